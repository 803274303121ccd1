//! Inverses of the small matrices of Runge–Kutta methods.

use crate::sums::max_or_nan;
use fvi_core::{factor, invert_factored};
use nalgebra::{Matrix4, SMatrix};
use std::f64::consts::PI;

/// The inverse; not a number for a singular matrix, which does not occur for the methods used here.
///
/// Up to R = 4 by cofactors, as part of a 4×4 matrix padded with the identity: the same code for every R,
/// accurate enough for the weights of the quadrature. Beyond by elimination.
pub(crate) fn inverse<const R: usize>(matrix: &SMatrix<f64, R, R>) -> SMatrix<f64, R, R> {
    if R > 4 {
        let mut inverse = SMatrix::<f64, R, R>::zeros();
        // Elimination reads rows and writes columns.
        let (mut factors, mut pivots) = (matrix.transpose(), [0; R]);
        eliminate(factors.as_mut_slice(), &mut pivots, inverse.as_mut_slice());
        return inverse;
    }
    let mut whole = Matrix4::identity();
    whole.view_mut((0, 0), (R, R)).copy_from(matrix);
    invert(&mut whole);
    SMatrix::from_fn(|row, column| whole[(row, column)])
}

/// A separate function, so that it is compiled once.
#[inline(never)]
fn invert(matrix: &mut Matrix4<f64>) {
    if !matrix.try_inverse_mut() {
        matrix.fill(f64::NAN);
    }
}

/// Likewise, for the other methods.
#[inline(never)]
fn eliminate(matrix: &mut [f64], pivots: &mut [usize], inverse: &mut [f64]) {
    match factor(matrix, pivots) {
        Ok(()) => invert_factored(matrix, pivots, inverse),
        Err(_) => inverse.fill(f64::NAN),
    }
}

/// A^{−μ} of a matrix with eigenvalues in |arg| ≤ 1.2, for 0 ≤ μ ≤ 1: the integral
///
/// ```text
/// A^{−μ} = (sin πμ / π) ∫ λ^{1−μ} (λ + A)^{−1} d ln λ
/// ```
///
/// by the trapezoidal rule, which converges like e^{−2π(π − 1.2)/d} in its spacing d. Its nodes far beyond
/// the spectrum on either side are summed in closed form, as geometric series for each power of λ or 1/λ.
pub(crate) fn power<const R: usize>(matrix: &SMatrix<f64, R, R>, mu: f64) -> SMatrix<f64, R, R> {
    const SPACING: f64 = 0.28;
    const POWERS: usize = 8;
    /// How far beyond: the next power of its inverse is below rounding.
    const BEYOND: f64 = 100.0;
    if mu == 0.0 {
        return SMatrix::identity();
    }
    let inverted = inverse(matrix);
    if mu == 1.0 {
        return inverted;
    }
    let size =
        |matrix: &SMatrix<f64, R, R>| matrix.row_iter().map(|row| row.abs().sum()).fold(0.0, max_or_nan);
    let begin = -libm::log(BEYOND * size(&inverted));
    let count = ((libm::log(BEYOND * size(matrix)) - begin) / SPACING).ceil() as usize;
    let mut sum = SMatrix::<f64, R, R>::zeros();
    for k in 0..count {
        let place = begin + k as f64 * SPACING;
        let shifted = SMatrix::identity() * libm::exp(place) + matrix;
        sum += inverse(&shifted) * libm::exp((1.0 - mu) * place);
    }
    let (above, below) = (begin + count as f64 * SPACING, begin - SPACING);
    let (mut of_large, mut of_small) = (SMatrix::<f64, R, R>::identity(), inverted);
    for m in 0..=POWERS {
        let (large, small) = (mu + m as f64, (1.0 - mu) + m as f64);
        sum -= of_large * (libm::exp(-large * above) / libm::expm1(-large * SPACING));
        sum -= of_small * (libm::exp(small * below) / libm::expm1(-small * SPACING));
        (of_large, of_small) = (-of_large * matrix, -of_small * inverted);
    }
    // Exact also near 1.
    sum * (libm::sin(PI * mu.min(1.0 - mu)) / PI * SPACING)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quadrature::runge_kutta_weights::RungeKuttaWeights;
    use fvi_core::RungeKutta;

    #[test]
    fn the_product_with_a_matrix_is_one() {
        // Not symmetric, with a zero in the first place of the diagonal.
        let matrix = SMatrix::<f64, 3, 3>::new(0.0, 2.0, -1.0, 4.0, 1.0, 0.5, -3.0, 5.0, 7.0);
        let product = inverse(&matrix) * matrix;
        assert!((product - SMatrix::identity()).amax() < 1e-15, "{product}");
        let singular = SMatrix::<f64, 2, 2>::new(1.0, 2.0, 2.0, 4.0);
        assert!(inverse(&singular).iter().all(|entry| entry.is_nan()));
    }

    fn check<const R: usize>(method: RungeKutta<R>) {
        let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
        let inverted = inverse(&matrix);
        assert!((inverted * matrix - SMatrix::identity()).amax() < 1e-13);
        for mu in [0.0, 1e-3, 0.2, 0.5, 0.93, 1.0 - 1e-9, 1.0] {
            let found = power(&matrix, mu);
            let product = found * power(&matrix, 1.0 - mu);
            assert!((product - inverted).amax() < 1e-13 * inverted.amax(), "{R}: {mu}");
            let known = RungeKuttaWeights::new(&method, mu, 1.0, 1).unwrap();
            assert!((found - known.leading()).amax() < 1e-13 * found.amax(), "{R}: {mu}");
        }
    }

    #[test]
    fn powers_make_up_the_inverse_and_agree_with_the_contour() {
        check(RungeKutta::<1>::radau_iia().unwrap());
        check(RungeKutta::<2>::radau_iia().unwrap());
        check(RungeKutta::<3>::radau_iia().unwrap());
        check(RungeKutta::<5>::radau_iia().unwrap());
        check(RungeKutta::<7>::radau_iia().unwrap());
        check(RungeKutta::<2>::lobatto_iiic().unwrap());
        check(RungeKutta::<3>::lobatto_iiic().unwrap());
        check(RungeKutta::<4>::lobatto_iiic().unwrap());
    }
}
