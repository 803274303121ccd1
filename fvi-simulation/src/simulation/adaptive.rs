//! Steps chosen during the run, so that the error stays near a tolerance.

use super::breaks::Breaks;
use super::crossings::{CrossingState, Crossings, Verdict};
use super::error_budget::ErrorBudget;
use super::function_jumps::FunctionJumps;
use super::perturbed::Perturbed;
use super::step_control::StepControl;
use super::velocity_kinks::VelocityKinks;
use super::{GridState, Precision, Simulation};
use crate::model::Model;
use fvi_core::{Instant, Mechanics, MemoryError, StateError, StepError, max_or_nan, min_or_nan};
use fvi_fft::memory::Tables;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Adaptive, Scenario, Term};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, TAU};

/// The first attempt without other information, as a fraction of the end, times √tolerance.
const FIRST: f64 = 1e-3;

/// The shortest step in single precision, as a fraction of the end.
const SHORTEST_IN_SINGLE: f64 = 1e-30;

/// Growth from which on a solution that no step continues counts as unbounded.
const UNBOUNDED: f64 = 1e6;

/// Multiple of the tolerance within which errors are to stay.
const ALLOWED: f64 = 10.0;

/// A tolerance that passes a step, as a multiple of the one that its best attempt would just have kept: with
/// it an equation may be solved with fewer stages. And the largest that is named.
const MARGIN: f64 = 10.0;
const LARGEST_NAMED: f64 = 0.1;

/// Largest number of attempts at one step.
const MOST_ATTEMPTS: usize = 60;

/// Where the polynomials of a pair are compared, as parts of its length: at several places, since one may lie
/// where their difference changes sign.
const LOOKS_INSIDE: [f64; 4] = [0.25, 0.5, 0.75, 0.875];

/// Least tolerance that the rounding of a start with infinite slopes leaves. Measured: a sixth root of what
/// begins at 0 keeps 10 digits.
const LEAST_BESIDE_INFINITE_SLOPES: f64 = 1e-11;

/// A warning about a start at which the slopes of an equation's right side are infinite, so that the rounding
/// of positions is magnified, if the tolerance is smaller than what that may leave.
pub(super) fn warning_of_start(scenario: &Scenario) -> Option<String> {
    let adaptive = scenario.time.adaptive().filter(|_| scenario.equation.is_some())?;
    if adaptive.tolerance >= LEAST_BESIDE_INFINITE_SLOPES {
        return None;
    }
    has_infinite_slopes(scenario).then(|| {
        format!(
            "time.tolerance = {:e}: slopes of the right side are infinite at the start, where differences of positions have few digits; \
             errors may be as if {LEAST_BESIDE_INFINITE_SLOPES:e} had been asked for",
            adaptive.tolerance
        )
    })
}

/// True if a quotient of differences of the right side at the start still grows when its step falls from 10⁻⁶
/// to 10⁻⁹ of the position: it would stay where there is a derivative.
fn has_infinite_slopes(scenario: &Scenario) -> bool {
    let Ok(mut model) = Model::<f64>::new(scenario) else { return false };
    let position = &scenario.initial.position;
    let instant = Instant::in_step(scenario.time.start, 0.0, 0.0);
    let mut value_at = |position: &Vec<f64>| {
        let mut restoring = vec![0.0; position.len()];
        model.restoring_force(instant, position, &mut restoring);
        restoring
    };
    let here = value_at(position);
    let mut slope = |part: f64| {
        let moved = |q: &f64| q + part * q.abs().max(1.0);
        let there = value_at(&position.iter().map(moved).collect());
        let differences = there.iter().zip(&here).map(|(there, here)| (there - here).abs() / part);
        differences.fold(0.0, max_or_nan)
    };
    let [far, near] = [1e-6, 1e-9].map(&mut slope);
    near > 3.0 * far && near > 1.0
}

/// Steps in pairs: two half steps, and the whole step for comparison with them.
///
/// The memory also makes both, so that its errors are part of the difference. The half steps are kept. After
/// an attempt with too large a difference the saved state is restored, bit by bit.
pub(crate) struct AdaptiveSteps<'s> {
    scenario: &'s Scenario,
    rule: Adaptive,
    breaks: Breaks,
    /// Jumps and kinks in the position, if there are any, kinks in the velocity, and jumps of forces in code.
    crossings: Option<Crossings>,
    velocity_kinks: Option<VelocityKinks>,
    function_jumps: Option<FunctionJumps>,
    progress: Progress,
    /// How perturbations grow; not known after a run has been continued.
    perturbed: Option<Perturbed>,
    /// Rounding unit of the precision, by which times are distinguished.
    epsilon: f64,
    /// Exponent of the part of a step in the whole time by which the error of a coordinate counts less: of
    /// an equation 1 − β for the further coordinates, which D^β moves and which forget the faster the smaller
    /// β is. Those that begin like t^β need not be followed from a start that no step resolves.
    forgetting: Vec<f64>,
    /// Reference size of each position and momentum.
    position_scale: Vec<f64>,
    momentum_scale: Vec<f64>,
    /// State before the pair, and between its halves.
    saved: Vec<u8>,
    saved_between: Vec<u8>,
    whole: GridState,
    end: GridState,
    /// The position where the pair begins.
    begin: Vec<f64>,
    /// States at [`LOOKS_INSIDE`] by the polynomials of the whole step and of its halves, if states inside
    /// steps are needed.
    inside: Option<[Vec<GridState>; 2]>,
    /// Weights of the differences of positions and momenta inside a step.
    share_inside: [f64; 2],
    /// Order of the error inside a step in its length.
    order_inside: f64,
    /// True if the simulation is at the end of the pair while its second half has not been returned yet.
    ahead: bool,
    /// Iterations of Newton's method in that half.
    iterations_ahead: u32,
}

/// State needed to continue in a later run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    control: StepControl,
    budget: ErrorBudget,
    /// Length and end of the second half of the current pair, if its first half has been returned.
    second: Option<(f64, f64)>,
    time: f64,
    /// Largest values so far of position and momentum.
    largest: [Vec<f64>; 2],
    pub(crate) counts: Counts,
    /// True if the next pair begins at a break.
    at_break: bool,
    standing: Option<CrossingState>,
    /// Σ |Δx| of each unknown of an equation.
    #[serde(default)]
    travelled: Vec<f64>,
}

impl Progress {
    /// The time of the state returned last.
    pub fn time(&self) -> f64 {
        self.time
    }
}

/// Counts of attempts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Counts {
    /// Rejected pairs of steps.
    pub rejected: usize,
    /// All attempted pairs of steps.
    pub attempts: usize,
    /// The shortest step made.
    pub smallest: f64,
    /// The longest step made.
    pub largest: f64,
}

/// A pair of equal steps that is attempted.
struct Pair {
    /// Time of its end.
    end: f64,
    /// True if that is a break known in advance, and if it is a jump or kink in the position.
    at_break: bool,
    at_crossing: bool,
}

/// What jumps and kinks make of an accurate pair.
enum Judged {
    /// It stands; true if it ends at a jump or kink in the position.
    Stands(bool),
    /// Another one is needed, up to an earlier time if there is one; and what for.
    Again(Option<f64>, &'static str),
}

impl<'s> AdaptiveSteps<'s> {
    /// `None` for a scenario with steps known in advance.
    ///
    /// # Errors
    /// If the tolerance cannot be reached in the precision.
    pub(crate) fn new(
        scenario: &'s Scenario,
        precision: Precision,
        simulation: &mut Simulation,
        start: &GridState,
    ) -> Result<Option<Self>, InputError> {
        let Some(&rule) = scenario.time.adaptive() else { return Ok(None) };
        let epsilon = precision.epsilon();
        let smallest = Adaptive::smallest_tolerance(epsilon);
        if rule.tolerance < smallest {
            let allowed =
                format!("at least {smallest:.1e} in single precision, whose rounding decides below");
            return Err(scenario.error_at("time.tolerance", Problem::OutOfRange { allowed }));
        }
        if precision == Precision::F32 && rule.shortest < SHORTEST_IN_SINGLE * rule.end {
            let allowed = format!(
                "at least {:.1e} in single precision, whose range ends below (absent, it is {:.1e}, for a start like {})",
                SHORTEST_IN_SINGLE * rule.end,
                rule.shortest,
                rule.start.shown_creep()
            );
            return Err(scenario.error_at("time.shortest", Problem::OutOfRange { allowed }));
        }
        let first = rule.first.map_or(FIRST * rule.tolerance.sqrt() * rule.end, |first| 2.0 * first);
        let first = rule.unjudged.unwrap_or(first);
        let first = if rule.first.is_none() { first.min(2.0 * rule.creep) } else { first };
        let scheme = scenario.scheme_descriptor();
        let order_inside = scheme.order_inside as f64;
        let budget = ErrorBudget::new(scenario.order_of_varying_steps());
        let control =
            StepControl::new(budget.order_of_pairs(), rule.start.creep, first.max(2.0 * rule.shortest));
        let largest =
            [&start.position, &start.momentum].map(|numbers| numbers.iter().map(|x| x.abs()).collect());
        let counts = Counts { rejected: 0, attempts: 0, smallest: f64::INFINITY, largest: 0.0 };
        // Momenta of coordinates without mass are zero, and so are their errors.
        let of_mass = |mass: f64| rule.velocity_scale() * if mass > 0.0 { mass } else { 1.0 };
        let masses = scenario.system.mass.diagonal();
        let momentum_scale: Vec<f64> = masses.iter().map(|&mass| of_mass(mass)).collect();
        let scales = momentum_scale.iter().zip(&start.momentum).zip(&masses);
        let energy_scale = scales.filter(|(_, mass)| **mass > 0.0).map(|((scale, p), mass)| {
            let p = p.abs().max(*scale);
            p * p / mass
        });
        let crossings = Crossings::of(
            simulation,
            (rule.tolerance, rule.scale, rule.end),
            epsilon,
            energy_scale.sum::<f64>() + start.energy.abs(),
            &start.position,
        );
        let standing = crossings.as_ref().map(|crossings| crossings.standing().clone());
        let travelled = vec![0.0; scenario.system.unknowns.unwrap_or(0)];
        let progress = Progress {
            control,
            budget,
            second: None,
            time: 0.0,
            largest,
            counts,
            at_break: true,
            standing,
            travelled,
        };
        let forgetting = scenario.equation.as_ref().map_or_else(Vec::new, |equation| {
            let exponents =
                equation.coordinates().iter().map(|coordinate| 1.0 - coordinate.moved).enumerate();
            exponents.map(|(row, power)| if row < equation.unknowns() { 0.0 } else { power }).collect()
        });
        Ok(Some(Self {
            breaks: Breaks::of(scenario, rule.shortest),
            forgetting,
            crossings,
            velocity_kinks: VelocityKinks::of(scenario),
            function_jumps: FunctionJumps::of(scenario),
            position_scale: position_scale(scenario, &rule),
            momentum_scale,
            scenario,
            rule,
            progress,
            perturbed: None,
            epsilon,
            saved: Vec::new(),
            saved_between: Vec::new(),
            whole: start.clone(),
            end: start.clone(),
            begin: start.position.clone(),
            inside: scenario
                .is_looked_into()
                .then(|| [(); 2].map(|()| vec![start.clone(); LOOKS_INSIDE.len()])),
            // The polynomial of half the step is more accurate by the same ratio. Galerkin's has momenta of
            // low order, which are not held to the tolerance.
            share_inside: match scheme.has_momentum_inside {
                true => [libm::pow(2.0, -order_inside); 2],
                false => [libm::pow(2.0, -order_inside), 0.0],
            },
            order_inside,
            ahead: false,
            iterations_ahead: 0,
        }))
    }

    /// The same, followed by a second run from a start beside this one, if that says how perturbations grow.
    pub(crate) fn with_perturbed(mut self, precision: Precision, tables: &Tables, start: &GridState) -> Self {
        self.perturbed = Perturbed::of(self.scenario, precision, tables, start);
        self
    }

    /// True if the end has been reached.
    pub(crate) fn is_done(&self) -> bool {
        self.progress.second.is_none() && self.progress.time >= self.rule.end
    }

    /// State needed to continue in a later run from the state returned last.
    pub(crate) fn progress(&self) -> &Progress {
        &self.progress
    }

    /// Warnings about what errors may have become.
    pub(crate) fn notes(&self) -> impl Iterator<Item = String> {
        // Beside a start with infinite slopes small perturbations grow at first, and are forgotten.
        let grown = self.perturbed.as_ref().and_then(|run| run.note(self.rule.tolerance));
        let grown = grown.filter(|_| !has_infinite_slopes(self.scenario));
        self.note_of_radians().into_iter().chain(grown)
    }

    /// What oscillations make of the error of the memory's table of rates, if that may be more than errors
    /// may be.
    ///
    /// Over ωt radians an error ε of the table turns the phase of a solution of order α by ωtε/α, where
    /// nothing damps it: radians are counted as Σ |Δx| in units of 2/π of the largest |x|.
    fn note_of_radians(&self) -> Option<String> {
        let Self { rule, progress, scenario, .. } = self;
        // With a fractional order among its terms an unknown of the largest order α turns like a solution of
        // that order.
        let is_fractional = |terms: &&Vec<Term>| terms.iter().any(|term| term.order.fract() != 0.0);
        let terms = scenario.equation.iter().flat_map(|equation| &equation.terms);
        let orders = terms.filter(is_fractional).map(|terms| terms[0].order);
        let order = orders.fold(f64::INFINITY, min_or_nan);
        let sizes = progress.travelled.iter().zip(&progress.largest[0]);
        let turns = sizes.filter(|(_, largest)| **largest > 0.0).map(|(sum, largest)| sum / largest);
        let radians = FRAC_PI_2 * turns.fold(0.0, max_or_nan);
        let error = radians * rule.error_of_rates() / order;
        // Less than a turn is no oscillation.
        (order.is_finite() && radians > TAU && error > ALLOWED * rule.tolerance).then(|| {
            format!(
                "time.tolerance: in some {radians:.0} radians of an oscillation that nothing damps the memory's errors, of {:.0e}, may \
                 have grown to {error:.0e} in its phase, more than {ALLOWED} times {:e}",
                rule.error_of_rates(),
                rule.tolerance
            )
        })
    }

    /// Continues from this state.
    pub(crate) fn resume(&mut self, simulation: &mut Simulation, progress: Progress) {
        if let (Some(crossings), Some(standing)) = (&mut self.crossings, &progress.standing) {
            crossings.resume(simulation, standing.clone());
        }
        (self.progress, self.ahead) = (progress, false);
        self.perturbed = None;
    }

    /// The saved state of the simulation for the state returned last.
    ///
    /// # Errors
    /// [`StateError`] if a memory cannot be saved.
    pub(crate) fn save(&self, simulation: &Simulation) -> Result<Vec<u8>, StateError> {
        if self.ahead { Ok(self.saved_between.clone()) } else { simulation.save() }
    }

    /// Writes the next state; returns the number of iterations of Newton's method.
    ///
    /// # Errors
    /// The reason why no further step can be made; the simulation is unchanged.
    pub(crate) fn advance(
        &mut self,
        simulation: &mut Simulation,
        next: &mut GridState,
    ) -> Result<u32, String> {
        if let Some((length, end)) = self.progress.second {
            if !self.ahead {
                let input = self.input(end - 0.5 * length);
                self.iterations_ahead =
                    simulation.step_over(length, end, input).map_err(|error: StepError| error.to_string())?;
                simulation.read(&mut self.end);
                self.end.time = end;
            }
            next.clone_from(&self.end);
            (self.progress.second, self.progress.time, self.ahead) = (None, end, false);
            return Ok(self.iterations_ahead);
        }
        self.attempt(simulation, next)
    }

    /// The input held over the pair that contains a time.
    fn input(&self, time: f64) -> &'s [f64] {
        let scenario: &'s Scenario = self.scenario;
        scenario.input_from(time)
    }

    /// Makes pairs until one is accurate enough, and writes the state between its halves.
    fn attempt(&mut self, simulation: &mut Simulation, middle: &mut GridState) -> Result<u32, String> {
        self.check_outlook()?;
        let time = self.progress.time;
        let input = self.input(time);
        if let Some(crossings) = &mut self.crossings {
            simulation.read_without_energy(&mut self.whole);
            crossings.begin(simulation, (time, &self.whole.position), self.progress.at_break)?;
        }
        self.saved = simulation.save().map_err(|error| error.to_string())?;
        // Half steps must be large enough to change the time.
        let shortest = (2.0 * self.rule.shortest).max(32.0 * self.epsilon * time);
        let longest = self.rule.longest.map_or(f64::INFINITY, |longest| 2.0 * longest);
        let longest = self.rule.longest_unjudged(time).map_or(longest, |most| most.min(longest));
        let (mut worst, mut tried, mut least) = (None, 0.5 * shortest, f64::INFINITY);
        // Time at which the pair should end because it crosses a jump or kink there.
        let mut crossing: Option<f64> = None;
        for _ in 0..MOST_ATTEMPTS {
            let Pair { end, mut at_break, at_crossing } = self.pair(time, [shortest, longest], crossing);
            let half = 0.5 * (end - time);
            let (between, length) = (time + half, end - time);
            self.progress.counts.attempts += 1;
            let made = self.make_pair(simulation, (half, between, end), input, middle);
            let error = match made {
                Ok(_) => Some(self.error([time, end])),
                Err(AttemptError::Step(_)) => None,
                Err(AttemptError::State(error)) => return Err(error.to_string()),
            };
            if self.turns_after_failure(simulation, &made)? {
                continue;
            }
            let ends = [time, between, end];
            if made.is_ok() && error.is_some_and(|error| error <= 1.0) {
                match self.judge(simulation, ends, shortest, at_crossing)? {
                    Judged::Stands(is_crossing) => at_break |= is_crossing,
                    Judged::Again(earlier, what) => {
                        crossing = earlier.or(crossing);
                        self.progress.counts.rejected += 1;
                        worst = Some(what.to_owned());
                        continue;
                    }
                }
            }
            if let (Some(crossings), Err(_)) = (&mut self.crossings, &made) {
                crossings.not_made(time, length);
            }
            if let (Ok(iterations), Some(error)) = (&made, error.filter(|&error| error <= 1.0)) {
                self.progress.control.accept(length, error, at_break);
                self.accept(ends, at_break, input);
                return Ok(*iterations);
            }
            self.progress.counts.rejected += 1;
            simulation.restore(&self.saved).map_err(|error| error.to_string())?;
            // An error that is not a number counts as a failure.
            let known = error.filter(|error| error.is_finite());
            self.progress.control.reject(length, known);
            least = known.map_or(least, |error| error.min(least));
            worst = Some(self.what_failed(&made, error));
            tried = half;
            if length <= shortest || (at_break && length < 2.0 * shortest) {
                break;
            }
        }
        Err(self.too_rough(&worst.unwrap_or_default(), tried) + &self.reachable(least))
    }

    /// Looks for jumps and kinks inside a pair, which is undone if there are any.
    ///
    /// # Errors
    /// If there is no motion from here, or more than one.
    fn judge(
        &mut self,
        simulation: &mut Simulation,
        pair: [f64; 3],
        shortest: f64,
        is_aimed: bool,
    ) -> Result<Judged, String> {
        let verdict = match &mut self.crossings {
            Some(crossings) => crossings.judge(simulation, pair, shortest, is_aimed),
            None => Ok(Verdict::Clear),
        };
        let judged = match verdict {
            Err(reason) => Err(reason),
            Ok(Verdict::EndAt(earlier)) => {
                Ok(Judged::Again(Some(earlier), "a jump or kink in the position is not met"))
            }
            Ok(Verdict::Again) => Ok(Judged::Again(None, "a jump or kink in the position is not met")),
            Ok(verdict) => {
                let is_inside = |time: &f64| *time - pair[0] >= shortest && pair[2] - *time >= shortest;
                let kinks = self.velocity_kinks.as_mut();
                let kink = kinks.and_then(|kinks| kinks.first_inside(simulation, pair)).filter(is_inside);
                let jumps = self.function_jumps.as_mut();
                let jump = jumps.and_then(|jumps| jumps.first_inside(simulation, pair)).filter(is_inside);
                Ok(match (kink, jump) {
                    (Some(kink), _) => Judged::Again(Some(kink), "a kink in the velocity is not met"),
                    (None, Some(jump)) => Judged::Again(Some(jump), "a jump of a function is not met"),
                    (None, None) => {
                        let jumps = self.function_jumps.as_ref();
                        let is_met = jumps.is_some_and(|jumps| jumps.is_met(pair[2]));
                        Judged::Stands(is_met || matches!(verdict, Verdict::Ends))
                    }
                })
            }
        };
        if !matches!(judged, Ok(Judged::Stands(_))) {
            simulation.restore(&self.saved).map_err(|error| error.to_string())?;
        }
        judged
    }

    /// Takes an accurate pair, at whose end the simulation is.
    fn accept(&mut self, [time, between, end]: [f64; 3], at_break: bool, input: &[f64]) {
        let half = 0.5 * (end - time);
        let counts = &mut self.progress.counts;
        (counts.smallest, counts.largest) = (counts.smallest.min(half), counts.largest.max(half));
        for (largest, now) in self.progress.largest.iter_mut().zip([&self.end.position, &self.end.momentum]) {
            largest.iter_mut().zip(now).for_each(|(most, x)| *most = most.max(x.abs()));
        }
        let moved = self.end.position.iter().zip(&self.begin);
        let moved = self.progress.travelled.iter_mut().zip(moved);
        moved.for_each(|(sum, (now, before))| *sum += (now - before).abs());
        self.begin.clone_from(&self.end.position);
        (self.progress.second, self.progress.time, self.ahead) = (Some((half, end)), between, true);
        self.progress.at_break = at_break;
        self.progress.budget.count();
        if at_break {
            self.progress.budget.pass(end);
        }
        self.progress.standing = self.crossings.as_ref().map(|crossings| crossings.standing().clone());
        if let Some(perturbed) = &mut self.perturbed {
            if let (Some(crossings), Some(switches)) = (&self.crossings, perturbed.switches()) {
                switches.set_sides(crossings.sides());
            }
            let unknowns = self.progress.travelled.len();
            let states = (&self.end.position[..], &self.progress.largest[0][..]);
            perturbed.follow([half, between, end], (input, &self.rule), states, unknowns);
        }
    }

    /// The tolerance that the best attempt at a step would have kept, `least` times that of the scenario.
    fn reachable(&self, least: f64) -> String {
        let tolerance = MARGIN * least * self.rule.tolerance;
        if tolerance > LARGEST_NAMED {
            return String::new();
        }
        format!("; `time.tolerance` = {tolerance:.0e} would pass this step")
    }

    /// The pair of steps to be attempted next from this time, within these lengths: as long as the control
    /// proposes, or up to a break, or to a jump or kink in the position at `crossing`.
    fn pair(&mut self, time: f64, [shortest, longest]: [f64; 2], crossing: Option<f64>) -> Pair {
        let longest =
            self.crossings.as_ref().map_or(longest, |crossings| crossings.longest(time).min(longest));
        let proposed = self.progress.control.proposed().clamp(shortest, longest.max(shortest));
        let proposed = match crossing {
            Some(crossing) if crossing - time <= 1.1 * proposed => crossing - time,
            _ => proposed,
        };
        let next_break = self.breaks.after(time, time + 1.25 * proposed);
        let left = next_break - time;
        // No remainder shorter than the shortest step may be left, for which the memory has no rates.
        let (length, at_break) = match proposed {
            proposed if proposed > 0.9 * left || left < 2.0 * shortest => (left, true),
            proposed if proposed > 0.5 * left => (0.5 * left, false),
            proposed => (proposed, false),
        };
        let at_crossing = crossing.filter(|crossing| {
            (crossing - time <= 1.001 * length || at_break) && next_break - crossing >= shortest
        });
        let end = match at_crossing {
            Some(crossing) => crossing,
            None if at_break => next_break,
            None => time + length,
        };
        Pair { end, at_break: at_break && at_crossing.is_none(), at_crossing: at_crossing.is_some() }
    }

    /// What is wrong with an attempt.
    fn what_failed(&self, made: &Result<u32, AttemptError>, error: Option<f64>) -> String {
        match made {
            Err(AttemptError::Step(StepError::NotFinite)) if self.scenario.equation.is_some() => {
                "the right side, or the result, is not a finite number".to_owned()
            }
            Err(AttemptError::Step(StepError::Memory(MemoryError::StepLength))) => {
                "a step shorter than `time.shortest` is needed".to_owned()
            }
            Err(AttemptError::Step(reason)) => reason.to_string(),
            _ => format!("the error is {:.1e} times the tolerance", error.unwrap_or(f64::INFINITY)),
        }
    }

    /// True if an attempt whose forces were not finite is to be repeated on another side of a jump or kink.
    fn turns_after_failure(
        &mut self,
        simulation: &mut Simulation,
        made: &Result<u32, AttemptError>,
    ) -> Result<bool, String> {
        let Err(AttemptError::Step(StepError::NotFinite)) = made else { return Ok(false) };
        let turns = |crossings: &mut Crossings| crossings.turns_after_failure(simulation);
        if !self.crossings.as_mut().is_some_and(turns) {
            return Ok(false);
        }
        self.progress.counts.rejected += 1;
        simulation.restore(&self.saved).map_err(|error| error.to_string())?;
        Ok(true)
    }

    /// The message that no step is accurate enough, down to the one tried last.
    fn too_rough(&self, worst: &str, tried: f64) -> String {
        let Adaptive { start, asked, shortest, creep, .. } = self.rule;
        let is_start = self.progress.time == 0.0;
        if is_start && asked < shortest && self.rule.unjudged.is_none() {
            return format!(
                "{worst}, with steps of {tried:.1e} even: Riemann–Liouville damping from an initial state that is not zero lets the \
                 momentum begin like t^{:.3}, and `time.tolerance` asks for a first step of {asked:.1e}, shorter than `time.shortest`; \
                 without that key it is made, or momenta are held to the tolerance from a later time on, which is said",
                start.power
            );
        }
        if is_start && creep < shortest {
            let asked = if creep > 0.0 { format!("{creep:.1e}") } else { "less than 1e-323".to_owned() };
            let what = match self.scenario.equation {
                Some(_) => "the solution begins",
                None => "a coordinate without mass begins to move",
            };
            return format!(
                "{worst}, with steps of {tried:.1e} even, the shortest here (`time.shortest`): {what} \
                 like {}, and `time.tolerance` asks for a first step of {asked}",
                start.shown_creep()
            );
        }
        if self.scenario.equation.is_some() && !is_start {
            return self.ends(worst, tried);
        }
        let usual = match self.scenario.equation {
            Some(_) => {
                "at the start the right side is no number (a root or a power of an unknown that begins at 0 also meets numbers a \
                 little below it: write abs(x0)^1.5 there), or its slopes hide the solution, or the tolerance is below what \
                 rounding leaves"
            }
            None => {
                "a jump of a force belongs on a grid point (`time.must_hit`), and a tolerance above what rounding leaves"
            }
        };
        let reason = to_and_fro(self.scenario).unwrap_or(usual);
        format!("{worst}, with steps of {tried:.1e} even, the shortest here (`time.shortest`): {reason}")
    }

    /// The message that the solution of an equation does not go on.
    fn ends(&self, worst: &str, tried: f64) -> String {
        let time = self.progress.time;
        let unknowns = self.scenario.system.unknowns.unwrap_or(0);
        let begun = self.scenario.initial.position.iter().map(|x| x.abs()).fold(self.rule.scale, max_or_nan);
        let (row, most) = self.progress.largest[0].iter().take(unknowns).enumerate().fold(
            (0, 0.0),
            |(row, most), (other, &size)| if size > most { (other, size) } else { (row, most) },
        );
        if most > UNBOUNDED * begun {
            return format!(
                "the solution grows without bound, it ends near t = {time}: |x{row}| is {most:.1e} there, and {worst}, with steps of \
                 {tried:.1e} even"
            );
        }
        if self.progress.at_break && self.rule.start.creep < 1.0 {
            return format!(
                "{worst}, with steps of {tried:.1e} even: behind a jump at t = {time} the solution goes on like {}, for which \
                 `time.tolerance` asks for steps below the rounding of t",
                self.rule.start.shown_creep()
            );
        }
        format!(
            "{worst}, with steps of {tried:.1e} even, the shortest here (`time.shortest`): near t = {time} the solution ends, or the \
             right side jumps (put that time into `time.must_hit`), or the tolerance is below what rounding leaves"
        )
    }

    /// # Errors
    /// The reason if the steps of a run will not suffice.
    fn check_outlook(&mut self) -> Result<(), String> {
        let Self { rule, progress, scenario, .. } = self;
        let steps = 2 * (progress.counts.attempts - progress.counts.rejected);
        let (most, order) = (scenario.time.steps, scenario.order_of_varying_steps());
        let asked = (rule.end, most);
        match progress.budget.out_of_reach((steps, progress.time), asked) {
            None => Ok(()),
            Some(all) => {
                let needed = format!(
                    "some {all:.0e} steps would be needed up to the end, and a run makes at most {most:.0e}"
                );
                Err(match to_and_fro(scenario) {
                    Some(reason) => format!("{needed}: {reason}"),
                    None => format!(
                        "{needed}: with this scheme, of order {order:.2}, they become fewer like `time.tolerance` to the power \
                         −{:.2}; take a larger tolerance, or a scheme of a higher order",
                        1.0 / order
                    ),
                })
            }
        }
    }

    /// Makes the whole step, restores the state, and makes the half steps. Leaves the simulation at the end.
    fn make_pair(
        &mut self,
        simulation: &mut Simulation,
        (half, between, end): (f64, f64, f64),
        input: &[f64],
        middle: &mut GridState,
    ) -> Result<u32, AttemptError> {
        simulation.step_over(2.0 * half, end, input)?;
        simulation.read_without_energy(&mut self.whole);
        let begin = between - half;
        let look = |simulation: &mut Simulation, states: &mut Vec<GridState>| {
            let places = LOOKS_INSIDE.iter().zip(states);
            places.for_each(|(part, state)| simulation.interpolate(begin + part * (end - begin), state));
        };
        if let Some([whole, _]) = &mut self.inside {
            look(simulation, whole);
        }
        simulation.restore(&self.saved)?;
        let iterations = simulation.step_over(half, between, input)?;
        simulation.read(middle);
        middle.time = between;
        self.saved_between = simulation.save()?;
        self.iterations_ahead = simulation.step_over(half, end, input)?;
        simulation.read(&mut self.end);
        self.end.time = end;
        if let Some([_, halves]) = &mut self.inside {
            look(simulation, halves);
        }
        Ok(iterations)
    }

    /// The error of the halves of a pair as a multiple of what it may be: the largest of all positions and
    /// momenta, at the end and inside.
    fn error(&self, pair: [f64; 2]) -> f64 {
        let is_judged = self.rule.longest_unjudged(self.progress.time).is_none();
        let of_momenta = if is_judged { 1.0 } else { 0.0 };
        let length = pair[1] - pair[0];
        let at_end = self.largest_difference([&self.whole, &self.end], [1.0, of_momenta], length);
        let at_end = self.progress.budget.of(at_end, pair);
        let inside = self.inside.as_ref().map_or(0.0, |[whole, halves]| {
            let [positions, momenta] = self.share_inside;
            // A kick at the start is spread over the first step.
            let is_kicked = self.rule.start.kicks && self.progress.time == 0.0;
            let shares = [positions, if is_kicked { 0.0 } else { of_momenta * momenta }];
            let places = whole.iter().zip(halves);
            let error = places.map(|(whole, half)| self.largest_difference([whole, half], shares, length));
            let error = error.fold(0.0, max_or_nan);
            // Rescaled to the same dependence on the length as the other.
            libm::pow(error, self.progress.budget.order_of_pairs() / self.order_inside)
        });
        if inside > at_end || inside.is_nan() { inside } else { at_end }
    }

    /// The largest difference of two states in units of the tolerance, with the given weights of positions
    /// and momenta, after a step of this length.
    fn largest_difference(&self, [one, other]: [&GridState; 2], shares: [f64; 2], length: f64) -> f64 {
        let Self { rule, progress, position_scale, momentum_scale, .. } = self;
        let of_row = |row: usize| match self.forgetting.get(row) {
            Some(&power) if power > 0.0 => shares[0] * libm::pow(length / rule.end, power),
            _ => shares[0],
        };
        let [positions, momenta] = &progress.largest;
        let relative = |one: f64, other: f64, most: f64, scale: f64| {
            (one - other).abs() / most.max(other.abs()).max(scale)
        };
        let positions =
            one.position.iter().zip(&other.position).zip(positions.iter().zip(position_scale)).enumerate();
        let momenta = one.momentum.iter().zip(&other.momentum).zip(momenta).zip(momentum_scale);
        let positions = positions
            .map(|(row, ((&one, &other), (&most, &scale)))| of_row(row) * relative(one, other, most, scale));
        let momenta =
            momenta.map(|(((&one, &other), &most), &scale)| shares[1] * relative(one, other, most, scale));
        // A value that is not a number counts as larger than every number.
        let beats = |error: f64, largest: f64| error > largest || error.is_nan();
        let largest = positions
            .chain(momenta)
            .fold(0.0, |largest: f64, error| if beats(error, largest) { error } else { largest });
        largest / rule.tolerance
    }
}

/// Reference size of each position: `scale`; D^s of an unknown has `scale` in the whole time to the power s.
fn position_scale(scenario: &Scenario, rule: &Adaptive) -> Vec<f64> {
    let of_derivative = |derivative: f64| rule.scale * libm::pow(rule.end, -derivative);
    match &scenario.equation {
        Some(equation) => {
            equation.coordinates().iter().map(|coordinate| of_derivative(coordinate.derivative)).collect()
        }
        None => vec![rule.scale; scenario.coordinates()],
    }
}

/// Reason why the error of an attempt is unknown.
enum AttemptError {
    Step(StepError),
    State(StateError),
}

impl From<StepError> for AttemptError {
    fn from(error: StepError) -> Self {
        Self::Step(error)
    }
}

impl From<StateError> for AttemptError {
    fn from(error: StateError) -> Self {
        Self::State(error)
    }
}

/// Why variational schemes take ever shorter steps where dampers c sign(v)|v|^γ hold a mass.
fn to_and_fro(scenario: &Scenario) -> Option<&'static str> {
    (scenario.scheme_descriptor().is_variational && scenario.jumps_with_velocities()).then_some(
        "what a force with `sign` or `step` of a velocity holds moves to and fro by ever less in this scheme, which adaptive steps \
         follow; with `scheme.kind` = \"collocation\" it rests, and equal steps (`time.step`) pass over it",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::motion::Motion;
    use serde_json::json;

    #[test]
    fn infinite_slopes_at_the_start_are_seen() {
        let seen = |right: &str, initial: f64| {
            let keys = json!({ "order": 0.5, "right": right, "initial": [initial] });
            let time = json!({ "end": 1.0, "tolerance": 1e-12 });
            let scenario = Scenario::from_value(&json!({ "equation": keys, "time": time })).unwrap();
            warning_of_start(&scenario).is_some()
        };
        assert!(seen("1 + (x0 - 0.5)^(1/3)", 0.5) && seen("sqrt(x0) - 1", 0.0));
        for (smooth, initial) in
            [("1 + (x0 - 0.5)^2", 0.5), ("-1e4*x0", 1.0), ("sin(x0)", 0.0), ("x0^(1/3)", 0.5)]
        {
            assert!(!seen(smooth, initial), "{smooth}");
        }
    }

    /// x = t³ under a root: D^β x = Γ(4)/Γ(4 − β) t^{3−β} − √x + t^1.5, where √x is all that counts at first.
    #[test]
    fn an_unknown_that_leaves_0_slowly_under_a_root_is_followed() {
        for (order, root) in
            [(1.0, "sqrt(x0)"), (1.0, "sqrt(max(x0, 0))"), (0.8, "sqrt(x0)"), (0.4, "x0^0.3")]
        {
            let factor = 6.0 / libm::tgamma(4.0 - order);
            let power = if root == "x0^0.3" { 0.9 } else { 1.5 };
            for tolerance in [1e-3, 1e-6, 1e-9] {
                let right = format!("{factor:?}*t^{:?} - {root} + t^{power}", 3.0 - order);
                let scenario = Scenario::from_value(&json!({
                    "equation": { "order": order, "right": right, "initial": [0.0] },
                    "time": { "end": 2.0, "tolerance": tolerance },
                }))
                .unwrap();
                let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
                while !motion.is_done() {
                    motion.advance().unwrap();
                }
                let error = (motion.state().position[0] / 8.0 - 1.0).abs();
                assert!(error <= 10.0 * tolerance, "{order}, {root}, {tolerance:e}: {error:e}");
            }
        }
    }

    /// Stiff relaxations to g(t), which solutions follow to 10⁻⁴, in steps longer than g turns in: the ends
    /// are right whatever the steps are, and the difference of two polynomials changes sign inside.
    #[test]
    fn values_inside_steps_of_stiff_relaxations_are_held_to_the_tolerance() {
        type Forced = (f64, &'static str, fn(f64) -> f64);
        let forced: [Forced; 3] = [
            (0.8, "cos(2.3*t + 1)", |t| (2.3 * t + 1.0).cos()),
            (1.0, "sin(3*t)", |t| (3.0 * t).sin()),
            (0.5, "tanh(5*(t - 4))", |t| (5.0 * (t - 4.0)).tanh()),
        ];
        for (order, right, exact) in forced {
            let scenario = Scenario::from_value(&json!({
                "equation": {
                    "order": order,
                    "right": format!("-1e4*(x0 - {right})"),
                    "initial": [exact(0.0)],
                },
                "time": { "end": 10.0, "tolerance": 1e-3 },
                "output": { "times": [10.0] },
            }))
            .unwrap();
            let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
            let (mut inside, mut begin, mut most) = (motion.state().clone(), 0.0, 0.0);
            while !motion.is_done() {
                motion.advance().unwrap();
                let end = motion.state().time;
                for part in 1..64 {
                    motion.interpolate(begin + (end - begin) * (f64::from(part) / 64.0), &mut inside);
                    most = max_or_nan(most, (inside.position[0] - exact(inside.time)).abs());
                }
                begin = end;
            }
            assert!(most < 2e-3 && motion.steps() < 150, "{right}: {most:e} in {} steps", motion.steps());
        }
    }

    /// Unknowns that begin like powers of t far apart: D^0.31 x0 = 1, x1″ = x0², and D^0.3 x1 = 1,
    /// D^0.9 x0 = 1 + x0 x1 with x0 = t^0.9/Γ(1.9).
    #[test]
    fn unknowns_that_begin_at_0_like_different_powers_act_on_each_other() {
        let gamma = libm::tgamma;
        let product = format!("1 + {:?}*t^1.2 - x0*x1", (gamma(1.9) * gamma(1.3)).recip());
        let squared = gamma(1.62) / gamma(3.62) / gamma(1.31).powi(2);
        for (orders, right, initial, exact) in [
            (
                json!([0.31, 2]),
                json!(["1", "x0^2"]),
                json!([0.0, [0.0, 1.0]]),
                [2f64.powf(0.31) / gamma(1.31), 2.0 + squared * 2f64.powf(2.62)],
            ),
            (
                json!([0.9, 0.3]),
                json!([product, "1"]),
                json!([0.0, 0.0]),
                [2f64.powf(0.9) / gamma(1.9), 2f64.powf(0.3) / gamma(1.3)],
            ),
        ] {
            for tolerance in [1e-3, 1e-6, 1e-9, 1e-12] {
                let scenario = Scenario::from_value(&json!({
                    "equation": { "order": orders, "right": right, "initial": initial },
                    "time": { "end": 2.0, "tolerance": tolerance },
                }))
                .unwrap();
                let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
                while !motion.is_done() {
                    motion.advance().unwrap();
                }
                for (found, exact) in motion.state().position.iter().zip(exact) {
                    let error = (found - exact).abs() / exact;
                    assert!(error <= 10.0 * tolerance, "{orders}, {tolerance:e}: {error:e}");
                }
                assert!(motion.steps() < 1000, "{orders}, {tolerance:e}: {} steps", motion.steps());
            }
        }
    }
}
