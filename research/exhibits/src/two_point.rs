//! Two-point fractional Euler–Lagrange problems and discrete embeddings.
//!
//! A Lagrangian L(x, v, t) gives the functional ∫ L(q, −σ D_σ^α q, t) dt over an interval, with q known at
//! both ends. On the grid t_k = a + k h, k = 0…N, it becomes
//!
//! ```text
//! L_h^{σ,α}(Q) = h Σ_{k∈I_σ} L(Q_k, V_k, t_k) ,   V = −σ Δ_σ^α Q ,   I₋ = {1…N}, I₊ = {0…N−1}
//! ```
//!
//! and its extremals solve ∂L/∂x − σ Δ_{−σ}^α ∂L/∂v = 0 at k = 1…N−1 (\[BCGI\] Propositions 4 and 5, Theorem
//! 5).
//!
//! | file | idea |
//! |---|---|
//! | `grid` | the interval, its grid, and the side σ |
//! | `toeplitz` | products with triangular Toeplitz matrices, by sums or by transforms |
//! | `operator` | the discrete operators Δ_±^α and their adjoints |
//! | `lagrangian` | Lagrangians from expressions and from closures |
//! | `functional` | the discrete functional and its gradient (the variational integrator) |
//! | `embedding` | the direct discrete embeddings of the Euler–Lagrange equation |
//! | `equation` | the direct discrete embedding of an equation that need not be Lagrangian |
//! | `newton` | Newton's method with line search |
//! | `positions` | stationarity in the positions, solved with dense matrices |
//! | `velocities` | stationarity in the fractional velocities, matrix-free |
//! | `minres` | the preconditioned Krylov method |
//! | `extremal` | the problem, its solution, and what is reported of it |
//! | `problem_file` | the input of `fvi extremal` |
//! | `output`, `pictures` | its files |
//!
//! Values on the grid are stored point by point: coordinate i at t_k is entry k·d + i.

mod embedding;
mod end_points;
mod equation;
mod extremal;
mod functional;
mod grid;
mod lagrangian;
mod minres;
mod newton;
mod operator;
mod output;
#[cfg(feature = "pictures")]
mod pictures;
mod positions;
mod problem_file;
mod toeplitz;
mod velocities;

pub use embedding::{asymmetric_embedding, fractional_embedding, symmetric_embedding};
pub use equation::{EmbeddedProblem, Embedding, OperatorEquation, Term};
pub use extremal::{ExtremalProblem, Method, NotConverged, ProblemError, Solution, Status};
pub use functional::Functional;
pub use grid::{Grid, Sigma};
pub use lagrangian::{Closures, ExpressionLagrangian, Lagrangian, MAX_COORDINATES};
pub use newton::NewtonOptions;
pub use operator::DiscreteOperator;
pub use output::{ExtremalSummary, GridError, OutputError, require_room, solve_and_write};
pub use problem_file::{KnownPositions, ProblemFile, Statement};
pub use toeplitz::{LowerToeplitz, Product};
