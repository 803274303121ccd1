//! The graph of a computation: every distinct value once.

use super::operation::Operation;
use fvi_scenario::language::expression::LARGEST_MULTIPLIED;
use std::collections::HashMap;

/// A value of the graph, by its index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Value(pub(super) u32);

/// Definition of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Origin {
    /// A number, by its bits.
    Constant(u64),
    Time,
    SidedTime,
    Variable(u32),
    /// An operation on earlier values; operands beyond its arity are `Value(0)`.
    Computed(Operation, [Value; 3]),
}

/// Values in an order in which they can be computed, none of them twice.
///
/// Simplifications change no bit of a finite result except the sign of a zero: x·1, x + 0, products and
/// quotients of negatives, division by a power of two, operations on numbers. Sums are never reordered.
#[derive(Clone, Debug, Default)]
pub(super) struct Graph {
    origins: Vec<Origin>,
    /// The values by their origins; empty for few values, which are found faster one by one.
    places: HashMap<Origin, Value>,
}

/// Number of values from which they are found by their origins.
const MANY: usize = 16;

impl Graph {
    pub(super) fn len(&self) -> usize {
        self.origins.len()
    }

    /// True if the time occurs in it.
    pub(super) fn knows_time(&self) -> bool {
        self.origins.iter().any(|origin| matches!(origin, Origin::Time | Origin::SidedTime))
    }

    pub(super) fn origin(&self, value: Value) -> Origin {
        self.origins[value.0 as usize]
    }

    /// The number, if the value is a constant.
    pub(super) fn number(&self, value: Value) -> Option<f64> {
        match self.origin(value) {
            Origin::Constant(bits) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }

    pub(super) fn constant(&mut self, number: f64) -> Value {
        self.insert(Origin::Constant(number.to_bits()))
    }

    pub(super) fn insert(&mut self, origin: Origin) -> Value {
        let value =
            |index: usize| Value(u32::try_from(index).expect("fewer than 2³² values fit into the memory"));
        let found = match self.places.is_empty() {
            true => self.origins.iter().position(|known| *known == origin).map(value),
            false => self.places.get(&origin).copied(),
        };
        found.unwrap_or_else(|| {
            let new = value(self.origins.len());
            self.origins.push(origin);
            if self.origins.len() == MANY {
                self.places
                    .extend(self.origins.iter().enumerate().map(|(index, &known)| (known, value(index))));
            } else if self.origins.len() > MANY {
                self.places.insert(origin, new);
            }
            new
        })
    }

    fn compute(&mut self, operation: Operation, operands: &[Value]) -> Value {
        let mut all = [Value(0); 3];
        for (place, &operand) in all.iter_mut().zip(operands) {
            *place = operand;
        }
        let mut numbers = [0.0; 3];
        let mut pairs = numbers.iter_mut().zip(operands);
        let are_numbers = pairs.all(|(place, &operand)| match self.number(operand) {
            Some(number) => {
                *place = number;
                true
            }
            None => false,
        });
        match are_numbers {
            true => self.constant(operation.of(numbers)),
            false => self.insert(Origin::Computed(operation, all)),
        }
    }

    /// The operand, if the value is a negation.
    fn negated(&self, value: Value) -> Option<Value> {
        match self.origin(value) {
            Origin::Computed(Operation::Negate, [inner, ..]) => Some(inner),
            _ => None,
        }
    }

    fn is(&self, value: Value, number: f64) -> bool {
        self.number(value) == Some(number)
    }

    pub(super) fn negate(&mut self, x: Value) -> Value {
        match self.negated(x) {
            Some(inner) => inner,
            None => self.compute(Operation::Negate, &[x]),
        }
    }

    pub(super) fn add(&mut self, x: Value, y: Value) -> Value {
        if self.is(x, 0.0) {
            return y;
        }
        if self.is(y, 0.0) {
            return x;
        }
        match (self.negated(x), self.negated(y)) {
            (_, Some(y)) => self.subtract(x, y),
            (Some(x), None) => self.subtract(y, x),
            (None, None) => self.compute(Operation::Add, &[x.min(y), x.max(y)]),
        }
    }

    pub(super) fn subtract(&mut self, x: Value, y: Value) -> Value {
        if self.is(y, 0.0) {
            return x;
        }
        if self.is(x, 0.0) {
            return self.negate(y);
        }
        match (self.negated(x), self.negated(y)) {
            (_, Some(y)) => self.add(x, y),
            (Some(x), None) => {
                let sum = self.add(x, y);
                self.negate(sum)
            }
            (None, None) => self.compute(Operation::Subtract, &[x, y]),
        }
    }

    pub(super) fn multiply(&mut self, x: Value, y: Value) -> Value {
        if self.is(x, 1.0) {
            return y;
        }
        if self.is(y, 1.0) {
            return x;
        }
        if self.is(x, -1.0) {
            return self.negate(y);
        }
        if self.is(y, -1.0) {
            return self.negate(x);
        }
        self.without_signs(x, y, |graph, x, y| graph.compute(Operation::Multiply, &[x.min(y), x.max(y)]))
    }

    pub(super) fn divide(&mut self, x: Value, y: Value) -> Value {
        if let Some(divisor) = self.number(y)
            && is_power_of_two(divisor)
        {
            let reciprocal = self.constant(1.0 / divisor);
            return self.multiply(x, reciprocal);
        }
        self.without_signs(x, y, |graph, x, y| graph.compute(Operation::Divide, &[x, y]))
    }

    /// [`Operation::Scale`].
    pub(super) fn scale(&mut self, slope: Value, x: Value) -> Value {
        let ordinary = match (self.number(slope), self.number(x)) {
            (_, Some(x)) => x != 0.0,
            (Some(slope), None) => slope.is_finite(),
            (None, None) => false,
        };
        if ordinary {
            return self.multiply(slope, x);
        }
        self.without_signs(slope, x, |graph, slope, x| graph.compute(Operation::Scale, &[slope, x]))
    }

    /// A product or quotient of two values that may be negations.
    fn without_signs(
        &mut self,
        x: Value,
        y: Value,
        make: impl FnOnce(&mut Self, Value, Value) -> Value,
    ) -> Value {
        let (positive_x, positive_y) = (self.negated(x), self.negated(y));
        let made = make(self, positive_x.unwrap_or(x), positive_y.unwrap_or(y));
        if positive_x.is_some() == positive_y.is_some() { made } else { self.negate(made) }
    }

    /// x^e, with multiplications for a small integer exponent.
    pub(super) fn power(&mut self, x: Value, exponent: Value) -> Value {
        let Some(number) = self.number(exponent) else {
            return self.compute(Operation::Power, &[x, exponent]);
        };
        let magnitude = number.abs();
        if magnitude.fract() != 0.0 || magnitude > f64::from(LARGEST_MULTIPLIED) {
            return self.compute(Operation::Power, &[x, exponent]);
        }
        let one = self.constant(1.0);
        let (mut product, mut square, mut bits) = (one, x, magnitude as u32);
        while bits > 0 {
            if bits & 1 == 1 {
                product = self.multiply(product, square);
            }
            bits >>= 1;
            if bits > 0 {
                square = self.multiply(square, square);
            }
        }
        if number < 0.0 { self.divide(one, product) } else { product }
    }

    pub(super) fn call(&mut self, operation: Operation, x: Value) -> Value {
        self.compute(operation, &[x])
    }

    pub(super) fn compare(&mut self, operation: Operation, left: Value, right: Value) -> Value {
        self.compute(operation, &[left, right])
    }

    pub(super) fn pick(&mut self, choice: Value, left: Value, right: Value) -> Value {
        self.compute(Operation::Pick, &[choice, left, right])
    }
}

/// True if division by the number equals multiplication by its reciprocal, bit by bit, in single precision
/// too.
fn is_power_of_two(number: f64) -> bool {
    const MANTISSA: u64 = (1 << 52) - 1;
    number.to_bits() & MANTISSA == 0 && (1e-18..=1e18).contains(&number.abs())
}
