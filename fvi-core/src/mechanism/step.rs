//! The equations of a step of the Gauss–Lobatto method, and Newton's method for them.

use crate::linear::{Singular, all_finite, at, factor, substitute};
use crate::mechanism::gauss_lobatto::GaussLobatto;
use crate::mechanism::lagrangian::{Dampers, Lagrangian, Second};
use crate::newton::{Stiffened, Stiffening, is_steep, is_unbalanced};
use crate::real::{Real, max_or_nan};
use crate::scheme::StepError;
use crate::space::{part, part_from, parts_mut};
use crate::system::Instant;

/// Largest number of corrections; a well-posed step needs three to five.
const MOST_CORRECTIONS: u32 = 40;

/// Numbers of stages s, coordinates N, constraints M and elongations E.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub(super) s: usize,
    pub(super) n: usize,
    pub(super) m: usize,
    pub(super) e: usize,
}

impl Shape {
    /// Number of unknowns: V_1 … V_s and Λ_0 … Λ_{s−1}.
    pub(super) const fn unknowns(self) -> usize {
        self.s * (self.n + self.m)
    }

    /// Numbers of work of a step.
    pub(super) const fn work(self) -> usize {
        let Self { s, n, m, e } = self;
        let u = self.unknowns();
        let vectors = 3 * s * n + 3 * s * e + 7 * n + m;
        let jacobians = 2 * s * e * n + (s + 1) * m * n;
        let squares = (4 * s + s * s + 1) * n * n;
        vectors + jacobians + squares + u * (u + 2)
    }
}

/// Work arrays of a step.
pub(super) struct StepBuffers<'a, T> {
    /// V and Λ, the unknowns.
    pub(super) unknowns: &'a mut [T],
    /// Q, L_v and L_q + F − Gᵀf at the nodes.
    pub(super) positions: &'a mut [T],
    pub(super) momenta: &'a mut [T],
    pub(super) forces: &'a mut [T],
    /// Known part of the dampers' forces and W, elongation by elongation; the forces, node by node.
    pub(super) known: &'a mut [T],
    pub(super) rates: &'a mut [T],
    pub(super) tensions: &'a mut [T],
    /// G and vᵀ∂²g at the nodes.
    pub(super) jacobians: &'a mut [T],
    pub(super) turning: &'a mut [T],
    /// L_vv, ∂L_v/∂q, ∂(L_q + F)/∂q, ∂(L_q + F)/∂v at the nodes.
    pub(super) mass: &'a mut [T],
    pub(super) coupling: &'a mut [T],
    pub(super) stiffness: &'a mut [T],
    pub(super) resistance: &'a mut [T],
    /// dY_i/dV_l.
    slopes: &'a mut [T],
    /// C at the knots.
    pub(super) constraints: &'a mut [T],
    pub(super) values: &'a mut [T],
    pub(super) point: &'a mut [T],
    pub(super) vector: &'a mut [T],
    /// Position, momentum, their rounding errors, and velocity at the end of the step.
    pub(super) next: &'a mut [T],
    /// Σ_k λ_k ∂²c_k of a knot.
    pub(super) curvature: &'a mut [T],
    pub(super) residual: &'a mut [T],
    pub(super) matrix: &'a mut [T],
}

impl<'a, T: Real> StepBuffers<'a, T> {
    /// The arrays in a buffer of [`Shape::work`] numbers.
    pub(super) fn new(shape: Shape, mut buffer: &'a mut [T]) -> Self {
        let Shape { s, n, m, e } = shape;
        let u = shape.unknowns();
        let mut take = |count: usize| {
            let (part, rest) = parts_mut(core::mem::take(&mut buffer), count);
            buffer = rest;
            part
        };
        Self {
            unknowns: take(u),
            positions: take(s * n),
            momenta: take(s * n),
            forces: take(s * n),
            known: take(s * e),
            rates: take(s * e),
            tensions: take(s * e),
            jacobians: take(s * e * n),
            turning: take(s * e * n),
            mass: take(s * n * n),
            coupling: take(s * n * n),
            stiffness: take(s * n * n),
            resistance: take(s * n * n),
            slopes: take(s * s * n * n),
            constraints: take((s + 1) * m * n),
            values: take(m),
            point: take(n),
            vector: take(n),
            next: take(5 * n),
            curvature: take(n * n),
            residual: take(u),
            matrix: take(u * u),
        }
    }
}

/// Vector `index` of vectors of `width` numbers.
fn vector<T>(numbers: &[T], width: usize, index: usize) -> &[T] {
    from(numbers, index * width, width)
}

fn vector_mut<T>(numbers: &mut [T], width: usize, index: usize) -> &mut [T] {
    from_mut(numbers, index * width, width)
}

/// Writes numbers to places; those that are more than the other are left out.
pub(super) fn copy<T: Copy>(places: &mut [T], numbers: &[T]) {
    places.iter_mut().zip(numbers).for_each(|(place, &number)| *place = number);
}

/// `count` numbers from `start` on.
pub(super) fn from<T>(numbers: &[T], start: usize, count: usize) -> &[T] {
    part(part_from(numbers, start), count)
}

fn from_mut<T>(numbers: &mut [T], start: usize, count: usize) -> &mut [T] {
    let (_, rest) = parts_mut(numbers, start);
    parts_mut(rest, count).0
}

pub(super) fn put<T>(numbers: &mut [T], index: usize, number: T) {
    if let Some(place) = numbers.get_mut(index) {
        *place = number;
    }
}

/// out += factor · Bᵀ x, for B of as many rows as x has numbers.
pub(super) fn add_transposed<T: Real>(factor: T, matrix: &[T], x: &[T], out: &mut [T]) {
    let width = out.len().max(1);
    for (row, &x) in matrix.chunks_exact(width).zip(x) {
        out.iter_mut().zip(row).for_each(|(out, &entry)| *out += factor * entry * x);
    }
}

/// `next` ← start + change, and `change` ← what the sum lost to rounding.
pub(super) fn add_compensated<T: Real>(start: &[T], change: &mut [T], next: &mut [T]) {
    for ((next, &start), change) in next.iter_mut().zip(start).zip(change) {
        *next = start + *change;
        *change -= *next - start;
    }
}

/// a · b.
pub(super) fn dot<T: Real>(a: &[T], b: &[T]) -> T {
    a.iter().zip(b).fold(T::zero(), |sum, (&a, &b)| sum + a * b)
}

/// B x, number by number.
pub(super) fn product<'a, T: Real>(matrix: &'a [T], x: &'a [T]) -> impl Iterator<Item = T> + 'a {
    let rows = matrix.chunks_exact(x.len().max(1));
    rows.map(move |row| row.iter().zip(x).fold(T::zero(), |sum, (&b, &x)| sum + b * x))
}

/// Share of |q|/h, the rounding of positions over a step, in what corrections are compared with.
const OF_POSITION: f64 = 0.01;

/// What corrections of velocities are compared with: the velocities, and |q|/h, with whose rounding positions
/// move. It is a velocity, so that a system is the same in any units.
pub(super) fn scale_of<T: Real>(velocities: &[T], position: &[T], length: T) -> T {
    let size = |numbers: &[T]| numbers.iter().fold(T::zero(), |most, x| max_or_nan(most, x.abs()));
    size(velocities) + T::of(OF_POSITION) * size(position) / length + T::SMALLEST_NORMAL / T::EPSILON
}

/// The equations of one step from (q₀, p₀) at a time, of length h.
pub(super) struct Equations<'a, T, L, D> {
    pub(super) rule: &'a GaussLobatto<T>,
    pub(super) shape: Shape,
    pub(super) system: &'a mut L,
    pub(super) dampers: &'a D,
    pub(super) time: T,
    pub(super) length: T,
    pub(super) position: &'a [T],
    pub(super) momentum: &'a [T],
    /// A force held over the step; missing numbers are zero.
    pub(super) input: &'a [T],
    /// How the derivatives of forces with respect to velocities enter the matrix, if it is stiffened.
    pub(super) stiffened: Option<Stiffened<T>>,
}

impl<T: Real, L: Lagrangian<T>, D: Dampers<T>> Equations<'_, T, L, D> {
    /// Solves for V and Λ, which hold a first guess, by Newton's method; the arrays of the room are then
    /// those of the solution. Returns the number of corrections.
    pub(super) fn solve(
        &mut self,
        room: &mut StepBuffers<'_, T>,
        pivots: &mut [usize],
    ) -> Result<u32, StepError> {
        let velocities = self.shape.s * self.shape.n;
        let [close, near] = [T::of(450.0) * T::EPSILON, T::of(5e5) * T::EPSILON];
        let mut last = T::max_value().unwrap_or(T::one());
        for count in 1..=MOST_CORRECTIONS {
            self.evaluate(room);
            self.linearise(room);
            if !(all_finite(room.residual) && all_finite(room.matrix)) {
                return Err(StepError::NotFinite);
            }
            factor(room.matrix, pivots).map_err(|Singular| StepError::SingularJacobian)?;
            substitute(room.matrix, pivots, room.residual);
            if !all_finite(room.residual) {
                return Err(StepError::SingularJacobian);
            }
            self.correct(room);
            let size = |numbers: &[T]| numbers.iter().fold(T::zero(), |most, x| max_or_nan(most, x.abs()));
            let correction = size(part(room.residual, velocities));
            let scale = scale_of(part(room.unknowns, velocities), self.position, self.length);
            let stalls = correction >= T::of(0.3) * last && correction < near * scale;
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
        self.solve_stiffened(room, pivots)
    }

    /// True if forces with steep slopes are not in balance at the unknowns that were evaluated last.
    fn is_unbalanced(&mut self, room: &mut StepBuffers<'_, T>) -> bool {
        let velocities = self.shape.s * self.shape.n;
        self.linearise(room);
        let [residual, velocity] = [&*room.residual, &*room.unknowns].map(|all| part(all, velocities));
        is_unbalanced(self.shape.n, residual, self.length, [&*room.resistance, &*room.mass], velocity)
    }

    /// As [`solve`](Self::solve), by the iteration of [`Stiffening`], from velocities of zero.
    fn solve_stiffened(
        &mut self,
        room: &mut StepBuffers<'_, T>,
        pivots: &mut [usize],
    ) -> Result<u32, StepError> {
        let velocities = self.shape.s * self.shape.n;
        let size = |numbers: &[T]| numbers.iter().fold(T::zero(), |most, x| max_or_nan(most, x.abs()));
        room.unknowns.fill(T::zero());
        self.evaluate(room);
        let mut iteration = Stiffening::new();
        loop {
            self.stiffened = Some(iteration.slopes);
            self.linearise(room);
            let residual = size(room.residual);
            if !(residual.is_finite() && all_finite(room.matrix)) {
                return Err(StepError::NotFinite);
            }
            if factor(room.matrix, pivots).is_err() {
                if iteration.widen() {
                    continue;
                }
                return Err(StepError::SingularJacobian);
            }
            substitute(room.matrix, pivots, room.residual);
            if !all_finite(room.residual) {
                return Err(StepError::SingularJacobian);
            }
            self.correct(room);
            let extent = size(part(room.unknowns, velocities));
            let change = size(part(room.residual, velocities));
            let scale = scale_of(part(room.unknowns, velocities), self.position, self.length);
            let rounding = T::of(2.0) * T::EPSILON * scale;
            self.evaluate(room);
            if iteration.judge(residual, change, (rounding, extent))? {
                if !all_finite(room.residual) {
                    return Err(StepError::NotFinite);
                }
                self.balance(room, pivots)?;
                return Ok(MOST_CORRECTIONS + iteration.count);
            }
        }
    }

    /// Changes the forces at the nodes by the rest that the equations need: where a velocity is 0 as far as
    /// numbers tell it, what holds it is known by that alone. h Σ_j a_ij δF_j is the residual of node i.
    fn balance(&self, room: &mut StepBuffers<'_, T>, pivots: &mut [usize]) -> Result<(), StepError> {
        let Shape { s, n, .. } = self.shape;
        let (rule, needed) = (parts_mut(room.slopes, s * s).0, parts_mut(room.matrix, s).0);
        let pivots = parts_mut(pivots, s).0;
        let nodes = (0..s).flat_map(|i| (0..s).map(move |j| (i, j)));
        rule.iter_mut().zip(nodes).for_each(|(place, (i, j))| *place = self.length * self.rule.matrix(i, j));
        factor(rule, pivots).map_err(|Singular| StepError::SingularJacobian)?;
        for coordinate in 0..n {
            let of_node = |i: usize| at(room.residual, i * n + coordinate);
            needed.iter_mut().enumerate().for_each(|(i, place)| *place = of_node(i));
            substitute(rule, pivots, needed);
            for (j, &force) in needed.iter().enumerate() {
                let place = j * n + coordinate;
                put(room.forces, place, at(room.forces, place) + force);
            }
        }
        Ok(())
    }

    /// Subtracts the solution; multipliers are solved for in units of 1/h.
    fn correct(&self, room: &mut StepBuffers<'_, T>) {
        let velocities = self.shape.s * self.shape.n;
        for (index, (unknown, &change)) in room.unknowns.iter_mut().zip(&*room.residual).enumerate() {
            *unknown -= if index < velocities { change } else { change / self.length };
        }
    }

    /// Instant of node i.
    fn instant(&self, i: usize) -> Instant<T> {
        Instant::in_step(self.time, self.rule.node(i), self.length)
    }

    /// Writes positions, momenta, forces and the residual for the unknowns.
    fn evaluate(&mut self, room: &mut StepBuffers<'_, T>) {
        let Shape { s, n, e, .. } = self.shape;
        let h = self.length;
        for i in 0..s {
            let place = vector_mut(room.positions, n, i);
            place.iter_mut().zip(self.position).for_each(|(place, &q)| *place = q);
            for j in 0..s {
                let factor = h * self.rule.matrix(i, j);
                let moved = place.iter_mut().zip(vector(room.unknowns, n, j));
                moved.for_each(|(place, &velocity)| *place += factor * velocity);
            }
            let jacobian = vector_mut(room.jacobians, e * n, i);
            self.system.elongate(place, jacobian);
            for (index, rate) in product(jacobian, vector(room.unknowns, n, i)).enumerate() {
                put(room.rates, index * s + i, rate);
            }
        }
        self.pull(room);
        for i in 0..s {
            let (position, velocity) = (vector(room.positions, n, i), vector(room.unknowns, n, i));
            let (momentum, force) = (vector_mut(room.momenta, n, i), vector_mut(room.forces, n, i));
            self.system.first(self.instant(i), position, velocity, momentum, force);
            force.iter_mut().zip(self.input).for_each(|(force, &input)| *force += input);
            let (jacobian, tensions) = (vector(room.jacobians, e * n, i), vector(room.tensions, e, i));
            add_transposed(-T::one(), jacobian, tensions, force);
        }
        for i in 0..s {
            let residual = vector_mut(room.residual, n, i);
            let momenta = vector(room.momenta, n, i).iter().zip(self.momentum);
            residual.iter_mut().zip(momenta).for_each(|(place, (&p, &start))| *place = p - start);
            for j in 0..s {
                let factor = h * self.rule.matrix(i, j);
                let forces = residual.iter_mut().zip(vector(room.forces, n, j));
                forces.for_each(|(place, &force)| *place -= factor * force);
            }
        }
        self.constrain(room);
    }

    /// The dampers' forces f = known + Z₀ W, node by node.
    fn pull(&self, room: &mut StepBuffers<'_, T>) {
        let Shape { s, e, .. } = self.shape;
        for row in 0..e {
            for i in 0..s {
                let mut sum = at(room.known, row * s + i);
                for column in 0..e {
                    for j in 0..s {
                        sum += self.dampers.leading([row, column], [i, j]) * at(room.rates, column * s + j);
                    }
                }
                put(room.tensions, i * e + row, sum);
            }
        }
    }

    /// Adds the constraints' impulses to the residual, and writes c at the knots, over h, behind it.
    fn constrain(&mut self, room: &mut StepBuffers<'_, T>) {
        let Shape { s, n, m, .. } = self.shape;
        for j in 0..if m == 0 { 0 } else { s + 1 } {
            self.write_knot(j, room);
            let jacobian = vector_mut(room.constraints, m * n, j);
            self.system.constrain(room.point, room.values, jacobian);
            if j > 0 {
                let places = room.residual.iter_mut().skip(s * n + (j - 1) * m);
                places.zip(&*room.values).for_each(|(place, &value)| *place = value / self.length);
            }
            if j < s {
                let multipliers = from(room.unknowns, s * n + j * m, m);
                for i in 0..s {
                    let factor = self.length * self.rule.conjugate(i, j);
                    add_transposed(factor, jacobian, multipliers, vector_mut(room.residual, n, i));
                }
            }
        }
    }

    /// Writes Q̃_j.
    fn write_knot(&self, j: usize, room: &mut StepBuffers<'_, T>) {
        let Shape { s, n, .. } = self.shape;
        room.point.iter_mut().zip(self.position).for_each(|(place, &q)| *place = q);
        for k in 0..s {
            let factor = self.length * self.rule.at_knot(j, k);
            let moved = room.point.iter_mut().zip(vector(room.unknowns, n, k));
            moved.for_each(|(place, &velocity)| *place += factor * velocity);
        }
    }

    /// Writes the matrix of the equations at the point that was evaluated last.
    fn linearise(&mut self, room: &mut StepBuffers<'_, T>) {
        let Shape { s, n, .. } = self.shape;
        let (u, square) = (self.shape.unknowns(), n * n);
        self.differentiate(room);
        room.matrix.fill(T::zero());
        for (i, l) in (0..s).flat_map(|i| (0..s).map(move |l| (i, l))) {
            let own = if i == l { T::one() } else { T::zero() };
            let coupled = self.length * self.rule.matrix(i, l);
            for (row, column) in (0..n).flat_map(|row| (0..n).map(move |column| (row, column))) {
                let entry = row * n + column;
                let mut sum =
                    own * at(room.mass, i * square + entry) + coupled * at(room.coupling, i * square + entry);
                for j in 0..s {
                    let slope = at(room.slopes, (j * s + l) * square + entry);
                    sum -= self.length * self.rule.matrix(i, j) * slope;
                }
                put(room.matrix, (i * n + row) * u + l * n + column, sum);
            }
        }
        self.linearise_constraints(room);
    }

    /// Writes dY_j/dV_l, with the second derivatives at the nodes.
    fn differentiate(&mut self, room: &mut StepBuffers<'_, T>) {
        let Shape { s, n, e, .. } = self.shape;
        let square = n * n;
        for i in 0..s {
            let (position, velocity) = (vector(room.positions, n, i), vector(room.unknowns, n, i));
            let parts = Second {
                mass: vector_mut(room.mass, square, i),
                coupling: vector_mut(room.coupling, square, i),
                stiffness: vector_mut(room.stiffness, square, i),
                resistance: vector_mut(room.resistance, square, i),
            };
            if let Some(slopes) = self.stiffened {
                copy(room.vector, velocity);
                Stiffened::move_aside(room.vector, slopes.aside);
                self.system.second(self.instant(i), position, room.vector, parts);
            } else {
                self.system.second(self.instant(i), position, velocity, parts);
            }
            let (tensions, turning) = (vector(room.tensions, e, i), vector_mut(room.turning, e * n, i));
            self.system.turn(position, velocity, tensions, turning, vector_mut(room.stiffness, square, i));
        }
        let stiffening = self.stiffened.map_or(T::one(), |slopes| slopes.factor);
        for (j, l) in (0..s).flat_map(|j| (0..s).map(move |l| (j, l))) {
            let own = if j == l { T::one() } else { T::zero() };
            let moved = self.length * self.rule.matrix(j, l);
            let slope = vector_mut(room.slopes, square, j * s + l);
            let parts = vector(room.resistance, square, j).iter().zip(vector(room.stiffness, square, j));
            let of_point = |(place, (&resistance, &stiffness)): (&mut T, (&T, &T))| {
                *place = own * resistance * stiffening + moved * stiffness;
            };
            slope.iter_mut().zip(parts).for_each(of_point);
            for row in 0..e {
                self.write_pull((row, j, l), (room.jacobians, room.turning), room.vector);
                let along = from(room.jacobians, (j * e + row) * n, n);
                for (slopes, &g) in slope.chunks_exact_mut(n.max(1)).zip(along) {
                    slopes.iter_mut().zip(&*room.vector).for_each(|(place, &pull)| *place -= g * pull);
                }
            }
        }
    }

    /// Writes the derivative of the force along elongation `row` at node j with respect to V_l.
    fn write_pull(&self, place: (usize, usize, usize), of_rates: (&[T], &[T]), pull: &mut [T]) {
        let (row, j, l) = place;
        let (jacobians, turning) = of_rates;
        let Shape { s, n, e, .. } = self.shape;
        pull.fill(T::zero());
        for (node, column) in (0..s).flat_map(|node| (0..e).map(move |column| (node, column))) {
            let weight = self.dampers.leading([row, column], [j, node]);
            let moved = weight * self.length * self.rule.matrix(node, l);
            let own = if node == l { weight } else { T::zero() };
            let start = (node * e + column) * n;
            let parts = from(jacobians, start, n).iter().zip(from(turning, start, n));
            let of_rate = |(place, (&g, &turn)): (&mut T, (&T, &T))| *place += own * g + moved * turn;
            pull.iter_mut().zip(parts).for_each(of_rate);
        }
    }

    /// Adds the constraints' part of the matrix. Multipliers are unknown in units of 1/h.
    fn linearise_constraints(&mut self, room: &mut StepBuffers<'_, T>) {
        let Shape { s, n, m, .. } = self.shape;
        let u = self.shape.unknowns();
        for j in 0..if m == 0 { 0 } else { s + 1 } {
            if j < s {
                self.write_knot(j, room);
                room.curvature.fill(T::zero());
                let multipliers = from(room.unknowns, s * n + j * m, m);
                self.system.add_constraint_curvature(room.point, multipliers, T::one(), room.curvature);
            }
            let jacobian = vector(room.constraints, m * n, j);
            let width = n.max(1);
            for l in 0..s {
                let moved = self.rule.at_knot(j, l);
                for (index, row) in jacobian.chunks_exact(width).enumerate().take(if j > 0 { m } else { 0 }) {
                    let places = from_mut(room.matrix, (s * n + (j - 1) * m + index) * u + l * n, n);
                    places.iter_mut().zip(row).for_each(|(place, &c)| *place += moved * c);
                }
                for i in 0..if j < s { s } else { 0 } {
                    let factor = self.length * self.length * self.rule.conjugate(i, j) * moved;
                    for (row, curvature) in room.curvature.chunks_exact(width).enumerate() {
                        let places = from_mut(room.matrix, (i * n + row) * u + l * n, n);
                        places.iter_mut().zip(curvature).for_each(|(place, &c)| *place += factor * c);
                    }
                }
            }
            for i in 0..if j < s { s } else { 0 } {
                let factor = self.rule.conjugate(i, j);
                for (index, row) in jacobian.chunks_exact(width).enumerate() {
                    for (coordinate, &c) in row.iter().enumerate() {
                        put(room.matrix, (i * n + coordinate) * u + s * n + j * m + index, factor * c);
                    }
                }
            }
        }
    }
}

/// Writes L_vv and the other second derivatives, c and C at a point, and the matrix [L_vv Cᵀ; C 0].
pub(super) fn form_saddle<T: Real, L: Lagrangian<T>>(
    system: &mut L,
    shape: Shape,
    (instant, position, velocity): (Instant<T>, &[T], &[T]),
    room: &mut StepBuffers<'_, T>,
) {
    let Shape { n, m, .. } = shape;
    let (square, width) = (n * n, n + m);
    let parts = Second {
        mass: vector_mut(room.mass, square, 0),
        coupling: vector_mut(room.coupling, square, 0),
        stiffness: vector_mut(room.stiffness, square, 0),
        resistance: vector_mut(room.resistance, square, 0),
    };
    system.second(instant, position, velocity, parts);
    system.constrain(position, room.values, vector_mut(room.constraints, m * n, 0));
    let matrix = from_mut(room.matrix, 0, width * width);
    matrix.fill(T::zero());
    for (row, masses) in from(room.mass, 0, square).chunks_exact(n.max(1)).enumerate() {
        copy(from_mut(matrix, row * width, n), masses);
    }
    for (index, gradient) in from(room.constraints, 0, m * n).chunks_exact(n.max(1)).enumerate() {
        copy(from_mut(matrix, (n + index) * width, n), gradient);
        gradient.iter().enumerate().for_each(|(row, &c)| put(matrix, row * width + n + index, c));
    }
}

/// Solves with the matrix that [`form_saddle`] wrote, for the first N + M numbers of the residual.
pub(super) fn solve_saddle<T: Real>(
    shape: Shape,
    room: &mut StepBuffers<'_, T>,
    pivots: &mut [usize],
) -> Result<(), Singular> {
    let width = shape.n + shape.m;
    let (matrix, pivots) = (from_mut(room.matrix, 0, width * width), from_mut(pivots, 0, width));
    let vector = from_mut(room.residual, 0, width);
    factor(matrix, pivots)?;
    substitute(matrix, pivots, vector);
    if all_finite(vector) { Ok(()) } else { Err(Singular) }
}
