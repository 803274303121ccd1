//! Weights of convolution quadrature as a head and decaying exponentials.

use crate::errors::{Failure, guarded};
use crate::memory::{keys, transfer};
use fvi_core::BdfOrder;
use fvi_fft::exponentials::band_table::band_table;
use fvi_fft::exponentials::exponential_table::{ENDLESS, ExponentialKernel, ExponentialKernelError};
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Head, rates and coefficients.
type Table<'py> = [Bound<'py, PyArray1<f64>>; 3];

/// The table of a kernel; without `horizon` it has no end.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of the function in Python")]
pub(crate) fn exponentials<'py>(
    py: Python<'py>,
    order: usize,
    exponent: Option<f64>,
    kernel: Option<&Bound<'py, PyDict>>,
    step: f64,
    increments: bool,
    horizon: Option<usize>,
    band: Option<[f64; 2]>,
    tolerance: f64,
) -> PyResult<Table<'py>> {
    let kernel = keys(kernel)?;
    let table = py.detach(|| {
        guarded(|| {
            let (order, transfer) = (BdfOrder::new(order)?, transfer(exponent, kernel)?);
            let made = match band {
                Some(band) => {
                    band_table(&transfer, order, increments, step, band, tolerance).map(|(table, _)| table)
                }
                None => ExponentialKernel::of_transfer(
                    &transfer,
                    order,
                    increments,
                    step,
                    horizon.unwrap_or(ENDLESS),
                    tolerance,
                ),
            };
            made.map_err(|error| match error {
                ExponentialKernelError::Parameter(error) => error.into(),
                missed => Failure::argument("tolerance", tolerance, &missed.to_string()),
            })
        })
    })?;
    let of = |number: fn(&(f64, f64)) -> f64| {
        let pairs = table.exponentials().iter().map(|one| (one.rate, one.coefficient));
        pairs.map(|pair| number(&pair)).collect::<Vec<f64>>()
    };
    let numbers = [table.head().to_vec(), of(|pair| pair.0), of(|pair| pair.1)];
    Ok(numbers.map(|numbers| numbers.into_pyarray(py)))
}
