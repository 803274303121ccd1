//! The explicit and the implicit Euler method with the same memory: the baselines of the papers.

use nalgebra::SVector;

use crate::damping::AffineForce;
use crate::newton::newton;
use crate::real::Real;
use crate::scheme::{Sampling, Scheme, StepEnd, StepError, StepStart};
use crate::system::{Force, Instant, Potential, System};

/// Explicit Euler method.
///
/// ```text
/// q_{k+1} = q_k + h M⁻¹ p_k ,     p_{k+1} = p_k − h ∇U(q_k) + h F(t_k, q_k) − h Σ_m ρ_m (D^{β_m} q)_{k+1}
/// ```
///
/// q_{k+1} is known before the memory is asked for it; for β = 1 and Grünwald–Letnikov weights the last term is ρ (q_{k+1} − q_k) =
/// h ρ M⁻¹ p_k, the explicit Euler method of the linearly damped system. Source: \[JO\] §5, eq. 44.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExplicitEuler;

/// Implicit Euler method.
///
/// ```text
/// q_{k+1} = q_k + h M⁻¹ p_{k+1} ,     p_{k+1} = p_k − h ∇U(q_{k+1}) + h F(t_{k+1}, q_{k+1}) − h Σ_m ρ_m (D^{β_m} q)_{k+1}
/// ```
///
/// Source: \[JO\] §5, eq. 44.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImplicitEuler;

impl<T: Real, const N: usize> Scheme<T, N, 1> for ExplicitEuler {
    fn sampling(&self) -> Sampling<T, 1> {
        Sampling::MainNodes
    }

    fn step<P: Potential<T, N>, F: Force<T, N>>(
        &self,
        system: &System<T, N, P, F>,
        start: &StepStart<T, N>,
        damping: &AffineForce<T, N, 1>,
    ) -> Result<StepEnd<T, N, 1>, StepError> {
        let h = start.step_size;
        let instant = Instant::in_step(start.time, T::zero(), h);
        let rise = system.mass.velocity(&start.momentum) * h;
        let force = system.pull(instant, &start.position) - start.input + damping.at(0, &[rise]);
        let position = start.position + rise;
        Ok(StepEnd { position, momentum: start.momentum - force * h, samples: [position], iterations: 0 })
    }
}

impl<T: Real, const N: usize> Scheme<T, N, 1> for ImplicitEuler {
    fn sampling(&self) -> Sampling<T, 1> {
        Sampling::MainNodes
    }

    fn step<P: Potential<T, N>, F: Force<T, N>>(
        &self,
        system: &System<T, N, P, F>,
        start: &StepStart<T, N>,
        damping: &AffineForce<T, N, 1>,
    ) -> Result<StepEnd<T, N, 1>, StepError> {
        let h = start.step_size;
        let instant = Instant::in_step(start.time, T::one(), h);
        let mass = system.mass.matrix();
        let dense_mass = mass.to_matrix();
        let mut rise = [system.mass.velocity(&start.momentum) * h];
        let force = |rise: &[SVector<T, N>; 1]| {
            let [increment] = rise;
            system.pull(instant, &(start.position + increment)) - start.input + damping.at(0, rise)
        };
        // 0 = p_k − h G(q_k + e) − M e / h
        let iterations = newton(&mut rise, start.position.amax(), |rise, [[jacobian]]| {
            let [[leading]] = &damping.leading;
            let [increment] = rise;
            let stiffness = system.stiffness(instant, &(start.position + increment));
            *jacobian = -(dense_mass * (T::one() / h) + (stiffness + leading) * h);
            [start.momentum - force(rise) * h - mass.multiply(increment) * (T::one() / h)]
        })?;
        let momentum = start.momentum - force(&rise) * h;
        let position = start.position + rise[0];
        Ok(StepEnd { position, momentum, samples: [position], iterations })
    }
}
