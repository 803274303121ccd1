//! `[initial]`: the initial state.

use super::keys;
use super::past::Past;
use super::system::System;
use crate::language::document::Table;
use crate::language::error::InputError;
use serde::Serialize;

/// Position and momentum at the start, and the motion before it.
#[derive(Clone, Debug, Serialize)]
pub struct InitialState {
    /// q₀.
    pub position: Vec<f64>,
    /// p₀ = M v₀, or L_v(q₀, v₀); zero for coordinates without mass.
    pub momentum: Vec<f64>,
    /// The motion before the start, for the memories; absent: the system was at rest at q₀.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub past: Option<Past>,
    /// True for the state of an [`Equation`](super::Equation), whose keys are written in place of these.
    #[serde(skip)]
    pub of_equation: bool,
    /// True if position and velocity are moved onto the constraints first.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub project: bool,
}

impl InitialState {
    /// Rest at the origin.
    pub(super) fn at_rest(count: usize) -> Self {
        Self {
            position: vec![0.0; count],
            momentum: vec![0.0; count],
            past: None,
            of_equation: false,
            project: false,
        }
    }

    /// The state of the coordinates of an equation.
    pub(super) fn of_equation(position: Vec<f64>) -> Self {
        Self { of_equation: true, momentum: vec![0.0; position.len()], position, past: None, project: false }
    }

    /// True if it is written by the keys of an equation.
    pub(super) fn is_of_equation(&self) -> bool {
        self.of_equation
    }

    /// Reads the keys; without momentum and velocity it is at rest.
    pub(super) fn read(table: &Table<'_>, system: &System) -> Result<Self, InputError> {
        table.allow(&keys::INITIAL)?;
        let count = system.coordinates();
        let position = table.required("position")?.vector(count)?;
        let project = table.optional("project").map_or(Ok(false), |value| value.truth())?;
        if table.optional("momentum").or(table.optional("velocity")).is_none() {
            let momentum = system.momentum_at_start(&vec![0.0; count]);
            return Ok(Self { position, momentum, past: None, of_equation: false, project });
        }
        let (is_momentum, value) = table.either("momentum", "velocity")?;
        let given = value.vector(count)?;
        let momentum = if is_momentum { given.clone() } else { system.momentum_at_start(&given) };
        if momentum.iter().any(|entry| !entry.is_finite()) {
            return Err(value.out_of_range("a velocity whose momentum M v is finite"));
        }
        if let Some(massless) = system.massless().into_iter().find(|&index| given[index] != 0.0) {
            let what = if is_momentum { "momentum" } else { "velocity of its own at the start" };
            return Err(value.out_of_range(format!(
                "0 at coordinate {massless} (from 0), which has no mass and so no {what}; {} is given",
                given[massless]
            )));
        }
        Ok(Self { position, momentum, past: None, of_equation: false, project })
    }

    /// Steps of the past.
    pub fn past_steps(&self) -> usize {
        self.past.as_ref().map_or(0, Past::steps)
    }

    /// The position at which the motion of the memories begins, which Caputo's derivatives subtract: that at
    /// the beginning of the past, or q₀ without a past.
    pub fn base(&self) -> &[f64] {
        self.past.as_ref().map_or(&self.position, Past::first)
    }
}
