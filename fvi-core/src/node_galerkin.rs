//! The Galerkin schemes that are damped at their quadrature nodes.

use nalgebra::SVector;

use crate::coefficients::Fixed;
use crate::damping::Damping;
use crate::error::ParameterError;
use crate::galerkin::{Galerkin, in_place};
use crate::newton::{Factors, StepMatrix};
use crate::real::Real;
use crate::runge_kutta::RungeKutta;
use crate::scheme::{Sampling, Scheme, State, Step, StepError};
use crate::system::Mechanics;
use crate::workspace::{CachedFactor, Workspace};

/// Galerkin scheme of degree S whose fractional force acts at its Q quadrature nodes, which the memory
/// stores.
///
/// The kernel of the memory determines how the fractional derivative is taken there:
///
/// * matrices of a Runge–Kutta convolution quadrature with the same nodes
///   ([`with_stages`](NodeGalerkin::with_stages)), which couple the nodes;
/// * plain weights of a backward differentiation formula ([`new`](NodeGalerkin::new)), which act on the
///   sequence of every node by itself, spaced by h like the main nodes:
///   (D^β X)_{k,i} = Σ_{n=0}^{k} w_n X_{k−n,i}. With BDF p the order is min(2S, p) in position and momentum.
///
/// Both are implicit in the nodes of the present step; for the equations see
/// [`DiscreteLagrangian::step_damped_at_nodes`](crate::DiscreteLagrangian::step_damped_at_nodes).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeGalerkin<T, const S: usize, const Q: usize> {
    galerkin: Galerkin<T, S, Q>,
}

/// Storage between steps of a scheme with Q nodes in its memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeStorage<T, const N: usize, const S: usize, const Q: usize> {
    pub(crate) kept: CachedFactor<Factors<T, N, S>, T>,
    /// q_k − X_{k−1,i}.
    pub(crate) behind: [[T; N]; Q],
}

impl<T: Real, const N: usize, const S: usize, const Q: usize> NodeStorage<T, N, S, Q> {
    /// Empty storage: no factors, all offsets zero.
    pub(crate) fn empty() -> Self {
        Self { kept: CachedFactor::nothing(Factors::zero()), behind: [[T::zero(); N]; Q] }
    }
}

impl<T: Real, const S: usize, const Q: usize> NodeGalerkin<T, S, Q> {
    /// The scheme on the discrete Lagrangian of `galerkin`, for memories with plain weights.
    pub fn new(galerkin: Galerkin<T, S, Q>) -> Self {
        Self { galerkin }
    }

    /// Polynomials of degree S with the nodes and weights of `method`, for memories with the matrix weights
    /// of the same method.
    ///
    /// # Errors
    /// If S is not one of 1…Q: the kinetic part would be singular.
    pub fn with_stages(method: &RungeKutta<Q>) -> Result<Self, ParameterError> {
        Ok(Self { galerkin: Galerkin::new(method.quadrature())? })
    }
}

impl<T: Real, const N: usize, const S: usize, const Q: usize> Scheme<T, Fixed<N>> for NodeGalerkin<T, S, Q> {
    type Storage = NodeStorage<T, N, S, Q>;

    fn storage<G: Mechanics<T, Fixed<N>>>(&self, _: &Fixed<N>, _: &G) -> Self::Storage {
        NodeStorage::empty()
    }

    fn carried(storage: &Self::Storage) -> &[T] {
        storage.behind.as_flattened()
    }

    fn carried_mut(storage: &mut Self::Storage) -> &mut [T] {
        storage.behind.as_flattened_mut()
    }

    fn sampling(&self) -> Sampling<'_, T> {
        Sampling::Nodes(self.galerkin.nodes())
    }

    #[inline(always)]
    fn step<G: Mechanics<T, Fixed<N>>, D: Damping<T, Fixed<N>>>(
        &self,
        storage: &mut Self::Storage,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<SVector<T, N>>,
    ) -> Result<u32, StepError> {
        let (known, mut room) = ([[T::zero(); N]; Q], [[[T::zero(); N]; Q]; 2]);
        let NodeStorage { kept, behind } = storage;
        in_place!(S, Q; kept, behind.as_flattened_mut(), mechanics, known, room.as_flattened_mut(), |workspace| {
            self.galerkin.view().step_damped_at_nodes(workspace, mechanics, damping, step, state)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrees_beyond_the_stages_are_refused() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        assert!(NodeGalerkin::<f64, 2, 2>::with_stages(&method).is_ok());
        assert!(NodeGalerkin::<f64, 3, 2>::with_stages(&method).is_err());
        assert!(NodeGalerkin::<f64, 0, 2>::with_stages(&method).is_err());
    }
}
