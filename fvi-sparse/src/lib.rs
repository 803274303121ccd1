//! Sparse symmetric matrices in compressed rows, and the Cholesky factors that solve their equations.
//!
//! A [`Pattern`] contains the places of entries, an [`Analysis`] the order of elimination for that pattern,
//! once for all values, and a [`Factor`] is the result for one set of values.
//!
//! ```
//! use fvi_sparse::{Analysis, Pattern};
//! // [2 −1; −1 2]
//! let pattern = Pattern::new(2, vec![(0, 0), (0, 1), (1, 0), (1, 1)]);
//! let analysis = Analysis::new(&pattern);
//! let factor = analysis.factor(&pattern, &[2.0, -1.0, -1.0, 2.0])?;
//! let mut x = [1.0_f64, 0.0];
//! factor.solve(&mut x);
//! assert!((x[0] - 2.0 / 3.0).abs() < 1e-15 && (x[1] - 1.0 / 3.0).abs() < 1e-15);
//! # Ok::<(), fvi_sparse::FactorError>(())
//! ```
#![forbid(unsafe_code)]

mod analysis;
mod blocks;
mod complex;
mod dissection;
mod factor;
mod graph;
mod kernels;
mod pattern;
mod product;
mod semidefinite;
mod separator;
mod solve;

pub use analysis::Analysis;
#[doc(hidden)]
pub use complex::ComplexFactored;
pub use complex::{ComplexSolver, Unsolved};
pub use factor::{Factor, FactorError};
pub use pattern::Pattern;
pub use semidefinite::check_positive_semidefinite;
