//! Gains and orders of fractional controllers for a plant, and the margins and responses that result.
//!
//! | file | idea |
//! |---|---|
//! | `plant` | P(s) e^{−Ls}: formulas, or a scenario, linearised |
//! | `problem` | the input of `fvi tune` |
//! | `law` | C(s), and the law that ticks |
//! | `relay` | the ultimate point by a relay on a simulated plant |
//! | `rules` | named rules |
//! | `search` | specifications |
//! | `sampled` | the loop as it ticks |
//! | `margins` | distances from −1 |
//! | `output`, `pictures` | its files |

mod law;
mod margins;
mod output;
#[cfg(feature = "pictures")]
mod pictures;
mod plant;
mod problem;
mod relay;
mod rules;
mod sampled;
mod search;

use fvi_fft::sums::max_or_nan;
pub use law::Law;
pub use margins::Margins;
pub use plant::Plant;
pub use problem::{
    Crossover, Limit, Preference, Purpose, Rule, Specification, Structure, Terms, TuningProblem,
};
pub use relay::RelayResult;
pub use search::Bound;

use fvi_fft::transfer::laplace::on_a_line;
use fvi_simulation::simulation::closed_loop::{
    Contour, OpenLoop, growing_motions, growing_motions_open, growing_sampled_motions,
};
use margins::{follow, margins};
use nalgebra::Complex;
use sampled::{band, sampled_loop};
use search::{Search, by_sensitivity};
use std::sync::atomic::{AtomicBool, Ordering};

/// Why there is no tuning.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TuneError {
    /// No controller of this structure meets the specification.
    #[error("{0}")]
    Infeasible(String),
    /// The loop would be unstable, or its stability cannot be decided.
    #[error("{0}")]
    Unstable(String),
    /// It was stopped.
    #[error("stopped")]
    Stopped,
}

/// A tuned loop.
#[derive(Clone, Debug)]
pub struct Tuning {
    /// The controller.
    pub law: Law,
    /// Margins of the loop in continuous time.
    pub margins: Margins,
    /// Margins of the sampled loop: discrete law, and plant behind a zero-order hold.
    pub sampled_margins: Margins,
    /// The bounds of the specification with the values reached.
    pub bounds: Vec<Bound>,
    /// The plant's ultimate gain and frequency under a proportional controller, if it has them.
    pub ultimate: Option<(f64, f64)>,
    /// Result of a relay experiment, if requested.
    pub relay: Option<RelayResult>,
    /// The plant and the loop over frequencies.
    pub response: Vec<LoopPoint>,
    /// Rows t, y and u after a unit step of the setpoint, y after a unit step of a load at the plant's input.
    pub steps: Vec<[f64; 4]>,
    /// Warnings.
    pub warnings: Vec<String>,
}

/// A plant and its loop at one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopPoint {
    /// ω.
    pub omega: f64,
    /// P(iω).
    pub plant: Complex<f64>,
    /// L(iω).
    pub open: Complex<f64>,
    /// L of the sampled loop, below π/h.
    pub sampled: Option<Complex<f64>>,
}

/// The frequency range of a loop.
struct Range {
    contour: Contour,
    /// Range in which margins are determined.
    from: f64,
    to: f64,
}

/// The loop of a plant and a law.
fn open_loop(plant: &Plant, law: &Law, s: Complex<f64>) -> Option<OpenLoop> {
    let plant = plant.at(s)?;
    let law = law.response(s);
    Some(OpenLoop {
        value: plant.value * law.measured,
        log_denominator: plant.log_denominator + plant::logarithm(law.denominator),
    })
}

/// Bounds on |L| at the highest frequency that is considered: without a dead time (`ENDS_AT`) and with one
/// (`MUST_END_AT`).
const ENDS_AT: f64 = 0.3;
const MUST_END_AT: f64 = 0.95;

fn range(plant: &Plant, law: &Law, about: f64) -> Result<Range, String> {
    let size = |omega: f64| {
        open_loop(plant, law, Complex::new(0.0, omega)).map_or(f64::NAN, |open| open.value.norm())
    };
    let dead_time = plant.dead_time();
    let mut highest = 1e4 * about.max(plant.scale());
    let last = 1e12 * about;
    let (enough, far) =
        if dead_time > 0.0 { (MUST_END_AT, last) } else { (ENDS_AT, 1e8 * about.max(plant.scale())) };
    while highest < far && (size(highest).is_nan() || size(highest) > enough) {
        highest *= 10.0;
    }
    // Beyond the highest frequency |L| must not grow again.
    let end = [1e2, 1e4, 1e6].iter().map(|part| size(part * highest)).fold(0.0, max_or_nan);
    if dead_time > 0.0 && (size(highest) > MUST_END_AT || end > MUST_END_AT) {
        return Err(
            "the loop gain does not fall below 1 at high frequencies, and with a dead time such a loop is unstable: give the \
             derivative a filter (`controller.derivative_filter`)"
                .to_owned(),
        );
    }
    // A small integral term becomes significant at very low frequencies only.
    let [kp, ki, _] = law.three();
    let mut lowest = 1e-7 * about.min(plant.scale());
    if ki != 0.0 && kp != 0.0 {
        lowest = lowest.min(1e-4 * libm::pow((ki / kp).abs(), law.lambda.recip()));
    }
    let lowest = lowest.max(1e-30 * about);
    let count = 40 * libm::log10(highest / lowest) as usize;
    let grid = (0..=count).map(|k| lowest * libm::pow(highest / lowest, k as f64 / count as f64));
    let crossing =
        grid.filter(|&omega| size(omega).is_nan() || size(omega) > ENDS_AT).fold(lowest, max_or_nan);
    let contour = Contour { lowest, highest, crossing: 1.2 * crossing, dead_time, shift: 0.0 };
    Ok(Range { contour, from: lowest * 1e2, to: highest })
}

/// True if the loop in continuous time is stable.
fn check(plant: &Plant, law: &Law, about: f64) -> Result<(), String> {
    let range = range(plant, law, about)?;
    match growing_motions(&range.contour, &|s| open_loop(plant, law, s))? {
        0 => Ok(()),
        1 => Err("one motion of the loop grows".to_owned()),
        several => Err(format!("{several} motions of the loop grow")),
    }
}

/// Number of points of the responses.
const POINTS: usize = 400;

/// The controller found for a specification.
#[derive(Clone, Debug)]
pub struct Found {
    /// The controller.
    pub law: Law,
    /// The bounds of the specification with the values reached.
    pub bounds: Vec<Bound>,
    /// Result of a relay experiment, if one was made.
    pub relay: Option<RelayResult>,
    about: f64,
}

/// Tunes a controller, and computes margins and responses of the loop.
///
/// # Errors
/// [`TuneError`].
pub fn tune(problem: &TuningProblem, stop: &AtomicBool) -> Result<Tuning, TuneError> {
    let Found { law, bounds, relay, about } = find(problem, stop)?;
    Ok(Tuning { relay, bounds, ..judged(problem, law, about, stop)? })
}

/// The law for a specification. Stability of the loop has been checked only for specifications by a
/// crossover.
///
/// # Errors
/// [`TuneError::Infeasible`], and if it was stopped.
pub fn find(problem: &TuningProblem, stop: &AtomicBool) -> Result<Found, TuneError> {
    let TuningProblem { plant, controller: structure, specification, .. } = problem;
    let mut bounds = Vec::new();
    let exact = plant.ultimate();
    let relay = match (problem.relay, plant.scenario()) {
        (Some(amplitude), Some(scenario)) => {
            let (_, expected) = exact.ok_or_else(|| {
                TuneError::Infeasible(
                    "a relay does not make the plant oscillate: its phase does not reach −180°".to_owned(),
                )
            })?;
            let found = relay::experiment(scenario, (amplitude, plant.sign()), expected, stop);
            Some(found.map_err(TuneError::Infeasible)?)
        }
        _ => None,
    };
    let needs_stable_plant = match specification {
        Specification::Sensitivity { .. } => true,
        Specification::Rule { name, .. } => *name == Rule::ZieglerNichols,
        Specification::Crossover(_) => false,
    };
    if needs_stable_plant {
        let scale = plant.scale();
        let (lowest, highest) = (1e-7 * scale, 1e4 * scale);
        let (shift, dead_time) = (1e-8 * scale, 0.0);
        let contour = Contour { lowest, highest, crossing: lowest, dead_time, shift };
        match growing_motions_open(&contour, &|s| plant.at(s)) {
            Ok(0) => {}
            Ok(_) => {
                return Err(TuneError::Infeasible(
                    "this specification is for plants without motions that grow: give a `crossover` and a `phase_margin`"
                        .to_owned(),
                ));
            }
            Err(reason) => return Err(TuneError::Infeasible(format!("of the plant alone, {reason}"))),
        }
    }
    let (law, about) = match specification {
        Specification::Crossover(wanted) => {
            let search = Search::new(plant, structure, wanted).map_err(TuneError::Infeasible)?;
            let stable =
                |law: &Law| !stop.load(Ordering::Relaxed) && check(plant, law, wanted.crossover).is_ok();
            let law = search.best(&stable);
            if stop.load(Ordering::Relaxed) {
                return Err(TuneError::Stopped);
            }
            let law = law.map_err(TuneError::Infeasible)?;
            bounds = search.bounds(&law);
            (law, wanted.crossover)
        }
        Specification::Sensitivity { ms, mt } => {
            let law = by_sensitivity(plant, structure, (*ms, *mt)).map_err(TuneError::Infeasible)?;
            (law, plant.scale())
        }
        Specification::Rule { name, ms, purpose, closed_loop_time } => {
            let ultimate = relay.map(|found| (found.describing_gain, found.frequency)).or(exact);
            let law = rules::by_rule(plant, structure, (*name, *ms, *purpose, *closed_loop_time), ultimate);
            (law.map_err(TuneError::Infeasible)?, plant.scale())
        }
    };
    Ok(Found { law, bounds, relay, about })
}

/// The margins of a law in continuous time.
///
/// # Errors
/// [`TuneError::Unstable`].
pub fn margins_of(problem: &TuningProblem, law: &Law) -> Result<Margins, TuneError> {
    let plant = &problem.plant;
    let about = plant.scale();
    let found = || {
        check(plant, law, about)?;
        let range = range(plant, law, about)?;
        let open = |omega: f64| Some(open_loop(plant, law, Complex::new(0.0, omega))?.value);
        let points = follow(&open, range.from, range.to, plant.dead_time())?;
        Ok(margins(&points, &open))
    };
    found().map_err(TuneError::Unstable)
}

/// Margins and responses of the loop with a given law.
///
/// # Errors
/// [`TuneError::Unstable`], and if it was stopped.
pub fn judge(problem: &TuningProblem, law: Law, stop: &AtomicBool) -> Result<Tuning, TuneError> {
    judged(problem, law, problem.plant.scale(), stop)
}

fn judged(problem: &TuningProblem, law: Law, about: f64, stop: &AtomicBool) -> Result<Tuning, TuneError> {
    let TuningProblem { plant, controller: structure, .. } = problem;
    let [kp, ki, kd] = law.three();
    let unstable = |reason: String| {
        TuneError::Unstable(format!(
            "kp = {kp:.6}, ki = {ki:.6}, lambda = {:.4}, kd = {kd:.6}, mu = {:.4} is refused: {reason}",
            law.lambda, law.mu
        ))
    };
    law.sampled(structure.sample).map_err(|error| unstable(error.to_string()))?;
    let range = range(plant, &law, about).map_err(unstable)?;
    check(plant, &law, about).map_err(unstable)?;
    let open = |omega: f64| Some(open_loop(plant, &law, Complex::new(0.0, omega))?.value);
    let points = follow(&open, range.from, range.to, plant.dead_time()).map_err(unstable)?;
    let found = margins(&points, &open);
    if stop.load(Ordering::Relaxed) {
        return Err(TuneError::Stopped);
    }

    let highest = band(structure.sample);
    let lowest = range.contour.lowest.min(1e-4 * highest);
    // The plant may have undamped modes of its own, with poles on the imaginary axis.
    let shift = 1e-7 * about.min(plant.scale());
    let own = growing_motions_open(&Contour { shift, ..range.contour }, &|s| plant.at(s));
    let own = own.map_err(|reason| unstable(format!("of the plant alone, {reason}")))?;
    let contour = Contour { lowest, highest, crossing: lowest, dead_time: 0.0, shift };
    let sampled_open = |s: Complex<f64>| sampled_loop(plant, &law, structure.sample, s);
    let growing = growing_sampled_motions(&contour, own, &sampled_open).map_err(|reason| {
        unstable(format!("with the samples of `controller.sample` = {}: {reason}", structure.sample))
    })?;
    if growing > 0 {
        return Err(unstable(format!(
            "{growing} motions of the loop grow with samples of `controller.sample` = {}, which none does in continuous time",
            structure.sample
        )));
    }
    let sampled_open = |omega: f64| sampled_open(Complex::new(0.0, omega));
    let from = range.from.max(1e-6 * highest).min(0.1 * highest);
    let sampled_points = follow(&sampled_open, from, highest, 0.0).map_err(unstable)?;
    let sampled_margins = margins(&sampled_points, &sampled_open);

    let mut warnings = Vec::new();
    let apart = |a: Option<f64>, b: Option<f64>| a.zip(b).map(|(a, b)| (a - b).abs());
    if apart(found.phase_margin, sampled_margins.phase_margin).is_some_and(|apart| apart > 5.0) {
        warnings.push(format!(
            "samples of {} take the phase margin from {:.2}° to {:.2}°",
            structure.sample,
            found.phase_margin.unwrap_or(f64::NAN),
            sampled_margins.phase_margin.unwrap_or(f64::NAN)
        ));
    }
    if plant.scenario().is_some_and(plant::ScenarioPlant::is_at_a_kink) {
        warnings.push(
            "the forces have a kink at the position of the plant, where they have no derivative: its stiffness is that \
             of one side, or lacks what has the kink"
                .to_owned(),
        );
    }
    if plant.scenario().is_some_and(plant::ScenarioPlant::changes_with_time) {
        warnings.push("the stiffness changes with time: the plant is that of t = 0".to_owned());
    }
    let centre = found.gain_crossovers.last().copied().unwrap_or(about);
    let response = (0..=POINTS)
        .map(|k| centre * libm::pow(10.0, 5.0 * k as f64 / POINTS as f64 - 3.0))
        .filter_map(|omega| {
            let plant = plant.at(Complex::new(0.0, omega))?.value;
            let sampled = (omega < highest).then(|| sampled_open(omega)).flatten();
            Some(LoopPoint { omega, plant, open: open(omega)?, sampled })
        })
        .collect();
    let end = 40.0 / centre + 10.0 * plant.dead_time();
    let steps = (1..=POINTS)
        .map(|k| {
            let time = end * k as f64 / POINTS as f64;
            let image = |of: &dyn Fn(Complex<f64>, Complex<f64>) -> Complex<f64>| {
                on_a_line(time, |s| {
                    // On a pole of the plant the loop has no value either.
                    let value = plant.at(s).map_or(Complex::new(f64::NAN, 0.0), |plant| plant.value);
                    of(s, value) / s
                })
            };
            let closed = |s: Complex<f64>, plant: Complex<f64>| {
                let law = law.response(s);
                (law.setpoint, plant * law.measured + 1.0)
            };
            [
                time,
                image(&|s, plant| {
                    let (setpoint, below) = closed(s, plant);
                    plant * setpoint / below
                }),
                image(&|s, plant| {
                    let (setpoint, below) = closed(s, plant);
                    setpoint / below
                }),
                image(&|s, plant| plant / closed(s, plant).1),
            ]
        })
        .collect();
    Ok(Tuning {
        law,
        margins: found,
        sampled_margins,
        bounds: Vec::new(),
        ultimate: plant.ultimate(),
        relay: None,
        response,
        steps,
        warnings,
    })
}
