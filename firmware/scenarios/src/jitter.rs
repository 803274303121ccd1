//! The plant and the controller of [`control_loop`](crate::control_loop) on a clock with ticks up to a fifth
//! of the interval early or late.
//!
//! ```text
//! plant        q̈ + D^{0.5} q + 4 q = u ,     q(0) = q̇(0) = 0
//! controller   u = 60 e + 20 I^{0.8} e + 12 D^{0.6} e ,     e = r − q
//! ```
//!
//! with intervals of 10 ms on average, measured by a timer; the reference r changes between 1 and −1 about
//! every 1.6 s. Plant and operators use the actual interval: collocation by the implicit Euler method, and
//! memories for steps of any length.

use core::fmt;

use fvi_core::{
    Coefficients, Collocation, DampingTerm, Derivative, Fixed, FractionalOperator, Integrator, Kernel, Mass,
    NoForce, Quadratic, RateTable, RungeKutta, Start, System, VariableStepMemory,
};
use nalgebra::SVector;

use crate::bits::Bits;
use crate::refusal::Refusal;
use crate::tables::{JITTER_DAMPING, JITTER_DERIVATIVE, JITTER_INTEGRAL};

/// Ticks of the run: about a thousand seconds.
pub const TICKS: u32 = 100_000;

/// Number of ticks between two printed samples.
pub const PRINTED: u32 = 10_000;

/// Ticks between two jumps of the reference.
const HALF_PERIOD: u32 = 164;

/// Average of the intervals.
const INTERVAL: f32 = 0.01;

/// Gains of e, I^{0.8} e and D^{0.6} e.
pub const GAINS: [f32; 3] = [60.0, 20.0, 12.0];

/// Exponents of the plant's damping, and of the controller's integral and derivative.
pub const EXPONENTS: [f64; 3] = [0.5, -0.8, 0.6];

/// Stiffness of the plant.
pub const STIFFNESS: f32 = 4.0;

/// Memory with one coordinate and one stage, and a state of `L` numbers.
type AnyStep<const L: usize> = VariableStepMemory<f32, 1, &'static [f32], [f32; L]>;

const fn state_len(table: &RateTable<&[f32]>) -> usize {
    table.state_len(1, 1)
}

type Damping = DampingTerm<f32, Fixed<1>, AnyStep<{ state_len(&JITTER_DAMPING) }>>;
type Plant =
    Integrator<f32, Fixed<1>, System<f32, 1, Quadratic<f32, 1>, NoForce>, Collocation<f32, 1>, Damping>;
type Integral = FractionalOperator<f32, AnyStep<{ state_len(&JITTER_INTEGRAL) }>>;
type Derived = FractionalOperator<f32, AnyStep<{ state_len(&JITTER_DERIVATIVE) }>>;

/// Plant and controller.
#[derive(Clone, Debug)]
pub struct Jitter {
    tick: u32,
    clock: u32,
    plant: Plant,
    integral: Integral,
    derivative: Derived,
    hash: u32,
}

/// Values of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tick {
    /// Seconds since the tick before.
    pub interval: f32,
    /// Control error e.
    pub error: f32,
    /// I^{0.8} e.
    pub integral: f32,
    /// D^{0.6} e.
    pub derivative: f32,
    /// Position q at the end of the step.
    pub position: f32,
    /// Momentum p at the end of the step.
    pub momentum: f32,
}

impl fmt::Display for Tick {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { interval, error, integral, derivative, position, momentum } = *self;
        for number in [interval, error, integral, derivative, position] {
            write!(f, "{} ", number.hexadecimal())?;
        }
        write!(f, "{}", momentum.hexadecimal())
    }
}

/// r at a tick.
pub fn reference(tick: u32) -> f32 {
    if (tick / HALF_PERIOD).is_multiple_of(2) { 1.0 } else { -1.0 }
}

impl Jitter {
    /// The loop at rest.
    ///
    /// # Errors
    /// What a constructor refuses; with these numbers, nothing.
    pub fn new() -> Result<Self, Refusal> {
        let method = RungeKutta::<1>::radau_iia()?;
        let memory = VariableStepMemory::new(&method, JITTER_DAMPING, 1, [0.0; state_len(&JITTER_DAMPING)])?;
        let (kernel, rho) = (Kernel::any_step(&method, 0.5)?, Coefficients::Diagonal(SVector::from([1.0])));
        let damping = DampingTerm::new(kernel, rho, Derivative::RiemannLiouville, memory)?;
        let system = System {
            mass: Mass::diagonal([1.0])?,
            potential: Quadratic::diagonal([STIFFNESS])?,
            force: NoForce,
        };
        let rest = SVector::from([0.0]);
        let integral = [0.0; state_len(&JITTER_INTEGRAL)];
        let integral = VariableStepMemory::new(&method, JITTER_INTEGRAL, 1, integral)?;
        let derivative = [0.0; state_len(&JITTER_DERIVATIVE)];
        let derivative = VariableStepMemory::new(&method, JITTER_DERIVATIVE, 1, derivative)?;
        Ok(Self {
            tick: 0,
            clock: 0x2545_f491,
            plant: Integrator::builder(system, Collocation::new(&method), INTERVAL)
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

    /// FNV-1a over the bits of every position, momentum and interval so far.
    pub fn hash(&self) -> u32 {
        self.hash
    }

    /// Seconds from this tick to the next: 8 to 12 ms, as a timer might count them.
    fn next_interval(&mut self) -> f32 {
        // Xorshift, so that the numbers are the same on every machine.
        self.clock ^= self.clock << 13;
        self.clock ^= self.clock >> 17;
        self.clock ^= self.clock << 5;
        INTERVAL * (0.8 + 0.4 * (self.clock >> 8) as f32 / (1 << 24) as f32)
    }

    /// One tick: read the position, compute the input, and advance the plant with it by the interval.
    ///
    /// # Errors
    /// What an operator or a step refuses; with these numbers, nothing.
    #[inline]
    pub fn tick(&mut self) -> Result<Tick, Refusal> {
        let interval = self.next_interval();
        let error = reference(self.tick) - self.plant.state().position[0];
        let integral = self.integral.push_after(interval, error)?;
        let derivative = self.derivative.push_after(interval, error)?;
        let [of_error, of_integral, of_derivative] = GAINS;
        let input = of_error * error + of_integral * integral + of_derivative * derivative;
        self.plant.step_by(interval, &SVector::from([input]))?;
        let state = self.plant.state();
        let (position, momentum) = (state.position[0], state.momentum[0]);
        for number in [position, momentum, interval] {
            self.hash = (self.hash ^ number.to_bits()).wrapping_mul(0x0100_0193);
        }
        self.tick += 1;
        Ok(Tick { interval, error, integral, derivative, position, momentum })
    }
}
