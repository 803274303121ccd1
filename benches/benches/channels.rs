//! Exponential sums for many channels: nanoseconds for each channel and step, and bytes of state for each
//! channel.
//!
//! `cargo bench -p fvi-benches --bench channels` prints a table for book/src/use/large.md. The answers are
//! compared first. Times are minima over rounds of two chunks, in which the memories take turns, so that what
//! else the machine does meets all of them.
//!
//! A second table is about dampings of different orders on the same coordinates: a memory each, against one
//! whose exponentials they share. A third one is about threads: one and two take turns, some chunks at a
//! time, as a run has its memory to itself for as long, and what they take is compared round by round.
//! Beside it stand the bytes that a step reads and writes, by count, and what that makes in a second; a
//! fourth table divides both among the steps that end a chunk, end eight places of it, or do neither. The
//! last two lines say how fast one and two threads copy memory here.

use fvi_core::{BdfOrder, ExponentialTable, Memory};
use fvi_fft::Aligned;
use fvi_fft::exponentials::exponential_table::{ExponentialKernel, SMALLEST_TOLERANCE};
use fvi_fft::sums::max_or_nan;
use fvi_fft::{ChunkedExponentialSum, Scalar, WideExponentialSum};
use std::time::Instant;

/// Steps of a round: whole chunks of all memories.
const ROUND: usize = 64;

/// Memories that take turns.
struct Contender {
    name: String,
    /// One for all kernels, or one for each.
    memories: Vec<Box<dyn Memory<f64>>>,
    /// Against the first contender, relative to the largest term.
    allowed: f64,
    best: f64,
    /// Of all kernels, one behind the other.
    terms: Vec<f64>,
}

impl Contender {
    fn new(
        name: impl Into<String>,
        memories: impl IntoIterator<Item = Box<dyn Memory<f64>>>,
        allowed: f64,
    ) -> Self {
        let memories: Vec<_> = memories.into_iter().collect();
        let count = memories.iter().map(|memory| memory.kernels() * memory.channels()).sum();
        Self { name: name.into(), memories, allowed, best: f64::INFINITY, terms: vec![0.0; count] }
    }

    fn step(&mut self, sample: &[f64]) {
        let mut rest = &mut self.terms[..];
        for memory in &mut self.memories {
            let (terms, others) = rest.split_at_mut(memory.kernels() * sample.len());
            memory.next_term(terms).expect("room");
            rest = others;
        }
        self.memories.iter_mut().for_each(|memory| memory.push(sample).expect("room"));
    }

    fn bytes(&self) -> usize {
        self.memories.iter().map(|memory| memory.bytes()).sum()
    }
}

type Table = ExponentialTable<Aligned<f64>>;

/// Tables of kernels that share their exponentials; of one, its own.
fn tables(exponents: &[f64], tolerance: f64) -> Vec<Table> {
    let order = BdfOrder::new(2).expect("an order");
    let kernels = ExponentialKernel::sharing_rates(order, exponents, true, 1.0, 1 << 20, tolerance);
    kernels.expect("tables").iter().map(ExponentialKernel::table).collect()
}

fn wide<P: Scalar>(tables: &[Table], channels: usize, threads: usize) -> Box<dyn Memory<f64>> {
    let tables: Vec<_> = tables.iter().map(ExponentialTable::borrow).collect();
    Box::new(WideExponentialSum::<f64, P>::of_kernels(&tables, channels).expect("tables").on_threads(threads))
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

/// Kinds of steps within a chunk: those that end it, those that end eight places of it, and the rest.
const KINDS: [&str; 3] = ["between", "ends of eight places", "ends of chunks"];

/// The kind of the step at a place.
fn kind(place: usize, chunk: usize) -> usize {
    if place + 1 == chunk { 2 } else { usize::from((place + 1).is_multiple_of(8)) }
}

/// Bytes that a memory of one kernel reads and writes for each channel in the steps of each kind, together,
/// of a chunk. Every step reads a sample and writes it, reads what is known of the term and the newest
/// samples, and writes the term; ends of eight places read the samples of the chunk and add to eight terms;
/// its end reads and writes the whole state.
fn traffic(chunk: usize, state: usize, number: usize) -> [f64; 3] {
    let mut bytes = [0; 3];
    for place in 0..chunk {
        let (kind, newest) = (kind(place, chunk), place % 8);
        bytes[kind] += 16 + (2 + newest) * number;
        bytes[kind] += [0, (place + 17) * number, 2 * state][kind];
    }
    bytes.map(|bytes| bytes as f64)
}

/// The smallest, the middle and the largest of some numbers.
fn spread(mut numbers: Vec<f64>) -> [f64; 3] {
    numbers.sort_by(f64::total_cmp);
    [0, numbers.len() / 2, numbers.len() - 1].map(|index| numbers[index])
}

/// Steps of a round with one thread, and then with two: some chunks.
const THREAD_ROUND: usize = 128;

/// Lets one and two threads take turns, compares their bits and prints what it took, and how it is divided
/// among steps of each kind.
fn compare_threads<P: Scalar>(name: &str, table: &[Table], channels: usize, rounds: usize) -> Vec<String> {
    let mut memories = [1, 2].map(|threads| wide::<P>(table, channels, threads));
    let chunk = WideExponentialSum::<f64, P>::chunk(&table[0].borrow());
    assert!(THREAD_ROUND.is_multiple_of(chunk));
    let mut terms = [vec![0.0; channels], vec![0.0; channels]];
    let mut sample = vec![0.0; channels];
    let (mut ratios, mut best) = (Vec::new(), [f64::INFINITY; 2]);
    // For each kind and number of threads, seconds of each round.
    let mut of_kinds = [const { [const { Vec::new() }; 2] }; 3];
    // The first round fetches pages.
    for round in 0..=rounds {
        let mut spent = [0.0; 2];
        for turn in 0..2 {
            let which = (turn + round) % 2;
            let mut of_round = [0.0; 3];
            for step in 0..THREAD_ROUND {
                for (channel, number) in sample.iter_mut().enumerate() {
                    *number = (((round * THREAD_ROUND + step) * 7 + channel) % 101) as f64 - 50.0;
                }
                let begin = Instant::now();
                memories[which].next_term(&mut terms[which]).expect("room");
                memories[which].push(&sample).expect("room");
                of_round[kind(step % chunk, chunk)] += begin.elapsed().as_secs_f64();
            }
            spent[which] = of_round.iter().sum();
            if round > 0 {
                of_kinds.iter_mut().zip(of_round).for_each(|(kind, seconds)| kind[which].push(seconds));
            }
        }
        // The last terms hold all samples.
        assert!(terms[0] == terms[1], "{name}: bits differ");
        if round > 0 {
            ratios.push(spent[0] / spent[1]);
            best.iter_mut().zip(spent).for_each(|(best, spent)| *best = best.min(spent));
        }
    }
    let [low, middle, high] = spread(ratios);
    let per_step = |seconds: f64| 1e9 * seconds / (THREAD_ROUND * channels) as f64;
    let [one, two] = best.map(per_step);
    let bytes = traffic(chunk, memories[0].bytes() / channels, size_of::<P>()).map(|sum| sum / chunk as f64);
    let all: f64 = bytes.iter().sum();
    println!(
        "| {channels} | {name} | {one:.2} | {two:.2} | {middle:.2} ({low:.2}–{high:.2}) | {all:.0} | {:.0} | \
         {:.0} |",
        all / one,
        all / two
    );
    let row = |((kind, bytes), seconds): ((&str, f64), [Vec<f64>; 2])| {
        let [one, two] = seconds.map(|seconds| per_step(spread(seconds)[1]));
        format!("| {channels} | {name} | {kind} | {bytes:.0} | {one:.2} | {two:.2} | {:.2} |", one / two)
    };
    KINDS.into_iter().zip(bytes).zip(of_kinds).map(row).collect()
}

/// Lets the contenders take turns on so many channels, compares what they say and prints what it took.
fn compare(channels: usize, rounds: usize, mut contenders: Vec<Contender>) {
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
                contender.step(&sample);
                spent += begin.elapsed().as_secs_f64();
                k += 1;
            }
            contender.best = contender.best.min(spent / (ROUND * channels) as f64);
        }
        let (first, others) = contenders.split_first().expect("several");
        for other in others {
            for (first, other_terms) in first.terms.chunks(channels).zip(other.terms.chunks(channels)) {
                let largest = first.iter().fold(0.0, |largest: f64, term| max_or_nan(largest, term.abs()));
                let apart = first.iter().zip(other_terms).map(|(a, b)| (a - b).abs());
                let apart = apart.fold(0.0, max_or_nan);
                assert!(apart <= other.allowed * largest, "{}: {apart:e} of {largest:e}", other.name);
            }
        }
    }
    let slowest = contenders.first().map_or(1.0, |contender| contender.best);
    for contender in &contenders {
        let (bytes, time) = (contender.bytes() / channels, 1e9 * contender.best);
        let Contender { name, best, .. } = contender;
        println!("| {channels} | {name} | {bytes} | {time:.2} | {:.2} |", best / slowest);
    }
}

fn main() {
    let measured = std::env::args().any(|argument| argument == "--bench");
    let rounds = if measured { 12 } else { 1 };
    let counts: &[usize] = if measured { &[64, 128, 1_000, 10_000, 100_000] } else { &[1_000] };
    let head = || {
        println!("| channels | memory | bytes a channel | ns a channel and step | of the first |");
        println!("|---|---|---|---|---|");
    };
    println!("BDF 2, D^0.6 on increments, horizon 2^20\n");
    head();
    let (exact, loose) = (tables(&[0.6], SMALLEST_TOLERANCE), tables(&[0.6], 2.5e-7));
    for &channels in counts {
        let chunked = ChunkedExponentialSum::<f64, 1>::new(&exact[0].borrow(), channels).expect("a table");
        let one = |memory: Box<dyn Memory<f64>>| [memory];
        let contenders = vec![
            Contender::new("chunked", one(Box::new(chunked)), 0.0),
            Contender::new("wide", one(wide::<f64>(&exact, channels, 1)), 1e-13),
            Contender::new("wide, two threads", one(wide::<f64>(&exact, channels, 2)), 1e-13),
            Contender::new("wide, f32 states, 5e-7", one(wide::<f32>(&loose, channels, 1)), 1e-6),
        ];
        compare(channels, rounds, contenders);
    }
    println!("\nSeveral terms on the same coordinates\n");
    head();
    for exponents in [&[0.3, 0.6][..], &[0.3, 0.6, 1.4]] {
        let count = exponents.len();
        let own = |tolerance| -> Vec<_> {
            exponents.iter().map(|&exponent| tables(&[exponent], tolerance)).collect()
        };
        let (own_exact, own_loose) = (own(SMALLEST_TOLERANCE), own(2.5e-7));
        let (exact, loose) = (tables(exponents, SMALLEST_TOLERANCE), tables(exponents, 2.5e-7));
        for &channels in counts.iter().filter(|&&channels| channels >= 1_000) {
            let each = own_exact.iter().map(|tables| wide::<f64>(tables, channels, 1));
            let each_single = own_loose.iter().map(|tables| wide::<f32>(tables, channels, 1));
            let contenders = vec![
                Contender::new(format!("{count} terms, a memory each"), each, 0.0),
                Contender::new(
                    format!("{count} terms, one memory"),
                    [wide::<f64>(&exact, channels, 1)],
                    1e-13,
                ),
                Contender::new(
                    format!("{count} terms, one memory, two threads"),
                    [wide::<f64>(&exact, channels, 2)],
                    1e-13,
                ),
                Contender::new(format!("{count} terms, a memory each, f32 states, 5e-7"), each_single, 1e-6),
                Contender::new(
                    format!("{count} terms, one memory, f32 states, 5e-7"),
                    [wide::<f32>(&loose, channels, 1)],
                    1e-6,
                ),
            ];
            compare(channels, rounds, contenders);
        }
    }
    println!("\nOne and two threads, ns a channel and step\n");
    println!("| channels | states | one | two | times as fast (of all rounds) | bytes | GB/s | GB/s, two |");
    println!("|---|---|---|---|---|---|---|---|");
    let counts: &[usize] = if measured { &[1_000, 2_500, 10_000, 100_000, 1_000_000] } else { &[1_000] };
    let mut by_kind = Vec::new();
    for &channels in counts {
        let rounds = if measured { (1_000_000 / channels).clamp(3, 200) } else { 1 };
        by_kind.extend(compare_threads::<f64>("f64", &exact, channels, rounds));
        by_kind.extend(compare_threads::<f32>("f32, 5e-7", &loose, channels, rounds));
    }
    println!("\nTheir parts, for each channel and divided by all steps\n");
    println!("| channels | states | steps | bytes | one, ns | two, ns | times as fast |");
    println!("|---|---|---|---|---|---|---|");
    by_kind.iter().for_each(|row| println!("{row}"));
    let [one, two] = [1, 2].map(|threads| copies(threads, rounds));
    println!("\ncopies on one thread: {one:.1} GB/s");
    println!("copies on two threads: {two:.1} GB/s, {:.2} times as fast", two / one);
}
