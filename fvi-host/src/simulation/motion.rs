//! A run under way: the simulation with the scenario's input, its state, and what watches it.

use crate::language::InputError;
use crate::memory::Tables;
use crate::scenario::Scenario;
use crate::simulation::adaptive::{AdaptiveSteps, Counts, Progress};
use crate::simulation::energy_guard::{EnergyGuard, Gathered};
use crate::simulation::not_finite::{reason, start, what_is_not_finite};
use crate::simulation::{GridState, Precision, Simulation};
use fvi_core::{StateError, StepError};

/// A scenario on its way from grid point to grid point.
///
/// The one loop body of all that runs scenarios: the sampled input of the step, the step, a look at whether the state is finite,
/// and one at the energy.
pub struct Motion<'s> {
    scenario: &'s Scenario,
    simulation: Simulation,
    guard: EnergyGuard,
    /// What chooses the steps, where they are chosen on the way.
    adaptive: Option<AdaptiveSteps<'s>>,
    steps: usize,
    state: GridState,
    next: GridState,
    /// Of the motions under load cases.
    energies: Vec<f64>,
}

/// Why a motion ends before its time.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    /// The step that failed, from 0: from t_step to t_{step+1}.
    pub step: usize,
    /// The time at its beginning.
    pub time: f64,
    /// Why.
    pub reason: String,
}

impl<'s> Motion<'s> {
    /// The scenario at t = 0.
    ///
    /// # Errors
    /// If the simulation cannot be made, or its state or energy is not finite in its precision.
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
        let (simulation, state) = start(scenario, precision, tables)?;
        let guard = EnergyGuard::new(scenario, &state);
        let adaptive = AdaptiveSteps::new(scenario, precision, &state)?;
        let mut energies = Vec::new();
        simulation.read_energies(&mut energies);
        Ok(Self { scenario, simulation, guard, adaptive, steps: 0, next: state.clone(), state, energies })
    }

    /// What watches it has gathered.
    pub(crate) fn gathered(&self) -> Gathered {
        self.guard.gathered()
    }

    /// The state as bytes.
    ///
    /// # Errors
    /// [`StateError`] if a memory cannot be saved.
    pub(crate) fn save(&self) -> Result<Vec<u8>, StateError> {
        match &self.adaptive {
            Some(adaptive) => adaptive.save(&self.simulation),
            None => self.simulation.save(),
        }
    }

    /// What steps that are chosen on the way need to go on.
    pub(crate) fn chosen(&self) -> Option<Progress> {
        self.adaptive.as_ref().map(|adaptive| adaptive.progress().clone())
    }

    /// What was made of attempts at steps, where they are chosen on the way.
    pub fn counts(&self) -> Option<Counts> {
        self.adaptive.as_ref().map(|adaptive| adaptive.progress().counts)
    }

    /// Goes on after so many steps with the state and what was gathered that another motion of the scenario had then.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are no such state; the motion is of no use then.
    pub(crate) fn go_on(
        &mut self,
        steps: usize,
        state: &[u8],
        gathered: Gathered,
        chosen: Option<Progress>,
    ) -> Result<(), StateError> {
        self.simulation.restore(state)?;
        self.simulation.read(&mut self.state);
        self.simulation.read_energies(&mut self.energies);
        if let (Some(adaptive), Some(chosen)) = (&mut self.adaptive, chosen) {
            self.state.time = chosen.time();
            adaptive.go_on(chosen);
        }
        self.steps = steps;
        self.guard.go_on(gathered, &self.state);
        Ok(())
    }

    /// Makes the next step; returns the iterations of Newton's method.
    ///
    /// # Errors
    /// [`Failure`]. A step that could not be made leaves the motion as it was. One at whose end the energy has grown without a
    /// cause has been made, and [`steps`](Self::steps) counts it.
    pub fn advance(&mut self) -> Result<u32, Failure> {
        let (step, time) = (self.steps, self.state.time);
        let failure = |reason| Failure { step, time, reason };
        if self.adaptive.is_some() && step >= self.scenario.time.steps {
            return Err(failure(format!("more than {step} steps; `time.tolerance` asks for too many")));
        }
        let iterations = match &mut self.adaptive {
            Some(adaptive) => adaptive.advance(&mut self.simulation, &mut self.next).map_err(&failure)?,
            None => self.step().map_err(|error| failure(error.to_string()))?,
        };
        let input = self.input();
        if let Some(what) = what_is_not_finite(&self.next) {
            return Err(failure(reason(what)));
        }
        self.steps += 1;
        std::mem::swap(&mut self.state, &mut self.next);
        match self.guard.take(input, &self.state) {
            None => Ok(iterations),
            Some(reason) => Err(failure(reason)),
        }
    }

    /// The next step of a grid that is known beforehand, and the state after it.
    fn step(&mut self) -> Result<u32, StepError> {
        let (time, step, input) = (&self.scenario.time, self.steps, self.input());
        let iterations = match &time.grid {
            None => self.simulation.step(input)?,
            Some(_) => {
                let end = time.time(step + 1);
                self.simulation.step_over(end - time.time(step), end, input)?
            }
        };
        let last = self.steps + 1 == time.steps;
        if last
            || !self.simulation.energy_is_dear()
            || (self.steps + 1).is_multiple_of(self.scenario.output.every)
        {
            self.simulation.read(&mut self.next);
            self.simulation.read_energies(&mut self.energies);
        } else {
            // The energy of the newest row that is written stands for those between.
            self.simulation.read_without_energy(&mut self.next);
            self.next.energy = self.state.energy;
        }
        Ok(iterations)
    }

    /// The input that is held over the step that begins at the present state.
    fn input(&self) -> &'s [f64] {
        let scenario = self.scenario;
        let input = scenario.input.as_ref().and_then(|input| match &self.adaptive {
            Some(_) => input.from_time(self.state.time),
            None => input.at_step(self.steps),
        });
        input.unwrap_or(&[])
    }

    /// Whether the end has been reached.
    pub fn is_done(&self) -> bool {
        match &self.adaptive {
            Some(adaptive) => adaptive.is_done(),
            None => self.steps >= self.scenario.time.steps,
        }
    }

    /// Brings the energy up to date with the state, where it was left out.
    pub fn complete(&mut self) {
        self.simulation.read(&mut self.next);
        // A step to what is not finite has taken the simulation further than the motion; so has the second half of a pair.
        if self.next.time == self.state.time {
            self.state.energy = self.next.energy;
            self.simulation.read_energies(&mut self.energies);
        }
    }

    /// Steps made.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// The state after them.
    pub fn state(&self) -> &GridState {
        &self.state
    }

    /// The energies of the motions under load cases, of which the state's is the sum; none without cases.
    pub fn energies(&self) -> &[f64] {
        &self.energies
    }

    /// Writes the state at a time within the last step, by the scheme's own polynomial.
    pub fn look_into(&mut self, time: f64, state: &mut GridState) {
        self.simulation.look_into(time, state);
    }

    /// What moves.
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// What the guard of the energy has to warn of.
    pub fn warning(&self) -> Option<&str> {
        self.guard.warning()
    }
}
