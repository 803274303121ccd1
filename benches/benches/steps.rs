//! Time of a step as `fvi run` makes it, against the same scheme written by hand for one system: closed-form
//! gradient and Hessian, plain arrays, the same memory.
//!
//! Both start from the same state; what they end at is compared before anything is timed. They are timed in
//! turn, so that both meet the same moods of the machine, and the fastest turn of each counts.
//! `cargo bench -p fvi-benches --bench steps`, with a name behind `--` for the systems that contain it.
//!
//! `-- --only run|nodes|hand SYSTEM STEPS` makes that many steps of one of them and nothing else, for tools
//! that count instructions: `.ci/steps` writes `docs/steps.md` with it. Systems are `pendulum`, `linear-N`
//! and `nonlinear-N`.

use std::hint::black_box;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use fvi_core::Memory;
use fvi_host::lab::run::{RunOptions, run};
use fvi_host::language::Document;
use fvi_host::memory::{HostMemory, MemoryRequest};
use fvi_host::scenario::{DampedAt, Scenario};
use fvi_host::simulation::{GridState, Precision, Simulation};
use nalgebra::DMatrix;

const STEP: f64 = 0.01;
const ORDER: f64 = 0.5;
const DAMPING: f64 = 0.1;
const GRAVITY: f64 = 9.81;
const STIFFNESS: f64 = 4.0;
const CUBIC: f64 = 0.7;

/// Turns of each path.
const TURNS: usize = 5;

/// Coordinates up to which all are written and drawn.
const MOST_DRAWN: usize = 128;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    if let Some(place) = words.iter().position(|word| word == "--only") {
        let [path, system, steps] = &words[place + 1..place + 4] else {
            panic!("--only run|nodes|hand SYSTEM STEPS")
        };
        return only(path, system, steps.parse().expect("a number of steps"));
    }
    let wanted: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let chosen = |name: &str| wanted.is_empty() || wanted.iter().any(|word| name.contains(word));
    println!("ns for a step                 fvi run  in the loop  by hand  ratio  (allowed)");
    let mut linear = Vec::new();
    let oscillator = |n: usize| (LinearChain::new(n), linear_chain(n));
    let cases = [(1, 1_000_000, 1.5), (8, 200_000, 1.5), (64, 20_000, 2.0)];
    for (coordinates, steps, allowed) in cases {
        let name = match coordinates {
            1 => String::from("linear oscillator"),
            _ => format!("linear chain of {coordinates}"),
        };
        if chosen(&name) {
            let (system, potential) = oscillator(coordinates);
            linear.push(compare(&name, coordinates, steps, &potential, system, allowed));
        }
    }
    if chosen("pendulum") {
        compare("pendulum", 1, 1_000_000, "9.81*(1 - cos(q0))", Pendulum, 1.5);
    }
    if chosen("nonlinear chain of 8") {
        compare("nonlinear chain of 8", 8, 200_000, &nonlinear_chain(8), NonlinearChain::new(8), 1.5);
    }
    if let [_, eight, chain] = linear[..] {
        println!("linear chain of 64 against 8: {:.1} times (30 allowed)", chain / eight);
    }
    if chosen("growing") {
        let sizes = [64, 128, 256, 500, 1000, 2000];
        let times = sizes.map(|n| (n, in_the_loop(&scenario(n, 40, &nonlinear_chain(n)))));
        for pair in times.windows(2) {
            let [(few, short), (many, long)] = pair else { continue };
            let growth = (long / short).ln() / (*many as f64 / *few as f64).ln();
            println!(
                "nonlinear chain growing from {few} to {many}: {short:.0} to {long:.0} ns, N^{growth:.2}"
            );
        }
    }
}

/// Makes the steps of one system by one path: by `run`, by `hand`, or by `nodes`, a run damped at the
/// quadrature node.
fn only(path: &str, system: &str, steps: usize) {
    let size = |kind: &str| system.strip_prefix(kind).map(|n| n.parse::<usize>().expect("a number"));
    if let Some(n) = size("linear-") {
        steps_of(path, &scenario(n, steps, &linear_chain(n)), LinearChain::new(n));
    } else if let Some(n) = size("nonlinear-") {
        steps_of(path, &scenario(n, steps, &nonlinear_chain(n)), NonlinearChain::new(n));
    } else {
        steps_of(path, &scenario(1, steps, "9.81*(1 - cos(q0))"), Pendulum);
    }
}

fn steps_of<S: ByHand>(path: &str, scenario: &Scenario, system: S) {
    if path == "hand" {
        let mut motion = Motion::new(scenario, system);
        for _ in 0..scenario.time.steps {
            motion.step();
            black_box(motion.energy());
        }
        return;
    }
    let mut scenario = scenario.clone();
    if path == "nodes" {
        scenario.convolution.at = DampedAt::Nodes;
    }
    let directory = std::env::temp_dir().join(format!("fvi-bench-steps-{}", std::process::id()));
    run(&scenario, &RunOptions::new(&directory), &AtomicBool::new(false), |_| ()).expect("a run");
    // What is left there is of no use to anyone.
    let _ = std::fs::remove_dir_all(directory);
}

/// A chain between two walls, each spring linear.
fn linear_chain(coordinates: usize) -> String {
    let springs = (1..coordinates).map(|i| format!(" + 2*(q{i} - q{})^2", i - 1));
    format!("2*q0^2{} + 2*q{}^2", springs.collect::<String>(), coordinates - 1)
}

/// A chain of springs that stiffen, its first mass held by a linear one.
fn nonlinear_chain(coordinates: usize) -> String {
    let spring = |i: usize| format!(" + 0.5*(q{i} - q{})^2 + 0.25*0.7*(q{i} - q{})^4", i - 1, i - 1);
    format!("2*q0^2{}", (1..coordinates).map(spring).collect::<String>())
}

fn start(index: usize) -> f64 {
    (0.7 * index as f64).sin() + 0.3
}

fn scenario(coordinates: usize, steps: usize, potential: &str) -> Scenario {
    let list = |of: &dyn Fn(usize) -> f64| -> String {
        (0..coordinates).map(|i| format!("{:?}, ", of(i))).collect()
    };
    let text = format!(
        r#"
        [system]
        mass = [{mass}]
        potential = "{potential}"
        [[system.damping]]
        order = {ORDER:?}
        coefficient = [{damping}]
        derivative = "caputo"
        [initial]
        position = [{position}]
        momentum = [{momentum}]
        [scheme]
        kind = "low-order"
        kappa = 0.5
        [convolution]
        order = 1
        at = "main-nodes"
        [time]
        step = {STEP:?}
        steps = {steps}
        [history]
        engine = "exponential-sum"
        horizon = 1000001
        [output]
        every = 1000
        momentum = "one-sided"
        {drawn}
        "#,
        // Of large systems one curve is drawn.
        drawn = if coordinates > MOST_DRAWN { "coordinates = [0]" } else { "" },
        mass = list(&|_| 1.0),
        damping = list(&|_| DAMPING),
        position = list(&start),
        momentum = list(&|_| 0.0),
    );
    Scenario::from_document(Document::new("steps", Path::new(""), &text)).expect("a good scenario")
}

/// A system whose formulas are known: unit masses, a potential with a tridiagonal Hessian.
trait ByHand: Clone {
    /// U(q).
    fn energy(&self, q: &[f64]) -> f64;
    /// ∇U(q).
    fn gradient(&self, q: &[f64], gradient: &mut [f64]);
    /// Solves the equations of the midpoint rule for the increment, from the guess in it; leaves ∇U at the
    /// midpoint in the room.
    fn solve(&mut self, q: &[f64], p: &[f64], increment: &mut [f64], room: &mut Room);
}

/// Room for the vectors of a step.
#[derive(Clone)]
struct Room {
    middle: Vec<f64>,
    gradient: Vec<f64>,
    residual: Vec<f64>,
}

/// (largest correction, bound of rounding) as the library's Newton iteration takes them.
fn at_rest(correction: &[f64], increment: &[f64], q: &[f64]) -> bool {
    let size = |numbers: &[f64]| numbers.iter().fold(0.0_f64, |largest, x| largest.max(x.abs()));
    size(correction) <= 2.0 * f64::EPSILON * (size(q) + size(increment))
}

#[derive(Clone)]
struct Pendulum;

impl ByHand for Pendulum {
    fn energy(&self, q: &[f64]) -> f64 {
        GRAVITY * (1.0 - libm::cos(q[0]))
    }

    fn gradient(&self, q: &[f64], gradient: &mut [f64]) {
        gradient[0] = GRAVITY * libm::sin(q[0]);
    }

    fn solve(&mut self, q: &[f64], p: &[f64], increment: &mut [f64], room: &mut Room) {
        loop {
            let (sine, cosine) = libm::sincos(q[0] + 0.5 * increment[0]);
            let residual = p[0] - increment[0] / STEP - 0.5 * STEP * GRAVITY * sine;
            let slope = -1.0 / STEP - 0.25 * STEP * GRAVITY * cosine;
            room.residual[0] = residual / slope;
            increment[0] -= room.residual[0];
            if at_rest(&room.residual, increment, q) {
                break;
            }
        }
        room.gradient[0] = GRAVITY * libm::sin(q[0] + 0.5 * increment[0]);
    }
}

#[derive(Clone)]
struct LinearChain {
    /// (1 + h²K/4)⁻¹, which is symmetric.
    inverse: Vec<f64>,
}

impl LinearChain {
    fn new(coordinates: usize) -> Self {
        let matrix = DMatrix::from_fn(coordinates, coordinates, |row, column| match row.abs_diff(column) {
            0 => 1.0 + 0.25 * STEP * STEP * 2.0 * STIFFNESS,
            1 => -0.25 * STEP * STEP * STIFFNESS,
            _ => 0.0,
        });
        Self { inverse: matrix.try_inverse().expect("definite").as_slice().to_vec() }
    }
}

impl ByHand for LinearChain {
    fn energy(&self, q: &[f64]) -> f64 {
        let ends = q[0] * q[0] + q[q.len() - 1] * q[q.len() - 1];
        0.5 * STIFFNESS * q.windows(2).fold(ends, |sum, q| sum + (q[1] - q[0]) * (q[1] - q[0]))
    }

    #[inline]
    fn gradient(&self, q: &[f64], gradient: &mut [f64]) {
        for (i, place) in gradient.iter_mut().enumerate() {
            let left = if i > 0 { q[i - 1] } else { 0.0 };
            let right = if i + 1 < q.len() { q[i + 1] } else { 0.0 };
            *place = STIFFNESS * (2.0 * q[i] - left - right);
        }
    }

    fn solve(&mut self, q: &[f64], p: &[f64], increment: &mut [f64], room: &mut Room) {
        // (1 + h²K/4) e = h p − h²K q/2.
        self.gradient(q, &mut room.gradient);
        for ((place, &p), &pull) in room.residual.iter_mut().zip(p).zip(&room.gradient) {
            *place = STEP * p - 0.5 * STEP * STEP * pull;
        }
        increment.fill(0.0);
        for (column, &x) in self.inverse.chunks_exact(q.len()).zip(&room.residual) {
            for (place, &entry) in increment.iter_mut().zip(column) {
                *place += entry * x;
            }
        }
        for ((place, &q), &e) in room.middle.iter_mut().zip(q).zip(&*increment) {
            *place = q + 0.5 * e;
        }
        self.gradient(&room.middle, &mut room.gradient);
    }
}

#[derive(Clone)]
struct NonlinearChain {
    diagonal: Vec<f64>,
    beside: Vec<f64>,
}

impl NonlinearChain {
    fn new(coordinates: usize) -> Self {
        Self { diagonal: vec![0.0; coordinates], beside: vec![0.0; coordinates] }
    }
}

impl ByHand for NonlinearChain {
    fn energy(&self, q: &[f64]) -> f64 {
        let spring = |stretch: f64| {
            let square = stretch * stretch;
            0.5 * square + 0.25 * CUBIC * square * square
        };
        q.windows(2).fold(2.0 * q[0] * q[0], |sum, q| sum + spring(q[1] - q[0]))
    }

    fn gradient(&self, q: &[f64], gradient: &mut [f64]) {
        gradient.fill(0.0);
        gradient[0] = 4.0 * q[0];
        for i in 1..q.len() {
            let stretch = q[i] - q[i - 1];
            let tension = stretch + CUBIC * stretch * stretch * stretch;
            gradient[i] += tension;
            gradient[i - 1] -= tension;
        }
    }

    fn solve(&mut self, q: &[f64], p: &[f64], increment: &mut [f64], room: &mut Room) {
        let n = q.len();
        loop {
            for i in 0..n {
                room.middle[i] = q[i] + 0.5 * increment[i];
            }
            room.gradient.fill(0.0);
            room.gradient[0] = 4.0 * room.middle[0];
            let quarter = 0.25 * STEP * STEP;
            self.diagonal.fill(1.0);
            self.diagonal[0] += quarter * 4.0;
            for i in 1..n {
                let stretch = room.middle[i] - room.middle[i - 1];
                let square = stretch * stretch;
                let tension = stretch + CUBIC * stretch * square;
                let stiffness = quarter * (1.0 + 3.0 * CUBIC * square);
                room.gradient[i] += tension;
                room.gradient[i - 1] -= tension;
                self.diagonal[i] += stiffness;
                self.diagonal[i - 1] += stiffness;
                self.beside[i] = -stiffness;
            }
            for i in 0..n {
                room.residual[i] = increment[i] - STEP * p[i] + 0.5 * STEP * STEP * room.gradient[i];
            }
            for i in 1..n {
                let factor = self.beside[i] / self.diagonal[i - 1];
                self.diagonal[i] -= factor * self.beside[i];
                room.residual[i] -= factor * room.residual[i - 1];
            }
            room.residual[n - 1] /= self.diagonal[n - 1];
            for i in (0..n - 1).rev() {
                room.residual[i] =
                    (room.residual[i] - self.beside[i + 1] * room.residual[i + 1]) / self.diagonal[i];
            }
            for (e, correction) in increment.iter_mut().zip(&room.residual) {
                *e -= correction;
            }
            if at_rest(&room.residual, increment, q) {
                break;
            }
        }
        for i in 0..n {
            room.middle[i] = q[i] + 0.5 * increment[i];
        }
        self.gradient(&room.middle, &mut room.gradient);
    }
}

/// The midpoint rule with its fractional force at the end of the step, \[JO\] eq. 63–66, for one system.
struct Motion<S> {
    system: S,
    memory: HostMemory<f64>,
    position: Vec<f64>,
    momentum: Vec<f64>,
    increment: Vec<f64>,
    term: Vec<f64>,
    room: Room,
}

impl<S: ByHand> Motion<S> {
    fn new(scenario: &Scenario, system: S) -> Self {
        let coordinates = scenario.coordinates();
        let memory = MemoryRequest {
            end: None,
            convolution: &scenario.convolution,
            exponent: ORDER,
            step_size: STEP,
            coordinates,
            motions: 1,
            samples: scenario.time.steps + 1,
            given: false,
            history: &scenario.history,
        };
        let zeros = || vec![0.0; coordinates];
        let mut memory = memory.build().expect("a memory");
        memory.push(&zeros()).expect("room");
        let (position, momentum) = (scenario.initial.position.clone(), zeros());
        let room = Room { middle: zeros(), gradient: zeros(), residual: zeros() };
        let (increment, term) = (zeros(), zeros());
        Self { system, memory, position, momentum, increment, term, room }
    }

    fn step(&mut self) {
        self.memory.next_term(&mut self.term).expect("room");
        for (e, &p) in self.increment.iter_mut().zip(&self.momentum) {
            *e = STEP * p;
        }
        let Self { system, position, momentum, increment, room, .. } = self;
        system.solve(position, momentum, increment, room);
        // The memory takes the increments of q − q₀.
        let leading = self.memory.leading()[0];
        for i in 0..position.len() {
            position[i] += increment[i];
            let damping = DAMPING * (self.term[i] + leading * increment[i]);
            momentum[i] -= STEP * (room.gradient[i] + damping);
        }
        self.memory.push(&self.increment).expect("room");
    }

    fn energy(&self) -> f64 {
        let kinetic: f64 = self.momentum.iter().map(|p| p * p).sum();
        0.5 * kinetic + self.system.energy(&self.position)
    }
}

fn simulation(scenario: &Scenario) -> (Simulation, GridState) {
    let zeros = vec![0.0; scenario.coordinates()];
    let state = GridState { position: zeros.clone(), momentum: zeros, ..GridState::default() };
    (Simulation::new(scenario, Precision::F64).expect("a good scenario"), state)
}

/// Fastest mean time of a call over a fiftieth of them, in nanoseconds: a stretch in which nothing else had
/// the processor.
fn fastest_stretch(calls: usize, mut call: impl FnMut()) -> f64 {
    let stretch = (calls / 50).max(1);
    let mut fastest = f64::INFINITY;
    for _ in 0..calls / stretch {
        let begin = Instant::now();
        for _ in 0..stretch {
            call();
        }
        fastest = fastest.min(begin.elapsed().as_secs_f64());
    }
    1e9 * fastest / stretch as f64
}

/// Nanoseconds for a step and what a run looks at after each.
fn in_the_loop(scenario: &Scenario) -> f64 {
    let (mut simulation, mut state) = simulation(scenario);
    fastest_stretch(scenario.time.steps, || {
        simulation.step(&[]).expect("a step");
        simulation.read(&mut state);
        black_box(&mut state);
    })
}

fn by_hand<S: ByHand>(scenario: &Scenario, system: S) -> f64 {
    let mut motion = Motion::new(scenario, system);
    fastest_stretch(scenario.time.steps, || {
        motion.step();
        black_box(motion.energy());
    })
}

/// All of the loop of `fvi run`, rows and what is gathered for the record included.
fn in_a_run(scenario: &Scenario, directory: &Path) -> f64 {
    let options = RunOptions::new(directory);
    let stretch = (scenario.time.steps / 50).max(1);
    let (mut fastest, mut begin) = (f64::INFINITY, None::<Instant>);
    let progress = |steps: usize| {
        if steps.is_multiple_of(stretch) {
            let now = Instant::now();
            fastest = begin.map_or(fastest, |begin| fastest.min((now - begin).as_secs_f64()));
            begin = Some(now);
        }
    };
    run(scenario, &options, &AtomicBool::new(false), progress).expect("a run");
    1e9 * fastest / stretch as f64
}

/// Prints the times of a step; returns that of `fvi run`.
fn compare<S: ByHand>(
    name: &str,
    coordinates: usize,
    steps: usize,
    potential: &str,
    system: S,
    allowed: f64,
) -> f64 {
    let scenario = scenario(coordinates, steps, potential);
    check(&scenario, system.clone());
    let directory = std::env::temp_dir().join(format!("fvi-bench-steps-{}", std::process::id()));
    let mut fastest = [f64::INFINITY; 3];
    for _ in 0..TURNS {
        let times =
            [in_a_run(&scenario, &directory), in_the_loop(&scenario), by_hand(&scenario, system.clone())];
        for (fastest, time) in fastest.iter_mut().zip(times) {
            *fastest = fastest.min(time);
        }
    }
    // What is left there is of no use to anyone.
    let _ = std::fs::remove_dir_all(directory);
    let [run, steps, hand] = fastest;
    println!("{name:<28} {run:>8.1} {steps:>12.1} {hand:>8.1} {:>6.2}  ({allowed})", run / hand);
    run
}

/// Both must have made the same motion after a thousand steps, to rounding.
fn check<S: ByHand>(scenario: &Scenario, system: S) {
    let (mut simulation, mut state) = simulation(scenario);
    let mut motion = Motion::new(scenario, system);
    for _ in 0..1000.min(scenario.time.steps) {
        simulation.step(&[]).expect("a step");
        motion.step();
    }
    simulation.read(&mut state);
    for (found, expected) in [(&state.position, &motion.position), (&state.momentum, &motion.momentum)] {
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-10, "{found} by the library, {expected} by hand");
        }
    }
    assert!((state.energy - motion.energy()).abs() < 1e-10 * (1.0 + state.energy.abs()));
}
