//! A decaying exponential of the weights of a kernel.

/// One term, coefficient · e^{−rate n}.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exponential {
    /// Decay per step.
    pub rate: f64,
    /// Value continued to n = 0.
    pub coefficient: f64,
}
