//! Stack use by painting: memory below the stack pointer is filled with a pattern, and afterwards searched
//! for the part that is unchanged.

const PATTERN: u32 = 0x5afe_57ac;

/// Number of bytes painted below the stack pointer.
const PAINTED: usize = 4096;

/// Number of bytes below the stack pointer that are not painted, for the frames of the painting itself.
const SPARED: usize = 128;

/// Bytes of stack used by `work`, up to 4 KiB; at least 128.
#[inline(never)]
pub fn used_by(work: impl FnOnce()) -> usize {
    let top = (stack_pointer() - SPARED) & !3;
    let bottom = top - PAINTED;
    for address in (bottom..top).step_by(4) {
        // SAFETY: unused memory below the stack; images have 4 MiB of it.
        unsafe { (address as *mut u32).write_volatile(PATTERN) };
    }
    work();
    let untouched = (bottom..top)
        .step_by(4)
        // SAFETY: written above.
        .take_while(|&address| unsafe { (address as *const u32).read_volatile() } == PATTERN)
        .count();
    PAINTED - 4 * untouched + SPARED
}

#[cfg(target_arch = "arm")]
fn stack_pointer() -> usize {
    cortex_m::register::msp::read() as usize
}

#[cfg(target_arch = "riscv32")]
fn stack_pointer() -> usize {
    let pointer;
    // SAFETY: reads a register.
    unsafe { core::arch::asm!("mv {}, sp", out(reg) pointer, options(nomem, nostack, preserves_flags)) };
    pointer
}
