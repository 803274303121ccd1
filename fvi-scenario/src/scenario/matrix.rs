//! Symmetric matrices of a scenario, given as diagonal entries, rows or files.

use super::sparse_matrix::{Matrices, SparseMatrix, wrong_size};
use crate::language::document::Value;
use crate::language::error::{InputError, Problem};
use fvi_core::min_or_nan;
use fvi_fft::dense::symmetric_eigenvalues;
use nalgebra::DMatrix;
use serde::{Serialize, Serializer};

/// A symmetric matrix, one row and column for each coordinate.
#[derive(Clone, Debug, PartialEq)]
pub enum SymmetricMatrix {
    /// The diagonal entries; all others are zero.
    Diagonal(Vec<f64>),
    /// All entries.
    Dense(DMatrix<f64>),
    /// The structurally nonzero entries.
    Sparse(SparseMatrix),
}

impl SymmetricMatrix {
    /// Number of rows.
    pub fn size(&self) -> usize {
        match self {
            Self::Diagonal(entries) => entries.len(),
            Self::Dense(matrix) => matrix.nrows(),
            Self::Sparse(matrix) => matrix.size(),
        }
    }

    /// The diagonal entries.
    pub fn diagonal(&self) -> Vec<f64> {
        match self {
            Self::Diagonal(entries) => entries.clone(),
            Self::Dense(matrix) => matrix.diagonal().iter().copied().collect(),
            Self::Sparse(matrix) => {
                let entry = |row: usize, slot: usize| {
                    (matrix.pattern.columns()[slot] as usize == row).then(|| matrix.values[slot])
                };
                let rows = matrix.pattern.rows().enumerate();
                rows.map(|(row, slots)| slots.into_iter().find_map(|slot| entry(row, slot)).unwrap_or(0.0))
                    .collect()
            }
        }
    }

    /// The product with a vector of the same size.
    pub fn times(&self, vector: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; self.size()];
        self.write_times(vector, &mut product);
        product
    }

    /// Writes the product with a vector of the same size to `product`.
    pub fn write_times(&self, vector: &[f64], product: &mut [f64]) {
        match self {
            Self::Diagonal(entries) => {
                for ((place, entry), x) in product.iter_mut().zip(entries).zip(vector) {
                    *place = entry * x;
                }
            }
            Self::Dense(matrix) => {
                for (place, row) in product.iter_mut().zip(matrix.row_iter()) {
                    *place = row.iter().zip(vector).map(|(entry, x)| entry * x).sum();
                }
            }
            Self::Sparse(matrix) => matrix.write_times(vector, product),
        }
    }

    /// True if every entry is zero.
    pub fn is_zero(&self) -> bool {
        match self {
            Self::Diagonal(entries) => entries.iter().all(|&entry| entry == 0.0),
            Self::Dense(matrix) => matrix.iter().all(|&entry| entry == 0.0),
            Self::Sparse(matrix) => matrix.values.iter().all(|&entry| entry == 0.0),
        }
    }

    /// The rows, from 0, in which every entry is zero: for a mass matrix the coordinates without mass.
    pub fn zero_rows(&self) -> Vec<usize> {
        let rows = 0..self.size();
        match self {
            Self::Diagonal(entries) => rows.filter(|&row| entries[row] == 0.0).collect(),
            Self::Dense(matrix) => {
                rows.filter(|&row| matrix.row(row).iter().all(|&entry| entry == 0.0)).collect()
            }
            Self::Sparse(matrix) => matrix.zero_rows(),
        }
    }

    /// The same matrix times a number.
    pub(super) fn scaled(self, scale: f64) -> Self {
        match self {
            Self::Diagonal(entries) => {
                Self::Diagonal(entries.into_iter().map(|entry| entry * scale).collect())
            }
            Self::Dense(matrix) => Self::Dense(matrix * scale),
            Self::Sparse(matrix) => Self::Sparse(matrix.scaled(scale)),
        }
    }

    /// Reads numbers (a diagonal), rows of numbers, or the name of a file, for the given number of
    /// coordinates; without it the matrix is the mass matrix, which determines that number. Files that have
    /// been read before are taken from `known`.
    pub(super) fn read(
        value: &Value<'_>,
        coordinates: Option<usize>,
        known: &mut Matrices<'_>,
    ) -> Result<Self, InputError> {
        if value.is_text() {
            return known.read(value, coordinates).map(Self::Sparse);
        }
        let matrix = Self::read_rows(value)?;
        match coordinates {
            Some(count) if count != matrix.size() => Err(wrong_size(matrix.size(), count, value)),
            _ => Ok(matrix),
        }
    }

    fn read_rows(value: &Value<'_>) -> Result<Self, InputError> {
        let entries = value.list("a list of numbers (the diagonal) or of rows")?;
        if !entries.iter().any(Value::is_list) {
            return Ok(Self::Diagonal(value.numbers()?));
        }
        let size = entries.len();
        let mut matrix = DMatrix::zeros(size, size);
        for (row, entry) in entries.iter().enumerate() {
            let numbers = entry.numbers()?;
            if numbers.len() != size {
                let expected = format!("{size}: a square matrix has as many columns as rows");
                let found = format!("{} entries", numbers.len());
                return Err(entry.error(Problem::WrongShape { expected, found }));
            }
            for (column, number) in numbers.into_iter().enumerate() {
                matrix[(row, column)] = number;
            }
        }
        for row in 0..size {
            for column in row + 1..size {
                let (upper, lower) = (matrix[(row, column)], matrix[(column, row)]);
                if upper != lower {
                    return Err(value.error(Problem::NotSymmetric { row, column, upper, lower }));
                }
            }
        }
        Ok(Self::Dense(matrix))
    }

    /// Refuses a matrix that has, beside rows and columns of zeros, an eigenvalue ≤ 0 (to rounding), or one
    /// so small that the inverse is not finite.
    pub(super) fn mass(self, value: &Value<'_>, known: &Matrices<'_>) -> Result<Self, InputError> {
        if let Self::Sparse(matrix) = self {
            return known.positive_definite(matrix, value).map(Self::Sparse);
        }
        let massive = match self.zero_rows().as_slice() {
            [] => self.clone(),
            massless if massless.len() == self.size() => return Ok(self),
            massless => self.clone().without(massless),
        };
        let is_positive =
            |(smallest, threshold): (f64, f64)| smallest > threshold && smallest.recip().is_finite();
        let spectrum = massive.spectrum();
        // Whatever the units of the coordinates are.
        if is_positive(spectrum)
            || massive.with_unit_diagonal().is_some_and(|scaled| is_positive(scaled.spectrum()))
        {
            Ok(self)
        } else {
            Err(value.error(Problem::NotPositiveDefinite { smallest: spectrum.0 }))
        }
    }

    /// A full matrix with the diagonal 1, m_ij/√(m_ii m_jj), which is definite together with this one; `None`
    /// where its diagonal is not positive.
    fn with_unit_diagonal(&self) -> Option<Self> {
        let Self::Dense(matrix) = self else { return None };
        let sizes: Vec<f64> = matrix.diagonal().iter().map(|entry| libm::sqrt(*entry)).collect();
        let is_positive = sizes.iter().all(|size| *size > 0.0 && size.is_finite());
        let of = |row: usize, column: usize| matrix[(row, column)] / sizes[row] / sizes[column];
        is_positive.then(|| Self::Dense(DMatrix::from_fn(sizes.len(), sizes.len(), of)))
    }

    /// A mass with another one added, which is positive definite together with it.
    pub(super) fn plus(
        self,
        added: &DMatrix<f64>,
        value: &Value<'_>,
        known: &Matrices<'_>,
    ) -> Result<Self, InputError> {
        let sum = match self {
            Self::Diagonal(entries) => DMatrix::from_diagonal(&entries.into()) + added,
            Self::Dense(matrix) => matrix + added,
            Self::Sparse(_) => {
                return Err(value.error(Problem::Incompatible {
                    with: "an added mass A(∞) of a kernel".to_owned(),
                    allowed: "a mass in numbers; or `added_to_mass = false` there".to_owned(),
                }));
            }
        };
        let is_diagonal = (0..sum.nrows()).all(|i| (0..i).all(|j| sum[(i, j)] == 0.0 && sum[(j, i)] == 0.0));
        let sum = match is_diagonal {
            true => Self::Diagonal(sum.diagonal().iter().copied().collect()),
            false => Self::Dense(sum),
        };
        sum.mass(value, known)
    }

    /// True if both have the same entries, to rounding of the largest.
    pub(super) fn is_close_to(&self, other: &Self) -> bool {
        let (Self::Dense(one), Self::Dense(other)) = (self, other) else { return false };
        one.shape() == other.shape() && (one - other).amax() <= 1e-12 * other.amax()
    }

    /// Refuses a matrix with an eigenvalue < 0 (beyond rounding).
    pub(super) fn positive_semidefinite(
        self,
        value: &Value<'_>,
        known: &Matrices<'_>,
    ) -> Result<Self, InputError> {
        if let Self::Sparse(matrix) = self {
            return known.positive_semidefinite(matrix, value).map(Self::Sparse);
        }
        let (smallest, threshold) = self.spectrum();
        if smallest >= -threshold {
            Ok(self)
        } else {
            Err(value.error(Problem::NotPositiveSemidefinite { smallest }))
        }
    }

    /// The matrix without these rows and columns, given in ascending order.
    fn without(self, rows: &[usize]) -> Self {
        match self {
            Self::Diagonal(entries) => {
                let left =
                    entries.into_iter().enumerate().filter(|(row, _)| rows.binary_search(row).is_err());
                Self::Diagonal(left.map(|(_, entry)| entry).collect())
            }
            Self::Dense(matrix) => Self::Dense(matrix.remove_rows_at(rows).remove_columns_at(rows)),
            Self::Sparse(_) => self,
        }
    }

    /// The smallest eigenvalue, and a bound of its rounding error.
    fn spectrum(&self) -> (f64, f64) {
        match self {
            Self::Diagonal(entries) => (entries.iter().copied().fold(f64::INFINITY, min_or_nan), 0.0),
            Self::Dense(matrix) => {
                let eigenvalues = symmetric_eigenvalues(matrix.clone());
                (eigenvalues.min(), 8.0 * f64::EPSILON * matrix.nrows() as f64 * eigenvalues.amax())
            }
            // Definiteness is checked by factorisation instead.
            Self::Sparse(_) => (f64::NAN, f64::NAN),
        }
    }
}

impl Serialize for SymmetricMatrix {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Diagonal(entries) => entries.serialize(serializer),
            Self::Sparse(matrix) => matrix.serialize(serializer),
            Self::Dense(matrix) => {
                let rows: Vec<Vec<f64>> =
                    matrix.row_iter().map(|row| row.iter().copied().collect()).collect();
                rows.serialize(serializer)
            }
        }
    }
}
