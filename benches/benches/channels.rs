//! Exponential sums for many channels: nanoseconds for each channel and step, and bytes of state for each
//! channel.
//!
//! `cargo bench -p fvi-benches --bench channels` prints a table for docs/large.md. The answers are compared
//! first. Times are minima over rounds of one chunk, in which the memories take turns, so that what else the
//! machine does meets all of them. Two lines below say how fast one and two threads copy memory here: with
//! many channels the state is fetched from there, and two threads gain no more than copies do.

use fvi_core::{BdfOrder, ExponentialTable, Memory};
use fvi_fft::{ChunkedExponentialSum, WideExponentialSum};
use fvi_host::numerics::aligned::Aligned;
use fvi_host::numerics::exponential_table::{ExponentialKernel, SMALLEST_TOLERANCE};
use std::time::Instant;

/// Steps of a round: whole chunks of all memories.
const ROUND: usize = 64;

/// Memories that take turns.
struct Contender {
    name: &'static str,
    memory: Box<dyn Memory<f64>>,
    /// Against the first one, relative to the largest term.
    allowed: f64,
    best: f64,
    term: Vec<f64>,
}

fn table(tolerance: f64) -> ExponentialTable<Aligned<f64>> {
    let order = BdfOrder::new(2).expect("an order");
    ExponentialKernel::bdf_on_increments(order, 0.6, 1.0, 1 << 20, tolerance).expect("a table").table()
}

/// GB/s, read and written, of so many threads that copy numbers from one half of memory of theirs to the
/// other, together far more than caches hold; the best of some rounds.
fn copies(threads: usize, rounds: usize) -> f64 {
    const NUMBERS: usize = 1 << 25;
    let mut numbers = vec![1.0; NUMBERS];
    let mut best = f64::INFINITY;
    for _ in 0..rounds {
        let begin = Instant::now();
        std::thread::scope(|scope| {
            for part in numbers.chunks_mut(NUMBERS / threads) {
                scope.spawn(|| {
                    let (from, to) = part.split_at_mut(part.len() / 2);
                    to.copy_from_slice(std::hint::black_box(from));
                });
            }
        });
        best = best.min(begin.elapsed().as_secs_f64());
    }
    (NUMBERS * size_of::<f64>()) as f64 / best * 1e-9
}

fn main() {
    let rounds = if std::env::args().any(|argument| argument == "--bench") { 12 } else { 1 };
    let (exact, loose) = (table(SMALLEST_TOLERANCE), table(2.5e-7));
    println!("BDF 2, D^0.6 on increments, horizon 2^20\n");
    println!("| channels | memory | bytes a channel | ns a channel and step | of the first |");
    println!("|---|---|---|---|---|");
    let counts: &[usize] = if rounds > 1 { &[64, 128, 1_000, 10_000, 100_000] } else { &[1_000] };
    for &channels in counts {
        let wide = |threads| {
            WideExponentialSum::<f64>::new(&exact.borrow(), channels).expect("a table").on_threads(threads)
        };
        let single = WideExponentialSum::<f64, f32>::new(&loose.borrow(), channels).expect("a table");
        let chunked = ChunkedExponentialSum::<f64, 1>::new(&exact.borrow(), channels).expect("a table");
        let contender = |name, memory: Box<dyn Memory<f64>>, allowed| Contender {
            name,
            memory,
            allowed,
            best: f64::INFINITY,
            term: vec![0.0; channels],
        };
        let mut contenders = vec![
            contender("chunked", Box::new(chunked), 0.0),
            contender("wide", Box::new(wide(1)), 1e-13),
            contender("wide, two threads", Box::new(wide(2)), 1e-13),
            contender("wide, f32 states, 5e-7", Box::new(single), 1e-6),
        ];
        let mut sample = vec![0.0; channels];
        let mut k = 0;
        for _ in 0..=rounds {
            let first = k;
            for contender in &mut contenders {
                let mut spent = 0.0;
                k = first;
                for _ in 0..ROUND {
                    for (channel, number) in sample.iter_mut().enumerate() {
                        *number = ((k * 7 + channel) % 101) as f64 - 50.0;
                    }
                    let begin = Instant::now();
                    contender.memory.next_term(&mut contender.term).expect("room");
                    contender.memory.push(&sample).expect("room");
                    spent += begin.elapsed().as_secs_f64();
                    k += 1;
                }
                contender.best = contender.best.min(spent / (ROUND * channels) as f64);
            }
            let (first, others) = contenders.split_first().expect("several");
            let largest = first.term.iter().fold(0.0, |largest: f64, term| largest.max(term.abs()));
            for other in others {
                let apart = first.term.iter().zip(&other.term).map(|(a, b)| (a - b).abs());
                let apart = apart.fold(0.0, f64::max);
                assert!(apart <= other.allowed * largest, "{}: {apart:e} of {largest:e}", other.name);
            }
        }
        let slowest = contenders.first().map_or(1.0, |contender| contender.best);
        for Contender { name, memory, best, .. } in &contenders {
            let (bytes, time) = (memory.bytes() / channels, 1e9 * best);
            println!("| {channels} | {name} | {bytes} | {time:.2} | {:.2} |", best / slowest);
        }
    }
    let [one, two] = [1, 2].map(|threads| copies(threads, rounds));
    println!("\ncopies on one thread: {one:.1} GB/s");
    println!("copies on two threads: {two:.1} GB/s, {:.2} times as fast", two / one);
}
