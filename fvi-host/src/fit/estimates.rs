//! Estimates, their errors, and sentences about what the data do not determine.

use super::FitError;
use super::data::{Deviations, Domain};
use super::least_squares::{End, Minimum, Refusal, Region, gradient, held};
use super::no_prediction::NoPrediction;
use super::plan::{Fit, Free, Model, Profile, Scale, numbers_at};
use super::prediction::Predicted;
use super::search::{Ended, Search};
use super::statistics::{Covariance, excess, half_width};
use fvi_fft::sums::max_or_nan;
use serde::Serialize;
use serde::ser::{SerializeMap, Serializer};
use std::f64::consts::PI;

/// One model, fitted.
#[derive(Clone, Debug, Serialize)]
pub struct FittedModel {
    /// Its name, where there are several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// True if the search ended at a minimum.
    pub converged: bool,
    /// How it ended, in words.
    pub end: &'static str,
    /// Steps of the search.
    pub iterations: usize,
    /// Number of runs, all searches together.
    pub runs: usize,
    /// The parameters: path and estimate of each.
    #[serde(serialize_with = "by_path")]
    pub parameters: Vec<(String, Estimate)>,
    /// Correlations of the estimates, in the order of the parameters; null where one has no standard error.
    pub correlation: Vec<Vec<Option<f64>>>,
    /// Σ ((model − datum)/deviation)², with deviations of 1 where none are known.
    pub chi2: f64,
    /// Data less parameters that are determined.
    pub degrees_of_freedom: usize,
    /// χ² over these.
    pub reduced_chi2: Option<f64>,
    /// True if the size of the deviations is "known" or "estimated" from the residuals.
    pub deviations: &'static str,
    /// The factor by which deviations are multiplied: 1, or √reduced χ² where it is estimated.
    pub deviation_factor: Option<f64>,
    /// Numbers of data.
    pub data: usize,
    /// Gaussian log-likelihood.
    pub log_likelihood: f64,
    /// 2k − 2 ln L, k the number of parameters, one more where the size of deviations is estimated.
    pub aic: f64,
    /// k ln n − 2 ln L.
    pub bic: f64,
    /// Singular values of the derivatives, each column scaled to length 1.
    pub singular_values: Vec<f64>,
    /// What the data do not determine, a sentence each.
    pub undetermined: Vec<String>,
    /// Further remarks on the result, a sentence each.
    pub notes: Vec<String>,
    /// Each search, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub starts: Vec<StartRecord>,
    /// The tables of data.
    pub tables: Vec<TableRecord>,
    /// Prediction of the model for each table of data: `told[table][column][row]`.
    #[serde(skip)]
    pub told: Vec<Vec<Vec<f64>>>,
}

/// A parameter.
#[derive(Clone, Debug, Serialize)]
pub struct Estimate {
    /// Where the search began.
    pub start: f64,
    /// The value with the smallest sum of squares.
    pub estimate: f64,
    /// Standard error; null where the data do not determine the parameter, and at a bound.
    pub standard_error: Option<f64>,
    /// The 95 % interval; null in the same cases as the standard error.
    pub interval: Option<[f64; 2]>,
    /// Lower and upper bound of the search; null where there is none.
    pub bounds: [Option<f64>; 2],
    /// "linear" or "log".
    pub scale: &'static str,
    /// "lower" or "upper" if the estimate lies at that bound.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_bound: Option<&'static str>,
    /// "exact": the derivative of the discrete motion, as with `[sensitivity]`; or "differences" of runs, or
    /// of closed forms of any of the tables.
    pub derivative: &'static str,
    /// Why it was taken from differences.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub derivative_note: Option<String>,
    /// Profile likelihood, where requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile: Option<Profiled>,
}

/// Profile likelihood of a parameter: the other parameters are optimised for each of its values.
#[derive(Clone, Debug, Serialize)]
pub struct Profiled {
    /// The 95 % interval; an end is null where it was not reached.
    pub interval: [Option<f64>; 2],
    /// Values of the parameter that were tried, ascending, each with the smallest χ².
    pub points: Vec<(f64, f64)>,
}

/// One of several searches from different starts.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StartRecord {
    /// Start values, in the order of the parameters.
    pub start: Vec<f64>,
    /// Values at the end of the search; null where no motion could be computed at the start.
    pub end: Option<Vec<f64>>,
    /// χ² at the end.
    pub chi2: Option<f64>,
}

/// A table of data.
#[derive(Clone, Debug, Serialize)]
pub struct TableRecord {
    /// The file.
    pub file: String,
    /// Its columns.
    pub columns: Vec<String>,
    /// Its rows.
    pub rows: usize,
    /// Rows of the file that are left out, since a number is missing in them.
    pub left_out: usize,
    /// Contribution of this table to χ².
    pub chi2: f64,
    /// The root of the mean of (model − datum)² of each column.
    pub rms: Vec<f64>,
    /// Its temperature, and log₁₀ of the factor by which it shifts frequencies, where tables are shifted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature: Option<f64>,
    /// See `temperature`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log10_shift: Option<f64>,
}

fn by_path<S: Serializer>(parameters: &[(String, Estimate)], serializer: S) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(parameters.len()))?;
    for (path, estimate) in parameters {
        map.serialize_entry(path, estimate)?;
    }
    map.end()
}

/// Relative accuracy of exact derivatives (`EXACT`) and of differences of runs (`DIFFERENCES`).
const EXACT: f64 = 1e-9;
const DIFFERENCES: f64 = 1e-7;

/// A deviation from the expected χ² by more standard deviations than this is reported; it occurs by chance
/// once in a thousand cases.
const SURPRISE: f64 = 3.09;

/// Searches whose χ² exceeds the smallest one by less than this, relatively, count as having found the same
/// minimum.
const SAME_END: f64 = 1e-6;

/// Correlations larger than this in magnitude are mentioned in the notes.
const NEARLY_TOGETHER: f64 = 0.99;

/// A parameter on a logarithmic scale is reported if its interval extends beyond this factor from the
/// estimate.
const FAR: f64 = 1000.0;

impl From<Refusal<Ended>> for FitError {
    fn from(refusal: Refusal<Ended>) -> Self {
        match refusal {
            Refusal::Point(reason) => Self::Start(reason),
            Refusal::End(Ended::Stopped) => Self::Stopped,
            Refusal::End(Ended::Untouched(reason)) => Self::Untouched(reason),
        }
    }
}

/// Estimates the parameters of a model and their uncertainty.
pub(super) fn estimate(
    plan: &Fit,
    model: &Model,
    search: &mut Search<'_, '_>,
) -> Result<FittedModel, FitError> {
    let start: Vec<f64> = model.free.iter().map(|free| free.start).collect();
    match search.predictions.at(&start, false) {
        Ok(predicted) => check_resolution(plan, search, &predicted)?,
        Err(NoPrediction::Stopped) => return Err(FitError::Stopped),
        Err(NoPrediction::Refused(reason)) if plan.starts == 1 => return Err(FitError::Start(reason)),
        Err(NoPrediction::Refused(_)) => {}
    }
    let (best, mut starts) = searches(plan, model, search)?;
    let predicted = search.predictions.at(&search.outside(&best.point), false)?;
    check_resolution(plan, search, &predicted)?;
    let values = search.outside(&best.point);
    let known = plan.deviations == Deviations::Known;
    let uncertainty = Uncertainty::of(search, &best, values, plan.data(), known);
    let (mut undetermined, mut notes) = (uncertainty.undetermined(model), Vec::new());
    let parameters: Vec<(String, Estimate)> = (model.free.iter().enumerate())
        .map(|(index, sought)| {
            let reason = search.predictions.reason(index).map(str::to_owned);
            let derivative = search.predictions.derivative(index);
            let estimate = uncertainty.estimate(index, sought, reason, (&mut undetermined, &mut notes));
            (sought.key(), Estimate { derivative, ..estimate })
        })
        .collect();
    let count = model.free.len();
    let correlation: Vec<Vec<Option<f64>>> = (0..count)
        .map(|row| (0..count).map(|column| uncertainty.correlation(row, column)).collect())
        .collect();
    notes.extend(nearly_together(model, &correlation));
    let Uncertainty { chi2, data, degrees_of_freedom, variance, .. } = uncertainty;
    notes.extend(surprises(plan, &best, known, chi2, degrees_of_freedom));
    if !known && degrees_of_freedom > 0 && chi2 <= 2.0 * uncertainty.region.rounding {
        notes.push(
            "the model says the data to rounding: nothing is left that tells the size of their deviations, and standard errors \
             and intervals are those of rounding"
                .to_owned(),
        );
    }
    notes.extend(resolution_note(search, &predicted, variance));
    notes.extend(starts_note(&starts, chi2));
    notes.extend(plan.records.iter().filter_map(super::data::Record::left_out_note));
    if plan.records.iter().any(|record| record.domain != Domain::Time) {
        let of = "derivatives of data over frequencies, of creep and of relaxation are differences of order four of closed \
             forms";
        notes.push(of.to_owned());
    }
    let log_likelihood = uncertainty.log_likelihood(search.deviations.as_slice(), known);
    let (n, k) = (data as f64, (count + usize::from(!known)) as f64);
    if plan.starts == 1 {
        starts.clear();
    }
    let mut fitted = FittedModel {
        name: model.name.clone(),
        converged: best.end == End::Converged,
        end: match best.end {
            End::Converged => "nothing is left to gain",
            End::Iterations => "as many steps as allowed were made",
            End::Stuck => "no step makes the residuals smaller, though the derivatives say that one should",
        },
        iterations: best.iterations,
        runs: 0,
        parameters,
        correlation,
        chi2,
        degrees_of_freedom,
        reduced_chi2: uncertainty.reduced_chi2,
        deviations: if known { "known" } else { "estimated" },
        deviation_factor: variance.map(f64::sqrt),
        data,
        log_likelihood,
        aic: 2.0 * k - 2.0 * log_likelihood,
        bic: k * libm::log(n) - 2.0 * log_likelihood,
        singular_values: uncertainty.covariance.singular_values.clone(),
        undetermined,
        notes,
        starts,
        tables: tables(plan, search, &best),
        told: told(plan, search, &predicted),
    };
    let wants = |key: &str| match &plan.profile {
        Profile::None => false,
        Profile::All => true,
        Profile::Some(paths) => paths.iter().any(|path| path == key),
    };
    for (index, is_at_bound) in uncertainty.at_bounds.iter().enumerate() {
        if wants(&fitted.parameters[index].0) && !is_at_bound {
            let width = uncertainty.width;
            let threshold = variance.map_or(f64::INFINITY, |variance| variance * width * width);
            let reach = uncertainty.error(index).filter(|error| *error > 0.0);
            let reach = reach.unwrap_or(uncertainty.region.typical[index]);
            fitted.parameters[index].1.profile = Some(profile(search, &best, index, threshold, reach)?);
        }
    }
    fitted.runs = search.predictions.runs();
    Ok(fitted)
}

/// What the data leave open about the parameters at the best point.
struct Uncertainty {
    /// Parameters in the coordinates of the search, and their values.
    point: Vec<f64>,
    values: Vec<f64>,
    region: Region,
    /// True for a parameter at its bound, and the others, which are the columns of the covariance.
    at_bounds: Vec<bool>,
    free: Vec<usize>,
    covariance: Covariance,
    /// The sum of squares over deviations, the number of data, and what is left of it.
    chi2: f64,
    data: usize,
    determined: usize,
    degrees_of_freedom: usize,
    reduced_chi2: Option<f64>,
    /// Variance of a residual, 1 where deviations are known; `None` where nothing tells it.
    variance: Option<f64>,
    /// Half width of an interval in standard errors.
    width: f64,
}

impl Uncertainty {
    fn of(search: &Search<'_, '_>, best: &Minimum, values: Vec<f64>, data: usize, known: bool) -> Self {
        let region = search.region(&values);
        let at_bounds = held(&best.point, &region, &gradient(&best.evaluation));
        let free: Vec<usize> = (0..values.len()).filter(|&index| !at_bounds[index]).collect();
        let chi2 = 2.0 * best.evaluation.cost();
        let typical: Vec<f64> = free.iter().map(|&index| region.typical[index]).collect();
        let jacobian = best.evaluation.jacobian.as_ref().map(|jacobian| jacobian.select_columns(&free));
        let jacobian = jacobian.unwrap_or_else(|| nalgebra::DMatrix::zeros(data, free.len()));
        let accuracy = if search.predictions.are_all_exact() { EXACT } else { DIFFERENCES };
        let covariance = Covariance::of(&jacobian, accuracy, &typical);
        let determined = free.len().saturating_sub(covariance.undetermined.len()).min(data);
        let degrees_of_freedom = data.saturating_sub(determined);
        let reduced_chi2 = (degrees_of_freedom > 0).then(|| chi2 / degrees_of_freedom as f64);
        Self {
            point: best.point.clone(),
            values,
            region,
            at_bounds,
            free,
            covariance,
            chi2,
            data,
            determined,
            degrees_of_freedom,
            reduced_chi2,
            variance: if known { Some(1.0) } else { reduced_chi2 },
            width: half_width((!known).then_some(degrees_of_freedom)),
        }
    }

    fn column(&self, index: usize) -> Option<usize> {
        self.free.iter().position(|&own| own == index)
    }

    /// Standard error of a column of the covariance, where the data determine it.
    fn error_of(&self, column: usize) -> Option<f64> {
        let variance = self.variance.filter(|_| !self.covariance.is_undetermined(column))?;
        Some((self.covariance.matrix[(column, column)].max(0.0) * variance).sqrt())
    }

    /// Standard error of a parameter in the coordinates of the search.
    fn error(&self, index: usize) -> Option<f64> {
        self.column(index).and_then(|column| self.error_of(column)).filter(|error| error.is_finite())
    }

    /// Sentences about what the data do not determine.
    fn undetermined(&self, model: &Model) -> Vec<String> {
        let Covariance { undetermined, open, .. } = &self.covariance;
        // The last one stands for all directions that so few data leave open.
        let directions = undetermined.iter().take(undetermined.len() - usize::from(*open > 0));
        let mut said: Vec<String> =
            directions.map(|direction| in_words(direction, &self.free, &model.free)).collect();
        if *open > 0 {
            let names: Vec<String> = self.free.iter().map(|&index| model.free[index].key()).collect();
            let (data, free, names) = (self.data, self.free.len(), names.join(", "));
            let one = if *open == 1 { "combination" } else { "combinations" };
            said.push(format!(
                "there are fewer data than free numbers, {data} for {free}: they leave {open} {one} of {names} open"
            ));
        } else if self.variance.is_none() {
            said.push(format!(
                "there are {} data for {} parameters: nothing is left from which the size of their deviations, and so any \
                 standard error, could be told",
                self.data, self.determined
            ));
        }
        said
    }

    /// The estimate of a parameter; `reason` is why its derivative is one of differences. What the data do
    /// not determine and what is noted about it is added to the two lists.
    fn estimate(
        &self,
        index: usize,
        sought: &Free,
        reason: Option<String>,
        (undetermined, notes): (&mut Vec<String>, &mut Vec<String>),
    ) -> Estimate {
        let error = self.error(index);
        let (x, value) = (self.point[index], self.values[index]);
        let mut interval = None;
        if let Some(error) = error {
            let half = self.width * error;
            match too_wide(sought, value, half) {
                Some(sentence) => undetermined.push(sentence),
                None => interval = Some([x - half, x + half].map(|end| sought.scale.outside(end))),
            }
        }
        let bound = || if x <= self.region.lower[index] { "lower" } else { "upper" };
        let at_bound = self.at_bounds[index].then(bound);
        if let Some(bound) = at_bound {
            notes.push(format!(
                "{} is at its {bound} bound {value}: the data would have it beyond, so it has no interval, and those of the \
                 others are with it there",
                sought.key()
            ));
        }
        let bounds = [sought.bounds.0, sought.bounds.1];
        let stretch = if sought.scale == Scale::Logarithmic { value } else { 1.0 };
        Estimate {
            start: sought.start,
            estimate: value,
            standard_error: error.map(|error| error * stretch),
            interval,
            bounds: bounds.map(|bound| bound.is_finite().then_some(bound)),
            scale: if sought.scale == Scale::Logarithmic { "log" } else { "linear" },
            at_bound,
            derivative: if reason.is_none() { "exact" } else { "differences" },
            derivative_note: reason,
            profile: None,
        }
    }

    /// Correlation of two parameters, where both have standard errors.
    fn correlation(&self, row: usize, column: usize) -> Option<f64> {
        let (a, b) = (self.column(row)?, self.column(column)?);
        let (one, other) = (self.error_of(a)?, self.error_of(b)?);
        let both = self.covariance.matrix[(a, b)] * self.variance?;
        let found = if row == column { 1.0 } else { (both / (one * other)).clamp(-1.0, 1.0) };
        found.is_finite().then_some(found)
    }

    /// Gaussian log-likelihood of data with these deviations; if they are not known, of their best common
    /// multiple.
    fn log_likelihood(&self, deviations: &[f64], known: bool) -> f64 {
        let logarithms: f64 = deviations.iter().map(|deviation| libm::log(*deviation)).sum();
        let (n, chi2) = (self.data as f64, self.chi2);
        match known {
            true => -0.5 * (chi2 + n * libm::log(2.0 * PI)) - logarithms,
            false => -0.5 * n * (libm::log(2.0 * PI * chi2 / n) + 1.0) - logarithms,
        }
    }
}

/// Notes of pairs of parameters that the data hardly tell apart.
fn nearly_together(model: &Model, correlation: &[Vec<Option<f64>>]) -> Vec<String> {
    let mut notes = Vec::new();
    for (row, found) in correlation.iter().enumerate() {
        let nearly = |found: &Option<f64>| found.filter(|found| found.abs() > NEARLY_TOGETHER);
        for (column, found) in found.iter().enumerate().skip(row + 1) {
            let Some(found) = nearly(found) else { continue };
            notes.push(format!(
                "{} and {} are nearly one number to the data: correlation {found:.5}",
                model.free[row].key(),
                model.free[column].key()
            ));
        }
    }
    notes
}

/// Searches from all starts, of which the first is the given one; returns the best minimum and a record of
/// each search.
fn searches(
    plan: &Fit,
    model: &Model,
    search: &mut Search<'_, '_>,
) -> Result<(Minimum, Vec<StartRecord>), FitError> {
    let first: Vec<f64> = model.free.iter().map(|free| free.start).collect();
    let mut starts = vec![search.inside(&first)];
    let region = search.region(&first);
    let mut random = fastrand::Rng::with_seed(plan.seed);
    // Latin hypercube: in each coordinate every start lies in a stratum of its own.
    let strata: Vec<Vec<usize>> = model
        .free
        .iter()
        .map(|_| {
            let mut order: Vec<usize> = (0..plan.starts - 1).collect();
            random.shuffle(&mut order);
            order
        })
        .collect();
    for index in 0..plan.starts - 1 {
        let coordinate = |(parameter, order): (usize, &Vec<usize>)| {
            let share = (order[index] as f64 + random.f64()) / (plan.starts - 1) as f64;
            region.lower[parameter] + share * (region.upper[parameter] - region.lower[parameter])
        };
        starts.push(strata.iter().enumerate().map(coordinate).collect());
    }
    let mut best: Option<Minimum> = None;
    let mut records = Vec::new();
    let mut refusal = String::new();
    for start in starts {
        let outside = search.outside(&start);
        match search.from(&start, None) {
            Ok(found) => {
                records.push(StartRecord {
                    start: outside,
                    end: Some(search.outside(&found.point)),
                    chi2: Some(2.0 * found.evaluation.cost()),
                });
                let is_better =
                    best.as_ref().is_none_or(|best| found.evaluation.cost() < best.evaluation.cost());
                if is_better {
                    best = Some(found);
                }
            }
            Err(Refusal::Point(reason)) => {
                if refusal.is_empty() {
                    refusal = reason;
                }
                records.push(StartRecord { start: outside, end: None, chi2: None });
            }
            Err(end) => return Err(end.into()),
        }
    }
    best.map(|best| (best, records)).ok_or(FitError::Start(refusal))
}

/// A sentence about a direction in parameter space along which the predictions do not change.
fn in_words(direction: &[f64], free: &[usize], sought: &[Free]) -> String {
    let parts: Vec<(String, f64)> = direction
        .iter()
        .zip(free)
        .filter(|(share, _)| share.abs() > 1e-3)
        .map(|(&share, &index)| (sought[index].key(), share))
        .collect();
    if let [(path, _)] = parts.as_slice() {
        return format!("the data do not determine {path}: no datum changes with it at the value found");
    }
    let names: Vec<&str> = parts.iter().map(|(path, _)| path.as_str()).collect();
    let shares: Vec<String> = parts.iter().map(|(_, share)| format!("{share:+.3}")).collect();
    format!(
        "the data do not determine {} each by itself: no datum changes where their relative changes are as {}",
        names.join(", "),
        shares.join(" : ")
    )
}

/// A sentence about an interval that is too wide to be informative.
fn too_wide(sought: &Free, value: f64, half: f64) -> Option<String> {
    let key = sought.key();
    let width = sought.scale.inside(sought.bounds.1) - sought.scale.inside(sought.bounds.0);
    if half >= width {
        return Some(format!(
            "the data do not determine {key} within its bounds: the 95 % interval is wider than they are"
        ));
    }
    match sought.scale {
        Scale::Logarithmic if half >= libm::log(FAR) => {
            Some(format!("the data do not determine {key}, not even to a factor of {FAR}"))
        }
        Scale::Linear if half >= 100.0 * value.abs().max(sought.start.abs()).max(f64::MIN_POSITIVE) => {
            Some(format!(
                "the data do not determine {key}: the 95 % interval is more than a hundred times as wide as its value"
            ))
        }
        _ => None,
    }
}

/// Sentences about residuals that are unexpectedly large or small, and about a search that did not converge.
fn surprises(plan: &Fit, best: &Minimum, known: bool, chi2: f64, degrees_of_freedom: usize) -> Vec<String> {
    let mut notes = Vec::new();
    if best.end != End::Converged {
        let most = plan.most_iterations;
        notes.push(match best.end {
            End::Iterations => format!("the search has not converged in {most} steps: estimates and errors are those of its last point"),
            _ => "the search has stopped where no step makes the residuals smaller, though the derivatives say that one \
                  should: estimates and errors are no result. The motion may jump there, as Caputo's derivative of a motion \
                  with an initial velocity does at order 1: `bounds` to one side, or several `starts`, go around it"
                .to_owned(),
        });
    }
    if known && degrees_of_freedom > 0 {
        let (sigmas, reduced) = (excess(chi2, degrees_of_freedom), chi2 / degrees_of_freedom as f64);
        if sigmas > SURPRISE {
            notes.push(format!(
                "the model does not describe the data to their deviations (reduced χ² = {reduced:.3}): it is wrong, or the \
                 deviations are larger; the errors, which take it and them for right, are too small"
            ));
        } else if sigmas < -SURPRISE {
            notes.push(format!(
                "the data lie closer to the model than their deviations allow (reduced χ² = {reduced:.3}): these are smaller, and \
                 the errors too large"
            ));
        }
    }
    notes
}

fn starts_note(starts: &[StartRecord], chi2: f64) -> Option<String> {
    if starts.len() < 2 {
        return None;
    }
    let same = |start: &&StartRecord| {
        start.chi2.is_some_and(|own| own <= chi2 * (1.0 + SAME_END) + f64::MIN_POSITIVE)
    };
    let there = starts.iter().filter(same).count();
    let none = starts.iter().filter(|start| start.chi2.is_none()).count();
    let without = if none > 0 { format!("; at {none} there was no motion") } else { String::new() };
    Some(format!("{there} of {} searches ended at the smallest χ²{without}", starts.len()))
}

/// Describes the row (table and line) that the entry `place` of the vector of all data belongs to.
fn row_of(plan: &Fit, mut place: usize) -> String {
    for record in &plan.records {
        if place < record.len() {
            let (row, column) = (place / record.columns.len(), place % record.columns.len());
            return format!(
                "{}: row {}, {} = {}, column {}",
                record.name,
                row + 1,
                record.over(),
                record.places[row],
                record.columns[column].name
            );
        }
        place -= record.len();
    }
    String::new()
}

/// Returns an error if the grid is too coarse for interpolation between grid points.
fn check_resolution(plan: &Fit, search: &Search<'_, '_>, predicted: &Predicted) -> Result<(), FitError> {
    let mut largest = vec![0.0f64; predicted.values.len()];
    for (index, record) in plan.records.iter().enumerate() {
        let place = search.predictions.place(index);
        for (number, column) in record.columns.iter().enumerate() {
            let size = column.values.iter().map(|value| value.abs()).fold(0.0, max_or_nan);
            place.clone().skip(number).step_by(record.columns.len()).for_each(|place| largest[place] = size);
        }
    }
    let known = plan.deviations == Deviations::Known;
    let limit = |place: usize| if known { search.deviations[place] } else { 1e-2 * largest[place] };
    let share = |place: usize| predicted.unresolved[place].abs() / limit(place);
    let worst = (0..largest.len()).filter(|&place| predicted.unresolved[place] != 0.0);
    let worst = worst.max_by(|&a, &b| share(a).total_cmp(&share(b)));
    match worst.filter(|&place| share(place) > 1.0) {
        Some(place) => Err(FitError::Unresolved(format!(
            "{}: the steps of the scenario do not resolve the motion there: polynomials through 6 and through 4 grid times differ \
             by {:.2e}, more than {:.2e}, {}; take a shorter `time.step`, or one of which the times of the data are multiples",
            row_of(plan, place),
            predicted.unresolved[place].abs(),
            limit(place),
            if known {
                "the deviation of the datum"
            } else {
                "a hundredth of the largest datum of the column"
            }
        ))),
        None => Ok(()),
    }
}

/// A note about the accuracy of interpolated values, where it matters.
fn resolution_note(search: &Search<'_, '_>, predicted: &Predicted, variance: Option<f64>) -> Option<String> {
    let factor = variance?.sqrt();
    let pairs = predicted.unresolved.iter().zip(&search.deviations);
    let worst =
        pairs.map(|(difference, deviation)| difference.abs() / (factor * deviation)).fold(0.0, max_or_nan);
    (worst > 0.1).then(|| {
        format!(
            "values between grid times, or accelerations, are told to about {worst:.1e} deviations: a shorter `time.step` would \
             tell them better"
        )
    })
}

fn tables(plan: &Fit, search: &Search<'_, '_>, best: &Minimum) -> Vec<TableRecord> {
    let values = &search.outside(&best.point);
    let residuals = &best.evaluation.residuals;
    let of = |(index, record): (usize, &super::data::Record)| {
        let place = search.predictions.place(index);
        let columns = record.columns.len();
        let rms = |column: usize| {
            let places = place.clone().skip(column).step_by(columns);
            let squares: f64 =
                places.map(|place| (residuals[place] * search.deviations[place]).powi(2)).sum();
            (squares / record.places.len() as f64).sqrt()
        };
        TableRecord {
            file: record.name.clone(),
            columns: record.columns.iter().map(|column| column.name.clone()).collect(),
            rows: record.places.len(),
            left_out: record.left_out.len(),
            chi2: place.clone().map(|place| residuals[place].powi(2)).sum(),
            rms: (0..columns).map(rms).collect(),
            temperature: plan.shift.as_ref().map(|shift| shift.temperature(index)),
            log10_shift: plan
                .shift
                .as_ref()
                .and_then(|shift| shift.log10(index, &numbers_at(search.free, values))),
        }
    };
    plan.records.iter().enumerate().map(of).collect()
}

fn told(plan: &Fit, search: &Search<'_, '_>, predicted: &Predicted) -> Vec<Vec<Vec<f64>>> {
    let of = |(index, record): (usize, &super::data::Record)| {
        let columns = record.columns.len();
        let place = search.predictions.place(index);
        let column =
            |number: usize| place.clone().skip(number).step_by(columns).map(|place| predicted.values[place]);
        (0..columns).map(|number| column(number).collect()).collect()
    };
    plan.records.iter().enumerate().map(of).collect()
}

/// Largest number of values of a parameter tried on either side of its estimate.
const MOST_LOOKS: usize = 16;

/// Where χ² exceeds its smallest value by `threshold`, the other parameters at their best; `reach` is the
/// standard error, or an estimate of it.
fn profile(
    search: &mut Search<'_, '_>,
    best: &Minimum,
    index: usize,
    threshold: f64,
    reach: f64,
) -> Result<Profiled, FitError> {
    let lowest = 2.0 * best.evaluation.cost();
    let region = search.region(&search.outside(&best.point));
    let (wanted, center) = (threshold.sqrt(), best.point[index]);
    let mut points = vec![(search.outside(&best.point)[index], lowest)];
    let mut interval = [None, None];
    for (side, sign) in [-1.0, 1.0].into_iter().enumerate() {
        if !wanted.is_finite() {
            break;
        }
        let bound = if sign < 0.0 { region.lower[index] } else { region.upper[index] };
        let room = (bound - center).abs();
        // z = √(χ² − smallest), nearly linear in the distance.
        let (mut near, mut far): ((f64, f64), Option<(f64, f64)>) = ((0.0, 0.0), None);
        let mut distance = (reach * half_width(None)).min(room);
        let mut from = best.point.clone();
        for _ in 0..MOST_LOOKS {
            if distance <= 0.0 {
                break;
            }
            let mut start = from.clone();
            start[index] = center + sign * distance;
            let z = match search.from(&start, Some(index)) {
                Ok(found) => {
                    let chi2 = 2.0 * found.evaluation.cost();
                    let value = search.outside(&found.point)[index];
                    points.push((value, chi2));
                    if far.is_none() {
                        from = found.point;
                    }
                    (chi2 - lowest).max(0.0).sqrt()
                }
                Err(Refusal::Point(_)) => f64::INFINITY,
                Err(end) => return Err(end.into()),
            };
            if (z - wanted).abs() <= 1e-3 * wanted {
                interval[side] = Some(search.free[index].scale.outside(center + sign * distance));
                break;
            }
            if z < wanted {
                if distance >= room {
                    break;
                }
                near = (distance, z);
            } else {
                far = Some((distance, z));
            }
            distance = match far {
                Some((beyond, at)) if at.is_finite() => {
                    let share = ((wanted - near.1) / (at - near.1)).clamp(0.05, 0.95);
                    near.0 + share * (beyond - near.0)
                }
                Some((beyond, _)) => 0.5 * (near.0 + beyond),
                None if near.1 > 0.0 => (near.0 * (1.02 * wanted / near.1).clamp(1.2, 4.0)).min(room),
                None => (4.0 * distance).min(room),
            };
        }
    }
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(Profiled { interval, points })
}
