//! Where the entries of a sparse matrix may be.

use core::ops::Range;

/// The places of a sparse square matrix, row by row, columns ascending.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pattern {
    /// Where each row begins, and where the last one ends.
    starts: Vec<usize>,
    columns: Vec<usize>,
    /// The same in half the bytes, for products, which are as fast as the matrix is fetched.
    narrow: Vec<u32>,
    /// Largest distance of a place from the diagonal.
    band: usize,
}

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
        Self::with_columns(starts, places.into_iter().map(|(_, column)| column).collect(), band)
    }

    fn with_columns(starts: Vec<usize>, columns: Vec<usize>, band: usize) -> Self {
        debug_assert!(starts.len() <= 1 << 32, "columns are numbers of 32 bits");
        let narrow = columns.iter().map(|&column| column as u32).collect();
        Self { starts, columns, narrow, band }
    }

    /// The pattern of rows given one after another, each with its columns ascending and less than the number
    /// of rows.
    pub fn from_rows<R: IntoIterator<Item = usize>>(rows: impl IntoIterator<Item = R>) -> Self {
        let (mut starts, mut columns, mut band) = (vec![0], Vec::new(), 0);
        for (row, places) in rows.into_iter().enumerate() {
            columns.extend(places);
            for &column in &columns[starts[row]..] {
                band = band.max(row.abs_diff(column));
            }
            starts.push(columns.len());
        }
        Self::with_columns(starts, columns, band)
    }

    /// Where in the values the entry of a place lies; the place must be one of the pattern's.
    pub fn slot(&self, row: usize, column: usize) -> usize {
        let start = self.starts[row];
        start + self.columns[start..self.starts[row + 1]].partition_point(|&other| other < column)
    }

    /// Number of rows, and of columns.
    pub fn size(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Number of places.
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether there is no place at all.
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// Largest distance of a place from the diagonal.
    pub fn band(&self) -> usize {
        self.band
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
    pub fn columns(&self) -> &[usize] {
        &self.columns
    }

    /// The column of each slot, in half the bytes.
    pub(crate) fn narrow_columns(&self) -> &[u32] {
        &self.narrow
    }

    /// Where each row begins, and where the last one ends.
    pub fn starts(&self) -> &[usize] {
        &self.starts
    }

    /// Bytes on the heap.
    pub fn bytes(&self) -> usize {
        (self.starts.len() + self.columns.len()) * size_of::<usize>() + self.narrow.len() * size_of::<u32>()
    }
}
