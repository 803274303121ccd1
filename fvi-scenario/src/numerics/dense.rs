//! Decompositions of dense matrices of any size, compiled once: what the library has of them is generic and
//! large, and each crate that asks it would compile it again.

use nalgebra::{Complex, DMatrix, DVector, Dyn, SymmetricEigen};

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

/// The solution x of A x = b for complex numbers, A row by row, by elimination with exchange of rows; `None`
/// where a pivot is zero or a number not finite.
pub fn solve_complex(matrix: &mut [Complex<f64>], vector: &mut [Complex<f64>]) -> Option<()> {
    let rows = vector.len();
    for column in 0..rows {
        let size = |row: usize| matrix[row * rows + column].norm_sqr();
        let pivot_row = (column..rows).max_by(|&a, &b| size(a).total_cmp(&size(b)))?;
        let pivot = matrix[pivot_row * rows + column];
        if pivot == Complex::ZERO || !(pivot.re.is_finite() && pivot.im.is_finite()) {
            return None;
        }
        if pivot_row != column {
            vector.swap(pivot_row, column);
            for j in column..rows {
                matrix.swap(pivot_row * rows + j, column * rows + j);
            }
        }
        let (above, below) = matrix.split_at_mut((column + 1) * rows);
        let pivots = &above[column * rows + column + 1..];
        let (known, unknown) = vector.split_at_mut(column + 1);
        let inverse = pivot.inv();
        for (row, entry) in below.chunks_exact_mut(rows).zip(unknown) {
            let factor = row[column] * inverse;
            if factor != Complex::ZERO {
                row[column + 1..].iter_mut().zip(pivots).for_each(|(entry, pivot)| *entry -= factor * pivot);
                *entry -= factor * known[column];
            }
        }
    }
    for row in (0..rows).rev() {
        let behind: Complex<f64> = (row + 1..rows).map(|j| matrix[row * rows + j] * vector[j]).sum();
        vector[row] = (vector[row] - behind) / matrix[row * rows + row];
    }
    vector.iter().all(|x| x.re.is_finite() && x.im.is_finite()).then_some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn complex_equations_are_solved_where_the_first_pivot_is_zero() {
        let entry = Complex::new;
        // [0 2i; 3 1] x = [2i; 4]: x = (1, 1).
        let mut matrix = [entry(0.0, 0.0), entry(0.0, 2.0), entry(3.0, 0.0), entry(1.0, 0.0)];
        let mut vector = [entry(0.0, 2.0), entry(4.0, 0.0)];
        solve_complex(&mut matrix, &mut vector).unwrap();
        assert!(vector.iter().all(|x| (x - entry(1.0, 0.0)).norm() < 1e-15), "{vector:?}");
        assert_eq!(solve_complex(&mut [entry(0.0, 0.0); 4], &mut [entry(1.0, 0.0); 2]), None);
    }
}
