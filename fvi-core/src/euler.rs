//! The explicit and the implicit Euler method with the same memory: the baselines of the papers.

use nalgebra::SVector;

use crate::coefficients::Fixed;
use crate::damping::Damping;
use crate::galerkin::{Galerkin, in_place};
use crate::newton::{Factors, StepMatrix};
use crate::real::Real;
use crate::scheme::{Sampling, Scheme, State, Step, StepError};
use crate::system::Mechanics;
use crate::workspace::{CachedFactor, Workspace};

/// Explicit Euler method.
///
/// ```text
/// q_{k+1} = q_k + h M⁻¹ p_k ,     p_{k+1} = p_k − h ∇U(q_k) + h F(t_k, q_k) − h Σ_m ρ_m (D^{β_m} q)_{k+1}
/// ```
///
/// q_{k+1} is known before the damping at k + 1 is computed; for β = 1 and Grünwald–Letnikov weights the last
/// term is ρ (q_{k+1} − q_k) = h ρ M⁻¹ p_k, the explicit Euler method of the linearly damped system.
/// Source: \[JO\] §5, eq. 44.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExplicitEuler;

/// Implicit Euler method.
///
/// ```text
/// q_{k+1} = q_k + h M⁻¹ p_{k+1} ,
/// p_{k+1} = p_k − h ∇U(q_{k+1}) + h F(t_{k+1}, q_{k+1}) − h Σ_m ρ_m (D^{β_m} q)_{k+1}
/// ```
///
/// Source: \[JO\] §5, eq. 44.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImplicitEuler;

impl ExplicitEuler {
    /// The coefficients that turn
    /// [`step_damped_at_main_nodes`](crate::DiscreteLagrangian::step_damped_at_main_nodes) into this method:
    /// U and F count at the beginning of the step and in the new momentum only.
    #[inline(always)]
    pub fn coefficients<T: Real>() -> Galerkin<T, 1, 1> {
        Galerkin::of_degree_one(T::zero(), T::zero(), T::zero())
    }
}

impl ImplicitEuler {
    /// The coefficients that turn [`step_damped_at_nodes`](crate::DiscreteLagrangian::step_damped_at_nodes)
    /// into this method: all forces count at the end of the step and in both of its equations.
    #[inline(always)]
    pub fn coefficients<T: Real>() -> Galerkin<T, 1, 1> {
        Galerkin::of_degree_one(T::one(), T::one(), T::one())
    }
}

/// [`Scheme`] for a method with the main nodes in its memory.
macro_rules! scheme {
    ($method:ty, $step:ident) => {
        impl<T: Real, const N: usize> Scheme<T, Fixed<N>> for $method {
            type Storage = CachedFactor<Factors<T, N, 1>, T>;

            fn storage<G: Mechanics<T, Fixed<N>>>(&self, _: &Fixed<N>, _: &G) -> Self::Storage {
                CachedFactor::nothing(Factors::zero())
            }

            fn sampling(&self) -> Sampling<'_, T> {
                Sampling::MainNodes
            }

            fn step<G: Mechanics<T, Fixed<N>>, D: Damping<T, Fixed<N>>>(
                &self,
                storage: &mut Self::Storage,
                mechanics: &mut G,
                damping: &mut D,
                step: &Step<'_, T>,
                state: &mut State<SVector<T, N>>,
            ) -> Result<u32, StepError> {
                const S: usize = 1;
                const Q: usize = 1;
                let coefficients = Self::coefficients::<T>();
                let zeros = [[T::zero(); N]; 1];
                in_place!(S, Q; storage, &mut [], mechanics, zeros, [[T::zero(); N]; 1], |workspace| {
                    coefficients.view().$step(workspace, mechanics, damping, step, state)
                })
            }
        }
    };
}

scheme!(ExplicitEuler, step_damped_at_main_nodes);
scheme!(ImplicitEuler, step_damped_at_nodes);
