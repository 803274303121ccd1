//! Instructions counted by SysTick, which QEMU's `-icount` drives: 1.6 ticks of 25 MHz per instruction of 64
//! ns.

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;

const RELOAD: u32 = 0x00ff_ffff;

/// Counts the instructions of a piece of code.
pub struct Counter {
    timer: SYST,
    overhead: u32,
}

/// Mean and worst case of several runs.
#[derive(Clone, Copy, Default)]
pub struct Spread {
    total: u64,
    runs: u32,
    worst: u32,
}

impl Spread {
    /// Takes a run into account.
    pub fn add(&mut self, instructions: u32) {
        self.total += u64::from(instructions);
        self.runs += 1;
        self.worst = self.worst.max(instructions);
    }

    /// Mean.
    pub fn mean(&self) -> f32 {
        self.total as f32 / self.runs.max(1) as f32
    }

    /// Worst case.
    pub fn worst(&self) -> u32 {
        self.worst
    }
}

impl Counter {
    /// A counter that has measured its own cost.
    pub fn new(mut timer: SYST) -> Self {
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(RELOAD);
        timer.clear_current();
        timer.enable_counter();
        let mut counter = Self { timer, overhead: 0 };
        counter.overhead = counter.count(|| ());
        counter
    }

    /// Instructions that `work` takes; up to ten million.
    #[inline(always)]
    pub fn count(&mut self, work: impl FnOnce()) -> u32 {
        self.timer.clear_current();
        let before = SYST::get_current();
        work();
        let ticks = before.wrapping_sub(SYST::get_current()) & RELOAD;
        (ticks * 5 / 8).saturating_sub(self.overhead)
    }
}
