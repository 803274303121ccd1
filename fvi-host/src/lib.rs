//! Fractional variational integrators on the host.
#![forbid(unsafe_code)]

pub mod expression;
pub mod scenario;
