//! Fractional variational integrators on the host.
#![forbid(unsafe_code)]

pub mod aligned;
pub mod command;
pub mod compare_engines;
pub mod converge;
pub mod energy_guard;
pub mod engine;
mod excerpt;
pub mod exponential_table;
pub mod expression;
pub mod files;
pub mod growing_ring;
pub mod measure;
pub mod model;
mod not_finite;
pub mod output_directory;
pub mod picture;
pub mod podlubny_matrix;
pub mod reproduce;
pub mod room;
pub mod run;
mod run_pictures;
pub mod runge_kutta_weights;
pub mod scenario;
pub mod simulation;
pub mod stability;
pub mod starting;
mod starting_defects;
pub mod tape;
pub mod trajectory;
pub mod two_point;
pub mod vectorised;
mod visible;

/// The examples of the page that introduces the crate.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
