//! Direct discrete embedding of a differential equation that need not be Lagrangian.

use super::embedding::derivative;
use super::end_points::EndPoints;
use super::extremal::{NotConverged, ProblemError, Solution, check_guess};
use super::grid::{Grid, Sigma};
use super::lagrangian::MAX_COORDINATES;
use super::minres::inner;
use super::newton::{Direction, Iterate, NewtonOptions, Residual, Stationarity, minimise_residual};
use fvi_core::max_or_nan;
use fvi_scenario::language::expression::{Expression, Moment};
use fvi_simulation::model::tape::CompiledFunction;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

/// One term f(x, t) · (d/dt)^i ( g(x, t) ) of a differential operator.
#[derive(Clone, Debug, Serialize)]
pub struct Term {
    /// f; absent: 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub factor: Option<Expression>,
    /// i, at most 2.
    pub order: usize,
    /// g, one expression for each coordinate.
    pub of: Vec<Expression>,
}

/// The differential equation O(x) = Σ_i f_i · (d/dt)^i ∘ g_i = 0 of order two, and its embedding by FDEσ:
/// each d/dt becomes −σ Δ_σ, which gives an equation at k = 2…N for σ = − and k = 0…N−2 for σ = +. See
/// [`Embedding`] for the asymmetric one.
///
/// The embedding depends on how the operator is written, not only on the equation. Source: \[BCGI\]
/// Definition 4; its example, ẍ + ẋ + x = 0, is their eq. NE and NE_h.
#[derive(Clone, Debug, Serialize)]
pub struct OperatorEquation {
    terms: Vec<Term>,
    embedding: Embedding,
    #[serde(skip)]
    compiled: Vec<CompiledTerm>,
    #[serde(skip)]
    coordinates: usize,
}

/// f and g of a term.
#[derive(Clone, Debug)]
struct CompiledTerm {
    factor: Option<CompiledFunction<f64>>,
    of: Vec<CompiledFunction<f64>>,
}

/// Discrete form of a second derivative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Embedding {
    /// d/dt ∘ d/dt becomes Δ_σ ∘ Δ_σ, with both differences to the same side: \[BCGI\] Definition 4.
    #[default]
    Symmetric,
    /// d/dt ∘ d/dt becomes −Δ_{−σ} ∘ Δ_σ, the central second difference, the equation at k = 1…N−1; with it
    /// an Euler–Lagrange equation gives the equations of the variational integrator: \[BCGI\] Proposition 3.
    Asymmetric,
}

/// Order of the equation, the highest order of a derivative: for it there are as many equations as points
/// between the ends.
pub(super) const ORDER: usize = 2;

impl OperatorEquation {
    /// The names of the variables, in the order that the expressions must have been parsed with.
    pub fn variables(coordinates: usize) -> impl Iterator<Item = String> {
        (0..coordinates).map(|index| format!("x{index}"))
    }

    /// The equation with these terms in `coordinates` coordinates; `None` unless every term has one
    /// expression for each coordinate, the highest order is 2, and there are 1 to [`MAX_COORDINATES`]
    /// coordinates.
    pub fn new(terms: Vec<Term>, coordinates: usize) -> Option<Self> {
        let fitting = (1..=MAX_COORDINATES).contains(&coordinates)
            && terms.iter().all(|term| term.of.len() == coordinates)
            && terms.iter().map(|term| term.order).max() == Some(ORDER);
        fitting.then(|| {
            let compile = |expression: &Expression| CompiledFunction::compile(expression, coordinates);
            let both = |term: &Term| CompiledTerm {
                factor: term.factor.as_ref().map(compile),
                of: term.of.iter().map(compile).collect(),
            };
            let compiled = terms.iter().map(both).collect();
            Self { compiled, terms, embedding: Embedding::default(), coordinates }
        })
    }

    /// The equation with another embedding than the symmetric one.
    pub fn with_embedding(mut self, embedding: Embedding) -> Self {
        self.embedding = embedding;
        self
    }

    /// The left sides of the embedded equations for the positions at the points 0…N, N − 1 points of d
    /// numbers.
    pub fn embedding(&self, grid: &Grid, sigma: Sigma, positions: &[f64]) -> Vec<f64> {
        let d = self.coordinates;
        let mut sum = vec![0.0; (grid.steps() - 1) * d];
        for term in &self.terms {
            for (place, value) in sum.iter_mut().enumerate() {
                let (equation, i) = (place / d + 1, place % d);
                let points = self.embedding.points(sigma, equation);
                let inner: f64 = self
                    .embedding
                    .stencil(sigma, term.order, grid.step())
                    .iter()
                    .zip(points)
                    .filter(|(coefficient, _)| **coefficient != 0.0)
                    .map(|(coefficient, k)| {
                        coefficient * term.of[i].value(Moment::inside(grid.time(k)), point(positions, k, d))
                    })
                    .sum();
                let k = points[0];
                let factor = term.factor.as_ref();
                let factor =
                    factor.map_or(1.0, |f| f.value(Moment::inside(grid.time(k)), point(positions, k, d)));
                *value += factor * inner;
            }
        }
        sum
    }
}

impl Embedding {
    /// For the equation with number `equation`, 1…N−1: the point k where it holds, and the two other points
    /// of its stencil. The three are the point with that number and its two neighbours.
    fn points(self, sigma: Sigma, equation: usize) -> [usize; 3] {
        match (self, sigma) {
            (Self::Symmetric, Sigma::Minus) => [equation + 1, equation, equation - 1],
            (Self::Symmetric, Sigma::Plus) => [equation - 1, equation, equation + 1],
            (Self::Asymmetric, Sigma::Minus) => [equation, equation - 1, equation + 1],
            (Self::Asymmetric, Sigma::Plus) => [equation, equation + 1, equation - 1],
        }
    }

    /// Coefficients of the derivative of the given order at the three [`points`](Self::points).
    fn stencil(self, sigma: Sigma, order: usize, step: f64) -> [f64; 3] {
        let sign = sigma.derivative_sign();
        match (order, self) {
            (0, _) => [1.0, 0.0, 0.0],
            (1, _) => [sign / step, -sign / step, 0.0],
            (_, Self::Symmetric) => [1.0, -2.0, 1.0].map(|coefficient| coefficient / (step * step)),
            (_, Self::Asymmetric) => [-2.0, 1.0, 1.0].map(|coefficient| coefficient / (step * step)),
        }
    }
}

fn point(values: &[f64], k: usize, coordinates: usize) -> &[f64] {
    &values[k * coordinates..(k + 1) * coordinates]
}

/// Value and gradient of a function of the positions.
fn value_and_gradient(function: &CompiledFunction<f64>, t: f64, x: &[f64]) -> (f64, Vec<f64>) {
    let (mut registers, mut gradient) = (Vec::new(), vec![0.0; x.len()]);
    function.gradient(Moment::inside(t), x, &mut registers, &mut gradient);
    (function.value(Moment::inside(t), x, &mut registers), gradient)
}

/// An embedded equation with fixed end points.
#[derive(Debug)]
pub struct EmbeddedProblem<'a> {
    equation: &'a OperatorEquation,
    grid: Grid,
    sigma: Sigma,
    ends: EndPoints,
    guess: Option<Vec<f64>>,
    options: NewtonOptions,
}

impl<'a> EmbeddedProblem<'a> {
    /// The problem with positions `start` and `end` at the ends of the grid.
    ///
    /// # Errors
    /// If an end point is not one finite number for each coordinate.
    pub fn new(
        equation: &'a OperatorEquation,
        grid: Grid,
        sigma: Sigma,
        start: &[f64],
        end: &[f64],
    ) -> Result<Self, ProblemError> {
        let ends = EndPoints::new(start, end, equation.coordinates)
            .ok_or(ProblemError::EndPoint { expected: equation.coordinates })?;
        Ok(Self { equation, grid, sigma, ends, guess: None, options: NewtonOptions::default() })
    }

    /// Sets tolerance and numbers of iterations.
    pub fn with_options(mut self, options: NewtonOptions) -> Self {
        self.options = options;
        self
    }

    /// Starts from these positions, (N + 1) d numbers, instead of the straight line between the ends.
    ///
    /// # Errors
    /// If `positions` does not consist of that many finite numbers.
    pub fn with_guess(mut self, positions: Vec<f64>) -> Result<Self, ProblemError> {
        check_guess(&positions, (self.grid.steps() + 1) * self.equation.coordinates)?;
        self.guess = Some(positions);
        Ok(self)
    }

    /// The positions at which the embedded equations hold; `observe` receives the number of Newton steps and
    /// the relative residual before each step.
    ///
    /// # Errors
    /// [`NotConverged`] with the best iterate.
    pub fn solve(&self, observe: &mut dyn FnMut(usize, f64)) -> Result<Solution, NotConverged> {
        let d = self.equation.coordinates;
        let start = self.ends.join(self.guess.as_deref(), self.grid.steps());
        let inner = start[d..start.len() - d].to_vec();
        let mut equations =
            Tridiagonal { problem: self, rows: Vec::new(), gradient: Vec::new(), largest_term: 0.0 };
        let (iterate, positions) = match minimise_residual(&mut equations, inner, &self.options, observe) {
            Some(iterate) => {
                let positions = equations.positions(&iterate.unknowns);
                (iterate, positions)
            }
            None => (Iterate::untouched(), start),
        };
        let points = self.sigma.points(self.grid.steps());
        let residual = self.equation.embedding(&self.grid, self.sigma, &positions);
        let solution = Solution {
            velocities: derivative(self.sigma, &self.grid, d, points, &positions),
            positions,
            value: None,
            newton_iterations: iterate.newton_iterations,
            krylov_iterations: 0,
            history: iterate.history,
            relative_residual: iterate.relative_residual,
            residual: residual.iter().map(|b| b.abs()).fold(0.0, max_or_nan),
            rounding_level: f64::EPSILON * equations.largest_term,
        };
        if iterate.converged && solution.is_finite() {
            Ok(solution)
        } else {
            Err(NotConverged { best: Box::new(solution) })
        }
    }
}

/// Derivatives of the equation with number k with respect to the positions at the points k − 1, k and k + 1.
struct Row([DMatrix<f64>; 3]);

struct Tridiagonal<'a> {
    problem: &'a EmbeddedProblem<'a>,
    rows: Vec<Row>,
    gradient: Vec<f64>,
    /// Largest sum, over the equations, of the magnitudes of an equation's terms and of its changes by
    /// rounding the positions.
    largest_term: f64,
}

impl Tridiagonal<'_> {
    fn positions(&self, unknowns: &[f64]) -> Vec<f64> {
        [self.problem.ends.start.as_slice(), unknowns, &self.problem.ends.end].concat()
    }

    /// Derivatives of one equation, and the magnitudes of its terms.
    fn row(&self, equation: usize, positions: &[f64]) -> (Row, Vec<f64>) {
        let EmbeddedProblem { equation: operator, grid, sigma, .. } = self.problem;
        let d = operator.coordinates;
        let points = operator.embedding.points(*sigma, equation);
        let first = equation - 1;
        let mut row = Row([(); 3].map(|()| DMatrix::zeros(d, d)));
        let mut sizes = vec![0.0; d];
        for (term, compiled) in operator.terms.iter().zip(&operator.compiled) {
            let coefficients = operator.embedding.stencil(*sigma, term.order, grid.step());
            let (factor, factor_slope) = match &compiled.factor {
                Some(factor) => {
                    value_and_gradient(factor, grid.time(points[0]), point(positions, points[0], d))
                }
                None => (1.0, vec![0.0; d]),
            };
            for (i, function) in compiled.of.iter().enumerate() {
                let mut inner = 0.0;
                for (coefficient, k) in coefficients.into_iter().zip(points) {
                    if coefficient == 0.0 {
                        continue;
                    }
                    let x = point(positions, k, d);
                    let (value, slope) = value_and_gradient(function, grid.time(k), x);
                    inner += coefficient * value;
                    sizes[i] += (factor * coefficient * value).abs();
                    for (j, slope) in slope.into_iter().enumerate() {
                        row.0[k - first][(i, j)] += factor * coefficient * slope;
                        sizes[i] += (factor * coefficient * slope * x[j]).abs();
                    }
                }
                for (j, slope) in factor_slope.iter().enumerate() {
                    row.0[points[0] - first][(i, j)] += slope * inner;
                }
            }
        }
        (row, sizes)
    }
}

impl Stationarity for Tridiagonal<'_> {
    fn linearise(&mut self, unknowns: &[f64]) -> Option<Residual> {
        let positions = self.positions(unknowns);
        self.gradient = self.problem.equation.embedding(&self.problem.grid, self.problem.sigma, &positions);
        self.rows.clear();
        let mut square = 0.0;
        self.largest_term = 0.0;
        for equation in 1..self.problem.grid.steps() {
            let (row, sizes) = self.row(equation, &positions);
            self.rows.push(row);
            square += sizes.iter().map(|size| size * size).sum::<f64>();
            self.largest_term = sizes.iter().copied().fold(self.largest_term, max_or_nan);
        }
        let norm = inner(&self.gradient, &self.gradient).sqrt();
        (norm.is_finite() && square.is_finite()).then_some(Residual { norm, scale: square.sqrt() })
    }

    fn norm_at(&mut self, unknowns: &[f64]) -> f64 {
        let positions = self.positions(unknowns);
        let residual = self.problem.equation.embedding(&self.problem.grid, self.problem.sigma, &positions);
        let norm = inner(&residual, &residual).sqrt();
        if norm.is_nan() { f64::INFINITY } else { norm }
    }

    /// Elimination of the blocks below the diagonal, then substitution from the last point back.
    fn direction(&mut self) -> Option<Direction> {
        let d = self.problem.equation.coordinates;
        let mut above: Vec<DMatrix<f64>> = Vec::with_capacity(self.rows.len());
        let mut reduced: Vec<DVector<f64>> = Vec::with_capacity(self.rows.len());
        for (m, Row([before, at, after])) in self.rows.iter().enumerate() {
            let mut pivot = at.clone();
            let mut right_side = -DVector::from_column_slice(point(&self.gradient, m, d));
            if let (Some(above), Some(reduced)) = (above.last(), reduced.last()) {
                pivot -= before * above;
                right_side -= before * reduced;
            }
            let pivot = pivot.lu();
            above.push(pivot.solve(after)?);
            reduced.push(pivot.solve(&right_side)?);
        }
        for m in (0..self.rows.len().saturating_sub(1)).rev() {
            let correction = &above[m] * &reduced[m + 1];
            reduced[m] -= correction;
        }
        let step: Vec<f64> = reduced.iter().flat_map(|part| part.iter().copied()).collect();
        step.iter().all(|entry| entry.is_finite()).then_some(Direction { step, krylov_iterations: 0 })
    }
}
