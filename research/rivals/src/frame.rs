//! Checks common to all memories of this crate.

use fvi_core::{MemoryError, ParameterError, check_channels};

/// Channels, capacity and number of samples of a memory, and its leading weight.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub(crate) channels: usize,
    pub(crate) capacity: usize,
    pub(crate) len: usize,
    pub(crate) leading: [f64; 1],
}

impl Frame {
    pub(crate) fn new(channels: usize, capacity: usize, leading: f64) -> Result<Self, ParameterError> {
        let refused = |parameter, value: usize| {
            Err(ParameterError { parameter, value: value as f64, allowed: "at least 1" })
        };
        if channels == 0 {
            return refused("channels", channels);
        }
        if capacity == 0 {
            return refused("capacity", capacity);
        }
        Ok(Self { channels, capacity, len: 0, leading: [leading] })
    }

    /// Checks the number of channels, and that the capacity is not exhausted.
    #[inline(always)]
    pub(crate) fn check(&self, numbers: &[f64]) -> Result<(), MemoryError> {
        check_channels(self.channels, numbers.len())?;
        if self.len < self.capacity { Ok(()) } else { Err(MemoryError::Full { capacity: self.capacity }) }
    }
}

/// Methods of [`Memory`](fvi_core::Memory) that only return values of the field `frame`.
macro_rules! framed {
    () => {
        fn channels(&self) -> usize {
            self.frame.channels
        }

        fn leading(&self) -> &[f64] {
            &self.frame.leading
        }

        fn len(&self) -> usize {
            self.frame.len
        }
    };
}

pub(crate) use framed;

/// The leading weight w_0; an error if there are no weights.
pub(crate) fn leading_of(weights: &[f64]) -> Result<f64, ParameterError> {
    weights.first().copied().ok_or(ParameterError {
        parameter: "number of weights",
        value: 0.0,
        allowed: "at least 1",
    })
}
