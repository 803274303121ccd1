//! The exponential-sum memory: a short head of weights and a tail of decaying exponentials, the same cost at
//! every step.

use crate::direct::{MAX_STAGES, Overflow};
use crate::error::{ParameterError, check_step_size};
use crate::linear;
use crate::memory::{ActsOn, Memory, MemoryError, check_channels};
use crate::real::{Real, sum_and_rest};
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, fingerprint, header_bytes};
use crate::space::{part_from, vectors, vectors_mut};

/// Kind of the saved state.
const TAG: [u8; 4] = *b"expo";

/// Exponentials per block. Table and state consist of blocks, so that a vector never mixes two kinds of
/// numbers.
const LANES: usize = 4;

/// One number for each exponential of a block.
type Lanes<T> = [T; LANES];

/// A kernel whose weights beyond a head are a sum of decaying exponentials.
///
/// ```text
/// W_n = head[n]                                   for 0 ≤ n < n₀ ,
/// W_n = Σ_{j<J} (1 − μ_j)^{n−n₀} u_j v_jᵀ          for n₀ ≤ n ≤ horizon
/// ```
///
/// For plain numbers (S = 1) u_j is the value of an exponential at n = n₀ and v_j = 1; kernels of S×S
/// matrices have rank-one terms. The table holds μ_j = 1 − R_j and not the factor R_j, which near 1 would
/// lose the digits that determine R_j to the power of many steps.
///
/// This is plain data, so that it can lie in flash; [`check`](ExponentialTable::check) checks it. `C` is
/// anything that holds numbers: `&'static [f32]`, `[f32; 8]`, `Vec<f64>`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExponentialTable<C> {
    /// Number of stages S of the kernel: 1 for plain numbers.
    pub stages: usize,
    /// Weights W₀ … W_{n₀−1}, at least two before exponentials and one without, plane by plane: entry (a, b)
    /// of W_n is `head[(a·S + b)·n₀ + n]`.
    pub head: C,
    /// The exponentials in blocks of four: four μ_j in [0, 2], then for each stage four entries of the u_j,
    /// and for S > 1 for each stage four entries of the v_j. The last block is filled up with zeros. Empty
    /// for a kernel that ends with its head.
    pub exponentials: C,
    /// How many blocks, from the first, hold slow exponentials, whose running sums are kept in two parts.
    ///
    /// A slowly decaying sum (μ_j ≪ 1) would otherwise accumulate the rounding errors of 1/μ_j steps, and in
    /// single precision stay constant once a sample is less than half a unit in its last place. For
    /// differences of a signal that jumps ([`Memory::expect_jumps`]) the two parts are those of the
    /// difference between signal and sum.
    pub slow_blocks: usize,
    /// How many of these, from the first, hold exponentials so slow that their running sums are kept in three
    /// parts; only for plain numbers.
    ///
    /// Of N samples of one size, two parts of single precision lose N 2⁻⁴⁸ at worst, 4·10⁻⁷ for N = 10⁸, and
    /// stand still from N = 2⁴⁹ on. Three parts lose N 2⁻⁷², 10⁻⁷ for N = 2⁴⁹.
    pub far_blocks: usize,
    /// Largest lag at which the weights hold, and number of samples that the memory takes before it refuses
    /// more or forgets ([`ExponentialSum::past_horizon`]). [`ENDLESS`](ExponentialTable::ENDLESS) for weights
    /// that hold for longer than any run.
    pub horizon: u64,
    /// The step size h contained in the weights; 1 for a table that is scaled to any step size.
    pub step_size: f64,
}

/// An exponential of an [`ExponentialTable`]: the part (1 − μ)^{n−n₀} u vᵀ of the weights W_n.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExponentialTerm<T, const S: usize> {
    /// μ
    pub decay: T,
    /// u
    pub output: [T; S],
    /// v; 1 for plain numbers.
    pub input: [T; S],
}

/// Numbers of a block in the table.
const fn block_len(stages: usize) -> usize {
    if stages == 1 { 2 * LANES } else { (1 + 2 * stages) * LANES }
}

/// Numbers of a block in the state: four recent parts, four settled parts.
const STATE_BLOCK: usize = 2 * LANES;

impl<C> ExponentialTable<C> {
    /// The [`horizon`](ExponentialTable::horizon) of a table for a memory that refuses nothing, however many
    /// samples there are.
    pub const ENDLESS: u64 = u64::MAX;

    /// The same table, borrowed.
    #[inline(always)]
    pub fn borrow<T>(&self) -> ExponentialTable<&[T]>
    where
        C: AsRef<[T]>,
    {
        ExponentialTable {
            stages: self.stages,
            head: self.head.as_ref(),
            exponentials: self.exponentials.as_ref(),
            slow_blocks: self.slow_blocks,
            far_blocks: self.far_blocks,
            horizon: self.horizon,
            step_size: self.step_size,
        }
    }
}

impl<T: Real> ExponentialTable<&[T]> {
    /// Checks everything about the table that does not depend on the number of channels.
    ///
    /// # Errors
    /// If the shapes do not fit together, S is not one of 1…4, a number is not finite, a μ_j is outside
    /// [0, 2], or the step size is not positive.
    pub fn check(&self) -> Result<(), ParameterError> {
        let count = |parameter, value: usize, accepted, allowed| {
            ParameterError::check(accepted, parameter, value as f64, allowed)
        };
        count("stages", self.stages, (1..=MAX_STAGES).contains(&self.stages), "one of 1, 2, 3, 4")?;
        let planes = self.stages * self.stages;
        let least = if self.exponentials.is_empty() { planes } else { 2 * planes };
        count(
            "head weights",
            self.head.len(),
            self.head.len() >= least && self.head.len().is_multiple_of(planes),
            "a multiple of the squared stages, at least one of each and two before exponentials",
        )?;
        let block = block_len(self.stages);
        count(
            "numbers of exponentials",
            self.exponentials.len(),
            self.exponentials.len().is_multiple_of(block),
            "a multiple of 8 for one stage, of 4 + 8 stages for more",
        )?;
        let blocks = self.exponentials.len() / block;
        count("slow blocks", self.slow_blocks, self.slow_blocks <= blocks, "at most the number of blocks")?;
        count(
            "far blocks",
            self.far_blocks,
            self.far_blocks <= if self.stages == 1 { self.slow_blocks } else { 0 },
            "at most the number of slow blocks, and none with several stages",
        )?;
        check_step_size(self.step_size)?;
        for (parameter, numbers) in [("head weight", self.head), ("exponential", self.exponentials)] {
            if let Some(number) = numbers.iter().copied().find(|number| !number.is_finite()) {
                return Err(ParameterError { parameter, value: number.to_f64(), allowed: "finite" });
            }
        }
        let mut decays = vectors(self.exponentials, block).flat_map(|block| block.iter().take(LANES));
        match decays.find(|&&decay| decay < T::zero() || decay > T::of(2.0)) {
            Some(decay) => {
                let allowed = "at least 0 and at most 2";
                Err(ParameterError { parameter: "decay", value: decay.to_f64(), allowed })
            }
            None => Ok(()),
        }
    }

    /// The exponentials one by one, without those that fill up the last block; none if S is not the number of
    /// stages.
    pub fn terms<const S: usize>(&self) -> impl Iterator<Item = ExponentialTerm<T, S>> {
        let exponentials = if S == self.stages { self.exponentials } else { &[] };
        let blocks = vectors(exponentials, block_len(S));
        let terms = blocks.flat_map(|block| {
            (0..LANES).map(move |lane| {
                let entry = |row: usize| linear::at(block, row * LANES + lane);
                ExponentialTerm {
                    decay: entry(0),
                    output: core::array::from_fn(|a| entry(1 + a)),
                    input: core::array::from_fn(|b| if S == 1 { T::one() } else { entry(1 + S + b) }),
                }
            })
        });
        terms.filter(|term| term.output.iter().any(|&number| number != T::zero()))
    }
}

impl<T> ExponentialTable<&[T]> {
    /// Length of the state that [`ExponentialSum`] needs for this table and `channels` channels.
    ///
    /// 2J C/S + (2n₀ − 1) C + S² with J in whole blocks of four, and 4C for each far block: running sums in
    /// two parts or three, pending terms and delayed samples, the term, the leading weight. A `const fn`, to
    /// be the length of an array.
    pub const fn state_len(&self, channels: usize) -> usize {
        let planes = self.stages.saturating_mul(self.stages);
        if planes == 0 || self.stages == 0 {
            return 0;
        }
        let head = self.head.len() / planes;
        let blocks = self.exponentials.len() / block_len(self.stages);
        let per_channel = head.saturating_add(head.saturating_sub(2)).saturating_add(1);
        planes
            .saturating_add(per_channel.saturating_mul(channels))
            .saturating_add(blocks.saturating_mul(STATE_BLOCK).saturating_mul(channels / self.stages))
            .saturating_add(self.far_blocks.saturating_mul(LANES).saturating_mul(channels / self.stages))
    }
}

/// The exponential-sum memory: r_k = Σ_{n=1}^{k} W_n x_{k−n} for the kernel of an [`ExponentialTable`].
///
/// ```text
/// r_k = Σ_{n=1}^{n₀−1} W_n x_{k−n} + Σ_j u_j z_j ,      z_j ← z_j + (v_jᵀ x_{k+1−n₀} − μ_j z_j)
/// ```
///
/// Cost and worst step: n₀ + 2J multiply–adds per channel (S = 1), whatever the length of the run. A new
/// sample goes into every pending sum of the head and, n₀ steps later, into every z_j, with accumulators in
/// fixed places: the result has the same bits whatever the width of the vectors that the compiler uses. The
/// table may be shared; the state `B` is the caller's: an array, a mutable slice, or a `Vec`, of
/// [`ExponentialTable::state_len`] numbers.
///
/// The kernel is `scale` times that of the table, so that one dimensionless table, made for h = 1, serves
/// every step size with `scale` = h^{−β}. A table whose weights hold another step size takes no scale but 1.
/// [`Kernel::exponential_sum`](crate::Kernel::exponential_sum) finds the scale itself, and refuses the table
/// of another kernel.
///
/// Source: collapsed contour of \[HJO\] eq. 19; recursion as in \[SchädleLFLubich06\].
///
/// ```
/// # use fvi_core::{ExponentialSum, ExponentialTable, Memory};
/// // w = 2, 1, 1/2, 1/4, …: one exponential after a head of two weights.
/// const TABLE: ExponentialTable<&[f32]> = ExponentialTable {
///     stages: 1,
///     head: &[2.0, 1.0],
///     exponentials: &[0.5, 0.0, 0.0, 0.0, /* μ */ 0.5, 0.0, 0.0, 0.0 /* u */],
///     slow_blocks: 0,
///     far_blocks: 0,
///     horizon: 1_000_000,
///     step_size: 1.0,
/// };
/// let mut memory = ExponentialSum::new(TABLE, 1.0, 1, [0.0; TABLE.state_len(1)])?;
/// let mut term = [0.0];
/// for sample in [8.0, 0.0, 4.0] {
///     memory.push(&[sample])?;
/// }
/// memory.next_term(&mut term)?;
/// assert_eq!(term, [8.0 / 4.0 + 4.0]);
/// # Ok::<(), Box<dyn core::error::Error>>(())
/// ```
pub type ExponentialSum<T, C, B> = TabulatedSum<T, Given<T, C>, B>;

/// The memory of an [`ExponentialSum`] whose kernel is a value K: a table with its scale that the memory was
/// given, or constants that were generated and checked before ([`GeneratedSum`](crate::GeneratedSum)).
#[derive(Clone, Debug)]
pub struct TabulatedSum<T, K, B> {
    kernel: K,
    state: B,
    /// Place of the oldest delayed sample.
    oldest: usize,
    /// Index of the slow block that settles at the next step.
    settling: usize,
    /// Samples so far; see [`advance`](TabulatedSum::advance).
    len: u64,
    /// The sum of the samples that have reached the exponentials, in two parts, for slow sums of a signal
    /// that jumps.
    signal: [T; 2],
}

/// Where a [`TabulatedSum`] has its kernel from.
pub trait TableSource<T> {
    /// The table.
    fn table(&self) -> ExponentialTable<&[T]>;

    /// Factor from the weights of the table to those of the kernel.
    fn scale(&self) -> T;

    /// Layout of the state.
    fn layout(&self) -> Layout;

    /// Kind of samples.
    fn acts_on(&self) -> ActsOn;

    /// True if the memory goes on past the horizon of the table.
    fn forgets(&self) -> bool;

    /// True if it takes another sample after `len` of them.
    fn has_room(&self, len: u64) -> bool;

    /// True if samples are differences of a signal that jumps: then slow sums are stored as their difference
    /// from the signal.
    fn jumps(&self) -> bool;

    /// States that samples are differences of a signal that jumps, if they are differences.
    fn expect_jumps(&mut self);
}

/// A table that an [`ExponentialSum`] was given.
#[derive(Clone, Debug)]
pub struct Given<T, C> {
    table: ExponentialTable<C>,
    scale: T,
    layout: Layout,
    acts_on: ActsOn,
    forgets: bool,
    jumps: bool,
}

impl<T: Real, C: AsRef<[T]>> TableSource<T> for Given<T, C> {
    #[inline(always)]
    fn table(&self) -> ExponentialTable<&[T]> {
        self.table.borrow()
    }

    #[inline(always)]
    fn scale(&self) -> T {
        self.scale
    }

    #[inline(always)]
    fn layout(&self) -> Layout {
        self.layout
    }

    #[inline(always)]
    fn acts_on(&self) -> ActsOn {
        self.acts_on
    }

    #[inline(always)]
    fn forgets(&self) -> bool {
        self.forgets
    }

    #[inline(always)]
    fn has_room(&self, len: u64) -> bool {
        len < self.table.horizon || self.forgets
    }

    #[inline(always)]
    fn jumps(&self) -> bool {
        self.jumps
    }

    fn expect_jumps(&mut self) {
        self.jumps = self.layout.of_one_number() && self.acts_on == ActsOn::Increments;
    }
}

impl<T, C, B> ExponentialSum<T, C, B>
where
    T: Real,
    C: AsRef<[T]>,
    B: AsRef<[T]> + AsMut<[T]>,
{
    /// A memory for the kernel scale·W_n on `channels` channels, without samples.
    ///
    /// # Errors
    /// If [`ExponentialTable::check`] refuses the table, the scale is not finite, or not 1 where the weights
    /// hold a step size; if the number of channels is not a positive multiple of S, or the state has another
    /// length than [`ExponentialTable::state_len`].
    pub fn new(
        table: ExponentialTable<C>,
        scale: T,
        channels: usize,
        state: B,
    ) -> Result<Self, ParameterError> {
        let view = table.borrow();
        view.check()?;
        ParameterError::check(
            channels > 0 && channels.is_multiple_of(view.stages),
            "channels",
            channels as f64,
            "a positive multiple of the stages",
        )?;
        let length = state.as_ref().len();
        ParameterError::check(
            length == view.state_len(channels),
            "state length",
            length as f64,
            "the table's state_len",
        )?;
        ParameterError::check(scale.is_finite(), "scale", scale.to_f64(), "finite")?;
        ParameterError::check(
            scale == T::one() || view.step_size == 1.0,
            "scale",
            scale.to_f64(),
            "1 for a table whose weights hold the step size",
        )?;
        let layout = Layout::of(&view, channels);
        let kernel = Given { table, scale, layout, acts_on: ActsOn::Values, forgets: false, jumps: false };
        Ok(Self::with_kernel(kernel, state))
    }

    /// The same memory, with weights for samples of the given kind.
    pub fn acting_on(self, acts_on: ActsOn) -> Self {
        Self { kernel: Given { acts_on, ..self.kernel }, ..self }
    }

    /// The same memory, with the policy for samples beyond the table's horizon: it refuses them, as a new
    /// memory does, or goes on and forgets.
    ///
    /// Beyond the horizon H the exponentials decay where the weights of the operator fall slowly, so that the
    /// term lacks at most max|x| Σ_{n>H} (|w_n| + |Σ_j (1 − μ_j)^{n−n₀} u_j|) at any time: for derivatives a
    /// few times what a ring of H samples leaves out, (H h)^{−β} / Γ(1 − β). The integral of order λ of a
    /// constant signal levels off at about (H h)^λ.
    ///
    /// # Errors
    /// For [`Overflow::Forget`], if an exponential of the table never decays: its sum would grow without
    /// bound.
    pub fn past_horizon(self, overflow: Overflow) -> Result<Self, ParameterError> {
        let table = self.kernel.table();
        let forgets = overflow == Overflow::Forget;
        let stays = vectors(table.exponentials, block_len(table.stages)).any(|block| {
            let (decays, others) = block.split_at_checked(LANES).unwrap_or_default();
            decays.iter().enumerate().any(|(lane, &decay)| {
                let mut outputs = others.iter().skip(lane).step_by(LANES);
                decay == T::zero() && outputs.any(|&number| number != T::zero())
            })
        });
        ParameterError::check(
            !(forgets && stays),
            "decay",
            0.0,
            "greater than 0 in a table that forgets: make it with a longer horizon, or endless",
        )?;
        Ok(Self { kernel: Given { forgets, ..self.kernel }, ..self })
    }

    /// The table.
    pub fn table(&self) -> &ExponentialTable<C> {
        &self.kernel.table
    }

    /// Factor from the weights of the table to those of the kernel.
    pub fn scale(&self) -> T {
        self.kernel.scale
    }
}

impl<T, K, B> TabulatedSum<T, K, B>
where
    T: Real,
    K: TableSource<T>,
    B: AsRef<[T]> + AsMut<[T]>,
{
    /// A memory without samples; the state has the length that the table needs.
    #[inline(always)]
    pub(crate) fn with_kernel(kernel: K, state: B) -> Self {
        let mut memory = Self { kernel, state, oldest: 0, settling: 0, len: 0, signal: [T::zero(); 2] };
        memory.clear();
        memory
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<4> {
        let kernel = &self.kernel;
        shape_of(&kernel.table(), kernel.scale(), kernel.layout().channels(), kernel.jumps())
    }

    /// Reads the number of samples in a saved state, checks the numbers and reads past them.
    #[inline(never)]
    fn checked(&self, from: &mut StateReader<'_>) -> Result<u64, StateError> {
        from.header::<T, 4>(TAG, &self.shape())?;
        let (found, limit) = (from.count()?, self.capacity().min(ENDLESS - 1));
        if found > limit {
            return Err(StateError::TooLarge { what: "samples", limit, found });
        }
        from.skip::<T>(self.changing() + self.saved_signal().len())?;
        Ok(found)
    }

    #[inline(always)]
    fn check_capacity(&self) -> Result<(), MemoryError> {
        if self.kernel.has_room(self.len) { Ok(()) } else { Err(full(self.kernel.table().horizon)) }
    }

    /// The part of the signal that is saved: both parts if the signal jumps, otherwise none.
    fn saved_signal(&self) -> &[T] {
        if self.kernel.jumps() { &self.signal } else { &[] }
    }

    /// Numbers of the state that samples change: all but the leading weight.
    fn changing(&self) -> usize {
        self.state.as_ref().len().saturating_sub(self.kernel.layout().planes())
    }

    /// Number of samples that the memory takes.
    fn capacity(&self) -> u64 {
        if self.kernel.forgets() { ENDLESS } else { self.kernel.table().horizon }
    }

    /// Counts a sample. Before the count overflows it is reduced by a multiple of both ring lengths, which
    /// leaves `oldest` and `settling` unchanged.
    #[inline(always)]
    fn advance(&mut self) {
        self.oldest =
            if self.oldest < self.kernel.layout().head.saturating_sub(3) { self.oldest + 1 } else { 0 };
        self.settling =
            if self.settling + 1 < self.kernel.table().slow_blocks { self.settling + 1 } else { 0 };
        self.len = self.len.wrapping_add(1);
        if self.len == ENDLESS {
            self.go_back();
        }
    }

    #[cold]
    #[inline(never)]
    fn go_back(&mut self) {
        let rings = (self.delayed_samples() as u64).saturating_mul(self.settling_blocks() as u64);
        self.len = self.len.saturating_sub(rings);
    }

    /// Length of the ring of delayed samples, at least 1.
    fn delayed_samples(&self) -> usize {
        self.kernel.layout().head.saturating_sub(2).max(1)
    }

    /// Number of blocks that settle in turn, at least 1.
    fn settling_blocks(&self) -> usize {
        self.kernel.table().slow_blocks.max(1)
    }
}

/// Capacity of a memory without a horizon.
const ENDLESS: u64 = ExponentialTable::<()>::ENDLESS;

#[cold]
fn full(capacity: u64) -> MemoryError {
    MemoryError::Full { capacity: saturated(capacity) }
}

/// Header of the state of a sum with this table; compiled once for all tables of a precision.
#[inline(never)]
fn shape_of<T: Real>(table: &ExponentialTable<&[T]>, scale: T, channels: usize, jumps: bool) -> Shape<4> {
    let blocks = table.slow_blocks as u64 | (table.far_blocks as u64) << 32 | u64::from(jumps) << 63;
    let kernel = fingerprint(table.head.iter().chain(table.exponentials)) ^ scale.bits();
    [
        ("channels", channels as u64),
        ("stages", table.stages as u64),
        ("slow blocks, far ones above, and whether samples jump", blocks),
        ("fingerprint of the kernel", kernel),
    ]
}

/// `count` modulo `length`, which is not 0: bit by bit, since a processor of 32 bits needs 600 bytes of code
/// to divide 64.
fn remainder(count: u64, length: usize) -> usize {
    (0..u64::BITS).rev().fold(0, |rest, bit| {
        let twice = 2 * rest + (count >> bit & 1) as usize;
        if twice < length { twice } else { twice - length }
    })
}

/// `count`, or the largest `usize` if it does not fit.
fn saturated(count: u64) -> usize {
    usize::try_from(count).unwrap_or(usize::MAX)
}

/// Layout of the parts of the state, one after another. The running sums come first and are aligned if the
/// state is. Third parts of sums, which few tables have, come last except for the leading weight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    stages: usize,
    /// Channels over stages.
    coordinates: usize,
    /// n₀.
    head: usize,
    /// Blocks of exponentials.
    blocks: usize,
}

impl Layout {
    /// Layout for a table and a number of channels that [`ExponentialSum::new`] has checked.
    pub(crate) const fn of<T>(table: &ExponentialTable<&[T]>, channels: usize) -> Self {
        let stages = if table.stages == 0 { 1 } else { table.stages };
        let planes = match stages.saturating_mul(stages) {
            0 => 1,
            planes => planes,
        };
        Self {
            stages,
            coordinates: channels / stages,
            head: table.head.len() / planes,
            blocks: table.exponentials.len() / block_len(stages),
        }
    }

    /// True if the samples are plain numbers of one channel.
    #[inline(always)]
    pub(crate) fn of_one_number(self) -> bool {
        self.stages == 1 && self.channels() == 1
    }

    #[inline(always)]
    fn channels(self) -> usize {
        self.coordinates * self.stages
    }

    /// S²
    #[inline(always)]
    fn planes(self) -> usize {
        self.stages * self.stages
    }

    #[inline(always)]
    fn sums(self) -> usize {
        self.coordinates * self.blocks * STATE_BLOCK
    }

    #[inline(always)]
    fn pending(self) -> usize {
        self.channels() * self.head
    }

    #[inline(always)]
    fn delayed(self) -> usize {
        self.channels() * self.head.saturating_sub(2)
    }

    /// Where the term begins.
    #[inline(always)]
    fn term_start(self) -> usize {
        self.sums() + self.pending() + self.delayed()
    }

    /// The parts of the state; `None` if it is too short, which the constructor excludes.
    #[inline(always)]
    fn split<T>(self, state: &mut [T]) -> Option<Parts<'_, T>> {
        let (sums, state) = state.split_at_mut_checked(self.sums())?;
        let (pending, state) = state.split_at_mut_checked(self.pending())?;
        let (delayed, state) = state.split_at_mut_checked(self.delayed())?;
        let (term, state) = state.split_at_mut_checked(self.channels())?;
        let (third, leading) = state.split_at_mut_checked(state.len().saturating_sub(self.planes()))?;
        Some(Parts { sums, pending, delayed, term, third, leading })
    }
}

/// The parts of the state.
struct Parts<'a, T> {
    /// Blocks of the z_j of every coordinate.
    sums: &'a mut [T],
    /// For every channel, what the samples so far add to the head of the next n₀ − 1 terms, then a zero.
    pending: &'a mut [T],
    /// The last n₀ − 2 samples, as a ring of samples.
    delayed: &'a mut [T],
    /// r_k of every channel.
    term: &'a mut [T],
    /// The third parts of the sums of every coordinate.
    third: &'a mut [T],
    /// The leading weight, scaled.
    leading: &'a mut [T],
}

/// Splits off the first `count` numbers, if there are as many.
#[inline(always)]
fn split_off<'a, T>(rest: &mut &'a mut [T], count: usize) -> Option<&'a mut [T]> {
    let (first, behind) = core::mem::take(rest).split_at_mut_checked(count)?;
    *rest = behind;
    Some(first)
}

#[inline(always)]
fn lanes<T: Real>(number: impl Fn(usize) -> T) -> Lanes<T> {
    let mut lanes = [T::zero(); LANES];
    for (lane, place) in lanes.iter_mut().enumerate() {
        *place = number(lane);
    }
    lanes
}

/// Number `lane` of a block. The remainder lets the compiler see that the index is in range.
#[inline(always)]
fn at<T: Real>(numbers: &Lanes<T>, lane: usize) -> T {
    numbers[lane % LANES]
}

/// The sum of four parts.
#[inline(always)]
fn total<T: Real>([a, b, c, d]: Lanes<T>) -> T {
    (a + c) + (b + d)
}

/// Passes of a loop that the compiler does not unroll.
#[inline(always)]
fn rolled<I: Iterator>(passes: I) -> impl Iterator<Item = I::Item> {
    passes.inspect(|_| core::hint::black_box(()))
}

/// Blocks of a table whose numbers the compiler does not know: of those that it knows it would put a second
/// copy into the program.
#[inline(always)]
fn in_place<T>(blocks: &[[T; STATE_BLOCK]]) -> &[[T; STATE_BLOCK]] {
    core::hint::black_box(blocks)
}

/// pending[i] ← pending[i+1] + weights[i] x: the next term moves to the front, and the sample joins those to
/// come.
///
/// Four at a time are read before they are written: then the compiler needs no proof that the slices are
/// apart to use vectors.
#[inline(always)]
fn shift_and_add<T: Real>(mut pending: &mut [T], weights: &[T], x: T) {
    let (blocks, rest) = weights.as_chunks::<LANES>();
    for weights in blocks {
        let Some(next) = pending.get(1..).and_then(|next| next.first_chunk::<LANES>()) else { return };
        let moved = lanes(|lane| at(next, lane) + at(weights, lane) * x);
        let Some((here, behind)) = pending.split_first_chunk_mut::<LANES>() else { return };
        *here = moved;
        pending = behind;
        // Otherwise the compiler would process several blocks at a time and check at every step that no
        // slices overlap, which costs more than the step.
        core::hint::black_box(());
    }
    // At most three, one by one: a vectorised loop would cost more.
    let mut rest = rest.iter();
    for _ in 1..LANES {
        let (Some(&weight), Some(&next)) = (rest.next(), pending.get(1)) else { return };
        let Some((here, behind)) = pending.split_first_mut() else { return };
        *here = next + weight * x;
        pending = behind;
    }
}

/// Adds a difference to the signal, kept in two parts: the first is the rounded signal.
#[inline(always)]
fn add_difference<T: Real>(signal: &mut [T; 2], x: T) {
    let (sum, lost) = sum_and_rest(signal[0], x);
    let rest = lost + signal[1];
    // A few units in the last place of the sum, which is the larger of the two.
    signal[0] = sum + rest;
    signal[1] = rest - (signal[0] - sum);
}

/// y ← y + μ z with z = X − y for a block of slow exponentials and the signal X whose differences they take,
/// y = settled + recent; adds the z before to the totals. `signal` is X, less the third part of y if there is
/// one.
#[inline(always)]
fn follow<T: Real>(
    sums: &mut [T; STATE_BLOCK],
    block: &[T; STATE_BLOCK],
    signal: impl Fn(usize) -> T,
    totals: &mut Lanes<T>,
) {
    let [decay, coefficient] = halves(*block);
    let [recent, settled] = halves(*sums);
    let before = lanes(|lane| (signal(lane) - at(&settled, lane)) - at(&recent, lane));
    let changed = lanes(|lane| at(&recent, lane) + at(&decay, lane) * at(&before, lane));
    if let Some(recent) = sums.first_chunk_mut::<LANES>() {
        *recent = changed;
    }
    *totals = lanes(|lane| at(totals, lane) + at(&coefficient, lane) * at(&before, lane));
}

/// z ← z + (x − μ z) for a block of exponentials, z = recent + settled; returns the z before.
///
/// Small changes meet the small recent part. That of a slow exponential is emptied into the settled part now
/// and then by [`settle`]; a fast one has no settled part.
#[inline(always)]
fn absorb<T: Real>(sums: &mut [T; STATE_BLOCK], decay: &Lanes<T>, x: Lanes<T>) -> Lanes<T> {
    let [recent, settled] = halves(*sums);
    let before = lanes(|lane| at(&settled, lane) + at(&recent, lane));
    let changed = lanes(|lane| at(&recent, lane) + (at(&x, lane) - at(decay, lane) * at(&before, lane)));
    if let Some(recent) = sums.first_chunk_mut::<LANES>() {
        *recent = changed;
    }
    before
}

#[inline(always)]
fn absorb_number<T: Real>(
    sums: &mut [T; STATE_BLOCK],
    block: &[T; STATE_BLOCK],
    x: T,
    totals: &mut Lanes<T>,
) {
    let [decay, coefficient] = halves(*block);
    let before = absorb(sums, &decay, [x; LANES]);
    *totals = lanes(|lane| at(totals, lane) + at(&coefficient, lane) * at(&before, lane));
}

/// Values shared by the steps of all channels.
struct NumberStep<'a, T> {
    /// w₁ … w_{n₀−1}.
    weights: &'a [T],
    exponentials: &'a [[T; STATE_BLOCK]],
    scale: T,
    /// Index of the block that settles at this step.
    settling: Option<usize>,
}

impl<'a, T: Real> NumberStep<'a, T> {
    #[inline(always)]
    fn new(table: &ExponentialTable<&'a [T]>, layout: Layout, scale: T, settling: usize) -> Option<Self> {
        Some(Self {
            weights: table.head.get(1..layout.head)?,
            exponentials: table.exponentials.as_chunks::<STATE_BLOCK>().0,
            scale,
            settling: Some(settling).filter(|&settling| settling < table.slow_blocks),
        })
    }

    /// The step of one channel: takes the sample x and returns the next term.
    #[inline(always)]
    fn take(&self, x: T, sums: &mut [T], pending: &mut [T], delayed: Option<&mut T>) -> T {
        let leaving = match delayed {
            Some(place) => core::mem::replace(place, x),
            None => x,
        };
        shift_and_add(pending, self.weights, x);
        let head = linear::at(pending, 0);
        let sums = sums.as_chunks_mut::<STATE_BLOCK>().0;
        let mut totals = [head, T::zero(), T::zero(), T::zero()];
        let (pairs, last) = self.exponentials.as_chunks::<2>();
        let (sums_of_pairs, sums_of_last) = sums.as_chunks_mut::<2>();
        for ([first, second], [sums, more_sums]) in pairs.iter().zip(sums_of_pairs) {
            absorb_number(sums, first, leaving, &mut totals);
            absorb_number(more_sums, second, leaving, &mut totals);
        }
        for (block, sums) in last.iter().zip(sums_of_last) {
            absorb_number(sums, block, leaving, &mut totals);
        }
        if let Some(sums) = self.settling.and_then(|settling| sums.get_mut(settling)) {
            settle(sums);
        }
        // The totals go through memory: otherwise their pairwise sum determines how the compiler vectorises
        // the loop above.
        total(core::hint::black_box(totals)) * self.scale
    }

    /// As [`take`](Self::take), for tables whose first blocks have third parts.
    fn take_with_third_parts(
        &self,
        x: T,
        (sums, third): (&mut [T], &mut [T]),
        pending: &mut [T],
        delayed: Option<&mut T>,
    ) -> Option<T> {
        let leaving = match delayed {
            Some(place) => core::mem::replace(place, x),
            None => x,
        };
        shift_and_add(pending, self.weights, x);
        let head = linear::at(pending, 0);
        let mut totals = [head, T::zero(), T::zero(), T::zero()];
        let sums = sums.as_chunks_mut::<STATE_BLOCK>().0;
        let third = third.as_chunks_mut::<LANES>().0;
        let (far, others) = in_place(self.exponentials).split_at_checked(third.len())?;
        let (far_sums, other_sums) = sums.split_at_mut_checked(third.len())?;
        for ((block, sums), &third) in rolled(far.iter().zip(far_sums).zip(third.iter())) {
            let [decay, coefficient] = halves(*block);
            let [recent, settled] = halves(*sums);
            let before = lanes(|lane| (at(&third, lane) + at(&settled, lane)) + at(&recent, lane));
            let changed = lanes(|lane| at(&recent, lane) + (leaving - at(&decay, lane) * at(&before, lane)));
            *sums = lanes_of_both(changed, settled);
            totals = lanes(|lane| at(&totals, lane) + at(&coefficient, lane) * at(&before, lane));
        }
        for (block, sums) in rolled(others.iter().zip(other_sums)) {
            absorb_number(sums, block, leaving, &mut totals);
        }
        if let Some(settling) = self.settling {
            settle_any(sums, third, settling);
        }
        Some(total(totals) * self.scale)
    }
}

/// Settles a block of slow sums, of which the first have third parts. Out of line: once for all tables.
#[inline(never)]
fn settle_any<T: Real>(sums: &mut [[T; STATE_BLOCK]], third: &mut [Lanes<T>], block: usize) {
    match (sums.get_mut(block), third.get_mut(block)) {
        (Some(sums), Some(third)) => settle_far(sums, third),
        (Some(sums), None) => settle(sums),
        (None, _) => {}
    }
}

/// Moves the recent parts of a block into the settled ones and these into the third; what rounding takes away
/// stays, to the bit.
#[inline(always)]
fn settle_far<T: Real>(sums: &mut [T; STATE_BLOCK], third: &mut Lanes<T>) {
    let [mut recent, mut settled] = halves(*sums);
    let parts = recent.iter_mut().zip(&mut settled).zip(third);
    for ((recent, settled), third) in parts {
        let (moved, rest) = sum_and_rest(*settled, *recent);
        *recent = rest;
        (*third, *settled) = sum_and_rest(*third, moved);
    }
    *sums = lanes_of_both(recent, settled);
}

/// Moves the recent parts of a block into the settled ones; what rounding takes away stays recent.
#[inline(always)]
fn settle<T: Real>(sums: &mut [T; STATE_BLOCK]) {
    let [recent, settled] = halves(*sums);
    let moved = lanes(|lane| at(&settled, lane) + at(&recent, lane));
    let rest = lanes(|lane| at(&recent, lane) - (at(&moved, lane) - at(&settled, lane)));
    *sums = lanes_of_both(rest, moved);
}

#[inline(always)]
fn halves<T: Real>([a, b, c, d, e, f, g, h]: [T; STATE_BLOCK]) -> [Lanes<T>; 2] {
    [[a, b, c, d], [e, f, g, h]]
}

#[inline(always)]
fn lanes_of_both<T: Real>([a, b, c, d]: Lanes<T>, [e, f, g, h]: Lanes<T>) -> [T; STATE_BLOCK] {
    [a, b, c, d, e, f, g, h]
}

impl<T, K, B> TabulatedSum<T, K, B>
where
    T: Real,
    K: TableSource<T>,
    B: AsRef<[T]> + AsMut<[T]>,
{
    /// The step for differences of a signal that jumps. Out of line, so that schemes do not pay for it.
    ///
    /// With the sum X of the samples that have reached the exponentials, a running sum is z = X − y, where
    ///
    /// ```text
    /// y ← y + μ (X − y) ,        X ← X + x :
    /// ```
    ///
    /// For a slow exponential the changes of y are small, whereas those of z, x − μ z, lose the decay below
    /// the last digit of x. X is one number for all exponentials, summed without rounding errors.
    #[inline(never)]
    fn push_difference(&mut self, x: T) -> Option<()> {
        let layout = Layout { stages: 1, coordinates: 1, ..self.kernel.layout() };
        let table = self.kernel.table();
        let parts = layout.split(self.state.as_mut())?;
        let step = NumberStep::new(&table, layout, self.kernel.scale(), self.settling)?;
        let leaving = match parts.delayed.get_mut(self.oldest) {
            Some(place) => core::mem::replace(place, x),
            None => x,
        };
        shift_and_add(parts.pending, step.weights, x);
        let head = linear::at(parts.pending, 0);
        let mut totals = [head, T::zero(), T::zero(), T::zero()];
        let sums = parts.sums.as_chunks_mut::<STATE_BLOCK>().0;
        let third = parts.third.as_chunks_mut::<LANES>().0;
        let [signal, _] = self.signal;
        let (slow, fast) = in_place(step.exponentials).split_at_checked(table.slow_blocks)?;
        let (far, slow) = slow.split_at_checked(third.len())?;
        let (slow_sums, fast_sums) = sums.split_at_mut_checked(table.slow_blocks)?;
        let (far_sums, other_sums) = slow_sums.split_at_mut_checked(third.len())?;
        for ((block, sums), third) in rolled(far.iter().zip(far_sums).zip(third.iter())) {
            follow(sums, block, |lane| signal - at(third, lane), &mut totals);
        }
        for (block, sums) in rolled(slow.iter().zip(other_sums)) {
            follow(sums, block, |_| signal, &mut totals);
        }
        for (block, sums) in rolled(fast.iter().zip(fast_sums)) {
            absorb_number(sums, block, leaving, &mut totals);
        }
        add_difference(&mut self.signal, leaving);
        settle_any(slow_sums, third, self.settling);
        *parts.term.first_mut()? = total(totals) * self.kernel.scale();
        Some(())
    }

    /// The step for plain numbers in one channel, without a loop and its set-up.
    #[inline(always)]
    fn push_number(&mut self, x: T) -> Option<()> {
        let layout = Layout { stages: 1, coordinates: 1, ..self.kernel.layout() };
        let table = self.kernel.table();
        let parts = layout.split(self.state.as_mut())?;
        let step = NumberStep::new(&table, layout, self.kernel.scale(), self.settling)?;
        if step.weights.is_empty() {
            // A single weight: nothing of a sample is left.
            return Some(());
        }
        let term = parts.term.first_mut()?;
        *term = step.take(x, parts.sums, parts.pending, parts.delayed.get_mut(self.oldest));
        Some(())
    }

    /// The step for plain numbers. It returns early only if the state has another shape than the constructor
    /// found.
    #[inline(always)]
    fn push_numbers(&mut self, sample: &[T]) -> Option<()> {
        let layout = Layout { stages: 1, ..self.kernel.layout() };
        let table = self.kernel.table();
        let parts = layout.split(self.state.as_mut())?;
        let step = NumberStep::new(&table, layout, self.kernel.scale(), self.settling)?;
        let (mut sums, mut pending) = (parts.sums, parts.pending);
        let mut delayed = parts.delayed.get_mut(self.oldest * layout.coordinates..)?.iter_mut();
        for (&x, term) in sample.iter().zip(parts.term) {
            let sums = split_off(&mut sums, layout.blocks * STATE_BLOCK)?;
            *term = step.take(x, sums, split_off(&mut pending, layout.head)?, delayed.next());
        }
        Some(())
    }

    /// The step for plain numbers where sums have third parts. Out of line: other tables do not pay for it.
    #[inline(never)]
    fn push_numbers_with_third_parts(&mut self, sample: &[T]) -> Option<()> {
        let layout = Layout { stages: 1, ..self.kernel.layout() };
        let table = self.kernel.table();
        let parts = layout.split(self.state.as_mut())?;
        let step = NumberStep::new(&table, layout, self.kernel.scale(), self.settling)?;
        let (mut sums, mut third, mut pending) = (parts.sums, parts.third, parts.pending);
        let mut delayed = parts.delayed.get_mut(self.oldest * layout.coordinates..)?.iter_mut();
        for (&x, term) in sample.iter().zip(parts.term) {
            let sums = split_off(&mut sums, layout.blocks * STATE_BLOCK)?;
            let third = split_off(&mut third, table.far_blocks * LANES)?;
            let pending = split_off(&mut pending, layout.head)?;
            *term = step.take_with_third_parts(x, (sums, third), pending, delayed.next())?;
        }
        Some(())
    }

    /// The step for S×S matrices. Out of line: it would burden the registers of the step for plain numbers.
    #[inline(never)]
    fn push_stages(&mut self, sample: &[T]) -> Option<()> {
        let layout = self.kernel.layout();
        let Layout { head, blocks, .. } = layout;
        let stages = layout.stages.max(1);
        let table = self.kernel.table();
        let parts = layout.split(self.state.as_mut())?;
        let (mut pending, mut sums) = (parts.pending, parts.sums.as_chunks_mut::<STATE_BLOCK>().0);
        let mut delayed = parts.delayed.get_mut(self.oldest * layout.channels()..)?;
        for (sample, terms) in vectors(sample, stages).zip(vectors_mut(parts.term, stages)) {
            let mut planes = vectors(table.head, head);
            let mut totals = [[T::zero(); LANES]; MAX_STAGES];
            let totals = totals.get_mut(..stages)?;
            for totals in totals.iter_mut() {
                let pending = split_off(&mut pending, head)?;
                for (b, &x) in sample.iter().enumerate() {
                    let weights = planes.next()?.get(1..)?;
                    if b == 0 {
                        shift_and_add(pending, weights, x);
                    } else {
                        pending.iter_mut().zip(weights).for_each(|(here, &weight)| *here += weight * x);
                    }
                }
                *totals = [linear::at(pending, 0), T::zero(), T::zero(), T::zero()];
            }
            let mut leaving = [T::zero(); MAX_STAGES];
            let leaving = leaving.get_mut(..stages)?;
            leaving.iter_mut().zip(sample).for_each(|(leaving, &x)| *leaving = x);
            if let Some(places) = split_off(&mut delayed, stages) {
                for (place, leaving) in places.iter_mut().zip(&mut *leaving) {
                    core::mem::swap(place, leaving);
                }
            }
            let (here, behind) = core::mem::take(&mut sums).split_at_mut_checked(blocks)?;
            sums = behind;
            for (block, sums) in vectors(table.exponentials, block_len(stages)).zip(here.iter_mut()) {
                let (decay, entries) = block.as_chunks::<LANES>().0.split_first()?;
                let (outputs, inputs) = entries.split_at_checked(stages)?;
                let input = inputs.iter().zip(&*leaving).fold([T::zero(); LANES], |sum, (input, &x)| {
                    lanes(|lane| at(&sum, lane) + at(input, lane) * x)
                });
                let before = absorb(sums, decay, input);
                for (totals, output) in totals.iter_mut().zip(outputs) {
                    *totals = lanes(|lane| at(totals, lane) + at(output, lane) * at(&before, lane));
                }
            }
            for (term, &totals) in terms.iter_mut().zip(&*totals) {
                *term = total(totals) * self.kernel.scale();
            }
            if let Some(sums) = here.get_mut(..table.slow_blocks)?.get_mut(self.settling) {
                settle(sums);
            }
        }
        Some(())
    }
}

impl<T, K, B> Memory<T> for TabulatedSum<T, K, B>
where
    T: Real,
    K: TableSource<T>,
    B: AsRef<[T]> + AsMut<[T]>,
{
    fn channels(&self) -> usize {
        self.kernel.layout().channels()
    }

    fn stages(&self) -> usize {
        self.kernel.table().stages
    }

    fn acts_on(&self) -> ActsOn {
        self.kernel.acts_on()
    }

    fn expect_jumps(&mut self) {
        self.kernel.expect_jumps();
        self.clear();
    }

    fn leading(&self) -> &[T] {
        let state = self.state.as_ref();
        part_from(state, state.len().saturating_sub(self.kernel.table().stages * self.kernel.table().stages))
    }

    fn len(&self) -> usize {
        saturated(self.len)
    }

    fn is_empty(&self) -> bool {
        self.len == 0
    }

    #[inline]
    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        check_channels(self.kernel.layout().channels(), term.len())?;
        self.check_capacity()?;
        let ready = part_from(self.state.as_ref(), self.kernel.layout().term_start());
        match (term, ready) {
            // One channel needs no set-up of a loop.
            ([term], [ready, ..]) => *term = *ready,
            (term, ready) => term.iter_mut().zip(ready).for_each(|(term, &ready)| *term = ready),
        }
        Ok(())
    }

    #[inline(always)]
    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        check_channels(self.kernel.layout().channels(), sample.len())?;
        self.check_capacity()?;
        let stored = match (self.kernel.layout().stages, sample) {
            (_, &[x]) if self.kernel.jumps() && self.kernel.table().slow_blocks > 0 => {
                self.push_difference(x)
            }
            _ if self.kernel.table().far_blocks > 0 => self.push_numbers_with_third_parts(sample),
            (1, &[x]) => self.push_number(x),
            (1, _) => self.push_numbers(sample),
            _ => self.push_stages(sample),
        };
        debug_assert!(stored.is_some(), "the constructor checked the shapes");
        self.advance();
        Ok(())
    }

    fn clear(&mut self) {
        let table = self.kernel.table();
        let state = self.state.as_mut();
        state.fill(T::zero());
        if let Some(parts) = self.kernel.layout().split(state) {
            let planes = vectors(table.head, self.kernel.layout().head);
            for (leading, plane) in parts.leading.iter_mut().zip(planes) {
                *leading = linear::at(plane, 0) * self.kernel.scale();
            }
        }
        (self.oldest, self.settling, self.len) = (0, 0, 0);
        self.signal = [T::zero(); 2];
    }

    fn bytes(&self) -> usize {
        let table = self.kernel.table();
        let numbers = table.head.len() + table.exponentials.len();
        size_of::<Self>() - size_of::<B>() + (numbers + self.state.as_ref().len()) * size_of::<T>()
    }
}

impl<T, K, B> Stateful for TabulatedSum<T, K, B>
where
    T: Real,
    K: TableSource<T>,
    B: AsRef<[T]> + AsMut<[T]>,
{
    fn state_bytes(&self) -> usize {
        header_bytes(5) + (self.changing() + self.saved_signal().len()) * T::BYTES
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 4>(TAG, &self.shape())?;
        to.count(self.len)?;
        to.slice(self.state.as_ref().get(..self.changing()).ok_or(StateError::Unsupported)?)?;
        to.slice(self.saved_signal())
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.checked(from).map(|_| ())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let len = self.checked(&mut from.clone())?;
        let changing = self.changing();
        let state = self.state.as_mut().get_mut(..changing).ok_or(StateError::Unsupported)?;
        self.len = len;
        from.bytes(header_bytes(5))?;
        from.fill(state)?;
        if self.kernel.jumps() {
            from.fill(&mut self.signal)?;
        }
        // Both indices are cyclic and advance by one with every sample.
        self.oldest = remainder(self.len, self.delayed_samples());
        self.settling = remainder(self.len, self.settling_blocks());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::saving::StateReader;
    use std::vec;
    use std::vec::Vec;

    /// W₀ … W₃ given, then W_n = Σ_j (1 − μ_j)^{n−4} u_j v_jᵀ with the terms of the table.
    fn weight(table: &ExponentialTable<&[f64]>, n: usize) -> [[f64; 2]; 2] {
        let head = table.head.len() / 4;
        core::array::from_fn(|a| {
            core::array::from_fn(|b| match table.head[(2 * a + b) * head..][..head].get(n) {
                Some(&weight) => weight,
                None => {
                    let part = |term: ExponentialTerm<f64, 2>| {
                        libm::pow(1.0 - term.decay, (n - head) as f64) * term.output[a] * term.input[b]
                    };
                    table.terms::<2>().map(part).sum()
                }
            })
        })
    }

    #[test]
    fn matrices_act_on_groups_of_channels_as_the_double_sum_does() {
        let head: Vec<f64> = (0..16).map(|n| libm::cos(0.7 * f64::from(n))).collect();
        // Two blocks of μ, u₁, u₂, v₁, v₂; the last lane of each fills up.
        let exponentials: Vec<f64> =
            (0..40).map(|n| if n % 4 == 3 { 0.0 } else { 0.05 + 0.02 * f64::from(n % 20) }).collect();
        for slow_blocks in 0..=2 {
            let table = ExponentialTable {
                stages: 2,
                head: &head[..],
                exponentials: &exponentials[..],
                slow_blocks,
                far_blocks: 0,
                horizon: 100,
                step_size: 1.0,
            };
            let state = vec![0.0; table.state_len(4)];
            let mut memory = ExponentialSum::new(table, -0.5, 4, state).unwrap();
            let samples: Vec<[f64; 4]> =
                (0..60).map(|k| core::array::from_fn(|c| libm::sin(0.3 * k as f64 + c as f64))).collect();
            for (k, sample) in samples.iter().enumerate() {
                let mut term = [f64::NAN; 4];
                memory.next_term(&mut term).unwrap();
                for (channel, term) in term.into_iter().enumerate() {
                    let (group, a) = (channel - channel % 2, channel % 2);
                    let product = |n: usize| {
                        let row = weight(&table, n)[a];
                        -0.5 * (row[0] * samples[k - n][group] + row[1] * samples[k - n][group + 1])
                    };
                    let sum: f64 = (1..=k).map(product).sum();
                    assert!((term - sum).abs() < 1e-12, "{slow_blocks} slow, k = {k}: {term} {sum}");
                }
                memory.push(sample).unwrap();
            }
        }
    }

    #[test]
    fn tables_with_incomplete_blocks_are_refused() {
        for (stages, block) in [(1, 8), (2, 20), (3, 28), (4, 36)] {
            let numbers = vec![0.5; 3 * block];
            let head = vec![1.0; 2 * stages * stages];
            let check = |length: usize| {
                let table = ExponentialTable {
                    stages,
                    head: &head[..],
                    exponentials: &numbers[..length],
                    slow_blocks: 0,
                    far_blocks: 0,
                    horizon: 1,
                    step_size: 1.0,
                };
                table.check()
            };
            for length in 0..=3 * block {
                assert_eq!(check(length).is_ok(), length % block == 0, "{stages} stages, {length} numbers");
            }
        }
    }

    #[test]
    fn bytes_are_those_of_the_object_the_table_and_the_state() {
        let (head, exponentials) = ([1.0, 0.5, 0.25], [0.5; 16]);
        let table = ExponentialTable {
            stages: 1,
            head: &head[..],
            exponentials: &exponentials[..],
            slow_blocks: 0,
            far_blocks: 0,
            horizon: 9,
            step_size: 1.0,
        };
        // 2·8 sums and 5 numbers a channel, the leading weight.
        let memory = ExponentialSum::new(table, 1.0, 2, [0.0; 2 * (16 + 5) + 1]).unwrap();
        let object = size_of_val(&memory) - 43 * size_of::<f64>();
        assert_eq!(memory.bytes(), object + (3 + 16 + 43) * size_of::<f64>());
    }

    #[test]
    fn the_state_of_another_kernel_is_refused() {
        let memory = |weight: f64, scale: f64| {
            let head = [weight];
            let table = ExponentialTable {
                stages: 1,
                head: head.to_vec(),
                exponentials: Vec::new(),
                slow_blocks: 0,
                far_blocks: 0,
                horizon: 9,
                step_size: 1.0,
            };
            let state = vec![0.0; table.borrow().state_len(1)];
            ExponentialSum::new(table, scale, 1, state).unwrap()
        };
        // The fingerprint must distinguish kernels and scales of few bits and of many.
        for scale in [1.0, 0.0, f64::from_bits(1), f64::MAX] {
            let own = memory(1.0, scale);
            let mut bytes = vec![0; own.state_bytes()];
            own.save(&mut StateWriter::new(&mut bytes)).unwrap();
            assert_eq!(memory(1.0, scale).restore(&mut StateReader::new(&bytes)), Ok(()));
            for n in 0..32 {
                let mut other = memory(1.0 + f64::EPSILON * f64::from(1 + n), scale);
                assert!(other.restore(&mut StateReader::new(&bytes)).is_err(), "{n}, {scale:e}");
            }
            assert!(memory(1.0, 2.0).restore(&mut StateReader::new(&bytes)).is_err());
        }
    }

    /// Plain numbers: head weights, then exponentials that stay, fade, change their sign or last one step.
    fn numbers<T: Real>(head: usize, blocks: usize) -> (Vec<T>, Vec<T>) {
        let head = (0..head).map(|n| T::of(libm::cos(0.7 * n as f64))).collect();
        let decay = |j: usize| [1e-4, 0.02, 0.3, 0.9, 1.0, 1.2, 0.5, 0.07][j % 8] * (1.0 - 0.01 * j as f64);
        let block = |block: usize| {
            let decays = (4 * block..4 * block + 4).map(move |j| T::of(decay(j)));
            decays.chain((0..4).map(move |lane| T::of(0.1 + 0.2 * (block + lane) as f64)))
        };
        (head, (0..blocks).flat_map(block).collect())
    }

    fn assert_double_sum(head: usize, blocks: usize, slow_blocks: usize, channels: usize) {
        for far_blocks in [0, slow_blocks.div_ceil(2), slow_blocks] {
            assert_double_sum_in_parts(head, blocks, (slow_blocks, far_blocks), channels);
        }
    }

    fn assert_double_sum_in_parts(
        head: usize,
        blocks: usize,
        (slow_blocks, far_blocks): (usize, usize),
        channels: usize,
    ) {
        let (head, exponentials) = numbers::<f64>(head, blocks);
        let (head, exponentials) = (&head[..], &exponentials[..]);
        let table = ExponentialTable {
            stages: 1,
            head,
            exponentials,
            slow_blocks,
            far_blocks,
            horizon: 70,
            step_size: 1.0,
        };
        let weight = |n: usize| match head.get(n) {
            Some(&weight) => weight,
            None => {
                let left = (n - head.len()) as f64;
                table.terms::<1>().map(|term| libm::pow(1.0 - term.decay, left) * term.output[0]).sum()
            }
        };
        let state = vec![f64::NAN; table.state_len(channels)];
        let mut memory = ExponentialSum::new(table, -0.5, channels, state).unwrap();
        assert_eq!((memory.channels(), memory.stages()), (channels, 1));
        let samples: Vec<Vec<f64>> =
            (0..70).map(|k| (0..channels).map(|c| libm::sin(0.3 * k as f64 + c as f64)).collect()).collect();
        let mut bits = Vec::new();
        for round in 0..2 {
            assert_eq!(memory.leading(), [-0.5 * head[0]]);
            for (k, sample) in samples.iter().enumerate() {
                let mut term = vec![f64::NAN; channels];
                memory.next_term(&mut term).unwrap();
                for (channel, &term) in term.iter().enumerate() {
                    let sum: f64 = (1..=k).map(|n| -0.5 * weight(n) * samples[k - n][channel]).sum();
                    let error = (term - sum).abs();
                    let of = (head.len(), blocks, slow_blocks, far_blocks, channels);
                    assert!(error < 1e-12, "{of:?}, k = {k}, channel {channel}: {term} {sum}");
                }
                // A memory that was cleared begins again with the same bits.
                let found: Vec<u64> = term.iter().map(|number| number.to_bits()).collect();
                if round == 0 {
                    bits.push(found);
                } else {
                    assert_eq!(bits[k], found);
                }
                memory.push(sample).unwrap();
            }
            let full = Err(MemoryError::Full { capacity: 70 });
            assert_eq!((memory.push(&samples[0]), memory.len()), (full, 70));
            assert_eq!(memory.next_term(&mut vec![0.0; channels]), full);
            memory.clear();
            assert!(memory.is_empty());
        }
        let wrong = Err(MemoryError::ChannelMismatch { expected: channels, found: channels + 1 });
        let mut long = vec![0.0; channels + 1];
        assert_eq!((memory.push(&long.clone()), memory.next_term(&mut long)), (wrong, wrong));
    }

    #[test]
    fn plain_numbers_give_the_double_sum() {
        for head in [2, 3, 4, 5, 9, 12] {
            for (blocks, slow_blocks) in [(0, 0), (1, 1), (2, 0), (3, 0), (3, 2), (5, 5)] {
                for channels in [1, 3] {
                    assert_double_sum(head, blocks, slow_blocks, channels);
                }
            }
        }
        assert_double_sum(1, 0, 0, 2);
    }

    #[test]
    fn three_stages_give_the_double_sum() {
        let head: Vec<f64> = (0..36).map(|n| libm::cos(0.7 * f64::from(n))).collect();
        let exponentials: Vec<f64> = (0..56).map(|n| 0.05 + 0.02 * f64::from(n % 20)).collect();
        let (head, exponentials) = (&head[..], &exponentials[..]);
        let table = ExponentialTable {
            stages: 3,
            head,
            exponentials,
            slow_blocks: 1,
            far_blocks: 0,
            horizon: 100,
            step_size: 1.0,
        };
        let mut memory = ExponentialSum::new(table, 2.0, 6, vec![0.0; table.state_len(6)]).unwrap();
        let leading: [f64; 9] = core::array::from_fn(|plane| 2.0 * head[4 * plane]);
        assert_eq!((memory.leading(), memory.channels(), memory.stages()), (&leading[..], 6, 3));
        let weight = |n: usize, a: usize, b: usize| match head[(3 * a + b) * 4..][..4].get(n) {
            Some(&weight) => weight,
            None => {
                let left = (n - 4) as f64;
                let part = |term: ExponentialTerm<f64, 3>| {
                    libm::pow(1.0 - term.decay, left) * term.output[a] * term.input[b]
                };
                table.terms::<3>().map(part).sum()
            }
        };
        let samples: Vec<[f64; 6]> =
            (0..40).map(|k| core::array::from_fn(|c| libm::sin(0.3 * k as f64 + c as f64))).collect();
        for (k, sample) in samples.iter().enumerate() {
            let mut term = [f64::NAN; 6];
            memory.next_term(&mut term).unwrap();
            for (channel, term) in term.into_iter().enumerate() {
                let (group, a) = (channel / 3 * 3, channel % 3);
                let part = |n: usize| -> f64 {
                    (0..3).map(|b| 2.0 * weight(n, a, b) * samples[k - n][group + b]).sum()
                };
                let sum: f64 = (1..=k).map(part).sum();
                assert!((term - sum).abs() < 1e-12, "k = {k}, channel {channel}: {term} {sum}");
            }
            memory.push(sample).unwrap();
        }
    }

    #[test]
    fn a_sum_that_hardly_forgets_keeps_its_digits_in_single_precision() {
        let table = ExponentialTable {
            stages: 1,
            head: &[1.0f32, 1.0][..],
            exponentials: &[1e-7, 1e-6, 1e-5, 1e-4, 1.0, 1.0, 1.0, 1.0],
            slow_blocks: 1,
            far_blocks: 0,
            horizon: 1_000_000,
            step_size: 1.0,
        };
        let mut memory = ExponentialSum::new(table, 1.0, 1, vec![0.0; table.state_len(1)]).unwrap();
        let x = 0.1f32;
        for _ in 0..200_000 {
            memory.push(&[x]).unwrap();
        }
        let mut term = [f32::NAN];
        memory.next_term(&mut term).unwrap();
        let sum = |term: ExponentialTerm<f32, 1>| {
            let decay = f64::from(term.decay);
            -libm::expm1(199_999.0 * libm::log1p(-decay)) / decay
        };
        let expected = f64::from(x) * (1.0 + table.terms::<1>().map(sum).sum::<f64>());
        let error = (f64::from(term[0]) / expected - 1.0).abs();
        assert!(error < 2e-6, "{error:e}");
    }

    #[test]
    fn tables_whose_parts_do_not_fit_are_refused() {
        let numbers = [0.5; 64];
        let refused = |stages: usize, head: usize, exponentials: usize, slow_blocks: usize| {
            let (head, exponentials) = (&numbers[..head], &numbers[..exponentials]);
            let table = ExponentialTable {
                stages,
                head,
                exponentials,
                slow_blocks,
                far_blocks: 0,
                horizon: 1,
                step_size: 1.0,
            };
            table.check().err().map(|error| error.parameter)
        };
        // Two weights of each entry before exponentials, and one without.
        assert_eq!((refused(1, 2, 8, 1), refused(1, 1, 0, 0), refused(2, 4, 0, 0)), (None, None, None));
        for (stages, head, exponentials) in
            [(1, 1, 8), (1, 0, 0), (2, 4, 20), (2, 3, 0), (2, 10, 20), (3, 9, 28)]
        {
            assert_eq!(refused(stages, head, exponentials, 0), Some("head weights"), "{stages}, {head}");
        }
        assert_eq!((refused(1, 2, 16, 2), refused(1, 2, 16, 3)), (None, Some("slow blocks")));
        let (head, exponentials) = (&numbers[..12], &numbers[..40]);
        let good = ExponentialTable {
            stages: 1,
            head,
            exponentials,
            slow_blocks: 2,
            far_blocks: 2,
            horizon: 1,
            step_size: 0.5,
        };
        let refused_with =
            |changed: ExponentialTable<&[f64]>| changed.check().err().map(|error| error.parameter);
        assert_eq!(refused_with(good), None);
        assert_eq!(refused_with(ExponentialTable { far_blocks: 3, ..good }), Some("far blocks"));
        let matrices = ExponentialTable { stages: 2, ..good };
        assert_eq!(refused_with(matrices), Some("far blocks"));
        assert_eq!(refused_with(ExponentialTable { far_blocks: 0, ..matrices }), None);
        for step_size in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(
                refused_with(ExponentialTable { step_size, ..good }),
                Some("step size"),
                "{step_size}"
            );
        }
        assert_eq!((refused(0, 4, 0, 0), refused(5, 25, 0, 0)), (Some("stages"), Some("stages")));
        let len = |stages: usize, head: usize, exponentials: usize, channels: usize| {
            let (head, exponentials) = (&numbers[..head], &numbers[..exponentials]);
            ExponentialTable {
                stages,
                head,
                exponentials,
                slow_blocks: 0,
                far_blocks: 0,
                horizon: 1,
                step_size: 1.0,
            }
            .state_len(channels)
        };
        // 2J C/S + (2n₀ − 1) C + S²
        assert_eq!((len(1, 5, 16, 3), len(2, 12, 40, 6)), (16 * 3 + 9 * 3 + 1, 16 * 3 + 5 * 6 + 4));
        assert_eq!((len(1, 1, 0, 2), len(0, 0, 0, 2)), (2 * 2 + 1, 0));
        let table = ExponentialTable {
            stages: 1,
            head: &numbers[..2],
            exponentials: &numbers[..8],
            slow_blocks: 0,
            far_blocks: 0,
            horizon: 1,
            step_size: 1.0,
        };
        let made = |channels, state| {
            ExponentialSum::new(table, 1.0, channels, vec![0.0; state]).err().map(|error| error.parameter)
        };
        assert_eq!((made(1, 12), made(1, 11), made(0, 1)), (None, Some("state length"), Some("channels")));
    }

    #[test]
    fn a_saved_state_goes_on_with_the_same_bits() {
        for (head, slow_blocks, far_blocks, channels) in [(2, 0, 0, 1), (9, 3, 0, 2), (9, 3, 2, 2)] {
            let (head, exponentials) = numbers::<f32>(head, 3);
            let (head, exponentials) = (&head[..], &exponentials[..]);
            let table = ExponentialTable {
                stages: 1,
                head,
                exponentials,
                slow_blocks,
                far_blocks,
                horizon: 60,
                step_size: 1.0,
            };
            let build =
                || ExponentialSum::new(table, 1.0, channels, vec![0.0; table.state_len(channels)]).unwrap();
            let mut memory = build();
            let sample = |k: usize| vec![libm::sinf(k as f32); channels];
            for k in 0..50 {
                let mut bytes = vec![0; memory.state_bytes()];
                let mut writer = StateWriter::new(&mut bytes);
                memory.save(&mut writer).unwrap();
                assert_eq!(writer.written(), memory.state_bytes());
                let mut restored = build();
                let mut reader = StateReader::new(&bytes);
                assert_eq!((restored.restore(&mut reader), reader.finish()), (Ok(()), Ok(())));
                assert_eq!(
                    (restored.len(), restored.oldest, restored.settling),
                    (k, memory.oldest, memory.settling)
                );
                assert!(restored.check_state(&mut StateReader::new(&bytes[1..])).is_err());
                assert!(restored.check_state(&mut StateReader::new(&bytes[..bytes.len() - 1])).is_err());
                assert_eq!(restored.state, memory.state);
                memory.push(&sample(k)).unwrap();
            }
        }
    }

    #[test]
    fn differences_of_a_signal_that_jumps_give_the_terms_of_any_others() {
        // In two parts and in three; the slow sums are stored differently, with a difference of rounding
        // size.
        for far_blocks in [0, 2] {
            let (head, exponentials) = numbers::<f64>(9, 3);
            let table = ExponentialTable {
                stages: 1,
                head: &head[..],
                exponentials: &exponentials[..],
                slow_blocks: 2,
                far_blocks,
                horizon: 1000,
                step_size: 1.0,
            };
            let build = || ExponentialSum::new(table, 1.0, 1, vec![0.0; table.state_len(1)]).unwrap();
            let mut plain = build().acting_on(ActsOn::Increments);
            let jumping = || {
                let mut memory = build().acting_on(ActsOn::Increments);
                memory.expect_jumps();
                memory
            };
            let mut memory = jumping();
            for k in 0..200 {
                let sample = [libm::cos(3.0 * f64::from(k))];
                let (mut expected, mut found) = ([f64::NAN], [f64::NAN]);
                plain.next_term(&mut expected).unwrap();
                memory.next_term(&mut found).unwrap();
                assert!((found[0] - expected[0]).abs() < 1e-13, "{k}: {} {}", found[0], expected[0]);
                plain.push(&sample).unwrap();
                memory.push(&sample).unwrap();
                // Restored bit by bit, and refused by a memory that does not expect jumps.
                let mut bytes = vec![0; memory.state_bytes()];
                let mut writer = StateWriter::new(&mut bytes);
                memory.save(&mut writer).unwrap();
                assert_eq!(writer.written(), memory.state_bytes());
                let mut restored = jumping();
                let mut reader = StateReader::new(&bytes);
                assert_eq!((restored.restore(&mut reader), reader.finish()), (Ok(()), Ok(())));
                assert_eq!((restored.signal, &restored.state), (memory.signal, &memory.state));
                assert!(plain.clone().restore(&mut StateReader::new(&bytes)).is_err());
            }
            memory.clear();
            assert_eq!((memory.signal, memory.kernel.jumps()), ([0.0; 2], true));
            // Samples of other kinds are treated as before.
            let mut on_values = build();
            on_values.expect_jumps();
            assert!(!on_values.kernel.jumps());
        }
    }

    /// A table of 9 + 12 numbers whose cyclic indices have the periods 7 and 3.
    fn table<'a>(head: &'a [f32], exponentials: &'a [f32], horizon: u64) -> ExponentialTable<&'a [f32]> {
        ExponentialTable {
            stages: 1,
            head,
            exponentials,
            slow_blocks: 3,
            far_blocks: 1,
            horizon,
            step_size: 1.0,
        }
    }

    /// The saved state of this memory with the sample count raised by `samples`.
    fn later(memory: &ExponentialSum<f32, &[f32], Vec<f32>>, samples: u64) -> Vec<u8> {
        let mut bytes = vec![0; memory.state_bytes()];
        memory.save(&mut StateWriter::new(&mut bytes)).unwrap();
        let count = header_bytes(4)..header_bytes(5);
        let seen = u64::from_le_bytes(bytes[count.clone()].try_into().unwrap());
        bytes[count].copy_from_slice(&(seen + samples).to_le_bytes());
        bytes
    }

    #[test]
    fn an_endless_memory_goes_on_where_its_count_ends() {
        let (head, exponentials) = numbers::<f32>(9, 3);
        let table = table(&head, &exponentials, ExponentialTable::<()>::ENDLESS);
        let build = || ExponentialSum::new(table, 1.0, 1, vec![0.0; table.state_len(1)]).unwrap();
        let sample = |k: u64| libm::sinf(0.3 * (k % 97) as f32);
        // Where 32 bits end, and where 64 do.
        for (end, steps) in [(1u64 << 32, 50), (u64::MAX, 2000)] {
            let mut early = build();
            (0..30).for_each(|k| early.push(&[sample(k)]).unwrap());
            // A multiple of 21, so that all cyclic indices stay the same.
            let more = (end - 60) / 21 * 21;
            let mut late = build();
            late.restore(&mut StateReader::new(&later(&early, more))).unwrap();
            assert_eq!((late.oldest, late.settling), (early.oldest, early.settling));
            for k in 30..30 + steps {
                let (mut expected, mut found) = ([f32::NAN], [f32::NAN]);
                early.next_term(&mut expected).unwrap();
                late.next_term(&mut found).unwrap();
                assert_eq!(found[0].to_bits(), expected[0].to_bits(), "sample {k} before {end}");
                early.push(&[sample(k)]).unwrap();
                late.push(&[sample(k)]).unwrap();
                // A state saved on either side of the end can be restored.
                let mut bytes = vec![0; late.state_bytes()];
                late.save(&mut StateWriter::new(&mut bytes)).unwrap();
                let mut again = build();
                again.restore(&mut StateReader::new(&bytes)).unwrap();
                let places = |memory: &ExponentialSum<_, _, _>| (memory.oldest, memory.settling, memory.len);
                assert_eq!(places(&again), places(&late));
                assert_eq!((again.oldest, again.settling), (early.oldest, early.settling));
            }
            assert!(late.len > (1 << 32) - 10 && !late.is_empty());
            assert_eq!(late.len(), usize::try_from(late.len).unwrap_or(usize::MAX));
        }
        let beyond = build().restore(&mut StateReader::new(&later(&build(), u64::MAX)));
        let limit = u64::MAX - 1;
        assert_eq!(beyond, Err(StateError::TooLarge { what: "samples", limit, found: u64::MAX }));
    }

    #[test]
    fn past_its_horizon_a_memory_refuses_or_forgets() {
        let (head, exponentials) = numbers::<f32>(9, 3);
        let endless = table(&head, &exponentials, ExponentialTable::<()>::ENDLESS);
        let table = ExponentialTable { horizon: 40, ..endless };
        let build = |table: ExponentialTable<_>| {
            ExponentialSum::new(table, 1.0, 1, vec![0.0f32; table.state_len(1)]).unwrap()
        };
        let (mut new, mut endless) = (build(table), build(endless));
        let mut refusing = build(table).past_horizon(Overflow::Refuse).unwrap();
        let mut forgetting = build(table).past_horizon(Overflow::Forget).unwrap();
        for k in 0..200 {
            let sample = [libm::cosf(k as f32)];
            let expected = if k < 40 { Ok(()) } else { Err(MemoryError::Full { capacity: 40 }) };
            assert_eq!((new.push(&sample), refusing.push(&sample)), (expected, expected), "{k}");
            assert_eq!((endless.push(&sample), forgetting.push(&sample)), (Ok(()), Ok(())), "{k}");
        }
        assert_eq!(forgetting.state, endless.state);
        // Only a memory that forgets restores a state with more samples than its horizon of 40.
        let saved = later(&forgetting, 0);
        assert!(build(table).restore(&mut StateReader::new(&saved)).is_err());
        let mut again = build(table).past_horizon(Overflow::Forget).unwrap();
        assert_eq!(again.restore(&mut StateReader::new(&saved)), Ok(()));
        // A sum that never decays would grow for ever; zeros that fill a block up are no exponentials.
        let (mut stays, mut ends) = (exponentials.clone(), exponentials.clone());
        stays[2] = 0.0;
        (ends[2], ends[6]) = (0.0, 0.0);
        let (stays, ends) = (
            ExponentialTable { exponentials: &stays[..], ..table },
            ExponentialTable { exponentials: &ends[..], ..table },
        );
        assert!(build(stays).past_horizon(Overflow::Refuse).is_ok());
        assert_eq!(build(stays).past_horizon(Overflow::Forget).unwrap_err().parameter, "decay");
        assert!(build(ends).past_horizon(Overflow::Forget).is_ok());
    }

    #[test]
    fn weights_that_hold_their_step_size_are_not_scaled_by_another() {
        let made = |step_size: f64, scale: f64| {
            let exponentials: &[f64] = &[];
            let table = ExponentialTable {
                stages: 1,
                head: &[2.0, -1.0][..],
                exponentials,
                slow_blocks: 0,
                far_blocks: 0,
                horizon: 9,
                step_size,
            };
            ExponentialSum::new(table, scale, 1, [0.0; 4]).err().map(|error| error.parameter)
        };
        assert_eq!((made(0.001, 1.0), made(1.0, 31.6), made(1.0, 1.0)), (None, None, None));
        assert_eq!(made(0.001, 31.6), Some("scale"));
    }

    /// Effect of N equal samples in single precision on a sum that already contains more samples than a test
    /// can push.
    #[test]
    fn three_parts_of_a_sum_take_samples_that_two_parts_would_lose() {
        // Behind two parts, two pending sums and the term.
        const THIRD: usize = 8 + 2 + 1;
        const EXPONENTIALS: [f32; 8] = [1e-20, 0.5, 0.5, 0.5, 1.0, 0.0, 0.0, 0.0];
        let samples = 1 << 20;
        let gained = |far_blocks: usize| {
            let table = ExponentialTable {
                stages: 1,
                head: &[0.0f32, 0.0][..],
                exponentials: &EXPONENTIALS,
                slow_blocks: 1,
                far_blocks,
                horizon: ExponentialTable::<()>::ENDLESS,
                step_size: 1.0,
            };
            let mut memory = ExponentialSum::new(table, 1.0, 1, vec![0.0; table.state_len(1)]).unwrap();
            // After 2⁵⁰ samples of size 1; the rest of the settled part is as large as it gets.
            let (whole, rest) = (1.125e15f32, 3.3e7f32);
            match far_blocks {
                0 => (memory.state[4], memory.state[0]) = (whole, rest),
                _ => (memory.state[THIRD], memory.state[4]) = (whole, rest),
            }
            let sum = |memory: &ExponentialSum<f32, _, Vec<f32>>| -> f64 {
                [0, 4, THIRD].iter().take(2 + far_blocks).map(|&part| f64::from(memory.state[part])).sum()
            };
            let before = sum(&memory);
            (0..samples).for_each(|_| memory.push(&[0.7f32]).unwrap());
            let decay = f64::from(EXPONENTIALS[0]) * before * samples as f64;
            (sum(&memory) - before + decay) / (f64::from(0.7f32) * samples as f64) - 1.0
        };
        let (two, three) = (gained(0), gained(1));
        assert!(two.abs() > 0.1, "{two:e}");
        assert!(three.abs() < 1e-6, "{three:e}");
    }
}
