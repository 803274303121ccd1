//! Scenarios in motion.
//!
//! | layer | what it knows |
//! |---|---|
//! | [`model`] | systems compiled to programs and matrices, schemes of any shape |
//! | [`simulation`] | a scenario in motion; its stability and its energy |
#![forbid(unsafe_code)]

pub mod model;
pub mod simulation;

use fvi_memory::memory;
use fvi_scenario::{language, numerics, scenario};
