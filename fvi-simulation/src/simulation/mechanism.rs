//! Simulation of a mechanism: any Lagrangian, constraints, and dampers along elongations.

use super::control::Drive;
use super::function_jumps::FunctionJumps;
use super::mechanism_multipliers::multipliers;
use super::passage::Passages;
use super::piece::{Piece, WithinStep};
use super::step_batch::StepBatch;
use super::turns::Turns;
use super::{GridState, Stepper, in_double};
use crate::model::{Mechanism, Switched, coefficient_of, vector};
use fvi_core::{
    DamperRow, GaussLobatto, Instant, Lagrangian, MechanismError, MechanismIntegrator, RelaxationTable,
    Relaxing, Second, StateError, StateReader, StateWriter, Stateful, StepError, max_or_nan, min_or_nan,
};
use fvi_fft::dense;
use fvi_fft::exponentials::relaxation_table::{relaxation_table, relaxation_table_derivative};
use fvi_fft::memory::{Engine, EngineError, reach_over};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::transfer::derivative::TransferDerivative;
use fvi_scenario::language::expression::Elementary;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Damping, ReportedMomentum, Scenario, Scheme, SymmetricMatrix};
use nalgebra::{DMatrix, DVector};

/// Largest number of unknowns of a step, whose matrix is full.
const MOST_UNKNOWNS: usize = 3000;

/// Number of points ahead of a motion at which elongations are looked at after a failed step.
const MOST_LOOKS: u32 = 16;

/// Relative error of a kernel's relaxations.
const TOLERANCE: f64 = 1e-13;

/// Least number of steps, in the mean length of those of the run, that a table of relaxations serves on other
/// than equal steps.
const LEAST_STEPS: f64 = 1e3;

pub(super) type Element<T> = Relaxing<T, Vec<T>, Vec<T>>;
pub(super) type Row<T> = DamperRow<Element<T>, Vec<Element<T>>>;

/// The integrator of a mechanism.
pub(super) type Integrator<T> = MechanismIntegrator<T, Mechanism<T>, Row<T>, Vec<T>, Vec<usize>>;

/// The mechanism of a scenario in one precision.
pub(super) struct TypedMechanism<T: Elementary> {
    integrator: Integrator<T>,
    /// The force that is held over the step to the present grid point; at the start that of the first step.
    input: Vec<T>,
    /// The momentum that is shown: with the excess of the dampers' impulse, or that of the scheme.
    momentum: Vec<T>,
    is_own_momentum: bool,
    /// The last two steps, the later one first, if states inside them are needed.
    pieces: Option<[Piece<T>; 2]>,
    terms: usize,
    pulls: Option<Pulls>,
    passages: Passages<T>,
    /// The keys of the elongations.
    along: Vec<String>,
    turns: Option<Turns<T>>,
    /// Position, velocity and time before the last step.
    before: (Vec<T>, Vec<T>, f64),
}

impl<T: Elementary> TypedMechanism<T> {
    /// The mechanism at its start.
    ///
    /// # Errors
    /// If it cannot begin there, a kernel has no relaxations, or there are too many unknowns.
    pub(super) fn new(scenario: &Scenario) -> Result<Self, InputError> {
        let mut integrator = integrator::<T>(scenario)?;
        let zeros = || vec![T::zero(); scenario.coordinates()];
        let first_input = scenario.input_over(0);
        let start = integrator.position().to_vec();
        let passages = Passages::new(integrator.system_mut(), &start);
        let mut made = Self {
            integrator,
            input: first_input.iter().map(|&force| T::of(force)).collect(),
            momentum: zeros(),
            is_own_momentum: scenario.output.momentum != ReportedMomentum::Mean,
            pieces: (scenario.is_looked_into() || FunctionJumps::of(scenario).is_some())
                .then(<[Piece<T>; 2]>::default),
            terms: scenario.system.damping.len(),
            pulls: (!scenario.system.constraints.is_empty()).then(|| Pulls::new(scenario)).transpose()?,
            passages,
            along: keys_of_elongations(scenario),
            turns: (scenario.scheme == Scheme::Energy).then(Turns::default),
            before: (Vec::new(), Vec::new(), scenario.time.start),
        };
        made.take_momentum();
        Ok(made)
    }

    fn take_momentum(&mut self) {
        match self.is_own_momentum {
            true => self.momentum.copy_from_slice(self.integrator.momentum()),
            // Without a projection it is that of the scheme.
            false => {
                self.integrator.write_momentum(&mut self.momentum);
            }
        }
    }

    /// Stores the beginning of a step, at this time, and its input.
    fn prepare(&mut self, input: &[f64], begin: f64) {
        self.input.clear();
        self.input.extend(input.iter().map(|&force| T::of(force)));
        let (position, velocity, time) = &mut self.before;
        self.integrator.position().clone_into(position);
        self.integrator.velocity().clone_into(velocity);
        *time = begin;
        if let Some(pieces) = &mut self.pieces {
            pieces.swap(0, 1);
            pieces[0].begin(begin, self.integrator.position(), &self.momentum);
        }
    }

    /// Stores the end of a step of this length, at this time.
    fn finish(&mut self, made: Result<u32, StepError>, (length, end): (T, f64)) -> Result<u32, StepError> {
        let corrections = made?;
        if let (Some(pulls), Some(_)) = (&mut self.pulls, &self.pieces) {
            pulls.at_nodes.clear();
            pulls.at_nodes.extend(in_double(self.integrator.tensions_at_nodes()));
        }
        self.follow(length, end);
        if let Some([piece, _]) = &mut self.pieces {
            piece.end(end, length, self.integrator.solution());
        }
        self.take_momentum();
        Ok(corrections)
    }

    /// Looks at the last step.
    fn follow(&mut self, length: T, end: f64) {
        if self.passages.are_idle() && self.turns.is_none() {
            return;
        }
        let (position, velocity, from) = &self.before;
        let rule = *self.integrator.rule();
        let moves = self.integrator.solution().to_vec();
        let last = self.integrator.position().to_vec();
        let at = |fraction: f64| {
            if fraction == 1.0 {
                return last.clone();
            }
            let mut place = position.clone();
            for (stage, rates) in moves.chunks_exact(position.len().max(1)).enumerate() {
                let moved = length * rule.integral(stage, fraction);
                place.iter_mut().zip(rates).for_each(|(place, &rate)| *place += moved * rate);
            }
            place
        };
        self.passages.take(self.integrator.system_mut(), &at, (*from, end - from));
        if let Some(turns) = &mut self.turns {
            let reached = self.integrator.velocity().to_vec();
            turns.take(self.integrator.system_mut(), &last, [velocity, &reached]);
        }
    }

    /// Position and velocity at a fraction of a step.
    fn inside(&self, piece: &Piece<T>, fraction: f64) -> [Vec<T>; 2] {
        let (rule, count) = (self.integrator.rule(), piece.position.len());
        let length = piece.length;
        let (mut position, mut velocity) = (piece.position.clone(), vec![T::zero(); count]);
        for (stage, rates) in piece.solution.chunks_exact(count.max(1)).enumerate() {
            let (moved, share) = (length * rule.integral(stage, fraction), rule.value(stage, fraction));
            for (index, &rate) in rates.iter().enumerate() {
                position[index] += moved * rate;
                velocity[index] += share * rate;
            }
        }
        [position, velocity]
    }

    /// The step that a time lies in, and what follows it.
    fn piece_at(&self, time: f64) -> Option<(&Piece<T>, Option<&Piece<T>>)> {
        let [last, before] = self.pieces.as_ref()?;
        if last.solution.is_empty() {
            return None;
        }
        let is_last = time > last.from || before.solution.is_empty();
        Some(if is_last { (last, None) } else { (before, Some(last)) })
    }
}

/// What multipliers follow from beside the state, of a mechanism with constraints.
struct Pulls {
    system: Mechanism<f64>,
    /// The dampers' forces at the nodes of the last step.
    at_nodes: Vec<f64>,
    /// For each elongation, whether its damper pulls at once on a velocity: those of orders below 1 do not.
    at_once: Vec<bool>,
}

impl Pulls {
    fn new(scenario: &Scenario) -> Result<Self, InputError> {
        let system = Mechanism::new(scenario).map_err(|error| super::bad_mass(scenario, &error))?;
        let of_term = |term: &Damping| {
            let count = coefficient_of::<f64>(scenario, term).len().isqrt();
            vec![term.transfer.growth() >= 1.0; count]
        };
        let at_once = scenario.system.damping.iter().flat_map(of_term).collect();
        Ok(Self { system, at_nodes: Vec::new(), at_once })
    }
}

/// The integrator of a scenario at its start.
pub(super) fn integrator<T: Elementary>(scenario: &Scenario) -> Result<Integrator<T>, InputError> {
    let ConvolutionFamily::Gauss { stages } = scenario.convolution.family else {
        let reason = "a mechanism has Gauss weights".to_owned();
        return Err(scenario.error_at("convolution.family", Problem::Unusable { reason }));
    };
    let rule = GaussLobatto::<T>::new(stages).map_err(|error| {
        let allowed = format!("{} ({} given)", error.allowed, error.parameter);
        scenario.error_at("scheme.degree", Problem::OutOfRange { allowed })
    })?;
    check_size(scenario, stages)?;
    let mut system = Mechanism::<T>::new(scenario).map_err(|error| super::bad_mass(scenario, &error))?;
    let position: Vec<T> = vector(&scenario.initial.position);
    if let Some(elongation) = system.first_not_differentiable(&position) {
        return Err(not_differentiable(scenario, elongation));
    }
    let velocity = match is_singular(scenario) {
        // Where the constraints do not determine it either, the integrator refuses the mass or them.
        true => velocity_on_constraints(scenario).or_else(|| Some(vec![0.0; scenario.coordinates()])),
        false => scenario.initial_velocity(),
    };
    let velocity = velocity.ok_or_else(|| {
        let reason =
            "the mass at the start is singular for velocities that the constraints allow: its inverse gives the velocity";
        scenario.error_at_first(
            &["system.kinetic", "system.mass"],
            Problem::Unusable { reason: reason.to_owned() },
        )
    })?;
    let dampers = dampers(scenario, &rule)?;
    let shape = [system.coordinates(), system.constraints(), system.elongations()];
    let conserves = scenario.scheme == Scheme::Energy;
    let numbers = match conserves {
        true => Integrator::<T>::conserving_numbers(shape),
        false => Integrator::<T>::numbers(stages, shape),
    };
    let indices = Integrator::<T>::unknowns(stages, shape) + usize::from(conserves);
    let buffers = (vec![T::zero(); numbers], vec![0; indices]);
    let parts = (system, dampers);
    let time = (T::of(scenario.time.step), T::of(scenario.time.start));
    let velocity = vector::<T>(&velocity);
    let (state, project) = ((&position[..], &velocity[..]), scenario.initial.project);
    let made = match conserves {
        true => Integrator::conserving(parts, time, state, project, buffers),
        false => Integrator::new(rule, parts, time, state, project, buffers),
    };
    let mut integrator = made.map_err(|error| refused(scenario, &error))?;
    integrator.system_mut().balance(&position, &velocity);
    Ok(integrator)
}

/// The slope of W = G v at the start; `None` where the scenario cannot begin.
fn start_slope(scenario: &Scenario) -> Option<Vec<f64>> {
    let mut integrator = integrator::<f64>(scenario).ok()?;
    let input = scenario.input_over(0).to_vec();
    integrator.step(&input).ok()?;
    Some(integrator.slope().to_vec())
}

/// The derivative of the slope of W at the start by a number of the scenario, from the slopes at values a
/// little beside it: of what momenta are corrected by, few digits matter.
pub(super) fn start_slope_derivative(scenario: &Scenario, path: &str) -> Result<Vec<f64>, InputError> {
    let unknown = || {
        let reason = "the accelerations at the start are not known for values beside it".to_owned();
        scenario.error_at(path, Problem::Unusable { reason })
    };
    let value = scenario.number(path)?.ok_or_else(unknown)?;
    let change = if value == 0.0 { 1e-5 } else { 1e-5 * value.abs() };
    let at = |value: f64| {
        let changed = scenario.with_number(path, value).ok()?;
        Some((value, start_slope(&changed)?))
    };
    // At the end of a range of values one side is enough.
    let (below, above) = (at(value - change), at(value + change));
    let (below, above) = match (below, above) {
        (Some(below), Some(above)) => (below, above),
        (Some(below), None) => (below, at(value).ok_or_else(unknown)?),
        (None, Some(above)) => (at(value).ok_or_else(unknown)?, above),
        (None, None) => return Err(unknown()),
    };
    let length = above.0 - below.0;
    Ok(above.1.iter().zip(&below.1).map(|(above, below)| (above - below) / length).collect())
}

/// True for a kinetic energy in words whose mass at the start has no inverse, to rounding.
fn is_singular(scenario: &Scenario) -> bool {
    let (Some(_), SymmetricMatrix::Dense(mass)) = (&scenario.system.kinetic, &scenario.system.mass) else {
        return false;
    };
    let values = mass.clone().symmetric_eigenvalues();
    let size = values.iter().fold(0.0, |most, value| max_or_nan(most, value.abs()));
    let least = values.iter().fold(f64::INFINITY, |least, value| min_or_nan(least, value.abs()));
    least <= 1e-12 * size
}

/// The velocity at the start, where the mass is regular for what the constraints allow.
fn velocity_on_constraints(scenario: &Scenario) -> Option<Vec<f64>> {
    let mut system = Mechanism::<f64>::new(scenario).ok()?;
    velocity_of(&mut system, &scenario.initial.position, &scenario.initial.momentum)
}

/// The velocity with M(q)v + Cᵀλ = p − a(q) and C v = 0, a(q) = L_v(q, 0); `None` if there is none.
pub(super) fn velocity_of(
    system: &mut Mechanism<f64>,
    position: &[f64],
    momentum: &[f64],
) -> Option<Vec<f64>> {
    let (n, m) = (system.coordinates(), system.constraints());
    let (still, now) = (vec![0.0; n], Instant::in_step(0.0, 0.5, 0.0));
    let [mut mass, mut coupling, mut stiffness, mut resistance] = [(); 4].map(|()| vec![0.0; n * n]);
    let matrices = Second {
        mass: &mut mass,
        coupling: &mut coupling,
        stiffness: &mut stiffness,
        resistance: &mut resistance,
    };
    system.second(now, position, &still, matrices);
    let (mut values, mut jacobian) = (vec![0.0; m], vec![0.0; m * n]);
    system.constrain(position, &mut values, &mut jacobian);
    let jacobian = DMatrix::from_row_slice(m, n, &jacobian);
    let mut saddle = DMatrix::zeros(n + m, n + m);
    saddle.view_mut((0, 0), (n, n)).copy_from(&DMatrix::from_row_slice(n, n, &mass));
    saddle.view_mut((n, 0), (m, n)).copy_from(&jacobian);
    saddle.view_mut((0, n), (n, m)).copy_from(&jacobian.transpose());
    let (mut linear, mut force) = (still.clone(), still.clone());
    system.first(now, position, &still, &mut linear, &mut force);
    let mut moving = DVector::zeros(n + m);
    for (place, (p, a)) in moving.iter_mut().zip(momentum.iter().zip(&linear)) {
        *place = p - a;
    }
    let solved = dense::inverse(saddle)? * moving;
    Some(solved.iter().take(n).copied().collect())
}

/// The velocities of a mechanism at positions with these momenta, N numbers a row: those with
/// M(q)v + Cᵀλ = p − a(q) and C v = 0; NaN where there are none.
///
/// # Errors
/// If the scenario is no mechanism that can be made.
pub fn velocities(scenario: &Scenario, positions: &[f64], momenta: &[f64]) -> Result<Vec<f64>, InputError> {
    let mut system = Mechanism::<f64>::new(scenario).map_err(|error| super::bad_mass(scenario, &error))?;
    let n = system.coordinates().max(1);
    let rows = positions.chunks_exact(n).zip(momenta.chunks_exact(n));
    let of_row = |(position, momentum): (&[f64], &[f64])| {
        velocity_of(&mut system, position, momentum).unwrap_or_else(|| vec![f64::NAN; n])
    };
    Ok(rows.flat_map(of_row).collect())
}

/// Refuses mechanisms whose full matrices would be too large.
fn check_size(scenario: &Scenario, stages: usize) -> Result<(), InputError> {
    let unknowns = stages * (scenario.coordinates() + scenario.system.constraints.len());
    if unknowns <= MOST_UNKNOWNS {
        return Ok(());
    }
    let reason = format!(
        "a step of this mechanism has {unknowns} unknowns and a full matrix; at most {MOST_UNKNOWNS} are taken"
    );
    Err(scenario.error_at("system", Problem::Unusable { reason }))
}

/// The error for an elongation without a gradient at the start.
fn not_differentiable(scenario: &Scenario, elongation: usize) -> InputError {
    let reason = format!(
        "elongation {elongation} (from 0) has no derivative at the initial position {:?}",
        scenario.initial.position
    );
    let keys = keys_of_elongations(scenario);
    let path = keys.get(elongation).map_or("system.damping", String::as_str);
    scenario.error_at(path, Problem::Unusable { reason })
}

/// The key of each elongation.
fn keys_of_elongations(scenario: &Scenario) -> Vec<String> {
    let of_term = |(index, term): (usize, &Damping)| {
        let count = coefficient_of::<f64>(scenario, term).len().isqrt();
        vec![format!("system.damping[{index}].along"); count]
    };
    scenario.system.damping.iter().enumerate().flat_map(of_term).collect()
}

/// The dampers of a scenario, in the order of their elongations.
pub(super) fn dampers<T: Elementary>(
    scenario: &Scenario,
    rule: &GaussLobatto<T>,
) -> Result<Row<T>, InputError> {
    let of_term = |(index, term): (usize, &Damping)| {
        damper(scenario, rule, index, (None, coefficient_of::<T>(scenario, term)))
    };
    let row = scenario.system.damping.iter().enumerate().map(of_term).collect::<Result<Vec<_>, _>>()?;
    Ok(DamperRow::new(row))
}

/// The damper of a term with a coefficient: of its kernel, or of the derivative of that.
pub(super) fn damper<T: Elementary>(
    scenario: &Scenario,
    rule: &GaussLobatto<T>,
    index: usize,
    (by, coefficient): (Option<&TransferDerivative>, Vec<T>),
) -> Result<Element<T>, InputError> {
    let time = &scenario.time;
    // A run on equal steps may be continued: its table reaches as far as those of engines for them.
    let samples = time.steps.saturating_add(1);
    let span = match &time.grid {
        None => reach_over(scenario.history.planned.unwrap_or(samples)) as f64 * time.step,
        Some(_) => (time.time(time.steps) - time.start).max(LEAST_STEPS * time.step),
    };
    let asked = scenario.history.horizon.map_or(span, |samples| samples as f64 * time.step);
    let horizon = libm::pow(10.0, libm::log10(span).ceil()).max(asked);
    if time.grid.is_none() && horizon < samples as f64 * time.step {
        let error = EngineError::TableEnds { reach: (horizon / time.step) as usize, samples };
        return Err(scenario.error_at("history.horizon", Problem::Unusable { reason: error.to_string() }));
    }
    let term = &scenario.system.damping[index];
    let table = table::<T>((term, by), time.step, horizon).map_err(|error| {
        let paths = ["order", "kernel"].map(|key| format!("system.damping[{index}].{key}"));
        let reason = match by {
            None => error.to_string(),
            Some(_) => format!("its derivative is no sum of relaxations: {error}"),
        };
        scenario.error_at_first(&[&paths[0], &paths[1]], Problem::Unusable { reason })
    })?;
    let count = coefficient.len().isqrt();
    let numbers = vec![T::zero(); Element::<T>::numbers(table.rates.len(), rule.stages(), count)];
    Relaxing::new(rule, table, coefficient, count, numbers).map_err(|error| {
        let path = format!("system.damping[{index}]");
        scenario.error_at(&path, Problem::Precision { reason: error.to_string() })
    })
}

/// The relaxations of a term's kernel; formulas may have lost a few digits to rounding.
fn table<T: Elementary>(
    (term, by): (&Damping, Option<&TransferDerivative>),
    step: f64,
    horizon: f64,
) -> Result<RelaxationTable<Vec<T>>, fvi_fft::exponentials::rate_table::RateTableError> {
    let transfer = term.transfer.clone().with_its_spring();
    let tolerance = TOLERANCE.max(0.01 * T::EPSILON.to_f64());
    let made = |loss: f64| match by {
        None => relaxation_table(&transfer, step, horizon, loss * tolerance),
        Some(by) => relaxation_table_derivative(&transfer, by, step, horizon, loss * tolerance),
    };
    let losses: &[f64] = if transfer.text().is_some() { &[10.0, 100.0] } else { &[] };
    let table = losses.iter().fold(made(1.0), |table, &loss| table.or_else(|_| made(loss)))?;
    let numbers = |numbers: Vec<f64>| numbers.into_iter().map(T::of).collect();
    Ok(RelaxationTable {
        is_inertial: table.is_inertial,
        rates: numbers(table.rates),
        coefficients: numbers(table.coefficients),
        shortest: table.shortest,
        horizon: table.horizon,
    })
}

fn refused(scenario: &Scenario, error: &MechanismError) -> InputError {
    let reason = match error {
        MechanismError::OffConstraint { .. } | MechanismError::LeavesConstraint { .. } => {
            match scenario.initial.project {
                true => format!(
                    "{error}: moving the start onto the constraints (`initial.project`) has not converged"
                ),
                false => format!("{error}; `initial.project = true` moves the start onto the constraints"),
            }
        }
        _ => error.to_string(),
    };
    let problem = Problem::Unusable { reason };
    match error {
        MechanismError::Parameter(_) => scenario.error_at("time.step", problem),
        MechanismError::LeavesConstraint { .. } => {
            scenario.error_at_first(&["initial.velocity", "initial.momentum", "initial"], problem)
        }
        MechanismError::Redundant { index }
        | MechanismError::Inconsistent { index, .. }
        | MechanismError::NotProjected { index, .. } => {
            scenario.error_at(&format!("system.constraints[{index}]"), problem)
        }
        MechanismError::SingularMass | MechanismError::IndefiniteMass { .. } => {
            scenario.error_at_first(&["system.kinetic", "system.mass"], problem)
        }
        _ => scenario.error_at("initial.position", problem),
    }
}

impl<T: Elementary> Stepper for TypedMechanism<T> {
    fn step(&mut self, input: &[f64]) -> Result<u32, StepError> {
        self.prepare(input, self.integrator.time().to_f64());
        let made = self.integrator.step(&self.input);
        self.finish(made, (self.integrator.step_size(), self.integrator.time().to_f64()))
    }

    fn step_over(&mut self, length: f64, end: f64, input: &[f64]) -> Result<u32, StepError> {
        self.prepare(input, self.integrator.time().to_f64());
        let made = self.integrator.step_over(T::of(length), T::of(end), &self.input);
        self.finish(made, (T::of(length), self.integrator.time().to_f64()))
    }

    fn advance(
        &mut self,
        scenario: &Scenario,
        steps: usize,
        batch: &mut StepBatch,
        drive: Option<&Drive>,
    ) -> Result<(), StepError> {
        let before = batch.first() - 1;
        for step in before..before + steps {
            let input = drive.map_or(scenario.input_over(step), |drive| &drive.held);
            // The grid's times have more digits than those of a run in single precision.
            let [begin, end] = [step, step + 1].map(|index| scenario.time.time(index));
            self.prepare(input, begin);
            let (made, length) = match &scenario.time.grid {
                None => (self.integrator.step(&self.input), self.integrator.step_size()),
                Some(_) => {
                    let length = T::of(end - begin);
                    (self.integrator.step_over(length, T::of(end), &self.input), length)
                }
            };
            let corrections = self.finish(made, (length, end))?;
            let energy = self.integrator.energy().to_f64();
            let time = self.integrator.time().to_f64();
            let momentum = in_double(&self.momentum);
            batch.push((time, energy), in_double(self.integrator.position()), momentum, corrections);
        }
        Ok(())
    }

    fn interpolate(&mut self, time: f64, state: &mut GridState) {
        if self.pieces.is_none() {
            return;
        }
        state.time = time;
        let Some((piece, next)) = self.piece_at(time) else { return self.read(state) };
        let (position, velocity, momentum) = match (piece.place(time), next) {
            (WithinStep::End, None) => return self.read(state),
            (WithinStep::End, Some(next)) => {
                let [_, velocity] = self.inside(next, 0.0);
                (next.position.clone(), velocity, Some(next.momentum.clone()))
            }
            (WithinStep::Inside(fraction), _) => {
                let [position, velocity] = self.inside(piece, fraction);
                (position, velocity, None)
            }
        };
        let mut own = vec![T::zero(); position.len()];
        let mut force = own.clone();
        let instant = Instant::in_step(T::of(time), T::of(0.5), T::zero());
        let system = self.integrator.system_mut();
        system.first(instant, &position, &velocity, &mut own, &mut force);
        let energy = system.energy(&position, &velocity).to_f64();
        let momentum = momentum.unwrap_or(own);
        for (numbers, found) in [(&mut state.position, &position), (&mut state.momentum, &momentum)] {
            numbers.iter_mut().zip(found).for_each(|(place, number)| *place = number.to_f64());
        }
        state.energy = energy;
    }

    fn position_at(&mut self, time: f64, position: &mut Vec<f64>) {
        position.clear();
        match self.piece_at(time).map(|(piece, next)| (piece, next, piece.place(time))) {
            Some((piece, _, WithinStep::Inside(fraction))) => {
                let [inside, _] = self.inside(piece, fraction);
                position.extend(in_double(&inside));
            }
            Some((_, Some(next), WithinStep::End)) => position.extend(in_double(&next.position)),
            _ => position.extend(in_double(self.integrator.position())),
        }
    }

    fn switches(&mut self) -> &mut dyn Switched {
        self.integrator.system_mut().model_mut()
    }

    fn read_without_energy(&mut self, state: &mut GridState) {
        state.time = self.integrator.time().to_f64();
        for (numbers, found) in
            [(&mut state.position, self.integrator.position()), (&mut state.momentum, &self.momentum[..])]
        {
            numbers.iter_mut().zip(found).for_each(|(place, number)| *place = number.to_f64());
        }
    }

    fn read(&mut self, state: &mut GridState) {
        self.read_without_energy(state);
        state.energy = self.integrator.energy().to_f64();
    }

    fn energies(&self, energies: &mut Vec<f64>) {
        energies.clear();
    }

    fn has_energies_of_rows_only(&self) -> bool {
        false
    }

    fn engines(&self) -> Vec<Engine> {
        vec![Engine::AnyStep; self.terms]
    }

    fn unresolved_since(&self) -> Option<f64> {
        None
    }

    fn shared(&self) -> Vec<Vec<usize>> {
        Vec::new()
    }

    fn overruns(&self) -> Option<usize> {
        None
    }

    fn memory_bytes(&self) -> usize {
        self.integrator.dampers().as_slice().iter().map(Stateful::state_bytes).sum()
    }

    fn write_multipliers(&mut self, multipliers: &mut [f64]) -> Result<(), String> {
        let Some(pulls) = &mut self.pulls else { return Ok(()) };
        let lacks = "the constraints do not determine their multipliers at its end";
        let is_at_start = self.integrator.steps() == 0;
        if !is_at_start && self.input.iter().all(|&force| force == T::zero()) {
            let mut found = vec![T::zero(); multipliers.len()];
            if !self.integrator.write_multipliers(&mut found) {
                return Err(lacks.to_owned());
            }
            let unit = self.integrator.system_mut().unit();
            found.iter_mut().for_each(|number| *number *= unit);
            multipliers.iter_mut().zip(in_double(&found)).for_each(|(place, number)| *place = number);
            return Ok(());
        }
        let double = |numbers: &[T]| in_double(numbers).collect::<Vec<_>>();
        let (position, velocity) = (double(self.integrator.position()), double(self.integrator.velocity()));
        let (mut tensions, input) = (double(self.integrator.tensions()), double(&self.input));
        if is_at_start {
            let gradual = tensions.iter_mut().zip(&pulls.at_once).filter(|(_, at_once)| !**at_once);
            gradual.for_each(|(tension, _)| *tension = 0.0);
        }
        let state = (self.integrator.time().to_f64(), &position[..], &velocity[..]);
        let found = self::multipliers(&mut pulls.system, state, [&tensions, &input]).ok_or(lacks)?;
        multipliers.copy_from_slice(&found);
        Ok(())
    }

    fn write_multipliers_at(&mut self, time: f64, multipliers: &mut [f64]) {
        let Some((piece, None)) = self.piece_at(time) else { return };
        let WithinStep::Inside(fraction) = piece.place(time) else { return };
        let [position, velocity] =
            self.inside(piece, fraction).map(|numbers| in_double(&numbers).collect::<Vec<_>>());
        let rule = *self.integrator.rule();
        let input: Vec<f64> = in_double(&self.input).collect();
        let Some(pulls) = &mut self.pulls else { return };
        let mut tensions = vec![0.0; pulls.at_once.len()];
        for (stage, forces) in pulls.at_nodes.chunks_exact(tensions.len().max(1)).enumerate() {
            let share = rule.value(stage, fraction).to_f64();
            tensions.iter_mut().zip(forces).for_each(|(sum, force)| *sum += share * force);
        }
        let state = (time, &position[..], &velocity[..]);
        match self::multipliers(&mut pulls.system, state, [&tensions, &input]) {
            Some(found) => multipliers.copy_from_slice(&found),
            None => multipliers.fill(f64::NAN),
        }
    }

    fn met(&mut self, error: &StepError, length: f64) -> Option<String> {
        if *error != StepError::NotFinite {
            return None;
        }
        // Ahead of the motion.
        let (position, velocity) = (self.integrator.position().to_vec(), self.integrator.velocity().to_vec());
        (0..=MOST_LOOKS).find_map(|look| {
            let ahead = T::of(length * f64::from(look) / f64::from(MOST_LOOKS));
            let place: Vec<T> = position.iter().zip(&velocity).map(|(&q, &v)| q + ahead * v).collect();
            let elongation = self.integrator.system_mut().first_not_differentiable(&place)?;
            let place: Vec<f64> = in_double(&place).collect();
            Some(format!(
                "`{}`: {error}: the elongation has no value or derivative where the step leads, as at q = {place:?}: choose an \
                 elongation that has one there, such as an angle by atan2",
                self.along[elongation]
            ))
        })
    }

    fn check(&self) -> Result<(), String> {
        let [passed, _] = self.passages.found();
        passed.map_or(Ok(()), |passed| {
            let place: Vec<f64> = in_double(self.integrator.position()).collect();
            Err(format!(
                "`{}`: the motion passes a point where the elongation has no derivative, at t = {:.6} on the way to q = {place:?}: \
                 choose an elongation that has one there, or a start from which the motion passes beside it",
                self.along[passed.elongation], passed.time
            ))
        })
    }

    fn notes(&self) -> Vec<String> {
        let [_, too_fast] = self.passages.found();
        let too_fast = too_fast.map(|passed| {
            format!(
                "{}: at t = {:.6} the elongation's derivative turns within a sixteenth of a step, which the nodes of the step do \
                 not see: what the damper does there is not followed; shorter steps follow it",
                self.along[passed.elongation], passed.time
            )
        });
        too_fast.into_iter().chain(self.turns.as_ref().and_then(Turns::note)).collect()
    }

    fn memory_energies(&self) -> Option<[f64; 2]> {
        let (work, stored) = (self.integrator.work().to_f64(), self.integrator.stored().to_f64());
        Some([stored, work - stored])
    }

    fn memory_work(&self) -> f64 {
        self.integrator.work().to_f64()
    }
}

impl<T: Elementary> Stateful for TypedMechanism<T> {
    fn state_bytes(&self) -> usize {
        self.integrator.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.integrator.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.integrator.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.integrator.restore(from)?;
        self.take_momentum();
        let position = self.integrator.position().to_vec();
        self.passages.begin(self.integrator.system_mut(), &position);
        Ok(())
    }
}
