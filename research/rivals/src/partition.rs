//! Partitioned convolution: the weights in blocks, each with a transform of its own length.

use std::sync::Arc;

use fvi_core::{Memory, MemoryError, ParameterError, Stateful};
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealToComplex};

use crate::frame::{Frame, framed, leading_of};
use crate::operations::{Operations, real_transform};
use crate::product::product;

/// Blocks of weights of one size B behind lag `first`, and the spectra of the last windows of samples.
///
/// A window is the last 2B samples before a time that is a multiple of B. Part p has the lags from first + pB
/// on; the window that ends at t contributes to the B terms from t − B + first + pB on (overlap–save: the
/// second half of the cyclic product is that of the sequences). Parts of one time share an inverse transform,
/// windows are transformed once (frequency-domain delay line).
struct Segment {
    block: usize,
    first: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
    /// For each part the spectrum of its weights, scaled.
    weights: Vec<Vec<Complex<f64>>>,
    /// For each channel the spectra of the last windows, as many as parts, in a ring buffer.
    windows: Vec<Vec<Vec<Complex<f64>>>>,
    newest: usize,
    scratch: Vec<Complex<f64>>,
    sum: Vec<Complex<f64>>,
    numbers: Vec<f64>,
}

impl Segment {
    fn new(weights: &[f64], block: usize, first: usize, parts: usize, channels: usize) -> Self {
        let (forward, inverse) = fvi_fft::real_transforms(2 * block);
        let scratch = forward.get_scratch_len().max(inverse.get_scratch_len());
        let mut segment = Self {
            block,
            first,
            weights: Vec::new(),
            windows: vec![vec![forward.make_output_vec(); parts]; channels],
            newest: 0,
            scratch: vec![Complex::new(0.0, 0.0); scratch],
            sum: forward.make_output_vec(),
            numbers: vec![0.0; 2 * block],
            forward,
            inverse,
        };
        for part in 0..parts {
            let from = (first + part * block).min(weights.len());
            let known = &weights[from..weights.len().min(from + block)];
            segment.numbers.fill(0.0);
            for (number, weight) in segment.numbers.iter_mut().zip(known) {
                *number = weight / (2 * block) as f64;
            }
            let mut spectrum = segment.forward.make_output_vec();
            segment.transform(&mut spectrum);
            segment.weights.push(spectrum);
        }
        segment
    }

    /// Writes the spectrum of `numbers`.
    fn transform(&mut self, spectrum: &mut [Complex<f64>]) {
        let scratch = &mut self.scratch[..self.forward.get_scratch_len()];
        // All lengths are those of the plan, so the transform cannot fail.
        let _ = self.forward.process_with_scratch(&mut self.numbers, spectrum, scratch);
    }

    /// Transforms the window that ends with the newest sample of every channel, and adds its contributions to
    /// the terms.
    #[inline(always)]
    fn advance(&mut self, samples: &[Vec<f64>], terms: &mut [Vec<f64>], operations: &Operations) {
        let parts = self.weights.len();
        self.newest = (self.newest + parts - 1) % parts;
        let length = 2 * self.block;
        for channel in 0..samples.len() {
            let row = &samples[channel];
            let missing = length.saturating_sub(row.len());
            self.numbers[..missing].fill(0.0);
            self.numbers[missing..].copy_from_slice(&row[row.len() - (length - missing)..]);
            let mut spectrum = std::mem::take(&mut self.windows[channel][self.newest]);
            self.transform(&mut spectrum);
            self.windows[channel][self.newest] = spectrum;

            let from = row.len() - self.block + self.first;
            let to = terms[channel].len().min(from + self.block);
            if from >= to {
                continue;
            }
            self.sum.fill(Complex::new(0.0, 0.0));
            for (part, weights) in self.weights.iter().enumerate() {
                let window = &self.windows[channel][(self.newest + part) % parts];
                multiply_add(&mut self.sum, window, weights);
            }
            // Rounding leaves small imaginary parts in the first and last value, which a real transform
            // requires to be real.
            self.sum[0].im = 0.0;
            self.sum[self.block].im = 0.0;
            let scratch = &mut self.scratch[..self.inverse.get_scratch_len()];
            let _ = self.inverse.process_with_scratch(&mut self.sum, &mut self.numbers, scratch);
            for (term, number) in terms[channel][from..to].iter_mut().zip(&self.numbers[self.block..]) {
                *term += number;
            }
        }
        let products = 8 * parts * (self.block + 1) + self.block;
        operations.add(samples.len() * (2 * real_transform(length) + products));
    }

    fn clear(&mut self) {
        let zero = Complex::new(0.0, 0.0);
        self.windows.iter_mut().flatten().for_each(|spectrum| spectrum.fill(zero));
    }

    fn bytes(&self) -> usize {
        let complex = self.weights.iter().chain(self.windows.iter().flatten()).map(Vec::len).sum::<usize>()
            + self.scratch.len()
            + self.sum.len();
        complex * size_of::<Complex<f64>>() + self.numbers.len() * size_of::<f64>()
    }
}

/// sum += a·b
#[inline(always)]
pub(crate) fn multiply_add(sum: &mut [Complex<f64>], a: &[Complex<f64>], b: &[Complex<f64>]) {
    for ((sum, a), b) in sum.iter_mut().zip(a).zip(b) {
        sum.re += a.re * b.re - a.im * b.im;
        sum.im += a.re * b.im + a.im * b.re;
    }
}

/// A partition of the weights: small lags summed directly, the others in segments that are evaluated at
/// multiples of their block size.
pub struct PartitionedSum {
    frame: Frame,
    /// w_D … w_1
    near: Vec<f64>,
    segments: Vec<Segment>,
    samples: Vec<Vec<f64>>,
    terms: Vec<Vec<f64>>,
    operations: Operations,
}

impl PartitionedSum {
    fn new(
        weights: &[f64],
        channels: usize,
        capacity: usize,
        near: usize,
        segments: Vec<Segment>,
    ) -> Result<Self, ParameterError> {
        let frame = Frame::new(channels, capacity, leading_of(weights)?)?;
        let weight = |n: usize| weights.get(n).copied().unwrap_or(0.0);
        Ok(Self {
            frame,
            near: (1..=near).rev().map(weight).collect(),
            segments,
            samples: (0..channels).map(|_| Vec::with_capacity(capacity)).collect(),
            terms: vec![vec![0.0; capacity]; channels],
            operations: Operations::default(),
        })
    }

    /// The counter of its operations.
    pub fn operations(&self) -> Operations {
        self.operations.clone()
    }
}

impl Memory<f64> for PartitionedSum {
    framed!();

    #[inline(always)]
    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        self.frame.check(term)?;
        let k = self.frame.len;
        let lags = self.near.len().min(k);
        let weights = &self.near[self.near.len() - lags..];
        for ((number, samples), terms) in term.iter_mut().zip(&self.samples).zip(&self.terms) {
            *number = terms[k] + product(weights, &samples[k - lags..]);
        }
        self.operations.add(2 * lags * self.frame.channels);
        Ok(())
    }

    #[inline(always)]
    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.frame.check(sample)?;
        for (row, &number) in self.samples.iter_mut().zip(sample) {
            row.push(number);
        }
        self.frame.len += 1;
        for segment in &mut self.segments {
            if self.frame.len.is_multiple_of(segment.block) {
                segment.advance(&self.samples, &mut self.terms, &self.operations);
            }
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.frame.len = 0;
        self.samples.iter_mut().for_each(Vec::clear);
        self.terms.iter_mut().for_each(|row| row.fill(0.0));
        self.segments.iter_mut().for_each(Segment::clear);
        self.operations.clear();
    }

    fn bytes(&self) -> usize {
        let rows = self.samples.iter().chain(&self.terms).map(Vec::capacity).sum::<usize>();
        let segments = self.segments.iter().map(Segment::bytes).sum::<usize>();
        size_of::<Self>() + (rows + self.near.len()) * size_of::<f64>() + segments
    }
}

impl Stateful for PartitionedSum {}

/// Equal blocks of B weights behind B − 1 lags that are summed directly: O(√N) a step with B ≈ 2√N.
///
/// B is the power of two with the fewest operations for the capacity; spectra of samples lie in a
/// frequency-domain delay line, so that a block of samples costs one forward and one inverse transform.
///
/// Source: \[Wefers15\], chapter 5; \[Gardner95\].
///
/// For at most `capacity` samples; weights beyond the table are zero.
///
/// # Errors
/// If there is no weight, no channel or no capacity.
pub fn uniform_partition(
    weights: &[f64],
    channels: usize,
    capacity: usize,
) -> Result<PartitionedSum, ParameterError> {
    let lags = weights.len().min(capacity);
    let parts = |block: usize| lags.saturating_sub(block).div_ceil(block);
    let cost =
        |block: usize| 2 * block + (2 * real_transform(2 * block) + 8 * parts(block) * (block + 1)) / block;
    let block = (4..24).map(|power| 1 << power).min_by_key(|&block| cost(block)).unwrap_or(16);
    let segments = match parts(block) {
        0 => Vec::new(),
        parts => vec![Segment::new(weights, block, block, parts, channels)],
    };
    PartitionedSum::new(weights, channels, capacity, block - 1, segments)
}

/// Gardner's partition, designed for an even load: 2B − 1 lags summed directly, then two blocks each of B,
/// 2B, 4B … weights, of which one of size B begins at lag 2B: O(log² N) a step.
///
/// With this layout a block of samples can be transformed while the next one arrives; here the work is done
/// at once when a block is complete, without a scheduler. B = 32.
///
/// Source: \[Gardner95\].
///
/// For at most `capacity` samples; weights beyond the table are zero.
///
/// # Errors
/// If there is no weight, no channel or no capacity.
pub fn non_uniform_partition(
    weights: &[f64],
    channels: usize,
    capacity: usize,
) -> Result<PartitionedSum, ParameterError> {
    let lags = weights.len().min(capacity);
    let blocks = (0..).map(|level| SMALLEST << level).take_while(|block| 2 * block < lags);
    let segments = blocks.map(|block| Segment::new(weights, block, 2 * block, 2, channels)).collect();
    PartitionedSum::new(weights, channels, capacity, 2 * SMALLEST - 1, segments)
}

/// Smallest block of [`non_uniform_partition`].
const SMALLEST: usize = 32;
