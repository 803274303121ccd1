//! The directory that the files of a run go to, held by one run at a time.

use crate::results::files::{FileError, lock, remove_abandoned_parts};
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// A directory that this process alone writes to.
///
/// The directory itself is locked, so that no lock file remains and the lock ends with the process in any
/// case. Where the system cannot lock a directory (Windows, some network file systems) runs are not protected
/// from each other.
#[derive(Debug)]
pub struct OutputDirectory {
    path: PathBuf,
    /// The directories that were created for it, outermost first.
    made: Vec<PathBuf>,
    lock: Option<File>,
}

impl OutputDirectory {
    /// Creates the directory and its parents if they do not exist, locks it, and removes unfinished files of
    /// killed runs.
    ///
    /// Directories that were created are removed again when the value is dropped, if they are empty.
    ///
    /// # Errors
    /// If it cannot be made, is a file, or another process writes to it ([`refuses`](Self::refuses)).
    pub fn claim(path: &Path) -> Result<Self, FileError> {
        let missing = |path: &&Path| !path.as_os_str().is_empty() && !path.exists();
        let mut made: Vec<PathBuf> = path.ancestors().take_while(missing).map(Path::to_owned).collect();
        made.reverse();
        Self::make(path)?;
        let mut claimed = Self { path: path.to_owned(), made, lock: None };
        let directory = if path.as_os_str().is_empty() { Path::new(".") } else { path };
        if let Ok(file) = File::open(directory) {
            match lock(&file) {
                Ok(()) => claimed.lock = Some(file),
                Err(TryLockError::WouldBlock) => {
                    let reason = "another run is writing to this directory; wait for it, or choose another with `--out`";
                    return Err(FileError::at(path)(io::Error::new(io::ErrorKind::ResourceBusy, reason)));
                }
                Err(TryLockError::Error(_)) => {}
            }
        }
        remove_abandoned_parts(&claimed.path);
        Ok(claimed)
    }

    /// Creates a directory and its parents if they do not exist.
    ///
    /// # Errors
    /// If it cannot be made, or is a file ([`refuses`](Self::refuses)).
    pub(crate) fn make(path: &Path) -> Result<(), FileError> {
        let dangles = |part: &&Path| !part.exists() && part.is_symlink();
        if let Some(link) = path.ancestors().find(dangles) {
            let reason = "a link to what is not there; choose another with `--out`";
            return Err(FileError::at(link)(io::Error::new(io::ErrorKind::NotADirectory, reason)));
        }
        if let Some(file) = path.ancestors().find(|part| part.exists()).filter(|part| !part.is_dir()) {
            let reason = "not a directory, where results go; choose one with `--out`";
            return Err(FileError::at(file)(io::Error::new(io::ErrorKind::NotADirectory, reason)));
        }
        fs::create_dir_all(path).map_err(FileError::at(path))
    }

    /// True if an error means that this path cannot be used: it is not a directory, or another process writes
    /// to it.
    pub fn refuses(error: &FileError) -> bool {
        matches!(error.source.kind(), io::ErrorKind::ResourceBusy | io::ErrorKind::NotADirectory)
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The path of a file in it.
    pub fn join(&self, name: impl AsRef<Path>) -> PathBuf {
        self.path.join(name)
    }
}

impl Drop for OutputDirectory {
    fn drop(&mut self) {
        // Unlocked explicitly: a process that another thread is just starting holds a copy of the open file
        // for a moment.
        if let Some(file) = &self.lock {
            let _ = file.unlock();
        }
        // Directories that are not empty remain.
        self.made.iter().rev().take_while(|path| fs::remove_dir(path).is_ok()).for_each(drop);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_directory_has_one_holder_at_a_time() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("a/b");
        let first = OutputDirectory::claim(&path).unwrap();
        let error = OutputDirectory::claim(&path).unwrap_err();
        assert!(OutputDirectory::refuses(&error) && error.to_string().contains("another run"), "{error}");
        drop(first);
        assert!(OutputDirectory::claim(&path).is_ok());
    }

    #[test]
    fn a_file_is_no_directory_and_stays() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("file");
        fs::write(&file, "mine").unwrap();
        for path in [file.clone(), file.join("below/it")] {
            let error = OutputDirectory::claim(&path).unwrap_err();
            assert!(OutputDirectory::refuses(&error) && error.path == file, "{error}");
        }
        assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
    }

    #[test]
    fn directories_that_were_made_and_stay_empty_are_removed_again() {
        let place = tempfile::tempdir().unwrap();
        let (outer, inner) = (place.path().join("a"), place.path().join("a/b"));
        drop(OutputDirectory::claim(&inner).unwrap());
        assert!(!outer.exists());
        let claimed = OutputDirectory::claim(&inner).unwrap();
        fs::write(claimed.join("table.csv"), "1").unwrap();
        drop(claimed);
        assert!(inner.join("table.csv").exists());
        fs::create_dir(place.path().join("empty")).unwrap();
        drop(OutputDirectory::claim(&place.path().join("empty")).unwrap());
        assert!(place.path().join("empty").exists());
    }
}
