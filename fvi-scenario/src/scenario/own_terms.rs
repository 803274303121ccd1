//! Potential and forces supplied in code instead of expressions.

use crate::language::expression::Moment;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

/// A potential U(q) and a force F(t, q) or F(t, q, v) in code, added to those of the scenario.
///
/// All numbers are in double precision, whatever the precision of the run. A call that fails writes a NaN,
/// with which the step fails, and stores its error itself.
pub trait OwnTerms: Send {
    /// U(q).
    fn potential(&mut self, position: &[f64]) -> f64;

    /// True if ∇U − F depends on the position. With a force of time alone large systems stay sparse.
    fn depends_on_position(&self) -> bool {
        true
    }

    /// Structurally nonzero places of ∂²U/∂q² − ∂F/∂q, as (row, column), each with its mirror image: with
    /// such terms large systems stay sparse. `None`: all places, row by row.
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

    /// True if the matrices that [`add_linearisation`](Self::add_linearisation) adds are the derivatives to
    /// rounding: then the motion has sensitivities and gradients. Newton's method alone takes approximate
    /// ones.
    fn has_exact_derivatives(&self) -> bool {
        false
    }

    /// The same terms for a run that is made at the same time as this one; `None`: there are no such runs,
    /// one follows another.
    fn again(&self) -> Option<SharedTerms> {
        None
    }

    /// True if F depends on the velocity. Then the following two methods are called instead of the two above;
    /// all terms count as depending on the position, with a full matrix.
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

    /// Writes the largest |F_i| since the last call, and resets it.
    fn take_largest_force(&mut self, largest: &mut [f64]);
}

/// Terms in code, shared by the parts of a run.
#[derive(Clone)]
pub struct SharedTerms(Arc<Mutex<dyn OwnTerms>>);

impl SharedTerms {
    /// Wraps terms for sharing.
    pub fn new(terms: impl OwnTerms + 'static) -> Self {
        Self(Arc::new(Mutex::new(terms)))
    }

    /// True if the terms depend on the position; terms that depend on the velocity count too.
    pub fn depend_on_position(&self) -> bool {
        self.with(|terms| terms.depends_on_position() || terms.depends_on_velocity())
    }

    /// True if the terms depend on the velocity.
    pub fn depend_on_velocity(&self) -> bool {
        self.with(|terms| terms.depends_on_velocity())
    }

    /// True if they depend on the position, and their derivatives are not known to rounding.
    pub fn have_approximate_derivatives(&self) -> bool {
        self.depend_on_position() && self.with(|terms| !terms.has_exact_derivatives())
    }

    /// True if they make the equations of a step dense: they depend on the position without stating the
    /// places, or on the velocity.
    pub fn are_full(&self) -> bool {
        self.with(|terms| {
            terms.depends_on_velocity() || (terms.depends_on_position() && terms.places().is_none())
        })
    }

    /// True if the terms depend on the position and state the places of their derivatives.
    pub fn are_sparse(&self) -> bool {
        !self.are_full() && self.depend_on_position()
    }

    /// The same terms for a run that is made at the same time, if they [can be](OwnTerms::again).
    pub fn again(&self) -> Option<Self> {
        self.with(|terms| terms.again())
    }

    /// Calls `call` with the terms.
    pub fn with<R>(&self, call: impl FnOnce(&mut dyn OwnTerms) -> R) -> R {
        call(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl fmt::Debug for SharedTerms {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SharedTerms(…)")
    }
}
