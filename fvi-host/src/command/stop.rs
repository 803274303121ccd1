//! Signals that end a run after the step under way: Ctrl-C, termination, hang-up.

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag::{register, register_conditional_shutdown};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Exit code of a run that was stopped.
pub(super) const STOPPED: u8 = 130;

/// A flag that the first signal sets; a second one ends the program at once.
///
/// A program started by `nohup` ignores hang-ups.
pub(super) fn flag() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let mut signals = vec![SIGINT, SIGTERM];
    #[cfg(unix)]
    if !hang_up_is_ignored() {
        signals.push(signal_hook::consts::SIGHUP);
    }
    for signal in signals {
        // If registration fails the signal still ends the program, but at once.
        let _ = register_conditional_shutdown(signal, STOPPED.into(), Arc::clone(&stop));
        let _ = register(signal, Arc::clone(&stop));
    }
    stop
}

/// Whether the program was started with hang-ups ignored, where the system provides this information.
#[cfg(unix)]
fn hang_up_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    // Bit 0 stands for signal 1.
    mask >> (signal_hook::consts::SIGHUP - 1) & 1 == 1
}
