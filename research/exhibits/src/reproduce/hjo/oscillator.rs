//! Figures 3, 4 and 6: the damped oscillator.

use super::super::error_curve::{error_chart, error_table};
use super::super::motion::{Motion, motion_chart, motion_table};
use super::super::problems::{GALERKIN, MIDPOINT, hjo_oscillator, with_bdf, with_scheme};
use super::super::table::Table;
use super::super::{Findings, ReproduceError};
use super::{OSCILLATOR_GRIDS, bdf_curves};
use fvi_host::converge::Quantity;
use fvi_host::results::picture::{Axis, Chart, Series, Style};
use fvi_scenario::scenario::{Scenario, Scheme};
use std::sync::atomic::AtomicBool;

const SETTING: &str = "q̈ + 0.2 q̇ + q = 0, q(0) = 0, q̇(0) = 1.2";

/// The three methods with h = 0.125, and the scenario with the exact solution.
fn motions(stop: &AtomicBool) -> Result<([Motion; 3], Scenario), ReproduceError> {
    let scenario = with_bdf(hjo_oscillator()?, 1);
    let run = |label: &str, scheme| Motion::run(label, &with_scheme(scenario.clone(), scheme), stop);
    let motions = [
        run("variational, BDF 1", MIDPOINT)?,
        run("explicit Euler", Scheme::ExplicitEuler)?,
        run("implicit Euler", Scheme::ImplicitEuler)?,
    ];
    Ok((motions, scenario))
}

pub(super) fn figure_3(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let (motions, scenario) = motions(stop)?;
    let [variational, explicit, implicit] = &motions;
    let all = [variational, explicit, implicit];
    let chart = |quantity| {
        motion_chart("Damped oscillator", &format!("{SETTING}; h = 0.125"), quantity, &all, &scenario)
    };
    let rises =
        |motion: &Motion| motion.states.windows(2).filter(|pair| pair[1].energy > pair[0].energy).count();
    let energy = |motion: &Motion| motion.errors(&scenario).energy.largest;
    let steps = scenario.time.steps;
    Ok(Findings::default()
        .with_picture("positions", "Positions of three methods over time", chart(Quantity::Position))
        .with_picture("energies", "Energies of three methods over time", chart(Quantity::Energy))
        .agrees(
            "largest error of the energy: variational, explicit, implicit Euler",
            "variational is closest (curves)",
            format!("{:.1e}, {:.1e}, {:.1e}", energy(variational), energy(explicit), energy(implicit)),
        )
        .differs(
            "steps in which the energy of the variational integrator rises",
            "none: “energy is always dissipated”",
            format!("{} of {steps}", rises(variational)),
            "the decay is that of the exact energy up to the error; where the momentum is near zero, so is the dissipation, and the \
             error decides the sign of a step's change",
        )
        .with_table(motion_table("", "The motions", &[Quantity::Position, Quantity::Energy], &all)))
}

pub(super) fn figure_4(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let (motions, scenario) = motions(stop)?;
    let mut chart = Chart::new(
        "Damped oscillator: absolute errors",
        Axis::linear("time t"),
        Axis::logarithmic("|q − exact|").with_range(1e-5, 1.0),
    )
    .with_subtitle(format!("{SETTING}; h = 0.125"));
    let mut rows = Vec::new();
    for motion in &motions {
        let errors = motion.position_errors(&scenario);
        rows.extend(
            errors.iter().map(|&(t, error)| vec![motion.label.as_str().into(), t.into(), error.into()]),
        );
        chart = chart.with(Series::new(&motion.label, Style::Line, errors));
    }
    let [variational, explicit, implicit] =
        motions.each_ref().map(|motion| motion.errors(&scenario).position.largest);
    let table = Table::of_curves("absolute", "Absolute errors over time", &["motion", "t", "error"], rows);
    let findings = Findings::default()
        .with_picture("absolute", "Absolute errors of three methods over time", chart)
        .agrees(
            "largest error of q with h = 0.125: variational, explicit, implicit Euler",
            "variational is closest (curves)",
            format!("{variational:.1e}, {explicit:.1e}, {implicit:.1e}"),
        )
        .with_table(table);
    orders(findings, MIDPOINT, stop)
}

pub(super) fn figure_6(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    orders(Findings::default(), GALERKIN, stop)
}

/// Adds errors and orders of BDF 1, 2, 3 over the paper's step sizes.
fn orders(findings: Findings, scheme: Scheme, stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let curves = bdf_curves(&hjo_oscillator()?, scheme, &OSCILLATOR_GRIDS, stop)?;
    let chart = error_chart(
        "Damped oscillator: errors of q",
        format!("{SETTING} on [0, 16]; {}", scheme.describe()),
        &curves,
        &[1.0, 2.0],
    );
    let mut findings = findings.with_picture("errors", "Largest errors of q over step sizes", chart);
    for (curve, paper) in curves.iter().zip(["1", "2", "2"]) {
        let reason = if (curve.slope() - curve.slope_of_finest(4)).abs() < 0.1 {
            ""
        } else {
            "the coarsest steps are as long as a sixth of a period; there the leading terms of the error partly cancel"
        };
        let quantity = format!("slope, {}", curve.label);
        findings = findings.differs(quantity, paper, curve.slopes_in_words(), reason);
    }
    Ok(findings.with_table(error_table("errors", "Largest errors of q", &curves)))
}
