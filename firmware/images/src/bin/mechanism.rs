//! Prints the trajectory of a mass on a rod with a viscoelastic strut, in single and in double precision.
#![no_std]
#![no_main]

use images::{Refused, image};
use scenarios::mechanism;

image!(|out| mechanism::run_both(out).map_err(|refusal| Refused::because(out, refusal)));
