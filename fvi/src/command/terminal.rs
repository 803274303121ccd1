//! Output to the terminal; closed pipes are not an error.

use super::CommandError;
use fvi_scenario::language::escape::visible;
use std::io::{self, ErrorKind, Write};

/// Writes to standard output. A closed pipe, as in `fvi weights … | head`, is not an error; a full device is.
pub(super) fn output(content: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), CommandError> {
    let mut output = io::BufWriter::new(io::stdout().lock());
    let written = content(&mut output).and_then(|()| output.flush());
    // The buffered rest must not be written again when the writer is dropped.
    let _ = output.into_parts();
    match written {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.map_err(|error| CommandError::Failed(format!("standard output: {error}"))),
    }
}

/// Writes a text to standard output, without terminal control characters.
pub(super) fn say(text: &str) -> Result<(), CommandError> {
    output(|output| output.write_all(visible(text).as_bytes()))
}

/// Writes a text to standard error unchanged; errors are ignored.
pub(super) fn mention(text: &str) {
    let _ = io::stderr().lock().write_all(text.as_bytes());
}
