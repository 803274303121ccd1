//! The memory of an operator of order zero, which has no state.

use core::marker::PhantomData;

use crate::memory::{ActsOn, Memory, MemoryError, check_channels};
use crate::real::Real;
use crate::saving::{StateError, StateReader, StateWriter, Stateful};

/// The memory of D⁰, the identity: W₀ = 1, and no other weights.
///
/// With it a [`FractionalIntegral`](crate::FractionalIntegral) is an integral of order 1, a plain
/// accumulator, at equal steps and at steps of any length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Memoryless<T> {
    scalar: PhantomData<T>,
    len: usize,
}

impl<T: Real> Memoryless<T> {
    /// A memory without samples.
    pub fn new() -> Self {
        Self { scalar: PhantomData, len: 0 }
    }
}

impl<T: Real> Default for Memoryless<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Real> Memory<T> for Memoryless<T> {
    fn channels(&self) -> usize {
        1
    }

    fn acts_on(&self) -> ActsOn {
        ActsOn::Values
    }

    fn leading(&self) -> &[T] {
        T::IDENTITY
    }

    /// The number of samples, at most the largest `usize`.
    fn len(&self) -> usize {
        self.len
    }

    #[inline]
    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        check_channels(1, term.len())?;
        term.fill(T::zero());
        Ok(())
    }

    #[inline]
    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        check_channels(1, sample.len())?;
        self.len = self.len.saturating_add(1);
        Ok(())
    }

    fn clear(&mut self) {
        self.len = 0;
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
    }
}

impl<T: Real> Stateful for Memoryless<T> {
    fn state_bytes(&self) -> usize {
        8
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.count(self.len as u64)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.count().map(|_| ())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.len = usize::try_from(from.count()?).unwrap_or(usize::MAX);
        Ok(())
    }
}
