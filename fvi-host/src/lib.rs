#![doc = include_str!("../README.md")]
//!
//! The crates below are re-exported, so that one dependency is enough; each uses only those above it in this
//! list.
//!
//! | crate | content |
//! |---|---|
//! | [`fvi_core`] | schemes and memories without `std` or allocation; the traits of your own engines |
//! | [`fvi_fft`] | K(s), its tables, and the memory engines |
//! | [`fvi_scenario`] | documents, expressions, the content of a scenario |
//! | [`fvi_simulation`] | time integration of a scenario; its stability and energy |
//!
//! | module | content |
//! |---|---|
//! | [`run`], [`checkpoint`] | a run that can be stopped and continued |
//! | [`batch`] | many runs of one scenario with other numbers, as arrays |
//! | [`gradient`] | derivatives of one function of a run by any number of parameters |
//! | [`converge`] | orders of convergence |
//! | [`sweep`] | one scenario with many values of some of its keys |
//! | [`fit`] | parameters from data |
//! | [`response`] | frequency response, poles |
//! | [`tune`] | fractional controllers for a plant |
//! | [`results`] | trajectories, summaries, pictures, and the files they go to |
//!
//! The feature `pictures`, on by default, adds the pictures of runs and studies.
#![forbid(unsafe_code)]

pub mod batch;
pub mod checkpoint;
pub mod converge;
pub mod fit;
pub mod gradient;
mod output_sink;
pub mod prelude;
pub mod response;
#[doc(hidden)]
pub mod results;
pub mod run;
pub mod sweep;
pub mod tune;

pub use {fvi_core, fvi_fft, fvi_scenario, fvi_simulation};
