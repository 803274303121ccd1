//! The sum Σ w_n x_{k−n} over a history that lies in two pieces, written so that it vectorises and stays
//! accurate.

use crate::real::Real;

/// Number of accumulators. A lag n always goes to accumulator (n − 1) mod `LANES`.
const LANES: usize = 8;

/// Lags between two clearings of the accumulators; a multiple of `LANES`.
const BLOCK: usize = 256 * LANES;

/// True if the accumulators are in vector registers, so that a short sum is worth code of its own.
const IN_REGISTERS: bool = cfg!(target_pointer_width = "64");

/// Σ_{n=1}^{k} w_n x_{k−n} with the k samples, newest first, in `newer` followed by `older`.
///
/// `weights[n]` is w_n; lags beyond the table count as zero. The oldest samples are added first, in blocks of
/// fixed lags with fixed accumulators: the weights fall with the lag, so small terms meet small sums, and the
/// result depends on the samples alone, neither on the place where the history is cut nor on the width of the
/// processor's vectors.
#[inline]
pub(crate) fn weighted_sum<T: Real>(weights: &[T], newer: &[T], older: &[T]) -> T {
    // Weight and sample at the same place belong together: place i is lag i + 1.
    let weights = weights.get(1..).unwrap_or(&[]);
    let newer = newer.get(..weights.len()).unwrap_or(newer);
    let Some((newer_weights, older_weights)) = weights.split_at_checked(newer.len()) else {
        return T::zero();
    };
    if IN_REGISTERS && older.is_empty() && newer.len() <= BLOCK {
        // One block in one piece.
        let mut lanes = [T::zero(); LANES];
        add_rows(&mut lanes, newer_weights, newer);
        return T::zero() + reduce(lanes);
    }
    let mut sum = BlockedSum { total: T::zero(), lanes: [T::zero(); LANES] };
    sum.add(older_weights, older, newer.len());
    sum.add(newer_weights, newer, 0);
    sum.total + reduce(sum.lanes)
}

/// The sum of the lags so far, which are added from the oldest on.
struct BlockedSum<T> {
    /// Sum of the complete blocks.
    total: T,
    /// Accumulators of the block being added.
    lanes: [T; LANES],
}

/// Sum of the accumulators by halves.
#[inline]
fn reduce<T: Real>(lanes: [T; LANES]) -> T {
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

impl<T: Real> BlockedSum<T> {
    /// Adds the products of the indices `first`, `first` + 1, …, the last one first.
    #[inline]
    fn add(&mut self, weights: &[T], samples: &[T], first: usize) {
        let mut count = weights.len().min(samples.len());
        while count > 0 {
            let in_block = (first + count - 1) % BLOCK + 1;
            let nearer = count.saturating_sub(in_block);
            let (Some(w), Some(x)) = (weights.get(nearer..count), samples.get(nearer..count)) else { return };
            self.add_within_block(w, x, (first + nearer) % LANES);
            if w.len() == in_block {
                self.total += reduce(self.lanes);
                self.lanes = [T::zero(); LANES];
            }
            count = nearer;
        }
    }

    /// Adds products of one block, the first of which belongs to accumulator `lane`.
    #[inline]
    fn add_within_block(&mut self, weights: &[T], samples: &[T], lane: usize) {
        let ragged = if lane == 0 { 0 } else { (LANES - lane).min(samples.len()) };
        let (Some((first_weights, weights)), Some((first, samples))) =
            (weights.split_at_checked(ragged), samples.split_at_checked(ragged))
        else {
            return;
        };
        add_rows(&mut self.lanes, weights, samples);
        add_products(self.lanes.get_mut(lane..).unwrap_or(&mut []), first_weights, first);
    }
}

/// Adds products whose first one belongs to accumulator 0, the last row first.
#[inline(always)]
fn add_rows<T: Real>(lanes: &mut [T; LANES], weights: &[T], samples: &[T]) {
    let (weight_rows, last_weights) = weights.as_chunks::<LANES>();
    let (rows, last) = samples.as_chunks::<LANES>();
    add_products(lanes, last_weights, last);
    // Accumulators by value stay in registers.
    let mut sums = *lanes;
    for (w, x) in weight_rows.iter().zip(rows).rev() {
        for i in 0..LANES {
            sums[i] += w[i] * x[i];
        }
    }
    *lanes = sums;
}

#[inline]
fn add_products<T: Real>(lanes: &mut [T], weights: &[T], samples: &[T]) {
    for (lane, (&w, &x)) in lanes.iter_mut().zip(weights.iter().zip(samples)) {
        *lane += w * x;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::noise;
    use std::vec::Vec;

    #[test]
    fn the_cut_of_the_history_does_not_change_a_bit() {
        for length in [0, 1, 7, 8, 9, 2047, 2048, 2049, 4199] {
            let (weights, samples) = (noise(length + 1), noise(length));
            let whole = weighted_sum(&weights, &samples, &[]);
            let plain: f64 = (1..=length).map(|n| weights[n] * samples[n - 1]).sum();
            assert!((whole - plain).abs() <= 1e-13, "length {length}: {whole} and {plain}");
            for cut in (0..=length).step_by(1 + length / 300) {
                let (newer, older) = samples.split_at(cut);
                assert_eq!(weighted_sum(&weights, newer, older), whole, "length {length}, cut at {cut}");
            }
        }
    }

    #[test]
    fn many_equal_terms_keep_their_digits_in_single_precision() {
        let count = 1 << 18;
        let (weights, samples) = (std::vec![1.0f32; count + 1], std::vec![0.1f32; count]);
        for cut in [0, 5000, count] {
            let (newer, older) = samples.split_at(cut);
            let sum = f64::from(weighted_sum(&weights, newer, older));
            let error = sum / (count as f64 * f64::from(0.1f32)) - 1.0;
            assert!(error.abs() < 1e-5, "cut at {cut}: {error:e}");
        }
    }

    #[test]
    fn lags_beyond_the_table_count_as_zero() {
        let (weights, samples) = (noise(40), noise(100));
        let long: Vec<f64> = weights.iter().copied().chain([0.0; 61]).collect();
        assert_eq!(
            weighted_sum(&weights, &samples[..50], &samples[50..]),
            weighted_sum(&long, &[], &samples)
        );
        assert_eq!(weighted_sum(&[], &[], &samples), 0.0);
    }

    #[test]
    fn a_block_of_lags_is_summed_by_itself() {
        // The ones at the end of the first block, lags 2047 and 2048, are added to each other before the 2⁵³
        // after them, to which each alone would be lost.
        let (mut weights, samples) = (std::vec![0.0; 2050], std::vec![1.0; 2049]);
        (weights[2047], weights[2048], weights[2049]) = (1.0, 1.0, 2f64.powi(53));
        assert_eq!(weighted_sum(&weights, &samples, &[]), 2f64.powi(53) + 2.0);
        // Lags 2049 and 2050 likewise, behind a block of 2⁵³.
        let (mut weights, samples) = (std::vec![0.0; 2051], std::vec![1.0; 2050]);
        (weights[2048], weights[2049], weights[2050]) = (2f64.powi(53), 1.0, 1.0);
        assert_eq!(weighted_sum(&weights, &samples, &[]), 2f64.powi(53) + 2.0);
    }
}
