//! A ring of samples on a buffer of the caller.

use fvi_core::Ring;

/// Samples of one channel in a circular buffer, newest first, beginning at index `newest`.
#[derive(Debug)]
pub(crate) struct BufferRing {
    buffer: &'static mut [f32],
    newest: usize,
    filled: usize,
}

impl BufferRing {
    pub(crate) fn new(buffer: &'static mut [f32]) -> Self {
        Self { buffer, newest: 0, filled: 0 }
    }
}

impl Ring<f32> for BufferRing {
    #[inline]
    fn as_slices(&self) -> (&[f32], &[f32]) {
        let (before, from) = self.buffer.split_at(self.newest.min(self.buffer.len()));
        let newer = from.get(..self.filled).unwrap_or(from);
        let older = before.get(..self.filled - newer.len()).unwrap_or(before);
        (newer, older)
    }

    fn capacity(&self) -> usize {
        self.buffer.len()
    }

    #[inline]
    fn store(&mut self, sample: f32) {
        self.newest = self.newest.checked_sub(1).unwrap_or(self.buffer.len().saturating_sub(1));
        if let Some(place) = self.buffer.get_mut(self.newest) {
            *place = sample;
            self.filled = (self.filled + 1).min(self.buffer.len());
        }
    }

    fn clear(&mut self) {
        (self.newest, self.filled) = (0, 0);
    }

    fn bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(self.buffer)
    }
}
