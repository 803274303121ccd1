//! The sum Σ w_n x_{k−n} over a history that lies in two pieces, written so that it vectorises and stays accurate.

use crate::real::Real;

/// Number of accumulators. A lag n always goes to accumulator (n − 1) mod `LANES`.
const LANES: usize = 8;

/// Lags between two clearings of the accumulators; a multiple of `LANES`.
const BLOCK: usize = 64 * LANES;

/// Σ_{n=1}^{k} w_n x_{k−n} with the k samples, oldest first, in `older` followed by `newer`.
///
/// `weights[n]` is w_n; lags beyond the table count as zero. The oldest samples are added first, in blocks of
/// fixed lags with fixed accumulators: the weights fall with the lag, so small terms meet small sums, and the result
/// depends on the samples alone, neither on the place where the history is cut nor on the width of the processor's
/// vectors.
#[inline]
pub(crate) fn weighted_sum<T: Real>(weights: &[T], older: &[T], newer: &[T]) -> T {
    let mut sum = BlockedSum { total: T::zero(), lanes: [T::zero(); LANES] };
    sum.add(weights, newer.len(), older);
    sum.add(weights, 0, newer);
    sum.total + reduce(sum.lanes)
}

struct BlockedSum<T> {
    total: T,
    lanes: [T; LANES],
}

/// Sum of the accumulators by halves.
#[inline]
fn reduce<T: Real>(lanes: [T; LANES]) -> T {
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

impl<T: Real> BlockedSum<T> {
    /// Adds the samples whose lags are `nearest + samples.len()` (the first) down to `nearest + 1` (the last).
    #[inline]
    fn add(&mut self, weights: &[T], nearest: usize, samples: &[T]) {
        // Weight n belongs to lag n; what the table or the history lacks is left out at the old end.
        let weights = weights.get(nearest + 1..).unwrap_or(&[]);
        let count = weights.len().min(samples.len());
        let mut weights = weights.get(..count).unwrap_or(&[]);
        let mut samples = samples.get(samples.len() - count..).unwrap_or(&[]);
        while !samples.is_empty() {
            let farthest = nearest + samples.len();
            let in_block = (farthest - 1) % BLOCK + 1;
            let Some((now, later)) = samples.split_at_checked(in_block.min(samples.len())) else { return };
            let Some((rest, with)) = weights.split_at_checked(later.len()) else { return };
            self.add_within_block(with, farthest, now);
            if in_block == now.len() {
                self.total += reduce(self.lanes);
                self.lanes = [T::zero(); LANES];
            }
            weights = rest;
            samples = later;
        }
    }

    /// Adds samples of lags `farthest`, `farthest` − 1, … whose weights are given in ascending order of lags.
    #[inline]
    fn add_within_block(&mut self, weights: &[T], farthest: usize, samples: &[T]) {
        let ragged = (farthest % LANES).min(samples.len());
        let (Some((first, aligned)), Some((aligned_weights, first_weights))) = (
            samples.split_at_checked(ragged),
            weights.split_at_checked(weights.len() - ragged.min(weights.len())),
        ) else {
            return;
        };
        self.add_singly(first_weights, farthest, first);
        let mut lanes = self.lanes;
        let chunks = aligned.chunks_exact(LANES);
        let weight_chunks = aligned_weights.rchunks_exact(LANES);
        let (last, last_weights) = (chunks.remainder(), weight_chunks.remainder());
        for (x, w) in chunks.zip(weight_chunks) {
            for ((lane, w), x) in lanes.iter_mut().zip(w).zip(x.iter().rev()) {
                *lane += *w * *x;
            }
        }
        self.lanes = lanes;
        self.add_singly(last_weights, farthest - ragged - (aligned.len() - last.len()), last);
    }

    #[inline]
    fn add_singly(&mut self, weights: &[T], farthest: usize, samples: &[T]) {
        for (behind, (w, x)) in weights.iter().rev().zip(samples).enumerate() {
            if let Some(lane) = self.lanes.get_mut((farthest - behind - 1) % LANES) {
                *lane += *w * *x;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn noise(count: usize) -> Vec<f64> {
        let mut state = 1u64;
        (0..count)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
            })
            .collect()
    }

    #[test]
    fn the_cut_of_the_history_does_not_change_a_bit() {
        for length in [0, 1, 7, 8, 9, 511, 512, 513, 1300] {
            let (weights, samples) = (noise(length + 1), noise(length));
            let whole = weighted_sum(&weights, &[], &samples);
            let plain: f64 = (1..=length).map(|n| weights[n] * samples[length - n]).sum();
            assert!((whole - plain).abs() <= 1e-13, "length {length}: {whole} and {plain}");
            for cut in 0..=length {
                let (older, newer) = samples.split_at(cut);
                assert_eq!(weighted_sum(&weights, older, newer), whole, "length {length}, cut at {cut}");
            }
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
}
