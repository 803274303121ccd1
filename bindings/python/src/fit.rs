//! Fits of scenarios to data.

use crate::documents::Source;
use crate::errors::{Failure, guarded};
use crate::watch::Watch;
use fvi_host::fit::{Fit, FitError, Fitted, FittedModel, fit as find};
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Data, model and deviations of a column.
type ColumnInPython<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// For a table of data: values of the independent variable, its name (t or omega), and the columns.
type TableInPython<'py> = (Bound<'py, PyArray1<f64>>, &'static str, Vec<ColumnInPython<'py>>);

/// Records of models, the best one, scenarios, report and tables.
type FitInPython<'py> = (Vec<String>, usize, Vec<String>, String, Vec<TableInPython<'py>>);

/// Fits a scenario to data: the records of all models as JSON, the index of the best one, the scenarios with
/// its estimates (that of all, then those of the tables of data) as JSON, its report, and the tables.
#[pyfunction]
#[pyo3(signature = (plan, scenario, progress = None))]
pub(crate) fn fit<'py>(
    py: Python<'py>,
    plan: Source,
    scenario: Option<Source>,
    progress: Option<Py<PyAny>>,
) -> PyResult<FitInPython<'py>> {
    let refused = |error: fvi_scenario::language::InputError| match (&plan, &scenario) {
        (Source::File(_), _) => plan.failure(&error),
        (_, Some(scenario)) if scenario.is_file() && error.file() != "fit" => scenario.failure(&error),
        _ => Failure::of_document(&error, false),
    };
    let (plan, found) = py.detach(|| {
        guarded(|| {
            let read = || match &scenario {
                None => plan.document().and_then(|document| Fit::from_document(&document)),
                Some(scenario) => Fit::of_scenario(&plan.document()?, scenario.document()?),
            };
            let plan = read().map_err(refused)?;
            let stop = AtomicBool::new(false);
            let mut watch = Watch::new(progress);
            let result = find(&plan, &stop, &mut |runs| {
                if !watch.tick(runs, None) {
                    stop.store(true, Ordering::Relaxed);
                }
            });
            if let Some(error) = watch.into_raised() {
                return Err(Failure::Raised(error));
            }
            let found = result.map_err(|error| match error {
                FitError::Start(reason) => Failure::Input {
                    key: "scenario".to_owned(),
                    value: String::new(),
                    message: format!("there is no motion where the parameters start: {reason}"),
                },
                FitError::Unresolved(message) => {
                    Failure::Input { key: "time.step".to_owned(), value: String::new(), message }
                }
                FitError::Untouched(message) => {
                    Failure::Input { key: "free".to_owned(), value: String::new(), message }
                }
                other => Failure::Failed(other.to_string()),
            })?;
            Ok((plan, found))
        })
    })?;
    let moved = scenario.as_ref().is_none_or(Source::is_file);
    into_python(py, &plan, &found, moved)
}

fn into_python<'py>(py: Python<'py>, plan: &Fit, found: &Fitted, moved: bool) -> PyResult<FitInPython<'py>> {
    let json = |value: Result<String, serde_json::Error>| -> PyResult<String> {
        Ok(value.map_err(|error| Failure::Failed(error.to_string()))?)
    };
    let record = |model: &FittedModel| json(serde_json::to_string(model));
    let models = found.models.iter().map(record).collect::<PyResult<_>>()?;
    let best = found.best();
    let scenario =
        |record: Option<usize>| json(serde_json::to_string(&plan.scenario_of(best, record, moved)));
    let records = std::iter::once(None).chain((0..plan.tables()).map(Some));
    let scenarios = records.map(scenario).collect::<PyResult<_>>()?;
    let table = |index: usize| {
        let (places, columns) = (plan.places(index), plan.columns(index));
        let array = |numbers: &[f64]| numbers.to_vec().into_pyarray(py);
        let column = |((data, deviations), told): ((&[f64], &[f64]), &Vec<f64>)| {
            (array(data), array(told), array(deviations))
        };
        let columns = columns.into_iter().zip(&best.told[index]).map(column).collect();
        (array(places), plan.over(index), columns)
    };
    let tables = (0..plan.tables()).map(table).collect();
    Ok((models, found.best, scenarios, found.report(plan), tables))
}
