//! Tables 1 and 2: orders of three problems with three BDF methods.

use super::super::problems::{GALERKIN, MIDPOINT, cube_plate, hjo_oscillator, root_plate};
use super::super::table::{Cell, Column, Format, Table};
use super::super::{Findings, ReproduceError};
use super::{OSCILLATOR_GRIDS, PLATE_GRIDS, bdf_curves};
use fvi_scenario::scenario::Scheme;
use std::sync::atomic::AtomicBool;

pub(super) fn table_1(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    orders(MIDPOINT, [1.0, 1.8, 1.8], "`hjo-fig-4`, `hjo-fig-5`", stop)
}

pub(super) fn table_2(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    orders(GALERKIN, [1.0, 2.0, 2.0], "`hjo-fig-6`, `hjo-fig-7`", stop)
}

/// Levels of every problem in these tables.
const LEVELS: usize = 8;

/// The three problems with one scheme; `root_orders` are the printed ones of the last, those of the others
/// are 1, 2, 2.
fn orders(
    scheme: Scheme,
    root_orders: [f64; 3],
    figures: &str,
    stop: &AtomicBool,
) -> Result<Findings, ReproduceError> {
    let problems = [
        ("damped oscillator, α = ½", hjo_oscillator()?, OSCILLATOR_GRIDS, [1.0, 2.0, 2.0]),
        ("Bagley–Torvik, α = ¼", cube_plate()?, PLATE_GRIDS, [1.0, 2.0, 2.0]),
        ("Bagley–Torvik, α = ¾", root_plate()?, PLATE_GRIDS, root_orders),
    ];
    let text = |name: &str| Column::new(name, Format::Exact);
    let levels =
        (1..LEVELS).map(|level| Column::new(format!("level {level} to {}", level + 1), Format::Order));
    let columns =
        [text("problem"), text("quadrature"), text("printed order"), Column::new("slope", Format::Order)];
    let caption = "Slopes over all levels, and orders from level to level, the longest step first";
    let mut table = Table::new("", caption, columns.into_iter().chain(levels).collect());
    let mut findings = Findings::default();
    for (problem, scenario, grids, printed) in problems {
        for (curve, printed) in bdf_curves(&scenario, scheme, &grids, stop)?.iter().zip(printed) {
            let near = |slope: f64| (slope - printed).abs() < 0.1;
            let reason = match near(curve.slope()) && near(curve.slope_of_finest(4)) {
                true => String::new(),
                false => format!("the order changes from level to level (table below); why: {figures}"),
            };
            let quantity = format!("{problem}, {}", curve.label);
            findings =
                findings.differs(quantity, format!("order {printed}"), curve.slopes_in_words(), reason);
            let known: [Cell; 4] =
                [problem.into(), curve.label.as_str().into(), printed.into(), curve.slope().into()];
            table = table.with_row(known.into_iter().chain(curve.orders().into_iter().map(Cell::from)));
        }
    }
    Ok(findings
        .with_table(table)
        .with_remark(format!("Errors and pictures: {figures}. Scheme: {}.", scheme.describe())))
}
