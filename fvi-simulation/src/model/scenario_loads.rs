//! The loads of a scenario, and whether its scheme supports exact moments of forces of time.

use fvi_scenario::scenario::{ForceQuadrature, Load, Scenario};
use std::ops::Range;

/// True if the scheme of a scenario supports exact moments of forces of time.
pub(crate) fn takes_moments(scenario: &Scenario) -> bool {
    scenario.system.force_quadrature == ForceQuadrature::Moments && scenario.scheme_descriptor().takes_moments
}

/// The loads of a scenario, each with the range of motions that it acts on.
pub(crate) fn loads(scenario: &Scenario) -> impl Iterator<Item = (&Load, Range<usize>)> {
    let motions = scenario.copies();
    let shared = scenario.system.loads.iter().map(move |load| (load, 0..motions));
    let of_cases = scenario.cases.iter().enumerate();
    shared
        .chain(of_cases.flat_map(|(index, case)| case.loads.iter().map(move |load| (load, index..index + 1))))
}
