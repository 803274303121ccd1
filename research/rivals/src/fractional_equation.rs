//! Systems of fractional differential equations for the methods of [`FixedStep`](super::FixedStep).

use fvi_core::ParameterError;

/// A function of t and x that writes to its last argument.
pub type Function<'a> = &'a dyn Fn(f64, &[f64], &mut [f64]);

/// D^{α_i} x_i = f_i(t, x) in Caputo's sense, 0 < α_i ≤ 1, x(0) given: x_i = x_i(0) + J^{α_i} f_i, with the
/// integral J^α f (t) = 1/Γ(α) ∫₀ᵗ (t − s)^{α−1} f(s) ds.
#[derive(Clone, Copy)]
pub struct FractionalEquation<'a> {
    /// α_i.
    pub orders: &'a [f64],
    /// x_i(0).
    pub initial: &'a [f64],
    /// Writes f(t, x) to its last argument.
    pub right: Function<'a>,
    /// Writes ∂f_i/∂x_j to its last argument, row by row.
    pub jacobian: Function<'a>,
}

/// Why a method with steps of one length ended before the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EquationError {
    /// The equation or the grid is outside of what the method is for.
    Parameter(ParameterError),
    /// The equations of a step were not solved.
    NotSolved {
        /// Index of the step.
        step: usize,
    },
}

impl From<ParameterError> for EquationError {
    fn from(error: ParameterError) -> Self {
        Self::Parameter(error)
    }
}

impl FractionalEquation<'_> {
    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.orders.len()
    }

    /// Checks orders and numbers of unknowns.
    pub(crate) fn check(&self) -> Result<(), ParameterError> {
        if self.orders.is_empty() || self.orders.len() != self.initial.len() {
            let allowed = "as many as there are orders, one at least";
            let value = self.initial.len() as f64;
            return Err(ParameterError { parameter: "initial", value, allowed });
        }
        match self.orders.iter().find(|&&order| !(order > 0.0 && order <= 1.0)) {
            Some(&value) => {
                Err(ParameterError { parameter: "order", value, allowed: "greater than 0, at most 1" })
            }
            None => Ok(()),
        }
    }
}

/// Newton's method for x_i = known_i + Σ_j share_{ij} f_i(t_j, x_j) of a block of samples, one as a rule.
#[derive(Default)]
pub(crate) struct Newton {
    values: Vec<f64>,
    slopes: Vec<f64>,
    matrix: Vec<f64>,
    residual: Vec<f64>,
}

/// Most iterations of a step.
const ITERATIONS: usize = 50;

impl Newton {
    /// Solves x_{a,i} = known_{a,i} + Σ_b share(i, a, b) f_i(t_b, x_b) for the samples a, b < `times.len()`, from
    /// the guess in `x`, whose numbers are sample by sample; false if it does not converge.
    pub(crate) fn solve(
        &mut self,
        equation: &FractionalEquation<'_>,
        times: &[f64],
        known: &[f64],
        share: impl Fn(usize, usize, usize) -> f64,
        x: &mut [f64],
    ) -> bool {
        let (count, size) = (equation.unknowns(), x.len());
        self.values.resize(size, 0.0);
        self.slopes.resize(size * count, 0.0);
        self.matrix.resize(size * size, 0.0);
        self.residual.resize(size, 0.0);
        let mut last = f64::INFINITY;
        for _ in 0..ITERATIONS {
            for (sample, &time) in times.iter().enumerate() {
                let at = sample * count..(sample + 1) * count;
                (equation.right)(time, &x[at.clone()], &mut self.values[at.clone()]);
                let slopes = &mut self.slopes[sample * count * count..(sample + 1) * count * count];
                (equation.jacobian)(time, &x[at], slopes);
            }
            self.linearise(count, times.len(), known, &share, x);
            if !eliminate(&mut self.matrix, &mut self.residual) {
                return false;
            }
            let mut change: f64 = 0.0;
            for (value, correction) in x.iter_mut().zip(&self.residual) {
                *value -= correction;
                change = change.max(correction.abs() / value.abs().max(1.0));
            }
            if !change.is_finite() {
                return false;
            }
            // Below √ε a step of Newton's method leaves rounding; above it, rounding ends the decrease.
            if change < 1e-9 || (change < 1e-6 && change >= last) {
                return true;
            }
            last = change;
        }
        false
    }

    /// Residual and matrix of the equations at x.
    fn linearise(
        &mut self,
        count: usize,
        samples: usize,
        known: &[f64],
        share: &impl Fn(usize, usize, usize) -> f64,
        x: &[f64],
    ) {
        let size = count * samples;
        for a in 0..samples {
            for i in 0..count {
                let row = a * count + i;
                let mut sum = x[row] - known[row];
                for b in 0..samples {
                    let weight = share(i, a, b);
                    sum -= weight * self.values[b * count + i];
                    for j in 0..count {
                        let one = f64::from(u8::from(a == b && i == j));
                        let slope = self.slopes[(b * count + i) * count + j];
                        self.matrix[row * size + b * count + j] = one - weight * slope;
                    }
                }
                self.residual[row] = sum;
            }
        }
    }
}

/// Solves a dense system by elimination with partial pivots in place; false if a pivot is zero or no number.
fn eliminate(matrix: &mut [f64], right: &mut [f64]) -> bool {
    let size = right.len();
    for column in 0..size {
        let larger = |&a: &usize, &b: &usize| {
            matrix[a * size + column].abs().total_cmp(&matrix[b * size + column].abs())
        };
        let Some(pivot) = (column..size).max_by(larger) else { return false };
        if pivot != column {
            (0..size).for_each(|entry| matrix.swap(pivot * size + entry, column * size + entry));
            right.swap(pivot, column);
        }
        let diagonal = matrix[column * size + column];
        if !(diagonal.is_finite() && diagonal != 0.0) {
            return false;
        }
        for row in column + 1..size {
            let factor = matrix[row * size + column] / diagonal;
            if factor != 0.0 {
                for entry in column + 1..size {
                    matrix[row * size + entry] -= factor * matrix[column * size + entry];
                }
                right[row] -= factor * right[column];
            }
        }
    }
    for row in (0..size).rev() {
        let known: f64 = (row + 1..size).map(|entry| matrix[row * size + entry] * right[entry]).sum();
        right[row] = (right[row] - known) / matrix[row * size + row];
    }
    true
}
