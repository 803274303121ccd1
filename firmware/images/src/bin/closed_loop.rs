//! Prints the trajectory of a stage under a fractional PID controller.
#![no_std]
#![no_main]

use images::{Refused, image};
use scenarios::closed_loop;

image!(|out| closed_loop::run(out).map_err(|refusal| Refused::because(out, refusal)));
