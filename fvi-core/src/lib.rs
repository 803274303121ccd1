//! Fractional variational integrators without `std` or allocation: schemes, convolution-quadrature weights
//! and memories, for `f32` and `f64`, from a host to a microcontroller.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod damping;
mod direct;
mod double_double;
mod error;

mod euler;
mod exponential_sum;
mod galerkin;
mod integrator;
mod linear;
mod memory;
mod newton;
#[cfg(test)]
mod noise;
mod operator;
mod quadrature;
mod real;
mod runge_kutta;
mod scheme;
mod stability;
mod system;
mod tiled;
mod weighted_sum;
mod weights;

pub use damping::{AffineForce, Damping, DampingError, DampingTerm, Derivative, MemoryShape};
pub use direct::{Direct, FixedDirect, MAX_STAGES, Overflow, Ring};
pub use error::ParameterError;
pub use euler::{ExplicitEuler, ImplicitEuler};
pub use exponential_sum::{ExponentialSum, ExponentialTable, ExponentialTerm};
pub use galerkin::Galerkin;
pub use integrator::{Integrator, IntegratorError, State};
pub use memory::{Memory, MemoryError, check_channels};
pub use operator::{FractionalOperator, OperatorError, Start, left_operator, right_operator};
pub use quadrature::Quadrature;
pub use real::Real;
pub use runge_kutta::{RungeKutta, StageGalerkin};
pub use scheme::{Sampling, Scheme, StepEnd, StepError, StepStart};
pub use stability::{ExplicitDamping, Stability, check_stability};
pub use system::{
    Approach, Coefficients, Force, Instant, Mass, MatrixError, NoForce, Potential, Quadratic, System,
    TimeForce,
};
pub use tiled::Tiled;
pub use weights::{BdfOrder, ConvolutionWeights, leading_bdf_weight, monic_bdf_table, monic_bdf_table_f32};
