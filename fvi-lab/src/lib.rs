//! Simulations at work.
//!
//! | layer | what it knows |
//! |---|---|
//! | [`results`] | trajectories, summaries, pictures, the files they go to |
//! | [`lab`] | runs, orders of convergence, sweeps, two-point problems |
//!
//! The feature `pictures` brings those of runs and studies.
#![forbid(unsafe_code)]

pub mod lab;
pub mod results;

use fvi_memory::memory;
use fvi_scenario::{language, numerics, scenario};
use fvi_simulation::{model, simulation};
