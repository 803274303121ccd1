#![doc = include_str!("../README.md")]
//!
//! | layer | contents |
//! |---|---|
//! | [`language`] | documents, expressions, errors that point at a place in a file |
//! | [`scenario`] | scenarios as plain data |
#![forbid(unsafe_code)]

pub mod language;
pub mod scenario;
