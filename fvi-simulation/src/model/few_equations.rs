//! Equations of a number of unknowns that the compiler knows.

use super::few::few_mut;
use super::matrices::{DenseFactors, Matrix};
use super::space::{AnyEquations, AnyFactors};
use fvi_core::{Block, Equations, Real, Singular, keep_factors, substitute, substitute_kept};

/// [`AnyEquations`] of N unknowns in a full matrix, N known to the compiler: elimination in them costs less
/// than its loops.
pub(super) struct FewEquations<'a, T, const N: usize> {
    rows: &'a mut [[T; N]; N],
    pivots: &'a mut [usize; N],
}

impl<'a, T: Real, const N: usize> FewEquations<'a, T, N> {
    /// The equations as arrays, if they are N in a full matrix.
    #[inline(always)]
    pub(super) fn of(equations: &'a mut AnyEquations<T>) -> Option<Self> {
        let AnyEquations::Dense(equations) = equations else { return None };
        let (rows, pivots) = equations.arrays()?;
        Some(Self { rows, pivots })
    }
}

impl<T: Real, const N: usize> Equations<T, Matrix<T>> for FewEquations<'_, T, N> {
    type Factor = AnyFactors<T>;

    #[inline(always)]
    fn clear(&mut self) {
        *self.rows = [[T::zero(); N]; N];
    }

    #[inline(always)]
    fn add(&mut self, row: usize, column: usize, factor: T, block: &Matrix<T>) {
        match (&mut self.rows[..], block.numbers()) {
            // One unknown: one number, without a search for its place.
            ([row], [entry]) => row[0] += *entry * factor,
            _ => block.add_to(factor, self.rows.as_flattened_mut(), N, row * N, column * N),
        }
    }

    #[inline(always)]
    fn solve(&mut self, vector: &mut [T]) -> Result<(), Singular> {
        fvi_core::solve(self.rows.as_flattened_mut(), self.pivots, few_mut::<_, N>(vector))
    }

    #[inline(always)]
    fn has_factors(&self) -> bool {
        true
    }

    #[inline(always)]
    fn solve_again(&mut self, vector: &mut [T]) {
        substitute(self.rows.as_flattened(), self.pivots, few_mut::<_, N>(vector));
    }

    fn keep(&mut self, kept: &mut AnyFactors<T>, _: (T, &Matrix<T>)) -> Result<(), Singular> {
        let mut factors = vec![T::zero(); N * N];
        keep_factors(self.rows.as_flattened_mut(), self.pivots, &mut factors)?;
        *kept = AnyFactors::Dense(DenseFactors::Whole(factors));
        Ok(())
    }

    #[inline(always)]
    fn solve_kept(&mut self, kept: &AnyFactors<T>, vector: &mut [T]) {
        if let AnyFactors::Dense(DenseFactors::Whole(factors)) = kept
            && let (columns, []) = factors.as_chunks::<N>()
            && let Some(columns) = columns.first_chunk::<N>()
        {
            substitute_kept(columns.as_flattened(), &self.pivots[..], few_mut::<_, N>(vector));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::matrices::{DenseEquations, Sparse};
    use fvi_sparse::Pattern;
    use std::sync::Arc;

    /// Solutions of A x = b by elimination, again with its factors, and with kept ones.
    fn solutions<const N: usize, E: Equations<f64, Matrix<f64>>>(
        equations: &mut E,
        blocks: &[Matrix<f64>],
        kept: &mut E::Factor,
    ) -> [[f64; N]; 3] {
        let add_all = |equations: &mut E| {
            equations.clear();
            blocks
                .iter()
                .zip([0.7, -1.3, 0.1])
                .for_each(|(block, factor)| equations.add(0, 0, factor, block));
        };
        let mut found = [core::array::from_fn(|index| 0.3 - index as f64); 3];
        add_all(equations);
        equations.solve(&mut found[0]).unwrap();
        assert!(equations.has_factors() && !equations.spares_factors());
        equations.solve_again(&mut found[1]);
        add_all(equations);
        equations.keep(kept, (0.7, &blocks[0])).unwrap();
        equations.solve_kept(kept, &mut found[2]);
        found
    }

    fn assert_same<const N: usize>() {
        let number = |index: usize| (1.7 * index as f64).sin();
        let pattern =
            Pattern::new(N, (0..N).flat_map(|row| [(row, row), (row, N - 1), (N - 1, row)]).collect());
        let mut sparse = Sparse::zero(Arc::new(pattern));
        sparse.values.own().iter_mut().enumerate().for_each(|(index, value)| *value = number(index + 3));
        let blocks = [
            Matrix::Diagonal((0..N).map(|index| 1.0 + number(index)).collect()),
            Matrix::Dense((0..N * N).map(number).collect()),
            Matrix::Sparse(sparse),
        ];
        let any = solutions::<N, _>(&mut DenseEquations::new(N, 1), &blocks, &mut DenseFactors::default());
        let mut equations = AnyEquations::Dense(DenseEquations::new(N, 1));
        let mut few = FewEquations::<_, N>::of(&mut equations).unwrap();
        assert_eq!(solutions::<N, _>(&mut few, &blocks, &mut AnyFactors::default()), any, "{N} unknowns");
    }

    #[test]
    fn few_equations_have_the_bits_of_any_number() {
        assert_same::<1>();
        assert_same::<2>();
        assert_same::<3>();
        assert!(DenseEquations::<f64>::new(3, 1).arrays::<2>().is_none());
        // A chain, as long as its matrix is tridiagonal.
        assert!(DenseEquations::<f64>::new(4, 1).arrays::<4>().is_none());
    }
}
