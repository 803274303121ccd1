//! Crossings of jumps and kinks of the system in the position by adaptive steps.
//!
//! The system is evaluated on one side of each throughout a pair of steps, so that the motion is smooth and
//! its polynomial determines the time at which the argument passes zero. The pair is then repeated to end
//! there, and the next pair begins on the other side.

use super::Simulation;
use super::events::zero;
use crate::model::Side;
use fvi_core::min_or_nan;
use serde::{Deserialize, Serialize};

/// Number of parts of each half step at whose ends arguments are evaluated.
const LOOKS: usize = 8;

/// A minimum between evaluations is searched for if the parabola through three values falls below this
/// fraction of the middle one, with the given number of steps.
const LOW: f64 = 0.3;
const STEPS_TO_LOWEST: usize = 30;

/// A crossing counts as reached if the time to it is below this fraction of the tolerance times the length of
/// the pair that found it first: the relative error of the momentum due to the wrong side is then of this
/// size.
const NEAR: f64 = 1e-3;

/// Values of arguments below this number of rounding errors of their terms are not distinguished from zero.
const ROUNDINGS: f64 = 64.0;

/// Largest remaining fraction, after each step, of the time to a crossing that steps cannot cross.
const LEFT: f64 = 0.1;

/// Half the range of an argument from one side to the other while a motion slides between them, in units of
/// the tolerance.
const WIDTH: f64 = 0.02;

/// State needed to continue in a later run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct CrossingState {
    /// The sides during the present pair.
    sides: Vec<Side>,
    /// Changes of sides at the beginning of the next pair.
    turned: Vec<(usize, Side)>,
    /// If steps across a crossing fail: the length of the failed pair, and the approximate time of the
    /// crossing.
    cautious: Option<(f64, f64)>,
}

/// Result of trying both sides at the beginning of a pair of steps.
#[derive(Clone, Copy, Debug, Default)]
struct Trial {
    /// True if the motion moves to the assumed side: below, above.
    goes: [Option<bool>; 2],
    /// Rate at which it does, as the change of the argument divided by the square of the time.
    rate: [f64; 2],
    /// True if the side is decided, independently of the first evaluation.
    settled: bool,
    /// True if forces are no numbers on the assumed side: below, above.
    failed: [bool; 2],
}

/// Side of a motion that begins at a zero of an argument.
enum Beginning {
    /// The motion is on its side from this evaluation on; from the last one if it stays at zero.
    OnSide(usize),
    /// Sides have been changed: the pair must be repeated.
    Again,
    /// A shorter pair is needed to decide.
    Unclear,
}

/// Crossings within a pair of steps.
#[derive(Debug)]
pub(super) enum Verdict {
    /// No crossing.
    Clear,
    /// The pair ends at a crossing.
    Ends,
    /// The pair should end at this time.
    EndAt(f64),
    /// Sides at the beginning have been changed: the pair must be repeated.
    Again,
}

/// The switches of a simulation, and the state of the motion relative to them.
pub(super) struct Crossings {
    standing: CrossingState,
    tolerance: f64,
    /// Reference size of positions.
    scale: f64,
    end: f64,
    epsilon: f64,
    /// Reference size of energies, relative to which a jump of the potential is significant.
    energy_scale: f64,
    trials: Vec<(usize, Trial)>,
    /// Rounding errors of the arguments, and their rates of change with the position.
    noise: Vec<f64>,
    slopes: Vec<f64>,
    times: Vec<f64>,
    /// Values of all arguments at the times of evaluation.
    looks: Vec<Vec<f64>>,
    position: Vec<f64>,
    /// Length of the first pair attempted from here.
    length: Option<f64>,
}

impl Crossings {
    /// The switches of a simulation at t = 0; `None` if there are none.
    pub(super) fn of(
        simulation: &mut Simulation,
        (tolerance, scale, end): (f64, f64, f64),
        epsilon: f64,
        energy_scale: f64,
        position: &[f64],
    ) -> Option<Self> {
        let switches = simulation.switches();
        if switches.switches() == 0 {
            return None;
        }
        let mut values = Vec::new();
        // The model has set the sides from the position.
        switches.arguments(0.0, position, &mut values);
        let sides = values.iter().map(|&value| Side::of(value)).collect();
        Some(Self {
            standing: CrossingState { sides, ..CrossingState::default() },
            tolerance,
            scale,
            end,
            epsilon,
            energy_scale,
            trials: Vec::new(),
            noise: Vec::new(),
            slopes: Vec::new(),
            times: Vec::new(),
            looks: Vec::new(),
            position: position.to_vec(),
            length: None,
        })
    }

    /// The sides during the present pair.
    pub(super) fn sides(&self) -> &[Side] {
        &self.standing.sides
    }

    pub(super) fn standing(&self) -> &CrossingState {
        &self.standing
    }

    /// Continues from a saved state, within a pair or at its end.
    pub(super) fn resume(&mut self, simulation: &mut Simulation, standing: CrossingState) {
        self.standing = standing;
        simulation.switches().set_sides(&self.standing.sides);
    }

    /// Changes the sides due at the beginning of a pair; `is_break`: forces may jump there too.
    ///
    /// # Errors
    /// If a potential jumps.
    pub(super) fn begin(
        &mut self,
        simulation: &mut Simulation,
        (time, position): (f64, &[f64]),
        is_break: bool,
    ) -> Result<(), String> {
        let switches = simulation.switches();
        let turned = std::mem::take(&mut self.standing.turned);
        self.position.clear();
        self.position.extend_from_slice(position);
        self.trials.clear();
        if !turned.is_empty() {
            let before = switches.sided_potential(position);
            for &(index, side) in &turned {
                let was = std::mem::replace(&mut self.standing.sides[index], side);
                if !matches!(was, Side::Between { .. }) {
                    self.trials.push((index, Trial::default()));
                }
            }
            switches.set_sides(&self.standing.sides);
            let jump = switches.sided_potential(position) - before;
            if jump.abs() > 10.0 * self.tolerance * self.energy_scale {
                let names: Vec<String> =
                    turned.iter().map(|&(index, _)| switches.describe_switch(index)).collect();
                return Err(format!(
                    "the potential jumps by {jump:.3e} with {}: the force there has no limit; a potential must be continuous",
                    names.join(" and ")
                ));
            }
        }
        let mut scales = Vec::new();
        switches.argument_scales(time, position, &mut scales);
        self.noise.clear();
        self.noise.extend(scales.iter().map(|[_, size]| ROUNDINGS * self.epsilon * size));
        self.slopes.clear();
        self.slopes.extend(scales.iter().map(|[slope, _]| slope));
        // Changes of other arguments may have changed these.
        let mut values = Vec::new();
        for _ in 0..=self.standing.sides.len().min(64) {
            switches.arguments(time, position, &mut values);
            let mut changed = false;
            for (index, (side, &value)) in self.standing.sides.iter_mut().zip(&values).enumerate() {
                if self.trials.iter().any(|&(other, _)| other == index) {
                    continue;
                }
                match *side {
                    // After a break the force that holds a motion between the sides is different.
                    Side::Between { .. } if is_break => {
                        (*side, changed) = (Side::of(value), true);
                        self.trials.push((index, Trial::default()));
                    }
                    Side::Between { .. } => {}
                    _ if value.abs() <= self.noise[index] => self.trials.push((index, Trial::default())),
                    _ if inside(*side, value) < 0.0 => (*side, changed) = (side.other(), true),
                    _ => {}
                }
            }
            if !changed {
                break;
            }
            switches.set_sides(&self.standing.sides);
        }
        self.length = None;
        Ok(())
    }

    /// The longest pair allowed from a time.
    pub(super) fn longest(&self, time: f64) -> f64 {
        match self.standing.cautious {
            Some((_, crossing)) if crossing > time => (1.0 - LEFT) * (crossing - time),
            _ => f64::INFINITY,
        }
    }

    /// Records that a pair of this length failed.
    pub(super) fn not_made(&mut self, time: f64, length: f64) {
        let (first, _) = self.standing.cautious.unwrap_or((length, time));
        self.standing.cautious = Some((first, time));
    }

    /// Turns to the other side of a zero at the beginning of the pair, after an attempt whose forces were not
    /// finite: as that of |x|^{3/2} on the side where |x| stands for −x, if x increases. False if there is no
    /// side that has not failed.
    pub(super) fn turns_after_failure(&mut self, simulation: &mut Simulation) -> bool {
        for place in 0..self.trials.len() {
            let (index, trial) = self.trials[place];
            let side = self.standing.sides[index];
            let which = usize::from(side == Side::Above);
            if trial.settled || trial.goes[which].is_some() || matches!(side, Side::Between { .. }) {
                continue;
            }
            self.trials[place].1.failed[which] = true;
            if !trial.failed[1 - which] {
                self.turn(simulation, index, side.other());
                return true;
            }
        }
        false
    }

    /// Examines a finished pair from its beginning over its middle to its end. Pairs are at least `apart`
    /// long; `is_aimed`: the pair was to end at a crossing, before which it may end by a small amount.
    ///
    /// # Errors
    /// If there is no motion from here, or more than one.
    pub(super) fn judge(
        &mut self,
        simulation: &mut Simulation,
        [begin, middle, end]: [f64; 3],
        apart: f64,
        is_aimed: bool,
    ) -> Result<Verdict, String> {
        let length = *self.length.get_or_insert(end - begin);
        let near = match self.standing.cautious {
            // If a crossing is approached in ever shorter steps, no remainder shorter than a step may be
            // left.
            Some((first, _)) if 1.1 * apart <= (self.tolerance * first).max(1e-11 * self.end) => 1.1 * apart,
            _ => 0.0,
        };
        let near = near.max(NEAR * self.tolerance * length).max(32.0 * self.epsilon * end);
        self.look(simulation, [begin, middle, end]);
        let mut armed = vec![0; self.standing.sides.len()];
        for place in 0..self.trials.len() {
            match self.judge_beginning(simulation, place)? {
                Beginning::OnSide(from) => armed[self.trials[place].0] = from,
                Beginning::Again => return Ok(Verdict::Again),
                Beginning::Unclear if self.times[LOOKS / 2] - begin < apart => {
                    let name = simulation.switches().describe_switch(self.trials[place].0);
                    return Err(format!(
                        "{name} is crossed at t = {begin}, and no step, down to the shortest (`time.shortest`), tells to which side"
                    ));
                }
                Beginning::Unclear => return Ok(Verdict::EndAt(self.times[LOOKS / 2])),
            }
        }
        let last = self.times.len() - 1;
        let mut found: Vec<(f64, usize)> = Vec::new();
        for (index, &from) in armed.iter().enumerate() {
            if let Some(time) = self.first_crossing(simulation, index, from) {
                found.push((time, index));
            }
        }
        let first = found.iter().map(|&(time, _)| time).fold(f64::INFINITY, min_or_nan);
        if first - begin < apart {
            // Too near for a step: it counts as at the beginning of the pair.
            if first - begin > 100.0 * near.max(1e-11 * end) {
                let names = self.names(simulation, found.iter().filter(|(time, _)| *time == first));
                return Err(format!(
                    "{names} is crossed at t = {first}, sooner than the shortest step allows (`time.shortest`)"
                ));
            }
            for &(_, index) in found.iter().filter(|(time, _)| time - begin < apart) {
                self.turn_at_beginning(index);
            }
            simulation.switches().set_sides(&self.standing.sides);
            return Ok(Verdict::Again);
        }
        if first < end - near.max(if end - first < apart { apart } else { 0.0 }) {
            return Ok(Verdict::EndAt(first));
        }
        // Arguments crossed at the end, or within rounding of it.
        let (mut turned, mut ahead) = (Vec::new(), f64::INFINITY);
        let mut crossing = f64::INFINITY;
        for (index, &from) in armed.iter().enumerate() {
            let side = self.standing.sides[index];
            let [before, now] = [last - 1, last].map(|look| inside(side, self.looks[look][index]));
            let rate = (before - now) / (self.times[last] - self.times[last - 1]);
            let is_met = found.iter().any(|&(_, other)| other == index);
            if is_met || (from < last && rate > 0.0 && now <= rate * near) {
                turned.push((index, self.behind(index)));
            } else if from < last && rate > 0.0 {
                crossing = crossing.min(end + now / rate);
                if now < 0.5 * before {
                    ahead = ahead.min(self.crossing_ahead(simulation, index));
                }
            }
        }
        if turned.is_empty() {
            if let Some((first, _)) = self.standing.cautious {
                self.standing.cautious = crossing.is_finite().then_some((first, crossing));
            } else if is_aimed && ahead - end < 0.05 * (end - begin) {
                return Ok(Verdict::EndAt(ahead));
            }
            return Ok(Verdict::Clear);
        }
        self.standing.cautious = None;
        self.standing.turned = turned;
        Ok(Verdict::Ends)
    }

    /// Evaluates the arguments along a pair.
    fn look(&mut self, simulation: &mut Simulation, [begin, middle, end]: [f64; 3]) {
        self.times.clear();
        self.times.extend(looks([begin, middle, end]));
        self.looks.resize_with(self.times.len(), Vec::new);
        let mut position = Vec::new();
        for (&time, values) in self.times.iter().zip(&mut self.looks) {
            let at = if time == begin {
                &self.position
            } else {
                simulation.position_at(time, &mut position);
                &position
            };
            simulation.switches().arguments(time, at, values);
        }
    }

    /// The side after a crossing at the end of the pair.
    fn behind(&self, index: usize) -> Side {
        match self.standing.sides[index] {
            Side::Between { share, slope } => {
                let last = self.looks.last().map_or(0.0, |values| values[index]);
                if share + slope * last < 0.5 { Side::Below } else { Side::Above }
            }
            side => side.other(),
        }
    }

    fn turn_at_beginning(&mut self, index: usize) {
        let side = &mut self.standing.sides[index];
        *side = match *side {
            Side::Between { share, .. } => {
                if share < 0.5 {
                    Side::Below
                } else {
                    Side::Above
                }
            }
            side => side.other(),
        };
        let trial = self.trials.iter_mut().find(|(other, _)| *other == index);
        match trial {
            Some((_, trial)) => trial.settled = true,
            None => {
                self.trials.push((index, Trial { settled: true, ..Trial::default() }));
            }
        }
    }

    /// Side of the motion that begins at a zero of an argument.
    fn judge_beginning(&mut self, simulation: &mut Simulation, place: usize) -> Result<Beginning, String> {
        let (index, trial) = self.trials[place];
        let side = self.standing.sides[index];
        let last = self.times.len() - 1;
        let value = |look: usize| inside(side, self.looks[look][index]);
        let begins = value(0);
        let on_side = (1..=last).find(|&look| value(look) > self.noise[index]).unwrap_or(last);
        if trial.settled || matches!(side, Side::Between { .. }) {
            let is_off = value(last) < -self.noise[index] && on_side == last;
            return Ok(if is_off { Beginning::Unclear } else { Beginning::OnSide(on_side) });
        }
        let Some(moved) = (1..=last).find(|&look| (value(look) - begins).abs() > self.noise[index]) else {
            return Ok(Beginning::OnSide(last));
        };
        let goes = value(moved) > begins;
        let which = usize::from(side == Side::Above);
        let time = self.times[moved] - self.times[0];
        let trial = &mut self.trials[place].1;
        trial.goes[which] = Some(goes);
        trial.rate[which] = (value(moved) - begins).abs() / (time * time);
        let start = self.times[0];
        match (goes, trial.goes[1 - which]) {
            (true, Some(true)) => {
                let name = simulation.switches().describe_switch(index);
                Err(format!(
                    "the motion from here is not unique: at rest on {name} it may leave to either side; begin a little beside it"
                ))
            }
            // At rest, whether the other side would also be possible.
            (true, None) if start == 0.0 && !trial.failed[1 - which] => {
                Ok(self.turn(simulation, index, side.other()))
            }
            (true, _) => Ok(Beginning::OnSide(on_side)),
            (false, None) if trial.failed[1 - which] => Ok(Beginning::Unclear),
            (false, None | Some(true)) => {
                if trial.goes[1 - which] == Some(true) {
                    trial.settled = true;
                }
                Ok(self.turn(simulation, index, side.other()))
            }
            (false, Some(false)) => {
                // Both sides push the motion back. The fraction of the upper side with which it stays in
                // place:
                let share = trial.rate[0] / (trial.rate[0] + trial.rate[1]);
                let slope = 0.5 / (WIDTH * self.tolerance * self.scale * self.slopes[index]);
                trial.settled = true;
                let value = self.looks[0][index];
                let side = Side::Between { share: share - slope * value, slope };
                Ok(self.turn(simulation, index, side))
            }
        }
    }

    fn turn(&mut self, simulation: &mut Simulation, index: usize, side: Side) -> Beginning {
        self.standing.sides[index] = side;
        simulation.switches().set_sides(&self.standing.sides);
        Beginning::Again
    }

    /// The first time, from an evaluation on, at which the motion leaves the side of a switch.
    fn first_crossing(&mut self, simulation: &mut Simulation, index: usize, from: usize) -> Option<f64> {
        let side = self.standing.sides[index];
        let values: Vec<f64> = self.looks.iter().map(|values| inside(side, values[index])).collect();
        let mut at = |time: f64| {
            let mut position = Vec::new();
            let mut arguments = Vec::new();
            simulation.position_at(time, &mut position);
            simulation.switches().arguments(time, &position, &mut arguments);
            inside(side, arguments[index])
        };
        first_zero(&mut at, &self.times, &values, from)
    }

    /// Approximate time of a crossing after the end of the pair.
    fn crossing_ahead(&mut self, simulation: &mut Simulation, index: usize) -> f64 {
        let (side, last) = (self.standing.sides[index], self.times.len() - 1);
        let end = self.times[last];
        let little = 0.05 * (end - self.times[last - 1]);
        let (mut position, mut arguments) = (Vec::new(), Vec::new());
        simulation.position_at(end - little, &mut position);
        simulation.switches().arguments(end - little, &position, &mut arguments);
        let now = inside(side, self.looks[last][index]);
        let rate = (inside(side, arguments[index]) - now) / little;
        if rate > 0.0 { end + now / rate } else { f64::INFINITY }
    }

    fn names<'a>(
        &self,
        simulation: &mut Simulation,
        found: impl Iterator<Item = &'a (f64, usize)>,
    ) -> String {
        let names: Vec<String> =
            found.map(|&(_, index)| simulation.switches().describe_switch(index)).collect();
        names.join(" and ")
    }
}

/// Distance of a value of an argument from the boundary of a side; negative outside.
fn inside(side: Side, value: f64) -> f64 {
    match side {
        Side::Above => value,
        Side::Below => -value,
        Side::Between { share, slope } => {
            let share = share + slope * value;
            share.min(1.0 - share) / slope
        }
    }
}

/// Times at which arguments along a pair of steps are evaluated: its ends, and those of parts of its halves.
pub(super) fn looks([begin, middle, end]: [f64; 3]) -> impl Iterator<Item = f64> {
    let parts =
        |from: f64, to: f64| (0..LOOKS).map(move |look| from + (to - from) * (look as f64 / LOOKS as f64));
    parts(begin, middle).chain(parts(middle, end)).chain([end])
}

/// The first time, from an evaluation on, at which a function with given values at given times falls to zero.
pub(super) fn first_zero(
    at: &mut dyn FnMut(f64) -> f64,
    times: &[f64],
    values: &[f64],
    from: usize,
) -> Option<f64> {
    (from + 1..times.len()).find_map(|look| {
        let (before, now) = (values[look - 1], values[look]);
        if before <= 0.0 {
            return None;
        }
        let start = (times[look - 1], before);
        if now <= 0.0 {
            return Some(zero(&mut *at, start, (times[look], now)));
        }
        let &next = values.get(look + 1)?;
        let dips = now <= before && now <= next && lowest(before, now, next) < LOW * now;
        if !dips {
            return None;
        }
        let found = below_zero(&mut *at, [times[look - 1], times[look], times[look + 1]])?;
        Some(zero(&mut *at, start, found))
    })
}

/// The minimum of the parabola through three values at equal distances.
fn lowest(before: f64, now: f64, next: f64) -> f64 {
    let (slope, curvature) = (0.5 * (next - before), before - 2.0 * now + next);
    if curvature > 0.0 { now - 0.5 * slope * slope / curvature } else { now }
}

/// Searches for a time with a value ≤ 0 around the minimum between the first and the last of three times, by
/// golden sections; returns it with the value.
fn below_zero(at: &mut dyn FnMut(f64) -> f64, [mut low, _, mut high]: [f64; 3]) -> Option<(f64, f64)> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let place = |low: f64, high: f64| [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
    let [mut left, mut right] = place(low, high);
    let (mut at_left, mut at_right) = (at(left), at(right));
    for _ in 0..STEPS_TO_LOWEST {
        let (time, value) = if at_left < at_right { (left, at_left) } else { (right, at_right) };
        if value <= 0.0 {
            return Some((time, value));
        }
        if at_left < at_right {
            (high, right, at_right) = (right, left, at_left);
            [left, _] = place(low, high);
            at_left = at(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            [_, right] = place(low, high);
            at_right = at(right);
        }
    }
    None
}
