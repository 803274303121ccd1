//! Plans of transforms, kept by their length.

use std::sync::Arc;

use rustfft::Fft;

use crate::scalar::Scalar;

/// A transform, forward and inverse.
#[derive(Clone)]
pub(crate) struct Plan<T> {
    pub(crate) forward: Arc<dyn Fft<T>>,
    pub(crate) inverse: Arc<dyn Fft<T>>,
}

/// The plans made so far: who asks for the same length shares their tables.
pub(crate) struct Plans<T>(Vec<Plan<T>>);

impl<T: Scalar> Plans<T> {
    pub(crate) fn new() -> Self {
        Self(Vec::new())
    }

    /// The plan of a length.
    pub(crate) fn plan(&mut self, length: usize) -> Plan<T> {
        if let Some(plan) = self.0.iter().find(|plan| plan.forward.len() == length) {
            return plan.clone();
        }
        let [forward, inverse] = T::transforms(length);
        let plan = Plan { forward, inverse };
        self.0.push(plan.clone());
        plan
    }
}
