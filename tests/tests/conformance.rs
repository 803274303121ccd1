//! Every engine for arbitrary kernels gives the plain sum to rounding and keeps the contract of a memory.

use fvi_core::{
    BdfOrder, Direct, ExponentialTable, Memory, MemoryError, Overflow, Real, StateError, StateReader,
    StateWriter, Stateful, Tiled, check_channels,
};
use fvi_fft::Aligned;
use fvi_fft::GrowingRing;
use fvi_fft::baseline::{Hls, Naive, OfflineFft, Signal, memory_term};
use fvi_fft::exponentials::exponential_table::{ExponentialKernel, SMALLEST_TOLERANCE};
use fvi_fft::memory::Engine;
use fvi_fft::memory::Memories;
use fvi_fft::{BlockFft, Engines, Pacing, RealTime, WeightTable, WideExponentialSum};
use fvi_tests::conformance::{
    Bound, Constructor, TestKernel, agrees_with_the_plain_sum, goes_on_where_it_was_saved, host_memory,
    keeps_the_contract, largest_error,
};
use std::sync::{Arc, Mutex};

const FINEST_BLOCK: usize = 64;

const QUADRATURES: [(usize, f64); 10] =
    [(1, 0.3), (1, 0.5), (1, 1.5), (1, 1.9), (1, -0.5), (6, 0.3), (6, 0.5), (6, 1.5), (6, 1.9), (6, -0.5)];

/// The engine of the program for the kernels it offers; for others, the memory below.
fn direct<T: Memories>(kernel: TestKernel, channels: usize, capacity: usize) -> Box<dyn Memory<T>> {
    host_memory(Engine::Direct, kernel, channels, capacity).unwrap_or_else(|| {
        let entries = kernel.stages() * kernel.stages();
        let weights = kernel.weights::<T>(capacity + 1);
        let planes: Vec<T> =
            (0..entries).flat_map(|entry| weights.iter().skip(entry).step_by(entries).copied()).collect();
        let rings: Vec<_> = (0..channels).map(|_| GrowingRing::new(capacity)).collect();
        Box::new(Direct::new(planes, kernel.stages(), T::one(), rings, Overflow::Refuse).unwrap())
    })
}

fn block_fft<T: Memories>(kernel: TestKernel, channels: usize, capacity: usize) -> Box<dyn Memory<T>> {
    host_memory(Engine::BlockFft, kernel, channels, capacity).unwrap_or_else(|| {
        // An empty run still has its leading weight.
        let weights = kernel.weights::<T>(capacity.max(1));
        let table = WeightTable::matrices(&weights, kernel.stages());
        Box::new(BlockFft::planned(table, channels, capacity).unwrap())
    })
}

/// A kernel asked for as the run grows.
struct Stream<T> {
    stages: usize,
    weights: Vec<T>,
}

impl<T: Memories> fvi_fft::Weights<T> for Stream<T> {
    fn stages(&self) -> usize {
        self.stages
    }

    fn fill(&mut self, first: usize, weights: &mut [T]) {
        WeightTable::matrices(&self.weights, self.stages).fill(first, weights);
    }
}

fn growing_block_fft<T: Memories>(
    kernel: TestKernel,
    channels: usize,
    capacity: usize,
) -> Box<dyn Memory<T>> {
    let stream = Stream { stages: kernel.stages(), weights: kernel.weights(4 * capacity.max(FINEST_BLOCK)) };
    Box::new(BlockFft::growing(stream, channels).unwrap())
}

fn real_time<T: Memories>(kernel: TestKernel, channels: usize, capacity: usize) -> Box<dyn Memory<T>> {
    host_memory(Engine::RealTime, kernel, channels, capacity).unwrap_or_else(|| {
        let weights = kernel.weights::<T>(capacity.max(1));
        let table = WeightTable::matrices(&weights, kernel.stages());
        Box::new(RealTime::planned(table, channels, capacity, Pacing::Paced).unwrap())
    })
}

fn exponential_sum<T: Memories>(kernel: TestKernel, channels: usize, capacity: usize) -> Box<dyn Memory<T>> {
    host_memory(Engine::ExponentialSum, kernel, channels, capacity).expect("a kernel of exponentials")
}

fn core_exponential_sum<T: Memories>(
    kernel: TestKernel,
    channels: usize,
    capacity: usize,
) -> Box<dyn Memory<T>> {
    host_memory(Engine::ExponentialSumCore, kernel, channels, capacity).expect("a kernel of exponentials")
}

/// For as few channels as the suite has the program takes another memory, so this one is made from its table.
fn wide_exponential_sum<T: Memories>(
    kernel: TestKernel,
    channels: usize,
    _capacity: usize,
) -> Box<dyn Memory<T>> {
    let tables = tables(kernel, Sharing::Alone, SMALLEST_TOLERANCE);
    Box::new(WideExponentialSum::<T>::new(&tables[0].borrow(), channels).unwrap())
}

/// One of several kernels of a memory, as a memory by itself.
struct OneOf<T: Engines, P: Engines = T> {
    memory: WideExponentialSum<T, P>,
    kernel: usize,
    leading: [T; 1],
    terms: Vec<T>,
}

impl<T: Engines, P: Engines> Memory<T> for OneOf<T, P> {
    fn channels(&self) -> usize {
        self.memory.channels()
    }

    fn leading(&self) -> &[T] {
        &self.leading
    }

    fn len(&self) -> usize {
        self.memory.len()
    }

    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        check_channels(self.channels(), term.len())?;
        self.terms.resize(self.memory.kernels() * term.len(), T::of(f64::NAN));
        self.memory.next_term(&mut self.terms)?;
        term.copy_from_slice(&self.terms[self.kernel * term.len()..][..term.len()]);
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

impl<T: Engines, P: Engines> Stateful for OneOf<T, P> {
    fn state_bytes(&self) -> usize {
        self.memory.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.memory.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.memory.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.memory.restore(from)
    }
}

/// The kernel as the second of three that share their exponentials.
fn shared_wide_exponential_sum<T: Memories>(
    kernel: TestKernel,
    channels: usize,
    _capacity: usize,
) -> Box<dyn Memory<T>> {
    Box::new(second_of_three::<T, T>(kernel, channels, SMALLEST_TOLERANCE))
}

fn second_of_three<T: Engines, P: Engines>(
    kernel: TestKernel,
    channels: usize,
    tolerance: f64,
) -> OneOf<T, P> {
    let tables = tables(kernel, Sharing::SecondOfThree, tolerance);
    let tables: Vec<_> = tables.iter().map(ExponentialTable::borrow).collect();
    let memory = WideExponentialSum::of_kernels(&tables, channels).unwrap();
    OneOf { leading: [memory.leading()[1]], kernel: 1, terms: Vec::new(), memory }
}

/// Whose the exponentials of a kernel are: its own, or those of two others.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Sharing {
    Alone,
    SecondOfThree,
}

type Tables = Arc<[ExponentialTable<Aligned<f64>>]>;

/// The kernel's table, and those that share its exponentials; for all lengths of the suite. Kept, since a
/// table takes longer to make than the runs on it.
fn tables(kernel: TestKernel, sharing: Sharing, tolerance: f64) -> Tables {
    type Wanted = (TestKernel, Sharing, f64);
    static MADE: Mutex<Vec<(Wanted, Tables)>> = Mutex::new(Vec::new());
    let wanted = (kernel, sharing, tolerance);
    let made =
        MADE.lock().unwrap().iter().find(|(made, _)| *made == wanted).map(|(_, tables)| tables.clone());
    made.unwrap_or_else(|| {
        let tables = make_tables(kernel, sharing, tolerance);
        MADE.lock().unwrap().push((wanted, tables.clone()));
        tables
    })
}

fn make_tables(kernel: TestKernel, sharing: Sharing, tolerance: f64) -> Tables {
    const HORIZON: usize = 1 << 20;
    let TestKernel::Quadrature { order, exponent } = kernel else { panic!("{kernel:?} has no exponentials") };
    let order = BdfOrder::new(order).unwrap();
    let on_increments = exponent > 0.0;
    match sharing {
        Sharing::Alone => {
            let make =
                if on_increments { ExponentialKernel::bdf_on_increments } else { ExponentialKernel::bdf };
            [make(order, exponent, 1.0, HORIZON, tolerance).unwrap().table()].into()
        }
        Sharing::SecondOfThree => {
            let exponents = if on_increments { [0.8, exponent, 0.2] } else { [-0.2, exponent, -0.8] };
            let kernels =
                ExponentialKernel::sharing_rates(order, &exponents, on_increments, 1.0, HORIZON, tolerance);
            kernels.unwrap().iter().map(ExponentialKernel::table).collect()
        }
    }
}

/// Blocks of the tiled memories: 5120 samples.
const TILES: usize = 640;

fn tiled<T: Real>(kernel: TestKernel, channels: usize, capacity: usize) -> Box<dyn Memory<T>> {
    assert!(kernel.stages() == 1 && capacity <= 8 * TILES, "{kernel:?}, {capacity} samples");
    let weights: &[T] = kernel.weights(capacity.max(1)).leak();
    match channels {
        1 => Box::new(Tiled::<T, 1, TILES>::new(weights, T::one(), Overflow::Refuse).unwrap()),
        2 => Box::new(Tiled::<T, 2, TILES>::new(weights, T::one(), Overflow::Refuse).unwrap()),
        _ => Box::new(Tiled::<T, 3, TILES>::new(weights, T::one(), Overflow::Refuse).unwrap()),
    }
}

/// Lengths at which something begins or ends in blocks of 64 and the sizes above them.
fn lengths() -> Vec<usize> {
    let mut lengths = vec![0, 1, 2, 15, 16, 17];
    for block in [FINEST_BLOCK, 2 * FINEST_BLOCK, 4 * FINEST_BLOCK, 16 * FINEST_BLOCK, 32 * FINEST_BLOCK] {
        lengths.extend([block - 1, block, block + 1]);
    }
    lengths.push(5000);
    lengths
}

/// The kernels of plain numbers from convolution quadrature.
fn short_runs_of_quadratures<T: Real>(build: impl Constructor<T> + Copy, bound: Bound) {
    for (order, exponent) in QUADRATURES {
        agrees_with_the_plain_sum(build, bound, TestKernel::Quadrature { order, exponent }, 1, &[1000]);
    }
    let quadrature = TestKernel::Quadrature { order: 1, exponent: 0.5 };
    agrees_with_the_plain_sum(build, bound, quadrature, 1, &lengths());
    agrees_with_the_plain_sum(build, bound, quadrature, 3, &[1, 63, 700]);
}

/// Those of 3×3 matrices.
fn short_runs_of_stages<T: Real>(build: impl Constructor<T> + Copy, bound: Bound) {
    for exponent in [0.3, 0.5, 1.5, 1.9, -0.5] {
        agrees_with_the_plain_sum(build, bound, TestKernel::RadauIia { exponent }, 1, &[700]);
    }
    agrees_with_the_plain_sum(build, bound, TestKernel::RadauIia { exponent: 0.5 }, 3, &[0, 1, 65, 129]);
}

/// Those without a pattern.
fn short_runs_of_arbitrary_kernels<T: Real>(
    build: impl Constructor<T> + Copy,
    bound: Bound,
    stages: &[usize],
) {
    for &stages in stages {
        for coordinates in [1, 3] {
            let kernel = TestKernel::Arbitrary { stages };
            agrees_with_the_plain_sum(build, bound, kernel, coordinates, &[0, 1, 65, 129, 700, 2049]);
        }
    }
}

/// For engines that take any kernel.
fn short_runs<T: Real>(build: impl Constructor<T> + Copy, bound: Bound) {
    short_runs_of_quadratures(build, bound);
    short_runs_of_stages(build, bound);
    short_runs_of_arbitrary_kernels(build, bound, &[1, 3]);
}

/// For those that need decaying weights of plain numbers.
fn short_runs_of_decaying_numbers<T: Real>(build: impl Constructor<T> + Copy, bound: Bound) {
    short_runs_of_quadratures(build, bound);
    // Channels that fill no vector, and some that fill more than one.
    let quadrature = TestKernel::Quadrature { order: 2, exponent: 0.6 };
    agrees_with_the_plain_sum(build, bound, quadrature, 75, &[33, 140]);
}

/// For those that need decaying weights.
fn short_runs_of_decaying_weights<T: Real>(build: impl Constructor<T> + Copy, bound: Bound) {
    short_runs_of_quadratures(build, bound);
    short_runs_of_stages(build, bound);
}

/// For those that need plain numbers.
fn short_runs_of_plain_numbers<T: Real>(build: impl Constructor<T> + Copy, bound: Bound) {
    short_runs_of_quadratures(build, bound);
    short_runs_of_arbitrary_kernels(build, bound, &[1]);
}

const HALF_DERIVATIVE: TestKernel = TestKernel::Quadrature { order: 1, exponent: 0.5 };
const HALF_INTEGRAL: TestKernel = TestKernel::Quadrature { order: 1, exponent: -0.5 };
const SECOND_ORDER: TestKernel = TestKernel::Quadrature { order: 2, exponent: 0.5 };
const SIXTH_ORDER: TestKernel = TestKernel::Quadrature { order: 6, exponent: 1.5 };
const STAGES: TestKernel = TestKernel::RadauIia { exponent: 0.5 };
const NUMBERS: TestKernel = TestKernel::Arbitrary { stages: 1 };
const MATRICES: TestKernel = TestKernel::Arbitrary { stages: 3 };

/// The suite for one engine: its constructor, the error it may have, the short runs it takes, kernels for the
/// contract and for long runs, and lengths of those.
macro_rules! engine {
    ($name:ident, $build:ident, $bound:expr, $short_runs:ident, $contract:expr, $long:expr, $lengths:expr) => {
        mod $name {
            use super::*;

            #[test]
            fn short_runs_agree_with_the_plain_sum() {
                $short_runs::<f64>($build, $bound);
            }

            #[test]
            fn short_runs_agree_with_the_plain_sum_in_f32() {
                $short_runs::<f32>($build, $bound);
            }

            #[test]
            fn repeated_refused_and_cleared_runs_give_the_same_bits() {
                for kernel in $contract {
                    for length in [1, 40, 700] {
                        keeps_the_contract::<f64>($build, kernel, length);
                        keeps_the_contract::<f32>($build, kernel, length);
                    }
                }
            }

            #[test]
            fn a_saved_state_goes_on_with_the_same_bits() {
                for kernel in $contract {
                    goes_on_where_it_was_saved::<f64>($build, kernel, 700);
                    goes_on_where_it_was_saved::<f32>($build, kernel, 700);
                }
            }

            #[test]
            fn long_runs_agree_with_the_plain_sum() {
                for kernel in $long {
                    agrees_with_the_plain_sum::<f64>($build, $bound, kernel, 1, $lengths);
                }
                agrees_with_the_plain_sum::<f32>($build, $bound, HALF_INTEGRAL, 1, $lengths);
            }
        }
    };
}

const ANY: [TestKernel; 2] = [SECOND_ORDER, MATRICES];
const ANY_LONG: [TestKernel; 3] = [HALF_DERIVATIVE, SIXTH_ORDER, NUMBERS];
const DECAYING: [TestKernel; 2] = [SECOND_ORDER, STAGES];
const DECAYING_LONG: [TestKernel; 3] = [HALF_DERIVATIVE, HALF_INTEGRAL, SIXTH_ORDER];
const LONG: &[usize] = &[33_000, 300_000];
/// For memories that are made for many channels, and take long with one.
const LONG_ENOUGH: &[usize] = &[33_000, 100_000];

engine!(direct_memory, direct, Bound::of(Engine::Direct), short_runs, ANY, ANY_LONG, &[20_000]);
engine!(tiled_memory, tiled, Bound::TILED, short_runs_of_plain_numbers, [SECOND_ORDER], ANY_LONG, &[5120]);
engine!(block_fft_memory, block_fft, Bound::of(Engine::BlockFft), short_runs, ANY, ANY_LONG, LONG);
engine!(
    growing_block_fft_memory,
    growing_block_fft,
    Bound::of(Engine::BlockFft),
    short_runs,
    ANY,
    ANY_LONG,
    LONG
);
engine!(real_time_memory, real_time, Bound::of(Engine::RealTime), short_runs, ANY, ANY_LONG, LONG);
engine!(
    exponential_sum_memory,
    exponential_sum,
    Bound::of(Engine::ExponentialSum),
    short_runs_of_decaying_weights,
    DECAYING,
    DECAYING_LONG,
    LONG
);
engine!(
    core_exponential_sum_memory,
    core_exponential_sum,
    Bound::of(Engine::ExponentialSumCore),
    short_runs_of_decaying_weights,
    DECAYING,
    DECAYING_LONG,
    LONG
);

engine!(
    wide_exponential_sum_memory,
    wide_exponential_sum,
    Bound::of(Engine::ExponentialSum),
    short_runs_of_decaying_numbers,
    [SECOND_ORDER],
    DECAYING_LONG,
    LONG_ENOUGH
);

engine!(
    shared_wide_exponential_sum_memory,
    shared_wide_exponential_sum,
    Bound::of(Engine::ExponentialSum),
    short_runs_of_decaying_numbers,
    [SECOND_ORDER],
    DECAYING_LONG,
    &[33_000]
);

/// The bits of every term, with so many threads; channels enough for them to take part.
fn bits_on_threads(tables: &[ExponentialTable<Aligned<f64>>], threads: usize) -> Vec<u64> {
    let (channels, length) = (20_011, 70);
    let tables: Vec<_> = tables.iter().map(ExponentialTable::borrow).collect();
    let memory = WideExponentialSum::<f64>::of_kernels(&tables, channels).unwrap();
    let mut memory = memory.on_threads(threads);
    let (mut term, mut bits) = (vec![0.0; tables.len() * channels], Vec::new());
    for k in 0..length {
        memory.next_term(&mut term).unwrap();
        bits.extend(term.iter().step_by(97).map(|number| number.to_bits()));
        let sample: Vec<f64> = (0..channels).map(|c| ((k * 31 + c) as f64 * 0.013).sin()).collect();
        memory.push(&sample).unwrap();
    }
    memory.next_term(&mut term).unwrap();
    bits.extend(term.iter().map(|number| number.to_bits()));
    bits
}

#[test]
fn threads_leave_every_bit_of_a_wide_memory_as_it_is() {
    for sharing in [Sharing::Alone, Sharing::SecondOfThree] {
        let tables = tables(SECOND_ORDER, sharing, SMALLEST_TOLERANCE);
        let alone = bits_on_threads(&tables, 1);
        assert!(alone == bits_on_threads(&tables, 2) && alone == bits_on_threads(&tables, 5));
    }
}

#[test]
fn kernels_without_common_exponentials_are_refused() {
    let of = |tables: &[ExponentialTable<Aligned<f64>>]| {
        let tables: Vec<_> = tables.iter().map(ExponentialTable::borrow).collect();
        WideExponentialSum::<f64>::of_kernels(&tables, 3).err().map(|error| error.parameter)
    };
    let table = |exponent| {
        let kernel = TestKernel::Quadrature { order: 2, exponent };
        tables(kernel, Sharing::Alone, SMALLEST_TOLERANCE)[0].clone()
    };
    assert_eq!(of(&[table(0.3), table(0.6)]), Some("exponentials"));
    let mut other = table(0.3);
    other.exponentials = other.exponentials.as_ref().iter().map(|number| 0.5 * number).collect();
    assert_eq!(of(&[table(0.3), other]), Some("decay"));
    let mut longer = table(0.3);
    longer.head = [longer.head.as_ref(), &[0.0]].concat().into_iter().collect();
    assert_eq!(of(&[table(0.3), longer]), Some("head weights"));
    assert_eq!(of(&[]), Some("tables"));
    assert_eq!(of(&vec![table(0.3); 5]), Some("tables"));
    assert_eq!(of(&vec![table(0.3); 4]), None);
}

/// In single precision between the chunks, an error of a few times its rounding, relative to Σ|w||x|, and
/// half the state.
#[test]
fn a_wide_memory_with_a_state_in_single_precision_stays_within_the_tolerance() {
    for (order, exponent) in [(1, 0.3), (2, 0.6), (2, 1.5), (6, 1.9)] {
        let kernel = TestKernel::Quadrature { order, exponent };
        let weights = kernel.weights::<f64>(20_000);
        let alone = tables(kernel, Sharing::Alone, 2.5e-7);
        let mut alone = WideExponentialSum::<f64, f32>::new(&alone[0].borrow(), 1).unwrap();
        let mut shared = second_of_three::<f64, f32>(kernel, 1, 2.5e-7);
        for signal in Signal::ALL {
            let memories: [&mut dyn Memory<f64>; 2] = [&mut alone, &mut shared];
            for (memory, name) in memories.into_iter().zip(["alone", "shared"]) {
                memory.clear();
                let (error, k) = largest_error(memory, &weights, signal, 100);
                let relative = error * f64::EPSILON / 2.0;
                assert!(relative < 5e-7, "{name} {kernel:?}, {signal:?}: {relative:e} at k = {k}");
            }
        }
    }
}

#[test]
fn a_growing_block_fft_memory_takes_any_number_of_samples() {
    let kernel = TestKernel::Quadrature { order: 1, exponent: 0.5 };
    let mut memory = growing_block_fft::<f64>(kernel, 1, 1 << 16);
    for _ in 0..200_000 {
        memory.push(&[1.0]).unwrap();
    }
    assert_eq!(memory.len(), 200_000);
}

#[test]
fn engines_refuse_channels_that_are_no_groups_of_stages() {
    let weights = vec![0.5; 9 * 10];
    let table = WeightTable::matrices(&weights, 3);
    for channels in [0, 1, 4] {
        let refusals = [
            BlockFft::planned(table, channels, 10).err(),
            RealTime::planned(table, channels, 10, Pacing::Eager).err(),
            Naive::planned(table, channels, 10).err(),
            Hls::planned(table, channels, 10).err(),
        ];
        for refusal in refusals {
            assert_eq!(refusal.map(|error| error.parameter), Some("channels"), "{channels} channels");
        }
    }
}

/// The textbook's transforms mix near and far lags: good to rounding only in norm.
#[test]
fn baselines_agree_with_the_plain_sum_in_norm() {
    for stages in [1, 3] {
        let kernel = TestKernel::Arbitrary { stages };
        let weights = kernel.weights::<f64>(3000);
        let table = WeightTable::matrices(&weights, stages);
        let mut memories: [Box<dyn Memory<f64>>; 2] = [
            Box::new(Naive::planned(table, 2 * stages, 3000).unwrap()),
            Box::new(Hls::planned(table, 2 * stages, 3000).unwrap()),
        ];
        for memory in &mut memories {
            let (error, k) = largest_error(&mut **memory, &weights, Signal::Stationary, 100);
            assert!(error < 300.0, "{stages} stages: {error} u at k = {k}");
        }
    }
}

#[test]
fn an_offline_transform_agrees_with_the_plain_sum_in_norm() {
    let weights = TestKernel::Quadrature { order: 1, exponent: 0.5 }.weights::<f64>(3000);
    let signal = Signal::Stationary.samples::<f64>(1, 3000);
    let mut terms = vec![f64::NAN; 3000];
    let mut offline = OfflineFft::new(WeightTable::scalars(&weights), 3000).unwrap();
    for _ in 0..2 {
        offline.convolve(&signal, &mut terms);
        for k in (0..3000).step_by(37) {
            let reference = memory_term(&weights, 1, &signal, 1, k)[0];
            assert!((terms[k] - reference.sum).abs() < 1e-13, "k = {k}");
        }
    }
}

#[test]
fn the_textbook_loses_small_terms_where_block_fft_keeps_them() {
    let kernel = TestKernel::Quadrature { order: 1, exponent: 1.5 };
    let weights = kernel.weights::<f64>(20_000);
    let table = WeightTable::scalars(&weights);
    let mut textbook = Hls::planned(table, 1, 20_000).unwrap();
    let mut blocks = BlockFft::planned(table, 1, 20_000).unwrap();
    let (lost, _) = largest_error(&mut textbook, &weights, Signal::Decaying, 40);
    let (kept, _) = largest_error(&mut blocks, &weights, Signal::Decaying, 40);
    assert!(
        lost > 1000.0 && kept <= Bound::of(Engine::BlockFft).changing,
        "textbook {lost} u, block-fft {kept} u"
    );
}
