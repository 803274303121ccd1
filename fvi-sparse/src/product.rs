//! y ← y + c A x.

use crate::Pattern;
use crate::threads::share;
use core::ops::{Add, Mul};

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
            let matrix = Product { pattern: self, values, factor, x };
            let count = x.len() / size;
            let threads = (self.len() * count / SHARE).clamp(1, threads.max(1));
            // A thread that is held up leaves parts to the others.
            let rows = if threads > 1 { size.div_ceil(4 * threads) } else { size };
            let mut parts: Vec<(usize, Vec<&mut [T]>)> =
                (0..size).step_by(rows).map(|first| (first, Vec::with_capacity(count))).collect();
            for y in y.chunks_mut(size) {
                parts.iter_mut().zip(y.chunks_mut(rows)).for_each(|((_, part), rows)| part.push(rows));
            }
            share(threads, parts.into_iter(), |(first, y)| match count {
                0 => {}
                1 => matrix.rows::<1>(first, y),
                2 => matrix.rows::<2>(first, y),
                3 | 4 => matrix.rows::<4>(first, y),
                _ => matrix.rows::<WIDEST>(first, y),
            });
        }
    }
}

/// A matrix, its factor, and what it is multiplied with.
struct Product<'a, T> {
    pattern: &'a Pattern,
    values: &'a [T],
    factor: T,
    x: &'a [T],
}

impl<T: Copy + Default + Add<Output = T> + Mul<Output = T>> Product<'_, T> {
    /// The rows from `first` on, for up to W vectors.
    fn rows<const W: usize>(&self, first: usize, mut y: Vec<&mut [T]>) {
        let size = self.pattern.size();
        // A vector that is not there stands for the first one, and its sums are not used.
        let starts: [usize; W] = core::array::from_fn(|index| if index < y.len() { index * size } else { 0 });
        let count = y.first().map_or(0, |rows| rows.len());
        for index in 0..count {
            let slots = self.pattern.row(first + index);
            let entries = self.pattern.narrow_columns()[slots.clone()].iter().zip(&self.values[slots]);
            let mut sums = [T::default(); W];
            for (&column, &entry) in entries {
                for (sum, start) in sums.iter_mut().zip(starts) {
                    *sum = *sum + entry * self.x[start + column as usize];
                }
            }
            for (y, sum) in y.iter_mut().zip(sums) {
                y[index] = y[index] + sum * self.factor;
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
            let known: f64 = pattern.row(7).map(|slot| values[slot] * x[pattern.columns()[slot]]).sum();
            assert!((alone[7] - x[7] - 0.5 * known).abs() < 1e-15);
        }
    }
}
