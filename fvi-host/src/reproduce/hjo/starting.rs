//! Figure 8: BDF 3 with starting weights on the solution t^{5/2}.

use super::super::error_curve::{ErrorCurve, error_chart, error_table};
use super::super::motion::Motion;
use super::super::problems::{
    GALERKIN, on_any_step, power_plate, with_bdf, with_scheme, with_starting_weights,
};
use super::super::table::{Column, Format, Table};
use super::super::{Findings, ReproduceError};
use super::PLATE_GRIDS;
use crate::converge::Quantity;
use crate::scenario::{Convolution, ConvolutionFamily, Scenario, Scheme};
use std::sync::atomic::AtomicBool;

/// The solution t^ν with BDF 3, starting weights for the given exponents.
fn bdf_3(power: f64, exponents: &[f64]) -> Result<Scenario, ReproduceError> {
    let scenario = with_bdf(with_scheme(power_plate(power, 1.0)?, GALERKIN), 3);
    Ok(on_any_step(with_starting_weights(scenario, exponents)))
}

/// The same with the quadrature of Radau IIA, three stages, whose nodes the force acts at.
fn radau(power: f64) -> Result<Scenario, ReproduceError> {
    let mut scenario =
        with_scheme(power_plate(power, 1.0)?, Scheme::Galerkin { degree: 3, quadrature: None });
    scenario.convolution =
        Convolution { family: ConvolutionFamily::RadauIia { stages: 3 }, starting: Vec::new() };
    Ok(scenario)
}

pub(super) fn figure_8(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let measure = |label: &str, scenario: Scenario| {
        ErrorCurve::measure(label, &scenario, &PLATE_GRIDS, Quantity::Position, stop)
    };
    let curves = [
        measure("t^{5/2}, BDF 3", bdf_3(2.5, &[])?)?,
        measure("t^{5/2}, BDF 3 with starting weights", bdf_3(2.5, &[2.5])?)?,
        measure("t⁴, BDF 3", bdf_3(4.0, &[])?)?,
        measure("t⁴, BDF 3 with starting weights", bdf_3(4.0, &[4.0])?)?,
        measure("t⁴, Radau IIA", radau(4.0)?)?,
    ];
    let [plain, corrected, _, smooth, stages] = &curves;
    let first = first_step(stop)?;
    let steepest = corrected.orders().into_iter().fold(f64::NAN, f64::max);
    let chart = error_chart(
        "Bagley–Torvik equation, α = ¾: starting weights",
        format!("on [0, 1]; {}; Radau IIA: 3 stages, degree 3", GALERKIN.describe()),
        &curves,
        &[2.0, 3.0],
    );
    Ok(Findings::default()
        .with_picture("", "Largest errors of q with and without starting weights", chart)
        .differs(
            "t^{5/2}: slope, BDF 3 with starting weights",
            "almost 3",
            format!(
                "{:.2}; steepest between two levels {steepest:.2}; finest four {:.2}",
                corrected.slope(),
                corrected.slope_of_finest(4)
            ),
            format!(
                "not reproduced, and beyond this scheme. The force acts at the main nodes, a coupling of order 2: with the smooth force of t⁴ and \
                 the quadrature made exact on t⁴ the slope is {:.2} over the finest four, while quadrature at the stages gives {:.2}. For t^{{5/2}} the \
                 correction is as good as q₁, whose relative error does not fall with h (table below)",
                smooth.slope_of_finest(4),
                stages.slope(),
            ),
        )
        .agrees(
            "t^{5/2}: starting weights make the error smaller on the finest grid",
            "yes (curves)",
            {
                let last = |curve: &ErrorCurve| curve.points.last().map_or(f64::NAN, |point| point.1);
                format!("{:.2e} instead of {:.2e}", last(corrected), last(plain))
            },
        )
        .with_table(error_table("", "Largest errors of q", &curves))
        .with_table(first))
}

/// Relative errors of q₁ for t^{5/2} over the grids: what the correction is made from.
fn first_step(stop: &AtomicBool) -> Result<Table, ReproduceError> {
    let columns = vec![Column::new("h", Format::Exact), Column::new("(q₁ − h^{5/2})/h^{5/2}", Format::Error)];
    let mut table = Table::new("first-step", "t^{5/2}: relative error of the first step", columns);
    for level in PLATE_GRIDS.levels {
        let scenario = bdf_3(2.5, &[2.5])?.in_steps(1 << level);
        let step = scenario.time.step;
        let motion = Motion::run("", &scenario, stop)?;
        let exact = libm::pow(step, 2.5);
        table = table.with_row([step.into(), ((motion.states[1].position[0] - exact) / exact).into()]);
    }
    Ok(table)
}
