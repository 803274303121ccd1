//! Decompositions of dense matrices of any size, compiled once: those of the library are generic and large,
//! and would be compiled again in each crate that uses them.

use nalgebra::{Complex, DMatrix, DVector, Dyn, LU, Schur, SymmetricEigen};

/// Of a decomposition that has no bound of its own.
const MOST_ITERATIONS: usize = 100_000;

/// Eigenvalues and eigenvectors of a symmetric matrix; all of them NaN where an entry is not finite, or they
/// are not found.
pub fn symmetric_eigen(matrix: DMatrix<f64>) -> SymmetricEigen<f64, Dyn> {
    let size = matrix.nrows();
    let unknown = || SymmetricEigen {
        eigenvectors: DMatrix::from_element(size, size, f64::NAN),
        eigenvalues: DVector::from_element(size, f64::NAN),
    };
    if !matrix.iter().all(|entry| entry.is_finite()) {
        return unknown();
    }
    SymmetricEigen::try_new(matrix, f64::EPSILON, MOST_ITERATIONS).unwrap_or_else(unknown)
}

/// Eigenvalues of a symmetric matrix; all of them NaN where an entry is not finite.
pub fn symmetric_eigenvalues(matrix: DMatrix<f64>) -> DVector<f64> {
    if !matrix.iter().all(|entry| entry.is_finite()) {
        return DVector::from_element(matrix.nrows(), f64::NAN);
    }
    matrix.symmetric_eigenvalues()
}

/// Eigenvalues of a square matrix, conjugates together; `None` where they are not found.
pub fn eigenvalues(matrix: DMatrix<f64>) -> Option<Vec<Complex<f64>>> {
    if !matrix.iter().all(|entry| entry.is_finite()) {
        return None;
    }
    let schur = matrix.try_schur(f64::EPSILON, MOST_ITERATIONS)?;
    Some(schur.complex_eigenvalues().iter().copied().collect())
}

/// A = σ Q T Q* for a complex square matrix A.
#[derive(Clone, Debug)]
pub struct ComplexSchur {
    /// Q, unitary.
    pub unitary: DMatrix<Complex<f64>>,
    /// T, upper triangular.
    pub triangular: DMatrix<Complex<f64>>,
    /// σ, the largest modulus of an entry of A; 1 for A = 0.
    pub scale: f64,
}

/// The decomposition of a complex square matrix; `None` where an entry is not finite, or it is not found.
pub fn complex_schur(mut matrix: DMatrix<Complex<f64>>) -> Option<ComplexSchur> {
    let largest = matrix.camax();
    if !matrix.iter().all(|entry| entry.is_finite()) || !largest.is_finite() {
        return None;
    }
    // Squares beyond 1e±308 leave the range, and the iteration does not end with what is not a number.
    let scale = if largest > 0.0 { largest } else { 1.0 };
    matrix.apply(|entry| *entry = Complex::new(entry.re / scale, entry.im / scale));
    let (unitary, triangular) = Schur::try_new(matrix, f64::EPSILON, MOST_ITERATIONS)?.unpack();
    Some(ComplexSchur { unitary, triangular, scale })
}

/// The inverse of a square matrix by elimination with exchange of rows; `None` where a pivot is zero.
pub fn inverse(matrix: DMatrix<f64>) -> Option<DMatrix<f64>> {
    matrix.lu().try_inverse()
}

/// The factors of a square matrix, by elimination with exchange of rows.
#[derive(Clone, Debug)]
pub struct Factored(LU<f64, Dyn, Dyn>);

impl Factored {
    /// Factors a matrix; `None` where a pivot is zero or not finite.
    pub fn new(matrix: DMatrix<f64>) -> Option<Self> {
        let factors = matrix.lu();
        (factors.is_invertible() && factors.lu_internal().iter().all(|x| x.is_finite()))
            .then_some(Self(factors))
    }

    /// Replaces the columns by the solutions.
    pub fn solve(&self, columns: &mut DMatrix<f64>) {
        self.0.solve_mut(columns);
    }
}

/// A = U diag(σ) Vᵀ, the singular values in descending order.
#[derive(Clone, Debug)]
pub struct SingularValues {
    /// Columns of U, one for each value.
    pub u: DMatrix<f64>,
    /// σ.
    pub values: DVector<f64>,
    /// Rows of Vᵀ, one for each value.
    pub v_t: DMatrix<f64>,
}

impl SingularValues {
    /// The singular values of a matrix; `None` where an entry is not finite, or they are not found.
    pub fn of(matrix: DMatrix<f64>) -> Option<Self> {
        let (rows, columns) = matrix.shape();
        if rows.min(columns) == 0 {
            let (u, v_t) = (DMatrix::zeros(rows, 0), DMatrix::zeros(0, columns));
            return Some(Self { u, values: DVector::zeros(0), v_t });
        }
        if !matrix.iter().all(|entry| entry.is_finite()) {
            return None;
        }
        let parts = matrix.try_svd(true, true, 5.0 * f64::EPSILON, MOST_ITERATIONS)?;
        Some(Self { u: parts.u?, values: parts.singular_values, v_t: parts.v_t? })
    }
}

/// R and the first entries of Qᵀb with A = QR: |Ax + b|² is |Rx + Qᵀb|² plus a constant.
pub fn triangle(matrix: DMatrix<f64>, right: &DVector<f64>) -> (DMatrix<f64>, DVector<f64>) {
    let count = matrix.nrows().min(matrix.ncols());
    if count == 0 {
        return (DMatrix::zeros(0, matrix.ncols()), DVector::zeros(0));
    }
    let factors = matrix.qr();
    let mut rotated = right.clone();
    factors.q_tr_mul(&mut rotated);
    (factors.unpack_r(), rotated.rows(0, count).into_owned())
}

/// Singular values below this part of the largest are none.
const NOTHING: f64 = 1e-15;

/// x with the least |A x − b|, by singular values of the scaled columns; `None` where there are more columns
/// than rows, or a number is not finite.
pub fn least_squares(mut matrix: DMatrix<f64>, right: &DVector<f64>) -> Option<Vec<f64>> {
    if matrix.ncols() > matrix.nrows() {
        return None;
    }
    let sizes: Vec<f64> = matrix.column_iter_mut().map(|mut column| column.normalize_mut()).collect();
    let (triangle, right) = triangle(matrix, right);
    let SingularValues { u, values, v_t } = SingularValues::of(triangle)?;
    let mut turned = u.tr_mul(&right);
    for (number, value) in turned.iter_mut().zip(values.iter()) {
        *number = if *value > NOTHING * values[0] { *number / value } else { 0.0 };
    }
    let solution = v_t.tr_mul(&turned);
    Some(solution.iter().zip(sizes).map(|(number, size)| number / size).collect())
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
    fn a_triangle_stands_for_all_rows() {
        let matrix = DMatrix::from_row_slice(3, 2, &[1.0, 2.0, -3.0, 0.5, 2.0, 2.0]);
        let right = DVector::from_vec(vec![1.0, -2.0, 0.5]);
        let (r, c) = triangle(matrix.clone(), &right);
        let left_over = right.norm_squared() - c.norm_squared();
        for x in [[0.0, 0.0], [1.0, -2.0], [0.3, 4.0]] {
            let x = DVector::from_row_slice(&x);
            let whole = (&matrix * &x + &right).norm_squared();
            assert!((whole - (&r * &x + &c).norm_squared() - left_over).abs() < 1e-12 * whole, "{x:?}");
        }
        let parts = SingularValues::of(matrix.clone()).unwrap();
        let again = &parts.u * DMatrix::from_diagonal(&parts.values) * &parts.v_t;
        assert!((again - matrix).norm() < 1e-14 && parts.values[0] >= parts.values[1]);
    }

    #[test]
    fn what_is_not_finite_has_no_known_values() {
        for number in [f64::NAN, f64::INFINITY] {
            let matrix = DMatrix::from_row_slice(2, 2, &[1.0, number, number, 1.0]);
            assert!(SingularValues::of(matrix.clone()).is_none());
            assert!(symmetric_eigen(matrix.clone()).eigenvalues.iter().all(|value| value.is_nan()));
            assert!(symmetric_eigenvalues(matrix).iter().all(|value| value.is_nan()));
        }
    }

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
