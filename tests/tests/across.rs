//! What a user relies on, across the crates: `cargo test -p fvi-tests --test across NAME` runs the tests of
//! one file.

mod collocation;
mod conformance;
mod documented_keys;
mod edges;
mod engines;
mod exponential_sum;
mod failures;
mod fractional_pid;
mod galerkin;
mod golden;
mod grids;
mod house;
mod kernels;
mod large_systems;
mod laws;
mod long_run;
mod node_form;
mod paired_source;
mod papers;
mod rounding;
mod runge_kutta;
mod two_point_coherence;
mod two_point_extremals;
mod variable_steps;
mod weights;
