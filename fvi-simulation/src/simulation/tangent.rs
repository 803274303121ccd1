//! Derivatives of a discrete motion with respect to parameters of its scenario.

pub(super) mod explicit;
mod mechanism;
mod mechanism_explicit;
pub(super) mod mechanism_step;
pub(super) mod points;
mod step;

use crate::model::{AnyEquations, AnyFactors, AnyScheme, AnySpace, Matrix, Model, RoughForces, matrix};
use crate::simulation::choice::{SolverChoice, sparse_space};
use crate::simulation::gyroscopic::Gyroscopic;
use explicit::Direct;
use fvi_core::{
    Block, DampedMotion, Derivative, Equations, Kernel, Mechanics, MemoryError, ParameterError, Real, Sample,
    Sampling, Scheme, StateError, StateReader, StateWriter, Stateful,
};
use fvi_fft::dense::Factored;
use fvi_fft::memory::{EngineError, HostMemory, MemoryRequest, Tables};
use fvi_fft::quadrature::multistep_weights::derivative_weights;
use fvi_fft::quadrature::runge_kutta_derivative::runge_kutta_derivative;
use fvi_fft::transfer::derivative::TransferDerivative;
use fvi_fft::with_staged_method;
use fvi_scenario::language::error::Cause;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{self, Parameter, Past, Quantity, ReportedMomentum, Scenario, Sensitivity};
use nalgebra::DMatrix;
use points::Points;
use std::sync::Arc;

/// Gyroscopic forces at the nodes.
pub(super) type Turning = Gyroscopic<f64, Matrix<f64>>;

/// A motion with its memory, for any number of coordinates.
type Remembered = DampedMotion<f64, AnySpace, HostMemory<f64>>;

/// The derivatives of a motion by the parameters of its scenario.
pub(crate) trait Differentiated: Send {
    /// Computes the derivatives after step `step`, which began at this position and momentum and was solved
    /// with these increments, for collocation with these accelerations.
    ///
    /// # Errors
    /// A message.
    fn advance(&mut self, step: usize, begin: (&[f64], &[f64]), increments: &[f64]) -> Result<(), String>;

    /// Appends the state.
    ///
    /// # Errors
    /// [`StateError`] if a memory cannot be saved.
    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), StateError>;

    /// Restores a state that the derivatives of the same scenario saved; the following ones have identical
    /// bits.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are no such state; the derivatives must not be used then.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError>;

    /// Writes ∂q and ∂p of every parameter, one after another.
    fn write(&self, values: &mut Vec<f64>);
}

/// The derivatives at t = 0; `None` without `[sensitivity]`.
///
/// # Errors
/// If a memory cannot be built, or derivatives by a parameter are not supported.
pub(crate) fn derivatives(
    scenario: &Scenario,
    tables: &Tables,
) -> Result<Option<Box<dyn Differentiated>>, InputError> {
    let Some(Sensitivity { parameters }) = &scenario.sensitivity else { return Ok(None) };
    refuse_rough(scenario, parameters)?;
    Ok(Some(match scenario.is_mechanism() {
        true => Box::new(mechanism::OfMechanism::new(scenario, parameters)?),
        false => Box::new(Tangent::new(scenario, parameters, tables)?),
    }))
}

/// ∂q_k/∂θ and ∂p_k/∂θ of the discrete motion of a scheme on equal steps, for p parameters.
///
/// The equations of a step (`discrete_lagrangian.rs`), differentiated, are linear in the derivatives and have
/// the matrix of Newton's method; with δ for ∂/∂θ and G_i the forces at the nodes
///
/// ```text
/// 0 = δ_{ν0} δp_k + (1/h) Σ_μ K_νμ (M δe^μ + δM e^μ) − h Σ_i b_i ℓ_ν(c_i) δG_i ,      ν = 0…S−1
/// δp_{k+1} = δp_k − h Σ_i b_i δG_i ,
/// δG_i = (∂²U − ∂F) δX_i − ∂F/∂v δV_i + G δV_i + δG V_i + ∂G_i/∂θ
///        + Σ_m [ρ_m D_m δX + δρ_m D_m X + ρ_m (∂D_m/∂θ) X]_i .
/// ```
///
/// with δV_i = Σ_ν ℓ̇_ν(c_i) δe^ν/h if forces, including the gyroscopic ones of the matrix G, depend on the
/// velocity of the polynomial. D_m acts on δX with its weights, on a separate memory with p times the
/// channels, and ∂D_m/∂θ on X with the derivatives of the weights. If the force acts at the main nodes its
/// three parts are in the last equation only. For collocation, with v = M⁻¹p,
///
/// ```text
/// 0 = M δa_i + δM a_i + δG_i ,      δX_i − δq_k = h c_i δv_k + h² Σ_j (A²)_ij δa_j ,
/// δV_i = δv_k + h Σ_j A_ij δa_j ,
/// δp_{k+1} = δp_k + h Σ_j b_j (M δa_j + δM a_j) ,      M δv_k = δp_k − δM v_k .
/// ```
///
/// So the derivatives are those of the computed numbers, up to rounding, not of the exact motion.
struct Tangent {
    size: usize,
    count: usize,
    /// Time at which the run begins.
    start: f64,
    step: f64,
    scheme: Arc<AnyScheme<f64>>,
    /// True if damping acts in the new momentum only, and whether memories store main nodes.
    kicks: bool,
    at_main_nodes: bool,
    /// True if half of the last kick is part of the reported momentum.
    mean: bool,
    model: Model<f64>,
    points: Points,
    /// ∂G/∂θ of each parameter, as a sum of parts.
    direct: Vec<Vec<Direct>>,
    /// ∂M: for each parameter the places whose entry it is.
    mass_changes: Vec<Vec<(usize, usize)>>,
    terms: Vec<Term>,
    /// G V, and δG V for the parameters in G.
    gyroscopic: Option<Turning>,
    gyroscopic_changes: Vec<(usize, Turning)>,
    solver: Solver,
    /// ∂q, ∂p and the derivative of the last kick: p times N numbers.
    position: Vec<f64>,
    momentum: Vec<f64>,
    kick: Vec<f64>,
    /// Offset of the position at the end of the last step from each of its nodes: its derivatives by the
    /// parameters, and its value.
    behind: Vec<f64>,
    motion_behind: Vec<f64>,
    scratch: Vec<f64>,
    room: TangentBuffers,
}

/// Buffers for a step: for n coordinates, R points and p parameters.
struct TangentBuffers {
    /// Derivatives of the damping force at the nodes: p n numbers each.
    damped: Vec<f64>,
    /// ∂G_i at the points: p n numbers each.
    forces: Vec<f64>,
    /// n numbers.
    right: Vec<f64>,
    /// h c_i ∂v_k and ∂v_k of collocation.
    base: Vec<f64>,
    start_velocities: Vec<f64>,
    /// ∂X_i − ∂q_k, and ∂q_{k+1} − ∂q_k.
    own_stages: Vec<f64>,
    own_rise: Vec<f64>,
    /// The right-hand sides for each parameter, replaced by the solutions.
    columns: DMatrix<f64>,
    /// Results of memories.
    derivative: Vec<f64>,
    terms: Vec<f64>,
}

impl TangentBuffers {
    fn new(n: usize, (degree, points, nodes): (usize, usize, usize), p: usize) -> Self {
        Self {
            damped: vec![0.0; nodes * p * n],
            forces: vec![0.0; points * p * n],
            right: vec![0.0; n],
            base: vec![0.0; points * p * n],
            start_velocities: vec![0.0; p * n],
            own_stages: vec![0.0; points * p * n],
            own_rise: vec![0.0; p * n],
            columns: DMatrix::zeros(degree * n, p),
            derivative: Vec::new(),
            terms: Vec::new(),
        }
    }
}

/// Solver of the equations of the derivatives, with the factors of their matrix.
pub(super) enum Solver {
    /// With a full matrix.
    Dense(Option<Factored>),
    /// By a sparse factor, in the space of the motion.
    Sparse { equations: Box<AnyEquations<f64>>, kept: Option<Box<AnyFactors<f64>>> },
}

impl Solver {
    pub(super) fn is_ready(&self) -> bool {
        match self {
            Self::Dense(factors) => factors.is_some(),
            Self::Sparse { kept, .. } => kept.is_some(),
        }
    }

    pub(super) fn forget(&mut self) {
        match self {
            Self::Dense(factors) => *factors = None,
            Self::Sparse { kept, .. } => *kept = None,
        }
    }

    /// Factors the matrix of the given number of unknowns, assembled from `parts`: row and column of a block,
    /// its factor and the block.
    pub(super) fn factor(
        &mut self,
        (degree, n): (usize, usize),
        mass: &Matrix<f64>,
        parts: impl FnOnce(&mut dyn FnMut(usize, usize, f64, &Matrix<f64>)),
    ) -> Result<(), &'static str> {
        match self {
            Self::Dense(factors) => {
                let mut matrix = DMatrix::zeros(degree * n, degree * n);
                parts(&mut |nu, mu, factor, block| {
                    if factor != 0.0 {
                        for (row, column, entry) in block.entries() {
                            matrix[(nu * n + row, mu * n + column)] += factor * entry;
                        }
                    }
                });
                *factors = Some(Factored::new(matrix).ok_or(SINGULAR)?);
            }
            Self::Sparse { equations, kept } => {
                *kept = None;
                Equations::<f64, _>::clear(&mut **equations);
                parts(&mut |nu, mu, factor, block| equations.add(nu, mu, factor, block));
                let mut factors = AnyFactors::default();
                equations.keep(&mut factors, (0.0, mass)).map_err(|_| SINGULAR)?;
                *kept = Some(Box::new(factors));
            }
        }
        Ok(())
    }

    /// As [`factor`](Self::factor), for the transposed matrix; that of a sparse factor is symmetric.
    pub(super) fn factor_transposed(
        &mut self,
        (degree, n): (usize, usize),
        mass: &Matrix<f64>,
        parts: impl FnOnce(&mut dyn FnMut(usize, usize, f64, &Matrix<f64>)),
    ) -> Result<(), &'static str> {
        let Self::Dense(factors) = self else { return self.factor((degree, n), mass, parts) };
        let mut matrix = DMatrix::zeros(degree * n, degree * n);
        parts(&mut |nu, mu, factor, block| {
            if factor != 0.0 {
                for (row, column, entry) in block.entries() {
                    matrix[(mu * n + column, nu * n + row)] += factor * entry;
                }
            }
        });
        *factors = Some(Factored::new(matrix).ok_or(SINGULAR)?);
        Ok(())
    }

    /// Replaces the columns by the solutions.
    pub(super) fn solve(&mut self, columns: &mut DMatrix<f64>) -> Result<(), &'static str> {
        match self {
            Self::Dense(factors) => factors.as_ref().ok_or(SINGULAR)?.solve(columns),
            Self::Sparse { equations, kept } => {
                equations.solve_kept(kept.as_ref().ok_or(SINGULAR)?, columns.as_mut_slice());
            }
        }
        Ok(())
    }
}

/// ∂ρ by its entries (row, column, number).
pub(super) type Change = Vec<(usize, usize, f64)>;

/// A damping term.
struct Term {
    rho: Matrix<f64>,
    /// D δX.
    tangent: Remembered,
    /// D X, if a parameter is in ρ, and ∂ρ for each such parameter.
    value: Option<Remembered>,
    changes: Vec<(usize, Change)>,
    /// (∂D/∂θ) X for the parameters in the kernel.
    kernels: Vec<(usize, Remembered)>,
}

/// Reason why derivatives cannot be continued.
pub(crate) const SINGULAR: &str = "the equations of the derivatives have no solution";

impl Tangent {
    /// The derivatives at t = 0.
    fn new(scenario: &Scenario, parameters: &[Parameter], tables: &Tables) -> Result<Self, InputError> {
        let size = scenario.coordinates();
        let count = parameters.len();
        let solver = solver(scenario, false)?;
        let shape = |error: fvi_core::ParameterError| {
            scenario.error_at("scheme", Problem::OutOfRange { allowed: error.allowed.to_owned() })
        };
        let scheme = AnyScheme::<f64>::new(scenario).map_err(shape)?;
        let kicks = scheme.kicks_at_main_nodes();
        let at_main_nodes = matches!(Scheme::<f64, AnySpace>::sampling(&scheme), Sampling::MainNodes);
        let nodes = if at_main_nodes { 1 } else { scheme.view().nodes.len() };
        let model = Model::<f64>::new(scenario).map_err(|error| super::bad_mass(scenario, &error))?;
        let initial = &scenario.initial;
        let beginning = Beginning::of(scenario, parameters, &model);
        let begin = scenario.time.start - initial.past_steps() as f64 * scenario.time.step;
        let mut terms = Vec::new();
        for index in 0..scenario.system.damping.len() {
            let mut term = Term::new(scenario, (index, nodes), parameters, tables)?;
            term.tangent.begin(&beginning.base_slopes, &beginning.velocity_slopes);
            term.motions_mut().for_each(|motion| motion.begin(initial.base(), &beginning.velocity));
            if begin != 0.0 {
                term.motions_mut().for_each(|motion| motion.begin_at(begin));
                term.tangent.begin_at(begin);
            }
            terms.push(term);
        }
        let (gyroscopic, gyroscopic_changes) = gyroscopic(scenario, parameters, &scheme);
        let direct = parameters.iter().map(|parameter| Direct::all(scenario, &parameter.what)).collect();
        let (degree, points) = (scheme.view().control_points.len(), scheme.view().nodes.len());
        let mut made = Self {
            room: TangentBuffers::new(size, (degree, points, nodes), count),
            size,
            count,
            start: scenario.time.start,
            step: scenario.time.step,
            kicks,
            at_main_nodes,
            mean: kicks && scenario.output.momentum == ReportedMomentum::Mean,
            points: Points::new(&model, size, points),
            model,
            direct,
            mass_changes: beginning.mass_changes,
            terms,
            gyroscopic,
            gyroscopic_changes,
            solver,
            kick: vec![0.0; count * size],
            behind: vec![0.0; if at_main_nodes { 0 } else { nodes * count * size }],
            motion_behind: vec![0.0; if at_main_nodes { 0 } else { nodes * size }],
            scratch: vec![0.0; (nodes + 1) * count * size],
            position: beginning.position,
            momentum: beginning.momentum,
            scheme: Arc::new(scheme),
        };
        let told = match &initial.past {
            Some(past) => made.follow(past, (&initial.position, &beginning.pasts), beginning.base_slopes),
            None if at_main_nodes => made.push_start(initial.base()),
            None => Ok(()),
        };
        told.map_err(|error| scenario.error_at("sensitivity", Problem::Engine(Cause::new(error))))?;
        Ok(made)
    }

    /// Pushes the initial position to the memories of main nodes.
    fn push_start(&mut self, start: &[f64]) -> Result<(), MemoryError> {
        let Self { terms, position, scratch, .. } = self;
        let first = |from| Sample { from, behind: &[], time: 0.0, length: 0.0, fractions: &[0.0] };
        let (rest, of_motion) = (vec![0.0; position.len()], vec![0.0; start.len()]);
        push(terms, (&first(start), &of_motion), (&first(position), &rest), scratch)
    }

    /// Pushes the motion before the start to the memories: a past that ends at this position, and its
    /// derivatives by the parameters, which begin with the given ones.
    fn follow(
        &mut self,
        past: &Past,
        (end, slopes): (&[f64], &[Option<Past>]),
        begin: Vec<f64>,
    ) -> Result<(), MemoryError> {
        let (n, h) = (self.size, self.step);
        let mut from = past.first().to_vec();
        let last = std::mem::replace(&mut self.position, begin);
        if self.at_main_nodes {
            self.push_start(&from)?;
        }
        let view = self.scheme.view();
        let at_end = [1.0];
        let fractions = if self.at_main_nodes { &at_end[..] } else { view.nodes };
        // The nodes, if there are several; a single one lies on a straight line.
        let stages = |from: &[f64], rise: &[f64], nodes: &[f64]| -> Vec<f64> {
            match nodes {
                [] => rise.iter().map(|rise| fractions[0] * rise).collect(),
                _ => nodes.chunks(n).flat_map(|node| node.iter().zip(from).map(|(x, q)| x - q)).collect(),
            }
        };
        let difference = |end: &[f64], from: &[f64]| -> Vec<f64> {
            end.iter().zip(from).map(|(end, from)| end - from).collect()
        };
        for step in 0..past.steps() {
            let time = self.start - (past.steps() - step) as f64 * h;
            let rise = difference(past.end(step).unwrap_or(end), &from);
            let told = stages(&from, &rise, past.nodes(step));
            let slope_end: Vec<f64> = (slopes.iter().zip(last.chunks(n)))
                .flat_map(|(slope, last)| match slope.as_ref().map(|slope| slope.end(step)) {
                    Some(Some(end)) => end.to_vec(),
                    None if past.end(step).is_none() => last.to_vec(),
                    _ => vec![0.0; n],
                })
                .collect();
            let own_rise = difference(&slope_end, &self.position);
            // Node after node, for every parameter.
            let each: Vec<Vec<f64>> = (slopes.iter().zip(self.position.chunks(n).zip(own_rise.chunks(n))))
                .map(|(slope, (from, rise))| match slope {
                    Some(slope) => stages(from, rise, slope.nodes(step)),
                    None => stages(from, rise, &vec![0.0; past.nodes(step).len()]),
                })
                .collect();
            let own_told: Vec<f64> = (0..fractions.len())
                .flat_map(|i| each.iter().flat_map(move |stages| &stages[i * n..][..n]))
                .copied()
                .collect();
            let sample = |from, behind| Sample { from, behind, time, length: h, fractions };
            let (motion, slopes) = (sample(&from, &self.motion_behind), sample(&self.position, &self.behind));
            let TangentBuffers { terms: room, derivative, .. } = &mut self.room;
            let (nodes, c) = (fractions.len(), self.position.len());
            for term in &mut self.terms {
                known(&mut term.tangent, &slopes, (nodes, c), room, derivative)?;
                for motion_of_term in term.motions_mut() {
                    known(motion_of_term, &motion, (nodes, n), room, derivative)?;
                }
            }
            push(&mut self.terms, (&motion, &told), (&slopes, &own_told), &mut self.scratch)?;
            leave_behind(&mut self.motion_behind, &rise, &told);
            leave_behind(&mut self.behind, &own_rise, &own_told);
            add(&mut from, 1.0, &rise);
            self.position.copy_from_slice(&slope_end);
        }
        Ok(())
    }

    /// The motions of all memories, in a fixed order.
    fn motions(&self) -> impl Iterator<Item = &Remembered> {
        self.terms.iter().flat_map(|Term { tangent, value, kernels, .. }| {
            std::iter::once(tangent).chain(value).chain(kernels.iter().map(|(_, motion)| motion))
        })
    }

    fn numbers(&self) -> [&[f64]; 5] {
        [&self.position, &self.momentum, &self.kick, &self.behind, &self.motion_behind]
    }
}

impl Differentiated for Tangent {
    fn advance(&mut self, step: usize, begin: (&[f64], &[f64]), increments: &[f64]) -> Result<(), String> {
        self.make(step, begin, increments)
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), StateError> {
        let count: usize = self.numbers().iter().map(|numbers| numbers.len()).sum();
        let begin = bytes.len();
        let memories: usize = self.motions().map(DampedMotion::state_bytes).sum();
        bytes.resize(begin + count * f64::BYTES + memories, 0);
        let mut writer = StateWriter::new(&mut bytes[begin..]);
        self.numbers().into_iter().try_for_each(|numbers| writer.numbers(numbers))?;
        self.motions().try_for_each(|motion| motion.save(&mut writer))?;
        let length = begin + writer.written();
        bytes.truncate(length);
        Ok(())
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let mut reader = StateReader::new(bytes);
        let Self { position, momentum, kick, behind, motion_behind, terms, .. } = self;
        for numbers in [position, momentum, kick, behind, motion_behind] {
            reader.numbers(numbers)?;
        }
        for term in terms {
            term.tangent.restore(&mut reader)?;
            for motion in term.motions_mut() {
                motion.restore(&mut reader)?;
            }
        }
        self.solver.forget();
        reader.finish()
    }

    fn write(&self, values: &mut Vec<f64>) {
        values.clear();
        let half = if self.mean { 0.5 * self.step } else { 0.0 };
        for parameter in 0..self.count {
            let own = parameter * self.size..(parameter + 1) * self.size;
            values.extend_from_slice(&self.position[own.clone()]);
            let momenta = self.momentum[own.clone()].iter().zip(&self.kick[own]);
            values.extend(momenta.map(|(momentum, kick)| momentum + half * kick));
        }
    }
}

/// How the derivatives begin, one parameter after another.
pub(super) struct Beginning {
    /// ∂q and ∂p at the start, and ∂M.
    position: Vec<f64>,
    momentum: Vec<f64>,
    pub(super) mass_changes: Vec<Vec<(usize, usize)>>,
    /// The derivatives of the motion before the start.
    pasts: Vec<Option<Past>>,
    /// Where the motion of the memories begins: ∂q, its velocity, and the derivatives of that.
    base_slopes: Vec<f64>,
    pub(super) velocity: Vec<f64>,
    velocity_slopes: Vec<f64>,
}

impl Beginning {
    pub(super) fn of(scenario: &Scenario, parameters: &[Parameter], model: &Model<f64>) -> Self {
        let (size, initial) = (scenario.coordinates(), &scenario.initial);
        let velocity_of = |momentum: &[f64]| {
            let mut velocity = vec![0.0; size];
            model.velocity(momentum, &mut velocity);
            velocity
        };
        let mut velocity = velocity_of(&initial.momentum);
        let gives_velocity = scenario.document().has("initial.velocity");
        let (mut position, mut momentum, mut velocity_slopes) = (Vec::new(), Vec::new(), Vec::new());
        let (mut pasts, mut mass_changes) = (Vec::new(), Vec::new());
        let mass = matrix::<f64>(&scenario.system.mass);
        for parameter in parameters {
            let (mut dq, mut dp, mut inertia) = (vec![0.0; size], vec![0.0; size], vec![0.0; size]);
            let (mut changes, mut past) = (Vec::new(), None);
            match parameter.what {
                Quantity::Position(index) => dq[index] = 1.0,
                Quantity::Past(row, column) => {
                    past = initial.past.as_ref().map(|past| past.slope(row, column));
                }
                Quantity::Momentum(index) => dp[index] = 1.0,
                Quantity::Velocity(index) => {
                    let mut one = vec![0.0; size];
                    one[index] = 1.0;
                    mass.multiply_add(1.0, &one, &mut dp);
                }
                Quantity::Mass(row, column) => {
                    changes = mirrored(row, column);
                    add_change(&changes, &velocity, &mut inertia);
                    if gives_velocity {
                        dp.clone_from(&inertia);
                    }
                }
                _ => {}
            }
            let rest: Vec<f64> = dp.iter().zip(&inertia).map(|(dp, inertia)| dp - inertia).collect();
            velocity_slopes.extend(velocity_of(&rest));
            position.extend(dq);
            momentum.extend(dp);
            mass_changes.push(changes);
            pasts.push(past);
        }
        // With a past the motion begins at rest at its first position.
        let mut base_slopes = position.clone();
        if initial.past.is_some() {
            [&mut velocity, &mut velocity_slopes].into_iter().for_each(|velocity| velocity.fill(0.0));
            for (past, slope) in pasts.iter().zip(base_slopes.chunks_mut(size)) {
                match past {
                    Some(past) => slope.copy_from_slice(past.first()),
                    None => slope.fill(0.0),
                }
            }
        }
        Self { position, momentum, mass_changes, pasts, base_slopes, velocity, velocity_slopes }
    }
}

/// G V at the nodes of a scheme, and δG V for the parameters in G, with their numbers.
pub(super) fn gyroscopic(
    scenario: &Scenario,
    parameters: &[Parameter],
    scheme: &AnyScheme<f64>,
) -> (Option<Turning>, Vec<(usize, Turning)>) {
    let Sampling::Nodes(fractions) = Scheme::<f64, AnySpace>::sampling(scheme) else {
        return (None, Vec::new());
    };
    let size = scenario.coordinates();
    let at_nodes = |skew| Gyroscopic::new(skew, fractions, scenario.time.step);
    let changes = parameters.iter().enumerate().filter_map(|(index, Parameter { what, .. })| match *what {
        Quantity::Gyroscopic(row, column) => {
            let entries = [(row, column, 1.0), (column, row, -1.0)];
            Some((index, at_nodes(Matrix::of_entries(size, entries.into_iter()))))
        }
        _ => None,
    });
    (super::gyroscopic(scenario, &AnySpace::dense(size)).map(at_nodes), changes.collect())
}

impl Term {
    /// The memories of the motion itself.
    fn motions_mut(&mut self) -> impl Iterator<Item = &mut Remembered> {
        self.value.iter_mut().chain(self.kernels.iter_mut().map(|(_, motion)| motion))
    }

    fn new(
        scenario: &Scenario,
        (index, nodes): (usize, usize),
        parameters: &[Parameter],
        tables: &Tables,
    ) -> Result<Self, InputError> {
        let term = &scenario.system.damping[index];
        let size = scenario.coordinates();
        let refused = |error| super::refused_memory(scenario, index, error);
        let derivative = match term.derivative {
            scenario::Derivative::Caputo => Derivative::Caputo,
            scenario::Derivative::RiemannLiouville => Derivative::RiemannLiouville,
        };
        let request = |motions: usize| MemoryRequest {
            motions,
            ..super::memory_request(scenario, (size * motions, nodes), term)
        };
        let on_memory = |motions: usize, kernel: Kernel, memory: HostMemory<f64>| {
            DampedMotion::new(&AnySpace::dense(size * motions), &[kernel], derivative, memory).map_err(
                |error| {
                    let problem = Problem::Precision { reason: error.to_string() };
                    scenario.error_at(&format!("system.damping[{index}]"), problem)
                },
            )
        };
        let of_kernel = |motions: usize| {
            let request = request(motions);
            let kernel = request.kernel().map_err(|error| refused(error.into()))?;
            let memory = request.build_with(tables).map_err(refused)?;
            on_memory(motions, kernel, memory)
        };
        let changes: Vec<_> = (parameters.iter().enumerate())
            .filter_map(|(parameter, Parameter { what, .. })| match what {
                Quantity::Coefficient(own, change) if *own == index => Some((parameter, change.clone())),
                _ => None,
            })
            .collect();
        let mut kernels = Vec::new();
        for (parameter, Parameter { what, .. }) in parameters.iter().enumerate() {
            let Some(by) = what.kernel(index) else { continue };
            let (kernel, memory) = derivative_memory(scenario, &request(1), by).map_err(refused)?;
            kernels.push((parameter, on_memory(1, kernel, memory)?));
        }
        let value = if changes.is_empty() { None } else { Some(of_kernel(1)?) };
        let tangent = of_kernel(parameters.len())?;
        Ok(Self { rho: matrix(&term.coefficient), tangent, value, changes, kernels })
    }
}

/// The memory of ∂D/∂θ, with its kernel, for which the same part of the motion is subtracted as for D.
pub(super) fn derivative_memory(
    scenario: &Scenario,
    request: &MemoryRequest<'_>,
    by: &TransferDerivative,
) -> Result<(Kernel, HostMemory<f64>), EngineError> {
    let weights = |on_differences, count| slope_weights(scenario, by, on_differences, count);
    if let Some(staged) = scenario.convolution.family.staged() {
        // The memory's weights are not checked; with an exponent of 0 nothing would be subtracted from the
        // motion.
        let kernel = Kernel::given(request.transfer.growth().max(f64::MIN_POSITIVE))?;
        return Ok((kernel, request.build_of_weights(staged.stages(), &weights)?));
    }
    let first = weights(false, 2)?;
    let kernel = Kernel::weights(request.transfer.growth(), [first[0], first[1]], scenario.time.step)?;
    Ok((kernel, request.build_of_weights(1, &weights)?))
}

/// The derivatives of a kernel's weights by a parameter, plane by plane, on differences or on values.
pub(super) fn slope_weights(
    scenario: &Scenario,
    by: &TransferDerivative,
    on_differences: bool,
    count: usize,
) -> Result<Vec<f64>, ParameterError> {
    let (family, step) = (scenario.convolution.family, scenario.time.step);
    if let Some(staged) = family.staged() {
        return with_staged_method!(staged, method => runge_kutta_derivative(&method, by, step, on_differences, count))?;
    }
    let rule = family.multistep()?.ok_or(ParameterError {
        parameter: "convolution.family",
        value: f64::NAN,
        allowed: "a multistep rule where a parameter of a kernel is differentiated by",
    })?;
    derivative_weights(by, rule, step, on_differences, count)
}

/// Largest number of unknowns of a step for which full matrices are solved.
pub(super) const MOST_UNKNOWNS: usize = 600;

/// The solver of the motion itself: a sparse factor if it has one, for `transposed` equations if their matrix
/// is symmetric.
pub(super) fn solver(scenario: &Scenario, transposed: bool) -> Result<Solver, InputError> {
    let unknowns_of_one = scenario.scheme_descriptor().unknowns;
    if (!transposed || unknowns_of_one == 1)
        && let Some(space) = sparse_space(scenario, SolverChoice::default())?
    {
        return Ok(Solver::Sparse { equations: Box::new(space.equations(1)), kept: None });
    }
    let unknowns = scenario.coordinates().saturating_mul(unknowns_of_one);
    if unknowns > MOST_UNKNOWNS {
        let with = if transposed { "a gradient" } else { "`[sensitivity]`" }.to_owned();
        let allowed = format!(
            "up to {MOST_UNKNOWNS} unknowns a step, degree times coordinates, where a step has no sparse factor; here there \
             are {unknowns}"
        );
        return Err(scenario.error_at("system.mass", Problem::Incompatible { with, allowed }));
    }
    Ok(Solver::Dense(None))
}

/// Refuses constants of forces with exact moments, whose derivatives are not supported.
pub(super) fn refuse_rough(scenario: &Scenario, parameters: &[Parameter]) -> Result<(), InputError> {
    let is_rough = RoughForces::of(scenario).is_some();
    for (index, Parameter { what, .. }) in parameters.iter().enumerate() {
        let Quantity::Named(named) = what else { continue };
        if is_rough && (named.force.is_some() || !named.loads.is_empty()) {
            let allowed = "constants of forces that are smooth in time, or `system.force_quadrature` = \"nodes\": exact moments \
                of forces that jump, have kinks or roots, are narrow or sampled are not differentiated";
            let problem = Problem::OutOfRange { allowed: allowed.to_owned() };
            return Err(scenario.error_at(&format!("sensitivity.parameters[{index}]"), problem));
        }
    }
    Ok(())
}

/// Pushes a sample of the motion and one of its derivatives, with their increments, to the memories of all
/// terms.
fn push(
    terms: &mut [Term],
    (motion, told): (&Sample<'_, f64>, &[f64]),
    (derivatives, own_told): (&Sample<'_, f64>, &[f64]),
    scratch: &mut [f64],
) -> Result<(), MemoryError> {
    for term in terms {
        term.tangent.push(derivatives, own_told, scratch)?;
        for of_motion in term.motions_mut() {
            of_motion.push(motion, told, scratch)?;
        }
    }
    Ok(())
}

fn said(error: MemoryError) -> String {
    error.to_string()
}

/// Writes the known part of the derivatives of a motion before its sample, for the given numbers of nodes and
/// coordinates, node after node.
fn known(
    motion: &mut Remembered,
    sample: &Sample<'_, f64>,
    (nodes, coordinates): (usize, usize),
    terms: &mut Vec<f64>,
    known: &mut Vec<f64>,
) -> Result<(), MemoryError> {
    known.clear();
    known.resize(nodes * coordinates, 0.0);
    if nodes == 1 {
        motion.memory_terms(sample, known)?;
        motion.complete(0, sample, known);
        return Ok(());
    }
    terms.clear();
    terms.resize(nodes * coordinates, 0.0);
    motion.memory_terms(sample, terms)?;
    for (node, known) in known.chunks_mut(coordinates).enumerate() {
        motion.complete_node((0, node), sample, terms, known);
    }
    Ok(())
}

/// Writes the complete derivatives of a motion with a known sample.
fn whole(
    motion: &mut Remembered,
    sample: &Sample<'_, f64>,
    increments: &[f64],
    (nodes, coordinates): (usize, usize),
    terms: &mut Vec<f64>,
    derivative: &mut Vec<f64>,
) -> Result<(), MemoryError> {
    known(motion, sample, (nodes, coordinates), terms, derivative)?;
    for (i, place) in derivative.chunks_mut(coordinates).enumerate() {
        for (j, increment) in increments.chunks(coordinates).enumerate() {
            add(place, motion.leading(0, nodes, i, j), increment);
        }
    }
    Ok(())
}

/// Adds Σ_m ρ_m Σ_j W_ij e_j of node i, for all parameters.
fn add_leading(terms: &[Term], (i, nodes): (usize, usize), increments: &[f64], n: usize, out: &mut [f64]) {
    let c = out.len();
    for term in terms {
        for (j, increment) in increments.chunks(c).enumerate() {
            let weight = term.tangent.leading(0, nodes, i, j);
            if weight != 0.0 {
                let pairs = out.chunks_mut(n).zip(increment.chunks(n));
                pairs.for_each(|(out, increment)| term.rho.multiply_add(weight, increment, out));
            }
        }
    }
}

pub(super) fn add(out: &mut [f64], factor: f64, vector: &[f64]) {
    out.iter_mut().zip(vector).for_each(|(out, x)| *out += factor * x);
}

fn mirrored(row: usize, column: usize) -> Vec<(usize, usize)> {
    if row == column { vec![(row, row)] } else { vec![(row, column), (column, row)] }
}

pub(super) fn add_change(change: &[(usize, usize)], vector: &[f64], out: &mut [f64]) {
    change.iter().for_each(|&(row, column)| out[row] += vector[column]);
}

/// q_{k+1} − X_{k,i}.
fn leave_behind(behind: &mut [f64], rise: &[f64], stages: &[f64]) {
    for (behind, stage) in behind.chunks_mut(rise.len()).zip(stages.chunks(rise.len())) {
        behind.iter_mut().zip(rise.iter().zip(stage)).for_each(|(behind, (rise, e))| *behind = rise - e);
    }
}
