//! Symmetric matrices that a scenario reads from files, or assembles from the columns of dampers.

use crate::language::document::Value;
use crate::language::error::{InputError, Problem};
use crate::language::matrix_file::FileMatrix;
use fvi_core::max_or_nan;
use fvi_sparse::check_positive_semidefinite;
use fvi_sparse::{Analysis, FactorError, Pattern};
use serde::{Serialize, Serializer};
use std::sync::{Arc, Mutex, PoisonError};

/// A symmetric matrix given by its structurally nonzero entries.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseMatrix {
    /// Structurally nonzero places.
    pub pattern: Arc<Pattern>,
    /// One value for each place.
    pub values: Arc<Vec<f64>>,
    /// The file that it was read from.
    source: Option<String>,
}

/// Largest relative difference of an entry and its mirror image, as from rounding in the assembly of
/// elements.
const ASYMMETRY: f64 = 1e-10;

/// Largest number of rows of a mass matrix per entry: rows without entries are coordinates without mass.
const MOST_ROWS: usize = 64;

impl SparseMatrix {
    /// The symmetric matrix in the file that `value` refers to; without a number of coordinates it is the
    /// mass matrix, which determines that number.
    ///
    /// Memory is allocated for each row, while a file may state any number of rows: a mass matrix with too
    /// many rows for its entries is refused first.
    fn read(value: &Value<'_>, coordinates: Option<usize>) -> Result<Self, InputError> {
        let file = value.matrix_file()?;
        if file.rows != file.columns {
            let reason =
                format!("{} rows and {} columns where a square matrix is wanted", file.rows, file.columns);
            return Err(value.file_error(reason));
        }
        match coordinates {
            Some(count) if count != file.rows => return Err(wrong_size(file.rows, count, value)),
            None if file.rows > MOST_ROWS.saturating_mul(file.entries.len()) => {
                let reason = format!(
                    "{} entries in {} rows: a mass matrix has one at least for each {MOST_ROWS} rows",
                    file.entries.len(),
                    file.rows
                );
                return Err(value.file_error(reason));
            }
            _ => {}
        }
        let mut matrix = Self::of_file(file);
        matrix.make_symmetric().map_err(|reason| value.file_error(reason))?;
        matrix.source = source(value);
        Ok(matrix)
    }

    fn of_file(file: FileMatrix) -> Self {
        let mirrored = |&(row, column, entry): &(u32, u32, f64)| {
            (file.half && row != column).then_some((column, row, entry))
        };
        let entries = || file.entries.iter().copied().chain(file.entries.iter().filter_map(mirrored));
        Self::of_entries(file.rows, entries)
    }

    /// The matrix of these entries, with entries at the same place added.
    fn of_entries<E: Iterator<Item = (u32, u32, f64)>>(rows: usize, entries: impl Fn() -> E) -> Self {
        let mut starts = vec![0_usize; rows + 1];
        entries().for_each(|(row, ..)| starts[row as usize + 1] += 1);
        for row in 0..rows {
            starts[row + 1] += starts[row];
        }
        let mut next = starts.clone();
        let mut sorted = vec![(0_u32, 0.0); starts[rows]];
        for (row, column, entry) in entries() {
            let place = &mut next[row as usize];
            sorted[*place] = (column, entry);
            *place += 1;
        }
        let mut values = Vec::with_capacity(sorted.len());
        let pattern = Pattern::from_rows(starts.windows(2).map(|ends| {
            let row = &mut sorted[ends[0]..ends[1]];
            row.sort_by_key(|&(column, _)| column);
            let mut columns: Vec<usize> = Vec::with_capacity(row.len());
            for &(column, entry) in &*row {
                if columns.last() == Some(&(column as usize)) {
                    if let Some(last) = values.last_mut() {
                        *last += entry;
                    }
                } else {
                    columns.push(column as usize);
                    values.push(entry);
                }
            }
            columns
        }));
        Self { pattern: Arc::new(pattern), values: Arc::new(values), source: None }
    }

    /// B diag(strength) Bᵀ; `columns` are those of B, each as its nonzero entries.
    pub(super) fn of_columns(rows: usize, columns: &[Vec<(u32, f64)>], strength: &[f64]) -> Self {
        let entries = || {
            columns.iter().zip(strength).flat_map(|(column, &strength)| {
                let with_row = move |&(row, b): &(u32, f64)| {
                    column.iter().map(move |&(other, c)| (row, other, b * c * strength))
                };
                column.iter().flat_map(with_row)
            })
        };
        Self::of_entries(rows, entries)
    }

    /// Takes the mean of entries whose mirror images differ by rounding.
    ///
    /// # Errors
    /// The first place where they differ by more, as a message.
    fn make_symmetric(&mut self) -> Result<(), String> {
        let pattern = Arc::clone(&self.pattern);
        let values = Arc::make_mut(&mut self.values);
        let find = |row: usize, column: usize| {
            let slots = pattern.row(row);
            let found = pattern.columns()[slots.clone()].binary_search(&(column as u32)).ok()?;
            Some(slots.start + found)
        };
        let largest: Vec<f64> = pattern
            .rows()
            .map(|slots| values[slots].iter().map(|entry| entry.abs()).fold(0.0, max_or_nan))
            .collect();
        for (row, slots) in pattern.rows().enumerate() {
            for slot in slots {
                let column = pattern.columns()[slot] as usize;
                let mirrored = find(column, row);
                let (one, other) = (values[slot], mirrored.map_or(0.0, |mirrored| values[mirrored]));
                if (one - other).abs() > ASYMMETRY * largest[row].min(largest[column]) {
                    return Err(format!(
                        "not symmetric: the entry in row {row}, column {column} is {one}, that in row {column}, column {row} \
                         is {other} (from 0)"
                    ));
                }
                if let Some(mirrored) = mirrored {
                    let mean = 0.5 * (one + other);
                    (values[slot], values[mirrored]) = (mean, mean);
                }
            }
        }
        // An entry of rounding size without a mirror image.
        if pattern.rows().enumerate().any(|(row, slots)| {
            slots.into_iter().any(|slot| find(pattern.columns()[slot] as usize, row).is_none())
        }) {
            let entries: Vec<(u32, u32, f64)> = pattern
                .rows()
                .enumerate()
                .flat_map(|(row, slots)| slots.map(move |slot| (row, slot)))
                .filter(|&(row, slot)| find(pattern.columns()[slot] as usize, row).is_some())
                .map(|(row, slot)| (row as u32, pattern.columns()[slot], values[slot]))
                .collect();
            *self = Self::of_entries(pattern.size(), || entries.iter().copied());
        }
        Ok(())
    }

    /// The same matrix times a number.
    pub(super) fn scaled(mut self, scale: f64) -> Self {
        Arc::make_mut(&mut self.values).iter_mut().for_each(|value| *value *= scale);
        self
    }

    /// True if places and entries are the same.
    fn has_entries_of(&self, other: &Self) -> bool {
        (Arc::ptr_eq(&self.values, &other.values) || self.values == other.values)
            && (Arc::ptr_eq(&self.pattern, &other.pattern) || self.pattern == other.pattern)
    }

    /// True if the matrix is `other` times a number ≥ 0, to rounding.
    fn is_multiple_of(&self, other: &Self) -> bool {
        let Some(largest) = other.values.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())) else {
            return false;
        };
        let same = Arc::ptr_eq(&self.pattern, &other.pattern) || self.pattern == other.pattern;
        let mut pairs = self.values.iter().zip(other.values.iter());
        let place = other.values.iter().position(|&value| value == largest);
        let factor = place.map_or(f64::NAN, |place| self.values[place] / largest);
        let near =
            |(own, other): (&f64, &f64)| (own - factor * other).abs() <= 4.0 * f64::EPSILON * own.abs();
        same && factor >= 0.0 && factor.is_finite() && pairs.all(near)
    }

    /// Number of rows.
    pub fn size(&self) -> usize {
        self.pattern.size()
    }

    /// Writes the product with a vector of the same size to `product`.
    pub fn write_times(&self, vector: &[f64], product: &mut [f64]) {
        for (place, slots) in product.iter_mut().zip(self.pattern.rows()) {
            let entries = self.pattern.columns()[slots.clone()].iter().zip(&self.values[slots]);
            *place = entries.map(|(&column, entry)| entry * vector[column as usize]).sum();
        }
    }

    /// The rows in which every entry is zero.
    pub fn zero_rows(&self) -> Vec<usize> {
        let rows = self.pattern.rows().enumerate();
        rows.filter(|(_, slots)| self.values[slots.clone()].iter().all(|&entry| entry == 0.0))
            .map(|(row, _)| row)
            .collect()
    }

    /// The same matrix with ones on the diagonal of these rows, whose entries are all zero.
    pub fn with_ones(&self, rows: &[usize]) -> (Pattern, Vec<f64>) {
        let entries = || {
            let own = self.pattern.rows().enumerate().flat_map(|(row, slots)| {
                slots.map(move |slot| (row as u32, self.pattern.columns()[slot], self.values[slot]))
            });
            own.chain(rows.iter().map(|&row| (row as u32, row as u32, 1.0)))
        };
        let whole = Self::of_entries(self.size(), entries);
        (Arc::unwrap_or_clone(whole.pattern), Arc::unwrap_or_clone(whole.values))
    }

    /// Refuses a matrix that is not positive definite apart from rows and columns of zeros.
    fn positive_definite(self, value: &Value<'_>) -> Result<Self, InputError> {
        let massless = self.zero_rows();
        let factor = if massless.is_empty() {
            Analysis::new(&self.pattern).factor_of(&self.pattern, &self.values)
        } else {
            let (pattern, values) = self.with_ones(&massless);
            Analysis::new(&pattern).factor(&pattern, &values)
        };
        match factor {
            Ok(_) => Ok(self),
            Err(error) => Err(self.refused(value, error)),
        }
    }

    /// Refuses a matrix that is not positive semidefinite beyond rounding.
    fn positive_semidefinite(self, value: &Value<'_>) -> Result<Self, InputError> {
        match check_positive_semidefinite(&self.pattern, &self.values, f64::EPSILON) {
            Ok(()) => Ok(self),
            Err(FactorError::Pivot { pivot, coordinate }) => {
                let reason = format!(
                    "not positive semidefinite: pivot {pivot} of the elimination, coordinate {coordinate}, is negative"
                );
                Err(value.error(Problem::Unusable { reason }))
            }
            Err(error) => Err(self.refused(value, error)),
        }
    }

    fn refused(&self, value: &Value<'_>, error: FactorError) -> InputError {
        value.error(Problem::Unusable { reason: error.to_string() })
    }
}

/// Matrices shared by scenarios: files attached to their documents are read once, equal patterns are stored
/// and analysed once, and the last two factors are cached for each pattern.
///
/// The contents live as long as the last clone.
#[derive(Clone, Debug, Default)]
pub struct KnownMatrices(Arc<Mutex<Known>>);

#[derive(Debug, Default)]
struct Known {
    /// Matrices, each with the content of its file.
    matrices: Vec<(Arc<[u8]>, SparseMatrix)>,
    patterns: Vec<Arc<Pattern>>,
    definite: Vec<SparseMatrix>,
    semidefinite: Vec<SparseMatrix>,
}

/// Number of cached entries of each kind; otherwise a fit with different matrices at each point would fill
/// the memory.
const KEPT: usize = 8;

/// Adds an entry; at the limit it replaces the oldest one.
fn keep<T>(kept: &mut Vec<T>, entry: T) {
    if kept.len() == KEPT {
        kept.remove(0);
    }
    kept.push(entry);
}

impl KnownMatrices {
    fn with<R>(&self, call: impl FnOnce(&mut Known) -> R) -> R {
        call(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// A pattern equal to the given one, shared from now on.
    pub fn pattern(&self, pattern: Arc<Pattern>) -> Arc<Pattern> {
        self.with(|known| {
            if let Some(other) = known.patterns.iter().find(|other| **other == pattern) {
                return Arc::clone(other);
            }
            let pattern = Arc::new(Arc::unwrap_or_clone(pattern).remembering_factors());
            keep(&mut known.patterns, Arc::clone(&pattern));
            pattern
        })
    }

    fn matrix(&self, content: &Arc<[u8]>) -> Option<SparseMatrix> {
        self.with(|known| {
            let same = |(other, _): &&(Arc<[u8]>, SparseMatrix)| other == content;
            known.matrices.iter().find(same).map(|(_, matrix)| matrix.clone())
        })
    }

    fn is_definite(&self, matrix: &SparseMatrix) -> bool {
        self.with(|known| known.definite.iter().any(|other| other.has_entries_of(matrix)))
    }

    /// True if the matrix is a multiple of a known semidefinite matrix.
    fn is_semidefinite(&self, matrix: &SparseMatrix) -> bool {
        self.with(|known| known.semidefinite.iter().any(|other| matrix.is_multiple_of(other)))
    }
}

/// Matrices from the files of one scenario: a file is read once, and equal patterns are stored and analysed
/// once.
#[derive(Default)]
pub(super) struct Matrices<'a> {
    own: Vec<SparseMatrix>,
    shared: Option<&'a KnownMatrices>,
}

impl<'a> Matrices<'a> {
    pub(super) fn sharing(shared: Option<&'a KnownMatrices>) -> Self {
        Self { own: Vec::new(), shared }
    }

    /// As [`SparseMatrix::read`].
    pub(super) fn read(
        &mut self,
        value: &Value<'_>,
        coordinates: Option<usize>,
    ) -> Result<SparseMatrix, InputError> {
        let source = source(value);
        if let Some(known) = self.own.iter().find(|known| known.source == source) {
            return Ok(known.clone());
        }
        let content = self.shared.and_then(|_| value.document().attached(value.text().ok()?));
        let known = self.shared.zip(content.as_ref()).and_then(|(shared, content)| shared.matrix(content));
        let mut matrix = match known {
            Some(known) if coordinates.is_none_or(|count| count == known.size()) => {
                SparseMatrix { source, ..known }
            }
            _ => SparseMatrix::read(value, coordinates)?,
        };
        if let Some(known) = self.own.iter().find(|known| known.pattern == matrix.pattern) {
            matrix.pattern = Arc::clone(&known.pattern);
        }
        if let Some(shared) = self.shared {
            matrix.pattern = shared.pattern(matrix.pattern);
            if let Some(content) = content
                && shared.matrix(&content).is_none()
            {
                shared.with(|known| keep(&mut known.matrices, (content, matrix.clone())));
            }
        }
        self.own.push(matrix.clone());
        Ok(matrix)
    }

    /// Refuses a matrix that is not positive definite apart from rows and columns of zeros.
    pub(super) fn positive_definite(
        &self,
        matrix: SparseMatrix,
        value: &Value<'_>,
    ) -> Result<SparseMatrix, InputError> {
        match self.shared {
            Some(shared) if shared.is_definite(&matrix) => Ok(matrix),
            shared => {
                let matrix = matrix.positive_definite(value)?;
                if let Some(shared) = shared {
                    shared.with(|known| keep(&mut known.definite, matrix.clone()));
                }
                Ok(matrix)
            }
        }
    }

    /// Refuses a matrix that is not positive semidefinite beyond rounding.
    pub(super) fn positive_semidefinite(
        &self,
        matrix: SparseMatrix,
        value: &Value<'_>,
    ) -> Result<SparseMatrix, InputError> {
        match self.shared {
            Some(shared) if shared.is_semidefinite(&matrix) => Ok(matrix),
            shared => {
                let matrix = matrix.positive_semidefinite(value)?;
                if let Some(shared) = shared {
                    shared.with(|known| keep(&mut known.semidefinite, matrix.clone()));
                }
                Ok(matrix)
            }
        }
    }
}

/// The file that a value refers to.
fn source(value: &Value<'_>) -> Option<String> {
    value.text().ok().map(|name| value.document().resolve(name).display().to_string())
}

/// The error for a matrix whose number of rows is not the number of coordinates.
pub(super) fn wrong_size(rows: usize, count: usize, value: &Value<'_>) -> InputError {
    value.error(Problem::WrongShape {
        expected: format!("{count} (the number of coordinates, from `system.mass`)"),
        found: format!("{rows} rows"),
    })
}

/// Serialised as the name of the file, or as rows.
impl Serialize for SparseMatrix {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if let Some(source) = &self.source {
            return source.serialize(serializer);
        }
        let row = |slots: core::ops::Range<usize>| {
            let mut row = vec![0.0; self.size()];
            for slot in slots {
                row[self.pattern.columns()[slot] as usize] = self.values[slot];
            }
            row
        };
        serializer.collect_seq(self.pattern.rows().map(row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::language::Document;
    use crate::scenario::Scenario;
    use std::fmt::Write as _;
    use std::path::Path;

    /// A tridiagonal matrix of 200 rows as a Matrix Market file.
    fn chain(diagonal: f64, beside: f64) -> String {
        let mut text = "%%MatrixMarket matrix coordinate real symmetric\n200 200 399\n".to_owned();
        for row in 1..=200 {
            writeln!(text, "{row} {row} {diagonal}").unwrap();
            if row > 1 {
                writeln!(text, "{row} {} {beside}", row - 1).unwrap();
            }
        }
        text
    }

    #[test]
    fn matrices_that_are_known_are_not_read_ordered_and_checked_again() {
        let known = KnownMatrices::default();
        let read = |damping: f64, load: &str| {
            let text = format!(
                "[system]\nmass = \"m.mtx\"\nstiffness = \"k.mtx\"\n\
                 damping = [{{ order = 0.5, coefficient = \"c.mtx\" }}]\n\
                 load = [{{ pattern = {{ coordinate = 3 }}, amplitude = \"{load}\" }}]\n\
                 [output]\ncoordinates = [3]\n[time]\nstep = 0.1\nsteps = 3\n"
            );
            let document = Document::new("scenario.toml", Path::new(""), &text)
                .with_attached("m.mtx", chain(4.0, 1.0))
                .with_attached("k.mtx", chain(2.0, -1.0))
                .with_attached("c.mtx", chain(2.0 * damping, -damping));
            Scenario::knowing(document, &known).unwrap();
            known.with(|known| {
                [known.matrices.len(), known.patterns.len(), known.definite.len(), known.semidefinite.len()]
            })
        };
        assert_eq!(read(0.25, "sin(t)"), [3, 1, 1, 1]);
        assert_eq!(read(0.25, "t"), [3, 1, 1, 1]);
        // A multiple of a known coefficient is read, and not checked.
        assert_eq!(read(0.5, "t"), [4, 1, 1, 1]);
    }
}
