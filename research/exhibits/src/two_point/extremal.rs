//! Two-point problems and their solutions.

use super::end_points::EndPoints;
use super::functional::Functional;
use super::grid::{Grid, Sigma};
use super::lagrangian::Lagrangian;
use super::newton::{Formulation, Iterate, NewtonOptions, minimise_residual};
use super::operator::{DiscreteOperator, derivative_weights, sum_weights};
use super::positions::Positions;
use super::toeplitz::Product;
use super::velocities::Velocities;
use fvi_core::{ParameterError, max_or_nan};
use serde::Serialize;

/// How the equations of an extremal are solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Dense matrices in the positions: O(N³) time, O(N²) memory.
    Dense,
    /// A preconditioned Krylov method in the fractional velocities: a few transforms an iteration, O(N)
    /// memory.
    Krylov,
}

impl Method {
    /// The default method for a grid of `steps` steps and `coordinates` coordinates.
    pub fn fitting(steps: usize, coordinates: usize) -> Self {
        if steps * coordinates <= 128 { Self::Dense } else { Self::Krylov }
    }
}

/// A coarser grid has fewer steps by this factor, but at least [`COARSEST`].
const COARSENING: usize = 4;
const COARSEST: usize = 16;

/// A two-point problem: find Q with Q₀ and Q_N given at which L_h^{σ,α} is stationary.
///
/// ```
/// use fvi_exhibits::two_point::{Closures, ExtremalProblem, Grid, Sigma};
/// // ½v², the straight line for α = 1
/// let free = Closures::new(
///     1,
///     |_t, _x: &[f64], v: &[f64]| 0.5 * v[0] * v[0],
///     |_t, _x: &[f64], v: &[f64], out: &mut [f64]| out.copy_from_slice(&[0.0, v[0]]),
///     |_t, _x: &[f64], _v: &[f64], out: &mut [f64]| out.copy_from_slice(&[0.0, 0.0, 0.0, 1.0]),
/// );
/// let grid = Grid::new(0.0, 2.0, 4)?;
/// let extremal = ExtremalProblem::new(&free, grid, Sigma::Minus, 1.0, &[0.0], &[1.0])?.solve()?;
/// let mut positions = extremal.positions.iter().zip([0.0, 0.25, 0.5, 0.75, 1.0]);
/// assert!(positions.all(|(q, exact)| (q - exact).abs() < 1e-15));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct ExtremalProblem<'a> {
    lagrangian: &'a dyn Lagrangian,
    grid: Grid,
    sigma: Sigma,
    alpha: f64,
    /// w₀…w_N of Δ_σ^α.
    weights: Vec<f64>,
    /// g₀…g_N of its inverse.
    sum_weights: Vec<f64>,
    ends: EndPoints,
    guess: Option<Vec<f64>>,
    method: Method,
    product: Product,
    options: NewtonOptions,
}

/// A two-point problem that cannot be set up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProblemError {
    /// A parameter is outside its range.
    #[error("{0}")]
    Parameter(ParameterError),
    /// An end point is not a vector of as many finite numbers as the Lagrangian has coordinates.
    #[error("an end point needs {expected} finite numbers")]
    EndPoint {
        /// Number of coordinates.
        expected: usize,
    },
    /// The initial guess is not one finite number for each coordinate at each of the N + 1 points.
    #[error("an initial guess needs {expected} finite numbers")]
    Guess {
        /// (N + 1) d.
        expected: usize,
    },
}

impl From<ParameterError> for ProblemError {
    fn from(error: ParameterError) -> Self {
        Self::Parameter(error)
    }
}

/// A discrete extremal or the solution of an embedded equation, or the best iterate on the way to one, with
/// measures of its accuracy.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Q_k, k = 0…N: coordinate i at t_k is entry k·d + i.
    pub positions: Vec<f64>,
    /// V_k = (−σ Δ_σ^α Q)_k in the same layout; zero and meaningless at the point outside I_σ.
    pub velocities: Vec<f64>,
    /// The value of the functional L_h^{σ,α}(Q); an embedded equation has none.
    pub value: Option<f64>,
    /// Number of Newton steps.
    pub newton_iterations: usize,
    /// Number of iterations of the Krylov method, all Newton steps together.
    pub krylov_iterations: usize,
    /// Relative residual (see [`NewtonOptions::tolerance`]) after 0, 1, 2, … Newton steps.
    pub history: Vec<f64>,
    /// Last entry of `history`.
    pub relative_residual: f64,
    /// max_k of the magnitude of the left side of the discrete equation, which for a Lagrangian is (1/h)
    /// ∂L_h/∂Q_k, in the units of that equation.
    pub residual: f64,
    /// Residual that rounding the positions to double precision alone may cause: ε times the largest
    /// Σ|w|(|∂L/∂v| + |∂²L/∂v²| Σ|w||Q|) plus similar terms; it grows like h^(−2α).
    pub rounding_level: f64,
}

impl Solution {
    /// True if all its numbers are finite. If an intermediate result has overflowed, it is not a solution.
    pub(super) fn is_finite(&self) -> bool {
        let numbers = self.positions.iter().chain(&self.velocities).chain(&self.history).chain(&self.value);
        let measures = [self.relative_residual, self.residual, self.rounding_level];
        numbers.chain(&measures).all(|number| number.is_finite())
    }
}

/// How a problem ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// An extremal was found.
    Converged,
    /// The positions are the best iterate of an iteration that did not converge.
    NotConverged,
}

/// Newton's method found no extremal, or one with values that are not finite.
#[derive(Clone, Debug, thiserror::Error)]
#[error(
    "no convergence: after {} Newton steps the relative residual is {:.1e}",
    best.newton_iterations,
    best.relative_residual
)]
pub struct NotConverged {
    /// The best iterate.
    pub best: Box<Solution>,
}

/// Checks an initial guess for `count` numbers.
pub(super) fn check_guess(positions: &[f64], expected: usize) -> Result<(), ProblemError> {
    if positions.len() == expected && positions.iter().all(|x| x.is_finite()) {
        Ok(())
    } else {
        Err(ProblemError::Guess { expected })
    }
}

impl<'a> ExtremalProblem<'a> {
    /// The problem with positions `start` and `end` at the ends of the grid.
    ///
    /// # Errors
    /// If `alpha` is outside (0, 1] or an end point is not one finite number for each coordinate.
    pub fn new(
        lagrangian: &'a dyn Lagrangian,
        grid: Grid,
        sigma: Sigma,
        alpha: f64,
        start: &[f64],
        end: &[f64],
    ) -> Result<Self, ProblemError> {
        let weights = derivative_weights(alpha, &grid)?;
        let sum_weights = sum_weights(alpha, &grid)?;
        let expected = lagrangian.coordinates();
        let ends = EndPoints::new(start, end, expected).ok_or(ProblemError::EndPoint { expected })?;
        let method = Method::fitting(grid.steps(), expected);
        let product = Product::fastest(grid.steps());
        let options = NewtonOptions::default();
        Ok(Self {
            lagrangian,
            grid,
            sigma,
            alpha,
            weights,
            sum_weights,
            ends,
            guess: None,
            method,
            product,
            options,
        })
    }

    /// Solves by this method.
    pub fn with_method(mut self, method: Method) -> Self {
        self.method = method;
        self
    }

    /// Sets tolerance and numbers of iterations.
    pub fn with_options(mut self, options: NewtonOptions) -> Self {
        self.options = options;
        self
    }

    /// Starts from these positions, (N + 1) d numbers, instead of the straight line between the ends (dense
    /// method) or the extremal of a coarser grid (Krylov method); at the ends they are replaced by the end
    /// points.
    ///
    /// # Errors
    /// If `positions` does not consist of that many finite numbers.
    pub fn with_guess(mut self, positions: Vec<f64>) -> Result<Self, ProblemError> {
        check_guess(&positions, (self.grid.steps() + 1) * self.lagrangian.coordinates())?;
        self.guess = Some(positions);
        Ok(self)
    }

    /// The discrete extremal.
    ///
    /// # Errors
    /// [`NotConverged`] with the best iterate.
    pub fn solve(&self) -> Result<Solution, NotConverged> {
        self.solve_observed(&mut |_, _| ())
    }

    /// [`solve`](Self::solve); `observe` receives the number of Newton steps and the relative residual before
    /// each step.
    ///
    /// # Errors
    /// [`NotConverged`] with the best iterate.
    pub fn solve_observed(&self, observe: &mut dyn FnMut(usize, f64)) -> Result<Solution, NotConverged> {
        let mut functional = self.functional();
        let coarser = (self.guess.is_none() && self.method == Method::Krylov).then(|| self.coarse_solution());
        let positions =
            coarser.flatten().unwrap_or_else(|| self.ends.join(self.guess.as_deref(), self.grid.steps()));
        let velocities = functional.velocities(&positions);
        match self.method {
            Method::Dense => {
                let equations =
                    Positions::new(self.lagrangian, self.grid, self.sigma, &self.weights, &self.ends);
                self.iterate(equations, positions, velocities, observe)
            }
            Method::Krylov => {
                let equations = Velocities::new(
                    self.lagrangian,
                    self.grid,
                    self.sigma,
                    &self.sum_weights,
                    &self.ends,
                    self.product,
                    self.options.krylov_iterations,
                );
                self.iterate(equations, positions, velocities, observe)
            }
        }
    }

    fn functional(&self) -> Functional<'a> {
        let d = self.lagrangian.coordinates();
        let operator = DiscreteOperator::with_weights(self.sigma, self.weights.clone(), d, self.product);
        Functional::with_operator(self.lagrangian, self.grid, operator)
    }

    /// The extremal of the same problem on a coarser grid, itself started from a coarser one, interpolated
    /// linearly: with this start the number of Newton steps hardly depends on the grid.
    fn coarse_solution(&self) -> Option<Vec<f64>> {
        let (d, steps) = (self.lagrangian.coordinates(), self.grid.steps());
        if steps < COARSENING * COARSEST {
            return None;
        }
        let grid = self.grid.with_steps(steps / COARSENING).ok()?;
        let (start, end) = (&self.ends.start, &self.ends.end);
        let coarse = Self::new(self.lagrangian, grid, self.sigma, self.alpha, start, end).ok()?;
        let coarse = coarse.with_options(self.options).solve().ok()?.positions;
        let mut positions = self.ends.join(self.guess.as_deref(), self.grid.steps());
        for k in 1..steps {
            let place = k as f64 / steps as f64 * grid.steps() as f64;
            let before = (place as usize).min(grid.steps() - 1);
            let part = place - before as f64;
            for i in 0..d {
                let (left, right) = (coarse[before * d + i], coarse[(before + 1) * d + i]);
                positions[k * d + i] = left + part * (right - left);
            }
        }
        Some(positions)
    }

    fn iterate(
        &self,
        mut equations: impl Formulation,
        positions: Vec<f64>,
        velocities: Vec<f64>,
        observe: &mut dyn FnMut(usize, f64),
    ) -> Result<Solution, NotConverged> {
        let start = equations.unknowns(&positions, &velocities);
        let Some(iterate) = minimise_residual(&mut equations, start, &self.options, observe) else {
            let iterate = Iterate::untouched();
            return Err(NotConverged { best: Box::new(self.report(iterate, positions, velocities)) });
        };
        let (positions, velocities) = equations.trajectory(&iterate.unknowns);
        let converged = iterate.converged;
        let extremal = self.report(iterate, positions, velocities);
        if converged && extremal.is_finite() {
            Ok(extremal)
        } else {
            Err(NotConverged { best: Box::new(extremal) })
        }
    }

    fn report(&self, iterate: Iterate, positions: Vec<f64>, velocities: Vec<f64>) -> Solution {
        let mut functional = self.functional();
        let residual = functional.gradient(&positions).iter().map(|b| b.abs()).fold(0.0, max_or_nan);
        Solution {
            value: Some(functional.value(&positions)),
            residual,
            rounding_level: self.rounding_level(&positions, &velocities),
            positions,
            velocities,
            newton_iterations: iterate.newton_iterations,
            krylov_iterations: iterate.krylov_iterations,
            history: iterate.history,
            relative_residual: iterate.relative_residual,
        }
    }

    /// See [`Solution::rounding_level`].
    fn rounding_level(&self, positions: &[f64], velocities: &[f64]) -> f64 {
        let d = self.lagrangian.coordinates();
        let weight: f64 = self.weights.iter().map(|weight| weight.abs()).sum();
        let largest = positions.iter().map(|b| b.abs()).fold(0.0, max_or_nan);
        let mut gradient = vec![0.0; 2 * d];
        let mut hessian = vec![0.0; 4 * d * d];
        let mut level: f64 = 0.0;
        for k in self.sigma.points(self.grid.steps()) {
            let point = k * d..(k + 1) * d;
            let (x, v) = (&positions[point.clone()], &velocities[point]);
            self.lagrangian.derivatives(self.grid.time(k), x, v, &mut gradient, &mut hessian);
            for (i, (slope, row)) in gradient.iter().zip(hessian.chunks_exact(2 * d)).enumerate() {
                let by_position: f64 = row[..d].iter().map(|c| c.abs()).sum();
                let by_velocity: f64 = row[d..].iter().map(|c| c.abs()).sum();
                let size = slope.abs() + (by_position + weight * by_velocity) * largest;
                level = level.max(if i < d { size } else { weight * size });
            }
        }
        f64::EPSILON * level
    }
}
