//! Elimination in a matrix whose entries lie near its diagonal.

use fvi_core::{Real, Singular};

/// Solves A x = `vector` for a matrix, row by row, whose entries farther than `band` from the diagonal are zero.
///
/// x replaces `vector`; of the matrix, only entries up to 2 `band` to the right of the diagonal and `band` to its left are looked at or
/// changed. Pivots and arithmetic are those of [`fvi_core::solve`], without the operations on zeros: the same bits in n·`band`² operations.
///
/// # Errors
/// [`Singular`], as [`fvi_core::solve`].
pub(super) fn solve<T: Real>(matrix: &mut [T], band: usize, vector: &mut [T]) -> Result<(), Singular> {
    let n = vector.len();
    for column in 0..n {
        let (last, end) = ((column + band).min(n - 1), (column + 2 * band + 1).min(n));
        let mut largest = T::zero();
        for row in column.saturating_sub(2 * band)..=last {
            largest = largest.max(matrix[row * n + column].abs());
        }
        let (mut pivot_row, mut pivot) = (column, T::zero());
        for row in column..=last {
            let candidate = matrix[row * n + column];
            if candidate.abs() > pivot.abs() {
                (pivot_row, pivot) = (row, candidate);
            }
        }
        if !pivot.is_finite() || pivot.abs() <= largest * T::EPSILON {
            return Err(Singular);
        }
        if pivot_row != column {
            let (above, below) = matrix.split_at_mut(pivot_row * n);
            above[column * n + column..column * n + end].swap_with_slice(&mut below[column..end]);
            vector.swap(column, pivot_row);
        }
        let (above, below) = matrix.split_at_mut((column + 1) * n);
        let upper = &above[column * n + column + 1..column * n + end];
        let known = vector[column];
        for (index, place) in vector[column + 1..=last].iter_mut().enumerate() {
            let row = &mut below[index * n + column..index * n + end];
            let Some((first, entries)) = row.split_first_mut() else { continue };
            let factor = *first / pivot;
            for (entry, &above) in entries.iter_mut().zip(upper) {
                *entry -= factor * above;
            }
            *place -= factor * known;
        }
    }
    for column in (0..n).rev() {
        let solution = vector[column] / matrix[column * n + column];
        vector[column] = solution;
        for row in column.saturating_sub(2 * band)..column {
            vector[row] -= matrix[row * n + column] * solution;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A banded matrix whose largest entries are beside the diagonal, so that rows must change places.
    fn banded(n: usize, band: usize) -> Vec<f64> {
        let entry = |row: usize, column: usize| match row.abs_diff(column) {
            0 => 0.1 * (row as f64 + 0.5).sin(),
            distance if distance <= band => 1.0 + (1.7 * (row * n + column) as f64).cos(),
            _ => 0.0,
        };
        (0..n * n).map(|index| entry(index / n, index % n)).collect()
    }

    #[test]
    fn a_band_is_solved_to_the_bits_of_the_whole_matrix() {
        for (n, band) in [(1, 0), (5, 0), (9, 1), (12, 3), (4, 3), (6, 9)] {
            let right: Vec<f64> = (0..n).map(|index| 1.0 - 0.3 * index as f64).collect();
            let (mut whole, mut near) = (banded(n, band), banded(n, band));
            let (mut expected, mut found) = (right.clone(), right);
            fvi_core::solve(&mut whole, &mut vec![0; n], &mut expected).unwrap();
            solve(&mut near, band, &mut found).unwrap();
            assert_eq!(found, expected, "{n} rows, band {band}");
        }
    }

    #[test]
    fn a_singular_band_is_refused() {
        let mut matrix = [1.0, 2.0, 0.0, 2.0, 4.0, 0.0, 0.0, 0.0, 1.0];
        assert_eq!(solve(&mut matrix, 1, &mut [1.0; 3]), Err(Singular));
    }
}
