//! Fractional variational integrators on the host.
//!
//! The modules are layers; each uses those above it in this list only, and a test reads that it does.
//!
//! | layer | what it knows |
//! |---|---|
//! | [`language`] | documents, expressions, errors that point at a place in a file |
//! | [`numerics`] | tables of exponentials, weights of Runge–Kutta quadrature, starting weights |
//! | [`scenario`] | what a scenario says, as plain data |
//! | [`memory`] | the memory engines of the program |
//! | [`model`] | systems compiled to programs and matrices, schemes of any shape |
//! | [`simulation`] | a scenario in motion; its stability and its energy |
//! | [`results`] | trajectories, summaries, pictures, the files they go to |
//! | [`lab`] | runs, orders of convergence, sweeps, two-point problems |
//! | `reproduce` | the figures and tables of the papers, computed again |
//! | `command` | the program `fvi` |
//!
//! The first three are those of `fvi-scenario`, the next one is that of `fvi-memory`, the next two are those
//! of `fvi-simulation`, and two more those of `fvi-lab`.
//!
//! `fvi-core`, whose traits your own engines implement, is here as [`fvi_core`]: one dependency is
//! enough.
//!
//! The feature `program` brings the last, with what it needs of a terminal; `pictures` brings those of runs
//! and studies and the reproduction of the papers. Both are on by default.
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
