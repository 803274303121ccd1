//! Shared problems and measures of the cross-crate tests.
#![forbid(unsafe_code)]

pub mod conformance;
pub mod convergence;
pub mod manufactured;
pub mod motion;
pub mod reference;
pub mod stages;

/// The examples of the front page.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;
