//! `trajectory.csv` or `trajectory.npz`: one row for each grid point, streamed.

use crate::results::csv_row::append_row;
use crate::results::growing_file::{GrowingFile, Mark};
use crate::results::npz_rows::{self, NpzRows};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::GridState;
use fvi_simulation::simulation::columns::{Columns, Quantity};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// The format of a trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// `trajectory.csv`: `t,q0,…,p0,…,energy`, of an equation `t,x0,…`, with the fewest digits that restore
    /// the same f64, and the run's columns, as `u,setpoint,measure` of a controller and
    /// `u0,setpoint0,measure0,u1,…` of several.
    #[default]
    Csv,
    /// `trajectory.npz`: the NumPy arrays `t` (rows), `q` and `p` (rows × coordinates) and `energy` (rows),
    /// of an equation `t` and `x`, and those of the run's columns, as `u`, `setpoint` and `measure` (rows, or
    /// rows × controllers).
    Npz,
}

impl Format {
    /// The name of the file.
    pub fn file(self) -> &'static str {
        match self {
            Self::Csv => "trajectory.csv",
            Self::Npz => "trajectory.npz",
        }
    }

    /// The other format.
    pub(crate) fn other(self) -> Self {
        match self {
            Self::Csv => Self::Npz,
            Self::Npz => Self::Csv,
        }
    }
}

/// What a state of a run consists of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum States {
    /// Positions q, momenta p and an energy.
    Motion,
    /// The unknowns x of an equation.
    Unknowns,
}

impl States {
    /// Those of a scenario.
    pub fn of(scenario: &Scenario) -> Self {
        if scenario.equation.is_some() { Self::Unknowns } else { Self::Motion }
    }

    /// The letter of the coordinates.
    pub fn letter(self) -> char {
        match self {
            Self::Motion => 'q',
            Self::Unknowns => 'x',
        }
    }
}

/// Content of the rows of a trajectory besides time and energy.
#[derive(Clone, Copy, Debug)]
pub struct Shape<'a> {
    /// What a row has.
    pub states: States,
    /// Indices of the coordinates that are written, which appear in the names of the columns.
    pub coordinates: &'a [usize],
    /// The run's columns.
    pub columns: &'a Columns,
    /// Number of sensitivity parameters; sensitivities are written to CSV only.
    pub parameters: usize,
}

/// Writes grid points row by row, with enough digits to restore the same f64.
///
/// The rows are written to files beside the destination, with names in `.part`, until
/// [`finish`](Self::finish) renames the result to its destination at once. For a run that may be resumed,
/// `mark` and `keep` preserve these files.
pub struct TrajectoryWriter {
    rows: Rows,
    states: States,
    every: usize,
    /// Index of the next grid point.
    index: usize,
    /// True if the newest row is in the file.
    written: bool,
    /// Buffer for a row of text.
    line: String,
}

enum Rows {
    Csv(GrowingFile),
    Npz(Box<NpzRows>, Vec<Quantity>),
}

impl Rows {
    /// NumPy arrays for `coordinates` coordinates and these columns, whose files `rows` opens.
    fn npz(
        (coordinates, states): (usize, States),
        columns: &Columns,
        rows: impl FnOnce(&[npz_rows::Shape]) -> io::Result<NpzRows>,
    ) -> io::Result<Self> {
        let quantities: Vec<_> = columns.quantities().collect();
        let mut arrays = match states {
            States::Motion => npz_rows::states(coordinates).to_vec(),
            States::Unknowns => npz_rows::unknowns(coordinates).to_vec(),
        };
        if states == States::Motion {
            arrays.push(npz_rows::Shape { name: "energy", columns: None });
        }
        arrays.extend(quantities.iter().map(|quantity| npz_rows::Shape {
            name: quantity.name,
            columns: (quantity.members > 1).then_some(quantity.members),
        }));
        Ok(Self::Npz(Box::new(rows(&arrays)?), quantities))
    }
}

/// Mark of a trajectory: how far its files are written at a grid point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct TrajectoryMark {
    pub(crate) format: Format,
    written: bool,
    /// Names of the NumPy arrays; empty for CSV.
    arrays: Vec<String>,
    files: Vec<Mark>,
}

impl TrajectoryWriter {
    /// A writer of every `every`-th row into a directory; the first and the last are always written. The
    /// states passed to it have the columns of `shape`.
    ///
    /// # Errors
    /// If a file cannot be created.
    pub fn create(directory: &Path, format: Format, shape: Shape<'_>, every: usize) -> io::Result<Self> {
        let Shape { states, coordinates, columns, parameters } = shape;
        let path = directory.join(format.file());
        let rows = match format {
            Format::Csv => {
                let mut file = GrowingFile::begin(&path, 0)?;
                let named = |letter: char| coordinates.iter().map(move |index| format!(",{letter}{index}"));
                let names: String = match states {
                    States::Motion => named('q').chain(named('p')).chain([",energy".to_owned()]).collect(),
                    States::Unknowns => named(states.letter()).collect(),
                };
                let more: String = columns.headings().iter().map(|heading| format!(",{heading}")).collect();
                let derived = |letter: char, parameter: usize| {
                    coordinates.iter().map(move |index| format!(",d{letter}{index}_d{parameter}"))
                };
                let both = |parameter| derived('q', parameter).chain(derived('p', parameter));
                let derivatives: String = (0..parameters).flat_map(both).collect();
                writeln!(file, "t{names}{more}{derivatives}")?;
                Rows::Csv(file)
            }
            Format::Npz => {
                Rows::npz((coordinates.len(), states), columns, |arrays| NpzRows::create(&path, arrays))?
            }
        };
        Ok(Self::behind(rows, states, (every, 0), true))
    }

    /// A writer of every row to a file of NumPy arrays of any name.
    ///
    /// # Errors
    /// If a file cannot be created.
    pub(crate) fn npz(path: &Path, coordinates: usize, columns: &Columns) -> io::Result<Self> {
        let states = States::Motion;
        let rows = Rows::npz((coordinates, states), columns, |arrays| NpzRows::create(path, arrays))?;
        Ok(Self::behind(rows, states, (1, 0), true))
    }

    /// A writer that continues behind a mark; the next grid point is `index`.
    ///
    /// # Errors
    /// If the marked rows no longer exist.
    pub(crate) fn resume(
        directory: &Path,
        mark: &TrajectoryMark,
        (states, coordinates, columns): (States, usize, &Columns),
        every: usize,
        index: usize,
    ) -> io::Result<Self> {
        let path = directory.join(mark.format.file());
        let rows = match (mark.format, mark.files.as_slice()) {
            (Format::Csv, [csv]) => Rows::Csv(GrowingFile::resume(&path, 0, csv, || whole(&path))?),
            (Format::Npz, marks) => {
                Rows::npz((coordinates, states), columns, |arrays| NpzRows::resume(&path, arrays, marks))?
            }
            _ => return Err(io::ErrorKind::InvalidData.into()),
        };
        Ok(Self::behind(rows, states, (every, index), mark.written))
    }

    fn behind(rows: Rows, states: States, (every, index): (usize, usize), written: bool) -> Self {
        Self { rows, states, every: every.max(1), index, written, line: String::new() }
    }

    /// True if the marked rows still exist. Changes nothing.
    pub(crate) fn can_resume(directory: &Path, mark: &TrajectoryMark) -> bool {
        let path = directory.join(mark.format.file());
        match (mark.format, mark.files.as_slice()) {
            (Format::Csv, [csv]) => GrowingFile::can_resume(&path, 0, csv, || whole(&path)),
            (Format::Npz, marks) => npz_rows::can_resume(&path, &mark.arrays, marks),
            _ => false,
        }
    }

    /// The format.
    pub fn format(&self) -> Format {
        match self.rows {
            Rows::Csv(_) => Format::Csv,
            Rows::Npz(..) => Format::Npz,
        }
    }

    /// Appends the next grid point.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn push(&mut self, state: &GridState) -> io::Result<()> {
        self.written = self.index.is_multiple_of(self.every);
        self.index += 1;
        if self.written { self.write(state) } else { Ok(()) }
    }

    /// Appends the next `count` grid points; `state` is called for those that are written.
    ///
    /// # Errors
    /// If one cannot be written.
    pub(crate) fn push_all(
        &mut self,
        count: usize,
        mut state: impl FnMut(usize) -> GridState,
    ) -> io::Result<()> {
        let Some(last) = count.checked_sub(1) else { return Ok(()) };
        let next = match self.index % self.every {
            0 => 0,
            past => self.every - past,
        };
        self.written = (self.index + last).is_multiple_of(self.every);
        self.index += count;
        (next..count).step_by(self.every).try_for_each(|index| self.write(&state(index)))
    }

    fn write(&mut self, state: &GridState) -> io::Result<()> {
        match &mut self.rows {
            Rows::Csv(file) => {
                self.line.clear();
                let row = std::iter::once(&state.time).chain(&state.position);
                match self.states {
                    States::Motion => {
                        let more = state.columns.iter().chain(&state.sensitivities);
                        append_row(
                            &mut self.line,
                            row.chain(&state.momentum).chain([&state.energy]).chain(more),
                        );
                    }
                    States::Unknowns => append_row(&mut self.line, row.chain(&state.columns)),
                }
                file.write_all(self.line.as_bytes())
            }
            Rows::Npz(rows, quantities) => {
                let (time, energy) = ([state.time], [state.energy]);
                let of = |quantity: &Quantity| quantity.of(&state.columns).collect();
                let more: Vec<Vec<f64>> = quantities.iter().map(of).collect();
                let row: &[&[f64]] = match self.states {
                    States::Motion => &[&time, &state.position, &state.momentum, &energy],
                    States::Unknowns => &[&time, &state.position],
                };
                rows.push(row.iter().copied().chain(more.iter().map(Vec::as_slice)))
            }
        }
    }

    /// Flushes everything to the disk; returns a mark of the trajectory.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn mark(&mut self) -> io::Result<TrajectoryMark> {
        let (format, arrays, files) = match &mut self.rows {
            Rows::Csv(file) => (Format::Csv, Vec::new(), vec![file.mark()?]),
            Rows::Npz(rows, _) => (Format::Npz, rows.names().map(str::to_owned).collect(), rows.mark()?),
        };
        Ok(TrajectoryMark { format, written: self.written, arrays, files })
    }

    /// From now on the part files are kept when the writer is dropped.
    pub(crate) fn keep(&mut self) {
        match &mut self.rows {
            Rows::Csv(file) => file.keep(),
            Rows::Npz(rows, _) => rows.keep(),
        }
    }

    /// Writes the last row, given in `last`, unless it has been written already, and renames the file to its
    /// destination.
    ///
    /// # Errors
    /// If that fails; an existing file is then unchanged.
    pub fn finish(mut self, last: &GridState) -> io::Result<()> {
        if !self.written {
            self.write(last)?;
        }
        match self.rows {
            Rows::Csv(file) => file.commit(),
            Rows::Npz(rows, _) => rows.finish(),
        }
    }
}

fn whole(path: &PathBuf) -> io::Result<Box<dyn Read>> {
    Ok(Box::new(File::open(path)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(index: usize) -> GridState {
        let time = index as f64 * 0.1;
        GridState {
            time,
            position: vec![1.0 / 3.0],
            momentum: vec![-time],
            energy: 1e-300,
            ..GridState::default()
        }
    }

    fn rows(every: usize, count: usize) -> Vec<String> {
        let directory = tempfile::tempdir().unwrap();
        let columns = Columns::default();
        let one = Shape { states: States::Motion, coordinates: &[0], columns: &columns, parameters: 0 };
        let mut writer = TrajectoryWriter::create(directory.path(), Format::Csv, one, every).unwrap();
        (0..count).for_each(|index| writer.push(&state(index)).unwrap());
        let path = directory.path().join("trajectory.csv");
        assert!(!path.exists());
        writer.finish(&state(count - 1)).unwrap();
        std::fs::read_to_string(path).unwrap().lines().map(str::to_owned).collect()
    }

    #[test]
    fn a_reader_gets_the_same_numbers_back() {
        let rows = rows(1, 8);
        assert_eq!(rows[0], "t,q0,p0,energy");
        for (index, row) in rows[1..].iter().enumerate() {
            let numbers: Vec<f64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
            let time = index as f64 * 0.1;
            assert_eq!(numbers, [time, 1.0 / 3.0, -time, 1e-300]);
        }
    }

    #[test]
    fn every_third_row_and_the_last_are_written() {
        let times = |every, count| -> Vec<f64> {
            let parse = |row: &String| row.split(',').next().unwrap().parse().unwrap();
            rows(every, count)[1..].iter().map(parse).collect()
        };
        assert_eq!(times(3, 7), [0.0, 0.1 * 3.0, 0.1 * 6.0]);
        assert_eq!(times(3, 8), [0.0, 0.1 * 3.0, 0.1 * 6.0, 0.1 * 7.0]);
        assert_eq!(times(100, 1), [0.0]);
    }

    #[test]
    fn a_trajectory_that_is_gone_on_with_has_the_bytes_of_one_that_was_not_interrupted() {
        for format in [Format::Csv, Format::Npz] {
            for every in [1, 3] {
                let written = |interrupted: bool, finished: bool| {
                    let directory = tempfile::tempdir().unwrap();
                    let columns = Columns::default();
                    let one =
                        Shape { states: States::Motion, coordinates: &[0], columns: &columns, parameters: 0 };
                    let mut writer = TrajectoryWriter::create(directory.path(), format, one, every).unwrap();
                    (0..11).for_each(|index| writer.push(&state(index)).unwrap());
                    if interrupted {
                        let mark = writer.mark().unwrap();
                        writer.keep();
                        (11..15).for_each(|index| writer.push(&state(index)).unwrap());
                        if finished {
                            writer.finish(&state(14)).unwrap();
                        } else {
                            drop(writer);
                        }
                        assert!(TrajectoryWriter::can_resume(directory.path(), &mark));
                        writer = TrajectoryWriter::resume(
                            directory.path(),
                            &mark,
                            (States::Motion, 1, &columns),
                            every,
                            11,
                        )
                        .unwrap();
                    }
                    (11..20).for_each(|index| writer.push(&state(index)).unwrap());
                    writer.finish(&state(19)).unwrap();
                    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1);
                    std::fs::read(directory.path().join(format.file())).unwrap()
                };
                let undisturbed = written(false, false);
                assert!(written(true, false) == undisturbed, "{format:?}, killed");
                assert!(written(true, true) == undisturbed, "{format:?}, carried further");
            }
        }
    }
}
