//! The equation of a step on a straight line with one quadrature node, the most common one, without loops
//! over unknowns and nodes.

use core::marker::PhantomData;

use crate::damping::Damping;
use crate::linear::{combine, combine_two, fill_pair};
use crate::newton::{Equations, Linearised, Stiffened, newton, size};
use crate::real::Real;
use crate::scheme::{State, Step, StepError};
use crate::space::{Block, Space, part, part_mut, vectors};
use crate::system::{Instant, Mechanics};
use crate::workspace::{CachedFactor, Workspace};

/// A discrete Lagrangian of degree 1 with one node.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OneNode<T> {
    /// b
    pub(crate) weight: T,
    /// c
    pub(crate) node: T,
    /// ℓ₁(c)
    pub(crate) shape: T,
    /// ℓ₀(c)
    pub(crate) test: T,
    /// b ℓ̇₀(c) ℓ̇₁(c)
    pub(crate) kinetic: T,
}

impl<T: Real> OneNode<T> {
    /// Solves
    ///
    /// ```text
    /// 0 = p_k + (K/h) M e − h b ℓ₀(c) G ,     G = ∇U(X) − F(t_k + ch, X) − u ,     X = q_k + ℓ₁(c) e ,
    /// ```
    ///
    /// for e = q_{k+1} − q_k, and leaves h b G in `work.residual`, as is done for any degree. F may depend on
    /// the velocity e/h of the line; if the damping acts at the node, G contains its force. The first
    /// `moments` numbers of `work.moment_correction` are the part of the force moments that the node misses.
    ///
    /// # Errors
    /// [`StepError`].
    #[inline(always)]
    pub(crate) fn solve<X, Y, E, G, D>(
        &self,
        work: &mut Workspace<'_, T, X, E>,
        mechanics: &mut G,
        damping: Option<&D>,
        step: &Step<'_, T>,
        state: &State<X::Vector>,
        moments: usize,
    ) -> Result<u32, StepError>
    where
        X: Space<T>,
        E: Equations<T, X::Block>,
        Y: Space<T, Vector = X::Vector, Block = X::Block>,
        G: Mechanics<T, Y>,
        D: Damping<T, Y>,
    {
        let Workspace {
            increments,
            residual,
            stages,
            forces,
            known,
            scratch,
            moment_correction,
            restoring,
            ..
        } = work;
        let (position, momentum) = (X::slice(&state.position), X::slice(&state.momentum));
        let moment_correction = part(moment_correction, moments);
        let (linear, drifts) = (mechanics.is_linear(), self.test == T::zero());
        let from_rest = linear && damping.is_some() && !drifts;
        self.guess::<X, Y, G>(
            mechanics,
            step.size,
            (from_rest, drifts),
            (increments, stages),
            (momentum, restoring),
        );
        let mut equation = Equation::<T, X, Y, G, D> {
            storage: PhantomData,
            numbers: self,
            instant: Instant::in_step(step.time, self.node, step.size),
            mechanics,
            damping,
            step,
            position,
            momentum,
            stage: stages,
            force: forces,
            known,
            moment_correction,
            scratch,
            point: &mut *work.point,
            stiffness: &mut *work.stiffness,
        };
        let iterations = if drifts {
            equation.evaluate(increments, false);
            0
        } else if linear {
            equation.solve_linear((increments, residual), from_rest, &mut *work.matrix, &mut *work.kept)?;
            1
        } else {
            equation.solve_nonlinear::<E>((increments, residual), &mut *work.matrix)?
        };
        let impulse = step.size * self.weight;
        combine(residual, equation.force, |_, force| force * impulse);
        for moment in vectors(moment_correction, position.len()) {
            combine(residual, moment, |place, moment| place - moment * step.size);
        }
        Ok(iterations)
    }

    /// Writes the first guess of e: zero `from_rest`, h v if the node `drifts` with the start, and otherwise
    /// what the restoring force of the last step leaves of h v.
    #[inline(always)]
    fn guess<X, Y, G>(
        &self,
        mechanics: &mut G,
        length: T,
        (from_rest, drifts): (bool, bool),
        (increments, stages): (&mut [T], &mut [T]),
        (momentum, restoring): (&[T], &[T]),
    ) where
        X: Space<T>,
        Y: Space<T, Vector = X::Vector, Block = X::Block>,
        G: Mechanics<T, Y>,
    {
        if from_rest {
            // A linear system needs no guess, and the guess for a fast stiff motion would be so large that
            // the position is lost in its rounding.
            increments.fill(T::zero());
        } else if drifts {
            // Without an equation to solve the guess is the result.
            mechanics.velocity(momentum, increments);
            scale(increments, length);
        } else if restoring.is_empty() {
            mechanics.drift(momentum, increments);
            scale(increments, length);
        } else {
            // The guess is the solution for the G of the last step, with each coordinate limited to twice its
            // force-free displacement: a stiff force of the last step is no estimate of the present one.
            let impulse = length * self.weight * self.test;
            combine_two(stages, momentum, restoring, |_, p, restoring| {
                let change = restoring * impulse;
                if change.abs() > p.abs() { p } else { p - change }
            });
            mechanics.drift(stages, increments);
            scale(increments, -(length / self.kinetic));
        }
    }
}

/// x ← factor · x
#[inline(always)]
fn scale<T: Real>(x: &mut [T], factor: T) {
    x.iter_mut().for_each(|x| *x *= factor);
}

/// x ← x − `correction`
#[inline(always)]
fn take_off<T: Real>(x: &mut [T], correction: &[T]) {
    combine(x, correction, |x, correction| x - correction);
}

/// The velocity e/h of a straight line.
#[inline(always)]
fn line_velocity<T: Real>(increments: &[T], h: T, velocity: &mut [T]) {
    velocity.iter_mut().zip(increments).for_each(|(velocity, &e)| *velocity = e / h);
}

/// The equation at a guess of e.
struct Equation<'a, T: Real, X: Space<T>, Y, G, D> {
    storage: PhantomData<Y>,
    numbers: &'a OneNode<T>,
    /// The time of the node.
    instant: Instant<T>,
    mechanics: &'a mut G,
    /// Damping, if it acts at the node.
    damping: Option<&'a D>,
    step: &'a Step<'a, T>,
    position: &'a [T],
    momentum: &'a [T],
    /// X − q_k
    stage: &'a mut [T],
    /// G
    force: &'a mut [T],
    known: &'a [T],
    moment_correction: &'a [T],
    scratch: &'a mut [T],
    /// X
    point: &'a mut X::Vector,
    /// ∂²U/∂q² − ∂F/∂q at X
    stiffness: &'a mut X::Block,
}

impl<T, X, Y, G, D> Equation<'_, T, X, Y, G, D>
where
    T: Real,
    X: Space<T>,
    Y: Space<T, Vector = X::Vector, Block = X::Block>,
    G: Mechanics<T, Y>,
    D: Damping<T, Y>,
{
    /// Solves the equation of a linear system, `from_rest` with increments that are zero, by factors kept
    /// from step to step, and leaves G at the solution.
    #[inline(always)]
    fn solve_linear<E: Equations<T, X::Block>>(
        &mut self,
        (increments, residual): (&mut [T], &mut [T]),
        from_rest: bool,
        matrix: &mut E,
        kept: &mut CachedFactor<E::Factor, T>,
    ) -> Result<(), StepError> {
        let length = self.step.size;
        if kept.length == length {
            self.evaluate_first(increments, from_rest, false);
        } else {
            self.evaluate_first(increments, from_rest, true);
            self.write_matrix(increments, (&mut *matrix, None));
            let inertia = (self.numbers.kinetic / length, self.mechanics.mass());
            matrix.keep(&mut kept.solver, inertia).map_err(|_| StepError::SingularJacobian)?;
            let stays = self.damping.is_none_or(|damping| damping.leading_is_constant());
            kept.length = if stays { length } else { T::zero() };
        }
        self.balance(increments, residual);
        matrix.solve_kept(&kept.solver, residual);
        take_off(increments, residual);
        // The rounding error of the solver is the same at every step, so that it would accumulate to growth
        // or decay. A second correction, with the force that is needed anyway, removes it.
        self.evaluate(increments, false);
        if !matrix.is_solved_at_once(&kept.solver) {
            self.balance(increments, residual);
            if matrix.is_unsettled(&kept.solver, increments, self.position, residual) {
                matrix.solve_kept(&kept.solver, residual);
                take_off(increments, residual);
                // If the damping acts at the node, the node is its sample.
                if self.damping.is_some() {
                    self.place_stage(increments);
                }
            }
        }
        Ok(())
    }

    /// Solves the equation by Newton's method and leaves G at the solution; how many iterations it took.
    #[inline(always)]
    fn solve_nonlinear<E: Equations<T, X::Block>>(
        &mut self,
        (increments, residual): (&mut [T], &mut [T]),
        matrix: &mut E,
    ) -> Result<u32, StepError> {
        let moves = self.mechanics.depends_on_velocity();
        let at = (size(self.position), moves);
        let balance = |increments: &[T], residual: &mut [T], matrix: Option<Linearised<'_, E, T>>| {
            self.evaluate(increments, matrix.is_some());
            self.balance(increments, residual);
            if let Some(matrix) = matrix {
                self.write_matrix(increments, matrix);
            }
        };
        let converged = newton(increments, residual, at, matrix, balance)?;
        // The final force is the last one plus its linear change, if the neglected remainder is of rounding
        // size.
        let rounding = T::of(0.25) * T::EPSILON * self.step.size * self.numbers.weight * size(self.force);
        // With a velocity-dependent force the matrix at hand is the resistance, not the stiffness.
        if !moves && converged.residual.is_some_and(|left| left <= rounding) {
            self.carry_on(increments, residual);
        } else {
            self.evaluate(increments, false);
            if converged.leaves_residual {
                self.settle(increments, residual);
            }
        }
        Ok(converged.iterations)
    }

    /// Places the node and computes G, with its derivative if `linearise`.
    #[inline(always)]
    fn evaluate(&mut self, increments: &[T], linearise: bool) {
        let shape = self.numbers.shape;
        let places = (&mut *self.stage, X::slice_mut(self.point));
        fill_pair(places, (increments, self.position), |e, q| (e * shape, q + e * shape));
        self.find_force(increments, linearise);
        if let Some(damping) = self.damping {
            damping.add_leading(self.stage, self.force, self.scratch);
        }
    }

    /// [`evaluate`](Self::evaluate) for the first iteration, where the increments are often zero.
    #[inline(always)]
    fn evaluate_first(&mut self, increments: &[T], are_zero: bool, linearise: bool) {
        if !are_zero {
            return self.evaluate(increments, linearise);
        }
        combine(X::slice_mut(self.point), self.position, |_, q| q);
        self.find_force(increments, linearise);
    }

    /// Computes G at the node without the contribution of the increments to the damping.
    #[inline(always)]
    fn find_force(&mut self, increments: &[T], linearise: bool) {
        let instant = self.instant;
        if self.mechanics.depends_on_velocity() {
            let velocity = part_mut(self.scratch, increments.len());
            line_velocity(increments, self.step.size, velocity);
            if linearise {
                let restoring = (&mut *self.force, &mut *self.stiffness);
                self.mechanics.linearise_in_motion(instant, self.point, velocity, restoring.0, restoring.1);
            } else {
                self.mechanics.restoring_force_in_motion(instant, self.point, velocity, self.force);
            }
        } else if linearise {
            self.mechanics.linearise(instant, self.point, self.force, self.stiffness);
        } else {
            self.mechanics.restoring_force(instant, self.point, self.force);
        }
        // The input may have fewer numbers; missing ones are zero.
        self.force.iter_mut().zip(self.step.input).for_each(|(force, &input)| *force -= input);
        if self.damping.is_some() {
            combine(self.force, self.known, |force, known| force + known);
        }
    }

    /// Adds the linear change of G by the last correction, and moves the node by it.
    #[inline(always)]
    fn carry_on(&mut self, increments: &[T], correction: &[T]) {
        let shape = self.numbers.shape;
        combine(self.stage, correction, |_, change| -(change * shape));
        self.stiffness.multiply_add(T::one(), self.stage, self.force);
        if let Some(damping) = self.damping {
            damping.add_leading(self.stage, self.force, self.scratch);
            self.place_stage(increments);
        }
    }

    #[inline(always)]
    fn place_stage(&mut self, increments: &[T]) {
        let shape = self.numbers.shape;
        combine(self.stage, increments, |_, e| e * shape);
    }

    /// Writes the residual of the equation.
    #[inline(always)]
    fn balance(&self, increments: &[T], residual: &mut [T]) {
        let h = self.step.size;
        let factor = h * self.numbers.weight * self.numbers.test;
        // The terms that nearly cancel come first: their difference is exact, and the remainder as small as
        // its rounding.
        let known = (self.momentum, (factor, &*self.force));
        self.mechanics.mass().balance(known, (self.numbers.kinetic / h, increments), residual);
        // The moments of the first shape.
        residual.iter_mut().zip(self.moment_correction).for_each(|(place, &moment)| *place += moment * h);
    }

    /// Changes the force to that which the equation needs.
    fn settle(&mut self, increments: &[T], residual: &mut [T]) {
        self.balance(increments, residual);
        let factor = self.step.size * self.numbers.weight * self.numbers.test;
        combine(self.force, residual, |force, left| force + left / factor);
    }

    /// Writes the derivative of the residual at the increments of the last linearisation, with that of the
    /// forces with respect to the velocity stiffened if the matrix is to be so.
    #[inline(always)]
    fn write_matrix<E: Equations<T, X::Block>>(
        &mut self,
        increments: &[T],
        (matrix, stiffened): Linearised<'_, E, T>,
    ) {
        let (h, numbers) = (self.step.size, self.numbers);
        let factor = h * numbers.weight * numbers.test * numbers.shape;
        matrix.clear();
        matrix.add(0, 0, numbers.kinetic / h, self.mechanics.mass());
        matrix.add(0, 0, -factor, self.stiffness);
        if self.mechanics.depends_on_velocity() {
            let instant = self.instant;
            let velocity = part_mut(self.scratch, increments.len());
            line_velocity(increments, h, velocity);
            let factor = if let Some(slopes) = stiffened {
                // The slopes of the velocities aside are computed with a force that replaces none.
                Stiffened::move_aside(velocity, slopes.aside / h);
                self.mechanics.linearise_in_motion(instant, self.point, velocity, self.stage, self.stiffness);
                slopes.factor
            } else {
                T::one()
            };
            self.mechanics.resistance(instant, self.point, velocity, self.stiffness);
            matrix.add(0, 0, -(numbers.weight * numbers.test * factor), self.stiffness);
        }
        if let Some(damping) = self.damping {
            damping.visit_leading(1, |_, _, leading, rho| matrix.add(0, 0, -(factor * leading), rho));
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Galerkin, Integrator, Mass, NoForce, Potential, System};
    use nalgebra::{SMatrix, SVector};

    struct Pendulum;

    impl Potential<f64, 1> for Pendulum {
        fn value(&self, q: &SVector<f64, 1>) -> f64 {
            1.0 - q[0].cos()
        }

        fn gradient(&self, q: &SVector<f64, 1>) -> SVector<f64, 1> {
            [q[0].sin()].into()
        }

        fn hessian(&self, q: &SVector<f64, 1>) -> SMatrix<f64, 1, 1> {
            [[q[0].cos()]].into()
        }
    }

    #[test]
    fn what_changes_the_momentum_is_the_force_at_the_node_to_rounding() {
        for h in [0.3, 0.1, 0.03, 0.01] {
            let system = System { mass: Mass::diagonal([1.0]).unwrap(), potential: Pendulum, force: NoForce };
            let scheme = Galerkin::low_order(0.5).unwrap();
            let mut integrator = Integrator::builder(system, scheme, h).position([2.5]).build().unwrap();
            let (mut q, mut p) = (2.5, 0.0);
            for step in 0..20_000 {
                integrator.step(&[0.0].into()).unwrap();
                let state = integrator.state();
                let (next_q, next_p) = (state.position[0], state.momentum[0]);
                let node: f64 = 0.5 * (q + next_q);
                let error = next_p - p + h * node.sin();
                // Rounding of the two momenta, of the node, and of the force itself.
                let rounding = 0.5 * f64::EPSILON * (p.abs() + next_p.abs() + h * (2.0 * node.abs() + 1.0));
                assert!(error.abs() < 3.0 * rounding, "h = {h}, step {step}: {}", error / rounding);
                (q, p) = (next_q, next_p);
            }
        }
    }
}
