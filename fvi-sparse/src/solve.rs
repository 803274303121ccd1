//! L Lᵀ x = b, or L Σ Lᵀ x = b.

use crate::Factor;
use crate::blocks::{Blocks, Subtree};
use crate::kernels::{products, subtract_columns};
use core::ops::Range;
use fvi_threads::share;
use pulp::{Arch, NullaryFnOnce, Simd, WithSimd};

/// Number of entries of a factor, times right-hand sides, for which another thread is worth while.
const SHARE: usize = 1 << 20;

/// Number of right-hand sides solved in one pass over the factor.
const WIDEST: usize = 8;

/// Number of entries of a block below its columns, times right-hand sides, for which another thread is worth
/// while; it is lower because the blocks of the trunk follow each other closely.
const SHARE_BLOCK: usize = 1 << 16;

impl Factor {
    /// Replaces the right-hand side by the solution. Several right-hand sides, one after another, are solved
    /// in one pass over the factor, each with the same bits as alone.
    pub fn solve(&self, vectors: &mut [f64]) {
        self.solve_on_threads(vectors, 1);
    }

    /// The same with at most `threads` threads, where that is worth while; the bits are the same.
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
                // Missing right-hand sides are computed as zeros: the factor is read only once all the same.
                _ => self.solve_side_by_side::<WIDEST>(vectors, threads),
            }
        }
    }

    /// Solves for up to W right-hand sides, with their numbers for a row side by side in between: each number
    /// of the factor is read once and multiplied with a vector of them.
    fn solve_side_by_side<const W: usize>(&self, vectors: &mut [f64], threads: usize) {
        let size = self.size();
        let (blocks, numbers) = (self.blocks(), self.numbers());
        let side = |&row: &u32| {
            core::array::from_fn(|lane| vectors.get(lane * size + row as usize).copied().unwrap_or_default())
        };
        let mut sorted: Vec<[f64; W]> = blocks.order.iter().map(side).collect();
        let unit = Arch::new();
        let subtrees = &blocks.subtrees;
        let mut crowns: Vec<SubtreeVector<'_, W>> =
            subtrees.parts.iter().map(|part| SubtreeVector::new(blocks, part, &sorted)).collect();
        share(threads, &mut crowns, |crown| {
            let Subtree { blocks: range, columns } = crown.part;
            let work = Work { blocks, numbers, start: columns.start, threads: 1 };
            unit.dispatch(Forward { work, range: range.clone(), vectors: &mut crown.vectors });
            if blocks.in_pairs {
                take_signs(&mut crown.vectors[..columns.len()]);
            }
        });
        for crown in &crowns {
            crown.give_up(blocks, &mut sorted);
        }
        let trunk = Work { blocks, numbers, start: 0, threads };
        for range in subtrees.trunk(blocks.count()) {
            unit.dispatch(Forward { work: trunk, range, vectors: &mut sorted });
        }
        if blocks.in_pairs {
            // The entries of subtrees in this vector are not used any more.
            take_signs(&mut sorted);
        }
        for range in subtrees.trunk(blocks.count()).rev() {
            unit.dispatch(Backward { work: trunk, range, vectors: &mut sorted });
        }
        for crown in &mut crowns {
            crown.take_up(blocks, &sorted);
        }
        share(threads, &mut crowns, |crown| {
            let Subtree { blocks: range, columns } = crown.part;
            let work = Work { blocks, numbers, start: columns.start, threads: 1 };
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

/// The vector of a subtree, for each right-hand side: its columns, followed by the rows of its last block.
struct SubtreeVector<'a, const W: usize> {
    part: &'a Subtree,
    vectors: Vec<[f64; W]>,
}

impl<'a, const W: usize> SubtreeVector<'a, W> {
    fn new(blocks: &Blocks, part: &'a Subtree, sorted: &[[f64; W]]) -> Self {
        let mut vectors = sorted[part.columns.clone()].to_vec();
        vectors.resize(vectors.len() + blocks.rows(part.blocks.end - 1).len(), [0.0; W]);
        Self { part, vectors }
    }

    /// Adds the contribution of the subtree to the rows beyond it.
    fn give_up(&self, blocks: &Blocks, sorted: &mut [[f64; W]]) {
        let beyond = blocks.rows(self.part.blocks.end - 1);
        for (&row, numbers) in beyond.iter().zip(&self.vectors[self.part.columns.len()..]) {
            add(&mut sorted[row as usize], numbers);
        }
    }

    /// Copies the solution in the rows beyond the subtree.
    fn take_up(&mut self, blocks: &Blocks, sorted: &[[f64; W]]) {
        let beyond = blocks.rows(self.part.blocks.end - 1);
        for (&row, numbers) in beyond.iter().zip(&mut self.vectors[self.part.columns.len()..]) {
            *numbers = sorted[row as usize];
        }
    }

    /// Copies the solution in the columns of the subtree to the whole vector.
    fn bring_down(&self, sorted: &mut [[f64; W]]) {
        let columns = &self.part.columns;
        sorted[columns.clone()].copy_from_slice(&self.vectors[..columns.len()]);
    }
}

/// Σ times a vector that begins with the first row of a pair.
fn take_signs<const W: usize>(vectors: &mut [[f64; W]]) {
    for numbers in vectors.iter_mut().skip(1).step_by(2) {
        *numbers = numbers.map(|number| -number);
    }
}

#[inline(always)]
fn add<const W: usize>(to: &mut [f64; W], numbers: &[f64; W]) {
    *to = core::array::from_fn(|lane| to[lane] + numbers[lane]);
}

/// Substitution in a range of blocks, on vectors whose first row is `start`.
#[derive(Clone, Copy)]
struct Work<'a> {
    blocks: &'a Blocks,
    numbers: &'a [f64],
    start: usize,
    /// Number of threads for large blocks; the bits are the same.
    threads: usize,
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

impl<'a> Work<'a> {
    /// The columns of a block as a range of the vectors, the indices of its rows below them, and its numbers
    /// together with those of the block processed next.
    fn block(&self, block: usize, next: usize) -> (Range<usize>, &'a [u32], Columns<'a>) {
        let columns = self.blocks.columns(block);
        let rows = &self.blocks.subtrees.places[self.blocks.row_places(block)];
        let (width, height) = (columns.len(), columns.len() + rows.len());
        let numbers = &self.numbers[self.blocks.numbers(block)];
        let following = &self.numbers[self.blocks.number_starts[next]..];
        let places = columns.start - self.start..columns.end - self.start;
        (places, rows, Columns { numbers, following, width, height })
    }

    /// Number of threads for the part of a block below its columns.
    fn threads_for<const W: usize>(&self, columns: &Columns<'_>) -> usize {
        let work = columns.width * (columns.height - columns.width) * W;
        (work / SHARE_BLOCK).clamp(1, self.threads)
    }

    /// L y = x in place.
    #[inline(always)]
    fn forward<S: Simd, const W: usize>(&self, unit: S, range: Range<usize>, vectors: &mut [[f64; W]]) {
        let mut below = Vec::new();
        for block in range {
            let (places, rows, columns) = self.block(block, block + 1);
            below.clear();
            below.resize(rows.len(), [0.0; W]);
            let top = &mut vectors[places];
            columns.forward(unit, top);
            match self.threads_for::<W>(&columns) {
                1 => columns.subtract(unit, top, 0, &mut below),
                threads => {
                    let part = rows.len().div_ceil(PARTS * threads);
                    share(threads, below.chunks_mut(part).enumerate(), |(index, below)| {
                        unit.vectorize(Subtract { unit, columns, x: top, first: index * part, below });
                    });
                }
            }
            for (&row, numbers) in rows.iter().zip(&below) {
                add(&mut vectors[row as usize], numbers);
            }
        }
    }

    /// Lᵀ x = y in place.
    #[inline(always)]
    fn backward<S: Simd, const W: usize>(&self, unit: S, range: Range<usize>, vectors: &mut [[f64; W]]) {
        let (mut below, mut under) = (Vec::new(), Vec::new());
        for block in range.rev() {
            let (places, rows, columns) = self.block(block, block.saturating_sub(1));
            below.clear();
            below.extend(rows.iter().map(|&row| vectors[row as usize]));
            under.clear();
            under.resize(columns.width, [0.0; W]);
            match self.threads_for::<W>(&columns) {
                1 => columns.products(unit, 0, &below, &mut under),
                threads => {
                    let part = columns.width.div_ceil(PARTS * threads).next_multiple_of(8);
                    share(threads, under.chunks_mut(part).enumerate(), |(index, under)| {
                        unit.vectorize(Products { unit, columns, first: index * part, below: &below, under });
                    });
                }
            }
            columns.backward(unit, &mut vectors[places], &under);
        }
    }
}

/// Parts of a block per thread: those of a delayed thread are done by the others.
const PARTS: usize = 2;

/// The columns of a block, `width` columns of `height` rows, of which the first `width` rows are the block's
/// own.
#[derive(Clone, Copy)]
struct Columns<'a> {
    numbers: &'a [f64],
    /// The entries of the block processed next, and all after them, for prefetching.
    following: &'a [f64],
    width: usize,
    height: usize,
}

impl<'a> Columns<'a> {
    /// The entries from a column on, or of the next block, for prefetching.
    #[inline(always)]
    fn next(&self, column: usize) -> &'a [f64] {
        if column < self.width { &self.numbers[column * self.height..] } else { self.following }
    }

    /// C columns from `first` on, in these rows; columns beyond `count` are replaced by the last one.
    #[inline(always)]
    fn some<const C: usize>(&self, first: usize, count: usize, rows: Range<usize>) -> [&'a [f64]; C] {
        core::array::from_fn(|index| {
            let column = (first + index.min(count - 1)) * self.height;
            &self.numbers[column + rows.start..column + rows.end]
        })
    }

    /// Solves for the block's own rows with its lower triangle.
    #[inline(always)]
    fn forward<S: Simd, const W: usize>(&self, unit: S, top: &mut [[f64; W]]) {
        for first in (0..self.width).step_by(4) {
            let group = (self.width - first).min(4);
            let end = first + group;
            for column in first..end {
                let l = &self.numbers[column * self.height..][..self.height];
                let x = top[column].map(|number| number / l[column]);
                top[column] = x;
                for row in column + 1..end {
                    top[row].iter_mut().zip(x).for_each(|(number, x)| *number -= l[row] * x);
                }
            }
            let x = four(top, first..end);
            subtract_columns(unit, &mut top[end..], self.some(first, group, end..self.width), x, &[]);
        }
    }

    /// Subtracts from rows below the block, from the given one on, the product of their entries with the
    /// solution x.
    #[inline(always)]
    fn subtract<S: Simd, const W: usize>(
        &self,
        unit: S,
        x: &[[f64; W]],
        first: usize,
        below: &mut [[f64; W]],
    ) {
        let rows = self.width + first..self.width + first + below.len();
        for first in (0..self.width).step_by(4) {
            let group = (self.width - first).min(4);
            let columns = self.some(first, group, rows.clone());
            subtract_columns(unit, below, columns, four(x, first..first + group), self.next(first + group));
        }
    }

    /// The products of columns from `first` on with the solution below the block.
    #[inline(always)]
    fn products<S: Simd, const W: usize>(
        &self,
        unit: S,
        first: usize,
        below: &[[f64; W]],
        under: &mut [[f64; W]],
    ) {
        let rows = self.width..self.height;
        let mut first = first;
        // Memory is read faster along more columns, if there are registers for their sums.
        let (eight, rest) =
            if W == 1 && S::F64_LANES >= 8 { under.as_chunks_mut::<8>() } else { (&mut [][..], under) };
        for under in eight {
            *under = products(unit, self.some::<8>(first, 8, rows.clone()), below, self.next(first + 8));
            first += 8;
        }
        for under in rest.chunks_mut(4) {
            let next = self.next(first + under.len());
            let sums = products(unit, self.some::<4>(first, under.len(), rows.clone()), below, next);
            under.iter_mut().zip(sums).for_each(|(under, sum)| *under = sum);
            first += 4;
        }
    }

    /// Solves for the block's own rows with the upper triangle, given the products with the rows below.
    #[inline(always)]
    fn backward<S: Simd, const W: usize>(&self, unit: S, top: &mut [[f64; W]], under: &[[f64; W]]) {
        for first in (0..self.width).step_by(4).rev() {
            let group = (self.width - first).min(4);
            let end = first + group;
            let above = products(unit, self.some::<4>(first, group, end..self.width), &top[end..], &[]);
            for own in (0..group).rev() {
                let column = first + own;
                let l = &self.numbers[column * self.height..][..self.height];
                for lane in 0..W {
                    let mut sum = top[column][lane] - above[own][lane] - under[column][lane];
                    for row in column + 1..end {
                        sum -= l[row] * top[row][lane];
                    }
                    top[column][lane] = sum / l[column];
                }
            }
        }
    }
}

/// Up to four of the solutions; zero for missing ones.
#[inline(always)]
fn four<const W: usize>(x: &[[f64; W]], range: Range<usize>) -> [[f64; W]; 4] {
    let mut four = [[0.0; W]; 4];
    four.iter_mut().zip(&x[range]).for_each(|(four, x)| *four = *x);
    four
}

/// [`Columns::subtract`] on another thread.
struct Subtract<'a, S, const W: usize> {
    unit: S,
    columns: Columns<'a>,
    x: &'a [[f64; W]],
    first: usize,
    below: &'a mut [[f64; W]],
}

impl<S: Simd, const W: usize> NullaryFnOnce for Subtract<'_, S, W> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.columns.subtract(self.unit, self.x, self.first, self.below);
    }
}

/// [`Columns::products`] on another thread.
struct Products<'a, S, const W: usize> {
    unit: S,
    columns: Columns<'a>,
    first: usize,
    below: &'a [[f64; W]],
    under: &'a mut [[f64; W]],
}

impl<S: Simd, const W: usize> NullaryFnOnce for Products<'_, S, W> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.columns.products(self.unit, self.first, self.below, self.under);
    }
}
