//! Baselines for comparison with the engines: a reference in twice the precision, test signals, the plain
//! double sum, the textbook algorithm, and convolution of data known in advance as a lower bound.
//!
//! Baselines that are timed against the engines are in double precision only, so that they are compiled in
//! this crate, with the same options.

mod hls;
mod memory_term;
mod naive;
mod offline_fft;
mod signal;

pub use hls::Hls;
pub use memory_term::{MemoryTerm, memory_term};
pub use naive::Naive;
pub use offline_fft::OfflineFft;
pub use signal::Signal;
