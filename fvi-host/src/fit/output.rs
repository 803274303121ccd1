//! The files of a fit, and its result as text.

use super::data::Record;
use super::plan::{Fit, Free, Model, put_number};
use super::{Estimate, Fitted, FittedModel};
use crate::results::csv_row::append_row;
use crate::results::files::{FileError, remove, write_json, write_text};
use crate::results::output_directory::OutputDirectory;
use fvi_scenario::language::put;
use serde::Serialize;
use std::fmt::Write as _;

/// The record of a fit, `fit.json`: the best model, and beside it all of them.
#[derive(Serialize)]
struct Summary<'a> {
    version: &'static str,
    platform: String,
    title: &'a str,
    scenario: &'a str,
    #[serde(flatten)]
    best: &'a FittedModel,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    models: Vec<&'a FittedModel>,
    files: &'a [String],
}

/// The name of the file with the record.
const SUMMARY: &str = "fit.json";

/// The name of the table of models.
const MODELS: &str = "models.csv";

impl Fit {
    /// The scenario of a model with its estimates; for a table of data, also with the values that this table
    /// sets. With `moved`, for a scenario written to another directory, the files that it names have absolute
    /// paths.
    pub fn scenario_of(
        &self,
        fitted: &FittedModel,
        record: Option<usize>,
        moved: bool,
    ) -> Option<toml::Table> {
        let model = self.model_of(fitted)?;
        let mut values = model.values.clone();
        if let Some(record) = record {
            for (path, value) in &self.records[record].set {
                put(&mut values, path, value.clone()).ok()?;
            }
        }
        for (free, (_, estimate)) in model.free.iter().zip(&fitted.parameters) {
            if free.record.is_none() || free.record == record {
                put_number(&mut values, &free.path, estimate.estimate).ok()?;
            }
        }
        if moved {
            for (key, value) in &mut values {
                if key != "title" {
                    name_files_whole(model, value);
                }
            }
        }
        Some(values)
    }

    fn model_of(&self, fitted: &FittedModel) -> Option<&Model> {
        self.models.iter().find(|model| model.name == fitted.name)
    }

    /// Indices of the tables of data that set keys or have parameters of their own.
    pub fn tables_of_their_own(&self, fitted: &FittedModel) -> Vec<usize> {
        let free: &[Free] = self.model_of(fitted).map_or(&[], |model| &model.free);
        let own = |index: usize| {
            !self.records[index].set.is_empty() || free.iter().any(|free| free.record == Some(index))
        };
        (0..self.records.len()).filter(|&index| own(index)).collect()
    }

    /// Number of tables of data.
    pub fn tables(&self) -> usize {
        self.records.len()
    }

    /// t or ω of each row of a table.
    pub fn places(&self, table: usize) -> &[f64] {
        &self.records[table].places
    }

    /// Data and standard deviations of each column of a table.
    pub fn columns(&self, table: usize) -> Vec<(&[f64], &[f64])> {
        let columns = self.records[table].columns.iter();
        columns.map(|column| (&column.values[..], &column.deviations[..])).collect()
    }

    /// Independent variable of a table: "t" or "omega".
    pub fn over(&self, index: usize) -> &'static str {
        self.records[index].over()
    }
}

/// Replaces the names of existing files by absolute paths.
fn name_files_whole(model: &Model, value: &mut toml::Value) {
    match value {
        toml::Value::String(text) => {
            let path = model.base.document().resolve(text);
            if path.is_file()
                && let Ok(whole) = path.canonicalize()
                && let Some(whole) = whole.to_str()
            {
                *text = whole.to_owned();
            }
        }
        toml::Value::Array(list) => list.iter_mut().for_each(|value| name_files_whole(model, value)),
        toml::Value::Table(table) => table.iter_mut().for_each(|(_, value)| name_files_whole(model, value)),
        _ => {}
    }
}

impl Fitted {
    /// AIC above the smallest, model by model.
    pub fn aic_differences(&self) -> Vec<f64> {
        let smallest = self.best().aic;
        // The AIC of a perfect fit is −∞.
        let above = |aic: f64| if aic == smallest { 0.0 } else { aic - smallest };
        self.models.iter().map(|model| above(model.aic)).collect()
    }

    /// Akaike's weights e^{−Δ/2}/Σ e^{−Δ/2} of the models, which sum to 1: how much the data speak for each.
    pub fn aic_weights(&self) -> Vec<f64> {
        let shares: Vec<f64> =
            self.aic_differences().into_iter().map(|above| libm::exp(-0.5 * above)).collect();
        let sum: f64 = shares.iter().sum();
        shares.into_iter().map(|share| share / sum).collect()
    }

    /// The models as a table; `None` if there is one only.
    fn comparison(&self) -> Option<String> {
        if self.models.len() < 2 {
            return None;
        }
        let mut text = "model,parameters,chi2,aic,aic_difference,aic_weight,bic\n".to_owned();
        let (differences, weights) = (self.aic_differences(), self.aic_weights());
        for (model, (difference, weight)) in self.models.iter().zip(differences.iter().zip(weights)) {
            let name = model.name.as_deref().unwrap_or_default().replace('"', "\"\"");
            let (count, chi2) = (model.parameters.len(), model.chi2);
            let (aic, bic) = (model.aic, model.bic);
            // Writing to a string cannot fail.
            let _ = write!(text, "\"{name}\",{count},");
            append_row(&mut text, &[chi2, aic, *difference, weight, bic]);
        }
        Some(text)
    }

    /// Writes the files of a fit, the record last.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn write(&self, plan: &Fit, directory: &OutputDirectory) -> Result<(), FileError> {
        remove(&directory.join(SUMMARY))?;
        let best = self.best();
        let mut texts: Vec<(String, String)> = Vec::new();
        let own = plan.tables_of_their_own(best);
        for record in std::iter::once(None).chain((0..plan.tables()).map(Some)) {
            let name = match record {
                None => "fitted.toml".to_owned(),
                Some(record) => format!("fitted_{record}.toml"),
            };
            if record.is_some_and(|record| !own.contains(&record)) {
                remove(&directory.join(&name))?;
                continue;
            }
            if let Some(values) = plan.scenario_of(best, record, true) {
                let from = plan.document.name().replace(char::is_control, " ");
                texts.push((name, format!("# The scenario of {from} with what fvi fit found.\n{values}")));
            }
        }
        for (index, record) in plan.records.iter().enumerate() {
            texts.push((format!("residuals_{index}.csv"), residuals(record, &best.told[index])));
        }
        for (index, (_, estimate)) in best.parameters.iter().enumerate() {
            let name = format!("profile_{index}.csv");
            match &estimate.profile {
                Some(profile) => {
                    let mut text = "value,chi2\n".to_owned();
                    profile.points.iter().for_each(|(value, chi2)| append_row(&mut text, [value, chi2]));
                    texts.push((name, text));
                }
                None => remove(&directory.join(name))?,
            }
        }
        match self.comparison() {
            Some(table) => texts.push((MODELS.to_owned(), table)),
            None => remove(&directory.join(MODELS))?,
        }
        for (name, text) in &texts {
            write_text(&directory.join(name), text)?;
        }
        let mut files: Vec<String> = texts.into_iter().map(|(name, _)| name).collect();
        #[cfg(feature = "pictures")]
        let pictures = {
            let own = super::pictures::charts(plan, best).into_iter();
            own.chain(super::pictures::comparison(plan, self))
                .chain(super::pictures::master_curve(plan, best))
        };
        #[cfg(feature = "pictures")]
        for (name, chart) in pictures {
            crate::results::files::write_picture(&directory.join(&name), &chart)?;
            files.push(name);
        }
        files.sort();
        let several = plan.models.len() > 1;
        let summary = Summary {
            version: env!("CARGO_PKG_VERSION"),
            platform: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            title: plan.heading(),
            scenario: plan.models[0].base.document().name(),
            best,
            models: if several { self.models.iter().collect() } else { Vec::new() },
            files: &files,
        };
        write_json(&directory.join(SUMMARY), &summary)
    }

    /// The result as text for a terminal.
    pub fn report(&self, plan: &Fit) -> String {
        let mut text = format!("{}: {} numbers of data\n", plan.heading(), plan.data());
        if self.models.len() > 1 {
            let name = |model: &FittedModel| model.name.clone().unwrap_or_default();
            let width = self.models.iter().map(|model| name(model).chars().count()).max().unwrap_or(0).max(5);
            let (differences, weights) = (self.aic_differences(), self.aic_weights());
            let _ = writeln!(
                text,
                "\n{:width$}  parameters           χ²          AIC     AIC − min    weight          BIC",
                "model"
            );
            for (model, (difference, weight)) in self.models.iter().zip(differences.iter().zip(weights)) {
                let _ = writeln!(
                    text,
                    "{:width$}  {:10} {:12.6e} {:12.2} {:13.2} {:9.3} {:12.2}",
                    name(model),
                    model.parameters.len(),
                    model.chi2,
                    model.aic,
                    difference,
                    weight,
                    model.bic
                );
            }
            let _ = writeln!(text, "\nsmallest AIC: {}", name(self.best()));
        }
        text.push_str(&self.best().report());
        text
    }
}

impl FittedModel {
    /// The result of one model as text.
    fn report(&self) -> String {
        let mut text = String::new();
        let width = self.parameters.iter().map(|(path, _)| path.chars().count()).max().unwrap_or(0).max(9);
        let _ = writeln!(
            text,
            "\n{:width$}  {:>15}  {:>14}  95 % interval",
            "parameter", "estimate", "standard error"
        );
        for (path, estimate) in &self.parameters {
            let Estimate { estimate, standard_error, interval, at_bound, .. } = estimate;
            let error = standard_error.map_or_else(|| "-".to_owned(), |error| format!("{error:.3e}"));
            let interval = match (interval, at_bound) {
                (Some([low, high]), _) => format!("{low:.8e} to {high:.8e}"),
                (None, Some(bound)) => format!("at its {bound} bound"),
                (None, None) => "not determined".to_owned(),
            };
            let _ = writeln!(text, "{path:width$}  {estimate:15.8e}  {error:>14}  {interval}");
        }
        let reduced = self.reduced_chi2.map_or_else(|| "-".to_owned(), |reduced| format!("{reduced:.6}"));
        let _ = writeln!(
            text,
            "\nχ² = {:.6e} ({} degrees of freedom, reduced {reduced}), AIC = {:.3}, BIC = {:.3}; deviations {}",
            self.chi2, self.degrees_of_freedom, self.aic, self.bic, self.deviations
        );
        let _ = writeln!(text, "{} steps, {} runs: {}", self.iterations, self.runs, self.end);
        for sentence in &self.undetermined {
            let _ = writeln!(text, "not determined: {sentence}");
        }
        for note in &self.notes {
            let _ = writeln!(text, "note: {note}");
        }
        for (path, estimate) in &self.parameters {
            if let Some(profile) = &estimate.profile {
                let end =
                    |end: Option<f64>| end.map_or_else(|| "open".to_owned(), |end| format!("{end:.8e}"));
                let [low, high] = profile.interval.map(end);
                let _ = writeln!(text, "profile of {path}: {low} to {high}");
            }
            if estimate.derivative_note.is_some() {
                let _ = writeln!(text, "note: {path} is differentiated by differences of runs");
            }
        }
        text
    }
}

/// Data, model and residual of each column, row by row.
fn residuals(record: &Record, told: &[Vec<f64>]) -> String {
    let mut text = record.over().to_owned();
    for column in &record.columns {
        let name = &column.name;
        let _ = write!(text, ",{name},{name}_model,{name}_residual,{name}_deviation");
    }
    text.push('\n');
    for (row, place) in record.places.iter().enumerate() {
        let mut numbers = vec![*place];
        for (column, told) in record.columns.iter().zip(told) {
            let (datum, model, deviation) = (column.values[row], told[row], column.deviations[row]);
            numbers.extend([datum, model, datum - model, deviation]);
        }
        append_row(&mut text, &numbers);
    }
    text
}
