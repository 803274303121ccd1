//! Errors of constructors: which parameter, its value, what is allowed.

use core::fmt;

/// A number given to a constructor lies outside what is allowed; not-a-number and infinities always do.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParameterError {
    /// Name of the parameter.
    pub parameter: &'static str,
    /// The value that was given.
    pub value: f64,
    /// Allowed values, as a phrase.
    pub allowed: &'static str,
}

impl fmt::Display for ParameterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { parameter, value, allowed } = self;
        // Not with hundreds of zeros.
        match value.abs() {
            size if size == 0.0 || (1e-12..1e16).contains(&size) => write!(f, "{parameter} = {value}")?,
            _ => write!(f, "{parameter} = {value:e}")?,
        }
        write!(f, " is not allowed: it must be {allowed}")
    }
}

impl core::error::Error for ParameterError {}

impl ParameterError {
    /// `value` if `accepted`, the error otherwise.
    pub(crate) const fn check(
        accepted: bool,
        parameter: &'static str,
        value: f64,
        allowed: &'static str,
    ) -> Result<(), Self> {
        if accepted { Ok(()) } else { Err(Self { parameter, value, allowed }) }
    }
}

/// Checks that a step size is finite and positive.
pub(crate) const fn check_step_size(step_size: f64) -> Result<(), ParameterError> {
    ParameterError::check(
        step_size > 0.0 && step_size.is_finite(),
        "step size",
        step_size,
        "positive and finite",
    )
}

/// Reasons to refuse a matrix of coefficients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MatrixError {
    /// An entry is infinite or not a number.
    NotFinite,
    /// Two entries that mirror each other differ.
    NotSymmetric {
        /// Row of the entry below the diagonal, from 0.
        row: usize,
        /// Its column.
        column: usize,
    },
    /// The matrix must be positive definite and is not.
    NotPositiveDefinite,
    /// The matrix must be positive semidefinite and is not.
    NotPositiveSemidefinite,
}

impl fmt::Display for MatrixError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "an entry is not a finite number"),
            Self::NotSymmetric { row, column } => {
                write!(
                    f,
                    "the matrix is not symmetric: entries ({row}, {column}) and ({column}, {row}) differ"
                )
            }
            Self::NotPositiveDefinite => write!(f, "the matrix is not positive definite"),
            Self::NotPositiveSemidefinite => write!(f, "the matrix is not positive semidefinite"),
        }
    }
}

impl core::error::Error for MatrixError {}
