//! Error against work: the papers' schemes, their baselines, Runge–Kutta convolution quadrature and damping
//! at the nodes side by side.

use super::error_curve::ErrorCurve;
use super::methods::{Look, MAIN_NODES, Method, NODES, RUNGE_KUTTA};
use super::motion::Motion;
use super::problems::{cube_plate, on_default_engine, on_grid, pendulum, pulse_plate};
use super::table::{Cell, Column, Format, Table};
use super::{Exhibit, Findings, ReproduceError};
use fvi_core::{max_or_nan, min_or_nan};
use fvi_host::converge::{Grids, converge};
use fvi_host::results::picture::{Axis, Chart, Series};
use fvi_scenario::scenario::{Reference, ReferenceRow, ReferenceSource, Scenario};
use std::sync::atomic::AtomicBool;

pub(super) const EXHIBITS: [Exhibit; 3] = [
    Exhibit::beyond(
        "work-precision-plate",
        "error against work, the plate under a pulse of [JO] Fig. 7",
        plate,
    ),
    Exhibit::beyond(
        "work-precision-pendulum",
        "error against work, a pendulum on a viscoelastic hinge",
        swinging,
    ),
    Exhibit::beyond(
        "work-precision-cubic",
        "error against work, the solution t³ of [HJO] Fig. 5 and 7",
        cubic,
    ),
];

/// Runs of each grid; the fastest counts.
pub(super) const REPEATS: usize = 3;

/// One run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Run {
    pub(super) steps: usize,
    /// Step size; the mean one, where steps differ.
    pub(super) step: f64,
    pub(super) error: f64,
    pub(super) seconds: f64,
}

/// The runs of a method that were stable and have a smaller error than q = 0, and how they are drawn.
pub(super) struct Measured {
    pub(super) label: &'static str,
    pub(super) look: Look,
    pub(super) runs: Vec<Run>,
}

/// A problem with the number of intervals of its coarsest grid and the levels of refinement.
pub(super) struct Comparison {
    pub(super) title: &'static str,
    pub(super) scenario: Scenario,
    pub(super) intervals: usize,
    pub(super) main_nodes: u32,
    pub(super) stages: u32,
    pub(super) orders: &'static [f64],
}

impl Comparison {
    pub(super) fn measure(&self, stop: &AtomicBool) -> Result<Vec<Measured>, ReproduceError> {
        let methods = MAIN_NODES.into_iter().chain(RUNGE_KUTTA).chain(NODES);
        methods.map(|method| self.measure_method(method, stop)).collect()
    }

    fn measure_method(&self, method: Method, stop: &AtomicBool) -> Result<Measured, ReproduceError> {
        let finest = if method.is_at_stages() { self.stages } else { self.main_nodes };
        let grids = Grids { levels: 1..=finest, intervals: self.intervals, from: 0.0 };
        let scenario = method.on(self.scenario.clone());
        let mut runs: Vec<Run> = Vec::new();
        for repeat in 0..REPEATS {
            let levels = converge(&scenario, &grids, stop, &mut |_, _| ())?.levels;
            let usable = levels.iter().filter(|level| {
                let position = &level.errors.position;
                level.failure.is_none() && position.largest <= position.reference_largest
            });
            for (index, level) in usable.enumerate() {
                let (error, seconds) = (level.errors.position.largest, level.seconds);
                match runs.get_mut(index) {
                    Some(run) if repeat > 0 => run.seconds = run.seconds.min(seconds),
                    _ => runs.push(Run { steps: level.steps, step: level.step, error, seconds }),
                }
            }
        }
        Ok(Measured { label: method.label, look: method.look(), runs })
    }

    fn findings(&self, stop: &AtomicBool) -> Result<Findings, ReproduceError> {
        Ok(self.page(&self.measure(stop)?))
    }

    /// Pictures and tables of what was measured.
    pub(super) fn page(&self, measured: &[Measured]) -> Findings {
        let chart = |label: &str, work: fn(&Run) -> f64| {
            let title = self.title;
            let mut chart = Chart::new(
                title,
                Axis::logarithmic(label),
                Axis::logarithmic("largest error of the position q"),
            );
            for of_method in measured {
                let points = of_method.runs.iter().map(|run| (work(run), run.error)).collect();
                chart = chart.with(of_method.look.curve(of_method.label, points));
            }
            chart
        };
        let mut by_steps = chart("number of steps", |run| run.steps as f64);
        for guide in guides(measured, self.orders) {
            by_steps = by_steps.with(guide);
        }
        let by_seconds = chart("time for all steps / s", |run| run.seconds);
        Findings::default()
            .with_picture("steps", format!("{}: error over the number of steps", self.title), by_steps)
            .with_picture("seconds", format!("{}: error over seconds", self.title), by_seconds)
            .with_table(summary(measured))
            .with_table(all_runs(measured))
            .with_remark(
                "Seconds are those of the machine that made this page: of the steps alone, without making weights, the fastest of \
                 three runs, with the memory engine that `fvi run` takes by default. Steps that are too long to be stable, and runs less \
                 accurate than q = 0 would be, are left out.",
            )
    }
}

/// Factor in the number of steps that the lines for the orders span.
const FAN: f64 = 3.0;

/// Factor that the lines and the labels at their ends span.
const LABELLED_FAN: f64 = 2.0 * FAN;

/// Lines of the given orders that fan out from one place to the left, below all curves.
fn guides(measured: &[Measured], orders: &[f64]) -> Vec<Series> {
    let runs = || measured.iter().flat_map(|of_method| &of_method.runs);
    let first = runs().map(|run| run.steps as f64).fold(f64::INFINITY, min_or_nan);
    let lowest =
        |runs: &mut dyn Iterator<Item = &Run>| runs.map(|run| run.error).fold(f64::INFINITY, min_or_nan);
    let start = (first, lowest(&mut runs().filter(|run| run.steps as f64 <= LABELLED_FAN * first)) / 3.0);
    let floor = lowest(&mut runs());
    let line = |&order: &f64| {
        let end = first * libm::pow(start.1 / floor, 1.0 / order).clamp(1.0, FAN);
        Series::slope(format!("order {order}"), -order, start, first, end)
    };
    orders.iter().map(line).collect()
}

/// Errors for which the summary lists the work.
const GOALS: [f64; 3] = [1e-3, 1e-6, 1e-9];

/// For each method its order and the first grid on which it meets each goal.
fn summary(measured: &[Measured]) -> Table {
    let mut columns = vec![Column::new("method", Format::Exact), Column::new("order", Format::Order)];
    for goal in ["10⁻³", "10⁻⁶", "10⁻⁹"] {
        columns.push(Column::new(format!("steps to {goal}"), Format::Exact));
        columns.push(Column::new(format!("seconds to {goal}"), Format::Error));
    }
    let row = |of_method: &Measured| -> Vec<Cell> {
        let curve = above_rounding(&of_method.runs);
        let order = Some(curve.slope_of_finest(3)).filter(|order| order.is_finite());
        let mut cells: Vec<Cell> = vec![of_method.label.into(), order.into()];
        for goal in GOALS {
            let first = of_method.runs.iter().find(|run| run.error <= goal);
            cells.push(first.map(|run| run.steps as f64).into());
            cells.push(first.map(|run| run.seconds).into());
        }
        cells
    };
    let table = Table::new(
        "",
        "Order on the three finest grids above rounding, and the work to reach an error",
        columns,
    );
    Table { rows: measured.iter().map(row).collect(), ..table }
}

/// The curve without the finest grids, from the one where rounding stops its decrease.
fn above_rounding(runs: &[Run]) -> ErrorCurve {
    ErrorCurve::new("", runs.iter().map(|run| (run.step, run.error)).collect()).above_rounding()
}

fn all_runs(measured: &[Measured]) -> Table {
    let rows = measured.iter().flat_map(|of_method| {
        let row = |run: &Run| -> Vec<Cell> {
            let numbers = [run.steps as f64, run.step, run.error, run.seconds];
            [of_method.label.into()].into_iter().chain(numbers.map(Cell::from)).collect()
        };
        of_method.runs.iter().map(row).collect::<Vec<_>>()
    });
    Table::of_curves("runs", "All runs", &["method", "steps", "h", "position_error", "seconds"], rows)
}

fn plate(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let comparison = Comparison {
        title: "Plate under a pulse: error against work",
        scenario: on_default_engine(pulse_plate()?),
        // The pulse ends at t = 1, a grid point on every level.
        intervals: 30,
        main_nodes: 8,
        stages: 6,
        orders: &[1.0, 2.0, 3.0, 5.0],
    };
    comparison.findings(stop)
}

fn cubic(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let comparison = Comparison {
        title: "Solution t³: error against work",
        scenario: on_default_engine(cube_plate()?),
        intervals: 2,
        main_nodes: 12,
        stages: 9,
        orders: &[1.0, 2.0, 3.0, 5.0],
    };
    comparison.findings(stop)
}

fn swinging(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let (scenario, uncertainty) = with_fine_reference(on_default_engine(pendulum()?), REFERENCE_STEPS, stop)?;
    let comparison = Comparison {
        title: "Pendulum on a viscoelastic hinge: error against work",
        scenario,
        intervals: 32,
        main_nodes: 8,
        stages: 6,
        orders: &[1.0, 2.0, 3.0, 5.0],
    };
    Ok(comparison.findings(stop)?.with_remark(format!(
        "No solution in closed form is known: errors are differences from a run of {} with {REFERENCE_STEPS} steps, from which \
         {} with as many steps differs by {uncertainty:.0e} at most.",
        REFERENCE_METHODS[0].label, REFERENCE_METHODS[1].label,
    )))
}

/// Steps of the run that the pendulum's errors are measured against: a multiple of those of every grid.
const REFERENCE_STEPS: usize = 8192;

/// The most accurate methods: the reference, and the one that its error is estimated with.
const REFERENCE_METHODS: [Method; 2] = [RUNGE_KUTTA[5], RUNGE_KUTTA[2]];

/// The scenario with a fine run for its reference, and the largest difference from another method's run.
fn with_fine_reference(
    mut scenario: Scenario,
    steps: usize,
    stop: &AtomicBool,
) -> Result<(Scenario, f64), ReproduceError> {
    let step = scenario.time.end() / steps as f64;
    let run =
        |method: Method| Motion::run(method.label, &method.on(on_grid(scenario.clone(), step, steps)), stop);
    let [fine, other] = REFERENCE_METHODS.map(run);
    let (fine, other) = (fine?, other?);
    let difference = fine
        .states
        .iter()
        .zip(&other.states)
        .map(|(fine, other)| (fine.position[0] - other.position[0]).abs());
    let difference = difference.fold(0.0, max_or_nan);
    let known = |numbers: &[f64]| numbers.iter().map(|&number| Some(number)).collect();
    let row = |state: &fvi_simulation::simulation::GridState| ReferenceRow {
        time: state.time,
        position: known(&state.position),
        momentum: known(&state.momentum),
        energy: Some(state.energy),
        undefined: 0,
    };
    let rows = fine.states.iter().map(row).collect();
    let source = ReferenceSource::Table { file: format!("{} with {steps} steps", fine.label), rows };
    scenario.reference = Some(Reference { source });
    Ok((scenario, difference))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Observed order of every method by its label.
    fn orders(comparison: &Comparison) -> Vec<(&'static str, f64)> {
        let measured = comparison.measure(&AtomicBool::new(false)).unwrap();
        let order = |of_method: &Measured| above_rounding(&of_method.runs).slope_of_finest(3);
        measured.iter().map(|of_method| (of_method.label, order(of_method))).collect()
    }

    #[test]
    fn every_method_has_its_order_on_the_solution_of_the_third_power() {
        let comparison = Comparison {
            title: "",
            scenario: cube_plate().unwrap(),
            intervals: 2,
            main_nodes: 7,
            stages: 5,
            orders: &[],
        };
        let expected = [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0];
        let orders = orders(&comparison);
        assert_eq!(orders.len(), 18);
        for ((label, order), expected) in orders.into_iter().zip(expected) {
            assert!((order - expected).abs() < 0.15, "{label}: {order} for {expected}");
        }
    }

    #[test]
    fn the_reference_of_the_pendulum_is_confirmed_by_another_method() {
        let (scenario, difference) =
            with_fine_reference(pendulum().unwrap(), 1024, &AtomicBool::new(false)).unwrap();
        assert!(difference > 0.0 && difference < 1e-7, "{difference}");
        assert!(scenario.reference.unwrap().at_step(512, 20.0 / 1024.0, 1).is_some());
    }
}
