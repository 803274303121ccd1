//! Relaxation functions given by rows of time and modulus.

use crate::transfer::Formula;
use crate::transfer::algebra::{Algebra, Series};
use nalgebra::Complex;

/// K(s) = s Ĝ(s) of a relaxation function G: the force ∫ G(t − τ) q̇(τ) dτ.
///
/// G is linear between its rows, and G(T) e^{−(t−T)/τ} after the last one, at T:
///
/// ```text
/// K(s) = G(0) + Σ_i m_i (e^{−s t_i} − e^{−s t_{i+1}})/s − G(T) e^{−sT} / (1 + τ s) ,
/// ```
///
/// m_i the slopes. Units: those of G. Source: \[Mainardi10\].
#[derive(Debug)]
pub struct Relaxation {
    name: String,
    /// t and G, one after the other.
    rows: Vec<f64>,
    decay: Option<f64>,
    /// True if the kernel is an entry of a matrix, for which passivity is a property of the whole.
    part: bool,
}

impl Relaxation {
    /// From rows (t, G) with ascending t from 0, of a file of this name, continued with the time constant
    /// `decay`; without one, G is zero after them.
    pub fn new(name: &str, rows: &[(f64, f64)], decay: Option<f64>) -> Self {
        let rows = rows.iter().flat_map(|&(time, modulus)| [time, modulus]).collect();
        Self { name: name.to_owned(), rows, decay, part: false }
    }

    /// The same as an entry of a matrix: its passivity is not checked by itself.
    pub fn of_matrix(self) -> Self {
        Self { part: true, ..self }
    }

    fn row(&self, index: usize) -> (f64, f64) {
        (self.rows[2 * index], self.rows[2 * index + 1])
    }

    fn count(&self) -> usize {
        self.rows.len() / 2
    }

    fn last(&self) -> (f64, f64) {
        self.row(self.count() - 1)
    }

    /// (t_i, t_{i+1} − t_i, m_i)
    fn pieces(&self) -> impl Iterator<Item = (f64, f64, f64)> + '_ {
        (1..self.count()).map(|index| {
            let ((begin, from), (end, to)) = (self.row(index - 1), self.row(index));
            (begin, end - begin, (to - from) / (end - begin))
        })
    }

    /// True if G falls, is convex, and ends at or above zero: then it is passive (Pólya).
    fn is_convex(&self) -> bool {
        let (_, end) = self.last();
        let after = self.decay.map_or(0.0, |decay| -end / decay);
        let slopes: Vec<f64> = self.pieces().map(|(.., slope)| slope).chain([after]).collect();
        // A step down to zero after the last row is not convex.
        let ends = end == 0.0 || (end > 0.0 && self.decay.is_some());
        ends && slopes.is_sorted() && slopes.last().is_none_or(|&slope| slope <= 0.0)
    }
}

impl Formula for Relaxation {
    fn value(&self, s: Complex<f64>) -> Complex<f64> {
        // m ∫ e^{−st} dt over a piece: Δ (1 − e^{−x})/x e^{−s t_i} with x = sΔ.
        let mean = |x: Complex<f64>| {
            if x.norm() < 1e-2 {
                (1..8).rev().fold(Complex::new(1.0, 0.0), |sum, n| {
                    Complex::new(1.0, 0.0) - x * sum / f64::from(n + 1)
                })
            } else {
                (Complex::new(1.0, 0.0) - (-x).exponential()) / x
            }
        };
        let pieces: Complex<f64> = self
            .pieces()
            .map(|(begin, length, slope)| (s * -begin).exponential() * mean(s * length) * (slope * length))
            .sum();
        let (end, modulus) = self.last();
        let tail = (s * -end).exponential() * modulus;
        let tail = self.decay.map_or(tail, |decay| tail / (s * decay + 1.0));
        let sum = pieces + self.row(0).1 - tail;
        // Far to the left the exponentials overflow.
        if sum.re.is_finite() && sum.im.is_finite() { sum } else { Complex::new(f64::NAN, f64::NAN) }
    }

    fn series(&self, s: &Series) -> Series {
        let at = |time: f64| s.scale(-time).exponential();
        let (end, modulus) = self.last();
        let tail = at(end).scale(modulus);
        let tail = match self.decay {
            Some(decay) => tail.divide(&s.scale(decay).add(&s.constant(1.0))),
            None => tail,
        };
        let mut sum = s.constant(self.row(0).1).add(&tail.negate());
        let mut begin = at(0.0);
        let mut pieces = s.constant(0.0);
        for (from, length, slope) in self.pieces() {
            let end = at(from + length);
            pieces = pieces.add(&begin.add(&end.negate()).scale(slope));
            begin = end;
        }
        sum = sum.add(&pieces.divide(s));
        sum
    }

    fn text(&self) -> &str {
        &self.name
    }

    fn form(&self) -> &'static str {
        "relaxation"
    }

    fn parameters(&self) -> Vec<(&'static str, f64)> {
        self.decay.map(|decay| ("decay", decay)).into_iter().collect()
    }

    fn numbers(&self) -> &[f64] {
        &self.rows
    }

    fn is_passive(&self) -> bool {
        self.part || self.is_convex()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quadrature::multistep_weights::multistep_weights;
    use crate::transfer::TransferFunction;
    use fvi_core::{BdfOrder, DoubleDouble};
    use std::sync::Arc;

    #[test]
    fn a_ramp_has_its_transform() {
        // G = 1 − t/2 to t = 2: K = 1 − (1 − e^{−2s})/(2s).
        let ramp = Relaxation::new("ramp", &[(0.0, 1.0), (0.5, 0.75), (2.0, 0.0)], None);
        for s in [Complex::new(0.3, 0.0), Complex::new(0.0, 2.0), Complex::new(1e-6, 1e-7)] {
            let direct =
                Complex::new(1.0, 0.0) - (Complex::new(1.0, 0.0) - (s * -2.0).exponential()) / (s * 2.0);
            assert!((ramp.value(s) - direct).norm() < 2e-10, "{s}");
        }
        assert!(ramp.is_passive());
        assert!(!Relaxation::new("step", &[(0.0, 1.0), (2.0, 0.5)], None).is_passive());
    }

    #[test]
    fn rows_of_an_exponential_relax_like_a_maxwell_element() {
        // Linear between 4000 rows of e^{−t}, to 3e−7 of it.
        let rows: Vec<(f64, f64)> =
            (0..4001).map(|k| f64::from(k) * 2.5e-3).map(|t| (t, (-t).exp())).collect();
        let measured = Relaxation::new("measured", &rows, Some(1.0));
        assert!(measured.is_passive());
        let measured = TransferFunction::formula(Arc::new(measured)).unwrap();
        let maxwell = TransferFunction::prony(&[1.0], &[1.0]).unwrap();
        let order = BdfOrder::new(2).unwrap();
        let weights =
            |of: &TransferFunction, count| multistep_weights(of, order, 0.05, false, count).unwrap();
        // By the series, and by the transform for later weights.
        for count in [60, 700] {
            for (a, b) in weights(&measured, count).iter().zip(weights(&maxwell, count)) {
                assert!((a - b).abs() < 1e-6, "{a} {b}");
            }
        }
        assert_eq!(measured.active(), None);
    }

    #[test]
    fn weights_at_the_delay_of_many_steps_are_those_of_short_tables() {
        // K(0) = 0 is the sum of all weights. e^{−4γ(0)/h} is e^{−768} at the shortest step.
        let rows = [(0.0, 1.0), (1.0, 0.25), (2.0, -0.1), (3.0, 0.03), (4.0, 0.0)];
        let transfer = TransferFunction::formula(Arc::new(Relaxation::new("rows", &rows, None))).unwrap();
        for order in [1, 2] {
            for (step, count) in [(1.0 / 64.0, 511), (1.0 / 128.0, 1600), (1.0 / 300.0, 3000)] {
                let order = BdfOrder::new(order).unwrap();
                let weights = multistep_weights(&transfer, order, step, false, count).unwrap();
                let sum: f64 = weights.iter().sum();
                assert!(sum.abs() < 1e-12, "{order:?}, h = {step}: {sum:e}");
            }
        }
    }

    #[test]
    fn the_series_is_that_of_the_value() {
        let rows = Relaxation::new("rows", &[(0.0, 2.0), (0.4, 1.0), (1.0, 0.7)], Some(3.0));
        let z = Series::polynomial(&[DoubleDouble::exact(2.0), DoubleDouble::exact(-2.0)], 80);
        let series: f64 =
            rows.series(&z).to_numbers().iter().rev().fold(0.0, |sum, coefficient| sum * 0.4 + coefficient);
        let value = rows.value(Complex::new(2.0 - 0.8, 0.0)).re;
        assert!((series - value).abs() < 1e-14, "{series} {value}");
    }
}
