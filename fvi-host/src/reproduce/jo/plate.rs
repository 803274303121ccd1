//! Figure 7: the plate under a pulse, with Podlubny's matrix method as the benchmark.

use super::super::error_curve::{ErrorCurve, error_chart, error_table};
use super::super::motion::Motion;
use super::super::problems::{accurate_pulse_plate, on_grid, pulse_plate, with_bdf};
use super::super::table::Table;
use super::super::{Findings, ReproduceError};
use crate::picture::{Axis, Chart, Series, Style};
use crate::podlubny_matrix::{LinearTerm, podlubny_matrix_method};
use fvi_core::ParameterError;
use std::sync::atomic::AtomicBool;

/// The last time.
const END: f64 = 30.0;
/// Steps of the benchmark: h = 5·10⁻³.
const BENCHMARK_STEPS: usize = 6000;
/// Steps of the runs; every grid is part of the benchmark's and has the end of the pulse among its points.
const STEPS: [usize; 6] = [150, 300, 600, 1500, 3000, 6000];
/// The runs that the slope against the benchmark is taken of: beyond, its own error is as large as theirs.
const FAR_FROM_BENCHMARK: usize = 4;

/// q̈ + D^{3/2} q + q = 8 on [0, 1], 0 after.
fn benchmark(steps: usize) -> Result<Vec<f64>, ParameterError> {
    let terms = [2.0, 1.5, 0.0].map(|order| LinearTerm { coefficient: 1.0, order });
    let step_size = END / steps as f64;
    // Half a step decides on which side of the jump a rounded grid time lies.
    let pulse = |t: f64| if t < 1.0 + 0.5 * step_size { 8.0 } else { 0.0 };
    podlubny_matrix_method(&terms, pulse, step_size, steps)
}

/// Largest difference at the grid points that both have.
fn largest_difference(coarse: &[f64], fine: &[f64]) -> f64 {
    let stride = (fine.len() - 1) / (coarse.len() - 1);
    let pairs = coarse.iter().zip(fine.iter().step_by(stride));
    pairs.fold(0.0, |largest, (a, b)| f64::max(largest, (a - b).abs()))
}

fn curve(label: &str, motions: &[Vec<f64>], known: &[f64]) -> ErrorCurve {
    let point = |motion: &Vec<f64>| (END / (motion.len() - 1) as f64, largest_difference(motion, known));
    ErrorCurve::new(label, motions.iter().map(point).collect())
}

fn over_time(positions: &[f64]) -> Vec<(f64, f64)> {
    let step = END / (positions.len() - 1) as f64;
    positions.iter().enumerate().map(|(k, &q)| (step * k as f64, q)).collect()
}

pub(super) fn figure_7(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let positions =
        |motion: Motion| motion.states.iter().map(|state| state.position[0]).collect::<Vec<f64>>();
    let scenario = with_bdf(pulse_plate()?, 1);
    let run = |steps: usize| {
        let grid = on_grid(scenario.clone(), END / steps as f64, steps);
        Ok::<_, ReproduceError>(positions(Motion::run("", &grid, stop)?))
    };
    let accurate = on_grid(accurate_pulse_plate()?, END / BENCHMARK_STEPS as f64, BENCHMARK_STEPS);
    let exact = Motion::run("", &accurate, stop)?;
    let exact_error = exact.errors(&accurate).position.largest;
    let exact = positions(exact);
    let benchmark_values = benchmark(BENCHMARK_STEPS)?;
    let runs = STEPS.map(run).into_iter().collect::<Result<Vec<_>, _>>()?;
    let benchmarks = STEPS.map(benchmark).into_iter().collect::<Result<Vec<_>, _>>()?;

    let against_benchmark = curve("variational − benchmark", &runs[..STEPS.len() - 1], &benchmark_values);
    let curves = [
        against_benchmark.clone(),
        curve("variational − exact", &runs, &exact),
        curve("benchmark method − exact", &benchmarks, &exact),
    ];
    let paper_step = 1;
    let picture = Chart::new("Plate under a pulse", Axis::linear("time t"), Axis::linear("position q"))
        .with_subtitle(
            "q̈ + D^{3/2} q + q = 8 on [0, 1], 0 after; variational: low order, κ = ½, Grünwald–Letnikov",
        )
        .with(Series::new("variational, h = 0.1", Style::Line, over_time(&runs[paper_step])))
        .with(Series::new(
            "benchmark: Podlubny's matrix method, h = 0.005",
            Style::Reference,
            over_time(&benchmark_values).into_iter().step_by(20).collect(),
        ));
    let errors = error_chart(
        "Plate under a pulse: errors on [0, 30]",
        "low order, κ = ½, Grünwald–Letnikov; benchmark: Podlubny's matrix method, h = 0.005",
        &curves,
        &[1.0],
    );
    let benchmark_error = largest_difference(&benchmark_values, &exact);
    let shared = benchmark_values.iter().step_by(BENCHMARK_STEPS / STEPS[paper_step]);
    let exact_shared = exact.iter().step_by(BENCHMARK_STEPS / STEPS[paper_step]);
    let rows = over_time(&runs[paper_step]).into_iter().zip(shared).zip(exact_shared);
    let rows = rows.map(|(((t, q), b), e)| vec![t.into(), q.into(), (*b).into(), (*e).into()]);
    Ok(Findings::default()
        .with_picture("", "The plate's position over time", picture)
        .with_picture("errors", "Largest errors over step sizes", errors)
        .differs(
            format!("global order against the benchmark, h = 0.2 … {}", against_benchmark.points[FAR_FROM_BENCHMARK - 1].0),
            "0.97",
            format!("{:.2}", against_benchmark.slope_of_coarsest(FAR_FROM_BENCHMARK)),
            format!(
                "the benchmark is of first order too, its own error is {benchmark_error:.1e}: as h comes near its step the difference \
                 of the two is no error of either; against the exact solution the slope is {:.2}",
                curves[1].slope()
            ),
        )
        .with_table(Table::of_curves(
            "",
            "Positions: variational with h = 0.1, benchmark with h = 0.005, exact",
            &["t", "variational", "benchmark", "exact"],
            rows,
        ))
        .with_table(error_table("errors", "Largest errors of q, benchmark with h = 0.005", &curves))
        .with_remark(format!(
            "“Exact” is a run with Radau IIA quadrature (three stages, degree 3, h = 0.005); at the 28 times where 20 digits are known it \
             is right to {exact_error:.0e}. The paper does not print its step sizes; these are all multiples of the benchmark's."
        )))
}
