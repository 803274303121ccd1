//! One step of a discrete Lagrangian on polynomials, for any degree, quadrature and space.

use core::marker::PhantomData;

use crate::damping::Damping;
use crate::linear::all_finite;
use crate::linear::{add_multiple, at, combine};
use crate::newton::{Equations, Linearised, Stiffened, newton, size};
use crate::one_node::OneNode;
use crate::real::Real;
use crate::scheme::{Outcome, State, Step, StepError, conclude};
use crate::space::{
    Block, Space, called, last_vector, part, part_mut, parts_mut, vector_at, vectors, vectors_mut,
};
use crate::system::{Instant, Mechanics, NodalRule};
use crate::workspace::{CachedFactor, Workspace};

/// Discrete Lagrangian on polynomials of degree S with a quadrature of Q points, as a view of its
/// coefficients.
///
/// ```text
/// L_d = h Σ_i b_i L(q_d(c_i h), q̇_d(c_i h)) ,     q_d(τh) = q_k + Σ_{ν=1}^{S} ℓ_ν(τ) e^ν ,
/// e^ν = q^ν − q_k
/// ```
///
/// S and Q are the lengths of the slices. Where these are known at compile time, as in the view of a
/// [`Galerkin`](crate::Galerkin), they cost nothing. Source: \[HJO\] eq. 6–7, 42.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiscreteLagrangian<'a, T> {
    /// Quadrature weights b_i, Q numbers.
    pub weights: &'a [T],
    /// Quadrature nodes c_i, Q numbers.
    pub nodes: &'a [T],
    /// Control points d_1 … d_S.
    pub control_points: &'a [T],
    /// ℓ_ν(c_i), S numbers ν = 1…S for each i.
    pub shapes: &'a [T],
    /// ℓ_ν(c_i), S numbers ν = 0…S−1 for each i: the test functions of the S equations.
    pub tests: &'a [T],
    /// K_νμ = Σ_i b_i ℓ̇_ν(c_i) ℓ̇_μ(c_i), S numbers μ = 1…S for each row ν = 0…S−1.
    pub kinetic: &'a [T],
}

impl<T: Real> DiscreteLagrangian<'_, T> {
    /// The same discrete Lagrangian without tables, if it has one unknown node and one quadrature point.
    #[inline(always)]
    fn one_node(&self) -> Option<OneNode<T>> {
        let ([_], &[weight], &[node]) = (self.control_points, self.weights, self.nodes) else { return None };
        let (&[shape], &[test], &[kinetic]) = (self.shapes, self.tests, self.kinetic) else { return None };
        Some(OneNode { weight, node, shape, test, kinetic })
    }

    /// Number of unknown nodes S.
    #[inline(always)]
    fn degree(&self) -> usize {
        self.control_points.len()
    }

    /// True if no force enters the equation for q_{k+1}, so that the position drifts: a straight line with ℓ₀
    /// = 0 at every node.
    #[inline(always)]
    fn drifts(&self) -> bool {
        self.degree() == 1 && self.tests.iter().all(|test| *test == T::zero())
    }

    /// ℓ̇_ν(c_i) of node i and the unknown ν = 1…S, both counted from zero: the velocity of the polynomial at
    /// the node is Σ_ν ℓ̇_ν(c_i) e^ν/h.
    pub fn slope(&self, node: usize, unknown: usize) -> T {
        let numbers = (self.nodes.get(node), self.control_points.get(unknown));
        let (Some(&tau), Some(&own)) = numbers else { return T::zero() };
        // ℓ_ν = τ/d_ν Π (τ − d_μ)/(d_ν − d_μ), differentiated factor by factor.
        let inverse = T::one() / own;
        let (mut value, mut slope) = (tau * inverse, inverse);
        for (_, &other) in self.control_points.iter().enumerate().filter(|&(index, _)| index != unknown) {
            let inverse = T::one() / (own - other);
            let factor = (tau - other) * inverse;
            slope = slope * factor + value * inverse;
            value *= factor;
        }
        slope
    }

    /// The velocity of the polynomial at a node.
    fn velocity_at(&self, node: usize, increments: &[T], h: T, velocity: &mut [T]) {
        velocity.fill(T::zero());
        for (unknown, increment) in vectors(increments, velocity.len()).enumerate() {
            add_multiple(velocity, self.slope(node, unknown) / h, increment);
        }
    }

    /// X_i − q_k = Σ_ν ℓ_ν(c_i) e^ν for every node.
    #[inline(always)]
    fn place_stages(&self, increments: &[T], stages: &mut [T], coordinates: usize) {
        let shapes = vectors(self.shapes, self.degree());
        for (stage, shapes) in vectors_mut(stages, coordinates).zip(shapes) {
            let mut terms = shapes.iter().zip(vectors(increments, coordinates));
            let Some((&shape, increment)) = terms.next() else { continue };
            for (place, &e) in stage.iter_mut().zip(increment) {
                *place = e * shape;
            }
            for (&shape, increment) in terms {
                add_multiple(stage, shape, increment);
            }
        }
    }

    /// The step of the fractional variational integrator whose memory stores the main nodes:
    ///
    /// ```text
    /// p_k = −D₁L_d − f₀ ,    0 = D_νL_d + f_ν (inner nodes) ,
    /// p_{k+1} = D_{S+1}L_d + f_S − h Σ_m ρ_m (D^{β_m} q)_{k+1}
    /// ```
    ///
    /// with the virtual work f_ν = h Σ_i b_i ℓ_ν(c_i) F of the external force. The fractional force involves
    /// q_{k+1} only after the first two lines have found it. Source: \[JO\] eq. 63–66, Algorithm 3; \[HJO\]
    /// eq. 38a, 44a–b, Algorithm 1.
    ///
    /// # Errors
    /// [`StepError`]; position, momentum and damping are as before.
    #[inline(always)]
    pub fn step_damped_at_main_nodes<X, Y, E, G, D>(
        &self,
        work: &mut Workspace<'_, T, X, E>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<X::Vector>,
    ) -> Result<u32, StepError>
    where
        X: Space<T>,
        E: Equations<T, X::Block>,
        Y: Space<T, Vector = X::Vector, Block = X::Block>,
        G: Mechanics<T, Y>,
        D: Damping<T, Y>,
    {
        let at_end = [T::one()];
        work.begin(damping, step, &at_end, state)?;
        let iterations = self.solve::<X, Y, E, G, ()>(work, mechanics, None, step, state)?;
        let coordinates = work.known.len();
        let rise = last_vector(work.increments, coordinates);
        damping.add_leading(rise, work.known, work.scratch);
        // The first N numbers of the residual hold the impulse, and in the end p_{k+1} − p_k.
        let kick = part_mut(work.residual, coordinates);
        combine(kick, work.known, |impulse, force| -impulse - force * step.size);
        let found = Outcome { increments: rise, rise, kick };
        conclude::<T, X, Y, D>(damping, step, &at_end, &found, state, work.behind, work.scratch)?;
        combine(work.restoring, work.forces, |_, force| force);
        Ok(iterations)
    }

    /// The step whose fractional force acts at the quadrature nodes X_{k,i} = q_d(c_i h), which the memory
    /// stores:
    ///
    /// ```text
    /// p_k     = −D₁L_d − f₀ + h Σ_i b_i ℓ₀(c_i) Σ_m ρ_m (D^{β_m} X)_{k,i}
    /// 0       = D_νL_d + f_ν − h Σ_i b_i ℓ_ν(c_i) Σ_m ρ_m (D^{β_m} X)_{k,i}        (inner nodes)
    /// p_{k+1} = D_{S+1}L_d + f_S − h Σ_i b_i ℓ_S(c_i) Σ_m ρ_m (D^{β_m} X)_{k,i}
    /// ```
    ///
    /// implicit in the nodes of step k through the leading weight. It follows from the restricted principle
    /// of \[HJO\] eq. 42 with the inner product Σ_k h Σ_i b_i in place of Σ_k h, in which the advanced
    /// operator is the adjoint of the retarded one.
    ///
    /// # Errors
    /// [`StepError`]; position, momentum and damping are as before.
    #[inline(always)]
    pub fn step_damped_at_nodes<X, Y, E, G, D>(
        &self,
        work: &mut Workspace<'_, T, X, E>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<X::Vector>,
    ) -> Result<u32, StepError>
    where
        X: Space<T>,
        E: Equations<T, X::Block>,
        Y: Space<T, Vector = X::Vector, Block = X::Block>,
        G: Mechanics<T, Y>,
        D: Damping<T, Y>,
    {
        work.begin(damping, step, self.nodes, state)?;
        let iterations = self.solve(work, mechanics, Some(damping), step, state)?;
        let coordinates = X::slice(&state.position).len();
        let rise = last_vector(work.increments, coordinates);
        let kick = part_mut(work.residual, coordinates);
        kick.iter_mut().for_each(|number| *number = -*number);
        let found = Outcome { increments: work.stages, rise, kick };
        conclude::<T, X, Y, D>(damping, step, self.nodes, &found, state, work.behind, work.scratch)?;
        combine(work.restoring, work.forces, |_, force| force);
        Ok(iterations)
    }

    /// Sums to the first N numbers of `residual` the impulse of the forces that the S equations need besides
    /// those at hand, which leave this residual r: h Σ_i b_i δG_i, where h Σ_i b_i ℓ_ν(c_i) δG_i = r_ν for
    /// ν < S.
    ///
    /// With as many points as unknowns the polynomial P = Π_i (τ − c_i) is zero at the points, so that
    /// ℓ_S(c_i) = −Σ_{ν<S} P(d_ν)/P(1) ℓ_ν(c_i), and the impulse is Σ_{ν<S} (1 − P(d_ν)/P(1)) r_ν. With more
    /// points, or one at the end, what the equations do not contain of δG is taken as zero.
    fn sum_missed_impulse(&self, coordinates: usize, residual: &mut [T]) {
        let node = |point: T| self.nodes.iter().fold(T::one(), |product, &c| product * (point - c));
        let end = node(T::one());
        let share = |point: T| match self.nodes.len() == self.degree() && end.abs() > T::EPSILON {
            true => T::one() - node(point) / end,
            false => T::one(),
        };
        let (sum, others) = parts_mut(residual, coordinates);
        sum.iter_mut().for_each(|number| *number *= share(T::zero()));
        for (missed, &point) in vectors(others, coordinates).zip(self.control_points) {
            add_multiple(sum, share(point), missed);
        }
    }

    /// Solves the first S equations for the nodes and leaves, in the first N numbers of `work.residual`, the
    /// impulse h Σ_i b_i G_i: what the momentum loses by the forces at the quadrature nodes.
    ///
    /// With G_i = ∇U(X_i) − F(t_k + c_i h, X_i, V_i) − u, V_i = q̇_d(c_i h), plus the fractional force where
    /// it acts at the nodes, equation ν = 0…S−1 is
    ///
    /// ```text
    /// 0 = δ_{ν0} p_k + (1/h) Σ_μ K_{νμ} M e^μ − h Σ_i b_i ℓ_ν(c_i) G_i ,
    /// K_{νμ} = Σ_i b_i ℓ̇_ν(c_i) ℓ̇_μ(c_i)
    /// ```
    ///
    /// The shapes add to one and their derivatives to zero, so the last equation is p_{k+1} = p_k − h Σ_i b_i
    /// G_i.
    #[inline(always)]
    fn solve<X, Y, E, G, D>(
        &self,
        work: &mut Workspace<'_, T, X, E>,
        mechanics: &mut G,
        damping: Option<&D>,
        step: &Step<'_, T>,
        state: &State<X::Vector>,
    ) -> Result<u32, StepError>
    where
        X: Space<T>,
        E: Equations<T, X::Block>,
        Y: Space<T, Vector = X::Vector, Block = X::Block>,
        G: Mechanics<T, Y>,
        D: Damping<T, Y>,
    {
        let rough = !self.drifts() && mechanics.is_rough() && {
            let rule = NodalRule {
                start: step.time,
                length: step.size,
                weights: self.weights,
                nodes: self.nodes,
                points: self.control_points,
                shapes: self.shapes,
                tests: self.tests,
            };
            mechanics.moment_correction(&rule, work.moment_correction)
        };
        let count = if rough { (self.degree() + 1) * X::slice(&state.position).len() } else { 0 };
        if let Some(one) = self.one_node() {
            return one.solve(work, mechanics, damping, step, state, count);
        }
        if X::KNOWN_SIZE {
            self.solve_for_any_nodes(work, mechanics, damping, step, state, count)
        } else {
            called(|| self.solve_for_any_nodes(work, mechanics, damping, step, state, count))
        }
    }

    /// As [`solve`](Self::solve), for any number of unknown nodes and points. The first `moments` numbers of
    /// `work.moment_correction` are the part of the force moments that the quadrature misses.
    #[inline(always)]
    fn solve_for_any_nodes<X, Y, E, G, D>(
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
        let (position, momentum) = (X::slice(&state.position), X::slice(&state.momentum));
        let coordinates = position.len();
        // From here on `scratch` holds one vector for products, and whatever the damping needs.
        if mechanics.is_linear() && damping.is_some() && !self.drifts() {
            // A linear system needs no guess, and the guess for a fast stiff motion would be so large that
            // the position is lost in its rounding.
            work.increments.fill(T::zero());
        } else {
            let drift = part_mut(work.scratch, coordinates);
            // Without equations to solve the guess is the result.
            if self.drifts() {
                mechanics.velocity(momentum, drift);
            } else {
                mechanics.drift(momentum, drift);
            }
            for (increment, &point) in vectors_mut(work.increments, coordinates).zip(self.control_points) {
                for (place, &velocity) in increment.iter_mut().zip(&*drift) {
                    *place = velocity * step.size * point;
                }
            }
        }
        let moment_correction = part(work.moment_correction, moments);
        let mut equations = StepEquations::<T, X, Y, G, D> {
            storage: PhantomData,
            lagrangian: self,
            mechanics,
            damping,
            step,
            position,
            momentum,
            stages: &mut *work.stages,
            forces: &mut *work.forces,
            known: &*work.known,
            moment_correction,
            scratch: &mut *work.scratch,
            point: &mut *work.point,
            stiffness: &mut *work.stiffness,
        };
        let drifts = self.drifts();
        let (iterations, missed) = if drifts {
            (0, false)
        } else if equations.mechanics.is_linear() {
            let unknowns = (&mut *work.increments, &mut *work.residual);
            equations.solve_linear(unknowns, &mut *work.matrix, &mut *work.kept)?;
            (1, false)
        } else {
            let unknowns = (&mut *work.increments, &mut *work.residual);
            equations.solve_nonlinear(unknowns, &mut *work.matrix)?
        };
        if !equations.mechanics.is_linear() || drifts {
            equations.forces::<E>(work.increments, None);
        }
        if missed {
            equations.balance(work.increments, work.residual);
            self.sum_missed_impulse(coordinates, work.residual);
        } else {
            part_mut(work.residual, coordinates).fill(T::zero());
        }
        let impulse = part_mut(work.residual, coordinates);
        for (&weight, force) in self.weights.iter().zip(vectors(equations.forces, coordinates)) {
            add_multiple(impulse, step.size * weight, force);
        }
        for moment in vectors(moment_correction, coordinates) {
            add_multiple(impulse, -step.size, moment);
        }
        Ok(iterations)
    }
}

/// The equations of one step at a guess of the nodes.
struct StepEquations<'a, T: Real, X: Space<T>, Y, G, D> {
    storage: PhantomData<Y>,
    lagrangian: &'a DiscreteLagrangian<'a, T>,
    mechanics: &'a mut G,
    /// Damping, if it acts at the quadrature nodes.
    damping: Option<&'a D>,
    step: &'a Step<'a, T>,
    position: &'a [T],
    momentum: &'a [T],
    stages: &'a mut [T],
    forces: &'a mut [T],
    known: &'a [T],
    /// Exact moments of the force minus those of the quadrature; empty without a correction.
    moment_correction: &'a [T],
    scratch: &'a mut [T],
    point: &'a mut X::Vector,
    stiffness: &'a mut X::Block,
}

impl<T, X, Y, G, D> StepEquations<'_, T, X, Y, G, D>
where
    T: Real,
    X: Space<T>,
    Y: Space<T, Vector = X::Vector, Block = X::Block>,
    G: Mechanics<T, Y>,
    D: Damping<T, Y>,
{
    /// Solves the equations of a linear system by factors kept from step to step, and leaves the forces at
    /// the solution.
    #[inline(always)]
    fn solve_linear<E: Equations<T, X::Block>>(
        &mut self,
        (increments, residual): (&mut [T], &mut [T]),
        matrix: &mut E,
        kept: &mut CachedFactor<E::Factor, T>,
    ) -> Result<(), StepError> {
        let length = self.step.size;
        if kept.length == length {
            self.residual::<E>(increments, residual, None);
        } else {
            self.residual(increments, residual, Some((&mut *matrix, None)));
            // With several nodes a symmetric perturbation of the matrix is not one of the mass alone: no
            // inertia is given.
            let inertia = (T::zero(), self.mechanics.mass());
            matrix.keep(&mut kept.solver, inertia).map_err(|_| StepError::SingularJacobian)?;
            let stays = self.damping.is_none_or(|damping| damping.leading_is_constant());
            kept.length = if stays { length } else { T::zero() };
        }
        self.correct(increments, residual, matrix, &kept.solver);
        self.forces::<E>(increments, None);
        // The rounding error of the solver is the same at every step, so that it would accumulate to growth
        // or decay. A second correction, with the forces that are needed anyway, removes it.
        self.balance(increments, residual);
        if matrix.is_unsettled(&kept.solver, increments, self.position, residual) {
            self.correct(increments, residual, matrix, &kept.solver);
        }
        // A value of the first correction that is not finite leaves a residual that is not finite.
        if !all_finite(residual) {
            return Err(StepError::NotFinite);
        }
        // If the damping acts at the nodes, the nodes are its sample.
        if self.damping.is_some() {
            self.lagrangian.place_stages(increments, self.stages, self.position.len());
        }
        Ok(())
    }

    /// Solves the equations by Newton's method: how many iterations it took, and whether it leaves a
    /// residual.
    #[inline(always)]
    fn solve_nonlinear<E: Equations<T, X::Block>>(
        &mut self,
        (increments, residual): (&mut [T], &mut [T]),
        matrix: &mut E,
    ) -> Result<(u32, bool), StepError> {
        let at = (size(self.position), self.mechanics.depends_on_velocity());
        let balance = |increments: &[T], residual: &mut [T], matrix: Option<Linearised<'_, E, T>>| {
            self.residual(increments, residual, matrix);
        };
        let converged = newton(increments, residual, at, matrix, balance)?;
        Ok((converged.iterations, converged.leaves_residual))
    }

    /// Places the stages and writes G_i to `forces`; adds −h Σ_i b_i ℓ_ν(c_i) ∂G_i/∂e^μ to the matrix if
    /// there is one, stiffened if it is to be so.
    #[inline(always)]
    fn forces<E: Equations<T, X::Block>>(&mut self, increments: &[T], matrix: Option<Linearised<'_, E, T>>) {
        if X::KNOWN_SIZE {
            self.write_forces(increments, matrix)
        } else {
            called(|| self.write_forces(increments, matrix))
        }
    }

    #[inline(always)]
    fn write_forces<E: Equations<T, X::Block>>(
        &mut self,
        increments: &[T],
        matrix: Option<Linearised<'_, E, T>>,
    ) {
        let (mut matrix, stiffened) = matrix.unzip();
        let stiffened = stiffened.flatten();
        let (lagrangian, h) = (self.lagrangian, self.step.size);
        let (coordinates, degree) = (self.position.len(), lagrangian.degree());
        lagrangian.place_stages(increments, self.stages, coordinates);
        let of_node = lagrangian.weights.iter().zip(lagrangian.nodes);
        let shapes = vectors(lagrangian.shapes, degree);
        let tests = vectors(lagrangian.tests, degree);
        let stages = vectors(self.stages, coordinates);
        let forces = vectors_mut(self.forces, coordinates);
        let of_nodes = of_node.zip(shapes.zip(tests)).zip(stages).zip(forces).enumerate();
        for (index, ((((&weight, &node), (shapes, tests)), stage), force)) in of_nodes {
            let point = X::slice_mut(self.point);
            for ((place, &q), &e) in point.iter_mut().zip(self.position).zip(stage) {
                *place = q + e;
            }
            let instant = Instant::in_step(self.step.time, node, h);
            if self.mechanics.depends_on_velocity() {
                let velocity = part_mut(self.scratch, coordinates);
                lagrangian.velocity_at(index, increments, h, velocity);
                if let Some(matrix) = matrix.as_deref_mut() {
                    let written = (&mut *force, &mut *self.stiffness);
                    self.mechanics.linearise_in_motion(instant, self.point, velocity, written.0, written.1);
                    for (row, &test) in tests.iter().enumerate() {
                        let factor = h * weight * test;
                        for (column, &shape) in shapes.iter().enumerate() {
                            matrix.add(row, column, -(factor * shape), self.stiffness);
                        }
                    }
                    if let Some(slopes) = stiffened {
                        Stiffened::move_aside(velocity, slopes.aside / h);
                        let written = (&mut *force, &mut *self.stiffness);
                        self.mechanics
                            .linearise_in_motion(instant, self.point, velocity, written.0, written.1);
                    }
                    self.mechanics.resistance(instant, self.point, velocity, self.stiffness);
                    let stiffening = stiffened.map_or(T::one(), |slopes| slopes.factor);
                    for (row, &test) in tests.iter().enumerate() {
                        for column in 0..degree {
                            let factor = weight * test * lagrangian.slope(index, column);
                            matrix.add(row, column, -(factor * stiffening), self.stiffness);
                        }
                    }
                    if stiffened.is_some() {
                        lagrangian.velocity_at(index, increments, h, velocity);
                        self.mechanics.restoring_force_in_motion(instant, self.point, velocity, force);
                    }
                } else {
                    self.mechanics.restoring_force_in_motion(instant, self.point, velocity, force);
                }
            } else if let Some(matrix) = matrix.as_deref_mut() {
                self.mechanics.linearise(instant, self.point, force, self.stiffness);
                for (row, &test) in tests.iter().enumerate() {
                    let factor = h * weight * test;
                    for (column, &shape) in shapes.iter().enumerate() {
                        matrix.add(row, column, -(factor * shape), self.stiffness);
                    }
                }
            } else {
                self.mechanics.restoring_force(instant, self.point, force);
            }
            for (force, &input) in force.iter_mut().zip(self.step.input) {
                *force -= input;
            }
        }
        let Some(damping) = self.damping else { return };
        add_multiple(self.forces, T::one(), self.known);
        damping.add_leading(self.stages, self.forces, self.scratch);
        let Some(matrix) = matrix else { return };
        damping.visit_leading(lagrangian.nodes.len(), |i, j, leading, rho| {
            let weight = at(lagrangian.weights, i);
            let tests = vector_at(lagrangian.tests, degree, i);
            let shapes = vector_at(lagrangian.shapes, degree, j);
            for (row, &test) in tests.iter().enumerate() {
                for (column, &shape) in shapes.iter().enumerate() {
                    matrix.add(row, column, -(h * weight * test * shape * leading), rho);
                }
            }
        });
    }

    /// Writes the residuals of the S equations, and their derivatives to the matrix if there is one.
    #[inline(always)]
    fn residual<E: Equations<T, X::Block>>(
        &mut self,
        increments: &[T],
        residual: &mut [T],
        mut matrix: Option<Linearised<'_, E, T>>,
    ) {
        let (lagrangian, h) = (self.lagrangian, self.step.size);
        let degree = lagrangian.degree();
        if let Some((matrix, _)) = &mut matrix {
            matrix.clear();
            for (row, numbers) in vectors(lagrangian.kinetic, degree).enumerate() {
                for (column, &kinetic) in numbers.iter().enumerate() {
                    matrix.add(row, column, kinetic / h, self.mechanics.mass());
                }
            }
        }
        self.forces(increments, matrix);
        self.balance(increments, residual);
    }

    /// Solves for the residual and subtracts the solution from the increments.
    #[inline(always)]
    fn correct<E: Equations<T, X::Block>>(
        &self,
        increments: &mut [T],
        residual: &mut [T],
        matrix: &mut E,
        solver: &E::Factor,
    ) {
        matrix.solve_kept(solver, residual);
        for (unknown, &correction) in increments.iter_mut().zip(&*residual) {
            *unknown -= correction;
        }
    }

    /// Writes the residuals of the S equations with the forces computed last.
    #[inline(always)]
    fn balance(&mut self, increments: &[T], residual: &mut [T]) {
        let (lagrangian, h) = (self.lagrangian, self.step.size);
        let (coordinates, degree) = (self.position.len(), lagrangian.degree());
        for (row, residual) in vectors_mut(residual, coordinates).enumerate() {
            residual.fill(T::zero());
            if row == 0 {
                add_multiple(residual, T::one(), self.momentum);
            }
        }
        let product = part_mut(self.scratch, coordinates);
        for (column, increment) in vectors(increments, coordinates).enumerate() {
            product.fill(T::zero());
            self.mechanics.mass().multiply_add(T::one(), increment, product);
            let kinetic = lagrangian.kinetic.iter().skip(column).step_by(degree.max(1));
            for (residual, &kinetic) in vectors_mut(residual, coordinates).zip(kinetic) {
                add_multiple(residual, kinetic / h, product);
            }
        }
        let tests = vectors(lagrangian.tests, degree);
        let forces = vectors(self.forces, coordinates);
        for ((&weight, tests), force) in lagrangian.weights.iter().zip(tests).zip(forces) {
            for (residual, &test) in vectors_mut(residual, coordinates).zip(tests) {
                add_multiple(residual, -(h * weight * test), force);
            }
        }
        let moment_correction = vectors(self.moment_correction, coordinates);
        for (residual, moment) in vectors_mut(residual, coordinates).zip(moment_correction) {
            add_multiple(residual, h, moment);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coefficients::Coefficients;
    use crate::coefficients::Fixed;
    use crate::damped_motion::{Mismatch, Sample};
    use crate::galerkin::Galerkin;
    use crate::memory::MemoryError;
    use crate::newton::{Factors, StepMatrix};
    use crate::quadrature::Quadrature;
    use crate::runge_kutta::RungeKutta;
    use crate::scheme::Rounding;
    use crate::system::{Force, Mass, Potential, System};
    use crate::workspace::CachedFactor;
    use nalgebra::{SMatrix, SVector, matrix, vector};

    struct Coupled;

    impl Potential<f64, 2> for Coupled {
        fn value(&self, q: &SVector<f64, 2>) -> f64 {
            1.5 * q[0] * q[0] + q[0].powi(4) / 4.0 + (q[0] - 2.0 * q[1]).cos()
        }

        fn gradient(&self, q: &SVector<f64, 2>) -> SVector<f64, 2> {
            let sine = (q[0] - 2.0 * q[1]).sin();
            vector![3.0 * q[0] + q[0].powi(3) - sine, 2.0 * sine]
        }

        fn hessian(&self, q: &SVector<f64, 2>) -> SMatrix<f64, 2, 2> {
            let cosine = (q[0] - 2.0 * q[1]).cos();
            matrix![3.0 + 3.0 * q[0] * q[0] - cosine, 2.0 * cosine; 2.0 * cosine, -4.0 * cosine]
        }
    }

    struct Push {
        /// Coefficient of the velocity-dependent part of the force; 0 without one.
        drag: f64,
    }

    impl Force<f64, 2> for Push {
        fn depends_on_velocity(&self) -> bool {
            self.drag != 0.0
        }

        fn value_in_motion(
            &self,
            instant: Instant<f64>,
            q: &SVector<f64, 2>,
            v: &SVector<f64, 2>,
        ) -> SVector<f64, 2> {
            self.value(instant, q) - vector![v[0] * v[0] * v[0] + v[1], q[0] * v[1] - v[0]] * self.drag
        }

        fn jacobian_in_motion(
            &self,
            instant: Instant<f64>,
            q: &SVector<f64, 2>,
            v: &SVector<f64, 2>,
        ) -> SMatrix<f64, 2, 2> {
            self.jacobian(instant, q) - matrix![0.0, 0.0; v[1], 0.0] * self.drag
        }

        fn velocity_jacobian(
            &self,
            _: Instant<f64>,
            q: &SVector<f64, 2>,
            v: &SVector<f64, 2>,
        ) -> SMatrix<f64, 2, 2> {
            matrix![3.0 * v[0] * v[0], 1.0; -1.0, q[0]] * -self.drag
        }

        fn value(&self, instant: Instant<f64>, q: &SVector<f64, 2>) -> SVector<f64, 2> {
            vector![(2.0 * instant.time).cos() - q[1] / 4.0, instant.time * q[0] / 8.0]
        }

        fn jacobian(&self, instant: Instant<f64>, _: &SVector<f64, 2>) -> SMatrix<f64, 2, 2> {
            matrix![0.0, -0.25; instant.time / 8.0, 0.0]
        }
    }

    fn system(drag: f64) -> System<f64, 2, Coupled, Push> {
        let mass = Mass::new(Coefficients::Dense(matrix![2.0, 0.5; 0.5, 1.0])).unwrap();
        System { mass, potential: Coupled, force: Push { drag } }
    }

    const STEP: Step<'static, f64> = Step { time: 0.7, end: 0.95, size: 0.25, input: &[0.3, -0.2] };
    const POSITION: SVector<f64, 2> = SVector::<f64, 2>::new(0.4, -0.3);
    const MOMENTUM: SVector<f64, 2> = SVector::<f64, 2>::new(1.2, 0.5);

    /// A damping that exerts known_i + Σ_j leading_ij e_j, without memory.
    struct Affine<const Q: usize> {
        known: [SVector<f64, 2>; Q],
        leading: [[SMatrix<f64, 2, 2>; Q]; Q],
    }

    impl<const Q: usize> Affine<Q> {
        fn at(&self, node: usize, increments: &[SVector<f64, 2>; Q]) -> SVector<f64, 2> {
            let row = self.leading[node].iter().zip(increments);
            row.fold(self.known[node], |sum, (weight, increment)| sum + weight * increment)
        }
    }

    impl<const Q: usize> crate::saving::Stateful for Affine<Q> {}

    impl<const Q: usize> Damping<f64, Fixed<2>> for Affine<Q> {
        fn check(&self, _: usize, _: usize, _: f64) -> Result<(), Mismatch> {
            Ok(())
        }

        fn begin(&mut self, _: &[f64], _: &[f64]) {}

        fn begin_at(&mut self, _: f64) {}

        fn add_known(
            &mut self,
            _: &Sample<'_, f64>,
            known: &mut [f64],
            _: &mut [f64],
        ) -> Result<(), MemoryError> {
            add_multiple(known, 1.0, self.known.map(|vector| [vector[0], vector[1]]).as_flattened());
            Ok(())
        }

        fn add_leading(&self, increments: &[f64], force: &mut [f64], _: &mut [f64]) {
            for (force, row) in force.chunks_exact_mut(2).zip(&self.leading) {
                for (block, increment) in row.iter().zip(increments.chunks_exact(2)) {
                    let product = block * vector![increment[0], increment[1]];
                    add_multiple(force, 1.0, product.as_slice());
                }
            }
        }

        fn visit_leading(
            &self,
            nodes: usize,
            mut visit: impl FnMut(usize, usize, f64, &Coefficients<f64, 2>),
        ) {
            for i in 0..nodes {
                for j in 0..nodes {
                    visit(i, j, 1.0, &Coefficients::Dense(self.leading[i][j]));
                }
            }
        }

        fn leading_is_constant(&self) -> bool {
            true
        }

        fn push(&mut self, _: &Sample<'_, f64>, _: &[f64], _: &mut [f64]) -> Result<(), MemoryError> {
            Ok(())
        }
    }

    /// The increments e^1 … e^S and the new momentum of one step damped at its nodes.
    fn solved<const S: usize, const Q: usize>(
        galerkin: &Galerkin<f64, S, Q>,
        damping: &Affine<Q>,
        drag: f64,
    ) -> ([SVector<f64, 2>; S], SVector<f64, 2>) {
        let mut system = system(drag);
        let (mut increments, mut residual) = ([[0.0; 2]; S], [[0.0; 2]; S]);
        let (mut stages, mut forces, mut known) = ([[0.0; 2]; Q], [[0.0; 2]; Q], [[0.0; 2]; Q]);
        let mut work = Workspace::<f64, Fixed<2>, StepMatrix<f64, 2, S>> {
            increments: increments.as_flattened_mut(),
            residual: residual.as_flattened_mut(),
            stages: stages.as_flattened_mut(),
            forces: forces.as_flattened_mut(),
            known: known.as_flattened_mut(),
            scratch: &mut [0.0; 32],
            behind: &mut [0.0; 32],
            restoring: &mut [],
            moment_correction: &mut [0.0; 32],
            point: &mut SVector::zeros(),
            stiffness: &mut system.stiffness(),
            matrix: &mut StepMatrix::zero(),
            kept: &mut CachedFactor::nothing(Factors::zero()),
        };
        let mut damping = Affine { known: damping.known, leading: damping.leading };
        let rounding = Rounding { position: SVector::zeros(), momentum: SVector::zeros() };
        let mut state = State { step: 0, position: POSITION, momentum: MOMENTUM, rounding };
        galerkin
            .view()
            .step_damped_at_nodes(&mut work, &mut system, &mut damping, &STEP, &mut state)
            .unwrap();
        (increments.map(SVector::from), state.momentum)
    }

    /// Value and derivative of the polynomial through (points, values), by Neville's scheme.
    fn interpolate(
        points: &[f64],
        values: &[SVector<f64, 2>],
        tau: f64,
    ) -> (SVector<f64, 2>, SVector<f64, 2>) {
        let mut table: std::vec::Vec<_> = values.iter().map(|&value| (value, SVector::zeros())).collect();
        for level in 1..points.len() {
            for i in 0..points.len() - level {
                let (left, right) = (points[i], points[i + level]);
                let ((a, da), (b, db)) = (table[i], table[i + 1]);
                let width = right - left;
                let value = (a * (right - tau) + b * (tau - left)) / width;
                let derivative = (b - a + da * (right - tau) + db * (tau - left)) / width;
                table[i] = (value, derivative);
            }
        }
        table[0]
    }

    /// The solved step must satisfy p_k = −D₁L_d − f₀, 0 = D_νL_d + f_ν, p_{k+1} = D_{S+1}L_d + f_S, with L_d
    /// and the virtual work of the forces computed from their definitions and D by differences.
    fn assert_stationary<const S: usize, const Q: usize>(
        quadrature: &Quadrature<Q>,
        control_points: &[f64],
        damping: Option<&Affine<Q>>,
    ) {
        for drag in [0.0, 0.4] {
            assert_stationary_with::<S, Q>(quadrature, control_points, damping, drag);
        }
    }

    fn assert_stationary_with<const S: usize, const Q: usize>(
        quadrature: &Quadrature<Q>,
        control_points: &[f64],
        damping: Option<&Affine<Q>>,
        drag: f64,
    ) {
        let galerkin = Galerkin::<f64, S, Q>::new(quadrature).unwrap();
        let (system, h) = (system(drag), STEP.size);
        let none = Affine { known: [SVector::zeros(); Q], leading: [[SMatrix::zeros(); Q]; Q] };
        let (increments, new_momentum) = solved(&galerkin, damping.unwrap_or(&none), drag);
        let mut nodes = std::vec![POSITION];
        nodes.extend(increments.iter().map(|increment| POSITION + increment));
        let rules = || quadrature.nodes().iter().zip(quadrature.weights());
        let action = |nodes: &[SVector<f64, 2>]| -> f64 {
            let lagrangian = |&c: &f64| {
                let (q, slope) = interpolate(control_points, nodes, c);
                let v = slope / h;
                0.5 * v.dot(&system.mass.momentum(&v)) - system.potential.value(&q)
            };
            rules().map(|(c, b)| h * b * lagrangian(c)).sum()
        };
        let stages: std::vec::Vec<_> =
            rules().map(|(&c, _)| interpolate(control_points, &nodes, c).0 - POSITION).collect();
        let stages: [SVector<f64, 2>; Q] = stages.try_into().unwrap();
        for nu in 0..=S {
            let mut unit = std::vec![SVector::zeros(); S + 1];
            unit[nu] = vector![1.0, 1.0];
            let mut work = SVector::<f64, 2>::zeros();
            for (i, (&c, &b)) in rules().enumerate() {
                let shape = interpolate(control_points, &unit, c).0[0];
                let instant = Instant::in_step(STEP.time, c, h);
                let input = vector![STEP.input[0], STEP.input[1]];
                let v = interpolate(control_points, &nodes, c).1 / h;
                let mut force = system.force.value_in_motion(instant, &(POSITION + stages[i]), &v) + input;
                if let Some(damping) = damping {
                    force -= damping.at(i, &stages);
                }
                work += force * (h * b * shape);
            }
            for coordinate in 0..2 {
                let moved = |by: f64| {
                    let mut nodes = nodes.clone();
                    nodes[nu][coordinate] += by;
                    action(&nodes)
                };
                let epsilon = 1e-3;
                // Fourth-order difference.
                let derivative = (8.0 * (moved(epsilon) - moved(-epsilon))
                    - (moved(2.0 * epsilon) - moved(-2.0 * epsilon)))
                    / (12.0 * epsilon);
                let momentum = match nu {
                    0 => -MOMENTUM[coordinate],
                    nu if nu == S => new_momentum[coordinate],
                    _ => 0.0,
                };
                let error = derivative + work[coordinate] - momentum;
                assert!(error.abs() < 1e-10, "degree {S}, {Q} points, node {nu}: {error:e}");
            }
        }
    }

    #[test]
    fn a_step_makes_the_discrete_action_stationary() {
        assert_stationary::<1, 1>(&Quadrature::gauss().unwrap(), &[0.0, 1.0], None);
        assert_stationary::<1, 2>(&Quadrature::lobatto().unwrap(), &[0.0, 1.0], None);
        assert_stationary::<2, 2>(&Quadrature::gauss().unwrap(), &[0.0, 0.5, 1.0], None);
        assert_stationary::<2, 3>(&Quadrature::lobatto().unwrap(), &[0.0, 0.5, 1.0], None);
        let root = 0.2f64.sqrt();
        let third = [0.0, 0.5 - 0.5 * root, 0.5 + 0.5 * root, 1.0];
        assert_stationary::<3, 3>(&Quadrature::gauss().unwrap(), &third, None);
        assert_stationary::<3, 4>(&Quadrature::lobatto().unwrap(), &third, None);
        assert_stationary::<3, 6>(&Quadrature::gauss().unwrap(), &third, None);
    }

    #[test]
    fn forces_at_the_stages_do_their_virtual_work() {
        let mut damping = Affine { known: [SVector::zeros(); 3], leading: [[SMatrix::zeros(); 3]; 3] };
        for i in 0..3 {
            damping.known[i] = vector![0.3, -0.4 * i as f64];
            for j in 0..3 {
                damping.leading[i][j] = matrix![1.0, 0.2; 0.2, 0.5] * (1.0 + i as f64 - 0.7 * j as f64);
            }
        }
        let radau = RungeKutta::<3>::radau_iia().unwrap();
        assert_stationary::<2, 3>(radau.quadrature(), &[0.0, 0.5, 1.0], Some(&damping));
        let lobatto = RungeKutta::<3>::lobatto_iiic().unwrap();
        assert_stationary::<2, 3>(lobatto.quadrature(), &[0.0, 0.5, 1.0], Some(&damping));
    }
}
