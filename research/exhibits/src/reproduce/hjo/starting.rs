//! Figure 8: BDF 3 with starting weights on the solution t^{5/2}.

use super::super::error_curve::{ErrorCurve, error_chart, error_table};
use super::super::motion::Motion;
use super::super::problems::{
    GALERKIN, on_any_step, power_plate, with_bdf, with_scheme, with_starting_weights,
};
use super::super::table::{Column, Format, Table};
use super::super::{Findings, ReproduceError};
use super::PLATE_GRIDS;
use fvi_core::max_or_nan;
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_host::converge::Quantity;
use fvi_scenario::scenario::{Convolution, DampedAt, Scenario, Scheme};
use std::sync::atomic::AtomicBool;

/// The solution t^ν with BDF 3, starting weights for the given exponents.
fn bdf_3(power: f64, exponents: &[f64]) -> Result<Scenario, ReproduceError> {
    let scenario = with_bdf(with_scheme(power_plate(power, 1.0)?, GALERKIN), 3);
    Ok(on_any_step(with_starting_weights(scenario, exponents)))
}

/// The same with the quadrature of Radau IIA, three stages, and the force at its nodes.
fn radau(power: f64) -> Result<Scenario, ReproduceError> {
    let mut scenario =
        with_scheme(power_plate(power, 1.0)?, Scheme::Galerkin { degree: 3, quadrature: None });
    scenario.convolution = Convolution {
        family: ConvolutionFamily::RadauIia { stages: 3 },
        at: DampedAt::Nodes,
        starting: Vec::new(),
    };
    Ok(scenario)
}

pub(super) fn figure_8(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let measure = |label: &str, scenario: Scenario| {
        ErrorCurve::measure(label, &scenario, &PLATE_GRIDS, Quantity::Position, stop)
    };
    let curves = [
        measure("t^(5/2), BDF 3", bdf_3(2.5, &[])?)?,
        measure("t^(5/2), BDF 3 with starting weights", bdf_3(2.5, &[2.5])?)?,
        measure("t^(5/2) without memory", with_scheme(with_bdf(power_plate(2.5, 0.0)?, 1), GALERKIN))?,
        measure("t^(5/2), Radau IIA", radau(2.5)?)?,
        measure("t⁴, BDF 3 with starting weights", bdf_3(4.0, &[4.0])?)?,
        measure("t⁴, Radau IIA", radau(4.0)?)?,
    ];
    let [plain, corrected, conservative, _, smooth, stages] = &curves;
    let (first, first_limit) = first_step(stop)?;
    let steepest = corrected.orders().into_iter().fold(f64::NEG_INFINITY, max_or_nan);
    let last = |curve: &ErrorCurve| curve.points.last().map_or(f64::NAN, |point| point.1);
    let chart = error_chart(
        "Bagley–Torvik equation, α = ¾: starting weights",
        format!("on [0, 1]; {}; Radau IIA: 3 stages, degree 3", GALERKIN.describe()),
        &curves,
        &[2.0, 3.0],
    );
    Ok(Findings::default()
        .with_picture("", "Largest errors of q with and without starting weights", chart)
        .differs(
            "t^(5/2): slope, BDF 3 with starting weights",
            "almost 3",
            format!(
                "{:.2}; steepest between two levels {steepest:.2}; finest four {:.2}",
                corrected.slope(),
                corrected.slope_of_finest(4)
            ),
            format!(
                "not reproduced, and out of reach: without any memory the order of t^(5/2) is {:.2}, since its force starts like √t. With the \
                 smooth force of t⁴ and the quadrature made exact on t⁴ it is {:.2}, the order of a force at the main nodes; a force at \
                 the stages gives {:.2}",
                conservative.slope_of_finest(4),
                smooth.slope_of_finest(4),
                stages.slope(),
            ),
        )
        .differs(
            "t^(5/2): error on the finest grid, with and without starting weights",
            "smaller with them (curves)",
            format!("{:.2e} and {:.2e}", last(corrected), last(plain)),
            format!(
                "the correction is as good as q₁, whose relative error goes to {first_limit:.3} as h → 0 (table below); \
                 without it the error of the quadrature offsets a part of that of the first step"
            ),
        )
        .with_table(error_table("", "Largest errors of q", &curves))
        .with_table(first)
        .with_table(exponent_lists(stop)?))
}

/// Slopes with other exponents than that of the solution.
fn exponent_lists(stop: &AtomicBool) -> Result<Table, ReproduceError> {
    let columns = vec![
        Column::new("exponents", Format::Exact),
        Column::new("error, h = 1/256", Format::Error),
        Column::new("slope", Format::Order),
        Column::new("slope, finest four", Format::Order),
    ];
    let caption = "t^(5/2), BDF 3: other starting exponents; the paper does not print its own";
    let mut table = Table::new("exponents", caption, columns);
    let lists: [&[f64]; 6] =
        [&[2.5], &[1.0, 2.5], &[1.5, 2.5], &[2.0, 2.5], &[1.0, 1.5, 2.0], &[0.5, 1.0, 1.5, 2.0, 2.5]];
    for exponents in lists {
        let curve = ErrorCurve::measure("", &bdf_3(2.5, exponents)?, &PLATE_GRIDS, Quantity::Position, stop)?;
        let words: Vec<String> = exponents.iter().map(f64::to_string).collect();
        table = table.with_row([
            words.join(" ").as_str().into(),
            curve.points.last().map(|point| point.1).into(),
            curve.slope().into(),
            curve.slope_of_finest(4).into(),
        ]);
    }
    Ok(table)
}

/// Relative errors of q₁, from which the starting correction is computed, for t^(5/2) on all grids, and their
/// limit c as h → 0.
///
/// They are c + d √h + …: c is the quadrature error at the nodes for a force like √t, d √h comes from the
/// damping, which the first step lacks.
fn first_step(stop: &AtomicBool) -> Result<(Table, f64), ReproduceError> {
    let columns = vec![Column::new("h", Format::Exact), Column::new("(q₁ − h^(5/2))/h^(5/2)", Format::Error)];
    let mut table = Table::new("first-step", "t^(5/2): relative error of the first step", columns);
    let (mut before, mut limit) = (f64::NAN, f64::NAN);
    for level in PLATE_GRIDS.levels {
        let scenario = bdf_3(2.5, &[2.5])?.in_steps(1 << level);
        let step = scenario.time.step;
        let motion = Motion::run("", &scenario, stop)?;
        let exact = libm::pow(step, 2.5);
        let error = (motion.states[1].position[0] - exact) / exact;
        limit = (core::f64::consts::SQRT_2 * error - before) / (core::f64::consts::SQRT_2 - 1.0);
        before = error;
        table = table.with_row([step.into(), error.into()]);
    }
    Ok((table, limit))
}
