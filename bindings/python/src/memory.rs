//! Memories of the library as Python objects.

use crate::documents::Tree;
use crate::errors::{Failure, Outcome, guarded};
use fvi_core::{Memory, MemoryError, StateError, StateReader, Stateful};
use fvi_fft::memory::{Engine, History};
use fvi_fft::memory::{EngineError, HostMemory, MemoryRequest};
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::language::Document;
use fvi_scenario::language::memory_limit::check_capacity;
use fvi_scenario::scenario::{Convolution, kernel_of_document};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::Path;

/// Takes the sample X_k and writes (W ∗ X)_k = W₀ X_k + Σ_{n≥1} W_n X_{k−n}.
pub(crate) fn operate(
    memory: &mut HostMemory<f64>,
    sample: &[f64],
    result: &mut [f64],
) -> Result<(), MemoryError> {
    memory.next_term(result)?;
    let (stages, leading) = (memory.stages(), memory.leading());
    for (sum, values) in result.chunks_exact_mut(stages).zip(sample.chunks_exact(stages)) {
        for (sum, row) in sum.iter_mut().zip(leading.chunks_exact(stages)) {
            *sum += row.iter().zip(values).map(|(weight, value)| weight * value).sum::<f64>();
        }
    }
    memory.push(sample)
}

/// Restores a complete state; on an error the memory is unchanged.
pub(crate) fn restore(memory: &mut HostMemory<f64>, state: &[u8]) -> Result<(), StateError> {
    let mut check = StateReader::new(state);
    memory.check_state(&mut check)?;
    check.finish()?;
    memory.restore(&mut StateReader::new(state))
}

/// Transfer function s^exponent, or that of the kernel with these keys, including K(0); one of the two
/// arguments is given.
pub(crate) fn transfer(exponent: Option<f64>, kernel: Option<Tree>) -> Outcome<TransferFunction> {
    match kernel {
        None => Ok(TransferFunction::power(exponent.unwrap_or(f64::NAN))?),
        Some(keys) => Ok(of_keys(keys)?.with_its_spring()),
    }
}

fn of_keys(keys: Tree) -> Outcome<TransferFunction> {
    let text = Tree::Table(vec![("kernel".to_owned(), keys)]).to_toml();
    kernel_of_document(&Document::new("kernel", Path::new(""), &text))
        .map_err(|error| Failure::of_document(&error, false))
}

/// Converts the keys of a kernel.
pub(crate) fn keys(kernel: Option<&Bound<'_, PyDict>>) -> PyResult<Option<Tree>> {
    kernel.map(|kernel| Tree::of(kernel.as_any())).transpose()
}

/// Properties of a kernel: the exponent of its growth for large s, its spring K(0), and a sentence on where
/// it is not passive, if so.
#[pyfunction]
pub(crate) fn kernel_facts(kernel: &Bound<'_, PyDict>) -> PyResult<(f64, f64, Option<String>)> {
    let keys = keys(Some(kernel))?.unwrap_or(Tree::Table(Vec::new()));
    guarded(|| {
        let transfer = of_keys(keys)?;
        let active = transfer.active().map(|active| active.to_string());
        Ok((transfer.growth(), transfer.spring(), active))
    })
}

/// The memory of a kernel for `channels` sequences of `samples` samples. With `given` the samples are the
/// values themselves, otherwise the differences for which rounding is smallest.
pub(crate) fn memory(
    convolution: &Convolution,
    transfer: &TransferFunction,
    step: f64,
    (channels, samples, given): (usize, usize, bool),
    history: &History,
) -> Outcome<HostMemory<f64>> {
    if channels == 0 {
        return Err(Failure::argument("channels", channels, "one at least"));
    }
    let engine = history.engine;
    let build = |channels: usize| -> Outcome<HostMemory<f64>> {
        let request = MemoryRequest {
            family: convolution.family,
            starting: &convolution.starting,
            transfer,
            step_size: step,
            end: None,
            coordinates: channels,
            motions: 1,
            samples,
            given,
            history,
        };
        // Exponent and step are checked before the engine.
        let _ = request.kernel()?;
        request.build().map_err(|error| match error {
            EngineError::Parameter(error) => error.into(),
            EngineError::NoRoom { .. } => Failure::NoRoom(error.to_string()),
            other => Failure::argument("engine", engine.map_or("None", Engine::name), &other.to_string()),
        })
    };
    if channels > MANY {
        let (one, two) = (build(1)?, build(2)?);
        // An allocation failure would abort the process.
        let each = two.bytes().saturating_sub(one.bytes()).max(size_of::<f64>());
        check_capacity(each.saturating_mul(channels))
            .map_err(|error| Failure::NoRoom(format!("channels = {channels}: {error}")))?;
    }
    build(channels)
}

/// Number of channels from which on the available memory is checked beforehand.
const MANY: usize = 1 << 16;

/// The failure for a full memory, or a sample of the wrong shape.
pub(crate) fn refused(error: MemoryError) -> Failure {
    match error {
        MemoryError::Full { capacity } => Failure::Failed(format!(
            "the memory is full: it takes {capacity} samples; make it with a greater `length`"
        )),
        other => Failure::Failed(other.to_string()),
    }
}
