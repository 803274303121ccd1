//! Creep and relaxation functions of kernels: numerical inverse Laplace transforms.

use crate::transfer::TransferFunction;
use nalgebra::Complex;
use std::f64::consts::PI;

/// The relaxation function G(t) = L⁻¹\[K(s)/s\] at a time t > 0, the spring included: the force after a unit
/// step of the displacement. `None` for kernels that are not passive, and for weights.
///
/// Units: those of K. To about 11 digits where all singularities of K lie on the negative real axis, to about
/// 7 for other formulas ([`TransferFunction::is_relaxation`]). Source: \[Mainardi10\].
pub fn relaxation(transfer: &TransferFunction, time: f64) -> Option<f64> {
    invert(transfer, time, |s| whole(transfer, s) / s)
}

/// The creep function J(t) = L⁻¹\[1/(s K(s))\] at a time t > 0, the spring included: the displacement under
/// a unit step of the force. `None` for kernels that are not passive, and for weights.
///
/// Units: those of 1/K; digits as for [`relaxation`]. Source: \[Mainardi10\].
pub fn creep(transfer: &TransferFunction, time: f64) -> Option<f64> {
    invert(transfer, time, |s| (s * whole(transfer, s)).inv())
}

/// K(s) including its spring.
pub fn whole(transfer: &TransferFunction, s: Complex<f64>) -> Complex<f64> {
    transfer.value(s) + transfer.spring()
}

fn invert(
    transfer: &TransferFunction,
    time: f64,
    image: impl Fn(Complex<f64>) -> Complex<f64>,
) -> Option<f64> {
    if transfer.active().is_some() || transfer.table().is_some() {
        return None;
    }
    let value = if transfer.is_relaxation() { talbot(time, image) } else { bromwich(time, image) };
    value.is_finite().then_some(value)
}

/// The inverse of a transform whose singularities lie on the negative real axis, at a time t > 0: to about
/// 11 digits. \[TWS06\]
pub fn on_talbots_contour(time: f64, image: impl Fn(Complex<f64>) -> Complex<f64>) -> f64 {
    talbot(time, image)
}

/// The inverse of a transform whose singularities lie on the negative real axis, on Talbot's contour with
/// the constants of \[TWS06\].
fn talbot(time: f64, image: impl Fn(Complex<f64>) -> Complex<f64>) -> f64 {
    const NODES: usize = 24;
    let count = NODES as f64;
    let node = |k: usize| {
        let angle = (2.0 * k as f64 + 1.0) * PI / count;
        let turned = 0.6407 * angle;
        let (sine, cosine) = (libm::sin(turned), libm::cos(turned));
        let place = Complex::new(0.5017 * angle * cosine / sine - 0.6122, 0.2645 * angle) * count;
        let along = 0.5017 * (cosine / sine - turned / (sine * sine));
        let slope = Complex::new(along, 0.2645) * count;
        (exponential(place) * image(place / time) * slope).im
    };
    2.0 / (count * time) * (0..NODES / 2).map(node).sum::<f64>()
}

/// The inverse of a transform that is analytic for Re s > 0, at a time t > 0: to about 7 digits where it is
/// smooth. \[AW95\]
pub fn on_a_line(time: f64, image: impl Fn(Complex<f64>) -> Complex<f64>) -> f64 {
    bromwich(time, image)
}

/// The inverse of a transform that is analytic in the right half-plane, by the trapezoidal rule on a line
/// there and Euler's summation. \[AW95\]
fn bromwich(time: f64, image: impl Fn(Complex<f64>) -> Complex<f64>) -> f64 {
    const SHIFT: f64 = 19.0;
    const PLAIN: usize = 40;
    const AVERAGED: usize = 14;
    let at = |k: usize| image(Complex::new(0.5 * SHIFT, PI * k as f64) / time).re;
    let mut sum = 0.5 * at(0);
    let mut sums = Vec::with_capacity(AVERAGED + 1);
    for k in 1..=PLAIN + AVERAGED {
        sum += if k % 2 == 0 { at(k) } else { -at(k) };
        if k >= PLAIN {
            sums.push(sum);
        }
    }
    while sums.len() > 1 {
        sums = sums.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
    }
    libm::exp(0.5 * SHIFT) / time * sums[0]
}

fn exponential(z: Complex<f64>) -> Complex<f64> {
    Complex::new(libm::cos(z.im), libm::sin(z.im)) * libm::exp(z.re)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(found: Option<f64>, known: f64, tolerance: f64) {
        let found = found.unwrap();
        assert!((found - known).abs() <= tolerance * known.abs(), "{found} instead of {known}");
    }

    #[test]
    fn springpots_creep_and_relax_by_powers() {
        for (order, time) in [(0.3, 1e-4), (0.5, 2.0), (0.9, 1e5)] {
            let transfer = TransferFunction::power(order).unwrap();
            let gamma = |x: f64| libm::tgamma(x);
            near(relaxation(&transfer, time), time.powf(-order) / gamma(1.0 - order), 2e-11);
            near(creep(&transfer, time), time.powf(order) / gamma(1.0 + order), 2e-11);
        }
    }

    #[test]
    fn a_maxwell_element_of_half_order_relaxes_by_the_error_function() {
        let (time, tau) = (0.7, 1.5);
        let transfer = TransferFunction::maxwell(0.5, 0.0, tau).unwrap();
        let x: f64 = time / tau;
        near(relaxation(&transfer, time), x.exp() * libm::erfc(x.sqrt()), 2e-11);
        near(creep(&transfer, time), 1.0 + x.sqrt() / libm::tgamma(1.5), 2e-11);
    }

    #[test]
    fn prony_series_relax_by_exponentials() {
        let transfer = TransferFunction::prony(&[1.0, 0.7], &[1.0, 0.1]).unwrap();
        for time in [1e-3, 0.2, 3.0] {
            let known = f64::exp(-time) + 0.7 * f64::exp(-time / 0.1);
            near(relaxation(&transfer, time), known, 2e-11);
        }
        // One element: spring and dashpot in series.
        let one = TransferFunction::prony(&[2.0], &[0.5]).unwrap();
        near(creep(&one, 0.8), 0.5 * (1.0 + 0.8 / 0.5), 2e-11);
    }

    #[test]
    fn lines_and_contours_agree() {
        let transfer = TransferFunction::havriliak_negami(0.7, 0.5, 1.0).unwrap();
        for time in [0.01, 1.0, 50.0] {
            let image = |s: Complex<f64>| whole(&transfer, s) / s;
            let (one, other) = (talbot(time, image), bromwich(time, image));
            assert!((one - other).abs() < 1e-7 * one.abs(), "{one} {other}");
        }
    }

    #[test]
    fn what_is_active_neither_creeps_nor_relaxes() {
        let active = TransferFunction::prony(&[1.0, -0.2], &[1.0, 0.1]).unwrap();
        assert_eq!((creep(&active, 1.0), relaxation(&active, 1.0)), (None, None));
    }
}
