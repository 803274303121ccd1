//! L Lᵀ x = b.

use crate::Factor;
use crate::blocks::{Blocks, Subtree};
use crate::kernels::{products, subtract_columns};
use crate::threads::share;
use core::ops::Range;
use pulp::Arch;

/// Numbers of a factor, times right-hand sides, for which another thread is worth while.
const SHARE: usize = 1 << 20;

impl Factor {
    /// Replaces the right-hand side by the solution. Several right-hand sides, one after another, are solved in one pass
    /// over the factor, each with the bits that it has alone.
    pub fn solve(&self, vectors: &mut [f64]) {
        self.solve_on_threads(vectors, 1);
    }

    /// The same with up to so many threads, where that is worth while; the bits are the same.
    pub fn solve_on_threads(&self, vectors: &mut [f64], threads: usize) {
        let size = self.size();
        if size == 0 {
            return;
        }
        let (blocks, numbers) = (self.blocks(), self.numbers());
        let count = vectors.len() / size;
        let threads = (numbers.len() * count / SHARE).clamp(1, threads.max(1));
        let mut sorted = vec![0.0; count * size];
        for (sorted, vector) in sorted.chunks_exact_mut(size).zip(vectors.chunks_exact(size)) {
            for (place, &row) in sorted.iter_mut().zip(&blocks.order) {
                *place = vector[row as usize];
            }
        }
        let unit = Arch::new();
        let subtrees = &blocks.subtrees;
        let mut crowns: Vec<Crown<'_>> =
            subtrees.parts.iter().map(|part| Crown::new(blocks, part, &sorted, size)).collect();
        share(threads, crowns.iter_mut(), |crown| {
            let Subtree { blocks: range, columns } = crown.part;
            let work = Work { blocks, numbers, start: columns.start, length: crown.length };
            unit.dispatch(|| work.forward(range.clone(), &mut crown.vectors));
        });
        for crown in &crowns {
            crown.give_up(blocks, &mut sorted, size);
        }
        let trunk = Work { blocks, numbers, start: 0, length: size };
        unit.dispatch(|| {
            subtrees.trunk(blocks.count()).for_each(|range| trunk.forward(range, &mut sorted));
            subtrees.trunk(blocks.count()).rev().for_each(|range| trunk.backward(range, &mut sorted));
        });
        for crown in &mut crowns {
            crown.take_up(blocks, &sorted, size);
        }
        share(threads, crowns.iter_mut(), |crown| {
            let Subtree { blocks: range, columns } = crown.part;
            let work = Work { blocks, numbers, start: columns.start, length: crown.length };
            unit.dispatch(|| work.backward(range.clone(), &mut crown.vectors));
        });
        for crown in &crowns {
            crown.bring_down(&mut sorted, size);
        }
        for (sorted, vector) in sorted.chunks_exact(size).zip(vectors.chunks_exact_mut(size)) {
            for (&number, &row) in sorted.iter().zip(&blocks.order) {
                vector[row as usize] = number;
            }
        }
    }
}

/// What a subtree works on: for each right-hand side its columns, and behind them the rows of its last block.
struct Crown<'a> {
    part: &'a Subtree,
    length: usize,
    vectors: Vec<f64>,
}

impl<'a> Crown<'a> {
    fn new(blocks: &Blocks, part: &'a Subtree, sorted: &[f64], size: usize) -> Self {
        let beyond = blocks.rows(part.blocks.end - 1).len();
        let mut vectors = Vec::with_capacity(sorted.len() / size * (part.columns.len() + beyond));
        for sorted in sorted.chunks_exact(size) {
            vectors.extend_from_slice(&sorted[part.columns.clone()]);
            vectors.resize(vectors.len() + beyond, 0.0);
        }
        Self { part, length: part.columns.len() + beyond, vectors }
    }

    /// Adds what the subtree owes to the rows beyond it.
    fn give_up(&self, blocks: &Blocks, sorted: &mut [f64], size: usize) {
        let beyond = blocks.rows(self.part.blocks.end - 1);
        for (own, sorted) in self.vectors.chunks_exact(self.length).zip(sorted.chunks_exact_mut(size)) {
            for (&row, &number) in beyond.iter().zip(&own[self.part.columns.len()..]) {
                sorted[row as usize] += number;
            }
        }
    }

    /// Takes the solution in the rows beyond.
    fn take_up(&mut self, blocks: &Blocks, sorted: &[f64], size: usize) {
        let beyond = blocks.rows(self.part.blocks.end - 1);
        for (own, sorted) in self.vectors.chunks_exact_mut(self.length).zip(sorted.chunks_exact(size)) {
            for (&row, number) in beyond.iter().zip(&mut own[self.part.columns.len()..]) {
                *number = sorted[row as usize];
            }
        }
    }

    /// Hands over the solution in the columns of the subtree.
    fn bring_down(&self, sorted: &mut [f64], size: usize) {
        let columns = &self.part.columns;
        for (own, sorted) in self.vectors.chunks_exact(self.length).zip(sorted.chunks_exact_mut(size)) {
            sorted[columns.clone()].copy_from_slice(&own[..columns.len()]);
        }
    }
}

/// Substitution in a run of blocks, on vectors of `length` numbers that begin with the column `start`.
struct Work<'a> {
    blocks: &'a Blocks,
    numbers: &'a [f64],
    start: usize,
    length: usize,
}

/// Four columns of a block from `first` on, from the row `from` down; those beyond the last are empty of effect.
#[inline(always)]
fn four(numbers: &[f64], height: usize, first: usize, count: usize, from: usize) -> [&[f64]; 4] {
    core::array::from_fn(|index| {
        // A column that is not there stands for any other, with the factor zero.
        let column = first + index.min(count - 1);
        &numbers[column * height + from..(column + 1) * height]
    })
}

impl Work<'_> {
    /// L y = x in place.
    #[inline(always)]
    fn forward(&self, range: Range<usize>, vectors: &mut [f64]) {
        let &Self { blocks, numbers, start, length } = self;
        let count = vectors.len() / length;
        let mut below = Vec::new();
        for block in range {
            let (columns, rows) = (blocks.columns(block), &blocks.subtrees.places[blocks.row_places(block)]);
            let (width, height) = (columns.len(), columns.len() + rows.len());
            let numbers = &numbers[blocks.numbers(block)];
            below.clear();
            below.resize(rows.len() * count, 0.0);
            let mut first = 0;
            while first < width {
                let group = (width - first).min(4);
                for (index, vector) in vectors.chunks_exact_mut(length).enumerate() {
                    let top = &mut vector[columns.start - start..columns.end - start];
                    let mut x = [0.0; 4];
                    for (column, x) in (first..first + group).zip(&mut x) {
                        let l = &numbers[column * height..][..height];
                        *x = top[column] / l[column];
                        top[column] = *x;
                        for row in column + 1..first + group {
                            top[row] -= l[row] * *x;
                        }
                    }
                    let end = first + group;
                    let l = four(numbers, height, first, group, end);
                    subtract_columns(&mut top[end..], l, x);
                    let l = four(numbers, height, first, group, width);
                    subtract_columns(&mut below[index * rows.len()..][..rows.len()], l, x);
                }
                first += group;
            }
            if !rows.is_empty() {
                for (below, vector) in below.chunks_exact(rows.len()).zip(vectors.chunks_exact_mut(length)) {
                    for (&row, &number) in rows.iter().zip(below) {
                        vector[row as usize] += number;
                    }
                }
            }
        }
    }

    /// Lᵀ x = y in place.
    #[inline(always)]
    fn backward(&self, range: Range<usize>, vectors: &mut [f64]) {
        let &Self { blocks, numbers, start, length } = self;
        let mut below = Vec::new();
        for block in range.rev() {
            let (columns, rows) = (blocks.columns(block), &blocks.subtrees.places[blocks.row_places(block)]);
            let (width, height) = (columns.len(), columns.len() + rows.len());
            let numbers = &numbers[blocks.numbers(block)];
            below.clear();
            for vector in vectors.chunks_exact(length) {
                below.extend(rows.iter().map(|&row| vector[row as usize]));
            }
            let groups = width.div_ceil(4);
            for first in (0..groups).rev().map(|group| 4 * group) {
                let group = (width - first).min(4);
                for (index, vector) in vectors.chunks_exact_mut(length).enumerate() {
                    let top = &mut vector[columns.start - start..columns.end - start];
                    let end = first + group;
                    let above = products(four(numbers, height, first, group, end), &top[end..]);
                    let below = &below[index * rows.len()..][..rows.len()];
                    let under = products(four(numbers, height, first, group, width), below);
                    for own in (0..group).rev() {
                        let column = first + own;
                        let l = &numbers[column * height..][..height];
                        let mut sum = top[column] - above[own] - under[own];
                        for row in column + 1..end {
                            sum -= l[row] * top[row];
                        }
                        top[column] = sum / l[column];
                    }
                }
            }
        }
    }
}
