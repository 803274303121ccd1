//! Fractional derivatives and integrals of whole sequences.

use crate::errors::{Failure, guarded};
use crate::memory::{keys, memory, operate, refused, transfer};
use crate::run::engine;
use crate::watch::Watch;
use crate::weights::convolution;
use fvi_fft::memory::History;
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Σ_{n=0}^{k} w_n x_{k−n} down every column of an array of finite numbers, by the memory that fits its
/// length.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of the function in Python")]
pub(crate) fn derivative<'py>(
    py: Python<'py>,
    samples: PyReadonlyArray2<'py, f64>,
    exponent: Option<f64>,
    kernel: Option<&Bound<'py, PyDict>>,
    step: f64,
    order: usize,
    starting: Vec<f64>,
    engine: Option<&str>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let engine = engine.map(self::engine).transpose()?;
    let kernel = keys(kernel)?;
    let array = samples.as_array();
    let (rows, columns) = array.dim();
    let numbers = samples.as_slice().map_err(|error| Failure::Failed(error.to_string()))?;
    let result = py.detach(|| {
        guarded(|| {
            if rows == 0 || columns == 0 {
                return Ok(Vec::new());
            }
            let mut convolution = convolution("bdf", order, None)?;
            convolution.starting = starting;
            let transfer = transfer(exponent, kernel)?;
            let history = History { engine, ..History::default() };
            let mut memory = memory(&convolution, &transfer, step, (columns, rows, true), &history)?;
            let mut watch = Watch::new(None);
            let mut result = vec![0.0; numbers.len()];
            for (index, (sample, place)) in
                numbers.chunks_exact(columns).zip(result.chunks_exact_mut(columns)).enumerate()
            {
                operate(&mut memory, sample, place).map_err(refused)?;
                if !watch.tick(index, rows) {
                    break;
                }
            }
            match watch.into_raised() {
                Some(error) => Err(Failure::Raised(error)),
                None if result.iter().all(|number| number.is_finite()) => Ok(result),
                None => Err(Failure::argument("x", "…", "samples so small that the result is finite")),
            }
        })
    })?;
    result.into_pyarray(py).reshape([rows, columns])
}
