//! Memories: their description in C, and the memories of the core made from it.

use core::mem::take;

use fvi_core::{
    ActsOn, BdfOrder, Direct, ExponentialSum, ExponentialTable, Kernel, Memory, MemoryError, Memoryless,
    Overflow, StateError, StateReader, StateWriter, Stateful,
};

use crate::pointer::{reference, slice, slice_mut};
use crate::ring::BufferRing;
use crate::status::{FviStatus, status};

/// Kind of memory: a ring that takes as many samples as it has room for and then refuses further ones.
pub const FVI_FULL_MEMORY: u32 = 0;
/// Kind of memory: a ring that drops the oldest sample. The sum is then truncated at the largest lags.
pub const FVI_SHORT_MEMORY: u32 = 1;
/// Kind of memory: a head of weights and a sum of decaying exponentials. No ring, the same cost at every
/// step.
pub const FVI_EXPONENTIAL_SUM: u32 = 2;

/// Added to the kind of a memory: its weights are for increments, sums w_0 + … + w_n of those for values
/// (fvi_increment_weights_bdf), and the rounding error is smaller. Steppers have the increments without a
/// subtraction.
pub const FVI_ON_INCREMENTS: u32 = 0x100;

/// Added to FVI_EXPONENTIAL_SUM: past the horizon of its table the memory continues and drops older samples;
/// without it, it refuses samples there.
pub const FVI_FORGET_PAST_HORIZON: u32 = 0x200;

/// Horizon of a table of exponentials without an end.
pub const FVI_ENDLESS: u64 = u64::MAX;

/// A memory: its kind, its kernel, and its buffer.
///
/// Tables and buffer stay in use until the last call on the object that was set up with them; the buffer must
/// belong to that object alone. The kernel is `scale` times the table. A new object has an empty memory,
/// whatever the content of the buffer.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviMemory {
    /// FVI_FULL_MEMORY, FVI_SHORT_MEMORY or FVI_EXPONENTIAL_SUM; with FVI_ON_INCREMENTS for weights on
    /// increments, and for an exponential sum with FVI_FORGET_PAST_HORIZON.
    pub kind: u32,
    /// Factor of all weights: 1 for weights that contain the step size, h^(-exponent) for a table made for h
    /// = 1. fvi_memory_scale_bdf computes it.
    pub scale: f32,
    /// Weights w_0, w_1, … of a ring; the head of an exponential sum.
    pub weights: *const f32,
    /// Number of weights, at least 1; at least 2 for an exponential sum. Lags beyond a ring's weights count
    /// as zero.
    pub weight_count: usize,
    /// Exponential sum: the exponentials in blocks of four, four decays and four coefficients each. Rings
    /// ignore this and the next five.
    pub exponentials: *const f32,
    /// Exponential sum: number of floats in `exponentials`.
    pub exponential_count: usize,
    /// Exponential sum: number of blocks, from the first, with slow exponentials.
    pub slow_blocks: usize,
    /// Exponential sum: number of these, from the first, whose sums are stored in three parts.
    pub far_blocks: usize,
    /// Exponential sum: largest lag at which the table is accurate, and largest number of samples.
    /// FVI_ENDLESS for a table without an end.
    pub horizon: u64,
    /// Exponential sum: the step size contained in the weights; the scale must then be 1. 1 for a table that
    /// may be scaled to any step size, 0 if it is not known.
    pub step_size: f64,
    /// The buffer. Ring: one sample per step and channel. Exponential sum: FVI_EXPONENTIAL_NUMBERS.
    pub buffer: *mut f32,
    /// Numbers in the buffer. A ring with c channels takes `buffer_count` / c samples.
    pub buffer_count: usize,
}

/// Compares the weights of a memory with those of D^exponent by a backward differentiation formula at a step
/// size, sets the scale for which they agree, and sets FVI_ON_INCREMENTS if they are weights for increments.
///
/// A table that contains its step size is not scaled a second time; one made for h = 1 gets the right scale.
/// `order` is 1…6; −1 < exponent < 2. The first eight weights are compared. Returns FVI_STATUS_NULL,
/// FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE, or FVI_STATUS_OUT_OF_RANGE if a parameter is out of range,
/// the weights are those of another operator, or the table contains another step size; the memory is then
/// unchanged.
///
/// # Safety
/// `memory` must be as its type describes, and writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_memory_scale_bdf(
    memory: *mut FviMemory,
    order: u32,
    exponent: f64,
    step_size: f64,
) -> FviStatus {
    status((|| {
        // SAFETY: passed on.
        let FviMemory { kind, weights, weight_count, exponential_count, step_size: held, .. } =
            *unsafe { reference(memory.cast_const()) }?;
        // SAFETY: passed on.
        let weights = unsafe { slice(weights, weight_count) }?;
        let kernel = Kernel::bdf(BdfOrder::new(usize::try_from(order).unwrap_or(0))?, exponent, step_size)?;
        let sums = kind & 0xff == FVI_EXPONENTIAL_SUM;
        let (scale, acts_on) = kernel.scale_of(weights, sums && exponential_count == 0)?;
        let is_one = (scale - 1.0).abs() <= 64.0 * f32::EPSILON;
        // Weights made for a known step size must be those of this step size without scaling.
        let says = sums && held != 0.0 && held != 1.0;
        if says && ((held / step_size - 1.0).abs() > 4.0 * f64::from(f32::EPSILON) || !is_one) {
            return Err(FviStatus::OutOfRange);
        }
        let on_increments = if acts_on == ActsOn::Values { 0 } else { FVI_ON_INCREMENTS };
        // SAFETY: not NULL and aligned, as the reference was; writable as promised.
        unsafe {
            (*memory).scale = if is_one { 1.0 } else { scale };
            (*memory).kind = kind & !FVI_ON_INCREMENTS | on_increments;
        }
        Ok(())
    })())
}

/// A memory with `C` channels on the caller's buffer, or that of the identity, which needs none.
#[derive(Debug)]
pub(crate) enum AnyMemory<const C: usize> {
    Identity(Memoryless<f32>),
    Ring(Direct<f32, &'static [f32], [BufferRing; C], BufferRing>),
    Exponential(ExponentialSum<f32, &'static [f32], &'static mut [f32]>),
}

impl<const C: usize> AnyMemory<C> {
    /// # Safety
    /// Tables and buffer must be as described for [`FviMemory`].
    pub(crate) unsafe fn new(memory: &FviMemory) -> Result<Self, FviStatus> {
        // SAFETY: passed on.
        let weights = unsafe { slice(memory.weights, memory.weight_count) }?;
        // SAFETY: passed on.
        let mut buffer = unsafe { slice_mut(memory.buffer, memory.buffer_count) }?;
        let on_increments = memory.kind & FVI_ON_INCREMENTS != 0;
        let acts_on = if on_increments { ActsOn::Increments } else { ActsOn::Values };
        let kind = memory.kind & !FVI_ON_INCREMENTS;
        let overflow =
            match if kind & 0xff == FVI_EXPONENTIAL_SUM { kind & !FVI_FORGET_PAST_HORIZON } else { kind } {
                FVI_FULL_MEMORY => Overflow::Refuse,
                FVI_SHORT_MEMORY => Overflow::Forget,
                FVI_EXPONENTIAL_SUM => {
                    // SAFETY: passed on.
                    let exponentials = unsafe { slice(memory.exponentials, memory.exponential_count) }?;
                    let FviMemory { slow_blocks, far_blocks, horizon, .. } = *memory;
                    let step_size = if memory.step_size == 0.0 { 1.0 } else { memory.step_size };
                    let table = ExponentialTable {
                        stages: 1,
                        head: weights,
                        exponentials,
                        slow_blocks,
                        far_blocks,
                        horizon,
                        step_size,
                    };
                    if table.state_len(C) != buffer.len() {
                        return Err(FviStatus::WrongSize);
                    }
                    let forgets = memory.kind & FVI_FORGET_PAST_HORIZON != 0;
                    let past = if forgets { Overflow::Forget } else { Overflow::Refuse };
                    let sum = ExponentialSum::new(table, memory.scale, C, buffer)?.past_horizon(past)?;
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

/// Forwards a call to the memory of the enum.
macro_rules! each {
    ($memory:expr, $name:ident => $call:expr) => {
        match $memory {
            AnyMemory::Identity($name) => $call,
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

    fn expect_jumps(&mut self) {
        each!(self, memory => memory.expect_jumps());
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
}

impl<const C: usize> Stateful for AnyMemory<C> {
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
