//! Matsuda's continued fraction.

use fvi_core::{BdfOrder, ParameterError};
use fvi_fft::exponentials::rational_power::RationalPower;

use crate::filter_cascade::{FilterCascade, Section};
use crate::oustaloup::{band, check_tolerance, whole_sections};

/// Largest number of sections; beyond, rounding destroys the continued fraction.
const MOST_SECTIONS: usize = 16;
/// Margin of the band, as a factor at either end; the fraction is accurate somewhat beyond its points, too.
const ROOM: f64 = 1e-2;

/// s^β as the continued fraction through its gains at points in geometric sequence \[MatsudaFujii93\]:
/// O(sections) a step.
///
/// a_0 + (s − ω_0)/(a_1 + (s − ω_1)/(a_2 + …)) takes the values ω_k^β at s = ω_k. With an odd number of
/// points it has as many zeros as poles, all on the negative real axis, which interlace; the sections that
/// they form are discretised by the backward differentiation formula. For β > 1 one section is s itself.
///
/// Choices made here: points over a band that extends the frequencies of a run of `capacity` steps by a
/// factor of 100 at either end; the smallest number of sections, not more than 16, whose relative error at
/// real s between the points is at most `tolerance`. There is no bound on the error of a sum.
///
/// # Errors
/// If β is not between 0 and 2, or is 1; if step or tolerance is outside its range, or there is no channel or
/// capacity.
pub fn matsuda(
    order: f64,
    formula: BdfOrder,
    step: f64,
    channels: usize,
    capacity: usize,
    tolerance: f64,
) -> Result<FilterCascade, ParameterError> {
    let (mut sections, part) = whole_sections(order)?;
    check_tolerance(tolerance)?;
    let (low, high) = band(step, capacity, ROOM);
    let mut best: Option<RationalPower> = None;
    for count in 1..=MOST_SECTIONS {
        let Some(found) = RationalPower::through_gains(part, low, high, count) else { continue };
        let error = found.error(part, low, high);
        if best.as_ref().is_none_or(|best| error < best.error(part, low, high)) {
            best = Some(found);
        }
        if error <= tolerance {
            break;
        }
    }
    let Some(best) = best else {
        return Err(ParameterError { parameter: "order", value: order, allowed: "one that has a fraction" });
    };
    sections.extend(first_order(&best));
    FilterCascade::new(best.gain, &sections, formula, step, channels, capacity)
}

fn first_order(fraction: &RationalPower) -> impl Iterator<Item = Section> {
    fraction.zeros.iter().zip(&fraction.poles).map(|(&zero, &pole)| Section { zero, pole: Some(pole) })
}
