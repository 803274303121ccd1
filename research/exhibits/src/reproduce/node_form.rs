//! Damping at the quadrature nodes on the papers' problems, and under a singular force.

use super::error_curve::{ErrorCurve, error_chart};
use super::exact_oscillator::Start;
use super::methods::{MAIN_NODES, Method, NODES};
use super::motion::Motion;
use super::problems::{cube_plate, hjo_oscillator, on_any_step, on_grid, root_plate};
use super::table::{Cell, Column, Format, Table};
use super::{Exhibit, Findings, ReproduceError};
use fvi_host::converge::{Grids, Quantity, converge};
use fvi_scenario::scenario::{ReportedMomentum, Scenario};
use std::sync::atomic::AtomicBool;

pub(super) const EXHIBITS: [Exhibit; 2] = [
    Exhibit::beyond(
        "node-form-tables",
        "the problems of [HJO] Tables 1 and 2 with damping at the nodes",
        tables,
    ),
    Exhibit::beyond(
        "node-form-singular",
        "Riemann–Liouville damping with q(0) ≠ 0, a force singular like t^(−β)",
        singular,
    ),
];

/// Largest errors of q and p from a time on, over step sizes.
fn errors_from(
    from: f64,
    reported: ReportedMomentum,
    method: &Method,
    scenario: &Scenario,
    levels: std::ops::RangeInclusive<u32>,
    stop: &AtomicBool,
) -> Result<[ErrorCurve; 2], ReproduceError> {
    let end = scenario.time.end();
    let mut curves = [Vec::new(), Vec::new()];
    for level in levels {
        let steps = 1 << level;
        let step = end / f64::from(steps);
        let mut scenario = on_any_step(method.on(on_grid(scenario.clone(), step, steps as usize)));
        scenario.output.momentum = reported;
        let motion = Motion::run(method.label, &scenario, stop)?;
        let errors = motion.errors_from(from, &scenario);
        for (curve, error) in curves.iter_mut().zip([errors.position.largest, errors.momentum.largest]) {
            if error.is_finite() && error < 1.0 {
                curve.push((step, error));
            }
        }
    }
    Ok(curves.map(|points| ErrorCurve::new(method.label, points).above_rounding()))
}

fn tables(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let problems = [
        ("damped oscillator, α = ½", hjo_oscillator()?, 1.0, 5..=11),
        ("Bagley–Torvik, α = ¼, t³", cube_plate()?, 0.5, 3..=9),
        ("Bagley–Torvik, α = ¾, t^(5/2)", root_plate()?, 0.5, 3..=9),
    ];
    let text = |name: &str| Column::new(name, Format::Exact);
    let columns = vec![
        text("problem"),
        text("scheme"),
        Column::new("order of q", Format::Order),
        Column::new("order of p", Format::Order),
        Column::new("finest error of q", Format::Error),
        Column::new("finest error of p", Format::Error),
    ];
    let caption = "Orders on the three finest grids above rounding, and the errors there";
    let mut table = Table::new("", caption, columns);
    let mut findings = Findings::default();
    for (name, (problem, scenario, from, levels)) in ["oscillator", "cube", "root"].into_iter().zip(problems)
    {
        let mut pictured = Vec::new();
        for method in MAIN_NODES[2..].iter().chain(&NODES) {
            let [position, momentum] =
                errors_from(from, ReportedMomentum::OneSided, method, &scenario, levels.clone(), stop)?;
            let last = |curve: &ErrorCurve| curve.points.last().map(|point| point.1);
            table = table.with_row([
                Cell::from(problem),
                method.label.into(),
                position.order_of_finest(3).into(),
                momentum.order_of_finest(3).into(),
                last(&position).into(),
                last(&momentum).into(),
            ]);
            pictured.push((method, momentum));
        }
        let title = format!("{problem}: errors of the momentum p");
        let mut chart = error_chart(title, format!("largest for t ≥ {from}"), &[], &[]);
        for (method, curve) in pictured {
            chart = chart.with(method.curve(curve.points));
        }
        findings = findings.with_picture(
            name,
            format!("{problem}: errors of p at the main nodes and at the nodes"),
            chart,
        );
    }
    Ok(findings.with_table(table).with_remark(
        "Problems and step sizes of [HJO] Tables 1 and 2; errors are the largest from t = 1 on (oscillator) or t = ½ on. The momentum at the main \
         nodes is here the one after the kick, the papers'. The force of t^(5/2) begins like √t: its order is that of the quadrature of \
         the force over the first step, not that of the damping.",
    ))
}

/// Damping orders of the singular force.
const SINGULAR: [f64; 8] = [0.3, 0.5, 0.7, 0.9, 1.0, 1.1, 1.3, 1.5];

fn singular(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let text = |name: &str| Column::new(name, Format::Exact);
    let columns = vec![
        text("β"),
        text("scheme"),
        Column::new("order of q", Format::Order),
        Column::new("order of p", Format::Order),
        Column::new("order of p, one-sided", Format::Order),
        Column::new("finest error of q", Format::Error),
    ];
    let mut table = Table::new("", "Orders on the three finest grids above rounding, t ≥ 1", columns);
    let mut findings = Findings::default();
    for beta in SINGULAR {
        let scenario = Start::Singular.scenario(beta)?;
        let mut pictured = Vec::new();
        for method in MAIN_NODES[2..4].iter().chain(&NODES[..3]) {
            let errors = |reported| errors_from(1.0, reported, method, &scenario, 7..=11, stop);
            let [position, momentum] = errors(ReportedMomentum::Mean)?;
            let [_, one_sided] = errors(ReportedMomentum::OneSided)?;
            table = table.with_row([
                Cell::from(beta),
                method.label.into(),
                position.order_of_finest(3).into(),
                momentum.order_of_finest(3).into(),
                one_sided.order_of_finest(3).into(),
                position.points.last().map(|point| point.1).into(),
            ]);
            pictured.push((method, position));
        }
        if beta == 0.7 {
            let chart = error_chart(
                "Riemann–Liouville damping with q(0) = 1: errors of q",
                "q̈ + ½ D^0.7 q + q = 0; largest for t ≥ 1",
                &[],
                &[],
            );
            let chart = pictured
                .into_iter()
                .fold(chart, |chart, (method, curve)| chart.with(method.curve(curve.points)));
            findings = findings.with_picture("errors", "Errors of q under a singular force, β = 0.7", chart);
        }
    }
    Ok(findings.with_table(table).with_remark(
        "q̈ + ½ D^β q + q = 0, q(0) = 1, q̇(0) = 0 in the sense of Riemann and Liouville, against exact values. At the nodes all orders meet in one \
         motion, that of the equation; at the main nodes the sum leaves out the kick of t = 0. With two nodes and more the momentum of \
         the discrete Lagrangian, one-sided, holds the offset (h²/12) ρ q(0) t^(−1−β)/Γ(−β), of order 2, which fades with time: the constant part \
         of q is sampled alike at all nodes of a step (`book/src/theory/node-form.md`). It is taken off the momentum that is reported, which has the order of q. At \
         the main nodes one-sided is after the kick.",
    ))
}

/// Largest errors of the position, the momentum and the energy over step sizes, at the times with known
/// values.
pub(super) fn errors(
    method: &Method,
    scenario: &Scenario,
    levels: std::ops::RangeInclusive<u32>,
    stop: &AtomicBool,
) -> Result<[ErrorCurve; 3], ReproduceError> {
    let convergence = converge(scenario, &Grids { levels, intervals: 1, from: 0.0 }, stop, &mut |_, _| ())?;
    let less_wrong_than_nothing = |point: &(f64, f64)| point.1 < 1.0;
    Ok(Quantity::ALL.map(|quantity| {
        let points = convergence.points(quantity).into_iter().filter(less_wrong_than_nothing).collect();
        ErrorCurve::new(method.label, points)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn under_a_singular_force_momenta_have_the_order_of_positions_but_one_sided_ones() {
        let stop = AtomicBool::new(false);
        for beta in [0.3, 0.9, 1.3] {
            let scenario = Start::Singular.scenario(beta).unwrap();
            let errors = |reported| errors_from(1.0, reported, &NODES[2], &scenario, 7..=10, &stop).unwrap();
            let orders = errors(ReportedMomentum::Mean).map(|curve| curve.slope_of_finest(3));
            assert!(orders.iter().all(|order| (order - 4.0).abs() < 0.3), "β = {beta}: {orders:?}");
            let one_sided = errors(ReportedMomentum::OneSided)[1].slope_of_finest(3);
            assert!((one_sided - 2.0).abs() < 0.2, "β = {beta}: {one_sided}");
        }
    }

    #[test]
    fn orders_of_position_momentum_and_energy_are_those_of_the_formula() {
        let stop = AtomicBool::new(false);
        let expected = [2.0, 3.0, 4.0, 5.0, 6.0];
        for start in [Start::Released, Start::Pushed] {
            for beta in [0.3, 0.5, 0.7, 1.0, 1.5] {
                let scenario = start.scenario(beta).unwrap();
                let methods = if beta > 1.0 { &NODES[..3] } else { &NODES[..] };
                for (method, expected) in methods.iter().zip(expected) {
                    // The errors of BDF 5 and 6 contain an initial transient that decreases faster than their
                    // order; finer grids show rounding.
                    let levels = match expected {
                        6.0 => 7..=9,
                        5.0 => 8..=9,
                        _ => 8..=10,
                    };
                    let curves = errors(method, &method.on(scenario.clone()), levels, &stop).unwrap();
                    for (quantity, curve) in Quantity::ALL.iter().zip(curves) {
                        let order = curve.slope();
                        let least = if expected == 6.0 { 5.4 } else { expected - 0.25 };
                        let most = if expected > 4.5 { f64::INFINITY } else { expected + 0.2 };
                        assert!(
                            (least..most).contains(&order),
                            "{} {start:?} β = {beta}, {quantity:?}: {order}",
                            method.label
                        );
                    }
                }
            }
        }
    }
}
