//! Runs that are recorded for gradients.

use crate::documents::Source;
use crate::errors::{Failure, Outcome, guarded};
use crate::run::{Arrays, Prepared, Record, arrays_of, read_knowing};
use crate::terms::{Callables, ErrorSlot, Functions};
use crate::watch::Watch;
use fvi_fft::memory::Tables;
use fvi_host::gradient::{Cotangent, GradientError, MOST_BYTES, Recording as HostRecording};
use fvi_host::results::rows::Rows;
use fvi_host::run::Run;
use fvi_scenario::scenario::Scenario;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use std::convert::Infallible;
use std::slice;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The steps of a run, for gradients of functions of its trajectory.
#[pyclass(frozen, module = "fvi._fvi")]
pub(crate) struct Recording {
    source: Source,
    scenario: Scenario,
    tables: Arc<Tables>,
    recording: HostRecording,
    /// True if it calls functions of Python.
    in_code: bool,
    slot: ErrorSlot,
}

/// Arrays of a run, how it ended as JSON, its summary, the exception that stopped it, and its steps.
type Recorded<'py> = (Arrays<'py>, String, Record, Option<PyErr>, Recording);

/// Derivatives by parameters, q₀, p₀, and forces step by step.
type Derivatives<'py> = [Bound<'py, PyArray1<f64>>; 4];

/// Runs a scenario and records its steps.
#[pyfunction]
#[pyo3(signature = (source, prepared, most_bytes = None, terms = None))]
pub(crate) fn record<'py>(
    py: Python<'py>,
    source: Source,
    prepared: &Prepared,
    most_bytes: Option<usize>,
    terms: Option<Callables>,
) -> PyResult<Recorded<'py>> {
    let (functions, slot) = (Functions { terms, ..Functions::default() }, ErrorSlot::default());
    let in_code = functions.need_interpreter();
    let run = || {
        guarded(|| {
            let scenario = read_knowing(&source, None, Some(&prepared.matrices))?;
            let scenario = functions.put_into(scenario, &slot, (true, true))?;
            let tables = prepared.tables.clone();
            let most = most_bytes.unwrap_or(MOST_BYTES);
            let (rows, summary, raised, recording) = recorded(&source, &scenario, &tables, &slot, most)?;
            Ok((rows, summary, raised, Recording { source, scenario, tables, recording, in_code, slot }))
        })
    };
    let (rows, summary, raised, recording) = if in_code { run() } else { py.detach(run) }?;
    let end = serde_json::to_string(&summary.in_short());
    let end = end.map_err(|error| Failure::Failed(error.to_string()))?;
    Ok((arrays_of(py, rows)?, end, Record { summary }, raised, recording))
}

/// Rows, summary, the exception that stopped the run, and its steps.
type Made = (Rows, fvi_host::run::RunSummary, Option<PyErr>, HostRecording);

fn recorded(
    source: &Source,
    scenario: &Scenario,
    tables: &Tables,
    slot: &ErrorSlot,
    most: usize,
) -> Outcome<Made> {
    let run = Run::of(scenario).tables(tables).recorded(most).start();
    let mut run = run.map_err(|error| slot.take().map_or_else(|| source.failure(&error), Failure::Raised))?;
    let rows = Rows::of_cases(scenario).map_err(|error| Failure::NoRoom(error.to_string()))?;
    let mut rows = rows.into_iter().next().ok_or_else(|| Failure::Failed("no motion".to_owned()))?;
    let (mut watch, stop) = (Watch::new(None), AtomicBool::new(false));
    let Ok(end) = run.drive(&stop, |portion| {
        let batch = portion.batch();
        let steps = batch.first() + batch.len().saturating_sub(1);
        if (steps > 0 && !watch.tick(steps, None)) || slot.is_full() {
            stop.store(true, Ordering::Relaxed);
        }
        portion.keep(slice::from_mut(&mut rows));
        Ok::<_, Infallible>(())
    });
    let recording = run.recording().ok_or_else(|| Failure::Failed("no steps were kept".to_owned()))?;
    Ok((rows, run.summary(end), slot.take().or(watch.into_raised()), recording))
}

#[pymethods]
impl Recording {
    /// Bytes of the steps that are kept.
    #[getter]
    fn nbytes(&self) -> usize {
        self.recording.bytes()
    }

    /// The derivatives of the function with these derivatives by the rows.
    fn gradient<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray1<'py, f64>,
        momentum: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Derivatives<'py>> {
        let (position, momentum) = (position.as_slice()?.to_vec(), momentum.as_slice()?.to_vec());
        let gradient = || {
            guarded(|| {
                let by = Cotangent { position: &position, momentum: &momentum };
                let gradient = self.recording.gradient_with(&self.scenario, &self.tables, by);
                if let Some(raised) = self.slot.take() {
                    return Err(Failure::Raised(raised));
                }
                gradient.map_err(|error| match error {
                    GradientError::Input(error) => self.source.failure(&error),
                    other => Failure::Failed(other.to_string()),
                })
            })
        };
        let gradient = if self.in_code { gradient() } else { py.detach(gradient) }?;
        let numbers = [gradient.parameters, gradient.position, gradient.momentum, gradient.force];
        Ok(numbers.map(|numbers| numbers.into_pyarray(py)))
    }
}
