//! s^β.

use crate::transfer::activity::look_for_activity;
use crate::transfer::algebra::Algebra;
use crate::transfer::form::{ClosedForm, Form, WrittenForm, WrittenParameter, one};
use crate::transfer::fractions::Fractions;
use crate::transfer::real::Real;
use crate::transfer::{Active, Cut, TransferFunction, check, sine_of_turns};
use fvi_core::ParameterError;
use std::f64::consts::PI;
use std::fmt;

/// s^β, −1 < β < 2.
#[derive(Clone, Debug)]
pub(in crate::transfer) struct Power {
    order: Real,
}

pub(super) const WRITTEN: WrittenForm = WrittenForm {
    name: "power",
    parameters: &[WrittenParameter::required("order")],
    make: |parameters| {
        let order = parameters[0][0];
        // A damping force is no integral.
        let allowed = "at least 0 and less than 2";
        check(order >= 0.0, "order", order, allowed)?;
        TransferFunction::power(order).map_err(|error| ParameterError { parameter: "order", ..error })
    },
};

impl Power {
    /// # Errors
    /// If β is outside (−1, 2).
    pub(in crate::transfer) fn new(order: f64) -> Result<Self, ParameterError> {
        check(order > -1.0 && order < 2.0, "exponent", order, "greater than −1 and less than 2")?;
        Ok(Self { order: order.into() })
    }
}

impl ClosedForm for Power {
    fn of<A: Algebra>(&self, s: &A) -> A {
        s.power(self.order)
    }

    fn parameters_mut(&mut self) -> Vec<(&'static str, &mut [Real])> {
        vec![one("order", &mut self.order)]
    }
}

impl Form for Power {
    fn name(&self) -> &'static str {
        WRITTEN.name
    }

    fn growth(&self) -> f64 {
        self.order.to_f64()
    }

    fn unrelaxed(&self) -> Option<f64> {
        match self.order.to_f64() {
            order if order > 0.0 => None,
            order => Some(if order == 0.0 { 1.0 } else { 0.0 }),
        }
    }

    fn cut(&self) -> Option<Cut> {
        let power = self.order.to_f64();
        (power.fract() != 0.0).then_some(Cut { start: 0.0, rest: 0.0, power, strip: 0.5 * PI })
    }

    fn jump(&self, d: f64) -> f64 {
        let order = self.order.to_f64();
        libm::pow(d, order) * sine_of_turns(order) / PI
    }

    fn fractions(&self) -> Option<Fractions> {
        match self.order.to_f64() {
            0.0 => Some(Fractions::constant(1.0)),
            1.0 => Some(Fractions { direct: [0.0, 1.0], poles: Vec::new() }),
            _ => None,
        }
    }

    fn active(&self) -> Option<Active> {
        if self.order.to_f64() >= 0.0 { None } else { look_for_activity(self) }
    }

    fn exponent(&self) -> Option<f64> {
        Some(self.order.to_f64())
    }

    fn heading(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "s^{}", self.order.to_f64())
    }
}
