//! `[[system.load]]`: a pattern of forces times a time-dependent amplitude.

use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Expression, Moment, Symbols};
use crate::language::number_table::NumberTable;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use std::sync::Arc;

/// The force f a(t).
#[derive(Clone, Debug, Serialize)]
pub struct Load {
    /// f.
    pub pattern: Pattern,
    /// a(t).
    pub amplitude: Amplitude,
}

/// f: distribution of a load over the coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Pattern {
    /// (coordinate, number) of the nonzero entries.
    pub entries: Arc<Vec<(u32, f64)>>,
    written: Written,
}

/// Form in which the scenario gives a pattern.
#[derive(Clone, Debug, PartialEq)]
enum Written {
    Numbers(usize),
    Coordinate,
    File(String),
}

/// a(t).
#[derive(Clone, Debug)]
pub enum Amplitude {
    /// An expression in t and the parameters.
    Expression(Expression),
    /// A record.
    Record(Record),
}

/// An amplitude given by its values at some times, linear in between, zero before the first and after the
/// last.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    file: String,
    rows: Arc<Vec<(f64, f64)>>,
}

impl Record {
    /// a(t). At its jumps, at the first and the last row, the side from which the moment is approached
    /// determines the value, as in `step`.
    pub fn at(&self, moment: Moment<f64>) -> f64 {
        let (first, last) = self.span();
        if moment.sided < first || moment.sided > last {
            return 0.0;
        }
        let time = moment.time.clamp(first, last);
        let after = self.rows.partition_point(|&(t, _)| t <= time);
        match (after.checked_sub(1).and_then(|before| self.rows.get(before)), self.rows.get(after)) {
            (Some(&(t0, a0)), Some(&(t1, a1))) => a0 + (a1 - a0) * ((time - t0) / (t1 - t0)),
            (Some(&(_, a0)), None) => a0,
            _ => 0.0,
        }
    }

    /// Its rows (t, a).
    pub fn rows(&self) -> &[(f64, f64)] {
        &self.rows
    }

    /// First and last time.
    pub fn span(&self) -> (f64, f64) {
        let time = |row: Option<&(f64, f64)>| row.map_or(0.0, |&(time, _)| time);
        (time(self.rows.first()), time(self.rows.last()))
    }
}

impl Load {
    pub(super) fn read(table: &Table<'_>, symbols: &Symbols, count: usize) -> Result<Self, InputError> {
        table.allow(&["pattern", "amplitude"])?;
        let pattern = Pattern::read(&table.required("pattern")?, count)?;
        let value = table.required("amplitude")?;
        let amplitude = if value.is_table() {
            let table = value.table()?;
            table.allow(&["file"])?;
            Amplitude::Record(Record::read(&table.required("file")?)?)
        } else {
            Amplitude::Expression(value.expression(&symbols.clone().with_time())?)
        };
        Ok(Self { pattern, amplitude })
    }
}

impl Pattern {
    pub(super) fn read(value: &Value<'_>, count: usize) -> Result<Self, InputError> {
        if value.is_table() {
            let table = value.table()?;
            table.allow(&["coordinate", "value"])?;
            let coordinate = table.required("coordinate")?.whole(0..=count - 1)?;
            let number = table.optional("value").map_or(Ok(1.0), |value| value.number())?;
            let entries = Arc::new(vec![(coordinate as u32, number)]);
            return Ok(Self { entries, written: Written::Coordinate });
        }
        let numbers = value.vector(count)?;
        let entries = numbers.iter().enumerate().filter(|(_, number)| **number != 0.0);
        let entries = entries.map(|(coordinate, &number)| (coordinate as u32, number)).collect();
        let written = if value.is_text() {
            Written::File(value.document().resolve(value.text()?).display().to_string())
        } else {
            Written::Numbers(count)
        };
        Ok(Self { entries: Arc::new(entries), written })
    }
}

impl Record {
    fn read(value: &Value<'_>) -> Result<Self, InputError> {
        let document = value.document();
        let table = NumberTable::read(value, document, &["a".to_owned()])?;
        let rows: Vec<(f64, f64)> =
            table.rows.iter().filter_map(|row| Some((*row.first()?, *row.get(1)?))).collect();
        if rows.len() < 2 {
            return Err(value.error(Problem::WrongShape {
                expected: "two rows at least".to_owned(),
                found: "one".to_owned(),
            }));
        }
        let file = document.resolve(value.text()?).display().to_string();
        Ok(Self { file, rows: Arc::new(rows) })
    }
}

impl Serialize for Pattern {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match (&self.written, self.entries.first()) {
            (Written::File(file), _) => file.serialize(serializer),
            (Written::Coordinate, Some((coordinate, number))) => {
                let mut map = serializer.serialize_map(Some(2))?;
                map.serialize_entry("coordinate", coordinate)?;
                map.serialize_entry("value", number)?;
                map.end()
            }
            (written, _) => {
                let mut numbers = vec![0.0; if let Written::Numbers(count) = written { *count } else { 0 }];
                for &(coordinate, number) in &*self.entries {
                    numbers[coordinate as usize] = number;
                }
                numbers.serialize(serializer)
            }
        }
    }
}

impl Serialize for Amplitude {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Expression(expression) => expression.serialize(serializer),
            Self::Record(record) => {
                let mut map = serializer.serialize_map(Some(1))?;
                map.serialize_entry("file", &record.file)?;
                map.end()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_linear_between_its_rows_and_zero_outside() {
        let rows = Arc::new(vec![(0.5, 1.0), (1.0, 3.0), (2.0, -1.0)]);
        let record = Record { file: String::new(), rows };
        for (time, amplitude) in
            [(0.4, 0.0), (0.5, 1.0), (0.75, 2.0), (1.0, 3.0), (1.5, 1.0), (2.0, -1.0), (2.1, 0.0)]
        {
            assert_eq!(record.at(Moment::inside(time)), amplitude, "t = {time}");
        }
        // It jumps at its ends; adjacent steps take the value on their own side.
        assert_eq!([Moment::from_left(0.5), Moment::from_right(0.5)].map(|at| record.at(at)), [0.0, 1.0]);
        assert_eq!([Moment::from_left(2.0), Moment::from_right(2.0)].map(|at| record.at(at)), [-1.0, 0.0]);
    }
}
