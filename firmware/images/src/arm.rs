//! Cortex-M: instructions counted by SysTick, which QEMU's `-icount` drives: 1.6 ticks of 25 MHz per
//! instruction of 64 ns.

use cortex_m::Peripherals;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;

const RELOAD: u32 = 0x00ff_ffff;

/// Counts the instructions of a piece of code.
pub struct Counter {
    timer: SYST,
    overhead: u32,
}

impl Counter {
    /// A counter that has measured its own overhead; `None` if the timer is in use.
    pub fn new() -> Option<Self> {
        let mut timer = Peripherals::take()?.SYST;
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(RELOAD);
        timer.clear_current();
        timer.enable_counter();
        let mut counter = Self { timer, overhead: 0 };
        counter.overhead = counter.count(|| ());
        Some(counter)
    }

    /// Number of instructions of `work`; up to ten million.
    #[inline(always)]
    pub fn count(&mut self, work: impl FnOnce()) -> u32 {
        self.timer.clear_current();
        let before = SYST::get_current();
        work();
        let ticks = before.wrapping_sub(SYST::get_current()) & RELOAD;
        (ticks * 5 / 8).saturating_sub(self.overhead)
    }
}
