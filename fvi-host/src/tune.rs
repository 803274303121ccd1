//! Gains and orders of fractional controllers for a plant, and the margins and responses that result.
//!
//! | file | idea |
//! |---|---|
//! | `plant` | P(s) e^{−Ls}: formulas, or a scenario, linearised |
//! | `polynomial` | by its roots |
//! | `measured` | a plant by its frequency response, and its model |
//! | `coverage` | what a loop needs to know beyond the frequencies that were measured |
//! | `problem` | the input of `fvi tune` |
//! | `law` | C(s), and the law that ticks |
//! | `relay` | the ultimate point by a relay on a simulated plant |
//! | `rules` | named rules |
//! | `search` | a crossover with phase margin and bounds |
//! | `largest_gain` | bounds alone |
//! | `sampled` | the loop as it ticks |
//! | `grid` | the sampled plant at the frequencies of a search |
//! | `margins` | distances from −1 |
//! | `running_loop` | the tuned loop as a scenario |
//! | `output`, `pictures` | its files |

mod coverage;
mod grid;
mod largest_gain;
mod law;
mod margins;
mod measured;
mod output;
#[cfg(feature = "pictures")]
mod pictures;
mod plant;
mod polynomial;
mod problem;
mod relay;
mod rules;
mod running_loop;
mod sampled;
mod search;

use fvi_fft::sums::{max_or_nan, min_or_nan};
pub use law::Law;
pub use margins::Margins;
pub use plant::Plant;
pub use problem::{
    Crossover, Limit, Preference, Purpose, Rule, Specification, Structure, Terms, TuningProblem,
};
pub use relay::RelayResult;
pub use search::{Allowed, Bound};

use coverage::check_covered;
use fvi_core::PidGains;
use fvi_fft::transfer::laplace::on_a_line;
use fvi_simulation::simulation::closed_loop::{
    Contour, OpenLoop, growing_motions, growing_motions_open, growing_sampled_motions, logarithm,
};
use grid::{SampledPlant, is_rising};
use largest_gain::by_sensitivity;
use margins::{Loop, follow, margins};
use measured::Measured;
use nalgebra::Complex;
use sampled::{band, sampled_loop};
use search::{DEFAULTS, Search, frequencies, missed};
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
    /// Bounds on Ms and Mt that the specification does not have, but that were sought for free orders.
    pub sought: [Option<f64>; 2],
    /// The plant's ultimate gain and frequency under a proportional controller, if it has them.
    pub ultimate: Option<(f64, f64)>,
    /// Result of a relay experiment, if requested.
    pub relay: Option<RelayResult>,
    /// The plant and the loop over frequencies.
    pub response: Vec<LoopPoint>,
    /// Rows t, y and u after a unit step of the setpoint, y after a unit step of a load at the plant's input.
    pub steps: Vec<[f64; 4]>,
    /// A sentence about the model of a measured plant.
    pub model: Option<String>,
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
        log_denominator: plant.log_denominator + logarithm(law.denominator),
    })
}

/// Bounds on |L| at the highest frequency that is considered: without a dead time (`ENDS_AT`) and with one
/// (`MUST_END_AT`).
const ENDS_AT: f64 = 0.3;
const MUST_END_AT: f64 = 0.95;

/// Lowest frequency that is considered, relative to that of the specification, and |L| from which on it does
/// not matter that it grows.
const LEAST: f64 = 1e-30;
const LARGE: f64 = 30.0;

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
    if size(highest).is_nan() {
        return Err(format!("the loop gain is not a number at ω = {highest:e}"));
    }
    // Beyond the highest frequency |L| must not grow again, be it as slowly as s^0.01.
    let ends = [1e2, 1e4, 1e6].map(|part| size(part * highest));
    let end = ends.into_iter().fold(0.0, max_or_nan);
    if dead_time > 0.0 && (size(highest) > MUST_END_AT || end > MUST_END_AT || is_rising(ends[2], ends[0])) {
        return Err(
            "the loop gain grows at high frequencies, or does not fall below 1 there, and with a dead time such a loop is unstable: give the \
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
    let mut lowest = lowest.max(LEAST * about);
    // The lowest frequency that is looked at is 10² of it: where |L| grows without bound as ω → 0, it is to
    // be large there.
    while size(1e2 * lowest) < LARGE && is_rising(size(lowest), size(1e2 * lowest)) {
        if lowest < LEAST * about {
            return Err(format!("|L| grows as ω → 0 and is no more than {LARGE} at ω = {lowest:e}"));
        }
        lowest *= 1e-2;
    }
    let count = 40 * libm::log10(highest / lowest) as usize;
    let mut crossing = lowest;
    for k in 0..=count {
        let omega = lowest * libm::pow(highest / lowest, k as f64 / count as f64);
        let mut here = size(omega);
        if here.is_nan() {
            // On a pole of the plant the loop has no value, but beside it.
            here = size(omega * (1.0 + 1e-9));
        }
        if here.is_nan() {
            return Err(format!("the loop gain is not a number at ω = {omega:e}"));
        }
        if here > ENDS_AT {
            crossing = omega;
        }
    }
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

/// A law found for a specification.
struct Found {
    law: Law,
    /// Result of a relay experiment, if one was made.
    relay: Option<RelayResult>,
    sought: [Option<f64>; 2],
    about: f64,
}

/// Safety margin of bounds in the search, which checks them at discrete points only, in their own units.
const CLOSER: f64 = 1e-4;

/// Largest violation that a search with a safety margin larger by it is expected to make up for, and number
/// of searches.
const MADE_UP: f64 = 0.1;
const SEARCHES: usize = 4;

/// Tunes a controller, and computes margins and responses of the loop. Every bound of the specification is
/// checked on the sampled loop of the result, over all frequencies and crossovers.
///
/// # Errors
/// [`TuneError`]; the message of a bound that is not met has the law that was found.
pub fn tune(problem: &TuningProblem, stop: &AtomicBool) -> Result<Tuning, TuneError> {
    let grid = grid(problem)?;
    let mut closer = CLOSER;
    let mut searches = 1;
    loop {
        let Found { law, relay, sought, about } = find_closer(problem, &grid, closer, stop)?;
        let tuning = evaluate_design(problem, law, about, stop)?;
        check_covered(problem, &law)
            .map_err(|reason| TuneError::Infeasible(format!("{} is refused: {reason}", in_words(&law))))?;
        let bounds = bounds(problem, &grid, &law, &tuning.sampled_margins)?;
        let excess = bounds.iter().map(Bound::excess).fold(0.0, max_or_nan);
        if excess == 0.0 {
            return Ok(Tuning { relay, bounds, sought, ..tuning });
        }
        let has_closer = !matches!(problem.specification, Specification::Rule { .. });
        if searches == SEARCHES || !has_closer {
            let reason = format!("{} does not meet the specification: {}", in_words(&law), missed(&bounds));
            return Err(TuneError::Infeasible(reason));
        }
        // A crossover beside which |L| grazes 1 is missed by a lot, for a little of |L|.
        closer += if excess > MADE_UP { 9.0 * closer } else { 1.5 * excess };
        searches += 1;
    }
}

/// The sampled plant at the frequencies of the specification; a rule needs none.
fn grid(problem: &TuningProblem) -> Result<Option<SampledPlant<'_>>, TuneError> {
    let TuningProblem { plant, controller: structure, specification, .. } = problem;
    let (about, further) = match specification {
        Specification::Crossover(wanted) => (wanted.crossover, frequencies(plant, wanted)),
        Specification::Sensitivity { .. } => (plant.scale(), Vec::new()),
        Specification::Rule { .. } => return Ok(None),
    };
    SampledPlant::new(plant, structure.sample, about, &further).map(Some).map_err(TuneError::Infeasible)
}

/// The bounds of the specification with the values that a law reaches, whose sampled loop has these margins.
fn bounds(
    problem: &TuningProblem,
    grid: &Option<SampledPlant<'_>>,
    law: &Law,
    margins: &Margins,
) -> Result<Vec<Bound>, TuneError> {
    match (&problem.specification, grid) {
        (Specification::Crossover(wanted), Some(grid)) => {
            let search = Search::new(grid, &problem.controller, wanted, CLOSER, DEFAULTS[0]);
            Ok(search.map_err(TuneError::Infeasible)?.bounds(law, margins))
        }
        (Specification::Sensitivity { ms, mt }, _) => {
            let mut bounds = vec![Bound::at_most("Ms", *ms, margins.ms)];
            bounds.extend(mt.map(|mt| Bound::at_most("Mt", mt, margins.mt)));
            Ok(bounds)
        }
        _ => Ok(Vec::new()),
    }
}

/// The law for a specification, by the sampled loop at the frequencies of a grid.
///
/// # Errors
/// [`TuneError::Infeasible`], and if it was stopped.
pub fn find(problem: &TuningProblem, stop: &AtomicBool) -> Result<Law, TuneError> {
    Ok(find_closer(problem, &grid(problem)?, CLOSER, stop)?.law)
}

fn find_closer(
    problem: &TuningProblem,
    grid: &Option<SampledPlant<'_>>,
    closer: f64,
    stop: &AtomicBool,
) -> Result<Found, TuneError> {
    let TuningProblem { plant, controller: structure, specification, .. } = problem;
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
        check_plant(plant)?;
    }
    let found = match (specification, grid) {
        (Specification::Crossover(wanted), Some(grid)) => {
            let about = wanted.crossover;
            let is_stable = |law: &Law| {
                !stop.load(Ordering::Relaxed) && grid.is_stable(law) && check(plant, law, about).is_ok()
            };
            let best = |defaults| {
                let search = Search::new(grid, structure, wanted, closer, defaults)?;
                search.best(&is_stable).map(|law| (law, search.sought()))
            };
            let [first, next] = DEFAULTS;
            let has_both = wanted.ms.is_some() && wanted.mt.is_some();
            let law = best(first).or_else(|reason| if has_both { Err(reason) } else { best(next) });
            law.map(|(law, sought)| (law, sought, about))
        }
        (Specification::Sensitivity { ms, mt }, Some(grid)) => {
            let bounds = (ms - closer, mt.map(|mt| mt - closer));
            by_sensitivity(grid, structure, bounds).map(|law| (law, [None; 2], plant.scale()))
        }
        (Specification::Rule { name, ms, purpose, closed_loop_time }, _) => {
            let ultimate = relay.map(|found| (found.describing_gain, found.frequency)).or(exact);
            rules::by_rule(plant, structure, (*name, *ms, *purpose, *closed_loop_time), ultimate)
                .map(|law| (law, [None; 2], plant.scale()))
        }
        (_, None) => Err("the specification needs the sampled plant".to_owned()),
    };
    if stop.load(Ordering::Relaxed) {
        return Err(TuneError::Stopped);
    }
    let (law, sought, about) = found.map_err(TuneError::Infeasible)?;
    Ok(Found { law, relay, sought, about })
}

/// Checks that no motion of the plant itself grows.
fn check_plant(plant: &Plant) -> Result<(), TuneError> {
    let scale = plant.scale();
    let (lowest, highest) = (1e-7 * scale, 1e4 * scale);
    let (shift, dead_time) = (1e-8 * scale, 0.0);
    let contour = Contour { lowest, highest, crossing: lowest, dead_time, shift };
    match growing_motions_open(&contour, &|s| plant.at(s)) {
        Ok(0) => Ok(()),
        Ok(_) => Err(TuneError::Infeasible(
            "this specification is for plants without motions that grow: give a `crossover` and a `phase_margin`"
                .to_owned(),
        )),
        Err(reason) => Err(TuneError::Infeasible(format!("of the plant alone, {reason}"))),
    }
}

/// A law for a message: gains with six digits behind the point, or as powers of ten where these would be few.
pub fn in_words(law: &Law) -> String {
    let gain = |gain: f64| {
        if gain == 0.0 || (1e-3..1e7).contains(&gain.abs()) {
            format!("{gain:.6}")
        } else {
            format!("{gain:.6e}")
        }
    };
    let [kp, ki, kd] = law.three().map(gain);
    let form = match law.gains {
        PidGains::Parallel { .. } => "",
        PidGains::Series { .. } => ", in series",
    };
    format!("kp = {kp}, ki = {ki}, lambda = {:.4}, kd = {kd}, mu = {:.4}{form}", law.lambda, law.mu)
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
    evaluate_design(problem, law, problem.plant.scale(), stop)
}

/// Turns of a dead time, in radians, up to which the sampled loop is followed; above, any phase is assumed.
const FOLLOWED_TURNS: f64 = 1000.0;

/// Margins of the sampled loop, which is stable.
///
/// # Errors
/// A sentence: motions of it grow, or it cannot be followed.
fn sampled_margins(
    plant: &Plant,
    law: &Law,
    sample: f64,
    (range, about): (&Range, f64),
) -> Result<Margins, String> {
    let highest = band(sample);
    let lowest = range.contour.lowest.min(1e-4 * highest);
    // The plant may have undamped modes of its own, with poles on the imaginary axis.
    let shift = 1e-7 * about.min(plant.scale());
    let own = growing_motions_open(&Contour { shift, ..range.contour }, &|s| plant.at(s));
    let own = own.map_err(|reason| format!("of the plant alone, {reason}"))?;
    let (crossing, dead_time) = (range.contour.crossing.min(highest), plant.dead_time());
    let contour = Contour { lowest, highest, crossing, dead_time, shift };
    let open = |s: Complex<f64>| sampled_loop(plant, law, sample, s);
    let growing = growing_sampled_motions(&contour, own, &open)
        .map_err(|reason| format!("with the samples of `controller.sample` = {sample}: {reason}"))?;
    if growing > 0 {
        return Err(format!(
            "{growing} motions of the loop grow with samples of `controller.sample` = {sample}, which none does in \
             continuous time"
        ));
    }
    let open = |omega: f64| open(Complex::new(0.0, omega));
    let from = range.from.min(0.1 * highest);
    let followed = highest.min(FOLLOWED_TURNS / dead_time).max(2.0 * from);
    let points = follow(&open, from, followed.min(highest), dead_time)?;
    let mut found = margins(&points, &open);
    let (mut omega, mut largest) = (followed, 0.0);
    while omega < highest {
        let size = open(omega).map_or(f64::NAN, |value| value.norm());
        if size.is_nan() || size >= MUST_END_AT {
            return Err(format!(
                "|L| is {size:.3} at ω = {omega:e}, where the dead time has turned its phase by more than {FOLLOWED_TURNS} rad"
            ));
        }
        if size > largest {
            let [s, t] = [1.0, size].map(|part| part / (1.0 - size));
            (found.ms_at, found.ms) = if s > found.ms { (omega, s) } else { (found.ms_at, found.ms) };
            (found.mt_at, found.mt) = if t > found.mt { (omega, t) } else { (found.mt_at, found.mt) };
            found.gain_margin = found.gain_margin.map(|margin| min_or_nan(margin, 1.0 / size));
            largest = size;
        }
        omega *= 1.0097;
    }
    Ok(found)
}

/// Margins with what |S| and |T| tend to beyond the points: 1 for |L| → 0 as ω → ∞, and for |L| → ∞ as
/// ω → 0.
fn with_ends(mut found: Margins, range: &Range, open: &Loop<'_>) -> Margins {
    let size = |omega: f64| open(omega).map(|value| value.norm());
    if found.ms < 1.0 && size(1e3 * range.to).is_some_and(|size| size < 1e-2) {
        (found.ms_at, found.ms) = (range.to, 1.0);
    }
    if found.mt < 1.0 && size(1e-3 * range.from).is_some_and(|size| size > 1e2) {
        (found.mt_at, found.mt) = (range.from, 1.0);
    }
    found
}

fn evaluate_design(
    problem: &TuningProblem,
    law: Law,
    about: f64,
    stop: &AtomicBool,
) -> Result<Tuning, TuneError> {
    let TuningProblem { plant, controller: structure, .. } = problem;
    let unstable = |reason: String| TuneError::Unstable(format!("{} is refused: {reason}", in_words(&law)));
    law.sampled(structure.sample).map_err(|error| unstable(error.to_string()))?;
    let range = range(plant, &law, about).map_err(unstable)?;
    check(plant, &law, about).map_err(unstable)?;
    let open = |omega: f64| Some(open_loop(plant, &law, Complex::new(0.0, omega))?.value);
    let points = follow(&open, range.from, range.to, plant.dead_time()).map_err(unstable)?;
    let found = with_ends(margins(&points, &open), &range, &open);
    if stop.load(Ordering::Relaxed) {
        return Err(TuneError::Stopped);
    }

    let sampled_margins =
        sampled_margins(plant, &law, structure.sample, (&range, about)).map_err(unstable)?;
    let highest = band(structure.sample);
    let sampled_open = |omega: f64| sampled_loop(plant, &law, structure.sample, Complex::new(0.0, omega));

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
    warnings.extend(plant.measured().and_then(|measured| measured.note.clone()));
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
        .filter(|omega| plant.is_known_at(*omega))
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
        sought: [None; 2],
        ultimate: plant.ultimate(),
        relay: None,
        response,
        steps,
        model: plant.measured().map(Measured::description),
        warnings,
    })
}
