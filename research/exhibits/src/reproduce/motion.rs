//! Trajectories of exhibits with one coordinate: run, drawn, listed.

use super::ReproduceError;
use super::table::{Cell, Table};
use fvi_host::converge::{Outcome, Quantity, run_on};
use fvi_host::results::measure::ReferenceErrors;
use fvi_host::results::picture::{Axis, Chart, Series, Style};
use fvi_scenario::scenario::{ReferenceRow, Scenario};
use fvi_simulation::simulation::GridState;
use std::sync::atomic::AtomicBool;

/// A trajectory with its name.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    pub(super) label: String,
    pub(super) states: Vec<GridState>,
}

/// Number of segments of the polygon that an exact solution is drawn with.
const EXACT_INTERVALS: usize = 300;

impl Motion {
    /// Runs a scenario.
    pub(super) fn run(
        label: impl Into<String>,
        scenario: &Scenario,
        stop: &AtomicBool,
    ) -> Result<Self, ReproduceError> {
        let mut states = Vec::with_capacity(scenario.time.steps + 1);
        match run_on(scenario, stop, &mut |_, state| states.push(state.clone()))? {
            Outcome::Done { .. } => Ok(Self { label: label.into(), states }),
            Outcome::Failed { reason } => Err(ReproduceError::Run { reason }),
        }
    }

    /// A quantity over time.
    pub(super) fn points(&self, quantity: Quantity) -> Vec<(f64, f64)> {
        self.states.iter().map(|state| (state.time, value(state, quantity))).collect()
    }

    /// Largest errors against the reference of the scenario that was run.
    pub(super) fn errors(&self, scenario: &Scenario) -> ReferenceErrors {
        self.errors_from(0.0, scenario)
    }

    /// Largest errors from a time on.
    pub(super) fn errors_from(&self, from: f64, scenario: &Scenario) -> ReferenceErrors {
        let mut errors = ReferenceErrors::default();
        for (index, state) in self.states.iter().enumerate().filter(|(_, state)| state.time >= from) {
            if let Some(row) = known(scenario, index) {
                errors.compare(state, &row);
            }
        }
        errors
    }

    /// |q − exact q| over time.
    pub(super) fn position_errors(&self, scenario: &Scenario) -> Vec<(f64, f64)> {
        let error = |(index, state): (usize, &GridState)| {
            let exact = *known(scenario, index)?.position.first()?.as_ref()?;
            Some((state.time, (state.position[0] - exact).abs()))
        };
        self.states.iter().enumerate().filter_map(error).collect()
    }

    /// The last energy.
    pub(super) fn last_energy(&self) -> f64 {
        self.states.last().map_or(f64::NAN, |state| state.energy)
    }
}

fn known(scenario: &Scenario, index: usize) -> Option<ReferenceRow> {
    scenario.reference.as_ref()?.at_step(index, scenario.time.step, 1)
}

/// The exact solution of a scenario over the time of its grid, where it is given by expressions.
pub(super) fn exact(scenario: &Scenario, quantity: Quantity) -> Vec<(f64, f64)> {
    let at = |index: usize| {
        let time = scenario.time.end() * index as f64 / EXACT_INTERVALS as f64;
        let row = scenario.reference.as_ref()?.at_time(time, 1)?;
        let value = match quantity {
            Quantity::Position => row.position[0],
            Quantity::Momentum => row.momentum[0],
            Quantity::Energy => row.energy,
        };
        Some((time, value?))
    };
    (0..=EXACT_INTERVALS).filter_map(at).collect()
}

fn value(state: &GridState, quantity: Quantity) -> f64 {
    match quantity {
        Quantity::Position => state.position[0],
        Quantity::Momentum => state.momentum[0],
        Quantity::Energy => state.energy,
    }
}

/// Motions over time, and the exact solution of a scenario over them.
pub(super) fn motion_chart(
    title: &str,
    subtitle: &str,
    quantity: Quantity,
    motions: &[&Motion],
    scenario: &Scenario,
) -> Chart {
    let axis = match quantity {
        Quantity::Position => "position q",
        Quantity::Momentum => "momentum p",
        Quantity::Energy => "energy ½ p² + ½ q²",
    };
    let mut chart = Chart::new(title, Axis::linear("time t"), Axis::linear(axis)).with_subtitle(subtitle);
    for motion in motions {
        // Grid points are marked where they are far enough apart to be distinguished.
        let style = if motion.states.len() <= 60 { Style::LineWithPoints } else { Style::Line };
        chart = chart.with(Series::new(&motion.label, style, motion.points(quantity)));
    }
    chart.with(Series::new("exact", Style::Reference, exact(scenario, quantity)))
}

/// A table of quantities of the motions, the motions one below the other.
pub(super) fn motion_table(
    name: &'static str,
    caption: &str,
    quantities: &[Quantity],
    motions: &[&Motion],
) -> Table {
    let columns: Vec<&str> = ["motion", "t"].into_iter().chain(quantities.iter().map(|q| q.name())).collect();
    let row = |motion: &Motion, state: &GridState| -> Vec<Cell> {
        let numbers = quantities.iter().map(|&quantity| value(state, quantity).into());
        [motion.label.as_str().into(), state.time.into()].into_iter().chain(numbers).collect()
    };
    let rows = motions.iter().flat_map(|motion| motion.states.iter().map(|state| row(motion, state)));
    Table::of_curves(name, caption, &columns, rows)
}
