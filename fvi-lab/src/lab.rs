//! What is done with simulations: single runs, studies of convergence, two-point problems.

pub mod checkpoint;
pub mod converge;
pub mod fit;
mod output_sink;
pub mod response;
pub mod run;
pub mod sweep;
pub mod tune;
pub mod two_point;
