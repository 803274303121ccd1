//! Adaptive steps: errors against tolerances, and work compared with the best grids that can be found by
//! hand.

use super::super::table::{Cell, Column, Format, Table};
use super::super::{Findings, ReproduceError};
use super::problems::{COLLOCATION, Made, Problem, measured};
use fvi_host::results::picture::{Axis, Chart, Marker, Series, Style};
use std::sync::atomic::AtomicBool;

const TOLERANCES: [f64; 4] = [1e-4, 1e-6, 1e-8, 1e-10];

/// All problems, and the difference of the pendulum's reference from a run with another scheme.
fn problems(stop: &AtomicBool) -> Result<(Vec<Problem>, f64), ReproduceError> {
    let (pendulum, uncertainty) = Problem::pendulum(stop)?;
    let problems = vec![
        Problem::root(),
        Problem::released(1.0, 0.3),
        Problem::released(1.0, 0.5),
        Problem::released(1.0, 0.7),
        Problem::released(1.0, 1.5),
        Problem::undamped(),
        Problem::pulse(),
        pendulum,
        Problem::stiff(),
        Problem::stiff_at_rest(),
        Problem::released(20.0, 0.5),
    ];
    Ok((problems, uncertainty))
}

fn adaptive(problem: &Problem, tolerance: f64, stop: &AtomicBool) -> Result<Made, ReproduceError> {
    let time = format!("grid = \"adaptive\"\nend = {:?}\ntolerance = {tolerance:e}\n", problem.end);
    problem.run_between(COLLOCATION, &time, stop)
}

/// Families of grids that one would try by hand, each refined as a whole.
#[derive(Clone, Copy, Debug)]
enum Shape {
    /// t = (k/N)^exponent
    Graded(f64),
    /// Steps that grow from `first`, by the factor 1 + `growth` on the coarsest grid, up to a longest one of
    /// 1/`parts` of the time.
    Growing { first: f64, growth: f64, parts: f64 },
}

const SHAPES: [Shape; 11] = {
    const fn growing(first: f64, growth: f64, parts: f64) -> Shape {
        Shape::Growing { first, growth, parts }
    }
    [
        Shape::Graded(1.0),
        Shape::Graded(2.0),
        Shape::Graded(3.0),
        growing(1e-3, 2.0, 8.0),
        growing(1e-3, 2.0, 24.0),
        growing(1e-5, 1.0, 12.0),
        growing(1e-5, 2.0, 12.0),
        growing(1e-5, 5.0, 12.0),
        growing(1e-8, 1.0, 12.0),
        growing(1e-8, 2.0, 12.0),
        growing(1e-8, 5.0, 24.0),
    ]
};

/// Number of grids of each shape; each has about a quarter more steps than the one before.
const LEVELS: usize = 30;

/// `[time]` of a grid.
fn by_hand(problem: &Problem, shape: Shape, level: usize) -> String {
    let (end, fineness) = (problem.end, libm::pow(1.25, level as f64));
    let jumps = match problem.jumps {
        [] => String::new(),
        jumps => format!("must_hit = {jumps:?}\n"),
    };
    match shape {
        Shape::Graded(exponent) => format!(
            "grid = \"graded\"\nend = {end:?}\nsteps = {}\nexponent = {exponent:?}\n{jumps}",
            libm::round(8.0 * fineness)
        ),
        Shape::Growing { first, growth, parts } => {
            let ratio = 1.0 + growth / fineness;
            // A pure relaxation needs no bound on the steps.
            let longest = match end {
                end if end > 1e3 => String::new(),
                end => format!("longest = {:?}\n", (end / (parts * fineness)).max(first)),
            };
            format!(
                "grid = \"geometric\"\nend = {end:?}\nfirst = {first:e}\nratio = {ratio:?}\n{longest}{jumps}"
            )
        }
    }
}

/// The fewest steps of a grid by hand that leave no larger error of q and p.
fn fewest(problem: &Problem, error: f64, stop: &AtomicBool) -> Result<Option<usize>, ReproduceError> {
    let mut best = None;
    for shape in SHAPES {
        // Bisection for the coarsest grid with a small enough error, assuming that finer grids satisfy it
        // too.
        let (mut bad, mut good) = (0, LEVELS);
        while bad < good {
            let level = (bad + good) / 2;
            let scenario =
                problem.scenario(COLLOCATION, &by_hand(problem, shape, level), &problem.at_known_times())?;
            if best.is_some_and(|best| scenario.time.steps >= best) {
                good = level;
                continue;
            }
            let made = measured(&scenario, stop)?;
            if made.error() <= error {
                (good, best) = (level, Some(made.steps));
            } else {
                bad = level + 1;
            }
        }
    }
    Ok(best)
}

pub(super) fn exhibit(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let exact = |name: &str| Column::new(name, Format::Exact);
    let columns = vec![
        exact("problem"),
        exact("tolerance"),
        exact("steps"),
        exact("attempts"),
        exact("rejected"),
        Column::new("error of q / tolerance", Format::Order),
        Column::new("error of p / tolerance", Format::Order),
        exact("steps solved"),
        exact("best grid"),
        Column::new("work", Format::Order),
    ];
    let mut table = Table::new(
        "",
        "Largest errors in units of the tolerance, over all grid points where a formula is known and at all known times otherwise. Steps \
         solved: three for each attempt. Best grid: the fewest steps of a grid with no larger error of q and p; work: solved over these. Grids by hand are graded, or grow from a first step up to a longest, eleven shapes in thirty sizes each",
        columns,
    );
    let mut chart = Chart::new(
        "Steps chosen on the way: errors over tolerances",
        Axis::logarithmic("tolerance"),
        Axis::logarithmic("largest error of q and p"),
    )
    .with_subtitle("Radau IIA 3, collocation; relative to the largest value where that is above 1");
    let (problems, uncertainty) = problems(stop)?;
    for (index, problem) in problems.iter().enumerate() {
        let mut points = Vec::new();
        for tolerance in TOLERANCES {
            let made = adaptive(problem, tolerance, stop)?;
            points.push((tolerance, made.error()));
            let best = fewest(problem, made.error(), stop)?.map(|steps| steps as f64);
            table = table.with_row([
                Cell::from(problem.name.as_str()),
                format!("{tolerance:e}").as_str().into(),
                (made.steps as f64).into(),
                (made.attempts as f64).into(),
                (made.rejected as f64).into(),
                (made.position / tolerance).into(),
                (made.momentum / tolerance).into(),
                (made.solved as f64).into(),
                best.into(),
                best.map(|best| made.solved as f64 / best).into(),
            ]);
        }
        let marker = if index < 6 { Marker::Disc } else { Marker::Square };
        chart = chart.with(Series::new(&problem.name, Style::LineWithPoints, points).with_marker(marker));
    }
    let line = |factor: f64| TOLERANCES.map(|tolerance| (tolerance, factor * tolerance)).to_vec();
    let chart = chart.with(Series::new("the tolerance", Style::Reference, line(1.0))).with(Series::new(
        "ten times the tolerance",
        Style::Dashed,
        line(10.0),
    ));
    Ok(Findings::default()
        .with_picture("", "Largest errors over the tolerance, problem by problem", chart)
        .with_table(table)
        .with_remark(format!(
            "References: formulas; residues and the integral along the cut, 20 digits (`tests/reference/released.py`), for what is let go, \
             the plate and the stiff mode; for the pendulum 12 000 graded steps by collocation, from which as many of the \
             variational scheme on the same nodes, on another grid, differ by {uncertainty:.0e} at most."
        )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_stay_within_ten_tolerances_and_work_within_three_times_the_best_grid() {
        let stop = AtomicBool::new(false);
        for (problem, tolerance) in [
            (Problem::released(1.0, 0.5), 1e-6),
            (Problem::released(1.0, 1.5), 1e-10),
            (Problem::pulse(), 1e-8),
            (Problem::stiff(), 1e-4),
            (Problem::stiff_at_rest(), 1e-10),
        ] {
            let made = adaptive(&problem, tolerance, &stop).unwrap();
            assert!(made.error() < 10.0 * tolerance, "{}: {:e}", problem.name, made.error());
            assert!(100 * made.rejected <= 15 * made.attempts, "{}: {made:?}", problem.name);
            if tolerance > 1e-9 {
                let best = fewest(&problem, made.error(), &stop).unwrap().unwrap();
                assert!(made.solved <= 3 * best, "{}: {made:?}, {best}", problem.name);
            }
        }
    }
}
