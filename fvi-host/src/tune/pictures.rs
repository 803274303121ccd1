//! The pictures of `fvi tune`.

use super::{Tuning, TuningProblem};
use crate::results::picture::{Axis, Chart, Series, Style};
use nalgebra::Complex;
use std::f64::consts::PI;

/// Number of points of the circle |S| = Ms.
const CIRCLE: usize = 200;

/// The charts of a tuning, with the names of their files.
pub(super) fn charts(found: &Tuning, problem: &TuningProblem) -> Vec<(&'static str, Chart)> {
    let subtitle = super::in_words(&found.law);
    let chart = |x: Axis, y: Axis| Chart::new(problem.heading(), x, y).with_subtitle(subtitle.clone());
    let frequency = || Axis::logarithmic("angular frequency ω");
    let with_loops = |chart: Chart, point: &dyn Fn(f64, Complex<f64>) -> (f64, f64)| {
        let open = found.response.iter().map(|at| point(at.omega, at.open)).collect();
        let ticks = found.response.iter().filter_map(|at| Some(point(at.omega, at.sampled?)));
        chart.with(Series::new("L = C P", Style::Line, open)).with(Series::new(
            "sampled",
            Style::Dashed,
            ticks.collect(),
        ))
    };
    let magnitude =
        with_loops(chart(frequency(), Axis::logarithmic("|L|")), &|omega, value| (omega, value.norm()));
    let degrees = |value: Complex<f64>| {
        let phase = libm::atan2(value.im, value.re) * 180.0 / PI;
        if phase > 0.0 { phase - 360.0 } else { phase }
    };
    let phase = with_loops(chart(frequency(), Axis::linear("phase of L, degrees")), &|omega, value| {
        (omega, degrees(value))
    });
    let near = |value: f64| value.clamp(-3.0, 1.5);
    let circle = (0..=CIRCLE)
        .map(|k| 2.0 * PI * k as f64 / CIRCLE as f64)
        .map(|angle| (-1.0 + libm::cos(angle) / found.margins.ms, libm::sin(angle) / found.margins.ms))
        .collect();
    let nyquist =
        chart(Axis::linear("Re L").with_range(-3.0, 1.5), Axis::linear("Im L").with_range(-3.0, 1.5));
    let inside = |value: Complex<f64>| value.re == near(value.re) && value.im == near(value.im);
    let points = |of: &dyn Fn(usize) -> Option<Complex<f64>>| -> Vec<(f64, f64)> {
        (0..found.response.len())
            .map(|k| match of(k) {
                Some(value) if inside(value) => (value.re, value.im),
                _ => (f64::NAN, f64::NAN),
            })
            .collect()
    };
    let nyquist = nyquist
        .with(Series::new("L = C P", Style::Line, points(&|k| Some(found.response[k].open))))
        .with(Series::new("sampled", Style::Dashed, points(&|k| found.response[k].sampled)))
        .with(Series::new(format!("|S| = {:.3}", found.margins.ms), Style::Guide, circle));
    let over_time = |name: &str, column: usize| {
        let points = found.steps.iter().map(|row| (row[0], row[column])).collect();
        Series::new(name, Style::Line, points)
    };
    let step = chart(Axis::linear("time t"), Axis::linear("after a unit step of the setpoint"))
        .with(over_time("measured", 1))
        .with(over_time("control", 2));
    let load = chart(Axis::linear("time t"), Axis::linear("after a unit step of a load"))
        .with(over_time("measured", 3));
    vec![
        ("bode-magnitude.svg", magnitude),
        ("bode-phase.svg", phase),
        ("nyquist.svg", nyquist),
        ("step.svg", step),
        ("load.svg", load),
    ]
}
