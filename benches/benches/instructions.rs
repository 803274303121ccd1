//! Instructions, counted by valgrind, of the parts where a regression would hide in the noise of a clock.
//!
//! Needs valgrind, and `cargo install gungraun-runner` in the version of the library.
#![allow(missing_docs, reason = "the macros make public items")]

use std::hint::black_box;

use fvi_benches::{
    ChainIntegrator, HISTORY, ShortMemoryDamping, noise, pendulum_chain, short_memory_damping,
};
use fvi_core::{BdfOrder, ConvolutionWeights, Damping, Fixed, Memory, ParameterError};
use fvi_fft::WeightTable;
use fvi_fft::baseline::OfflineFft;
use fvi_fft::exponentials::exponential_table::{ExponentialKernel, SMALLEST_TOLERANCE};
use fvi_fft::transfer::TransferFunction;
use fvi_strategies::{BuiltStrategy, Task, engines};
use gungraun::{library_benchmark, library_benchmark_group, main};
use nalgebra::SVector;

/// Steps of a run: the counts below over this are instructions per step.
const STEPS: usize = 4096;

fn weights() -> Vec<f64> {
    let mut weights = vec![0.0; STEPS];
    ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 1.0).expect("in range").fill(&mut weights);
    weights
}

/// The engine of that name, and a signal.
fn engine(name: &str) -> (Box<dyn Memory<f64>>, Vec<f64>) {
    let task = Task::of_a_run(BdfOrder::GRUNWALD_LETNIKOV, 0.5, STEPS).expect("in range");
    let strategy =
        engines::strategies().into_iter().find(|strategy| strategy.name() == name).expect("a name");
    let memory = strategy.make(&task).ok().and_then(BuiltStrategy::into_memory).expect("a short run");
    (memory, noise(STEPS))
}

#[library_benchmark(setup = engine)]
#[bench::exponential_sum("exponential-sum")]
#[bench::exponential_sum_core("exponential-sum-core")]
#[bench::block_fft("block-fft")]
#[bench::real_time("real-time")]
#[bench::direct("direct")]
fn memory((mut memory, signal): (Box<dyn Memory<f64>>, Vec<f64>)) -> f64 {
    let mut term = [0.0];
    for sample in &signal {
        memory.next_term(&mut term).expect("room");
        memory.push(black_box(&[*sample])).expect("room");
    }
    term[0]
}

fn offline_transform() -> (OfflineFft, Vec<f64>, Vec<f64>) {
    let offline = OfflineFft::new(WeightTable::scalars(&weights()), STEPS).expect("a length");
    (offline, noise(STEPS), vec![0.0; STEPS])
}

#[library_benchmark]
#[bench::known_data(setup = offline_transform)]
fn offline_fft((mut offline, signal, mut terms): (OfflineFft, Vec<f64>, Vec<f64>)) -> Vec<f64> {
    offline.convolve(black_box(&signal), &mut terms);
    terms
}

#[library_benchmark]
#[bench::order_1(1)]
#[bench::order_6(6)]
fn quadrature_weights(order: usize) -> Vec<f64> {
    let mut weights = vec![0.0; STEPS];
    let order = BdfOrder::new(black_box(order)).expect("an order");
    ConvolutionWeights::bdf(order, 0.5, 1.0).expect("in range").fill(&mut weights);
    weights
}

#[library_benchmark]
#[bench::order_1(1, 0.5)]
#[bench::order_2(2, 1.5)]
#[bench::order_6(6, 0.7)]
fn table_of_exponentials(order: usize, exponent: f64) -> ExponentialKernel {
    let order = BdfOrder::new(black_box(order)).expect("an order");
    ExponentialKernel::bdf(order, exponent, 1.0, 1 << 20, SMALLEST_TOLERANCE).expect("a table")
}

#[library_benchmark]
#[bench::tempered(TransferFunction::tempered(0.5, 0.3))]
#[bench::maxwell(TransferFunction::maxwell(0.6, 0.0, 1.5))]
#[bench::havriliak_negami(TransferFunction::havriliak_negami(0.7, 0.5, 1.0))]
fn table_of_a_material(kernel: Result<TransferFunction, ParameterError>) -> ExponentialKernel {
    let (kernel, order) = (kernel.expect("in range"), BdfOrder::new(2).expect("an order"));
    ExponentialKernel::of_transfer(&kernel, order, true, 0.01, 1 << 20, SMALLEST_TOLERANCE).expect("a table")
}

fn with_full_memory() -> ChainIntegrator<ShortMemoryDamping<2>, 2> {
    let mut integrator = pendulum_chain(short_memory_damping());
    for _ in 0..2 * HISTORY {
        integrator.step(&SVector::zeros()).expect("a step");
    }
    integrator
}

fn steps<D: Damping<f64, Fixed<N>>, const N: usize>(mut integrator: ChainIntegrator<D, N>) -> f64 {
    for _ in 0..STEPS {
        integrator.step(black_box(&SVector::zeros())).expect("a step");
    }
    integrator.state().position[0]
}

#[library_benchmark]
#[bench::without_damping(pendulum_chain(()))]
fn two_pendulums(integrator: ChainIntegrator<(), 2>) -> f64 {
    steps(integrator)
}

#[library_benchmark]
#[bench::of_256_samples(with_full_memory())]
fn two_pendulums_with_memory(integrator: ChainIntegrator<ShortMemoryDamping<2>, 2>) -> f64 {
    steps(integrator)
}

library_benchmark_group!(
    name = instructions,
    benchmarks = [
        memory,
        offline_fft,
        quadrature_weights,
        table_of_exponentials,
        table_of_a_material,
        two_pendulums,
        two_pendulums_with_memory
    ]
);

main!(library_benchmark_groups = instructions);
