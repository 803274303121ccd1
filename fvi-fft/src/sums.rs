//! Sums and largest numbers that lose nothing on the way.

pub use fvi_core::{max_or_nan, min_or_nan};

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
}
