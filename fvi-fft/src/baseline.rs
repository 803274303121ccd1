//! Convolutions to compare with: what people write first, what the textbook says, and the bound of known data.

mod hls;
mod naive;
mod offline_fft;

pub use hls::Hls;
pub use naive::Naive;
pub use offline_fft::OfflineFft;
