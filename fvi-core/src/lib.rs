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
mod fractional_integral;
mod galerkin;
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
pub use collocation::{Collocation, CollocationTables};
pub use damped_motion::{DampedMotion, DampingError, Derivative, Mismatch, Sample};
pub use damping::{Damping, DampingTerm};
pub use direct::{Direct, FixedDirect, Overflow, Ring};
pub use discrete_lagrangian::DiscreteLagrangian;
pub use double_double::DoubleDouble;
pub use error::{MatrixError, ParameterError};
pub use euler::{ExplicitEuler, ImplicitEuler};
pub use exponential_sum::{ExponentialSum, ExponentialTable, ExponentialTerm};
pub use fractional_integral::{FractionalIntegral, PendingIntegral};
pub use galerkin::{Galerkin, Tables};
pub use integrator::{Integrator, IntegratorBuilder, IntegratorError};
pub use kernel::{Kernel, Rule, Symbol};
pub use linear::{
    Singular, add_multiple, combine, combine_four, combine_two, factor, invert_factored,
    is_positive_definite_in_place, keep_factors, solve, substitute, substitute_kept,
};
pub use mechanism::{
    DamperRow, Dampers, GaussLobatto, Lagrangian, MOST_STAGES, MechanismError, MechanismIntegrator,
    RelaxationTable, Relaxing, Second,
};
pub use memory::{ActsOn, Memory, MemoryError, SavedChannels, check_channels};
pub use memoryless::Memoryless;
pub use newton::{Equations, Factors};
pub use node_galerkin::{NodeGalerkin, NodeStorage};
pub use operator::{FractionalOperator, OperatorError, Pending, Start, left_operator, right_operator};
pub use pid::{Actuator, ExponentialPi, ExponentialPid, FractionalPid, PidError, PidInputs, RingPi, RingPid};
pub use pid_law::{
    AntiWindup, Bumpless, DerivativeFilter, DerivativeOf, PidGains, PidLaw, PidResponse, PidSettings,
};
pub use quadrature::{Quadrature, gauss_rule, lobatto_rule};
pub use real::{Real, max_or_nan, min_or_nan};
pub use resolvent::Resolvent;
pub use runge_kutta::RungeKutta;
pub use saving::{Shape, StateError, StateReader, StateWriter, Stateful, fingerprint, header_bytes};
pub use scheme::{Outcome, Rounding, Sampling, Scheme, State, Step, StepError, conclude};
pub use space::{Block, Space};
pub use stability::{ExplicitDamping, Stability, check_stability};
pub use system::{
    Approach, Force, Instant, Mass, Mechanics, NoForce, NodalRule, Potential, Quadratic, System, TimeForce,
};
pub use tiled::Tiled;
pub use variable_steps::{RateTable, VariableStepMemory};
pub use weights::{
    BdfOrder, ConvolutionWeights, leading_bdf_weight, monic_bdf_table, monic_bdf_table_f32,
    monic_increment_table, monic_increment_table_f32,
};
pub use workspace::{CachedFactor, Workspace};

/// The examples of the page that introduces the crate.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
