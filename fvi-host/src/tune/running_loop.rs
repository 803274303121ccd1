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
//! with the output u of the controller and a load w behind the dead time. Its motion from sample to sample is
//! computed by collocation (Radau IIA of order 5), by as many steps as bring it within [`EXACT`] of the
//! exponential of its matrix.

use super::Plant;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::document::{Table, Value};
use fvi_scenario::language::{Document, InputError, Problem};
use fvi_scenario::scenario::{Quotient, Scenario};
use nalgebra::DMatrix;
use std::fmt::Write as _;
use std::path::Path;

/// Keys of `[loop]` that are keys of `[controller]` in a scenario.
const OF_CONTROLLER: [&str; 7] =
    ["setpoint", "feed_forward", "limits", "rate_limit", "anti_windup", "quantise", "noise"];

/// The largest error of the motion over a sample, relative to the largest number that it has.
const EXACT: f64 = 1e-9;

/// The most steps in a sample, and the error up to which they suffice.
const MOST: u32 = 1024;
const LOOSE: f64 = 1e-6;

/// Part of itself that a dead time may be changed by without a word, part of a step by which it may end off a
/// grid point, and the most steps that are added to those of a sample so that it ends at one.
const DELAYED: f64 = 1e-9;
const NEARLY: f64 = 0.01;
const ADDED: u32 = 255;

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
        if plant.quotient().is_none() {
            let allowed = "a quotient of polynomials in s with more poles than zeros and one dead time: others run as scenarios";
            let with = "this plant".to_owned();
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
        let Some(text) = running.scenario("", plant, sample, plant.scale(), &law) else {
            let reason = format!(
                "the plant moves too fast for samples of {sample}: {MOST} steps in each do not follow it to {LOOSE:e}"
            );
            return Err(value.error(Problem::Unusable { reason }));
        };
        Scenario::from_document(Document::new("loop.toml", Path::new("."), &text))
            .map_err(|error| placed(&table, value, &error))?;
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
        let (plant, measured) = (plant.quotient()?, plant.measured());
        let Quotient { numerator, denominator, dead_time } = &plant;
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
        let (parts, error) = parts(denominator, sample)?;
        let (parts, delay) = with_delay(parts, *dead_time, sample);
        let mut model = measured
            .map_or_else(String::new, |measured| format!("# By measurement: {}.\n", measured.description()));
        if (delay - dead_time).abs() > DELAYED * dead_time {
            let _ =
                writeln!(model, "# A dead time of {dead_time:?} would end inside a step: it is {delay:?}.");
        }
        let end = self.end.unwrap_or(80.0 / about + 20.0 * dead_time);
        let samples = (end / sample).ceil();
        let all = |number: &str| vec![number; count].join(", ");
        let unit: Vec<&str> = (0..count).map(|i| if i + 1 == count { "1.0" } else { "0.0" }).collect();
        let quoted: Vec<String> =
            forces.into_iter().map(|force| toml::Value::from(force).to_string()).collect();
        let mut text = format!(
            "# The tuned loop, for `fvi run` and `fvi controller`: the plant is a chain of coordinates without mass; its dead\n\
             # time is the controller's `delay`, and what is added to the last force acts behind it, as a load. From one sample\n\
             # to the next its motion is within {error:.0e} of the exact one.\n\
             {model}title = {}\n\n[system]\nmass = [{}]\nforce = [{}]\n\n[[system.damping]]\norder = 1.0\n\
             coefficient = [{}]\n\n[initial]\nposition = [{}]\n\n[scheme]\nkind = \"collocation\"\n\n\
             [time]\nstep = {:?}\nsteps = {}\n\n[controller]\nmeasures = {}\ndrives = [{}]\n",
            toml::Value::from(title),
            all("0.0"),
            quoted.join(", "),
            all("1.0"),
            all("0.0"),
            sample / f64::from(parts),
            samples * f64::from(parts),
            toml::Value::from(sum(numerator, 1.0)),
            unit.join(", "),
        );
        if !self.keys.iter().any(|(key, _)| *key == "setpoint") {
            text += "setpoint = \"1\"\n";
        }
        for (key, value) in &self.keys {
            let _ = writeln!(text, "{key} = {value}");
        }
        text += law;
        if delay > 0.0 {
            let _ = writeln!(text, "delay = {delay:?}");
        }
        Some(text)
    }
}

/// The fewest steps of a sample, a power of two, for which the motion of the chain is within [`EXACT`] of the
/// exact one, and its error; [`MOST`] where they reach [`LOOSE`] only. `None` if they do not, or if the
/// motion leaves the numbers in a sample.
fn parts(denominator: &[f64], sample: f64) -> Option<(u32, f64)> {
    let count = denominator.len() - 1;
    // In units of the fastest time, so that the numbers of a vector are of one size; the last one is the
    // input.
    let unit =
        (0..count).map(|i| libm::pow(denominator[i].abs(), 1.0 / (count - i) as f64)).fold(0.0, max_or_nan);
    let unit = if unit > 0.0 { unit } else { sample.recip() };
    let mut matrix = DMatrix::zeros(count + 1, count + 1);
    for i in 0..count {
        matrix[(i, i + 1)] = 1.0;
        matrix[(count - 1, i)] -= denominator[i] / libm::pow(unit, (count - i) as f64);
    }
    let exact = exponential(&matrix * (unit * sample));
    let size = exact.iter().map(|number| number.abs()).fold(1.0, max_or_nan);
    if !size.is_finite() {
        return None;
    }
    let error = |parts: u32| -> Option<f64> {
        let z = &matrix * (unit * sample / f64::from(parts));
        let one = DMatrix::identity(count + 1, count + 1);
        let square = &z * &z;
        let numerator = &one + &z * 0.4 + &square * 0.05;
        let denominator = one - &z * 0.6 + &square * 0.15 - &square * &z / 60.0;
        let step = denominator.lu().solve(&numerator)?;
        let apart = step.pow(parts) - &exact;
        Some(apart.iter().map(|number| number.abs()).fold(0.0, max_or_nan) / size)
    };
    let mut parts = 1;
    loop {
        let found = error(parts)?;
        if found <= EXACT || parts >= MOST {
            return (found <= LOOSE).then_some((parts, found));
        }
        parts *= 2;
    }
}

/// Steps of a sample, at least so many, by which a dead time is a whole number of steps, exactly or nearly,
/// and that dead time.
fn with_delay(least: u32, dead_time: f64, sample: f64) -> (u32, f64) {
    let miss = |parts: u32| {
        let steps = dead_time / sample * f64::from(parts);
        ((steps - steps.round()).abs(), steps)
    };
    let counts = || least..=least + ADDED;
    let exact = counts().find(|&parts| {
        let (miss, steps) = miss(parts);
        miss <= DELAYED * steps
    });
    if let Some(parts) = exact {
        return (parts, dead_time);
    }
    let nearly = counts().find(|&parts| miss(parts).0 <= NEARLY);
    let nearest = || counts().min_by(|&a, &b| miss(a).0.total_cmp(&miss(b).0)).unwrap_or(least);
    let parts = nearly.unwrap_or_else(nearest);
    (parts, miss(parts).1.round() * sample / f64::from(parts))
}

/// e^Z: its series for Z/2^k, of which no row sum exceeds ½, squared k times.
fn exponential(z: DMatrix<f64>) -> DMatrix<f64> {
    let size = z.row_iter().map(|row| row.iter().map(|number| number.abs()).sum()).fold(0.0, max_or_nan);
    let halvings = if size > 0.5 { (libm::log2(size) + 1.0).ceil().min(1023.0) } else { 0.0 };
    let z = z / libm::exp2(halvings);
    let one = DMatrix::identity(z.nrows(), z.ncols());
    // 0.5^17/17! is below the rounding error of 1.
    let series = (1..=16).rev().fold(one.clone(), |sum, k| &one + &z * sum / f64::from(k));
    (0..halvings as u32).fold(series, |power, _| &power * &power)
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

#[cfg(test)]
mod tests {
    use super::{parts, with_delay};

    #[test]
    fn dead_times_end_at_steps() {
        assert_eq!(with_delay(1, 0.0, 0.1), (1, 0.0));
        assert_eq!(with_delay(2, 0.35, 0.1), (2, 0.35));
        assert_eq!(with_delay(1, 0.337, 0.1), (100, 0.337));
        // 1.7π steps: 5.3407…, 44 parts are 234.99 steps.
        let (parts, delay) = with_delay(1, 1.7 * std::f64::consts::PI, 1.0);
        assert!((delay - 1.7 * std::f64::consts::PI).abs() <= 0.01 / f64::from(parts), "{parts} {delay}");
    }

    #[test]
    fn steps_follow_what_a_sample_sees_of_a_plant() {
        // Slow, fast, slow and stiff, an oscillation of 16 turns in a sample, a chain of integrators.
        for (denominator, known, within) in [
            (vec![0.01, 1.0], 1, 1e-9),
            (vec![10.0, 1.0], 16, 1e-9),
            (vec![400.0, 800.5, 1.0], 8, 1e-9),
            (vec![1e6, 1.0, 1.0], 1024, 1e-6),
            (vec![0.0, 0.0, 0.0, 1.0], 1, 1e-9),
        ] {
            let (parts, error) = parts(&denominator, 0.1).unwrap();
            assert_eq!(parts, known, "{denominator:?}");
            assert!(error <= within, "{denominator:?}: {error:e}");
        }
        // What steps cannot follow and what grows beyond all numbers has no loop.
        assert_eq!(parts(&[1e12, 1.0, 1.0], 0.1), None);
        assert_eq!(parts(&[-1e6, 1.0], 1.0), None);
    }
}
