//! The trait of mechanical systems with any Lagrangian L(q, v).

use crate::memory::MemoryError;
use crate::real::Real;
use crate::system::Instant;

/// A mechanical system
///
/// ```text
/// d/dt L_v − L_q = F(t, q, v) − Σ_e G_eᵀ f_e − Cᵀ λ ,      c(q) = 0 ,
/// ```
///
/// of N coordinates, M holonomic constraints c with C = ∂c/∂q, and E elongations g_e(q) with
/// G_e = ∂g_e/∂q, along which dampers with memory pull with the forces f_e. The Lagrangian is regular: L_vv
/// is positive definite on the kernel of C.
///
/// Matrices are row by row. Every method writes all numbers of its outputs; those that add say so.
pub trait Lagrangian<T> {
    /// N.
    fn coordinates(&self) -> usize;

    /// M.
    fn constraints(&self) -> usize {
        0
    }

    /// E.
    fn elongations(&self) -> usize {
        0
    }

    /// Writes L_v and L_q + F, N numbers each.
    fn first(
        &mut self,
        instant: Instant<T>,
        position: &[T],
        velocity: &[T],
        momentum: &mut [T],
        force: &mut [T],
    );

    /// Writes the derivatives of L_v and of L_q + F, N×N matrices.
    fn second(&mut self, instant: Instant<T>, position: &[T], velocity: &[T], parts: Second<'_, T>);

    /// Writes c and C, M and M×N numbers.
    fn constrain(&mut self, position: &[T], values: &mut [T], jacobian: &mut [T]) {
        let _ = (position, values, jacobian);
    }

    /// Adds `factor` Σ_j λ_j ∂²c_j/∂q² to an N×N matrix.
    fn add_constraint_curvature(&mut self, position: &[T], multipliers: &[T], factor: T, sum: &mut [T]) {
        let _ = (position, multipliers, factor, sum);
    }

    /// Writes G, E×N numbers.
    fn elongate(&mut self, position: &[T], jacobian: &mut [T]) {
        let _ = (position, jacobian);
    }

    /// Writes vᵀ ∂²g_e/∂q² for every elongation, E×N numbers, and adds −Σ_e f_e ∂²g_e/∂q² to an N×N matrix.
    fn turn(&mut self, position: &[T], velocity: &[T], forces: &[T], turning: &mut [T], stiffness: &mut [T]) {
        let _ = (position, velocity, forces, turning, stiffness);
    }

    /// True if L_vv is positive definite and the same everywhere, so that it need not be looked at.
    fn has_constant_mass(&self) -> bool {
        false
    }

    /// U, with ∂U/∂q, N numbers, and ∂²U/∂q², N×N numbers, if asked for, of a system with L = ½vᵀMv − U(q)
    /// and a constant M; `None` without them, if the system does not tell them or has another L. What is left
    /// of L_q + F at rest is F.
    fn potential(&mut self, position: &[T], gradient: &mut [T], hessian: Option<&mut [T]>) -> Option<T> {
        let _ = (position, gradient, hessian);
        None
    }

    /// For a system with L = ½vᵀM(q)v + a(q)ᵀv − U(q): the form
    ///
    /// ```text
    /// Λ(q; v, w) = ½ vᵀM(q)w + ½ a(q)ᵀ(v + w) − U(q) = 2L(q, (v + w)/2) − ½L(q, v) − ½L(q, w) ,
    /// ```
    ///
    /// and the sum of the absolute values that it is made of, which says how much of it rounding is; with
    /// ∂Λ/∂q, N numbers, and ∂²Λ/∂q², N×N numbers, if asked for. `None` without them, if the system does not
    /// tell them. What L_q + F has beyond ∂Λ/∂q for v = w is F.
    fn polarised(
        &mut self,
        position: &[T],
        velocities: [&[T]; 2],
        gradient: &mut [T],
        hessian: Option<&mut [T]>,
    ) -> Option<[T; 2]> {
        let _ = (position, velocities, gradient, hessian);
        None
    }

    /// The energy L_vᵀ v − L.
    fn energy(&mut self, position: &[T], velocity: &[T]) -> T;
}

/// Second derivatives, N×N numbers each, row by row.
#[derive(Debug)]
pub struct Second<'a, T> {
    /// L_vv.
    pub mass: &'a mut [T],
    /// ∂L_v/∂q.
    pub coupling: &'a mut [T],
    /// ∂(L_q + F)/∂q.
    pub stiffness: &'a mut [T],
    /// ∂(L_q + F)/∂v.
    pub resistance: &'a mut [T],
}

/// The dampers of a mechanism: forces f = (Z ∗ W) along its elongations, of the velocities W = G V at the
/// nodes of the steps so far.
///
/// Numbers of elongation e at node i are at e·s + i.
pub trait Dampers<T> {
    /// Number of elongations E.
    fn elongations(&self) -> usize;

    /// Begins at rest, for a motion whose elongations have these velocities at first.
    fn begin(&mut self, velocities: &[T]);

    /// Sets the length of the step to come.
    ///
    /// # Errors
    /// If the memories do not take it; nothing has changed.
    fn begin_step(&mut self, length: T) -> Result<(), MemoryError>;

    /// Writes the forces that the steps so far leave in the step to come.
    fn known(&self, forces: &mut [T]);

    /// ∂f of elongation `row` at node i with respect to W of elongation `column` at node j.
    fn leading(&self, places: [usize; 2], nodes: [usize; 2]) -> T;

    /// Stores the velocities of a step.
    fn push(&mut self, velocities: &[T]);

    /// Writes δ_e, by which the impulse of the discrete memory of the velocities W₀ + Ẇ₀t, given as W₀ and
    /// Ẇ₀, exceeds that of the kernel: known from the lengths of the steps alone.
    fn excess(&self, start: [&[T]; 2], excess: &mut [T]);

    /// Writes the forces that velocities have at once, before any time has passed.
    fn sudden(&self, velocities: &[T], forces: &mut [T]);

    /// The energy stored in the memories.
    fn stored(&self) -> T;
}

/// No dampers.
impl<T: Real> Dampers<T> for () {
    fn elongations(&self) -> usize {
        0
    }

    fn begin(&mut self, _: &[T]) {}

    fn begin_step(&mut self, _: T) -> Result<(), MemoryError> {
        Ok(())
    }

    fn known(&self, forces: &mut [T]) {
        forces.fill(T::zero());
    }

    fn leading(&self, _: [usize; 2], _: [usize; 2]) -> T {
        T::zero()
    }

    fn push(&mut self, _: &[T]) {}

    fn excess(&self, _: [&[T]; 2], excess: &mut [T]) {
        excess.fill(T::zero());
    }

    fn sudden(&self, _: &[T], forces: &mut [T]) {
        forces.fill(T::zero());
    }

    fn stored(&self) -> T {
        T::zero()
    }
}
