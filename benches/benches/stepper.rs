//! Time per step of the whole integrator: a chain of pendulums with one damping term on a short memory.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use fvi_benches::{ChainIntegrator, HISTORY, pendulum_chain, short_memory_damping};
use fvi_core::{Damping, Fixed};
use nalgebra::SVector;

fn step<D: Damping<f64, Fixed<N>>, const N: usize>(
    criterion: &mut Criterion,
    group: &str,
    mut integrator: ChainIntegrator<D, N>,
) {
    let input = SVector::zeros();
    for _ in 0..2 * HISTORY {
        integrator.step(&input).expect("a step");
    }
    criterion.benchmark_group(group).bench_function(BenchmarkId::from_parameter(N), |bencher| {
        bencher.iter(|| black_box(&mut integrator).step(&input).expect("a step"));
    });
}

fn steps(criterion: &mut Criterion) {
    let group = "step without damping";
    step(criterion, group, pendulum_chain::<_, 1>(()));
    step(criterion, group, pendulum_chain::<_, 2>(()));
    step(criterion, group, pendulum_chain::<_, 6>(()));
    let group = "step with 256 samples";
    step(criterion, group, pendulum_chain::<_, 1>(short_memory_damping()));
    step(criterion, group, pendulum_chain::<_, 2>(short_memory_damping()));
    step(criterion, group, pendulum_chain::<_, 6>(short_memory_damping()));
}

criterion_group!(benches, steps);
criterion_main!(benches);
