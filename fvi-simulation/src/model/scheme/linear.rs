//! Steps of a linear system on one quadrature node, once its equations are prepared.

use super::{AnyScheme, Form, Room};
use crate::model::space::AnySpace;
use fvi_core::{
    Block, Damping, Equations, Instant, Mechanics, Outcome, Real, Sample, State, Step, StepError, combine,
    combine_pair, combine_two, conclude,
};

/// A discrete Lagrangian of degree one with one quadrature point.
///
/// Its steps are those of [`DiscreteLagrangian`](fvi_core::DiscreteLagrangian), to the bit: what is asked
/// there is known here, so that a small system's step spends its instructions on its numbers, and goes along
/// them less often.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line<T> {
    damped_at_node: bool,
    weight: T,
    node: T,
    shape: T,
    test: T,
    kinetic: T,
}

impl<T: Real> Line<T> {
    /// The scheme as such a line, where the step to come is one: its equations are those that the room keeps
    /// a solver of, which solves them at once.
    #[inline(always)]
    pub(super) fn of<G: Mechanics<T, AnySpace>>(
        scheme: &AnyScheme<T>,
        room: &Room<T>,
        mechanics: &G,
        step: &Step<'_, T>,
    ) -> Option<Self> {
        if room.kept.length != step.size || !room.matrix.is_solved_at_once(&room.kept.solver) {
            return None;
        }
        let damped_at_node = match scheme.form {
            Form::MainNodes => false,
            Form::Nodes => true,
            Form::EndOfStep | Form::Collocation => return None,
        };
        let view = scheme.of_one_point()?;
        let (&[weight], &[node], &[shape]) = (view.weights, view.nodes, view.shapes) else { return None };
        let (&[test], &[kinetic]) = (view.tests, view.kinetic) else { return None };
        // A drift solves nothing, and exact moments are the business of others.
        let is_plain = test != T::zero() && !mechanics.is_rough();
        is_plain.then_some(Self { damped_at_node, weight, node, shape, test, kinetic })
    }

    /// Makes the step.
    pub(super) fn step<G: Mechanics<T, AnySpace>, D: Damping<T, AnySpace>>(
        &self,
        room: &mut Room<T>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<Vec<T>>,
    ) -> Result<u32, StepError> {
        let &Self { damped_at_node, weight, node, shape, test, kinetic } = self;
        let Room { increments, residual, stages, forces, known, scratch, carried, behind, .. } = room;
        let behind = carried.get_mut(..*behind).unwrap_or(&mut []);
        let (h, fractions) = (step.size, [if damped_at_node { node } else { T::one() }]);
        let (position, momentum) = (state.position.as_slice(), state.momentum.as_slice());
        // Filling them would be a call of the platform, which takes longer than few numbers do.
        combine(known, position, |_, _| T::zero());
        let sample = Sample { from: position, behind, time: step.time, length: h, fractions: &fractions };
        damping.add_known(&sample, known, scratch)?;

        let instant = Instant::in_step(step.time, node, h);
        let take_input = |forces: &mut [T]| {
            forces.iter_mut().zip(step.input).for_each(|(force, &input)| *force -= input);
        };
        let factor = h * weight * test;
        if damped_at_node {
            // From increments of zero, as a stiff motion at speed would be guessed so far off that its place
            // is lost in rounding.
            mechanics.restoring_force(instant, &state.position, forces);
            take_input(forces);
            combine(forces, known, |force, known| force + known);
            combine_two(residual, momentum, forces, |_, p, force| p + T::zero() - force * factor);
        } else {
            mechanics.drift(momentum, increments);
            combine_pair((increments, &mut room.point), position, |velocity, _, q| {
                let e = velocity * h;
                (e, q + e * shape)
            });
            mechanics.restoring_force(instant, &room.point, forces);
            take_input(forces);
            let start = (momentum, (factor, forces.as_slice()));
            mechanics.mass().balance(start, (kinetic / h, increments), residual);
        }
        room.matrix.solve_kept(&room.kept.solver, residual);
        // The node takes the place of what is left.
        combine_pair((increments, residual), position, |e, left, q| {
            let e = if damped_at_node { T::zero() } else { e } - left;
            (e, q + e * shape)
        });
        mechanics.restoring_force(instant, residual, forces);
        take_input(forces);
        let impulse = h * weight;
        if damped_at_node {
            combine(forces, known, |force, known| force + known);
            combine(stages, increments, |_, e| e * shape);
            damping.add_leading(stages, forces, scratch);
            combine(residual, forces, |_, force| -(force * impulse));
        } else {
            damping.add_leading(increments, known, scratch);
            combine_two(residual, forces, known, |_, force, known| -(force * impulse) - known * h);
        }
        let sampled = if damped_at_node { &*stages } else { &*increments };
        let found = Outcome { increments: sampled, rise: increments, kick: residual };
        conclude(damping, step, &fractions, &found, state, behind, scratch)?;
        Ok(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::language::Document;
    use crate::memory::MemoryRequest;
    use crate::model::matrices::Matrix;
    use crate::model::{Model, ScenarioSpace};
    use crate::numerics::transfer::TransferFunction;
    use crate::scenario::Scenario;
    use fvi_core::{DampingTerm, Derivative, Rounding, Scheme};
    use std::path::Path;

    const STEP: f64 = 0.05;

    fn chain(size: usize, convolution: &str) -> Scenario {
        let springs: String = (1..size).map(|i| format!(" + 2*(q{i} - q{})^2", i - 1)).collect();
        let numbers: Vec<f64> = (1..=size).map(|i| 0.5 + 0.1 * i as f64).collect();
        let text = format!(
            "[system]\nmass = {numbers:?}\npotential = \"2*q0^2{springs}\"\n[initial]\nposition = {numbers:?}\n\
             momentum = {numbers:?}\n[scheme]\nkind = \"low-order\"\nkappa = 0.5\n[convolution]\n{convolution}\n\
             [time]\nstep = {STEP}\nsteps = 100\n"
        );
        Scenario::from_document(Document::new("test.toml", Path::new(""), &text)).unwrap()
    }

    /// Position and momentum after steps that are made together, or each as if it were the first; how many
    /// of them were such lines.
    fn states(scenario: &Scenario, afresh: bool) -> (Vec<[Vec<f64>; 2]>, usize) {
        let size = scenario.coordinates();
        let space = AnySpace::dense(size);
        let mut model: Model<f64> = ScenarioSpace::<f64>::system(&space, scenario).unwrap();
        let scheme = AnyScheme::<f64>::new(scenario).unwrap();
        let request = MemoryRequest {
            convolution: &scenario.convolution,
            transfer: &TransferFunction::power(0.5).unwrap(),
            step_size: STEP,
            end: None,
            coordinates: size,
            motions: 1,
            samples: 101,
            given: false,
            history: &scenario.history,
        };
        let (kernel, memory) = (request.kernel().unwrap(), request.build::<f64>().unwrap());
        let rho = Matrix::Diagonal(vec![0.3; size]);
        let mut damping = DampingTerm::in_space(&space, kernel, rho, Derivative::Caputo, memory).unwrap();
        let position = scenario.initial.position.clone();
        damping.begin(&position, &vec![0.0; size]);
        if scheme.form == Form::MainNodes {
            let sample = Sample { from: &position, behind: &[], time: 0.0, length: 0.0, fractions: &[0.0] };
            let (rest, mut scratch) = (vec![0.0; size], vec![0.0; size]);
            damping.push(&sample, &rest, &mut scratch).unwrap();
        }
        let mut room = scheme.storage(&space, &model);
        let zeros = || vec![0.0; size];
        let rounding = Rounding { position: zeros(), momentum: zeros() };
        let mut state = State { step: 0, position, momentum: scenario.initial.momentum.clone(), rounding };
        let mut lines = 0;
        let made = (0..60).map(|index| {
            let time = f64::from(index) * STEP;
            let input: &[f64] = if index % 5 == 2 { &[0.25, -1.5] } else { &[] };
            let step = Step { time, end: time + STEP, size: STEP, input };
            if afresh {
                room.kept.length = 0.0;
            }
            lines += usize::from(Line::of(&scheme, &room, &model, &step).is_some());
            scheme.step(&mut room, &mut model, &mut damping, &step, &mut state).unwrap();
            [state.position.clone(), state.momentum.clone()]
        });
        (made.collect(), lines)
    }

    #[test]
    fn prepared_steps_have_the_bits_of_those_that_prepare() {
        for convolution in ["at = \"nodes\"\norder = 2", "at = \"main-nodes\"\norder = 1"] {
            for size in [8, 11, 19] {
                let scenario = chain(size, convolution);
                let ((found, lines), (expected, none)) = (states(&scenario, false), states(&scenario, true));
                assert_eq!((lines, none), (59, 0), "{size}: {convolution}");
                assert!(found == expected, "{size}: {convolution}");
            }
        }
    }
}
