//! The order of elimination and the places of the factor, from the pattern alone.

use crate::Pattern;
use crate::blocks::{Blocks, Subtrees};
use crate::dissection::nested_dissection;
use std::sync::Arc;

/// How matrices of one pattern are eliminated: the order of the coordinates and the places of the factor.
///
/// The order is approximate minimum degree or another that fills less. Neighbouring columns of the factor
/// with the same places below them, or nearly, are kept together as dense blocks. Source:
/// \[DavisRajamanickamSidLakhdar16\] §§ 4, 5, 8.
#[derive(Clone, Debug)]
pub struct Analysis {
    blocks: Arc<Blocks>,
}

/// No parent.
const ROOT: u32 = u32::MAX;

impl Analysis {
    /// Analyses a symmetric pattern of fewer than 2³¹ places; each pattern once, however often it is asked
    /// for.
    pub fn new(pattern: &Pattern) -> Self {
        pattern.analysis.get_or_init(|| Self::of(pattern)).clone()
    }

    fn of(pattern: &Pattern) -> Self {
        let order = order(pattern);
        let parents = elimination_tree(pattern, &order, &inverse(&order));
        let later = postorder(&parents);
        let order: Vec<u32> = later.iter().map(|&old| order[old as usize]).collect();
        let place = inverse(&order);
        let new_place = inverse(&later);
        let parents: Vec<u32> = later
            .iter()
            .map(|&old| match parents[old as usize] {
                ROOT => ROOT,
                parent => new_place[parent as usize],
            })
            .collect();
        let counts = column_counts(pattern, &order, &place, &parents);
        let first = blocks(&parents, &counts);
        Self { blocks: Arc::new(places(pattern, order, place, first)) }
    }

    /// Number of rows.
    pub fn size(&self) -> usize {
        self.blocks.order.len()
    }

    /// Numbers that a factor holds.
    pub fn factor_len(&self) -> usize {
        self.blocks.number_starts.last().copied().unwrap_or(0)
    }

    /// Bytes of a factor's numbers.
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

/// Rows from which on more than one order is tried.
const LARGE: usize = 2_000;

/// The rows in the order, of some, with which the factor is smallest: of minimum degree, as they come, by
/// nested dissection.
///
/// Minimum degree is best for most small and flat structures; beams that are numbered along their length are
/// best left so.
fn order(pattern: &Pattern) -> Vec<u32> {
    let least = minimum_degree(pattern);
    if pattern.size() < LARGE {
        return least;
    }
    let mut best = (fill(pattern, &least, u64::MAX).unwrap_or(u64::MAX), least);
    for order in [(0..pattern.size() as u32).collect(), nested_dissection(pattern)] {
        if let Some(places) = fill(pattern, &order, best.0) {
            best = (places, order);
        }
    }
    best.1
}

/// Places of the factor below the diagonal, if they are fewer than `limit`.
fn fill(pattern: &Pattern, order: &[u32], limit: u64) -> Option<u64> {
    let place = inverse(order);
    let parents = elimination_tree(pattern, order, &place);
    let mut places = 0;
    visit_places(pattern, (order, &place), &parents, |_| {
        places += 1;
        places < limit
    });
    (places < limit).then_some(places)
}

/// The rows in an order that keeps the factor sparse.
fn minimum_degree(pattern: &Pattern) -> Vec<u32> {
    let starts: Vec<i32> = pattern.starts().iter().map(|&start| start as i32).collect();
    let columns: Vec<i32> = pattern.columns().iter().map(|&column| column as i32).collect();
    match amd::order(pattern.size() as i32, &starts, &columns, &amd::Control::default()) {
        Ok((order, ..)) => order.into_iter().map(|row| row as u32).collect(),
        // Not for a pattern with rows in order; any order serves.
        Err(_) => (0..pattern.size() as u32).collect(),
    }
}

/// Columns in order of elimination, each with the earlier ones that its row has a place in.
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
    // Short cuts towards the root.
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

/// The columns so that every subtree of the elimination tree is a run.
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

/// Number of places of each column of the factor, the diagonal included.
fn column_counts(pattern: &Pattern, order: &[u32], place: &[u32], parents: &[u32]) -> Vec<u32> {
    let mut counts = vec![1; order.len()];
    visit_places(pattern, (order, place), parents, |column| {
        counts[column] += 1;
        true
    });
    counts
}

/// Hands the column of each place of the factor below the diagonal to `visit`, row by row, until it says that
/// that is enough.
fn visit_places(
    pattern: &Pattern,
    (order, place): (&[u32], &[u32]),
    parents: &[u32],
    mut visit: impl FnMut(usize) -> bool,
) {
    let mut seen = vec![ROOT; order.len()];
    for (own, others) in earlier(pattern, order, place) {
        seen[own] = own as u32;
        for other in others {
            let mut column = other;
            while seen[column] != own as u32 {
                seen[column] = own as u32;
                if !visit(column) {
                    return;
                }
                column = parents[column] as usize;
            }
        }
    }
}

/// Two neighbouring blocks are joined if that gives no more columns than the first number and no larger part
/// of zeros than the second, by one of these.
const JOINED: [(usize, f64); 4] = [(4, 1.0), (16, 0.8), (48, 0.1), (usize::MAX, 0.05)];

/// Where the blocks of columns begin, and where the last one ends.
fn blocks(parents: &[u32], counts: &[u32]) -> Vec<u32> {
    struct Block {
        first: usize,
        columns: usize,
        rows: usize,
        /// Places that are not there for the block's sake.
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

    /// Joins the last block with those before it while that pays.
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

/// The rows of each block: those of the matrix and of the blocks before that it takes up.
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
    let mut blocks = Blocks { order, place, first, block_of, row_starts, rows, number_starts, subtrees };
    blocks.subtrees = Subtrees::of(&blocks);
    blocks
}
