//! A run under way: the simulation with the scenario's input, its state, and what watches it.

use crate::language::InputError;
use crate::memory::Tables;
use crate::scenario::Scenario;
use crate::simulation::energy_guard::{EnergyGuard, Gathered};
use crate::simulation::not_finite::{reason, start, what_is_not_finite};
use crate::simulation::{GridState, Precision, Simulation};
use fvi_core::StateError;

/// A scenario on its way from grid point to grid point.
///
/// The one loop body of all that runs scenarios: the sampled input of the step, the step, a look at whether the state is finite,
/// and one at the energy.
pub struct Motion<'s> {
    scenario: &'s Scenario,
    simulation: Simulation,
    guard: EnergyGuard,
    steps: usize,
    state: GridState,
    next: GridState,
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
        Ok(Self { scenario, simulation, guard, steps: 0, next: state.clone(), state })
    }

    /// What watches it has gathered.
    pub(crate) fn gathered(&self) -> Gathered {
        self.guard.gathered()
    }

    /// Goes on after so many steps with the state and what was gathered that another motion of the scenario had then.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are no such state; the motion is of no use then.
    pub(crate) fn go_on(&mut self, steps: usize, state: &[u8], gathered: Gathered) -> Result<(), StateError> {
        self.simulation.restore(state)?;
        self.simulation.read(&mut self.state);
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
        let input = self.scenario.input.as_ref().and_then(|input| input.at_step(step)).unwrap_or(&[]);
        let iterations = match &self.scenario.time.grid {
            None => self.simulation.step(input),
            Some(_) => {
                let end = self.scenario.time.time(step + 1);
                self.simulation.step_over(end - self.scenario.time.time(step), end, input)
            }
        };
        let iterations = iterations.map_err(|error| failure(error.to_string()))?;
        let last = self.steps + 1 == self.scenario.time.steps;
        if last
            || !self.simulation.energy_is_dear()
            || (self.steps + 1).is_multiple_of(self.scenario.output.every)
        {
            self.simulation.read(&mut self.next);
        } else {
            // The energy of the newest row that is written stands for those between.
            self.simulation.read_without_energy(&mut self.next);
            self.next.energy = self.state.energy;
        }
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

    /// Brings the energy up to date with the state, where it was left out.
    pub fn complete(&mut self) {
        self.simulation.read(&mut self.next);
        // A step to what is not finite has taken the simulation further than the motion.
        if self.next.time == self.state.time {
            self.state.energy = self.next.energy;
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
