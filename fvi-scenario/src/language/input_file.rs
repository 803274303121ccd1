//! Whole files of input: regular files and pipes, with a limit.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Read};
use std::path::Path;
use std::time::{Duration, Instant};

use super::memory_limit::check_capacity;

/// Largest document.
pub(crate) const LARGEST_DOCUMENT: u64 = 16 << 20;

/// Memory that a document takes for each byte of its text, as long lists of short numbers and their system
/// do.
const MEMORY_OF_A_BYTE: usize = 160;

/// Largest input from a pipe, whose length nobody knows beforehand.
const LARGEST_FROM_PIPE: u64 = 1 << 30;

/// How long a pipe may be silent.
const LONGEST_SILENCE: Duration = Duration::from_secs(30);

/// Reads a document, of at most [`LARGEST_DOCUMENT`] bytes.
///
/// # Errors
/// As [`read_data`], and if its values might not fit into memory.
pub(crate) fn read_document(path: &Path) -> io::Result<Vec<u8>> {
    let allowed =
        "matrices, loads and other numbers in bulk stand in files of their own, which a document names";
    let bytes = read(path, LARGEST_DOCUMENT, allowed)?;
    check_capacity(MEMORY_OF_A_BYTE * bytes.len()).map_err(|error| {
        io::Error::other(format!("a document of {} bytes: {error}; {allowed}", bytes.len()))
    })?;
    Ok(bytes)
}

/// Reads a file of numbers.
///
/// # Errors
/// If it cannot be read, is neither a regular file nor a pipe (a device has no end), is larger than the
/// memory that is available, or is a pipe that is silent for half a minute.
pub(crate) fn read_data(path: &Path) -> io::Result<Vec<u8>> {
    read(path, u64::MAX, "")
}

fn read(path: &Path, most: u64, allowed: &str) -> io::Result<Vec<u8>> {
    let there = fs::metadata(path)?;
    let too_large = |bytes: u64, most: u64| {
        let allowed = if allowed.is_empty() { String::new() } else { format!("; {allowed}") };
        io::Error::other(format!("{bytes} bytes, of which {most} may be read{allowed}"))
    };
    let limit = if there.is_file() {
        let length = there.len();
        if length > most {
            return Err(too_large(length, most));
        }
        check_capacity(usize::try_from(length).unwrap_or(usize::MAX)).map_err(io::Error::other)?;
        most
    } else if is_pipe(&there) {
        most.min(LARGEST_FROM_PIPE)
    } else {
        let kind = if there.is_dir() { "a directory" } else { "a device or socket" };
        return Err(io::Error::other(format!("{kind}; a regular file or a pipe is read")));
    };
    let mut file = open(path)?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(there.len() as usize).map_err(io::Error::other)?;
    let mut heard = Instant::now();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer) {
            // A pipe that nobody has opened for writing yet looks as if it were at its end.
            Ok(0) if is_pipe(&there) && bytes.is_empty() && heard.elapsed() < LONGEST_SILENCE => wait(),
            Ok(0) if is_pipe(&there) && bytes.is_empty() => return Err(silent()),
            Ok(0) => return Ok(bytes),
            Ok(count) => {
                heard = Instant::now();
                bytes.extend_from_slice(&buffer[..count]);
                if bytes.len() as u64 > limit {
                    return Err(too_large(bytes.len() as u64, limit));
                }
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                if heard.elapsed() >= LONGEST_SILENCE {
                    return Err(silent());
                }
                wait();
            }
            Err(error) => return Err(error),
        }
    }
}

fn wait() {
    std::thread::sleep(Duration::from_millis(5));
}

fn silent() -> io::Error {
    io::Error::new(
        io::ErrorKind::TimedOut,
        format!("a pipe that nothing came from for {} s", LONGEST_SILENCE.as_secs()),
    )
}

#[cfg(unix)]
fn is_pipe(there: &Metadata) -> bool {
    use std::os::unix::fs::FileTypeExt;
    there.file_type().is_fifo()
}

#[cfg(not(unix))]
fn is_pipe(_: &Metadata) -> bool {
    false
}

/// Opens a file without waiting for the other end of a pipe.
fn open(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, libc::O_NONBLOCK);
    options.open(path)
}
