//! Equations of very different sizes, solved with their rows and columns brought to one size.

use fvi_core::{Real, Singular, max_or_nan, solve};

/// Logarithm to base 2 of the quotient of the largest to the smallest row from which on the rounding of one
/// hides the other.
const FAR: f64 = 50.0;

/// Sweeps over rows and columns; the logarithms of a full pattern are balanced after the first.
const SWEEPS: usize = 8;

/// Solves A x = `vector` if rows of A differ in size by so much that rounding of one hides another, so that
/// elimination cannot choose its pivots by the size of entries; otherwise returns `None` and changes nothing.
///
/// Rows and columns are multiplied by powers of two with which the logarithms of the entries are closest to
/// zero in the least squares \[CR72\], so that the rounding is that of pivots alone. Slopes of a right side
/// that are infinite at the start make such matrices in the first steps, and so do unknowns that begin like
/// powers of t far apart. Of these the solution has sizes far apart, too, and that scaling may let one hide
/// another. Where a row is not solved to its rounding, rows are scaled by |A||x| instead, with which pivots
/// chosen by size leave each of them a residual of its own rounding \[Skeel79\].
///
/// # Errors
/// [`Singular`], as [`fvi_core::solve`].
pub(super) fn solve_far_apart<T: Real>(
    matrix: &mut [T],
    pivots: &mut [usize],
    vector: &mut [T],
) -> Option<Result<(), Singular>> {
    let n = pivots.len();
    let (mut largest, mut smallest) = (T::zero(), None);
    for row in matrix.chunks_exact(n.max(1)) {
        let size = row.iter().fold(T::zero(), |size: T, entry| max_or_nan(size, entry.abs()));
        largest = max_or_nan(largest, size);
        smallest = Some(smallest.map_or(size, |smallest: T| smallest.min(size)));
    }
    let smallest = smallest?;
    // An entry that is not finite, or a row of zeros, is left to elimination.
    if !(largest.is_finite() && smallest > T::zero() && largest * T::of(0.5f64.powf(FAR)) > smallest) {
        return None;
    }
    Some(solve_scaled(matrix, pivots, vector))
}

/// Most solutions, each with rows scaled by the one before it.
const MOST_SOLUTIONS: usize = 4;

/// Bound of the backward error of a row per row of the matrix, in units of rounding, at which a solution is
/// taken.
const ROUNDING: f64 = 4.0;

#[cold]
#[inline(never)]
fn solve_scaled<T: Real>(matrix: &mut [T], pivots: &mut [usize], vector: &mut [T]) -> Result<(), Singular> {
    let n = pivots.len();
    let (given, right) = (matrix.to_vec(), vector.to_vec());
    let bound = ROUNDING * n as f64 * T::EPSILON.to_f64();
    let (mut rows, mut columns) = balanced(matrix, n);
    let mut least = None;
    for _ in 0..MOST_SOLUTIONS {
        matrix.copy_from_slice(&given);
        let mut found = right.clone();
        if solve_with((&rows, &columns), matrix, pivots, &mut found).is_err() {
            // Rows scaled by a solution that was bad may be anything.
            break;
        }
        let (error, sizes) = backward_error(&given, &right, &found);
        if error.is_nan() {
            break;
        }
        if least.is_none_or(|least| error < least) {
            least = Some(error);
            vector.copy_from_slice(&found);
        }
        if error <= bound {
            return Ok(());
        }
        let power = |size: f64, before: f64| if size.is_normal() { size.log2().round() } else { before };
        rows.iter_mut().zip(&sizes).for_each(|(row, &size)| *row = -power(size, -*row));
        columns.iter_mut().zip(&found).for_each(|(column, x)| *column = power(x.to_f64().abs(), *column));
    }
    // Entries at the end of the range of numbers, which change nothing, count in the scaling like others.
    matrix.copy_from_slice(&given);
    let mut found = right.clone();
    let plain = solve(matrix, pivots, &mut found);
    if plain.is_ok() {
        let (error, _) = backward_error(&given, &right, &found);
        if least.is_none_or(|least| error < least) {
            vector.copy_from_slice(&found);
        }
    }
    if least.is_some() { Ok(()) } else { plain }
}

/// Solves A x = `vector` with rows and columns multiplied by these powers of two.
fn solve_with<T: Real>(
    (rows, columns): (&[f64], &[f64]),
    matrix: &mut [T],
    pivots: &mut [usize],
    vector: &mut [T],
) -> Result<(), Singular> {
    let power = |exponent: f64| T::of(exponent.exp2());
    for ((row, number), &by) in matrix.chunks_exact_mut(rows.len()).zip(&mut *vector).zip(rows) {
        // The product of both may be in range where one is not, and out of range where there is no entry.
        let entries = row.iter_mut().zip(columns).filter(|(entry, _)| **entry != T::zero());
        entries.for_each(|(entry, column)| *entry *= power(by + column));
        *number *= power(by);
    }
    solve(matrix, pivots, vector)?;
    vector.iter_mut().zip(columns).for_each(|(number, &column)| *number *= power(column));
    Ok(())
}

/// max_i |A x − b|_i/(|A||x| + |b|)_i, and (|A||x|)_i.
fn backward_error<T: Real>(matrix: &[T], right: &[T], solution: &[T]) -> (f64, Vec<f64>) {
    let mut error = 0.0;
    let rows = matrix.chunks_exact(solution.len()).zip(right);
    let sizes = rows.map(|(row, right)| {
        let right = right.to_f64();
        let products = || row.iter().zip(solution).map(|(a, x)| a.to_f64() * x.to_f64());
        let size = products().map(f64::abs).sum::<f64>();
        let residual = (products().sum::<f64>() - right).abs();
        if residual > 0.0 {
            error = max_or_nan(error, residual / (size + right.abs()));
        }
        size
    });
    let sizes = sizes.collect();
    (error, sizes)
}

/// Whole numbers r, c that make Σ (log₂|a_ij| + r_i + c_j)² over the entries that are not zero small.
fn balanced<T: Real>(matrix: &[T], n: usize) -> (Vec<f64>, Vec<f64>) {
    let logarithms: Vec<f64> = matrix.iter().map(|entry| entry.to_f64().abs().log2()).collect();
    let (mut rows, mut columns) = (vec![0.0; n], vec![0.0; n]);
    let mean = |of: &mut dyn Iterator<Item = f64>| {
        let (count, sum) = of.filter(|x| x.is_finite()).fold((0.0, 0.0), |(k, sum), x| (k + 1.0, sum + x));
        if count > 0.0 { sum / count } else { 0.0 }
    };
    for _ in 0..SWEEPS {
        for (i, row) in rows.iter_mut().enumerate() {
            *row = -mean(&mut (0..n).map(|j| logarithms[i * n + j] + columns[j]));
        }
        for (j, column) in columns.iter_mut().enumerate() {
            *column = -mean(&mut (0..n).map(|i| logarithms[i * n + j] + rows[i]));
        }
    }
    rows.iter_mut().chain(&mut columns).for_each(|power| *power = power.round());
    (rows, columns)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows times 2^r and columns times 2^c of a matrix whose solution is known.
    fn scaled(rows: [i32; 4], columns: [i32; 4]) -> ([f64; 16], [f64; 4], [f64; 4]) {
        let entry = |i: usize, j: usize| (1.7 * ((4 * i + j) * (4 * i + j)) as f64).cos();
        let power = |exponent: i32| 2.0f64.powi(exponent);
        let matrix = core::array::from_fn(|at| entry(at / 4, at % 4) * power(rows[at / 4] + columns[at % 4]));
        let vector = core::array::from_fn(|i| {
            (0..4).map(|j| entry(i, j) * (j + 1) as f64).sum::<f64>() * power(rows[i])
        });
        (matrix, vector, core::array::from_fn(|j| (j + 1) as f64 * power(-columns[j])))
    }

    #[test]
    fn rows_and_columns_of_any_sizes_are_solved_to_rounding() {
        for (rows, columns) in [
            ([0, 200, -100, 30], [0, 0, 0, 0]),
            ([150, 0, -150, 0], [-200, 100, 0, 300]),
            ([-60, 0, 0, 0], [0, -40, 250, 40]),
        ] {
            let (mut matrix, mut vector, expected) = scaled(rows, columns);
            let solved = solve_far_apart(&mut matrix, &mut [0; 4], &mut vector);
            assert_eq!(solved, Some(Ok(())), "{rows:?} {columns:?}");
            for (found, expected) in vector.iter().zip(expected) {
                assert!((found / expected - 1.0).abs() < 1e-13, "{rows:?} {columns:?}: {found} {expected}");
            }
        }
    }

    #[test]
    fn unknowns_of_sizes_far_apart_do_not_hide_each_other() {
        // The step of x0 = O(1e-27), x1 = O(1e-9) that D^0.9 x0 = 1 − x0 x1, D^0.3 x1 = 1 − x1 begin with, at
        // two stages: x1 hardly acts on x0, and x0 not at all on x1.
        let (stages, far) = ([[2.0, 1.0], [-3.0, 5.0]], [1e-33, 1e-51, 1e-87]);
        let mut matrix = [0.0; 16];
        for (i, row) in stages.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                matrix[8 * i + 2 * j] = entry * far[0];
                matrix[8 * i + 2 * j + 1] = entry * far[2];
                matrix[8 * i + 4 + 2 * j + 1] = entry * far[1];
            }
        }
        let mut vector = [3.0 + 3e-36, 3.0, 2.0 + 2e-36, 2.0];
        assert_eq!(solve_far_apart(&mut matrix, &mut [0; 4], &mut vector), Some(Ok(())));
        for (found, size) in vector.iter().zip([1e33, 1e51, 1e33, 1e51f64]) {
            assert!((found / size - 1.0).abs() < 1e-14, "{vector:?}");
        }
    }

    #[test]
    fn places_without_an_entry_stay_empty_whatever_the_scaling() {
        // x0, and x1' = x2, x2' = x3 in a step of 1e-107: some products of two powers are beyond all numbers.
        let h: f64 = 1e-107;
        let rows =
            [[h.powf(1.9), 0.0, 0.0, 0.0], [0.0, h, -h * h, 0.0], [0.0, 0.0, h, -h * h], [0.0, 0.0, 0.0, h]];
        let (mut matrix, mut vector) = (rows.concat(), [h.powf(1.9), h - h * h, h - h * h, h]);
        assert_eq!(solve_far_apart(&mut matrix, &mut [0; 4], &mut vector), Some(Ok(())));
        for found in vector {
            assert!((found - 1.0).abs() < 1e-14, "{vector:?}");
        }
    }

    #[test]
    fn matrices_as_usual_are_left_as_they_are() {
        let (mut matrix, mut vector, _) = scaled([0, 20, -20, 0], [0, 300, 0, -300]);
        let before = (matrix, vector);
        let usual = scaled([0, 20, -20, 0], [0, 0, 0, 0]).0;
        assert_eq!(solve_far_apart(&mut usual.clone(), &mut [0; 4], &mut vector), None);
        matrix[5] = f64::INFINITY;
        assert_eq!(solve_far_apart(&mut matrix, &mut [0; 4], &mut vector), None);
        assert_eq!(vector, before.1);
        // A row of zeros has no size.
        assert_eq!(solve_far_apart(&mut [1e99, 1.0, 0.0, 0.0], &mut [0; 2], &mut [1.0; 2]), None);
        let no_number = solve_far_apart(&mut [1e99, f64::NAN, 1.0, 2.0], &mut [0; 2], &mut [1.0; 2]);
        assert_eq!(no_number, None);
    }

    #[test]
    fn rows_that_are_multiples_are_singular_at_any_size() {
        let row = [0.1, 0.3, 0.7];
        let matrix = [row, row.map(|x| 1e60 * x), [0.5, -0.25, 1.0]];
        let mut matrix = matrix.concat();
        assert_eq!(solve_far_apart(&mut matrix, &mut [0; 3], &mut [1.0; 3]), Some(Err(Singular)));
    }
}
