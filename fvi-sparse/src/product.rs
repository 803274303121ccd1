//! y ← y + c A x.

use crate::Pattern;
use core::ops::{Add, Mul};
use fvi_threads::share;
use pulp::{Arch, Simd, WithSimd};

/// Number of vectors that are multiplied in one pass over the matrix.
const WIDEST: usize = 8;

/// Number of places up to which the choice of a vector unit takes longer than the product.
const FEW: usize = 32;

/// Number of multiplications for which another thread is worth while.
const SHARE: usize = 1 << 20;

impl Pattern {
    /// y ← y + factor A x for the matrix with these values, one for each place, for one or more x and y
    /// stored one after another. Eight vectors at a time share a pass over A, each with the same bits as
    /// alone. Uses at most the given number of threads.
    pub fn multiply_add<T>(&self, values: &[T], factor: T, x: &[T], y: &mut [T], threads: usize)
    where
        T: Copy + Default + Add<Output = T> + Mul<Output = T> + Send + Sync,
    {
        let size = self.size();
        if size == 0 {
            return;
        }
        if x.len() == size && self.len() <= FEW {
            let matrix = Matrix { pattern: self, values, factor };
            for (row, y) in y.iter_mut().enumerate().take(size) {
                let [sum] = matrix.row(x.as_chunks().0, row);
                *y = *y + sum * factor;
            }
            return;
        }
        for (x, y) in x.chunks(WIDEST * size).zip(y.chunks_mut(WIDEST * size)) {
            match x.len() / size {
                0 => {}
                1 => self.multiply_add_some::<T, 1>(values, factor, x.as_chunks().0, y, threads),
                2 => self.multiply_add_some::<T, 2>(values, factor, &side_by_side(x, size), y, threads),
                3 | 4 => self.multiply_add_some::<T, 4>(values, factor, &side_by_side(x, size), y, threads),
                _ => self.multiply_add_some::<T, WIDEST>(values, factor, &side_by_side(x, size), y, threads),
            }
        }
    }

    /// The same for up to W vectors, with the numbers of a row side by side in x.
    fn multiply_add_some<T, const W: usize>(
        &self,
        values: &[T],
        factor: T,
        x: &[[T; W]],
        y: &mut [T],
        threads: usize,
    ) where
        T: Copy + Default + Add<Output = T> + Mul<Output = T> + Send + Sync,
    {
        let size = self.size();
        let count = y.len() / size;
        let threads = (self.len() * count / SHARE).clamp(1, threads.max(1));
        let (matrix, unit) = (Matrix { pattern: self, values, factor }, Arch::new());
        if threads == 1 {
            // Without allocation, which takes longer than the product of a small matrix.
            let mut vectors = y.chunks_mut(size);
            let mut y: [&mut [T]; W] = core::array::from_fn(|_| vectors.next().unwrap_or_default());
            return unit.dispatch(Product { matrix, x, first: 0, y: &mut y[..count.min(W)] });
        }
        // Parts of a thread that is delayed are done by the others.
        let rows = size.div_ceil(4 * threads);
        let mut parts: Vec<(usize, Vec<&mut [T]>)> =
            (0..size).step_by(rows).map(|first| (first, Vec::with_capacity(count))).collect();
        for y in y.chunks_mut(size) {
            parts.iter_mut().zip(y.chunks_mut(rows)).for_each(|((_, part), rows)| part.push(rows));
        }
        share(threads, parts, |(first, mut y)| unit.dispatch(Product { matrix, x, first, y: &mut y }));
    }
}

/// Up to W vectors of `size` numbers, stored one after another, rearranged with their numbers for a row side
/// by side; missing vectors are zero.
fn side_by_side<T: Copy + Default, const W: usize>(x: &[T], size: usize) -> Vec<[T; W]> {
    let side = |row| core::array::from_fn(|vector| x.get(vector * size + row).copied().unwrap_or_default());
    (0..size).map(side).collect()
}

/// A matrix and the factor of its product.
#[derive(Clone, Copy)]
struct Matrix<'a, T> {
    pattern: &'a Pattern,
    values: &'a [T],
    factor: T,
}

/// The product of the rows from `first` on, compiled once for every vector unit.
struct Product<'a, 'y, 'r, T, const W: usize> {
    matrix: Matrix<'a, T>,
    x: &'a [[T; W]],
    first: usize,
    /// The given rows of each vector.
    y: &'y mut [&'r mut [T]],
}

impl<T, const W: usize> WithSimd for Product<'_, '_, '_, T, W>
where
    T: Copy + Default + Add<Output = T> + Mul<Output = T>,
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { matrix, x, first, y } = self;
        let count = y.first().map_or(0, |rows| rows.len());
        for index in 0..count {
            let sums = matrix.row(x, first + index);
            for (y, sum) in y.iter_mut().zip(sums) {
                y[index] = y[index] + sum * matrix.factor;
            }
        }
    }
}

impl<T: Copy + Default + Add<Output = T> + Mul<Output = T>> Matrix<'_, T> {
    /// The products of a row with W vectors, each from two sums: over the even places, and over the odd ones.
    #[inline(always)]
    fn row<const W: usize>(&self, x: &[[T; W]], row: usize) -> [T; W] {
        let slots = self.pattern.row(row);
        let (columns, entries) = (&self.pattern.columns()[slots.clone()], &self.values[slots]);
        let add = |sums: &mut [T; W], column: u32, entry: T| {
            let x = x[column as usize];
            sums.iter_mut().zip(x).for_each(|(sum, x)| *sum = *sum + entry * x);
        };
        let mut sums = [[T::default(); W]; 2];
        let [even, odd] = &mut sums;
        let ((pairs, last), (entries, entry)) = (columns.as_chunks::<2>(), entries.as_chunks::<2>());
        for (&[left, right], &[a, b]) in pairs.iter().zip(entries) {
            add(even, left, a);
            add(odd, right, b);
        }
        if let ([column], [entry]) = (last, entry) {
            add(even, *column, *entry);
        }
        core::array::from_fn(|vector| even[vector] + odd[vector])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_vectors_and_threads_have_the_bits_of_one() {
        // A ring, long enough to be shared.
        let n = 400_000;
        let pattern = Pattern::from_rows((0..n).map(|row| {
            let mut places = [row, (row + 1) % n, (row + n - 1) % n];
            places.sort_unstable();
            places
        }));
        let values: Vec<f64> = (0..pattern.len()).map(|slot| (slot as f64 * 0.3).sin()).collect();
        let x: Vec<f64> = (0..3 * n).map(|index| (index as f64 * 0.7).cos()).collect();
        let mut together = x.clone();
        pattern.multiply_add(&values, 0.5, &x, &mut together, 3);
        for (index, (x, together)) in x.chunks(n).zip(together.chunks(n)).enumerate() {
            let mut alone = x.to_vec();
            pattern.multiply_add(&values, 0.5, x, &mut alone, 1);
            assert!(alone == together, "vector {index}");
            let known: f64 =
                pattern.row(7).map(|slot| values[slot] * x[pattern.columns()[slot] as usize]).sum();
            assert!((alone[7] - x[7] - 0.5 * known).abs() < 1e-15);
        }
    }

    #[test]
    fn any_number_of_vectors_is_multiplied() {
        // Rows of odd, even and no places.
        let n = 17;
        let near = |row: usize| (0..n).filter(move |&column| row.abs_diff(column) <= row % 4 && row != 5);
        let pattern = Pattern::from_rows((0..n).map(near));
        let values: Vec<f64> = (0..pattern.len()).map(|slot| (slot as f64 * 0.3).sin()).collect();
        for count in [1, 2, 3, 8, 9] {
            let x: Vec<f64> = (0..count * n).map(|index| (index as f64 * 0.7).cos()).collect();
            let mut y = vec![1.0; count * n];
            pattern.multiply_add(&values, 2.0, &x, &mut y, 1);
            for (x, y) in x.chunks(n).zip(y.chunks(n)) {
                for (row, slots) in pattern.rows().enumerate() {
                    let sum: f64 = slots.map(|slot| values[slot] * x[pattern.columns()[slot] as usize]).sum();
                    assert!((y[row] - 1.0 - 2.0 * sum).abs() < 1e-14, "{count} {row}: {} {sum}", y[row]);
                }
            }
        }
    }
}
