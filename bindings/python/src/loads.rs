//! Loads as impulses for the midpoint rule.

use crate::documents::Source;
use crate::errors::{Failure, guarded};
use crate::run::read;
use fvi_core::{Instant, Mechanics as _, NodalRule};
use fvi_simulation::model::Model;
use numpy::{IntoPyArray, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// The forces of a scenario that depend on time only, over equal steps.
#[pyclass(frozen, module = "fvi._fvi")]
pub(crate) struct Loads {
    model: Mutex<Model<f64>>,
    coordinates: usize,
    step: f64,
}

#[pymethods]
impl Loads {
    #[new]
    fn new(source: Source) -> PyResult<Self> {
        guarded(|| {
            let scenario = read(&source, None)?;
            let model = Model::new(&scenario).map_err(|error| Failure::Failed(error.to_string()))?;
            let (coordinates, step) = (scenario.coordinates(), scenario.time.step);
            Ok(Self { model: Mutex::new(model), coordinates, step })
        })
    }

    /// For `count` steps from step `first` on, h ∫ (1 − τ) F dτ and h ∫ τ F dτ over the step, each a number
    /// for each coordinate: the contributions of F to the momenta at both ends of a step. Where F is smooth,
    /// its value at the midpoint is used.
    fn impulses<'py>(
        &self,
        py: Python<'py>,
        first: u64,
        count: usize,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let impulses = py.detach(|| {
            guarded(|| {
                let mut model = self.model.lock().unwrap_or_else(PoisonError::into_inner);
                let (size, h) = (self.coordinates, self.step);
                let rest = vec![0.0; size];
                let (mut restoring, mut moment_correction) = (vec![0.0; size], vec![0.0; 2 * size]);
                let mut impulses = Vec::with_capacity(2 * size * count);
                for step in 0..count as u64 {
                    let start = (first + step) as f64 * h;
                    model.restoring_force(Instant::in_step(start, 0.5, h), &rest, &mut restoring);
                    let rule = NodalRule {
                        start,
                        length: h,
                        weights: &[1.0],
                        nodes: &[0.5],
                        points: &[1.0],
                        shapes: &[0.5],
                        tests: &[0.5],
                    };
                    if !(model.is_rough() && model.moment_correction(&rule, &mut moment_correction)) {
                        moment_correction.fill(0.0);
                    }
                    let both = restoring.iter().chain(&restoring).zip(&moment_correction);
                    impulses.extend(
                        both.map(|(restoring, moment_correction)| h * (moment_correction - 0.5 * restoring)),
                    );
                }
                Ok(impulses)
            })
        })?;
        impulses.into_pyarray(py).reshape([count, 2, self.coordinates])
    }
}
