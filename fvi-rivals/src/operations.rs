//! Floating-point operations, counted where they are done.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Number of floating-point operations that a memory has done since it was made or cleared.
///
/// A multiply–add counts two, a complex transform of length n counts 5 n log₂ n and a real one half of it,
/// whatever the transform does inside: so counts of different authors are comparable. Copies share one count.
#[derive(Clone, Debug, Default)]
pub struct Operations(Arc<AtomicU64>);

impl Operations {
    /// The number so far.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    // One memory counts at a time, so that no locked instruction is needed.
    #[inline(always)]
    pub(crate) fn add(&self, operations: usize) {
        self.0.store(self.0.load(Ordering::Relaxed) + operations as u64, Ordering::Relaxed);
    }

    pub(crate) fn clear(&self) {
        self.0.store(0, Ordering::Relaxed);
    }
}

/// Operations of a real transform of so many numbers, forward or inverse.
pub(crate) fn real_transform(length: usize) -> usize {
    5 * length * length.trailing_zeros() as usize / 2
}
