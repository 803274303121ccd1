//! What the pictures of a run are drawn from.

use crate::results::trace::{Envelope, PathTrace};
use serde::{Deserialize, Serialize};

/// Curves gathered along a run, of bounded size.
#[derive(Serialize, Deserialize)]
pub(crate) struct RunTraces {
    pub(super) coordinates: Vec<Envelope>,
    pub(super) energy: Envelope,
    /// (q₀, p₀), for a single coordinate.
    pub(super) phase: Option<PathTrace>,
    /// Output, setpoint and measured value of each controller.
    pub(super) control: Vec<Envelope>,
    /// Energies stored in memories, and dissipated by them.
    pub(super) memory: Vec<Envelope>,
}

impl RunTraces {
    /// For as many coordinates as are drawn, and controllers, and with the energies of memories.
    pub(crate) fn new(coordinates: usize, controllers: usize, memory: bool) -> Self {
        Self {
            coordinates: vec![Envelope::new(); coordinates],
            energy: Envelope::new(),
            phase: (coordinates == 1).then(PathTrace::new),
            control: vec![Envelope::new(); 3 * controllers],
            memory: vec![Envelope::new(); if memory { 2 } else { 0 }],
        }
    }

    /// Whether what was read could have been gathered along a run with so many coordinates.
    pub(crate) fn is_sound(&self, coordinates: usize) -> bool {
        (1..=coordinates).contains(&self.coordinates.len())
            && self.control.len().is_multiple_of(3)
            && matches!(self.memory.len(), 0 | 2)
            && self.coordinates.iter().chain(&self.control).chain(&self.memory).all(Envelope::is_sound)
            && self.energy.is_sound()
            && self.phase.is_some() == (self.coordinates.len() == 1)
            && self.phase.iter().all(PathTrace::is_sound)
    }

    /// Takes in times, the coordinates that are drawn, and the energies at all of them or at those that are
    /// known.
    pub(crate) fn take<'a>(
        &mut self,
        times: &[f64],
        mut coordinates: impl Iterator<Item = (&'a [f64], &'a [f64])>,
        (energies, with_energy): (&[f64], Option<impl Iterator<Item = usize>>),
    ) {
        for envelope in &mut self.coordinates {
            let Some((position, momentum)) = coordinates.next() else { break };
            envelope.push_all(times, position);
            if let Some(phase) = &mut self.phase {
                phase.push_all(position, momentum);
            }
        }
        let Some(with_energy) = with_energy else { return self.energy.push_all(times, energies) };
        for index in with_energy {
            self.take_energy(times[index], energies[index]);
        }
    }

    /// Takes in what the controllers saw and put out, at the last of these times.
    pub(crate) fn take_control(&mut self, times: &[f64], control: &[f64]) {
        let Some(time) = times.last() else { return };
        for (envelope, number) in self.control.iter_mut().zip(control) {
            envelope.push_all(&[*time], &[*number]);
        }
    }

    /// Takes in the energies of memories, at the last of these times.
    pub(crate) fn take_memory(&mut self, times: &[f64], memory: &[f64]) {
        let Some(time) = times.last() else { return };
        for (envelope, number) in self.memory.iter_mut().zip(memory) {
            envelope.push_all(&[*time], &[*number]);
        }
    }

    /// Takes in an energy by itself.
    pub(crate) fn take_energy(&mut self, time: f64, energy: f64) {
        self.energy.push_all(&[time], &[energy]);
    }
}
