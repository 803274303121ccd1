//! Data for the pictures of a run.

use crate::results::trace::{Envelope, PathTrace};
use serde::{Deserialize, Serialize};

/// Curves collected along a run, with bounded size.
#[derive(Serialize, Deserialize)]
pub(crate) struct RunTraces {
    pub(super) coordinates: Vec<Envelope>,
    pub(super) energy: Envelope,
    /// (q₀, p₀), for a single coordinate; (x₀, x₁), for several unknowns of an equation.
    pub(super) phase: Option<PathTrace>,
    /// Curves of the run's [`Columns`](fvi_simulation::simulation::columns::Columns).
    pub(super) columns: Vec<Envelope>,
}

impl RunTraces {
    /// Empty traces for the number of drawn coordinates and of columns, with a phase portrait or without.
    pub(crate) fn new(coordinates: usize, columns: usize, has_phase: bool) -> Self {
        Self {
            coordinates: vec![Envelope::new(); coordinates],
            energy: Envelope::new(),
            phase: has_phase.then(PathTrace::new),
            columns: vec![Envelope::new(); columns],
        }
    }

    /// True if traces read from a file are valid for a run with `coordinates` drawn coordinates.
    pub(crate) fn is_sound(&self, coordinates: usize) -> bool {
        (1..=coordinates).contains(&self.coordinates.len())
            && self.coordinates.iter().chain(&self.columns).all(Envelope::is_sound)
            && self.energy.is_sound()
            && self.phase.iter().all(PathTrace::is_sound)
    }

    /// Appends times, the drawn coordinates, and the energies with their times, which may be fewer.
    pub(crate) fn take<'a>(
        &mut self,
        times: &[f64],
        mut coordinates: impl Iterator<Item = &'a [f64]>,
        (energies, with_energy): (&[f64], Option<impl Iterator<Item = usize>>),
    ) {
        for envelope in &mut self.coordinates {
            let Some(position) = coordinates.next() else { break };
            envelope.push_all(times, position);
        }
        let Some(with_energy) = with_energy else { return self.energy.push_all(times, energies) };
        for index in with_energy {
            self.take_energy(times[index], energies[index]);
        }
    }

    /// Appends to the phase portrait.
    pub(crate) fn take_phase(&mut self, x: &[f64], y: &[f64]) {
        if let Some(phase) = &mut self.phase {
            phase.push_all(x, y);
        }
    }

    /// Appends the run's columns at the last of these times.
    pub(crate) fn take_columns(&mut self, times: &[f64], columns: &[f64]) {
        let Some(time) = times.last() else { return };
        for (envelope, number) in self.columns.iter_mut().zip(columns) {
            envelope.push_all(&[*time], &[*number]);
        }
    }

    /// Appends a single energy.
    pub(crate) fn take_energy(&mut self, time: f64, energy: f64) {
        self.energy.push_all(&[time], &[energy]);
    }
}
