//! What a scenario of fractional mechanics says, and the tables that its kernels are made of.
//!
//! | layer | what it knows |
//! |---|---|
//! | [`language`] | documents, expressions, errors that point at a place in a file |
//! | [`numerics`] | tables of exponentials, weights of Runge–Kutta quadrature, starting weights |
//! | [`scenario`] | what a scenario says, as plain data |
#![forbid(unsafe_code)]

pub mod language;
pub mod numerics;
pub mod scenario;
