//! Jumps and kinks in the position as switches: a system is smooth while none of them is turned.

use super::tape::CompiledSides;
use crate::language::expression::Elementary;
use serde::{Deserialize, Serialize};

/// On which side of a jump or kink with the argument g a system is taken.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Side {
    /// As for g < 0, wherever g is.
    Below,
    /// As for g > 0.
    Above,
    /// Between them, in the share a + b g of what is above.
    Between {
        /// a
        share: f64,
        /// b
        slope: f64,
    },
}

impl Side {
    /// That of a value of the argument; zero is above.
    pub fn of(value: f64) -> Self {
        if value < 0.0 { Self::Below } else { Self::Above }
    }

    /// The other one; between stays.
    pub fn other(self) -> Self {
        match self {
            Self::Below => Self::Above,
            Self::Above => Self::Below,
            Self::Between { .. } => self,
        }
    }

    /// a and b.
    fn inputs(self) -> [f64; 2] {
        match self {
            Self::Below => [0.0, 0.0],
            Self::Above => [1.0, 0.0],
            Self::Between { share, slope } => [share, slope],
        }
    }
}

/// A system whose jumps and kinks in the position are switches. They are numbered; nothing turns them but
/// [`set_sides`](Self::set_sides).
pub trait Switched {
    /// How many there are.
    fn switches(&self) -> usize {
        0
    }

    /// Turns them.
    fn set_sides(&mut self, _sides: &[Side]) {}

    /// Writes their arguments at a time and a position.
    fn arguments(&mut self, _time: f64, _position: &[f64], _values: &mut Vec<f64>) {}

    /// Writes how fast they change: (Σ_i |∂g/∂q_i|, Σ_i |q_i ∂g/∂q_i|) of each.
    fn argument_scales(&mut self, _time: f64, _position: &[f64], _scales: &mut Vec<[f64; 2]>) {}

    /// The part of the potential that has jumps and kinks, as it is on the present sides.
    fn sided_potential(&mut self, _position: &[f64]) -> f64 {
        0.0
    }

    /// A switch in words: what jumps or has a kink, and where it is written.
    fn describe_switch(&self, _index: usize) -> String {
        String::new()
    }
}

/// Room for a position with the inputs that say the sides of a function's jumps and kinks.
#[derive(Clone, Debug)]
pub(super) struct SidedPoint<T> {
    sides: CompiledSides,
    /// Coordinates, then the inputs.
    numbers: Vec<T>,
    /// The same in double precision.
    doubles: Vec<f64>,
    registers: Vec<f64>,
}

impl<T: Elementary> SidedPoint<T> {
    /// All of them below.
    pub(super) fn new(sides: CompiledSides) -> Self {
        let length = sides.coordinates() + 2 * sides.names().len();
        let (numbers, doubles) = (vec![T::zero(); length], vec![0.0; length]);
        Self { sides, numbers, doubles, registers: Vec::new() }
    }

    /// How many jumps and kinks there are.
    pub(super) fn len(&self) -> usize {
        self.sides.names().len()
    }

    /// Name of the function that jumps, or has a kink.
    pub(super) fn name(&self, index: usize) -> &str {
        &self.sides.names()[index]
    }

    pub(super) fn set(&mut self, sides: &[Side]) {
        let first = self.sides.coordinates();
        let inputs = sides.iter().flat_map(|side| side.inputs());
        for ((number, double), input) in
            self.numbers[first..].iter_mut().zip(&mut self.doubles[first..]).zip(inputs)
        {
            (*number, *double) = (T::of(input), input);
        }
    }

    /// The position with the inputs behind it.
    #[inline]
    pub(super) fn at(&mut self, position: &[T]) -> &[T] {
        self.numbers.iter_mut().zip(position).for_each(|(place, &number)| *place = number);
        &self.numbers
    }

    /// Writes the arguments.
    pub(super) fn values(&mut self, time: f64, position: &[f64], values: &mut [f64]) {
        self.doubles.iter_mut().zip(position).for_each(|(place, &number)| *place = number);
        self.sides.values(time, &self.doubles, &mut self.registers, values);
    }

    /// Writes how fast they change.
    pub(super) fn scales(&mut self, time: f64, position: &[f64], scales: &mut [[f64; 2]]) {
        self.doubles.iter_mut().zip(position).for_each(|(place, &number)| *place = number);
        self.sides.scales(time, &self.doubles, &mut self.registers, scales);
    }
}
