//! A stage: spectra of the latest input blocks, and the job that computes an output block.

use core::ops::Range;

use pulp::Arch;
use rustfft::num_complex::Complex;

use crate::engines::level::Products;
use crate::engines::scalar::Scalar;
use crate::engines::stream::history::History;
use crate::engines::stream::partition::StagePlan;
use crate::engines::stream::prepared::PreparedResponses;
use crate::engines::transform::{PACKET, Packet, Transform};

/// Number of products added at a time.
const GROUP: usize = 4;

/// Cost of a task, about one complex multiply–add.
pub(crate) type Work = i64;

/// Bytes of spectra that stay in the cache of a core beside everything else, from one block to the next.
const CACHED: usize = 1 << 20;

/// Cost of waiting for spectra that do not: for each place at which a task begins to read or write.
const WAIT: usize = 128;

/// What the tasks of a stage read besides its own numbers.
pub(crate) struct Context<'a, T: Scalar> {
    pub(crate) index: usize,
    pub(crate) plan: &'a StagePlan,
    pub(crate) transform: &'a Transform<T>,
    /// Packets of a tile, a divisor of those of a spectrum.
    pub(crate) tile: usize,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) unit: Arch,
    pub(crate) history: &'a History<T>,
    /// The responses in use, and during an exchange the others.
    pub(crate) banks: &'a [Option<PreparedResponses<T>>; 2],
}

/// Spectra, outputs and the current job of a stage.
pub(crate) struct Stage<T: Scalar> {
    /// Spectra of the last input blocks, tile by tile for each input: what is multiplied together is close
    /// together.
    signal: Vec<Packet<T>>,
    slots: usize,
    /// The spectrum of an input while it is computed, then the sum of the products of an output.
    sum: Vec<Packet<T>>,
    polynomial: Vec<Complex<T>>,
    /// For each bank the last two output blocks, one output after the other in each.
    output: Vec<T>,
    job: Option<Job>,
    /// Cost of waiting for spectra.
    wait: usize,
    /// Cost of a transform of an input block.
    forward_cost: usize,
    /// Cost of a transform of an output block.
    inverse_cost: usize,
}

/// Job of one output block.
#[derive(Clone, Debug)]
struct Job {
    output: u64,
    inputs: Range<u64>,
    bank: usize,
    /// The bank that is computed after the first.
    then: Option<usize>,
    place: Place,
}

/// The next task of a job.
#[derive(Clone, Copy, Debug)]
enum Place {
    Forward { input: usize, piece: usize },
    Products { second: bool, output: usize, tile: usize, group: usize },
    Inverse { second: bool, output: usize, piece: usize },
}

/// Cost of a piece of a transform of an input block, with waiting where it writes to the spectra.
fn forward_cost<T: Scalar>(transform: &Transform<T>, wait: usize, piece: usize) -> usize {
    transform.forward_cost(piece) + if transform.packets_of(piece).is_empty() { 0 } else { wait }
}

impl<T: Scalar> Stage<T> {
    /// A stage whose responses have so many packets.
    pub(crate) fn new(
        plan: &StagePlan,
        transform: &Transform<T>,
        (inputs, outputs): (usize, usize),
        responses: usize,
    ) -> Self {
        let packets = transform.packets();
        // An exchange computes the present output block again after the input for the next one has come.
        let slots = plan.reach + 1;
        let signal = vec![Packet::zero(); slots * inputs * packets];
        let bytes = (signal.len() + responses) * size_of::<Packet<T>>();
        let wait = if bytes > CACHED { WAIT } else { 0 };
        Self {
            signal,
            slots,
            sum: vec![Packet::zero(); packets],
            polynomial: vec![Complex::new(T::zero(), T::zero()); plan.block],
            output: vec![T::zero(); 2 * 2 * outputs * plan.block],
            job: None,
            wait,
            forward_cost: (0..transform.pieces()).map(|piece| forward_cost(transform, wait, piece)).sum(),
            inverse_cost: (0..transform.pieces()).map(|piece| transform.inverse_cost(piece)).sum(),
        }
    }

    /// Releases the job of an output block, whose newest input block has come.
    pub(crate) fn release(&mut self, with: &Context<'_, T>, output: u64, bank: usize, then: Option<usize>) {
        let inputs = with.plan.inputs(output, with.plan.nearest);
        if inputs.is_empty() {
            for bank in [Some(bank), then].into_iter().flatten() {
                (0..with.outputs).for_each(|o| self.output_mut(with, bank, output, o).fill(T::zero()));
            }
            return;
        }
        let place = Place::Forward { input: 0, piece: 0 };
        self.job = Some(Job { output, inputs, bank, then, place });
    }

    /// True if there is work.
    pub(crate) fn is_busy(&self) -> bool {
        self.job.is_some()
    }

    /// Does all that is left of the job.
    pub(crate) fn finish(&mut self, with: &Context<'_, T>, scratch: &mut [Complex<f64>]) {
        while self.job.is_some() {
            self.run_task(with, scratch);
        }
    }

    /// Ends the work for all banks but one.
    pub(crate) fn keep_bank(&mut self, bank: usize) {
        let Some(job) = &mut self.job else { return };
        if job.then == Some(bank) {
            job.place = match job.place {
                Place::Products { second: true, output, tile, group } => {
                    Place::Products { second: false, output, tile, group }
                }
                Place::Inverse { second: true, output, piece } => {
                    Place::Inverse { second: false, output, piece }
                }
                Place::Forward { input, piece } => Place::Forward { input, piece },
                _ => Place::Products { second: false, output: 0, tile: 0, group: 0 },
            };
            job.bank = bank;
        }
        job.then = None;
    }

    /// Transforms one input block of all inputs.
    pub(crate) fn transform_input(
        &mut self,
        with: &Context<'_, T>,
        block: u64,
        scratch: &mut [Complex<f64>],
    ) {
        for input in 0..with.inputs {
            for piece in 0..with.transform.pieces() {
                self.forward(with, block, input, piece, scratch);
            }
        }
    }

    /// Computes an output block from input blocks that have been transformed, at distance `nearest` or more.
    pub(crate) fn compute(
        &mut self,
        with: &Context<'_, T>,
        output: u64,
        nearest: usize,
        bank: usize,
        scratch: &mut [Complex<f64>],
    ) {
        let inputs = with.plan.inputs(output, nearest);
        if inputs.is_empty() {
            (0..with.outputs).for_each(|o| self.output_mut(with, bank, output, o).fill(T::zero()));
            return;
        }
        let place = Place::Products { second: false, output: 0, tile: 0, group: 0 };
        let job = Job { output, inputs, bank, then: None, place };
        let waiting = self.job.replace(job);
        self.finish(with, scratch);
        self.job = waiting;
    }

    /// Cost of the most expensive job for the banks in use.
    pub(crate) fn largest_cost(&self, with: &Context<'_, T>) -> Work {
        let of_output = |bank: &PreparedResponses<T>, output| {
            let products = bank.paths(output).len() * with.plan.most_inputs();
            let (groups, rest) = (products / GROUP, products % GROUP);
            let last = if rest > 0 || groups == 0 { self.group_cost(with, rest) } else { 0 };
            let of_tile = groups * self.group_cost(with, GROUP) + last;
            self.inverse_cost + with.transform.packets() / with.tile * of_tile
        };
        let banks = with.banks.iter().flatten();
        let products = banks.flat_map(|bank| (0..with.outputs).map(move |output| of_output(bank, output)));
        (with.inputs * self.forward_cost + products.sum::<usize>()) as Work
    }

    /// Cost of a group of products, which reads spectra of the signal and of a response. One without products
    /// clears the sum.
    fn group_cost(&self, with: &Context<'_, T>, products: usize) -> usize {
        products.max(1) * PACKET * with.tile + 2 * self.wait
    }

    /// Cost of the most expensive task.
    pub(crate) fn largest_task(&self, with: &Context<'_, T>) -> Work {
        let products = self.group_cost(with, GROUP);
        let pieces = (0..with.transform.pieces()).map(|piece| forward_cost(with.transform, self.wait, piece));
        pieces.max().unwrap_or(0).max(products) as Work
    }

    /// Runs the next task of the job, if there is one, and returns its cost.
    pub(crate) fn run_task(&mut self, with: &Context<'_, T>, scratch: &mut [Complex<f64>]) -> Work {
        let Some(mut job) = self.job.take() else { return 0 };
        let bank = |second: bool| if second { job.then.unwrap_or(job.bank) } else { job.bank };
        let pieces = with.transform.pieces();
        let (cost, next) = match job.place {
            Place::Forward { input, piece } => {
                self.forward(with, job.inputs.end - 1, input, piece, scratch);
                let next = match (piece + 1 < pieces, input + 1 < with.inputs) {
                    (true, _) => Place::Forward { input, piece: piece + 1 },
                    (_, true) => Place::Forward { input: input + 1, piece: 0 },
                    _ => Place::Products { second: false, output: 0, tile: 0, group: 0 },
                };
                (forward_cost(with.transform, self.wait, piece), Some(next))
            }
            Place::Products { second, output, tile, group } => {
                let paths = with.banks[bank(second)].as_ref().map_or(0, |bank| bank.paths(output).len());
                let products = paths * (job.inputs.end - job.inputs.start) as usize;
                let cost = self.products(with, &job, bank(second), (output, tile, group), products);
                let tiles = with.transform.packets() / with.tile;
                let next = match ((group + 1) * GROUP < products, tile + 1 < tiles) {
                    (true, _) => Place::Products { second, output, tile, group: group + 1 },
                    (_, true) => Place::Products { second, output, tile: tile + 1, group: 0 },
                    _ => Place::Inverse { second, output, piece: 0 },
                };
                (cost, Some(next))
            }
            Place::Inverse { second, output, piece } => {
                let first = self.output_place(with, bank(second), job.output, output);
                let numbers = &mut self.output[first..first + with.plan.block];
                with.transform.inverse(piece, &self.sum, numbers, &mut self.polynomial, scratch);
                let begin = |second, output| Place::Products { second, output, tile: 0, group: 0 };
                let next = match (piece + 1 < pieces, output + 1 < with.outputs, job.then) {
                    (true, ..) => Some(Place::Inverse { second, output, piece: piece + 1 }),
                    (_, true, _) => Some(begin(second, output + 1)),
                    (_, _, Some(_)) if !second => Some(begin(true, 0)),
                    _ => None,
                };
                (with.transform.inverse_cost(piece), next)
            }
        };
        self.job = next.map(|place| {
            job.place = place;
            job
        });
        cost as Work
    }

    fn forward(
        &mut self,
        with: &Context<'_, T>,
        block: u64,
        input: usize,
        piece: usize,
        scratch: &mut [Complex<f64>],
    ) {
        let length = with.plan.block;
        let samples = with.history.samples(input, block * length as u64, length);
        with.transform.forward(piece, samples, &mut self.sum, &mut self.polynomial, scratch);
        let slot = self.slot(block);
        for packet in with.transform.packets_of(piece) {
            let place = self.signal_place(with, input, packet / with.tile, slot) + packet % with.tile;
            self.signal[place] = self.sum[packet];
        }
    }

    /// Place of a tile of the spectrum in a slot of an input.
    fn signal_place(&self, with: &Context<'_, T>, input: usize, tile: usize, slot: usize) -> usize {
        let tiles = with.transform.packets() / with.tile;
        ((input * tiles + tile) * self.slots + slot) * with.tile
    }

    fn slot(&self, block: u64) -> usize {
        (block % self.slots as u64) as usize
    }

    /// A group of products of an output in a tile of the spectrum; returns the cost.
    fn products(
        &mut self,
        with: &Context<'_, T>,
        job: &Job,
        bank: usize,
        (output, tile, group): (usize, usize, usize),
        products: usize,
    ) -> usize {
        if group == 0 {
            self.sum[tile * with.tile..(tile + 1) * with.tile].fill(Packet::zero());
        }
        let first = group * GROUP;
        let cost = self.group_cost(with, GROUP.min(products - first.min(products)));
        let Some(responses) = &with.banks[bank] else { return cost };
        let at = (output, tile, first);
        match products - first.min(products) {
            0 => {}
            1 => self.add_products::<1>(with, job, responses, at),
            2 => self.add_products::<2>(with, job, responses, at),
            3 => self.add_products::<3>(with, job, responses, at),
            _ => self.add_products::<GROUP>(with, job, responses, at),
        }
        cost
    }

    /// Adds M of the products X_{i,m′} W_{o,i,m−m′} of an output, from the given one on; m′ is the fastest
    /// index.
    fn add_products<const M: usize>(
        &mut self,
        with: &Context<'_, T>,
        job: &Job,
        responses: &PreparedResponses<T>,
        (output, tile, first): (usize, usize, usize),
    ) {
        let tiles = with.transform.packets() / with.tile;
        let distances = with.plan.most_inputs();
        let of_path = (job.inputs.end - job.inputs.start) as usize;
        let paths = responses.paths(output);
        let spectra = &responses.spectra[with.index];
        let mut signal: [&[Packet<T>]; M] = [&[]; M];
        let mut kernel: [&[Packet<T>]; M] = [&[]; M];
        for (place, (signal, kernel)) in (first..).zip(signal.iter_mut().zip(&mut kernel)) {
            let path = &paths[place / of_path];
            let input = job.inputs.start + (place % of_path) as u64;
            let distance = (job.output - input) as usize - with.plan.nearest;
            let place = self.signal_place(with, path.input, tile, self.slot(input));
            *signal = &self.signal[place..place + with.tile];
            let place = ((path.filter * tiles + tile) * distances + distance) * with.tile;
            *kernel = &spectra[place..place + with.tile];
        }
        let sum = &mut self.sum[tile * with.tile..(tile + 1) * with.tile];
        with.unit.dispatch(Products { sum, signal, kernel });
    }

    fn output_place(&self, with: &Context<'_, T>, bank: usize, block: u64, output: usize) -> usize {
        ((bank * 2 + (block % 2) as usize) * with.outputs + output) * with.plan.block
    }

    fn output_mut(&mut self, with: &Context<'_, T>, bank: usize, block: u64, output: usize) -> &mut [T] {
        let first = self.output_place(with, bank, block, output);
        &mut self.output[first..first + with.plan.block]
    }

    /// Adds the outputs from sample k on, all of one block.
    pub(crate) fn add_output(
        &self,
        with: &Context<'_, T>,
        bank: usize,
        output: usize,
        k: u64,
        row: &mut [T],
    ) {
        let block = with.plan.block as u64;
        let first = self.output_place(with, bank, k / block, output) + (k % block) as usize;
        for (number, output) in row.iter_mut().zip(&self.output[first..]) {
            *number += *output;
        }
    }

    /// Forgets all samples.
    pub(crate) fn clear(&mut self) {
        self.output.fill(T::zero());
        self.job = None;
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.signal.as_slice())
            + size_of_val(self.sum.as_slice())
            + size_of_val(self.polynomial.as_slice())
            + size_of_val(self.output.as_slice())
    }
}

#[cfg(test)]
impl<T: Scalar> Stage<T> {
    /// Tile and group of the products that are next in the current job, if they are.
    pub(crate) fn next_products(&self) -> Option<(usize, usize)> {
        match self.job.as_ref()?.place {
            Place::Products { tile, group, .. } => Some((tile, group)),
            _ => None,
        }
    }
}
