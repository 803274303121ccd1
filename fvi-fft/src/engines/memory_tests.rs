//! Every memory of this crate on small kernels: terms are those of the plain sum, refused calls change
//! nothing, restored memories continue with identical bits, and `bytes` is the size of tables and state.

use fvi_core::{
    ActsOn, ExponentialTable, Memory, MemoryError, Real, StateError, StateReader, StateWriter, Stateful,
    header_bytes,
};

use crate::baseline::{Hls, Naive, OfflineFft, Signal, memory_term};
use crate::{
    BlockFft, BoxedMemory, ChunkedExponentialSum, Engines, Pacing, RealTime, Scalar, WeightTable, Weights,
    WideExponentialSum,
};

/// Weights of S×S matrices without a pattern, slowly decaying, W₀ ≠ 0.
fn arbitrary<T: Real>(stages: usize, count: usize) -> Vec<T> {
    let entries = stages * stages;
    let number = |index: usize| {
        let (n, entry) = ((index / entries) as f64, (index % entries) as f64);
        T::of((0.7 * n * n + entry + 1.0).cos() / (1.0 + n).powf(0.8))
    };
    (0..count * entries).map(number).collect()
}

/// A table of exponentials with its own storage.
struct Exponentials {
    stages: usize,
    head: Vec<f64>,
    exponentials: Vec<f64>,
    horizon: usize,
}

impl Exponentials {
    /// Eighteen rates from one that never decays to one that alternates in sign, after a head of `head`
    /// weights.
    fn new(stages: usize, head: usize, horizon: usize) -> Self {
        let decays =
            [1e-7, 1e-5, 4e-4, 1e-3, 0.004, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8];
        let decays: Vec<f64> = decays.into_iter().chain([1.0, 1.4, 0.0, 0.0]).collect();
        let mut exponentials = Vec::new();
        for (block, decays) in decays.chunks(4).enumerate() {
            exponentials.extend(decays);
            let vectors = if stages == 1 { 1 } else { 2 * stages };
            for vector in 0..vectors {
                for lane in 0..4 {
                    let j = 4 * block + lane;
                    let size = 0.3 + (j as f64 + 0.37 * vector as f64).sin().abs();
                    exponentials.push(if j < 18 { size } else { 0.0 });
                }
            }
        }
        let number = |index: usize| {
            let (entry, n) = ((index / head) as f64, (index % head) as f64);
            (8.0 + entry) / (1.0 + n) + (n + entry).cos()
        };
        let head = (0..stages * stages * head).map(number).collect();
        Self { stages, head, exponentials, horizon }
    }

    fn table(&self) -> ExponentialTable<&[f64]> {
        let Self { stages, ref head, ref exponentials, horizon } = *self;
        let horizon = horizon as u64;
        ExponentialTable {
            stages,
            head,
            exponentials,
            slow_blocks: 0,
            far_blocks: 0,
            horizon,
            step_size: 1.0,
        }
    }

    /// The first `count` weights by the definition of a table, row by row.
    fn weights<T: Real>(&self, count: usize) -> Vec<T> {
        let (stages, entries) = (self.stages, self.stages * self.stages);
        let head = self.head.len() / entries;
        let mut weights = Vec::new();
        for n in 0..count {
            for (a, b) in (0..entries).map(|entry| (entry / stages, entry % stages)) {
                if n < head {
                    weights.push(T::of(self.head[(a * stages + b) * head + n]));
                    continue;
                }
                let vectors = if stages == 1 { 1 } else { 2 * stages };
                let part = |block: &[f64], lane: usize| {
                    let left = if block[lane] < 1.0 {
                        ((n - head) as f64 * (-block[lane]).ln_1p()).exp()
                    } else {
                        (1.0 - block[lane]).powi((n - head) as i32)
                    };
                    let input = if stages == 1 { 1.0 } else { block[(1 + stages + b) * 4 + lane] };
                    left * block[(1 + a) * 4 + lane] * input
                };
                let blocks = self.exponentials.chunks(4 * (1 + vectors));
                let sum = blocks.flat_map(|block| (0..4).map(move |lane| part(block, lane))).sum();
                weights.push(T::of(sum));
            }
        }
        weights
    }
}

/// Largest |r_k − reference| in units of u Σ|w||x|, over some 50 steps of a run.
fn largest_error<T: Real>(
    memory: &mut dyn Memory<T>,
    weights: &[T],
    signal: Signal,
    length: usize,
) -> (f64, usize) {
    let (channels, stages) = (memory.channels(), memory.stages());
    let samples = signal.samples::<T>(channels, length);
    let stride = length.div_ceil(40);
    let mut term = vec![T::of(f64::NAN); channels];
    let mut largest = (0.0, 0);
    for k in 0..length {
        memory.next_term(&mut term).unwrap();
        if k % stride == stride - 1 || k.is_power_of_two() || k + 2 >= length {
            for (number, reference) in term.iter().zip(memory_term(weights, stages, &samples, channels, k)) {
                let error = (number.to_f64() - reference.sum).abs() / reference.absolute;
                let error = error / (T::EPSILON.to_f64() / 2.0);
                if error > largest.0 || error.is_nan() {
                    largest = (error, k);
                }
            }
        }
        memory.push(&samples[k * channels..(k + 1) * channels]).unwrap();
    }
    largest
}

fn assert_plain_sum<T: Real>(
    name: &str,
    memory: &mut dyn Memory<T>,
    weights: &[T],
    length: usize,
    signals: &[Signal],
    bound: f64,
) {
    for &signal in signals {
        memory.clear();
        let (error, k) = largest_error(memory, weights, signal, length);
        let (channels, stages) = (memory.channels(), memory.stages());
        assert!(
            error <= bound,
            "{name}, {channels} channels, {stages} stages, {length} samples, {signal:?}: {error} u at {k}"
        );
    }
}

/// The engines for arbitrary kernels.
fn transform_engines<T: Scalar>(
    channels: usize,
    stages: usize,
    length: usize,
) -> [(&'static str, BoxedMemory<T>); 4] {
    let weights: &[T] = arbitrary::<T>(stages, length).leak();
    let table = WeightTable::matrices(weights, stages);
    [
        ("block-fft", Box::new(BlockFft::planned(table, channels, length).unwrap())),
        ("growing block-fft", {
            let table = WeightTable::matrices(weights, stages);
            Box::new(BlockFft::growing(table, channels).unwrap())
        }),
        ("paced real-time", Box::new(RealTime::planned(table, channels, length, Pacing::Paced).unwrap())),
        ("eager real-time", Box::new(RealTime::planned(table, channels, length, Pacing::Eager).unwrap())),
    ]
}

const SHORT: [Signal; 2] = [Signal::Stationary, Signal::Decaying];

#[test]
fn transforms_give_the_plain_sum_of_any_kernel() {
    for (channels, stages, length) in [(1, 1, 5000), (2, 1, 1500), (2, 2, 1500), (6, 3, 700), (1, 1, 20_000)]
    {
        let signals = if length > 10_000 { &SHORT[..1] } else { &SHORT };
        for (name, mut engine) in transform_engines::<f64>(channels, stages, length) {
            assert_plain_sum(name, &mut *engine, &arbitrary(stages, length), length, signals, 22.0);
        }
    }
    for (name, mut engine) in transform_engines::<f32>(1, 1, 3000) {
        assert_plain_sum(name, &mut *engine, &arbitrary(1, 3000), 3000, &SHORT, 22.0);
    }
}

#[test]
fn the_textbook_and_the_plain_double_sum_agree_on_signals_of_even_size() {
    for (channels, stages, length) in [(1, 1, 700), (4, 2, 300)] {
        let weights = arbitrary::<f64>(stages, length);
        let table = WeightTable::matrices(&weights, stages);
        let mut naive = Naive::planned(table, channels, length).unwrap();
        assert_plain_sum("naive", &mut naive, &weights, length, &SHORT, 100.0);
        let mut textbook = Hls::planned(table, channels, length).unwrap();
        assert_plain_sum("textbook", &mut textbook, &weights, length, &SHORT[..1], 300.0);
    }
}

#[test]
fn a_transform_of_everything_gives_the_terms_again_and_again() {
    let weights = arbitrary::<f64>(1, 500);
    let mut offline = OfflineFft::new(WeightTable::scalars(&weights), 500).unwrap();
    for signal in SHORT {
        let samples = signal.samples::<f64>(1, 500);
        let mut terms = vec![f64::NAN; 500];
        offline.convolve(&samples, &mut terms);
        for (k, term) in terms.into_iter().enumerate() {
            let error = term - memory_term(&weights, 1, &samples, 1, k)[0].sum;
            assert!(error.abs() < 1e-13, "k = {k}: {error:e}");
        }
    }
    // Two spectra of 513 complex numbers, 1024 real ones, scratch.
    let least = size_of::<OfflineFft>() + (2 * 513 + 512) * 16;
    assert!((least..least + 32_768).contains(&offline.bytes()), "{}", offline.bytes());
    assert_eq!(OfflineFft::new(WeightTable::scalars(&weights), 0).err().unwrap().parameter, "length");
    assert_eq!(OfflineFft::new(WeightTable::matrices(&weights, 2), 9).err().unwrap().parameter, "channels");
}

/// The memories for tables with one stage.
fn sums_of_exponentials<T: Scalar>(
    table: &Exponentials,
    channels: usize,
) -> [(&'static str, BoxedMemory<T>); 3] {
    let table = &table.table();
    [
        ("chunked", Box::new(ChunkedExponentialSum::<T, 1>::new(table, channels).unwrap())),
        ("wide", Box::new(WideExponentialSum::<T>::new(table, channels).unwrap())),
        ("wide on three threads", {
            Box::new(WideExponentialSum::<T>::new(table, channels).unwrap().on_threads(3))
        }),
    ]
}

#[test]
fn exponential_sums_give_the_plain_sum_of_their_table() {
    for head in [2, 9, 17, 18, 40] {
        let exponentials = Exponentials::new(1, head, 4000);
        for (name, mut engine) in sums_of_exponentials::<f64>(&exponentials, 2) {
            assert_plain_sum(name, &mut *engine, &exponentials.weights(1500), 1500, &SHORT, 28.0);
        }
    }
    let exponentials = Exponentials::new(1, 9, 20_000);
    for (name, mut engine) in sums_of_exponentials::<f32>(&exponentials, 1) {
        let signals = [Signal::Stationary, Signal::Constant];
        assert_plain_sum(name, &mut *engine, &exponentials.weights(20_000), 20_000, &signals, 8.0);
    }
    for (name, mut engine) in sums_of_exponentials::<f64>(&Exponentials::new(1, 9, 200), 333) {
        assert_plain_sum(name, &mut *engine, &exponentials.weights(200), 200, &SHORT, 28.0);
    }
}

#[test]
fn exponential_sums_of_matrices_give_the_plain_sum_of_their_table() {
    for (stages, head) in [(1, 5), (2, 2), (2, 20), (3, 7), (4, 40)] {
        let exponentials = Exponentials::new(stages, head, 1000);
        let mut engine = f64::exponential_sum(&exponentials.table(), 2 * stages).unwrap();
        assert_plain_sum("chunked", &mut *engine, &exponentials.weights(1000), 1000, &SHORT, 44.0);
        let mut engine = f32::exponential_sum(&exponentials.table(), stages).unwrap();
        assert_plain_sum("chunked", &mut *engine, &exponentials.weights(1000), 1000, &SHORT, 44.0);
    }
}

/// Tables with the same exponentials and different coefficients.
fn sharing() -> Vec<Exponentials> {
    let table = |factor: f64| {
        let mut table = Exponentials::new(1, 9, 1000);
        table.head.iter_mut().for_each(|weight| *weight *= 2.0 - factor);
        for block in table.exponentials.chunks_mut(8) {
            block[4..].iter_mut().enumerate().for_each(|(j, u)| *u *= factor + 0.1 * j as f64);
        }
        table
    };
    [1.0, 0.5, 1.7].map(table).into()
}

/// One of the kernels of a memory, as a memory by itself.
struct OneOf<'a, T> {
    memory: &'a mut dyn Memory<T>,
    kernel: usize,
}

impl<T: Real> Memory<T> for OneOf<'_, T> {
    fn channels(&self) -> usize {
        self.memory.channels()
    }

    fn leading(&self) -> &[T] {
        &self.memory.leading()[self.kernel..=self.kernel]
    }

    fn len(&self) -> usize {
        self.memory.len()
    }

    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        let mut terms = vec![T::of(f64::NAN); term.len() * self.memory.kernels()];
        self.memory.next_term(&mut terms)?;
        term.copy_from_slice(&terms[self.kernel * term.len()..][..term.len()]);
        Ok(())
    }

    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        self.memory.push(sample)
    }

    fn clear(&mut self) {
        self.memory.clear();
    }

    fn bytes(&self) -> usize {
        self.memory.bytes()
    }
}

impl<T: Real> Stateful for OneOf<'_, T> {}

#[test]
fn kernels_that_share_their_samples_have_terms_of_their_own() {
    let tables = sharing();
    let views: Vec<_> = tables.iter().map(Exponentials::table).collect();
    let mut engine = f64::wide_exponential_sum(&views, 70, 2).unwrap();
    let mut coarse = f64::wide_exponential_sum_in_f32(&views, 70, 2).unwrap();
    assert_eq!((engine.kernels(), engine.stages(), engine.channels()), (3, 1, 70));
    for (kernel, table) in tables.iter().enumerate() {
        let weights = table.weights(300);
        let mut one = OneOf { memory: &mut *engine, kernel };
        assert_eq!(one.leading(), &weights[..1]);
        assert_plain_sum("shared", &mut one, &weights, 300, &SHORT, 28.0);
        let mut one = OneOf { memory: &mut *coarse, kernel };
        // Tolerance for two units of single precision.
        assert_plain_sum("shared in single precision", &mut one, &weights, 300, &SHORT[..1], 2f64.powi(30));
        assert!(
            largest_error(
                &mut {
                    one.clear();
                    one
                },
                &weights,
                Signal::Stationary,
                300
            )
            .0 > 1000.0
        );
    }
    assert!(coarse.bytes() < engine.bytes());
}

#[test]
fn tables_that_do_not_share_their_exponentials_are_refused() {
    let refused = |change: &dyn Fn(&mut Exponentials)| {
        let mut tables = sharing();
        change(&mut tables[1]);
        let views: Vec<_> = tables.iter().map(Exponentials::table).collect();
        WideExponentialSum::<f64>::of_kernels(&views, 1).err().map(|error| error.parameter)
    };
    assert_eq!(refused(&|_| ()), None);
    assert_eq!(refused(&|table| table.head.truncate(8)), Some("head weights"));
    assert_eq!(refused(&|table| table.exponentials.truncate(16)), Some("exponentials"));
    assert_eq!(refused(&|table| table.exponentials[1] *= 1.5), Some("decay"));
    assert_eq!(refused(&|table| table.exponentials[1] = 2.5), Some("decay"));
    assert_eq!(refused(&|table| *table = Exponentials::new(2, 9, 1000)), Some("stages"));
    let table = Exponentials::new(1, 9, 1000);
    let tables = |count, channels| {
        let tables = vec![table.table(); count];
        WideExponentialSum::<f64>::of_kernels(&tables, channels).err().map(|error| error.parameter)
    };
    assert_eq!((tables(0, 1), tables(5, 1)), (Some("tables"), Some("tables")));
    assert_eq!((tables(1, 0), tables(4, 1)), (Some("channels"), None));
}

#[test]
fn kernels_of_no_or_five_stages_and_channels_without_a_partner_are_refused() {
    let weights = [1.0; 75];
    let refused = |stages, channels| {
        let table = WeightTable::matrices(&weights, stages);
        let errors = [
            BlockFft::planned(table, channels, 9).err(),
            BlockFft::growing(WeightTable::matrices(&[], stages), channels).map(|_: BlockFft<f64>| ()).err(),
            RealTime::planned(table, channels, 9, Pacing::Paced).err(),
            Naive::planned(table, channels, 9).err(),
            Hls::planned(table, channels, 9).err(),
        ];
        let parameters = errors.map(|error| error.map(|error| (error.parameter, error.value)));
        assert!(parameters.iter().all(|parameter| *parameter == parameters[0]), "{parameters:?}");
        parameters[0]
    };
    assert_eq!(refused(1, 1), None);
    assert_eq!(refused(5, 10), None);
    assert_eq!(refused(0, 1), Some(("stages", 0.0)));
    assert_eq!(refused(1, 0), Some(("channels", 0.0)));
    assert_eq!(refused(2, 3), Some(("channels", 3.0)));
    let five = Exponentials { stages: 5, head: vec![1.0; 50], exponentials: vec![], horizon: 9 };
    assert_eq!(f64::exponential_sum(&five.table(), 5).err().unwrap().parameter, "stages");
    let two = Exponentials::new(2, 4, 9);
    assert_eq!(ChunkedExponentialSum::<f64, 2>::new(&two.table(), 3).err().unwrap().parameter, "channels");
}

/// Expected properties of a memory.
struct Promise<'a, T> {
    name: &'static str,
    build: &'a dyn Fn() -> BoxedMemory<T>,
    channels: usize,
    stages: usize,
    kernels: usize,
    leading: Vec<T>,
    capacity: Option<usize>,
}

fn saved<T>(memory: &dyn Memory<T>) -> Vec<u8> {
    let mut bytes = vec![0; memory.state_bytes()];
    let mut writer = StateWriter::new(&mut bytes);
    memory.save(&mut writer).unwrap();
    assert_eq!(writer.written(), memory.state_bytes());
    bytes
}

impl<T: Scalar> Promise<'_, T> {
    fn term(&self, memory: &mut dyn Memory<T>) -> Vec<u64> {
        let mut term = vec![T::of(f64::NAN); self.channels * self.kernels];
        memory.next_term(&mut term).unwrap();
        term.iter().map(|number| number.bits()).collect()
    }

    /// Asserts the contract of the trait in runs of 400 samples, some of them interrupted by refused calls.
    fn assert_kept(&self) {
        let &Self { name, channels, stages, kernels, .. } = self;
        let length = self.capacity.unwrap_or(400).min(400);
        let samples = Signal::Stationary.samples::<T>(channels, length);
        let sample = |k: usize| &samples[k * channels..(k + 1) * channels];
        let mut memory = (self.build)();
        assert_eq!(
            (memory.channels(), memory.stages(), memory.kernels()),
            (channels, stages, kernels),
            "{name}"
        );
        assert_eq!((memory.len(), memory.is_empty(), memory.acts_on()), (0, true, ActsOn::Values), "{name}");
        assert!(memory.leading_is_constant() && memory.leading() == self.leading, "{name}");
        let mut terms = Vec::new();
        for k in 0..length {
            terms.push(self.term(&mut *memory));
            memory.push(sample(k)).unwrap();
            assert_eq!((memory.len(), memory.is_empty()), (k + 1, false), "{name}");
        }
        let mut term = vec![T::zero(); channels * kernels];
        if self.capacity == Some(length) {
            let full = Err(MemoryError::Full { capacity: length });
            assert_eq!((memory.next_term(&mut term), memory.push(sample(0))), (full, full), "{name}");
            assert_eq!(memory.len(), length, "{name}");
        }
        // Interrupted by refused calls, after samples that were cleared.
        memory.clear();
        for k in 0..length / 3 {
            memory.push(sample(length - 1 - k)).unwrap();
        }
        memory.clear();
        assert!(memory.is_empty(), "{name}");
        for (k, expected) in terms.iter().enumerate() {
            for found in [0, channels * kernels + 1] {
                let refusal = MemoryError::ChannelMismatch { expected: channels * kernels, found };
                assert_eq!(memory.next_term(&mut vec![T::zero(); found]), Err(refusal), "{name}");
            }
            for found in [0, channels + 1] {
                let refusal = MemoryError::ChannelMismatch { expected: channels, found };
                assert_eq!(memory.push(&vec![T::zero(); found]), Err(refusal), "{name}");
            }
            assert!(
                self.term(&mut *memory) == *expected && self.term(&mut *memory) == *expected,
                "{name}, {k}"
            );
            memory.push(sample(k)).unwrap();
        }
    }

    /// Asserts that a restored memory continues where it was saved, and refuses any other state.
    fn assert_saved(&self) {
        let &Self { name, channels, .. } = self;
        let length = self.capacity.unwrap_or(400).min(400);
        let samples = Signal::Stationary.samples::<T>(channels, length);
        let sample = |k: usize| &samples[k * channels..(k + 1) * channels];
        let (mut states, mut terms) = (Vec::new(), Vec::new());
        let mut memory = (self.build)();
        for k in 0..length {
            if [0, 1, 15, 16, 30, 63, 64, 100, 128, 200, 399].contains(&k) {
                states.push((k, saved(&*memory)));
            }
            terms.push(self.term(&mut *memory));
            memory.push(sample(k)).unwrap();
        }
        for (k, state) in states {
            let before = saved(&*memory);
            for cut in [0, 3, 4, 12, 36, 37, state.len() - 1] {
                let cut = cut.min(state.len() - 1);
                let (mut reader, mut again) =
                    (StateReader::new(&state[..cut]), StateReader::new(&state[..cut]));
                assert!(
                    matches!(memory.check_state(&mut reader), Err(StateError::Truncated { .. })),
                    "{name}"
                );
                assert!(matches!(memory.restore(&mut again), Err(StateError::Truncated { .. })), "{name}");
            }
            if k > 0 {
                let mut state = state.clone();
                // The last numbers of the state, which are the last to be read.
                state.iter_mut().rev().take(8).for_each(|byte| *byte = 0xff);
                let refused = memory.restore(&mut StateReader::new(&state));
                assert_eq!(refused, Err(StateError::NotFinite), "{name}");
            }
            let forged = |at: usize, byte: u8| {
                let mut state = state.clone();
                state[at] ^= byte;
                let found = memory.check_state(&mut StateReader::new(&state));
                (found, state)
            };
            let (error, other_kind) = forged(0, 1);
            assert!(matches!(error, Err(StateError::Kind { .. })), "{name}");
            for (at, byte) in [(4, 12), (5, 1), (13, 1), (21, 1)] {
                assert!(matches!(forged(at, byte).0, Err(StateError::Mismatch { .. })), "{name}, byte {at}");
            }
            if let Some(capacity) = self.capacity {
                let (error, _) = forged(35, 1);
                let limit = capacity as u64;
                assert!(
                    matches!(error, Err(StateError::TooLarge { what: "samples", limit: found, .. }) if found == limit),
                    "{name}: {error:?}"
                );
                assert!(memory.restore(&mut StateReader::new(&forged(35, 1).1)).is_err(), "{name}");
            }
            assert!(memory.restore(&mut StateReader::new(&other_kind)).is_err(), "{name}");
            assert!(saved(&*memory) == before, "{name}: a refusal changed the memory");
            let mut reader = StateReader::new(&state);
            memory.check_state(&mut reader).unwrap();
            reader.finish().unwrap();
            let mut reader = StateReader::new(&state);
            memory.restore(&mut reader).unwrap();
            reader.finish().unwrap();
            assert!(memory.len() == k && saved(&*memory) == state, "{name}: saved again at {k}");
            for (k, expected) in terms.iter().enumerate().skip(k).take(100) {
                assert!(self.term(&mut *memory) == *expected, "{name}, {k}");
                memory.push(sample(k)).unwrap();
            }
        }
    }
}

#[test]
fn transforms_keep_what_the_trait_promises() {
    for (channels, stages) in [(1, 1), (3, 1), (4, 2)] {
        let capacity = Some(400);
        let engine = |index: usize| {
            move || {
                let [first, second, third, fourth] = transform_engines::<f64>(channels, stages, 400);
                [first, second, third, fourth].into_iter().nth(index).unwrap().1
            }
        };
        let leading = arbitrary(stages, 1);
        for (index, name, capacity) in
            [(0, "block-fft", capacity), (1, "growing", None), (2, "paced", capacity), (3, "eager", capacity)]
        {
            let build = &engine(index);
            let leading = leading.clone();
            let promise = Promise { name, build, channels, stages, kernels: 1, leading, capacity };
            promise.assert_kept();
            promise.assert_saved();
        }
    }
}

#[test]
fn baselines_keep_what_the_trait_promises() {
    for (channels, stages) in [(1, 1), (4, 2)] {
        let weights: &[f64] = arbitrary(stages, 90).leak();
        let table = WeightTable::matrices(weights, stages);
        let builds: [(_, &dyn Fn() -> BoxedMemory<f64>); 2] = [
            ("naive", &move || Box::new(Naive::planned(table, channels, 90).unwrap())),
            ("textbook", &move || Box::new(Hls::planned(table, channels, 90).unwrap())),
        ];
        for (name, build) in builds {
            let (leading, capacity) = (weights[..stages * stages].to_vec(), Some(90));
            Promise { name, build, channels, stages, kernels: 1, leading, capacity }.assert_kept();
        }
    }
}

#[test]
fn exponential_sums_keep_what_the_trait_promises() {
    for (channels, head) in [(1, 9), (3, 40)] {
        let exponentials = Exponentials::new(1, head, 400);
        for index in 0..3 {
            let (name, _) = sums_of_exponentials::<f32>(&exponentials, channels)[index];
            let build =
                &|| sums_of_exponentials::<f32>(&exponentials, channels).into_iter().nth(index).unwrap().1;
            let leading = vec![f32::of(exponentials.head[0])];
            let promise =
                Promise { name, build, channels, stages: 1, kernels: 1, leading, capacity: Some(400) };
            promise.assert_kept();
            promise.assert_saved();
        }
    }
    for stages in 2..=4 {
        let exponentials = Exponentials::new(stages, 20, 400);
        let build = &|| f64::exponential_sum(&exponentials.table(), 2 * stages).unwrap();
        let leading = exponentials.weights(1);
        let (name, channels, capacity) = ("matrices", 2 * stages, Some(400));
        let promise = Promise { name, build, channels, stages, kernels: 1, leading, capacity };
        promise.assert_kept();
        promise.assert_saved();
    }
    let tables = sharing();
    for table in &tables {
        assert!(table.horizon > 400);
    }
    let views: Vec<_> = tables.iter().map(Exponentials::table).collect();
    let leading: Vec<f64> = tables.iter().map(|table| table.head[0]).collect();
    let builds: [&dyn Fn() -> BoxedMemory<f64>; 2] =
        [&|| f64::wide_exponential_sum(&views, 70, 1).unwrap(), &|| {
            f64::wide_exponential_sum_in_f32(&views, 70, 3).unwrap()
        }];
    for build in builds {
        let leading = leading.clone();
        let (name, channels, capacity) = ("shared", 70, Some(1000));
        let promise = Promise { name, build, channels, stages: 1, kernels: 3, leading, capacity };
        promise.assert_kept();
        promise.assert_saved();
    }
}

#[test]
fn what_the_samples_are_stays_with_the_memory() {
    let exponentials = Exponentials::new(1, 9, 400);
    let table = &exponentials.table();
    let weights: &[f64] = arbitrary(1, 9).leak();
    let scalars = WeightTable::scalars(weights);
    let acts_on = ActsOn::Increments;
    let memories: [BoxedMemory<f64>; 5] = [
        Box::new(BlockFft::planned(scalars, 1, 9).unwrap().acting_on(acts_on)),
        Box::new(BlockFft::growing(scalars, 1).unwrap().acting_on(acts_on)),
        Box::new(RealTime::planned(scalars, 1, 9, Pacing::Paced).unwrap().acting_on(acts_on)),
        Box::new(ChunkedExponentialSum::<f64, 1>::new(table, 1).unwrap().acting_on(acts_on)),
        Box::new(WideExponentialSum::<f64>::new(table, 1).unwrap().acting_on(acts_on)),
    ];
    for memory in memories {
        assert_eq!(memory.acts_on(), acts_on);
    }
}

#[test]
fn engines_behind_objects_are_those_of_the_crate() {
    let weights = arbitrary::<f64>(2, 400);
    let mut table = WeightTable::matrices(&weights, 2);
    let mut pairs = [
        (f64::block_fft(&mut table, 2, 400).unwrap(), transform_engines(2, 2, 400).map(|(_, engine)| engine)),
        (f64::real_time(&mut table, 2, 400).unwrap(), transform_engines(2, 2, 400).map(|(_, engine)| engine)),
    ];
    for (index, (object, engines)) in pairs.iter_mut().enumerate() {
        let engine = &mut engines[2 * index];
        let (mut found, mut expected) = ([0.0; 2], [0.0; 2]);
        assert_eq!(object.overruns(), engine.overruns());
        for k in 0..400 {
            object.next_term(&mut found).unwrap();
            engine.next_term(&mut expected).unwrap();
            assert_eq!(found.map(f64::to_bits), expected.map(f64::to_bits));
            object.push(&[k as f64, 1.0]).unwrap();
            engine.push(&[k as f64, 1.0]).unwrap();
        }
    }
}

/// Weights are requested once, in order, and missing ones are zero.
#[test]
fn weights_are_asked_for_once_and_in_order() {
    struct Ordered(usize);
    impl Weights<f64> for Ordered {
        fn fill(&mut self, first: usize, weights: &mut [f64]) {
            assert_eq!(first, self.0);
            self.0 += weights.len();
            weights.fill(1.0);
        }
    }
    let mut memory = BlockFft::growing(Ordered(0), 1).unwrap();
    for k in 0..5000 {
        let mut term = [f64::NAN];
        memory.next_term(&mut term).unwrap();
        assert!((term[0] - k as f64).abs() < 1e-12 * k as f64 + 1e-15, "the sum of {k} ones is {term:?}");
        memory.push(&[1.0]).unwrap();
    }
    let mut weights = [7.0; 8];
    WeightTable::matrices(&[1.0, 2.0, 3.0, 4.0, 5.0], 2).fill(1, &mut weights);
    assert_eq!(weights, [5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    weights.fill(7.0);
    WeightTable::scalars(&[1.0, 2.0]).fill(5, &mut weights);
    assert_eq!(weights, [0.0; 8]);
}

/// `bytes` is the size of the numbers, which are counted here, plus a small overhead.
fn assert_bytes(name: &str, memory: &dyn Memory<f64>, numbers: usize, overhead: usize) {
    let (least, found) = (8 * numbers, memory.bytes());
    assert!((least..least + overhead).contains(&found), "{name}: {found} bytes for {least}");
}

#[test]
fn bytes_count_the_numbers_that_a_memory_keeps() {
    // Leading weights, tables of d chunks, blocks of sixteen exponentials and the state.
    let (rows, stages) = (|rows: usize| 16 * rows, 4);
    let exponentials = Exponentials::new(stages, 40, 400);
    let memory = ChunkedExponentialSum::<f64, 4>::new(&exponentials.table(), 3 * stages).unwrap();
    let distance = 3;
    let blocks = 2;
    let tables =
        stages * stages + rows((distance + 1) * 16 * stages * stages) + rows(blocks * (3 + 2 * stages + 16));
    let state = 3 * rows((3 + distance) * stages + 2 * blocks);
    assert_bytes("chunked", &memory, tables + state, 1000);
    assert_eq!(memory.state_bytes(), header_bytes(4) + 8 * state);

    // A chunk of 40: coefficients for groups of eight terms from m samples of the same chunk, and from a
    // whole chunk and 17 sums, since one of 18 exponentials decays at once; and those of the sums from a
    // chunk.
    let exponentials = Exponentials::new(1, 40, 400);
    let memory = WideExponentialSum::<f64>::new(&exponentials.table(), 100).unwrap();
    let (chunk, sums) = (40, 17);
    let within: usize = (0..chunk).step_by(8).map(|m| 8 * m).sum();
    let tables = 1 + 8 + within + chunk * (sums + chunk) + sums.next_multiple_of(8) * chunk + sums;
    let slow = memory.channel_bytes() - 8 * (chunk + sums);
    // Rates up to 0.003 lose less than an eighth in a chunk and have rests.
    assert_eq!(slow, 4 * 4);
    assert_bytes("wide", &memory, tables + 128 * (chunk + sums) + 128 * slow / 8, 1500);
    assert_eq!(memory.state_bytes(), header_bytes(4) + 8 * 100 * (chunk + sums + 4));

    // Near part: weights of two blocks of 64 for each entry, sixteen weights per place, one row of terms per
    // channel.
    let (channels, stages, capacity) = (4, 2, 2048);
    let near = stages * stages * (1 + rows(128 + 16)) + rows(channels);
    let [block_fft, growing, paced, _] = transform_engines::<f64>(channels, stages, capacity);
    // Spectra of weights and samples at distances from 2 on, a sum, a polynomial, twists; one output block.
    let level = |block: usize, reach: usize, outputs: usize| {
        let spectra = (reach - 1) * (stages * stages + channels) + 3;
        2 * block * spectra + outputs * channels * block
    };
    let numbers = near + level(64, 15, 1) + level(512, 3, 1) + channels * capacity;
    assert_bytes("block-fft", &*block_fft.1, numbers, 20_000);
    let numbers = near + level(64, 7, 2) + level(256, 7, 2) + channels * capacity;
    assert_bytes("real-time", &*paced.1, numbers, 8000);
    let mut growing = growing.1;
    let before = growing.bytes();
    assert_bytes("growing", &*growing, near, 6000);
    for _ in 0..capacity {
        growing.push(&[0.0; 4]).unwrap();
    }
    let numbers = level(64, 15, 1) + level(512, 3, 1) + channels * capacity + stages * stages * capacity;
    assert!(growing.bytes() - before > 8 * numbers, "{before} {}", growing.bytes());

    let weights = arbitrary::<f64>(2, 500);
    let table = WeightTable::matrices(&weights, 2);
    let naive = Naive::planned(table, 4, 500).unwrap();
    assert_bytes("naive", &naive, 4 + 4 * 500 + 4 * 500, size_of::<Naive>() + 200);
    assert!(naive.bytes() >= 8 * (4 + 4 * 500 + 4 * 500) + size_of::<Naive>());
    let mut textbook = Hls::planned(table, 4, 500).unwrap();
    let before = textbook.bytes();
    assert!(before >= 8 * 12 * 500 + size_of::<Hls>() && before < 8 * 16 * 500 + 1000, "{before}");
    for _ in 0..400 {
        textbook.push(&[0.0; 4]).unwrap();
    }
    // Two rows of 512 complex numbers, each with a capacity of at most twice as many.
    assert!((2 * 512 * 16..=4 * 512 * 16).contains(&(textbook.bytes() - before)));
}

#[test]
fn states_of_other_kernels_and_channels_are_refused() {
    fn refused<T: Scalar>(memory: &mut dyn Memory<T>, other: &dyn Memory<T>) -> (&'static str, u64, u64) {
        match memory.restore(&mut StateReader::new(&saved(other))) {
            Err(StateError::Mismatch { what, expected, found }) => (what, expected, found),
            result => panic!("{result:?}"),
        }
    }
    let weights: &[f64] = arbitrary(2, 50).leak();
    let others: &[f64] = weights.iter().map(|weight| 1.5 * weight).collect::<Vec<_>>().leak();
    let made =
        |weights, channels| BlockFft::planned(WeightTable::matrices(weights, 2), channels, 50).unwrap();
    assert_eq!(refused(&mut made(weights, 6), &made(weights, 4)), ("channels", 6, 4));
    assert_eq!(refused(&mut made(weights, 6), &made(others, 6)).0, "fingerprint of the kernel");
    let (table, mut other) = (Exponentials::new(2, 9, 50), Exponentials::new(2, 9, 50));
    other.head[3] += 1.0;
    let made = |table: &Exponentials, channels| {
        ChunkedExponentialSum::<f64, 2>::new(&table.table(), channels).unwrap()
    };
    assert_eq!(refused(&mut made(&table, 6), &made(&table, 4)), ("channels", 6, 4));
    assert_eq!(refused(&mut made(&table, 6), &made(&other, 6)).0, "fingerprint of the kernel");
    let (table, mut other) = (Exponentials::new(1, 9, 50), Exponentials::new(1, 9, 50));
    other.head[3] += 1.0;
    let made =
        |table: &Exponentials, channels| WideExponentialSum::<f64>::new(&table.table(), channels).unwrap();
    assert_eq!(refused(&mut made(&table, 6), &made(&table, 4)), ("channels", 6, 4));
    assert_eq!(refused(&mut made(&table, 6), &made(&other, 6)).0, "fingerprint of the kernel");
    let coarse = WideExponentialSum::<f64, f32>::new(&table.table(), 6).unwrap();
    assert_eq!(refused(&mut made(&table, 6), &coarse), ("bytes of a number of the state", 8, 4));
}

#[test]
fn a_closure_and_a_recursion_are_kernels() {
    let order = fvi_core::BdfOrder::new(2).unwrap();
    let recursion = fvi_core::ConvolutionWeights::bdf(order, 0.5, 0.1).unwrap();
    let weights: Vec<f64> = recursion.clone().take(300).collect();
    let mut asked = 0;
    let closure = |first: usize, numbers: &mut [f64]| {
        assert_eq!(first, asked);
        asked += numbers.len();
        for (number, weight) in numbers.iter_mut().zip(weights.iter().skip(first)) {
            *number = *weight;
        }
    };
    let mut memories: [BoxedMemory<f64>; 2] = [
        Box::new(Naive::planned(closure, 1, 300).unwrap()),
        Box::new(BlockFft::planned(recursion, 1, 300).unwrap()),
    ];
    for memory in &mut memories {
        assert_plain_sum("kernel", &mut **memory, &weights, 300, &SHORT[..1], 100.0);
    }
    drop(memories);
    // As many weights as the run can use, in several requests.
    let mut counted = 0;
    let long = |_: usize, numbers: &mut [f64]| {
        counted += numbers.len();
        numbers.fill(1.0);
    };
    Naive::planned(long, 1, 1500).unwrap();
    assert_eq!((asked, counted), (300, 1500));
    let mut empty = Hls::planned(WeightTable::scalars(&[2.0f64]), 1, 0).unwrap();
    assert_eq!(empty.leading(), [2.0]);
    assert_eq!(empty.next_term(&mut [0.0]), Err(MemoryError::Full { capacity: 0 }));
}

/// The rounding error of a chunk's sum is the same at many chunks of a constant signal. Without the
/// correction the terms would be wrong by some hundred units: of a sum in equilibrium, because there a chunk
/// changes it by less than its last digit, and of one that only grows.
fn assert_slow_sums_keep_their_digits<T: Scalar>() {
    const LENGTH: usize = 40_000;
    let (never_ends, in_balance) = ((1e-20, 1.0), (1e-4, 4.0));
    let mut table = Exponentials::new(1, 2, LENGTH + 1);
    table.head = vec![1.0, 1.0];
    table.exponentials = vec![never_ends.0, in_balance.0, 0.0, 0.0, never_ends.1, in_balance.1, 0.0, 0.0];
    let sum = |(decay, size): (f64, f64)| -size * ((LENGTH - 1) as f64 * (-decay).ln_1p()).exp_m1() / decay;
    let sample = T::of(0.1);
    let expected = sample.to_f64() * (1.0 + sum(never_ends) + sum(in_balance));
    // Also on the last of several tiles of channels.
    for (name, mut memory) in sums_of_exponentials::<T>(&table, 70).into_iter().take(2) {
        for _ in 0..LENGTH {
            memory.push(&[sample; 70]).unwrap();
        }
        let mut term = [T::of(f64::NAN); 70];
        memory.next_term(&mut term).unwrap();
        for (channel, number) in term.iter().enumerate() {
            let error = (number.to_f64() / expected - 1.0).abs() / (T::EPSILON.to_f64() / 2.0);
            // The tolerance of exponential sums for signals of constant size.
            assert!(error < 28.0, "{name}, channel {channel}: {error} u");
        }
    }
}

#[test]
fn slow_sums_keep_their_digits_over_thousands_of_chunks() {
    assert_slow_sums_keep_their_digits::<f32>();
    assert_slow_sums_keep_their_digits::<f64>();
}

#[test]
fn threads_that_share_a_step_change_no_bit() {
    // Enough channels that two threads share all work of a step.
    const CHANNELS: usize = 40_000;
    let tables = sharing();
    let views: Vec<_> = [0, 1, 2, 1].map(|index| tables[index].table()).into();
    let memory =
        |threads| WideExponentialSum::<f32>::of_kernels(&views, CHANNELS).unwrap().on_threads(threads);
    let (mut alone, mut together) = (memory(1), memory(2));
    let (mut expected, mut found) = (vec![f32::NAN; 4 * CHANNELS], vec![f32::NAN; 4 * CHANNELS]);
    for k in 0..40 {
        alone.next_term(&mut expected).unwrap();
        together.next_term(&mut found).unwrap();
        assert!(expected == found, "k = {k}");
        let sample: Vec<f32> =
            (0..CHANNELS).map(|channel| ((channel + 7 * k) % 1013) as f32 - 500.0).collect();
        alone.push(&sample).unwrap();
        together.push(&sample).unwrap();
    }
}

#[test]
fn the_vector_units_are_named_as_they_are_used() {
    let name = crate::vector_units();
    if cfg!(target_arch = "x86_64") {
        assert!(name.starts_with("x86-64 with"), "{name}");
        let fused = !matches!(pulp::Arch::new(), pulp::Arch::Scalar);
        assert_eq!(name.ends_with("with fused multiply–add"), fused, "{name}");
    } else {
        assert!(!name.starts_with("x86-64") && !name.is_empty(), "{name}");
    }
}

#[test]
fn a_slow_exponential_however_small_is_what_lasts() {
    let mut table = Exponentials::new(1, 2, 400);
    table.head = vec![1.0, 1.0];
    table.exponentials = vec![0.5, 1e-6, 0.0, 0.0, 1.0, 1e-22, 0.0, 0.0];
    for (name, mut memory) in sums_of_exponentials::<f64>(&table, 1) {
        let mut term = [f64::NAN];
        for k in 0..300 {
            memory.push(&[if k == 0 { 1.0 } else { 0.0 }]).unwrap();
        }
        memory.next_term(&mut term).unwrap();
        let weight = 1e-22 * (298.0 * (-1e-6f64).ln_1p()).exp();
        assert!((term[0] / weight - 1.0).abs() < 1e-13, "{name}: {term:?}");
    }
}

#[test]
fn operations_are_counted_as_blocks_are_cut() {
    // Lags below 128 one by one, 2k and 2(k − 64) …; output blocks 2 and 3 of 64 with one and two input
    // blocks.
    let near: usize = (0..128).map(|k| 2 * k).sum::<usize>() + 2 * (64..128).map(|k| 2 * k).sum::<usize>();
    let blocks = 2 * (2 * 5 * 64 * 6) + 3 * 8 * 64;
    let count = (near + blocks) as f64;
    assert_eq!((BlockFft::<f64>::operations(256), RealTime::<f64>::operations(256)), (count, count));
    // Eight blocks of a level make one of the next, or four.
    let of_a_step = |operations: f64| operations / 2048.0;
    let longer = (BlockFft::<f64>::operations(2048), RealTime::<f64>::operations(2048));
    assert_eq!((of_a_step(longer.0), of_a_step(longer.1)), (362.5, 356.5));
}
