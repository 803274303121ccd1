//! Growth and limits of formulas, from their values.

use super::Formula;
use crate::sums::max_or_nan;
use nalgebra::Complex;

/// μ with K(s) ~ s^μ for large s in the right half-plane.
///
/// It is taken on the positive axis, and on the imaginary axis where K underflows there or grows faster, as
/// with a factor e^{−s}. What falls like 1/s or faster, as a filter does, or faster than any power, like
/// e^{−√s}, has the memory of a kernel with a bound, μ = 0.
pub(super) fn growth_of(formula: &dyn Formula) -> f64 {
    /// Of a periodic factor on the imaginary axis.
    const SWINGS: f64 = 0.25;
    let slope = slope_of_powers;
    let real = |exponent: f64| formula.value(Complex::new(libm::exp10(exponent), 0.0)).norm();
    // The largest of several places, since a factor may be periodic.
    let imaginary = |exponent: f64| {
        let at = |k: i32| Complex::new(0.0, libm::exp10(exponent) * (1.0 + 0.1 * f64::from(k)));
        (0..16).map(|k| formula.value(at(k)).norm()).filter(|size| !size.is_nan()).fold(0.0, max_or_nan)
    };
    let along = slope(imaginary(50.0), imaginary(60.0));
    let growth = slope(real(50.0), real(60.0));
    if real(60.0) == 0.0 {
        return if imaginary(60.0) == 0.0 { 0.0 } else { along };
    }
    let found = if along > growth + SWINGS { along } else { growth };
    if found <= -1.0 { 0.0 } else { found }
}

/// Slope in decades between two sizes at places ten decades apart, to as many digits as are reliable for a
/// formula without a power law there.
pub(super) fn slope_of_powers(near: f64, far: f64) -> f64 {
    let slope = (libm::log10(far) - libm::log10(near)) / 10.0;
    (slope * 1e6).round() / 1e6
}

/// Places 10^{±(10 + 5k)} from which limits of a formula are taken.
const PLACES: usize = 11;
const APART: f64 = 5.0;

/// K(0) of a formula; 0 if it decays to zero, or to the rounding error of a sum.
pub(super) fn value_at_zero(formula: &dyn Formula) -> f64 {
    let at = |exponent: f64| formula.value(Complex::new(libm::exp10(exponent), 0.0)).re;
    let (near, far) = (at(-60.0), at(-50.0));
    let is_large = |value: f64| value.abs() > 1e-13 * at(0.0).abs();
    if (near - far).abs() <= 1e-9 * near.abs() {
        return if is_large(near) { near } else { 0.0 };
    }
    // Beside low powers of s a constant is not yet alone. Limits from different places agree.
    let values: Vec<f64> = (0..PLACES).map(|k| at(-10.0 - APART * k as f64)).collect();
    match [&values[2..], &values[1..PLACES - 1], &values[..PLACES - 2]].map(limit) {
        [Some(limit), Some(one), Some(other)] => {
            let agree = (limit - one).abs().max((limit - other).abs()) <= 1e-8 * limit.abs();
            if agree && is_large(limit) { limit } else { 0.0 }
        }
        _ => 0.0,
    }
}

/// K(∞) of a formula; `None` if it has no bound.
pub(super) fn value_at_infinity(formula: &dyn Formula) -> Option<f64> {
    let at = |k: usize| formula.value(Complex::new(libm::exp10(10.0 + APART * k as f64), 0.0)).re;
    limit(&(0..PLACES).map(at).collect::<Vec<f64>>())
}

/// The limit of values at equidistant exponents; `None` if there is none.
///
/// Where the last ones still differ, as those of low powers of s do, the limit is that of Wynn's ε-algorithm,
/// which is exact for sums of powers that decay. A difference that does not decrease belongs to a power that
/// grows, or to a logarithm.
fn limit(values: &[f64]) -> Option<f64> {
    let &[.., before, near, far] = values else { return None };
    let (change, earlier) = ((far - near).abs(), (near - before).abs());
    if change <= 1e-14 * far.abs() {
        return Some(far);
    }
    // Of a power with the exponent −10⁻³ a change leaves 0.9886.
    if change.is_nan() || change >= 0.99 * earlier {
        return None;
    }
    if far.abs() < 1e-3 * near.abs() {
        return Some(0.0);
    }
    let (mut odd, mut even) = (vec![0.0; values.len() + 1], values.to_vec());
    let mut limit = far;
    while even.len() > 2 {
        let next = |odd: &[f64], even: &[f64]| -> Vec<f64> {
            let steps = even.windows(2).zip(&odd[1..]);
            steps.map(|(pair, &odd)| odd + (pair[1] - pair[0]).recip()).collect()
        };
        odd = next(&odd, &even);
        even = next(&even, &odd);
        match even.last() {
            Some(&last) if last.is_finite() => limit = last,
            _ => break,
        }
    }
    Some(limit)
}
