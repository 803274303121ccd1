//! Memories for hosts: fast Fourier transforms, and exponential sums, in vector code.
#![forbid(unsafe_code)]

pub mod baseline;
mod block_fft;
mod chunked_exponential_sum;
mod complex_exponential_sum;
mod cover;
mod engines;
mod lanes;
mod level;
#[cfg(test)]
mod memory_tests;
mod near;
mod plans;
mod real_time;
mod replay;
mod row;
mod scalar;
mod table_kernel;
mod transform;
mod vector_variable_steps;
mod vectorised;
mod weights;
mod wide_exponential_sum;

pub use block_fft::BlockFft;
pub use chunked_exponential_sum::ChunkedExponentialSum;
pub use complex_exponential_sum::{ComplexExponentialSum, ComplexExponentials};
pub use engines::{Engine, Engines};
pub use plans::real_transforms;
pub use real_time::{Pacing, RealTime};
pub use scalar::Scalar;
pub use vector_variable_steps::VectorVariableSteps;
pub use vectorised::Vectorised;
pub use weights::{WeightTable, Weights};
pub use wide_exponential_sum::{WIDE_KERNELS, WideExponentialSum};

/// Name of what the last bits of these memories depend on besides their input: the processor's family, and
/// whether its vector units have fused multiply–adds.
pub fn vector_units() -> &'static str {
    match (cfg!(target_arch = "x86_64"), cfg!(target_arch = "aarch64"), pulp::Arch::new()) {
        (true, _, pulp::Arch::Scalar) => "x86-64 without fused multiply–add",
        (true, _, _) => "x86-64 with fused multiply–add",
        (_, true, pulp::Arch::Scalar) => "ARM64 without fused multiply–add",
        (_, true, _) => "ARM64 with fused multiply–add",
        (_, _, pulp::Arch::Scalar) => "no vector units",
        _ => "other vector units",
    }
}

/// The examples of the page that introduces the crate.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
