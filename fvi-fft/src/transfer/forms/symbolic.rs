//! Formulas in s, which are known by their values alone.

use crate::sums::max_or_nan;
use crate::transfer::activity::look_for_activity;
use crate::transfer::algebra::{Algebra, Series};
use crate::transfer::form::{Form, Slope, Values, key};
use crate::transfer::fractions::{Fractions, PoleOfOrder};
use crate::transfer::limits::{growth_of, value_at_infinity, value_at_zero};
use crate::transfer::multistep_rule::MultistepRule;
use crate::transfer::{Active, Cut, Formula, NARROWEST, Passivity, Pole, check};
use fvi_core::ParameterError;
use nalgebra::Complex;
use std::f64::consts::PI;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

/// K(s) − K(0) of a formula, where the spring K(0) is kept separately; or K(s).
#[derive(Clone, Debug)]
pub(in crate::transfer) struct Symbolic {
    formula: Arc<dyn Formula>,
    growth: f64,
    spring: f64,
    is_beside: bool,
    relaxation: bool,
    /// See [`Cut::strip`].
    strip: f64,
    /// Of a rational function.
    fractions: Option<Arc<Fractions>>,
    active: Option<Active>,
}

impl Symbolic {
    /// # Errors
    /// If the formula is not a real finite number for positive s, or grows like s² or faster.
    pub(in crate::transfer) fn new(formula: Arc<dyn Formula>) -> Result<Self, ParameterError> {
        check_positive_axis(&*formula)?;
        let fractions = formula.fractions().filter(|fractions| are_of(fractions, &*formula)).map(Arc::new);
        // Of fractions known without the rounding errors of values at large s, where terms cancel.
        let growth = match &fractions {
            Some(fractions) if fractions.direct[1] != 0.0 => 1.0,
            Some(_) => 0.0,
            None => growth_of(&*formula),
        };
        let allowed = "a symbol that grows more slowly than s²";
        check(growth.is_finite() && growth < 2.0, "growth of the symbol", growth, allowed)?;
        let spring = value_at_zero(&*formula);
        let rational = fractions.as_ref().map(|fractions| fractions.is_relaxation());
        let (relaxation, active, is_beside, strip) = (false, None, true, 0.25 * PI);
        let mut made = Self { formula, growth, spring, is_beside, relaxation, strip, fractions, active };
        let (found, drives) = sampled_once(key(&made), || made.sampled(rational));
        (made.relaxation, made.active) = (found.is_some(), drives);
        if let Some(found) = found {
            made.strip = found;
        }
        Ok(made)
    }

    /// The strip of its cut if it is a relaxation, and the region where it is not passive; `rational`: for a
    /// rational function, whether it is a relaxation.
    fn sampled(&self, rational: Option<bool>) -> Sampled {
        match self.formula.passivity() {
            Passivity::Passive => (None, None),
            Passivity::Active(active) => (None, Some(active)),
            Passivity::Unknown => {
                let found = match rational {
                    Some(is_relaxation) => is_relaxation.then_some(0.25 * PI),
                    None => self.strip_of_its_cut(),
                };
                (found, look_for_activity(self))
            }
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
}

impl Values for Symbolic {
    fn value(&self, s: Complex<f64>) -> Complex<f64> {
        let value = self.formula.value(s);
        if self.is_beside { value - self.spring } else { value }
    }

    fn values(&self, places: &[Complex<f64>]) -> Vec<Complex<f64>> {
        let mut values = self.formula.values(places);
        if self.is_beside {
            values.iter_mut().for_each(|value| *value -= self.spring);
        }
        values
    }

    fn series(&self, s: &Series) -> Series {
        let series = self.formula.series(s);
        if self.is_beside { series.add(&s.constant(-self.spring)) } else { series }
    }

    fn parameters(&self) -> Vec<(&'static str, Vec<f64>)> {
        self.formula.parameters().into_iter().map(|(name, number)| (name, vec![number])).collect()
    }

    /// Only who knows the formula can differentiate it.
    fn slope(&self, _name: &str, _index: usize) -> Option<Arc<dyn Slope>> {
        None
    }
}

impl Form for Symbolic {
    fn name(&self) -> &'static str {
        self.formula.form()
    }

    fn growth(&self) -> f64 {
        self.growth
    }

    fn unrelaxed(&self) -> Option<f64> {
        value_at_infinity(&*self.formula)
    }

    fn creep_power(&self) -> f64 {
        if self.growth > 0.0 {
            return self.growth;
        }
        let at = |exponent: f64| self.value(Complex::new(libm::pow(10.0, exponent), 0.0));
        let [near, far] = [[at(4.0), at(8.0)], [at(8.0), at(12.0)]].map(|[one, other]| (other - one).norm());
        // A difference of rounding only is that of a rational function.
        if far > 1e-11 * at(8.0).norm() { libm::log10(near / far) / 4.0 } else { 1.0 }
    }

    /// The cut is assumed to begin at s = 0.
    fn cut(&self) -> Option<Cut> {
        if self.fractions.is_some() {
            return None;
        }
        let size = |d: f64| self.jump(d).abs();
        let (near, far) = (size(1e-40), size(1e-30));
        let power = (libm::log10(far) - libm::log10(near)) / 10.0;
        let is_power = power.is_finite() && power > -1.0;
        is_power.then_some(Cut { start: 0.0, rest: 0.0, power, strip: self.strip })
    }

    fn jump(&self, d: f64) -> f64 {
        if self.fractions.is_some() {
            return 0.0;
        }
        self.formula.value(Complex::new(-d, 0.0)).im / PI
    }

    fn poles(&self) -> Vec<Pole> {
        let Some(fractions) = self.fractions.as_ref().filter(|_| self.relaxation) else { return Vec::new() };
        let residue = |pole: &PoleOfOrder| pole.coefficients.iter().map(|a| a.re).sum();
        let poles = fractions.poles.iter();
        poles.map(|pole| Pole { rate: -pole.place.re, residue: residue(pole), rests: [0.0; 2] }).collect()
    }

    fn fractions(&self) -> Option<Fractions> {
        self.fractions.as_deref().cloned()
    }

    fn is_relaxation(&self) -> bool {
        self.relaxation
    }

    fn active(&self) -> Option<Active> {
        self.active
    }

    fn spring(&self) -> f64 {
        self.spring
    }

    fn with_its_spring(&self) -> Option<Arc<dyn Form>> {
        Some(Arc::new(Self { is_beside: false, ..self.clone() }))
    }

    fn includes_its_spring(&self) -> bool {
        !self.is_beside
    }

    fn text(&self) -> Option<&str> {
        Some(self.formula.text())
    }

    fn notes(&self) -> &[String] {
        self.formula.notes()
    }

    fn numbers(&self) -> &[f64] {
        self.formula.numbers()
    }

    fn own_weights(&self, rule: MultistepRule, step_size: f64, count: usize) -> Option<Vec<f64>> {
        self.formula.weights(rule, step_size, count)
    }

    fn is_rounded_formula(&self) -> bool {
        self.fractions.is_none() && self.formula.form() == "symbol"
    }

    fn heading(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.formula.text())
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

/// True if partial fractions are those of a formula: they agree on rays into the right half-plane, relative
/// to their terms.
fn are_of(fractions: &Fractions, formula: &dyn Formula) -> bool {
    let agree = |angle: f64, exponent: i32| {
        let size = libm::exp10(f64::from(exponent));
        let s = Complex::new(size * libm::cos(angle), size * libm::sin(angle));
        let (found, known) = (fractions.value(s), formula.value(s));
        // Powers of very large and very small s are no numbers.
        let is_finite = known.re.is_finite() && known.im.is_finite();
        // Terms that cancel at large s leave their rounding errors in the formula.
        !is_finite || (found - known).norm() <= 1e-11 * fractions.size(s) + 16.0 * formula.rounding(s)
    };
    [0.0, 0.9, 1.5].into_iter().all(|angle| (-24..=24).all(|exponent| agree(angle, exponent)))
}

/// Rounding error of a smooth function near a place: its third differences at distances whose cubes are none.
fn rounding_error(of: impl Fn(f64) -> f64, place: f64) -> f64 {
    let values: Vec<f64> = (0..12).map(|k| of(place * (1.0 + 1e-6 * f64::from(k)))).collect();
    let third = |values: &[f64]| values[3] - 3.0 * values[2] + 3.0 * values[1] - values[0];
    values.windows(4).map(third).map(|error| error.abs()).fold(0.0, max_or_nan)
}
