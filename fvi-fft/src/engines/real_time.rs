//! The engine for deadlines: the work of large blocks is cut into small tasks and spread over the steps.

use core::ops::Range;

use fvi_core::{
    ActsOn, Memory, MemoryError, ParameterError, StateError, StateReader, StateWriter, Stateful,
    check_channels,
};
use pulp::Arch;
use rustfft::num_complex::Complex;

use crate::engines::cover::Cover;
use crate::engines::level::{Level, LevelShape, owed};
use crate::engines::near::Near;
use crate::engines::replay;
use crate::engines::row::CHUNK;
use crate::engines::scalar::Scalar;
use crate::engines::weights::{Weights, check_shape, take_planes};

/// Schedule of the tasks of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pacing {
    /// All at once, as soon as the block's input is complete.
    Eager,
    /// A constant amount of work a step, so that each block is done just in time.
    Paced,
}

/// The `real-time` memory: fast convolution of a known kernel with an online signal at a bounded cost per
/// step.
///
/// The result is exact to rounding for any kernel, as that of [`BlockFft`](crate::BlockFft). After
/// construction there is no allocation, no lock and no thread.
///
/// **Schedule.** The job for output block m of a level needs the input blocks up to m − 2, so it is released
/// when block m − 2 is complete, at sample (m − 1)B, and due when its output begins, at mB: a window of
/// exactly B steps, one job at a time in each level. A job is a list of tasks of bounded cost (64 to 128
/// points). Each step spends the *work budget* Σ_ℓ C_ℓ/B_ℓ + 5 %, C_ℓ the largest cost of a job of level ℓ,
/// on the finest level that has work; deadlines nest, so this is the earliest deadline first. The work of a
/// step is at most the near part, the budget and one task.
///
/// A job that is not done when it is due would be an *overrun*: it is then finished at once, so that the
/// result stays exact, and counted by [`overruns`](RealTime::overruns).
///
/// Outputs are stored in buffers of their level until they are read, so [`Pacing`] does not change the bits
/// of the result.
///
/// Source: \[Gardner95\], \[Garcia02\], \[Battenberg11\].
pub struct RealTime<T: Scalar> {
    acts_on: ActsOn,
    channels: usize,
    len: usize,
    capacity: usize,
    pacing: Pacing,
    cover: Cover,
    levels: Vec<Level<T>>,
    /// Current job of each level.
    jobs: Vec<Option<Job>>,
    near: Near<T>,
    /// All samples, one row per channel.
    signal: Vec<Vec<T>>,
    scratch: Vec<Complex<f64>>,
    budget: Work,
    /// Work that may still be done; negative after a task that cost more than the remaining budget.
    credit: Work,
    overruns: usize,
}

/// Cost of a task, about one complex multiply–add.
type Work = i64;

/// Job of one output block.
#[derive(Clone, Debug)]
struct Job {
    inputs: Range<usize>,
    done: usize,
    tasks: usize,
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"real";

/// Samples of a block of the finest level.
const FIRST_BLOCK: usize = 64;

/// Largest leaf of the transforms: bounds the cost of a task.
const LEAF: usize = 128;

/// Ratio of the block sizes of neighbouring levels.
const RATIO: usize = 4;

/// A level is the top if the whole run has at most this many of its blocks.
const TOP_BLOCKS: usize = 16;

/// Margin of the per-step budget over the mean cost of the jobs, in percent.
const RESERVE: Work = 5;

impl<T: Scalar> RealTime<T> {
    /// A memory for at most `capacity` samples; everything is computed and allocated here.
    ///
    /// # Errors
    /// If `channels` is zero or no multiple of the kernel's stages.
    pub fn planned(
        mut kernel: impl Weights<T>,
        channels: usize,
        capacity: usize,
        pacing: Pacing,
    ) -> Result<Self, ParameterError> {
        let stages = check_shape(&kernel, channels)?;
        let unit = Arch::new();
        let cover = Cover::for_run(FIRST_BLOCK, RATIO, TOP_BLOCKS, capacity);
        let planes = take_planes(&mut kernel, capacity.max(2 * cover.block(0)));
        let mut scratch = Vec::new();
        let shape = LevelShape { block: 0, leaf: LEAF, stages, channels, reach: 0, outputs: 2 };
        let levels: Vec<Level<T>> = Level::for_run(&cover, capacity, &shape, &planes, &mut scratch, unit);
        let budget = levels.iter().map(|level| {
            let largest = 0..level.reach() - 1;
            let job: usize = (0..level.tasks(&largest)).map(|task| level.cost(&largest, task)).sum();
            (job as Work * (100 + RESERVE)).div_euclid(100 * level.block() as Work) + 1
        });
        let budget = budget.sum();
        Ok(Self {
            acts_on: ActsOn::Values,
            channels,
            len: 0,
            capacity,
            pacing,
            near: Near::new(2 * cover.block(0), stages, channels, &planes, unit),
            cover,
            jobs: vec![None; levels.len()],
            levels,
            signal: (0..channels).map(|_| Vec::with_capacity(capacity)).collect(),
            scratch,
            budget,
            credit: 0,
            overruns: 0,
        })
    }

    /// Floating-point operations of a run of `steps` steps of one channel with a kernel of plain numbers: a
    /// multiply–add counts two, a complex transform of length n 5 n log₂ n.
    pub fn operations(steps: usize) -> f64 {
        Cover::for_run(FIRST_BLOCK, RATIO, TOP_BLOCKS, steps).operations(steps)
    }

    /// The same memory, with weights for samples of the given kind.
    #[must_use]
    pub fn acting_on(self, acts_on: ActsOn) -> Self {
        Self { acts_on, ..self }
    }

    /// Number of blocks since the beginning or the last [`clear`](Memory::clear) that were not done when they
    /// were due.
    pub fn overruns(&self) -> usize {
        self.overruns
    }

    /// Finishes the jobs that are due at sample k and releases those whose input is complete.
    fn turn_blocks(&mut self, k: usize) {
        for index in 0..self.levels.len() {
            let block = self.levels[index].block();
            if !k.is_multiple_of(block) {
                break;
            }
            if self.jobs[index].is_some() {
                self.overruns += 1;
                while self.jobs[index].is_some() {
                    self.run_task(index);
                }
            }
            let output = k / block + 1;
            if output >= 2 && output * block < self.capacity {
                let inputs = self.cover.inputs(index, output);
                self.jobs[index] = Some(Job { done: 0, tasks: self.levels[index].tasks(&inputs), inputs });
            }
        }
    }

    /// Runs the next task of a level's job, if it has one, and returns the cost.
    fn run_task(&mut self, index: usize) -> Work {
        let Some(job) = &mut self.jobs[index] else { return 0 };
        let level = &mut self.levels[index];
        let cost = level.cost(&job.inputs, job.done);
        level.run(&job.inputs, job.done, &self.signal, &mut self.scratch);
        job.done += 1;
        if job.done == job.tasks {
            self.jobs[index] = None;
        }
        cost as Work
    }

    /// Spends the work of one step.
    fn work(&mut self) {
        // Unused budget of an idle step is dropped: the work of one step stays bounded.
        self.credit = self.credit.min(0) + self.budget;
        let mut index = 0;
        while index < self.levels.len() && (self.credit > 0 || self.pacing == Pacing::Eager) {
            if self.jobs[index].is_some() {
                self.credit -= self.run_task(index);
            } else {
                index += 1;
            }
        }
    }

    fn check_capacity(&self) -> Result<(), MemoryError> {
        if self.len < self.capacity { Ok(()) } else { Err(MemoryError::Full { capacity: self.capacity }) }
    }
}

impl<T: Scalar> Memory<T> for RealTime<T> {
    fn channels(&self) -> usize {
        self.channels
    }

    fn stages(&self) -> usize {
        self.near.stages()
    }

    fn acts_on(&self) -> ActsOn {
        self.acts_on
    }

    fn leading(&self) -> &[T] {
        self.near.leading()
    }

    fn len(&self) -> usize {
        self.len
    }

    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        check_channels(self.channels, term.len())?;
        self.check_capacity()?;
        self.near.term(self.len, term);
        Ok(())
    }

    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        check_channels(self.channels, sample.len())?;
        self.check_capacity()?;
        for (row, &number) in self.signal.iter_mut().zip(sample) {
            row.push(number);
        }
        self.near.push(self.len, sample);
        self.len += 1;
        if self.len == self.capacity {
            return Ok(());
        }
        if self.len.is_multiple_of(self.cover.block(0)) {
            self.turn_blocks(self.len);
        }
        self.work();
        if self.len.is_multiple_of(CHUNK) {
            let (levels, k) = (&self.levels, self.len);
            self.near.begin(self.cover.near(k), &self.signal, |channel| owed(levels, channel, k));
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.len = 0;
        self.credit = 0;
        self.overruns = 0;
        self.jobs.fill(None);
        self.near.clear();
        self.signal.iter_mut().for_each(Vec::clear);
        self.levels.iter_mut().for_each(Level::clear);
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.near.bytes()
            + self.levels.iter().map(Level::bytes).sum::<usize>()
            + self.signal.iter().map(|row| row.capacity() * size_of::<T>()).sum::<usize>()
            + size_of_val(self.scratch.as_slice())
    }

    fn overruns(&self) -> Option<usize> {
        Some(self.overruns)
    }
}

impl<T: Scalar> Stateful for RealTime<T> {
    fn state_bytes(&self) -> usize {
        replay::state_bytes(self)
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        replay::save(self, TAG, &self.signal, to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        replay::check(self, TAG, self.capacity, from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let capacity = self.capacity;
        replay::restore(self, TAG, capacity, from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weight(first: usize, weights: &mut [f64]) {
        for (n, weight) in (first..).zip(weights) {
            *weight = 1.0 / (1.0 + n as f64);
        }
    }

    fn terms(pacing: Pacing, length: usize) -> (Vec<u64>, usize) {
        let mut memory = RealTime::planned(weight, 1, length, pacing).unwrap();
        let mut term = [0.0];
        let mut terms = Vec::new();
        for k in 0..length {
            memory.next_term(&mut term).unwrap();
            terms.push(term[0].to_bits());
            memory.push(&[(0.37 * k as f64).sin()]).unwrap();
        }
        (terms, memory.overruns())
    }

    #[test]
    fn pacing_does_not_change_a_bit() {
        for length in [1000, 10_000, 70_000] {
            let (eager, _) = terms(Pacing::Eager, length);
            let (paced, overruns) = terms(Pacing::Paced, length);
            assert_eq!(overruns, 0);
            assert!(eager == paced, "length {length}");
        }
    }

    fn assert_no_block_is_late(lengths: impl Iterator<Item = u32>) {
        for bits in lengths {
            for length in [1 << bits, 3 << (bits - 2)] {
                let mut memory = RealTime::planned(weight, 1, length, Pacing::Paced).unwrap();
                for _ in 0..length {
                    memory.push(&[1.0]).unwrap();
                }
                assert_eq!(memory.overruns(), 0, "length {length}");
            }
        }
    }

    #[test]
    fn no_block_is_late_in_runs_of_any_length_up_to_sixty_thousand_steps() {
        assert_no_block_is_late(7..=16);
    }

    #[test]
    fn no_block_is_late_in_runs_of_up_to_four_million_steps() {
        assert_no_block_is_late(17..=22);
    }

    #[test]
    fn a_budget_too_small_is_reported_and_the_result_stays_exact() {
        let mut memory = RealTime::planned(weight, 1, 5000, Pacing::Paced).unwrap();
        memory.budget /= 2;
        let (expected, _) = terms(Pacing::Eager, 5000);
        let mut term = [0.0];
        for (k, expected) in expected.iter().enumerate() {
            memory.next_term(&mut term).unwrap();
            assert_eq!(term[0].to_bits(), *expected, "k = {k}");
            memory.push(&[(0.37 * k as f64).sin()]).unwrap();
        }
        assert!(memory.overruns() > 1);
        assert_eq!(Memory::overruns(&memory), Some(memory.overruns()));
    }

    #[test]
    fn the_budget_is_a_twentieth_above_the_largest_jobs() {
        let budget = |length| RealTime::planned(weight, 1, length, Pacing::Paced).unwrap().budget;
        // Up to 16 blocks of 64: the last output needs products with 14 blocks, of 64 numbers each, and two
        // transforms of one leaf, with six operations for each of its 64 numbers.
        let job = 14 * 64 + 2 * 6 * 64;
        assert_eq!(budget(1000), job * 105 / 100 / 64 + 1);
        // For 4000 samples an output of the blocks of 64 needs 6 products, and one of the blocks of 256 needs
        // 14; the latter have 64 butterflies of eight operations each above four leaves.
        let finest = 6 * 64 + 2 * 6 * 64;
        let coarsest = 14 * 256 + 2 * (8 * 64 + 4 * 6 * 64);
        assert_eq!(budget(4000), (finest * 105 / 100 / 64 + 1) + (coarsest * 105 / 100 / 256 + 1));
    }

    /// For the worst lengths no smaller budget suffices. For others, such as 1000 and 16 384, nine tenths of
    /// it do.
    #[test]
    fn at_some_lengths_nine_tenths_of_the_budget_are_too_little() {
        for length in [4000, 65_536] {
            let mut memory = RealTime::planned(weight, 1, length, Pacing::Paced).unwrap();
            memory.budget = memory.budget * 9 / 10;
            for _ in 0..length {
                memory.push(&[1.0]).unwrap();
            }
            assert!(memory.overruns() > 0, "length {length}");
        }
    }
}
