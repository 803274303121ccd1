//! The latest samples of the inputs.

use core::ops::Range;

use crate::engines::scalar::Scalar;

/// A ring of samples for each input, so long that no block of a power of two straddles its end.
pub(crate) struct History<T> {
    rows: Vec<Vec<T>>,
    length: usize,
}

impl<T: Scalar> History<T> {
    /// Room for the last `length` samples, a multiple of the largest block.
    pub(crate) fn new(inputs: usize, length: usize) -> Self {
        Self { rows: vec![vec![T::zero(); length]; inputs], length }
    }

    /// Number of samples kept.
    pub(crate) fn length(&self) -> usize {
        self.length
    }

    fn place(&self, k: u64) -> usize {
        (k % self.length as u64) as usize
    }

    /// Samples k, …, k + count − 1 of an input, all of one block.
    pub(crate) fn samples(&self, input: usize, k: u64, count: usize) -> &[T] {
        let first = self.place(k);
        &self.rows[input][first..first + count]
    }

    /// The same, to be written.
    pub(crate) fn samples_mut(&mut self, input: usize, k: u64, count: usize) -> &mut [T] {
        let first = self.place(k);
        &mut self.rows[input][first..first + count]
    }

    /// The samples of an input in a range of times, oldest first.
    pub(crate) fn range(&self, input: usize, times: Range<u64>) -> impl Iterator<Item = &T> {
        times.filter_map(move |k| self.rows[input].get(self.place(k)))
    }

    /// The place of sample k of an input.
    pub(crate) fn sample_mut(&mut self, input: usize, k: u64) -> Option<&mut T> {
        let place = self.place(k);
        self.rows[input].get_mut(place)
    }

    pub(crate) fn clear(&mut self) {
        self.rows.iter_mut().for_each(|row| row.fill(T::zero()));
    }

    pub(crate) fn bytes(&self) -> usize {
        self.rows.len() * self.length * size_of::<T>()
    }
}
