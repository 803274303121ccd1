//! The room of a step.

use crate::damped_motion::Sample;
use crate::damping::Damping;
use crate::newton::Equations;
use crate::real::Real;
use crate::scheme::{State, Step, StepError};
use crate::space::Space;

/// Where a step puts its intermediate results, for N coordinates, S nodes, Q points and a memory of R nodes.
#[derive(Debug)]
pub struct Workspace<'a, T: Real, X: Space<T>, E: Equations<T, X::Block>> {
    /// e^1 … e^S: S·N numbers.
    pub increments: &'a mut [T],
    /// S·N numbers.
    pub residual: &'a mut [T],
    /// X_i − q_k: Q·N numbers.
    pub stages: &'a mut [T],
    /// Q·N numbers.
    pub forces: &'a mut [T],
    /// R·N numbers.
    pub known: &'a mut [T],
    /// R·N numbers, and N more where R > 1.
    pub scratch: &'a mut [T],
    /// q_k − X_{k−1,i}, R·N numbers, kept from step to step ([`Scheme::carried`](crate::Scheme::carried));
    /// empty where the memory stores the main nodes.
    pub behind: &'a mut [T],
    /// What pulled at the node of the last step, N numbers that are carried along too, for the guess at where
    /// a single node will be; empty where the guess is a drift.
    pub restoring: &'a mut [T],
    /// What exact moments of the force exceed the nodes by
    /// ([`Mechanics::moment_correction`](crate::Mechanics::moment_correction)): (S + 1)·N numbers at least.
    pub moment_correction: &'a mut [T],
    /// A position.
    pub point: &'a mut X::Vector,
    /// From [`Mechanics::stiffness`](crate::Mechanics::stiffness).
    pub stiffness: &'a mut X::Block,
    /// The equations of a step.
    pub matrix: &'a mut E,
    /// Factors that solve them while they stay the same.
    pub kept: &'a mut CachedFactor<E::Factor, T>,
}

impl<T: Real, X: Space<T>, E: Equations<T, X::Block>> Workspace<'_, T, X, E> {
    /// Asks the damping for what it knows of the step, with nodes at these fractions of it.
    #[inline(always)]
    pub(crate) fn begin<D: Damping<T, X>>(
        &mut self,
        damping: &mut D,
        step: &Step<'_, T>,
        fractions: &[T],
        state: &State<X::Vector>,
    ) -> Result<(), StepError> {
        self.known.fill(T::zero());
        let (from, behind) = (X::slice(&state.position), &*self.behind);
        let sample = Sample { from, behind, time: step.time, length: step.size, fractions };
        Ok(damping.add_known(&sample, self.known, self.scratch)?)
    }
}

/// Prepared factors of the equations of a linear system.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CachedFactor<K, T> {
    /// Factors made by [`Equations::keep`].
    pub solver: K,
    /// The length of the steps whose equations it is for; zero where it is for none.
    pub length: T,
}

impl<K, T: Real> CachedFactor<K, T> {
    /// Nothing prepared yet.
    pub fn nothing(solver: K) -> Self {
        Self { solver, length: T::zero() }
    }
}
