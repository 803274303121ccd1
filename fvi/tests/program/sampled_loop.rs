//! Sampled loops by state-space arithmetic of their own: nothing of the program's takes part.

use crate::tune::Complex;
use fvi_core::min_or_nan;
use fvi_fft::sums::max_or_nan;
use serde_json::Value;
use std::f64::consts::PI;

const ONE: Complex = Complex(1.0, 0.0);

type Matrix = Vec<Vec<f64>>;

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let sum = |row: &Vec<f64>, j: usize| row.iter().zip(b).map(|(x, line)| x * line[j]).sum();
    a.iter().map(|row| (0..b[0].len()).map(|j| sum(row, j)).collect()).collect()
}

fn unit(size: usize, scale: f64) -> Matrix {
    (0..size).map(|i| (0..size).map(|j| if i == j { scale } else { 0.0 }).collect()).collect()
}

fn plus(a: &Matrix, b: &Matrix, scale: f64) -> Matrix {
    a.iter().zip(b).map(|(x, y)| x.iter().zip(y).map(|(x, y)| x + scale * y).collect()).collect()
}

/// ∫₀ᵗ e^{As} ds, by its series over t/2ⁿ and doublings Φ(2t) = Φ(t) (2 + A Φ(t)).
fn held(a: &Matrix, time: f64) -> Matrix {
    let size = a.len();
    let largest = a.iter().map(|row| row.iter().map(|x| x.abs()).sum()).fold(0.0, max_or_nan);
    let doublings = (largest * time / 0.1).log2().ceil().max(0.0) as i32;
    let short = time / 2f64.powi(doublings);
    let mut term = unit(size, short);
    let mut sum = term.clone();
    for k in 2..16 {
        term = product(a, &term);
        term.iter_mut().flatten().for_each(|x| *x *= short / f64::from(k));
        sum = plus(&sum, &term, 1.0);
    }
    for _ in 0..doublings {
        sum = product(&sum, &plus(&unit(size, 2.0), &product(a, &sum), 1.0));
    }
    sum
}

/// Determinant and solution of M x = b by elimination.
fn solved(mut m: Vec<Vec<Complex>>, mut b: Vec<Complex>) -> (Complex, Vec<Complex>) {
    let size = b.len();
    let mut determinant = ONE;
    for k in 0..size {
        let pivot = (k..size).max_by(|&i, &j| m[i][k].size().total_cmp(&m[j][k].size())).unwrap();
        if pivot != k {
            m.swap(pivot, k);
            b.swap(pivot, k);
            determinant = determinant.scaled(-1.0);
        }
        determinant = determinant.times(m[k][k]);
        let inverse = m[k][k].inverse();
        for i in k + 1..size {
            let factor = m[i][k].times(inverse).scaled(-1.0);
            let pivot = m[k].clone();
            m[i].iter_mut().zip(pivot).skip(k).for_each(|(x, y)| *x = x.plus(factor.times(y)));
            b[i] = b[i].plus(factor.times(b[k]));
        }
    }
    for k in (0..size).rev() {
        let known = (k + 1..size).fold(Complex(0.0, 0.0), |sum, j| sum.plus(m[k][j].times(b[j])));
        b[k] = b[k].plus(known.scaled(-1.0)).times(m[k][k].inverse());
    }
    (determinant, b)
}

/// A plant: a product of polynomials in s with ascending coefficients over another, behind a dead time.
#[derive(Clone, Debug)]
pub(crate) struct Rational {
    pub(crate) gain: f64,
    pub(crate) above: Vec<Vec<f64>>,
    pub(crate) below: Vec<Vec<f64>>,
    pub(crate) delay: f64,
}

impl Rational {
    /// In the notation of `plant.transfer`.
    pub(crate) fn formula(&self) -> String {
        let polynomial = |factor: &Vec<f64>| {
            let terms = factor.iter().enumerate().map(|(power, x)| format!("({x:?})*s^{power}"));
            format!("*({})", terms.collect::<Vec<_>>().join(" + ").replace("*s^0", ""))
        };
        let [above, below] =
            [&self.above, &self.below].map(|of| of.iter().map(polynomial).collect::<String>());
        let delay = if self.delay > 0.0 { format!("*exp(-{:?}*s)", self.delay) } else { String::new() };
        format!("{:?}{above}/(1{below}){delay}", self.gain)
    }

    /// P(iω), with its dead time.
    pub(crate) fn at(&self, omega: f64) -> Complex {
        let s = Complex(0.0, omega);
        let value = |factors: &[Vec<f64>]| {
            factors.iter().fold(ONE, |value, factor| {
                let sum = |sum: Complex, &x: &f64| sum.times(s).plus(Complex(x, 0.0));
                value.times(factor.iter().rev().fold(Complex(0.0, 0.0), sum))
            })
        };
        let turned = Complex((omega * self.delay).cos(), -(omega * self.delay).sin());
        value(&self.above).times(value(&self.below).inverse()).times(turned).scaled(self.gain)
    }

    /// A and c of ẋ = A x + e_n u, y = c x.
    fn states(&self) -> (Matrix, Vec<f64>) {
        let expanded = |factors: &[Vec<f64>]| {
            factors.iter().fold(vec![1.0], |known, factor| {
                let mut next = vec![0.0; known.len() + factor.len() - 1];
                for (i, x) in known.iter().enumerate() {
                    for (j, y) in factor.iter().enumerate() {
                        next[i + j] += x * y;
                    }
                }
                next
            })
        };
        let (above, below) = (expanded(&self.above), expanded(&self.below));
        let size = below.len() - 1;
        assert!(above.len() <= size, "the plant does not decay");
        let shift = |i: usize, j: usize| f64::from(u8::from(j == i + 1));
        let entry = |i: usize, j: usize| if i + 1 < size { shift(i, j) } else { -below[j] / below[size] };
        let a = (0..size).map(|i| (0..size).map(|j| entry(i, j)).collect()).collect();
        let c = (0..size).map(|i| self.gain * above.get(i).unwrap_or(&0.0) / below[size]).collect();
        (a, c)
    }
}

/// A law in the parallel form, with a filter of order 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gains {
    pub(crate) kp: f64,
    pub(crate) ki: f64,
    pub(crate) lambda: f64,
    pub(crate) kd: f64,
    pub(crate) mu: f64,
    pub(crate) filter: f64,
}

impl Gains {
    pub(crate) fn of(record: &Value) -> Self {
        let number = |key: &str| record[key].as_f64().unwrap();
        let filter = record["derivative_filter"]["time"].as_f64().unwrap_or(0.0);
        let [kp, ki, lambda, kd, mu] = ["kp", "ki", "lambda", "kd", "mu"].map(number);
        Self { kp, ki, lambda, kd, mu, filter }
    }
}

/// What a sampled loop reaches.
#[derive(Clone, Debug)]
pub(crate) struct Reached {
    pub(crate) ms: f64,
    pub(crate) mt: f64,
    /// The least phase margin of all crossovers in degrees; infinite without a crossover.
    pub(crate) phase_margin: f64,
    pub(crate) highest_crossover: f64,
    /// Motions of the closed loop that grow.
    pub(crate) growing: f64,
}

/// A plant behind a zero-order hold, and a law that ticks with backward differences.
///
/// With L = d h + τ the state advances by e^{Ah}, by the input of d + 1 ticks before over τ, and by that of d
/// ticks before over the rest.
pub(crate) struct SampledLoop {
    sample: f64,
    /// (e^{Ah} − 1)/h, and c.
    slope: Matrix,
    c: Vec<f64>,
    /// Columns of the inputs d and d + 1 ticks before, divided by h.
    inputs: [Vec<f64>; 2],
    ticks: i32,
    gains: Gains,
}

impl SampledLoop {
    pub(crate) fn new(plant: &Rational, sample: f64, gains: Gains) -> Self {
        let (a, c) = plant.states();
        let size = c.len();
        let whole = held(&a, sample);
        let slope = product(&a, &whole).iter().map(|row| row.iter().map(|x| x / sample).collect()).collect();
        let ticks = (plant.delay / sample + 1e-9).floor();
        let late = (plant.delay - ticks * sample).clamp(0.0, sample);
        let [after, before] = [sample - late, late].map(|time| held(&a, time));
        let carried = plus(&unit(size, 1.0), &product(&a, &after), 1.0);
        let column = |m: &Matrix| m.iter().map(|row| row[size - 1] / sample).collect();
        let inputs = [column(&after), column(&product(&carried, &before))];
        Self { sample, slope, c, inputs, ticks: ticks as i32, gains }
    }

    /// L at z = e^{iωh}, and z^{-n} det(z − e^{Ah}) times what makes it free of the poles of the law at z = 1.
    fn at(&self, omega: f64) -> (Complex, Complex) {
        let turn = omega * self.sample;
        let half = (0.5 * turn).sin();
        // (z − 1)/h and (1 − 1/z)/h without cancellation.
        let forward = Complex(-2.0 * half * half, turn.sin()).scaled(1.0 / self.sample);
        let difference = Complex(2.0 * half * half, turn.sin()).scaled(1.0 / self.sample);
        let back = Complex(turn.cos(), -turn.sin());
        let size = self.c.len();
        let entry = |i: usize, j: usize| {
            let own = if i == j { forward } else { Complex(0.0, 0.0) };
            own.plus(Complex(-self.slope[i][j], 0.0))
        };
        let matrix = (0..size).map(|i| (0..size).map(|j| entry(i, j)).collect()).collect();
        let load = |i: usize| Complex(self.inputs[0][i], 0.0).plus(back.scaled(self.inputs[1][i]));
        let (determinant, state) = solved(matrix, (0..size).map(load).collect());
        let seen = state.iter().zip(&self.c).fold(Complex(0.0, 0.0), |sum, (x, c)| sum.plus(x.scaled(*c)));
        let Gains { kp, ki, lambda, kd, mu, filter } = self.gains;
        let mut law = Complex(kp, 0.0);
        let mut free = determinant.times(back.power_of_a_turn(size as i32));
        if ki != 0.0 {
            law = law.plus(difference.power(-lambda).scaled(ki));
            free = free.times(difference.power(lambda));
        }
        if kd != 0.0 {
            let through = ONE.plus(difference.scaled(filter));
            law = law.plus(difference.power(mu).scaled(kd).times(through.inverse()));
        }
        (seen.times(law).times(back.power_of_a_turn(self.ticks)), free)
    }

    /// Over `count` frequencies from `low` to π/h, and as many again about the extremes.
    ///
    /// 1 + L, freed of its poles, is analytic in 1/z inside the unit circle: the turns along the circle are
    /// the motions that grow.
    pub(crate) fn reached(&self, low: f64, count: u32) -> Reached {
        let high = PI / self.sample * (1.0 - 1e-12);
        let mut found =
            Reached { ms: 0.0, mt: 0.0, phase_margin: f64::INFINITY, highest_crossover: 0.0, growing: 0.0 };
        let mut last: Option<(f64, Complex, Complex)> = None;
        let (mut turned, mut peaks) = (0.0, [low; 2]);
        let place = |k: f64| low * (high / low).powf(k / f64::from(count));
        for k in 0..=count {
            let omega = place(f64::from(k));
            let (open, free) = self.at(omega);
            let whole = ONE.plus(open);
            let image = free.times(whole);
            if 1.0 / whole.size() > found.ms {
                (found.ms, peaks[0]) = (1.0 / whole.size(), omega);
            }
            if open.size() / whole.size() > found.mt {
                (found.mt, peaks[1]) = (open.size() / whole.size(), omega);
            }
            match last {
                // From z = 1, where it is a real number.
                None => turned += image.scaled(image.0.signum()).phase(),
                Some((place, before, known)) => {
                    if (before.size() > 1.0) != (open.size() > 1.0) {
                        // ln |L| is nearly straight between neighbours.
                        let part = before.size().ln() / (before.size() / open.size()).ln();
                        let turn = open.times(before.inverse()).phase();
                        let margin = before.scaled(-1.0).phase() + part * turn;
                        found.phase_margin = min_or_nan(found.phase_margin, margin.to_degrees().abs());
                        found.highest_crossover = place * (omega / place).powf(part);
                    }
                    turned += image.times(known.inverse()).phase();
                }
            }
            last = Some((omega, open, image));
        }
        let ratio = (high / low).powf(1.0 / f64::from(count));
        for k in 0..=400 {
            for (index, peak) in peaks.into_iter().enumerate() {
                let omega = min_or_nan(peak * ratio.powf(f64::from(k) / 200.0 - 1.0), high);
                let (open, _) = self.at(omega);
                let value = [1.0, open.size()][index] / ONE.plus(open).size();
                let best = if index == 0 { &mut found.ms } else { &mut found.mt };
                *best = max_or_nan(*best, value);
            }
        }
        // The direction is against that of 1/z, and the other half circle is the same.
        found.growing = -turned / PI;
        found
    }
}
