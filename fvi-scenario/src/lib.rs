//! Scenarios of fractional mechanics, and the numerical tables for their kernels.
//!
//! | layer | contents |
//! |---|---|
//! | [`language`] | documents, expressions, errors that point at a place in a file |
//! | [`numerics`] | tables of exponentials, weights of Runge–Kutta quadrature, starting weights |
//! | [`scenario`] | scenarios as plain data |
#![forbid(unsafe_code)]

pub mod language;
pub mod numerics;
pub mod scenario;
