//! What a caller sees besides trajectories: messages and causes of errors, borrowed parts, names that say the
//! same, and what is refused.

use fvi_core::heapless::Deque;
use fvi_core::nalgebra::{SMatrix, SVector};
use fvi_core::{
    ActsOn, BdfOrder, Coefficients, ConvolutionWeights, DampingError, DampingTerm, Derivative, Direct,
    DoubleDouble, ExponentialSum, ExponentialTable, Fixed, FixedDirect, Force, FractionalOperator, Galerkin,
    Instant, Integrator, IntegratorError, Kernel, Mass, MatrixError, Memory, MemoryError, Mismatch, NoForce,
    OperatorError, Overflow, ParameterError, Potential, Quadratic, Rule, RungeKutta, Scheme, Singular, Start,
    StateError, StateReader, StateWriter, Stateful, StepError, Symbol, System, Tiled, leading_bdf_weight,
    monic_bdf_table, monic_bdf_table_f32, monic_increment_table, monic_increment_table_f32,
};
use std::error::Error;
use std::hint::black_box;

const GRUNWALD: BdfOrder = BdfOrder::GRUNWALD_LETNIKOV;
static VALUES: [f64; 32] = monic_bdf_table(GRUNWALD, 0.5);
static INCREMENTS: [f64; 32] = monic_increment_table(GRUNWALD, 0.5);

fn parameter() -> ParameterError {
    ParameterError { parameter: "step size", value: -1.0, allowed: "positive and finite" }
}

/// An error, words that its message has, and its cause.
type Case = (Box<dyn Error>, &'static [&'static str], Option<Box<dyn Error>>);

#[test]
fn every_error_says_what_happened_and_names_its_cause() {
    let full = MemoryError::Full { capacity: 7 };
    let shape = Mismatch::Shape { channels_needed: 4, channels: 3, stages_needed: 2, stages: 1 };
    let diverged = StepError::NotConverged { iterations: 50, residual: 0.25 };
    let mismatch = StateError::Mismatch { what: "channels", expected: 1, found: 2 };
    let too_large = StateError::TooLarge { what: "samples", limit: 8, found: 9 };
    let errors: Vec<Case> = vec![
        (parameter().into(), &["step size", "-1", "positive and finite"], None),
        (full.into(), &["full", "7 samples"], None),
        (MemoryError::ChannelMismatch { expected: 3, found: 2 }.into(), &["2 numbers", "3 channels"], None),
        (MemoryError::StepLength.into(), &["steps of another length"], None),
        (MatrixError::NotFinite.into(), &["not a finite number"], None),
        (
            MatrixError::NotSymmetric { row: 2, column: 0 }.into(),
            &["not symmetric", "(2, 0)", "(0, 2)"],
            None,
        ),
        (MatrixError::NotPositiveDefinite.into(), &["not positive definite"], None),
        (MatrixError::NotPositiveSemidefinite.into(), &["not positive semidefinite"], None),
        (Singular.into(), &["singular"], None),
        (shape.into(), &["3 channels and 1 stages", "4 and 2 are needed"], None),
        (
            Mismatch::StepSize { kernel: 0.1, integrator: 0.2 }.into(),
            &["step size 0.1", "steps of 0.2"],
            None,
        ),
        (DampingError::Order(parameter()).into(), &["step size"], Some(parameter().into())),
        (DampingError::Kernel(parameter()).into(), &["step size"], Some(parameter().into())),
        (
            DampingError::Coefficients(MatrixError::NotFinite).into(),
            &["damping coefficient", "not a finite number"],
            Some(MatrixError::NotFinite.into()),
        ),
        (IntegratorError::StepSize(parameter()).into(), &["step size"], Some(parameter().into())),
        (IntegratorError::InitialState.into(), &["initial position or momentum"], None),
        (IntegratorError::Damping(shape).into(), &["3 channels"], Some(shape.into())),
        (IntegratorError::Memory(full).into(), &["full"], Some(full.into())),
        (diverged.into(), &["did not converge in 50 iterations", "2.5e-1"], None),
        (StepError::SingularJacobian.into(), &["Jacobian", "singular"], None),
        (
            StepError::IndefiniteMass { coordinate: 3, energy: -0.5 }.into(),
            &["not positive definite", "coordinate 3", "-5e-1"],
            None,
        ),
        (StepError::NotFinite.into(), &["not a finite number"], None),
        (StepError::Memory(full).into(), &["full"], Some(full.into())),
        (OperatorError::NotFinite.into(), &["not a finite number"], None),
        (OperatorError::Memory(full).into(), &["full"], Some(full.into())),
        (StateError::NoRoom { room: 5 }.into(), &["does not fit into 5 bytes"], None),
        (StateError::Truncated { needed: 8, left: 3 }.into(), &["3 bytes are left", "8 are needed"], None),
        (StateError::Surplus { bytes: 2 }.into(), &["2 bytes are left over"], None),
        (
            StateError::Kind { expected: *b"tile", found: *b"di\0e" }.into(),
            &["\"di\\x00e\", not \"tile\""],
            None,
        ),
        (mismatch.into(), &["channels is 2, not 1"], None),
        (too_large.into(), &["samples = 9", "at most 8"], None),
        (StateError::Unsupported.into(), &["cannot save its state"], None),
    ];
    for (error, words, cause) in errors {
        let message = error.to_string();
        for word in words {
            assert!(message.contains(word), "`{message}` lacks `{word}`");
        }
        let found = error.source().map(ToString::to_string);
        assert_eq!(found, cause.map(|cause| cause.to_string()), "cause of `{message}`");
    }
}

/// Terms of so many samples that are pushed.
fn terms(mut memory: impl Memory<f64>, count: usize) -> Vec<f64> {
    (0..count)
        .map(|k| {
            let mut term = [f64::NAN];
            memory.begin_step(1.0).unwrap();
            memory.next_term(&mut term).unwrap();
            memory.push(&[(0.7 * k as f64).sin()]).unwrap();
            term[0]
        })
        .collect()
}

fn facts(memory: &impl Memory<f64>) -> (usize, usize, usize, Option<usize>, usize) {
    (memory.len(), memory.channels(), memory.bytes(), memory.overruns(), memory.state_bytes())
}

#[test]
fn a_borrowed_memory_is_the_memory_itself() {
    let build = || Tiled::<f64, 1, 4>::new(&VALUES, 1.0, Overflow::Refuse).unwrap();
    let (mut lent, mut own) = (build(), build());
    assert_eq!(terms(&mut lent, 20), terms(&mut own, 20));
    assert_eq!(facts(&&mut lent), facts(&own));
    let mut bytes = vec![0; own.state_bytes()];
    Stateful::save(&&mut lent, &mut StateWriter::new(&mut bytes)).unwrap();
    let mut other = build();
    Stateful::restore(&mut &mut other, &mut StateReader::new(&bytes)).unwrap();
    assert_eq!(terms(&mut other, 5), terms(&mut own, 5));
    Memory::clear(&mut &mut lent);
    assert!(lent.is_empty());
}

/// Samples are counted, and nothing else is offered.
struct Plain {
    count: usize,
}

impl Memory<f64> for Plain {
    fn channels(&self) -> usize {
        1
    }

    fn leading(&self) -> &[f64] {
        &[1.0]
    }

    fn len(&self) -> usize {
        self.count
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        term.fill(0.0);
        Ok(())
    }

    fn push(&mut self, _: &[f64]) -> Result<(), MemoryError> {
        self.count += 1;
        Ok(())
    }

    fn clear(&mut self) {
        self.count = 0;
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
    }
}

impl Stateful for Plain {}

#[test]
fn a_memory_of_ones_own_that_cannot_be_saved_says_so() {
    let mut memory = Plain { count: 0 };
    assert_eq!((memory.state_bytes(), memory.acts_on(), memory.stages()), (0, ActsOn::Values, 1));
    assert_eq!(memory.save(&mut StateWriter::new(&mut [])), Err(StateError::Unsupported));
    assert_eq!(memory.check_state(&mut StateReader::new(&[])), Err(StateError::Unsupported));
    assert_eq!(memory.restore(&mut StateReader::new(&[])), Err(StateError::Unsupported));
    let rho = Coefficients::Diagonal([1.0].into());
    let term = DampingTerm::new(Kernel::given(0.5).unwrap(), rho, Derivative::Caputo, memory).unwrap();
    let mut run = oscillator(0.1).damping(term).build().unwrap();
    run.step(&[0.0].into()).unwrap();
    let mut bytes = vec![0; run.state_bytes()];
    assert_eq!(run.save(&mut StateWriter::new(&mut bytes)), Err(StateError::Unsupported));
}

#[test]
fn tables_made_at_run_time_are_those_of_the_compiler() {
    let (order, exponent) = (black_box(GRUNWALD), black_box(0.5));
    assert_eq!(monic_bdf_table::<32>(order, exponent), VALUES);
    assert_eq!(monic_increment_table::<32>(order, exponent), INCREMENTS);
    assert_eq!(monic_bdf_table_f32::<32>(order, exponent), VALUES.map(|weight| weight as f32));
    assert_eq!(monic_increment_table_f32::<32>(order, exponent), INCREMENTS.map(|weight| weight as f32));
    for outside in [-1.0, 2.0, f64::NAN] {
        assert!(monic_bdf_table::<3>(order, black_box(outside)).iter().all(|weight| weight.is_nan()));
    }
    let order = black_box(BdfOrder::new(3).unwrap());
    let leading = leading_bdf_weight(order, 0.3, 1.0).unwrap();
    let weights = ConvolutionWeights::bdf(order, 0.3, 1.0).unwrap();
    for (monic, weight) in monic_bdf_table::<6>(order, 0.3).iter().zip(weights) {
        assert!((leading * monic - weight).abs() <= 4.0 * f64::EPSILON * leading, "{monic} {weight}");
    }
}

type Oscillator<D> = fvi_core::IntegratorBuilder<
    f64,
    Fixed<1>,
    System<f64, 1, Quadratic<f64, 1>, NoForce>,
    Galerkin<f64, 1, 1>,
    D,
>;

fn oscillator(step_size: f64) -> Oscillator<()> {
    let (mass, potential) = (Mass::diagonal([2.0]).unwrap(), Quadratic::diagonal([3.0]).unwrap());
    let system = System { mass, potential, force: NoForce };
    Integrator::builder(system, Galerkin::low_order(0.5).unwrap(), step_size).position([1.0])
}

#[test]
fn a_start_by_velocity_is_one_by_momentum_and_times_may_be_given() {
    let mut by_velocity = oscillator(0.1).velocity([0.25]).build().unwrap();
    let mut by_momentum = oscillator(0.1).momentum([0.5]).build().unwrap();
    let mut velocity = [0.0].into();
    by_momentum.velocity(&mut velocity);
    assert_eq!(velocity[0], 0.25);
    let rest = [0.0].into();
    for k in 1..=10 {
        by_velocity.step(&rest).unwrap();
        by_momentum.step_to(0.1 * f64::from(k), &rest).unwrap();
    }
    let (one, other) = (by_velocity.state(), by_momentum.state());
    assert!((one.position[0] - other.position[0]).abs() < 1e-15);
    assert!((one.momentum[0] - other.momentum[0]).abs() < 1e-15);
    for past in [1.0, 0.5, f64::NAN, f64::INFINITY] {
        let refused = by_momentum.step_to(past, &rest);
        assert_eq!(refused, Err(StepError::Memory(MemoryError::StepLength)), "to t = {past}");
    }
    let lost = oscillator(0.1).velocity([f64::NAN]).build().err();
    assert_eq!(lost, Some(IntegratorError::InitialState));
}

#[test]
fn a_kernel_names_itself_and_makes_equal_memories_of_every_kind() {
    let kernel = Kernel::bdf(GRUNWALD, 0.5, 0.1).unwrap();
    assert_eq!((kernel.rule(), kernel.symbol()), (Rule::Bdf(GRUNWALD), Symbol::Power { exponent: 0.5 }));
    let sums = |table: &[f64]| {
        let full = terms(kernel.full_memory::<f64, 1, 32>(table).unwrap(), 30);
        let tiled = terms(kernel.tiled_memory::<f64, 1, 4>(table, Overflow::Refuse).unwrap(), 30);
        for (one, other) in full.iter().zip(&tiled) {
            assert!((one - other).abs() < 1e-14, "{one} {other}");
        }
    };
    sums(&VALUES);
    sums(&INCREMENTS);
    let acts_on = |table| kernel.tiled_memory::<f64, 1, 4>(table, Overflow::Refuse).unwrap().acts_on();
    assert_eq!((acts_on(&VALUES), acts_on(&INCREMENTS)), (ActsOn::Values, ActsOn::Increments));
    // Tables of plain numbers are no memory of a kernel of matrices.
    let coupled = Kernel::runge_kutta(&RungeKutta::<2>::radau_iia().unwrap(), 0.5, 0.1).unwrap();
    let refused = coupled.tiled_memory::<f64, 1, 4>(&VALUES, Overflow::Refuse).err();
    assert_eq!(refused.map(|error| error.parameter), Some("kernel"));
}

#[test]
fn what_a_memory_is_told_of_its_samples_is_what_it_says() {
    let table = ExponentialTable {
        stages: 1,
        head: &[1.0, 0.5][..],
        exponentials: &[0.5, 0.25, 0.125, 0.0, 0.75, 0.0, 0.0, 0.0][..],
        slow_blocks: 0,
        far_blocks: 0,
        horizon: 100,
        step_size: 1.0,
    };
    let sum = ExponentialSum::new(table, 1.0, 1, vec![0.0; table.state_len(1)]).unwrap();
    assert_eq!(sum.acts_on(), ActsOn::Values);
    assert_eq!(sum.table().horizon, 100);
    assert_eq!(sum.acting_on(ActsOn::Increments).acts_on(), ActsOn::Increments);
    let ring = [const { Deque::<f64, 8>::new() }; 1];
    let direct = Direct::new(&VALUES[..], 1, 1.0, ring, Overflow::Forget).unwrap();
    assert_eq!(direct.acting_on(ActsOn::Increments).acts_on(), ActsOn::Increments);
}

#[test]
fn an_operator_that_is_cleared_begins_anew() {
    let memory = || FixedDirect::<f64, 1, 8>::full_memory(&VALUES, 1.0).unwrap();
    let mut operator = FractionalOperator::new(memory(), Start::Caputo).unwrap();
    let signal = [3.0, 1.0, 4.0, 1.5];
    let first: Vec<_> = signal.iter().map(|&sample| operator.push(sample).unwrap()).collect();
    assert_eq!((first[0], operator.memory().len()), (0.0, 4));
    operator.clear();
    let again: Vec<_> = signal.iter().map(|&sample| operator.push(sample).unwrap()).collect();
    assert_eq!(first, again);
}

#[test]
fn an_operator_refuses_what_has_no_meaning() {
    let memory = || FixedDirect::<f64, 1, 8>::full_memory(&VALUES, 1.0).unwrap();
    let operator = |start| FractionalOperator::new(memory(), start);
    let steps = OperatorError::Memory(MemoryError::StepLength);
    for start in [Start::CaputoWithRise { rise: f64::NAN }, Start::CaputoWithSlope { slope: f64::INFINITY }] {
        assert_eq!(operator(start).err(), Some(OperatorError::NotFinite));
    }
    // A slope is per time, a rise per step.
    assert_eq!(operator(Start::CaputoWithSlope { slope: 1.0 }).unwrap().push(1.0), Err(steps));
    assert_eq!(operator(Start::CaputoWithRise { rise: 1.0 }).unwrap().push_after(0.1, 1.0), Err(steps));
    let on_increments = memory().acting_on(ActsOn::Increments);
    let mut operator = FractionalOperator::new(on_increments, Start::Caputo).unwrap();
    assert_eq!(operator.push_after(0.1, 1.0), Err(steps));
    assert_eq!(operator.push(f64::NAN), Err(OperatorError::NotFinite));
    assert!(operator.memory().is_empty());
}

/// √t on a free mass, with the exact moments of linear shapes or without any.
struct Root {
    exact: bool,
}

impl Force<f64, 2> for Root {
    fn value(&self, instant: Instant<f64>, _: &SVector<f64, 2>) -> SVector<f64, 2> {
        [instant.time.sqrt(), 0.0].into()
    }

    fn moments(&self, start: f64, length: f64, points: &[f64], moments: &mut [SVector<f64, 2>]) -> bool {
        assert_eq!(points, [1.0]);
        let end = start + length;
        let difference = |power: f64| (end.powf(power) - start.powf(power)) / power;
        let whole = difference(1.5) / length;
        let rising = (difference(2.5) - start * difference(1.5)) / (length * length);
        moments[0] = [whole - rising, 0.0].into();
        moments[1] = [rising, 0.0].into();
        self.exact
    }
}

struct Free;

impl Potential<f64, 2> for Free {
    fn value(&self, _: &SVector<f64, 2>) -> f64 {
        0.0
    }

    fn gradient(&self, _: &SVector<f64, 2>) -> SVector<f64, 2> {
        SVector::zeros()
    }

    fn hessian(&self, _: &SVector<f64, 2>) -> SMatrix<f64, 2, 2> {
        SMatrix::zeros()
    }
}

#[test]
fn a_force_that_gives_its_moments_acts_without_error_of_quadrature() {
    fn error(scheme: impl Scheme<f64, Fixed<2>>, exact: bool) -> f64 {
        let mass = Mass::diagonal([1.0, 2.0]).unwrap();
        let system = System { mass, potential: Free, force: Root { exact } };
        let mut run = Integrator::builder(system, scheme, 0.1).build().unwrap();
        for _ in 0..10 {
            run.step(&SVector::zeros()).unwrap();
        }
        // p(1) = ∫₀¹ √t dt
        (run.state().momentum[0] - 2.0 / 3.0).abs()
    }
    let scheme = || Galerkin::low_order(0.5).unwrap();
    let (with, without) = (error(scheme(), true), error(scheme(), false));
    assert!(with < 1e-15 && without > 1e-3, "{with:e} {without:e}");
}

#[test]
fn room_and_digits_that_are_left_can_be_asked_for() {
    let mut reader = StateReader::new(&[1, 0, 0, 0, 0, 0, 0, 0, 9]);
    assert_eq!((reader.left(), reader.count(), reader.left()), (9, Ok(1), 1));
    let mut room = [0; 7];
    assert_eq!(StateWriter::new(&mut room).numbers([&1.0]), Err(StateError::NoRoom { room: 7 }));
    let third = DoubleDouble::ONE.divide(3.0);
    // What a double leaves of one third: 1/3 − 6004799503160661·2⁻⁵⁴ = 2⁻⁵⁴/3.
    assert!((third.low() - 0.5f64.powi(54) / 3.0).abs() < 1e-32, "{:e}", third.low());
}

/// Weights W_n of a table, entry (a, b), by its definition.
fn weight_of(table: &ExponentialTable<Vec<f64>>, n: usize, a: usize, b: usize) -> f64 {
    let stages = table.stages;
    let head = table.head.len() / (stages * stages);
    if n < head {
        return table.head[(a * stages + b) * head + n];
    }
    let rows = if stages == 1 { 2 } else { 1 + 2 * stages };
    let blocks = table.exponentials.chunks(4 * rows);
    let terms = blocks.flat_map(|block| {
        (0..4).map(move |lane| {
            let entry = |row: usize| block[4 * row + lane];
            let input = if stages == 1 { 1.0 } else { entry(1 + stages + b) };
            (1.0 - entry(0)).powi((n - head) as i32) * entry(1 + a) * input
        })
    });
    terms.sum()
}

/// Numbers in (−1, 1) that look random, the same in every run.
fn numbers(count: usize, seed: f64) -> Vec<f64> {
    (0..count).map(|k| (seed + 12.9898 * k as f64 + 0.01 * (k * k) as f64).sin()).collect()
}

fn exponentials(stages: usize, head: usize, blocks: usize) -> ExponentialTable<Vec<f64>> {
    let rows = if stages == 1 { 2 } else { 1 + 2 * stages };
    let mut exponentials = numbers(4 * rows * blocks, 2.0);
    for block in exponentials.chunks_mut(4 * rows) {
        block[..4].iter_mut().for_each(|decay| *decay = 0.5 * decay.abs());
    }
    let slow_blocks = blocks.saturating_sub(1);
    ExponentialTable {
        stages,
        head: numbers(head * stages * stages, 1.0),
        exponentials,
        slow_blocks,
        far_blocks: 0,
        horizon: 60,
        step_size: 1.0,
    }
}

#[test]
fn an_exponential_sum_is_the_sum_of_its_weights_for_any_head_blocks_stages_and_channels() {
    for (stages, head, blocks, coordinates) in [
        (1, 1, 0, 1),
        (1, 2, 1, 1),
        (1, 3, 2, 2),
        (1, 6, 3, 1),
        (1, 11, 3, 3),
        (2, 2, 1, 1),
        (2, 7, 3, 2),
        (3, 3, 2, 2),
        (4, 5, 1, 1),
    ] {
        let table = exponentials(stages, head, blocks);
        let channels = stages * coordinates;
        let state = vec![f64::NAN; table.borrow::<f64>().state_len(channels)];
        let mut memory = ExponentialSum::new(table.clone(), 0.5, channels, state).unwrap();
        let case = format!("{stages} stages, head of {head}, {blocks} blocks, {coordinates} coordinates");
        assert_eq!((memory.stages(), memory.channels()), (stages, channels), "{case}");
        for (place, &weight) in memory.leading().iter().enumerate() {
            assert_eq!(weight, 0.5 * weight_of(&table, 0, place / stages, place % stages), "{case}");
        }
        // A second time after it is cleared.
        for _ in 0..2 {
            let mut samples: Vec<Vec<f64>> = Vec::new();
            for k in 0..60 {
                let mut term = vec![f64::NAN; channels];
                memory.next_term(&mut term).unwrap();
                for (channel, &found) in term.iter().enumerate() {
                    let (group, a) = (channel / stages * stages, channel % stages);
                    let products = (1..=k).flat_map(|n| (0..stages).map(move |b| (n, b)));
                    let plain = products
                        .filter(|&(n, _)| blocks > 0 || n < head)
                        .map(|(n, b)| 0.5 * weight_of(&table, n, a, b) * samples[k - n][group + b])
                        .sum::<f64>();
                    assert!((found - plain).abs() < 1e-12, "{case}, step {k}: {found} and {plain}");
                }
                samples.push(numbers(channels, 100.0 + k as f64));
                memory.push(&samples[k]).unwrap();
            }
            let full = Err(MemoryError::Full { capacity: 60 });
            assert_eq!((memory.push(&samples[0]), memory.next_term(&mut vec![0.0; channels])), (full, full));
            memory.clear();
        }
    }
}

#[test]
fn tables_of_exponentials_with_a_wrong_shape_are_refused() {
    for stages in 1..=4 {
        let good = exponentials(stages, 3, 2);
        let refused =
            |table: ExponentialTable<Vec<f64>>| table.borrow::<f64>().check().map_err(|e| e.parameter);
        assert_eq!(refused(good.clone()), Ok(()), "{stages}");
        let shorter = |head: &[f64], by: usize| head[..head.len() - by].to_vec();
        let ragged = ExponentialTable { head: shorter(&good.head, 1), ..good.clone() };
        // One weight is enough without exponentials only.
        let single = ExponentialTable { head: good.head[..stages * stages].to_vec(), ..good.clone() };
        if stages > 1 {
            assert_eq!(refused(ragged), Err("head weights"), "{stages}");
        }
        assert_eq!(refused(single.clone()), Err("head weights"), "{stages}");
        assert_eq!(refused(ExponentialTable { exponentials: vec![], slow_blocks: 0, ..single }), Ok(()));
        let empty = ExponentialTable { head: vec![], ..good.clone() };
        assert_eq!(refused(empty), Err("head weights"));
        let cut = ExponentialTable { exponentials: shorter(&good.exponentials, 4), ..good.clone() };
        assert_eq!(refused(cut), Err("numbers of exponentials"), "{stages}");
        assert_eq!(refused(ExponentialTable { slow_blocks: 2, ..good.clone() }), Ok(()));
        assert_eq!(refused(ExponentialTable { slow_blocks: 3, ..good }), Err("slow blocks"));
    }
}

#[test]
fn slow_exponentials_keep_small_samples_in_single_precision() {
    // An integral in disguise: W_n = 1 for every n, by one exponential that forgets nothing.
    let table = ExponentialTable {
        stages: 1,
        head: vec![1.0f32, 1.0],
        exponentials: vec![0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        slow_blocks: 1,
        far_blocks: 0,
        horizon: 1_000_000,
        step_size: 1.0,
    };
    let state = vec![0.0; table.borrow::<f32>().state_len(1)];
    let mut memory = ExponentialSum::new(table, 1.0, 1, state).unwrap();
    for _ in 0..200_000 {
        memory.push(&[0.1]).unwrap();
    }
    let mut term = [0.0];
    memory.next_term(&mut term).unwrap();
    let error = f64::from(term[0]) / (200_000.0 * f64::from(0.1f32)) - 1.0;
    assert!(error.abs() < 4.0 * f64::from(f32::EPSILON), "{error:e}");
}

#[test]
fn memories_count_their_bytes_with_the_table_that_they_use() {
    let table = size_of_val(&VALUES);
    let direct = FixedDirect::<f64, 2, 8>::full_memory(&VALUES, 1.0).unwrap();
    assert_eq!(direct.bytes(), size_of_val(&direct) + table);
    let tiled = Tiled::<f64, 2, 4>::new(&VALUES, 1.0, Overflow::Refuse).unwrap();
    assert_eq!(tiled.bytes(), size_of_val(&tiled) + table);
    let exponentials = exponentials(1, 3, 2);
    let numbers = exponentials.head.len() + exponentials.exponentials.len();
    let length = exponentials.borrow::<f64>().state_len(2);
    let sum = ExponentialSum::new(exponentials, 1.0, 2, vec![0.0; length]).unwrap();
    assert_eq!(sum.bytes(), size_of_val(&sum) - size_of::<Vec<f64>>() + 8 * (numbers + length));
}

#[test]
fn a_state_is_taken_by_a_memory_of_the_same_kernel_that_lacks_no_sample() {
    fn saved(memory: &impl Memory<f64>) -> Vec<u8> {
        let mut bytes = vec![0; memory.state_bytes()];
        memory.save(&mut StateWriter::new(&mut bytes)).unwrap();
        bytes
    }
    fn fed<M: Memory<f64>>(mut memory: M) -> M {
        (0..6).for_each(|k| memory.push(&[f64::from(k)]).unwrap());
        memory
    }
    let tiled = |scale, overflow| Tiled::<f64, 1, 4>::new(&VALUES, scale, overflow).unwrap();
    let bytes = saved(&fed(tiled(1.0, Overflow::Refuse)));
    let mut twice = tiled(2.0, Overflow::Refuse);
    let refused = twice.restore(&mut StateReader::new(&bytes)).unwrap_err();
    assert!(matches!(refused, StateError::Mismatch { what: "fingerprint of the kernel", .. }), "{refused}");
    let refused = tiled(1.0, Overflow::Forget).restore(&mut StateReader::new(&bytes)).unwrap_err();
    assert!(matches!(refused, StateError::Mismatch { what: "refusal of an overflow", .. }), "{refused}");
    assert!(tiled(1.0, Overflow::Refuse).restore(&mut StateReader::new(&bytes)).is_ok());

    // One weight that differs makes another kernel.
    for place in 1..16 {
        let mut others = VALUES;
        others[place] *= 1.5;
        let mut other = Tiled::<f64, 1, 4>::new(&others, 2.0, Overflow::Refuse).unwrap();
        let bytes = saved(&tiled(2.0, Overflow::Refuse));
        assert!(other.restore(&mut StateReader::new(&bytes)).is_err(), "weight {place}");
    }

    // A ring of four has forgotten what one of eight needs, not the other way round.
    let four = || FixedDirect::<f64, 1, 4>::short_memory(&VALUES, 1.0).unwrap();
    let eight = || FixedDirect::<f64, 1, 8>::short_memory(&VALUES, 1.0).unwrap();
    let lacking = eight().restore(&mut StateReader::new(&saved(&fed(four()))));
    assert_eq!(lacking, Err(StateError::Mismatch { what: "kept samples", expected: 6, found: 4 }));
    let mut taken = four();
    taken.restore(&mut StateReader::new(&saved(&fed(eight())))).unwrap();
    assert_eq!(terms(taken, 3), terms(fed(four()), 3));
}

#[test]
fn exponents_outside_the_range_make_no_kernel() {
    let method = RungeKutta::<2>::radau_iia().unwrap();
    for outside in [-1.0, 2.0, -3.0, 7.0, f64::NAN] {
        assert_eq!(Kernel::given(outside).unwrap_err().parameter, "exponent", "{outside}");
        assert_eq!(Kernel::bdf(GRUNWALD, outside, 0.1).unwrap_err().parameter, "exponent", "{outside}");
        assert_eq!(Kernel::runge_kutta(&method, outside, 0.1).unwrap_err().parameter, "exponent");
    }
    for inside in [-0.999, 0.0, 1.999] {
        assert!(Kernel::given(inside).is_ok() && Kernel::bdf(GRUNWALD, inside, 0.1).is_ok());
    }
}

#[test]
fn the_leading_weight_of_a_step_half_as_long_is_larger_by_the_power_of_two() {
    for p in 1..=6 {
        let weight = |h| leading_bdf_weight(BdfOrder::new(p).unwrap(), 0.75, h).unwrap();
        let ratio = weight(0.05) / weight(0.1);
        assert!((ratio - 2f64.powf(0.75)).abs() < 1e-14, "{ratio}");
    }
}

#[test]
fn a_whole_derivative_looks_back_as_far_as_its_order() {
    for p in 1..=6 {
        let weights = ConvolutionWeights::bdf(BdfOrder::new(p).unwrap(), 1.0, 0.1).unwrap();
        let sums: Vec<f64> = weights.clone().on_increments().take(40).collect();
        assert!(sums[..p].iter().all(|&weight| weight != 0.0), "p = {p}: {sums:?}");
        assert!(sums[p..].iter().all(|&weight| weight == 0.0), "p = {p}: {sums:?}");
        assert!(weights.skip(p + 1).take(40).all(|weight| weight == 0.0), "p = {p}");
    }
}

/// True if a damping term takes a memory with this leading weight for one of the kernel.
fn takes<const S: usize>(kernel: Kernel, leading: &[f64]) -> bool {
    let rings = [const { Deque::<f64, 4>::new() }; S];
    let memory = Direct::new(leading, S, 1.0, rings, Overflow::Refuse).unwrap();
    let rho = Coefficients::Diagonal([1.0].into());
    DampingTerm::<f64, Fixed<1>, _>::new(kernel, rho, Derivative::Caputo, memory).is_ok()
}

#[test]
fn kernels_of_every_method_are_told_by_the_determinant_of_their_leading_weight() {
    // W₀ = (A⁻¹/h)^β. The stability function of R stages is a Padé approximant: det A = (R−1)!/(2R−1)! for
    // Radau IIA and (R−2)!/(2R−2)! for Lobatto IIIC.
    fn check<const S: usize>(method: &RungeKutta<S>, determinant: f64) {
        let (beta, h) = (0.5f64, 0.25f64);
        let kernel = Kernel::runge_kutta(method, beta, h).unwrap();
        let right = (determinant * h.powi(S as i32)).powf(-beta);
        // Lower triangular, the rows turned by one place: an even permutation for one and three stages.
        let matrix = |determinant: f64| {
            let mut leading = vec![0.0; S * S];
            for row in 0..S {
                leading[(row + 1) % S * S + row] = if row == 0 { determinant } else { 1.0 };
            }
            leading
        };
        let sign = if S % 2 == 1 { 1.0 } else { -1.0 };
        assert!(takes::<S>(kernel, &matrix(sign * right)), "{S} stages");
        for wrong in [-sign * right, sign * right * 1.001, sign / right, 0.0] {
            assert!(!takes::<S>(kernel, &matrix(wrong)), "{S} stages: {wrong} for {right}");
        }
    }
    check(&RungeKutta::<1>::radau_iia().unwrap(), 1.0);
    check(&RungeKutta::<2>::radau_iia().unwrap(), 1.0 / 6.0);
    check(&RungeKutta::<3>::radau_iia().unwrap(), 1.0 / 60.0);
    check(&RungeKutta::<2>::lobatto_iiic().unwrap(), 1.0 / 2.0);
    check(&RungeKutta::<3>::lobatto_iiic().unwrap(), 1.0 / 24.0);
    check(&RungeKutta::<4>::lobatto_iiic().unwrap(), 1.0 / 360.0);
}

#[test]
fn kernels_of_three_stages_mix_them_by_their_planes_and_scale() {
    // Entry (i, j) of W₁ is 10 i + j + 11, of W₂ ten times that.
    let planes: Vec<f64> = (0..9)
        .flat_map(|plane| {
            let entry = f64::from(10 * (plane / 3) + plane % 3 + 11);
            [0.0, entry, 10.0 * entry]
        })
        .collect();
    let rings = [const { Deque::<f64, 8>::new() }; 3];
    let mut memory = Direct::new(&planes[..], 3, 0.5, rings, Overflow::Refuse).unwrap();
    assert_eq!(memory.stages(), 3);
    memory.push(&[0.0, 0.0, 2.0]).unwrap();
    memory.push(&[2.0, 0.0, 0.0]).unwrap();
    let mut term = [0.0; 3];
    memory.next_term(&mut term).unwrap();
    assert_eq!(term, [11.0 + 130.0, 21.0 + 230.0, 31.0 + 330.0]);
}

#[test]
fn the_inverse_of_a_method_undoes_its_matrix() {
    fn check<const S: usize>(method: &RungeKutta<S>) {
        let inverse = method.inverse().unwrap();
        for (row, numbers) in method.matrix().iter().enumerate() {
            for column in 0..S {
                let product: f64 = numbers.iter().zip(&inverse).map(|(a, line)| a * line[column]).sum();
                let unit = f64::from(u8::from(row == column));
                assert!((product - unit).abs() < 1e-13, "{S} stages, ({row}, {column}): {product}");
            }
        }
    }
    check(&RungeKutta::<1>::radau_iia().unwrap());
    check(&RungeKutta::<2>::radau_iia().unwrap());
    check(&RungeKutta::<3>::radau_iia().unwrap());
    check(&RungeKutta::<2>::lobatto_iiic().unwrap());
    check(&RungeKutta::<3>::lobatto_iiic().unwrap());
    check(&RungeKutta::<4>::lobatto_iiic().unwrap());
}
