//! Times at which a motion is rough, where adaptive steps must end: jumps, kinks and roots of forces of time,
//! terms narrower than the step, samples, and times required by the scenario.

use crate::model::tape::{RoughArguments, TimeTerms};
use fvi_scenario::scenario::{Amplitude, Scenario};

/// The breaks of a scenario.
pub(super) struct Breaks {
    /// Breaks known in advance, ascending, the end last.
    known: Vec<f64>,
    /// Arguments whose zeros are searched for in each step.
    curved: Option<Curved>,
    /// Functions of time that steps must resolve, and the tolerance.
    narrow: Option<(TimeTerms, f64)>,
    /// Smallest distance between breaks.
    apart: f64,
}

/// Arguments of jumps, kinks and roots that are not linear in time.
struct Curved {
    arguments: RoughArguments,
    sought: Vec<usize>,
    apart: f64,
    registers: Vec<f64>,
    values: Vec<f64>,
}

impl Breaks {
    /// The breaks of a scenario up to its end; steps are at least `shortest` long.
    pub(super) fn of(scenario: &Scenario, shortest: f64) -> Self {
        let (end, apart) = (scenario.time.end(), 2.5 * shortest);
        let amplitudes = scenario.system.loads.iter().map(|load| &load.amplitude);
        let expressions = amplitudes.clone().filter_map(|amplitude| match amplitude {
            Amplitude::Expression(expression) => Some(expression),
            Amplitude::Record(_) => None,
        });
        let expressions: Vec<_> = scenario.system.force.iter().flatten().chain(expressions).collect();
        let arguments = RoughArguments::anywhere_in(expressions.iter().copied());
        let tolerance = scenario.time.adaptive().map_or(0.0, |adaptive| adaptive.tolerance);
        let narrow = TimeTerms::anywhere_in(expressions.iter().copied(), end);
        let narrow = narrow.map(|terms| (terms, tolerance));
        let zeros = arguments.iter().flat_map(RoughArguments::arguments).filter_map(|argument| argument.zero);
        let records = amplitudes.flat_map(|amplitude| match amplitude {
            Amplitude::Record(record) => record.rows().iter().map(|&(time, _)| time).collect(),
            Amplitude::Expression(_) => Vec::new(),
        });
        let samples = scenario.input.iter().flat_map(|input| input.times.iter().copied());
        let asked: Vec<f64> = scenario.time.grid.iter().flat_map(|grid| grid.times()).copied().collect();
        let mut found: Vec<f64> = zeros.chain(records).chain(samples).collect();
        found.sort_by(f64::total_cmp);
        // Times required by the scenario are kept exactly; breaks equal to them up to rounding are dropped.
        let near = |times: &[f64], time: f64| {
            let after = times.partition_point(|&other| other < time);
            let room = apart.max(1e-12 * time.abs());
            times.iter().skip(after.saturating_sub(1)).take(2).any(|other| (other - time).abs() < room)
        };
        let mut known: Vec<f64> = Vec::new();
        for time in found {
            if time > 0.0 && time < end && !near(&asked, time) && !near(&known, time) {
                known.push(time);
            }
        }
        known.extend(asked.into_iter().filter(|&time| time > 0.0));
        known.sort_by(f64::total_cmp);
        let curved = arguments.and_then(|arguments| Curved::of(arguments, apart));
        Self { known, curved, narrow, apart }
    }

    /// The first break after a time; breaks not known in advance are searched for up to `reach` only.
    pub(super) fn after(&mut self, time: f64, reach: f64) -> f64 {
        let index = self.known.partition_point(|&other| other <= time);
        let known = self.known.get(index).copied().unwrap_or(reach);
        let next = match self.curved.as_mut().and_then(|curved| curved.first(time, known.min(reach))) {
            // Not if it equals, up to rounding, the beginning of the step or the known break.
            Some(found) if found - time > self.apart && known - found > self.apart => found,
            _ => known,
        };
        let Some((terms, tolerance)) = &mut self.narrow else { return next };
        let farthest = next.min(reach);
        let seen = terms.reach(time, farthest, *tolerance);
        // No remainder shorter than the shortest step may be left before the next break.
        let is_apart = seen - time > self.apart && next - seen > 4.0 * self.apart;
        if seen < farthest && is_apart { seen } else { next }
    }
}

impl Curved {
    /// `None` if every argument is linear.
    fn of(arguments: RoughArguments, apart: f64) -> Option<Self> {
        let all = arguments.arguments().iter().enumerate();
        let sought: Vec<usize> =
            all.filter(|(_, argument)| argument.zero.is_none()).map(|(index, _)| index).collect();
        let values = vec![0.0; arguments.arguments().len()];
        (!sought.is_empty()).then_some(Self { arguments, sought, apart, registers: Vec::new(), values })
    }

    /// The first time of a change of sign.
    fn first(&mut self, from: f64, to: f64) -> Option<f64> {
        // A zero at the beginning of the step is excluded.
        let from = from + self.apart;
        let mut found = to;
        for position in 0..self.sought.len() {
            let index = self.sought[position];
            if from >= found || self.arguments.keeps_sign(index, from, found) {
                continue;
            }
            let stretch = (from, found - from);
            let mut first = None;
            let room = (&mut self.registers, self.values.as_mut_slice());
            let searched = self.arguments.changes(index, stretch, room, |place, changes| {
                first = changes.then_some(place);
                !changes
            });
            match (first, searched) {
                (Some(place), _) => found = self.closer(index, stretch.0 + place * stretch.1),
                // The range beyond has not been searched.
                (None, Err(time)) if time > from => found = time,
                (None, _) => {}
            }
        }
        (found < to).then_some(found)
    }

    fn negative(&mut self, index: usize, time: f64) -> bool {
        self.arguments.values(time, &mut self.registers, &mut self.values);
        self.values[index] < 0.0
    }

    /// Refines the first time after a change of sign to a few rounding units.
    fn closer(&mut self, index: usize, time: f64) -> f64 {
        let mut width = 2.0 * f64::EPSILON * time.abs();
        let (mut low, mut high) = (time - width, time + width);
        let negative = loop {
            let negative = self.negative(index, low);
            if negative != self.negative(index, high) {
                break negative;
            }
            width *= 2.0;
            if width > 1e-9 * time.abs() {
                return time;
            }
            (low, high) = (time - width, time + width);
        };
        loop {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                return high;
            }
            if self.negative(index, middle) == negative { low = middle } else { high = middle }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn breaks(force: &str, more: &str) -> Breaks {
        let scenario = serde_json::json!({
            "system": { "mass": [1.0], "force": [force] },
            "scheme": { "kind": "collocation" },
            "time": { "grid": "adaptive", "end": 10.0, "tolerance": 1e-6 },
        });
        let mut scenario = scenario;
        if !more.is_empty() {
            scenario["time"]["must_hit"] = serde_json::from_str(more).unwrap();
        }
        Breaks::of(&Scenario::from_value(&scenario).unwrap(), 1e-11)
    }

    #[test]
    fn zeros_of_linear_arguments_are_known_beforehand() {
        let mut found = breaks("8*step(1 - t)*cos(q0) + abs(t - 3.5)", "");
        assert_eq!(found.after(0.0, 10.0), 1.0);
        assert_eq!(found.after(1.0, 10.0), 3.5);
        assert_eq!(found.after(3.5, 5.0), 10.0);
    }

    #[test]
    fn zeros_of_other_arguments_are_found_to_rounding() {
        let mut found = breaks("step(sin(t))", "");
        let first = found.after(0.0, 4.0);
        assert!((first - std::f64::consts::PI).abs() < 1e-15 * 4.0, "{first}");
        // Not the break at which the step begins.
        assert_eq!(found.after(first, 5.0), 10.0);
        let second = found.after(first, 6.5);
        assert!((second - 2.0 * std::f64::consts::PI).abs() < 1e-14, "{second}");
    }

    #[test]
    fn zeros_close_to_each_other_are_found_each() {
        let mut found = breaks("step(1e-4 - abs(t - 3.00123))", "");
        for expected in [3.00113, 3.00123, 3.00133] {
            let next = found.after(expected - 1e-5, 10.0);
            assert!((next - expected).abs() < 1e-15 * 8.0, "{next}");
        }
        let mut found = breaks("step(1e-10 - (t - 2)^2)", "");
        assert!((found.after(0.0, 10.0) - (2.0 - 1e-5)).abs() < 1e-13);
        assert!((found.after(2.0 - 1e-5, 10.0) - (2.0 + 1e-5)).abs() < 1e-13);
    }

    #[test]
    fn steps_do_not_run_over_narrow_terms() {
        for width in [1e-2, 1e-4, 1e-6] {
            let mut found = breaks(&format!("sin(t) + exp(-((t - 3.3)/{width})^2)/{width}"), "");
            // The narrow term is approached in few steps, which are as short as the term near it.
            let (mut time, mut steps) = (0.0, 0);
            while time < 3.3 - 3.0 * width {
                let next = found.after(time, time + 4.0);
                let is_short = next - time < 8.0 * width;
                assert!(next > time && (is_short || next < 3.3 - 1.5 * width), "{time} to {next}");
                (time, steps) = (next, steps + 1);
            }
            assert!(steps < 30, "{steps}");
        }
        // Smooth functions do not limit steps.
        for smooth in ["sin(3*t)*exp(-t)", "1/(1 + t^2)", "t^2.5", "sqrt(t)"] {
            assert_eq!(breaks(smooth, "").after(0.0, 1.0), 10.0, "{smooth}");
        }
    }

    #[test]
    fn what_is_asked_for_is_hit_to_the_last_bit() {
        let mut found = breaks("step(0.3 - t) + step(t - 1/3)", "[0.1, 0.30000000000000004, 7.0]");
        let hit: Vec<f64> = std::iter::successors(Some(0.0), |&time| {
            let next = found.after(time, 10.0);
            (next > time).then_some(next)
        })
        .take(6)
        .collect();
        assert_eq!(hit, [0.0, 0.1, 0.300_000_000_000_000_04, 1.0 / 3.0, 7.0, 10.0]);
    }
}
