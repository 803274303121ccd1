//! Newton's method for the nodes of one step, converged to rounding.

use nalgebra::SVector;

use crate::linear::{Blocks, Nodes, solve};
use crate::real::Real;
use crate::scheme::StepError;

/// Corrections before giving up. A sane step needs three to five.
const MAX_ITERATIONS: u32 = 50;

/// Largest absolute component.
#[inline]
fn size<T: Real, const N: usize>(vectors: &[SVector<T, N>]) -> T {
    vectors
        .iter()
        .flat_map(|vector| vector.iter())
        .fold(T::zero(), |largest, number| largest.max(number.abs()))
}

/// Solves residual(x) = 0 from the guess `unknowns`; returns the number of corrections.
///
/// `linearise` returns the residual at x and fills in its Jacobian. The iteration ends when a correction is no larger than
/// the rounding of numbers of size `offset` + |x| (the unknowns are increments on something of size `offset`), or, once
/// corrections are below the square root of that, when they stop shrinking: then rounding in the residual makes them.
///
/// # Errors
/// [`StepError::NotFinite`], [`StepError::SingularJacobian`] or [`StepError::NotConverged`].
#[inline]
pub(crate) fn newton<T: Real, const N: usize, const S: usize>(
    unknowns: &mut Nodes<T, N, S>,
    offset: T,
    mut linearise: impl FnMut(&Nodes<T, N, S>, &mut Blocks<T, N, S>) -> Nodes<T, N, S>,
) -> Result<u32, StepError> {
    let mut jacobian = [[nalgebra::SMatrix::zeros(); S]; S];
    let mut previous: Option<T> = None;
    let mut residual_size = T::zero();
    for iteration in 1..=MAX_ITERATIONS {
        let mut correction = linearise(unknowns, &mut jacobian);
        residual_size = size(&correction);
        if !finite(&correction) {
            return Err(StepError::NotFinite);
        }
        solve(&mut jacobian, &mut correction).map_err(|_| StepError::SingularJacobian)?;
        if !finite(&correction) {
            return Err(StepError::NotFinite);
        }
        for (unknown, correction) in unknowns.iter_mut().zip(&correction) {
            *unknown -= correction;
        }
        let (change, scale) = (size(&correction), offset + size(unknowns));
        let resolved = change <= T::of(2.0) * T::EPSILON * scale;
        let stalled =
            previous.is_some_and(|previous| change >= previous) && change <= T::EPSILON.sqrt() * scale;
        if resolved || stalled {
            return Ok(iteration);
        }
        previous = Some(change);
    }
    Err(StepError::NotConverged { iterations: MAX_ITERATIONS, residual: residual_size.to_f64() })
}

fn finite<T: Real, const N: usize>(vectors: &[SVector<T, N>]) -> bool {
    vectors.iter().flat_map(|vector| vector.iter()).all(|number| number.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{SMatrix, vector};

    fn scalar(f: impl Fn(f64) -> (f64, f64)) -> Result<(f64, u32), StepError> {
        let mut unknown = [vector![1.0]];
        let iterations = newton(&mut unknown, 0.0, |x, jacobian| {
            let (value, slope) = f(x[0][0]);
            jacobian[0][0] = SMatrix::from_element(slope);
            [vector![value]]
        })?;
        Ok((unknown[0][0], iterations))
    }

    #[test]
    fn a_root_is_found_to_the_last_digit() {
        let (root, iterations) = scalar(|x| (x * x - 2.0, 2.0 * x)).unwrap();
        assert!((root - 2f64.sqrt()).abs() <= f64::EPSILON);
        assert!(iterations <= 7, "{iterations}");
    }

    #[test]
    fn failures_are_told_apart() {
        assert_eq!(scalar(|_| (1.0, 0.0)), Err(StepError::SingularJacobian));
        assert_eq!(scalar(|_| (f64::NAN, 1.0)), Err(StepError::NotFinite));
        let never = scalar(|x| (x * x + 1.0, 2.0 * x));
        assert!(
            matches!(
                never,
                Err(StepError::NotConverged { iterations: 50, .. } | StepError::SingularJacobian)
            ),
            "{never:?}"
        );
    }
}
