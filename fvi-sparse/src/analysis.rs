//! The order of elimination and the structure of the factor, from the pattern alone.

use crate::Pattern;
use crate::blocks::{Blocks, Subtrees};
use crate::dissection::nested_dissection;
use crate::separator::Effort;
use std::sync::Arc;

/// Elimination of matrices of one pattern: the order of the coordinates and the places of the factor.
///
/// The order is approximate minimum degree or another with less fill-in. Neighbouring columns of the factor
/// with the same places below them, or nearly, are stored together as dense blocks. Source:
/// \[DavisRajamanickamSidLakhdar16\] §§ 4, 5, 8.
#[derive(Clone, Debug)]
pub struct Analysis {
    blocks: Arc<Blocks>,
}

/// Marker of a column without parent.
const ROOT: u32 = u32::MAX;

impl Analysis {
    /// Analyses a symmetric pattern of fewer than 2³¹ places. The result is cached in the pattern.
    pub fn new(pattern: &Pattern) -> Self {
        pattern.analysis.get_or_init(|| Self::of(pattern)).clone()
    }

    fn of(pattern: &Pattern) -> Self {
        let Elimination { order, parents, counts } = least_fill(pattern);
        let place = inverse(&order);
        let first = blocks(&parents, &counts);
        Self { blocks: Arc::new(places(pattern, order, place, first)) }
    }

    /// Elimination of matrices with 2×2 numbers at each place of the pattern that are symmetric and
    /// quasidefinite:
    ///
    /// ```text
    /// A = [G  B; Bᵀ  −H] ,    G and H positive definite,
    /// ```
    ///
    /// with the diagonal of G in the first of each pair of rows, that of −H in the second. The values of a
    /// place are those of its two rows, one after the other; rows 2i and 2i + 1 of vectors and solutions
    /// belong to row i of the pattern. The order of elimination is that of the pattern.
    ///
    /// Every symmetric permutation of A has a factor L Σ Lᵀ with the signs Σ of the pairs (\[Vanderbei95\]).
    /// The growth of its numbers is bounded by the sizes of B H⁻¹ Bᵀ relative to G, and of Bᵀ G⁻¹ B relative
    /// to H (\[GillSaundersShinnerl96\]).
    #[must_use]
    pub fn of_pairs(&self) -> Self {
        Self { blocks: Arc::new(self.blocks.paired()) }
    }

    /// Number of rows.
    pub fn size(&self) -> usize {
        self.blocks.order.len()
    }

    /// Number of entries stored in a factor.
    pub fn factor_len(&self) -> usize {
        self.blocks.number_starts.last().copied().unwrap_or(0)
    }

    /// Bytes of the entries of a factor.
    pub fn factor_bytes(&self) -> usize {
        self.factor_len().saturating_mul(size_of::<f64>())
    }

    pub(crate) fn blocks(&self) -> &Blocks {
        &self.blocks
    }
}

fn inverse(order: &[u32]) -> Vec<u32> {
    let mut place = vec![0; order.len()];
    for (index, &row) in order.iter().enumerate() {
        place[row as usize] = index as u32;
    }
    place
}

/// Number of rows from which more than one order is tried.
const LARGE: usize = 2_000;

/// (places per column, places) of the best other order from which nested dissection is tried; the first is
/// typical of three dimensions. Below both, dissection takes longer than it saves in a thousand steps.
const DISSECTED: (u64, u64) = (64, 2_000_000);

/// Places per column from which elimination takes so long that a thorough dissection pays.
const LONG: u64 = 300;

/// The elimination with the smallest factor among minimum degree, the order of the rows as given, and nested
/// dissection where that may be better.
///
/// Minimum degree is best for most small and flat structures, the given order for beams that are numbered
/// along their length.
fn least_fill(pattern: &Pattern) -> Elimination {
    let rows = pattern.size() as u64;
    let mut best = Elimination::new(pattern, minimum_degree(pattern));
    if pattern.size() < LARGE {
        return best;
    }
    let mut try_order = |order| {
        let other = Elimination::new(pattern, order);
        if other.places() < best.places() {
            best = other;
        }
        best.places()
    };
    let places = try_order((0..pattern.size() as u32).collect());
    let (mean, all) = DISSECTED;
    if places >= all || places >= mean * rows {
        let effort = if places < LONG * rows { Effort::QUICK } else { Effort::THOROUGH };
        try_order(nested_dissection(pattern, &effort));
    }
    best
}

/// An order of elimination in which every subtree of the elimination tree is a contiguous range.
struct Elimination {
    order: Vec<u32>,
    /// For each column of the factor the first row below the diagonal.
    parents: Vec<u32>,
    /// Number of places of each column, the diagonal included.
    counts: Vec<u32>,
}

impl Elimination {
    /// Elimination in the given order, or in an equivalent one with the same factor.
    fn new(pattern: &Pattern, order: Vec<u32>) -> Self {
        let parents = elimination_tree(pattern, &order, &inverse(&order));
        let later = postorder(&parents);
        let order: Vec<u32> = later.iter().map(|&old| order[old as usize]).collect();
        let new_place = inverse(&later);
        let parents: Vec<u32> = later
            .iter()
            .map(|&old| match parents[old as usize] {
                ROOT => ROOT,
                parent => new_place[parent as usize],
            })
            .collect();
        let counts = column_counts(pattern, &order, &parents);
        Self { order, parents, counts }
    }

    /// Number of places of the factor.
    fn places(&self) -> u64 {
        self.counts.iter().map(|&count| u64::from(count)).sum()
    }
}

/// The rows in an order that keeps the factor sparse.
fn minimum_degree(pattern: &Pattern) -> Vec<u32> {
    let starts: Vec<i32> = pattern.starts().iter().map(|&start| start as i32).collect();
    let columns: Vec<i32> = pattern.columns().iter().map(|&column| column as i32).collect();
    match amd::order(pattern.size() as i32, &starts, &columns, &amd::Control::default()) {
        Ok((order, ..)) => order.into_iter().map(|row| row as u32).collect(),
        // amd does not fail for a pattern with sorted rows; any order is correct.
        Err(_) => (0..pattern.size() as u32).collect(),
    }
}

/// Columns in order of elimination, each with the earlier columns at which its row has a place.
fn earlier<'a>(
    pattern: &'a Pattern,
    order: &'a [u32],
    place: &'a [u32],
) -> impl Iterator<Item = (usize, impl Iterator<Item = usize> + 'a)> + 'a {
    order.iter().enumerate().map(move |(own, &row)| {
        let columns = pattern.columns()[pattern.row(row as usize)].iter();
        (own, columns.map(move |&column| place[column as usize] as usize).filter(move |&other| other < own))
    })
}

/// For each column of the factor the first row below the diagonal.
fn elimination_tree(pattern: &Pattern, order: &[u32], place: &[u32]) -> Vec<u32> {
    let mut parents = vec![ROOT; order.len()];
    // Shortcuts towards the root.
    let mut ancestors = vec![ROOT; order.len()];
    for (own, others) in earlier(pattern, order, place) {
        for other in others {
            let mut column = other;
            while column != own {
                let next = ancestors[column];
                ancestors[column] = own as u32;
                if next == ROOT {
                    parents[column] = own as u32;
                    break;
                }
                column = next as usize;
            }
        }
    }
    parents
}

/// The columns in an order in which every subtree of the elimination tree is a contiguous range.
fn postorder(parents: &[u32]) -> Vec<u32> {
    let count = parents.len();
    // Children of each column as a list, the smallest first.
    let (mut child, mut sibling) = (vec![ROOT; count], vec![ROOT; count]);
    for column in (0..count).rev() {
        if parents[column] != ROOT {
            let parent = parents[column] as usize;
            sibling[column] = child[parent];
            child[parent] = column as u32;
        }
    }
    let mut later = Vec::with_capacity(count);
    let mut path = Vec::new();
    for root in (0..count).filter(|&column| parents[column] == ROOT) {
        path.push(root as u32);
        while let Some(&column) = path.last() {
            let next = child[column as usize];
            if next == ROOT {
                later.push(column);
                path.pop();
            } else {
                child[column as usize] = sibling[next as usize];
                path.push(next);
            }
        }
    }
    later
}

/// Number of places of each column of the factor, the diagonal included, from an order in which every subtree
/// of the elimination tree is a contiguous range.
///
/// The columns in which a row has places are a subtree, cut off below at some leaves; it is counted as the
/// paths from these to the row minus their common parts. Source: \[GilbertNgPeyton94\].
fn column_counts(pattern: &Pattern, order: &[u32], parents: &[u32]) -> Vec<u32> {
    let size = order.len();
    let place = inverse(order);
    // The first column of the subtree of each column.
    let mut first: Vec<u32> = (0..size as u32).collect();
    for (column, &parent) in parents.iter().enumerate() {
        if parent != ROOT {
            first[parent as usize] = first[parent as usize].min(first[column]);
        }
    }
    // Each count minus the sum of the counts of the children.
    let mut more: Vec<i64> = first.iter().zip(0..).map(|(&first, own)| i64::from(first == own)).collect();
    // The last leaf of each row's subtree so far, and shortcuts towards the root through finished columns.
    let mut leaf = vec![ROOT; size];
    let mut above: Vec<u32> = (0..size as u32).collect();
    for own in 0..size {
        let parent = parents[own];
        if parent != ROOT {
            more[parent as usize] -= 1;
        }
        for &column in &pattern.columns()[pattern.row(order[own] as usize)] {
            let row = place[column as usize] as usize;
            let last = leaf[row];
            // Not a leaf if the last leaf is in its subtree.
            if row <= own || (last != ROOT && first[own] <= last) {
                continue;
            }
            more[own] += 1;
            if last != ROOT {
                more[top(&mut above, last) as usize] -= 1;
            }
            leaf[row] = own as u32;
        }
        if parent != ROOT {
            above[own] = parent;
        }
    }
    for column in 0..size {
        if parents[column] != ROOT {
            more[parents[column] as usize] += more[column];
        }
    }
    more.into_iter().map(|count| count as u32).collect()
}

/// The first unfinished column on the path to the root; shortens the shortcuts.
fn top(above: &mut [u32], column: u32) -> u32 {
    let mut top = column;
    while above[top as usize] != top {
        top = above[top as usize];
    }
    let mut column = column;
    while column != top {
        column = std::mem::replace(&mut above[column as usize], top);
    }
    top
}

/// Two neighbouring blocks are merged if, for one of these pairs, the result has at most the first number of
/// columns and at most the second fraction of explicit zeros.
const JOINED: [(usize, f64); 4] = [(4, 1.0), (16, 0.8), (48, 0.1), (usize::MAX, 0.05)];

/// The first column of each block, and the end of the last one.
fn blocks(parents: &[u32], counts: &[u32]) -> Vec<u32> {
    struct Block {
        first: usize,
        columns: usize,
        rows: usize,
        /// Structurally nonzero places; the others of the block are explicit zeros.
        places: f64,
    }
    let stored = |columns: usize, rows: usize| columns as f64 * (rows as f64 - 0.5 * (columns as f64 - 1.0));
    let mut found: Vec<Block> = Vec::new();
    for column in 0..parents.len() {
        let rows = counts[column] as usize;
        if let Some(last) = found.last_mut()
            && parents[column - 1] == column as u32
            && counts[column - 1] as usize == rows + 1
        {
            last.columns += 1;
            last.places += rows as f64;
            continue;
        }
        join(&mut found, parents, stored);
        found.push(Block { first: column, columns: 1, rows, places: rows as f64 });
    }
    join(&mut found, parents, stored);

    /// Merges the last block with those before it as far as the criterion allows.
    fn join(found: &mut Vec<Block>, parents: &[u32], stored: impl Fn(usize, usize) -> f64) {
        while let [.., before, last] = found.as_slice() {
            let parent = parents[last.first - 1];
            let own = last.first as u32..(last.first + last.columns) as u32;
            let (columns, rows) = (before.columns + last.columns, before.columns + last.rows);
            let places = before.places + last.places;
            let zeros = 1.0 - places / stored(columns, rows);
            if !own.contains(&parent) || !JOINED.iter().any(|&(most, part)| columns <= most && zeros <= part)
            {
                return;
            }
            let joined = Block { first: before.first, columns, rows, places };
            found.truncate(found.len() - 2);
            found.push(joined);
        }
    }

    let firsts = found.iter().map(|block| block.first as u32);
    firsts.chain([parents.len() as u32]).collect()
}

/// The rows of each block: those of the matrix and of the earlier blocks that it updates from.
fn places(pattern: &Pattern, order: Vec<u32>, place: Vec<u32>, first: Vec<u32>) -> Blocks {
    let count = first.len() - 1;
    let mut block_of = vec![0; order.len()];
    for (block, ends) in first.windows(2).enumerate() {
        block_of[ends[0] as usize..ends[1] as usize].fill(block as u32);
    }
    let mut seen = vec![ROOT; order.len()];
    let (mut rows, mut row_starts, mut number_starts) = (Vec::new(), vec![0], vec![0]);
    let mut before: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (block, ends) in first.windows(2).enumerate() {
        let end = ends[1];
        let start = rows.len();
        let mut take = |row: u32, rows: &mut Vec<u32>| {
            if row >= end && seen[row as usize] != block as u32 {
                seen[row as usize] = block as u32;
                rows.push(row);
            }
        };
        for &own in &order[ends[0] as usize..end as usize] {
            for &column in &pattern.columns()[pattern.row(own as usize)] {
                take(place[column as usize], &mut rows);
            }
        }
        for child in std::mem::take(&mut before[block]) {
            for index in row_starts[child]..row_starts[child + 1] {
                take(rows[index], &mut rows);
            }
        }
        rows[start..].sort_unstable();
        let columns = (end - ends[0]) as usize;
        row_starts.push(rows.len());
        number_starts.push(number_starts[block] + columns * (columns + rows.len() - start));
        if let Some(&next) = rows.get(start) {
            before[block_of[next as usize] as usize].push(block);
        }
    }
    let subtrees = Subtrees::default();
    let mut blocks =
        Blocks { order, place, first, block_of, row_starts, rows, number_starts, in_pairs: false, subtrees };
    blocks.subtrees = Subtrees::of(&blocks);
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A random symmetric pattern with a full diagonal.
    fn scattered(size: usize, per_row: usize) -> Pattern {
        let mut places: Vec<(usize, usize)> = (0..size).map(|row| (row, row)).collect();
        let mut state = size as u64;
        for row in 0..size {
            for _ in 0..per_row {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                let other = (state >> 33) as usize % size;
                places.extend([(row, other), (other, row)]);
            }
        }
        Pattern::new(size, places)
    }

    /// Points of a rectangle, each connected to its four neighbours.
    fn membrane(wide: usize, high: usize) -> Pattern {
        Pattern::from_rows((0..wide * high).map(|own| {
            let (x, y) = (own % wide, own / wide);
            let below = [(y > 0).then(|| own - wide), (x > 0).then(|| own - 1), Some(own)];
            let above = [(x + 1 < wide).then_some(own + 1), (y + 1 < high).then_some(own + wide)];
            below.into_iter().chain(above).flatten()
        }))
    }

    #[test]
    fn the_order_tried_is_that_which_may_pay() {
        // Small and flat: minimum degree. Long: no worse than in the given order. Large: dissection, with
        // less than the 2.78 million places of SuperLU's minimum degree.
        let small = membrane(100, 100);
        let least = Elimination::new(&small, minimum_degree(&small)).places();
        assert_eq!(least_fill(&small).places(), least);
        let long = membrane(10, 300);
        let as_it_comes = Elimination::new(&long, (0..3_000).collect()).places();
        assert!(least_fill(&long).places() <= as_it_comes);
        let large = membrane(316, 316);
        let places = least_fill(&large).places();
        assert!(places < 2_700_000, "{places}");
    }

    #[test]
    fn columns_are_counted_as_elimination_row_by_row_finds_them() {
        for (size, per_row) in [(1, 0), (7, 1), (60, 0), (60, 1), (90, 2), (200, 3)] {
            let pattern = scattered(size, per_row);
            for order in [(0..size as u32).rev().collect(), minimum_degree(&pattern)] {
                let found = Elimination::new(&pattern, order);
                let place = inverse(&found.order);
                // Places below the diagonal, with those that each column passes to its parent.
                let mut rows: Vec<std::collections::BTreeSet<u32>> = vec![Default::default(); size];
                for (own, &row) in found.order.iter().enumerate() {
                    let columns = &pattern.columns()[pattern.row(row as usize)];
                    let below = columns.iter().map(|&column| place[column as usize]);
                    rows[own].extend(below.filter(|&other| other as usize > own));
                }
                for own in 0..size {
                    let first = rows[own].first().copied();
                    assert_eq!(
                        found.parents[own],
                        first.unwrap_or(ROOT),
                        "{size} {per_row}: parent of {own}"
                    );
                    assert_eq!(
                        found.counts[own] as usize,
                        rows[own].len() + 1,
                        "{size} {per_row}: column {own}"
                    );
                    if let Some(first) = first {
                        let rest: Vec<u32> = rows[own].iter().copied().filter(|&row| row != first).collect();
                        rows[first as usize].extend(rest);
                    }
                }
            }
        }
    }
}
