//! A memory as C describes it, and as the core knows it.

use core::mem::take;

use fvi_core::{
    ActsOn, Direct, ExponentialSum, ExponentialTable, Memory, MemoryError, Overflow, StateError, StateReader,
    StateWriter,
};

use crate::pointer::{slice, slice_mut};
use crate::ring::BufferRing;
use crate::status::FviStatus;

/// Kind of memory: a ring that takes as many samples as it holds and then refuses.
pub const FVI_FULL_MEMORY: u32 = 0;
/// Kind of memory: a ring that drops the oldest sample. The sum then lacks its far end.
pub const FVI_SHORT_MEMORY: u32 = 1;
/// Kind of memory: a head of weights and a sum of decaying exponentials. No ring, the same cost at every
/// step.
pub const FVI_EXPONENTIAL_SUM: u32 = 2;

/// Added to the kind of a memory: its weights are for increments, sums w_0 + … + w_n of those for values
/// (fvi_increment_weights_bdf), and lose less to rounding. Steppers know the increments without subtraction.
pub const FVI_ON_INCREMENTS: u32 = 0x100;

/// A memory: which, for which kernel, and on which buffer.
///
/// Tables and buffer stay in use until the last call on the object that was set up with them; the buffer must
/// belong to that object alone. The kernel is `scale` times the table. A new object has an empty memory,
/// whatever the buffer held.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviMemory {
    /// FVI_FULL_MEMORY, FVI_SHORT_MEMORY or FVI_EXPONENTIAL_SUM; with FVI_ON_INCREMENTS for weights on
    /// increments.
    pub kind: u32,
    /// Factor of all weights: 1 for weights that hold the step size, h^(-exponent) for a table made for
    /// h = 1.
    pub scale: f32,
    /// Weights w_0, w_1, … of a ring; the head of an exponential sum.
    pub weights: *const f32,
    /// Number of weights, at least 1; at least 2 for an exponential sum. Lags beyond a ring's weights count
    /// as zero.
    pub weight_count: usize,
    /// Exponential sum: the exponentials in blocks of four, four decays and four coefficients each. Rings
    /// ignore this and the next three.
    pub exponentials: *const f32,
    /// Exponential sum: how many numbers those are.
    pub exponential_count: usize,
    /// Exponential sum: how many blocks, from the first, hold slow exponentials.
    pub slow_blocks: usize,
    /// Exponential sum: largest lag at which the table holds; so many samples are taken.
    pub horizon: usize,
    /// The buffer. Ring: one sample per step and channel. Exponential sum: FVI_EXPONENTIAL_NUMBERS.
    pub buffer: *mut f32,
    /// Numbers in the buffer. A ring with c channels takes `buffer_count` / c samples.
    pub buffer_count: usize,
}

/// A memory with `C` channels on the caller's buffer.
#[derive(Debug)]
pub(crate) enum AnyMemory<const C: usize> {
    Ring(Direct<f32, &'static [f32], [BufferRing; C], BufferRing>),
    Exponential(ExponentialSum<f32, &'static [f32], &'static mut [f32]>),
}

impl<const C: usize> AnyMemory<C> {
    /// # Safety
    /// Tables and buffer must be as [`FviMemory`] says.
    pub(crate) unsafe fn new(memory: &FviMemory) -> Result<Self, FviStatus> {
        // SAFETY: passed on.
        let weights = unsafe { slice(memory.weights, memory.weight_count) }?;
        // SAFETY: passed on.
        let mut buffer = unsafe { slice_mut(memory.buffer, memory.buffer_count) }?;
        let on_increments = memory.kind & FVI_ON_INCREMENTS != 0;
        let acts_on = if on_increments { ActsOn::Increments } else { ActsOn::Values };
        let overflow = match memory.kind & !FVI_ON_INCREMENTS {
            FVI_FULL_MEMORY => Overflow::Refuse,
            FVI_SHORT_MEMORY => Overflow::Forget,
            FVI_EXPONENTIAL_SUM => {
                // SAFETY: passed on.
                let exponentials = unsafe { slice(memory.exponentials, memory.exponential_count) }?;
                let (slow_blocks, horizon) = (memory.slow_blocks, memory.horizon);
                let table = ExponentialTable { stages: 1, head: weights, exponentials, slow_blocks, horizon };
                if table.state_len(C) != buffer.len() {
                    return Err(FviStatus::WrongSize);
                }
                let sum = ExponentialSum::new(table, memory.scale, C, buffer)?;
                return Ok(Self::Exponential(sum.acting_on(acts_on)));
            }
            _ => return Err(FviStatus::OutOfRange),
        };
        let capacity = buffer.len() / C.max(1);
        if capacity == 0 || !buffer.len().is_multiple_of(C.max(1)) {
            return Err(FviStatus::WrongSize);
        }
        let rings = [(); C].map(|()| {
            let (ring, rest) = take(&mut buffer).split_at_mut_checked(capacity).unwrap_or_default();
            buffer = rest;
            BufferRing::new(ring)
        });
        Ok(Self::Ring(Direct::new(weights, 1, memory.scale, rings, overflow)?.acting_on(acts_on)))
    }
}

/// Hands a call to the memory there is.
macro_rules! each {
    ($memory:expr, $name:ident => $call:expr) => {
        match $memory {
            AnyMemory::Ring($name) => $call,
            AnyMemory::Exponential($name) => $call,
        }
    };
}

impl<const C: usize> Memory<f32> for AnyMemory<C> {
    fn channels(&self) -> usize {
        C
    }

    fn acts_on(&self) -> ActsOn {
        each!(self, memory => memory.acts_on())
    }

    fn leading(&self) -> &[f32] {
        each!(self, memory => memory.leading())
    }

    fn len(&self) -> usize {
        each!(self, memory => memory.len())
    }

    #[inline]
    fn next_term(&mut self, term: &mut [f32]) -> Result<(), MemoryError> {
        each!(self, memory => memory.next_term(term))
    }

    #[inline]
    fn push(&mut self, sample: &[f32]) -> Result<(), MemoryError> {
        each!(self, memory => memory.push(sample))
    }

    fn clear(&mut self) {
        each!(self, memory => memory.clear());
    }

    fn bytes(&self) -> usize {
        each!(self, memory => memory.bytes())
    }

    fn state_bytes(&self) -> usize {
        each!(self, memory => memory.state_bytes())
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        each!(self, memory => memory.save(to))
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        each!(self, memory => memory.check_state(from))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        each!(self, memory => memory.restore(from))
    }
}
