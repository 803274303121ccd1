//! What engines are compared with: a reference of twice the precision on telling signals, what people write
//! first, what the textbook says, and the bound of data known beforehand.
//!
//! What is timed against the engines is in double precision only, so that it is compiled here, as they are.

mod compensated_sum;
mod hls;
mod naive;
mod offline_fft;
mod signal;

pub use compensated_sum::{CompensatedSum, MemoryTerm, memory_term};
pub use hls::Hls;
pub use naive::Naive;
pub use offline_fft::OfflineFft;
pub use signal::Signal;
