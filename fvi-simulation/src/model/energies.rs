//! The energies of many states of a motion.

use super::tape::{CompiledPotential, LANES, LaneRegisters};
use fvi_scenario::language::expression::Elementary;

/// Positions and momenta of many states, in columns: one column for each coordinate, with the distance
/// `stride` between columns.
#[derive(Clone, Copy, Debug)]
pub struct States<'a> {
    /// q.
    pub positions: &'a [f64],
    /// p.
    pub momenta: &'a [f64],
    /// At least the number of states.
    pub stride: usize,
}

/// Buffers for the computation of energies.
#[derive(Clone, Debug)]
pub struct EnergyRoom<T> {
    lanes: LaneRegisters<T>,
    registers: Vec<T>,
    position: Vec<T>,
}

impl<T> Default for EnergyRoom<T> {
    fn default() -> Self {
        Self { lanes: LaneRegisters::default(), registers: Vec::new(), position: Vec::new() }
    }
}

/// Number of states up to which they are computed one by one.
const FEW: usize = LANES / 4;

/// ½ Σ p_i²/m_i + U(q), for the reciprocals of the masses.
pub(super) fn write_plain<T: Elementary>(
    inverse_masses: &[T],
    potential: Option<&CompiledPotential<T>>,
    states: &States<'_>,
    room: &mut EnergyRoom<T>,
    energies: &mut [f64],
) {
    let stride = states.stride.max(1);
    for (index, energies) in energies.chunks_mut(LANES).enumerate() {
        let first = index * LANES;
        let columns = |numbers| columns_from(numbers, stride, first);
        let mut kinetic = [T::zero(); LANES];
        for (column, &inverse) in columns(states.momenta).zip(inverse_masses) {
            let energy = |p: T| p * (inverse * p);
            match column.first_chunk::<LANES>() {
                Some(momenta) => {
                    kinetic = core::array::from_fn(|lane| kinetic[lane] + energy(T::of(momenta[lane])))
                }
                // For large systems there are few states.
                None => kinetic.iter_mut().zip(column).for_each(|(sum, &p)| *sum += energy(T::of(p))),
            }
        }
        let place = |variables: &mut [[T; LANES]]| {
            for (variable, column) in variables.iter_mut().zip(columns(states.positions)) {
                match column.first_chunk::<LANES>() {
                    Some(numbers) => *variable = numbers.map(T::of),
                    None => variable.iter_mut().zip(column).for_each(|(place, &q)| *place = T::of(q)),
                }
            }
        };
        let heights = match potential {
            None => [T::zero(); LANES],
            Some(potential) if energies.len() > FEW => potential.values_along(&mut room.lanes, place),
            Some(potential) => {
                let EnergyRoom { registers, position, .. } = &mut *room;
                let mut heights = [T::zero(); LANES];
                for (index, height) in heights.iter_mut().enumerate().take(energies.len()) {
                    position.clear();
                    position.extend(columns(states.positions).map(|column| T::of(column[index])));
                    *height = potential.value(position, registers);
                }
                heights
            }
        };
        for ((energy, kinetic), height) in energies.iter_mut().zip(kinetic).zip(heights) {
            *energy = (T::of(0.5) * kinetic + height).to_f64();
        }
    }
}

/// The columns from a state on.
fn columns_from(numbers: &[f64], stride: usize, first: usize) -> impl Iterator<Item = &[f64]> {
    numbers.chunks_exact(stride).map(move |column| &column[first..])
}
