//! Tables of exponentials in complex-conjugate pairs, for kernels that oscillate: rational approximation of
//! their generating function.
//!
//! Of the weights behind a head of n₀ the generating function, in ζ = 1/z,
//!
//! ```text
//! F(ζ) = Σ_{n ≥ n₀} w_n ζ^{−(n−n₀)−1} ≈ Σ_j c_j/(ζ − ρ_j) ,        w_n ≈ Σ_j c_j ρ_j^{n−n₀} ,
//! ```
//!
//! is approximated on the circle |ζ| = e^{1/N}, N the horizon, by the AAA algorithm: a quotient of
//! barycentric sums with support points where the error was largest and coefficients of least squares.
//! Samples lie between neighbouring support points, so that they crowd where poles are near. Support points
//! come with their conjugates, so that all equations are real. The poles are eigenvalues, those outside of
//! the circle are left out, and the residues follow from least squares anew. What the table is worth is
//! measured weight by weight.
//!
//! Rational kernels with simple poles have their exponentials in closed form (`closed_pairs.rs`).
//!
//! Sources: \[NST18\]; \[DNT24\] for samples between support points.

use crate::ComplexExponentials;
use crate::dense::{SingularValues, eigenvalues, triangle};
use crate::exponentials::closed_pairs::ClosedPairs;
use crate::exponentials::exponential_table::{ENDLESS, ExponentialKernelError, check_range};
use crate::quadrature::multistep_weights::multistep_weights;
use crate::rational::{Values, real_rows};
use crate::transfer::TransferFunction;
use crate::transfer::multistep_rule::MultistepRule;
use fvi_core::{ParameterError, max_or_nan, min_or_nan};
use nalgebra::{Complex, DMatrix, DVector};
use std::f64::consts::PI;

/// Lengths n₀ of the head that are tried. A damping term compares the first two weights with its own.
const HEADS: [usize; 6] = [2, 9, 17, 33, 65, 129];

/// Most support points in the upper half-plane, about as many as there are pairs.
const MOST: usize = 64;

/// Samples between two support points, and fewest of all.
const BETWEEN: usize = 3;
const FEWEST: usize = 16;

/// Part of the error allowed that is left to the approximation on the circle.
const PART: f64 = 0.3;

/// Rounding of the function, relative to itself and to the largest weight: what is left of it is not
/// approximated.
const ROUNDING: f64 = 32.0 * f64::EPSILON;

/// Multiply–adds of a pair, where a weight of the head is one.
const COST: usize = 6;

/// Weights that a table in closed form is compared with: those of the power series.
const COMPARED: usize = 512;

/// Sums of a pair over all lags below this part of the error allowed are nothing.
const NEGLIGIBLE: f64 = 0.1;

/// How far a table is from the weights, at lags up to its horizon; at most so far, if it is in closed form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Miss {
    /// max |w_n − w̃_n|/max |w_n|
    pub largest: f64,
    /// Σ |w_n − w̃_n|/Σ |w_n|
    pub sum: f64,
}

/// A table of exponentials in pairs for the weights of K(γ(z)/h), or of K(γ(z)/h)/(1 − z) on increments, and
/// how far it is from them: each weight up to lag `horizon` is within `tolerance` max |w_n|, all of them
/// together within `tolerance` Σ |w_n|.
///
/// It is for kernels without a cut that begins at s = 0: rational and other meromorphic K, delays, powers
/// like ((1 + s)/(1 + s/10))^½. The weights of others fall off like powers, which takes many exponentials.
/// Without end are tables of rational kernels with simple poles, and of those whose weights fade within 2¹⁵
/// lags.
///
/// # Errors
/// If a parameter is out of range, there are no such weights, or no table reaches the tolerance.
pub fn complex_exponentials(
    transfer: &TransferFunction,
    rule: impl Into<MultistepRule>,
    on_increments: bool,
    step_size: f64,
    horizon: usize,
    tolerance: f64,
) -> Result<(ComplexExponentials, Miss), ExponentialKernelError> {
    check_range(horizon as u64, tolerance)?;
    let rule = rule.into();
    /// Error of exponentials in closed form up to which only rounding is in the way of a smaller one.
    const OF_ROUNDING: f64 = 1e-8;
    let (made, mut reached) = closed(transfer, rule, on_increments, step_size, horizon, tolerance)?;
    if let Some(made) = made {
        return Ok(made);
    }
    let asked = horizon;
    let exact = match asked {
        ENDLESS => {
            faded(transfer, rule, on_increments, step_size, tolerance).map_err(|error| match reached {
                reached if reached <= OF_ROUNDING => {
                    ExponentialKernelError::ToleranceMissed { tolerance, reached }
                }
                _ => error,
            })?
        }
        _ => multistep_weights(transfer, rule, step_size, on_increments, horizon + 1)?,
    };
    let horizon = exact.len() - 1;
    let largest = exact.iter().map(|weight| weight.abs()).fold(0.0, max_or_nan);
    let radius = libm::exp(1.0 / horizon as f64);
    let mut best: Option<(usize, ComplexExponentials, Miss)> = None;
    for length in HEADS.into_iter().take_while(|&length| length <= horizon) {
        if best.as_ref().is_some_and(|(least, ..)| *least <= length) {
            break;
        }
        let head = &exact[..length];
        let function = |angle: f64| {
            let place = on_circle(radius, angle);
            let z = place.inv();
            let symbol = transfer.symbol(rule, step_size, z);
            let symbol = if on_increments { symbol / (Complex::new(1.0, 0.0) - z) } else { symbol };
            let near = head.iter().rev().fold(Complex::ZERO, |sum, weight| sum * z + weight);
            (symbol - near) * place.powu(length as u32 - 1)
        };
        let allowed = PART * tolerance * largest;
        let is_nothing = exact[length..].iter().all(|weight| weight.abs() <= allowed / horizon as f64);
        let pairs =
            if is_nothing { Some(Vec::new()) } else { approximated(&function, radius, allowed, largest) };
        let Some(mut pairs) = pairs else { continue };
        // Poles that rounding has left in the approximation.
        pairs.retain(|&[re, im, c_re, c_im]| {
            let lags = (1.0 / (1.0 - libm::hypot(re, im)).max(0.0)).min(horizon as f64);
            libm::hypot(c_re, c_im) * lags > NEGLIGIBLE * allowed
        });
        let cost = length + COST * pairs.len();
        let mut table = ComplexExponentials { head: head.to_vec(), pairs, horizon };
        let miss = missed(&table, &exact);
        // Behind the lag at which the weights have faded nothing may be left of the exponentials either.
        let left = if asked == ENDLESS { left_behind(&table) / largest } else { 0.0 };
        table.horizon = asked;
        let error = miss.largest.max(miss.sum) + left;
        if error <= tolerance && best.as_ref().is_none_or(|(least, ..)| cost < *least) {
            best = Some((cost, table, miss));
        } else if error.is_finite() {
            reached = reached.min(error);
        }
    }
    match best {
        Some((_, table, miss)) => Ok((table, miss)),
        None => Err(ExponentialKernelError::ToleranceMissed { tolerance, reached }),
    }
}

/// The weights up to a lag behind which they are nothing: they fall by 1/STEEP within a factor of two of the
/// lag, to less than 1/STEEP of the tolerance, as exponentials do and powers of a lag do not.
fn faded(
    transfer: &TransferFunction,
    rule: MultistepRule,
    on_increments: bool,
    step_size: f64,
    tolerance: f64,
) -> Result<Vec<f64>, ExponentialKernelError> {
    const STEEP: f64 = 1e3;
    for count in [1 << 9, 1 << 12, 1 << 15] {
        let exact = multistep_weights(transfer, rule, step_size, on_increments, count)?;
        let size =
            |from: usize, to: usize| exact[from..to].iter().map(|weight| weight.abs()).fold(0.0, max_or_nan);
        let (all, before, last) = (size(0, count), size(count / 8, count / 4), size(count / 2, count));
        // Rounding errors of what has faded long before do not fall.
        let allowed = (1e-13 * all).max(before / STEEP);
        if last <= allowed && last <= tolerance * all / STEEP {
            return Ok(exact);
        }
    }
    let allowed = "a number of lags: only rational kernels with simple poles in Re s < 0, and those whose weights have faded after 2^15 \
                   lags, have exponentials without end";
    Err(ParameterError { parameter: "horizon", value: f64::INFINITY, allowed }.into())
}

/// The table of a rational kernel with simple poles by backward differentiation: its own exponentials,
/// without those that are nothing after the head; and the smallest error of one. `None` for other kernels,
/// and where rounding is more than the tolerance.
///
/// The first weights are compared with exact ones. What has been left out falls off, and a pair that is
/// rounded is wrong by at most ε n |c ρⁿ| at lag n, so that the rest is bounded by sums of these.
fn closed(
    transfer: &TransferFunction,
    rule: MultistepRule,
    on_increments: bool,
    step_size: f64,
    horizon: usize,
    tolerance: f64,
) -> Result<(Option<(ComplexExponentials, Miss)>, f64), ExponentialKernelError> {
    let none = Ok((None, f64::INFINITY));
    let MultistepRule::Bdf(order) = rule else { return none };
    let Some(fractions) = transfer.fractions() else { return none };
    let Some(all) = ClosedPairs::of(&fractions, order, on_increments, step_size) else { return none };
    let count = horizon.saturating_add(1).min(COMPARED);
    let exact = multistep_weights(transfer, rule, step_size, on_increments, count)?;
    let largest = exact.iter().map(|weight| weight.abs()).fold(0.0, max_or_nan);
    let whole: f64 = exact.iter().map(|weight| weight.abs()).sum();
    let mut best: Option<(usize, ComplexExponentials, Miss)> = None;
    let mut reached = f64::INFINITY;
    for length in HEADS.into_iter().filter(|&length| length >= all.first && length <= horizon) {
        // The sums over all lags behind the head, and behind the compared ones, least first.
        let mut parts: Vec<_> = all.pairs.iter().map(|pair| (behind(*pair, length), *pair)).collect();
        parts.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut sum, mut bound) = (0.0, 0.0);
        let mut pairs = Vec::new();
        for (part, [rho, c]) in parts {
            sum += part;
            if sum <= PART * tolerance * largest {
                bound += behind([rho, c], count);
            } else {
                let first = c * rho.powu(length as u32);
                pairs.push([rho.re, rho.im, first.re, first.im]);
                bound += f64::EPSILON * behind([rho, c], count) * (lags(rho) + count as f64);
            }
        }
        pairs.sort_by(|[re, im, ..], [other, more, ..]| {
            libm::hypot(*other, *more).total_cmp(&libm::hypot(*re, *im))
        });
        let cost = length + COST * pairs.len();
        let table = ComplexExponentials { head: exact[..length].to_vec(), pairs, horizon };
        let compared = missed(&table, &exact);
        let miss = if count > horizon {
            compared
        } else {
            Miss { largest: compared.largest + bound / largest, sum: compared.sum + bound / whole }
        };
        let is_within = miss.largest <= tolerance && miss.sum <= tolerance;
        reached = min_or_nan(reached, max_or_nan(miss.largest, miss.sum));
        if is_within && best.as_ref().is_none_or(|(least, ..)| cost < *least) {
            best = Some((cost, table, miss));
        }
    }
    Ok((best.map(|(_, table, miss)| (table, miss)), reached))
}

/// What the exponentials of a table sum to behind its horizon, at most.
fn left_behind(table: &ComplexExponentials) -> f64 {
    let lags = table.horizon + 1 - table.head.len();
    let of_pair = |&[re, im, c_re, c_im]: &[f64; 4]| {
        let (rho, c) = (Complex::new(re, im), Complex::new(c_re, c_im));
        if rho.norm() < 1.0 { behind([rho, c], lags) } else { f64::INFINITY }
    };
    table.pairs.iter().map(of_pair).sum()
}

/// Σ_{n ≥ first} |c ρⁿ|
fn behind([rho, c]: [Complex<f64>; 2], first: usize) -> f64 {
    c.norm() * libm::pow(rho.norm(), first as f64) * lags(rho)
}

/// Σ_{n ≥ 0} |ρⁿ|
fn lags(rho: Complex<f64>) -> f64 {
    1.0 / (1.0 - rho.norm())
}

/// Every weight against the exact one.
fn missed(table: &ComplexExponentials, exact: &[f64]) -> Miss {
    let (mut most, mut largest, mut sum, mut whole) = (0.0_f64, 0.0_f64, 0.0, 0.0);
    for (found, weight) in table.head.iter().copied().chain(table.tail()).zip(exact) {
        let error = (found - weight).abs();
        // A number that is none stays one.
        most = if error > most || error.is_nan() { error } else { most };
        largest = largest.max(weight.abs());
        sum += error;
        whole += weight.abs();
    }
    let relative = |error: f64, size: f64| if error == 0.0 { 0.0 } else { error / size };
    Miss { largest: relative(most, largest), sum: relative(sum, whole) }
}

fn on_circle(radius: f64, angle: f64) -> Complex<f64> {
    // The ends are real.
    if angle == PI {
        Complex::new(-radius, 0.0)
    } else {
        Complex::new(libm::cos(angle), libm::sin(angle)) * radius
    }
}

/// A point of a circle in the upper half-plane, the value there, and its barycentric coefficient; unless it
/// is real, it stands for its conjugate too.
#[derive(Clone, Copy)]
struct Point {
    angle: f64,
    place: Complex<f64>,
    value: Complex<f64>,
    coefficient: Complex<f64>,
}

impl Point {
    fn new(radius: f64, angle: f64, function: &impl Fn(f64) -> Complex<f64>) -> Self {
        let (place, value) = (on_circle(radius, angle), function(angle));
        let value = if place.im == 0.0 { Complex::new(value.re, 0.0) } else { value };
        Self { angle, place, value, coefficient: Complex::ZERO }
    }

    fn is_real(&self) -> bool {
        self.place.im == 0.0
    }

    /// Σ g(point) over the point and its conjugate.
    fn with_conjugate(&self, of: impl Fn(Self) -> Complex<f64>) -> Complex<f64> {
        let conjugate = Self {
            angle: -self.angle,
            place: self.place.conj(),
            value: self.value.conj(),
            coefficient: self.coefficient.conj(),
        };
        if self.is_real() { of(*self) } else { of(*self) + of(conjugate) }
    }
}

/// ρ and c of a sum of Σ c_j/(ζ − ρ_j) that is within `allowed` of a function on a circle, as far as rounding
/// lets it; `None` where the function has no values.
fn approximated(
    function: &impl Fn(f64) -> Complex<f64>,
    radius: f64,
    allowed: f64,
    largest: f64,
) -> Option<Vec<[f64; 4]>> {
    let point = |angle: f64| Point::new(radius, angle, function);
    let mut support = vec![point(0.0), point(PI)];
    loop {
        let between = BETWEEN.max(FEWEST.saturating_sub(support.len()));
        let samples: Vec<Point> = support
            .windows(2)
            .flat_map(|ends| {
                let (from, length) = (ends[0].angle, ends[1].angle - ends[0].angle);
                (1..=between).map(move |k| from + length * k as f64 / (between + 1) as f64)
            })
            .map(point)
            .collect();
        if !support.iter().chain(&samples).all(|point| point.value.is_finite()) {
            return None;
        }
        choose_coefficients(&mut support, &samples)?;
        let error = |sample: &Point| {
            let sum = |of: fn(Point) -> Complex<f64>| -> Complex<f64> {
                let term =
                    |point: &Point| point.with_conjugate(|point| of(point) / (sample.place - point.place));
                support.iter().map(term).sum()
            };
            let quotient = sum(|point| point.coefficient * point.value) / sum(|point| point.coefficient);
            let error = (quotient - sample.value).norm();
            let excess = error - allowed.max(ROUNDING * (sample.value.norm() + largest));
            if excess.is_nan() { f64::INFINITY } else { excess }
        };
        let errors: Vec<f64> = samples.iter().map(error).collect();
        let worst = (0..samples.len()).max_by(|&a, &b| errors[a].total_cmp(&errors[b]))?;
        if errors[worst] <= 0.0 || support.len() >= MOST {
            let poles = poles(&support, radius)?;
            return residues(&poles, &[support, samples].concat());
        }
        let place = support.partition_point(|point| point.angle < samples[worst].angle);
        support.insert(place, samples[worst]);
    }
}

/// Coefficients w of norm 1 for which Σ_j w_j (f(ζ) − f_j)/(ζ − ζ_j) is least at the samples; `None` where
/// they are not found.
fn choose_coefficients(support: &mut [Point], samples: &[Point]) -> Option<()> {
    let mut columns = Vec::new();
    for point in &*support {
        let quotient =
            |sample: &Point, point: Point| (sample.value - point.value) / (sample.place - point.place);
        for direction in [Complex::new(1.0, 0.0), Complex::new(0.0, 1.0)]
            .into_iter()
            .take(1 + usize::from(!point.is_real()))
        {
            let turned = Point { coefficient: direction, ..*point };
            columns.extend(real_rows(
                samples
                    .iter()
                    .map(|sample| turned.with_conjugate(|point| point.coefficient * quotient(sample, point))),
            ));
        }
    }
    let rows = 2 * samples.len();
    let matrix = DMatrix::from_vec(rows, columns.len() / rows, columns);
    let (triangle, _) = triangle(matrix, &DVector::zeros(rows));
    let values = SingularValues::of(triangle)?;
    let least: Vec<f64> = values.v_t.row(values.v_t.nrows() - 1).iter().copied().collect();
    let mut place = 0;
    for point in support {
        let im = if point.is_real() { 0.0 } else { least[place + 1] };
        point.coefficient = Complex::new(least[place], im);
        place += 1 + usize::from(!point.is_real());
    }
    Some(())
}

/// Zeros of Σ_j w_j/(ζ − ζ_j) in a circle, those of the upper half-plane and the real ones: with D = diag ζ_j
/// they are the eigenvalues of D − 1 wᵀD/wᵀ1 but for a zero. In the basis (1, 1)/√2, (i, −i)/√2 of a pair
/// the matrix is real.
fn poles(support: &[Point], radius: f64) -> Option<Vec<Complex<f64>>> {
    let count: usize = support.iter().map(|point| 1 + usize::from(!point.is_real())).sum();
    let (mut matrix, mut ones, mut row) =
        (DMatrix::zeros(count, count), DVector::zeros(count), DVector::zeros(count));
    let mut k = 0;
    for point in support {
        let (place, w) = (point.place, point.coefficient);
        matrix[(k, k)] = place.re;
        if point.is_real() {
            (ones[k], row[k]) = (1.0, w.re);
            k += 1;
            continue;
        }
        let root = std::f64::consts::SQRT_2;
        (matrix[(k + 1, k + 1)], matrix[(k, k + 1)], matrix[(k + 1, k)]) = (place.re, -place.im, place.im);
        (ones[k], row[k], row[k + 1]) = (root, root * w.re, -root * w.im);
        k += 2;
    }
    let behind = matrix.tr_mul(&row) / row.dot(&ones);
    matrix -= ones * behind.transpose();
    let mut zeros = eigenvalues(matrix)?;
    let least = (0..zeros.len()).min_by(|&a, &b| zeros[a].norm().total_cmp(&zeros[b].norm()))?;
    zeros.swap_remove(least);
    zeros.retain(|zero| zero.im >= 0.0 && zero.norm() < radius);
    // Slowest first, whatever the order of the eigenvalues.
    zeros.sort_by(|a, b| b.norm().total_cmp(&a.norm()).then(a.re.total_cmp(&b.re)));
    Some(zeros)
}

/// ρ and c of the sum Σ c_j/(ζ − ρ_j) with these poles and their conjugates that is next to the values.
fn residues(poles: &[Complex<f64>], points: &[Point]) -> Option<Vec<[f64; 4]>> {
    let (places, values): (Vec<_>, Vec<_>) = points.iter().map(|point| (point.place, point.value)).unzip();
    let weights = vec![1.0; points.len()];
    let found = Values { places: &places, values: &values, weights: &weights }.residues(poles)?;
    // Of a pair c ρⁿ stands for twice its real part.
    let pair = |(pole, residue): (&Complex<f64>, Complex<f64>)| {
        let factor = if pole.im == 0.0 { 1.0 } else { 2.0 };
        [pole.re, pole.im, factor * residue.re, factor * residue.im]
    };
    let pairs: Vec<[f64; 4]> = poles.iter().zip(found).map(pair).collect();
    pairs.as_flattened().iter().all(|number| number.is_finite()).then_some(pairs)
}
