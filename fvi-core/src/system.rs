//! The mechanical system: mass, potential, external force.

use nalgebra::{SMatrix, SVector};

use crate::coefficients::{Coefficients, Fixed};
use crate::error::MatrixError;
use crate::linear::{invert, is_positive_definite};
use crate::linear::{zero_matrix, zero_vector};
use crate::real::Real;
use crate::space::{Block, Space, vectors, vectors_mut};

/// Mass matrix M of the kinetic energy ½ vᵀ M v: symmetric and positive definite, diagonal or dense.
///
/// Source: \[JO\] eq. 33.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mass<T, const N: usize> {
    matrix: Coefficients<T, N>,
    inverse: Coefficients<T, N>,
}

impl<T: Real, const N: usize> Mass<T, N> {
    /// Checks the matrix and prepares its inverse.
    ///
    /// # Errors
    /// If an entry is not finite, or the matrix is not symmetric or not positive definite to working
    /// precision.
    pub fn new(matrix: Coefficients<T, N>) -> Result<Self, MatrixError> {
        matrix.check_symmetric()?;
        if !is_positive_definite(&matrix.to_matrix()) {
            return Err(MatrixError::NotPositiveDefinite);
        }
        let inverse = match &matrix {
            Coefficients::Diagonal(diagonal) => Coefficients::Diagonal(diagonal.map(|mass| T::one() / mass)),
            Coefficients::Dense(dense) => {
                Coefficients::Dense(invert(dense).map_err(|_| MatrixError::NotPositiveDefinite)?)
            }
        };
        Ok(Self { matrix, inverse })
    }

    /// Diagonal mass matrix.
    ///
    /// # Errors
    /// If a mass is not finite or not positive.
    pub fn diagonal(masses: [T; N]) -> Result<Self, MatrixError> {
        Self::new(Coefficients::Diagonal(SVector::from(masses)))
    }

    /// Dense mass matrix.
    ///
    /// # Errors
    /// As [`Mass::new`].
    pub fn dense(matrix: SMatrix<T, N, N>) -> Result<Self, MatrixError> {
        Self::new(Coefficients::Dense(matrix))
    }

    /// The matrix M.
    pub fn matrix(&self) -> &Coefficients<T, N> {
        &self.matrix
    }

    /// Momentum p = M v.
    #[inline(always)]
    pub fn momentum(&self, velocity: &SVector<T, N>) -> SVector<T, N> {
        self.matrix.multiply(velocity)
    }

    /// Velocity v = M⁻¹ p.
    #[inline(always)]
    pub fn velocity(&self, momentum: &SVector<T, N>) -> SVector<T, N> {
        self.inverse.multiply(momentum)
    }
}

/// Potential energy U(q) with its first two derivatives.
///
/// The scheme needs them consistent: `hessian` must be the derivative of `gradient` for Newton's method to
/// converge quadratically.
pub trait Potential<T, const N: usize> {
    /// U(q).
    fn value(&self, position: &SVector<T, N>) -> T;
    /// ∇U(q).
    fn gradient(&self, position: &SVector<T, N>) -> SVector<T, N>;
    /// ∂²U/∂q².
    fn hessian(&self, position: &SVector<T, N>) -> SMatrix<T, N, N>;
    /// True if U is a quadratic polynomial, so that the Hessian is the same everywhere. With a force that
    /// does not depend on the position every step then solves a linear system with one matrix, factored once.
    fn is_quadratic(&self) -> bool {
        false
    }
}

/// Quadratic potential U(q) = ½ qᵀ K q.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quadratic<T, const N: usize> {
    stiffness: Coefficients<T, N>,
}

impl<T: Real, const N: usize> Quadratic<T, N> {
    /// The potential with the stiffness matrix K.
    ///
    /// # Errors
    /// If an entry of K is not finite or K is not symmetric. K may be indefinite.
    pub fn new(stiffness: Coefficients<T, N>) -> Result<Self, MatrixError> {
        stiffness.check_symmetric()?;
        Ok(Self { stiffness })
    }

    /// Uncoupled springs.
    ///
    /// # Errors
    /// If a stiffness is not finite.
    pub fn diagonal(stiffnesses: [T; N]) -> Result<Self, MatrixError> {
        Self::new(Coefficients::Diagonal(SVector::from(stiffnesses)))
    }
}

impl<T: Real, const N: usize> Potential<T, N> for Quadratic<T, N> {
    #[inline(always)]
    fn value(&self, position: &SVector<T, N>) -> T {
        T::of(0.5) * position.dot(&self.stiffness.multiply(position))
    }

    #[inline(always)]
    fn gradient(&self, position: &SVector<T, N>) -> SVector<T, N> {
        self.stiffness.multiply(position)
    }

    #[inline(always)]
    fn hessian(&self, _: &SVector<T, N>) -> SMatrix<T, N, N> {
        self.stiffness.to_matrix()
    }

    #[inline(always)]
    fn is_quadratic(&self) -> bool {
        true
    }
}

/// Side from which a node sees its instant.
///
/// A force may jump at a grid point. A node at an end of the step sees the limit from inside the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Approach {
    /// The node lies strictly inside the step.
    Inside,
    /// The node is the end of the step: the limit from earlier times.
    FromLeft,
    /// The node is the beginning of the step: the limit from later times.
    FromRight,
}

/// A point of time as seen by a node of the scheme.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instant<T> {
    /// Time t.
    pub time: T,
    /// Side from which the limit is taken at a jump.
    pub approach: Approach,
}

impl<T: Real> Instant<T> {
    /// The instant `start` + `fraction`·`step_size`, `fraction` in [0, 1].
    #[inline(always)]
    pub fn in_step(start: T, fraction: T, step_size: T) -> Self {
        let approach = if fraction == T::zero() {
            Approach::FromRight
        } else if fraction == T::one() {
            Approach::FromLeft
        } else {
            Approach::Inside
        };
        Self { time: start + fraction * step_size, approach }
    }
}

/// External force F(t, q), or F(t, q, v) where it depends on the velocity.
///
/// A force that depends on the velocity returns true from [`depends_on_velocity`](Force::depends_on_velocity)
/// and implements [`value_in_motion`](Force::value_in_motion) with its derivatives. Schemes evaluate it at
/// their quadrature nodes with the velocity of their polynomial there, collocation with that of its stages,
/// and keep their orders.
///
/// ```
/// # use fvi_core::*;
/// # use nalgebra::{SMatrix, SVector};
/// /// Air drag −c |v| v.
/// struct Drag(f64);
///
/// impl Force<f64, 1> for Drag {
///     fn value(&self, _: Instant<f64>, _: &SVector<f64, 1>) -> SVector<f64, 1> {
///         [0.0].into()
///     }
///     fn depends_on_position(&self) -> bool {
///         false
///     }
///     fn depends_on_velocity(&self) -> bool {
///         true
///     }
///     fn value_in_motion(
///         &self,
///         _: Instant<f64>,
///         _: &SVector<f64, 1>,
///         v: &SVector<f64, 1>,
///     ) -> SVector<f64, 1> {
///         [-self.0 * v[0].abs() * v[0]].into()
///     }
///     fn velocity_jacobian(
///         &self,
///         _: Instant<f64>,
///         _: &SVector<f64, 1>,
///         v: &SVector<f64, 1>,
///     ) -> SMatrix<f64, 1, 1> {
///         [[-2.0 * self.0 * v[0].abs()]].into()
///     }
/// }
///
/// // Without other forces v = v₀/(1 + c v₀ t).
/// let potential = Quadratic::diagonal([0.0])?;
/// let system = System { mass: Mass::diagonal([1.0])?, potential, force: Drag(0.5) };
/// let mut integrator =
///     Integrator::builder(system, Galerkin::low_order(0.5)?, 0.01).velocity([2.0]).build()?;
/// for _ in 0..100 {
///     integrator.step(&[0.0].into())?;
/// }
/// assert!((integrator.state().momentum[0] - 1.0).abs() < 1e-5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Force<T: Real, const N: usize> {
    /// F(t, q); for a force that depends on the velocity F(t, q, 0).
    fn value(&self, instant: Instant<T>, position: &SVector<T, N>) -> SVector<T, N>;

    /// ∂F/∂q, entry (i, j) = ∂F_i/∂q_j. Zero by default; if F depends on q, Newton's method then converges
    /// slowly.
    fn jacobian(&self, _instant: Instant<T>, _position: &SVector<T, N>) -> SMatrix<T, N, N> {
        zero_matrix()
    }

    /// True if F depends on the position at all.
    fn depends_on_position(&self) -> bool {
        true
    }

    /// True if F depends on the velocity: then schemes call the `_in_motion` methods and `velocity_jacobian`.
    fn depends_on_velocity(&self) -> bool {
        false
    }

    /// F(t, q, v).
    fn value_in_motion(
        &self,
        instant: Instant<T>,
        position: &SVector<T, N>,
        _velocity: &SVector<T, N>,
    ) -> SVector<T, N> {
        self.value(instant, position)
    }

    /// ∂F/∂q at (t, q, v).
    fn jacobian_in_motion(
        &self,
        instant: Instant<T>,
        position: &SVector<T, N>,
        _velocity: &SVector<T, N>,
    ) -> SMatrix<T, N, N> {
        self.jacobian(instant, position)
    }

    /// ∂F/∂v at (t, q, v), entry (i, j) = ∂F_i/∂v_j. Zero by default, with which Newton's method converges
    /// slowly.
    fn velocity_jacobian(
        &self,
        _instant: Instant<T>,
        _position: &SVector<T, N>,
        _velocity: &SVector<T, N>,
    ) -> SMatrix<T, N, N> {
        zero_matrix()
    }

    /// Writes the moments ∫₀¹ ℓ_ν(τ) F(`start` + τ·`length`) dτ, ν = 0…S, of a force that depends on time
    /// alone, and returns true; or returns false, and the scheme evaluates F at its nodes.
    ///
    /// ℓ_0, …, ℓ_S are the Lagrange polynomials of degree S on the points 0, d_1, …, d_S; `points` holds d_1,
    /// …, d_S = 1. Where F is rough, at jumps or near a root like √t, exact moments keep the order that nodes
    /// lose.
    fn moments(&self, start: T, length: T, points: &[T], moments: &mut [SVector<T, N>]) -> bool {
        let _ = (start, length, points, moments);
        false
    }
}

/// No external force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoForce;

impl<T: Real, const N: usize> Force<T, N> for NoForce {
    #[inline(always)]
    fn value(&self, _: Instant<T>, _: &SVector<T, N>) -> SVector<T, N> {
        zero_vector()
    }

    #[inline(always)]
    fn depends_on_position(&self) -> bool {
        false
    }
}

/// A force F(t) of time alone, from a function.
#[derive(Clone, Copy, Debug)]
pub struct TimeForce<F>(pub F);

impl<T: Real, const N: usize, F: Fn(Instant<T>) -> SVector<T, N>> Force<T, N> for TimeForce<F> {
    #[inline(always)]
    fn value(&self, instant: Instant<T>, _: &SVector<T, N>) -> SVector<T, N> {
        (self.0)(instant)
    }

    #[inline(always)]
    fn depends_on_position(&self) -> bool {
        false
    }
}

/// Mechanical system with the Lagrangian L = ½ vᵀ M v − U(q) and an external force F(t, q) or F(t, q, v).
///
/// ```text
/// d/dt ∂L/∂v − ∂L/∂q = F(t, q, v) − Σ_m ρ_m D₋^{β_m} q
/// ```
///
/// The damping on the right is not part of it: it has a memory, see [`DampingTerm`](crate::DampingTerm).
/// Source: \[JO\] eq. 1, 31–34.
#[derive(Clone, Copy, Debug)]
pub struct System<T, const N: usize, P, F = NoForce> {
    /// Mass matrix M.
    pub mass: Mass<T, N>,
    /// Potential U.
    pub potential: P,
    /// External force F.
    pub force: F,
}

/// Quadrature by which a step computes the work of forces against the polynomials ℓ_0 … ℓ_S on the points 0,
/// d_1, …, d_S.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodalRule<'a, T> {
    /// t_k.
    pub start: T,
    /// h.
    pub length: T,
    /// b_1 … b_Q.
    pub weights: &'a [T],
    /// c_1 … c_Q.
    pub nodes: &'a [T],
    /// d_1 … d_S.
    pub points: &'a [T],
    /// ℓ_ν(c_i), S numbers ν = 1…S for each i.
    pub shapes: &'a [T],
    /// ℓ_ν(c_i), S numbers ν = 0…S−1 for each i.
    pub tests: &'a [T],
}

/// Number of moments of the largest degree, 6.
pub(crate) const MAX_MOMENTS: usize = 7;

/// Interface of schemes to a mechanical system in the space X.
///
/// [`System`] implements it for the fixed space. Methods take `&mut self` so that a host can keep scratch
/// space with its models.
pub trait Mechanics<T: Real, X: Space<T>> {
    /// Mass matrix M.
    fn mass(&self) -> &X::Block;

    /// v = M⁻¹ p.
    fn velocity(&self, momentum: &[T], velocity: &mut [T]);

    /// A guess of the velocity at the beginning of a step; by default M⁻¹ p, which a system may replace by
    /// something cheaper.
    fn drift(&self, momentum: &[T], velocity: &mut [T]) {
        self.velocity(momentum, velocity);
    }

    /// ∇U(q) − F(t, q): the rate of loss of momentum without damping and input.
    fn restoring_force(&mut self, instant: Instant<T>, position: &X::Vector, restoring: &mut [T]);

    /// [`restoring_force`](Mechanics::restoring_force) together with its derivative ∂²U/∂q² − ∂F/∂q.
    fn linearise(
        &mut self,
        instant: Instant<T>,
        position: &X::Vector,
        restoring: &mut [T],
        stiffness: &mut X::Block,
    );

    /// True if F depends on the velocity. Then schemes call the three methods that follow in place of the two
    /// above.
    #[inline(always)]
    fn depends_on_velocity(&self) -> bool {
        false
    }

    /// ∇U(q) − F(t, q, v).
    #[inline(always)]
    fn restoring_force_in_motion(
        &mut self,
        instant: Instant<T>,
        position: &X::Vector,
        _velocity: &[T],
        restoring: &mut [T],
    ) {
        self.restoring_force(instant, position, restoring);
    }

    /// [`restoring_force_in_motion`](Mechanics::restoring_force_in_motion) together with its derivative
    /// ∂²U/∂q² − ∂F/∂q.
    #[inline(always)]
    fn linearise_in_motion(
        &mut self,
        instant: Instant<T>,
        position: &X::Vector,
        _velocity: &[T],
        restoring: &mut [T],
        stiffness: &mut X::Block,
    ) {
        self.linearise(instant, position, restoring, stiffness);
    }

    /// Writes −∂F/∂v at the arguments of the last call of
    /// [`linearise_in_motion`](Mechanics::linearise_in_motion), which are passed again; `resistance` is the
    /// matrix that that call wrote to.
    #[inline(always)]
    fn resistance(
        &mut self,
        _instant: Instant<T>,
        _position: &X::Vector,
        _velocity: &[T],
        _resistance: &mut X::Block,
    ) {
    }

    /// True if [`moment_correction`](Mechanics::moment_correction) has to be called at all.
    #[inline(always)]
    fn is_rough(&self) -> bool {
        true
    }

    /// Writes the exact moments of the part of F that depends on time alone minus those of the quadrature,
    ///
    /// ```text
    /// ∫₀¹ ℓ_ν(τ) F(t_k + τh) dτ − Σ_i b_i ℓ_ν(c_i) F(t_k + c_i h) ,     ν = 0…S ,
    /// ```
    ///
    /// (S + 1)·N numbers, and returns true; or returns false if the quadrature is accurate enough.
    ///
    /// Collocation calls it with a rule without shapes and tests. It needs a correction of F at each of its R
    /// nodes, R·N numbers, so that Σ_i b_i π(c_i) F_i is ∫₀¹ π(τ) F(t_k + τh) dτ for polynomials π of degree
    /// R − 1: Σ_i b_i F_i is then the impulse, and with two or more stages the displacement is exact too.
    fn moment_correction(&mut self, rule: &NodalRule<'_, T>, moment_correction: &mut [T]) -> bool {
        let _ = (rule, moment_correction);
        false
    }

    /// A matrix for [`linearise`](Mechanics::linearise) to write to.
    fn stiffness(&self) -> X::Block;

    /// True if the stiffness, and the resistance if there is one, is the same at every position, velocity and
    /// time.
    fn is_linear(&self) -> bool;

    /// Energy E = ½ pᵀ M⁻¹ p + U(q) (\[JO\] §5).
    fn energy(&mut self, position: &X::Vector, momentum: &X::Vector) -> T;
}

impl<T: Real, const N: usize, P: Potential<T, N>, F: Force<T, N>> System<T, N, P, F> {
    /// Energy E = ½ pᵀ M⁻¹ p + U(q) (\[JO\] §5).
    pub fn energy(&self, position: &SVector<T, N>, momentum: &SVector<T, N>) -> T {
        T::of(0.5) * momentum.dot(&self.mass.velocity(momentum)) + self.potential.value(position)
    }
}

impl<T: Real, const N: usize, P: Potential<T, N>, F: Force<T, N>> Mechanics<T, Fixed<N>>
    for System<T, N, P, F>
{
    #[inline(always)]
    fn mass(&self) -> &Coefficients<T, N> {
        self.mass.matrix()
    }

    #[inline(always)]
    fn velocity(&self, momentum: &[T], velocity: &mut [T]) {
        velocity.fill(T::zero());
        self.mass.inverse.multiply_add(T::one(), momentum, velocity);
    }

    #[inline(always)]
    fn restoring_force(&mut self, instant: Instant<T>, position: &SVector<T, N>, restoring: &mut [T]) {
        let found = self.potential.gradient(position) - self.force.value(instant, position);
        for (place, &number) in restoring.iter_mut().zip(found.iter()) {
            *place = number;
        }
    }

    #[inline(always)]
    fn linearise(
        &mut self,
        instant: Instant<T>,
        position: &SVector<T, N>,
        restoring: &mut [T],
        stiffness: &mut Coefficients<T, N>,
    ) {
        self.restoring_force(instant, position, restoring);
        *stiffness =
            Coefficients::Dense(self.potential.hessian(position) - self.force.jacobian(instant, position));
    }

    #[inline(always)]
    fn depends_on_velocity(&self) -> bool {
        self.force.depends_on_velocity()
    }

    #[inline(always)]
    fn restoring_force_in_motion(
        &mut self,
        instant: Instant<T>,
        position: &SVector<T, N>,
        velocity: &[T],
        restoring: &mut [T],
    ) {
        let velocity = of_slice(velocity);
        let found =
            self.potential.gradient(position) - self.force.value_in_motion(instant, position, &velocity);
        for (place, &number) in restoring.iter_mut().zip(found.iter()) {
            *place = number;
        }
    }

    #[inline(always)]
    fn linearise_in_motion(
        &mut self,
        instant: Instant<T>,
        position: &SVector<T, N>,
        velocity: &[T],
        restoring: &mut [T],
        stiffness: &mut Coefficients<T, N>,
    ) {
        self.restoring_force_in_motion(instant, position, velocity, restoring);
        let of_force = self.force.jacobian_in_motion(instant, position, &of_slice(velocity));
        *stiffness = Coefficients::Dense(self.potential.hessian(position) - of_force);
    }

    #[inline(always)]
    fn resistance(
        &mut self,
        instant: Instant<T>,
        position: &SVector<T, N>,
        velocity: &[T],
        resistance: &mut Coefficients<T, N>,
    ) {
        let of_force = self.force.velocity_jacobian(instant, position, &of_slice(velocity));
        *resistance = Coefficients::Dense(-of_force);
    }

    #[inline(always)]
    fn moment_correction(&mut self, rule: &NodalRule<'_, T>, moment_correction: &mut [T]) -> bool {
        // Collocation evaluates forces at its nodes.
        if rule.shapes.is_empty() {
            return false;
        }
        let mut moments = [zero_vector(); MAX_MOMENTS];
        let degree = rule.points.len();
        let Some(moments) = moments.get_mut(..=degree) else { return false };
        if !self.force.moments(rule.start, rule.length, rule.points, moments) {
            return false;
        }
        let rows = vectors(rule.tests, degree).zip(vectors(rule.shapes, degree));
        for ((&weight, &node), (tests, shapes)) in rule.weights.iter().zip(rule.nodes).zip(rows) {
            let instant = Instant::in_step(rule.start, node, rule.length);
            let force = self.force.value(instant, &zero_vector());
            for (moment, &shape) in moments.iter_mut().zip(tests.iter().chain(shapes.last())) {
                *moment -= force * (weight * shape);
            }
        }
        for (place, moment) in vectors_mut(moment_correction, N).zip(moments) {
            place.iter_mut().zip(moment.iter()).for_each(|(place, &number)| *place = number);
        }
        true
    }

    #[inline(always)]
    fn stiffness(&self) -> Coefficients<T, N> {
        Coefficients::Dense(zero_matrix())
    }

    #[inline(always)]
    fn is_linear(&self) -> bool {
        self.potential.is_quadratic()
            && !self.force.depends_on_position()
            && !self.force.depends_on_velocity()
    }

    #[inline(always)]
    fn energy(&mut self, position: &SVector<T, N>, momentum: &SVector<T, N>) -> T {
        System::energy(self, position, momentum)
    }
}

/// The vector with these numbers; zeros where there are fewer.
#[inline(always)]
fn of_slice<T: Real, const N: usize>(numbers: &[T]) -> SVector<T, N> {
    let mut vector: SVector<T, N> = zero_vector();
    vector.iter_mut().zip(numbers).for_each(|(place, &number)| *place = number);
    vector
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{matrix, vector};

    #[test]
    fn masses_must_be_symmetric_positive_definite() {
        assert!(Mass::diagonal([1.0, 0.0]).is_err());
        assert_eq!(Mass::diagonal([1.0, f64::NAN]), Err(MatrixError::NotFinite));
        let skew = matrix![1.0, 0.5; 0.4, 1.0];
        assert_eq!(Mass::dense(skew), Err(MatrixError::NotSymmetric { row: 1, column: 0 }));
        assert_eq!(Mass::dense(matrix![1.0, 2.0; 2.0, 1.0]), Err(MatrixError::NotPositiveDefinite));
        let mass = Mass::dense(matrix![2.0, 1.0; 1.0, 3.0]).unwrap();
        let velocity = vector![0.3, -0.7];
        assert!((mass.velocity(&mass.momentum(&velocity)) - velocity).norm() < 1e-15);
    }

    #[test]
    fn nodes_at_the_ends_of_a_step_look_inside() {
        assert_eq!(Instant::in_step(1.0, 0.0, 0.5).approach, Approach::FromRight);
        assert_eq!(Instant::in_step(1.0, 0.5, 0.5), Instant { time: 1.25, approach: Approach::Inside });
        assert_eq!(Instant::in_step(1.0, 1.0, 0.5), Instant { time: 1.5, approach: Approach::FromLeft });
    }

    #[test]
    fn energy_is_that_of_motion_and_that_of_position() {
        let mass = Mass::dense(matrix![2.0, 1.0; 1.0, 3.0]).unwrap();
        let potential = Quadratic::diagonal([4.0, 0.5f64]).unwrap();
        let system = System { mass, potential, force: NoForce };
        let velocity = vector![0.5, -1.0];
        let momentum = system.mass.momentum(&velocity);
        assert_eq!(momentum, vector![0.0, -2.5]);
        // ½ (2·0.5² − 2·0.5 + 3) + ½ (4·3² + 0.5·2²)
        assert!((system.energy(&vector![3.0, 2.0], &momentum) - (1.25 + 19.0)).abs() < 1e-14);
    }

    /// A spring and a force that depends on the position.
    struct Follower;

    impl Force<f64, 2> for Follower {
        fn value(&self, instant: Instant<f64>, q: &SVector<f64, 2>) -> SVector<f64, 2> {
            vector![instant.time * q[1], 0.25 * q[0]]
        }

        fn jacobian(&self, instant: Instant<f64>, _: &SVector<f64, 2>) -> SMatrix<f64, 2, 2> {
            matrix![0.0, instant.time; 0.25, 0.0]
        }
    }

    #[test]
    fn systems_are_linear_where_forces_do_not_follow_the_position() {
        let (mass, potential) = (Mass::diagonal([1.0; 2]).unwrap(), Quadratic::diagonal([4.0, 0.5]).unwrap());
        fn is_linear<F: Force<f64, 2>>(system: &System<f64, 2, Quadratic<f64, 2>, F>) -> bool {
            Mechanics::<f64, Fixed<2>>::is_linear(system)
        }
        assert!(is_linear(&System { mass, potential, force: NoForce }));
        let of_time = TimeForce(|instant: Instant<f64>| vector![instant.time, 1.0]);
        assert!(is_linear(&System { mass, potential, force: of_time }));
        assert!(!is_linear(&System { mass, potential, force: Follower }));
    }

    #[test]
    fn the_stiffness_is_the_derivative_of_the_restoring_force() {
        let (mass, potential) = (Mass::diagonal([1.0; 2]).unwrap(), Quadratic::diagonal([4.0, 0.5]).unwrap());
        let mut system = System { mass, potential, force: Follower };
        let instant = Instant::in_step(3.0, 0.5, 0.5);
        let (mut restoring, mut stiffness) = ([0.0; 2], Mechanics::<f64, Fixed<2>>::stiffness(&system));
        system.linearise(instant, &vector![1.0, 2.0], &mut restoring, &mut stiffness);
        // K q − F, K − ∂F/∂q
        assert_eq!(restoring, [4.0 - 6.5, 1.0 - 0.25]);
        assert_eq!(stiffness.to_matrix(), matrix![4.0, -3.25; -0.25, 0.5]);
        assert_eq!(
            Mechanics::<f64, Fixed<2>>::energy(&mut system, &vector![1.0, 2.0], &vector![2.0, 0.0]),
            5.0
        );
    }

    /// A free mass that relies on all defaults.
    struct Free(Coefficients<f64, 1>);

    impl Mechanics<f64, Fixed<1>> for Free {
        fn mass(&self) -> &Coefficients<f64, 1> {
            &self.0
        }

        fn velocity(&self, momentum: &[f64], velocity: &mut [f64]) {
            velocity.iter_mut().zip(momentum).for_each(|(v, p)| *v = p / 2.0);
        }

        fn restoring_force(&mut self, _: Instant<f64>, _: &SVector<f64, 1>, restoring: &mut [f64]) {
            restoring.fill(0.0);
        }

        fn linearise(
            &mut self,
            _: Instant<f64>,
            _: &SVector<f64, 1>,
            _: &mut [f64],
            _: &mut Coefficients<f64, 1>,
        ) {
        }

        fn stiffness(&self) -> Coefficients<f64, 1> {
            Coefficients::Diagonal([0.0].into())
        }

        fn is_linear(&self) -> bool {
            true
        }

        fn energy(&mut self, _: &SVector<f64, 1>, momentum: &SVector<f64, 1>) -> f64 {
            momentum[0] * momentum[0] / 4.0
        }
    }

    #[test]
    fn what_a_system_need_not_say_is_what_most_of_them_are() {
        let mut free = Free(Coefficients::Diagonal([2.0].into()));
        let mut velocity = [f64::NAN];
        free.drift(&[3.0], &mut velocity);
        assert_eq!(velocity, [1.5]);
        let (weights, nodes) = (&[1.0][..], &[0.5][..]);
        let rule = NodalRule {
            start: 0.0,
            length: 0.5,
            weights,
            nodes,
            points: &[1.0],
            shapes: nodes,
            tests: nodes,
        };
        let mut moment_correction = [7.0; 2];
        assert!(free.is_rough() && !free.moment_correction(&rule, &mut moment_correction));
        assert_eq!(moment_correction, [7.0; 2]);
        let mut moments = [SVector::zeros(); 2];
        assert!(Follower.depends_on_position() && !Follower.moments(0.0, 0.5, &[1.0], &mut moments));
    }
}
