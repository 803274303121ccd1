//! The integrator of a mechanism.

use core::fmt;

use crate::error::{ParameterError, check_step_size};
use crate::linear::{Singular, all_finite, at};
use crate::mechanism::definite::{NotDefinite, not_definite};
use crate::mechanism::discrete_gradient::{Buffers, Conserving};
use crate::mechanism::gauss_lobatto::GaussLobatto;
use crate::mechanism::lagrangian::{Dampers, Lagrangian};
use crate::mechanism::step::{
    Equations, Shape as StepShape, StepBuffers, add_compensated, add_transposed, copy, dot, form_saddle,
    from, product, solve_saddle,
};
use crate::memory::MemoryError;
use crate::real::{Real, max_or_nan};
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, header_bytes};
use crate::scheme::{StepError, write_indefinite};
use crate::space::parts_mut;
use crate::system::{Approach, Instant};

/// Kind of the saved state.
const TAG: [u8; 4] = *b"mecG";

/// The same for discrete gradients.
const CONSERVING_TAG: [u8; 4] = *b"mecD";

/// The same of a Lagrangian whose mass depends on the position.
const POLARISED_TAG: [u8; 4] = *b"mecP";

/// Largest |c| and |C v|, relative to the sizes that they are made of, with which a motion may begin.
const ON_CONSTRAINTS: f64 = 1e-8;

/// Relative size of what is left of a constraint's gradient beside those of the others that counts as none.
const REDUNDANT: f64 = 1e-10;

/// Largest number of corrections of an initial position.
const MOST_CORRECTIONS: usize = 50;

/// Integrates d/dt L_v − L_q = F − Σ_e G_eᵀ f_e − Cᵀ λ, c(q) = 0, by the (s, s)-Gauss–Lobatto method, with
/// dampers whose memories have the Gauss method's weights.
///
/// ```text
/// Q_i = q₀ + h Σ_j a_ij V_j ,      Q̃_j = q₀ + h Σ_k ã_jk V_k ,      W = G(Q) V ,      f = Z(∂_h) W
/// L_v(Q_i, V_i) = p₀ + h Σ_j a_ij Y_j − h Σ_{j<s} â_ij C(Q̃_j)ᵀ Λ_j ,      Y_i = L_q + F − G_iᵀ f_i
/// 0 = c(Q̃_j) ,  j = 1 … s
/// q₁ = q₀ + h Σ b_i V_i ,      p₁ = p₀ + h Σ b_i Y_i − h Σ_{j≤s} b̃_j C(Q̃_j)ᵀ Λ_j  with  C(q₁) v₁ = 0
/// ```
///
/// Positions have order 2s, at most 6 − 2β for a kernel that grows like s^β, β < 1, if elongations move at
/// the start, and 8 − 2β if not, or if β > 1; c and C v vanish at grid points to rounding. With a constant
/// mass, a quadratic potential and linear constraints the energy changes by the work of forces and dampers
/// exactly. Momenta with the [excess](Dampers::excess) of the memory's impulse have order 2s, at most 6 − 2β
/// and 8 − 4β if elongations move at the start, and 8 − 2β if not. Without constraints and with
/// L = ½vᵀMv − U it is Gauss collocation of Hamilton's equations, the Galerkin scheme of degree s with s
/// Gauss points \[MW\].
///
/// `B` is a buffer of [`numbers`](MechanismIntegrator::numbers), `P` one of
/// [`unknowns`](MechanismIntegrator::unknowns) indices. Sources: \[Jay07\], \[HLW\] VI.6; \[BanjaiFerrari22\]
/// for the weights.
#[derive(Clone, Debug)]
pub struct MechanismIntegrator<T, L, D, B, P> {
    rule: GaussLobatto<T>,
    gradients: Gradients,
    shape: StepShape,
    system: L,
    dampers: D,
    numbers: B,
    pivots: P,
    step_size: T,
    steps: u64,
    /// Index and time of the grid point from which times are counted with the step size.
    anchor: (u64, T),
    /// Work that the dampers have taken up, and its rounding error.
    work: [T; 2],
}

/// How the equations of a step take the gradients of its Lagrangian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Gradients {
    /// At the nodes of a Gauss method.
    AtNodes,
    /// As discrete gradients: of a potential beside a constant mass, or of the polarised Lagrangian.
    Discrete { is_polarised: bool },
}

/// Reason why a mechanism cannot be integrated from a start.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum MechanismError {
    /// The step size is not positive and finite, or a buffer has another length than it must.
    Parameter(ParameterError),
    /// Position, velocity or momentum have another number of coordinates, or are not finite.
    InitialState,
    /// Constraint `index` does not hold at the initial position: its value.
    OffConstraint {
        /// From 0.
        index: usize,
        /// c.
        value: f64,
    },
    /// The initial velocity leaves constraint `index`: its rate.
    LeavesConstraint {
        /// From 0.
        index: usize,
        /// C v.
        rate: f64,
    },
    /// The gradient of constraint `index` is a combination of those before it, at the initial position.
    Redundant {
        /// From 0.
        index: usize,
    },
    /// The mass is singular for velocities that the constraints allow.
    SingularMass,
    /// The mass is not positive definite for them: the kinetic energy of one of size 1.
    IndefiniteMass {
        /// The coordinate that moves most, from 0.
        coordinate: usize,
        /// ½ vᵀMv.
        energy: f64,
    },
    /// Constraint `index` cannot hold beside those before it: their gradients determine its own, and this of
    /// its value is left where they hold.
    Inconsistent {
        /// From 0.
        index: usize,
        /// What is left of c.
        value: f64,
    },
    /// No position on the constraints was found near the initial one: where they come closest to holding
    /// together, constraint `index` is off most.
    NotProjected {
        /// From 0.
        index: usize,
        /// Its c.
        value: f64,
    },
    /// The system tells neither its potential nor its polarised Lagrangian, which discrete gradients are made
    /// of.
    NoPotential,
}

impl fmt::Display for MechanismError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parameter(error) => error.fmt(f),
            Self::InitialState => write!(f, "the initial position, velocity or momentum is not finite"),
            Self::OffConstraint { index, value } => {
                write!(f, "constraint {index} (from 0) is {value:e} and not 0 at the initial position")
            }
            Self::LeavesConstraint { index, rate } => {
                write!(f, "the initial velocity changes constraint {index} (from 0) at the rate {rate:e}")
            }
            Self::Redundant { index } => {
                write!(
                    f,
                    "constraint {index} (from 0) is redundant: its gradient is zero, or a combination of those before it"
                )
            }
            Self::SingularMass => {
                write!(f, "the mass is singular for velocities that the constraints allow")
            }
            Self::IndefiniteMass { coordinate, energy } => write_indefinite(f, *coordinate, *energy),
            Self::Inconsistent { index, value } => {
                write!(
                    f,
                    "constraint {index} (from 0) contradicts those before it: its gradient is zero or a combination of theirs, \
                     and where they hold it is {value:e}"
                )
            }
            Self::NotProjected { index, value } => {
                write!(
                    f,
                    "no position on the constraints was found near the initial one: where they come closest to holding \
                     together, constraint {index} (from 0) is {value:e}"
                )
            }
            Self::NoPotential => write!(f, "the system does not tell its potential apart from its forces"),
        }
    }
}

impl core::error::Error for MechanismError {}

impl From<NotDefinite> for MechanismError {
    fn from(NotDefinite { coordinate, energy }: NotDefinite) -> Self {
        Self::IndefiniteMass { coordinate, energy }
    }
}

impl From<ParameterError> for MechanismError {
    fn from(error: ParameterError) -> Self {
        Self::Parameter(error)
    }
}

/// The numbers that are carried from step to step.
struct Carried<'a, T> {
    position: &'a mut [T],
    momentum: &'a mut [T],
    /// Rounding errors of both.
    position_rest: &'a mut [T],
    momentum_rest: &'a mut [T],
    velocity: &'a mut [T],
    /// First guess of the unknowns of the next step.
    guess: &'a mut [T],
    /// W₀, the slope of W there, and the dampers' forces at the present grid point.
    start: &'a mut [T],
    slope: &'a mut [T],
    tensions: &'a mut [T],
    /// V of the last step, for positions inside it.
    solution: &'a mut [T],
}

impl StepShape {
    /// Numbers that are carried.
    const fn carried(self) -> usize {
        5 * self.n + self.unknowns() + 3 * self.e + self.s * self.n
    }
}

fn carried<T>(shape: StepShape, mut buffer: &mut [T]) -> (Carried<'_, T>, &mut [T]) {
    let mut take = |count: usize| {
        let (part, rest) = parts_mut(core::mem::take(&mut buffer), count);
        buffer = rest;
        part
    };
    let StepShape { s, n, e, .. } = shape;
    let carried = Carried {
        position: take(n),
        momentum: take(n),
        position_rest: take(n),
        momentum_rest: take(n),
        velocity: take(n),
        guess: take(shape.unknowns()),
        start: take(e),
        slope: take(e),
        tensions: take(e),
        solution: take(s * n),
    };
    (carried, buffer)
}

impl<T, L, D, B, P> MechanismIntegrator<T, L, D, B, P>
where
    T: Real,
    L: Lagrangian<T>,
    D: Dampers<T>,
    B: AsRef<[T]> + AsMut<[T]>,
    P: AsMut<[usize]>,
{
    /// Numbers of the buffer for s stages, N coordinates, M constraints and E elongations.
    pub const fn numbers(stages: usize, [n, m, e]: [usize; 3]) -> usize {
        let shape = StepShape { s: stages, n, m, e };
        shape.carried() + shape.work()
    }

    /// Numbers of the buffer of [`conserving`](MechanismIntegrator::conserving); its `P` has one index more
    /// than there are unknowns with one stage.
    pub const fn conserving_numbers([n, m, e]: [usize; 3]) -> usize {
        let shape = StepShape { s: 1, n, m, e };
        let (work, own) = (shape.work(), Buffers::<T>::numbers(shape));
        shape.carried() + if own > work { own } else { work }
    }

    /// Number of unknowns of a step, the length of `P`.
    pub const fn unknowns(stages: usize, [n, m, e]: [usize; 3]) -> usize {
        StepShape { s: stages, n, m, e }.unknowns()
    }

    /// The integrator at a start on the constraints, or with `project` at the point on them that is found
    /// nearest in the metric of the mass.
    ///
    /// # Errors
    /// [`MechanismError`].
    pub fn new(
        rule: GaussLobatto<T>,
        (system, dampers): (L, D),
        time: (T, T),
        state: (&[T], &[T]),
        project: bool,
        buffers: (B, P),
    ) -> Result<Self, MechanismError> {
        Self::build((rule, Gradients::AtNodes), (system, dampers), time, state, project, buffers)
    }

    /// An integrator whose energy never rises by itself: the midpoint rule with discrete gradients, for
    /// systems with L = ½vᵀMv − U(q), M constant, that tell their [potential](Lagrangian::potential), and for
    /// those with L = ½vᵀM(q)v + a(q)ᵀv − U(q) that tell Λ, the [polarised](Lagrangian::polarised) one.
    ///
    /// ```text
    /// q₁ − q₀ = hM⁻¹ (p₀ + p₁)/2 ,     p₁ − p₀ = h (F − ∇̄U − Ḡᵀf) − C̄ᵀμ ,     c(q₁) = 0 ,
    /// ∇̄U·(q₁ − q₀) = U(q₁) − U(q₀) ,     C̄ (q₁ − q₀) = c(q₁) − c(q₀) ,     f = Z(∂_h) Ḡ (q₁ − q₀)/h
    /// ```
    ///
    /// and where the mass depends on the position
    ///
    /// ```text
    /// q₁ − q₀ = h (v₀ + v₁)/2 ,     L_v(q₁, v₁) − L_v(q₀, v₀) = h (F + ∇̄Λ − Ḡᵀf) − C̄ᵀμ ,
    /// ∇̄Λ·(q₁ − q₀) = Λ(q₁; v₀, v₁) − Λ(q₀; v₀, v₁) ,
    /// ```
    ///
    /// with the memory of the midpoint rule, so that E₁ + (work of the dampers) = E₀ + (work of F) for
    /// *every* U, g, c and h, up to rounding, and with Z = Σ c_j/(s + λ_j) E plus the energy stored in the
    /// dampers never rises but by F. Of order 2. The momentum need not be tangent to the constraints. Where
    /// Newton's method fails from the velocity of the last step, the solution is followed from a step of
    /// length 0; the energy bounds that path if U has a lower bound. Source: \[Gonzalez96\] for the
    /// gradients.
    ///
    /// # Errors
    /// [`MechanismError`].
    pub fn conserving(
        (system, dampers): (L, D),
        time: (T, T),
        state: (&[T], &[T]),
        project: bool,
        buffers: (B, P),
    ) -> Result<Self, MechanismError> {
        let rule = GaussLobatto::new(1)?;
        let gradients = Gradients::Discrete { is_polarised: false };
        let parts = (system, dampers);
        let mut made = Self::build((rule, gradients), parts, time, state, project, buffers)?;
        let n = made.shape.n;
        let (carried, room, system, _) = made.split();
        let (position, slope) = (&*carried.position, parts_mut(room.forces, n).0);
        if system.potential(position, slope, None).is_some() {
            return Ok(made);
        }
        let velocities = [&*carried.velocity; 2];
        if system.polarised(position, velocities, slope, None).is_none() {
            return Err(MechanismError::NoPotential);
        }
        made.gradients = Gradients::Discrete { is_polarised: true };
        Ok(made)
    }

    fn build(
        (rule, gradients): (GaussLobatto<T>, Gradients),
        (system, dampers): (L, D),
        (step_size, start): (T, T),
        (position, velocity): (&[T], &[T]),
        project: bool,
        (numbers, pivots): (B, P),
    ) -> Result<Self, MechanismError> {
        check_step_size(step_size.to_f64())?;
        let (n, m, e) = (system.coordinates(), system.constraints(), system.elongations());
        let shape = StepShape { s: rule.stages(), n, m, e };
        let check = |is, parameter, found: usize, allowed| {
            ParameterError::check(is, parameter, found as f64, allowed)
        };
        let found = dampers.elongations();
        check(found == e, "elongations of the dampers", found, "as many as the system has")?;
        let conserves = gradients != Gradients::AtNodes;
        let long =
            if conserves { Self::conserving_numbers([n, m, e]) } else { shape.carried() + shape.work() };
        let found = numbers.as_ref().len();
        check(found == long, "numbers of the buffer", found, "those of `numbers`, or `conserving_numbers`")?;
        let anchor = (0, start);
        let work = [T::zero(); 2];
        let mut made = Self {
            rule,
            gradients,
            shape,
            system,
            dampers,
            numbers,
            pivots,
            step_size,
            steps: 0,
            anchor,
            work,
        };
        let found = made.pivots.as_mut().len();
        let indices = shape.unknowns() + usize::from(conserves);
        check(found == indices, "indices of the buffer", found, "those of `unknowns`, or one more")?;
        let fits = position.len() == n && velocity.len() == n;
        if !(fits && all_finite(position) && all_finite(velocity)) {
            return Err(MechanismError::InitialState);
        }
        let (carried, _) = carried(shape, made.numbers.as_mut());
        copy(carried.position, position);
        copy(carried.velocity, velocity);
        made.check_rank()?;
        if project {
            made.project()?;
        }
        made.check_start()?;
        made.begin()?;
        Ok(made)
    }

    /// The instant of the present grid point, from the right.
    fn now(&self) -> Instant<T> {
        Instant::in_step(self.time(), T::zero(), self.step_size)
    }

    /// The carried numbers and the work arrays, with the system.
    fn split(&mut self) -> (Carried<'_, T>, StepBuffers<'_, T>, &mut L, &mut [usize]) {
        let (carried, work) = carried(self.shape, self.numbers.as_mut());
        (carried, StepBuffers::new(self.shape, work), &mut self.system, self.pivots.as_mut())
    }

    /// Refuses constraints whose gradients depend on each other at the present position.
    fn check_rank(&mut self) -> Result<(), MechanismError> {
        let StepShape { n, m, .. } = self.shape;
        let (carried, room, system, _) = self.split();
        let (rows, _) = parts_mut(room.constraints, m * n);
        system.constrain(carried.position, room.values, rows);
        if !(all_finite(room.values) && all_finite(rows)) {
            return Err(MechanismError::InitialState);
        }
        let near = allowed_off(carried.position);
        for index in 0..m {
            let (before, rest) = parts_mut(rows, index * n);
            let (row, _) = parts_mut(rest, n);
            let whole = dot(row, row);
            let (mut value, steep) = (at(room.values, index), largest(T::zero(), row));
            // Twice, for rows that are nearly parallel; those before are orthonormal.
            for _ in 0..2 {
                for (other, &off) in before.chunks_exact(n.max(1)).zip(&*room.values) {
                    let along = dot(row, other);
                    row.iter_mut().zip(other).for_each(|(place, &other)| *place -= along * other);
                    value -= along * off;
                }
            }
            let left = dot(row, row);
            if left <= T::of(REDUNDANT * REDUNDANT) * whole || whole == T::zero() {
                // To first order it is this where the others hold.
                let holds = value.abs() <= steep * near;
                return Err(match holds {
                    true => MechanismError::Redundant { index },
                    false => MechanismError::Inconsistent { index, value: value.to_f64() },
                });
            }
            let scale = T::one() / left.sqrt();
            row.iter_mut().for_each(|place| *place *= scale);
            room.values.iter_mut().skip(index).take(1).for_each(|place| *place = scale * value);
        }
        Ok(())
    }

    /// Moves position and velocity onto the constraints.
    fn project(&mut self) -> Result<(), MechanismError> {
        let (instant, shape) = (self.now(), self.shape);
        let mut last = T::max_value().unwrap_or(T::one());
        // The constraint that is off most where the largest is smallest.
        let mut closest = (last, 0, T::zero());
        for count in 0..=MOST_CORRECTIONS {
            let (carried, mut room, system, pivots) = self.split();
            let room = &mut room;
            form_saddle(system, shape, (instant, carried.position, carried.velocity), room);
            let size = largest(T::zero(), room.values);
            if size < closest.0 {
                let off = room.values.iter().enumerate().find(|(_, value)| value.abs() == size);
                closest = off.map_or(closest, |(index, &value)| (size, index, value));
            }
            let holds = size == T::zero() || (size < T::of(1e-6) && size >= last);
            if holds {
                break;
            }
            last = size;
            room.residual.fill(T::zero());
            let places = room.residual.iter_mut().skip(shape.n).zip(&*room.values);
            places.for_each(|(place, &value)| *place = -value);
            let is_lost = count == MOST_CORRECTIONS || !size.is_finite();
            if is_lost || solve_saddle(shape, room, pivots).is_err() {
                let (_, index, value) = closest;
                let missed = MechanismError::NotProjected { index, value: value.to_f64() };
                return Err(match self.check_rank() {
                    Err(MechanismError::Inconsistent { index, value }) => {
                        MechanismError::Inconsistent { index, value }
                    }
                    _ if is_lost || count > 0 => missed,
                    // The constraints have full rank at the start: only the mass is left as a reason.
                    _ => self.bad_mass(),
                });
            }
            let moves = carried.position.iter_mut().zip(&*room.residual);
            moves.for_each(|(place, &change)| *place += change);
        }
        let (carried, mut room, system, pivots) = self.split();
        let room = &mut room;
        form_saddle(system, shape, (instant, carried.position, carried.velocity), room);
        room.residual.fill(T::zero());
        let momentum = product(from(room.mass, 0, shape.n * shape.n), carried.velocity);
        room.residual.iter_mut().zip(momentum).for_each(|(place, p)| *place = p);
        if solve_saddle(shape, room, pivots).is_err() {
            return Err(self.bad_mass());
        }
        carried.velocity.iter_mut().zip(&*room.residual).for_each(|(place, &v)| *place = v);
        Ok(())
    }

    /// Refuses a start off the constraints, and a mass that is singular where they let it move.
    fn check_start(&mut self) -> Result<(), MechanismError> {
        let (instant, shape) = (self.now(), self.shape);
        let (carried, mut room, system, pivots) = self.split();
        form_saddle(system, shape, (instant, carried.position, carried.velocity), &mut room);
        let (near, slow) = (allowed_off(carried.position), allowed_off(carried.velocity));
        let rows = room.constraints.chunks_exact(shape.n.max(1));
        for (index, (&value, row)) in room.values.iter().zip(rows).enumerate() {
            let steep = largest(T::zero(), row);
            let rate = dot(row, carried.velocity);
            if value.abs() > steep * near || !value.is_finite() {
                return Err(MechanismError::OffConstraint { index, value: value.to_f64() });
            }
            if rate.abs() > steep * slow || !rate.is_finite() {
                return Err(MechanismError::LeavesConstraint { index, rate: rate.to_f64() });
            }
        }
        if let Some(found) = look_at_mass(system, shape, &mut room) {
            return Err(found.into());
        }
        form_saddle(system, shape, (instant, carried.position, carried.velocity), &mut room);
        room.residual.fill(T::zero());
        solve_saddle(shape, &mut room, pivots).map_err(|Singular| MechanismError::SingularMass)
    }

    /// What is wrong with the mass, where constraints of full rank leave a system without a solution.
    fn bad_mass(&mut self) -> MechanismError {
        let (instant, shape) = (self.now(), self.shape);
        let (carried, mut room, system, _) = self.split();
        form_saddle(system, shape, (instant, carried.position, carried.velocity), &mut room);
        look_at_mass(system, shape, &mut room).map_or(MechanismError::SingularMass, MechanismError::from)
    }

    /// Sets momentum, memories and the first guess for the present position and velocity.
    fn begin(&mut self) -> Result<(), MechanismError> {
        let (instant, StepShape { s, n, e, .. }) = (self.now(), self.shape);
        let (carried, room, system, _) = self.split();
        let (force, jacobian) = (parts_mut(room.forces, n).0, parts_mut(room.jacobians, e * n).0);
        system.first(instant, carried.position, carried.velocity, carried.momentum, force);
        system.elongate(carried.position, jacobian);
        let rates = product(jacobian, carried.velocity);
        carried.start.iter_mut().zip(rates).for_each(|(place, rate)| *place = rate);
        if ![&*carried.momentum, force, jacobian, carried.start].iter().all(|numbers| all_finite(numbers)) {
            return Err(MechanismError::InitialState);
        }
        carried.position_rest.fill(T::zero());
        carried.momentum_rest.fill(T::zero());
        carried.slope.fill(T::zero());
        carried.guess.fill(T::zero());
        for stage in carried.guess.chunks_exact_mut(n.max(1)).take(s) {
            copy(stage, carried.velocity);
        }
        copy(carried.solution, from(carried.guess, 0, s * n));
        let (carried, _) = super::integrator::carried(self.shape, self.numbers.as_mut());
        self.dampers.begin(carried.start);
        self.dampers.sudden(carried.start, carried.tensions);
        Ok(())
    }

    /// Time of the present state.
    pub fn time(&self) -> T {
        let (index, time) = self.anchor;
        time + T::from_count(self.steps - index) * self.step_size
    }

    /// Number of steps made.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Makes a step of the step size h with a force held over it; missing numbers are zero. Returns the
    /// number of Newton's corrections.
    ///
    /// # Errors
    /// [`StepError`]; the state is as before.
    pub fn step(&mut self, input: &[T]) -> Result<u32, StepError> {
        let (index, time) = self.anchor;
        let end = time + T::from_count((self.steps - index).saturating_add(1)) * self.step_size;
        let corrections = self.make(self.step_size, end, input)?;
        self.steps += 1;
        Ok(corrections)
    }

    /// Makes a step of any length to the time `end`.
    ///
    /// # Errors
    /// [`StepError`]; the state is as before.
    pub fn step_over(&mut self, length: T, end: T, input: &[T]) -> Result<u32, StepError> {
        if !(length > T::zero() && end.is_finite()) {
            return Err(MemoryError::StepLength.into());
        }
        let corrections = self.make(length, end, input)?;
        self.steps += 1;
        self.anchor = (self.steps, end);
        Ok(corrections)
    }

    fn make(&mut self, length: T, end: T, input: &[T]) -> Result<u32, StepError> {
        let (time, shape) = (self.time(), self.shape);
        if self.steps == 0 {
            self.look_at_start(input);
        }
        self.dampers.begin_step(length)?;
        if let Gradients::Discrete { is_polarised } = self.gradients {
            return self.conserve((time, length), input, is_polarised);
        }
        let (carried, work) = carried(shape, self.numbers.as_mut());
        let mut room = StepBuffers::new(shape, work);
        copy(room.unknowns, carried.guess);
        self.dampers.known(room.known);
        let mut equations = Equations {
            rule: &self.rule,
            shape,
            system: &mut self.system,
            dampers: &self.dampers,
            time,
            length,
            position: &*carried.position,
            momentum: &*carried.momentum,
            input,
            stiffened: None,
        };
        let corrections = equations.solve(&mut room, self.pivots.as_mut())?;
        let last = Instant { time: end, approach: Approach::FromLeft };
        let ended = Ended { rule: &self.rule, shape, length, last };
        ended.write_next(&mut self.system, &carried, &mut room, self.pivots.as_mut())?;
        // Nothing fails from here on.
        let StepBuffers { unknowns, next, tensions, rates, .. } = room;
        self.work = ended.advance(carried, [unknowns, next, tensions, rates], self.work);
        self.dampers.push(rates);
        Ok(corrections)
    }

    /// A step with discrete gradients.
    fn conserve(
        &mut self,
        (time, length): (T, T),
        input: &[T],
        is_polarised: bool,
    ) -> Result<u32, StepError> {
        let (shape, last) = (self.shape, Instant { time, approach: Approach::FromLeft });
        let (carried, work) = carried(shape, self.numbers.as_mut());
        let mut room = Buffers::new(shape, work);
        copy(room.unknowns, carried.guess);
        self.dampers.known(room.known);
        let pivots = self.pivots.as_mut();
        let mut equations = Conserving {
            shape,
            system: &mut self.system,
            dampers: &self.dampers,
            time,
            length,
            position: &*carried.position,
            momentum: &*carried.momentum,
            velocity: is_polarised.then_some(&*carried.velocity),
            input,
            stiffened: None,
        };
        let solved = equations.solve(&mut room, pivots);
        let corrections = solved.map_err(|error| equations.reason(error, &mut room))?;
        equations.write_next((&*carried.position_rest, &*carried.momentum_rest), &mut room, pivots)?;
        let ended = Ended { rule: &self.rule, shape, length, last };
        // Nothing fails from here on.
        let Buffers { unknowns, next, tensions, rates, .. } = room;
        self.work = ended.advance(carried, [unknowns, next, tensions, rates], self.work);
        self.dampers.push(rates);
        Ok(corrections)
    }

    /// q_k.
    pub fn position(&self) -> &[T] {
        from(self.numbers.as_ref(), 0, self.shape.n)
    }

    /// p_k of the scheme, L_v.
    pub fn momentum(&self) -> &[T] {
        from(self.numbers.as_ref(), self.shape.n, self.shape.n)
    }

    /// v_k, of this momentum.
    pub fn velocity(&self) -> &[T] {
        from(self.numbers.as_ref(), 4 * self.shape.n, self.shape.n)
    }

    /// V_1 … V_s of the last step.
    pub fn solution(&self) -> &[T] {
        let StepShape { s, n, .. } = self.shape;
        from(self.numbers.as_ref(), self.shape.carried() - s * n, s * n)
    }

    /// Λ_0 … Λ_{s−1} of the last step.
    #[doc(hidden)]
    pub fn multipliers(&self) -> &[T] {
        let StepShape { s, n, m, .. } = self.shape;
        from(self.numbers.as_ref(), 5 * n + s * n, s * m)
    }

    /// The dampers' forces at the present grid point, continued from the nodes of the last step.
    pub fn tensions(&self) -> &[T] {
        let StepShape { n, e, .. } = self.shape;
        from(self.numbers.as_ref(), 5 * n + self.shape.unknowns() + 2 * e, e)
    }

    /// The dampers' forces at the nodes of the step that has just been made, E for each; until anything else
    /// is asked for.
    #[doc(hidden)]
    pub fn tensions_at_nodes(&mut self) -> &[T] {
        let (_, work) = carried(self.shape, self.numbers.as_mut());
        match self.gradients {
            Gradients::AtNodes => StepBuffers::new(self.shape, work).tensions,
            Gradients::Discrete { .. } => Buffers::new(self.shape, work).tensions,
        }
    }

    /// The energy L_vᵀ v − L of the scheme's state.
    pub fn energy(&mut self) -> T {
        let (carried, _, system, _) = self.split();
        system.energy(carried.position, carried.velocity)
    }

    /// Step size h.
    pub fn step_size(&self) -> T {
        self.step_size
    }

    /// The work that the dampers have taken up so far, h Σ_k Σ_i b_i W_iᵀ f_i.
    pub fn work(&self) -> T {
        let [work, _] = self.work;
        work
    }

    /// The energy stored in the dampers.
    pub fn stored(&self) -> T {
        self.dampers.stored()
    }

    /// The method.
    pub fn rule(&self) -> &GaussLobatto<T> {
        &self.rule
    }

    /// The system.
    pub fn system(&self) -> &L {
        &self.system
    }

    /// The system, to be changed between steps.
    pub fn system_mut(&mut self) -> &mut L {
        &mut self.system
    }

    /// The dampers.
    pub fn dampers(&self) -> &D {
        &self.dampers
    }

    /// Writes p_k + Π Gᵀ δ_k, where δ is the [excess](Dampers::excess) of the memory's impulse and Π the
    /// projection onto momenta that keep the constraints. Returns false, with the scheme's momentum, if there
    /// is no such projection.
    pub fn write_momentum(&mut self, momentum: &mut [T]) -> bool {
        let (instant, shape) = (self.now(), self.shape);
        let (carried, work) = carried(shape, self.numbers.as_mut());
        let mut room = StepBuffers::new(shape, work);
        copy(momentum, carried.momentum);
        let excess = parts_mut(room.tensions, shape.e).0;
        self.dampers.excess([carried.start, carried.slope], excess);
        if excess.iter().all(|&number| number == T::zero()) {
            return true;
        }
        let jacobian = parts_mut(room.jacobians, shape.e * shape.n).0;
        self.system.elongate(carried.position, jacobian);
        let kick = parts_mut(room.next, shape.n).0;
        kick.fill(T::zero());
        add_transposed(T::one(), jacobian, excess, kick);
        if shape.m > 0 {
            form_saddle(&mut self.system, shape, (instant, carried.position, carried.velocity), &mut room);
            room.residual.fill(T::zero());
            let kick = room.next.iter().take(shape.n);
            room.residual.iter_mut().zip(kick).for_each(|(place, &kick)| *place = kick);
            if solve_saddle(shape, &mut room, self.pivots.as_mut()).is_err() {
                return false;
            }
            let rows = from(room.constraints, 0, shape.m * shape.n);
            let multipliers = from(room.residual, shape.n, shape.m);
            add_transposed(-T::one(), rows, multipliers, parts_mut(room.next, shape.n).0);
        }
        momentum.iter_mut().zip(&*room.next).for_each(|(place, &kick)| *place += kick);
        true
    }

    /// Sets the slope of W = G v at the start, for the force that is held over the first step; zero where
    /// the accelerations are not determined.
    fn look_at_start(&mut self, input: &[T]) {
        let StepShape { n, e, .. } = self.shape;
        let is_known = self.accelerate(input);
        let (carried, room, system, _) = self.split();
        let (position, velocity) = (&*carried.position, &*carried.velocity);
        let (jacobian, turning) = (parts_mut(room.jacobians, e * n).0, parts_mut(room.turning, e * n).0);
        system.elongate(position, jacobian);
        let idle = parts_mut(room.curvature, n * n).0;
        let none = parts_mut(room.tensions, e).0;
        none.fill(T::zero());
        system.turn(position, velocity, none, turning, idle);
        let rows = jacobian.chunks_exact(n.max(1)).zip(turning.chunks_exact(n.max(1)));
        for (slope, (row, turned)) in carried.slope.iter_mut().zip(rows) {
            *slope = dot(row, from(room.residual, 0, n)) + dot(turned, velocity);
        }
        if !(is_known && all_finite(carried.slope)) {
            carried.slope.fill(T::zero());
        }
    }

    /// The slope of W = G v at the start, after the first step.
    pub fn slope(&self) -> &[T] {
        let StepShape { n, e, .. } = self.shape;
        from(self.numbers.as_ref(), 5 * n + self.shape.unknowns() + e, e)
    }

    /// Writes the accelerations that keep the constraints at the present grid point under a force, and the
    /// multipliers λ, to the residual. Returns false if they are not determined.
    fn accelerate(&mut self, input: &[T]) -> bool {
        let (instant, shape) = (self.now(), self.shape);
        let StepShape { n, m, e, .. } = shape;
        let (carried, mut room, system, pivots) = self.split();
        let room = &mut room;
        let (position, velocity) = (&*carried.position, &*carried.velocity);
        let (momentum, force) = (parts_mut(room.momenta, n).0, parts_mut(room.forces, n).0);
        system.first(instant, position, velocity, momentum, force);
        force.iter_mut().zip(input).for_each(|(force, &input)| *force += input);
        let jacobian = parts_mut(room.jacobians, e * n).0;
        system.elongate(position, jacobian);
        add_transposed(-T::one(), jacobian, carried.tensions, force);
        form_saddle(system, shape, (instant, position, velocity), room);
        room.residual.fill(T::zero());
        let turned = product(from(room.coupling, 0, n * n), velocity);
        let parts = room.residual.iter_mut().zip(room.forces.iter().zip(turned));
        parts.for_each(|(place, (&force, turned))| *place = force - turned);
        for index in 0..m {
            room.values.fill(T::zero());
            room.values.iter_mut().skip(index).take(1).for_each(|one| *one = T::one());
            room.curvature.fill(T::zero());
            system.add_constraint_curvature(position, room.values, T::one(), room.curvature);
            let bent = product(room.curvature, velocity).zip(velocity);
            let sum = bent.fold(T::zero(), |sum, (bent, &v)| sum + bent * v);
            room.residual.iter_mut().skip(n + index).take(1).for_each(|place| *place = -sum);
        }
        solve_saddle(shape, room, pivots).is_ok()
    }

    /// Writes the multipliers λ of the constraints at the present grid point, from the accelerations that
    /// keep them: the constraint forces are −Cᵀλ. Returns false if they are not determined.
    pub fn write_multipliers(&mut self, multipliers: &mut [T]) -> bool {
        let StepShape { n, m, .. } = self.shape;
        let solved = self.accelerate(&[]);
        let (_, room, ..) = self.split();
        multipliers.iter_mut().zip(from(room.residual, n, m)).for_each(|(place, &found)| *place = found);
        solved
    }

    /// The largest |c| at the present position.
    pub fn constraint_error(&mut self) -> T {
        let shape = self.shape;
        let (carried, room, system, _) = self.split();
        system.constrain(carried.position, room.values, parts_mut(room.constraints, shape.m * shape.n).0);
        largest(T::zero(), room.values)
    }

    fn tag(&self) -> [u8; 4] {
        match self.gradients {
            Gradients::AtNodes => TAG,
            Gradients::Discrete { is_polarised: false } => CONSERVING_TAG,
            Gradients::Discrete { is_polarised: true } => POLARISED_TAG,
        }
    }

    fn shape_of_state(&self) -> Shape<4> {
        let StepShape { s, n, m, e } = self.shape;
        [
            ("stages", s as u64),
            ("coordinates", n as u64),
            ("constraints", m as u64),
            ("elongations", e as u64),
        ]
    }
}

/// A velocity without positive kinetic energy at the point where [`form_saddle`] was called last, of a system
/// whose mass is not constant; its matrix and the residual are lost.
fn look_at_mass<T: Real, L: Lagrangian<T>>(
    system: &L,
    shape: StepShape,
    room: &mut StepBuffers<'_, T>,
) -> Option<NotDefinite> {
    if system.has_constant_mass() {
        return None;
    }
    let StepShape { n, m, .. } = shape;
    let point = (from(room.mass, 0, n * n), from(room.constraints, 0, m * n));
    not_definite(point, [n, m], (room.matrix, room.residual))
}

/// How far positions of this size, or velocities, may be off a constraint whose gradient is one: a part of
/// them, and the rounding of terms of the size one, such as cosines.
fn allowed_off<T: Real>(numbers: &[T]) -> T {
    let rounding = T::of(1e3) * T::EPSILON;
    T::of(ON_CONSTRAINTS).max(rounding) * largest(T::zero(), numbers) + rounding
}

/// The largest absolute value of `least` and the numbers.
fn largest<T: Real>(least: T, numbers: &[T]) -> T {
    numbers.iter().fold(least, |most, x| max_or_nan(most, x.abs()))
}

/// A step whose equations are solved.
struct Ended<'a, T> {
    rule: &'a GaussLobatto<T>,
    shape: StepShape,
    length: T,
    /// The instant at its end.
    last: Instant<T>,
}

impl<T: Real> Ended<'_, T> {
    /// Writes the state at the end of the step to the room.
    fn write_next<L: Lagrangian<T>>(
        &self,
        system: &mut L,
        carried: &Carried<'_, T>,
        room: &mut StepBuffers<'_, T>,
        pivots: &mut [usize],
    ) -> Result<(), StepError> {
        let StepShape { s, n, m, .. } = self.shape;
        let h = self.length;
        let next = core::mem::take(&mut room.next);
        let (position, rest) = parts_mut(next, n);
        let (momentum, rest) = parts_mut(rest, n);
        let (position_rest, rest) = parts_mut(rest, n);
        let (momentum_rest, velocity) = parts_mut(rest, n);
        copy(position_rest, carried.position_rest);
        copy(momentum_rest, carried.momentum_rest);
        for i in 0..s {
            let factor = h * self.rule.weight(i);
            let (moves, kicks) = (from(room.unknowns, i * n, n), from(room.forces, i * n, n));
            position_rest.iter_mut().zip(moves).for_each(|(sum, &velocity)| *sum += factor * velocity);
            momentum_rest.iter_mut().zip(kicks).for_each(|(sum, &force)| *sum += factor * force);
            let rows = from(room.constraints, i * m * n, m * n);
            let multipliers = from(room.unknowns, s * n + i * m, m);
            add_transposed(-h * self.rule.knot_weight(i), rows, multipliers, momentum_rest);
        }
        add_compensated(carried.position, position_rest, position);
        // The velocity of this momentum may leave the constraints: the multipliers of the last knot take off
        // what does. The mass does not depend on the velocity.
        velocity.fill(T::zero());
        system.first(self.last, position, velocity, room.point, room.vector);
        form_saddle(system, self.shape, (self.last, position, velocity), room);
        room.residual.fill(T::zero());
        let moving = carried.momentum.iter().zip(&*momentum_rest).zip(&*room.point);
        let moving = moving.map(|((&p, &kick), &still)| (p - still) + kick);
        room.residual.iter_mut().zip(moving).for_each(|(place, number)| *place = number);
        if solve_saddle(self.shape, room, pivots).is_err() {
            let of_mass = look_at_mass(system, self.shape, room);
            return Err(of_mass.map_or(StepError::SingularJacobian, StepError::from));
        }
        velocity.iter_mut().zip(&*room.residual).for_each(|(place, &v)| *place = v);
        let rows = from(room.constraints, 0, m * n);
        add_transposed(-T::one(), rows, from(room.residual, n, m), momentum_rest);
        add_compensated(carried.momentum, momentum_rest, momentum);
        room.next = next;
        if let Some(found) = look_at_mass(system, self.shape, room) {
            return Err(found.into());
        }
        if all_finite(room.next) { Ok(()) } else { Err(StepError::NotFinite) }
    }

    /// Takes over the end of the step; returns the dampers' work up to there.
    fn advance(
        &self,
        carried: Carried<'_, T>,
        [unknowns, next_numbers, tensions, rates]: [&[T]; 4],
        [work, rest]: [T; 2],
    ) -> [T; 2] {
        let StepShape { s, n, m, e } = self.shape;
        let next = [
            carried.position,
            carried.momentum,
            carried.position_rest,
            carried.momentum_rest,
            carried.velocity,
        ];
        for (place, numbers) in next.into_iter().zip(next_numbers.chunks_exact(n.max(1))) {
            copy(place, numbers);
        }
        copy(carried.solution, from(unknowns, 0, s * n));
        let (guess, multipliers) = parts_mut(carried.guess, s * n);
        guess.fill(T::zero());
        for (i, stage) in guess.chunks_exact_mut(n.max(1)).enumerate() {
            for j in 0..s {
                let factor = self.rule.ahead(i, j);
                let parts = stage.iter_mut().zip(from(unknowns, j * n, n));
                parts.for_each(|(place, &velocity)| *place += factor * velocity);
            }
        }
        copy(multipliers, from(unknowns, s * n, s * m));
        carried.tensions.fill(T::zero());
        let mut taken = rest;
        for i in 0..s {
            let (factor, tensions) = (self.rule.at_end(i), from(tensions, i * e, e));
            let places = carried.tensions.iter_mut().zip(tensions);
            places.for_each(|(place, &tension)| *place += factor * tension);
            for (elongation, &tension) in tensions.iter().enumerate() {
                taken += self.length * self.rule.weight(i) * at(rates, elongation * s + i) * tension;
            }
        }
        let sum = work + taken;
        [sum, taken - (sum - work)]
    }
}

impl<T, L, D, B, P> Stateful for MechanismIntegrator<T, L, D, B, P>
where
    T: Real,
    L: Lagrangian<T>,
    D: Dampers<T> + Stateful,
    B: AsRef<[T]> + AsMut<[T]>,
    P: AsMut<[usize]>,
{
    fn state_bytes(&self) -> usize {
        header_bytes(4) + 16 + (3 + self.shape.carried()) * T::BYTES + self.dampers.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 4>(self.tag(), &self.shape_of_state())?;
        to.count(self.steps)?;
        to.count(self.anchor.0)?;
        to.numbers([&self.anchor.1])?;
        to.numbers(&self.work)?;
        to.numbers(from(self.numbers.as_ref(), 0, self.shape.carried()))?;
        self.dampers.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.header::<T, 4>(self.tag(), &self.shape_of_state())?;
        let steps = from.count()?;
        from.count_up_to("steps", usize::try_from(steps).unwrap_or(usize::MAX))?;
        from.skip::<T>(3 + self.shape.carried())?;
        self.dampers.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        from.header::<T, 4>(self.tag(), &self.shape_of_state())?;
        self.steps = from.count()?;
        let first = from.count_up_to("steps", usize::try_from(self.steps).unwrap_or(usize::MAX))?;
        self.anchor = (first as u64, from.number()?);
        self.work = [from.number()?, from.number()?];
        let (carried, _) = parts_mut(self.numbers.as_mut(), self.shape.carried());
        from.numbers(carried)?;
        self.dampers.restore(from)
    }
}
