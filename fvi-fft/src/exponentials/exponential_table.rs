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
//! up to contributions of the other roots ζ of γ_p, which fall like |ζ|^{−n} and are left to the head. The
//! integral over y = ln m by the trapezoidal rule is a sum of exponentials with rates s = ln(1+m); for p = 1
//! it is a Beta function, whose poles bound the error of the rule at every n. The rule needs many nodes of
//! tiny rates, and some of large rates that decay just after the head: both groups are replaced by the Gauss
//! rules of their own discrete measures. How far each group can be compressed, and how short the head may be,
//! is determined by measuring the error of the weights, not from a bound.
//!
//! For a memory on increments the kernel is divided by 1 − z = −m: the same rates with other coefficients.
//!
//! Kernels of several β can share their rates: the trapezoidal rule is the same up to its coefficients, and
//! the nodes of one Gauss rule, that of the geometric mean of their measures, serve all of them with the
//! coefficients that integrate polynomials exactly against each.
//!
//! Other transfer functions K(s) have other jumps across the cut, which may begin beyond m = 0, and poles on
//! it, which are separate exponentials (`principal_cut.rs`).
//!
//! Sources: \[HJO\] eq. 18–22, 30; the Gauss rule of a discrete measure by Lanczos' algorithm,
//! \[GolubWelsch69\], \[Gautschi04\]; quadrature for sums of exponentials, \[BeylkinMonzon10\], \[McLean18\].

use crate::Aligned;
use crate::exponentials::decays::sum_of_exponentials;
use crate::exponentials::shorter_rules::{Nodes, Shortening, largest_change};
use crate::quadrature::exponential::Exponential;
use crate::quadrature::multistep_weights::multistep_weights;
use crate::quadrature::principal_cut::PrincipalCut;
use crate::sums::max_or_nan;
use crate::transfer::TransferFunction;
use fvi_core::{BdfOrder, ConvolutionWeights, ExponentialTable, ParameterError, Real, min_or_nan};
use std::cell::RefCell;
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
    step_size: f64,
    on_increments: bool,
    horizon: usize,
    tolerance: f64,
}

/// Reason why no table was computed.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum ExponentialKernelError {
    /// A parameter is not allowed.
    Parameter(ParameterError),
    /// The cut of the kernel is so narrow that it would need more exponentials than a table may have.
    Narrow(ParameterError),
    /// No head of acceptable length gives weights within the tolerance.
    ToleranceMissed {
        /// The requested tolerance.
        tolerance: f64,
        /// Smallest error reached.
        reached: f64,
    },
}

impl std::fmt::Display for ExponentialKernelError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Parameter(error) | Self::Narrow(error) => error.fmt(f),
            Self::ToleranceMissed { tolerance, reached } => {
                write!(
                    f,
                    "no table of exponentials within the tolerance {tolerance:e}: the best has {reached:.1e}; the engines \
                     \"direct\", \"block-fft\" and \"real-time\" sum any weights"
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

/// Smallest relative tolerance of a table: below it the rounding of the coefficients dominates.
pub const SMALLEST_TOLERANCE: f64 = 4e-15;

/// Tolerance below which rounding is a considerable part of it.
const ROUNDING_COUNTS: f64 = 1e-14;

/// Rounding error in double precision in the measured error of a weight.
const ROUNDING: f64 = 8.0 * f64::EPSILON;

/// Ratio of errors of a tail to those allowed for the first weight below which they are neglected.
const NOTHING: f64 = 1e-9;

/// Fraction of the tolerance left to the quadrature where rounding matters.
const PART_OF_THE_QUADRATURE: f64 = 0.25;

/// Candidates for the length n₀ of the head: n₀ − 1 weights are summed directly, in whole vectors.
const HEADS: [usize; 15] = [5, 9, 17, 25, 33, 41, 49, 65, 81, 97, 129, 193, 257, 385, 513];

/// The largest of these lengths.
const LONGEST_HEAD: usize = HEADS[HEADS.len() - 1];

/// Relative accuracy of weights that are compared with.
const FINEST: f64 = 1e-17;

/// The longest head of most tables.
const USUAL_HEAD: usize = 65;

/// Number of successive longer heads with a higher cost after which the search ends: each saves fewer
/// exponentials than the previous one.
const DEARER_HEADS: usize = 2;

/// Multiply–adds per step of an exponential that all kernels share; each exponential and each weight of the
/// head costs one more for each kernel.
const COST_OF_EXPONENTIAL: usize = 1;

/// Running sums of rates below this are kept in two parts, as they would accumulate the rounding errors of
/// 1/rate steps.
const SLOW_RATE: f64 = 1.0 / 32.0;

/// Number of lags after the head at which the trapezoidal rule is measured before it is shortened: what the
/// head has to hold, beside the cut, decays from there on.
const FIRST_LAGS: usize = 8;

/// Number of lags after the head at which the error of a table is measured one by one; the following ones
/// increase by an eighth each.
const DENSE_LAGS: usize = 64;

/// End of the measurement in multiples of the longest head.
const MEASURED_HEADS: usize = 4;

/// Exponentials per block of the table of fvi-core.
const BLOCK: usize = 4;

/// The horizon of a table without a limit.
pub const ENDLESS: usize = usize::MAX;

/// The largest lag at which the weights of an endless table hold to the tolerance, 2⁵⁰: 35 000 years at 1
/// kHz.
pub const ENDLESS_REACH: u64 = 1 << 50;

/// The largest lag at which the weights of a table for `horizon` hold, also where a `usize` is shorter.
fn reach_of(horizon: usize) -> u64 {
    if horizon == ENDLESS { ENDLESS_REACH } else { horizon as u64 }
}

/// Sums of more than this number of samples over ε, the distance from 1 to the next number, are kept in three
/// parts: of N samples of one size two parts lose N ε²/4 at worst.
const IN_TWO_PARTS: f64 = 16.0;

impl ExponentialKernel {
    /// Weights of the backward differentiation formula `order` for the operator D^`exponent` and the step
    /// size `step_size`, each within the relative tolerance `tolerance` up to lag `horizon`.
    ///
    /// Kernels of exponent 0 and 1 end after a few weights: they are all head. For exponents near 0, 1 and 2
    /// the weights after the head may be tiny; their errors are then limited to 10⁻⁹ of those allowed for w₀.
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
        Self::one(Cut { order, exponent, on_increments: false }, step_size, horizon, tolerance)
    }

    /// The same for a memory on increments: the partial sums of the weights
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
        Self::one(Cut { order, exponent, on_increments: true }, step_size, horizon, tolerance)
    }

    /// Kernels of several exponents that share the length of the head and the rates, otherwise as by
    /// [`bdf`](Self::bdf) or [`bdf_on_increments`](Self::bdf_on_increments); a few more exponentials are
    /// needed than for the most demanding one alone.
    ///
    /// # Errors
    /// As there, and for exponents 0 and 1, which have no exponentials.
    pub fn sharing_rates(
        order: BdfOrder,
        exponents: &[f64],
        on_increments: bool,
        step_size: f64,
        horizon: usize,
        tolerance: f64,
    ) -> Result<Vec<Self>, ExponentialKernelError> {
        let whole = |exponent: f64| exponent == 1.0 || (on_increments && exponent <= 0.0) || exponent == 0.0;
        if let Some(&exponent) = exponents.iter().find(|&&exponent| whole(exponent)) {
            let allowed = "neither 0 nor 1, and greater than 0 for weights on increments";
            return Err(ParameterError { parameter: "exponent", value: exponent, allowed }.into());
        }
        let cuts: Vec<_> = exponents.iter().map(|&exponent| Cut { order, exponent, on_increments }).collect();
        Self::of(&cuts, step_size, reach_of(horizon), tolerance)
    }

    /// Weights of the backward differentiation formula `order` for any transfer function K, each within the
    /// relative tolerance `tolerance` up to lag `horizon`, on values or on increments: the Taylor
    /// coefficients of K(γ_p(z)/h), or of K(γ_p(z)/h)/(1 − z).
    ///
    /// The tolerance is relative to each weight; weights that fall off exponentially are held to it as far as
    /// 10⁻⁹ of w₀ divided by the length of the head.
    ///
    /// # Errors
    /// As [`bdf`](ExponentialKernel::bdf); and if the transfer function has singularities off the negative
    /// real axis, so that its weights are not a sum of decaying exponentials.
    pub fn of_transfer(
        transfer: &TransferFunction,
        order: BdfOrder,
        on_increments: bool,
        step_size: f64,
        horizon: usize,
        tolerance: f64,
    ) -> Result<Self, ExponentialKernelError> {
        if let Some(exponent) = transfer.exponent() {
            let make = if on_increments { Self::bdf_on_increments } else { Self::bdf };
            return make(order, exponent, step_size, horizon, tolerance);
        }
        if let Some(table) = transfer.table() {
            return Err(ExponentialKernelError::Parameter(ParameterError {
                parameter: "number of weights",
                value: table.weights().len() as f64,
                allowed: "none: exponentials are those of a kernel K(s), which weights do not tell",
            }));
        }
        let reach = reach_of(horizon);
        check_range(reach, tolerance)?;
        let mut reached = f64::INFINITY;
        if let Some(narrow) = transfer.narrow() {
            return Err(ExponentialKernelError::Narrow(narrow));
        }
        let mut source = TransferSource {
            transfer,
            order,
            step_size,
            on_increments,
            cut: PrincipalCut::new(transfer, order, step_size, on_increments),
            known: RefCell::default(),
            refinement: 1.0,
        };
        // The width of the strip of a formula is a guess.
        for refinement in [1.0, 0.5, 0.25] {
            source.refinement = refinement;
            match Self::of(std::slice::from_ref(&source), step_size, reach, tolerance)
                .and_then(|made| Self::only(made, tolerance))
            {
                Ok(mut made) => {
                    if horizon == ENDLESS {
                        made.end_never();
                    }
                    return Ok(made);
                }
                Err(ExponentialKernelError::ToleranceMissed { reached: error, .. }) => {
                    reached = reached.min(error);
                }
                Err(error) => return Err(error),
            }
        }
        Err(ExponentialKernelError::ToleranceMissed { tolerance, reached })
    }

    fn one(cut: Cut, step_size: f64, horizon: usize, tolerance: f64) -> Result<Self, ExponentialKernelError> {
        let reach = reach_of(horizon);
        if cut.exponent == 0.0 || cut.exponent == 1.0 {
            check_range(reach, tolerance)?;
            let length = cut.exponent as usize * cut.order.get() + usize::from(!cut.on_increments);
            let head = cut.exact_weights(step_size)?.take(length).collect();
            let (exponentials, horizon, on_increments) = (Vec::new(), ENDLESS, cut.on_increments);
            return Ok(Self { head, exponentials, step_size, on_increments, horizon, tolerance });
        }
        let mut made =
            Self::of(&[cut], step_size, reach, tolerance).and_then(|made| Self::only(made, tolerance))?;
        if horizon == ENDLESS {
            made.end_never();
        }
        Ok(made)
    }

    fn only(mut made: Vec<Self>, tolerance: f64) -> Result<Self, ExponentialKernelError> {
        made.pop().ok_or(ExponentialKernelError::ToleranceMissed { tolerance, reached: f64::INFINITY })
    }

    /// Turns a table for lags up to [`ENDLESS_REACH`] into one without a horizon.
    fn end_never(&mut self) {
        self.horizon = ENDLESS;
        // An exponential that is constant up to the reach must decay beyond: its sum would grow without
        // bound.
        let standing = 0.01 * self.tolerance / ENDLESS_REACH as f64;
        self.exponentials.iter_mut().for_each(|e| e.rate = e.rate.max(standing));
    }

    /// The same kernel with other numbers of these.
    pub(crate) fn with_tail(&self, head: Vec<f64>, exponentials: Vec<Exponential>, tolerance: f64) -> Self {
        Self { head, exponentials, tolerance, ..self.clone() }
    }

    /// One kernel for each source, with common rates.
    fn of<S: Source>(
        cuts: &[S],
        step_size: f64,
        horizon: u64,
        tolerance: f64,
    ) -> Result<Vec<Self>, ExponentialKernelError> {
        check_range(horizon, tolerance)?;
        let weights = |step_size: f64, count: usize| -> Result<Vec<Vec<f64>>, ParameterError> {
            cuts.iter().map(|cut| cut.exact(step_size, count)).collect()
        };
        let kernels = |head: usize, tails: Vec<Nodes>| -> Result<Vec<Self>, ExponentialKernelError> {
            let of_kernels = weights(step_size, head)?.into_iter().zip(tails);
            let on_increments = cuts.iter().all(Source::on_increments);
            let kernel = |(head, exponentials)| Self {
                head,
                exponentials,
                step_size,
                on_increments,
                horizon: usize::try_from(horizon).unwrap_or(ENDLESS),
                tolerance,
            };
            Ok(of_kernels.map(kernel).collect())
        };
        let exact = |head: usize| weights(1.0, MEASURED_HEADS * at_most(head, horizon) + 2);
        let part = if tolerance < ROUNDING_COUNTS { PART_OF_THE_QUADRATURE } else { 1.0 };
        let quadrature_tolerance = part * tolerance;
        let mut measured = cuts.iter().map(Source::measured).fold(0, usize::max);
        let [near, end] = [measured, LONGEST_HEAD].map(|head| (MEASURED_HEADS * head) as u64);
        let far: Vec<u64> = lags(near, end).skip(1).filter(|&n| n <= horizon).collect();
        let far = cuts.iter().map(|cut| far.iter().copied().zip(cut.far_weights(&far)).collect()).collect();
        let mut check = Check { cuts, exact: exact(measured)?, far, horizon, tolerance };
        let mut best: Option<((bool, usize), usize, Vec<Nodes>)> = None;
        let mut missed: Vec<(usize, Vec<Nodes>)> = Vec::new();
        let mut dearer = 0;
        let mut shortening = Shortening::default();
        for head in HEADS {
            if head as u64 > horizon || dearer == DEARER_HEADS {
                break;
            }
            if head > measured {
                measured = LONGEST_HEAD;
                check.exact = exact(measured)?;
                check.far.iter_mut().for_each(Vec::clear);
            }
            let reach = cuts.iter().map(|cut| cut.reach(horizon)).fold(head as u64, u64::max);
            let rules = trapezoidal_rules(cuts, head, reach, quadrature_tolerance);
            let whole = finished(rules.clone(), cuts);
            let margin = 2.0 * largest_change(quadrature_tolerance) + ROUNDING;
            if check.misses(&check.errors(&whole, head, (head + FIRST_LAGS) as u64), head, margin) {
                missed.push((head, whole));
                continue;
            }
            let rules = if are_positive(&rules) {
                let slowest = cuts.iter().map(Source::slowest).fold(f64::INFINITY, min_or_nan);
                finished(shortening.of(&rules, [head as u64, reach], slowest, quadrature_tolerance), cuts)
            } else {
                whole
            };
            let errors = check.errors(&rules, head, horizon);
            if check.misses(&errors, head, 0.0) {
                missed.push((head, rules));
                continue;
            }
            let largest = errors.iter().copied().fold(0.0, max_or_nan);
            // A table with no margin for the rounding of its sums is better than none.
            let tight = largest > tolerance.min(quadrature_tolerance + ROUNDING);
            let exponentials = rules.first().map_or(0, Vec::len);
            let cost = cuts.len() * (head + exponentials) + COST_OF_EXPONENTIAL * exponentials;
            if best.as_ref().is_none_or(|(least, ..)| (tight, cost) < *least) {
                best = Some(((tight, cost), head, rules));
                dearer = 0;
            } else if !tight {
                dearer += 1;
            }
        }
        match best {
            Some(((_, cost), head, rules)) if cost as u64 <= horizon.saturating_mul(cuts.len() as u64) => {
                let scaled = |(cut, exponentials): (&S, Nodes)| {
                    let unit = cut.unit(step_size);
                    let scaled = |e: Exponential| Exponential { coefficient: e.coefficient * unit, ..e };
                    exponentials.into_iter().map(scaled).collect()
                };
                kernels(head, cuts.iter().zip(rules).map(scaled).collect())
            }
            _ if horizon < LONGEST_HEAD as u64 => {
                kernels(at_most(LONGEST_HEAD, horizon) + 1, vec![Vec::new(); cuts.len()])
            }
            _ => {
                let error = |(head, rules): &(usize, Vec<Nodes>)| {
                    check.errors(rules, *head, horizon).into_iter().fold(0.0, max_or_nan)
                };
                let errors = missed.iter().map(error).filter(|error| !error.is_nan());
                let reached = errors.fold(f64::INFINITY, min_or_nan);
                Err(ExponentialKernelError::ToleranceMissed { tolerance, reached })
            }
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

    /// Largest lag at which the weights hold; [`ENDLESS`] without a limit: beyond [`ENDLESS_REACH`] the
    /// weights decay, and no sample is refused.
    pub fn horizon(&self) -> usize {
        self.horizon
    }

    /// True if the weights are those of a memory on increments.
    pub fn on_increments(&self) -> bool {
        self.on_increments
    }

    /// Step size contained in the weights.
    pub fn step_size(&self) -> f64 {
        self.step_size
    }

    /// Relative tolerance of a weight.
    pub fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// The weight w_n of this representation.
    pub fn weight(&self, n: usize) -> f64 {
        match self.head.get(n) {
            Some(&weight) => weight,
            None => sum_of_exponentials(&self.exponentials, n as u64),
        }
    }

    /// The table in the format and scalar of fvi-core's memory.
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
        let slower = |rate: f64| self.exponentials.iter().filter(|e| e.rate < rate).count().div_ceil(BLOCK);
        let unit = T::EPSILON.to_f64();
        let in_three_parts = reach_of(self.horizon).min(ENDLESS_REACH) as f64 > IN_TWO_PARTS / unit;
        ExponentialTable {
            stages: 1,
            head: self.head.iter().map(|&weight| T::of(weight)).collect(),
            exponentials: numbers.collect(),
            slow_blocks: slower(SLOW_RATE),
            far_blocks: if in_three_parts { slower(unit / IN_TWO_PARTS) } else { 0 },
            horizon: if self.horizon == ENDLESS { u64::MAX } else { self.horizon as u64 },
            step_size: self.step_size,
        }
    }
}

/// A length, or the lag `reach` where that is shorter.
fn at_most(length: usize, reach: u64) -> usize {
    reach.min(length as u64) as usize
}

pub(crate) fn check_range(horizon: u64, tolerance: f64) -> Result<(), ParameterError> {
    let range = |accepted, parameter, value, allowed| match accepted {
        true => Ok(()),
        false => Err(ParameterError { parameter, value, allowed }),
    };
    range(horizon > 0, "horizon", horizon as f64, "at least 1")?;
    let accepted = (SMALLEST_TOLERANCE..=0.1).contains(&tolerance);
    range(accepted, "tolerance", tolerance, "at least 4e-15 and at most 0.1")
}

/// What tables are measured by.
struct Check<'a, S> {
    cuts: &'a [S],
    /// The exact first weights of each kernel.
    exact: Vec<Vec<f64>>,
    /// Lags beyond these, and the weights there.
    far: Vec<Vec<(u64, f64)>>,
    horizon: u64,
    tolerance: f64,
}

impl<S: Source> Check<'_, S> {
    /// The largest error of each kernel at the lags from `head` on that are measured, up to `last`.
    fn errors(&self, rules: &[Nodes], head: usize, last: u64) -> Vec<f64> {
        let last = last.min(self.horizon);
        let of_kernels = rules.iter().zip(&self.exact).zip(&self.far).zip(self.cuts);
        of_kernels
            .map(|(((rule, exact), far), cut)| {
                let floor = cut.floor(head);
                let near = largest_error(rule, exact, head, last, floor);
                let far = far.iter().filter(|(n, _)| *n <= last);
                far.map(|&(n, weight)| error_at(rule, n, weight, floor)).fold(near, max_or_nan)
            })
            .collect()
    }

    /// True if one of these errors is too large, by more than a margin.
    fn misses(&self, errors: &[f64], head: usize, margin: f64) -> bool {
        // Near integer exponents the tail is tiny, and its errors are relaxed.
        let misses = |((&error, exact), cut): ((&f64, &Vec<f64>), &S)| {
            let excess = error - margin;
            let tail = head as f64 * exact[head].abs();
            let allowed = NOTHING * self.tolerance * exact[0].abs();
            let is_nothing = cut.floor(head) == 0.0 && excess * tail <= allowed;
            (excess > self.tolerance || excess.is_nan()) && !is_nothing
        };
        errors.iter().zip(&self.exact).zip(self.cuts).any(misses)
    }
}

/// Largest relative error of the exponentials against exact weights after the head: at every lag at first,
/// then at ever larger distances. Weights smaller than `floor` count as that large.
fn largest_error(exponentials: &[Exponential], exact: &[f64], head: usize, horizon: u64, floor: f64) -> f64 {
    let last = horizon.min(exact.len() as u64 - 1);
    let sparse_from = (head + DENSE_LAGS + 1) as u64;
    let dense = head as u64..=last.min(sparse_from - 1);
    let sparse = lags(sparse_from, last);
    dense.chain(sparse).map(|n| error_at(exponentials, n, exact[n as usize], floor)).fold(0.0, max_or_nan)
}

/// The error of the exponentials at one lag.
fn error_at(exponentials: &[Exponential], n: u64, weight: f64, floor: f64) -> f64 {
    match sum_of_exponentials(exponentials, n) {
        sum if weight == sum => 0.0,
        sum if weight.abs() >= floor => (sum / weight - 1.0).abs(),
        sum => (sum - weight).abs() / floor,
    }
}

/// Source of a kernel's weights and of the exponentials for their tail.
trait Source {
    /// The exact first weights.
    fn exact(&self, step_size: f64, count: usize) -> Result<Vec<f64>, ParameterError>;

    /// The head up to a multiple of which the exact first weights are wanted, as long as that of the table is
    /// not longer.
    fn measured(&self) -> usize;

    /// Weights beyond these, at some lags.
    fn far_weights(&self, lags: &[u64]) -> Vec<f64>;

    /// True if the weights are those of a memory on increments.
    fn on_increments(&self) -> bool;

    /// The factor of all coefficients for a step size other than that of the rule.
    fn unit(&self, step_size: f64) -> f64;

    /// Size below which weights are negligible, after a head of this length.
    fn floor(&self, head: usize) -> f64;

    /// The lag up to which the weights are not negligible.
    fn reach(&self, horizon: u64) -> u64;

    /// Spacing of the trapezoidal rule for a relative tolerance.
    fn spacing(&self, tolerance: f64) -> f64;

    /// Rate from which nodes are negligible at the end of a head.
    fn fastest(&self, head: usize, tolerance: f64) -> f64;

    /// The trapezoidal rule up to a rate, slowest node first, without the common [`factor`](Self::factor).
    fn rule(&self, spacing: f64, fastest: f64, horizon: u64, tolerance: f64) -> Nodes;

    /// The common factor of the nodes of the rule.
    fn factor(&self) -> f64;

    /// Exponentials in addition to those of the rule, with their own coefficients.
    fn poles(&self) -> &[Exponential];

    /// Rate of the slowest node.
    fn slowest(&self) -> f64;
}

/// Any transfer function, at a given step size.
struct TransferSource<'a> {
    transfer: &'a TransferFunction,
    order: BdfOrder,
    step_size: f64,
    on_increments: bool,
    cut: PrincipalCut<'a>,
    /// The weights computed so far.
    known: RefCell<Vec<f64>>,
    /// Fraction of the spacing of the trapezoidal rule that is used.
    refinement: f64,
}

impl Source for TransferSource<'_> {
    fn exact(&self, _: f64, count: usize) -> Result<Vec<f64>, ParameterError> {
        let mut known = self.known.borrow_mut();
        if known.len() < count {
            *known = multistep_weights(self.transfer, self.order, self.step_size, self.on_increments, count)?;
        }
        Ok(known[..count].to_vec())
    }

    /// The first weights come from power series, which take the square of their number. Later ones are those
    /// of the cut and the poles, where the cut is known.
    fn measured(&self) -> usize {
        if self.transfer.text().is_some() { LONGEST_HEAD } else { USUAL_HEAD }
    }

    /// By a rule that is finer than any table.
    fn far_weights(&self, lags: &[u64]) -> Vec<f64> {
        let [Some(&first), Some(&last)] = [lags.first(), lags.last()] else { return Vec::new() };
        let (spacing, fastest) =
            (0.5 * self.cut.spacing(FINEST), self.cut.fastest(at_most(usize::MAX, first), FINEST));
        let mut rule = self.cut.rule(spacing, fastest, last, FINEST);
        rule.iter_mut().for_each(|node| node.coefficient *= self.cut.sign());
        rule.extend_from_slice(self.cut.poles());
        lags.iter().map(|&n| sum_of_exponentials(&rule, n)).collect()
    }

    fn on_increments(&self) -> bool {
        self.on_increments
    }

    fn unit(&self, _: f64) -> f64 {
        1.0
    }

    fn floor(&self, head: usize) -> f64 {
        NOTHING * self.known.borrow().first().map_or(0.0, |first| first.abs()) / head as f64
    }

    fn reach(&self, horizon: u64) -> u64 {
        self.cut.reach(horizon)
    }

    fn spacing(&self, tolerance: f64) -> f64 {
        self.refinement * self.cut.spacing(tolerance)
    }

    fn fastest(&self, head: usize, tolerance: f64) -> f64 {
        self.cut.fastest(head, tolerance)
    }

    fn rule(&self, spacing: f64, fastest: f64, horizon: u64, tolerance: f64) -> Nodes {
        self.cut.rule(spacing, fastest, horizon, tolerance)
    }

    fn factor(&self) -> f64 {
        self.cut.sign()
    }

    fn poles(&self) -> &[Exponential] {
        self.cut.poles()
    }

    fn slowest(&self) -> f64 {
        self.cut.slowest()
    }
}

/// Lags from `first` to `last`, each an eighth larger than the previous one.
fn lags(first: u64, last: u64) -> impl Iterator<Item = u64> {
    let next = move |&n: &u64| if n == last { None } else { Some((n + n / 8 + 1).min(last)) };
    std::iter::successors(Some(first), next).filter(move |&n| n <= last)
}

/// The branch cut [1, ∞) of γ_p(z)^β, or of γ_p(z)^β/(1 − z) for weights on increments.
#[derive(Clone, Copy)]
struct Cut {
    order: BdfOrder,
    exponent: f64,
    on_increments: bool,
}

impl Source for Cut {
    fn exact(&self, step_size: f64, count: usize) -> Result<Vec<f64>, ParameterError> {
        Ok(self.exact_weights(step_size)?.take(count).collect())
    }

    fn measured(&self) -> usize {
        LONGEST_HEAD
    }

    fn far_weights(&self, _: &[u64]) -> Vec<f64> {
        Vec::new()
    }

    fn on_increments(&self) -> bool {
        self.on_increments
    }

    fn unit(&self, step_size: f64) -> f64 {
        step_size.power(-self.exponent)
    }

    /// They decay like a power of n, so none is negligible.
    fn floor(&self, _: usize) -> f64 {
        0.0
    }

    fn reach(&self, horizon: u64) -> u64 {
        horizon
    }

    fn spacing(&self, tolerance: f64) -> f64 {
        (*self).spacing_of_power(tolerance)
    }

    fn fastest(&self, head: usize, tolerance: f64) -> f64 {
        ((2.0 / tolerance).ln() + 2.0 + 1.5 * self.power()) / head as f64
    }

    fn rule(&self, spacing: f64, fastest: f64, horizon: u64, tolerance: f64) -> Nodes {
        self.trapezoidal_rule(spacing, fastest, horizon, tolerance)
    }

    fn factor(&self) -> f64 {
        self.jump()
    }

    fn poles(&self) -> &[Exponential] {
        &[]
    }

    fn slowest(&self) -> f64 {
        0.0
    }
}

impl Cut {
    /// The exact weights.
    fn exact_weights(self, step_size: f64) -> Result<ConvolutionWeights, ParameterError> {
        let weights = ConvolutionWeights::bdf(self.order, self.exponent, step_size)?;
        Ok(if self.on_increments { weights.on_increments() } else { weights })
    }

    /// Exponent of m in the behaviour of the function at the branch point: β or β − 1.
    fn power(self) -> f64 {
        self.exponent - if self.on_increments { 1.0 } else { 0.0 }
    }

    /// −sin(πβ)/π, exact to rounding also near an integer β; with the other sign for weights on increments.
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
    fn spacing_of_power(self, tolerance: f64) -> f64 {
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

    /// The trapezoidal rule up to this rate, slowest node first, without the common factor
    /// [`jump`](Self::jump).
    ///
    /// Nodes so slow that they are constant up to the horizon, a geometric series, are merged to one node of
    /// rate 0.
    fn trapezoidal_rule(self, spacing: f64, fastest: f64, horizon: u64, tolerance: f64) -> Nodes {
        let standing = 0.01 * tolerance / horizon as f64;
        let first = libm::log(libm::expm1(fastest));
        let count = ((first - standing.ln()) / spacing).ceil().max(1.0) as usize;
        let slowest = libm::exp(first - count as f64 * spacing);
        let ratio = 1.0 + self.power();
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
}

/// The trapezoidal rules of kernels with common rates, for lags `head` to `horizon`.
fn trapezoidal_rules<S: Source>(cuts: &[S], head: usize, horizon: u64, tolerance: f64) -> Vec<Nodes> {
    let spacing = cuts.iter().map(|cut| cut.spacing(tolerance)).fold(f64::INFINITY, min_or_nan);
    let fastest = cuts.iter().map(|cut| cut.fastest(head, tolerance)).fold(0.0, max_or_nan);
    cuts.iter().map(|cut| cut.rule(spacing, fastest, horizon, tolerance)).collect()
}

/// True if there are nodes and all of them are positive: Gauss rules need positive measures.
fn are_positive(rules: &[Nodes]) -> bool {
    let mut nodes = rules.iter().flatten();
    rules.first().is_some_and(|rule| !rule.is_empty()) && nodes.all(|node| node.coefficient >= 0.0)
}

/// Rules with the factors of their kernels, and with the exponentials of poles.
fn finished<S: Source>(rules: Vec<Nodes>, cuts: &[S]) -> Vec<Nodes> {
    let finished = |(mut rule, cut): (Nodes, &S)| {
        rule.iter_mut().for_each(|node| node.coefficient *= cut.factor());
        if !cut.poles().is_empty() {
            rule.extend_from_slice(cut.poles());
            rule.sort_by(|a, b| a.rate.total_cmp(&b.rate));
        }
        rule
    };
    rules.into_iter().zip(cuts).map(finished).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_of_any_transfer_function_hold_every_weight() {
        let made = [
            TransferFunction::tempered(0.5, 0.3),
            TransferFunction::tempered(1.5, 2.0),
            TransferFunction::maxwell(0.6, 0.0, 1.5),
            TransferFunction::maxwell(0.9, 0.4, 0.5),
            TransferFunction::maxwell(1.0, 0.3, 0.5),
            TransferFunction::prony(&[1.0, 0.7], &[1.0, 0.1]),
            TransferFunction::havriliak_negami(0.7, 0.5, 1.0),
            TransferFunction::havriliak_negami(1.0, 0.5, 2.0),
        ];
        for transfer in made.map(Result::unwrap) {
            for (p, on_increments) in [(1, false), (2, false), (2, true), (4, true), (6, false)] {
                for step_size in [1e-3, 0.1] {
                    if p == 6 && step_size == 0.1 {
                        // The weights from other preimages of fast poles decay too slowly for a head.
                        continue;
                    }
                    for tolerance in [1e-7, SMALLEST_TOLERANCE] {
                        let order = BdfOrder::new(p).unwrap();
                        let count = 20_000;
                        let made = ExponentialKernel::of_transfer(
                            &transfer,
                            order,
                            on_increments,
                            step_size,
                            count,
                            tolerance,
                        );
                        let at =
                            format!("{transfer}, BDF {p}, {on_increments}, h = {step_size}, {tolerance:e}");
                        let kernel = made.unwrap_or_else(|error| panic!("{at}: {error}"));
                        let exact =
                            multistep_weights(&transfer, order, step_size, on_increments, count).unwrap();
                        assert_eq!((kernel.step_size(), kernel.on_increments()), (step_size, on_increments));
                        let floor = 1e-9 * exact[0].abs() / kernel.head().len() as f64;
                        for n in (0..100).chain(lags(100, count as u64 - 1).map(|n| n as usize)) {
                            let error = (kernel.weight(n) - exact[n]).abs();
                            let lapse = kernel.exponentials().first().map_or(0.0, |e| e.rate) * n as f64;
                            let allowed = 2.0 * tolerance + (8.0 + 4.0 * lapse) * f64::EPSILON;
                            let allowed = allowed * exact[n].abs().max(floor);
                            assert!(error <= allowed, "{at}, {n}: {error:e} of {:e}", exact[n]);
                        }
                        assert!(
                            p > 4 || kernel.exponentials().len() < 120,
                            "{at}: {}",
                            kernel.exponentials().len()
                        );
                    }
                }
            }
        }
    }
}
