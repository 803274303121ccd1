//! Figure 2: errors of convolution quadrature for D^{1/2} on t^{β−1} sin t.
//!
//! β is the exponent of the functions here, as in the paper's figure, not a damping order.

use super::super::error_curve::{ErrorCurve, error_chart, error_table};
use super::super::table::{Column, Format, Table};
use super::super::{Findings, ReproduceError};
use fvi_core::{BdfOrder, ConvolutionWeights};
use std::sync::atomic::{AtomicBool, Ordering};

/// The order of the derivative.
const ORDER: f64 = 0.5;
/// The exponents of the figure, with the names of their files.
const BETAS: [(u32, &str); 4] = [(1, "beta-1"), (3, "beta-3"), (4, "beta-4"), (5, "beta-5")];
/// Grids h = 2^−i on [0, 1].
const LEVELS: std::ops::RangeInclusive<u32> = 3..=8;

/// t^{β−1} sin t.
fn function(beta: u32, t: f64) -> f64 {
    libm::pow(t, f64::from(beta - 1)) * libm::sin(t)
}

/// D^{1/2} of [`function`], from the series of the sine, 0 ≤ t ≤ 1.
///
/// ```text
/// Σ_j (−1)^j/(2j+1)! · Γ(β+2j+1)/Γ(β+2j+1/2) · t^{β+2j−1/2}
/// ```
fn half_derivative(beta: u32, t: f64) -> f64 {
    let mut sum = 0.0;
    let mut factorial = 1.0;
    for j in 0..10 {
        let power = f64::from(beta + 2 * j);
        if j > 0 {
            factorial *= -f64::from(2 * j) * f64::from(2 * j + 1);
        }
        let slope = libm::tgamma(power + 1.0) / libm::tgamma(power + 1.0 - ORDER);
        sum += slope * libm::pow(t, power - ORDER) / factorial;
    }
    sum
}

/// Errors of the quadrature at t_0…t_N, h = 1/N. \[HJO\] eq. 29.
fn errors(beta: u32, bdf_order: usize, steps: usize) -> Result<Vec<f64>, ReproduceError> {
    let step = 1.0 / steps as f64;
    let weights: Vec<f64> =
        ConvolutionWeights::bdf(BdfOrder::new(bdf_order)?, ORDER, step)?.take(steps + 1).collect();
    let samples: Vec<f64> = (0..=steps).map(|k| function(beta, step * k as f64)).collect();
    let error = |k: usize| {
        // Summed from the smallest terms to the largest.
        let pairs = weights[..=k].iter().rev().zip(&samples[..=k]);
        let quadrature: f64 = pairs.map(|(weight, sample)| weight * sample).sum();
        (half_derivative(beta, step * k as f64) - quadrature).abs()
    };
    Ok((0..=steps).map(error).collect())
}

/// Largest errors, errors at t = 1, and the grid point of the largest on the finest grid.
struct Measured {
    largest: ErrorCurve,
    last: ErrorCurve,
    place: usize,
}

fn measure(beta: u32, bdf_order: usize, stop: &AtomicBool) -> Result<Measured, ReproduceError> {
    let (mut largest, mut last, mut place) = (Vec::new(), Vec::new(), 0);
    for level in LEVELS {
        if stop.load(Ordering::Relaxed) {
            return Err(ReproduceError::Stopped);
        }
        let steps = 1_usize << level;
        let step = 1.0 / steps as f64;
        let errors = errors(beta, bdf_order, steps)?;
        let (at, error) =
            errors.iter().enumerate().fold((0, 0.0), |best, (k, &e)| if e > best.1 { (k, e) } else { best });
        largest.push((step, error));
        last.push((step, errors[steps]));
        place = at;
    }
    let label = format!("BDF {bdf_order}");
    Ok(Measured { largest: ErrorCurve::new(&label, largest), last: ErrorCurve::new(&label, last), place })
}

pub(super) fn figure_2(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let mut findings = Findings::default();
    let mut slopes = slopes_table();
    for (beta, name) in BETAS {
        let measured = (1..=6).map(|order| measure(beta, order, stop)).collect::<Result<Vec<_>, _>>()?;
        for (order, Measured { largest, last, place }) in (1..).zip(&measured) {
            slopes = slopes.with_row([
                f64::from(beta).into(),
                f64::from(order).into(),
                f64::from(beta.min(order)).into(),
                largest.slope().into(),
                (f64::from(beta) - ORDER).min(f64::from(order)).into(),
                (*place as f64).into(),
                last.slope_of_finest(3).into(),
            ]);
        }
        let curves: Vec<ErrorCurve> = measured.iter().map(|measured| measured.largest.clone()).collect();
        let title = format!("D^(1/2) of t^(β−1) sin t, β = {beta}: largest errors");
        let saturated = f64::from(beta) - ORDER;
        let chart = error_chart(title, "convolution quadrature on [0, 1]", &curves, &[saturated]);
        findings = findings
            .with_picture(name, format!("β = {beta}: largest errors over step sizes"), chart)
            .with_table(Table {
                shown: false,
                ..error_table(name, format!("β = {beta}: largest errors"), &curves)
            });
        findings = compare(findings, beta, &measured);
    }
    Ok(findings.with_table(slopes).with_remark(
        "Where p exceeds β − ½, the largest errors sit at the first grid points. There t^(β−1) sin t is t^β up to higher powers, its derivative of order ½ is of size \
         h^(β−1/2), and the quadrature has a relative error that no step size makes smaller. So the maximum norm of [HJO] eq. 29 saturates at \
         min(β − ½, p). At the fixed time t = 1 nothing saturates that early: [HJO] eq. 25 with the power t^β that the function starts with \
         predicts min(β + 1, p), and the slopes are within 0.25 of it or, while that term of the error is small, above.",
    ))
}

fn slopes_table() -> Table {
    let columns = vec![
        Column::new("β", Format::Exact),
        Column::new("p", Format::Exact),
        Column::new("min(β, p)", Format::Exact),
        Column::new("slope of the largest error", Format::Order),
        Column::new("min(β − ½, p)", Format::Exact),
        Column::new("grid point of the largest error, h = 1/256", Format::Exact),
        Column::new("slope at t = 1, finest three", Format::Order),
    ];
    Table::new("slopes", "Slopes over h = 1/8 … 1/256", columns)
}

/// Compares with the paper's statement for one β: for p > β the order remains β.
fn compare(findings: Findings, beta: u32, measured: &[Measured]) -> Findings {
    let finest = |p: usize| measured[p - 1].largest.points.last().map_or(f64::NAN, |point| point.1);
    let beta_index = beta as usize;
    let gain = finest(beta_index) / finest(beta_index + 1);
    let slope = measured[5].largest.slope();
    findings
        .agrees(
            format!("β = {beta}: gain of BDF {} over BDF {beta}, h = 1/256", beta + 1),
            "none, “starts to saturate”",
            format!("error {gain:.1} times smaller"),
        )
        .differs(
            format!("β = {beta}: slope for p = 6"),
            format!("min(β, p) = {beta}"),
            format!("{slope:.2}"),
            format!("min(β − ½, p) = {}: see below", f64::from(beta) - ORDER),
        )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quadrature_meets_the_series_at_a_fixed_time() {
        // At t = 1 BDF 6 has order 6 for β = 5: with 256 steps the error is mostly rounding.
        let error = errors(5, 6, 256).unwrap()[256];
        assert!(error < 1e-11, "{error:e}");
    }

    #[test]
    fn the_largest_error_saturates_half_an_order_before_beta_and_that_at_a_fixed_time_one_after() {
        let stop = AtomicBool::new(false);
        for (beta, order) in [(1, 1), (1, 6), (3, 2), (3, 6), (5, 3), (5, 6)] {
            let found = measure(beta, order, &stop).unwrap();
            let expected = (f64::from(beta) - 0.5).min(order as f64);
            let slope = found.largest.slope_of_finest(4);
            assert!(
                (slope - expected).abs() < 0.05,
                "β = {beta}, p = {order}: {slope} instead of {expected}"
            );
        }
        for (beta, order) in [(1, 1), (1, 4), (3, 3), (5, 3)] {
            let slope = measure(beta, order, &stop).unwrap().last.slope_of_finest(4);
            let expected = f64::from(beta + 1).min(order as f64);
            assert!((slope - expected).abs() < 0.1, "β = {beta}, p = {order} at t = 1: {slope}");
        }
    }
}
