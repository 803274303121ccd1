//! `trajectory.csv` or `trajectory.npz`: one row for each grid point, streamed.

use crate::results::growing_file::{GrowingFile, Mark};
use crate::results::npz_rows::{self, Arrays, NpzRows};
use crate::simulation::GridState;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// The format of a trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// `trajectory.csv`: `t,q0,…,p0,…,energy` with 17 significant digits, and `u,setpoint,measure` of a
    /// controller, `u0,setpoint0,measure0,u1,…` of several.
    #[default]
    Csv,
    /// `trajectory.npz`: the NumPy arrays `t` (rows), `q` and `p` (rows × coordinates) and `energy` (rows);
    /// `u`, `setpoint` and `measure` (rows, or rows × controllers).
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

/// The columns of a trajectory.
#[derive(Clone, Copy, Debug)]
pub struct Columns<'a> {
    /// The coordinates, which name columns.
    pub coordinates: &'a [usize],
    /// Number of controllers.
    pub controllers: usize,
    /// Number of parameters with respect to which there are derivatives, which text has room for.
    pub parameters: usize,
    /// Whether there are the energies stored in memories and dissipated by them, which text has room for.
    pub memory_energy: bool,
}

/// Writes grid points row by row, so that a reader gets the same f64 back.
///
/// The rows live in files beside the destination, under names with `.part`, until [`finish`](Self::finish)
/// puts the whole in its place at once. A run that is to be gone on with takes a mark and has the parts kept.
pub struct TrajectoryWriter {
    rows: Rows,
    every: usize,
    /// Index of the grid point to come.
    index: usize,
    /// Whether the newest row is in the file.
    written: bool,
    /// Room for a row of text.
    line: String,
}

enum Rows {
    Csv(GrowingFile),
    Npz(Box<NpzRows>),
}

/// How far a trajectory has got: what of its files belongs to so many grid points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct TrajectoryMark {
    pub(crate) format: Format,
    written: bool,
    files: Vec<Mark>,
}

impl TrajectoryWriter {
    /// A writer into a directory of every `every`-th row; the first and the last are always written. The
    /// states that it takes hold these columns.
    ///
    /// # Errors
    /// If a file cannot be created.
    pub fn create(directory: &Path, format: Format, columns: Columns<'_>, every: usize) -> io::Result<Self> {
        let Columns { coordinates, controllers, parameters, memory_energy } = columns;
        let path = directory.join(format.file());
        let rows = match format {
            Format::Csv => {
                let mut file = GrowingFile::begin(&path, 0)?;
                let columns = |letter: char| coordinates.iter().map(move |index| format!(",{letter}{index}"));
                let names: String = columns('q').chain(columns('p')).collect();
                let control = (0..controllers).map(|index| match controllers {
                    1 => ",u,setpoint,measure".to_owned(),
                    _ => format!(",u{index},setpoint{index},measure{index}"),
                });
                let control: String = control.collect();
                let derived = |letter: char, parameter: usize| {
                    coordinates.iter().map(move |index| format!(",d{letter}{index}_d{parameter}"))
                };
                let both = |parameter| derived('q', parameter).chain(derived('p', parameter));
                let derivatives: String = (0..parameters).flat_map(both).collect();
                let memory = if memory_energy { ",memory_stored,memory_dissipated" } else { "" };
                writeln!(file, "t{names},energy{control}{derivatives}{memory}")?;
                Rows::Csv(file)
            }
            Format::Npz => {
                Rows::Npz(Box::new(NpzRows::create(&path, Arrays::of_rows(controllers), coordinates.len())?))
            }
        };
        Ok(Self::behind(rows, every, 0, true))
    }

    /// A writer to a file of NumPy arrays of any name.
    ///
    /// # Errors
    /// If a file cannot be created.
    pub(crate) fn npz(
        path: &Path,
        (coordinates, controllers): (usize, usize),
        every: usize,
    ) -> io::Result<Self> {
        let rows = Rows::Npz(Box::new(NpzRows::create(path, Arrays::of_rows(controllers), coordinates)?));
        Ok(Self::behind(rows, every, 0, true))
    }

    /// A writer that goes on behind a mark with grid point `index`.
    ///
    /// # Errors
    /// If what was marked is no longer there.
    pub(crate) fn resume(
        directory: &Path,
        mark: &TrajectoryMark,
        (coordinates, controllers): (usize, usize),
        every: usize,
        index: usize,
    ) -> io::Result<Self> {
        let path = directory.join(mark.format.file());
        let rows = match (mark.format, mark.files.as_slice()) {
            (Format::Csv, [csv]) => Rows::Csv(GrowingFile::resume(&path, 0, csv, || whole(&path))?),
            (Format::Npz, marks) => {
                Rows::Npz(Box::new(NpzRows::resume(&path, Arrays::of_rows(controllers), coordinates, marks)?))
            }
            _ => return Err(io::ErrorKind::InvalidData.into()),
        };
        Ok(Self::behind(rows, every, index, mark.written))
    }

    fn behind(rows: Rows, every: usize, index: usize, written: bool) -> Self {
        Self { rows, every: every.max(1), index, written, line: String::new() }
    }

    /// Whether what was marked is still there. Nothing is changed.
    pub(crate) fn can_resume(directory: &Path, mark: &TrajectoryMark) -> bool {
        let path = directory.join(mark.format.file());
        match (mark.format, mark.files.as_slice()) {
            (Format::Csv, [csv]) => GrowingFile::can_resume(&path, 0, csv, || whole(&path)),
            (Format::Npz, marks) => npz_rows::can_resume(&path, marks),
            _ => false,
        }
    }

    /// The format.
    pub fn format(&self) -> Format {
        match self.rows {
            Rows::Csv(_) => Format::Csv,
            Rows::Npz(_) => Format::Npz,
        }
    }

    /// Takes the next row.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn push(&mut self, state: &GridState) -> io::Result<()> {
        self.written = self.index.is_multiple_of(self.every);
        self.index += 1;
        if self.written { self.write(state) } else { Ok(()) }
    }

    /// Takes the next `count` rows, of which `state` makes those that are written.
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
                state.append_row(&mut self.line);
                file.write_all(self.line.as_bytes())
            }
            Rows::Npz(rows) => {
                let control = |column: usize| state.control.iter().skip(column).step_by(3).copied();
                let control: [Vec<f64>; 3] = std::array::from_fn(|column| control(column).collect());
                let [output, setpoint, measure] = &control;
                rows.push([
                    &[state.time],
                    &state.position,
                    &state.momentum,
                    &[state.energy],
                    output,
                    setpoint,
                    measure,
                ])
            }
        }
    }

    /// Has everything on the disk; returns how far the trajectory has got.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn mark(&mut self) -> io::Result<TrajectoryMark> {
        let (format, files) = match &mut self.rows {
            Rows::Csv(file) => (Format::Csv, vec![file.mark()?]),
            Rows::Npz(rows) => (Format::Npz, rows.mark()?),
        };
        Ok(TrajectoryMark { format, written: self.written, files })
    }

    /// From now on the parts stay when the writer is dropped.
    pub(crate) fn keep(&mut self) {
        match &mut self.rows {
            Rows::Csv(file) => file.keep(),
            Rows::Npz(rows) => rows.keep(),
        }
    }

    /// Writes the last row, once more in `last`, if it is not there yet, and puts the file in its place.
    ///
    /// # Errors
    /// If that fails; the file that was there before then still is.
    pub fn finish(mut self, last: &GridState) -> io::Result<()> {
        if !self.written {
            self.write(last)?;
        }
        match self.rows {
            Rows::Csv(file) => file.commit(),
            Rows::Npz(rows) => rows.finish(),
        }
    }
}

fn whole(path: &PathBuf) -> io::Result<Box<dyn Read>> {
    Ok(Box::new(File::open(path)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: Columns<'static> =
        Columns { coordinates: &[0], controllers: 0, parameters: 0, memory_energy: false };

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
        let mut writer = TrajectoryWriter::create(directory.path(), Format::Csv, ONE, every).unwrap();
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
                    let mut writer = TrajectoryWriter::create(directory.path(), format, ONE, every).unwrap();
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
                        writer =
                            TrajectoryWriter::resume(directory.path(), &mark, (1, 0), every, 11).unwrap();
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
