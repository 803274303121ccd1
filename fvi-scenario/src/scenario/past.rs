//! `[initial] past`: the motion before the start, for the memories.

use super::scheme::{Convolution, DampedAt, Scheme};
use crate::language::document::Value;
use crate::language::error::{InputError, Problem};
use serde::{Serialize, Serializer};

/// The motion during some steps before the start. Before those the system was at rest at its first position.
///
/// Memories store its positions like those of solved steps, so that derivatives begin with it: Caputo's act
/// on q − q(t₀ − m h).
#[derive(Clone, Debug, PartialEq)]
pub struct Past {
    /// Positions, row by row, in the order of time: for every step its beginning, followed, if the memory
    /// stores several nodes, by those of the nodes. The last step ends at the initial position.
    positions: Vec<f64>,
    coordinates: usize,
    rows_of_step: usize,
    /// The file that it was read from.
    source: Option<String>,
}

/// Rows for a step of the past: one if positions at grid points suffice, otherwise one for its beginning and
/// one for each node.
pub(crate) fn rows_of_step(scheme: &Scheme, convolution: &Convolution) -> usize {
    match nodes(scheme, convolution) {
        1 => 1,
        nodes => nodes + 1,
    }
}

/// Number of nodes per step that a memory stores.
pub(super) fn nodes(scheme: &Scheme, convolution: &Convolution) -> usize {
    if convolution.at == DampedAt::MainNodes && !convolution.family.is_staged() {
        return 1;
    }
    scheme.descriptor(convolution.family).nodes
}

impl Past {
    pub(super) fn read(
        value: &Value<'_>,
        coordinates: usize,
        rows_of_step: usize,
    ) -> Result<Self, InputError> {
        let shape =
            |expected: String, found: String| Err(value.error(Problem::WrongShape { expected, found }));
        let (count, columns, positions, source) = if value.is_text() {
            let file = value.matrix_file()?;
            if file.half {
                return Err(value.file_error("a symmetric matrix where rows of positions are wanted"));
            }
            let mut positions = vec![0.0; file.rows.saturating_mul(file.columns)];
            for (row, column, entry) in file.entries {
                positions[row as usize * file.columns + column as usize] += entry;
            }
            let source = value.document().resolve(value.text()?).display().to_string();
            (file.rows, file.columns, positions, Some(source))
        } else {
            let rows = value.list("a file, or a list of rows")?;
            let rows: Vec<Vec<f64>> = rows.iter().map(Value::numbers).collect::<Result<_, _>>()?;
            if let Some(row) = rows.iter().find(|row| row.len() != coordinates) {
                return shape(
                    format!("rows of {coordinates} numbers, one for each coordinate"),
                    format!("{}", row.len()),
                );
            }
            (rows.len(), coordinates, rows.concat(), None)
        };
        if columns != coordinates {
            return shape(
                format!("rows of {coordinates} numbers, one for each coordinate"),
                columns.to_string(),
            );
        }
        if count == 0 || !count.is_multiple_of(rows_of_step) {
            let expected = match rows_of_step {
                1 => {
                    "one row at least, for each step before the start the position where it begins".to_owned()
                }
                rows => format!(
                    "{rows} rows for each step before the start: the position where it begins, and those at the {} nodes \
                     of the scheme",
                    rows - 1
                ),
            };
            return shape(expected, format!("{count} rows"));
        }
        Ok(Self { positions, coordinates, rows_of_step, source })
    }

    /// Number of steps.
    pub fn steps(&self) -> usize {
        self.positions.len() / (self.coordinates * self.rows_of_step)
    }

    /// True if the past was read from a file.
    pub fn is_from_file(&self) -> bool {
        self.source.is_some()
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.positions.len() / self.coordinates
    }

    /// Its derivative by one of its numbers: one at that place, zeros elsewhere.
    #[must_use]
    pub fn slope(&self, row: usize, coordinate: usize) -> Self {
        let place = row * self.coordinates + coordinate;
        let is_there = |index| f64::from(u8::from(index == place));
        Self { positions: (0..self.positions.len()).map(is_there).collect(), ..self.clone() }
    }

    /// The position at its beginning, where the system had been at rest.
    pub fn first(&self) -> &[f64] {
        &self.positions[..self.coordinates]
    }

    /// The positions at the nodes of a step, one after another; empty if grid points suffice.
    pub fn nodes(&self, step: usize) -> &[f64] {
        let begin = step * self.rows_of_step;
        &self.positions[(begin + 1) * self.coordinates..(begin + self.rows_of_step) * self.coordinates]
    }

    /// The position at the end of a step; `None` for the last, which ends at the initial position.
    pub fn end(&self, step: usize) -> Option<&[f64]> {
        let begin = (step + 1) * self.rows_of_step * self.coordinates;
        self.positions.get(begin..begin + self.coordinates)
    }
}

impl Serialize for Past {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.source {
            Some(file) => file.serialize(serializer),
            None => {
                let rows: Vec<&[f64]> = self.positions.chunks(self.coordinates).collect();
                rows.serialize(serializer)
            }
        }
    }
}
