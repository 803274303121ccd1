//! Gains and orders that meet a specification.

use super::law::{Law, filter, power};
use super::margins::{
    Loop, complementary, complementary_at_any_phase, largest, largest_by_parabolas, sensitivity,
    sensitivity_at_any_phase, summit,
};
use super::plant::Plant;
use super::problem::{Crossover, Limit, Preference, Structure, Terms};
use fvi_core::PidGains;
use nalgebra::Complex;
use std::f64::consts::PI;

/// Range of the orders, where they are free.
const ORDERS: (f64, f64) = (0.02, 1.98);

/// Range of the slope d arg L/d ln ω, where the phase need not be flat.
const SLOPES: (f64, f64) = (-3.0, 1.0);

/// Bound on Ms and Mt where a specification has free parameters and no bound of its own.
const DEFAULT_MS: f64 = 2.0;
const DEFAULT_MT: f64 = 1.3;

/// Number of candidates among which a stable one is sought for the error message, if none meets the
/// specification.
const SHOWN_FROM: usize = 300;

/// Largest phase change of e^{−iωL}, in radians, between points at which a bound is checked; where the dead
/// time would need too many points, the bound is required for any phase.
const TURN: f64 = 0.5;
const MOST_TURNS: f64 = 2000.0;

/// Relative safety margin of bounds in the search, which checks them at discrete points only.
const CLOSER: f64 = 1e-4;

/// Violation of a bound, in decibels or relative, up to which it counts as met.
const SLACK: f64 = 1e-6;

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

/// A search for a crossover.
pub(super) struct Search<'a> {
    plant: &'a Plant,
    structure: &'a Structure,
    wanted: &'a Crossover,
    /// P(iω_c) and d arg P/d ln ω there.
    at: Complex<f64>,
    plant_slope: f64,
    /// Frequencies at which bounds are checked, with P(iω).
    points: Vec<(f64, Complex<f64>)>,
    ms: Option<f64>,
    mt: Option<f64>,
    sign: f64,
}

/// A bound and the value reached.
#[derive(Clone, Debug, PartialEq)]
pub struct Bound {
    /// What is bounded, in words.
    pub what: String,
    /// The bound.
    pub allowed: f64,
    /// The value reached.
    pub found: f64,
}

impl<'a> Search<'a> {
    /// Prepares a search.
    ///
    /// # Errors
    /// A sentence, where the plant has no value at the crossover.
    pub(super) fn new(
        plant: &'a Plant,
        structure: &'a Structure,
        wanted: &'a Crossover,
    ) -> Result<Self, String> {
        let omega = wanted.crossover;
        let value = |omega: f64| plant.at(Complex::new(0.0, omega)).map(|plant| plant.value);
        let missing = || format!("the plant has no value at ω = {omega}");
        let at = value(omega).filter(|value| value.norm() > 0.0 && value.norm().is_finite());
        let at = at.ok_or_else(missing)?;
        // Central differences of order four in ln ω.
        let turn = |step: f64| {
            let ratio = value(omega * libm::exp(step))? / value(omega * libm::exp(-step))?;
            Some(libm::atan2(ratio.im, ratio.re) / (2.0 * step))
        };
        let step = (1e-3f64).min(0.1 / (1.0 + omega * plant.dead_time()));
        let plant_slope = turn(step)
            .zip(turn(2.0 * step))
            .map(|(near, far)| (4.0 * near - far) / 3.0)
            .ok_or_else(missing)?;
        let mut frequencies: Vec<f64> =
            (-300..=300).map(|index| omega * libm::exp(f64::from(index) * 0.03)).collect();
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
        frequencies.sort_by(f64::total_cmp);
        frequencies.dedup();
        let points = frequencies.into_iter().filter_map(|omega| Some((omega, value(omega)?))).collect();
        let free = [
            structure.terms.integrates() && structure.lambda.is_none(),
            structure.terms.differentiates() && structure.mu.is_none(),
            structure.terms == Terms::Pid && !wanted.flat_phase,
        ];
        let equations = usize::from(wanted.flat_phase && structure.terms != Terms::Pid);
        let has_choice = free.iter().filter(|&&free| free).count() > equations;
        let ms = wanted.ms.or(has_choice.then_some(DEFAULT_MS));
        // At the crossover |S| = |T| = 1/(2 sin(φ_m/2)) for every law.
        let there = 0.5 / libm::sin(0.5 * wanted.phase_margin.to_radians());
        let mt = wanted.mt.or(has_choice.then_some(DEFAULT_MT.max(1.1 * there)));
        let sign = plant.sign();
        Ok(Self { plant, structure, wanted, at, plant_slope, points, ms, mt, sign })
    }

    /// The law with these orders and this slope that has the crossover and the phase margin; `None` if its
    /// gains would have other signs than the plant.
    fn law(&self, point: Point) -> Option<Law> {
        let Self { structure, wanted, .. } = self;
        let s = Complex::new(0.0, wanted.crossover);
        let margin = wanted.phase_margin.to_radians() - PI;
        let needed = Complex::new(libm::cos(margin), libm::sin(margin)) / self.at;
        let integral = (power(s, -point.lambda), power(s, -point.lambda) * -point.lambda);
        let [through, slope] = filter(structure.filter, s);
        let derived = power(s, point.mu) / through;
        let derivative = (derived, derived * (Complex::new(point.mu, 0.0) - slope / through));
        let [proportional, ki, kd] = match structure.terms {
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
        let sign = self.sign;
        let used = [true, structure.terms.integrates(), structure.terms.differentiates()];
        let right = [proportional, ki, kd]
            .iter()
            .zip(used)
            .all(|(gain, used)| if used { gain * sign > 0.0 && gain.is_finite() } else { *gain == 0.0 });
        let parts = proportional.abs() + ki.abs() * integral.0.norm() + kd.abs() * derivative.0.norm();
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
        let s = |step: f64| Complex::new(0.0, self.wanted.crossover * libm::exp(step));
        let step = 1e-3;
        let turn = |step: f64| {
            let ratio = law.response(s(step)).measured / law.response(s(-step)).measured;
            libm::atan2(ratio.im, ratio.re) / (2.0 * step)
        };
        (4.0 * turn(step) - turn(2.0 * step)) / 3.0 + self.plant_slope
    }

    /// The bounds of the specification with the values that a law reaches.
    pub(super) fn bounds(&self, law: &Law) -> Vec<Bound> {
        let open: &Loop<'_> = &|omega| {
            let s = Complex::new(0.0, omega);
            Some(self.plant.at(s)?.value * law.response(s).measured)
        };
        let points: Vec<(f64, Complex<f64>)> = self
            .points
            .iter()
            .map(|&(omega, plant)| (omega, plant * law.response(Complex::new(0.0, omega)).measured))
            .collect();
        let mut bounds = Vec::new();
        let mut limits = |limits: &[Limit], bounded: Bounded| {
            for limit in limits {
                let size = bounded.size(turns_too_often(self.plant, limit));
                let inside: Vec<_> = points
                    .iter()
                    .filter(|(omega, _)| (limit.from..=limit.to).contains(omega))
                    .copied()
                    .collect();
                let found = if inside.is_empty() { f64::NAN } else { largest(&inside, open, size).1 };
                let range = if limit.from == limit.to {
                    format!("{}", limit.from)
                } else {
                    format!("{} … {}", limit.from, limit.to)
                };
                let what = format!("|{bounded:?}(iω)| in dB at ω = {range}");
                bounds.push(Bound { what, allowed: limit.decibels, found: 20.0 * libm::log10(found) });
            }
        };
        limits(&self.wanted.sensitivity, Bounded::S);
        limits(&self.wanted.complementary, Bounded::T);
        type Size = fn(Complex<f64>) -> f64;
        for (bound, what, size) in
            [(self.ms, "Ms", sensitivity as Size), (self.mt, "Mt", complementary as Size)]
        {
            if let Some(allowed) = bound {
                let what = what.to_owned();
                bounds.push(Bound { what, allowed, found: largest(&points, open, size).1 });
            }
        }
        bounds
    }

    fn merit(&self, point: Point) -> Merit {
        let Some(law) = self.law(point) else { return Merit::NONE };
        let open: Vec<(f64, Complex<f64>)> = self
            .points
            .iter()
            .map(|&(omega, plant)| (omega, plant * law.response(Complex::new(0.0, omega)).measured))
            .collect();
        let over = |limit: Option<&Limit>, size: fn(Complex<f64>) -> f64| {
            let inside = open
                .iter()
                .filter(|point| limit.is_none_or(|limit| (limit.from..=limit.to).contains(&point.0)));
            largest_by_parabolas(inside.map(|point| point.1), size)
        };
        let decibels = |value: f64| 20.0 * libm::log10(value);
        let beyond = |found: f64, allowed: f64| {
            if found.is_finite() { (found - allowed + CLOSER).max(0.0) } else { f64::INFINITY }
        };
        let of_limits = |limits: &[Limit], bounded: Bounded| -> f64 {
            let found = |limit: &Limit| {
                let size = bounded.size(turns_too_often(self.plant, limit));
                beyond(decibels(over(Some(limit), size)), limit.decibels)
            };
            limits.iter().map(found).sum()
        };
        let peak = over(None, sensitivity);
        let missed = of_limits(&self.wanted.sensitivity, Bounded::S)
            + of_limits(&self.wanted.complementary, Bounded::T)
            + self.ms.map_or(0.0, |ms| beyond(peak, ms))
            + self.mt.map_or(0.0, |mt| beyond(over(None, complementary), mt));
        let preferred = match self.wanted.prefer {
            Preference::Robustness => peak,
            Preference::Loads => {
                let s = Complex::new(0.0, 0.1 * self.wanted.crossover);
                self.plant
                    .at(s)
                    .map_or(f64::INFINITY, |plant| sensitivity(plant.value * law.response(s).measured))
            }
        };
        if preferred.is_finite() { Merit { missed, preferred } } else { Merit::NONE }
    }

    /// The best law that `stable` accepts.
    ///
    /// # Errors
    /// A sentence: that there is none, and which bounds the nearest one violates.
    pub(super) fn best(&self, stable: &dyn Fn(&Law) -> bool) -> Result<Law, String> {
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
        let is_line = structure.terms != Terms::Pid;
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
        let slopes: Vec<f64> = if wanted.flat_phase || is_line {
            vec![0.0]
        } else {
            (0..17).map(|k| SLOPES.0 + (SLOPES.1 - SLOPES.0) * f64::from(k) / 16.0).collect()
        };
        let mut candidates: Vec<(Point, Merit)> = Vec::new();
        if wanted.flat_phase && is_line {
            candidates.extend(self.flat(&lambdas, &mus));
        } else {
            for &lambda in &lambdas {
                for &mu in &mus {
                    for &slope in &slopes {
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
        let free = [lambdas.len() > 1, mus.len() > 1, slopes.len() > 1];
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
        let missed: Vec<String> = self
            .bounds(&law)
            .iter()
            .filter(|bound| bound.found.is_nan() || bound.found > bound.allowed + SLACK)
            .map(|bound| format!("{} is {:.4} instead of at most {}", bound.what, bound.found, bound.allowed))
            .collect();
        let [kp, ki, kd] = law.three();
        Err(format!(
            "no law with this crossover and phase margin meets all bounds; of those tried the nearest one (kp = {kp:.5}, ki = {ki:.5}, lambda \
             = {:.4}, kd = {kd:.5}, mu = {:.4}) misses: {}",
            law.lambda,
            law.mu,
            missed.join("; ")
        ))
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

/// The largest integral gain (of a PI^λ), or proportional gain (of a PD^μ), with |S| ≤ Ms and |T| ≤ Mt.
///
/// For a fixed ratio of the two gains, the largest admissible gain k is the smallest positive root of a
/// quadratic, over all frequencies; the ratio is then optimised in one dimension. \[APH98\]
///
/// # Errors
/// A sentence, if the bounds hold for any gain.
pub(super) fn by_sensitivity(
    plant: &Plant,
    structure: &Structure,
    (ms, mt): (f64, Option<f64>),
) -> Result<Law, String> {
    let (lambda, mu) = (structure.lambda.unwrap_or(1.0), structure.mu.unwrap_or(1.0));
    let (scale, sign) = (plant.scale(), plant.sign());
    let law = |ratio: f64, gain: f64| {
        let (integral, derivative) = match structure.terms {
            Terms::Pi => (ratio * gain * sign, 0.0),
            _ => (0.0, ratio * gain * sign),
        };
        Law {
            gains: PidGains::Parallel { proportional: gain * sign, integral, derivative },
            lambda,
            mu,
            filter: structure.filter,
            setpoint_weights: structure.setpoint_weights,
        }
    };
    let step = 0.01f64.min(0.2 / (1.0 + scale * plant.dead_time()));
    let count = (libm::log(1e7) / step) as usize;
    let points: Vec<(f64, Complex<f64>)> = (0..count)
        .map(|k| 1e-4 * scale * libm::exp(step * k as f64))
        .filter_map(|omega| Some((omega, plant.at(Complex::new(0.0, omega))?.value)))
        .collect();
    let largest_gain = |value: Complex<f64>| {
        let square = value.norm_sqr();
        let root = |a: f64, c: f64| {
            // a k² + 2 Re G k + c = 0
            let discriminant = value.re * value.re - a * c;
            if value.re < 0.0 && discriminant >= 0.0 {
                c / (libm::sqrt(discriminant) - value.re)
            } else {
                f64::INFINITY
            }
        };
        let by_s = root(square, 1.0 - 1.0 / (ms * ms));
        mt.map_or(by_s, |mt| by_s.min(root(square * (1.0 - 1.0 / (mt * mt)), 1.0)))
    };
    let gain_of = |ratio: f64| {
        let unit = law(ratio, 1.0);
        let at = |omega: f64, plant: Complex<f64>| {
            largest_gain(plant * unit.response(Complex::new(0.0, omega)).measured)
        };
        let (index, least) = points
            .iter()
            .map(|&(omega, plant)| at(omega, plant))
            .enumerate()
            .fold((0, f64::INFINITY), |best, (index, gain)| if gain < best.1 { (index, gain) } else { best });
        if least.is_infinite() {
            return least;
        }
        let (low, high) = (points[index.saturating_sub(1)].0, points[(index + 1).min(points.len() - 1)].0);
        let negative = |omega: f64| {
            let value = plant.at(Complex::new(0.0, omega)).map_or(Complex::ZERO, |plant| plant.value);
            -at(omega, value)
        };
        least.min(-summit(&negative, low, high).1)
    };
    // The gain to be maximised: K_i for PI, K_p for PD.
    let merit = |ratio: f64| {
        let gain = gain_of(ratio);
        match structure.terms {
            Terms::Pi => ratio * gain,
            _ => gain,
        }
    };
    let exponent = if structure.terms == Terms::Pi { lambda } else { -mu };
    let ratio_at = |x: f64| libm::pow(scale * libm::exp(x), exponent);
    let places: Vec<f64> = (-69..=69).map(|k| 0.1 * f64::from(k)).collect();
    let merits: Vec<f64> = places.iter().map(|&x| merit(ratio_at(x))).collect();
    let (index, &found) =
        merits.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).ok_or_else(String::new)?;
    if !found.is_finite() {
        return Err(
            "any gain keeps this Ms: the plant's phase stays above −180° with this controller".to_owned()
        );
    }
    let (low, high) = (places[index.saturating_sub(1)], places[(index + 1).min(places.len() - 1)]);
    let (x, _) = summit(&|x| merit(ratio_at(x)), low, high);
    let ratio = ratio_at(x);
    Ok(law(ratio, gain_of(ratio)))
}
