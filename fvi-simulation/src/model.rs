//! A scenario's system and scheme as the core wants them: any number of coordinates, expressions compiled.

mod band;
mod chain;
mod channel_damping;
mod elements;
mod energies;
mod force_moments;
mod loads;
mod matrices;
mod mechanics;
mod one_point;
mod own;
mod rough_forces;
mod scenario_space;
mod scheme;
mod shared;
mod signal_moments;
mod space;
mod sparse;
pub mod tape;

pub use band::BandFactors;
pub use chain::ChainFactors;
pub use channel_damping::{ChannelDamping, Directions, HostTerm};
pub use elements::Elements;
pub use energies::{EnergiesAlong, EnergyRoom, States};
pub use force_moments::{ForceMoments, StepLengths};
pub use loads::Loads;
pub use matrices::{DenseEquations, DenseFactors, Matrix, Sparse};
pub use mechanics::{Model, SingleModel, matrix, moment, vector};
pub use one_point::{OnePoint, OnePointRoom};
pub(crate) use rough_forces::RoughForces;
pub use scenario_space::{Remembers, ScenarioSpace};
pub use scheme::{AnyScheme, DenseOutput, Room};
pub use shared::Shared;
pub use space::{AnyEquations, AnyFactors, AnySpace};
pub use sparse::{Elimination, Factored, SparseEquations};
