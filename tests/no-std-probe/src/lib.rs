//! Everything a controller calls, compiled without `std`. The panic handler calls a function that does not
//! exist: if the optimiser cannot prove it unreachable, its name stays among the undefined symbols of the
//! library.
//!
//! With the feature `seeded-panic` it is the negative control, built the same way: a function that can
//! panic, and none of the others, which take long to compile.
#![no_std]

#[cfg(not(feature = "seeded-panic"))]
mod everything;
#[cfg(feature = "seeded-panic")]
mod seeded;

use core::panic::PanicInfo;

unsafe extern "C" {
    fn fvi_reachable_panic() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    unsafe { fvi_reachable_panic() }
}
