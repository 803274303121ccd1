//! A scenario's system and scheme as the core wants them: any number of coordinates, expressions compiled.

mod band;
mod mechanics;
mod scheme;
mod space;
pub mod tape;

pub use mechanics::{Model, matrix, vector};
pub use scheme::{AnyScheme, Room};
pub use space::{Dense, DenseEquations, Matrix, Pattern, Sparse};
