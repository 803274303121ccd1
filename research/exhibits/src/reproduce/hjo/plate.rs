//! Figures 5 and 7: the Bagley–Torvik equation with exact solutions t³ and t^{5/2}.

use super::super::error_curve::{ErrorCurve, error_chart, error_table};
use super::super::problems::{
    GALERKIN, MIDPOINT, cube_plate, power_plate, root_plate, with_bdf, with_scheme,
};
use super::super::{Findings, ReproduceError};
use super::{PLATE_GRIDS, bdf_curve, bdf_curves};
use fvi_host::converge::{Grids, Quantity};
use fvi_scenario::scenario::Scheme;
use std::sync::atomic::AtomicBool;

pub(super) fn figure_5(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    figure(MIDPOINT, ["1", "below 2", "below 2"], stop)
}

pub(super) fn figure_7(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    figure(GALERKIN, ["1", "2", "2"], stop)
}

/// Both solutions with one scheme; `root_orders` are the orders that the paper gives for t^{5/2}.
fn figure(scheme: Scheme, root_orders: [&str; 3], stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let cube = bdf_curves(&cube_plate()?, scheme, &PLATE_GRIDS, stop)?;
    let root = bdf_curves(&root_plate()?, scheme, &PLATE_GRIDS, stop)?;
    let causes = Causes::measure(scheme, stop)?;
    let chart = |what: &str, curves: &[ErrorCurve], slopes: &[f64]| {
        let title = format!("Bagley–Torvik equation, {what}: errors of q");
        error_chart(title, format!("on [0, 1]; {}", scheme.describe()), curves, slopes)
    };
    let mut findings = Findings::default()
        .with_picture("cube", "Solution t³: largest errors", chart("α = ¼, solution t³", &cube, &[1.0, 2.0]))
        .with_picture(
            "root",
            "Solution t^(5/2): largest errors",
            chart("α = ¾, solution t^(5/2)", &root, &[1.0, 2.0]),
        )
        .with_picture(
            "causes",
            "The same equation without memory, and with a smooth force",
            chart("α = ¾, what limits the order", &causes.curves(), &[1.5, 2.0]),
        );
    for (curve, paper) in cube.iter().zip(["1", "2", "2"]) {
        let reason = match (curve.slope() - curve.slope_of_finest(4)).abs() < 0.1 {
            true => String::new(),
            false => format!("from level to level the order is {}", curve.orders_in_words()),
        };
        let quantity = format!("t³: slope, {}", curve.label);
        findings = findings.differs(quantity, paper, curve.slopes_in_words(), reason);
    }
    for (index, (curve, paper)) in root.iter().zip(root_orders).enumerate() {
        let reason = if index == 0 { String::new() } else { falling(curve, &causes, index + 1) };
        findings = findings.differs(
            format!("t^(5/2): slope, {}", curve.label),
            paper,
            curve.slopes_in_words(),
            reason,
        );
    }
    Ok(findings
        .with_table(error_table("cube", "Solution t³: largest errors of q", &cube))
        .with_table(error_table("root", "Solution t^(5/2): largest errors of q", &root))
        .with_table(error_table("causes", "What limits the order: largest errors of q", &causes.curves()))
        .with_remark(format!(
            "For α = ¾ some of the paper's coarsest steps are too long for the explicit fractional force: `fvi run` refuses {}. So few \
             steps do not let the growth show, and they count here as they do in the paper.",
            refused(scheme, stop)?
        )))
}

/// The equation with damping order 3/2 on finer grids: without the memory, and with a smooth force.
struct Causes {
    /// Solution t^(5/2), ρ = 0.
    without_memory: ErrorCurve,
    /// Solution t^(5/2), BDF 3.
    root: ErrorCurve,
    /// Solution t⁴, BDF 2 and BDF 3.
    smooth: [ErrorCurve; 2],
}

impl Causes {
    fn measure(scheme: Scheme, stop: &AtomicBool) -> Result<Self, ReproduceError> {
        let grids = Grids { levels: 1..=11, intervals: 1, from: 0.0 };
        let curve = |label: &str, power, coefficient, order| {
            bdf_curve(label, &power_plate(power, coefficient)?, scheme, order, &grids, stop)
        };
        Ok(Self {
            without_memory: curve("t^(5/2) without memory", 2.5, 0.0, 1)?,
            root: curve("t^(5/2), BDF 3", 2.5, 1.0, 3)?,
            smooth: [curve("t⁴, BDF 2", 4.0, 1.0, 2)?, curve("t⁴, BDF 3", 4.0, 1.0, 3)?],
        })
    }

    fn curves(&self) -> Vec<ErrorCurve> {
        let [second, third] = self.smooth.clone();
        vec![self.without_memory.clone(), self.root.clone(), second, third]
    }
}

/// Explains why the order for t^(5/2) with BDF 2 or 3 is not constant.
fn falling(curve: &ErrorCurve, causes: &Causes, bdf_order: usize) -> String {
    let smooth = &causes.smooth[usize::from(bdf_order == 3)];
    format!(
        "no constant: from level to level the order is {}, and it goes on to 1.5 (BDF 3, finest two: {:.2}). The force starts like √t, which the \
         nodes of the action integrate over the first step only to h^(3/2): without any memory the order of t^(5/2) is {:.2} on the finest \
         grids, and with the smooth force of t⁴ that of BDF {bdf_order} is {:.2}",
        curve.orders_in_words(),
        causes.root.slope_of_finest(2),
        causes.without_memory.slope_of_finest(4),
        smooth.slope_of_finest(4),
    )
}

/// Lists the paper's step sizes that `fvi run` refuses as too long for the explicit fractional force.
fn refused(scheme: Scheme, stop: &AtomicBool) -> Result<String, ReproduceError> {
    let mut words = Vec::new();
    for order in 1..=3 {
        let scenario = with_bdf(with_scheme(root_plate()?, scheme), order);
        let stable = ErrorCurve::measure("", &scenario, &PLATE_GRIDS, Quantity::Position, stop)?;
        match stable.points.first() {
            Some(&(longest, _)) if longest < 0.5 => words.push(format!("BDF {order} with h > {longest}")),
            _ => {}
        }
    }
    Ok(words.join(", "))
}
