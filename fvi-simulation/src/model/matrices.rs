//! Matrices with the number of coordinates of a scenario, and equations eliminated in a full matrix or within
//! its band.

use super::band::{self, BandFactors};
use super::chain::{Chain, ChainFactors};
use super::equilibrium::solve_far_apart;
use super::few::{few, few_mut};
use super::shared::Shared;
use fvi_core::{Block, Equations, MatrixError, Real, Singular, max_or_nan};
use fvi_core::{add_multiple, combine_four, combine_two, is_positive_definite_in_place};
use fvi_core::{keep_factors, substitute, substitute_kept};
use fvi_sparse::Pattern;
use fvi_sparse::check_positive_semidefinite;
use std::sync::Arc;

/// An N×N matrix: diagonal, full or sparse.
#[derive(Clone, Debug, PartialEq)]
pub enum Matrix<T> {
    /// Diagonal entries.
    Diagonal(Vec<T>),
    /// All entries, column by column.
    Dense(Vec<T>),
    /// Structurally nonzero entries.
    Sparse(Sparse<T>),
}

/// The structurally nonzero entries of a matrix, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Sparse<T> {
    /// Places of the entries.
    pub pattern: Arc<Pattern>,
    /// One number for each place of the pattern.
    pub values: Shared<T>,
    /// Number of threads for a product.
    pub threads: usize,
}

impl<T: Real> Sparse<T> {
    /// The zero matrix with a pattern.
    pub fn zero(pattern: Arc<Pattern>) -> Self {
        let values = Shared::Own(vec![T::zero(); pattern.len()]);
        Self { pattern, values, threads: 1 }
    }

    /// out ← out + factor A x, for vectors with one number for each row of A, or for several motions one
    /// after another.
    fn multiply_add(&self, factor: T, x: &[T], out: &mut [T]) {
        // The first increments of a linear step are zero.
        if x.iter().all(|&x| x == T::zero()) {
            return;
        }
        let Some(rows) = self.tridiagonal() else {
            return self.pattern.multiply_add(&self.values, factor, x, out, self.threads);
        };
        let size = self.pattern.size();
        if x.len() == size {
            return rows.multiply_add(factor, x, out);
        }
        for (x, out) in x.chunks_exact(size).zip(out.chunks_exact_mut(size)) {
            rows.multiply_add(factor, x, out);
        }
    }

    /// True if the matrix is tridiagonal with all its entries stored.
    pub(super) fn is_tridiagonal(&self) -> bool {
        self.pattern.is_chain()
    }

    /// The entries without their columns if the matrix is tridiagonal: chains are common.
    fn tridiagonal(&self) -> Option<Tridiagonal<'_, T>> {
        if !self.pattern.is_chain() {
            return None;
        }
        let [diagonal, right, middle @ .., left, last] = &*self.values else { return None };
        Some(Tridiagonal { first: [*diagonal, *right], middle: middle.as_chunks().0, last: [*left, *last] })
    }
}

/// A tridiagonal matrix with all its entries stored, row by row.
struct Tridiagonal<'a, T> {
    first: [T; 2],
    middle: &'a [[T; 3]],
    last: [T; 2],
}

impl<T: Real> Tridiagonal<'_, T> {
    /// out ← out + factor · A x
    fn multiply_add(&self, factor: T, x: &[T], out: &mut [T]) {
        let put = |out: &mut T, row: T| *out += row * factor;
        let ([x0, x1, x_from_third @ ..], [.., left, last]) = (x, x) else { return };
        let [out_first, out_middle @ .., out_last] = out else { return };
        let row = |[a, b]: [T; 2], x: T, y: T| a * x + b * y;
        put(out_first, row(self.first, *x0, *x1));
        let (mut x, mut y) = (*x0, *x1);
        for ((out, &[l, d, r]), &z) in out_middle.iter_mut().zip(self.middle).zip(x_from_third) {
            put(out, l * x + d * y + r * z);
            (x, y) = (y, z);
        }
        put(out_last, row(self.last, *left, *last));
    }
}

impl<T: Real> Matrix<T> {
    /// As [`balance`](Block::balance), for any matrix.
    #[inline(never)]
    fn balance_any(&self, (start, (by, force)): (&[T], (T, &[T])), (factor, x): (T, &[T]), out: &mut [T]) {
        out.copy_from_slice(start);
        self.multiply_add(factor, x, out);
        add_multiple(out, -by, force);
    }

    /// The stored entries.
    #[inline]
    pub(super) fn numbers(&self) -> &[T] {
        match self {
            Self::Diagonal(entries) | Self::Dense(entries) => entries,
            Self::Sparse(sparse) => &sparse.values,
        }
    }

    /// out += factor · (B x) for any matrix, and several motions one after another. Kept out of line so that
    /// only the code for a diagonal is inlined.
    #[inline(never)]
    fn multiply_add_any(&self, factor: T, x: &[T], out: &mut [T]) {
        if let Self::Sparse(sparse) = self {
            return sparse.multiply_add(factor, x, out);
        }
        let size = self.size().max(1);
        for (x, out) in x.chunks(size).zip(out.chunks_mut(size)) {
            match self {
                Self::Diagonal(diagonal) => multiply_add_diagonal(diagonal, factor, x, out),
                Self::Dense(columns) => multiply_add_dense(columns, factor, x, out),
                Self::Sparse(sparse) => sparse.multiply_add(factor, x, out),
            }
        }
    }

    /// The entries of a symmetric matrix of `size` rows from those of its lower triangle.
    pub fn symmetric(size: usize, lower: impl Iterator<Item = (usize, usize, T)> + Clone) -> Self {
        if lower.clone().all(|(row, column, _)| row == column) {
            let mut diagonal = vec![T::zero(); size];
            lower.for_each(|(row, _, entry)| diagonal[row] += entry);
            return Self::Diagonal(diagonal);
        }
        let both = |(row, column, _): (usize, usize, T)| [(row, column), (column, row)];
        let pattern = Pattern::new(size, lower.clone().flat_map(both).collect());
        // If half or more of the entries are stored, a full matrix is as good.
        if 2 * pattern.len() > size * size {
            let mut dense = vec![T::zero(); size * size];
            for (row, column, entry) in lower {
                dense[column * size + row] += entry;
                if row != column {
                    dense[row * size + column] += entry;
                }
            }
            return Self::Dense(dense);
        }
        let mut values = vec![T::zero(); pattern.len()];
        for (row, column, entry) in lower {
            values[pattern.slot(row, column)] += entry;
            if row != column {
                values[pattern.slot(column, row)] += entry;
            }
        }
        Self::Sparse(Sparse { pattern: Arc::new(pattern), values: Shared::Own(values), threads: 1 })
    }

    /// The matrix of `size` rows with these entries; entries at the same place are added.
    pub fn of_entries(size: usize, entries: impl Iterator<Item = (usize, usize, f64)> + Clone) -> Self {
        let pattern = Pattern::new(size, entries.clone().map(|(row, column, _)| (row, column)).collect());
        let mut values = vec![T::zero(); pattern.len()];
        entries.for_each(|(row, column, entry)| values[pattern.slot(row, column)] += T::of(entry));
        Self::Sparse(Sparse { pattern: Arc::new(pattern), values: Shared::Own(values), threads: 1 })
    }

    /// The same matrix, with products on at most the given number of threads; the bits are the same.
    #[must_use]
    pub fn on_threads(self, threads: usize) -> Self {
        match self {
            Self::Sparse(sparse) => Self::Sparse(Sparse { threads, ..sparse }),
            other => other,
        }
    }

    /// out ← out + factor · Bᵀ x
    pub(crate) fn transposed_multiply_add(&self, factor: T, x: &[T], out: &mut [T]) {
        match self {
            Self::Diagonal(_) => self.multiply_add(factor, x, out),
            Self::Dense(columns) => {
                for (out, column) in out.iter_mut().zip(columns.chunks_exact(x.len().max(1))) {
                    let sum = column.iter().zip(x).fold(T::zero(), |sum, (&entry, &x)| sum + entry * x);
                    *out += factor * sum;
                }
            }
            Self::Sparse(sparse) => {
                for (slots, &x) in sparse.pattern.rows().zip(x) {
                    for slot in slots {
                        let column = sparse.pattern.columns()[slot] as usize;
                        out[column] += factor * sparse.values[slot] * x;
                    }
                }
            }
        }
    }

    /// out ← out + Bᵀ x for several vectors, one after another.
    pub(crate) fn transposed_multiply_add_all(&self, x: &[T], out: &mut [T]) {
        let size = self.size().max(1);
        let pairs = x.chunks(size).zip(out.chunks_mut(size));
        pairs.for_each(|(x, out)| self.transposed_multiply_add(T::one(), x, out));
    }

    /// Number of rows.
    pub fn size(&self) -> usize {
        match self {
            Self::Diagonal(entries) => entries.len(),
            Self::Dense(entries) => entries.len().isqrt(),
            Self::Sparse(sparse) => sparse.pattern.size(),
        }
    }

    /// Largest distance of a structurally nonzero entry from the diagonal.
    fn band(&self) -> usize {
        match self {
            Self::Diagonal(_) => 0,
            Self::Dense(columns) => columns.len().isqrt().saturating_sub(1),
            Self::Sparse(sparse) => sparse.pattern.band(),
        }
    }

    /// The structurally nonzero entries as (row, column, entry).
    pub fn entries(&self) -> Vec<(usize, usize, T)> {
        match self {
            Self::Diagonal(diagonal) => {
                diagonal.iter().enumerate().map(|(index, &entry)| (index, index, entry)).collect()
            }
            Self::Dense(columns) => {
                let size = columns.len().isqrt();
                let place = |(index, &entry)| (index % size, index / size, entry);
                columns.iter().enumerate().map(place).collect()
            }
            Self::Sparse(sparse) => {
                let rows = sparse.pattern.rows().enumerate();
                let places = rows.flat_map(|(row, slots)| slots.map(move |slot| (row, slot)));
                places
                    .map(|(row, slot)| (row, sparse.pattern.columns()[slot] as usize, sparse.values[slot]))
                    .collect()
            }
        }
    }
}

#[inline(always)]
fn multiply_add_diagonal<T: Real>(diagonal: &[T], factor: T, x: &[T], out: &mut [T]) {
    combine_two(out, diagonal, x, |out, entry, x| out + entry * x * factor);
}

fn multiply_add_dense<T: Real>(columns: &[T], factor: T, x: &[T], out: &mut [T]) {
    for (column, &x) in columns.chunks_exact(out.len().max(1)).zip(x) {
        // Rounded like the products of other matrices.
        out.iter_mut().zip(column).for_each(|(out, &entry)| *out += entry * x * factor);
    }
}

impl<T: Real> Block<T> for Matrix<T> {
    #[inline(always)]
    fn balance(&self, (start, (by, force)): (&[T], (T, &[T])), (factor, x): (T, &[T]), out: &mut [T]) {
        match self {
            Self::Diagonal(diagonal) if diagonal.len() == x.len() => {
                combine_four(out, (start, diagonal), (x, force), |start, entry, x, force| {
                    start + entry * x * factor - force * by
                });
            }
            _ => self.balance_any((start, (by, force)), (factor, x), out),
        }
    }

    #[inline(always)]
    fn multiply_add(&self, factor: T, x: &[T], out: &mut [T]) {
        // One coordinate: one number, without a loop.
        if let ([x], [out]) = (x, &mut *out) {
            match self {
                Self::Diagonal(entries) | Self::Dense(entries) => {
                    if let [entry] = entries[..] {
                        *out += entry * *x * factor;
                        return;
                    }
                }
                Self::Sparse(sparse) => {
                    if let [entry] = sparse.values[..] {
                        // A row is a sum that begins with zero.
                        if *x != T::zero() {
                            *out += (T::zero() + entry * *x) * factor;
                        }
                        return;
                    }
                }
            }
        }
        match self {
            Self::Diagonal(diagonal) if diagonal.len() == x.len() => {
                multiply_add_diagonal(diagonal, factor, x, out);
            }
            _ => self.multiply_add_any(factor, x, out),
        }
    }

    fn add_to(&self, factor: T, target: &mut [T], width: usize, row: usize, column: usize) {
        match self {
            Self::Diagonal(diagonal) => {
                let mut place = row * width + column;
                for &entry in diagonal {
                    target[place] += entry * factor;
                    place += width + 1;
                }
            }
            Self::Dense(columns) => {
                let size = columns.len().isqrt();
                let rows = target.chunks_exact_mut(width.max(1)).skip(row);
                for (index, numbers) in rows.take(size).enumerate() {
                    let entries = columns.iter().skip(index).step_by(size);
                    for (place, &entry) in numbers[column..].iter_mut().zip(entries) {
                        *place += entry * factor;
                    }
                }
            }
            Self::Sparse(sparse) => {
                for (index, slots) in sparse.pattern.rows().enumerate() {
                    let numbers = &mut target[(row + index) * width + column..];
                    for slot in slots {
                        numbers[sparse.pattern.columns()[slot] as usize] += sparse.values[slot] * factor;
                    }
                }
            }
        }
    }

    fn check_positive_semidefinite(&self) -> Result<(), MatrixError> {
        let entries = self.entries();
        if !entries.iter().all(|&(.., entry)| entry.is_finite()) {
            return Err(MatrixError::NotFinite);
        }
        let largest = entries.iter().map(|&(.., entry)| entry.abs()).fold(T::zero(), max_or_nan);
        if largest == T::zero() {
            return Ok(());
        }
        if let Self::Diagonal(diagonal) = self {
            let negative = diagonal.iter().any(|&entry| entry < T::zero());
            return if negative { Err(MatrixError::NotPositiveSemidefinite) } else { Ok(()) };
        }
        if let Self::Sparse(sparse) = self {
            let values: Vec<f64> = sparse.values.iter().map(|entry| entry.to_f64()).collect();
            let rounding = T::EPSILON.to_f64();
            return check_positive_semidefinite(&sparse.pattern, &values, rounding)
                .map_err(|_| MatrixError::NotPositiveSemidefinite);
        }
        let size = self.size();
        let mut dense = vec![T::zero(); size * size];
        self.add_to(T::one(), &mut dense, size, 0, 0);
        // A semidefinite matrix becomes definite when its diagonal is raised by the rounding error.
        let lift = largest * T::EPSILON * T::from_count(64 * size as u64);
        (0..size).for_each(|index| dense[index * size + index] += lift);
        if is_positive_definite_in_place(&mut dense, size) {
            Ok(())
        } else {
            Err(MatrixError::NotPositiveSemidefinite)
        }
    }
}

/// The equations of a step as a dense matrix, possibly with a band.
#[derive(Clone, Debug)]
pub struct DenseEquations<T> {
    /// The matrix as long as it is tridiagonal.
    chain: Option<Chain<T>>,
    /// Row by row; empty while there is a chain.
    entries: Vec<T>,
    /// Largest distance from the diagonal of the entries added so far.
    band: usize,
    coordinates: usize,
    pivots: Vec<usize>,
    /// True if the last solution has left factors.
    has_factors: bool,
}

/// Factors of [`DenseEquations`] for many right-hand sides.
#[derive(Clone, Debug)]
pub enum DenseFactors<T> {
    /// The factors, column by column; their pivots are stored with the equations, where no other matrix is
    /// factored in between.
    Whole(Vec<T>),
    /// The factors within a band.
    Banded(BandFactors<T>),
    /// The factors of a chain.
    Chain(ChainFactors<T>),
}

impl<T> Default for DenseFactors<T> {
    fn default() -> Self {
        Self::Whole(Vec::new())
    }
}

impl<T: Real> DenseEquations<T> {
    /// Equations for N coordinates and S nodes.
    pub fn new(coordinates: usize, nodes: usize) -> Self {
        let pivots = vec![0; coordinates * nodes];
        let chain = (nodes == 1 && is_banded(coordinates, 1)).then(|| Chain::zero(coordinates));
        let mut equations =
            Self { chain, entries: Vec::new(), band: 0, coordinates, pivots, has_factors: false };
        if equations.chain.is_none() {
            equations.make_room();
        }
        equations
    }

    fn make_room(&mut self) {
        let size = self.pivots.len();
        self.entries.resize(size * size, T::zero());
    }

    /// True if elimination within the band has fewer operations.
    fn is_banded(&self) -> bool {
        is_banded(self.pivots.len(), self.band)
    }

    /// Rows and pivots as arrays, if the equations are N in a full matrix.
    #[inline(always)]
    pub(super) fn arrays<const N: usize>(&mut self) -> Option<(&mut [[T; N]; N], &mut [usize; N])> {
        let Self { chain: None, entries, pivots, .. } = self else { return None };
        let (rows, []) = entries.as_chunks_mut() else { return None };
        Some((rows.try_into().ok()?, pivots.as_mut_slice().try_into().ok()?))
    }

    /// Copies the entries of a chain to the full matrix.
    #[cold]
    fn spread(&mut self, chain: &Chain<T>) {
        self.make_room();
        self.band = self.band.max(1);
        let size = self.pivots.len();
        // Entries that elimination may have filled.
        for row in 0..size {
            self.entries[row * size + row.saturating_sub(1)..row * size + (row + 3).min(size)]
                .fill(T::zero());
        }
        chain.for_each(|row, column, entry| self.entries[row * size + column] = entry);
    }

    /// Factors the chain, if there is one and pivots on its diagonal are acceptable; otherwise copies its
    /// entries to the full matrix. Returns whether there are factors.
    fn factor_chain(&mut self) -> Result<bool, Singular> {
        let Some(mut chain) = self.chain.take() else { return Ok(false) };
        let factored = chain.factor();
        if factored == Ok(false) {
            self.spread(&chain);
        }
        self.chain = Some(chain);
        factored
    }
}

/// Number of rows up to which a matrix is never banded.
const NEVER_BANDED: usize = 3;

/// True if elimination within a band has fewer operations than in the full matrix of `size` rows.
fn is_banded(size: usize, band: usize) -> bool {
    size > NEVER_BANDED && 3 * band < size
}

/// Calls `$of(matrix, pivots, vector)` with arrays where rows are few: elimination in them costs less than
/// its loops. `$few` borrows matrix and pivots.
macro_rules! of_rows {
    ($of:path, $few:ident, $matrix:expr, $pivots:expr, $vector:expr) => {
        match $pivots.len() {
            1 => $of($few::<_, 1>($matrix), $few::<_, 1>($pivots), few_mut::<_, 1>($vector)),
            2 => $of($few::<_, 4>($matrix), $few::<_, 2>($pivots), few_mut::<_, 2>($vector)),
            3 => $of($few::<_, 9>($matrix), $few::<_, 3>($pivots), few_mut::<_, 3>($vector)),
            _ => $of($matrix, $pivots, $vector),
        }
    };
}

impl<T: Real> Equations<T, Matrix<T>> for DenseEquations<T> {
    type Factor = DenseFactors<T>;

    fn clear(&mut self) {
        if let Some(chain) = &mut self.chain {
            return chain.clear();
        }
        let (n, band) = (self.pivots.len(), self.band);
        // A small matrix is cleared faster than its band is determined.
        if n <= 16 || !self.is_banded() {
            return self.entries.fill(T::zero());
        }
        // Elimination fills an equal number of entries to the right.
        for row in 0..n {
            let (first, end) = (row.saturating_sub(band), (row + 2 * band + 1).min(n));
            for entry in &mut self.entries[row * n + first..row * n + end] {
                *entry = T::zero();
            }
        }
    }

    #[inline]
    fn add(&mut self, row: usize, column: usize, factor: T, block: &Matrix<T>) {
        if let ([place], [entry]) = (&mut self.entries[..], block.numbers()) {
            // One unknown: one number, without a search for its place.
            *place += *entry * factor;
            return;
        }
        match (&mut self.chain, block) {
            (Some(chain), Matrix::Diagonal(diagonal)) => return chain.add_diagonal(factor, diagonal),
            (Some(chain), Matrix::Sparse(sparse)) if sparse.is_tridiagonal() => {
                return chain.add_rows(factor, &sparse.values);
            }
            _ => {}
        }
        if let Some(chain) = self.chain.take() {
            self.spread(&chain);
        }
        if self.pivots.len() > NEVER_BANDED {
            self.band = self.band.max(row.abs_diff(column) * self.coordinates + block.band());
        }
        let (row, column) = (row * self.coordinates, column * self.coordinates);
        block.add_to(factor, &mut self.entries, self.pivots.len(), row, column);
    }

    fn solve(&mut self, vector: &mut [T]) -> Result<(), Singular> {
        self.has_factors = self.factor_chain()?;
        if self.has_factors {
            self.solve_again(vector);
            return Ok(());
        }
        if self.is_banded() {
            return band::solve(&mut self.entries, self.band, &mut self.pivots, vector);
        }
        if self.pivots.len() > NEVER_BANDED
            && let Some(solved) = solve_far_apart(&mut self.entries, &mut self.pivots, vector)
        {
            return solved;
        }
        self.has_factors = true;
        of_rows!(fvi_core::solve, few_mut, &mut self.entries, &mut self.pivots, vector)
    }

    fn has_factors(&self) -> bool {
        self.has_factors
    }

    fn solve_again(&mut self, vector: &mut [T]) {
        match &self.chain {
            Some(chain) => chain.solve(vector),
            None => of_rows!(substitute, few, &self.entries, &self.pivots, vector),
        }
    }

    fn keep(&mut self, kept: &mut DenseFactors<T>, inertia: (T, &Matrix<T>)) -> Result<(), Singular> {
        let n = self.pivots.len();
        if let (true, Some(chain)) = (self.factor_chain()?, &self.chain) {
            let masses = match inertia.1 {
                Matrix::Diagonal(masses) => Some(masses.as_slice()),
                _ => None,
            };
            *kept = DenseFactors::Chain(chain.kept(inertia.0, masses));
            return Ok(());
        }
        if self.is_banded() {
            let factors = BandFactors::of(&mut self.entries, self.band, &mut self.pivots)?;
            *kept = DenseFactors::Banded(factors);
            return Ok(());
        }
        // The factors may fill the whole matrix.
        self.band = n;
        let mut factors = vec![T::zero(); n * n];
        keep_factors(&mut self.entries, &mut self.pivots, &mut factors)?;
        *kept = DenseFactors::Whole(factors);
        Ok(())
    }

    fn solve_kept(&mut self, kept: &DenseFactors<T>, vector: &mut [T]) {
        match kept {
            DenseFactors::Whole(factors) => {
                of_rows!(substitute_kept, few, factors, &self.pivots, vector);
            }
            DenseFactors::Banded(factors) => factors.solve(vector),
            DenseFactors::Chain(factors) => factors.solve(vector),
        }
    }

    fn is_solved_at_once(&self, kept: &DenseFactors<T>) -> bool {
        matches!(kept, DenseFactors::Chain(factors) if factors.one_solve_suffices())
    }
}
