//! A step stored for states inside it.

use fvi_core::Real;

/// State at the beginning of a step, and its solution.
#[derive(Clone, Debug, Default)]
pub(super) struct Piece<T> {
    pub(super) from: f64,
    pub(super) to: f64,
    /// The length that the step had: late in time that is more digits than the difference of its ends.
    pub(super) length: T,
    pub(super) position: Vec<T>,
    pub(super) momentum: Vec<T>,
    /// [`AnyScheme::solution`](crate::model::AnyScheme::solution).
    pub(super) solution: Vec<T>,
}

/// Location of a time relative to a step.
pub(super) enum WithinStep {
    /// Inside, at this fraction of it.
    Inside(f64),
    /// At its end, up to rounding.
    End,
}

impl<T: Real> Piece<T> {
    pub(super) fn begin(&mut self, time: f64, position: &[T], momentum: &[T]) {
        self.from = time;
        position.clone_into(&mut self.position);
        momentum.clone_into(&mut self.momentum);
    }

    pub(super) fn end(&mut self, time: f64, length: T, solution: &[T]) {
        (self.to, self.length) = (time, length);
        solution.clone_into(&mut self.solution);
    }

    /// Location of a time in the step; the end if no step has been made.
    pub(super) fn place(&self, time: f64) -> WithinStep {
        let length = self.to - self.from;
        // A time equal to the end of the step up to rounding is its end.
        if length <= 0.0 || self.to - time <= 4.0 * f64::EPSILON * self.to {
            return WithinStep::End;
        }
        WithinStep::Inside(((time - self.from) / length).max(0.0))
    }
}
