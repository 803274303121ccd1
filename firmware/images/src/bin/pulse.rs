//! Prints the trajectory of the plate under a pulse, in single and in double precision.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use images::{Refused, main};
use scenarios::pulse;

#[entry]
fn start() -> ! {
    main(|out| pulse::run_both(out).map_err(|refusal| Refused::because(out, refusal)))
}
