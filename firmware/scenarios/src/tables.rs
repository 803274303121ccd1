//! Tables of exponentials for the memories of the control loop: weights of D^exponent at h = 1 ms for 10⁸ steps.
//!
//! Each file is what `fvi exponentials --exponent … --step 0.001 --horizon 1e8 --tolerance 1e-7 --format rust --precision f32` prints.

/// Exponent 0.5.
#[rustfmt::skip]
pub mod damping;
/// Exponent 0.6.
#[rustfmt::skip]
pub mod derivative;
/// Exponent −0.8.
#[rustfmt::skip]
pub mod integral;

pub use damping::TABLE as DAMPING;
pub use derivative::TABLE as DERIVATIVE;
pub use integral::TABLE as INTEGRAL;
