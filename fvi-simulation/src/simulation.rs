//! Simulation of a scenario: the integrator behind an interface without type parameters.

#[doc(hidden)]
pub mod adaptive;
#[doc(hidden)]
pub mod adjoint;
mod breaks;
mod choice;
#[doc(hidden)]
pub mod closed_loop;
#[doc(hidden)]
pub mod columns;
#[doc(hidden)]
pub mod control;
mod crossings;
#[doc(hidden)]
pub mod energy_guard;
#[cfg(test)]
mod energy_scheme_tests;
mod error_budget;
pub mod events;
mod forces_of_time;
#[cfg(test)]
mod forces_of_time_tests;
#[cfg(test)]
mod forces_of_velocity_tests;
mod function_jumps;
mod given_weights;
mod gyroscopic;
mod massless;
#[cfg(test)]
mod massless_tests;
mod mechanism;
#[cfg(test)]
mod mechanism_accuracy_tests;
#[cfg(test)]
mod mechanism_limits_tests;
mod mechanism_multipliers;
#[cfg(test)]
mod mechanism_multipliers_tests;
#[cfg(test)]
mod mechanism_tests;
mod memory_energy;
mod momentum_offset;
#[doc(hidden)]
pub mod motion;
pub(crate) mod not_finite;
mod passage;
mod perturbed;
mod piece;
pub mod response;
#[doc(hidden)]
pub mod stability;
mod state_quantities;
pub mod step_batch;
mod step_control;
mod tangent;
mod turns;
mod velocity_kinks;

use crate::model::{
    AnyScheme, AnySpace, ChannelDamping, EnergyRoom, Matrix, Model, States, Switched, channels_of,
    follow_alike, term_on_memory, vector,
};
pub use choice::{Solver, SolverChoice};
use choice::{dense_warning, sparse_space};
use control::Drive;
use function_jumps::FunctionJumps;
use fvi_core::{
    Damping, Instant, Integrator, IntegratorBuilder, IntegratorError, MatrixError, Mechanics, Memory,
    MemoryError, Mismatch, Outcome, Real, Sample, Sampling, Scheme, StateError, StateReader, StateWriter,
    Stateful, StepError,
};
use fvi_fft::memory::Engine;
use fvi_fft::memory::{EngineError, HostMemory, MOST_SHARING, Memories, MemoryRequest, Tables};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_scenario::language::error::Cause;
use fvi_scenario::language::expression::Elementary;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{self, DampedAt, Feature, Past, ReportedMomentum, Scenario};
use gyroscopic::Gyroscopic;
use massless::Placed;
use mechanism::TypedMechanism;
pub use mechanism::velocities;
use momentum_offset::MomentumOffset;
use nalgebra::DMatrix;
use piece::{Piece, WithinStep};
use serde::Serialize;
#[doc(hidden)]
pub use state_quantities::{StateQuantities, velocities_need_all_momenta};
use step_batch::StepBatch;
use velocity_kinks::VelocityKinks;

/// The scalar type of a simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// Double precision.
    #[default]
    F64,
    /// Single precision, as on a microcontroller.
    F32,
}

impl Precision {
    /// Twice its unit of rounding.
    pub(crate) fn epsilon(self) -> f64 {
        match self {
            Self::F64 => f64::EPSILON,
            Self::F32 => f64::from(f32::EPSILON),
        }
    }
}

/// A simulation of a scenario, with any number of coordinates.
pub struct Simulation {
    stepper: Box<dyn Stepper>,
    engines: Vec<Engine>,
    shared: Vec<Vec<usize>>,
    precision: Precision,
    solver: Solver,
    warning: Option<String>,
}

/// Interface of simulations with any scalar type.
trait Stepper: Stateful {
    /// Begins anew with another initial state and another model, compiled already or not; false if it cannot.
    fn begin_anew(&mut self, _: &Scenario, _: Option<Model<f64>>) -> Result<bool, InputError> {
        Ok(false)
    }
    fn step(&mut self, input: &[f64]) -> Result<u32, StepError>;
    fn step_over(&mut self, length: f64, end: f64, input: &[f64]) -> Result<u32, StepError>;
    fn advance(
        &mut self,
        scenario: &Scenario,
        steps: usize,
        batch: &mut StepBatch,
        drive: Option<&Drive>,
    ) -> Result<(), StepError>;
    fn interpolate(&mut self, time: f64, state: &mut GridState);
    /// Writes the position at a time within the last two steps.
    fn position_at(&mut self, time: f64, position: &mut Vec<f64>);
    /// The jumps and kinks in the position as switches.
    fn switches(&mut self) -> &mut dyn Switched;
    /// Time, position and momentum.
    fn read_without_energy(&mut self, state: &mut GridState);
    /// Writes time, position, momentum and energy.
    fn read(&mut self, state: &mut GridState);
    /// Writes the energies of the motions under load cases, whose sum was read last.
    fn energies(&self, energies: &mut Vec<f64>);
    /// True if the steps of a grid compute the energy only where a row is written.
    fn has_energies_of_rows_only(&self) -> bool;
    fn engines(&self) -> Vec<Engine>;
    /// Time from which rough points of forces may have been overlooked.
    fn unresolved_since(&self) -> Option<f64>;
    /// The terms of each memory that serves several terms.
    fn shared(&self) -> Vec<Vec<usize>>;
    fn overruns(&self) -> Option<usize>;
    fn memory_bytes(&self) -> usize;
    /// Writes the multipliers of the constraints.
    fn write_multipliers(&mut self, _: &mut [f64]) -> Result<(), String> {
        Ok(())
    }
    /// Writes those at a time inside the last step.
    fn write_multipliers_at(&mut self, _: f64, _: &mut [f64]) {}
    /// Refuses the last step for what it passed.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
    /// What a failed step of about this length met, where more is known than its error says.
    fn met(&mut self, _: &StepError, _: f64) -> Option<String> {
        None
    }
    /// Warnings about the steps so far.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }
    /// The energies stored and dissipated by memories, where the simulation knows them.
    fn memory_energies(&self) -> Option<[f64; 2]> {
        None
    }
    /// Their sum, or 0 where it is not known.
    fn memory_work(&self) -> f64 {
        0.0
    }
}

/// The state at a grid point, in double precision whatever the precision of the run. With load cases position
/// and momentum are those of all motions, one after another, and the energy is their sum.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct GridState {
    /// t_k.
    pub time: f64,
    /// q_k.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub position: Vec<f64>,
    /// p_k, zero for coordinates without mass: if the fractional force acts at the main nodes, the mean of
    /// the momenta before and after its kick, or the one after, according to `output.momentum`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub momentum: Vec<f64>,
    /// ½ p_kᵀM⁻¹p_k + U(q_k) with this p_k.
    pub energy: f64,
    /// The numbers of the run's [`Columns`](columns::Columns).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub columns: Vec<f64>,
    /// ∂q_k/∂θ and ∂p_k/∂θ for each parameter of `[sensitivity]`, one after another.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sensitivities: Vec<f64>,
}

impl Simulation {
    /// The simulation at t = 0, after the checks that need the whole scenario.
    ///
    /// # Errors
    /// If settings of the scenario cannot be combined, or the step is too long to be stable.
    pub fn new(scenario: &Scenario, precision: Precision) -> Result<Self, InputError> {
        Self::with_solver(scenario, precision, SolverChoice::default())
    }

    /// As [`new`](Self::new), with the solver of the step's equations chosen by the caller.
    ///
    /// # Errors
    /// As [`new`](Self::new), and if the scheme cannot be combined with the solver.
    pub fn with_solver(
        scenario: &Scenario,
        precision: Precision,
        choice: SolverChoice,
    ) -> Result<Self, InputError> {
        Self::sharing(scenario, precision, choice, &Tables::default())
    }

    /// As [`with_solver`](Self::with_solver), with the tables of its memories shared with other simulations.
    ///
    /// # Errors
    /// As [`with_solver`](Self::with_solver).
    pub fn sharing(
        scenario: &Scenario,
        precision: Precision,
        choice: SolverChoice,
        tables: &Tables,
    ) -> Result<Self, InputError> {
        // Code may have changed what was read.
        scenario.check_combinations()?;
        check_forces(scenario)?;
        if scenario.is_mechanism() {
            return Self::of_mechanism(scenario, precision);
        }
        let (given, placed) = (scenario, massless::placed(scenario)?);
        let scenario = &*placed.scenario;
        let mut compiled = None;
        let space = match sparse_space(scenario, choice)? {
            Some(space) => {
                if choice::is_of_few(scenario, choice) && !stability::is_unconditional(scenario) {
                    check_stability(scenario)?;
                } else {
                    stability::check_large_step(scenario)?;
                }
                space
            }
            None => {
                compiled = checked_model(scenario)?.filter(|_| !placed.jumps);
                AnySpace::dense(scenario.coordinates())
            }
        };
        let solver = space.plan().map_or(Solver::Dense, |plan| Solver::Sparse {
            places: plan.places(),
            factor_bytes: plan.factor_bytes(),
        });
        let stepper: Box<dyn Stepper> = match precision {
            Precision::F64 => Box::new(TypedSimulation::<f64>::new(space, given, &placed, tables, compiled)?),
            Precision::F32 => Box::new(TypedSimulation::<f32>::new(space, given, &placed, tables, compiled)?),
        };
        let (engines, shared) = (stepper.engines(), stepper.shared());
        let warning = if solver == Solver::Dense { dense_warning(scenario) } else { None };
        Ok(Self { stepper, engines, shared, precision, solver, warning })
    }

    /// Begins anew with a scenario that differs from its own in the initial position and momentum and in
    /// parameters of expressions only, and whose features are known to go together: all steps have the bits
    /// of those of a new simulation. False where it has to be built anew, since more of it depends on these.
    ///
    /// # Errors
    /// As [`new`](Self::new); the simulation must begin anew before its next step.
    pub(crate) fn begin_anew(&mut self, scenario: &Scenario) -> Result<bool, InputError> {
        let depends = scenario.is_mechanism()
            || self.solver != Solver::Dense
            || scenario.initial.past.is_some()
            || !scenario.system.massless().is_empty();
        if depends {
            return Ok(false);
        }
        check_forces(scenario)?;
        let compiled = checked_model(scenario)?;
        self.stepper.begin_anew(scenario, compiled)
    }

    fn of_mechanism(scenario: &Scenario, precision: Precision) -> Result<Self, InputError> {
        let stepper: Box<dyn Stepper> = match precision {
            Precision::F64 => Box::new(TypedMechanism::<f64>::new(scenario)?),
            Precision::F32 => Box::new(TypedMechanism::<f32>::new(scenario)?),
        };
        let engines = stepper.engines();
        Ok(Self { stepper, engines, shared: Vec::new(), precision, solver: Solver::Dense, warning: None })
    }

    /// What a failed step of about this length met, where more is known than its error says.
    pub(crate) fn met(&mut self, error: &StepError, length: f64) -> Option<String> {
        self.stepper.met(error, length)
    }

    /// Writes the multipliers λ of the constraints at the present grid point.
    pub(crate) fn write_multipliers(&mut self, multipliers: &mut [f64]) -> Result<(), String> {
        self.stepper.write_multipliers(multipliers)
    }

    /// Writes those at a time inside the last step; not a number where they are not determined.
    pub(crate) fn write_multipliers_at(&mut self, time: f64, multipliers: &mut [f64]) {
        self.stepper.write_multipliers_at(time, multipliers);
    }

    /// The energies stored and dissipated by the dampers of a mechanism; `None` for other simulations.
    pub(crate) fn memory_energies(&self) -> Option<[f64; 2]> {
        self.stepper.memory_energies()
    }

    /// Their sum; 0 for other simulations.
    pub(crate) fn memory_work(&self) -> f64 {
        self.stepper.memory_work()
    }

    /// True if no motion near the start grows at the step of the scenario, according to the check of the
    /// step.
    ///
    /// # Errors
    /// If the check is not possible.
    pub fn is_predicted_stable(scenario: &Scenario) -> Result<bool, InputError> {
        if scenario.is_mechanism() {
            return Ok(true);
        }
        let mut scenario = massless::placed(scenario)?.scenario.into_owned();
        scenario.time.allow_unstable = false;
        match check_stability(&scenario) {
            Ok(_) => Ok(true),
            Err(error) if matches!(error.problem(), Problem::Unstable { .. }) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// One step with an input held over it (empty: none); returns the number of iterations of Newton's
    /// method.
    ///
    /// # Errors
    /// [`StepError`]; the simulation is unchanged.
    pub fn step(&mut self, input: &[f64]) -> Result<u32, StepError> {
        self.stepper.step(input)
    }

    /// One step of any length to the time `end`, on a grid with different steps.
    ///
    /// # Errors
    /// [`StepError`]; the simulation is unchanged.
    pub fn step_over(&mut self, length: f64, end: f64, input: &[f64]) -> Result<u32, StepError> {
        self.stepper.step_over(length, end, input)
    }

    /// Makes `steps` steps of the scenario's grid, and appends the states after them to the batch, which is
    /// empty and contains the number of steps made before. If an energy costs as much as a step, it is
    /// computed for rows that are written only, and the last one stands for the states after it. A `drive`,
    /// which includes the inputs of the scenario, replaces them.
    ///
    /// # Errors
    /// [`StepError`] of the step after the last one in the batch; the simulation is then as before that step.
    pub(crate) fn advance(
        &mut self,
        scenario: &Scenario,
        steps: usize,
        batch: &mut StepBatch,
        drive: Option<&Drive>,
    ) -> Result<(), StepError> {
        self.stepper.advance(scenario, steps, batch, drive)
    }

    /// Writes the state at a time within the last two steps into `state`, by the polynomial of the scheme;
    /// before the first step and after the last the present state.
    pub fn interpolate(&mut self, time: f64, state: &mut GridState) {
        self.stepper.interpolate(time, state);
    }

    /// Writes the position at a time, as [`interpolate`](Self::interpolate).
    pub(crate) fn position_at(&mut self, time: f64, position: &mut Vec<f64>) {
        self.stepper.position_at(time, position);
    }

    /// The jumps and kinks of the system in the position as switches; none if steps do not end at them.
    pub(crate) fn switches(&mut self) -> &mut dyn Switched {
        self.stepper.switches()
    }

    /// Writes the present state into `state`, whose vectors have one place for each coordinate.
    pub fn read(&mut self, state: &mut GridState) {
        self.stepper.read(state);
    }

    /// Writes the energies of the motions under load cases, whose sum was [`read`](Self::read) last; none
    /// without cases.
    pub fn read_energies(&self, energies: &mut Vec<f64>) {
        self.stepper.energies(energies);
    }

    /// Number of steps after multiples of which [`advance`](Self::advance) computes the energy; it also does
    /// at the end.
    pub(crate) fn energies_every(&self, scenario: &Scenario) -> usize {
        if self.stepper.has_energies_of_rows_only() { scenario.output.every } else { 1 }
    }

    /// Writes the present state without its energy into `state`, whose energy is unchanged.
    pub fn read_without_energy(&mut self, state: &mut GridState) {
        self.stepper.read_without_energy(state);
    }

    /// Solver of the equations of a step.
    pub fn solver(&self) -> Solver {
        self.solver
    }

    /// Warning about the solver: full matrices of many coordinates.
    pub fn warning(&self) -> Option<&str> {
        self.warning.as_deref()
    }

    /// The engine of each damping term.
    pub fn engines(&self) -> &[Engine] {
        &self.engines
    }

    /// The damping terms, by their indices from 0, of each memory that serves several.
    pub fn shared(&self) -> &[Vec<usize>] {
        &self.shared
    }

    /// Refuses the last step for what it passed.
    pub(crate) fn check(&self) -> Result<(), String> {
        self.stepper.check()
    }

    /// Warnings about the steps so far.
    pub(crate) fn notes(&self) -> Vec<String> {
        self.stepper.notes()
    }

    /// Time from which steps had more zeros or peaks of a force of time than are searched for.
    pub fn unresolved_since(&self) -> Option<f64> {
        self.stepper.unresolved_since()
    }

    /// Floating-point precision.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// Number of blocks that `real-time` memories completed late; `None` without such a memory.
    pub fn overruns(&self) -> Option<usize> {
        self.stepper.overruns()
    }

    /// Bytes of all memories.
    pub fn memory_bytes(&self) -> usize {
        self.stepper.memory_bytes()
    }

    /// The state: step, position, momentum, and the state of the memories.
    ///
    /// # Errors
    /// [`StateError`] if a memory cannot be saved.
    pub fn save(&self) -> Result<Vec<u8>, StateError> {
        let mut bytes = vec![0; self.stepper.state_bytes()];
        let mut writer = StateWriter::new(&mut bytes);
        self.stepper.save(&mut writer)?;
        let length = writer.written();
        bytes.truncate(length);
        Ok(bytes)
    }

    /// Restores a state that a simulation of the same scenario saved; the following steps have identical
    /// bits.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are no such state; the simulation must not be used then.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let mut reader = StateReader::new(bytes);
        self.stepper.restore(&mut reader)?;
        reader.finish()
    }
}

/// Refuses forces and weights that no simulation of a scenario can use.
fn check_forces(scenario: &Scenario) -> Result<(), InputError> {
    scenario.check_use(Feature::Motion)?;
    forces_of_time::check(scenario)?;
    given_weights::check(scenario)
}

/// Checks the step of a system in the dense space unless it is known to be stable; returns the system if it
/// was compiled for that.
fn checked_model(scenario: &Scenario) -> Result<Option<Model<f64>>, InputError> {
    // Eigenvalues of full matrices would take as long as hundreds of steps.
    let known = choice::are_several(scenario) && stability::is_unconditional(scenario);
    if known && scenario.system.gyroscopic.is_none() { Ok(None) } else { check_stability(scenario) }
}

/// Largest number of coordinates for which all motions are checked for growth, not the fastest only.
const ALL_MOTIONS: usize = 256;

/// Checks the step of a system in the dense space; returns the system if it was compiled for the check.
fn check_stability(scenario: &Scenario) -> Result<Option<Model<f64>>, InputError> {
    if scenario.system.gyroscopic.is_some() {
        return gyroscopic::check_step(scenario).map(|()| None);
    }
    if scenario.coordinates() > ALL_MOTIONS {
        return stability::check_large_step(scenario).map(|()| None);
    }
    let mut model = Model::<f64>::new(scenario).map_err(|error| bad_mass(scenario, &error))?;
    // A model that knows the velocity of its last evaluation is that of a new one only as a copy.
    let (stiffness, resistance) = match Mechanics::depends_on_velocity(&model) {
        true => linearised(scenario, &mut model.clone()),
        false => linearised(scenario, &mut model),
    };
    stability::check_step(scenario, (&stiffness, resistance.as_ref()))?;
    Ok(Some(model))
}

/// ∂²U/∂q² − ∂F/∂q and, if forces depend on the velocity, −∂F/∂v at the initial state in the middle of the
/// first step.
fn linearised(scenario: &Scenario, model: &mut Model<f64>) -> (DMatrix<f64>, Option<DMatrix<f64>>) {
    let size = scenario.coordinates();
    let instant = Instant::in_step(scenario.time.start, 0.5, scenario.time.step);
    let mut restoring = vec![0.0; size];
    let mut stiffness = model.stiffness();
    let position = &scenario.initial.position;
    let full = |matrix: &Matrix<f64>| {
        let mut dense = DMatrix::zeros(size, size);
        for (row, column, entry) in Matrix::entries(matrix) {
            dense[(row, column)] = entry;
        }
        dense
    };
    if !Mechanics::depends_on_velocity(&*model) {
        model.linearise(instant, position, &mut restoring, &mut stiffness);
        return (full(&stiffness), None);
    }
    let mut velocity = vec![0.0; size];
    model.velocity(&scenario.initial.momentum, &mut velocity);
    let mut resistance = model.stiffness();
    model.linearise_in_motion(instant, position, &velocity, &mut restoring, &mut stiffness);
    model.resistance(instant, position, &velocity, &mut resistance);
    (full(&stiffness), Some(full(&resistance)))
}

/// Fractions of a step at which `initial.past` has positions in addition to those at grid points; empty if
/// grid points suffice.
pub fn sample_fractions(scenario: &Scenario) -> Vec<f64> {
    let scheme = AnyScheme::<f64>::new(scenario);
    match scheme.as_ref().map(|scheme| Scheme::<f64, AnySpace>::sampling(scheme)) {
        Ok(Sampling::Nodes(fractions)) if fractions.len() > 1 => fractions.to_vec(),
        _ => Vec::new(),
    }
}

fn bad_mass(scenario: &Scenario, error: &MatrixError) -> InputError {
    scenario.error_at("system.mass", Problem::Precision { reason: error.to_string() })
}

/// The integrator of a scenario in one precision and space.
struct TypedSimulation<T: Elementary + Memories> {
    integrator: Integrator<T, AnySpace, Model<T>, AnyScheme<T>, DampingTerms<T>>,
    input: Vec<T>,
    /// True if the input of the last step was nonzero.
    pushed: bool,
    /// The reported momentum if it is not that of the state: the mean of the momenta before and after the
    /// last kick, or the momentum without the offset.
    reported: Option<Vec<T>>,
    offset: MomentumOffset<T>,
    /// The last two steps, the later one first, if states inside them are needed.
    pieces: Option<[Piece<T>; 2]>,
    energies: Energies,
    energy_room: EnergyRoom<T>,
    /// The last energy computed.
    energy: f64,
}

/// Schedule for the energies of states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Energies {
    /// For all states of a batch together.
    Together,
    /// After every step.
    EveryStep,
    /// After steps whose row is written.
    Rows,
}

/// A scalar of simulations.
trait Scalar: Elementary + Memories {
    /// The system of a scenario, compiled already in double precision or not.
    fn model(scenario: &Scenario, compiled: Option<Model<f64>>) -> Result<Model<Self>, MatrixError>;
}

impl Scalar for f64 {
    fn model(scenario: &Scenario, compiled: Option<Model<f64>>) -> Result<Model<f64>, MatrixError> {
        compiled.map_or_else(|| Model::new(scenario), Ok)
    }
}

impl Scalar for f32 {
    fn model(scenario: &Scenario, _: Option<Model<f64>>) -> Result<Model<f32>, MatrixError> {
        Model::new(scenario)
    }
}

impl<T: Scalar> TypedSimulation<T> {
    /// Builds the integrator from system, compiled already or not, scheme and memories, which are at rest at
    /// the position of the scenario, and lets it jump to the one `placed`.
    fn new(
        space: AnySpace,
        scenario: &Scenario,
        placed: &Placed<'_>,
        tables: &Tables,
        compiled: Option<Model<f64>>,
    ) -> Result<Self, InputError> {
        let scheme = AnyScheme::new(scenario).map_err(|error| {
            let allowed = format!("{} ({} given)", error.allowed, error.parameter);
            scenario.error_at("scheme", Problem::OutOfRange { allowed })
        })?;
        let scheme = scheme.with_massless(placed.rows.clone());
        let nodes = scheme.sampling().nodes();
        let mut damping = damping_terms(scenario, &space, nodes, tables)?;
        let system = T::model(scenario, compiled).map_err(|error| bad_mass(scenario, &error))?;
        // With a past the motion begins at rest at its first position.
        let position = vector(scenario.initial.base()).repeat(space.copies());
        let start = placed.jumps.then(|| vector(&placed.scenario.initial.position));
        let zeros = || vec![T::zero(); position.len()];
        let momentum = match scenario.initial.past {
            None => vector(&scenario.initial.momentum).repeat(space.copies()),
            Some(_) => zeros(),
        };
        let begin = scenario.time.start - scenario.initial.past_steps() as f64 * scenario.time.step;
        let input = zeros();
        let kicked = scenario.convolution.at == DampedAt::MainNodes;
        // With sparse factors an energy costs about as much as a step.
        let is_dear = space.plan().is_some();
        let offset = offset(scenario, nodes, &damping, start.as_ref().unwrap_or(&position), &placed.rows.all);
        let mean = kicked && scenario.output.momentum == ReportedMomentum::Mean;
        damping.kick = mean.then(|| Kick { next: zeros(), last: zeros() });
        if let (Some(skew), Sampling::Nodes(fractions)) = (gyroscopic(scenario, &space), scheme.sampling()) {
            damping.gyroscopic = Some(Gyroscopic::new(skew, fractions, T::of(scenario.time.step)));
        }
        let mut integrator = IntegratorBuilder::in_space(space, system, scheme, T::of(scenario.time.step))
            .damping(damping)
            .start(T::of(begin))
            .position(position)
            .momentum(momentum)
            .build()
            .map_err(|error| refused(scenario, &error))?;
        if let Some(start) = &start {
            integrator.system_mut().take_sides_at(&placed.scenario.initial.position);
            integrator.jump_to(start);
        }
        if let Some(past) = &scenario.initial.past {
            follow_past(&mut integrator, scenario, past)?;
        }
        let mut simulation = Self {
            integrator,
            input,
            pushed: false,
            reported: None,
            offset,
            pieces: None,
            energies: Energies::EveryStep,
            energy_room: EnergyRoom::default(),
            energy: 0.0,
        };
        simulation.settle(scenario, is_dear);
        Ok(simulation)
    }

    /// Sets what belongs to a motion beside the state of the integrator to its beginning; an energy `is_dear`
    /// if it costs about as much as a step.
    fn settle(&mut self, scenario: &Scenario, is_dear: bool) {
        let system = self.integrator.system();
        let is_looked_into = scenario.is_looked_into()
            || system.switches() > 0
            || VelocityKinks::of(scenario).is_some()
            || FunctionJumps::of(scenario).is_some();
        self.pieces = is_looked_into.then(<[Piece<T>; 2]>::default);
        let is_compared = scenario.reference.as_ref().is_some_and(|reference| reference.knows()[2]);
        self.energies = match is_dear {
            true if is_compared => Energies::EveryStep,
            true => Energies::Rows,
            false if system.has_plain_energy() => Energies::Together,
            false => Energies::EveryStep,
        };
        let is_reported = self.integrator.damping().kick.is_some() || !self.offset.is_empty();
        self.reported = is_reported.then(|| vec![T::zero(); self.input.len()]);
        // What it holds is of the last system.
        self.energy_room = EnergyRoom::default();
        self.input.fill(T::zero());
        (self.pushed, self.energy) = (false, 0.0);
    }
}

impl<T: Elementary + Memories> TypedSimulation<T> {
    /// Sets the input, and stores the beginning of the step.
    #[inline(always)]
    fn prepare(&mut self, input: &[f64], begin: impl Fn() -> f64) {
        if !input.is_empty() || self.pushed {
            self.store_input(input);
        }
        if let Some(pieces) = &mut self.pieces {
            let state = self.integrator.state();
            pieces.swap(0, 1);
            pieces[0].begin(begin(), &state.position, &state.momentum);
        }
    }

    #[inline(never)]
    fn store_input(&mut self, input: &[f64]) {
        self.pushed = !input.is_empty();
        for (index, place) in self.input.iter_mut().enumerate() {
            *place = input.get(index).map_or(T::zero(), |&number| T::of(number));
        }
    }

    /// Writes a position and a momentum and computes their energy.
    fn write(&mut self, position: &[T], momentum: &[T], state: &mut GridState) {
        for (numbers, vector) in [(&mut state.position, position), (&mut state.momentum, momentum)] {
            numbers.iter_mut().zip(vector).for_each(|(place, number)| *place = number.to_f64());
        }
        let (position, momentum) = (position.to_vec(), momentum.to_vec());
        state.energy = self.integrator.energy_of(&position, &momentum).to_f64();
    }

    /// Makes the step of a grid after the given number of others.
    #[inline(always)]
    fn step_on_grid(
        &mut self,
        scenario: &Scenario,
        step: usize,
        drive: Option<&Drive>,
    ) -> Result<u32, StepError> {
        // The grid's times have more digits than those of a run in single precision.
        let [begin, end] = [step, step + 1].map(|index| move || scenario.time.time(index));
        match drive {
            None => {
                self.prepare(scenario.input_over(step), begin);
            }
            Some(drive) => {
                let live = self.integrator.system_mut().live();
                if let (Some(live), Some(inside)) = (live, &drive.inside) {
                    live.clone_from(inside);
                }
                self.prepare(&drive.held, begin);
            }
        }
        if scenario.time.grid.is_none() {
            let made = self.integrator.step_under(if self.pushed { &self.input } else { &[] });
            return self.keep_piece(made, end, self.integrator.step_size());
        }
        let length = T::of(end() - begin());
        let made = self.integrator.step_over(length, T::of(end()), &self.input);
        self.keep_piece(made, end, length)
    }

    /// Updates the reported momentum if it is not that of the state.
    #[inline(always)]
    fn take_momentum(&mut self) {
        let Some(reported) = &mut self.reported else { return };
        let (reported, state) = ((reported), self.integrator.state());
        let step_size = self.integrator.step_size();
        let Some(kick) = &self.integrator.damping().kick else {
            reported.copy_from_slice(&state.momentum);
            return self.offset.take_off(self.integrator.time().to_f64(), step_size.to_f64(), reported);
        };
        let half = step_size / T::of(2.0);
        let momenta = reported.iter_mut().zip(&state.momentum).zip(&kick.last);
        momenta.for_each(|((mean, &after), &force)| *mean = after + half * force);
    }

    /// The reported momentum.
    #[inline(always)]
    fn momentum(&self) -> &[T] {
        self.reported.as_ref().unwrap_or(&self.integrator.state().momentum)
    }

    /// Computes the energy of the state with the reported momentum.
    fn take_energy(&mut self) {
        let energy = match &self.reported {
            Some(momentum) => self.integrator.energy_with(momentum),
            None => self.integrator.energy(),
        };
        self.energy = energy.to_f64();
    }

    /// Stores the solution of the step for states inside it.
    #[inline(always)]
    fn keep_piece(
        &mut self,
        made: Result<u32, StepError>,
        end: impl Fn() -> f64,
        length: T,
    ) -> Result<u32, StepError> {
        if let (Ok(_), Some([piece, _])) = (&made, &mut self.pieces) {
            piece.end(end(), length, AnyScheme::solution(self.integrator.storage()));
        }
        made
    }
}

/// The numbers in double precision.
#[inline(always)]
fn in_double<T: Real>(numbers: &[T]) -> impl Iterator<Item = f64> {
    numbers.iter().map(|number| number.to_f64())
}

/// Passes the past to the memories of an integrator at its beginning, and advances it to the initial state.
fn follow_past<T: Elementary + Memories>(
    integrator: &mut Integrator<T, AnySpace, Model<T>, AnyScheme<T>, DampingTerms<T>>,
    scenario: &Scenario,
    past: &Past,
) -> Result<(), InputError> {
    let (h, steps, size) = (scenario.time.step, past.steps(), scenario.coordinates());
    let fraction = match integrator.scheme().sampling() {
        Sampling::Nodes(&[fraction]) => fraction,
        Sampling::Nodes(_) | Sampling::MainNodes => T::one(),
    };
    let mut kick: Vec<T> = scenario.initial.momentum.iter().map(|&p| T::of(p)).collect();
    let (mut rise, mut increments) = (vec![T::zero(); size], Vec::new());
    let (mut known, mut scratch) = (Vec::new(), Vec::new());
    for step in 0..steps {
        let from = integrator.state().position.as_slice();
        let end = past.end(step).unwrap_or(&scenario.initial.position);
        rise.iter_mut().zip(end).zip(from).for_each(|((rise, &end), &from)| *rise = T::of(end) - from);
        increments.clear();
        match past.nodes(step) {
            // A single node lies on a straight line.
            [] => increments.extend(rise.iter().map(|&rise| fraction * rise)),
            nodes => {
                let nodes = nodes.chunks(size).flat_map(|node| node.iter().zip(from));
                increments.extend(nodes.map(|(&node, &from)| T::of(node) - from));
            }
        }
        known.clear();
        known.resize(increments.len(), T::zero());
        scratch.clear();
        scratch.resize(increments.len() + size, T::zero());
        // Rounded like a time that is counted from the start.
        let time = scenario.time.start - (steps - step - 1) as f64 * h;
        let found = Outcome { increments: &increments, rise: &rise, kick: &kick };
        integrator.follow(T::of(time), &found, &mut known, &mut scratch).map_err(|error| {
            scenario.error_at("initial.past", Problem::Unusable { reason: error.to_string() })
        })?;
        kick.fill(T::zero());
    }
    // The force at the end of the past acted before the initial momentum.
    if let Some(kick) = integrator.damping_mut().kick.as_mut() {
        kick.last.fill(T::zero());
    }
    Ok(())
}

fn refused(scenario: &Scenario, error: &IntegratorError) -> InputError {
    let path = match error {
        IntegratorError::InitialState => "initial",
        _ if scenario.time.grid.is_some() => "time.grid",
        _ => "time.step",
    };
    scenario.error_at(path, Problem::Precision { reason: error.to_string() })
}

/// Request for the memory of a damping term.
fn memory_request<'a>(
    scenario: &'a Scenario,
    (channels, nodes): (usize, usize),
    term: &'a scenario::Damping,
) -> MemoryRequest<'a> {
    MemoryRequest {
        family: scenario.convolution.family,
        starting: &scenario.convolution.starting,
        transfer: &term.transfer,
        step_size: scenario.time.step,
        end: scenario.time.grid.as_ref().map(|grid| grid.end()),
        // Scalar weights act on the sequence of every node separately, matrix weights on all nodes together.
        coordinates: match scenario.convolution.family {
            ConvolutionFamily::Bdf { .. } | ConvolutionFamily::Trapezoidal => channels * nodes,
            _ => channels,
        },
        motions: scenario.copies(),
        samples: scenario.samples(),
        given: false,
        history: &scenario.history,
    }
}

/// The damping terms of a scenario on their memories, and the indices of the terms that each memory serves:
/// terms of the same coordinates whose engine is exponential sums for many channels share a memory.
fn damping_terms<T: Elementary + Memories>(
    scenario: &Scenario,
    space: &AnySpace,
    nodes: usize,
    tables: &Tables,
) -> Result<DampingTerms<T>, InputError> {
    let damping = &scenario.system.damping;
    let request = |index: usize| {
        let term = &damping[index];
        memory_request(scenario, (channels_of(term, space.copies()), nodes), term)
    };
    let alike = |one: usize, other: usize| {
        nodes == 1
            && request(one).may_share_with(&request(other))
            && follow_alike::<T>(&damping[one], &damping[other])
    };
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for index in 0..damping.len() {
        let known = groups.iter_mut().find(|group| group.len() < MOST_SHARING && alike(group[0], index));
        match known {
            Some(group) => group.push(index),
            None => groups.push(vec![index]),
        }
    }
    let (mut terms, mut served) = (Vec::new(), Vec::new());
    for group in groups {
        let exponents: Vec<f64> =
            group.iter().filter_map(|&index| damping[index].transfer.exponent()).collect();
        let shared = match group[..] {
            [first, _, ..] => request(first).build_sharing(&exponents, tables),
            _ => None,
        };
        if let Some(memory) = shared {
            terms.push(term_on(scenario, space, &group, request, memory)?);
            served.push(group);
            continue;
        }
        for index in group {
            let memory =
                request(index).build_with(tables).map_err(|error| refused_memory(scenario, index, error))?;
            terms.push(term_on(scenario, space, &[index], request, memory)?);
            served.push(vec![index]);
        }
    }
    Ok(DampingTerms { terms, served, kick: None, gyroscopic: None })
}

/// Terms of a scenario on a memory of their kernels.
fn term_on<'a, T: Elementary + Memories>(
    scenario: &Scenario,
    space: &AnySpace,
    indices: &[usize],
    request: impl Fn(usize) -> MemoryRequest<'a>,
    memory: HostMemory<T>,
) -> Result<ChannelDamping<T, HostMemory<T>>, InputError> {
    let with_kernel = |&index: &usize| {
        let kernel =
            request(index).kernel().map_err(|error| refused_memory(scenario, index, error.into()))?;
        Ok((&scenario.system.damping[index], kernel))
    };
    let terms = indices.iter().map(with_kernel).collect::<Result<Vec<_>, InputError>>()?;
    term_on_memory(space, &terms, memory).map_err(|error| {
        let path = format!("system.damping[{}]", indices[0]);
        scenario.error_at(&path, Problem::Precision { reason: error.to_string() })
    })
}

/// The error for a term whose memory cannot be built.
fn refused_memory(scenario: &Scenario, index: usize, error: EngineError) -> InputError {
    let places: &[&str] = match error {
        EngineError::Table(_) => &["history.tolerance", "history.engine"],
        EngineError::TableEnds { .. } => &["history.horizon", "history.engine"],
        EngineError::NoRoom { .. } => &["history.engine", "time.steps", "time.end"],
        EngineError::Unsuited { .. } => &["history.engine", "time.grid"],
        EngineError::Parameter(_) | EngineError::Rates(_) => {
            let paths = ["order", "kernel"].map(|key| format!("system.damping[{index}].{key}"));
            let places = [paths[0].as_str(), paths[1].as_str()];
            return scenario.error_at_first(&places, Problem::Engine(Cause::new(error)));
        }
        _ => &["history.engine"],
    };
    scenario.error_at_first(places, Problem::Engine(Cause::new(error)))
}

/// G, skew-symmetric; `None` without gyroscopic forces.
fn gyroscopic<T: Elementary>(scenario: &Scenario, space: &AnySpace) -> Option<Matrix<T>> {
    let skew = scenario.system.gyroscopic.as_ref()?;
    let entries = skew.entries().iter().map(|&(row, column, entry)| (row as usize, column as usize, entry));
    Some(Matrix::of_entries(scenario.coordinates(), entries).on_threads(space.threads()))
}

/// The momentum offset of a motion whose terms are at rest at a position, without these coordinates.
fn offset<T: Elementary + Memories>(
    scenario: &Scenario,
    nodes: usize,
    damping: &DampingTerms<T>,
    position: &[T],
    massless: &[usize],
) -> MomentumOffset<T> {
    // With several nodes terms do not share memories.
    MomentumOffset::of(scenario, nodes, |term| {
        let mut force = resisting(&damping.terms[term], position);
        massless.iter().for_each(|&row| force[row] = T::zero());
        force
    })
}

/// ρ x of a term with a scalar kernel.
fn resisting<T: Elementary + Memories>(term: &ChannelDamping<T, HostMemory<T>>, vector: &[T]) -> Vec<T> {
    let mut scratch = vec![T::zero(); vector.len()];
    let mut force = vec![T::zero(); vector.len()];
    term.add_leading(vector, &mut force, &mut scratch);
    let leading = term.memory().leading().first().copied().unwrap_or(T::one());
    force.iter_mut().for_each(|number| *number /= leading);
    force
}

/// Any number of damping terms on their memories.
struct DampingTerms<T: Elementary + Memories> {
    terms: Vec<ChannelDamping<T, HostMemory<T>>>,
    /// Indices of the scenario's terms that each memory serves.
    served: Vec<Vec<usize>>,
    kick: Option<Kick<T>>,
    /// Gyroscopic forces, which act like a damping without memory.
    gyroscopic: Option<Gyroscopic<T, Matrix<T>>>,
}

/// The fractional force Σ_m ρ_m (D^{β_m} q)_k at the main nodes: the momentum p_k of such a scheme is the one
/// after the kick of this force.
struct Kick<T> {
    /// Known part of the next force.
    next: Vec<T>,
    /// The last force; zero at t = 0, where there is no kick.
    last: Vec<T>,
}

/// Result of `act`, whose code for any number of terms stays out of the steps of one term.
#[inline(never)]
fn out_of_line<R>(act: impl FnOnce() -> R) -> R {
    act()
}

impl<T: Elementary + Memories> Damping<T, AnySpace> for DampingTerms<T> {
    fn check(&self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
        self.terms[..].check(coordinates, nodes, step_size)
    }

    fn begin(&mut self, position: &[T], velocity: &[T]) {
        self.terms[..].begin(position, velocity);
        if let Some(Kick { next, last }) = &mut self.kick {
            next.fill(T::zero());
            last.fill(T::zero());
        }
    }

    fn begin_at(&mut self, time: T) {
        self.terms[..].begin_at(time);
    }

    #[inline(always)]
    fn add_known(
        &mut self,
        sample: &Sample<'_, T>,
        known: &mut [T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        match &mut self.terms[..] {
            [only] => only.add_known(sample, known, scratch)?,
            several => out_of_line(|| several.add_known(sample, known, scratch))?,
        }
        if let Some(kick) = &mut self.kick {
            kick.next.iter_mut().zip(known).for_each(|(next, known)| *next = *known);
        }
        Ok(())
    }

    #[inline(always)]
    fn add_leading(&self, increments: &[T], force: &mut [T], scratch: &mut [T]) {
        match &self.terms[..] {
            [only] => only.add_leading(increments, force, scratch),
            several => out_of_line(|| several.add_leading(increments, force, scratch)),
        }
        if let Some(gyroscopic) = &self.gyroscopic {
            gyroscopic.add(increments, force, scratch);
        }
    }

    fn visit_leading(&self, nodes: usize, mut visit: impl FnMut(usize, usize, T, &Matrix<T>)) {
        self.terms[..].visit_leading(nodes, &mut visit);
        if let Some(gyroscopic) = &self.gyroscopic {
            gyroscopic.visit(visit);
        }
    }

    fn leading_is_constant(&self) -> bool {
        self.terms[..].leading_is_constant()
    }

    #[inline(always)]
    fn push(
        &mut self,
        sample: &Sample<'_, T>,
        increments: &[T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        // Starting weights change the leading weight at the push.
        if let Some(kick) = &mut self.kick {
            self.terms[..].add_leading(increments, &mut kick.next, scratch);
        }
        match &mut self.terms[..] {
            [only] => only.push(sample, increments, scratch)?,
            several => out_of_line(|| several.push(sample, increments, scratch))?,
        }
        if let Some(Kick { next, last }) = &mut self.kick {
            std::mem::swap(next, last);
            next.fill(T::zero());
        }
        Ok(())
    }
}

impl<T: Elementary + Memories> Stateful for DampingTerms<T> {
    fn state_bytes(&self) -> usize {
        let kick = self.kick.as_ref().map_or(0, |kick| kick.last.len() * T::BYTES);
        kick + self.terms[..].state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        if let Some(kick) = &self.kick {
            to.numbers(&kick.last)?;
        }
        self.terms[..].save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        if let Some(kick) = &self.kick {
            from.skip::<T>(kick.last.len())?;
        }
        self.terms[..].check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        if let Some(kick) = &mut self.kick {
            from.numbers(&mut kick.last)?;
        }
        self.terms[..].restore(from)
    }
}

impl<T: Scalar> Stepper for TypedSimulation<T> {
    fn begin_anew(&mut self, scenario: &Scenario, compiled: Option<Model<f64>>) -> Result<bool, InputError> {
        let model = T::model(scenario, compiled).map_err(|error| bad_mass(scenario, &error))?;
        let initial = &scenario.initial;
        let (position, momentum) = (vector(&initial.position), vector(&initial.momentum));
        let integrator = &mut self.integrator;
        *integrator.system_mut() = model;
        integrator
            .begin_anew(T::of(scenario.time.start), &position, &momentum)
            .map_err(|error| refused(scenario, &error))?;
        let (scheme, damping) = (self.integrator.scheme(), self.integrator.damping());
        self.offset = offset(scenario, scheme.sampling().nodes(), damping, &position, &[]);
        self.settle(scenario, false);
        Ok(true)
    }

    fn step(&mut self, input: &[f64]) -> Result<u32, StepError> {
        let begin = self.integrator.time().to_f64();
        self.prepare(input, || begin);
        let made = self.integrator.step(&self.input);
        let (end, length) = (self.integrator.time().to_f64(), self.integrator.step_size());
        self.keep_piece(made, || end, length)
    }

    fn step_over(&mut self, length: f64, end: f64, input: &[f64]) -> Result<u32, StepError> {
        let begin = self.integrator.time().to_f64();
        self.prepare(input, || begin);
        let made = self.integrator.step_over(T::of(length), T::of(end), &self.input);
        let end = self.integrator.time().to_f64();
        self.keep_piece(made, || end, T::of(length))
    }

    fn interpolate(&mut self, time: f64, state: &mut GridState) {
        let Some([last, before]) = &self.pieces else { return };
        state.time = time;
        if last.solution.is_empty() {
            self.read(state);
            return;
        }
        let (piece, end) = if time > last.from { (last, None) } else { (before, Some(last)) };
        match (piece.place(time), end) {
            (WithinStep::End, None) => self.read(state),
            (WithinStep::End, Some(next)) => {
                let (position, momentum) = (next.position.clone(), next.momentum.clone());
                self.write(&position, &momentum, state);
            }
            (WithinStep::Inside(fraction), _) => {
                let (mut position, mut momentum) = (piece.position.clone(), piece.momentum.clone());
                self.integrator.scheme().interpolate(
                    &piece.solution,
                    self.integrator.system(),
                    (piece.length, T::of(fraction)),
                    &mut position,
                    &mut momentum,
                );
                self.write(&position, &momentum, state);
            }
        }
    }

    fn position_at(&mut self, time: f64, position: &mut Vec<f64>) {
        position.clear();
        let Some([last, before]) = &self.pieces else { return };
        let (piece, end) = if time > last.from || before.solution.is_empty() {
            (last, self.integrator.state().position.as_slice())
        } else {
            (before, last.position.as_slice())
        };
        match piece.place(time) {
            WithinStep::Inside(fraction) if !piece.solution.is_empty() => {
                let (mut inside, mut momentum) = (piece.position.clone(), piece.momentum.clone());
                let place = (piece.length, T::of(fraction));
                let (scheme, system) = (self.integrator.scheme(), self.integrator.system());
                scheme.interpolate(&piece.solution, system, place, &mut inside, &mut momentum);
                position.extend(in_double(&inside));
            }
            _ => position.extend(in_double(end)),
        }
    }

    fn switches(&mut self) -> &mut dyn Switched {
        self.integrator.system_mut()
    }

    fn advance(
        &mut self,
        scenario: &Scenario,
        steps: usize,
        batch: &mut StepBatch,
        drive: Option<&Drive>,
    ) -> Result<(), StepError> {
        let before = batch.first() - 1;
        let mut made = Ok(());
        for step in before..before + steps {
            let iterations = match self.step_on_grid(scenario, step, drive) {
                Ok(iterations) => iterations,
                Err(error) => {
                    made = Err(error);
                    break;
                }
            };
            self.take_momentum();
            let count = step + 1;
            let row = || count == scenario.time.steps || count.is_multiple_of(scenario.output.every);
            match self.energies {
                Energies::EveryStep => self.take_energy(),
                Energies::Rows if row() => self.take_energy(),
                Energies::Rows | Energies::Together => {}
            }
            let position = in_double(&self.integrator.state().position);
            let time = self.integrator.time().to_f64();
            batch.push((time, self.energy), position, in_double(self.momentum()), iterations);
            batch.push_increments(in_double(AnyScheme::solution(self.integrator.storage())));
            // A force with more jumps in a step than are looked for makes long steps: signals come between.
            if self.integrator.system().unresolved_since().is_some() {
                break;
            }
        }
        if self.energies == Energies::Together {
            let stride = batch.room();
            let (positions, momenta, energies) = batch.with_energies_mut();
            let states = States { positions, momenta, stride };
            self.integrator.system().write_energies(&states, &mut self.energy_room, energies);
        }
        made
    }

    fn read_without_energy(&mut self, grid: &mut GridState) {
        self.take_momentum();
        grid.time = self.integrator.time().to_f64();
        let write = |places: &mut [f64], numbers: &[T]| {
            places.iter_mut().zip(numbers).for_each(|(place, number)| *place = number.to_f64());
        };
        write(&mut grid.position, &self.integrator.state().position);
        write(&mut grid.momentum, self.momentum());
    }

    fn read(&mut self, grid: &mut GridState) {
        self.read_without_energy(grid);
        self.take_energy();
        grid.energy = self.energy;
    }

    fn energies(&self, energies: &mut Vec<f64>) {
        energies.clear();
        energies.extend(self.integrator.system().energies().iter().map(|energy| energy.to_f64()));
    }

    fn has_energies_of_rows_only(&self) -> bool {
        self.energies == Energies::Rows
    }

    fn engines(&self) -> Vec<Engine> {
        let DampingTerms { terms, served, .. } = self.integrator.damping();
        let of_memory = |(term, served): (&ChannelDamping<T, HostMemory<T>>, &Vec<usize>)| {
            let engine = term.memory().engine();
            served.iter().map(move |&index| (index, engine)).collect::<Vec<_>>()
        };
        let mut engines: Vec<_> = terms.iter().zip(served).flat_map(of_memory).collect();
        engines.sort_by_key(|&(index, _)| index);
        engines.into_iter().map(|(_, engine)| engine).collect()
    }

    fn unresolved_since(&self) -> Option<f64> {
        self.integrator.system().unresolved_since()
    }

    fn shared(&self) -> Vec<Vec<usize>> {
        self.integrator.damping().served.iter().filter(|served| served.len() > 1).cloned().collect()
    }

    fn overruns(&self) -> Option<usize> {
        let terms = self.integrator.damping().terms.iter();
        terms.filter_map(|term| term.memory().overruns()).reduce(|sum, more| sum + more)
    }

    fn memory_bytes(&self) -> usize {
        self.integrator.damping().terms.iter().map(|term| term.memory().bytes()).sum()
    }
}

impl<T: Elementary + Memories> Stateful for TypedSimulation<T> {
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
        self.integrator.restore(from)
    }
}
