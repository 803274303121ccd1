//! `[system] gyroscopic`: forces −G v with a skew-symmetric matrix, which do no work.

use crate::language::document::Value;
use crate::language::error::{InputError, Problem};
use fvi_core::max_or_nan;
use serde::{Serialize, Serializer};

/// G, skew-symmetric: for rotating frames and rotors, and charges in a magnetic field.
#[derive(Clone, Debug, PartialEq)]
pub struct SkewMatrix {
    /// (row, column, entry) of the nonzero entries, in the order of rows.
    entries: Vec<(u32, u32, f64)>,
    size: usize,
    /// The file that it was read from.
    source: Option<String>,
}

/// Largest relative deviation of an entry from the negative of its mirror image.
const SYMMETRY: f64 = 1e-10;

impl SkewMatrix {
    pub(super) fn read(value: &Value<'_>, count: usize) -> Result<Self, InputError> {
        let (rows, columns, given, source) = if value.is_text() {
            let file = value.matrix_file()?;
            if file.half {
                return Err(value.file_error("a symmetric matrix where a skew-symmetric one is wanted"));
            }
            let source = value.document().resolve(value.text()?).display().to_string();
            (file.rows, file.columns, file.entries, Some(source))
        } else {
            let rows = value.list("a file, or a list of rows")?;
            let rows: Vec<Vec<f64>> = rows.iter().map(Value::numbers).collect::<Result<_, _>>()?;
            let columns = rows.iter().map(Vec::len).find(|&len| len != count).unwrap_or(count);
            let entry = |(row, numbers): (usize, &Vec<f64>)| {
                let numbers = numbers.iter().enumerate().filter(|(_, number)| **number != 0.0);
                numbers.map(|(column, &number)| (row as u32, column as u32, number)).collect::<Vec<_>>()
            };
            (rows.len(), columns, rows.iter().enumerate().flat_map(entry).collect(), None)
        };
        if (rows, columns) != (count, count) {
            return Err(value.error(Problem::WrongShape {
                expected: format!(
                    "{count} rows of {count} numbers (as many as `system.mass` has coordinates)"
                ),
                found: format!("{rows} rows of {columns}"),
            }));
        }
        Self::of_entries(given, count, source).map_err(|(row, column, entry, mirrored)| {
            value.out_of_range(format!(
                "a skew-symmetric matrix, Gᵀ = −G; entry ({row}, {column}) is {entry}, entry ({column}, {row}) is {mirrored}"
            ))
        })
    }

    /// The skew part of a matrix that is skew-symmetric to rounding; otherwise the place where it is not, and
    /// both entries.
    fn of_entries(
        given: Vec<(u32, u32, f64)>,
        size: usize,
        source: Option<String>,
    ) -> Result<Self, (u32, u32, f64, f64)> {
        let mut sums = std::collections::BTreeMap::new();
        for (row, column, entry) in given {
            *sums.entry((row, column)).or_insert(0.0) += entry;
        }
        let mirrored = |row, column| sums.get(&(column, row)).copied().unwrap_or(0.0);
        let largest = sums.values().map(|entry| entry.abs()).fold(0.0, max_or_nan);
        let mut entries = Vec::with_capacity(sums.len());
        for (&(row, column), &entry) in &sums {
            let other = mirrored(row, column);
            if (entry + other).abs() > SYMMETRY * largest {
                return Err((row, column, entry, other));
            }
            let entry = 0.5 * (entry - other);
            if entry != 0.0 {
                entries.push((row, column, entry));
                if !sums.contains_key(&(column, row)) {
                    entries.push((column, row, -entry));
                }
            }
        }
        Ok(Self { entries, size, source })
    }

    /// True if the matrix was read from a file.
    pub fn is_from_file(&self) -> bool {
        self.source.is_some()
    }

    /// (row, column, entry) of the nonzero entries.
    pub fn entries(&self) -> &[(u32, u32, f64)] {
        &self.entries
    }
}

impl Serialize for SkewMatrix {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if let Some(file) = &self.source {
            return file.serialize(serializer);
        }
        let mut rows = vec![vec![0.0; self.size]; self.size];
        for &(row, column, entry) in &self.entries {
            rows[row as usize][column as usize] = entry;
        }
        rows.serialize(serializer)
    }
}
