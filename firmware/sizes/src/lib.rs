//! Entry points of controllers, each of which is linked alone to measure its flash.
//!
//! The panic handler calls a function that does not exist: what links cannot panic.
#![no_std]

use core::panic::PanicInfo;

use controllers::fractional::{FractionalLaw, FractionalPid, fractional_with, new_fractional};
use controllers::integer::{IntegerLaw, IntegerPid, integer_with};
use controllers::whole::{WholePid, new_whole};
use fvi_core::{PidGains, StateReader, StateWriter, Stateful as _};

unsafe extern "C" {
    fn reachable_panic() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: not linked, so never called.
    unsafe { reachable_panic() }
}

/// Orders 1, the law compiled in: a fresh controller.
#[unsafe(no_mangle)]
pub extern "Rust" fn integer_start(pid: &mut IntegerPid<IntegerLaw>) {
    if let Ok(fresh) = integer_with(IntegerLaw) {
        *pid = fresh;
    }
}

/// A tick of it; the last output where it is refused.
#[unsafe(no_mangle)]
pub extern "Rust" fn integer_tick(pid: &mut IntegerPid<IntegerLaw>, setpoint: f32, measured: f32) -> f32 {
    pid.tick(setpoint, measured).unwrap_or(pid.output())
}

/// Fractional orders, the law compiled in: a fresh controller.
#[unsafe(no_mangle)]
pub extern "Rust" fn fixed_start(pid: &mut FractionalPid<FractionalLaw>) {
    if let Ok(fresh) = fractional_with(FractionalLaw) {
        *pid = fresh;
    }
}

/// A tick of it; the last output where it is refused.
#[unsafe(no_mangle)]
pub extern "Rust" fn fixed_tick(pid: &mut FractionalPid<FractionalLaw>, setpoint: f32, measured: f32) -> f32 {
    pid.tick(setpoint, measured).unwrap_or(pid.output())
}

/// In whole numbers, within 1 % over five decades: a fresh controller.
#[unsafe(no_mangle)]
pub extern "Rust" fn whole_start(pid: &mut WholePid) {
    if let Ok(fresh) = new_whole() {
        *pid = fresh;
    }
}

/// A tick of it.
#[unsafe(no_mangle)]
pub extern "Rust" fn whole_tick(pid: &mut WholePid, setpoint: i32, measured: i32) -> i32 {
    pid.tick(setpoint, measured)
}

/// Fractional orders, a law that changes: a fresh controller.
#[unsafe(no_mangle)]
pub extern "Rust" fn changing_start(pid: &mut FractionalPid) {
    if let Ok(fresh) = new_fractional() {
        *pid = fresh;
    }
}

/// A tick of it; the last output where it is refused.
#[unsafe(no_mangle)]
pub extern "Rust" fn changing_tick(pid: &mut FractionalPid, setpoint: f32, measured: f32) -> f32 {
    pid.tick(setpoint, measured).unwrap_or(pid.output())
}

/// Other gains, without a bump.
#[unsafe(no_mangle)]
pub extern "Rust" fn changing_gains(pid: &mut FractionalPid, [proportional, integral, derivative]: [f32; 3]) {
    let _ = pid.set_gains(PidGains::Parallel { proportional, integral, derivative });
}

/// Manual and automatic.
#[unsafe(no_mangle)]
pub extern "Rust" fn changing_mode(pid: &mut FractionalPid, output: Option<f32>) {
    match output {
        Some(output) => {
            let _ = pid.manual(output);
        }
        None => pid.automatic(),
    }
}

/// Saves the state; true if there was room.
#[unsafe(no_mangle)]
pub extern "Rust" fn changing_save(pid: &FractionalPid, bytes: &mut [u8]) -> bool {
    pid.save(&mut StateWriter::new(bytes)).is_ok()
}

/// Restores the state; true if it was one.
#[unsafe(no_mangle)]
pub extern "Rust" fn changing_restore(pid: &mut FractionalPid, bytes: &[u8]) -> bool {
    pid.restore(&mut StateReader::new(bytes)).is_ok()
}
