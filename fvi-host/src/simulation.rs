//! A scenario in motion: the integrator behind a face without type parameters.
//!
//! The core knows the number of coordinates, the scalar and the scheme at compile time; here they become known
//! at run time. [`Simulation::new`] is the one place where the one is turned into the other.

mod assembly;
mod dispatch;

use crate::scenario::{Engine, InputError, Scenario};
use fvi_core::StepError;
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
    fn engines(&self) -> Vec<Engine>;
    fn overruns(&self) -> Option<usize>;
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
        let stepper = dispatch::stepper(scenario, precision)?;
        let engines = stepper.engines();
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

    /// Blocks that `real-time` memories had not done when they were due; `None` without such a memory.
    pub fn overruns(&self) -> Option<usize> {
        self.stepper.overruns()
    }

    /// Bytes of all memories.
    pub fn memory_bytes(&self) -> usize {
        self.stepper.memory_bytes()
    }
}
