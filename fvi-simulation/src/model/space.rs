//! The space in which scenarios run: vectors of as many coordinates as there are, and equations that are
//! solved as suits them.

use super::matrices::{DenseEquations, DenseFactors, Matrix};
use super::sparse::{Elimination, Factored, SparseEquations};
use fvi_core::{Equations, Real, Singular, Space};
use std::sync::Arc;

/// The space of N coordinates, N known at run time, or of several such motions together.
///
/// Vectors are on the heap, blocks are [`Matrix`]. How the equations of a step are solved is a value, so that
/// what is written over spaces is compiled once for all of them: in a full matrix or within its band, or,
/// where there is a plan, by a sparse factor.
///
/// With C motions of one linear system, which have sparse factors, the vectors have C N numbers, one motion
/// behind the other, and a block of N rows stands for the matrix that has it C times on its diagonal: one
/// factor serves all motions, in one pass.
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

    /// The space in which equations are eliminated by this plan.
    pub fn sparse(plan: Elimination) -> Self {
        Self { coordinates: plan.coordinates(), copies: 1, threads: 1, plan: Some(Arc::new(plan)) }
    }

    /// The space of so many motions together.
    #[must_use]
    pub fn times(self, copies: usize) -> Self {
        Self { copies, ..self }
    }

    /// The same space, whose products and solutions may take so many threads; the bits are the same.
    #[must_use]
    pub fn on_threads(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    /// How many threads that are.
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// How many motions there are.
    pub fn copies(&self) -> usize {
        self.copies
    }

    /// How equations are eliminated where they are sparse.
    pub fn plan(&self) -> Option<&Elimination> {
        self.plan.as_deref()
    }

    /// Room for the equations of a step of this many nodes.
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

/// The equations of a step, solved as their space says.
pub enum AnyEquations<T> {
    /// In a full matrix, or within its band.
    Dense(DenseEquations<T>),
    /// By a sparse factor.
    Sparse(SparseEquations),
}

/// Factors of [`AnyEquations`] for many right-hand sides.
pub enum AnyFactors<T> {
    /// That of dense ones.
    Dense(DenseFactors<T>),
    /// That of sparse ones.
    Sparse(Option<Factored>),
}

impl<T> Default for AnyFactors<T> {
    fn default() -> Self {
        Self::Dense(DenseFactors::default())
    }
}

impl<T: Real> Equations<T, Matrix<T>> for AnyEquations<T> {
    type Factor = AnyFactors<T>;

    fn clear(&mut self) {
        match self {
            Self::Dense(equations) => equations.clear(),
            Self::Sparse(equations) => Equations::<T, _>::clear(equations),
        }
    }

    fn add(&mut self, row: usize, column: usize, factor: T, block: &Matrix<T>) {
        match self {
            Self::Dense(equations) => equations.add(row, column, factor, block),
            Self::Sparse(equations) => equations.add(row, column, factor, block),
        }
    }

    fn solve(&mut self, vector: &mut [T]) -> Result<(), Singular> {
        match self {
            Self::Dense(equations) => equations.solve(vector),
            Self::Sparse(equations) => equations.solve(vector),
        }
    }

    fn has_factors(&self) -> bool {
        match self {
            Self::Dense(equations) => equations.has_factors(),
            Self::Sparse(equations) => Equations::<T, _>::has_factors(equations),
        }
    }

    fn spares_factors(&self) -> bool {
        matches!(self, Self::Sparse(_))
    }

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
                // Before the next factor is made: there may not be room for two.
                *kept = AnyFactors::default();
                let mut factor = None;
                equations.keep(&mut factor, inertia)?;
                *kept = AnyFactors::Sparse(factor);
            }
        }
        Ok(())
    }

    fn solve_kept(&mut self, kept: &AnyFactors<T>, vector: &mut [T]) {
        match (self, kept) {
            (Self::Dense(equations), AnyFactors::Dense(factors)) => equations.solve_kept(factors, vector),
            (Self::Sparse(equations), AnyFactors::Sparse(factor)) => equations.solve_kept(factor, vector),
            // Nothing has been kept.
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
