//! Plans of transforms, cached by length; the planner is compiled in this module only.

use std::sync::Arc;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};

/// A transform, forward and inverse.
#[derive(Clone)]
pub(crate) struct Plan {
    pub(crate) forward: Arc<dyn Fft<f64>>,
    pub(crate) inverse: Arc<dyn Fft<f64>>,
}

/// The plans made so far, shared by all users of the same length.
pub(crate) struct Plans(Vec<Plan>);

impl Plans {
    pub(crate) fn new() -> Self {
        Self(Vec::new())
    }

    /// The plan of a length.
    pub(crate) fn plan(&mut self, length: usize) -> Plan {
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
