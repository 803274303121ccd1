//! Conversion of the caller's pointers to slices and references, with the checks that are possible.

use crate::status::FviStatus;

/// Checks that a pointer is neither NULL nor misaligned.
pub(crate) fn check<T>(pointer: *const T) -> Result<(), FviStatus> {
    if pointer.is_null() {
        Err(FviStatus::Null)
    } else if !pointer.is_aligned() {
        Err(FviStatus::Misaligned)
    } else {
        Ok(())
    }
}

/// Checks that `count` numbers do not exceed the largest possible object.
fn check_size<T>(count: usize) -> Result<(), FviStatus> {
    match count.checked_mul(size_of::<T>()) {
        Some(bytes) if bytes <= isize::MAX as usize => Ok(()),
        _ => Err(FviStatus::OutOfRange),
    }
}

/// The object behind the pointer.
///
/// # Safety
/// If the pointer is not NULL and aligned, it must point to an initialised `T` that nobody changes during
/// `'a`.
pub(crate) unsafe fn reference<'a, T>(pointer: *const T) -> Result<&'a T, FviStatus> {
    check(pointer)?;
    // SAFETY: not NULL, aligned; the rest is the caller's promise.
    Ok(unsafe { &*pointer })
}

/// `count` numbers to read; with `count` 0 the pointer is ignored.
///
/// # Safety
/// If the pointer is not NULL and aligned, `count` initialised numbers must lie there that nobody changes
/// during `'a`.
pub(crate) unsafe fn slice<'a, T>(pointer: *const T, count: usize) -> Result<&'a [T], FviStatus> {
    if count == 0 {
        return Ok(&[]);
    }
    check(pointer)?;
    check_size::<T>(count)?;
    // SAFETY: not NULL, aligned, not larger than an object can be; the rest is the caller's promise.
    Ok(unsafe { core::slice::from_raw_parts(pointer, count) })
}

/// `count` numbers to read and write.
///
/// # Safety
/// If the pointer is not NULL and aligned, `count` initialised numbers must lie there that nobody else uses
/// during `'a`.
pub(crate) unsafe fn slice_mut<'a, T>(pointer: *mut T, count: usize) -> Result<&'a mut [T], FviStatus> {
    if count == 0 {
        return Ok(&mut []);
    }
    check(pointer)?;
    check_size::<T>(count)?;
    // SAFETY: not NULL, aligned, not larger than an object can be; the rest is the caller's promise.
    Ok(unsafe { core::slice::from_raw_parts_mut(pointer, count) })
}
