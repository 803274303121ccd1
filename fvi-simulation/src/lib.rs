#![doc = include_str!("../README.md")]
//!
//! | layer | contents |
//! |---|---|
//! | [`mod@column`] | reductions over a column of numbers |
//! | [`model`] | systems compiled to programs and matrices, schemes of any shape |
//! | [`simulation`] | the simulation of a scenario; its stability and its energy |
#![forbid(unsafe_code)]

#[doc(hidden)]
pub mod column;
#[doc(hidden)]
pub mod model;
pub mod simulation;
