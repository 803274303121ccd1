//! Weights of convolution quadrature, and starting weights.

pub(crate) mod exponential;
mod family;
pub(crate) mod inverse;
mod kernel_defects;
pub mod multistep_weights;
pub(crate) mod principal_cut;
pub mod runge_kutta_derivative;
pub mod runge_kutta_weights;
pub mod staged_method;
pub mod starting;
pub mod starting_defects;

pub use family::ConvolutionFamily;
pub use staged_method::StagedMethod;
