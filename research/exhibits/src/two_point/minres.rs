//! The minimal-residual method for symmetric systems, with a positive definite preconditioner.

/// Result of the iteration.
#[derive(Clone, Debug)]
pub(super) struct Solution {
    pub(super) unknowns: Vec<f64>,
    pub(super) iterations: usize,
    /// Norm of the residual that was reached, relative to that of the right side, in the norm ‖r‖² = r·M⁻¹r.
    pub(super) reduction: f64,
}

/// Stopping criteria.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub(super) reduction: f64,
    pub(super) iterations: usize,
}

/// Solves A x = b for symmetric A, which may be indefinite, by Lanczos vectors of M⁻¹A: each iterate
/// minimises the residual in the norm of M⁻¹ over a Krylov space that grows by one dimension an iteration,
/// with one product with A and one with M⁻¹ in each iteration. Memory: nine vectors.
///
/// Source: \[PaigeSaunders75\].
pub(super) fn solve(
    right_side: &[f64],
    mut product: impl FnMut(&[f64]) -> Vec<f64>,
    mut precondition: impl FnMut(&[f64]) -> Vec<f64>,
    limits: Limits,
) -> Solution {
    let mut unknowns = vec![0.0; right_side.len()];
    let mut residual = right_side.to_vec();
    let mut preconditioned = precondition(&residual);
    let first_beta = inner(&residual, &preconditioned).sqrt();
    if first_beta == 0.0 {
        return Solution { unknowns, iterations: 0, reduction: 0.0 };
    }
    let mut previous_residual = residual.clone();
    let (mut beta, mut previous_beta) = (first_beta, first_beta);
    // The rotation that turns the tridiagonal matrix into an upper triangular one, row by row.
    let (mut cosine, mut sine) = (-1.0, 0.0);
    let (mut diagonal, mut above) = (0.0, 0.0);
    let mut remaining = first_beta;
    let mut direction = vec![0.0; right_side.len()];
    let mut previous_direction = direction.clone();
    let mut iterations = 0;
    while iterations < limits.iterations && remaining > limits.reduction * first_beta {
        iterations += 1;
        let lanczos: Vec<f64> = preconditioned.iter().map(|y| y / beta).collect();
        let mut next = product(&lanczos);
        if iterations > 1 {
            add(&mut next, -beta / previous_beta, &previous_residual);
        }
        let alpha = inner(&lanczos, &next);
        add(&mut next, -alpha / beta, &residual);
        previous_residual = core::mem::replace(&mut residual, next);
        preconditioned = precondition(&residual);
        previous_beta = beta;
        // Rounding may leave a tiny negative square where the Krylov space is exhausted.
        beta = inner(&residual, &preconditioned).max(0.0).sqrt();

        let two_above = above;
        let one_above = cosine * diagonal + sine * alpha;
        let corner = sine * diagonal - cosine * alpha;
        above = sine * beta;
        diagonal = -cosine * beta;
        let pivot = corner.hypot(beta).max(f64::MIN_POSITIVE);
        cosine = corner / pivot;
        sine = beta / pivot;
        let advance = cosine * remaining;
        remaining *= sine;

        for (i, entry) in lanczos.iter().enumerate() {
            let new = (entry - two_above * previous_direction[i] - one_above * direction[i]) / pivot;
            previous_direction[i] = direction[i];
            direction[i] = new;
            unknowns[i] += advance * new;
        }
        if beta <= f64::EPSILON * first_beta {
            break;
        }
    }
    Solution { unknowns, iterations, reduction: remaining / first_beta }
}

/// x·y.
pub(super) fn inner(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(a, b)| a * b).sum()
}

fn add(target: &mut [f64], factor: f64, other: &[f64]) {
    for (entry, value) in target.iter_mut().zip(other) {
        *entry += factor * value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MATRIX: [[f64; 4]; 4] =
        [[4.0, 1.0, 0.0, -2.0], [1.0, -3.0, 0.5, 0.0], [0.0, 0.5, 2.0, 1.0], [-2.0, 0.0, 1.0, 1.0]];

    fn multiply(x: &[f64]) -> Vec<f64> {
        MATRIX.iter().map(|row| inner(row, x)).collect()
    }

    #[test]
    fn an_indefinite_system_is_solved_in_as_many_iterations_as_unknowns() {
        let expected = [1.0, -2.0, 3.0, 0.25];
        let right_side = multiply(&expected);
        let limits = Limits { reduction: 1e-13, iterations: 4 };
        for scale in [[1.0; 4], [0.25, 0.3, 0.5, 1.0]] {
            let precondition = |r: &[f64]| r.iter().zip(scale).map(|(a, b)| a * b).collect();
            let solution = solve(&right_side, multiply, precondition, limits);
            for (value, exact) in solution.unknowns.iter().zip(expected) {
                assert!((value - exact).abs() < 1e-11, "{:?}", solution);
            }
        }
    }

    #[test]
    fn the_reported_reduction_is_that_of_the_true_residual() {
        let right_side = [1.0, 2.0, -1.0, 0.5];
        let limits = Limits { reduction: 0.0, iterations: 2 };
        let solution = solve(&right_side, multiply, <[f64]>::to_vec, limits);
        let product = multiply(&solution.unknowns);
        let residual: Vec<f64> = right_side.iter().zip(&product).map(|(b, p)| b - p).collect();
        let reduction = (inner(&residual, &residual) / inner(&right_side, &right_side)).sqrt();
        assert!((solution.reduction - reduction).abs() < 1e-13);
        assert!(reduction > 1e-3);
    }

    #[test]
    fn an_exact_preconditioner_needs_one_iteration() {
        let diagonal = [2.0, 5.0, 0.1];
        let product = |x: &[f64]| x.iter().zip(diagonal).map(|(a, b)| a * b).collect();
        let precondition = |r: &[f64]| r.iter().zip(diagonal).map(|(a, b)| a / b).collect();
        let limits = Limits { reduction: 1e-12, iterations: 50 };
        let solution = solve(&[1.0, 1.0, 1.0], product, precondition, limits);
        assert_eq!(solution.iterations, 1);
    }
}
