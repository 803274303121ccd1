//! The memory term summed term by term with compensation: what every engine is compared with.

use fvi_core::Real;

/// One number of r_k and what its rounding errors are measured against.
#[derive(Clone, Copy, Debug)]
pub struct MemoryTerm {
    /// Σ_{n=1}^{k} w_n x_{k−n}, correct to f64 rounding.
    pub sum: f64,
    /// Σ_{n=1}^{k} |w_n| |x_{k−n}|.
    pub absolute: f64,
}

/// r_k of every channel, for S×S weights row by row and samples one after the other.
///
/// Products are split exactly by a fused multiply–add, and the sums of sums and of errors are those of Ogita, Rump and Oishi: the
/// result is as if computed in twice the precision.
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
            let (mut sum, mut error, mut absolute) = (0.0f64, 0.0, 0.0);
            for n in 1..=k {
                for other in 0..stages {
                    let weight = weights[n * entries + stage * stages + other].to_f64();
                    let sample = samples[(k - n) * channels + group + other].to_f64();
                    let product = weight * sample;
                    error += weight.mul_add(sample, -product);
                    let next = sum + product;
                    let rounded = next - sum;
                    error += (sum - (next - rounded)) + (product - rounded);
                    sum = next;
                    absolute += product.abs();
                }
            }
            MemoryTerm { sum: sum + error, absolute }
        })
        .collect()
}
