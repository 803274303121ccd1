//! What holds for every memory engine, checked through its constructor.

use fvi_core::{
    BdfOrder, ConvolutionWeights, Memory, MemoryError, Real, RungeKutta, StateReader, StateWriter,
};
use fvi_fft::baseline::{Signal, memory_term};
use fvi_fft::memory::{Engine, History};
use fvi_fft::memory::{Memories, MemoryRequest};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::quadrature::runge_kutta_weights::RungeKuttaWeights;
use fvi_fft::transfer::TransferFunction;

/// A kernel to convolve with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TestKernel {
    /// Weights of the convolution quadrature of a BDF order for D^`exponent` at step size 1, as runs of the
    /// program have them: on increments where the exponent is positive.
    Quadrature {
        /// Order p of the formula.
        order: usize,
        /// Exponent of the quadrature.
        exponent: f64,
    },
    /// Matrix weights of the convolution quadrature of the Radau IIA method of three stages for D^`exponent`
    /// at step size 1, as runs of the program have them: on rises where the exponent is positive.
    RadauIia {
        /// Exponent of the quadrature.
        exponent: f64,
    },
    /// Weights of no pattern but a slow decay, W₀ = 0, of S×S matrices.
    Arbitrary {
        /// S.
        stages: usize,
    },
}

impl TestKernel {
    /// Number of stages S.
    pub fn stages(self) -> usize {
        match self {
            Self::Quadrature { .. } => 1,
            Self::RadauIia { .. } => 3,
            Self::Arbitrary { stages } => stages,
        }
    }

    /// The first `count` weights, row by row.
    pub fn weights<T: Real>(self, count: usize) -> Vec<T> {
        match self {
            Self::Quadrature { order, exponent } => {
                let order = BdfOrder::new(order).expect("an order");
                let on_values = ConvolutionWeights::bdf(order, exponent, 1.0).expect("an exponent");
                let mut source = if exponent > 0.0 { on_values.on_increments() } else { on_values };
                let mut weights = vec![T::zero(); count];
                source.fill(&mut weights);
                weights
            }
            Self::RadauIia { exponent } => {
                let planes = radau_iia_weights(exponent).planes();
                let entry = |index: usize| planes[index % 9 * RADAU_IIA_WEIGHTS + index / 9];
                (0..count * 9).map(|index| T::of(entry(index))).collect()
            }
            Self::Arbitrary { stages } => (0..count * stages * stages)
                .map(|index| {
                    let (n, entry) = ((index / (stages * stages)) as f64, (index % (stages * stages)) as f64);
                    T::of(if n == 0.0 { 0.0 } else { (0.7 * n * n + entry).cos() / (1.0 + n).powf(0.8) })
                })
                .collect(),
        }
    }
}

/// Weights of [`TestKernel::RadauIia`]: their last digits depend on how many are made, so it is always the
/// same number.
pub const RADAU_IIA_WEIGHTS: usize = 4096;

/// The kernel of [`TestKernel::RadauIia`].
pub fn radau_iia_weights(exponent: f64) -> RungeKuttaWeights<3> {
    let method = RungeKutta::<3>::radau_iia().expect("three stages");
    let make = if exponent > 0.0 { RungeKuttaWeights::on_rises } else { RungeKuttaWeights::new };
    make(&method, exponent, 1.0, RADAU_IIA_WEIGHTS).expect("an exponent")
}

/// An engine as a run of the program has it, or `None` for kernels that no run has.
pub fn host_memory<T: Memories>(
    engine: Engine,
    kernel: TestKernel,
    channels: usize,
    capacity: usize,
) -> Option<Box<dyn Memory<T>>> {
    let (family, exponent, samples) = match kernel {
        TestKernel::Quadrature { order, exponent } => (ConvolutionFamily::Bdf { order }, exponent, capacity),
        // One sample less than weights: the first weight meets none of the past.
        TestKernel::RadauIia { exponent } => {
            (ConvolutionFamily::RadauIia { stages: 3 }, exponent, RADAU_IIA_WEIGHTS - 1)
        }
        TestKernel::Arbitrary { .. } => return None,
    };
    let request = MemoryRequest {
        end: None,
        family,
        starting: &[],
        transfer: &TransferFunction::power(exponent).expect("an exponent of the suite"),
        step_size: 1.0,
        coordinates: channels / kernel.stages(),
        motions: 1,
        samples,
        given: false,
        history: &History { engine: Some(engine), ..History::default() },
    };
    Some(Box::new(request.build().expect("an engine for every kernel that the program offers")))
}

/// Makes an engine for a kernel, a number of channels and at least so many samples.
pub trait Constructor<T>: Fn(TestKernel, usize, usize) -> Box<dyn Memory<T>> {}

impl<T, F: Fn(TestKernel, usize, usize) -> Box<dyn Memory<T>>> Constructor<T> for F {}

/// Checks that a memory saved after any number of samples is restored to a memory that goes on with the same
/// bits, and that what is cut off is refused without a trace.
///
/// # Panics
/// If not.
pub fn goes_on_where_it_was_saved<T: Real>(build: impl Constructor<T>, kernel: TestKernel, length: usize) {
    let channels = 2 * kernel.stages();
    let signal = Signal::Stationary.samples::<T>(channels, length);
    let sample = |k: usize| &signal[k * channels..(k + 1) * channels];
    let save = |memory: &dyn Memory<T>| {
        let mut bytes = vec![0; memory.state_bytes()];
        let mut writer = StateWriter::new(&mut bytes);
        memory.save(&mut writer).expect("room for the state");
        assert_eq!(writer.written(), memory.state_bytes());
        bytes
    };
    // Before a block and behind it, in the middle of a chunk, at both ends.
    let places = [0, 1, 5, 16, 63, 64, 127, 128, 150, 193, 511, 512, length - 1];
    let mut saved = Vec::new();
    let mut terms = Vec::new();
    let mut term = vec![T::zero(); channels];
    let mut undisturbed = build(kernel, channels, length);
    for k in 0..length {
        if places.contains(&k) {
            saved.push((k, save(&*undisturbed)));
        }
        undisturbed.next_term(&mut term).expect("room");
        terms.push(term.iter().map(|number| number.bits()).collect::<Vec<_>>());
        undisturbed.push(sample(k)).expect("room");
    }
    let mut memory = build(kernel, channels, length);
    for (k, bytes) in saved {
        let before = save(&*memory);
        for cut in (0..bytes.len()).step_by(1 + bytes.len() / 100) {
            assert!(memory.restore(&mut StateReader::new(&bytes[..cut])).is_err(), "{cut} bytes");
        }
        assert!(save(&*memory) == before, "a refusal changed the memory");
        let mut reader = StateReader::new(&bytes);
        memory.restore(&mut reader).expect("its own state");
        reader.finish().expect("nothing left over");
        assert!(save(&*memory) == bytes, "saved again at k = {k}");
        for (k, expected) in terms.iter().enumerate().take(length).skip(k).take(200) {
            memory.next_term(&mut term).expect("room");
            let found: Vec<_> = term.iter().map(|number| number.bits()).collect();
            assert_eq!(found, *expected, "k = {k}");
            memory.push(sample(k)).expect("room");
        }
    }
}

/// Largest |r_k − reference| / Σ|w||x| on a signal, in units of u, over all k < length or `samples` of
/// them, and the k where it is. The memory is empty; the length is that of its weights, row by row.
pub fn largest_error<T: Real>(
    memory: &mut dyn Memory<T>,
    weights: &[T],
    signal: Signal,
    samples: usize,
) -> (f64, usize) {
    let (channels, stages) = (memory.channels(), memory.stages());
    let length = weights.len() / (stages * stages);
    let unit_roundoff = T::EPSILON.to_f64() / 2.0;
    let signal = signal.samples::<T>(channels, length);
    // The last terms, those around powers of two where blocks begin, and the rest evenly.
    let stride = length.div_ceil(samples).max(1);
    let wanted = |k: usize| k % stride == stride - 1 || k + 3 >= length || (k & (k.wrapping_sub(1))) == 0;
    let mut term = vec![T::of(f64::NAN); channels];
    let mut largest = (0.0, 0);
    for k in 0..length {
        memory.next_term(&mut term).expect("room for the sample");
        if wanted(k) {
            for (number, reference) in term.iter().zip(memory_term(weights, stages, &signal, channels, k)) {
                let error = (number.to_f64() - reference.sum).abs();
                let relative = if error == 0.0 { 0.0 } else { error / reference.absolute / unit_roundoff };
                if relative > largest.0 || relative.is_nan() {
                    largest = (relative, k);
                }
            }
        }
        memory.push(&signal[k * channels..(k + 1) * channels]).expect("room for the sample");
    }
    largest
}

/// Largest |r_k − reference| / Σ|w||x| that is allowed, in units of u: twice what is reached over all
/// kernels, lengths and precisions of the suite and over the random cases of `tests/engines.rs`.
#[derive(Clone, Copy, Debug)]
pub struct Bound {
    /// On signals that keep their size.
    pub steady: f64,
    /// On signals that decay or grow by eight orders of magnitude, where small terms stand beside large ones.
    pub changing: f64,
}

impl Bound {
    /// Of the tiled memory.
    pub const TILED: Self = Self { steady: 8.0, changing: 32.0 };

    /// Of an engine of the program.
    pub const fn of(engine: Engine) -> Self {
        match engine {
            Engine::Direct => Self { steady: 8.0, changing: 10.0 },
            Engine::BlockFft | Engine::RealTime => Self { steady: 16.0, changing: 22.0 },
            // The third weight of Lobatto IIIC for orders near 2, which decays slowest at that lag, has 46 u.
            Engine::ExponentialSum => Self { steady: 28.0, changing: 92.0 },
            Engine::ExponentialSumCore => Self { steady: 48.0, changing: 92.0 },
            // Its table's tolerance, 10⁻¹³, and not rounding; `variable_steps.rs` has its tests.
            Engine::AnyStep => Self { steady: 1000.0, changing: 1000.0 },
        }
    }

    /// For a signal.
    pub fn on(self, signal: Signal) -> f64 {
        match signal {
            Signal::Stationary | Signal::Constant => self.steady,
            Signal::Decaying | Signal::Growing => self.changing,
        }
    }
}

/// Checks that the terms are those of the plain sum, at every length given.
///
/// # Panics
/// If they are not.
pub fn agrees_with_the_plain_sum<T: Real>(
    build: impl Constructor<T>,
    bound: Bound,
    kernel: TestKernel,
    coordinates: usize,
    lengths: &[usize],
) {
    for &length in lengths {
        // One memory, cleared for the next signal: its kernel takes longer to make than many a run.
        let mut memory = build(kernel, coordinates * kernel.stages(), length);
        let weights = kernel.weights::<T>(length);
        for signal in Signal::ALL {
            memory.clear();
            let (error, k) = largest_error(&mut *memory, &weights, signal, 40);
            assert!(
                error <= bound.on(signal),
                "{kernel:?}, {coordinates} coordinates, length {length}, {signal:?}: error {error} u at k = {k}"
            );
        }
    }
}

/// Checks what the trait promises beside the numbers: repeated calls, failing calls, `clear`.
///
/// # Panics
/// If a promise is broken.
pub fn keeps_the_contract<T: Real>(build: impl Constructor<T>, kernel: TestKernel, length: usize) {
    let channels = 2 * kernel.stages();
    let signal = Signal::Stationary.samples::<T>(channels, length);
    let sample = |k: usize| &signal[k * channels..(k + 1) * channels];
    let bits = |numbers: &[T]| numbers.iter().map(|number| number.to_f64().to_bits()).collect::<Vec<_>>();

    let mut calm = build(kernel, channels, length);
    assert_eq!((calm.channels(), calm.stages()), (channels, kernel.stages()));
    assert_eq!(bits(calm.leading()), bits(&kernel.weights::<T>(1)));
    assert!(calm.is_empty() && calm.bytes() > 0);
    let mut expected = Vec::new();
    let mut term = vec![T::zero(); channels];
    for k in 0..length {
        calm.next_term(&mut term).expect("room");
        expected.push(bits(&term));
        calm.push(sample(k)).expect("room");
        assert_eq!(calm.len(), k + 1);
    }
    if let Err(full) = calm.next_term(&mut term) {
        assert!(matches!(full, MemoryError::Full { capacity } if capacity >= length), "{full}");
        assert_eq!(calm.push(sample(0)), Err(full));
        assert_eq!(calm.len(), length);
    }

    // The same run with refused and repeated calls in between, in a memory that was used before.
    let mut teased = build(kernel, channels, length);
    for k in 0..length / 2 {
        teased.push(sample(length - 1 - k)).expect("room");
    }
    teased.clear();
    assert!(teased.is_empty());
    let mut dirty = vec![T::of(f64::NAN); channels];
    let mut long = vec![T::zero(); channels + 1];
    for (k, expected) in expected.iter().enumerate() {
        let refusal = MemoryError::ChannelMismatch { expected: channels, found: channels + 1 };
        assert_eq!(teased.next_term(&mut long), Err(refusal));
        assert_eq!(teased.push(&long), Err(refusal));
        let refusal = MemoryError::ChannelMismatch { expected: channels, found: 0 };
        assert_eq!(teased.next_term(&mut []), Err(refusal));
        assert_eq!(teased.push(&[]), Err(refusal));
        for _ in 0..2 {
            dirty.fill(T::of(f64::NAN));
            teased.next_term(&mut dirty).expect("room");
            assert_eq!(bits(&dirty), *expected, "k = {k}");
        }
        teased.push(sample(k)).expect("room");
    }
}
