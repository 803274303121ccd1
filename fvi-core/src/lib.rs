//! Fractional variational integrators without `std` or allocation: schemes, convolution-quadrature weights
//! and memories, for `f32` and `f64`, from a host to a microcontroller.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod double_double;
mod error;
mod memory;
mod real;
mod weights;

pub use error::ParameterError;
pub use memory::{Memory, MemoryError, check_channels};
pub use real::Real;
pub use weights::{BdfOrder, ConvolutionWeights, leading_bdf_weight, monic_bdf_table, monic_bdf_table_f32};
