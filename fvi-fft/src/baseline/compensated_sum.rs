//! The memory term summed term by term with compensation: the reference for every engine.

use fvi_core::Real;

/// A sum in f64 that accumulates the rounding errors of its additions and products separately \[Knuth2\], as
/// if computed in twice the precision.
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
    fn what_large_numbers_hide_comes_back_when_they_go() {
        assert_eq!([1e16, 1.0, 1.0, -1e16].into_iter().collect::<CompensatedSum>().total(), 2.0);
        assert_eq!([1.0, 1e100, 1.0, -1e100].into_iter().collect::<CompensatedSum>().total(), 2.0);
        let mut sum = CompensatedSum::default();
        // (1 + 2⁻³⁰)² = 1 + 2⁻²⁹ + 2⁻⁶⁰
        let near_one = 1.0 + 2f64.powi(-30);
        sum.add_product(near_one, near_one);
        sum.add_product(-near_one, near_one);
        sum.add_product(near_one, near_one);
        sum.add(-1.0);
        sum.add(-2f64.powi(-29));
        assert_eq!(sum.total(), 2f64.powi(-60));
        let small: CompensatedSum = (0..1000).map(|_| 1e-20).collect();
        let mut sum = CompensatedSum::default();
        sum.add(1.0);
        (0..1000).for_each(|_| sum.add(1e-20));
        sum.add(-1.0);
        assert!((sum.total() / small.total() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_term_of_two_stages_by_hand() {
        // W₁ = (1 2; 3 −4), W₂ = (5 6; 7 8); x₀ = (1, −1), x₁ = (10, 100).
        let weights = [9.0, 9.0, 9.0, 9.0, 1.0, 2.0, 3.0, -4.0, 5.0, 6.0, 7.0, 8.0];
        let terms = memory_term(&weights, 2, &[1.0, -1.0, 10.0, 100.0], 2, 2);
        assert_eq!(terms.iter().map(|term| term.sum).collect::<Vec<_>>(), [209.0, -371.0]);
        assert_eq!(terms.iter().map(|term| term.absolute).collect::<Vec<_>>(), [221.0, 445.0]);
    }
}
