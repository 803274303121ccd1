//! Fast-Fourier-transform memories for fractional variational integrators.
#![forbid(unsafe_code)]

pub mod baseline;
mod block_fft;
mod cover;
mod kernel;
mod lanes;
mod level;
mod near;
mod real_time;
mod scalar;
mod transform;

pub use block_fft::BlockFft;
pub use kernel::{Kernel, WeightTable};
pub use real_time::{Pacing, RealTime};
pub use scalar::Scalar;
