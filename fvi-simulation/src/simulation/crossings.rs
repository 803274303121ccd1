//! Where steps that are chosen on the way cross jumps and kinks of the system in the position.
//!
//! The system is taken on one side of each of them throughout a pair of steps, so that the motion is smooth
//! and its polynomial tells when the argument passes zero. The pair is then made again to end there, and the
//! next begins on the other side.

use super::Simulation;
use super::events::zero;
use crate::model::Side;
use serde::{Deserialize, Serialize};

/// Parts of each half at whose ends arguments are looked at.
const LOOKS: usize = 8;

/// A smallest value between looks is sought where the parabola through three of them is below this share of
/// the one in the middle, in so many steps.
const LOW: f64 = 0.3;
const STEPS_TO_LOWEST: usize = 30;

/// A crossing is met where the time to it is below this share of the tolerance times the length of the pair
/// that saw it first: what the wrong side does meanwhile to the momentum is as small beside what the pair
/// does.
const NEAR: f64 = 1e-3;

/// Values of arguments below so many roundings of what they are made of are not told from zero.
const ROUNDINGS: f64 = 64.0;

/// Most that is left of the way to a crossing which steps across cannot be made, after each step.
const LEFT: f64 = 0.1;

/// Half the way of an argument from one side to the other where a motion slides between them, in units of
/// the tolerance.
const WIDTH: f64 = 0.02;

/// State that a later run needs to go on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Standing {
    /// The sides that the present pair is made on.
    sides: Vec<Side>,
    /// Those that the next one begins on in place of them.
    turned: Vec<(usize, Side)>,
    /// Steps across a crossing cannot be made: the length of the pair that was to be, and about when it is.
    cautious: Option<(f64, f64)>,
}

/// Sides at the beginning of a pair of steps.
#[derive(Clone, Copy, Debug, Default)]
struct Trial {
    /// Whether the motion goes to the side that it is on: below, above.
    goes: [Option<bool>; 2],
    /// How fast, as the change of the argument by the square of the time.
    rate: [f64; 2],
    /// Whether it is settled, whatever the first look says.
    settled: bool,
}

/// Where a motion goes from zero of an argument.
enum Beginning {
    /// It is on its side from this look on; from the last one if it stays where it is.
    OnSide(usize),
    /// Sides have been changed: the pair is to be made again.
    Again,
    /// A shorter pair may tell.
    Unclear,
}

/// Crossings within a pair of steps.
#[derive(Debug)]
pub(super) enum Verdict {
    /// Nothing.
    Clear,
    /// It ends where it does so.
    Ends,
    /// It should have ended at this time.
    EndAt(f64),
    /// Sides at its beginning have been changed: it is to be made again.
    Again,
}

/// The switches of a simulation, and where the motion stands with them.
pub(super) struct Crossings {
    standing: Standing,
    tolerance: f64,
    /// Of positions that counts as one.
    scale: f64,
    end: f64,
    epsilon: f64,
    /// Of energies: a jump of the potential is one beside it.
    energy_scale: f64,
    trials: Vec<(usize, Trial)>,
    /// Below which the values of arguments are rounding; how fast arguments change with the position.
    noise: Vec<f64>,
    slopes: Vec<f64>,
    times: Vec<f64>,
    /// Values of all arguments at these times.
    looks: Vec<Vec<f64>>,
    position: Vec<f64>,
    /// The length of the first pair that was to be made from here.
    length: Option<f64>,
}

impl Crossings {
    /// Those of a simulation at t = 0; `None` if there are none.
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
        // The model has taken the sides of the position.
        switches.arguments(0.0, position, &mut values);
        let sides = values.iter().map(|&value| Side::of(value)).collect();
        Some(Self {
            standing: Standing { sides, ..Standing::default() },
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

    pub(super) fn standing(&self) -> &Standing {
        &self.standing
    }

    /// Goes on from there, within a pair or at its end.
    pub(super) fn go_on(&mut self, simulation: &mut Simulation, standing: Standing) {
        self.standing = standing;
        simulation.switches().set_sides(&self.standing.sides);
    }

    /// Turns what is to be turned where a pair begins; `is_break` says whether forces may jump there too.
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
        // Arguments within others may have turned these.
        let mut values = Vec::new();
        for _ in 0..=self.standing.sides.len().min(64) {
            switches.arguments(time, position, &mut values);
            let mut changed = false;
            for (index, (side, &value)) in self.standing.sides.iter_mut().zip(&values).enumerate() {
                if self.trials.iter().any(|&(other, _)| other == index) {
                    continue;
                }
                match *side {
                    // What held a motion between the sides is another force now.
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

    /// The longest pair to be made from a time.
    pub(super) fn longest(&self, time: f64) -> f64 {
        match self.standing.cautious {
            Some((_, crossing)) if crossing > time => (1.0 - LEFT) * (crossing - time),
            _ => f64::INFINITY,
        }
    }

    /// Takes in that a pair of this length could not be made.
    pub(super) fn not_made(&mut self, time: f64, length: f64) {
        let (first, _) = self.standing.cautious.unwrap_or((length, time));
        self.standing.cautious = Some((first, time));
    }

    /// Looks at a pair that has been made, from its beginning by way of its middle to its end. Pairs are
    /// no shorter than `apart`; `is_aimed` says whether it was to end at a crossing, which it may do a little
    /// before.
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
            // Where the way to a crossing is made in ever shorter steps, no step may be left over.
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
        let first = found.iter().fold(f64::INFINITY, |first, &(time, _)| first.min(time));
        if first - begin < apart {
            // Too near for a step: it is where the pair begins.
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
        // What is crossed at the end, or within rounding of it.
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

    /// Takes the values of the arguments along a pair.
    fn look(&mut self, simulation: &mut Simulation, [begin, middle, end]: [f64; 3]) {
        let part = |from: f64, to: f64, look: usize| from + (to - from) * (look as f64 / LOOKS as f64);
        self.times.clear();
        self.times.push(begin);
        self.times.extend((1..LOOKS).map(|look| part(begin, middle, look)));
        self.times.push(middle);
        self.times.extend((1..LOOKS).map(|look| part(middle, end, look)));
        self.times.push(end);
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

    /// The side behind a crossing at the end of the pair.
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

    /// Where the motion goes that begins at zero of an argument.
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
            // Whether the other side would do too where it begins at rest.
            (true, None) if start == 0.0 => Ok(self.turn(simulation, index, side.other())),
            (true, _) => Ok(Beginning::OnSide(on_side)),
            (false, None | Some(true)) => {
                if trial.goes[1 - which] == Some(true) {
                    trial.settled = true;
                }
                Ok(self.turn(simulation, index, side.other()))
            }
            (false, Some(false)) => {
                // Both sides push back. The share of what is above that leaves it where it is:
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

    /// The first time from a look on at which the motion leaves the side of a switch.
    fn first_crossing(&mut self, simulation: &mut Simulation, index: usize, from: usize) -> Option<f64> {
        let side = self.standing.sides[index];
        let values: Vec<f64> = self.looks.iter().map(|values| inside(side, values[index])).collect();
        let last = values.len() - 1;
        let mut at = |time: f64| {
            let mut position = Vec::new();
            let mut arguments = Vec::new();
            simulation.position_at(time, &mut position);
            simulation.switches().arguments(time, &position, &mut arguments);
            inside(side, arguments[index])
        };
        for look in from + 1..=last {
            let (before, now) = (values[look - 1], values[look]);
            if now <= 0.0 && before > 0.0 {
                return Some(zero(&mut at, (self.times[look - 1], before), (self.times[look], now)));
            }
            let Some(&next) = values.get(look + 1) else { break };
            if before > 0.0 && now <= before && now <= next && lowest(before, now, next) < LOW * now {
                let times = [self.times[look - 1], self.times[look], self.times[look + 1]];
                if let Some((time, value)) = below_zero(&mut at, times) {
                    return Some(zero(&mut at, (self.times[look - 1], before), (time, value)));
                }
            }
        }
        None
    }

    /// About when a switch will be crossed beyond the end of the pair.
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

/// How far a value of an argument lies inside of a side; negative outside.
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

/// The lowest value of the parabola through three values at equal distances.
fn lowest(before: f64, now: f64, next: f64) -> f64 {
    let (slope, curvature) = (0.5 * (next - before), before - 2.0 * now + next);
    if curvature > 0.0 { now - 0.5 * slope * slope / curvature } else { now }
}

/// A time with a value that is not positive around the smallest value between the first and the last of
/// three times, if there is one: golden sections.
fn below_zero(mut at: impl FnMut(f64) -> f64, [mut low, _, mut high]: [f64; 3]) -> Option<(f64, f64)> {
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
