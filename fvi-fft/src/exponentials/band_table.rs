//! Tables of few exponentials for a band of frequencies: as accurate there as asked for, and no more.
//!
//! Of the symbol H(ω) = K(γ(e^{−iωh})/h) the first n₀ weights are exact, and what they leave is approximated,
//! relative to |H|, by decaying exponentials,
//!
//! ```text
//! (H(ω) − Σ_{n<n₀} w_n zⁿ)/z^{n₀} ≈ Σ_j a_j/(1 − ρ_j z) ,        z = e^{−iωh}, 0 < ρ_j < 1, f₁ ≤ ω/2π ≤ f₂ .
//! ```
//!
//! The endless table of the kernel is such a sum of many terms: a symmetric system whose matrix is diag ρ_j.
//! Its Gramian over the band, weighted by 1/|H|, is that of controllability and of observability at once, so
//! that its balanced truncation is an orthogonal projection, whose eigenvalues are real and lie between the
//! ρ_j. From there, and from rates in geometric sequence, Gauss–Newton steps change rates and coefficients
//! together, with weights that grow where the error is largest (Lawson's), until it is nearly the same at all
//! of its maxima. The number of exponentials is the smallest with which this reaches the tolerance.
//!
//! How far that is from the best: from 10⁻³ to 10⁻⁷ the error of s^½ over five decades falls by e^{0.77} an
//! exponential, where that of the best rational functions falls by at most e^{π²/ln(f₂/f₁)} = e^{0.86}; the
//! AAA algorithm, free to take complex poles, needs 12, 16, 23 and 30 of them for 10⁻², 10⁻³, 10⁻⁵ and 10⁻⁷,
//! these tables 7, 11, 16 and 23.
//!
//! Sources: \[Moore81\] for balanced truncation, \[Enns84\] with weights; \[Lawson61\].

use super::exponential_table::{ENDLESS, ExponentialKernel, ExponentialKernelError};
use crate::dense::{SingularValues, least_squares, symmetric_eigenvalues};
use crate::quadrature::exponential::Exponential;
use crate::quadrature::multistep_weights::multistep_weights;
use crate::transfer::TransferFunction;
use fvi_core::{BdfOrder, ParameterError, max_or_nan};
use nalgebra::{Complex, DMatrix, DVector};
use std::f64::consts::PI;

/// Range of the tolerance of a table for a band.
const TOLERANCES: [f64; 2] = [1e-7, 0.1];

/// Lowest frequency of a band, in sampling frequencies.
const LOWEST: f64 = 1e-10;

/// Lengths of the head that are tried.
const HEADS: [usize; 5] = [2, 5, 9, 17, 33];

/// Exponentials of a block of fvi-core, and multiply–adds of one, where a weight of the head is one.
const BLOCK: usize = 4;
const COST: usize = 2;

/// Tolerance of the table that is shortened.
const WHOLE: f64 = 1e-10;

/// Frequencies of the approximation for each decade, fewest and most of all, and of the check between two.
const A_DECADE: f64 = 40.0;
const FEWEST: usize = 120;
const MOST: usize = 480;
const CHECKED: usize = 5;

/// Rounds of the approximation, and error of its start, in tolerances, from which it is worth while.
const ROUNDS: usize = 60;
const WITHIN_REACH: f64 = 300.0;

/// The largest rate of a start, and the ratio of neighbouring rates that are added to those of a table.
const EDGE: f64 = 4.0;
const DENSITY: f64 = 1.3;

/// Part of the tolerance for the frequencies of the approximation.
const PART: f64 = 0.98;

/// Largest change of ln rate in a step, and largest rate times the length of the head.
const STRIDE: f64 = 0.5;
const FASTEST: f64 = 200.0;

/// How far a table is from its kernel over its band.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BandErrors {
    /// The band in Hz.
    pub band: [f64; 2],
    /// max |H̃/H − 1| for the symbol H of the weights.
    pub relative: f64,
    /// Largest error of the magnitude against that symbol, in dB, and of the phase, in degrees.
    pub of_symbol: [f64; 2],
    /// The same against K(iω) itself: with what the quadrature makes of it.
    pub of_operator: [f64; 2],
}

impl std::fmt::Display for BandErrors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { band: [low, high], relative, of_symbol, of_operator } = self;
        write!(
            f,
            "from {low} to {high} Hz within {relative:.1e} of the weights' symbol ({:.1e} dB, {:.1e} degrees) and within \
             {:.1e} dB, {:.1e} degrees of the operator",
            of_symbol[0], of_symbol[1], of_operator[0], of_operator[1]
        )
    }
}

/// A table for the frequencies from `band[0]` to `band[1]`, in Hz if `step_size` is in seconds, with the
/// fewest exponentials for which the relative error of the frequency response, against that of the weights
/// of [`ExponentialKernel::of_transfer`], is at most `tolerance` there. It has no end.
///
/// Below the band a derivative falls off like one of order 1; an integral, a kernel that grows towards ω = 0,
/// has an exponential that stays, so that it keeps integrating.
///
/// # Errors
/// As [`ExponentialKernel::of_transfer`]; if the band does not lie between 10⁻¹⁰ and ½ of the sampling
/// frequency, the tolerance not between 10⁻⁷ and 0.1; or if no table reaches it.
pub fn band_table(
    transfer: &TransferFunction,
    order: BdfOrder,
    on_increments: bool,
    step_size: f64,
    band: [f64; 2],
    tolerance: f64,
) -> Result<(ExponentialKernel, BandErrors), ExponentialKernelError> {
    check(band, step_size, tolerance)?;
    let [low, high] = band.map(|frequency| frequency * step_size);
    let whole = ExponentialKernel::of_transfer(transfer, order, on_increments, step_size, ENDLESS, WHOLE)?;
    let response = Response { transfer, order, step_size, on_increments };
    if whole.exponentials().is_empty() {
        let errors = response.errors(&whole, band);
        return Ok((whole, errors));
    }
    let cost = |head: usize, exponentials: usize| head + COST * BLOCK * exponentials.div_ceil(BLOCK);
    // A rational kernel has no more exponentials than poles.
    let errors = response.errors(&whole, band);
    let mut best = (errors.relative <= tolerance)
        .then(|| (cost(whole.head().len(), whole.exponentials().len()), whole.clone(), errors));
    let mut reached = f64::INFINITY;
    let mut before = usize::MAX;
    for length in HEADS {
        let head = multistep_weights(transfer, order, step_size, on_increments, length)?;
        let most = best.as_ref().map_or(usize::MAX, |(least, ..)| *least);
        if length >= most {
            break;
        }
        let target = Target::new(&response, &head, [low, high], &whole);
        let found = target.shortest(&whole, tolerance);
        reached = reached.min(found.as_ref().map_or_else(|error| *error, |_| tolerance));
        let Ok(exponentials) = found else { continue };
        let cost = cost(length, exponentials.len());
        let made = whole.with_tail(head, exponentials, tolerance);
        let errors = response.errors(&made, band);
        if errors.relative <= tolerance && cost < most {
            best = Some((cost, made, errors));
        } else if cost > before {
            break;
        }
        before = cost;
    }
    match best {
        Some((_, made, errors)) => Ok((made, errors)),
        None => Err(ExponentialKernelError::ToleranceMissed { tolerance, reached }),
    }
}

/// Errors with the band and the tolerance as they were given, whatever the unit of frequency is.
pub(super) fn check(band: [f64; 2], step_size: f64, tolerance: f64) -> Result<(), ParameterError> {
    let allowed = |accepted, parameter, value, allowed| {
        if accepted { Ok(()) } else { Err(ParameterError { parameter, value, allowed }) }
    };
    let [low, high] = band.map(|frequency| frequency * step_size);
    allowed(low >= LOWEST, "lower end of the band", band[0], "at least 1e-10 of the sampling frequency")?;
    let range = "above the lower end, and at most half of the sampling frequency";
    allowed(low < high && high <= 0.5, "upper end of the band", band[1], range)?;
    let [least, most] = TOLERANCES;
    let range = "at least 1e-7 and at most 0.1 over a band";
    allowed((least..=most).contains(&tolerance), "tolerance", tolerance, range)
}

/// A kernel over frequencies.
struct Response<'a> {
    transfer: &'a TransferFunction,
    order: BdfOrder,
    step_size: f64,
    on_increments: bool,
}

/// 1 − e^{−i2πx} for x turns, without cancellation, and e^{−i2πx}.
fn turned(turns: f64) -> [Complex<f64>; 2] {
    let (sine, cosine) = (libm::sin(PI * turns), libm::cos(PI * turns));
    let fallen = Complex::new(2.0 * sine * sine, 2.0 * sine * cosine);
    [fallen, Complex::new(1.0 - fallen.re, -fallen.im)]
}

/// γ(z)/h = Σ_{i≤p} (1 − z)^i/i/h
fn slope(order: BdfOrder, fallen: Complex<f64>, step_size: f64) -> Complex<f64> {
    let series = (1..=order.get()).rev().fold(Complex::ZERO, |sum, i| fallen * (sum + 1.0 / i as f64));
    series / step_size
}

impl Response<'_> {
    /// The symbol of the weights at x turns a step; on increments divided by 1 − z.
    fn symbol(&self, turns: f64) -> Complex<f64> {
        let [fallen, _] = turned(turns);
        let symbol = self.transfer.value(slope(self.order, fallen, self.step_size));
        if self.on_increments { symbol / fallen } else { symbol }
    }

    fn errors(&self, table: &ExponentialKernel, band: [f64; 2]) -> BandErrors {
        let [low, high] = band.map(|frequency| frequency * self.step_size);
        let count = CHECKED * points(low, high);
        let mut errors = BandErrors { band, relative: 0.0, of_symbol: [0.0; 2], of_operator: [0.0; 2] };
        for turns in spread(low, high, count) {
            let [fallen, _] = turned(turns);
            let found = response_of(table, turns);
            let known = self.symbol(turns);
            let operator = self.transfer.value(Complex::new(0.0, 2.0 * PI * turns / self.step_size));
            let beside = if self.on_increments { operator / fallen } else { operator };
            let apart = |known: Complex<f64>| {
                let ratio = found / known;
                [20.0 * libm::log10(ratio.norm()), libm::atan2(ratio.im, ratio.re).to_degrees()].map(f64::abs)
            };
            errors.relative = max_or_nan(errors.relative, (found / known - 1.0).norm());
            for (largest, known) in [(&mut errors.of_symbol, known), (&mut errors.of_operator, beside)] {
                let [size, phase] = apart(known);
                *largest = [max_or_nan(largest[0], size), max_or_nan(largest[1], phase)];
            }
        }
        errors
    }
}

/// Frequency response of a table at x turns a step.
fn response_of(table: &ExponentialKernel, turns: f64) -> Complex<f64> {
    let [fallen, z] = turned(turns);
    let head = table.head().iter().rev().fold(Complex::ZERO, |sum: Complex<f64>, weight| sum * z + weight);
    let first = table.head().len() as f64;
    let tail = table.exponentials().iter().map(|e| {
        let decay = -libm::expm1(-e.rate);
        Complex::new(e.coefficient * libm::exp(-e.rate * first), 0.0) / distance(decay, fallen)
    });
    head + tail.sum::<Complex<f64>>() * z.powu(table.head().len() as u32)
}

/// 1 − ρ z = (1 − z) + μ z for ρ = 1 − μ.
fn distance(decay: f64, fallen: Complex<f64>) -> Complex<f64> {
    fallen * (1.0 - decay) + decay
}

fn points(low: f64, high: f64) -> usize {
    ((A_DECADE * libm::log10(high / low)) as usize).clamp(FEWEST, MOST)
}

fn spread(low: f64, high: f64, count: usize) -> impl Iterator<Item = f64> {
    (0..=count).map(move |k| (low * libm::pow(high / low, k as f64 / count as f64)).min(high))
}

/// What a tail has to be at the frequencies of the approximation.
struct Target {
    /// 1 − z, and z.
    places: Vec<[Complex<f64>; 2]>,
    values: Vec<Complex<f64>>,
    /// 1/|H|
    weights: Vec<f64>,
    head: usize,
    /// Rate of the exponential that stays.
    standing: Option<f64>,
}

/// An approximation: its largest relative error, ln of the rates, and the values at the end of the head, that
/// of the exponential that stays last.
#[derive(Clone)]
struct Fit {
    error: f64,
    rates: Vec<f64>,
    values: Vec<f64>,
}

impl Target {
    fn new(response: &Response<'_>, head: &[f64], [low, high]: [f64; 2], whole: &ExponentialKernel) -> Self {
        let turns: Vec<f64> = spread(low, high, points(low, high)).collect();
        let places: Vec<_> = turns.iter().map(|&turns| turned(turns)).collect();
        let symbols: Vec<_> = turns.iter().map(|&turns| response.symbol(turns)).collect();
        let left = |(symbol, [_, z]): (&Complex<f64>, &[Complex<f64>; 2])| {
            let near = head.iter().rev().fold(Complex::ZERO, |sum: Complex<f64>, weight| sum * z + weight);
            (symbol - near) / z.powu(head.len() as u32)
        };
        // Towards ω = 0 an integral grows.
        let size = |turns: f64| {
            let [fallen, _] = turned(turns);
            (response.symbol(turns) * if response.on_increments { fallen } else { Complex::from(1.0) }).norm()
        };
        let integrates = size(1e-4 * low) > 1.001 * size(1e-3 * low);
        let slowest = whole.exponentials().first().map(|e| e.rate);
        Self {
            values: symbols.iter().zip(&places).map(left).collect(),
            places,
            weights: symbols.iter().map(|symbol| symbol.norm().recip()).collect(),
            head: head.len(),
            standing: slowest.filter(|rate| integrates && *rate < 1e-3 * low),
        }
    }

    /// The shortest tail within the tolerance.
    ///
    /// # Errors
    /// The least error reached.
    fn shortest(&self, whole: &ExponentialKernel, tolerance: f64) -> Result<Vec<Exponential>, f64> {
        let mut reached = f64::INFINITY;
        let states = self.states(whole);
        let Some(directions) = self.directions(&states) else { return Err(reached) };
        let most = directions.ncols().min(self.places.len() / 4);
        for count in 1..=most {
            let starts = [truncated(&states, &directions, count, self.head), Some(self.spread_rates(count))];
            for start in starts.into_iter().flatten() {
                let Some(found) = self.approximated(start, PART * tolerance) else { continue };
                reached = reached.min(found.error);
                if found.error <= PART * tolerance {
                    return Ok(self.exponentials(&found));
                }
            }
        }
        Err(reached)
    }

    /// Rates, and values at the end of the head, of the exponentials of a table, and of faster ones that its
    /// own head, which is longer, has made unnecessary.
    fn states(&self, whole: &ExponentialKernel) -> Vec<[f64; 2]> {
        let at = |rate: f64, coefficient: f64| [rate, coefficient * libm::exp(-rate * self.head as f64)];
        let mut states: Vec<_> = whole.exponentials().iter().map(|e| at(e.rate, e.coefficient)).collect();
        if let Some(fastest) = whole.exponentials().last() {
            let next = |rate: &f64| Some(rate * DENSITY);
            let faster = std::iter::successors(Some(fastest.rate * DENSITY), next);
            let coefficient = |rate: f64| fastest.coefficient * rate / fastest.rate;
            states
                .extend(faster.take_while(|rate| *rate < 2.0 * EDGE).map(|rate| at(rate, coefficient(rate))));
        }
        states
    }

    /// ln of rates in geometric sequence over the band.
    fn spread_rates(&self, count: usize) -> Vec<f64> {
        let [low, high] =
            [self.places.first().map_or(EDGE, |[fallen, _]| fallen.norm()), EDGE].map(libm::log);
        (0..count).map(|k| low + (high - low) * (k as f64 + 0.5) / count as f64).collect()
    }

    /// Singular vectors of states over the band, the strongest first.
    fn directions(&self, states: &[[f64; 2]]) -> Option<DMatrix<f64>> {
        let mut matrix = DMatrix::zeros(states.len(), 2 * self.places.len());
        for (row, [rate, value]) in states.iter().enumerate() {
            let size = libm::sqrt(value.abs());
            for (k, ([fallen, _], weight)) in self.places.iter().zip(&self.weights).enumerate() {
                let state = distance(-libm::expm1(-rate), *fallen).inv() * (size * weight);
                (matrix[(row, 2 * k)], matrix[(row, 2 * k + 1)]) = (state.re, state.im);
            }
        }
        Some(SingularValues::of(matrix)?.u)
    }

    /// Columns 1/(1 − ρ z), and derivatives by ln rate.
    fn columns(&self, rates: &[f64]) -> [Vec<Vec<Complex<f64>>>; 2] {
        let column = |&rate: &f64| -> Vec<Complex<f64>> {
            let decay = -libm::expm1(-libm::exp(rate));
            self.places.iter().map(|[fallen, _]| distance(decay, *fallen).inv()).collect()
        };
        let values: Vec<_> = rates.iter().map(column).collect();
        let slopes = rates.iter().zip(&values).map(|(rate, column)| {
            let rate = libm::exp(*rate);
            let factor = -rate * libm::exp(-rate);
            column.iter().zip(&self.places).map(|(value, [_, z])| value * value * z * factor).collect()
        });
        let slopes = slopes.collect();
        let mut values = values;
        values.extend(self.standing.map(|rate| column(&rate.ln())));
        [values, slopes]
    }

    /// Real and imaginary parts, each times the weight of its frequency.
    fn rows(column: &[Complex<f64>], weights: &[f64]) -> Vec<f64> {
        column
            .iter()
            .zip(weights)
            .flat_map(|(value, weight)| [value.re * weight, value.im * weight])
            .collect()
    }

    /// The best coefficients for these rates, and what they leave.
    fn with_rates(&self, rates: &[f64], weights: &[f64]) -> Option<(Vec<f64>, Vec<Complex<f64>>)> {
        let [columns, _] = self.columns(rates);
        let flat: Vec<f64> = columns.iter().flat_map(|column| Self::rows(column, weights)).collect();
        let matrix = DMatrix::from_vec(2 * self.places.len(), columns.len(), flat);
        let values = least_squares(matrix, &DVector::from_vec(Self::rows(&self.values, weights)))?;
        let mut left = self.values.clone();
        for (column, value) in columns.iter().zip(&values) {
            left.iter_mut().zip(column).for_each(|(left, entry)| *left -= entry * *value);
        }
        Some((values, left))
    }

    /// A Gauss–Newton step of rates and coefficients together, damped.
    fn step(&self, fit: &Fit, left: &[Complex<f64>], weights: &[f64], damping: f64) -> Option<Vec<f64>> {
        let [columns, slopes] = self.columns(&fit.rates);
        let scaled = slopes.iter().zip(&fit.values);
        let scaled =
            scaled.map(|(slope, value)| slope.iter().map(|entry| entry * *value).collect::<Vec<_>>());
        let all: Vec<Vec<f64>> = columns.into_iter().chain(scaled).map(|c| Self::rows(&c, weights)).collect();
        let (rows, count) = (2 * self.places.len(), all.len());
        let mut matrix = DMatrix::zeros(rows + count, count);
        let mut sizes = Vec::new();
        for (j, column) in all.iter().enumerate() {
            let size = libm::sqrt(column.iter().map(|x| x * x).sum::<f64>()).max(f64::MIN_POSITIVE);
            column.iter().enumerate().for_each(|(i, x)| matrix[(i, j)] = x / size);
            matrix[(rows + j, j)] = libm::sqrt(damping);
            sizes.push(size);
        }
        let mut right = DVector::zeros(rows + count);
        Self::rows(left, weights).into_iter().enumerate().for_each(|(i, x)| right[i] = x);
        let change = least_squares(matrix, &right)?;
        let first = count - fit.rates.len();
        let most = libm::log(FASTEST / self.head as f64);
        let moved = fit.rates.iter().zip(&change[first..]).zip(&sizes[first..]);
        Some(moved.map(|((rate, d), size)| (rate + (d / size).clamp(-STRIDE, STRIDE)).min(most)).collect())
    }

    /// The approximation from a start, until its largest error is at most `enough`.
    fn approximated(&self, start: Vec<f64>, enough: f64) -> Option<Fit> {
        let mut lawson = vec![1.0; self.places.len()];
        let mut damping = 1e-3;
        let mut rates = start;
        let mut best: Option<Fit> = None;
        let error = |left: &[Complex<f64>]| -> Vec<f64> {
            left.iter().zip(&self.weights).map(|(left, weight)| left.norm() * weight).collect()
        };
        for round in 0..ROUNDS {
            let weights: Vec<f64> = lawson.iter().zip(&self.weights).map(|(a, b)| a * b).collect();
            let cost = |left: &[Complex<f64>]| -> f64 {
                left.iter().zip(&weights).map(|(left, weight)| left.norm_sqr() * weight * weight).sum()
            };
            let (values, mut left) = self.with_rates(&rates, &weights)?;
            let largest = error(&left).into_iter().fold(0.0, max_or_nan);
            let fit = Fit { error: largest, rates: rates.clone(), values };
            if best.as_ref().is_none_or(|best| largest < best.error) {
                best = Some(fit.clone());
            }
            let hopeless = largest.is_nan() || largest > WITHIN_REACH * enough;
            if largest <= enough || round == 0 && hopeless {
                break;
            }
            let before = cost(&left);
            for _ in 0..8 {
                let moved = self.step(&fit, &left, &weights, damping)?;
                let tried = self.with_rates(&moved, &weights)?;
                if cost(&tried.1) < before {
                    (rates, left) = (moved, tried.1);
                    damping = f64::max(0.2 * damping, 1e-12);
                    break;
                }
                damping = f64::min(5.0 * damping, 1e3);
            }
            let errors = error(&left);
            let largest = errors.iter().copied().fold(0.0, max_or_nan);
            lawson.iter_mut().zip(&errors).for_each(|(x, error)| *x *= libm::sqrt(error / largest + 1e-3));
            let most = lawson.iter().copied().fold(0.0, max_or_nan);
            lawson.iter_mut().for_each(|x| *x /= most);
        }
        best
    }

    fn exponentials(&self, fit: &Fit) -> Vec<Exponential> {
        let rates = fit.rates.iter().map(|rate| libm::exp(*rate)).chain(self.standing);
        let at = |(rate, value): (f64, &f64)| Exponential {
            rate,
            coefficient: value * libm::exp(rate * self.head as f64),
        };
        let mut exponentials: Vec<_> = rates.zip(&fit.values).map(at).collect();
        exponentials.sort_by(|a, b| a.rate.total_cmp(&b.rate));
        exponentials
    }
}

/// ln of the rates of the balanced truncation with `count` states.
fn truncated(states: &[[f64; 2]], directions: &DMatrix<f64>, count: usize, head: usize) -> Option<Vec<f64>> {
    let kept = directions.columns(0, count).into_owned();
    let mut scaled = kept.clone();
    for (mut row, [rate, _]) in scaled.row_iter_mut().zip(states) {
        row *= -libm::expm1(-rate);
    }
    let decays = symmetric_eigenvalues(kept.tr_mul(&scaled));
    let most = FASTEST / head as f64;
    let rate = |decay: &f64| -libm::log1p(-decay.clamp(1e-15, 1.0 - 1e-8));
    decays
        .iter()
        .all(|decay| decay.is_finite())
        .then(|| decays.iter().map(|decay| libm::log(rate(decay).min(most))).collect())
}
