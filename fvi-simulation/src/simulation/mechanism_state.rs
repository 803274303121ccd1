//! Velocities and energies of a mechanism at given positions and momenta.

use super::mechanism::velocity_of;
use crate::model::Mechanism;
use fvi_core::Lagrangian;
use fvi_scenario::language::InputError;
use fvi_scenario::scenario::Scenario;

/// What position and momentum of a mechanism tell: the velocity with L_v(q, v) = p on its constraints, and
/// the energy L_vᵀ v − L.
pub struct MechanismState(Mechanism<f64>);

impl MechanismState {
    /// Of the mechanism of a scenario.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn new(scenario: &Scenario) -> Result<Self, InputError> {
        Mechanism::new(scenario).map(Self).map_err(|error| super::bad_mass(scenario, &error))
    }

    /// The velocity; `None` where the mass is singular for what the constraints allow.
    pub fn velocity(&mut self, position: &[f64], momentum: &[f64]) -> Option<Vec<f64>> {
        velocity_of(&mut self.0, position, momentum)
    }

    /// The energy; `None` as for the velocity.
    pub fn energy(&mut self, position: &[f64], momentum: &[f64]) -> Option<f64> {
        let velocity = self.velocity(position, momentum)?;
        Some(self.0.energy(position, &velocity))
    }
}
