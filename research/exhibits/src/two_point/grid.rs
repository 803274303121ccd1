//! The interval, its grid, and the side from which derivatives are taken.

use core::ops::Range;
use fvi_core::ParameterError;
use serde::Serialize;

/// The side σ of a discrete operator Δ_σ^α (\[BCGI\] Definitions 2, 3 and 11).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Sigma {
    /// σ = −: the left derivative, which looks back to the start of the interval.
    #[serde(rename = "-")]
    Minus,
    /// σ = +: the right derivative, which looks forward to its end.
    #[serde(rename = "+")]
    Plus,
}

impl Sigma {
    /// −σ.
    pub fn opposite(self) -> Self {
        match self {
            Self::Minus => Self::Plus,
            Self::Plus => Self::Minus,
        }
    }

    /// The factor −σ that turns Δ_σ^α into the analogue of a derivative: +1 for σ = −, −1 for σ = +.
    pub fn derivative_sign(self) -> f64 {
        match self {
            Self::Minus => 1.0,
            Self::Plus => -1.0,
        }
    }

    /// The grid points I_σ of the quadrature, and of the operator: 1…N for σ = −, 0…N−1 for σ = +.
    pub fn points(self, steps: usize) -> Range<usize> {
        match self {
            Self::Minus => 1..steps + 1,
            Self::Plus => 0..steps,
        }
    }

    /// The one grid point outside I_σ.
    pub fn excluded(self, steps: usize) -> usize {
        match self {
            Self::Minus => 0,
            Self::Plus => steps,
        }
    }
}

/// The grid t_k = a + k h, k = 0…N, h = (b − a)/N.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Grid {
    start: f64,
    end: f64,
    steps: usize,
}

impl Grid {
    /// The grid of `steps` = N steps on [`start`, `end`] = [a, b].
    ///
    /// # Errors
    /// If the ends are not finite, `end` does not come after `start`, or `steps` is below 2 (there would be
    /// nothing between the ends).
    pub fn new(start: f64, end: f64, steps: usize) -> Result<Self, ParameterError> {
        if !start.is_finite() {
            return Err(ParameterError { parameter: "start", value: start, allowed: "finite" });
        }
        if !(end > start && end.is_finite()) {
            return Err(ParameterError {
                parameter: "end",
                value: end,
                allowed: "finite and after the start",
            });
        }
        if steps < 2 {
            return Err(ParameterError { parameter: "steps", value: steps as f64, allowed: "at least 2" });
        }
        Ok(Self { start, end, steps })
    }

    /// Number of steps N.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Step size h.
    pub fn step(&self) -> f64 {
        (self.end - self.start) / self.steps as f64
    }

    /// The time t_k; exactly b for k = N.
    pub fn time(&self, k: usize) -> f64 {
        if k == self.steps {
            self.end
        } else {
            self.start + (self.end - self.start) * (k as f64 / self.steps as f64)
        }
    }

    /// The same interval with another number of steps.
    ///
    /// # Errors
    /// If `steps` is below 2.
    pub fn with_steps(&self, steps: usize) -> Result<Self, ParameterError> {
        Self::new(self.start, self.end, steps)
    }
}
