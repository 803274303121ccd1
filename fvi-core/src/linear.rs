//! Small dense linear algebra: elimination with pivots, and properties of symmetric matrices.
//!
//! Matrices of n×n numbers lie row by row in a slice.

use core::array::from_fn;

use nalgebra::{SMatrix, SVector};

use crate::real::Real;

/// Numbers processed at a time. A loop over slices whose length is known at run time only also checks that
/// they do not overlap, and has loops for the remainder: for small vectors that costs more than the
/// arithmetic.
const LANES: usize = 8;

/// True if to process several numbers at a time: microcontrollers have no vector registers for them.
const IN_ROWS: bool = cfg!(target_pointer_width = "64");

/// The first `len` numbers as rows of [`LANES`], and the remainder.
#[inline(always)]
fn rows<T>(numbers: &[T], len: usize) -> (&[[T; LANES]], &[T]) {
    let numbers = numbers.get(..len).unwrap_or_default();
    if IN_ROWS { numbers.as_chunks() } else { (&[], numbers) }
}

/// As [`rows`], to change them.
#[inline(always)]
fn rows_mut<T>(numbers: &mut [T], len: usize) -> (&mut [[T; LANES]], &mut [T]) {
    let numbers = numbers.get_mut(..len).unwrap_or_default();
    if IN_ROWS { numbers.as_chunks_mut() } else { (&mut [], numbers) }
}

/// target ← of(target, x), number by number.
#[inline(always)]
pub fn combine<T: Real>(target: &mut [T], x: &[T], of: impl Fn(T, T) -> T) {
    let len = target.len().min(x.len());
    let ((targets, target), (xs, x)) = (rows_mut(target, len), rows(x, len));
    for (targets, &xs) in targets.iter_mut().zip(xs) {
        let old = *targets;
        *targets = from_fn(|lane| of(lane_of(&old, lane), lane_of(&xs, lane)));
        by_itself();
    }
    for (target, &x) in target.iter_mut().zip(x) {
        *target = of(*target, x);
    }
}

/// target ← of(target, x, y), number by number.
#[inline(always)]
pub fn combine_two<T: Real>(target: &mut [T], x: &[T], y: &[T], of: impl Fn(T, T, T) -> T) {
    let len = target.len().min(x.len()).min(y.len());
    let ((targets, target), (xs, x), (ys, y)) = (rows_mut(target, len), rows(x, len), rows(y, len));
    for (targets, (&xs, &ys)) in targets.iter_mut().zip(xs.iter().zip(ys)) {
        let old = *targets;
        *targets = from_fn(|lane| of(lane_of(&old, lane), lane_of(&xs, lane), lane_of(&ys, lane)));
        by_itself();
    }
    for (target, (&x, &y)) in target.iter_mut().zip(x.iter().zip(y)) {
        *target = of(*target, x, y);
    }
}

/// target ← of(a, b, c, d), number by number.
#[inline(always)]
pub fn combine_four<T: Real>(
    target: &mut [T],
    (a, b): (&[T], &[T]),
    (c, d): (&[T], &[T]),
    of: impl Fn(T, T, T, T) -> T,
) {
    let len = target.len().min(a.len()).min(b.len()).min(c.len()).min(d.len());
    let (targets, target) = rows_mut(target, len);
    let ((rows_of_a, a), (rows_of_b, b)) = (rows(a, len), rows(b, len));
    let ((rows_of_c, c), (rows_of_d, d)) = (rows(c, len), rows(d, len));
    let sources = rows_of_a.iter().zip(rows_of_b).zip(rows_of_c.iter().zip(rows_of_d));
    for (targets, ((a, b), (c, d))) in targets.iter_mut().zip(sources) {
        *targets = from_fn(|lane| of(lane_of(a, lane), lane_of(b, lane), lane_of(c, lane), lane_of(d, lane)));
        by_itself();
    }
    for (target, ((&a, &b), (&c, &d))) in target.iter_mut().zip(a.iter().zip(b).zip(c.iter().zip(d))) {
        *target = of(a, b, c, d);
    }
}

/// (a, b) ← of(x, y), number by number.
#[inline(always)]
pub(crate) fn fill_pair<T: Real>(
    (a, b): (&mut [T], &mut [T]),
    (x, y): (&[T], &[T]),
    of: impl Fn(T, T) -> (T, T),
) {
    let len = a.len().min(b.len()).min(x.len()).min(y.len());
    let ((rows_of_a, a), (rows_of_b, b)) = (rows_mut(a, len), rows_mut(b, len));
    let ((xs, x), (ys, y)) = (rows(x, len), rows(y, len));
    for ((a, b), (x, y)) in rows_of_a.iter_mut().zip(rows_of_b).zip(xs.iter().zip(ys)) {
        let pairs: [(T, T); LANES] = from_fn(|lane| of(lane_of(x, lane), lane_of(y, lane)));
        (*a, *b) = (pairs.map(|(a, _)| a), pairs.map(|(_, b)| b));
        by_itself();
    }
    for ((a, b), (&x, &y)) in a.iter_mut().zip(b).zip(x.iter().zip(y)) {
        (*a, *b) = of(x, y);
    }
}

/// target ← target − x, number by number. Returns x and the new target, each folded with `join` from zero.
#[inline(always)]
pub(crate) fn subtract_and_fold<T: Real>(target: &mut [T], x: &[T], join: impl Fn(T, T) -> T) -> (T, T) {
    let len = target.len().min(x.len());
    let ((targets, target), (xs, x)) = (rows_mut(target, len), rows(x, len));
    let (mut of_x, mut of_target) = (T::zero(), T::zero());
    if !targets.is_empty() {
        let (mut lanes_of_x, mut lanes) = ([T::zero(); LANES], [T::zero(); LANES]);
        for (targets, x) in targets.iter_mut().zip(xs) {
            let old = *targets;
            let new: [T; LANES] = from_fn(|lane| lane_of(&old, lane) - lane_of(x, lane));
            lanes_of_x = from_fn(|lane| join(lane_of(&lanes_of_x, lane), lane_of(x, lane)));
            lanes = from_fn(|lane| join(lane_of(&lanes, lane), lane_of(&new, lane)));
            *targets = new;
            by_itself();
        }
        (of_x, of_target) = (join_lanes(&lanes_of_x, &join), join_lanes(&lanes, &join));
    }
    for (target, &x) in target.iter_mut().zip(x) {
        *target -= x;
        (of_x, of_target) = (join(of_x, x), join(of_target, *target));
    }
    (of_x, of_target)
}

/// (a, b) ← of(a, b, x), number by number.
#[inline(always)]
pub(crate) fn combine_pair<T: Real>((a, b): (&mut [T], &mut [T]), x: &[T], of: impl Fn(T, T, T) -> (T, T)) {
    let len = a.len().min(b.len()).min(x.len());
    let ((rows_of_a, a), (rows_of_b, b), (xs, x)) = (rows_mut(a, len), rows_mut(b, len), rows(x, len));
    for ((a, b), &x) in rows_of_a.iter_mut().zip(rows_of_b).zip(xs) {
        let (old_a, old_b) = (*a, *b);
        let pairs: [(T, T); LANES] =
            from_fn(|lane| of(lane_of(&old_a, lane), lane_of(&old_b, lane), lane_of(&x, lane)));
        (*a, *b) = (pairs.map(|(a, _)| a), pairs.map(|(_, b)| b));
        by_itself();
    }
    for ((a, b), &x) in a.iter_mut().zip(b).zip(x) {
        (*a, *b) = of(*a, *b, x);
    }
}

/// Folds the numbers with `join` from `start`, in no particular order. `join` must be associative and
/// commutative, also between partial results.
#[inline(always)]
pub(crate) fn fold<T: Real>(numbers: &[T], start: T, join: impl Fn(T, T) -> T) -> T {
    let (rows, rest) = rows(numbers, numbers.len());
    let mut joined = start;
    if !rows.is_empty() {
        let mut lanes = [start; LANES];
        for row in rows {
            lanes = from_fn(|lane| join(lane_of(&lanes, lane), lane_of(row, lane)));
            by_itself();
        }
        joined = join_lanes(&lanes, &join);
    }
    rest.iter().fold(joined, |joined, &number| join(joined, number))
}

/// True if every number of the slice is finite.
#[inline]
pub(crate) fn all_finite<T: Real>(numbers: &[T]) -> bool {
    // Zero times an infinity or not-a-number is not a number, and stays so in sums.
    fold(numbers, T::zero(), |sum, number| sum + number * T::zero()) == T::zero()
}

/// `start` and zero times every number of x + y: zero if all are finite, else not a number.
#[inline(always)]
pub(crate) fn add_zeros<T: Real>(start: T, x: &[T], y: &[T]) -> T {
    let len = x.len().min(y.len());
    let ((xs, x), (ys, y)) = (rows(x, len), rows(y, len));
    let mut sum = start;
    if !xs.is_empty() {
        let mut lanes = [start; LANES];
        for (x, y) in xs.iter().zip(ys) {
            lanes = from_fn(|lane| lane_of(&lanes, lane) + (lane_of(x, lane) + lane_of(y, lane)) * T::zero());
            by_itself();
        }
        sum = join_lanes(&lanes, |sum, lane| sum + lane);
    }
    x.iter().zip(y).fold(sum, |sum, (&x, &y)| sum + (x + y) * T::zero())
}

/// Folds by halves, which the compiler vectorises.
#[inline(always)]
fn join_lanes<T: Real>(lanes: &[T; LANES], join: impl Fn(T, T) -> T) -> T {
    let [a, b, c, d, e, f, g, h] = *lanes;
    join(join(join(a, e), join(c, g)), join(join(b, f), join(d, h)))
}

/// Number `lane` of a row. The remainder lets the compiler see that the index is in range.
#[inline(always)]
fn lane_of<T: Real>(row: &[T; LANES], lane: usize) -> T {
    row[lane % LANES]
}

/// Keeps the compiler from merging iterations, for which it would transpose rows into columns.
#[inline(always)]
fn by_itself() {
    core::hint::black_box(());
}

/// target += factor · x, number by number.
#[inline(always)]
pub fn add_multiple<T: Real>(target: &mut [T], factor: T, x: &[T]) {
    combine(target, x, |target, x| target + x * factor);
}

/// A pivot vanished: the matrix is singular to working precision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Singular;

impl core::fmt::Display for Singular {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "the matrix is singular to working precision")
    }
}

impl core::error::Error for Singular {}

/// A number of a work array.
///
/// The shapes of scheme, system and memory determine the places. Unit tests detect one beyond the end; in
/// production it counts as zero, since no step may panic.
#[inline(always)]
pub(crate) fn at<T: Copy + Default>(numbers: &[T], index: usize) -> T {
    let found = numbers.get(index).copied();
    #[cfg(test)]
    assert!(found.is_some(), "number {index} of {}", numbers.len());
    found.unwrap_or_default()
}

/// Row `upper` and the later row `lower` of a matrix of width n, to read and to change.
#[inline(always)]
fn two_rows<T>(matrix: &mut [T], n: usize, upper: usize, lower: usize) -> Option<(&mut [T], &mut [T])> {
    let (above, below) = matrix.split_at_mut_checked(lower * n)?;
    Some((above.get_mut(upper * n..)?.get_mut(..n)?, below.get_mut(..n)?))
}

/// Takes multiples of a pivot's row from the rows below it, so that nothing is left below the pivot; the
/// factors stand there instead.
#[inline(always)]
fn eliminate<T: Real>(matrix: &mut [T], n: usize, column: usize, pivot: T) {
    for row in column + 1..n {
        let Some((upper, lower)) = two_rows(matrix, n, column, row) else { continue };
        let mut entries = lower.iter_mut().zip(upper).skip(column);
        let Some((entry, _)) = entries.next() else { continue };
        *entry /= pivot;
        let factor = *entry;
        for (entry, &mut above) in entries {
            *entry -= factor * above;
        }
    }
}

/// True if a pivot is no more than rounding of what elimination took from its entry, the products of the
/// factors to its left and above it. Rows and columns in other units change both alike.
#[inline(always)]
fn is_rounding<T: Real>(matrix: &[T], n: usize, (row, column): (usize, usize), pivot: T) -> bool {
    // The entry before elimination is the pivot plus what was taken from it.
    let mut entry = pivot.abs();
    for earlier in 0..column {
        entry += (at(matrix, row * n + earlier) * at(matrix, earlier * n + column)).abs();
    }
    pivot.abs() <= entry * T::EPSILON * T::of(4.0)
}

/// Factors P A = L U in place, by elimination with row pivoting; `pivots` takes the row that each column's
/// pivot came from.
///
/// # Errors
/// [`Singular`] if the largest pivot of a column is no more than rounding of what elimination took from its
/// entry, or one is not a number.
#[inline(always)]
pub fn factor<T: Real>(matrix: &mut [T], pivots: &mut [usize]) -> Result<(), Singular> {
    let n = pivots.len();
    for (column, place) in pivots.iter_mut().enumerate() {
        let (mut pivot_row, mut pivot) = (column, T::zero());
        for row in column..n {
            let candidate = at(matrix, row * n + column);
            if candidate.abs() > pivot.abs() {
                (pivot_row, pivot) = (row, candidate);
            }
        }
        if !pivot.is_finite() || is_rounding(matrix, n, (pivot_row, column), pivot) {
            return Err(Singular);
        }
        *place = pivot_row;
        if pivot_row != column
            && let Some((upper, lower)) = two_rows(matrix, n, column, pivot_row)
        {
            upper.iter_mut().zip(lower).for_each(|(a, b)| core::mem::swap(a, b));
        }
        eliminate(matrix, n, column, pivot);
    }
    Ok(())
}

/// Solves A x = `vector` with the factors of A; x replaces `vector`.
#[inline(always)]
pub fn substitute<T: Real>(factors: &[T], pivots: &[usize], vector: &mut [T]) {
    let n = pivots.len();
    exchange(pivots, vector);
    for column in 0..n {
        let known = at(vector, column);
        for row in column + 1..n {
            put(vector, row, at(vector, row) - at(factors, row * n + column) * known);
        }
    }
    for column in (0..n).rev() {
        let solution = at(vector, column) / at(factors, column * n + column);
        put(vector, column, solution);
        for row in 0..column {
            put(vector, row, at(vector, row) - at(factors, row * n + column) * solution);
        }
    }
}

/// Solves A x = `vector` in place; x replaces `vector`, the factors the matrix.
///
/// # Errors
/// [`Singular`], as [`factor`].
#[inline(always)]
pub fn solve<T: Real>(matrix: &mut [T], pivots: &mut [usize], vector: &mut [T]) -> Result<(), Singular> {
    factor(matrix, pivots)?;
    substitute(matrix, pivots, vector);
    Ok(())
}

/// Factors A as [`factor`] does and writes the factors to `kept` for [`substitute_kept`]: column by column,
/// the pivots as reciprocals.
///
/// # Errors
/// [`Singular`], as [`factor`].
#[inline(always)]
pub fn keep_factors<T: Real>(matrix: &mut [T], pivots: &mut [usize], kept: &mut [T]) -> Result<(), Singular> {
    factor(matrix, pivots)?;
    let n = pivots.len();
    for (column, numbers) in kept.chunks_exact_mut(n.max(1)).enumerate() {
        for (row, place) in numbers.iter_mut().enumerate() {
            let number = at(matrix, row * n + column);
            *place = if row == column { T::one() / number } else { number };
        }
    }
    Ok(())
}

/// Solves A x = `vector` with what [`keep_factors`] wrote; x replaces `vector`.
///
/// As many products as with the inverse of A, but the residual A x − `vector` is of the size of the rounding
/// error of A x for any stiffness: the error of a product with a rounded inverse grows with the condition
/// number of A, and beyond 10⁸ a stiff motion is lost in it.
#[inline(always)]
pub fn substitute_kept<T: Real, P: Copy + Into<usize>>(kept: &[T], pivots: &[P], vector: &mut [T]) {
    let n = pivots.len();
    exchange(pivots, vector);
    let columns = || kept.chunks_exact(n.max(1)).enumerate();
    for (column, numbers) in columns() {
        let Some((known, later)) = vector.split_at_mut_checked(column + 1) else { continue };
        let (Some(&known), Some(numbers)) = (known.last(), numbers.get(column + 1..)) else { continue };
        add_multiple(later, -known, numbers);
    }
    for (column, numbers) in columns().rev() {
        let Some((earlier, known)) = vector.split_at_mut_checked(column) else { continue };
        let Some(known) = known.first_mut() else { continue };
        *known *= at(numbers, column);
        add_multiple(earlier, -*known, numbers);
    }
}

/// Exchanges the numbers of a vector as elimination exchanged rows.
#[inline(always)]
fn exchange<T: Real, P: Copy + Into<usize>>(pivots: &[P], vector: &mut [T]) {
    // The last row stays where it is.
    let last = pivots.len().saturating_sub(1);
    for (row, &pivot) in pivots.iter().enumerate().take(last) {
        let pivot = pivot.into();
        if row != pivot {
            let (a, b) = (at(vector, row), at(vector, pivot));
            put(vector, row, b);
            put(vector, pivot, a);
        }
    }
}

#[inline(always)]
fn put<T>(numbers: &mut [T], index: usize, value: T) {
    if let Some(place) = numbers.get_mut(index) {
        *place = value;
    }
}

/// Writes the inverse of a factored matrix, column by column.
#[inline(always)]
pub fn invert_factored<T: Real>(factors: &[T], pivots: &[usize], columns: &mut [T]) {
    columns.fill(T::zero());
    for (index, column) in columns.chunks_exact_mut(pivots.len().max(1)).enumerate() {
        put(column, index, T::one());
        substitute(factors, pivots, column);
    }
}

/// True if the symmetric matrix of n×n numbers is positive definite to working precision: all pivots of its
/// elimination stay above rounding. The elimination is left in its place.
pub fn is_positive_definite_in_place<T: Real>(matrix: &mut [T], n: usize) -> bool {
    for column in 0..n {
        let pivot = at(matrix, column * n + column);
        if !(pivot.is_finite() && pivot > T::zero()) || is_rounding(matrix, n, (column, column), pivot) {
            return false;
        }
        eliminate(matrix, n, column, pivot);
    }
    true
}

/// The zero vector. nalgebra's constructors check the number of entries written, and the check is not removed
/// at every level of optimisation.
#[inline(always)]
pub(crate) fn zero_vector<T: Real, const N: usize>() -> SVector<T, N> {
    SVector::from([T::zero(); N])
}

/// As [`zero_vector`].
#[inline(always)]
pub(crate) fn zero_matrix<T: Real, const N: usize>() -> SMatrix<T, N, N> {
    SMatrix::from([[T::zero(); N]; N])
}

/// True if a symmetric matrix is positive definite to working precision.
pub(crate) fn is_positive_definite<T: Real, const N: usize>(matrix: &SMatrix<T, N, N>) -> bool {
    let mut copy = matrix.data.0;
    is_positive_definite_in_place(copy.as_flattened_mut(), N)
}

/// Inverse of a matrix.
///
/// # Errors
/// [`Singular`], as [`factor`].
pub(crate) fn invert<T: Real, const N: usize>(
    matrix: &SMatrix<T, N, N>,
) -> Result<SMatrix<T, N, N>, Singular> {
    let mut rows = [[T::zero(); N]; N];
    for (index, column) in matrix.data.0.iter().enumerate() {
        for (row, &entry) in rows.iter_mut().zip(column) {
            if let Some(place) = row.get_mut(index) {
                *place = entry;
            }
        }
    }
    let mut pivots = [0; N];
    factor(rows.as_flattened_mut(), &mut pivots)?;
    let mut inverse = zero_matrix::<T, N>();
    invert_factored(rows.as_flattened(), &pivots, inverse.data.0.as_flattened_mut());
    Ok(inverse)
}

/// Inverse of R×R numbers, row by row.
///
/// # Errors
/// [`Singular`], as [`factor`].
pub(crate) fn invert_rows<const R: usize>(matrix: &[[f64; R]; R]) -> Result<[[f64; R]; R], Singular> {
    let columns = SMatrix::<f64, R, R>::from(*matrix);
    // Columns for rows on either side: the inverse of the transpose is the transpose of the inverse.
    Ok(invert(&columns)?.data.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::noise;
    use crate::real::max_or_nan;
    use nalgebra::matrix;

    #[test]
    fn one_number_that_is_not_finite_is_noticed_wherever_it_lies() {
        for length in 0..40 {
            let good = noise(length);
            assert!(all_finite(&good) && add_zeros(0.0, &good, &good) == 0.0, "{length} numbers");
            for place in 0..length {
                for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                    let mut numbers = good.clone();
                    numbers[place] = bad;
                    assert!(!all_finite(&numbers), "{bad} at {place} of {length}");
                    assert!(add_zeros(0.0, &good, &numbers).is_nan(), "{bad} at {place} of {length}");
                    assert!(add_zeros(0.0, &numbers, &good).is_nan(), "{bad} at {place} of {length}");
                }
            }
        }
    }

    #[test]
    fn numbers_whose_product_is_beyond_range_are_finite() {
        let large = [1e200; 19];
        assert!(all_finite(&large) && add_zeros(0.0, &large, &large) == 0.0);
    }

    #[test]
    fn a_sum_beyond_range_is_noticed_wherever_it_lies_and_a_difference_is_not_asked_for() {
        for length in 1..40 {
            for place in 0..length {
                let (mut x, mut y) = (noise(length), noise(length));
                (x[place], y[place]) = (f64::MAX, f64::MAX);
                assert!(add_zeros(0.0, &x, &y).is_nan(), "{place} of {length}");
                y[place] = -f64::MAX;
                assert_eq!(add_zeros(0.0, &x, &y), 0.0, "{place} of {length}");
            }
        }
    }

    #[test]
    fn every_number_is_joined_once() {
        for length in 0..40 {
            let numbers = noise(length);
            let sum = fold(&numbers, 0.0, |sum, number| sum + number);
            assert!((sum - numbers.iter().sum::<f64>()).abs() < 1e-14, "{length} numbers");
            for largest in 0..length {
                let mut numbers = numbers.clone();
                numbers[largest] = 2.0;
                assert_eq!(fold(&numbers, -1.0, max_or_nan), 2.0, "at {largest} of {length}");
            }
        }
    }

    #[test]
    fn elimination_changes_rows_where_it_must() {
        // The first pivot comes from the fourth row: 6 in column 0.
        let mut matrix = [
            0.0, 0.0, 1.0, 2.0, //
            0.0, 0.0, 3.0, 4.0, //
            0.0, 5.0, 1.0, 0.0, //
            6.0, 0.0, 0.0, 1.0f64,
        ];
        let mut vector = [5.0, 11.0, 11.0, 8.0];
        let mut pivots = [0; 4];
        factor(&mut matrix, &mut pivots).unwrap();
        assert_eq!(pivots[0], 3);
        substitute(&matrix, &pivots, &mut vector);
        for (found, expected) in vector.into_iter().zip([1.0, 2.0, 1.0, 2.0]) {
            assert!((found - expected).abs() < 1e-14, "{vector:?}");
        }
    }

    #[test]
    fn kept_factors_leave_rounding_of_the_equations_where_an_inverse_leaves_its_condition() {
        // K = 10¹⁴ on one direction, 1 on all others: no product with a rounded inverse solves the stiff one.
        let n = 6;
        let stiff: std::vec::Vec<f64> = (0..n).map(|i| (1.0 + i as f64 * 0.7).sin()).collect();
        let mut matrix = std::vec![0.0; n * n];
        for row in 0..n {
            for column in 0..n {
                matrix[row * n + column] =
                    1e14 * stiff[row] * stiff[column] + f64::from(u8::from(row == column));
            }
        }
        let right: std::vec::Vec<f64> = (0..n).map(|i| 1e14 * stiff[i] + i as f64).collect();
        let residual = |x: &[f64]| -> f64 {
            let row = |i: usize| -> f64 { (0..n).map(|j| matrix[i * n + j] * x[j]).sum::<f64>() - right[i] };
            (0..n).map(row).map(f64::abs).fold(0.0, max_or_nan)
        };
        let (mut rows, mut pivots, mut kept) = (matrix.clone(), std::vec![0; n], std::vec![0.0; n * n]);
        keep_factors(&mut rows, &mut pivots, &mut kept).unwrap();
        let (mut found, mut eliminated) = (right.clone(), right.clone());
        substitute_kept(&kept, &pivots, &mut found);
        substitute(&rows, &pivots, &mut eliminated);
        assert!(residual(&eliminated) < 1.0 && residual(&found) < 1.0, "{:e}", residual(&found));
        let mut columns = std::vec![0.0; n * n];
        invert_factored(&rows, &pivots, &mut columns);
        let product: std::vec::Vec<f64> =
            (0..n).map(|i| (0..n).map(|j| columns[j * n + i] * right[j]).sum()).collect();
        assert!(residual(&product) > 1e3, "{:e}", residual(&product));
    }

    #[test]
    fn four_vectors_are_combined_number_by_number() {
        for length in 0..20 {
            let [a, b, c, d] =
                [1.0, 2.0, 3.0, 4.0].map(|first| noise(length).iter().map(|x| first + x).collect());
            let [a, b, c, d]: [std::vec::Vec<f64>; 4] = [a, b, c, d];
            let mut found = std::vec![f64::NAN; length];
            combine_four(&mut found, (&a, &b), (&c, &d), |a, b, c, d| a + 10.0 * b + 100.0 * c + 1000.0 * d);
            for i in 0..length {
                assert_eq!(found[i], a[i] + 10.0 * b[i] + 100.0 * c[i] + 1000.0 * d[i], "{i} of {length}");
            }
        }
    }

    #[test]
    fn a_correction_is_subtracted_and_the_largest_numbers_are_those_before_and_after() {
        let largest = |numbers: &[f64]| numbers.iter().map(|x| x.abs()).fold(0.0, max_or_nan);
        for length in 0..20 {
            let (start, correction) = (noise(length), noise(length + 7).split_off(7));
            let mut found = start.clone();
            let sizes = subtract_and_fold(&mut found, &correction, |largest, x| max_or_nan(largest, x.abs()));
            for i in 0..length {
                assert_eq!(found[i], start[i] - correction[i], "{i} of {length}");
            }
            assert_eq!(sizes, (largest(&correction), largest(&found)), "{length} numbers");
        }
    }

    #[test]
    fn a_pivot_is_held_against_what_elimination_took_from_it() {
        // Two equations alike but for rounding, and a saddle of a mass and a constraint, in whichever units.
        for unit in [1e-26, 1.0, 1e20] {
            let mut alike = [unit, 1.0, unit, 1.0 + f64::EPSILON];
            assert_eq!(factor(&mut alike, &mut [0; 2]), Err(Singular), "{unit:e}");
            let mut saddle = [unit, 0.0, 0.6, 0.0, unit, 0.8, 0.6, 0.8, 0.0];
            let (mut pivots, mut force) = ([0; 3], [unit, 0.0, 0.0]);
            factor(&mut saddle, &mut pivots).unwrap();
            substitute(&saddle, &pivots, &mut force);
            for (found, expected) in force.into_iter().zip([0.64, -0.48, 0.6 * unit]) {
                let error = (found - expected).abs();
                assert!(error <= 4.0 * f64::EPSILON * expected.abs(), "{unit:e}: {found} for {expected}");
            }
            let mut twice = [unit, 0.3, 0.6, 0.3, 0.0, 0.0, 0.6, 0.0, 0.0];
            assert_eq!(factor(&mut twice, &mut [0; 3]), Err(Singular), "{unit:e}");
        }
        // Of rows alike the first is the pivot.
        let (mut alike, mut pivots) = ([1.0, 2.0, 1.0, 3.0], [9; 2]);
        factor(&mut alike, &mut pivots).unwrap();
        assert_eq!(pivots, [0, 1]);
    }

    #[test]
    fn what_elimination_leaves_by_rounding_is_not_definite() {
        // s [1 1; 1 1 + 2ε] behind another coordinate: elimination takes s from s (1 + 2ε).
        let (s, e) = (1.0 / 1_048_576.0, f64::EPSILON);
        let mut nearly = [1.0, 0.0, 0.0, 0.0, s, s, 0.0, s, s * (1.0 + 2.0 * e)];
        assert!(!is_positive_definite_in_place(&mut nearly, 3));
        let mut clearly = [1.0, 0.0, 0.0, 0.0, s, s, 0.0, s, s * (1.0 + 6.0 * e)];
        assert!(is_positive_definite_in_place(&mut clearly, 3));
    }

    #[test]
    fn singular_and_indefinite_matrices_are_told_apart() {
        let singular = matrix![1.0, 2.0; 2.0, 4.0];
        assert_eq!(invert(&singular), Err(Singular));
        assert!(!is_positive_definite(&singular));
        // A pivot is compared with what elimination took from its own entry, however small that is beside the
        // rest.
        assert!(is_positive_definite(&matrix![1.0, 1e-20; 1e-20, 2e-40]));
        let indefinite = matrix![1.0, 2.0; 2.0, 1.0];
        assert!(invert(&indefinite).is_ok());
        assert!(!is_positive_definite(&indefinite));
        let definite = matrix![2.0, 1.0; 1.0, 2.0];
        assert!(is_positive_definite(&definite));
        assert!((definite * invert(&definite).unwrap() - SMatrix::identity()).norm() < 1e-15);
        assert!(!is_positive_definite(&matrix![f64::NAN]));
    }
}
