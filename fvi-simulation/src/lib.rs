//! Scenarios in motion.
//!
//! | layer | what it knows |
//! |---|---|
//! | [`memory`] | the memory engines of the program |
//! | [`model`] | systems compiled to programs and matrices, schemes of any shape |
//! | [`simulation`] | a scenario in motion; its stability and its energy |
#![forbid(unsafe_code)]

pub mod memory;
pub mod model;
pub mod simulation;

use fvi_scenario::{language, numerics, scenario};
