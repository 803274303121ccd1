//! Fractional variational integrators on the host.
#![forbid(unsafe_code)]

pub mod aligned;
pub mod command;
pub mod compare_engines;
pub mod converge;
pub mod engine;
pub mod exponential_table;
pub mod expression;
pub mod files;
pub mod growing_ring;
pub mod measure;
pub mod model;
pub mod picture;
pub mod podlubny_matrix;
pub mod reproduce;
pub mod run;
mod run_pictures;
pub mod runge_kutta_weights;
pub mod scenario;
pub mod simulation;
pub mod stage_stability;
pub mod starting;
pub mod trajectory;
pub mod two_point;
pub mod vectorised;
