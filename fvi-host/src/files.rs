//! Files of results: each appears whole or not at all, and an error names the one it is about.

use crate::picture::Chart;
use atomic_write_file::AtomicWriteFile;
use serde::Serialize;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Why a file of results, or a directory for them, is not there.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", .path.display())]
pub struct FileError {
    /// The file or directory.
    pub path: PathBuf,
    /// What the system, the plotting library or the serialiser says.
    pub source: io::Error,
}

impl FileError {
    /// For one path, what makes an error of it.
    pub(crate) fn at(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        |source| Self { path: path.to_owned(), source }
    }
}

/// Makes a directory and those above it, if they are not there.
pub(crate) fn make_directory(path: &Path) -> Result<(), FileError> {
    std::fs::create_dir_all(path).map_err(FileError::at(path))
}

/// A file that is being written beside its destination.
pub(crate) type NewFile = BufWriter<AtomicWriteFile>;

/// Begins a file; it is not there before [`commit`].
pub(crate) fn begin(path: &Path) -> io::Result<NewFile> {
    Ok(BufWriter::with_capacity(1 << 16, AtomicWriteFile::open(path)?))
}

/// Puts a file that has been written into its place.
pub(crate) fn commit(file: NewFile) -> io::Result<()> {
    file.into_inner().map_err(io::IntoInnerError::into_error)?.commit()
}

/// Writes a file in one go.
pub(crate) fn write(
    path: &Path,
    content: impl FnOnce(&mut NewFile) -> io::Result<()>,
) -> Result<(), FileError> {
    let write = || {
        let mut file = begin(path)?;
        content(&mut file)?;
        commit(file)
    };
    write().map_err(FileError::at(path))
}

/// Writes a text.
pub(crate) fn write_text(path: &Path, text: &str) -> Result<(), FileError> {
    write(path, |file| file.write_all(text.as_bytes()))
}

/// Writes a record as JSON.
pub(crate) fn write_json(path: &Path, record: &impl Serialize) -> Result<(), FileError> {
    write(path, |file| {
        serde_json::to_writer_pretty(&mut *file, record)?;
        file.write_all(b"\n")
    })
}

/// Draws and writes a picture.
pub(crate) fn write_picture(path: &Path, chart: &Chart) -> Result<(), FileError> {
    let svg = chart.to_svg().map_err(io::Error::other).map_err(FileError::at(path))?;
    write_text(path, &svg)
}
