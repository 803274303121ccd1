//! Weights of convolution quadrature as sums of exponentials.

pub mod complex_exponential_table;
pub mod controller_source;
pub mod exponential_table;
mod rate_rules;
pub mod rate_table;
pub mod relaxation_table;
pub mod rust_constants;
mod spectrum;
