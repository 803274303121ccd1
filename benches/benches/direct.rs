//! The direct memory's sum against a plain vectorised dot product of the same length.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use fvi_benches::noise;
use fvi_core::{FixedDirect, Memory};

const LENGTHS: [usize; 7] = [256, 512, 1024, 2048, 4096, 8192, 16384];
const CAPACITY: usize = 16385;

/// Σ aᵢ bᵢ, both in ascending order, with as many accumulators as the direct sum has.
fn dot_product(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        for (lane, (a, b)) in lanes.iter_mut().zip(a.iter().zip(b)) {
            *lane += a * b;
        }
    }
    lanes.iter().sum()
}

fn sums(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("direct sum");
    let weights = noise(CAPACITY);
    for length in LENGTHS {
        let samples = noise(length);
        group.throughput(Throughput::Elements(length as u64));
        group.bench_function(BenchmarkId::new("dot product", length), |bencher| {
            bencher.iter(|| dot_product(black_box(&weights[..length]), black_box(&samples)));
        });
        let mut memory = FixedDirect::<f64, 1, CAPACITY>::full_memory(&weights, 1.0).expect("good weights");
        for &sample in &samples {
            memory.push(&[sample]).expect("room");
        }
        group.bench_function(BenchmarkId::new("direct memory", length), |bencher| {
            let mut term = [0.0];
            bencher.iter(|| {
                black_box(&mut memory).next_term(&mut term).expect("room");
                term[0]
            });
        });
        // A ring that has turned: the history lies in two pieces.
        let mut turned =
            FixedDirect::<f64, 1, CAPACITY>::short_memory(&weights[..=length], 1.0).expect("good weights");
        for k in 0..CAPACITY + length / 3 {
            turned.push(&[samples[k % length]]).expect("forgets");
        }
        group.bench_function(BenchmarkId::new("direct memory in two pieces", length), |bencher| {
            let mut term = [0.0];
            bencher.iter(|| {
                black_box(&mut turned).next_term(&mut term).expect("forgets");
                term[0]
            });
        });
    }
    group.finish();
}

criterion_group!(benches, sums);
criterion_main!(benches);
