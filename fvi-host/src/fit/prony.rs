//! A Prony series as one entry of `[[free]]`: times spread over those of the data, strengths sought.

use super::data::Record;
use fvi_core::{max_or_nan, min_or_nan};
use fvi_scenario::language::document::Table;
use fvi_scenario::language::{InputError, put, value_at};
use std::ops::RangeInclusive;

/// Most terms of a series that is sought.
const MOST_TERMS: usize = 60;

/// A series Σ g τ s/(1 + τ s) with strengths g ≥ 0 that are sought, and times τ in equal ratios between two
/// ends, as in Σ g e^{−t/τ}: one time is their geometric mean.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Series {
    /// Number of terms; of several the smallest AIC decides.
    pub(super) terms: RangeInclusive<usize>,
    /// The shortest and the longest time.
    between: (f64, f64),
}

impl Series {
    /// Reads the keys `terms` and `between` of an entry of `[[free]]`. By default the times are between the
    /// shortest and the longest that the `records` tell: t, or 1/ω.
    pub(super) fn read(table: &Table<'_>, records: &[Record]) -> Result<Option<Self>, InputError> {
        let Some(value) = table.optional("terms") else {
            return match table.optional("between") {
                Some(value) => Err(value.key_error(fvi_scenario::language::Problem::Incompatible {
                    with: "a free number".to_owned(),
                    allowed: "`terms` beside it, the number of terms of a Prony series".to_owned(),
                })),
                None => Ok(None),
            };
        };
        let terms = match value.is_list() {
            true => {
                let list = value.list("the smallest and the largest number of terms")?;
                let [low, high] = list.as_slice() else {
                    return Err(value.out_of_range("a number of terms, or the smallest and the largest one"));
                };
                let low = low.whole(1..=MOST_TERMS)?;
                low..=high.whole(low..=MOST_TERMS)?
            }
            false => {
                let terms = value.whole(1..=MOST_TERMS)?;
                terms..=terms
            }
        };
        let between = match table.optional("between") {
            Some(between) => match between.numbers()?.as_slice() {
                &[low, high] if 0.0 < low && low < high && high.is_finite() => (low, high),
                _ => return Err(between.out_of_range("the shortest and the longest time, > 0")),
            },
            None => {
                let times = || records.iter().flat_map(Record::times);
                let ends = (times().fold(f64::INFINITY, min_or_nan), times().fold(0.0, max_or_nan));
                if !(ends.0 > 0.0 && ends.0 < ends.1) {
                    return Err(value.out_of_range("`between` beside it: the data are at one time only"));
                }
                ends
            }
        };
        Ok(Some(Self { terms, between }))
    }

    /// The times of so many terms.
    fn times(&self, terms: usize) -> Vec<f64> {
        let (low, high) = (libm::log(self.between.0), libm::log(self.between.1));
        let share = |index: usize| match terms {
            1 => 0.5,
            _ => index as f64 / (terms - 1) as f64,
        };
        (0..terms).map(|index| libm::exp(low + share(index) * (high - low))).collect()
    }

    /// Puts the times to the kernel at this path, and equal strengths, whose sum is that of the kernel there.
    /// Returns the paths of the strengths, and their start.
    pub(super) fn put(
        &self,
        values: &mut toml::Table,
        path: &str,
        terms: usize,
    ) -> Result<(Vec<String>, f64), String> {
        let kernel = value_at(values, path).and_then(toml::Value::as_table);
        let form = kernel.and_then(|kernel| kernel.get("form")).and_then(toml::Value::as_str);
        let Some(kernel) = kernel.filter(|_| form == Some("prony")) else {
            return Err(format!(
                "there is no kernel of the form \"prony\" at `{path}`; with `terms` the path is such as system.damping[0].kernel"
            ));
        };
        let strengths = kernel.get("strengths").and_then(toml::Value::as_array);
        let number = |value: &toml::Value| value.as_float().or_else(|| value.as_integer().map(|n| n as f64));
        let total: f64 = strengths.into_iter().flatten().filter_map(number).map(f64::abs).sum();
        let start = total / terms as f64;
        let list =
            |numbers: Vec<f64>| toml::Value::Array(numbers.into_iter().map(toml::Value::Float).collect());
        put(values, &format!("{path}.strengths"), list(vec![start; terms]))?;
        put(values, &format!("{path}.times"), list(self.times(terms)))?;
        Ok(((0..terms).map(|index| format!("{path}.strengths[{index}]")).collect(), start))
    }
}
