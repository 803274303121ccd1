//! The schemes of scenarios: any degree, any quadrature, known at run time.

use super::space::{Matrix, MatrixSpace};
use crate::scenario::{ConvolutionFamily, DampedAt, Quadrature, Scenario, Scheme as ScenarioScheme};
use fvi_core::{
    Damping, DiscreteLagrangian, ExplicitEuler, Galerkin, ImplicitEuler, Kept, Mechanics, ParameterError,
    Real, RungeKutta, Sampling, Scheme, State, Step, StepError, Tables, Workspace, gauss_rule, lobatto_rule,
};

/// Any of the core's schemes, its tables on the heap.
#[derive(Clone, Debug)]
pub struct AnyScheme<T> {
    weights: Vec<T>,
    nodes: Vec<T>,
    control_points: Vec<T>,
    shapes: Vec<T>,
    tests: Vec<T>,
    kinetic: Vec<T>,
    form: Form,
}

/// Where the fractional force acts, and what the memory stores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    /// At q_{k+1}, in the new momentum only; the main nodes.
    MainNodes,
    /// At the end of the step, in all equations; the main nodes.
    EndOfStep,
    /// At the quadrature nodes; these.
    Nodes,
}

impl<T: Real> AnyScheme<T> {
    /// The scheme of a scenario.
    ///
    /// # Errors
    /// If degree, points and stages do not go together.
    pub fn new(scenario: &Scenario) -> Result<Self, ParameterError> {
        let form = match scenario.convolution.at {
            DampedAt::MainNodes => Form::MainNodes,
            DampedAt::Nodes => Form::Nodes,
        };
        let degree = match scenario.scheme {
            ScenarioScheme::LowOrder { kappa } => {
                return Ok(Self::of(&Galerkin::low_order(T::of(kappa))?, form));
            }
            ScenarioScheme::ExplicitEuler => {
                return Ok(Self::of(&ExplicitEuler::coefficients(), Form::MainNodes));
            }
            ScenarioScheme::ImplicitEuler => {
                return Ok(Self::of(&ImplicitEuler::coefficients(), Form::EndOfStep));
            }
            ScenarioScheme::Galerkin { degree, .. } => degree,
        };
        let rule = match scenario.convolution.family {
            ConvolutionFamily::Bdf { .. } => {
                Rule::of(scenario.scheme.quadrature().unwrap_or(Quadrature::Gauss(degree)))?
            }
            ConvolutionFamily::RadauIia { stages } => Rule::radau_iia(stages)?,
            ConvolutionFamily::LobattoIiic { stages } => Rule::lobatto_iiic(stages)?,
        };
        Self::galerkin(degree, &rule, form)
    }

    fn galerkin(degree: usize, rule: &Rule, form: Form) -> Result<Self, ParameterError> {
        let points = rule.nodes.len();
        let numbers = |count: usize| vec![T::zero(); count];
        let mut scheme = Self {
            weights: super::vector(&rule.weights),
            nodes: super::vector(&rule.nodes),
            control_points: numbers(degree),
            shapes: numbers(points * degree),
            tests: numbers(points * degree),
            kinetic: numbers(degree * degree),
            form,
        };
        let tables = Tables {
            control_points: &mut scheme.control_points,
            shapes: &mut scheme.shapes,
            tests: &mut scheme.tests,
            kinetic: &mut scheme.kinetic,
        };
        tables.fill(&rule.nodes, &rule.weights)?;
        Ok(scheme)
    }

    fn of(galerkin: &Galerkin<T, 1, 1>, form: Form) -> Self {
        let view = galerkin.view();
        Self {
            weights: view.weights.to_vec(),
            nodes: view.nodes.to_vec(),
            control_points: view.control_points.to_vec(),
            shapes: view.shapes.to_vec(),
            tests: view.tests.to_vec(),
            kinetic: view.kinetic.to_vec(),
            form,
        }
    }

    /// The discrete Lagrangian.
    pub fn view(&self) -> DiscreteLagrangian<'_, T> {
        DiscreteLagrangian {
            weights: &self.weights,
            nodes: &self.nodes,
            control_points: &self.control_points,
            shapes: &self.shapes,
            tests: &self.tests,
            kinetic: &self.kinetic,
        }
    }
}

/// A quadrature on [0, 1].
struct Rule {
    nodes: Vec<f64>,
    weights: Vec<f64>,
}

impl Rule {
    fn of(quadrature: Quadrature) -> Result<Self, ParameterError> {
        let points = quadrature.points();
        let (mut nodes, mut weights) = (vec![0.0; points], vec![0.0; points]);
        match quadrature {
            Quadrature::Gauss(_) => gauss_rule(&mut nodes, &mut weights)?,
            Quadrature::Lobatto(_) => lobatto_rule(&mut nodes, &mut weights)?,
        }
        Ok(Self { nodes, weights })
    }

    fn radau_iia(stages: usize) -> Result<Self, ParameterError> {
        match stages {
            1 => Ok(Self::of_method(&RungeKutta::<1>::radau_iia()?)),
            2 => Ok(Self::of_method(&RungeKutta::<2>::radau_iia()?)),
            _ => Ok(Self::of_method(&RungeKutta::<3>::radau_iia()?)),
        }
    }

    fn lobatto_iiic(stages: usize) -> Result<Self, ParameterError> {
        match stages {
            2 => Ok(Self::of_method(&RungeKutta::<2>::lobatto_iiic()?)),
            3 => Ok(Self::of_method(&RungeKutta::<3>::lobatto_iiic()?)),
            _ => Ok(Self::of_method(&RungeKutta::<4>::lobatto_iiic()?)),
        }
    }

    fn of_method<const R: usize>(method: &RungeKutta<R>) -> Self {
        let quadrature = method.quadrature();
        Self { nodes: quadrature.nodes().to_vec(), weights: quadrature.weights().to_vec() }
    }
}

/// The room of a step, and what a linear system keeps between steps.
pub struct Room<T: Real, X: MatrixSpace<T>> {
    increments: Vec<T>,
    residual: Vec<T>,
    stages: Vec<T>,
    forces: Vec<T>,
    known: Vec<T>,
    scratch: Vec<T>,
    behind: Vec<T>,
    excess: Vec<T>,
    point: Vec<T>,
    stiffness: Matrix<T>,
    matrix: X::Equations,
    kept: Kept<X::Kept>,
}

impl<T: Real, X: MatrixSpace<T>> Scheme<T, X> for AnyScheme<T> {
    type Storage = Room<T, X>;

    fn storage<G: Mechanics<T, X>>(&self, space: &X, mechanics: &G) -> Room<T, X> {
        let (size, degree, points) = (space.coordinates(), self.control_points.len(), self.nodes.len());
        let samples = Scheme::<T, X>::sampling(self).nodes();
        let numbers = |count: usize| vec![T::zero(); count * size];
        Room {
            increments: numbers(degree),
            residual: numbers(degree),
            stages: numbers(points),
            forces: numbers(points),
            known: numbers(samples),
            scratch: numbers(samples + 1),
            excess: numbers(degree + 1),
            behind: numbers(if self.form == Form::Nodes { points } else { 0 }),
            point: numbers(1),
            stiffness: mechanics.stiffness(),
            matrix: space.equations(degree),
            kept: Kept::nothing(X::Kept::default()),
        }
    }

    fn behind(room: &Room<T, X>) -> &[T] {
        &room.behind
    }

    fn behind_mut(room: &mut Room<T, X>) -> &mut [T] {
        &mut room.behind
    }

    fn sampling(&self) -> Sampling<'_, T> {
        match self.form {
            Form::MainNodes | Form::EndOfStep => Sampling::MainNodes,
            Form::Nodes => Sampling::Nodes(&self.nodes),
        }
    }

    fn step<G: Mechanics<T, X>, D: Damping<T, X>>(
        &self,
        room: &mut Room<T, X>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<Vec<T>>,
    ) -> Result<u32, StepError> {
        let mut work = Workspace::<T, X, _> {
            increments: &mut room.increments,
            residual: &mut room.residual,
            stages: &mut room.stages,
            forces: &mut room.forces,
            known: &mut room.known,
            scratch: &mut room.scratch,
            behind: &mut room.behind,
            excess: &mut room.excess,
            point: &mut room.point,
            stiffness: &mut room.stiffness,
            matrix: &mut room.matrix,
            kept: &mut room.kept,
        };
        match self.form {
            Form::MainNodes => {
                self.view().step_damped_at_main_nodes(&mut work, mechanics, damping, step, state)
            }
            Form::EndOfStep | Form::Nodes => {
                self.view().step_damped_at_nodes(&mut work, mechanics, damping, step, state)
            }
        }
    }
}
