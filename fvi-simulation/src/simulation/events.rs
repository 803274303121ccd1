//! Events: where functions of the motion pass zero.

use super::GridState;
use crate::language::expression::{Expression, Moment};
use crate::scenario::{Action, Direction, Scenario};
use serde::{Deserialize, Serialize};

/// Parts of a step at whose ends signs are looked at: two zeros within one of them are not seen.
const LOOKS: usize = 8;

/// Steps of the search for a zero; each at least halves the interval in two of them.
const MOST_STEPS: usize = 200;

/// An event that has happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Happened {
    /// Which of the scenario's events, from 0.
    pub event: usize,
    /// Whether its function was rising.
    pub rising: bool,
    /// When.
    pub time: f64,
    /// Position there.
    pub position: Vec<f64>,
    /// Momentum there.
    pub momentum: Vec<f64>,
    /// Energy there.
    pub energy: f64,
}

impl Happened {
    /// The state there.
    pub fn state(&self) -> GridState {
        let Self { time, position, momentum, energy, .. } = self;
        GridState {
            time: *time,
            position: position.clone(),
            momentum: momentum.clone(),
            energy: *energy,
            ..GridState::default()
        }
    }
}

/// Most events that are kept.
const MOST_EVENTS: usize = 100_000;

/// State of a watch that a later run needs to go on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    /// The events, in their order.
    pub happened: Vec<Happened>,
    /// Events beyond the most that are kept.
    pub dropped: usize,
    /// Of each function when it was first found to be not a number.
    pub undefined: Vec<Option<f64>>,
    /// Of each function whether it was negative when it was last not zero; `None`: it was not, since it began
    /// or was no number.
    negative: Vec<Option<bool>>,
}

/// Watches for the events of a scenario.
pub struct Watch {
    watched: Vec<Watched>,
    seen: Seen,
    time: f64,
    /// Position and momentum, where functions are evaluated.
    variables: Vec<f64>,
    point: GridState,
}

struct Watched {
    function: Expression,
    direction: Direction,
    stops: bool,
    /// Its value where it was looked at last.
    value: f64,
}

impl Watch {
    /// The events of a scenario, from its start on.
    pub fn new(scenario: &Scenario, start: &GridState) -> Self {
        let watched: Vec<Watched> = scenario
            .events
            .iter()
            .map(|event| Watched {
                function: event.when.clone(),
                direction: event.direction,
                stops: event.action == Action::Stop,
                value: 0.0,
            })
            .collect();
        let count = watched.len();
        let seen = Seen { negative: vec![None; count], undefined: vec![None; count], ..Seen::default() };
        let mut watch = Self { watched, seen, time: start.time, variables: Vec::new(), point: start.clone() };
        watch.stand_at(start);
        for (negative, event) in watch.seen.negative.iter_mut().zip(&watch.watched) {
            *negative = sign(event.value);
        }
        watch
    }

    /// Whether nothing is watched for.
    pub fn is_idle(&self) -> bool {
        self.watched.is_empty()
    }

    /// The time of the state that was looked at last.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// State of the watch.
    pub fn seen(&self) -> &Seen {
        &self.seen
    }

    /// Goes on from a state with what another watch had seen until then.
    pub fn go_on(&mut self, state: &GridState, seen: Seen) {
        self.seen = seen;
        self.stand_at(state);
    }

    /// Takes the values at a state.
    fn stand_at(&mut self, state: &GridState) {
        self.time = state.time;
        place(&mut self.variables, state);
        for (event, undefined) in self.watched.iter_mut().zip(&mut self.seen.undefined) {
            event.value = event.function.value(Moment::inside(state.time), &self.variables);
            if event.value.is_nan() {
                undefined.get_or_insert(state.time);
            }
        }
    }

    /// Looks at the step that has led to `state`, by `interpolate`; keeps what has happened in it, in the
    /// order of time, up to the first event that ends the run, and returns the state there.
    pub fn take(
        &mut self,
        state: &GridState,
        mut interpolate: impl FnMut(f64, &mut GridState),
    ) -> Option<GridState> {
        let (from, to) = (self.time, state.time);
        let mut found: Vec<(f64, usize, bool)> = Vec::new();
        let mut point = std::mem::take(&mut self.point);
        for look in 1..=LOOKS {
            let (before, values) = (self.time, self.values());
            if look == LOOKS {
                point.clone_from(state);
            } else {
                interpolate(from + (to - from) * (look as f64 / LOOKS as f64), &mut point);
            }
            self.stand_at(&point);
            let (now, variables) = (self.time, &mut self.variables);
            let events = self.watched.iter().zip(&mut self.seen.negative).zip(values);
            for (index, ((event, negative), value)) in events.enumerate() {
                let Some(is_negative) = sign(event.value) else {
                    // What lies behind a stretch without numbers is a beginning.
                    if event.value.is_nan() {
                        *negative = None;
                    }
                    continue;
                };
                let rising = !is_negative;
                let wanted = match event.direction {
                    Direction::Both => true,
                    Direction::Rising => rising,
                    Direction::Falling => !rising,
                };
                if negative.replace(is_negative) == Some(rising) && wanted {
                    let value_at = |time: f64| {
                        interpolate(time, &mut point);
                        place(variables, &point);
                        event.function.value(Moment::inside(time), variables)
                    };
                    let time = zero(value_at, (before, value), (now, event.value));
                    // Times to rounding where the step begins are its beginning, whose state was shown.
                    let at_beginning = time - from <= 4.0 * f64::EPSILON * from;
                    found.push((if at_beginning { from } else { time }, index, rising));
                }
            }
        }
        self.point = point;
        let stops = |index: usize| self.watched.get(index).is_some_and(|event| event.stops);
        // What happens at the same time as the end is seen.
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(stops(a.1).cmp(&stops(b.1))));
        let stop = found.iter().position(|&(_, index, _)| stops(index));
        found.truncate(stop.map_or(found.len(), |stop| stop + 1));
        let count = found.len();
        for (number, (time, event, rising)) in (1..).zip(found) {
            let ends = stop.is_some() && number == count;
            // The last one says how the run ended.
            if self.seen.happened.len() >= MOST_EVENTS && !ends {
                self.seen.dropped += 1;
                continue;
            }
            let mut there = state.clone();
            interpolate(time, &mut there);
            let GridState { position, momentum, energy, .. } = there;
            self.seen.happened.push(Happened { event, rising, time, position, momentum, energy });
        }
        stop.and_then(|_| self.seen.happened.last().map(Happened::state))
    }

    fn values(&self) -> Vec<f64> {
        self.watched.iter().map(|event| event.value).collect()
    }
}

/// Puts position and momentum behind each other.
fn place(variables: &mut Vec<f64>, state: &GridState) {
    variables.clear();
    variables.extend(state.position.iter().chain(&state.momentum));
}

/// Whether a value is negative; `None` if it is zero or not a number.
fn sign(value: f64) -> Option<bool> {
    if value < 0.0 {
        Some(true)
    } else if value > 0.0 {
        Some(false)
    } else {
        None
    }
}

/// A zero of a continuous function between two times with its values there, to rounding of the time: regula
/// falsi with halved ordinates (Illinois), where every third step halves the interval. Source:
/// \[DowellJarratt71\].
///
/// The function has another sign at the second time than it last had up to the first, where it may be zero.
pub(super) fn zero(
    mut value: impl FnMut(f64) -> f64,
    (mut low, mut at_low): (f64, f64),
    (mut high, mut at_high): (f64, f64),
) -> f64 {
    if at_low == 0.0 {
        return low;
    }
    for step in 0..MOST_STEPS {
        let width = high - low;
        let secant = low + width * (at_low / (at_low - at_high));
        let middle =
            if step % 3 == 2 || !(secant > low && secant < high) { low + 0.5 * width } else { secant };
        if middle <= low || middle >= high {
            break;
        }
        let found = value(middle);
        if found == 0.0 {
            return middle;
        }
        if (found < 0.0) == (at_high < 0.0) {
            (high, at_high) = (middle, found);
            at_low *= 0.5;
        } else {
            (low, at_low) = (middle, found);
            at_high *= 0.5;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zeros_are_found_to_rounding() {
        let near = |found: f64, exact: f64| (found - exact).abs() <= 2.0 * f64::EPSILON * exact.abs();
        let between = |function: fn(f64) -> f64, from: f64, to: f64| {
            zero(function, (from, function(from)), (to, function(to)))
        };
        assert!(near(between(|t| t * t - 2.0, 1.0, 2.0), 2.0_f64.sqrt()));
        assert!(near(between(|t| 1.0 - t.exp2() / 8.0, 0.0, 100.0), 3.0));
        // A jump.
        assert!(near(between(|t| if t < 0.7 { -1e-9 } else { 1e9 }, 0.0, 1.0), 0.7));
        // Where the interval begins.
        assert_eq!(between(|t| t, 0.0, 1.0), 0.0);
    }

    /// The events of the function on the motion q = sin t, p = cos t over steps of a length.
    fn happened(function: &str, direction: &str, action: &str, step: f64, steps: usize) -> Vec<(f64, bool)> {
        let scenario = Scenario::from_value(&serde_json::json!({
            "system": { "mass": [1.0] },
            "scheme": { "kind": "collocation" },
            "time": { "step": step, "steps": steps },
            "event": [{ "when": function, "direction": direction, "action": action }],
        }))
        .unwrap();
        let motion = |time: f64, state: &mut GridState| {
            *state = GridState {
                time,
                position: vec![time.sin()],
                momentum: vec![time.cos()],
                energy: 0.5,
                ..GridState::default()
            };
        };
        let mut state = GridState::default();
        motion(0.0, &mut state);
        let mut watch = Watch::new(&scenario, &state);
        for step_number in 1..=steps {
            motion(step * step_number as f64, &mut state);
            if watch.take(&state, motion).is_some() {
                break;
            }
        }
        watch.seen().happened.iter().map(|happened| (happened.time, happened.rising)).collect()
    }

    #[test]
    fn events_in_both_directions_several_in_a_step() {
        use std::f64::consts::PI;
        // Steps of 4: more than one zero of sin in some of them.
        for step in [4.0, 0.1, PI / 2.0] {
            let found = happened("q0", "both", "record", step, (12.0 / step) as usize);
            // The zero where the motion starts is no passage.
            assert_eq!(found.len(), 3, "{step}: {found:?}");
            for (k, &(time, rising)) in (1..).zip(&found) {
                assert!((time - f64::from(k) * PI).abs() < 1e-14 * 12.0, "{step}: {time}");
                assert_eq!(rising, k % 2 == 0);
            }
        }
        let falling = happened("q0 - 0.5", "falling", "record", 1.0, 12);
        assert_eq!(falling.len(), 2);
        assert!((falling[0].0 - 5.0 * PI / 6.0).abs() < 1e-14 * 3.0);
    }

    #[test]
    fn nothing_happens_where_there_is_no_number() {
        // Positive before the stretch where q < 0, negative behind it.
        assert_eq!(happened("sqrt(q0)*cos(0.5*t)", "both", "record", 0.1, 120), []);
    }

    #[test]
    fn a_stop_ends_what_is_found() {
        let found = happened("p0", "both", "stop", 4.0, 3);
        assert_eq!(found.len(), 1);
        assert!((found[0].0 - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
    }
}
