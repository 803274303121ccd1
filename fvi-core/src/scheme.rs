//! The trait of one-step schemes: from (q_k, p_k) and the damping to (q_{k+1}, p_{k+1}).

use core::fmt;

use crate::damped_motion::Sample;
use crate::damping::Damping;
use crate::linear::{add_zeros, combine_pair, combine_two};
use crate::memory::MemoryError;
use crate::real::Real;
use crate::space::{Space, vectors, vectors_mut};
use crate::system::Mechanics;

/// Times, size and input of the step to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<'a, T> {
    /// Time t_k at its beginning.
    pub time: T,
    /// Time t_{k+1} at its end.
    pub end: T,
    /// Step size h.
    pub size: T,
    /// Input u_k: a force held over the step, added to F(t, q). Missing numbers are zero.
    pub input: &'a [T],
}

/// State of the motion after a number of steps; `V` is a vector of the space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State<V> {
    /// Number of steps made, k; the time is t_k = k h.
    pub step: u64,
    /// Position q_k.
    pub position: V,
    /// Momentum p_k.
    pub momentum: V,
    /// Rounding errors of position and momentum.
    pub rounding: Rounding<V>,
}

/// The rounding errors of a state's updates: the motion is at q + `position` with the momentum
/// p + `momentum`.
///
/// Each step adds them to its changes of q and p, so that in many small steps no digit of a change is lost
/// (compensated summation, \[Kahan65\]). They stay below half a unit in the last place of position and
/// momentum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rounding<V> {
    /// Part of the position.
    pub position: V,
    /// Part of the momentum.
    pub momentum: V,
}

/// Samples that the memory stores of each step.
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
/// A scheme has no state of its own. Its [`Storage`](Scheme::Storage) holds what is reused between steps: the
/// factors of a linear system's equations, and scratch space that does not belong on the stack.
pub trait Scheme<T: Real, X: Space<T>> {
    /// Storage between steps.
    type Storage;

    /// Storage for a system in the given space.
    fn storage<G: Mechanics<T, X>>(&self, space: &X, mechanics: &G) -> Self::Storage;

    /// Samples that the memory stores of each step.
    fn sampling(&self) -> Sampling<'_, T>;

    /// The part of the storage that belongs to the state: the offsets q_k − X_{k−1,i} of the position from
    /// the nodes of the last sample, one node after another, if the memory stores nodes; and everything else
    /// that the bits of the next step depend on.
    fn carried(storage: &Self::Storage) -> &[T] {
        let _ = storage;
        &[]
    }

    /// [`carried`](Scheme::carried), mutable.
    fn carried_mut(storage: &mut Self::Storage) -> &mut [T] {
        let _ = storage;
        &mut []
    }

    /// One step: takes the known part of the damping, solves for the new state, stores the new sample in the
    /// damping and then advances position and momentum ([`conclude`] does the last two). Returns the number
    /// of iterations of Newton's method, 0 for explicit formulas.
    ///
    /// # Errors
    /// If the nonlinear equations have no solution that Newton's method finds, the result is not finite, or
    /// the memory refuses; state and damping are then as before.
    fn step<G: Mechanics<T, X>, D: Damping<T, X>>(
        &self,
        storage: &mut Self::Storage,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<X::Vector>,
    ) -> Result<u32, StepError>;
}

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome<'a, T> {
    /// e_1, …, e_R of the sample, one node after another.
    pub increments: &'a [T],
    /// q_{k+1} − q_k.
    pub rise: &'a [T],
    /// p_{k+1} − p_k.
    pub kick: &'a [T],
}

/// The last part of every step: checks that the new position and momentum are finite, stores the sample and
/// only then advances the state; updates `behind`, the offsets of the position from the nodes of the last
/// sample. `scratch` has room for the sample and one more vector.
///
/// # Errors
/// [`StepError::NotFinite`] or [`StepError::Memory`]; nothing has changed.
#[inline(always)]
pub fn conclude<T: Real, X: Space<T>, Y: Space<T>, D: Damping<T, Y>>(
    damping: &mut D,
    step: &Step<'_, T>,
    fractions: &[T],
    found: &Outcome<'_, T>,
    state: &mut State<X::Vector>,
    behind: &mut [T],
    scratch: &mut [T],
) -> Result<(), StepError> {
    let (position, momentum) = (X::slice_mut(&mut state.position), X::slice_mut(&mut state.momentum));
    let sum = add_zeros(T::zero(), position, found.rise);
    if add_zeros(sum, momentum, found.kick) != T::zero() {
        return Err(StepError::NotFinite);
    }
    let sample = Sample { from: position, behind, time: step.time, length: step.size, fractions };
    damping.push(&sample, found.increments, scratch)?;
    let increments = vectors(found.increments, position.len());
    for (behind, increment) in vectors_mut(behind, position.len()).zip(increments) {
        combine_two(behind, found.rise, increment, |_, rise, e| rise - e);
    }
    add_compensated(position, X::slice_mut(&mut state.rounding.position), found.rise);
    add_compensated(momentum, X::slice_mut(&mut state.rounding.momentum), found.kick);
    Ok(())
}

/// Adds `change` to `number` + `rest`, and leaves the rounding error in `rest`.
#[inline(always)]
fn add_compensated<T: Real>(numbers: &mut [T], rests: &mut [T], changes: &[T]) {
    combine_pair((numbers, rests), changes, |number, rest, change| {
        let change = change + rest;
        let sum = number + change;
        (sum, change - (sum - number))
    });
}

/// Reason why a step failed. State and memory are as before the step.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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
    /// The mass is not positive definite at the end of the step: the kinetic energy of a velocity of size 1
    /// that the constraints allow.
    IndefiniteMass {
        /// The coordinate that moves most, from 0.
        coordinate: usize,
        /// ½ vᵀMv.
        energy: f64,
    },
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
            Self::IndefiniteMass { coordinate, energy } => write_indefinite(f, *coordinate, *energy),
            Self::NotFinite => write!(f, "a force, the input or the result is not a finite number"),
            Self::Memory(error) => error.fmt(f),
        }
    }
}

/// That a mass is not positive definite.
pub(crate) fn write_indefinite(f: &mut fmt::Formatter<'_>, coordinate: usize, energy: f64) -> fmt::Result {
    write!(
        f,
        "the mass is not positive definite for velocities that the constraints allow: one of size 1, most of it of \
         coordinate {coordinate} (from 0), has the kinetic energy {energy:e}"
    )
}

impl core::error::Error for StepError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Memory(error) => Some(error),
            Self::NotConverged { .. }
            | Self::SingularJacobian
            | Self::IndefiniteMass { .. }
            | Self::NotFinite => None,
        }
    }
}

impl From<MemoryError> for StepError {
    fn from(error: MemoryError) -> Self {
        Self::Memory(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Fixed;
    use nalgebra::{SVector, vector};

    #[test]
    fn a_step_ends_where_it_was_found_to_and_its_nodes_lie_behind_by_what_they_did_not_rise() {
        let zeros = SVector::<f64, 2>::zeros();
        let rounding = Rounding { position: zeros, momentum: zeros };
        let start = State { step: 3, position: vector![1.0, 2.0], momentum: vector![-1.0, 0.5], rounding };
        let step = Step { time: 0.5, end: 0.75, size: 0.25, input: &[] };
        // Two nodes of two coordinates.
        let increments = [0.25, 0.5, 0.75, 1.0];
        let found = Outcome { increments: &increments, rise: &[1.0, 4.0], kick: &[0.125, -0.5] };
        let (mut state, mut behind, mut scratch) = (start, [9.0; 4], [0.0; 4]);
        conclude::<_, Fixed<2>, Fixed<2>, _>(
            &mut (),
            &step,
            &[0.2, 0.8],
            &found,
            &mut state,
            &mut behind,
            &mut scratch,
        )
        .unwrap();
        assert_eq!(state.position, vector![2.0, 6.0]);
        assert_eq!(state.momentum, vector![-0.875, 0.0]);
        assert_eq!(behind, [0.75, 3.5, 0.25, 3.0]);
    }

    #[test]
    fn what_is_too_small_to_show_is_added_when_it_has_grown() {
        let (mut number, mut rest) = ([1.0_f32], [0.0_f32]);
        for _ in 0..1_000_000 {
            add_compensated(&mut number, &mut rest, &[1e-9]);
        }
        // Each of them alone is less than half a unit of 1.
        assert!((number[0] - 1.001).abs() < 1.5e-7, "{}", number[0]);
    }
}
