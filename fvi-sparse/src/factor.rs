//! A = L Lᵀ, or L Σ Lᵀ with the signs of pairs, computed block by block.

use crate::Pattern;
use crate::analysis::Analysis;
use crate::blocks::Blocks;
use crate::kernels::Products;
use core::fmt;
use pulp::{Arch, Simd, WithSimd};
use std::sync::Arc;

/// Reason why a matrix has no factor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FactorError {
    /// The matrix is not positive definite, or not quasidefinite: a pivot has the wrong sign.
    Pivot {
        /// Number of pivots with the right sign before it.
        pivot: usize,
        /// The row of the pattern that the pivot belongs to, from 0.
        coordinate: usize,
    },
    /// There is not enough memory.
    NoRoom {
        /// Bytes needed for the factor.
        bytes: usize,
    },
}

impl fmt::Display for FactorError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Pivot { pivot, coordinate } => write!(
                f,
                "not positive definite: pivot {pivot} of the elimination, coordinate {coordinate}, is not positive"
            ),
            Self::NoRoom { bytes } => {
                write!(f, "the factor takes {} MB, more than there is", bytes.div_ceil(1 << 20))
            }
        }
    }
}

impl core::error::Error for FactorError {}

/// The factor L of one matrix.
#[derive(Clone, Debug)]
pub struct Factor {
    analysis: Analysis,
    /// Entries, shared with clones of the factor.
    numbers: Arc<Vec<f64>>,
}

/// Number of columns of a block that are eliminated before they update those to their right.
const PANEL: usize = 32;

impl Analysis {
    /// Factors the symmetric matrix with these values, one for each place of the pattern that was analysed,
    /// or four [in pairs](Self::of_pairs).
    ///
    /// # Errors
    /// [`FactorError`].
    pub fn factor(&self, pattern: &Pattern, values: &[f64]) -> Result<Factor, FactorError> {
        let mut numbers = Vec::new();
        let no_room = |_| FactorError::NoRoom { bytes: self.factor_bytes() };
        numbers.try_reserve_exact(self.factor_len()).map_err(no_room)?;
        numbers.resize(self.factor_len(), 0.0);
        let blocks = self.blocks();
        Arch::new().dispatch(Elimination { blocks, pattern, values, numbers: &mut numbers }).map_err(
            |pivot| FactorError::Pivot {
                pivot,
                coordinate: blocks.order[pivot] as usize / if blocks.in_pairs { 2 } else { 1 },
            },
        )?;
        Ok(Factor { analysis: self.clone(), numbers: Arc::new(numbers) })
    }
}

impl Analysis {
    /// As [`factor`](Self::factor), or a cached factor of the same matrix from the pattern.
    ///
    /// # Errors
    /// [`FactorError`].
    pub fn factor_of(&self, pattern: &Pattern, values: &[f64]) -> Result<Factor, FactorError> {
        if let Some(known) = pattern.remembered(values) {
            return Ok(known);
        }
        let factor = self.factor(pattern, values)?;
        pattern.remember(values, &factor);
        Ok(factor)
    }
}

/// Elimination, compiled once for every vector unit; a closure might not be inlined into the dispatch.
struct Elimination<'a> {
    blocks: &'a Blocks,
    pattern: &'a Pattern,
    values: &'a [f64],
    numbers: &'a mut [f64],
}

impl WithSimd for Elimination<'_> {
    type Output = Result<(), usize>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Result<(), usize> {
        eliminate(self.blocks, self.pattern, self.values, self.numbers)
    }
}

/// Marker for no block.
const NONE: u32 = u32::MAX;

/// Left-looking elimination: each block is updated from the blocks before it, then factored.
///
/// # Errors
/// Index of a pivot that has the wrong sign.
#[inline(always)]
fn eliminate(blocks: &Blocks, pattern: &Pattern, values: &[f64], numbers: &mut [f64]) -> Result<(), usize> {
    // For each block a linked list of the earlier blocks that update it next, and for each of those the first
    // of its rows that has not been used yet.
    let (mut waiting, mut next) = (vec![NONE; blocks.count()], vec![NONE; blocks.count()]);
    let mut come = vec![0; blocks.count()];
    // Index of each row within the current block.
    let mut local = vec![0_u32; blocks.order.len()];
    let (mut product, mut products) = (Vec::new(), Products::signed(blocks.in_pairs));
    for block in 0..blocks.count() {
        let (columns, rows) = (blocks.columns(block), blocks.rows(block));
        let (width, height) = (columns.len(), columns.len() + rows.len());
        let (before, own) = numbers.split_at_mut(blocks.numbers(block).start);
        let own = &mut own[..width * height];
        for (index, row) in columns.clone().chain(rows.iter().map(|&row| row as usize)).enumerate() {
            local[row] = index as u32;
        }
        for (index, &row) in blocks.order[columns.clone()].iter().enumerate() {
            let mut put = |column: usize, value: f64| {
                let place = blocks.place[column] as usize;
                if place >= columns.start + index {
                    own[index * height + local[place] as usize] += value;
                }
            };
            if blocks.in_pairs {
                let side = row as usize % 2;
                for slot in pattern.row(row as usize / 2) {
                    let column = 2 * pattern.columns()[slot] as usize;
                    put(column, values[4 * slot + 2 * side]);
                    put(column + 1, values[4 * slot + 2 * side + 1]);
                }
            } else {
                let slots = pattern.row(row as usize);
                for (&column, &value) in pattern.columns()[slots.clone()].iter().zip(&values[slots]) {
                    put(column as usize, value);
                }
            }
        }
        let mut other = std::mem::replace(&mut waiting[block], NONE);
        while other != NONE {
            let earlier = other as usize;
            other = next[earlier];
            let (depth, below) = (blocks.columns(earlier).len(), blocks.rows(earlier));
            let start = come[earlier];
            let count = below[start..].partition_point(|&row| (row as usize) < columns.end);
            let (step, owed) = (depth + below.len(), below.len() - start);
            let from = &before[blocks.numbers(earlier)][depth + start..];
            product.clear();
            product.resize(owed * count, 0.0);
            products.subtract(&mut product, owed, (owed, count, depth), (from, from), step);
            for (column, product) in product.chunks_exact(owed).enumerate() {
                let place = local[below[start + column] as usize] as usize;
                let target = &mut own[place * height..][..height];
                for (&row, &number) in below[start..].iter().zip(product).skip(column) {
                    target[local[row as usize] as usize] += number;
                }
            }
            come[earlier] = start + count;
            if let Some(&row) = below.get(start + count) {
                let later = blocks.block_of[row as usize] as usize;
                next[earlier] = std::mem::replace(&mut waiting[later], earlier as u32);
            }
        }
        factor_block(own, width, height, &mut products, blocks.in_pairs)
            .map_err(|pivot| columns.start + pivot)?;
        if let Some(&row) = rows.first() {
            let later = blocks.block_of[row as usize] as usize;
            next[block] = std::mem::replace(&mut waiting[later], block as u32);
        }
    }
    Ok(())
}

/// Factors the lower trapezoid of a block of `width` columns and `height` rows in place; in pairs the second
/// columns have negative pivots.
#[inline(always)]
fn factor_block(
    own: &mut [f64],
    width: usize,
    height: usize,
    products: &mut Products,
    in_pairs: bool,
) -> Result<(), usize> {
    let mut first = 0;
    while first < width {
        let end = (first + PANEL).min(width);
        let (done, panel) = own.split_at_mut(first * height);
        if first > 0 {
            let shape = (height - first, end - first, first);
            products.subtract(&mut panel[first..], height, shape, (&done[first..], &done[first..]), height);
        }
        for column in first..end {
            let (own, right) = panel[(column - first) * height..].split_at_mut(height);
            let sign = if in_pairs && column % 2 == 1 { -1.0 } else { 1.0 };
            let pivot = sign * own[column];
            if !(pivot > 0.0 && pivot.is_finite()) {
                return Err(column);
            }
            let root = pivot.sqrt();
            own[column] = root;
            let divisor = sign * root;
            own[column + 1..].iter_mut().for_each(|number| *number /= divisor);
            for (index, target) in right.chunks_exact_mut(height).take(end - column - 1).enumerate() {
                let row = column + 1 + index;
                let factor = sign * own[row];
                for (place, &number) in target[row..].iter_mut().zip(&own[row..]) {
                    *place -= factor * number;
                }
            }
        }
        first = end;
    }
    Ok(())
}

impl Factor {
    /// Number of rows.
    pub fn size(&self) -> usize {
        self.analysis.size()
    }

    /// Bytes of the entries.
    pub fn bytes(&self) -> usize {
        self.numbers.len() * size_of::<f64>()
    }

    /// The order of elimination and the places of the numbers.
    pub(crate) fn blocks(&self) -> &Blocks {
        self.analysis.blocks()
    }

    /// The entries, block by block.
    pub(crate) fn numbers(&self) -> &[f64] {
        &self.numbers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The matrix of a cube of springs, k×k×k points.
    fn cube(k: usize) -> (Pattern, Vec<f64>) {
        let n = k * k * k;
        let near = move |a: usize, b: usize| {
            let apart = |unit: usize| (a / unit % k).abs_diff(b / unit % k);
            apart(1) + apart(k) + apart(k * k) <= 1
        };
        let pattern = Pattern::from_rows((0..n).map(|a| (0..n).filter(move |&b| near(a, b))));
        let value = |row: usize, column: usize| {
            if row == column {
                6.0 + (row as f64).sin().abs()
            } else {
                -1.0 + 0.1 * ((row + column) as f64).cos()
            }
        };
        let rows = pattern.rows().enumerate();
        let values = rows
            .flat_map(|(row, slots)| slots.map(move |slot| (row, slot)))
            .map(|(row, slot)| value(row, pattern.columns()[slot] as usize))
            .collect();
        (pattern, values)
    }

    fn product(pattern: &Pattern, values: &[f64], x: &[f64]) -> Vec<f64> {
        let entry = |slot: usize| values[slot] * x[pattern.columns()[slot] as usize];
        pattern.rows().map(|slots| slots.map(entry).sum()).collect()
    }

    #[test]
    fn a_factor_solves_one_and_several_right_hand_sides() {
        for k in [1, 2, 3, 8, 11] {
            let (pattern, values) = cube(k);
            let analysis = Analysis::new(&pattern);
            let factor = analysis.factor(&pattern, &values).unwrap();
            assert_eq!(factor.bytes(), analysis.factor_bytes());
            let n = k * k * k;
            let known: Vec<f64> = (0..3 * n).map(|i| (i as f64 * 0.7).sin() + 0.1).collect();
            let pushed: Vec<f64> = known.chunks(n).flat_map(|x| product(&pattern, &values, x)).collect();
            let mut together = pushed.clone();
            factor.solve(&mut together);
            for (found, known) in together.iter().zip(&known) {
                assert!((found - known).abs() < 1e-13, "k = {k}: {found} {known}");
            }
            let mut alone = pushed[n..2 * n].to_vec();
            factor.solve(&mut alone);
            assert_eq!(alone, together[n..2 * n], "k = {k}");
        }
    }

    #[test]
    fn a_pattern_that_remembers_hands_out_the_factor_of_the_same_matrix() {
        let (pattern, values) = cube(5);
        let other: Vec<f64> = values.iter().map(|value| 2.0 * value).collect();
        let shares = |one: &Factor, other: &Factor| Arc::ptr_eq(&one.numbers, &other.numbers);
        let analysis = Analysis::new(&pattern);
        let alone = analysis.factor_of(&pattern, &values).unwrap();
        assert!(!shares(&alone, &analysis.factor_of(&pattern, &values).unwrap()));
        let pattern = pattern.remembering_factors();
        let first = analysis.factor_of(&pattern, &values).unwrap();
        assert!(first.numbers == alone.numbers);
        let second = analysis.factor_of(&pattern, &other).unwrap();
        assert!(shares(&first, &analysis.factor_of(&pattern, &values).unwrap()));
        assert!(shares(&second, &analysis.factor_of(&pattern.clone(), &other).unwrap()));
        // A third factor replaces the one that was not used for longest.
        analysis.factor_of(&pattern, &vec![1.0; values.len()]).unwrap_err();
        let third: Vec<f64> = values.iter().map(|value| 3.0 * value).collect();
        analysis.factor_of(&pattern, &third).unwrap();
        assert!(shares(&second, &analysis.factor_of(&pattern, &other).unwrap()));
        assert!(!shares(&first, &analysis.factor_of(&pattern, &values).unwrap()));
    }

    #[test]
    fn threads_leave_every_bit_of_a_solution_as_it_is() {
        // Large enough to be divided into subtrees and shared among threads.
        let (pattern, values) = cube(17);
        let factor = Analysis::new(&pattern).factor(&pattern, &values).unwrap();
        assert!(factor.blocks().subtrees.parts.len() > 2);
        let n = pattern.size();
        let known: Vec<f64> = (0..8 * n).map(|i| (i as f64 * 0.7).sin() + 0.1).collect();
        let pushed: Vec<f64> = known.chunks(n).flat_map(|x| product(&pattern, &values, x)).collect();
        let mut alone = pushed.clone();
        factor.solve(&mut alone);
        assert!(alone.iter().zip(&known).all(|(found, known)| (found - known).abs() < 1e-12));
        for threads in [2, 5] {
            let mut together = pushed.clone();
            factor.solve_on_threads(&mut together, threads);
            assert!(together == alone);
        }
    }

    /// [G B; Bᵀ −H] in pairs, with G and H like the cube's matrix and B without symmetry, and its product
    /// with a vector.
    fn pairs(k: usize) -> (Pattern, Vec<f64>, impl Fn(&[f64]) -> Vec<f64>) {
        let (pattern, upper) = cube(k);
        let coupling = |row: usize, column: usize| 2.0 + (row as f64 - 0.3 * column as f64).sin();
        let rows = pattern.rows().enumerate();
        let places: Vec<(usize, usize)> = rows
            .flat_map(|(row, slots)| slots.map(move |slot| (row, slot)))
            .map(|(row, slot)| (row, pattern.columns()[slot] as usize))
            .collect();
        let values: Vec<f64> = places
            .iter()
            .zip(&upper)
            .flat_map(|(&(row, column), &g)| {
                [
                    g,
                    coupling(row, column),
                    coupling(column, row),
                    -(g + if row == column { 0.5 } else { 0.0 }),
                ]
            })
            .collect();
        let entries = values.clone();
        let product = move |x: &[f64]| {
            let mut product = vec![0.0; x.len()];
            for (&(row, column), entries) in places.iter().zip(entries.chunks_exact(4)) {
                for (side, entries) in entries.chunks_exact(2).enumerate() {
                    product[2 * row + side] += entries[0] * x[2 * column] + entries[1] * x[2 * column + 1];
                }
            }
            product
        };
        (pattern, values, product)
    }

    #[test]
    fn quasidefinite_pairs_are_solved_on_any_number_of_threads() {
        // The last one is large enough to be divided into subtrees and shared among threads.
        for k in [1, 2, 3, 8, 14] {
            let (pattern, values, product) = pairs(k);
            let analysis = Analysis::new(&pattern).of_pairs();
            let factor = analysis.factor(&pattern, &values).unwrap();
            let n = 2 * k * k * k;
            assert!(factor.size() == n && factor.bytes() == analysis.factor_bytes());
            assert!(k < 14 || factor.blocks().subtrees.parts.len() > 2);
            let known: Vec<f64> = (0..3 * n).map(|i| (i as f64 * 0.7).sin() + 0.1).collect();
            let pushed: Vec<f64> = known.chunks(n).flat_map(&product).collect();
            let mut together = pushed.clone();
            factor.solve(&mut together);
            for (found, known) in together.iter().zip(&known) {
                assert!((found - known).abs() < 1e-13, "k = {k}: {found} {known}");
            }
            let (mut alone, mut shared) = (pushed[n..2 * n].to_vec(), pushed);
            factor.solve(&mut alone);
            factor.solve_on_threads(&mut shared, 3);
            assert!(alone == together[n..2 * n] && shared == together, "k = {k}");
        }
    }

    #[test]
    fn a_pivot_of_a_pair_without_its_sign_is_named_by_its_coordinate() {
        let pattern = Pattern::from_rows((0..600).map(|row| [row]));
        let analysis = Analysis::new(&pattern).of_pairs();
        for (side, value) in [(0, -2.0), (0, 0.0), (3, 5.0), (3, f64::NAN)] {
            let mut values = [1.0, 0.5, 0.5, -1.0].repeat(600);
            values[4 * 417 + side] = value;
            let refused = analysis.factor(&pattern, &values).unwrap_err();
            assert!(matches!(refused, FactorError::Pivot { coordinate: 417, .. }), "{refused}");
        }
    }

    #[test]
    fn places_that_are_full_or_far_from_the_diagonal_are_eliminated() {
        // An arrow, a full matrix, and a ring with a chord.
        let n = 70;
        let arrow = |a: usize, b: usize| a == b || a == 0 || b == 0;
        let full = |_: usize, _: usize| true;
        let ring = |a: usize, b: usize| a.abs_diff(b) <= 1 || a.abs_diff(b) == n - 1 || a + b == n;
        let shapes: [&dyn Fn(usize, usize) -> bool; 3] = [&arrow, &full, &ring];
        for near in shapes {
            let pattern = Pattern::from_rows((0..n).map(|a| (0..n).filter(move |&b| near(a, b))));
            let rows = pattern.rows().enumerate();
            let values: Vec<f64> = rows
                .flat_map(|(row, slots)| slots.map(move |slot| (row, slot)))
                .map(|(row, slot)| if pattern.columns()[slot] as usize == row { n as f64 } else { 0.5 })
                .collect();
            let known: Vec<f64> = (0..n).map(|i| 1.0 / (1.0 + i as f64)).collect();
            let mut x = product(&pattern, &values, &known);
            Analysis::new(&pattern).factor(&pattern, &values).unwrap().solve(&mut x);
            for (found, known) in x.iter().zip(&known) {
                assert!((found - known).abs() < 1e-14, "{found} {known}");
            }
        }
    }

    #[test]
    fn a_pivot_that_is_not_positive_is_named_by_its_coordinate() {
        for (n, bad) in [(1, 0), (5, 3), (600, 417)] {
            let pattern = Pattern::from_rows((0..n).map(|row| [row]));
            for value in [-2.0, 0.0, f64::NAN] {
                let mut values = vec![1.0; n];
                values[bad] = value;
                let refused = Analysis::new(&pattern).factor(&pattern, &values).unwrap_err();
                assert!(
                    matches!(refused, FactorError::Pivot { coordinate, .. } if coordinate == bad),
                    "{refused}"
                );
            }
        }
        let (pattern, mut values) = cube(6);
        values.iter_mut().for_each(|value| *value = -*value);
        assert!(Analysis::new(&pattern).factor(&pattern, &values).is_err());
    }
}
