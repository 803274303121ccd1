//! Why a block or an exchange is refused.

use thiserror::Error;

use crate::engines::scalar::Scalar;
use crate::engines::stream::prepared::PreparedResponses;

/// Reason why a block of a stream was not processed; the convolver is then unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum StreamError {
    /// The number of inputs or outputs is not that of the responses.
    #[error("{found} {what} where the responses have {expected}")]
    Channels {
        /// `"inputs"` or `"outputs"`.
        what: &'static str,
        /// Their number in the responses.
        expected: usize,
        /// Their number in the call.
        found: usize,
    },
    /// A channel is not as long as the first input.
    #[error("channel {channel} of the {what} has {found} samples where the first input has {expected}")]
    Samples {
        /// `"inputs"` or `"outputs"`.
        what: &'static str,
        /// The channel.
        channel: usize,
        /// Samples of the first input.
        expected: usize,
        /// Samples of the channel.
        found: usize,
    },
    /// A sample is infinite or not a number.
    #[error("sample {sample} of input {channel} is not finite")]
    NotFinite {
        /// The input.
        channel: usize,
        /// Index of the sample in the block.
        sample: usize,
    },
}

/// Reason why responses were not exchanged, with the new ones, which can be used again; the convolver is
/// unchanged.
#[derive(Error)]
#[non_exhaustive]
pub enum ExchangeError<T: Scalar> {
    /// The last exchange has not ended.
    #[error("the last exchange ends in {left} samples")]
    Busy {
        /// Samples until it ends.
        left: u64,
        /// The new responses.
        responses: PreparedResponses<T>,
    },
    /// They were prepared for a convolver of another shape or partition.
    #[error("the responses were prepared for another convolver")]
    Foreign {
        /// The new responses.
        responses: PreparedResponses<T>,
    },
}

impl<T: Scalar> ExchangeError<T> {
    /// The new responses.
    pub fn into_responses(self) -> PreparedResponses<T> {
        match self {
            Self::Busy { responses, .. } | Self::Foreign { responses } => responses,
        }
    }
}

impl<T: Scalar> core::fmt::Debug for ExchangeError<T> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Busy { left, .. } => f.debug_struct("Busy").field("left", left).finish_non_exhaustive(),
            Self::Foreign { .. } => f.debug_struct("Foreign").finish_non_exhaustive(),
        }
    }
}
