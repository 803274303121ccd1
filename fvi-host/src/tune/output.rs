//! The files of a tuning.

use super::margins::Margins;
use super::problem::{Specification, Structure, TuningProblem};
use super::{Allowed, Bound, Plant, Tuning};
use crate::results::csv_row::append_row;
use crate::results::files::{FileError, remove, write_json, write_text};
use crate::results::output_directory::OutputDirectory;
use fvi_core::{DerivativeFilter, PidGains};
use serde::Serialize;
use std::fmt::Write as _;

/// `tune.json`.
#[derive(Serialize)]
pub struct TuneRecord<'a> {
    version: &'static str,
    platform: String,
    form: &'static str,
    kp: f64,
    /// K_i; K_p/T_i of the series form.
    ki: f64,
    lambda: f64,
    /// K_d; K_p T_d of the series form.
    kd: f64,
    mu: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    integral_time: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    derivative_time: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    filter_ratio: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    derivative_filter: Option<FilterRecord>,
    sample: f64,
    margins: &'a Margins,
    sampled_margins: &'a Margins,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    bounds: Vec<BoundRecord<'a>>,
    /// Bounds that are not of the specification.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    sought: Vec<SoughtRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ultimate: Option<Ultimate>,
    #[serde(skip_serializing_if = "Option::is_none")]
    relay: Option<super::RelayResult>,
    warnings: &'a [String],
    files: Vec<String>,
    plant: &'a Plant,
    controller: &'a Structure,
    specification: &'a Specification,
}

#[derive(Serialize)]
struct FilterRecord {
    time: f64,
    order: f64,
}

#[derive(Serialize)]
struct BoundRecord<'a> {
    what: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    at_most: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    at_least: Option<f64>,
    found: f64,
}

impl<'a> BoundRecord<'a> {
    fn new(bound: &'a Bound) -> Self {
        let (at_most, at_least) = match bound.allowed {
            Allowed::AtMost(allowed) => (Some(allowed), None),
            Allowed::AtLeast(allowed) => (None, Some(allowed)),
        };
        Self { what: &bound.what, at_most, at_least, found: bound.found }
    }
}

/// A bound that was sought because the specification has none.
#[derive(Serialize)]
struct SoughtRecord {
    what: &'static str,
    at_most: f64,
}

/// Ultimate point under a proportional controller.
#[derive(Serialize)]
struct Ultimate {
    gain: f64,
    frequency: f64,
}

impl Tuning {
    /// The content of `tune.json`.
    pub fn record<'a>(&'a self, problem: &'a TuningProblem) -> TuneRecord<'a> {
        let [kp, ki, kd] = self.law.three();
        let (form, series) = match self.law.gains {
            PidGains::Parallel { .. } => ("parallel", None),
            PidGains::Series { integral_rate, derivative_time, filter_ratio, .. } => {
                ("series", Some((integral_rate.recip(), derivative_time, filter_ratio)))
            }
        };
        TuneRecord {
            version: env!("CARGO_PKG_VERSION"),
            platform: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            form,
            kp,
            ki,
            lambda: self.law.lambda,
            kd,
            mu: self.law.mu,
            integral_time: series.map(|series| series.0),
            derivative_time: series.map(|series| series.1),
            filter_ratio: series.map(|series| series.2),
            derivative_filter: self.filter().map(|(time, order)| FilterRecord { time, order }),
            sample: problem.controller.sample,
            margins: &self.margins,
            sampled_margins: &self.sampled_margins,
            bounds: self.bounds.iter().map(BoundRecord::new).collect(),
            sought: ["Ms", "Mt"]
                .into_iter()
                .zip(self.sought)
                .filter_map(|(what, bound)| Some(SoughtRecord { what, at_most: bound? }))
                .collect(),
            ultimate: self.ultimate.map(|(gain, frequency)| Ultimate { gain, frequency }),
            relay: self.relay,
            warnings: &self.warnings,
            files: Vec::new(),
            plant: &problem.plant,
            controller: &problem.controller,
            specification: &problem.specification,
        }
    }

    fn filter(&self) -> Option<(f64, f64)> {
        match self.law.filter {
            DerivativeFilter::None => None,
            DerivativeFilter::FirstOrder { time } => Some((time, 1.0)),
            DerivativeFilter::Fractional { time, order } => Some((time, order)),
        }
    }

    /// The table `[controller]` for a scenario; for a plant from a scenario it can be pasted into that.
    pub fn controller_table(&self, problem: &TuningProblem) -> String {
        let mut text = String::new();
        let (measures, drives) = match problem.plant.scenario() {
            Some(plant) => {
                let drives: Vec<String> = plant.load().iter().map(|number| format!("{number:?}")).collect();
                (plant.controller.measures.text().to_owned(), drives.join(", "))
            }
            None => {
                text += "# What the plant is measured by and driven with, and its dead time, are those of the scenario.\n";
                ("q0".to_owned(), "1.0".to_owned())
            }
        };
        let mut line = |key: &str, value: String| {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{key} = {value}");
        };
        line("[controller]\nkind", "\"fractional-pid\"".to_owned());
        line("measures", toml::Value::from(measures).to_string());
        line("setpoint", "\"1\"".to_owned());
        line("drives", format!("[{drives}]"));
        text += &self.law_keys(problem);
        if problem.plant.scenario().is_some() && problem.plant.dead_time() > 0.0 {
            let _ = writeln!(text, "delay = {:?}", problem.plant.dead_time());
        }
        text
    }

    /// The keys of the law in `[controller]`, with its sampling time.
    fn law_keys(&self, problem: &TuningProblem) -> String {
        let mut text = String::new();
        let law = &self.law;
        let mut line = |key: &str, value: String| {
            let _ = writeln!(text, "{key} = {value}");
        };
        let terms = problem.controller.terms;
        match law.gains {
            PidGains::Parallel { proportional, integral, derivative } => {
                line("kp", format!("{proportional:?}"));
                if terms.integrates() {
                    line("ki", format!("{integral:?}"));
                    line("lambda", format!("{:?}", law.lambda));
                }
                if terms.differentiates() {
                    line("kd", format!("{derivative:?}"));
                    line("mu", format!("{:?}", law.mu));
                }
                let [b, c] = law.setpoint_weights;
                line("setpoint_weights", format!("[{b:?}, {c:?}]"));
                if let Some((time, order)) = self.filter() {
                    line("derivative_filter", format!("{{ time = {time:?}, order = {order:?} }}"));
                }
            }
            PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio } => {
                line("form", "\"series\"".to_owned());
                line("kp", format!("{proportional:?}"));
                line("integral_time", format!("{:?}", integral_rate.recip()));
                line("lambda", format!("{:?}", law.lambda));
                line("derivative_time", format!("{derivative_time:?}"));
                line("mu", format!("{:?}", law.mu));
                line("filter_ratio", format!("{filter_ratio:?}"));
            }
        }
        line("sample", format!("{:?}", problem.controller.sample));
        text
    }

    /// The tuned loop as a scenario for `fvi run` and `fvi controller`, with what `[loop]` says of it; `None`
    /// for plants that are not quotients of polynomials.
    pub fn loop_scenario(&self, problem: &TuningProblem) -> Option<String> {
        let crossovers = &self.sampled_margins.gain_crossovers;
        let about = crossovers.last().copied().unwrap_or_else(|| problem.plant.scale());
        let keys = self.law_keys(problem);
        problem.running.scenario(problem.heading(), &problem.plant, problem.controller.sample, about, &keys)
    }

    /// Writes the files of a tuning.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn write(&self, problem: &TuningProblem, directory: &OutputDirectory) -> Result<(), FileError> {
        remove(&directory.join("tune.json"))?;
        let mut files = Vec::new();
        let mut put = |name: &str, text: String| {
            files.push(name.to_owned());
            write_text(&directory.join(name), &text)
        };
        put("controller.toml", self.controller_table(problem))?;
        if let Some(text) = self.loop_scenario(problem) {
            put("loop.toml", text)?;
        }
        let mut text = "omega,plant_re,plant_im,loop_re,loop_im,sampled_re,sampled_im\n".to_owned();
        for super::LoopPoint { omega, plant, open, sampled } in &self.response {
            let numbers = [*omega, plant.re, plant.im, open.re, open.im];
            match sampled {
                Some(sampled) => append_row(&mut text, numbers.iter().chain([&sampled.re, &sampled.im])),
                None => {
                    append_row(&mut text, &numbers);
                    text.insert_str(text.len() - 1, ",,");
                }
            }
        }
        put("loop.csv", text)?;
        let mut text = "t,step,control,load\n".to_owned();
        self.steps.iter().for_each(|row| append_row(&mut text, row));
        put("steps.csv", text)?;
        #[cfg(feature = "pictures")]
        for (name, chart) in super::pictures::charts(self, problem) {
            crate::results::files::write_picture(&directory.join(name), &chart)?;
            files.push(name.to_owned());
        }
        files.sort();
        write_json(&directory.join("tune.json"), &TuneRecord { files, ..self.record(problem) })
    }
}
