//! Which results of each run go into the table.

use super::measured::Measured;
use crate::run::RunSummary;
use fvi_core::max_or_nan;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Simulation;

/// A group of columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quantity {
    /// `t`, `q0`…, `p0`…: the last state.
    Last,
    /// `largest_q0`…, `largest_p0`…: largest absolute values.
    Largest,
    /// `error_q`, `error_p`, `error_energy`: largest errors against the reference.
    Errors,
    /// `energy_start`, `energy`, `energy_left` (their quotient), `largest_energy`.
    Energy,
    /// `amplitude_q0`…: half the range of each coordinate over the last part of the run.
    Amplitude,
    /// `stable_predicted` (1 or 0), `growth` (largest |q| over that of the start).
    Stability,
}

impl Quantity {
    pub(super) const NAMES: [(&'static str, Self); 6] = [
        ("last", Self::Last),
        ("largest", Self::Largest),
        ("errors", Self::Errors),
        ("energy", Self::Energy),
        ("amplitude", Self::Amplitude),
        ("stability", Self::Stability),
    ];

    fn columns(self, coordinates: usize) -> Vec<String> {
        let each = |prefix: &str| -> Vec<String> {
            (0..coordinates).map(|index| format!("{prefix}{index}")).collect()
        };
        let names = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
        match self {
            Self::Last => [vec!["t".to_owned()], each("q"), each("p")].concat(),
            Self::Largest => [each("largest_q"), each("largest_p")].concat(),
            Self::Errors => names(&["error_q", "error_p", "error_energy"]),
            Self::Energy => names(&["energy_start", "energy", "energy_left", "largest_energy"]),
            Self::Amplitude => each("amplitude_q"),
            Self::Stability => names(&["stable_predicted", "growth"]),
        }
    }

    fn values(self, scenario: &Scenario, summary: &RunSummary, measured: &Measured) -> Vec<f64> {
        let (last, largest) = (&summary.last, &summary.largest);
        match self {
            Self::Last => [&[last.time][..], &last.position, &last.momentum].concat(),
            Self::Largest => [&largest.position[..], &largest.momentum].concat(),
            Self::Errors => summary.errors.as_ref().map_or_else(
                || vec![f64::NAN; 3],
                |errors| {
                    let known = |error: &crate::results::measure::ErrorMeasure| {
                        if error.compared > 0 { error.largest } else { f64::NAN }
                    };
                    vec![known(&errors.position), known(&errors.momentum), known(&errors.energy)]
                },
            ),
            Self::Energy => {
                let start = measured.energy_at_start();
                vec![start, last.energy, last.energy / start, largest.energy]
            }
            Self::Amplitude => measured.amplitudes(),
            Self::Stability => {
                let stable = Simulation::is_predicted_stable(scenario);
                let stable = stable.map_or(f64::NAN, |stable| if stable { 1.0 } else { 0.0 });
                let size = |numbers: &[f64]| numbers.iter().map(|number| number.abs()).fold(0.0, max_or_nan);
                vec![stable, size(&largest.position) / size(&scenario.initial.position)]
            }
        }
    }
}

/// The columns of a table, apart from those of the axes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Quantities {
    pub(super) groups: Vec<Quantity>,
    pub(super) coordinates: usize,
}

impl Quantities {
    pub(super) fn columns(&self) -> Vec<String> {
        self.groups.iter().flat_map(|group| group.columns(self.coordinates)).collect()
    }

    pub(super) fn values(&self, scenario: &Scenario, summary: &RunSummary, measured: &Measured) -> Vec<f64> {
        self.groups.iter().flat_map(|group| group.values(scenario, summary, measured)).collect()
    }
}
