//! Weights of convolution quadrature, and starting weights.

#[doc(hidden)]
pub mod correlation;
pub(crate) mod exponential;
mod family;
pub(crate) mod inverse;
mod kernel_defects;
#[doc(hidden)]
pub mod multistep_weights;
pub(crate) mod principal_cut;
mod runge_kutta_circle;
#[doc(hidden)]
pub mod runge_kutta_derivative;
#[doc(hidden)]
pub mod runge_kutta_weights;
#[doc(hidden)]
pub mod staged_method;
#[doc(hidden)]
pub mod starting;
#[doc(hidden)]
pub mod starting_defects;

pub use family::ConvolutionFamily;
pub use staged_method::StagedMethod;
