//! Collocation: position and velocity by the Runge–Kutta method of the memory itself.

use nalgebra::SVector;

use crate::coefficients::Fixed;
use crate::damping::Damping;
use crate::galerkin::in_place;
use crate::linear::add_multiple;
use crate::linear::all_finite;
use crate::newton::{ASIDE, Equations, Linearised, StepMatrix, Stiffened, damped_newton, newton, size};
use crate::node_galerkin::NodeStorage;
use crate::real::Real;
use crate::runge_kutta::RungeKutta;
use crate::scheme::{Outcome, Sampling, Scheme, State, Step, StepError, conclude};
use crate::space::{Block, Space, called, last_vector, part, part_mut, vector_at, vectors, vectors_mut};
use crate::system::{Instant, Mechanics, NodalRule};
use crate::workspace::Workspace;

/// Corrections of a linear system's step. The second takes back what the first lost to rounding where the
/// step is long beside the periods of the system.
const LINEAR_CORRECTIONS: u32 = 2;

/// Collocation by a Runge–Kutta method, as a view of its coefficients.
///
/// ```text
/// M a_i + ∇U(X_i) − F(t_k + c_i h, X_i, V_i) − u + Σ_m ρ_m (D^{β_m} X)_{k,i} = 0 ,      i = 1…R
/// X_i − q_k = h c_i v_k + h² Σ_j (A²)_ij a_j ,      V_i = v_k + h Σ_j A_ij a_j ,
/// v_{k+1} = v_k + h Σ_j b_j a_j ,      q_{k+1} = X_R
/// ```
///
/// with v = M⁻¹p. Radau IIA makes it L-stable: neither stiff springs nor strong damping limit the step. It is
/// no variational integrator: an undamped oscillator loses energy, by R(iωh) a step with the stability
/// function R, |R(iy)|² = 1 − O(y^{2R}). Source: \[HW\]; the fractional force as in \[LO93\] and \[LFS16\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CollocationTables<'a, T> {
    /// A, R·R numbers row by row.
    pub matrix: &'a [T],
    /// A², likewise.
    pub square: &'a [T],
    /// b, the last row of A.
    pub weights: &'a [T],
    /// c
    pub nodes: &'a [T],
}

/// Collocation with a stiffly accurate Runge–Kutta method of R stages, Radau IIA above all, whose nodes the
/// memory stores; see [`CollocationTables`] for its equations.
///
/// The memory has matrix weights of the same method, on equal steps
/// ([`Kernel::runge_kutta`](crate::Kernel::runge_kutta)) or on steps of any length
/// ([`VariableStepMemory`](crate::VariableStepMemory)).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Collocation<T, const R: usize> {
    matrix: [[T; R]; R],
    square: [[T; R]; R],
    weights: [T; R],
    nodes: [T; R],
}

impl<T: Real, const R: usize> Collocation<T, R> {
    /// Collocation by `method`.
    pub fn new(method: &RungeKutta<R>) -> Self {
        let (square, quadrature) = (method.square(), method.quadrature());
        Self {
            matrix: method.matrix().map(|row| row.map(T::of)),
            square: square.map(|row| row.map(T::of)),
            weights: quadrature.weights().map(T::of),
            nodes: quadrature.nodes().map(T::of),
        }
    }

    /// View of the coefficients.
    pub fn tables(&self) -> CollocationTables<'_, T> {
        CollocationTables {
            matrix: self.matrix.as_flattened(),
            square: self.square.as_flattened(),
            weights: &self.weights,
            nodes: &self.nodes,
        }
    }
}

impl<T: Real, const N: usize, const R: usize> Scheme<T, Fixed<N>> for Collocation<T, R> {
    type Storage = NodeStorage<T, N, R, R>;

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
        Sampling::Nodes(&self.nodes)
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
        let (known, mut room) = ([[T::zero(); N]; R], [[[T::zero(); N]; R]; 2]);
        let NodeStorage { kept, behind } = storage;
        in_place!(R, R; kept, behind.as_flattened_mut(), mechanics, known, room.as_flattened_mut(), |workspace| {
            self.tables().step(workspace, mechanics, damping, step, state)
        })
    }
}

impl<T: Real> CollocationTables<'_, T> {
    /// One step. The accelerations a_i are left in `work.increments`, X_i − q_k in `work.stages`.
    /// `work.moment_correction` has room for a vector at each node.
    ///
    /// # Errors
    /// [`StepError`]; position, momentum and damping are as before.
    #[inline(always)]
    pub fn step<X, E, G, D>(
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
        G: Mechanics<T, X>,
        D: Damping<T, X>,
    {
        work.begin(damping, step, self.nodes, state)?;
        let (position, momentum) = (&state.position, &state.momentum);
        let coordinates = X::slice(position).len();
        // The velocity needs a vector of its own: the scratch vector is in use while the equations are
        // solved.
        let mut velocity = position.clone();
        mechanics.velocity(X::slice(momentum), X::slice_mut(&mut velocity));
        work.increments.fill(T::zero());
        let linear = mechanics.is_linear();
        let rough = mechanics.is_rough() && {
            let (start, length, nodes) = (step.time, step.size, self.nodes);
            let rule = NodalRule {
                start,
                length,
                weights: self.weights,
                nodes,
                points: nodes,
                shapes: &[],
                tests: &[],
            };
            mechanics.moment_correction(&rule, work.moment_correction)
        };
        // Room for a correction, where there are no moments.
        let (moment_correction, spare) = match (rough, &mut *work.moment_correction) {
            (true, moments) => (part(moments, work.forces.len()), &mut [][..]),
            (false, room) => (&[][..], part_mut(room, work.increments.len())),
        };
        let mut equations = CollocationEquations {
            moment_correction,
            tables: self,
            mechanics,
            damping: &*damping,
            step,
            position: X::slice(position),
            velocity: X::slice(&velocity),
            stages: &mut *work.stages,
            forces: &mut *work.forces,
            known: &*work.known,
            scratch: &mut *work.scratch,
            point: &mut *work.point,
            stiffness: &mut *work.stiffness,
        };
        let iterations = if linear {
            let stays = equations.damping.leading_is_constant();
            if work.kept.length != step.size {
                let matrix = Some((&mut *work.matrix, None));
                equations.residual(work.increments, work.residual, matrix);
                let inertia = (T::zero(), equations.mechanics.mass());
                work.matrix.keep(&mut work.kept.solver, inertia).map_err(|_| StepError::SingularJacobian)?;
                work.kept.length = if stays { step.size } else { T::zero() };
            }
            for _ in 0..LINEAR_CORRECTIONS {
                equations.residual::<E>(work.increments, work.residual, None);
                work.matrix.solve_kept(&work.kept.solver, work.residual);
                if !all_finite(work.residual) {
                    return Err(StepError::NotFinite);
                }
                add_multiple(work.increments, -T::one(), work.residual);
            }
            LINEAR_CORRECTIONS
        } else {
            equations.solve(work.increments, [work.residual, spare], work.matrix)?
        };
        self.place_stages(work.increments, X::slice(&velocity), step.size, work.stages);
        let rise = last_vector(work.stages, coordinates);
        // p_{k+1} = p_k + h M Σ_j b_j a_j
        let mean = X::slice_mut(&mut velocity);
        mean.fill(T::zero());
        for (&weight, acceleration) in self.weights.iter().zip(vectors(work.increments, coordinates)) {
            add_multiple(mean, weight, acceleration);
        }
        let kick = part_mut(work.residual, coordinates);
        kick.fill(T::zero());
        mechanics.mass().multiply_add(step.size, mean, kick);
        let found = Outcome { increments: work.stages, rise, kick };
        conclude::<T, X, X, D>(damping, step, self.nodes, &found, state, work.behind, work.scratch)?;
        Ok(iterations)
    }

    /// X_i − q_k
    #[inline(always)]
    fn place_stages(&self, accelerations: &[T], velocity: &[T], h: T, stages: &mut [T]) {
        let coordinates = velocity.len();
        let rows = vectors(self.square, self.nodes.len());
        for ((stage, &node), row) in vectors_mut(stages, coordinates).zip(self.nodes).zip(rows) {
            for (place, &v) in stage.iter_mut().zip(velocity) {
                *place = h * node * v;
            }
            for (&factor, acceleration) in row.iter().zip(vectors(accelerations, coordinates)) {
                add_multiple(stage, h * h * factor, acceleration);
            }
        }
    }
}

/// The equations of one step at a guess of the accelerations.
struct CollocationEquations<'a, T: Real, X: Space<T>, G, D> {
    /// Moment corrections of the forces at the nodes.
    moment_correction: &'a [T],
    tables: &'a CollocationTables<'a, T>,
    mechanics: &'a mut G,
    damping: &'a D,
    step: &'a Step<'a, T>,
    position: &'a [T],
    velocity: &'a [T],
    stages: &'a mut [T],
    forces: &'a mut [T],
    known: &'a [T],
    scratch: &'a mut [T],
    point: &'a mut X::Vector,
    stiffness: &'a mut X::Block,
}

impl<T: Real, X: Space<T>, G: Mechanics<T, X>, D: Damping<T, X>> CollocationEquations<'_, T, X, G, D> {
    /// True if a coordinate has a mass; `numbers` is overwritten.
    #[cold]
    fn has_mass(&mut self, numbers: &mut [T]) -> bool {
        let (ones, moved) =
            (part_mut(numbers, self.position.len()), part_mut(self.scratch, self.position.len()));
        ones.fill(T::one());
        moved.fill(T::zero());
        self.mechanics.mass().multiply_add(T::one(), ones, moved);
        ones.is_empty() || moved.iter().any(|&moved| moved != T::zero())
    }

    /// Solves equations that are not linear; number of iterations.
    #[inline(always)]
    fn solve<E: Equations<T, X::Block>>(
        &mut self,
        accelerations: &mut [T],
        [residual, spare]: [&mut [T]; 2],
        matrix: &mut E,
    ) -> Result<u32, StepError> {
        let moves = self.mechanics.depends_on_velocity();
        // A residual below the rounding of the positions, divided by h², does not change an acceleration.
        let offset = size(self.position) / (self.step.size * self.step.size);
        let balance = |accelerations: &[T], residual: &mut [T], matrix: Option<Linearised<'_, E, T>>| {
            self.residual(accelerations, residual, matrix);
        };
        match newton(accelerations, residual, (offset, moves), matrix, balance) {
            Ok(converged) => Ok(converged.iterations),
            // Where a mass grows beyond all bounds its step has solutions behind the end of the motion.
            Err(failure) if self.has_mass(spare) => Err(failure),
            Err(failure) => {
                let balance =
                    |accelerations: &[T], residual: &mut [T], matrix: Option<Linearised<'_, E, T>>| {
                        self.residual(accelerations, residual, matrix);
                    };
                damped_newton(accelerations, [residual, spare], (offset, failure), matrix, balance)
                    .map(|converged| converged.iterations)
            }
        }
    }

    /// Writes the residuals of the R equations, and their derivatives to the matrix if there is one.
    #[inline(always)]
    fn residual<E: Equations<T, X::Block>>(
        &mut self,
        accelerations: &[T],
        residual: &mut [T],
        matrix: Option<Linearised<'_, E, T>>,
    ) {
        if X::KNOWN_SIZE {
            self.write_residual(accelerations, residual, matrix);
        } else {
            called(|| self.write_residual(accelerations, residual, matrix));
        }
    }

    #[inline(always)]
    fn write_residual<E: Equations<T, X::Block>>(
        &mut self,
        accelerations: &[T],
        residual: &mut [T],
        matrix: Option<Linearised<'_, E, T>>,
    ) {
        let (mut matrix, stiffened) = matrix.unzip();
        let stiffened = stiffened.flatten();
        let (tables, h) = (self.tables, self.step.size);
        let (coordinates, stages) = (self.position.len(), tables.nodes.len());
        tables.place_stages(accelerations, self.velocity, h, self.stages);
        if let Some(matrix) = matrix.as_deref_mut() {
            matrix.clear();
            for i in 0..stages {
                matrix.add(i, i, T::one(), self.mechanics.mass());
            }
        }
        let rows = vectors(tables.square, stages);
        let nodes = tables.nodes.iter().zip(rows).enumerate();
        let vectors_of_nodes = vectors(self.stages, coordinates).zip(vectors_mut(self.forces, coordinates));
        for ((i, (&node, row)), (stage, force)) in nodes.zip(vectors_of_nodes) {
            let point = X::slice_mut(self.point);
            for ((place, &q), &e) in point.iter_mut().zip(self.position).zip(stage) {
                *place = q + e;
            }
            let instant = Instant::in_step(self.step.time, node, h);
            if self.mechanics.depends_on_velocity() {
                let velocity = part_mut(self.scratch, coordinates);
                velocity.iter_mut().zip(self.velocity).for_each(|(place, &v)| *place = v);
                let integrals = vector_at(tables.matrix, stages, i);
                for (&factor, acceleration) in integrals.iter().zip(vectors(accelerations, coordinates)) {
                    add_multiple(velocity, h * factor, acceleration);
                }
                if let Some(matrix) = matrix.as_deref_mut() {
                    let written = (&mut *force, &mut *self.stiffness);
                    self.mechanics.linearise_in_motion(instant, self.point, velocity, written.0, written.1);
                    for (j, &factor) in row.iter().enumerate() {
                        matrix.add(i, j, h * h * factor, self.stiffness);
                    }
                    let aside = stiffened.map(|slopes| {
                        let by = slopes.aside * h + T::of(ASIDE) * T::EPSILON * size(self.velocity);
                        Stiffened::move_aside(velocity, by);
                        let written = (&mut *force, &mut *self.stiffness);
                        self.mechanics
                            .linearise_in_motion(instant, self.point, velocity, written.0, written.1);
                        by
                    });
                    self.mechanics.resistance(instant, self.point, velocity, self.stiffness);
                    let stiffening = stiffened.map_or(T::one(), |slopes| slopes.factor);
                    for (j, &factor) in integrals.iter().enumerate() {
                        matrix.add(i, j, h * factor * stiffening, self.stiffness);
                    }
                    if aside.is_some() {
                        velocity.iter_mut().zip(self.velocity).for_each(|(place, &v)| *place = v);
                        for (&factor, acceleration) in
                            integrals.iter().zip(vectors(accelerations, coordinates))
                        {
                            add_multiple(velocity, h * factor, acceleration);
                        }
                        self.mechanics.restoring_force_in_motion(instant, self.point, velocity, force);
                    }
                } else {
                    self.mechanics.restoring_force_in_motion(instant, self.point, velocity, force);
                }
            } else if let Some(matrix) = matrix.as_deref_mut() {
                self.mechanics.linearise(instant, self.point, force, self.stiffness);
                for (j, &factor) in row.iter().enumerate() {
                    matrix.add(i, j, h * h * factor, self.stiffness);
                }
            } else {
                self.mechanics.restoring_force(instant, self.point, force);
            }
            for (force, &input) in force.iter_mut().zip(self.step.input) {
                *force -= input;
            }
        }
        self.forces
            .iter_mut()
            .zip(self.moment_correction)
            .for_each(|(force, &moment_correction)| *force -= moment_correction);
        add_multiple(self.forces, T::one(), self.known);
        self.damping.add_leading(self.stages, self.forces, self.scratch);
        if let Some(matrix) = matrix {
            self.damping.visit_leading(stages, |i, l, leading, rho| {
                let row = vector_at(tables.square, stages, l);
                for (j, &factor) in row.iter().enumerate() {
                    matrix.add(i, j, h * h * factor * leading, rho);
                }
            });
        }
        let of_stages = vectors(accelerations, coordinates).zip(vectors(self.forces, coordinates));
        for (residual, (acceleration, force)) in vectors_mut(residual, coordinates).zip(of_stages) {
            for (place, &force) in residual.iter_mut().zip(force) {
                *place = force;
            }
            self.mechanics.mass().multiply_add(T::one(), acceleration, residual);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::Integrator;
    use crate::system::{Mass, NoForce, Potential, Quadratic, System};

    fn oscillator(stiffness: f64) -> System<f64, 1, Quadratic<f64, 1>, NoForce> {
        System {
            mass: Mass::diagonal([2.0]).unwrap(),
            potential: Quadratic::diagonal([2.0 * stiffness]).unwrap(),
            force: NoForce,
        }
    }

    /// (q, v) after one step of q̈ = −q is R(hJ), R the stability function.
    fn assert_one_step<const R: usize>(order: i32, length: f64) {
        let method = RungeKutta::<R>::radau_iia().unwrap();
        let error = |h: f64| {
            let scheme = Collocation::new(&method);
            let mut integrator =
                Integrator::builder(oscillator(1.0), scheme, h).position([1.0]).build().unwrap();
            integrator.step(&[0.0].into()).unwrap();
            let state = integrator.state();
            (state.position[0] - h.cos()).abs().max((0.5 * state.momentum[0] + h.sin()).abs())
        };
        let found = (error(length) / error(0.5 * length)).log2();
        assert!((found - f64::from(order + 1)).abs() < 0.25, "{R} stages: local order {found}");
    }

    #[test]
    fn a_step_has_the_order_of_the_method() {
        assert_one_step::<1>(1, 0.2);
        assert_one_step::<2>(3, 0.2);
        assert_one_step::<3>(5, 0.2);
        // From longer steps, whose errors are above rounding.
        assert_one_step::<5>(9, 1.0);
        assert_one_step::<7>(13, 2.0);
    }

    #[test]
    fn stiff_steps_end_at_rest() {
        // ωh from 1 to 10⁶: L-stable.
        for frequency in [1.0, 1e2, 1e4, 1e6] {
            let scheme = Collocation::new(&RungeKutta::<3>::radau_iia().unwrap());
            let system = oscillator(frequency * frequency);
            let mut integrator = Integrator::builder(system, scheme, 1.0).position([1.0]).build().unwrap();
            let mut energy = integrator.energy();
            for _ in 0..50 {
                integrator.step(&[0.0].into()).unwrap();
                let next = integrator.energy();
                assert!(next <= energy, "ωh = {frequency}: {energy:e} → {next:e}");
                energy = next;
            }
            assert!(frequency == 1.0 || energy < 1e-20 * frequency * frequency, "{frequency}: {energy:e}");
        }
    }

    struct Pendulum;

    impl Potential<f64, 1> for Pendulum {
        fn value(&self, q: &SVector<f64, 1>) -> f64 {
            1.0 - q[0].cos()
        }

        fn gradient(&self, q: &SVector<f64, 1>) -> SVector<f64, 1> {
            SVector::from([q[0].sin()])
        }

        fn hessian(&self, q: &SVector<f64, 1>) -> nalgebra::SMatrix<f64, 1, 1> {
            [[q[0].cos()]].into()
        }
    }

    #[test]
    fn nonlinear_steps_converge_whatever_their_length() {
        for h in [1e-9, 1e-4, 0.3, 2.0] {
            let system = System { mass: Mass::diagonal([1.0]).unwrap(), potential: Pendulum, force: NoForce };
            let scheme = Collocation::new(&RungeKutta::<3>::radau_iia().unwrap());
            let mut integrator = Integrator::builder(system, scheme, h).position([2.0]).build().unwrap();
            let iterations = integrator.step(&[0.0].into()).unwrap();
            assert!(iterations <= 8, "{iterations} at {h}");
            // p = −∫ sin q, and q has hardly moved where h is small.
            if h < 1e-3 {
                let expected = -2.0_f64.sin() * h;
                assert!((integrator.state().momentum[0] / expected - 1.0).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn accelerations_need_no_more_digits_than_show_in_the_position() {
        let scheme = Collocation::new(&RungeKutta::<2>::radau_iia().unwrap());
        let iterations = |h| {
            let system = System { mass: Mass::diagonal([1.0]).unwrap(), potential: Pendulum, force: NoForce };
            let mut integrator = Integrator::builder(system, scheme, h).position([2.0]).build().unwrap();
            integrator.step(&[0.0].into()).unwrap()
        };
        // For h² below the unit roundoff, h² a is below the rounding of q.
        assert_eq!((iterations(1e-9), iterations(1e-3)), (1, 2));
    }
}
