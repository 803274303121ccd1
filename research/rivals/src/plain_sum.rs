//! The sum itself, of all samples or of a window of them.

use fvi_core::{Memory, MemoryError, ParameterError, Stateful};

use crate::frame::{Frame, framed, leading_of};
use crate::operations::Operations;
use crate::product::product;

/// r_k = Σ_{n=1}^{min(k, L)} w_n x_{k−n} for weights w_0 … w_L: O(L) a step.
///
/// Samples are stored oldest first and multiplied with the reversed weights. Samples outside of the window
/// are removed only once their number has reached the length of the window, so that the copying per step is
/// O(1) on average.
#[derive(Clone, Debug)]
pub struct PlainSum {
    frame: Frame,
    /// w_L … w_1
    reversed: Vec<f64>,
    /// One row per channel.
    samples: Vec<Vec<f64>>,
    room: usize,
    operations: Operations,
}

impl PlainSum {
    /// For at most `capacity` samples; weights beyond the table are zero.
    ///
    /// # Errors
    /// If there is no weight, no channel or no capacity.
    pub fn new(weights: &[f64], channels: usize, capacity: usize) -> Result<Self, ParameterError> {
        let frame = Frame::new(channels, capacity, leading_of(weights)?)?;
        let lags = (weights.len() - 1).min(capacity.max(2) - 1);
        let room = (2 * lags).clamp(1, capacity);
        Ok(Self {
            frame,
            reversed: weights[1..=lags].iter().rev().copied().collect(),
            samples: (0..channels).map(|_| Vec::with_capacity(room)).collect(),
            room,
            operations: Operations::default(),
        })
    }

    /// The counter of its operations.
    pub fn operations(&self) -> Operations {
        self.operations.clone()
    }

    /// L, the largest lag.
    pub fn window(&self) -> usize {
        self.reversed.len()
    }
}

impl Memory<f64> for PlainSum {
    framed!();

    #[inline(always)]
    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        self.frame.check(term)?;
        let lags = self.reversed.len().min(self.frame.len);
        let weights = &self.reversed[self.reversed.len() - lags..];
        for (number, row) in term.iter_mut().zip(&self.samples) {
            *number = product(weights, &row[row.len() - lags..]);
        }
        self.operations.add(2 * lags * self.frame.channels);
        Ok(())
    }

    #[inline(always)]
    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.frame.check(sample)?;
        let lags = self.reversed.len();
        for (row, &number) in self.samples.iter_mut().zip(sample) {
            if row.len() == self.room {
                row.copy_within(self.room - lags.min(self.room).saturating_sub(1).., 0);
                row.truncate(lags.min(self.room).saturating_sub(1));
            }
            row.push(number);
        }
        self.frame.len += 1;
        Ok(())
    }

    fn clear(&mut self) {
        self.frame.len = 0;
        self.samples.iter_mut().for_each(Vec::clear);
        self.operations.clear();
    }

    fn bytes(&self) -> usize {
        let numbers = self.reversed.capacity() + self.samples.iter().map(Vec::capacity).sum::<usize>();
        size_of::<Self>() + numbers * size_of::<f64>()
    }
}

impl Stateful for PlainSum {}
