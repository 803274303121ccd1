//! Fractional variational integrators on the host.
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
//! | [`fvi_lab`] | runs, studies, trajectories, pictures, and the files they go to |
//!
//! | module | content |
//! |---|---|
//! | `reproduce` | the figures and tables of the papers, computed again |
//! | `command` | the program `fvi` |
//!
//! The feature `program` adds the last module, with the dependencies for a terminal; `pictures` adds the
//! pictures of runs and studies, and `reproduce`. Both are on by default.
#![forbid(unsafe_code)]

#[cfg(feature = "program")]
pub mod command;
#[cfg(feature = "pictures")]
pub mod reproduce;

pub use {fvi_core, fvi_fft, fvi_lab, fvi_scenario, fvi_simulation};

/// The examples of the page that introduces the crate.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
