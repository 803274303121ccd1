//! Memories for hosts: fast Fourier transforms, and exponential sums, in vector code.
#![forbid(unsafe_code)]

pub mod baseline;
mod block_fft;
mod chunked_exponential_sum;
mod cover;
mod kernel;
mod lanes;
mod level;
mod near;
mod real_time;
mod row;
mod scalar;
mod transform;

pub use block_fft::BlockFft;
pub use chunked_exponential_sum::ChunkedExponentialSum;
pub use kernel::{Kernel, WeightTable};
pub use real_time::{Pacing, RealTime};
pub use scalar::Scalar;

/// The examples of the page that introduces the crate.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
