//! Tunings of controllers.

use crate::documents::Source;
use crate::errors::{Failure, guarded};
use fvi_host::tune::{TuningProblem, tune as find};
use pyo3::prelude::*;
use std::sync::atomic::AtomicBool;

/// Rows of ω and real and imaginary parts of plant, loop and sampled loop; and rows t, y, u, y after a load
/// step.
type Curves = (Vec<[f64; 7]>, Vec<[f64; 4]>);

/// Tunes a controller, for the scenario of its plant if that is given: `tune.json` as text, `[controller]` as
/// text, and the curves.
#[pyfunction]
#[pyo3(signature = (source, plant = None))]
pub(crate) fn tune(
    py: Python<'_>,
    source: Source,
    plant: Option<Source>,
) -> PyResult<(String, String, Curves)> {
    py.detach(|| {
        guarded(|| {
            let problem = || match &plant {
                None => TuningProblem::from_document(source.document()?),
                Some(plant) => TuningProblem::of_scenario(source.document()?, plant.document()?),
            };
            let problem = problem().map_err(|error| source.failure(&error))?;
            let found = find(&problem, &AtomicBool::new(false));
            let found = found.map_err(|error| Failure::Failed(error.to_string()))?;
            let record = serde_json::to_string(&found.record(&problem));
            let record = record.map_err(|error| Failure::Failed(error.to_string()))?;
            let rows = found.response.iter().map(|at| {
                let sampled = at.sampled.map_or([f64::NAN; 2], |value| [value.re, value.im]);
                [at.omega, at.plant.re, at.plant.im, at.open.re, at.open.im, sampled[0], sampled[1]]
            });
            Ok((record, found.controller_table(&problem), (rows.collect(), found.steps.clone())))
        })
    })
}
