//! The blocks of columns of a factor, and the disjoint subtrees of the elimination tree that are solved in
//! parallel.

use core::ops::Range;

/// Blocks of columns of the factor. Block s has the columns `first[s]`..`first[s + 1]`, the rows of the same
/// indices and, below them, `rows[row_starts[s]..row_starts[s + 1]]`; its numbers are stored column by
/// column.
#[derive(Debug)]
pub(crate) struct Blocks {
    /// The row of the matrix that is eliminated at each place.
    pub(crate) order: Vec<u32>,
    /// The place at which each row is eliminated.
    pub(crate) place: Vec<u32>,
    pub(crate) first: Vec<u32>,
    /// The block of each column.
    pub(crate) block_of: Vec<u32>,
    pub(crate) row_starts: Vec<usize>,
    pub(crate) rows: Vec<u32>,
    pub(crate) number_starts: Vec<usize>,
    /// True if each row of the pattern stands for two, the second with a negative pivot.
    pub(crate) in_pairs: bool,
    /// Subtrees of the elimination tree that are solved separately.
    pub(crate) subtrees: Subtrees,
}

impl Blocks {
    /// The same blocks with two rows in the place of each.
    pub(crate) fn paired(&self) -> Self {
        let twice = |row: &u32| [2 * row, 2 * row + 1];
        let mut number_starts = vec![0];
        for block in 0..self.count() {
            let (width, height) = (self.columns(block).len(), self.rows(block).len());
            number_starts.push(number_starts[block] + 4 * width * (width + height));
        }
        let mut paired = Self {
            order: self.order.iter().flat_map(twice).collect(),
            place: self.place.iter().flat_map(twice).collect(),
            first: self.first.iter().map(|first| 2 * first).collect(),
            block_of: self.block_of.iter().flat_map(|&block| [block; 2]).collect(),
            row_starts: self.row_starts.iter().map(|start| 2 * start).collect(),
            rows: self.rows.iter().flat_map(twice).collect(),
            number_starts,
            in_pairs: true,
            subtrees: Subtrees::default(),
        };
        paired.subtrees = Subtrees::of(&paired);
        paired
    }

    pub(crate) fn count(&self) -> usize {
        self.first.len() - 1
    }

    /// Columns of a block.
    pub(crate) fn columns(&self, block: usize) -> Range<usize> {
        self.first[block] as usize..self.first[block + 1] as usize
    }

    /// Range of the rows of a block among those of all blocks.
    pub(crate) fn row_places(&self, block: usize) -> Range<usize> {
        self.row_starts[block]..self.row_starts[block + 1]
    }

    /// Rows of a block below its columns.
    pub(crate) fn rows(&self, block: usize) -> &[u32] {
        &self.rows[self.row_starts[block]..self.row_starts[block + 1]]
    }

    /// Range of the numbers of consecutive blocks.
    pub(crate) fn numbers_of(&self, blocks: Range<usize>) -> Range<usize> {
        self.number_starts[blocks.start]..self.number_starts[blocks.end]
    }

    /// Range of the numbers of a block.
    pub(crate) fn numbers(&self, block: usize) -> Range<usize> {
        self.number_starts[block]..self.number_starts[block + 1]
    }
}

/// Disjoint subtrees of the elimination tree, and the trunk that remains.
///
/// Columns are in postorder, so that a subtree is a contiguous range of blocks and of columns. Its
/// contribution to later columns is in the rows of its last block. The choice depends on the pattern alone,
/// and with it the order of all sums: the number of threads changes no bit.
#[derive(Debug, Default)]
pub(crate) struct Subtrees {
    /// In ascending order.
    pub(crate) parts: Vec<Subtree>,
    /// For each row of each block, its index in the vector that the block works on: the whole vector for
    /// blocks of the trunk; for those of a subtree its own, which has its columns first and then the rows of
    /// its last block.
    pub(crate) places: Vec<u32>,
}

/// A subtree, as its ranges of blocks and columns.
#[derive(Debug)]
pub(crate) struct Subtree {
    pub(crate) blocks: Range<usize>,
    pub(crate) columns: Range<usize>,
}

/// Number of entries of a factor from which dividing it into subtrees is worth while.
const LARGE: usize = 1 << 18;

/// Fraction of all entries above which a subtree is split.
const PART: f64 = 0.1;

/// Smallest number of entries of a subtree.
const LEAST: usize = 1 << 14;

impl Subtrees {
    pub(crate) fn of(blocks: &Blocks) -> Self {
        let count = blocks.count();
        let mut places: Vec<u32> = (0..count).flat_map(|block| blocks.rows(block)).copied().collect();
        let size = |range: &Range<usize>| blocks.numbers_of(range.clone()).len();
        let all = blocks.numbers_of(0..count).len();
        let mut parts = Vec::new();
        if all >= LARGE {
            // First block of the subtree that each block is the root of.
            let mut first: Vec<usize> = (0..count).collect();
            let mut children: Vec<Vec<usize>> = vec![Vec::new(); count];
            let mut open = Vec::new();
            for block in 0..count {
                match blocks.rows(block).first() {
                    Some(&row) => {
                        let parent = blocks.block_of[row as usize] as usize;
                        first[parent] = first[parent].min(first[block]);
                        children[parent].push(block);
                    }
                    None => open.push(block),
                }
            }
            let most = (PART * all as f64) as usize;
            while let Some(root) = open.pop() {
                let range = first[root]..root + 1;
                if size(&range) > most {
                    open.append(&mut children[root]);
                } else if size(&range) >= LEAST {
                    parts.push(range);
                }
            }
            parts.sort_by_key(|range| range.start);
        }
        let parts: Vec<Subtree> = parts
            .into_iter()
            .map(|range| {
                let columns = blocks.columns(range.start).start..blocks.columns(range.end - 1).end;
                Subtree { blocks: range, columns }
            })
            .collect();
        for Subtree { blocks: range, columns } in &parts {
            let beyond = blocks.rows(range.end - 1);
            for block in range.clone() {
                for place in &mut places[blocks.row_places(block)] {
                    let row = *place as usize;
                    *place = match row < columns.end {
                        true => row - columns.start,
                        false => columns.len() + beyond.partition_point(|&other| (other as usize) < row),
                    } as u32;
                }
            }
        }
        Self { parts, places }
    }

    /// The ranges of blocks between the subtrees, in ascending order.
    pub(crate) fn trunk(&self, count: usize) -> impl DoubleEndedIterator<Item = Range<usize>> {
        let ends = self.parts.iter().map(|part| part.blocks.end);
        let starts = self.parts.iter().map(|part| part.blocks.start);
        let ranges: Vec<_> = std::iter::once(0)
            .chain(ends)
            .zip(starts.chain([count]))
            .map(|(start, end)| start..end)
            .collect();
        ranges.into_iter()
    }
}

#[cfg(test)]
mod tests {
    use crate::{Analysis, Pattern};

    #[test]
    fn subtrees_and_trunk_are_all_blocks_once() {
        // A plate of springs, 200×200 points.
        let k = 200;
        let n = k * k;
        let near = |a: usize| {
            let (x, y) = (a % k, a / k);
            let mut places = vec![a];
            if x > 0 {
                places.push(a - 1);
            }
            if x + 1 < k {
                places.push(a + 1);
            }
            if y > 0 {
                places.push(a - k);
            }
            if y + 1 < k {
                places.push(a + k);
            }
            places.sort_unstable();
            places
        };
        let analysis = Analysis::new(&Pattern::from_rows((0..n).map(near)));
        let blocks = analysis.blocks();
        let parts = &blocks.subtrees.parts;
        assert!(parts.len() > 4, "{}", parts.len());
        let trunk = blocks.subtrees.trunk(blocks.count());
        let mut seen: Vec<usize> =
            trunk.chain(parts.iter().map(|part| part.blocks.clone())).flatten().collect();
        seen.sort_unstable();
        assert_eq!(seen, (0..blocks.count()).collect::<Vec<_>>());
        // Rows of a subtree beyond its columns are among the rows of its last block.
        for part in parts {
            let beyond = blocks.rows(part.blocks.end - 1);
            for block in part.blocks.clone() {
                assert!(blocks.columns(block).end <= part.columns.end);
                for row in blocks.rows(block) {
                    assert!((*row as usize) < part.columns.end || beyond.binary_search(row).is_ok());
                }
            }
        }
    }
}
