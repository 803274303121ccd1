//! Jumps of forces in code, at which adaptive steps end.

use super::Simulation;
use super::velocity_kinks::motion_at;
use fvi_core::max_or_nan;
use fvi_scenario::language::expression::Moment;
use fvi_scenario::scenario::{Scenario, SharedTerms};

/// Where a force is evaluated near either end of a pair, as parts of the pair from that end on.
const PLACES: [f64; 7] = [0.0, 1.0 / 64.0, 1.0 / 32.0, 1.0 / 16.0, 1.0 / 8.0, 1.0 / 4.0, 1.0 / 2.0];

/// Slope between two places, in slopes beside it, from which on a jump is sought there.
const STEEP: f64 = 4.0;

/// Part of a difference that stays in one half of its interval, where it is a jump.
const STAYS: f64 = 0.85;

/// Part of a force below which differences are its rounding.
const ROUNDING: f64 = 1e-12;

/// Halvings of an interval, down to neighbouring numbers.
const HALVINGS: usize = 70;

/// Forces in code, whose jumps no expression tells.
///
/// A jump before the first node of a pair or behind its last one is seen by no difference of a whole step
/// and its halves, since the forces are those of one side at all nodes. So the force is evaluated along the
/// motion near both ends of an accurate pair: where it changes much more between two places than beside them,
/// the interval is halved, and if all of the change stays in one half each time, the pair ends there. Jumps
/// that are smaller than what the force changes on the pair anyway stay unseen.
pub(super) struct FunctionJumps {
    terms: SharedTerms,
    moves: bool,
    tolerance: f64,
    size: usize,
    position: [Vec<f64>; 2],
    motion: Vec<f64>,
    /// The jump found last.
    found: f64,
    /// End of the run.
    end: f64,
}

impl FunctionJumps {
    /// Those of the forces of a scenario with adaptive steps; `None` without terms in code.
    pub(super) fn of(scenario: &Scenario) -> Option<Self> {
        let rule = scenario.time.adaptive()?;
        let terms = scenario.system.own_terms.clone()?;
        let (moves, size) = (terms.depend_on_velocity(), scenario.coordinates());
        let (position, motion) = ([Vec::new(), Vec::new()], Vec::new());
        let (tolerance, end, found) = (rule.tolerance, rule.end, f64::NAN);
        Some(Self { terms, moves, tolerance, size, position, motion, found, end })
    }

    /// The time before the first jump inside a finished pair that its nodes do not see, away from both of its
    /// ends.
    pub(super) fn first_inside(&mut self, simulation: &mut Simulation, pair: [f64; 3]) -> Option<f64> {
        let [begin, _, end] = pair;
        let length = end - begin;
        // What a jump this close to an end changes is nothing; where one has just been met, it is that one.
        let near = 0.1 * self.tolerance * if self.found == begin { self.end } else { length };
        let from_begin: Vec<f64> = PLACES.iter().map(|part| begin + part * length).collect();
        let from_end: Vec<f64> = PLACES.iter().rev().map(|part| end - part * length).collect();
        let found = [from_begin, from_end].into_iter().find_map(|times| {
            let found = self.among(simulation, (&times, pair))?;
            (found - begin > near && end - found > near).then_some(found)
        });
        self.found = found.unwrap_or(self.found);
        found
    }

    /// True if the jump found last is at this time.
    pub(super) fn is_met(&self, time: f64) -> bool {
        self.found == time
    }

    /// The time before the first jump between these times, at one of which the pair begins or ends.
    fn among(&mut self, simulation: &mut Simulation, (times, pair): (&[f64], [f64; 3])) -> Option<f64> {
        let forces: Vec<Vec<f64>> = times.iter().map(|&time| self.force(simulation, (time, pair))).collect();
        let slopes: Vec<f64> = (1..times.len())
            .map(|k| difference(&forces[k - 1], &forces[k]) / (times[k] - times[k - 1]))
            .collect();
        for (k, slope) in slopes.iter().enumerate() {
            let beside = [k.checked_sub(1), Some(k + 1)].into_iter().flatten();
            let usual = beside.filter_map(|k| slopes.get(k)).copied().fold(0.0, max_or_nan);
            let change = difference(&forces[k], &forces[k + 1]);
            let size = forces[k].iter().map(|force| force.abs()).fold(0.0, max_or_nan);
            if *slope > STEEP * usual && change > ROUNDING * size {
                let ends = [(times[k], &forces[k]), (times[k + 1], &forces[k + 1])];
                if let Some(found) = self.halved(simulation, ends, pair) {
                    return Some(found);
                }
            }
        }
        None
    }

    /// The last time before a jump that an interval has; `None` if the force changes steadily there.
    fn halved(
        &mut self,
        simulation: &mut Simulation,
        [(mut from, before), (mut to, after)]: [(f64, &Vec<f64>); 2],
        pair: [f64; 3],
    ) -> Option<f64> {
        let (mut before, mut after) = (before.clone(), after.clone());
        for _ in 0..HALVINGS {
            let middle = from + 0.5 * (to - from);
            if middle <= from || middle >= to {
                break;
            }
            let force = self.force(simulation, (middle, pair));
            let [left, right] = [difference(&before, &force), difference(&force, &after)];
            if left >= STAYS * (left + right) {
                (to, after) = (middle, force);
            } else if right >= STAYS * (left + right) {
                (from, before) = (middle, force);
            } else {
                return None;
            }
        }
        Some(from)
    }

    /// The force at a time inside the pair.
    fn force(&mut self, simulation: &mut Simulation, place: (f64, [f64; 3])) -> Vec<f64> {
        motion_at(simulation, place, &mut self.position, &mut self.motion);
        let (position, velocity) = self.motion.split_at(self.size);
        let (moment, mut force) = (Moment::inside(place.0), vec![0.0; self.size]);
        self.terms.with(|terms| match self.moves {
            true => terms.add_restoring_force_in_motion(moment, position, velocity, &mut force),
            false => terms.add_restoring_force(moment, position, &mut force),
        });
        force
    }
}

/// The largest difference of a component; not a number where one is not.
fn difference(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(one, other)| (one - other).abs()).fold(0.0, max_or_nan)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::Precision;
    use crate::simulation::motion::Motion;
    use fvi_scenario::scenario::OwnTerms;

    /// −x + 3 step(t − jump), or −x − 3 step(jump − x).
    struct Jump {
        at: f64,
        is_in_time: bool,
        is_of_velocity: bool,
    }

    impl Jump {
        fn force(&self, time: f64, x: f64) -> f64 {
            match self.is_in_time {
                true => -x + if time > self.at { 3.0 } else { 0.0 },
                false => -x - if x < self.at { 3.0 } else { 0.0 },
            }
        }

        /// x(t) from x(0) = 1.
        fn exact(&self, time: f64) -> f64 {
            let (met, rest) = match self.is_in_time {
                true => (self.at, 3.0),
                false => (-libm::log(self.at), -3.0),
            };
            let after = if time > met { -libm::expm1(met - time) } else { 0.0 };
            libm::exp(-time) + rest * after
        }
    }

    impl OwnTerms for Jump {
        fn potential(&mut self, _: &[f64]) -> f64 {
            0.0
        }

        fn depends_on_velocity(&self) -> bool {
            self.is_of_velocity
        }

        fn add_restoring_force(&mut self, moment: Moment<f64>, position: &[f64], restoring: &mut [f64]) {
            restoring[0] -= self.force(moment.time, position[0]);
        }

        fn add_linearisation(
            &mut self,
            moment: Moment<f64>,
            position: &[f64],
            restoring: &mut [f64],
            stiffness: &mut [f64],
        ) {
            self.add_restoring_force(moment, position, restoring);
            stiffness[0] += 1.0;
        }

        fn add_restoring_force_in_motion(
            &mut self,
            moment: Moment<f64>,
            _: &[f64],
            velocity: &[f64],
            restoring: &mut [f64],
        ) {
            restoring[0] -= self.force(moment.time, velocity[0]);
        }

        fn add_linearisation_in_motion(
            &mut self,
            moment: Moment<f64>,
            (position, velocity): (&[f64], &[f64]),
            restoring: &mut [f64],
            _: &mut [f64],
            resistance: &mut [f64],
        ) {
            self.add_restoring_force_in_motion(moment, position, velocity, restoring);
            resistance[0] += 1.0;
        }

        fn take_largest_force(&mut self, largest: &mut [f64]) {
            largest.fill(10.0);
        }
    }

    /// x(2) of an equation, or the momentum of a mass.
    fn end(scenario: &serde_json::Value, jump: Jump) -> f64 {
        let of_mass = jump.is_of_velocity;
        let scenario = Scenario::from_value(scenario).unwrap().with_own_terms(SharedTerms::new(jump));
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        while !motion.is_done() {
            motion.advance().unwrap();
        }
        let state = motion.state();
        if of_mass { state.momentum[0] } else { state.position[0] }
    }

    /// Jumps at 60 places, in time and where the unknown passes: no node of a pair tells of one that lies
    /// before the first.
    #[test]
    fn adaptive_steps_keep_their_tolerance_across_jumps_of_functions() {
        for is_of_velocity in [false, true] {
            for (digits, is_in_time) in [(6, true), (8, true), (10, true), (6, false), (9, false)] {
                let tolerance = libm::pow(10.0, -f64::from(digits));
                let time = serde_json::json!({ "grid": "adaptive", "end": 2.0, "tolerance": tolerance });
                let scenario = match is_of_velocity {
                    false => serde_json::json!({
                        "equation": { "order": 1.0, "right": ["0"], "initial": [1.0] },
                        "time": time,
                    }),
                    true => serde_json::json!({
                        "system": { "mass": [1.0] },
                        "initial": { "position": [0.0], "velocity": [1.0] },
                        "scheme": { "kind": "collocation" },
                        "time": time,
                    }),
                };
                // Velocities of short steps have too few digits for ten, and for a jump where they pass.
                if is_of_velocity && (digits > 9 || !is_in_time) {
                    continue;
                }
                for k in 0..60 {
                    let at = 0.15 + 0.8 * libm::fmod(0.618_033_988_75 * f64::from(k), 1.0);
                    let at = if is_in_time { 2.0 * at } else { at };
                    let of = || Jump { at, is_in_time, is_of_velocity };
                    let error = (end(&scenario, of()) - of().exact(2.0)).abs();
                    assert!(error < 30.0 * tolerance, "{at}, {tolerance:e}, {is_in_time}: {error:e}");
                }
            }
        }
    }
}
