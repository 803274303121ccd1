//! Elimination in a banded matrix.

use fvi_core::{Real, Singular, add_multiple};

/// Solves A x = `vector` for a matrix, row by row, whose entries farther than `band` from the diagonal are
/// zero.
///
/// x replaces `vector`; of the matrix, only entries up to 2 `band` to the right of the diagonal and `band` to
/// its left are looked at or changed. Pivots and arithmetic are those of
/// [`fvi_core::solve`], without the operations on zeros: the same bits in n·`band`² operations.
///
/// # Errors
/// [`Singular`], as [`fvi_core::solve`].
pub(super) fn solve<T: Real>(
    matrix: &mut [T],
    band: usize,
    pivots: &mut [usize],
    vector: &mut [T],
) -> Result<(), Singular> {
    match band {
        1 => solve_narrow::<T, 2, 3>(matrix, vector),
        2 => solve_narrow::<T, 3, 5>(matrix, vector),
        3 => solve_narrow::<T, 4, 7>(matrix, vector),
        band => solve_wide(matrix, band, pivots, vector),
    }
}

/// [`solve`] for a band that the compiler knows: the `ROWS` = band + 1 rows that the elimination of a column
/// changes are held in a window of `WIDTH` = 2 band + 1 numbers each, which moves down the diagonal.
fn solve_narrow<T: Real, const ROWS: usize, const WIDTH: usize>(
    matrix: &mut [T],
    vector: &mut [T],
) -> Result<(), Singular> {
    let n = vector.len();
    let mut window: [([T; WIDTH], T); ROWS] =
        core::array::from_fn(|row| (row_from(matrix, n, row, 0), at(vector, row)));
    for column in 0..n {
        let mut largest = T::zero();
        for row in column.saturating_sub(WIDTH - 1)..column {
            largest = largest.max(matrix[row * n + column].abs());
        }
        let (mut pivot_row, mut pivot) = (0, T::zero());
        for (row, (entries, _)) in window.iter().enumerate() {
            largest = largest.max(entries[0].abs());
            if entries[0].abs() > pivot.abs() {
                (pivot_row, pivot) = (row, entries[0]);
            }
        }
        if !pivot.is_finite() || pivot.abs() <= largest * T::EPSILON {
            return Err(Singular);
        }
        window.swap(0, pivot_row);
        let (upper, known) = window[0];
        matrix[column * n + column..(column + 1) * n]
            .iter_mut()
            .zip(upper)
            .for_each(|(place, entry)| *place = entry);
        vector[column] = known;
        // The rows below, without their first entry, move up.
        for row in 1..ROWS {
            let (entries, number) = window[row];
            let factor = entries[0] / pivot;
            let mut moved = [T::zero(); WIDTH];
            for index in 1..WIDTH {
                moved[index - 1] = entries[index] - factor * upper[index];
            }
            window[row - 1] = (moved, number - factor * known);
        }
        window[ROWS - 1] = (row_from(matrix, n, column + ROWS, column + 1), at(vector, column + ROWS));
    }
    substitute_upper(matrix, ROWS - 1, vector);
    Ok(())
}

/// The numbers of a row from a column on, zeros beyond the matrix.
fn row_from<T: Real, const WIDTH: usize>(matrix: &[T], n: usize, row: usize, column: usize) -> [T; WIDTH] {
    let mut numbers = [T::zero(); WIDTH];
    if row < n {
        let entries = &matrix[row * n + column..(row + 1) * n];
        numbers.iter_mut().zip(entries).for_each(|(number, &entry)| *number = entry);
    }
    numbers
}

fn solve_wide<T: Real>(
    matrix: &mut [T],
    band: usize,
    pivots: &mut [usize],
    vector: &mut [T],
) -> Result<(), Singular> {
    factor(matrix, band, pivots)?;
    let n = pivots.len();
    for (column, &pivot_row) in pivots.iter().enumerate() {
        vector.swap(column, pivot_row);
        let known = vector[column];
        for row in column + 1..(column + band + 1).min(n) {
            vector[row] -= matrix[row * n + column] * known;
        }
    }
    substitute_upper(matrix, band, vector);
    Ok(())
}

/// Solves U x = `vector` for the rows on and right of the diagonal that elimination has left.
#[inline(always)]
fn substitute_upper<T: Real>(matrix: &[T], band: usize, vector: &mut [T]) {
    let n = vector.len();
    for row in (0..n).rev() {
        let (known, solved) = vector.split_at_mut(row + 1);
        let entries = &matrix[row * n + row..row * n + (row + 2 * band + 1).min(n)];
        let mut number = known[row];
        for (&entry, &x) in entries[1..].iter().zip(&*solved).rev() {
            number -= entry * x;
        }
        known[row] = number / entries[0];
    }
}

/// Factors in place, by elimination with row pivoting within the band. The multipliers of a column stay below
/// its pivot, in the rows of the time of its elimination; `pivots` gets the row that each column's pivot came
/// from.
fn factor<T: Real>(matrix: &mut [T], band: usize, pivots: &mut [usize]) -> Result<(), Singular> {
    let n = pivots.len();
    for (column, place) in pivots.iter_mut().enumerate() {
        let (last, end) = ((column + band).min(n - 1), (column + 2 * band + 1).min(n));
        let (pivot_row, pivot) = pivot(matrix, n, band, column)?;
        *place = pivot_row;
        let (above, below) = matrix.split_at_mut((column + 1) * n);
        let upper = &mut above[column * n + column..column * n + end];
        if let Some(row) = (pivot_row - column).checked_sub(1) {
            upper.swap_with_slice(&mut below[row * n + column..row * n + end]);
        }
        for row in below.chunks_exact_mut(n).take(last - column) {
            let Some((multiplier, entries)) = row[column..end].split_first_mut() else { continue };
            *multiplier /= pivot;
            for (entry, &above) in entries.iter_mut().zip(&upper[1..]) {
                *entry -= *multiplier * above;
            }
        }
    }
    Ok(())
}

/// The factors of a banded matrix, for many right-hand sides.
#[derive(Clone, Debug, Default)]
pub struct BandFactors<T> {
    band: usize,
    /// Number of entries of a row to the right of the diagonal.
    upper: usize,
    /// For each column: the pivot's reciprocal, the `band` multipliers of the rows below, the `upper` entries
    /// to the right of the pivot.
    columns: Vec<T>,
    /// Number of rows below the diagonal from which each pivot came; empty if all were on it.
    lifts: Vec<usize>,
}

impl<T: Real> BandFactors<T> {
    /// Factors as [`solve`] does and copies the data for solutions with other right-hand sides.
    ///
    /// # Errors
    /// [`Singular`], as [`fvi_core::solve`].
    pub(super) fn of(matrix: &mut [T], band: usize, pivots: &mut [usize]) -> Result<Self, Singular> {
        factor(matrix, band, pivots)?;
        let n = pivots.len();
        let mut lifts: Vec<usize> = pivots.iter().enumerate().map(|(column, &row)| row - column).collect();
        if lifts.iter().all(|&lift| lift == 0) {
            lifts.clear();
        }
        let upper = if lifts.is_empty() { band } else { 2 * band };
        let mut columns = Vec::with_capacity(n * (1 + band + upper));
        for column in 0..n {
            columns.push(T::one() / matrix[column * n + column]);
            columns.extend((column + 1..=column + band).map(|row| at(matrix, row * n + column)));
            let row = &matrix[column * n + column..(column + 1) * n];
            columns.extend((1..=upper).map(|index| at(row, index)));
        }
        Ok(Self { band, upper, columns, lifts })
    }

    /// Replaces `vector` by the solution: the bits of [`fvi_core::substitute_kept`] without its operations on
    /// zeros.
    pub(super) fn solve(&self, vector: &mut [T]) {
        let stride = 1 + self.band + self.upper;
        for (row, column) in self.columns.chunks_exact(stride).enumerate() {
            if let Some(&lift) = self.lifts.get(row) {
                vector.swap(row, row + lift);
            }
            let (known, later) = vector.split_at_mut(row + 1);
            add_multiple(later, -known[row], &column[1..=self.band]);
        }
        for (row, column) in self.columns.chunks_exact(stride).enumerate().rev() {
            let (known, solved) = vector.split_at_mut(row + 1);
            let mut number = known[row];
            for (&x, &entry) in solved.iter().zip(&column[1 + self.band..]).rev() {
                number += entry * -x;
            }
            known[row] = number * column[0];
        }
    }
}

/// A number of a slice; zero beyond it.
fn at<T: Real>(numbers: &[T], index: usize) -> T {
    numbers.get(index).copied().unwrap_or(T::zero())
}

/// The row from which a column's pivot comes, and the pivot.
fn pivot<T: Real>(matrix: &[T], n: usize, band: usize, column: usize) -> Result<(usize, T), Singular> {
    let last = (column + band).min(n - 1);
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
    Ok((pivot_row, pivot))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A banded matrix whose largest entries are off the diagonal, so that rows must be exchanged.
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
        for (n, band) in [(1, 0), (5, 0), (9, 1), (1, 1), (11, 2), (12, 3), (4, 3), (2, 3), (14, 4), (6, 9)] {
            // Rows are exchanged from the first one on, from some row on, and not at all.
            for heavy in [0, n / 2, n] {
                let mut matrix = banded(n, band);
                (0..heavy).for_each(|index| matrix[index * n + index] += 20.0);
                let right: Vec<f64> = (0..n).map(|index| 1.0 - 0.3 * index as f64).collect();
                let (mut whole, mut near) = (matrix.clone(), matrix);
                let (mut expected, mut found) = (right.clone(), right);
                fvi_core::solve(&mut whole, &mut vec![0; n], &mut expected).unwrap();
                solve(&mut near, band, &mut vec![0; n], &mut found).unwrap();
                assert_eq!(found, expected, "{n} rows, band {band}, {heavy} with heavy diagonals");
            }
        }
    }

    #[test]
    fn nothing_away_from_the_diagonal_is_looked_at() {
        for (n, band) in [(40, 1), (40, 2), (40, 3), (40, 5)] {
            let (mut whole, mut near) = (banded(n, band), banded(n, band));
            for (index, entry) in near.iter_mut().enumerate() {
                let (row, column) = (index / n, index % n);
                if column + band < row || row + 2 * band < column {
                    *entry = f64::NAN;
                }
            }
            let (mut expected, mut found) = (vec![1.0; n], vec![1.0; n]);
            solve(&mut whole, band, &mut vec![0; n], &mut expected).unwrap();
            solve(&mut near, band, &mut vec![0; n], &mut found).unwrap();
            assert_eq!(found, expected, "band {band}");
        }
    }

    #[test]
    fn kept_factors_of_a_band_have_the_bits_of_those_of_the_whole_matrix() {
        for (n, band) in [(9, 1), (11, 2), (12, 3), (14, 4), (6, 9), (5, 0)] {
            // With and without exchange of rows.
            for lift in [0.0, 20.0] {
                let mut matrix = banded(n, band);
                (0..n).for_each(|index| matrix[index * n + index] += lift);
                let right: Vec<f64> = (0..n).map(|index| 1.0 - 0.3 * index as f64).collect();
                let (mut whole, mut pivots, mut kept) = (matrix.clone(), vec![0; n], vec![0.0; n * n]);
                fvi_core::keep_factors(&mut whole, &mut pivots, &mut kept).unwrap();
                let (mut expected, mut found) = (right.clone(), right);
                fvi_core::substitute_kept(&kept, &pivots, &mut expected);
                let factors = BandFactors::of(&mut matrix, band, &mut vec![0; n]).unwrap();
                factors.solve(&mut found);
                assert_eq!(found, expected, "{n} rows, band {band}, lift {lift}");
                assert_eq!(factors.lifts.is_empty(), lift != 0.0 || band == 0);
            }
        }
    }

    #[test]
    fn a_singular_band_is_refused() {
        let mut matrix = [1.0, 2.0, 0.0, 2.0, 4.0, 0.0, 0.0, 0.0, 1.0];
        assert_eq!(solve(&mut matrix.clone(), 1, &mut [0; 3], &mut [1.0; 3]), Err(Singular));
        assert!(BandFactors::of(&mut matrix, 1, &mut [0; 3]).is_err());
    }
}
