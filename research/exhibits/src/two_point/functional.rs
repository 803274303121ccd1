//! The discrete functional and its gradient: the variational integrator of a two-point problem.

use super::grid::{Grid, Sigma};
use super::lagrangian::Lagrangian;
use super::operator::DiscreteOperator;
use super::toeplitz::Product;
use fvi_core::ParameterError;

/// The discrete Lagrangian functional L_h^{σ,α}(Q) = h Σ_{k∈I_σ} L(Q_k, V_k, t_k), V = −σ Δ_σ^α Q.
///
/// Source: \[BCGI\] Proposition 4; for α = 1, Proposition 2.
pub struct Functional<'a> {
    lagrangian: &'a dyn Lagrangian,
    grid: Grid,
    operator: DiscreteOperator,
}

impl<'a> Functional<'a> {
    /// The functional of `lagrangian` on `grid`.
    ///
    /// # Errors
    /// If `alpha` is outside (0, 1].
    pub fn new(
        lagrangian: &'a dyn Lagrangian,
        grid: Grid,
        sigma: Sigma,
        alpha: f64,
        product: Product,
    ) -> Result<Self, ParameterError> {
        let operator = DiscreteOperator::new(sigma, alpha, &grid, lagrangian.coordinates(), product)?;
        Ok(Self::with_operator(lagrangian, grid, operator))
    }

    /// The functional whose velocities come from `operator`.
    pub(super) fn with_operator(
        lagrangian: &'a dyn Lagrangian,
        grid: Grid,
        operator: DiscreteOperator,
    ) -> Self {
        Self { lagrangian, grid, operator }
    }

    /// The fractional velocities V = −σ Δ_σ^α Q at the points 0…N; zero and meaningless at the point outside
    /// I_σ.
    pub fn velocities(&mut self, positions: &[f64]) -> Vec<f64> {
        let sign = self.operator.sigma().derivative_sign();
        let mut velocities = self.operator.apply(positions);
        velocities.iter_mut().for_each(|velocity| *velocity *= sign);
        velocities
    }

    /// L_h^{σ,α}(Q) for the positions Q₀…Q_N.
    pub fn value(&mut self, positions: &[f64]) -> f64 {
        let velocities = self.velocities(positions);
        let d = self.lagrangian.coordinates();
        let sum: f64 = self
            .operator
            .sigma()
            .points(self.grid.steps())
            .map(|k| {
                let point = k * d..(k + 1) * d;
                self.lagrangian.value(self.grid.time(k), &positions[point.clone()], &velocities[point])
            })
            .sum();
        self.grid.step() * sum
    }

    /// (1/h) ∂L_h^{σ,α}/∂Q_k for k = 1…N−1, by the chain rule: ∂L/∂x plus the adjoint of −σ Δ_σ^α applied to
    /// ∂L/∂v.
    ///
    /// Its zeros are the discrete extremals; it is the left side of the equation that the variational
    /// integrator gives, \[BCGI\] Theorem 5.
    pub fn gradient(&mut self, positions: &[f64]) -> Vec<f64> {
        let velocities = self.velocities(positions);
        let d = self.lagrangian.coordinates();
        let sigma = self.operator.sigma();
        let mut by_position = vec![0.0; positions.len()];
        let mut by_velocity = vec![0.0; positions.len()];
        let mut both = vec![0.0; 2 * d];
        for k in sigma.points(self.grid.steps()) {
            let point = k * d..(k + 1) * d;
            let (x, v) = (&positions[point.clone()], &velocities[point.clone()]);
            self.lagrangian.gradient(self.grid.time(k), x, v, &mut both);
            by_position[point.clone()].copy_from_slice(&both[..d]);
            by_velocity[point].copy_from_slice(&both[d..]);
        }
        let through_velocity = self.operator.apply_adjoint(&by_velocity);
        let sign = sigma.derivative_sign();
        let inner = d..positions.len() - d;
        by_position[inner.clone()]
            .iter()
            .zip(&through_velocity[inner])
            .map(|(direct, through)| direct + sign * through)
            .collect()
    }
}
