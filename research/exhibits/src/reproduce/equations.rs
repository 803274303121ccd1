//! Fractional differential equations of other people's test sets: error against time, beside the methods of
//! the literature.

mod problems;

use self::problems::{PROBLEMS, Problem};
use super::methods::Look;
use super::table::{Cell, Column, Format, Table};
use super::{Exhibit, Findings, ReproduceError};
use fvi_host::results::picture::{Axis, Chart, Marker};
use fvi_host::run::{Run as HostRun, RunEnd};
use fvi_rivals::FixedStep;
use fvi_strategies::Machine;
use std::convert::Infallible;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Name of the page.
pub(super) const PAGE: &str = "equations.md";

pub(super) const EXHIBITS: [Exhibit; 1] = [Exhibit::beyond(
    "equations",
    "fractional differential equations, error against time beside the methods of the literature",
    compute,
)
.on_page(PAGE)];

/// Head of the page.
pub(super) const HEAD: &str = "# Fractional differential equations on published test problems\n\n\
    `fvi reproduce equations --out book/src/assurance` writes this page, its pictures and the CSV files behind them. How equations are written: \
    [equations.md](../use/equations.md).\n";

const TOLERANCES: [f64; 10] = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12];

/// How much is measured.
struct Effort {
    problems: &'static [Problem],
    tolerances: &'static [f64],
    /// The number of steps of a method of the literature is doubled until it takes so long, in seconds.
    longest: f64,
    /// Runs of each kind; the fastest counts.
    repeats: usize,
}

/// One run.
#[derive(Clone, Debug)]
struct Run {
    /// Asked for; `None` for steps of one length.
    tolerance: Option<f64>,
    steps: usize,
    /// Relative to the largest known value where that is above 1; `None` if the run failed.
    error: Option<f64>,
    seconds: f64,
    /// The slowest repetition over the fastest.
    spread: f64,
    /// Why it failed.
    refused: String,
}

/// The runs of a method.
struct Measured {
    label: &'static str,
    look: Look,
    runs: Vec<Run>,
}

/// Repeats a computation that gives a result and its seconds; the spread of the seconds.
fn fastest<T>(
    repeats: usize,
    mut compute: impl FnMut() -> Result<(T, f64), ReproduceError>,
) -> Result<(T, f64, f64), ReproduceError> {
    let (mut result, mut least) = compute()?;
    let mut most = least;
    for _ in 1..repeats {
        let (next, seconds) = compute()?;
        most = most.max(seconds);
        (result, least) = (next, least.min(seconds));
    }
    Ok((result, least, most / least))
}

/// A run of fvi to a tolerance: its preparation and its steps.
fn adaptive(
    problem: &Problem,
    tolerance: f64,
    repeats: usize,
    stop: &AtomicBool,
) -> Result<Run, ReproduceError> {
    let scenario = problem.scenario(tolerance)?;
    let ((steps, error, refused), seconds, spread) = fastest(repeats, || {
        let clock = Instant::now();
        let mut run = HostRun::of(&scenario).start()?;
        let Ok(end) = run.drive(stop, |_| Ok::<_, Infallible>(()));
        let seconds = clock.elapsed().as_secs_f64();
        let summary = run.summary(end);
        let measure = summary.errors.unwrap_or_default().position;
        let error = measure.largest / measure.reference_largest.max(1.0);
        let (error, refused) = match summary.end {
            RunEnd::Completed | RunEnd::Event { .. } => (Some(error), String::new()),
            RunEnd::Stopped => return Err(ReproduceError::Stopped),
            RunEnd::Failed { reason, .. } => (None, reason),
        };
        Ok(((summary.steps, error, refused), seconds))
    })?;
    Ok(Run { tolerance: Some(tolerance), steps, error, seconds, spread, refused })
}

/// A method of the literature on finer and finer grids.
fn refined(
    problem: &Problem,
    method: FixedStep,
    effort: &Effort,
    stop: &AtomicBool,
) -> Result<Vec<Run>, ReproduceError> {
    let equation = problem.equation();
    let mut runs: Vec<Run> = Vec::new();
    let mut steps = problem.coarsest;
    if !method.is_for(&equation) {
        return Ok(runs);
    }
    loop {
        if stop.load(Ordering::Relaxed) {
            return Err(ReproduceError::Stopped);
        }
        let (solution, seconds, spread) = fastest(effort.repeats, || {
            let clock = Instant::now();
            let solution = method.solve(&equation, problem.end, steps);
            Ok((solution, clock.elapsed().as_secs_f64()))
        })?;
        // A method that is not stable with long steps is right with shorter ones.
        if let Ok(x) = solution {
            let error = Some(problem.error(&x, steps)).filter(|&error| error <= 1.0);
            runs.push(Run { tolerance: None, steps, error, seconds, spread, refused: String::new() });
        }
        steps *= 2;
        // The next grid takes more than twice as long.
        if 2.0 * seconds > effort.longest {
            return Ok(runs);
        }
    }
}

const FVI: &str = "fvi";

impl Effort {
    fn measure(&self, problem: &Problem, stop: &AtomicBool) -> Result<Vec<Measured>, ReproduceError> {
        let mut own = Vec::new();
        for &tolerance in self.tolerances {
            own.push(adaptive(problem, tolerance, self.repeats, stop)?);
        }
        let mut measured =
            vec![Measured { label: FVI, look: Look { colour: 0, marker: Marker::Disc }, runs: own }];
        for (index, method) in FixedStep::ALL.into_iter().enumerate() {
            let look = Look { colour: index + 1, marker: Marker::Square };
            let runs = refined(problem, method, self, stop)?;
            measured.push(Measured { label: method.name(), look, runs });
        }
        Ok(measured)
    }

    fn findings(&self, stop: &AtomicBool) -> Result<Findings, ReproduceError> {
        let (mut findings, mut kept, mut all) = (Findings::default(), kept_table(), Vec::new());
        let mut summary = summary_table();
        let mut spreads: Vec<f64> = Vec::new();
        for problem in self.problems {
            let measured = self.measure(problem, stop)?;
            findings =
                findings.with_picture(problem.name, picture_caption(problem), chart(problem, &measured));
            for row in kept_rows(problem, &measured[0].runs) {
                kept = kept.with_row(row);
            }
            for row in summary_rows(problem, &measured) {
                summary = summary.with_row(row);
            }
            for of_method in &measured {
                spreads.extend(of_method.runs.iter().map(|run| run.spread));
                all.extend(of_method.runs.iter().map(|run| full_row(problem, of_method.label, run)));
            }
        }
        spreads.sort_by(f64::total_cmp);
        let Machine { processor, threads, system, compiler, .. } = Machine::here();
        let names = ["problem", "method", "tolerance", "steps", "error", "seconds", "spread", "refused"];
        let remark = format!(
            "{processor}, {threads} threads, {system}, {compiler}. Seconds are the fastest of {} runs, the slowest of which took {:.2} times as long \
             in the median and {:.1} times at most; runs of fvi with their preparation, without reading the file, right sides as expressions; methods of the literature with their \
             weights, right sides compiled, sums by relaxed multiplication.",
            self.repeats,
            spreads[spreads.len() / 2],
            spreads[spreads.len() - 1],
        );
        Ok(findings
            .with_table(kept)
            .with_table(summary)
            .with_table(Table::of_curves("runs", "All runs", &names, all))
            .with_remark(remark)
            .with_remark(METHODS))
    }
}

const METHODS: &str = "The methods (`research/rivals/src/fixed_step.rs`) are those of the programs fde_pi1_im, fde_pi2_im, fde_pi12_pc [Gar18] and flmm2 [Gar15], \
    written from the papers, with steps of one length; the fractional BDF is for one order of all unknowns. Errors are the largest over all grid points where a formula is known, and \
    otherwise at the times of the table beside the scenario that are grid points, which for `relaxation` leaves out the fast \
    beginning for methods with steps of one length. Starting weights make the powers t^⅓ and t^⅔ of `cubic` exact, so that the fractional BDF \
    solves it to rounding with any step. Not measured here: fhbvm2 and the programs in MATLAB and Julia themselves.";

fn picture_caption(problem: &Problem) -> String {
    format!("{}: error over seconds", problem.title)
}

fn chart(problem: &Problem, measured: &[Measured]) -> Chart {
    let mut chart =
        Chart::new(problem.title, Axis::logarithmic("time / s"), Axis::logarithmic("largest error"));
    for of_method in measured {
        let points: Vec<(f64, f64)> =
            of_method.runs.iter().filter_map(|run| Some((run.seconds, run.error?))).collect();
        if !points.is_empty() {
            chart = chart.with(of_method.look.curve(of_method.label, points));
        }
    }
    chart
}

fn kept_table() -> Table {
    let mut columns = vec![Column::new("problem", Format::Exact)];
    columns.extend(TOLERANCES.map(|tolerance| Column::new(format!("{tolerance:e}"), Format::Error)));
    Table::new("tolerances", "Errors of fvi in units of the tolerance; – where it refuses", columns)
}

fn kept_rows(problem: &Problem, runs: &[Run]) -> Vec<Vec<Cell>> {
    let of = |tolerance: f64| {
        let run = runs.iter().find(|run| run.tolerance == Some(tolerance))?;
        Some(run.error? / tolerance)
    };
    let mut row: Vec<Cell> = vec![problem.name.into()];
    row.extend(TOLERANCES.map(|tolerance| Cell::from(of(tolerance))));
    vec![row]
}

fn summary_table() -> Table {
    let columns = vec![
        Column::new("problem", Format::Exact),
        Column::new("error", Format::Exact),
        Column::new("steps of fvi", Format::Exact).headed("steps"),
        Column::new("seconds of fvi", Format::Error).headed("seconds"),
        Column::new("fastest method of the literature", Format::Exact),
        Column::new("its steps", Format::Exact).headed("steps"),
        Column::new("its seconds", Format::Error).headed("seconds"),
    ];
    Table::new(
        "",
        "The fastest run of each with an error of at most so much; – where none was found",
        columns,
    )
}

/// Errors for which the summary lists the work.
const GOALS: [f64; 4] = [1e-3, 1e-6, 1e-9, 1e-12];

fn summary_rows(problem: &Problem, measured: &[Measured]) -> Vec<Vec<Cell>> {
    let row = |goal: f64| -> Vec<Cell> {
        let meets = |run: &&Run| run.error.is_some_and(|error| error <= goal);
        let fastest = |of: &Measured| {
            let runs = of.runs.iter().filter(meets);
            runs.min_by(|a, b| a.seconds.total_cmp(&b.seconds)).cloned()
        };
        let own = fastest(&measured[0]);
        let others = measured[1..].iter().filter_map(|of| Some((of.label, fastest(of)?)));
        let best = others.min_by(|a, b| a.1.seconds.total_cmp(&b.1.seconds));
        vec![
            problem.name.into(),
            format!("{goal:e}").as_str().into(),
            own.as_ref().map(|run| run.steps as f64).into(),
            own.map(|run| run.seconds).into(),
            best.as_ref().map_or(Cell::Empty, |(label, _)| (*label).into()),
            best.as_ref().map(|(_, run)| run.steps as f64).into(),
            best.map(|(_, run)| run.seconds).into(),
        ]
    };
    GOALS.into_iter().map(row).collect()
}

fn full_row(problem: &Problem, label: &str, run: &Run) -> Vec<Cell> {
    vec![
        problem.name.into(),
        label.into(),
        run.tolerance.into(),
        (run.steps as f64).into(),
        run.error.into(),
        run.seconds.into(),
        run.spread.into(),
        if run.refused.is_empty() { Cell::Empty } else { run.refused.as_str().into() },
    ]
}

fn compute(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    Effort { problems: &PROBLEMS, tolerances: &TOLERANCES, longest: 0.3, repeats: 3 }.findings(stop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_are_kept_and_methods_of_the_literature_converge() {
        let stop = AtomicBool::new(false);
        for problem in &PROBLEMS {
            let own = adaptive(problem, 1e-5, 1, &stop).unwrap();
            assert!(own.error.unwrap() <= 1e-4, "{}: {own:?}", problem.name);
            for method in FixedStep::ALL {
                let equation = problem.equation();
                let error = |doublings: u32| {
                    let steps = problem.coarsest << doublings;
                    method.solve(&equation, problem.end, steps).map(|x| problem.error(&x, steps))
                };
                // The predictor–corrector is not stable with rates of 10⁴.
                if !method.is_for(&equation)
                    || (method == FixedStep::PredictorCorrector && problem.name == "stiff")
                {
                    continue;
                }
                let errors = [3, 5].map(|doublings| error(doublings).unwrap());
                // The fractional BDF makes the powers of `cubic` exact. The rectangle damps what oscillates.
                let falls = errors[1] < errors[0] || errors[1] < 1e-14;
                assert!(falls, "{}, {}: {errors:?}", problem.name, method.name());
            }
        }
    }
}
