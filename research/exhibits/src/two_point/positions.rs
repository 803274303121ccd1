//! Stationarity with the positions as unknowns, solved with dense matrices: for small grids, and to check the
//! matrix-free solver, with which it shares nothing but the Lagrangian and the weights.

use super::end_points::EndPoints;
use super::grid::{Grid, Sigma};
use super::lagrangian::Lagrangian;
use super::newton::{Descent, Direction, Formulation, Residual, Stationarity};
use fvi_fft::dense::symmetric_eigen;
use nalgebra::{DMatrix, DVector};

/// For a descent direction, eigenvalues are raised to at least this fraction of the largest one.
const LEAST_CURVATURE: f64 = 1e-8;

/// The discrete Euler–Lagrange equations at the points 1…N−1, written with the matrix D of −σ Δ_σ^α (rows
/// I_σ, columns 0…N; ⊗ the identity of the coordinates):
///
/// ```text
/// r = ∂L/∂x + Dᵀ ∂L/∂v ,   ∂r/∂Q = C + Bᵀ D + Dᵀ B + Dᵀ A D      restricted to the inner points
/// ```
///
/// with the second derivatives A = ∂²L/∂v², B = ∂²L/∂v∂x, C = ∂²L/∂x² at each point.
pub(super) struct Positions<'a> {
    lagrangian: &'a dyn Lagrangian,
    grid: Grid,
    sigma: Sigma,
    coordinates: usize,
    ends: EndPoints,
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
    jacobian: DMatrix<f64>,
}

impl<'a> Positions<'a> {
    /// The equations with the weights w₀…w_N of Δ_σ^α.
    pub(super) fn new(
        lagrangian: &'a dyn Lagrangian,
        grid: Grid,
        sigma: Sigma,
        weights: &[f64],
        ends: &EndPoints,
    ) -> Self {
        let d = lagrangian.coordinates();
        let steps = grid.steps();
        let first = sigma.points(steps).start;
        let matrix = DMatrix::from_fn(steps * d, (steps + 1) * d, |row, column| {
            let (k, j) = (row / d + first, column / d);
            let lag = match sigma {
                Sigma::Minus => k.checked_sub(j),
                Sigma::Plus => j.checked_sub(k),
            };
            match lag {
                Some(lag) if row % d == column % d => sigma.derivative_sign() * weights[lag],
                _ => 0.0,
            }
        });
        let (gradient, jacobian) = (DVector::zeros(0), DMatrix::zeros(0, 0));
        Self { lagrangian, grid, sigma, coordinates: d, ends: ends.clone(), matrix, gradient, jacobian }
    }

    fn state(&self, unknowns: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let positions = [self.ends.start.as_slice(), unknowns, &self.ends.end].concat();
        let velocities = &self.matrix * DVector::from_column_slice(&positions);
        let nothing = vec![0.0; self.coordinates];
        let velocities = match self.sigma {
            Sigma::Minus => [&nothing, velocities.as_slice()].concat(),
            Sigma::Plus => [velocities.as_slice(), &nothing].concat(),
        };
        (positions, velocities)
    }

    /// Calls `visit` with the time, position and velocity of each point of I_σ, in order.
    fn visit_points(&self, unknowns: &[f64], mut visit: impl FnMut(usize, f64, &[f64], &[f64])) {
        let d = self.coordinates;
        let (positions, velocities) = self.state(unknowns);
        for k in self.sigma.points(self.grid.steps()) {
            let point = k * d..(k + 1) * d;
            visit(k, self.grid.time(k), &positions[point.clone()], &velocities[point]);
        }
    }

    fn residual(&self, unknowns: &[f64]) -> DVector<f64> {
        let d = self.coordinates;
        let mut by_position = DVector::zeros((self.grid.steps() + 1) * d);
        let mut by_velocity = Vec::with_capacity(self.grid.steps() * d);
        let mut both = vec![0.0; 2 * d];
        self.visit_points(unknowns, |k, t, x, v| {
            self.lagrangian.gradient(t, x, v, &mut both);
            by_position.as_mut_slice()[k * d..(k + 1) * d].copy_from_slice(&both[..d]);
            by_velocity.extend_from_slice(&both[d..]);
        });
        by_position += self.matrix.tr_mul(&DVector::from_vec(by_velocity));
        by_position.rows(d, (self.grid.steps() - 1) * d).into_owned()
    }
}

impl Stationarity for Positions<'_> {
    fn linearise(&mut self, unknowns: &[f64]) -> Option<Residual> {
        let (d, steps) = (self.coordinates, self.grid.steps());
        let sizes = self.matrix.abs();
        let (positions, _) = self.state(unknowns);
        let propagated = &sizes * DVector::from_vec(positions).abs();
        let first = self.sigma.points(steps).start;
        let mut first_derivatives = vec![0.0; 2 * d];
        let mut second_derivatives = vec![0.0; 4 * d * d];
        // D and the selection matrix of the positions, stacked, multiplied by the second derivatives at each
        // point.
        let mut by_velocity = DMatrix::zeros(steps * d, (steps + 1) * d);
        let mut by_position = DMatrix::zeros((steps + 1) * d, (steps + 1) * d);
        let mut velocity_sizes = DVector::zeros(steps * d);
        let mut position_sizes = DVector::zeros((steps + 1) * d);
        self.visit_points(unknowns, |k, t, x, v| {
            self.lagrangian.derivatives(t, x, v, &mut first_derivatives, &mut second_derivatives);
            let row = (k - first) * d;
            for i in 0..2 * d {
                let curvature = &second_derivatives[2 * d * i..2 * d * (i + 1)];
                let mut line = DVector::zeros((steps + 1) * d).transpose();
                let mut size = first_derivatives[i].abs();
                for j in 0..d {
                    line[k * d + j] += curvature[j];
                    line += self.matrix.row(row + j) * curvature[d + j];
                    size += (curvature[j] * x[j]).abs() + (curvature[d + j] * propagated[row + j]).abs();
                }
                if i < d {
                    by_position.set_row(k * d + i, &line);
                    position_sizes[k * d + i] = size;
                } else {
                    by_velocity.set_row(row + i - d, &line);
                    velocity_sizes[row + i - d] = size;
                }
            }
        });
        let inner = d..steps * d;
        let jacobian = by_position + self.matrix.tr_mul(&by_velocity);
        self.jacobian = jacobian.view_range(inner.clone(), inner.clone()).into_owned();
        self.gradient = self.residual(unknowns);
        let all_sizes = position_sizes + sizes.tr_mul(&velocity_sizes);
        let scale = all_sizes.rows_range(inner).norm();
        let norm = self.gradient.norm();
        let finite =
            norm.is_finite() && scale.is_finite() && self.jacobian.iter().all(|entry| entry.is_finite());
        finite.then_some(Residual { norm, scale })
    }

    fn norm_at(&mut self, unknowns: &[f64]) -> f64 {
        let norm = self.residual(unknowns).norm();
        if norm.is_nan() { f64::INFINITY } else { norm }
    }

    fn direction(&mut self) -> Option<Direction> {
        let step = self.jacobian.clone().lu().solve(&-&self.gradient)?;
        step.iter()
            .all(|entry| entry.is_finite())
            .then(|| Direction { step: step.as_slice().to_vec(), krylov_iterations: 0 })
    }

    fn functional(&mut self) -> Option<&mut dyn Descent> {
        Some(self)
    }
}

impl Descent for Positions<'_> {
    fn value_at(&mut self, unknowns: &[f64]) -> f64 {
        let mut sum = 0.0;
        self.visit_points(unknowns, |_, t, x, v| sum += self.lagrangian.value(t, x, v));
        if sum.is_nan() { f64::INFINITY } else { sum }
    }

    fn slope(&self, step: &[f64]) -> f64 {
        self.gradient.iter().zip(step).map(|(g, s)| g * s).sum()
    }

    /// Descent direction: Newton step with the eigenvalues of the second derivative replaced by their
    /// magnitudes.
    fn steepest(&mut self) -> Vec<f64> {
        let eigen = symmetric_eigen(self.jacobian.clone());
        let floor = LEAST_CURVATURE * eigen.eigenvalues.amax();
        let mut coefficients = eigen.eigenvectors.tr_mul(&self.gradient);
        for (coefficient, value) in coefficients.iter_mut().zip(&eigen.eigenvalues) {
            *coefficient /= -value.abs().max(floor).max(f64::MIN_POSITIVE);
        }
        (eigen.eigenvectors * coefficients).as_slice().to_vec()
    }
}

impl Formulation for Positions<'_> {
    fn unknowns(&self, positions: &[f64], _velocities: &[f64]) -> Vec<f64> {
        positions[self.coordinates..positions.len() - self.coordinates].to_vec()
    }

    fn trajectory(&mut self, unknowns: &[f64]) -> (Vec<f64>, Vec<f64>) {
        self.state(unknowns)
    }
}
