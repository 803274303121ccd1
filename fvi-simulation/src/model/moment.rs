//! Conversion of instants of steps to moments of expressions.

use fvi_core::{Approach, Instant, Real};
use fvi_scenario::language::expression::Moment;

/// The moment at which expressions are evaluated for an instant.
pub fn moment<T: Real>(instant: Instant<T>) -> Moment<T> {
    match instant.approach {
        Approach::Inside => Moment::inside(instant.time),
        Approach::FromLeft => Moment::from_left(instant.time),
        Approach::FromRight => Moment::from_right(instant.time),
    }
}
