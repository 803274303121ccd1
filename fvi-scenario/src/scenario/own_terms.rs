//! Potential and forces that code supplies where a file has expressions.

use crate::language::expression::Moment;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

/// A potential U(q) and a force F(t, q) or F(t, q, v) in code; they are added to those that a scenario
/// writes.
///
/// All numbers are in double precision, whatever the run computes in. A call that fails writes a NaN, which
/// ends the step it is made for, and keeps the reason to itself.
pub trait OwnTerms: Send {
    /// U(q).
    fn potential(&mut self, position: &[f64]) -> f64;

    /// Whether ∇U − F depends on the position. A force of time alone leaves large systems sparse.
    fn depends_on_position(&self) -> bool {
        true
    }

    /// Where ∂²U/∂q² − ∂F/∂q may have entries, as (row, column), each place with its mirror image: such terms
    /// leave large systems sparse. `None`: everywhere, row by row.
    fn places(&self) -> Option<Vec<(u32, u32)>> {
        None
    }

    /// Adds ∇U(q) − F(t, q).
    fn add_restoring_force(&mut self, moment: Moment<f64>, position: &[f64], restoring: &mut [f64]);

    /// Adds ∇U(q) − F(t, q), and its derivative ∂²U/∂q² − ∂F/∂q to `stiffness`, one number for each of the
    /// [`places`](Self::places), or row by row. Not called where nothing depends on the position.
    fn add_linearisation(
        &mut self,
        moment: Moment<f64>,
        position: &[f64],
        restoring: &mut [f64],
        stiffness: &mut [f64],
    );

    /// Whether F depends on the velocity. Then the two methods that follow are called in place of the two
    /// above; everything depends on the position as well, and all places have entries.
    fn depends_on_velocity(&self) -> bool {
        false
    }

    /// Adds ∇U(q) − F(t, q, v).
    fn add_restoring_force_in_motion(
        &mut self,
        moment: Moment<f64>,
        position: &[f64],
        velocity: &[f64],
        restoring: &mut [f64],
    ) {
        let _ = velocity;
        self.add_restoring_force(moment, position, restoring);
    }

    /// Adds ∇U(q) − F(t, q, v), and its derivatives ∂²U/∂q² − ∂F/∂q and −∂F/∂v to two matrices, row by row.
    fn add_linearisation_in_motion(
        &mut self,
        moment: Moment<f64>,
        (position, velocity): (&[f64], &[f64]),
        restoring: &mut [f64],
        stiffness: &mut [f64],
        resistance: &mut [f64],
    ) {
        let _ = (velocity, resistance);
        self.add_linearisation(moment, position, restoring, stiffness);
    }

    /// Writes the largest |F_i| that was seen since this was last called, and forgets it.
    fn take_largest_force(&mut self, largest: &mut [f64]);
}

/// Terms in code that the parts of a run share.
#[derive(Clone)]
pub struct SharedTerms(Arc<Mutex<dyn OwnTerms>>);

impl SharedTerms {
    /// To share.
    pub fn new(terms: impl OwnTerms + 'static) -> Self {
        Self(Arc::new(Mutex::new(terms)))
    }

    /// Whether they depend on the position, as those of the velocity count.
    pub fn depend_on_position(&self) -> bool {
        self.with(|terms| terms.depends_on_position() || terms.depends_on_velocity())
    }

    /// Whether they depend on the velocity.
    pub fn depend_on_velocity(&self) -> bool {
        self.with(|terms| terms.depends_on_velocity())
    }

    /// Whether they make the equations of a step full: they depend on the position, and do not say where, or
    /// on the velocity.
    pub fn are_full(&self) -> bool {
        self.with(|terms| {
            terms.depends_on_velocity() || (terms.depends_on_position() && terms.places().is_none())
        })
    }

    /// Whether they depend on the position in places that they say.
    pub fn are_sparse(&self) -> bool {
        !self.are_full() && self.depend_on_position()
    }

    /// Calls them.
    pub fn with<R>(&self, call: impl FnOnce(&mut dyn OwnTerms) -> R) -> R {
        call(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl fmt::Debug for SharedTerms {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SharedTerms(…)")
    }
}
