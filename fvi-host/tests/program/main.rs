//! What a user of the program `fvi` relies on.

mod adaptive;
mod checkpoints;
mod controllers;
mod convergence;
mod engine_comparison;
mod events;
mod extremals;
mod faults;
mod grids;
mod independent_trajectories;
mod large_systems;
mod listings;
mod memory_energies;
mod piecewise;
mod repository_scenarios;
mod reproduction;
mod response;
mod rough_inputs;
mod runs;
mod scenario_errors;
mod sensitivities;
mod stability;
mod strategies;
mod sweeps;
mod weights_of_files;
mod workplace;
