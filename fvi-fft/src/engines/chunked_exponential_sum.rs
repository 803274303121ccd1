//! The exponential-sum memory of the host: samples and terms are processed in chunks, with the far history in
//! products with small matrices.

use fvi_core::{
    ActsOn, ExponentialTable, Memory, MemoryError, ParameterError, Shape, StateError, StateReader,
    StateWriter, Stateful, check_channels, fingerprint, header_bytes,
};
use pulp::{Arch, NullaryFnOnce, Simd, WithSimd};

use crate::engines::row::{CHUNK, Row, add_product};
use crate::engines::scalar::Scalar;
use crate::engines::table_kernel::{Exponential, TableKernel, samples_of};

/// The exponential-sum memory in vector code: r_k = Σ_{n=1}^{k} W_n x_{k−n} for the kernel of an
/// [`ExponentialTable`].
///
/// Samples and terms are processed in chunks of M = 16. A term contains the samples of its own chunk and of
/// the d chunks before it directly, where d chunks cover the head of the table, and everything older through
/// sums Z_j that are updated once per chunk. During chunk c the contribution of the chunks up to c − d to
/// chunk c + 1 is prepared:
///
/// ```text
/// Z_j ← (1 − μ_j)^M Z_j + Σ_{m<M} (1 − μ_j)^{M−1−m} v_jᵀ x_{(c−d)M+m}
/// r_{(c+1)M+i} = Σ_{n=1}^{dM+i} W_n x_{(c+1)M+i−n} + Σ_j u_j (1 − μ_j)^{dM+1−n₀+i} Z_j ,      0 ≤ i < M
/// ```
///
/// Weights are those of the table, and terms agree with [`ExponentialSum`](fvi_core::ExponentialSum) to
/// rounding, in two thirds of its time on a host; not to the last bit, because the order of the sums
/// differs, and because a multiply–add is rounded once on machines where that is one instruction. The work of
/// a chunk is spread over its steps. Memory is constant: 17 kB for 2²⁰ steps of order 1 in `f64`.
///
/// S is the number of stages of the kernel, 1 for plain numbers. Powers are formed in double precision,
/// whatever `T`.
///
/// Source: collapsed contour of \[HJO\] eq. 19; recursion as in \[SchädleLFLubich06\].
pub struct ChunkedExponentialSum<T: Scalar, const S: usize> {
    acts_on: ActsOn,
    horizon: usize,
    /// Hash that distinguishes tables.
    fingerprint: u64,
    len: usize,
    /// W₀, row by row.
    leading: Vec<T>,
    within: Columns<T, S>,
    /// Weights of lags from one chunk to a later one: first d chunks later, last the next one.
    between: Vec<Columns<T, S>>,
    blocks: Vec<Block<T, S>>,
    coordinates: Vec<Coordinate<T, S>>,
    /// Number of pieces of the far work that are to be done by each sample of a chunk.
    due: [usize; CHUNK],
    /// Number of pieces done so far in this chunk.
    done: usize,
    unit: Arch,
}

/// Contribution of each sample of a chunk to the terms of a chunk: entry `[m][b][a]` is from stage b of
/// sample m to stage a.
type Columns<T, const S: usize> = [[[Row<T>; S]; S]; CHUNK];

/// Kind of the saved state.
const TAG: [u8; 4] = *b"chnk";

/// Exponentials per block, equal to the samples per chunk.
const LANES: usize = CHUNK;

/// Sixteen exponentials. A block that is not full is padded with zeros.
struct Block<T, const S: usize> {
    /// 1 − μ
    factor: Row<T>,
    /// (1 − μ)²
    squared: Row<T>,
    /// 1 − (1 − μ)^M, which near 0 has the digits that (1 − μ)^M lacks.
    decay: Row<T>,
    /// v, stage by stage, with a correction for the rounding of the factors; for plain numbers times u.
    inputs: [Row<T>; S],
    /// u (1 − μ)^{dM+1−n₀}, stage by stage; for plain numbers it is part of the input already.
    outputs: [Row<T>; S],
    /// For each exponential (1 − μ)^i, 0 ≤ i < M.
    powers: [Row<T>; LANES],
}

/// The state of one coordinate.
struct Coordinate<T, const S: usize> {
    /// Memory terms of this chunk, as far as the samples are known.
    terms: [Row<T>; S],
    /// Contribution of the samples before this chunk to the terms of the next one, as far as it is done.
    next: [Row<T>; S],
    /// Samples of this chunk.
    samples: [Row<T>; S],
    /// Samples of the d chunks before, oldest first.
    past: Vec<[Row<T>; S]>,
    sums: Vec<Sum<T>>,
}

/// The Z_j of a block.
#[derive(Clone, Copy)]
struct Sum<T> {
    whole: Row<T>,
    /// Rounding error of the sum: a slowly decaying sum would accumulate the errors of many chunks.
    rest: Row<T>,
}

impl<T: Scalar, const S: usize> ChunkedExponentialSum<T, S> {
    /// A memory for the kernel of a table on `channels` channels, without samples.
    ///
    /// # Errors
    /// If [`ExponentialTable::check`] refuses the table, it has another number of stages than S, or
    /// `channels` is no positive multiple of S.
    pub fn new(table: &ExponentialTable<&[f64]>, channels: usize) -> Result<Self, ParameterError> {
        let stages = table.stages;
        if stages != S {
            let allowed = "as many as the type of the memory has";
            return Err(ParameterError { parameter: "stages", value: stages as f64, allowed });
        }
        table.check()?;
        if channels == 0 || !channels.is_multiple_of(S) {
            let allowed = "a positive multiple of the stages";
            return Err(ParameterError { parameter: "channels", value: channels as f64, allowed });
        }
        let mut kernel = TableKernel::new(table);
        let head = kernel.head_len();
        let distance = (head - 1).div_ceil(CHUNK).max(1);
        let weights = |n: usize| kernel.weights(n).into_iter().map(T::of);
        let weights: Vec<T> = (0..(distance + 1) * CHUNK).flat_map(weights).collect();
        let within = columns(&weights, 0);
        let between = (1..=distance).rev().map(|chunks| columns(&weights, chunks)).collect();
        let nearest = distance * CHUNK + 1;
        kernel.keep_what_lasts(nearest);
        let blocks: Vec<Block<T, S>> =
            kernel.terms.chunks(LANES).map(|terms| Block::new(terms, nearest - head)).collect();
        let pieces = distance - 1 + blocks.len() + usize::from(!blocks.is_empty());
        let coordinates = (0..channels / S).map(|_| Coordinate::new(distance, blocks.len())).collect();
        Ok(Self {
            acts_on: ActsOn::Values,
            horizon: samples_of(table.horizon),
            fingerprint: fingerprint(table.head.iter().chain(table.exponentials)),
            len: 0,
            leading: weights[..S * S].to_vec(),
            within,
            between,
            blocks,
            coordinates,
            due: core::array::from_fn(|place| pieces.min((place + 1) * pieces / (CHUNK - 1))),
            done: 0,
            unit: Arch::new(),
        })
    }

    /// The same memory, with weights for samples of the given kind.
    #[must_use]
    pub fn acting_on(self, acts_on: ActsOn) -> Self {
        Self { acts_on, ..self }
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<3> {
        let channels = (self.coordinates.len() * S) as u64;
        [("channels", channels), ("stages", S as u64), ("fingerprint of the kernel", self.fingerprint)]
    }

    /// Reads the number of samples in a saved state.
    fn count(&self, from: &mut StateReader<'_>) -> Result<usize, StateError> {
        from.header::<T, 3>(TAG, &self.shape())?;
        from.count_up_to("samples", self.horizon)
    }

    /// Length of the state.
    fn numbers(&self) -> usize {
        self.coordinates.iter().map(|coordinate| coordinate.rows() * CHUNK).sum()
    }

    #[inline]
    fn check(&self, channels: usize) -> Result<(), MemoryError> {
        check_channels(self.coordinates.len() * S, channels)?;
        let capacity = self.horizon;
        if self.len >= capacity { Err(MemoryError::Full { capacity }) } else { Ok(()) }
    }

    /// Takes a sample of the right length.
    #[inline(always)]
    fn step<V: Simd>(&mut self, unit: V, sample: &[T]) {
        let place = self.len % CHUNK;
        let within = &self.within[place];
        for (coordinate, x) in self.coordinates.iter_mut().zip(sample.as_chunks::<S>().0) {
            for (samples, &x) in coordinate.samples.iter_mut().zip(x) {
                samples.0[place] = x;
            }
            for (weights, &x) in within.iter().zip(x) {
                for (terms, weights) in coordinate.terms.iter_mut().zip(weights) {
                    terms.add_multiple(unit, weights, x, place);
                }
            }
        }
        self.len += 1;
        if self.due[place] != self.done || place + 1 == CHUNK {
            unit.vectorize(Work { memory: self, unit, place });
        }
    }

    /// Work after the sample at `place`: the next pieces of the far work, and at the end the beginning of a
    /// chunk.
    #[inline(always)]
    fn work<V: Simd>(&mut self, unit: V, place: usize) {
        let (pieces, begins) = (self.done..self.due[place], place + 1 == CHUNK);
        self.done = if begins { 0 } else { pieces.end };
        for coordinate in &mut self.coordinates {
            for piece in pieces.clone() {
                coordinate.work(unit, piece, &self.blocks, &self.between);
            }
            if begins {
                coordinate.begin_chunk(unit, &self.between);
            }
        }
    }

    /// The step for processors without a known vector unit. Out of line, so that it does not occupy registers
    /// in the call for the others.
    #[inline(never)]
    fn portable_step(&mut self, sample: &[T]) {
        self.step(pulp::Scalar, sample);
    }
}

/// The step as a call that is compiled once for every vector unit.
struct Step<'a, T: Scalar, const S: usize> {
    memory: &'a mut ChunkedExponentialSum<T, S>,
    sample: &'a [T],
}

impl<T: Scalar, const S: usize> WithSimd for Step<'_, T, S> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) {
        // The branch is resolved at compile time; there is one such step for each memory.
        if V::IS_SCALAR {
            self.memory.portable_step(self.sample);
        } else {
            self.memory.step(unit, self.sample);
        }
    }
}

/// The far work, as a separate call, so that it does not occupy registers in steps without such work.
struct Work<'a, T: Scalar, V, const S: usize> {
    memory: &'a mut ChunkedExponentialSum<T, S>,
    unit: V,
    place: usize,
}

impl<T: Scalar, V: Simd, const S: usize> NullaryFnOnce for Work<'_, T, V, S> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.memory.work(self.unit, self.place);
    }
}

/// Relative deficit of the sum over a chunk of a constant that [`Block::absorb`] makes with the factors of a
/// [`Block`] rounded to the scalar T. It is the same at every chunk, unlike the errors of additions; for
/// exponentials that change their sign nothing accumulates, and it is zero.
fn shortfall<T: Scalar>(term: &Exponential) -> f64 {
    let (base, rest) = term.factor();
    if base <= 0.0 {
        return 0.0;
    }
    let square = base * base;
    let square_rest = libm::fma(base, base, -square) + 2.0 * base * rest;
    let stored = |n: usize| T::of(term.power(n)).to_f64();
    let excess_of_base = (stored(1) - base) - rest;
    let excess_of_square = (stored(2) - square) - square_rest;
    let (mut sum, mut excess_of_sum, mut power, mut excess_of_power) = (0.0, 0.0, 1.0, 0.0);
    for _ in 0..CHUNK / 2 {
        sum += power * (1.0 + base);
        excess_of_sum += excess_of_power * (1.0 + base) + power * excess_of_base;
        excess_of_power = excess_of_power * square + power * excess_of_square;
        power *= square;
    }
    -excess_of_sum / sum
}

/// Contribution of each sample of a chunk to the terms of the chunk that is `chunks` chunks later, from the
/// weights of all lags.
fn columns<T: Scalar, const S: usize>(weights: &[T], chunks: usize) -> Columns<T, S> {
    let mut columns = [[[Row::zeros(); S]; S]; CHUNK];
    for (m, column) in columns.iter_mut().enumerate() {
        for i in 0..CHUNK {
            let Some(n @ 1..) = (chunks * CHUNK + i).checked_sub(m) else { continue };
            for b in 0..S {
                for a in 0..S {
                    column[b][a].0[i] = weights[(n * S + a) * S + b];
                }
            }
        }
    }
    columns
}

/// One number for each of up to sixteen exponentials, zero beyond.
fn lanes<T: Scalar>(terms: &[Exponential], of: &dyn Fn(&Exponential) -> f64) -> Row<T> {
    let mut row = Row::zeros();
    row.0.iter_mut().zip(terms).for_each(|(number, term)| *number = T::of(of(term)));
    row
}

impl<T: Scalar, const S: usize> Block<T, S> {
    /// The block of up to sixteen exponentials; `left` is the nearest lag of the sums minus the first lag of
    /// the table's exponentials.
    fn new(terms: &[Exponential], left: usize) -> Self {
        let mut block = Self {
            factor: lanes(terms, &|term| term.power(1)),
            squared: lanes(terms, &|term| term.power(2)),
            decay: lanes(terms, &|term| term.loss(CHUNK)),
            inputs: [Row::zeros(); S],
            outputs: [Row::zeros(); S],
            powers: [Row::zeros(); LANES],
        };
        for stage in 0..S {
            block.inputs[stage] = lanes(terms, &|term| {
                let joined = if S == 1 { term.output[stage] * term.power(left) } else { 1.0 };
                let input = term.input[stage] * joined;
                input + input * shortfall::<T>(term)
            });
            block.outputs[stage] = lanes(terms, &|term| term.output[stage] * term.power(left));
        }
        for (powers, term) in block.powers.iter_mut().zip(terms) {
            powers.0.iter_mut().enumerate().for_each(|(i, power)| *power = T::of(term.power(i)));
        }
        block
    }

    /// Adds a chunk of samples to the sums.
    #[inline(always)]
    fn absorb<V: Simd>(&self, unit: V, sum: &mut Sum<T>, samples: &[Row<T>; S]) {
        let zero = T::in_lanes(unit, T::zero());
        let mut inputs = [zero; LANES];
        for (samples, scale) in samples.iter().zip(&self.inputs) {
            // Horner's rule for samples at even and at odd places separately: two independent chains of
            // operations.
            let [[first, second], later @ ..] = samples.0.as_chunks::<2>().0 else { return };
            let (mut even, mut odd) =
                ([T::in_lanes(unit, *first); LANES], [T::in_lanes(unit, *second); LANES]);
            for &[first, second] in later {
                let (first, second) = (T::in_lanes(unit, first), T::in_lanes(unit, second));
                for ((even, odd), &squared) in even.iter_mut().zip(&mut odd).zip(self.squared.parts::<V>()) {
                    *even = T::plus_product(unit, squared, *even, first);
                    *odd = T::plus_product(unit, squared, *odd, second);
                }
                // Otherwise the compiler unrolls this loop, processes one chain after the other, and runs out
                // of registers for the samples.
                core::hint::black_box(());
            }
            let parts = self.factor.parts::<V>().iter().zip(scale.parts::<V>());
            for (((input, (&factor, &scale)), even), odd) in inputs.iter_mut().zip(parts).zip(even).zip(odd) {
                *input = T::plus_product(unit, scale, T::plus_product(unit, factor, even, odd), *input);
            }
        }
        let sums = sum.whole.parts_mut::<V>().iter_mut().zip(sum.rest.parts_mut::<V>());
        for (((whole, rest), &decay), input) in sums.zip(self.decay.parts::<V>()).zip(inputs) {
            let change = T::plus(unit, T::minus_product(unit, decay, *whole, *rest), input);
            let after = T::plus(unit, *whole, change);
            *rest = T::minus(unit, change, T::minus(unit, after, *whole));
            *whole = after;
        }
    }

    /// Adds the contribution of the sums to the terms of the next chunk.
    #[inline(always)]
    fn emit<V: Simd>(&self, unit: V, sum: &Sum<T>, next: &mut [Row<T>; S]) {
        for (outputs, next) in self.outputs.iter().zip(next) {
            if S == 1 {
                add_product(unit, next, self.powers.iter().zip(sum.whole.0));
                continue;
            }
            let mut amplitudes = Row::zeros();
            let parts = outputs.parts::<V>().iter().zip(sum.whole.parts::<V>());
            for (amplitude, (&output, &whole)) in amplitudes.parts_mut::<V>().iter_mut().zip(parts) {
                *amplitude = T::times(unit, output, whole);
            }
            add_product(unit, next, self.powers.iter().zip(amplitudes.0));
        }
    }
}

impl<T: Scalar, const S: usize> Coordinate<T, S> {
    fn new(distance: usize, blocks: usize) -> Self {
        let sum = Sum { whole: Row::zeros(), rest: Row::zeros() };
        Self {
            terms: [Row::zeros(); S],
            next: [Row::zeros(); S],
            samples: [Row::zeros(); S],
            past: vec![[Row::zeros(); S]; distance],
            sums: vec![sum; blocks],
        }
    }

    /// Number of rows of the state.
    fn rows(&self) -> usize {
        (3 + self.past.len()) * S + 2 * self.sums.len()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        for chunk in [&self.terms, &self.next, &self.samples].into_iter().chain(&self.past) {
            chunk.iter().try_for_each(|row| to.numbers(&row.0))?;
        }
        for sum in &self.sums {
            to.numbers(&sum.whole.0)?;
            to.numbers(&sum.rest.0)?;
        }
        Ok(())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        for chunk in [&mut self.terms, &mut self.next, &mut self.samples].into_iter().chain(&mut self.past) {
            chunk.iter_mut().try_for_each(|row| from.numbers(&mut row.0))?;
        }
        for sum in &mut self.sums {
            from.numbers(&mut sum.whole.0)?;
            from.numbers(&mut sum.rest.0)?;
        }
        Ok(())
    }

    /// One piece of the far work of a chunk: first each chunk but the oldest, directly; then the blocks. A
    /// block emits one piece after it has absorbed, so that neighbouring pieces are independent of each
    /// other.
    #[inline(always)]
    fn work<V: Simd>(&mut self, unit: V, piece: usize, blocks: &[Block<T, S>], between: &[Columns<T, S>]) {
        let direct = between.len() - 1;
        if let Some(piece) = piece.checked_sub(direct) {
            let emitting = piece.wrapping_sub(1);
            if let (Some(block), Some(sum)) = (blocks.get(emitting), self.sums.get(emitting)) {
                block.emit(unit, sum, &mut self.next);
            }
            let oldest = self.past.first();
            if let (Some(block), Some(sum), Some(oldest)) =
                (blocks.get(piece), self.sums.get_mut(piece), oldest)
            {
                block.absorb(unit, sum, oldest);
            }
        } else if let (Some(samples), Some(columns)) = (self.past.get(piece + 1), between.get(piece)) {
            add_chunk(unit, &mut self.next, samples, columns);
        }
    }

    /// Ends a chunk: its samples join the past, and the terms prepared for the next chunk become the current
    /// ones.
    #[inline(always)]
    fn begin_chunk<V: Simd>(&mut self, unit: V, between: &[Columns<T, S>]) {
        self.terms = self.next;
        self.next = [Row::zeros(); S];
        if let Some(columns) = between.last() {
            add_chunk(unit, &mut self.terms, &self.samples, columns);
        }
        if self.past.len() > 1 {
            self.past.copy_within(1.., 0);
        }
        if let Some(newest) = self.past.last_mut() {
            *newest = self.samples;
        }
    }
}

/// Adds a chunk of samples to the terms of a later one directly.
#[inline(always)]
fn add_chunk<T: Scalar, V: Simd, const S: usize>(
    unit: V,
    terms: &mut [Row<T>; S],
    samples: &[Row<T>; S],
    columns: &Columns<T, S>,
) {
    for (b, samples) in samples.iter().enumerate() {
        for (a, terms) in terms.iter_mut().enumerate() {
            add_product(unit, terms, columns.iter().map(|column| &column[b][a]).zip(samples.0));
        }
    }
}

impl<T: Scalar, const S: usize> Memory<T> for ChunkedExponentialSum<T, S> {
    fn channels(&self) -> usize {
        self.coordinates.len() * S
    }

    fn stages(&self) -> usize {
        S
    }

    fn acts_on(&self) -> ActsOn {
        self.acts_on
    }

    fn leading(&self) -> &[T] {
        &self.leading
    }

    fn len(&self) -> usize {
        self.len
    }

    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        self.check(term.len())?;
        let place = self.len % CHUNK;
        if let ([term], [coordinate]) = (&mut *term, &*self.coordinates) {
            // One channel needs no set-up of a loop.
            *term = coordinate.terms[0].0[place];
            return Ok(());
        }
        for (term, coordinate) in term.as_chunks_mut::<S>().0.iter_mut().zip(&self.coordinates) {
            for (term, terms) in term.iter_mut().zip(&coordinate.terms) {
                *term = terms.0[place];
            }
        }
        Ok(())
    }

    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        self.check(sample.len())?;
        self.unit.dispatch(Step { memory: self, sample });
        Ok(())
    }

    fn clear(&mut self) {
        (self.len, self.done) = (0, 0);
        let (distance, blocks) = (self.between.len(), self.blocks.len());
        self.coordinates.fill_with(|| Coordinate::new(distance, blocks));
    }

    fn bytes(&self) -> usize {
        let coordinate = |coordinate: &Coordinate<T, S>| {
            size_of_val(coordinate.past.as_slice()) + size_of_val(coordinate.sums.as_slice())
        };
        size_of::<Self>()
            + size_of_val(self.leading.as_slice())
            + size_of_val(self.between.as_slice())
            + size_of_val(self.blocks.as_slice())
            + size_of_val(self.coordinates.as_slice())
            + self.coordinates.iter().map(coordinate).sum::<usize>()
    }
}

impl<T: Scalar, const S: usize> Stateful for ChunkedExponentialSum<T, S> {
    fn state_bytes(&self) -> usize {
        header_bytes(4) + self.numbers() * T::BYTES
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape())?;
        to.count(self.len as u64)?;
        self.coordinates.iter().try_for_each(|coordinate| coordinate.save(to))
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.count(from)?;
        from.skip::<T>(self.numbers())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.len = self.count(from)?;
        let place = self.len % CHUNK;
        self.done = if place == 0 { 0 } else { self.due[place - 1] };
        self.coordinates.iter_mut().try_for_each(|coordinate| coordinate.restore(from))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use fvi_core::DoubleDouble;

    /// Weights 2, 1, 1/2, 1/4, …
    fn halves() -> ExponentialTable<&'static [f64]> {
        ExponentialTable {
            stages: 1,
            head: &[2.0, 1.0],
            exponentials: &[0.5, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0],
            slow_blocks: 0,
            far_blocks: 0,
            horizon: 100,
            step_size: 1.0,
        }
    }

    #[test]
    fn a_unit_sample_leaves_the_weights_until_the_horizon() {
        // One exponential, and a second one of constant size that alternates in sign.
        let alternating: &[f64] = &[0.5, 2.0, 0.0, 0.0, 0.5, 0.25, 0.0, 0.0];
        let tables = [(halves(), 0.0), (ExponentialTable { exponentials: alternating, ..halves() }, 0.25)];
        for (table, size) in tables {
            let mut memory = ChunkedExponentialSum::<f64, 1>::new(&table, 1).unwrap();
            assert_eq!(memory.leading(), [2.0]);
            let mut term = [f64::NAN];
            for k in 0..100 {
                memory.next_term(&mut term).unwrap();
                let weight = match k {
                    0 | 1 => f64::from(k),
                    _ => 0.5f64.powi(k - 1) + size * f64::from(1 - k % 2 * 2),
                };
                assert!((term[0] - weight).abs() <= 1e-15 * weight.abs(), "{term:?} at k = {k}");
                memory.push(&[if k == 0 { 1.0 } else { 0.0 }]).unwrap();
            }
            let full = Err(MemoryError::Full { capacity: 100 });
            assert_eq!((memory.next_term(&mut term), memory.push(&[0.0])), (full, full));
        }
    }

    #[test]
    fn what_has_died_away_costs_nothing() {
        // Rates of ln 2 and 16 per step, from lag 1 on; the second has decayed by e^{−256} at lag 17.
        let exponentials: &[f64] = &[0.5, 1.0 - (-16.0f64).exp(), 0.0, 0.0, 0.5, 0.5, 0.0, 0.0];
        let table = ExponentialTable { exponentials, ..halves() };
        let memory = ChunkedExponentialSum::<f64, 1>::new(&table, 1).unwrap();
        let alive = memory.blocks[0].factor.0.iter().filter(|&&factor| factor != 0.0).count();
        assert_eq!((memory.blocks.len(), alive), (1, 1));
    }

    #[test]
    fn a_table_with_other_stages_or_out_of_range_is_refused() {
        let parameter = |table, channels| {
            ChunkedExponentialSum::<f64, 1>::new(&table, channels).err().map(|error| error.parameter)
        };
        assert_eq!(parameter(ExponentialTable { stages: 2, ..halves() }, 2), Some("stages"));
        assert_eq!(parameter(ExponentialTable { exponentials: &[3.0; 8], ..halves() }, 1), Some("decay"));
        assert_eq!(parameter(halves(), 0), Some("channels"));
    }

    /// The sum over sixteen samples of 1 with the factor f and the factor f₂ for two steps: (f + 1) Σ f₂ⁱ, i
    /// < 8.
    fn sum_of_ones(factor: DoubleDouble, squared: DoubleDouble) -> DoubleDouble {
        let sum =
            (1..CHUNK / 2).fold(DoubleDouble::ONE, |sum, _| squared.multiply(sum).add(DoubleDouble::ONE));
        factor.add(DoubleDouble::ONE).multiply(sum)
    }

    fn assert_shortfall<T: Scalar>() {
        let exact = DoubleDouble::exact;
        for decay in [1e-6, 0.003, 0.007, 0.07, 0.1, 0.3, 0.41, 0.62, 0.9] {
            let term = Exponential { decay, output: vec![1.0], input: vec![1.0] };
            let block = Block::<T, 1>::new(core::slice::from_ref(&term), 0);
            let stored = |row: &Row<T>| exact(row.0[0].to_f64());
            let factor = exact(1.0).add(exact(-decay));
            let right = sum_of_ones(factor, factor.multiply(factor));
            let found = sum_of_ones(stored(&block.factor), stored(&block.squared));
            let expected = right.add(found.scale(-1.0)).to_f64() / right.to_f64();
            let error = (shortfall::<T>(&term) - expected).abs();
            // The neglected terms are of second order.
            let unit = T::EPSILON.to_f64() / 2.0;
            assert!(error < 8.0 * unit * unit + 1e-29, "{decay}: {expected:e}, {error:e}");
        }
        let alternating = Exponential { decay: 1.3, output: vec![1.0], input: vec![1.0] };
        assert_eq!(shortfall::<T>(&alternating), 0.0);
    }

    #[test]
    fn rounded_factors_make_a_constant_fall_short_by_what_is_made_up_for() {
        assert_shortfall::<f32>();
        assert_shortfall::<f64>();
    }

    #[test]
    fn a_state_has_the_bytes_that_it_says() {
        for blocks in [1, 3] {
            let exponentials = [0.5, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0].repeat(blocks);
            let table = ExponentialTable { exponentials: exponentials.as_slice(), ..halves() };
            let memory = ChunkedExponentialSum::<f64, 1>::new(&table, 2).unwrap();
            let mut bytes = vec![0; memory.state_bytes()];
            let mut to = StateWriter::new(&mut bytes);
            memory.save(&mut to).unwrap();
            assert_eq!(to.written(), memory.state_bytes(), "{blocks}");
        }
    }

    #[test]
    fn bytes_are_those_of_the_object_and_of_every_number() {
        let table = ExponentialTable { head: &[1.0; 20][..], ..halves() };
        let memory = ChunkedExponentialSum::<f64, 1>::new(&table, 3).unwrap();
        // The head spans two chunks: the reach of the direct weights, and the number of past chunks stored.
        let (row, distance, blocks) = (8 * CHUNK, 2, 1);
        let tables = 8 + distance * CHUNK * row + blocks * (3 + 1 + 1 + 16) * row;
        let coordinate = (3 * row + 2 * size_of::<Vec<f64>>()).next_multiple_of(align_of::<Row<f64>>());
        let state = coordinate + (distance + 2 * blocks) * row;
        assert_eq!(memory.bytes(), size_of_val(&memory) + tables + 3 * state);
    }

    #[test]
    fn the_step_without_vector_units_gives_the_same_terms() {
        let memory = || ChunkedExponentialSum::<f64, 1>::new(&halves(), 1).unwrap();
        let (mut portable, mut other) = (memory(), memory());
        portable.unit = Arch::Scalar;
        for k in 0..60 {
            let (mut found, mut expected) = ([f64::NAN], [f64::NAN]);
            portable.next_term(&mut found).unwrap();
            other.next_term(&mut expected).unwrap();
            assert!((found[0] - expected[0]).abs() <= 1e-14, "{k}: {found:?} {expected:?}");
            let sample = [(0.7 * f64::from(k)).sin()];
            portable.push(&sample).unwrap();
            other.push(&sample).unwrap();
        }
    }
}
