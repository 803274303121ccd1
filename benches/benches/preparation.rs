//! What surrounds the steps of a run: tables of exponentials and rates, rows, adaptive runs, sweeps, chains.
//!
//! `cargo bench -p fvi-benches --bench preparation` prints a table in Markdown; words behind `--` choose the
//! rows that contain one of them. Everything is measured in a few turns, of which the fastest counts.

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use fvi_core::{BdfOrder, Memory, RungeKutta};
use fvi_fft::exponentials::exponential_table::{ExponentialKernel, SMALLEST_TOLERANCE};
use fvi_fft::exponentials::rate_table::rate_table;
use fvi_fft::memory::{Engine, History, MemoryRequest, RATE_TOLERANCE};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::transfer::TransferFunction;
use fvi_host::run::{RunOptions, RunSummary, run};
use fvi_host::sweep::{Sweep, SweepOptions, sweep};
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;

/// Turns of each measurement.
const TURNS: usize = 5;

/// Order of the damping.
const ORDER: f64 = 0.5;

/// Steps of the longest tables.
const LONG: usize = 1 << 20;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let place = std::env::temp_dir().join(format!("fvi-bench-preparation-{}", std::process::id()));
    std::fs::create_dir_all(&place).expect("room for temporary files");
    println!("| what | fastest | unit |\n|---|---:|---|");
    type Row<'a> = (&'a str, &'a str, Box<dyn Fn() -> f64 + 'a>);
    let rows: Vec<Row<'_>> = vec![
        ("table of exponentials for 10⁶ steps, 10⁻⁷", "ms", Box::new(|| 1e3 * exponentials(1_000_000, 1e-7))),
        (
            "table of exponentials for 2²⁰ steps, to rounding",
            "ms",
            Box::new(|| 1e3 * exponentials(LONG, SMALLEST_TOLERANCE)),
        ),
        (
            "rates for adaptive steps, 3 stages, steps down to 10⁻¹² of the end",
            "ms",
            Box::new(|| 1e3 * rates()),
        ),
        ("an adaptive run at 10⁻⁶: preparation", "ms", Box::new(|| 1e3 * adaptive(&place, true))),
        ("an adaptive run at 10⁻⁶: its steps", "ms", Box::new(|| 1e3 * adaptive(&place, false))),
        ("exponential sum over 2²⁰ steps, to rounding", "ns a step", Box::new(|| 1e9 * engine(None))),
        ("exponential sum over 2²⁰ steps, 10⁻⁷", "ns a step", Box::new(|| 1e9 * engine(Some(1e-7)))),
        ("rows of an oscillator in CSV", "ns a number", Box::new(|| 1e9 * csv(&place))),
        ("steps of the same", "ns a step", Box::new(|| 1e9 * oscillator(&place, OSCILLATOR_STEPS))),
        ("sweep of 400 runs with two kernels", "ms a run", Box::new(|| 1e3 * swept(&place, ""))),
        (
            "the same, with the exponential sum",
            "ms a run",
            Box::new(|| 1e3 * swept(&place, "[history]\nengine = \"exponential-sum\"\n")),
        ),
        ("sparse chain of 10⁴", "ns a coordinate and step", Box::new(|| 1e9 * chain(&place, 10_000))),
        ("sparse chain of 10⁵", "ns a coordinate and step", Box::new(|| 1e9 * chain(&place, 100_000))),
    ];
    for (name, unit, measure) in rows {
        if words.is_empty() || words.iter().any(|word| name.contains(word)) {
            println!("| {name} | {:.2} | {unit} |", measure());
        }
    }
    // What is left there is of no use to anyone.
    let _ = std::fs::remove_dir_all(place);
}

/// Seconds of the fastest of a few calls.
fn fastest<R>(mut call: impl FnMut() -> R) -> f64 {
    let mut fastest = f64::INFINITY;
    for _ in 0..TURNS {
        let begin = Instant::now();
        black_box(call());
        fastest = fastest.min(begin.elapsed().as_secs_f64());
    }
    fastest
}

fn exponentials(steps: usize, tolerance: f64) -> f64 {
    let order = BdfOrder::GRUNWALD_LETNIKOV;
    fastest(|| ExponentialKernel::bdf_on_increments(order, ORDER, 0.01, steps, tolerance).expect("a table"))
}

fn rates() -> f64 {
    let method = RungeKutta::<3>::radau_iia().expect("a method");
    fastest(|| rate_table::<f64, 3>(&method, ORDER, 1e-12, 1.0, RATE_TOLERANCE).expect("a table"))
}

/// Seconds for a sample of an exponential sum over 2²⁰ of them.
fn engine(tolerance: Option<f64>) -> f64 {
    let history = History { engine: Some(Engine::ExponentialSum), tolerance, ..History::default() };
    let request = MemoryRequest {
        end: None,
        family: ConvolutionFamily::Bdf { order: 1 },
        starting: &[],
        transfer: &TransferFunction::power(ORDER).expect("an exponent"),
        step_size: 0.01,
        coordinates: 1,
        motions: 1,
        samples: LONG,
        given: false,
        history: &history,
    };
    let mut memory = request.build::<f64>().expect("a memory");
    let signal = fvi_benches::noise(LONG);
    let mut term = [0.0];
    let all = fastest(|| {
        memory.clear();
        for sample in &signal {
            memory.next_term(&mut term).expect("room");
            memory.push(std::slice::from_ref(sample)).expect("room");
        }
        term[0]
    });
    all / LONG as f64
}

/// The summary of a run whose files go to `place`.
fn summary(place: &Path, text: &str) -> RunSummary {
    let scenario =
        Scenario::from_document(Document::new("bench.toml", place, text)).expect("a good scenario");
    let options = RunOptions::new(place.join("run"));
    run(&scenario, &options, &AtomicBool::new(false), &mut |_| ()).expect("a run")
}

fn adaptive(place: &Path, preparation: bool) -> f64 {
    let text = "[system]\nmass = [1.0]\npotential = '0.5*q0^2'\nforce = ['cos(3*t)']\n\
                damping = [{ order = 0.5, coefficient = [0.3] }]\n[initial]\nposition = [1.0]\n\
                [scheme]\nkind = 'collocation'\n[time]\ngrid = 'adaptive'\nend = 20.0\ntolerance = 1e-6\n";
    let mut fastest = f64::INFINITY;
    for _ in 0..TURNS {
        let summary = summary(place, text);
        fastest = fastest.min(if preparation { summary.preparation_seconds } else { summary.seconds });
    }
    fastest
}

const OSCILLATOR_STEPS: usize = 200_000;

/// Seconds for a step of an oscillator of which every so manieth row is written.
fn oscillator(place: &Path, every: usize) -> f64 {
    let text = format!(
        "[system]\nmass = [1.0]\npotential = '0.5*q0^2'\ndamping = [{{ order = {ORDER}, coefficient = [0.1] }}]\n\
         [initial]\nposition = [1.0]\n[time]\nstep = 0.01\nsteps = {OSCILLATOR_STEPS}\n[output]\nevery = {every}\n"
    );
    let mut fastest = f64::INFINITY;
    for _ in 0..TURNS {
        fastest = fastest.min(summary(place, &text).seconds);
    }
    fastest / OSCILLATOR_STEPS as f64
}

/// Seconds for a number of a row: t, q, p and the energy.
fn csv(place: &Path) -> f64 {
    (oscillator(place, 1) - oscillator(place, OSCILLATOR_STEPS)) / 4.0
}

/// Seconds for a run of 1000 steps in a sweep over an order and a coefficient, in one thread.
fn swept(place: &Path, history: &str) -> f64 {
    let file = |name: &str, text: &str| -> PathBuf {
        let path = place.join(name);
        std::fs::write(&path, text).expect("room for temporary files");
        path
    };
    file(
        "swept.toml",
        &format!(
            "[system]\nmass = [1.0]\npotential = '0.5*q0^2'\ndamping = [{{ order = 0.5, coefficient = [0.1] }}, \
             {{ order = 0.8, coefficient = [0.05] }}]\n[initial]\nposition = [1.0]\n[time]\nstep = 0.01\nsteps = 1000\n{history}"
        ),
    );
    let path = file(
        "sweep.toml",
        "scenario = 'swept.toml'\n[axes]\n'system.damping[0].order' = { from = 0.3, to = 0.7, count = 20 }\n\
         'system.damping[1].coefficient[0]' = { from = 0.01, to = 0.1, count = 20 }\n",
    );
    let read = Sweep::read(&path).expect("a good sweep");
    let mut options = SweepOptions::new(place.join("sweep"));
    options.jobs = std::num::NonZero::new(1);
    let all = fastest(|| {
        // Otherwise there is nothing left to do.
        let _ = std::fs::remove_dir_all(&options.directory);
        sweep(&read, &options, &AtomicBool::new(false), &mut |_| ()).expect("a sweep")
    });
    all / read.runs() as f64
}

/// Seconds for a coordinate and step of a chain whose stiffness comes from a file.
fn chain(place: &Path, coordinates: usize) -> f64 {
    const STEPS: usize = 100;
    let entries = 2 * coordinates - 1;
    let mut matrix =
        format!("%%MatrixMarket matrix coordinate real symmetric\n{coordinates} {coordinates} {entries}\n");
    for row in 1..=coordinates {
        matrix += &format!("{row} {row} 2.0\n");
        if row < coordinates {
            matrix += &format!("{} {row} -1.0\n", row + 1);
        }
    }
    std::fs::write(place.join("chain.mtx"), matrix).expect("room for temporary files");
    let ones = format!("[{}]", vec!["1.0"; coordinates].join(", "));
    let text = format!(
        "[system]\nmass = {ones}\nstiffness = 'chain.mtx'\ndamping = [{{ order = {ORDER}, coefficient = {ones} }}]\n\
         [initial]\nposition = {ones}\n[time]\nstep = 0.01\nsteps = {STEPS}\n\
         [output]\nevery = {STEPS}\ncoordinates = [0]\n"
    );
    let mut fastest = f64::INFINITY;
    for _ in 0..TURNS {
        fastest = fastest.min(summary(place, &text).seconds);
    }
    fastest / (STEPS * coordinates) as f64
}
