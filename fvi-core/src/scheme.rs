//! What a one-step scheme is: from (q_k, p_k) and the memory's values to (q_{k+1}, p_{k+1}).

use core::fmt;

use nalgebra::SVector;

use crate::damping::AffineForce;
use crate::memory::MemoryError;
use crate::real::Real;
use crate::system::{Force, Potential, System};

/// Where a step begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepStart<T, const N: usize> {
    /// Time t_k.
    pub time: T,
    /// Step size h.
    pub step_size: T,
    /// Position q_k.
    pub position: SVector<T, N>,
    /// Momentum p_k.
    pub momentum: SVector<T, N>,
    /// Input u_k: a force held over the step, added to F(t, q).
    pub input: SVector<T, N>,
}

/// Where a step ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepEnd<T, const N: usize, const R: usize> {
    /// Position q_{k+1}.
    pub position: SVector<T, N>,
    /// Momentum p_{k+1}.
    pub momentum: SVector<T, N>,
    /// Positions of the nodes that the memory stores.
    pub samples: [SVector<T, N>; R],
    /// Iterations of Newton's method; 0 for explicit formulas.
    pub iterations: u32,
}

/// What the memory stores of each step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sampling<T, const R: usize> {
    /// The main nodes q_0, q_1, …: one sample before the first step and one at the end of every step.
    MainNodes,
    /// The positions at these fractions of every step.
    Stages([T; R]),
}

/// A one-step scheme for N coordinates whose memory stores R nodes a step.
///
/// A scheme has no state: it turns (q_k, p_k) and what the damping exerts, known up to the unknowns themselves, into
/// (q_{k+1}, p_{k+1}).
pub trait Scheme<T: Real, const N: usize, const R: usize> {
    /// What the memory stores of each step.
    fn sampling(&self) -> Sampling<T, R>;

    /// One step.
    ///
    /// # Errors
    /// If the nonlinear equations have no solution that Newton's method finds, or the result is not finite.
    fn step<P: Potential<T, N>, F: Force<T, N>>(
        &self,
        system: &System<T, N, P, F>,
        start: &StepStart<T, N>,
        damping: &AffineForce<T, N, R>,
    ) -> Result<StepEnd<T, N, R>, StepError>;
}

/// Why a step failed. State and memory are as before the step.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum StepError {
    /// Newton's method did not converge.
    NotConverged {
        /// Iterations made.
        iterations: u32,
        /// Largest component of the residual at the end, in units of momentum.
        residual: f64,
    },
    /// The Jacobian of the step's equations is singular.
    SingularJacobian,
    /// The potential, the force, the input or the result is infinite or not a number.
    NotFinite,
    /// The memory refused the sample; most likely it is full.
    Memory(MemoryError),
}

impl fmt::Display for StepError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotConverged { iterations, residual } => {
                write!(
                    f,
                    "Newton's method did not converge in {iterations} iterations (residual {residual:e})"
                )
            }
            Self::SingularJacobian => write!(f, "the Jacobian of the step is singular"),
            Self::NotFinite => write!(f, "a force, the input or the result is not a finite number"),
            Self::Memory(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for StepError {}

impl From<MemoryError> for StepError {
    fn from(error: MemoryError) -> Self {
        Self::Memory(error)
    }
}
