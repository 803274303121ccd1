//! Whole runs of each memory engine, and an offline transform of the same length as the lower bound.

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use fvi_benches::noise;
use fvi_core::BdfOrder;
use fvi_fft::WeightTable;
use fvi_fft::baseline::{OfflineFft, memory_term};
use fvi_strategies::{BuiltStrategy, Task, engines};

fn runs(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("memory");
    group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
    for length in [1 << 10, 1 << 14, 1 << 18] {
        let (order, exponent) = (BdfOrder::GRUNWALD_LETNIKOV, 0.5);
        let task = Task::of_a_run(order, exponent, length).expect("in range");
        let weights = &task.weights;
        let signal = noise(length);
        let last = memory_term(weights, 1, &signal, 1, length - 1)[0];
        group.throughput(Throughput::Elements(length as u64));

        let mut offline = OfflineFft::new(WeightTable::scalars(weights), length).expect("a length");
        let mut terms = vec![0.0; length];
        group.bench_function(BenchmarkId::new("offline-fft", length), |bencher| {
            bencher.iter(|| offline.convolve(black_box(&signal), &mut terms));
        });
        for strategy in engines::strategies() {
            // Those with plain sums sit out long runs; the offline transform is measured above.
            let Some(mut memory) = strategy.make(&task).ok().and_then(BuiltStrategy::into_memory) else {
                continue;
            };
            let mut run = || {
                memory.clear();
                let mut term = [0.0];
                for sample in &signal {
                    memory.next_term(&mut term).expect("room");
                    memory.push(&[*sample]).expect("room");
                }
                term[0]
            };
            // Norm-wise for the textbook's algorithm, which is among them.
            assert!((run() - last.sum).abs() <= 1e-9 * last.absolute, "{}", strategy.name());
            group.bench_function(BenchmarkId::new(strategy.name(), length), |bencher| bencher.iter(&mut run));
        }
    }
    group.finish();
}

criterion_group!(benches, runs);
criterion_main!(benches);
