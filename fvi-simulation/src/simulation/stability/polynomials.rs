//! The basis polynomials of a step: those of its two ends, and bubbles that vanish there.

use nalgebra::DMatrix;

/// Values and slopes of the S + 1 polynomials at the quadrature nodes, and their products.
///
/// First 1 − τ and τ, with the coefficients q_k and q_{k+1}, then the bubbles ∫₀^τ P_μ(2x − 1) dx, μ = 1…S−1,
/// integrals of Legendre polynomials: a well-conditioned basis of the same space as that of the control
/// points.
#[derive(Clone, Debug)]
pub(super) struct Polynomials {
    /// Nodes c_i.
    pub(super) nodes: Vec<f64>,
    /// Weights b_i, none of them zero.
    pub(super) weights: Vec<f64>,
    /// Row i, column μ: the polynomial μ at c_i.
    pub(super) values: DMatrix<f64>,
    /// Σ_i b_i φ_μ(c_i) φ̇_ν(c_i).
    pub(super) viscous: DMatrix<f64>,
    /// Σ_i b_i φ̇_μ(c_i) φ̇_ν(c_i).
    pub(super) kinetic: DMatrix<f64>,
    /// Σ_i b_i φ_μ(c_i) φ_ν(c_i).
    pub(super) elastic: DMatrix<f64>,
}

impl Polynomials {
    /// Degree S with a quadrature; nodes of weight zero are left out.
    pub(super) fn new(degree: usize, nodes: &[f64], weights: &[f64]) -> Self {
        let (nodes, weights): (Vec<f64>, Vec<f64>) =
            nodes.iter().zip(weights).filter(|&(_, &weight)| weight != 0.0).unzip();
        let at = |part: fn(f64, usize) -> f64| {
            DMatrix::from_fn(nodes.len(), degree + 1, |i, index| part(nodes[i], index))
        };
        let (values, slopes) = (at(value), at(slope));
        let products = |left: &DMatrix<f64>, right: &DMatrix<f64>| {
            DMatrix::from_fn(degree + 1, degree + 1, |mu, nu| {
                weights.iter().enumerate().map(|(i, weight)| weight * left[(i, mu)] * right[(i, nu)]).sum()
            })
        };
        let (kinetic, elastic) = (products(&slopes, &slopes), products(&values, &values));
        Self { kinetic, elastic, viscous: products(&values, &slopes), nodes, weights, values }
    }
}

/// The Legendre polynomials P_{n−1}, P_n and P_{n+1} at 2τ − 1, for n ≥ 1.
fn legendre(tau: f64, n: usize) -> [f64; 3] {
    let x = 2.0 * tau - 1.0;
    let mut three = [1.0, x, 0.5 * (3.0 * x * x - 1.0)];
    for degree in 2..=n {
        let next = degree as f64 + 1.0;
        let [_, before, last] = three;
        three = [before, last, ((2.0 * next - 1.0) * x * last - (next - 1.0) * before) / next];
    }
    three
}

fn value(tau: f64, index: usize) -> f64 {
    match index {
        0 => 1.0 - tau,
        1 => tau,
        _ => {
            let n = index - 1;
            let [below, _, above] = legendre(tau, n);
            (above - below) / (2.0 * (2.0 * n as f64 + 1.0))
        }
    }
}

fn slope(tau: f64, index: usize) -> f64 {
    match index {
        0 => -1.0,
        1 => 1.0,
        _ => legendre(tau, index - 1)[1],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bubbles_vanish_at_the_ends_and_have_their_slopes() {
        for index in 0..7 {
            for tau in [0.1, 0.37, 0.8] {
                let (h, numeric) =
                    (1e-6, |h: f64| (value(tau + h, index) - value(tau - h, index)) / (2.0 * h));
                assert!((numeric(h) - slope(tau, index)).abs() < 1e-8, "{index} at {tau}");
            }
            if index > 1 {
                assert!(value(0.0, index).abs() + value(1.0, index).abs() < 1e-16, "{index}");
            }
        }
    }

    #[test]
    fn products_of_degree_two_with_exact_quadrature() {
        // Gauss, three points: ∫ φ̇₂² = ∫ (2τ−1)² = 1/3 and ∫ φ₂² = ∫ τ²(1−τ)² = 1/30.
        let node = 0.5 - 0.15f64.sqrt();
        let of =
            Polynomials::new(2, &[node, 0.5, 1.0 - node, 0.9], &[5.0 / 18.0, 4.0 / 9.0, 5.0 / 18.0, 0.0]);
        assert_eq!(of.values.nrows(), 3);
        assert!((of.kinetic[(2, 2)] - 1.0 / 3.0).abs() < 1e-15);
        assert!((of.elastic[(2, 2)] - 1.0 / 30.0).abs() < 1e-16);
        assert!((of.elastic[(0, 1)] - 1.0 / 6.0).abs() < 1e-15);
    }
}
