//! Memories for hosts: fast Fourier transforms, and exponential sums, in vector code.
#![forbid(unsafe_code)]

pub mod baseline;
mod block_fft;
mod chunked_exponential_sum;
mod cover;
mod lanes;
mod level;
mod near;
mod real_time;
mod replay;
mod row;
mod scalar;
mod transform;
mod weights;

pub use block_fft::BlockFft;
pub use chunked_exponential_sum::ChunkedExponentialSum;
pub use real_time::{Pacing, RealTime};
pub use scalar::Scalar;
pub use weights::{WeightTable, Weights};

/// The examples of the page that introduces the crate.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
