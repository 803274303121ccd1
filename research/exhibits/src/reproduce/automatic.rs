//! `scheme.kind = "auto"` beside schemes, grids and steps chosen by hand, on ten problems.

use super::table::{Cell, Column, Format, Table};
use super::{Exhibit, Findings, ReproduceError};
use fvi_core::max_or_nan;
use fvi_fft::memory::Tables;
use fvi_host::results::rows::Rows;
use fvi_host::run::{Chosen, Run, RunEnd, RunError, choose};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Precision;
use fvi_strategies::Machine;
use std::convert::Infallible;
use std::fmt::Write as _;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Name of the page.
pub(super) const PAGE: &str = "automatic.md";

pub(super) const EXHIBITS: [Exhibit; 1] = [Exhibit::beyond(
    "automatic",
    "a tolerance in place of a scheme, beside the best choice by hand",
    compute,
)
.on_page(PAGE)];

/// Head of the page.
pub(super) const HEAD: &str = "# A tolerance in place of a scheme: errors and time\n\n\
    `fvi reproduce automatic --out book/src/assurance` writes this page and the CSV files behind it. What `kind = \"auto\"` promises: \
    [choosing.md](../start/choosing.md#a-tolerance-in-place-of-a-scheme).\n";

const TOLERANCES: [f64; 8] = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10];

/// The text of a scenario whose last tables, from `[scheme]` on, ask for a tolerance.
macro_rules! carried {
    ($name:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/automatic/", $name, ".toml"))
    };
}

/// A test problem.
struct Problem {
    name: &'static str,
    text: &'static str,
    end: f64,
    rows: Vec<f64>,
    /// Steps of the coarsest equal grid, whose grid points the rows are; none where rows are decades.
    coarsest: Option<usize>,
    /// Scheme and grid of the reference, which are none of those compared.
    reference: (&'static str, Grid),
}

#[derive(Clone, Copy)]
enum Grid {
    Equal(usize),
    Graded(usize),
    /// Steps grow by this part of themselves.
    Geometric(f64),
    Adaptive(f64),
}

/// One run.
struct Measured {
    label: String,
    scenario: Scenario,
    /// As `auto` measures it.
    error: f64,
    seconds: f64,
    /// The slowest repetition over the fastest.
    spread: f64,
}

const SEVEN: &str = "[scheme]\nkind = 'collocation'\n[convolution]\nfamily = 'radau-iia'\nstages = 7\n";

fn problems() -> Vec<Problem> {
    let at_equal = |name: &'static str, text: &'static str, end: f64, rows: usize| Problem {
        name,
        text,
        end,
        rows: (1..=rows).map(|row| end * row as f64 / rows as f64).collect(),
        coarsest: Some(rows),
        reference: (SEVEN, Grid::Adaptive(1e-12)),
    };
    let stage = at_equal("stage", carried!("stage"), 8.0, 20);
    let floating = at_equal("floating-body", carried!("floating-body"), 20.0, 20);
    let multistep = "[scheme]\nkind = 'galerkin'\ndegree = 4\n[convolution]\norder = 6\n";
    vec![
        at_equal("oscillator", carried!("oscillator"), 20.0, 20),
        at_equal("pendulum", carried!("pendulum"), 20.0, 20),
        at_equal("plate", carried!("plate"), 30.0, 30),
        at_equal("zener", carried!("zener"), 20.0, 20),
        at_equal("chain", carried!("chain"), 20.0, 20),
        // A step divides the time between samples.
        Problem { coarsest: Some(800), reference: (SEVEN, Grid::Equal(25600)), ..stage },
        at_equal("wall", carried!("wall"), 10.0, 20),
        at_equal("duffing", carried!("duffing"), 50.0, 25),
        Problem {
            rows: (-4..=6).map(|exponent| format!("1e{exponent}").parse().unwrap_or(f64::NAN)).collect(),
            coarsest: None,
            ..at_equal("creep", carried!("creep"), 1e6, 1)
        },
        Problem { reference: (multistep, Grid::Equal(10240)), ..floating },
    ]
}

/// Schemes by hand, each with its convolution quadrature and whether steps may differ.
fn by_hand() -> Vec<(String, String, bool)> {
    let mut all = vec![(
        "midpoint, BDF 2".to_owned(),
        "[scheme]\nkind = 'low-order'\n[convolution]\norder = 2\n".to_owned(),
        false,
    )];
    let mut galerkin = |degree: usize, label: &str, keys: &str, may_differ: bool| {
        all.push((
            format!("Galerkin {degree}, {label}"),
            format!("[scheme]\nkind = 'galerkin'\ndegree = {degree}\n[convolution]\n{keys}\n"),
            may_differ,
        ));
    };
    for (degree, order) in [(2, 3), (2, 4), (3, 5), (3, 6), (4, 6)] {
        galerkin(degree, &format!("BDF {order}"), &format!("order = {order}"), false);
    }
    (1..=4).for_each(|degree| galerkin(degree, "Gauss", "family = 'gauss'", false));
    for stages in [2, 3] {
        galerkin(stages, "Radau IIA", &format!("family = 'radau-iia'\nstages = {stages}"), false);
    }
    for stages in [1, 2, 3, 5, 7] {
        let text = format!(
            "[scheme]\nkind = 'collocation'\n[convolution]\nfamily = 'radau-iia'\nstages = {stages}\n"
        );
        all.push((format!("collocation, {stages} stages"), text, stages > 1));
    }
    all
}

/// The finer and finer grids of a scheme.
fn ladders(problem: &Problem, may_differ: bool) -> Vec<Vec<Grid>> {
    let mut ladders = Vec::new();
    if let Some(coarsest) = problem.coarsest {
        ladders.push((0..15).map(|doublings| Grid::Equal(coarsest << doublings)).collect());
    }
    // Controllers and oscillating kernels refuse them.
    if may_differ {
        ladders.push((4..14).map(|doublings| Grid::Graded(1 << doublings)).collect());
        ladders.push((2..13).map(|digits| Grid::Adaptive(libm::exp10(-f64::from(digits)))).collect());
        if problem.coarsest.is_none() {
            ladders.push((0..7).map(|halvings| Grid::Geometric(libm::exp2(-f64::from(halvings)))).collect());
        }
    }
    ladders
}

impl Problem {
    /// The system with a scheme, then the tables of times and rows.
    fn on(&self, scheme: &str, grid: Grid) -> String {
        let system = self.text.split("[scheme]").next().unwrap_or_default();
        let (end, rows) = (self.end, &self.rows);
        let times = match grid {
            Grid::Equal(steps) => format!("step = {:?}\nsteps = {steps}", end / steps as f64),
            Grid::Graded(steps) => {
                format!("grid = 'graded'\nexponent = 3.0\nsteps = {steps}\nend = {end:?}")
            }
            Grid::Geometric(part) => format!(
                "grid = 'geometric'\nfirst = {:?}\nratio = {:?}\nend = {end:?}",
                1e-6 * part,
                1.0 + part
            ),
            Grid::Adaptive(tolerance) => {
                format!("grid = 'adaptive'\ntolerance = {tolerance:e}\nend = {end:?}")
            }
        };
        let mut text = format!("{system}{scheme}[time]\n{times}\n");
        if !matches!(grid, Grid::Equal(_)) {
            let _ = writeln!(text, "must_hit = {:?}", &rows[..rows.len() - 1]);
        }
        text + &format!("[output]\ntimes = {rows:?}\n")
    }

    /// The file with another tolerance.
    fn asked(&self, tolerance: f64) -> Result<Scenario, ReproduceError> {
        Ok(self.text.replace("tolerance = 1e-6", &format!("tolerance = {tolerance:e}")).parse()?)
    }

    /// Largest error of positions and momenta at the rows, each relative to its coordinate's largest value.
    fn error(&self, rows: &Rows, exact: &Rows) -> f64 {
        let column = |numbers: &[f64], index: usize| -> Vec<f64> {
            numbers.iter().skip(index).step_by(exact.coordinates.max(1)).copied().collect()
        };
        let same = |one: f64, other: f64| (one - other).abs() <= 1e-9 * other;
        let mut most = 0.0;
        for of in [|rows: &Rows| rows.position.clone(), |rows: &Rows| rows.momentum.clone()] {
            let (found, known) = (of(rows), of(exact));
            let all = known.iter().fold(0.0, |most, number: &f64| max_or_nan(most, number.abs()));
            for index in 0..exact.coordinates {
                let (found, known) = (column(&found, index), column(&known, index));
                let own = known.iter().fold(1e-3 * all, |most, number| max_or_nan(most, number.abs()));
                for &time in &self.rows {
                    let place = |rows: &Rows| rows.time.iter().position(|&other| same(other, time));
                    let (Some(one), Some(other)) = (place(rows), place(exact)) else { return f64::NAN };
                    most = max_or_nan(most, (found[one] - known[other]).abs() / own);
                }
            }
        }
        most
    }
}

/// The rows and the seconds of a run, its preparation with them; `None` if it is refused or fails.
fn run(scenario: &Scenario, stop: &AtomicBool) -> Result<Option<(Rows, f64)>, ReproduceError> {
    let clock = Instant::now();
    let Ok(mut run) = Run::of(scenario).start() else { return Ok(None) };
    let mut rows = Rows::for_run(scenario);
    let Ok(end) = run.drive(stop, |portion| {
        portion.keep(std::slice::from_mut(&mut rows));
        Ok::<_, Infallible>(())
    });
    match end {
        RunEnd::Completed => Ok(Some((rows, clock.elapsed().as_secs_f64()))),
        RunEnd::Stopped => Err(ReproduceError::Stopped),
        RunEnd::Failed { .. } | RunEnd::Event { .. } => Ok(None),
    }
}

/// The fastest of some runs.
fn measured(
    (problem, exact): (&Problem, &Rows),
    (label, scenario): (&str, &Scenario),
    (repeats, stop): (usize, &AtomicBool),
) -> Result<Option<Measured>, ReproduceError> {
    let Some((rows, mut least)) = run(scenario, stop)? else { return Ok(None) };
    let mut most = least;
    for _ in 1..repeats {
        let Some((_, seconds)) = run(scenario, stop)? else { return Ok(None) };
        (least, most) = (least.min(seconds), most.max(seconds));
    }
    let error = problem.error(&rows, exact);
    let (label, scenario) = (label.to_owned(), scenario.clone());
    Ok(Some(Measured { label, scenario, error, seconds: least, spread: most / least }))
}

/// All runs by hand, of each scheme on finer and finer grids until its error is below every tolerance.
fn runs_by_hand(
    problem: &Problem,
    exact: &Rows,
    repeats: usize,
    stop: &AtomicBool,
) -> Result<Vec<Measured>, ReproduceError> {
    let mut all = Vec::new();
    for (label, scheme, may_differ) in by_hand() {
        for ladder in ladders(problem, may_differ) {
            let mut failed = 0;
            for grid in ladder {
                let (of, finer) = match grid {
                    Grid::Equal(steps) => ("equal", steps as f64),
                    Grid::Graded(steps) => ("graded", steps as f64),
                    Grid::Geometric(part) => ("geometric", part),
                    Grid::Adaptive(tolerance) => ("adaptive", tolerance),
                };
                let label = format!("{label}; {of}, {finer}");
                let Ok(scenario) = problem.on(&scheme, grid).parse::<Scenario>() else { break };
                let Some(run) = measured((problem, exact), (&label, &scenario), (repeats, stop))? else {
                    failed += 1;
                    if failed > 6 {
                        break;
                    }
                    continue;
                };
                let is_last = run.error < TOLERANCES[TOLERANCES.len() - 1] || run.seconds > LONGEST;
                all.push(run);
                if is_last {
                    break;
                }
            }
        }
    }
    Ok(all)
}

/// Runs by hand are not made finer beyond this time, in seconds.
const LONGEST: f64 = 0.06;

/// Runs of each kind; the fastest counts. Those of the tables are made again, more often.
const REPEATS: usize = 2;
const OF_TABLES: usize = 15;

/// The choice, its run, and the seconds of both together.
fn automatic(
    problem: &Problem,
    exact: &Rows,
    tolerance: f64,
    (repeats, stop): (usize, &AtomicBool),
) -> Result<Option<(Measured, f64)>, ReproduceError> {
    let asked = problem.asked(tolerance)?;
    let mut with_choice = f64::INFINITY;
    let mut scenario = asked.clone();
    for _ in 0..repeats.min(5) {
        let clock = Instant::now();
        match choose(&asked, Precision::F64, &Tables::default(), stop) {
            Ok(Chosen { scenario: chosen, .. }) => scenario = chosen,
            Err(RunError::Stopped) => return Err(ReproduceError::Stopped),
            Err(_) => return Ok(None),
        }
        if run(&scenario, stop)?.is_none() {
            return Ok(None);
        }
        with_choice = with_choice.min(clock.elapsed().as_secs_f64());
    }
    let label = format!("{}; {}", scenario.scheme.describe(), scenario.time.describe());
    let own = measured((problem, exact), (&label, &scenario), (repeats, stop))?;
    Ok(own.map(|own| (own, with_choice)))
}

/// The fastest run by hand that reaches a tolerance: the few fastest are made again.
fn best_by_hand(
    problem: &Problem,
    (exact, hand): (&Rows, &[Measured]),
    tolerance: f64,
    stop: &AtomicBool,
) -> Result<Option<Measured>, ReproduceError> {
    let mut reach: Vec<&Measured> = hand.iter().filter(|run| run.error <= tolerance).collect();
    reach.sort_by(|one, other| one.seconds.total_cmp(&other.seconds));
    let mut best: Option<Measured> = None;
    for run in reach.into_iter().take(4) {
        let again = measured((problem, exact), (&run.label, &run.scenario), (OF_TABLES, stop))?;
        let seconds = |run: &Option<Measured>| run.as_ref().map_or(f64::INFINITY, |run| run.seconds);
        if seconds(&again) < seconds(&best) {
            best = again;
        }
    }
    Ok(best)
}

fn table(name: &'static str, caption: &str, format: Format) -> Table {
    let mut columns = vec![Column::new("problem", Format::Exact)];
    columns.extend(TOLERANCES.map(|tolerance| Column::new(format!("{tolerance:e}"), format)));
    Table::new(name, caption, columns)
}

fn compute(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let errors = "Errors of `auto` in units of the tolerance; – where it refuses";
    let runs =
        "Time of the run that `auto` chose, over that of the fastest by hand that reaches the tolerance";
    let both = "The same with the short runs by which it chose";
    let mut errors = table("errors", errors, Format::Order);
    let mut runs = table("runs", runs, Format::Order);
    let mut both = table("choice", both, Format::Order);
    let (mut all, mut spreads) = (Vec::new(), Vec::new());
    for problem in problems() {
        let (scheme, grid) = problem.reference;
        let Some((exact, _)) = run(&problem.on(scheme, grid).parse()?, stop)? else {
            let reason = format!("{}: the reference fails", problem.name);
            return Err(ReproduceError::Run { reason });
        };
        let hand = runs_by_hand(&problem, &exact, REPEATS, stop)?;
        let mut rows: [Vec<Cell>; 3] = std::array::from_fn(|_| vec![problem.name.into()]);
        for tolerance in TOLERANCES {
            let own = automatic(&problem, &exact, tolerance, (OF_TABLES, stop))?;
            let best = best_by_hand(&problem, (&exact, &hand), tolerance, stop)?;
            let over = |seconds: f64| best.as_ref().map(|best| seconds / best.seconds);
            rows[0].push(own.as_ref().map(|(own, _)| own.error / tolerance).into());
            rows[1].push(own.as_ref().and_then(|(own, _)| over(own.seconds)).into());
            rows[2].push(own.as_ref().and_then(|&(_, seconds)| over(seconds)).into());
            for run in own.iter().map(|(own, _)| own).chain(&best) {
                spreads.push(run.spread);
                let numbers = [tolerance, run.error, run.seconds, run.spread].map(Cell::from);
                all.push(
                    [problem.name.into(), run.label.as_str().into()].into_iter().chain(numbers).collect(),
                );
            }
        }
        let [of_errors, of_runs, of_both] = rows;
        (errors, runs, both) = (errors.with_row(of_errors), runs.with_row(of_runs), both.with_row(of_both));
    }
    spreads.sort_by(f64::total_cmp);
    let Machine { processor, threads, system, compiler, .. } = Machine::here();
    let remark = format!(
        "{processor}, {threads} threads, {system}, {compiler}. Times are the fastest of {OF_TABLES}, preparation and steps; the slowest took {:.2} times as \
         long in the median and {:.1} times at most. Errors are those of positions and momenta at the rows of the file, each relative to the largest \
         value of its coordinate. By hand: the midpoint rule, Galerkin schemes of degree 1 to 4 with BDF, Gauss and Radau IIA, collocation of 1 to 7 \
         stages, on equal, graded, geometric and adaptive steps, twice as fine each time; whoever chooses by hand has to know which one, and that it is fine enough.",
        spreads[spreads.len() / 2],
        spreads[spreads.len() - 1],
    );
    let names = ["problem", "run", "tolerance", "error", "seconds", "spread"];
    Ok(findings_of(
        [errors, runs, both],
        Table::of_curves("all", "All runs of the tables", &names, all),
        remark,
    ))
}

fn findings_of(tables: [Table; 3], all: Table, remark: String) -> Findings {
    let shown = tables.into_iter().fold(Findings::default(), Findings::with_table);
    shown.with_table(all).with_remark(remark)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tolerance_is_kept_or_refused_on_all_problems() {
        let stop = AtomicBool::new(false);
        for problem in problems() {
            let (scheme, grid) = problem.reference;
            let (exact, _) = run(&problem.on(scheme, grid).parse().unwrap(), &stop).unwrap().unwrap();
            for tolerance in [1e-3, 1e-6, 1e-9] {
                let own = automatic(&problem, &exact, tolerance, (1, &stop)).unwrap();
                let Some((own, _)) = own else { continue };
                // The reference is known to some 10⁻¹¹.
                assert!(own.error <= tolerance + 1e-11, "{} to {tolerance:e}: {:e}", problem.name, own.error);
            }
        }
    }
}
