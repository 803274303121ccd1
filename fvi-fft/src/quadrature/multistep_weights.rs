//! Weights of convolution quadrature by multistep rules, for any transfer function.

use std::f64::consts::PI;

use crate::quadrature::principal_cut::PrincipalCut;
use crate::real_transforms;
use crate::transfer::TransferFunction;
use crate::transfer::derivative::TransferDerivative;
use crate::transfer::given_weights::GivenWeights;
use crate::transfer::multistep_rule::MultistepRule;
use fvi_core::{BdfOrder, ConvolutionWeights, DoubleDouble, ParameterError, max_or_nan};
use nalgebra::Complex;

/// Number of weights computed from the power series. Beyond these the contributions that the integral over
/// the cut leaves out are negligible: |ζ|⁻ⁿ with |ζ| ≥ 1.13 for BDF 6.
const HEAD: usize = 512;

/// Number of the last weights of the series that are compared with the integral over the cut.
const COMPARED: usize = 64;

/// Relative accuracy of the integral over the cut.
const TOLERANCE: f64 = 1e-18;

/// Lags from one exact evaluation of the parts of a weight to the next.
const BLOCK: usize = 16;

/// Largest difference between the integral and the last weights of the series, relative to these, and
/// smallest weight, relative to w₀, to which it is related.
const AGREEMENT: f64 = 64.0 * f64::EPSILON;
const NOTHING: f64 = 1e-5;

/// Number of points on the circle per weight.
const POINTS: usize = 16;

/// The first `count` weights of K(γ(z)/h) = Σ w_n zⁿ, or of K(γ(z)/h)/(1 − z) on increments.
///
/// The first weights are the coefficients of a power series computed to about 30 digits. The others are an
/// integral over the cut of K and its poles, without cancellation, so that even small weights are relatively
/// accurate (`principal_cut.rs`). With the trapezoidal rule, and where K has singularities elsewhere, which
/// shows in the last weights of the series, they are computed by a transform on a circle, with an error
/// relative to w₀.
///
/// # Errors
/// If h is not positive and finite, or a weight is not finite: then K is singular at some γ_p(z)/h, |z| < 1,
/// in the right half-plane.
pub fn multistep_weights(
    transfer: &TransferFunction,
    rule: impl Into<MultistepRule>,
    step_size: f64,
    on_increments: bool,
    count: usize,
) -> Result<Vec<f64>, ParameterError> {
    let rule = rule.into();
    if let Some(table) = transfer.table() {
        return given_weights(table, step_size, on_increments, count);
    }
    if let (Some(exponent), MultistepRule::Bdf(order)) = (transfer.exponent(), rule) {
        let weights = ConvolutionWeights::bdf(order, exponent, step_size)?;
        let weights = if on_increments { weights.on_increments() } else { weights };
        return Ok(weights.take(count).collect());
    }
    if !(step_size > 0.0 && step_size.is_finite()) {
        return Err(ParameterError {
            parameter: "step size",
            value: step_size,
            allowed: "positive and finite",
        });
    }
    if let Some(exponent) = transfer.exponent() {
        let first = transfer.series(&rule.series(step_size, 1)).to_numbers();
        return Ok(trapezoidal_power(exponent, first[0], on_increments, count));
    }
    if let Some(weights) = transfer.own_weights(rule, step_size, count) {
        return Ok(if on_increments { partial_sums(&weights) } else { weights });
    }
    let head = Head { transfer, rule, step_size, on_increments };
    let mut weights = head.weights(count.min(HEAD))?;
    if count > HEAD {
        let tail = match rule {
            MultistepRule::Bdf(order) if transfer.narrow().is_none() => {
                let cut = PrincipalCut::new(transfer, order, step_size, on_increments);
                tail_of_cut(&cut, HEAD - COMPARED, count)
            }
            _ => Vec::new(),
        };
        let first = weights[0].abs();
        let agrees = |(found, known): (&f64, &f64)| {
            (found - known).abs() <= AGREEMENT * known.abs().max(NOTHING * first)
        };
        // Beside singularities elsewhere the last weights of the series may agree because they vanish: those
        // of a delay of more steps. Then all of them are compared with a transform.
        let circle = if transfer.is_relaxation() { None } else { Some(head.circle(count)?) };
        let is_confirmed = |tail: &[f64]| match &circle {
            None => true,
            Some(circle) => {
                let known = &circle.weights[HEAD - COMPARED..];
                tail.iter().zip(known).all(|(found, known)| (found - known).abs() <= circle.bound())
            }
        };
        let agrees_there = tail.iter().zip(&weights[HEAD - COMPARED..]).all(agrees);
        if !tail.is_empty() && agrees_there && is_confirmed(&tail) {
            weights.extend_from_slice(&tail[COMPARED..]);
        } else {
            let circle = circle.map_or_else(|| head.circle(count), Ok)?;
            weights.extend_from_slice(&circle.weights[HEAD..]);
        }
        head.check(&weights)?;
    }
    Ok(weights)
}

/// The first weights of a kernel.
struct Head<'a> {
    transfer: &'a TransferFunction,
    rule: MultistepRule,
    step_size: f64,
    on_increments: bool,
}

impl Head<'_> {
    /// The first weights, from the power series where it can be trusted.
    ///
    /// The series of a quotient has the zeros of its divisor inside |z| < 1 as poles, up to rounding, also
    /// where the quotient has none: that of (s − 1)/log(s) grows like |ζ|⁻ⁿ from rounding, with γ(ζ)/h = 1.
    /// So the weights of symbols that are not rational are compared with a transform on a circle, and
    /// replaced by it where they begin to differ.
    fn weights(&self, count: usize) -> Result<Vec<f64>, ParameterError> {
        let series = self.transfer.series(&self.rule.series(self.step_size, count));
        let mut weights = if self.on_increments { series.sums() } else { series.to_numbers() };
        if self.transfer.is_rounded_formula() {
            // Of the same number of points for any count, so that the same weights are the same numbers.
            self.circle(HEAD)?.replace_lost(&mut weights);
        }
        self.check(&weights)?;
        Ok(weights)
    }

    /// Refuses weights that are no numbers, or grow.
    fn check(&self, weights: &[f64]) -> Result<(), ParameterError> {
        if let Some(&weight) = weights.iter().find(|weight| !weight.is_finite()) {
            return Err(self.refused(weight));
        }
        // If K(s) = O(s^μ), μ < 2, is analytic in the right half-plane, no weight is more than a few times
        // the largest |K(γ(z)/h)| on the circle, which the first weight may be far below: that of a delay.
        let largest = weights.iter().map(|weight| weight.abs()).fold(0.0, max_or_nan);
        let first = weights.first().map_or(0.0, |first| first.abs());
        if largest > GROWN * first && largest > GROWN * self.largest_on_the_right() {
            return Err(self.refused(largest));
        }
        Ok(())
    }

    /// The largest |K| on the circle, at places that are moved to the imaginary axis where they lie to the
    /// left of it, as with backward differentiation of order 3 and more.
    fn largest_on_the_right(&self) -> f64 {
        const PLACES: usize = 256;
        let size = |k: usize| {
            let angle = PI * (k as f64 + 0.5) / PLACES as f64;
            let z = Complex::new(libm::cos(angle), libm::sin(angle)) * (1.0 - 1e-3);
            let s = self.rule.symbol(z) / self.step_size;
            let size = self.transfer.value(Complex::new(s.re.clamp(0.0, f64::MAX), s.im)).norm();
            if self.on_increments { size / (Complex::new(1.0, 0.0) - z).norm() } else { size }
        };
        (0..PLACES).map(size).filter(|size| size.is_finite()).fold(0.0, max_or_nan)
    }

    /// The weights by a transform on a circle, of more points where weights still rise behind the last one,
    /// as those of a slow diffusion do.
    fn circle(&self, count: usize) -> Result<Circle, ParameterError> {
        const MOST: usize = 1 << 17;
        let function = |s| self.transfer.value(s);
        let growth = self.transfer.growth();
        let mut behind = f64::NAN;
        for longer in [1, 16, 256].into_iter().filter(|longer| *longer == 1 || longer * count <= MOST) {
            let wanted = longer * count;
            let mut circle =
                transform((&function, growth), self.rule, self.step_size, self.on_increments, wanted);
            if circle.weights.iter().all(|weight| weight.is_finite()) && circle.is_analytic() {
                circle.weights.truncate(count);
                return Ok(circle);
            }
            behind = circle.behind;
        }
        Err(self.refused(behind))
    }

    fn refused(&self, value: f64) -> ParameterError {
        let allowed = if self.rule.order() > 2 {
            "finite and bounded: K(s) must be analytic for Re s > 0, and with backward differentiation of order 3 and more \
             also bounded beside the imaginary axis to the left of it, where a delay e^(−sT) grows: take order 1 or 2 for it"
        } else {
            "finite and bounded: K(s) must be analytic for Re s > 0"
        };
        ParameterError { parameter: "weight of the kernel", value, allowed }
    }
}

/// The first of the given weights.
fn given_weights(
    table: &GivenWeights,
    step_size: f64,
    on_increments: bool,
    count: usize,
) -> Result<Vec<f64>, ParameterError> {
    table.check_step(step_size)?;
    let given = table.weights().get(..count).ok_or(ParameterError {
        parameter: "number of weights",
        value: table.weights().len() as f64,
        allowed: "at least as many as are wanted, one for each lag from 0; where the kernel has ended they are 0",
    })?;
    Ok(if on_increments { partial_sums(given) } else { given.to_vec() })
}

fn partial_sums(weights: &[f64]) -> Vec<f64> {
    let sums = weights.iter().scan(DoubleDouble::ZERO, |sum, &weight| {
        *sum = sum.add(DoubleDouble::exact(weight));
        Some(sum.to_f64())
    });
    sums.collect()
}

/// The derivatives of [`multistep_weights`] with respect to a parameter of K: the first from a power series,
/// with small relative errors, the others from a transform on a circle, with errors relative to the largest.
///
/// # Errors
/// If h is not positive and finite, or a weight is not finite.
pub fn derivative_weights(
    derivative: &TransferDerivative,
    rule: impl Into<MultistepRule>,
    step_size: f64,
    on_increments: bool,
    count: usize,
) -> Result<Vec<f64>, ParameterError> {
    let refused = |parameter, value, allowed| Err(ParameterError { parameter, value, allowed });
    if !(step_size > 0.0 && step_size.is_finite()) {
        return refused("step size", step_size, "positive and finite");
    }
    let rule = rule.into();
    if let (Some(exponent), MultistepRule::Bdf(order)) = (derivative.of_power(), rule) {
        return Ok(power_derivative(exponent, order, step_size, on_increments, count));
    }
    if let Some(time) = derivative.of_strength() {
        return Ok(relaxation_weights(time, rule, step_size, on_increments, count));
    }
    let series = derivative.series(&rule.series(step_size, count.min(HEAD)));
    let mut weights = if on_increments { series.sums() } else { series.to_numbers() };
    let function = |s| derivative.value(s);
    let circle = |count| transform((&function, derivative.growth()), rule, step_size, on_increments, count);
    if derivative.is_rounded_formula() {
        let circle = circle(HEAD);
        if circle.is_analytic() {
            circle.replace_lost(&mut weights);
        }
    }
    if count > HEAD {
        weights.extend_from_slice(&circle(count).weights[HEAD..]);
    }
    match weights.iter().find(|weight| !weight.is_finite()) {
        Some(&weight) => refused("derivative of a weight", weight, "finite"),
        None => Ok(weights),
    }
}

/// The weights of τs/(1 + τs), a quotient of polynomials in z for every multistep rule: with γ = G/H
///
/// ```text
/// τγ/h/(1 + τγ/h) = τG/(hH + τG) ,
/// ```
///
/// divided by 1 − z on increments, where G(1) = 0 makes G/(1 − z) a polynomial. Beyond the degree of the
/// numerator the weights have the recurrence of the denominator, every sixteenth state of which is computed
/// in double-double arithmetic.
fn relaxation_weights(
    time: f64,
    rule: MultistepRule,
    step_size: f64,
    on_increments: bool,
    count: usize,
) -> Vec<f64> {
    let (mut above, below) = match rule {
        // Sixty times the coefficients are integers.
        MultistepRule::Bdf(order) => {
            (order.coefficients().into_iter().map(|entry| (60.0 * entry).round()).collect(), vec![60.0])
        }
        MultistepRule::Trapezoidal => (vec![2.0, -2.0], vec![1.0, 1.0]),
    };
    let denominator: Vec<DoubleDouble> = (0..above.len())
        .map(|k| {
            let of_time = DoubleDouble::product(time, above[k]);
            below.get(k).map_or(of_time, |&entry| of_time.add(DoubleDouble::product(step_size, entry)))
        })
        .collect();
    if on_increments {
        let sums = above.iter().scan(0.0, |sum, entry| {
            *sum += entry;
            Some(*sum)
        });
        above = sums.collect();
    }
    let first = reciprocal(denominator[0]);
    let back: Vec<DoubleDouble> =
        denominator[1..].iter().map(|entry| entry.multiply(first).scale(-1.0)).collect();
    let above: Vec<DoubleDouble> = above.iter().map(|&entry| DoubleDouble::product(time, entry)).collect();
    // The last coefficients of 1/(hH + τG), and the last weights, the newest first.
    let (mut inverse, mut known) =
        (vec![DoubleDouble::ZERO; above.len()], vec![DoubleDouble::ZERO; back.len()]);
    let mut weights = Vec::with_capacity(count);
    for n in 0..=back.len() {
        let next = if n == 0 { first } else { dot(&back, &inverse) };
        inverse.rotate_right(1);
        inverse[0] = next;
        known.rotate_right(1);
        known[0] = dot(&above, &inverse);
        weights.push(known[0].to_f64());
    }
    weights.resize(count, 0.0);
    // From here on the weights have the recurrence of the reciprocal.
    let leap = leap(&back);
    let back: Vec<f64> = back.iter().map(|entry| entry.to_f64()).collect();
    for block in weights.get_mut(back.len() + 1..).into_iter().flat_map(|rest| rest.chunks_mut(LEAP)) {
        let mut near = [0.0; 6];
        near.iter_mut().zip(&known).for_each(|(near, known)| *near = known.to_f64());
        if near.iter().all(|number| number.abs() < f64::MIN_POSITIVE) {
            break;
        }
        for weight in block {
            *weight = back.iter().zip(&near).map(|(entry, known)| entry * known).sum();
            near.copy_within(..5, 1);
            near[0] = *weight;
        }
        known = leap.iter().map(|row| dot(row, &known)).collect();
    }
    weights
}

/// Terms of a recurrence that are computed in double precision from one state in double-double arithmetic.
const LEAP: usize = 16;

/// The matrix that takes a state of the recurrence y_n = Σ_k b_k y_{n−1−k}, the newest term first, over
/// [`LEAP`] terms.
fn leap(back: &[DoubleDouble]) -> Vec<Vec<DoubleDouble>> {
    let size = back.len();
    let unit =
        |row: usize| (0..size).map(move |k| if k == row { DoubleDouble::ONE } else { DoubleDouble::ZERO });
    let mut matrix: Vec<Vec<DoubleDouble>> =
        std::iter::once(back.to_vec()).chain((1..size).map(|row| unit(row - 1).collect())).collect();
    for _ in 0..LEAP.ilog2() {
        let column = |k: usize| matrix.iter().map(move |row| row[k]).collect::<Vec<_>>();
        let columns: Vec<Vec<DoubleDouble>> = (0..size).map(column).collect();
        matrix = matrix.iter().map(|row| columns.iter().map(|column| dot(row, column)).collect()).collect();
    }
    matrix
}

fn dot(a: &[DoubleDouble], b: &[DoubleDouble]) -> DoubleDouble {
    a.iter().zip(b).fold(DoubleDouble::ZERO, |sum, (a, b)| sum.add(a.multiply(*b)))
}

/// 1/x, by one step of Newton's method.
fn reciprocal(x: DoubleDouble) -> DoubleDouble {
    let near = DoubleDouble::exact(x.to_f64().recip());
    let rest = DoubleDouble::ONE.add(x.multiply(near).scale(-1.0));
    near.add(near.multiply(rest))
}

/// The derivatives by β of the weights of s^β, of y = (γ(z)/h)^β, or of y = (γ(z)/h)^β/(1 − z), by backward
/// differentiation: with γ = Σ γ_k z^k, P = γ/(1 − z) and c = 1 on increments, 0 otherwise,
///
/// ```text
/// γ y' = (β γ' + c P) y :       n γ_0 y_n = Σ_k [(β k − (n − k)) γ_k + c P_{k−1}] y_{n−k} ,
/// ```
///
/// and the derivative of that by β, in double-double arithmetic, both relative to y_0 = (γ_0/h)^β.
fn power_derivative(
    exponent: f64,
    order: BdfOrder,
    step_size: f64,
    on_increments: bool,
    count: usize,
) -> Vec<f64> {
    // Sixty times the coefficients are integers.
    let gamma: Vec<f64> = order.coefficients().into_iter().map(|entry| (60.0 * entry).round()).collect();
    let mut sum = 0.0;
    let quotient = gamma.iter().map(|entry| {
        sum += entry;
        if on_increments { sum } else { 0.0 }
    });
    let quotient: Vec<f64> = quotient.collect();
    let leading = gamma[0] / 60.0 / step_size;
    let (first, logarithm) = (libm::pow(leading, exponent), libm::log(leading));
    let mut known = vec![(DoubleDouble::ONE, DoubleDouble::ZERO)];
    let mut derivatives = Vec::with_capacity(count);
    for n in 1..=count {
        let (y, slope) = known[n - 1];
        derivatives.push(y.scale(logarithm).add(slope).scale(first).to_f64());
        let (mut next, mut next_slope) = (DoubleDouble::ZERO, DoubleDouble::ZERO);
        for k in 1..gamma.len().min(n + 1) {
            let (y, slope) = known[n - k];
            let back = (n - k) as f64;
            let own = DoubleDouble::product(exponent, k as f64).add(DoubleDouble::exact(-back));
            let share = own.scale(gamma[k]).add(DoubleDouble::exact(quotient[k - 1]));
            next = next.add(share.multiply(y));
            next_slope = next_slope.add(share.multiply(slope)).add(y.scale(k as f64 * gamma[k]));
        }
        let divisor = n as f64 * gamma[0];
        known.push((next.divide(divisor), next_slope.divide(divisor)));
    }
    derivatives
}

/// The weights of s^β by the trapezoidal rule, of (2/h)^β (1 − z)^a (1 + z)^(−β), a = β or β − 1: from
/// n w_n = −(a + β) w_{n−1} + (n − 2 − a + β) w_{n−2}, in double-double arithmetic.
fn trapezoidal_power(exponent: f64, first: f64, on_increments: bool, count: usize) -> Vec<f64> {
    let (sum, rest) = if on_increments {
        (DoubleDouble::exact(2.0 * exponent).add(DoubleDouble::exact(-1.0)), 1.0)
    } else {
        (DoubleDouble::exact(2.0 * exponent), 0.0)
    };
    let (mut before, mut now) = (DoubleDouble::ZERO, DoubleDouble::ONE);
    let mut weights = Vec::with_capacity(count);
    for n in 1..=count {
        weights.push(now.scale(first).to_f64());
        let size = n as f64;
        let next = before.scale(size - 2.0 + rest).add(now.multiply(sum).scale(-1.0)).divide(size);
        (before, now) = (now, next);
    }
    weights
}

/// Ratio to the first weight above which weights are taken for those of a kernel with growing parts.
const GROWN: f64 = 1e6;

/// Weights from `first` to `count` by the integral over the cut, each relative to itself.
///
/// At the beginning of a block of lags the parts are known to 30 digits; within it their powers are rounded
/// once, part by part, and their sum is compensated.
fn tail_of_cut(cut: &PrincipalCut<'_>, first: usize, count: usize) -> Vec<f64> {
    let parts = cut.parts(first, count, TOLERANCE);
    let mut terms: Vec<DoubleDouble> =
        parts.iter().map(|part| part.coefficient.multiply(power(part.decay, first))).collect();
    let powers: Vec<[f64; BLOCK]> =
        parts.iter().map(|part| std::array::from_fn(|lag| power(part.decay, lag).to_f64())).collect();
    let beyond: Vec<DoubleDouble> = parts.iter().map(|part| power(part.decay, BLOCK)).collect();
    let mut weights = Vec::with_capacity(count - first + BLOCK);
    // Slowest first: what has died out is dropped for good.
    let mut alive = parts.len();
    while weights.len() < count - first {
        while alive > 0 && terms[alive - 1].to_f64().abs() < f64::MIN_POSITIVE {
            alive -= 1;
        }
        let mut sums = [0.0; BLOCK];
        let mut errors = [0.0; BLOCK];
        for (term, powers) in terms[..alive].iter().zip(&powers).rev() {
            for ((sum, error), power) in sums.iter_mut().zip(&mut errors).zip(powers) {
                let added = term.to_f64() * power;
                let next = *sum + added;
                let part = next - *sum;
                *error += (*sum - (next - part)) + (added - part);
                *sum = next;
            }
        }
        weights.extend(sums.iter().zip(errors).map(|(sum, error)| sum + error));
        for (term, beyond) in terms[..alive].iter_mut().zip(&beyond) {
            *term = term.multiply(*beyond);
        }
    }
    weights.truncate(count - first);
    weights
}

/// xⁿ to about 30 digits, by squares.
fn power(x: DoubleDouble, n: usize) -> DoubleDouble {
    let (mut square, mut power) = (x, DoubleDouble::ONE);
    for bit in 0..usize::BITS - n.leading_zeros() {
        if n >> bit & 1 == 1 {
            power = power.multiply(square);
        }
        square = square.multiply(square);
    }
    power
}

/// Weights by a transform on a circle.
struct Circle {
    weights: Vec<f64>,
    /// The largest value on the circle.
    largest: f64,
    /// The largest coefficient of z⁻¹, z⁻², …, times powers of the radius.
    behind: f64,
    /// Factors 1 + z by which the series was divided.
    factors: i32,
}

impl Circle {
    /// Coefficients of negative powers of an analytic function, relative to its largest value: rounding.
    const NEGATIVE: f64 = 1e-12;
    /// Error of a weight relative to the largest value.
    const ROUNDING: f64 = 1e-12;

    /// True if the function has no singularity inside the circle, as far as its coefficients show.
    fn is_analytic(&self) -> bool {
        self.behind <= Self::NEGATIVE * self.largest
    }

    /// Bound of the error of a weight.
    fn bound(&self) -> f64 {
        Self::ROUNDING * self.largest * (self.weights.len() as f64).powi(self.factors)
    }

    /// Replaces weights of a series from the first one on that differs.
    fn replace_lost(&self, weights: &mut [f64]) {
        let bound = self.bound();
        let differs = |(found, known): (&f64, &f64)| {
            let apart = (found - known).abs();
            apart.is_nan() || apart > bound
        };
        if let Some(from) = weights.iter().zip(&self.weights).position(differs) {
            let known = self.weights.iter().skip(from);
            weights[from..].iter_mut().zip(known).for_each(|(weight, known)| *weight = *known);
        }
    }
}

/// Last coefficients of a transform that belong to negative powers.
const LAST: usize = 16;

/// All weights by Cauchy's integral on a circle inside |z| = 1.
///
/// With the trapezoidal rule a kernel that grows like s^μ is large near z = −1: the transformed function is
/// multiplied by (1 + z)^m, m ≥ μ, and the series is divided by that again.
fn transform(
    (function, growth): (&dyn Fn(Complex<f64>) -> Complex<f64>, f64),
    rule: MultistepRule,
    step_size: f64,
    on_increments: bool,
    count: usize,
) -> Circle {
    let length = (POINTS * count).next_power_of_two();
    // Aliasing from beyond the end is r^length of a weight.
    let radius = libm::exp(libm::log(1e-20) / length as f64);
    let factors = match rule {
        MultistepRule::Bdf(_) => 0,
        MultistepRule::Trapezoidal => growth.max(0.0).ceil() as i32,
    };
    let value = |k: usize| {
        let angle = -2.0 * PI * k as f64 / length as f64;
        let z = Complex::new(libm::cos(angle), libm::sin(angle)) * radius;
        let difference = Complex::new(1.0, 0.0) - z;
        let value = function(rule.symbol(z) / step_size) * (z + 1.0).powi(factors);
        if on_increments { value / difference } else { value }
    };
    let mut values: Vec<Complex<f64>> = (0..=length / 2).map(value).collect();
    // Real for real z, without rounding errors of the imaginary part.
    for end in [0, length / 2] {
        values[end].im = 0.0;
    }
    let largest = values.iter().map(|value| value.norm()).fold(0.0, max_or_nan);
    let mut weights = vec![0.0; length];
    let (_, inverse) = real_transforms(length);
    if inverse.process(&mut values, &mut weights).is_err() {
        return Circle { weights: vec![f64::NAN; count], largest, behind: f64::NAN, factors };
    }
    let behind = weights[length - LAST..].iter().map(|weight| weight.abs() / length as f64);
    let behind = behind.fold(0.0, max_or_nan);
    let scaled =
        |(n, weight): (usize, &f64)| weight / length as f64 * libm::exp(-(n as f64) * libm::log(radius));
    let mut weights: Vec<f64> = weights.iter().enumerate().take(count).map(scaled).collect();
    for _ in 0..factors {
        let mut before = DoubleDouble::ZERO;
        for weight in &mut weights {
            before = DoubleDouble::exact(*weight).add(before.scale(-1.0));
            *weight = before.to_f64();
        }
    }
    Circle { weights, largest, behind, factors }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sums::max_or_nan;
    use fvi_core::BdfOrder;

    #[test]
    fn the_weights_of_a_relaxation_are_a_geometric_sequence() {
        let count = 100_000;
        for (time, step) in [(100.0, 0.01), (0.3, 0.01), (1.0, 1.0), (0.003, 0.01)] {
            let one = MultistepRule::Bdf(BdfOrder::GRUNWALD_LETNIKOV);
            let [values, rises] =
                [false, true].map(|on_rises| relaxation_weights(time, one, step, on_rises, count));
            assert!((values[0] * (step + time) / time - 1.0).abs() < 1e-15);
            for n in 1..count {
                let exponent = -(n as f64) * (step / time).ln_1p();
                let error = 1e-14 + 2e-16 * exponent.abs();
                let (value, rise) =
                    (exponent.exp() * step / (step + time), exponent.exp() * time / (step + time));
                if value > 1e-300 {
                    assert!((values[n] / value + 1.0).abs() < error, "τ = {time}, n = {n}: {}", values[n]);
                    assert!((rises[n] / rise - 1.0).abs() < error, "τ = {time}, n = {n}: {}", rises[n]);
                }
            }
            for rule in [1, 2, 3, 4, 5, 6].map(|order| MultistepRule::Bdf(BdfOrder::new(order).unwrap())) {
                let [values, rises] =
                    [false, true].map(|on_rises| relaxation_weights(time, rule, step, on_rises, 3000));
                let sums = partial_sums(&values);
                for n in 0..3000 {
                    let error = (sums[n] - rises[n]).abs();
                    assert!(error < 1e-13, "{rule:?}, τ = {time}, n = {n}: {} {}", sums[n], rises[n]);
                }
            }
        }
    }

    fn forms() -> Vec<TransferFunction> {
        vec![
            TransferFunction::tempered(0.5, 0.3).unwrap(),
            TransferFunction::tempered(1.5, 2.0).unwrap(),
            TransferFunction::maxwell(0.6, 0.0, 1.5).unwrap(),
            TransferFunction::maxwell(0.9, 0.4, 0.5).unwrap(),
            TransferFunction::prony(&[1.0, 0.7], &[1.0, 0.1]).unwrap(),
            TransferFunction::havriliak_negami(0.7, 0.5, 1.0).unwrap(),
            TransferFunction::havriliak_negami(1.0, 0.5, 2.0).unwrap(),
        ]
    }

    #[test]
    fn orders_next_to_one_take_no_longer_than_others() {
        // At order 1 the form becomes τs/(1 + τs), whose weights are an exponential.
        let (rule, count, step_size) = (BdfOrder::new(2).unwrap(), 900, 0.02);
        let weights =
            |transfer: &TransferFunction| multistep_weights(transfer, rule, step_size, false, count).unwrap();
        let limit = weights(&TransferFunction::prony(&[1.0], &[0.5]).unwrap());
        for beside in [1e-5, 1e-9, 1e-13] {
            let found = weights(&TransferFunction::maxwell(1.0 - beside, 0.0, 0.5).unwrap());
            for (found, limit) in found.iter().zip(&limit) {
                assert!((found - limit).abs() < 20.0 * beside + 1e-13, "{beside}: {found:e} {limit:e}");
            }
        }
    }

    #[test]
    fn the_integral_over_the_cut_goes_on_where_the_series_ends() {
        for transfer in forms() {
            for p in 1..=6 {
                let order = BdfOrder::new(p).unwrap();
                for on_increments in [false, true] {
                    // For longer steps the cut of (s + 2)^β and the pole at −10 have no real preimage.
                    for step_size in [1e-3, 0.005, 0.02] {
                        let (first, length) = (HEAD - COMPARED, HEAD + 100);
                        let series = transfer.series(&MultistepRule::from(order).series(step_size, length));
                        let known = if on_increments { series.sums() } else { series.to_numbers() };
                        let cut = PrincipalCut::new(&transfer, order, step_size, on_increments);
                        let tail = tail_of_cut(&cut, first, length);
                        for (n, (found, known)) in (first..).zip(tail.iter().zip(&known[first..])) {
                            let floor = 1e-19 * series.to_numbers()[0].abs();
                            assert!(
                                (found - known).abs() <= 2.0 * f64::EPSILON * known.abs() + floor,
                                "{transfer}, BDF {p}, h = {step_size}, {on_increments}, {n}: {found:e} {known:e}"
                            );
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn a_transform_on_a_circle_gives_the_weights_relative_to_the_first() {
        for transfer in forms() {
            for rule in [MultistepRule::Bdf(BdfOrder::new(2).unwrap()), MultistepRule::Trapezoidal] {
                let series = transfer.series(&rule.series(0.05, 300)).to_numbers();
                let function = |s| transfer.value(s);
                let found = transform((&function, transfer.growth()), rule, 0.05, false, 300).weights;
                let error = series.iter().zip(&found).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan);
                // The weights of the trapezoidal rule do not decay: the error is relative to their sum.
                let size = match rule {
                    MultistepRule::Bdf(_) => 2.0 * series[0],
                    MultistepRule::Trapezoidal => series.iter().map(|weight| weight.abs()).sum(),
                };
                assert!(error <= 4.0 * f64::EPSILON * size, "{transfer}, {rule}: {error:e}");
            }
        }
    }

    #[test]
    fn the_weights_of_a_power_by_the_trapezoidal_rule_are_those_of_its_series() {
        for exponent in [-0.5, 0.0, 0.3, 1.0, 1.7] {
            let power = TransferFunction::power(exponent).unwrap();
            let series = power.series(&MultistepRule::Trapezoidal.series(0.1, 600));
            for (on_increments, known) in [(false, series.to_numbers()), (true, series.sums())] {
                let found = multistep_weights(&power, MultistepRule::Trapezoidal, 0.1, on_increments, 600);
                for (n, (found, known)) in found.unwrap().iter().zip(known).enumerate() {
                    let error = (found - known).abs();
                    assert!(error <= 4.0 * f64::EPSILON * known.abs() + 1e-25, "{exponent}, {n}: {error:e}");
                }
            }
        }
    }

    #[test]
    fn the_weights_of_a_power_are_those_of_the_core() {
        let order = BdfOrder::new(3).unwrap();
        let power = TransferFunction::power(0.7).unwrap();
        let found = multistep_weights(&power, order, 0.1, false, 20).unwrap();
        let series = power.series(&MultistepRule::from(order).series(0.1, 20)).to_numbers();
        for (found, series) in found.iter().zip(series) {
            assert!((found - series).abs() <= 2.0 * f64::EPSILON * found.abs());
        }
    }

    #[test]
    fn derivatives_of_weights_are_differences_of_weights() {
        let order = BdfOrder::new(2).unwrap();
        let (at, h, count) = (0.7, 1e-3, HEAD + 300);
        for on_increments in [false, true] {
            let power = |x: f64| TransferFunction::power(x).unwrap();
            let derivative = TransferDerivative::new(&power(at), "order", 0).unwrap();
            let found = derivative_weights(&derivative, order, 0.05, on_increments, count).unwrap();
            let of = |x: f64| multistep_weights(&power(x), order, 0.05, on_increments, count).unwrap();
            let [one, other, far, away] = [at + h, at - h, at + 2.0 * h, at - 2.0 * h].map(of);
            for n in 0..count {
                let difference = (8.0 * (one[n] - other[n]) - (far[n] - away[n])) / (12.0 * h);
                let error = (found[n] - difference).abs();
                assert!(error < 1e-10 * found[0].abs(), "{n}: {} {difference}", found[n]);
            }
        }
    }

    #[test]
    fn derivatives_by_strengths_are_those_of_their_series_and_of_the_weights() {
        let rules = (1..=6).map(|order| MultistepRule::Bdf(BdfOrder::new(order).unwrap()));
        for rule in rules.chain([MultistepRule::Trapezoidal]) {
            for time in [2e-4, 0.05, 30.0] {
                let kernel = TransferFunction::prony(&[1.0], &[time]).unwrap();
                let derivative = TransferDerivative::new(&kernel, "strengths", 0).unwrap();
                let series = derivative.series(&rule.series(0.03, HEAD));
                for (on_increments, known) in [(false, series.to_numbers()), (true, series.sums())] {
                    let count = HEAD + 4000;
                    let found = derivative_weights(&derivative, rule, 0.03, on_increments, count).unwrap();
                    // K is linear in its strength.
                    let whole = multistep_weights(&kernel, rule, 0.03, on_increments, count).unwrap();
                    let largest = known[0].abs();
                    for n in 0..count {
                        let known = if n < HEAD { known[n] } else { whole[n] };
                        let error = (found[n] - known).abs();
                        assert!(error <= 1e-14 * largest, "{rule}, {time}: {n}: {} {known}", found[n]);
                    }
                }
            }
        }
    }

    #[test]
    fn derivatives_of_powers_are_those_of_their_series() {
        for (order, exponent) in [(1, 0.6), (2, 1.3), (3, 0.0), (4, 1.0), (5, 0.2), (6, 1.9)] {
            let rule = MultistepRule::Bdf(BdfOrder::new(order).unwrap());
            let power = TransferFunction::power(exponent).unwrap();
            let derivative = TransferDerivative::new(&power, "order", 0).unwrap();
            let series = derivative.series(&rule.series(0.03, HEAD));
            for (on_increments, known) in [(false, series.to_numbers()), (true, series.sums())] {
                let found = derivative_weights(&derivative, rule, 0.03, on_increments, HEAD).unwrap();
                let weights = multistep_weights(&power, rule, 0.03, on_increments, HEAD).unwrap();
                for n in 0..HEAD {
                    let size = known[n].abs() + weights[n].abs();
                    let error = (found[n] - known[n]).abs();
                    assert!(error <= 1e-14 * size, "BDF {order}, {exponent}: {n}: {} {}", found[n], known[n]);
                }
            }
        }
    }
}
