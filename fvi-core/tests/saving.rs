//! A state saved in the middle and restored elsewhere goes on with the same bits; anything else is refused.

use fvi_core::nalgebra::{SMatrix, SVector};
use fvi_core::{
    BdfOrder, Coefficients, Collocation, ConvolutionWeights, Damping, DampingTerm, Derivative, Direct,
    ExponentialSum, ExponentialTable, Fixed, FixedDirect, FractionalOperator, Galerkin, Integrator, Kernel,
    Mass, Memory, MemoryError, NoForce, NodeGalerkin, Overflow, Potential, Quadratic, Real, RungeKutta,
    Sample, Scheme, Start, StateError, StateReader, StateWriter, Stateful, System, Tiled,
};

const STEPS: usize = 60;

fn bits<T: Real>(numbers: &[T]) -> Vec<u64> {
    numbers.iter().map(|number| number.bits()).collect()
}

fn signal<T: Real>(k: usize, channels: usize) -> Vec<T> {
    (0..channels).map(|channel| T::of((0.37 * k as f64 + channel as f64).sin())).collect()
}

fn saved<T: Real>(memory: &dyn Memory<T>) -> Vec<u8> {
    let mut bytes = vec![0xa5; memory.state_bytes()];
    let mut writer = StateWriter::new(&mut bytes);
    memory.save(&mut writer).unwrap();
    assert_eq!(writer.written(), memory.state_bytes());
    bytes
}

/// Restores, after a look whether it will.
fn restore<S: Stateful + ?Sized>(object: &mut S, bytes: &[u8]) -> Result<(), StateError> {
    let (mut ahead, mut reader) = (StateReader::new(bytes), StateReader::new(bytes));
    let checked = object.check_state(&mut ahead);
    let restored = object.restore(&mut reader);
    assert_eq!(checked.is_ok(), restored.is_ok(), "{checked:?} {restored:?}");
    restored?;
    assert_eq!(ahead.left(), reader.left());
    reader.finish()
}

/// Terms of the next `steps` samples, which are pushed.
fn resume<T: Real>(memory: &mut dyn Memory<T>, steps: usize) -> Vec<u64> {
    let mut term = vec![T::zero(); memory.channels()];
    let mut terms = Vec::new();
    for _ in 0..steps {
        memory.next_term(&mut term).unwrap();
        terms.extend(bits(&term));
        memory.push(&signal(memory.len(), memory.channels())).unwrap();
    }
    terms
}

/// Saves after every number of samples and restores to a fresh memory and to a used one; every truncation is
/// refused and leaves the memory as it was.
fn goes_on<'m, T: Real>(build: &dyn Fn() -> Box<dyn Memory<T> + 'm>) {
    let mut memory = build();
    for k in (0..STEPS).step_by(7) {
        let bytes = saved(&*memory);
        let (mut fresh, mut used) = (build(), build());
        resume(&mut *used, 11);
        let before = saved(&*used);
        for length in 0..bytes.len() {
            assert!(restore(&mut *used, &bytes[..length]).is_err(), "{length} bytes of {}", bytes.len());
        }
        assert!(saved(&*used) == before, "a refusal changed the memory");
        restore(&mut *fresh, &bytes).unwrap();
        restore(&mut *used, &bytes).unwrap();
        assert_eq!((fresh.len(), used.len()), (k, k));
        assert!(saved(&*fresh) == bytes);
        let expected = resume(&mut *memory, 7);
        assert!(resume(&mut *fresh, 7) == expected && resume(&mut *used, 7) == expected, "{k} samples");
    }
    // Bits flipped in what says shape and counts: refused, or taken as another count, but never a panic.
    let bytes = saved(&*memory);
    for place in 0..bytes.len().min(64) {
        for bit in 0..8 {
            let mut flipped = bytes.clone();
            flipped[place] ^= 1 << bit;
            let mut other = build();
            if restore(&mut *other, &flipped).is_ok() {
                let _ = other.next_term(&mut vec![T::zero(); other.channels()]);
                let _ = other.push(&signal(0, other.channels()));
            } else {
                assert!(other.is_empty(), "a refusal changed the memory");
            }
        }
    }
}

fn weights<T: Real>(count: usize) -> Vec<T> {
    let mut weights = vec![T::zero(); count];
    ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 1.0).unwrap().fill(&mut weights);
    weights
}

fn every_memory_goes_on<T: Real>() {
    let table = weights::<T>(100);
    goes_on(&|| Box::new(FixedDirect::<T, 2, 80>::full_memory(&table, T::one()).unwrap()));
    goes_on(&|| Box::new(FixedDirect::<T, 2, 16>::short_memory(&table, T::one()).unwrap()));
    goes_on(&|| Box::new(Tiled::<T, 2, 10>::new(&table, T::one(), Overflow::Refuse).unwrap()));
    goes_on(&|| Box::new(Tiled::<T, 1, 4>::new(&table, T::one(), Overflow::Forget).unwrap()));
    let planes = weights::<T>(4 * 80);
    let rings = || [const { fvi_core::heapless::Deque::<T, 80>::new() }; 4];
    goes_on(&|| Box::new(Direct::new(&planes[..], 2, T::one(), rings(), Overflow::Refuse).unwrap()));
    let number = T::of;
    let exponentials: Vec<T> =
        [0.01, 0.25, 0.5, 0.0, 0.5, 0.25, 0.125, 0.0, 0.75, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
            .map(number)
            .to_vec();
    let head = [2.0, 1.0, 0.75, 0.5, 0.25].map(number);
    for slow_blocks in [0, 2] {
        let table = ExponentialTable {
            stages: 1,
            head: &head[..],
            exponentials: &exponentials[..],
            slow_blocks,
            far_blocks: 0,
            horizon: 1000,
            step_size: 1.0,
        };
        let state = || vec![T::zero(); table.state_len(2)];
        goes_on(&|| Box::new(ExponentialSum::new(table, T::one(), 2, state()).unwrap()));
    }
}

#[test]
fn every_memory_goes_on_with_the_same_bits() {
    every_memory_goes_on::<f64>();
    every_memory_goes_on::<f32>();
}

#[test]
fn a_state_of_another_engine_kernel_or_precision_is_refused() {
    let (table, single) = (weights::<f64>(40), weights::<f32>(40));
    let direct = |scale| FixedDirect::<f64, 1, 40>::full_memory(&table, scale).unwrap();
    let tiled = || Tiled::<f64, 1, 5>::new(&table, 1.0, Overflow::Refuse).unwrap();
    let bytes = saved(&direct(1.0));
    let kind = StateError::Kind { expected: *b"tile", found: *b"dire" };
    assert_eq!(restore(&mut tiled(), &bytes), Err(kind));
    let what = |error| match error {
        Err(StateError::Mismatch { what, .. }) => what,
        other => panic!("{other:?}"),
    };
    assert_eq!(what(restore(&mut direct(2.0), &bytes)), "fingerprint of the kernel");
    let mut float = FixedDirect::<f32, 1, 40>::full_memory(&single, 1.0).unwrap();
    assert_eq!(what(restore(&mut float, &bytes)), "bytes of a number");
    let mut two = FixedDirect::<f64, 2, 40>::full_memory(&table, 1.0).unwrap();
    assert_eq!(what(restore(&mut two, &bytes)), "channels");
    let mut surplus = bytes.clone();
    surplus.push(0);
    assert_eq!(restore(&mut direct(1.0), &surplus), Err(StateError::Surplus { bytes: 1 }));
}

/// A pendulum: its equations are solved by Newton's method.
#[derive(Clone, Copy)]
struct Cosine;

impl<T: Real, const N: usize> Potential<T, N> for Cosine {
    fn value(&self, position: &SVector<T, N>) -> T {
        position.iter().fold(T::zero(), |sum, &q| sum - q.cos())
    }

    fn gradient(&self, position: &SVector<T, N>) -> SVector<T, N> {
        position.map(|q| q.sin())
    }

    fn hessian(&self, position: &SVector<T, N>) -> SMatrix<T, N, N> {
        SMatrix::from_diagonal(&position.map(|q| q.cos()))
    }
}

fn term<T: Real, M: Memory<T>>(memory: M) -> DampingTerm<T, Fixed<2>, M> {
    let rho = Coefficients::Diagonal([T::of(0.3), T::of(0.1)].into());
    DampingTerm::new(Kernel::given(0.5).unwrap(), rho, Derivative::Caputo, memory).unwrap()
}

/// A run saved in the middle and continued by another integrator, which has made other steps before.
fn an_integrator_goes_on<T, P, S, D>(potential: P, scheme: S, damping: impl Fn() -> D)
where
    T: Real,
    P: Potential<T, 2> + Copy,
    S: Scheme<T, Fixed<2>> + Copy,
    D: Damping<T, Fixed<2>>,
{
    let build = |position: f64| {
        let force = NoForce;
        let system = System { mass: Mass::diagonal([T::one(), T::of(2.0)]).unwrap(), potential, force };
        Integrator::builder(system, scheme, T::of(0.1))
            .damping(damping())
            .position([T::of(position), T::of(-0.5)])
            .build()
            .unwrap()
    };
    let input = SVector::from([T::of(0.2), T::zero()]);
    let (mut first, mut second) = (build(1.0), build(0.3));
    let advance = |integrator: &mut Integrator<_, _, _, _, _>, steps: usize| {
        for _ in 0..steps {
            integrator.step(&input).unwrap();
        }
    };
    advance(&mut first, 20);
    advance(&mut second, 20);
    let mut bytes = vec![0; first.state_bytes()];
    first.save(&mut StateWriter::new(&mut bytes)).unwrap();
    let before = *second.state();
    for length in 0..bytes.len() {
        assert!(restore(&mut second, &bytes[..length]).is_err(), "{length} bytes");
    }
    assert!(*second.state() == before, "a refusal changed the state");
    restore(&mut second, &bytes).unwrap();
    for _ in 0..20 {
        advance(&mut first, 1);
        advance(&mut second, 1);
        assert_eq!(first.state().step, second.state().step);
        for (one, other) in [
            (first.state().position, second.state().position),
            (first.state().momentum, second.state().momentum),
        ] {
            assert_eq!(bits(one.as_slice()), bits(other.as_slice()));
        }
    }
}

fn spring<T: Real>() -> Quadratic<T, 2> {
    Quadratic::diagonal([T::one(), T::of(3.0)]).unwrap()
}

fn in_any_precision<T: Real>() {
    let table = weights::<T>(100);
    let low_order = Galerkin::low_order(T::of(0.5)).unwrap();
    let direct = || term(FixedDirect::<T, 2, 50>::full_memory(&table, T::one()).unwrap());
    an_integrator_goes_on(Cosine, low_order, direct);
    let stages = NodeGalerkin::<T, 2, 2>::with_stages(&RungeKutta::radau_iia().unwrap()).unwrap();
    let planes = weights::<T>(4 * 50);
    let rings = || [const { fvi_core::heapless::Deque::<T, 50>::new() }; 4];
    let of_stages = || term(Direct::new(&planes[..], 2, T::one(), rings(), Overflow::Refuse).unwrap());
    an_integrator_goes_on(spring(), stages, of_stages);
    let collocation = Collocation::<T, 2>::new(&RungeKutta::radau_iia().unwrap());
    an_integrator_goes_on(spring(), collocation, of_stages);
    an_integrator_goes_on(Cosine, collocation, of_stages);
}

#[test]
fn an_integrator_goes_on_with_the_same_bits() {
    in_any_precision::<f64>();
    in_any_precision::<f32>();
}

#[test]
fn integrators_with_several_memories_or_none_go_on_with_the_same_bits() {
    let table = weights::<f64>(100);
    let low_order = Galerkin::low_order(0.5).unwrap();
    let direct = || term(FixedDirect::<f64, 2, 50>::full_memory(&table, 1.0).unwrap());
    let tiled = || term(Tiled::<f64, 2, 10>::new(&table, 1.0, Overflow::Refuse).unwrap());
    an_integrator_goes_on(spring(), low_order, || (direct(), tiled()));
    an_integrator_goes_on(spring(), low_order, || [direct(), direct()]);
    an_integrator_goes_on(Cosine, low_order, || ());
}

#[test]
fn an_operator_goes_on_with_the_same_bits() {
    let table = weights::<f64>(40);
    let memory = || FixedDirect::<f64, 1, 40>::full_memory(&table, 1.0).unwrap();
    let operator = |start| FractionalOperator::new(memory(), start).unwrap();
    let starts = [Start::RiemannLiouville, Start::Caputo, Start::CaputoWithRise { rise: 0.5 }];
    for (index, &start) in starts.iter().enumerate() {
        let (mut first, mut second) = (operator(start), operator(start));
        for k in 0..10 {
            first.push(1.0 + f64::from(k)).unwrap();
            second.push(5.0).unwrap();
        }
        let mut bytes = vec![0; first.state_bytes()];
        first.save(&mut StateWriter::new(&mut bytes)).unwrap();
        for other in [starts[(index + 1) % 3], Start::CaputoWithRise { rise: 0.25 }] {
            let refused = restore(&mut operator(other), &bytes);
            assert!(
                matches!(refused, Err(StateError::Mismatch { .. })),
                "{start:?} as {other:?}: {refused:?}"
            );
        }
        for length in 0..bytes.len() {
            assert!(restore(&mut second.clone(), &bytes[..length]).is_err());
        }
        restore(&mut second, &bytes).unwrap();
        for _ in 0..10 {
            assert_eq!(first.push(0.7).unwrap().to_bits(), second.push(0.7).unwrap().to_bits(), "{start:?}");
        }
    }
}

/// Weights w₀ = 1/h, w₁ = −1/h of the step at hand: a memory for steps of any length.
struct Difference {
    leading: [f64; 1],
    last: Option<f64>,
}

impl Memory<f64> for Difference {
    fn channels(&self) -> usize {
        1
    }

    fn leading(&self) -> &[f64] {
        &self.leading
    }

    fn leading_is_constant(&self) -> bool {
        false
    }

    fn len(&self) -> usize {
        self.last.iter().count()
    }

    fn begin_step(&mut self, length: f64) -> Result<(), MemoryError> {
        self.leading = [1.0 / length];
        Ok(())
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        term[0] = -self.leading[0] * self.last.unwrap_or(0.0);
        Ok(())
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.last = Some(sample[0]);
        Ok(())
    }

    fn clear(&mut self) {
        self.last = None;
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
    }
}

impl Stateful for Difference {}

#[test]
fn a_memory_hears_the_length_of_every_step() {
    let memory = Difference { leading: [f64::NAN], last: None };
    let rho = Coefficients::Diagonal([1.0].into());
    let kernel = Kernel::given(1.0).unwrap();
    let mut term = DampingTerm::new(kernel, rho, Derivative::RiemannLiouville, memory).unwrap();
    let mut damping = |step_size: f64, rise: f64| {
        let (mut known, mut scratch) = ([0.0], [0.0; 2]);
        let sample = Sample { from: &[2.0], behind: &[], time: 1.0, length: step_size, fractions: &[1.0] };
        Damping::<f64, Fixed<1>>::add_known(&mut term, &sample, &mut known, &mut scratch).unwrap();
        Damping::<f64, Fixed<1>>::add_leading(&term, &[rise], &mut known, &mut scratch);
        known[0]
    };
    // ρ q̇ of the step, with no sample yet: q_k counts as a jump from zero.
    assert_eq!(damping(0.5, 0.0), 4.0);
    assert_eq!(damping(0.25, 1.0), 12.0);
    let unsaved = Difference { leading: [0.0], last: None };
    assert_eq!(unsaved.save(&mut StateWriter::new(&mut [])), Err(StateError::Unsupported));
}

#[test]
fn equal_step_kernels_refuse_steps_of_another_size() {
    let table = weights::<f64>(8);
    let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 0.25).unwrap();
    let memory = kernel.full_memory::<f64, 1, 8>(&table).unwrap();
    let rho = Coefficients::Diagonal([1.0].into());
    let mut term = DampingTerm::new(kernel, rho, Derivative::Caputo, memory).unwrap();
    let (mut known, mut scratch) = ([0.0], [0.0; 2]);
    let mut add = |length| {
        let sample = Sample { from: &[0.0], behind: &[], time: 0.0, length, fractions: &[1.0] };
        Damping::<f64, Fixed<1>>::add_known(&mut term, &sample, &mut known, &mut scratch)
    };
    assert_eq!(add(0.25), Ok(()));
    assert_eq!(add(0.5), Err(MemoryError::StepLength));
}
