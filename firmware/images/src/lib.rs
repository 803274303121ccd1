//! Output, program end and measurement, common to the images. What differs between processors is in `arm`,
//! `riscv` and `stack`.
#![no_std]

#[cfg(all(target_arch = "arm", not(feature = "cycles")))]
#[path = "arm.rs"]
mod processor;
#[cfg(target_arch = "riscv32")]
#[path = "riscv.rs"]
mod processor;

#[cfg(feature = "cycles")]
mod cycles;
pub mod spread;
pub mod stack;

#[cfg(feature = "cycles")]
pub use cycles::Counter;
#[cfg(not(feature = "cycles"))]
pub use processor::Counter;

use core::fmt;
use core::panic::PanicInfo;

use semihosting::io::{Stdout, Write as _, stdout};
use semihosting::process::exit;

/// The debugger's standard output.
pub struct Output(Stdout);

impl fmt::Write for Output {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.write_all(text.as_bytes()).map_err(|_| fmt::Error)
    }
}

/// Makes a function that returns as [`main`] asks the program of an image.
#[macro_export]
macro_rules! image {
    ($program:expr) => {
        #[cfg_attr(target_arch = "arm", cortex_m_rt::entry)]
        #[cfg_attr(target_arch = "riscv32", riscv_rt::entry)]
        fn start() -> ! {
            $crate::main($program)
        }
    };
}

/// Runs `program` on the debugger's standard output and ends the emulation: with success if it does.
pub fn main(program: impl FnOnce(&mut Output) -> Result<(), Refused>) -> ! {
    match stdout().map_err(|_| Refused).and_then(|out| program(&mut Output(out))) {
        Ok(()) => exit(0),
        Err(Refused) => exit(1),
    }
}

/// The program could not continue; the reason has been printed.
pub struct Refused;

impl Refused {
    /// Prints the reason.
    pub fn because(out: &mut Output, reason: impl fmt::Display) -> Self {
        // If this fails as well, only the exit status reports the error.
        let _ = fmt::Write::write_fmt(out, format_args!("refused: {reason}\n"));
        Self
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    main(|out| Err(Refused::because(out, info)))
}
