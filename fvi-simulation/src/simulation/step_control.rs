//! Step size control from the errors of previous steps.

use serde::{Deserialize, Serialize};

/// Factor of the step size by which the error is kept below the tolerance.
const SAFETY: f64 = 0.9;

/// Largest growth factor of steps, in smooth motion and after a break.
const MOST_GROWTH: f64 = 4.0;
const MOST_GROWTH_AFTER_BREAK: f64 = 10.0;

/// Smallest factor of a step size, in smooth motion and after a break; and the factor after a failure without
/// a known error.
const MOST_SHRINKING: f64 = 0.1;
const MOST_SHRINKING_AFTER_BREAK: f64 = 1e-3;
const SHRINKING_AFTER_FAILURE: f64 = 0.25;

/// Factor by which the bound of a rejection decays after each step, and after two consecutive steps whose
/// e/h^k is a small fraction of it.
const FADING: f64 = 0.97;
const FADING_WHEN_LOW: f64 = 1e-3;
const LOW: f64 = 0.05;

/// Largest order of the error, in its length, of a step that begins with a jump or at t = 0: that for a
/// motion like t^{5/2}. For smoother motions the step is too short at first, and grows.
const SINGULAR_ORDER: f64 = 2.5;

/// The controller of adaptive steps.
///
/// After a step of length h with the error e, in units of the tolerance, comes one of
///
/// ```text
/// 0.9 h e^{−1/k} min(1, (h/h′) (e′/e)^{1/k})
/// ```
///
/// with length h′ and error e′ of the previous step, and e ~ h^k. Source: \[Gus94\], as in \[HW\] IV.8. After
/// a rejection its e/h^k bounds the following steps, with a decaying weight: otherwise an error that
/// oscillates with the motion would cause a rejection in every period.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct StepControl {
    /// k
    order: f64,
    /// The same for a step that begins with a jump or at t = 0.
    singular_order: f64,
    /// The length to try next.
    proposed: f64,
    /// Length and error of the last accepted step.
    before: Option<(f64, f64)>,
    /// True if the next step begins at a break, after which earlier errors are irrelevant.
    at_break: bool,
    /// The length that would have been right after the last break.
    after_break: Option<f64>,
    /// True if the last attempt was rejected.
    rejected: bool,
    /// e/h^k of the last rejection, with decay.
    hardest: f64,
    /// True if e/h^k of the last step was small relative to it.
    low: bool,
}

impl StepControl {
    /// A controller for steps whose error has the given order in their length, with the first length;
    /// `singular`: the smallest power of t with which a coordinate begins to move.
    pub(super) fn new(order: f64, singular: f64, first: f64) -> Self {
        Self {
            order,
            singular_order: if singular < 1.0 { singular } else { SINGULAR_ORDER },
            proposed: first,
            before: None,
            at_break: true,
            after_break: None,
            rejected: false,
            hardest: 0.0,
            low: false,
        }
    }

    /// The length of the next attempt.
    pub(super) fn proposed(&self) -> f64 {
        self.proposed
    }

    /// Records a step with an error ≤ 1; `at_break`: it ends at a break.
    pub(super) fn accept(&mut self, length: f64, error: f64, at_break: bool) {
        let error = error.max(1e-12);
        let factor = SAFETY * libm::pow(error, -1.0 / self.order);
        let (factor, most) = match self.before {
            Some((length_before, error_before)) if !self.at_break => {
                let trend = length / length_before * libm::pow(error_before / error, 1.0 / self.order);
                (factor * trend.min(1.0), MOST_GROWTH)
            }
            _ => (factor, MOST_GROWTH_AFTER_BREAK),
        };
        let most = if self.rejected { 1.0 } else { most };
        let low = error < LOW * self.hardest * libm::pow(length, self.order);
        self.hardest *= if low && self.low { FADING_WHEN_LOW } else { FADING };
        self.low = low;
        let bound = SAFETY * libm::pow(self.hardest.max(f64::MIN_POSITIVE), -1.0 / self.order);
        let next = (length * factor.clamp(MOST_SHRINKING, most)).min(bound);
        if self.at_break {
            let singular = 0.5 * libm::pow(error, -1.0 / self.singular_order);
            self.after_break = Some(length * singular.clamp(0.5, MOST_GROWTH_AFTER_BREAK));
        }
        // A step shortened to end at a break is no reason against longer ones.
        let cut = length < 0.9 * self.proposed;
        self.proposed = if cut { next.max(self.proposed.min(bound)) } else { next };
        if at_break {
            self.proposed = self.proposed.min(self.after_break.unwrap_or(self.proposed));
        }
        self.before = (!at_break).then_some((length, error));
        if at_break {
            self.hardest = 0.0;
        }
        (self.at_break, self.rejected) = (at_break, false);
    }

    /// Records an attempt with this error > 1, or without a result.
    pub(super) fn reject(&mut self, length: f64, error: Option<f64>) {
        let factor = match error {
            Some(error) if self.at_break => {
                let factor = 0.5 * libm::pow(error, -1.0 / self.singular_order);
                let least = libm::pow(MOST_SHRINKING_AFTER_BREAK, SINGULAR_ORDER / self.singular_order);
                factor.clamp(least, 0.5)
            }
            Some(error) => {
                self.hardest = self.hardest.max(error / libm::pow(length, self.order));
                let factor = SAFETY * libm::pow(error, -1.0 / self.order);
                factor.clamp(MOST_SHRINKING, SAFETY)
            }
            None => SHRINKING_AFTER_FAILURE,
        };
        self.proposed = length * factor;
        self.rejected = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lengths and number of rejections over [0, end] if a step from t of length h has the error `error(t,
    /// h)`.
    fn run(order: f64, first: f64, end: f64, error: impl Fn(f64, f64) -> f64) -> (Vec<f64>, usize) {
        let mut control = StepControl::new(order, 1.0, first);
        let (mut time, mut lengths, mut rejected) = (0.0, Vec::new(), 0);
        while time < end {
            let length = control.proposed();
            let error = error(time, length);
            assert!(lengths.len() + rejected < 10_000, "{time}");
            if error <= 1.0 {
                control.accept(length, error, false);
                lengths.push(length);
                time += length;
            } else {
                control.reject(length, Some(error));
                rejected += 1;
            }
        }
        (lengths, rejected)
    }

    #[test]
    fn the_error_settles_near_the_tolerance() {
        let error = |_: f64, h: f64| (h / 0.1).powi(6);
        let (lengths, rejected) = run(6.0, 1e-6, 10.0, error);
        assert!(lengths.len() < 130 && rejected <= 2, "{} {rejected}", lengths.len());
        assert!(lengths[20..].iter().all(|&h| (0.08..=0.1).contains(&h)), "{lengths:?}");
        // A first step that is far too long costs a few attempts only.
        assert!(run(6.0, 10.0, 10.0, error).1 <= 6);
    }

    #[test]
    fn steps_follow_a_motion_that_becomes_faster() {
        let error = |t: f64, h: f64| (h * (1.0 + 5.0 * (1.0 + (t - 5.0).tanh()))).powi(6);
        let (lengths, rejected) = run(6.0, 0.1, 10.0, error);
        assert!(rejected * 100 <= 15 * (lengths.len() + rejected), "{rejected} of {}", lengths.len());
    }

    #[test]
    fn an_error_that_swings_is_not_run_into_again_and_again() {
        let error = |t: f64, h: f64| (h / 0.1).powi(6) * (20.0 * t).sin().powi(2);
        let (lengths, rejected) = run(6.0, 0.01, 50.0, error);
        assert!(rejected * 100 <= 15 * (lengths.len() + rejected), "{rejected} of {}", lengths.len());
    }

    #[test]
    fn a_jump_that_nobody_told_of_is_passed_and_left_behind() {
        let error = |t: f64, h: f64| (h / 0.1).powi(6) + if t < 5.0 && 5.0 < t + h { 1e3 * h } else { 0.0 };
        let (lengths, rejected) = run(6.0, 0.01, 10.0, error);
        assert!(lengths.len() < 150 && rejected <= 15, "{} {rejected}", lengths.len());
    }

    #[test]
    fn steps_grow_with_the_time_from_a_singular_start() {
        // t^{5/2}: the error of [t, t + h] is like t^{5/2} (h/t)^6, and h^{5/2} at the start.
        let error = |t: f64, h: f64| 1e4 * h.powf(2.5) * (h / (t + h)).powf(3.5);
        let (lengths, rejected) = run(6.0, 1e-3, 1.0, error);
        assert!(
            rejected * 100 <= 15 * (lengths.len() + rejected) && lengths.len() < 40,
            "{rejected}, {lengths:?}"
        );
    }
}
