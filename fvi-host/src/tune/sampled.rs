//! The sampled loop: the plant behind a zero-order hold, observed at the samples, and the discrete law.

use super::law::Law;
use super::plant::Plant;
use nalgebra::Complex;
use std::f64::consts::PI;

/// Number of aliasing bands summed on either side; what lies beyond is extrapolated. Where |sh| is small
/// fewer are enough, because all of them together contribute less.
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
/// The relative error is some 10⁻⁴ at ω = π/h, and smaller below. `None` where P has no value.
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
    let bands = bands(s.norm() * sample);
    let sum = Aliases { s, band: 2.0 * PI / sample, function };
    let mut whole = Complex::ZERO;
    let mut half = Complex::ZERO;
    for k in 0..bands {
        if k == bands / 2 {
            half = whole;
        }
        whole += sum.pair(k as f64)?;
    }
    let whole = match sum.slow_rest(bands as f64) {
        Some(rest) => whole + rest,
        // The truncation error is inversely proportional to the number of bands.
        None => whole * 2.0 - half,
    };
    Some(fallen(s * sample) / sample * whole)
}

/// The terms f(s + 2πik/h).
struct Aliases<F> {
    s: Complex<f64>,
    band: f64,
    function: F,
}

impl<F: Fn(Complex<f64>) -> Option<Complex<f64>>> Aliases<F> {
    fn place(&self, distance: f64) -> Complex<f64> {
        Complex::new(self.s.re, self.s.im + distance * self.band)
    }

    fn term(&self, distance: f64) -> Option<Complex<f64>> {
        let place = self.place(distance);
        let value = (self.function)(Complex::new(place.re, place.im.abs()))?;
        Some(if place.im < 0.0 { value.conj() } else { value })
    }

    /// The terms k and −k − 1 together.
    fn pair(&self, k: f64) -> Option<Complex<f64>> {
        Some(self.term(k)? + self.term(-k - 1.0)?)
    }

    /// The sum of the pairs from `first` on of a plant that falls more slowly than 1/s and has no fraction of
    /// a sample as dead time; `None` of others.
    ///
    /// By the formula of Euler and Maclaurin: the integral over k is computed over octaves, and from the last
    /// one on as that of a power. With a direct path the series gives the mean of the outputs before and
    /// after a step of the input; the controller reads the one before, so that the step arrives a sample
    /// later.
    fn slow_rest(&self, first: f64) -> Option<Complex<f64>> {
        const OCTAVES: i32 = 24;
        const NODES: [(f64, f64); 3] =
            [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];
        let (one, next, far) = (self.term(first)?, self.term(first + 1.0)?, self.term(2.0 * first)?);
        let is_slow = far.norm() > 0.27 * one.norm();
        let turn = next / one;
        if !is_slow || libm::atan2(turn.im, turn.re).abs() > 1e-3 {
            return None;
        }
        let mut rest = (self.pair(first)?) * 0.5 - (self.pair(first + 0.5)? - self.pair(first - 0.5)?) / 12.0;
        for octave in 0..OCTAVES {
            let begin = first * libm::exp2(f64::from(octave));
            for (node, weight) in NODES {
                let k = begin * libm::exp2(0.5 + 0.5 * node);
                rest += self.pair(k)? * (0.5 * std::f64::consts::LN_2 * weight * k);
            }
        }
        let last = first * libm::exp2(f64::from(OCTAVES));
        let (before, end) = (self.pair(0.5 * last)?, self.pair(last)?);
        if end.norm() > 0.0 {
            let ratio = before / end;
            let power = Complex::new(libm::log(ratio.norm()), libm::atan2(ratio.im, ratio.re))
                / std::f64::consts::LN_2;
            rest += end * last / (power - 1.0);
        }
        let [direct, earlier] = [last, 0.5 * last].map(|k| Some(self.term(k)? * self.place(k)));
        let (direct, earlier) = (direct?, earlier?);
        if (direct - earlier).norm() < 1e-4 * direct.norm() {
            // Times (1 − e^{−sh})/h.
            rest -= direct * (PI / self.band);
        }
        Some(rest)
    }
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
