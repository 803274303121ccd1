#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

#[cfg(feature = "pictures")]
pub mod reproduce;
pub mod two_point;
