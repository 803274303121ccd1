//! Transfer functions of memories: the damping force as a function K(s) of the Laplace variable.

mod active;
#[doc(hidden)]
pub mod algebra;
#[doc(hidden)]
pub mod derivative;
#[doc(hidden)]
pub mod dual;
#[doc(hidden)]
pub mod estimate;
#[doc(hidden)]
pub mod fractions;
#[doc(hidden)]
pub mod given_weights;
#[doc(hidden)]
pub mod laplace;
#[doc(hidden)]
pub mod multistep_rule;
#[doc(hidden)]
pub mod radiation;
#[doc(hidden)]
pub mod relaxation;
#[doc(hidden)]
pub mod state_space;

use crate::sums::max_or_nan;
pub use active::Active;
use algebra::{Algebra, Series};
use fractions::{Fractions, PoleOfOrder};
use fvi_core::{DoubleDouble, ParameterError};
use given_weights::GivenWeights;
use multistep_rule::MultistepRule;
use nalgebra::Complex;
use std::f64::consts::PI;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

/// The transfer function K(s) of a damping force −ρ K(D) q.
///
/// | constructor | K(s) |
/// |---|---|
/// | [`power`](Self::power) | s^β |
/// | [`tempered`](Self::tempered) | (s + a)^β − a^β |
/// | [`maxwell`](Self::maxwell) | (τs)^β/(1 + (τs)^{β−α}) |
/// | [`prony`](Self::prony) | Σ g τ s/(1 + τ s) |
/// | [`havriliak_negami`](Self::havriliak_negami) | 1 − (1 + (τs)^α)^{−γ} |
/// | [`formula`](Self::formula) | any formula that is analytic off the negative real axis |
/// | [`weights`](Self::weights) | unknown: the weights of one step are given |
///
/// Everything that depends on the form is implemented here: its value, its jump across the cut, its poles,
/// its growth, and the numbers that identify it in tables and files. Powers are principal branches.
///
/// Sources: \[Lubich86\] for the operational calculus; \[Mainardi10\] for the materials.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferFunction {
    form: Form,
}

#[derive(Clone, Debug, PartialEq)]
enum Form {
    Power {
        order: f64,
    },
    Tempered {
        order: f64,
        rate: f64,
    },
    Maxwell {
        order: f64,
        inner: f64,
        time: f64,
    },
    Prony {
        strengths: Vec<f64>,
        times: Vec<f64>,
    },
    HavriliakNegami {
        order: f64,
        power: f64,
        time: f64,
    },
    /// K(s) − K(0), where the spring K(0) is kept separately.
    Formula {
        formula: SharedFormula,
        growth: f64,
        spring: f64,
        is_beside: bool,
        relaxation: bool,
        /// See [`Cut::strip`].
        strip: f64,
        /// Of a rational function.
        fractions: Option<Arc<Fractions>>,
        active: Option<Active>,
    },
    Weights(Arc<GivenWeights>),
}

/// A formula in the Laplace variable.
pub trait Formula: fmt::Debug + Send + Sync {
    /// K(s) for a complex s off the negative real axis, or on its upper side.
    fn value(&self, s: Complex<f64>) -> Complex<f64>;
    /// Bound of the rounding error of [`value`](Self::value), where it is known.
    fn rounding(&self, _s: Complex<f64>) -> f64 {
        0.0
    }
    /// K of a power series; its coefficients are not numbers if K has no such series.
    fn series(&self, s: &Series) -> Series;
    /// Source text: an expression, or the name of the file that it comes from.
    fn text(&self) -> &str;
    /// The name of its form in files.
    fn form(&self) -> &'static str {
        "symbol"
    }
    /// Further parameters with their names in files.
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }
    /// Numbers that the text refers to.
    fn numbers(&self) -> &[f64] {
        &[]
    }
    /// Sentences on how the numbers were amended.
    #[doc(hidden)]
    fn notes(&self) -> &[String] {
        &[]
    }
    /// Its partial fractions, if it is rational.
    fn fractions(&self) -> Option<Fractions> {
        None
    }
    /// Its passivity, if it is known from its form.
    fn passivity(&self) -> Passivity {
        Passivity::Unknown
    }
    /// The first weights of a rule, relative to the first one to rounding, if it has a faster way to them
    /// than its series.
    fn weights(&self, _rule: MultistepRule, _step_size: f64, _count: usize) -> Option<Vec<f64>> {
        None
    }
}

/// What a formula knows of its passivity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Passivity {
    /// It is passive.
    Passive,
    /// It is not, in a region.
    Active(Active),
    /// Nothing: sampling has to show it.
    Unknown,
}

/// A formula that several transfer functions share.
#[derive(Clone, Debug)]
struct SharedFormula(Arc<dyn Formula>);

impl PartialEq for SharedFormula {
    fn eq(&self, other: &Self) -> bool {
        let (one, other) = (&self.0, &other.0);
        one.text() == other.text()
            && one.numbers() == other.numbers()
            && one.parameters() == other.parameters()
    }
}

/// The cut of K on the negative real axis, s = −a − d for d > 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// a ≥ 0.
    pub start: f64,
    /// What a number of double precision leaves out of a.
    pub rest: f64,
    /// ν > −1: the jump begins like d^ν.
    pub power: f64,
    /// Half the width of the strip about the real axis in which the jump is an analytic function of ln d.
    pub strip: f64,
}

/// Width of the narrowest strip for which an integral over the cut is used: the number of points of the rule
/// is proportional to the inverse of the width. The width for Maxwell's form goes to zero as the difference
/// of its orders goes to 1, that for Havriliak and Negami's as its order does: π/x − π, which is 0.01 at x =
/// 0.9968.
const NARROWEST: f64 = 0.01;

/// Rates below this are none: powers of s over them are no numbers.
const NO_RATE: f64 = 1e-140;

/// The start s = −a of a cut beside which K(−a + a u) = 1 − u^{−γ} has no bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnboundedStart {
    /// a > 0.
    pub place: f64,
    /// γ, between 0 and 1.
    pub power: f64,
}

impl UnboundedStart {
    /// K(−a + a eʷ), also where that is −a to rounding.
    pub fn value(&self, w: Complex<f64>) -> Complex<f64> {
        1.0 - (w * -self.power).exponential()
    }
}

/// A simple pole on the negative real axis: K(s) = `residue`/(s + `rate`) + …
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pole {
    /// λ > 0.
    pub rate: f64,
    /// The residue.
    pub residue: f64,
    /// What numbers of double precision leave out of rate and residue.
    pub rests: [f64; 2],
}

const POSITIVE: &str = "positive and finite";

fn positive(parameter: &'static str, value: f64) -> Result<(), ParameterError> {
    check(value > 0.0 && value.is_finite(), parameter, value, POSITIVE)
}

fn check(
    accepted: bool,
    parameter: &'static str,
    value: f64,
    allowed: &'static str,
) -> Result<(), ParameterError> {
    if accepted { Ok(()) } else { Err(ParameterError { parameter, value, allowed }) }
}

impl TransferFunction {
    /// s^β, the fractional derivative; β < 0 is a fractional integral.
    ///
    /// # Errors
    /// If β is outside (−1, 2).
    pub fn power(order: f64) -> Result<Self, ParameterError> {
        check(order > -1.0 && order < 2.0, "exponent", order, "greater than −1 and less than 2")?;
        Ok(Self { form: Form::Power { order } })
    }

    /// (s + a)^β − a^β, a fractional derivative with a longest relaxation time 1/a.
    ///
    /// # Errors
    /// If β is outside (0, 2) or a negative or not finite.
    pub fn tempered(order: f64, rate: f64) -> Result<Self, ParameterError> {
        check(order > 0.0 && order < 2.0, "order", order, "greater than 0 and less than 2")?;
        check(rate >= 0.0 && rate.is_finite(), "rate", rate, "at least 0 and finite")?;
        if rate < NO_RATE || order == 1.0 {
            return Self::power(order);
        }
        Ok(Self { form: Form::Tempered { order, rate } })
    }

    /// (τs)^β/(1 + (τs)^{β−α}): a springpot of order β in series with one of order α, the fractional Maxwell
    /// model; α = 0 is a spring. With a spring beside it the fractional Zener model.
    ///
    /// # Errors
    /// Unless 0 ≤ α < β ≤ 1, and if τ is not positive and finite.
    pub fn maxwell(order: f64, inner: f64, time: f64) -> Result<Self, ParameterError> {
        check(order > 0.0 && order <= 1.0, "order", order, "greater than 0 and at most 1")?;
        check(inner >= 0.0 && inner < order, "inner", inner, "at least 0 and less than the order")?;
        positive("time", time)?;
        if order - inner == 1.0 {
            return Self::prony(&[1.0], &[time]);
        }
        Ok(Self { form: Form::Maxwell { order, inner, time } })
    }

    /// Σ g τ s/(1 + τ s), a Prony series: Maxwell elements in parallel.
    ///
    /// # Errors
    /// If there is no term, the numbers of strengths and times differ, a strength is not finite or all are
    /// zero, or a time not positive and finite.
    pub fn prony(strengths: &[f64], times: &[f64]) -> Result<Self, ParameterError> {
        check(!strengths.is_empty(), "number of strengths", 0.0, "at least 1")?;
        let count = times.len();
        check(count == strengths.len(), "number of times", count as f64, "as many as strengths")?;
        for &strength in strengths {
            check(strength.is_finite(), "strength", strength, "finite")?;
        }
        let some = strengths.iter().any(|&strength| strength != 0.0);
        check(some, "strength", 0.0, "not 0 for one term at least")?;
        times.iter().try_for_each(|&time| positive("time", time))?;
        Ok(Self { form: Form::Prony { strengths: strengths.to_vec(), times: times.to_vec() } })
    }

    /// 1 − (1 + (τs)^α)^{−γ}: Cole–Cole with γ = 1, Cole–Davidson with α = 1.
    ///
    /// # Errors
    /// Unless 0 < α ≤ 1 and γ > 0 and τ > 0, all finite; if α = 1, γ must be at most 1.
    pub fn havriliak_negami(order: f64, power: f64, time: f64) -> Result<Self, ParameterError> {
        check(order > 0.0 && order <= 1.0, "order", order, "greater than 0 and at most 1")?;
        positive("power", power)?;
        check(order < 1.0 || power <= 1.0, "power", power, "at most 1 with order 1")?;
        positive("time", time)?;
        if order == 1.0 && power == 1.0 {
            return Self::prony(&[1.0], &[time]);
        }
        Ok(Self { form: Form::HavriliakNegami { order, power, time } })
    }

    /// K(s) by a formula that is analytic off the negative real axis. Its value at s = 0 is split off as a
    /// [`spring`](Self::spring).
    ///
    /// # Errors
    /// If it is not a real finite number for positive s, or grows like s² or faster.
    pub fn formula(formula: Arc<dyn Formula>) -> Result<Self, ParameterError> {
        check_positive_axis(&*formula)?;
        let growth = growth_of(&*formula);
        let allowed = "a symbol that grows more slowly than s²";
        check(growth.is_finite() && growth < 2.0, "growth of the symbol", growth, allowed)?;
        let allowed = "a symbol that does not vanish like an integral for large s";
        check(growth > -1.0, "growth of the symbol", growth, allowed)?;
        let spring = value_at_zero(&*formula);
        let fractions = formula.fractions().filter(|fractions| are_of(fractions, &*formula)).map(Arc::new);
        let rational = fractions.as_ref().map(|fractions| fractions.is_relaxation());
        let formula = SharedFormula(formula);
        let (relaxation, active, is_beside, strip) = (false, None, true, 0.25 * PI);
        let mut made = Self {
            form: Form::Formula { formula, growth, spring, is_beside, relaxation, strip, fractions, active },
        };
        let (found, drives) = sampled_once(made.key(), || made.sampled(rational));
        if let Form::Formula { relaxation, active, strip, .. } = &mut made.form {
            (*relaxation, *active, *strip) = (found.is_some(), drives, found.unwrap_or(*strip));
        }
        Ok(made)
    }

    /// The strip of its cut if it is a relaxation, and the region where it is not passive; `rational`: for a
    /// rational function, whether it is a relaxation.
    fn sampled(&self, rational: Option<bool>) -> Sampled {
        let passivity = match &self.form {
            Form::Formula { formula, .. } => formula.0.passivity(),
            _ => Passivity::Unknown,
        };
        match passivity {
            Passivity::Passive => (None, None),
            Passivity::Active(active) => (None, Some(active)),
            Passivity::Unknown => {
                let found = match rational {
                    Some(is_relaxation) => is_relaxation.then_some(0.25 * PI),
                    None => self.strip_of_its_cut(),
                };
                (found, self.look_for_activity())
            }
        }
    }

    /// Weights in place of a transfer function: K(s) is then [`GivenWeights::value`].
    pub fn weights(table: GivenWeights) -> Self {
        Self { form: Form::Weights(Arc::new(table)) }
    }

    /// True for a formula whose series may lose digits: one that is not rational, without weights of its own.
    pub(crate) fn is_rounded_formula(&self) -> bool {
        matches!(&self.form, Form::Formula { formula, fractions: None, .. } if formula.0.form() == "symbol")
    }

    /// The weights, if it is given by weights.
    pub fn table(&self) -> Option<&GivenWeights> {
        match &self.form {
            Form::Weights(table) => Some(table),
            _ => None,
        }
    }

    /// The first weights of a rule by a way of its own, see [`Formula::weights`].
    pub(crate) fn own_weights(&self, rule: MultistepRule, step_size: f64, count: usize) -> Option<Vec<f64>> {
        match &self.form {
            Form::Formula { formula, .. } => formula.0.weights(rule, step_size, count),
            _ => None,
        }
    }

    /// K(γ(z)/h) for |z| < 1: Σ w_n zⁿ, whose weights are those of the rule or given.
    pub fn symbol(&self, rule: MultistepRule, step: f64, z: Complex<f64>) -> Complex<f64> {
        match &self.form {
            Form::Weights(table) => table.symbol(z),
            _ => self.value(rule.symbol(z) / step),
        }
    }

    /// β, if this is s^β.
    pub fn exponent(&self) -> Option<f64> {
        match self.form {
            Form::Power { order } => Some(order),
            _ => None,
        }
    }

    /// μ with K(s) ~ s^μ for large s.
    pub fn growth(&self) -> f64 {
        match self.form {
            Form::Power { order } | Form::Tempered { order, .. } => order,
            Form::Maxwell { inner, .. } => inner,
            // Weights act on values, and on q − q₀ in Caputo's form.
            Form::Prony { .. } | Form::HavriliakNegami { .. } | Form::Weights(_) => 0.0,
            Form::Formula { growth, .. } => growth,
        }
    }

    /// γ ≤ 1 if a coordinate without mass that this kernel holds begins to creep like t^γ: μ where K grows,
    /// otherwise the power with which K(∞) − K(s) ~ s^{−γ} vanishes.
    pub fn creep_power(&self) -> f64 {
        let power = match &self.form {
            Form::HavriliakNegami { order, power, .. } => order * power,
            Form::Maxwell { order, inner: 0.0, .. } => *order,
            Form::Prony { .. } | Form::Weights(_) => 1.0,
            Form::Formula { growth, .. } if *growth <= 0.0 => {
                let at = |exponent: f64| self.value(Complex::new(libm::pow(10.0, exponent), 0.0));
                let [near, far] =
                    [[at(4.0), at(8.0)], [at(8.0), at(12.0)]].map(|[one, other]| (other - one).norm());
                // A difference of rounding only is that of a rational function.
                if far > 1e-11 * at(8.0).norm() { libm::log10(near / far) / 4.0 } else { 1.0 }
            }
            _ => self.growth(),
        };
        power.min(1.0)
    }

    /// K(∞), the unrelaxed modulus (glass modulus), the spring included: the force on a jump of the
    /// displacement. `None` if the force has no bound. For weights the first one.
    pub fn unrelaxed(&self) -> Option<f64> {
        match &self.form {
            Form::Power { order } if *order > 0.0 => None,
            Form::Power { order } => Some(if *order == 0.0 { 1.0 } else { 0.0 }),
            Form::Tempered { .. } => None,
            Form::Maxwell { inner, .. } => (*inner == 0.0).then_some(1.0),
            Form::Prony { strengths, .. } => Some(strengths.iter().sum()),
            Form::HavriliakNegami { .. } => Some(1.0),
            Form::Formula { formula, .. } => value_at_infinity(&*formula.0),
            Form::Weights(table) => table.weights().first().copied(),
        }
    }

    /// K(s); on the negative real axis the value on its upper side.
    pub fn value(&self, s: Complex<f64>) -> Complex<f64> {
        match &self.form {
            Form::Formula { formula, spring, is_beside: true, .. } => formula.0.value(s) - spring,
            Form::Formula { formula, .. } => formula.0.value(s),
            Form::Weights(table) => table.value(s),
            _ => self.of(&s),
        }
    }

    /// K of a power series with a positive first coefficient.
    pub fn series(&self, s: &Series) -> Series {
        match &self.form {
            Form::Formula { formula, spring, is_beside: true, .. } => {
                formula.0.series(s).add(&s.constant(-spring))
            }
            Form::Formula { formula, .. } => formula.0.series(s),
            _ => self.of(s),
        }
    }

    fn of<A: Algebra>(&self, s: &A) -> A {
        let exact = DoubleDouble::exact;
        match &self.form {
            Form::Power { order } => s.power(exact(*order)),
            // a^β ((1 + s/a)^β − 1) keeps its digits where s is small, (s + a)^β − a^β where it is large.
            Form::Tempered { order, rate } => {
                let scale = exact(*rate);
                let base = s.constant(*rate).power(exact(*order));
                s.divide(&s.constant(scale.to_f64())).power_beside_one(*order).multiply(&base)
            }
            Form::Maxwell { order, inner, time } => {
                let scaled = s.scale(*time);
                let between = exact(*order).add(exact(-*inner));
                let below = scaled.power(between).add(&s.constant(1.0));
                scaled.power(exact(*order)).divide(&below)
            }
            Form::Prony { strengths, times } => {
                let terms = strengths.iter().zip(times).map(|(&strength, &time)| {
                    let scaled = s.scale(time);
                    scaled.scale(strength).divide(&scaled.add(&s.constant(1.0)))
                });
                terms.fold(s.constant(0.0), |sum, term| sum.add(&term))
            }
            Form::HavriliakNegami { order, power, time } => {
                s.scale(*time).power(exact(*order)).power_beside_one(-*power).negate()
            }
            // A table of weights cannot be evaluated for a series.
            Form::Formula { .. } | Form::Weights(_) => s.constant(f64::NAN),
        }
    }

    /// The cut on the negative real axis; `None` if there is none, as for integer powers and sums of poles.
    /// The cut of a formula is assumed to begin at s = 0.
    pub fn cut(&self) -> Option<Cut> {
        let half = 0.5 * PI;
        match self.form {
            Form::Power { order } if order.fract() == 0.0 => None,
            Form::Power { order } => Some(Cut { start: 0.0, rest: 0.0, power: order, strip: half }),
            Form::Tempered { order, rate } => Some(Cut { start: rate, rest: 0.0, power: order, strip: half }),
            Form::Maxwell { order, inner, .. } => {
                // Beyond the cut 1 + (τs)^{β−α} vanishes at the angle π/(β − α). (τs)^1 itself has no jump.
                let power = if order == 1.0 { 2.0 - inner } else { order };
                Some(Cut { start: 0.0, rest: 0.0, power, strip: half.min(PI / (order - inner) - PI) })
            }
            Form::HavriliakNegami { order: 1.0, power, time } => {
                let [start, rest] = ratio(1.0, time);
                Some(Cut { start, rest, power: -power, strip: half })
            }
            Form::HavriliakNegami { order, .. } => {
                Some(Cut { start: 0.0, rest: 0.0, power: order, strip: half.min(PI / order - PI) })
            }
            Form::Prony { .. } | Form::Weights(_) | Form::Formula { fractions: Some(_), .. } => None,
            Form::Formula { strip, .. } => {
                let size = |d: f64| self.jump(d).abs();
                let (near, far) = (size(1e-40), size(1e-30));
                let power = (libm::log10(far) - libm::log10(near)) / 10.0;
                (power.is_finite() && power > -1.0).then_some(Cut { start: 0.0, rest: 0.0, power, strip })
            }
        }
    }

    /// The start of its cut, if K has no bound there.
    pub fn unbounded_start(&self) -> Option<UnboundedStart> {
        match self.form {
            Form::HavriliakNegami { order: 1.0, power, time } => {
                Some(UnboundedStart { place: ratio(1.0, time)[0], power })
            }
            _ => None,
        }
    }

    /// The parameter that makes the cut so narrow that an integral over it would need too many points; `None`
    /// if the cut is wide enough.
    pub fn narrow(&self) -> Option<ParameterError> {
        let allowed = "exactly 1, or at most 0.9968: between these the integral over the cut of K(s) takes too many points, and weights \
                       come from transforms, with `convolution.family` = \"bdf\" and the engines \"direct\", \"block-fft\" and \
                       \"real-time\" alone";
        let (parameter, value) = match self.form {
            Form::Maxwell { order, inner, .. } => ("`order` − `inner` of the kernel", order - inner),
            Form::HavriliakNegami { order, .. } => ("`order` of the kernel", order),
            _ => return None,
        };
        let is_narrow = self.cut().is_some_and(|cut| cut.strip < NARROWEST);
        is_narrow.then_some(ParameterError { parameter, value, allowed })
    }

    /// Im K(−a − d + i0)/π beyond the start a of the [`cut`](Self::cut).
    pub fn jump(&self, d: f64) -> f64 {
        match self.form {
            Form::Power { order } | Form::Tempered { order, .. } => {
                libm::pow(d, order) * sine_of_turns(order) / PI
            }
            Form::Maxwell { order, inner, time } => {
                // Im [u/(1 + v)] with u = (τx)^β e^{iπβ}, v = (τx)^{β−α} e^{iπ(β−α)}.
                let between = order - inner;
                let (u, v) = (libm::pow(time * d, order), libm::pow(time * d, between));
                let cosine = sine_of_turns(0.5 - 0.5 * between);
                let below = (1.0 - v) * (1.0 - v) + 4.0 * v * cosine * cosine;
                u * (sine_of_turns(order) + v * sine_of_turns(inner)) / below / PI
            }
            Form::HavriliakNegami { order: 1.0, power, time } => {
                libm::pow(time * d, -power) * sine_of_turns(power) / PI
            }
            Form::HavriliakNegami { order, power, time } => {
                let w = libm::pow(time * d, order);
                let (re, im) = (1.0 + w * sine_of_turns(0.5 - order), w * sine_of_turns(order));
                libm::pow(libm::hypot(re, im), -power) * libm::sin(power * libm::atan2(im, re)) / PI
            }
            Form::Prony { .. } | Form::Weights(_) | Form::Formula { fractions: Some(_), .. } => 0.0,
            Form::Formula { ref formula, .. } => formula.0.value(Complex::new(-d, 0.0)).im / PI,
        }
    }

    /// Simple poles on the negative real axis.
    pub fn poles(&self) -> Vec<Pole> {
        match &self.form {
            // g τ s/(1 + τ s) = g − (g/τ)/(s + 1/τ)
            Form::Prony { strengths, times } => {
                // An element without strength has no pole.
                let poles = strengths.iter().zip(times).filter(|(strength, _)| **strength != 0.0);
                let pole = |(&g, &time): (&f64, &f64)| {
                    let ([rate, rest], [residue, rest_of_residue]) = (ratio(1.0, time), ratio(-g, time));
                    Pole { rate, residue, rests: [rest, rest_of_residue] }
                };
                poles.map(pole).collect()
            }
            Form::Formula { fractions: Some(fractions), relaxation: true, .. } => {
                let residue = |pole: &PoleOfOrder| pole.coefficients.iter().map(|a| a.re).sum();
                let poles = fractions.poles.iter();
                poles
                    .map(|pole| Pole { rate: -pole.place.re, residue: residue(pole), rests: [0.0; 2] })
                    .collect()
            }
            _ => Vec::new(),
        }
    }

    /// K(s), its spring included, in partial fractions; `None` if it is not known to be rational.
    pub fn fractions(&self) -> Option<Fractions> {
        match &self.form {
            Form::Power { order: 0.0 } => Some(Fractions::constant(1.0)),
            Form::Power { order: 1.0 } => Some(Fractions { direct: [0.0, 1.0], poles: Vec::new() }),
            Form::Prony { strengths, .. } => {
                let poles = self.poles().into_iter().map(|pole| PoleOfOrder {
                    place: Complex::new(-pole.rate, 0.0),
                    coefficients: vec![Complex::new(pole.residue, 0.0)],
                });
                let terms = poles.map(|pole| Fractions { direct: [0.0; 2], poles: vec![pole] });
                Some(terms.fold(Fractions::constant(strengths.iter().sum()), Fractions::plus))
            }
            Form::Formula { fractions, .. } => fractions.as_deref().cloned(),
            _ => None,
        }
    }

    /// Half the width of the strip about the real axis in which the jump of a formula is an analytic function
    /// of ln d, from π/4 down by halves; `None` if the formula has singularities off its cut, or grows like s
    /// or faster.
    ///
    /// The trapezoidal rule in ln x with the spacing for a strip makes up second divided differences of
    /// K(s) = ∫ s (Im K(−x + i0)/π)/(x (s + x)) dx, at some s:
    ///
    /// ```text
    /// K[s₁, s₂, s₃] = −∫ (Im K(−x + i0)/π)/((s₁ + x)(s₂ + x)(s₃ + x)) dx ,
    /// ```
    ///
    /// which converges like x^{1+ν} at 0 and x^{µ−2} at infinity, where K itself takes x^ν and x^{µ−1}: for
    /// powers near 0 and 1 these are not small within the numbers there are. Half the spacing squares the
    /// error of the rule, and leaves that of other singularities.
    fn strip_of_its_cut(&self) -> Option<f64> {
        const WIDEST: f64 = 0.25 * PI;
        // What a spacing that is twice as wide leaves, so that this one leaves less than rounding.
        const COARSE: f64 = 3e5;
        if self.growth() >= 1.0 {
            return None;
        }
        let error_for = |strip: f64| self.error_of_its_cut(2.0 * PI * strip / 42.0);
        let mut before = error_for(2.0 * WIDEST);
        let mut strip = WIDEST;
        while strip > NARROWEST {
            let error = error_for(strip);
            if error <= 1.0 && before <= COARSE {
                return Some(strip);
            }
            if error.is_nan() || (error > 1.0 && error > 0.9 * before) {
                return None;
            }
            (before, strip) = (error, 0.5 * strip);
        }
        None
    }

    /// The largest difference of a trapezoidal rule over the cut from K, in units of its bound; NaN for
    /// values that are no numbers.
    fn error_of_its_cut(&self, spacing: f64) -> f64 {
        const REACH: f64 = 92.0;
        const BOUND: f64 = 1e-13;
        const ROUNDING: f64 = 1e-14;
        let count = (REACH / spacing) as i32;
        let jumps: Vec<(f64, f64)> = (-count..=count)
            .map(|k| libm::exp(spacing * f64::from(k)))
            .map(|x| (x, spacing * x * self.jump(x)))
            .collect();
        let at = |s: f64| self.value(Complex::new(s, 0.0)).re;
        (-9..=9).map(|decade| libm::exp10(f64::from(decade))).fold(0.0, |worst, s| {
            let [first, middle, last] = [s, 4.0 * s, 16.0 * s];
            let sum: f64 = jumps.iter().map(|(x, jump)| jump / (first + x) / (middle + x) / (last + x)).sum();
            let values = [at(first), at(middle), at(last)];
            let slope = |from: usize, ends: [f64; 2]| (values[from + 1] - values[from]) / (ends[1] - ends[0]);
            let bend = (slope(1, [middle, last]) - slope(0, [first, middle])) / (last - first);
            // Where K is nearly constant, or nearly linear, its bend has the rounding error of its values.
            let size = values.iter().map(|value| value.abs()).fold(0.0, max_or_nan);
            let rounding = (ROUNDING * size + 20.0 * rounding_error(at, s)) / (s * s);
            let error = (sum + bend).abs() / (BOUND * bend.abs() + rounding);
            if error.is_nan() || error > worst { error } else { worst }
        })
    }

    /// True if the kernel is determined by cut and poles: its response is a sum of decaying exponentials.
    pub fn is_relaxation(&self) -> bool {
        !matches!(self.form, Form::Formula { relaxation: false, .. } | Form::Weights(_))
    }

    /// The k-th derivative of L⁻¹\[K\](t) at a time t > 0, from the jump across the cut and the poles; `None`
    /// for formulas that have other singularities or grow like s or faster.
    ///
    /// ```text
    /// L⁻¹[K](t) = −∫₀^∞ e^{−xt} Im K(−x + i0)/π dx + Σ_poles residue e^{−λt}
    /// ```
    pub fn response(&self, time: f64, k: i32) -> Option<f64> {
        if !self.is_relaxation() {
            return None;
        }
        let decayed = |rate: f64| (-rate).powi(k) * libm::exp(-rate * time);
        let poles: f64 = self.poles().iter().map(|pole| pole.residue * decayed(pole.rate)).sum();
        let Some(cut) = self.cut() else { return Some(poles) };
        // The trapezoidal rule in ln(x t) over the range where the integrand is above rounding.
        let spacing = 2.0 * PI * cut.strip / 42.0;
        let lowest = -40.0 / (1.0 + cut.power + if cut.start == 0.0 { f64::from(k) } else { 0.0 });
        let highest = libm::log(60.0);
        let nodes = ((highest - lowest) / spacing).ceil() as usize;
        let node = |index: usize| {
            let d = libm::exp(lowest + spacing * index as f64) / time;
            d * self.jump(d) * decayed(cut.start + d)
        };
        Some(poles - spacing * (0..=nodes).map(node).sum::<f64>())
    }

    /// K including K(0), for K(D) of a signal: its first weight includes the spring, and a memory acts on
    /// values.
    #[must_use]
    pub fn with_its_spring(mut self) -> Self {
        if let Form::Formula { is_beside, .. } = &mut self.form {
            *is_beside = false;
        }
        self
    }

    /// K(0) of a formula, the stiffness of the spring beside the memory: [`value`](Self::value) and
    /// [`series`](Self::series) do not include it, except for a kernel
    /// [`with_its_spring`](Self::with_its_spring).
    pub fn spring(&self) -> f64 {
        match self.form {
            Form::Formula { spring, .. } => spring,
            _ => 0.0,
        }
    }

    /// The region where K is not passive; `None` if R(s) = K(s)/s is positive real, as far as sampling shows.
    ///
    /// The passivity of most forms follows from their formula. Others are sampled on the imaginary axis and
    /// on rays into the right half-plane, at forty and ten places per decade over sixty decades, and more
    /// densely where the real part of R is small.
    pub fn active(&self) -> Option<Active> {
        match &self.form {
            Form::Power { order } if *order >= 0.0 => None,
            Form::Tempered { .. } | Form::Maxwell { .. } => None,
            Form::Prony { strengths, .. } if strengths.iter().all(|&strength| strength >= 0.0) => None,
            Form::HavriliakNegami { order, power, .. } if order * power <= 1.0 => None,
            Form::Formula { active, .. } => *active,
            Form::Weights(table) => table.active(),
            _ => self.look_for_activity(),
        }
    }

    fn look_for_activity(&self) -> Option<Active> {
        if self.spring() < 0.0 {
            // The static force is repulsive.
            let place = Complex::new(f64::MIN_POSITIVE, 0.0);
            return Some(Active { place, resistance: -1.0, from: None, to: None });
        }
        let resistance = |angle: f64, logarithm: f64| {
            let size = libm::exp10(logarithm);
            // On the imaginary axis Re K(iω)/(iω) is Im K/ω, without the rounding of a cosine.
            let s = if angle == 0.5 * PI {
                Complex::new(0.0, size)
            } else {
                Complex::new(size * libm::cos(angle), size * libm::sin(angle))
            };
            let value = self.value(s);
            let ratio = value / s;
            // Of K(s) − K(0) the rounding of K(0) is left.
            let rounding = 4.0 * f64::EPSILON * self.spring().abs() / value.norm();
            (s, ratio.re / ratio.norm() + rounding)
        };
        const DECADES: i32 = 30;
        // Rounding error of formulas with cancellation.
        const ROUNDING: f64 = -1e-9;
        let (first, last) = (-f64::from(DECADES), f64::from(DECADES));
        for angle in [0.5 * PI, 0.45 * PI, 0.4 * PI, 0.3 * PI, 0.2 * PI, 0.1 * PI, 0.0] {
            // Resonances are narrow next to the axis only; the rays are 0.3 apart, which is a seventh of a
            // decade.
            let per_decade = if angle == 0.5 * PI { 40 } else { 10 };
            let at = |k: i32| f64::from(k) / f64::from(per_decade);
            // A value that is not a number, from under- or overflow, is ignored.
            let value = |logarithm: f64| resistance(angle, logarithm).1;
            let drives = |logarithm: f64| value(logarithm) < ROUNDING;
            let mut looks: Vec<(f64, f64)> =
                (-DECADES * per_decade..=DECADES * per_decade).map(|k| (at(k), value(at(k)))).collect();
            let mut grounds = Vec::new();
            for looks in looks.windows(3) {
                if looks[1].1 <= looks[0].1 && looks[1].1 <= looks[2].1 && looks[1].1 < 0.1 {
                    // A minimum: golden-section search.
                    let (mut low, mut high) = (looks[0].0, looks[2].0);
                    for _ in 0..40 {
                        let (left, right) = (high - 0.618 * (high - low), low + 0.618 * (high - low));
                        if value(left) < value(right) {
                            high = right;
                        } else {
                            low = left;
                        }
                    }
                    grounds.push((0.5 * (low + high), value(0.5 * (low + high))));
                }
            }
            looks.extend(grounds);
            looks.sort_by(|one, other| one.0.total_cmp(&other.0));
            let Some(begin) = looks.iter().position(|look| look.1 < ROUNDING) else { continue };
            let end = looks[begin..].iter().position(|look| look.1 >= ROUNDING);
            let end = end.map_or(looks.len(), |count| begin + count);
            // Bisection between a place that is not passive and one that is.
            let edge = |mut inside: f64, mut outside: f64| {
                for _ in 0..40 {
                    let middle = 0.5 * (inside + outside);
                    if drives(middle) { inside = middle } else { outside = middle }
                }
                libm::exp10(inside)
            };
            let from = (begin > 0).then(|| edge(looks[begin].0, looks[begin - 1].0));
            let to = looks.get(end).map(|beyond| edge(looks[end - 1].0, beyond.0));
            let worst = looks[begin..end].iter().min_by(|one, other| one.1.total_cmp(&other.1));
            let (place, resistance) =
                resistance(angle, worst.map_or(first, |worst| worst.0.clamp(first, last)));
            return Some(Active { place, resistance, from, to });
        }
        None
    }

    /// The name of its form in files.
    pub fn form(&self) -> &'static str {
        match &self.form {
            Form::Power { .. } => "power",
            Form::Tempered { .. } => "tempered",
            Form::Maxwell { .. } => "maxwell",
            Form::Prony { .. } => "prony",
            Form::HavriliakNegami { .. } => "havriliak-negami",
            Form::Formula { formula, .. } => formula.0.form(),
            Form::Weights(_) => "weights",
        }
    }

    /// Its parameters with their names in files, in the order of the formula; each name once, with all its
    /// values.
    pub fn parameters(&self) -> Vec<(&'static str, Vec<f64>)> {
        let one = |number: f64| vec![number];
        match &self.form {
            Form::Power { order } => vec![("order", one(*order))],
            Form::Tempered { order, rate } => vec![("order", one(*order)), ("rate", one(*rate))],
            Form::Maxwell { order, inner, time } => {
                vec![("order", one(*order)), ("inner", one(*inner)), ("time", one(*time))]
            }
            Form::Prony { strengths, times } => {
                vec![("strengths", strengths.clone()), ("times", times.clone())]
            }
            Form::HavriliakNegami { order, power, time } => {
                vec![("order", one(*order)), ("power", one(*power)), ("time", one(*time))]
            }
            Form::Formula { formula, .. } => {
                formula.0.parameters().into_iter().map(|(name, number)| (name, one(number))).collect()
            }
            Form::Weights(table) => table.step().map(|step| ("step", one(step))).into_iter().collect(),
        }
    }

    /// The text of a formula, or the name of a file; empty for rows given directly.
    pub fn text(&self) -> Option<&str> {
        match &self.form {
            Form::Formula { formula, .. } => Some(formula.0.text()),
            Form::Weights(table) => Some(table.name()),
            _ => None,
        }
    }

    /// Sentences on how the numbers of a file were amended.
    #[doc(hidden)]
    pub fn notes(&self) -> &[String] {
        match &self.form {
            Form::Formula { formula, .. } => formula.0.notes(),
            _ => &[],
        }
    }

    /// The numbers that the text of a formula, or a file, contains.
    pub fn numbers(&self) -> &[f64] {
        match &self.form {
            Form::Formula { formula, .. } => formula.0.numbers(),
            Form::Weights(table) => table.weights(),
            _ => &[],
        }
    }

    /// Numbers that identify it: equal keys have equal weights.
    pub fn key(&self) -> Vec<u64> {
        let form = self.form().bytes().next().map_or(0, u64::from);
        let numbers = self.parameters().into_iter().flat_map(|(_, numbers)| {
            std::iter::once(numbers.len() as u64).chain(numbers.into_iter().map(f64::to_bits))
        });
        let text = self.text().unwrap_or("").bytes().map(u64::from);
        let behind = self.numbers().iter().map(|number| number.to_bits());
        let whole = u64::from(matches!(self.form, Form::Formula { is_beside: false, .. }));
        [form, whole].into_iter().chain(numbers).chain(text).chain(behind).collect()
    }
}

/// For headings: `s^0.5`, or the form with its parameters.
impl fmt::Display for TransferFunction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.form {
            Form::Power { order } => write!(f, "s^{order}"),
            Form::Tempered { order, rate } => write!(f, "(s + {rate})^{order} − {rate}^{order}"),
            Form::Formula { formula, .. } => f.write_str(formula.0.text()),
            Form::Weights(table) => {
                write!(f, "{} weights", table.weights().len())?;
                if table.name().is_empty() { Ok(()) } else { write!(f, " of {}", table.name()) }
            }
            _ => {
                f.write_str(self.form())?;
                for (name, numbers) in self.parameters() {
                    match numbers[..] {
                        [number] => write!(f, ", {name} {number}")?,
                        _ => write!(f, ", {name} {numbers:?}")?,
                    }
                }
                Ok(())
            }
        }
    }
}

/// What sampling a formula shows: the strip of its cut, if that makes it up, and where it is not passive.
type Sampled = (Option<f64>, Option<Active>);

/// Largest number of formulas of which that is remembered.
const MOST_REMEMBERED: usize = 64;

/// What sampling a formula with this key shows: computed once for the runs of a fit or sweep that have it.
fn sampled_once(key: Vec<u64>, sample: impl FnOnce() -> Sampled) -> Sampled {
    static REMEMBERED: Mutex<Vec<(Vec<u64>, Sampled)>> = Mutex::new(Vec::new());
    let remembered = || REMEMBERED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, known)) = remembered().iter().find(|(known, _)| *known == key) {
        return *known;
    }
    let found = sample();
    let mut remembered = remembered();
    if remembered.len() == MOST_REMEMBERED {
        remembered.remove(0);
    }
    remembered.push((key, found));
    found
}

/// Refuses a formula that is not a real number for every s > 0, or loses all its digits there.
fn check_positive_axis(formula: &dyn Formula) -> Result<(), ParameterError> {
    /// Largest rounding error relative to the value, and to values of moderate s.
    const MOST_LOST: f64 = 1e-6;
    let at = |exponent: i32| Complex::new(libm::exp10(f64::from(exponent)), 0.0);
    let size = |exponent: i32| formula.value(at(exponent)).norm();
    let moderate = (-3..=3).map(size).filter(|size| size.is_finite()).fold(0.0, max_or_nan);
    let place = |exponent: i32| (at(exponent), formula.value(at(exponent)), formula.rounding(at(exponent)));
    let places: Vec<_> = (-60..=60).map(place).collect();
    let parameter = "symbol at a positive s";
    for &(s, value, error) in &places {
        let allowed = "a finite number for every s > 0: this one divides by 0 there, or overflows (sinh(x)/cosh(x) is tanh(x), \
                       1/exp(x) is exp(-x))";
        check(value.is_finite(), parameter, s.re, allowed)?;
        let allowed = "a real number for every s > 0";
        check(value.im.abs() <= 1e-9 * value.re.abs() + error, parameter, s.re, allowed)?;
    }
    for &(s, value, error) in &places {
        let allowed = "a symbol whose terms do not cancel: rounding exceeds its value there, which is to be written without \
                       the difference, such as 1/(sqrt(1 + s) + 1) in place of (sqrt(1 + s) - 1)/s";
        check(error <= MOST_LOST * value.norm().max(moderate), parameter, s.re, allowed)?;
    }
    Ok(())
}

/// μ with K(s) ~ s^μ for large s in the right half-plane.
///
/// It is taken on the positive axis, and on the imaginary axis where K underflows there or grows faster, as
/// with a factor e^{−s}. What underflows on both, like e^{−√s}, falls faster than any power; its memory is
/// that of a kernel with a bound, μ = 0.
fn growth_of(formula: &dyn Formula) -> f64 {
    /// Of a periodic factor on the imaginary axis.
    const SWINGS: f64 = 0.25;
    let slope = |near: f64, far: f64| {
        let slope = (libm::log10(far) - libm::log10(near)) / 10.0;
        // To as many digits as are reliable for a formula without a power law at infinity.
        (slope * 1e6).round() / 1e6
    };
    let real = |exponent: f64| formula.value(Complex::new(libm::exp10(exponent), 0.0)).norm();
    // The largest of several places, since a factor may be periodic.
    let imaginary = |exponent: f64| {
        let at = |k: i32| Complex::new(0.0, libm::exp10(exponent) * (1.0 + 0.1 * f64::from(k)));
        (0..16).map(|k| formula.value(at(k)).norm()).filter(|size| !size.is_nan()).fold(0.0, max_or_nan)
    };
    let along = slope(imaginary(50.0), imaginary(60.0));
    let growth = slope(real(50.0), real(60.0));
    if real(60.0) == 0.0 {
        return if imaginary(60.0) == 0.0 { 0.0 } else { along };
    }
    if along > growth + SWINGS { along } else { growth }
}

/// Places 10^{±(10 + 5k)} from which limits of a formula are taken.
const PLACES: usize = 11;
const APART: f64 = 5.0;

/// K(0) of a formula; 0 if it decays to zero, or to the rounding error of a sum.
pub(crate) fn value_at_zero(formula: &dyn Formula) -> f64 {
    let at = |exponent: f64| formula.value(Complex::new(libm::exp10(exponent), 0.0)).re;
    let (near, far) = (at(-60.0), at(-50.0));
    let is_large = |value: f64| value.abs() > 1e-13 * at(0.0).abs();
    if (near - far).abs() <= 1e-9 * near.abs() {
        return if is_large(near) { near } else { 0.0 };
    }
    // Beside low powers of s a constant is not yet alone. Limits from different places agree.
    let values: Vec<f64> = (0..PLACES).map(|k| at(-10.0 - APART * k as f64)).collect();
    match [&values[2..], &values[1..PLACES - 1], &values[..PLACES - 2]].map(limit) {
        [Some(limit), Some(one), Some(other)] => {
            let agree = (limit - one).abs().max((limit - other).abs()) <= 1e-8 * limit.abs();
            if agree && is_large(limit) { limit } else { 0.0 }
        }
        _ => 0.0,
    }
}

/// K(∞) of a formula; `None` if it has no bound.
fn value_at_infinity(formula: &dyn Formula) -> Option<f64> {
    let at = |k: usize| formula.value(Complex::new(libm::exp10(10.0 + APART * k as f64), 0.0)).re;
    limit(&(0..PLACES).map(at).collect::<Vec<f64>>())
}

/// The limit of values at equidistant exponents; `None` if there is none.
///
/// Where the last ones still differ, as those of low powers of s do, the limit is that of Wynn's ε-algorithm,
/// which is exact for sums of powers that decay. A difference that does not decrease belongs to a power that
/// grows, or to a logarithm.
fn limit(values: &[f64]) -> Option<f64> {
    let &[.., before, near, far] = values else { return None };
    let (change, earlier) = ((far - near).abs(), (near - before).abs());
    if change <= 1e-14 * far.abs() {
        return Some(far);
    }
    // Of a power with the exponent −10⁻³ a change leaves 0.9886.
    if change.is_nan() || change >= 0.99 * earlier {
        return None;
    }
    if far.abs() < 1e-3 * near.abs() {
        return Some(0.0);
    }
    let (mut odd, mut even) = (vec![0.0; values.len() + 1], values.to_vec());
    let mut limit = far;
    while even.len() > 2 {
        let next = |odd: &[f64], even: &[f64]| -> Vec<f64> {
            let steps = even.windows(2).zip(&odd[1..]);
            steps.map(|(pair, &odd)| odd + (pair[1] - pair[0]).recip()).collect()
        };
        odd = next(&odd, &even);
        even = next(&even, &odd);
        match even.last() {
            Some(&last) if last.is_finite() => limit = last,
            _ => break,
        }
    }
    Some(limit)
}

/// True if partial fractions are those of a formula: they agree on rays into the right half-plane, relative
/// to their terms.
fn are_of(fractions: &Fractions, formula: &dyn Formula) -> bool {
    let agree = |angle: f64, exponent: i32| {
        let size = libm::exp10(f64::from(exponent));
        let s = Complex::new(size * libm::cos(angle), size * libm::sin(angle));
        let (found, known) = (fractions.value(s), formula.value(s));
        // Powers of very large and very small s are no numbers.
        let is_finite = known.re.is_finite() && known.im.is_finite();
        !is_finite || (found - known).norm() <= 1e-11 * fractions.size(s)
    };
    [0.0, 0.9, 1.5].into_iter().all(|angle| (-24..=24).all(|exponent| agree(angle, exponent)))
}

/// Rounding error of a smooth function near a place: its third differences at distances whose cubes are none.
fn rounding_error(of: impl Fn(f64) -> f64, place: f64) -> f64 {
    let values: Vec<f64> = (0..12).map(|k| of(place * (1.0 + 1e-6 * f64::from(k)))).collect();
    let third = |values: &[f64]| values[3] - 3.0 * values[2] + 3.0 * values[1] - values[0];
    values.windows(4).map(third).map(|error| error.abs()).fold(0.0, max_or_nan)
}

/// a/b, and what rounding leaves out of it.
fn ratio(a: f64, b: f64) -> [f64; 2] {
    let ratio = a / b;
    [ratio, -libm::fma(ratio, b, -a) / b]
}

/// sin πx, right to rounding near whole numbers.
fn sine_of_turns(x: f64) -> f64 {
    let nearest = x.round();
    let sine = libm::sin(PI * (x - nearest));
    if nearest.rem_euclid(2.0) == 0.0 { sine } else { -sine }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn forms() -> Vec<TransferFunction> {
        vec![
            TransferFunction::power(0.5).unwrap(),
            TransferFunction::power(1.7).unwrap(),
            TransferFunction::tempered(0.5, 0.3).unwrap(),
            TransferFunction::tempered(1.5, 2.0).unwrap(),
            TransferFunction::maxwell(0.6, 0.0, 1.5).unwrap(),
            TransferFunction::maxwell(0.9, 0.4, 0.5).unwrap(),
            TransferFunction::maxwell(1.0, 0.3, 0.5).unwrap(),
            TransferFunction::prony(&[1.0, 0.7], &[1.0, 0.1]).unwrap(),
            TransferFunction::havriliak_negami(0.7, 0.5, 1.0).unwrap(),
            TransferFunction::havriliak_negami(1.0, 0.5, 2.0).unwrap(),
        ]
    }

    #[test]
    fn the_jump_is_the_imaginary_part_above_the_cut() {
        for transfer in forms() {
            let Some(cut) = transfer.cut() else { continue };
            for d in [1e-3, 0.2, 1.0, 7.0, 300.0] {
                let above = transfer.value(Complex::new(-cut.start - d, 0.0));
                let error = (transfer.jump(d) - above.im / PI).abs();
                // −a − d has the rounding error of a, relative to d.
                let rounding = 1e-13 * above.im.abs() + 1e-15 * (1.0 + cut.start / d) * above.norm();
                assert!(error <= rounding, "{transfer}, {d}: {} {above}", transfer.jump(d));
            }
            // The jump begins like d^ν.
            let ratio = transfer.jump(2e-12) / transfer.jump(1e-12);
            assert!((ratio.log2() - cut.power).abs() < 1e-3, "{transfer}: {}", ratio.log2());
        }
    }

    #[test]
    fn poles_are_those_of_the_value() {
        let transfer = TransferFunction::prony(&[1.0, 0.7], &[1.0, 0.1]).unwrap();
        let direct = |s: f64| s / (1.0 + s) + 0.7 * 0.1 * s / (1.0 + 0.1 * s);
        for s in [0.1, 1.0, 30.0] {
            let poles = transfer.poles().iter().map(|pole| pole.residue / (s + pole.rate)).sum::<f64>() + 1.7;
            assert!((poles - direct(s)).abs() < 1e-15);
            assert!((transfer.value(Complex::new(s, 0.0)).re - direct(s)).abs() < 1e-15);
        }
    }

    #[test]
    fn responses_are_inverse_transforms() {
        // L⁻¹[s^β] = t^{−β−1}/Γ(−β); with e^{−at} for (s + a)^β.
        for (order, time) in [(0.5, 0.3), (1.7, 2.0), (0.9, 1e-3)] {
            let gamma = |x: f64| libm::tgamma(x);
            let power = |x: f64| libm::pow(time, x);
            let first = power(-order - 1.0) / gamma(-order);
            let second = power(-order - 3.0) / gamma(-order - 2.0);
            let (transfer, rate) = (TransferFunction::power(order).unwrap(), 0.4);
            assert!((transfer.response(time, 0).unwrap() / first - 1.0).abs() < 1e-12);
            assert!((transfer.response(time, 2).unwrap() / second - 1.0).abs() < 1e-12);
            let tempered = TransferFunction::tempered(order, rate).unwrap();
            let expected = first * libm::exp(-rate * time);
            assert!((tempered.response(time, 0).unwrap() / expected - 1.0).abs() < 1e-12);
        }
        let prony = TransferFunction::prony(&[2.0], &[0.5]).unwrap();
        assert!((prony.response(0.25, 0).unwrap() + 4.0 * libm::exp(-0.5)).abs() < 1e-15);
    }

    #[test]
    fn special_cases_are_told_by_their_simplest_form() {
        let power = |order| TransferFunction::power(order).unwrap();
        assert_eq!(TransferFunction::tempered(0.5, 0.0).unwrap(), power(0.5));
        assert_eq!(TransferFunction::tempered(1.5, 1e-300).unwrap(), power(1.5));
        assert_eq!(TransferFunction::tempered(1.0, 3.0).unwrap(), power(1.0));
        let debye = TransferFunction::prony(&[1.0], &[2.0]).unwrap();
        assert_eq!(TransferFunction::maxwell(1.0, 0.0, 2.0).unwrap(), debye);
        assert_eq!(TransferFunction::havriliak_negami(1.0, 1.0, 2.0).unwrap(), debye);
    }

    #[test]
    fn parameters_outside_their_ranges_are_refused() {
        let parameter = |made: Result<TransferFunction, ParameterError>| made.unwrap_err().parameter;
        assert_eq!(parameter(TransferFunction::power(2.0)), "exponent");
        assert_eq!(parameter(TransferFunction::tempered(0.0, 1.0)), "order");
        assert_eq!(parameter(TransferFunction::tempered(0.5, -1.0)), "rate");
        assert_eq!(parameter(TransferFunction::maxwell(1.1, 0.0, 1.0)), "order");
        assert_eq!(parameter(TransferFunction::maxwell(0.5, 0.5, 1.0)), "inner");
        assert_eq!(parameter(TransferFunction::maxwell(0.5, 0.0, f64::NAN)), "time");
        assert_eq!(parameter(TransferFunction::prony(&[], &[])), "number of strengths");
        assert_eq!(parameter(TransferFunction::prony(&[1.0], &[])), "number of times");
        assert_eq!(parameter(TransferFunction::prony(&[0.0], &[1.0])), "strength");
        assert_eq!(parameter(TransferFunction::prony(&[1.0], &[0.0])), "time");
        assert_eq!(parameter(TransferFunction::havriliak_negami(0.5, -1.0, 1.0)), "power");
        assert_eq!(parameter(TransferFunction::havriliak_negami(1.0, 1.5, 1.0)), "power");
    }

    #[test]
    fn cuts_that_are_too_narrow_are_told_by_the_orders_that_make_them_so() {
        let told = |made: Result<TransferFunction, ParameterError>| {
            made.unwrap().narrow().map(|error| (error.parameter, error.value))
        };
        let orders = Some(("`order` − `inner` of the kernel", 0.998));
        assert_eq!(told(TransferFunction::maxwell(0.998, 0.0, 1.0)), orders);
        let order = Some(("`order` of the kernel", 0.999));
        assert_eq!(told(TransferFunction::havriliak_negami(0.999, 0.5, 1.0)), order);
        // π/x − π ≥ 0.01, a pole, and a cut that begins beyond 0.
        assert_eq!(told(TransferFunction::maxwell(0.9968, 0.0, 1.0)), None);
        assert_eq!(told(TransferFunction::maxwell(1.0, 0.0, 1.0)), None);
        assert_eq!(told(TransferFunction::havriliak_negami(1.0, 0.5, 1.0)), None);
    }

    #[test]
    fn materials_are_passive_and_negative_elements_are_not() {
        for transfer in forms() {
            assert_eq!(transfer.active(), None, "{transfer}");
        }
        // Re R(iω) of s/(1 + s) − 0.2·s/(1 + s/10)/10 is negative where the second term decays later than the
        // first.
        let active = TransferFunction::prony(&[1.0, -0.2], &[1.0, 0.1]).unwrap().active().unwrap();
        assert!(active.place.re == 0.0 && active.place.im > 1.0 && active.resistance < 0.0, "{active:?}");
        assert!(TransferFunction::havriliak_negami(0.8, 2.8, 1.0).unwrap().active().is_some());
        assert!(TransferFunction::power(-0.5).unwrap().active().is_some());
    }

    #[test]
    fn keys_tell_transfer_functions_apart() {
        let mut keys: Vec<_> = forms().iter().map(TransferFunction::key).collect();
        keys.sort();
        keys.dedup();
        assert_eq!(keys.len(), forms().len());
    }
}
