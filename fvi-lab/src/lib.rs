#![doc = include_str!("../README.md")]
//!
//! | layer | content |
//! |---|---|
//! | [`results`] | trajectories, summaries, pictures, the files they go to |
//! | [`lab`] | runs, orders of convergence, sweeps, two-point problems |
//!
//! The feature `pictures` adds the pictures of runs and studies.
#![forbid(unsafe_code)]

pub mod lab;
pub mod results;
