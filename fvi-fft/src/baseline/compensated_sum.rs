//! The memory term summed term by term with compensation: what every engine is compared with.

use fvi_core::Real;

/// A sum in f64 with the rounding errors of its additions and products gathered apart \[Knuth2\], as if
/// computed in twice the precision.
#[derive(Clone, Copy, Debug, Default)]
pub struct CompensatedSum {
    sum: f64,
    error: f64,
}

impl CompensatedSum {
    /// Adds a number.
    pub fn add(&mut self, number: f64) {
        let next = self.sum + number;
        let part = next - self.sum;
        self.error += (self.sum - (next - part)) + (number - part);
        self.sum = next;
    }

    /// Adds a product, split exactly by a fused multiply–add.
    pub fn add_product(&mut self, a: f64, b: f64) {
        let product = a * b;
        self.error += a.mul_add(b, -product);
        self.add(product);
    }

    /// The sum, rounded once.
    pub fn total(self) -> f64 {
        self.sum + self.error
    }
}

impl FromIterator<f64> for CompensatedSum {
    fn from_iter<I: IntoIterator<Item = f64>>(numbers: I) -> Self {
        let mut sum = Self::default();
        numbers.into_iter().for_each(|number| sum.add(number));
        sum
    }
}

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
/// The sums of sums and of errors are those of Ogita, Rump and Oishi.
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
