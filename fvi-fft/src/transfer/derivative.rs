//! Derivatives of transfer functions with respect to their parameters.

use crate::transfer::algebra::{Algebra, Series};
use crate::transfer::{Form, Formula, Pole, TransferFunction, value_at_zero};
use fvi_core::{DoubleDouble, ParameterError};
use nalgebra::Complex;
use std::f64::consts::PI;
use std::sync::Arc;

/// ∂K(s)/∂θ of a transfer function K by one of its parameters θ, a function of s like K: its weights are the
/// derivatives of those of K.
///
/// With L = ln(τs), u = (τs)^β, v = (τs)^{β−α} and w = (τs)^α:
///
/// | form | θ | ∂K/∂θ |
/// |---|---|---|
/// | power | β | s^β ln s |
/// | tempered | β, a | (s+a)^β ln(s+a) − a^β ln a; β ((s+a)^{β−1} − a^{β−1}) |
/// | Maxwell | β, α, τ | u L/(1+v)²; u v L/(1+v)²; (β u/(1+v) − (β−α) u v/(1+v)²)/τ |
/// | Prony | g, τ | τs/(1+τs); g s/(1+τs)² |
/// | Havriliak–Negami | α, γ, τ | γ w L (1+w)^{−γ−1}; (1+w)^{−γ} ln(1+w); γ α w (1+w)^{−γ−1}/τ |
/// | formula | a constant in it | ∂K/∂θ(s) − ∂K/∂θ(0), by the rules of differentiation |
#[derive(Clone, Debug)]
pub struct TransferDerivative {
    of: Derivand,
    growth: f64,
    spring: f64,
}

#[derive(Clone, Debug)]
enum Derivand {
    Parameter(Parameter),
    /// ∂K/∂θ itself.
    Formula(Arc<dyn Formula>),
}

/// θ, and the numbers that its derivative needs.
#[derive(Clone, Copy, Debug)]
enum Parameter {
    PowerOrder { order: f64 },
    TemperedOrder { order: f64, rate: f64 },
    TemperedRate { order: f64, rate: f64 },
    Maxwell { of: MaxwellParameter, order: f64, inner: f64, time: f64 },
    PronyStrength { time: f64 },
    PronyTime { strength: f64, time: f64 },
    HavriliakNegami { of: HavriliakNegamiParameter, order: f64, power: f64, time: f64 },
}

#[derive(Clone, Copy, Debug)]
enum MaxwellParameter {
    Order,
    Inner,
    Time,
}

#[derive(Clone, Copy, Debug)]
enum HavriliakNegamiParameter {
    Order,
    Power,
    Time,
}

/// Allowance for a logarithm that multiplies the power of s.
const LOGARITHM: f64 = 1e-6;

impl TransferDerivative {
    /// The derivative with respect to the parameter of this name, for a Prony series that of the term
    /// `index`; `None` if there is no such parameter, and for formulas.
    pub fn new(transfer: &TransferFunction, name: &str, index: usize) -> Option<Self> {
        let parameter = Parameter::of(&transfer.form, name, index)?;
        Some(Self { of: Derivand::Parameter(parameter), growth: transfer.growth() + LOGARITHM, spring: 0.0 })
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
        Ok(Self { of: Derivand::Formula(derivative), growth: transfer.growth() + LOGARITHM, spring })
    }

    /// β, if this is the derivative of s^β by β.
    pub fn of_power(&self) -> Option<f64> {
        match self.of {
            Derivand::Parameter(Parameter::PowerOrder { order }) => Some(order),
            _ => None,
        }
    }

    /// ∂K(0)/∂θ, the derivative of the spring beside the memory, which is not included in
    /// [`value`](Self::value) and [`series`](Self::series).
    pub fn spring(&self) -> f64 {
        self.spring
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
            Derivand::Parameter(parameter) => parameter.at(&s),
            Derivand::Formula(formula) => formula.value(s) - self.spring,
        }
    }

    /// Im ∂K/∂θ(−x + i0)/π at x = start + d, where K has a cut from −start on.
    pub(crate) fn jump(&self, start: f64, d: f64) -> f64 {
        let (parameter, place) = match &self.of {
            // Functions of s + a alone, whose digits s = −a − d does not have.
            Derivand::Parameter(Parameter::TemperedOrder { order, .. }) => {
                (&Parameter::PowerOrder { order: *order }, -d)
            }
            &Derivand::Parameter(Parameter::TemperedRate { order, .. }) => {
                let power = Complex::new(-d, 0.0).power(DoubleDouble::exact(order - 1.0));
                return order * power.im / PI;
            }
            Derivand::Parameter(parameter) => (parameter, -(start + d)),
            Derivand::Formula(_) => return self.value(Complex::new(-(start + d), 0.0)).im / PI,
        };
        parameter.at(&Complex::new(place, 0.0)).im / PI
    }

    /// The poles of ∂K/∂θ for a Prony series. That by a time has a double one, in place of which simple ones
    /// stand at neighbouring rates: a difference of order four.
    pub(crate) fn poles(&self) -> Vec<Pole> {
        match self.of {
            Derivand::Parameter(Parameter::PronyStrength { time }) => {
                vec![Pole { rate: time.recip(), residue: -time.recip(), rests: [0.0; 2] }]
            }
            Derivand::Parameter(Parameter::PronyTime { strength, time }) => {
                let (whole, near) = (time.recip(), 1e-3);
                let parts = [(-2.0, 1.0), (-1.0, -8.0), (1.0, 8.0), (2.0, -1.0)];
                let scale = strength * whole / (12.0 * near);
                let rates = parts.map(|(place, share)| (whole * (1.0 + near * place), share));
                rates
                    .map(|(rate, share)| Pole { rate, residue: scale * share * rate, rests: [0.0; 2] })
                    .into()
            }
            _ => Vec::new(),
        }
    }

    /// ∂K/∂θ of a power series with a positive first coefficient.
    pub fn series(&self, s: &Series) -> Series {
        match &self.of {
            Derivand::Parameter(parameter) => parameter.at(s),
            Derivand::Formula(formula) => formula.series(s).add(&s.constant(-self.spring)),
        }
    }
}

impl Parameter {
    /// The parameter of this name, for a Prony series that of the term `index`.
    fn of(form: &Form, name: &str, index: usize) -> Option<Self> {
        if let Form::Prony { strengths, times } = form {
            let (&strength, &time) = (strengths.get(index)?, times.get(index)?);
            return match name {
                "strengths" => Some(Self::PronyStrength { time }),
                "times" => Some(Self::PronyTime { strength, time }),
                _ => None,
            };
        }
        if index > 0 {
            return None;
        }
        match (form, name) {
            (&Form::Power { order }, "order") => Some(Self::PowerOrder { order }),
            (&Form::Tempered { order, rate }, "order") => Some(Self::TemperedOrder { order, rate }),
            (&Form::Tempered { order, rate }, "rate") => Some(Self::TemperedRate { order, rate }),
            (&Form::Maxwell { order, inner, time }, name) => {
                let of = match name {
                    "order" => MaxwellParameter::Order,
                    "inner" => MaxwellParameter::Inner,
                    "time" => MaxwellParameter::Time,
                    _ => return None,
                };
                Some(Self::Maxwell { of, order, inner, time })
            }
            (&Form::HavriliakNegami { order, power, time }, name) => {
                let of = match name {
                    "order" => HavriliakNegamiParameter::Order,
                    "power" => HavriliakNegamiParameter::Power,
                    "time" => HavriliakNegamiParameter::Time,
                    _ => return None,
                };
                Some(Self::HavriliakNegami { of, order, power, time })
            }
            _ => None,
        }
    }

    /// ∂K/∂θ at s.
    fn at<A: Algebra>(self, s: &A) -> A {
        let exact = DoubleDouble::exact;
        let one = s.constant(1.0);
        match self {
            Self::PowerOrder { order } => s.power(exact(order)).multiply(&s.logarithm()),
            Self::TemperedRate { order, rate } => {
                let scaled = s.divide(&s.constant(rate));
                let scale = s.constant(rate).power(exact(order - 1.0));
                scaled.power_beside_one(order - 1.0).multiply(&scale).scale(order)
            }
            Self::TemperedOrder { order, rate } => {
                // a^β [((1 + x)^β − 1) ln a + (1 + x)^β ln(1 + x)] with x = s/a
                let scaled = s.divide(&s.constant(rate));
                let beyond = scaled.power_beside_one(order);
                let grown = beyond.add(&one).multiply(&scaled.add(&one).logarithm());
                let sum = beyond.scale(libm::log(rate)).add(&grown);
                sum.multiply(&s.constant(rate).power(exact(order)))
            }
            Self::Maxwell { of, order, inner, time } => {
                let scaled = s.scale(time);
                let between = exact(order).add(exact(-inner));
                let (u, v) = (scaled.power(exact(order)), scaled.power(between));
                let below = v.add(&one);
                let share = u.divide(&below);
                let squared = share.divide(&below);
                match of {
                    MaxwellParameter::Order => squared.multiply(&scaled.logarithm()),
                    MaxwellParameter::Inner => squared.multiply(&v).multiply(&scaled.logarithm()),
                    MaxwellParameter::Time => {
                        let second = squared.multiply(&v).scale(inner - order);
                        share.scale(order).add(&second).scale(time.recip())
                    }
                }
            }
            Self::PronyStrength { time } => {
                let below = s.scale(time).add(&one);
                s.scale(time).divide(&below)
            }
            Self::PronyTime { strength, time } => {
                let below = s.scale(time).add(&one);
                s.scale(strength).divide(&below).divide(&below)
            }
            Self::HavriliakNegami { of, order, power, time } => {
                let scaled = s.scale(time);
                let w = scaled.power(exact(order));
                let above = w.add(&one);
                let falling = above.power(exact(-power));
                match of {
                    HavriliakNegamiParameter::Power => falling.multiply(&above.logarithm()),
                    HavriliakNegamiParameter::Order => {
                        falling.divide(&above).multiply(&w).multiply(&scaled.logarithm()).scale(power)
                    }
                    HavriliakNegamiParameter::Time => {
                        falling.divide(&above).multiply(&w).scale(power * order / time)
                    }
                }
            }
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
