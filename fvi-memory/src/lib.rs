//! Memory engines on a host: one for a request.
//!
//! | layer | contents |
//! |---|---|
//! | [`memory`] | the memory engines of the program |
#![forbid(unsafe_code)]

pub mod memory;

use fvi_scenario::{numerics, scenario};
