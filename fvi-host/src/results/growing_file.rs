//! Files that grow over a whole run, and that another process may continue.

use crate::results::files::replaced_permissions;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Length of a growing file at some moment: number of bytes behind its head, and their checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Mark {
    /// Bytes behind the head.
    pub(crate) length: u64,
    /// CRC-32 of them.
    checksum: u32,
}

/// A file that grows beside its destination, under the destination's name with `.part`.
///
/// It has a head of fixed length (often 0) that may be rewritten at any time. It is removed when dropped
/// unless [`keep`](Self::keep) or [`commit`](Self::commit) was called.
pub(crate) struct GrowingFile {
    file: File,
    part: PathBuf,
    destination: PathBuf,
    buffer: Vec<u8>,
    written: u64,
    hasher: crc32fast::Hasher,
    kept: bool,
}

/// Size of the write buffer in bytes.
const BUFFER: usize = 1 << 16;

impl GrowingFile {
    /// An empty file with a head of `head` zero bytes.
    pub(crate) fn begin(destination: &Path, head: u64) -> io::Result<Self> {
        let replaced = replaced_permissions(destination)?;
        let (part, file) = new_part(destination)?;
        let destination = destination.to_owned();
        let kept = false;
        let hasher = crc32fast::Hasher::new();
        let mut this =
            Self { file, part, destination, buffer: Vec::with_capacity(BUFFER), written: 0, hasher, kept };
        if let Some(permissions) = replaced {
            this.file.set_permissions(permissions)?;
        }
        this.write_head(&vec![0; head as usize])?;
        Ok(this)
    }

    /// Continues behind a mark: in the part file, if it contains the marked bytes, otherwise in a copy of the
    /// file that `whole` opens.
    ///
    /// # Errors
    /// If neither contains the marked bytes.
    pub(crate) fn resume(
        destination: &Path,
        head: u64,
        mark: &Mark,
        whole: impl FnOnce() -> io::Result<Box<dyn Read>>,
    ) -> io::Result<Self> {
        replaced_permissions(destination)?;
        let destination = destination.to_owned();
        let mut opened = open_part(&destination, true);
        let held = match &mut opened {
            Some((_, file)) => holds(file, head, mark)?,
            None => false,
        };
        let (part, file) = match opened {
            Some((part, file)) if held => {
                file.set_len(head + mark.length)?;
                (part, file)
            }
            _ => {
                let mut whole = whole()?;
                let (part, mut file) = new_part(&destination)?;
                io::copy(&mut (&mut whole).take(head + mark.length), &mut file)?;
                (part, file)
            }
        };
        let mut this = Self {
            file,
            part,
            destination,
            buffer: Vec::with_capacity(BUFFER),
            written: mark.length,
            hasher: crc32fast::Hasher::new_with_initial_len(mark.checksum, mark.length),
            kept: true,
        };
        this.file.seek(SeekFrom::End(0))?;
        Ok(this)
    }

    /// True if the part file, or the file that `whole` opens, contains the marked bytes. Changes nothing.
    pub(crate) fn can_resume(
        destination: &Path,
        head: u64,
        mark: &Mark,
        whole: impl FnOnce() -> io::Result<Box<dyn Read>>,
    ) -> bool {
        let held = |file: Box<dyn Read>| holds(&mut { file }, head, mark).unwrap_or(false);
        let part = || Some(Box::new(open_part(destination, false)?.1) as Box<dyn Read>);
        replaced_permissions(destination).is_ok() && (part().is_some_and(held) || whole().is_ok_and(held))
    }

    /// Flushes to the disk and returns a mark of the current length.
    pub(crate) fn mark(&mut self) -> io::Result<Mark> {
        self.flush()?;
        self.file.sync_data()?;
        Ok(Mark { length: self.written, checksum: self.hasher.clone().finalize() })
    }

    /// Writes the head.
    pub(crate) fn write_head(&mut self, head: &[u8]) -> io::Result<()> {
        self.file.rewind()?;
        self.file.write_all(head)?;
        self.file.seek(SeekFrom::End(0))?;
        Ok(())
    }

    /// Number of bytes behind the head that have been written to the file, without those in the buffer.
    pub(crate) fn written(&self) -> u64 {
        self.written
    }

    /// From now on the part file is kept when this is dropped.
    pub(crate) fn keep(&mut self) {
        self.kept = true;
    }

    /// Renames the file to its destination.
    pub(crate) fn commit(mut self) -> io::Result<()> {
        self.flush()?;
        self.file.sync_all()?;
        fs::rename(&self.part, &self.destination)?;
        self.kept = true;
        Ok(())
    }

    /// Flushes the part file and opens it for reading; it is removed when the second returned value is
    /// dropped.
    pub(crate) fn reread(mut self) -> io::Result<(File, Self)> {
        self.flush()?;
        let file = File::open(&self.part)?;
        Ok((file, self))
    }

    /// Lets the part file be removed when this is dropped, even after [`keep`](Self::keep).
    pub(crate) fn discard(&mut self) {
        self.kept = false;
    }
}

/// Writes go through a buffer of [`BUFFER`] bytes.
impl Write for GrowingFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.buffer.len() + bytes.len() > BUFFER {
            self.flush()?;
        }
        self.buffer.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.write_all(&self.buffer)?;
        self.hasher.update(&self.buffer);
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }
}

impl Drop for GrowingFile {
    fn drop(&mut self) {
        if !self.kept {
            let _ = fs::remove_file(&self.part);
        }
    }
}

/// Path of the part file.
fn part_of(destination: &Path) -> PathBuf {
    let mut name = destination.as_os_str().to_owned();
    name.push(".part");
    PathBuf::from(name)
}

/// A new, empty part file in place of whatever file or link has its name.
fn new_part(destination: &Path) -> io::Result<(PathBuf, File)> {
    let part = part_of(destination);
    match fs::remove_file(&part) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let file = OpenOptions::new().write(true).create_new(true).open(&part)?;
    Ok((part, file))
}

/// The part file of an earlier run, opened for reading and, if `write`, for writing; a link is none.
fn open_part(destination: &Path, write: bool) -> Option<(PathBuf, File)> {
    let part = part_of(destination);
    // Before it is opened: a pipe would wait for its other end.
    if !fs::symlink_metadata(&part).is_ok_and(|there| there.is_file()) {
        return None;
    }
    let file = OpenOptions::new().read(true).write(write).open(&part).ok()?;
    Some((part, file))
}

/// True if a file contains the marked bytes.
fn holds(file: &mut impl Read, head: u64, mark: &Mark) -> io::Result<bool> {
    let skipped = io::copy(&mut file.by_ref().take(head), &mut io::sink())?;
    let mut rest = file.take(mark.length);
    let (mut hasher, mut length) = (crc32fast::Hasher::new(), 0);
    let mut buffer = vec![0; BUFFER];
    loop {
        match rest.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => {
                hasher.update(&buffer[..count]);
                length += count as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(skipped == head && length == mark.length && hasher.finalize() == mark.checksum)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nothing() -> io::Result<Box<dyn Read>> {
        Err(io::ErrorKind::NotFound.into())
    }

    #[test]
    fn a_file_goes_on_behind_its_mark() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("table");
        let mut file = GrowingFile::begin(&path, 2).unwrap();
        file.write_all(b"one").unwrap();
        let mark = file.mark().unwrap();
        file.write_all(b"lost").unwrap();
        file.flush().unwrap();
        file.keep();
        drop(file);
        assert!(!path.exists());
        assert!(GrowingFile::can_resume(&path, 2, &mark, nothing));
        let mut file = GrowingFile::resume(&path, 2, &mark, nothing).unwrap();
        file.write_head(b"<>").unwrap();
        file.write_all(b"two").unwrap();
        let later = file.mark().unwrap();
        file.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"<>onetwo");

        // A completed file can be continued as well, and is unchanged until the new one is committed.
        let whole = || Ok(Box::new(File::open(&path)?) as Box<dyn Read>);
        assert!(GrowingFile::can_resume(&path, 2, &later, whole));
        let mut file = GrowingFile::resume(&path, 2, &mark, whole).unwrap();
        file.write_all(b"three").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"<>onetwo");
        file.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"<>onethree");

        // The marked bytes no longer exist.
        fs::write(&path, b"<>one").unwrap();
        assert!(!GrowingFile::can_resume(&path, 2, &later, whole));
        fs::write(&path, b"<>onetWo").unwrap();
        assert!(!GrowingFile::can_resume(&path, 2, &later, whole));
    }

    #[test]
    fn a_file_that_is_given_up_leaves_nothing_behind() {
        let directory = tempfile::tempdir().unwrap();
        let mut file = GrowingFile::begin(&directory.path().join("table"), 0).unwrap();
        file.write_all(b"one").unwrap();
        drop(file);
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 0);
    }
}
