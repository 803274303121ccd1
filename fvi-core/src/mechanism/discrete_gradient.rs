//! A step by the midpoint rule with discrete gradients, and a solver for it that no step is too long for.

use crate::linear::{Singular, all_finite, at, factor, substitute};
use crate::mechanism::definite::not_definite;
use crate::mechanism::lagrangian::{Dampers, Lagrangian, Second};
use crate::mechanism::step::{
    Shape, add_compensated, add_transposed, copy, dot, from, product, put, scale_of,
};
use crate::newton::{Stiffened, Stiffening, is_steep, is_unbalanced};
use crate::real::{Real, max_or_nan};
use crate::scheme::StepError;
use crate::space::{part_mut, parts_mut};
use crate::system::{Approach, Instant};

/// Newton's corrections before the solution is followed from a short step.
const DIRECT: u32 = 20;

/// Corrections of a point of the path.
const OF_POINT: u32 = 8;

/// Largest number of points of a path.
const MOST_POINTS: u32 = 2_000;

/// Number of starts after that.
const STARTS: u32 = 60;

/// Work arrays of a step.
pub(super) struct Buffers<'a, T> {
    /// V and μ = h Λ, behind them the share θ of the step.
    pub(super) unknowns: &'a mut [T],
    /// Where the path was, its direction, and the right-hand side of the next one.
    before: &'a mut [T],
    tangent: &'a mut [T],
    pub(super) residual: &'a mut [T],
    moved: &'a mut [T],
    pub(super) matrix: &'a mut [T],
    /// q₁ − q₀, q₁ and the middle.
    rise: &'a mut [T],
    end: &'a mut [T],
    middle: &'a mut [T],
    /// M V, and L_q + F with the corrected gradient.
    pub(super) momentum: &'a mut [T],
    force: &'a mut [T],
    /// U at both ends, or Λ with the sizes that it is made of; ∂U or ∂Λ in the middle and at the end, and the
    /// second derivatives in the middle.
    heights: &'a mut [T],
    slope: &'a mut [T],
    end_slope: &'a mut [T],
    bend: &'a mut [T],
    /// v₁, and two vectors of momentum, of a mass that depends on the position.
    end_velocity: &'a mut [T],
    carried_on: &'a mut [T],
    spare: &'a mut [T],
    pub(super) mass: &'a mut [T],
    coupling: &'a mut [T],
    stiffness: &'a mut [T],
    resistance: &'a mut [T],
    /// c at both ends and in the middle, with their gradients.
    values: &'a mut [T],
    end_values: &'a mut [T],
    constraints: &'a mut [T],
    end_constraints: &'a mut [T],
    weights: &'a mut [T],
    jacobian: &'a mut [T],
    turning: &'a mut [T],
    pull: &'a mut [T],
    pub(super) rates: &'a mut [T],
    pub(super) tensions: &'a mut [T],
    pub(super) known: &'a mut [T],
    /// Position, momentum, their rounding errors, and velocity at the end of the step.
    pub(super) next: &'a mut [T],
}

impl<'a, T: Real> Buffers<'a, T> {
    /// Numbers of a buffer.
    pub(super) const fn numbers(shape: Shape) -> usize {
        let Shape { n, m, e, .. } = shape;
        let u = n + m;
        3 + 5 * (u + 1) + (u + 1) * (u + 1) + 15 * n + 6 * n * n + 3 * m + 2 * m * n + 2 * e * n + 3 * e
    }

    /// The arrays in a buffer of so many numbers.
    pub(super) fn new(shape: Shape, mut buffer: &'a mut [T]) -> Self {
        let Shape { n, m, e, .. } = shape;
        let u = n + m;
        let mut take = |count: usize| {
            let (part, rest) = parts_mut(core::mem::take(&mut buffer), count);
            buffer = rest;
            part
        };
        Self {
            unknowns: take(u + 1),
            before: take(u + 1),
            tangent: take(u + 1),
            residual: take(u + 1),
            moved: take(u + 1),
            matrix: take((u + 1) * (u + 1)),
            rise: take(n),
            end: take(n),
            middle: take(n),
            momentum: take(n),
            force: take(n),
            heights: take(3),
            slope: take(n),
            end_slope: take(n),
            bend: take(n * n),
            end_velocity: take(n),
            carried_on: take(n),
            spare: take(n),
            mass: take(n * n),
            coupling: take(n * n),
            stiffness: take(n * n),
            resistance: take(n * n),
            values: take(m),
            end_values: take(m),
            constraints: take(m * n),
            end_constraints: take(m * n),
            weights: take(m),
            jacobian: take(e * n),
            turning: take(e * n),
            pull: take(n * n),
            rates: take(e),
            tensions: take(e),
            known: take(e),
            next: take(5 * n),
        }
    }
}

/// The last equation, which says how much of the step the solution is of.
#[derive(Clone, Copy)]
enum Row<T> {
    /// θ has this value.
    Share(T),
    /// The point is so far along the tangent from the one before.
    Along(T),
}

/// The equations of one step from (q₀, p₀), of the share θ of its length h,
///
/// ```text
/// 2 (M V − p₀) + θh [∇̄U − F + Ḡᵀ f] + C̄ᵀ μ = 0 ,    C̄ V + (θ/h) c(q₀) = 0 ,
/// q₁ = q₀ + θhV ,     f = known + Z₀ Ḡ V ,     Ḡ = G((q₀ + q₁)/2) ,
/// ∇̄U = ∇U((q₀ + q₁)/2) + r (q₁ − q₀) ,   ∇̄U · (q₁ − q₀) = U(q₁) − U(q₀) ,
/// ```
///
/// and C̄ likewise. If the mass depends on the position, the first of them is that of Λ, which is ½vᵀM(q)w +
/// ½aᵀ(v + w) − U (see [`Lagrangian::polarised`]),
///
/// ```text
/// L_v(q₁, v₁) − p₀ − θh [∇̄Λ + F − Ḡᵀ f] + C̄ᵀ μ = 0 ,     v₁ = 2V − v₀ ,
/// ∇̄Λ = ∂Λ/∂q((q₀ + q₁)/2; v₀, v₁) + r (q₁ − q₀) ,   ∇̄Λ · (q₁ − q₀) = Λ(q₁; v₀, v₁) − Λ(q₀; v₀, v₁) ,
/// ```
///
/// whose product with V is E₁ − E₀ as before, since (p₁ − p₀)·V is ½v₁ᵀM₁v₁ − ½v₀ᵀM₀v₀ plus the change of
/// Λ + U. No mass is inverted. For θ = 1 they are those of the step, with the multipliers μ/h; for θ = 0 they
/// are linear and have one solution. In between the energy bounds V, so that a path of solutions leads from
/// one to the other.
pub(super) struct Conserving<'a, T, L, D> {
    pub(super) shape: Shape,
    pub(super) system: &'a mut L,
    pub(super) dampers: &'a D,
    pub(super) time: T,
    pub(super) length: T,
    pub(super) position: &'a [T],
    pub(super) momentum: &'a [T],
    /// v₀, if the mass depends on the position.
    pub(super) velocity: Option<&'a [T]>,
    /// A force held over the step; missing numbers are zero.
    pub(super) input: &'a [T],
    /// How the derivatives of forces with respect to velocities enter the matrix, if it is stiffened.
    pub(super) stiffened: Option<Stiffened<T>>,
}

impl<T: Real, L: Lagrangian<T>, D: Dampers<T>> Conserving<'_, T, L, D> {
    /// Solves for V and μ, which hold a first guess; the arrays of the room are then those of the solution.
    /// Returns the number of corrections.
    pub(super) fn solve(
        &mut self,
        room: &mut Buffers<'_, T>,
        pivots: &mut [usize],
    ) -> Result<u32, StepError> {
        put_last(room.unknowns, T::one());
        if let Ok(count) = self.newton(Row::Share(T::one()), DIRECT, room, pivots) {
            return Ok(count);
        }
        room.unknowns.fill(T::zero());
        self.newton(Row::Share(T::zero()), OF_POINT, room, pivots)?;
        copy(room.before, room.unknowns);
        if let Ok(count) = self.follow(room, pivots) {
            return Ok(count);
        }
        if room.resistance.iter().any(|&slope| slope != T::zero())
            && let Ok(count) = self.solve_stiffened(room, pivots)
        {
            return Ok(count);
        }
        // A potential that oscillates many times over the step bends the path as often. Parts of the velocity
        // without forces are starts, too.
        room.unknowns.fill(T::zero());
        self.newton(Row::Share(T::zero()), OF_POINT, room, pivots)?;
        copy(room.before, room.unknowns);
        let mut last = StepError::NotConverged { iterations: 0, residual: f64::INFINITY };
        for part in
            (0..STARTS).map(|index| T::one() - T::of(1.5 / f64::from(STARTS)) * T::of(f64::from(index)))
        {
            room.unknowns.iter_mut().zip(&*room.before).for_each(|(place, &free)| *place = part * free);
            put_last(room.unknowns, T::one());
            match self.newton(Row::Share(T::one()), DIRECT, room, pivots) {
                Ok(count) => return Ok(count),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    /// True if forces with steep slopes are not in balance at the unknowns.
    fn is_unbalanced(&mut self, room: &mut Buffers<'_, T>) -> bool {
        let n = self.shape.n;
        self.linearise(Row::Share(T::one()), room);
        let [residual, velocity] = [&*room.residual, &*room.unknowns].map(|all| from(all, 0, n));
        is_unbalanced(n, residual, self.length, [&*room.resistance, &*room.mass], velocity)
    }

    /// As [`solve`](Self::solve), by the iteration of [`Stiffening`], from velocities of zero.
    fn solve_stiffened(&mut self, room: &mut Buffers<'_, T>, pivots: &mut [usize]) -> Result<u32, StepError> {
        let (n, row) = (self.shape.n, Row::Share(T::one()));
        room.unknowns.fill(T::zero());
        put_last(room.unknowns, T::one());
        let mut iteration = Stiffening::new();
        let ended = loop {
            self.stiffened = Some(iteration.slopes);
            self.linearise(row, room);
            self.write_last_equation(row, room);
            let residual = size_of(room.residual);
            if !(residual.is_finite() && all_finite(room.matrix)) {
                break Err(StepError::NotFinite);
            }
            if factor(room.matrix, pivots).is_err() {
                if iteration.widen() {
                    continue;
                }
                break Err(StepError::SingularJacobian);
            }
            substitute(room.matrix, pivots, room.residual);
            if !all_finite(room.residual) {
                break Err(StepError::SingularJacobian);
            }
            room.unknowns.iter_mut().zip(&*room.residual).for_each(|(place, &change)| *place -= change);
            let (change, extent) = (size_of(from(room.residual, 0, n)), size_of(from(room.unknowns, 0, n)));
            let scale = scale_of(from(room.unknowns, 0, n), self.position, self.length);
            let rounding = T::of(2.0) * T::EPSILON * scale;
            match iteration.judge(residual, change, (rounding, extent)) {
                Ok(true) => break Ok(DIRECT + iteration.count),
                Ok(false) => {}
                Err(error) => break Err(error),
            }
        };
        self.stiffened = None;
        self.evaluate(room);
        if ended.is_ok() && !all_finite(room.residual) { Err(StepError::NotFinite) } else { ended }
    }

    /// Follows the solutions from that at θ = 0, which is `before`, to θ = 1 by their arc length: they may
    /// turn back in θ on the way.
    ///
    /// A point is taken if it lies close to the tangent of the one before and the tangent hardly turns, so
    /// that the path is not left for another one; at kinks, which short lengths show, it may turn by a right
    /// angle.
    fn follow(&mut self, room: &mut Buffers<'_, T>, pivots: &mut [usize]) -> Result<u32, StepError> {
        let mut count = DIRECT;
        room.tangent.fill(T::zero());
        put_last(room.tangent, T::one());
        self.turn(room, pivots)?;
        copy(room.tangent, room.residual);
        let (mut length, n) = (T::of(0.1), self.shape.n);
        for _ in 0..MOST_POINTS {
            // The metric is that of the point.
            let scale = self.scale(room.before);
            let size = scaled_dot(room.tangent, room.tangent, n, scale).sqrt();
            room.tangent.iter_mut().for_each(|number| *number /= size);
            let (share, rate) = (last_of(room.before), last_of(room.tangent));
            let (far, turned) = if length < T::of(1e-6) { (3.0, 0.0) } else { (0.3, 0.8) };
            let ends = share < T::one() && share + length * rate >= T::one();
            let distance = if ends { (T::one() - share) / rate } else { length };
            let places = room.unknowns.iter_mut().zip(room.before.iter().zip(&*room.tangent));
            places.for_each(|(place, (&from, &along))| *place = from + distance * along);
            let row = if ends { Row::Share(T::one()) } else { Row::Along(distance) };
            let most = if ends { DIRECT } else { OF_POINT };
            match self.newton(row, most, room, pivots) {
                Ok(corrections) if self.is_close(T::of(far) * distance, distance, room) => {
                    count = count.saturating_add(corrections);
                    if ends {
                        return Ok(count);
                    }
                    self.turn(room, pivots)?;
                    if scaled_dot(room.residual, room.tangent, n, scale) > T::of(turned) {
                        copy(room.before, room.unknowns);
                        copy(room.tangent, room.residual);
                        length = T::one().min(T::of(1.6) * length);
                        continue;
                    }
                }
                _ => {}
            }
            length *= T::of(0.4);
            if length < T::of(1e3) * T::EPSILON {
                break;
            }
        }
        copy(room.unknowns, room.before);
        put_last(room.unknowns, T::one());
        self.evaluate(room);
        Err(StepError::NotConverged { iterations: count, residual: size_of(room.residual).to_f64() })
    }

    /// True if the unknowns lie no farther than `most` from the place at a distance along the tangent.
    fn is_close(&self, most: T, distance: T, room: &mut Buffers<'_, T>) -> bool {
        let parts = room.unknowns.iter().zip(room.before.iter().zip(&*room.tangent));
        let off = |(&now, (&before, &along)): (&T, (&T, &T))| now - before - distance * along;
        room.moved.iter_mut().zip(parts).for_each(|(place, parts)| *place = off(parts));
        let off = scaled_dot(room.moved, room.moved, self.shape.n, self.scale(room.before)).sqrt();
        off <= most
    }

    /// Writes the state at the end of the step, given what the last sums lost to rounding.
    pub(super) fn write_next(
        &mut self,
        (position_rest, momentum_rest): (&[T], &[T]),
        room: &mut Buffers<'_, T>,
        pivots: &mut [usize],
    ) -> Result<(), StepError> {
        let n = self.shape.n;
        let next = core::mem::take(&mut room.next);
        let (position, rest) = parts_mut(next, n);
        let (momentum, rest) = parts_mut(rest, n);
        let (moves, rest) = parts_mut(rest, n);
        let (kicks, velocity) = parts_mut(rest, n);
        let of_position = moves.iter_mut().zip(position_rest.iter().zip(&*room.rise));
        of_position.for_each(|(place, (&rest, &rise))| *place = rest + rise);
        if let Some(before) = self.velocity {
            let solved = from(room.unknowns, 0, n).iter().zip(before);
            let of_velocity = kicks.iter_mut().zip(momentum_rest).zip(solved);
            of_velocity.for_each(|((place, &rest), (&v, &start))| *place = rest + T::of(2.0) * (v - start));
            add_compensated(self.position, moves, position);
            add_compensated(before, kicks, velocity);
            let last = Instant { time: self.time + self.length, approach: Approach::FromLeft };
            self.system.first(last, position, velocity, momentum, room.force);
            let places = (&*position, &*velocity, last);
            let mass = self.check_mass(places, room);
            room.next = next;
            return if all_finite(room.next) { mass } else { Err(StepError::NotFinite) };
        }
        let of_momentum = kicks.iter_mut().zip(momentum_rest).zip(room.momentum.iter().zip(self.momentum));
        of_momentum.for_each(|((place, &rest), (&p, &start))| *place = rest + T::of(2.0) * (p - start));
        add_compensated(self.position, moves, position);
        add_compensated(self.momentum, kicks, momentum);
        copy(velocity, momentum);
        let (mass, pivots) = (parts_mut(room.matrix, n * n).0, parts_mut(pivots, n).0);
        copy(mass, room.mass);
        factor(mass, pivots).map_err(|Singular| StepError::SingularJacobian)?;
        substitute(mass, pivots, velocity);
        room.next = next;
        if all_finite(room.next) { Ok(()) } else { Err(StepError::NotFinite) }
    }

    /// Why the equations have no solution: because of the mass where the step would end, or what was found.
    pub(super) fn reason(&mut self, error: StepError, room: &mut Buffers<'_, T>) -> StepError {
        if self.velocity.is_none() {
            return error;
        }
        let (end, velocity) = (core::mem::take(&mut room.end), core::mem::take(&mut room.end_velocity));
        let last = Instant { time: self.time + self.length, approach: Approach::FromLeft };
        let of_mass = if all_finite(end) { self.check_mass((end, velocity, last), room) } else { Ok(()) };
        of_mass.err().unwrap_or(error)
    }

    /// Refuses a mass at the end of the step that is not positive definite where the constraints let it move.
    fn check_mass(
        &mut self,
        (position, velocity, instant): (&[T], &[T], Instant<T>),
        room: &mut Buffers<'_, T>,
    ) -> Result<(), StepError> {
        let Shape { n, m, .. } = self.shape;
        let parts = [&mut *room.mass, room.coupling, room.stiffness, room.resistance];
        self.second_at((instant, position, velocity), parts);
        let found = not_definite((room.mass, room.end_constraints), [n, m], (room.matrix, room.moved));
        found.map_or(Ok(()), |found| Err(found.into()))
    }

    /// Writes the tangent of the path at the unknowns to the residual, in the direction of the one before.
    fn turn(&mut self, room: &mut Buffers<'_, T>, pivots: &mut [usize]) -> Result<(), StepError> {
        self.linearise(Row::Along(T::zero()), room);
        room.residual.fill(T::zero());
        put_last(room.residual, T::one());
        factor(room.matrix, pivots).map_err(|Singular| StepError::SingularJacobian)?;
        substitute(room.matrix, pivots, room.residual);
        let scale = self.scale(room.before);
        let size = scaled_dot(room.residual, room.residual, self.shape.n, scale).sqrt();
        if !(size > T::zero() && all_finite(room.residual)) {
            return Err(StepError::SingularJacobian);
        }
        room.residual.iter_mut().for_each(|number| *number /= size);
        Ok(())
    }

    /// Weights of V, of μ and of θ in distances.
    fn scale(&self, point: &[T]) -> [T; 3] {
        let (velocities, rest) = (from(point, 0, self.shape.n), from(point, self.shape.n, self.shape.m));
        let weight = |size: T| T::one() / (size * size);
        let velocity = scale_of(velocities, self.position, self.length);
        // At rest at the origin there is nothing to compare with.
        let velocity = if velocity < T::SMALLEST_NORMAL.sqrt() { T::one() } else { velocity };
        [weight(velocity), weight(T::one() + size_of(rest)), T::one()]
    }

    fn newton(
        &mut self,
        row: Row<T>,
        most: u32,
        room: &mut Buffers<'_, T>,
        pivots: &mut [usize],
    ) -> Result<u32, StepError> {
        let n = self.shape.n;
        let [close, near] = [T::of(450.0) * T::EPSILON, T::of(5e5) * T::EPSILON];
        let mut last = T::max_value().unwrap_or(T::one());
        for count in 1..=most {
            self.linearise(row, room);
            self.write_last_equation(row, room);
            if !(all_finite(room.residual) && all_finite(room.matrix)) {
                return Err(StepError::NotFinite);
            }
            factor(room.matrix, pivots).map_err(|Singular| StepError::SingularJacobian)?;
            substitute(room.matrix, pivots, room.residual);
            if !all_finite(room.residual) {
                return Err(StepError::SingularJacobian);
            }
            room.unknowns.iter_mut().zip(&*room.residual).for_each(|(place, &change)| *place -= change);
            let correction = size_of(from(room.residual, 0, n));
            let scale = scale_of(from(room.unknowns, 0, n), self.position, self.length);
            // What rounding leaves of a difference of heights is divided by the way.
            let way = size_of(room.rise) + self.length * correction;
            let is_rounding = correction < near * scale || correction * way < T::of(8.0) * T::EPSILON * scale;
            let stalls = correction >= T::of(0.3) * last && is_rounding;
            if correction < close * scale || stalls {
                self.evaluate(room);
                if !all_finite(room.residual) {
                    return Err(StepError::NotFinite);
                }
                if !(is_steep(self.length, [&*room.resistance, &*room.mass]) && self.is_unbalanced(room)) {
                    return Ok(count);
                }
            }
            last = correction;
        }
        self.evaluate(room);
        Err(StepError::NotConverged { iterations: most, residual: size_of(room.residual).to_f64() })
    }

    /// Writes the last equation to the residual.
    fn write_last_equation(&self, row: Row<T>, room: &mut Buffers<'_, T>) {
        let left = match row {
            Row::Share(share) => last_of(room.unknowns) - share,
            Row::Along(distance) => {
                let places = room.moved.iter_mut().zip(room.unknowns.iter().zip(&*room.before));
                places.for_each(|(place, (&now, &before))| *place = now - before);
                let scale = self.scale(room.before);
                scaled_dot(room.moved, room.tangent, self.shape.n, scale) - distance
            }
        };
        put_last(room.residual, left);
    }

    /// The instant in the middle of the share of the step.
    fn instant(&self, share: T) -> Instant<T> {
        Instant::in_step(self.time, T::of(0.5), share * self.length)
    }

    /// Writes positions, forces, constraints and the residual for the unknowns.
    fn evaluate(&mut self, room: &mut Buffers<'_, T>) {
        let Shape { n, m, .. } = self.shape;
        let share = last_of(room.unknowns);
        let length = share * self.length;
        let velocity = from(room.unknowns, 0, n);
        for (index, (&v, &q)) in velocity.iter().zip(self.position).enumerate() {
            let rise = length * v;
            put(room.rise, index, rise);
            put(room.end, index, q + rise);
            put(room.middle, index, q + T::of(0.5) * rise);
        }
        self.system.elongate(room.middle, room.jacobian);
        for (place, rate) in room.rates.iter_mut().zip(product(room.jacobian, velocity)) {
            *place = rate;
        }
        for (row, (place, &known)) in room.tensions.iter_mut().zip(&*room.known).enumerate() {
            let pulls = room.rates.iter().enumerate();
            let own = |(column, &rate): (usize, &T)| self.dampers.leading([row, column], [0, 0]) * rate;
            *place = pulls.map(own).fold(known, |sum, pull| sum + pull);
        }
        let instant = self.instant(share);
        self.system.first(instant, room.middle, velocity, room.momentum, room.force);
        if let Some(before) = self.velocity {
            self.polarise(before, room);
        }
        room.force.iter_mut().zip(self.input).for_each(|(force, &input)| *force += input);
        add_transposed(-T::one(), room.jacobian, room.tensions, room.force);
        let steep = if self.velocity.is_some() { -self.remains(room) } else { self.correct_gradient(room) };
        room.force.iter_mut().zip(&*room.rise).for_each(|(force, &rise)| *force -= steep * rise);
        // p₁ − p₀ is 2(MV − p₀) with a constant mass.
        let twice = if self.velocity.is_some() { T::one() } else { T::of(2.0) };
        let momenta = room.momentum.iter().zip(self.momentum).zip(&*room.force);
        for (place, ((&p, &start), &force)) in room.residual.iter_mut().zip(momenta) {
            *place = twice * (p - start) - length * force;
        }
        if m == 0 {
            return;
        }
        self.constrain(room);
        let (velocity, multipliers) = (from(room.unknowns, 0, n), from(room.unknowns, n, m));
        let (kicks, rows) = parts_mut(room.residual, n);
        add_transposed(T::one(), room.constraints, multipliers, kicks);
        let off = product(room.constraints, velocity).zip(&*room.values);
        let whole = share == T::one();
        for (place, ((rate, &start), &end)) in rows.iter_mut().zip(off.zip(&*room.end_values)) {
            *place = if whole { end / self.length } else { rate + share * start / self.length };
        }
    }

    /// r of the potential.
    fn correct_gradient(&mut self, room: &mut Buffers<'_, T>) -> T {
        let start = self.system.potential(self.position, room.slope, None);
        let end = self.system.potential(room.end, room.end_slope, None);
        let (Some(start), Some(end)) = (start, end) else { return T::zero() };
        self.system.potential(room.middle, room.slope, None);
        copy(room.heights, &[start, end]);
        remainder([start, end, dot(room.slope, room.rise)], dot(room.rise, room.rise))
    }

    /// Writes v₁, L_v(q₁, v₁), Λ at both ends, and ∂Λ/∂q + F in the middle in place of L_q + F.
    fn polarise(&mut self, before: &[T], room: &mut Buffers<'_, T>) {
        let n = self.shape.n;
        let velocity = from(room.unknowns, 0, n);
        let ends = room.end_velocity.iter_mut().zip(velocity.iter().zip(before));
        ends.for_each(|(place, (&v, &start))| *place = v + (v - start));
        let (end_velocity, unknown) = (&*room.end_velocity, [T::of(f64::NAN); 2]);
        let still = self.system.polarised(room.middle, [velocity, velocity], room.slope, None);
        room.force.iter_mut().zip(&*room.slope).for_each(|(force, &slope)| *force -= slope);
        let both = [before, end_velocity];
        let [start, size] = self.system.polarised(self.position, both, room.slope, None).unwrap_or(unknown);
        let [end, end_size] = self.system.polarised(room.end, both, room.end_slope, None).unwrap_or(unknown);
        self.system.polarised(room.middle, both, room.slope, None);
        room.force.iter_mut().zip(&*room.slope).for_each(|(force, &slope)| *force += slope);
        let size = if still.is_some() { size + end_size } else { T::of(f64::NAN) };
        copy(room.heights, &[start, end, size]);
        let last = Instant::in_step(self.time, T::one(), last_of(room.unknowns) * self.length);
        self.system.first(last, room.end, end_velocity, room.momentum, room.spare);
    }

    /// r of Λ.
    fn remains(&self, room: &Buffers<'_, T>) -> T {
        let [start, end, size] = [0, 1, 2].map(|index| at(room.heights, index));
        remainder_of([start, end, dot(room.slope, room.rise)], size, dot(room.rise, room.rise))
    }

    /// Writes c at both ends, C̄, and its r.
    fn constrain(&mut self, room: &mut Buffers<'_, T>) {
        let n = self.shape.n;
        self.system.constrain(self.position, room.values, room.constraints);
        self.system.constrain(room.end, room.end_values, room.end_constraints);
        // Values in the middle are not needed.
        self.system.constrain(room.middle, room.weights, room.constraints);
        let square = dot(room.rise, room.rise);
        let ends = room.values.iter().zip(&*room.end_values);
        let rows = room.constraints.chunks_exact_mut(n.max(1)).zip(room.weights.iter_mut());
        for ((row, weight), (&start, &end)) in rows.zip(ends) {
            // A constraint is near zero between terms that are not.
            let of_terms = row.iter().zip(&*room.end).fold(T::zero(), |sum, (c, q)| sum + (*c * *q).abs());
            let size = start.abs() + end.abs() + of_terms;
            *weight = remainder_of([start, end, dot(row, room.rise)], size, square);
            row.iter_mut().zip(&*room.rise).for_each(|(place, &rise)| *place += *weight * rise);
        }
    }

    /// Evaluates the equations and writes their matrix.
    fn linearise(&mut self, row: Row<T>, room: &mut Buffers<'_, T>) {
        let u = self.shape.n + self.shape.m;
        room.matrix.fill(T::zero());
        match row {
            Row::Share(_) => self.evaluate(room),
            Row::Along(_) => {
                // ∂/∂θ by a difference: it only says where to look for the path.
                let (share, small) = (last_of(room.unknowns), T::EPSILON.sqrt());
                put_last(room.unknowns, share + small);
                self.evaluate(room);
                copy(room.moved, room.residual);
                put_last(room.unknowns, share);
                self.evaluate(room);
                let rows = room.matrix.chunks_exact_mut(u + 1).zip(room.moved.iter().zip(&*room.residual));
                rows.take(u).for_each(|(row, (&moved, &here))| put_last(row, (moved - here) / small));
            }
        }
        self.differentiate(room);
        let Some(place) = room.matrix.chunks_exact_mut(u + 1).last() else { return };
        match row {
            Row::Share(_) => put_last(place, T::one()),
            Row::Along(_) => {
                let weights = self.scale(room.before);
                copy(place, room.tangent);
                let n = self.shape.n;
                place
                    .iter_mut()
                    .enumerate()
                    .for_each(|(index, entry)| *entry *= weight_at(index, n, u, weights));
            }
        }
    }

    /// Writes the derivatives with respect to V and μ.
    fn differentiate(&mut self, room: &mut Buffers<'_, T>) {
        let Shape { n, m, e, .. } = self.shape;
        let u = n + m;
        let share = last_of(room.unknowns);
        let (length, half) = (share * self.length, T::of(0.5));
        let instant = self.instant(share);
        let velocity = from(room.unknowns, 0, n);
        let parts = Second {
            mass: room.mass,
            coupling: room.coupling,
            stiffness: room.stiffness,
            resistance: room.resistance,
        };
        if let Some(slopes) = self.stiffened {
            copy(room.moved, velocity);
            Stiffened::move_aside(part_mut(room.moved, n), slopes.aside);
            self.system.second(instant, room.middle, from(room.moved, 0, n), parts);
            room.resistance.iter_mut().for_each(|slope| *slope *= slopes.factor);
        } else {
            self.system.second(instant, room.middle, velocity, parts);
        }
        self.system.turn(room.middle, velocity, room.tensions, room.turning, room.stiffness);
        // Σ_j Z₀ (G + ½θh Vᵀ∂²g), Ḡᵀ of it.
        room.pull.fill(T::zero());
        for (row, column) in (0..e).flat_map(|row| (0..e).map(move |column| (row, column))) {
            let weight = self.dampers.leading([row, column], [0, 0]);
            let along = from(room.jacobian, row * n, n);
            let (own, turned) = (from(room.jacobian, column * n, n), from(room.turning, column * n, n));
            for (place, &g) in room.pull.chunks_exact_mut(n.max(1)).zip(along) {
                let entries = place.iter_mut().zip(own.iter().zip(turned));
                entries.for_each(|(place, (&own, &turned))| {
                    *place += weight * g * (own + half * length * turned);
                });
            }
        }
        for (row, line) in room.matrix.chunks_exact_mut(u + 1).take(n).enumerate() {
            for (column, place) in line.iter_mut().take(n).enumerate() {
                let entry = row * n + column;
                let stiffness = half * length * at(room.stiffness, entry);
                *place = T::of(2.0) * at(room.mass, entry)
                    - length * (stiffness + at(room.resistance, entry))
                    + length * at(room.pull, entry);
            }
        }
        match self.velocity {
            Some(before) => self.differentiate_polarised(before, room, length),
            None => self.differentiate_gradient(room, length),
        }
        self.differentiate_constraints(room, length);
    }

    /// Replaces 2M − θh(…) in the middle by the derivatives of L_v(q₁, v₁) − θh (∇̄Λ + F); the room holds the
    /// mass and the coupling in the middle.
    fn differentiate_polarised(&mut self, before: &[T], room: &mut Buffers<'_, T>, length: T) {
        let Shape { n, m, .. } = self.shape;
        let (half, u, share) = (T::of(0.5) * length, n + m, last_of(room.unknowns));
        let velocity = from(room.unknowns, 0, n);
        let (end_velocity, instant) = (&*room.end_velocity, self.instant(share));
        let last = Instant::in_step(self.time, T::one(), share * self.length);
        add_square(-T::of(2.0), room.mass, false, (room.matrix, u));
        // What ∂(L_q + F)/∂q and ∂(L_q + F)/∂v have beyond the derivatives of F.
        add_square(length, room.coupling, true, (room.matrix, u));
        self.system.polarised(room.middle, [velocity, velocity], room.slope, Some(room.bend));
        add_square(length * half, room.bend, false, (room.matrix, u));
        let both = [before, end_velocity];
        self.system.polarised(room.middle, both, room.slope, Some(room.bend));
        add_square(-length * half, room.bend, false, (room.matrix, u));
        // ∂²Λ/∂q∂v₁ is half of ∂L_v/∂q at v₀, transposed, and ∂v₁/∂V is 2.
        let parts = [&mut *room.mass, room.coupling, room.stiffness, room.resistance];
        self.second_at((instant, room.middle, before), parts);
        add_square(-length, room.coupling, true, (room.matrix, u));
        self.differentiate_remainder((last, before), room, length);
        let end = (last, &*room.end, &*room.end_velocity);
        self.second_at(end, [&mut *room.mass, room.coupling, room.stiffness, room.resistance]);
        add_square(T::of(2.0), room.mass, false, (room.matrix, u));
        add_square(length, room.coupling, false, (room.matrix, u));
    }

    /// Adds −θh ∂(r d)/∂V of Λ, d = q₁ − q₀; the room holds ∂L_v/∂q in the middle at v₀.
    fn differentiate_remainder(
        &mut self,
        (last, before): (Instant<T>, &[T]),
        room: &mut Buffers<'_, T>,
        length: T,
    ) {
        let Shape { n, m, .. } = self.shape;
        let (square, r) = (dot(room.rise, room.rise), self.remains(room));
        // ∂r/∂v₁ is half of this over |d|².
        self.system.first(last, room.end, before, room.carried_on, room.spare);
        let turned = product(room.coupling, room.rise);
        let ends = room.spare.iter_mut().zip(turned).zip(room.carried_on.iter().zip(self.momentum));
        for ((place, turned), (&end, &start)) in ends {
            let left = (end - start) - turned;
            let lost = T::of(8.0) * T::EPSILON * (end.abs() + start.abs() + turned.abs());
            *place = if left.abs() <= lost || square == T::zero() { T::zero() } else { left / square };
        }
        for (line, &rise) in room.matrix.chunks_exact_mut(n + m + 1).zip(&*room.rise) {
            let places = line.iter_mut().zip(&*room.spare);
            places.for_each(|(place, &slope)| *place -= length * rise * slope);
        }
        add_correction(
            (-length * length, n, m, r, square),
            (&*room.end_slope, &*room.slope, &*room.bend),
            (room.rise, room.matrix),
        );
    }

    /// Writes the second derivatives of L at a point.
    fn second_at(
        &mut self,
        (instant, position, velocity): (Instant<T>, &[T], &[T]),
        [mass, coupling, stiffness, resistance]: [&mut [T]; 4],
    ) {
        self.system.second(instant, position, velocity, Second { mass, coupling, stiffness, resistance });
    }

    /// Adds θh ∂(r d)/∂V of the potential, d = q₁ − q₀, whose values the equations were evaluated with.
    fn differentiate_gradient(&mut self, room: &mut Buffers<'_, T>, length: T) {
        let n = self.shape.n;
        self.system.potential(room.middle, room.slope, Some(room.bend));
        let [start, end] = [at(room.heights, 0), at(room.heights, 1)];
        let square = dot(room.rise, room.rise);
        let r = remainder([start, end, dot(room.slope, room.rise)], square);
        add_correction(
            (length * length, n, self.shape.m, r, square),
            (&*room.end_slope, &*room.slope, &*room.bend),
            (room.rise, room.matrix),
        );
    }

    /// Adds the constraints' part: ∂(C̄ᵀμ)/∂V, C̄ᵀ, and ∂(C̄V)/∂V = C(q₁).
    fn differentiate_constraints(&mut self, room: &mut Buffers<'_, T>, length: T) {
        let Shape { n, m, .. } = self.shape;
        if m == 0 {
            return;
        }
        let (u, half) = (n + m, T::of(0.5));
        let square = dot(room.rise, room.rise);
        let (matrix, rows) = parts_mut(room.matrix, n * (u + 1));
        for index in 0..m {
            let multiplier = at(room.unknowns, n + index);
            // 1 at the constraint, for its second derivatives alone.
            room.values.fill(T::zero());
            put(room.values, index, T::one());
            room.bend.fill(T::zero());
            self.system.add_constraint_curvature(room.middle, room.values, T::one(), room.bend);
            let r = at(room.weights, index);
            // The gradient in the middle, without its correction.
            copy(room.slope, from(room.constraints, index * n, n));
            room.slope.iter_mut().zip(&*room.rise).for_each(|(place, &rise)| *place -= r * rise);
            for (line, bend) in matrix.chunks_exact_mut(u + 1).zip(room.bend.chunks_exact(n.max(1))) {
                let places = line.iter_mut().zip(bend);
                places.for_each(|(place, &bend)| *place += half * length * multiplier * bend);
            }
            add_correction(
                (length * multiplier, n, m, r, square),
                (from(room.end_constraints, index * n, n), &*room.slope, &*room.bend),
                (room.rise, matrix),
            );
            let mean = from(room.constraints, index * n, n);
            for (line, &c) in matrix.chunks_exact_mut(u + 1).zip(mean) {
                put(line, n + index, c);
            }
            let end = from(room.end_constraints, index * n, n);
            if let Some(line) = rows.chunks_exact_mut(u + 1).nth(index) {
                copy(line, end);
            }
        }
    }
}

/// Adds a multiple of an n×n matrix, or of its transpose, to the first rows and columns of one of u + 1
/// columns.
fn add_square<T: Real>(factor: T, square: &[T], is_transposed: bool, (matrix, u): (&mut [T], usize)) {
    let n = square.len().isqrt();
    for (row, line) in matrix.chunks_exact_mut(u + 1).take(n).enumerate() {
        for (column, place) in line.iter_mut().take(n).enumerate() {
            let entry = if is_transposed { column * n + row } else { row * n + column };
            *place += factor * at(square, entry);
        }
    }
}

/// Adds `factor` ∂(r d)/∂q₁ of a function φ to the first n rows of a matrix of n + m + 1 columns,
///
/// ```text
/// ∂(r d) = r I + d ⊗ ([∇φ(q₁) − ∇φ(q̄) − ½ ∂²φ(q̄) d] − 2 r d)/|d|² .
/// ```
fn add_correction<T: Real>(
    (factor, n, m, r, square): (T, usize, usize, T, T),
    (end, middle, bend): (&[T], &[T], &[T]),
    (rise, matrix): (&[T], &mut [T]),
) {
    if square == T::zero() {
        return;
    }
    let bent = product(bend, rise);
    let slopes = end.iter().zip(middle).zip(bent).zip(rise);
    for (column, (((&end, &middle), bent), &along)) in slopes.enumerate() {
        // Below rounding nothing is left of the difference.
        let difference = end - middle - T::of(0.5) * bent;
        let lost = T::of(8.0) * T::EPSILON * (end.abs() + middle.abs());
        let steep = if difference.abs() <= lost { T::zero() } else { difference };
        let slope = (steep - T::of(2.0) * r * along) / square;
        for (row, (line, &rise)) in matrix.chunks_exact_mut(n + m + 1).zip(rise).enumerate() {
            let own = if row == column { r } else { T::zero() };
            line.iter_mut().skip(column).take(1).for_each(|place| *place += factor * (own + rise * slope));
        }
    }
}

/// (φ(q₁) − φ(q₀) − ∇φ(q̄)·d)/|d|², and 0 where rounding is all of it.
fn remainder<T: Real>([start, end, along]: [T; 3], square: T) -> T {
    remainder_of([start, end, along], start.abs() + end.abs(), square)
}

/// The same of values that are sums of numbers of this size.
fn remainder_of<T: Real>([start, end, along]: [T; 3], size: T, square: T) -> T {
    let left = (end - start) - along;
    let lost = T::of(4.0) * T::EPSILON * (size + along.abs());
    if left.abs() <= lost || square == T::zero() { T::zero() } else { left / square }
}

/// The product of two points in a metric.
fn scaled_dot<T: Real>(a: &[T], b: &[T], n: usize, weights: [T; 3]) -> T {
    let u = a.len().saturating_sub(1);
    let products = a.iter().zip(b).enumerate();
    products.fold(T::zero(), |sum, (index, (&a, &b))| sum + weight_at(index, n, u, weights) * a * b)
}

fn size_of<T: Real>(numbers: &[T]) -> T {
    numbers.iter().fold(T::zero(), |most, x| max_or_nan(most, x.abs()))
}

fn put_last<T>(numbers: &mut [T], number: T) {
    if let Some(place) = numbers.last_mut() {
        *place = number;
    }
}

fn last_of<T: Real>(numbers: &[T]) -> T {
    at(numbers, numbers.len().saturating_sub(1))
}

fn weight_at<T: Real>(index: usize, n: usize, u: usize, [of_velocity, of_impulse, of_share]: [T; 3]) -> T {
    match index {
        index if index < n => of_velocity,
        index if index < u => of_impulse,
        _ => of_share,
    }
}
