//! Errors and orders against exact solutions, for damping orders from 0.1 to 1.9: schemes, starts, step
//! sizes.

use super::error_curve::ErrorCurve;
use super::exact_oscillator::{DAMPING_ORDERS, Start};
use super::methods::{MAIN_NODES, Method, NODES, RUNGE_KUTTA};
use super::node_form::errors;
use super::table::{Cell, Column, Format, Table};
use super::{Exhibit, Findings, ReproduceError};
use fvi_host::results::picture::{Axis, Chart};
use fvi_scenario::scenario::ReportedMomentum;
use std::sync::atomic::AtomicBool;

/// Name of the page.
pub(super) const PAGE: &str = "accuracy.md";

pub(super) const EXHIBITS: [Exhibit; 1] =
    [Exhibit::beyond("accuracy", "errors against exact solutions, and what to take", compute).on_page(PAGE)];

/// Head of the page.
pub(super) const HEAD: &str = "# Accuracy\n\n\
    `fvi reproduce accuracy --out book/src/assurance` writes this page, its pictures and the CSV files behind them: errors against exact solutions \
    of q̈ + ½ D^β q + q = 0 at t = 1, 2, 3, 4, 6, 8 (21 digits, `tests/reference/oscillator.py`). *nodes* is damping at the quadrature \
    nodes, the default ([node-form.md](../theory/node-form.md)); *main nodes* the papers' form.\n\n\
    ## What to take\n\n\
    | problem | `[scheme]` and `[convolution]` |\n|---|---|\n\
    | any stiffness, any damping, errors of 10⁻³ to 10⁻⁵ | say nothing: midpoint rule, BDF 2 at the nodes; every step is stable |\n\
    | many digits on plain weights, any engine, firmware: β ≤ 1 | `galerkin`, `degree = 3`, `order = 5` or `6` |\n\
    | the same, β from 1 to 1.5 | `galerkin`, `degree = 2`, `order = 4` |\n\
    | the most digits, and β near 2 or damping that outweighs the inertia | `galerkin`, `degree = 3`, `family = \"lobatto-iiic\"`, `stages = 4` (matrix weights) |\n\
    | β near 2 or strong damping, moderate accuracy | say nothing |\n\
    | Riemann–Liouville with q(0) ≠ 0 | any of the above at the nodes, never the main nodes; momenta to order 2 with two nodes and more |\n\
    | accurate right from the first steps, smooth force | `radau-iia`, `stages = 3`, `degree = 3` |\n\
    | a force that jumps | whatever it is, with the jumps on grid points |\n\
    | a microcontroller | midpoint rule, BDF 2 at the nodes: the cost of the papers' form, one order more in the momentum |\n\
    | the papers' numbers | `at = \"main-nodes\"`, `[output] momentum = \"one-sided\"` |\n";

/// h = 1/8 to 1/512.
const LEVELS: std::ops::RangeInclusive<u32> = 6..=12;

/// Step size of the tables that compare errors.
const STEP: f64 = 1.0 / 64.0;

/// Errors below this are partly rounding: the rounding of the weights grows like h^(−β).
fn floor(damping_order: f64, step: f64) -> f64 {
    100.0 * f64::EPSILON * libm::pow(step, -damping_order.max(1.0))
}

fn methods() -> Vec<Method> {
    [MAIN_NODES[3], MAIN_NODES[6]].into_iter().chain(NODES).chain([RUNGE_KUTTA[2], RUNGE_KUTTA[5]]).collect()
}

/// Errors of position, momentum and energy of a method on a motion.
struct Measured {
    method: Method,
    start: Start,
    damping_order: f64,
    errors: [ErrorCurve; 3],
}

impl Measured {
    /// Slope over the three finest grids with errors that are not rounding.
    fn order(&self, quantity: usize) -> Option<f64> {
        let curve = &self.errors[quantity];
        let resolved = |point: &(f64, f64)| point.1 > floor(self.damping_order, point.0);
        let points = curve.points.iter().copied().filter(resolved).collect();
        ErrorCurve::new("", points).order_of_finest(3)
    }

    fn error_at(&self, step: f64) -> Option<f64> {
        self.errors[0].points.iter().find(|point| point.0 == step).map(|point| point.1)
    }

    /// The smallest error of the position over all step sizes, with its step size.
    fn least(&self) -> Option<(f64, f64)> {
        self.errors[0].points.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

fn compute(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let mut measured = Vec::new();
    for start in Start::ALL {
        for damping_order in DAMPING_ORDERS {
            let scenario = start.scenario(damping_order)?;
            for method in methods() {
                let mut scenario = method.on(scenario.clone());
                scenario.output.momentum = ReportedMomentum::Mean;
                let errors = errors(&method, &scenario, LEVELS, stop)?;
                measured.push(Measured { method, start, damping_order, errors });
            }
        }
    }
    let mut findings = Findings::default();
    for (name, damping_order) in [("errors-0.5", 0.5), ("errors-1.5", 1.5)] {
        let chart = errors_chart(&measured, damping_order);
        findings =
            findings.with_picture(name, format!("Errors of q over step sizes, β = {damping_order}"), chart);
    }
    for (name, start) in [("over-beta-released", Start::Released), ("over-beta-singular", Start::Singular)] {
        let caption =
            format!("Errors of q with 64 steps a unit of time over the damping order, {}", start.describe());
        findings = findings.with_picture(name, caption, over_damping_orders(&measured, start));
    }
    for start in Start::ALL {
        findings =
            findings.with_table(orders(&measured, start)).with_table(errors_side_by_side(&measured, start));
    }
    Ok(findings.with_table(floors(&measured)).with_table(all(&measured)).with_remark(
        "Orders are the slopes over the three finest of the grids h = 1/8 … 1/512 whose error is above 100 u h^(−max(1, β)), u the unit of rounding; – stands where no step of \
         these is stable, or fewer than two errors are above that. BDF 5 and 6 begin with a transient that dies out like 0.71ᵏ and 0.86ᵏ with \
         the number k of steps: at t = 1 their errors fall faster than their order while k is small. The momentum of the main nodes is the \
         mean of those before and after the kick. For Riemann–Liouville damping with q(0) ≠ 0 and two nodes and more an offset of \
         order 2 that is known is taken off the momentum (`theory/node-form.md`).",
    ))
}

fn columns(format: Format) -> Vec<Column> {
    let head = Column::new("scheme", Format::Exact);
    [head]
        .into_iter()
        .chain(DAMPING_ORDERS.iter().map(|beta| Column::new(format!("β = {beta}"), format)))
        .collect()
}

/// One row for each method, one cell for each damping order.
fn rows(measured: &[Measured], start: Start, cell: impl Fn(&Measured) -> Cell) -> Vec<Vec<Cell>> {
    let of_start: Vec<&Measured> = measured.iter().filter(|of| of.start == start).collect();
    let row = |method: Method| {
        let of_method = of_start.iter().filter(|of| of.method == method).map(|of| cell(of));
        [Cell::from(method.label)].into_iter().chain(of_method).collect()
    };
    methods().into_iter().map(row).collect()
}

fn orders(measured: &[Measured], start: Start) -> Table {
    let name = match start {
        Start::Released => "orders-released",
        Start::Pushed => "orders-pushed",
        Start::Singular => "orders-singular",
    };
    let cell = |of: &Measured| {
        let order =
            |quantity| of.order(quantity).map_or("–".to_owned(), |order: f64| format!("{order:.1}"));
        Cell::Text(format!("{} {} {}", order(0), order(1), order(2)))
    };
    let caption = format!("{}: orders of q, p and energy", start.describe());
    Table { rows: rows(measured, start, cell), ..Table::new(name, caption, columns(Format::Exact)) }
}

fn errors_side_by_side(measured: &[Measured], start: Start) -> Table {
    let name = match start {
        Start::Released => "errors-released",
        Start::Pushed => "errors-pushed",
        Start::Singular => "errors-singular",
    };
    let caption = format!("{}: largest error of q for t ≥ 1 with h = 1/64", start.describe());
    let rows = rows(measured, start, |of| of.error_at(STEP).into());
    Table { rows, ..Table::new(name, caption, columns(Format::Error)) }
}

fn floors(measured: &[Measured]) -> Table {
    let caption = format!(
        "{}: the least error of q over h = 1/8 … 1/512; where it is not that of the finest grid, rounding has ended the fall",
        Start::Released.describe()
    );
    let rows = rows(measured, Start::Released, |of| of.least().map(|least| least.1).into());
    Table { rows, ..Table::new("floors", caption, columns(Format::Error)) }
}

fn all(measured: &[Measured]) -> Table {
    let rows = measured.iter().flat_map(|of| {
        let row = |index: usize| -> Vec<Cell> {
            let (step, error) = of.errors[0].points[index];
            let other = |quantity: usize| {
                let points = &of.errors[quantity].points;
                Cell::from(points.iter().find(|point| point.0 == step).map(|point| point.1))
            };
            let head = [of.method.label.into(), of.start.describe().into(), of.damping_order.into()];
            head.into_iter().chain([step.into(), error.into(), other(1), other(2)]).collect()
        };
        (0..of.errors[0].points.len()).map(row).collect::<Vec<_>>()
    });
    let columns = ["scheme", "start", "beta", "h", "position_error", "momentum_error", "energy_error"];
    Table::of_curves("all", "All errors", &columns, rows)
}

fn errors_chart(measured: &[Measured], damping_order: f64) -> Chart {
    let mut chart = Chart::new(
        format!("Errors of the position, β = {damping_order}"),
        Axis::logarithmic("step size h"),
        Axis::logarithmic("largest error of q for t ≥ 1"),
    )
    .with_subtitle(format!("q̈ + ½ D^{damping_order} q + q = 0, {}", Start::Released.describe()));
    for of in measured.iter().filter(|of| of.start == Start::Released && of.damping_order == damping_order) {
        chart = chart.with(of.method.curve(of.errors[0].points.clone()));
    }
    chart
}

fn over_damping_orders(measured: &[Measured], start: Start) -> Chart {
    let mut chart = Chart::new(
        "Errors of the position with h = 1/64",
        Axis::linear("damping order β"),
        Axis::logarithmic("largest error of q for t ≥ 1"),
    )
    .with_subtitle(format!("q̈ + ½ D^β q + q = 0, {}", start.describe()));
    for method in methods() {
        let of_method = measured.iter().filter(|of| of.start == start && of.method == method);
        let points = of_method.filter_map(|of| Some((of.damping_order, of.error_at(STEP)?))).collect();
        chart = chart.with(method.curve(points));
    }
    chart
}
