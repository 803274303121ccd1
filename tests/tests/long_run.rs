//! Long runs of a nonlinear pendulum: the engines give one trajectory, in memories of very different size.

use fvi_core::{
    BdfOrder, ConvolutionWeights, DampingTerm, Derivative::Caputo, ExponentialSum, Galerkin, Integrator,
    Kernel, Mass, Memory, NoForce, System,
};
use fvi_fft::exponentials::exponential_table::{ExponentialKernel, SMALLEST_TOLERANCE};
use fvi_fft::memory::Engine;
use fvi_fft::sums::max_or_nan;
use fvi_fft::{BlockFft, Pacing, RealTime};
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::{GridState, Precision, Simulation};
use fvi_tests::motion::{Pendulum, diagonal};
use nalgebra::vector;
use std::path::Path;

const STEPS: usize = 1_000_000;
const STEP_SIZE: f64 = 0.01;
const DAMPING_ORDER: f64 = 0.5;

fn kernel() -> ConvolutionWeights {
    ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, DAMPING_ORDER, STEP_SIZE).unwrap()
}

/// Position and momentum every thousandth step, and the bytes of the memory at the end.
fn run(memory: impl Memory<f64>) -> (Vec<[f64; 2]>, usize) {
    // So weakly damped that it still swings through half a radian at the end.
    let damping =
        DampingTerm::new(Kernel::given(DAMPING_ORDER).unwrap(), diagonal(2e-4), Caputo, memory).unwrap();
    let system =
        System { mass: Mass::diagonal([1.0]).unwrap(), potential: Pendulum { gravity: 1.0 }, force: NoForce };
    let scheme = Galerkin::low_order(0.5).unwrap();
    let mut integrator = Integrator::builder(system, scheme, STEP_SIZE)
        .damping(damping)
        .position(vector![2.0])
        .momentum(vector![0.0])
        .build()
        .unwrap();
    let mut states = vec![];
    for step in 1..=STEPS {
        integrator.step(&vector![0.0]).unwrap();
        if step % 1000 == 0 {
            states.push([integrator.state().position[0], integrator.state().momentum[0]]);
        }
    }
    (states, integrator.damping().memory().bytes())
}

#[test]
fn a_million_steps_of_a_pendulum_do_not_depend_on_the_engine() {
    let samples = STEPS + 1;
    let table = ExponentialKernel::bdf(
        BdfOrder::GRUNWALD_LETNIKOV,
        DAMPING_ORDER,
        STEP_SIZE,
        samples,
        SMALLEST_TOLERANCE,
    )
    .unwrap()
    .table::<f64>();
    let state = vec![0.0; table.borrow().state_len(1)];
    let (exponential, small) = run(ExponentialSum::new(table, 1.0, 1, state).unwrap());
    let (block, _) = run(BlockFft::planned(kernel(), 1, samples).unwrap());
    let (real_time, large) = run(RealTime::planned(kernel(), 1, samples, Pacing::Paced).unwrap());
    assert!(small < 4096 && large > 8 * STEPS, "{small} and {large} bytes");
    let size = |states: &[[f64; 2]]| states.iter().flatten().fold(0.0, |m, x| max_or_nan(m, x.abs()));
    assert!(size(&exponential[900..]) > 0.2, "the pendulum came to rest: {}", size(&exponential[900..]));
    for (name, other) in [("block-fft", &block), ("real-time", &real_time)] {
        for (thousand, (a, b)) in (1..).zip(exponential.iter().zip(other)) {
            let error = max_or_nan((a[0] - b[0]).abs(), (a[1] - b[1]).abs());
            assert!(error < 1e-9, "{name}, step {}: {error:e}", 1000 * thousand);
        }
    }
}

/// Position and momentum every hundredth step of a pendulum with Runge–Kutta quadrature, 10⁵ steps.
fn staged_run(engine: Engine) -> Vec<[f64; 2]> {
    let text = r#"
        [system]
        mass = [1.0]
        potential = "-cos(q0)"
        [[system.damping]]
        order = 0.5
        coefficient = [0.002]
        [initial]
        position = [2.0]
        momentum = [0.0]
        [scheme]
        kind = "galerkin"
        degree = 2
        [convolution]
        family = "radau-iia"
        stages = 2
        [time]
        step = 0.01
        steps = 100000
    "#;
    let document = Document::new("pendulum.toml", Path::new(""), text);
    let mut scenario = Scenario::from_document(document).unwrap();
    scenario.history.choose(engine);
    let mut simulation = Simulation::new(&scenario, Precision::F64).unwrap();
    assert_eq!(simulation.engines(), [engine]);
    let mut state = GridState { position: vec![0.0], momentum: vec![0.0], ..GridState::default() };
    let mut states = vec![];
    for step in 1..=scenario.time.steps {
        simulation.step(&[]).unwrap();
        if step % 100 == 0 {
            simulation.read(&mut state);
            states.push([state.position[0], state.momentum[0]]);
        }
    }
    states
}

#[test]
fn a_hundred_thousand_steps_with_matrix_weights_do_not_depend_on_the_engine() {
    // The plain sum runs through all of its 5·10⁹ pairs of steps: nothing is sampled.
    let plain = staged_run(Engine::Direct);
    let largest =
        [0, 1].map(|quantity| plain.iter().fold(0.0, |m, state| max_or_nan(m, state[quantity].abs())));
    let last = plain[900..].iter().fold(0.0, |m, state| max_or_nan(m, state[0].abs()));
    assert!(last > 0.5, "the pendulum came to rest: {last}");
    for engine in [Engine::BlockFft, Engine::RealTime, Engine::ExponentialSum] {
        for (hundred, (a, b)) in (1..).zip(plain.iter().zip(staged_run(engine))) {
            for quantity in [0, 1] {
                let error = (a[quantity] - b[quantity]).abs() / largest[quantity];
                assert!(error < 1e-9, "{}, step {}: {error:e}", engine.name(), 100 * hundred);
            }
        }
    }
}
