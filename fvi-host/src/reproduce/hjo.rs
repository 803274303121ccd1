//! \[HJO\]: figures 2 to 8, tables 1 and 2.

use super::error_curve::{ErrorCurve, error_chart, error_table};
use super::problems::{
    GALERKIN, MIDPOINT, oscillator_from_rest_point, plate_with_cube, plate_with_root, with_bdf, with_scheme,
};
use super::{Exhibit, Findings, Origin, ReproduceError};
use crate::converge::{Grids, Quantity};
use crate::scenario::{Scenario, Scheme};
use std::sync::atomic::AtomicBool;

const fn exhibit(
    name: &'static str,
    number: &'static str,
    title: &'static str,
    compute: fn(&AtomicBool) -> Result<Findings, ReproduceError>,
) -> Exhibit {
    Exhibit { name, origin: Origin::Printed { paper: "HJO", number }, title, compute }
}

pub(super) const EXHIBITS: &[Exhibit] = &[
    exhibit("hjo-table-1", "Table 1", "orders with the midpoint rule", table_1),
    exhibit("hjo-table-2", "Table 2", "orders with the Galerkin scheme of order 4", table_2),
];

/// Errors of BDF 1, 2 and 3 over the grids.
fn bdf_curves(
    scenario: &Scenario,
    scheme: Scheme,
    grids: &Grids,
    stop: &AtomicBool,
) -> Result<Vec<ErrorCurve>, ReproduceError> {
    let measure = |order: usize| {
        let scenario = with_bdf(with_scheme(scenario.clone(), scheme), order);
        ErrorCurve::measure(format!("BDF {order}"), &scenario, grids, Quantity::Position, stop)
    };
    (1..=3).map(measure).collect()
}

fn table_1(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    table_of_orders(MIDPOINT, ["1", "1.8", "1.8"], stop)
}

fn table_2(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    table_of_orders(GALERKIN, ["1", "2", "2"], stop)
}

/// The three problems with one scheme; `root_orders` are the printed ones of the last problem, those of the others are 1, 2, 2.
fn table_of_orders(
    scheme: Scheme,
    root_orders: [&str; 3],
    stop: &AtomicBool,
) -> Result<Findings, ReproduceError> {
    let problems = [
        ("oscillator", "Damped oscillator (α = ½)", oscillator_from_rest_point()?, 4..=11, ["1", "2", "2"]),
        ("cube", "Bagley–Torvik (α = ¼)", plate_with_cube()?, 1..=8, ["1", "2", "2"]),
        ("root", "Bagley–Torvik (α = ¾)", plate_with_root()?, 1..=8, root_orders),
    ];
    let mut findings = Findings::default();
    for (name, words, scenario, levels, printed) in problems {
        let curves = bdf_curves(&scenario, scheme, &Grids { levels, intervals: 1 }, stop)?;
        for (curve, printed) in curves.iter().zip(printed) {
            let ours = format!("{:.2}, finest four {:.2}", curve.slope(), curve.slope_of_finest(4));
            findings = findings.agrees(format!("{words}, {}", curve.label), printed, ours);
        }
        let chart = error_chart(words, scheme.describe(), &curves, &[1.0, 2.0]);
        findings = findings
            .with_picture(name, format!("{words}: errors over step sizes"), chart)
            .with_table(error_table(name, words, &curves));
    }
    Ok(findings)
}
