//! The Gauss rule of a step with the Lobatto rule of its constraints.

use crate::error::ParameterError;
use crate::linear::at;
use crate::quadrature::{gauss_rule, lobatto_rule};
use crate::real::Real;

/// Largest number of stages s.
pub const MOST_STAGES: usize = 6;

/// Largest number of knots, s + 1.
const MOST_KNOTS: usize = MOST_STAGES + 1;

/// A table of R rows and C columns.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Table<T, const R: usize, const C: usize>([[T; C]; R]);

impl<T: Real, const R: usize, const C: usize> Table<T, R, C> {
    /// The table of a function of row and column, in double precision until here.
    fn of(number: impl Fn(usize, usize) -> f64) -> Self {
        let mut rows = [[T::zero(); C]; R];
        for (i, row) in rows.iter_mut().enumerate() {
            row.iter_mut().enumerate().for_each(|(j, place)| *place = T::of(number(i, j)));
        }
        Self(rows)
    }

    #[inline(always)]
    fn at(&self, row: usize, column: usize) -> T {
        at(self.0.as_flattened(), row * C + column)
    }
}

/// Gauss collocation with s stages, and the Lobatto rule with s + 1 knots at which constraints hold.
///
/// ```text
/// a_ij = ∫₀^{c_i} ℓ_j ,   ã_jk = ∫₀^{c̃_j} ℓ_k ,   â_ij = b̃_j (1 − ã_ji / b_i)
/// ```
///
/// with the Gauss nodes c and weights b, their Lagrange polynomials ℓ, and the Lobatto knots c̃ and weights
/// b̃: the (s, s)-Gauss–Lobatto method, of order 2s. Source: \[Jay07\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussLobatto<T> {
    stages: usize,
    rule: Table<T, 2, MOST_STAGES>,
    matrix: Table<T, MOST_STAGES, MOST_STAGES>,
    knot_weights: Table<T, 1, MOST_KNOTS>,
    at_knots: Table<T, MOST_KNOTS, MOST_STAGES>,
    conjugate: Table<T, MOST_STAGES, MOST_KNOTS>,
    ahead: Table<T, MOST_STAGES, MOST_STAGES>,
    at_end: Table<T, 1, MOST_STAGES>,
}

impl<T: Real> GaussLobatto<T> {
    /// The method of s stages.
    ///
    /// # Errors
    /// If s is not one of 1…6.
    pub fn new(stages: usize) -> Result<Self, ParameterError> {
        let (mut nodes, mut weights) = ([0.0; MOST_STAGES], [0.0; MOST_STAGES]);
        let (mut knots, mut knot_weights) = ([0.0; MOST_KNOTS], [0.0; MOST_KNOTS]);
        let unknown = ParameterError { parameter: "stages", value: stages as f64, allowed: "one of 1…6" };
        let places = nodes.get_mut(..stages).zip(weights.get_mut(..stages));
        let (c, b) = places.filter(|_| stages > 0).ok_or(unknown)?;
        gauss_rule(c, b)?;
        let places = knots.get_mut(..=stages).zip(knot_weights.get_mut(..=stages));
        let (knots_in_use, weights_in_use) = places.ok_or(unknown)?;
        lobatto_rule(knots_in_use, weights_in_use)?;
        let c = nodes.get(..stages).unwrap_or(&[]);
        let basis = Basis { nodes: c, weights: weights.get(..stages).unwrap_or(&[]) };
        let number = |numbers: &[f64], index: usize| at(numbers, index);
        let matrix = Table::of(|i, j| basis.integral(j, number(&nodes, i)));
        let at_knots = Table::of(|j, k| basis.integral(k, number(&knots, j)));
        // Of stages that are not there, whose weights are 0, nothing is asked.
        let conjugate = |i: usize, j: usize| match number(&weights, i) {
            0.0 => 0.0,
            b => number(&knot_weights, j) * (1.0 - basis.integral(i, number(&knots, j)) / b),
        };
        Ok(Self {
            stages,
            rule: Table::of(|row, i| number(if row == 0 { &nodes } else { &weights }, i)),
            matrix,
            knot_weights: Table::of(|_, j| number(&knot_weights, j)),
            at_knots,
            conjugate: Table::of(conjugate),
            ahead: Table::of(|i, j| basis.value(j, 1.0 + number(&nodes, i))),
            at_end: Table::of(|_, j| basis.value(j, 1.0)),
        })
    }

    /// Number of stages s.
    #[inline]
    pub fn stages(&self) -> usize {
        self.stages
    }

    /// c_i.
    #[inline(always)]
    pub fn node(&self, i: usize) -> T {
        self.rule.at(0, i)
    }

    /// b_i.
    #[inline(always)]
    pub fn weight(&self, i: usize) -> T {
        self.rule.at(1, i)
    }

    /// a_ij.
    #[inline(always)]
    pub fn matrix(&self, i: usize, j: usize) -> T {
        self.matrix.at(i, j)
    }

    /// b̃_j, j = 0…s.
    #[doc(hidden)]
    #[inline(always)]
    pub fn knot_weight(&self, j: usize) -> T {
        self.knot_weights.at(0, j)
    }

    /// ã_jk, j = 0…s.
    #[doc(hidden)]
    #[inline(always)]
    pub fn at_knot(&self, j: usize, k: usize) -> T {
        self.at_knots.at(j, k)
    }

    /// â_ij, j = 0…s.
    #[doc(hidden)]
    #[inline(always)]
    pub fn conjugate(&self, i: usize, j: usize) -> T {
        self.conjugate.at(i, j)
    }

    /// ℓ_j(1 + c_i): the polynomial of a step continued to the nodes of the next.
    #[inline(always)]
    pub(super) fn ahead(&self, i: usize, j: usize) -> T {
        self.ahead.at(i, j)
    }

    /// ℓ_j(1).
    #[inline(always)]
    pub(super) fn at_end(&self, j: usize) -> T {
        self.at_end.at(0, j)
    }

    /// ∫₀^τ ℓ_j: the position inside a step is q + h Σ_j V_j ∫₀^τ ℓ_j, τ in [0, 1].
    pub fn integral(&self, j: usize, fraction: f64) -> T {
        let (mut nodes, mut weights) = ([0.0; MOST_STAGES], [0.0; MOST_STAGES]);
        for (i, (node, weight)) in nodes.iter_mut().zip(&mut weights).enumerate() {
            (*node, *weight) = (self.node(i).to_f64(), self.weight(i).to_f64());
        }
        let (nodes, weights) = (nodes.get(..self.stages), weights.get(..self.stages));
        let basis = Basis { nodes: nodes.unwrap_or(&[]), weights: weights.unwrap_or(&[]) };
        T::of(basis.integral(j, fraction))
    }

    /// ℓ_j(τ): the velocity inside a step is Σ_j V_j ℓ_j(τ).
    pub fn value(&self, j: usize, fraction: f64) -> T {
        let mut nodes = [0.0; MOST_STAGES];
        nodes.iter_mut().enumerate().for_each(|(i, node)| *node = self.node(i).to_f64());
        T::of(Basis { nodes: nodes.get(..self.stages).unwrap_or(&[]), weights: &[] }.value(j, fraction))
    }
}

/// The Lagrange polynomials of Gauss nodes.
struct Basis<'a> {
    nodes: &'a [f64],
    weights: &'a [f64],
}

impl Basis<'_> {
    /// ℓ_j(x); zero for a node that is not there.
    fn value(&self, j: usize, x: f64) -> f64 {
        let Some(&own) = self.nodes.get(j) else { return 0.0 };
        let others = self.nodes.iter().enumerate().filter(|&(other, _)| other != j);
        others.map(|(_, node)| (x - node) / (own - node)).product()
    }

    /// ∫₀^x ℓ_j, by the rule itself, which is exact for it.
    fn integral(&self, j: usize, x: f64) -> f64 {
        let parts = self.nodes.iter().zip(self.weights);
        x * parts.map(|(node, weight)| weight * self.value(j, x * node)).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polynomial_of_degree_s_is_integrated_to_its_values_at_nodes_and_knots() {
        for stages in 1..=MOST_STAGES {
            let rule = GaussLobatto::<f64>::new(stages).unwrap();
            let power = |x: f64, k: usize| x.powi(k as i32);
            for k in 0..stages {
                let slope = |j: usize| (k + 1) as f64 * power(rule.node(j), k);
                for i in 0..stages {
                    let value: f64 = (0..stages).map(|j| rule.matrix(i, j) * slope(j)).sum();
                    assert!((value - power(rule.node(i), k + 1)).abs() < 1e-14, "{stages} stages, t^{k}");
                }
                let end: f64 = (0..stages).map(|j| rule.at_knot(stages, j) * slope(j)).sum();
                assert!((end - 1.0).abs() < 1e-14, "{stages} stages, t^{k} at the end");
                let inside: f64 = (0..stages).map(|j| rule.integral(j, 0.3) * slope(j)).sum();
                assert!((inside - power(0.3, k + 1)).abs() < 1e-14, "{stages} stages, t^{k} inside");
                let later: f64 = (0..stages).map(|j| rule.ahead(0, j) * power(rule.node(j), k)).sum();
                let exact = power(1.0 + rule.node(0), k);
                assert!((later - exact).abs() < 1e-11 * exact, "{stages} stages, t^{k} one step later");
            }
        }
    }

    #[test]
    fn the_rule_of_the_constraints_is_the_conjugate_of_that_of_the_positions() {
        for stages in 1..=MOST_STAGES {
            let rule = GaussLobatto::<f64>::new(stages).unwrap();
            for i in 0..stages {
                for j in 0..=stages {
                    let (b, knot) = (rule.weight(i), rule.knot_weight(j));
                    // b_i â_ij + b̃_j ã_ji = b_i b̃_j, the condition for a symplectic step.
                    let sum = b * rule.conjugate(i, j) + knot * rule.at_knot(j, i);
                    assert!((sum - b * knot).abs() < 1e-15, "{stages} stages, {i}, {j}");
                }
                // The last knot does not act within the step.
                assert!(rule.conjugate(i, stages).abs() < 1e-14, "{stages} stages, {i}");
            }
        }
    }

    #[test]
    fn other_numbers_of_stages_are_refused() {
        for stages in [0, 7, usize::MAX] {
            let refused = GaussLobatto::<f64>::new(stages).unwrap_err();
            assert_eq!((refused.parameter, refused.value), ("stages", stages as f64));
        }
    }
}
