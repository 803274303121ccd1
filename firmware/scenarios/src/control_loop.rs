//! A fractionally damped plant under a fractional PID controller, both with memories that never fill.
//!
//! ```text
//! plant        q̈ + D^{0.5} q + 4 q = u ,     q(0) = q̇(0) = 0
//! controller   u = 60 e + 20 I^{0.8} e + 12 D^{0.6} e ,     e = r − q
//! ```
//!
//! at h = 1 ms; the reference r changes between 1 and −1 every 1.6384 s. The plant is the low-order
//! integrator with the input held over each step, the controller two streaming operators.

use core::fmt;

use fvi_core::{
    Coefficients, DampingTerm, Derivative, ExponentialSum, ExponentialTable, Fixed, FractionalOperator,
    Galerkin, Integrator, Kernel, Mass, NoForce, Quadratic, Start, StateError, StateReader, StateWriter,
    Stateful, System,
};
use nalgebra::SVector;

use crate::bits::Bits;
use crate::refusal::Refusal;
use crate::tables::{DAMPING, DERIVATIVE, INTEGRAL};

/// Ticks of the run: a thousand seconds.
pub const TICKS: u32 = 1_000_000;

/// Number of ticks between two printed samples.
pub const PRINTED: u32 = 50_000;

/// Ticks between two jumps of the reference.
const HALF_PERIOD: u32 = 1_638;

const STEP_SIZE: f32 = 1e-3;

/// Exponential-sum memory with one channel and a state of `L` numbers.
type Forgetless<const L: usize> = ExponentialSum<f32, &'static [f32], [f32; L]>;

const fn state_len(table: &ExponentialTable<&[f32]>) -> usize {
    table.state_len(1)
}

type Damping = DampingTerm<f32, Fixed<1>, Forgetless<{ state_len(&DAMPING) }>>;
type Plant =
    Integrator<f32, Fixed<1>, System<f32, 1, Quadratic<f32, 1>, NoForce>, Galerkin<f32, 1, 1>, Damping>;
type Integral = FractionalOperator<f32, Forgetless<{ state_len(&INTEGRAL) }>>;
type Derived = FractionalOperator<f32, Forgetless<{ state_len(&DERIVATIVE) }>>;

/// Plant and controller.
#[derive(Clone, Debug)]
pub struct ControlLoop {
    tick: u32,
    plant: Plant,
    integral: Integral,
    derivative: Derived,
    hash: u32,
}

/// Values of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tick {
    /// Control error e.
    pub error: f32,
    /// I^{0.8} e.
    pub integral: f32,
    /// D^{0.6} e.
    pub derivative: f32,
    /// Input u of the plant.
    pub input: f32,
    /// Position q at the end of the step.
    pub position: f32,
    /// Momentum p at the end of the step.
    pub momentum: f32,
}

impl fmt::Display for Tick {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { error, integral, derivative, input, position, momentum } = *self;
        for number in [error, integral, derivative, input, position] {
            write!(f, "{} ", number.hexadecimal())?;
        }
        write!(f, "{}", momentum.hexadecimal())
    }
}

impl ControlLoop {
    /// The loop at rest.
    ///
    /// # Errors
    /// What a constructor refuses; with these numbers, nothing.
    pub fn new() -> Result<Self, Refusal> {
        let memory = ExponentialSum::new(DAMPING, 1.0, 1, [0.0; state_len(&DAMPING)])?;
        let rho = Coefficients::Diagonal(SVector::from([1.0]));
        let damping = DampingTerm::new(Kernel::given(0.5)?, rho, Derivative::RiemannLiouville, memory)?;
        let system =
            System { mass: Mass::diagonal([1.0])?, potential: Quadratic::diagonal([4.0])?, force: NoForce };
        let (scheme, rest) = (Galerkin::low_order(0.5)?, SVector::from([0.0]));
        let integral = ExponentialSum::new(INTEGRAL, 1.0, 1, [0.0; state_len(&INTEGRAL)])?;
        let derivative = ExponentialSum::new(DERIVATIVE, 1.0, 1, [0.0; state_len(&DERIVATIVE)])?;
        Ok(Self {
            tick: 0,
            plant: Integrator::builder(system, scheme, STEP_SIZE)
                .damping(damping)
                .position(rest)
                .momentum(rest)
                .build()?,
            integral: FractionalOperator::new(integral, Start::RiemannLiouville)?,
            derivative: FractionalOperator::new(derivative, Start::RiemannLiouville)?,
            hash: 0x811c_9dc5,
        })
    }

    /// Ticks made.
    pub fn ticks(&self) -> u32 {
        self.tick
    }

    /// FNV-1a over the bits of every position, momentum and input so far.
    pub fn hash(&self) -> u32 {
        self.hash
    }

    /// One tick: read the position, compute the input, and advance the plant by a step with it.
    ///
    /// # Errors
    /// Errors of the operators and of the step; none occurs with the numbers of this loop.
    #[inline]
    pub fn tick(&mut self) -> Result<Tick, Refusal> {
        let reference = if (self.tick / HALF_PERIOD).is_multiple_of(2) { 1.0 } else { -1.0 };
        let error = reference - self.plant.state().position[0];
        let integral = self.integral.push(error)?;
        let derivative = self.derivative.push(error)?;
        let input = 60.0 * error + 20.0 * integral + 12.0 * derivative;
        self.plant.step(&SVector::from([input]))?;
        let state = self.plant.state();
        let (position, momentum) = (state.position[0], state.momentum[0]);
        for number in [position, momentum, input] {
            self.hash = (self.hash ^ number.to_bits()).wrapping_mul(0x0100_0193);
        }
        self.tick += 1;
        Ok(Tick { error, integral, derivative, input, position, momentum })
    }

    /// Writes the complete state of the loop.
    ///
    /// # Errors
    /// If there is no room for it.
    pub fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.count(u64::from(self.tick))?;
        to.count(u64::from(self.hash))?;
        self.plant.save(to)?;
        self.integral.save(to)?;
        self.derivative.save(to)
    }

    /// A loop that continues from a saved state.
    ///
    /// # Errors
    /// If the bytes are not a state of this loop.
    pub fn restored(from: &mut StateReader<'_>) -> Result<Self, Refusal> {
        let mut restored = Self::new()?;
        restored.tick = from.count_up_to("ticks", TICKS as usize)? as u32;
        restored.hash = from.count_up_to("hash", u32::MAX as usize)? as u32;
        restored.plant.restore(from)?;
        restored.integral.restore(from)?;
        restored.derivative.restore(from)?;
        Ok(restored)
    }
}
