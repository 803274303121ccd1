//! Number of zeros of an analytic function inside a circle, by the argument principle.

use nalgebra::Complex;
use std::cell::Cell;
use std::f64::consts::PI;

/// Resolution with which a logarithm is followed along a path.
pub(in crate::simulation) struct Fineness {
    /// Largest increment between neighbouring points.
    pub(in crate::simulation) followed: f64,
    /// Initial number of parts of the path.
    pub(in crate::simulation) parts: usize,
    /// Largest number of halvings of a part.
    pub(in crate::simulation) halvings: u32,
}

/// For the half-circle: down to 10⁻¹³ of it.
pub(super) const FINENESS: Fineness = Fineness { followed: 0.5, parts: 16, halvings: 41 };

/// The same for a second count. Between neighbouring points some of many zeros in a row may turn the phase a
/// whole number of times and leave the size: the smaller the increments, the rarer that is.
pub(super) const FINER: Fineness = Fineness { followed: 0.2, ..FINENESS };

/// Largest number of evaluations of the function in a count: a zero near the circle takes some fifty, noise
/// any number.
const MOST_VALUES: usize = 20_000;

/// Result of a count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Count {
    /// Number of zeros.
    Zeros(usize),
    /// A zero lies on the circle, or the function is not finite.
    Unknown,
    /// The phase changes too often to be followed, as for rounding errors after cancellation.
    Endless,
}

/// Number of zeros in |z| < radius of a function with real coefficients, given by any branch of its
/// logarithm.
///
/// The phase is followed over the upper half of the circle, from the real axis to the real axis; the
/// conjugate half contributes equally. Intervals are halved until the logarithm, size and phase, changes
/// little over both halves of each. Unlike the phase alone this seldom misses several zeros close together
/// near the circle: they would change the phase by a multiple of 2π, but the function is small on the way.
pub(super) fn zeros_inside(
    radius: f64,
    fineness: &Fineness,
    logarithm: impl Fn(Complex<f64>) -> Option<Complex<f64>>,
) -> Count {
    let left = Cell::new(MOST_VALUES);
    match turns(radius, (fineness, &left), logarithm) {
        Some(zeros) => Count::Zeros(zeros),
        None if left.get() == 0 => Count::Endless,
        None => Count::Unknown,
    }
}

fn turns(
    radius: f64,
    (fineness, left): (&Fineness, &Cell<usize>),
    logarithm: impl Fn(Complex<f64>) -> Option<Complex<f64>>,
) -> Option<usize> {
    let at = |angle: f64| {
        left.set(left.get().checked_sub(1)?);
        let value = logarithm(Complex::new(radius * libm::cos(angle), radius * libm::sin(angle)))?;
        (value.re.is_finite() && value.im.is_finite()).then_some(value)
    };
    let turned = turned(PI, fineness, at)?;
    let zeros = (turned / PI).round();
    (zeros >= 0.0 && (turned / PI - zeros).abs() < 0.1).then_some(zeros as usize)
}

/// Change of the phase of a function from 0 to `end`, given any branch of its logarithm; `None` if the
/// logarithm does not exist or cannot be followed.
pub(in crate::simulation) fn turned(
    end: f64,
    fineness: &Fineness,
    logarithm: impl Fn(f64) -> Option<Complex<f64>>,
) -> Option<f64> {
    let at = |place: f64| logarithm(place).map(|value| (place, value));
    sum_over_parts(end, fineness, at, |[left, middle, right]| {
        let (first, second) = (increment(left.1, middle.1), increment(middle.1, right.1));
        let is_followed = first.norm() < fineness.followed && second.norm() < fineness.followed;
        is_followed.then_some(first.im + second.im)
    })
}

/// The same for a product of many factors, whose phase may turn several times within each part.
///
/// Slopes, from values beside each place, tell the increment over a part by Simpson's rule, the logarithm how
/// far that is off but for whole turns. A part is halved until this is little, and Simpson's rule and the
/// trapezoidal one differ by less than half a turn.
pub(in crate::simulation) fn turned_by_slopes(
    end: f64,
    fineness: &Fineness,
    logarithm: impl Fn(f64) -> Option<Complex<f64>>,
) -> Option<f64> {
    const BESIDE: f64 = 1e-8;
    let at = |place: f64| {
        let (before, behind) = (logarithm(place - BESIDE)?, logarithm(place + BESIDE)?);
        let change = increment(before, behind);
        Some((place, (before + change * 0.5, change / (2.0 * BESIDE))))
    };
    sum_over_parts(end, fineness, at, |[left, middle, right]| {
        let width = right.0 - left.0;
        let ((first, before), (_, between), (last, behind)) = (left.1, middle.1, right.1);
        let simpson = (before + between * 4.0 + behind) * (width / 6.0);
        let trapezoidal = (before + between * 2.0 + behind) * (width / 4.0);
        let off = increment(simpson, increment(first, last));
        let is_followed = (simpson - trapezoidal).norm() < PI && off.norm() < fineness.followed;
        is_followed.then_some(simpson.im + off.im)
    })
}

/// Sum over parts of [0, `end`] of what `of` finds from a part's left end, middle and right end, each a place
/// and a value; where it finds nothing the part is halved. `None` if a value does not exist, or the last
/// halves are not enough.
fn sum_over_parts<V: Copy>(
    end: f64,
    fineness: &Fineness,
    at: impl Fn(f64) -> Option<(f64, V)>,
    of: impl Fn([(f64, V); 3]) -> Option<f64>,
) -> Option<f64> {
    let mut intervals = Vec::new();
    let mut left = at(0.0)?;
    for part in 1..=fineness.parts {
        let right = at(end * part as f64 / fineness.parts as f64)?;
        intervals.push((left, right, 0));
        left = right;
    }
    let mut sum = 0.0;
    while let Some((left, right, halvings)) = intervals.pop() {
        let middle = at(0.5 * (left.0 + right.0))?;
        match of([left, middle, right]) {
            Some(found) => sum += found,
            None if halvings < fineness.halvings => {
                intervals.push((left, middle, halvings + 1));
                intervals.push((middle, right, halvings + 1));
            }
            None => return None,
        }
    }
    Some(sum)
}

/// Difference of two logarithms, its phase in [−π, π].
fn increment(from: Complex<f64>, to: Complex<f64>) -> Complex<f64> {
    let phase = to.im - from.im;
    Complex::new(to.re - from.re, phase - 2.0 * PI * (phase / (2.0 * PI)).round())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(radius: f64, zeros: &[(f64, f64)]) -> Option<usize> {
        let found = zeros_inside(radius, &FINENESS, |z| {
            let product: Complex<f64> = zeros
                .iter()
                .map(|&(size, angle)| {
                    let zero = |sign: f64| Complex::new(size * angle.cos(), sign * size * angle.sin());
                    (z - zero(1.0)) * (z - zero(-1.0))
                })
                .product();
            Some(Complex::new(product.norm().ln(), product.arg()))
        });
        match found {
            Count::Zeros(zeros) => Some(zeros),
            _ => None,
        }
    }

    /// A row of zeros that crosses the circle, as of a chain near the end of its band.
    #[test]
    fn hundreds_of_zeros_close_together_are_counted() {
        let zeros: Vec<Complex<f64>> = (1..=500)
            .map(|k| {
                let angle = f64::from(k) * PI / 1002.0;
                Complex::new(-0.05 * angle.sin(), 2.0 * angle.sin())
            })
            .collect();
        for (centre, radius) in [(2.6, 0.601), (2.6, 0.65), (1.0, 0.3), (1.9, 0.05), (3.0, 2.0)] {
            let centre = Complex::new(0.0, centre);
            let logarithm = |angle: f64| {
                let s = centre + Complex::new(angle.cos(), angle.sin()) * radius;
                Some(zeros.iter().map(|zero| Complex::new((s - zero).norm().ln(), (s - zero).arg())).sum())
            };
            let fineness = Fineness { followed: 0.3, parts: 8, halvings: 22 };
            let turned = turned_by_slopes(2.0 * PI, &fineness, logarithm).unwrap();
            let inside = zeros.iter().filter(|zero| (*zero - centre).norm() < radius).count();
            assert!(
                (turned / (2.0 * PI) - inside as f64).abs() < 1e-3,
                "{centre}, {radius}: {turned} {inside}"
            );
        }
    }

    #[test]
    fn what_turns_too_often_is_given_up() {
        let values = Cell::new(0);
        let found = zeros_inside(1.0, &FINENESS, |z| {
            values.set(values.get() + 1);
            Some(Complex::new(0.0, 10.0 * libm::sin(1e6 * z.re)))
        });
        assert_eq!(found, Count::Endless);
        assert_eq!(values.get(), MOST_VALUES);
    }

    #[test]
    fn zeros_close_to_the_circle_are_told_apart_together_and_alone() {
        let radius = 1.0 - 1e-6;
        for angle in [1e-5, 0.01, 0.7, 2.0, 3.1] {
            for gap in [1e-1, 1e-3, 1e-7] {
                let (inside, outside) = ((radius - gap, angle), (radius + gap, angle));
                assert_eq!(count(radius, &[inside]), Some(2));
                assert_eq!(count(radius, &[outside]), Some(0));
                assert_eq!(count(radius, &[outside; 3]), Some(0), "three at {angle}, {gap}");
                assert_eq!(count(radius, &[inside; 3]), Some(6), "three at {angle}, {gap}");
                assert_eq!(count(radius, &[inside, outside, (radius + 0.5, 1.0)]), Some(2));
            }
        }
        assert_eq!(count(0.5, &[(0.5, 1.0)]), None);
    }

    /// Thirty modes of the midpoint rule at h = 0.01, one of which grows outside the circle.
    #[test]
    fn zeros_in_a_row_are_counted_right_by_small_increments() {
        let step = 0.01;
        let stiffness: Vec<f64> =
            (0..30).map(|j| if j == 0 { -0.06 } else { 0.25 * f64::from(j).powf(1.5) }).collect();
        let radius = libm::exp(-2.0 * 0.06_f64.sqrt() * step);
        let count = |fineness: &Fineness| {
            zeros_inside(radius, fineness, |z| {
                let mean = (z + 1.0) * 0.5 * step;
                let mode = |k: &f64| (Complex::from(1.0) - z).powi(2) + mean * mean * *k;
                Some(stiffness.iter().map(|k| Complex::new(mode(k).norm().ln(), mode(k).arg())).sum())
            })
        };
        assert_eq!(count(&FINER), Count::Zeros(0));
        // What the second count is for: two turns that the first one does not see.
        assert_eq!(count(&FINENESS), Count::Zeros(4));
    }
}
