//! Prints the trajectory of a stage under a fractional PID controller.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use images::{Refused, main};
use scenarios::closed_loop;

#[entry]
fn start() -> ! {
    main(|out| closed_loop::run(out).map_err(|refusal| Refused::because(out, refusal)))
}
