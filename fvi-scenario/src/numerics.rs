//! Numerical methods that need an allocator or are applied once per run: tables for memories, weights,
//! benchmarks.

pub mod active;
pub mod algebra;
pub mod aligned;
pub mod column;
pub mod complex_exponential_table;
pub mod controller_source;
pub mod dense;
pub mod dual;
pub mod exponential;
pub mod exponential_table;
pub mod fractions;
pub mod growing_ring;
mod inverse;
mod kernel_defects;
pub mod laplace;
pub mod multistep_rule;
pub mod multistep_weights;
pub mod podlubny_matrix;
mod principal_cut;
mod rate_rules;
pub mod rate_table;
pub mod relaxation;
pub mod runge_kutta_derivative;
pub mod runge_kutta_weights;
pub mod rust_constants;
pub mod semidefinite;
mod spectrum;
pub mod staged_method;
pub mod starting;
pub mod starting_defects;
pub mod transfer;
pub mod transfer_derivative;
pub mod weight_table;

pub use staged_method::StagedMethod;
