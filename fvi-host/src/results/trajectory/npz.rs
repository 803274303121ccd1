//! The rows of `trajectory.npz`: four arrays that grow side by side and become one archive.

use crate::results::files;
use crate::results::growing_file::{GrowingFile, Mark};
use crate::results::numpy::{self, HEAD, Kind};
use crate::simulation::GridState;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use zip::ZipArchive;

/// The arrays in the order of the archive.
const NAMES: [&str; 4] = ["t", "q", "p", "energy"];

/// Four arrays, each in a part that `np.load` opens at any time: its head counts the rows that are written.
pub(super) struct NpzRows {
    path: PathBuf,
    arrays: [Array; 4],
}

struct Array {
    file: GrowingFile,
    /// Columns, if it is a matrix.
    columns: Option<usize>,
    /// Bytes behind the head when the head was written.
    counted: u64,
}

impl NpzRows {
    pub(super) fn create(path: &Path, coordinates: usize) -> io::Result<Self> {
        Self::with_files(path, coordinates, |index| GrowingFile::begin(&array_path(path, index), HEAD))
    }

    pub(super) fn resume(path: &Path, coordinates: usize, marks: &[Mark]) -> io::Result<Self> {
        Self::with_files(path, coordinates, |index| {
            let mark = marks.get(index).ok_or(io::ErrorKind::InvalidData)?;
            GrowingFile::resume(&array_path(path, index), HEAD, mark, || member(path, index))
        })
    }

    fn with_files(
        path: &Path,
        coordinates: usize,
        file: impl Fn(usize) -> io::Result<GrowingFile>,
    ) -> io::Result<Self> {
        let array = |index: usize, columns| -> io::Result<Array> {
            let mut array = Array { file: file(index)?, columns, counted: 0 };
            array.write_head()?;
            Ok(array)
        };
        let matrix = Some(coordinates);
        let arrays = [array(0, None)?, array(1, matrix)?, array(2, matrix)?, array(3, None)?];
        Ok(Self { path: path.to_owned(), arrays })
    }

    pub(super) fn push(&mut self, state: &GridState) -> io::Result<()> {
        let [t, q, p, energy] = &mut self.arrays;
        t.push(&[state.time])?;
        q.push(&state.position)?;
        p.push(&state.momentum)?;
        energy.push(&[state.energy])
    }

    pub(super) fn mark(&mut self) -> io::Result<Vec<Mark>> {
        self.arrays.iter_mut().map(|array| array.mark()).collect()
    }

    pub(super) fn keep(&mut self) {
        self.arrays.iter_mut().for_each(|array| array.file.keep());
    }

    /// Puts the arrays together into the archive.
    pub(super) fn finish(self) -> io::Result<()> {
        let mut archive = zip::ZipWriter::new(files::begin(&self.path)?);
        let mut parts = Vec::new();
        for (name, mut array) in NAMES.into_iter().zip(self.arrays) {
            array.file.flush()?;
            array.write_head()?;
            let (mut file, part) = array.file.reread()?;
            numpy::begin_array(&mut archive, name)?;
            io::copy(&mut file, &mut archive)?;
            parts.push(part);
        }
        files::commit(archive.finish().map_err(io::Error::other)?)?;
        parts.iter_mut().for_each(GrowingFile::discard);
        Ok(())
    }
}

impl Array {
    fn push(&mut self, numbers: &[f64]) -> io::Result<()> {
        for number in numbers {
            self.file.write_all(&number.to_le_bytes())?;
        }
        if self.file.written() != self.counted { self.write_head() } else { Ok(()) }
    }

    fn mark(&mut self) -> io::Result<Mark> {
        self.file.flush()?;
        self.write_head()?;
        self.file.mark()
    }

    /// Counts the rows that are written.
    fn write_head(&mut self) -> io::Result<()> {
        self.counted = self.file.written();
        let row = 8 * self.columns.unwrap_or(1).max(1) as u64;
        self.file.write_head(&numpy::head(Kind::Number, self.counted / row, self.columns))
    }
}

/// Whether parts or archive hold what was marked.
pub(super) fn can_resume(path: &Path, marks: &[Mark]) -> bool {
    marks.len() == NAMES.len()
        && marks.iter().enumerate().all(|(index, mark)| {
            GrowingFile::can_resume(&array_path(path, index), HEAD, mark, || member(path, index))
        })
}

/// Where an array would be if it stood by itself.
fn array_path(path: &Path, index: usize) -> PathBuf {
    path.with_extension(format!("{}.npy", NAMES.get(index).unwrap_or(&"")))
}

/// An array of the archive.
fn member(path: &Path, index: usize) -> io::Result<Box<dyn Read>> {
    let mut archive = ZipArchive::new(BufReader::new(File::open(path)?)).map_err(io::Error::other)?;
    let name = format!("{}.npy", NAMES.get(index).unwrap_or(&""));
    let (start, size) = {
        let entry = archive.by_name(&name).map_err(io::Error::other)?;
        let start = entry.data_start().ok_or(io::ErrorKind::InvalidData)?;
        (start, entry.size())
    };
    let mut file = archive.into_inner();
    file.seek(SeekFrom::Start(start))?;
    Ok(Box::new(file.take(size)))
}
