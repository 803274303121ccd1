//! Tables for the exponential-sum memory: the weights of convolution quadrature as a head and decaying
//! exponentials.
//!
//! The weights are the Taylor coefficients of (γ_p(z)/h)^β. Cauchy's contour, collapsed onto the cut [1, ∞)
//! of that function, gives with z = 1 + m
//!
//! ```text
//! w_n = −(sin πβ / π) h^{−β} ∫₀^∞ |γ_p(1+m)|^β (1+m)^{−n−1} dm ,
//! ```
//!
//! up to what the other roots ζ of γ_p add, which falls like |ζ|^{−n} and is left to the head. The integral
//! over y = ln m by the trapezoidal rule is a sum of exponentials with rates s = ln(1+m); for p = 1 it is a
//! Beta function, whose poles bound the error of the rule at every n. The rule needs many nodes of tiny
//! rates, and some of large ones that die out just behind the head: both groups are replaced by the Gauss
//! rules of their own discrete measures. How much each group can be compressed, and how short the head may
//! be, is found by measuring the error of the weights and not by a bound.
//!
//! For a memory on increments the kernel is divided by 1 − z = −m: the same rates, other coefficients.
//!
//! Sources: \[HJO\] eq. 18–22, 30; the Gauss rule of a discrete measure by Lanczos' algorithm,
//! \[GolubWelsch69\], \[Gautschi04\]; quadrature for sums of exponentials, \[BeylkinMonzon10\], \[McLean18\].

use crate::numerics::aligned::Aligned;
use fvi_core::{BdfOrder, ConvolutionWeights, ExponentialTable, ParameterError, Real};
use fvi_fft::baseline::CompensatedSum;
use nalgebra::DMatrix;
use std::f64::consts::PI;

/// Convolution-quadrature weights as a head and decaying exponentials.
///
/// ```text
/// w_n = head[n]                                for n < n₀ ,
/// w_n ≈ Σ_j coefficient_j e^{−rate_j n}         for n₀ ≤ n ≤ horizon
/// ```
///
/// Rates are per step, in ascending order; head and coefficients have the unit of a weight, time^(−β).
#[derive(Clone, Debug, PartialEq)]
pub struct ExponentialKernel {
    head: Vec<f64>,
    exponentials: Vec<Exponential>,
    horizon: usize,
    tolerance: f64,
}

/// One term, coefficient · e^{−rate n}.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exponential {
    /// Decay per step.
    pub rate: f64,
    /// Value continued to n = 0.
    pub coefficient: f64,
}

/// Why no table was made.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum ExponentialKernelError {
    /// A parameter is not allowed.
    Parameter(ParameterError),
    /// No head of acceptable length brings the weights to the tolerance.
    ToleranceMissed {
        /// The tolerance that was asked for.
        tolerance: f64,
        /// Smallest error reached.
        reached: f64,
    },
}

impl std::fmt::Display for ExponentialKernelError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Parameter(error) => error.fmt(f),
            Self::ToleranceMissed { tolerance, reached } => {
                write!(
                    f,
                    "no table of exponentials within the tolerance {tolerance:e}: the best has {reached:.1e}"
                )
            }
        }
    }
}

impl std::error::Error for ExponentialKernelError {}

impl From<ParameterError> for ExponentialKernelError {
    fn from(error: ParameterError) -> Self {
        Self::Parameter(error)
    }
}

/// Smallest relative tolerance of a table: below it the rounding of the coefficients decides.
pub const SMALLEST_TOLERANCE: f64 = 4e-15;

/// Below this tolerance, rounding takes a good part of it.
const ROUNDING_COUNTS: f64 = 1e-14;

/// What rounding in double precision adds to the measured error of a weight.
const ROUNDING: f64 = 8.0 * f64::EPSILON;

/// Errors of a tail count for nothing that are this much smaller than those allowed of the first weight.
const NOTHING: f64 = 1e-9;

/// The part of the tolerance that is left to the quadrature where rounding counts.
const PART_OF_THE_QUADRATURE: f64 = 0.25;

/// Lengths n₀ of the head that are tried: n₀ − 1 weights are summed directly, in whole vectors.
const HEADS: [usize; 15] = [5, 9, 17, 25, 33, 41, 49, 65, 81, 97, 129, 193, 257, 385, 513];

/// The last of them.
const LONGEST_HEAD: usize = HEADS[HEADS.len() - 1];

/// The search ends after so many longer heads that cost more: each saves fewer exponentials than the one
/// before.
const DEARER_HEADS: usize = 2;

/// Multiply–adds per step of an exponential; a weight of the head has one.
const COST_OF_EXPONENTIAL: usize = 2;

/// Running sums of rates below this are kept in two parts: they would gather the rounding errors of 1/rate
/// steps.
const SLOW_RATE: f64 = 1.0 / 32.0;

/// How far the slow nodes reach that a Gauss rule is tried for, as rate · horizon: up to there e^{−sn} is
/// nearly a polynomial in s.
const SLOW_REACHES: [f64; 5] = [2.0, 4.0, 8.0, 16.0, 32.0];

/// How far down the fast nodes reach, as rate · head.
const FAST_REACHES: [f64; 6] = [16.0, 13.0, 10.0, 8.0, 6.0, 4.0];

/// Lags behind the head at which the error of a table is measured one by one; from there on they are an
/// eighth apart.
const DENSE_LAGS: usize = 64;

/// The measurement goes up to this many times the longest head.
const MEASURED_HEADS: usize = 4;

/// Nodes of the longest Gauss rule that is tried.
pub(super) const LONGEST_RULE: usize = 24;

/// Exponentials in a block of the core's table.
const BLOCK: usize = 4;

impl ExponentialKernel {
    /// Weights of the backward differentiation formula `order` for the operator D^`exponent` and the step
    /// size `step_size`, each within the relative tolerance `tolerance` up to lag `horizon`.
    ///
    /// Kernels of exponent 0 and 1 end after a few weights: they are all head. Next to them, and to 2, what
    /// is behind the head may be next to nothing; its errors are then held to 10⁻⁹ of those allowed of w₀.
    ///
    /// # Errors
    /// If the exponent is outside (−1, 2), the step size not positive, the horizon zero or the tolerance
    /// outside [4·10⁻¹⁵, 10⁻¹]; or if no table reaches the tolerance.
    pub fn bdf(
        order: BdfOrder,
        exponent: f64,
        step_size: f64,
        horizon: usize,
        tolerance: f64,
    ) -> Result<Self, ExponentialKernelError> {
        Self::of(Cut { order, exponent, on_increments: false }, step_size, horizon, tolerance)
    }

    /// The same for a memory on increments: the sums of the weights
    /// ([`ConvolutionWeights::on_increments`]).
    ///
    /// # Errors
    /// As [`bdf`](ExponentialKernel::bdf); and if the exponent is not positive: sums of such weights do not
    /// decay.
    pub fn bdf_on_increments(
        order: BdfOrder,
        exponent: f64,
        step_size: f64,
        horizon: usize,
        tolerance: f64,
    ) -> Result<Self, ExponentialKernelError> {
        if exponent <= 0.0 {
            let allowed = "greater than 0 and less than 2 for weights on increments";
            return Err(ParameterError { parameter: "exponent", value: exponent, allowed }.into());
        }
        Self::of(Cut { order, exponent, on_increments: true }, step_size, horizon, tolerance)
    }

    fn of(cut: Cut, step_size: f64, horizon: usize, tolerance: f64) -> Result<Self, ExponentialKernelError> {
        let Cut { order, exponent, on_increments } = cut;
        let exact_weights = |step_size: f64| -> Result<ConvolutionWeights, ParameterError> {
            let weights = ConvolutionWeights::bdf(order, exponent, step_size)?;
            Ok(if on_increments { weights.on_increments() } else { weights })
        };
        let range = |accepted, parameter, value, allowed| match accepted {
            true => Ok(()),
            false => Err(ParameterError { parameter, value, allowed }),
        };
        range(horizon > 0, "horizon", horizon as f64, "at least 1")?;
        range(
            (SMALLEST_TOLERANCE..=0.1).contains(&tolerance),
            "tolerance",
            tolerance,
            "at least 4e-15 and at most 0.1",
        )?;
        let all_head = |length: usize| -> Result<Self, ExponentialKernelError> {
            let head = exact_weights(step_size)?.take(length).collect();
            Ok(Self { head, exponentials: Vec::new(), horizon, tolerance })
        };
        if exponent == 0.0 || exponent == 1.0 {
            let length = exponent as usize * order.get() + usize::from(!on_increments);
            return Ok(Self { horizon: usize::MAX, ..all_head(length)? });
        }
        let exact: Vec<f64> =
            exact_weights(1.0)?.take(MEASURED_HEADS * LONGEST_HEAD.min(horizon) + 2).collect();
        let part = if tolerance < ROUNDING_COUNTS { PART_OF_THE_QUADRATURE } else { 1.0 };
        let quadrature_tolerance = part * tolerance;
        let spacing = cut.spacing(quadrature_tolerance);
        let mut best: Option<((bool, usize), usize, Vec<Exponential>)> = None;
        let mut reached = f64::INFINITY;
        let mut dearer = 0;
        for head in HEADS {
            if head > horizon || dearer == DEARER_HEADS {
                break;
            }
            let exponentials = cut.compressed_rule(spacing, head, horizon, quadrature_tolerance);
            let error = largest_error(&exponentials, &exact, head, horizon);
            reached = reached.min(error);
            // Next to whole exponents the tail is next to nothing, and its errors are less.
            let tail = head as f64 * exact[head].abs();
            if error > tolerance && error * tail > NOTHING * tolerance * exact[0].abs() {
                continue;
            }
            // One that has no room for the rounding of its sums is better than none.
            let tight = error > tolerance.min(quadrature_tolerance + ROUNDING);
            let cost = (tight, head + COST_OF_EXPONENTIAL * exponentials.len());
            if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
                best = Some((cost, head, exponentials));
                dearer = 0;
            } else if !tight {
                dearer += 1;
            }
        }
        match best {
            Some(((_, cost), head, exponentials)) if cost <= horizon => {
                let unit = step_size.power(-exponent);
                let scaled = |e: Exponential| Exponential { coefficient: e.coefficient * unit, ..e };
                let exponentials = exponentials.into_iter().map(scaled).collect();
                Ok(Self { exponentials, ..all_head(head)? })
            }
            _ if horizon < LONGEST_HEAD => all_head(horizon + 1),
            _ => Err(ExponentialKernelError::ToleranceMissed { tolerance, reached }),
        }
    }

    /// The weights w₀ … w_{n₀−1}.
    pub fn head(&self) -> &[f64] {
        &self.head
    }

    /// The exponentials of the tail, slowest first.
    pub fn exponentials(&self) -> &[Exponential] {
        &self.exponentials
    }

    /// Largest lag at which the weights hold.
    pub fn horizon(&self) -> usize {
        self.horizon
    }

    /// Relative tolerance of a weight.
    pub fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// The weight w_n of this representation.
    pub fn weight(&self, n: usize) -> f64 {
        match self.head.get(n) {
            Some(&weight) => weight,
            None => sum_of_exponentials(&self.exponentials, n),
        }
    }

    /// The table that the memory of the core reads, in its scalar.
    pub fn table<T: Real>(&self) -> ExponentialTable<Aligned<T>> {
        let first = self.head.len() as f64;
        let blocks = self.exponentials.chunks(BLOCK);
        let numbers = blocks.flat_map(|block| {
            let mut numbers = [T::of(0.0); 2 * BLOCK];
            for (lane, e) in block.iter().enumerate() {
                numbers[lane] = T::of(-libm::expm1(-e.rate));
                numbers[BLOCK + lane] = T::of(e.coefficient * libm::exp(-e.rate * first));
            }
            numbers
        });
        let slow = self.exponentials.iter().filter(|e| e.rate < SLOW_RATE).count();
        ExponentialTable {
            stages: 1,
            head: self.head.iter().map(|&weight| T::of(weight)).collect(),
            exponentials: numbers.collect(),
            slow_blocks: slow.div_ceil(BLOCK),
            horizon: self.horizon,
        }
    }
}

/// The check of a table must not be less accurate than the table, so the sum is compensated.
fn sum_of_exponentials(exponentials: &[Exponential], n: usize) -> f64 {
    let terms = exponentials.iter().map(|e| e.coefficient * libm::exp(-e.rate * n as f64));
    terms.collect::<CompensatedSum>().total()
}

/// Largest relative error of the exponentials against exact weights behind the head: every lag at first, then
/// ever fewer.
fn largest_error(exponentials: &[Exponential], exact: &[f64], head: usize, horizon: usize) -> f64 {
    let last = horizon.min(exact.len() - 1);
    let dense = head..=last.min(head + DENSE_LAGS);
    let sparse = lags(head + DENSE_LAGS + 1, last);
    dense
        .chain(sparse)
        .map(|n| (sum_of_exponentials(exponentials, n) / exact[n] - 1.0).abs())
        .fold(0.0, f64::max)
}

/// Lags from `first` to `last`, an eighth apart from one to the next.
fn lags(first: usize, last: usize) -> impl Iterator<Item = usize> {
    let next = move |&n: &usize| if n == last { None } else { Some((n + n / 8 + 1).min(last)) };
    std::iter::successors(Some(first), next).filter(move |&n| n <= last)
}

/// The branch cut [1, ∞) of γ_p(z)^β, or of γ_p(z)^β/(1 − z) for weights on increments.
#[derive(Clone, Copy)]
struct Cut {
    order: BdfOrder,
    exponent: f64,
    on_increments: bool,
}

/// A discrete positive measure: exponentials up to the common sign.
type Nodes = Vec<Exponential>;

impl Cut {
    /// The power of m that the function is like at the branch point: β or β − 1.
    fn power(self) -> f64 {
        self.exponent - if self.on_increments { 1.0 } else { 0.0 }
    }

    /// −sin(πβ)/π, exact to rounding also near a whole β; with the other sign for weights on increments.
    fn jump(self) -> f64 {
        let nearest = self.exponent.round();
        let sign = if (nearest.abs() == 1.0) != self.on_increments { 1.0 } else { -1.0 };
        sign * libm::sin(PI * (self.exponent - nearest)) / PI
    }

    /// |γ_p(1+m)|, γ_p(1+m) = Σ_i (−m)^i / i.
    fn modulus(self, m: f64) -> f64 {
        let series = (1..=self.order.get()).rev().fold(0.0, |sum, i| 1.0 / i as f64 - m * sum);
        (m * series).abs()
    }

    /// Spacing d of the trapezoidal rule in ln m at which its relative error is half the tolerance:
    /// 2 |Γ(1+β + 2πi/d)| / Γ(1+β), by Stirling's formula 2 √(2π) (2π/d)^{β+½} e^{−π²/d} / Γ(1+β), β the
    /// [`power`](Self::power).
    fn spacing(self, tolerance: f64) -> f64 {
        let error = |d: f64| {
            let power = (2.0 * PI / d).power(self.power() + 0.5);
            2.0 * (2.0 * PI).sqrt() * power * libm::exp(-PI * PI / d) / libm::tgamma(1.0 + self.power())
        };
        let (mut fine, mut coarse) = (0.05, 4.0);
        for _ in 0..60 {
            let middle = 0.5 * (fine + coarse);
            if error(middle) < 0.5 * tolerance { fine = middle } else { coarse = middle }
        }
        fine
    }

    /// The trapezoidal rule for lags n ≥ `head`, slowest node first, up to the common factor
    /// [`jump`](Self::jump).
    ///
    /// Nodes so slow that they stand still up to the horizon, a geometric series, are one node of rate 0.
    fn trapezoidal_rule(self, spacing: f64, head: usize, horizon: usize, tolerance: f64) -> Nodes {
        let exponent = self.power();
        let fastest = ((2.0 / tolerance).ln() + 2.0 + 1.5 * exponent) / head as f64;
        let standing = 0.01 * tolerance / horizon as f64;
        let first = libm::log(libm::expm1(fastest));
        let count = ((first - standing.ln()) / spacing).ceil().max(1.0) as usize;
        let slowest = libm::exp(first - count as f64 * spacing);
        let ratio = 1.0 + exponent;
        // d Σ_{k≥1} (slowest e^{−kd})^{1+β}
        let rest = spacing * slowest.power(ratio) / libm::expm1(spacing * ratio);
        let node = |k: usize| {
            let m = libm::exp(first - k as f64 * spacing);
            let divisor = if self.on_increments { m } else { 1.0 };
            let coefficient = spacing * self.modulus(m).power(self.exponent) * (m / divisor) / (1.0 + m);
            Exponential { rate: libm::log1p(m), coefficient }
        };
        std::iter::once(Exponential { rate: 0.0, coefficient: rest })
            .chain((0..=count).rev().map(node))
            .collect()
    }

    /// The rule with its slowest and fastest nodes compressed, for lags `head` to `horizon`.
    fn compressed_rule(self, spacing: f64, head: usize, horizon: usize, tolerance: f64) -> Vec<Exponential> {
        let nodes = self.trapezoidal_rule(spacing, head, horizon, tolerance);
        let allowed = (0.25 * tolerance).max(4.0 * f64::EPSILON);
        let weights: Vec<(usize, f64)> =
            lags(head, horizon).map(|n| (n, sum_of_exponentials(&nodes, n))).collect();
        let agrees = |group: &[Exponential], rule: &[Exponential]| {
            weights.iter().all(|&(n, weight)| {
                let difference = sum_of_exponentials(group, n) - sum_of_exponentials(rule, n);
                difference.abs() <= allowed * weight
            })
        };
        let slow = |reach: f64| {
            let count = nodes.partition_point(|node| node.rate * horizon as f64 <= reach);
            let group = nodes.get(..count).unwrap_or(&[]);
            shortest_rule(group, slow_gauss_rules(group), &agrees)
        };
        let fast = |reach: f64| {
            let count = nodes.partition_point(|node| node.rate * head as f64 <= reach);
            let group = nodes.get(count..).unwrap_or(&[]);
            shortest_rule(group, fast_gauss_rules(group, head), &agrees)
        };
        // Of the reaches, the one that saves most.
        let most = |rules: Vec<(usize, Nodes)>| {
            rules.into_iter().max_by_key(|(replaced, rule)| replaced - rule.len()).unwrap_or_default()
        };
        let (slow_count, slow_rule) = most(SLOW_REACHES.map(slow).into());
        let (fast_count, fast_rule) = most(FAST_REACHES.map(fast).into());
        let middle = nodes.get(slow_count..nodes.len() - fast_count).unwrap_or(&[]);
        let mut rule = [&slow_rule, middle, &fast_rule].concat();
        rule.iter_mut().for_each(|node| node.coefficient *= self.jump());
        rule
    }
}

/// Number of nodes replaced and the shortest Gauss rule that agrees with them, or the nodes themselves.
fn shortest_rule(
    group: &[Exponential],
    gauss_rule: impl Fn(usize) -> Nodes,
    agrees: &impl Fn(&[Exponential], &[Exponential]) -> bool,
) -> (usize, Nodes) {
    let sizes = 1..group.len().min(LONGEST_RULE + 1);
    let rule = sizes.map(gauss_rule).find(|rule| agrees(group, rule));
    (group.len(), rule.unwrap_or_else(|| group.to_vec()))
}

/// Gauss rules of the measure in the rate, by size: e^{−sn} is nearly a polynomial in s where s n is
/// moderate.
fn slow_gauss_rules(group: &[Exponential]) -> impl Fn(usize) -> Nodes {
    let unit = group.last().map_or(1.0, |node| node.rate);
    let measure: Vec<(f64, f64)> = group.iter().map(|node| (node.rate / unit, node.coefficient)).collect();
    let jacobi = JacobiMatrix::of(&measure);
    move |size| {
        let rule = jacobi.gauss_rule(size).into_iter();
        rule.map(|(x, c)| Exponential { rate: x.max(0.0) * unit, coefficient: c }).collect()
    }
}

/// Gauss rules of the measure in t = e^{−s}, by size, weighted as it stands behind the head: e^{−s(n−n₀)} is
/// a power of t.
fn fast_gauss_rules(group: &[Exponential], head: usize) -> impl Fn(usize) -> Nodes {
    let behind = head as f64;
    let unit = group.first().map_or(1.0, |node| libm::exp(-node.rate));
    let measure: Vec<(f64, f64)> = group
        .iter()
        .map(|node| (libm::exp(-node.rate) / unit, node.coefficient * libm::exp(-node.rate * behind)))
        .collect();
    let jacobi = JacobiMatrix::of(&measure);
    move |size| {
        let node = |(t, c): (f64, f64)| {
            let rate = -libm::log(t.max(f64::EPSILON) * unit);
            Exponential { rate, coefficient: c * libm::exp(rate * behind) }
        };
        let mut rule: Nodes = jacobi.gauss_rule(size).into_iter().map(node).collect();
        rule.sort_by(|a, b| a.rate.total_cmp(&b.rate));
        rule
    }
}

/// The Jacobi matrix of a discrete positive measure; its leading parts are those of the Gauss rules
/// \[GolubWelsch69\].
pub(super) struct JacobiMatrix {
    mass: f64,
    diagonal: Vec<f64>,
    beside: Vec<f64>,
}

impl JacobiMatrix {
    /// For a measure of (place, mass), as far as rules of [`LONGEST_RULE`] nodes need it: Lanczos' algorithm
    /// on the diagonal matrix of places, started from the square roots of the masses and reorthogonalised.
    pub(super) fn of(measure: &[(f64, f64)]) -> Self {
        let mass = measure.iter().map(|(_, mass)| *mass).collect::<CompensatedSum>().total();
        let mut jacobi = Self { mass, diagonal: Vec::new(), beside: Vec::new() };
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let mut current: Vec<f64> = measure.iter().map(|(_, part)| (part / mass).sqrt()).collect();
        let mut basis: Vec<Vec<f64>> = Vec::new();
        for _ in 0..LONGEST_RULE.min(measure.len()) {
            let mut next: Vec<f64> = measure.iter().zip(&current).map(|((place, _), q)| place * q).collect();
            jacobi.diagonal.push(dot(&next, &current));
            basis.push(current);
            for _ in 0..2 {
                for vector in &basis {
                    let overlap = dot(&next, vector);
                    next.iter_mut().zip(vector).for_each(|(next, q)| *next -= overlap * q);
                }
            }
            let norm = dot(&next, &next).sqrt();
            jacobi.beside.push(norm);
            next.iter_mut().for_each(|next| *next /= norm);
            current = next;
        }
        jacobi
    }

    /// The Gauss rule of `size` nodes, (place, mass) in ascending order.
    pub(super) fn gauss_rule(&self, size: usize) -> Vec<(f64, f64)> {
        let size = size.min(self.diagonal.len());
        let mut leading = DMatrix::zeros(size, size);
        for k in 0..size {
            leading[(k, k)] = self.diagonal[k];
            if k + 1 < size {
                leading[(k, k + 1)] = self.beside[k];
                leading[(k + 1, k)] = self.beside[k];
            }
        }
        let eigen = leading.symmetric_eigen();
        let node = |k: usize| (eigen.eigenvalues[k], self.mass * eigen.eigenvectors[(0, k)].powi(2));
        let mut rule: Vec<(f64, f64)> = (0..size).map(node).collect();
        rule.sort_by(|a, b| a.0.total_cmp(&b.0));
        rule
    }
}
