//! `scheme.kind = "auto"`: scheme, grid and step from a tolerance, by short runs before the run.

use super::{Run, RunEnd, RunError};
use crate::results::rows::Rows;
use fvi_core::min_or_nan;
use fvi_fft::memory::Tables;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Automatic, Candidate, Fineness, KnownMatrices, Method, Scenario, Spread};
use fvi_simulation::simulation::Precision;
use serde::Serialize;
use std::sync::atomic::AtomicBool;

/// The error that a number of steps is chosen for, and the largest estimate that is accepted, as parts of the
/// tolerance.
const AIM: f64 = 0.3;
const ACCEPTED: f64 = 0.7;

/// Coordinates smaller than this part of the largest one are measured as if they were so large.
const SMALL: f64 = 1e-3;

/// Fewest steps of a run that is compared.
const FEWEST: usize = 32;

/// Number of rows of the file from which on two runs are enough to see that their steps resolve the motion.
const MANY_ROWS: usize = 512;

/// The lowest order at which errors count as shrinking.
const LOWEST_ORDER: f64 = 0.8;

/// Difference of two runs, relative to the motion, from which on the next number of steps is told.
const RESOLVED: f64 = 0.05;

/// Difference that is rounding's, below which runs do not come closer.
const ROUNDING: f64 = 1e-9;

/// Largest cost of a run: steps times [`Candidate::cost`].
const LARGEST_COST: f64 = 1e7;

/// By how many times steps are made shorter while runs fail.
const MOST_FAILED: usize = 4096;

/// Number of runs, all short, in which a candidate is tried: the preparation of so many is what that costs at
/// least.
const RUNS_OF_A_TRIAL: f64 = 4.0;

/// By how many times more steps may be told from an order that is not the scheme's own.
const TOLD_AT_MOST: f64 = 4.0;

/// Number of times that steps are made shorter after they have been told.
const ATTEMPTS: usize = 4;

/// Adaptive steps are relative to positions of the size one at least. A motion that stays below is made again
/// relative to its own size, up to so many times, since the first run is coarse there.
const MOST_SCALES: usize = 4;

/// The smallest tolerance of adaptive steps.
const SMALLEST_OF_STEPS: f64 = 1e-12;

/// What has been chosen for a scenario with `scheme.kind = "auto"`, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Choice {
    /// ε, see [`Automatic`].
    pub tolerance: f64,
    /// Scheme, convolution quadrature and grid.
    pub chosen: String,
    /// Estimate of the largest error of the rows, measured as the tolerance is.
    pub estimated_error: f64,
    /// How the estimate was made.
    pub because: String,
    /// The candidates that were tried before, each with what came of it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub others: Vec<String>,
}

impl Choice {
    /// The choice in a line.
    pub fn note(&self) -> String {
        let Self { tolerance, chosen, estimated_error, because, .. } = self;
        format!(
            "for a tolerance of {tolerance:e}: {chosen}; estimated error {estimated_error:.1e}: {because}"
        )
    }
}

/// A scenario with its scheme.
#[derive(Clone, Debug)]
pub struct Chosen {
    /// The scenario, with scheme, convolution, grid and step as if its file had named them.
    pub scenario: Scenario,
    /// The record of the choice.
    pub choice: Choice,
}

/// Chooses scheme, grid and step of a scenario that asks for a tolerance.
///
/// Candidates that the table of combinations allows are run on few steps, then on twice as many, until their
/// errors shrink at an order p. With d the largest difference of the rows of n and n/2 steps the error is
/// d/(2ᵖ − 1) if p is the order of the scheme (less one with damping), and d otherwise; from it follow the
/// steps for the tolerance and their cost. The cheapest candidate is run with these steps and half of them,
/// and taken if that difference confirms the estimate; otherwise steps are made shorter, and last the
/// candidates are tried that seemed to cost more. Adaptive steps are compared with those of a tenth of their
/// tolerance. Only numbers of steps decide and no clock, so that a scenario leads to the same choice, and to
/// the same bits, every time.
///
/// # Errors
/// [`RunError::Input`] at `scheme.tolerance`, with what is reachable, if no candidate reaches it; if no
/// candidate can be run, with the reason. [`RunError::Stopped`].
pub fn choose(
    scenario: &Scenario,
    precision: Precision,
    tables: &Tables,
    stop: &AtomicBool,
) -> Result<Chosen, RunError> {
    let Some(automatic) = scenario.automatic else {
        let problem = Problem::MissingKey { key: "tolerance".to_owned() };
        return Err(scenario.error_at("scheme", problem).into());
    };
    let known = KnownMatrices::default();
    let mut search = Search {
        scenario,
        automatic,
        pilots: Pilots { precision, tables, known: &known, stop },
        others: Vec::new(),
        refused: None,
        least: f64::INFINITY,
    };
    let mut left = Candidate::of(scenario);
    while !left.is_empty() {
        let mut told: Vec<Told> = Vec::new();
        let mut untried: Vec<Candidate> = Vec::new();
        for candidate in std::mem::take(&mut left) {
            let cheapest = told.iter().map(Told::cost).fold(f64::INFINITY, min_or_nan);
            // What it could save at most is less than what trying it costs.
            let is_needless = cheapest <= RUNS_OF_A_TRIAL * candidate.preparation();
            if is_needless || told.iter().any(|told| told.is_clean) {
                untried.push(candidate);
                continue;
            }
            match search.tell(candidate, cheapest)? {
                Trial::Told(next) => told.push(next),
                Trial::Dearer => untried.push(candidate),
                Trial::Useless => {}
            }
        }
        told.sort_by(|one, other| one.cost().total_cmp(&other.cost()));
        for told in told {
            let found = match told.fineness {
                Fineness::Steps(_) => search.confirm_steps(told)?,
                Fineness::Tolerance { .. } => search.confirm_tolerance(told)?,
            };
            if let Some(chosen) = found {
                return Ok(chosen);
            }
        }
        left = untried;
    }
    Err(search.unreachable().into())
}

/// The runs that are compared.
#[derive(Clone, Copy)]
struct Pilots<'a> {
    precision: Precision,
    tables: &'a Tables,
    known: &'a KnownMatrices,
    stop: &'a AtomicBool,
}

/// The rows of a run.
#[derive(Clone)]
struct Pilot {
    rows: Vec<Rows>,
    steps: usize,
}

impl Pilot {
    fn largest_position(&self) -> f64 {
        let all = self.rows.iter().flat_map(|rows| &rows.position);
        all.fold(0.0, |largest, position| max_or_nan(largest, position.abs()))
    }
}

/// A run takes more steps than any that would be chosen.
struct TooMany;

/// Why there are no rows to compare.
enum NoRows {
    /// The candidate does not go with the scenario.
    Refused(InputError),
    /// Steps are too long, or fail.
    Failed(String),
    /// Motions grow with steps of more than this length; without it, with any.
    Unstable(Option<f64>, String),
}

/// What came of trying a candidate.
enum Trial {
    Told(Told),
    /// It costs more than another one.
    Dearer,
    Useless,
}

/// Jumps and kinks of forces inside steps: two runs may agree by chance, so that errors count as at least
/// those that the largest difference so far leaves at the order at which they are sure to shrink.
#[derive(Clone, Copy)]
struct Breaks {
    order: Option<f64>,
    /// The largest of all differences, each times its number of steps to the power of the order.
    largest: f64,
}

impl Breaks {
    fn of(scenario: &Scenario) -> Self {
        Self { order: scenario.order_at_breaks(), largest: 0.0 }
    }

    fn take(&mut self, difference: f64, steps: usize) {
        // Steps that do not resolve the motion tell nothing of breaks at times; of those in the position they
        // may be the only ones that do not agree by chance.
        if let Some(order) = self.order.filter(|&order| order <= 1.0 || difference < RESOLVED) {
            self.largest = max_or_nan(self.largest, difference * libm::pow(steps as f64, order));
        }
    }

    /// The least error that counts for this number of steps.
    fn floor(self, steps: usize) -> f64 {
        self.order.map_or(0.0, |order| self.largest / libm::pow(steps as f64, order))
    }
}

/// The fineness that a candidate is told to need.
struct Told {
    candidate: Candidate,
    fineness: Fineness,
    /// Number of steps.
    steps: usize,
    /// The order at which errors shrink.
    order: f64,
    /// True if that is the scheme's own.
    is_clean: bool,
    breaks: Breaks,
    /// The finest run so far.
    finest: Option<(usize, Pilot)>,
    /// Its error, if the difference that tells it is known.
    error: Option<f64>,
}

impl Told {
    fn cost(&self) -> f64 {
        // Grid points at rows are added to graded steps.
        let made = self.finest.as_ref().map_or(0, |(_, pilot)| pilot.steps);
        self.candidate.cost(self.steps.max(made))
    }
}

struct Search<'a> {
    scenario: &'a Scenario,
    automatic: Automatic,
    pilots: Pilots<'a>,
    others: Vec<String>,
    /// Why one was refused, for a reason that has to do with numbers of the scenario.
    refused: Option<InputError>,
    /// The smallest error that was estimated.
    least: f64,
}

impl Pilots<'_> {
    /// The rows of a run whose steps have this cost.
    fn rows(&self, scenario: &Scenario, cost: f64) -> Result<Result<Pilot, NoRows>, RunError> {
        let run = Run::of(scenario).precision(self.precision).tables(self.tables).start();
        let mut run = match run {
            Ok(run) => run,
            Err(error) => {
                return Ok(Err(match error.problem() {
                    &Problem::Unstable { largest_step, .. } => {
                        NoRows::Unstable(largest_step, error.problem().to_string())
                    }
                    _ => NoRows::Refused(error),
                }));
            }
        };
        let mut rows = match Rows::of_cases(scenario) {
            Ok(rows) => rows,
            Err(error) => return Ok(Err(NoRows::Failed(error.to_string()))),
        };
        let driven = run.drive(self.stop, |portion| {
            // Steps that shrink without end, as before a motion that is not finite.
            if portion.batch().first() as f64 * cost > LARGEST_COST && scenario.time.adaptive().is_some() {
                return Err(TooMany);
            }
            portion.keep(&mut rows);
            Ok(())
        });
        let Ok(end) = driven else { return Ok(Err(NoRows::Failed("takes too many steps".to_owned()))) };
        // A force that the nodes miss would be missed by twice as many steps, too.
        if let Some(note) = run.motion.notes().into_iter().next() {
            return Ok(Err(NoRows::Failed(note)));
        }
        match end {
            RunEnd::Completed | RunEnd::Event { .. } => Ok(Ok(Pilot { rows, steps: run.steps() })),
            RunEnd::Stopped => Err(RunError::Stopped),
            RunEnd::Failed { time, reason, .. } => {
                Ok(Err(NoRows::Failed(format!("at t = {time}: {reason}"))))
            }
        }
    }
}

impl Search<'_> {
    fn pilot(&mut self, candidate: Candidate, fineness: Fineness) -> Result<Result<Pilot, NoRows>, RunError> {
        match self.scenario.on_candidate(candidate, fineness, (self.pilots.known, true)) {
            Ok(scenario) => self.pilots.rows(&scenario, candidate.cost_of_step()),
            Err(error) => Ok(Err(NoRows::Refused(error))),
        }
    }

    /// Takes down why a candidate is not used.
    fn put_aside(&mut self, candidate: Candidate, why: NoRows) {
        let reason = match why {
            NoRows::Failed(reason) | NoRows::Unstable(_, reason) => reason,
            NoRows::Refused(error) => {
                let reason = format!("{}: {}", error.key(), error.problem());
                let general = |error: &InputError| !matches!(error.problem(), Problem::Incompatible { .. });
                if self.refused.is_none() && general(&error) {
                    self.refused = Some(error);
                }
                reason
            }
        };
        self.others.push(format!("{}: {reason}", name(candidate)));
    }

    /// The steps that a candidate needs for the tolerance, unless it is of no use, or is seen to cost more
    /// than another one.
    fn tell(&mut self, candidate: Candidate, cheapest: f64) -> Result<Trial, RunError> {
        if candidate.steps == Spread::Adaptive {
            return self.tell_adaptive(candidate);
        }
        let rows = self.automatic.rows().filter(|_| candidate.steps == Spread::Equal);
        let first = rows.unwrap_or(FEWEST);
        let of_step = candidate.cost_of_step();
        let most = LARGEST_COST.max(8.0 * first as f64 * of_step) / of_step;
        let worthwhile = (0.5 * cheapest - candidate.preparation()) / of_step;
        let (is_cut, most) = (worthwhile < most, most.min(worthwhile));
        let own = own_order(self.scenario, candidate);
        let (mut before, mut differences): (Option<Pilot>, Vec<f64>) = (None, Vec::new());
        let (mut steps, mut last_failure) = (first, None);
        let mut breaks = Breaks::of(self.scenario);
        while steps as f64 <= most {
            let pilot = match self.pilot(candidate, Fineness::Steps(steps))? {
                Ok(pilot) => pilot,
                Err(NoRows::Unstable(Some(longest), reason)) if candidate.steps == Spread::Equal => {
                    (before, last_failure) = (None, Some(reason));
                    differences.clear();
                    let needed = (self.automatic.length() / longest / first as f64).ceil();
                    if needed * first as f64 > most {
                        break;
                    }
                    steps = (2 * steps).max(first * (needed as usize).next_power_of_two());
                    continue;
                }
                Err(NoRows::Failed(reason) | NoRows::Unstable(Some(_), reason)) => {
                    (before, last_failure) = (None, Some(reason));
                    if steps > first.saturating_mul(MOST_FAILED) {
                        break;
                    }
                    differences.clear();
                    steps *= 2;
                    continue;
                }
                Err(refused) => {
                    self.put_aside(candidate, refused);
                    return Ok(Trial::Useless);
                }
            };
            if let Some(difference) = before.as_ref().and_then(|before| self.difference(before, &pilot)) {
                differences.push(difference);
                breaks.take(difference, steps);
            }
            let order = shrinking(&differences, own).or_else(|| {
                let few = steps / 2 >= MANY_ROWS && differences.len() == 1;
                (few && differences[0] <= 0.5 * ACCEPTED * self.automatic.tolerance).then_some(1.0)
            });
            let difference = differences.last().copied();
            if let (Some(order), Some(difference)) = (order, difference) {
                let (order, is_clean) = self.trusted(order, own);
                let error = max_or_nan(estimate(difference, order, is_clean), breaks.floor(steps));
                self.least = self.least.min(error);
                let coarse = max_or_nan(error + difference, breaks.floor(steps / 2));
                let finest = Some((steps, pilot.clone()));
                let told = |steps, error| {
                    let fineness = Fineness::Steps(steps);
                    Told { candidate, fineness, steps, order, is_clean, breaks, finest, error }
                };
                let accepted = ACCEPTED * self.automatic.tolerance;
                if coarse <= accepted {
                    return Ok(Trial::Told(told(steps / 2, Some(coarse))));
                }
                if error <= accepted {
                    return Ok(Trial::Told(told(steps, Some(error))));
                }
                if difference < RESOLVED {
                    let needed = steps as f64 * self.factor(error, order);
                    if needed > most {
                        break;
                    }
                    // A short run is made twice as long as soon as another one is prepared.
                    let is_long = steps as f64 * of_step > candidate.preparation();
                    if is_clean || (is_long && needed <= TOLD_AT_MOST * steps as f64) {
                        return Ok(Trial::Told(told(in_multiples(needed, first, steps), None)));
                    }
                }
            }
            let stalls = differences.len() > 2 && order.is_none() && difference < Some(ROUNDING);
            if stalls {
                break;
            }
            before = Some(pilot);
            steps *= 2;
        }
        if is_cut {
            return Ok(Trial::Dearer);
        }
        let reason = last_failure.filter(|_| differences.is_empty());
        let reason = reason.unwrap_or_else(|| match differences.last() {
            Some(difference) => {
                format!("runs of {steps} steps and half of them still differ by {difference:.1e}")
            }
            None => "costs more".to_owned(),
        });
        self.put_aside(candidate, NoRows::Failed(reason));
        Ok(Trial::Useless)
    }

    fn tell_adaptive(&mut self, candidate: Candidate) -> Result<Trial, RunError> {
        let of = self.automatic.tolerance.max(SMALLEST_OF_STEPS);
        let mut scale = 1.0;
        for _ in 0..MOST_SCALES {
            let fineness = Fineness::Tolerance { of, scale };
            let pilot = match self.pilot(candidate, fineness)? {
                Ok(pilot) => pilot,
                Err(why) => {
                    self.put_aside(candidate, why);
                    return Ok(Trial::Useless);
                }
            };
            let size = pilot.largest_position();
            if size > 0.0 && size < 0.5 * scale {
                // A power of two, so that a choice in other units is the same.
                scale = libm::exp2(libm::floor(libm::log2(size)));
                continue;
            }
            let steps = pilot.steps;
            let finest = Some((steps, pilot));
            return Ok(Trial::Told(Told {
                candidate,
                fineness,
                steps,
                order: 1.0,
                is_clean: false,
                breaks: Breaks::of(self.scenario),
                finest,
                error: None,
            }));
        }
        let reason = "the size of its positions changes with the tolerance of its steps".to_owned();
        self.put_aside(candidate, NoRows::Failed(reason));
        Ok(Trial::Useless)
    }

    /// The order by which errors are told from differences that shrink at this one, with a scheme of its own
    /// order, and whether they are less than the differences.
    fn trusted(&self, order: f64, own: f64) -> (f64, bool) {
        let breaks = self.scenario.order_at_breaks();
        let is_clean = order >= own - 1.0 && breaks.is_none() && !self.scenario.shows_singular_start();
        match is_clean && !self.scenario.system.damping.is_empty() {
            // What the singular start leaves shrinks more slowly, and shows later.
            true => (order - 1.0, true),
            false => (breaks.map_or(order, |breaks| min_or_nan(order, breaks)), is_clean),
        }
    }

    /// By how much the number of steps grows for the error that is aimed at.
    fn factor(&self, error: f64, order: f64) -> f64 {
        libm::pow(error / (AIM * self.automatic.tolerance), 1.0 / order).max(1.2)
    }

    /// The largest difference of two runs at the rows that both have; `None` if there are none.
    fn difference(&self, coarse: &Pilot, fine: &Pilot) -> Option<f64> {
        let momenta = self.scenario.equation.is_none();
        let pairs = coarse.rows.iter().zip(&fine.rows);
        let all = pairs.filter_map(|(coarse, fine)| difference(coarse, fine, momenta));
        all.reduce(max_or_nan).map(|most| if most.is_nan() { f64::INFINITY } else { most })
    }

    /// Runs a candidate with the steps that it was told to need, and half of them.
    fn confirm_steps(&mut self, told: Told) -> Result<Option<Chosen>, RunError> {
        let Told { candidate, mut steps, order, is_clean, mut breaks, finest, error, .. } = told;
        if let Some(error) = error {
            let because = format!(
                "runs with half and twice as many steps, whose differences shrink at order {order:.1}, tell the error"
            );
            return self.chosen(candidate, Fineness::Steps(steps), (error, because)).map(Some);
        }
        let first = self.automatic.rows().filter(|_| candidate.steps == Spread::Equal).unwrap_or(FEWEST);
        let mut known = finest;
        let mut before = f64::INFINITY;
        for _ in 0..ATTEMPTS {
            let half = match known.take().filter(|(of, _)| *of == steps / 2) {
                Some((_, pilot)) => Ok(pilot),
                None => self.pilot(candidate, Fineness::Steps(steps / 2))?,
            };
            let (half, whole) = match (half, self.pilot(candidate, Fineness::Steps(steps))?) {
                (Ok(half), Ok(whole)) => (half, whole),
                (Err(why), _) | (_, Err(why)) => {
                    self.put_aside(candidate, why);
                    return Ok(None);
                }
            };
            let Some(difference) = self.difference(&half, &whole) else { return Ok(None) };
            breaks.take(difference, steps);
            let error = max_or_nan(estimate(difference, order, is_clean), breaks.floor(steps));
            self.least = self.least.min(error);
            if error <= ACCEPTED * self.automatic.tolerance {
                let because = format!(
                    "a run with half as many steps differs by {difference:.1e}, and errors shrink at order {order:.1}"
                );
                return self.chosen(candidate, Fineness::Steps(steps), (error, because)).map(Some);
            }
            if error >= before {
                break;
            }
            before = error;
            let needed = steps as f64 * self.factor(error, order);
            if needed * candidate.cost_of_step() > LARGEST_COST {
                break;
            }
            known = Some((steps, whole));
            steps = in_multiples(needed, first, steps);
        }
        let reason = format!("with {steps} steps its error is {before:.1e}, and shorter steps do not help");
        self.put_aside(candidate, NoRows::Failed(reason));
        Ok(None)
    }

    /// Compares adaptive steps with those of a tenth of their tolerance.
    fn confirm_tolerance(&mut self, told: Told) -> Result<Option<Chosen>, RunError> {
        let Told { candidate, finest, fineness, .. } = told;
        let Fineness::Tolerance { scale, .. } = fineness else { return Ok(None) };
        let mut tolerance = self.automatic.tolerance.max(SMALLEST_OF_STEPS);
        let Some((_, mut coarse)) = finest else { return Ok(None) };
        let mut least = f64::INFINITY;
        while tolerance > SMALLEST_OF_STEPS {
            let finer = (0.1 * tolerance).max(SMALLEST_OF_STEPS);
            let fine = match self.pilot(candidate, Fineness::Tolerance { of: finer, scale })? {
                Ok(fine) => fine,
                Err(why) => {
                    self.put_aside(candidate, why);
                    return Ok(None);
                }
            };
            let Some(difference) = self.difference(&coarse, &fine) else { return Ok(None) };
            // What the finer run lacks is a part of the difference.
            let error = 1.1 * difference;
            (self.least, least) = (self.least.min(error), least.min(error));
            if error <= ACCEPTED * self.automatic.tolerance {
                let because =
                    format!("a run with {finer:.0e} as tolerance of its steps differs by {difference:.1e}");
                let fineness = Fineness::Tolerance { of: tolerance, scale };
                return self.chosen(candidate, fineness, (error, because)).map(Some);
            }
            (tolerance, coarse) = (finer, fine);
        }
        let reason = format!("its runs still differ by {least:.1e}");
        self.put_aside(candidate, NoRows::Failed(reason));
        Ok(None)
    }

    fn chosen(
        &mut self,
        candidate: Candidate,
        fineness: Fineness,
        (estimated_error, because): (f64, String),
    ) -> Result<Chosen, RunError> {
        let scenario = self.scenario.on_candidate(candidate, fineness, (self.pilots.known, false))?;
        let chosen = format!(
            "{}; {}; {}",
            scenario.scheme.describe(),
            scenario.convolution.describe(),
            scenario.time.describe()
        );
        let tolerance = self.automatic.tolerance;
        let others = std::mem::take(&mut self.others);
        Ok(Chosen { scenario, choice: Choice { tolerance, chosen, estimated_error, because, others } })
    }

    /// No candidate reaches the tolerance.
    fn unreachable(self) -> InputError {
        let tried = self.others.join("; ");
        match (self.refused, self.least.is_finite()) {
            (Some(error), false) => error,
            (_, true) => {
                // Two digits, not rounded down.
                let allowed = format!(
                    "a tolerance from about {:.1e} on, the smallest error that was reached ({tried})",
                    1.05 * self.least / ACCEPTED
                );
                self.scenario.error_at("scheme.tolerance", Problem::OutOfRange { allowed })
            }
            (_, false) => {
                let reason = format!("no scheme that goes with this scenario comes to an error: {tried}");
                self.scenario.error_at("scheme.kind", Problem::Unusable { reason })
            }
        }
    }
}

/// The order of a candidate for smooth motions.
fn own_order(scenario: &Scenario, candidate: Candidate) -> f64 {
    let order = match candidate.method {
        Method::Midpoint => 2,
        Method::Galerkin { degree, .. } if scenario.system.damping.is_empty() => 2 * degree,
        Method::Galerkin { degree, order } => order.min(2 * degree),
        Method::Gauss { degree } => 2 * degree,
        Method::Radau { stages } => 2 * stages - 1,
    };
    order as f64
}

/// The error of a run that differs so much from one with half as many steps: d/(2ᵖ − 1). Where p is not the
/// order of the scheme, a kink or a singularity may lie better in one of the grids than in the other, and the
/// whole difference counts.
fn estimate(difference: f64, order: f64, is_clean: bool) -> f64 {
    if is_clean { difference / (libm::exp2(order) - 1.0) } else { difference }
}

/// The order at which the last two differences shrink, at most the scheme's own; `None` if they do not.
fn shrinking(differences: &[f64], own: f64) -> Option<f64> {
    let &[.., before, last] = differences else { return None };
    let order = libm::log2(before / last).min(own);
    match last == 0.0 {
        true => Some(own),
        false => Some(order).filter(|&order| order >= LOWEST_ORDER && before.is_finite()),
    }
}

/// A number of steps that is an even multiple of the first one, at least twice as many as `steps` or, where
/// the half of it is another one, as needed.
fn in_multiples(needed: f64, first: usize, steps: usize) -> usize {
    if needed <= 2.0 * steps as f64 {
        return 2 * steps;
    }
    let unit = 2 * first;
    (needed / unit as f64).ceil() as usize * unit
}

fn name(candidate: Candidate) -> String {
    let method = match candidate.method {
        Method::Midpoint => "midpoint rule".to_owned(),
        Method::Galerkin { degree, order } => format!("Galerkin of degree {degree} with BDF {order}"),
        Method::Gauss { degree } => format!("Galerkin of degree {degree} with Gauss weights"),
        Method::Radau { stages } => format!("collocation of {stages} stages"),
    };
    let steps = match candidate.steps {
        Spread::Equal => "equal",
        Spread::Graded { .. } => "graded",
        Spread::Adaptive => "adaptive",
    };
    format!("{method} on {steps} steps")
}

/// Largest difference of positions and momenta, each relative to the size of its coordinate, at the times
/// that two runs have in common; `None` if there is none but the first.
fn difference(coarse: &Rows, fine: &Rows, momenta: bool) -> Option<f64> {
    let mut common: Vec<(usize, usize)> = Vec::new();
    let mut place = 0;
    for (index, &time) in coarse.time.iter().enumerate() {
        let same = |other: f64| (other - time).abs() <= 1e-9 * time.abs();
        while fine.time.get(place).is_some_and(|&other| other < time && !same(other)) {
            place += 1;
        }
        if fine.time.get(place).is_some_and(|&other| same(other)) {
            common.push((index, place));
        }
    }
    if common.len() < 2 {
        return None;
    }
    let width = coarse.coordinates;
    let positions = relative(&coarse.position, &fine.position, width, &common);
    let momenta = if momenta { relative(&coarse.momentum, &fine.momentum, width, &common) } else { 0.0 };
    Some(max_or_nan(positions, momenta))
}

/// The largest difference of columns at these pairs of rows, each relative to the largest number of its
/// column, or to [`SMALL`] of that of all columns if that is larger.
fn relative(coarse: &[f64], fine: &[f64], width: usize, common: &[(usize, usize)]) -> f64 {
    let mut largest = vec![0.0; width];
    for row in fine.chunks_exact(width.max(1)) {
        for (largest, number) in largest.iter_mut().zip(row) {
            *largest = max_or_nan(*largest, number.abs());
        }
    }
    let least = SMALL * largest.iter().copied().fold(0.0, max_or_nan);
    let mut most = 0.0;
    for &(one, other) in common {
        for (column, &largest) in largest.iter().enumerate() {
            let apart = (coarse[one * width + column] - fine[other * width + column]).abs();
            if apart != 0.0 {
                most = max_or_nan(most, apart / max_or_nan(largest, least));
            }
        }
    }
    most
}

#[cfg(test)]
mod tests;
