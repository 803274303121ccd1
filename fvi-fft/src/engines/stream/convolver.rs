//! The convolver: near part, stages, exchange of responses, schedule, saved state.

use std::sync::Arc;

use fvi_core::{
    ParameterError, Shape, StateError, StateReader, StateWriter, Stateful, fingerprint, header_bytes,
};
use rustfft::num_complex::Complex;

use crate::engines::scalar::Scalar;
use crate::engines::stream::error::{ExchangeError, StreamError};
use crate::engines::stream::history::History;
use crate::engines::stream::near::Recent;
use crate::engines::stream::partition::{Partition, Stream};
use crate::engines::stream::prepared::{Geometry, PreparedResponses, Preparer};
use crate::engines::stream::responses::Responses;
use crate::engines::stream::stage::{Context, Stage, Work};

/// Convolution of an endless stream with finite responses, in blocks of any size, at a bounded cost per
/// sample.
///
/// y_o(k) = Σ_i Σ_{n=0}^{L−1} w_{oi}(n) x_i(k − latency − n) ,     x_i(j) = 0 for j < 0.
///
/// The error is a few units of rounding of Σ|w| max|x|, however long the stream is, for nothing is carried
/// from one block to the next. Only at the ends of the range of numbers is it larger: with B the largest
/// block of [`stages`](Self::stages), transforms overflow where B max|x| max(1, Σ|w|) comes near the largest
/// number, and weights below B times the smallest normal number lose digits.
///
/// Short lags are summed directly, or, for calls of a known length, by transforms of that length; the rest
/// is divided into stages of growing blocks. Each stage transforms every input block once, multiplies
/// spectra and transforms every output block back. Block sizes are chosen by a model of the cost. The work
/// of a stage is cut into small tasks and done evenly between the end of an input block and the beginning of
/// the output block that needs it, with deadlines as in [`RealTime`](crate::RealTime).
///
/// [`process`](Self::process) does not allocate, free, lock or wait. Responses are
/// [exchanged](Self::exchange) while the stream runs; what is prepared on another thread is sent to the
/// stream's, and what was used before comes back to be freed elsewhere.
///
/// ```
/// use fvi_fft::{Convolver, Responses, Stream};
///
/// let response = Responses::one(&[0.5, 0.25, 0.125])?;
/// let mut convolver = Convolver::new(&response, &Stream::default())?;
/// let mut output = [0.0; 4];
/// convolver.process_one(&[1.0, 0.0, 0.0, 2.0], &mut output)?;
/// assert_eq!(output, [0.5, 0.25, 0.125, 1.0]);
///
/// // On any thread.
/// let preparer = convolver.preparer();
/// let other = preparer.prepare(&Responses::one(&[1.0])?)?;
/// // On the stream's: from here on the sum of (1 − g) times the old output and g times the new one.
/// convolver.exchange(other, 2)?;
/// convolver.process_one(&[0.0; 4], &mut output)?;
/// assert_eq!(output, [0.5, 0.125, 0.0, 0.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Source: \[Gardner95\], \[Garcia02\], \[Battenberg11\].
pub struct Convolver<T: Scalar> {
    geometry: Arc<Geometry<T>>,
    /// The responses in use, and during an exchange the others.
    banks: [Option<PreparedResponses<T>>; 2],
    active: usize,
    exchange: Option<Exchange>,
    retired: Option<PreparedResponses<T>>,
    stages: Vec<Stage<T>>,
    history: History<T>,
    recent: Recent<T>,
    /// Outputs of a chunk with the new responses.
    mixed: Vec<T>,
    scratch: Vec<Complex<f64>>,
    /// Samples taken.
    len: u64,
    /// Input blocks that the stage without schedule has transformed.
    transformed: u64,
    budget: Work,
    /// Work that may still be done; negative after a task that cost more than the remaining budget.
    credit: Work,
    /// Until this sample jobs may be left that were planned for two banks.
    wide_until: u64,
    overruns: u64,
}

/// A change of responses under way.
#[derive(Clone, Copy, Debug)]
struct Exchange {
    /// The first sample of the fade.
    start: u64,
    /// Its length.
    fade: u64,
}

/// What an exchange that has begun returns.
pub struct Exchanged<T: Scalar> {
    /// Samples until the fade begins.
    pub begins_in: u64,
    /// The responses that an earlier exchange has put out of use, unless they were
    /// [taken](Convolver::take_retired) before.
    pub retired: Option<PreparedResponses<T>>,
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"strm";

/// Margin of the per-step budget over the mean cost of the jobs, in percent.
const RESERVE: Work = 5;

/// Most samples in a saved state: more than a century at a gigahertz.
const MOST_SAMPLES: u64 = 1 << 62;

/// What the tasks of a stage read.
fn context<'a, T: Scalar>(
    geometry: &'a Geometry<T>,
    index: usize,
    history: &'a History<T>,
    banks: &'a [Option<PreparedResponses<T>>; 2],
) -> Context<'a, T> {
    Context {
        index,
        plan: &geometry.partition.stages[index],
        transform: &geometry.transforms[index],
        tile: geometry.tile(index),
        inputs: geometry.inputs,
        outputs: geometry.outputs,
        unit: geometry.unit,
        history,
        banks,
    }
}

impl<T: Scalar> Convolver<T> {
    /// A convolver for the responses; everything is planned and allocated here.
    ///
    /// # Errors
    /// If the latency, the block or the longest response of `stream` is out of range.
    pub fn new(responses: &Responses<T>, stream: &Stream) -> Result<Self, ParameterError> {
        let partition = Partition::new(responses, stream)?;
        let (inputs, outputs) = (responses.inputs(), responses.outputs());
        let geometry = Arc::new(Geometry::new(partition, inputs, outputs));
        let prepared = Preparer::new(geometry.clone()).prepare(responses)?;
        let partition = &geometry.partition;
        let stages = partition.stages.iter().zip(&geometry.transforms).zip(&prepared.spectra);
        let stages = stages
            .map(|((plan, transform), spectra)| Stage::new(plan, transform, (inputs, outputs), spectra.len()))
            .collect();
        let mut convolver = Self {
            banks: [Some(prepared), None],
            active: 0,
            exchange: None,
            retired: None,
            stages,
            history: History::new(inputs, partition.history()),
            recent: Recent::new(inputs, partition.first, geometry.back(), geometry.unit),
            mixed: vec![T::zero(); partition.first],
            scratch: geometry.scratch(),
            len: 0,
            transformed: 0,
            budget: 0,
            credit: 0,
            wide_until: 0,
            overruns: 0,
            geometry,
        };
        convolver.budget = convolver.budget();
        Ok(convolver)
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.geometry.inputs
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.geometry.outputs
    }

    /// Samples by which outputs come later than by the definition of the convolution.
    pub fn latency(&self) -> usize {
        self.geometry.partition.latency
    }

    /// Samples of the longest response that can be exchanged for the present ones.
    pub fn longest(&self) -> usize {
        self.geometry.partition.lags - self.latency()
    }

    /// Samples taken since the beginning.
    pub fn taken(&self) -> u64 {
        self.len
    }

    /// Number of blocks that were not done when they were due, and were then finished at once. The schedule
    /// keeps it at zero.
    pub fn overruns(&self) -> u64 {
        self.overruns
    }

    /// Samples of a block in each stage, with the largest number of block pairs of an output; finest first.
    pub fn stages(&self) -> impl Iterator<Item = (usize, usize)> {
        self.geometry.partition.stages.iter().map(|stage| (stage.block, stage.most_inputs()))
    }

    /// Bytes of tables and state.
    pub fn bytes(&self) -> usize {
        let banks = self.banks.iter().chain([&self.retired]).flatten().map(PreparedResponses::bytes);
        let transforms = self.geometry.transforms.iter().map(|transform| transform.bytes());
        size_of::<Self>()
            + banks.sum::<usize>()
            + transforms.sum::<usize>()
            + self.stages.iter().map(Stage::bytes).sum::<usize>()
            + self.history.bytes()
            + self.recent.bytes()
            + size_of_val(self.mixed.as_slice())
            + size_of_val(self.scratch.as_slice())
    }

    /// What makes responses ready for an exchange, on any thread.
    pub fn preparer(&self) -> Preparer<T> {
        Preparer::new(self.geometry.clone())
    }

    /// Takes the next samples of each input and writes as many of each output.
    ///
    /// # Errors
    /// [`StreamError`] if there are not as many inputs and outputs as the responses have, if they differ in
    /// length, or if a sample is not finite; the convolver is then unchanged.
    pub fn process<I: AsRef<[T]>, O: AsMut<[T]>>(
        &mut self,
        inputs: &[I],
        outputs: &mut [O],
    ) -> Result<(), StreamError> {
        let count = self.check(inputs, outputs)?;
        let first = self.geometry.partition.first;
        let mut at = 0;
        while at < count {
            let place = self.place();
            let samples = (count - at).min(first - place);
            let whole = self.geometry.partition.at_once && samples == first;
            self.begin(whole);
            for (input, numbers) in inputs.iter().enumerate() {
                self.store(input, &numbers.as_ref()[at..at + samples], whole);
            }
            self.transform_at_once(whole);
            for (output, numbers) in outputs.iter_mut().enumerate() {
                self.write(output, &mut numbers.as_mut()[at..at + samples], whole);
            }
            self.resume(samples);
            at += samples;
        }
        Ok(())
    }

    /// The same for one input and one output.
    ///
    /// # Errors
    /// As [`process`](Self::process).
    pub fn process_one(&mut self, input: &[T], output: &mut [T]) -> Result<(), StreamError> {
        self.process(&[input], &mut [output])
    }

    /// The number of samples of a call.
    fn check<I: AsRef<[T]>, O: AsMut<[T]>>(
        &self,
        inputs: &[I],
        outputs: &mut [O],
    ) -> Result<usize, StreamError> {
        for (what, expected, found) in
            [("inputs", self.inputs(), inputs.len()), ("outputs", self.outputs(), outputs.len())]
        {
            if expected != found {
                return Err(StreamError::Channels { what, expected, found });
            }
        }
        let expected = inputs.first().map_or(0, |input| input.as_ref().len());
        let lengths = inputs.iter().map(|input| ("inputs", input.as_ref().len())).enumerate();
        let of_outputs = outputs.iter_mut().map(|output| ("outputs", output.as_mut().len())).enumerate();
        for (channel, (what, found)) in lengths.chain(of_outputs) {
            if found != expected {
                return Err(StreamError::Samples { what, channel, expected, found });
            }
        }
        for (channel, input) in inputs.iter().enumerate() {
            if let Some(sample) = input.as_ref().iter().position(|sample| !sample.is_finite()) {
                return Err(StreamError::NotFinite { channel, sample });
            }
        }
        Ok(expected)
    }

    /// Place of the next sample in its block of the near part.
    fn place(&self) -> usize {
        (self.len % self.geometry.partition.first as u64) as usize
    }

    /// The bank that is needed besides the active one for a block that ends before sample `end`.
    fn other(&self, end: u64) -> Option<usize> {
        self.exchange.filter(|exchange| end > exchange.start).map(|_| 1 - self.active)
    }

    /// Begins a block, if its first sample is next.
    fn begin(&mut self, whole: bool) {
        if self.place() == 0 && self.geometry.partition.at_once && !whole {
            self.recent.begin_block();
        }
    }

    fn store(&mut self, input: usize, samples: &[T], whole: bool) {
        self.history.samples_mut(input, self.len, samples.len()).copy_from_slice(samples);
        if !whole {
            let place = self.place();
            self.recent.store(input, place, samples);
        }
    }

    /// The work of the stage without schedule, if the block that it is for begins.
    fn transform_at_once(&mut self, whole: bool) {
        if self.place() != 0 || !self.geometry.partition.at_once {
            return;
        }
        let block = self.len / self.geometry.partition.first as u64;
        let then = self.other(self.len + self.geometry.partition.first as u64);
        let Self { geometry, history, banks, stages, scratch, transformed, active, .. } = self;
        let with = context(geometry, 0, history, banks);
        let Some(stage) = stages.first_mut() else { return };
        let come = if whole { block + 1 } else { block };
        // At most the last block and this one.
        while *transformed < come {
            stage.transform_input(&with, *transformed, scratch);
            *transformed += 1;
        }
        for bank in [Some(*active), then].into_iter().flatten() {
            stage.compute(&with, block, usize::from(!whole), bank, scratch);
        }
    }

    /// Writes outputs from the next sample on.
    fn write(&mut self, output: usize, numbers: &mut [T], whole: bool) {
        self.sum(self.active, output, numbers, whole);
        let Some(Exchange { start, fade }) = self.exchange.filter(|exchange| exchange.start <= self.len)
        else {
            return;
        };
        let mut mixed = core::mem::take(&mut self.mixed);
        let new = &mut mixed[..numbers.len()];
        self.sum(1 - self.active, output, new, whole);
        for (k, (number, &new)) in (self.len - start..).zip(numbers.iter_mut().zip(&*new)) {
            let share = if k < fade { T::of(k as f64 / fade as f64) } else { T::one() };
            *number = (T::one() - share) * *number + share * new;
        }
        self.mixed = mixed;
    }

    /// Outputs from the next sample on with the responses of a bank.
    fn sum(&self, bank: usize, output: usize, numbers: &mut [T], whole: bool) {
        let Self { geometry, history, banks, stages, .. } = self;
        numbers.fill(T::zero());
        for (index, stage) in stages.iter().enumerate().rev() {
            let with = context(geometry, index, history, banks);
            stage.add_output(&with, bank, output, self.len, numbers);
        }
        if !whole && let Some(responses) = &banks[bank] {
            let place = self.place();
            for path in responses.paths(output) {
                self.recent.add(path.input, &responses.near[path.filter], place, numbers);
            }
        }
    }

    /// Counts samples that were taken, and does the work of the stages for as many.
    fn resume(&mut self, samples: usize) {
        // Between the release of a job and its end lie chunks of B samples, whose work is done before.
        self.work(samples as Work);
        self.len += samples as u64;
        if self.place() == 0 {
            if !self.geometry.partition.at_once {
                self.recent.begin_block();
            }
            self.turn_blocks();
        }
        self.settle();
    }

    /// Finishes the jobs that are due now and releases those whose input is complete.
    fn turn_blocks(&mut self) {
        let k = self.len;
        let paced = usize::from(self.geometry.partition.at_once);
        for index in paced..self.stages.len() {
            let block = self.geometry.partition.stages[index].block as u64;
            if !k.is_multiple_of(block) {
                break;
            }
            let then = self.other(k + 2 * block);
            let Self { geometry, history, banks, stages, scratch, active, overruns, .. } = self;
            let (with, stage) = (context(geometry, index, history, banks), &mut stages[index]);
            if stage.is_busy() {
                *overruns += 1;
                stage.finish(&with, scratch);
            }
            stage.release(&with, k / block + 1, *active, then);
        }
    }

    /// Spends the work of so many samples on the finest stage that has work: its deadline is the earliest.
    fn work(&mut self, samples: Work) {
        let Self { geometry, history, banks, stages, scratch, .. } = self;
        // Unused budget of an idle step is dropped: the work of one step stays bounded.
        self.credit = self.credit.min(0) + self.budget * samples;
        for (index, stage) in stages.iter_mut().enumerate() {
            while self.credit > 0 && stage.is_busy() {
                let with = context(geometry, index, history, banks);
                self.credit -= stage.run_task(&with, scratch);
            }
        }
    }

    /// The work of a sample: that of the largest job of each stage, spread over its block, and the largest
    /// task, which may have just begun when a job of the finest stage is released.
    fn budget(&self) -> Work {
        let paced = usize::from(self.geometry.partition.at_once);
        let (mut jobs, mut task, mut finest) = (0, 0, None);
        for (index, stage) in self.stages.iter().enumerate().skip(paced) {
            let with = context(&self.geometry, index, &self.history, &self.banks);
            let block = with.plan.block as Work;
            jobs += (stage.largest_cost(&with) * (100 + RESERVE)).div_euclid(100 * block) + 1;
            task = stage.largest_task(&with).max(task);
            finest.get_or_insert(block);
        }
        jobs + finest.map_or(0, |block| task / block + 1)
    }

    /// Begins to exchange the responses: from the next sample on, with i = 0, 1, …,
    ///
    /// y = (1 − g) y_old + g y_new ,     g = min(1, i/fade) ,
    ///
    /// where y_old and y_new are the convolutions of the whole stream with the responses before and after.
    ///
    /// The new responses need the outputs of the blocks under way: this call computes them at once, which for
    /// long responses takes as long as some blocks of audio; [`exchange_evenly`](Self::exchange_evenly) does
    /// not. Neither allocates or frees.
    ///
    /// # Errors
    /// [`ExchangeError`] if an exchange is under way, or the responses were prepared for another convolver.
    pub fn exchange(
        &mut self,
        responses: PreparedResponses<T>,
        fade: usize,
    ) -> Result<Exchanged<T>, ExchangeError<T>> {
        self.enter(responses, self.len, fade)?;
        let retired = self.retired.take();
        self.catch_up(1 - self.active);
        self.settle();
        Ok(Exchanged { begins_in: 0, retired })
    }

    /// The same without any work here: the fade begins when the outputs of the new responses have been
    /// computed along with those of the old ones, after one to two blocks of the coarsest stage. Until it has
    /// ended the products of spectra cost twice as much.
    ///
    /// # Errors
    /// As [`exchange`](Self::exchange).
    pub fn exchange_evenly(
        &mut self,
        responses: PreparedResponses<T>,
        fade: usize,
    ) -> Result<Exchanged<T>, ExchangeError<T>> {
        let top = self.geometry.partition.top() as u64;
        let start = (self.len / top + 2) * top;
        self.enter(responses, start, fade)?;
        Ok(Exchanged { begins_in: start - self.len, retired: self.retired.take() })
    }

    /// Responses that an exchange has put out of use, to be freed on another thread or used again.
    pub fn take_retired(&mut self) -> Option<PreparedResponses<T>> {
        self.retired.take()
    }

    /// Samples until the exchange under way has ended; 0 if there is none.
    pub fn exchange_left(&self) -> u64 {
        self.exchange.map_or(0, |Exchange { start, fade }| (start + fade).saturating_sub(self.len))
    }

    fn enter(
        &mut self,
        responses: PreparedResponses<T>,
        start: u64,
        fade: usize,
    ) -> Result<(), ExchangeError<T>> {
        let (own, others) = (&self.geometry, &responses.geometry);
        let same = Arc::ptr_eq(own, others)
            || (own.partition == others.partition
                && own.inputs == others.inputs
                && own.outputs == others.outputs);
        if !same {
            return Err(ExchangeError::Foreign { responses });
        }
        if self.exchange.is_some() {
            return Err(ExchangeError::Busy { left: self.exchange_left(), responses });
        }
        self.banks[1 - self.active] = Some(responses);
        let fade = (fade as u64).min(MOST_SAMPLES);
        self.exchange = Some(Exchange { start, fade });
        self.wide_until = start.saturating_add(fade).saturating_add(self.geometry.partition.top() as u64);
        self.budget = self.budget();
        Ok(())
    }

    /// Computes the outputs of a bank for the blocks under way.
    fn catch_up(&mut self, bank: usize) {
        let (k, at_once) = (self.len, self.geometry.partition.at_once);
        let Self { geometry, history, banks, stages, scratch, .. } = self;
        for (index, stage) in stages.iter_mut().enumerate() {
            let with = context(geometry, index, history, banks);
            let (output, within) = (k / with.plan.block as u64, k % with.plan.block as u64);
            stage.finish(&with, scratch);
            if at_once && index == 0 {
                // Only a block that has begun in part; others are computed when they begin.
                if within > 0 {
                    stage.compute(&with, output, 1, bank, scratch);
                }
                continue;
            }
            for output in [output, output + 1] {
                stage.compute(&with, output, 2, bank, scratch);
            }
        }
    }

    /// Ends an exchange whose fade is over.
    fn settle(&mut self) {
        if let Some(Exchange { start, fade }) = self.exchange
            && self.len >= start
            && self.len - start >= fade
        {
            self.active = 1 - self.active;
            self.stages.iter_mut().for_each(|stage| stage.keep_bank(self.active));
            // The exchange has taken what was here.
            self.retired = self.banks[1 - self.active].take();
            self.exchange = None;
        }
        if self.wide_until > 0 && self.exchange.is_none() && self.len >= self.wide_until {
            self.wide_until = 0;
            self.budget = self.budget();
        }
    }

    /// Forgets all samples; an exchange under way ends.
    pub fn clear(&mut self) {
        if self.exchange.take().is_some() {
            self.active = 1 - self.active;
            self.retired = self.banks[1 - self.active].take();
        }
        self.wide_until = 0;
        self.budget = self.budget();
        self.forget();
    }

    fn forget(&mut self) {
        (self.len, self.transformed, self.credit, self.overruns) = (0, 0, 0, 0);
        self.stages.iter_mut().for_each(Stage::clear);
        self.history.clear();
        self.recent.clear();
    }

    /// Samples of each input in a saved state.
    fn saved_samples(&self, len: u64) -> u64 {
        len.min(self.history.length() as u64)
    }

    fn shape(&self) -> Shape<6> {
        let print = |bank: &Option<PreparedResponses<T>>| bank.as_ref().map_or(0, |bank| bank.fingerprint);
        let partition = &self.geometry.partition;
        let plan = partition.stages.iter().flat_map(|stage| [stage.block, stage.reach, stage.nearest]);
        let plan = plan.chain([partition.first, partition.grain.leaf]);
        let plan: Vec<f64> = plan.map(|number| number as f64).collect();
        [
            ("inputs", self.inputs() as u64),
            ("outputs", self.outputs() as u64),
            ("latency", self.latency() as u64),
            ("fingerprint of the partition", fingerprint(&plan)),
            ("fingerprint of the responses", print(&self.banks[self.active])),
            ("fingerprint of the responses to come", print(&self.banks[1 - self.active])),
        ]
    }

    /// Reads the header: samples taken, and the exchange under way.
    fn begin_state(&self, from: &mut StateReader<'_>) -> Result<(u64, Option<Exchange>), StateError> {
        from.header::<T, 6>(TAG, &self.shape())?;
        let mut counts = [0; 3];
        for (count, what) in counts.iter_mut().zip(["samples", "beginning of the fade", "fade"]) {
            *count = from.count()?;
            if *count > MOST_SAMPLES {
                return Err(StateError::TooLarge { what, limit: MOST_SAMPLES, found: *count });
            }
        }
        let [len, start, fade] = counts;
        Ok((len, self.exchange.map(|_| Exchange { start, fade })))
    }

    /// Computes what follows from the samples.
    fn recompute(&mut self) {
        let (k, at_once, first) = (self.len, self.geometry.partition.at_once, self.geometry.partition.first);
        let then = self.exchange.map(|_| 1 - self.active);
        let Self { geometry, history, banks, stages, scratch, active, .. } = self;
        for (index, stage) in stages.iter_mut().enumerate() {
            let with = context(geometry, index, history, banks);
            let block = with.plan.block as u64;
            let (output, within) = (k / block, k % block);
            for input in output.saturating_sub(with.plan.reach as u64)..output {
                stage.transform_input(&with, input, scratch);
            }
            let (outputs, nearest) = match at_once && index == 0 {
                true => (output..output + u64::from(within > 0), 1),
                false => (output..output + 2, 2),
            };
            for output in outputs {
                for bank in [Some(*active), then].into_iter().flatten() {
                    stage.compute(&with, output, nearest, bank, scratch);
                }
            }
        }
        self.transformed = k / first as u64;
        let begun = self.transformed * first as u64;
        for input in 0..geometry.inputs {
            let back = geometry.back() as u64;
            if back > 0 && begun >= back {
                let before = history.samples(input, begun - back, back as usize);
                self.recent.store_before(input, before);
            }
            let samples = history.samples(input, begun, (k - begun) as usize);
            self.recent.store(input, 0, samples);
        }
    }
}

impl<T: Scalar> Stateful for Convolver<T> {
    fn state_bytes(&self) -> usize {
        let samples = self.saved_samples(self.len) as usize * self.inputs();
        header_bytes(6) + 3 * 8 + samples * T::BYTES
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 6>(TAG, &self.shape())?;
        let Exchange { start, fade } = self.exchange.unwrap_or(Exchange { start: 0, fade: 0 });
        [self.len, start, fade].into_iter().try_for_each(|count| to.count(count))?;
        let times = self.len - self.saved_samples(self.len)..self.len;
        (0..self.inputs()).try_for_each(|input| to.numbers(self.history.range(input, times.clone())))
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let (len, _) = self.begin_state(from)?;
        from.skip::<T>((self.saved_samples(len) as usize).saturating_mul(self.inputs()))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        let (len, exchange) = self.begin_state(from)?;
        self.forget();
        for input in 0..self.inputs() {
            for k in len - self.saved_samples(len)..len {
                let sample = from.number()?;
                if let Some(place) = self.history.sample_mut(input, k) {
                    *place = sample;
                }
            }
        }
        (self.len, self.exchange) = (len, exchange);
        if let Some(Exchange { start, fade }) = exchange {
            self.wide_until = start + fade + self.geometry.partition.top() as u64;
        }
        self.recompute();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// They wait for memory, several times as long as they compute.
    #[test]
    fn a_single_sample_adds_one_group_of_products_of_spectra_that_are_not_in_the_cache() {
        let response: Vec<f32> = (0..200_000).map(|n| (-1e-5 * n as f32).exp()).collect();
        let stream = Stream { block: Some(1), ..Stream::default() };
        let mut convolver = Convolver::new(&Responses::one(&response).unwrap(), &stream).unwrap();
        convolver.process_one(&vec![0.5; 250_000], &mut vec![0.0; 250_000]).unwrap();
        let (mut before, mut added) = (None, 0);
        for _ in 0..40_000 {
            convolver.process_one(&[0.5], &mut [0.0]).unwrap();
            let next = convolver.stages.last().and_then(Stage::next_products);
            if let (Some((old_tile, old_group)), Some((tile, group))) = (before, next) {
                // The groups of a tile are followed by the first of the next one.
                let one = (tile, group) == (old_tile, old_group + 1) || (tile, group) == (old_tile + 1, 0);
                assert!((tile, group) == (old_tile, old_group) || one, "{before:?}, {next:?}");
                added += usize::from(one);
            }
            before = next;
        }
        assert!(added > 1000, "{added}");
        assert_eq!(convolver.overruns(), 0);
    }
}
