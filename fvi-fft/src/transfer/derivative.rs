//! Derivatives of transfer functions with respect to their parameters.

use crate::transfer::algebra::{Algebra, Series};
use crate::transfer::form::Slope;
use crate::transfer::limits::value_at_zero;
use crate::transfer::{Formula, Pole, TransferFunction};
use fvi_core::ParameterError;
use nalgebra::Complex;
use std::f64::consts::PI;
use std::sync::Arc;

/// ∂K(s)/∂θ of a transfer function K by one of its parameters θ, a function of s like K: its weights are the
/// derivatives of those of K.
///
/// It follows from the formula of K by the rules of differentiation, with dual numbers K(s; θ) + ε ∂K/∂θ.
/// For a constant in a formula it is ∂K/∂θ(s) − ∂K/∂θ(0).
#[derive(Clone, Debug)]
pub struct TransferDerivative {
    of: Derivand,
    growth: f64,
    spring: f64,
    is_rounded: bool,
}

#[derive(Clone, Debug)]
enum Derivand {
    /// With the exponent of s^β, if θ is β.
    Parameter(Arc<dyn Slope>, Option<f64>),
    /// ∂K/∂θ itself.
    Formula(Arc<dyn Formula>),
}

/// Allowance for a logarithm that multiplies the power of s.
const LOGARITHM: f64 = 1e-6;

impl TransferDerivative {
    /// The derivative with respect to the parameter of this name, for a Prony series that of the term
    /// `index`; `None` if there is no such parameter, and for formulas.
    pub fn new(transfer: &TransferFunction, name: &str, index: usize) -> Option<Self> {
        let slope = transfer.form.slope(name, index)?;
        let of = Derivand::Parameter(slope, transfer.exponent());
        let (growth, is_rounded) = (transfer.growth() + LOGARITHM, transfer.is_rounded_formula());
        Some(Self { of, growth, spring: 0.0, is_rounded })
    }

    /// The derivative of a formula, itself given as a formula, whose value at s = 0 is split off.
    ///
    /// # Errors
    /// If it is not finite for every positive s.
    pub fn of_formula(
        transfer: &TransferFunction,
        derivative: Arc<dyn Formula>,
    ) -> Result<Self, ParameterError> {
        for exponent in -60..=60 {
            let s = libm::exp10(f64::from(exponent));
            if !derivative.value(Complex::new(s, 0.0)).is_finite() {
                let allowed = "a constant by which the symbol has a derivative for every s > 0";
                return Err(ParameterError { parameter: "s", value: s, allowed });
            }
        }
        let spring = value_at_zero(&*derivative);
        let (growth, is_rounded) = (transfer.growth() + LOGARITHM, transfer.is_rounded_formula());
        Ok(Self { of: Derivand::Formula(derivative), growth, spring, is_rounded })
    }

    /// β, if this is the derivative of s^β by β.
    pub fn of_power(&self) -> Option<f64> {
        match self.of {
            Derivand::Parameter(_, exponent) => exponent,
            Derivand::Formula(_) => None,
        }
    }

    /// τ, if this is the derivative τs/(1 + τs) by the strength of a term of a Prony series.
    pub(crate) fn of_strength(&self) -> Option<f64> {
        match self.poles()[..] {
            [pole] => Some(pole.rate.recip()),
            _ => None,
        }
    }

    /// ∂K(0)/∂θ, the derivative of the spring beside the memory, which is not included in
    /// [`value`](Self::value) and [`series`](Self::series).
    pub fn spring(&self) -> f64 {
        self.spring
    }

    /// True if its series may lose digits, as that of K.
    pub(crate) fn is_rounded_formula(&self) -> bool {
        self.is_rounded
    }

    /// An exponent μ with which ∂K/∂θ = O(s^μ) for large s.
    pub fn growth(&self) -> f64 {
        self.growth
    }

    /// True if the exponent with which K grows depends on θ: then ∂K/∂θ is larger than K by a logarithm.
    pub fn changes_growth_of(&self, transfer: &TransferFunction) -> bool {
        let ratio = |exponent: f64| {
            let s = Complex::new(libm::exp10(exponent), 0.0);
            (self.value(s) / transfer.value(s)).re
        };
        let (near, far) = (ratio(50.0), ratio(60.0));
        (far - near).abs() > 1e-3 * far.abs()
    }

    /// ∂K/∂θ at a place off the negative real axis.
    pub fn value(&self, s: Complex<f64>) -> Complex<f64> {
        match &self.of {
            Derivand::Parameter(slope, _) => slope.value(s),
            Derivand::Formula(formula) => formula.value(s) - self.spring,
        }
    }

    /// Im ∂K/∂θ(−x + i0)/π at x = start + d, where K has a cut from −start on.
    pub(crate) fn jump(&self, start: f64, d: f64) -> f64 {
        match &self.of {
            Derivand::Parameter(slope, _) => slope.jump(start, d),
            Derivand::Formula(_) => self.value(Complex::new(-(start + d), 0.0)).im / PI,
        }
    }

    /// The poles of ∂K/∂θ for a Prony series. That by a time has a double one, in place of which simple ones
    /// stand at neighbouring rates: a difference of order four.
    pub(crate) fn poles(&self) -> Vec<Pole> {
        match &self.of {
            Derivand::Parameter(slope, _) => slope.poles(),
            Derivand::Formula(_) => Vec::new(),
        }
    }

    /// ∂K/∂θ of a power series with a positive first coefficient.
    pub fn series(&self, s: &Series) -> Series {
        match &self.of {
            Derivand::Parameter(slope, _) => slope.series(s),
            Derivand::Formula(formula) => formula.series(s).add(&s.constant(-self.spring)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_core::ParameterError;

    type Made = Result<TransferFunction, ParameterError>;

    /// A parameter, its index and value, and the kernel as a function of it.
    type Case = (&'static str, usize, f64, Box<dyn Fn(f64) -> Made>);

    #[test]
    fn derivatives_are_those_of_the_values() {
        let cases: Vec<Case> = vec![
            ("order", 0, 0.7, Box::new(TransferFunction::power)),
            ("order", 0, 1.4, Box::new(|x| TransferFunction::tempered(x, 0.3))),
            ("rate", 0, 0.3, Box::new(|x| TransferFunction::tempered(1.4, x))),
            ("order", 0, 0.8, Box::new(|x| TransferFunction::maxwell(x, 0.2, 1.5))),
            ("inner", 0, 0.2, Box::new(|x| TransferFunction::maxwell(0.8, x, 1.5))),
            ("time", 0, 1.5, Box::new(|x| TransferFunction::maxwell(0.8, 0.2, x))),
            ("strengths", 1, 0.7, Box::new(|x| TransferFunction::prony(&[1.0, x], &[1.0, 0.1]))),
            ("times", 1, 0.1, Box::new(|x| TransferFunction::prony(&[1.0, 0.7], &[1.0, x]))),
            ("order", 0, 0.6, Box::new(|x| TransferFunction::havriliak_negami(x, 0.5, 2.0))),
            ("power", 0, 0.5, Box::new(|x| TransferFunction::havriliak_negami(0.6, x, 2.0))),
            ("time", 0, 2.0, Box::new(|x| TransferFunction::havriliak_negami(0.6, 0.5, x))),
            ("from", 0, 0.3, Box::new(|x| TransferFunction::distributed(x, 0.9, 0.7))),
            ("to", 0, 0.9, Box::new(|x| TransferFunction::distributed(0.3, x, 0.7))),
            ("time", 0, 0.7, Box::new(|x| TransferFunction::distributed(0.3, 0.9, x))),
        ];
        for (name, index, at, make) in cases {
            let derivative = TransferDerivative::new(&make(at).unwrap(), name, index).unwrap();
            for s in [Complex::new(0.4, 0.0), Complex::new(0.01, 3.0), Complex::new(-2.0, 0.7)] {
                let value = |x: f64| make(x).unwrap().value(s);
                let h = 1e-3 * at;
                // Difference of order four.
                let difference = ((value(at + h) - value(at - h)) * 8.0
                    - (value(at + 2.0 * h) - value(at - 2.0 * h)))
                    / (12.0 * h);
                let error = (derivative.value(s) - difference).norm();
                assert!(
                    error < 1e-9 * (1.0 + difference.norm()),
                    "{name} of {}: {error:e}",
                    make(at).unwrap()
                );
            }
        }
    }

    #[test]
    fn what_is_no_parameter_has_no_derivative() {
        let maxwell = TransferFunction::maxwell(0.8, 0.2, 1.5).unwrap();
        assert!(TransferDerivative::new(&maxwell, "rate", 0).is_none());
        assert!(TransferDerivative::new(&maxwell, "order", 1).is_none());
    }
}
