//! The values of one key of the scenario.

use fvi_scenario::language::document::Value;
use fvi_scenario::language::{InputError, Problem};

/// A key of the scenario, by its path, and the values that it takes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axis {
    /// Path of the key, such as `system.damping[0].order`.
    pub(super) path: String,
    pub(super) values: Values,
}

/// The values of an axis.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Values {
    /// Listed values.
    List(Vec<toml::Value>),
    /// `count` numbers from `from` to `to`, both included.
    Range { from: f64, to: f64, count: usize, spacing: Spacing },
    /// `count` integers from `from` to `to`, both included.
    Whole { from: i64, to: i64, count: usize },
}

/// How a range is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Spacing {
    Linear,
    Logarithmic,
}

/// Largest number of values of one axis.
const MOST_VALUES: usize = 1_000_000;

impl Axis {
    /// Reads an axis; `plain` is the same value without places in the file. In a sampled sweep a range has no
    /// `count`.
    pub(super) fn read(
        path: &str,
        value: &Value<'_>,
        plain: &toml::Value,
        sampled: bool,
    ) -> Result<Self, InputError> {
        let path = path.to_owned();
        if let Some(list) = plain.as_array() {
            return if list.is_empty() {
                Err(value.out_of_range("at least one value"))
            } else {
                Ok(Self { path, values: Values::List(list.clone()) })
            };
        }
        let table = value.table()?;
        table.allow(&["from", "to", "count", "spacing"])?;
        let (from_value, to_value) = (table.required("from")?, table.required("to")?);
        let (from, to) = (from_value.number()?, to_value.number()?);
        let spacings = [("linear", Spacing::Linear), ("logarithmic", Spacing::Logarithmic)];
        let spacing = table.optional("spacing").map(|value| value.choice(&spacings)).transpose()?;
        let count = match (table.optional("count"), sampled) {
            (Some(count), true) => {
                return Err(count.key_error(Problem::Conflict { other: "sampling".to_owned() }));
            }
            (Some(count), false) => count.whole(1..=MOST_VALUES)?,
            (None, true) => 2,
            (None, false) => {
                return Err(table.required("count").err().unwrap_or_else(|| value.out_of_range("")));
            }
        };
        let spacing = spacing.unwrap_or(Spacing::Linear);
        if spacing == Spacing::Logarithmic {
            for (value, number) in [(&from_value, from), (&to_value, to)] {
                if number <= 0.0 {
                    return Err(value.out_of_range("a number > 0, for a logarithmic range"));
                }
            }
        }
        let whole = |key: &str| plain.get(key).and_then(toml::Value::as_integer);
        if let (Some(from), Some(to), Spacing::Linear) = (whole("from"), whole("to"), spacing) {
            let steps = count.saturating_sub(1).max(1) as i128;
            let even = (i128::from(to) - i128::from(from)) % steps == 0;
            if sampled || even {
                return Ok(Self { path, values: Values::Whole { from, to, count } });
            }
        }
        if !(to - from).is_finite() {
            return Err(to_value.out_of_range("a number whose distance from `from` is finite"));
        }
        Ok(Self { path, values: Values::Range { from, to, count, spacing } })
    }

    /// Number of values.
    pub(super) fn count(&self) -> usize {
        match &self.values {
            Values::List(values) => values.len(),
            Values::Range { count, .. } | Values::Whole { count, .. } => *count,
        }
    }

    /// The value at an index below [`count`](Self::count).
    pub(super) fn value(&self, index: usize) -> toml::Value {
        match &self.values {
            Values::List(values) => values.get(index).cloned().unwrap_or(toml::Value::Float(f64::NAN)),
            Values::Whole { from, to, count } => {
                let steps = count.saturating_sub(1).max(1) as i128;
                let way = (i128::from(*to) - i128::from(*from)) / steps * index as i128;
                toml::Value::Integer((i128::from(*from) + way) as i64)
            }
            Values::Range { count, spacing, .. } => {
                let last = count.saturating_sub(1);
                let value = self.at(if last == 0 { 0.0 } else { index as f64 / last as f64 });
                match value {
                    // Between the ends, rounded to the number that one would write: 0.4, not
                    // 0.39999999999999997.
                    toml::Value::Float(value) if *spacing == Spacing::Linear && index > 0 && index < last => {
                        toml::Value::Float(format!("{value:.14e}").parse().unwrap_or(value))
                    }
                    value => value,
                }
            }
        }
    }

    /// The value at `place` in [0, 1] along a range; for a list of n values, that with index ⌊n·place⌋.
    pub(super) fn at(&self, place: f64) -> toml::Value {
        match &self.values {
            Values::List(values) => {
                let index = (place * values.len() as f64) as usize;
                self.value(index.min(values.len() - 1))
            }
            Values::Whole { from, to, .. } => {
                let (low, high) = (*from.min(to), *from.max(to));
                let width = (i128::from(high) - i128::from(low) + 1) as f64;
                let offset = ((place * width) as i128).min(i128::from(high) - i128::from(low));
                toml::Value::Integer((i128::from(low) + offset) as i64)
            }
            // The ends are met exactly.
            Values::Range { from, .. } if place == 0.0 => toml::Value::Float(*from),
            Values::Range { to, .. } if place == 1.0 => toml::Value::Float(*to),
            Values::Range { from, to, spacing: Spacing::Linear, .. } => {
                toml::Value::Float(from + place * (to - from))
            }
            Values::Range { from, to, spacing: Spacing::Logarithmic, .. } => {
                toml::Value::Float(from * libm::pow(to / from, place))
            }
        }
    }

    /// True if its values are numbers.
    pub(super) fn is_numeric(&self) -> bool {
        match &self.values {
            Values::List(values) => values.iter().all(|value| number(value).is_some()),
            Values::Range { .. } | Values::Whole { .. } => true,
        }
    }

    /// True if a picture shows the axis on a logarithmic scale.
    #[cfg(feature = "pictures")]
    pub(super) fn is_logarithmic(&self) -> bool {
        matches!(self.values, Values::Range { spacing: Spacing::Logarithmic, .. })
    }
}

/// A value as a number.
pub(super) fn number(value: &toml::Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

/// A value as a cell of a table.
pub(super) fn cell(value: &toml::Value) -> String {
    match value {
        toml::Value::String(text) => text.clone(),
        toml::Value::Float(number) => format!("{number:?}"),
        value => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(from: f64, to: f64, count: usize, spacing: Spacing) -> Axis {
        Axis { path: "k".to_owned(), values: Values::Range { from, to, count, spacing } }
    }

    fn numbers(axis: &Axis) -> Vec<f64> {
        (0..axis.count()).map(|index| number(&axis.value(index)).unwrap()).collect()
    }

    #[test]
    fn ranges_meet_their_ends() {
        assert_eq!(numbers(&range(0.1, 0.7, 3, Spacing::Linear)), [0.1, 0.4, 0.7]);
        let decades = numbers(&range(1e-3, 1.0, 4, Spacing::Logarithmic));
        assert_eq!((decades[0], decades[3]), (1e-3, 1.0));
        assert!((decades[1] / 1e-2 - 1.0).abs() < 1e-14, "{decades:?}");
        assert_eq!(numbers(&range(2.0, 3.0, 1, Spacing::Linear)), [2.0]);
        let whole = Axis { path: "k".to_owned(), values: Values::Whole { from: 1, to: 7, count: 3 } };
        assert_eq!(
            (0..3).map(|index| whole.value(index)).collect::<Vec<_>>(),
            [1, 4, 7].map(toml::Value::Integer)
        );
        assert_eq!([0.0, 0.5, 0.999].map(|place| whole.at(place)), [1, 4, 7].map(toml::Value::Integer));
    }
}
