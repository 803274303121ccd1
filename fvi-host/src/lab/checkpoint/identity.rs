//! What a run and its checkpoint must have in common.

use crate::scenario::{Engine, Scenario};
use crate::simulation::Precision;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Which run a checkpoint belongs to, and where it was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Identity {
    /// Version of the program.
    version: String,
    /// What the last bits of the engines depend on; nothing for engines that have the same bits everywhere.
    vector_units: Option<String>,
    /// Samples that engine and table were chosen for.
    pub(crate) planned: usize,
    /// Precision, format and the scenario as used: every value by its path, long lists by their checksum.
    values: BTreeMap<String, String>,
}

/// Lists up to this length are told apart entry by entry.
const SHORT: usize = 16;

/// Parts of a scenario in which run and checkpoint may differ: where it ends, what is written, how many
/// threads share the work.
const FREE: [&str; 4] = ["time.steps", "time.end", "output", "history.threads"];

impl Identity {
    /// That of a run with these engines.
    pub(crate) fn new(scenario: &Scenario, precision: Precision, engines: &[Engine]) -> Self {
        let mut values = BTreeMap::new();
        flatten("", &json(scenario), &mut values);
        values
            .retain(|path, _| !FREE.iter().any(|free| path == free || path.starts_with(&format!("{free}."))));
        values.insert("precision".to_owned(), json(&precision).to_string());
        let same_everywhere = [Engine::Direct, Engine::ExponentialSumCore];
        let vector_units = engines
            .iter()
            .any(|engine| !same_everywhere.contains(engine))
            .then(|| fvi_fft::vector_units().to_owned());
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            vector_units,
            planned: scenario.history.planned.unwrap_or(scenario.time.steps.saturating_add(1)),
            values,
        }
    }

    /// In what the run that is wanted differs.
    pub(super) fn differences(&self, wanted: &Self) -> Vec<String> {
        const MOST: usize = 5;
        let absent = "absent".to_owned();
        let paths: std::collections::BTreeSet<&String> =
            self.values.keys().chain(wanted.values.keys()).collect();
        let differing = paths.into_iter().filter_map(|path| {
            let (there, here) = (self.values.get(path), wanted.values.get(path));
            let said = |value: Option<&String>| value.unwrap_or(&absent).clone();
            (there != here).then(|| format!("`{path}` is {} here and was {} there", said(here), said(there)))
        });
        let mut differences: Vec<String> = differing.collect();
        if differences.len() > MOST {
            let more = differences.len() - MOST;
            differences.truncate(MOST);
            differences.push(format!("and {more} more"));
        }
        differences
    }

    /// What of the machine or the program differs so that bits may.
    pub(super) fn other_machine(&self, wanted: &Self) -> Vec<String> {
        let mut differences = Vec::new();
        if self.version != wanted.version {
            differences.push(format!("fvi {} here, {} there", wanted.version, self.version));
        }
        if self.vector_units != wanted.vector_units {
            let said = |units: &Option<String>| units.clone().unwrap_or_else(|| "none needed".to_owned());
            differences.push(format!(
                "{} here, {} there",
                said(&wanted.vector_units),
                said(&self.vector_units)
            ));
        }
        differences
    }
}

/// What is written into summaries has no value that JSON does not know.
fn json(value: &impl Serialize) -> Value {
    serde_json::to_value(value).unwrap_or_default()
}

fn flatten(path: &str, value: &Value, values: &mut BTreeMap<String, String>) {
    match value {
        Value::Object(entries) => {
            for (key, value) in entries {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                flatten(&path, value, values);
            }
        }
        Value::Array(entries) if entries.len() <= SHORT => {
            for (index, value) in entries.iter().enumerate() {
                flatten(&format!("{path}[{index}]"), value, values);
            }
        }
        Value::Array(entries) => {
            let checksum = crc32fast::hash(value.to_string().as_bytes());
            values.insert(
                path.to_owned(),
                format!("{} values with the checksum {checksum:08x}", entries.len()),
            );
        }
        value => {
            values.insert(path.to_owned(), value.to_string());
        }
    }
}
