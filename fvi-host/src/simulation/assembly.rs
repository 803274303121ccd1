//! System, scheme and memories put together.

use super::Stepper;
use crate::engine::{EngineError, HostMemory, MemoryRequest};
use crate::expression::Elementary;
use crate::model::{self, ExpressionForce, ExpressionPotential, ScenarioSystem};
use crate::scenario::{self, ConvolutionFamily, Engine, InputError, Problem, Scenario};
use crate::stage_stability::{LinearSystem, StageDamping, check_stage_stability};
use fvi_core::{
    AffineForce, BdfOrder, Damping, DampingTerm, Derivative, ExplicitDamping, Force, Galerkin, Instant,
    Integrator, Mass, Memory, MemoryError, MemoryShape, ParameterError, Potential, RungeKutta, Scheme,
    Stability, StepError, check_stability,
};
use fvi_fft::Scalar;
use nalgebra::{SMatrix, SVector};

/// Refuses a step that is too long for the explicit fractional force.
pub(super) fn check_step<const N: usize, const S: usize, const Q: usize>(
    scenario: &Scenario,
    scheme: &Galerkin<f64, S, Q>,
) -> Result<(), InputError> {
    let ConvolutionFamily::Bdf { order } = scenario.convolution.family else { return Ok(()) };
    if scenario.time.allow_unstable {
        return Ok(());
    }
    let bdf_order = BdfOrder::new(order).map_err(|_| {
        scenario.error_at("convolution.order", Problem::OutOfRange { allowed: "1 to 6".to_owned() })
    })?;
    let explicit = |term: &scenario::Damping| ExplicitDamping {
        coefficients: model::coefficients(&term.coefficient),
        damping_order: term.order,
        bdf_order,
    };
    let damping: Vec<ExplicitDamping<f64, N>> = scenario.system.damping.iter().map(explicit).collect();
    let (mass, stiffness) = mass_and_stiffness(scenario)?;
    judge(scenario, check_stability(scheme, &mass, &stiffness, &damping, scenario.time.step))
}

/// Refuses a step at which the damping at the stages of a Runge–Kutta method makes a motion grow.
pub(super) fn check_stage_step<const N: usize, const R: usize>(
    scenario: &Scenario,
    method: &RungeKutta<R>,
    degree: usize,
) -> Result<(), InputError> {
    if scenario.time.allow_unstable {
        return Ok(());
    }
    let at_stages = |term: &scenario::Damping| StageDamping {
        coefficients: model::coefficients(&term.coefficient),
        damping_order: term.order,
    };
    let damping: Vec<StageDamping<N>> = scenario.system.damping.iter().map(at_stages).collect();
    let (mass, stiffness) = mass_and_stiffness(scenario)?;
    let system = LinearSystem { mass: mass.matrix().to_matrix(), stiffness };
    judge(scenario, check_stage_stability(method, degree, &system, &damping, scenario.time.step))
}

/// M and ∂²U/∂q² − ∂F/∂q at the initial position in the middle of the first step.
fn mass_and_stiffness<const N: usize>(
    scenario: &Scenario,
) -> Result<(Mass<f64, N>, SMatrix<f64, N, N>), InputError> {
    let system = system::<f64, N>(scenario)?;
    let position = model::vector(&scenario.initial.position);
    let instant = Instant::in_step(0.0, 0.5, scenario.time.step);
    let stiffness = system.potential.hessian(&position) - system.force.jacobian(instant, &position);
    Ok((system.mass, stiffness))
}

fn judge(scenario: &Scenario, verdict: Result<Stability, ParameterError>) -> Result<(), InputError> {
    match verdict {
        Ok(Stability::Unstable { largest_stable_step }) => {
            let largest_step = three_digits_below(largest_stable_step);
            Err(scenario.error_at("time.step", Problem::Unstable { largest_step }))
        }
        Ok(Stability::Stable) => Ok(()),
        Err(error) => {
            Err(scenario.error_at("time.step", Problem::OutOfRange { allowed: error.allowed.to_owned() }))
        }
    }
}

/// A positive number cut to three digits: a step of that size passes the check.
fn three_digits_below(number: f64) -> f64 {
    let unit = libm::exp10(libm::log10(number).floor() - 2.0);
    (number / unit).floor() * unit
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
        EngineError::Table(_) => {
            scenario.error_at_first(&["history.tolerance", "history.engine"], Problem::Engine(error))
        }
        EngineError::NoRoom { .. } => {
            scenario.error_at_first(&["history.engine", "time.steps", "time.end"], Problem::Engine(error))
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
