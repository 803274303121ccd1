//! What the caller of a run receives.

use super::Run;
use crate::output_sink::StateView;
use crate::results::rows::Rows;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::step_batch::StepBatch;
use fvi_simulation::simulation::{GridState, StateQuantities, velocities_need_all_momenta};
use std::convert::Infallible;

/// Places that states and rows are written to, one after another.
pub(super) struct Place {
    state: GridState,
    /// A row, with the coordinates of the output, and their numbers.
    row: GridState,
    chosen: Vec<usize>,
    /// What tells velocities, once rows are kept whose momenta do not; with room for one.
    velocities: Option<(StateQuantities, Vec<f64>)>,
}

impl Place {
    pub(super) fn of(run: &Run<'_>) -> Self {
        let (state, row) = (run.state().clone(), run.view(0).shown(run.scenario));
        Self { state, row, chosen: run.scenario.written_coordinates(), velocities: None }
    }

    /// Adds the velocity of a state to rows.
    fn add_velocity(&mut self, rows: &mut Rows, scenario: &Scenario, position: &[f64], momentum: &[f64]) {
        let made =
            || StateQuantities::new(scenario).ok().map(|told| (told, vec![0.0; scenario.coordinates()]));
        self.velocities = self.velocities.take().or_else(made);
        let Some((told, velocity)) = &mut self.velocities else { return };
        told.velocity(position, momentum, velocity);
        rows.velocity.extend(self.chosen.iter().map(|&index| velocity[index]));
    }
}

/// The steps that a run has made since its caller last received some; see [`Run::drive`].
pub struct Portion<'r> {
    pub(super) run: &'r Run<'r>,
    pub(super) batch: &'r StepBatch,
    pub(super) place: &'r mut Place,
}

impl Portion<'_> {
    /// The states in columns, those of load cases one after another.
    pub fn batch(&self) -> &StepBatch {
        self.batch
    }

    /// Hands on every state with the number of steps made until then, those of load cases in one.
    ///
    /// # Errors
    /// Errors of `take`.
    pub fn states<E>(&mut self, mut take: impl FnMut(usize, &GridState) -> Result<(), E>) -> Result<(), E> {
        let (batch, state) = (self.batch, &mut self.place.state);
        (0..batch.len()).try_for_each(|index| {
            batch.read(index, state);
            take(batch.first() + index, state)
        })
    }

    /// Hands on the rows that `[output]` selects, with its coordinates, each with the index of its load case,
    /// 0 without load cases. Rows of a case come in order.
    ///
    /// # Errors
    /// Errors of `take`.
    pub fn rows<E>(&mut self, mut take: impl FnMut(usize, &GridState) -> Result<(), E>) -> Result<(), E> {
        let (run, scenario) = (self.run, self.run.scenario);
        let copies = scenario.copies();
        if self.batch.is_empty() {
            return (0..copies).try_for_each(|case| take(case, &run.view(case).shown(scenario)));
        }
        let Place { row, chosen, .. } = &mut *self.place;
        if scenario.output.times.is_empty() {
            for index in self.batch.multiples(scenario.output.every) {
                for case in 0..copies {
                    run.batch_view(case).read(index, chosen, row);
                    take(case, row)?;
                }
            }
        }
        // Load cases have rows at grid points only.
        let between = run.rows_between().iter();
        between.map(|state| StateView::from(state).shown(scenario)).try_for_each(|row| take(0, &row))
    }

    /// Adds the rows that `[output]` selects to those of each load case, or of the one motion without them,
    /// with velocities where the written momenta do not tell them.
    pub fn keep(&mut self, motions: &mut [Rows]) {
        // An event at a grid point ends a run after the row of that point.
        let now = self.run.state().time;
        if self.batch.is_empty() && motions.iter().any(|rows| rows.time.last() == Some(&now)) {
            return;
        }
        if velocities_need_all_momenta(self.run.scenario) {
            self.keep_velocities(motions);
        }
        let Self { run, batch, .. } = *self;
        let output = &run.scenario.output;
        if batch.is_empty() || !output.times.is_empty() {
            let Ok(()) = self.rows(|case, row| {
                motions.get_mut(case).into_iter().for_each(|rows| rows.push(row));
                Ok::<_, Infallible>(())
            });
            return;
        }
        for (case, rows) in motions.iter_mut().enumerate() {
            run.batch_view(case).add_to(rows, &self.place.chosen, output.every);
        }
    }

    fn keep_velocities(&mut self, motions: &mut [Rows]) {
        let Self { run, batch, ref mut place } = *self;
        let output = &run.scenario.output;
        for (case, rows) in motions.iter_mut().enumerate() {
            if batch.is_empty() {
                let last = run.view(case);
                place.add_velocity(rows, run.scenario, last.position, last.momentum);
            } else if output.times.is_empty() {
                let whole: Vec<usize> = (0..run.scenario.coordinates()).collect();
                for index in batch.multiples(output.every) {
                    let state = run.batch_view(case).state(index, &whole);
                    place.add_velocity(rows, run.scenario, &state.position, &state.momentum);
                }
            } else {
                for state in run.rows_between() {
                    place.add_velocity(rows, run.scenario, &state.position, &state.momentum);
                }
            }
        }
    }
}
