//! One step of the derivatives.

use super::points::{Points, Step, StepMatrix};
use super::{Tangent, TangentBuffers, Term, add, add_leading, known, leave_behind, push, said, whole};
use crate::model::StepShape;
use fvi_core::{Block, Mechanics, Memory};
use std::sync::Arc;

impl Tangent {
    /// Computes the derivatives after the step that began at this position and momentum and was solved with
    /// these increments, for collocation with these accelerations.
    ///
    /// # Errors
    /// A message.
    pub(super) fn make(
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

    /// The points of the step, and for collocation δv_k and h c_i δv_k.
    fn place_points(&mut self, step: &Step<'_>) {
        self.points.place(&mut self.model, step);
        if !step.shape.is_collocation() {
            return;
        }
        let (n, c, h) = (self.size, self.size * self.count, self.step);
        let TangentBuffers { right, base, start_velocities, .. } = &mut self.room;
        for (parameter, change) in self.mass_changes.iter().enumerate() {
            right.copy_from_slice(&self.momentum[parameter * n..][..n]);
            change.iter().for_each(|&(row, column)| right[row] -= self.points.start_velocity[column]);
            self.model.velocity(right, &mut start_velocities[parameter * n..][..n]);
        }
        for (base, node) in base.chunks_mut(c).zip(step.shape.nodes()) {
            base.iter_mut().zip(&*start_velocities).for_each(|(b, v)| *b = h * node * v);
        }
    }

    /// The known part of ρ D δX, δρ D X, and ρ (∂D) X, at every node of the memories.
    fn recall(&mut self, step: &Step<'_>) -> Result<(), String> {
        let (n, c, nodes) = (self.size, self.size * self.count, step.fractions.len());
        let TangentBuffers { damped, derivative, terms, .. } = &mut self.room;
        let Points { stages, rise, .. } = &self.points;
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
        self.points.linearise(&mut self.model, step, !self.solver.is_ready());
        let Self { points, room, direct, position, terms, kicks, .. } = self;
        let TangentBuffers { forces, damped, base, start_velocities, .. } = room;
        forces.fill(0.0);
        for i in 0..step.shape.points() {
            let (instant, stiffness) = (points.instant(step, i), points.stiffness(i));
            for (direct, force) in direct.iter_mut().zip(forces[i * c..][..c].chunks_mut(n)) {
                direct.iter_mut().for_each(|part| part.add(instant, points.at(i), force));
            }
            for (parameter, force) in forces[i * c..][..c].chunks_mut(n).enumerate() {
                stiffness.multiply_add(1.0, &position[parameter * n..][..n], force);
                if step.shape.is_collocation() {
                    stiffness.multiply_add(1.0, &base[i * c + parameter * n..][..n], force);
                    if let Some(resistance) = points.resistance(i) {
                        resistance.multiply_add(1.0, &start_velocities[parameter * n..][..n], force);
                    }
                }
            }
            if !*kicks {
                add(&mut forces[i * c..][..c], 1.0, &damped[i * c..][..c]);
            }
            if step.shape.is_collocation() {
                add_leading(terms, (i, nodes), base, n, &mut forces[i * c..][..c]);
            }
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
        let acting = if self.kicks { &[][..] } else { &self.terms };
        let leading = |term: &Term| {
            let places = (0..nodes).flat_map(|i| (0..nodes).map(move |j| (i, j)));
            places.map(|(i, j)| term.tangent.leading(0, nodes, i, j)).collect()
        };
        let matrix = StepMatrix {
            mass: self.model.mass(),
            points: &self.points,
            dampers: acting.iter().map(|term| (&term.rho, leading(term))).collect(),
            gyroscopic: self.gyroscopic.as_ref().filter(|_| !self.kicks),
        };
        self.solver.factor((shape.degree(), n), matrix.mass, |insert| matrix.visit(shape, nodes, insert))
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
        let points = &self.points;
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
                own.for_each(|(force, own)| points.stiffness(i).multiply_add(1.0, own, force));
                if let Some(resistance) = points.resistance(i) {
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
        let TangentBuffers { own_stages, own_rise, .. } = &self.room;
        let Points { stages, rise, .. } = &self.points;
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
