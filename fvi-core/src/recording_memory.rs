//! A memory for tests that records its samples.

use std::vec::Vec;

use crate::memory::{ActsOn, Memory, MemoryError, check_channels};
use crate::saving::Stateful;

/// A memory whose terms and leading weights are given numbers that do not depend on its samples.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RecordingMemory {
    pub(crate) stages: usize,
    /// S² numbers of each kernel.
    pub(crate) leading: Vec<f64>,
    pub(crate) leading_is_constant: bool,
    pub(crate) acts_on: ActsOn,
    /// One number for each channel and kernel.
    pub(crate) terms: Vec<f64>,
    /// Number of samples that it accepts.
    pub(crate) capacity: usize,
    pub(crate) samples: Vec<Vec<f64>>,
}

impl Memory<f64> for RecordingMemory {
    fn channels(&self) -> usize {
        self.terms.len() / self.kernels()
    }

    fn stages(&self) -> usize {
        self.stages
    }

    fn kernels(&self) -> usize {
        self.leading.len() / (self.stages * self.stages)
    }

    fn acts_on(&self) -> ActsOn {
        self.acts_on
    }

    fn leading(&self) -> &[f64] {
        &self.leading
    }

    fn leading_is_constant(&self) -> bool {
        self.leading_is_constant
    }

    fn len(&self) -> usize {
        self.samples.len()
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        check_channels(self.terms.len(), term.len())?;
        term.copy_from_slice(&self.terms);
        self.check_capacity()
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        check_channels(self.channels(), sample.len())?;
        self.check_capacity()?;
        self.samples.push(sample.to_vec());
        Ok(())
    }

    fn clear(&mut self) {
        self.samples.clear();
    }

    fn bytes(&self) -> usize {
        0
    }
}

impl Stateful for RecordingMemory {}

impl RecordingMemory {
    fn check_capacity(&self) -> Result<(), MemoryError> {
        let full = MemoryError::Full { capacity: self.capacity };
        if self.samples.len() < self.capacity { Ok(()) } else { Err(full) }
    }
}
