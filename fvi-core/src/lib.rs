//! Fractional variational integrators without `std` or allocation: schemes, convolution-quadrature weights
//! and memories, for `f32` and `f64`, from a host to a microcontroller.
#![no_std]
#![forbid(unsafe_code)]

mod memory;
mod real;

pub use memory::{Memory, MemoryError, check_channels};
pub use real::Real;
