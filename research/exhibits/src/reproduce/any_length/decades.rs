//! Relaxation over seventeen decades of time.

use super::super::motion::Motion;
use super::super::table::{Cell, Column, Format, Table};
use super::super::{Findings, ReproduceError};
use super::problems::{COLLOCATION, Problem};
use fvi_host::results::picture::{Axis, Chart, Marker, Series, Style};
use std::sync::atomic::AtomicBool;

/// Ratios of successive steps, coarsest grid first.
const RATIOS: [f64; 4] = [1.4, 1.2, 1.1, 1.05];

pub(super) fn exhibit(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let problem = Problem::released(20.0, 0.5);
    let known = problem.times();
    let inner = &known[..known.len() - 1];
    let columns = vec![
        Column::new("ratio", Format::Exact),
        Column::new("steps", Format::Exact),
        Column::new("largest error of q", Format::Error),
        Column::new("order in the number of steps", Format::Order).headed("order"),
        Column::new("largest relative error of q", Format::Error),
        Column::new("order of the relative error", Format::Order).headed("order"),
    ];
    let mut table = Table::new(
        "",
        "Errors at 10⁻⁶, 10⁻⁵, …, 10⁸, absolute and relative to q there; orders in the number of steps",
        columns,
    );
    let axes = |title: &str, label: &str| {
        Chart::new(title, Axis::logarithmic("time t"), Axis::logarithmic(label))
            .with_subtitle("q̈ + 20 D^(1/2) q + q = 0, Caputo, q(0) = 1; first step 10⁻⁹")
    };
    let mut errors = axes("Seventeen decades: relative errors of q", "relative error of q");
    let mut motion = axes("Relaxation over seventeen decades", "position q");
    let mut before: Option<(f64, [f64; 2])> = None;
    for (index, ratio) in RATIOS.into_iter().enumerate() {
        let time = format!(
            "grid = \"geometric\"\nfirst = 1e-9\nratio = {ratio:?}\nend = {:?}\nmust_hit = {inner:?}\n",
            problem.end
        );
        let scenario = problem.scenario(COLLOCATION, &time, "")?;
        let run = Motion::run(format!("ratio {ratio}"), &scenario, stop)?;
        let steps = (run.states.len() - 1) as f64;
        let (mut points, mut largest) = (Vec::new(), [0.0_f64; 2]);
        for state in &run.states {
            let known = scenario.reference.as_ref().and_then(|of| of.at_output(state.time, 1));
            let Some(exact) = known.and_then(|row| row.position[0]) else { continue };
            let error = (state.position[0] - exact).abs();
            largest = [largest[0].max(error), largest[1].max(error / exact.abs())];
            points.push((state.time, error / exact.abs()));
        }
        let order = |index: usize| {
            before.map(|(steps_before, errors): (f64, [f64; 2])| {
                libm::log(errors[index] / largest[index]) / libm::log(steps / steps_before)
            })
        };
        table = table.with_row([
            Cell::from(ratio),
            steps.into(),
            largest[0].into(),
            order(0).into(),
            largest[1].into(),
            order(1).into(),
        ]);
        before = Some((steps, largest));
        let label = format!("ratio {ratio}, {steps} steps");
        errors = errors.with(Series::new(&label, Style::LineWithPoints, points).with_colour_of(index));
        if ratio == 1.1 {
            let shown: Vec<(f64, f64)> =
                run.states.iter().skip(1).map(|state| (state.time, state.position[0])).collect();
            motion = motion.with(Series::new(label, Style::Points, shown).with_marker(Marker::Disc));
        }
    }
    let exact: Vec<(f64, f64)> = problem.values(0);
    motion = motion.with(Series::new("exact", Style::ReferencePoints, exact));
    let late = |t: f64| (t, 20.0 / (std::f64::consts::PI * t).sqrt());
    motion = motion.with(Series::new("20/√(πt)", Style::Dashed, vec![late(1e4), late(1e8)]));
    Ok(Findings::default()
        .with_picture("", "q over seventeen decades of time, both axes logarithmic", motion)
        .with_picture("errors", "Relative errors of q over time", errors)
        .with_table(table)
        .with_remark(
            "The scenario is `examples/scenarios/creep-seventeen-decades.toml`. On equal steps of 10⁻⁹ it would take 10¹⁷ of them. Late errors are \
             relative to what is left, 10⁻³ at the end.",
        ))
}
