//! The sampled loop: the plant behind a zero-order hold, observed at the samples, and the discrete law.

use super::law::Law;
use super::plant::Plant;
use nalgebra::Complex;
use std::f64::consts::PI;

/// Number of aliasing bands summed on either side; the remainder is extrapolated from the sum of half as
/// many. Where |sh| is small fewer are enough, because all of them together contribute less.
fn bands(angle: f64) -> usize {
    match angle {
        ..0.01 => 8,
        ..0.2 => 32,
        _ => 128,
    }
}

/// 1 − e^{−z}
fn fallen(z: Complex<f64>) -> Complex<f64> {
    let half = libm::sin(0.5 * z.im);
    let beside = libm::expm1(-z.re);
    Complex::new(2.0 * half * half - beside * libm::cos(z.im), (1.0 + beside) * libm::sin(z.im))
}

/// Transfer function of the plant from sample to sample, with its input held between them,
///
/// ```text
/// G(e^{sh}) = (1 − e^{−sh})/h Σ_k P(s + 2πik/h) / (s + 2πik/h) ,        Re s ≥ 0, 0 ≤ Im s ≤ π/h .
/// ```
///
/// For plants that decay like 1/s or faster the relative error is some 10⁻⁴ at ω = π/h, and smaller below.
/// `None` where P has no value.
pub(super) fn held_plant(plant: &Plant, s: Complex<f64>, sample: f64) -> Option<Complex<f64>> {
    aliases(s, sample, |place| Some(plant.at(place)?.value / place))
}

/// The part of G at ω that comes from |P| beyond a frequency, of any phase.
pub(super) fn held_from_beyond(plant: &Plant, omega: f64, sample: f64, beyond: f64) -> Option<f64> {
    let size = |place: Complex<f64>| match place.im > beyond * (1.0 + 1e-9) {
        true => Some(Complex::new((plant.at(place)?.value / place).norm(), 0.0)),
        false => Some(Complex::ZERO),
    };
    aliases(Complex::new(0.0, omega), sample, size).map(|sum| sum.norm())
}

/// (1 − e^{−sh})/h Σ_k f(s + 2πik/h) for f with conjugate values at conjugate places.
fn aliases(
    s: Complex<f64>,
    sample: f64,
    function: impl Fn(Complex<f64>) -> Option<Complex<f64>>,
) -> Option<Complex<f64>> {
    let band = 2.0 * PI / sample;
    let term = |distance: f64| {
        let place = Complex::new(s.re, s.im + distance * band);
        let value = function(Complex::new(place.re, place.im.abs()))?;
        Some(if place.im < 0.0 { value.conj() } else { value })
    };
    let mut sum = Complex::ZERO;
    let mut half = Complex::ZERO;
    let bands = bands(s.norm() * sample);
    for k in 0..bands {
        if k == bands / 2 {
            half = sum;
        }
        sum += term(k as f64)? + term(-((k + 1) as f64))?;
    }
    // The truncation error is inversely proportional to the number of bands.
    Some(fallen(s * sample) / sample * (sum * 2.0 - half))
}

/// (1 − e^{−sh})/h, which stands for s in the sampled law.
pub(super) fn difference(s: Complex<f64>, sample: f64) -> Complex<f64> {
    fallen(s * sample) / sample
}

/// L(e^{sh}) of the sampled loop. The discrete law is the continuous one with backward differences,
/// (1 − e^{−sh})/h, in place of s.
pub(super) fn sampled_loop(plant: &Plant, law: &Law, sample: f64, s: Complex<f64>) -> Option<Complex<f64>> {
    Some(held_plant(plant, s, sample)? * law.response(difference(s, sample)).measured)
}

/// Upper end of the frequency band: π/h, reduced by rounding.
pub(super) fn band(sample: f64) -> f64 {
    PI / sample * (1.0 - 1e-13)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_core::{DerivativeFilter, PidGains};

    #[test]
    fn a_law_with_differences_in_place_of_s_is_the_law_that_ticks() {
        let parallel = Law {
            gains: PidGains::Parallel { proportional: 2.0, integral: 0.7, derivative: 0.4 },
            lambda: 0.8,
            mu: 1.3,
            filter: DerivativeFilter::Fractional { time: 0.2, order: 0.9 },
            setpoint_weights: [0.5, 0.1],
        };
        let series = Law {
            gains: PidGains::Series {
                proportional: 2.0,
                integral_rate: 0.3,
                derivative_time: 0.5,
                filter_ratio: 10.0,
            },
            filter: DerivativeFilter::None,
            setpoint_weights: [1.0, 0.0],
            ..parallel
        };
        let sample = 0.1;
        for law in [parallel, series] {
            let ticks = law.sampled(sample).unwrap();
            for omega in [1e-3, 0.4, 7.0, band(sample)] {
                let known = ticks.response(omega).unwrap();
                let found = law.response(difference(Complex::new(0.0, omega), sample));
                for (known, found) in [(known.measured, found.measured), (known.setpoint, found.setpoint)] {
                    assert!((known - found).norm() < 1e-12 * known.norm(), "{omega}: {known} {found}");
                }
            }
        }
    }
}
