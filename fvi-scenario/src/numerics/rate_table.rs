//! Tables for the memory of steps of any length: a power of the Laplace variable as a sum of relaxations.
//!
//! ```text
//! s^{−μ} = (sin πμ / π) ∫ λ^{1−μ} (s + λ)^{−1} d ln λ ,
//! t^{μ−1}/Γ(μ) = (sin πμ / π) ∫ λ^{1−μ} e^{−λt} d ln λ
//! ```
//!
//! The integrals over ln λ are those of analytic functions that decay at both ends, for which the trapezoidal
//! rule converges like e^{−π²/d} in its spacing d. What lies below the horizon's rate acts as a polynomial in
//! λ, what lies above the shortest step's as λ^{−2} times one in 1/λ: there Gauss rules of the trapezoidal
//! rule's own measure take the place of its nodes. So the number of rates grows with the logarithm of horizon
//! over shortest step, and by nothing else.

use std::f64::consts::PI;

use super::aligned::Aligned;
use super::exponential_table::{JacobiMatrix, LONGEST_RULE};
use super::inverse::inverse;
use super::runge_kutta_weights::RungeKuttaWeights;
use fvi_core::{ParameterError, RateTable, Real, RungeKutta};
use nalgebra::{SMatrix, SVector};

/// Smallest relative tolerance of a table: below it rounding decides.
pub const SMALLEST_TOLERANCE: f64 = 1e-14;

/// Rates in a block of the core's memory.
const BLOCK: usize = 4;

/// How far the slow nodes reach that a Gauss rule is tried for, as rate · horizon.
const SLOW_REACHES: [f64; 6] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0];

/// How far down the fast nodes reach, as rate · shortest step.
const FAST_REACHES: [f64; 6] = [64.0, 32.0, 16.0, 8.0, 4.0, 2.0];

/// A relaxation c/(s + λ).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Relaxation {
    rate: f64,
    coefficient: f64,
}

/// The table of D^`exponent` for a method, for steps from `shortest` on and times up to `horizon`, with the
/// weights of the past within the relative tolerance `tolerance`.
///
/// # Errors
/// If the exponent is outside (−1, 2), the lengths are outside [10⁻²⁸⁰, 10²⁸⁰], the horizon is shorter than
/// the shortest step, or the tolerance is outside [10⁻¹⁴, 10⁻¹].
pub fn rate_table<T: Real, const R: usize>(
    method: &RungeKutta<R>,
    exponent: f64,
    shortest: f64,
    horizon: f64,
    tolerance: f64,
) -> Result<RateTable<Aligned<T>>, ParameterError> {
    let range = |accepted, parameter, value, allowed| match accepted {
        true => Ok(()),
        false => Err(ParameterError { parameter, value, allowed }),
    };
    // Beyond, rates and coefficients are no numbers of double precision.
    range(
        (1e-280..=1e280).contains(&shortest),
        "shortest step",
        shortest,
        "at least 1e-280 and at most 1e280",
    )?;
    range(
        (shortest..=1e280).contains(&horizon),
        "horizon",
        horizon,
        "at least the shortest step and at most 1e280",
    )?;
    range(
        (SMALLEST_TOLERANCE..=0.1).contains(&tolerance),
        "tolerance",
        tolerance,
        "at least 1e-14 and at most 0.1",
    )?;
    let leading = *RungeKuttaWeights::new(method, exponent, 1.0, 1)?.leading();
    let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
    let relaxations = if exponent == exponent.round() {
        Vec::new()
    } else {
        Power { mu: exponent.ceil() - exponent, jump: (PI * (exponent - exponent.round())).sin().abs() / PI }
            .compressed(early_responses(&matrix, shortest), [shortest, horizon], tolerance)
    };
    let filled = relaxations.len().next_multiple_of(BLOCK);
    let numbers = |of: &dyn Fn(&Relaxation) -> f64| {
        let numbers = relaxations.iter().map(|relaxation| T::of(of(relaxation)));
        numbers.chain(std::iter::repeat(T::zero())).take(filled).collect::<Aligned<T>>()
    };
    Ok(RateTable {
        exponent,
        leading: (0..R * R).map(|index| T::of(leading[(index / R, index % R)])).collect(),
        rates: numbers(&|relaxation| relaxation.rate),
        coefficients: numbers(&|relaxation| relaxation.coefficient),
        shortest,
        horizon,
    })
}

/// s^{−μ}
struct Power {
    mu: f64,
    /// sin(πμ)/π, exact to rounding also near a whole order.
    jump: f64,
}

impl Power {
    /// Spacing of the trapezoidal rule at which its relative error is half the tolerance:
    /// 2 |Γ(1−μ + 2πi/d)| / Γ(1−μ), by Stirling's formula.
    fn spacing(&self, tolerance: f64) -> f64 {
        let error = |d: f64| {
            let power = (2.0 * PI / d).powf(0.5 - self.mu);
            2.0 * (2.0 * PI).sqrt() * power * (-PI * PI / d).exp() / libm::tgamma(1.0 - self.mu)
        };
        let (mut fine, mut coarse) = (0.05, 4.0);
        for _ in 0..60 {
            let middle = 0.5 * (fine + coarse);
            if error(middle) < 0.5 * tolerance { fine = middle } else { coarse = middle }
        }
        fine
    }

    /// The trapezoidal rule, slowest node first. Nodes so slow that they stand still up to the horizon, a
    /// geometric series, are one of rate 0; faster ones than the last add less than the tolerance to any
    /// step.
    fn trapezoidal_rule(&self, shortest: f64, horizon: f64, tolerance: f64) -> Vec<Relaxation> {
        let (spacing, ratio) = (self.spacing(tolerance), 1.0 - self.mu);
        let fastest = (100.0 / tolerance).ln() / (1.0 + self.mu) - shortest.ln();
        let standing = (0.01 * tolerance / horizon).ln();
        let count = ((fastest - standing) / spacing).ceil().max(1.0) as usize;
        let at = |k: usize| fastest - k as f64 * spacing;
        let node = |k: usize| Relaxation {
            rate: at(k).exp(),
            coefficient: self.jump * spacing * (ratio * at(k)).exp(),
        };
        let rest = self.jump * spacing * (ratio * at(count)).exp() / libm::expm1(spacing * ratio);
        std::iter::once(Relaxation { rate: 0.0, coefficient: rest })
            .chain((0..=count).rev().map(node))
            .collect()
    }

    /// The rule with its slowest and fastest nodes compressed, for a method whose shortest step has these
    /// responses.
    fn compressed(
        &self,
        early_responses: Vec<Response>,
        [shortest, horizon]: [f64; 2],
        tolerance: f64,
    ) -> Vec<Relaxation> {
        let nodes = self.trapezoidal_rule(shortest, horizon, tolerance);
        let allowed = (0.25 * tolerance).max(4.0 * f64::EPSILON);
        let late = Agreement::new(&nodes, allowed, late_responses(horizon));
        let early = Agreement::new(&nodes, allowed, early_responses);
        let slow = |reach: f64| {
            let count = nodes.partition_point(|node| node.rate * horizon <= reach);
            late.shortest_rule(&nodes[..count], Relaxation::slow_rules(&nodes[..count]))
        };
        let fast = |reach: f64| {
            let count = nodes.partition_point(|node| node.rate * shortest <= reach);
            early.shortest_rule(&nodes[count..], Relaxation::fast_rules(&nodes[count..]))
        };
        // Of the reaches, the one that saves most.
        let most = |rules: Vec<(usize, Vec<Relaxation>)>| {
            rules.into_iter().max_by_key(|(replaced, rule)| replaced - rule.len()).unwrap_or_default()
        };
        let (slow_count, slow_rule) = most(SLOW_REACHES.map(slow).into());
        let (fast_count, fast_rule) = most(FAST_REACHES.map(fast).into());
        // Runs of a few steps: the two may meet.
        let middle = nodes.get(slow_count..nodes.len() - fast_count);
        match middle {
            Some(middle) => [&slow_rule, middle, &fast_rule].concat(),
            None => [&slow_rule, &nodes[slow_count..]].concat(),
        }
    }
}

impl Relaxation {
    /// Gauss rules of the measure in λ, by size.
    fn slow_rules(group: &[Self]) -> impl Fn(usize) -> Vec<Self> {
        let unit = group.last().map_or(1.0, |node| node.rate).max(f64::MIN_POSITIVE);
        let measure: Vec<_> = group.iter().map(|node| (node.rate / unit, node.coefficient)).collect();
        let jacobi = JacobiMatrix::of(&measure);
        move |size| {
            let rule = jacobi.gauss_rule(size).into_iter();
            rule.map(|(x, coefficient)| Self { rate: x.max(0.0) * unit, coefficient }).collect()
        }
    }

    /// Gauss rules of the measure in u = 1/λ with weight u², by size.
    fn fast_rules(group: &[Self]) -> impl Fn(usize) -> Vec<Self> {
        let unit = group.first().map_or(1.0, |node| node.rate);
        let measure: Vec<_> = group
            .iter()
            .map(|node| (unit / node.rate, node.coefficient * (unit / node.rate).powi(2)))
            .collect();
        let jacobi = JacobiMatrix::of(&measure);
        move |size| {
            let node = |(u, mass): (f64, f64)| Self { rate: unit / u, coefficient: mass / (u * u) };
            let rule = jacobi.gauss_rule(size).into_iter().filter(|(u, _)| *u > 0.0);
            let mut rule: Vec<Self> = rule.map(node).collect();
            rule.sort_by(|a, b| a.rate.total_cmp(&b.rate));
            rule
        }
    }
}

/// f(λ)
type Response = Box<dyn Fn(f64) -> f64>;

/// Whether a rule takes the place of some nodes, judged by responses.
struct Agreement {
    /// Each with the difference that is allowed.
    responses: Vec<(Response, f64)>,
}

impl Agreement {
    fn new(nodes: &[Relaxation], allowed: f64, responses: Vec<Response>) -> Self {
        let responses = responses.into_iter().map(|response| {
            let size: f64 = nodes.iter().map(|node| node.coefficient * response(node.rate).abs()).sum();
            (response, allowed * size)
        });
        Self { responses: responses.collect() }
    }

    /// Number of nodes replaced and the shortest rule that agrees with them, or the nodes themselves.
    fn shortest_rule(
        &self,
        group: &[Relaxation],
        rules: impl Fn(usize) -> Vec<Relaxation>,
    ) -> (usize, Vec<Relaxation>) {
        let sum = |nodes: &[Relaxation], response: &Response| -> f64 {
            nodes.iter().map(|node| node.coefficient * response(node.rate)).sum()
        };
        let wanted: Vec<f64> = self.responses.iter().map(|(response, _)| sum(group, response)).collect();
        let agrees = |rule: &Vec<Relaxation>| {
            let of_rule = self.responses.iter().zip(&wanted);
            of_rule
                .into_iter()
                .all(|((response, allowed), wanted)| (sum(rule, response) - wanted).abs() <= *allowed)
        };
        let rule = (1..group.len().min(LONGEST_RULE + 1)).map(rules).find(agrees);
        (group.len(), rule.unwrap_or_else(|| group.to_vec()))
    }
}

/// What is left of a relaxation after times up to the horizon: of many short steps e^{−λt}, of two long ones
/// (1 + λt/2)^{−2}.
fn late_responses(horizon: f64) -> Vec<Response> {
    let times = (0..24).map(move |k| horizon * 0.5_f64.powi(k));
    let responses = times.flat_map(|time| -> [Response; 2] {
        [Box::new(move |rate| (-rate * time).exp()), Box::new(move |rate| (1.0 + 0.5 * rate * time).powi(-2))]
    });
    responses.collect()
}

/// The entries of (I + h′λA)⁻¹1 · R(−hλ)ⁿ · e_Rᵀ(I + hλA)⁻¹ for the shortest step h, some n and h′ ≥ h.
fn early_responses<const R: usize>(matrix: &SMatrix<f64, R, R>, shortest: f64) -> Vec<Response> {
    let matrix = *matrix;
    let resolvent = move |x: f64| inverse(&(SMatrix::identity() + matrix * x));
    let shapes = [1.0, 3.0, 30.0].into_iter().flat_map(|ratio| [0, 1, 4].map(|steps| (ratio, steps)));
    let entries = shapes.flat_map(|shape| (0..R * R).map(move |entry| (shape, entry)));
    let response = move |((ratio, steps), entry): ((f64, i32), usize)| -> Response {
        Box::new(move |rate: f64| {
            let before = resolvent(shortest * rate);
            let here = resolvent(ratio * shortest * rate) * SVector::repeat(1.0);
            let decay = before.row(R - 1).sum();
            here[entry / R] * decay.powi(steps) * before[(R - 1, entry % R)]
        })
    };
    entries.map(response).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn radau() -> RungeKutta<3> {
        RungeKutta::radau_iia().unwrap()
    }

    #[test]
    fn the_relaxations_sum_to_the_kernel_over_seventeen_decades() {
        for exponent in [0.05, 0.3, 0.5, 0.97, 1.5, 1.9, -0.4] {
            for (tolerance, most) in [(1e-12, 150), (1e-6, 90)] {
                let table = rate_table::<f64, 3>(&radau(), exponent, 1e-9, 1e8, tolerance).unwrap();
                let (rates, coefficients) = (table.rates.as_ref(), table.coefficients.as_ref());
                assert!(rates.len() <= most, "{} rates for {exponent}, {tolerance:e}", rates.len());
                let mu = exponent.ceil() - exponent;
                for decade in 0..=68 {
                    // The shortest step is where the memory begins; its stages lie within.
                    let time = 1e-8 * 10_f64.powf(f64::from(decade) / 4.25);
                    let terms = rates.iter().zip(coefficients).map(|(rate, c)| c * (-rate * time).exp());
                    let exact = time.powf(mu - 1.0) / libm::tgamma(mu);
                    let error = terms.sum::<f64>() / exact - 1.0;
                    assert!(error.abs() < tolerance, "{exponent}, {tolerance:e}: {error:e} at {time:e}");
                }
            }
        }
    }

    #[test]
    fn whole_orders_need_no_rates() {
        for exponent in [0.0, 1.0] {
            let table = rate_table::<f64, 3>(&radau(), exponent, 1e-3, 1.0, 1e-12).unwrap();
            assert!(table.rates.as_ref().is_empty());
        }
    }

    #[test]
    fn what_no_table_serves_is_refused() {
        let table = |exponent, shortest, horizon, tolerance| {
            rate_table::<f64, 3>(&radau(), exponent, shortest, horizon, tolerance).is_ok()
        };
        assert!(table(0.5, 0.1, 1.0, 1e-12) && table(0.5, 1.0, 1.0, 1e-12));
        assert!(!table(2.0, 0.1, 1.0, 1e-12) && !table(0.5, 0.0, 1.0, 1e-12));
        assert!(!table(0.5, 0.1, 0.01, 1e-12) && !table(0.5, 0.1, f64::NAN, 1e-12));
        assert!(!table(0.5, 0.1, 1.0, 1e-16));
    }
}
