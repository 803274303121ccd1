#![doc = include_str!("../README.md")]
//!
//! Each counts its floating-point operations ([`Operations`]). A memory wrapped by [`vectorised`] runs with
//! the widest vectors of the processor, as the memories of `fvi-fft` do.
//!
//! | strategy | cost of a step | what it serves |
//! |---|---|---|
//! | [`PlainSum`] | O(N) | any weights; a window of them is the short-memory principle |
//! | [`TextbookHls`] | O(log² N) | any weights |
//! | [`PartitionedSum`] | O(√N), O(log² N) | any weights ([`uniform_partition`], [`non_uniform_partition`]) |
//! | [`RelaxedProduct`] | O(log² N) | any weights |
//! | [`FilterCascade`] | O(poles) | s^β, as a rational function ([`oustaloup`], [`matsuda`]) |
//! | [`ExponentialModes`] | O(log N) | s^β by the L1 formula ([`jiang`], [`kernel_compression`]) |
//! | [`ObliviousQuadrature`] | O(log N) | K(s) with singularities on the negative real axis, BDF of order 1 |
//!
//! [`FixedStep`] has the literature's methods for fractional differential equations on such sums.
#![forbid(unsafe_code)]

mod claims;
mod dyadic_exponentials;
mod exponential_modes;
mod filter_cascade;
mod fixed_step;
mod fractional_equation;
mod frame;
mod gauss_jacobi;
mod growth;
mod jiang;
mod kernel_compression;
mod l1;
mod matsuda;
mod oblivious;
mod operations;
mod oustaloup;
mod partition;
mod plain_sum;
mod product;
mod relaxed;
mod short_memory;
mod textbook_hls;

pub use claims::{Claim, Relation, claims};
pub use exponential_modes::ExponentialModes;
pub use filter_cascade::{FilterCascade, Section};
pub use fixed_step::FixedStep;
pub use fractional_equation::{EquationError, FractionalEquation, Function};
pub use fvi_fft::Vectorised;
pub use growth::{Growth, fitted_exponent, growths};
pub use jiang::jiang;
pub use kernel_compression::kernel_compression;
pub use l1::l1_weights;
pub use matsuda::matsuda;
pub use oblivious::ObliviousQuadrature;
pub use operations::Operations;
pub use oustaloup::oustaloup;
pub use partition::{PartitionedSum, non_uniform_partition, uniform_partition};
pub use plain_sum::PlainSum;
pub use relaxed::RelaxedProduct;
pub use short_memory::{short_memory, window_of};
pub use textbook_hls::TextbookHls;

/// Wraps a memory so that its calls are compiled for every vector unit, with the best available one selected
/// at run time.
pub fn vectorised<M: fvi_core::Memory<f64> + Send + 'static>(
    memory: M,
) -> Box<dyn fvi_core::Memory<f64> + Send> {
    Box::new(Vectorised::new(memory))
}
