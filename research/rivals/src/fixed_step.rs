//! The methods for fractional differential equations that the literature's programs have, with steps of one
//! length and fast convolution.

use crate::fractional_equation::{EquationError, FractionalEquation, Newton};
use crate::relaxed::RelaxedProduct;
use fvi_core::{Memory, ParameterError};
use nalgebra::{DMatrix, DVector};

/// A method with steps of one length h. All compute
///
/// ```text
/// x_n = x_0 + h^α ( s_n f_0 + Σ_{j=1}^{n} w_{n−j} f_j ) ,
/// ```
///
/// with weights of their own, for each unknown and its α, the sums by [`RelaxedProduct`] in O(N log² N).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixedStep {
    /// Product integration of order 1, implicit, on f_n in (t_{n−1}, t_n]: w_n = ((n+1)^α − n^α)/Γ(α+1).
    /// \[Gar18\], section 4.
    Rectangle,
    /// Product integration of a polygon through f_n, implicit: w_0 = 1/Γ(α+2), w_n =
    /// ((n−1)^{α+1} − 2n^{α+1} + (n+1)^{α+1})/Γ(α+2). \[Gar18\], section 4.
    Trapezoid,
    /// The same with f_n at the explicit rectangle's x_n, evaluated twice a step (PECE). \[DFF04\].
    PredictorCorrector,
    /// Convolution quadrature, Σ w_n zⁿ = (3/2 − 2z + z²/2)^{−α}, with starting weights that make t^ν exact for ν
    /// ≤ 1 in {i + jα}; one order for all unknowns. \[Lubich86\]; \[Gar15\].
    Bdf2,
}

/// The weights of one unknown, without h^α.
struct Weights {
    /// w_n, the first for the value to come.
    of_lag: Vec<f64>,
    /// s_n.
    of_start: Vec<f64>,
}

/// n^p − (n−1)^p − … in the form n^p ((1 + 1/n)^p − 1), which loses no digits.
fn step_of_power(n: f64, p: f64) -> f64 {
    if n == 0.0 { 1.0 } else { libm::pow(n, p) * libm::expm1(p * libm::log1p(1.0 / n)) }
}

impl Weights {
    fn rectangle(order: f64, steps: usize) -> Self {
        let scale = 1.0 / libm::tgamma(order + 1.0);
        let of_lag = (0..=steps).map(|n| scale * step_of_power(n as f64, order)).collect();
        Self { of_lag, of_start: vec![0.0; steps + 1] }
    }

    fn trapezoid(order: f64, steps: usize) -> Self {
        let (p, scale) = (order + 1.0, 1.0 / libm::tgamma(order + 2.0));
        let of_lag = (0..=steps).map(|n| scale * crate::l1::second_difference(p, n)).collect();
        let of_start = (0..=steps).map(|n| scale * first_of_polygon(n, order)).collect();
        Self { of_lag, of_start }
    }

    /// (3/2 − 2z + z²/2)^{−α} by the recurrence of powers of a polynomial.
    fn bdf2(order: f64, steps: usize) -> Vec<f64> {
        let mut weights = vec![libm::pow(1.5, -order)];
        for n in 1..=steps {
            let k = n as f64;
            let mut sum = -2.0 * (1.0 - order - k) * weights[n - 1];
            if n > 1 {
                sum += 0.5 * (2.0 * (1.0 - order) - k) * weights[n - 2];
            }
            weights.push(sum / (1.5 * k));
        }
        weights
    }
}

/// Γ(α+2) times the weight of f_0 in the integral of a polygon: (n−1)^{α+1} − n^α (n − α − 1).
fn first_of_polygon(n: usize, order: f64) -> f64 {
    let (x, p) = (n as f64, order + 1.0);
    if n < 8 {
        return if n == 0 { 0.0 } else { libm::pow(x - 1.0, p) - libm::pow(x, order) * (x - p) };
    }
    // n^p ((1 − 1/n)^p − 1 + p/n), by its series.
    let (mut term, mut sum) = (-p / x, 0.0);
    for k in 2..60 {
        let k = f64::from(k);
        term *= -(p - k + 1.0) / (k * x);
        sum += term;
    }
    libm::pow(x, p) * sum
}

impl FixedStep {
    /// All methods.
    pub const ALL: [Self; 4] = [Self::Rectangle, Self::Trapezoid, Self::PredictorCorrector, Self::Bdf2];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rectangle => "product integration 1",
            Self::Trapezoid => "product integration 2",
            Self::PredictorCorrector => "predictor–corrector",
            Self::Bdf2 => "fractional BDF 2",
        }
    }

    /// True if the method is for this equation: the fractional BDF for one order of all unknowns.
    pub fn is_for(self, equation: &FractionalEquation<'_>) -> bool {
        self != Self::Bdf2 || equation.orders.iter().all(|&order| order == equation.orders[0])
    }

    /// x at the times 0, h, …, `end` with h = `end`/`steps`, time by time.
    ///
    /// # Errors
    /// [`EquationError`].
    pub fn solve(
        self,
        equation: &FractionalEquation<'_>,
        end: f64,
        steps: usize,
    ) -> Result<Vec<f64>, EquationError> {
        equation.check()?;
        if steps == 0 || !(end > 0.0 && end.is_finite()) {
            let allowed = "positive and finite, in one step at least";
            return Err(ParameterError { parameter: "end", value: end, allowed }.into());
        }
        if !self.is_for(equation) {
            let allowed = "the same for all unknowns with the fractional BDF";
            return Err(ParameterError { parameter: "order", value: equation.orders[0], allowed }.into());
        }
        let grid = Grid::new(equation, end, steps);
        match self {
            Self::Rectangle => grid.implicit(Weights::rectangle),
            Self::Trapezoid => grid.implicit(Weights::trapezoid),
            Self::PredictorCorrector => grid.predict_and_correct(),
            Self::Bdf2 => grid.bdf2(),
        }
    }
}

/// An equation on a grid, with the x that are known and f at the last of them.
struct Grid<'a> {
    equation: &'a FractionalEquation<'a>,
    steps: usize,
    step: f64,
    /// h^{α_i}
    scales: Vec<f64>,
    x: Vec<f64>,
    f: Vec<f64>,
}

impl<'a> Grid<'a> {
    fn new(equation: &'a FractionalEquation<'a>, end: f64, steps: usize) -> Self {
        let step = end / steps as f64;
        let mut f = vec![0.0; equation.unknowns()];
        (equation.right)(0.0, equation.initial, &mut f);
        Self {
            equation,
            steps,
            step,
            scales: equation.orders.iter().map(|&order| libm::pow(step, order)).collect(),
            x: equation.initial.to_vec(),
            f,
        }
    }

    fn time(&self, index: usize) -> f64 {
        index as f64 * self.step
    }

    fn last(&self) -> &[f64] {
        &self.x[self.x.len() - self.equation.unknowns()..]
    }

    fn weights(&self, of: fn(f64, usize) -> Weights) -> Vec<Weights> {
        self.equation.orders.iter().map(|&order| of(order, self.steps)).collect()
    }

    /// One memory for each unknown, each with room for all steps.
    fn memories(&self, weights: &[Weights]) -> Result<Vec<RelaxedProduct>, ParameterError> {
        weights.iter().map(|weights| RelaxedProduct::new(&weights.of_lag, 1, self.steps + 1)).collect()
    }

    /// Evaluates f at the last x.
    fn evaluate(&mut self) {
        let time = self.time(self.x.len() / self.equation.unknowns() - 1);
        let from = self.x.len() - self.equation.unknowns();
        (self.equation.right)(time, &self.x[from..], &mut self.f);
    }

    fn implicit(mut self, of: fn(f64, usize) -> Weights) -> Result<Vec<f64>, EquationError> {
        let weights = self.weights(of);
        let mut memories = self.memories(&weights)?;
        let (first, mut newton) = (self.f.clone(), Newton::default());
        push(&mut memories, &vec![0.0; first.len()]);
        let mut known = vec![0.0; first.len()];
        for n in 1..=self.steps {
            for (i, memory) in memories.iter_mut().enumerate() {
                let sum = weights[i].of_start[n] * first[i] + next(memory);
                known[i] = self.equation.initial[i] + self.scales[i] * sum;
            }
            let mut x = self.last().to_vec();
            let share = |i: usize, _, _| self.scales[i] * weights[i].of_lag[0];
            if !newton.solve(self.equation, &[self.time(n)], &known, share, &mut x) {
                return Err(EquationError::NotSolved { step: n });
            }
            self.x.extend_from_slice(&x);
            self.evaluate();
            push(&mut memories, &self.f);
        }
        Ok(self.x)
    }

    fn predict_and_correct(mut self) -> Result<Vec<f64>, EquationError> {
        let (explicit, polygon) = (self.weights(Weights::rectangle), self.weights(Weights::trapezoid));
        // The predictor's weights are those of the rectangle one step late, and begin with f_0.
        let late = |weights: &Weights| [&[0.0], &weights.of_lag[..self.steps]].concat();
        let late = explicit.iter().map(|weights| Weights { of_lag: late(weights), of_start: Vec::new() });
        let mut predictors = self.memories(&late.collect::<Vec<_>>())?;
        let mut correctors = self.memories(&polygon)?;
        let first = self.f.clone();
        push(&mut predictors, &first);
        push(&mut correctors, &vec![0.0; first.len()]);
        let mut x = vec![0.0; first.len()];
        for n in 1..=self.steps {
            for (i, memory) in predictors.iter_mut().enumerate() {
                x[i] = self.equation.initial[i] + self.scales[i] * next(memory);
            }
            (self.equation.right)(self.time(n), &x, &mut self.f);
            for (i, memory) in correctors.iter_mut().enumerate() {
                let weights = &polygon[i];
                let sum = weights.of_start[n] * first[i] + next(memory) + weights.of_lag[0] * self.f[i];
                x[i] = self.equation.initial[i] + self.scales[i] * sum;
            }
            if x.iter().any(|value| !value.is_finite()) {
                return Err(EquationError::NotSolved { step: n });
            }
            self.x.extend_from_slice(&x);
            self.evaluate();
            push(&mut predictors, &self.f);
            push(&mut correctors, &self.f);
        }
        Ok(self.x)
    }

    fn bdf2(mut self) -> Result<Vec<f64>, EquationError> {
        let order = self.equation.orders[0];
        let exponents = exponents_up_to_one(order);
        let (count, started) = (self.equation.unknowns(), exponents.len());
        let weights = Weights::bdf2(order, self.steps.max(started));
        let starting = StartingWeights::new(order, &weights, exponents)?;
        let (scale, mut newton) = (self.scales[0], Newton::default());
        // The first samples, all at a time.
        let samples = started - 1;
        let times: Vec<f64> = (1..=samples).map(|n| self.time(n)).collect();
        let rows: Vec<Vec<f64>> = (1..=samples).map(|n| starting.of_step(n)).collect();
        let total = |n: usize, j: usize| {
            let lag = if j <= n { weights[n - j] } else { 0.0 };
            scale * (lag + rows[n - 1][j])
        };
        let mut known = Vec::new();
        for n in 1..=samples {
            known.extend((0..count).map(|i| self.equation.initial[i] + total(n, 0) * self.f[i]));
        }
        let mut x = self.equation.initial.repeat(samples);
        if !newton.solve(self.equation, &times, &known, |_, a, b| total(a + 1, b + 1), &mut x) {
            return Err(EquationError::NotSolved { step: samples });
        }
        let mut memory = RelaxedProduct::new(&weights, count, self.steps.max(samples) + 1)?;
        let mut first = vec![self.f.clone()];
        let _ = memory.push(&self.f);
        for sample in x.chunks(count) {
            self.x.extend_from_slice(sample);
            self.evaluate();
            first.push(self.f.clone());
            let _ = memory.push(&self.f);
        }
        let mut term = vec![0.0; count];
        for n in started..=self.steps {
            let _ = memory.next_term(&mut term);
            let row = starting.of_step(n);
            for (i, sum) in term.iter_mut().enumerate() {
                let start: f64 = row.iter().zip(&first).map(|(weight, f)| weight * f[i]).sum();
                *sum = self.equation.initial[i] + scale * (*sum + start);
            }
            let mut x = self.last().to_vec();
            if !newton.solve(self.equation, &[self.time(n)], &term, |_, _, _| scale * weights[0], &mut x) {
                return Err(EquationError::NotSolved { step: n });
            }
            self.x.extend_from_slice(&x);
            self.evaluate();
            let _ = memory.push(&self.f);
        }
        self.x.truncate((self.steps + 1) * count);
        Ok(self.x)
    }
}

/// Pushes f of each unknown to its memory, which has room for it.
fn push(memories: &mut [RelaxedProduct], f: &[f64]) {
    for (memory, value) in memories.iter_mut().zip(f) {
        let _ = memory.push(&[*value]);
    }
}

/// Σ_{n≥1} w_n f_{k−n}.
fn next(memory: &mut RelaxedProduct) -> f64 {
    let mut term = [0.0];
    let _ = memory.next_term(&mut term);
    term[0]
}

/// The exponents i + jα ≤ 1 in rising order; those below 1 and 1 itself.
fn exponents_up_to_one(order: f64) -> Vec<f64> {
    let mut exponents: Vec<f64> =
        (0..).map(|j| f64::from(j) * order).take_while(|&at| at < 1.0 - 1e-9).collect();
    exponents.push(1.0);
    exponents
}

/// Weights of f_0 … f_s in step n that make J^α t^ν exact for s + 1 exponents ν.
struct StartingWeights {
    order: f64,
    exponents: Vec<f64>,
    /// Σ_j w_{n−j} j^ν for each ν and n.
    quadrature: Vec<Vec<f64>>,
    inverse: DMatrix<f64>,
}

impl StartingWeights {
    fn new(order: f64, weights: &[f64], exponents: Vec<f64>) -> Result<Self, ParameterError> {
        let size = exponents.len();
        let powers = DMatrix::from_fn(size, size, |row, column| power(column, exponents[row]));
        let too_small =
            ParameterError { parameter: "order", value: order, allowed: "large enough for starting weights" };
        let inverse = powers.try_inverse().ok_or(too_small)?;
        let steps = weights.len();
        let quadrature = exponents.iter().map(|&exponent| {
            let mut memory = RelaxedProduct::new(weights, 1, steps)?;
            let sum = |n: usize| {
                let sample = power(n, exponent);
                let sum = next(&mut memory) + weights[0] * sample;
                let _ = memory.push(&[sample]);
                sum
            };
            Ok((0..steps).map(sum).collect())
        });
        let quadrature = quadrature.collect::<Result<Vec<_>, ParameterError>>()?;
        Ok(Self { order, exponents, quadrature, inverse })
    }

    fn of_step(&self, n: usize) -> Vec<f64> {
        let missing = |(exponent, sums): (&f64, &Vec<f64>)| {
            let ratio = libm::tgamma(exponent + 1.0) / libm::tgamma(exponent + 1.0 + self.order);
            ratio * libm::pow(n as f64, exponent + self.order) - sums[n]
        };
        let missing = self.exponents.iter().zip(&self.quadrature).map(missing);
        let missing = DVector::from_iterator(self.exponents.len(), missing);
        (&self.inverse * missing).iter().copied().collect()
    }
}

/// j^ν with 0⁰ = 1.
fn power(j: usize, exponent: f64) -> f64 {
    if exponent == 0.0 { 1.0 } else { libm::pow(j as f64, exponent) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// D^α x = (Γ(3)/Γ(3−α)) t^{2−α} + Γ(2+α) t + (t² + t^{1+α})² − x², x = t² + t^{1+α}.
    fn largest_error(method: FixedStep, order: f64, steps: usize) -> f64 {
        let solution = |t: f64| t * t + t.powf(1.0 + order);
        let right = |t: f64, x: &[f64], f: &mut [f64]| {
            let slope = 2.0 / libm::tgamma(3.0 - order) * t.powf(2.0 - order) + libm::tgamma(2.0 + order) * t;
            f[0] = slope + solution(t).powi(2) - x[0] * x[0];
        };
        let jacobian = |_: f64, x: &[f64], slopes: &mut [f64]| slopes[0] = -2.0 * x[0];
        let equation =
            FractionalEquation { orders: &[order], initial: &[0.0], right: &right, jacobian: &jacobian };
        let x = method.solve(&equation, 1.0, steps).unwrap();
        assert_eq!(x.len(), steps + 1);
        let error = |(n, x): (usize, &f64)| (x - solution(n as f64 / steps as f64)).abs();
        x.iter().enumerate().map(error).fold(0.0, fvi_fft::sums::max_or_nan)
    }

    #[test]
    fn orders_on_a_nonlinear_equation_are_those_of_the_literature() {
        for order in [0.3, 0.5, 0.8] {
            for (method, least) in [
                (FixedStep::Rectangle, 0.95),
                (FixedStep::Trapezoid, 1.9),
                (FixedStep::PredictorCorrector, 1.0 + order - 0.1),
                // f has a term t^{2−α}, beyond the powers that the starting weights make exact.
                (FixedStep::Bdf2, 1.8),
            ] {
                let errors = [400, 800, 1600].map(|steps| largest_error(method, order, steps));
                let orders = [errors[0] / errors[1], errors[1] / errors[2]].map(f64::log2);
                assert!(orders[1] > least, "{} at α = {order}: {orders:?}, {errors:?}", method.name());
            }
        }
    }

    #[test]
    fn a_system_with_orders_of_its_own_meets_its_solution() {
        // x' = y, D^½ y = 1 − x: x = 1 − E_{3/2}(−t^{3/2}), whose series is summed.
        let right = |_: f64, x: &[f64], f: &mut [f64]| (f[0], f[1]) = (x[1], 1.0 - x[0]);
        let jacobian = |_: f64, _: &[f64], slopes: &mut [f64]| slopes.copy_from_slice(&[0.0, 1.0, -1.0, 0.0]);
        let equation = FractionalEquation {
            orders: &[1.0, 0.5],
            initial: &[0.0, 0.0],
            right: &right,
            jacobian: &jacobian,
        };
        let exact: f64 = (1..20).map(|k| -(-1f64).powi(k) / libm::tgamma(1.5 * f64::from(k) + 1.0)).sum();
        for method in [FixedStep::Rectangle, FixedStep::Trapezoid, FixedStep::PredictorCorrector] {
            let x = method.solve(&equation, 1.0, 2000).unwrap();
            let error = (x[2 * 2000] - exact).abs();
            assert!(error < 1e-3, "{}: {error}", method.name());
        }
        assert!(FixedStep::Bdf2.solve(&equation, 1.0, 10).is_err());
    }

    #[test]
    fn weights_of_a_long_grid_keep_their_digits() {
        // Constants are integrated exactly: the sum of all weights is n^α/Γ(α+1).
        for order in [0.2, 0.7, 1.0] {
            for of in [Weights::rectangle, Weights::trapezoid] {
                let weights = of(order, 100_000);
                for n in [1, 7, 8, 1000, 100_000] {
                    let first = weights.of_start[n];
                    let sum: f64 = first + weights.of_lag[..n].iter().sum::<f64>();
                    let exact = (n as f64).powf(order) / libm::tgamma(order + 1.0);
                    assert!((sum / exact - 1.0).abs() < 1e-13, "α = {order}, n = {n}: {sum} {exact}");
                }
            }
        }
    }
}
