//! Memories of the library for whoever asks in Python.

use crate::errors::{Failure, Outcome};
use fvi_core::MemoryError;
use fvi_host::memory::{EngineError, HostMemory, MemoryRequest};
use fvi_host::scenario::{Convolution, Engine, History};

/// The memory of a kernel for `channels` sequences of `samples` numbers.
pub(crate) fn memory(
    convolution: &Convolution,
    exponent: f64,
    step: f64,
    channels: usize,
    samples: usize,
    engine: Option<Engine>,
) -> Outcome<HostMemory<f64>> {
    if channels == 0 {
        return Err(Failure::argument("channels", channels, "one at least"));
    }
    let history = History { engine, ..History::default() };
    let request = MemoryRequest {
        convolution,
        exponent,
        step_size: step,
        end: None,
        coordinates: channels,
        samples,
        history: &history,
    };
    // Exponent and step are looked at before the engine is.
    let _ = request.kernel()?;
    request.build().map_err(|error| match error {
        EngineError::Parameter(error) => error.into(),
        EngineError::NoRoom { .. } => Failure::NoRoom(error.to_string()),
        other => Failure::argument("engine", engine.map_or("None", Engine::name), &other.to_string()),
    })
}

/// A refusal of a memory that is full, or of a sample of another shape.
pub(crate) fn refused(error: MemoryError) -> Failure {
    match error {
        MemoryError::Full { capacity } => Failure::Failed(format!(
            "the memory is full: it takes {capacity} samples; make it with a greater `length`"
        )),
        other => Failure::Failed(other.to_string()),
    }
}
