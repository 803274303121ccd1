//! Why a scenario stopped.

use core::fmt;

use fvi_core::{
    DampingError, IntegratorError, MatrixError, MechanismError, OperatorError, ParameterError, PidError,
    StateError, StepError,
};

/// The error that stopped it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    /// A number of the scenario.
    Parameter(ParameterError),
    /// A matrix of the scenario.
    Matrix(MatrixError),
    /// A damping term.
    Damping(DampingError),
    /// The integrator.
    Integrator(IntegratorError),
    /// A mechanism.
    Mechanism(MechanismError),
    /// A step.
    Step(StepError),
    /// A fractional operator.
    Operator(OperatorError),
    /// A controller.
    Pid(PidError),
    /// A saved state.
    State(StateError),
    /// The output.
    Output(fmt::Error),
}

macro_rules! refusals {
    ($($variant:ident($error:ty)),*) => {
        $(impl From<$error> for Refusal {
            fn from(error: $error) -> Self {
                Self::$variant(error)
            }
        })*

        impl fmt::Display for Refusal {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self {
                    $(Self::$variant(error) => error.fmt(f),)*
                }
            }
        }
    };
}

refusals!(
    Parameter(ParameterError),
    Matrix(MatrixError),
    Damping(DampingError),
    Integrator(IntegratorError),
    Mechanism(MechanismError),
    Step(StepError),
    Operator(OperatorError),
    Pid(PidError),
    State(StateError),
    Output(fmt::Error)
);

impl core::error::Error for Refusal {}
