//! Mechanisms: any Lagrangian, holonomic constraints, and memory along elongations.

mod damper_row;
mod definite;
mod discrete_gradient;
mod gauss_lobatto;
mod integrator;
mod lagrangian;
mod relaxations;
mod step;
#[cfg(test)]
mod tests;

pub use damper_row::DamperRow;
pub use gauss_lobatto::{GaussLobatto, MOST_STAGES};
pub use integrator::{MechanismError, MechanismIntegrator};
pub use lagrangian::{Dampers, Lagrangian, Second};
pub use relaxations::{RelaxationTable, Relaxing};
