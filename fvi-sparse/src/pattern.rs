//! The structurally nonzero places of a sparse matrix.

use crate::Factor;
use crate::analysis::Analysis;
use core::ops::Range;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// The structurally nonzero places of a sparse square matrix, row by row, columns ascending.
#[derive(Clone, Debug, Default)]
pub struct Pattern {
    /// The first slot of each row, and the end of the last one.
    starts: Vec<usize>,
    /// Column of each slot, in 32 bits: products are limited by the rate at which the matrix is read.
    columns: Vec<u32>,
    /// Largest distance of a place from the diagonal.
    band: usize,
    is_chain: bool,
    /// Analysis of the elimination, once it has been requested.
    pub(crate) analysis: OnceLock<Analysis>,
    /// Cache of the matrices factored last, if enabled.
    remembered: Option<Arc<Remembered>>,
}

/// The values of matrices and their factors, the latest first.
type Remembered = Mutex<Vec<(Vec<f64>, Factor)>>;

/// Number of cached factors: that of the mass and that of the step's matrix.
const REMEMBERED: usize = 2;

/// Patterns are equal if their places are.
impl PartialEq for Pattern {
    fn eq(&self, other: &Self) -> bool {
        self.starts == other.starts && self.columns == other.columns
    }
}

impl Eq for Pattern {}

impl Pattern {
    /// The pattern of the given places, in any order, repetitions allowed; each index is less than `rows`.
    pub fn new(rows: usize, mut places: Vec<(usize, usize)>) -> Self {
        places.sort_unstable();
        places.dedup();
        let mut starts = vec![0; rows + 1];
        for &(row, _) in &places {
            starts[row + 1] += 1;
        }
        for row in 0..rows {
            starts[row + 1] += starts[row];
        }
        let band = places.iter().map(|&(row, column)| row.abs_diff(column)).max().unwrap_or(0);
        Self::with_columns(starts, places.into_iter().map(|(_, column)| column as u32).collect(), band)
    }

    fn with_columns(starts: Vec<usize>, columns: Vec<u32>, band: usize) -> Self {
        debug_assert!(starts.len() <= 1 << 32, "columns are numbers of 32 bits");
        let rows = starts.len().saturating_sub(1);
        let is_chain = rows > 1 && band == 1 && columns.len() + 2 == 3 * rows;
        Self { starts, columns, band, is_chain, analysis: OnceLock::new(), remembered: None }
    }

    /// The pattern of rows given one after another, each with its columns ascending and less than the number
    /// of rows.
    pub fn from_rows<R: IntoIterator<Item = usize>>(rows: impl IntoIterator<Item = R>) -> Self {
        let (mut starts, mut columns, mut band) = (vec![0], Vec::new(), 0);
        for (row, places) in rows.into_iter().enumerate() {
            columns.extend(places.into_iter().map(|column| column as u32));
            for &column in &columns[starts[row]..] {
                band = band.max(row.abs_diff(column as usize));
            }
            starts.push(columns.len());
        }
        Self::with_columns(starts, columns, band)
    }

    /// The pattern, with a cache of the last two factors for [`Analysis::factor_of`], shared by its clones:
    /// later factorisations of the same matrix are taken from it.
    pub fn remembering_factors(mut self) -> Self {
        self.remembered = Some(Arc::default());
        self
    }

    /// The factor of the matrix with these values, if it is cached.
    pub(crate) fn remembered(&self, values: &[f64]) -> Option<Factor> {
        let mut known = self.remembered.as_ref()?.lock().unwrap_or_else(PoisonError::into_inner);
        let place = known.iter().position(|(known, _)| known == values)?;
        known[..=place].rotate_right(1);
        known.first().map(|(_, factor)| factor.clone())
    }

    /// Caches a factor, if the pattern has a cache.
    pub(crate) fn remember(&self, values: &[f64], factor: &Factor) {
        if let Some(known) = &self.remembered {
            let mut known = known.lock().unwrap_or_else(PoisonError::into_inner);
            known.insert(0, (values.to_vec(), factor.clone()));
            known.truncate(REMEMBERED);
        }
    }

    /// Slot of a place among the values; the place must be one of the pattern's.
    pub fn slot(&self, row: usize, column: usize) -> usize {
        let start = self.starts[row];
        start + self.columns[start..self.starts[row + 1]].partition_point(|&other| (other as usize) < column)
    }

    /// Number of rows, and of columns.
    pub fn size(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Number of places.
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// True if there is no place at all.
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// Largest distance of a place from the diagonal.
    pub fn band(&self) -> usize {
        self.band
    }

    /// True if the columns of every row are its neighbours and itself, for two or more rows.
    pub fn is_chain(&self) -> bool {
        self.is_chain
    }

    /// Each row as its range of slots.
    pub fn rows(&self) -> impl Iterator<Item = Range<usize>> {
        self.starts.windows(2).map(|ends| ends[0]..ends[1])
    }

    /// The range of slots of a row.
    pub fn row(&self, row: usize) -> Range<usize> {
        self.starts[row]..self.starts[row + 1]
    }

    /// The column of each slot.
    pub fn columns(&self) -> &[u32] {
        &self.columns
    }

    /// The first slot of each row, and the end of the last one.
    pub fn starts(&self) -> &[usize] {
        &self.starts
    }

    /// Bytes on the heap.
    pub fn bytes(&self) -> usize {
        size_of_val(self.starts.as_slice()) + size_of_val(self.columns.as_slice())
    }
}
