//! Matrices and vectors of N coordinates in place.

use nalgebra::{SMatrix, SVector};

use crate::error::MatrixError;
use crate::linear::{all_finite, at, is_positive_definite, zero_matrix, zero_vector};
use crate::real::{Real, max_or_nan};
use crate::space::{Block, Space};

/// Space of N coordinates, N known at compile time: vectors and matrices are stored in place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fixed<const N: usize>;

impl<T: Real, const N: usize> Space<T> for Fixed<N> {
    const KNOWN_SIZE: bool = true;

    type Vector = SVector<T, N>;
    type Block = Coefficients<T, N>;

    #[inline(always)]
    fn coordinates(&self) -> usize {
        N
    }

    #[inline(always)]
    fn zeros(&self) -> SVector<T, N> {
        zero_vector()
    }

    #[inline(always)]
    fn slice(vector: &SVector<T, N>) -> &[T] {
        vector.as_slice()
    }

    #[inline(always)]
    fn slice_mut(vector: &mut SVector<T, N>) -> &mut [T] {
        vector.as_mut_slice()
    }
}

/// Symmetric N×N matrix of coefficients; of a diagonal one only the diagonal is stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coefficients<T, const N: usize> {
    /// Diagonal entries.
    Diagonal(SVector<T, N>),
    /// All entries.
    Dense(SMatrix<T, N, N>),
}

impl<T: Real, const N: usize> Coefficients<T, N> {
    /// Product with a vector.
    #[inline(always)]
    pub fn multiply(&self, vector: &SVector<T, N>) -> SVector<T, N> {
        match self {
            Self::Diagonal(diagonal) => diagonal.component_mul(vector),
            Self::Dense(matrix) => matrix * vector,
        }
    }

    /// The matrix with all its entries.
    #[inline(always)]
    pub fn to_matrix(&self) -> SMatrix<T, N, N> {
        match self {
            Self::Diagonal(diagonal) => {
                let mut matrix = zero_matrix();
                for (index, (column, &entry)) in matrix.data.0.iter_mut().zip(diagonal.iter()).enumerate() {
                    if let Some(place) = column.get_mut(index) {
                        *place = entry;
                    }
                }
                matrix
            }
            Self::Dense(matrix) => *matrix,
        }
    }

    /// Checks that the entries are finite and the matrix symmetric to rounding.
    pub(crate) fn check_symmetric(&self) -> Result<(), MatrixError> {
        let matrix = self.to_matrix();
        if !all_finite(matrix.as_slice()) {
            return Err(MatrixError::NotFinite);
        }
        for row in 0..N {
            for column in 0..row {
                let entry = |row: usize, column: usize| at(matrix.as_slice(), column * N + row);
                let (lower, upper) = (entry(row, column), entry(column, row));
                if (lower - upper).abs() > T::of(4.0) * T::EPSILON * lower.abs().max(upper.abs()) {
                    return Err(MatrixError::NotSymmetric { row, column });
                }
            }
        }
        Ok(())
    }
}

impl<T: Real, const N: usize> Block<T> for Coefficients<T, N> {
    #[inline(always)]
    fn multiply_add(&self, factor: T, x: &[T], out: &mut [T]) {
        match self {
            Self::Diagonal(diagonal) => {
                for ((out, &entry), &x) in out.iter_mut().zip(diagonal.iter()).zip(x) {
                    *out += entry * x * factor;
                }
            }
            Self::Dense(matrix) => {
                for (row, out) in out.iter_mut().enumerate().take(N) {
                    let entries = matrix.data.0.iter().filter_map(|column| column.get(row));
                    let sum = entries.zip(x).fold(T::zero(), |sum, (&entry, &x)| sum + entry * x);
                    *out += sum * factor;
                }
            }
        }
    }

    #[inline(always)]
    fn add_to(&self, factor: T, target: &mut [T], width: usize, row: usize, column: usize) {
        let rows = target.chunks_exact_mut(width.max(1)).skip(row);
        match self {
            Self::Diagonal(diagonal) => {
                for (index, (numbers, &entry)) in rows.zip(diagonal.iter()).enumerate() {
                    if let Some(place) = numbers.get_mut(column + index) {
                        *place += entry * factor;
                    }
                }
            }
            Self::Dense(matrix) => {
                for (index, numbers) in rows.take(N).enumerate() {
                    let entries = matrix.data.0.iter().filter_map(|column| column.get(index));
                    for (place, &entry) in numbers.iter_mut().skip(column).zip(entries) {
                        *place += entry * factor;
                    }
                }
            }
        }
    }

    fn check_positive_semidefinite(&self) -> Result<(), MatrixError> {
        self.check_symmetric()?;
        let mut matrix = self.to_matrix();
        let columns = || matrix.data.0.iter().enumerate();
        let diagonal = columns().filter_map(|(index, column)| column.get(index).copied());
        let largest = diagonal.map(|entry| entry.abs()).fold(T::zero(), max_or_nan);
        let lift = largest * T::EPSILON * T::from_count(64 * N as u64);
        // An all-zero matrix is semidefinite. Any other semidefinite matrix becomes definite when its
        // diagonal is raised by the rounding error.
        let zero = matrix.iter().all(|entry| *entry == T::zero());
        for (index, column) in matrix.data.0.iter_mut().enumerate() {
            if let Some(entry) = column.get_mut(index) {
                *entry += lift;
            }
        }
        if zero || is_positive_definite(&matrix) { Ok(()) } else { Err(MatrixError::NotPositiveSemidefinite) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{matrix, vector};

    #[test]
    fn damping_may_act_on_some_directions_only() {
        let rank_one = Coefficients::Dense(matrix![1.0, -1.0; -1.0, 1.0]);
        assert_eq!(rank_one.check_positive_semidefinite(), Ok(()));
        assert_eq!(Coefficients::Diagonal(vector![0.0, 0.0]).check_positive_semidefinite(), Ok(()));
        let negative = Coefficients::Diagonal(vector![1.0, -1e-3]);
        assert_eq!(negative.check_positive_semidefinite(), Err(MatrixError::NotPositiveSemidefinite));
        let no_diagonal = Coefficients::Dense(matrix![0.0, 1.0; 1.0, 0.0]);
        assert_eq!(no_diagonal.check_positive_semidefinite(), Err(MatrixError::NotPositiveSemidefinite));
    }

    #[test]
    fn symmetry_and_definiteness_allow_for_rounding_and_no_more() {
        let off = |factor: f64| {
            let (a, b) = (1e-3, 1e-3 * (1.0 + factor * f64::EPSILON));
            Coefficients::Dense(matrix![1.0, a; b, 1.0]).check_symmetric()
        };
        assert_eq!(off(3.0), Ok(()));
        assert_eq!(off(6.0), Err(MatrixError::NotSymmetric { row: 1, column: 0 }));
        // Negative pivots as small as rounding count as zero; the tolerance is 64 u for each coordinate.
        let negative =
            |part: f64| Coefficients::Diagonal(vector![1.0, -part, 1.0, 1.0]).check_positive_semidefinite();
        assert_eq!(negative(100.0 * f64::EPSILON), Ok(()));
        assert_eq!(negative(240.0 * f64::EPSILON), Ok(()));
        assert_eq!(negative(270.0 * f64::EPSILON), Err(MatrixError::NotPositiveSemidefinite));
    }
}
