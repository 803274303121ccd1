//! A scenario's system and scheme as implementations of fvi-core's traits: any number of coordinates,
//! compiled expressions.

mod band;
mod chain;
mod channel_damping;
mod elements;
mod energies;
mod force_moments;
mod loads;
mod massless;
mod matrices;
mod mechanics;
mod missed;
mod moment;
mod own;
mod rough_forces;
mod scenario_damping;
mod scenario_loads;
mod scheme;
mod shared;
mod signal_moments;
mod space;
mod sparse;
mod switches;
pub mod tape;
mod unbounded_forces;

pub use band::BandFactors;
pub use chain::ChainFactors;
pub use channel_damping::{ChannelDamping, Directions};
pub use elements::Elements;
pub use energies::{EnergyRoom, States};
pub use force_moments::{ForceMoments, StepLengths};
pub use loads::Loads;
pub(crate) use massless::{Equilibrium, MasslessRows};
pub use matrices::{DenseEquations, DenseFactors, Matrix, Sparse};
pub use mechanics::{Model, matrix, vector};
pub(crate) use missed::first_missed;
pub use moment::moment;
pub(crate) use rough_forces::RoughForces;
pub use scenario_damping::{channels_of, follow_alike, term_on_memory};
pub(crate) use scenario_loads::takes_moments;
pub use scheme::{AnyScheme, Room};
pub use shared::Shared;
pub use space::{AnyEquations, AnyFactors, AnySpace};
pub use sparse::{Elimination, Factored, SparseEquations, StagePair};
pub use switches::{Side, Switched};
