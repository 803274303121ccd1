//! Tables of numbers as laboratories write them: separators, lines before the header, names and units of
//! columns, numbers that are missing.

use super::document::{Table, Value};
use super::error::{InputError, Problem};
use crate::language::excerpt::excerpt;
use crate::language::expression::nearest;
use fvi_core::{max_or_nan, min_or_nan};
use layout::{Layout, Row, is_missing, number_of, squeezed};
use std::f64::consts::{PI, TAU};
use units::{
    FREQUENCIES, factor_of, in_unit, is_decibels, is_unit, says_logarithms, unit_in, unit_of_axis,
    without_unit,
};

mod layout;
mod units;

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
    /// True if its numbers are magnitudes in decibels.
    in_decibels: bool,
    /// Why its numbers are not known, of a phase without a unit: who has no phases refuses it as such.
    open: Option<String>,
}

impl Place {
    /// True if the file says that its numbers are decibels.
    pub fn is_decibels(&self) -> bool {
        self.unit.as_deref().is_some_and(is_decibels)
    }
}

/// The rows below the header, how many cells each has, and what separates them.
struct Body {
    rows: Vec<Row>,
    width: usize,
    separator: char,
}

/// Independent variables of tables: time, angular frequency, frequency in Hz.
pub const OVER: [&str; 3] = ["t", "omega", "f"];

/// The column whose numbers may be decibels.
const MAGNITUDE: &str = "magnitude";

/// Largest number of a column in `columns`.
const MOST_COLUMNS: usize = 100_000;

/// Keys that say how a table is written.
pub const AS_WRITTEN: [&str; 3] = ["columns", "units", "decimal"];

/// What is said of a line that is no row.
const AS_COMMENT: &str = "a line of words begins with # as a comment";

/// Suffix of the column with the standard deviations of another one.
pub const DEVIATION: &str = "_deviation";

impl Cells<'_, '_> {
    pub fn fault(&self, line: u64, reason: String) -> InputError {
        self.value.error(Problem::Table { file: self.file.clone(), line, reason })
    }

    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|own| own.name == name)
    }

    /// The numbers of a column in the unit of the scenario; of decibels the factors that they stand for.
    pub fn values(&self, column: usize) -> Vec<f64> {
        let Place { factor, in_decibels, .. } = self.columns[column];
        let value = |number: f64| if in_decibels { libm::exp10(number / 20.0) } else { number };
        self.rows.iter().map(|(_, row)| value(row[column]) * factor).collect()
    }

    /// The numbers of a column in the unit of the scenario, decibels as such.
    pub fn levels(&self, column: usize) -> Vec<f64> {
        let factor = self.columns[column].factor;
        self.rows.iter().map(|(_, row)| row[column] * factor).collect()
    }

    /// What the numbers of a column are multiplied by.
    pub fn factor(&self, name: &str) -> f64 {
        self.column(name).map_or(1.0, |column| self.columns[column].factor)
    }

    /// Refuses a column whose unit is not known.
    ///
    /// # Errors
    /// Says why it is not.
    pub fn check_unit(&self, column: usize) -> Result<(), InputError> {
        let open = self.columns[column].open.as_ref();
        open.map_or(
            Ok(()),
            |reason| Err(self.fault(self.header, format!("{}: {reason}", self.place(column)))),
        )
    }

    /// True if a column holds decibels.
    pub fn is_in_decibels(&self, name: &str) -> bool {
        self.column(name).is_some_and(|column| self.columns[column].in_decibels)
    }

    /// "column 2 (storage)".
    pub fn place(&self, column: usize) -> String {
        let Place { name, number, .. } = &self.columns[column];
        format!("column {number} ({})", excerpt(name))
    }

    /// "2 rows are left out, in which a number is missing: lines 5, 9"; `None` if there are none.
    pub fn left_out_note(lines: &[u64], of: Option<usize>) -> Option<String> {
        const MOST: usize = 10;
        let all = of.map_or_else(String::new, |all| format!(" of {all}"));
        let said: Vec<String> = lines.iter().take(MOST).map(u64::to_string).collect();
        let more = if lines.len() > MOST { " …" } else { "" };
        let (count, said) = (lines.len(), said.join(", "));
        match (count, of) {
            (0, _) => None,
            (1, None) => Some(format!("1 row is left out, in which a number is missing: line {said}")),
            (1, Some(_)) => {
                Some(format!("1{all} rows is left out, in which a number is missing: line {said}"))
            }
            _ => Some(format!(
                "{count}{all} rows are left out, in which a number is missing: lines {said}{more}"
            )),
        }
    }

    /// Brings the rows into ascending order of a column.
    fn sort(&mut self, column: usize) {
        self.rows.sort_by(|(_, a), (_, b)| a[column].total_cmp(&b[column]));
    }
}

/// Refuses the keys of a file beside what is none.
pub fn refuse_as_written(table: &Table<'_>, with: &str) -> Result<(), InputError> {
    let Some(key) = AS_WRITTEN.iter().find_map(|key| table.optional(key)) else { return Ok(()) };
    let (with, allowed) = (with.to_owned(), "this key beside a text file".to_owned());
    Err(key.key_error(Problem::Incompatible { with, allowed }))
}

/// Reads the file of a table; `table` is its entry in the fit.
pub fn cells<'v, 'd>(value: &'v Value<'d>, table: &Table<'_>) -> Result<Cells<'v, 'd>, InputError> {
    let document = value.document();
    let name = value.text()?;
    let text = document.read_encoded(name).map_err(|error| value.file_error(error.to_string()))?;
    let mut read = Cells {
        value,
        file: document.resolve(name).display().to_string(),
        columns: Vec::new(),
        header: 1,
        rows: Vec::new(),
        left_out: Vec::new(),
    };
    let comma = match table.optional("decimal") {
        Some(value) => value.choice(&[(".", false), (",", true)])?,
        None => false,
    };
    let layout = Layout::of(&text).map_err(|reason| read.fault(1, reason))?;
    let body = match table.optional("columns") {
        None => read.plain_header(&layout, comma)?,
        Some(columns) => read.given_columns(&layout, &columns, table, comma)?,
    };
    let over = read.over()?;
    let mut below = body.rows.as_slice();
    if let Some(units) = read.row_of_units(&layout, &body, comma)? {
        for place in &mut read.columns {
            let unit = bare(units.get(place.number - 1).map_or("", String::as_str));
            if !is_blank(unit) {
                place.unit = Some(unit.to_owned());
            }
        }
        below = &below[1..];
    }
    for (line, row) in below {
        read.row(*line, row, body.width, comma)?;
    }
    if read.rows.is_empty() {
        let reason = match read.left_out.len() {
            0 => "there are no rows".to_owned(),
            count => format!("there are no rows: in each of {count} a number is missing"),
        };
        return Err(read.fault(read.header, reason));
    }
    read.check_second_table(over)?;
    read.units(table.optional("units").as_ref())?;
    read.sort(over);
    Ok(read)
}

/// A cell of a row of units without its brackets.
fn bare(cell: &str) -> &str {
    let inner = [('[', ']'), ('(', ')')]
        .into_iter()
        .find_map(|(open, close)| cell.strip_prefix(open).and_then(|rest| rest.strip_suffix(close)));
    inner.unwrap_or(cell).trim()
}

/// True for what stands in a row of units for a number without one.
fn is_blank(unit: &str) -> bool {
    matches!(unit, "" | "-" | "–" | "—" | "1")
}

/// True for rows of numbers alone, at least one.
fn are_numbers(row: &[String], comma: bool) -> bool {
    let is_number = |cell: &String| number_of(cell, comma).is_some();
    row.iter().any(is_number) && row.iter().all(|cell| is_number(cell) || is_missing(cell))
}

fn used_width(row: &[String]) -> usize {
    row.iter().rposition(|cell| !cell.is_empty()).map_or(0, |last| last + 1)
}

/// The names of columns in a message, the first of them.
fn list_of<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<String> =
        names.filter(|name| !name.is_empty()).map(|name| format!("`{}`", excerpt(name))).collect();
    match names.len() {
        0..=20 => names.join(", "),
        _ => format!("{}, …", names[..20].join(", ")),
    }
}

impl Cells<'_, '_> {
    /// The column of the independent variable.
    fn over(&self) -> Result<usize, InputError> {
        let over: Vec<usize> = OVER.iter().filter_map(|name| self.column(name)).collect();
        match over.as_slice() {
            &[one] => Ok(one),
            [] => {
                let time = self.columns.iter().find(|column| column.name.to_lowercase().starts_with("time"));
                let own = if time.is_some() { "t" } else { "omega" };
                let first = time.or(self.columns.first()).map_or("…", |column| column.name.as_str());
                let reason = format!(
                    "there is no column t, omega (rad/s) or f (Hz) among {}; `columns = {{ {own} = \"{}\", … }}` says which of \
                     the file's it is, and what the others are; the header may then be any line",
                    list_of(self.columns.iter().map(|column| column.name.as_str())),
                    excerpt(first)
                );
                Err(self.fault(self.header, reason))
            }
            _ => Err(self.fault(self.header, "one column of t, omega and f, not several".to_owned())),
        }
    }

    fn read(&self, layout: &Layout, separator: char) -> Result<Vec<Row>, InputError> {
        layout.rows(separator).map_err(|error| {
            let line = error.position().map_or(0, csv::Position::line);
            self.fault(line, error.to_string())
        })
    }

    /// The rows below the first one, which names all columns; if that has numbers, the comment above it does.
    fn plain_header(&mut self, layout: &Layout, comma: bool) -> Result<Body, InputError> {
        let separator = layout.of_first_line();
        let mut rows = self.read(layout, separator)?;
        let Some((line, first)) = rows.first() else {
            return Err(self.fault(1, "there are no rows".to_owned()));
        };
        self.header = *line;
        let header = if are_numbers(first, comma) {
            let above = layout.comments(separator).into_iter().rfind(|(comment, _)| comment < line);
            let named = above.filter(|(_, cells)| cells.len() == first.len() && !are_numbers(cells, comma));
            let Some((line, names)) = named else {
                let reason = format!(
                    "numbers where the names of the columns are wanted: {}; `columns = {{ omega = 1, … }}`, or t or f in place of omega, \
                     gives them by their numbers, from 1",
                    list_of(first.iter().map(String::as_str))
                );
                return Err(self.fault(self.header, reason));
            };
            self.header = line;
            names
        } else {
            rows.remove(0).1
        };
        let width = used_width(&header);
        for (index, cell) in header.iter().take(width).enumerate() {
            // Names of the program are words, so that `in` is none of them: "f in Hertz".
            let named = match without_unit(cell) {
                (_, None) => in_unit(cell).filter(|(name, _)| !name.contains(' ')),
                (name, Some(unit)) => Some((name, unit)),
            };
            let (name, unit) = named.map_or((cell.as_str(), None), |(name, unit)| (name, Some(unit)));
            if self.column(name).is_some() {
                let reason = format!("column {}: `{}` stands there twice", index + 1, excerpt(name));
                return Err(self.fault(self.header, reason));
            }
            self.add(name, index, unit);
        }
        Ok(Body { rows, width, separator })
    }

    /// The rows below the header of `columns = { omega = "Angular Frequency" }`, or from the first row on
    /// with numbers in the columns of `columns = { omega = 2 }`.
    fn given_columns(
        &mut self,
        layout: &Layout,
        columns: &Value<'_>,
        table: &Table<'_>,
        comma: bool,
    ) -> Result<Body, InputError> {
        let entries = columns.table()?.entries();
        if entries.is_empty() {
            return Err(columns.out_of_range("names of columns, such as { omega = \"Angular Frequency\" }"));
        }
        if entries.iter().all(|(_, value)| !value.is_text()) {
            let wanted: Vec<(&str, usize)> = entries
                .iter()
                .map(|(own, value)| Ok((*own, value.whole(1..=MOST_COLUMNS)?)))
                .collect::<Result<_, InputError>>()?;
            return self.numbered_columns(layout, &wanted, table, comma);
        }
        let wanted: Vec<(&str, String)> = entries
            .iter()
            .map(|(own, value)| Ok((*own, squeezed(value.text()?))))
            .collect::<Result<_, InputError>>()?;
        let wanted: Vec<(&str, &str)> = wanted.iter().map(|(own, name)| (*own, name.as_str())).collect();
        self.named_columns(layout, &wanted, comma)
    }

    fn numbered_columns(
        &mut self,
        layout: &Layout,
        wanted: &[(&str, usize)],
        table: &Table<'_>,
        comma: bool,
    ) -> Result<Body, InputError> {
        let has_numbers = |row: &Row| {
            let cells: Option<Vec<String>> =
                wanted.iter().map(|(_, number)| row.1.get(number - 1).cloned()).collect();
            cells.is_some_and(|cells| are_numbers(&cells, comma))
        };
        for separator in layout.separators(comma) {
            let Ok(mut rows) = self.read(layout, separator) else { continue };
            let Some(begin) = rows.iter().position(has_numbers) else { continue };
            let below = rows.split_off(begin);
            let (above, rows) = (rows, below);
            self.header = rows[0].0;
            let width = used_width(&rows[0].1);
            let (heading, units) = self.units_above(&above, layout, (separator, width), wanted, table)?;
            self.header = heading;
            for &(own, number) in wanted {
                let is_there = |(_, other): &&(&str, usize)| *other == number;
                if wanted.iter().filter(is_there).count() > 1 {
                    return Err(self.fault(self.header, format!("column {number} stands in `columns` twice")));
                }
                let unit = units.iter().find(|(of, _)| *of == number).map(|(_, unit)| unit.as_str());
                self.add(own, number - 1, unit);
            }
            return Ok(Body { rows, width, separator });
        }
        let names: Vec<String> = wanted.iter().map(|(own, number)| format!("{number} ({own})")).collect();
        Err(self.fault(1, format!("no row has numbers in the columns {}", names.join(", "))))
    }

    /// The units of columns by their numbers, in the heading or the row of units above the first row of
    /// numbers, and its line.
    fn units_above(
        &self,
        rows: &[Row],
        layout: &Layout,
        (separator, width): (char, usize),
        wanted: &[(&str, usize)],
        table: &Table<'_>,
    ) -> Result<(u64, Vec<(usize, String)>), InputError> {
        let comments = layout.comments(separator);
        let above = rows.iter().chain(&comments).filter(|(line, _)| *line < self.header);
        let nothing = || Ok((self.header, Vec::new()));
        let Some((line, row)) = above.max_by_key(|(line, _)| *line) else { return nothing() };
        let mut cells: Vec<String> = Vec::new();
        for cell in row {
            match cells.last_mut() {
                // Between spaces a unit in brackets is a word of its own, behind a name.
                Some(name)
                    if separator == ' ' && cell.starts_with(['[', '(']) && !name.starts_with(['[', '(']) =>
                {
                    *name += &format!(" {cell}");
                }
                _ => cells.push(cell.clone()),
            }
        }
        let is_one = |cell: &String| is_unit(bare(cell)) && (bare(cell) != cell || cell.chars().count() > 1);
        let widest = wanted.iter().map(|(_, number)| *number).max().unwrap_or(0);
        let fits = if separator == ' ' { cells.len() == width } else { cells.len() >= widest };
        if !fits {
            let has_units =
                cells.len() > 1 && cells.iter().any(|cell| is_one(cell) || unit_in(cell).is_some());
            let over = wanted.iter().find(|(own, _)| OVER.contains(own)).map_or("omega", |(own, _)| *own);
            let said = table.optional("units").and_then(|units| units.table().ok());
            if has_units && said.is_none_or(|said| said.optional(over).is_none()) {
                let reason = format!(
                    "{} cells, some with units, above rows of {width}: whose they are is not known; `units = {{ {over} = … }}` \
                     says that of {over}",
                    cells.len()
                );
                return Err(self.fault(*line, reason));
            }
            return nothing();
        }
        for (own, number) in wanted.iter().filter(|(own, _)| !OVER.contains(own)) {
            self.check_not_logarithms(*line, own, &cells[number - 1])?;
        }
        // Below names stands a row of units where all data have one, or a sign for none.
        let data =
            || wanted.iter().filter(|(own, _)| !OVER.contains(own)).map(|(_, number)| &cells[number - 1]);
        let are_units = data().any(is_one) && data().all(|cell| is_one(cell) || is_blank(bare(cell)));
        let unit = |&(own, number): &(&str, usize)| {
            let cell = cells[number - 1].as_str();
            let unit = match are_units {
                true => Some(bare(cell)),
                false if OVER.contains(&own) => unit_of_axis(own, cell),
                false => unit_in(cell),
            };
            unit.map(|unit| (number, unit.to_owned()))
        };
        Ok((*line, wanted.iter().filter_map(unit).collect()))
    }

    fn named_columns(
        &mut self,
        layout: &Layout,
        wanted: &[(&str, &str)],
        comma: bool,
    ) -> Result<Body, InputError> {
        // The row that has most of the names, and how many.
        let mut nearest_row: Option<(usize, u64, Vec<String>)> = None;
        let mut without_numbers: Option<(Row, Vec<Row>, char)> = None;
        for separator in layout.separators(comma) {
            let Ok(rows) = self.read(layout, separator) else { continue };
            let comments = layout.comments(separator);
            for (line, row) in rows.iter().chain(&comments) {
                let places: Vec<Vec<usize>> = wanted.iter().map(|(_, name)| places_of(row, name)).collect();
                let there = places.iter().filter(|places| !places.is_empty()).count();
                if nearest_row.as_ref().is_none_or(|(most, ..)| there > *most) {
                    nearest_row = Some((there, *line, row.clone()));
                }
                if there < wanted.len() {
                    continue;
                }
                let below = &rows[rows.partition_point(|(other, _)| other <= line)..];
                // The same words stand above a header too, in a list of settings.
                if are_above_numbers(below, &places, comma) {
                    return self.header_of((*line, row), wanted, below.to_vec(), separator);
                }
                without_numbers.get_or_insert_with(|| ((*line, row.clone()), below.to_vec(), separator));
            }
        }
        if let Some(((line, row), below, separator)) = without_numbers {
            return self.header_of((line, &row), wanted, below, separator);
        }
        let (_, line, row) = nearest_row.unwrap_or_default();
        let missing = wanted.iter().map(|(_, name)| *name).find(|name| places_of(&row, name).is_empty());
        let missing = missing.unwrap_or_default();
        let near = nearest(missing, row.iter().map(String::as_str));
        let near = near.map_or_else(String::new, |near| format!("; did you mean `{near}`?"));
        let reason = format!(
            "no row has all names of `columns`: here `{}` is missing{near}; there are {}",
            excerpt(missing),
            list_of(row.iter().map(String::as_str))
        );
        Err(self.fault(line, reason))
    }

    fn header_of(
        &mut self,
        (line, row): (u64, &[String]),
        wanted: &[(&str, &str)],
        rows: Vec<Row>,
        separator: char,
    ) -> Result<Body, InputError> {
        self.header = line;
        for (own, name) in wanted {
            let &[column] = places_of(row, name).as_slice() else {
                return Err(self.fault(self.header, format!("`{}` stands there twice", excerpt(name))));
            };
            let cell = &row[column];
            if !OVER.contains(own) {
                self.check_not_logarithms(self.header, own, cell)?;
            }
            let unit = match () {
                () if OVER.contains(own) => unit_of_axis(own, cell),
                () if cell == name => unit_in(cell),
                () => without_unit(cell).1.or_else(|| in_unit(cell).map(|(_, unit)| unit)),
            };
            self.add(own, column, unit);
        }
        Ok(Body { rows, width: used_width(row), separator })
    }

    /// Refuses a column of data under a heading that speaks of logarithms.
    fn check_not_logarithms(&self, line: u64, own: &str, heading: &str) -> Result<(), InputError> {
        if !says_logarithms(heading) {
            return Ok(());
        }
        let heading = excerpt(heading);
        Err(self.fault(
            line,
            format!("{own} is `{heading}`: logarithms, where the numbers themselves are wanted"),
        ))
    }

    fn add(&mut self, name: &str, index: usize, unit: Option<&str>) {
        let unit = unit.filter(|unit| !is_blank(unit)).map(str::to_owned);
        let name = name.to_owned();
        self.columns.push(Place {
            name,
            number: index + 1,
            unit,
            factor: 1.0,
            in_decibels: false,
            open: None,
        });
    }

    /// The units of all columns, if the first row below the header has them. Between spaces they are as many
    /// as the names, or in line with these.
    fn row_of_units(
        &self,
        layout: &Layout,
        body: &Body,
        comma: bool,
    ) -> Result<Option<Vec<String>>, InputError> {
        let Some((line, row)) = body.rows.first() else { return Ok(None) };
        let are_units = |row: Vec<String>| self.are_units(&row, comma).then_some(row);
        let has_numbers = row.iter().any(|cell| number_of(cell, comma).is_some());
        if body.separator != ' ' || row.len() >= body.width || has_numbers {
            return Ok(are_units(row.clone()));
        }
        let units = layout.below(self.header, *line).ok_or_else(|| {
            let reason = format!(
                "{}, which are not in line with the {} names of line {}: whose they are is not known; `columns = {{ f = 2, … }}` \
                 takes the rows of numbers below, with columns by their numbers, from 1, and `units = {{ f = \"Hz\", … }}` says \
                 their units",
                list_of(row.iter().map(String::as_str)),
                body.width,
                self.header
            );
            self.fault(*line, reason)
        })?;
        Ok(are_units(units))
    }

    /// Whether a row has units in place of numbers: words, and signs for numbers without one.
    fn are_units(&self, row: &[String], comma: bool) -> bool {
        let cells =
            || self.columns.iter().filter_map(|place| row.get(place.number - 1)).map(|cell| bare(cell));
        let begins_as_number =
            |cell: &str| cell.starts_with(|sign: char| sign.is_ascii_digit() || "+-.,".contains(sign));
        let is_word = |cell: &str| {
            is_unit(cell) || !begins_as_number(cell) && number_of(cell, comma).is_none() && !is_missing(cell)
        };
        cells().any(is_word) && cells().all(|cell| is_word(cell) || is_blank(cell))
    }

    fn row(&mut self, line: u64, row: &[String], width: usize, comma: bool) -> Result<(), InputError> {
        let is_ragged = row.len() < width || row[width..].iter().any(|cell| !cell.is_empty());
        if is_ragged {
            let again = row.iter().any(|cell| self.columns.iter().any(|place| place.name == *cell));
            let advice = match (row.len() < 2, again) {
                (true, _) => format!(": a line of other content, or another separator; {AS_COMMENT}"),
                (_, true) => ": a second table, which wants a file of its own".to_owned(),
                _ => format!("; below the table {AS_COMMENT}, and another table wants a file of its own"),
            };
            let cells = if row.len() == 1 { "cell" } else { "cells" };
            let reason = format!("{} {cells} where the header has {width}{advice}", row.len());
            return Err(self.fault(line, reason));
        }
        let is_word = |place: &Place| {
            let cell = row[place.number - 1].as_str();
            number_of(cell, true).or(number_of(cell, false)).is_none() && !is_missing(cell)
        };
        if self.columns.len() > 1 && self.columns.iter().all(is_word) {
            let said = list_of(self.columns.iter().map(|place| row[place.number - 1].as_str()));
            let reason = format!(
                "{said} where numbers are wanted; {AS_COMMENT}, and another table wants a file of its own"
            );
            return Err(self.fault(line, reason));
        }
        let mut numbers = Vec::with_capacity(self.columns.len());
        for column in 0..self.columns.len() {
            let cell = row[self.columns[column].number - 1].as_str();
            if is_missing(cell) {
                self.left_out.push(line);
                return Ok(());
            }
            let number = number_of(cell, comma);
            let Some(number) = number.filter(|number| number.is_finite()) else {
                let advice = match (comma, number_of(cell, true)) {
                    (false, Some(_)) if number.is_none() => {
                        "; a comma before the decimals is `decimal = \",\"`"
                    }
                    _ if number.is_some()
                        && self.is_of_waves()
                        && OVER.contains(&self.columns[column].name.as_str()) =>
                    {
                        "; A(∞) of bodies in waves is the key `infinite`, not a row"
                    }
                    _ if number.is_some() => "",
                    _ => "; without a number are empty cells, dashes, NaN, NA, N/A, null, #N/A",
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

    /// True if there are columns A or B, A00, B00, …: added mass and damping.
    fn is_of_waves(&self) -> bool {
        let is_entry = |name: &str| {
            let rest = name.strip_prefix(['A', 'B']);
            rest.is_some_and(|rest| rest.chars().all(|sign| sign.is_ascii_digit() || sign == '_'))
        };
        self.columns.iter().any(|place| is_entry(&place.name))
    }

    /// Refuses a second table below an empty line or a comment, whose places lie among those above.
    fn check_second_table(&self, over: usize) -> Result<(), InputError> {
        let name = &self.columns[over].name;
        let is_below = |above: &(u64, Vec<f64>), below: &(u64, Vec<f64>)| {
            let between = below.0 - above.0 - 1;
            let left_out = self.left_out.iter().filter(|line| (above.0..below.0).contains(line));
            between == 0 || between == left_out.count() as u64
        };
        let [mut low, mut high] = [f64::INFINITY, f64::NEG_INFINITY];
        for block in self.rows.chunk_by(is_below) {
            let places = || block.iter().map(|(_, row)| row[over]);
            let least = places().fold(f64::INFINITY, min_or_nan);
            let most = places().fold(f64::NEG_INFINITY, max_or_nan);
            if least < high && most > low {
                let reason = format!(
                    "a second table below an empty line, with {name} from {least} to {most} after {low} to {high}: it wants a \
                     file of its own; the rows of one table stand without empty lines and comments between them"
                );
                return Err(self.fault(block[0].0, reason));
            }
            (low, high) = (min_or_nan(low, least), max_or_nan(high, most));
        }
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
                let factor = match name {
                    // A number leads to the unit that the column has without it: for `f` that is Hz.
                    _ if value.number().is_ok() => value.positive()? * factor_of(name, None).unwrap_or(1.0),
                    "omega" | "f" => {
                        let others = FREQUENCIES.map(|(unit, hertz)| (unit, hertz * TAU));
                        value.choice(&[&[("Hz", TAU), ("rad/s", 1.0)][..], &others].concat())?
                    }
                    "phase" => value.choice(&[("deg", PI / 180.0), ("rad", 1.0)])?,
                    MAGNITUDE => {
                        value.choice(&[("dB", 1.0)])?;
                        self.columns.iter_mut().for_each(|place| place.in_decibels |= place.name == name);
                        1.0
                    }
                    _ => value.positive()?,
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
            let in_decibels = own.is_none() && name == MAGNITUDE && unit.as_deref().is_some_and(is_decibels);
            if let (Err((reason, _)), "phase") = (&factor, name.as_str()) {
                self.columns[index].open = Some(reason.clone());
                continue;
            }
            self.columns[index].factor = factor.map_err(|(reason, number)| {
                let advice = match number {
                    Some(number) => format!("`units = {{ {base} = {number} }}` is what to multiply it by"),
                    None if reason.contains("`units = ") => String::new(),
                    None => format!("`units = {{ {base} = … }}` is the number to multiply it by, or 1"),
                };
                let between = if advice.is_empty() { "" } else { "; " };
                self.fault(self.header, format!("{}: {reason}{between}{advice}", self.place(index)))
            })?;
            self.columns[index].in_decibels |= in_decibels;
        }
        Ok(())
    }
}

/// Where a name stands in a row, as the whole of a cell, or else before a unit.
fn places_of(row: &[String], name: &str) -> Vec<usize> {
    let matching = |same: &dyn Fn(&str) -> bool| -> Vec<usize> {
        (0..row.len()).filter(|&index| same(&row[index])).collect()
    };
    let ways: [&dyn Fn(&str) -> bool; 3] =
        [&|cell| cell == name, &|cell| without_unit(cell).0 == name, &|cell| {
            in_unit(cell).is_some_and(|(front, _)| front == name)
        }];
    ways.into_iter().map(matching).find(|places| !places.is_empty()).unwrap_or_default()
}

/// True if below a header, or below a row of units, the columns at these places have numbers.
fn are_above_numbers(below: &[Row], places: &[Vec<usize>], comma: bool) -> bool {
    let cells = |row: &Row| -> Vec<String> {
        places.iter().filter_map(|places| row.1.get(*places.first()?).cloned()).collect()
    };
    below.iter().take(2).any(|row| {
        let cells = cells(row);
        cells.len() == places.len() && are_numbers(&cells, comma)
    })
}
