//! Rational functions with real coefficients that are next to values at points of a plane.
//!
//! Poles and residues are those of the closed upper half-plane; the rest are their conjugates:
//!
//! ```text
//! f(s) = Σ_real r/(s − p) + Σ_pairs (r/(s − p) + r̄/(s − p̄))
//! ```
//!
//! Residues are linear. Poles come from them by vector fitting: with trial poles q the least squares of
//!
//! ```text
//! Σ_j c_j/(s − q_j) − f(s) Σ_j d_j/(s − q_j) = f(s)
//! ```
//!
//! are those of a quotient whose divisor 1 + Σ d_j/(s − q_j) has the poles wanted as its zeros: they are
//! the next trial, mirrored to the left of the imaginary axis where they are to its right.
//!
//! Source: \[GustavsenSemlyen99\].

use crate::dense::{eigenvalues, least_squares};
use nalgebra::{Complex, DMatrix, DVector};

/// Real parts, then imaginary ones.
pub(crate) fn real_rows(numbers: impl Iterator<Item = Complex<f64>> + Clone) -> impl Iterator<Item = f64> {
    numbers.clone().map(|number| number.re).chain(numbers.map(|number| number.im))
}

/// Values of a function in the upper half-plane, and what their errors are multiplied by.
#[derive(Clone, Copy, Debug)]
pub struct Values<'a> {
    /// s.
    pub places: &'a [Complex<f64>],
    /// f(s).
    pub values: &'a [Complex<f64>],
    /// Weights of the errors.
    pub weights: &'a [f64],
}

/// The parts of a pole that real coefficients multiply: 1/(s − p), and of a pair the sum and i times the
/// difference of it and its conjugate.
fn parts(pole: Complex<f64>, place: Complex<f64>) -> [Complex<f64>; 2] {
    let part = (place - pole).inv();
    if pole.im == 0.0 {
        return [part, Complex::ZERO];
    }
    let conjugate = (place - pole.conj()).inv();
    [part + conjugate, Complex::new(0.0, 1.0) * (part - conjugate)]
}

/// Number of real coefficients of a pole.
fn width(pole: Complex<f64>) -> usize {
    1 + usize::from(pole.im != 0.0)
}

impl Values<'_> {
    /// Columns of the parts of poles, times a factor at each place.
    fn columns(&self, poles: &[Complex<f64>], factor: impl Fn(usize) -> Complex<f64>) -> Vec<f64> {
        let mut columns = Vec::new();
        for &pole in poles {
            for k in 0..width(pole) {
                let at = |(i, place): (usize, &Complex<f64>)| parts(pole, *place)[k] * factor(i);
                columns.extend(real_rows(self.places.iter().enumerate().map(at)));
            }
        }
        columns
    }

    fn weight(&self, i: usize) -> Complex<f64> {
        Complex::new(self.weights[i], 0.0)
    }

    fn solution(&self, columns: Vec<f64>) -> Option<Vec<f64>> {
        let rows = 2 * self.places.len();
        let matrix = DMatrix::from_vec(rows, columns.len() / rows, columns);
        let weighted = self.values.iter().zip(self.weights).map(|(value, weight)| value * *weight);
        least_squares(matrix, &DVector::from_vec(real_rows(weighted).collect()))
    }

    /// The residues at these poles with the least squares of errors; `None` where they are not found.
    pub fn residues(&self, poles: &[Complex<f64>]) -> Option<Vec<Complex<f64>>> {
        if poles.is_empty() {
            return Some(Vec::new());
        }
        let numbers = self.solution(self.columns(poles, |i| self.weight(i)))?;
        Some(by_pole(poles, &numbers))
    }

    /// The next trial of poles after these, all with Re p < 0, beside others that stay; `None` where they
    /// are not found.
    pub fn relocated(&self, poles: &[Complex<f64>], staying: &[Complex<f64>]) -> Option<Vec<Complex<f64>>> {
        if poles.is_empty() {
            return Some(Vec::new());
        }
        let mut columns = self.columns(staying, |i| self.weight(i));
        columns.extend(self.columns(poles, |i| self.weight(i)));
        columns.extend(self.columns(poles, |i| -self.values[i] * self.weight(i)));
        let mut numbers = self.solution(columns)?;
        let count = poles.iter().map(|pole| width(*pole)).sum::<usize>();
        let divisor = numbers.split_off(numbers.len() - count);
        // Zeros of 1 + Σ d_j/(s − q_j): eigenvalues of diag q_j − 1 dᵀ, of a pair with its parts as basis.
        let mut matrix = DMatrix::zeros(count, count);
        let mut row = 0;
        for &pole in poles {
            let last = row + width(pole) - 1;
            for at in [row, last] {
                matrix[(at, at)] = pole.re;
            }
            if last > row {
                (matrix[(row, last)], matrix[(last, row)]) = (pole.im, -pole.im);
            }
            let input = width(pole) as f64;
            for (column, number) in divisor.iter().enumerate() {
                matrix[(row, column)] -= input * number;
            }
            row = last + 1;
        }
        let mirrored = |zero: Complex<f64>| Complex::new(-zero.re.abs().max(f64::MIN_POSITIVE), zero.im);
        let zeros = eigenvalues(matrix)?.into_iter().filter(|zero| zero.im >= 0.0);
        Some(zeros.map(mirrored).collect())
    }
}

/// The residues of poles from their real coefficients.
fn by_pole(poles: &[Complex<f64>], numbers: &[f64]) -> Vec<Complex<f64>> {
    let mut place = 0;
    let residue = |pole: &Complex<f64>| {
        let own = &numbers[place..];
        place += width(*pole);
        Complex::new(own[0], if pole.im == 0.0 { 0.0 } else { own[1] })
    };
    poles.iter().map(residue).collect()
}

/// f(s) of poles and residues.
pub fn sum_of_fractions(poles: &[Complex<f64>], residues: &[Complex<f64>], s: Complex<f64>) -> Complex<f64> {
    let term = |(pole, residue): (&Complex<f64>, &Complex<f64>)| {
        let [sum, turned] = parts(*pole, s);
        sum * residue.re + turned * residue.im
    };
    poles.iter().zip(residues).map(term).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poles_and_residues_of_a_rational_function_are_found() {
        let known = [Complex::new(-3.0, 0.0), Complex::new(-0.02, 2.0)];
        let strengths = [Complex::new(5.0, 0.0), Complex::new(0.3, -0.7)];
        let places: Vec<_> =
            (0..60).map(|k| Complex::new(0.0, libm::exp10(f64::from(k) / 20.0 - 1.5))).collect();
        let values: Vec<_> = places.iter().map(|s| sum_of_fractions(&known, &strengths, *s)).collect();
        // By the definition, with the conjugates.
        let by_hand = |s: Complex<f64>| {
            let [pole, pair] = known;
            strengths[0] / (s - pole) + strengths[1] / (s - pair) + strengths[1].conj() / (s - pair.conj())
        };
        assert!(places.iter().zip(&values).all(|(s, value)| (by_hand(*s) - value).norm() < 1e-13));
        let weights: Vec<f64> = values.iter().map(|value| value.norm().recip()).collect();
        let data = Values { places: &places, values: &values, weights: &weights };
        let mut poles = vec![Complex::new(-1.0, 0.0), Complex::new(-0.5, 1.0)];
        for _ in 0..10 {
            poles = data.relocated(&poles, &[]).unwrap();
        }
        poles.sort_by(|a, b| a.im.total_cmp(&b.im));
        let residues = data.residues(&poles).unwrap();
        for (found, known) in poles.iter().zip(known).chain(residues.iter().zip(strengths)) {
            assert!((found - known).norm() < 1e-9, "{poles:?} {residues:?}");
        }
    }
}
