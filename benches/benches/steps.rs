//! Time of a step as `fvi run` makes it, against the same scheme written by hand for one system: closed-form
//! gradient and Hessian, plain arrays, the same memory, and the same sums, whose rounding errors are kept. A
//! third one is plain: it updates position and momentum without keeping what rounding takes away. The fourth
//! is `steps.c`, plain too, compiled by `cc -O3 -march=native` for each system and size.
//!
//! All start from the same state; what they end at is compared before anything is timed. They are timed in
//! turn, so that changes of the machine's speed meet all alike, and the fastest turn of each counts.
//! `cargo bench -p fvi-benches --bench steps`, with a name behind `--` for the systems that contain it.
//!
//! `-- --only PATH SYSTEM STEPS` makes that many steps of one of them and nothing else, for tools that count
//! instructions: `.ci/steps` writes `book/src/engines/steps.md` with it. Paths are `run`, `hand` and `plain`,
//! and `nodes` and `hand-nodes`, damped at the quadrature node; systems are `pendulum`, `linear-N` and
//! `nonlinear-N`.

use fvi_fft::sums::max_or_nan;
use std::hint::black_box;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use fvi_core::{BdfOrder, Memory};
use fvi_fft::exponentials::exponential_table::{ExponentialKernel, SMALLEST_TOLERANCE};
use fvi_fft::memory::{HostMemory, MemoryRequest};
use fvi_fft::transfer::TransferFunction;
use fvi_host::run::{RunOptions, run};
use fvi_scenario::language::Document;
use fvi_scenario::scenario::{DampedAt, Scenario};
use fvi_simulation::simulation::{GridState, Precision, Simulation};
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
            panic!("--only run|hand|plain|nodes|hand-nodes SYSTEM STEPS")
        };
        return only(path, system, steps.parse().expect("a number of steps"));
    }
    let wanted: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let chosen = |name: &str| wanted.is_empty() || wanted.iter().any(|word| name.contains(word));
    println!(
        "ns for a step                 fvi run  in the loop  by hand  ratio  (allowed)    plain  ratio     in C  ratio"
    );
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
            let code = if coordinates == 1 { Code::Oscillator } else { Code::LinearChain };
            linear.push(compare(&name, (coordinates, steps), &potential, system, (code, allowed)));
        }
    }
    if chosen("pendulum") {
        let code = (Code::Pendulum, 1.5);
        compare("pendulum", (1, 1_000_000), "9.81*(1 - cos(q0))", Pendulum, code);
    }
    if chosen("nonlinear chain of 8") {
        let (system, code) = (NonlinearChain::new(8), (Code::NonlinearChain, 1.5));
        compare("nonlinear chain of 8", (8, 200_000), &nonlinear_chain(8), system, code);
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

/// Makes the steps of one system by one path.
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
    match path {
        "hand" => return steps_by_hand(Motion::<_, false, true>::new(scenario, system), scenario.time.steps),
        "plain" => {
            return steps_by_hand(Motion::<_, false, false>::new(scenario, system), scenario.time.steps);
        }
        "hand-nodes" => {
            let scenario = damped_at_nodes(scenario);
            return steps_by_hand(Motion::<_, true, true>::new(&scenario, system), scenario.time.steps);
        }
        _ => {}
    }
    let scenario = if path == "nodes" { damped_at_nodes(scenario) } else { scenario.clone() };
    let directory = std::env::temp_dir().join(format!("fvi-bench-steps-{}", std::process::id()));
    run(&scenario, &RunOptions::new(&directory), &AtomicBool::new(false), &mut |_| ()).expect("a run");
    // What is left there is of no use to anyone.
    let _ = std::fs::remove_dir_all(directory);
}

fn steps_by_hand<S: ByHand, const AT_NODES: bool, const COMPENSATED: bool>(
    mut motion: Motion<S, AT_NODES, COMPENSATED>,
    steps: usize,
) {
    for _ in 0..steps {
        motion.step();
        black_box(motion.energy());
    }
}

/// The same with its damping at the quadrature node.
fn damped_at_nodes(scenario: &Scenario) -> Scenario {
    let mut scenario = scenario.clone();
    scenario.convolution.at = DampedAt::Nodes;
    scenario
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
    /// Prepares what is the same in every step, for a force `slope` · e at the node.
    fn prepare(&mut self, _slope: f64) {}
    /// Solves the equations of the midpoint rule for the increment e, from the guess in it; leaves ∇U at the
    /// midpoint in the room. Where damping acts at the node, its force is there: known + slope · e.
    fn solve<const AT_NODES: bool>(
        &mut self,
        q: &[f64],
        p: &[f64],
        increment: &mut [f64],
        room: &mut Buffers,
    );
}

/// Buffers for the vectors of a step.
#[derive(Clone)]
struct Buffers {
    middle: Vec<f64>,
    gradient: Vec<f64>,
    residual: Vec<f64>,
    known: Vec<f64>,
    slope: f64,
}

impl Buffers {
    /// The force of damping at the node.
    #[inline(always)]
    fn damping<const AT_NODES: bool>(&self, i: usize, increment: f64) -> f64 {
        if AT_NODES { self.known[i] + self.slope * increment } else { 0.0 }
    }
}

/// (largest correction, bound of rounding) as the library's Newton iteration takes them.
fn at_rest(correction: &[f64], increment: &[f64], q: &[f64]) -> bool {
    let size = |numbers: &[f64]| numbers.iter().fold(0.0_f64, |largest, x| max_or_nan(largest, x.abs()));
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

    #[inline(always)]
    fn solve<const AT_NODES: bool>(
        &mut self,
        q: &[f64],
        p: &[f64],
        increment: &mut [f64],
        room: &mut Buffers,
    ) {
        loop {
            let (sine, cosine) = libm::sincos(q[0] + 0.5 * increment[0]);
            let mut residual = p[0] - increment[0] / STEP - 0.5 * STEP * GRAVITY * sine;
            let mut slope = -1.0 / STEP - 0.25 * STEP * GRAVITY * cosine;
            if AT_NODES {
                residual -= 0.5 * STEP * room.damping::<true>(0, increment[0]);
                slope -= 0.5 * STEP * room.slope;
            }
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
    coordinates: usize,
    /// (1 + h²K/4 + h²/2 slope)⁻¹, which is symmetric.
    inverse: Vec<f64>,
}

impl LinearChain {
    fn new(coordinates: usize) -> Self {
        Self { coordinates, inverse: Vec::new() }
    }
}

impl ByHand for LinearChain {
    fn energy(&self, q: &[f64]) -> f64 {
        let ends = q[0] * q[0] + q[q.len() - 1] * q[q.len() - 1];
        0.5 * STIFFNESS * q.windows(2).fold(ends, |sum, q| sum + (q[1] - q[0]) * (q[1] - q[0]))
    }

    fn prepare(&mut self, slope: f64) {
        let n = self.coordinates;
        let matrix = DMatrix::from_fn(n, n, |row, column| match row.abs_diff(column) {
            0 => 1.0 + 0.25 * STEP * STEP * 2.0 * STIFFNESS + 0.5 * STEP * STEP * slope,
            1 => -0.25 * STEP * STEP * STIFFNESS,
            _ => 0.0,
        });
        self.inverse = matrix.try_inverse().expect("definite").as_slice().to_vec();
    }

    #[inline]
    fn gradient(&self, q: &[f64], gradient: &mut [f64]) {
        for (i, place) in gradient.iter_mut().enumerate() {
            let left = if i > 0 { q[i - 1] } else { 0.0 };
            let right = if i + 1 < q.len() { q[i + 1] } else { 0.0 };
            *place = STIFFNESS * (2.0 * q[i] - left - right);
        }
    }

    #[inline(always)]
    fn solve<const AT_NODES: bool>(
        &mut self,
        q: &[f64],
        p: &[f64],
        increment: &mut [f64],
        room: &mut Buffers,
    ) {
        // (1 + h²K/4 + h²/2 slope) e = h p − h²/2 (K q + known).
        self.gradient(q, &mut room.gradient);
        if AT_NODES {
            room.gradient.iter_mut().zip(&room.known).for_each(|(pull, known)| *pull += known);
        }
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

    #[inline(always)]
    fn solve<const AT_NODES: bool>(
        &mut self,
        q: &[f64],
        p: &[f64],
        increment: &mut [f64],
        room: &mut Buffers,
    ) {
        let n = q.len();
        loop {
            for i in 0..n {
                room.middle[i] = q[i] + 0.5 * increment[i];
            }
            room.gradient.fill(0.0);
            room.gradient[0] = 4.0 * room.middle[0];
            let quarter = 0.25 * STEP * STEP;
            self.diagonal.fill(if AT_NODES { 1.0 + 0.5 * STEP * STEP * room.slope } else { 1.0 });
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
                let force = room.gradient[i] + room.damping::<AT_NODES>(i, increment[i]);
                room.residual[i] = increment[i] - STEP * p[i] + 0.5 * STEP * STEP * force;
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

/// The midpoint rule for one system, with its fractional force at the end of the step, \[JO\] eq. 63–66, or
/// at the quadrature node.
struct Motion<S, const AT_NODES: bool, const COMPENSATED: bool> {
    system: S,
    memory: HostMemory<f64>,
    position: Vec<f64>,
    momentum: Vec<f64>,
    /// Rounding errors of position and momentum so far.
    rests: [Vec<f64>; 2],
    increment: Vec<f64>,
    /// q_k − X_{k−1}: how far the last node lies behind.
    behind: Vec<f64>,
    sample: Vec<f64>,
    term: Vec<f64>,
    room: Buffers,
}

impl<S: ByHand, const AT_NODES: bool, const COMPENSATED: bool> Motion<S, AT_NODES, COMPENSATED> {
    fn new(scenario: &Scenario, mut system: S) -> Self {
        let coordinates = scenario.coordinates();
        let memory = MemoryRequest {
            end: None,
            family: scenario.convolution.family,
            starting: &scenario.convolution.starting,
            transfer: &TransferFunction::power(ORDER).expect("an exponent"),
            step_size: STEP,
            coordinates,
            motions: 1,
            samples: scenario.time.steps + 1,
            given: false,
            history: &scenario.history,
        };
        let zeros = || vec![0.0; coordinates];
        let mut memory = memory.build().expect("a memory");
        let mut slope = 0.0;
        if AT_NODES {
            slope = 0.5 * DAMPING * memory.leading()[0];
        } else {
            memory.push(&zeros()).expect("room");
        }
        system.prepare(slope);
        Self {
            system,
            memory,
            position: scenario.initial.position.clone(),
            momentum: zeros(),
            rests: [zeros(), zeros()],
            increment: zeros(),
            behind: zeros(),
            sample: zeros(),
            term: zeros(),
            room: Buffers { middle: zeros(), gradient: zeros(), residual: zeros(), known: zeros(), slope },
        }
    }

    fn step(&mut self) {
        self.memory.next_term(&mut self.term).expect("room");
        let leading = self.memory.leading()[0];
        let Self { system, position, momentum, rests, increment, behind, sample, term, room, .. } = self;
        if AT_NODES {
            for (known, (term, behind)) in room.known.iter_mut().zip(term.iter().zip(&*behind)) {
                *known = DAMPING * (term + leading * behind);
            }
        }
        for (e, &p) in increment.iter_mut().zip(&*momentum) {
            *e = STEP * p;
        }
        system.solve::<AT_NODES>(position, momentum, increment, room);
        let [position_rest, momentum_rest] = rests;
        let positions = position.iter_mut().zip(position_rest);
        let momenta = momentum.iter_mut().zip(momentum_rest);
        let forces = room.gradient.iter().zip(if AT_NODES { &room.known } else { &*term });
        for ((((q, q_rest), (p, p_rest)), (pull, known)), &e) in
            positions.zip(momenta).zip(forces).zip(&*increment)
        {
            let damping = if AT_NODES { known + room.slope * e } else { DAMPING * (known + leading * e) };
            add::<COMPENSATED>(q, q_rest, e);
            add::<COMPENSATED>(p, p_rest, -STEP * (pull + damping));
        }
        if AT_NODES {
            // The memory takes the increments of X − q₀, of which this is the next one.
            for ((sample, behind), e) in sample.iter_mut().zip(behind).zip(&*increment) {
                (*sample, *behind) = (*behind + 0.5 * e, 0.5 * e);
            }
        }
        // That of the main nodes takes the increments of q − q₀.
        self.memory.push(if AT_NODES { sample } else { increment }).expect("room");
    }

    fn energy(&self) -> f64 {
        let kinetic: f64 = self.momentum.iter().map(|p| p * p).sum();
        0.5 * kinetic + self.system.energy(&self.position)
    }
}

/// Adds `change` to `number`, if wanted with what rounding has left of earlier changes.
#[inline(always)]
fn add<const COMPENSATED: bool>(number: &mut f64, rest: &mut f64, change: f64) {
    if COMPENSATED {
        let change = change + *rest;
        let sum = *number + change;
        (*number, *rest) = (sum, change - (sum - *number));
    } else {
        *number += change;
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

fn by_hand<S: ByHand, const AT_NODES: bool, const COMPENSATED: bool>(scenario: &Scenario, system: S) -> f64 {
    let mut motion = Motion::<S, AT_NODES, COMPENSATED>::new(scenario, system);
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
    let mut progress = |steps: usize| {
        if steps.is_multiple_of(stretch) {
            let now = Instant::now();
            fastest = begin.map_or(fastest, |begin| fastest.min((now - begin).as_secs_f64()));
            begin = Some(now);
        }
    };
    run(scenario, &options, &AtomicBool::new(false), &mut progress).expect("a run");
    1e9 * fastest / stretch as f64
}

/// Prints the times of a step; returns that of `fvi run`.
fn compare<S: ByHand>(
    name: &str,
    (coordinates, steps): (usize, usize),
    potential: &str,
    system: S,
    (code, allowed): (Code, f64),
) -> f64 {
    let scenario = scenario(coordinates, steps, potential);
    let nodes = damped_at_nodes(&scenario);
    check::<_, false, true>(&scenario, system.clone());
    check::<_, false, false>(&scenario, system.clone());
    check::<_, true, true>(&nodes, system.clone());
    let directory = std::env::temp_dir().join(format!("fvi-bench-steps-{}", std::process::id()));
    std::fs::create_dir_all(&directory).expect("room for temporary files");
    let in_c = InC::compile(code, &scenario, &directory);
    let mut fastest = [f64::INFINITY; 7];
    for _ in 0..TURNS {
        let times = [
            in_c.nanoseconds(&scenario),
            in_a_run(&scenario, &directory),
            in_the_loop(&scenario),
            by_hand::<_, false, true>(&scenario, system.clone()),
            by_hand::<_, false, false>(&scenario, system.clone()),
            in_a_run(&nodes, &directory),
            by_hand::<_, true, true>(&nodes, system.clone()),
        ];
        for (fastest, time) in fastest.iter_mut().zip(times) {
            *fastest = fastest.min(time);
        }
    }
    // What is left there is of no use to anyone.
    let _ = std::fs::remove_dir_all(directory);
    let [in_c, run, steps, hand, plain, nodes, hand_nodes] = fastest;
    println!(
        "{name:<28} {run:>8.1} {steps:>12.1} {hand:>8.1} {:>6.2}  ({allowed}) {plain:>11.1} {:>6.2} {in_c:>8.1} {:>6.2}",
        run / hand,
        run / plain,
        run / in_c
    );
    println!(
        "{:<28} {nodes:>8.1} {hand_nodes:>21.1} {:>6.2}  {:.2} of the main nodes' (1.1)",
        "  damped at the node",
        nodes / hand_nodes,
        nodes / run
    );
    run
}

/// The systems of `steps.c`.
#[derive(Clone, Copy)]
enum Code {
    Oscillator,
    Pendulum,
    LinearChain,
    NonlinearChain,
}

/// `steps.c`, compiled for one system and size.
struct InC {
    program: PathBuf,
    table: String,
}

impl InC {
    fn compile(code: Code, scenario: &Scenario, directory: &Path) -> Self {
        let program = directory.join("steps");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/steps.c");
        let defined = [format!("-DSYSTEM={}", code as u8), format!("-DN={}", scenario.coordinates())];
        let compiled = Command::new("cc")
            .args(["-std=gnu11", "-O3", "-march=native", "-o"])
            .arg(&program)
            .args(defined)
            .arg(source)
            .arg("-lm")
            .status();
        assert!(compiled.is_ok_and(|status| status.success()), "`cc` compiles steps.c");
        // The weights of the memory that the scenario asks for.
        let kernel = ExponentialKernel::bdf_on_increments(
            BdfOrder::GRUNWALD_LETNIKOV,
            ORDER,
            STEP,
            scenario.history.horizon.expect("in the scenario"),
            SMALLEST_TOLERANCE,
        );
        let kernel = kernel.expect("a table");
        let table = kernel.table::<f64>();
        let (head, exponentials) = (table.head.as_ref(), table.exponentials.as_ref());
        let of_blocks =
            |from: usize| exponentials.chunks_exact(8).flat_map(move |block| &block[from..from + 4]);
        let numbers = head.iter().chain(of_blocks(0)).chain(of_blocks(4));
        let mut text = format!("{} {}", head.len(), exponentials.len() / 2);
        numbers.for_each(|number| text += &format!(" {number:e}"));
        Self { program, table: text }
    }

    /// Nanoseconds of a step, after it has made the same motion as the library.
    fn nanoseconds(&self, scenario: &Scenario) -> f64 {
        let mut child = Command::new(&self.program)
            .arg(scenario.time.steps.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program runs");
        child.stdin.take().expect("piped").write_all(self.table.as_bytes()).expect("it reads");
        let output = child.wait_with_output().expect("it ends");
        assert!(output.status.success(), "steps.c: {}", output.status);
        let text = String::from_utf8_lossy(&output.stdout);
        let mut numbers = text.split_whitespace().map(|number| number.parse::<f64>().expect("a number"));
        let nanoseconds = numbers.next().expect("the time");
        let (mut simulation, mut state) = simulation(scenario);
        for _ in 0..1000 {
            simulation.step(&[]).expect("a step");
        }
        simulation.read(&mut state);
        for expected in state.position.iter().zip(&state.momentum).flat_map(|(&q, &p)| [q, p]) {
            let found = numbers.next().expect("the state");
            assert!((found - expected).abs() < 1e-9, "{expected} by the library, {found} in C");
        }
        nanoseconds
    }
}

/// Both must have made the same motion after a thousand steps, to rounding.
fn check<S: ByHand, const AT_NODES: bool, const COMPENSATED: bool>(scenario: &Scenario, system: S) {
    let (mut simulation, mut state) = simulation(scenario);
    let mut motion = Motion::<S, AT_NODES, COMPENSATED>::new(scenario, system);
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
