//! Output and program end, common to the images.
#![no_std]

#[cfg(feature = "cycles")]
pub mod cycles;
pub mod instructions;
pub mod spread;
pub mod stack;

use core::fmt;
use core::panic::PanicInfo;

use cortex_m as _;
use cortex_m_semihosting::{debug, hio};

/// Runs `program` on the debugger's standard output and ends the emulation: with success if it does.
pub fn main(program: impl FnOnce(&mut hio::HostStream) -> Result<(), Refused>) -> ! {
    let status = match hio::hstdout().map_err(|()| Refused).and_then(|mut out| program(&mut out)) {
        Ok(()) => debug::EXIT_SUCCESS,
        Err(Refused) => debug::EXIT_FAILURE,
    };
    loop {
        debug::exit(status);
    }
}

/// The program could not continue; the reason has been printed.
pub struct Refused;

impl Refused {
    /// Prints the reason.
    pub fn because(out: &mut hio::HostStream, reason: impl fmt::Display) -> Self {
        // If this fails as well, only the exit status reports the error.
        let _ = fmt::Write::write_fmt(out, format_args!("refused: {reason}\n"));
        Self
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    main(|out| Err(Refused::because(out, info)))
}
