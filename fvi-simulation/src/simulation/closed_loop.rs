//! Stability of closed loops: the number of zeros of 1 + L in the right half-plane.

use super::stability::winding::{Fineness, turned};
use nalgebra::Complex;
use std::f64::consts::PI;

/// An open loop at one s: L(s) = N(s)/D(s) with N and D analytic for Re s > 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpenLoop {
    /// L(s).
    pub value: Complex<f64>,
    /// ln D(s), on any branch.
    pub log_denominator: Complex<f64>,
}

/// The contour on which a loop is evaluated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contour {
    /// The lowest frequency, below which L follows its power law at s = 0.
    pub lowest: f64,
    /// The highest frequency: above, |L| is below 1, or there is no dead time and L follows its power law.
    pub highest: f64,
    /// Largest frequency at which |L| may be ½ or more.
    pub crossing: f64,
    /// The sum of all dead times in L.
    pub dead_time: f64,
    /// Shift σ of the contour to the right: motions that grow more slowly than e^{σt} are not counted. Zero,
    /// or a small number if the open loop may have motions that neither grow nor decay.
    pub shift: f64,
}

/// For a piece of the contour.
const FINENESS: Fineness = Fineness { followed: 0.5, parts: 1, halvings: 44 };

/// Logarithm of the ratio of neighbouring frequencies on the axis.
const PIECE: f64 = 0.05;

/// Phase of e^{−iωL} on a piece, in radians.
const TURN: f64 = 0.3;

/// Largest number of pieces.
const MOST_PIECES: f64 = 4e5;

/// Number of growing motions e^{st} of a closed loop: zeros of D + N with Re s > 0, which include those of 1
/// + L and cancelled ones.
///
/// The argument principle on a quarter of a ring, from the positive axis along its outer arc to the imaginary
/// axis, down it, and along its inner arc back; the conjugate quarter contributes equally. Zeros inside the
/// inner arc and beyond the outer one are not counted.
///
/// # Errors
/// A message: a zero lies on the contour, or the phase of the function cannot be followed there.
pub fn growing_motions(
    contour: &Contour,
    open: &dyn Fn(Complex<f64>) -> Option<OpenLoop>,
) -> Result<usize, String> {
    turns(contour, &|s| {
        let OpenLoop { value, log_denominator } = open(s)?;
        Some(log_denominator + logarithm(value + 1.0))
    })
}

/// Number of growing motions e^{st} of the open loop: zeros of D with Re s > 0.
///
/// # Errors
/// As [`growing_motions`].
pub fn growing_motions_open(
    contour: &Contour,
    open: &dyn Fn(Complex<f64>) -> Option<OpenLoop>,
) -> Result<usize, String> {
    turns(contour, &|s| Some(open(s)?.log_denominator))
}

fn turns(
    contour: &Contour,
    function: &dyn Fn(Complex<f64>) -> Option<Complex<f64>>,
) -> Result<usize, String> {
    let (low, high) = (libm::log(contour.lowest), libm::log(contour.highest));
    let function = |x: f64, angle: f64| function(polar(x, angle) + contour.shift);
    let arc = |log_radius: f64| {
        along(0.5 * PI, &Fineness { parts: 64, ..FINENESS }, &|angle| function(log_radius, angle))
    };
    let axis = along_axis(contour, low, high, &|x| function(x, 0.5 * PI));
    let whole = axis.and_then(|axis| Some(arc(high)? - axis - arc(low)?));
    let turned = whole.ok_or_else(|| {
        "the loop has a motion that neither grows nor fades, or is lost in rounding".to_owned()
    })?;
    let zeros = (turned / PI).round();
    if zeros >= 0.0 && (turned / PI - zeros).abs() < 0.05 {
        Ok(zeros as usize)
    } else {
        Err(format!("the loop cannot be followed around its contour ({:.3} turns)", 0.5 * turned / PI))
    }
}

/// Number of growing motions z = e^{sh} of a sampled loop, from `open_motions` growing motions of the plant
/// itself and the winding of 1 + L along the upper half of the unit circle, where `open` is a function of s
/// with 0 ≤ Im s ≤ `highest` = π/h.
///
/// # Errors
/// As [`growing_motions`].
pub fn growing_sampled_motions(
    contour: &Contour,
    open_motions: usize,
    open: &dyn Fn(Complex<f64>) -> Option<Complex<f64>>,
) -> Result<usize, String> {
    let (low, high) = (libm::log(contour.lowest), libm::log(contour.highest));
    let function = |s: Complex<f64>| Some(logarithm(open(s + contour.shift)? + 1.0));
    let arc = along(0.5 * PI, &Fineness { parts: 16, ..FINENESS }, &|angle| function(polar(low, angle)));
    let axis = along_axis(contour, low, high, &|x| {
        // The end of the band exactly.
        function(if x >= high { Complex::new(0.0, contour.highest) } else { polar(x, 0.5 * PI) })
    });
    let turned = arc.and_then(|arc| Some(-axis? - arc)).ok_or_else(|| {
        "the sampled loop has a motion that neither grows nor fades, or is lost in rounding".to_owned()
    })?;
    let zeros = open_motions as f64 + turned / PI;
    if zeros.round() >= 0.0 && (zeros - zeros.round()).abs() < 0.05 {
        Ok(zeros.round() as usize)
    } else {
        Err(format!("the sampled loop cannot be followed around its contour ({zeros:.3} motions)"))
    }
}

/// Change of the phase of a function of ln ω along the imaginary axis.
fn along_axis(
    contour: &Contour,
    low: f64,
    high: f64,
    function: &dyn Fn(f64) -> Option<Complex<f64>>,
) -> Option<f64> {
    if contour.dead_time * contour.crossing > TURN * MOST_PIECES {
        return None;
    }
    let (mut x, mut turned) = (low, 0.0);
    while x < high {
        let omega = libm::exp(x);
        let mut piece = PIECE;
        if omega < contour.crossing && contour.dead_time > 0.0 {
            piece = piece.min(TURN / (contour.dead_time * omega));
        }
        let next = if x + 1.01 * piece >= high { high } else { x + piece };
        turned += along(next - x, &FINENESS, &|way| function(if way == next - x { next } else { x + way }))?;
        x = next;
    }
    Some(turned)
}

fn along(end: f64, fineness: &Fineness, function: &dyn Fn(f64) -> Option<Complex<f64>>) -> Option<f64> {
    turned(end, fineness, |place| {
        function(place).filter(|value| value.re.is_finite() && value.im.is_finite())
    })
}

/// ln z, its imaginary part from −π to π.
pub fn logarithm(z: Complex<f64>) -> Complex<f64> {
    Complex::new(libm::log(z.norm()), libm::atan2(z.im, z.re))
}

/// e^{x + iθ}, with exactly zero real part at θ = π/2 and exactly zero imaginary part at 0.
fn polar(x: f64, angle: f64) -> Complex<f64> {
    let size = libm::exp(x);
    let cosine = if angle == 0.5 * PI { 0.0 } else { libm::cos(angle) };
    Complex::new(size * cosine, size * libm::sin(angle))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// k e^{−Ls}/(s (s + 1)^n)
    fn integrating(gain: f64, dead_time: f64, order: i32) -> impl Fn(Complex<f64>) -> Option<OpenLoop> {
        move |s| {
            let denominator = s * (s + 1.0).powi(order);
            let value = (s * -dead_time).exp() * gain / denominator;
            Some(OpenLoop { value, log_denominator: logarithm(denominator) })
        }
    }

    #[test]
    fn loops_become_unstable_at_their_ultimate_gain() {
        let contour =
            |dead_time| Contour { lowest: 1e-7, highest: 1e6, crossing: 100.0, dead_time, shift: 0.0 };
        // Stability limits: k/(s (s + 1)²) at k = 2; k e^{−Ls}/s at k L = π/2.
        for (factor, expected) in [(0.999, 0), (1.001, 2)] {
            let cubic = integrating(2.0 * factor, 0.0, 2);
            assert_eq!(growing_motions(&contour(0.0), &cubic), Ok(expected), "{factor}");
            let delayed = integrating(0.25 * PI * factor, 2.0, 0);
            assert_eq!(growing_motions(&contour(2.0), &delayed), Ok(expected), "{factor}");
        }
        // Each further zero due to the dead time: k L beyond 5π/2.
        assert_eq!(growing_motions(&contour(2.0), &integrating(1.26 * PI, 2.0, 0)), Ok(4));
        assert!(growing_motions(&contour(2.0), &integrating(0.25 * PI, 2.0, 0)).is_err());
    }

    #[test]
    fn an_unstable_plant_is_held_by_enough_gain() {
        let contour = Contour { lowest: 1e-7, highest: 1e6, crossing: 10.0, dead_time: 0.0, shift: 0.0 };
        for (gain, expected) in [(0.9, 1), (1.1, 0)] {
            let open = |s: Complex<f64>| {
                let denominator = s - 1.0;
                let value = Complex::new(gain, 0.0) / denominator;
                Some(OpenLoop { value, log_denominator: logarithm(denominator) })
            };
            assert_eq!(growing_motions(&contour, &open), Ok(expected), "{gain}");
            assert_eq!(growing_motions_open(&contour, &open), Ok(1));
        }
    }

    #[test]
    fn what_neither_grows_nor_fades_is_left_out_by_a_shift() {
        let open = |s: Complex<f64>| {
            let denominator = s * s + 1.0;
            Some(OpenLoop { value: Complex::ZERO, log_denominator: logarithm(denominator) })
        };
        let at = |shift| Contour { lowest: 1e-7, highest: 1e6, crossing: 10.0, dead_time: 0.0, shift };
        assert!(growing_motions_open(&at(0.0), &open).is_err());
        assert_eq!(growing_motions_open(&at(1e-7), &open), Ok(0));
        assert_eq!(growing_motions_open(&at(-1e-3), &open), Ok(2));
    }

    #[test]
    fn a_sampled_integrator_is_unstable_from_twice_its_inverse_step() {
        // k h z⁻¹/(1 − z⁻¹), z = e^{sh}: a zero of 1 + L at z = 1 − k h.
        let step: f64 = 0.1;
        let (lowest, highest) = (1e-5, PI / step);
        let contour = Contour { lowest, highest, crossing: highest, dead_time: step, shift: 0.0 };
        for (gain, expected) in [(19.9, 0), (20.1, 1)] {
            let open = |s: Complex<f64>| {
                let back = (s * -step).exp();
                Some(back * gain * step / (-back + 1.0))
            };
            assert_eq!(growing_sampled_motions(&contour, 0, &open), Ok(expected), "{gain}");
        }
    }
}
