//! `snapshots.npz`: the whole state at some grid points, as NumPy reads it.

use crate::results::files::{FileError, write};
use crate::results::numpy::{Kind, begin_array, head};
use std::io::{self, Cursor, Write};
use std::path::Path;
use zip::ZipWriter;

/// States gathered along a run.
#[derive(Clone, Debug, Default)]
pub struct Snapshots {
    every: usize,
    coordinates: usize,
    times: Vec<f64>,
    positions: Vec<f64>,
    momenta: Vec<f64>,
}

impl Snapshots {
    /// Every how many steps a state of this many coordinates is kept.
    pub fn new(every: usize, coordinates: usize) -> Self {
        Self { every: every.max(1), coordinates, ..Self::default() }
    }

    /// Bytes that all of them take over a number of steps.
    pub fn bytes(every: usize, coordinates: usize, steps: usize) -> usize {
        // The archive is put together in memory.
        (steps / every.max(1) + 1).saturating_mul(2 * coordinates + 1).saturating_mul(2 * size_of::<f64>())
    }

    /// Every how many steps a state is kept.
    pub fn every(&self) -> usize {
        self.every
    }

    /// Keeps a state.
    pub fn take(&mut self, time: f64, position: &[f64], momentum: &[f64]) {
        self.times.push(time);
        self.positions.extend(position);
        self.momenta.extend(momentum);
    }

    /// Times, and the positions at them one after another.
    pub fn positions(&self) -> (&[f64], &[f64]) {
        (&self.times, &self.positions)
    }

    /// Writes an archive with `t`, and `q` and `p` with a row for each time.
    ///
    /// # Errors
    /// If that fails; the file that was there before then still is.
    pub(crate) fn write(&self, path: &Path) -> Result<(), FileError> {
        let bytes = self.archive().map_err(FileError::at(path))?;
        write(path, |file| file.write_all(&bytes))
    }

    fn archive(&self) -> io::Result<Vec<u8>> {
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        let width = Some(self.coordinates);
        for (name, columns, numbers) in
            [("t", None, &self.times), ("q", width, &self.positions), ("p", width, &self.momenta)]
        {
            begin_array(&mut archive, name)?;
            archive.write_all(&head(Kind::Number, self.times.len() as u64, columns))?;
            for numbers in numbers.chunks(1 << 13) {
                let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
                archive.write_all(&bytes)?;
            }
        }
        Ok(archive.finish().map_err(io::Error::other)?.into_inner())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numpy_arrays_hold_the_states() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("snapshots.npz");
        let mut snapshots = Snapshots::new(2, 2);
        for x in [0.0, 2.0] {
            snapshots.take(0.5 * x, &[x, -x], &[2.0 * x, 0.0]);
        }
        snapshots.write(&path).unwrap();
        let mut archive = zip::ZipArchive::new(std::fs::File::open(path).unwrap()).unwrap();
        let mut array = |name: &str| {
            let mut bytes = Vec::new();
            io::Read::read_to_end(&mut archive.by_name(name).unwrap(), &mut bytes).unwrap();
            crate::language::npy::read(&bytes).unwrap()
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
