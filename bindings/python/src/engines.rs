//! Memories and streaming operators as objects.

use crate::errors::{Failure, Outcome, guarded};
use crate::memory::{keys, memory, refused, restore, transfer};
use crate::run::engine;
use crate::weights::convolution;
use fvi_core::{
    ActsOn, FractionalOperator, Memory as _, OperatorError, SavedChannels, Start, StateReader, StateWriter,
    Stateful,
};
use fvi_fft::exponentials::exponential_table::SMALLEST_TOLERANCE;
use fvi_fft::memory::HostMemory;
use fvi_fft::memory::{Engine, History, States};
use fvi_scenario::scenario::{LARGEST_TOLERANCE, SMALLEST_SINGLE_TOLERANCE};
use numpy::{IntoPyArray, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::sync::{Mutex, MutexGuard, PoisonError};

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn saved(
    bytes: usize,
    save: impl FnOnce(&mut StateWriter<'_>) -> Result<(), fvi_core::StateError>,
) -> Outcome<Vec<u8>> {
    let mut room = vec![0; bytes];
    let mut writer = StateWriter::new(&mut room);
    save(&mut writer).map_err(|error| Failure::Failed(error.to_string()))?;
    let written = writer.written();
    room.truncate(written);
    Ok(room)
}

fn bad_state(error: fvi_core::StateError) -> Failure {
    Failure::Input { key: "state".to_owned(), value: String::new(), message: format!("state: {error}") }
}

/// The engine with its settings, as in a scenario; tolerance and states apply to sums of exponentials only.
fn settings(
    engine: Option<&str>,
    family: &str,
    tolerance: Option<f64>,
    states: Option<&str>,
    threads: Option<usize>,
) -> Outcome<History> {
    let mut engine = engine.map(self::engine).transpose()?;
    let refused = |key, value: String, allowed: &str| Err(Failure::argument(key, value, allowed));
    let owners = [Engine::ExponentialSum, Engine::ExponentialSumCore];
    if let Some(tolerance) = tolerance {
        if !(SMALLEST_TOLERANCE..=LARGEST_TOLERANCE).contains(&tolerance) {
            let allowed = format!("{SMALLEST_TOLERANCE:e} ≤ tolerance ≤ {LARGEST_TOLERANCE:e}");
            return refused("tolerance", format!("{tolerance:e}"), &allowed);
        }
        if family != "bdf" || !owners.contains(engine.get_or_insert(Engine::ExponentialSum)) {
            let allowed = "only with the family \"bdf\" and the engine \"exponential-sum\"";
            return refused("tolerance", format!("{tolerance:e}"), allowed);
        }
    }
    let states = match states {
        None | Some("f64") => None,
        Some("f32") if family != "bdf" || engine != Some(Engine::ExponentialSum) => {
            let allowed = "only with the family \"bdf\", the engine \"exponential-sum\" and a tolerance";
            return refused("states", "\"f32\"".to_owned(), allowed);
        }
        Some("f32") if tolerance.is_none_or(|tolerance| tolerance < SMALLEST_SINGLE_TOLERANCE) => {
            let allowed = format!("only with a tolerance of {SMALLEST_SINGLE_TOLERANCE:e} or more");
            return refused("states", "\"f32\"".to_owned(), &allowed);
        }
        Some("f32") => Some(States::F32),
        Some(other) => return refused("states", format!("{other:?}"), "\"f64\", \"f32\""),
    };
    if let Some(threads) = threads
        && !(1..=1024).contains(&threads)
    {
        return refused("threads", threads.to_string(), "a whole number from 1 to 1024");
    }
    Ok(History { engine, tolerance, states, threads, ..History::default() })
}

/// A memory engine.
#[pyclass(frozen, subclass, module = "fvi._fvi", name = "Memory")]
pub(crate) struct Memory {
    memory: Mutex<HostMemory<f64>>,
    channels: usize,
    stages: usize,
}

#[pymethods]
impl Memory {
    #[new]
    #[pyo3(signature = (*, exponent, kernel, step, family, order, stages, channels, length, engine, samples, tolerance, states,
                        threads))]
    #[expect(clippy::too_many_arguments, reason = "the keywords of the class")]
    fn new(
        exponent: Option<f64>,
        kernel: Option<&Bound<'_, PyDict>>,
        step: f64,
        family: &str,
        order: usize,
        stages: Option<usize>,
        channels: usize,
        length: usize,
        engine: Option<&str>,
        samples: &str,
        tolerance: Option<f64>,
        states: Option<&str>,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let history = settings(engine, family, tolerance, states, threads)?;
        let given = match samples {
            "values" => true,
            "differences" => false,
            other => {
                let allowed = "\"values\", \"differences\"";
                return Err(Failure::argument("samples", format!("{other:?}"), allowed).into());
            }
        };
        let kernel = keys(kernel)?;
        guarded(|| {
            let convolution = convolution(family, order, stages)?;
            let transfer = transfer(exponent, kernel)?;
            let memory = memory(&convolution, &transfer, step, (channels, length, given), &history)?;
            let stages = memory.stages();
            Ok(Self { memory: Mutex::new(memory), channels, stages })
        })
    }

    #[getter]
    fn engine(&self) -> &'static str {
        locked(&self.memory).engine().name()
    }

    #[getter]
    fn samples(&self) -> &'static str {
        match locked(&self.memory).acts_on() {
            ActsOn::Values => "values",
            ActsOn::Increments => "increments",
            ActsOn::Rises => "rises",
        }
    }

    #[getter]
    fn channels(&self) -> usize {
        self.channels
    }

    #[getter]
    fn stages(&self) -> usize {
        self.stages
    }

    #[getter]
    fn nbytes(&self) -> usize {
        locked(&self.memory).bytes()
    }

    #[getter]
    fn leading<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let leading = locked(&self.memory).leading().to_vec();
        let shape = if self.stages == 1 { vec![] } else { vec![self.stages, self.stages] };
        leading.into_pyarray(py).reshape(shape)
    }

    fn __len__(&self) -> usize {
        locked(&self.memory).len()
    }

    fn next_term<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let term = guarded(|| {
            let mut term = vec![0.0; self.channels * self.stages];
            locked(&self.memory).next_term(&mut term).map_err(refused)?;
            Ok(term)
        })?;
        let shape = if self.stages == 1 { vec![self.channels] } else { vec![self.channels, self.stages] };
        term.into_pyarray(py).reshape(shape)
    }

    fn push(&self, sample: PyReadonlyArrayDyn<'_, f64>) -> PyResult<()> {
        let sample: Vec<f64> = sample.as_array().iter().copied().collect();
        guarded(|| locked(&self.memory).push(&sample).map_err(refused))
    }

    fn clear(&self) {
        locked(&self.memory).clear();
    }

    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let memory = locked(&self.memory);
        let state = guarded(|| saved(memory.state_bytes(), |writer| memory.save(writer)))?;
        Ok(PyBytes::new(py, &state))
    }

    fn restore(&self, state: &[u8]) -> PyResult<()> {
        guarded(|| restore(&mut locked(&self.memory), state).map_err(bad_state))
    }

    fn restore_channels(
        &self,
        state: &[u8],
        of: usize,
        first: usize,
        count: usize,
        to: usize,
    ) -> PyResult<()> {
        let channels = SavedChannels { of, first, count, to };
        guarded(|| {
            locked(&self.memory).restore_channels(&mut StateReader::new(state), channels).map_err(bad_state)
        })
    }
}

/// A fractional operator on a stream.
#[pyclass(frozen, subclass, module = "fvi._fvi", name = "Operator")]
pub(crate) struct Operator {
    operator: Mutex<FractionalOperator<f64, HostMemory<f64>>>,
}

fn not_taken(error: OperatorError) -> Failure {
    match error {
        OperatorError::Memory(error) => refused(error),
        _ => Failure::Input {
            key: "sample".to_owned(),
            value: String::new(),
            message: "sample: not finite, or so large that the result is not".to_owned(),
        },
    }
}

#[pymethods]
impl Operator {
    #[new]
    #[pyo3(signature = (*, exponent, step, order, start, rise, length, engine))]
    fn new(
        exponent: f64,
        step: f64,
        order: usize,
        start: &str,
        rise: Option<f64>,
        length: usize,
        engine: Option<&str>,
    ) -> PyResult<Self> {
        let engine = engine.map(self::engine).transpose()?;
        guarded(|| {
            let start = match (start, rise) {
                ("caputo", None) => Start::Caputo,
                ("caputo", Some(rise)) => Start::CaputoWithRise { rise },
                _ => Start::RiemannLiouville,
            };
            let transfer = transfer(Some(exponent), None)?;
            let history = History { engine, ..History::default() };
            let memory =
                memory(&convolution("bdf", order, None)?, &transfer, step, (1, length, true), &history)?;
            let operator = FractionalOperator::new(memory, start).map_err(not_taken)?;
            Ok(Self { operator: Mutex::new(operator) })
        })
    }

    fn push(&self, sample: f64) -> PyResult<f64> {
        guarded(|| locked(&self.operator).push(sample).map_err(not_taken))
    }

    fn push_many<'py>(
        &self,
        py: Python<'py>,
        samples: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let samples = samples.as_array().to_vec();
        let results = py.detach(|| {
            guarded(|| {
                let mut operator = locked(&self.operator);
                samples
                    .iter()
                    .map(|&sample| operator.push(sample).map_err(not_taken))
                    .collect::<Outcome<Vec<_>>>()
            })
        })?;
        Ok(results.into_pyarray(py))
    }

    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let operator = locked(&self.operator);
        let state = guarded(|| saved(operator.state_bytes(), |writer| operator.save(writer)))?;
        Ok(PyBytes::new(py, &state))
    }

    fn restore(&self, state: &[u8]) -> PyResult<()> {
        guarded(|| {
            let mut operator = locked(&self.operator);
            operator.restore(&mut StateReader::new(state)).map_err(bad_state)
        })
    }
}
