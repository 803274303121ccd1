//! One step of the derivatives.

use super::{Tangent, TangentBuffers, add, add_leading, known, leave_behind, push, said, whole};
use crate::model::{Matrix, StepShape};
use fvi_core::{Block, Instant, Mechanics, Memory, Sample};
use std::sync::Arc;

/// A step of the motion whose derivatives are computed.
#[derive(Clone, Copy)]
struct Step<'a> {
    shape: StepShape<'a>,
    /// Time of its beginning, and its length.
    time: f64,
    length: f64,
    /// q_k and p_k.
    start: &'a [f64],
    momentum: &'a [f64],
    /// The unknowns that solved it.
    unknowns: &'a [f64],
    /// Fractions of the step at which memories take samples.
    fractions: &'a [f64],
}

impl<'a> Step<'a> {
    /// e^μ of n coordinates.
    fn unknown(&self, mu: usize, n: usize) -> &'a [f64] {
        &self.unknowns[mu * n..][..n]
    }

    /// The sample of a memory.
    fn sample<'s>(&'s self, from: &'s [f64], behind: &'s [f64]) -> Sample<'s, f64> {
        Sample { from, behind, time: self.time, length: self.length, fractions: self.fractions }
    }
}

impl Tangent {
    /// Computes the derivatives after the step that began at this position and momentum and was solved with
    /// these increments, for collocation with these accelerations.
    ///
    /// # Errors
    /// A message.
    pub(crate) fn advance(
        &mut self,
        step: usize,
        (start, momentum): (&[f64], &[f64]),
        increments: &[f64],
    ) -> Result<(), String> {
        let scheme = Arc::clone(&self.scheme);
        let shape = StepShape::new(&scheme, self.step);
        let fractions = if self.at_main_nodes { &[1.0][..] } else { shape.nodes() };
        let time = self.start + self.step * step as f64;
        let step = Step { shape, time, length: self.step, start, momentum, unknowns: increments, fractions };
        self.place_points(&step);
        self.recall(&step)?;
        self.gather_forces(&step);
        self.factor(&step)?;
        self.solve(&step)?;
        self.displace(&step);
        self.change_momentum(&step);
        self.remember(&step)
    }

    /// X_i − q_k at the quadrature points and at the end of the step, and for collocation h c_i δv_k.
    fn place_points(&mut self, step: &Step<'_>) {
        let (n, c, h) = (self.size, self.size * self.count, self.step);
        let (shape, points) = (step.shape, step.shape.points());
        let TangentBuffers { stages, place, right, base, start_velocities, rise, .. } = &mut self.room;
        stages.fill(0.0);
        if shape.is_collocation() {
            self.model.velocity(step.momentum, place);
            for (parameter, change) in self.mass_changes.iter().enumerate() {
                right.copy_from_slice(&self.momentum[parameter * n..][..n]);
                change.iter().for_each(|&(row, column)| right[row] -= place[column]);
                self.model.velocity(right, &mut start_velocities[parameter * n..][..n]);
            }
            for (i, node) in shape.nodes().iter().enumerate() {
                add(&mut stages[i * n..][..n], h * node, place);
                let pairs = base[i * c..][..c].iter_mut().zip(&*start_velocities);
                pairs.for_each(|(b, v)| *b = h * node * v);
            }
        }
        for i in 0..points {
            for mu in 0..shape.degree() {
                add(&mut stages[i * n..][..n], shape.displacement(i, mu), step.unknown(mu, n));
            }
        }
        match shape.is_collocation() {
            true => rise.copy_from_slice(&stages[(points - 1) * n..]),
            false => rise.copy_from_slice(step.unknown(shape.degree() - 1, n)),
        }
    }

    /// The known part of ρ D δX, δρ D X, and ρ (∂D) X, at every node of the memories.
    fn recall(&mut self, step: &Step<'_>) -> Result<(), String> {
        let (n, c, nodes) = (self.size, self.size * self.count, step.fractions.len());
        let TangentBuffers { stages, damped, derivative, terms, rise, .. } = &mut self.room;
        let told = if self.at_main_nodes { &rise[..] } else { &stages[..] };
        let sample = step.sample(step.start, &self.motion_behind);
        let own_sample = step.sample(&self.position, &self.behind);
        damped.fill(0.0);
        for term in &mut self.terms {
            known(&mut term.tangent, &own_sample, (nodes, c), terms, derivative).map_err(said)?;
            for (damped, known) in damped.chunks_mut(n).zip(derivative.chunks(n)) {
                term.rho.multiply_add(1.0, known, damped);
            }
            if let Some(value) = &mut term.value {
                whole(value, &sample, told, (nodes, n), terms, derivative).map_err(said)?;
                for (parameter, change) in &term.changes {
                    for node in 0..nodes {
                        let place = &mut damped[node * c + parameter * n..][..n];
                        for &(row, column, entry) in change {
                            place[row] += entry * derivative[node * n + column];
                        }
                    }
                }
            }
            for (parameter, kernel) in &mut term.kernels {
                whole(kernel, &sample, told, (nodes, n), terms, derivative).map_err(said)?;
                for node in 0..nodes {
                    let place = &mut damped[node * c + *parameter * n..][..n];
                    term.rho.multiply_add(1.0, &derivative[node * n..][..n], place);
                }
            }
        }
        for (parameter, change) in &self.gyroscopic_changes {
            change.visit(|i, j, weight, skew| {
                let place = &mut damped[i * c + parameter * n..][..n];
                skew.multiply_add(weight, &stages[j * n..][..n], place);
            });
        }
        Ok(())
    }

    /// δG_i without what follows from the unknowns, and the matrices ∂²U − ∂F and −∂F/∂v, at every point.
    fn gather_forces(&mut self, step: &Step<'_>) {
        let (n, c, nodes) = (self.size, self.size * self.count, step.fractions.len());
        let differ = !Mechanics::is_linear(&self.model) && step.shape.points() > 1;
        self.room.forces.fill(0.0);
        self.room.stiffnesses.clear();
        self.room.resistances.clear();
        for i in 0..step.shape.points() {
            self.linearise(step, i);
            let TangentBuffers { forces, damped, base, start_velocities, stiffnesses, resistances, .. } =
                &mut self.room;
            for (parameter, force) in forces[i * c..][..c].chunks_mut(n).enumerate() {
                self.stiffness.multiply_add(1.0, &self.position[parameter * n..][..n], force);
                if step.shape.is_collocation() {
                    self.stiffness.multiply_add(1.0, &base[i * c + parameter * n..][..n], force);
                    if let Some(resistance) = &self.resistance {
                        resistance.multiply_add(1.0, &start_velocities[parameter * n..][..n], force);
                    }
                }
            }
            if differ {
                stiffnesses.push(self.stiffness.clone());
                resistances.extend(self.resistance.clone());
            }
            if !self.kicks {
                add(&mut forces[i * c..][..c], 1.0, &damped[i * c..][..c]);
            }
            if step.shape.is_collocation() {
                add_leading(&self.terms, (i, nodes), base, n, &mut forces[i * c..][..c]);
            }
        }
    }

    /// ∂²U − ∂F and −∂F/∂v at a point, where they are not known already, and ∂G_i/∂θ there.
    fn linearise(&mut self, step: &Step<'_>, i: usize) {
        let (n, c, shape) = (self.size, self.size * self.count, step.shape);
        let TangentBuffers { stages, forces, restoring, place, velocity, .. } = &mut self.room;
        let instant = Instant::in_step(step.time, shape.nodes()[i], step.length);
        let anew = !Mechanics::is_linear(&self.model) || (i == 0 && !self.solver.is_ready());
        place.iter_mut().zip(step.start.iter().zip(&stages[i * n..])).for_each(|(x, (q, e))| *x = q + e);
        if let Some(resistance) = &mut self.resistance {
            match shape.is_collocation() {
                true => self.model.velocity(step.momentum, velocity),
                false => velocity.fill(0.0),
            }
            for mu in 0..shape.degree() {
                add(velocity, shape.slope(i, mu), step.unknown(mu, n));
            }
            if anew {
                let stiffness = &mut self.stiffness;
                self.model.linearise_in_motion(instant, place, velocity, restoring, stiffness);
                self.model.resistance(instant, place, velocity, resistance);
            }
        } else if anew {
            self.model.linearise(instant, place, restoring, &mut self.stiffness);
        }
        for (direct, force) in self.direct.iter_mut().zip(forces[i * c..][..c].chunks_mut(n)) {
            direct.iter_mut().for_each(|part| part.add(instant, (place, velocity), force));
        }
    }

    /// Factors the matrix of the step, unless it is that of the step before.
    fn factor(&mut self, step: &Step<'_>) -> Result<(), &'static str> {
        let (n, nodes, shape) = (self.size, step.fractions.len(), step.shape);
        let linear = Mechanics::is_linear(&self.model);
        let stays = linear && self.terms.iter().all(|term| term.tangent.memory().leading_is_constant());
        if self.solver.is_ready() && stays {
            return Ok(());
        }
        let matrices = Matrices::of(&self.room, &self.stiffness, self.resistance.as_ref());
        let (model, terms, gyroscopic, kicks) = (&self.model, &self.terms, &self.gyroscopic, self.kicks);
        self.solver.factor((shape.degree(), n), model.mass(), |insert| {
            for nu in 0..shape.degree() {
                for mu in 0..shape.degree() {
                    insert(nu, mu, shape.inertia(nu, mu), model.mass());
                    for i in 0..shape.points() {
                        let factor = shape.part(i, nu);
                        insert(nu, mu, factor * shape.displacement(i, mu), matrices.stiffness(i));
                        if let Some(resistance) = matrices.resistance(i) {
                            insert(nu, mu, factor * shape.slope(i, mu), resistance);
                        }
                        if kicks {
                            continue;
                        }
                        for term in terms {
                            let weight =
                                |j: usize| term.tangent.leading(0, nodes, i, j) * shape.displacement(j, mu);
                            insert(nu, mu, factor * (0..nodes).map(weight).sum::<f64>(), &term.rho);
                        }
                        if let Some(gyroscopic) = gyroscopic {
                            gyroscopic.visit(|row, j, weight, skew| {
                                if row == i {
                                    insert(nu, mu, factor * weight * shape.displacement(j, mu), skew);
                                }
                            });
                        }
                    }
                }
            }
        })
    }

    /// Solves for the derivatives of the unknowns.
    fn solve(&mut self, step: &Step<'_>) -> Result<(), String> {
        let (n, c, shape) = (self.size, self.size * self.count, step.shape);
        let TangentBuffers { forces, right, columns, .. } = &mut self.room;
        for parameter in 0..self.count {
            for nu in 0..shape.degree() {
                right.fill(0.0);
                if nu == 0 && !shape.is_collocation() {
                    add(right, -1.0, &self.momentum[parameter * n..][..n]);
                }
                for i in 0..shape.points() {
                    add(right, -shape.part(i, nu), &forces[i * c + parameter * n..][..n]);
                }
                for mu in 0..shape.degree() {
                    let (factor, unknown) = (-shape.inertia(nu, mu), step.unknown(mu, n));
                    for &(row, column) in &self.mass_changes[parameter] {
                        right[row] += factor * unknown[column];
                    }
                }
                columns.column_mut(parameter).rows_mut(nu * n, n).copy_from_slice(right);
            }
        }
        self.solver.solve(columns)?;
        match columns.iter().all(|number| number.is_finite()) {
            true => Ok(()),
            false => Err("a derivative is not finite".to_owned()),
        }
    }

    /// δX_i − δq_k at the points, and δq_{k+1} − δq_k.
    fn displace(&mut self, step: &Step<'_>) {
        let (n, c, shape) = (self.size, self.size * self.count, step.shape);
        let (degree, points) = (shape.degree(), shape.points());
        let TangentBuffers { base, own_stages, own_rise, columns, .. } = &mut self.room;
        for (parameter, column) in columns.as_slice().chunks_exact(degree * n).enumerate() {
            for i in 0..points {
                let own = &mut own_stages[i * c + parameter * n..][..n];
                for (row, own) in own.iter_mut().enumerate() {
                    *own = (0..degree).map(|mu| shape.displacement(i, mu) * column[mu * n + row]).sum();
                }
            }
            if !shape.is_collocation() {
                own_rise[parameter * n..][..n].copy_from_slice(&column[(degree - 1) * n..]);
            }
        }
        if shape.is_collocation() {
            add(own_stages, 1.0, base);
            own_rise.copy_from_slice(&own_stages[(points - 1) * c..]);
        }
    }

    /// δp_{k+1}: of collocation from the derivatives of the accelerations, else from δG_i; and the kick at
    /// the main nodes.
    fn change_momentum(&mut self, step: &Step<'_>) {
        let (n, c, h, nodes) = (self.size, self.size * self.count, self.step, step.fractions.len());
        let shape = step.shape;
        let mut forces = std::mem::take(&mut self.room.forces);
        let matrices = Matrices::of(&self.room, &self.stiffness, self.resistance.as_ref());
        let TangentBuffers { own_stages, own_rise, columns, .. } = &self.room;
        let columns = columns.as_slice();
        if shape.is_collocation() {
            for (parameter, column) in columns.chunks_exact(shape.degree() * n).enumerate() {
                let momentum = &mut self.momentum[parameter * n..][..n];
                for (j, weight) in shape.weights().iter().enumerate() {
                    self.model.mass().multiply_add(h * weight, &column[j * n..][..n], momentum);
                    for &(row, other) in &self.mass_changes[parameter] {
                        momentum[row] += h * weight * step.unknown(j, n)[other];
                    }
                }
            }
        } else {
            for (i, weight) in shape.weights().iter().enumerate() {
                let force = &mut forces[i * c..][..c];
                let own = force.chunks_mut(n).zip(own_stages[i * c..][..c].chunks(n));
                own.for_each(|(force, own)| matrices.stiffness(i).multiply_add(1.0, own, force));
                if let Some(resistance) = matrices.resistance(i) {
                    for (parameter, force) in force.chunks_mut(n).enumerate() {
                        for mu in 0..shape.degree() {
                            let own = &columns[(parameter * shape.degree() + mu) * n..][..n];
                            resistance.multiply_add(shape.slope(i, mu), own, force);
                        }
                    }
                }
                if !self.kicks {
                    add_leading(&self.terms, (i, nodes), own_stages, n, force);
                    if let Some(gyroscopic) = &self.gyroscopic {
                        gyroscopic.visit(|row, j, weight, skew| {
                            if row == i {
                                let pairs = force.chunks_mut(n).zip(own_stages[j * c..][..c].chunks(n));
                                pairs.for_each(|(force, own)| skew.multiply_add(weight, own, force));
                            }
                        });
                    }
                }
                add(&mut self.momentum, -h * weight, force);
            }
        }
        if self.kicks {
            self.kick.copy_from_slice(&self.room.damped);
            add_leading(&self.terms, (0, 1), own_rise, n, &mut self.kick);
            add(&mut self.momentum, -h, &self.kick);
        }
        self.room.forces = forces;
    }

    /// Hands the step to the memories, and moves on to its end.
    fn remember(&mut self, step: &Step<'_>) -> Result<(), String> {
        let TangentBuffers { stages, rise, own_stages, own_rise, .. } = &self.room;
        let (told, own_told) = match self.at_main_nodes {
            true => (rise, own_rise),
            false => (stages, own_stages),
        };
        let sample = step.sample(step.start, &self.motion_behind);
        let own_sample = step.sample(&self.position, &self.behind);
        push(&mut self.terms, (&sample, told), (&own_sample, own_told), &mut self.scratch).map_err(said)?;
        leave_behind(&mut self.motion_behind, rise, stages);
        leave_behind(&mut self.behind, own_rise, own_stages);
        add(&mut self.position, 1.0, own_rise);
        Ok(())
    }
}

/// ∂²U − ∂F and −∂F/∂v at the points of a step.
struct Matrices<'a> {
    /// Where they do not depend on the point.
    stiffness: &'a Matrix<f64>,
    resistance: Option<&'a Matrix<f64>>,
    /// Point by point; none where they do not.
    stiffnesses: &'a [Matrix<f64>],
    resistances: &'a [Matrix<f64>],
}

impl<'a> Matrices<'a> {
    fn of(room: &'a TangentBuffers, stiffness: &'a Matrix<f64>, resistance: Option<&'a Matrix<f64>>) -> Self {
        Self { stiffness, resistance, stiffnesses: &room.stiffnesses, resistances: &room.resistances }
    }

    fn stiffness(&self, i: usize) -> &'a Matrix<f64> {
        self.stiffnesses.get(i).unwrap_or(self.stiffness)
    }

    fn resistance(&self, i: usize) -> Option<&'a Matrix<f64>> {
        self.resistances.get(i).or(self.resistance)
    }
}
