//! The state of objects as bytes, for a restart.

use fvi_core::{Fixed, Scheme, StateReader, StateWriter, Stateful};

use crate::operator::{FviOperator, Operator};
use crate::pointer::{check, slice, slice_mut};
use crate::status::{FviStatus, status};
use crate::stepper::{AtMainNodes, AtNode, Calls, FviStepper, Machine};
use crate::stored::kept;

/// Destination of a saved state: `capacity` bytes, and the address for the number of bytes written.
#[derive(Clone, Copy)]
pub(crate) struct ByteBuffer {
    pub(crate) bytes: *mut u8,
    pub(crate) capacity: usize,
    pub(crate) written: *mut usize,
}

impl ByteBuffer {
    /// Saves a state; with a capacity of 0 it only writes its size.
    ///
    /// # Safety
    /// As [`fvi_operator_save`].
    pub(crate) unsafe fn take(self, object: &impl Stateful) -> Result<(), FviStatus> {
        check(self.written)?;
        let size = object.state_bytes();
        if self.capacity != 0 {
            // SAFETY: promised by the caller.
            let bytes = unsafe { slice_mut(self.bytes, self.capacity) }?;
            let bytes = bytes.get_mut(..size).ok_or(FviStatus::WrongSize)?;
            object.save(&mut StateWriter::new(bytes))?;
        }
        // SAFETY: not NULL and aligned; writable as promised.
        unsafe { self.written.write(size) };
        Ok(())
    }
}

/// Restores a state that begins at `bytes`.
///
/// # Safety
/// As [`fvi_operator_restore`].
pub(crate) unsafe fn give(
    bytes: *const u8,
    count: usize,
    object: &mut impl Stateful,
) -> Result<(), FviStatus> {
    // SAFETY: promised by the caller.
    let bytes = unsafe { slice(bytes, count) }?;
    Ok(object.restore(&mut StateReader::new(bytes))?)
}

/// Saves an operator: writes its state to `bytes` and the number of bytes to `written`. With a capacity of 0
/// only the number of bytes that are needed at present is written; for rings it grows as they fill.
///
/// The bytes are the same on every machine. They contain no checksum; where stored bits can change, add one.
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE, or
/// FVI_STATUS_WRONG_SIZE if the capacity is too small; then nothing is written.
///
/// # Safety
/// `operation` must be zeroed or set up, `capacity` bytes and `written` writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_operator_save(
    operation: *const FviOperator,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStatus {
    status((|| {
        check(operation)?;
        // SAFETY: zeroed or set up, as promised.
        let operator = unsafe { kept::<Operator>(operation.cast_mut().cast()) }?;
        let place = ByteBuffer { bytes, capacity, written };
        // SAFETY: promised by the caller.
        unsafe { place.take(operator) }
    })())
}

/// Restores what fvi_operator_save wrote, into an operator that was set up with the same memory and start: it
/// then continues bit-identically. Bytes after the state, up to `count`, are ignored.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE, or
/// FVI_STATUS_WRONG_STATE if the bytes are not the state of such an operator, which is then unchanged.
///
/// # Safety
/// `operation` must be zeroed or set up, `count` bytes readable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_operator_restore(
    operation: *mut FviOperator,
    bytes: *const u8,
    count: usize,
) -> FviStatus {
    status((|| {
        check(operation)?;
        // SAFETY: zeroed or set up, as promised.
        let operator = unsafe { kept::<Operator>(operation.cast()) }?;
        // SAFETY: promised by the caller.
        unsafe { give(bytes, count, operator) }
    })())
}

/// # Safety
/// As [`fvi_stepper_save_1`].
unsafe fn save<const N: usize>(stepper: *const FviStepper, place: ByteBuffer) -> Result<(), FviStatus> {
    /// # Safety
    /// The storage must hold a `Machine<N, S>`.
    unsafe fn of<const N: usize, S: Scheme<f32, Fixed<N>>>(
        storage: *mut u64,
        place: ByteBuffer,
    ) -> Result<(), FviStatus> {
        // SAFETY: promised by the caller.
        let stepper = &unsafe { kept::<Machine<N, S>>(storage) }?.stepper;
        // SAFETY: promised by the caller.
        unsafe { place.take(stepper) }
    }
    let storage = stepper.cast_mut().cast::<u64>();
    // SAFETY: set up or zeroed, as promised; every `Machine` begins with its calls, and these say which it
    // is.
    unsafe {
        match kept::<Calls>(storage)?.kind {
            kind if kind == N as i32 => of::<N, AtMainNodes>(storage, place),
            kind if kind == -(N as i32) => of::<N, AtNode>(storage, place),
            _ => Err(FviStatus::WrongSize),
        }
    }
}

/// # Safety
/// As [`fvi_stepper_restore_1`].
unsafe fn restore<const N: usize>(
    stepper: *mut FviStepper,
    bytes: *const u8,
    count: usize,
) -> Result<(), FviStatus> {
    /// # Safety
    /// The storage must hold a `Machine<N, S>`.
    unsafe fn of<const N: usize, S: Scheme<f32, Fixed<N>>>(
        storage: *mut u64,
        bytes: *const u8,
        count: usize,
    ) -> Result<(), FviStatus> {
        // SAFETY: promised by the caller.
        let stepper = &mut unsafe { kept::<Machine<N, S>>(storage) }?.stepper;
        // SAFETY: promised by the caller.
        unsafe { give(bytes, count, stepper) }
    }
    let storage = stepper.cast::<u64>();
    // SAFETY: set up or zeroed, as promised; every `Machine` begins with its calls, and these say which it
    // is.
    unsafe {
        match kept::<Calls>(storage)?.kind {
            kind if kind == N as i32 => of::<N, AtMainNodes>(storage, bytes, count),
            kind if kind == -(N as i32) => of::<N, AtNode>(storage, bytes, count),
            _ => Err(FviStatus::WrongSize),
        }
    }
}

/// Saves a stepper for one coordinate: writes step, position, momentum and the state of its memory to
/// `bytes`, and the number of bytes to `written`. With a capacity of 0 only the number of bytes that are
/// needed at present is written; for rings it grows as they fill.
///
/// The bytes are the same on every machine. They contain no checksum; where stored bits can change, add one.
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE, or
/// FVI_STATUS_WRONG_SIZE if the capacity is too small or the stepper has another number of coordinates; then
/// nothing is written.
///
/// # Safety
/// `stepper` must come from fvi_stepper_init_n or fvi_stepper_init_at_node_n or point to zeroed storage,
/// `capacity` bytes and `written` be writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_save_1(
    stepper: *const FviStepper,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { save::<1>(stepper, ByteBuffer { bytes, capacity, written }) })
}

/// Restores what fvi_stepper_save_1 wrote, into a stepper set up in the same way, which then continues
/// bit-identically. System, scheme and damping order are not compared. Bytes after the state, up to `count`,
/// are ignored.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE,
/// FVI_STATUS_WRONG_SIZE if the stepper has another number of coordinates, or FVI_STATUS_WRONG_STATE if the
/// bytes are not the state of such a stepper, which is then unchanged.
///
/// # Safety
/// `stepper` must come from fvi_stepper_init_n or fvi_stepper_init_at_node_n or point to zeroed storage,
/// `count` bytes be readable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_restore_1(
    stepper: *mut FviStepper,
    bytes: *const u8,
    count: usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { restore::<1>(stepper, bytes, count) })
}

/// Saves a stepper for two coordinates, as fvi_stepper_save_1 does for one.
///
/// # Safety
/// As fvi_stepper_save_1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_save_2(
    stepper: *const FviStepper,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { save::<2>(stepper, ByteBuffer { bytes, capacity, written }) })
}

/// Restores what fvi_stepper_save_2 wrote, as fvi_stepper_restore_1 does for one coordinate.
///
/// # Safety
/// As fvi_stepper_restore_1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_restore_2(
    stepper: *mut FviStepper,
    bytes: *const u8,
    count: usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { restore::<2>(stepper, bytes, count) })
}

/// Saves a stepper for three coordinates, as fvi_stepper_save_1 does for one.
///
/// # Safety
/// As fvi_stepper_save_1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_save_3(
    stepper: *const FviStepper,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { save::<3>(stepper, ByteBuffer { bytes, capacity, written }) })
}

/// Restores what fvi_stepper_save_3 wrote, as fvi_stepper_restore_1 does for one coordinate.
///
/// # Safety
/// As fvi_stepper_restore_1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_restore_3(
    stepper: *mut FviStepper,
    bytes: *const u8,
    count: usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { restore::<3>(stepper, bytes, count) })
}

/// Saves a stepper for four coordinates, as fvi_stepper_save_1 does for one.
///
/// # Safety
/// As fvi_stepper_save_1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_save_4(
    stepper: *const FviStepper,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { save::<4>(stepper, ByteBuffer { bytes, capacity, written }) })
}

/// Restores what fvi_stepper_save_4 wrote, as fvi_stepper_restore_1 does for one coordinate.
///
/// # Safety
/// As fvi_stepper_restore_1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_restore_4(
    stepper: *mut FviStepper,
    bytes: *const u8,
    count: usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { restore::<4>(stepper, bytes, count) })
}

/// Saves a stepper for five coordinates, as fvi_stepper_save_1 does for one.
///
/// # Safety
/// As fvi_stepper_save_1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_save_5(
    stepper: *const FviStepper,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { save::<5>(stepper, ByteBuffer { bytes, capacity, written }) })
}

/// Restores what fvi_stepper_save_5 wrote, as fvi_stepper_restore_1 does for one coordinate.
///
/// # Safety
/// As fvi_stepper_restore_1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_restore_5(
    stepper: *mut FviStepper,
    bytes: *const u8,
    count: usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { restore::<5>(stepper, bytes, count) })
}

/// Saves a stepper for six coordinates, as fvi_stepper_save_1 does for one.
///
/// # Safety
/// As fvi_stepper_save_1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_save_6(
    stepper: *const FviStepper,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { save::<6>(stepper, ByteBuffer { bytes, capacity, written }) })
}

/// Restores what fvi_stepper_save_6 wrote, as fvi_stepper_restore_1 does for one coordinate.
///
/// # Safety
/// As fvi_stepper_restore_1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_restore_6(
    stepper: *mut FviStepper,
    bytes: *const u8,
    count: usize,
) -> FviStatus {
    // SAFETY: promised by the caller.
    status(unsafe { restore::<6>(stepper, bytes, count) })
}
