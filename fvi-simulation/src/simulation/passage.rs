//! Passages of a motion through points where elongations have no derivative, such as a length of zero.

use crate::model::Mechanism;
use fvi_core::{Lagrangian, Real, max_or_nan};
use fvi_scenario::language::expression::Elementary;

/// Halvings of a step in which a change of ∂g/∂q is sought.
const HALVINGS: u32 = 20;

/// The same in single precision, whose positions tell no more apart.
const HALVINGS_OF_SINGLE: u32 = 10;

/// Halvings of a step after which a change that is still whole is too fast for its nodes.
const TOO_FAST: u32 = 4;

/// ∂g/∂q of the elongations of a motion at its last grid point.
#[derive(Clone, Debug)]
pub(super) struct Passages<T> {
    /// Indices of the elongations in words.
    watched: Vec<usize>,
    slopes: Vec<Vec<T>>,
    /// What the last step passed.
    passed: Option<Passed>,
    /// Where a step was first too long for an elongation.
    too_fast: Option<Passed>,
}

/// A change of ∂g/∂q within a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Passed {
    /// The elongation, from 0 over all dampers.
    pub(super) elongation: usize,
    /// Its place in the step.
    pub(super) fraction: f64,
    /// Its time, once that is known.
    pub(super) time: f64,
}

impl<T: Elementary> Passages<T> {
    /// At the start of a motion.
    pub(super) fn new(system: &mut Mechanism<T>, position: &[T]) -> Self {
        let watched = system.functions();
        let mut made = Self { slopes: Vec::new(), passed: None, too_fast: None, watched };
        made.begin(system, position);
        made
    }

    /// Begins at a position.
    pub(super) fn begin(&mut self, system: &mut Mechanism<T>, position: &[T]) {
        self.slopes = self.watched.iter().map(|&index| slope(system, index, position)).collect();
        self.passed = None;
    }

    /// True if there is nothing to look at.
    pub(super) fn are_idle(&self) -> bool {
        self.watched.is_empty()
    }

    /// What the last step passed, and where a step was first too long.
    pub(super) fn found(&self) -> [Option<Passed>; 2] {
        [self.passed, self.too_fast]
    }

    /// Follows a step whose positions at fractions of it are given, from a time over a length.
    ///
    /// Where the larger change of a component of ∂g/∂q lies in ever shorter halves of the step and does not
    /// become smaller, the motion has passed a point where g has no derivative.
    pub(super) fn take(
        &mut self,
        system: &mut Mechanism<T>,
        position: &dyn Fn(f64) -> Vec<T>,
        (from, length): (f64, f64),
    ) {
        self.passed = None;
        let end = position(1.0);
        for (&elongation, before) in self.watched.iter().zip(&mut self.slopes) {
            let after = slope(system, elongation, &end);
            if let Some((fraction, halvings)) = change(system, elongation, position, [before, &after]) {
                let passed = Passed { elongation, fraction, time: from + fraction * length };
                let all = if T::EPSILON.to_f64() > 1e-10 { HALVINGS_OF_SINGLE } else { HALVINGS };
                if halvings >= all {
                    self.passed.get_or_insert(passed);
                } else {
                    self.too_fast.get_or_insert(passed);
                }
            }
            *before = after;
        }
    }
}

fn slope<T: Elementary>(system: &mut Mechanism<T>, elongation: usize, position: &[T]) -> Vec<T> {
    let mut slope = vec![T::zero(); system.coordinates()];
    system.slope(elongation, position, &mut slope);
    slope
}

/// The middle of the part of a step in which ∂g/∂q changes, and the halvings after which most of the change
/// was still in it; `None` if it changes slowly.
fn change<T: Elementary>(
    system: &mut Mechanism<T>,
    elongation: usize,
    position: &dyn Fn(f64) -> Vec<T>,
    [before, after]: [&[T]; 2],
) -> Option<(f64, u32)> {
    let component = largest_change(before, after)?;
    let whole = (after[component] - before[component]).abs();
    let all = if T::EPSILON.to_f64() > 1e-10 { HALVINGS_OF_SINGLE } else { HALVINGS };
    let (mut from, mut to, mut ends) = (0.0, 1.0, [before[component], after[component]]);
    for halvings in 0..all {
        let half = 0.5 * (from + to);
        let here = slope(system, elongation, &position(half))[component];
        if !here.is_finite() {
            return Some((half, all));
        }
        let [first, second] = [(here - ends[0]).abs(), (ends[1] - here).abs()];
        match first > second {
            true => (to, ends[1]) = (half, here),
            false => (from, ends[0]) = (half, here),
        }
        if max_or_nan(first, second) < T::of(0.5) * whole {
            return (halvings >= TOO_FAST).then_some((0.5 * (from + to), halvings));
        }
    }
    Some((0.5 * (from + to), all))
}

/// The component that changes most of those that change by more than a tenth of their sizes; `None` if none
/// does.
fn largest_change<T: Real>(before: &[T], after: &[T]) -> Option<usize> {
    let size = before.iter().chain(after).fold(T::zero(), |most, x| max_or_nan(most, x.abs()));
    let (mut found, mut most) = (None, T::zero());
    for (index, (&before, &after)) in before.iter().zip(after).enumerate() {
        let change = (after - before).abs();
        // Beside the other components it may be rounding.
        let is_large = change > T::of(0.1) * (before.abs() + after.abs()) + T::EPSILON.sqrt() * size;
        if (is_large && change > most) || !change.is_finite() {
            (found, most) = (Some(index), change);
        }
    }
    found
}
