//! Tables of exponentials for the memories of the control loops: weights of D^exponent at h = 1 ms for 10⁸
//! steps, and rates for steps from 7.9 ms on up to 2000 s.
//!
//! The files are the output of `fvi exponentials --exponent … --step 0.001 --horizon 1e8 --tolerance 1e-7
//! --format rust --precision f32`, with `--endless` for `--horizon 1e8`, and `fvi rates --stages 1 --exponent
//! … --shortest 0.0079 --horizon 2000 --tolerance 1e-7 --format rust --precision f32`.

/// Output of `fvi controller firmware/loop.toml --format rust --name axis`.
#[rustfmt::skip]
pub mod axis;
/// Exponent 0.5.
#[rustfmt::skip]
pub mod damping;
/// Exponent 0.6.
#[rustfmt::skip]
pub mod derivative;
/// Exponent 0.5, without a horizon.
#[rustfmt::skip]
pub mod endless;
/// Exponent −0.8 for a step size of 1, without a horizon.
#[rustfmt::skip]
pub mod endless_integral;
/// Exponent −0.8.
#[rustfmt::skip]
pub mod integral;
/// Exponent 0.5, steps of any length.
#[rustfmt::skip]
pub mod jitter_damping;
/// Exponent 0.6, steps of any length.
#[rustfmt::skip]
pub mod jitter_derivative;
/// Exponent −0.8, steps of any length.
#[rustfmt::skip]
pub mod jitter_integral;
/// Output of `fvi controller firmware/loop.toml --arithmetic fixed --band 0.01 250 --tolerance 1e-2
/// --input-unit 1e-4 --output-unit 1e-3 --format rust --name whole_axis`.
#[rustfmt::skip]
pub mod whole_axis;

pub use damping::TABLE as DAMPING;
pub use derivative::TABLE as DERIVATIVE;
pub use endless::TABLE as ENDLESS;
pub use endless_integral::TABLE as ENDLESS_INTEGRAL;
pub use integral::TABLE as INTEGRAL;
pub use jitter_damping::TABLE as JITTER_DAMPING;
pub use jitter_derivative::TABLE as JITTER_DERIVATIVE;
pub use jitter_integral::TABLE as JITTER_INTEGRAL;
