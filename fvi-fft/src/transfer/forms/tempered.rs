//! (s + a)^β − a^β.

use crate::transfer::algebra::Algebra;
use crate::transfer::dual::Dual;
use crate::transfer::form::{ClosedForm, Form, WrittenForm, WrittenParameter, one};
use crate::transfer::real::Real;
use crate::transfer::{Active, Cut, TransferFunction, check, sine_of_turns};
use fvi_core::ParameterError;
use nalgebra::Complex;
use std::f64::consts::PI;
use std::fmt;

/// (s + a)^β − a^β, 0 < β < 2 and β ≠ 1, a > 0.
#[derive(Clone, Debug)]
pub(in crate::transfer) struct Tempered {
    order: Real,
    rate: Real,
}

/// Rates below this are none: powers of s over them are no numbers.
const NO_RATE: f64 = 1e-140;

pub(super) const WRITTEN: WrittenForm = WrittenForm {
    name: "tempered",
    parameters: &[WrittenParameter::required("order"), WrittenParameter::required("rate")],
    make: |parameters| TransferFunction::tempered(parameters[0][0], parameters[1][0]),
};

impl Tempered {
    /// `None` for what is a power to rounding.
    ///
    /// # Errors
    /// If β is outside (0, 2) or a negative or not finite.
    pub(in crate::transfer) fn new(order: f64, rate: f64) -> Result<Option<Self>, ParameterError> {
        check(order > 0.0 && order < 2.0, "order", order, "greater than 0 and less than 2")?;
        check(rate >= 0.0 && rate.is_finite(), "rate", rate, "at least 0 and finite")?;
        let is_power = rate < NO_RATE || order == 1.0;
        Ok((!is_power).then(|| Self { order: order.into(), rate: rate.into() }))
    }
}

impl ClosedForm for Tempered {
    /// As a^β ((1 + s/a)^β − 1), which keeps its digits where s is small.
    fn of<A: Algebra>(&self, s: &A) -> A {
        s.power_beyond(self.rate, self.order)
    }

    /// Of (s + a)^β at s + a = −d.
    fn slope_of_jump(&self, d: f64) -> Option<f64> {
        let place = Dual::constant_in(&Complex::new(-d, 0.0));
        let moved = place.add(&place.parameter(Real { slope: self.rate.slope, ..0.0.into() }));
        Some(moved.power(self.order).slope().im / PI)
    }

    fn parameters_mut(&mut self) -> Vec<(&'static str, &mut [Real])> {
        vec![one("order", &mut self.order), one("rate", &mut self.rate)]
    }
}

impl Form for Tempered {
    fn name(&self) -> &'static str {
        WRITTEN.name
    }

    fn growth(&self) -> f64 {
        self.order.to_f64()
    }

    fn unrelaxed(&self) -> Option<f64> {
        None
    }

    fn cut(&self) -> Option<Cut> {
        let (start, power) = (self.rate.to_f64(), self.order.to_f64());
        Some(Cut { start, rest: 0.0, power, strip: 0.5 * PI })
    }

    fn jump(&self, d: f64) -> f64 {
        let order = self.order.to_f64();
        libm::pow(d, order) * sine_of_turns(order) / PI
    }

    fn active(&self) -> Option<Active> {
        None
    }

    fn heading(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (order, rate) = (self.order.to_f64(), self.rate.to_f64());
        write!(f, "(s + {rate})^{order} − {rate}^{order}")
    }
}
