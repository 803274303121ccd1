//! Generating functions of convolution quadratures inside the unit circle, by their principal branches.

use fvi_fft::dense::{ComplexSchur, complex_schur};
use fvi_fft::transfer::multistep_rule::MultistepRule;
use nalgebra::{Complex, DMatrix};

/// γ(z)^β for |z| < 1.
///
/// The rules are A(ϑ)-stable, so γ takes no value on the negative real axis there, and the principal branch
/// is the continuation of γ(0)^β > 0.
pub(crate) fn multistep(rule: MultistepRule, exponent: f64, z: Complex<f64>) -> Complex<f64> {
    scalar_power(rule.symbol(z), exponent)
}

/// Δ(z)^β for |z| < 1, with Δ(z) = A⁻¹ − z A⁻¹ 1 bᵀ A⁻¹ and b the last row of A.
///
/// The methods are A-stable: the eigenvalues of Δ(z) lie in the right half-plane.
pub(crate) fn runge_kutta(inverse: &DMatrix<f64>, exponent: f64, z: Complex<f64>) -> DMatrix<Complex<f64>> {
    matrix_power(&difference(inverse, z), exponent)
}

/// Δ(z).
pub(crate) fn difference(inverse: &DMatrix<f64>, z: Complex<f64>) -> DMatrix<Complex<f64>> {
    let stages = inverse.nrows();
    let sums = inverse.column_sum();
    // bᵀA⁻¹ is the last unit vector.
    DMatrix::from_fn(stages, stages, |i, j| {
        let entry = Complex::new(inverse[(i, j)], 0.0);
        if j + 1 == stages { entry - z * sums[i] } else { entry }
    })
}

/// f of a matrix, by the recurrence for the triangular factor of its Schur decomposition. \[Higham08\]
///
/// For eigenvalues that nearly coincide the derivative of f is used. Not a number where the matrix or f at an
/// eigenvalue is not finite.
pub(crate) fn function_of(
    matrix: &DMatrix<Complex<f64>>,
    function: impl Fn(Complex<f64>) -> Complex<f64>,
) -> DMatrix<Complex<f64>> {
    let size = matrix.nrows();
    let Some(schur) = complex_schur(matrix.clone()) else { return unknown(size) };
    let ComplexSchur { unitary, triangular, scale } = schur;
    let function = |s: Complex<f64>| function(s * scale);
    let mut found = DMatrix::from_diagonal(&triangular.diagonal().map(function));
    for apart in 1..size {
        for row in 0..size - apart {
            let column = row + apart;
            let (left, right) = (triangular[(row, row)], triangular[(column, column)]);
            let between: Complex<f64> = (row + 1..column)
                .map(|k| {
                    found[(row, k)] * triangular[(k, column)] - triangular[(row, k)] * found[(k, column)]
                })
                .sum();
            let gap = left - right;
            let near = 1e-6 * (left.norm() + right.norm());
            found[(row, column)] = if gap.norm() > near {
                (triangular[(row, column)] * (found[(row, row)] - found[(column, column)]) + between) / gap
            } else {
                let middle = (left + right) * 0.5;
                let slope = (function(middle + near) - function(middle - near)) / (2.0 * near);
                triangular[(row, column)] * slope
            };
        }
    }
    &unitary * found * unitary.adjoint()
}

fn unknown(size: usize) -> DMatrix<Complex<f64>> {
    DMatrix::from_element(size, size, Complex::new(f64::NAN, f64::NAN))
}

fn scalar_power(base: Complex<f64>, exponent: f64) -> Complex<f64> {
    if exponent == 0.0 {
        return Complex::new(1.0, 0.0);
    }
    let (size, angle) = (libm::pow(base.norm(), exponent), exponent * libm::atan2(base.im, base.re));
    Complex::new(size * libm::cos(angle), size * libm::sin(angle))
}

/// Principal power, 0 ≤ exponent < 2, of a matrix without eigenvalues on the negative real axis.
///
/// Square roots of the triangular factor of the Schur decomposition until it is near the identity, then the
/// binomial series and repeated squaring. Eigenvalues may coincide.
fn matrix_power(matrix: &DMatrix<Complex<f64>>, exponent: f64) -> DMatrix<Complex<f64>> {
    let size = matrix.nrows();
    if exponent == 0.0 {
        return DMatrix::identity(size, size);
    }
    if exponent == 1.0 {
        return matrix.clone();
    }
    if exponent > 1.0 {
        return matrix_power(matrix, exponent - 1.0) * matrix;
    }
    let Some(schur) = complex_schur(matrix.clone()) else { return unknown(size) };
    let ComplexSchur { unitary, triangular, scale } = schur;
    let identity = DMatrix::<Complex<f64>>::identity(size, size);
    let (mut root, mut roots) = (triangular.clone(), 0);
    while roots < 40 && (&root - &identity).norm() > 0.2 {
        root = triangular_root(&root);
        roots += 1;
    }
    let away = &identity - root;
    let (mut term, mut power) = (identity.clone(), identity);
    for j in 1..40 {
        term = &term * &away * Complex::new((f64::from(j) - 1.0 - exponent) / f64::from(j), 0.0);
        power += &term;
        if term.norm() < 1e-18 {
            break;
        }
    }
    for _ in 0..roots {
        power = &power * &power;
    }
    for i in 0..size {
        power[(i, i)] = scalar_power(triangular[(i, i)], exponent);
    }
    &unitary * power * unitary.adjoint() * Complex::new(libm::pow(scale, exponent), 0.0)
}

/// Principal square root of an upper triangular matrix.
fn triangular_root(matrix: &DMatrix<Complex<f64>>) -> DMatrix<Complex<f64>> {
    let size = matrix.nrows();
    let mut root = DMatrix::zeros(size, size);
    for column in 0..size {
        root[(column, column)] = matrix[(column, column)].sqrt();
        for row in (0..column).rev() {
            let between: Complex<f64> = (row + 1..column).map(|k| root[(row, k)] * root[(k, column)]).sum();
            root[(row, column)] =
                (matrix[(row, column)] - between) / (root[(row, row)] + root[(column, column)]);
        }
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dmatrix;

    #[test]
    fn a_function_of_any_matrix_is_found_or_not_a_number() {
        let inverse = dmatrix![1.5, 0.5; -4.5, 2.5];
        let delta = difference(&inverse, Complex::new(0.3, 0.9));
        for size in [1e-300, 1e-160, 1e160, 1e300] {
            let scaled = &delta * Complex::new(size, 0.0);
            let found = function_of(&scaled, |s| scalar_power(s / size, 0.7));
            let error = (found - matrix_power(&delta, 0.7)).norm();
            assert!(error < 1e-12, "{size:e}: {error:e}");
        }
        let mut broken = delta;
        for entry in [f64::NAN, f64::INFINITY] {
            broken[(1, 0)] = Complex::new(entry, 0.0);
            assert!(function_of(&broken, |s| s).iter().all(|found| found.is_nan()), "{entry}");
            assert!(matrix_power(&broken, 0.3).iter().all(|found| found.is_nan()), "{entry}");
        }
    }

    #[test]
    fn functions_of_a_matrix_are_its_powers_where_they_are_powers() {
        let inverse = dmatrix![1.5, 0.5; -4.5, 2.5];
        for z in [Complex::new(0.3, 0.9), Complex::new(-0.2, 0.4)] {
            let found = function_of(&difference(&inverse, z), |s| scalar_power(s, 0.7));
            let error = (found - runge_kutta(&inverse, 0.7, z)).norm();
            assert!(error < 1e-12, "{z}: {error:e}");
        }
    }

    #[test]
    fn powers_of_a_matrix_form_a_semigroup() {
        // Radau IIA of two stages, close to the branch point too.
        let inverse = dmatrix![1.5, 0.5; -4.5, 2.5];
        for z in [Complex::new(0.3, 0.9), Complex::new(1.0 - 1e-6, 1e-7), Complex::new(-0.999, 0.0)] {
            for (a, b) in [(0.3, 0.5), (0.9, 0.95), (0.25, 0.75)] {
                let product = runge_kutta(&inverse, a, z) * runge_kutta(&inverse, b, z);
                let error = (&product - runge_kutta(&inverse, a + b, z)).norm() / product.norm();
                assert!(error < 1e-12, "{z}, {a} + {b}: {error:e}");
            }
        }
    }

    #[test]
    fn the_branch_of_the_formulas_is_the_one_of_the_power_series() {
        // Σ w_n zⁿ well inside the circle; towards it arg γ₆ exceeds 160°.
        let order = fvi_core::BdfOrder::new(6).unwrap();
        for exponent in [0.5, 1.2, 1.9] {
            let mut weights = vec![0.0; 4000];
            fvi_core::ConvolutionWeights::bdf(order, exponent, 1.0).unwrap().fill(&mut weights);
            for angle in [0.4, 0.9, 1.6, 3.0f64] {
                let z = Complex::new(angle.cos(), angle.sin()) * 0.99;
                let series: Complex<f64> =
                    weights.iter().rev().fold(Complex::ZERO, |sum, &weight| sum * z + weight);
                let error = (series - multistep(order.into(), exponent, z)).norm();
                assert!(error < 1e-9, "β = {exponent}, {angle}: {error:e}");
            }
        }
    }
}
