//! What a user of the program `fvi` relies on.

mod adaptive;
mod checkpoints;
mod controllers;
mod convergence;
mod dampers;
mod engine_comparison;
mod equations;
mod events;
mod extremals;
mod faults;
mod fits;
mod gradients;
mod grids;
#[cfg(target_os = "linux")]
mod hostile;
mod independent_trajectories;
mod large_systems;
mod limits;
mod listings;
mod memory_energies;
mod piecewise;
mod repository_scenarios;
mod reproduction;
mod response;
mod rough_inputs;
mod runs;
mod sampled_loop;
mod scenario_errors;
mod sensitivities;
mod stability;
mod strategies;
mod sweeps;
mod tune;
mod tune_bounds;
mod weights_of_files;
mod workplace;
