//! Values in storage of the caller, preceded by a tag with their type.

use core::mem::MaybeUninit;

use crate::pointer::check;
use crate::status::FviStatus;

/// Values that may lie in storage of the caller.
pub(crate) trait Storable: Sized {
    /// Identifies the type; differs from the content of storage that was never set up.
    const TAG: u64;
}

/// Layout of a value in the storage.
#[repr(C)]
struct Stored<V> {
    tag: u64,
    value: MaybeUninit<V>,
}

/// Number of words that a value needs.
pub(crate) const fn words<V>() -> usize {
    size_of::<Stored<V>>().div_ceil(size_of::<u64>())
}

/// Sets up the storage with a value.
///
/// # Safety
/// If the pointer is not NULL and aligned, [`words`]`::<V>()` words must lie there that nobody else uses.
pub(crate) unsafe fn keep<V: Storable>(storage: *mut u64, value: V) -> Result<(), FviStatus> {
    const { assert!(align_of::<Stored<V>>() <= align_of::<u64>()) };
    check(storage)?;
    let stored = Stored { tag: V::TAG, value: MaybeUninit::new(value) };
    // SAFETY: aligned and large enough for `Stored<V>`, as promised. What was there needs no drop.
    unsafe { storage.cast::<Stored<V>>().write(stored) };
    Ok(())
}

/// The value in the storage.
///
/// # Safety
/// If the pointer is not NULL and aligned, an initialised word must lie there; if it is the tag of `V`, then
/// [`keep`] must have put a `V`, or something that begins with one, there, and nobody else may use the
/// storage during `'a`.
pub(crate) unsafe fn kept<'a, V: Storable>(storage: *mut u64) -> Result<&'a mut V, FviStatus> {
    check(storage)?;
    // SAFETY: not NULL, aligned; initialised as promised.
    if unsafe { storage.read() } != V::TAG {
        return Err(FviStatus::NotInitialised);
    }
    // SAFETY: the tag says that `keep` has put a `V` here, or what begins with one.
    Ok(unsafe { (*storage.cast::<Stored<V>>()).value.assume_init_mut() })
}
