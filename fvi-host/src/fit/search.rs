//! The search for the parameters of one model: weighted residuals on the scales of the parameters.

use super::data::Record;
use super::least_squares::{Evaluation, Minimum, Refusal, Region, Residuals, minimise};
use super::no_prediction::NoPrediction;
use super::plan::{Fit, Free, Model, Scale};
use super::prediction::{Predicted, Predictions};
use nalgebra::{DMatrix, DVector};

/// The residuals of a model's predictions.
pub(super) struct Search<'p, 'f> {
    pub(super) predictions: &'p mut Predictions<'f>,
    pub(super) free: &'f [Free],
    pub(super) data: DVector<f64>,
    pub(super) deviations: DVector<f64>,
    most_iterations: usize,
    /// True once it is known that some datum changes with each parameter.
    are_touched: bool,
}

/// Rounding errors of residuals, relative to the largest datum.
const ROUNDING: f64 = 1e-13;

/// Why a search ended without a result.
#[derive(Clone, Debug)]
pub(super) enum Ended {
    /// It was stopped.
    Stopped,
    /// No datum changes with a parameter: a sentence that names it.
    Untouched(String),
}

impl From<NoPrediction> for Refusal<Ended> {
    fn from(reason: NoPrediction) -> Self {
        match reason {
            NoPrediction::Refused(reason) => Self::Point(reason),
            NoPrediction::Stopped => Self::End(Ended::Stopped),
        }
    }
}

impl Residuals for Search<'_, '_> {
    type End = Ended;

    fn evaluate(&mut self, point: &[f64], derivatives: bool) -> Result<Evaluation, Refusal<Ended>> {
        let values = self.outside(point);
        let Predicted { values: told, jacobian, .. } = self.predictions.at(&values, derivatives)?;
        if let (Some(jacobian), false) = (&jacobian, self.are_touched) {
            self.check_touched(&values, jacobian)?;
        }
        let residuals = (told - &self.data).component_div(&self.deviations);
        let jacobian = jacobian.map(|mut jacobian| {
            for (index, mut column) in jacobian.column_iter_mut().enumerate() {
                let stretch = if self.free[index].scale == Scale::Logarithmic { values[index] } else { 1.0 };
                column
                    .iter_mut()
                    .zip(&self.deviations)
                    .for_each(|(slope, deviation)| *slope *= stretch / deviation);
            }
            jacobian
        });
        let is_finite = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
        let all_finite = is_finite(residuals.as_slice())
            && jacobian.as_ref().is_none_or(|jacobian| is_finite(jacobian.as_slice()));
        if !all_finite {
            return Err(Refusal::Point(
                "what the model says, or a derivative of it, is not finite".to_owned(),
            ));
        }
        Ok(Evaluation { residuals, jacobian })
    }
}

impl<'p, 'f> Search<'p, 'f> {
    pub(super) fn new(plan: &'f Fit, model: &'f Model, predictions: &'p mut Predictions<'f>) -> Self {
        let row = |record: &Record, of: fn(&super::data::Column) -> &Vec<f64>| -> Vec<f64> {
            let rows = 0..record.places.len();
            rows.flat_map(|row| record.columns.iter().map(move |column| of(column)[row])).collect()
        };
        let all = |of: fn(&super::data::Column) -> &Vec<f64>| -> DVector<f64> {
            DVector::from_vec(plan.records.iter().flat_map(|record| row(record, of)).collect())
        };
        Self {
            predictions,
            free: &model.free,
            data: all(|column| &column.values),
            deviations: all(|column| &column.deviations),
            most_iterations: plan.most_iterations,
            are_touched: false,
        }
    }

    /// Refuses a parameter with which no datum changes, neither at these values nor beside them, where a
    /// derivative that vanishes by chance does not.
    fn check_touched(&mut self, values: &[f64], jacobian: &DMatrix<f64>) -> Result<(), Refusal<Ended>> {
        let untouched = |jacobian: &DMatrix<f64>| -> Vec<usize> {
            (0..jacobian.ncols())
                .filter(|&index| jacobian.column(index).iter().all(|&slope| slope == 0.0))
                .collect()
        };
        let here = untouched(jacobian);
        if !here.is_empty() {
            let beside = self.predictions.at(&self.predictions.nudged(values), true)?.jacobian;
            let beside = beside.map_or_else(Vec::new, |jacobian| untouched(&jacobian));
            if let Some(&index) = here.iter().find(|index| beside.contains(index)) {
                return Err(Refusal::End(Ended::Untouched(format!(
                    "no datum changes with {}: leave it out of `free`, or give data that depend on it",
                    self.free[index].key()
                ))));
            }
        }
        self.are_touched = true;
        Ok(())
    }

    /// The values of the parameters at a point of the search.
    pub(super) fn outside(&self, point: &[f64]) -> Vec<f64> {
        let pairs = self.free.iter().zip(point);
        // Clamped, so that a bound is reached exactly despite the rounding of the logarithmic scale.
        pairs.map(|(free, &x)| free.scale.outside(x).max(free.bounds.0).min(free.bounds.1)).collect()
    }

    /// The point of the search for these values of the parameters.
    pub(super) fn inside(&self, values: &[f64]) -> Vec<f64> {
        self.free.iter().zip(values).map(|(free, &value)| free.scale.inside(value)).collect()
    }

    /// Bounds and scales of the search for parameters near these values.
    pub(super) fn region(&self, values: &[f64]) -> Region {
        let bounds =
            |of: fn(&Free) -> f64| self.free.iter().map(|free| free.scale.inside(of(free))).collect();
        let typical = self.free.iter().zip(values).map(|(free, &value)| free.typical(value)).collect();
        let largest = self.data.component_div(&self.deviations).amax();
        let rounding = self.data.len() as f64 * (ROUNDING * largest).powi(2);
        // A number on a logarithmic scale changes by a factor of e at most.
        let longest = |free: &Free| if free.scale == Scale::Logarithmic { 1.0 } else { f64::INFINITY };
        Region {
            lower: bounds(|free| free.bounds.0),
            upper: bounds(|free| free.bounds.1),
            typical,
            longest: self.free.iter().map(longest).collect(),
            rounding,
        }
    }

    /// Minimises the sum of squares from a start; the parameter `hold`, if any, keeps its value.
    pub(super) fn from(&mut self, start: &[f64], hold: Option<usize>) -> Result<Minimum, Refusal<Ended>> {
        let mut region = self.region(&self.outside(start));
        if let Some(index) = hold {
            (region.lower[index], region.upper[index]) = (start[index], start[index]);
        }
        let most = self.most_iterations;
        minimise(self, start, &region, most)
    }
}
