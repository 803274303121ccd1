//! What is done with simulations: single runs, studies of convergence, comparisons, the papers' exhibits,
//! two-point problems.

pub mod checkpoint;
pub mod compare_engines;
pub mod converge;
mod outlet;
#[cfg(feature = "pictures")]
pub mod reproduce;
pub mod run;
pub mod sweep;
pub mod two_point;
