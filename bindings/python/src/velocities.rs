//! Velocities of mechanisms, whose masses depend on the position.

use crate::documents::Source;
use crate::errors::guarded;
use fvi_scenario::scenario::Scenario;
use numpy::{PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// The velocities at positions with momenta, a row each; NaN where none has the momentum.
#[pyfunction]
pub(crate) fn velocities<'py>(
    py: Python<'py>,
    source: Source,
    positions: PyReadonlyArray2<'py, f64>,
    momenta: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let shape = positions.shape().to_vec();
    let numbers = |array: &PyReadonlyArray2<'py, f64>| array.as_array().iter().copied().collect::<Vec<_>>();
    let (positions, momenta) = (numbers(&positions), numbers(&momenta));
    let found = py.detach(|| {
        guarded(|| {
            let scenario = source.document().and_then(Scenario::from_document);
            let found = scenario
                .and_then(|scenario| fvi_simulation::simulation::velocities(&scenario, &positions, &momenta));
            found.map_err(|error| source.failure(&error))
        })
    })?;
    numpy::PyArray1::from_vec(py, found).reshape([shape[0], shape[1]])
}
