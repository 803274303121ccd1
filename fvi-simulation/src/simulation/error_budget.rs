//! What a pair of adaptive steps may add to the error, so that all of them together stay near the tolerance.

use serde::{Deserialize, Serialize};

/// Factor between the difference of two half steps and the whole step and the assumed error of the half
/// steps, where a motion begins.
///
/// For a smooth motion the error is 1/(2^p − 1) of the difference, for a singular start up to a quarter.
const SHARE: f64 = 2.0;

/// The error that a pair may add, in units of the tolerance, as a multiple of its part of the time elapsed.
///
/// Pairs of the lengths h_k that end at t_k add up to Σ h_k/t_k ≤ 1 + ln(t/h_0): with a tenth to a thousandth
/// of the time for the first pair, 3 to 8.
const PART: f64 = 1.0;

/// The number of steps from which on their density is measured, and the rest estimated: a narrow pulse may
/// take some 10⁵ of them.
const FEWEST_TO_MEASURE: usize = 1 << 13;
const FEWEST_TO_JUDGE: usize = 1 << 18;

/// The largest factor by which the time grows with twice the steps where they do not grow in proportion to
/// it.
const MOST_ADVANCE: f64 = 2.5;

/// The share of the tolerance that each pair may use.
///
/// A single pair is held to the tolerance by twice its difference. The errors of many pairs add up where no
/// damping forgets them: with a scheme of order p the error of a pair is 1/(2^p − 1) of its difference, and
/// that is held to the tolerance times the pair's part of the time, since the start or since the last break
/// (divided by the number of breaks, since every one of them begins a sum of its own), or half its part of
/// the number of pairs, 1/(2k) for the k-th, whose sum grows like a logarithm: so many short pairs in a
/// narrow pulse need not be as accurate as they are short. The second condition is the one that counts where
/// steps are many, which is so for low orders first: for the order 1 from the second pair on, for the order 5
/// from the thirtieth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ErrorBudget {
    /// p
    order: f64,
    /// The last break, and how many there have been, with the start.
    since: f64,
    breaks: f64,
    /// Number of pairs accepted.
    pairs: f64,
    /// Number of steps and time when the rest was estimated last.
    mark: (usize, f64),
    /// Steps per time between the last two estimates.
    density: f64,
}

impl ErrorBudget {
    /// The budget of a scheme of this order from the start on.
    pub(super) fn new(order: f64) -> Self {
        Self { order, since: 0.0, breaks: 1.0, pairs: 0.0, mark: (0, 0.0), density: 0.0 }
    }

    /// The order in their length of the errors that [`of`](Self::of) returns.
    pub(super) fn order_of_pairs(&self) -> f64 {
        self.order + 1.0
    }

    /// The error of a pair from its difference in units of the tolerance, as a multiple of what it may be.
    pub(super) fn of(&self, difference: f64, [begin, end]: [f64; 2]) -> f64 {
        let length = end - begin;
        let of_time = length / end.min((end - self.since) * self.breaks);
        let of_pairs = 0.5 / (self.pairs + 1.0);
        let part = if of_time > of_pairs { of_time } else { of_pairs };
        let added = difference / (libm::pow(2.0, self.order) - 1.0) / (PART * part);
        // Of the order p in the length, since the part is; rescaled to that of the difference.
        let added = libm::pow(added, self.order_of_pairs() / self.order);
        let alone = SHARE * difference;
        if added > alone || added.is_nan() { added } else { alone }
    }

    /// Estimates, at every power of two of the steps, how many they will be at the end if they shorten like
    /// t^{−1/p}, as the part of the time that a step may use does; returns that number if it is beyond reach
    /// of
    /// `most`.
    ///
    /// Not while steps grow with the time, and early on only what is far too much, as steps may become
    /// longer.
    pub(super) fn out_of_reach(
        &mut self,
        (steps, time): (usize, f64),
        (end, most): (f64, usize),
    ) -> Option<f64> {
        if steps < FEWEST_TO_MEASURE || !steps.is_power_of_two() || steps == self.mark.0 {
            return None;
        }
        let (steps_before, time_before) = std::mem::replace(&mut self.mark, (steps, time));
        let most = most as f64;
        let made = steps as f64;
        let density = (made - steps_before as f64) / (time - time_before);
        // Where steps are short for a while only, they say nothing about the rest.
        let density = density.min(std::mem::replace(&mut self.density, density));
        if steps < FEWEST_TO_JUDGE || time > MOST_ADVANCE * time_before {
            return None;
        }
        let power = 1.0 + 1.0 / self.order;
        let all = made + density * time / power * (libm::pow(end / time, power) - 1.0);
        (all > most * libm::sqrt(most / made)).then_some(all)
    }

    /// Counts a pair that was accepted.
    pub(super) fn count(&mut self) {
        self.pairs += 1.0;
    }

    /// Records a break at this time.
    pub(super) fn pass(&mut self, time: f64) {
        (self.since, self.breaks) = (time, self.breaks + 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs over [0, 1] whose difference is (h/0.1)^k, each as long as the budget lets it be; their number
    /// and the sum of their errors in units of the tolerance.
    fn filled(order: f64, difference: impl Fn(f64) -> f64) -> (usize, f64) {
        let mut budget = ErrorBudget::new(order);
        let (mut time, mut pairs, mut sum, mut length) = (0.0, 0, 0.0, 1.0);
        while time < 1.0 {
            let error = budget.of(difference(length), [time, time + length]);
            if error > 1.0 {
                length *= 0.9 * libm::pow(error, -1.0 / budget.order_of_pairs());
                continue;
            }
            sum += difference(length) / (libm::pow(2.0, order) - 1.0);
            budget.count();
            (time, pairs, length) = (time + length, pairs + 1, 1.5 * length);
        }
        (pairs, sum)
    }

    #[test]
    fn errors_of_all_pairs_stay_below_ten_tolerances_for_every_order() {
        for order in [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0] {
            for scale in [1e-1, 1e-2, 1e-3] {
                let (pairs, sum) = filled(order, |h| libm::pow(h / scale, order + 1.0));
                assert!(sum < 10.0 && pairs < 10_000_000, "{order}, {scale}: {sum} in {pairs}");
            }
        }
    }

    #[test]
    fn pairs_of_high_order_are_as_long_as_one_alone_may_be_while_they_are_few() {
        let mut budget = ErrorBudget::new(5.0);
        (0..1000).for_each(|_| budget.count());
        assert_eq!(budget.of(0.4, [0.9, 1.0]), 0.8);
        assert!(budget.of(0.4, [0.999, 1.0]) > 1.0);
        // After a break a sum begins anew.
        let mut after = budget.clone();
        after.pass(0.999);
        assert_eq!(after.of(0.4, [0.999, 1.0]), 0.8);
    }

    #[test]
    fn what_steps_cannot_reach_is_noticed_unless_they_grow() {
        let mut budget = ErrorBudget::new(1.0);
        assert_eq!(budget.out_of_reach((1 << 16, 1e-3), (1.0, 10_000_000)), None);
        assert_eq!(budget.out_of_reach((1 << 17, 1.4e-3), (1.0, 10_000_000)), None);
        assert!(budget.out_of_reach((1 << 18, 2e-3), (1.0, 10_000_000)).is_some_and(|all| all > 1e9));
        let mut growing = ErrorBudget::new(1.0);
        assert_eq!(growing.out_of_reach((1 << 17, 1e-30), (1.0, 10_000_000)), None);
        assert_eq!(growing.out_of_reach((1 << 18, 1e-20), (1.0, 10_000_000)), None);
        // Nor where they are short in one place only.
        let mut local = ErrorBudget::new(1.0);
        assert_eq!(local.out_of_reach((1 << 17, 0.5), (1.0, 10_000_000)), None);
        assert_eq!(local.out_of_reach((1 << 18, 0.5 + 1e-9), (1.0, 10_000_000)), None);
    }
}
