//! \[HJO\]: figures 2 to 8, tables 1 and 2.

mod oscillator;
mod plate;
mod saturation;
mod starting;
mod tables;

use super::error_curve::ErrorCurve;
use super::problems::{on_any_step, with_bdf, with_scheme};
use super::{Exhibit, ReproduceError};
use fvi_host::converge::{Grids, Quantity};
use fvi_scenario::scenario::{Scenario, Scheme};
use std::sync::atomic::AtomicBool;

pub(super) const EXHIBITS: [Exhibit; 9] = [
    Exhibit::printed(
        "HJO",
        "hjo-fig-2",
        "Fig. 2",
        "saturation of convolution quadrature on powers",
        saturation::figure_2,
    ),
    Exhibit::printed(
        "HJO",
        "hjo-fig-3",
        "Fig. 3",
        "oscillator: positions and energies",
        oscillator::figure_3,
    ),
    Exhibit::printed(
        "HJO",
        "hjo-fig-4",
        "Fig. 4",
        "oscillator: errors with the midpoint rule",
        oscillator::figure_4,
    ),
    Exhibit::printed(
        "HJO",
        "hjo-fig-5",
        "Fig. 5",
        "Bagley–Torvik equation: errors with the midpoint rule",
        plate::figure_5,
    ),
    Exhibit::printed("HJO", "hjo-table-1", "Table 1", "orders with the midpoint rule", tables::table_1),
    Exhibit::printed(
        "HJO",
        "hjo-fig-6",
        "Fig. 6",
        "oscillator: errors with the Galerkin scheme",
        oscillator::figure_6,
    ),
    Exhibit::printed(
        "HJO",
        "hjo-fig-7",
        "Fig. 7",
        "Bagley–Torvik equation: errors with the Galerkin scheme",
        plate::figure_7,
    ),
    Exhibit::printed("HJO", "hjo-fig-8", "Fig. 8", "starting weights", starting::figure_8),
    Exhibit::printed("HJO", "hjo-table-2", "Table 2", "orders with the Galerkin scheme", tables::table_2),
];

/// h = 16/2^i, i = 4…11, on [0, 16].
const OSCILLATOR_GRIDS: Grids = Grids { levels: 4..=11, intervals: 1, from: 0.0 };
/// h = 2^−i, i = 1…8, on [0, 1].
const PLATE_GRIDS: Grids = Grids { levels: 1..=8, intervals: 1, from: 0.0 };

/// Errors of q with BDF 1, 2 and 3, on every grid of the paper.
fn bdf_curves(
    scenario: &Scenario,
    scheme: Scheme,
    grids: &Grids,
    stop: &AtomicBool,
) -> Result<Vec<ErrorCurve>, ReproduceError> {
    (1..=3).map(|order| bdf_curve(format!("BDF {order}"), scenario, scheme, order, grids, stop)).collect()
}

/// Errors of q with one BDF method, on every grid of the paper.
fn bdf_curve(
    label: impl Into<String>,
    scenario: &Scenario,
    scheme: Scheme,
    order: usize,
    grids: &Grids,
    stop: &AtomicBool,
) -> Result<ErrorCurve, ReproduceError> {
    let scenario = on_any_step(with_bdf(with_scheme(scenario.clone(), scheme), order));
    ErrorCurve::measure(label, &scenario, grids, Quantity::Position, stop)
}
