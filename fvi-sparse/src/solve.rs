//! L Lᵀ x = b.

use crate::Factor;
use crate::blocks::{Blocks, Subtree};
use crate::kernels::{products, subtract_columns};
use core::ops::Range;
use fvi_threads::share;
use pulp::{Arch, Simd, WithSimd};

/// Numbers of a factor, times right-hand sides, for which another thread is worth while.
const SHARE: usize = 1 << 20;

/// Right-hand sides that go through the factor together.
const WIDEST: usize = 8;

impl Factor {
    /// Replaces the right-hand side by the solution. Several right-hand sides, one after another, are solved
    /// in one pass over the factor, each with the bits that it has alone.
    pub fn solve(&self, vectors: &mut [f64]) {
        self.solve_on_threads(vectors, 1);
    }

    /// The same with up to so many threads, where that is worth while; the bits are the same.
    pub fn solve_on_threads(&self, vectors: &mut [f64], threads: usize) {
        let size = self.size();
        if size == 0 {
            return;
        }
        for vectors in vectors.chunks_mut(WIDEST * size) {
            let count = vectors.len() / size;
            let threads = (self.numbers().len() * count / SHARE).clamp(1, threads.max(1));
            match count {
                0 => {}
                1 => self.solve_side_by_side::<1>(vectors, threads),
                // What is not there is computed with, too: the factor is fetched once all the same.
                _ => self.solve_side_by_side::<WIDEST>(vectors, threads),
            }
        }
    }

    /// Solves for up to W right-hand sides, whose numbers for a row lie side by side on the way: each number
    /// of the factor is fetched once, and multiplied with a vector of them.
    fn solve_side_by_side<const W: usize>(&self, vectors: &mut [f64], threads: usize) {
        let size = self.size();
        let (blocks, numbers) = (self.blocks(), self.numbers());
        let mut sorted = vec![[0.0; W]; size];
        for (lane, vector) in vectors.chunks_exact(size).enumerate() {
            for (place, &row) in sorted.iter_mut().zip(&blocks.order) {
                place[lane] = vector[row as usize];
            }
        }
        let unit = Arch::new();
        let subtrees = &blocks.subtrees;
        let mut crowns: Vec<Crown<'_, W>> =
            subtrees.parts.iter().map(|part| Crown::new(blocks, part, &sorted)).collect();
        share(threads, &mut crowns, |crown| {
            let Subtree { blocks: range, columns } = crown.part;
            let work = Work { blocks, numbers, start: columns.start };
            unit.dispatch(Forward { work, range: range.clone(), vectors: &mut crown.vectors });
        });
        for crown in &crowns {
            crown.give_up(blocks, &mut sorted);
        }
        let trunk = Work { blocks, numbers, start: 0 };
        for range in subtrees.trunk(blocks.count()) {
            unit.dispatch(Forward { work: trunk, range, vectors: &mut sorted });
        }
        for range in subtrees.trunk(blocks.count()).rev() {
            unit.dispatch(Backward { work: trunk, range, vectors: &mut sorted });
        }
        for crown in &mut crowns {
            crown.take_up(blocks, &sorted);
        }
        share(threads, &mut crowns, |crown| {
            let Subtree { blocks: range, columns } = crown.part;
            let work = Work { blocks, numbers, start: columns.start };
            unit.dispatch(Backward { work, range: range.clone(), vectors: &mut crown.vectors });
        });
        for crown in &crowns {
            crown.bring_down(&mut sorted);
        }
        for (lane, vector) in vectors.chunks_exact_mut(size).enumerate() {
            for (numbers, &row) in sorted.iter().zip(&blocks.order) {
                vector[row as usize] = numbers[lane];
            }
        }
    }
}

/// What a subtree works on, for each right-hand side: its columns, and behind them the rows of its last
/// block.
struct Crown<'a, const W: usize> {
    part: &'a Subtree,
    vectors: Vec<[f64; W]>,
}

impl<'a, const W: usize> Crown<'a, W> {
    fn new(blocks: &Blocks, part: &'a Subtree, sorted: &[[f64; W]]) -> Self {
        let mut vectors = sorted[part.columns.clone()].to_vec();
        vectors.resize(vectors.len() + blocks.rows(part.blocks.end - 1).len(), [0.0; W]);
        Self { part, vectors }
    }

    /// Adds what the subtree owes to the rows beyond it.
    fn give_up(&self, blocks: &Blocks, sorted: &mut [[f64; W]]) {
        let beyond = blocks.rows(self.part.blocks.end - 1);
        for (&row, numbers) in beyond.iter().zip(&self.vectors[self.part.columns.len()..]) {
            add(&mut sorted[row as usize], numbers);
        }
    }

    /// Takes the solution in the rows beyond.
    fn take_up(&mut self, blocks: &Blocks, sorted: &[[f64; W]]) {
        let beyond = blocks.rows(self.part.blocks.end - 1);
        for (&row, numbers) in beyond.iter().zip(&mut self.vectors[self.part.columns.len()..]) {
            *numbers = sorted[row as usize];
        }
    }

    /// Hands over the solution in the columns of the subtree.
    fn bring_down(&self, sorted: &mut [[f64; W]]) {
        let columns = &self.part.columns;
        sorted[columns.clone()].copy_from_slice(&self.vectors[..columns.len()]);
    }
}

#[inline(always)]
fn add<const W: usize>(to: &mut [f64; W], numbers: &[f64; W]) {
    to.iter_mut().zip(numbers).for_each(|(to, number)| *to += number);
}

/// Substitution in a run of blocks, on vectors that begin with the column `start`.
#[derive(Clone, Copy)]
struct Work<'a> {
    blocks: &'a Blocks,
    numbers: &'a [f64],
    start: usize,
}

/// L y = x, compiled once for every vector unit.
struct Forward<'a, const W: usize> {
    work: Work<'a>,
    range: Range<usize>,
    vectors: &'a mut [[f64; W]],
}

impl<const W: usize> WithSimd for Forward<'_, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, unit: S) {
        self.work.forward(unit, self.range, self.vectors);
    }
}

/// Lᵀ x = y, likewise.
struct Backward<'a, const W: usize> {
    work: Work<'a>,
    range: Range<usize>,
    vectors: &'a mut [[f64; W]],
}

impl<const W: usize> WithSimd for Backward<'_, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, unit: S) {
        self.work.backward(unit, self.range, self.vectors);
    }
}

/// Four columns of a block from `first` on, from the row `from` down; those beyond the last are empty of
/// effect.
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
    fn forward<S: Simd, const W: usize>(&self, unit: S, range: Range<usize>, vectors: &mut [[f64; W]]) {
        let &Self { blocks, numbers, start } = self;
        let mut below = Vec::new();
        for block in range {
            let (columns, rows) = (blocks.columns(block), &blocks.subtrees.places[blocks.row_places(block)]);
            let (width, height) = (columns.len(), columns.len() + rows.len());
            let numbers = &numbers[blocks.numbers(block)];
            below.clear();
            below.resize(rows.len(), [0.0; W]);
            let top = &mut vectors[columns.start - start..columns.end - start];
            for first in (0..width).step_by(4) {
                let group = (width - first).min(4);
                let end = first + group;
                let mut x = [[0.0; W]; 4];
                for (column, x) in (first..end).zip(&mut x) {
                    let l = &numbers[column * height..][..height];
                    *x = top[column].map(|number| number / l[column]);
                    top[column] = *x;
                    for row in column + 1..end {
                        top[row].iter_mut().zip(&*x).for_each(|(number, x)| *number -= l[row] * x);
                    }
                }
                subtract_columns(unit, &mut top[end..], four(numbers, height, first, group, end), x);
                subtract_columns(unit, &mut below, four(numbers, height, first, group, width), x);
            }
            for (&row, numbers) in rows.iter().zip(&below) {
                add(&mut vectors[row as usize], numbers);
            }
        }
    }

    /// Lᵀ x = y in place.
    #[inline(always)]
    fn backward<S: Simd, const W: usize>(&self, unit: S, range: Range<usize>, vectors: &mut [[f64; W]]) {
        let &Self { blocks, numbers, start } = self;
        let mut below = Vec::new();
        for block in range.rev() {
            let (columns, rows) = (blocks.columns(block), &blocks.subtrees.places[blocks.row_places(block)]);
            let (width, height) = (columns.len(), columns.len() + rows.len());
            let numbers = &numbers[blocks.numbers(block)];
            below.clear();
            below.extend(rows.iter().map(|&row| vectors[row as usize]));
            let top = &mut vectors[columns.start - start..columns.end - start];
            for first in (0..width).step_by(4).rev() {
                let group = (width - first).min(4);
                let end = first + group;
                let above = products(unit, four(numbers, height, first, group, end), &top[end..]);
                let under = products(unit, four(numbers, height, first, group, width), &below);
                for own in (0..group).rev() {
                    let column = first + own;
                    let l = &numbers[column * height..][..height];
                    for lane in 0..W {
                        let mut sum = top[column][lane] - above[own][lane] - under[own][lane];
                        for row in column + 1..end {
                            sum -= l[row] * top[row][lane];
                        }
                        top[column][lane] = sum / l[column];
                    }
                }
            }
        }
    }
}
