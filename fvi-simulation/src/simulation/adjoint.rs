//! Gradients: derivatives of one function of a discrete motion by any number of parameters.

mod constants;
mod term;

use crate::model::{AnyScheme, AnySpace, Matrix, Model, StepShape};
use crate::simulation::step_batch::StepBatch;
use crate::simulation::tangent::explicit::Direct;
use crate::simulation::tangent::points::{Points, Step, StepMatrix};
use crate::simulation::tangent::{Beginning, Solver, Turning, add, gyroscopic, refuse_rough, solver};
use constants::Constants;
use fvi_core::{ActsOn, Block, Mechanics, MemoryError, Sampling, Scheme};
use fvi_fft::memory::Tables;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Derivative, Feature, Parameter, Quantity, ReportedMomentum, Scenario};
use nalgebra::DMatrix;
use std::ops::Range;
use std::sync::Arc;
use term::{Origin, Term};

/// What a stretch of steps leaves behind for gradients: the states, and what the steps were solved by.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// Number of steps made before the first state.
    first: usize,
    size: usize,
    unknowns: usize,
    positions: Vec<f64>,
    momenta: Vec<f64>,
    increments: Vec<f64>,
}

impl Record {
    /// Takes the states of a batch, the steps to which have left behind what they were solved by.
    pub fn take(&mut self, batch: &StepBatch) {
        for index in 0..batch.len() {
            self.size = batch.positions().count();
            self.positions.extend(batch.positions().map(|column| column[index]));
            self.momenta.extend(batch.momenta().map(|column| column[index]));
            if batch.first() + index > 0 {
                let increments = batch.increments(index);
                self.unknowns = increments.len();
                self.increments.extend_from_slice(increments);
            }
        }
    }

    /// The last step with both its states, to which a later stretch can be appended.
    #[must_use]
    pub fn tail(&self) -> Self {
        let steps = self.steps().min(1);
        let last = |numbers: &[f64], count: usize| numbers[numbers.len() - count..].to_vec();
        Self {
            first: self.end() - steps,
            positions: last(&self.positions, (steps + 1) * self.size),
            momenta: last(&self.momenta, (steps + 1) * self.size),
            increments: last(&self.increments, steps * self.unknowns),
            ..*self
        }
    }

    /// Number of steps in it.
    fn steps(&self) -> usize {
        self.increments.len().checked_div(self.unknowns).unwrap_or(0)
    }

    /// Number of steps of the motion up to its last state.
    pub fn end(&self) -> usize {
        self.first + self.steps()
    }

    /// Bytes of its numbers.
    pub fn bytes(&self) -> usize {
        size_of::<f64>() * (self.positions.len() + self.momenta.len() + self.increments.len())
    }

    fn position(&self, k: usize) -> &[f64] {
        &self.positions[(k - self.first) * self.size..][..self.size]
    }

    fn momentum(&self, k: usize) -> &[f64] {
        &self.momenta[(k - self.first) * self.size..][..self.size]
    }

    fn unknowns(&self, k: usize) -> &[f64] {
        &self.increments[(k - self.first) * self.unknowns..][..self.unknowns]
    }
}

/// Adds the derivatives of a function by the state q_k, p_k after k steps to q̄ and p̄.
pub type Cotangent<'a> = dyn FnMut(usize, &mut [f64], &mut [f64]) + 'a;

/// Derivatives of a function J of a motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradient {
    /// By the parameters of `[sensitivity]`, in their order.
    pub parameters: Vec<f64>,
    /// By q₀, N numbers.
    pub position: Vec<f64>,
    /// By p₀, with the velocity that belongs to it.
    pub momentum: Vec<f64>,
    /// By a force on each coordinate that is constant over a step and zero in the others, as `[input]` has
    /// it: N numbers for each step.
    pub force: Vec<f64>,
}

/// The steps of a motion backwards.
///
/// With the cotangents q̄, p̄ of the state after a step, those of the state before it are found from the
/// multipliers λ of the equations of the step (those of the tangent), which the
/// transposed matrix of Newton's method determines:
///
/// ```text
/// Aᵀ λ = −ē ,      Ḡ_i = −h b_i p̄_{k+1} + Σ_ν part(i, ν) λ_ν ,
/// Z_m = Σ_l W_lᵀ D̄_{m+l} ,      s̄ = ρᵀ Z ,
/// q̄_k = q̄_{k+1} + Σ_i (∂²U − ∂F)ᵀ Ḡ_i + … ,      p̄_k = p̄_{k+1} + λ_0 .
/// ```
///
/// ē is the cotangent of the unknowns as far as it is known before: from the end of the step, from its own
/// forces in the new momentum, and from the samples that later forces remember. Each parameter then costs a
/// product with λ, Ḡ or Z in each step; those of kernels are the product of the derivatives of the weights
/// with the correlation Σ_m (ρᵀD̄_m) s_{m−l}, formed once.
///
/// The numbers are those of forward sensitivities, up to rounding: the transpose of the same linear map.
pub struct Adjoint {
    size: usize,
    start: f64,
    step: f64,
    scheme: Arc<AnyScheme<f64>>,
    kicks: bool,
    at_main_nodes: bool,
    mean: bool,
    model: Model<f64>,
    points: Points,
    parameters: Vec<Parameter>,
    direct: Vec<(usize, Direct)>,
    constants: Option<Constants>,
    mass_changes: Vec<(usize, Vec<(usize, usize)>)>,
    gives_velocity: bool,
    /// q₀, v₀ and t₀ of the memories.
    base: Vec<f64>,
    velocity: Vec<f64>,
    terms: Vec<Term>,
    /// Σ ρ K(0) of Caputo's terms, each with its factor.
    springs: Vec<(f64, Matrix<f64>)>,
    gyroscopic: Option<Turning>,
    gyroscopic_changes: Vec<(usize, Turning)>,
    solver: Solver,
    cotangents: Cotangents,
    gradient: Gradient,
}

/// Cotangents on their way back through the steps.
struct Cotangents {
    /// q̄_k and p̄_k.
    position: Vec<f64>,
    momentum: Vec<f64>,
    /// Of the offsets of q_k from the nodes of the step before it: R n numbers.
    behind: Vec<f64>,
    /// Of the position and velocity at which the motion of the memories begins.
    base: Vec<f64>,
    velocity: Vec<f64>,
    /// Ḡ_i, D̄_i and the cotangents of X_i − q_k, n numbers at each point.
    forces: Vec<f64>,
    damped: Vec<f64>,
    stages: Vec<f64>,
    /// Of q_{k+1} − q_k.
    rise: Vec<f64>,
    sample: Vec<f64>,
    columns: DMatrix<f64>,
}

impl Adjoint {
    /// Before the last step of a motion of the scenario, for the parameters of its `[sensitivity]`.
    ///
    /// # Errors
    /// If gradients of the scenario are not supported.
    pub fn new(scenario: &Scenario, tables: &Tables) -> Result<Self, InputError> {
        scenario.check_use(Feature::Gradient)?;
        let parameters = scenario.sensitivity.as_ref().map_or(&[][..], |asked| &asked.parameters);
        refuse_rough(scenario, parameters)?;
        let size = scenario.coordinates();
        let solver = solver(scenario, true)?;
        let shape = |error: fvi_core::ParameterError| {
            scenario.error_at("scheme", Problem::OutOfRange { allowed: error.allowed.to_owned() })
        };
        let scheme = AnyScheme::<f64>::new(scenario).map_err(shape)?;
        let kicks = scheme.kicks_at_main_nodes();
        let at_main_nodes = matches!(Scheme::<f64, AnySpace>::sampling(&scheme), Sampling::MainNodes);
        let (degree, points) = (scheme.view().control_points.len(), scheme.view().nodes.len());
        let nodes = if at_main_nodes { 1 } else { points };
        let model = Model::<f64>::new(scenario).map_err(|error| super::bad_mass(scenario, &error))?;
        let beginning = Beginning::of(scenario, parameters, &model);
        let damping = &scenario.system.damping;
        let terms = (0..damping.len()).map(|index| Term::new(scenario, (index, nodes), parameters, tables));
        let terms = terms.collect::<Result<Vec<_>, _>>()?;
        let springs = damping.iter().filter(|term| term.derivative == Derivative::Caputo);
        let springs = springs.filter(|term| term.transfer.spring() != 0.0);
        let springs = springs.map(|term| (term.transfer.spring(), crate::model::matrix(&term.coefficient)));
        let (gyroscopic, gyroscopic_changes) = gyroscopic(scenario, parameters, &scheme);
        let of_position = |what: &Quantity| matches!(what, Quantity::Position(_));
        let direct = parameters.iter().enumerate().filter(|(_, parameter)| !of_position(&parameter.what));
        let direct = direct.flat_map(|(index, parameter)| {
            Direct::beside_expressions(scenario, &parameter.what).into_iter().map(move |part| (index, part))
        });
        let changes = beginning.mass_changes.into_iter().enumerate();
        let zeros = |count: usize| vec![0.0; count * size];
        Ok(Self {
            size,
            start: scenario.time.start,
            step: scenario.time.step,
            kicks,
            at_main_nodes,
            mean: kicks && scenario.output.momentum == ReportedMomentum::Mean,
            points: Points::new(&model, size, points),
            model,
            parameters: parameters.to_vec(),
            direct: direct.collect(),
            constants: Constants::new(scenario, parameters)?,
            mass_changes: changes.filter(|(_, change)| !change.is_empty()).collect(),
            gives_velocity: scenario.document().has("initial.velocity"),
            base: scenario.initial.base().to_vec(),
            velocity: beginning.velocity,
            terms,
            springs: springs.collect(),
            gyroscopic,
            gyroscopic_changes,
            solver,
            cotangents: Cotangents {
                position: zeros(1),
                momentum: zeros(1),
                behind: zeros(nodes),
                base: zeros(1),
                velocity: zeros(1),
                forces: zeros(points),
                damped: zeros(nodes),
                stages: zeros(points),
                rise: zeros(1),
                sample: zeros(nodes),
                columns: DMatrix::zeros(degree * size, 1),
            },
            gradient: Gradient { parameters: vec![0.0; parameters.len()], ..Gradient::default() },
            scheme: Arc::new(scheme),
        })
    }

    /// Goes back through the steps with these indices, which the record contains. The derivatives of the
    /// function by the state q_k, p_k after k steps are what `cotangent(k, q̄, p̄)` adds to q̄ and p̄; it is
    /// called for the ends of the steps.
    ///
    /// # Errors
    /// A message, if a step has no derivative.
    pub fn go_back(
        &mut self,
        record: &Record,
        steps: Range<usize>,
        cotangent: &mut Cotangent<'_>,
    ) -> Result<(), String> {
        let needed = steps.end * self.size;
        if self.gradient.force.len() < needed {
            self.gradient.force.resize(needed, 0.0);
        }
        for k in steps.rev() {
            let momentum = self.receive(k + 1, cotangent);
            self.retreat(k, record, &momentum)?;
        }
        Ok(())
    }

    /// Adds the cotangents of a state, and returns that of the momentum.
    fn receive(&mut self, k: usize, cotangent: &mut Cotangent<'_>) -> Vec<f64> {
        let (mut position, mut momentum) = (vec![0.0; self.size], vec![0.0; self.size]);
        cotangent(k, &mut position, &mut momentum);
        add(&mut self.cotangents.position, 1.0, &position);
        add(&mut self.cotangents.momentum, 1.0, &momentum);
        momentum
    }

    /// From the state after step k to that before it. The cotangents of the former include those of the
    /// function, of which `momentum` is that by the reported momentum.
    fn retreat(&mut self, k: usize, record: &Record, momentum: &[f64]) -> Result<(), String> {
        let scheme = Arc::clone(&self.scheme);
        let shape = StepShape::new(&scheme, self.step);
        let fractions = if self.at_main_nodes { &[1.0][..] } else { shape.nodes() };
        let step = Step {
            shape,
            time: self.start + self.step * k as f64,
            length: self.step,
            start: record.position(k),
            momentum: record.momentum(k),
            unknowns: record.unknowns(k),
            fractions,
        };
        let m = if self.at_main_nodes { k + 1 } else { k };
        self.points.place(&mut self.model, &step);
        self.points.linearise(&mut self.model, &step, !self.solver.is_ready());
        self.recall(&step, m, momentum).map_err(|error| error.to_string())?;
        self.factor(&step, m)?;
        self.solve(&step, m)?;
        self.attribute(&step);
        let behind = self.behind(record, k, shape);
        self.remember(&step, (m, behind)).map_err(|error| error.to_string())?;
        self.hand_on(&step);
        let force = &mut self.gradient.force[k * self.size..][..self.size];
        self.cotangents.forces.chunks(self.size).for_each(|of_point| add(force, -1.0, of_point));
        match self.cotangents.position.iter().chain(&self.cotangents.momentum).all(|x| x.is_finite()) {
            true => Ok(()),
            false => Err("a derivative is not finite".to_owned()),
        }
    }

    /// The cotangents that are known before the multipliers: those of the rise and the points from later
    /// steps, and of the forces from the new momentum.
    fn recall(&mut self, step: &Step<'_>, m: usize, momentum: &[f64]) -> Result<(), MemoryError> {
        let (n, h, shape) = (self.size, self.step, step.shape);
        let Self { cotangents, terms, .. } = self;
        let Cotangents { rise, stages, forces, damped, behind, sample, .. } = cotangents;
        rise.copy_from_slice(&cotangents.position);
        stages.fill(0.0);
        forces.fill(0.0);
        if !shape.is_collocation() {
            for (force, weight) in forces.chunks_mut(n).zip(shape.weights()) {
                add(force, -h * weight, &cotangents.momentum);
            }
        }
        if !self.at_main_nodes {
            for (stage, behind) in stages.chunks_mut(n).zip(behind.chunks(n)) {
                add(rise, 1.0, behind);
                add(stage, -1.0, behind);
            }
        }
        if self.kicks {
            damped.fill(0.0);
            add(damped, -h, &cotangents.momentum);
            if self.mean {
                add(damped, 0.5 * h, momentum);
            }
        }
        for term in terms {
            term.recall(m, h)?;
            if self.kicks {
                term.push(m, damped)?;
            }
            sample.fill(0.0);
            term.rho.transposed_multiply_add_all(&term.convolved, sample);
            match self.at_main_nodes {
                true => add(rise, 1.0, sample),
                false => add(stages, 1.0, sample),
            }
        }
        Ok(())
    }

    /// The matrix of the step as for the tangent, transposed.
    fn factor(&mut self, step: &Step<'_>, m: usize) -> Result<(), &'static str> {
        let (n, nodes, shape) = (self.size, step.fractions.len(), step.shape);
        let stays = Mechanics::is_linear(&self.model) && self.terms.iter().all(Term::is_uniform);
        if self.solver.is_ready() && stays {
            return Ok(());
        }
        let acting = if self.kicks { &[][..] } else { &self.terms };
        let matrix = StepMatrix {
            mass: self.model.mass(),
            points: &self.points,
            dampers: acting.iter().map(|term| (&term.rho, term.leading(m))).collect(),
            gyroscopic: self.gyroscopic.as_ref().filter(|_| !self.kicks),
        };
        let size = (shape.degree(), n);
        self.solver.factor_transposed(size, matrix.mass, |insert| matrix.visit(shape, nodes, insert))
    }

    /// Adds to the cotangents of the rise and the points those that forces hand to them.
    fn pull_forces(&mut self, step: &Step<'_>, m: usize) {
        let (n, nodes) = (self.size, step.fractions.len());
        let Self { cotangents, points, terms, .. } = self;
        let Cotangents { rise, stages, forces, .. } = cotangents;
        for (i, (stage, force)) in stages.chunks_mut(n).zip(forces.chunks(n)).enumerate() {
            points.stiffness(i).transposed_multiply_add(1.0, force, stage);
        }
        if self.kicks {
            return;
        }
        for term in terms {
            for (index, weight) in
                term.leading(m).into_iter().enumerate().filter(|&(_, weight)| weight != 0.0)
            {
                let (i, j) = (index / nodes, index % nodes);
                let place = if self.at_main_nodes { &mut rise[..] } else { &mut stages[j * n..][..n] };
                term.rho.transposed_multiply_add(weight, &forces[i * n..][..n], place);
            }
        }
        if let Some(gyroscopic) = &self.gyroscopic {
            gyroscopic.visit(|i, j, weight, skew| {
                skew.transposed_multiply_add(weight, &forces[i * n..][..n], &mut stages[j * n..][..n]);
            });
        }
    }

    /// Solves for the multipliers, and completes the cotangents of forces and points by them.
    fn solve(&mut self, step: &Step<'_>, m: usize) -> Result<(), &'static str> {
        let (n, h, shape) = (self.size, self.step, step.shape);
        let known = self.cotangents.stages.clone();
        let known_rise = self.cotangents.rise.clone();
        self.pull_forces(step, m);
        let Self { cotangents, points, solver, model, .. } = self;
        let Cotangents { rise, stages, forces, columns, momentum, .. } = &mut *cotangents;
        let column = columns.as_mut_slice();
        column.fill(0.0);
        if shape.is_collocation() {
            // The end of the step is its last node.
            let last = stages.len() - n;
            add(&mut stages[last..], 1.0, rise);
        } else {
            add(&mut column[(shape.degree() - 1) * n..], -1.0, rise);
        }
        for mu in 0..shape.degree() {
            let right = &mut column[mu * n..][..n];
            for i in 0..shape.points() {
                add(right, -shape.displacement(i, mu), &stages[i * n..][..n]);
                if let Some(resistance) = points.resistance(i) {
                    resistance.transposed_multiply_add(-shape.slope(i, mu), &forces[i * n..][..n], right);
                }
            }
            if shape.is_collocation() {
                model.mass().multiply_add(-h * shape.weights()[mu], momentum, right);
            }
        }
        solver.solve(columns)?;
        let multipliers = columns.as_slice();
        for (i, force) in forces.chunks_mut(n).enumerate() {
            for nu in 0..shape.degree() {
                add(force, shape.part(i, nu), &multipliers[nu * n..][..n]);
            }
        }
        stages.copy_from_slice(&known);
        rise.copy_from_slice(&known_rise);
        self.pull_forces(step, m);
        Ok(())
    }

    /// Adds the derivatives by parameters in the mass, the forces, and gyroscopic matrices.
    fn attribute(&mut self, step: &Step<'_>) {
        let (n, h, shape) = (self.size, self.step, step.shape);
        let Self { cotangents, points, gradient, constants, .. } = self;
        let Cotangents { forces, columns, momentum, .. } = &*cotangents;
        let multipliers = columns.as_slice();
        let parameters = &mut gradient.parameters;
        let through = |change: &[(usize, usize)], left: &[f64], right: &[f64]| -> f64 {
            change.iter().map(|&(row, column)| left[row] * right[column]).sum()
        };
        for (parameter, change) in &self.mass_changes {
            for nu in 0..shape.degree() {
                let multiplier = &multipliers[nu * n..][..n];
                for mu in 0..shape.degree() {
                    let factor = shape.inertia(nu, mu);
                    parameters[*parameter] += factor * through(change, multiplier, step.unknown(mu, n));
                }
            }
            if shape.is_collocation() {
                for (j, weight) in shape.weights().iter().enumerate() {
                    parameters[*parameter] += h * weight * through(change, momentum, step.unknown(j, n));
                }
            }
        }
        for i in 0..shape.points() {
            let instant = points.instant(step, i);
            for (parameter, part) in &mut self.direct {
                parameters[*parameter] += part.weighted(instant, points.at(i), &forces[i * n..][..n]);
            }
            if let Some(constants) = constants {
                constants.visit(instant, points.at(i), &forces[i * n..][..n]);
            }
        }
        let mut turned = vec![0.0; n];
        for (parameter, change) in &self.gyroscopic_changes {
            change.visit(|i, j, weight, skew| {
                turned.fill(0.0);
                skew.multiply_add(weight, &points.stages[j * n..][..n], &mut turned);
                let pairs = turned.iter().zip(&forces[i * n..][..n]);
                parameters[*parameter] += pairs.map(|(turned, force)| turned * force).sum::<f64>();
            });
        }
    }

    /// The offsets of q_k from the nodes of the step before, if a term needs them.
    fn behind(&self, record: &Record, k: usize, shape: StepShape<'_>) -> Option<Vec<f64>> {
        let asked = |term: &Term| term.needs_samples() && term.acts_on == ActsOn::Increments;
        let before = k.checked_sub(1).filter(|_| !self.at_main_nodes && self.terms.iter().any(asked))?;
        let (n, unknowns) = (self.size, record.unknowns(before));
        let mut behind = Vec::with_capacity(shape.points() * n);
        for i in 0..shape.points() {
            let mut node = unknowns[(shape.degree() - 1) * n..].to_vec();
            for mu in 0..shape.degree() {
                add(&mut node, -shape.displacement(i, mu), &unknowns[mu * n..][..n]);
            }
            behind.extend(node);
        }
        Some(behind)
    }

    /// Completes the cotangents of the samples, and hands them on to what the samples were made of.
    fn remember(
        &mut self,
        step: &Step<'_>,
        (m, behind): (usize, Option<Vec<f64>>),
    ) -> Result<(), MemoryError> {
        let (n, is_first) = (self.size, m == 0);
        let Self { cotangents, points, terms, gradient, .. } = self;
        let Cotangents { forces, damped, sample, position, base, velocity, behind: of_behind, .. } =
            cotangents;
        if !self.kicks {
            let count = damped.len();
            damped.copy_from_slice(&forces[..count]);
        }
        let rises = if self.at_main_nodes { &points.rise } else { &points.stages };
        let origin = Origin { position: &self.base, velocity: &self.velocity, time: self.start };
        of_behind.fill(0.0);
        for term in terms {
            if !self.kicks {
                term.push(m, damped)?;
            }
            sample.fill(0.0);
            term.rho.transposed_multiply_add_all(&term.convolved, sample);
            for (i, node) in sample.chunks(n).enumerate() {
                let places = [&mut position[..], &mut base[..], &mut velocity[..]];
                term.pull(step, (i, is_first, self.start), node, places);
            }
            if term.acts_on == ActsOn::Increments && !is_first {
                add(of_behind, 1.0, sample);
            }
            if term.needs_samples() {
                let sample = term.sample(step, (rises, behind.as_deref()), (is_first, &origin));
                term.gather((damped, &sample), &mut gradient.parameters);
            }
        }
        Ok(())
    }

    /// q̄_k and p̄_k.
    fn hand_on(&mut self, step: &Step<'_>) {
        let (n, h, shape) = (self.size, self.step, step.shape);
        let Self { cotangents, points, model, gradient, .. } = self;
        let Cotangents { position, momentum, forces, stages, rise, columns, .. } = cotangents;
        for (i, force) in forces.chunks(n).enumerate() {
            points.stiffness(i).transposed_multiply_add(1.0, force, position);
        }
        if !shape.is_collocation() {
            add(momentum, 1.0, &columns.as_slice()[..n]);
            return;
        }
        let last = stages.len() - n;
        add(&mut stages[last..], 1.0, rise);
        let mut velocity = vec![0.0; n];
        for (i, (stage, force)) in stages.chunks(n).zip(forces.chunks(n)).enumerate() {
            add(&mut velocity, h * shape.nodes()[i], stage);
            if let Some(resistance) = points.resistance(i) {
                resistance.transposed_multiply_add(1.0, force, &mut velocity);
            }
        }
        let mut solved = vec![0.0; n];
        model.velocity(&velocity, &mut solved);
        for (parameter, change) in &self.mass_changes {
            let pairs = change.iter().map(|&(row, column)| solved[row] * points.start_velocity[column]);
            gradient.parameters[*parameter] -= pairs.sum::<f64>();
        }
        add(momentum, 1.0, &solved);
    }

    /// The gradient, when all steps have been gone back; the record contains the first state.
    ///
    /// # Errors
    /// A message, if a memory has no term for it.
    pub fn finish(mut self, record: &Record, cotangent: &mut Cotangent<'_>) -> Result<Gradient, String> {
        self.receive(0, cotangent);
        self.complete(record).map_err(|error| error.to_string())
    }

    fn complete(mut self, record: &Record) -> Result<Gradient, MemoryError> {
        let n = self.size;
        let scheme = Arc::clone(&self.scheme);
        if self.at_main_nodes {
            // The memories began with the position at the start.
            let shape = StepShape::new(&scheme, self.step);
            let step = Step {
                shape,
                time: self.start,
                length: 0.0,
                start: record.position(0),
                momentum: record.momentum(0),
                unknowns: &[],
                fractions: &[0.0],
            };
            let origin = Origin { position: &self.base, velocity: &self.velocity, time: self.start };
            let zeros = vec![0.0; n];
            let Cotangents { sample, position, base, velocity, .. } = &mut self.cotangents;
            for term in &mut self.terms {
                term.recall(0, self.step)?;
                sample.fill(0.0);
                term.rho.transposed_multiply_add_all(&term.convolved, sample);
                let places = [&mut position[..], &mut base[..], &mut velocity[..]];
                term.pull(&step, (0, true, self.start), sample, places);
                if term.needs_samples() {
                    let first = term.sample(&step, (&zeros, None), (true, &origin));
                    term.gather((&zeros, &first), &mut self.gradient.parameters);
                }
            }
        }
        self.terms.iter_mut().for_each(|term| term.correlate(&mut self.gradient.parameters));
        self.constants.iter().for_each(|constants| constants.finish(&mut self.gradient.parameters));
        let Cotangents { position, momentum, base, velocity, .. } = &self.cotangents;
        let (mut by_position, mut by_momentum) = (position.clone(), momentum.clone());
        add(&mut by_position, 1.0, base);
        let mut of_velocity = vec![0.0; n];
        self.model.velocity(velocity, &mut of_velocity);
        add(&mut by_momentum, 1.0, &of_velocity);
        // The springs of Caputo's terms rest at the start.
        let mut all_forces = vec![0.0; n];
        self.gradient.force.chunks(n).for_each(|force| add(&mut all_forces, -1.0, force));
        for (spring, rho) in &self.springs {
            rho.transposed_multiply_add(-spring, &all_forces, &mut by_position);
        }
        let mut by_velocity = vec![0.0; n];
        self.model.mass().multiply_add(1.0, &by_momentum, &mut by_velocity);
        let Gradient { parameters, .. } = &mut self.gradient;
        for (place, parameter) in parameters.iter_mut().zip(&self.parameters) {
            match parameter.what {
                Quantity::Position(index) => *place += by_position[index],
                Quantity::Momentum(index) => *place += by_momentum[index],
                Quantity::Velocity(index) => *place += by_velocity[index],
                _ => {}
            }
        }
        for (parameter, change) in &self.mass_changes {
            // With a given velocity the momentum changes with the mass, else the velocity does.
            let through = |left: &[f64]| -> f64 {
                change.iter().map(|&(row, column)| left[row] * self.velocity[column]).sum()
            };
            parameters[*parameter] += match self.gives_velocity {
                true => through(momentum),
                false => -through(&of_velocity),
            };
        }
        (self.gradient.position, self.gradient.momentum) = (by_position, by_momentum);
        Ok(self.gradient)
    }
}
