//! Potentials and forces compiled once, before the first step.
//!
//! An expression is differentiated symbolically into a graph in which every distinct value occurs once, and
//! the graph is compiled to programs without branches: for the value, for the gradient, and for the gradient
//! with the structurally nonzero entries of the Hessian. The quadratic part of a potential becomes a matrix,
//! and so does the linear part of a force, so that linear systems are detected.
//!
//! Evaluation does not allocate: it works in a vector owned by the caller, which grows once and may be shared
//! between programs. A program for q of length n takes exactly n coordinates.

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
mod slopes;
mod time_terms;
mod unbounded;

pub use force::{CompiledForce, variables as force_variables};
pub use function::CompiledFunction;
pub use potential::{CompiledPotential, QuadraticPart};
pub(super) use program::{LANES, LaneRegisters, OwnRegisters};
pub use rough::{RoughArgument, RoughArguments};
pub use sides::CompiledSides;
pub use slopes::CompiledSlopes;
pub use time_terms::{TimeTerms, terms};
pub use unbounded::{Singularity, Unbounded};

#[cfg(test)]
mod tests;
