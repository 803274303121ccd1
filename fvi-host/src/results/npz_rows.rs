//! Rows of states as NumPy arrays: each grows in a file of its own, and all are finally joined in one
//! archive.

use crate::results::files;
use crate::results::growing_file::{GrowingFile, Mark};
use crate::results::numpy::{self, HEAD, Kind};
use rawzip::{CompressionMethod, RECOMMENDED_BUFFER_SIZE, ZipArchive};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Arrays, each in a part file that `np.load` can open at any time, since its head contains the number of
/// rows written.
pub(crate) struct NpzRows {
    path: PathBuf,
    arrays: Vec<Array>,
}

/// Name and shape of an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shape {
    pub(crate) name: &'static str,
    /// Number of columns of a matrix; `None` for a vector.
    pub(crate) columns: Option<usize>,
}

/// The arrays of states with `coordinates` coordinates: `t`, `q`, `p`.
pub(crate) fn states(coordinates: usize) -> [Shape; 3] {
    let columns = Some(coordinates);
    [Shape { name: "t", columns: None }, Shape { name: "q", columns }, Shape { name: "p", columns }]
}

/// The arrays of the states of an equation with `unknowns` unknowns: `t`, `x`.
pub(crate) fn unknowns(unknowns: usize) -> [Shape; 2] {
    [Shape { name: "t", columns: None }, Shape { name: "x", columns: Some(unknowns) }]
}

struct Array {
    shape: Shape,
    file: GrowingFile,
    /// Number of bytes behind the head that the head accounts for.
    counted: u64,
}

impl NpzRows {
    /// Arrays without rows.
    pub(crate) fn create(path: &Path, arrays: &[Shape]) -> io::Result<Self> {
        Self::with_files(path, arrays, |name| GrowingFile::begin(&array_path(path, name), HEAD))
    }

    /// Continues behind marks.
    pub(crate) fn resume(path: &Path, arrays: &[Shape], marks: &[Mark]) -> io::Result<Self> {
        let mut marks = marks.iter();
        Self::with_files(path, arrays, |name| {
            let mark = marks.next().ok_or(io::ErrorKind::InvalidData)?;
            GrowingFile::resume(&array_path(path, name), HEAD, mark, || member(path, name))
        })
    }

    fn with_files(
        path: &Path,
        arrays: &[Shape],
        mut file: impl FnMut(&str) -> io::Result<GrowingFile>,
    ) -> io::Result<Self> {
        let mut array = |&shape: &Shape| -> io::Result<Array> {
            let mut array = Array { shape, file: file(shape.name)?, counted: 0 };
            array.write_head()?;
            Ok(array)
        };
        let arrays = arrays.iter().map(&mut array).collect::<io::Result<_>>()?;
        Ok(Self { path: path.to_owned(), arrays })
    }

    /// The names of the arrays.
    pub(crate) fn names(&self) -> impl Iterator<Item = &'static str> {
        self.arrays.iter().map(|array| array.shape.name)
    }

    /// Appends a row: the numbers of each array.
    pub(crate) fn push<'a>(&mut self, row: impl IntoIterator<Item = &'a [f64]>) -> io::Result<()> {
        self.arrays.iter_mut().zip(row).try_for_each(|(array, numbers)| array.push(numbers))
    }

    pub(crate) fn mark(&mut self) -> io::Result<Vec<Mark>> {
        self.arrays.iter_mut().map(|array| array.mark()).collect()
    }

    pub(crate) fn keep(&mut self) {
        self.arrays.iter_mut().for_each(|array| array.file.keep());
    }

    /// Joins the arrays in the archive.
    pub(crate) fn finish(self) -> io::Result<()> {
        let mut archive = numpy::Archive::new(files::begin(&self.path)?);
        let mut parts = Vec::new();
        for mut array in self.arrays {
            let name = array.shape.name;
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

    /// Writes the number of rows into the heads.
    fn write_head(&mut self) -> io::Result<()> {
        self.counted = self.file.written();
        let row = 8 * self.shape.columns.unwrap_or(1).max(1) as u64;
        self.file.write_head(&numpy::head(Kind::Number, self.counted / row, self.shape.columns))
    }
}

/// True if part files or archive contain the marked rows of the arrays with these names.
pub(crate) fn can_resume(path: &Path, names: &[impl AsRef<str>], marks: &[Mark]) -> bool {
    let is_there = |(mark, name): (&Mark, &str)| {
        GrowingFile::can_resume(&array_path(path, name), HEAD, mark, || member(path, name))
    };
    marks.len() == names.len() && marks.iter().zip(names.iter().map(AsRef::as_ref)).all(is_there)
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

/// Path of the file of a single array.
fn array_path(path: &Path, name: &str) -> PathBuf {
    path.with_extension(format!("{name}.npy"))
}

/// Opens an array of the archive.
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
