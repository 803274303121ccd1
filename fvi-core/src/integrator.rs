//! The integrator: the only place where system, scheme and memory meet.

use core::fmt;

use nalgebra::SVector;

use crate::damping::{AffineForce, Damping, MemoryShape};
use crate::error::{ParameterError, check_step_size};
use crate::memory::MemoryError;
use crate::real::{Real, all_finite};
use crate::scheme::{Sampling, Scheme, StepError, StepStart};
use crate::system::{Force, Potential, System};

/// State of the motion after a number of steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State<T, const N: usize> {
    /// Number of steps made, k; the time is t_k = k h.
    pub step: u64,
    /// Position q_k.
    pub position: SVector<T, N>,
    /// Momentum p_k.
    pub momentum: SVector<T, N>,
}

/// Integrates d/dt ∂L/∂v − ∂L/∂q = F + u − Σ_m ρ_m D₋^{β_m} q step by step.
///
/// One step asks the memories for their terms, solves the scheme's equations, stores the new sample and only then moves on:
/// an error leaves state and memories as they were, and the caller may try again.
///
/// ```
/// # use fvi_core::*;
/// // m q̈ + k q = −ρ D^{1/2} q with q(0) = 1, q̇(0) = 0, in Caputo's sense.
/// static WEIGHTS: [f64; 128] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
/// let step_size = 0.05;
/// let scale = leading_bdf_weight(BdfOrder::GRUNWALD_LETNIKOV, 0.5, step_size)?;
/// let memory = FixedDirect::<f64, 1, 128>::full_memory(&WEIGHTS, scale)?;
/// let rho = Coefficients::Diagonal([0.2].into());
/// let damping = DampingTerm::new(rho, 0.5, Derivative::Caputo, memory)?;
/// let system = System {
///     mass: Mass::diagonal([1.0])?,
///     potential: Quadratic::diagonal([1.0])?,
///     force: NoForce,
/// };
/// let scheme = Galerkin::low_order(0.5)?;
/// let mut integrator = Integrator::new(system, scheme, damping, step_size, [1.0].into(), [0.0].into())?;
/// let energy = integrator.energy();
/// for _ in 0..100 {
///     integrator.step(&[0.0].into())?;
/// }
/// assert!(integrator.energy() < energy);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Source: \[JO\] Algorithm 3; \[HJO\] Algorithm 1.
#[derive(Clone, Debug)]
pub struct Integrator<T, const N: usize, const R: usize, P, F, S, D> {
    system: System<T, N, P, F>,
    scheme: S,
    damping: D,
    step_size: T,
    state: State<T, N>,
}

/// Why an integrator cannot be made.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum IntegratorError {
    /// The step size is not positive and finite.
    StepSize(ParameterError),
    /// The initial position or momentum is not finite.
    InitialState,
    /// A memory does not fit the system and the scheme.
    Shape(MemoryShape),
    /// A memory has no room for the first sample.
    Memory(MemoryError),
}

impl fmt::Display for IntegratorError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::StepSize(error) => error.fmt(f),
            Self::InitialState => write!(f, "the initial position or momentum is not finite"),
            Self::Shape(error) => error.fmt(f),
            Self::Memory(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for IntegratorError {}

impl<T, const N: usize, const R: usize, P, F, S, D> Integrator<T, N, R, P, F, S, D>
where
    T: Real,
    P: Potential<T, N>,
    F: Force<T, N>,
    S: Scheme<T, N, R>,
    D: Damping<T, N, R>,
{
    /// An integrator at t = 0 with empty memories.
    ///
    /// # Errors
    /// [`IntegratorError`].
    pub fn new(
        system: System<T, N, P, F>,
        scheme: S,
        mut damping: D,
        step_size: T,
        position: SVector<T, N>,
        momentum: SVector<T, N>,
    ) -> Result<Self, IntegratorError> {
        check_step_size(step_size.to_f64()).map_err(IntegratorError::StepSize)?;
        if !all_finite(position.as_slice()) || !all_finite(momentum.as_slice()) {
            return Err(IntegratorError::InitialState);
        }
        damping.check_shape().map_err(IntegratorError::Shape)?;
        damping.begin(&position, &system.mass.velocity(&momentum));
        if matches!(scheme.sampling(), Sampling::MainNodes) {
            damping.push(&[position; R], &[T::zero(); R]).map_err(IntegratorError::Memory)?;
        }
        Ok(Self { system, scheme, damping, step_size, state: State { step: 0, position, momentum } })
    }

    /// Makes one step with the input u held over it (zero where there is none); returns the iterations of Newton's method.
    ///
    /// # Errors
    /// [`StepError`]; state and memories are as before the call.
    #[inline]
    pub fn step(&mut self, input: &SVector<T, N>) -> Result<u32, StepError> {
        let start = StepStart {
            time: self.time(),
            step_size: self.step_size,
            position: self.state.position,
            momentum: self.state.momentum,
            input: *input,
        };
        let times = match self.scheme.sampling() {
            Sampling::MainNodes => [T::from_count(self.state.step + 1) * self.step_size; R],
            Sampling::Stages(nodes) => nodes.map(|node| start.time + node * self.step_size),
        };
        let mut force = AffineForce::zero();
        self.damping.add_force(&start.position, &times, &mut force)?;
        let end = self.scheme.step(&self.system, &start, &force)?;
        if !all_finite(end.position.as_slice()) || !all_finite(end.momentum.as_slice()) {
            return Err(StepError::NotFinite);
        }
        self.damping.push(&end.samples, &times)?;
        self.state = State { step: self.state.step + 1, position: end.position, momentum: end.momentum };
        Ok(end.iterations)
    }

    /// Time t_k = k h of the present state.
    #[inline]
    pub fn time(&self) -> T {
        T::from_count(self.state.step) * self.step_size
    }

    /// Step size h.
    pub fn step_size(&self) -> T {
        self.step_size
    }

    /// The present state.
    pub fn state(&self) -> &State<T, N> {
        &self.state
    }

    /// Velocity M⁻¹ p of the present state.
    pub fn velocity(&self) -> SVector<T, N> {
        self.system.mass.velocity(&self.state.momentum)
    }

    /// Energy ½ pᵀ M⁻¹ p + U(q) of the present state (\[JO\] §5).
    pub fn energy(&self) -> T {
        self.system.energy(&self.state.position, &self.state.momentum)
    }

    /// The system.
    pub fn system(&self) -> &System<T, N, P, F> {
        &self.system
    }

    /// The damping with its memories.
    pub fn damping(&self) -> &D {
        &self.damping
    }
}
