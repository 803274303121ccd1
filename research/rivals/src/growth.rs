//! Growth of the operations per step with the length of the run, compared with theory.

use fvi_core::{BdfOrder, ConvolutionWeights, Memory, ParameterError};
use nalgebra::Complex;

use crate::{
    ObliviousQuadrature, Operations, PlainSum, RelaxedProduct, TextbookHls, jiang, kernel_compression,
    l1_weights, matsuda, non_uniform_partition, oustaloup, uniform_partition, window_of,
};

/// Exponent p of operations ~ xᵖ of one strategy.
#[derive(Clone, Debug)]
pub struct Growth {
    /// Name of the strategy in `fvi strategies`.
    pub strategy: &'static str,
    /// Theoretical cost of a step.
    pub theory: &'static str,
    /// Pairs of the quantity x and the mean number of operations per step over a run.
    pub counts: Vec<(f64, f64)>,
    /// Exponent of the theoretical cost, fitted over the same x.
    pub expected: f64,
    /// Exponent fitted to the counts.
    pub found: f64,
}

impl Growth {
    /// A row of a Markdown table: strategy, theoretical cost, its exponent, that of the counts, and that of
    /// the times if measured.
    pub fn row(&self, of_time: Option<f64>) -> String {
        let of_time =
            of_time.map_or_else(|| "–".to_owned(), |exponent| format!("{exponent:.2}").replace('-', "−"));
        let (strategy, theory) = (self.strategy, self.theory);
        format!("| `{strategy}` | {theory} | {:.2} | {:.2} | {of_time} |", self.expected, self.found)
    }
}

/// Slope of log y over log x by least squares; `None` with fewer than two different x.
pub fn fitted_exponent(points: &[(f64, f64)]) -> Option<f64> {
    let logarithms: Vec<(f64, f64)> =
        points.iter().filter(|(x, y)| *x > 0.0 && *y > 0.0).map(|(x, y)| (x.ln(), y.ln())).collect();
    let count = logarithms.len() as f64;
    let mean_x = logarithms.iter().map(|(x, _)| x).sum::<f64>() / count;
    let mean_y = logarithms.iter().map(|(_, y)| y).sum::<f64>() / count;
    let (mut above, mut below) = (0.0, 0.0);
    for (x, y) in logarithms {
        above += (x - mean_x) * (y - mean_y);
        below += (x - mean_x) * (x - mean_x);
    }
    (below > 0.0).then(|| above / below)
}

/// Lengths of the runs; shorter ones for strategies whose cost per step grows in proportion to them.
const LENGTHS: [usize; 3] = [1 << 10, 1 << 13, 1 << 16];
const SHORT_LENGTHS: [usize; 3] = [1 << 9, 1 << 10, 1 << 11];

/// A memory and the counter of its operations.
type Counted = (Box<dyn Memory<f64>>, Operations);

macro_rules! counted {
    ($make:expr) => {{
        let memory = $make;
        let operations = memory.operations();
        Ok((Box::new(memory) as Box<dyn Memory<f64>>, operations))
    }};
}

fn weights(count: usize) -> Result<Vec<f64>, ParameterError> {
    Ok(ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 1.0)?.take(count).collect())
}

fn growth(
    strategy: &'static str,
    theory: (&'static str, fn(f64) -> f64),
    lengths: [usize; 3],
    make: impl Fn(usize) -> Result<Counted, ParameterError>,
) -> Result<Growth, ParameterError> {
    let mut counts = Vec::new();
    for steps in lengths {
        let (mut memory, operations) = make(steps)?;
        let mut term = [0.0];
        for _ in 0..steps {
            // Refused samples are not counted, which would show in the fit.
            let _ = memory.next_term(&mut term).and_then(|()| memory.push(&[1.0]));
        }
        counts.push((steps as f64, operations.count() as f64 / steps as f64));
    }
    let expected: Vec<(f64, f64)> = counts.iter().map(|&(steps, _)| (steps, (theory.1)(steps))).collect();
    let of = |points: &[(f64, f64)]| fitted_exponent(points).unwrap_or(f64::NAN);
    Ok(Growth { strategy, theory: theory.0, expected: of(&expected), found: of(&counts), counts })
}

/// Growth with the number of steps of each strategy on s^½, for those with a tolerance at 10⁻⁶ (filters 10⁻³,
/// `matsuda` 3·10⁻², `short-memory` 10⁻¹), and of the window of a short memory with 1/ε.
///
/// # Errors
/// [`ParameterError`] of a strategy that cannot be constructed; this does not occur.
pub fn growths() -> Result<Vec<Growth>, ParameterError> {
    const PLAIN: (&str, fn(f64) -> f64) = ("N", |n| n);
    const ROOT: (&str, fn(f64) -> f64) = ("√N", f64::sqrt);
    const SQUARE: (&str, fn(f64) -> f64) = ("log² N", |n| n.log2() * n.log2());
    const LOGARITHM: (&str, fn(f64) -> f64) = ("log N", f64::log2);
    // Their cost depends on the width of their bands.
    const OUSTALOUP: (&str, fn(f64) -> f64) = ("log 2N/ε²", |n| (2e6 * n).log2());
    const MATSUDA: (&str, fn(f64) -> f64) = ("log 2·10⁴ N", |n| (2e4 * n).log2());
    let formula = BdfOrder::GRUNWALD_LETNIKOV;
    let root = |s: Complex<f64>| s.sqrt();
    let mut window = Growth {
        strategy: "short-memory",
        theory: "ε^−1/β",
        counts: Vec::new(),
        expected: 2.0,
        found: f64::NAN,
    };
    let long = weights(1 << 18)?;
    for tolerance in [0.1, 0.05, 0.025] {
        window.counts.push((1.0 / tolerance, 2.0 * window_of(&long, tolerance) as f64));
    }
    window.found = fitted_exponent(&window.counts).unwrap_or(f64::NAN);
    Ok(vec![
        growth("naive", PLAIN, SHORT_LENGTHS, |n| counted!(PlainSum::new(&weights(n)?, 1, n)?))?,
        growth("hls", SQUARE, LENGTHS, |n| counted!(TextbookHls::new(&weights(n)?, 1, n)?))?,
        growth("uniform", ROOT, LENGTHS, |n| counted!(uniform_partition(&weights(n)?, 1, n)?))?,
        growth("gardner", SQUARE, LENGTHS, |n| counted!(non_uniform_partition(&weights(n)?, 1, n)?))?,
        growth("relaxed", SQUARE, LENGTHS, |n| counted!(RelaxedProduct::new(&weights(n)?, 1, n)?))?,
        growth("short-memory", ("1", |_| 1.0), LENGTHS, |n| {
            counted!(PlainSum::new(&long[..=window_of(&long, 0.1)], 1, n)?)
        })?,
        window,
        growth("oustaloup", OUSTALOUP, LENGTHS, |n| counted!(oustaloup(0.5, formula, 1.0, 1, n, 1e-3)?))?,
        growth("matsuda", MATSUDA, LENGTHS, |n| counted!(matsuda(0.5, formula, 1.0, 1, n, 3e-2)?))?,
        growth("l1", PLAIN, SHORT_LENGTHS, |n| counted!(PlainSum::new(&l1_weights(0.5, 1.0, n)?, 1, n)?))?,
        growth("jiang", LOGARITHM, LENGTHS, |n| counted!(jiang(0.5, 1.0, 1, n, 1e-6)?))?,
        growth("baffet-hesthaven", LOGARITHM, LENGTHS, |n| {
            counted!(kernel_compression(0.5, 1.0, 1, n, 1e-6)?)
        })?,
        growth("oblivious", LOGARITHM, LENGTHS, |n| {
            counted!(ObliviousQuadrature::new(&root, &weights(n)?, 1.0, 1, n, 1e-6)?)
        })?,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_are_those_of_powers() {
        let points = [(2.0, 3.0 * 4.0), (4.0, 3.0 * 16.0), (8.0, 3.0 * 64.0)];
        assert!((fitted_exponent(&points).unwrap() - 2.0).abs() < 1e-12);
        assert_eq!(fitted_exponent(&points[..1]), None);
    }
}
