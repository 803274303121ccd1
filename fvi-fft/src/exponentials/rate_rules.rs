//! Relaxations c/(s + λ) that approximate a kernel, and their compression.
//!
//! Nodes with rates below the inverse of the horizon act as a polynomial in λ, those above the inverse of the
//! shortest step as a power of 1/λ times a polynomial in 1/λ: they are replaced by Gauss rules of the measure
//! of the nodes.

use crate::exponentials::exponential_table::{JacobiMatrix, LONGEST_RULE};
use crate::quadrature::inverse::inverse;
use nalgebra::{SMatrix, SVector};

/// Upper ends of the group of slow nodes for which Gauss rules are tried, as rate · horizon.
const SLOW_REACHES: [f64; 6] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0];

/// Lower ends of the group of fast nodes, as rate · shortest step.
const FAST_REACHES: [f64; 6] = [64.0, 32.0, 16.0, 8.0, 4.0, 2.0];

/// A relaxation c/(s + λ).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Relaxation {
    pub(crate) rate: f64,
    pub(crate) coefficient: f64,
}

/// Responses that the compression of nodes must preserve.
pub(crate) struct Compression {
    /// For the fast nodes, and for the slow ones.
    pub(crate) early: Vec<Response>,
    pub(crate) late: Vec<Response>,
    pub(crate) shortest: f64,
    pub(crate) horizon: f64,
    pub(crate) tolerance: f64,
    /// Rate of a relaxation that preserves Σ c/λ, the contribution of the replaced nodes within a step;
    /// `None` if that is preserved otherwise.
    pub(crate) closing: Option<f64>,
}

impl Compression {
    /// Positive nodes, slowest first, with the slowest and fastest replaced.
    pub(crate) fn of(self, nodes: &[Relaxation]) -> Vec<Relaxation> {
        let Self { early, late, shortest, horizon, tolerance, closing } = self;
        let allowed = (0.25 * tolerance).max(4.0 * f64::EPSILON);
        let late = Agreement::new(nodes, allowed, late);
        let early = Agreement::new(nodes, allowed, early);
        let slow = |reach: f64| {
            let count = nodes.partition_point(|node| node.rate * horizon <= reach);
            late.shortest_rule(&nodes[..count], Relaxation::slow_rules(&nodes[..count]))
        };
        let replaced = |group: &[Relaxation]| {
            let (count, mut rule) = early.shortest_rule(group, Relaxation::fast_rules(group));
            let worth =
                |nodes: &[Relaxation]| nodes.iter().map(|node| node.coefficient / node.rate).sum::<f64>();
            if let (Some(rate), true) = (closing, rule.len() < count) {
                rule.push(Relaxation { rate, coefficient: (worth(group) - worth(&rule)) * rate });
            }
            (count, rule)
        };
        let fast =
            |reach: f64| replaced(&nodes[nodes.partition_point(|node| node.rate * shortest <= reach)..]);
        // Of the candidates the one that saves most nodes.
        let most = |rules: Vec<(usize, Vec<Relaxation>)>| {
            let saved = |(replaced, rule): &(usize, Vec<Relaxation>)| replaced.saturating_sub(rule.len());
            rules.into_iter().max_by_key(saved).unwrap_or_default()
        };
        let (slow_count, slow_rule) = most(SLOW_REACHES.map(slow).into());
        let (fast_count, fast_rule) = most(FAST_REACHES.map(fast).into());
        // For runs of a few steps the two groups may overlap.
        let middle = nodes.get(slow_count..nodes.len() - fast_count);
        match middle {
            Some(middle) => [&slow_rule, middle, &fast_rule].concat(),
            None if closing.is_some() => [slow_rule, replaced(&nodes[slow_count..]).1].concat(),
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

    /// Gauss rules of the measure in u = 1/λ with the weight u², by size.
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
pub(crate) type Response = Box<dyn Fn(f64) -> f64>;

/// Check that a rule can replace some nodes, by comparing responses.
struct Agreement {
    /// Each response with its tolerance.
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

/// Decay factors of a relaxation at times up to the horizon: e^{−λt} for many short steps, (1 + λt/2)^{−2}
/// for two long ones.
pub(crate) fn late_responses(horizon: f64) -> Vec<Response> {
    let times = (0..24).map(move |k| horizon * 0.5_f64.powi(k));
    let responses = times.flat_map(|time| -> [Response; 2] {
        [Box::new(move |rate| (-rate * time).exp()), Box::new(move |rate| (1.0 + 0.5 * rate * time).powi(-2))]
    });
    responses.collect()
}

/// The entries of (I + h′λA)⁻¹1 · R(−hλ)ⁿ · e_Rᵀ(I + hλA)⁻¹ for the shortest step h, some n and h′ ≥ h.
pub(crate) fn early_responses<const R: usize>(matrix: &SMatrix<f64, R, R>, shortest: f64) -> Vec<Response> {
    let matrix = *matrix;
    let resolvent = move |x: f64| resolvent(&matrix, x);
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

/// The entries of hA(I + hλA)⁻¹, the contribution of a relaxation within a step of length h.
pub(crate) fn responses_within<const R: usize>(matrix: &SMatrix<f64, R, R>, length: f64) -> Vec<Response> {
    let matrix = *matrix;
    let entries = (0..R).flat_map(|i| (0..R).map(move |j| (i, j)));
    let response = |entry: (usize, usize)| -> Response {
        Box::new(move |rate: f64| (matrix * resolvent(&matrix, length * rate))[entry] * length)
    };
    entries.map(response).collect()
}

/// The same minus 1/λ where the relaxation decays within the step: the remainder if Σ c/λ is preserved.
pub(crate) fn responses_beyond<const R: usize>(matrix: &SMatrix<f64, R, R>, length: f64) -> Vec<Response> {
    let matrix = *matrix;
    let entries = (0..R).flat_map(|i| (0..R).map(move |j| (i, j)));
    let response = |entry: (usize, usize)| -> Response {
        Box::new(move |rate: f64| {
            let resolvent = resolvent(&matrix, length * rate);
            if length * rate >= 1.0 { resolvent[entry] / rate } else { (matrix * resolvent)[entry] * length }
        })
    };
    entries.map(response).collect()
}

/// (I + xA)⁻¹, also for x whose determinants overflow.
fn resolvent<const R: usize>(matrix: &SMatrix<f64, R, R>, x: f64) -> SMatrix<f64, R, R> {
    const LARGE: f64 = 1e50;
    match x < LARGE {
        true => inverse(&(SMatrix::identity() + matrix * x)),
        false => inverse(&(SMatrix::identity() / x + matrix)) / x,
    }
}
