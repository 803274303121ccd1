//! Potentials and forces compiled once, before the first step.
//!
//! An expression is differentiated symbolically into a graph in which every distinct value occurs once, and
//! the graph is written out as programs without branches: for the value, for the gradient, and for the
//! gradient with those entries of the Hessian that are not zero everywhere. The quadratic part of a potential
//! becomes a matrix, the linear part of a force likewise, so that a linear system is seen to be one.
//!
//! Evaluation allocates nothing: it works in a vector that the caller keeps and that grows once. The vector
//! may be shared between programs. A program for q of length n takes exactly n coordinates.

mod derivative;
mod enclosure;
mod force;
mod function;
mod graph;
mod operation;
mod polynomial;
mod potential;
mod program;
mod rough;
mod sides;
mod time_terms;
mod unbounded;

pub use force::{CompiledForce, variables as force_variables};
pub use function::CompiledFunction;
pub use potential::{CompiledPotential, QuadraticPart};
pub(super) use program::{LANES, LaneRegisters, OwnRegisters};
pub use rough::{RoughArgument, RoughArguments};
pub use sides::CompiledSides;
pub use time_terms::{TimeTerms, terms};
pub use unbounded::{Singularity, Unbounded};

#[cfg(test)]
mod tests;
