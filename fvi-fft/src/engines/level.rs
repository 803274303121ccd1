//! One level of blocks: cached spectra of the kernel, spectra of the signal, and the job that computes one
//! output block.

use core::ops::Range;

use pulp::{Arch, Simd, WithSimd};
use rustfft::num_complex::Complex;

use crate::engines::cover::Cover;
use crate::engines::plans::Plans;
use crate::engines::row::{CHUNK, Row};
use crate::engines::scalar::Scalar;
use crate::engines::transform::{PACKET, Packet, Transform};

/// Packets of a spectrum per task of products.
const TILE: usize = 8;

/// Number of products added at a time.
const GROUP: usize = 4;

/// Blocks of B samples and everything needed to convolve them at block distances 2, 3, ….
pub(crate) struct Level<T: Scalar> {
    block: usize,
    stages: usize,
    channels: usize,
    transform: Transform<T>,
    /// Spectra of the weights, for each distance from 2 the S×S entries row by row; they include the factor
    /// 1/B.
    kernel: Vec<Packet<T>>,
    /// Spectra of the last input blocks, all channels of one block after the other.
    signal: Vec<Packet<T>>,
    slots: usize,
    /// Sum of products of the current job.
    sum: Vec<Packet<T>>,
    /// Polynomial of the current job.
    polynomial: Vec<Complex<T>>,
    /// The last output blocks, one channel after the other in each.
    output: Vec<T>,
    outputs: usize,
    unit: Arch,
}

/// Size and shape of a level.
pub(crate) struct LevelShape {
    /// Samples of a block, B.
    pub(crate) block: usize,
    /// Largest leaf of the transforms.
    pub(crate) leaf: usize,
    /// Stages S.
    pub(crate) stages: usize,
    /// Channels N·S.
    pub(crate) channels: usize,
    /// Largest block distance.
    pub(crate) reach: usize,
    /// Output blocks kept: 1 for the block being read, 2 to compute the next one meanwhile.
    pub(crate) outputs: usize,
}

impl<T: Scalar> Level<T> {
    pub(crate) fn new(shape: &LevelShape, plans: &mut Plans, unit: Arch) -> Self {
        let &LevelShape { block, leaf, stages, channels, reach, outputs } = shape;
        let transform = Transform::new(block, leaf, plans, unit);
        let packets = transform.packets();
        let slots = reach - 1;
        Self {
            block,
            stages,
            channels,
            kernel: Vec::with_capacity((reach - 1) * stages * stages * packets),
            signal: vec![Packet::zero(); slots * channels * packets],
            slots,
            sum: vec![Packet::zero(); packets],
            polynomial: vec![Complex::new(T::zero(), T::zero()); block],
            output: vec![T::zero(); outputs * channels * block],
            outputs,
            transform,
            unit,
        }
    }

    /// The levels of a run of at most `capacity` samples, with all their spectra; `scratch` grows to the
    /// length they need.
    ///
    /// `shape` has the values shared by all levels; its block and reach are ignored.
    pub(crate) fn for_run(
        cover: &Cover,
        capacity: usize,
        shape: &LevelShape,
        planes: &[Vec<T>],
        scratch: &mut Vec<Complex<f64>>,
        unit: Arch,
    ) -> Vec<Self> {
        let mut plans = Plans::new();
        let reaches = (0..cover.levels()).map(|index| cover.reach(index, capacity));
        let mut levels = Vec::new();
        for (index, reach) in reaches.enumerate().take_while(|&(_, reach)| reach >= 2) {
            let shape = LevelShape { block: cover.block(index), reach, ..*shape };
            let mut level = Self::new(&shape, &mut plans, unit);
            scratch.resize(level.scratch().max(scratch.len()), Complex::default());
            while level.missing_distance() <= reach {
                level.add_distance(planes, scratch);
            }
            levels.push(level);
        }
        levels
    }

    /// Largest block distance that the level serves.
    pub(crate) fn reach(&self) -> usize {
        self.slots + 1
    }

    pub(crate) fn block(&self) -> usize {
        self.block
    }

    /// Complex numbers of scratch that a task needs.
    pub(crate) fn scratch(&self) -> usize {
        self.transform.scratch()
    }

    /// Smallest block distance whose spectra are still missing.
    pub(crate) fn missing_distance(&self) -> usize {
        2 + self.kernel.len() / (self.stages * self.stages * self.transform.packets())
    }

    /// Computes the spectra of the first missing distance d from the weights of lags ((d−1)B, (d+1)B);
    /// weights
    /// beyond the end of a plane count as zero.
    pub(crate) fn add_distance(&mut self, planes: &[Vec<T>], scratch: &mut [Complex<f64>]) {
        let (block, packets) = (self.block, self.transform.packets());
        let first = (self.missing_distance() - 1) * block;
        let scale = T::of(1.0 / block as f64);
        for plane in planes {
            let start = self.kernel.len();
            self.kernel.resize(start + packets, Packet::zero());
            let spectrum = &mut self.kernel[start..];
            let weight = |lag: usize| plane.get(lag).map_or(T::zero(), |&weight| weight * scale);
            for (j, number) in self.polynomial.iter_mut().enumerate() {
                // No pair has the lag (d−1)B itself.
                let lower = if j == 0 { T::zero() } else { weight(first + j) };
                *number = Complex::new(lower, weight(first + block + j));
            }
            for piece in 0..self.transform.pieces() {
                self.transform.forward_in_place(piece, &mut self.polynomial, spectrum, scratch);
            }
        }
    }

    /// Number of tasks of the job that computes an output block from the given input blocks.
    pub(crate) fn tasks(&self, inputs: &Range<usize>) -> usize {
        self.channels * (self.transform.pieces() + self.tasks_per_channel(inputs))
    }

    fn tasks_per_channel(&self, inputs: &Range<usize>) -> usize {
        self.tiles() * self.groups(inputs) + self.transform.pieces()
    }

    fn tiles(&self) -> usize {
        self.transform.packets().div_ceil(TILE)
    }

    fn groups(&self, inputs: &Range<usize>) -> usize {
        (inputs.len() * self.stages).div_ceil(GROUP)
    }

    fn locate(&self, inputs: &Range<usize>, task: usize) -> TaskKind {
        let pieces = self.transform.pieces();
        if task < self.channels * pieces {
            return TaskKind::Forward { channel: task / pieces, piece: task % pieces };
        }
        let per_channel = self.tasks_per_channel(inputs);
        let channel = (task - self.channels * pieces) / per_channel;
        let within = (task - self.channels * pieces) % per_channel;
        let groups = self.groups(inputs);
        if within < self.tiles() * groups {
            TaskKind::Products { channel, tile: within / groups, group: within % groups }
        } else {
            TaskKind::Inverse { channel, piece: within - self.tiles() * groups }
        }
    }

    /// Cost of a task, in complex multiply–adds.
    pub(crate) fn cost(&self, inputs: &Range<usize>, task: usize) -> usize {
        match self.locate(inputs, task) {
            TaskKind::Forward { piece, .. } => self.transform.forward_cost(piece),
            TaskKind::Products { group, .. } => {
                let products = GROUP.min(inputs.len() * self.stages - group * GROUP);
                products * PACKET * TILE.min(self.transform.packets())
            }
            TaskKind::Inverse { piece, .. } => self.transform.inverse_cost(piece),
        }
    }

    /// Runs one task of the job that computes output block `inputs.end + 1`, whose newest input block is
    /// `inputs.end − 1`. The tasks of a job are to be run in order.
    pub(crate) fn run(
        &mut self,
        inputs: &Range<usize>,
        task: usize,
        signal: &[Vec<T>],
        scratch: &mut [Complex<f64>],
    ) {
        let packets = self.transform.packets();
        match self.locate(inputs, task) {
            TaskKind::Forward { channel, piece } => {
                let newest = inputs.end - 1;
                let samples = &signal[channel][newest * self.block..(newest + 1) * self.block];
                let slot = (newest % self.slots * self.channels + channel) * packets;
                let spectrum = &mut self.signal[slot..slot + packets];
                self.transform.forward(piece, samples, spectrum, &mut self.polynomial, scratch);
            }
            TaskKind::Products { channel, tile, group } => self.products(inputs, channel, tile, group),
            TaskKind::Inverse { channel, piece } => {
                let place = ((inputs.end + 1) % self.outputs * self.channels + channel) * self.block;
                let output = &mut self.output[place..place + self.block];
                self.transform.inverse(piece, &self.sum, output, &mut self.polynomial, scratch);
            }
        }
    }

    fn products(&mut self, inputs: &Range<usize>, channel: usize, tile: usize, group: usize) {
        let first = group * GROUP;
        match inputs.len() * self.stages - first {
            1 => self.add_products::<1>(inputs, channel, tile, first),
            2 => self.add_products::<2>(inputs, channel, tile, first),
            3 => self.add_products::<3>(inputs, channel, tile, first),
            _ => self.add_products::<GROUP>(inputs, channel, tile, first),
        }
    }

    /// Adds M of the products X_{m′,s′}·W_{m−m′,s,s′} of an output, from the given one on; s′ is the fastest
    /// index.
    fn add_products<const M: usize>(
        &mut self,
        inputs: &Range<usize>,
        channel: usize,
        tile: usize,
        first: usize,
    ) {
        let (packets, stages) = (self.transform.packets(), self.stages);
        let tile = tile * TILE..packets.min((tile + 1) * TILE);
        let in_tile = |spectrum: usize| spectrum * packets + tile.start..spectrum * packets + tile.end;
        let (stage, group) = (channel % stages, channel - channel % stages);
        // Input blocks paired with the slots of the ring that contain their spectra.
        let oldest = inputs.start + first / stages;
        let slots = (oldest % self.slots..self.slots).chain(0..self.slots);
        let products = (oldest..inputs.end)
            .zip(slots)
            .flat_map(|(input, slot)| (0..stages).map(move |other| (input, slot, other)))
            .skip(first % stages);
        let mut signal: [&[Packet<T>]; M] = [&[]; M];
        let mut kernel: [&[Packet<T>]; M] = [&[]; M];
        for ((signal, kernel), (input, slot, other)) in signal.iter_mut().zip(&mut kernel).zip(products) {
            let distance = inputs.end - 1 - input;
            *signal = &self.signal[in_tile(slot * self.channels + group + other)];
            *kernel = &self.kernel[in_tile((distance * stages + stage) * stages + other)];
        }
        let sum = &mut self.sum[tile];
        if first == 0 {
            sum.fill(Packet::zero());
        }
        self.unit.dispatch(Products { sum, signal, kernel });
    }

    /// Adds the chunk of outputs at sample `k`, all of one block, to `row`.
    fn add_output(&self, channel: usize, k: usize, row: &mut Row<T>) {
        // Block sizes are powers of two, and so is the number of output blocks.
        let output = (k >> self.block.trailing_zeros()) & (self.outputs - 1);
        let place = (output * self.channels + channel) * self.block + (k & (self.block - 1));
        for (number, output) in row.0.iter_mut().zip(&self.output[place..place + CHUNK]) {
            *number += *output;
        }
    }

    /// Forgets all samples.
    pub(crate) fn clear(&mut self) {
        self.output.fill(T::zero());
    }

    pub(crate) fn bytes(&self) -> usize {
        self.transform.bytes()
            + size_of_val(self.kernel.as_slice())
            + size_of_val(self.signal.as_slice())
            + size_of_val(self.sum.as_slice())
            + size_of_val(self.polynomial.as_slice())
            + size_of_val(self.output.as_slice())
    }
}

/// Sum of the contributions of the levels to the chunk of outputs at sample `k`, the smallest parts first.
pub(crate) fn owed<T: Scalar>(levels: &[Level<T>], channel: usize, k: usize) -> Row<T> {
    let mut row = Row::zeros();
    levels.iter().rev().for_each(|level| level.add_output(channel, k, &mut row));
    row
}

enum TaskKind {
    Forward { channel: usize, piece: usize },
    Products { channel: usize, tile: usize, group: usize },
    Inverse { channel: usize, piece: usize },
}

/// sum += Σ signal·kernel, number by number.
pub(crate) struct Products<'a, T, const M: usize> {
    pub(crate) sum: &'a mut [Packet<T>],
    pub(crate) signal: [&'a [Packet<T>]; M],
    pub(crate) kernel: [&'a [Packet<T>]; M],
}

impl<T: Scalar, const M: usize> WithSimd for Products<'_, T, M> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, unit: S) {
        let count = self.sum.len();
        let signal = self.signal.map(|spectrum| &spectrum[..count]);
        let kernel = self.kernel.map(|spectrum| &spectrum[..count]);
        for (p, sum) in self.sum.iter_mut().enumerate() {
            let (sum_re, sum_im) = (T::reals_mut::<S>(&mut sum.re), T::reals_mut::<S>(&mut sum.im));
            for (v, (sum_re, sum_im)) in sum_re.iter_mut().zip(sum_im).enumerate() {
                let (mut re, mut im) = (*sum_re, *sum_im);
                for index in 0..M {
                    let (x, w) = (&signal[index][p], &kernel[index][p]);
                    let (x_re, x_im) = (T::reals::<S>(&x.re)[v], T::reals::<S>(&x.im)[v]);
                    let (w_re, w_im) = (T::reals::<S>(&w.re)[v], T::reals::<S>(&w.im)[v]);
                    re = T::minus_product(unit, x_im, w_im, T::plus_product(unit, x_re, w_re, re));
                    im = T::plus_product(unit, x_im, w_re, T::plus_product(unit, x_re, w_im, im));
                }
                (*sum_re, *sum_im) = (re, im);
            }
        }
    }
}
