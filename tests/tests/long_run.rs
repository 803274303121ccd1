//! A million steps of a nonlinear pendulum: the fast engines give one trajectory, in memories of very different size.

use fvi_core::{
    BdfOrder, ConvolutionWeights, DampingTerm, Derivative::Caputo, ExponentialSum, Galerkin, Integrator,
    Mass, Memory, NoForce, System,
};
use fvi_fft::{BlockFft, Pacing, RealTime};
use fvi_host::exponential_table::ExponentialKernel;
use fvi_tests::motion::{Pendulum, diagonal};
use nalgebra::vector;

const STEPS: usize = 1_000_000;
const STEP_SIZE: f64 = 0.01;
const DAMPING_ORDER: f64 = 0.5;

fn kernel() -> ConvolutionWeights {
    ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, DAMPING_ORDER, STEP_SIZE).unwrap()
}

/// Position and momentum every thousandth step, and the bytes of the memory at the end.
fn run(memory: impl Memory<f64>) -> (Vec<[f64; 2]>, usize) {
    // So weakly damped that it still swings through half a radian at the end.
    let damping = DampingTerm::new(diagonal(2e-4), DAMPING_ORDER, Caputo, memory).unwrap();
    let system =
        System { mass: Mass::diagonal([1.0]).unwrap(), potential: Pendulum { gravity: 1.0 }, force: NoForce };
    let scheme = Galerkin::low_order(0.5).unwrap();
    let mut integrator =
        Integrator::new(system, scheme, damping, STEP_SIZE, vector![2.0], vector![0.0]).unwrap();
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
    let table = ExponentialKernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, DAMPING_ORDER, STEP_SIZE, samples, 1e-15)
        .unwrap()
        .table::<f64>();
    let state = vec![0.0; table.borrow().state_len(1)];
    let table = fvi_core::ExponentialTable {
        stages: 1,
        head: table.head.as_ref().to_vec(),
        exponentials: table.exponentials.as_ref().to_vec(),
        slow_blocks: table.slow_blocks,
        horizon: table.horizon,
    };
    let (exponential, small) = run(ExponentialSum::new(table, 1.0, 1, state).unwrap());
    let (block, _) = run(BlockFft::planned(kernel(), 1, samples).unwrap());
    let (real_time, large) = run(RealTime::planned(kernel(), 1, samples, Pacing::Paced).unwrap());
    assert!(small < 4096 && large > 8 * STEPS, "{small} and {large} bytes");
    let size = |states: &[[f64; 2]]| states.iter().flatten().fold(0.0, |m, x| f64::max(m, x.abs()));
    assert!(size(&exponential[900..]) > 0.2, "the pendulum came to rest: {}", size(&exponential[900..]));
    for (name, other) in [("block-fft", &block), ("real-time", &real_time)] {
        for (thousand, (a, b)) in (1..).zip(exponential.iter().zip(other)) {
            let error = (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
            assert!(error < 1e-9, "{name}, step {}: {error:e}", 1000 * thousand);
        }
    }
}
