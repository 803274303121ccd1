//! What a one-step scheme is: from (q_k, p_k) and the memory's values to (q_{k+1}, p_{k+1}).

use core::fmt;

use crate::damping::{Damping, Sample};
use crate::linear::add_multiple;
use crate::memory::MemoryError;
use crate::real::{Real, all_finite};
use crate::space::Space;
use crate::system::Mechanics;

/// The step that is to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<'a, T> {
    /// Time t_k at its beginning.
    pub time: T,
    /// Time t_{k+1} at its end.
    pub end: T,
    /// Its size h.
    pub size: T,
    /// Input u_k: a force held over the step, added to F(t, q). Missing numbers are zero.
    pub input: &'a [T],
}

/// What the memory stores of each step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sampling<'a, T> {
    /// The main nodes q_0, q_1, …: one sample before the first step and one at the end of every step.
    MainNodes,
    /// The positions at these fractions of every step.
    Nodes(&'a [T]),
}

impl<T> Sampling<'_, T> {
    /// Number of nodes R that a sample holds.
    pub fn nodes(&self) -> usize {
        match self {
            Self::MainNodes => 1,
            Self::Nodes(fractions) => fractions.len(),
        }
    }
}

/// A one-step scheme.
///
/// A scheme has no state of its own. Its [`Storage`](Scheme::Storage) keeps what is worth keeping between
/// steps: the factors of a linear system's equations, and scratch space where the stack is not the place for
/// it.
pub trait Scheme<T: Real, X: Space<T>> {
    /// What is kept between steps.
    type Storage;

    /// Storage for a system in the given space.
    fn storage<G: Mechanics<T, X>>(&self, space: &X, mechanics: &G) -> Self::Storage;

    /// Forgets what is kept for steps of the length of the last: the next is of another.
    fn forget_step(storage: &mut Self::Storage) {
        let _ = storage;
    }

    /// What the memory stores of each step.
    fn sampling(&self) -> Sampling<'_, T>;

    /// One step: asks the damping for what it knows, solves for the new state, stores the new sample with the
    /// damping and then moves `position` and `momentum` on ([`conclude`] does the last two). Returns the
    /// iterations of Newton's method, 0 for explicit formulas.
    ///
    /// # Errors
    /// If the nonlinear equations have no solution that Newton's method finds, the result is not finite, or
    /// the memory refuses; position, momentum and damping are then as before.
    fn step<G: Mechanics<T, X>, D: Damping<T, X>>(
        &self,
        storage: &mut Self::Storage,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        position: &mut X::Vector,
        momentum: &mut X::Vector,
    ) -> Result<u32, StepError>;
}

/// The last part of every step: checks that `rise` = q_{k+1} − q_k and the new momentum are finite, stores the sample and only then moves on.
/// `scratch` has room for the sample and one vector more.
///
/// # Errors
/// [`StepError::NotFinite`] or [`StepError::Memory`]; nothing has changed.
#[inline(always)]
pub fn conclude<T: Real, X: Space<T>, D: Damping<T, X>>(
    damping: &mut D,
    sample: Sample<'_, T>,
    (rise, new_momentum): (&[T], &[T]),
    (position, momentum): (&mut [T], &mut [T]),
    scratch: &mut [T],
) -> Result<(), StepError> {
    let finite = position.iter().zip(rise).all(|(&q, &rise)| (q + rise).is_finite());
    if !finite || !all_finite(new_momentum) {
        return Err(StepError::NotFinite);
    }
    damping.push(position, &sample, scratch)?;
    add_multiple(position, T::one(), rise);
    for (place, &number) in momentum.iter_mut().zip(new_momentum) {
        *place = number;
    }
    Ok(())
}

/// Why a step failed. State and memory are as before the step.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum StepError {
    /// Newton's method did not converge.
    NotConverged {
        /// Iterations made.
        iterations: u32,
        /// Largest component of the residual at the end, in units of momentum.
        residual: f64,
    },
    /// The Jacobian of the step's equations is singular.
    SingularJacobian,
    /// The potential, the force, the input or the result is infinite or not a number.
    NotFinite,
    /// The memory refused the sample; most likely it is full.
    Memory(MemoryError),
}

impl fmt::Display for StepError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotConverged { iterations, residual } => {
                write!(
                    f,
                    "Newton's method did not converge in {iterations} iterations (residual {residual:e})"
                )
            }
            Self::SingularJacobian => write!(f, "the Jacobian of the step is singular"),
            Self::NotFinite => write!(f, "a force, the input or the result is not a finite number"),
            Self::Memory(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for StepError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Memory(error) => Some(error),
            Self::NotConverged { .. } | Self::SingularJacobian | Self::NotFinite => None,
        }
    }
}

impl From<MemoryError> for StepError {
    fn from(error: MemoryError) -> Self {
        Self::Memory(error)
    }
}
