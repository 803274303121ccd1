//! Equations with a tridiagonal matrix, in which every unknown is coupled to its neighbours only, as in a
//! chain.

use fvi_core::{Real, Singular};

/// A tridiagonal matrix and its factors.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain<T> {
    /// Each row: left of the diagonal, on it, right of it. The first number and the last stay zero.
    rows: Vec<[T; 3]>,
    factors: ChainFactors<T>,
}

/// A = L D U with ones on the diagonals of L and U, if no rows need to be exchanged.
#[derive(Clone, Debug, Default)]
pub struct ChainFactors<T> {
    /// Each row: the entry of L, the reciprocal of that of D, the entry of U.
    rows: Vec<[T; 3]>,
    /// True if A is symmetric and definite, and its diagonal at most twice that of its mass part.
    one_solve_suffices: bool,
}

impl<T: Real> Chain<T> {
    /// The zero matrix for `size` unknowns.
    pub(super) fn zero(size: usize) -> Self {
        Self { rows: vec![[T::zero(); 3]; size], factors: ChainFactors::default() }
    }

    /// Sets all entries to zero.
    pub(super) fn clear(&mut self) {
        self.rows.as_flattened_mut().fill(T::zero());
    }

    /// Adds factor times a diagonal.
    pub(super) fn add_diagonal(&mut self, factor: T, diagonal: &[T]) {
        for ([_, own, _], &entry) in self.rows.iter_mut().zip(diagonal) {
            *own += entry * factor;
        }
    }

    /// Adds factor times the entries of a tridiagonal matrix, row by row.
    pub(super) fn add_rows(&mut self, factor: T, entries: &[T]) {
        // The same layout, without the first number and the last.
        let places = self.rows.as_flattened_mut().get_mut(1..).unwrap_or(&mut []);
        fvi_core::add_multiple(places, factor, entries);
    }

    /// Calls `take(row, column, entry)` for each entry.
    pub(super) fn for_each(&self, mut take: impl FnMut(usize, usize, T)) {
        let last = self.rows.len().saturating_sub(1);
        for (row, &[left, own, right]) in self.rows.iter().enumerate() {
            if row > 0 {
                take(row, row - 1, left);
            }
            take(row, row, own);
            if row < last {
                take(row, row + 1, right);
            }
        }
    }

    /// Factors the matrix for [`solve`](Self::solve); returns whether pivots on the diagonal are acceptable.
    ///
    /// # Errors
    /// [`Singular`], as [`fvi_core::factor`].
    pub(super) fn factor(&mut self) -> Result<bool, Singular> {
        let (rows, factors) = (&self.rows, &mut self.factors.rows);
        factors.resize(rows.len(), [T::zero(); 3]);
        let (mut reciprocal, mut before, mut above) = (T::zero(), T::zero(), T::zero());
        for (place, &[left, own, right]) in factors.iter_mut().zip(rows) {
            let lower = left * reciprocal;
            // The multiplier is larger than 1, or not a number.
            if lower.abs() > T::one() || !lower.is_finite() {
                return Ok(false);
            }
            let pivot = own - before * left;
            let size = pivot.abs();
            if !pivot.is_finite() || size <= above * T::EPSILON || size == T::zero() {
                // The pivot of another row may be nonzero.
                return if left == T::zero() && right == T::zero() { Err(Singular) } else { Ok(false) };
            }
            reciprocal = T::one() / pivot;
            before = right * reciprocal;
            above = right.abs();
            *place = [lower, reciprocal, before];
        }
        Ok(true)
    }

    /// Replaces `vector` by the solution with the factors of the last [`factor`](Self::factor).
    pub(super) fn solve(&self, vector: &mut [T]) {
        self.factors.solve(vector);
    }

    /// The factors of the last [`factor`](Self::factor). If `masses` is a diagonal, `factor` times it is the
    /// mass part of the matrix.
    pub(super) fn kept(&self, factor: T, masses: Option<&[T]>) -> ChainFactors<T> {
        let symmetric = self.rows.windows(2).all(|rows| match rows {
            [[_, _, right], [left, _, _]] => left == right,
            _ => true,
        });
        let signs = || self.factors.rows.iter().map(|&[_, reciprocal, _]| reciprocal > T::zero());
        let definite = signs().all(|sign| sign) || !signs().any(|sign| sign);
        let light = masses.is_some_and(|masses| {
            let mut rows = self.rows.iter().zip(masses);
            rows.all(|(&[_, own, _], &mass)| own.abs() <= T::of(2.0) * (factor * mass).abs())
        });
        let rows = self.factors.rows.clone();
        ChainFactors { rows, one_solve_suffices: symmetric && definite && light }
    }
}

impl<T: Real> ChainFactors<T> {
    /// Replaces `vector` by the solution.
    pub(super) fn solve(&self, vector: &mut [T]) {
        let mut carried = T::zero();
        for (number, &[lower, _, _]) in vector.iter_mut().zip(&self.rows) {
            carried = *number - lower * carried;
            *number = carried;
        }
        let mut solution = T::zero();
        for (number, &[_, reciprocal, upper]) in vector.iter_mut().zip(&self.rows).rev() {
            solution = *number * reciprocal - upper * solution;
            *number = solution;
        }
    }

    /// True if solutions are exact for a matrix A + E where E is as small as rounding of the entries of the
    /// mass.
    ///
    /// For a symmetric matrix L and U are bitwise transposes of each other, so that E is symmetric, and if
    /// the matrix is definite |E_ij| is a few ε |A_ij| (\[Higham02\] §9.6). The midpoint rule with A + E is
    /// that of the mass M + h E.
    pub(super) fn one_solve_suffices(&self) -> bool {
        self.one_solve_suffices
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chain of masses `mass` with springs between walls.
    fn chain(size: usize, mass: f64, skew: f64) -> Chain<f64> {
        let mut springs: Vec<f64> = (0..size).flat_map(|_| [-1.0, 2.0, -1.0]).collect();
        springs[2] += skew;
        let mut chain = Chain::zero(size);
        chain.add_diagonal(1.0, &vec![mass; size]);
        chain.add_rows(0.5, &springs[1..3 * size - 1]);
        chain
    }

    fn dense(chain: &Chain<f64>, size: usize) -> Vec<f64> {
        let mut entries = vec![0.0; size * size];
        chain.for_each(|row, column, entry| entries[row * size + column] = entry);
        entries
    }

    #[test]
    fn solutions_are_those_of_the_whole_matrix() {
        for skew in [0.0, 0.3] {
            let mut chain = chain(9, 1.5, skew);
            let mut found: Vec<f64> = (0..9).map(|index| 1.0 - 0.3 * f64::from(index)).collect();
            let mut expected = found.clone();
            fvi_core::solve(&mut dense(&chain, 9), &mut [0; 9], &mut expected).unwrap();
            assert_eq!(chain.factor(), Ok(true));
            chain.solve(&mut found);
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-14, "{found} {expected}");
            }
        }
    }

    #[test]
    fn one_correction_is_enough_where_the_mass_outweighs_symmetric_springs() {
        let gentle = |mass: f64, skew: f64, inertia: f64| {
            let mut chain = chain(9, mass, skew);
            assert_eq!(chain.factor(), Ok(true));
            chain.kept(inertia, Some(&[1.0; 9])).one_solve_suffices()
        };
        assert!(gentle(1.5, 0.0, 1.5) && gentle(-3.5, 0.0, -3.5));
        // A step longer than the periods, a nonsymmetric force, a mass part that does not dominate.
        assert!(!gentle(0.5, 0.0, 0.5) && !gentle(1.5, 0.1, 1.5));
        let mut chain = chain(9, 1.5, 0.0);
        chain.factor().unwrap();
        assert!(!chain.kept(1.5, None).one_solve_suffices());
    }

    #[test]
    fn rows_that_must_change_places_are_left_to_others() {
        let mut chain = chain(9, -0.999, 0.0);
        assert_eq!(chain.factor(), Ok(false));
        let mut nothing = Chain::<f64>::zero(5);
        assert_eq!(nothing.factor(), Err(Singular));
    }
}
