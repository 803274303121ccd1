//! What matrix weights cost: the block transforms on kernels of R×R matrices against the same engine on plain
//! numbers.

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use fvi_benches::noise;
use fvi_core::{BdfOrder, ConvolutionWeights, Memory, RungeKutta};
use fvi_fft::baseline::memory_term;
use fvi_fft::quadrature::runge_kutta_weights::RungeKuttaWeights;
use fvi_fft::{BlockFft, WeightTable};

const STEPS: usize = 100_000;
const EXPONENT: f64 = 0.5;

/// Runs measured in turn for the ratio; the fastest of each engine counts.
const TURNS: usize = 15;

/// One coordinate: a memory with as many channels as stages, and a signal for it.
struct Run {
    stages: usize,
    memory: BlockFft<f64>,
    signal: Vec<f64>,
}

impl Run {
    /// A memory for weights that lie row by row, checked at the last step against the compensated sum.
    fn new(stages: usize, weights: &[f64]) -> Self {
        let kernel = WeightTable::matrices(weights, stages);
        let memory = BlockFft::planned(kernel, stages, STEPS).expect("as many channels as stages");
        let mut run = Self { stages, memory, signal: noise(STEPS * stages) };
        let found = run.last_term();
        let last = memory_term(weights, stages, &run.signal, stages, STEPS - 1);
        for (found, last) in found.iter().zip(last) {
            assert!((found - last.sum).abs() <= 1e-14 * last.absolute, "{stages} stages");
        }
        run
    }

    fn last_term(&mut self) -> Vec<f64> {
        self.memory.clear();
        let mut term = vec![0.0; self.stages];
        for sample in self.signal.chunks_exact(self.stages) {
            self.memory.next_term(black_box(&mut term)).expect("room");
            self.memory.push(sample).expect("room");
        }
        term
    }
}

fn staged<const R: usize>() -> Run {
    let method = RungeKutta::<R>::radau_iia().expect("1 to 3 stages");
    let planes = RungeKuttaWeights::new(&method, EXPONENT, 1.0, STEPS).expect("good weights").planes();
    let entry = |index: usize| planes[index % (R * R) * STEPS + index / (R * R)];
    Run::new(R, &(0..STEPS * R * R).map(entry).collect::<Vec<_>>())
}

fn runs(criterion: &mut Criterion) {
    let mut weights = vec![0.0; STEPS];
    let source = ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, EXPONENT, 1.0);
    source.expect("a good exponent").fill(&mut weights);
    let mut runs = [Run::new(1, &weights), staged::<2>(), staged::<3>()];

    let mut group = criterion.benchmark_group("block-fft, 10⁵ steps");
    group.sample_size(20).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(3));
    group.throughput(Throughput::Elements(STEPS as u64));
    for run in &mut runs {
        let name = if run.stages == 1 { "plain numbers" } else { "matrices of stages" };
        group.bench_function(BenchmarkId::new(name, run.stages), |bencher| bencher.iter(|| run.last_term()));
    }
    group.finish();

    // In turn, so that all of them are slowed down alike by what else the machine does.
    let mut fastest = [f64::INFINITY; 3];
    for _ in 0..TURNS {
        for (run, fastest) in runs.iter_mut().zip(&mut fastest) {
            let start = Instant::now();
            black_box(run.last_term());
            *fastest = fastest.min(start.elapsed().as_secs_f64());
        }
    }
    for (run, seconds) in runs.iter().zip(fastest) {
        let (r, per_step) = (run.stages, 1e9 * seconds / STEPS as f64);
        let ratio = seconds / fastest[0];
        println!("R = {r}: {per_step:.0} ns a step, {ratio:.2} times plain numbers (R² + R = {})", r * r + r);
    }
}

criterion_group!(benches, runs);
criterion_main!(benches);
