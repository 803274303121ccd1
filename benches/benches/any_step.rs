//! What steps of any length cost: the memory that takes them against the fixed-step memories of the same
//! Runge–Kutta quadrature, in one process and in turn, for steps of one length, for lengths that come back
//! and for steps of which each has a new one. `.ci/variable-steps` puts the table into
//! book/src/theory/variable-steps.md.

use fvi_fft::sums::max_or_nan;
use std::hint::black_box;
use std::time::Instant;

use fvi_benches::noise;
use fvi_core::{Memory, min_or_nan};
use fvi_fft::memory::{Engine, History};
use fvi_fft::memory::{HostMemory, MemoryRequest};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::transfer::TransferFunction;

const STEPS: usize = 1 << 15;

/// Samples that the tables are made for.
const HORIZON: usize = 1 << 20;

const EXPONENT: f64 = 0.5;

/// Runs measured in turn; the fastest of each counts.
const TURNS: usize = 9;

/// A memory and what it is fed.
struct Run {
    memory: HostMemory<f64>,
    channels: usize,
    lengths: Vec<f64>,
    fastest: f64,
}

impl Run {
    fn new(engine: Engine, stages: usize, coordinates: usize, lengths: Vec<f64>) -> Self {
        let history = History { engine: Some(engine), ..History::default() };
        let request = MemoryRequest {
            end: (engine == Engine::AnyStep).then_some(HORIZON as f64),
            family: ConvolutionFamily::RadauIia { stages },
            starting: &[],
            transfer: &TransferFunction::power(EXPONENT).expect("an exponent"),
            step_size: lengths.iter().copied().fold(f64::INFINITY, min_or_nan),
            coordinates,
            motions: 1,
            samples: HORIZON,
            given: true,
            history: &history,
        };
        let memory = request.build().expect("an engine for Runge–Kutta quadrature");
        Self { memory, channels: stages * coordinates, lengths, fastest: f64::INFINITY }
    }

    /// Runs once; returns the last derivative, W₀ x + r.
    fn run(&mut self, samples: &[f64]) -> Vec<f64> {
        self.memory.clear();
        let mut term = vec![0.0; self.channels];
        let start = Instant::now();
        for (sample, &length) in samples.chunks_exact(self.channels).zip(&self.lengths) {
            self.memory.begin_step(length).expect("a length of the table");
            self.memory.next_term(black_box(&mut term)).expect("room");
            self.memory.push(black_box(sample)).expect("room");
        }
        self.fastest = self.fastest.min(start.elapsed().as_secs_f64());
        let stages = self.memory.stages();
        let last = &samples[(STEPS - 1) * self.channels..];
        for (term, last) in term.chunks_exact_mut(stages).zip(last.chunks_exact(stages)) {
            for (term, row) in term.iter_mut().zip(self.memory.leading().chunks_exact(stages)) {
                *term += row.iter().zip(last).map(|(w, x)| w * x).sum::<f64>();
            }
        }
        term
    }
}

fn main() {
    println!(
        "| stages, coordinates | `exponential-sum`, ns | `exponential-sum-core` | `any-step`, equal steps \
         | halved and doubled in turn | each of a new length |"
    );
    println!("|---|---|---|---|---|---|");
    for (stages, coordinates) in [(1, 1), (2, 1), (3, 1), (3, 8)] {
        let samples = noise(STEPS * stages * coordinates);
        let equal = vec![1.0; STEPS];
        let halved = (0..STEPS).map(|k| if k % 3 == 0 { 1.0 } else { 0.5 }).collect();
        let different = noise(STEPS).iter().map(|x| 1.0 + 0.2 * x.clamp(-1.0, 1.0)).collect();
        let run = |engine, lengths| Run::new(engine, stages, coordinates, lengths);
        let mut runs = [
            run(Engine::ExponentialSum, equal.clone()),
            run(Engine::ExponentialSumCore, equal.clone()),
            run(Engine::AnyStep, equal),
            run(Engine::AnyStep, halved),
            run(Engine::AnyStep, different),
        ];
        let mut found: Vec<Vec<f64>> = Vec::new();
        for turn in 0..TURNS {
            for run in &mut runs {
                let derivative = run.run(&samples);
                if turn == 0 {
                    found.push(derivative);
                }
            }
        }
        for other in &found[1..3] {
            let largest = found[0].iter().fold(0.0_f64, |largest, x| max_or_nan(largest, x.abs()));
            for (one, other) in found[0].iter().zip(other) {
                assert!((one - other).abs() < 1e-10 * largest, "{one} {other}");
            }
        }
        let [chunked, others @ ..] = &runs;
        let per_step = 1e9 * chunked.fastest / (STEPS * coordinates) as f64;
        let ratios: Vec<_> =
            others.iter().map(|run| format!("{:.2}", run.fastest / chunked.fastest)).collect();
        println!("| {stages}, {coordinates} | {per_step:.0} | {} |", ratios.join(" | "));
    }
}
