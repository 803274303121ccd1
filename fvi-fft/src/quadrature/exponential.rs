//! A decaying exponential of the weights of a kernel.

/// One term, coefficient · e^{−rate n}.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exponential {
    /// Decay rate per step.
    pub rate: f64,
    /// Value extrapolated to n = 0.
    pub coefficient: f64,
}
