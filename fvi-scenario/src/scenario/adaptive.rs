//! `time.grid = "adaptive"`: settings for steps chosen during the run.

use super::initial::InitialState;
use super::system::{Derivative, System};
use crate::language::document::Table;
use crate::language::error::InputError;
use crate::language::expression::Moment;
use fvi_core::{max_or_nan, min_or_nan};
use fvi_fft::exponentials::rate_table::SMALLEST_TOLERANCE as SMALLEST_ERROR_OF_RATES;
use fvi_fft::memory::RATE_TOLERANCE;
use std::ops::RangeInclusive;

/// Largest number of steps chosen during the run.
pub(super) const MOST_STEPS_CHOSEN: usize = 10_000_000;

/// The shortest step, if the scenario does not give it, as a fraction of the end.
const SHORTEST: f64 = 1e-12;

/// The shortest step in any case, as a fraction of the end. If the momentum begins like t^e with e < 1, the
/// first step h leaves an error like h^e, for which `SHORTEST` may be too long: the shortest step is then
/// chosen, down to this bound, such that this error is `SMALL_PART` of the tolerance.
const SHORTEST_OF_ALL: f64 = 1e-30;
const SMALL_PART: f64 = 0.03;

/// The same where positions of coordinates without mass begin like t^γ, γ < 1. The size of that motion
/// depends on forces and is not known here; the shortest step, which costs rates of the memory only, suffices
/// for this multiple of `scale`. Below the bound the square of a step leaves the range of double precision.
const SHORTEST_OF_CREEP: f64 = 1e-140;
const LARGEST_CREEP: f64 = 1e3;

/// Ends of which the squares of steps, down to the shortest, are in the range of double precision.
const ENDS: RangeInclusive<f64> = 1e-140..=1e140;

/// Margin of the size of that motion where it is known.
const KNOWN_CREEP: f64 = 10.0;

/// The smallest power of a creep that is told apart, and two times at which it is seen how a right side
/// begins.
const LEAST_CREEP: f64 = 1e-3;
const NEAR_START: [f64; 2] = [1e-20, 1e-12];

/// The first pair of steps, in units of the shortest, if no step is short enough.
const UNJUDGED: f64 = 1000.0;

/// The shortest step relative to the first, if the scenario gives the first and not the shortest: a later
/// jump may need shorter steps than the start.
const SHORTER_THAN_FIRST: f64 = 1e-3;

/// Range of tolerances in double precision; see [`Adaptive::smallest_tolerance`] for single precision.
const SMALLEST_TOLERANCE: f64 = 1e-12;
const SMALLEST_OF_EQUATIONS: f64 = 1e-13;
const LARGEST_TOLERANCE: f64 = 0.1;

/// The error of the table of rates as a part of the tolerance: an undamped oscillation of order α makes of it
/// 1/α tolerances in a thousand radians.
const PART_OF_RATES: f64 = 1e-3;

/// The same for an equation, whose table is no more accurate than that, so that short runs are not spent on
/// it.
const PART_OF_RATES_OF_EQUATIONS: f64 = 1e-4;

/// Settings for steps chosen during the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// The last time.
    pub end: f64,
    /// Approximate error of position and momentum allowed per step, relative to the largest value of each
    /// coordinate so far or, while that is smaller, to `scale`.
    pub tolerance: f64,
    /// The first step; absent: chosen from the error.
    pub first: Option<f64>,
    /// The shortest step.
    pub shortest: f64,
    /// The longest step; absent: unlimited.
    pub longest: Option<f64>,
    /// Reference size of positions; see [`velocity_scale`](Self::velocity_scale).
    pub scale: f64,
    /// Behaviour of the momentum at the start.
    pub start: Start,
    /// The first step that the tolerance requires for this behaviour.
    pub asked: f64,
    /// The length in which a creep like t^γ of the size `scale` at the end stays within the tolerance; the
    /// end without one.
    pub creep: f64,
    /// The first pair of steps, if the required step is too short to be made and the scenario does not give
    /// the shortest; see [`momenta_from`](Self::momenta_from).
    pub unjudged: Option<f64>,
}

/// Behaviour at the start: of the momentum like c m t^e, m the mass, of positions without mass like t^γ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// γ, the smallest of all such coordinates, at most 1.
    pub creep: f64,
    /// e, at most 1.
    pub power: f64,
    /// c, the largest of all terms; zero if e is 1.
    pub size: f64,
    /// True if the momentum jumps there: the Riemann–Liouville derivative of order 1 of a position other than
    /// zero is a kick.
    pub kicks: bool,
    /// True for an equation: a tolerance need not be given, and other coordinates than the unknowns begin to
    /// move like any power.
    pub of_equation: bool,
    /// The largest right side of an equation near the start; zero without one.
    pub push: f64,
}

impl Start {
    /// t^γ as messages show it; powers below the smallest that is told apart are not.
    pub fn shown_creep(&self) -> String {
        if self.creep > LEAST_CREEP {
            format!("t^{:.3}", self.creep)
        } else {
            format!("t to a power of {LEAST_CREEP} or less")
        }
    }
}

impl Adaptive {
    /// The tolerance of an equation, if none is given.
    pub(super) const USUAL_TOLERANCE: f64 = 1e-6;

    /// Reads the keys.
    pub(super) fn read(table: &Table<'_>, start: Start) -> Result<Self, InputError> {
        let positive = |key: &str| table.optional(key).map(|value| value.positive()).transpose();
        let end = table.required("end")?.positive()?;
        if !ENDS.contains(&end) {
            let allowed =
                format!("{:e} ≤ end ≤ {:e}: measure time in another unit", ENDS.start(), ENDS.end());
            return Err(table.required("end")?.out_of_range(allowed));
        }
        let tolerance = match (table.optional("tolerance"), start.of_equation) {
            (None, true) => Self::USUAL_TOLERANCE,
            _ => {
                let value = table.required("tolerance")?;
                let tolerance = value.number()?;
                let smallest = if start.of_equation { SMALLEST_OF_EQUATIONS } else { SMALLEST_TOLERANCE };
                if !(smallest..=LARGEST_TOLERANCE).contains(&tolerance) {
                    return Err(value.out_of_range(format!(
                        "{smallest:e} ≤ tolerance ≤ {LARGEST_TOLERANCE}: below, rounding decides and not the steps"
                    )));
                }
                tolerance
            }
        };
        let (first, longest) = (positive("first")?, positive("longest")?);
        let scale = positive("scale")?.unwrap_or(1.0);
        let velocity_scale = scale / end;
        let most = (start.size * libm::pow(end, start.power)).max(velocity_scale);
        let small = SMALL_PART * tolerance * (velocity_scale / most);
        let asked = if start.power < 1.0 { libm::pow(small, 1.0 / start.power) * end } else { end };
        let part_of_creep = |size: f64| match start.creep {
            creep if creep < 1.0 || start.of_equation => {
                libm::pow(SMALL_PART * tolerance / size, 1.0 / creep) * end
            }
            _ => end,
        };
        // Of an equation the size of that motion is known: x − x₀ = f t^γ/Γ(1 + γ).
        let pushed = KNOWN_CREEP * start.push * libm::pow(end, start.creep) / scale;
        let largest_creep = if pushed > LARGEST_CREEP { pushed } else { LARGEST_CREEP };
        let shortest = positive("shortest")?.unwrap_or_else(|| {
            (SHORTEST * end)
                .min(asked.max(SHORTEST_OF_ALL * end))
                .min(part_of_creep(largest_creep).max(SHORTEST_OF_CREEP * end))
                .min(first.map_or(f64::INFINITY, |first| SHORTER_THAN_FIRST * first))
                .min(longest.map_or(f64::INFINITY, |longest| SHORTER_THAN_FIRST * longest))
        });
        let ordered = |key: &str, value: f64, most: f64, of: &str| match table.optional(key) {
            Some(place) if value > most => Err(place.out_of_range(format!("at most {of}, {most}"))),
            _ => Ok(()),
        };
        // Steps are made in pairs.
        ordered("shortest", shortest, 0.5 * end, "half of `time.end`")?;
        ordered("longest", longest.unwrap_or(end), end, "`time.end`")?;
        if let Some(longest) = longest {
            ordered("shortest", shortest, longest, "`time.longest`")?;
        }
        if let (Some(first), Some(place)) = (first, table.optional("first")) {
            let most = longest.unwrap_or(0.5 * end).min(0.5 * end);
            if !(shortest..=most).contains(&first) {
                return Err(
                    place.out_of_range(format!("a first step between the shortest, {shortest}, and {most}"))
                );
            }
        }
        let is_out_of_reach = asked < shortest && table.optional("shortest").is_none();
        let unjudged = is_out_of_reach.then_some(UNJUDGED * shortest);
        let creep = if start.creep < 1.0 { part_of_creep(1.0) } else { end };
        Ok(Self { end, tolerance, first, shortest, longest, scale, start, asked, creep, unjudged })
    }

    /// Reference size of velocities, which times the mass is that of momenta: `scale` in the whole time. An
    /// error of that size moves a free mass by `scale` until the end, in whatever unit time is measured.
    pub fn velocity_scale(&self) -> f64 {
        self.scale / self.end
    }

    /// Time from which momenta are held to the tolerance, if that is later than the start.
    ///
    /// A quadrature of the force from the start on loses the error of the first step, as (h/t)^k, k > 1.
    pub fn momenta_from(&self) -> Option<f64> {
        self.unjudged.map(|length| 100.0 * length)
    }

    /// The longest pair of steps from a time on while momenta are not held to the tolerance: steps grow in
    /// proportion to the time, a tenth of it each.
    pub fn longest_unjudged(&self, time: f64) -> Option<f64> {
        let first = self.unjudged.filter(|_| self.momenta_from() > Some(time))?;
        Some(if time == 0.0 { first } else { 0.2 * time })
    }

    /// Two neighbouring times among 0, the given increasing ones and the end that are too close for a pair of
    /// steps between them; `None` if there are none.
    pub(super) fn too_near(&self, times: &[f64]) -> Option<(f64, f64)> {
        let ends = [&[0.0], times, &[self.end]].concat();
        let near = |pair: &&[f64]| pair[1] > pair[0] && pair[1] - pair[0] < 2.0 * self.shortest;
        ends.windows(2).find(near).map(|pair| (pair[0], pair[1]))
    }

    /// The smallest power of t with which the momentum begins, at most 1: the Riemann–Liouville derivative of
    /// a constant position, or velocity, is a force like t^(−β), or t^(1−β).
    pub(super) fn start(system: &System, initial: &InitialState) -> Start {
        let masses = system.mass.diagonal();
        let by_mass = |force: Vec<f64>| {
            let moved = force.iter().zip(&masses).filter(|(_, mass)| **mass > 0.0);
            moved.map(|(force, mass)| (force / mass).abs()).fold(0.0, max_or_nan)
        };
        let terms = system.damping.iter().filter(|term| term.derivative == Derivative::RiemannLiouville);
        let of_equation = system.stands_for_equation();
        let push = if of_equation { Self::largest_push(system, initial) } else { 0.0 };
        let mut start = Start {
            creep: Self::creep(system, initial),
            power: 1.0,
            size: 0.0,
            kicks: false,
            of_equation,
            push,
        };
        for term in terms {
            let (power, size) = match term.transfer.growth() {
                order if order < 1.0 => (1.0 - order, by_mass(term.coefficient.times(&initial.position))),
                order if order > 1.0 => {
                    let push = by_mass(term.coefficient.times(&initial.momentum));
                    (
                        2.0 - order,
                        push / masses
                            .iter()
                            .copied()
                            .filter(|&mass| mass > 0.0)
                            .fold(f64::INFINITY, min_or_nan),
                    )
                }
                _ => (0.0, by_mass(term.coefficient.times(&initial.position))),
            };
            if size > 0.0 && power == 0.0 {
                start.kicks = true;
            } else if size > 0.0 && power < 1.0 {
                start = Start { power: start.power.min(power), size: start.size.max(size), ..start };
            }
        }
        start
    }

    /// The smallest power of t with which a coordinate without mass begins to move, at most 1: that of the
    /// kernel on its own motion that grows fastest, less what a right side of an equation that is unbounded
    /// at the start takes off. What an equation moves besides its unknowns is held to the tolerance less
    /// tightly the faster it forgets, as if it began like t.
    fn creep(system: &System, initial: &InitialState) -> f64 {
        let mut held: Vec<Option<(f64, f64)>> = vec![None; system.coordinates()];
        for term in &system.damping {
            let (growth, power) = (term.transfer.growth(), term.transfer.creep_power());
            for (held, entry) in held.iter_mut().zip(term.coefficient.diagonal()) {
                // Of two that grow alike the one that begins more steeply.
                let beats = |(most, least): (f64, f64)| growth > most || (growth == most && power < least);
                if entry != 0.0 && held.is_none_or(beats) {
                    *held = Some((growth, power));
                }
            }
        }
        let powers = system.massless().into_iter().filter_map(|row| Some((row, held[row]?.1)));
        let powers = powers.map(|(row, power)| match system.unknowns {
            None => power,
            Some(count) if row < count => (power + Self::push(system, initial, row)).max(LEAST_CREEP),
            Some(_) => (1.0 + Self::push(system, initial, row)).max(LEAST_CREEP),
        });
        powers.fold(1.0, min_or_nan)
    }

    /// The largest finite |f| of the right sides near the start.
    fn largest_push(system: &System, initial: &InitialState) -> f64 {
        let forces = system.force.iter().flatten();
        let values = forces.map(|force| force.value(Moment::inside(NEAR_START[1]), &initial.position));
        values.map(f64::abs).filter(|size| size.is_finite()).fold(0.0, max_or_nan)
    }

    /// The power of t, at most 0, with which the right side of an equation begins: −0.3 for one like t^−0.3,
    /// from its values near the start.
    fn push(system: &System, initial: &InitialState, row: usize) -> f64 {
        let Some(force) = system.force.as_ref().and_then(|force| force.get(row)) else { return 0.0 };
        let at = |time: f64| force.value(Moment::inside(time), &initial.position).abs();
        let [early, late] = NEAR_START.map(at);
        let power = libm::log(early / late) / libm::log(NEAR_START[0] / NEAR_START[1]);
        // Not a number where a value is 0 or none.
        if power < -0.01 { power } else { 0.0 }
    }

    /// The relative error that the memory's table of rates may have; `None` for the usual one.
    pub(super) fn tolerance_of_rates(&self) -> Option<f64> {
        match self.start.of_equation {
            true => Some(self.error_of_rates()),
            false => Some(PART_OF_RATES * self.tolerance).filter(|&error| error < RATE_TOLERANCE),
        }
    }

    /// The relative error of the table of an equation.
    pub fn error_of_rates(&self) -> f64 {
        (PART_OF_RATES_OF_EQUATIONS * self.tolerance).max(SMALLEST_ERROR_OF_RATES)
    }

    /// The smallest tolerance in a precision with this rounding unit.
    pub fn smallest_tolerance(epsilon: f64) -> f64 {
        SMALLEST_OF_EQUATIONS.max(32.0 * epsilon)
    }
}
