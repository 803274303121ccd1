//! Matrix weights of Runge–Kutta convolution quadrature, with relative accuracy at every index.

use crate::sums::{CompensatedSum, max_or_nan};
use std::f64::consts::PI;
use std::ops::Range;

use crate::Aligned;
use crate::quadrature::inverse::inverse;
use crate::quadrature::runge_kutta_circle::on_circle;
use crate::transfer::fractions::{Fractions, PoleOfOrder};
use crate::transfer::{Pole, TransferFunction};
use fvi_core::{ExponentialTable, ParameterError, Real, RungeKutta};
use nalgebra::{Complex, DMatrix, DVector, SMatrix, SVector};

/// A decaying exponential of the kernel: its part of the weight W_n is
/// (1 − `decrement`)^{n−1} · `left` · `right`ᵀ.
#[derive(Clone, Copy, Debug)]
pub struct RankOneExponential<const R: usize> {
    /// 1 − R(−x), R the stability function: in (0, 2), with full relative accuracy.
    pub decrement: f64,
    /// Coefficient times (I + xA)⁻¹ 1.
    pub left: SVector<f64, R>,
    /// bᵀ (I + xA)⁻¹.
    pub right: SVector<f64, R>,
}

/// Points of the contour. The slowest of the methods needs about a thousand for rounding accuracy.
const CONTOUR_POINTS: usize = 2048;

/// Relative accuracy of the quadrature over the cut.
const TOLERANCE: f64 = 1e-17;

/// ln d of the smallest distances from a branch point that are numbers.
const LEAST_PLACE: f64 = -690.0;

/// Exponentials per block of fvi-core's table.
const EXPONENTIALS_IN_BLOCK: usize = 4;

/// Decrement below which running sums are kept in two parts: they would accumulate the rounding errors of
/// many steps.
const SLOW_DECREMENT: f64 = 1.0 / 32.0;

/// Number of weights by a transform from which the first are taken.
const NEAR: usize = 64;

/// Coefficients of negative powers of an analytic function, relative to its largest value: rounding.
const NEGATIVE: f64 = 1e-11;

/// Number of powers between two exact evaluations of an exponential in [`RungeKuttaWeights::planes`].
const RESTART: usize = 16;

/// The matrix weights W_n of D^β for a Runge–Kutta method, n = 0 … count − 1.
///
/// ```text
/// Δ(z) = A⁻¹ − z A⁻¹ 1 bᵀ A⁻¹ ,      Σ_n W_n zⁿ = (Δ(z)/h)^β
/// ```
///
/// Cauchy's formula around the spectrum of A⁻¹, the resolvent of Δ(z) expanded in z (a rank-one change),
/// gives
///
/// ```text
/// W₀ = h^{−β}/(2πi) ∮ λ^β (λA − I)⁻¹A dλ ,
/// W_n = −h^{−β}/(2πi) ∮ λ^β R(λ)^{n−1} (λA−I)⁻¹1 · bᵀ(λA−I)⁻¹ dλ
/// ```
///
/// with the stability function R. A circle serves n = 0 and 1; for the others the contour is collapsed onto
/// the negative axis,
///
/// ```text
/// W_n = −(sin πβ / π) h^{−β} ∫₀^∞ x^β R(−x)^{n−1} (I+xA)⁻¹1 · bᵀ(I+xA)⁻¹ dx ,
/// ```
///
/// by the trapezoidal rule in ln x. There is no cancellation, so each weight has a small relative error,
/// where a transform on a circle loses all digits of the tail. The powers are computed from ln(1 −
/// decrement), not from R rounded to a number near one.
///
/// For 1 < β < 2 the first three follow from those of β − 1 by the semigroup property: the integral needs n >
/// β + 1 to converge fast. Integer exponents have at most two nonzero weights: D¹ has A⁻¹/h and −A⁻¹1bᵀA⁻¹/h.
/// Source: \[LO93\];
/// \[LS02\] for the contour.
#[derive(Clone, Debug)]
pub struct RungeKuttaWeights<const R: usize> {
    count: usize,
    step_size: f64,
    /// W₀, W₁ and for β > 1 also W₂.
    near: Vec<SMatrix<f64, R, R>>,
    /// Empty for integer exponents.
    exponentials: Vec<RankOneExponential<R>>,
    /// The other weights of a rational K whose poles are not all simple and real.
    far: Vec<SMatrix<f64, R, R>>,
}

impl<const R: usize> RungeKuttaWeights<R> {
    /// Weights for the operator D^`exponent` and the step size `step_size`, `count` of them.
    ///
    /// # Errors
    /// If the exponent is outside (−1, 2), the step size is not positive and finite, or `count` is zero.
    pub fn new(
        method: &RungeKutta<R>,
        exponent: f64,
        step_size: f64,
        count: usize,
    ) -> Result<Self, ParameterError> {
        let refuse = |parameter, value, allowed| Err(ParameterError { parameter, value, allowed });
        if !(exponent > -1.0 && exponent < 2.0) {
            return refuse("exponent", exponent, "greater than −1 and less than 2");
        }
        if !(step_size > 0.0 && step_size.is_finite()) {
            return refuse("step size", step_size, "positive and finite");
        }
        if count == 0 {
            return refuse("number of weights", 0.0, "positive");
        }
        let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
        let weights = SVector::<f64, R>::from(*method.quadrature().weights());
        let scale = libm::pow(step_size, -exponent);
        let mut near = near_weights(&matrix, &weights, exponent);
        let exponentials = if exponent == 0.0 || exponent == 1.0 {
            Vec::new()
        } else {
            cut_exponentials(&matrix, &weights, exponent, scale, near.len()..count.max(near.len() + 1))
        };
        near.iter_mut().for_each(|weight| *weight *= scale);
        Ok(Self { count, step_size, near, exponentials, far: Vec::new() })
    }

    /// Weights of the same operator on rises X_k − 1 x_k, the differences of the stages from the main node
    /// x_k at the beginning of their step, the last stage of the previous step: V_n with D^β X = Σ_n V_n
    /// (X_{k−n} − 1 x_{k−n}).
    ///
    /// The discrete derivative of the method is a multiple of the rises, Δ(z)X = A⁻¹(X_k − 1 x_k), so that
    /// V_n is the weight of D^{β−1} times A⁻¹/h.
    ///
    /// # Errors
    /// As [`new`](RungeKuttaWeights::new), and if the exponent is not positive.
    pub fn on_rises(
        method: &RungeKutta<R>,
        exponent: f64,
        step_size: f64,
        count: usize,
    ) -> Result<Self, ParameterError> {
        if !(exponent > 0.0 && exponent < 2.0) {
            let allowed = "greater than 0 and less than 2 for weights on rises";
            return Err(ParameterError { parameter: "exponent", value: exponent, allowed });
        }
        let mut weights = Self::new(method, exponent - 1.0, step_size, count)?;
        let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
        let derivative = inverse(&matrix) / step_size;
        weights.near.iter_mut().for_each(|weight| *weight *= derivative);
        weights.exponentials.iter_mut().for_each(|e| e.right = derivative.tr_mul(&e.right));
        Ok(weights)
    }

    /// Weights of any transfer function K on values, or on rises if `on_rises` is set: Σ W_n zⁿ = K(Δ(z)/h),
    /// or K(Δ(z)/h) (Δ(z)/h)⁻¹ times A⁻¹/h. Each is right relative to itself where K is determined by its cut
    /// and poles, or rational; otherwise they come from a transform on a circle, with errors relative to the
    /// largest |K(Δ(z)/h)| there.
    ///
    /// # Errors
    /// As [`new`](RungeKuttaWeights::new) and [`on_rises`](RungeKuttaWeights::on_rises); and if K is singular
    /// in Re s > 0.
    pub fn of_transfer(
        method: &RungeKutta<R>,
        transfer: &TransferFunction,
        on_rises: bool,
        step_size: f64,
        count: usize,
    ) -> Result<Self, ParameterError> {
        if let Some(exponent) = transfer.exponent() {
            let make = if on_rises { Self::on_rises } else { Self::new };
            return make(method, exponent, step_size, count);
        }
        let refuse = |parameter, value, allowed| Err(ParameterError { parameter, value, allowed });
        if let Some(narrow) = transfer.narrow() {
            return Err(narrow);
        }
        if !(step_size > 0.0 && step_size.is_finite()) {
            return refuse("step size", step_size, "positive and finite");
        }
        if count == 0 {
            return refuse("number of weights", 0.0, "positive");
        }
        let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
        let weights = SVector::<f64, R>::from(*method.quadrature().weights());
        let growth = transfer.growth() - if on_rises { 1.0 } else { 0.0 };
        // The integral over the cut needs n > μ + 1 to converge.
        let first = if growth > 0.9 { 3 } else { 2 };
        let function = |lambda: Complex<f64>| {
            let s = lambda / step_size;
            let value = transfer.value(s);
            if on_rises { value / s } else { value }
        };
        let range = first..count.max(first + 1);
        if !transfer.is_relaxation() && oscillating(transfer).is_none() {
            // The first weights from the same points for any count, so that they are the same numbers.
            let of = |count| weights_on_circle(method, transfer, on_rises, step_size, count);
            let near = of(NEAR)?[..first].to_vec();
            let far = if count > first { of(count)?.split_off(first) } else { Vec::new() };
            return Ok(Self { count, step_size, near, exponentials: Vec::new(), far });
        }
        let near = contour_weights_of(&matrix, &weights, function, first);
        let (exponentials, far) = match oscillating(transfer).filter(|_| !transfer.is_relaxation()) {
            Some(fractions) => {
                let poles = if on_rises { fractions.poles_over_s() } else { fractions.poles };
                (Vec::new(), responses_of(&matrix, &weights, &poles, step_size, range))
            }
            None => (exponentials_of(&matrix, &weights, transfer, on_rises, step_size, range), Vec::new()),
        };
        let mut made = Self { count, step_size, near, exponentials, far };
        if on_rises {
            let derivative = inverse(&matrix) / step_size;
            made.near.iter_mut().chain(&mut made.far).for_each(|weight| *weight *= derivative);
            made.exponentials.iter_mut().for_each(|e| e.right = derivative.tr_mul(&e.right));
        }
        Ok(made)
    }

    /// Number of weights, the horizon of the table.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Leading weight W₀.
    pub fn leading(&self) -> &SMatrix<f64, R, R> {
        &self.near[0]
    }

    /// det W₀.
    pub fn leading_determinant(&self) -> f64 {
        DMatrix::from_column_slice(R, R, self.leading().as_slice()).determinant()
    }

    /// The first two or three weights, which are not given by the exponentials.
    pub fn near(&self) -> &[SMatrix<f64, R, R>] {
        &self.near
    }

    /// The exponentials whose sum are the other weights; none if these vanish.
    pub fn exponentials(&self) -> &[RankOneExponential<R>] {
        &self.exponentials
    }

    /// (Δ(z)/h)^β = Σ_n W_n zⁿ for |z| ≤ 1, as a sum of geometric series. The exponentials describe the
    /// weights below [`count`](Self::count), so |z − 1| must be much larger than the inverse of that.
    pub fn symbol(&self, z: Complex<f64>) -> SMatrix<Complex<f64>, R, R> {
        let mut power = Complex::new(1.0, 0.0);
        let mut symbol = SMatrix::zeros();
        for weight in self.near.iter().chain(&self.far) {
            symbol += weight.map(|entry| power * entry);
            power *= z;
        }
        for exponential in &self.exponentials {
            let first = exponential.power(self.near.len() - 1);
            let series = power * first / (Complex::new(1.0, 0.0) - z * (1.0 - exponential.decrement));
            symbol += (exponential.left * exponential.right.transpose()).map(|entry| series * entry);
        }
        symbol
    }

    /// The table in the format and scalar of fvi-core's exponential-sum memory.
    pub fn table<T: Real>(&self) -> ExponentialTable<Aligned<T>> {
        let first = self.near.len();
        let entries = (0..R).flat_map(|i| (0..R).map(move |j| (i, j)));
        let head = entries.flat_map(|place| self.near.iter().map(move |weight| T::of(weight[place])));
        // Slow exponentials must come first.
        let slow_first: Vec<_> = self.exponentials.iter().rev().collect();
        let mut numbers = Vec::new();
        for block in slow_first.chunks(EXPONENTIALS_IN_BLOCK) {
            let lane = |of: &dyn Fn(&RankOneExponential<R>) -> f64| {
                let mut lanes = [T::zero(); EXPONENTIALS_IN_BLOCK];
                for (lane, exponential) in lanes.iter_mut().zip(block) {
                    *lane = T::of(of(exponential));
                }
                lanes
            };
            numbers.extend(lane(&|exponential| exponential.decrement));
            for stage in 0..R {
                // The table of a scalar kernel has no inputs: they are included in the outputs.
                let input =
                    |exponential: &RankOneExponential<R>| if R == 1 { exponential.right[0] } else { 1.0 };
                numbers.extend(lane(&|exponential| {
                    exponential.left[stage] * input(exponential) * exponential.power(first - 1)
                }));
            }
            if R > 1 {
                for stage in 0..R {
                    numbers.extend(lane(&|exponential| exponential.right[stage]));
                }
            }
        }
        let slow = slow_first.iter().take_while(|exponential| exponential.decrement < SLOW_DECREMENT).count();
        ExponentialTable {
            stages: R,
            head: head.collect(),
            exponentials: numbers.into_iter().collect(),
            slow_blocks: slow.div_ceil(EXPONENTIALS_IN_BLOCK),
            far_blocks: 0,
            horizon: self.count as u64,
            step_size: self.step_size,
        }
    }

    /// All weights, plane by plane as engines expect them: entry (i, j) of W_n is at (i·R + j)·count + n.
    pub fn planes(&self) -> Vec<f64> {
        let mut planes = vec![0.0; R * R * self.count];
        let mut put = |n: usize, weight: &SMatrix<f64, R, R>| {
            for i in 0..R {
                for j in 0..R {
                    planes[(i * R + j) * self.count + n] = weight[(i, j)];
                }
            }
        };
        for (n, weight) in self.near.iter().chain(&self.far).enumerate().take(self.count) {
            put(n, weight);
        }
        if !self.far.is_empty() {
            return planes;
        }
        // Largest x first: terms that have decayed at n are dropped for good.
        let mut alive = self.exponentials.len();
        let mut powers = vec![0.0; alive];
        let first = self.near.len();
        for n in first..self.count {
            if (n - first).is_multiple_of(RESTART) {
                for (power, exponential) in powers.iter_mut().zip(&self.exponentials).take(alive) {
                    *power = exponential.power(n - 1);
                }
                while alive > 0 && powers[alive - 1].abs() < 1e-40 {
                    alive -= 1;
                }
            }
            let mut weight = SMatrix::<f64, R, R>::zeros();
            for (power, exponential) in powers.iter_mut().zip(&self.exponentials).take(alive) {
                weight += exponential.left * *power * exponential.right.transpose();
                *power -= *power * exponential.decrement;
            }
            put(n, &weight);
        }
        planes
    }
}

impl<const R: usize> RankOneExponential<R> {
    /// (1 − decrement)^n.
    fn power(&self, n: usize) -> f64 {
        let base = 1.0 - self.decrement;
        if base > 0.0 {
            libm::exp(n as f64 * libm::log1p(-self.decrement))
        } else {
            let size = libm::pow(-base, n as f64);
            if n.is_multiple_of(2) { size } else { -size }
        }
    }
}

/// The first weights for h = 1. The method is stiffly accurate: bᵀA⁻¹ is the last unit vector.
fn near_weights<const R: usize>(
    matrix: &SMatrix<f64, R, R>,
    weights: &SVector<f64, R>,
    exponent: f64,
) -> Vec<SMatrix<f64, R, R>> {
    let (inverse, zero) = (inverse(matrix), SMatrix::<f64, R, R>::zeros());
    let lower = if exponent == 0.0 {
        return vec![SMatrix::identity(), zero];
    } else if exponent < 1.0 {
        return contour_weights(matrix, weights, exponent);
    } else if exponent == 1.0 {
        vec![SMatrix::identity(), zero]
    } else {
        let mut lower = contour_weights(matrix, weights, exponent - 1.0);
        let exponentials = cut_exponentials(matrix, weights, exponent - 1.0, 1.0, 2..3);
        lower.push(exponentials.iter().fold(zero, |sum, exponential| {
            sum + exponential.left * (1.0 - exponential.decrement) * exponential.right.transpose()
        }));
        lower
    };
    // D^β = D¹ D^{β−1}
    let sums = inverse * SVector::<f64, R>::repeat(1.0);
    let previous = std::iter::once(&zero).chain(&lower);
    lower
        .iter()
        .zip(previous)
        .map(|(weight, previous)| inverse * weight - sums * previous.row(R - 1))
        .collect()
}

/// W₀ and W₁ for h = 1 by the trapezoidal rule on a circle around the spectrum of A⁻¹, in the right
/// half-plane.
///
/// The circle around m passes through the geometric mean of the distances of the farthest eigenvalue and of
/// the branch point 0 from m; the rule converges like a power of their ratio. m = |λ|²/Re λ minimises that
/// ratio for the eigenvalue λ.
fn contour_weights<const R: usize>(
    matrix: &SMatrix<f64, R, R>,
    weights: &SVector<f64, R>,
    exponent: f64,
) -> Vec<SMatrix<f64, R, R>> {
    let power = |lambda: Complex<f64>| {
        let phase = exponent * libm::atan2(lambda.im, lambda.re);
        let size = libm::pow(lambda.norm(), exponent);
        Complex::new(size * libm::cos(phase), size * libm::sin(phase))
    };
    contour_weights_of(matrix, weights, power, 2)
}

/// The first `count` weights, two or three, of a function of λ in place of λ^β.
fn contour_weights_of<const R: usize>(
    matrix: &SMatrix<f64, R, R>,
    weights: &SVector<f64, R>,
    function: impl Fn(Complex<f64>) -> Complex<f64>,
    count: usize,
) -> Vec<SMatrix<f64, R, R>> {
    let in_place = |matrix: &SMatrix<f64, R, R>| DMatrix::from_column_slice(R, R, matrix.as_slice());
    let (inverse, weights) = (in_place(&inverse(matrix)), DVector::from_column_slice(weights.as_slice()));
    let near = contour_integrals(&in_place(matrix), &inverse, &weights, &function);
    near.iter().take(count).map(|weight| SMatrix::from_column_slice(weight.as_slice())).collect()
}

/// The first three weights for any number of stages, compiled once for all of them.
fn contour_integrals(
    matrix: &DMatrix<f64>,
    inverse: &DMatrix<f64>,
    weights: &DVector<f64>,
    function: &dyn Fn(Complex<f64>) -> Complex<f64>,
) -> [DMatrix<f64>; 3] {
    let stages = weights.len();
    let eigenvalues = inverse.complex_eigenvalues();
    let middle = eigenvalues.iter().map(|value| value.norm_sqr() / value.re).fold(0.0, max_or_nan);
    let farthest = eigenvalues.iter().map(|value| (value - middle).norm()).fold(0.25 * middle, max_or_nan);
    let radius = (middle * farthest).sqrt();
    let complex = |number: f64| Complex::new(number, 0.0);
    let (matrix, weights) = (matrix.map(complex), weights.map(complex));
    let ones = DVector::repeat(stages, complex(1.0));
    let identity = DMatrix::identity(stages, stages);
    let mut near = [0; 3].map(|_| DMatrix::zeros(stages, stages));
    for point in 0..CONTOUR_POINTS {
        let angle = 2.0 * PI * (point as f64 + 0.5) / CONTOUR_POINTS as f64;
        let offset = Complex::new(libm::cos(angle), libm::sin(angle)) * radius;
        let lambda = offset + middle;
        let power = function(lambda);
        let Some(resolvent) = (&matrix * lambda - &identity).lu().try_inverse() else {
            // No eigenvalue lies on the circle: weights that are no numbers would show it.
            return [0; 3].map(|_| DMatrix::from_element(stages, stages, f64::NAN));
        };
        // dλ/(2πi) of the rule
        let factor = power * offset / CONTOUR_POINTS as f64;
        let left = &resolvent * &ones;
        let right = resolvent.tr_mul(&weights);
        near[0] += (&resolvent * &matrix * factor).map(|entry| entry.re);
        let product = left * right.transpose() * factor;
        near[1] -= product.map(|entry| entry.re);
        // R(λ) = 1 − λ bᵀ(λA − I)⁻¹ 1
        let stability = complex(1.0) - lambda * right.sum();
        near[2] -= (product * stability).map(|entry| entry.re);
    }
    near
}

/// The first `count` weights of a K that is analytic in the right half-plane, where the spectrum of Δ(z) is,
/// by a transform on a circle.
fn weights_on_circle<const R: usize>(
    method: &RungeKutta<R>,
    transfer: &TransferFunction,
    on_rises: bool,
    step_size: f64,
    count: usize,
) -> Result<Vec<SMatrix<f64, R, R>>, ParameterError> {
    let found = on_circle(method, &|s| transfer.value(s), step_size, on_rises, count)?;
    if found.behind.is_nan() || found.behind > NEGATIVE {
        return Err(ParameterError {
            parameter: "weight of the kernel",
            value: found.behind,
            allowed: "bounded: K(s) must be analytic for Re s > 0",
        });
    }
    Ok((0..count).map(|n| SMatrix::from_fn(|i, j| found.planes[(i * R + j) * count + n])).collect())
}

/// The partial fractions of a rational K whose poles lie in Re s < 0.
fn oscillating(transfer: &TransferFunction) -> Option<Fractions> {
    transfer.fractions().filter(|fractions| fractions.poles.iter().all(|pole| pole.place.re < 0.0))
}

/// The weights of poles of any order for n in `range`: the stages of x₁' = p x₁ + u, x₂' = p x₂ + x₁, … by
/// the method itself, whose discrete operator at Δ(z)/h they are, under unit pulses at each stage.
fn responses_of<const R: usize>(
    matrix: &SMatrix<f64, R, R>,
    weights: &SVector<f64, R>,
    poles: &[PoleOfOrder],
    step_size: f64,
    range: Range<usize>,
) -> Vec<SMatrix<f64, R, R>> {
    let complex = |number: f64| Complex::new(number, 0.0);
    let matrix = DMatrix::from_fn(R, R, |i, j| complex(matrix[(i, j)] * step_size));
    let weights = DVector::from_fn(R, |i, _| complex(weights[i] * step_size));
    let mut made = vec![SMatrix::<f64, R, R>::zeros(); range.len()];
    for pole in poles.iter().filter(|pole| pole.place.im >= 0.0) {
        // Of a pair both are counted with the upper one.
        let times = if pole.place.im > 0.0 { 2.0 } else { 1.0 };
        let implicit = DMatrix::identity(R, R) - &matrix * pole.place;
        let unknown = DMatrix::from_element(R, R, complex(f64::NAN));
        let resolvent = implicit.lu().try_inverse().unwrap_or(unknown);
        for column in 0..R {
            let mut states = vec![Complex::ZERO; pole.coefficients.len()];
            for n in 0..range.end {
                let pulse = if n == 0 { 1.0 } else { 0.0 };
                let mut input =
                    DVector::from_fn(R, |stage, _| complex(if stage == column { pulse } else { 0.0 }));
                for (state, coefficient) in states.iter_mut().zip(&pole.coefficients) {
                    let stages = &resolvent * (&matrix * &input + DVector::repeat(R, *state));
                    *state += weights.dot(&(&stages * pole.place + &input));
                    if let Some(place) = n.checked_sub(range.start) {
                        for stage in 0..R {
                            made[place][(stage, column)] += times * (stages[stage] * coefficient).re;
                        }
                    }
                    input = stages;
                }
            }
        }
    }
    made
}

/// Relative difference from a power law next to a branch point at which its rest is not that of a power.
const NOT_A_POWER: f64 = 1e-6;

/// The coefficient of the exponentials that stand still up to the last weight, on rises, of a kernel with a
/// cut from 0 that falls more slowly than any power there, as that of (s − 1)/ln s does.
///
/// With nodes x_i in λ = s h from e^{2 a} to e^b, a the place of the slowest that moves, K(s)/s = Σ c_i/(λ +
/// x_i) + c/λ for λ = e^a, beside which those below are zero and those above infinite, says c.
fn standing_on_rises(
    transfer: &TransferFunction,
    step_size: f64,
    (lowest, highest, width): (f64, f64, f64),
    coefficient: &dyn Fn(f64) -> f64,
) -> f64 {
    let lambda = libm::exp(lowest);
    let value = step_size * transfer.value(Complex::new(lambda / step_size, 0.0)).re;
    let (below, above) = ((-lowest / width).ceil() as i32, ((highest - lowest) / width).ceil() as i32);
    let node = |k: i32| libm::exp(lowest + width * f64::from(k));
    let moved: CompensatedSum =
        (-below..above).map(|k| coefficient(node(k)) * lambda / (lambda + node(k))).collect();
    let slow: CompensatedSum = (-below..0).map(|k| coefficient(node(k))).collect();
    value - moved.total() + slow.total()
}

/// The integral over the cut of any transfer function, divided by s on rises, and its poles, for n in
/// `range`: the trapezoidal rule in ln d, x = h (a + d).
fn exponentials_of<const R: usize>(
    matrix: &SMatrix<f64, R, R>,
    weights: &SVector<f64, R>,
    transfer: &TransferFunction,
    on_rises: bool,
    step_size: f64,
    range: Range<usize>,
) -> Vec<RankOneExponential<R>> {
    let ones = SVector::<f64, R>::repeat(1.0);
    // The exponential at x for the weight `coefficient` in ∫ dμ(x) R(−x)^{n−1} (I + xA)⁻¹1 · bᵀ(I + xA)⁻¹.
    let at = |x: f64, coefficient: f64| {
        let resolvent = inverse(&(SMatrix::identity() + matrix * x));
        let right = resolvent.tr_mul(weights);
        (x, RankOneExponential { decrement: x * right.sum(), left: resolvent * ones * coefficient, right })
    };
    // 1/(s + λ) has the measure h at x = λh; on rises it is divided by s = −λ.
    let pole = |pole: Pole| {
        let residue = if on_rises { -pole.residue / pole.rate } else { pole.residue };
        at(pole.rate * step_size, residue * step_size)
    };
    let mut found: Vec<_> = transfer.poles().into_iter().map(pole).collect();
    if let Some(cut) = transfer.cut() {
        let digits = -libm::log(TOLERANCE);
        let growth = transfer.growth() - if on_rises { 1.0 } else { 0.0 };
        let power = cut.power - if on_rises && cut.start == 0.0 { 1.0 } else { 0.0 };
        let width = 2.0 * PI * cut.strip / (digits + (growth + 0.5).max(0.0) * 4.0);
        // Nodes that are constant relative to the branch point up to the last weight are merged to one there.
        let stand = power < 0.0 || cut.start > 0.0;
        // Maxwell's form follows its powers only far out: the smaller one is assumed.
        let fall = 1.0 + power.min(growth) + if stand { 1.0 } else { 0.0 };
        let lowest = -digits / fall - libm::log(range.end as f64);
        let highest = libm::log(200.0) + digits / (range.start as f64 - growth);
        let nodes = ((highest - lowest) / width).ceil() as usize;
        let start = cut.start * step_size;
        let coefficient = |d: f64| {
            let jump = -transfer.jump(d / step_size) * d * width;
            if on_rises { -jump * step_size / (start + d) } else { jump }
        };
        if stand {
            // Term by term: next to the branch point a kernel of several powers, such as Maxwell's, follows
            // none of them. The last term stands for those behind it, if they fall like a power.
            let ratio = libm::exp(-width * (1.0 + power));
            let last = -1.0 / libm::expm1(-width * (1.0 + power));
            let (mut standing, mut before) = (0.0_f64, 0.0_f64);
            let mut place = lowest;
            let falls_like_a_power = loop {
                place -= width;
                let term = coefficient(libm::exp(place));
                let is_last = place - width < LEAST_PLACE;
                if is_last || (term * last).abs() <= TOLERANCE * standing.abs() {
                    standing += term * last;
                    break !is_last || (term - before * ratio).abs() <= NOT_A_POWER * term.abs();
                }
                standing += term;
                before = term;
            };
            if on_rises && !falls_like_a_power {
                standing = standing_on_rises(transfer, step_size, (lowest, highest, width), &coefficient);
            }
            found.push(at(start, standing));
        }
        found.extend((0..nodes).map(|node| {
            let d = libm::exp(lowest + width * node as f64);
            at(start + d, coefficient(d))
        }));
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, exponential)| exponential).collect()
}

/// The trapezoidal rule in y = ln x for the integral over the cut, for n in `range`, which begins at 2 or
/// later.
fn cut_exponentials<const R: usize>(
    matrix: &SMatrix<f64, R, R>,
    weights: &SVector<f64, R>,
    exponent: f64,
    scale: f64,
    range: Range<usize>,
) -> Vec<RankOneExponential<R>> {
    // The integrand is e^{(1+β)y − n x} where it matters and analytic for |Im y| < π/2: the error is
    // e^{−π²/d} times a power of the size at the edge of the strip.
    let digits = -libm::log(TOLERANCE);
    let width = PI * PI / (digits + (exponent + 0.5).max(0.0) * 4.0);
    // On the left the integrand falls like x^{1+β}, on the right like x^{β−n}. For β < 0, where the former is
    // slow, the nodes that are constant up to the last weight, a geometric series, are merged to one at x =
    // 0: the error of that is like (nx)^{2+β}.
    let stand = exponent < 0.0;
    let fall = if stand { 2.0 + exponent } else { 1.0 + exponent };
    let lowest = -digits / fall - libm::log(range.end as f64);
    let highest = libm::log(200.0) + digits / (range.start as f64 - exponent);
    let nodes = ((highest - lowest) / width).ceil() as usize;
    let factor = -libm::sin(PI * exponent) / PI * scale * width;
    let ones = SVector::<f64, R>::repeat(1.0);
    let ratio = 1.0 + exponent;
    let standing = factor * libm::exp((lowest - width) * ratio) / -libm::expm1(-width * ratio);
    let standing = RankOneExponential { decrement: 0.0, left: ones * standing, right: *weights };
    stand
        .then_some(standing)
        .into_iter()
        .chain((0..nodes).map(|node| {
            let x = libm::exp(lowest + width * node as f64);
            let resolvent = inverse(&(SMatrix::identity() + matrix * x));
            let right = resolvent.tr_mul(weights);
            let left = resolvent * ones * (factor * libm::pow(x, 1.0 + exponent));
            RankOneExponential { decrement: x * right.sum(), left, right }
        }))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Σ_n W_n zⁿ from the weights, at a z inside the circle.
    fn series<const R: usize>(weights: &RungeKuttaWeights<R>, z: f64, count: usize) -> SMatrix<f64, R, R> {
        let planes = weights.planes();
        let entry = |n: usize, i: usize, j: usize| planes[(i * R + j) * weights.count() + n];
        (0..count).rev().fold(SMatrix::zeros(), |sum: SMatrix<f64, R, R>, n| {
            sum * z + SMatrix::from_fn(|i, j| entry(n, i, j))
        })
    }

    fn check<const R: usize>(method: &RungeKutta<R>, transfer: &TransferFunction, step_size: f64) {
        let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
        let inverse = inverse(&matrix);
        let (z, count) = (0.5, 120);
        let last = SMatrix::<f64, R, R>::from_fn(|_, j| f64::from(u8::from(j + 1 == R)));
        // Δ = A⁻¹ − z A⁻¹ 1 bᵀA⁻¹, where bᵀA⁻¹ is the last unit vector; its powers are independent of the
        // weights.
        let delta = (inverse - inverse * last * z) / step_size;
        let values = RungeKuttaWeights::of_transfer(method, transfer, false, step_size, count).unwrap();
        let found = series(&values, z, count);
        // K(Δ) commutes with Δ and has the same eigenvectors: they are compared through K of the eigenvalues
        // of Δ.
        let commutator = (found * delta - delta * found).norm() / (found.norm() * delta.norm());
        assert!(commutator < 1e-13, "{transfer}: {commutator:e}");
        let eigenvalues = DMatrix::from_column_slice(R, R, delta.as_slice()).complex_eigenvalues();
        let trace: Complex<f64> = eigenvalues.iter().map(|&value| transfer.value(value)).sum();
        let error = (found.trace() - trace.re).abs();
        assert!(error < 1e-12 * (1.0 + trace.re.abs()), "{transfer}, {R}: {error:e}");
        // Weights on rises: V(z) = W(z) Δ(z)⁻¹ A⁻¹/h.
        let rises = RungeKuttaWeights::of_transfer(method, transfer, true, step_size, count).unwrap();
        let expected = found * super::inverse(&delta) * inverse / step_size;
        let error = (series(&rises, z, count) - expected).norm() / expected.norm();
        assert!(error < 1e-12, "{transfer}, {R}, rises: {error:e}");
    }

    #[test]
    fn weights_of_any_transfer_function_are_the_series_of_its_value() {
        for transfer in [
            TransferFunction::tempered(0.5, 0.3),
            TransferFunction::tempered(1.5, 2.0),
            TransferFunction::maxwell(0.6, 0.0, 1.5),
            TransferFunction::maxwell(0.9, 0.4, 0.5),
            // Next to the branch point these follow no power for many decades.
            TransferFunction::maxwell(0.12, 0.105, 1.0),
            TransferFunction::maxwell(0.5, 0.45, 1.0),
            TransferFunction::maxwell(0.98, 0.9, 0.1),
            TransferFunction::prony(&[1.0, 0.7], &[1.0, 0.1]),
            TransferFunction::havriliak_negami(0.7, 0.5, 1.0),
            TransferFunction::havriliak_negami(1.0, 0.5, 2.0),
        ] {
            let transfer = transfer.unwrap();
            for step_size in [0.01, 0.5] {
                check(&RungeKutta::<1>::radau_iia().unwrap(), &transfer, step_size);
                check(&RungeKutta::<2>::radau_iia().unwrap(), &transfer, step_size);
                check(&RungeKutta::<3>::radau_iia().unwrap(), &transfer, step_size);
                check(&RungeKutta::<4>::lobatto_iiic().unwrap(), &transfer, step_size);
            }
        }
    }
}
