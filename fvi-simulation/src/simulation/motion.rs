//! A run: the simulation with the scenario's inputs, its state, and its monitors.

use crate::simulation::adaptive::{AdaptiveSteps, Counts, Progress, warning_of_start};
use crate::simulation::columns::{Columns, Source};
use crate::simulation::control::{Control, Drive, acts_inside_steps, control};
use crate::simulation::energy_guard::{EnergyGuard, Gathered};
use crate::simulation::forces_of_time;
use crate::simulation::memory_energy::MemoryEnergy;
use crate::simulation::not_finite::{first_not_finite, reason, start};
use crate::simulation::step_batch::StepBatch;
use crate::simulation::tangent::{Differentiated, derivatives};
use crate::simulation::{GridState, Precision, Simulation};
use fvi_core::{StateError, StepError};
use fvi_fft::memory::Tables;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Feature, SampledInput, Scenario};

/// Run of a scenario from grid point to grid point.
///
/// The common loop body of all runs of scenarios: a batch of steps with their sampled inputs, followed by
/// checks that the states are finite and of their energies. Large parts are boxed, since a short run is moved
/// more often than it steps.
pub struct Motion<'s> {
    scenario: &'s Scenario,
    simulation: Simulation,
    guard: Box<EnergyGuard>,
    /// Adaptive steps, if any.
    adaptive: Option<Box<AdaptiveSteps<'s>>>,
    steps: usize,
    /// The state after these steps.
    state: GridState,
    /// The states of the last batch.
    batch: StepBatch,
    next: GridState,
    /// The controllers, and their input in the last step.
    control: Option<Box<dyn Control>>,
    drive: Drive,
    /// The run's columns, and their numbers before the last step.
    columns: Columns,
    columns_before: Vec<f64>,
    /// Energies of the motions under load cases.
    energies: Vec<f64>,
    /// Warning about forces of time.
    notes: Vec<String>,
    tangent: Option<Box<dyn Differentiated>>,
    memory_energy: Option<Box<MemoryEnergy>>,
    /// Derivatives of a state on their way to the batch.
    slopes: Vec<f64>,
}

/// Reason why a motion ends early.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    /// The step that failed, from 0: from t_step to t_{step+1}.
    pub step: usize,
    /// The time at its beginning.
    pub time: f64,
    /// The reason.
    pub reason: String,
}

impl<'s> Motion<'s> {
    /// The motion of the scenario at t = 0.
    ///
    /// # Errors
    /// If the simulation cannot be built, or its state or energy is not finite in its precision.
    pub fn start(scenario: &'s Scenario, precision: Precision) -> Result<Self, InputError> {
        Self::sharing(scenario, precision, &Tables::default())
    }

    /// As [`start`](Self::start), with the tables of its memories shared with other motions.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn sharing(
        scenario: &'s Scenario,
        precision: Precision,
        tables: &Tables,
    ) -> Result<Self, InputError> {
        Self::reusing(None, scenario, precision, tables)
    }

    /// As [`sharing`](Self::sharing), with the simulation of a motion that has ended, which begins anew. The
    /// scenario of that one must differ from this one in the initial position and momentum and in parameters
    /// of expressions only, the precision in nothing.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn reusing(
        ended: Option<Simulation>,
        scenario: &'s Scenario,
        precision: Precision,
        tables: &Tables,
    ) -> Result<Self, InputError> {
        let (mut simulation, mut state) = start(ended, scenario, precision, tables)?;
        let columns = Columns::of(scenario);
        state.columns.resize(columns.len(), 0.0);
        let mut control = control(scenario, precision)?;
        if let Some(control) = &mut control {
            control.take(0, &state).map_err(|reason| {
                scenario.error_at("controller", Problem::Unusable { reason: format!("{reason}, at t = 0") })
            })?;
            control.write(&mut state.columns[columns.places(Source::Controllers)]);
        }
        let memory_energy = match scenario.is_mechanism() {
            true => None,
            false => MemoryEnergy::new(scenario)?.map(Box::new),
        };
        if let Some(memory_energy) = &memory_energy {
            memory_energy.write(&mut state.columns[columns.places(Source::Memories)]);
        }
        write_of_mechanism(&mut simulation, &columns, &mut state.columns)
            .map_err(|reason| scenario.error_at("system.constraints", Problem::Unusable { reason }))?;
        let inside = acts_inside_steps(scenario);
        let drive =
            Drive { inside: inside.then(|| SampledInput::of(Vec::new(), Vec::new())), ..Drive::default() };
        let guard = Box::new(EnergyGuard::new(scenario, precision, &state));
        let adaptive = AdaptiveSteps::new(scenario, precision, &mut simulation, &state)?
            .map(|steps| Box::new(steps.with_perturbed(precision, tables, &state)));
        let mut energies = Vec::new();
        simulation.read_energies(&mut energies);
        // Steps are made in batches if nothing needs states inside them or each state separately.
        let one_by_one = adaptive.is_some()
            || control.is_some()
            || guard.asks_for_energies()
            || scenario.is_looked_into()
            || !scenario.cases.is_empty()
            || memory_energy.is_some()
            || scenario.is_mechanism()
            || scenario.system.own_terms.is_some();
        let every = if adaptive.is_some() { 1 } else { simulation.energies_every(scenario) };
        let mut batch = StepBatch::new(scenario.coordinates() * scenario.copies(), one_by_one, every);
        batch.push_state(&state, 0);
        let next = state.clone();
        let mut notes = forces_of_time::warnings(scenario);
        notes.extend(warning_of_start(scenario));
        let columns_before = state.columns.clone();
        Ok(Self {
            scenario,
            simulation,
            guard,
            adaptive,
            steps: 0,
            state,
            batch,
            next,
            control,
            drive,
            columns,
            columns_before,
            energies,
            notes,
            tangent: None,
            memory_energy,
            slopes: Vec::new(),
        })
    }

    /// Its simulation, for [another motion](Self::reusing).
    pub fn into_simulation(self) -> Simulation {
        self.simulation
    }

    /// The motion at t = 0 with the derivatives that its scenario requests.
    ///
    /// # Errors
    /// If they are not supported: in single precision, or if their memories cannot be built.
    pub fn with_sensitivities(mut self, tables: &Tables) -> Result<Self, InputError> {
        if self.simulation.precision() == Precision::F32 {
            self.scenario.check_use(Feature::SinglePrecision)?;
        }
        self.tangent = derivatives(self.scenario, tables)?;
        if let Some(tangent) = &self.tangent {
            tangent.write(&mut self.state.sensitivities);
            self.batch.take_sensitivities(0, &self.state.sensitivities);
            self.batch.keep_increments();
        }
        Ok(self)
    }

    /// The motion at t = 0, whose batches keep what its steps were solved by, for an
    /// [`adjoint::Record`](crate::simulation::adjoint::Record).
    #[must_use]
    pub fn recorded(mut self) -> Self {
        self.batch.keep_increments();
        self
    }

    /// States of its monitors.
    pub fn gathered(&self) -> Gathered {
        self.guard.gathered()
    }

    /// The state as bytes.
    ///
    /// # Errors
    /// [`StateError`] if a memory cannot be saved.
    pub fn save(&self) -> Result<Vec<u8>, StateError> {
        let mut bytes = match &self.adaptive {
            Some(adaptive) => adaptive.save(&self.simulation)?,
            None => self.simulation.save()?,
        };
        if let Some(control) = &self.control {
            let length = bytes.len();
            control.save(&mut bytes)?;
            bytes.extend((length as u64).to_le_bytes());
        }
        if let Some(memory_energy) = &self.memory_energy {
            let length = bytes.len();
            memory_energy.save(&mut bytes)?;
            bytes.extend((length as u64).to_le_bytes());
        }
        if let Some(tangent) = &self.tangent {
            let length = bytes.len();
            tangent.save(&mut bytes)?;
            bytes.extend((length as u64).to_le_bytes());
        }
        Ok(bytes)
    }

    /// State needed to continue adaptive steps.
    pub fn chosen(&self) -> Option<Progress> {
        self.adaptive.as_ref().map(|adaptive| adaptive.progress().clone())
    }

    /// Counts of attempted adaptive steps.
    pub fn counts(&self) -> Option<Counts> {
        self.adaptive.as_ref().map(|adaptive| adaptive.progress().counts)
    }

    /// Continues after the given number of steps from the state, and the states of monitors, of another
    /// motion of the scenario.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are no such state; the motion must not be used then.
    pub fn resume(
        &mut self,
        steps: usize,
        state: &[u8],
        gathered: Gathered,
        chosen: Option<Progress>,
    ) -> Result<(), StateError> {
        let state = match &mut self.tangent {
            None => state,
            Some(tangent) => {
                let (state, of_tangent) = split_last(state)?;
                tangent.restore(of_tangent)?;
                tangent.write(&mut self.state.sensitivities);
                state
            }
        };
        let state = match &mut self.memory_energy {
            None => state,
            Some(memory_energy) => {
                let (state, of_memory) = split_last(state)?;
                memory_energy.restore(of_memory)?;
                memory_energy.write(&mut self.state.columns[self.columns.places(Source::Memories)]);
                state
            }
        };
        let state = match &mut self.control {
            None => state,
            Some(control) => {
                let (state, of_control) = split_last(state)?;
                control.restore(of_control)?;
                control.write(&mut self.state.columns[self.columns.places(Source::Controllers)]);
                state
            }
        };
        self.columns_before.clone_from(&self.state.columns);
        self.simulation.restore(state)?;
        self.simulation.read(&mut self.state);
        // They were determined when the state was saved.
        let _ = write_of_mechanism(&mut self.simulation, &self.columns, &mut self.state.columns);
        self.columns_before.clone_from(&self.state.columns);
        self.simulation.read_energies(&mut self.energies);
        if let (Some(adaptive), Some(chosen)) = (&mut self.adaptive, chosen) {
            self.state.time = chosen.time();
            adaptive.resume(&mut self.simulation, chosen);
        }
        self.steps = steps;
        self.batch.begin(steps);
        self.batch.push_state(&self.state, 0);
        self.guard.resume(gathered, &self.state);
        Ok(())
    }

    /// Makes the next step; returns the number of iterations of Newton's method.
    ///
    /// # Errors
    /// [`Failure`]. A failed step leaves the motion as it was. A step at whose end the energy guard stops the
    /// run has been made, and [`steps`](Self::steps) counts it.
    pub fn advance(&mut self) -> Result<u32, Failure> {
        self.advance_along(1)?;
        Ok(self.batch.iterations().iter().sum())
    }

    /// Makes up to `most` of the next steps; [`batch`](Self::batch) then contains the states after them.
    ///
    /// # Errors
    /// [`Failure`] of the step after the last state of the batch; or of the step to that state, if the energy
    /// guard stops the run there.
    pub fn advance_along(&mut self, most: usize) -> Result<(), Failure> {
        let (before, begin) = (self.steps, self.state.time);
        self.batch.begin(before + 1);
        let mut failure = self.make_steps(most).err();
        if let Some((index, what)) = first_not_finite(&self.batch, &mut self.next) {
            self.batch.truncate(index);
            failure = Some(reason(what));
        }
        if let Err(reason) = self.differentiate(before) {
            failure = Some(reason);
        }
        if let (Some(memory_energy), 1, None) = (&mut self.memory_energy, self.batch.len(), &failure) {
            self.batch.read(0, &mut self.next);
            memory_energy.advance(&self.state.position, &self.next.position);
            memory_energy.write(&mut self.batch.columns_mut()[self.columns.places(Source::Memories)]);
        }
        if self.batch.len() == 1
            && let Err(reason) =
                write_of_mechanism(&mut self.simulation, &self.columns, self.batch.columns_mut())
        {
            self.batch.truncate(0);
            failure = Some(reason);
        }
        let mut failed = self.batch.len();
        self.guard.absorb(self.simulation.memory_work());
        let (scenario, on_grid) = (self.scenario, self.adaptive.is_none());
        let driven = self.control.is_some().then_some(self.drive.largest.as_slice());
        let input_over = |index: usize, time: f64| match driven {
            Some(driven) => driven,
            None if on_grid => scenario.input_over(before + index),
            None => scenario.input_from(time),
        };
        let grown = match self.guard.asks_for_energies() {
            false => self.guard.take_along(&self.batch, begin, input_over),
            true if self.batch.len() == 1 => {
                self.batch.read(0, &mut self.next);
                let (simulation, room) = (&mut self.simulation, &mut self.state);
                let energy = || {
                    simulation.read(room);
                    room.energy
                };
                let grown = self.guard.take_asking(input_over(0, begin), &self.next, energy);
                grown.map(|grown| (0, grown))
            }
            true => None,
        };
        if let Some((index, grown)) = grown {
            self.batch.truncate(index + 1);
            (failure, failed) = (Some(grown), index);
        }
        if let (Some(control), false) = (&mut self.control, self.batch.is_empty()) {
            self.batch.read(0, &mut self.next);
            if failure.is_none()
                && let Err(reason) = control.take(before as u64 + 1, &self.next)
            {
                (failure, failed) = (Some(reason), 1);
            }
            control.write(&mut self.batch.columns_mut()[self.columns.places(Source::Controllers)]);
        }
        if let Some(last) = self.batch.len().checked_sub(1) {
            self.columns_before.clone_from(&self.state.columns);
            self.steps = before + self.batch.len();
            self.batch.read(last, &mut self.state);
        }
        let Some(reason) = failure else { return Ok(()) };
        let time = failed.checked_sub(1).map_or(begin, |index| self.batch.times()[index]);
        Err(Failure { step: before + failed, time, reason })
    }

    /// Writes the derivatives of the states in the batch, the first of which is that after so many steps and
    /// one more; those behind a state that has none are left out, and the error says why.
    fn differentiate(&mut self, before: usize) -> Result<(), String> {
        let Self { tangent, batch, state, next, slopes, .. } = self;
        let Some(tangent) = tangent else { return Ok(()) };
        for index in 0..batch.len() {
            let begin = match index.checked_sub(1) {
                None => &*state,
                Some(earlier) => {
                    batch.read(earlier, next);
                    &*next
                }
            };
            let begin = (&begin.position[..], &begin.momentum[..]);
            if let Err(reason) = tangent.advance(before + index, begin, batch.increments(index)) {
                batch.truncate(index);
                return Err(reason);
            }
            tangent.write(slopes);
            batch.take_sensitivities(index, slopes);
        }
        Ok(())
    }

    /// Makes steps and puts their states into the empty batch; the error says why the one behind them could
    /// not be made.
    fn make_steps(&mut self, most: usize) -> Result<(), String> {
        let Self { scenario, simulation, adaptive, batch, next, control, drive, state, .. } = self;
        let left = scenario.time.steps.saturating_sub(self.steps);
        match adaptive {
            Some(_) if left == 0 => {
                let steps = self.steps;
                return Err(format!("more than {steps} steps; `time.tolerance` asks for too many"));
            }
            Some(adaptive) => {
                let iterations = adaptive.advance(simulation, next)?;
                batch.push_state(next, iterations);
            }
            None => {
                let steps = most.min(batch.room()).min(left);
                let drive = control.as_mut().map(|control| {
                    drive.held.clear();
                    drive.held.resize(scenario.coordinates(), 0.0);
                    let given = scenario.input_over(self.steps);
                    drive.held.iter_mut().zip(given).for_each(|(sum, force)| *sum += force);
                    control.drive(self.steps as u64, state.time, drive);
                    &*drive
                });
                if let Err(error) = simulation.advance(scenario, steps, batch, drive) {
                    let met = simulation.met(&error, scenario.time.mean_step());
                    return Err(met.unwrap_or_else(|| reason_of(&error)));
                }
                if let Err(reason) = simulation.check() {
                    batch.truncate(batch.len().saturating_sub(1));
                    return Err(reason);
                }
            }
        }
        simulation.read_energies(&mut self.energies);
        Ok(())
    }

    /// True if the end has been reached.
    pub fn is_done(&self) -> bool {
        match &self.adaptive {
            Some(adaptive) => adaptive.is_done(),
            None => self.steps >= self.scenario.time.steps,
        }
    }

    /// Computes the energy of the state if it was left out.
    pub fn complete(&mut self) {
        self.simulation.read(&mut self.next);
        // After a step to a state that is not finite, or the first half of a pair, the simulation is ahead of
        // the motion.
        if self.next.time == self.state.time {
            self.state.energy = self.next.energy;
            self.simulation.read_energies(&mut self.energies);
        }
    }

    /// The states of the last batch: at first the initial state, then those after the steps made together.
    pub fn batch(&self) -> &StepBatch {
        &self.batch
    }

    /// Replaces the last state of the [`batch`](Self::batch) by a state, or removes it if it was shown
    /// before; the motion itself is unchanged.
    pub fn show(&mut self, state: Option<&GridState>) {
        self.batch.replace_last(state);
    }

    /// Number of steps made.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// The state after these steps.
    pub fn state(&self) -> &GridState {
        &self.state
    }

    /// The energies of the motions under load cases, whose sum is the energy of the state; empty without
    /// cases.
    pub fn energies(&self) -> &[f64] {
        &self.energies
    }

    /// Writes the state at a time within the last step, by the polynomial of the scheme, with the columns of
    /// the step's beginning, but for multipliers.
    pub fn interpolate(&mut self, time: f64, state: &mut GridState) {
        self.simulation.interpolate(time, state);
        state.columns.clear();
        let is_inside = time < self.state.time;
        state.columns.extend_from_slice(if is_inside { &self.columns_before } else { &self.state.columns });
        let multipliers = &mut state.columns[self.columns.places(Source::Constraints)];
        if is_inside && !multipliers.is_empty() {
            self.simulation.write_multipliers_at(time, multipliers);
        }
    }

    /// The simulation.
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// Warnings about forces of time, and about oscillations of equations.
    pub fn notes(&self) -> Vec<String> {
        let missed = self.simulation.unresolved_since().map(|time| {
            format!(
                "system.force: from t = {time} on a step had more jumps, kinks or peaks of a force of time than are looked for; \
                 shorter steps tell them apart"
            )
        });
        let turned = self.adaptive.iter().flat_map(|adaptive| adaptive.notes());
        let of_steps = self.simulation.notes();
        self.notes.iter().cloned().chain(missed).chain(turned).chain(of_steps).collect()
    }

    /// Warning of the energy guard.
    pub fn warning(&self) -> Option<&str> {
        self.guard.warning()
    }
}

/// The reason why a step failed, with the key that says it.
fn reason_of(error: &StepError) -> String {
    match error {
        StepError::IndefiniteMass { .. } => format!("`system.kinetic`: at its end {error}"),
        _ => error.to_string(),
    }
}

/// Writes the columns of a mechanism: multipliers, and the energies of its dampers.
fn write_of_mechanism(
    simulation: &mut Simulation,
    columns: &Columns,
    numbers: &mut [f64],
) -> Result<(), String> {
    let places = columns.places(Source::Memories);
    if !places.is_empty()
        && let Some(energies) = simulation.memory_energies()
    {
        numbers[places].copy_from_slice(&energies);
    }
    simulation.write_multipliers(&mut numbers[columns.places(Source::Constraints)])
}

/// Splits off the last appended part of a state, whose length follows it: returns the state before it and the
/// part.
fn split_last(state: &[u8]) -> Result<(&[u8], &[u8]), StateError> {
    let cut_off = StateError::Truncated { needed: 8, left: state.len() };
    let (both, length) = state.split_last_chunk::<8>().ok_or(cut_off)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
    both.split_at_checked(length).ok_or(cut_off)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_scenario::scenario::Scenario;
    use serde_json::{Value, json};

    fn scenario(system: Value, more: Value) -> Scenario {
        let mut value = json!({
            "system": system,
            "initial": { "position": [2.0], "momentum": [0.3] },
            "scheme": { "kind": "low-order", "kappa": 0.5 },
            "time": { "step": 0.05, "steps": 300 },
        });
        let (all, more) = (value.as_object_mut().unwrap(), more.as_object().unwrap().clone());
        all.extend(more);
        Scenario::from_value(&value).unwrap()
    }

    /// Number of steps made, the state after them, and the iterations of the last step.
    type Stepped = (usize, GridState, u32);

    /// All states of a motion, made `most` steps at a time, with the failure and the warning at its end.
    fn states(scenario: &Scenario, most: usize) -> (Vec<Stepped>, Option<Failure>, Option<String>) {
        let mut motion = Motion::start(scenario, Precision::F64).unwrap();
        let mut states = Vec::new();
        let mut state = motion.state().clone();
        let mut failure = None;
        while !motion.is_done() && failure.is_none() {
            failure = motion.advance_along(most).err();
            let batch = motion.batch();
            for (index, &iterations) in batch.iterations().iter().enumerate() {
                batch.read(index, &mut state);
                states.push((batch.first() + index, state.clone(), iterations));
            }
            assert_eq!(states.last().map_or(0, |last| last.0), motion.steps());
            assert!(states.last().is_none_or(|last| last.1 == *motion.state()));
        }
        (states, failure, motion.warning().map(str::to_owned))
    }

    #[test]
    fn steps_made_together_are_those_made_one_by_one() {
        let damping = json!([{ "order": 0.5, "coefficient": [0.3] }]);
        let pendulum = json!({ "mass": [1.7], "potential": "9*(1 - cos(q0))", "damping": damping });
        let driven = json!({ "mass": [1.7], "potential": "q0^2", "force": ["sin(t)"], "damping": damping });
        let matrix = json!({ "mass": [[1.7]], "potential": "q0^2 + q0^4" });
        // Up to the edge of the potential's domain, 1.4 s away.
        let edge = json!({ "mass": [1.0], "potential": "-3*q0 + 0*sqrt(9 - q0)" });
        // At the top the potential is repulsive, at the bottom the step is too long.
        let growing = json!({ "mass": [1.0], "potential": "1000*(1 - cos(q0))" });
        let long = |reaction: &str| {
            json!({
                "initial": { "position": [3.0], "momentum": [0.0] },
                "scheme": { "kind": "low-order", "kappa": 0.0 },
                "time": { "step": 0.1, "steps": 3000, "energy_guard": reaction },
            })
        };
        let input = json!({ "input": { "period": 0.35, "samples": [1.0, -2.0, 0.5] } });
        let mean = json!({ "convolution": { "order": 1, "at": "main-nodes" }, "output": { "every": 7 } });
        let cases = [
            (scenario(pendulum.clone(), json!({})), None),
            (scenario(pendulum.clone(), mean), None),
            (scenario(pendulum, input), None),
            (scenario(driven, json!({})), None),
            (scenario(matrix, json!({})), None),
            (scenario(edge, json!({})), Some("finite")),
            (scenario(growing.clone(), long("stop")), Some("the energy has risen")),
            (scenario(growing, long("warn")), None),
        ];
        for (scenario, ending) in cases {
            let one_by_one = states(&scenario, 1);
            assert_eq!(one_by_one.1.as_ref().map(|failure| failure.step > 3), ending.map(|_| true));
            if let (Some(failure), Some(ending)) = (&one_by_one.1, ending) {
                assert!(failure.reason.contains(ending), "{failure:?}");
            }
            for most in [2, 17, usize::MAX] {
                assert_eq!(states(&scenario, most), one_by_one, "{most}");
            }
        }
    }
}
