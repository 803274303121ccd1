//! Why there is no prediction.

use super::plan::said;
use fvi_scenario::language::InputError;

/// Why there is no prediction.
#[derive(Debug)]
pub(super) enum NoPrediction {
    /// The scenario is invalid with these values, or its run fails.
    Refused(String),
    /// It was stopped.
    Stopped,
}

impl NoPrediction {
    /// A motion is asked for what only closed forms have.
    pub(super) fn of_a_motion() -> Self {
        Self::Refused("a motion has states and an energy, no response, modulus or relaxation".to_owned())
    }
}

impl From<InputError> for NoPrediction {
    fn from(error: InputError) -> Self {
        Self::Refused(said(&error))
    }
}
