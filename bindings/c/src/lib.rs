//! C interface of fvi-core: fractional operators on a stream, a fractional PID controller, and a stepper for
//! fractionally damped systems.
//!
//! All state is the caller's, of a size known at compile time; nothing is allocated, nothing unwinds, and
//! every call that can fail returns a status and leaves the state unchanged in that case. The header `fvi.h`
//! is generated from this crate.
#![no_std]

mod fixed_pid;
mod memory;
mod operator;
mod pid;
mod pointer;
mod ring;
mod saving;
mod status;
mod stepper;
mod stored;
mod weights;

pub use fixed_pid::*;
pub use memory::*;
pub use operator::*;
pub use pid::*;
pub use saving::*;
pub use status::*;
pub use stepper::*;
pub use weights::*;

/// Calls a function that does not exist: a program that could panic does not link. In an optimised build no
/// call of this interface can panic.
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    unsafe extern "C" {
        fn fvi_reachable_panic() -> !;
    }
    // SAFETY: the function does not exist, so a program that could call it does not link.
    unsafe { fvi_reachable_panic() }
}

/// The negative control of the panic check: an index that may be out of bounds.
#[cfg(feature = "seeded-panic")]
#[unsafe(no_mangle)]
pub extern "C" fn fvi_seeded_panic(index: usize) -> f32 {
    static NUMBERS: [f32; 2] = [1.0, 2.0];
    NUMBERS[index]
}
