//! Fast and oblivious convolution quadrature.

use std::f64::consts::PI;

use fvi_core::{Memory, MemoryError, ParameterError, Stateful};
use fvi_fft::sums::max_or_nan;
use nalgebra::Complex;

use crate::dyadic_exponentials::lags_to_compare;
use crate::frame::{Frame, framed, leading_of};
use crate::operations::Operations;
use crate::product::{product, sum};

/// B: the lags of a contour are B times as long as those of the contour before.
const BASE: usize = 8;
/// Most points on the upper half of a contour.
const MOST_POINTS: usize = 48;
/// Half the angle between the asymptotes of a hyperbola and the imaginary axis.
const ANGLES: [f64; 2] = [0.65, 0.9];

/// Convolution quadrature of implicit Euler with weights from contour integrals and a state that grows with
/// the logarithm of time: O(log N) a step, O(log N) numbers \[SchädleLFLubich06\].
///
/// w_n = (1/2πi) ∫ K(λ/h) (1 − λ)^{−n−1} dλ over hyperbolas around the negative real axis, one for the lags
/// B^{ℓ−1} … 2B^ℓ of each level ℓ; the lags below 2B are summed directly. After k samples, level ℓ sums those
/// with index from (⌊k/B^ℓ⌋ − 1) B^ℓ up to (⌊k/B^{ℓ−1}⌋ − 1) B^{ℓ−1}. Each node of its contour stores
/// decaying sums for the current and the previous block of B^ℓ samples, and for the current and the previous
/// block of B^{ℓ−1} samples, which are not due yet; so whole blocks can be discarded.
///
/// Choices made here: B = 8; hyperbola, step and number of points of each level by search, with the smallest
/// number of points for which the resulting weights agree with those of the quadrature within the relative
/// `tolerance` (half of it at the lags that are checked).
#[derive(Clone, Debug)]
pub struct ObliviousQuadrature {
    frame: Frame,
    /// w_{2B−1} … w_1
    near: Vec<f64>,
    /// For each channel the samples of the last 2B steps, oldest first.
    recent: Vec<Vec<f64>>,
    levels: Vec<Level>,
    operations: Operations,
}

/// Complex numbers with real and imaginary parts in separate arrays.
#[derive(Clone, Debug, Default)]
struct Parts {
    re: Vec<f64>,
    im: Vec<f64>,
}

impl Parts {
    fn zeros(count: usize) -> Self {
        Self { re: vec![0.0; count], im: vec![0.0; count] }
    }

    fn of(numbers: &[Complex<f64>]) -> Self {
        Self { re: numbers.iter().map(|z| z.re).collect(), im: numbers.iter().map(|z| z.im).collect() }
    }

    fn fill_zero(&mut self) {
        self.re.fill(0.0);
        self.im.fill(0.0);
    }

    /// self = factor · (self + real)
    #[inline(always)]
    fn decay(&mut self, factor: &Self, real: f64) {
        let factors = factor.re.iter().zip(&factor.im);
        for ((re, im), (a, b)) in self.re.iter_mut().zip(&mut self.im).zip(factors) {
            let (x, y) = (*re + real, *im);
            *re = a * x - b * y;
            *im = a * y + b * x;
        }
    }

    fn add(&mut self, other: &Self) {
        self.re.iter_mut().zip(&other.re).for_each(|(a, b)| *a += b);
        self.im.iter_mut().zip(&other.im).for_each(|(a, b)| *a += b);
    }

    fn bytes(&self) -> usize {
        (self.re.capacity() + self.im.capacity()) * size_of::<f64>()
    }
}

/// Level ℓ, for the lags B^{ℓ−1} < n < 2B^ℓ.
#[derive(Clone, Debug)]
struct Level {
    /// b = B^{ℓ−1}
    block: usize,
    /// For each node: ρ = 1/(1 − λ), ρ^b, and the factor of ρⁿ.
    decays: Parts,
    block_decays: Parts,
    factors: Parts,
    channels: Vec<Sums>,
}

/// Sums Σ ρ^{t−i} x_i of one channel at the nodes of a contour, over different blocks of samples and up to
/// different times t.
#[derive(Clone, Debug)]
struct Sums {
    /// Over the current block of b samples; t is the current time.
    gathering: Parts,
    /// Over the previous block of b samples; t is its end.
    waiting: Parts,
    /// Over the previous block of B b samples (`old`), and over the part of the current one that is due
    /// (`new`); t is the last multiple of b.
    old: Parts,
    new: Parts,
    /// `old` + `new` times the factors of the nodes; t is the current time.
    due: Parts,
}

impl Sums {
    fn new(count: usize) -> Self {
        let zeros = || Parts::zeros(count);
        Self { gathering: zeros(), waiting: zeros(), old: zeros(), new: zeros(), due: zeros() }
    }

    fn all(&mut self) -> [&mut Parts; 5] {
        [&mut self.gathering, &mut self.waiting, &mut self.old, &mut self.new, &mut self.due]
    }
}

impl Level {
    /// Takes a sample; `known` is the number of samples up to and with it.
    #[inline(always)]
    fn push(&mut self, channel: usize, sample: f64, known: usize) {
        let sums = &mut self.channels[channel];
        sums.gathering.decay(&self.decays, sample);
        if !known.is_multiple_of(self.block) {
            sums.due.decay(&self.decays, 0.0);
            return;
        }
        let parent = self.block * BASE;
        sums.waiting.decay(&self.block_decays, 0.0);
        sums.old.decay(&self.block_decays, 0.0);
        sums.new.decay(&self.block_decays, 0.0);
        if known.is_multiple_of(parent) {
            std::mem::swap(&mut sums.old, &mut sums.new);
            sums.new.fill_zero();
        }
        // `waiting` belongs to the previous parent block until the first block of the current parent is
        // complete.
        let into = if known % parent <= self.block { &mut sums.old } else { &mut sums.new };
        into.add(&sums.waiting);
        std::mem::swap(&mut sums.waiting, &mut sums.gathering);
        sums.gathering.fill_zero();
        sums.due.clone_from(&sums.old);
        sums.due.add(&sums.new);
        sums.due.decay(&self.factors, 0.0);
    }

    fn bytes(&self) -> usize {
        let sums = |sums: &Sums| -> usize {
            [&sums.gathering, &sums.waiting, &sums.old, &sums.new, &sums.due].map(Parts::bytes).iter().sum()
        };
        let states: usize = self.channels.iter().map(sums).sum();
        states + [&self.decays, &self.block_decays, &self.factors].map(Parts::bytes).iter().sum::<usize>()
    }
}

impl ObliviousQuadrature {
    /// A memory for K(s) = `symbol` with implicit Euler at step h; `weights` are its quadrature weights w_0
    /// …, with which those from the contours are compared.
    ///
    /// # Errors
    /// If no contour reaches the tolerance, such as for K with singularities off the negative real axis, or
    /// there is no weight, channel or capacity.
    pub fn new(
        symbol: &dyn Fn(Complex<f64>) -> Complex<f64>,
        weights: &[f64],
        step: f64,
        channels: usize,
        capacity: usize,
        tolerance: f64,
    ) -> Result<Self, ParameterError> {
        let frame = Frame::new(channels, capacity, leading_of(weights)?)?;
        if !(step > 0.0 && step.is_finite()) {
            return Err(ParameterError { parameter: "step", value: step, allowed: "positive and finite" });
        }
        if weights.len() < capacity {
            let allowed = "as many as the capacity";
            let value = weights.len() as f64;
            return Err(ParameterError { parameter: "number of weights", value, allowed });
        }
        let lags = (2 * BASE - 1).min(capacity.max(2) - 1).min(weights.len() - 1);
        let mut levels = Vec::new();
        let mut block = BASE;
        // Level ℓ = log_B(block) + 1 has the lags up to 2·B·block.
        while 2 * block <= capacity {
            let wanted = (block + 1, (2 * BASE * block - 1).min(capacity - 1));
            let nodes = contour(symbol, weights, step, wanted, tolerance)?;
            let power = block as i32;
            let block_decays: Vec<_> = nodes.iter().map(|node| node.decay.powi(power)).collect();
            levels.push(Level {
                block,
                decays: Parts::of(&nodes.iter().map(|node| node.decay).collect::<Vec<_>>()),
                block_decays: Parts::of(&block_decays),
                factors: Parts::of(&nodes.iter().map(|node| node.factor).collect::<Vec<_>>()),
                channels: vec![Sums::new(nodes.len()); channels],
            });
            block *= BASE;
        }
        Ok(Self {
            frame,
            near: weights[1..=lags].iter().rev().copied().collect(),
            recent: vec![Vec::with_capacity(4 * BASE); channels],
            levels,
            operations: Operations::default(),
        })
    }

    /// The counter of its operations.
    pub fn operations(&self) -> Operations {
        self.operations.clone()
    }

    /// Number of nodes on all contours.
    pub fn nodes(&self) -> usize {
        self.levels.iter().map(|level| level.decays.re.len()).sum()
    }
}

/// w_n ≈ Σ Im(factor · decayⁿ)
#[derive(Clone, Copy, Debug)]
struct Node {
    decay: Complex<f64>,
    factor: Complex<f64>,
}

/// The nodes for a range of lags.
fn contour(
    symbol: &dyn Fn(Complex<f64>) -> Complex<f64>,
    weights: &[f64],
    step: f64,
    (first, last): (usize, usize),
    tolerance: f64,
) -> Result<Vec<Node>, ParameterError> {
    let refused = |allowed| Err(ParameterError { parameter: "tolerance", value: tolerance, allowed });
    if !(tolerance > 0.0 && tolerance < 1.0) {
        return refused("greater than 0 and less than 1");
    }
    let mut lags: Vec<usize> = lags_to_compare(last).into_iter().filter(|&n| n >= first).collect();
    lags.push(first);
    // Weights may pass through zero: errors are relative to the largest weight from this lag on.
    let mut largest = 0.0_f64;
    let mut envelope = vec![0.0; last + 1];
    for n in (first..=last).rev() {
        largest = largest.max(weights[n].abs());
        envelope[n] = largest;
    }
    let error = |nodes: &[Node]| {
        let of = |&n: &usize| {
            let sum: f64 = nodes.iter().map(|node| (node.factor * node.decay.powi(n as i32)).im).sum();
            let error = (sum - weights[n]).abs();
            if error == 0.0 { 0.0 } else { error / envelope[n] }
        };
        lags.iter().map(of).fold(0.0, max_or_nan)
    };
    let digits = -libm::log(tolerance) + 2.0;
    for points in (4..=MOST_POINTS).step_by(2) {
        for angle in ANGLES {
            for reach in [1.0, 2.0, 3.0, 4.5, 6.5, 9.0, 12.0, 16.0] {
                let scale = reach / last as f64;
                // The last point, where the decay over the first lag is below rounding.
                let fall = (libm::expm1(digits / first as f64) / scale + 1.0) / angle.sin();
                let end = libm::acosh(fall.max(1.1));
                for share in [0.8, 1.0] {
                    let nodes = hyperbola(symbol, step, scale, angle, share * end / points as f64, points);
                    if error(&nodes) <= 0.5 * tolerance {
                        return Ok(nodes);
                    }
                }
            }
        }
    }
    refused("what contours around the negative real axis reach for this kernel")
}

/// λ(θ) = μ(1 − sin α cosh θ + i cos α sinh θ) at θ = (j + ½)τ: the upper half.
fn hyperbola(
    symbol: &dyn Fn(Complex<f64>) -> Complex<f64>,
    step: f64,
    scale: f64,
    angle: f64,
    spacing: f64,
    points: usize,
) -> Vec<Node> {
    let (sine, cosine) = (angle.sin(), angle.cos());
    let node = |j: usize| {
        let theta = (j as f64 + 0.5) * spacing;
        let (sinh, cosh) = (libm::sinh(theta), libm::cosh(theta));
        let place = Complex::new(scale * (1.0 - sine * cosh), scale * cosine * sinh);
        let derivative = Complex::new(-scale * sine * sinh, scale * cosine * cosh);
        let decay = Complex::new(1.0, 0.0) / (Complex::new(1.0, 0.0) - place);
        Node { decay, factor: symbol(place / step) * derivative * decay * (spacing / PI) }
    };
    (0..points).map(node).collect()
}

impl Memory<f64> for ObliviousQuadrature {
    framed!();

    #[inline(always)]
    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        self.frame.check(term)?;
        let k = self.frame.len;
        // From the multiple of B before the last one.
        let lags = k - (k / BASE).saturating_sub(1) * BASE;
        let lags = lags.min(self.near.len());
        let weights = &self.near[self.near.len() - lags..];
        for (channel, number) in term.iter_mut().enumerate() {
            let recent = &self.recent[channel];
            *number = product(weights, &recent[recent.len() - lags..]);
            for level in &self.levels {
                *number += sum(&level.channels[channel].due.im);
            }
        }
        let nodes: usize = self.levels.iter().map(|level| level.decays.re.len()).sum();
        self.operations.add((2 * lags + nodes) * self.frame.channels);
        Ok(())
    }

    #[inline(always)]
    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.frame.check(sample)?;
        self.frame.len += 1;
        let known = self.frame.len;
        for (channel, &number) in sample.iter().enumerate() {
            let recent = &mut self.recent[channel];
            if recent.len() == 4 * BASE {
                recent.copy_within(2 * BASE.., 0);
                recent.truncate(2 * BASE);
            }
            recent.push(number);
            for level in &mut self.levels {
                level.push(channel, number, known);
            }
        }
        let mut operations = 0;
        for level in &self.levels {
            let due = if known.is_multiple_of(level.block) { 6 * 4 + 4 } else { 6 };
            operations += (7 + due) * level.decays.re.len();
        }
        self.operations.add(operations * self.frame.channels);
        Ok(())
    }

    fn clear(&mut self) {
        self.frame.len = 0;
        self.recent.iter_mut().for_each(Vec::clear);
        let sums = self.levels.iter_mut().flat_map(|level| &mut level.channels);
        sums.flat_map(Sums::all).for_each(Parts::fill_zero);
        self.operations.clear();
    }

    fn bytes(&self) -> usize {
        let recent = self.near.capacity() + self.recent.iter().map(Vec::capacity).sum::<usize>();
        let levels = self.levels.iter().map(Level::bytes).sum::<usize>();
        size_of::<Self>() + recent * size_of::<f64>() + levels
    }
}

impl Stateful for ObliviousQuadrature {}
