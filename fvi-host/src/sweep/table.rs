//! The table of a sweep, a row for each run: `results.csv` and `results.npz`.

use super::axis::{cell, number};
use super::plan::Sweep;
use super::records::{Record, Records, record_of};
use crate::results::files::{self, FileError};
use crate::results::numpy::{self, Archive, Kind};
use crate::results::output_directory::OutputDirectory;
use std::io::{self, Write};

const CSV: &str = "results.csv";
const NPZ: &str = "results.npz";

/// A column of the table.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// Whole numbers.
    Whole(Vec<i64>),
    /// Floating-point numbers; NaN for missing values.
    Number(Vec<f64>),
    /// Texts.
    Text(Vec<String>),
}

/// The rows of the runs that are done, in the order of the runs, column by column.
pub(super) fn rows(sweep: &Sweep, shards: &[Records]) -> Result<Vec<(String, Column)>, FileError> {
    let mut done: Vec<(usize, Record)> = Vec::new();
    for records in shards {
        for place in 0..records.share() {
            done.extend(records.read(place)?.map(|record| (records.run(place), record)));
        }
    }
    done.sort_by_key(|&(run, _)| run);
    let whole = |number: &dyn Fn(&(usize, Record)) -> usize| {
        Column::Whole(done.iter().map(|row| number(row) as i64).collect())
    };
    let text = |text: &dyn Fn(&(usize, Record)) -> String| Column::Text(done.iter().map(text).collect());
    let mut columns = vec![("run".to_owned(), whole(&|(run, _)| *run))];
    for (index, axis) in sweep.axes().iter().enumerate() {
        let value = |run: usize| sweep.values_of(run).swap_remove(index);
        let column = if axis.is_numeric() {
            Column::Number(done.iter().map(|(run, _)| number(&value(*run)).unwrap_or(f64::NAN)).collect())
        } else {
            text(&|(run, _)| cell(&value(*run)))
        };
        columns.push((axis.path.clone(), column));
    }
    columns.push(("status".to_owned(), text(&|(_, record)| record.status.name().to_owned())));
    columns.push(("steps".to_owned(), whole(&|(_, record)| record.steps as usize)));
    for (index, name) in sweep.quantities().columns().into_iter().enumerate() {
        let value = |(_, record): &(usize, Record)| record.values.get(index).copied().unwrap_or(f64::NAN);
        columns.push((name, Column::Number(done.iter().map(value).collect())));
    }
    columns.push(("message".to_owned(), text(&|(_, record)| record.message.clone())));
    Ok(columns)
}

/// Writes the table in both forms; returns the names of the files.
pub(super) fn write(
    sweep: &Sweep,
    shards: &[Records],
    directory: &OutputDirectory,
) -> Result<Vec<String>, FileError> {
    let path = directory.join(CSV);
    files::write(&path, |file| write_csv(sweep, shards, file))?;
    let path = directory.join(NPZ);
    let mut archive = Archive::new(files::begin(&path).map_err(FileError::at(&path))?);
    write_npz(sweep, shards, &mut archive).map_err(FileError::at(&path))?;
    let file = archive.finish().map_err(io::Error::other).map_err(FileError::at(&path))?;
    files::commit(file).map_err(FileError::at(&path))?;
    Ok(vec![CSV.to_owned(), NPZ.to_owned()])
}

fn write_csv(sweep: &Sweep, shards: &[Records], file: &mut impl Write) -> io::Result<()> {
    let mut table = csv::Writer::from_writer(file);
    let paths = sweep.axes().iter().map(|axis| axis.path.clone());
    let columns = sweep.quantities().columns();
    let fixed = |name: &str| std::iter::once(name.to_owned());
    let head = fixed("run").chain(paths).chain(fixed("status")).chain(fixed("steps"));
    table.write_record(head.chain(columns).chain(fixed("message")))?;
    for run in 0..sweep.runs() {
        let record = record(shards, run)?;
        let values = sweep.values_of(run);
        // Missing values and NaN become empty cells.
        let number = |value: &f64| if value.is_nan() { String::new() } else { format!("{value:?}") };
        let row = fixed(&run.to_string())
            .chain(values.iter().map(cell))
            .chain(fixed(record.status.name()))
            .chain(fixed(&record.steps.to_string()))
            .chain(record.values.iter().map(number))
            .chain(fixed(&record.message));
        table.write_record(row)?;
    }
    table.flush()
}

fn record(shards: &[Records], run: usize) -> io::Result<Record> {
    record_of(shards, run).map_err(|error| error.source)
}

/// Writes the columns as arrays, one after another: the records are read once for each, and none is held.
fn write_npz(sweep: &Sweep, shards: &[Records], archive: &mut Archive) -> io::Result<()> {
    column(archive, "run", Kind::Whole, sweep, |run| Ok((run as i64).to_le_bytes()))?;
    for (index, axis) in sweep.axes().iter().enumerate() {
        let value = |run: usize| sweep.values_of(run).swap_remove(index);
        if axis.is_numeric() {
            let number = |run| Ok(number(&value(run)).unwrap_or(f64::NAN).to_le_bytes());
            column(archive, &axis.path, Kind::Number, sweep, number)?;
        } else {
            texts(archive, &axis.path, sweep, |run| Ok(cell(&value(run))))?;
        }
    }
    texts(archive, "status", sweep, |run| Ok(record(shards, run)?.status.name().to_owned()))?;
    column(
        archive,
        "steps",
        Kind::Whole,
        sweep,
        |run| Ok((record(shards, run)?.steps as i64).to_le_bytes()),
    )?;
    for (index, name) in sweep.quantities().columns().iter().enumerate() {
        column(archive, name, Kind::Number, sweep, |run| {
            Ok(record(shards, run)?.values.get(index).copied().unwrap_or(f64::NAN).to_le_bytes())
        })?;
    }
    texts(archive, "message", sweep, |run| Ok(record(shards, run)?.message))
}

/// Writes an array with a number for each run.
fn column(
    archive: &mut Archive,
    name: &str,
    kind: Kind,
    sweep: &Sweep,
    number: impl Fn(usize) -> io::Result<[u8; 8]>,
) -> io::Result<()> {
    numpy::write_array(archive, name, |array| {
        array.write_all(&numpy::head(kind, sweep.runs() as u64, None))?;
        (0..sweep.runs()).try_for_each(|run| array.write_all(&number(run)?))
    })
}

/// Writes an array with a text for each run.
fn texts(
    archive: &mut Archive,
    name: &str,
    sweep: &Sweep,
    text: impl Fn(usize) -> io::Result<String>,
) -> io::Result<()> {
    let mut longest = 1;
    for run in 0..sweep.runs() {
        longest = longest.max(text(run)?.chars().count());
    }
    numpy::write_array(archive, name, |array| {
        array.write_all(&numpy::head(Kind::Text(longest), sweep.runs() as u64, None))?;
        for run in 0..sweep.runs() {
            let text = text(run)?;
            let mut letters = text.chars().map(u32::from).chain(std::iter::repeat(0)).take(longest);
            letters.try_for_each(|letter| array.write_all(&letter.to_le_bytes()))?;
        }
        Ok(())
    })
}
