//! Sparse equations of many coordinates, and their factors.

use super::matrices::Matrix;
use fvi_core::{DiscreteLagrangian, Equations, Real, Singular, max_or_nan};
use fvi_scenario::scenario::KnownMatrices;
use fvi_sparse::{Analysis, Factor, Pattern};
use std::sync::Arc;

/// Plan of the elimination for the equations of a step, made before the first step.
#[derive(Clone, Debug)]
pub struct Elimination {
    pattern: Arc<Pattern>,
    analysis: Analysis,
    /// Transformation to symmetric form, for two unknown nodes.
    pair: Option<StagePair>,
}

impl Elimination {
    /// Analyses the union of the patterns of these matrices.
    pub fn of<T: Real>(coordinates: usize, blocks: &[&Matrix<T>]) -> Self {
        Self::with_pattern(Self::places_of(coordinates, blocks))
    }

    /// The same, using an equal pattern of another scenario if there is one.
    pub fn knowing<T: Real>(coordinates: usize, blocks: &[&Matrix<T>], known: &KnownMatrices) -> Self {
        Self::with_pattern(known.pattern(Self::places_of(coordinates, blocks)))
    }

    fn places_of<T: Real>(coordinates: usize, blocks: &[&Matrix<T>]) -> Arc<Pattern> {
        let sparse = blocks.iter().filter_map(|block| match block {
            Matrix::Sparse(sparse) => Some(&sparse.pattern),
            _ => None,
        });
        // Often the stiffness includes all other patterns, and has been analysed already.
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
        Self { analysis: Analysis::new(&pattern), pattern, pair: None }
    }

    /// The same for equations of two unknown nodes.
    #[must_use]
    pub fn of_pairs(self, pair: StagePair) -> Self {
        Self { analysis: self.analysis.of_pairs(), pair: Some(pair), ..self }
    }

    /// Number of coordinates N.
    pub fn coordinates(&self) -> usize {
        self.pattern.size()
    }

    /// Unknown nodes of a step.
    pub fn nodes(&self) -> usize {
        if self.pair.is_some() { 2 } else { 1 }
    }

    /// Number of entries of the factor.
    pub fn factor_len(&self) -> usize {
        self.analysis.factor_len()
    }

    /// Bytes of the factor.
    pub fn factor_bytes(&self) -> usize {
        self.analysis.factor_bytes()
    }

    /// Number of places in the matrix.
    pub fn places(&self) -> usize {
        self.pattern.len() * if self.pair.is_some() { 4 } else { 1 }
    }
}

/// A 2×2 matrix row by row, one row or column for each unknown node.
type Pair = [[f64; 2]; 2];

/// Transformation of the equations of a step with two unknown nodes, damped at two quadrature nodes or at
/// none, to symmetric and quasidefinite form.
///
/// With the stages X_i = q_k + Σ_μ ℓ_μ(c_i) e^μ as unknowns and equations combined such that each contains
/// the force of one stage, the matrix is
///
/// ```text
/// h [K₁ + a₁₁ M/h²    a₁₂ M/h²     ;
///    a₂₁ M/h²         K₂ + a₂₂ M/h²] ,
/// ```
///
/// K_i the stiffness at stage i with the leading weights of the damping there. For Gauss's rule a = (A²)⁻¹ =
/// [6, 6(2√3 − 3); −6(2√3 + 3), 6], A that of collocation. With g² = −a₂₁/a₁₂, the second unknown multiplied
/// by g and the second equation by −1/g it becomes
///
/// ```text
/// h [K₁ + a₁₁ M/h²    c M/h²          ;
///    c M/h²           −(K₂ + a₂₂ M/h²)] ,       c = g a₁₂ = 6√3 ,
/// ```
///
/// which is quasidefinite, and has a factor L Σ Lᵀ for every order of elimination, if G_i = K_i + a_ii M/h²
/// is positive definite. There is hardly any growth of its numbers if K_i is positive semidefinite
/// (\[GillSaundersShinnerl96\]): (c M/h²) G_i⁻¹ (c M/h²) ≤ (c²/a₁₁) M/h² = 3 a₁₁ M/h² ≤ 3 G_j.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StagePair {
    /// Combinations of the equations: each row has one coefficient for each equation.
    equations: Pair,
    /// Combinations of the unknowns: each row has one coefficient for each new unknown.
    unknowns: Pair,
}

impl StagePair {
    /// The transformation for a discrete Lagrangian; `None` if it does not have two unknown nodes and two
    /// points, or its equations cannot be brought into this form.
    pub fn of<T: Real>(lagrangian: &DiscreteLagrangian<'_, T>) -> Option<Self> {
        fn pair<T: Real>(numbers: &[T]) -> Option<Pair> {
            let numbers: &[T; 4] = numbers.try_into().ok()?;
            let [a, b, c, d] = numbers.each_ref().map(|number| number.to_f64());
            Some([[a, b], [c, d]])
        }
        let &[first, second] = lagrangian.weights else { return None };
        // One row for each node.
        let (shapes, [one, other]) = (pair(lagrangian.shapes)?, pair(lagrangian.tests)?);
        // Row ν and column μ of the matrix have −h Σ_i b_i ℓ_ν(c_i) ℓ_μ(c_i) K_i.
        let (first, second) = (-first.to_f64(), -second.to_f64());
        let forces = [[first * one[0], second * other[0]], [first * one[1], second * other[1]]];
        let (mut equations, mut unknowns) = (inverse(forces)?, inverse(shapes)?);
        let inertia = product(product(equations, pair(lagrangian.kinetic)?), unknowns);
        let square = -inertia[1][0] / inertia[0][1];
        if !(inertia[0][0] > 0.0 && inertia[1][1] > 0.0 && square > 0.0 && square.is_finite()) {
            return None;
        }
        let scale = square.sqrt();
        equations[1] = equations[1].map(|number| -number / scale);
        unknowns.iter_mut().for_each(|row| row[1] *= scale);
        Some(Self { equations, unknowns })
    }
}

fn product(a: Pair, b: Pair) -> Pair {
    core::array::from_fn(|row| {
        core::array::from_fn(|column| a[row][0] * b[0][column] + a[row][1] * b[1][column])
    })
}

fn inverse([[a, b], [c, d]]: Pair) -> Option<Pair> {
    let determinant = a * d - b * c;
    let size = (a * d).abs() + (b * c).abs();
    (determinant.abs() > 1e-3 * size)
        .then(|| [[d, -b], [-c, a]].map(|row| row.map(|number| number / determinant)))
}

/// The sparse equations of a step: for one unknown node the matrix is symmetric and definite, for two it is
/// transformed to be [symmetric and quasidefinite](StagePair).
///
/// The pattern is analysed once. Newton's method factors the matrix only if it differs from the last one
/// factored.
pub struct SparseEquations {
    pattern: Arc<Pattern>,
    /// Analysis of the pattern; `None` after it has grown.
    analysis: Option<Analysis>,
    pair: Option<StagePair>,
    /// One value for each place, times `sign`; four for pairs.
    values: Vec<f64>,
    /// The sign that makes the first entry positive; 0 while nothing has been added.
    sign: f64,
    /// Number of threads for a solution.
    threads: usize,
    /// The last matrix factored for a single solution, with its factor.
    last: Option<(Vec<f64>, Factored)>,
    /// The vector in double precision.
    buffer: Vec<f64>,
}

/// The factor of a matrix A, or of −A.
pub struct Factored {
    factor: Factor,
    pair: Option<StagePair>,
    sign: f64,
    threads: usize,
    /// √A_ii; empty for pairs.
    scales: Vec<f64>,
}

/// Size of a residual, in rounding errors of its terms, up to which one correction suffices.
const ROUNDINGS: f64 = 32.0;

impl Factored {
    fn solve<T: Real>(&self, buffer: &mut Vec<f64>, vector: &mut [T]) {
        if let Some(pair) = &self.pair {
            return self.solve_pairs(pair, buffer, vector);
        }
        buffer.clear();
        buffer.extend(vector.iter().map(|number| number.to_f64() * self.sign));
        self.factor.solve_on_threads(buffer, self.threads);
        vector.iter_mut().zip(buffer.iter()).for_each(|(place, &number)| *place = T::of(number));
    }

    /// Solves for both nodes as pairs; the numbers of the first node for all motions come before those of the
    /// second.
    fn solve_pairs<T: Real>(&self, pair: &StagePair, buffer: &mut Vec<f64>, vector: &mut [T]) {
        let (first, second) = vector.split_at_mut(vector.len() / 2);
        let combined = |[a, b]: [f64; 2], x: f64, y: f64| a * x + b * y;
        buffer.clear();
        for (x, y) in first.iter().zip(&*second) {
            let (x, y) = (x.to_f64(), y.to_f64());
            buffer.extend(pair.equations.map(|row| combined(row, x, y)));
        }
        self.factor.solve_on_threads(buffer, self.threads);
        for ((first, second), solved) in first.iter_mut().zip(second).zip(buffer.chunks_exact(2)) {
            let [x, y] = pair.unknowns.map(|row| combined(row, solved[0], solved[1]));
            (*first, *second) = (T::of(x), T::of(y));
        }
    }
}

impl SparseEquations {
    /// Storage for equations with this plan, on at most the given number of threads.
    pub fn new(plan: &Elimination, threads: usize) -> Self {
        Self {
            pattern: Arc::clone(&plan.pattern),
            analysis: Some(plan.analysis.clone()),
            pair: plan.pair,
            values: Vec::new(),
            sign: 0.0,
            threads,
            last: None,
            buffer: Vec::new(),
        }
    }

    /// Number of values at each place of the pattern.
    fn numbers(&self) -> usize {
        if self.pair.is_some() { 4 } else { 1 }
    }

    fn factored(&mut self, remembers: bool) -> Result<Factored, Singular> {
        let analysis = self.analysis.get_or_insert_with(|| {
            let analysis = Analysis::new(&self.pattern);
            if self.pair.is_some() { analysis.of_pairs() } else { analysis }
        });
        let factor = match remembers {
            true => analysis.factor_of(&self.pattern, &self.values),
            false => analysis.factor(&self.pattern, &self.values),
        };
        match factor {
            Ok(factor) => {
                let rows = if self.pair.is_some() { 0 } else { self.pattern.size() };
                let diagonal = (0..rows).map(|row| self.values[self.pattern.slot(row, row)]);
                let scales = diagonal.map(f64::sqrt).collect();
                Ok(Factored { factor, pair: self.pair, sign: self.sign, threads: self.threads, scales })
            }
            Err(_) => Err(Singular),
        }
    }
}

/// Adds, at each place, the four numbers times the entry of the block.
fn add_pairs<T: Real>(pattern: &Pattern, places: &mut [[f64; 4]], numbers: &[f64], block: &Matrix<T>) {
    for (row, slots) in pattern.rows().enumerate() {
        let mut places = pattern.columns()[slots.clone()].iter().zip(&mut places[slots]);
        for_each_entry(block, row, |column, entry| {
            if let Some((_, place)) = places.find(|(place, _)| **place as usize == column) {
                let entry = entry.to_f64();
                place.iter_mut().zip(numbers).for_each(|(place, number)| *place += number * entry);
            }
        });
    }
}

impl<T: Real> Equations<T, Matrix<T>> for SparseEquations {
    type Factor = Option<Factored>;

    fn clear(&mut self) {
        self.values.clear();
        self.values.resize(self.pattern.len() * self.numbers(), 0.0);
        self.sign = 0.0;
    }

    fn add(&mut self, row: usize, column: usize, factor: T, block: &Matrix<T>) {
        let factor = factor.to_f64();
        if factor == 0.0 {
            return;
        }
        if self.sign == 0.0 {
            self.sign = factor.signum();
        }
        if let Some(wider) = widened(&self.pattern, block) {
            let numbers = self.numbers();
            let mut values = vec![0.0; wider.len() * numbers];
            for (new, old) in wider.rows().zip(self.pattern.rows()) {
                let mut places = wider.columns()[new.clone()].iter().zip(new);
                for (&column, old) in self.pattern.columns()[old.clone()].iter().zip(old) {
                    if let Some((_, new)) = places.find(|(other, _)| **other == column) {
                        values[new * numbers..(new + 1) * numbers]
                            .copy_from_slice(&self.values[old * numbers..(old + 1) * numbers]);
                    }
                }
            }
            (self.values, self.pattern) = (values, Arc::new(wider));
            (self.analysis, self.last) = (None, None);
        }
        if let Some(StagePair { equations, unknowns }) = &self.pair {
            let numbers: Pair = core::array::from_fn(|own| {
                unknowns[column].map(|unknown| factor * equations[own][row] * unknown)
            });
            let places = self.values.as_chunks_mut::<4>().0;
            return add_pairs(&self.pattern, places, numbers.as_flattened(), block);
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
            // The old factor is dropped first: there may not be memory for two.
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

    /// For one unknown node, for each motion separately: |r_i| > 32 ε √A_ii · max_j √A_jj (|e_j| + |q_j|) for
    /// some i, or not a number. For two nodes always true.
    ///
    /// The factor is that of A + E with E symmetric and |E_ij| ≤ c ε √(A_ii A_jj), c growing with the number
    /// of entries of a row (\[Demmel89\] theorem 2.1), and the entries of A and of its stiffness are bounded
    /// by their diagonals likewise: the right-hand side bounds the rounding of the residual and of the forces
    /// in it. Below it another correction would only add rounding errors. The effect of E at every step is
    /// harmless: the midpoint rule with A + E is that of the mass M + h E, and stable if that is definite.
    fn is_unsettled(
        &self,
        kept: &Option<Factored>,
        increments: &[T],
        position: &[T],
        residual: &mut [T],
    ) -> bool {
        // The rounding errors of a pair's factor are not equivalent to a change of the mass.
        let Some(Factored { scales, pair: None, .. }) = kept else { return true };
        let size = scales.len().max(1);
        let motions = increments.chunks(size).zip(position.chunks(size)).zip(residual.chunks_mut(size));
        let mut unsettled = false;
        for ((increments, position), residual) in motions {
            let scaled = increments.iter().zip(position).zip(scales);
            let sizes = scaled.map(|((e, q), scale)| scale * (e.to_f64().abs() + q.to_f64().abs()));
            let largest = sizes.fold(0.0, max_or_nan);
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

/// Calls `visit` for each structurally nonzero entry of a row, columns ascending.
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

/// The pattern extended by the places of a block; `None` if it includes them.
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
    use fvi_core::{Block, Galerkin};

    fn chain(size: usize) -> Matrix<f64> {
        let diagonal = (0..size).map(|row| (row, row, 2.5 + row as f64 * 0.1));
        let near = (1..size).map(|row| (row, row - 1, -1.0));
        Matrix::symmetric(size, diagonal.chain(near))
    }

    #[test]
    fn sparse_equations_are_solved_like_dense_ones() {
        let size = 7;
        let (mass, stiffness) = (Matrix::Diagonal(vec![3.0; size]), chain(size));
        // The matrix of the midpoint rule has a negative sign; the pattern is known in advance, or grows.
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

    fn two_gauss_points() -> Galerkin<f64, 2, 2> {
        Galerkin::new(&fvi_core::Quadrature::gauss().unwrap()).unwrap()
    }

    #[test]
    fn two_gauss_points_make_quasidefinite_equations() {
        let scheme = two_gauss_points();
        let StagePair { equations, unknowns } = StagePair::of(&scheme.view()).unwrap();
        let view = scheme.view();
        let rows = |numbers: &[f64]| [[numbers[0], numbers[1]], [numbers[2], numbers[3]]];
        let (shapes, tests) = (rows(view.shapes), rows(view.tests));
        let near = |found: Pair, expected: Pair| {
            for (found, expected) in found.as_flattened().iter().zip(expected.as_flattened()) {
                assert!((found - expected).abs() < 1e-13, "{found} {expected}");
            }
        };
        let coupling = 6.0 * 3.0_f64.sqrt();
        near(product(product(equations, rows(view.kinetic)), unknowns), [[6.0, coupling], [coupling, -6.0]]);
        // The stiffness of each stage separately.
        for (stage, expected) in [[[1.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, -1.0]]].into_iter().enumerate()
        {
            let force = tests[stage].map(|test| shapes[stage].map(|shape| -0.5 * test * shape));
            near(product(product(equations, force), unknowns), expected);
        }
        // Not for more points, fewer unknowns, or points at the ends.
        let lobatto = fvi_core::Quadrature::<3>::lobatto().unwrap();
        assert!(StagePair::of(&Galerkin::<f64, 2, 3>::new(&lobatto).unwrap().view()).is_none());
        assert!(StagePair::of(&Galerkin::low_order(0.5).unwrap().view()).is_none());
        let ends = fvi_core::Quadrature::<2>::lobatto().unwrap();
        assert!(StagePair::of(&Galerkin::<f64, 2, 2>::new(&ends).unwrap().view()).is_none());
    }

    #[test]
    fn equations_of_two_nodes_are_solved_like_dense_ones() {
        let size = 7;
        let scheme = two_gauss_points();
        let (view, pair) = (scheme.view(), StagePair::of(&scheme.view()).unwrap());
        let mass = Matrix::Diagonal((1..=size).map(|i| i as f64).collect());
        // Another stiffness at each stage, the second with a place that is not in the pattern.
        let more = Matrix::symmetric(size, [(0, 0, 3.0), (3, 1, 0.5), (6, 2, -0.25)].into_iter());
        let stiffness = [chain(size), more];
        let plan = Elimination::of(size, &[&mass, &stiffness[0]]).of_pairs(pair);
        assert_eq!((plan.nodes(), plan.places()), (2, 4 * (3 * size - 2)));
        let mut sparse = SparseEquations::new(&plan, 1);
        let mut dense = DenseEquations::new(size, 2);
        Equations::<f64, _>::clear(&mut sparse);
        dense.clear();
        let mut add = |row, column, factor, block: &Matrix<f64>| {
            sparse.add(row, column, factor, block);
            dense.add(row, column, factor, block);
        };
        for row in 0..2 {
            for column in 0..2 {
                add(row, column, 4.0 * view.kinetic[2 * row + column], &mass);
                for (stage, block) in stiffness.iter().enumerate() {
                    let of_stage = view.tests[2 * stage + row] * view.shapes[2 * stage + column];
                    add(row, column, -0.125 * of_stage, block);
                }
            }
        }
        let right: Vec<f64> = (0..2 * size).map(|i| (1.0 + i as f64).sin()).collect();
        let (mut found, mut kept, mut expected) = (right.clone(), right.clone(), right);
        Equations::<f64, Matrix<f64>>::solve(&mut sparse, &mut found).unwrap();
        let mut factored = None;
        sparse.keep(&mut factored, (0.0, &mass)).unwrap();
        Equations::<f64, Matrix<f64>>::solve_kept(&mut sparse, &factored, &mut kept);
        dense.solve(&mut expected).unwrap();
        for (found, expected) in found.iter().chain(&kept).zip(expected.iter().cycle()) {
            assert!((found - expected).abs() < 1e-14, "{found} {expected}");
        }
        // With a factor in pairs every residual needs a correction.
        let at_rest = vec![0.0; size];
        assert!(Equations::<f64, Matrix<f64>>::is_unsettled(
            &sparse,
            &factored,
            &kept,
            &at_rest,
            &mut vec![0.0; 2 * size]
        ));
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
        // The residual of the exact solution, and one of a millionth of the right-hand side.
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
        // A residual that is not finite does not count as rounding.
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
