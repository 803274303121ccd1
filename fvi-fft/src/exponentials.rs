//! Weights of convolution quadrature as sums of exponentials.

#[doc(hidden)]
pub mod band_filter;
#[doc(hidden)]
pub mod band_table;
mod closed_pairs;
pub mod complex_exponential_table;
pub mod controller_source;
mod decays;
#[doc(hidden)]
pub mod exponential_table;
pub mod fixed_source;
mod jacobi_matrix;
#[doc(hidden)]
pub mod paired_source;
mod rate_rules;
#[doc(hidden)]
pub mod rate_table;
#[doc(hidden)]
pub mod rational_power;
#[doc(hidden)]
pub mod relaxation_table;
#[doc(hidden)]
pub mod rust_constants;
mod shorter_rules;
mod spectrum;
