//! fvi-core for a page in the browser: the functions that JavaScript calls, and the memory that it reads and
//! writes.
//!
//! JavaScript writes [`Settings`] as numbers at [`settings`], calls [`motion`], [`controlled`] or
//! [`response`], and reads rows of numbers at [`rows`] and [`answer`]. There is no allocator: all data is in
//! one static object.
// With std on a host, for clippy.
#![cfg_attr(target_arch = "wasm32", no_std)]

mod oscillator;

use core::cell::UnsafeCell;

use oscillator::{Refusal, Row, SAMPLES, Settings, Tables};

/// All data that persists between calls.
struct Room {
    settings: Settings,
    tables: Tables,
    rows: [Row; SAMPLES],
    answer: [f64; 4],
    refusal: Option<Refusal>,
}

/// The data of a module, which has one thread.
struct Alone(UnsafeCell<Room>);

// SAFETY: a module compiled without threads is entered by one thread only, and no function here is
// re-entered, because none calls JavaScript.
unsafe impl Sync for Alone {}

static ROOM: Alone = Alone(UnsafeCell::new(Room {
    settings: Settings::ZERO,
    tables: Tables::EMPTY,
    rows: [[0.0; 3]; SAMPLES],
    answer: [0.0; 4],
    refusal: None,
}));

fn room() -> &'static mut Room {
    // SAFETY: see `Alone`; every exported function calls this once and keeps no reference.
    unsafe { &mut *ROOM.0.get() }
}

#[cfg(target_arch = "wasm32")]
#[panic_handler]
fn panicked(_: &core::panic::PanicInfo<'_>) -> ! {
    core::arch::wasm32::unreachable()
}

/// Address of the settings: the fields of [`Settings`] as numbers, in order.
#[unsafe(no_mangle)]
extern "C" fn settings() -> *mut Settings {
    &raw mut room().settings
}

/// Number of settings.
#[unsafe(no_mangle)]
extern "C" fn settings_len() -> usize {
    size_of::<Settings>() / size_of::<f64>()
}

/// Address of the rows of three numbers each: position, momentum, and external force.
#[unsafe(no_mangle)]
extern "C" fn rows() -> *const Row {
    room().rows.as_ptr()
}

/// Largest number of steps.
#[unsafe(no_mangle)]
extern "C" fn most_steps() -> usize {
    SAMPLES - 1
}

/// Computes the oscillator under its constant force; returns the number of rows. It is less than the number
/// of steps plus one if an error occurred.
#[unsafe(no_mangle)]
extern "C" fn motion() -> usize {
    let Room { settings, tables, rows, refusal, .. } = room();
    let mut written = 0;
    *refusal = oscillator::motion(settings, tables, rows, &mut written).err();
    written
}

/// Computes the oscillator under its controller; returns the number of rows, as [`motion`] does.
#[unsafe(no_mangle)]
extern "C" fn controlled() -> usize {
    let Room { settings, tables, rows, refusal, .. } = room();
    let mut written = 0;
    *refusal = oscillator::controlled(settings, tables, rows, &mut written).err();
    written
}

/// Computes P(iω) and C(iω) P(iω) at ω in radians per unit of time; returns the address of their real and
/// imaginary parts, or null on an error.
#[unsafe(no_mangle)]
extern "C" fn response(omega: f64) -> *const f64 {
    let Room { settings, answer, refusal, .. } = room();
    match oscillator::response(settings, omega) {
        Ok(found) => {
            (*answer, *refusal) = (found, None);
            answer.as_ptr()
        }
        Err(why) => {
            *refusal = Some(why);
            core::ptr::null()
        }
    }
}

/// Text of the last error: the setting or event (0), or the allowed values (1); empty if there was no error.
fn refused(part: usize) -> &'static str {
    match (&room().refusal, part) {
        (Some(refusal), 0) => refusal.what,
        (Some(refusal), _) => refusal.allowed,
        (None, _) => "",
    }
}

/// Address of the text of the last error: the setting or event (0), or the allowed values (1).
#[unsafe(no_mangle)]
extern "C" fn refused_text(part: usize) -> *const u8 {
    refused(part).as_ptr()
}

/// Length of that text in bytes of UTF-8; 0 if there was no error.
#[unsafe(no_mangle)]
extern "C" fn refused_len(part: usize) -> usize {
    refused(part).len()
}

/// The value that was refused; NaN if the error has no value.
#[unsafe(no_mangle)]
extern "C" fn refused_value() -> f64 {
    room().refusal.as_ref().map_or(f64::NAN, |refusal| refusal.value)
}
