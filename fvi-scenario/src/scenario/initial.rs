//! `[initial]`: where the system starts.

use super::system::System;
use crate::language::document::Table;
use crate::language::error::InputError;
use serde::Serialize;

/// Position and momentum at t = 0.
#[derive(Clone, Debug, Serialize)]
pub struct InitialState {
    /// q₀.
    pub position: Vec<f64>,
    /// p₀ = M v₀.
    pub momentum: Vec<f64>,
}

impl InitialState {
    /// Rest at the origin.
    pub(super) fn at_rest(count: usize) -> Self {
        Self { position: vec![0.0; count], momentum: vec![0.0; count] }
    }

    /// Reads the keys; without momentum and velocity it is at rest.
    pub(super) fn read(table: &Table<'_>, system: &System) -> Result<Self, InputError> {
        table.allow(&["position", "momentum", "velocity"])?;
        let count = system.coordinates();
        let position = table.required("position")?.vector(count)?;
        if table.optional("momentum").or(table.optional("velocity")).is_none() {
            return Ok(Self { position, ..Self::at_rest(count) });
        }
        let (is_momentum, value) = table.either("momentum", "velocity")?;
        let given = value.vector(count)?;
        let momentum = if is_momentum { given } else { system.mass.times(&given) };
        if momentum.iter().any(|entry| !entry.is_finite()) {
            return Err(value.out_of_range("a velocity whose momentum M v is finite"));
        }
        Ok(Self { position, momentum })
    }
}
