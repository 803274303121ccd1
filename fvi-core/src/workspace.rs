//! Workspace of a step.

use crate::damped_motion::Sample;
use crate::damping::Damping;
use crate::newton::Equations;
use crate::real::Real;
use crate::scheme::{State, Step, StepError};
use crate::space::Space;

/// Buffers for the intermediate results of a step, for N coordinates, S nodes, Q points and a memory of R
/// nodes.
#[derive(Debug)]
pub struct Workspace<'a, T: Real, X: Space<T>, E: Equations<T, X::Block>> {
    /// e^1 … e^S: S·N numbers.
    pub increments: &'a mut [T],
    /// Residual of the equations: S·N numbers.
    pub residual: &'a mut [T],
    /// X_i − q_k: Q·N numbers.
    pub stages: &'a mut [T],
    /// Forces at the nodes: Q·N numbers.
    pub forces: &'a mut [T],
    /// Known part of the damping: R·N numbers.
    pub known: &'a mut [T],
    /// R·N numbers, and N more where R > 1.
    pub scratch: &'a mut [T],
    /// q_k − X_{k−1,i}, R·N numbers, kept from step to step ([`Scheme::carried`](crate::Scheme::carried));
    /// empty where the memory stores the main nodes.
    pub behind: &'a mut [T],
    /// Restoring force at the node of the last step, N numbers that are carried along too, for the guess of a
    /// single node; empty where the guess is a drift.
    pub restoring: &'a mut [T],
    /// Exact moments of the force minus those of the nodes
    /// ([`Mechanics::moment_correction`](crate::Mechanics::moment_correction)): at least (S + 1)·N numbers.
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
    /// Takes the known part of the damping for the step, with nodes at the given fractions of it.
    #[inline(always)]
    pub(crate) fn begin<Y: Space<T>, D: Damping<T, Y>>(
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
    /// Length of the steps whose equations the factors are for; zero for none.
    pub length: T,
}

impl<K, T: Real> CachedFactor<K, T> {
    /// No factors prepared yet.
    pub fn nothing(solver: K) -> Self {
        Self { solver, length: T::zero() }
    }
}
