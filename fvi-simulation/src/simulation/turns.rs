//! How far a motion turns in its steps.

use crate::model::Mechanism;
use fvi_scenario::language::expression::Elementary;

/// Σ v_kᵀM v_{k+1} and Σ ½ (v_kᵀM v_k + v_{k+1}ᵀM v_{k+1}) of the steps so far.
///
/// Their ratio is the mean of cos φ, weighted by kinetic energy, of an oscillation that turns by the angle φ
/// in a step. By the midpoint rule tan(φ/2) = ωh/2, so that no step turns by more than half a turn, however
/// long it is; beyond a right angle, ωh > 2, the motion is not that of the system any more.
#[derive(Clone, Debug, Default)]
pub(super) struct Turns<T> {
    together: f64,
    alone: f64,
    steps: u64,
    momentum: [Vec<T>; 2],
}

/// Steps before which nothing is said.
const LEAST_STEPS: u64 = 8;

impl<T: Elementary> Turns<T> {
    /// Adds a step to a position with the velocities at its ends.
    pub(super) fn take(&mut self, system: &mut Mechanism<T>, position: &[T], [before, after]: [&[T]; 2]) {
        let [first, last] = &mut self.momentum;
        first.resize(position.len(), T::zero());
        last.resize(position.len(), T::zero());
        system.moved(position, before, first);
        system.moved(position, after, last);
        let product = |one: &[T], other: &[T]| {
            one.iter().zip(other).fold(0.0, |sum, (one, other)| sum + one.to_f64() * other.to_f64())
        };
        self.together += product(before, last);
        self.alone += 0.5 * (product(before, first) + product(after, last));
        self.steps += 1;
    }

    /// A warning if the motion turns by more than a right angle in a step.
    pub(super) fn note(&self) -> Option<String> {
        let mean = self.together / self.alone;
        (mean < 0.0 && self.steps >= LEAST_STEPS).then(|| {
            format!(
                "time.step: weighted by its kinetic energy the motion turns by {:.0}° in a step, beyond a right angle: its energy \
                 is kept, but its course is not followed; shorter steps follow it",
                libm::acos(mean.max(-1.0)).to_degrees()
            )
        })
    }
}
