//! Fractional operators on a stream.

use fvi_core::{FractionalOperator, Start};

use crate::memory::{AnyMemory, FviMemory};
use crate::pointer::{check, reference};
use crate::status::{FviStatus, status};
use crate::stored::{Storable, keep, kept, words};

/// Start: nothing is subtracted; the operator of Riemann–Liouville type. Fractional integrals are of this
/// type.
pub const FVI_RIEMANN_LIOUVILLE: u32 = 0;
/// Start: the first sample is subtracted; the Caputo derivative of an order up to 1.
pub const FVI_CAPUTO: u32 = 1;
/// Start: the first sample and `rise` per step are subtracted; the Caputo derivative of an order between 1
/// and 2.
pub const FVI_CAPUTO_WITH_RISE: u32 = 2;

/// Number of 64-bit words of an operator.
pub const FVI_OPERATOR_WORDS: usize = 24;

/// A fractional operator on a stream: takes a sample x_k and returns Σ_{n=0}^{k} w_n x_{k−n}.
///
/// Set all words to zero before the first call.
#[repr(C)]
#[derive(Debug)]
pub struct FviOperator {
    /// Internal state; not to be accessed by the caller.
    pub words: [u64; FVI_OPERATOR_WORDS],
}

pub(crate) type Operator = FractionalOperator<f32, AnyMemory<1>>;

impl Storable for Operator {
    const TAG: u64 = 0x6676_692d_6f70_6572;
}

const _: () = assert!(words::<Operator>() <= FVI_OPERATOR_WORDS);

/// Sets up an operator on an empty memory.
///
/// `start` is FVI_RIEMANN_LIOUVILLE, FVI_CAPUTO or FVI_CAPUTO_WITH_RISE; `rise` is the initial slope times
/// the step size, for the last only. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE,
/// FVI_STATUS_OUT_OF_RANGE or FVI_STATUS_WRONG_SIZE if something is wrong with a pointer, a number or a size.
///
/// # Safety
/// `operation` must be writable, `memory` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_operator_init(
    operation: *mut FviOperator,
    memory: *const FviMemory,
    start: u32,
    rise: f32,
) -> FviStatus {
    status((|| {
        check(operation)?;
        let start = match start {
            FVI_RIEMANN_LIOUVILLE => Start::RiemannLiouville,
            FVI_CAPUTO => Start::Caputo,
            FVI_CAPUTO_WITH_RISE => Start::CaputoWithRise { rise },
            _ => return Err(FviStatus::OutOfRange),
        };
        // SAFETY: promised by the caller.
        let memory = unsafe { AnyMemory::<1>::new(reference(memory)?) }?;
        let value = Operator::new(memory, start)?;
        // SAFETY: the words are as many as the assertion above demands.
        unsafe { keep(operation.cast(), value) }
    })())
}

/// Takes a sample and writes the value of the operator to `result`.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE or
/// FVI_STATUS_MEMORY_FULL; then neither operator nor `result` has changed.
///
/// # Safety
/// `operation` must be zeroed or set up, `result` writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_operator_push(
    operation: *mut FviOperator,
    sample: f32,
    result: *mut f32,
) -> FviStatus {
    status((|| {
        check(result)?;
        check(operation)?;
        // SAFETY: zeroed or set up, as promised.
        let value = unsafe { kept::<Operator>(operation.cast()) }?.push(sample)?;
        // SAFETY: not NULL and aligned; writable as promised.
        unsafe { result.write(value) };
        Ok(())
    })())
}

/// Writes what fvi_operator_push would write, without changing the operator.
///
/// Returns what fvi_operator_push returns.
///
/// # Safety
/// As for fvi_operator_push.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_operator_peek(
    operation: *mut FviOperator,
    sample: f32,
    result: *mut f32,
) -> FviStatus {
    status((|| {
        check(result)?;
        check(operation)?;
        // SAFETY: zeroed or set up, as promised.
        let value = unsafe { kept::<Operator>(operation.cast()) }?.peek(sample)?;
        // SAFETY: not NULL and aligned; writable as promised.
        unsafe { result.write(value) };
        Ok(())
    })())
}

/// Takes a sample for each of two operators; on an error neither takes its sample.
///
/// Writes the two values to `results`. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED,
/// FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE, FVI_STATUS_MEMORY_FULL, or FVI_STATUS_OUT_OF_RANGE if
/// both are the same operator; then neither operator nor `results` has changed.
///
/// # Safety
/// `first` and `second` must be zeroed or set up, `samples` readable and `results` writable for two numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_operator_push_two(
    first: *mut FviOperator,
    second: *mut FviOperator,
    samples: *const f32,
    results: *mut f32,
) -> FviStatus {
    status((|| {
        check(results)?;
        check(first)?;
        check(second)?;
        if core::ptr::eq(first, second) {
            return Err(FviStatus::OutOfRange);
        }
        // SAFETY: readable as promised.
        let &[of_first, of_second] = unsafe { reference(samples.cast::<[f32; 2]>()) }?;
        // SAFETY: zeroed or set up, as promised; they are two.
        let (first, second) = unsafe { (kept::<Operator>(first.cast())?, kept::<Operator>(second.cast())?) };
        let (first, second) = (first.prepare(of_first)?, second.prepare(of_second)?);
        let values = [first.take()?, second.take()?];
        // SAFETY: not NULL and aligned; writable as promised.
        unsafe { results.cast::<[f32; 2]>().write(values) };
        Ok(())
    })())
}

/// Removes all samples.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.
///
/// # Safety
/// `operation` must be zeroed or set up.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_operator_clear(operation: *mut FviOperator) -> FviStatus {
    status((|| {
        check(operation)?;
        // SAFETY: zeroed or set up, as promised.
        unsafe { kept::<Operator>(operation.cast()) }?.clear();
        Ok(())
    })())
}
