//! What a form of transfer functions is.

use super::algebra::{Algebra, Series};
use super::dual::Dual;
use super::fractions::Fractions;
use super::given_weights::GivenWeights;
use super::multistep_rule::MultistepRule;
use super::real::Real;
use super::{Active, Cut, Pole, TransferFunction, UnboundedStart};
use fvi_core::ParameterError;
use nalgebra::Complex;
use std::f64::consts::PI;
use std::fmt;
use std::sync::Arc;

/// A form as files write it.
#[derive(Clone, Copy, Debug)]
pub struct WrittenForm {
    /// The value of `form`.
    pub name: &'static str,
    /// Its parameters in their order.
    pub parameters: &'static [WrittenParameter],
    /// The transfer function of this form, from the numbers of each parameter, as many as
    /// [`parameters`](Self::parameters) and each with one number unless it is a list.
    pub(super) make: fn(&[Vec<f64>]) -> Result<TransferFunction, ParameterError>,
}

impl WrittenForm {
    /// The transfer function with these parameters, in their order.
    ///
    /// # Errors
    /// If their number is another one, or a parameter is outside its range.
    pub fn make(&self, parameters: &[Vec<f64>]) -> Result<TransferFunction, ParameterError> {
        let of_all = self.parameters.len() == parameters.len();
        let each = self.parameters.iter().zip(parameters).all(|(own, given)| own.is_list || given.len() == 1);
        let count = parameters.len() as f64;
        super::check(of_all && each, "number of parameters", count, "as many as the form has")?;
        (self.make)(parameters)
    }
}

/// A parameter of a form as files write it.
#[derive(Clone, Copy, Debug)]
pub struct WrittenParameter {
    /// Its key.
    pub name: &'static str,
    /// True for a list of numbers; the lists of one form have the same length.
    pub is_list: bool,
    /// Its value if the key is missing; `None` if it is required.
    pub default: Option<f64>,
}

impl WrittenParameter {
    pub(super) const fn required(name: &'static str) -> Self {
        Self { name, is_list: false, default: None }
    }

    pub(super) const fn optional(name: &'static str, default: f64) -> Self {
        Self { name, is_list: false, default: Some(default) }
    }

    pub(super) const fn list(name: &'static str) -> Self {
        Self { name, is_list: true, default: None }
    }
}

/// What depends on the form of a transfer function; [`TransferFunction`] describes its methods.
pub(super) trait Form: Values + fmt::Debug + Send + Sync {
    /// Its name in files.
    fn name(&self) -> &'static str;

    fn growth(&self) -> f64;

    fn unrelaxed(&self) -> Option<f64>;

    /// Not yet limited to 1.
    fn creep_power(&self) -> f64 {
        self.growth()
    }

    fn cut(&self) -> Option<Cut> {
        None
    }

    fn jump(&self, _d: f64) -> f64 {
        0.0
    }

    fn poles(&self) -> Vec<Pole> {
        Vec::new()
    }

    fn fractions(&self) -> Option<Fractions> {
        None
    }

    fn is_relaxation(&self) -> bool {
        true
    }

    /// The region where it is not passive.
    fn active(&self) -> Option<Active>;

    fn unbounded_start(&self) -> Option<UnboundedStart> {
        None
    }

    /// The parameter, with its value, on which the width of the cut depends.
    fn narrowing(&self) -> Option<(&'static str, f64)> {
        None
    }

    fn exponent(&self) -> Option<f64> {
        None
    }

    fn spring(&self) -> f64 {
        0.0
    }

    /// Itself including its spring, if it has one.
    fn with_its_spring(&self) -> Option<Arc<dyn Form>> {
        None
    }

    /// True if its value includes a spring that others keep beside it.
    fn includes_its_spring(&self) -> bool {
        false
    }

    fn text(&self) -> Option<&str> {
        None
    }

    fn notes(&self) -> &[String] {
        &[]
    }

    fn numbers(&self) -> &[f64] {
        &[]
    }

    fn table(&self) -> Option<&GivenWeights> {
        None
    }

    fn own_weights(&self, _rule: MultistepRule, _step_size: f64, _count: usize) -> Option<Vec<f64>> {
        None
    }

    fn symbol(&self, rule: MultistepRule, step: f64, z: Complex<f64>) -> Complex<f64> {
        self.value(rule.symbol(z) / step)
    }

    fn is_rounded_formula(&self) -> bool {
        false
    }

    /// For headings.
    fn heading(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())?;
        for (name, numbers) in self.parameters() {
            match numbers[..] {
                [number] => write!(f, ", {name} {number}")?,
                _ => write!(f, ", {name} {numbers:?}")?,
            }
        }
        Ok(())
    }
}

/// The values of a form.
pub(super) trait Values {
    fn value(&self, s: Complex<f64>) -> Complex<f64>;

    fn values(&self, places: &[Complex<f64>]) -> Vec<Complex<f64>> {
        places.iter().map(|&s| self.value(s)).collect()
    }

    fn series(&self, s: &Series) -> Series;

    fn parameters(&self) -> Vec<(&'static str, Vec<f64>)>;

    /// ∂K/∂θ for the parameter θ of this name, for a list that of the place `index`; `None` if there is no
    /// such parameter.
    fn slope(&self, name: &str, index: usize) -> Option<Arc<dyn Slope>>;
}

/// A function K(s; θ) in closed form, written once for every kind of numbers.
pub(super) trait ClosedForm: Clone + fmt::Debug + Send + Sync + 'static {
    /// K(s).
    fn of<A: Algebra>(&self, s: &A) -> A;

    /// The jump of ∂K/∂θ at d beyond the start a of the cut, where −a − d has lost digits of d; θ has the
    /// slope 1.
    fn slope_of_jump(&self, _d: f64) -> Option<f64> {
        None
    }

    /// The poles of ∂K/∂θ, simple ones; θ has the slope 1.
    fn slope_of_poles(&self) -> Vec<Pole> {
        Vec::new()
    }

    /// Its parameters with their names in files, in the order of the formula.
    fn parameters_mut(&mut self) -> Vec<(&'static str, &mut [Real])>;
}

impl<F: ClosedForm> Values for F {
    fn value(&self, s: Complex<f64>) -> Complex<f64> {
        self.of(&s)
    }

    fn series(&self, s: &Series) -> Series {
        self.of(s)
    }

    fn parameters(&self) -> Vec<(&'static str, Vec<f64>)> {
        let mut own = self.clone();
        let numbers = |values: &[Real]| values.iter().map(|value| value.to_f64()).collect();
        own.parameters_mut().into_iter().map(|(name, values)| (name, numbers(values))).collect()
    }

    fn slope(&self, name: &str, index: usize) -> Option<Arc<dyn Slope>> {
        let mut own = self.clone();
        let (_, values) = own.parameters_mut().into_iter().find(|(known, _)| *known == name)?;
        values.get_mut(index)?.slope = 1.0;
        Some(Arc::new(SlopeOf(own)))
    }
}

/// ∂K/∂θ by a parameter θ.
pub(super) trait Slope: fmt::Debug + Send + Sync {
    fn value(&self, s: Complex<f64>) -> Complex<f64>;

    fn series(&self, s: &Series) -> Series;

    /// The imaginary part over π above the cut, at s = −start − d.
    fn jump(&self, start: f64, d: f64) -> f64;

    /// Simple poles that stand for its own.
    fn poles(&self) -> Vec<Pole>;
}

/// ∂K/∂θ of a closed form, of whose parameters θ has the slope 1.
#[derive(Clone, Debug)]
struct SlopeOf<F>(F);

impl<F: ClosedForm> Slope for SlopeOf<F> {
    fn value(&self, s: Complex<f64>) -> Complex<f64> {
        self.0.of(&Dual::constant_in(&s)).slope()
    }

    fn series(&self, s: &Series) -> Series {
        self.0.of(&Dual::constant_in(s)).slope()
    }

    fn jump(&self, start: f64, d: f64) -> f64 {
        let of_value = || self.value(Complex::new(-(start + d), 0.0)).im / PI;
        self.0.slope_of_jump(d).unwrap_or_else(of_value)
    }

    fn poles(&self) -> Vec<Pole> {
        self.0.slope_of_poles()
    }
}

/// One parameter as the slice of its numbers.
pub(super) fn one<'a>(name: &'static str, value: &'a mut Real) -> (&'static str, &'a mut [Real]) {
    (name, std::slice::from_mut(value))
}

/// Numbers that identify a form with its parameters, see [`TransferFunction::key`].
pub(super) fn key(form: &dyn Form) -> Vec<u64> {
    let name = form.name().bytes().map(u64::from);
    let numbers = form.parameters().into_iter().flat_map(|(_, numbers)| {
        std::iter::once(numbers.len() as u64).chain(numbers.into_iter().map(f64::to_bits))
    });
    let text = form.text().unwrap_or("").bytes().map(u64::from);
    let behind = form.numbers().iter().map(|number| number.to_bits());
    let whole = u64::from(form.includes_its_spring());
    std::iter::once(whole).chain(name).chain(numbers).chain(text).chain(behind).collect()
}
