//! Prints the trajectory of the plate under a pulse, in single and in double precision.
#![no_std]
#![no_main]

use images::{Refused, image};
use scenarios::pulse;

image!(|out| pulse::run_both(out).map_err(|refusal| Refused::because(out, refusal)));
