//! Scenarios of fractional mechanics: what a system is, read with the place of every error.
//!
//! | layer | contents |
//! |---|---|
//! | [`language`] | documents, expressions, errors that point at a place in a file |
//! | [`scenario`] | scenarios as plain data |
#![forbid(unsafe_code)]

pub mod language;
pub mod scenario;
