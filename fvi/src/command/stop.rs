//! Signals that end a run after the step under way: Ctrl-C, termination, hang-up.

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag::{register, register_conditional_shutdown};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use super::terminal;

/// Exit code of a run that was stopped.
pub(super) const STOPPED: u8 = 130;

/// How long a computation has to notice a signal, and how often the flag is looked at.
const PATIENCE: Duration = Duration::from_millis(800);
const GLANCE: Duration = Duration::from_millis(50);

/// A flag that the first signal sets; a second one ends the program at once, and so does the first one if a
/// computation that has nothing to keep does not notice it within a second.
///
/// A program started by `nohup` ignores hang-ups.
pub(super) fn flag() -> Arc<AtomicBool> {
    flag_of_steps(&Arc::default())
}

/// The same for a computation in steps that are kept, from when `begun` is set on: the step under way is
/// awaited, and the user is told that it is.
pub(super) fn flag_of_steps(begun: &Arc<AtomicBool>) -> Arc<AtomicBool> {
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
    let (asked, begun) = (Arc::clone(&stop), Arc::clone(begun));
    thread::spawn(move || {
        while !asked.load(Ordering::Relaxed) {
            thread::sleep(GLANCE);
        }
        thread::sleep(PATIENCE);
        if begun.load(Ordering::Relaxed) {
            terminal::mention(
                "note: stops after the step under way; a second signal ends the program at once\n",
            );
        } else {
            terminal::mention("fvi: stopped\n");
            std::process::exit(STOPPED.into());
        }
    });
    stop
}

/// Waits for a process, to which a stop is passed on.
#[cfg(feature = "research")]
pub(super) fn wait(
    child: &mut std::process::Child,
    stop: &AtomicBool,
) -> std::io::Result<std::process::ExitStatus> {
    let mut told = false;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if stop.load(Ordering::Relaxed) && !told {
            told = true;
            #[cfg(unix)]
            let _ = rustix::process::kill_process(
                rustix::process::Pid::from_child(child),
                rustix::process::Signal::INT,
            );
        }
        thread::sleep(GLANCE);
    }
}

/// True if the program was started with hang-ups ignored, where the system provides this information.
#[cfg(unix)]
fn hang_up_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    // Bit 0 stands for signal 1.
    mask >> (signal_hook::consts::SIGHUP - 1) & 1 == 1
}
