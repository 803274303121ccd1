//! Gauss and Lobatto quadrature on the unit interval.

use crate::error::ParameterError;

/// Quadrature of Q points on [0, 1]: ∫₀¹ f(τ) dτ ≈ Σ_i b_i f(c_i).
///
/// Nodes in increasing order, in `f64`; callers in another precision round them. Source: \[HJO\] §2.3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quadrature<const Q: usize> {
    pub(crate) nodes: [f64; Q],
    pub(crate) weights: [f64; Q],
}

/// Nodes and weights (c_i, b_i) with c_i ≤ ½; the others mirror them.
type Half = &'static [(f64, f64)];

/// Gauss rules of 1…6 points: the zeros of the Legendre polynomials.
const GAUSS: [Half; 6] = [
    &[(0.5, 1.0)],
    &[(0.2113248654051871, 0.5)],
    &[(0.11270166537925831, 0.2777777777777778), (0.5, 0.4444444444444444)],
    &[(0.06943184420297371, 0.17392742256872692), (0.33000947820757187, 0.32607257743127305)],
    &[
        (0.046910077030668004, 0.11846344252809454),
        (0.23076534494715845, 0.23931433524968324),
        (0.5, 0.28444444444444444),
    ],
    &[
        (0.03376524289842399, 0.08566224618958518),
        (0.16939530676686773, 0.1803807865240693),
        (0.38069040695840156, 0.23395696728634552),
    ],
];

/// Lobatto rules of 2…7 points: both ends and the extrema of the Legendre polynomials.
const LOBATTO: [Half; 6] = [
    &[(0.0, 0.5)],
    &[(0.0, 0.16666666666666666), (0.5, 0.6666666666666666)],
    &[(0.0, 0.08333333333333333), (0.276393202250021, 0.4166666666666667)],
    &[(0.0, 0.05), (0.17267316464601143, 0.2722222222222222), (0.5, 0.35555555555555557)],
    &[
        (0.0, 0.03333333333333333),
        (0.11747233803526766, 0.1892374781489235),
        (0.3573842417596775, 0.2774291885177432),
    ],
    &[
        (0.0, 0.023809523809523808),
        (0.08488805186071653, 0.13841302368078298),
        (0.2655756032646429, 0.2158726906049313),
        (0.5, 0.2438095238095238),
    ],
];

/// The Lobatto rule of `points` points, first half.
pub(crate) fn lobatto_half(points: usize) -> Option<Half> {
    LOBATTO.get(points.checked_sub(2)?).copied()
}

/// Writes the Gauss rule of as many points as there are places; see [`Quadrature::gauss`].
///
/// # Errors
/// If that is not one of 1…6.
pub fn gauss_rule(nodes: &mut [f64], weights: &mut [f64]) -> Result<(), ParameterError> {
    let half = nodes.len().checked_sub(1).and_then(|index| GAUSS.get(index)).copied();
    mirror(half, nodes, weights, "points of the Gauss quadrature", "one of 1, 2, 3, 4, 5, 6")
}

/// Writes the Lobatto rule of as many points as there are places; see [`Quadrature::lobatto`].
///
/// # Errors
/// If that is not one of 2…7.
pub fn lobatto_rule(nodes: &mut [f64], weights: &mut [f64]) -> Result<(), ParameterError> {
    let half = lobatto_half(nodes.len());
    mirror(half, nodes, weights, "points of the Lobatto quadrature", "one of 2, 3, 4, 5, 6, 7")
}

fn mirror(
    half: Option<Half>,
    nodes: &mut [f64],
    weights: &mut [f64],
    parameter: &'static str,
    allowed: &'static str,
) -> Result<(), ParameterError> {
    let half = half.ok_or(ParameterError { parameter, value: nodes.len() as f64, allowed })?;
    for ((node, weight), &(c, b)) in nodes.iter_mut().zip(&mut *weights).zip(half) {
        (*node, *weight) = (c, b);
    }
    for ((node, weight), &(c, b)) in nodes.iter_mut().zip(weights).rev().zip(half) {
        (*node, *weight) = (1.0 - c, b);
    }
    Ok(())
}

impl<const Q: usize> Quadrature<Q> {
    /// Gauss quadrature, exact for polynomials of degree 2Q − 1.
    ///
    /// # Errors
    /// If Q is not one of 1…6.
    pub fn gauss() -> Result<Self, ParameterError> {
        let mut rule = Self { nodes: [0.0; Q], weights: [0.0; Q] };
        gauss_rule(&mut rule.nodes, &mut rule.weights)?;
        Ok(rule)
    }

    /// Lobatto quadrature, with a node at each end: exact for polynomials of degree 2Q − 3.
    ///
    /// # Errors
    /// If Q is not one of 2…7.
    pub fn lobatto() -> Result<Self, ParameterError> {
        let mut rule = Self { nodes: [0.0; Q], weights: [0.0; Q] };
        lobatto_rule(&mut rule.nodes, &mut rule.weights)?;
        Ok(rule)
    }

    /// Nodes c_i, increasing.
    pub fn nodes(&self) -> &[f64; Q] {
        &self.nodes
    }

    /// Weights b_i, positive, of sum 1.
    pub fn weights(&self) -> &[f64; Q] {
        &self.weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_exact_to<const Q: usize>(rule: &Quadrature<Q>, degree: i32) {
        let moment = |k| rule.nodes.iter().zip(&rule.weights).map(|(c, b)| b * c.powi(k)).sum::<f64>();
        for k in 0..=degree {
            let error = moment(k) * f64::from(k + 1) - 1.0;
            assert!(error.abs() < 6e-16, "{Q} points, power {k}: {error:e}");
        }
        let error = moment(degree + 1) * f64::from(degree + 2) - 1.0;
        assert!(error.abs() > 1e-7, "{Q} points should not integrate power {}: {error:e}", degree + 1);
        assert!(rule.nodes.is_sorted());
        for i in 0..Q {
            assert_eq!(rule.nodes[i] + rule.nodes[Q - 1 - i], 1.0, "{Q} points");
        }
    }

    #[test]
    fn rules_are_exact_to_their_degree_and_no_further() {
        assert_exact_to(&Quadrature::<1>::gauss().unwrap(), 1);
        assert_exact_to(&Quadrature::<2>::gauss().unwrap(), 3);
        assert_exact_to(&Quadrature::<3>::gauss().unwrap(), 5);
        assert_exact_to(&Quadrature::<4>::gauss().unwrap(), 7);
        assert_exact_to(&Quadrature::<5>::gauss().unwrap(), 9);
        assert_exact_to(&Quadrature::<6>::gauss().unwrap(), 11);
        assert_exact_to(&Quadrature::<2>::lobatto().unwrap(), 1);
        assert_exact_to(&Quadrature::<3>::lobatto().unwrap(), 3);
        assert_exact_to(&Quadrature::<4>::lobatto().unwrap(), 5);
        assert_exact_to(&Quadrature::<5>::lobatto().unwrap(), 7);
        assert_exact_to(&Quadrature::<6>::lobatto().unwrap(), 9);
        assert_exact_to(&Quadrature::<7>::lobatto().unwrap(), 11);
    }

    #[test]
    fn other_numbers_of_points_are_refused() {
        assert!(Quadrature::<0>::gauss().is_err());
        assert!(Quadrature::<7>::gauss().is_err());
        assert!(Quadrature::<0>::lobatto().is_err());
        assert!(Quadrature::<1>::lobatto().is_err());
        assert_eq!(Quadrature::<8>::lobatto().unwrap_err().value, 8.0);
    }
}
