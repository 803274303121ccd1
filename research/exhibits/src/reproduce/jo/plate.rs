//! Figure 7: the plate under a pulse, with Podlubny's matrix method as the benchmark.

use super::super::error_curve::{ErrorCurve, error_chart, error_table};
use super::super::motion::Motion;
use super::super::problems::{accurate_pulse_plate, on_grid, pulse_plate, with_bdf};
use super::super::table::Table;
use super::super::{Findings, ReproduceError};
use crate::reproduce::podlubny_matrix::{LinearTerm, podlubny_matrix_method};
use fvi_core::ParameterError;
use fvi_fft::sums::max_or_nan;
use fvi_host::results::picture::{Axis, Chart, Series, Style};
use std::sync::atomic::AtomicBool;

/// The last time.
const END: f64 = 30.0;
/// Steps of the benchmark: h = 5·10⁻³.
const BENCHMARK_STEPS: usize = 6000;
/// Steps of the runs; every grid is part of the benchmark's and has the end of the pulse among its points.
const STEPS: [usize; 7] = [60, 120, 300, 600, 1200, 3000, BENCHMARK_STEPS];
/// Index in [`STEPS`] of the run with the paper's step, h = 0.1.
const PAPER_STEP: usize = 2;
/// Number of the first entries of [`STEPS`] that are used for the slope against the benchmark: their steps
/// are at least ten times as long as the benchmark's.
const FAR_FROM_BENCHMARK: usize = 4;

/// q̈ + D^(3/2) q + q = 8 on [0, 1], 0 after.
fn benchmark(steps: usize) -> Result<Vec<f64>, ParameterError> {
    let terms = [2.0, 1.5, 0.0].map(|order| LinearTerm { coefficient: 1.0, order });
    let step_size = END / steps as f64;
    // Half a step decides on which side of the jump a rounded grid time lies.
    let pulse = |t: f64| if t < 1.0 + 0.5 * step_size { 8.0 } else { 0.0 };
    podlubny_matrix_method(&terms, pulse, step_size, steps)
}

/// Largest difference at the common grid points.
fn largest_difference(coarse: &[f64], fine: &[f64]) -> f64 {
    let stride = (fine.len() - 1) / (coarse.len() - 1);
    let pairs = coarse.iter().zip(fine.iter().step_by(stride));
    pairs.fold(0.0, |largest, (a, b)| max_or_nan(largest, (a - b).abs()))
}

fn curve(label: &str, motions: &[Vec<f64>], known: &[f64]) -> ErrorCurve {
    let point = |motion: &Vec<f64>| (END / (motion.len() - 1) as f64, largest_difference(motion, known));
    ErrorCurve::new(label, motions.iter().map(point).collect())
}

fn over_time(positions: &[f64]) -> Vec<(f64, f64)> {
    let step = END / (positions.len() - 1) as f64;
    positions.iter().enumerate().map(|(k, &q)| (step * k as f64, q)).collect()
}

/// Positions on the grids of [`STEPS`].
struct Positions {
    /// Positions by the variational integrator, for each grid.
    runs: Vec<Vec<f64>>,
    /// Positions by Podlubny's matrix method, for each grid.
    benchmarks: Vec<Vec<f64>>,
    /// Positions by the matrix method on the benchmark's grid.
    benchmark: Vec<f64>,
    /// Positions of the accurate run, on the benchmark's grid.
    exact: Vec<f64>,
    /// Largest error of `exact` where the solution is known.
    exact_error: f64,
}

impl Positions {
    fn compute(stop: &AtomicBool) -> Result<Self, ReproduceError> {
        let positions = |motion: Motion| motion.states.iter().map(|state| state.position[0]).collect();
        let scenario = with_bdf(pulse_plate()?, 1);
        let run = |steps: usize| {
            let grid = on_grid(scenario.clone(), END / steps as f64, steps);
            Motion::run("", &grid, stop).map(positions)
        };
        let accurate = on_grid(accurate_pulse_plate()?, END / BENCHMARK_STEPS as f64, BENCHMARK_STEPS);
        let exact = Motion::run("", &accurate, stop)?;
        Ok(Self {
            runs: STEPS.into_iter().map(run).collect::<Result<_, _>>()?,
            benchmarks: STEPS.into_iter().map(benchmark).collect::<Result<_, _>>()?,
            benchmark: benchmark(BENCHMARK_STEPS)?,
            exact_error: exact.errors(&accurate).position.largest,
            exact: positions(exact),
        })
    }

    fn chart(&self) -> Chart {
        let benchmark = over_time(&self.benchmark).into_iter().step_by(20).collect();
        Chart::new("Plate under a pulse", Axis::linear("time t"), Axis::linear("position q"))
            .with_subtitle(
                "q̈ + D^(3/2) q + q = 8 on [0, 1], 0 after; variational: low order, κ = ½, Grünwald–Letnikov",
            )
            .with(Series::new("variational, h = 0.1", Style::Line, over_time(&self.runs[PAPER_STEP])))
            .with(Series::new("benchmark: Podlubny's matrix method, h = 0.005", Style::Reference, benchmark))
    }

    fn table(&self) -> Table {
        let stride = BENCHMARK_STEPS / STEPS[PAPER_STEP];
        let known = self.benchmark.iter().zip(&self.exact).step_by(stride);
        let rows = over_time(&self.runs[PAPER_STEP]).into_iter().zip(known);
        let rows = rows
            .map(|((t, q), (&benchmark, &exact))| vec![t.into(), q.into(), benchmark.into(), exact.into()]);
        let caption = "Positions: variational with h = 0.1, benchmark with h = 0.005, exact";
        Table::of_curves("", caption, &["t", "variational", "benchmark", "exact"], rows)
    }
}

pub(super) fn figure_7(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let positions = Positions::compute(stop)?;
    let Positions { runs, benchmarks, benchmark, exact, exact_error } = &positions;
    let against_benchmark = |runs: &[Vec<f64>]| curve("variational − benchmark", runs, benchmark);
    let (all, far) =
        (against_benchmark(&runs[..STEPS.len() - 1]), against_benchmark(&runs[..FAR_FROM_BENCHMARK]));
    let against_exact = curve("variational − exact", runs, exact);
    let method = curve("benchmark method − exact", benchmarks, exact);
    let reason = format!(
        "the paper does not print its step sizes. From level to level the order is {}: the benchmark is of first order too, with an error of \
         {:.1e}, and as h comes near its step the difference of the two is no error of either",
        all.orders_in_words(),
        largest_difference(benchmark, exact),
    );
    let findings = Findings::default()
        .differs(
            "global order against the benchmark, h = 0.5 … 0.05",
            "0.97",
            format!("{:.2}", far.slope()),
            reason,
        )
        .agrees(
            "global order against the exact solution, h = 0.5 … 0.005",
            "–",
            format!("{:.2}, benchmark method {:.2}", against_exact.slope(), method.slope()),
        );
    let errors = error_chart(
        "Plate under a pulse: errors on [0, 30]",
        "low order, κ = ½, Grünwald–Letnikov; benchmark: Podlubny's matrix method, h = 0.005",
        &[far, against_exact.clone(), method.clone()],
        &[1.0],
    );
    let caption = "Largest errors of q, benchmark with h = 0.005";
    Ok(findings
        .with_picture("", "The plate's position over time", positions.chart())
        .with_picture("errors", "Largest errors over step sizes", errors)
        .with_table(positions.table())
        .with_table(error_table("errors", caption, &[all, against_exact, method]))
        .with_remark(format!(
            "“Exact” is a run with Radau IIA quadrature (three stages, degree 3, h = 0.005); at the 28 times where 20 digits are known it \
             is right to {exact_error:.0e}. All step sizes are multiples of the benchmark's."
        )))
}
