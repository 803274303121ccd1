//! Rows of states as NumPy reads them: arrays that grow side by side and become one archive.

use crate::results::files;
use crate::results::growing_file::{GrowingFile, Mark};
use crate::results::numpy::{self, HEAD, Kind};
use rawzip::{CompressionMethod, RECOMMENDED_BUFFER_SIZE, ZipArchive};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Times, positions, momenta and, in some archives, energies and what controllers saw and put out, in the
/// order of the archive.
const NAMES: [&str; 7] = ["t", "q", "p", "energy", "u", "setpoint", "measure"];

/// Arrays, each in a part that `np.load` opens at any time: its head counts the rows that are written.
pub(crate) struct NpzRows {
    path: PathBuf,
    arrays: Vec<Array>,
}

/// Which of the arrays there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrays {
    /// `t`, `q`, `p`.
    States,
    /// These and `energy`.
    WithEnergies,
    /// These and `u`, `setpoint` and `measure` of so many controllers.
    WithControl(usize),
}

impl Arrays {
    /// Those of a trajectory with so many controllers.
    pub(crate) fn of_rows(controllers: usize) -> Self {
        if controllers == 0 { Self::WithEnergies } else { Self::WithControl(controllers) }
    }

    fn count(self) -> usize {
        match self {
            Self::States => 3,
            Self::WithEnergies => 4,
            Self::WithControl(_) => 7,
        }
    }
}

struct Array {
    name: &'static str,
    file: GrowingFile,
    /// Columns, if it is a matrix.
    columns: Option<usize>,
    /// Bytes behind the head when the head was written.
    counted: u64,
}

impl NpzRows {
    /// Arrays without rows.
    pub(crate) fn create(path: &Path, arrays: Arrays, coordinates: usize) -> io::Result<Self> {
        Self::with_files(path, arrays, coordinates, |name| GrowingFile::begin(&array_path(path, name), HEAD))
    }

    /// Goes on behind marks.
    pub(crate) fn resume(
        path: &Path,
        arrays: Arrays,
        coordinates: usize,
        marks: &[Mark],
    ) -> io::Result<Self> {
        let mut marks = marks.iter();
        Self::with_files(path, arrays, coordinates, |name| {
            let mark = marks.next().ok_or(io::ErrorKind::InvalidData)?;
            GrowingFile::resume(&array_path(path, name), HEAD, mark, || member(path, name))
        })
    }

    fn with_files(
        path: &Path,
        arrays: Arrays,
        coordinates: usize,
        mut file: impl FnMut(&str) -> io::Result<GrowingFile>,
    ) -> io::Result<Self> {
        let mut array = |name: &'static str| -> io::Result<Array> {
            let columns = match (name, arrays) {
                ("q" | "p", _) => Some(coordinates),
                ("u" | "setpoint" | "measure", Arrays::WithControl(several @ 2..)) => Some(several),
                _ => None,
            };
            let mut array = Array { name, file: file(name)?, columns, counted: 0 };
            array.write_head()?;
            Ok(array)
        };
        let arrays = NAMES.into_iter().take(arrays.count()).map(&mut array).collect::<io::Result<_>>()?;
        Ok(Self { path: path.to_owned(), arrays })
    }

    /// Takes a row: time, position, momentum, and energy and what controllers have where there are arrays for
    /// them.
    pub(crate) fn push(&mut self, row: [&[f64]; 7]) -> io::Result<()> {
        self.arrays.iter_mut().zip(row).try_for_each(|(array, numbers)| array.push(numbers))
    }

    pub(crate) fn mark(&mut self) -> io::Result<Vec<Mark>> {
        self.arrays.iter_mut().map(|array| array.mark()).collect()
    }

    pub(crate) fn keep(&mut self) {
        self.arrays.iter_mut().for_each(|array| array.file.keep());
    }

    /// Puts the arrays together into the archive.
    pub(crate) fn finish(self) -> io::Result<()> {
        let mut archive = numpy::Archive::new(files::begin(&self.path)?);
        let mut parts = Vec::new();
        for mut array in self.arrays {
            let name = array.name;
            array.file.flush()?;
            array.write_head()?;
            let (mut file, part) = array.file.reread()?;
            numpy::write_array(&mut archive, name, |array| io::copy(&mut file, array).map(drop))?;
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

/// Whether parts or archive hold what was marked: arrays of states, with energies, or with controllers.
pub(crate) fn can_resume(path: &Path, marks: &[Mark]) -> bool {
    matches!(marks.len(), 3 | 4 | 7)
        && marks.iter().zip(NAMES).all(|(mark, name)| {
            GrowingFile::can_resume(&array_path(path, name), HEAD, mark, || member(path, name))
        })
}

/// The numbers of an array of a finished archive, `columns` at a time.
#[cfg_attr(not(any(feature = "pictures", test)), expect(dead_code, reason = "maps are drawn from them"))]
pub(crate) fn read_rows(
    path: &Path,
    name: &str,
    columns: usize,
) -> io::Result<impl Iterator<Item = io::Result<Vec<f64>>>> {
    let mut file = BufReader::new(member(path, name)?);
    io::copy(&mut file.by_ref().take(HEAD), &mut io::sink())?;
    let mut bytes = vec![0; columns.max(1) * size_of::<f64>()];
    Ok(std::iter::from_fn(move || match file.read_exact(&mut bytes) {
        Ok(()) => Some(Ok(bytes.as_chunks().0.iter().map(|&number| f64::from_le_bytes(number)).collect())),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => None,
        Err(error) => Some(Err(error)),
    }))
}

/// Where an array would be if it stood by itself.
fn array_path(path: &Path, name: &str) -> PathBuf {
    path.with_extension(format!("{name}.npy"))
}

/// An array of the archive.
fn member(path: &Path, name: &str) -> io::Result<Box<dyn Read>> {
    let mut file = BufReader::new(File::open(path)?);
    let mut buffer = vec![0; RECOMMENDED_BUFFER_SIZE];
    let archive =
        ZipArchive::from_file(file.get_ref().try_clone()?, &mut buffer).map_err(io::Error::other)?;
    let name = format!("{name}.npy");
    let mut entries = archive.entries(&mut buffer);
    while let Some(entry) = entries.next_entry().map_err(io::Error::other)? {
        let is_stored = entry.compression_method() == CompressionMethod::STORE;
        if is_stored && entry.file_path().as_ref() == name.as_bytes() {
            let content = archive.get_entry(entry.wayfinder()).map_err(io::Error::other)?;
            let (start, end) = content.compressed_data_range();
            file.seek(SeekFrom::Start(start))?;
            return Ok(Box::new(file.take(end.saturating_sub(start))));
        }
    }
    Err(io::ErrorKind::NotFound.into())
}
