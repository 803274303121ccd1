//! One coordinate, one quadrature point: steps so short that everything lies in place.

use super::mechanics::{SingleModel, matrix};
use super::scenario_space::{Remembers, ScenarioSpace, derivative};
use super::scheme::{AnyScheme, DenseOutput};
use crate::language::expression::Elementary;
use crate::scenario::{self, DampedAt, Scenario};
use core::ops::Range;
use fvi_core::{
    Block, Coefficients, Damping, DampingError, DampingTerm, DiscreteLagrangian, Factors, Fixed, Kept,
    Kernel, MatrixError, Mechanics, Memory, ParameterError, Real, Sampling, Scheme, State, Step, StepError,
    StepMatrix, Workspace, add_multiple,
};
use nalgebra::SVector;

/// A discrete Lagrangian of degree one with one quadrature point, its tables in place.
#[derive(Clone, Debug)]
pub struct OnePoint<T> {
    at: DampedAt,
    weight: [T; 1],
    node: [T; 1],
    end: [T; 1],
    shape: [T; 1],
    test: [T; 1],
    kinetic: [T; 1],
}

impl<T: Real> OnePoint<T> {
    /// The same scheme in place, if it is of this kind.
    pub fn of(scheme: &AnyScheme<T>) -> Option<Self> {
        let at = scheme.one_point_form()?;
        let view = scheme.of_one_point()?;
        let one = |numbers: &[T]| <[T; 1]>::try_from(numbers).ok();
        let (weight, node, end) = (one(view.weights)?, one(view.nodes)?, one(view.control_points)?);
        let (shape, test, kinetic) = (one(view.shapes)?, one(view.tests)?, one(view.kinetic)?);
        Some(Self { at, weight, node, end, shape, test, kinetic })
    }

    #[inline(always)]
    fn view(&self) -> DiscreteLagrangian<'_, T> {
        DiscreteLagrangian {
            weights: &self.weight,
            nodes: &self.node,
            control_points: &self.end,
            shapes: &self.shape,
            tests: &self.test,
            kinetic: &self.kinetic,
        }
    }
}

impl<T: Elementary> OnePoint<T> {
    /// Whether a scenario is stepped by such a scheme in the space of one coordinate.
    pub fn serves(scenario: &Scenario) -> bool {
        SingleModel::<T>::serves(scenario)
            && scenario.system.damping.iter().all(|term| term.attached.is_none())
            && AnyScheme::<T>::new(scenario).is_ok_and(|scheme| Self::of(&scheme).is_some())
    }
}

/// What a [`OnePoint`] scheme keeps between steps.
#[derive(Clone, Debug)]
pub struct OnePointRoom<T> {
    kept: Kept<Factors<T, 1, 1>, T>,
    /// q_k − X_{k−1}, and what pulled there.
    carried: [T; 2],
    /// Which of them there are: the first where the memory stores the quadrature node, the second where the
    /// system is not linear.
    present: Range<usize>,
    /// q_{k+1} − q_k of the last step.
    increment: [T; 1],
}

impl<T: Real> Scheme<T, Fixed<1>> for OnePoint<T> {
    type Storage = OnePointRoom<T>;

    fn storage<G: Mechanics<T, Fixed<1>>>(&self, _: &Fixed<1>, mechanics: &G) -> OnePointRoom<T> {
        OnePointRoom {
            kept: Kept::nothing(Factors::zero()),
            carried: [T::zero(); 2],
            present: usize::from(self.at != DampedAt::Nodes)..2 - usize::from(mechanics.is_linear()),
            increment: [T::zero()],
        }
    }

    fn carried(room: &OnePointRoom<T>) -> &[T] {
        &room.carried[room.present.clone()]
    }

    fn carried_mut(room: &mut OnePointRoom<T>) -> &mut [T] {
        &mut room.carried[room.present.clone()]
    }

    fn sampling(&self) -> Sampling<'_, T> {
        match self.at {
            DampedAt::MainNodes => Sampling::MainNodes,
            DampedAt::Nodes => Sampling::Nodes(&self.node),
        }
    }

    #[inline]
    fn step<G: Mechanics<T, Fixed<1>>, D: Damping<T, Fixed<1>>>(
        &self,
        room: &mut OnePointRoom<T>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<SVector<T, 1>>,
    ) -> Result<u32, StepError> {
        let number = || [T::zero()];
        let (mut increments, mut residual, mut stages, mut forces) = (number(), number(), number(), number());
        let (mut known, mut scratch, mut excess) = (number(), [T::zero(); 2], [T::zero(); 2]);
        let (behind, pull) = room.carried.split_at_mut(1);
        let mut work = Workspace::<T, Fixed<1>, StepMatrix<T, 1, 1>> {
            increments: &mut increments,
            residual: &mut residual,
            stages: &mut stages,
            forces: &mut forces,
            known: &mut known,
            scratch: &mut scratch,
            behind: if room.present.start == 0 { behind } else { &mut [] },
            pull: if room.present.end == 2 { pull } else { &mut [] },
            excess: &mut excess,
            point: &mut SVector::zeros(),
            stiffness: &mut mechanics.stiffness(),
            matrix: &mut StepMatrix::zero(),
            kept: &mut room.kept,
        };
        let made = match self.at {
            DampedAt::MainNodes => {
                self.view().step_damped_at_main_nodes(&mut work, mechanics, damping, step, state)
            }
            DampedAt::Nodes => self.view().step_damped_at_nodes(&mut work, mechanics, damping, step, state),
        };
        room.increment = increments;
        made
    }
}

impl<T: Real> DenseOutput<T, Fixed<1>> for OnePoint<T> {
    fn solution(room: &OnePointRoom<T>) -> &[T] {
        &room.increment
    }

    fn look_into(
        &self,
        solution: &[T],
        mechanics: &impl Mechanics<T, Fixed<1>>,
        (length, fraction): (T, T),
        position: &mut [T],
        momentum: &mut [T],
    ) {
        // A straight line.
        let Some(&increment) = solution.first() else { return };
        add_multiple(position, fraction, solution);
        momentum.fill(T::zero());
        mechanics.mass().multiply_add(T::one(), &[increment * (T::one() / length)], momentum);
    }
}

impl<T: Elementary, M: Memory<T>> Remembers<M> for DampingTerm<T, Fixed<1>, M> {
    fn memory(&self) -> &M {
        DampingTerm::memory(self)
    }
}

impl<T: Elementary> ScenarioSpace<T> for Fixed<1> {
    type System = SingleModel<T>;
    type Scheme = OnePoint<T>;
    type Term<M: Memory<T>> = DampingTerm<T, Self, M>;

    fn system(&self, scenario: &Scenario) -> Result<SingleModel<T>, MatrixError> {
        SingleModel::new(scenario)
    }

    fn scheme(&self, scenario: &Scenario) -> Result<OnePoint<T>, ParameterError> {
        let allowed = "a scheme of degree 1 with one point";
        let other = ParameterError { parameter: "scheme", value: f64::NAN, allowed };
        OnePoint::of(&AnyScheme::new(scenario)?).ok_or(other)
    }

    fn vector(&self, numbers: &[f64]) -> SVector<T, 1> {
        SVector::from_iterator(numbers.iter().map(|&number| T::of(number)))
    }

    fn channels(&self, _: &scenario::Damping) -> usize {
        1
    }

    fn follow_alike(&self, _: &scenario::Damping, _: &scenario::Damping) -> bool {
        // One coordinate's exponentials are few, and steps of a known size know terms one by one.
        false
    }

    fn term<M: Memory<T>>(
        &self,
        terms: &[(&scenario::Damping, Kernel)],
        memory: M,
    ) -> Result<DampingTerm<T, Self, M>, DampingError> {
        let (term, kernel) = terms[0];
        let mut rho = [T::zero()];
        matrix(&term.coefficient).multiply_add(T::one(), &[T::one()], &mut rho);
        DampingTerm::new(kernel, Coefficients::Diagonal(rho.into()), derivative(term), memory)
    }
}
