//! Error and order of a scenario over a sequence of step sizes.

use crate::results::measure::{ErrorMeasure, ReferenceErrors};
#[cfg(feature = "pictures")]
use crate::results::picture::{Axis, Chart, Series, Style, power};
use fvi_core::ParameterError;
use fvi_scenario::language::memory_limit::{OutOfMemory, check_capacity};
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Feature, MOST_STEPS, Reference, ReferenceRow, Scenario};
use fvi_simulation::simulation::motion::{Failure, Motion};
use fvi_simulation::simulation::{GridState, Precision};
use serde::Serialize;
use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Which grids are compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Grids {
    /// Levels i: the time of the scenario is cut into `intervals`·2^i steps.
    pub levels: RangeInclusive<u32>,
    /// Number of intervals of the coarsest grid (level 0); their ends, such as the time of a jump, are points
    /// of every grid.
    pub intervals: usize,
    /// Errors count from this time on: next to a singular start they may be larger than the order of a scheme
    /// promises.
    pub from: f64,
}

/// Quantity whose errors are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// q, the largest over the coordinates.
    Position,
    /// p, the largest over the coordinates.
    Momentum,
    /// E = ½ pᵀM⁻¹p + U(q).
    Energy,
}

impl Quantity {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Position, Self::Momentum, Self::Energy];

    /// Name of the quantity.
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Momentum => "momentum",
            Self::Energy => "energy",
        }
    }

    fn of(self, errors: &ReferenceErrors) -> &ErrorMeasure {
        match self {
            Self::Position => &errors.position,
            Self::Momentum => &errors.momentum,
            Self::Energy => &errors.energy,
        }
    }
}

/// Reference for the errors of a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorReference {
    /// The reference of the scenario.
    Reference,
    /// A run of the same scheme with this number of steps.
    FinerRun(usize),
}

/// One run of the sequence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Level {
    /// Its number i.
    pub level: u32,
    /// Number of steps.
    pub steps: usize,
    /// Step size h.
    pub step: f64,
    /// Largest errors over the grid points where the solution is known.
    pub errors: ReferenceErrors,
    /// Seconds for the steps.
    pub seconds: f64,
    /// Why there is no result: the step is too long to be stable, or a step failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
}

/// Errors over a sequence of step sizes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Convergence {
    /// Reference of each quantity, in the order of [`Quantity::ALL`].
    pub against: [ErrorReference; 3],
    /// The runs, coarsest first.
    pub levels: Vec<Level>,
}

/// Why errors could not be measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConvergeError {
    /// The scenario cannot be run.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The finer run used as reference failed.
    #[error("the finer run of {steps} steps that the others are compared with failed: {reason}")]
    FinerRun {
        /// Its number of steps.
        steps: usize,
        /// Why.
        reason: String,
    },
    /// The states of the finer run do not fit into memory.
    #[error("the states of the finer run: {0}")]
    NoRoom(#[from] OutOfMemory),
    /// There are too many steps to count.
    #[error("level {level} has more steps than can be counted")]
    TooManySteps {
        /// The level.
        level: u32,
    },
    /// `Grids::from` lies outside the scenario's time interval.
    #[error(transparent)]
    From(ParameterError),
    /// It was stopped.
    #[error("stopped")]
    Stopped,
}

/// Number of levels by which the run used as reference is finer than the finest grid, where the scenario has
/// no reference.
const FINER: u32 = 2;

/// How a run on one grid ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// All steps were made.
    Done {
        /// Wall-clock seconds of the steps alone.
        seconds: f64,
    },
    /// A step failed.
    Failed {
        /// Which step, and why.
        reason: String,
    },
}

/// Runs the scenario on every grid and measures the errors against its reference, and against a finer run of
/// the same scheme for quantities that the reference does not contain.
///
/// `progress` receives the number of steps made and the total number of steps.
///
/// # Errors
/// [`ConvergeError`]. A level whose step is too long, or fails, is part of the result.
pub fn converge(
    scenario: &Scenario,
    grids: &Grids,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Convergence, ConvergeError> {
    let from = grids.from;
    if !(0.0..=scenario.time.end()).contains(&from) {
        let allowed = "a time from 0 to the end of the scenario";
        return Err(ConvergeError::From(ParameterError { parameter: "from", value: from, allowed }));
    }
    let steps_of = |level: u32| {
        let power = 1_usize.checked_shl(level).filter(|&power| power >> level == 1);
        power
            .and_then(|power| power.checked_mul(grids.intervals))
            .filter(|&steps| steps <= MOST_STEPS)
            .ok_or(ConvergeError::TooManySteps { level })
    };
    let finest = *grids.levels.end();
    let known = scenario.reference.as_ref().map_or([false; 3], Reference::knows);
    let finer = if known == [true; 3] { None } else { Some(steps_of(finest + FINER)?) };
    let mut all = finer.unwrap_or(0);
    for level in grids.levels.clone() {
        all = all.saturating_add(steps_of(level)?);
    }
    scenario.check_use(Feature::Converge)?;
    if scenario.time.end() <= scenario.time.start {
        let key = if scenario.document().has("time.end") { "time.end" } else { "time.steps" };
        let reason = "a run without steps has no errors: an end after the start is needed".to_owned();
        return Err(ConvergeError::Input(scenario.error_at(key, Problem::Unusable { reason })));
    }
    let meets = |level| steps_of(level).is_ok_and(|steps| scenario.in_steps(steps).meets_reference());
    if !grids.levels.clone().any(meets) {
        let allowed =
            "levels of which one has a grid point at a time of the table (see `--intervals`)".to_owned();
        let problem = Problem::Incompatible { with: "`--levels`".to_owned(), allowed };
        return Err(ConvergeError::Input(scenario.error_at("reference.file", problem)));
    }
    let mut made = 0;
    let mut count = || {
        made += 1;
        progress(made, all);
    };

    let mut fine_states: Vec<GridState> = Vec::new();
    if finer.is_some() {
        let numbers =
            size_of::<GridState>() + 2 * scenario.coordinates().next_multiple_of(2) * size_of::<f64>() + 32;
        let states = steps_of(finest)?.saturating_add(1);
        check_capacity(states.saturating_mul(numbers))?;
        fine_states.reserve_exact(states);
    }
    if let Some(steps) = finer {
        let outcome = run_on(&scenario.in_steps(steps), stop, &mut |index, state| {
            if index.is_multiple_of(1 << FINER) {
                fine_states.push(state.clone());
            }
            count();
        })?;
        if let Outcome::Failed { reason } = outcome {
            return Err(ConvergeError::FinerRun { steps, reason });
        }
    }
    let mut levels = Vec::new();
    for level in grids.levels.clone() {
        let steps = steps_of(level)?;
        let on_grid = scenario.in_steps(steps);
        let stride = 1_usize << (finest - level);
        let mut errors = ReferenceErrors::default();
        let early = from * (1.0 - 1e-12);
        let outcome = run_on(&on_grid, stop, &mut |index, state| {
            count();
            if state.time < early {
                return;
            }
            let row = known_at(&on_grid, index, fine_states.get(index * stride), known);
            errors.compare(state, &row);
        });
        let (seconds, failure) = match outcome {
            Ok(Outcome::Done { seconds }) => (seconds, None),
            Ok(Outcome::Failed { reason }) => (0.0, Some(reason)),
            Err(ConvergeError::Input(error)) => match error.problem() {
                problem @ Problem::Unstable { .. } => (0.0, Some(problem.to_string())),
                _ => return Err(ConvergeError::Input(error)),
            },
            Err(error) => return Err(error),
        };
        levels.push(Level { level, steps, step: on_grid.time.mean_step(), errors, seconds, failure });
    }
    let against = known.map(|known| match finer {
        Some(steps) if !known => ErrorReference::FinerRun(steps),
        _ => ErrorReference::Reference,
    });
    Ok(Convergence { against, levels })
}

/// Reference values at a grid point. `known` is true for the quantities that the scenario's reference
/// contains; the others are taken from the finer run.
fn known_at(scenario: &Scenario, index: usize, fine: Option<&GridState>, known: [bool; 3]) -> ReferenceRow {
    let coordinates = scenario.coordinates();
    let nothing = || ReferenceRow {
        time: scenario.time.time(index),
        position: vec![None; coordinates],
        momentum: vec![None; coordinates],
        energy: None,
        undefined: 0,
    };
    let reference = scenario.reference.as_ref();
    let mut row = reference
        .and_then(|reference| reference.at_grid_point(index, &scenario.time, coordinates))
        .unwrap_or_else(nothing);
    if let Some(fine) = fine {
        let list = |numbers: &[f64]| numbers.iter().map(|&number| Some(number)).collect();
        let [position, momentum, energy] = known;
        if !position {
            row.position = list(&fine.position);
        }
        if !momentum {
            row.momentum = list(&fine.momentum);
        }
        if !energy {
            row.energy = Some(fine.energy);
        }
    }
    row
}

/// Runs a scenario without load cases in double precision; `take` receives the index and the state of every
/// grid point, from the first one on.
///
/// # Errors
/// [`ConvergeError`]. A failing step is not an error here but an [`Outcome`].
pub fn run_on(
    scenario: &Scenario,
    stop: &AtomicBool,
    take: &mut dyn FnMut(usize, &GridState),
) -> Result<Outcome, ConvergeError> {
    scenario.check_use(Feature::OneMotion)?;
    let mut motion = Motion::start(scenario, Precision::F64)?;
    take(0, motion.state());
    let mut seconds = 0.0;
    while !motion.is_done() {
        if stop.load(Ordering::Relaxed) {
            return Err(ConvergeError::Stopped);
        }
        let (made, begin) = (motion.steps(), Instant::now());
        let result = motion.advance();
        seconds += begin.elapsed().as_secs_f64();
        if motion.steps() > made {
            take(motion.steps(), motion.state());
        }
        if let Err(Failure { step, reason, .. }) = result {
            return Ok(Outcome::Failed { reason: format!("step {step}: {reason}") });
        }
    }
    Ok(Outcome::Done { seconds })
}

impl Convergence {
    /// Step size and largest error of a quantity for each level with an error other than zero.
    pub fn points(&self, quantity: Quantity) -> Vec<(f64, f64)> {
        let usable = |level: &&Level| level.failure.is_none() && quantity.of(&level.errors).compared > 0;
        self.levels
            .iter()
            .filter(usable)
            .map(|level| (level.step, quantity.of(&level.errors).largest))
            .filter(|&(_, error)| error > 0.0 && error.is_finite())
            .collect()
    }

    /// Largest error of a quantity on a level; `None` if the run failed or has nothing to be compared with.
    pub fn error(&self, index: usize, quantity: Quantity) -> Option<f64> {
        let level = self.levels.get(index).filter(|level| level.failure.is_none())?;
        let measured = quantity.of(&level.errors);
        (measured.compared > 0).then_some(measured.largest)
    }

    /// Order between a level and the one before it.
    pub fn order(&self, index: usize, quantity: Quantity) -> Option<f64> {
        let usable = |level: &&Level| level.failure.is_none() && quantity.of(&level.errors).compared > 0;
        let point = |level: &Level| (level.step, quantity.of(&level.errors).largest);
        let fine = self.levels.get(index).filter(usable)?;
        let coarse = self.levels.get(index.checked_sub(1)?).filter(usable)?;
        order_between(point(coarse), point(fine))
    }

    /// Slope of the line of least squares through all points of a quantity.
    pub fn slope(&self, quantity: Quantity) -> Option<f64> {
        slope(&self.points(quantity))
    }

    /// Warning about values of the reference that are not finite.
    pub fn warning(&self) -> Option<String> {
        self.levels.iter().rev().find_map(|level| level.errors.warning())
    }

    /// The table as text, for a terminal.
    pub fn table(&self) -> String {
        let mut text = format!("{:>5} {:>9} {:>11}", "level", "steps", "h");
        for quantity in Quantity::ALL {
            text += &format!(" {:>11} {:>6}", quantity.name(), "order");
        }
        text += &format!(" {:>9}\n", "seconds");
        for (index, level) in self.levels.iter().enumerate() {
            text += &format!("{:>5} {:>9} {:>11.4e}", level.level, level.steps, level.step);
            if let Some(failure) = &level.failure {
                text += &format!("  {failure}\n");
                continue;
            }
            for quantity in Quantity::ALL {
                let measure = quantity.of(&level.errors);
                let error =
                    if measure.compared > 0 { format!("{:.4e}", measure.largest) } else { "-".into() };
                let order = self.order(index, quantity).map_or("-".into(), |order| format!("{order:.3}"));
                text += &format!(" {error:>11} {order:>6}");
            }
            text += &format!(" {:>9.2e}\n", level.seconds);
        }
        text += &format!("{:>27}", "slope");
        for quantity in Quantity::ALL {
            let slope = self.slope(quantity).map_or("-".into(), |slope| format!("{slope:.3}"));
            text += &format!(" {:>11} {slope:>6}", "");
        }
        text.push('\n');
        for (quantity, against) in Quantity::ALL.into_iter().zip(self.against) {
            if let ErrorReference::FinerRun(steps) = against {
                text += &format!("{} against a run of {steps} steps\n", quantity.name());
            }
        }
        text
    }

    /// The table as CSV; empty cells where nothing is known.
    pub fn csv(&self) -> String {
        let mut text = "level,steps,step".to_owned();
        for quantity in Quantity::ALL {
            text += &format!(",{0}_error,{0}_order", quantity.name());
        }
        text += ",seconds,failure\n";
        for (index, level) in self.levels.iter().enumerate() {
            text += &format!("{},{},{:?}", level.level, level.steps, level.step);
            for quantity in Quantity::ALL {
                let measure = quantity.of(&level.errors);
                let known = measure.compared > 0 && level.failure.is_none();
                let error = if known { format!("{:?}", measure.largest) } else { String::new() };
                let order =
                    self.order(index, quantity).map_or_else(String::new, |order| format!("{order:?}"));
                text += &format!(",{error},{order}");
            }
            let failure = level.failure.as_deref().unwrap_or("").replace('"', "'");
            let failure = if failure.is_empty() { failure } else { format!("\"{failure}\"") };
            text += &format!(",{:?},{failure}\n", level.seconds);
        }
        text
    }

    /// Errors over step sizes on logarithmic axes, with slopes to compare with.
    #[cfg(feature = "pictures")]
    pub fn chart(&self, scenario: &Scenario) -> Chart {
        let subtitle = format!("{}; {}", scenario.scheme.describe(), scenario.convolution.describe());
        let mut chart = Chart::new(
            scenario.heading(),
            Axis::logarithmic("step size h").in_units(&scenario.output.appearance.units.time),
            Axis::logarithmic("largest error"),
        )
        .on_paper(scenario.output.appearance.paper)
        .with_subtitle(subtitle);
        let mut orders: Vec<(i64, (f64, f64))> = Vec::new();
        for quantity in Quantity::ALL {
            let points = self.points(quantity);
            let (Some(slope), Some(&(h, error))) = (self.slope(quantity), points.first()) else { continue };
            let label = format!("{} (slope {slope:.2})", quantity.name());
            chart = chart.with(Series::new(label, Style::LineWithPoints, points.clone()));
            // A guide half a decade below the lowest of the curves that share it.
            let order = slope.round() as i64;
            match orders.iter_mut().find(|(other, _)| *other == order) {
                Some((_, place)) if place.1 > error * 0.3 => *place = (h, error * 0.3),
                Some(_) => {}
                None => orders.push((order, (h, error * 0.3))),
            }
        }
        let finest = self.levels.last().map_or(1.0, |level| level.step);
        for (order, through) in orders.into_iter().filter(|(order, _)| *order >= 1) {
            chart = chart.with(Series::slope(power("h", order), order as f64, through, through.0, finest));
        }
        chart
    }
}

/// Order log(e₁/e₂)/log(h₁/h₂) between two step sizes with their errors, the coarse one first.
pub fn order_between(coarse: (f64, f64), fine: (f64, f64)) -> Option<f64> {
    let order = libm::log2(coarse.1 / fine.1) / libm::log2(coarse.0 / fine.0);
    order.is_finite().then_some(order)
}

/// Slope of the line of least squares through the logarithms of step sizes and errors.
pub fn slope(points: &[(f64, f64)]) -> Option<f64> {
    let points: Vec<(f64, f64)> = points.iter().map(|&(h, error)| (libm::log(h), libm::log(error))).collect();
    let count = points.len() as f64;
    let mean = |select: fn(&(f64, f64)) -> f64| points.iter().map(select).sum::<f64>() / count;
    let (x, y) = (mean(|point| point.0), mean(|point| point.1));
    let covariance: f64 = points.iter().map(|point| (point.0 - x) * (point.1 - y)).sum();
    let variance: f64 = points.iter().map(|point| (point.0 - x).powi(2)).sum();
    Some(covariance / variance).filter(|slope| slope.is_finite())
}
