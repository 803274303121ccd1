//! Two springpots in series.

use crate::transfer::algebra::Algebra;
use crate::transfer::form::{ClosedForm, Form, WrittenForm, WrittenParameter, one};
use crate::transfer::real::Real;
use crate::transfer::{Active, Cut, TransferFunction, check, positive, sine_of_turns};
use fvi_core::ParameterError;
use std::f64::consts::PI;

/// (τs)^β/(1 + (τs)^{β−α}) = 1/((τs)^{−β} + (τs)^{−α}), 0 ≤ α < β ≤ 1, β − α < 1, τ > 0.
#[derive(Clone, Debug)]
pub(in crate::transfer) struct Maxwell {
    order: Real,
    inner: Real,
    time: Real,
}

pub(super) const WRITTEN: WrittenForm = WrittenForm {
    name: "maxwell",
    parameters: &[
        WrittenParameter::required("order"),
        WrittenParameter::optional("inner", 0.0),
        WrittenParameter::required("time"),
    ],
    make: |parameters| TransferFunction::maxwell(parameters[0][0], parameters[1][0], parameters[2][0]),
};

impl Maxwell {
    /// `None` for a spring and a dashpot, which have a pole in place of a cut.
    ///
    /// # Errors
    /// Unless 0 ≤ α < β ≤ 1, and if τ is not positive and finite.
    pub(in crate::transfer) fn new(
        order: f64,
        inner: f64,
        time: f64,
    ) -> Result<Option<Self>, ParameterError> {
        check(order > 0.0 && order <= 1.0, "order", order, "greater than 0 and at most 1")?;
        check(inner >= 0.0 && inner < order, "inner", inner, "at least 0 and less than the order")?;
        positive("time", time)?;
        let has_cut = order - inner != 1.0;
        Ok(has_cut.then(|| Self { order: order.into(), inner: inner.into(), time: time.into() }))
    }

    fn between(&self) -> f64 {
        self.order.to_f64() - self.inner.to_f64()
    }
}

impl ClosedForm for Maxwell {
    fn of<A: Algebra>(&self, s: &A) -> A {
        let scaled = s.stretched(self.time);
        scaled.power(self.order).in_series(&scaled.power(self.inner))
    }

    fn parameters_mut(&mut self) -> Vec<(&'static str, &mut [Real])> {
        vec![one("order", &mut self.order), one("inner", &mut self.inner), one("time", &mut self.time)]
    }
}

impl Form for Maxwell {
    fn name(&self) -> &'static str {
        WRITTEN.name
    }

    fn growth(&self) -> f64 {
        self.inner.to_f64()
    }

    fn unrelaxed(&self) -> Option<f64> {
        (self.inner.to_f64() == 0.0).then_some(1.0)
    }

    fn creep_power(&self) -> f64 {
        match self.inner.to_f64() {
            0.0 => self.order.to_f64(),
            inner => inner,
        }
    }

    /// Beyond the cut 1 + (τs)^{β−α} vanishes at the angle π/(β − α). (τs)^1 itself has no jump.
    fn cut(&self) -> Option<Cut> {
        let order = self.order.to_f64();
        let power = if order == 1.0 { 2.0 - self.inner.to_f64() } else { order };
        let strip = (0.5 * PI).min(PI / self.between() - PI);
        Some(Cut { start: 0.0, rest: 0.0, power, strip })
    }

    /// Im [u/(1 + v)] with u = (τx)^β e^{iπβ}, v = (τx)^{β−α} e^{iπ(β−α)}.
    fn jump(&self, d: f64) -> f64 {
        let [order, inner, time] = [self.order, self.inner, self.time].map(Real::to_f64);
        let between = self.between();
        let (u, v) = (libm::pow(time * d, order), libm::pow(time * d, between));
        let cosine = sine_of_turns(0.5 - 0.5 * between);
        let below = (1.0 - v) * (1.0 - v) + 4.0 * v * cosine * cosine;
        u * (sine_of_turns(order) + v * sine_of_turns(inner)) / below / PI
    }

    fn active(&self) -> Option<Active> {
        None
    }

    fn narrowing(&self) -> Option<(&'static str, f64)> {
        Some(("`order` − `inner` of the kernel", self.between()))
    }
}
