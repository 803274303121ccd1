//! Tables of numbers in CSV files that a scenario refers to.

use super::document::{Document, Value};
use super::error::{InputError, Problem};
use crate::language::excerpt::excerpt;

/// The columns of a CSV file with a header, rows ordered by its column `t`.
#[derive(Debug)]
pub struct NumberTable {
    /// Names of the columns.
    pub names: Vec<String>,
    /// One number for each column, row by row.
    pub rows: Vec<Vec<f64>>,
}

impl NumberTable {
    /// Reads the file that `value` refers to, relative to the document's directory. Lines that begin with `#`
    /// are comments. The first column is `t`, ascending; every number is finite.
    pub fn read(value: &Value<'_>, document: &Document, allowed: &[String]) -> Result<Self, InputError> {
        let file = document.resolve(value.text()?).display().to_string();
        let unreadable = |reason: String| value.error(Problem::Unreadable { reason });
        let fault =
            |line: u64, reason: String| value.error(Problem::Table { file: file.clone(), line, reason });
        let text = document.read_named(value.text()?).map_err(|error| unreadable(error.to_string()))?;
        let mut reader =
            csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(text.as_bytes());
        let names: Vec<String> = reader
            .headers()
            .map_err(|error| unreadable(error.to_string()))?
            .iter()
            .map(str::to_owned)
            .collect();
        if names.first().map(String::as_str) != Some("t") {
            return Err(fault(
                1,
                format!("the first column must be t; further ones: {}", allowed.join(", ")),
            ));
        }
        for (index, name) in names.iter().enumerate().skip(1) {
            if !allowed.contains(name) || names[..index].contains(name) {
                let list = allowed.join(", ");
                return Err(fault(
                    1,
                    format!("unknown or repeated column `{}`; columns after t: {list}", excerpt(name)),
                ));
            }
        }
        if names.len() < 2 && !allowed.is_empty() {
            let list = allowed.join(", ");
            return Err(fault(1, format!("there is no column beside t; columns after t: {list}")));
        }
        let mut rows: Vec<Vec<f64>> = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| {
                let line = error.position().map_or(0, csv::Position::line);
                fault(line, error.to_string())
            })?;
            let line = record.position().map_or(0, csv::Position::line);
            let row = record
                .iter()
                .map(|cell| {
                    let number = cell.parse::<f64>().ok().filter(|number| number.is_finite());
                    number.ok_or_else(|| fault(line, format!("`{}` is not a finite number", excerpt(cell))))
                })
                .collect::<Result<Vec<f64>, _>>()?;
            if rows.last().is_some_and(|last| last[0] >= row[0]) {
                return Err(fault(line, format!("t = {} does not come after the row before", row[0])));
            }
            rows.push(row);
        }
        if rows.is_empty() {
            return Err(fault(1, "there are no rows".to_owned()));
        }
        Ok(Self { names, rows })
    }
}
