//! Jumps and kinks in the position as switches: a system is smooth as long as no switch changes.

use super::tape::CompiledSides;
use fvi_scenario::language::expression::Elementary;
use serde::{Deserialize, Serialize};

/// Side on which a system is evaluated at a jump or kink with the argument g.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Side {
    /// As for g < 0, independently of g.
    Below,
    /// As for g > 0, independently of g.
    Above,
    /// A combination with the fraction a + b g of the upper side.
    Between {
        /// a
        share: f64,
        /// b
        slope: f64,
    },
}

impl Side {
    /// The side for a value of the argument; zero is above.
    pub fn of(value: f64) -> Self {
        if value < 0.0 { Self::Below } else { Self::Above }
    }

    /// The opposite side; `Between` is unchanged.
    pub fn other(self) -> Self {
        match self {
            Self::Below => Self::Above,
            Self::Above => Self::Below,
            Self::Between { .. } => self,
        }
    }

    /// The inputs a and b of the compiled programs.
    fn inputs(self) -> [f64; 2] {
        match self {
            Self::Below => [0.0, 0.0],
            Self::Above => [1.0, 0.0],
            Self::Between { share, slope } => [share, slope],
        }
    }
}

/// A system whose jumps and kinks in the position are numbered switches. Only [`set_sides`](Self::set_sides)
/// changes them.
pub trait Switched {
    /// Number of switches.
    fn switches(&self) -> usize {
        0
    }

    /// Sets the sides of all switches.
    fn set_sides(&mut self, _sides: &[Side]) {}

    /// Writes their arguments at a time and a position.
    fn arguments(&mut self, _time: f64, _position: &[f64], _values: &mut Vec<f64>) {}

    /// Writes the rates of change of the arguments: (Σ_i |∂g/∂q_i|, Σ_i |q_i ∂g/∂q_i|) of each.
    fn argument_scales(&mut self, _time: f64, _position: &[f64], _scales: &mut Vec<[f64; 2]>) {}

    /// The part of the potential with jumps and kinks, evaluated on the present sides.
    fn sided_potential(&mut self, _position: &[f64]) -> f64 {
        0.0
    }

    /// Description of a switch: the function with the jump or kink, and the key that contains it.
    fn describe_switch(&self, _index: usize) -> String {
        String::new()
    }
}

/// A buffer for a position and the inputs for the sides of a function's jumps and kinks.
#[derive(Clone, Debug)]
pub(super) struct SidedPoint<T> {
    sides: CompiledSides,
    /// Coordinates, followed by the inputs.
    numbers: Vec<T>,
    /// The same in double precision.
    doubles: Vec<f64>,
    registers: Vec<f64>,
}

impl<T: Elementary> SidedPoint<T> {
    /// The initial state with all sides below.
    pub(super) fn new(sides: CompiledSides) -> Self {
        let length = sides.coordinates() + 2 * sides.names().len();
        let (numbers, doubles) = (vec![T::zero(); length], vec![0.0; length]);
        Self { sides, numbers, doubles, registers: Vec::new() }
    }

    /// Number of jumps and kinks.
    pub(super) fn len(&self) -> usize {
        self.sides.names().len()
    }

    /// Name of the function with the jump or kink.
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

    /// The position followed by the inputs.
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

    /// Writes the rates of change of the arguments.
    pub(super) fn scales(&mut self, time: f64, position: &[f64], scales: &mut [[f64; 2]]) {
        self.doubles.iter_mut().zip(position).for_each(|(place, &number)| *place = number);
        self.sides.scales(time, &self.doubles, &mut self.registers, scales);
    }
}
