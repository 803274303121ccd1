//! Convolution of a stream with a response, beside the crate `fft-convolver`: the table of the book's page on
//! streams.
//!
//! Every call is timed in several passes over the same stream, and the least of its times counts: the
//! schedule is the same in every pass, interrupts of the machine are not. The time of reading the clock is
//! subtracted. A stream has run for the length of the response before.

use std::alloc::System;
use std::hint::black_box;
use std::time::{Duration, Instant};

use fft_convolver::{FFTConvolver, TwoStageFFTConvolver};

use fvi_fft::{Convolver, Engines, Responses, Stream};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Samples per second.
const RATE: f64 = 48_000.0;
const RESPONSES: [f64; 5] = [0.1, 0.3, 1.0, 3.0, 10.0];
const BLOCKS: [usize; 6] = [1, 16, 64, 128, 256, 1024];
const PASSES: usize = 5;
/// Samples of a pass: two of the largest blocks of a stage, and more.
const SAMPLES: usize = 1 << 17;
/// A pass ends after as long, but not before so many calls.
const LONGEST_PASS: Duration = Duration::from_millis(600);
const FEWEST_CALLS: usize = 64;

/// What processes blocks.
trait Candidate<T> {
    /// Begins again, with samples that are not measured.
    fn restart(&mut self, before: &[T]);
    fn process(&mut self, input: &[T], output: &mut [T]);
}

impl<T: Engines> Candidate<T> for Convolver<T> {
    fn restart(&mut self, before: &[T]) {
        self.clear();
        let mut output = vec![T::zero(); before.len()];
        self.process_one(before, &mut output).expect("blocks of one channel");
    }

    fn process(&mut self, input: &[T], output: &mut [T]) {
        self.process_one(input, output).expect("blocks of one channel");
    }
}

impl<T: Engines> Candidate<T> for FFTConvolver<T> {
    // Its work does not depend on what came before.
    fn restart(&mut self, _: &[T]) {
        self.reset();
    }

    fn process(&mut self, input: &[T], output: &mut [T]) {
        FFTConvolver::process(self, input, output).expect("blocks of one channel");
    }
}

impl<T: Engines> Candidate<T> for TwoStageFFTConvolver<T> {
    // Its work does not depend on what came before.
    fn restart(&mut self, _: &[T]) {
        self.reset();
    }

    fn process(&mut self, input: &[T], output: &mut [T]) {
        TwoStageFFTConvolver::process(self, input, output).expect("blocks of one channel");
    }
}

/// Seconds of the calls, the shortest first.
fn measure<T: Engines>(
    candidate: &mut dyn Candidate<T>,
    (before, signal): (&[T], &[T]),
    block: usize,
    clock: f64,
) -> Vec<f64> {
    let mut least: Vec<f64> = Vec::new();
    let mut output = vec![T::zero(); block];
    for _ in 0..PASSES {
        candidate.restart(before);
        let begin = Instant::now();
        for (call, input) in signal.chunks_exact(block).enumerate() {
            let before = Instant::now();
            candidate.process(black_box(input), &mut output);
            let seconds = (before.elapsed().as_secs_f64() - clock).max(0.0);
            match least.get_mut(call) {
                Some(time) => *time = time.min(seconds),
                None => least.push(seconds),
            }
            if call + 1 >= FEWEST_CALLS && begin.elapsed() > LONGEST_PASS {
                break;
            }
        }
    }
    least.sort_by(f64::total_cmp);
    least
}

/// Median time of reading the clock twice.
fn clock() -> f64 {
    let mut times: Vec<f64> = (0..10_001).map(|_| Instant::now().elapsed().as_secs_f64()).collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// Mean, 99.9th percentile and longest in microseconds.
fn described(calls: &[f64]) -> [f64; 3] {
    let mean = calls.iter().sum::<f64>() / calls.len() as f64;
    [mean, calls[(calls.len() * 999).div_ceil(1000) - 1], calls[calls.len() - 1]].map(|time| 1e6 * time)
}

/// What `make` returns, with the bytes that it keeps.
fn weighed<C>(make: impl FnOnce() -> C) -> (C, f64) {
    let region = Region::new(ALLOCATOR);
    let made = make();
    let change = region.change();
    let grown = change.bytes_reallocated as f64;
    (made, change.bytes_allocated as f64 + grown - change.bytes_deallocated as f64)
}

/// Checks outputs against the plain sum, in units of rounding of the response's size.
fn agree<T: Engines>(convolver: &mut Convolver<T>, taps: &[T], signal: &[T]) {
    let mut output = vec![T::zero(); 4096];
    convolver.process_one(&signal[..4096], &mut output).expect("blocks of one channel");
    let size: f64 = taps.iter().map(|w| w.to_f64().abs()).sum();
    for k in (0..4096).step_by(97) {
        let terms = taps.iter().zip(signal[..=k].iter().rev()).map(|(w, x)| w.to_f64() * x.to_f64());
        let difference = (output[k].to_f64() - terms.sum::<f64>()).abs();
        assert!(difference < 8.0 * size * T::EPSILON.to_f64() / 2.0, "{k}: {difference}");
    }
}

fn compare<T: Engines>(scalar: &str, only: &[String]) {
    println!("\n{scalar}, microseconds per call of so many samples\n");
    let candidates =
        ["fvi", "uniform", "two stages"].map(|name| format!(" {name}: mean | p99.9 | worst | MB |"));
    println!("| response (s) | block |{}", candidates.concat());
    println!("|--:|--:|{}", "--:|".repeat(12));
    let clock = clock();
    let signal: Vec<T> = fvi_benches::noise(SAMPLES).into_iter().map(T::of).collect();
    let before: Vec<T> = fvi_benches::noise(481_280).into_iter().map(T::of).collect();
    let wanted = |what: &str| only.is_empty() || only.iter().any(|only| what == only);
    for response in RESPONSES.into_iter().filter(|response| wanted(&response.to_string())) {
        let length = (RATE * response) as usize;
        let decay = |n: usize| (-7.0 * n as f64 / length as f64).exp();
        let taps: Vec<T> =
            fvi_benches::noise(length).iter().enumerate().map(|(n, x)| T::of(x * decay(n))).collect();
        let responses = Responses::one(&taps).expect("finite");
        for block in BLOCKS {
            // A whole number of blocks.
            let before = &before[..length.next_multiple_of(1024)];
            let signal = (before, &*signal);
            let stream = Stream { block: Some(block), ..Stream::default() };
            let (mut own, own_bytes) = weighed(|| Convolver::new(&responses, &stream).expect("in range"));
            agree(&mut own, &taps, signal.1);
            let (mut uniform, uniform_bytes) = weighed(|| {
                let mut uniform = FFTConvolver::<T>::default();
                uniform.init(block, &taps).expect("in range");
                uniform
            });
            let (mut staged, staged_bytes) = weighed(|| {
                let mut staged = TwoStageFFTConvolver::<T>::default();
                staged.init_default(block, &taps).expect("in range");
                staged
            });
            print!("| {response} | {block} |");
            let candidates: [(&mut dyn Candidate<T>, f64); 3] =
                [(&mut own, own_bytes), (&mut uniform, uniform_bytes), (&mut staged, staged_bytes)];
            for (candidate, bytes) in candidates {
                let calls = measure(candidate, signal, block, clock);
                let [mean, tail, worst] = described(&calls);
                print!(" {mean:.2} | {tail:.2} | {worst:.2} | {:.2} |", bytes / 1e6);
            }
            println!();
            assert_eq!(own.overruns(), 0);
        }
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    compare::<f32>("f32", &arguments);
    compare::<f64>("f64", &arguments);
}
