//! Sums of exponentials at many lags, with a multiplication in place of most exponentials.

use crate::quadrature::exponential::Exponential;
use crate::sums::CompensatedSum;

/// Value of e^{−sn} above which that at twice the lag follows from 1 − e^{−sn}, which keeps its relative
/// accuracy, and up to which it is a square.
const NEARLY_ONE: f64 = 0.5;

/// Σ c e^{−sn} at one lag. The check of a table must be more accurate than the table, so the sum is
/// compensated.
pub(super) fn sum_of_exponentials(exponentials: &[Exponential], n: u64) -> f64 {
    let terms = exponentials.iter().map(|e| e.coefficient * libm::exp(-e.rate * n as f64));
    terms.collect::<CompensatedSum>().total()
}

/// Lags in ascending order: from the first to twice the first each an eighth larger than the one before, then
/// twice those one octave below, and a last one.
pub(super) struct Lags {
    all: Vec<u64>,
    /// Number of those below twice the first.
    octave: usize,
}

impl Lags {
    /// From `first` ≥ 1 to `last`.
    pub(super) fn new(first: u64, last: u64) -> Self {
        let next = |n: &u64| Some(n + n / 8 + 1);
        let mut all: Vec<u64> =
            std::iter::successors(Some(first), next).take_while(|&n| n < 2 * first && n < last).collect();
        let octave = all.len();
        let below = |all: &[u64]| all.len().checked_sub(octave).and_then(|place| all.get(place)).copied();
        while let Some(twice) = below(&all).map(|n| n.saturating_mul(2)).filter(|&n| n < last) {
            all.push(twice);
        }
        all.push(last);
        Self { all, octave }
    }

    /// The lags.
    pub(super) fn all(&self) -> &[u64] {
        &self.all
    }

    /// e^{−`rate` n} at these lags, as far as they are not zero, in place of the `decays`.
    fn decay(&self, rate: f64, decays: &mut Vec<f64>) {
        decays.clear();
        let Some((last, doubled)) = self.all.split_last() else { return };
        // 1 − e^{−sn} at the lags of an octave, with the other sign.
        let mut falls: [f64; 8] = [0.0; 8];
        let falls = &mut falls[..self.octave];
        for (fall, &n) in falls.iter_mut().zip(&self.all) {
            *fall = libm::expm1(-rate * n as f64);
        }
        decays.extend(falls.iter().map(|fall| 1.0 + fall));
        if rate > 0.5 / *self.all.first().unwrap_or(last) as f64 {
            // Where an exponential has all its digits, 1 − e^{−sn} may have lost those of e^{−sn}.
            let exact = |n: &u64| libm::exp(-rate * *n as f64);
            decays.iter_mut().zip(&self.all).for_each(|(decay, n)| *decay = exact(n));
        }
        while decays.len() < doubled.len() {
            let begin = decays.len() - self.octave;
            let count = self.octave.min(doubled.len() - decays.len());
            for (place, fall) in (begin..).zip(falls.iter_mut()).take(count) {
                let below = decays[place];
                *fall *= 2.0 + *fall;
                decays.push(if 1.0 + *fall > NEARLY_ONE { 1.0 + *fall } else { below * below });
            }
            if decays[begin + self.octave..].iter().all(|decay| *decay < f64::MIN_POSITIVE) {
                return;
            }
        }
        decays.push(libm::exp(-rate * *last as f64));
    }
}

/// Sums of exponentials with common rates at all of some lags, term by term.
pub(super) struct SumsAtLags<'a> {
    lags: &'a Lags,
    /// For each of several sums, at each lag.
    sums: Vec<Vec<CompensatedSum>>,
    decays: Vec<f64>,
}

impl<'a> SumsAtLags<'a> {
    /// So many empty sums.
    pub(super) fn new(lags: &'a Lags, count: usize) -> Self {
        let sums = vec![vec![CompensatedSum::default(); lags.all.len()]; count];
        Self { lags, sums, decays: Vec::with_capacity(lags.all.len()) }
    }

    /// Adds an exponential of a rate, with one coefficient for each sum.
    pub(super) fn add(&mut self, rate: f64, coefficients: impl Iterator<Item = f64>) {
        self.lags.decay(rate, &mut self.decays);
        for (sums, coefficient) in self.sums.iter_mut().zip(coefficients) {
            sums.iter_mut().zip(&self.decays).for_each(|(sum, decay)| sum.add(coefficient * decay));
        }
    }

    /// The sums so far, for each of them at each lag.
    pub(super) fn totals(&self) -> Vec<Vec<f64>> {
        let total = |sums: &Vec<CompensatedSum>| sums.iter().map(|sum| sum.total()).collect();
        self.sums.iter().map(total).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sums::max_or_nan;

    #[test]
    fn lags_are_next_to_each_other_up_to_the_last() {
        for (first, last) in
            [(1, 1), (1, 2), (5, 5), (5, 9), (9, 17), (33, 1 << 20), (513, 1000), (7, 1 << 50)]
        {
            let lags = Lags::new(first, last);
            assert_eq!((lags.all()[0], *lags.all().last().unwrap()), (first, last));
            assert!(lags.octave <= 8);
            for pair in lags.all().windows(2) {
                assert!(
                    pair[0] < pair[1] && pair[1] <= pair[0] + pair[0] / 4 + 1,
                    "{first}, {last}: {pair:?}"
                );
            }
        }
    }

    #[test]
    fn squares_of_exponentials_are_exponentials() {
        let lags = Lags::new(33, 1 << 20);
        let mut decays = Vec::new();
        let mut largest = 0.0;
        for k in 0..600 {
            let rate = libm::exp(-20.0 + 0.04 * f64::from(k));
            lags.decay(rate, &mut decays);
            for (place, &n) in lags.all().iter().enumerate() {
                // In units of rounding of the largest of all terms c e^{−sn} at this lag, if c were 1.
                let error = decays.get(place).unwrap_or(&0.0) - libm::exp(-rate * n as f64);
                largest = max_or_nan(largest, error.abs() / f64::EPSILON);
            }
        }
        assert!(largest < 4.0, "{largest}");
    }
}
