//! Gains and orders that meet a specification.

use super::grid::{SampledPlant, SampledPoint};
use super::in_words;
use super::law::{Law, filter, power};
use super::margins::{
    Loop, Margins, complementary, complementary_at_any_phase, largest, largest_by_parabolas, sensitivity,
    sensitivity_at_any_phase,
};
use super::plant::Plant;
use super::problem::{Crossover, Limit, Preference, Structure, Terms};
use super::sampled::{band, difference};
use fvi_core::PidGains;
use fvi_fft::sums::{max_or_nan, min_or_nan};
use nalgebra::Complex;
use std::cell::RefCell;
use std::f64::consts::PI;

/// Range of the orders, where they are free.
const ORDERS: (f64, f64) = (0.02, 1.98);

/// Range of the slope d arg L/d ln ω, where the phase need not be flat.
const SLOPES: (f64, f64) = (-30.0, 10.0);

/// Bounds on Ms and Mt that a search keeps where a specification has free parameters and no bound of its own:
/// the first ones, and where no loop keeps them the next.
pub(super) const DEFAULTS: [[f64; 2]; 2] = [[2.0, 1.3], [3.0, 3.0]];

/// Number of candidates among which a stable one is sought for the error message, if none meets the
/// specification.
const SHOWN_FROM: usize = 300;

/// Largest phase change of e^{−iωL}, in radians, between points at which a bound is checked; where the dead
/// time would need too many points, the bound is required for any phase.
const TURN: f64 = 0.5;
const MOST_TURNS: f64 = 2000.0;

/// Violation of a bound, in its own unit, up to which it counts as met.
pub(super) const SLACK: f64 = 1e-6;

/// Values beyond which a bounded quantity is not compared.
const MOST: f64 = 1e6;

/// Relative excess of the highest crossover that counts as rounding.
const SAME: f64 = 1e-6;

/// Weight of a degree of phase that other crossovers lack, relative to a unit of Ms.
const OF_A_DEGREE: f64 = 0.1;

/// Largest ratio of the sum of magnitudes of the parts of a law to the magnitude of their sum, at the
/// crossover: beyond, a relative change of a gain by 10⁻³ changes the loop by more than 100 %.
const MOST_CANCELLED: f64 = 1e3;

/// Number of stable loops violating a bound that the search tries to improve.
const IMPROVED: usize = 4;

/// The free parameters of the search: orders and slope of the phase.
#[derive(Clone, Copy, Debug)]
struct Point {
    lambda: f64,
    mu: f64,
    slope: f64,
}

/// How good a candidate is: first by how far it violates the specification, then by the objective.
#[derive(Clone, Copy, Debug)]
struct Merit {
    missed: f64,
    preferred: f64,
}

impl Merit {
    const NONE: Self = Self { missed: f64::INFINITY, preferred: f64::INFINITY };

    fn number(self) -> f64 {
        if self.missed > SLACK { 1e6 * (1.0 + self.missed) } else { self.preferred }
    }
}

/// The bounded quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Bounded {
    S,
    T,
}

impl Bounded {
    fn size(self, at_any_phase: bool) -> fn(Complex<f64>) -> f64 {
        match (self, at_any_phase) {
            (Self::S, false) => sensitivity,
            (Self::T, false) => complementary,
            (Self::S, true) => sensitivity_at_any_phase,
            (Self::T, true) => complementary_at_any_phase,
        }
    }
}

/// The frequencies of a crossover and its bounds, which the grid must have.
pub(super) fn frequencies(plant: &Plant, wanted: &Crossover) -> Vec<f64> {
    let mut frequencies = vec![wanted.crossover];
    for limit in wanted.sensitivity.iter().chain(&wanted.complementary) {
        frequencies.extend([limit.from, limit.to]);
        let mut omega = limit.from;
        while omega < limit.to {
            frequencies.push(omega);
            let ratio = if turns_too_often(plant, limit) {
                0.02
            } else {
                (TURN / (plant.dead_time() * omega)).min(0.02)
            };
            omega *= libm::exp(ratio);
        }
    }
    frequencies
}

/// A search for a crossover of the sampled loop.
pub(super) struct Search<'a> {
    sampled: &'a SampledPlant<'a>,
    structure: &'a Structure,
    wanted: &'a Crossover,
    /// At the crossover: (1 − e^{−iωh})/h, d ln of it/d ln ω, G, and d arg G/d ln ω.
    difference: Complex<f64>,
    stretch: Complex<f64>,
    at: Complex<f64>,
    plant_slope: f64,
    /// Difference and G at a tenth of the crossover.
    slow: Option<[Complex<f64>; 2]>,
    /// ω and P(iω) of bounds beyond π/h, which hold for the loop in continuous time.
    beyond: Vec<(f64, Complex<f64>)>,
    ms: Option<f64>,
    mt: Option<f64>,
    sign: f64,
    /// Safety margin of bounds, which are checked at discrete points only.
    closer: f64,
    /// G s^−λ and G s^μ, filtered, over the grid for the orders that were tried last.
    parts: RefCell<Parts>,
}

/// The parts of a loop that gains multiply.
#[derive(Default)]
struct Parts {
    orders: Option<[f64; 2]>,
    values: Vec<[Complex<f64>; 2]>,
}

/// A bound and the value reached.
#[derive(Clone, Debug, PartialEq)]
pub struct Bound {
    /// What is bounded, in words.
    pub what: String,
    /// The bound.
    pub allowed: Allowed,
    /// The value reached.
    pub found: f64,
}

/// The values that a bound allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Allowed {
    /// This one and smaller ones.
    AtMost(f64),
    /// This one and larger ones.
    AtLeast(f64),
}

impl Bound {
    pub(super) fn at_most(what: &str, allowed: f64, found: f64) -> Self {
        Self { what: what.to_owned(), allowed: Allowed::AtMost(allowed), found }
    }

    /// By how much it is missed: positive if it is, beyond rounding, and infinite if nothing is known.
    pub fn excess(&self) -> f64 {
        let excess = match self.allowed {
            Allowed::AtMost(allowed) => self.found - allowed,
            Allowed::AtLeast(allowed) => allowed - self.found,
        };
        if excess.is_nan() {
            f64::INFINITY
        } else if excess > SLACK {
            excess
        } else {
            0.0
        }
    }
}

impl std::fmt::Display for Bound {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (word, allowed) = match self.allowed {
            Allowed::AtMost(allowed) => ("most", allowed),
            Allowed::AtLeast(allowed) => ("least", allowed),
        };
        write!(f, "{} is {:.4} instead of at {word} {allowed}", self.what, self.found)
    }
}

/// The bounds that are missed, in words.
pub(super) fn missed(bounds: &[Bound]) -> String {
    let missed: Vec<String> =
        bounds.iter().filter(|bound| bound.excess() > 0.0).map(ToString::to_string).collect();
    missed.join("; ")
}

impl<'a> Search<'a> {
    /// Prepares a search.
    ///
    /// # Errors
    /// A sentence, where the plant has no value at the crossover.
    pub(super) fn new(
        sampled: &'a SampledPlant<'a>,
        structure: &'a Structure,
        wanted: &'a Crossover,
        closer: f64,
        [default_ms, default_mt]: [f64; 2],
    ) -> Result<Self, String> {
        let (omega, sample, plant) = (wanted.crossover, structure.sample, sampled.plant);
        let value = |omega: f64| sampled.held(omega);
        let missing = || format!("the plant has no value at ω = {omega}");
        let at = value(omega).filter(|value| value.norm() > 0.0 && value.norm().is_finite());
        let at = at.ok_or_else(missing)?;
        // Central differences of order four in ln ω.
        let turn = |step: f64| {
            let ratio = value(omega * libm::exp(step))? / value(omega * libm::exp(-step))?;
            Some(libm::atan2(ratio.im, ratio.re) / (2.0 * step))
        };
        let step = (1e-3f64).min(0.1 / (1.0 + omega * plant.dead_time()));
        let step = step.min(0.25 * libm::log(band(sample) / omega));
        let plant_slope = turn(step)
            .zip(turn(2.0 * step))
            .map(|(near, far)| (4.0 * near - far) / 3.0)
            .ok_or_else(missing)?;
        let s = Complex::new(0.0, omega);
        let here = difference(s, sample);
        // d ln(1 − e^{−sh})/d ln s = s e^{−sh}/((1 − e^{−sh})/h)
        let stretch = s * (s * -sample).exp() / here;
        let slow = Complex::new(0.0, 0.1 * omega);
        let slow = value(slow.im).map(|plant| [difference(slow, sample), plant]);
        let beyond = frequencies(plant, wanted)
            .into_iter()
            .filter(|omega| *omega >= band(sample))
            .filter_map(|omega| Some((omega, plant.at(Complex::new(0.0, omega))?.value)))
            .collect();
        let free = [
            structure.terms.integrates() && structure.lambda.is_none(),
            structure.terms.differentiates() && structure.mu.is_none(),
            structure.terms == Terms::Pid && !wanted.flat_phase,
        ];
        let equations = usize::from(wanted.flat_phase && structure.terms != Terms::Pid);
        let has_choice = free.iter().filter(|&&free| free).count() > equations;
        let ms = wanted.ms.or(has_choice.then_some(default_ms));
        // At the crossover |S| = |T| = 1/(2 sin(φ_m/2)) for every law.
        let there = 0.5 / libm::sin(0.5 * wanted.phase_margin.to_radians());
        let mt = wanted.mt.or(has_choice.then_some(default_mt.max(1.1 * there)));
        let sign = plant.sign();
        Ok(Self {
            sampled,
            structure,
            wanted,
            difference: here,
            stretch,
            at,
            plant_slope,
            slow,
            beyond,
            ms,
            mt,
            sign,
            closer,
            parts: RefCell::default(),
        })
    }

    /// Bounds on Ms and Mt that the specification does not have and the search does.
    pub(super) fn sought(&self) -> [Option<f64>; 2] {
        let [ms, mt] = [(self.wanted.ms, self.ms), (self.wanted.mt, self.mt)];
        [ms, mt].map(|(wanted, sought)| if wanted.is_none() { sought } else { None })
    }

    /// L of a law at the points of the grid.
    fn open(&self, law: &Law) -> Vec<(f64, Complex<f64>)> {
        let mut parts = self.parts.borrow_mut();
        let orders = [law.lambda, law.mu];
        if parts.orders != Some(orders) {
            let of = |point: &SampledPoint| {
                let [through, _] = filter(law.filter, point.difference);
                let integral = power(point.difference, -law.lambda);
                [integral * point.plant, power(point.difference, law.mu) / through * point.plant]
            };
            *parts = Parts { orders: Some(orders), values: self.sampled.points.iter().map(of).collect() };
        }
        let [kp, ki, kd] = law.three();
        let points = self.sampled.points.iter().zip(&parts.values);
        points
            .map(|(point, [integral, derivative])| {
                let derived = if kd == 0.0 { Complex::ZERO } else { derivative * kd };
                let integrated = if ki == 0.0 { Complex::ZERO } else { integral * ki };
                (point.omega, point.plant * kp + integrated + derived)
            })
            .collect()
    }

    /// The gains of the law with these orders and this slope that has the crossover and the phase margin, and
    /// the responses of its integral and derivative there.
    fn gains(&self, point: Point) -> ([f64; 3], [Complex<f64>; 3]) {
        let Self { structure, wanted, .. } = self;
        let (s, stretch) = (self.difference, self.stretch);
        let margin = wanted.phase_margin.to_radians() - PI;
        let needed = Complex::new(libm::cos(margin), libm::sin(margin)) / self.at;
        // Values, and derivatives by ln ω.
        let integral = (power(s, -point.lambda), power(s, -point.lambda) * -point.lambda * stretch);
        let [through, slope] = filter(structure.filter, s);
        let derived = power(s, point.mu) / through;
        let derivative = (derived, derived * (Complex::new(point.mu, 0.0) - slope / through) * stretch);
        let gains = match structure.terms {
            Terms::Pi => {
                let ki = needed.im / integral.0.im;
                [needed.re - ki * integral.0.re, ki, 0.0]
            }
            Terms::Pd => {
                let kd = needed.im / derivative.0.im;
                [needed.re - kd * derivative.0.re, 0.0, kd]
            }
            Terms::Pid => {
                // Im C = Im c, and Im(s C′/c) = slope − that of the plant.
                let turned = |part: Complex<f64>| (part / needed).im;
                let (a, b) = (integral.0.im, derivative.0.im);
                let (c, d) = (turned(integral.1), turned(derivative.1));
                let wanted_slope = point.slope - self.plant_slope;
                let determinant = a * d - b * c;
                let ki = (needed.im * d - b * wanted_slope) / determinant;
                let kd = (a * wanted_slope - c * needed.im) / determinant;
                [needed.re - ki * integral.0.re - kd * derivative.0.re, ki, kd]
            }
        };
        (gains, [integral.0, derivative.0, needed])
    }

    /// The law with these gains; `None` if they would have other signs than the plant.
    fn law(&self, point: Point) -> Option<Law> {
        let structure = self.structure;
        let ([proportional, ki, kd], [integral, derivative, needed]) = self.gains(point);
        let sign = self.sign;
        let used = [true, structure.terms.integrates(), structure.terms.differentiates()];
        let right = [proportional, ki, kd]
            .iter()
            .zip(used)
            .all(|(gain, used)| if used { gain * sign > 0.0 && gain.is_finite() } else { *gain == 0.0 });
        let parts = proportional.abs() + ki.abs() * integral.norm() + kd.abs() * derivative.norm();
        (right && parts <= MOST_CANCELLED * needed.norm()).then_some(Law {
            gains: PidGains::Parallel { proportional, integral: ki, derivative: kd },
            lambda: point.lambda,
            mu: point.mu,
            filter: structure.filter,
            setpoint_weights: structure.setpoint_weights,
        })
    }

    /// d arg L/d ln ω of a law at the crossover.
    fn slope(&self, law: &Law) -> f64 {
        let s = |step: f64| {
            difference(Complex::new(0.0, self.wanted.crossover * libm::exp(step)), self.structure.sample)
        };
        let step = 1e-3f64.min(0.25 * libm::log(band(self.structure.sample) / self.wanted.crossover));
        let turn = |step: f64| {
            let ratio = law.response(s(step)).measured / law.response(s(-step)).measured;
            libm::atan2(ratio.im, ratio.re) / (2.0 * step)
        };
        (4.0 * turn(step) - turn(2.0 * step)) / 3.0 + self.plant_slope
    }

    /// L in continuous time at the frequencies of bounds beyond π/h.
    fn beyond(&self, law: &Law) -> Vec<(f64, Complex<f64>)> {
        let at = |&(omega, plant): &(f64, Complex<f64>)| {
            (omega, plant * law.response(Complex::new(0.0, omega)).measured)
        };
        self.beyond.iter().map(at).collect()
    }

    /// The bounds of the specification with the values that a law reaches, whose sampled loop has these
    /// margins.
    pub(super) fn bounds(&self, law: &Law, margins: &Margins) -> Vec<Bound> {
        self.bounds_with(law, margins, [self.wanted.ms, self.wanted.mt])
    }

    fn bounds_with(&self, law: &Law, margins: &Margins, [ms, mt]: [Option<f64>; 2]) -> Vec<Bound> {
        let sampled: &Loop<'_> = &|omega| self.sampled.open(law, omega);
        let continuous: &Loop<'_> = &|omega| {
            let s = Complex::new(0.0, omega);
            Some(self.sampled.plant.at(s)?.value * law.response(s).measured)
        };
        let parts = [(self.sampled.loop_points(law), sampled), (self.beyond(law), continuous)];
        let mut bounds = self.of_crossovers(margins);
        let mut limits = |limits: &[Limit], bounded: Bounded| {
            for limit in limits {
                let size = bounded.size(turns_too_often(self.sampled.plant, limit));
                let mut found = f64::NAN;
                for (points, open) in &parts {
                    let inside = |point: &&(f64, Complex<f64>)| (limit.from..=limit.to).contains(&point.0);
                    let inside: Vec<_> = points.iter().filter(inside).copied().collect();
                    if !inside.is_empty() {
                        let here = largest(&inside, *open, size).1;
                        found = if found.is_nan() { here } else { max_or_nan(found, here) };
                    }
                }
                let range = if limit.from == limit.to {
                    format!("{}", limit.from)
                } else {
                    format!("{} … {}", limit.from, limit.to)
                };
                let what = format!("|{bounded:?}(iω)| in dB at ω = {range}");
                bounds.push(Bound::at_most(&what, limit.decibels, 20.0 * libm::log10(found)));
            }
        };
        limits(&self.wanted.sensitivity, Bounded::S);
        limits(&self.wanted.complementary, Bounded::T);
        bounds.extend(ms.map(|ms| Bound::at_most("Ms", ms, margins.ms)));
        bounds.extend(mt.map(|mt| Bound::at_most("Mt", mt, margins.mt)));
        bounds
    }

    /// The crossover, which is the highest one, and the phase margin, which holds at every one.
    fn of_crossovers(&self, margins: &Margins) -> Vec<Bound> {
        let wanted = self.wanted.crossover;
        let highest = margins.gain_crossovers.last().copied().unwrap_or(f64::NAN);
        // What rounding makes of it.
        let highest = if (highest / wanted - 1.0).abs() < SAME { wanted } else { highest };
        let phase = margins.phase_margin.map_or(f64::NAN, f64::abs);
        let allowed = Allowed::AtLeast(self.wanted.phase_margin);
        vec![
            Bound::at_most("the highest crossover", wanted, highest),
            Bound { what: "the least phase margin of all crossovers".to_owned(), allowed, found: phase },
        ]
    }

    /// How far other crossovers than the one asked for lack phase or lie above it.
    fn missed_at_others(&self, open: &[(f64, Complex<f64>)]) -> f64 {
        let wanted = self.wanted.crossover;
        let mut missed = 0.0;
        // Between its points |L| may be a little larger.
        let one = 1.0 - 20.0 * self.closer;
        let mut has_fallen = false;
        for pair in open.windows(2) {
            let ((low, left), (high, right)) = (pair[0], pair[1]);
            has_fallen = has_fallen || low > wanted && left.norm() < one;
            if high > wanted && right.norm() >= if has_fallen { one } else { 1.0 } {
                missed = max_or_nan(missed, libm::log(high / wanted));
            }
            if (left.norm() > 1.0) != (right.norm() > 1.0) && (wanted <= low || high <= wanted) {
                if low == wanted || high == wanted {
                    continue;
                }
                let (before, after) = (libm::log(left.norm()), libm::log(right.norm()));
                let crossed = left + (right - left) * (before / (before - after));
                let margin = libm::atan2(-crossed.im, -crossed.re).to_degrees().abs();
                missed += OF_A_DEGREE * (self.wanted.phase_margin - margin + self.closer).max(0.0);
            }
        }
        missed
    }

    fn merit(&self, point: Point) -> Merit {
        let Some(law) = self.law(point) else { return Merit::NONE };
        let open = self.open(&law);
        let beyond = self.beyond(&law);
        let over = |limit: Option<&Limit>, bounded: Bounded| {
            let inside = |omega: &f64| limit.is_none_or(|limit| (limit.from..=limit.to).contains(omega));
            let turns = limit.is_some_and(|limit| turns_too_often(self.sampled.plant, limit));
            let near = open.iter().zip(&self.sampled.points);
            let (turning, still): (Vec<_>, Vec<_>) =
                near.filter(|(open, _)| inside(&open.0)).partition(|(_, point)| point.any_phase || turns);
            let at_any_phase =
                turning.iter().map(|(open, _)| bounded.size(true)(open.1)).fold(0.0, max_or_nan);
            let outside = beyond.iter().filter(|point| limit.is_some() && inside(&point.0));
            let outside = outside.map(|point| bounded.size(turns)(point.1)).fold(0.0, max_or_nan);
            let still = still.iter().map(|(open, _)| open.1);
            max_or_nan(max_or_nan(largest_by_parabolas(still, bounded.size(false)), at_any_phase), outside)
        };
        let decibels = |value: f64| 20.0 * libm::log10(value);
        let excess = |found: f64, allowed: f64| {
            if found.is_nan() {
                return f64::INFINITY;
            }
            // Without a bound where any phase of |L| > 1 is assumed, but still comparable.
            let found = if found < MOST { found } else { MOST };
            (found - allowed + self.closer).max(0.0)
        };
        let of_limits = |limits: &[Limit], bounded: Bounded| -> f64 {
            limits.iter().map(|limit| excess(decibels(over(Some(limit), bounded)), limit.decibels)).sum()
        };
        let peak = over(None, Bounded::S);
        let missed = of_limits(&self.wanted.sensitivity, Bounded::S)
            + of_limits(&self.wanted.complementary, Bounded::T)
            + self.ms.map_or(0.0, |ms| excess(peak, ms))
            + self.mt.map_or(0.0, |mt| excess(over(None, Bounded::T), mt))
            + self.missed_at_others(&open);
        let preferred = match self.wanted.prefer {
            Preference::Robustness => peak,
            Preference::Loads => self.slow.map_or(f64::INFINITY, |[difference, plant]| {
                sensitivity(plant * law.response(difference).measured)
            }),
        };
        if !preferred.is_nan() && !missed.is_nan() { Merit { missed, preferred } } else { Merit::NONE }
    }

    /// The slopes that the search begins from at these orders: among them some of the interval in which all
    /// gains, linear functions of the slope, have the sign of the plant.
    fn slopes(&self, lambda: f64, mu: f64, is_line: bool) -> Vec<f64> {
        const SHARES: u32 = 8;
        if self.wanted.flat_phase || is_line {
            return vec![0.0];
        }
        let at = |slope: f64| self.gains(Point { lambda, mu, slope }).0.map(|gain| gain * self.sign);
        let (mut low, mut high) = SLOPES;
        for (still, next) in at(0.0).into_iter().zip(at(1.0)) {
            let by = next - still;
            let zero = -still / by;
            if by > 0.0 {
                low = max_or_nan(low, zero);
            } else if by < 0.0 {
                high = min_or_nan(high, zero);
            } else if still <= 0.0 {
                return Vec::new();
            }
        }
        let shares = (0..SHARES).map(|k| low + (high - low) * (f64::from(k) + 0.5) / f64::from(SHARES));
        let round = (0..17).map(|k| -3.0 + 0.25 * f64::from(k));
        round.chain(shares).filter(|slope| low < *slope && *slope < high).collect()
    }

    /// The orders λ and µ that the search begins from.
    fn axes(&self, is_line: bool) -> [Vec<f64>; 2] {
        let Self { structure, wanted, .. } = self;
        let orders = |count: usize| {
            let step = (ORDERS.1 - ORDERS.0) / (count - 1) as f64;
            (0..count).map(move |k| ORDERS.0 + step * k as f64)
        };
        let axis = |known: Option<f64>, used: bool, count: usize| match known {
            Some(order) => vec![order],
            None if used => orders(count).collect(),
            None => vec![1.0],
        };
        let slopes_are_free = !wanted.flat_phase && !is_line;
        let count = if is_line {
            393
        } else if slopes_are_free {
            15
        } else {
            40
        };
        let lambdas = axis(structure.lambda, structure.terms.integrates(), count);
        let mus = axis(structure.mu, structure.terms.differentiates(), count);
        [lambdas, mus]
    }

    /// The best law that `stable` accepts.
    ///
    /// # Errors
    /// A sentence: that there is none, and which bounds the nearest one violates.
    pub(super) fn best(&self, stable: &dyn Fn(&Law) -> bool) -> Result<Law, String> {
        let Self { structure, wanted, .. } = self;
        let is_line = structure.terms != Terms::Pid;
        let [lambdas, mus] = self.axes(is_line);
        let mut candidates: Vec<(Point, Merit)> = Vec::new();
        if wanted.flat_phase && is_line {
            candidates.extend(self.flat(&lambdas, &mus));
        } else {
            for &lambda in &lambdas {
                for &mu in &mus {
                    for slope in self.slopes(lambda, mu, is_line) {
                        let point = Point { lambda, mu, slope };
                        let merit = self.merit(point);
                        if merit.missed.is_finite() {
                            candidates.push((point, merit));
                        }
                    }
                }
            }
        }
        candidates.sort_by(|a, b| a.1.number().total_cmp(&b.1.number()));
        if candidates.is_empty() {
            return Err(self.nothing());
        }
        let free = [lambdas.len() > 1, mus.len() > 1, !wanted.flat_phase && !is_line];
        let is_fixed = free == [false; 3] || (wanted.flat_phase && is_line);
        // The best of the stable loops that are found from a few starts.
        let mut best: Option<(Law, Merit)> = None;
        for (start, merit) in candidates.iter().take(if is_fixed { candidates.len() } else { 4 }) {
            let (point, merit) = if is_fixed { (*start, *merit) } else { self.improve(*start, free) };
            let better = best.as_ref().is_none_or(|best| merit.number() < best.1.number());
            if merit.missed <= SLACK
                && better
                && let Some(law) = self.law(point)
                && stable(&law)
            {
                best = Some((law, merit));
            }
        }
        if best.is_none() {
            best = candidates
                .iter()
                .filter(|candidate| candidate.1.missed <= SLACK)
                .find_map(|&(point, merit)| self.law(point).filter(stable).map(|law| (law, merit)));
        }
        if let Some((law, _)) = best {
            return Ok(law);
        }
        // If unstable loops satisfy the bounds they are ranked first; a stable loop that satisfies them may
        // be near a stable one that does not yet.
        let among = if candidates[0].1.missed <= SLACK { candidates.len() } else { SHOWN_FROM };
        let mut shown: Option<(Law, Merit)> = None;
        let near = candidates
            .iter()
            .take(among)
            .filter(|candidate| self.law(candidate.0).is_some_and(|law| stable(&law)));
        for &(start, merit) in near.take(if is_fixed { 1 } else { IMPROVED }) {
            let (point, merit) = if is_fixed { (start, merit) } else { self.improve(start, free) };
            let improved = self.law(point).filter(|law| stable(law)).map(|law| (law, merit));
            if shown.as_ref().is_none_or(|shown| merit.number() < shown.1.number()) {
                shown = improved.or(shown);
            }
        }
        // For the error message a stable candidate is more informative than an unstable one.
        let law = match shown {
            Some((law, merit)) if merit.missed <= SLACK => return Ok(law),
            Some((law, _)) => law,
            None if candidates[0].1.missed <= SLACK => {
                return Err(
                    "every loop with this crossover and phase margin that was tried is unstable".to_owned()
                );
            }
            None => match self.law(candidates[0].0) {
                Some(law) => law,
                None => return Err(self.nothing()),
            },
        };
        let missed = missed(&self.bounds_with(&law, &self.sampled.margins(&law), [self.ms, self.mt]));
        if missed.is_empty() && stable(&law) {
            // Between the points of the grid, where the search had only guessed.
            return Ok(law);
        }
        let what = match missed.is_empty() {
            true => "has motions that grow".to_owned(),
            false => format!("misses: {missed}"),
        };
        Err(format!(
            "no law with this crossover and phase margin meets all bounds; of those tried the nearest one ({}) {what}{}",
            in_words(&law),
            self.of_defaults()
        ))
    }

    /// A sentence about bounds that were not asked for.
    fn of_defaults(&self) -> String {
        let own = [("ms", self.wanted.ms, self.ms), ("mt", self.wanted.mt, self.mt)];
        let sought = own.into_iter().filter(|(_, asked, _)| asked.is_none());
        let sought = sought.filter_map(|(key, _, sought)| Some(format!("`{key}` ≤ {}", sought?)));
        let sought: Vec<String> = sought.collect();
        if sought.is_empty() {
            return String::new();
        }
        format!("; {} is sought by default: with the key more is allowed", sought.join(" and "))
    }

    fn nothing(&self) -> String {
        let phase = libm::atan2(self.at.im, self.at.re).to_degrees();
        let needed = self.wanted.phase_margin - 180.0 - phase;
        let needed = needed - 360.0 * (needed / 360.0).round();
        let flat = if self.wanted.flat_phase { " with a flat phase" } else { "" };
        format!(
            "no gains of the plant's sign have this crossover and phase margin{flat}: at ω = {} the plant has the phase \
             {phase:.2}°, and the controller would have to turn it by {needed:.2}°",
            self.wanted.crossover
        )
    }

    /// Orders at which the phase of a law with two gains is flat.
    fn flat(&self, lambdas: &[f64], mus: &[f64]) -> Vec<(Point, Merit)> {
        let point = |order: f64| match self.structure.terms {
            Terms::Pi => Point { lambda: order, mu: 1.0, slope: 0.0 },
            _ => Point { lambda: 1.0, mu: order, slope: 0.0 },
        };
        let orders = if self.structure.terms == Terms::Pi { lambdas } else { mus };
        let slope = |order: f64| self.law(point(order)).map(|law| self.slope(&law));
        let mut found = Vec::new();
        for pair in orders.windows(2) {
            let (Some(left), Some(right)) = (slope(pair[0]), slope(pair[1])) else { continue };
            if (left > 0.0) == (right > 0.0) {
                continue;
            }
            let (mut low, mut high) = (pair[0], pair[1]);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                match slope(middle) {
                    Some(value) if (value > 0.0) == (left > 0.0) => low = middle,
                    _ => high = middle,
                }
            }
            let order = point(0.5 * (low + high));
            let merit = self.merit(order);
            if merit.missed.is_finite() {
                found.push((order, merit));
            }
        }
        found
    }

    /// Improves a candidate by the simplex method of Nelder and Mead.
    fn improve(&self, start: Point, free: [bool; 3]) -> (Point, Merit) {
        let axes: Vec<usize> = (0..3).filter(|&axis| free[axis]).collect();
        let get = |point: &Point, axis: usize| [point.lambda, point.mu, point.slope][axis];
        let of = |numbers: &[f64]| {
            let mut point = start;
            for (&axis, &number) in axes.iter().zip(numbers) {
                match axis {
                    0 => point.lambda = number.clamp(ORDERS.0, ORDERS.1),
                    1 => point.mu = number.clamp(ORDERS.0, ORDERS.1),
                    _ => point.slope = number.clamp(SLOPES.0, SLOPES.1),
                }
            }
            point
        };
        let cost = |numbers: &[f64]| self.merit(of(numbers)).number();
        let first: Vec<f64> = axes.iter().map(|&axis| get(&start, axis)).collect();
        let mut simplex: Vec<(Vec<f64>, f64)> = vec![(first.clone(), cost(&first))];
        for axis in 0..axes.len() {
            let mut corner = first.clone();
            corner[axis] += if corner[axis] > 1.0 { -0.02 } else { 0.02 };
            let value = cost(&corner);
            simplex.push((corner, value));
        }
        for _ in 0..120 {
            simplex.sort_by(|a, b| a.1.total_cmp(&b.1));
            let count = simplex.len() - 1;
            let centre: Vec<f64> = (0..count)
                .map(|axis| simplex[..count].iter().map(|corner| corner.0[axis]).sum::<f64>() / count as f64)
                .collect();
            let worst = simplex[count].clone();
            let towards = |factor: f64| {
                let place: Vec<f64> =
                    centre.iter().zip(&worst.0).map(|(c, w)| c + factor * (c - w)).collect();
                let value = cost(&place);
                (place, value)
            };
            let reflected = towards(1.0);
            simplex[count] = if reflected.1 < simplex[0].1 {
                let expanded = towards(2.0);
                if expanded.1 < reflected.1 { expanded } else { reflected }
            } else if reflected.1 < simplex[count - 1].1 {
                reflected
            } else {
                let contracted = towards(if reflected.1 < worst.1 { 0.5 } else { -0.5 });
                if contracted.1 < worst.1 {
                    contracted
                } else {
                    let best = simplex[0].0.clone();
                    for corner in &mut simplex[1..] {
                        corner.0.iter_mut().zip(&best).for_each(|(x, b)| *x = 0.5 * (*x + b));
                        corner.1 = cost(&corner.0);
                    }
                    continue;
                }
            };
        }
        simplex.sort_by(|a, b| a.1.total_cmp(&b.1));
        let point = of(&simplex[0].0);
        (point, self.merit(point))
    }
}

/// True if the dead time turns the phase of L too often within a band to be resolved by points.
fn turns_too_often(plant: &Plant, limit: &Limit) -> bool {
    plant.dead_time() * (limit.to - limit.from) > MOST_TURNS
}
