//! Error against work: schemes on steps of any length compared with every scheme on equal steps.

use super::super::methods::Look;
use super::super::work_precision::{Comparison, Measured, REPEATS, Run};
use super::super::{Findings, ReproduceError};
use super::problems::{COLLOCATION, COLLOCATION_2, GALERKIN, Problem};
use fvi_host::results::picture::Marker;
use fvi_scenario::scenario::OutputOptions;
use std::sync::atomic::AtomicBool;

/// A scheme with steps of some lengths, as a function of the level of refinement.
struct Way {
    label: &'static str,
    look: Look,
    scheme: &'static str,
    time: fn(end: f64, level: u32) -> String,
}

const fn way(
    label: &'static str,
    (colour, marker): (usize, Marker),
    scheme: &'static str,
    time: fn(f64, u32) -> String,
) -> Way {
    Way { label, look: Look { colour, marker }, scheme, time }
}

/// k^4 and, for longer times, steps that grow up to a longest.
fn graded(end: f64, level: u32) -> String {
    format!("grid = \"graded\"\nend = {end:?}\nsteps = {}\nexponent = 4.0\n", 10 << level)
}

fn geometric(end: f64, level: u32) -> String {
    let ratio = 1.0 + 2.0 / libm::pow(2.0, f64::from(level));
    let longest = end / f64::from(20 << level);
    format!("grid = \"geometric\"\nend = {end:?}\nfirst = 1e-9\nratio = {ratio:?}\nlongest = {longest:?}\n")
}

fn adaptive(end: f64, level: u32) -> String {
    let tolerance = libm::pow(10.0, -2.0 - 1.5 * f64::from(level));
    format!("grid = \"adaptive\"\nend = {end:?}\ntolerance = {tolerance:e}\n")
}

/// Schemes with steps adapted to the start, for comparison with equal ones.
const GRADED: [Way; 4] = [
    way("collocation 2, graded", (8, Marker::Square), COLLOCATION_2, graded),
    way("collocation 3, graded", (8, Marker::Triangle), COLLOCATION, graded),
    way("Galerkin, Radau IIA 3, graded", (1, Marker::Diamond), GALERKIN, graded),
    way("collocation 3, adaptive", (9, Marker::Triangle), COLLOCATION, adaptive),
];

const GROWING: [Way; 4] = [
    way("collocation 2, growing", (8, Marker::Square), COLLOCATION_2, geometric),
    way("collocation 3, growing", (8, Marker::Triangle), COLLOCATION, geometric),
    way("Galerkin, Radau IIA 3, growing", (1, Marker::Diamond), GALERKIN, geometric),
    way("collocation 3, adaptive", (9, Marker::Triangle), COLLOCATION, adaptive),
];

fn measure(way: &Way, problem: &Problem, stop: &AtomicBool) -> Result<Measured, ReproduceError> {
    let mut runs = Vec::new();
    for level in 0..6 {
        let mut run: Option<Run> = None;
        for _ in 0..REPEATS {
            let made = problem.run_between(way.scheme, &(way.time)(problem.end, level), stop)?;
            let seconds = run.map_or(f64::INFINITY, |run| run.seconds).min(made.seconds);
            let step = problem.end / made.steps as f64;
            run = Some(Run { steps: made.solved, step, error: made.position, seconds });
        }
        runs.extend(run);
    }
    Ok(Measured { label: way.label, look: way.look, runs })
}

fn findings(
    title: &'static str,
    problem: &Problem,
    ways: &[Way],
    intervals: usize,
    stop: &AtomicBool,
) -> Result<Findings, ReproduceError> {
    let time = format!("step = {:?}\nend = {:?}\n", problem.end / (2 * intervals) as f64, problem.end);
    let mut scenario = problem.scenario(COLLOCATION, &time, "")?;
    scenario.output = OutputOptions { times: Vec::new(), ..scenario.output };
    let comparison =
        Comparison { title, scenario, intervals, main_nodes: 8, stages: 7, orders: &[1.0, 2.0, 5.0] };
    let mut measured = comparison.measure(stop)?;
    for way in ways {
        measured.push(measure(way, problem, stop)?);
    }
    Ok(comparison.page(&measured))
}

pub(super) fn root(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let found = findings("Solution t^(5/2): error against work", &Problem::root(), &GRADED, 5, stop)?;
    Ok(found.with_remark(
        "Graded: t = (k/N)⁴. Adaptive: tolerances from 10⁻² to 3·10⁻¹⁰; all steps that were solved count, three for two that are kept. \
         The force acts by its exact moments with the schemes' polynomials on equal and graded steps, but for collocation and \
         Euler's methods.",
    ))
}

pub(super) fn released(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let problem = Problem::released(1.0, 0.5);
    let found = findings("Oscillator let go: error against work", &problem, &GROWING, 40, stop)?;
    Ok(found.with_remark(
        "q̈ + D^(1/2) q + q = 0 in Caputo's sense, q(0) = 1, to t = 20. Growing: from 10⁻⁹ on, up to a longest step. Errors of equal \
         steps are those at t = 0.5, 1, …, 20, of the others at 0.001, 0.01 and 0.1 too, which are no grid points.",
    ))
}
