//! y ← y + c A x.

use crate::Pattern;
use crate::threads::share;
use core::ops::{Add, Mul};
use pulp::{Arch, Simd, WithSimd};

/// Vectors that go through a matrix together.
const WIDEST: usize = 8;

/// Products of entries and numbers for which another thread is worth while.
const SHARE: usize = 1 << 20;

impl Pattern {
    /// y ← y + factor A x for the matrix with these values, one for each place, and several x and y one
    /// behind the other: in one pass over A for each eight of them, each with the bits that it has alone,
    /// with up to so many threads.
    pub fn multiply_add<T>(&self, values: &[T], factor: T, x: &[T], y: &mut [T], threads: usize)
    where
        T: Copy + Default + Add<Output = T> + Mul<Output = T> + Send + Sync,
    {
        let size = self.size();
        if size == 0 {
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

    /// The same for up to W vectors, whose numbers for a row lie side by side in x.
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
        // A thread that is held up leaves parts to the others.
        let rows = if threads > 1 { size.div_ceil(4 * threads) } else { size };
        let mut parts: Vec<(usize, Vec<&mut [T]>)> =
            (0..size).step_by(rows).map(|first| (first, Vec::with_capacity(count))).collect();
        for y in y.chunks_mut(size) {
            parts.iter_mut().zip(y.chunks_mut(rows)).for_each(|((_, part), rows)| part.push(rows));
        }
        let (matrix, unit) = (Matrix { pattern: self, values, factor }, Arch::new());
        share(threads, parts.into_iter(), |(first, y)| unit.dispatch(Product { matrix, x, first, y }));
    }
}

/// Up to W vectors of so many numbers, one behind the other, with their numbers for a row side by side, behind
/// them zeros.
fn side_by_side<T: Copy + Default, const W: usize>(x: &[T], size: usize) -> Vec<[T; W]> {
    let mut sides = vec![[T::default(); W]; size];
    for (vector, x) in x.chunks_exact(size).enumerate() {
        sides.iter_mut().zip(x).for_each(|(side, &x)| side[vector] = x);
    }
    sides
}

/// A matrix and its factor.
#[derive(Clone, Copy)]
struct Matrix<'a, T> {
    pattern: &'a Pattern,
    values: &'a [T],
    factor: T,
}

/// The product of the rows from `first` on, compiled once for every vector unit.
struct Product<'a, 'y, T, const W: usize> {
    matrix: Matrix<'a, T>,
    x: &'a [[T; W]],
    first: usize,
    /// These rows of each vector.
    y: Vec<&'y mut [T]>,
}

impl<T, const W: usize> WithSimd for Product<'_, '_, T, W>
where
    T: Copy + Default + Add<Output = T> + Mul<Output = T>,
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { matrix, x, first, mut y } = self;
        let count = y.first().map_or(0, |rows| rows.len());
        // With several vectors there are sums enough.
        let most = if W > 2 { 1 } else { TOGETHER };
        let mut index = 0;
        while index < count {
            let alike = matrix.pattern.alike(first + index, most.min(count - index));
            match alike {
                1 => matrix.run::<W, 1>(x, first, index, &mut y),
                2 => matrix.run::<W, 2>(x, first, index, &mut y),
                _ => matrix.run::<W, TOGETHER>(x, first, index, &mut y),
            }
            index += alike;
        }
    }
}

/// Rows with the same columns that go through a vector together: the unknowns of one node of a mesh in space.
const TOGETHER: usize = 3;

impl<T: Copy + Default + Add<Output = T> + Mul<Output = T>> Matrix<'_, T> {
    /// R rows with the same columns from one on, each with two sums: of its even places, and of its odd ones.
    #[inline(always)]
    fn run<const W: usize, const R: usize>(
        &self,
        x: &[[T; W]],
        first: usize,
        index: usize,
        y: &mut [&mut [T]],
    ) {
        let columns = &self.pattern.columns()[self.pattern.row(first + index)];
        let rows: [&[T]; R] =
            core::array::from_fn(|row| &self.values[self.pattern.row(first + index + row)][..columns.len()]);
        let mut sums = [[[T::default(); W]; 2]; R];
        let mut add = |place: usize, column: u32, half: usize| {
            let x = x[column as usize];
            for (sums, row) in sums.iter_mut().zip(rows) {
                let entry = row[place];
                for (sum, x) in sums[half].iter_mut().zip(x) {
                    *sum = *sum + entry * x;
                }
            }
        };
        let (pairs, last) = columns.as_chunks::<2>();
        for (pair, &[even, odd]) in pairs.iter().enumerate() {
            add(2 * pair, even, 0);
            add(2 * pair + 1, odd, 1);
        }
        if let [column] = last {
            add(columns.len() - 1, *column, 0);
        }
        for (row, [even, odd]) in sums.iter().enumerate() {
            for ((y, &even), &odd) in y.iter_mut().zip(even).zip(odd) {
                let place = &mut y[index + row];
                *place = *place + (even + odd) * self.factor;
            }
        }
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
    fn rows_with_the_same_columns_are_multiplied_as_any_others() {
        // Nodes of four, three, two and one unknowns, each coupled with itself and the next.
        let ends = [0, 4, 7, 9, 10, 13, 17];
        let node = |row: usize| ends.iter().rposition(|&end| end <= row).unwrap_or(0);
        let n = 17;
        let near = |row: usize| (0..n).filter(move |&column| node(row).abs_diff(node(column)) <= 1);
        let pattern = Pattern::from_rows((0..n).map(near));
        let values: Vec<f64> = (0..pattern.len()).map(|slot| (slot as f64 * 0.3).sin()).collect();
        for count in [1, 2, 3, 8] {
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
