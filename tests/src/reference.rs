//! The independent high-precision values in `tests/reference`; its README tells how they were made.

use std::collections::HashMap;
use std::path::Path;

/// Reads a table of numbers; each row maps a column's name to its value.
///
/// # Panics
/// If the file is missing or holds anything but numbers under its header.
pub fn read(file: &str) -> Vec<HashMap<String, f64>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("reference").join(file);
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    lines
        .map(|line| {
            let numbers = line.split(',').map(|cell| cell.parse().expect("a number"));
            header.iter().map(|name| name.to_string()).zip(numbers).collect()
        })
        .collect()
}
