//! Inverses of the small matrices of Runge–Kutta methods.

use nalgebra::{Matrix4, SMatrix};

/// The inverse; not a number for a singular matrix, which does not occur for the methods used here.
///
/// By cofactors, as part of a 4×4 matrix padded with the identity: the same code for every R, accurate enough
/// for the weights of the quadrature.
pub(crate) fn inverse<const R: usize>(matrix: &SMatrix<f64, R, R>) -> SMatrix<f64, R, R> {
    const { assert!(R <= 4, "methods have at most four stages") };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_product_with_a_matrix_is_one() {
        // Not symmetric, with a zero in the first place of the diagonal.
        let matrix = SMatrix::<f64, 3, 3>::new(0.0, 2.0, -1.0, 4.0, 1.0, 0.5, -3.0, 5.0, 7.0);
        let product = inverse(&matrix) * matrix;
        assert!((product - SMatrix::identity()).amax() < 1e-15, "{product}");
        let singular = SMatrix::<f64, 2, 2>::new(1.0, 2.0, 2.0, 4.0);
        assert!(inverse(&singular).iter().all(|entry| entry.is_nan()));
    }
}
