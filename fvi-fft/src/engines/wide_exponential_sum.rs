//! The exponential-sum memory for many channels: vectors of neighbouring channels, and a state that is
//! visited once in a chunk of samples.

use fvi_core::{
    ActsOn, ExponentialTable, Memory, MemoryError, ParameterError, SavedChannels, Shape, StateError,
    StateReader, StateWriter, Stateful, check_channels, fingerprint, header_bytes,
};
use fvi_threads::{are_awake, share};
use pulp::{Arch, Simd, WithSimd};

use crate::engines::scalar::Scalar;
use crate::engines::table_kernel::{Exponential, TableKernel, keep_what_lasts, samples_of};

/// The exponential-sum memory for hundreds of channels and more: r_k = Σ_{n=1}^{k} w_n x_{k−n} for the plain
/// kernel of an [`ExponentialTable`], on every channel alike.
///
/// With many channels the state does not fit into the caches, and the cost is that of reading it. Samples and
/// terms are processed in chunks of M, where M + 1 is at least the head of the table. A chunk has one place
/// for each of its samples, which holds the known part of the term r_k until x_k replaces it: the samples of
/// the chunk itself are added eight at a time, and the newest when the term is requested. Only at the end of
/// chunk c are the sums Z_j read,
///
/// ```text
/// r_{(c+1)M+i} = Σ_j u_j (1 − μ_j)^{M+1+i−n₀} Z_j + Σ_{m<M} w_{M+i−m} x_{cM+m} ,      0 ≤ i < M
/// Z_j ← (1 − μ_j)^M Z_j + Σ_{m<M} (1 − μ_j)^{M−1−m} x_{cM+m} ,
/// ```
///
/// two products with small matrices. Thirty-two channels are processed side by side; the operations for a
/// number do not depend on its place nor on the number of threads.
///
/// Several kernels with the same exponentials and different coefficients, of dampings of different orders on
/// the same coordinates, share the samples and the sums; only the places of known terms are separate.
///
/// Weights are those of the table; terms agree with [`ChunkedExponentialSum`](crate::ChunkedExponentialSum)
/// to rounding. One channel of K kernels takes K M + J numbers, and four bytes for each of the slow
/// exponentials, whose sums would otherwise accumulate the errors of many chunks.
///
/// `T` is the scalar of samples, terms and arithmetic, `P` that of the state between the chunks. With `f32`
/// in place of `f64` the state is half as large, and a term has an error of some 10⁻⁷ Σ|w||x|.
///
/// Source: collapsed contour of \[HJO\] eq. 19; recursion as in \[SchädleLFLubich06\].
pub struct WideExponentialSum<T: Scalar, P: Scalar = T> {
    acts_on: ActsOn,
    horizon: usize,
    /// Hash that distinguishes the tables.
    fingerprint: u64,
    len: usize,
    channels: usize,
    plan: Plan<T>,
    state: State<P>,
    threads: usize,
    unit: Arch,
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"wide";

/// Largest number of kernels of a [`WideExponentialSum`].
pub const WIDE_KERNELS: usize = 4;

/// Number of channels processed side by side.
const LANES: usize = 32;

/// Number of terms, or sums, computed together: enough accumulators to keep the arithmetic units of a
/// processor busy.
const GROUP: usize = 8;

/// Smallest chunk: a shorter one would read the sums more often without making the state much smaller.
const SHORTEST_CHUNK: usize = 32;

/// Smallest loss per chunk, 1 − (1 − μ)^M, at which rounding errors do not accumulate in a sum.
const FAST: f64 = 0.125;

/// Approximate costs in picoseconds: a multiply–add; reading or writing a number of the state; and one of the
/// caller's.
const MULTIPLY_ADD: usize = 25;
const FETCH: usize = 60;
const FETCH_OUTSIDE: usize = 150;

/// Work per thread, in picoseconds, that is worth sharing with threads that are awake, a few times the cost
/// of handing it over; and with threads that have to be woken, about the time that takes.
const SHARE: usize = 10_000_000;
const WAKE: usize = 50_000_000;

/// Bounds of the work in a part, in picoseconds: below the shortest the set-up of its scratch dominates; the
/// longest limits how long threads may wait for each other.
const SHORTEST_PART: usize = 5_000_000;
const LONGEST_PART: usize = 100_000_000;

/// Numbers of neighbouring channels, on whole cache lines.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Lanes<N>([N; LANES]);

/// The state of tiles of neighbouring channels. The data that a step needs of successive tiles are
/// contiguous, so that it reads memory sequentially.
struct State<P> {
    /// One vector for each group of eight places, with eight rows for every tile. The groups of the first
    /// kernel contain the samples of this chunk, and after them the known parts of its terms at the places to
    /// come; then follow the groups of each further kernel, with the known parts of its terms at all places.
    groups: Vec<Vec<Lanes<P>>>,
    /// The rows of the first tile, then those of the second, and so on.
    sums: Vec<Lanes<P>>,
    /// Rounding errors of the slow sums, the first ones of a tile: the upper half of a number.
    rests: Vec<Lanes<u32>>,
}

/// The kernels in the form used in a chunk.
struct Plan<T> {
    /// M.
    chunk: usize,
    /// w₀ of each kernel.
    leading: Vec<T>,
    kernels: Vec<KernelPlan<T>>,
    /// For each group of eight sums, the coefficients of the samples of a chunk.
    inward: Vec<Vec<[T; GROUP]>>,
    /// For each sum 1 − (1 − μ)^M.
    losses: Vec<T>,
    /// Number of sums, from the first, that have a rest.
    slow: usize,
}

/// Data that belong to one kernel.
struct KernelPlan<T> {
    /// w₀ … w₇.
    near: [T; GROUP],
    /// For each group of eight terms of a chunk, the coefficients of the samples of the chunk before them.
    within: Vec<Vec<[T; GROUP]>>,
    /// For each group of eight terms of the next chunk, the coefficients of the sums and of the samples of
    /// this one.
    onward: Vec<[Vec<[T; GROUP]>; 2]>,
}

impl<T: Scalar> KernelPlan<T> {
    /// Tables from the weights up to lag 2M of a kernel and its exponentials that are not negligible.
    fn new(weights: &[T], terms: &[Exponential], head: usize) -> Self {
        let chunk = weights.len() / 2;
        let group = |of: &dyn Fn(usize) -> T| core::array::from_fn(of);
        let within = |first: usize| (0..first).map(|m| group(&|i| weights[first + i - m])).collect();
        let emit = |first: usize| {
            let coefficient = |left: usize| {
                move |term: &Exponential| T::of(term.output[0] * term.input[0] * term.power(left))
            };
            terms.iter().map(|term| group(&|i| coefficient(chunk + 1 + first + i - head)(term))).collect()
        };
        let direct = |first: usize| (0..chunk).map(|m| group(&|i| weights[chunk + first + i - m])).collect();
        let firsts = || (0..chunk).step_by(GROUP);
        Self {
            near: core::array::from_fn(|n| if n == 0 { T::zero() } else { weights[n] }),
            within: firsts().map(within).collect(),
            onward: firsts().map(|first| [emit(first), direct(first)]).collect(),
        }
    }

    /// Bytes of the tables.
    fn bytes(&self) -> usize {
        let tables = self.within.iter().chain(self.onward.iter().flatten());
        size_of::<Self>() + tables.map(|table| size_of_val(table.as_slice())).sum::<usize>()
    }
}

impl<T: Scalar> Plan<T> {
    /// A plan for tables that differ in their coefficients only.
    fn new(tables: &[ExponentialTable<&[f64]>], chunk: usize) -> Self {
        let mut kernels: Vec<_> = tables.iter().map(TableKernel::new).collect();
        let weights = |kernel: &TableKernel<'_>| -> Vec<T> {
            (0..2 * chunk).flat_map(|n| kernel.weights(n)).map(T::of).collect()
        };
        let weights: Vec<_> = kernels.iter().map(weights).collect();
        keep_what_lasts(&mut kernels, chunk + 1);
        for kernel in &mut kernels {
            kernel.terms.sort_by(|a, b| a.decay.total_cmp(&b.decay));
        }
        let terms = kernels.first().map_or(&[][..], |kernel| &kernel.terms);
        let absorb = |first: usize| {
            let number =
                |j: usize, m: usize| terms.get(j).map_or(T::zero(), |term| T::of(term.power(chunk - 1 - m)));
            (0..chunk).map(|m| core::array::from_fn(|i| number(first + i, m))).collect()
        };
        let own = |(kernel, weights): (&TableKernel<'_>, &Vec<T>)| {
            KernelPlan::new(weights, &kernel.terms, kernel.head_len())
        };
        Self {
            chunk,
            leading: weights.iter().map(|weights| weights[0]).collect(),
            kernels: kernels.iter().zip(&weights).map(own).collect(),
            inward: (0..terms.len()).step_by(GROUP).map(absorb).collect(),
            losses: terms.iter().map(|term| T::of(term.loss(chunk))).collect(),
            slow: terms.iter().take_while(|term| term.loss(chunk) < FAST).count(),
        }
    }

    /// Number of places of a tile.
    fn places(&self) -> usize {
        self.kernels.len() * self.chunk
    }

    /// Number of groups of eight places per kernel.
    fn groups(&self) -> usize {
        self.chunk / GROUP
    }

    /// Approximate cost of the terms at a place of the chunk per channel, in picoseconds.
    fn cost_of_terms(&self, place: usize) -> usize {
        let (kernels, newest) = (self.kernels.len(), place % GROUP);
        MULTIPLY_ADD * kernels * newest + FETCH * newest + FETCH_OUTSIDE * 4 * kernels
    }

    /// Approximate cost of a sample at a place of the chunk per channel, in picoseconds.
    fn cost_of_sample(&self, place: usize) -> usize {
        let (behind, kernels, sums) = (place + 1, self.kernels.len(), self.losses.len());
        let (products, fetched) = if behind == self.chunk {
            (self.chunk * (kernels * (self.chunk + sums) + sums), (1 + kernels) * self.chunk + 2 * sums)
        } else if behind.is_multiple_of(GROUP) {
            (kernels * GROUP * behind, behind + 2 * kernels * GROUP)
        } else {
            (0, 2)
        };
        MULTIPLY_ADD * products + FETCH * fetched + FETCH_OUTSIDE
    }

    /// Bytes of the tables.
    fn bytes(&self) -> usize {
        let inward = self.inward.iter().map(|table| size_of_val(table.as_slice()));
        self.kernels.iter().map(KernelPlan::bytes).chain(inward).sum::<usize>()
            + size_of_val(self.leading.as_slice())
            + size_of_val(self.losses.as_slice())
    }
}

/// Buffers for a tile in the scalar of the arithmetic.
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
    // `map` of an array would be a call.
    converted.0.iter_mut().zip(&row.0).for_each(|(place, number)| *place = B::of(number.to_f64()));
    converted
}

/// The upper 32 bits of a number: its size and some 20 binary digits; of a number in single precision all but
/// six of its digits.
#[inline(always)]
fn upper_half<T: Scalar>(number: T) -> u32 {
    (number.bits() >> (8 * T::BYTES - 32)) as u32
}

#[inline(always)]
fn of_upper_half<T: Scalar>(half: u32) -> T {
    T::of_bits(u64::from(half) << (8 * T::BYTES - 32))
}

/// Prefetches the numbers of a row, which are needed soon.
#[inline(always)]
fn fetch_ahead<N>(row: &Lanes<N>) {
    #[cfg(target_arch = "x86_64")]
    if let Some(unit) = pulp::core_arch::x86::Sse::try_new() {
        // Rows begin and end with a line of the cache.
        for numbers in row.0.chunks(align_of::<Lanes<N>>() / size_of::<N>()) {
            unit._mm_prefetch::<{ core::arch::x86_64::_MM_HINT_T0 }>(numbers.as_ptr().cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = row;
}

/// Coefficients for eight sums, and the rows that they multiply.
type Product<'a, T> = (&'a [[T; GROUP]], &'a [Lanes<T>]);

/// results_i = Σ over tables of Σ_j coefficients_{ji} rows_j, for eight i. With every eight products one of
/// the rows `ahead` is prefetched, so that memory is read during the arithmetic and not all at once.
#[inline(always)]
fn combine<T: Scalar, P, V: Simd, const N: usize>(
    unit: V,
    products: [Product<'_, T>; N],
    results: &mut [Lanes<T>; GROUP],
    ahead: &[Lanes<P>],
) {
    // Two vectors of each sum if there are enough registers: a coefficient is then loaded once for both.
    if const { V::REGISTER_COUNT < 32 } {
        combine_vectors::<T, P, V, N, 1>(unit, products, results, ahead);
    } else {
        combine_vectors::<T, P, V, N, 2>(unit, products, results, ahead);
    }
}

/// The same, W vectors of each sum at a time.
#[inline(always)]
fn combine_vectors<T: Scalar, P, V: Simd, const N: usize, const W: usize>(
    unit: V,
    products: [Product<'_, T>; N],
    results: &mut [Lanes<T>; GROUP],
    ahead: &[Lanes<P>],
) {
    let vectors = T::reals::<V>(&results[0].0).len();
    let mut ahead = ahead.iter();
    for part in (0..vectors).step_by(W) {
        let mut sums = [[T::in_lanes(unit, T::zero()); W]; GROUP];
        for (coefficients, rows) in products {
            for (coefficients, rows) in coefficients.chunks(GROUP).zip(rows.chunks(GROUP)) {
                ahead.next().into_iter().for_each(fetch_ahead);
                for (coefficients, row) in coefficients.iter().zip(rows) {
                    let Some(row) = T::reals::<V>(&row.0).get(part..part + W) else { return };
                    for (sums, &coefficient) in sums.iter_mut().zip(coefficients) {
                        let coefficient = T::in_lanes(unit, coefficient);
                        for (sum, &number) in sums.iter_mut().zip(row) {
                            *sum = T::plus_product(unit, coefficient, number, *sum);
                        }
                    }
                }
            }
        }
        for (result, sums) in results.iter_mut().zip(sums) {
            if let Some(places) = T::reals_mut::<V>(&mut result.0).get_mut(part..part + W) {
                places.copy_from_slice(&sums);
            }
        }
    }
}

/// The rows of a tile in a slice with `count` rows for each.
#[inline(always)]
fn rows<N>(slice: &[N], tile: usize, count: usize) -> &[N] {
    slice.get(tile * count..(tile + 1) * count).unwrap_or(&[])
}

/// The same, mutable.
#[inline(always)]
fn rows_mut<N>(slice: &mut [N], tile: usize, count: usize) -> &mut [N] {
    slice.get_mut(tile * count..(tile + 1) * count).unwrap_or(&mut [])
}

/// The rows of a tile, mutable, and those of the next.
#[inline(always)]
fn rows_and_next<N>(slice: &mut [N], tile: usize, count: usize) -> (&mut [N], &[N]) {
    let rest = slice.get_mut(tile * count..).unwrap_or(&mut []);
    let (rows, next) = rest.split_at_mut(count.min(rest.len()));
    (rows, next.get(..count).unwrap_or(&[]))
}

/// Stores samples of a tile in their row of its group.
#[inline(always)]
fn store<T: Scalar, P: Scalar>(row: Option<&mut Lanes<P>>, samples: &[T]) {
    if let Some(row) = row {
        let numbers = row.0.iter_mut().zip(samples);
        numbers.for_each(|(number, sample)| *number = P::of(sample.to_f64()));
    }
}

impl<P: Scalar> State<P> {
    fn new<T: Scalar>(plan: &Plan<T>, tiles: usize) -> Self {
        let zero = Lanes([P::zero(); LANES]);
        Self {
            groups: (0..plan.places() / GROUP).map(|_| vec![zero; tiles * GROUP]).collect(),
            sums: vec![zero; tiles * plan.losses.len()],
            rests: vec![Lanes([0; LANES]); tiles * plan.slow],
        }
    }

    fn tiles(&self) -> usize {
        self.groups.first().map_or(0, |group| group.len() / GROUP)
    }

    /// The whole state, in parts of the given number of tiles.
    fn parts<T: Scalar>(&mut self, plan: &Plan<T>, tiles: usize) -> Vec<Part<'_, P>> {
        let count = self.tiles().div_ceil(tiles);
        let part =
            |_| Part { groups: Vec::with_capacity(plan.places() / GROUP), sums: &mut [], rests: &mut [] };
        let mut parts: Vec<_> = (0..count).map(part).collect();
        for group in &mut self.groups {
            let rows = group.chunks_mut(tiles * GROUP);
            parts.iter_mut().zip(rows).for_each(|(part, rows)| part.groups.push(rows));
        }
        // There may be no sums.
        let sums = self.sums.chunks_mut((tiles * plan.losses.len()).max(1));
        parts.iter_mut().zip(sums).for_each(|(part, sums)| part.sums = sums);
        let rests = self.rests.chunks_mut((tiles * plan.slow).max(1));
        parts.iter_mut().zip(rests).for_each(|(part, rests)| part.rests = rests);
        parts
    }
}

/// Some tiles of the state.
struct Part<'a, P> {
    groups: Vec<&'a mut [Lanes<P>]>,
    sums: &'a mut [Lanes<P>],
    rests: &'a mut [Lanes<u32>],
}

impl<P: Scalar> Part<'_, P> {
    /// The samples of the first groups.
    #[inline(always)]
    fn samples<T: Scalar>(&self, tile: usize, groups: usize, samples: &mut Vec<Lanes<T>>) {
        samples.clear();
        for group in self.groups.iter().take(groups) {
            samples.extend(rows(group, tile, GROUP).iter().map(converted));
        }
    }

    /// Adds the samples of the first groups of a chunk to the terms of the next one.
    #[inline(always)]
    fn catch_up<T: Scalar, V: Simd>(
        &mut self,
        unit: V,
        plan: &Plan<T>,
        tile: usize,
        next: usize,
        scratch: &mut Scratch<T>,
    ) {
        let Scratch { samples, results, .. } = scratch;
        self.samples(tile, next, samples);
        for (kernel, groups) in plan.kernels.iter().zip(self.groups.chunks_mut(plan.groups())) {
            let (Some(weights), Some(terms)) = (kernel.within.get(next), groups.get_mut(next)) else {
                return;
            };
            combine::<T, P, V, 1>(unit, [(weights, samples)], results, &[]);
            for (term, result) in rows_mut(terms, tile, GROUP).iter_mut().zip(&*results) {
                for (term, result) in term.0.iter_mut().zip(result.0) {
                    *term = P::of((T::of(term.to_f64()) + result).to_f64());
                }
            }
        }
    }

    /// Ends a chunk: its samples are replaced by the terms of the next one, and added to the sums.
    #[inline(always)]
    fn turn<T: Scalar, V: Simd>(&mut self, unit: V, plan: &Plan<T>, tile: usize, scratch: &mut Scratch<T>) {
        let Scratch { samples, sums: wholes, results } = scratch;
        self.samples(tile, plan.groups(), samples);
        let (sums, of_next_tile) = rows_and_next(self.sums, tile, plan.losses.len());
        wholes.clear();
        wholes.extend(sums.iter().map(converted));
        let groups = plan.kernels.iter().flat_map(|kernel| &kernel.onward);
        for ([far, near], terms) in groups.zip(&mut self.groups) {
            combine(unit, [(far, wholes), (near, samples)], results, rows(terms, tile + 1, GROUP));
            let terms = rows_mut(terms, tile, GROUP).iter_mut();
            terms.zip(&*results).for_each(|(term, result)| *term = converted(result));
        }
        let mut rests = rows_mut(self.rests, tile, plan.slow).iter_mut();
        let groups = plan.inward.iter().zip(plan.losses.chunks(GROUP));
        let mut ahead = of_next_tile.chunks(GROUP);
        for ((coefficients, losses), (sums, wholes)) in
            groups.zip(sums.chunks_mut(GROUP).zip(wholes.chunks(GROUP)))
        {
            combine(unit, [(coefficients, samples)], results, ahead.next().unwrap_or(&[]));
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

/// The terms of some channels, for each kernel; empty for missing kernels.
type OfKernels<'a, T> = [&'a mut [T]; WIDE_KERNELS];

/// Splits off the terms of the first `channels` channels, or of all that are left.
#[inline(always)]
fn take_first<'a, T>(rest: &mut OfKernels<'a, T>, channels: usize) -> OfKernels<'a, T> {
    let mut taken = OfKernels::default();
    for (taken, rest) in taken.iter_mut().zip(rest) {
        let all = core::mem::take(rest);
        (*taken, *rest) = all.split_at_mut(channels.min(all.len()));
    }
    taken
}

/// The terms at a place of the chunk, from their known parts and the newest samples: a call that is compiled
/// once for every vector unit.
struct Terms<'a, T: Scalar, P> {
    plan: &'a Plan<T>,
    place: usize,
    /// For each kernel the group that contains the place.
    groups: [&'a [Lanes<P>]; WIDE_KERNELS],
    terms: OfKernels<'a, T>,
}

impl<T: Scalar, P: Scalar> WithSimd for Terms<'_, T, P> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) {
        let Self { plan, groups, mut terms, .. } = self;
        let place = self.place % GROUP;
        for (tile, newest) in groups[0].chunks(GROUP).enumerate() {
            let newest = newest.get(..place).unwrap_or(&[]);
            let of_tile = take_first(&mut terms, LANES);
            for ((kernel, group), terms) in plan.kernels.iter().zip(groups).zip(of_tile) {
                let Some(known) = rows(group, tile, GROUP).get(place) else { return };
                let mut sums: Lanes<T> = converted(known);
                let weights = kernel.near.iter().skip(1).take(newest.len()).rev();
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
        }
    }
}

/// A sample that completes a group, and the work that is then due: likewise.
struct Due<'a, T: Scalar, P> {
    plan: &'a Plan<T>,
    place: usize,
    part: Part<'a, P>,
    samples: &'a [T],
}

impl<T: Scalar, P: Scalar> WithSimd for Due<'_, T, P> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) {
        let Self { plan, place, mut part, samples } = self;
        let mut scratch = Scratch::new();
        let next = place / GROUP + 1;
        for (tile, samples) in samples.chunks(LANES).enumerate() {
            let group = part.groups.get_mut(place / GROUP);
            store(group.and_then(|group| rows_mut(group, tile, GROUP).last_mut()), samples);
            if next == plan.groups() {
                part.turn(unit, plan, tile, &mut scratch);
            } else {
                part.catch_up(unit, plan, tile, next, &mut scratch);
            }
        }
    }
}

impl<T: Scalar, P: Scalar> WideExponentialSum<T, P> {
    /// A memory for the kernel of a table on `channels` channels, without samples, for one thread.
    ///
    /// # Errors
    /// If [`ExponentialTable::check`] refuses the table, it has more than one stage, or there is no channel.
    pub fn new(table: &ExponentialTable<&[f64]>, channels: usize) -> Result<Self, ParameterError> {
        Self::of_kernels(&[*table], channels)
    }

    /// A memory for the kernels of tables that share their exponentials: one head length, the same μ in the
    /// same places.
    ///
    /// # Errors
    /// As [`new`](Self::new), and if the tables do not share them, there is none or more than
    /// [`WIDE_KERNELS`].
    pub fn of_kernels(tables: &[ExponentialTable<&[f64]>], channels: usize) -> Result<Self, ParameterError> {
        let refused = |parameter, value, allowed| Err(ParameterError { parameter, value, allowed });
        let (Some(first), 1..=WIDE_KERNELS) = (tables.first(), tables.len()) else {
            return refused("tables", tables.len() as f64, "1 to 4");
        };
        for table in tables {
            if table.stages != 1 {
                let allowed = "1: this memory is for kernels of plain numbers";
                return refused("stages", table.stages as f64, allowed);
            }
            table.check()?;
            if table.head.len() != first.head.len() {
                return refused("head weights", table.head.len() as f64, "as many as the first table has");
            }
            let (own, of_first) = (table.terms::<1>().count(), first.terms::<1>().count());
            if own != of_first {
                return refused("exponentials", own as f64, "as many as the first table has");
            }
            let mut pairs = table.terms::<1>().zip(first.terms::<1>());
            if let Some((own, _)) = pairs.find(|(own, of_first)| own.decay != of_first.decay) {
                return refused("decay", own.decay, "that of the first table, in its place");
            }
        }
        if channels == 0 {
            return refused("channels", 0.0, "at least 1");
        }
        let plan = Plan::new(tables, Self::chunk(first));
        let numbers = tables.iter().flat_map(|table| table.head.iter().chain(table.exponentials));
        Ok(Self {
            acts_on: ActsOn::Values,
            horizon: tables.iter().map(|table| samples_of(table.horizon)).min().unwrap_or(0),
            fingerprint: fingerprint(numbers),
            len: 0,
            channels,
            state: State::new(&plan, channels.div_ceil(LANES)),
            plan,
            threads: 1,
            unit: Arch::new(),
        })
    }

    /// Length M of the chunks for a table of one stage: the head of the table must lie within one.
    pub fn chunk(table: &ExponentialTable<&[f64]>) -> usize {
        table.head.len().saturating_sub(1).max(SHORTEST_CHUNK).next_multiple_of(GROUP)
    }

    /// The same memory, with weights for samples of the given kind.
    #[must_use]
    pub fn acting_on(self, acts_on: ActsOn) -> Self {
        Self { acts_on, ..self }
    }

    /// The same memory, with up to the given number of threads where that is worth while; the bits are the
    /// same.
    #[must_use]
    pub fn on_threads(self, threads: usize) -> Self {
        Self { threads: threads.max(1), ..self }
    }

    /// Bytes of the state of a channel.
    pub fn channel_bytes(&self) -> usize {
        (self.plan.places() + self.plan.losses.len()) * size_of::<P>() + self.plan.slow * size_of::<u32>()
    }

    /// Header of the saved state of `channels` channels.
    fn shape(&self, channels: usize) -> Shape<3> {
        let bytes = size_of::<P>() as u64;
        [
            ("channels", channels as u64),
            ("bytes of a number of the state", bytes),
            ("fingerprint of the kernel", self.fingerprint),
        ]
    }

    /// Reads the number of samples in a saved state of `channels` channels.
    fn count(&self, channels: usize, from: &mut StateReader<'_>) -> Result<usize, StateError> {
        from.header::<T, 3>(TAG, &self.shape(channels))?;
        from.count_up_to("samples", self.horizon)
    }

    /// Reads past a saved state of `channels` channels.
    fn check_state_of(&self, channels: usize, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.count(channels, from)?;
        let (places, slow) = (self.plan.places() + self.plan.losses.len(), self.plan.slow);
        for tile in 0..channels.div_ceil(LANES) {
            let channels = (channels - tile * LANES).min(LANES);
            from.skip::<P>(channels * places)?;
            from.skip::<T>(channels * slow)?;
        }
        Ok(())
    }

    #[inline]
    fn check_capacity(&self) -> Result<(), MemoryError> {
        let capacity = self.horizon;
        if self.len >= capacity { Err(MemoryError::Full { capacity }) } else { Ok(()) }
    }

    /// Number of threads, and of tiles in a part of the work, for `cost` picoseconds a channel. Threads that
    /// have to be woken are worth while for more work only.
    fn shares(&self, cost: usize, awake: impl Fn(usize) -> bool) -> (usize, usize) {
        let cost = cost * self.channels;
        let threads = match cost >= SHARE * self.threads && awake(self.threads) {
            true => self.threads,
            false => (cost / WAKE).clamp(1, self.threads),
        };
        // The parts of a thread that begins late are done by the others.
        const PARTS: usize = 16;
        let parts = (PARTS * threads).min(cost / SHORTEST_PART).max(cost / LONGEST_PART);
        (threads, self.state.tiles().div_ceil(if threads > 1 { parts } else { 1 }))
    }
}

impl<T: Scalar, P: Scalar> Memory<T> for WideExponentialSum<T, P> {
    fn channels(&self) -> usize {
        self.channels
    }

    fn kernels(&self) -> usize {
        self.plan.kernels.len()
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
        let kernels = self.plan.kernels.len();
        check_channels(kernels * self.channels, term.len())?;
        self.check_capacity()?;
        let (plan, unit, place) = (&self.plan, self.unit, self.len % self.plan.chunk);
        let (threads, part) = self.shares(plan.cost_of_terms(place), are_awake);
        let mut rest = OfKernels::default();
        rest.iter_mut().zip(term.chunks_mut(self.channels)).for_each(|(rest, terms)| *rest = terms);
        let groups = self.state.groups.iter().skip(place / GROUP).step_by(plan.groups());
        let parts = (0..self.state.tiles()).step_by(part).map(|first| {
            let mut of_part = [&[][..]; WIDE_KERNELS];
            for (rows, group) in of_part.iter_mut().zip(groups.clone()) {
                *rows = group.get(first * GROUP..).unwrap_or(&[]);
                *rows = rows.get(..part * GROUP).unwrap_or(rows);
            }
            (of_part, take_first(&mut rest, part * LANES))
        });
        share(threads, parts, |(groups, terms)| unit.dispatch(Terms { plan, place, groups, terms }));
        Ok(())
    }

    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        check_channels(self.channels, sample.len())?;
        self.check_capacity()?;
        let place = self.len % self.plan.chunk;
        let (threads, part) = self.shares(self.plan.cost_of_sample(place), are_awake);
        let (plan, unit, samples) = (&self.plan, self.unit, sample.chunks(part * LANES));
        if (place + 1).is_multiple_of(GROUP) {
            let parts = self.state.parts(plan, part).into_iter().zip(samples);
            share(threads, parts, |(part, samples)| unit.dispatch(Due { plan, place, part, samples }));
        } else if let Some(group) = self.state.groups.get_mut(place / GROUP) {
            share(threads, group.chunks_mut(part * GROUP).zip(samples), |(group, samples)| {
                for (rows, samples) in group.chunks_mut(GROUP).zip(samples.chunks(LANES)) {
                    store(rows.get_mut(place % GROUP), samples);
                }
            });
        }
        self.len += 1;
        Ok(())
    }

    fn clear(&mut self) {
        self.len = 0;
        self.state = State::new(&self.plan, self.state.tiles());
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.plan.bytes()
            + self.state.tiles() * LANES * self.channel_bytes()
            + size_of_val(self.state.groups.as_slice())
    }

    fn restore_channels(
        &mut self,
        from: &mut StateReader<'_>,
        channels: SavedChannels,
    ) -> Result<(), StateError> {
        let SavedChannels { of, first, count, to } = channels;
        for (what, begin, limit) in [("channels of the state", first, of), ("channels", to, self.channels)] {
            let end = begin.saturating_add(count);
            if end > limit {
                return Err(StateError::TooLarge { what, limit: limit as u64, found: end as u64 });
            }
        }
        self.check_state_of(of, &mut from.clone())?;
        let len = self.count(of, from)?;
        if self.len > 0 && self.len != len {
            let (expected, found) = (self.len as u64, len as u64);
            return Err(StateError::Mismatch { what: "samples", expected, found });
        }
        self.len = len;
        let (state, sums, slow) = (&mut self.state, self.plan.losses.len(), self.plan.slow);
        for tile in 0..of.div_ceil(LANES) {
            let channels = (of - tile * LANES).min(LANES);
            // Tile and lane of a channel.
            let place = |lane: usize| {
                let taken = (tile * LANES + lane).checked_sub(first).filter(|&channel| channel < count)?;
                Some(((to + taken) / LANES, (to + taken) % LANES))
            };
            for group in &mut state.groups {
                for row in 0..GROUP {
                    for lane in 0..channels {
                        let number = from.number::<P>()?;
                        if let Some((tile, lane)) = place(lane) {
                            group[tile * GROUP + row].0[lane] = number;
                        }
                    }
                }
            }
            for row in 0..sums {
                for lane in 0..channels {
                    let number = from.number::<P>()?;
                    if let Some((tile, lane)) = place(lane) {
                        state.sums[tile * sums + row].0[lane] = number;
                    }
                }
            }
            for row in 0..slow {
                for lane in 0..channels {
                    let number = from.number::<T>()?;
                    if let Some((tile, lane)) = place(lane) {
                        state.rests[tile * slow + row].0[lane] = upper_half(number);
                    }
                }
            }
        }
        Ok(())
    }
}

impl<T: Scalar, P: Scalar> Stateful for WideExponentialSum<T, P> {
    fn state_bytes(&self) -> usize {
        let numbers = (self.plan.places() + self.plan.losses.len()) * P::BYTES + self.plan.slow * T::BYTES;
        header_bytes(4) + self.channels * numbers
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape(self.channels))?;
        to.count(self.len as u64)?;
        let (state, sums, slow) = (&self.state, self.plan.losses.len(), self.plan.slow);
        for tile in 0..state.tiles() {
            let channels = (self.channels - tile * LANES).min(LANES);
            let places = state.groups.iter().flat_map(|group| rows(group, tile, GROUP));
            for row in places.chain(rows(&state.sums, tile, sums)) {
                to.numbers(row.0.iter().take(channels))?;
            }
            for row in rows(&state.rests, tile, slow) {
                to.numbers(row.0.map(of_upper_half::<T>).iter().take(channels))?;
            }
        }
        Ok(())
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state_of(self.channels, from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.len = self.count(self.channels, from)?;
        let (state, sums, slow) = (&mut self.state, self.plan.losses.len(), self.plan.slow);
        for tile in 0..state.tiles() {
            let channels = (self.channels - tile * LANES).min(LANES);
            let places = state.groups.iter_mut().flat_map(|group| rows_mut(group, tile, GROUP));
            for row in places.chain(rows_mut(&mut state.sums, tile, sums)) {
                from.numbers(row.0.iter_mut().take(channels))?;
            }
            for row in rows_mut(&mut state.rests, tile, slow) {
                for half in row.0.iter_mut().take(channels) {
                    *half = upper_half(from.number::<T>()?);
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
