//! The ring of the `direct` engine on the host.

use fvi_core::Ring;
use std::collections::VecDeque;

/// A ring whose capacity is known at run time and whose storage grows as samples come; newest first.
#[derive(Clone, Debug)]
pub struct GrowingRing<T> {
    samples: VecDeque<T>,
    capacity: usize,
}

impl<T> GrowingRing<T> {
    /// An empty ring for at most `capacity` samples.
    pub fn new(capacity: usize) -> Self {
        Self { samples: VecDeque::new(), capacity }
    }
}

impl<T: Copy> Ring<T> for GrowingRing<T> {
    fn as_slices(&self) -> (&[T], &[T]) {
        self.samples.as_slices()
    }

    fn capacity(&self) -> usize {
        self.capacity
    }

    fn store(&mut self, sample: T) {
        if self.samples.len() == self.capacity {
            self.samples.pop_back();
        }
        self.samples.push_front(sample);
    }

    fn clear(&mut self) {
        self.samples.clear();
    }

    fn bytes(&self) -> usize {
        size_of::<Self>() + self.samples.capacity() * size_of::<T>()
    }
}
