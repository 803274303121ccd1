//! Conversion of errors to Python exceptions.

use fvi_core::ParameterError;
use pyo3::exceptions::{PyMemoryError, PyOSError, PyRuntimeError};
use pyo3::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind};

pyo3::import_exception!(fvi._errors, InputError);

/// Errors that a call of the library may end with.
pub(crate) type Outcome<T> = Result<T, Failure>;

/// Why a call ends without a result.
pub(crate) enum Failure {
    /// The input cannot be used: key or argument, value, and message.
    Input { key: String, value: String, message: String },
    /// The memory needed is not available.
    NoRoom(String),
    /// The computation failed.
    Failed(String),
    /// A file cannot be written.
    File(String),
    /// The caller's code, or a signal handler, raised an exception.
    Raised(PyErr),
}

impl Failure {
    /// The failure for an error in a scenario or problem, with its place if the document is a file.
    pub(crate) fn of_document(error: &fvi_scenario::language::InputError, in_file: bool) -> Self {
        let (key, value) = (error.key().to_owned(), error.value().to_owned());
        let mut message = if in_file {
            error.to_string()
        } else {
            let subject = match (key.as_str(), value.as_str()) {
                ("", _) => String::new(),
                (key, "") => format!("{key}: "),
                (key, value) => format!("{key} = {value}: "),
            };
            format!("{subject}{}", error.problem())
        };
        if let Some(allowed) = error.problem().allowed() {
            message += &format!("; {allowed}");
        }
        Self::Input { key, value, message }
    }

    /// The failure for an invalid argument.
    pub(crate) fn argument(key: &str, value: impl ToString, allowed: &str) -> Self {
        let value = value.to_string();
        let message = format!("{key} = {value}: not allowed; allowed: {allowed}");
        Self::Input { key: key.to_owned(), value, message }
    }
}

impl From<ParameterError> for Failure {
    fn from(error: ParameterError) -> Self {
        Self::argument(error.parameter, error.value, error.allowed)
    }
}

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self::Raised(error)
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Input { key, value, message } => self::InputError::new_err((message, key, value)),
            Failure::NoRoom(message) => PyMemoryError::new_err(message),
            Failure::Failed(message) => PyRuntimeError::new_err(message),
            Failure::File(message) => PyOSError::new_err(message),
            Failure::Raised(error) => error,
        }
    }
}

/// Calls the library; a panic, which is a bug of the library, becomes a `RuntimeError`.
pub(crate) fn guarded<T>(call: impl FnOnce() -> Outcome<T>) -> PyResult<T> {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(outcome) => outcome.map_err(PyErr::from),
        Err(panic) => {
            let words = panic.downcast_ref::<String>().map(String::as_str);
            let words = words.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
            Err(PyRuntimeError::new_err(format!("a mistake in fvi, please report it: {words}")))
        }
    }
}

/// Panics, for a test of how panics are converted; not present in a release.
#[cfg(debug_assertions)]
#[pyfunction]
pub(crate) fn _panic() -> PyResult<()> {
    guarded(|| panic!("asked for"))
}
