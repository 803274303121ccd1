//! The memory term summed term by term with compensation: the reference for every engine.

use crate::sums::CompensatedSum;
use fvi_core::Real;

/// One number of r_k and the scale of its rounding errors.
#[derive(Clone, Copy, Debug)]
pub struct MemoryTerm {
    /// Σ_{n=1}^{k} w_n x_{k−n}, correct to f64 rounding.
    pub sum: f64,
    /// Σ_{n=1}^{k} |w_n| |x_{k−n}|.
    pub absolute: f64,
}

/// r_k of every channel, for S×S weights row by row and samples one after the other.
///
/// The algorithms for sums and products with error terms are those of Ogita, Rump and Oishi.
pub fn memory_term<T: Real>(
    weights: &[T],
    stages: usize,
    samples: &[T],
    channels: usize,
    k: usize,
) -> Vec<MemoryTerm> {
    let entries = stages * stages;
    (0..channels)
        .map(|channel| {
            let (stage, group) = (channel % stages, channel - channel % stages);
            let (mut sum, mut absolute) = (CompensatedSum::default(), 0.0);
            for n in 1..=k {
                for other in 0..stages {
                    let weight = weights[n * entries + stage * stages + other].to_f64();
                    let sample = samples[(k - n) * channels + group + other].to_f64();
                    sum.add_product(weight, sample);
                    absolute += (weight * sample).abs();
                }
            }
            MemoryTerm { sum: sum.total(), absolute }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_term_of_two_stages_by_hand() {
        // W₁ = (1 2; 3 −4), W₂ = (5 6; 7 8); x₀ = (1, −1), x₁ = (10, 100).
        let weights = [9.0, 9.0, 9.0, 9.0, 1.0, 2.0, 3.0, -4.0, 5.0, 6.0, 7.0, 8.0];
        let terms = memory_term(&weights, 2, &[1.0, -1.0, 10.0, 100.0], 2, 2);
        assert_eq!(terms.iter().map(|term| term.sum).collect::<Vec<_>>(), [209.0, -371.0]);
        assert_eq!(terms.iter().map(|term| term.absolute).collect::<Vec<_>>(), [221.0, 445.0]);
    }
}
