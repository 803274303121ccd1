//! The pictures of `fvi response`.

use super::{KernelCurves, Response, ResponseOptions};
use crate::results::picture::{Axis, Chart, Series, Style};
use fvi_scenario::scenario::Scenario;
use nalgebra::Complex;
use std::f64::consts::PI;

/// The charts of a response, with the names of their files.
pub(super) fn charts(
    found: &Response,
    scenario: &Scenario,
    options: &ResponseOptions,
) -> Vec<(&'static str, Chart)> {
    let (input, output) = (options.input, options.output);
    let subtitle = format!("q{output} under a force on q{input}; {}", scenario.scheme.describe());
    let plain =
        |x: Axis, y: Axis| Chart::new(scenario.heading(), x, y).on_paper(scenario.output.appearance.paper);
    let chart = |x: Axis, y: Axis| plain(x, y).with_subtitle(subtitle.clone());
    let frequency = || Axis::logarithmic("angular frequency ω");
    let discrete: &[Complex<f64>] = found.discrete.as_deref().unwrap_or_default();
    let both = |mut chart: Chart, point: &dyn Fn(f64, Complex<f64>) -> (f64, f64)| {
        // At the end of the band, ω = π/h, the response of some schemes is zero, which has no logarithm.
        let shows = |value: Complex<f64>, continuous: Complex<f64>| value.norm() >= 1e-3 * continuous.norm();
        let of = |values: &[Complex<f64>]| -> Vec<(f64, f64)> {
            let places = found.omega.iter().zip(values).zip(&found.response);
            let shown = places.filter(|((_, value), continuous)| shows(**value, **continuous));
            shown.map(|((&omega, &value), _)| point(omega, value)).collect()
        };
        let asked = found.omega.iter().copied().zip(found.response.iter().copied());
        let mut places: Vec<_> = asked.chain(found.between.iter().copied()).collect();
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        let places = places.into_iter().map(|(omega, value)| point(omega, value)).collect();
        chart = chart.with(Series::new("continuous", Style::Line, places));
        if !discrete.is_empty() {
            chart = chart.with(Series::new("of the scheme", Style::Dashed, of(discrete)));
        }
        chart
    };
    let magnitude = both(chart(frequency(), Axis::logarithmic("|H|")), &|omega, value| (omega, value.norm()));
    let phase = both(chart(frequency(), Axis::linear("phase of H, degrees")), &|omega, value| {
        (omega, libm::atan2(value.im, value.re) * 180.0 / PI)
    });
    let nyquist = both(chart(Axis::linear("Re H"), Axis::linear("Im H")), &|_, value| (value.re, value.im));
    let mut charts =
        vec![("bode-magnitude.svg", magnitude), ("bode-phase.svg", phase), ("nyquist.svg", nyquist)];
    if found.kernels.is_empty() {
        return charts;
    }
    let mut moduli = plain(frequency(), Axis::logarithmic("modulus of K(iω)"));
    let time = || Axis::logarithmic("time t").in_units(&scenario.output.appearance.units.time);
    let mut creep = plain(time(), Axis::logarithmic("creep J(t)"));
    let mut relaxation = plain(time(), Axis::logarithmic("relaxation G(t)"));
    for (term, kernel) in found.kernels.iter().enumerate() {
        let KernelCurves { name, times, .. } = kernel;
        let of = |part: fn(&Complex<f64>) -> f64| {
            found.omega.iter().zip(&kernel.moduli).map(|(&omega, value)| (omega, part(value))).collect()
        };
        moduli = moduli
            .with(Series::new(format!("storage, {name}"), Style::Line, of(|k| k.re)).with_colour_of(term))
            .with(Series::new(format!("loss, {name}"), Style::Dashed, of(|k| k.im)).with_colour_of(term));
        let curve = |values: &Option<Vec<f64>>| {
            let values = values.as_deref().unwrap_or_default();
            let points = times.iter().zip(values).map(|(&time, &value)| (time, value)).collect();
            Series::new(name.clone(), Style::Line, points).with_colour_of(term)
        };
        creep = creep.with(curve(&kernel.creep));
        relaxation = relaxation.with(curve(&kernel.relaxation));
    }
    charts.extend([("moduli.svg", moduli), ("creep.svg", creep), ("relaxation.svg", relaxation)]);
    charts
}
