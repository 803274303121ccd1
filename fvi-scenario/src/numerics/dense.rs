//! Decompositions of dense matrices of any size, compiled once: what the library has of them is generic and
//! large, and each crate that asks it would compile it again.

use nalgebra::{DMatrix, DVector, Dyn, SymmetricEigen};

/// Eigenvalues and eigenvectors of a symmetric matrix.
pub fn symmetric_eigen(matrix: DMatrix<f64>) -> SymmetricEigen<f64, Dyn> {
    matrix.symmetric_eigen()
}

/// Eigenvalues of a symmetric matrix.
pub fn symmetric_eigenvalues(matrix: DMatrix<f64>) -> DVector<f64> {
    matrix.symmetric_eigenvalues()
}

/// The inverse of a square matrix by elimination with exchange of rows; `None` where a pivot is zero.
pub fn inverse(matrix: DMatrix<f64>) -> Option<DMatrix<f64>> {
    matrix.lu().try_inverse()
}
