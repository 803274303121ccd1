//! The textbook's fast online convolution, with counted operations.

use fvi_core::{Memory, MemoryError, ParameterError, Stateful};
use fvi_fft::WeightTable;
use fvi_fft::baseline::Hls;

use crate::operations::Operations;

/// Binary splitting with three complex transforms per block and no spectra stored between blocks \[HLS\]: the
/// baseline of `fvi-fft` with its operations counted.
pub struct TextbookHls {
    memory: Hls,
    capacity: usize,
    operations: Operations,
}

/// Largest block that the baseline sums directly.
const DIRECT: usize = 32;

impl TextbookHls {
    /// For at most `capacity` samples; weights beyond the table are zero.
    ///
    /// # Errors
    /// If there is no channel.
    pub fn new(weights: &[f64], channels: usize, capacity: usize) -> Result<Self, ParameterError> {
        let memory = Hls::planned(WeightTable::scalars(weights), channels, capacity)?;
        Ok(Self { memory, capacity, operations: Operations::default() })
    }

    /// The counter of its operations.
    pub fn operations(&self) -> Operations {
        self.operations.clone()
    }
}

impl Memory<f64> for TextbookHls {
    fn channels(&self) -> usize {
        self.memory.channels()
    }

    fn leading(&self) -> &[f64] {
        self.memory.leading()
    }

    fn len(&self) -> usize {
        self.memory.len()
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        self.memory.next_term(term)
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.memory.push(sample)?;
        let known = self.memory.len();
        if known < self.capacity {
            let block = 1usize << known.trailing_zeros();
            let length = 2 * block;
            let operations = if block <= DIRECT {
                2 * block * block.min(self.capacity - known)
            } else {
                // Three complex transforms, products with a scale, and the sum.
                3 * 5 * length * length.trailing_zeros() as usize + 8 * length + block
            };
            self.operations.add(operations * self.memory.channels());
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.memory.clear();
        self.operations.clear();
    }

    fn bytes(&self) -> usize {
        self.memory.bytes()
    }
}

impl Stateful for TextbookHls {}
