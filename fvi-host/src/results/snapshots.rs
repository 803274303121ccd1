//! `snapshots.npz`: the whole state at some grid points, as NumPy arrays.

use crate::results::growing_file::Mark;
use crate::results::npz_rows::{self, NpzRows};
#[cfg(feature = "pictures")]
use crate::results::picture::Map;
use std::io;
use std::path::Path;

/// States collected along a run in arrays: `t`, and `q` and `p` with a row for each time.
pub(crate) struct Snapshots {
    every: usize,
    rows: NpzRows,
}

impl Snapshots {
    /// A file for states of `coordinates` coordinates, one every `every` steps.
    pub(crate) fn create(path: &Path, every: usize, coordinates: usize) -> io::Result<Self> {
        let rows = NpzRows::create(path, &npz_rows::states(coordinates))?;
        Ok(Self { every: every.max(1), rows })
    }

    /// Continues behind marks.
    pub(crate) fn resume(path: &Path, every: usize, coordinates: usize, marks: &[Mark]) -> io::Result<Self> {
        let rows = NpzRows::resume(path, &npz_rows::states(coordinates), marks)?;
        Ok(Self { every: every.max(1), rows })
    }

    /// True if the marked rows still exist. Changes nothing.
    pub(crate) fn can_resume(path: &Path, marks: &[Mark]) -> bool {
        let names = npz_rows::states(0).map(|array| array.name);
        npz_rows::can_resume(path, &names, marks)
    }

    /// Number of steps between two snapshots.
    pub(crate) fn every(&self) -> usize {
        self.every
    }

    /// Appends a state.
    pub(crate) fn take(&mut self, time: f64, position: &[f64], momentum: &[f64]) -> io::Result<()> {
        self.rows.push([&[time], position, momentum])
    }

    /// Flushes everything to the disk; returns marks of the arrays.
    pub(crate) fn mark(&mut self) -> io::Result<Vec<Mark>> {
        self.rows.mark()
    }

    /// From now on the part files are kept when this is dropped.
    pub(crate) fn keep(&mut self) {
        self.rows.keep();
    }

    /// Writes the archive to its destination.
    ///
    /// # Errors
    /// If that fails; an existing file is then unchanged.
    pub(crate) fn finish(self) -> io::Result<()> {
        self.rows.finish()
    }
}

/// The map of the positions in an archive.
#[cfg(feature = "pictures")]
pub(crate) fn map(path: &Path, heading: &str, coordinates: usize) -> io::Result<Map> {
    let times = npz_rows::read_rows(path, "t", 1)?.collect::<io::Result<Vec<_>>>()?.concat();
    let mut map = Map::new(heading, &times, coordinates);
    for (index, row) in npz_rows::read_rows(path, "q", coordinates)?.enumerate() {
        map.take(index, &row?);
    }
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numpy_arrays_hold_the_states() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("snapshots.npz");
        let mut snapshots = Snapshots::create(&path, 2, 2).unwrap();
        let take = |snapshots: &mut Snapshots, x: f64| {
            snapshots.take(0.5 * x, &[x, -x], &[2.0 * x, 0.0]).unwrap();
        };
        take(&mut snapshots, 0.0);
        let marks = snapshots.mark().unwrap();
        snapshots.keep();
        // Rows behind the marks are written again.
        take(&mut snapshots, 7.0);
        drop(snapshots);
        assert!(Snapshots::can_resume(&path, &marks) && !path.exists());
        let mut snapshots = Snapshots::resume(&path, 2, 2, &marks).unwrap();
        take(&mut snapshots, 2.0);
        snapshots.finish().unwrap();
        let rows: Vec<_> = npz_rows::read_rows(&path, "q", 2).unwrap().map(Result::unwrap).collect();
        assert_eq!(rows, [[0.0, 0.0], [2.0, -2.0]]);
        let mut archive = zip::ZipArchive::new(std::fs::File::open(path).unwrap()).unwrap();
        let mut array = |name: &str| {
            let mut bytes = Vec::new();
            io::Read::read_to_end(&mut archive.by_name(name).unwrap(), &mut bytes).unwrap();
            fvi_scenario::language::npy::read(&bytes).unwrap()
        };
        assert_eq!(array("t.npy").numbers, [0.0, 1.0]);
        let q = array("q.npy");
        assert_eq!(
            (q.shape.as_slice(), q.numbers.as_slice()),
            ([2, 2].as_slice(), [0.0, 0.0, 2.0, -2.0].as_slice())
        );
        assert_eq!(array("p.npy").numbers, [0.0, 0.0, 4.0, 0.0]);
    }
}
