//! Fast online convolution in its textbook form.

use fvi_core::{Memory, MemoryError, ParameterError, Stateful, check_channels};
use rustfft::num_complex::Complex;

use crate::engines::plans::Plans;
use crate::engines::weights::{Weights, check_shape, take_planes};

/// Binary splitting with three complex transforms per block and nothing cached between blocks: O(log² k) a
/// step.
///
/// When t samples are known and 2ⁱ is the largest power of two that divides t, the last 2ⁱ samples are
/// convolved with the lags 1 … 2ⁱ⁺¹ − 1 and added to the next 2ⁱ terms. Blocks of at most 32 samples are
/// summed directly.
///
/// Near and far lags share a transform, so that small terms get the rounding errors of large ones: on
/// decaying signals the result is not exact to rounding.
///
/// Source: \[HLS\].
pub struct Hls {
    stages: usize,
    capacity: usize,
    leading: Vec<f64>,
    /// For each entry of the matrices, row by row, its weights.
    planes: Vec<Vec<f64>>,
    /// All samples, one row per channel.
    signal: Vec<Vec<f64>>,
    /// Memory terms as far as they are known, one row per channel.
    terms: Vec<Vec<f64>>,
    plans: Plans,
    samples: Vec<Complex<f64>>,
    weights: Vec<Complex<f64>>,
}

/// Largest block that is summed directly.
const DIRECT: usize = 32;

impl Hls {
    /// A memory for at most `capacity` samples.
    ///
    /// # Errors
    /// If `channels` is zero or no multiple of the kernel's stages.
    pub fn planned(
        mut kernel: impl Weights<f64>,
        channels: usize,
        capacity: usize,
    ) -> Result<Self, ParameterError> {
        let stages = check_shape(&kernel, channels)?;
        let planes = take_planes(&mut kernel, capacity.max(1));
        Ok(Self {
            stages,
            capacity,
            leading: planes.iter().map(|plane| plane[0]).collect(),
            planes,
            signal: (0..channels).map(|_| Vec::with_capacity(capacity)).collect(),
            terms: vec![vec![0.0; capacity]; channels],
            plans: Plans::new(),
            samples: Vec::new(),
            weights: Vec::new(),
        })
    }

    fn check_capacity(&self) -> Result<(), MemoryError> {
        if self.len() < self.capacity { Ok(()) } else { Err(MemoryError::Full { capacity: self.capacity }) }
    }

    /// Adds the block of samples that ends at `known` of one channel to the terms of another through one
    /// plane.
    fn add_block(&mut self, plane: usize, source: usize, target: usize, known: usize, block: usize) {
        let samples = &self.signal[source][known - block..known];
        let weights = &self.planes[plane];
        let terms = &mut self.terms[target][known..self.capacity.min(known + block)];
        if block <= DIRECT {
            for (i, term) in terms.iter_mut().enumerate() {
                for (j, &sample) in samples.iter().enumerate() {
                    *term += weights[block + i - j] * sample;
                }
            }
            return;
        }
        let length = 2 * block;
        let zero = Complex::new(0.0, 0.0);
        let complex = |&number: &f64| Complex::new(number, 0.0);
        self.samples.clear();
        self.samples.extend(samples.iter().map(complex));
        self.samples.resize(length, zero);
        self.weights.clear();
        self.weights.extend(weights.iter().take(length).map(complex));
        self.weights.resize(length, zero);
        let plan = self.plans.plan(length);
        plan.forward.process(&mut self.samples);
        plan.forward.process(&mut self.weights);
        let scale = 1.0 / length as f64;
        for (sample, weight) in self.samples.iter_mut().zip(&self.weights) {
            *sample = *sample * *weight * scale;
        }
        plan.inverse.process(&mut self.samples);
        for (term, sum) in terms.iter_mut().zip(&self.samples[block..]) {
            *term += sum.re;
        }
    }
}

impl Memory<f64> for Hls {
    fn channels(&self) -> usize {
        self.signal.len()
    }

    fn stages(&self) -> usize {
        self.stages
    }

    fn leading(&self) -> &[f64] {
        &self.leading
    }

    fn len(&self) -> usize {
        self.signal[0].len()
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        check_channels(self.channels(), term.len())?;
        self.check_capacity()?;
        let k = self.len();
        for (number, row) in term.iter_mut().zip(&self.terms) {
            *number = row[k];
        }
        Ok(())
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        check_channels(self.channels(), sample.len())?;
        self.check_capacity()?;
        for (row, &number) in self.signal.iter_mut().zip(sample) {
            row.push(number);
        }
        let known = self.len();
        let block = 1 << known.trailing_zeros();
        if known == self.capacity {
            return Ok(());
        }
        for channel in 0..self.channels() {
            let (stage, group) = (channel % self.stages, channel - channel % self.stages);
            for other in 0..self.stages {
                self.add_block(stage * self.stages + other, group + other, channel, known, block);
            }
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.signal.iter_mut().for_each(Vec::clear);
        self.terms.iter_mut().for_each(|row| row.fill(0.0));
    }

    fn bytes(&self) -> usize {
        let rows =
            |rows: &[Vec<f64>]| rows.iter().map(|row| row.capacity() * size_of::<f64>()).sum::<usize>();
        let complex = [&self.samples, &self.weights].map(Vec::capacity).iter().sum::<usize>();
        let complex = complex * size_of::<Complex<f64>>();
        size_of::<Self>() + rows(&self.planes) + rows(&self.signal) + rows(&self.terms) + complex
    }
}

impl Stateful for Hls {}
