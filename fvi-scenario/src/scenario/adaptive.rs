//! `time.grid = "adaptive"`: what steps keep to that are chosen on the way.

use super::initial::InitialState;
use super::system::{Derivative, System};
use crate::language::document::Table;
use crate::language::error::InputError;

/// Most steps that are made where they are chosen on the way.
pub(super) const MOST_STEPS_CHOSEN: usize = 10_000_000;

/// The shortest step, where the scenario does not say, as a share of the end.
const SHORTEST: f64 = 1e-12;

/// Where the momentum begins like t^e with e < 1 the first step h leaves an error like h^e, and `SHORTEST` is
/// too long. Down to this share of the end the shortest step is where that is a small part of the tolerance.
const SHORTEST_OF_ALL: f64 = 1e-30;
const SMALL_PART: f64 = 0.03;

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
}

impl Adaptive {
    /// Reads the keys. The momentum begins like t to the power of `start`.
    pub(super) fn read(table: &Table<'_>, start: f64) -> Result<Self, InputError> {
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
        let shortest = positive("shortest")?.unwrap_or_else(|| {
            let singular = libm::pow(SMALL_PART * tolerance, 1.0 / start).max(SHORTEST_OF_ALL);
            (SHORTEST.min(singular) * end)
                .min(first.map_or(f64::INFINITY, |first| SHORTER_THAN_FIRST * first))
                .min(longest.map_or(f64::INFINITY, |longest| SHORTER_THAN_FIRST * longest))
        });
        let scale = positive("scale")?.unwrap_or(1.0);
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
        Ok(Self { end, tolerance, first, shortest, longest, scale })
    }

    /// Two neighbours of 0, some increasing times and the end between which no pair of steps fits.
    pub(super) fn too_near(&self, times: &[f64]) -> Option<(f64, f64)> {
        let ends = [&[0.0], times, &[self.end]].concat();
        let near = |pair: &&[f64]| pair[1] > pair[0] && pair[1] - pair[0] < 2.0 * self.shortest;
        ends.windows(2).find(near).map(|pair| (pair[0], pair[1]))
    }

    /// The smallest power of t that the momentum begins with, at most 1: the Riemann–Liouville derivative of
    /// a constant position, or velocity, is a force like t^(−β), or t^(1−β).
    pub(super) fn start(system: &System, initial: &InitialState) -> f64 {
        let moves = |numbers: &[f64]| numbers.iter().any(|&number| number != 0.0);
        let terms = system.damping.iter().filter(|term| term.derivative == Derivative::RiemannLiouville);
        let power = |order: f64| match order {
            order if order < 1.0 && moves(&initial.position) => 1.0 - order,
            order if order > 1.0 && moves(&initial.momentum) => 2.0 - order,
            _ => 1.0,
        };
        terms.map(|term| power(term.transfer.growth())).fold(1.0, f64::min)
    }

    /// The smallest tolerance in a precision with this rounding unit.
    pub fn smallest_tolerance(epsilon: f64) -> f64 {
        SMALLEST_TOLERANCE.max(32.0 * epsilon)
    }
}
