//! Runs the loop with irregular ticks, prints the output of its image, and compares its first ticks with a
//! run in double precision whose memories are sums over the whole past.

use std::error::Error;

use scenarios::jitter::{EXPONENTS, GAINS, Jitter, PRINTED, STIFFNESS, TICKS, reference};

/// Number of ticks compared.
const COMPARED: usize = 800;

/// Bound on the difference of positions, whose magnitude is about 1.
const TOLERANCE: f64 = 1e-6;

/// D^β on steps of any length by the implicit Euler method, with a sum over the whole past.
///
/// ```text
/// (D^β x)_n = h_n^μ Y_n + Σ_{k<n} K_{nk} h_k Y_k ,
/// K_{nk} = (sin πμ/π) ∫ λ^{−μ} Π_{i=k}^{n} (1 + h_i λ)^{−1} dλ ,      μ = ⌈β⌉ − β
/// ```
///
/// with Y the ⌈β⌉-th difference quotient, ⌈β⌉ ≤ 1, and the integral by the trapezoidal rule in ln λ.
struct FullMemory {
    differences: bool,
    mu: f64,
    /// λ and (sin πμ/π) λ^{1−μ} d ln λ.
    nodes: Vec<[f64; 2]>,
    lengths: Vec<f64>,
    /// h_k Y_k
    past: Vec<f64>,
    last: f64,
}

impl FullMemory {
    fn new(exponent: f64) -> Self {
        const SPACING: f64 = 0.25;
        let mu = exponent.ceil() - exponent;
        let jump = (std::f64::consts::PI * mu).sin() / std::f64::consts::PI;
        // Range of ln λ for which the truncated parts at both ends are below 10⁻¹², for times from 5 ms to
        // 1000 s.
        let (low, high) = (-28.0 / (1.0 - mu) - 7.0, 28.0 / (1.0 + mu) + 6.0);
        let node = |y: f64| [y.exp(), jump * SPACING * ((1.0 - mu) * y).exp()];
        let nodes = (0..((high - low) / SPACING) as usize).map(|k| node(low + SPACING * k as f64)).collect();
        Self { differences: exponent > 0.0, mu, nodes, lengths: Vec::new(), past: Vec::new(), last: 0.0 }
    }

    /// The derivative after a step of length h as factor · x_n + rest: returns factor and rest.
    fn next(&self, h: f64) -> (f64, f64) {
        let mut sum = 0.0;
        for &[rate, coefficient] in &self.nodes {
            let (mut decay, mut inner) = (1.0 / (1.0 + h * rate), 0.0);
            for (&length, &past) in self.lengths.iter().zip(&self.past).rev() {
                decay /= 1.0 + length * rate;
                if decay < 1e-25 {
                    break;
                }
                inner += decay * past;
            }
            sum += coefficient * inner;
        }
        let leading = h.powf(self.mu) / if self.differences { h } else { 1.0 };
        let stay = if self.differences { leading * self.last } else { 0.0 };
        (leading, sum - stay)
    }

    fn push(&mut self, h: f64, x: f64) {
        self.lengths.push(h);
        self.past.push(if self.differences { x - self.last } else { h * x });
        self.last = x;
    }
}

/// The loop in double precision: the largest differences of positions and momenta from those of single
/// precision.
fn largest_differences() -> Result<[f64; 2], Box<dyn Error>> {
    let mut single = Jitter::new()?;
    let [mut damping, mut integral, mut derivative] = EXPONENTS.map(FullMemory::new);
    let gains = GAINS.map(f64::from);
    let (mut q, mut v, mut largest) = (0.0, 0.0, [0.0f64; 2]);
    for k in 0..COMPARED {
        let tick = single.tick()?;
        let h = f64::from(tick.interval);
        let error = f64::from(reference(k as u32)) - q;
        let mut input = gains[0] * error;
        for (memory, gain) in [&mut integral, &mut derivative].into_iter().zip(&gains[1..]) {
            let (leading, rest) = memory.next(h);
            memory.push(h, error);
            input += gain * (leading * error + rest);
        }
        // a + 4 X + D^½ X = u with X = q + h v + h² a.
        let (leading, rest) = damping.next(h);
        let stiffness = f64::from(STIFFNESS) + leading;
        let a = (input - rest - stiffness * (q + h * v)) / (1.0 + h * h * stiffness);
        (q, v) = (q + h * v + h * h * a, v + h * a);
        damping.push(h, q);
        largest[0] = largest[0].max((f64::from(tick.position) - q).abs());
        largest[1] = largest[1].max((f64::from(tick.momentum) - v).abs());
    }
    Ok(largest)
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut jitter = Jitter::new()?;
    for k in 1..=TICKS {
        let tick = jitter.tick()?;
        if k % PRINTED == 0 {
            println!("{k} {tick}");
        }
    }
    println!("hash {:08x}", jitter.hash());
    let [position, momentum] = largest_differences()?;
    eprintln!(
        "jitter: the first {COMPARED} ticks against full memory in double precision: positions within {position:.1e}, momenta within {momentum:.1e}"
    );
    if position > TOLERANCE || position.is_nan() {
        return Err(format!("larger than {TOLERANCE:e}").into());
    }
    Ok(())
}
