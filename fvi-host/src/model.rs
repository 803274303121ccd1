//! A scenario's system and scheme as the core wants them: any number of coordinates, expressions compiled.

mod band;
mod force_moments;
mod mechanics;
mod own;
mod scenario_space;
mod scheme;
mod space;
pub mod tape;

pub use force_moments::ForceMoments;
pub use mechanics::{Model, matrix, vector};
pub use scenario_space::ScenarioSpace;
pub use scheme::{AnyScheme, DenseOutput, Room};
pub use space::{Dense, DenseEquations, Matrix, Pattern, Sparse};
