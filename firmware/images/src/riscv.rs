//! RISC-V: instructions counted by the register minstret, which QEMU's `-icount` makes exact.

use riscv::register::minstret;

/// Counts the instructions of a piece of code.
pub struct Counter {
    overhead: u32,
}

impl Counter {
    /// A counter that has measured its own overhead; always there.
    pub fn new() -> Option<Self> {
        let mut counter = Self { overhead: 0 };
        counter.overhead = counter.count(|| ());
        Some(counter)
    }

    /// Number of instructions of `work`; less than 2³².
    #[inline(always)]
    pub fn count(&mut self, work: impl FnOnce()) -> u32 {
        let before = minstret::read() as u32;
        work();
        (minstret::read() as u32).wrapping_sub(before).saturating_sub(self.overhead)
    }
}
