//! The equations of many coordinates, with sparse factors.

use super::matrices::Matrix;
use crate::scenario::KnownMatrices;
use fvi_core::{Equations, Real, Singular};
use fvi_sparse::{Analysis, Factor, Pattern};
use std::sync::Arc;

/// How the equations of a step with one unknown node are eliminated, known before the first step.
#[derive(Clone, Debug)]
pub struct Elimination {
    pattern: Arc<Pattern>,
    analysis: Analysis,
}

impl Elimination {
    /// Analyses the places at which the sum of these matrices can have entries.
    pub fn of<T: Real>(coordinates: usize, blocks: &[&Matrix<T>]) -> Self {
        Self::with_pattern(Self::places_of(coordinates, blocks))
    }

    /// The same with a pattern of other scenarios, if one of them has had these places.
    pub fn knowing<T: Real>(coordinates: usize, blocks: &[&Matrix<T>], known: &KnownMatrices) -> Self {
        Self::with_pattern(known.pattern(Self::places_of(coordinates, blocks)))
    }

    fn places_of<T: Real>(coordinates: usize, blocks: &[&Matrix<T>]) -> Arc<Pattern> {
        let sparse = blocks.iter().filter_map(|block| match block {
            Matrix::Sparse(sparse) => Some(&sparse.pattern),
            _ => None,
        });
        // Often the stiffness has all places, and has been analysed.
        let widest = sparse.max_by_key(|pattern| pattern.len());
        let none = || Arc::new(Pattern::new(coordinates, Vec::new()));
        let mut pattern = widest.map_or_else(none, Arc::clone);
        let diagonal = Matrix::Diagonal(vec![T::zero(); coordinates]);
        for block in blocks.iter().copied().chain([&diagonal]) {
            if let Some(wider) = widened(&pattern, block) {
                pattern = Arc::new(wider);
            }
        }
        pattern
    }

    fn with_pattern(pattern: Arc<Pattern>) -> Self {
        Self { analysis: Analysis::new(&pattern), pattern }
    }

    /// Number of coordinates N.
    pub fn coordinates(&self) -> usize {
        self.pattern.size()
    }

    /// Numbers of the factor.
    pub fn factor_len(&self) -> usize {
        self.analysis.factor_len()
    }

    /// Bytes of the factor.
    pub fn factor_bytes(&self) -> usize {
        self.analysis.factor_bytes()
    }

    /// Number of places in the matrix.
    pub fn places(&self) -> usize {
        self.pattern.len()
    }
}

/// The sparse equations of a step with one unknown node, whose matrix is symmetric and definite.
///
/// The pattern is analysed once. Newton's method factors again where the matrix has changed since it was
/// factored last.
pub struct SparseEquations {
    pattern: Arc<Pattern>,
    /// Of the pattern; `None` after it grew.
    analysis: Option<Analysis>,
    /// One for each place; times `sign`.
    values: Vec<f64>,
    /// The sign that makes the first entry positive; 0 while nothing has been added.
    sign: f64,
    /// That a solution may take.
    threads: usize,
    /// The last matrix that was factored for one solution, with its factor.
    last: Option<(Vec<f64>, Factored)>,
    /// The vector in double precision.
    buffer: Vec<f64>,
}

/// The factor of a matrix A, or of what it is with a minus.
pub struct Factored {
    factor: Factor,
    sign: f64,
    threads: usize,
    /// √A_ii.
    scales: Vec<f64>,
}

/// How many roundings of its terms a residual may have for one correction to be enough.
const ROUNDINGS: f64 = 32.0;

impl Factored {
    fn solve<T: Real>(&self, buffer: &mut Vec<f64>, vector: &mut [T]) {
        buffer.clear();
        buffer.extend(vector.iter().map(|number| number.to_f64() * self.sign));
        self.factor.solve_on_threads(buffer, self.threads);
        vector.iter_mut().zip(buffer.iter()).for_each(|(place, &number)| *place = T::of(number));
    }
}

impl SparseEquations {
    /// Room for equations that are eliminated by this plan, on so many threads.
    pub fn new(plan: &Elimination, threads: usize) -> Self {
        Self {
            pattern: Arc::clone(&plan.pattern),
            analysis: Some(plan.analysis.clone()),
            values: Vec::new(),
            sign: 0.0,
            threads,
            last: None,
            buffer: Vec::new(),
        }
    }

    fn factored(&mut self, remembers: bool) -> Result<Factored, Singular> {
        let analysis = self.analysis.get_or_insert_with(|| Analysis::new(&self.pattern));
        let factor = match remembers {
            true => analysis.factor_of(&self.pattern, &self.values),
            false => analysis.factor(&self.pattern, &self.values),
        };
        match factor {
            Ok(factor) => {
                let diagonal = (0..self.pattern.size()).map(|row| self.values[self.pattern.slot(row, row)]);
                let scales = diagonal.map(f64::sqrt).collect();
                Ok(Factored { factor, sign: self.sign, threads: self.threads, scales })
            }
            Err(_) => Err(Singular),
        }
    }
}

impl<T: Real> Equations<T, Matrix<T>> for SparseEquations {
    type Factor = Option<Factored>;

    fn clear(&mut self) {
        self.values.clear();
        self.values.resize(self.pattern.len(), 0.0);
        self.sign = 0.0;
    }

    fn add(&mut self, _: usize, _: usize, factor: T, block: &Matrix<T>) {
        let factor = factor.to_f64();
        if factor == 0.0 {
            return;
        }
        if self.sign == 0.0 {
            self.sign = factor.signum();
        }
        if let Some(wider) = widened(&self.pattern, block) {
            let mut values = vec![0.0; wider.len()];
            for (new, old) in wider.rows().zip(self.pattern.rows()) {
                let mut places = wider.columns()[new.clone()].iter().zip(&mut values[new]);
                for (&column, &value) in self.pattern.columns()[old.clone()].iter().zip(&self.values[old]) {
                    if let Some((_, place)) = places.find(|(other, _)| **other == column) {
                        *place = value;
                    }
                }
            }
            (self.values, self.pattern) = (values, Arc::new(wider));
            (self.analysis, self.last) = (None, None);
        }
        let factor = factor * self.sign;
        for (row, slots) in self.pattern.rows().enumerate() {
            let mut places = self.pattern.columns()[slots.clone()].iter().zip(&mut self.values[slots]);
            for_each_entry(block, row, |column, entry| {
                if let Some((_, place)) = places.find(|(place, _)| **place as usize == column) {
                    *place += factor * entry.to_f64();
                }
            });
        }
    }

    fn solve(&mut self, vector: &mut [T]) -> Result<(), Singular> {
        if !self.last.as_ref().is_some_and(|(values, _)| *values == self.values) {
            // Before the next factor is made: there may not be room for two.
            self.last = None;
            let factored = self.factored(false)?;
            self.last = Some((self.values.clone(), factored));
        }
        if let Some((_, factored)) = &self.last {
            factored.solve(&mut self.buffer, vector);
        }
        Ok(())
    }

    fn has_factors(&self) -> bool {
        self.last.is_some()
    }

    fn spares_factors(&self) -> bool {
        true
    }

    fn solve_again(&mut self, vector: &mut [T]) {
        if let Some((_, factored)) = &self.last {
            factored.solve(&mut self.buffer, vector);
        }
    }

    fn keep(&mut self, kept: &mut Option<Factored>, _: (T, &Matrix<T>)) -> Result<(), Singular> {
        *kept = None;
        *kept = Some(self.factored(true)?);
        self.values = Vec::new();
        Ok(())
    }

    fn solve_kept(&mut self, kept: &Option<Factored>, vector: &mut [T]) {
        if let Some(factored) = kept {
            factored.solve(&mut self.buffer, vector);
        }
    }

    /// Each motion by itself: |r_i| > 32 ε √A_ii · max_j √A_jj (|e_j| + |q_j|) for some i, or not a number.
    ///
    /// The factor is that of A + E with E symmetric and |E_ij| ≤ c ε √(A_ii A_jj), c growing with the entries
    /// of a row (\[Demmel89\] theorem 2.1), and the entries of A and of the stiffness in it are no larger
    /// than their diagonals allow either: the right-hand side is what the residual, and the forces in it, are
    /// rounded by. Below it another correction would bring rounding of its own. What E does at every step is
    /// harmless: the midpoint rule with A + E is that of the mass M + h E, and as stable as that one is
    /// definite.
    fn is_unsettled(
        &self,
        kept: &Option<Factored>,
        increments: &[T],
        position: &[T],
        residual: &mut [T],
    ) -> bool {
        let Some(Factored { scales, .. }) = kept else { return true };
        let size = scales.len().max(1);
        let motions = increments.chunks(size).zip(position.chunks(size)).zip(residual.chunks_mut(size));
        let mut unsettled = false;
        for ((increments, position), residual) in motions {
            let scaled = increments.iter().zip(position).zip(scales);
            let largest = scaled.fold(0.0_f64, |largest, ((e, q), scale)| {
                largest.max(scale * (e.to_f64().abs() + q.to_f64().abs()))
            });
            let bound = ROUNDINGS * T::EPSILON.to_f64() * largest;
            let rounding = |(r, scale): (&T, &f64)| r.to_f64().abs() <= bound * scale;
            if bound.is_finite() && residual.iter().zip(scales).all(rounding) {
                residual.fill(T::zero());
            } else {
                unsettled = true;
            }
        }
        unsettled
    }
}

/// Hands each entry of a row that need not be zero to `visit`, columns ascending.
fn for_each_entry<T: Real>(block: &Matrix<T>, row: usize, mut visit: impl FnMut(usize, T)) {
    match block {
        Matrix::Diagonal(entries) => visit(row, entries[row]),
        Matrix::Dense(columns) => {
            let size = columns.len().isqrt();
            columns
                .iter()
                .skip(row)
                .step_by(size)
                .enumerate()
                .for_each(|(column, &entry)| visit(column, entry));
        }
        Matrix::Sparse(sparse) => {
            let slots = sparse.pattern.row(row);
            let entries = sparse.pattern.columns()[slots.clone()].iter().zip(&sparse.values[slots]);
            entries.for_each(|(&column, &entry)| visit(column as usize, entry));
        }
    }
}

/// The pattern with the places of a block; `None` if it has them all.
fn widened<T: Real>(pattern: &Arc<Pattern>, block: &Matrix<T>) -> Option<Pattern> {
    if let Matrix::Sparse(sparse) = block
        && Arc::ptr_eq(&sparse.pattern, pattern)
    {
        return None;
    }
    let missing = pattern.rows().enumerate().any(|(row, slots)| {
        let mut places = pattern.columns()[slots].iter();
        let mut missing = false;
        for_each_entry(block, row, |column, _| missing |= !places.any(|&place| place as usize == column));
        missing
    });
    missing.then(|| {
        let rows = pattern.rows().enumerate().map(|(row, slots)| {
            let mut places: Vec<usize> =
                pattern.columns()[slots].iter().map(|&column| column as usize).collect();
            for_each_entry(block, row, |column, _| places.push(column));
            places.sort_unstable();
            places.dedup();
            places
        });
        Pattern::from_rows(rows)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::DenseEquations;
    use fvi_core::Block;

    fn chain(size: usize) -> Matrix<f64> {
        let diagonal = (0..size).map(|row| (row, row, 2.5 + row as f64 * 0.1));
        let near = (1..size).map(|row| (row, row - 1, -1.0));
        Matrix::symmetric(size, diagonal.chain(near))
    }

    #[test]
    fn sparse_equations_are_solved_like_dense_ones() {
        let size = 7;
        let (mass, stiffness) = (Matrix::Diagonal(vec![3.0; size]), chain(size));
        // That of the midpoint rule comes with a minus; a pattern that is known and one that grows.
        for (sign, known) in [(1.0, true), (-1.0, true), (-1.0, false)] {
            let blocks = if known { vec![&mass, &stiffness] } else { vec![&mass] };
            let mut sparse = SparseEquations::new(&Elimination::of(size, &blocks), 1);
            let mut dense = DenseEquations::new(size, 1);
            Equations::<f64, _>::clear(&mut sparse);
            dense.clear();
            for (factor, block) in [(2.0, &mass), (0.5, &stiffness)] {
                sparse.add(0, 0, sign * factor, block);
                dense.add(0, 0, sign * factor, block);
            }
            let right: Vec<f64> = (0..size).map(|i| (1.0 + i as f64).sin()).collect();
            let (mut found, mut kept, mut expected) = (right.clone(), right.clone(), right);
            Equations::<f64, Matrix<f64>>::solve(&mut sparse, &mut found).unwrap();
            let mut factored = None;
            sparse.keep(&mut factored, (0.0, &Matrix::Diagonal(Vec::new()))).unwrap();
            Equations::<f64, Matrix<f64>>::solve_kept(&mut sparse, &factored, &mut kept);
            dense.solve(&mut expected).unwrap();
            for (found, expected) in found.iter().chain(&kept).zip(expected.iter().cycle()) {
                assert!((found - expected).abs() < 1e-14, "{sign} {known}: {found} {expected}");
            }
        }
    }

    #[test]
    fn each_motion_is_corrected_again_where_its_residual_is_more_than_rounding() {
        let size = 5;
        let stiffness = chain(size);
        let mut equations = SparseEquations::new(&Elimination::of(size, &[&stiffness]), 1);
        Equations::<f64, _>::clear(&mut equations);
        equations.add(0, 0, -1.0, &stiffness);
        let mut kept = None;
        equations.keep(&mut kept, (0.0, &Matrix::Diagonal(Vec::new()))).unwrap();
        let increments: Vec<f64> = (0..2 * size).map(|i| 1e3 * (1.0 + i as f64).sin()).collect();
        let unsettled = |increments: &[f64], residual: &mut [f64]| {
            Equations::<f64, Matrix<f64>>::is_unsettled(&equations, &kept, increments, &[0.0; 10], residual)
        };
        // The residual of what solves the equations, and one that is a millionth of them.
        let mut right = vec![0.0; 2 * size];
        for (x, b) in increments.chunks(size).zip(right.chunks_mut(size)) {
            stiffness.multiply_add(-1.0, x, b);
        }
        let mut solved = right.clone();
        if let Some(kept) = &kept {
            kept.solve(&mut Vec::new(), &mut solved);
        }
        for (x, b) in solved.chunks(size).zip(right.chunks_mut(size)) {
            stiffness.multiply_add(1.0, x, b);
        }
        assert!(!unsettled(&increments, &mut right.clone()), "{right:?}");
        right[size + 2] = 1e-3;
        let mut left = right.clone();
        assert!(unsettled(&increments, &mut left));
        assert!(left[..size].iter().all(|&r| r == 0.0) && left[size..] == right[size..]);
        // Nothing that is not finite passes for rounding.
        for bad in [f64::NAN, f64::INFINITY] {
            let mut increments = increments.clone();
            increments[1] = bad;
            assert!(unsettled(&increments, &mut [bad; 10]));
        }
    }

    #[test]
    fn a_singular_matrix_is_refused() {
        let zero = Matrix::Diagonal(vec![1.0, 0.0, 1.0]);
        let mut equations = SparseEquations::new(&Elimination::of(3, &[&zero]), 1);
        Equations::<f64, _>::clear(&mut equations);
        equations.add(0, 0, 1.0, &zero);
        assert!(Equations::<f64, Matrix<f64>>::solve(&mut equations, &mut [1.0; 3]).is_err());
    }
}
