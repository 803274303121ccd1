//! Floating-point operations, counted where they are done.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Number of floating-point operations that a memory has done since it was made or cleared.
///
/// A multiply–add counts two, a complex transform of length n counts 5 n log₂ n and a real one half of it,
/// independent of its implementation, so that counts of different methods are comparable. Clones share one
/// counter.
#[derive(Clone, Debug, Default)]
pub struct Operations(Arc<AtomicU64>);

impl Operations {
    /// The number so far.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    // Only one memory writes a counter, so that no atomic read-modify-write instruction is needed.
    #[inline(always)]
    pub(crate) fn add(&self, operations: usize) {
        self.0.store(self.0.load(Ordering::Relaxed) + operations as u64, Ordering::Relaxed);
    }

    pub(crate) fn clear(&self) {
        self.0.store(0, Ordering::Relaxed);
    }
}

/// Operations of a real transform of `length` numbers, forward or inverse.
pub(crate) fn real_transform(length: usize) -> usize {
    5 * length * length.trailing_zeros() as usize / 2
}
