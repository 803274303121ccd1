//! 1 − (1 + (τs)^α)^{−γ}.

use crate::transfer::activity::look_for_activity;
use crate::transfer::algebra::Algebra;
use crate::transfer::form::{ClosedForm, Form, WrittenForm, WrittenParameter, one};
use crate::transfer::real::Real;
use crate::transfer::{Active, Cut, TransferFunction, UnboundedStart, check, positive, ratio, sine_of_turns};
use fvi_core::ParameterError;
use std::f64::consts::PI;

/// 1 − (1 + (τs)^α)^{−γ}, 0 < α ≤ 1, γ > 0, τ > 0, and not α = γ = 1.
#[derive(Clone, Debug)]
pub(in crate::transfer) struct HavriliakNegami {
    order: Real,
    power: Real,
    time: Real,
}

pub(super) const WRITTEN: WrittenForm = WrittenForm {
    name: "havriliak-negami",
    parameters: &[
        WrittenParameter::required("order"),
        WrittenParameter::optional("power", 1.0),
        WrittenParameter::required("time"),
    ],
    make: |parameters| {
        TransferFunction::havriliak_negami(parameters[0][0], parameters[1][0], parameters[2][0])
    },
};

impl HavriliakNegami {
    /// `None` for a spring and a dashpot, which have a pole in place of a cut.
    ///
    /// # Errors
    /// Unless 0 < α ≤ 1 and γ > 0 and τ > 0, all finite; if α = 1, γ must be at most 1.
    pub(in crate::transfer) fn new(
        order: f64,
        power: f64,
        time: f64,
    ) -> Result<Option<Self>, ParameterError> {
        check(order > 0.0 && order <= 1.0, "order", order, "greater than 0 and at most 1")?;
        positive("power", power)?;
        check(order < 1.0 || power <= 1.0, "power", power, "at most 1 with order 1")?;
        positive("time", time)?;
        let has_cut = order != 1.0 || power != 1.0;
        Ok(has_cut.then(|| Self { order: order.into(), power: power.into(), time: time.into() }))
    }

    fn numbers(&self) -> [f64; 3] {
        [self.order, self.power, self.time].map(Real::to_f64)
    }
}

impl ClosedForm for HavriliakNegami {
    fn of<A: Algebra>(&self, s: &A) -> A {
        s.stretched(self.time).power(self.order).power_beside_one(self.power.negative()).negate()
    }

    fn parameters_mut(&mut self) -> Vec<(&'static str, &mut [Real])> {
        vec![one("order", &mut self.order), one("power", &mut self.power), one("time", &mut self.time)]
    }
}

impl Form for HavriliakNegami {
    fn name(&self) -> &'static str {
        WRITTEN.name
    }

    fn growth(&self) -> f64 {
        0.0
    }

    fn unrelaxed(&self) -> Option<f64> {
        Some(1.0)
    }

    fn creep_power(&self) -> f64 {
        self.order.to_f64() * self.power.to_f64()
    }

    fn cut(&self) -> Option<Cut> {
        let half = 0.5 * PI;
        let [order, power, time] = self.numbers();
        if order == 1.0 {
            let [start, rest] = ratio(1.0, time);
            return Some(Cut { start, rest, power: -power, strip: half });
        }
        Some(Cut { start: 0.0, rest: 0.0, power: order, strip: half.min(PI / order - PI) })
    }

    fn jump(&self, d: f64) -> f64 {
        let [order, power, time] = self.numbers();
        if order == 1.0 {
            return libm::pow(time * d, -power) * sine_of_turns(power) / PI;
        }
        let w = libm::pow(time * d, order);
        let (re, im) = (1.0 + w * sine_of_turns(0.5 - order), w * sine_of_turns(order));
        libm::pow(libm::hypot(re, im), -power) * libm::sin(power * libm::atan2(im, re)) / PI
    }

    fn active(&self) -> Option<Active> {
        if self.creep_power() <= 1.0 { None } else { look_for_activity(self) }
    }

    fn unbounded_start(&self) -> Option<UnboundedStart> {
        let [order, power, time] = self.numbers();
        (order == 1.0).then(|| UnboundedStart { place: ratio(1.0, time)[0], power })
    }

    fn narrowing(&self) -> Option<(&'static str, f64)> {
        Some(("`order` of the kernel", self.order.to_f64()))
    }
}
