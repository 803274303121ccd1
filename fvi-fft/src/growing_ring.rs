//! The ring of the `direct` engine on the host.

use fvi_core::Ring;

/// A ring whose capacity is known at run time and whose storage grows as samples come; newest first.
///
/// The storage is filled from its end, so that the samples are one slice until the ring forgets some.
#[derive(Clone, Debug)]
pub struct GrowingRing<T> {
    /// The newest samples from `head` on, those that do not fit there from the beginning on.
    samples: Vec<T>,
    head: usize,
    len: usize,
    capacity: usize,
}

/// Number of samples for which there is room at first.
const FIRST: usize = 16;

impl<T> GrowingRing<T> {
    /// An empty ring for at most `capacity` samples.
    pub fn new(capacity: usize) -> Self {
        Self { samples: Vec::new(), head: 0, len: 0, capacity }
    }
}

impl<T: Copy> GrowingRing<T> {
    /// Doubles the storage; `filler` is a number for places without a sample.
    #[inline(never)]
    fn grow(&mut self, filler: T) {
        let room = (2 * self.len).max(FIRST).min(self.capacity);
        let mut samples = vec![filler; room];
        let head = room - self.len;
        let (newer, older) = self.as_slices();
        samples[head..][..newer.len()].copy_from_slice(newer);
        samples[head + newer.len()..].copy_from_slice(older);
        (self.samples, self.head) = (samples, head);
    }
}

impl<T: Copy> Ring<T> for GrowingRing<T> {
    #[inline]
    fn as_slices(&self) -> (&[T], &[T]) {
        let (older, newer) = self.samples.split_at(self.head);
        match self.len.checked_sub(newer.len()) {
            Some(rest) => (newer, &older[..rest]),
            None => (&newer[..self.len], &[]),
        }
    }

    fn capacity(&self) -> usize {
        self.capacity
    }

    #[inline]
    fn store(&mut self, sample: T) {
        if self.len == self.samples.len() && self.len < self.capacity {
            self.grow(sample);
        }
        let next = self.head.checked_sub(1).unwrap_or(self.samples.len().saturating_sub(1));
        if let Some(place) = self.samples.get_mut(next) {
            *place = sample;
            (self.head, self.len) = (next, (self.len + 1).min(self.samples.len()));
        }
    }

    fn clear(&mut self) {
        (self.head, self.len) = (self.samples.len(), 0);
    }

    fn bytes(&self) -> usize {
        size_of::<Self>() + self.samples.len() * size_of::<T>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn newest_first(ring: &GrowingRing<usize>) -> Vec<usize> {
        let (newer, older) = ring.as_slices();
        [newer, older].concat()
    }

    #[test]
    fn samples_come_newest_first_and_the_oldest_are_forgotten() {
        for capacity in [0, 1, 2, 15, 16, 17, 40] {
            let mut ring = GrowingRing::new(capacity);
            // Once empty, once with the storage of the first time.
            for first in [0, 1000] {
                ring.clear();
                for count in 0..=2 * capacity + 3 {
                    let kept = count.min(capacity);
                    let expected: Vec<usize> = (0..kept).map(|lag| first + count - 1 - lag).collect();
                    assert_eq!(newest_first(&ring), expected, "capacity {capacity}");
                    assert!(count > capacity || ring.as_slices().1.is_empty(), "one slice");
                    ring.store(first + count);
                }
            }
        }
    }
}
