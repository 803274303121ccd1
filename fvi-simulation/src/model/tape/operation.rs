//! The operations of a tape.

use core::cmp::Ordering;
use fvi_scenario::language::expression::{Elementary, Function, power};

/// An operation on one, two or three numbers.
///
/// The order of the variants has no meaning; it makes equal operations neighbours when they are sorted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Operation {
    Negate,
    Add,
    Subtract,
    Multiply,
    Divide,
    /// slope·x, and 0 for x = 0 even where the slope is infinite, as in the chain rule here, by which √(q²)
    /// has the derivative 0 at 0.
    Scale,
    /// x^e.
    Power,
    /// 1 if the smaller of two numbers is the left one, 0 if it is the right one, not-a-number if they are
    /// not comparable.
    LeftIsMin,
    /// The same for the larger.
    LeftIsMax,
    /// The angle of the point (y, x).
    Angle,
    /// (choice, left, right): left for 1, right for 0, their sum if the choice is not a number.
    Pick,
    /// A function of one argument.
    Call(Function),
    /// ψ.
    Digamma,
    /// ψ′.
    Trigamma,
}

impl Operation {
    /// Number of operands.
    pub(super) fn arity(self) -> usize {
        match self {
            Self::Negate | Self::Call(_) | Self::Digamma | Self::Trigamma => 1,
            Self::Add
            | Self::Subtract
            | Self::Multiply
            | Self::Divide
            | Self::Scale
            | Self::Power
            | Self::LeftIsMin
            | Self::LeftIsMax
            | Self::Angle => 2,
            Self::Pick => 3,
        }
    }

    /// Its value; operands beyond its arity are ignored.
    pub(super) fn of<T: Elementary>(self, [x, y, z]: [T; 3]) -> T {
        match self {
            Self::Negate => -x,
            Self::Add => x + y,
            Self::Subtract => x - y,
            Self::Multiply => x * y,
            Self::Divide => x / y,
            Self::Scale => scale(x, y),
            Self::Power => power(x, y),
            Self::LeftIsMin => left_unless(x, y, Ordering::Greater),
            Self::LeftIsMax => left_unless(x, y, Ordering::Less),
            Self::Angle => x.arc_tangent_of(y),
            Self::Pick => pick(x, y, z),
            Self::Call(function) => function.at(x),
            Self::Digamma => x.digamma_function(),
            Self::Trigamma => x.trigamma_function(),
        }
    }
}

#[inline]
pub(super) fn scale<T: Elementary>(slope: T, x: T) -> T {
    if x == T::zero() { x } else { slope * x }
}

fn left_unless<T: Elementary>(left: T, right: T, otherwise: Ordering) -> T {
    match left.partial_cmp(&right) {
        None => T::of(f64::NAN),
        Some(order) if order == otherwise => T::zero(),
        Some(_) => T::one(),
    }
}

fn pick<T: Elementary>(choice: T, left: T, right: T) -> T {
    if choice == T::one() {
        left
    } else if choice == T::zero() {
        right
    } else {
        left + right
    }
}
