//! Files of results: each appears atomically, and an error names its file.

#[cfg(feature = "pictures")]
use crate::results::picture::Chart;
use serde::Serialize;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{self, SyncSender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// A file of results, or a directory for them, could not be written or created.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", .path.display())]
pub struct FileError {
    /// The file or directory.
    pub path: PathBuf,
    /// Message of the system, the plotting library or the serialiser.
    pub source: io::Error,
}

impl FileError {
    /// A function that makes an error about `path` of an I/O error.
    pub(crate) fn at(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        |source| Self { path: path.to_owned(), source: explained(path, source) }
    }
}

/// Explains in an error that the directory of a file has been removed since the file was begun.
fn explained(path: &Path, error: io::Error) -> io::Error {
    match path.parent() {
        Some(directory) if error.kind() == io::ErrorKind::NotFound && !exists(directory) => io::Error::new(
            io::ErrorKind::NotFound,
            format!("the directory {} is not there, or no longer ({error})", directory.display()),
        ),
        _ => error,
    }
}

fn exists(directory: &Path) -> bool {
    directory.as_os_str().is_empty() || directory.exists()
}

/// A file that is being written beside its destination.
pub type NewFile = BufWriter<PartFile>;

/// The file beside the destination. It is locked as long as the process that writes it lives, and removed
/// unless it is committed.
pub struct PartFile {
    file: File,
    part: PathBuf,
    destination: PathBuf,
    committed: bool,
    /// Bytes written since the last order to flush to the disk.
    waiting: usize,
    helper: Option<DiskHelper>,
}

/// A thread that flushes the beginning of a large file to the disk while the rest is being written.
struct DiskHelper {
    orders: SyncSender<()>,
    thread: JoinHandle<()>,
}

impl DiskHelper {
    /// Number of bytes between two flushes.
    const AFTER: usize = 8 << 20;

    fn of(file: &File) -> io::Result<Self> {
        let file = file.try_clone()?;
        // While one flush is in progress one more order can wait; further orders are covered by it.
        let (orders, received) = mpsc::sync_channel(1);
        let thread = thread::Builder::new().spawn(move || {
            for () in received {
                // An error here occurs again when the file is complete, and is reported then.
                let _ = file.sync_data();
            }
        })?;
        Ok(Self { orders, thread })
    }
}

/// Ending of the names of files that are being written.
const PART_ENDING: &str = ".fvi-part";

/// Permissions of the file that one written to `destination` replaces, if there is one.
///
/// A link is replaced itself, and what it refers to stays as it is: whoever can put a link into an output
/// directory cannot make a run write anywhere else.
///
/// # Errors
/// If something else than a file or a link is there: a directory, a device, a pipe.
pub(crate) fn replaced_permissions(destination: &Path) -> io::Result<Option<fs::Permissions>> {
    match fs::symlink_metadata(destination) {
        Ok(there) if there.is_file() => Ok(Some(there.permissions())),
        Ok(there) if !there.is_symlink() => {
            Err(io::Error::other("not a regular file, and not replaced by one"))
        }
        _ => Ok(None),
    }
}

/// Opens a file of an output directory to read and write it where it lies, creating it if it is not there.
/// What has its name but is no regular file, a link for instance, is replaced by a new file.
pub(crate) fn open_in_place(path: &Path) -> io::Result<File> {
    replaced_permissions(path)?;
    if fs::symlink_metadata(path).is_ok_and(|there| there.is_symlink()) {
        fs::remove_file(path)?;
    }
    OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)
}

impl PartFile {
    fn beside(destination: &Path) -> io::Result<Self> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let replaced = replaced_permissions(destination)?;
        let destination = destination.to_owned();
        loop {
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            let name = format!(".{}-{count}{PART_ENDING}", std::process::id());
            let part = destination.with_file_name(name);
            let file = match OpenOptions::new().write(true).create_new(true).open(&part) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                file => file?,
            };
            // On file systems without locks (some network file systems) the part file remains if the process
            // is killed.
            let _ = file.lock();
            if !part.exists() {
                // Between creation and lock another process has removed it as abandoned.
                continue;
            }
            if let Some(permissions) = replaced {
                file.set_permissions(permissions)?;
            }
            return Ok(Self { file, part, destination, committed: false, waiting: 0, helper: None });
        }
    }

    /// Flushes what was written to the disk.
    pub(crate) fn sync(&mut self) -> io::Result<()> {
        if let Some(DiskHelper { orders, thread }) = self.helper.take() {
            drop(orders);
            // If the helper failed, `sync_all` below does its work.
            let _ = thread.join();
        }
        self.file.sync_all()
    }

    /// Renames the file to its destination.
    fn commit(mut self) -> io::Result<()> {
        self.sync()?;
        fs::rename(&self.part, &self.destination)?;
        self.committed = true;
        Ok(())
    }
}

impl Write for PartFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.waiting += written;
        if self.waiting >= DiskHelper::AFTER {
            self.waiting = 0;
            if self.helper.is_none() {
                self.helper = DiskHelper::of(&self.file).ok();
            }
            if let Some(helper) = &self.helper {
                let _ = helper.orders.try_send(());
            }
        }
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for PartFile {
    fn seek(&mut self, place: SeekFrom) -> io::Result<u64> {
        self.file.seek(place)
    }
}

impl Drop for PartFile {
    fn drop(&mut self) {
        if !self.committed {
            let _ = fs::remove_file(&self.part);
        }
    }
}

/// Locks a file against other processes, and says if another one has it.
///
/// What a program has locked and given back stays locked for as long as a child that it has just forked has
/// not begun its own program: a lock that is taken is tried again for a moment.
pub(crate) fn lock(file: &File) -> Result<(), TryLockError> {
    const TRIALS: usize = 20;
    const PAUSE: Duration = Duration::from_millis(10);
    for _ in 1..TRIALS {
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => thread::sleep(PAUSE),
            other => return other,
        }
    }
    file.try_lock()
}

/// Removes the unfinished files that killed processes have left in a directory: those that no process has
/// locked.
pub(crate) fn remove_abandoned_parts(directory: &Path) {
    let directory = if directory.as_os_str().is_empty() { Path::new(".") } else { directory };
    let Ok(entries) = fs::read_dir(directory) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let ours = name.to_str().is_some_and(|name| name.starts_with('.') && name.ends_with(PART_ENDING));
        if ours
            && entry.file_type().is_ok_and(|kind| kind.is_file())
            && OpenOptions::new().write(true).open(entry.path()).is_ok_and(|file| file.try_lock().is_ok())
        {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Begins a file; it appears at its destination with [`commit`].
pub(crate) fn begin(path: &Path) -> io::Result<NewFile> {
    Ok(BufWriter::with_capacity(1 << 16, PartFile::beside(path)?))
}

/// Renames a completed file to its destination.
pub(crate) fn commit(file: NewFile) -> io::Result<()> {
    file.into_inner().map_err(io::IntoInnerError::into_error)?.commit()
}

/// Writes a file with `write`, and commits it.
///
/// # Errors
/// [`FileError`] if it cannot be written; an existing file is then unchanged.
pub fn write(path: &Path, content: impl FnOnce(&mut NewFile) -> io::Result<()>) -> Result<(), FileError> {
    let write = || {
        let mut file = begin(path)?;
        content(&mut file)?;
        commit(file)
    };
    write().map_err(FileError::at(path))
}

/// Writes to a path that the user has named himself: the file that it refers to atomically, through links; a
/// device, pipe or terminal directly, as a shell would.
///
/// # Errors
/// [`FileError`] if it cannot be opened or written; an existing file is then unchanged.
pub fn write_out(
    path: &Path,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), FileError> {
    if fs::metadata(path).is_ok_and(|there| !there.is_file()) {
        let write = || {
            let mut file = BufWriter::new(OpenOptions::new().write(true).open(path)?);
            content(&mut file)?;
            file.flush()
        };
        return write().map_err(FileError::at(path));
    }
    let destination = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    remove_abandoned_parts(destination.parent().unwrap_or(Path::new("")));
    write(&destination, |file| content(file))
}

/// Removes a file of an earlier run that would contradict those of this one.
///
/// # Errors
/// [`FileError`] if it exists and cannot be removed.
pub fn remove(path: &Path) -> Result<(), FileError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(FileError::at(path)(error)),
        _ => Ok(()),
    }
}

/// Writes a text atomically.
///
/// # Errors
/// [`FileError`] if it cannot be written; an existing file is then unchanged.
pub fn write_text(path: &Path, text: &str) -> Result<(), FileError> {
    write(path, |file| file.write_all(text.as_bytes()))
}

/// Writes a record as JSON.
///
/// # Errors
/// [`FileError`] if it cannot be written; an existing file is then unchanged.
pub fn write_json(path: &Path, record: &impl Serialize) -> Result<(), FileError> {
    write(path, |file| {
        serde_json::to_writer_pretty(&mut *file, record)?;
        file.write_all(b"\n")
    })
}

/// Draws a picture and writes it as SVG, atomically.
///
/// # Errors
/// [`FileError`] if it cannot be drawn or written; an existing file is then unchanged.
#[cfg(feature = "pictures")]
pub fn write_picture(path: &Path, chart: &Chart) -> Result<(), FileError> {
    let svg = chart.to_svg().map_err(io::Error::other).map_err(FileError::at(path))?;
    write_text(path, &svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(directory: &Path) -> Vec<String> {
        let entries = fs::read_dir(directory).unwrap();
        let mut names: Vec<_> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn parts_of_dead_processes_are_removed_and_those_of_living_ones_are_not() {
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        let living = begin(&path("table.csv")).unwrap();
        fs::write(path(".123-0.fvi-part"), "half a").unwrap();
        fs::write(path(".123-0.other-part"), "another program's").unwrap();
        remove_abandoned_parts(directory.path());
        assert_eq!(names(directory.path()).len(), 2);
        commit(living).unwrap();
        assert_eq!(names(directory.path()), [".123-0.other-part", "table.csv"]);
    }

    #[test]
    fn a_file_that_is_given_up_leaves_the_old_one_alone() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("table.csv");
        write_text(&path, "old").unwrap();
        let failed = write(&path, |file| {
            file.write_all(b"new")?;
            Err(io::Error::other("no more"))
        });
        assert!(failed.is_err());
        assert_eq!(names(directory.path()), ["table.csv"]);
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
    }

    #[test]
    fn a_directory_that_is_gone_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let inner = directory.path().join("inner");
        fs::create_dir(&inner).unwrap();
        let path = inner.join("table.csv");
        let failed = write(&path, |_| fs::remove_dir_all(&inner)).unwrap_err();
        assert!(failed.to_string().contains("is not there, or no longer"), "{failed}");
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_replaced_but_followed_where_the_user_named_it_and_what_is_no_file_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        write_text(&path("file"), "old").unwrap();
        std::os::unix::fs::symlink(path("file"), path("link")).unwrap();
        write_out(&path("link"), |out| out.write_all(b"new")).unwrap();
        assert_eq!(fs::read_to_string(path("file")).unwrap(), "new");
        assert!(fs::symlink_metadata(path("link")).unwrap().is_symlink());
        write_text(&path("link"), "newest").unwrap();
        assert_eq!(fs::read_to_string(path("file")).unwrap(), "new");
        assert_eq!(fs::read_to_string(path("link")).unwrap(), "newest");
        assert!(!fs::symlink_metadata(path("link")).unwrap().is_symlink());

        std::os::unix::fs::symlink("/dev/null", path("device")).unwrap();
        write_out(&path("device"), |out| out.write_all(b"new")).unwrap();
        assert!(write_text(Path::new("/dev/null"), "new").is_err());
        let _socket = std::os::unix::net::UnixListener::bind(path("socket")).unwrap();
        assert!(write_out(&path("socket"), |out| out.write_all(b"new")).is_err());
        assert!(write_text(&path("socket"), "new").is_err());
        assert_eq!(names(directory.path()), ["device", "file", "link", "socket"]);
    }
}
