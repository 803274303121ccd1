//! Events: zero crossings of functions of the motion.

use super::GridState;
use fvi_scenario::language::expression::{Expression, Moment};
use fvi_scenario::scenario::{Action, Direction, Event, Scenario, SharedFunction};
use serde::{Deserialize, Serialize};

/// Number of parts of a step at whose ends signs are evaluated: two zeros within one part are not detected.
const LOOKS: usize = 8;

/// Largest number of steps of the search for a zero; every third one halves the interval.
const MOST_STEPS: usize = 200;

/// An event that has happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EventRecord {
    /// Index of the event in the scenario, from 0.
    pub event: usize,
    /// True if its function was rising.
    pub rising: bool,
    /// Its time.
    pub time: f64,
    /// Position there.
    pub position: Vec<f64>,
    /// Momentum there.
    pub momentum: Vec<f64>,
    /// Energy there.
    pub energy: f64,
}

impl EventRecord {
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

/// Largest number of events stored.
const MOST_EVENTS: usize = 100_000;

/// State of a watch needed to continue in a later run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WatchState {
    /// The events, in the order of time.
    pub happened: Vec<EventRecord>,
    /// Number of events beyond the largest number stored.
    pub dropped: usize,
    /// For each function the first time at which it was not a number.
    pub undefined: Vec<Option<f64>>,
    /// For each function whether its last nonzero value was negative; `None` if there was none since the
    /// beginning or since it was not a number.
    negative: Vec<Option<bool>>,
}

/// Detection of the events of a scenario.
pub struct Watch {
    watched: Vec<Watched>,
    seen: WatchState,
    time: f64,
    /// Position and momentum as variables of functions.
    variables: Vec<f64>,
    point: GridState,
}

struct Watched {
    function: Function,
    direction: Direction,
    stops: bool,
    /// Its value at the last evaluation.
    value: f64,
}

/// The function of an event.
enum Function {
    Written(Expression),
    InCode(SharedFunction),
}

impl Function {
    fn of(event: &Event) -> Self {
        match &event.own {
            Some(function) => Self::InCode(function.clone()),
            None => Self::Written(event.when.clone()),
        }
    }

    /// Its value at a time, position and momentum; the latter two are contiguous in `variables`.
    fn value(&self, time: f64, variables: &[f64]) -> f64 {
        match self {
            Self::Written(expression) => expression.value(Moment::inside(time), variables),
            Self::InCode(function) => {
                let (position, momentum) = variables.split_at(variables.len() / 2);
                function.value(time, position, momentum)
            }
        }
    }
}

impl Watch {
    /// The events of a scenario, from its start on.
    pub fn new(scenario: &Scenario, start: &GridState) -> Self {
        let watched: Vec<Watched> = scenario
            .events
            .iter()
            .map(|event| Watched {
                function: Function::of(event),
                direction: event.direction,
                stops: event.action == Action::Stop,
                value: 0.0,
            })
            .collect();
        let count = watched.len();
        let seen =
            WatchState { negative: vec![None; count], undefined: vec![None; count], ..WatchState::default() };
        let mut watch = Self { watched, seen, time: start.time, variables: Vec::new(), point: start.clone() };
        watch.stand_at(start);
        for (negative, event) in watch.seen.negative.iter_mut().zip(&watch.watched) {
            *negative = sign(event.value);
        }
        watch
    }

    /// True if there are no events.
    pub fn is_idle(&self) -> bool {
        self.watched.is_empty()
    }

    /// The time of the last state examined.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// State of the watch.
    pub fn seen(&self) -> &WatchState {
        &self.seen
    }

    /// Continues from a state with the state of another watch.
    pub fn resume(&mut self, state: &GridState, seen: WatchState) {
        self.seen = seen;
        self.stand_at(state);
    }

    /// Evaluates the functions at a state.
    fn stand_at(&mut self, state: &GridState) {
        self.time = state.time;
        place(&mut self.variables, state);
        for (event, undefined) in self.watched.iter_mut().zip(&mut self.seen.undefined) {
            event.value = event.function.value(state.time, &self.variables);
            if event.value.is_nan() {
                undefined.get_or_insert(state.time);
            }
        }
    }

    /// Examines the step that has led to `state`, by `interpolate`; stores its events in the order of time,
    /// up to the first one that ends the run, and returns the state there.
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
                    // The first value after a range without numbers is a beginning.
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
                        event.function.value(time, variables)
                    };
                    let time = zero(value_at, (before, value), (now, event.value));
                    // A time equal to the beginning of the step up to rounding is the beginning, whose state
                    // has been shown.
                    let at_beginning = time - from <= 4.0 * f64::EPSILON * from;
                    found.push((if at_beginning { from } else { time }, index, rising));
                }
            }
        }
        self.point = point;
        let stops = |index: usize| self.watched.get(index).is_some_and(|event| event.stops);
        // Events at the same time as the one that ends the run are included.
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(stops(a.1).cmp(&stops(b.1))));
        let stop = found.iter().position(|&(_, index, _)| stops(index));
        found.truncate(stop.map_or(found.len(), |stop| stop + 1));
        let count = found.len();
        for (number, (time, event, rising)) in (1..).zip(found) {
            let ends = stop.is_some() && number == count;
            // The event that ends the run is always stored.
            if self.seen.happened.len() >= MOST_EVENTS && !ends {
                self.seen.dropped += 1;
                continue;
            }
            let mut there = state.clone();
            interpolate(time, &mut there);
            let GridState { position, momentum, energy, .. } = there;
            self.seen.happened.push(EventRecord { event, rising, time, position, momentum, energy });
        }
        stop.and_then(|_| self.seen.happened.last().map(EventRecord::state))
    }

    fn values(&self) -> Vec<f64> {
        self.watched.iter().map(|event| event.value).collect()
    }
}

/// Copies position and momentum to a contiguous list.
fn place(variables: &mut Vec<f64>, state: &GridState) {
    variables.clear();
    variables.extend(state.position.iter().chain(&state.momentum));
}

/// True if a value is negative; `None` if it is zero or not a number.
fn sign(value: f64) -> Option<bool> {
    if value < 0.0 {
        Some(true)
    } else if value > 0.0 {
        Some(false)
    } else {
        None
    }
}

/// A zero of a continuous function between two times with the given values, to rounding of the time: regula
/// falsi with halved ordinates (Illinois), where every third step halves the interval. Source:
/// \[DowellJarratt71\].
///
/// The sign at the second time differs from the last nonzero sign up to the first time, where the function
/// may be zero.
#[doc(hidden)]
pub fn zero(
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

    /// The events of the function for the motion q = sin t, p = cos t over steps of the given length.
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
            // The zero at the start of the motion is not a crossing.
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
        // Positive before the range with q < 0, negative after it.
        assert_eq!(happened("sqrt(q0)*cos(0.5*t)", "both", "record", 0.1, 120), []);
    }

    #[test]
    fn a_stop_ends_what_is_found() {
        let found = happened("p0", "both", "stop", 4.0, 3);
        assert_eq!(found.len(), 1);
        assert!((found[0].0 - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
    }
}
