//! Times at which a motion is rough, where steps that are chosen on the way must end: jumps, kinks and roots
//! of forces of time, samples, and what the scenario asks for.

use crate::model::tape::RoughArguments;
use crate::scenario::{Amplitude, Scenario};

/// Parts of a step in which the sign of an argument is looked at.
const LOOKS: usize = 16;

/// The breaks of a scenario.
pub(super) struct Breaks {
    /// Those known beforehand, ascending, the end last.
    known: Vec<f64>,
    /// Arguments whose zeros are sought step by step.
    curved: Option<Curved>,
    /// Nothing is closer to another break than this.
    apart: f64,
}

/// Arguments of jumps, kinks and roots that are not linear in time.
struct Curved {
    arguments: RoughArguments,
    sought: Vec<usize>,
    registers: Vec<f64>,
    values: Vec<f64>,
}

impl Breaks {
    /// Those of a scenario up to its end; steps are no shorter than `shortest`.
    pub(super) fn of(scenario: &Scenario, shortest: f64) -> Self {
        let (end, apart) = (scenario.time.end(), 2.5 * shortest);
        let amplitudes = scenario.system.loads.iter().map(|load| &load.amplitude);
        let expressions = amplitudes.clone().filter_map(|amplitude| match amplitude {
            Amplitude::Expression(expression) => Some(expression),
            Amplitude::Record(_) => None,
        });
        let arguments =
            RoughArguments::anywhere_in(scenario.system.force.iter().flatten().chain(expressions));
        let zeros = arguments.iter().flat_map(RoughArguments::arguments).filter_map(|argument| argument.zero);
        let records = amplitudes.flat_map(|amplitude| match amplitude {
            Amplitude::Record(record) => record.rows().iter().map(|&(time, _)| time).collect(),
            Amplitude::Expression(_) => Vec::new(),
        });
        let samples = scenario.input.iter().flat_map(|input| input.times.iter().copied());
        let asked: Vec<f64> = scenario.time.grid.iter().flat_map(|grid| grid.times()).copied().collect();
        let mut found: Vec<f64> = zeros.chain(records).chain(samples).collect();
        found.sort_by(f64::total_cmp);
        // What the scenario asks for stays to the last bit; what is found there to rounding is the same.
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
        let curved = arguments.and_then(Curved::of);
        Self { known, curved, apart }
    }

    /// The first break after a time; one that is not known beforehand is sought up to `reach` only.
    pub(super) fn after(&mut self, time: f64, reach: f64) -> f64 {
        let index = self.known.partition_point(|&other| other <= time);
        let known = self.known.get(index).copied().unwrap_or(reach);
        let Some(curved) = &mut self.curved else { return known };
        match curved.first(time, known.min(reach)) {
            // To rounding the break at which the step begins, or the one that is known.
            Some(found) if found - time > self.apart && known - found > self.apart => found,
            _ => known,
        }
    }
}

impl Curved {
    /// `None` if every argument is linear.
    fn of(arguments: RoughArguments) -> Option<Self> {
        let all = arguments.arguments().iter().enumerate();
        let sought: Vec<usize> =
            all.filter(|(_, argument)| argument.zero.is_none()).map(|(index, _)| index).collect();
        let values = vec![0.0; arguments.arguments().len()];
        (!sought.is_empty()).then_some(Self { arguments, sought, registers: Vec::new(), values })
    }

    /// The first time of a change of sign.
    fn first(&mut self, from: f64, to: f64) -> Option<f64> {
        let at = |look: usize| from + (to - from) * (look as f64 / LOOKS as f64);
        let mut found = f64::INFINITY;
        for position in 0..self.sought.len() {
            let index = self.sought[position];
            // A zero where the step begins is behind it.
            let mut before = self.negative(index, from + 1e-3 * (at(1) - from));
            for look in 1..=LOOKS {
                if at(look) >= found {
                    break;
                }
                let now = self.negative(index, at(look));
                if now != before {
                    found = self.bisect(index, before, at(look - 1), at(look));
                    break;
                }
                before = now;
            }
        }
        found.is_finite().then_some(found)
    }

    fn negative(&mut self, index: usize, time: f64) -> bool {
        self.arguments.values(time, &mut self.registers, &mut self.values);
        self.values[index] < 0.0
    }

    fn bisect(&mut self, index: usize, negative: bool, mut low: f64, mut high: f64) -> f64 {
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
        // Not the one where the step begins.
        assert_eq!(found.after(first, 5.0), 10.0);
        let second = found.after(first, 6.5);
        assert!((second - 2.0 * std::f64::consts::PI).abs() < 1e-14, "{second}");
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
