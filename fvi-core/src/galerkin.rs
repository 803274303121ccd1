//! Galerkin discrete Lagrangians: polynomial trajectories, quadrature of the action, and the step they give.

use nalgebra::SVector;

use crate::damping::AffineForce;
use crate::error::ParameterError;
use crate::linear::Nodes;
use crate::newton::newton;
use crate::real::Real;
use crate::scheme::{Sampling, Scheme, StepEnd, StepError, StepStart};
use crate::system::{Force, Instant, Potential, System};

/// Discrete Lagrangian on polynomials of degree S with a quadrature of Q points.
///
/// ```text
/// L_d = h Σ_i b_i L(q_d(c_i h), q̇_d(c_i h)) ,     q_d(τh) = q_k + Σ_{ν=1}^{S} ℓ_ν(τ) e^ν ,     e^ν = q^ν − q_k
/// ```
///
/// through the control points 0 = d₀ < d₁ < … < d_S = 1. Degree 1 with one point at 1 − κ is the low-order discrete Lagrangian
/// (1/2h) Δqᵀ M Δq − h U(κ q_k + (1−κ) q_{k+1}), see [`low_order`](Galerkin::low_order).
///
/// As a [`Scheme`] it is the fractional variational integrator in (q, p) form, whose memory stores the main nodes:
///
/// ```text
/// p_k = −D₁L_d − f₀ ,    0 = D_νL_d + f_ν (inner nodes) ,    p_{k+1} = D_{S+1}L_d + f_S − h Σ_m ρ_m (D^{β_m} q)_{k+1}
/// ```
///
/// with the virtual work f_ν = h Σ_i b_i ℓ_ν(c_i) F of the external force. Eliminating p gives [JO] Algorithm 3 and [HJO] eq. 38a,
/// 44a–b (Algorithm 1). The fractional force involves q_{k+1} only after the first two lines have found it.
///
/// Source: [JO] eq. 45a, 57, 63–66; [HJO] eq. 6–7, 42.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Galerkin<T, const S: usize, const Q: usize> {
    /// Quadrature weights b_i.
    weights: [T; Q],
    /// Quadrature nodes c_i.
    nodes: [T; Q],
    /// Control points d_1 … d_S.
    control_points: [T; S],
    /// ℓ_ν(c_i), ν = 1…S.
    shapes: [[T; S]; Q],
    /// ℓ_ν(c_i), ν = 0…S−1: the shapes that the S equations are tested with.
    tests: [[T; S]; Q],
    /// Σ_i b_i ℓ̇_ν(c_i) ℓ̇_μ(c_i), row ν = 0…S−1, column μ = 1…S.
    kinetic: [[T; S]; S],
}

impl<T: Real> Galerkin<T, 1, 1> {
    /// The low-order discrete Lagrangian of [JO] eq. 57, potential at κ q_k + (1−κ) q_{k+1}.
    ///
    /// κ = ½ is the midpoint rule (order 2 for the conservative part); κ = 0 and 1 are the two symplectic Euler methods.
    ///
    /// # Errors
    /// If κ is outside [0, 1].
    pub fn low_order(kappa: T) -> Result<Self, ParameterError> {
        ParameterError::check(
            kappa >= T::zero() && kappa <= T::one(),
            "kappa",
            kappa.to_f64(),
            "at least 0 and at most 1",
        )?;
        let node = T::one() - kappa;
        Ok(Self {
            weights: [T::one()],
            nodes: [node],
            control_points: [T::one()],
            shapes: [[node]],
            tests: [[kappa]],
            kinetic: [[-T::one()]],
        })
    }
}

/// What the equations of a step say once the nodes are found.
struct Solution<T, const N: usize, const S: usize, const Q: usize> {
    /// e^1 … e^S.
    increments: Nodes<T, N, S>,
    /// h Σ_i b_i G_i, what the momentum loses by the forces at the quadrature nodes.
    impulse: SVector<T, N>,
    iterations: u32,
}

impl<T: Real, const S: usize, const Q: usize> Galerkin<T, S, Q> {
    /// X_i − q_k = Σ_ν ℓ_ν(c_i) e^ν.
    #[inline]
    fn stages<const N: usize>(&self, increments: &Nodes<T, N, S>) -> Nodes<T, N, Q> {
        self.shapes.map(|shapes| {
            shapes.iter().zip(increments).fold(SVector::zeros(), |sum, (&shape, e)| sum + e * shape)
        })
    }

    /// Solves the first S equations for the nodes.
    ///
    /// With G_i = ∇U(X_i) − F(t_k + c_i h, X_i) − u, plus the fractional force where it acts at the stages, equation ν = 0…S−1 is
    ///
    /// ```text
    /// 0 = δ_{ν0} p_k + (1/h) Σ_μ K_{νμ} M e^μ − h Σ_i b_i ℓ_ν(c_i) G_i ,      K_{νμ} = Σ_i b_i ℓ̇_ν(c_i) ℓ̇_μ(c_i)
    /// ```
    ///
    /// The shapes add to one and their derivatives to zero, so the last equation is p_{k+1} = p_k − h Σ_i b_i G_i.
    #[inline]
    fn solve<const N: usize, P: Potential<T, N>, F: Force<T, N>>(
        &self,
        system: &System<T, N, P, F>,
        start: &StepStart<T, N>,
        stage_force: Option<&AffineForce<T, N, Q>>,
    ) -> Result<Solution<T, N, S, Q>, StepError> {
        let h = start.step_size;
        let instants = self.nodes.map(|node| Instant::in_step(start.time, node, h));
        let forces = |stages: &Nodes<T, N, Q>| {
            let mut forces = [SVector::zeros(); Q];
            for (i, ((force, stage), instant)) in forces.iter_mut().zip(stages).zip(instants).enumerate() {
                *force = system.pull(instant, &(start.position + stage)) - start.input;
                if let Some(damping) = stage_force {
                    *force += damping.at(i, stages);
                }
            }
            forces
        };
        let drift = system.mass.velocity(&start.momentum) * h;
        let mut increments = self.control_points.map(|point| drift * point);
        let mass = system.mass.matrix();
        let dense_mass = mass.to_matrix();
        let iterations = newton(&mut increments, start.position.amax(), |increments, jacobian| {
            let stages = self.stages(increments);
            let forces = forces(&stages);
            let mut residual = [SVector::zeros(); S];
            if let Some(first) = residual.first_mut() {
                *first = start.momentum;
            }
            for ((residual, blocks), kinetic) in
                residual.iter_mut().zip(jacobian.iter_mut()).zip(&self.kinetic)
            {
                for ((block, &kinetic), increment) in blocks.iter_mut().zip(kinetic).zip(increments) {
                    let factor = kinetic / h;
                    *block = dense_mass * factor;
                    *residual += mass.multiply(increment) * factor;
                }
            }
            let quadrature = self.weights.iter().zip(&self.tests).zip(&self.shapes);
            for (i, (((&weight, tests), shapes), (force, (stage, &instant)))) in
                quadrature.zip(forces.iter().zip(stages.iter().zip(&instants))).enumerate()
            {
                let stiffness = system.stiffness(instant, &(start.position + stage));
                for ((residual, blocks), &test) in residual.iter_mut().zip(jacobian.iter_mut()).zip(tests) {
                    let factor = h * weight * test;
                    *residual -= force * factor;
                    for (block, &shape) in blocks.iter_mut().zip(shapes) {
                        *block -= stiffness * (factor * shape);
                    }
                    let damping_row = stage_force.and_then(|damping| damping.leading.get(i));
                    for (leading, shapes) in damping_row.into_iter().flatten().zip(&self.shapes) {
                        for (block, &shape) in blocks.iter_mut().zip(shapes) {
                            *block -= leading * (factor * shape);
                        }
                    }
                }
            }
            residual
        })?;
        let impulse = self
            .weights
            .iter()
            .zip(&forces(&self.stages(&increments)))
            .fold(SVector::zeros(), |sum, (&weight, force)| sum + force * (h * weight));
        Ok(Solution { increments, impulse, iterations })
    }
}

impl<T: Real, const N: usize, const S: usize, const Q: usize> Scheme<T, N, 1> for Galerkin<T, S, Q> {
    fn sampling(&self) -> Sampling<T, 1> {
        Sampling::MainNodes
    }

    #[inline]
    fn step<P: Potential<T, N>, F: Force<T, N>>(
        &self,
        system: &System<T, N, P, F>,
        start: &StepStart<T, N>,
        damping: &AffineForce<T, N, 1>,
    ) -> Result<StepEnd<T, N, 1>, StepError> {
        let solution = self.solve(system, start, None)?;
        let rise = solution.increments.last().copied().unwrap_or_else(SVector::zeros);
        let position = start.position + rise;
        let momentum = start.momentum - solution.impulse - damping.at(0, &[rise]) * start.step_size;
        Ok(StepEnd { position, momentum, samples: [position], iterations: solution.iterations })
    }
}
