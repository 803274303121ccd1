//! Weights in place of a function.

use crate::transfer::Active;
use crate::transfer::algebra::{Algebra, Series};
use crate::transfer::form::{Form, Slope, Values};
use crate::transfer::given_weights::GivenWeights;
use crate::transfer::multistep_rule::MultistepRule;
use nalgebra::Complex;
use std::fmt;
use std::sync::Arc;

/// The weights of one step.
#[derive(Clone, Debug)]
pub(in crate::transfer) struct Given(pub(in crate::transfer) Arc<GivenWeights>);

impl Values for Given {
    fn value(&self, s: Complex<f64>) -> Complex<f64> {
        self.0.value(s)
    }

    /// A table of weights cannot be evaluated for a series.
    fn series(&self, s: &Series) -> Series {
        s.constant(f64::NAN)
    }

    fn parameters(&self) -> Vec<(&'static str, Vec<f64>)> {
        self.0.step().map(|step| ("step", vec![step])).into_iter().collect()
    }

    fn slope(&self, _name: &str, _index: usize) -> Option<Arc<dyn Slope>> {
        None
    }
}

impl Form for Given {
    fn name(&self) -> &'static str {
        "weights"
    }

    /// Weights act on values, and on q − q₀ in Caputo's form.
    fn growth(&self) -> f64 {
        0.0
    }

    fn unrelaxed(&self) -> Option<f64> {
        self.0.weights().first().copied()
    }

    fn creep_power(&self) -> f64 {
        1.0
    }

    fn is_relaxation(&self) -> bool {
        false
    }

    fn active(&self) -> Option<Active> {
        self.0.active()
    }

    fn text(&self) -> Option<&str> {
        Some(self.0.name())
    }

    fn numbers(&self) -> &[f64] {
        self.0.weights()
    }

    fn table(&self) -> Option<&GivenWeights> {
        Some(&self.0)
    }

    fn symbol(&self, _rule: MultistepRule, _step: f64, z: Complex<f64>) -> Complex<f64> {
        self.0.symbol(z)
    }

    fn heading(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} weights", self.0.weights().len())?;
        if self.0.name().is_empty() { Ok(()) } else { write!(f, " of {}", self.0.name()) }
    }
}
