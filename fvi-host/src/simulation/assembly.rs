//! System, scheme and memories put together.

use super::Stepper;
use crate::engine::{EngineError, HostMemory, MemoryRequest};
use crate::expression::Elementary;
use crate::model::{self, ExpressionForce, ExpressionPotential, ScenarioSystem};
use crate::scenario::{self, Engine, InputError, Problem, Scenario};
use crate::stability;
use fvi_core::{
    AffineForce, Damping, DampingTerm, Derivative, Force, Instant, Integrator, Memory, MemoryError,
    MemoryShape, Potential, Scheme, StepError,
};
use fvi_fft::Scalar;
use nalgebra::{DMatrix, SMatrix, SVector};

/// Refuses a step at which motions near the start grow.
pub(super) fn check_step<const N: usize>(scenario: &Scenario) -> Result<(), InputError> {
    let system = system::<f64, N>(scenario)?;
    let position = model::vector(&scenario.initial.position);
    let instant = Instant::in_step(0.0, 0.5, scenario.time.step);
    let stiffness: SMatrix<f64, N, N> =
        system.potential.hessian(&position) - system.force.jacobian(instant, &position);
    stability::check_step(scenario, &DMatrix::from_fn(N, N, |i, j| stiffness[(i, j)]))
}

fn system<T: Elementary, const N: usize>(scenario: &Scenario) -> Result<ScenarioSystem<T, N>, InputError> {
    model::system(scenario)
        .map_err(|error| scenario.error_at("system.mass", Problem::Precision { reason: error.to_string() }))
}

/// What the memory of a damping term is wanted for.
pub(super) fn memory_request<'a>(scenario: &'a Scenario, term: &scenario::Damping) -> MemoryRequest<'a> {
    MemoryRequest {
        convolution: &scenario.convolution,
        exponent: term.order,
        step_size: scenario.time.step,
        coordinates: scenario.coordinates(),
        samples: scenario.time.steps.saturating_add(1),
        history: &scenario.history,
    }
}

/// Puts system, scheme and memories together.
pub(super) fn assemble<T, const N: usize, const R: usize, S>(
    scenario: &Scenario,
    scheme: S,
) -> Result<Box<dyn Stepper>, InputError>
where
    T: Elementary + Scalar,
    S: Scheme<T, N, R> + 'static,
{
    let terms = scenario.system.damping.iter().enumerate();
    let terms =
        terms.map(|(index, term)| damping_term(scenario, index, term)).collect::<Result<Vec<_>, _>>()?;
    let integrator = Integrator::new(
        system::<T, N>(scenario)?,
        scheme,
        DampingTerms(terms),
        T::of(scenario.time.step),
        model::vector(&scenario.initial.position),
        model::vector(&scenario.initial.momentum),
    )
    .map_err(|error| scenario.error_at("time.step", Problem::Precision { reason: error.to_string() }))?;
    Ok(Box::new(integrator))
}

fn damping_term<T: Elementary + Scalar, const N: usize>(
    scenario: &Scenario,
    index: usize,
    term: &scenario::Damping,
) -> Result<DampingTerm<T, N, HostMemory<T>>, InputError> {
    let memory = memory_request(scenario, term).build().map_err(|error| match error {
        EngineError::Table(_) | EngineError::NoRoom { .. } => {
            scenario.error_at("history.engine", Problem::Engine(error))
        }
        EngineError::Parameter(_) => {
            scenario.error_at(&format!("system.damping[{index}].order"), Problem::Engine(error))
        }
    })?;
    let derivative = match term.derivative {
        scenario::Derivative::RiemannLiouville => Derivative::RiemannLiouville,
        scenario::Derivative::Caputo => Derivative::Caputo,
    };
    DampingTerm::new(model::coefficients(&term.coefficient), T::of(term.order), derivative, memory).map_err(
        |error| {
            let path = format!("system.damping[{index}]");
            scenario.error_at(&path, Problem::Precision { reason: error.to_string() })
        },
    )
}

/// Any number of damping terms, each with a memory of its own.
struct DampingTerms<T, const N: usize>(Vec<DampingTerm<T, N, HostMemory<T>>>);

impl<T: Elementary, const N: usize, const R: usize> Damping<T, N, R> for DampingTerms<T, N> {
    fn check_shape(&self) -> Result<(), MemoryShape> {
        self.0.iter().try_for_each(Damping::<T, N, R>::check_shape)
    }

    fn begin(&mut self, position: &SVector<T, N>, velocity: &SVector<T, N>) {
        self.0.iter_mut().for_each(|term| Damping::<T, N, R>::begin(term, position, velocity));
    }

    fn add_force(
        &mut self,
        from: &SVector<T, N>,
        times: &[T; R],
        force: &mut AffineForce<T, N, R>,
    ) -> Result<(), MemoryError> {
        self.0.iter_mut().try_for_each(|term| term.add_force(from, times, force))
    }

    fn push(&mut self, positions: &[SVector<T, N>; R], times: &[T; R]) -> Result<(), MemoryError> {
        self.0.iter_mut().try_for_each(|term| term.push(positions, times))
    }
}

impl<T, const N: usize, const R: usize, S> Stepper
    for Integrator<T, N, R, ExpressionPotential, ExpressionForce, S, DampingTerms<T, N>>
where
    T: Elementary,
    S: Scheme<T, N, R>,
{
    fn step(&mut self, input: &[f64]) -> Result<u32, StepError> {
        Self::step(self, &model::vector(input))
    }

    fn time(&self) -> f64 {
        Self::time(self).to_f64()
    }

    fn read(&self, position: &mut [f64], momentum: &mut [f64]) {
        let state = self.state();
        position.iter_mut().zip(state.position.iter()).for_each(|(place, number)| *place = number.to_f64());
        momentum.iter_mut().zip(state.momentum.iter()).for_each(|(place, number)| *place = number.to_f64());
    }

    fn energy(&self) -> f64 {
        Self::energy(self).to_f64()
    }

    fn engines(&self) -> Vec<Engine> {
        self.damping().0.iter().map(|term| term.memory().engine()).collect()
    }

    fn overruns(&self) -> Option<usize> {
        self.damping().0.iter().filter_map(|term| term.memory().overruns()).reduce(|sum, more| sum + more)
    }

    fn memory_bytes(&self) -> usize {
        self.damping().0.iter().map(|term| term.memory().bytes()).sum()
    }
}
