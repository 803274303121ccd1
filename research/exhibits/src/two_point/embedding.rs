//! Direct discrete embeddings of the Euler–Lagrange equation.
//!
//! A direct embedding replaces each derivative in the *equation* by its discrete analogue; it does not use
//! the functional. Where it gives the same equations as the variational integrator
//! ([`Functional::gradient`](super::Functional::gradient)), the embedding is called coherent.

use super::grid::{Grid, Sigma};
use super::lagrangian::Lagrangian;
use super::operator::DiscreteOperator;
use super::toeplitz::Product;
use core::ops::Range;
use fvi_core::ParameterError;

/// Direct embedding of the fractional Euler–Lagrange equation by the Gauss Grünwald–Letnikov embedding
/// Gauss–GLEσ:
///
/// ```text
/// ∂L/∂x(Q_k, V_k, t_k) − σ (Δ_{−σ}^α ∂L/∂v(Q, V, t))_k ,   V = −σ Δ_σ^α Q ,   k = 1…N−1
/// ```
///
/// Coherent: \[BCGI\] Proposition 5.
///
/// # Errors
/// If `alpha` is outside (0, 1].
pub fn fractional_embedding(
    lagrangian: &dyn Lagrangian,
    grid: &Grid,
    sigma: Sigma,
    alpha: f64,
    product: Product,
    positions: &[f64],
) -> Result<Vec<f64>, ParameterError> {
    let d = lagrangian.coordinates();
    let sign = sigma.derivative_sign();
    let mut velocities = DiscreteOperator::new(sigma, alpha, grid, d, product)?.apply(positions);
    velocities.iter_mut().for_each(|velocity| *velocity *= sign);
    let (by_position, by_velocity) = derivatives(lagrangian, grid, sigma, positions, &velocities);
    let outer = DiscreteOperator::new(sigma.opposite(), alpha, grid, d, product)?.apply(&by_velocity);
    let inner = d..positions.len() - d;
    Ok(by_position[inner.clone()].iter().zip(&outer[inner]).map(|(x, v)| x + sign * v).collect())
}

/// Direct embedding of the asymmetric Euler–Lagrange equation ∂L/∂x − σ d_{−σ}(∂L/∂v) = 0 by the asymmetric
/// Gauss–FDEσ, with the one-sided differences Δ₋ and Δ₊; k = 1…N−1.
///
/// Coherent: \[BCGI\] Proposition 3.
pub fn asymmetric_embedding(
    lagrangian: &dyn Lagrangian,
    grid: &Grid,
    sigma: Sigma,
    positions: &[f64],
) -> Vec<f64> {
    let d = lagrangian.coordinates();
    let steps = grid.steps();
    let velocities = derivative(sigma, grid, d, sigma.points(steps), positions);
    let (by_position, by_velocity) = derivatives(lagrangian, grid, sigma, positions, &velocities);
    // −σ d_{−σ} is minus the derivative seen from the other side.
    let outer = derivative(sigma.opposite(), grid, d, 1..steps, &by_velocity);
    let inner = d..positions.len() - d;
    by_position[inner.clone()].iter().zip(&outer[inner]).map(|(x, v)| x - v).collect()
}

/// Direct embedding of the Euler–Lagrange equation ∂L/∂x − d/dt(∂L/∂v) = 0 by Gauss–FDEσ, with −σ Δ_σ for
/// both derivatives: the equations k = 2…N for σ = −, k = 0…N−2 for σ = +.
///
/// Not coherent: it has no adjoint difference, and its equations are not those of any critical point of the
/// functional. \[BCGI\] Proposition 1 (eq. 1) and §2.2.
pub fn symmetric_embedding(
    lagrangian: &dyn Lagrangian,
    grid: &Grid,
    sigma: Sigma,
    positions: &[f64],
) -> Vec<f64> {
    let d = lagrangian.coordinates();
    let steps = grid.steps();
    let equations = match sigma {
        Sigma::Minus => 2..steps + 1,
        Sigma::Plus => 0..steps - 1,
    };
    let velocities = derivative(sigma, grid, d, sigma.points(steps), positions);
    let (by_position, by_velocity) = derivatives(lagrangian, grid, sigma, positions, &velocities);
    let outer = derivative(sigma, grid, d, equations.clone(), &by_velocity);
    let entries = equations.start * d..equations.end * d;
    by_position[entries.clone()].iter().zip(&outer[entries]).map(|(x, v)| x - v).collect()
}

/// −σ Δ_σ of `values` at the points of a range, by one-sided differences; zero elsewhere.
pub(super) fn derivative(
    sigma: Sigma,
    grid: &Grid,
    coordinates: usize,
    points: Range<usize>,
    values: &[f64],
) -> Vec<f64> {
    let mut result = vec![0.0; values.len()];
    for entry in points.start * coordinates..points.end * coordinates {
        let (later, earlier) = match sigma {
            Sigma::Minus => (values[entry], values[entry - coordinates]),
            Sigma::Plus => (values[entry + coordinates], values[entry]),
        };
        result[entry] = (later - earlier) / grid.step();
    }
    result
}

/// ∂L/∂x and ∂L/∂v at the points of I_σ; zero elsewhere.
fn derivatives(
    lagrangian: &dyn Lagrangian,
    grid: &Grid,
    sigma: Sigma,
    positions: &[f64],
    velocities: &[f64],
) -> (Vec<f64>, Vec<f64>) {
    let d = lagrangian.coordinates();
    let mut both = vec![0.0; 2 * d];
    let mut by_position = vec![0.0; positions.len()];
    let mut by_velocity = vec![0.0; positions.len()];
    for k in sigma.points(grid.steps()) {
        let entries = k * d..(k + 1) * d;
        lagrangian.gradient(
            grid.time(k),
            &positions[entries.clone()],
            &velocities[entries.clone()],
            &mut both,
        );
        by_position[entries.clone()].copy_from_slice(&both[..d]);
        by_velocity[entries].copy_from_slice(&both[d..]);
    }
    (by_position, by_velocity)
}
