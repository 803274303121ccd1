//! The points of a step: where they lie, and the derivatives of the forces there.

use super::add;
use crate::model::{Matrix, Model, StepShape};
use crate::simulation::tangent::Turning;
use fvi_core::{Instant, Mechanics, Sample};

/// A step of the motion whose derivatives are computed.
#[derive(Clone, Copy)]
pub(in crate::simulation) struct Step<'a> {
    pub(in crate::simulation) shape: StepShape<'a>,
    /// Time of its beginning, and its length.
    pub(in crate::simulation) time: f64,
    pub(in crate::simulation) length: f64,
    /// q_k and p_k.
    pub(in crate::simulation) start: &'a [f64],
    pub(in crate::simulation) momentum: &'a [f64],
    /// The unknowns that solved it.
    pub(in crate::simulation) unknowns: &'a [f64],
    /// Fractions of the step at which memories take samples.
    pub(in crate::simulation) fractions: &'a [f64],
}

impl<'a> Step<'a> {
    /// e^μ of n coordinates.
    pub(in crate::simulation) fn unknown(&self, mu: usize, n: usize) -> &'a [f64] {
        &self.unknowns[mu * n..][..n]
    }

    /// The sample of a memory.
    pub(in crate::simulation) fn sample<'s>(&'s self, from: &'s [f64], behind: &'s [f64]) -> Sample<'s, f64> {
        Sample { from, behind, time: self.time, length: self.length, fractions: self.fractions }
    }
}

/// The points X_i of a step, the velocities V_i there, and the matrices ∂²U − ∂F and −∂F/∂v.
pub(in crate::simulation) struct Points {
    /// X_i − q_k: R n numbers.
    pub(in crate::simulation) stages: Vec<f64>,
    /// q_{k+1} − q_k.
    pub(in crate::simulation) rise: Vec<f64>,
    /// v_k of collocation.
    pub(in crate::simulation) start_velocity: Vec<f64>,
    /// X_i, and V_i if forces depend on it.
    places: Vec<Vec<f64>>,
    velocities: Vec<Vec<f64>>,
    /// ∂²U − ∂F and, if forces depend on the velocity, −∂F/∂v: where they do not depend on the point.
    stiffness: Matrix<f64>,
    resistance: Option<Matrix<f64>>,
    /// Point by point; none where they do not.
    stiffnesses: Vec<Matrix<f64>>,
    resistances: Vec<Matrix<f64>>,
    restoring: Vec<f64>,
}

impl Points {
    pub(in crate::simulation) fn new(model: &Model<f64>, n: usize, points: usize) -> Self {
        Self {
            stages: vec![0.0; points * n],
            rise: vec![0.0; n],
            start_velocity: vec![0.0; n],
            places: vec![vec![0.0; n]; points],
            velocities: vec![vec![0.0; n]; points],
            stiffness: model.stiffness(),
            resistance: Mechanics::depends_on_velocity(model).then(|| model.stiffness()),
            stiffnesses: Vec::new(),
            resistances: Vec::new(),
            restoring: vec![0.0; n],
        }
    }

    /// Determines X_i, V_i and q_{k+1} − q_k.
    pub(in crate::simulation) fn place(&mut self, model: &mut Model<f64>, step: &Step<'_>) {
        let (n, shape) = (self.rise.len(), step.shape);
        let points = shape.points();
        let Self { stages, rise, start_velocity, places, velocities, .. } = self;
        stages.fill(0.0);
        velocities.iter_mut().for_each(|velocity| velocity.fill(0.0));
        if shape.is_collocation() {
            model.velocity(step.momentum, start_velocity);
            for (i, node) in shape.nodes().iter().enumerate() {
                add(&mut stages[i * n..][..n], step.length * node, start_velocity);
                velocities[i].copy_from_slice(start_velocity);
            }
        }
        for i in 0..points {
            for mu in 0..shape.degree() {
                add(&mut stages[i * n..][..n], shape.displacement(i, mu), step.unknown(mu, n));
                if self.resistance.is_some() {
                    add(&mut velocities[i], shape.slope(i, mu), step.unknown(mu, n));
                }
            }
            let place = places[i].iter_mut();
            place.zip(step.start.iter().zip(&stages[i * n..])).for_each(|(x, (q, e))| *x = q + e);
        }
        match shape.is_collocation() {
            true => rise.copy_from_slice(&stages[(points - 1) * n..]),
            false => rise.copy_from_slice(step.unknown(shape.degree() - 1, n)),
        }
    }

    /// Determines the matrices at every point; those of a linear system only if `anew`.
    pub(in crate::simulation) fn linearise(&mut self, model: &mut Model<f64>, step: &Step<'_>, anew: bool) {
        let (linear, points) = (Mechanics::is_linear(model), step.shape.points());
        self.stiffnesses.clear();
        self.resistances.clear();
        if linear && !anew {
            return;
        }
        for i in 0..if linear { 1 } else { points } {
            let instant = self.instant(step, i);
            let Self { places, velocities, stiffness, resistance, restoring, .. } = self;
            let (place, velocity) = (&places[i], &velocities[i]);
            match resistance {
                Some(resistance) => {
                    model.linearise_in_motion(instant, place, velocity, restoring, stiffness);
                    model.resistance(instant, place, velocity, resistance);
                }
                None => model.linearise(instant, place, restoring, stiffness),
            }
            if !linear && points > 1 {
                self.stiffnesses.push(self.stiffness.clone());
                self.resistances.extend(self.resistance.clone());
            }
        }
    }

    /// The instant of point i.
    pub(in crate::simulation) fn instant(&self, step: &Step<'_>, i: usize) -> Instant<f64> {
        Instant::in_step(step.time, step.shape.nodes()[i], step.length)
    }

    /// X_i and V_i.
    pub(in crate::simulation) fn at(&self, i: usize) -> (&[f64], &[f64]) {
        (&self.places[i], &self.velocities[i])
    }

    /// ∂²U − ∂F at X_i.
    pub(in crate::simulation) fn stiffness(&self, i: usize) -> &Matrix<f64> {
        self.stiffnesses.get(i).unwrap_or(&self.stiffness)
    }

    /// −∂F/∂v there, if forces depend on the velocity.
    pub(in crate::simulation) fn resistance(&self, i: usize) -> Option<&Matrix<f64>> {
        self.resistances.get(i).or(self.resistance.as_ref())
    }
}

/// What the matrix of a step consists of besides its shape and the matrices at its points.
pub(in crate::simulation) struct StepMatrix<'a> {
    pub(in crate::simulation) mass: &'a Matrix<f64>,
    pub(in crate::simulation) points: &'a Points,
    /// ρ_m and the leading weights, R×R numbers row by row, of the terms that act in the equations of the
    /// unknowns.
    pub(in crate::simulation) dampers: Vec<(&'a Matrix<f64>, Vec<f64>)>,
    pub(in crate::simulation) gyroscopic: Option<&'a Turning>,
}

impl StepMatrix<'_> {
    /// Hands on the blocks: row ν, column μ, a factor and a matrix, for the samples of `nodes` nodes.
    pub(in crate::simulation) fn visit(
        &self,
        shape: StepShape<'_>,
        nodes: usize,
        mut insert: impl FnMut(usize, usize, f64, &Matrix<f64>),
    ) {
        for nu in 0..shape.degree() {
            for mu in 0..shape.degree() {
                insert(nu, mu, shape.inertia(nu, mu), self.mass);
                for i in 0..shape.points() {
                    let factor = shape.part(i, nu);
                    insert(nu, mu, factor * shape.displacement(i, mu), self.points.stiffness(i));
                    if let Some(resistance) = self.points.resistance(i) {
                        insert(nu, mu, factor * shape.slope(i, mu), resistance);
                    }
                    for (rho, leading) in &self.dampers {
                        let weight = |j: usize| leading[i * nodes + j] * shape.displacement(j, mu);
                        insert(nu, mu, factor * (0..nodes).map(weight).sum::<f64>(), rho);
                    }
                    let Some(gyroscopic) = self.gyroscopic else { continue };
                    gyroscopic.visit(|row, j, weight, skew| {
                        if row == i {
                            insert(nu, mu, factor * weight * shape.displacement(j, mu), skew);
                        }
                    });
                }
            }
        }
    }
}
