//! NumPy's files: `.npy` arrays and `.npz` archives of them.

use crate::results::files::NewFile;
use crc32fast::Hasher;
use rawzip::{DataDescriptorOutput, ZipArchiveWriter};
use std::io::{self, BufWriter, Write};

/// Length in bytes of the head of an array, fixed so that the head can be rewritten when rows have been
/// added.
pub(crate) const HEAD: u64 = 128;

/// Type of the numbers of an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// f64.
    Number,
    /// i64.
    Whole,
    /// Texts with at most this number of characters, as UTF-32 padded with zeros.
    Text(usize),
}

/// The head of an array of version 1.0 of the format.
///
/// `columns` is `None` for a vector.
pub(crate) fn head(kind: Kind, rows: u64, columns: Option<usize>) -> Vec<u8> {
    let kind = match kind {
        Kind::Number => "<f8".to_owned(),
        Kind::Whole => "<i8".to_owned(),
        Kind::Text(length) => format!("<U{}", length.max(1)),
    };
    let shape = columns.map_or(format!("({rows},)"), |columns| format!("({rows}, {columns})"));
    let mut head = Vec::from(b"\x93NUMPY\x01\x00");
    head.extend((HEAD as u16 - 10).to_le_bytes());
    head.extend(format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}").as_bytes());
    head.resize(HEAD as usize - 1, b' ');
    head.push(b'\n');
    head
}

/// An archive of arrays that is being written.
pub(crate) type Archive = ZipArchiveWriter<NewFile>;

/// Writes an array, head included, into an archive, without compression and without a date.
pub(crate) fn write_array(
    archive: &mut Archive,
    name: &str,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let (entry, _) = archive.new_file(format!("{name}.npy")).start().map_err(io::Error::other)?;
    let mut summed = BufWriter::new(Summed { inner: entry, checksum: Hasher::new(), bytes: 0 });
    content(&mut summed)?;
    let Summed { inner, checksum, bytes } = summed.into_inner().map_err(io::IntoInnerError::into_error)?;
    inner.finish(DataDescriptorOutput::new(checksum.finalize(), bytes)).map_err(io::Error::other)?;
    Ok(())
}

/// A writer that counts bytes and computes their checksum.
struct Summed<W> {
    inner: W,
    checksum: Hasher,
    bytes: u64,
}

impl<W: Write> Write for Summed<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.inner.write(bytes)?;
        self.checksum.update(&bytes[..count]);
        self.bytes += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_head_is_what_numpy_writes() {
        let head = head(Kind::Number, 12, Some(3));
        assert_eq!(head.len(), 128);
        assert_eq!(head[..10], *b"\x93NUMPY\x01\x00\x76\x00");
        let text = std::str::from_utf8(&head[10..]).unwrap();
        assert!(text.starts_with("{'descr': '<f8', 'fortran_order': False, 'shape': (12, 3), }"), "{text}");
        assert!(text.ends_with('\n'));
    }
}
