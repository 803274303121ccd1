//! Velocities and energies of given positions and momenta.

use super::mechanism::velocity_of;
use crate::model::{Mechanism, Model};
use fvi_core::{Lagrangian, Mechanics};
use fvi_scenario::language::InputError;
use fvi_scenario::scenario::{Scenario, SymmetricMatrix};

/// What position and momentum tell: the velocity M⁻¹p and the energy ½ pᵀM⁻¹p + U(q); of a mechanism the
/// velocity with L_v(q, v) = p on its constraints and the energy L_vᵀ v − L.
pub struct StateQuantities(System);

enum System {
    Straight(Box<Model<f64>>, Vec<usize>),
    Mechanism(Box<Mechanism<f64>>),
}

impl StateQuantities {
    /// Of the states of a scenario.
    ///
    /// # Errors
    /// If its system cannot be made.
    pub fn new(scenario: &Scenario) -> Result<Self, InputError> {
        if scenario.is_mechanism() {
            let made = Mechanism::new(scenario).map_err(|error| super::bad_mass(scenario, &error))?;
            return Ok(Self(System::Mechanism(Box::new(made))));
        }
        let made = Model::new(scenario).map_err(|error| super::bad_mass(scenario, &error))?;
        Ok(Self(System::Straight(Box::new(made), scenario.system.massless())))
    }

    /// Writes the velocity, N numbers: NaN where the momentum does not tell it, which are coordinates without
    /// mass and mechanisms whose mass is singular for what their constraints allow.
    pub fn velocity(&mut self, position: &[f64], momentum: &[f64], velocity: &mut [f64]) {
        match &mut self.0 {
            System::Straight(model, massless) => {
                model.velocity(momentum, velocity);
                massless.iter().for_each(|&row| velocity[row] = f64::NAN);
            }
            System::Mechanism(mechanism) => match velocity_of(mechanism, position, momentum) {
                Some(found) => velocity.copy_from_slice(&found),
                None => velocity.fill(f64::NAN),
            },
        }
    }

    /// The energy; NaN where a mechanism has no velocity.
    pub fn energy(&mut self, position: &[f64], momentum: &[f64]) -> f64 {
        match &mut self.0 {
            System::Straight(model, _) => model.energy(&position.to_vec(), &momentum.to_vec()),
            System::Mechanism(mechanism) => match velocity_of(mechanism, position, momentum) {
                Some(velocity) => mechanism.energy(position, &velocity),
                None => f64::NAN,
            },
        }
    }
}

/// True if velocities of the coordinates that a scenario writes do not follow from their momenta alone.
pub fn velocities_need_all_momenta(scenario: &Scenario) -> bool {
    let coupled = scenario.is_mechanism() || !matches!(scenario.system.mass, SymmetricMatrix::Diagonal(_));
    coupled && scenario.output.coordinates.is_some() && scenario.equation.is_none()
}
