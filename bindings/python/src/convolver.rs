//! Finite responses on endless streams.

use std::sync::{Mutex, MutexGuard, PoisonError};

use fvi_core::{StateReader, StateWriter, Stateful};
use fvi_fft::{Convolver as Engine, Engines, ExchangeError, Responses, Stream, StreamError};
use numpy::{Element, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::{Failure, Outcome, guarded};

/// A convolver in the precision of its responses.
enum Precision {
    Single(Engine<f32>),
    Double(Engine<f64>),
}

/// A scalar that convolvers may have.
trait Kind: Engines + Element + Copy {
    /// The convolver, if it has this scalar.
    fn within(precision: &mut Precision) -> Option<&mut Engine<Self>>;
}

impl Kind for f32 {
    fn within(precision: &mut Precision) -> Option<&mut Engine<Self>> {
        match precision {
            Precision::Single(convolver) => Some(convolver),
            Precision::Double(_) => None,
        }
    }
}

impl Kind for f64 {
    fn within(precision: &mut Precision) -> Option<&mut Engine<Self>> {
        match precision {
            Precision::Single(_) => None,
            Precision::Double(convolver) => Some(convolver),
        }
    }
}

/// Evaluates an expression for the convolver of either precision.
macro_rules! of_either {
    ($precision:expr, $convolver:ident => $value:expr) => {
        match $precision {
            Precision::Single($convolver) => $value,
            Precision::Double($convolver) => $value,
        }
    };
}

/// A convolver.
#[pyclass(frozen, subclass, module = "fvi._fvi", name = "Convolver")]
pub(crate) struct Convolver {
    convolver: Mutex<Precision>,
    single: bool,
}

/// The rows of an array in the precision of the convolver.
fn rows<T: Kind>(name: &str, array: &Bound<'_, PyAny>) -> Outcome<Vec<Vec<T>>> {
    let allowed = "an array of two dimensions in the precision of the responses";
    let array: PyReadonlyArray2<'_, T> =
        array.extract().map_err(|_| Failure::argument(name, "an array", allowed))?;
    Ok(array.as_array().outer_iter().map(|row| row.to_vec()).collect())
}

/// Rows of responses in an arrangement: "shared", one for `outputs` channels; "each", one for each channel;
/// or "matrix", input by input.
fn responses<T: Kind>(rows: &[Vec<T>], arrangement: &str, outputs: usize) -> Outcome<Responses<T>> {
    Ok(match (arrangement, rows) {
        ("shared", [row]) => Responses::shared(row, outputs)?,
        ("each", rows) => Responses::each(rows)?,
        (_, rows) => Responses::matrix(outputs, rows)?,
    })
}

/// What the shapes of the Python class exclude.
fn other_precision() -> Failure {
    Failure::Failed("the convolver has another precision".to_owned())
}

fn not_taken(error: StreamError) -> Failure {
    let key = match error {
        StreamError::NotFinite { .. } => "block",
        _ => "shape",
    };
    Failure::Input { key: key.to_owned(), value: String::new(), message: format!("block: {error}") }
}

fn bad_state(error: fvi_core::StateError) -> Failure {
    Failure::Input { key: "state".to_owned(), value: String::new(), message: format!("state: {error}") }
}

fn process<T: Kind>(precision: &mut Precision, inputs: &[Vec<T>]) -> Outcome<Vec<Vec<T>>> {
    let convolver = T::within(precision).ok_or_else(other_precision)?;
    let samples = inputs.first().map_or(0, Vec::len);
    let mut outputs = vec![vec![T::zero(); samples]; convolver.outputs()];
    convolver.process(inputs, &mut outputs).map_err(not_taken)?;
    Ok(outputs)
}

fn exchange<T: Kind>(precision: &mut Precision, responses: &Responses<T>, fade: usize) -> Outcome<()> {
    let convolver = T::within(precision).ok_or_else(other_precision)?;
    let prepared = convolver.preparer().prepare(responses)?;
    convolver.exchange(prepared, fade).map_err(|error| match error {
        ExchangeError::Busy { left, .. } => {
            Failure::Failed(format!("the last exchange ends in {left} samples; only then can another begin"))
        }
        other => Failure::Failed(other.to_string()),
    })?;
    // What an earlier one has put out of use is freed here.
    convolver.take_retired();
    Ok(())
}

fn saved(convolver: &impl Stateful) -> Outcome<Vec<u8>> {
    let mut room = vec![0; convolver.state_bytes()];
    convolver.save(&mut StateWriter::new(&mut room)).map_err(|error| Failure::Failed(error.to_string()))?;
    Ok(room)
}

fn restore(convolver: &mut impl Stateful, state: &[u8]) -> Outcome<()> {
    let mut ahead = StateReader::new(state);
    convolver.check_state(&mut ahead).and_then(|()| ahead.finish()).map_err(bad_state)?;
    convolver.restore(&mut StateReader::new(state)).map_err(bad_state)
}

impl Convolver {
    fn locked(&self) -> MutexGuard<'_, Precision> {
        self.convolver.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn process_in<'py, T: Kind>(
        &self,
        py: Python<'py>,
        block: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<T>>> {
        let inputs = guarded(|| rows::<T>("block", block))?;
        let outputs = py.detach(|| guarded(|| process(&mut self.locked(), &inputs)))?;
        Ok(PyArray2::from_vec2(py, &outputs)?)
    }

    fn exchange_in<T: Kind>(
        &self,
        py: Python<'_>,
        rows: &Bound<'_, PyAny>,
        arrangement: &str,
        (outputs, fade): (usize, usize),
    ) -> PyResult<()> {
        let rows = guarded(|| self::rows::<T>("response", rows))?;
        py.detach(|| guarded(|| exchange(&mut self.locked(), &responses(&rows, arrangement, outputs)?, fade)))
    }
}

#[pymethods]
impl Convolver {
    #[new]
    #[pyo3(signature = (*, rows, single, arrangement, outputs, latency, block, longest))]
    fn new(
        rows: &Bound<'_, PyAny>,
        single: bool,
        arrangement: &str,
        outputs: usize,
        latency: usize,
        block: Option<usize>,
        longest: usize,
    ) -> PyResult<Self> {
        let stream = Stream { latency, block, longest };
        guarded(|| {
            let convolver = if single {
                let responses = responses(&self::rows::<f32>("response", rows)?, arrangement, outputs)?;
                Precision::Single(Engine::new(&responses, &stream)?)
            } else {
                let responses = responses(&self::rows::<f64>("response", rows)?, arrangement, outputs)?;
                Precision::Double(Engine::new(&responses, &stream)?)
            };
            Ok(Self { convolver: Mutex::new(convolver), single })
        })
    }

    #[getter]
    fn inputs(&self) -> usize {
        of_either!(&*self.locked(), convolver => convolver.inputs())
    }

    #[getter]
    fn outputs(&self) -> usize {
        of_either!(&*self.locked(), convolver => convolver.outputs())
    }

    #[getter]
    fn latency(&self) -> usize {
        of_either!(&*self.locked(), convolver => convolver.latency())
    }

    #[getter]
    fn longest(&self) -> usize {
        of_either!(&*self.locked(), convolver => convolver.longest())
    }

    #[getter]
    fn taken(&self) -> u64 {
        of_either!(&*self.locked(), convolver => convolver.taken())
    }

    #[getter]
    fn exchange_left(&self) -> u64 {
        of_either!(&*self.locked(), convolver => convolver.exchange_left())
    }

    #[getter]
    fn nbytes(&self) -> usize {
        of_either!(&*self.locked(), convolver => convolver.bytes())
    }

    #[getter]
    fn stages(&self) -> Vec<(usize, usize)> {
        of_either!(&*self.locked(), convolver => convolver.stages().collect())
    }

    fn process<'py>(&self, py: Python<'py>, block: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        Ok(if self.single {
            self.process_in::<f32>(py, block)?.into_any()
        } else {
            self.process_in::<f64>(py, block)?.into_any()
        })
    }

    fn exchange(
        &self,
        py: Python<'_>,
        rows: &Bound<'_, PyAny>,
        arrangement: &str,
        outputs: usize,
        fade: usize,
    ) -> PyResult<()> {
        if self.single {
            self.exchange_in::<f32>(py, rows, arrangement, (outputs, fade))
        } else {
            self.exchange_in::<f64>(py, rows, arrangement, (outputs, fade))
        }
    }

    fn clear(&self) {
        of_either!(&mut *self.locked(), convolver => convolver.clear());
    }

    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let state = guarded(|| of_either!(&*self.locked(), convolver => saved(convolver)))?;
        Ok(PyBytes::new(py, &state))
    }

    fn restore(&self, state: &[u8]) -> PyResult<()> {
        guarded(|| of_either!(&mut *self.locked(), convolver => restore(convolver, state)))
    }
}
