//! A scenario in motion: the integrator behind a face without type parameters.
//!
//! The core knows the number of coordinates, the scalar and the scheme at compile time; here they become known
//! at run time. [`Simulation::new`] is the one place where the one is turned into the other.

use crate::engine::{EngineError, HostMemory, MemoryRequest};
use crate::expression::Elementary;
use crate::model::{self, ExpressionForce, ExpressionPotential};
use crate::scenario::{
    ConvolutionFamily, Damping as DampingOfScenario, Engine, InputError, Problem, Scenario, Scheme,
};
use fvi_core::{
    AffineForce, BdfOrder, Damping, DampingTerm, Derivative, ExplicitDamping, ExplicitEuler, Galerkin,
    ImplicitEuler, Integrator, Memory, MemoryError, MemoryShape, Stability, StepError,
};
use nalgebra::SVector;
use serde::Serialize;

/// The scalar a simulation computes in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// Double precision.
    #[default]
    F64,
    /// Single precision, the twin of a microcontroller.
    F32,
}

/// A scenario in motion, N from 1 to 8.
pub struct Simulation {
    stepper: Box<dyn Stepper>,
    engines: Vec<Engine>,
    precision: Precision,
}

/// What the integrator of any scalar, size and scheme can do.
trait Stepper {
    fn step(&mut self, input: &[f64]) -> Result<u32, StepError>;
    fn time(&self) -> f64;
    fn read(&self, position: &mut [f64], momentum: &mut [f64]);
    fn energy(&self) -> f64;
    fn memory_bytes(&self) -> usize;
}

/// The state at a grid point, in double precision whatever it was computed in.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct GridState {
    /// t_k.
    pub time: f64,
    /// q_k.
    pub position: Vec<f64>,
    /// p_k.
    pub momentum: Vec<f64>,
    /// ½ p_kᵀM⁻¹p_k + U(q_k).
    pub energy: f64,
}

impl Simulation {
    /// The simulation at t = 0, after the checks that need the whole scenario.
    ///
    /// # Errors
    /// If settings of the scenario do not go together, or the step is too long to be stable.
    pub fn new(scenario: &Scenario, precision: Precision) -> Result<Self, InputError> {
        let stepper = match precision {
            Precision::F64 => sized::<f64>(scenario)?,
            Precision::F32 => sized::<f32>(scenario)?,
        };
        let engines =
            scenario.system.damping.iter().map(|term| memory_request(scenario, term).engine()).collect();
        Ok(Self { stepper, engines, precision })
    }

    /// One step with an input held over it (empty: none); returns the iterations of Newton's method.
    ///
    /// # Errors
    /// [`StepError`]; the simulation is as it was.
    pub fn step(&mut self, input: &[f64]) -> Result<u32, StepError> {
        self.stepper.step(input)
    }

    /// Writes the present state into `state`, whose vectors have one place for each coordinate.
    pub fn read(&self, state: &mut GridState) {
        state.time = self.stepper.time();
        self.stepper.read(&mut state.position, &mut state.momentum);
        state.energy = self.stepper.energy();
    }

    /// The engine of each damping term.
    pub fn engines(&self) -> &[Engine] {
        &self.engines
    }

    /// What it computes in.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// Bytes of all memories.
    pub fn memory_bytes(&self) -> usize {
        self.stepper.memory_bytes()
    }
}

/// From the number of coordinates to a type.
fn sized<T: Elementary>(scenario: &Scenario) -> Result<Box<dyn Stepper>, InputError> {
    match scenario.coordinates() {
        1 => typed::<T, 1>(scenario),
        2 => typed::<T, 2>(scenario),
        3 => typed::<T, 3>(scenario),
        4 => typed::<T, 4>(scenario),
        5 => typed::<T, 5>(scenario),
        6 => typed::<T, 6>(scenario),
        7 => typed::<T, 7>(scenario),
        _ => typed::<T, 8>(scenario),
    }
}

/// From the scheme to a type.
fn typed<T: Elementary, const N: usize>(scenario: &Scenario) -> Result<Box<dyn Stepper>, InputError> {
    match scenario.scheme {
        Scheme::LowOrder { kappa } => {
            let outside = |_| {
                let allowed = "0 ≤ κ ≤ 1".to_owned();
                scenario.error_at("scheme.kappa", Problem::OutOfRange { allowed })
            };
            check_stability::<N, 1, 1>(scenario, &Galerkin::low_order(kappa).map_err(outside)?)?;
            assemble::<T, N, _>(scenario, Galerkin::low_order(T::of(kappa)).map_err(outside)?)
        }
        Scheme::ExplicitEuler => assemble::<T, N, _>(scenario, ExplicitEuler),
        Scheme::ImplicitEuler => assemble::<T, N, _>(scenario, ImplicitEuler),
        Scheme::Galerkin { .. } => {
            let allowed = "\"low-order\", \"explicit-euler\", \"implicit-euler\"".to_owned();
            Err(scenario.error_at("scheme.kind", Problem::OutOfRange { allowed }))
        }
    }
}

/// Refuses a step that is too long for the explicit fractional force.
fn check_stability<const N: usize, const S: usize, const Q: usize>(
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
    let system = system::<f64, N>(scenario)?;
    let position = model::vector(&scenario.initial.position);
    let first_node = scheme.nodes().first().copied().unwrap_or(0.0);
    let instant = fvi_core::Instant::in_step(0.0, first_node, scenario.time.step);
    let stiffness = fvi_core::Potential::hessian(&system.potential, &position)
        - fvi_core::Force::jacobian(&system.force, instant, &position);
    let explicit = |term: &DampingOfScenario| ExplicitDamping {
        coefficients: model::coefficients(&term.coefficient),
        damping_order: term.order,
        bdf_order,
    };
    let damping: Vec<ExplicitDamping<f64, N>> = scenario.system.damping.iter().map(explicit).collect();
    match fvi_core::check_stability(scheme, &system.mass, &stiffness, &damping, scenario.time.step) {
        Ok(Stability::Unstable { largest_stable_step: largest_step }) => {
            Err(scenario.error_at("time.step", Problem::Unstable { largest_step }))
        }
        Ok(Stability::Stable) => Ok(()),
        Err(error) => {
            Err(scenario.error_at("time.step", Problem::OutOfRange { allowed: error.allowed.to_owned() }))
        }
    }
}

fn system<T: Elementary, const N: usize>(
    scenario: &Scenario,
) -> Result<model::ScenarioSystem<T, N>, InputError> {
    model::system(scenario)
        .map_err(|error| scenario.error_at("system.mass", Problem::Precision { reason: error.to_string() }))
}

fn memory_request<'a>(scenario: &'a Scenario, term: &DampingOfScenario) -> MemoryRequest<'a> {
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
fn assemble<T, const N: usize, S>(scenario: &Scenario, scheme: S) -> Result<Box<dyn Stepper>, InputError>
where
    T: Elementary,
    S: fvi_core::Scheme<T, N, 1> + 'static,
{
    let terms = scenario
        .system
        .damping
        .iter()
        .enumerate()
        .map(|(index, term)| damping_term(scenario, index, term))
        .collect::<Result<Vec<_>, _>>()?;
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

fn damping_term<T: Elementary, const N: usize>(
    scenario: &Scenario,
    index: usize,
    term: &DampingOfScenario,
) -> Result<DampingTerm<T, N, HostMemory<T>>, InputError> {
    let memory = memory_request(scenario, term).build().map_err(|error| match error {
        EngineError::Kernel { .. } | EngineError::NoRoom { .. } => {
            scenario.error_at("history.engine", Problem::Engine(error))
        }
        EngineError::Parameter(_) => {
            scenario.error_at(&format!("system.damping[{index}].order"), Problem::Engine(error))
        }
    })?;
    let derivative = match term.derivative {
        crate::scenario::Derivative::RiemannLiouville => Derivative::RiemannLiouville,
        crate::scenario::Derivative::Caputo => Derivative::Caputo,
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

impl<T: Elementary, const N: usize> Damping<T, N, 1> for DampingTerms<T, N> {
    fn check_shape(&self) -> Result<(), MemoryShape> {
        self.0.iter().try_for_each(Damping::<T, N, 1>::check_shape)
    }

    fn begin(&mut self, position: &SVector<T, N>, velocity: &SVector<T, N>) {
        self.0.iter_mut().for_each(|term| Damping::<T, N, 1>::begin(term, position, velocity));
    }

    fn add_force(
        &mut self,
        from: &SVector<T, N>,
        times: &[T; 1],
        force: &mut AffineForce<T, N, 1>,
    ) -> Result<(), MemoryError> {
        self.0.iter_mut().try_for_each(|term| term.add_force(from, times, force))
    }

    fn push(&mut self, positions: &[SVector<T, N>; 1], times: &[T; 1]) -> Result<(), MemoryError> {
        self.0.iter_mut().try_for_each(|term| term.push(positions, times))
    }
}

impl<T, const N: usize, S> Stepper
    for Integrator<T, N, 1, ExpressionPotential, ExpressionForce, S, DampingTerms<T, N>>
where
    T: Elementary,
    S: fvi_core::Scheme<T, N, 1>,
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

    fn memory_bytes(&self) -> usize {
        self.damping().0.iter().map(|term| term.memory().bytes()).sum()
    }
}
