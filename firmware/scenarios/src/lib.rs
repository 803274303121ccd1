//! What the images compute, and their twins on the host from the same source: the two must agree in every
//! bit.
#![no_std]
#![forbid(unsafe_code)]

pub mod bits;
pub mod closed_loop;
pub mod control_loop;
pub mod jitter;
pub mod oustaloup;
pub mod pulse;
pub mod refusal;
pub mod tables;
