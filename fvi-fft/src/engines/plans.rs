//! Plans of transforms, cached by length; the planner is compiled in this module only.

use std::sync::Arc;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftNum, FftPlanner};

/// A transform, forward and inverse.
pub(crate) struct Plan<T = f64> {
    pub(crate) forward: Arc<dyn Fft<T>>,
    pub(crate) inverse: Arc<dyn Fft<T>>,
}

impl<T> Clone for Plan<T> {
    fn clone(&self) -> Self {
        Self { forward: self.forward.clone(), inverse: self.inverse.clone() }
    }
}

/// The plans made so far, shared by all users of the same length.
pub(crate) struct Plans<T = f64>(Vec<Plan<T>>);

impl<T: FftNum> Plans<T> {
    pub(crate) fn new() -> Self {
        Self(Vec::new())
    }

    /// The plan of a length.
    pub(crate) fn plan(&mut self, length: usize) -> Plan<T> {
        if let Some(plan) = self.0.iter().find(|plan| plan.forward.len() == length) {
            return plan.clone();
        }
        let mut planner = FftPlanner::new();
        let plan =
            Plan { forward: planner.plan_fft_forward(length), inverse: planner.plan_fft_inverse(length) };
        self.0.push(plan.clone());
        plan
    }
}

/// Transforms of real data of a length, forward and inverse.
pub fn real_transforms(length: usize) -> (Arc<dyn RealToComplex<f64>>, Arc<dyn ComplexToReal<f64>>) {
    let mut planner = RealFftPlanner::new();
    (planner.plan_fft_forward(length), planner.plan_fft_inverse(length))
}
