//! Shared problems and measures of the cross-crate tests.
#![forbid(unsafe_code)]

pub mod reference;
