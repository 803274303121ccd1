//! The equations of a step of a mechanism, linearised, and those of a grid point.

use super::mechanism_explicit::Explicit;
use crate::model::Mechanism;
use fvi_core::{GaussLobatto, Instant, Lagrangian, Second, max_or_nan};
use fvi_fft::dense::Factored;
use nalgebra::DMatrix;

/// Largest rate, relative to the sizes that it is made of, at which a start may leave the constraints.
const ON_CONSTRAINTS: f64 = 1e-8;

/// A node of a step: Q, V, G, vᵀ∂²g, f, and the second derivatives, with those of elongations.
pub(in crate::simulation) struct Node {
    pub(super) position: Vec<f64>,
    pub(super) velocity: Vec<f64>,
    pub(super) elongating: Vec<f64>,
    pub(super) turning: Vec<f64>,
    pub(super) forces: Vec<f64>,
    pub(super) mass: Vec<f64>,
    pub(in crate::simulation) coupling: Vec<f64>,
    pub(super) stiffness: Vec<f64>,
    pub(super) resistance: Vec<f64>,
}

/// A knot of a step: Q̃, C, Λ, and Λ·∂²c.
pub(super) struct Knot {
    pub(super) position: Vec<f64>,
    pub(super) gradients: Vec<f64>,
    pub(super) multipliers: Vec<f64>,
    pub(super) curvature: Vec<f64>,
}

/// A step, linearised where it was solved.
pub(super) struct Step {
    pub(super) rule: GaussLobatto<f64>,
    /// N, M, E.
    pub(super) shape: [usize; 3],
    pub(super) time: f64,
    pub(super) length: f64,
    /// Z₀, of elongation e at node i in row and column e·s + i.
    pub(super) leading: Vec<f64>,
    pub(super) nodes: Vec<Node>,
    pub(super) knots: Vec<Knot>,
}

/// What a step's derivatives follow from.
#[derive(Default)]
pub(super) struct Given {
    pub(super) position: Vec<f64>,
    pub(super) momentum: Vec<f64>,
    /// δf but for Z₀ δW.
    pub(super) known: Vec<f64>,
    /// ∂_θL_v and ∂_θ(L_q + F) at nodes, N each; ∂_θG, E×N each.
    pub(super) momenta: Vec<f64>,
    pub(super) forces: Vec<f64>,
    pub(super) elongating: Vec<f64>,
    /// ∂_θc and ∂_θC at knots, M and M×N each.
    pub(super) values: Vec<f64>,
    pub(super) gradients: Vec<f64>,
}

/// What the linear equations say for derivatives of the unknowns.
pub(super) struct Found {
    pub(super) residual: Vec<f64>,
    pub(super) rates: Vec<f64>,
    pub(super) position: Vec<f64>,
    /// The momentum without the last multipliers.
    pub(super) momentum: Vec<f64>,
}

/// out += factor B x, for B of as many columns as x has numbers.
pub(in crate::simulation) fn add(factor: f64, matrix: &[f64], x: &[f64], out: &mut [f64]) {
    for (out, row) in out.iter_mut().zip(matrix.chunks_exact(x.len().max(1))) {
        *out += factor * row.iter().zip(x).map(|(b, x)| b * x).sum::<f64>();
    }
}

/// out += factor Bᵀ x.
pub(in crate::simulation) fn add_transposed(factor: f64, matrix: &[f64], x: &[f64], out: &mut [f64]) {
    for (row, &x) in matrix.chunks_exact(out.len().max(1)).zip(x) {
        out.iter_mut().zip(row).for_each(|(out, b)| *out += factor * b * x);
    }
}

pub(super) fn add_vector(factor: f64, x: &[f64], out: &mut [f64]) {
    out.iter_mut().zip(x).for_each(|(out, x)| *out += factor * x);
}

/// Part `index` of parts of `width` numbers; nothing of no numbers.
pub(super) fn at(numbers: &[f64], width: usize, index: usize) -> &[f64] {
    if numbers.is_empty() { numbers } else { &numbers[index * width..(index + 1) * width] }
}

impl Step {
    /// The equations for derivatives of V and Λ, the latter over h.
    pub(super) fn respond(&self, given: &Given, unknowns: &[f64]) -> Found {
        let ([n, m, e], s, h, rule) = (self.shape, self.rule.stages(), self.length, &self.rule);
        let (velocities, multipliers) = unknowns.split_at(s * n);
        let moved = |weight: &dyn Fn(usize) -> f64| {
            let mut moved = given.position.clone();
            (0..s).for_each(|j| add_vector(h * weight(j), at(velocities, n, j), &mut moved));
            moved
        };
        let positions: Vec<_> = (0..s).map(|i| moved(&|j| rule.matrix(i, j))).collect();
        let mut rates = vec![0.0; e * s];
        for (i, node) in self.nodes.iter().enumerate() {
            let mut own = vec![0.0; e];
            add(1.0, &node.elongating, at(velocities, n, i), &mut own);
            add(1.0, &node.turning, &positions[i], &mut own);
            add(1.0, at(&given.elongating, e * n, i), &node.velocity, &mut own);
            own.iter().enumerate().for_each(|(index, &rate)| rates[index * s + i] = rate);
        }
        let mut pulls = given.known.clone();
        pulls.resize(e * s, 0.0);
        add(1.0, &self.leading, &rates, &mut pulls);
        let mut residual = vec![0.0; s * (n + m)];
        let mut forces = Vec::new();
        for (i, node) in self.nodes.iter().enumerate() {
            let (position, velocity) = (&positions[i], at(velocities, n, i));
            let own: Vec<f64> = (0..e).map(|index| pulls[index * s + i]).collect();
            let mut force = vec![0.0; n];
            add(1.0, &node.stiffness, position, &mut force);
            add(1.0, &node.resistance, velocity, &mut force);
            add_vector(1.0, at(&given.forces, n, i), &mut force);
            add_transposed(-1.0, &node.elongating, &own, &mut force);
            add_transposed(-1.0, at(&given.elongating, e * n, i), &node.forces, &mut force);
            let place = &mut residual[i * n..(i + 1) * n];
            add(1.0, &node.coupling, position, place);
            add(1.0, &node.mass, velocity, place);
            add_vector(1.0, at(&given.momenta, n, i), place);
            add_vector(-1.0, &given.momentum, place);
            forces.push(force);
        }
        let mut momentum = given.momentum.clone();
        for (j, force) in forces.iter().enumerate() {
            add_vector(h * rule.weight(j), force, &mut momentum);
            for i in 0..s {
                add_vector(-h * rule.matrix(i, j), force, &mut residual[i * n..(i + 1) * n]);
            }
        }
        for (j, knot) in self.knots.iter().enumerate() {
            let position = moved(&|k| rule.at_knot(j, k));
            if j > 0 {
                let place = &mut residual[s * n + (j - 1) * m..][..m];
                add(1.0 / h, &knot.gradients, &position, place);
                add_vector(1.0 / h, at(&given.values, m, j), place);
            }
            if j == s {
                continue;
            }
            let mut impulse = vec![0.0; n];
            add(h, &knot.curvature, &position, &mut impulse);
            add_transposed(1.0, &knot.gradients, at(multipliers, m, j), &mut impulse);
            add_transposed(h, at(&given.gradients, m * n, j), &knot.multipliers, &mut impulse);
            add_vector(-rule.knot_weight(j), &impulse, &mut momentum);
            for i in 0..s {
                add_vector(rule.conjugate(i, j), &impulse, &mut residual[i * n..(i + 1) * n]);
            }
        }
        Found { residual, rates, position: moved(&|j| rule.weight(j)), momentum }
    }

    /// The matrix of the equations, factored.
    pub(super) fn factor(&self) -> Option<Factored> {
        let ([n, m, _], s) = (self.shape, self.rule.stages());
        let still = Given { position: vec![0.0; n], momentum: vec![0.0; n], ..Given::default() };
        let count = s * (n + m);
        let mut matrix = DMatrix::zeros(count, count);
        for column in 0..count {
            let mut unit = vec![0.0; count];
            unit[column] = 1.0;
            matrix.column_mut(column).copy_from_slice(&self.respond(&still, &unit).residual);
        }
        Factored::new(matrix)
    }

    pub(super) fn instant(&self, i: usize) -> Instant<f64> {
        Instant::in_step(self.time, self.rule.node(i), self.length)
    }
}

/// y and μ with M y + Cᵀμ = x and C y = r at a position, and what their derivatives follow from.
pub(in crate::simulation) struct Saddle {
    pub(super) position: Vec<f64>,
    pub(super) factored: Factored,
    pub(super) solution: Vec<f64>,
    /// ∂(M y)/∂q, N×N.
    pub(super) turned: Vec<f64>,
    pub(super) gradients: Vec<f64>,
    /// μ·∂²c, and yᵀ∂²c, N×N and M×N.
    pub(super) curvature: Vec<f64>,
    pub(super) turning: Vec<f64>,
}

impl Saddle {
    pub(in crate::simulation) fn new(
        system: &mut Mechanism<f64>,
        position: &[f64],
        right: [&[f64]; 2],
    ) -> Option<Self> {
        let (n, m) = (position.len(), right[1].len());
        let mass = second(system, position, &vec![0.0; n]);
        let (mut values, mut gradients) = (vec![0.0; m], vec![0.0; m * n]);
        system.constrain(position, &mut values, &mut gradients);
        let matrix = DMatrix::from_fn(n + m, n + m, |i, j| match (i.checked_sub(n), j.checked_sub(n)) {
            (None, None) => mass.mass[i * n + j],
            (Some(row), None) => gradients[row * n + j],
            (None, Some(column)) => gradients[column * n + i],
            _ => 0.0,
        });
        let factored = Factored::new(matrix)?;
        let mut column = DMatrix::from_column_slice(n + m, 1, &right.concat());
        factored.solve(&mut column);
        let solution = column.as_slice().to_vec();
        let (y, multipliers) = solution.split_at(n);
        let mut turned = second(system, position, y).coupling;
        add_vector(-1.0, &mass.coupling, &mut turned);
        let (mut curvature, mut turning) = (vec![0.0; n * n], vec![0.0; m * n]);
        system.add_constraint_curvature(position, multipliers, 1.0, &mut curvature);
        turn_constraints(system, position, y, &mut turning);
        let position = position.to_vec();
        Some(Self { position, factored, solution, turned, gradients, curvature, turning })
    }

    pub(in crate::simulation) fn value(&self) -> (&[f64], &[f64]) {
        self.solution.split_at(self.position.len())
    }

    /// δy, and δ(Cᵀμ), for derivatives of position and right side.
    pub(super) fn slope(
        &self,
        explicit: &mut Explicit,
        change: &[f64],
        (mut top, mut bottom): (Vec<f64>, Vec<f64>),
    ) -> [Vec<f64>; 2] {
        let (n, m) = (change.len(), bottom.len());
        let (y, multipliers) = self.value();
        let (mut values, mut gradients) = (vec![0.0; m], vec![0.0; m * n]);
        explicit.constrain(&self.position, &mut values, &mut gradients);
        let mut pulled = vec![0.0; n];
        add(1.0, &self.curvature, change, &mut pulled);
        add_transposed(1.0, &gradients, multipliers, &mut pulled);
        add(-1.0, &self.turned, change, &mut top);
        explicit.add_momentum(-1.0, &self.position, y, &mut top);
        explicit.add_momentum(1.0, &self.position, &vec![0.0; n], &mut top);
        add_vector(-1.0, &pulled, &mut top);
        add(-1.0, &self.turning, change, &mut bottom);
        add(-1.0, &gradients, y, &mut bottom);
        let mut column = DMatrix::from_column_slice(n + m, 1, &[top, bottom].concat());
        self.factored.solve(&mut column);
        let (slope, multipliers) = column.as_slice().split_at(n);
        add_transposed(1.0, &self.gradients, multipliers, &mut pulled);
        [slope.to_vec(), pulled]
    }
}

/// Writes vᵀ∂²c, M×N numbers.
pub(in crate::simulation) fn turn_constraints(
    system: &mut Mechanism<f64>,
    position: &[f64],
    velocity: &[f64],
    turning: &mut [f64],
) {
    let (n, m) = (position.len(), system.constraints());
    for index in 0..m {
        let (mut one, mut bent) = (vec![0.0; m], vec![0.0; n * n]);
        one[index] = 1.0;
        system.add_constraint_curvature(position, &one, 1.0, &mut bent);
        let place = &mut turning[index * n..][..n];
        place.fill(0.0);
        add(1.0, &bent, velocity, place);
    }
}

/// True if a start remains on the constraints with these derivatives of position and velocity.
pub(super) fn stays_on(
    system: &mut Mechanism<f64>,
    explicit: &mut Explicit,
    (position, velocity): (&[f64], &[f64]),
    (change, slope): (&[f64], &[f64]),
) -> bool {
    let (n, m) = (position.len(), system.constraints());
    let (mut values, mut gradients) = (vec![0.0; m], vec![0.0; m * n]);
    system.constrain(position, &mut values, &mut gradients);
    let (mut rates, mut parts, mut turning) = (vec![0.0; m], vec![0.0; m * n], vec![0.0; m * n]);
    explicit.constrain(position, &mut rates, &mut parts);
    add(1.0, &gradients, change, &mut rates);
    turn_constraints(system, position, velocity, &mut turning);
    let mut speeds = vec![0.0; m];
    add(1.0, &gradients, slope, &mut speeds);
    add(1.0, &turning, change, &mut speeds);
    add(1.0, &parts, velocity, &mut speeds);
    let largest = |numbers: &[f64]| numbers.iter().fold(0.0, |most, x| max_or_nan(most, x.abs()));
    let scale = 1.0 + largest(&gradients).max(largest(&turning));
    largest(&rates).max(largest(&speeds)) <= ON_CONSTRAINTS * scale
}

/// The second derivatives at a grid point; elongations are left out.
pub(super) fn second(system: &mut Mechanism<f64>, position: &[f64], velocity: &[f64]) -> Node {
    second_at(system, Instant::in_step(0.0, 0.5, 0.0), position, velocity)
}

pub(in crate::simulation) fn second_at(
    system: &mut Mechanism<f64>,
    instant: Instant<f64>,
    position: &[f64],
    velocity: &[f64],
) -> Node {
    let square = vec![0.0; position.len() * position.len()];
    let mut node = Node {
        position: position.to_vec(),
        velocity: velocity.to_vec(),
        elongating: Vec::new(),
        turning: Vec::new(),
        forces: Vec::new(),
        mass: square.clone(),
        coupling: square.clone(),
        stiffness: square.clone(),
        resistance: square,
    };
    let Node { mass, coupling, stiffness, resistance, .. } = &mut node;
    system.second(instant, position, velocity, Second { mass, coupling, stiffness, resistance });
    node
}
