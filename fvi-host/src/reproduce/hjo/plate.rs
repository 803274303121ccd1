//! Figures 5 and 7: the Bagley–Torvik equation with exact solutions t³ and t^{5/2}.

use super::super::error_curve::{ErrorCurve, error_chart, error_table};
use super::super::problems::{GALERKIN, MIDPOINT, cube_plate, power_plate, root_plate};
use super::super::{Findings, ReproduceError};
use super::{PLATE_GRIDS, bdf_curve, bdf_curves};
use crate::converge::Grids;
use crate::scenario::Scheme;
use std::sync::atomic::AtomicBool;

pub(super) fn figure_5(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    figure(MIDPOINT, ["1", "below 2", "below 2"], stop)
}

pub(super) fn figure_7(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    figure(GALERKIN, ["1", "2", "2"], stop)
}

/// Both solutions with one scheme; `root_orders` are those the paper reads off for t^{5/2}.
fn figure(scheme: Scheme, root_orders: [&str; 3], stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let cube = bdf_curves(&cube_plate()?, scheme, &PLATE_GRIDS, stop)?;
    let root = bdf_curves(&root_plate()?, scheme, &PLATE_GRIDS, stop)?;
    let causes = causes(scheme, stop)?;
    let chart = |what: &str, curves: &[ErrorCurve], slopes: &[f64]| {
        let title = format!("Bagley–Torvik equation, {what}: errors of q");
        error_chart(title, format!("on [0, 1]; {}", scheme.describe()), curves, slopes)
    };
    let mut findings = Findings::default()
        .with_picture("cube", "Solution t³: largest errors", chart("α = ¼, solution t³", &cube, &[1.0, 2.0]))
        .with_picture(
            "root",
            "Solution t^{5/2}: largest errors",
            chart("α = ¾, solution t^{5/2}", &root, &[1.0, 2.0]),
        )
        .with_picture(
            "causes",
            "The same equation without memory, and with a smooth force",
            chart("α = ¾, what limits the order", &causes, &[1.5, 2.0]),
        );
    for (curve, paper) in cube.iter().zip(["1", "2", "2"]) {
        findings = findings.agrees(format!("t³: slope, {}", curve.label), paper, slopes(curve));
    }
    for (index, (curve, paper)) in root.iter().zip(root_orders).enumerate() {
        let reason = if index == 0 { String::new() } else { falling(curve, &causes) };
        findings =
            findings.differs(format!("t^{{5/2}}: slope, {}", curve.label), paper, slopes(curve), reason);
    }
    Ok(findings
        .with_table(error_table("cube", "Solution t³: largest errors of q", &cube))
        .with_table(error_table("root", "Solution t^{5/2}: largest errors of q", &root))
        .with_table(error_table("causes", "What limits the order: largest errors of q", &causes))
        .with_remark(
            "Some of the paper's coarsest steps are longer than the explicit fractional force allows for α = ¾ (`fvi run` refuses them). So \
             few steps do not let the growth show, and they count here as they do in the paper.",
        ))
}

pub(super) fn slopes(curve: &ErrorCurve) -> String {
    format!("{:.2}, finest four {:.2}", curve.slope(), curve.slope_of_finest(4))
}

/// The equation with damping order 3/2, once without the memory and once with a smooth force, down to finer grids.
pub(super) fn causes(scheme: Scheme, stop: &AtomicBool) -> Result<Vec<ErrorCurve>, ReproduceError> {
    let grids = Grids { levels: 1..=11, intervals: 1 };
    let curve = |label: &str, power, coefficient, order| {
        bdf_curve(label, &power_plate(power, coefficient)?, scheme, order, &grids, stop)
    };
    Ok(vec![
        curve("t^{5/2} without memory", 2.5, 0.0, 1)?,
        curve("t^{5/2}, BDF 3", 2.5, 1.0, 3)?,
        curve("t⁴, BDF 2", 4.0, 1.0, 2)?,
        curve("t⁴, BDF 3", 4.0, 1.0, 3)?,
    ])
}

/// Why the order of t^{5/2} is no constant.
fn falling(curve: &ErrorCurve, causes: &[ErrorCurve]) -> String {
    let orders: Vec<String> = curve.orders().iter().map(|order| format!("{order:.2}")).collect();
    format!(
        "no constant: the order is {} from level to level and goes to 1.5 as h → 0. The force starts like √t, which the nodes of the action \
         integrate over the first step only to h^{{3/2}}: without any memory the order of t^{{5/2}} is {:.2} on the finest grids, and with \
         the smooth force of t⁴ that of BDF 3 is {:.2}",
        orders.join(", "),
        causes[0].slope_of_finest(4),
        causes[3].slope_of_finest(4),
    )
}
