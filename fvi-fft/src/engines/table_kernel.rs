//! The kernel of a table of exponentials, evaluated at any lag.

use fvi_core::{ExponentialTable, ExponentialTerm};

/// The weights of a table at any lag.
pub(crate) struct TableKernel<'a> {
    pub(crate) stages: usize,
    head: &'a [f64],
    pub(crate) terms: Vec<Exponential>,
}

/// An [`ExponentialTerm`] of any number of stages.
pub(crate) struct Exponential {
    pub(crate) decay: f64,
    pub(crate) output: Vec<f64>,
    pub(crate) input: Vec<f64>,
}

/// Ratio to the weight below which an exponential may be dropped.
const NEGLIGIBLE: f64 = 1e-18;

/// Largest decay factor of an exponential that may be dropped: one that has decayed so far at a lag decays
/// faster from there on than the weights, which fall at most like the third power of the lag.
const FADED: f64 = 1e-3;

/// Number of samples that a memory accepts for a table of this horizon.
pub(crate) fn samples_of(horizon: u64) -> usize {
    usize::try_from(horizon).unwrap_or(usize::MAX)
}

impl<'a> TableKernel<'a> {
    /// The kernel of a table of 1 to 4 stages.
    pub(crate) fn new(table: &ExponentialTable<&'a [f64]>) -> Self {
        let terms = match table.stages {
            1 => table.terms::<1>().map(Exponential::new).collect(),
            2 => table.terms::<2>().map(Exponential::new).collect(),
            3 => table.terms::<3>().map(Exponential::new).collect(),
            _ => table.terms::<4>().map(Exponential::new).collect(),
        };
        Self { stages: table.stages, head: table.head, terms }
    }

    pub(crate) fn head_len(&self) -> usize {
        self.head.len() / (self.stages * self.stages)
    }

    /// W_n, row by row.
    pub(crate) fn weights(&self, n: usize) -> Vec<f64> {
        let (stages, head) = (self.stages, self.head_len());
        if n < head {
            return self.head.iter().skip(n).step_by(head).copied().collect();
        }
        let mut weights = vec![0.0; stages * stages];
        for term in &self.terms {
            let power = term.power(n - head);
            weights.iter_mut().zip(term.product()).for_each(|(weight, entry)| *weight += entry * power);
        }
        weights
    }

    /// Drops the exponentials that are negligible at lag n and beyond.
    pub(crate) fn keep_what_lasts(&mut self, n: usize) {
        keep_what_lasts(core::slice::from_mut(self), n);
    }

    /// For each exponential, whether it is not negligible at lag n and beyond.
    fn lasting(&self, n: usize) -> Vec<bool> {
        let largest = |size: f64, entry: f64| size.max(entry.abs());
        let weight = self.weights(n).into_iter().fold(0.0, largest);
        let left = n - self.head_len();
        let lasts = |term: &Exponential| {
            let part = term.product().fold(0.0, largest) * term.power(left).abs();
            term.power(n).abs() > FADED || part > NEGLIGIBLE * weight
        };
        self.terms.iter().map(lasts).collect()
    }
}

/// Drops from kernels with the same exponentials those that are negligible in all of them at lag n and
/// beyond.
pub(crate) fn keep_what_lasts(kernels: &mut [TableKernel<'_>], n: usize) {
    let lasting: Vec<Vec<bool>> = kernels.iter().map(|kernel| kernel.lasting(n)).collect();
    for kernel in kernels {
        let mut index = 0;
        kernel.terms.retain(|_| {
            index += 1;
            lasting.iter().any(|lasting| lasting[index - 1])
        });
    }
}

impl Exponential {
    fn new<const S: usize>(term: ExponentialTerm<f64, S>) -> Self {
        Self { decay: term.decay, output: term.output.to_vec(), input: term.input.to_vec() }
    }

    /// u vᵀ, row by row.
    fn product(&self) -> impl Iterator<Item = f64> {
        self.output.iter().flat_map(|output| self.input.iter().map(move |input| output * input))
    }

    /// 1 − μ, rounded, and its rounding error.
    pub(crate) fn factor(&self) -> (f64, f64) {
        let base = 1.0 - self.decay;
        (base, (1.0 - base) - self.decay)
    }

    /// (1 − μ)ⁿ, with full relative accuracy.
    pub(crate) fn power(&self, n: usize) -> f64 {
        let (base, rest) = self.factor();
        let power = libm::pow(base, n as f64);
        if rest == 0.0 { power } else { power + power * (n as f64 * (rest / base)) }
    }

    /// 1 − (1 − μ)ⁿ, which near 0 has the digits that (1 − μ)ⁿ lacks.
    pub(crate) fn loss(&self, n: usize) -> f64 {
        match 1.0 - self.decay > 0.0 {
            true => -libm::expm1(n as f64 * libm::log1p(-self.decay)),
            false => 1.0 - self.power(n),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use fvi_core::DoubleDouble;

    /// True if each exponential of a kernel with the head `head` is not negligible at lag 34.
    fn lasting<const S: usize>(head: &[f64], terms: &[(f64, [f64; S], [f64; S])]) -> Vec<bool> {
        let term = |&(decay, output, input): &(f64, [f64; S], [f64; S])| {
            Exponential::new(ExponentialTerm { decay, output, input })
        };
        TableKernel { stages: S, head, terms: terms.iter().map(term).collect() }.lasting(34)
    }

    #[test]
    fn what_has_faded_and_adds_no_digit_is_left_out() {
        // After a head of two, lag 34 is 32 steps away: a factor of a half has become 2⁻³², a tenth 10⁻³².
        let plain = |decay: f64, size: f64| (decay, [size], [1.0]);
        let terms = [plain(0.5, 1.0), plain(0.5, 2e-18), plain(0.5, 0.5e-18), plain(0.9, 1.0)];
        assert_eq!(lasting(&[1.0; 2], &terms), [true, true, false, false]);
        // The smaller one decays more slowly and dominates in the end.
        assert_eq!(lasting(&[1.0; 2], &[plain(0.5, 1.0), plain(1e-6, 1e-30)]), [true, true]);
    }

    #[test]
    fn an_exponential_of_matrices_is_as_large_as_its_largest_entry() {
        let half = |output, input| (0.5, output, input);
        // The largest entry of the weight is in row 1, column 0; products, not factors, are compared.
        let terms = [
            half([0.0, 1.0], [1.0, 0.0]),
            half([2e-9, 0.0], [1e-9, 0.0]),
            half([0.5e-9, 0.0], [1e-9, 0.0]),
            half([1e-30, 1e-30], [1e-30, 1e-10]),
            half([1e-30, 1e-10], [1e-30, 1e-5]),
        ];
        assert_eq!(lasting(&[1.0; 8], &terms), [true, true, false, false, true]);
    }

    #[test]
    fn powers_and_what_they_lose_are_accurate_relative_to_themselves() {
        for decay in [1e-12, 1e-9, 1e-4, 0.03, 0.1, 0.3, 0.45, 0.49, 0.7, 1.3] {
            let term = Exponential { decay, output: vec![1.0], input: vec![1.0] };
            let factor = DoubleDouble::exact(1.0).add(DoubleDouble::exact(-decay));
            let mut exact = DoubleDouble::ONE;
            for n in 1..=100 {
                exact = exact.multiply(factor);
                let error = (term.power(n) / exact.to_f64() - 1.0).abs();
                assert!(error < 5e-16, "power {n} of 1 − {decay}: {error:e}");
                let lost = DoubleDouble::exact(1.0).add(exact.scale(-1.0)).to_f64();
                let error = (term.loss(n) / lost - 1.0).abs();
                assert!(error < 2e-15, "loss {n} of 1 − {decay}: {error:e}");
            }
        }
    }
}
