//! The discrete operators Δ_±^α of the Grünwald–Letnikov embedding.

use super::grid::{Grid, Sigma};
use super::toeplitz::{LowerToeplitz, Product};
use fvi_core::{BdfOrder, ConvolutionWeights, ParameterError};

/// The operator Δ_σ^α on a grid of N steps:
///
/// ```text
/// (Δ₋^α Q)_k = Σ_{r=0}^{k} w_r Q_{k−r} ,   k = 1…N
/// (Δ₊^α Q)_k = Σ_{r=0}^{N−k} w_r Q_{k+r} , k = 0…N−1
/// ```
///
/// with the Grünwald–Letnikov weights w of exponent α, which hold the factor h^(−α). For α = 1 these are the
/// one-sided differences (Q_k − Q_{k−1})/h and (Q_k − Q_{k+1})/h. The analogue of the derivative is −σ Δ_σ^α.
///
/// Values are stored for all points 0…N; at the one point outside I_σ they are zero and mean nothing.
///
/// Source: \[BCGI\] Definitions 2, 3 and 11.
#[derive(Debug)]
pub struct DiscreteOperator {
    sigma: Sigma,
    steps: usize,
    coordinates: usize,
    matrix: LowerToeplitz,
}

/// The Grünwald–Letnikov weights w₀…w_N of exponent α.
///
/// # Errors
/// If `alpha` is outside (0, 1].
pub(super) fn derivative_weights(alpha: f64, grid: &Grid) -> Result<Vec<f64>, ParameterError> {
    if !(alpha > 0.0 && alpha <= 1.0) {
        return Err(ParameterError {
            parameter: "alpha",
            value: alpha,
            allowed: "greater than 0 and at most 1",
        });
    }
    weights(alpha, grid)
}

/// The weights g₀…g_N of the fractional sum of order α, the inverse of the Grünwald–Letnikov operator.
///
/// # Errors
/// If `alpha` is outside (0, 1].
pub(super) fn sum_weights(alpha: f64, grid: &Grid) -> Result<Vec<f64>, ParameterError> {
    if alpha == 1.0 {
        // 1/(1 − z) has the coefficients 1, 1, …; quadratures are made for exponents greater than −1.
        return Ok(vec![grid.step(); grid.steps() + 1]);
    }
    weights(-alpha, grid)
}

fn weights(exponent: f64, grid: &Grid) -> Result<Vec<f64>, ParameterError> {
    let weights = ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, grid.step())?;
    Ok(weights.take(grid.steps() + 1).collect())
}

impl DiscreteOperator {
    /// The operator of order `alpha` for values of `coordinates` numbers a point.
    ///
    /// # Errors
    /// If `alpha` is outside (0, 1].
    pub fn new(
        sigma: Sigma,
        alpha: f64,
        grid: &Grid,
        coordinates: usize,
        product: Product,
    ) -> Result<Self, ParameterError> {
        Ok(Self::with_weights(sigma, derivative_weights(alpha, grid)?, coordinates, product))
    }

    /// The operator with the weights w₀…w_N.
    pub(super) fn with_weights(
        sigma: Sigma,
        weights: Vec<f64>,
        coordinates: usize,
        product: Product,
    ) -> Self {
        let steps = weights.len() - 1;
        Self { sigma, steps, coordinates, matrix: LowerToeplitz::new(weights, product) }
    }

    /// The side σ.
    pub fn sigma(&self) -> Sigma {
        self.sigma
    }

    /// The weights w₀…w_N.
    pub fn weights(&self) -> &[f64] {
        self.matrix.weights()
    }

    /// Δ_σ^α of values at the points 0…N.
    pub fn apply(&mut self, values: &[f64]) -> Vec<f64> {
        let mut result = values.to_vec();
        match self.sigma {
            Sigma::Minus => self.matrix.apply(&mut result, self.coordinates),
            Sigma::Plus => self.matrix.apply_transposed(&mut result, self.coordinates),
        }
        self.clear_excluded(&mut result);
        result
    }

    /// The adjoint: A with Σ_{k∈I_σ} g_k (Δ_σ^α Q)_k = Σ_{j=0}^{N} (A g)_j Q_j for all Q.
    pub fn apply_adjoint(&mut self, values: &[f64]) -> Vec<f64> {
        let mut result = values.to_vec();
        self.clear_excluded(&mut result);
        match self.sigma {
            Sigma::Minus => self.matrix.apply_transposed(&mut result, self.coordinates),
            Sigma::Plus => self.matrix.apply(&mut result, self.coordinates),
        }
        result
    }

    fn clear_excluded(&self, values: &mut [f64]) {
        let excluded = self.sigma.excluded(self.steps) * self.coordinates;
        values[excluded..excluded + self.coordinates].fill(0.0);
    }
}
