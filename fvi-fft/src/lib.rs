//! From a kernel K(s) to its fastest exact memory.
//!
//! | module | content |
//! |---|---|
//! | [`transfer`] | K(s) as a value: forms, formulas, series, creep and relaxation, multistep rules |
//! | [`quadrature`] | the weights of convolution quadrature for K, and starting weights |
//! | [`exponentials`] | the same weights as sums of exponentials, for steps of one or any length |
//! | [`memory`] | the one engine that serves a request: the only place that chooses |
//! | [`Aligned`] | storage for these tables |
#![forbid(unsafe_code)]

mod aligned;
#[doc(hidden)]
pub mod baseline;
#[doc(hidden)]
pub mod dense;
mod engines;
pub mod exponentials;
mod growing_ring;
pub mod memory;
pub mod quadrature;
#[doc(hidden)]
pub mod rational;
#[doc(hidden)]
pub mod sums;
pub mod transfer;

pub use aligned::Aligned;
pub use engines::{
    BlockFft, BoxedMemory, ChunkedExponentialSum, ComplexExponentialSum, ComplexExponentials, Convolver,
    Engines, ExchangeError, Exchanged, Pacing, PreparedResponses, Preparer, RealTime, Responses, Scalar,
    Stream, StreamError, VectorVariableSteps, Vectorised, WIDE_KERNELS, WeightTable, Weights,
    WideExponentialSum, real_transforms,
};
pub use growing_ring::GrowingRing;

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
