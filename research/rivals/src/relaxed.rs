//! Relaxed multiplication of power series in blocks, one factor known.

use std::sync::Arc;

use fvi_core::{Memory, MemoryError, ParameterError, Stateful};
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealToComplex};

use crate::frame::{Frame, framed, leading_of};
use crate::operations::{Operations, real_transform};
use crate::partition::multiply_add;
use crate::product::product;

/// Number of blocks in a parent; each is transformed once for all blocks after it.
const ARITY: usize = 8;
/// Number of samples of a leaf, within which products are summed directly.
const LEAF: usize = 32;

/// Semi-relaxed product Σ w_n zⁿ · Σ x_k z^k by splitting in eight, with middle products and stored
/// transforms: O(log² N) a step, by a constant factor cheaper than binary splitting.
///
/// At level ℓ the time axis has blocks of B = 32·8^ℓ samples, eight to a parent. When block i of a parent
/// begins, the blocks j < i of this parent contribute to it through the lags (i−j−1)B + 1 … (i−j+1)B − 1,
/// whose spectra of length 2B are stored, as are those of the blocks. A sample contributes to a term at the
/// level at which the two lie in different blocks of the same parent.
///
/// Adjacent blocks are included: transforms mix lags from 1 to 2B − 1, hence errors are in proportion to the
/// norms, u log N ‖w‖₂‖x‖₂, not of each term.
///
/// Source: \[vdHoeven02\], \[vdHoeven14\]; the middle product instead of two products: \[vdHoeven03\].
pub struct RelaxedProduct {
    frame: Frame,
    /// w_{LEAF−1} … w_1
    near: Vec<f64>,
    levels: Vec<Level>,
    samples: Vec<Vec<f64>>,
    terms: Vec<Vec<f64>>,
    operations: Operations,
}

struct Level {
    block: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
    /// Spectra of the lags at distance 1, 2, … blocks, scaled.
    weights: Vec<Vec<Complex<f64>>>,
    /// For each channel the spectra of the blocks of the current parent.
    blocks: Vec<Vec<Vec<Complex<f64>>>>,
    scratch: Vec<Complex<f64>>,
    sum: Vec<Complex<f64>>,
    numbers: Vec<f64>,
}

impl Level {
    fn new(weights: &[f64], block: usize, blocks: usize, channels: usize) -> Self {
        let length = 2 * block;
        let (forward, inverse) = fvi_fft::real_transforms(length);
        let scratch = forward.get_scratch_len().max(inverse.get_scratch_len());
        let mut level = Self {
            block,
            weights: Vec::new(),
            blocks: vec![vec![forward.make_output_vec(); blocks - 1]; channels],
            scratch: vec![Complex::new(0.0, 0.0); scratch],
            sum: forward.make_output_vec(),
            numbers: vec![0.0; length],
            forward,
            inverse,
        };
        for distance in 1..blocks {
            for (index, number) in level.numbers.iter_mut().enumerate() {
                let weight = weights.get((distance - 1) * block + index);
                *number = weight.map_or(0.0, |weight| weight / length as f64);
            }
            let mut spectrum = level.forward.make_output_vec();
            level.transform(&mut spectrum);
            level.weights.push(spectrum);
        }
        level
    }

    fn transform(&mut self, spectrum: &mut [Complex<f64>]) {
        let scratch = &mut self.scratch[..self.forward.get_scratch_len()];
        // All lengths are those of the plan, so the transform cannot fail.
        let _ = self.forward.process_with_scratch(&mut self.numbers, spectrum, scratch);
    }

    /// Adds the contributions of the earlier blocks of its parent to the terms of the block that begins at
    /// `known`.
    #[inline(always)]
    fn advance(&mut self, known: usize, samples: &[Vec<f64>], terms: &mut [Vec<f64>], count: &Operations) {
        let block = self.block;
        let index = known / block % ARITY;
        if index == 0 || index > self.weights.len() {
            return;
        }
        for channel in 0..samples.len() {
            self.numbers[..block].copy_from_slice(&samples[channel][known - block..known]);
            self.numbers[block..].fill(0.0);
            let mut spectrum = std::mem::take(&mut self.blocks[channel][index - 1]);
            self.transform(&mut spectrum);
            self.blocks[channel][index - 1] = spectrum;
            self.sum.fill(Complex::new(0.0, 0.0));
            for before in 0..index {
                let weights = &self.weights[index - before - 1];
                multiply_add(&mut self.sum, &self.blocks[channel][before], weights);
            }
            self.sum[0].im = 0.0;
            self.sum[block].im = 0.0;
            let scratch = &mut self.scratch[..self.inverse.get_scratch_len()];
            let _ = self.inverse.process_with_scratch(&mut self.sum, &mut self.numbers, scratch);
            let to = terms[channel].len().min(known + block);
            for (term, number) in terms[channel][known..to].iter_mut().zip(&self.numbers[block..]) {
                *term += number;
            }
        }
        let products = 8 * index * (block + 1) + block;
        count.add(samples.len() * (2 * real_transform(2 * block) + products));
    }

    fn bytes(&self) -> usize {
        let spectra = self.weights.iter().chain(self.blocks.iter().flatten()).map(Vec::len).sum::<usize>();
        let complex = spectra + self.scratch.len() + self.sum.len();
        complex * size_of::<Complex<f64>>() + self.numbers.len() * size_of::<f64>()
    }
}

impl RelaxedProduct {
    /// For at most `capacity` samples; weights beyond the table are zero.
    ///
    /// # Errors
    /// If there is no weight, no channel or no capacity.
    pub fn new(weights: &[f64], channels: usize, capacity: usize) -> Result<Self, ParameterError> {
        let frame = Frame::new(channels, capacity, leading_of(weights)?)?;
        let mut levels = Vec::new();
        let mut block = LEAF;
        while block < capacity {
            levels.push(Level::new(weights, block, capacity.div_ceil(block).min(ARITY), channels));
            block *= ARITY;
        }
        let weight = |n: usize| weights.get(n).copied().unwrap_or(0.0);
        Ok(Self {
            frame,
            near: (1..LEAF).rev().map(weight).collect(),
            levels,
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

impl Memory<f64> for RelaxedProduct {
    framed!();

    #[inline(always)]
    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        self.frame.check(term)?;
        let k = self.frame.len;
        let lags = k % LEAF;
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
        let known = self.frame.len;
        if known == self.frame.capacity {
            return Ok(());
        }
        for level in &mut self.levels {
            if !known.is_multiple_of(level.block) {
                break;
            }
            level.advance(known, &self.samples, &mut self.terms, &self.operations);
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.frame.len = 0;
        self.samples.iter_mut().for_each(Vec::clear);
        self.terms.iter_mut().for_each(|row| row.fill(0.0));
        self.operations.clear();
    }

    fn bytes(&self) -> usize {
        let rows = self.samples.iter().chain(&self.terms).map(Vec::capacity).sum::<usize>();
        let levels = self.levels.iter().map(Level::bytes).sum::<usize>();
        size_of::<Self>() + (rows + self.near.len()) * size_of::<f64>() + levels
    }
}

impl Stateful for RelaxedProduct {}
