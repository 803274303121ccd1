//! Polynomials of many real coefficients at many complex places.

use nalgebra::Complex;
use pulp::{Arch, NullaryFnOnce};

/// Σ c_i zⁱ over i < n at places (z, n), by Horner's rule for several neighbouring places at a time.
///
/// All of them have as many terms as the one that needs the most. Every place has its own operations, in the
/// same order whatever the number of places is, hence the same bits on every processor.
pub(super) fn polynomial(
    coefficient: impl Fn(usize) -> f64 + Copy,
    places: &[(Complex<f64>, usize)],
) -> Vec<Complex<f64>> {
    let unit = Arch::new();
    let several = |places: &[(Complex<f64>, usize)]| match places {
        [_] => unit.dispatch(Horner::<1, _> { coefficient, places }),
        _ if places.len() <= 4 => unit.dispatch(Horner::<4, _> { coefficient, places }),
        _ => unit.dispatch(Horner::<16, _> { coefficient, places }),
    };
    places.chunks(16).flat_map(several).collect()
}

/// At most N places as a call that is compiled once for every vector unit.
struct Horner<'a, const N: usize, C> {
    coefficient: C,
    places: &'a [(Complex<f64>, usize)],
}

impl<const N: usize, C: Fn(usize) -> f64> NullaryFnOnce for Horner<'_, N, C> {
    type Output = Vec<Complex<f64>>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let (mut re, mut im) = ([0.0; N], [0.0; N]);
        for (lane, (z, _)) in self.places.iter().enumerate() {
            (re[lane], im[lane]) = (z.re, z.im);
        }
        let most = self.places.iter().map(|place| place.1).max().unwrap_or(0);
        let mut sums = ([0.0; N], [0.0; N]);
        for i in (0..most).rev() {
            let coefficient = (self.coefficient)(i);
            let mut next = ([0.0; N], [0.0; N]);
            for lane in 0..N {
                let (a, b) = (sums.0[lane], sums.1[lane]);
                next.0[lane] = a * re[lane] - b * im[lane] + coefficient;
                next.1[lane] = a * im[lane] + b * re[lane];
            }
            sums = next;
        }
        (0..self.places.len()).map(|lane| Complex::new(sums.0[lane], sums.1[lane])).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_of_places_has_the_sums_of_the_rule() {
        let coefficient = |i: usize| libm::cos(1.3 * i as f64);
        let place = |k: usize| Complex::from_polar(1.0 - 0.01 * k as f64, 0.37 * k as f64);
        for count in 0..40 {
            let places: Vec<(Complex<f64>, usize)> = (0..count).map(|k| (place(k), 200)).collect();
            let found = polynomial(coefficient, &places);
            let sum = |z| (0..200).rev().fold(Complex::new(0.0, 0.0), |sum, i| sum * z + coefficient(i));
            let known: Vec<Complex<f64>> = places.iter().map(|&(z, _)| sum(z)).collect();
            assert_eq!(found, known, "{count}");
        }
        // Σ zⁱ with as many terms as the place that needs the most.
        let half = Complex::new(0.5, 0.0);
        assert_eq!(polynomial(|_| 1.0, &[(half, 1), (half, 3)]), [Complex::new(1.75, 0.0); 2]);
    }
}
