//! Cycles counted by the DWT unit of a part, in place of the instructions that QEMU counts: the image `costs`
//! built with the feature `cycles` prints the table of `firmware/costs.csv` in cycles.
//!
//!     cargo build --release --package images --bin costs --features cycles
//!
//! Output goes through semihosting to the debugger. QEMU has no such unit and would count nothing. Caches,
//! prefetchers and wait states are as after start-up: configure the clock as the application does.

use cortex_m::Peripherals;
use cortex_m::peripheral::DWT;

/// Counts the cycles of a piece of code.
pub struct Counter {
    overhead: u32,
}

impl Counter {
    /// A counter that has measured its own overhead; `None` if the unit is in use.
    pub fn new() -> Option<Self> {
        let mut peripherals = Peripherals::take()?;
        peripherals.DCB.enable_trace();
        // On some processors the unit is locked until a key is written.
        DWT::unlock();
        peripherals.DWT.set_cycle_count(0);
        peripherals.DWT.enable_cycle_counter();
        let mut counter = Self { overhead: 0 };
        counter.overhead = counter.count(|| ());
        Some(counter)
    }

    /// Number of cycles of `work`; less than 2³².
    #[inline(always)]
    pub fn count(&mut self, work: impl FnOnce()) -> u32 {
        let before = DWT::cycle_count();
        work();
        DWT::cycle_count().wrapping_sub(before).saturating_sub(self.overhead)
    }
}
