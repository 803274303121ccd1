//! Frequency response and poles of a scenario.

use crate::documents::Source;
use crate::errors::{Failure, guarded};
use crate::run::read;
use crate::watch::Watch;
use fvi_host::response::{Complex, MODES, POINTS, ResponseError, ResponseOptions, respond};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::sync::atomic::{AtomicBool, Ordering};

/// The response of a scenario: one dictionary of lists.
#[pyfunction]
#[pyo3(signature = (source, *, omega = None, from_omega = None, to_omega = None, points = None, input = 0, output = 0,
                    position = None, near = None, modes = None, discrete = true))]
#[expect(clippy::too_many_arguments, reason = "the keywords of the function")]
pub(crate) fn response<'py>(
    py: Python<'py>,
    source: Source,
    omega: Option<Vec<f64>>,
    from_omega: Option<f64>,
    to_omega: Option<f64>,
    points: Option<usize>,
    input: usize,
    output: usize,
    position: Option<Vec<f64>>,
    near: Option<Vec<f64>>,
    modes: Option<usize>,
    discrete: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let found = py.detach(|| {
        guarded(|| {
            let scenario = read(&source, None)?;
            let options = ResponseOptions {
                from: from_omega,
                to: to_omega,
                points: points.unwrap_or(POINTS),
                omega,
                input,
                output,
                position,
                near: near.unwrap_or_default(),
                modes: modes.unwrap_or(MODES),
                discrete,
            };
            let stop = AtomicBool::new(false);
            let mut watch = Watch::new(None);
            let result = respond(&scenario, &options, &stop, &mut |done, all| {
                if !watch.tick(done, all) {
                    stop.store(true, Ordering::Relaxed);
                }
            });
            if let Some(error) = watch.into_raised() {
                return Err(Failure::Raised(error));
            }
            result.map_err(|error| match error {
                ResponseError::Input(error) => source.failure(&error),
                ResponseError::Argument(error) => error.into(),
                ResponseError::Position { found, expected } => Failure::argument(
                    "position",
                    found,
                    &format!("{expected} numbers, one for each coordinate"),
                ),
                ResponseError::NoRoom { .. } => Failure::NoRoom(format!("points: {error}")),
                other => Failure::Failed(other.to_string()),
            })
        })
    })?;
    let record = PyDict::new(py);
    record.set_item("omega", &found.omega)?;
    record.set_item("response", pairs(&found.response))?;
    let (omega, between): (Vec<f64>, Vec<_>) = found.between.iter().copied().unzip();
    record.set_item("omega_between", omega)?;
    record.set_item("between", pairs(&between))?;
    record.set_item("discrete", found.discrete.as_ref().ok().map(pairs))?;
    let poles = found
        .poles
        .as_ref()
        .ok()
        .map(|poles| poles.iter().map(|pole| (pole.place.re, pole.place.im)).collect::<Vec<_>>());
    record.set_item("poles", poles)?;
    let modes = PyList::empty(py);
    for (near, mode) in &found.modes {
        let entry = PyDict::new(py);
        entry.set_item("near", near)?;
        entry.set_item("s", (mode.place.re, mode.place.im))?;
        entry.set_item("shape", pairs(&mode.shape))?;
        entry.set_item("residual", mode.residual)?;
        entry.set_item("of_tables", mode.of_tables)?;
        modes.append(entry)?;
    }
    record.set_item("modes", modes)?;
    let kernels = PyList::empty(py);
    for kernel in &found.kernels {
        let entry = PyDict::new(py);
        entry.set_item("name", &kernel.name)?;
        entry.set_item("moduli", pairs(&kernel.moduli))?;
        entry.set_item("t", &kernel.times)?;
        entry.set_item("creep", kernel.creep.as_ref())?;
        entry.set_item("relaxation", kernel.relaxation.as_ref())?;
        kernels.append(entry)?;
    }
    record.set_item("kernels", kernels)?;
    record.set_item("left_out", found.left_out())?;
    record.set_item("warnings", &found.warnings)?;
    Ok(record)
}

/// Real and imaginary parts.
fn pairs(values: impl AsRef<[Complex]>) -> Vec<(f64, f64)> {
    values.as_ref().iter().map(|value| (value.re, value.im)).collect()
}
