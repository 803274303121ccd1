//! Time per step of the whole integrator: a chain of pendulums with one damping term on a short memory.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use fvi_core::{
    BdfOrder, Coefficients, DampingTerm, Derivative, FixedDirect, Galerkin, Integrator, Mass, NoForce,
    Potential, System, leading_bdf_weight, monic_bdf_table,
};
use nalgebra::{SMatrix, SVector};

const HISTORY: usize = 256;
static WEIGHTS: [f64; HISTORY + 1] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
const STEP_SIZE: f64 = 0.01;

/// Pendulums, each tied to its neighbours by a spring.
struct PendulumChain;

impl<const N: usize> Potential<f64, N> for PendulumChain {
    fn value(&self, q: &SVector<f64, N>) -> f64 {
        let hanging: f64 = q.iter().map(|q| -q.cos()).sum();
        hanging + q.as_slice().windows(2).map(|pair| 0.5 * (pair[1] - pair[0]).powi(2)).sum::<f64>()
    }

    fn gradient(&self, q: &SVector<f64, N>) -> SVector<f64, N> {
        let mut gradient = q.map(f64::sin);
        for i in 1..N {
            let pull = q[i] - q[i - 1];
            gradient[i] += pull;
            gradient[i - 1] -= pull;
        }
        gradient
    }

    fn hessian(&self, q: &SVector<f64, N>) -> SMatrix<f64, N, N> {
        let mut hessian = SMatrix::from_diagonal(&q.map(f64::cos));
        for i in 1..N {
            hessian[(i, i)] += 1.0;
            hessian[(i - 1, i - 1)] += 1.0;
            hessian[(i, i - 1)] -= 1.0;
            hessian[(i - 1, i)] -= 1.0;
        }
        hessian
    }
}

fn step<const N: usize>(criterion: &mut Criterion, history: bool) {
    let group = if history { "step with 256 samples" } else { "step without damping" };
    let mut group = criterion.benchmark_group(group);
    let system = System {
        mass: Mass::diagonal([1.0; N]).expect("positive"),
        potential: PendulumChain,
        force: NoForce,
    };
    let scheme = Galerkin::low_order(0.5).expect("in range");
    let start = SVector::<f64, N>::repeat(1.0);
    let input = SVector::zeros();
    if history {
        let scale = leading_bdf_weight(BdfOrder::GRUNWALD_LETNIKOV, 0.5, STEP_SIZE).expect("in range");
        let memory = FixedDirect::<f64, N, HISTORY>::short_memory(&WEIGHTS, scale).expect("good weights");
        let rho = Coefficients::Diagonal(SVector::repeat(1e-3));
        let damping = DampingTerm::new(rho, 0.5, Derivative::Caputo, memory).expect("good damping");
        let mut integrator = Integrator::new(system, scheme, damping, STEP_SIZE, start, SVector::zeros())
            .expect("good problem");
        for _ in 0..2 * HISTORY {
            integrator.step(&input).expect("a step");
        }
        group.bench_function(BenchmarkId::from_parameter(N), |bencher| {
            bencher.iter(|| black_box(&mut integrator).step(&input).expect("a step"));
        });
    } else {
        let mut integrator =
            Integrator::new(system, scheme, (), STEP_SIZE, start, SVector::zeros()).expect("good problem");
        group.bench_function(BenchmarkId::from_parameter(N), |bencher| {
            bencher.iter(|| black_box(&mut integrator).step(&input).expect("a step"));
        });
    }
    group.finish();
}

fn steps(criterion: &mut Criterion) {
    for history in [false, true] {
        step::<1>(criterion, history);
        step::<2>(criterion, history);
        step::<6>(criterion, history);
    }
}

criterion_group!(benches, steps);
criterion_main!(benches);
