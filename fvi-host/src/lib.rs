//! Fractional variational integrators on the host.
//!
//! The modules are layers; each uses only those above it in this list, which a test checks.
//!
//! | layer | content |
//! |---|---|
//! | [`language`] | documents, expressions, errors that point at a place in a file |
//! | [`numerics`] | tables of exponentials, weights of Runge–Kutta quadrature, starting weights |
//! | [`scenario`] | the content of a scenario, as plain data |
//! | [`memory`] | the memory engines of the program |
//! | [`model`] | systems compiled to programs and matrices, schemes of any shape |
//! | [`simulation`] | time integration of a scenario; its stability and energy |
//! | [`results`] | trajectories, summaries, pictures, the files they go to |
//! | [`lab`] | runs, orders of convergence, sweeps, two-point problems |
//! | `reproduce` | the figures and tables of the papers, computed again |
//! | `command` | the program `fvi` |
//!
//! The first three are those of `fvi-scenario`, the next one is that of `fvi-memory`, the next two are those
//! of `fvi-simulation`, and two more those of `fvi-lab`.
//!
//! `fvi-core`, whose traits your own engines implement, is re-exported as [`fvi_core`], so that one
//! dependency is enough.
//!
//! The feature `program` adds the last layer, with the dependencies for a terminal; `pictures` adds the
//! pictures of runs and studies, and `reproduce`. Both are on by default.
#![forbid(unsafe_code)]

#[cfg(feature = "program")]
pub mod command;
#[cfg(feature = "pictures")]
pub mod reproduce;

pub use fvi_core;
pub use fvi_lab::{lab, results};
pub use fvi_memory::memory;
pub use fvi_scenario::{language, numerics, scenario};
pub use fvi_simulation::{model, simulation};

/// The examples of the page that introduces the crate.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
