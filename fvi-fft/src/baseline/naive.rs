//! The plain double sum.

use fvi_core::{Memory, MemoryError, ParameterError, Stateful, check_channels};

use crate::engines::weights::{Weights, check_shape, take_planes};

/// r_k = Σ_{n=1}^{k} W_n x_{k−n}, summed in this order with one accumulator a channel: O(k) a step.
#[derive(Clone, Debug)]
pub struct Naive {
    stages: usize,
    capacity: usize,
    leading: Vec<f64>,
    /// For each entry of the matrices, row by row, its weights.
    planes: Vec<Vec<f64>>,
    /// All samples, one row per channel.
    signal: Vec<Vec<f64>>,
}

impl Naive {
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
        })
    }

    fn check_capacity(&self) -> Result<(), MemoryError> {
        if self.len() < self.capacity { Ok(()) } else { Err(MemoryError::Full { capacity: self.capacity }) }
    }
}

impl Memory<f64> for Naive {
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
        for (channel, number) in term.iter_mut().enumerate() {
            let (stage, group) = (channel % self.stages, channel - channel % self.stages);
            *number = 0.0;
            for other in 0..self.stages {
                let weights = &self.planes[stage * self.stages + other][1..];
                for (&sample, &weight) in self.signal[group + other].iter().rev().zip(weights) {
                    *number += weight * sample;
                }
            }
        }
        Ok(())
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        check_channels(self.channels(), sample.len())?;
        self.check_capacity()?;
        for (row, &number) in self.signal.iter_mut().zip(sample) {
            row.push(number);
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.signal.iter_mut().for_each(Vec::clear);
    }

    fn bytes(&self) -> usize {
        let rows =
            |rows: &[Vec<f64>]| rows.iter().map(|row| row.capacity() * size_of::<f64>()).sum::<usize>();
        size_of::<Self>() + size_of_val(self.leading.as_slice()) + rows(&self.planes) + rows(&self.signal)
    }
}

impl Stateful for Naive {}
