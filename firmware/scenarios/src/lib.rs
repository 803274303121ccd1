//! Computations of the images and, from the same source, of their twins on the host: the results must be
//! bit-identical.
#![no_std]
#![forbid(unsafe_code)]

pub mod bits;
pub mod closed_loop;
pub mod control_loop;
pub mod jitter;
pub mod mechanism;
pub mod oustaloup;
pub mod pulse;
pub mod refusal;
pub mod tables;
