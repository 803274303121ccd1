//! Orders of the schemes with Runge–Kutta convolution quadrature, which the papers name as future work.

use super::error_curve::{ErrorCurve, error_table};
use super::methods::{Method, RUNGE_KUTTA};
use super::table::{Cell, Column, Format, Table};
use super::{Exhibit, Findings, ReproduceError};
use fvi_host::converge::{Grids, Quantity, converge};
use fvi_host::results::picture::{Axis, Chart, Series, Style};
use fvi_scenario::language::{Document, InputError};
use fvi_scenario::scenario::Scenario;
use std::path::Path;
use std::sync::atomic::AtomicBool;

pub(super) const EXHIBITS: [Exhibit; 1] = [Exhibit::beyond(
    "rk-orders",
    "orders of Runge–Kutta convolution quadrature, named as future work in [HJO] §6",
    compute,
)];

/// Damping orders of the tables.
const DAMPING_ORDERS: [f64; 5] = [0.3, 0.5, 1.0, 1.5, 1.9];

/// Further ones for the picture of orders over damping orders.
const BETWEEN: [f64; 5] = [0.7, 0.9, 1.1, 1.3, 1.7];

/// Order u and stage order w of the [`RUNGE_KUTTA`] methods. Radau IIA with r stages: 2r − 1 and r; Lobatto
/// IIIC: 2r − 2 and r − 1.
const ORDERS: [(f64, f64); 6] = [(1.0, 1.0), (3.0, 2.0), (5.0, 3.0), (2.0, 1.0), (4.0, 2.0), (6.0, 3.0)];

/// 4 to 128 steps.
const LEVELS: std::ops::RangeInclusive<u32> = 2..=7;

/// Errors below this are rounding.
const FLOOR: f64 = 2e-14;

/// Which potential the motion has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Problem {
    /// U = ½ q².
    Linear,
    /// U = −2 cos q.
    Pendulum,
}

impl Problem {
    const ALL: [Self; 2] = [Self::Linear, Self::Pendulum];

    fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Pendulum => "nonlinear",
        }
    }

    /// q̈ + ∇U(q) + ½ D^β q = f with f such that q = t⁸/4 on [0, 1].
    ///
    /// Enough derivatives vanish at t = 0 that no method loses order at the start.
    fn scenario(self, damping_order: f64) -> Result<Scenario, InputError> {
        let (potential, pull) = match self {
            Self::Linear => ("0.5*q0^2", "t^8/4"),
            Self::Pendulum => ("-2*cos(q0)", "2*sin(t^8/4)"),
        };
        let text = format!(
            r#"
            [system]
            mass = [1.0]
            potential = "{potential}"
            force = ["14*t^6 + {pull} + gamma(9)/gamma(9 - b)*t^(8 - b)/8"]
        force_quadrature = "nodes"
            parameters = {{ b = {damping_order:?} }}
            [[system.damping]]
            order = {damping_order:?}
            coefficient = [0.5]
            [initial]
            position = [0.0]
            momentum = [0.0]
            [time]
            step = 0.0078125
            end = 1.0
            [reference]
            position = ["t^8/4"]
            momentum = ["2*t^7"]
            "#
        );
        Scenario::from_document(Document::new("motion with the solution t^8/4", Path::new(""), &text))
    }
}

/// Results of a method on one problem.
pub(super) struct Outcome {
    pub(super) problem: Problem,
    pub(super) damping_order: f64,
    pub(super) method: Method,
    /// Index of the method in [`ORDERS`].
    index: usize,
    /// Errors of position and momentum.
    pub(super) errors: [ErrorCurve; 2],
}

/// The two quantities, each with the number c in its expected order min(u, w + c − β).
const QUANTITIES: [(Quantity, f64); 2] = [(Quantity::Position, 3.0), (Quantity::Momentum, 2.0)];

impl Outcome {
    /// Slope over the three finest grids above rounding.
    pub(super) fn found(&self, quantity: usize) -> f64 {
        self.errors[quantity].slope_of_finest(3)
    }

    /// min(u, w + 3 − β) for the position, min(u, w + 2 − β) for the momentum; u for β = 1, where the
    /// quadrature is the Runge–Kutta method itself.
    pub(super) fn expected(&self, quantity: usize) -> f64 {
        let (order, stage_order) = ORDERS[self.index];
        if self.damping_order == 1.0 {
            return order;
        }
        order.min(stage_order + QUANTITIES[quantity].1 - self.damping_order)
    }
}

/// All methods on a problem.
pub(super) fn measure(
    problem: Problem,
    damping_orders: &[f64],
    stop: &AtomicBool,
) -> Result<Vec<Outcome>, ReproduceError> {
    let mut outcomes = Vec::new();
    for &damping_order in damping_orders {
        let scenario = problem.scenario(damping_order)?;
        for (index, method) in RUNGE_KUTTA.into_iter().enumerate() {
            let grids = Grids { levels: LEVELS, intervals: 1, from: 0.0 };
            let convergence = converge(&method.on(scenario.clone()), &grids, stop, &mut |_, _| ())?;
            let curve = |(quantity, _)| {
                let above = |point: &(f64, f64)| point.1 > FLOOR;
                let points = convergence.points(quantity).into_iter().filter(above).collect();
                ErrorCurve::new(method.label, points)
            };
            outcomes.push(Outcome { problem, damping_order, method, index, errors: QUANTITIES.map(curve) });
        }
    }
    Ok(outcomes)
}

fn compute(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let mut outcomes = measure(Problem::Linear, &DAMPING_ORDERS, stop)?;
    outcomes.extend(measure(Problem::Pendulum, &DAMPING_ORDERS, stop)?);
    let between = measure(Problem::Pendulum, &BETWEEN, stop)?;
    let mut findings = Findings::default().with_table(orders_table(&outcomes));
    for (name, damping_order) in [("errors-0.5", 0.5), ("errors-1.5", 1.5)] {
        findings = findings.with_picture(
            name,
            format!("Position errors of the nonlinear motion over step sizes, β = {damping_order}"),
            errors_chart(&outcomes, damping_order),
        );
    }
    findings = findings.with_picture(
        "over-beta",
        "Observed orders of the momentum over the damping order, nonlinear motion",
        orders_chart(outcomes.iter().chain(&between)),
    );
    for problem in Problem::ALL {
        for damping_order in DAMPING_ORDERS {
            findings = findings.with_table(errors_table(&outcomes, problem, damping_order));
        }
    }
    Ok(findings
        .with_remark(
            "The motion is q = t⁸/4 on [0, 1], made exact by the force, with M = 1, damping ½ D^β q and the potential ½q² (linear) \
             or −2 cos q (nonlinear). *Expected* is min(u, w + 3 − β) for the position and min(u, w + 2 − β) for the momentum, u the order \
             of the Runge–Kutta method and w its stage order (Radau IIA with r stages: 2r − 1 and r; Lobatto IIIC: 2r − 2 and r − 1). \
             Values at the stages are of order w + 1 only; the quadrature of D^β loses β of it and each integration over time wins \
             one back. So Radau IIA 3 at β = 1.9 has the order 4.1 in the position and 3.1 in the momentum in place of 5, and \
             Lobatto IIIC 4 has 6 nowhere but at β = 1, where the quadrature is the Runge–Kutta method itself.",
        )
        .with_remark(
            "*Measured* is the slope over the three finest grids with errors above rounding (2·10⁻¹⁴). Where it departs from the expected \
             order by more than a few tenths, for β ≤ 1, two parts of the error of nearly the same order are of opposite sign and \
             cancel on some of these grids: the momentum of Lobatto IIIC 3, the position of Lobatto IIIC 4, and the position of \
             Radau IIA 1. All methods are stable here for every β. With as many degrees as stages (Radau IIA) steps are limited, \
             to h^{2−β} ρ/m < 1.1, 2.3 and 1.3 for r = 1, 2, 3 at β = 1.9, and `fvi run` refuses longer ones; Lobatto IIIC with r − 1 \
             degrees has no limit for β ≥ 1.",
        ))
}

fn orders_table(outcomes: &[Outcome]) -> Table {
    let order = |name: &str| Column::new(name, Format::Order);
    let columns = vec![
        Column::new("method", Format::Exact),
        Column::new("problem", Format::Exact),
        Column::new("β", Format::Exact),
        order("position, measured"),
        order("position, expected"),
        order("momentum, measured"),
        order("momentum, expected"),
    ];
    let row = |outcome: &Outcome| -> Vec<Cell> {
        let mut cells: Vec<Cell> =
            vec![outcome.method.label.into(), outcome.problem.name().into(), outcome.damping_order.into()];
        for quantity in [0, 1] {
            cells.extend([outcome.found(quantity).into(), outcome.expected(quantity).into()]);
        }
        cells
    };
    let mut sorted: Vec<&Outcome> = outcomes.iter().collect();
    sorted.sort_by_key(|outcome| outcome.index);
    let table = Table::new("", "Orders on a smooth motion", columns);
    Table { rows: sorted.into_iter().map(row).collect(), ..table }
}

fn errors_table(outcomes: &[Outcome], problem: Problem, damping_order: f64) -> Table {
    const NAMES: [[&str; 5]; 2] = [
        ["linear-0.3", "linear-0.5", "linear-1", "linear-1.5", "linear-1.9"],
        ["nonlinear-0.3", "nonlinear-0.5", "nonlinear-1", "nonlinear-1.5", "nonlinear-1.9"],
    ];
    let name = DAMPING_ORDERS.iter().position(|order| *order == damping_order).unwrap_or(0);
    let caption = format!("Position errors, {} motion, β = {damping_order}", problem.name());
    let curves: Vec<ErrorCurve> = outcomes
        .iter()
        .filter(|outcome| outcome.problem == problem && outcome.damping_order == damping_order)
        .map(|outcome| outcome.errors[0].clone())
        .collect();
    let table = error_table(NAMES[usize::from(problem == Problem::Pendulum)][name], caption, &curves);
    Table { shown: false, ..table }
}

fn errors_chart(outcomes: &[Outcome], damping_order: f64) -> Chart {
    let mut chart = Chart::new(
        "Runge–Kutta convolution quadrature on a nonlinear motion",
        Axis::logarithmic("step size h"),
        Axis::logarithmic("largest error of the position q"),
    )
    .with_subtitle(format!(
        "pendulum under a force that makes q = t⁸/4, β = {damping_order}; dotted: expected orders"
    ));
    for outcome in outcomes {
        if outcome.problem != Problem::Pendulum || outcome.damping_order != damping_order {
            continue;
        }
        let points = &outcome.errors[0].points;
        chart = chart.with(outcome.method.curve(points.clone()));
        // The guide passes through the finest point, so that a curve with the expected order coincides with
        // it.
        if let (Some(&finest), Some(&coarsest)) = (points.last(), points.first()) {
            let order = outcome.expected(0);
            chart = chart.with(Series::slope(format!("{order:.1}"), order, finest, coarsest.0, finest.0));
        }
    }
    chart
}

fn orders_chart<'a>(outcomes: impl Iterator<Item = &'a Outcome> + Clone) -> Chart {
    let mut chart = Chart::new(
        "Orders of Runge–Kutta convolution quadrature",
        Axis::linear("damping order β"),
        Axis::linear("observed order of the momentum p"),
    )
    .with_subtitle("nonlinear motion, three finest grids above rounding; dotted: min(u, w + 2 − β)");
    for (index, method) in RUNGE_KUTTA.into_iter().enumerate() {
        let of_method =
            outcomes.clone().filter(|outcome| outcome.problem == Problem::Pendulum && outcome.index == index);
        let points = of_method.map(|outcome| (outcome.damping_order, outcome.found(1))).collect();
        chart = chart.with(method.markers(points));
    }
    for (order, stage_order) in ORDERS {
        let points = (0..20).map(|tenths| 0.1 * f64::from(tenths));
        let points = points.map(|beta| (beta, order.min(stage_order + 2.0 - beta))).collect();
        chart = chart.with(Series::new("", Style::Guide, points));
    }
    chart
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_are_those_of_the_theory_where_it_is_sharp() {
        // For β < 1 parts of the error cancel on these grids.
        for outcome in measure(Problem::Pendulum, &[1.0, 1.9], &AtomicBool::new(false)).unwrap() {
            for quantity in [0, 1] {
                let what = (outcome.method.label, outcome.damping_order, quantity);
                let (found, expected) = (outcome.found(quantity), outcome.expected(quantity));
                // They also cancel in the position with one stage at β = 1.
                if what != ("Radau IIA 1", 1.0, 0) {
                    assert!((found - expected).abs() < 0.2, "{what:?}: {found} for {expected}");
                }
            }
        }
    }
}
