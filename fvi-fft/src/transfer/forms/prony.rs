//! Maxwell elements of springs and dashpots in parallel.

use crate::transfer::activity::look_for_activity;
use crate::transfer::algebra::Algebra;
use crate::transfer::form::{ClosedForm, Form, WrittenForm, WrittenParameter};
use crate::transfer::fractions::{Fractions, PoleOfOrder};
use crate::transfer::real::Real;
use crate::transfer::{Active, Pole, TransferFunction, check, positive, ratio};
use fvi_core::ParameterError;
use nalgebra::Complex;

/// Σ g τ s/(1 + τ s).
#[derive(Clone, Debug)]
pub(in crate::transfer) struct Prony {
    strengths: Vec<Real>,
    times: Vec<Real>,
}

pub(super) const WRITTEN: WrittenForm = WrittenForm {
    name: "prony",
    parameters: &[WrittenParameter::list("strengths"), WrittenParameter::list("times")],
    make: |parameters| TransferFunction::prony(&parameters[0], &parameters[1]),
};

impl Prony {
    /// # Errors
    /// If there is no term, the numbers of strengths and times differ, a strength is not finite or all are
    /// zero, or a time not positive and finite.
    pub(in crate::transfer) fn new(strengths: &[f64], times: &[f64]) -> Result<Self, ParameterError> {
        check(!strengths.is_empty(), "number of strengths", 0.0, "at least 1")?;
        let count = times.len();
        check(count == strengths.len(), "number of times", count as f64, "as many as strengths")?;
        for &strength in strengths {
            check(strength.is_finite(), "strength", strength, "finite")?;
        }
        let some = strengths.iter().any(|&strength| strength != 0.0);
        check(some, "strength", 0.0, "not 0 for one term at least")?;
        times.iter().try_for_each(|&time| positive("time", time))?;
        let reals = |numbers: &[f64]| numbers.iter().map(|&number| Real::from(number)).collect();
        Ok(Self { strengths: reals(strengths), times: reals(times) })
    }

    fn strengths(&self) -> impl Iterator<Item = f64> {
        self.strengths.iter().map(|strength| strength.to_f64())
    }
}

impl ClosedForm for Prony {
    fn of<A: Algebra>(&self, s: &A) -> A {
        let terms = self.strengths.iter().zip(&self.times);
        terms.fold(s.constant(0.0), |sum, (&strength, &time)| {
            sum.add(&s.stretched(time).share().stretched(strength))
        })
    }

    /// That by a time has a double pole, in place of which simple ones stand at neighbouring rates: a
    /// difference of order four.
    fn slope_of_poles(&self) -> Vec<Pole> {
        let mut poles = Vec::new();
        for (strength, time) in self.strengths.iter().zip(&self.times) {
            let rate = time.to_f64().recip();
            if strength.slope != 0.0 {
                poles.push(Pole { rate, residue: -rate, rests: [0.0; 2] });
            }
            if time.slope != 0.0 {
                let near = 1e-3;
                let scale = strength.to_f64() * rate / (12.0 * near);
                for (place, share) in [(-2.0, 1.0), (-1.0, -8.0), (1.0, 8.0), (2.0, -1.0)] {
                    let rate = rate * (1.0 + near * place);
                    poles.push(Pole { rate, residue: scale * share * rate, rests: [0.0; 2] });
                }
            }
        }
        poles
    }

    fn parameters_mut(&mut self) -> Vec<(&'static str, &mut [Real])> {
        vec![("strengths", &mut self.strengths), ("times", &mut self.times)]
    }
}

impl Form for Prony {
    fn name(&self) -> &'static str {
        WRITTEN.name
    }

    fn growth(&self) -> f64 {
        0.0
    }

    fn unrelaxed(&self) -> Option<f64> {
        Some(self.strengths().sum())
    }

    fn creep_power(&self) -> f64 {
        1.0
    }

    /// g τ s/(1 + τ s) = g − (g/τ)/(s + 1/τ); an element without strength has no pole.
    fn poles(&self) -> Vec<Pole> {
        let elements = self.strengths().zip(&self.times).filter(|(strength, _)| *strength != 0.0);
        let pole = |(g, time): (f64, &Real)| {
            let ([rate, rest], [residue, rest_of_residue]) =
                (ratio(1.0, time.to_f64()), ratio(-g, time.to_f64()));
            Pole { rate, residue, rests: [rest, rest_of_residue] }
        };
        elements.map(pole).collect()
    }

    fn fractions(&self) -> Option<Fractions> {
        let poles = self.poles().into_iter().map(|pole| PoleOfOrder {
            place: Complex::new(-pole.rate, 0.0),
            coefficients: vec![Complex::new(pole.residue, 0.0)],
        });
        let terms = poles.map(|pole| Fractions { direct: [0.0; 2], poles: vec![pole] });
        Some(terms.fold(Fractions::constant(self.strengths().sum()), Fractions::plus))
    }

    fn active(&self) -> Option<Active> {
        if self.strengths().all(|strength| strength >= 0.0) { None } else { look_for_activity(self) }
    }
}
