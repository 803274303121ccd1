//! `time.grid = "adaptive"`: what steps keep to that are chosen on the way.

use super::initial::InitialState;
use super::system::{Derivative, System};
use crate::language::document::Table;
use crate::language::error::InputError;

/// Most steps that are made where they are chosen on the way.
pub(super) const MOST_STEPS_CHOSEN: usize = 10_000_000;

/// The shortest step, where the scenario does not say, as a share of the end.
const SHORTEST: f64 = 1e-12;

/// The shortest step that is ever taken, as a share of the end. Where the momentum begins like t^e with e <
/// 1, the first step h leaves an error like h^e, for which `SHORTEST` may be too long: the shortest step is
/// then chosen, down to this bound, so that this error is a small part of the tolerance.
const SHORTEST_OF_ALL: f64 = 1e-30;
const SMALL_PART: f64 = 0.03;

/// The first pair, where no step is short enough, in units of the shortest.
const UNJUDGED: f64 = 1000.0;

/// The shortest step beside the first, where the scenario gives the first and not the shortest: a jump later
/// on may ask for shorter steps than the start.
const SHORTER_THAN_FIRST: f64 = 1e-3;

/// Tolerances that have a meaning in double precision; [`Adaptive::smallest_tolerance`] knows those of single
/// precision.
const SMALLEST_TOLERANCE: f64 = 1e-12;
const LARGEST_TOLERANCE: f64 = 0.1;

/// Steps chosen on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// The last time.
    pub end: f64,
    /// Error of position and momentum that each step may add about, relative to the largest value of each
    /// coordinate so far or, while that is smaller, to `scale`.
    pub tolerance: f64,
    /// The first step; absent: found from the error.
    pub first: Option<f64>,
    /// The shortest step.
    pub shortest: f64,
    /// The longest step; absent: any.
    pub longest: Option<f64>,
    /// The size of positions that counts as one; that of momenta is this times the mass, for each unit of
    /// time.
    pub scale: f64,
    /// How the momentum begins.
    pub start: Start,
    /// The first step that the tolerance asks for because of that.
    pub asked: f64,
    /// The first pair of steps, where that is too short a step to be made and the scenario does not say the
    /// shortest; see [`momenta_from`](Self::momenta_from).
    pub unjudged: Option<f64>,
}

/// How the momentum begins: like c m t^e, m the mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// e, at most 1.
    pub power: f64,
    /// c, of all terms the largest; zero where e is 1.
    pub size: f64,
}

impl Adaptive {
    /// Reads the keys.
    pub(super) fn read(table: &Table<'_>, start: Start) -> Result<Self, InputError> {
        let positive = |key: &str| table.optional(key).map(|value| value.positive()).transpose();
        let end = table.required("end")?.positive()?;
        let value = table.required("tolerance")?;
        let tolerance = value.number()?;
        if !(SMALLEST_TOLERANCE..=LARGEST_TOLERANCE).contains(&tolerance) {
            return Err(value.out_of_range(format!(
                "{SMALLEST_TOLERANCE:e} ≤ tolerance ≤ {LARGEST_TOLERANCE}: below, rounding decides and not the steps"
            )));
        }
        let (first, longest) = (positive("first")?, positive("longest")?);
        let scale = positive("scale")?.unwrap_or(1.0);
        let most = (start.size * libm::pow(end, start.power)).max(scale);
        let small = SMALL_PART * tolerance * (scale / most);
        let asked = if start.power < 1.0 { libm::pow(small, 1.0 / start.power) * end } else { end };
        let shortest = positive("shortest")?.unwrap_or_else(|| {
            (SHORTEST * end)
                .min(asked.max(SHORTEST_OF_ALL * end))
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
        Ok(Self { end, tolerance, first, shortest, longest, scale, start, asked, unjudged })
    }

    /// From which time on momenta are held to the tolerance, where that is not from the beginning on.
    ///
    /// A quadrature of the force from the start on forgets what it lost in the first step, as (h/t)^k, k > 1.
    pub fn momenta_from(&self) -> Option<f64> {
        self.unjudged.map(|length| 100.0 * length)
    }

    /// The longest pair of steps from a time on while momenta are not held to the tolerance: steps that grow
    /// like the time, by a tenth each.
    pub fn longest_unjudged(&self, time: f64) -> Option<f64> {
        let first = self.unjudged.filter(|_| self.momenta_from() > Some(time))?;
        Some(if time == 0.0 { first } else { 0.2 * time })
    }

    /// Two neighbouring times, of 0, the given increasing ones and the end, so close that no pair of steps
    /// fits between them; `None` if there are none.
    pub(super) fn too_near(&self, times: &[f64]) -> Option<(f64, f64)> {
        let ends = [&[0.0], times, &[self.end]].concat();
        let near = |pair: &&[f64]| pair[1] > pair[0] && pair[1] - pair[0] < 2.0 * self.shortest;
        ends.windows(2).find(near).map(|pair| (pair[0], pair[1]))
    }

    /// The smallest power of t that the momentum begins with, at most 1: the Riemann–Liouville derivative of
    /// a constant position, or velocity, is a force like t^(−β), or t^(1−β).
    pub(super) fn start(system: &System, initial: &InitialState) -> Start {
        let masses = system.mass.diagonal();
        let by_mass = |force: Vec<f64>| {
            let moved = force.iter().zip(&masses).filter(|(_, mass)| **mass > 0.0);
            moved.fold(0.0_f64, |most, (force, mass)| most.max((force / mass).abs()))
        };
        let terms = system.damping.iter().filter(|term| term.derivative == Derivative::RiemannLiouville);
        let mut start = Start { power: 1.0, size: 0.0 };
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
                            .fold(f64::INFINITY, f64::min),
                    )
                }
                _ => continue,
            };
            if size > 0.0 && power < 1.0 {
                start = Start { power: start.power.min(power), size: start.size.max(size) };
            }
        }
        start
    }

    /// The smallest tolerance in a precision with this rounding unit.
    pub fn smallest_tolerance(epsilon: f64) -> f64 {
        SMALLEST_TOLERANCE.max(32.0 * epsilon)
    }
}
