//! Measurements of a run for a sweep that its summary does not contain.

use fvi_scenario::scenario::Scenario;
use fvi_simulation::column::{highest, lowest};
use fvi_simulation::simulation::step_batch::StepBatch;

/// Measurements accumulated along one run.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    /// Beginning of the part of the run over which amplitudes are taken.
    settled: Settled,
    energy_at_start: f64,
    /// Lowest and highest value of each coordinate over that part.
    ranges: Vec<(f64, f64)>,
}

/// A step index, or a time for steps of different lengths.
#[derive(Clone, Copy, Debug)]
enum Settled {
    Step(usize),
    Time(f64),
}

impl Measured {
    /// `settled` is the last share of the run over which amplitudes are taken.
    pub(super) fn new(scenario: &Scenario, settled: f64) -> Self {
        let time = &scenario.time;
        let settled = match time.grid {
            None => Settled::Step((((1.0 - settled) * time.steps as f64) as usize).min(time.steps)),
            Some(_) => Settled::Time(time.end() - settled * (time.end() - time.time(0))),
        };
        Self { settled, energy_at_start: f64::NAN, ranges: Vec::new() }
    }

    /// Evaluates the states of a batch, which are finite.
    pub(super) fn take(&mut self, batch: &StepBatch) {
        if batch.first() == 0 {
            self.energy_at_start = batch.energies().first().copied().unwrap_or(f64::NAN);
            self.ranges = vec![(f64::INFINITY, f64::NEG_INFINITY); batch.positions().count()];
        }
        let first = match self.settled {
            Settled::Step(first) => first.saturating_sub(batch.first()),
            Settled::Time(first) => batch.times().partition_point(|&time| time < first),
        };
        for (range, column) in self.ranges.iter_mut().zip(batch.positions()) {
            let settled = column.get(first..).unwrap_or(&[]);
            if !settled.is_empty() {
                *range = (range.0.min(lowest(settled)), range.1.max(highest(settled)));
            }
        }
    }

    pub(super) fn energy_at_start(&self) -> f64 {
        self.energy_at_start
    }

    /// Half the range of each coordinate; NaN for a run that ended before that part.
    pub(super) fn amplitudes(&self) -> Vec<f64> {
        let half = |&(low, high): &(f64, f64)| if low <= high { 0.5 * (high - low) } else { f64::NAN };
        self.ranges.iter().map(half).collect()
    }
}
