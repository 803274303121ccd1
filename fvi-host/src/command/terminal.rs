//! Output to the terminal; closed pipes are no error.

use super::CommandError;
use crate::language::visible::visible;
use std::io::{self, ErrorKind, Write};

/// Writes to standard output. A reader that has gone, as in `fvi weights … | head`, is no error; a full
/// device is.
pub(super) fn output(content: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), CommandError> {
    let mut output = io::BufWriter::new(io::stdout().lock());
    let written = content(&mut output).and_then(|()| output.flush());
    // What is left of it must not be tried once more.
    let _ = output.into_parts();
    match written {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.map_err(|error| CommandError::Failed(format!("standard output: {error}"))),
    }
}

/// Writes a text to standard output, without characters that steer a terminal.
pub(super) fn say(text: &str) -> Result<(), CommandError> {
    output(|output| output.write_all(visible(text).as_bytes()))
}

/// Writes a text to standard error as it is; if nobody can be told, so be it.
pub(super) fn mention(text: &str) {
    let _ = io::stderr().lock().write_all(text.as_bytes());
}
