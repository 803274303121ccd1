//! Several dampers of a mechanism.

use core::marker::PhantomData;

use crate::mechanism::lagrangian::Dampers;
use crate::memory::MemoryError;
use crate::real::Real;
use crate::saving::{StateError, StateReader, StateWriter, Stateful};
use crate::space::{part, part_from, parts_mut};

/// Dampers one after another along the elongations of a mechanism; `S` holds them.
#[derive(Clone, Copy, Debug, Default)]
pub struct DamperRow<D, S> {
    row: S,
    kind: PhantomData<D>,
}

impl<D, S: AsRef<[D]> + AsMut<[D]>> DamperRow<D, S> {
    /// The dampers of a row.
    pub fn new(row: S) -> Self {
        Self { row, kind: PhantomData }
    }

    /// The dampers.
    pub fn as_slice(&self) -> &[D] {
        self.row.as_ref()
    }
}

impl<T: Real, D: Dampers<T>, S: AsRef<[D]> + AsMut<[D]>> Dampers<T> for DamperRow<D, S> {
    fn elongations(&self) -> usize {
        self.as_slice().iter().map(D::elongations).sum()
    }

    fn begin(&mut self, mut velocities: &[T]) {
        for dampers in self.row.as_mut() {
            let count = dampers.elongations();
            dampers.begin(part(velocities, count));
            velocities = part_from(velocities, count);
        }
    }

    fn begin_step(&mut self, length: T) -> Result<(), MemoryError> {
        self.row.as_mut().iter_mut().try_for_each(|dampers| dampers.begin_step(length))
    }

    fn known(&self, mut forces: &mut [T]) {
        let stages = forces.len() / self.elongations().max(1);
        for dampers in self.as_slice() {
            let (own, rest) = parts_mut(core::mem::take(&mut forces), dampers.elongations() * stages);
            dampers.known(own);
            forces = rest;
        }
    }

    fn leading(&self, [mut row, mut column]: [usize; 2], nodes: [usize; 2]) -> T {
        for dampers in self.as_slice() {
            let count = dampers.elongations();
            match (row.checked_sub(count), column.checked_sub(count)) {
                (None, None) => return dampers.leading([row, column], nodes),
                (Some(later), Some(later_column)) => (row, column) = (later, later_column),
                // Of two dampers, each along its own elongations.
                _ => return T::zero(),
            }
        }
        T::zero()
    }

    fn push(&mut self, mut velocities: &[T]) {
        let stages = velocities.len() / self.elongations().max(1);
        for dampers in self.row.as_mut() {
            let count = dampers.elongations() * stages;
            dampers.push(part(velocities, count));
            velocities = part_from(velocities, count);
        }
    }

    fn excess(&self, [start, slope]: [&[T]; 2], excess: &mut [T]) {
        let mut rest = slope;
        let mut own_slope = |count| {
            let own = part(rest, count);
            rest = part_from(rest, count);
            own
        };
        each(self.as_slice(), start, excess, |dampers, start, excess| {
            dampers.excess([start, own_slope(dampers.elongations())], excess);
        });
    }

    fn sudden(&self, velocities: &[T], forces: &mut [T]) {
        each(self.as_slice(), velocities, forces, D::sudden);
    }

    fn stored(&self) -> T {
        self.as_slice().iter().fold(T::zero(), |sum, dampers| sum + dampers.stored())
    }
}

/// Lets each of the dampers write the numbers of its elongations.
fn each<T, D: Dampers<T>>(
    dampers: &[D],
    mut velocities: &[T],
    mut out: &mut [T],
    mut write: impl FnMut(&D, &[T], &mut [T]),
) {
    for dampers in dampers {
        let count = dampers.elongations();
        let (own, rest) = parts_mut(core::mem::take(&mut out), count);
        write(dampers, part(velocities, count), own);
        (velocities, out) = (part_from(velocities, count), rest);
    }
}

impl<D: Stateful, S: AsRef<[D]> + AsMut<[D]>> Stateful for DamperRow<D, S> {
    fn state_bytes(&self) -> usize {
        self.as_slice().iter().map(D::state_bytes).sum()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.as_slice().iter().try_for_each(|dampers| dampers.save(to))
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.as_slice().iter().try_for_each(|dampers| dampers.check_state(from))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.row.as_mut().iter_mut().try_for_each(|dampers| dampers.restore(from))
    }
}
