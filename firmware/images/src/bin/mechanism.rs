//! Prints the trajectory of a mass on a rod with a viscoelastic strut, in single and in double precision.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use images::{Refused, main};
use scenarios::mechanism;

#[entry]
fn start() -> ! {
    main(|out| mechanism::run_both(out).map_err(|refusal| Refused::because(out, refusal)))
}
