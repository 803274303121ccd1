//! The exponential-sum memory for many channels: vectors of neighbouring channels, and a state that is
//! visited once in a chunk of samples.

use std::sync::{Mutex, PoisonError};

use fvi_core::{
    ActsOn, ExponentialTable, Memory, MemoryError, ParameterError, Shape, StateError, StateReader,
    StateWriter, check_channels, fingerprint, header_bytes,
};
use pulp::{Arch, Simd, WithSimd};

use crate::scalar::Scalar;
use crate::table_kernel::{TableKernel, loss, power};

/// The exponential-sum memory for hundreds of channels and more: r_k = Σ_{n=1}^{k} w_n x_{k−n} for the plain
/// kernel of an [`ExponentialTable`], on every channel alike.
///
/// With many channels the state no longer fits into the caches, and what counts is how often it is fetched.
/// Samples and terms come in chunks of M, M + 1 being no less than the head of the table. A chunk has one
/// place for each of its samples, which holds what is known of the term r_k until x_k takes its place: the
/// samples of the chunk itself are added eight at a time, and the newest when the term is asked for. Only at
/// the end of chunk c are the sums Z_j fetched,
///
/// ```text
/// r_{(c+1)M+i} = Σ_j u_j (1 − μ_j)^{M+1+i−n₀} Z_j + Σ_{m<M} w_{M+i−m} x_{cM+m} ,      0 ≤ i < M
/// Z_j ← (1 − μ_j)^M Z_j + Σ_{m<M} (1 − μ_j)^{M−1−m} x_{cM+m} ,
/// ```
///
/// two products with small matrices. Thirty-two channels lie side by side, and each number of theirs is
/// formed by the same operations whatever their place and the number of threads.
///
/// Weights are those of the table; terms agree with [`ChunkedExponentialSum`](crate::ChunkedExponentialSum)
/// to rounding. One channel takes M + J numbers and four bytes for each of the slow exponentials, whose sums
/// would gather the errors of many chunks.
///
/// `T` is the scalar of samples, terms and arithmetic, `P` that of the state between the chunks. With `f32`
/// in place of `f64` the state is half as large, and a term has an error of some 10⁻⁷ Σ|w||x|.
///
/// Source: collapsed contour of \[HJO\] eq. 19; recursion as in \[SchädleLFLubich06\].
pub struct WideExponentialSum<T: Scalar, P: Scalar = T> {
    acts_on: ActsOn,
    horizon: usize,
    /// Tells the table from others.
    fingerprint: u64,
    len: usize,
    channels: usize,
    plan: Plan<T>,
    tiles: Vec<Tile<P>>,
    threads: usize,
    unit: Arch,
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"wide";

/// Channels that lie side by side.
const LANES: usize = 32;

/// Terms, and sums, that are formed together: as many accumulators as keep the arithmetic of a processor
/// busy.
const GROUP: usize = 8;

/// Smallest chunk: a shorter one would fetch the sums more often without making the state much smaller.
const SHORTEST_CHUNK: usize = 32;

/// What an exponential loses in a chunk from which on its sum forgets fast enough for rounding not to gather.
const FAST: f64 = 0.125;

/// Multiply–adds for which another thread is worth while.
const SHARE: usize = 400_000;

/// Numbers of neighbouring channels, on whole cache lines.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Lanes<N>([N; LANES]);

/// The state of neighbouring channels.
struct Tile<P> {
    /// Samples of this chunk, behind them what is known of the terms of those to come.
    places: Vec<Lanes<P>>,
    sums: Vec<Lanes<P>>,
    /// What rounding took away from the slow sums, the first ones: the upper half of a number.
    rests: Vec<Lanes<u32>>,
}

/// The kernel, as a chunk needs it.
struct Plan<T> {
    /// M.
    chunk: usize,
    leading: [T; 1],
    /// w₀ … w₇.
    near: [T; GROUP],
    /// For each eight terms of a chunk, what the samples of the chunk before them add.
    within: Vec<Vec<[T; GROUP]>>,
    /// For each eight terms of the next chunk, what the sums and the samples of this one add.
    onward: Vec<[Vec<[T; GROUP]>; 2]>,
    /// For each eight sums, what the samples of a chunk add.
    inward: Vec<Vec<[T; GROUP]>>,
    /// For each sum 1 − (1 − μ)^M.
    losses: Vec<T>,
    /// How many sums, from the first on, have a rest.
    slow: usize,
}

impl<T: Scalar> Plan<T> {
    fn new(mut kernel: TableKernel<'_, 1>, chunk: usize) -> Self {
        let head = kernel.head_len();
        let weights: Vec<T> = (0..2 * chunk).map(|n| T::of(kernel.weight(0, 0, n))).collect();
        let near = core::array::from_fn(|n| if n == 0 { T::zero() } else { weights[n] });
        kernel.keep_what_lasts(chunk + 1);
        kernel.terms.sort_by(|a, b| a.decay.total_cmp(&b.decay));
        let terms = &kernel.terms;
        let group = |of: &dyn Fn(usize) -> T| core::array::from_fn(of);
        let within = |first: usize| (0..first).map(|m| group(&|i| weights[first + i - m])).collect();
        let emit = |first: usize| {
            let coefficient = |left: usize| {
                move |term: &fvi_core::ExponentialTerm<f64, 1>| {
                    T::of(term.output[0] * term.input[0] * power(term, left))
                }
            };
            terms.iter().map(|term| group(&|i| coefficient(chunk + 1 + first + i - head)(term))).collect()
        };
        let direct = |first: usize| (0..chunk).map(|m| group(&|i| weights[chunk + first + i - m])).collect();
        let absorb = |first: usize| {
            let number =
                |j: usize, m: usize| terms.get(j).map_or(T::zero(), |term| T::of(power(term, chunk - 1 - m)));
            (0..chunk).map(|m| group(&|i| number(first + i, m))).collect()
        };
        let firsts = || (0..chunk).step_by(GROUP);
        Self {
            chunk,
            leading: [weights[0]],
            near,
            within: firsts().map(within).collect(),
            onward: firsts().map(|first| [emit(first), direct(first)]).collect(),
            inward: (0..terms.len()).step_by(GROUP).map(absorb).collect(),
            losses: terms.iter().map(|term| T::of(loss(term, chunk))).collect(),
            slow: terms.iter().take_while(|term| loss(term, chunk) < FAST).count(),
        }
    }

    /// Multiply–adds for each channel at a place of the chunk.
    fn cost(&self, place: usize) -> usize {
        let behind = place + 1;
        if behind == self.chunk {
            self.chunk * (self.chunk + 2 * self.losses.len())
        } else if behind.is_multiple_of(GROUP) {
            GROUP * behind
        } else {
            GROUP
        }
    }

    /// Bytes of the tables.
    fn bytes(&self) -> usize {
        let groups = |table: &Vec<[T; GROUP]>| size_of_val(table.as_slice());
        self.within.iter().chain(self.onward.iter().flatten()).chain(&self.inward).map(groups).sum::<usize>()
            + size_of_val(self.losses.as_slice())
    }
}

/// Numbers of a tile in the scalar of the arithmetic.
struct Scratch<T> {
    samples: Vec<Lanes<T>>,
    sums: Vec<Lanes<T>>,
    /// Eight results.
    results: [Lanes<T>; GROUP],
}

impl<T: Scalar> Scratch<T> {
    fn new() -> Self {
        Self { samples: Vec::new(), sums: Vec::new(), results: [Lanes([T::zero(); LANES]); GROUP] }
    }
}

/// The same numbers in another precision.
#[inline(always)]
fn converted<A: Scalar, B: Scalar>(row: &Lanes<A>) -> Lanes<B> {
    let mut converted = Lanes([B::zero(); LANES]);
    // `map` of an array is a call.
    converted.0.iter_mut().zip(&row.0).for_each(|(place, number)| *place = B::of(number.to_f64()));
    converted
}

/// The upper 32 bits of a number: its size and some 20 binary digits, six in single precision's all.
#[inline(always)]
fn upper_half<T: Scalar>(number: T) -> u32 {
    (number.bits() >> (8 * T::BYTES - 32)) as u32
}

#[inline(always)]
fn of_upper_half<T: Scalar>(half: u32) -> T {
    T::of_bits(u64::from(half) << (8 * T::BYTES - 32))
}

/// Coefficients of eight sums, and the rows that they multiply.
type Product<'a, T> = (&'a [[T; GROUP]], &'a [Lanes<T>]);

/// results_i = Σ over tables of Σ_j coefficients_{ji} rows_j, for eight i.
#[inline(always)]
fn combine<T: Scalar, V: Simd, const N: usize>(
    unit: V,
    products: [Product<'_, T>; N],
    results: &mut [Lanes<T>; GROUP],
) {
    let parts = T::reals::<V>(&results[0].0).len();
    for part in 0..parts {
        let mut sums = [T::in_lanes(unit, T::zero()); GROUP];
        for (coefficients, rows) in products {
            for (coefficients, row) in coefficients.iter().zip(rows) {
                let Some(&row) = T::reals::<V>(&row.0).get(part) else { return };
                for (sum, &coefficient) in sums.iter_mut().zip(coefficients) {
                    *sum = T::plus_product(unit, T::in_lanes(unit, coefficient), row, *sum);
                }
            }
        }
        for (result, sum) in results.iter_mut().zip(sums) {
            if let Some(place) = T::reals_mut::<V>(&mut result.0).get_mut(part) {
                *place = sum;
            }
        }
    }
}

impl<P: Scalar> Tile<P> {
    fn new<T: Scalar>(plan: &Plan<T>) -> Self {
        let zero = Lanes([P::zero(); LANES]);
        Self {
            places: vec![zero; plan.chunk],
            sums: vec![zero; plan.losses.len()],
            rests: vec![Lanes([0; LANES]); plan.slow],
        }
    }

    /// The terms at a place: what is known of them, and what the newest samples add.
    #[inline(always)]
    fn terms<T: Scalar, V: Simd>(&self, unit: V, plan: &Plan<T>, place: usize, terms: &mut [T]) {
        let newest = self.places.get(place - place % GROUP..place).unwrap_or(&[]);
        let mut sums = self.places.get(place).map_or(Lanes([T::zero(); LANES]), converted);
        let weights = plan.near.iter().skip(1).take(newest.len()).rev();
        for (row, &weight) in newest.iter().zip(weights) {
            let row: Lanes<T> = converted(row);
            let weight = T::in_lanes(unit, weight);
            let parts = T::reals_mut::<V>(&mut sums.0).iter_mut().zip(T::reals::<V>(&row.0));
            for (sum, &number) in parts {
                *sum = T::plus_product(unit, weight, number, *sum);
            }
        }
        terms.iter_mut().zip(sums.0).for_each(|(term, sum)| *term = sum);
    }

    /// Stores samples at a place of the chunk, and does what falls due behind them.
    #[inline(always)]
    fn take<T: Scalar, V: Simd>(
        &mut self,
        unit: V,
        plan: &Plan<T>,
        place: usize,
        samples: &[T],
        scratch: &mut Scratch<T>,
    ) {
        if let Some(row) = self.places.get_mut(place) {
            let numbers = row.0.iter_mut().zip(samples);
            numbers.for_each(|(number, sample)| *number = P::of(sample.to_f64()));
        }
        let behind = place + 1;
        if behind == plan.chunk {
            self.turn(unit, plan, scratch);
        } else if behind.is_multiple_of(GROUP) {
            self.catch_up(unit, plan, behind, scratch);
        }
    }

    /// Adds the samples of the chunk to its next eight terms.
    #[inline(always)]
    fn catch_up<T: Scalar, V: Simd>(
        &mut self,
        unit: V,
        plan: &Plan<T>,
        behind: usize,
        scratch: &mut Scratch<T>,
    ) {
        let (samples, terms) = self.places.split_at_mut(behind);
        let Scratch { samples: unpacked_samples, results, .. } = scratch;
        unpacked_samples.clear();
        unpacked_samples.extend(samples.iter().map(converted));
        let Some(weights) = plan.within.get(behind / GROUP) else { return };
        combine(unit, [(weights, unpacked_samples)], results);
        for (term, result) in terms.iter_mut().zip(results) {
            for (term, result) in term.0.iter_mut().zip(result.0) {
                *term = P::of((T::of(term.to_f64()) + result).to_f64());
            }
        }
    }

    /// Ends a chunk: its samples give way to the terms of the next one, and join the sums.
    #[inline(always)]
    fn turn<T: Scalar, V: Simd>(&mut self, unit: V, plan: &Plan<T>, scratch: &mut Scratch<T>) {
        let Scratch { samples, sums, results } = scratch;
        samples.clear();
        samples.extend(self.places.iter().map(converted));
        sums.clear();
        sums.extend(self.sums.iter().map(converted));
        for ([far, near], terms) in plan.onward.iter().zip(self.places.chunks_mut(GROUP)) {
            combine(unit, [(far, sums), (near, samples)], results);
            terms.iter_mut().zip(&*results).for_each(|(term, result)| *term = converted(result));
        }
        let mut rests = self.rests.iter_mut();
        let groups = plan.inward.iter().zip(plan.losses.chunks(GROUP));
        for ((coefficients, losses), (sums, wholes)) in
            groups.zip(self.sums.chunks_mut(GROUP).zip(sums.chunks(GROUP)))
        {
            combine(unit, [(coefficients, samples)], results);
            let rows = sums.iter_mut().zip(wholes).zip(losses.iter().zip(&*results));
            for ((sum, whole), (&loss, input)) in rows {
                let numbers = sum.0.iter_mut().zip(whole.0).zip(input.0);
                let Some(rest) = rests.next() else {
                    for ((sum, whole), input) in numbers {
                        *sum = P::of((whole + (input - loss * whole)).to_f64());
                    }
                    continue;
                };
                for (((sum, whole), input), rest) in numbers.zip(&mut rest.0) {
                    let change = (of_upper_half::<T>(*rest) - loss * whole) + input;
                    *sum = P::of((whole + change).to_f64());
                    *rest = upper_half(change - (T::of(sum.to_f64()) - whole));
                }
            }
        }
    }
}

/// Hands parts of the work to so many threads; each takes the next as it is done with one. Threads that
/// cannot be had leave their share to the others.
fn share<I: Send>(threads: usize, parts: impl Iterator<Item = I> + Send, work: impl Fn(I) + Sync) {
    let parts = Mutex::new(parts);
    let next = || parts.lock().unwrap_or_else(PoisonError::into_inner).next();
    let run = || {
        while let Some(part) = next() {
            work(part);
        }
    };
    if threads < 2 {
        return run();
    }
    std::thread::scope(|scope| {
        for _ in 1..threads {
            // An error means that this machine has no more threads to give.
            let _ = std::thread::Builder::new().spawn_scoped(scope, run);
        }
        run();
    });
}

/// A call that is compiled once for every vector unit.
struct Terms<'a, T: Scalar, P> {
    plan: &'a Plan<T>,
    place: usize,
    tiles: &'a [Tile<P>],
    terms: &'a mut [T],
}

impl<T: Scalar, P: Scalar> WithSimd for Terms<'_, T, P> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) {
        for (tile, terms) in self.tiles.iter().zip(self.terms.chunks_mut(LANES)) {
            tile.terms(unit, self.plan, self.place, terms);
        }
    }
}

/// The other one.
struct Take<'a, T: Scalar, P> {
    plan: &'a Plan<T>,
    place: usize,
    tiles: &'a mut [Tile<P>],
    samples: &'a [T],
}

impl<T: Scalar, P: Scalar> WithSimd for Take<'_, T, P> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) {
        let mut scratch = Scratch::new();
        for (tile, samples) in self.tiles.iter_mut().zip(self.samples.chunks(LANES)) {
            tile.take(unit, self.plan, self.place, samples, &mut scratch);
        }
    }
}

impl<T: Scalar, P: Scalar> WideExponentialSum<T, P> {
    /// A memory for the kernel of a table on `channels` channels, without samples, for one thread.
    ///
    /// # Errors
    /// If [`ExponentialTable::check`] refuses the table, it has more than one stage, or there is no channel.
    pub fn new(table: &ExponentialTable<&[f64]>, channels: usize) -> Result<Self, ParameterError> {
        if table.stages != 1 {
            let allowed = "1: this memory is for kernels of plain numbers";
            return Err(ParameterError { parameter: "stages", value: table.stages as f64, allowed });
        }
        table.check()?;
        if channels == 0 {
            return Err(ParameterError { parameter: "channels", value: 0.0, allowed: "at least 1" });
        }
        let plan = Plan::new(TableKernel::new(table), Self::chunk(table));
        Ok(Self {
            acts_on: ActsOn::Values,
            horizon: table.horizon,
            fingerprint: fingerprint(table.head.iter().chain(table.exponentials)),
            len: 0,
            channels,
            tiles: (0..channels.div_ceil(LANES)).map(|_| Tile::new(&plan)).collect(),
            plan,
            threads: 1,
            unit: Arch::new(),
        })
    }

    /// Length M of the chunks for a table of one stage: the head of the table must lie within one.
    pub fn chunk(table: &ExponentialTable<&[f64]>) -> usize {
        table.head.len().saturating_sub(1).max(SHORTEST_CHUNK).next_multiple_of(GROUP)
    }

    /// The same memory, its weights being for such samples.
    #[must_use]
    pub fn acting_on(self, acts_on: ActsOn) -> Self {
        Self { acts_on, ..self }
    }

    /// The same memory, working with up to so many threads where that is worth while; the bits are the same.
    #[must_use]
    pub fn on_threads(self, threads: usize) -> Self {
        Self { threads: threads.max(1), ..self }
    }

    /// Bytes of the state of a channel.
    pub fn channel_bytes(&self) -> usize {
        (self.plan.chunk + self.plan.losses.len()) * size_of::<P>() + self.plan.slow * size_of::<u32>()
    }

    /// What its state begins with.
    fn shape(&self) -> Shape<3> {
        let bytes = size_of::<P>() as u64;
        [
            ("channels", self.channels as u64),
            ("bytes of a number of the state", bytes),
            ("fingerprint of the kernel", self.fingerprint),
        ]
    }

    /// Reads how many samples a state has seen.
    fn count(&self, from: &mut StateReader<'_>) -> Result<usize, StateError> {
        from.header::<T, 3>(TAG, &self.shape())?;
        from.count_up_to("samples", self.horizon)
    }

    #[inline]
    fn check(&self, channels: usize) -> Result<(), MemoryError> {
        check_channels(self.channels, channels)?;
        let capacity = self.horizon;
        if self.len >= capacity { Err(MemoryError::Full { capacity }) } else { Ok(()) }
    }

    /// Threads, and tiles in a part of the work, for so many multiply–adds a channel.
    fn shares(&self, cost: usize) -> (usize, usize) {
        let threads = (cost * self.channels / SHARE).clamp(1, self.threads);
        // A thread that is held up leaves parts to the others.
        const PARTS: usize = 4;
        let parts = if threads > 1 { PARTS * threads } else { 1 };
        (threads, self.tiles.len().div_ceil(parts))
    }

    /// The tiles, with the number of channels in each.
    fn filled(&self) -> impl Iterator<Item = (&Tile<P>, usize)> {
        let channels = self.channels;
        self.tiles.iter().enumerate().map(move |(index, tile)| (tile, (channels - index * LANES).min(LANES)))
    }
}

impl<T: Scalar, P: Scalar> Memory<T> for WideExponentialSum<T, P> {
    fn channels(&self) -> usize {
        self.channels
    }

    fn acts_on(&self) -> ActsOn {
        self.acts_on
    }

    fn leading(&self) -> &[T] {
        &self.plan.leading
    }

    fn len(&self) -> usize {
        self.len
    }

    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        self.check(term.len())?;
        let (plan, unit, place) = (&self.plan, self.unit, self.len % self.plan.chunk);
        let (threads, part) = self.shares(GROUP);
        let parts = self.tiles.chunks(part).zip(term.chunks_mut(part * LANES));
        share(threads, parts, |(tiles, terms)| unit.dispatch(Terms { plan, place, tiles, terms }));
        Ok(())
    }

    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        self.check(sample.len())?;
        let place = self.len % self.plan.chunk;
        let (threads, part) = self.shares(self.plan.cost(place));
        let (plan, unit) = (&self.plan, self.unit);
        let parts = self.tiles.chunks_mut(part).zip(sample.chunks(part * LANES));
        share(threads, parts, |(tiles, samples)| unit.dispatch(Take { plan, place, tiles, samples }));
        self.len += 1;
        Ok(())
    }

    fn clear(&mut self) {
        self.len = 0;
        let plan = &self.plan;
        self.tiles.fill_with(|| Tile::new(plan));
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.plan.bytes()
            + self.tiles.len() * LANES * self.channel_bytes()
            + size_of_val(self.tiles.as_slice())
    }

    fn state_bytes(&self) -> usize {
        let numbers = (self.plan.chunk + self.plan.losses.len()) * P::BYTES + self.plan.slow * T::BYTES;
        header_bytes(4) + self.channels * numbers
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape())?;
        to.count(self.len as u64)?;
        for (tile, channels) in self.filled() {
            for row in tile.places.iter().chain(&tile.sums) {
                to.numbers(row.0.iter().take(channels))?;
            }
            for row in &tile.rests {
                to.numbers(row.0.map(of_upper_half::<T>).iter().take(channels))?;
            }
        }
        Ok(())
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.count(from)?;
        from.bytes(self.state_bytes() - header_bytes(4)).map(|_| ())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.len = self.count(from)?;
        let channels = self.channels;
        for (index, tile) in self.tiles.iter_mut().enumerate() {
            let channels = (channels - index * LANES).min(LANES);
            for row in tile.places.iter_mut().chain(&mut tile.sums) {
                from.numbers(row.0.iter_mut().take(channels))?;
            }
            for row in &mut tile.rests {
                for half in row.0.iter_mut().take(channels) {
                    *half = upper_half(from.number::<T>()?);
                }
            }
        }
        Ok(())
    }
}
