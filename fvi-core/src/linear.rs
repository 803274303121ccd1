//! Small dense linear algebra: elimination on blocks, and what symmetric matrices must satisfy.

use nalgebra::{SMatrix, SVector};

use crate::real::Real;

/// S×S blocks of N×N numbers: the Jacobian of a step with S unknown nodes.
pub(crate) type Blocks<T, const N: usize, const S: usize> = [[SMatrix<T, N, N>; S]; S];

/// S vectors of N numbers.
pub(crate) type Nodes<T, const N: usize, const S: usize> = [SVector<T, N>; S];

/// A pivot vanished: the matrix is singular to working precision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Singular;

/// Entry in row (a, i) and column (b, j) of a matrix of blocks.
#[inline]
fn entry<T: Real, const N: usize, const S: usize>(matrix: &Blocks<T, N, S>, row: usize, column: usize) -> T {
    matrix
        .get(row / N.max(1))
        .and_then(|blocks| blocks.get(column / N.max(1)))
        .and_then(|block| block.get((row % N.max(1), column % N.max(1))))
        .copied()
        .unwrap_or(T::zero())
}

#[inline]
fn entry_mut<T: Real, const N: usize, const S: usize>(
    matrix: &mut Blocks<T, N, S>,
    row: usize,
    column: usize,
) -> Option<&mut T> {
    matrix
        .get_mut(row / N.max(1))
        .and_then(|blocks| blocks.get_mut(column / N.max(1)))
        .and_then(|block| block.get_mut((row % N.max(1), column % N.max(1))))
}

#[inline]
fn component<T: Real, const N: usize, const S: usize>(vector: &Nodes<T, N, S>, row: usize) -> T {
    vector.get(row / N.max(1)).and_then(|node| node.get(row % N.max(1))).copied().unwrap_or(T::zero())
}

#[inline]
fn component_mut<T: Real, const N: usize, const S: usize>(
    vector: &mut Nodes<T, N, S>,
    row: usize,
) -> Option<&mut T> {
    vector.get_mut(row / N.max(1)).and_then(|node| node.get_mut(row % N.max(1)))
}

/// Solves `matrix` · x = `vector` in place by elimination with row pivoting; x replaces `vector`.
///
/// # Errors
/// [`Singular`] if no pivot of a column is larger than rounding of that column's largest entry, or one is not a number.
pub(crate) fn solve<T: Real, const N: usize, const S: usize>(
    matrix: &mut Blocks<T, N, S>,
    vector: &mut Nodes<T, N, S>,
) -> Result<(), Singular> {
    let size = N * S;
    for column in 0..size {
        let mut largest = T::zero();
        for row in 0..size {
            largest = largest.max(entry(matrix, row, column).abs());
        }
        let (mut pivot_row, mut pivot) = (column, T::zero());
        for row in column..size {
            let candidate = entry(matrix, row, column);
            if candidate.abs() > pivot.abs() {
                (pivot_row, pivot) = (row, candidate);
            }
        }
        if !pivot.is_finite() || pivot.abs() <= largest * T::EPSILON {
            return Err(Singular);
        }
        if pivot_row != column {
            for other in column..size {
                let (upper, lower) = (entry(matrix, column, other), entry(matrix, pivot_row, other));
                put(entry_mut(matrix, column, other), lower);
                put(entry_mut(matrix, pivot_row, other), upper);
            }
            let (upper, lower) = (component(vector, column), component(vector, pivot_row));
            put(component_mut(vector, column), lower);
            put(component_mut(vector, pivot_row), upper);
        }
        for row in column + 1..size {
            let factor = entry(matrix, row, column) / pivot;
            for other in column + 1..size {
                let change = factor * entry(matrix, column, other);
                add(entry_mut(matrix, row, other), -change);
            }
            let change = factor * component(vector, column);
            add(component_mut(vector, row), -change);
        }
    }
    for column in (0..size).rev() {
        let solution = component(vector, column) / entry(matrix, column, column);
        put(component_mut(vector, column), solution);
        for row in 0..column {
            let change = entry(matrix, row, column) * solution;
            add(component_mut(vector, row), -change);
        }
    }
    Ok(())
}

#[inline]
fn put<T>(place: Option<&mut T>, value: T) {
    if let Some(place) = place {
        *place = value;
    }
}

#[inline]
fn add<T: Real>(place: Option<&mut T>, value: T) {
    if let Some(place) = place {
        *place += value;
    }
}

/// Whether the symmetric matrix of blocks is positive definite to working precision: all pivots of its elimination stay
/// above rounding. The elimination is left in its place.
pub(crate) fn are_positive_definite<T: Real, const N: usize, const S: usize>(
    matrix: &mut Blocks<T, N, S>,
) -> bool {
    let size = N * S;
    for column in 0..size {
        // The diagonal entry before elimination is the pivot plus what was taken from it.
        let (mut diagonal, pivot) = (entry(matrix, column, column).abs(), entry(matrix, column, column));
        for earlier in 0..column {
            let (factor, product) = (entry(matrix, column, earlier), entry(matrix, earlier, column));
            diagonal += (factor * product).abs();
        }
        if !(pivot.is_finite() && pivot > diagonal * T::EPSILON * T::of(4.0)) {
            return false;
        }
        for row in column + 1..size {
            let factor = entry(matrix, row, column) / pivot;
            put(entry_mut(matrix, row, column), factor);
            for other in column + 1..size {
                let change = factor * entry(matrix, column, other);
                add(entry_mut(matrix, row, other), -change);
            }
        }
    }
    true
}

/// [`are_positive_definite`] for a plain matrix.
pub(crate) fn is_positive_definite<T: Real, const N: usize>(matrix: &SMatrix<T, N, N>) -> bool {
    are_positive_definite(&mut [[*matrix]])
}

/// Inverse of a matrix.
///
/// # Errors
/// [`Singular`], as [`solve`].
pub(crate) fn invert<T: Real, const N: usize>(
    matrix: &SMatrix<T, N, N>,
) -> Result<SMatrix<T, N, N>, Singular> {
    let mut inverse = SMatrix::<T, N, N>::zeros();
    for column in 0..N {
        let mut unit = [SVector::<T, N>::zeros()];
        put(component_mut(&mut unit, column), T::one());
        solve(&mut [[*matrix]], &mut unit)?;
        inverse.set_column(column, &unit[0]);
    }
    Ok(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{matrix, vector};

    #[test]
    fn elimination_pivots_across_blocks() {
        // The leading block is zero, so the first pivot comes from the second block row.
        let mut blocks = [
            [SMatrix::<f64, 2, 2>::zeros(), matrix![1.0, 2.0; 3.0, 4.0]],
            [matrix![0.0, 5.0; 6.0, 0.0], matrix![1.0, 0.0; 0.0, 1.0]],
        ];
        let mut vector = [vector![5.0, 11.0], vector![11.0, 8.0]];
        solve(&mut blocks, &mut vector).unwrap();
        assert!((vector[0] - vector![1.0, 2.0]).norm() < 1e-14);
        assert!((vector[1] - vector![1.0, 2.0]).norm() < 1e-14);
    }

    #[test]
    fn singular_and_indefinite_matrices_are_told_apart() {
        let singular = matrix![1.0, 2.0; 2.0, 4.0];
        assert_eq!(invert(&singular), Err(Singular));
        assert!(!is_positive_definite(&singular));
        let indefinite = matrix![1.0, 2.0; 2.0, 1.0];
        assert!(invert(&indefinite).is_ok());
        assert!(!is_positive_definite(&indefinite));
        let definite = matrix![2.0, 1.0; 1.0, 2.0];
        assert!(is_positive_definite(&definite));
        assert!((definite * invert(&definite).unwrap() - SMatrix::identity()).norm() < 1e-15);
        assert!(!is_positive_definite(&matrix![f64::NAN]));
    }
}
