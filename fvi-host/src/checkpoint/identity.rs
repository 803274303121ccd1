//! What a run and its checkpoint must have in common.

use fvi_fft::memory::Engine;
use fvi_scenario::scenario::{Damping, Scenario};
use fvi_simulation::simulation::Precision;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Which run a checkpoint belongs to, and where it was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Identity {
    /// Version of the program.
    version: String,
    /// Vector units in use, on which the last bits of the engines depend; `None` for engines whose results
    /// are bit-identical on all machines.
    vector_units: Option<String>,
    /// Number of samples for which engine and tables were chosen.
    pub(crate) planned: usize,
    /// Precision, format and the scenario as used: every value by its path, long lists by their checksum.
    values: BTreeMap<String, String>,
    /// The bit patterns of `output.times`: through decimals the last bit might change.
    #[serde(default)]
    times: Vec<u64>,
}

/// Lists up to this length are compared entry by entry, longer ones by their checksum.
const SHORT: usize = 16;

/// Keys of a scenario in which run and checkpoint may differ: where the run ends, how often rows are written,
/// how many threads share the work. The columns of the rows must stay those of the checkpoint.
const FREE: [&str; 5] = ["time.steps", "time.end", "output.every", "output.times", "history.threads"];

impl Identity {
    /// The identity of a run of `scenario` with these engines.
    pub(crate) fn new(scenario: &Scenario, precision: Precision, engines: &[Engine]) -> Self {
        let mut values = BTreeMap::new();
        flatten("", &json(scenario), &mut values);
        let is_part_of = |path: &str, whole: &str| {
            path.strip_prefix(whole).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
        };
        values.retain(|path, _| !FREE.iter().any(|free| is_part_of(path, free)));
        values.insert("precision".to_owned(), json(&precision).to_string());
        values.extend(contents_of_kernels(scenario));
        let same_everywhere = [Engine::Direct, Engine::ExponentialSumCore];
        let vector_units = engines
            .iter()
            .any(|engine| !same_everywhere.contains(engine))
            .then(|| fvi_fft::vector_units().to_owned());
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            vector_units,
            planned: scenario.history.planned.unwrap_or_else(|| scenario.samples()),
            values,
            times: scenario.output.times.iter().map(|time| time.to_bits()).collect(),
        }
    }

    /// The first entry of `output.times` of the run `wanted`, up to the time `now`, for which the
    /// checkpointed run has not written a row.
    pub(super) fn missing_time(&self, wanted: &Self, now: f64) -> Option<f64> {
        let past = wanted.times.iter().filter(|&&time| f64::from_bits(time) <= now);
        past.copied().find(|time| !self.times.contains(time)).map(f64::from_bits)
    }

    /// The differences between the checkpointed run and the run `wanted`, one sentence each.
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

    /// Differences of machine or program version that may change the rounding.
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

/// Checksums of the kernels that are read from files, of which the scenario contains only the file names.
pub(crate) fn contents_of_kernels(scenario: &Scenario) -> Vec<(String, String)> {
    let terms = scenario.system.damping.iter().enumerate();
    let in_files = terms.filter(|(_, term)| {
        !term.transfer.numbers().is_empty() && term.transfer.text().is_some_and(|name| !name.is_empty())
    });
    let content = |(index, term): (usize, &Damping)| {
        let numbers = term.transfer.numbers();
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_bits().to_le_bytes()).collect();
        let told = format!("{} numbers with the checksum {:08x}", numbers.len(), crc32fast::hash(&bytes));
        (format!("system.damping[{index}].kernel, its file"), told)
    };
    in_files.map(content).collect()
}

/// Serialisation cannot fail: summaries contain only values that JSON can represent.
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
