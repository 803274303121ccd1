//! What a call returns.

use core::ffi::{CStr, c_char};

use fvi_core::{
    DampingError, IntegratorError, MatrixError, MemoryError, Mismatch, OperatorError, ParameterError,
    StateError, StepError,
};

/// The status returned by a call. Any status but FVI_STATUS_OK means that the call has changed nothing, with
/// two exceptions: a call that sets up an object with an exponential sum may have cleared its buffer, and one
/// that sets up a controller may have cleared the buffers of its memories, since it tests their weights with
/// samples.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FviStatus {
    /// Success.
    Ok = 0,
    /// A pointer is NULL that must not be.
    Null = 1,
    /// A pointer is not aligned as its type requires.
    Misaligned = 2,
    /// A number is infinite or NaN: a parameter, a sample, a value written by a callback, or the result.
    NotFinite = 3,
    /// A parameter is outside its range.
    OutOfRange = 4,
    /// A buffer does not have the size that the call needs.
    WrongSize = 5,
    /// A matrix is not symmetric.
    NotSymmetric = 6,
    /// The mass is not positive definite, or the damping not positive semidefinite.
    NotPositive = 7,
    /// The state was never set up, or belongs to another kind of object.
    NotInitialised = 8,
    /// The memory is full, or the horizon of its table is reached.
    MemoryFull = 9,
    /// Newton's method did not converge.
    NotConverged = 10,
    /// The Jacobian of the step is singular.
    Singular = 11,
    /// Saved bytes are incomplete, damaged, or the state of another object.
    WrongState = 12,
}

/// A short English text for a status; an unknown one has a text as well. Never NULL.
#[unsafe(no_mangle)]
pub extern "C" fn fvi_status_text(status: i32) -> *const c_char {
    const TEXTS: [&CStr; 13] = [
        c"done",
        c"a pointer is NULL",
        c"a pointer is not aligned",
        c"a number is not finite",
        c"a parameter is out of range",
        c"a buffer has the wrong size",
        c"a matrix is not symmetric",
        c"a matrix is not positive definite or semidefinite",
        c"the state is not initialised",
        c"the memory is full",
        c"Newton's method did not converge",
        c"the Jacobian is singular",
        c"the saved state is damaged or belongs to something else",
    ];
    let text = usize::try_from(status).ok().and_then(|status| TEXTS.get(status));
    text.unwrap_or(&c"unknown status").as_ptr()
}

/// The status of a result.
pub(crate) fn status(result: Result<(), FviStatus>) -> FviStatus {
    match result {
        Ok(()) => FviStatus::Ok,
        Err(status) => status,
    }
}

impl From<ParameterError> for FviStatus {
    fn from(error: ParameterError) -> Self {
        if error.value.is_finite() { Self::OutOfRange } else { Self::NotFinite }
    }
}

impl From<MatrixError> for FviStatus {
    fn from(error: MatrixError) -> Self {
        match error {
            MatrixError::NotFinite => Self::NotFinite,
            MatrixError::NotSymmetric { .. } => Self::NotSymmetric,
            _ => Self::NotPositive,
        }
    }
}

impl From<MemoryError> for FviStatus {
    fn from(error: MemoryError) -> Self {
        match error {
            MemoryError::Full { .. } => Self::MemoryFull,
            MemoryError::StepLength => Self::OutOfRange,
            _ => Self::WrongSize,
        }
    }
}

impl From<OperatorError> for FviStatus {
    fn from(error: OperatorError) -> Self {
        match error {
            OperatorError::Memory(error) => error.into(),
            _ => Self::NotFinite,
        }
    }
}

impl From<DampingError> for FviStatus {
    fn from(error: DampingError) -> Self {
        match error {
            DampingError::Order(error) => error.into(),
            DampingError::Coefficients(error) => error.into(),
            _ => Self::OutOfRange,
        }
    }
}

impl From<IntegratorError> for FviStatus {
    fn from(error: IntegratorError) -> Self {
        match error {
            IntegratorError::StepSize(error) => error.into(),
            IntegratorError::Memory(error) => error.into(),
            IntegratorError::Damping(Mismatch::Shape { .. }) => Self::WrongSize,
            IntegratorError::Damping(_) => Self::OutOfRange,
            _ => Self::NotFinite,
        }
    }
}

impl From<StepError> for FviStatus {
    fn from(error: StepError) -> Self {
        match error {
            StepError::NotConverged { .. } => Self::NotConverged,
            StepError::SingularJacobian => Self::Singular,
            StepError::Memory(error) => error.into(),
            _ => Self::NotFinite,
        }
    }
}

impl From<StateError> for FviStatus {
    fn from(error: StateError) -> Self {
        match error {
            StateError::NoRoom { .. } => Self::WrongSize,
            _ => Self::WrongState,
        }
    }
}
