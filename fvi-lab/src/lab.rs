//! What is done with simulations: single runs, studies of convergence, comparisons, two-point problems.

pub mod checkpoint;
pub mod compare_engines;
pub mod converge;
pub mod fit;
mod output_sink;
pub mod response;
pub mod run;
pub mod sweep;
pub mod tune;
pub mod two_point;
