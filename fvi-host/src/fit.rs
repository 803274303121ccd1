//! Fits: the numbers of a scenario for which its prediction agrees best with measured data, and how well the
//! data determine them.

mod closed;
mod data;
mod estimates;
mod interpolation;
mod least_squares;
mod no_prediction;
mod output;
#[cfg(feature = "pictures")]
mod pictures;
mod plan;
mod prediction;
mod prony;
mod search;
mod shift;
mod statistics;
mod units;

pub use data::KEYS as DATA_KEYS;
pub use estimates::{Estimate, FittedModel, Profiled, StartRecord, TableRecord};
pub use plan::Fit;

use estimates::estimate;
use no_prediction::NoPrediction;
use prediction::Predictions;
use search::Search;
use std::sync::atomic::AtomicBool;

/// Result of a fit.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// One for each model, in the order of the file.
    pub models: Vec<FittedModel>,
    /// Index of the model with the smallest AIC.
    pub best: usize,
}

/// Why there is no fit.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FitError {
    /// No motion can be computed with the start values of the parameters.
    #[error("{0}")]
    Start(String),
    /// The grid of the scenario is too coarse for the times of the data.
    #[error("{0}")]
    Unresolved(String),
    /// No datum changes with a parameter.
    #[error("{0}")]
    Untouched(String),
    /// It was stopped.
    #[error("stopped")]
    Stopped,
}

impl From<NoPrediction> for FitError {
    fn from(reason: NoPrediction) -> Self {
        match reason {
            NoPrediction::Refused(reason) => Self::Start(reason),
            NoPrediction::Stopped => Self::Stopped,
        }
    }
}

impl Fitted {
    /// The model with the smallest AIC.
    pub fn best(&self) -> &FittedModel {
        &self.models[self.best]
    }
}

/// Fits the models of a plan to its data; `progress` receives the number of runs made.
///
/// Weighted least squares, Σ ((model − datum)/deviation)², by the method of Levenberg and Marquardt within
/// the bounds. Derivatives are the exact ones of the discrete motion (as with `[sensitivity]`) where
/// available, differences of runs otherwise. Standard errors come from the derivatives at the minimum;
/// intervals from Student's distribution where the size of the deviations is estimated together with the
/// parameters, and from the normal distribution where it is known.
///
/// # Errors
/// [`FitError`].
pub fn fit(plan: &Fit, stop: &AtomicBool, progress: &mut dyn FnMut(usize)) -> Result<Fitted, FitError> {
    let mut models = Vec::new();
    let mut made = 0;
    for model in &plan.models {
        let before = made;
        let mut told = |runs: usize| {
            made = before + runs;
            progress(made);
        };
        let mut predictions = Predictions::new(model, (&plan.records, plan.shift.as_ref()), stop, &mut told)
            .map_err(|reason| of_model(model.name.as_deref(), reason.into()))?;
        let found = estimate(plan, model, &mut Search::new(plan, model, &mut predictions));
        models.push(found.map_err(|error| of_model(model.name.as_deref(), error))?);
    }
    let score = |model: &FittedModel| if model.aic.is_finite() { model.aic } else { f64::NEG_INFINITY };
    let best =
        (0..models.len()).min_by(|&a, &b| score(&models[a]).total_cmp(&score(&models[b]))).unwrap_or(0);
    Ok(Fitted { models, best })
}

fn of_model(name: Option<&str>, error: FitError) -> FitError {
    let Some(name) = name else { return error };
    match error {
        FitError::Start(reason) => FitError::Start(format!("model \"{name}\": {reason}")),
        FitError::Unresolved(reason) => FitError::Unresolved(format!("model \"{name}\": {reason}")),
        FitError::Untouched(reason) => FitError::Untouched(format!("model \"{name}\": {reason}")),
        FitError::Stopped => FitError::Stopped,
    }
}
