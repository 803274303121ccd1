//! Simulation of scenarios.
//!
//! | layer | contents |
//! |---|---|
//! | [`model`] | systems compiled to programs and matrices, schemes of any shape |
//! | [`simulation`] | the simulation of a scenario; its stability and its energy |
#![forbid(unsafe_code)]

pub mod model;
pub mod simulation;

use fvi_memory::memory;
use fvi_scenario::{language, numerics, scenario};
