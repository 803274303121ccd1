//! Relaxations c/(s + λ) that approximate a kernel, and their compression.
//!
//! Nodes with rates below the inverse of the horizon act as a polynomial in λ, those above the inverse of the
//! shortest step as a power of 1/λ times a polynomial in 1/λ: they are replaced by Gauss rules of the measure
//! of the nodes.

use crate::exponentials::jacobi_matrix::{JacobiMatrix, LONGEST_RULE};
use crate::quadrature::inverse::inverse;
use fvi_core::{Resolvent, RungeKutta};
use nalgebra::{SMatrix, SVector};
use std::ops::Range;

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
    pub(crate) early: Vec<Responses>,
    pub(crate) late: Vec<Responses>,
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
        // A larger group is not replaced by fewer nodes: its search begins where the last one ended.
        let mut fewest = 1;
        let mut slow = |reach: f64| {
            let count = nodes.partition_point(|node| node.rate * horizon <= reach);
            let group = (nodes, 0..count);
            let rule = late.shortest_rule(group, fewest, Relaxation::slow_rules(&nodes[..count]));
            fewest = if rule.len() < count { rule.len() } else { fewest };
            (count, rule)
        };
        let replaced = |from: usize, fewest: usize| {
            let group = &nodes[from..];
            let range = (nodes, from..nodes.len());
            let mut rule = early.shortest_rule(range, fewest, Relaxation::fast_rules(group));
            let (count, size) = (group.len(), rule.len());
            let worth =
                |nodes: &[Relaxation]| nodes.iter().map(|node| node.coefficient / node.rate).sum::<f64>();
            if let (Some(rate), true) = (closing, size < count) {
                rule.push(Relaxation { rate, coefficient: (worth(group) - worth(&rule)) * rate });
            }
            (size, (count, rule))
        };
        let mut fewest_fast = 1;
        let mut fast = |reach: f64| {
            let from = nodes.partition_point(|node| node.rate * shortest <= reach);
            let (size, found) = replaced(from, fewest_fast);
            fewest_fast = if size < found.0 { size } else { fewest_fast };
            found
        };
        // Of the candidates the one that saves most nodes.
        let most = |rules: Vec<(usize, Vec<Relaxation>)>| {
            let saved = |(replaced, rule): &(usize, Vec<Relaxation>)| replaced.saturating_sub(rule.len());
            rules.into_iter().max_by_key(saved).unwrap_or_default()
        };
        let (slow_count, slow_rule) = most(SLOW_REACHES.map(&mut slow).into());
        let (fast_count, fast_rule) = most(FAST_REACHES.map(&mut fast).into());
        // For runs of a few steps the two groups may overlap.
        let middle = nodes.get(slow_count..nodes.len() - fast_count);
        match middle {
            Some(middle) => [&slow_rule, middle, &fast_rule].concat(),
            None if closing.is_some() => [slow_rule, replaced(slow_count, 1).1.1].concat(),
            None => [&slow_rule, &nodes[slow_count..]].concat(),
        }
    }
}

impl Relaxation {
    /// Gauss rules of the measure in λ, by size.
    fn slow_rules(group: &[Self]) -> impl FnMut(usize) -> Vec<Self> {
        let unit = group.last().map_or(1.0, |node| node.rate).max(f64::MIN_POSITIVE);
        let measure: Vec<_> = group.iter().map(|node| (node.rate / unit, node.coefficient)).collect();
        let mut jacobi = JacobiMatrix::of(&measure);
        move |size| {
            let rule = jacobi.gauss_rule(size).into_iter();
            rule.map(|(x, coefficient)| Self { rate: x.max(0.0) * unit, coefficient }).collect()
        }
    }

    /// Gauss rules of the measure in u = 1/λ with the weight u², by size.
    fn fast_rules(group: &[Self]) -> impl FnMut(usize) -> Vec<Self> {
        let unit = group.first().map_or(1.0, |node| node.rate);
        let measure: Vec<_> = group
            .iter()
            .map(|node| (unit / node.rate, node.coefficient * (unit / node.rate).powi(2)))
            .collect();
        let mut jacobi = JacobiMatrix::of(&measure);
        move |size| {
            let node = |(u, mass): (f64, f64)| Self { rate: unit / u, coefficient: mass / (u * u) };
            let rule = jacobi.gauss_rule(size).into_iter().filter(|(u, _)| *u > 0.0);
            let mut rule: Vec<Self> = rule.map(node).collect();
            rule.sort_by(|a, b| a.rate.total_cmp(&b.rate));
            rule
        }
    }
}

/// Several f(λ) that need the same numbers, appended.
pub(crate) type Responses = Box<dyn Fn(f64, &mut Vec<f64>)>;

/// Values of responses at nodes.
fn values(responses: &[Responses], nodes: &[Relaxation]) -> Vec<Vec<f64>> {
    let at = |node: &Relaxation| {
        let mut values = Vec::new();
        responses.iter().for_each(|responses| responses(node.rate, &mut values));
        values
    };
    nodes.iter().map(at).collect()
}

/// Check that a rule can replace some nodes, by comparing responses.
struct Agreement {
    responses: Vec<Responses>,
    /// The values of all responses at each node.
    values: Vec<Vec<f64>>,
    /// The tolerance of each response.
    allowed: Vec<f64>,
}

impl Agreement {
    fn new(nodes: &[Relaxation], allowed: f64, responses: Vec<Responses>) -> Self {
        let values = values(&responses, nodes);
        let count = values.first().map_or(0, Vec::len);
        let of_nodes = || nodes.iter().zip(&values);
        let size = |index: usize| -> f64 {
            of_nodes().map(|(node, values)| node.coefficient * values[index].abs()).sum()
        };
        let allowed = (0..count).map(|index| allowed * size(index)).collect();
        Self { responses, values, allowed }
    }

    /// The shortest rule, of at least `fewest` nodes, that agrees with a range of the nodes; these themselves
    /// if there is none.
    fn shortest_rule(
        &self,
        (nodes, range): (&[Relaxation], Range<usize>),
        fewest: usize,
        rules: impl FnMut(usize) -> Vec<Relaxation>,
    ) -> Vec<Relaxation> {
        let sum = |nodes: &[Relaxation], values: &[Vec<f64>], index: usize| -> f64 {
            nodes.iter().zip(values).map(|(node, values)| node.coefficient * values[index]).sum()
        };
        let group = &nodes[range.clone()];
        let of_group = &self.values[range];
        let wanted: Vec<f64> = (0..self.allowed.len()).map(|index| sum(group, of_group, index)).collect();
        let agrees = |rule: &Vec<Relaxation>| {
            // Rules that are too short miss most responses: they are asked one after the other.
            let mut first = 0;
            self.responses.iter().all(|responses| {
                let values = values(std::slice::from_ref(responses), rule);
                let count = values.first().map_or(0, Vec::len);
                let places = first..first + count;
                first += count;
                let of = self.allowed[places.clone()].iter().zip(&wanted[places]).enumerate();
                of.into_iter()
                    .all(|(k, (allowed, wanted))| (sum(rule, &values, k) - wanted).abs() <= *allowed)
            })
        };
        let rule = (fewest.max(1)..group.len().min(LONGEST_RULE + 1)).map(rules).find(agrees);
        rule.unwrap_or_else(|| group.to_vec())
    }
}

/// Decay factors of a relaxation at times up to the horizon: e^{−λt} for many short steps, (1 + λt/2)^{−2}
/// for two long ones.
pub(crate) fn late_responses(horizon: f64) -> Vec<Responses> {
    let times = (0..24).map(move |k| horizon * 0.5_f64.powi(k));
    let of = |time: f64| -> Responses {
        Box::new(move |rate, values| {
            values.extend([(-rate * time).exp(), (1.0 + 0.5 * rate * time).powi(-2)]);
        })
    };
    times.map(of).collect()
}

/// The entries of (I + h′λA)⁻¹1 · R(−hλ)ⁿ · e_Rᵀ(I + hλA)⁻¹ for the shortest step h, some n and h′ ≥ h.
pub(crate) fn early_responses<const R: usize>(method: &RungeKutta<R>, shortest: f64) -> Vec<Responses> {
    let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
    let resolvents = Resolvent::<f64, R>::new(method);
    let at = move |x: f64| if R > 4 { vectors_of(&resolvents, x) } else { vectors_by_inverse(&matrix, x) };
    let of = |ratio: f64| -> Responses {
        Box::new(move |rate, values| {
            let ((_, before), (here, _)) = (at(shortest * rate), at(ratio * shortest * rate));
            let decay: f64 = before.iter().sum();
            for steps in [0, 1, 4] {
                let entry = |entry: usize| here[entry / R] * decay.powi(steps) * before[entry % R];
                values.extend((0..R * R).map(entry));
            }
        })
    };
    [1.0, 3.0, 30.0].map(of).into()
}

/// (I + xA)⁻¹ 1 and e_Rᵀ (I + xA)⁻¹.
fn vectors_by_inverse<const R: usize>(matrix: &SMatrix<f64, R, R>, x: f64) -> ([f64; R], [f64; R]) {
    let inverse = resolvent(matrix, x);
    let ones = inverse * SVector::<f64, R>::repeat(1.0);
    (std::array::from_fn(|stage| ones[stage]), std::array::from_fn(|stage| inverse[(R - 1, stage)]))
}

/// The same from the polynomials of the resolvent, for methods whose matrices are larger.
fn vectors_of<const R: usize>(resolvent: &Resolvent<f64, R>, x: f64) -> ([f64; R], [f64; R]) {
    // As homogeneous forms of two numbers of which none is larger than 1.
    let (high, low) = if x <= 1.0 { (x, 1.0) } else { (1.0, 1.0 / x) };
    let (mut column, mut row, mut determinant) = ([0.0; R], [0.0; R], 1.0);
    let mut power = 1.0;
    let coefficients = resolvent.columns().iter().zip(resolvent.rows()).zip(resolvent.determinant());
    for ((columns, rows), p) in coefficients {
        column.iter_mut().zip(columns).for_each(|(sum, c)| *sum = *sum * low + c * power);
        row.iter_mut().zip(rows).for_each(|(sum, c)| *sum = *sum * low + c * power);
        power *= high;
        determinant = determinant * low + p * power;
    }
    let factor = low / determinant;
    (column.map(|number| number * factor), row.map(|number| number * factor))
}

/// The entries of hA(I + hλA)⁻¹, the contribution of a relaxation within a step of length h.
pub(crate) fn responses_within<const R: usize>(matrix: &SMatrix<f64, R, R>, length: f64) -> Responses {
    let matrix = *matrix;
    Box::new(move |rate, values| {
        let within = matrix * resolvent(&matrix, length * rate);
        values.extend((0..R * R).map(|entry| within[(entry / R, entry % R)] * length));
    })
}

/// The same minus 1/λ where the relaxation decays within the step: the remainder if Σ c/λ is preserved.
pub(crate) fn responses_beyond<const R: usize>(matrix: &SMatrix<f64, R, R>, length: f64) -> Responses {
    let matrix = *matrix;
    Box::new(move |rate, values| {
        let resolvent = resolvent(&matrix, length * rate);
        let within = matrix * resolvent;
        values.extend((0..R * R).map(|entry| (entry / R, entry % R)).map(|entry| {
            if length * rate >= 1.0 { resolvent[entry] / rate } else { within[entry] * length }
        }));
    })
}

/// (I + xA)⁻¹, also for x whose determinants overflow.
fn resolvent<const R: usize>(matrix: &SMatrix<f64, R, R>, x: f64) -> SMatrix<f64, R, R> {
    const LARGE: f64 = 1e50;
    match x < LARGE {
        true => inverse(&(SMatrix::identity() + matrix * x)),
        false => inverse(&(SMatrix::identity() / x + matrix)) / x,
    }
}
