//! Oustaloup's recursive filter.

use std::f64::consts::PI;

use fvi_core::{BdfOrder, ParameterError};

use crate::filter_cascade::{FilterCascade, Section};

/// Largest number of sections; where the tolerance needs more, it is not reached.
const MOST_SECTIONS: usize = 160;

/// s^β as poles and zeros in geometric sequence \[Oustaloup00\]: O(sections) a step.
///
/// With n sections between ω_b and ω_h and μ = (ω_h/ω_b)^{1/n}, section k has its zero at
/// ω_b μ^{k + (1−β)/2} and its pole at ω_b μ^{k + (1+β)/2}, and the gain is ω_h^β. For β > 1 one section is
/// s itself and the others are those of β − 1.
///
/// Choices made here: the ripple along iω is e^{−π²/ln μ}, which gives μ for the tolerance; the errors from
/// the ends of the band decrease only like ω_b/ω and ω/ω_h, so that the band extends from `tolerance`/(Nh) to
/// 2/(h · `tolerance`). A section is discretised by the backward differentiation formula of the quadrature.
/// There is no bound on the error of a sum.
///
/// # Errors
/// If β is not between 0 and 2, or is 1; if step or tolerance is outside its range, or there is no channel or
/// capacity.
pub fn oustaloup(
    order: f64,
    formula: BdfOrder,
    step: f64,
    channels: usize,
    capacity: usize,
    tolerance: f64,
) -> Result<FilterCascade, ParameterError> {
    let (mut sections, part) = whole_sections(order)?;
    check_tolerance(tolerance)?;
    let (low, high) = band(step, capacity, tolerance);
    let spacing = PI * PI / -libm::log(tolerance);
    let count = ((libm::log(high / low) / spacing).ceil() as usize).clamp(1, MOST_SECTIONS);
    sections.extend(recursion(part, low, high, count));
    FilterCascade::new(libm::pow(high, part), &sections, formula, step, channels, capacity)
}

/// Zeros and poles of `count` sections between two frequencies.
pub(crate) fn recursion(
    order: f64,
    low: f64,
    high: f64,
    count: usize,
) -> impl Iterator<Item = Section> + Clone {
    let ratio = libm::log(high / low) / count as f64;
    (0..count).map(move |k| {
        let place = |shift: f64| low * libm::exp(ratio * (k as f64 + 0.5 * (1.0 + shift)));
        Section { zero: place(-order), pole: Some(place(order)) }
    })
}

/// The section s for orders above 1 (none otherwise), and the remaining order.
pub(crate) fn whole_sections(order: f64) -> Result<(Vec<Section>, f64), ParameterError> {
    if order > 0.0 && order < 1.0 {
        Ok((Vec::new(), order))
    } else if order > 1.0 && order < 2.0 {
        Ok((vec![Section { zero: 0.0, pole: None }], order - 1.0))
    } else {
        let allowed = "between 0 and 1 or between 1 and 2, where a filter is wanted";
        Err(ParameterError { parameter: "order", value: order, allowed })
    }
}

pub(crate) fn check_tolerance(tolerance: f64) -> Result<(), ParameterError> {
    if tolerance > 0.0 && tolerance < 1.0 {
        return Ok(());
    }
    let allowed = "greater than 0 and less than 1";
    Err(ParameterError { parameter: "tolerance", value: tolerance, allowed })
}

/// Band from the lowest frequency that a run of `capacity` steps resolves to the highest one of the grid,
/// extended by the factor `room` at either end.
pub(crate) fn band(step: f64, capacity: usize, room: f64) -> (f64, f64) {
    (room / (step * capacity as f64), 2.0 / (step * room))
}
