//! Fractional variational integrators without `std` or allocation: schemes, convolution-quadrature weights
//! and memories, for `f32` and `f64`, from a host to a microcontroller.
#![no_std]
#![forbid(unsafe_code)]

pub use {heapless, nalgebra};

#[cfg(test)]
extern crate std;

mod coefficients;
mod collocation;
mod damped_motion;
mod damping;
mod direct;
mod discrete_lagrangian;
mod double_double;
mod error;
mod euler;
mod exponential_sum;
mod fixed_point;
mod fractional_integral;
mod galerkin;
mod generated;
mod integrator;
mod kernel;
mod linear;
mod mechanism;
mod memory;
mod memoryless;
mod newton;
mod node_galerkin;
#[cfg(test)]
mod noise;
mod one_node;
mod operator;
mod pid;
mod pid_law;
#[cfg(test)]
mod pid_tests;
mod quadrature;
mod real;
#[cfg(test)]
mod recording_memory;
mod resolvent;
mod runge_kutta;
mod saving;
mod scheme;
mod space;
mod stability;
#[cfg(test)]
mod step_tests;
mod system;
mod tiled;
mod variable_steps;
mod weighted_sum;
mod weights;
mod workspace;

pub use coefficients::{Coefficients, Fixed};
pub use collocation::Collocation;
#[doc(hidden)]
pub use collocation::CollocationTables;
#[doc(hidden)]
pub use damped_motion::Subtraction;
pub use damped_motion::{DampedMotion, DampingError, Derivative, Mismatch, Sample};
pub use damping::{Damping, DampingTerm};
pub use direct::{Direct, FixedDirect, Overflow, Ring};
#[doc(hidden)]
pub use discrete_lagrangian::DiscreteLagrangian;
#[doc(hidden)]
pub use double_double::DoubleDouble;
pub use error::{MatrixError, ParameterError};
pub use euler::{ExplicitEuler, ImplicitEuler};
pub use exponential_sum::{ExponentialSum, ExponentialTable, ExponentialTerm, TabulatedSum};
#[doc(hidden)]
pub use exponential_sum::{Given, Layout, TableSource};
pub use fixed_point::{FixedGain, FixedLaw, FixedOperator, FixedPid, FixedTerm, FixedWindup};
pub use fractional_integral::{FractionalIntegral, PendingIntegral};
pub use galerkin::Galerkin;
#[doc(hidden)]
pub use galerkin::Tables;
#[doc(hidden)]
pub use generated::Sealing;
pub use generated::{Generated, GeneratedKernel, GeneratedMemory, GeneratedSum, SealedTable};
pub use integrator::{Integrator, IntegratorBuilder, IntegratorError};
pub use kernel::{Kernel, Rule, Symbol};
#[doc(hidden)]
pub use linear::{
    Singular, add_multiple, combine, combine_four, combine_two, factor, invert_factored,
    is_positive_definite_in_place, keep_factors, solve, substitute, substitute_kept,
};
#[doc(hidden)]
pub use mechanism::MOST_STAGES;
pub use mechanism::{
    DamperRow, Dampers, GaussLobatto, Lagrangian, MechanismError, MechanismIntegrator, RelaxationTable,
    Relaxing, Second,
};
pub use memory::{ActsOn, Memory, MemoryError};
#[doc(hidden)]
pub use memory::{SavedChannels, check_channels};
pub use memoryless::Memoryless;
#[doc(hidden)]
pub use newton::{Equations, Factors};
pub use node_galerkin::NodeGalerkin;
#[doc(hidden)]
pub use node_galerkin::NodeStorage;
pub use operator::{FractionalOperator, OperatorError, Pending, Start, left_operator, right_operator};
pub use pid::{Actuator, ExponentialPi, ExponentialPid, FractionalPid, PidError, PidInputs, RingPi, RingPid};
pub use pid_law::{
    AntiWindup, Bumpless, DerivativeFilter, DerivativeOf, PidConstants, PidGains, PidLaw, PidResponse,
    PidSettings,
};
pub use quadrature::{Quadrature, gauss_rule, lobatto_rule};
pub use real::Real;
#[doc(hidden)]
pub use real::{max_or_nan, min_or_nan};
#[doc(hidden)]
pub use resolvent::Resolvent;
pub use runge_kutta::RungeKutta;
pub use saving::{Shape, StateError, StateReader, StateWriter, Stateful};
#[doc(hidden)]
pub use saving::{fingerprint, header_bytes};
#[doc(hidden)]
pub use scheme::{Outcome, Rounding, conclude};
pub use scheme::{Sampling, Scheme, State, Step, StepError};
pub use space::{Block, Space};
pub use stability::{ExplicitDamping, Stability, check_stability};
#[doc(hidden)]
pub use system::Approach;
pub use system::{
    Force, Instant, Mass, Mechanics, NoForce, NodalRule, Potential, Quadratic, System, TimeForce,
};
pub use tiled::Tiled;
pub use variable_steps::{RateTable, VariableStepMemory};
pub use weights::{BdfOrder, ConvolutionWeights};
#[doc(hidden)]
pub use weights::{
    leading_bdf_weight, monic_bdf_table, monic_bdf_table_f32, monic_increment_table,
    monic_increment_table_f32,
};
#[doc(hidden)]
pub use workspace::{CachedFactor, Workspace};

/// The examples of the page that introduces the crate.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
