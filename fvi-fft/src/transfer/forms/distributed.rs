//! The mean of the powers of all orders between two.

use crate::transfer::algebra::Algebra;
use crate::transfer::form::{ClosedForm, Form, Values, WrittenForm, WrittenParameter, one};
use crate::transfer::limits::slope_of_powers;
use crate::transfer::real::Real;
use crate::transfer::{Active, Cut, TransferFunction, check, positive};
use fvi_core::ParameterError;
use nalgebra::Complex;
use std::f64::consts::PI;

/// ((τs)^b − (τs)^a)/((b − a) ln(τs)) = 1/(b − a) ∫_a^b (τs)^β dβ, 0 ≤ a < b ≤ 1 or 1 ≤ a < b < 2, τ > 0; 1
/// at s = 1/τ.
#[derive(Clone, Debug)]
pub(in crate::transfer) struct Distributed {
    from: Real,
    to: Real,
    time: Real,
}

pub(super) const WRITTEN: WrittenForm = WrittenForm {
    name: "distributed",
    parameters: &[
        WrittenParameter::optional("from", 0.0),
        WrittenParameter::optional("to", 1.0),
        WrittenParameter::optional("time", 1.0),
    ],
    make: |parameters| TransferFunction::distributed(parameters[0][0], parameters[1][0], parameters[2][0]),
};

impl Distributed {
    /// # Errors
    /// Unless 0 ≤ a < b ≤ 1 or 1 ≤ a < b < 2, and if τ is not positive and finite.
    pub(in crate::transfer) fn new(from: f64, to: f64, time: f64) -> Result<Self, ParameterError> {
        check((0.0..2.0).contains(&from), "from", from, "at least 0 and less than 2")?;
        check(to > from && to < 2.0, "to", to, "greater than `from` and less than 2")?;
        // Sums of exponentials begin with K/s for orders below 1, and with K/s² for those above.
        let allowed = "at most 1 where `from` is less than 1: take two kernels, up to 1 and from 1";
        check(from >= 1.0 || to <= 1.0, "to", to, allowed)?;
        positive("time", time)?;
        Ok(Self { from: from.into(), to: to.into(), time: time.into() })
    }

    fn size(&self, exponent: f64) -> f64 {
        self.value(Complex::new(libm::exp10(exponent), 0.0)).norm()
    }
}

impl ClosedForm for Distributed {
    /// As (τs)^a ∫₀¹ e^{t (b − a) ln(τs)} dt.
    fn of<A: Algebra>(&self, s: &A) -> A {
        let scaled = s.stretched(self.time);
        let mean = scaled.logarithm().stretched(self.to.less(self.from)).exponential_moment(0);
        scaled.power(self.from).multiply(&mean)
    }

    fn parameters_mut(&mut self) -> Vec<(&'static str, &mut [Real])> {
        vec![one("from", &mut self.from), one("to", &mut self.to), one("time", &mut self.time)]
    }
}

impl Form for Distributed {
    fn name(&self) -> &'static str {
        WRITTEN.name
    }

    /// K grows like s^b/ln s, which is no power: taken where the numbers end.
    fn growth(&self) -> f64 {
        slope_of_powers(self.size(50.0), self.size(60.0))
    }

    fn unrelaxed(&self) -> Option<f64> {
        None
    }

    /// The jump begins like x^a/ln x, for a = 0 like 1/(ln x)²: taken where the numbers end. It is an entire
    /// function of ln x, as wide as that of a power.
    fn cut(&self) -> Option<Cut> {
        let power = slope_of_powers(self.jump(1e-40).abs(), self.jump(1e-30).abs());
        Some(Cut { start: 0.0, rest: 0.0, power, strip: 0.5 * PI })
    }

    fn jump(&self, d: f64) -> f64 {
        self.value(Complex::new(-d, 0.0)).im / PI
    }

    /// As every power of an order between 0 and 2.
    fn active(&self) -> Option<Active> {
        None
    }

    /// The quotient of its series cancels where s is next to 1/τ.
    fn is_rounded_formula(&self) -> bool {
        true
    }
}
