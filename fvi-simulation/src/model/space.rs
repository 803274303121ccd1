//! The space of scenarios: vectors with a number of coordinates known at run time, and equations with a
//! choice of solvers.

use super::matrices::{DenseEquations, DenseFactors, Matrix};
use super::sparse::{Elimination, Factored, SparseEquations};
use fvi_core::{Equations, Real, Singular, Space};
use std::sync::Arc;

/// The space of N coordinates, N known at run time, or of several such motions together.
///
/// Vectors are on the heap, blocks are [`Matrix`]. The solver for the equations of a step is a value, so that
/// code which is generic over spaces is compiled once for all solvers: elimination in a full matrix or within
/// its band, or, with a plan, a sparse factor.
///
/// With C motions of one linear system, which use sparse factors, vectors have C N numbers, one motion after
/// another, and a block of N rows stands for the block-diagonal matrix with C copies of it: one factor solves
/// for all motions in one pass.
#[derive(Clone, Debug)]
pub struct AnySpace {
    coordinates: usize,
    copies: usize,
    threads: usize,
    plan: Option<Arc<Elimination>>,
}

impl AnySpace {
    /// The space of N coordinates whose equations are solved in a full matrix, or within its band.
    pub fn dense(coordinates: usize) -> Self {
        Self { coordinates, copies: 1, threads: 1, plan: None }
    }

    /// The space whose equations are solved by a sparse factor with this plan.
    pub fn sparse(plan: Elimination) -> Self {
        Self { coordinates: plan.coordinates(), copies: 1, threads: 1, plan: Some(Arc::new(plan)) }
    }

    /// The space of `copies` motions together.
    #[must_use]
    pub fn times(self, copies: usize) -> Self {
        Self { copies, ..self }
    }

    /// The same space, with products and solutions on at most the given number of threads; the bits are the
    /// same.
    #[must_use]
    pub fn on_threads(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    /// Number of threads.
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// Number of motions.
    pub fn copies(&self) -> usize {
        self.copies
    }

    /// Plan of the sparse elimination; `None` for dense equations.
    pub fn plan(&self) -> Option<&Elimination> {
        self.plan.as_deref()
    }

    /// Storage for the equations of a step with `nodes` nodes.
    pub fn equations<T: Real>(&self, nodes: usize) -> AnyEquations<T> {
        match &self.plan {
            None => AnyEquations::Dense(DenseEquations::new(self.coordinates, nodes)),
            Some(plan) => {
                debug_assert_eq!(nodes, plan.nodes(), "the plan is one for schemes of other nodes");
                AnyEquations::Sparse(SparseEquations::new(plan, self.threads))
            }
        }
    }
}

impl<T: Real> Space<T> for AnySpace {
    const KNOWN_SIZE: bool = false;

    type Vector = Vec<T>;
    type Block = Matrix<T>;

    fn coordinates(&self) -> usize {
        self.copies * self.coordinates
    }

    fn zeros(&self) -> Vec<T> {
        vec![T::zero(); self.copies * self.coordinates]
    }

    fn slice(vector: &Vec<T>) -> &[T] {
        vector
    }

    fn slice_mut(vector: &mut Vec<T>) -> &mut [T] {
        vector
    }
}

/// The equations of a step, with the solver of their space.
pub enum AnyEquations<T> {
    /// In a full matrix, or within its band.
    Dense(DenseEquations<T>),
    /// By a sparse factor.
    Sparse(SparseEquations),
}

/// Factors of [`AnyEquations`] for many right-hand sides.
pub enum AnyFactors<T> {
    /// Factors of dense equations.
    Dense(DenseFactors<T>),
    /// Factor of sparse equations.
    Sparse(Option<Factored>),
}

impl<T> Default for AnyFactors<T> {
    fn default() -> Self {
        Self::Dense(DenseFactors::default())
    }
}

impl<T: Real> Equations<T, Matrix<T>> for AnyEquations<T> {
    type Factor = AnyFactors<T>;

    #[inline]
    fn clear(&mut self) {
        match self {
            Self::Dense(equations) => equations.clear(),
            Self::Sparse(equations) => Equations::<T, _>::clear(equations),
        }
    }

    #[inline]
    fn add(&mut self, row: usize, column: usize, factor: T, block: &Matrix<T>) {
        match self {
            Self::Dense(equations) => equations.add(row, column, factor, block),
            Self::Sparse(equations) => equations.add(row, column, factor, block),
        }
    }

    #[inline]
    fn solve(&mut self, vector: &mut [T]) -> Result<(), Singular> {
        match self {
            Self::Dense(equations) => equations.solve(vector),
            Self::Sparse(equations) => equations.solve(vector),
        }
    }

    #[inline]
    fn has_factors(&self) -> bool {
        match self {
            Self::Dense(equations) => equations.has_factors(),
            Self::Sparse(equations) => Equations::<T, _>::has_factors(equations),
        }
    }

    fn spares_factors(&self) -> bool {
        matches!(self, Self::Sparse(_))
    }

    #[inline]
    fn solve_again(&mut self, vector: &mut [T]) {
        match self {
            Self::Dense(equations) => equations.solve_again(vector),
            Self::Sparse(equations) => equations.solve_again(vector),
        }
    }

    fn keep(&mut self, kept: &mut AnyFactors<T>, inertia: (T, &Matrix<T>)) -> Result<(), Singular> {
        match self {
            Self::Dense(equations) => {
                let mut factors = DenseFactors::default();
                equations.keep(&mut factors, inertia)?;
                *kept = AnyFactors::Dense(factors);
            }
            Self::Sparse(equations) => {
                // The old factor is dropped first: there may not be memory for two.
                *kept = AnyFactors::default();
                let mut factor = None;
                equations.keep(&mut factor, inertia)?;
                *kept = AnyFactors::Sparse(factor);
            }
        }
        Ok(())
    }

    #[inline]
    fn solve_kept(&mut self, kept: &AnyFactors<T>, vector: &mut [T]) {
        match (self, kept) {
            (Self::Dense(equations), AnyFactors::Dense(factors)) => equations.solve_kept(factors, vector),
            (Self::Sparse(equations), AnyFactors::Sparse(factor)) => equations.solve_kept(factor, vector),
            // No factor has been stored.
            _ => {}
        }
    }

    fn is_solved_at_once(&self, kept: &AnyFactors<T>) -> bool {
        match (self, kept) {
            (Self::Dense(equations), AnyFactors::Dense(factors)) => equations.is_solved_at_once(factors),
            _ => false,
        }
    }

    fn is_unsettled(
        &self,
        kept: &AnyFactors<T>,
        increments: &[T],
        position: &[T],
        residual: &mut [T],
    ) -> bool {
        match (self, kept) {
            (Self::Sparse(equations), AnyFactors::Sparse(factor)) => {
                equations.is_unsettled(factor, increments, position, residual)
            }
            _ => true,
        }
    }
}
