//! What the pictures of a run are drawn from.

use crate::results::trace::{Envelope, PathTrace};
use crate::simulation::GridState;
use serde::{Deserialize, Serialize};

/// Curves gathered along a run, of bounded size.
#[derive(Serialize, Deserialize)]
pub(crate) struct RunTraces {
    pub(super) coordinates: Vec<Envelope>,
    pub(super) energy: Envelope,
    /// (q₀, p₀), for a single coordinate.
    pub(super) phase: Option<PathTrace>,
}

impl RunTraces {
    /// For as many coordinates as are drawn.
    pub(crate) fn new(coordinates: usize) -> Self {
        Self {
            coordinates: vec![Envelope::new(); coordinates],
            energy: Envelope::new(),
            phase: (coordinates == 1).then(PathTrace::new),
        }
    }

    /// Whether what was read could have been gathered along a run with so many coordinates.
    pub(crate) fn is_sound(&self, coordinates: usize) -> bool {
        (1..=coordinates).contains(&self.coordinates.len())
            && self.coordinates.iter().chain([&self.energy]).all(Envelope::is_sound)
            && self.phase.is_some() == (self.coordinates.len() == 1)
            && self.phase.iter().all(PathTrace::is_sound)
    }

    pub(crate) fn take(&mut self, state: &GridState) {
        for (envelope, &position) in self.coordinates.iter_mut().zip(&state.position) {
            envelope.push(state.time, position);
        }
        self.energy.push(state.time, state.energy);
        if let (Some(phase), [position], [momentum]) =
            (&mut self.phase, state.position.as_slice(), state.momentum.as_slice())
        {
            phase.push(*position, *momentum);
        }
    }
}
