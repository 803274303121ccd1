//! Studies: two-point problems, orders of convergence, engines side by side.

use crate::documents::Source;
use crate::errors::{Failure, guarded};
use crate::run::{engine, read};
use crate::watch::Watch;
use fvi_core::{BdfOrder, ParameterError};
use fvi_exhibits::two_point::{ProblemFile, Status};
use fvi_host::converge::{ConvergeError, Grids, converge as measure};
use fvi_strategies::engines::{Comparison, ComparisonError, strategies};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::sync::atomic::{AtomicBool, Ordering};

/// Solves a two-point problem: t, x, v, and the report on the solution.
#[pyfunction]
#[expect(clippy::type_complexity, reason = "three arrays and a table")]
pub(crate) fn extremal<'py>(
    py: Python<'py>,
    source: Source,
) -> PyResult<(
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyDict>,
)> {
    let (file, converged, solution) = py.detach(|| {
        guarded(|| {
            let file = source.document().and_then(ProblemFile::from_document);
            let file = file.map_err(|error| source.failure(&error))?;
            fvi_exhibits::two_point::require_room(&file)
                .map_err(|error| Failure::NoRoom(error.to_string()))?;
            let solved = file.solve(file.grid, &mut |_, _| {}).map_err(|error| {
                let message = error.to_string();
                Failure::Input { key: "problem".to_owned(), value: String::new(), message }
            })?;
            let (status, solution) = match solved {
                Ok(solution) => (Status::Converged, solution),
                Err(not_converged) => (Status::NotConverged, *not_converged.best),
            };
            Ok((file, status == Status::Converged, solution))
        })
    })?;
    let points = file.grid.steps() + 1;
    let time: Vec<f64> = (0..points).map(|k| file.grid.time(k)).collect();
    let mut velocities = solution.velocities;
    // The fractional velocity is not defined at one end.
    let (excluded, size) = (file.sigma.excluded(file.grid.steps()), file.coordinates());
    velocities[excluded * size..(excluded + 1) * size].fill(f64::NAN);
    let record = PyDict::new(py);
    record.set_item("converged", converged)?;
    record.set_item("value", solution.value)?;
    record.set_item("newton_iterations", solution.newton_iterations)?;
    record.set_item("krylov_iterations", solution.krylov_iterations)?;
    record.set_item("relative_residual", solution.relative_residual)?;
    record.set_item("residual_history", solution.history)?;
    record.set_item("residual", solution.residual)?;
    record.set_item("rounding_level", solution.rounding_level)?;
    let shape = [points, size];
    Ok((
        time.into_pyarray(py),
        solution.positions.into_pyarray(py).reshape(shape)?,
        velocities.into_pyarray(py).reshape(shape)?,
        record,
    ))
}

/// Errors and orders of a scenario over step sizes: one dictionary for each level.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of the function in Python")]
pub(crate) fn converge<'py>(
    py: Python<'py>,
    source: Source,
    first: u32,
    last: u32,
    intervals: usize,
    from: f64,
    engine: Option<&str>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyList>, Option<String>)> {
    let engine = engine.map(self::engine).transpose()?;
    let convergence = py.detach(|| {
        guarded(|| {
            let scenario = read(&source, engine)?;
            let stop = AtomicBool::new(false);
            let mut watch = Watch::new(progress);
            let grids = Grids { levels: first..=last, intervals, from };
            let result = measure(&scenario, &grids, &stop, &mut |made, all| {
                if !watch.tick(made, all) {
                    stop.store(true, Ordering::Relaxed);
                }
            });
            if let Some(error) = watch.into_raised() {
                return Err(Failure::Raised(error));
            }
            result.map_err(|error| match error {
                ConvergeError::Input(error) => source.failure(&error),
                ConvergeError::NoRoom(_) => Failure::NoRoom(format!("levels: {error}")),
                ConvergeError::TooManySteps { .. } => Failure::argument("levels", last, &error.to_string()),
                ConvergeError::From(error) => Failure::argument("from_time", from, error.allowed),
                other => Failure::Failed(other.to_string()),
            })
        })
    })?;
    let rows = PyList::empty(py);
    for (index, level) in convergence.levels.iter().enumerate() {
        let row = PyDict::new(py);
        row.set_item("level", level.level)?;
        row.set_item("steps", level.steps)?;
        row.set_item("step", level.step)?;
        for quantity in fvi_host::converge::Quantity::ALL {
            let name = quantity.name();
            row.set_item(format!("{name}_error"), convergence.error(index, quantity).unwrap_or(f64::NAN))?;
            row.set_item(format!("{name}_order"), convergence.order(index, quantity).unwrap_or(f64::NAN))?;
        }
        row.set_item("seconds", level.seconds)?;
        row.set_item("failure", level.failure.as_deref())?;
        rows.append(row)?;
    }
    Ok((rows, convergence.warning()))
}

/// Engines side by side: one dictionary for each engine, kernel and length.
#[pyfunction]
pub(crate) fn compare_engines<'py>(
    py: Python<'py>,
    lengths: Vec<usize>,
    orders: Vec<usize>,
    exponents: Vec<f64>,
    repetitions: Option<usize>,
) -> PyResult<Bound<'py, PyList>> {
    let rows = py.detach(|| {
        guarded(|| {
            let mut kernels = Vec::new();
            for &order in &orders {
                for &exponent in &exponents {
                    let order = BdfOrder::new(order)?;
                    fvi_core::ConvolutionWeights::bdf(order, exponent, 1.0)?;
                    kernels.push((order, exponent));
                }
            }
            if let Some(&length) = lengths.iter().find(|&&length| length == 0) {
                return Err(Failure::argument("lengths", length, "one step at least"));
            }
            if repetitions == Some(0) {
                return Err(
                    ParameterError { parameter: "repetitions", value: 0.0, allowed: "one at least" }.into()
                );
            }
            let comparison = Comparison { lengths, kernels, repetitions };
            let mut watch = Watch::new(None);
            let result = comparison.run(&strategies(), &mut |_| {
                watch.tick(0, 1_usize);
            });
            if let Some(error) = watch.into_raised() {
                return Err(Failure::Raised(error));
            }
            result.map_err(|error| match error {
                ComparisonError::NoRoom { .. } => Failure::NoRoom(format!("lengths: {error}")),
                other => Failure::Failed(other.to_string()),
            })
        })
    })?;
    let list = PyList::empty(py);
    for measured in &rows {
        let row = PyDict::new(py);
        row.set_item("engine", &measured.engine)?;
        row.set_item("length", measured.length)?;
        row.set_item("order", measured.order.get())?;
        row.set_item("exponent", measured.exponent)?;
        row.set_item("error_u", measured.max_error_u)?;
        row.set_item("mean_ns", measured.step_mean_ns)?;
        row.set_item("p50_ns", measured.step_quantile_ns(0.5).unwrap_or(f64::NAN))?;
        row.set_item("p999_ns", measured.step_quantile_ns(0.999).unwrap_or(f64::NAN))?;
        row.set_item("max_ns", measured.step_quantile_ns(1.0).unwrap_or(f64::NAN))?;
        row.set_item("bytes", measured.bytes)?;
        list.append(row)?;
    }
    Ok(list)
}
