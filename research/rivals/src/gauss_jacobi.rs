//! Gauss rules for powers.

use nalgebra::{DMatrix, SymmetricEigen};

/// Nodes and weights of the rule of `count` points for ∫₀¹ x^p f(x) dx, p > −1; p = 0 is Gauss–Legendre.
///
/// From the eigenvalues of the Jacobi matrix and the first components of its eigenvectors \[GolubWelsch69\].
pub(crate) fn gauss_jacobi(count: usize, power: f64) -> Vec<(f64, f64)> {
    let p = power;
    let mut jacobi = DMatrix::zeros(count, count);
    for k in 0..count {
        let n = k as f64;
        // Recurrence of the Jacobi polynomials for the weight (1 + t)^p on (−1, 1).
        jacobi[(k, k)] = if k == 0 { p / (p + 2.0) } else { p * p / ((2.0 * n + p) * (2.0 * n + p + 2.0)) };
        if k > 0 {
            let square = if k == 1 {
                4.0 * (1.0 + p) / ((2.0 + p) * (2.0 + p) * (3.0 + p))
            } else {
                let s = 2.0 * n + p;
                4.0 * n * n * (n + p) * (n + p) / (s * s * (s + 1.0) * (s - 1.0))
            };
            jacobi[(k, k - 1)] = square.sqrt();
            jacobi[(k - 1, k)] = square.sqrt();
        }
    }
    let eigen = SymmetricEigen::new(jacobi);
    let rule = |i: usize| {
        let first = eigen.eigenvectors[(0, i)];
        (0.5 * (1.0 + eigen.eigenvalues[i]), first * first / (p + 1.0))
    };
    (0..count).map(rule).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_are_exact_for_polynomials_of_twice_their_points() {
        for power in [0.0, -0.5, 0.3, 1.0] {
            for count in [1, 2, 5, 12] {
                for degree in 0..2 * count {
                    let sum: f64 =
                        gauss_jacobi(count, power).iter().map(|(x, w)| w * x.powi(degree as i32)).sum();
                    let exact = 1.0 / (power + degree as f64 + 1.0);
                    assert!((sum / exact - 1.0).abs() < 1e-13, "{power}, {count}, {degree}: {sum}");
                }
            }
        }
    }
}
