//! Tables of numbers as laboratories write them: separators, lines before the header, names and units of
//! columns, numbers that are missing.

use super::document::{Table, Value};
use super::error::{InputError, Problem};
use crate::language::excerpt::excerpt;
use crate::language::expression::nearest;
use std::f64::consts::TAU;

/// The used cells of a table, with their places in the file for error messages.
pub struct Cells<'v, 'd> {
    value: &'v Value<'d>,
    file: String,
    pub columns: Vec<Place>,
    /// Line number of the header with the column names.
    pub header: u64,
    /// Row by row, with the line in the file: numbers as they stand there.
    pub rows: Vec<(u64, Vec<f64>)>,
    /// Lines of rows that are left out, since a number is missing in them.
    pub left_out: Vec<u64>,
}

/// A column that is used.
pub struct Place {
    /// The name by which the fit knows it.
    pub name: String,
    /// Its number in the file, from 1 on.
    pub number: usize,
    /// Its unit, as the file says.
    pub unit: Option<String>,
    /// What its numbers are multiplied by.
    pub factor: f64,
}

/// A row of the file: its line, and its cells.
type Row = (u64, Vec<String>);

/// What stands in place of a number that is missing, in small letters.
const MISSING: [&str; 6] = ["", "-", "nan", "na", "n/a", "null"];

/// Independent variables of tables: time, angular frequency, frequency in Hz.
pub const OVER: [&str; 3] = ["t", "omega", "f"];

/// Suffix of the column with the standard deviations of another one.
pub const DEVIATION: &str = "_deviation";

impl Cells<'_, '_> {
    pub fn fault(&self, line: u64, reason: String) -> InputError {
        self.value.error(Problem::Table { file: self.file.clone(), line, reason })
    }

    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|own| own.name == name)
    }

    /// The numbers of a column in the unit of the scenario.
    pub fn values(&self, column: usize) -> Vec<f64> {
        let factor = self.columns[column].factor;
        self.rows.iter().map(|(_, row)| row[column] * factor).collect()
    }

    /// What the numbers of a column are multiplied by.
    pub fn factor(&self, name: &str) -> f64 {
        self.column(name).map_or(1.0, |column| self.columns[column].factor)
    }

    /// "column 2 (storage)".
    pub fn place(&self, column: usize) -> String {
        let Place { name, number, .. } = &self.columns[column];
        format!("column {number} ({})", excerpt(name))
    }

    /// Brings the rows into ascending order of a column.
    fn sort(&mut self, column: usize) {
        self.rows.sort_by(|(_, a), (_, b)| a[column].total_cmp(&b[column]));
    }
}

/// Reads the file of a table; `table` is its entry in the fit.
pub fn cells<'v, 'd>(value: &'v Value<'d>, table: &Table<'_>) -> Result<Cells<'v, 'd>, InputError> {
    let document = value.document();
    let name = value.text()?;
    let text = document.read_named(name).map_err(|error| value.file_error(error.to_string()))?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let mut read = Cells {
        value,
        file: document.resolve(name).display().to_string(),
        columns: Vec::new(),
        header: 1,
        rows: Vec::new(),
        left_out: Vec::new(),
    };
    let (rows, header) = match table.optional("columns") {
        None => read.plain_header(text)?,
        Some(columns) => read.named_header(text, &columns)?,
    };
    let comma = match table.optional("decimal") {
        Some(value) => value.choice(&[(".", false), (",", true)])?,
        None => false,
    };
    let width = rows[header].1.iter().rposition(|cell| !cell.is_empty()).map_or(0, |last| last + 1);
    let mut below = &rows[header + 1..];
    if let Some((_, first)) = below.first()
        && read.are_units(first, comma)
    {
        for place in &mut read.columns {
            let unit = first.get(place.number - 1).map_or("", String::as_str);
            let unit = unit.trim_start_matches(['[', '(']).trim_end_matches([']', ')']).trim();
            if !unit.is_empty() && unit != "-" {
                place.unit = Some(unit.to_owned());
            }
        }
        below = &below[1..];
    }
    for (line, row) in below {
        read.row(*line, row, width, comma)?;
    }
    if read.rows.is_empty() {
        let reason = match read.left_out.len() {
            0 => "there are no rows".to_owned(),
            count => format!("there are no rows: in each of {count} a number is missing"),
        };
        return Err(read.fault(read.header, reason));
    }
    read.units(table.optional("units").as_ref())?;
    let over: Vec<usize> = OVER.iter().filter_map(|name| read.column(name)).collect();
    match over.as_slice() {
        &[one] => read.sort(one),
        [] => {
            let reason = "there is no column t, omega (rad/s) or f (Hz); `columns = { omega = \"…\" }` says which of \
                          the file's it is";
            return Err(read.fault(read.header, reason.to_owned()));
        }
        _ => return Err(read.fault(read.header, "one column of t, omega and f, not several".to_owned())),
    }
    Ok(read)
}

/// The rows of a text that is separated by tabs, semicolons or commas, or by spaces.
fn separated(text: &str, separator: char) -> Result<Vec<Row>, csv::Error> {
    let spaced;
    let (text, separator) = if separator == ' ' {
        let lines = text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join("\t"));
        spaced = lines.collect::<Vec<_>>().join("\n");
        (spaced.as_str(), '\t')
    } else {
        (text, separator)
    };
    let mut reader = csv::ReaderBuilder::new();
    let reader = reader.comment(Some(b'#')).trim(csv::Trim::All).has_headers(false).flexible(true);
    let mut rows = Vec::new();
    for record in reader.delimiter(separator as u8).from_reader(text.as_bytes()).records() {
        let record = record?;
        let row: Vec<String> = record.iter().map(str::to_owned).collect();
        if row.iter().any(|cell| !cell.is_empty()) {
            rows.push((record.position().map_or(0, csv::Position::line), row));
        }
    }
    Ok(rows)
}

/// Separators in the order in which they are tried.
const SEPARATORS: [char; 4] = ['\t', ';', ',', ' '];

/// A name of a column and the unit in brackets behind it, if any.
fn without_unit(name: &str) -> (&str, Option<&str>) {
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some((front, unit)) = name.strip_suffix(close).and_then(|rest| rest.rsplit_once(open))
            && !front.trim().is_empty()
        {
            return (front.trim(), Some(unit.trim()));
        }
    }
    (name, None)
}

fn number_of(cell: &str, comma: bool) -> Option<f64> {
    if !comma {
        return cell.parse().ok();
    }
    if cell.contains('.') { None } else { cell.replacen(',', ".", 1).parse().ok() }
}

fn is_missing(cell: &str) -> bool {
    MISSING.contains(&cell.to_lowercase().as_str())
}

impl Cells<'_, '_> {
    fn read(&self, text: &str, separator: char) -> Result<Vec<Row>, InputError> {
        separated(text, separator).map_err(|error| {
            let line = error.position().map_or(0, csv::Position::line);
            self.fault(line, error.to_string())
        })
    }

    /// The rows, the first of which names all columns.
    fn plain_header(&mut self, text: &str) -> Result<(Vec<Row>, usize), InputError> {
        let is_content = |line: &&str| !line.trim().is_empty() && !line.starts_with('#');
        let first = text.lines().find(is_content).unwrap_or_default();
        let separator = SEPARATORS.into_iter().find(|&separator| first.contains(separator)).unwrap_or(',');
        let rows = self.read(text, separator)?;
        let Some((line, header)) = rows.first() else {
            return Err(self.fault(1, "there are no rows".to_owned()));
        };
        self.header = *line;
        let named = header.iter().rposition(|cell| !cell.is_empty()).map_or(0, |last| last + 1);
        for (index, cell) in header.iter().take(named).enumerate() {
            let (name, unit) = without_unit(cell);
            if self.column(name).is_some() {
                let reason = format!("column {}: `{}` stands there twice", index + 1, excerpt(name));
                return Err(self.fault(self.header, reason));
            }
            self.add(name, index, unit);
        }
        Ok((rows, 0))
    }

    /// The rows, and the first of them with all names of `columns = { omega = "Angular Frequency" }`.
    fn named_header(&mut self, text: &str, columns: &Value<'_>) -> Result<(Vec<Row>, usize), InputError> {
        let mut wanted: Vec<(&str, &str)> = Vec::new();
        for (own, value) in columns.table()?.entries() {
            wanted.push((own, value.text()?.trim()));
        }
        if wanted.is_empty() {
            return Err(columns.out_of_range("names of columns, such as { omega = \"Angular Frequency\" }"));
        }
        let place = |row: &[String], name: &str| -> Vec<usize> {
            let matching = |same: &dyn Fn(&str) -> bool| -> Vec<usize> {
                (0..row.len()).filter(|&index| same(&row[index])).collect()
            };
            let exact = matching(&|cell| cell == name);
            if exact.is_empty() { matching(&|cell| without_unit(cell).0 == name) } else { exact }
        };
        // The row that has most of the names, and how many.
        let mut nearest_row: Option<(usize, u64, Vec<String>)> = None;
        for separator in SEPARATORS {
            let Ok(rows) = self.read(text, separator) else { continue };
            for (index, (line, row)) in rows.iter().enumerate() {
                let there = wanted.iter().filter(|(_, name)| !place(row, name).is_empty()).count();
                if there == wanted.len() {
                    self.header = *line;
                    for (own, name) in &wanted {
                        let &[column] = place(row, name).as_slice() else {
                            let reason = format!("`{}` stands there twice", excerpt(name));
                            return Err(self.fault(self.header, reason));
                        };
                        let unit = if row[column] == *name { None } else { without_unit(&row[column]).1 };
                        self.add(own, column, unit);
                    }
                    return Ok((rows, index));
                }
                if nearest_row.as_ref().is_none_or(|(most, ..)| there > *most) {
                    nearest_row = Some((there, *line, row.clone()));
                }
            }
        }
        let (_, line, row) = nearest_row.unwrap_or_default();
        let missing = wanted.iter().map(|(_, name)| *name).find(|name| place(&row, name).is_empty());
        let missing = missing.unwrap_or_default();
        let near = nearest(missing, row.iter().map(String::as_str));
        let near = near.map_or_else(String::new, |near| format!("; did you mean `{near}`?"));
        let names: Vec<String> = row.iter().take(20).map(|name| excerpt(name).to_string()).collect();
        let reason = format!(
            "no row has all names of `columns`: here `{}` is missing{near}; there are {}",
            excerpt(missing),
            names.join(", ")
        );
        Err(self.fault(line, reason))
    }

    fn add(&mut self, name: &str, index: usize, unit: Option<&str>) {
        let unit = unit.map(str::to_owned);
        self.columns.push(Place { name: name.to_owned(), number: index + 1, unit, factor: 1.0 });
    }

    /// Whether a row has units in place of numbers: words, and signs for numbers without one.
    fn are_units(&self, row: &[String], comma: bool) -> bool {
        let cells = || self.columns.iter().filter_map(|place| row.get(place.number - 1));
        let begins_as_number =
            |cell: &str| cell.starts_with(|sign: char| sign.is_ascii_digit() || "+-.,".contains(sign));
        let is_word =
            |cell: &String| !begins_as_number(cell) && number_of(cell, comma).is_none() && !is_missing(cell);
        let is_blank = |cell: &String| matches!(cell.as_str(), "" | "-" | "1");
        cells().any(is_word) && cells().all(|cell| is_word(cell) || is_blank(cell))
    }

    fn row(&mut self, line: u64, row: &[String], width: usize, comma: bool) -> Result<(), InputError> {
        let is_ragged = row.len() < width || row[width..].iter().any(|cell| !cell.is_empty());
        if is_ragged {
            let reason = format!("{} cells where the header has {width}", row.len());
            return Err(self.fault(line, reason));
        }
        let mut numbers = Vec::with_capacity(self.columns.len());
        for column in 0..self.columns.len() {
            let cell = row[self.columns[column].number - 1].as_str();
            if is_missing(cell) {
                self.left_out.push(line);
                return Ok(());
            }
            let number = number_of(cell, comma).filter(|number| number.is_finite());
            let Some(number) = number else {
                let advice = match (comma, number_of(cell, true)) {
                    (false, Some(_)) => "; a comma before the decimals is `decimal = \",\"`",
                    _ => "",
                };
                let reason =
                    format!("{}: `{}` is not a finite number{advice}", self.place(column), excerpt(cell));
                return Err(self.fault(line, reason));
            };
            numbers.push(number);
        }
        self.rows.push((line, numbers));
        Ok(())
    }

    /// Sets the factors that lead from the units of the file to those of the scenario.
    fn units(&mut self, given: Option<&Value<'_>>) -> Result<(), InputError> {
        let mut said: Vec<(String, f64)> = Vec::new();
        if let Some(given) = given {
            let table = given.table()?;
            let names: Vec<&str> = self.columns.iter().map(|place| place.name.as_str()).collect();
            table.allow(&names)?;
            for (name, value) in table.entries() {
                let factor = if OVER[1..].contains(&name) && value.number().is_err() {
                    value.choice(&[("Hz", TAU), ("rad/s", 1.0)])?
                } else {
                    value.positive()?
                };
                said.push((name.to_owned(), factor));
            }
        }
        for index in 0..self.columns.len() {
            let Place { name, unit, .. } = &self.columns[index];
            let base = name.strip_suffix(DEVIATION).unwrap_or(name);
            let own = said.iter().find(|(own, _)| own == name || own == base);
            let factor = match own {
                Some((_, factor)) => Ok(*factor),
                None => factor_of(name, unit.as_deref()),
            };
            self.columns[index].factor = factor.map_err(|reason| {
                let advice = format!("`units = {{ {base} = … }}` is the number to multiply it by, or 1");
                self.fault(self.header, format!("{}: {reason}; {advice}", self.place(index)))
            })?;
        }
        Ok(())
    }
}

/// What a column with this unit is multiplied by.
fn factor_of(name: &str, unit: Option<&str>) -> Result<f64, String> {
    let plain: Option<String> =
        unit.map(|unit| unit.chars().filter(|letter| !letter.is_whitespace()).collect());
    let Some(unit) = plain else { return Ok(if name == "f" { TAU } else { 1.0 }) };
    match (name, unit.as_str()) {
        ("omega" | "f", "Hz" | "hz" | "HZ") => Ok(TAU),
        ("omega" | "f", "rad/s" | "rads⁻¹" | "rad·s⁻¹" | "rads^-1" | "rad/sec" | "rads-1") => Ok(1.0),
        ("omega" | "f", _) => {
            Err(format!("a frequency in `{}`, which is neither rad/s nor Hz", excerpt(&unit)))
        }
        ("t", "s" | "sec" | "S") => Ok(1.0),
        ("t", _) => Err(format!("a time in `{}`, not in s", excerpt(&unit))),
        ("tan_delta", "1" | "–") => Ok(1.0),
        ("tan_delta", _) => Err(format!("a loss factor in `{}`", excerpt(&unit))),
        _ => Ok(1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_divided_from_their_units() {
        for (cell, name, unit) in [
            ("Angular Frequency [rad/s]", "Angular Frequency", Some("rad/s")),
            ("Storage Modulus (Pa)", "Storage Modulus", Some("Pa")),
            ("G'", "G'", None),
            ("(Pa)", "(Pa)", None),
        ] {
            assert_eq!(without_unit(cell), (name, unit));
        }
    }

    #[test]
    fn units_of_frequencies_and_times_have_factors() {
        assert_eq!(factor_of("omega", Some("Hz")), Ok(TAU));
        assert_eq!(factor_of("omega", Some("rad / s")), Ok(1.0));
        assert_eq!((factor_of("f", None), factor_of("omega", None)), (Ok(TAU), Ok(1.0)));
        for (name, unit) in [("omega", "1/s"), ("t", "min"), ("tan_delta", "%")] {
            assert!(factor_of(name, Some(unit)).is_err(), "{name} in {unit}");
        }
    }

    #[test]
    fn decimal_commas_are_not_guessed() {
        assert_eq!((number_of("1,5", true), number_of("1.5", false)), (Some(1.5), Some(1.5)));
        assert_eq!((number_of("1,5", false), number_of("1,234.5", true)), (None, None));
    }
}
