//! Transfer functions of memories: the damping force as a function K(s) of the Laplace variable.

mod active;
mod activity;
#[doc(hidden)]
pub mod algebra;
#[doc(hidden)]
pub mod derivative;
#[doc(hidden)]
pub mod dual;
#[doc(hidden)]
pub mod estimate;
mod form;
mod forms;
#[doc(hidden)]
pub mod fractions;
#[doc(hidden)]
pub mod given_weights;
#[doc(hidden)]
pub mod laplace;
mod limits;
#[doc(hidden)]
pub mod multistep_rule;
mod polynomial;
#[doc(hidden)]
pub mod radiation;
#[doc(hidden)]
pub mod real;
#[doc(hidden)]
pub mod relaxation;
#[doc(hidden)]
pub mod scaled;
#[doc(hidden)]
pub mod state_space;

pub use active::Active;
use algebra::{Algebra, Series};
use form::Form;
#[doc(hidden)]
pub use form::{WrittenForm, WrittenParameter};
#[doc(hidden)]
pub use forms::WRITTEN;
use forms::{Distributed, Given, HavriliakNegami, Maxwell, Power, Prony, Symbolic, Tempered};
use fractions::Fractions;
use fvi_core::ParameterError;
use given_weights::GivenWeights;
use multistep_rule::MultistepRule;
use nalgebra::Complex;
use std::f64::consts::PI;
use std::fmt;
use std::sync::Arc;

/// The transfer function K(s) of a damping force −ρ K(D) q.
///
/// | constructor | K(s) |
/// |---|---|
/// | [`power`](Self::power) | s^β |
/// | [`tempered`](Self::tempered) | (s + a)^β − a^β |
/// | [`maxwell`](Self::maxwell) | (τs)^β/(1 + (τs)^{β−α}) |
/// | [`prony`](Self::prony) | Σ g τ s/(1 + τ s) |
/// | [`havriliak_negami`](Self::havriliak_negami) | 1 − (1 + (τs)^α)^{−γ} |
/// | [`distributed`](Self::distributed) | ((τs)^b − (τs)^a)/((b − a) ln(τs)) |
/// | [`formula`](Self::formula) | any formula that is analytic off the negative real axis |
/// | [`weights`](Self::weights) | unknown: the weights of one step are given |
///
/// Powers are principal branches.
///
/// Sources: \[Lubich86\] for the operational calculus; \[Mainardi10\] for the materials.
#[derive(Clone, Debug)]
pub struct TransferFunction {
    form: Arc<dyn Form>,
}

/// Equal are those with equal weights.
impl PartialEq for TransferFunction {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

/// A formula in the Laplace variable.
pub trait Formula: fmt::Debug + Send + Sync {
    /// K(s) for a complex s off the negative real axis, or on its upper side.
    fn value(&self, s: Complex<f64>) -> Complex<f64>;
    /// K at each of the places.
    #[doc(hidden)]
    fn values(&self, places: &[Complex<f64>]) -> Vec<Complex<f64>> {
        places.iter().map(|&s| self.value(s)).collect()
    }
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

pub(crate) fn check(
    accepted: bool,
    parameter: &'static str,
    value: f64,
    allowed: &'static str,
) -> Result<(), ParameterError> {
    if accepted { Ok(()) } else { Err(ParameterError { parameter, value, allowed }) }
}

impl TransferFunction {
    fn of(form: impl Form + 'static) -> Self {
        Self { form: Arc::new(form) }
    }

    /// s^β, the fractional derivative; β < 0 is a fractional integral.
    ///
    /// # Errors
    /// If β is outside (−1, 2).
    pub fn power(order: f64) -> Result<Self, ParameterError> {
        Power::new(order).map(Self::of)
    }

    /// (s + a)^β − a^β, a fractional derivative with a longest relaxation time 1/a.
    ///
    /// # Errors
    /// If β is outside (0, 2) or a negative or not finite.
    pub fn tempered(order: f64, rate: f64) -> Result<Self, ParameterError> {
        Tempered::new(order, rate)?.map_or_else(|| Self::power(order), |form| Ok(Self::of(form)))
    }

    /// (τs)^β/(1 + (τs)^{β−α}): a springpot of order β in series with one of order α, the fractional Maxwell
    /// model; α = 0 is a spring. With a spring beside it the fractional Zener model.
    ///
    /// # Errors
    /// Unless 0 ≤ α < β ≤ 1, and if τ is not positive and finite.
    pub fn maxwell(order: f64, inner: f64, time: f64) -> Result<Self, ParameterError> {
        let form = Maxwell::new(order, inner, time)?;
        form.map_or_else(|| Self::prony(&[1.0], &[time]), |form| Ok(Self::of(form)))
    }

    /// Σ g τ s/(1 + τ s), a Prony series: Maxwell elements in parallel.
    ///
    /// # Errors
    /// If there is no term, the numbers of strengths and times differ, a strength is not finite or all are
    /// zero, or a time not positive and finite.
    pub fn prony(strengths: &[f64], times: &[f64]) -> Result<Self, ParameterError> {
        Prony::new(strengths, times).map(Self::of)
    }

    /// 1 − (1 + (τs)^α)^{−γ}: Cole–Cole with γ = 1, Cole–Davidson with α = 1.
    ///
    /// # Errors
    /// Unless 0 < α ≤ 1 and γ > 0 and τ > 0, all finite; if α = 1, γ must be at most 1.
    pub fn havriliak_negami(order: f64, power: f64, time: f64) -> Result<Self, ParameterError> {
        let form = HavriliakNegami::new(order, power, time)?;
        form.map_or_else(|| Self::prony(&[1.0], &[time]), |form| Ok(Self::of(form)))
    }

    /// ((τs)^b − (τs)^a)/((b − a) ln(τs)), the mean of (τs)^β over all orders β from a to b: a derivative of
    /// distributed order. With a = 0, b = 1 and τ = 1 it is (s − 1)/ln s.
    ///
    /// Source: \[Mainardi10\].
    ///
    /// # Errors
    /// Unless 0 ≤ a < b ≤ 1 or 1 ≤ a < b < 2, and if τ is not positive and finite.
    pub fn distributed(from: f64, to: f64, time: f64) -> Result<Self, ParameterError> {
        Distributed::new(from, to, time).map(Self::of)
    }

    /// K(s) by a formula that is analytic off the negative real axis. Its value at s = 0 is split off as a
    /// [`spring`](Self::spring).
    ///
    /// # Errors
    /// If it is not a real finite number for positive s, or grows like s² or faster.
    pub fn formula(formula: Arc<dyn Formula>) -> Result<Self, ParameterError> {
        Symbolic::new(formula).map(Self::of)
    }

    /// Weights in place of a transfer function: K(s) is then [`GivenWeights::value`].
    pub fn weights(table: GivenWeights) -> Self {
        Self::of(Given(Arc::new(table)))
    }

    /// True for a formula whose series may lose digits: one that is not rational, without weights of its own,
    /// or that cancels somewhere.
    pub(crate) fn is_rounded_formula(&self) -> bool {
        self.form.is_rounded_formula()
    }

    /// The weights, if it is given by weights.
    pub fn table(&self) -> Option<&GivenWeights> {
        self.form.table()
    }

    /// The first weights of a rule by a way of its own, see [`Formula::weights`].
    pub(crate) fn own_weights(&self, rule: MultistepRule, step_size: f64, count: usize) -> Option<Vec<f64>> {
        self.form.own_weights(rule, step_size, count)
    }

    /// K(γ(z)/h) for |z| < 1: Σ w_n zⁿ, whose weights are those of the rule or given.
    pub fn symbol(&self, rule: MultistepRule, step: f64, z: Complex<f64>) -> Complex<f64> {
        self.form.symbol(rule, step, z)
    }

    /// β, if this is s^β.
    pub fn exponent(&self) -> Option<f64> {
        self.form.exponent()
    }

    /// μ with K(s) ~ s^μ for large s.
    pub fn growth(&self) -> f64 {
        self.form.growth()
    }

    /// γ ≤ 1 if a coordinate without mass that this kernel holds begins to creep like t^γ: μ where K grows,
    /// otherwise the power with which K(∞) − K(s) ~ s^{−γ} vanishes.
    pub fn creep_power(&self) -> f64 {
        self.form.creep_power().min(1.0)
    }

    /// K(∞), the unrelaxed modulus (glass modulus), the spring included: the force on a jump of the
    /// displacement. `None` if the force has no bound. For weights the first one.
    pub fn unrelaxed(&self) -> Option<f64> {
        self.form.unrelaxed()
    }

    /// K(s); on the negative real axis the value on its upper side.
    pub fn value(&self, s: Complex<f64>) -> Complex<f64> {
        self.form.value(s)
    }

    /// K at each of the places.
    #[doc(hidden)]
    pub fn values(&self, places: &[Complex<f64>]) -> Vec<Complex<f64>> {
        self.form.values(places)
    }

    /// K of a power series with a positive first coefficient.
    pub fn series(&self, s: &Series) -> Series {
        self.form.series(s)
    }

    /// The cut on the negative real axis; `None` if there is none, as for integer powers and sums of poles.
    /// The cut of a formula is assumed to begin at s = 0.
    pub fn cut(&self) -> Option<Cut> {
        self.form.cut()
    }

    /// The start of its cut, if K has no bound there.
    pub fn unbounded_start(&self) -> Option<UnboundedStart> {
        self.form.unbounded_start()
    }

    /// The parameter that makes the cut so narrow that an integral over it would need too many points; `None`
    /// if the cut is wide enough.
    pub fn narrow(&self) -> Option<ParameterError> {
        let allowed = "exactly 1, or at most 0.9968: between these the integral over the cut of K(s) takes too many points, and weights \
                       come from transforms, with `convolution.family` = \"bdf\" and the engines \"direct\", \"block-fft\" and \
                       \"real-time\" alone";
        let (parameter, value) = self.form.narrowing()?;
        let is_narrow = self.cut().is_some_and(|cut| cut.strip < NARROWEST);
        is_narrow.then_some(ParameterError { parameter, value, allowed })
    }

    /// Im K(−a − d + i0)/π beyond the start a of the [`cut`](Self::cut).
    pub fn jump(&self, d: f64) -> f64 {
        self.form.jump(d)
    }

    /// Simple poles on the negative real axis.
    pub fn poles(&self) -> Vec<Pole> {
        self.form.poles()
    }

    /// K(s), its spring included, in partial fractions; `None` if it is not known to be rational.
    pub fn fractions(&self) -> Option<Fractions> {
        self.form.fractions()
    }

    /// True if the kernel is determined by cut and poles: its response is a sum of decaying exponentials.
    pub fn is_relaxation(&self) -> bool {
        self.form.is_relaxation()
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
    pub fn with_its_spring(self) -> Self {
        match self.form.with_its_spring() {
            Some(form) => Self { form },
            None => self,
        }
    }

    /// K(0) of a formula, the stiffness of the spring beside the memory: [`value`](Self::value) and
    /// [`series`](Self::series) do not include it, except for a kernel
    /// [`with_its_spring`](Self::with_its_spring).
    pub fn spring(&self) -> f64 {
        self.form.spring()
    }

    /// The region where K is not passive; `None` if R(s) = K(s)/s is positive real, as far as sampling shows.
    ///
    /// The passivity of most forms follows from their formula. Others are sampled on the imaginary axis and
    /// on rays into the right half-plane, at forty and ten places per decade over sixty decades, and more
    /// densely where the real part of R is small.
    pub fn active(&self) -> Option<Active> {
        self.form.active()
    }

    /// The name of its form in files.
    pub fn form(&self) -> &'static str {
        self.form.name()
    }

    /// Its parameters with their names in files, in the order of the formula; each name once, with all its
    /// values.
    pub fn parameters(&self) -> Vec<(&'static str, Vec<f64>)> {
        self.form.parameters()
    }

    /// The text of a formula, or the name of a file; empty for rows given directly.
    pub fn text(&self) -> Option<&str> {
        self.form.text()
    }

    /// Sentences on how the numbers of a file were amended.
    #[doc(hidden)]
    pub fn notes(&self) -> &[String] {
        self.form.notes()
    }

    /// The numbers that the text of a formula, or a file, contains.
    pub fn numbers(&self) -> &[f64] {
        self.form.numbers()
    }

    /// Of a kernel that is a table over time up to T, the same with the table up to T/2; `None` for others.
    #[doc(hidden)]
    pub fn halved(&self) -> Option<Self> {
        if self.form() != relaxation::FORM {
            return None;
        }
        let rows: Vec<(f64, f64)> = self.numbers().chunks_exact(2).map(|row| (row[0], row[1])).collect();
        let half = 0.5 * rows.last()?.0;
        let rows = &rows[..rows.partition_point(|&(time, _)| time <= half)];
        let decay = self.parameters().into_iter().find(|(name, _)| *name == "decay");
        let decay = decay.and_then(|(_, values)| values.first().copied());
        let shorter = relaxation::Relaxation::new("", rows, decay).of_matrix();
        (rows.len() > 1).then(|| Self::formula(Arc::new(shorter)).ok())?
    }

    /// Numbers that identify it: equal keys have equal weights.
    pub fn key(&self) -> Vec<u64> {
        form::key(&*self.form)
    }
}

/// For headings: `s^0.5`, or the form with its parameters.
impl fmt::Display for TransferFunction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.form.heading(f)
    }
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
            TransferFunction::distributed(0.0, 1.0, 1.0).unwrap(),
            TransferFunction::distributed(1.1, 1.6, 0.4).unwrap(),
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
            // The jump begins like d^ν, that of distributed orders with a logarithm.
            if transfer.form() == "distributed" {
                continue;
            }
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
        assert_eq!(parameter(TransferFunction::distributed(-0.1, 1.0, 1.0)), "from");
        assert_eq!(parameter(TransferFunction::distributed(0.5, 0.5, 1.0)), "to");
        assert_eq!(parameter(TransferFunction::distributed(0.5, 1.2, 1.0)), "to");
        assert_eq!(parameter(TransferFunction::distributed(0.5, 0.9, 0.0)), "time");
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
