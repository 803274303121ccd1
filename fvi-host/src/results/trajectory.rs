//! `trajectory.csv`: one row for each grid point, streamed.

use crate::results::files::{NewFile, begin, commit};
use crate::simulation::GridState;
use std::io::{self, Write};
use std::path::Path;

/// Writes `t,q0,…,p0,…,energy` row by row with 17 significant digits, so that a reader gets the same f64 back.
///
/// The rows go to a temporary file in the same directory; [`finish`](Self::finish) puts it in its place at once,
/// and without it nothing is left behind.
pub struct TrajectoryWriter {
    file: NewFile,
    every: usize,
    /// Rows to come before one is written.
    skipped: usize,
    /// Whether the newest row is in the file.
    written: bool,
}

impl TrajectoryWriter {
    /// A writer of every `every`-th row; the first and the last are always written.
    ///
    /// # Errors
    /// If the file cannot be created.
    pub fn create(path: &Path, coordinates: usize, every: usize) -> io::Result<Self> {
        let mut file = begin(path)?;
        let columns = |letter: char| (0..coordinates).map(move |index| format!(",{letter}{index}"));
        let names: String = columns('q').chain(columns('p')).collect();
        writeln!(file, "t{names},energy")?;
        Ok(Self { file, every: every.max(1), skipped: 0, written: true })
    }

    /// Takes the next row.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn push(&mut self, state: &GridState) -> io::Result<()> {
        self.written = self.skipped == 0;
        if self.written {
            self.skipped = self.every;
            write_row(&mut self.file, state)?;
        }
        self.skipped -= 1;
        Ok(())
    }

    /// Writes the last row, once more in `last`, if it is not there yet, and puts the file in its place.
    ///
    /// # Errors
    /// If that fails; the file that was there before then still is.
    pub fn finish(mut self, last: &GridState) -> io::Result<()> {
        if !self.written {
            write_row(&mut self.file, last)?;
        }
        commit(self.file)
    }
}

fn write_row(file: &mut impl Write, state: &GridState) -> io::Result<()> {
    write!(file, "{:.16e}", state.time)?;
    for number in state.position.iter().chain(&state.momentum).chain([&state.energy]) {
        write!(file, ",{number:.16e}")?;
    }
    file.write_all(b"\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(every: usize, count: usize) -> Vec<String> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("trajectory.csv");
        let mut writer = TrajectoryWriter::create(&path, 1, every).unwrap();
        let mut state = GridState { position: vec![1.0 / 3.0], energy: 1e-300, ..GridState::default() };
        for index in 0..count {
            state.time = index as f64 * 0.1;
            state.momentum = vec![-state.time];
            writer.push(&state).unwrap();
        }
        assert!(!path.exists());
        writer.finish(&state).unwrap();
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
}
