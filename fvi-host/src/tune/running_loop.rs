//! `loop.toml`: the tuned loop as a scenario, which `fvi run` simulates and `fvi controller` makes constants
//! of.
//!
//! A plant P = (c₀ + … + c_m s^m)/(a₀ + … + a_{n−1} s^{n−1} + sⁿ) e^{−Ls}, m < n, is a chain of coordinates
//! without mass,
//!
//! ```text
//! q̇_i = q_{i+1} ,   q̇_{n−1} = u(t − L) + w − Σ a_i q_i ,   y = Σ c_i q_i
//! ```
//!
//! with the output u of the controller and a load w behind the dead time.

use super::Plant;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::document::{Table, Value};
use fvi_scenario::language::{Document, InputError, Problem};
use fvi_scenario::scenario::Scenario;
use std::fmt::Write as _;
use std::path::Path;

/// Keys of `[loop]` that are keys of `[controller]` in a scenario.
const OF_CONTROLLER: [&str; 7] =
    ["setpoint", "feed_forward", "limits", "rate_limit", "anti_windup", "quantise", "noise"];

/// Steps in the time of the fastest pole, and most of them in a sample.
const STEPS: f64 = 8.0;
const MOST: f64 = 1000.0;

/// `[loop]`: how a tuned loop runs.
#[derive(Default)]
pub(super) struct Running {
    /// Keys of the controller and their values, as TOML.
    keys: Vec<(&'static str, String)>,
    /// Load at the input of the plant, an expression in t.
    load: Option<String>,
    end: Option<f64>,
}

impl Running {
    /// Reads `[loop]`.
    ///
    /// # Errors
    /// What a scenario with these keys cannot use; or if the plant is no quotient of polynomials.
    pub(super) fn read(value: &Value<'_>, plant: &Plant, sample: f64) -> Result<Self, InputError> {
        if plant.polynomials().is_none() {
            let allowed = "a plant by gain and time constants, frequency, or poles: others run as scenarios";
            let with = "`plant.transfer` or `plant.scenario`".to_owned();
            return Err(value.key_error(Problem::Incompatible { with, allowed: allowed.to_owned() }));
        }
        let table = value.table()?;
        let keys: Vec<&str> = OF_CONTROLLER.into_iter().chain(["load", "end"]).collect();
        table.allow(&keys)?;
        let values = value.document().values()?;
        let given = values.get("loop").and_then(toml::Value::as_table);
        let text = |key: &'static str| Some((key, given?.get(key)?.to_string()));
        for key in ["setpoint", "feed_forward", "load"] {
            table.optional(key).map(|value| value.text().map(str::to_owned)).transpose()?;
        }
        let load = table.optional("load").map(|value| value.text().map(str::to_owned)).transpose()?;
        let end = table.optional("end").map(|value| value.positive()).transpose()?;
        let running = Self { keys: OF_CONTROLLER.into_iter().filter_map(text).collect(), load, end };
        let law = format!("kp = 1.0\nsample = {sample:?}\n");
        if let Some(text) = running.scenario("", plant, sample, plant.scale(), &law) {
            Scenario::from_document(Document::new("loop.toml", Path::new("."), &text))
                .map_err(|error| placed(&table, value, &error))?;
        }
        Ok(running)
    }

    /// The scenario with these keys of its law; crossover or scale `about`.
    pub(super) fn scenario(
        &self,
        title: &str,
        plant: &Plant,
        sample: f64,
        about: f64,
        law: &str,
    ) -> Option<String> {
        let [numerator, denominator] = plant.polynomials()?;
        let count = denominator.len() - 1;
        let sum = |numbers: &[f64], sign: f64| {
            let terms: Vec<String> = numbers
                .iter()
                .enumerate()
                .filter(|(_, number)| **number != 0.0)
                .map(|(i, number)| format!("({:?})*q{i}", sign * number))
                .collect();
            if terms.is_empty() { "0".to_owned() } else { terms.join(" + ") }
        };
        let mut last = sum(&denominator[..count], -1.0);
        if let Some(load) = &self.load {
            // First, so that columns in messages are those of the load.
            last = format!("{load} + {last}");
        }
        let mut forces: Vec<String> = (1..count).map(|i| format!("q{i}")).collect();
        forces.push(last);
        let fastest = (0..count)
            .map(|i| libm::pow(denominator[i].abs(), 1.0 / (count - i) as f64))
            .fold(about, max_or_nan);
        let parts = (STEPS * sample * fastest).ceil().clamp(1.0, MOST);
        let end = self.end.unwrap_or(80.0 / about + 20.0 * plant.dead_time());
        let samples = (end / sample).ceil();
        let all = |number: &str| vec![number; count].join(", ");
        let unit: Vec<&str> = (0..count).map(|i| if i + 1 == count { "1.0" } else { "0.0" }).collect();
        let quoted: Vec<String> =
            forces.into_iter().map(|force| toml::Value::from(force).to_string()).collect();
        let mut text = format!(
            "# The tuned loop, for `fvi run` and `fvi controller`: the plant is a chain of coordinates without mass; its dead\n\
             # time is the controller's `delay`, and what is added to the last force acts behind it, as a load.\n\
             title = {}\n\n[system]\nmass = [{}]\nforce = [{}]\n\n[[system.damping]]\norder = 1.0\n\
             coefficient = [{}]\n\n[initial]\nposition = [{}]\n\n[convolution]\norder = 2\n\n\
             [time]\nstep = {:?}\nsteps = {}\n\n[controller]\nmeasures = {}\ndrives = [{}]\n",
            toml::Value::from(title),
            all("0.0"),
            quoted.join(", "),
            all("1.0"),
            all("0.0"),
            sample / parts,
            samples * parts,
            toml::Value::from(sum(&numerator, 1.0)),
            unit.join(", "),
        );
        if !self.keys.iter().any(|(key, _)| *key == "setpoint") {
            text += "setpoint = \"1\"\n";
        }
        for (key, value) in &self.keys {
            let _ = writeln!(text, "{key} = {value}");
        }
        text += law;
        if plant.dead_time() > 0.0 {
            let _ = writeln!(text, "delay = {:?}", plant.dead_time());
        }
        Some(text)
    }
}

/// An error of the scenario at its key of `[loop]`.
fn placed(table: &Table<'_>, value: &Value<'_>, error: &InputError) -> InputError {
    let key = error.key();
    let key = match key.strip_prefix("controller.") {
        Some(key) => key.split(['.', '[']).next().unwrap_or(key),
        None if key.starts_with("system.force") => "load",
        None if key.starts_with("time") => "end",
        None => return value.error(error.problem().clone()),
    };
    match table.optional(key) {
        Some(value) => value.error(error.problem().clone()),
        None => value.error(error.problem().clone()),
    }
}
