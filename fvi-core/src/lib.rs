//! Fractional variational integrators without `std` or allocation: schemes, convolution-quadrature weights
//! and memories, for `f32` and `f64`, from a host to a microcontroller.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod direct;
mod double_double;
mod error;
mod memory;
mod operator;
mod real;
mod weighted_sum;
mod weights;

pub use direct::{Direct, FixedDirect, MAX_STAGES, Overflow, Ring};
pub use error::ParameterError;
pub use memory::{Memory, MemoryError, check_channels};
pub use operator::{FractionalOperator, OperatorError, Start, left_operator, right_operator};
pub use real::Real;
pub use weights::{BdfOrder, ConvolutionWeights, leading_bdf_weight, monic_bdf_table, monic_bdf_table_f32};
