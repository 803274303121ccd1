//! Equations in which every unknown meets its neighbours only: those of chains.

use fvi_core::{Real, Singular};

/// A matrix with entries on the diagonal and beside it, and what elimination makes of it.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain<T> {
    /// Each row: left of the diagonal, on it, right of it. The first number and the last stay zero.
    rows: Vec<[T; 3]>,
    factors: ChainFactors<T>,
}

/// A = L D U with ones on the diagonals of L and U, where no rows need change places.
#[derive(Clone, Debug, Default)]
pub struct ChainFactors<T> {
    /// Each row: the entry of L, the reciprocal of that of D, the entry of U.
    rows: Vec<[T; 3]>,
    /// Whether A is symmetric and definite, and its diagonal no more than twice that of the mass in it.
    one_solve_suffices: bool,
}

/// A matrix with entries on the diagonal and beside it, for products: pairs of rows are computed together.
#[derive(Clone, Debug)]
pub(super) struct PairedRows<T> {
    /// Of two rows each: the entries left of the diagonal, on it, right of it. Left of the first row there is
    /// zero.
    pairs: Vec<[[T; 2]; 3]>,
    /// The last of them. Right of the last row there is zero.
    last: [[T; 2]; 3],
    /// The last row where it has no partner.
    single: Option<[T; 2]>,
}

impl<T: Real> PairedRows<T> {
    /// From the first row, those between, and the last.
    pub(super) fn new(first: [T; 2], middle: &[[T; 3]], last: [T; 2]) -> Self {
        let mut rows = vec![[T::zero(), first[0], first[1]]];
        rows.extend(middle);
        rows.push([last[0], last[1], T::zero()]);
        let (pairs, single) = rows.as_chunks::<2>();
        let column = |[upper, lower]: &[[T; 3]; 2], place: usize| [upper[place], lower[place]];
        let columns = |pair: &[[T; 3]; 2]| [0, 1, 2].map(|place| column(pair, place));
        let mut pairs: Vec<_> = pairs.iter().map(columns).collect();
        let last = pairs.pop().unwrap_or([[T::zero(); 2]; 3]);
        Self { pairs, last, single: single.first().map(|&[left, own, _]| [left, own]) }
    }

    /// out ← A x, if these are as many numbers as A has rows; whether they are.
    #[inline(always)]
    pub(super) fn multiply(&self, x: &[T], out: &mut [T]) -> bool {
        let ((xs, x), (outs, out)) = (x.as_chunks::<2>(), out.as_chunks_mut::<2>());
        let ([first, later @ ..], [outs @ .., last]) = (xs, outs) else { return false };
        let (count, left) = (self.pairs.len(), usize::from(self.single.is_some()));
        if later.len() != count || outs.len() != count || x.len() != left || out.len() != left {
            return false;
        }
        // Numbers are read in the pairs that they were written in, each once: a processor hands on what was
        // just written only whole.
        let (mut before, mut own) = ([T::zero(); 2], *first);
        for row in 0..count {
            let numbers = (self.pairs.get(row), outs.get_mut(row), later.get(row));
            let (Some(pair), Some(out), Some(&after)) = numbers else { return false };
            *out = of_pair(pair, before, own, after);
            (before, own) = (own, after);
            // Each pair is a vector by itself.
            core::hint::black_box(());
        }
        let behind = [x.first().copied().unwrap_or(T::zero()), T::zero()];
        *last = of_pair(&self.last, before, own, behind);
        if let (Some([left, middle]), [out]) = (self.single, out) {
            *out = left * own[1] + middle * behind[0];
        }
        true
    }
}

/// A pair of rows times the numbers around it: those of the pair itself and its neighbours.
#[inline(always)]
fn of_pair<T: Real>([left, own, right]: &[[T; 2]; 3], before: [T; 2], x: [T; 2], after: [T; 2]) -> [T; 2] {
    [
        left[0] * before[1] + own[0] * x[0] + right[0] * x[1],
        left[1] * x[0] + own[1] * x[1] + right[1] * after[0],
    ]
}

impl<T: Real> Chain<T> {
    /// The zero matrix for so many unknowns.
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

    /// Adds factor times entries on the diagonal and beside it, row by row.
    pub(super) fn add_rows(&mut self, factor: T, entries: &[T]) {
        // The same order, without the first number and the last.
        let places = self.rows.as_flattened_mut().get_mut(1..).unwrap_or(&mut []);
        fvi_core::add_multiple(places, factor, entries);
    }

    /// Hands each entry to `take` as (row, column, entry).
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

    /// Factors the matrix for [`solve`](Self::solve); returns whether the pivots may stay on the diagonal.
    ///
    /// # Errors
    /// [`Singular`], as [`fvi_core::factor`].
    pub(super) fn factor(&mut self) -> Result<bool, Singular> {
        let (rows, factors) = (&self.rows, &mut self.factors.rows);
        factors.resize(rows.len(), [T::zero(); 3]);
        let (mut reciprocal, mut before, mut above) = (T::zero(), T::zero(), T::zero());
        for (place, &[left, own, right]) in factors.iter_mut().zip(rows) {
            let lower = left * reciprocal;
            // Larger than its pivot, or not a number.
            if lower.abs() > T::one() || !lower.is_finite() {
                return Ok(false);
            }
            let pivot = own - before * left;
            let size = pivot.abs();
            if !pivot.is_finite() || size <= above * T::EPSILON || size == T::zero() {
                // Another row may do better.
                return if left == T::zero() && right == T::zero() { Err(Singular) } else { Ok(false) };
            }
            reciprocal = T::one() / pivot;
            before = right * reciprocal;
            above = right.abs();
            *place = [lower, reciprocal, before];
        }
        Ok(true)
    }

    /// Replaces `vector` by the solution with the factors that were made last.
    pub(super) fn solve(&self, vector: &mut [T]) {
        self.factors.solve(vector);
    }

    /// The factors that were made last; factor times the masses, where those are a
    /// diagonal, is the part of the mass in the matrix.
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

    /// Whether solutions are those of a matrix A + E with E as small as rounding makes the entries of the
    /// mass.
    ///
    /// Of a symmetric matrix L and U are each other's transposes to the bit, so that E is symmetric, and
    /// where it is definite |E_ij| is a few ε |A_ij| (\[Higham02\] §9.6). The midpoint rule with A + E is
    /// that of the mass M + h E.
    pub(super) fn one_solve_suffices(&self) -> bool {
        self.one_solve_suffices
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Springs between walls, and a mass of so much.
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
        // A step longer than the periods, a force that is none of a potential, a mass of another kind.
        assert!(!gentle(0.5, 0.0, 0.5) && !gentle(1.5, 0.1, 1.5));
        let mut chain = chain(9, 1.5, 0.0);
        chain.factor().unwrap();
        assert!(!chain.kept(1.5, None).one_solve_suffices());
    }

    #[test]
    fn products_of_paired_rows_are_those_of_the_whole_matrix() {
        for size in [2, 3, 8, 9] {
            let chain = chain(size, 1.5, 0.3);
            let entries = dense(&chain, size);
            let row = |row: usize, first: usize| [0, 1].map(|place| entries[row * size + first + place]);
            let middle: Vec<_> = (1..size - 1).map(|row| chain.rows[row]).collect();
            let rows = PairedRows::new(row(0, 0), &middle, row(size - 1, size - 2));
            let x: Vec<f64> = (0..size).map(|index| 1.0 - 0.3 * index as f64).collect();
            let (mut found, mut longer) = (vec![f64::NAN; size], vec![0.0; size + 1]);
            assert!(rows.multiply(&x, &mut found));
            let products = entries.chunks_exact(size).map(|row| row.iter().zip(&x).map(|(a, x)| a * x).sum());
            for (found, expected) in found.iter().zip(products.collect::<Vec<f64>>()) {
                assert!((found - expected).abs() < 1e-14, "{found} {expected} of {size}");
            }
            assert!(!rows.multiply(&x, &mut longer) && !rows.multiply(&longer.clone(), &mut longer));
        }
    }

    #[test]
    fn rows_that_must_change_places_are_left_to_others() {
        let mut chain = chain(9, -0.999, 0.0);
        assert_eq!(chain.factor(), Ok(false));
        let mut nothing = Chain::<f64>::zero(5);
        assert_eq!(nothing.factor(), Err(Singular));
    }
}
