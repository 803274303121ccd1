//! Correlations of signals that are known in full.

use crate::engines::plans::real_transforms;
use realfft::{ComplexToReal, RealToComplex};
use rustfft::num_complex::Complex;
use std::sync::Arc;

/// Correlations of the stages of two signals, summed over their channels:
///
/// ```text
/// C_l[i, j] = Σ_channels Σ_{m ≥ l} a_{m,i} x_{m−l,j} ,      l = 0 … length − 1 .
/// ```
///
/// By transforms of twice the length, so that an error is relative to the largest number.
pub struct Correlation {
    length: usize,
    stages: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
    /// Spectra of C[i, j], row by row.
    sums: Vec<Vec<Complex<f64>>>,
}

impl Correlation {
    /// Zero, for signals of so many samples with so many stages.
    pub fn new(length: usize, stages: usize) -> Self {
        let (forward, inverse) = real_transforms((2 * length.max(1)).next_power_of_two());
        let sums = vec![forward.make_output_vec(); stages * stages];
        Self { length, stages, forward, inverse, sums }
    }

    /// Adds a channel: a and x, each stage a sequence of `length` numbers or fewer, zero behind them.
    pub fn add(&mut self, a: &[Vec<f64>], x: &[Vec<f64>]) {
        let (a, x) = (self.spectra(a), self.spectra(x));
        for (i, a) in a.iter().enumerate() {
            for (j, x) in x.iter().enumerate() {
                let sum = &mut self.sums[i * self.stages + j];
                sum.iter_mut().zip(a.iter().zip(x)).for_each(|(sum, (a, x))| *sum += a * x.conj());
            }
        }
    }

    fn spectra(&self, stages: &[Vec<f64>]) -> Vec<Vec<Complex<f64>>> {
        let mut padded = self.forward.make_input_vec();
        let spectrum = |stage: &Vec<f64>| {
            padded.fill(0.0);
            padded.iter_mut().zip(stage).for_each(|(place, &number)| *place = number);
            let mut spectrum = self.forward.make_output_vec();
            // Lengths fit.
            let _ = self.forward.process(&mut padded, &mut spectrum);
            spectrum
        };
        stages.iter().map(spectrum).collect()
    }

    /// C, plane by plane: C_l[i, j] is at (i·R + j)·length + l.
    pub fn planes(self) -> Vec<f64> {
        let mut numbers = self.inverse.make_output_vec();
        let scale = 1.0 / numbers.len() as f64;
        let mut planes = Vec::with_capacity(self.sums.len() * self.length);
        for mut sum in self.sums {
            // Spectra of real signals are real at both ends, up to rounding.
            for end in [0, sum.len() - 1] {
                sum[end].im = 0.0;
            }
            let _ = self.inverse.process(&mut sum, &mut numbers);
            planes.extend(numbers[..self.length].iter().map(|number| number * scale));
        }
        planes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_double_sum() {
        let (length, stages) = (13, 2);
        let signal = |seed: usize| -> Vec<Vec<f64>> {
            let number = |m: usize| ((seed * 31 + m * 17) % 23) as f64 - 11.0;
            (0..stages).map(|i| (0..length).map(|m| number(m + 5 * i)).collect()).collect()
        };
        let mut found = Correlation::new(length, stages);
        let channels = [(signal(1), signal(2)), (signal(3), signal(4))];
        channels.iter().for_each(|(a, x)| found.add(a, x));
        let found = found.planes();
        for i in 0..stages {
            for j in 0..stages {
                for l in 0..length {
                    let of = |(a, x): &(Vec<Vec<f64>>, Vec<Vec<f64>>)| -> f64 {
                        (l..length).map(|m| a[i][m] * x[j][m - l]).sum()
                    };
                    let expected: f64 = channels.iter().map(of).sum();
                    let found = found[(i * stages + j) * length + l];
                    assert!((found - expected).abs() < 1e-10, "{i}, {j}, {l}: {found}, not {expected}");
                }
            }
        }
    }
}
