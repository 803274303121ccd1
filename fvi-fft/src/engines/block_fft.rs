//! The engine for throughput: the work of a block is done when its first output is needed.

use fvi_core::{
    ActsOn, Memory, MemoryError, ParameterError, StateError, StateReader, StateWriter, Stateful,
    check_channels,
};
use pulp::Arch;
use rustfft::num_complex::Complex;

use crate::engines::cover::Cover;
use crate::engines::level::{Level, LevelShape, owed};
use crate::engines::near::Near;
use crate::engines::plans::Plans;
use crate::engines::replay;
use crate::engines::row::CHUNK;
use crate::engines::scalar::Scalar;
use crate::engines::weights::{Weights, check_shape, extend_planes, take_planes};

/// The `block-fft` memory: fast convolution of a known kernel with an online signal, O(k log² k) for k steps.
///
/// Lags below two blocks of 64 samples are summed directly; beyond, blocks of growing size are convolved
/// through cached spectra of the kernel, block pairs always at distance ≥ 2 (see \[HLS\] for the idea). It is
/// exact to rounding for any kernel, leading weight zero included: the error is a few u·Σ|w||x|, on decaying
/// and growing signals too.
///
/// All coordinates share plans and kernel spectra. The cost of a step is uneven: a step that begins a large
/// block does all the work of that block. [`RealTime`](crate::RealTime) spreads it.
pub struct BlockFft<T: Scalar> {
    acts_on: ActsOn,
    channels: usize,
    len: usize,
    /// `None` for a run of unknown length.
    capacity: Option<usize>,
    cover: Cover,
    levels: Vec<Level<T>>,
    near: Near<T>,
    /// All samples, one row per channel.
    signal: Vec<Vec<T>>,
    growth: Option<Growth<T>>,
    scratch: Vec<Complex<f64>>,
    unit: Arch,
}

/// Kernel and plans that a run of unknown length needs to add levels.
struct Growth<T: Scalar> {
    source: Box<dyn Weights<T> + Send>,
    /// All weights generated so far, one plane for each entry of the matrices, row by row.
    planes: Vec<Vec<T>>,
    plans: Plans,
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"blck";

/// Samples of a block of the finest level.
const FIRST_BLOCK: usize = 64;

/// Largest leaf of the transforms.
const LEAF: usize = 512;

/// Ratio of the block sizes of neighbouring levels.
const RATIO: usize = 8;

/// A level is the top if the whole run has at most this many of its blocks.
const TOP_BLOCKS: usize = 32;

/// Runs up to this length have the same levels, and so the same bits, whatever their length.
const SHORT_RUN: usize = FIRST_BLOCK * RATIO * TOP_BLOCKS;

impl<T: Scalar> BlockFft<T> {
    /// A memory for at most `capacity` samples; all spectra are computed here.
    ///
    /// # Errors
    /// If `channels` is zero or no multiple of the kernel's stages.
    pub fn planned(
        mut kernel: impl Weights<T>,
        channels: usize,
        capacity: usize,
    ) -> Result<Self, ParameterError> {
        let stages = check_shape(&kernel, channels)?;
        let unit = Arch::new();
        let cover = Cover::for_run(FIRST_BLOCK, RATIO, TOP_BLOCKS, capacity.max(SHORT_RUN));
        let planes = take_planes(&mut kernel, cover.lags(capacity));
        let mut scratch = Vec::new();
        let shape = LevelShape { block: 0, leaf: LEAF, stages, channels, reach: 0, outputs: 1 };
        let levels = Level::for_run(&cover, capacity, &shape, &planes, &mut scratch, unit);
        Ok(Self {
            acts_on: ActsOn::Values,
            channels,
            len: 0,
            capacity: Some(capacity),
            near: Near::new(2 * cover.block(0), stages, channels, &planes, unit),
            cover,
            levels,
            signal: (0..channels).map(|_| Vec::with_capacity(capacity)).collect(),
            growth: None,
            scratch,
            unit,
        })
    }

    /// A memory without a fixed length: weights and levels are added as the run grows.
    ///
    /// # Errors
    /// If `channels` is zero or no multiple of the kernel's stages.
    pub fn growing(
        mut kernel: impl Weights<T> + Send + 'static,
        channels: usize,
    ) -> Result<Self, ParameterError> {
        let stages = check_shape(&kernel, channels)?;
        let unit = Arch::new();
        let planes = take_planes(&mut kernel, 2 * FIRST_BLOCK);
        Ok(Self {
            acts_on: ActsOn::Values,
            channels,
            len: 0,
            capacity: None,
            cover: Cover::growing(FIRST_BLOCK, RATIO),
            levels: Vec::new(),
            near: Near::new(2 * FIRST_BLOCK, stages, channels, &planes, unit),
            signal: vec![Vec::new(); channels],
            growth: Some(Growth { source: Box::new(kernel), planes, plans: Plans::new() }),
            scratch: Vec::new(),
            unit,
        })
    }

    /// Floating-point operations of a run of `steps` steps of one channel with a kernel of plain numbers: a
    /// multiply–add counts two, a complex transform of length n 5 n log₂ n.
    pub fn operations(steps: usize) -> f64 {
        Cover::for_run(FIRST_BLOCK, RATIO, TOP_BLOCKS, steps.max(SHORT_RUN)).operations(steps)
    }

    /// The same memory, with weights for samples of the given kind.
    #[must_use]
    pub fn acting_on(self, acts_on: ActsOn) -> Self {
        Self { acts_on, ..self }
    }

    /// Adds the levels and spectra that are needed for outputs from sample k on and are still missing.
    fn grow(&mut self, k: usize) {
        let Some(growth) = &mut self.growth else { return };
        let stages = self.near.stages();
        loop {
            let index = self.levels.len();
            if index == self.cover.levels() {
                self.cover.grow();
            }
            let block = self.cover.block(index);
            if k < 2 * block {
                break;
            }
            let shape = LevelShape {
                block,
                leaf: LEAF,
                stages,
                channels: self.channels,
                reach: 2 * RATIO - 1,
                outputs: 1,
            };
            let level = Level::new(&shape, &mut growth.plans, self.unit);
            self.scratch.resize(level.scratch().max(self.scratch.len()), Complex::default());
            self.levels.push(level);
        }
        for (index, level) in self.levels.iter_mut().enumerate() {
            let m = k / level.block();
            while level.missing_distance() <= m - self.cover.inputs(index, m).start {
                extend_planes(
                    &mut *growth.source,
                    &mut growth.planes,
                    (level.missing_distance() + 1) * level.block(),
                );
                level.add_distance(&growth.planes, &mut self.scratch);
            }
        }
    }

    /// Prepares the chunk of outputs that begins at sample k.
    fn begin_chunk(&mut self, k: usize) {
        if k.is_multiple_of(self.cover.block(0)) {
            self.grow(k);
            for (index, level) in self.levels.iter_mut().enumerate() {
                let m = k / level.block();
                if !k.is_multiple_of(level.block()) || m < 2 {
                    break;
                }
                let inputs = self.cover.inputs(index, m);
                for task in 0..level.tasks(&inputs) {
                    level.run(&inputs, task, &self.signal, &mut self.scratch);
                }
            }
        }
        let levels = &self.levels;
        self.near.begin(self.cover.near(k), &self.signal, |channel| owed(levels, channel, k));
    }

    fn check_capacity(&self) -> Result<(), MemoryError> {
        match self.capacity {
            Some(capacity) if self.len >= capacity => Err(MemoryError::Full { capacity }),
            _ => Ok(()),
        }
    }
}

impl<T: Scalar> Memory<T> for BlockFft<T> {
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
        if self.len.is_multiple_of(CHUNK) && self.check_capacity().is_ok() {
            self.begin_chunk(self.len);
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.len = 0;
        self.near.clear();
        self.signal.iter_mut().for_each(Vec::clear);
        self.levels.iter_mut().for_each(Level::clear);
    }

    fn bytes(&self) -> usize {
        let rows = |rows: &[Vec<T>]| rows.iter().map(|row| row.capacity() * size_of::<T>()).sum::<usize>();
        size_of::<Self>()
            + self.near.bytes()
            + self.levels.iter().map(Level::bytes).sum::<usize>()
            + rows(&self.signal)
            + self.growth.as_ref().map_or(0, |growth| rows(&growth.planes))
            + size_of_val(self.scratch.as_slice())
    }
}

impl<T: Scalar> Stateful for BlockFft<T> {
    fn state_bytes(&self) -> usize {
        replay::state_bytes(self)
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        replay::save(self, TAG, &self.signal, to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        replay::check(self, TAG, self.capacity.unwrap_or(usize::MAX), from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let capacity = self.capacity.unwrap_or(usize::MAX);
        replay::restore(self, TAG, capacity, from)
    }
}
