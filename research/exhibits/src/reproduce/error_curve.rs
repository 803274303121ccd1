//! Errors over step sizes: slopes, tables side by side, pictures.

use super::ReproduceError;
use super::table::{Cell, Column, Format, Table};
use fvi_host::converge::{Grids, Quantity, converge, order_between, slope};
use fvi_host::results::picture::{Axis, Chart, Series, Style, power};
use fvi_scenario::scenario::Scenario;
use std::sync::atomic::AtomicBool;

/// Errors of one method over step sizes, the longest step first.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorCurve {
    /// The method.
    pub label: String,
    /// Step size and error.
    pub points: Vec<(f64, f64)>,
}

/// Errors above this are not rounding.
const ROUNDING: f64 = 1e-8;

impl ErrorCurve {
    /// A curve.
    pub fn new(label: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self { label: label.into(), points }
    }

    /// Runs a scenario on every grid and measures the largest error of a quantity against its reference.
    ///
    /// # Errors
    /// [`ReproduceError`]. A grid whose step is too long to be stable is left out.
    pub fn measure(
        label: impl Into<String>,
        scenario: &Scenario,
        grids: &Grids,
        quantity: Quantity,
        stop: &AtomicBool,
    ) -> Result<Self, ReproduceError> {
        let convergence = converge(scenario, grids, stop, &mut |_, _| ())?;
        Ok(Self::new(label, convergence.points(quantity)))
    }

    /// Slope of the line of least squares through the logarithms of all points; NaN with fewer than two.
    pub fn slope(&self) -> f64 {
        slope(&self.points).unwrap_or(f64::NAN)
    }

    /// Slope through the `count` points with the shortest steps.
    pub fn slope_of_finest(&self, count: usize) -> f64 {
        slope(&self.points[self.points.len().saturating_sub(count)..]).unwrap_or(f64::NAN)
    }

    /// [`slope_of_finest`](Self::slope_of_finest) where there are at least `count` points.
    pub(super) fn order_of_finest(&self, count: usize) -> Option<f64> {
        Some(self.slope_of_finest(count)).filter(|order| order.is_finite())
    }

    /// The curve without the finest grids, from the one where rounding stops its decrease.
    pub(super) fn above_rounding(mut self) -> Self {
        while let [.., coarse, fine] = self.points[..]
            && fine.1 > 0.75 * coarse.1
            && fine.1 < ROUNDING
        {
            self.points.pop();
        }
        self
    }

    /// Orders between neighbouring step sizes, the longest first.
    pub fn orders(&self) -> Vec<f64> {
        self.points.windows(2).filter_map(|pair| order_between(pair[0], pair[1])).collect()
    }

    /// The orders as text, two decimals each.
    pub fn orders_in_words(&self) -> String {
        self.orders().iter().map(|order| format!("{order:.2}")).collect::<Vec<_>>().join(", ")
    }

    /// The slope over all points, and over the four shortest steps.
    pub fn slopes_in_words(&self) -> String {
        format!("{:.2}, finest four {:.2}", self.slope(), self.slope_of_finest(4))
    }

    /// Error at a step size, if it is there.
    fn error(&self, step: f64) -> Option<f64> {
        self.points.iter().find(|point| point.0 == step).map(|point| point.1)
    }

    /// Order between a step size and the next longer one.
    fn order(&self, step: f64) -> Option<f64> {
        let index = self.points.iter().position(|point| point.0 == step)?;
        order_between(*self.points.get(index.checked_sub(1)?)?, self.points[index])
    }
}

/// Errors and orders of all curves side by side, one row for each step size.
pub(super) fn error_table(name: &'static str, caption: impl Into<String>, curves: &[ErrorCurve]) -> Table {
    let mut steps: Vec<f64> =
        curves.iter().flat_map(|curve| curve.points.iter().map(|point| point.0)).collect();
    steps.sort_by(|a, b| b.total_cmp(a));
    steps.dedup();
    let pair = |curve: &ErrorCurve| {
        [
            Column::new(&curve.label, Format::Error),
            Column::new(format!("order {}", curve.label), Format::Order).headed("order"),
        ]
    };
    let columns = [Column::new("h", Format::Exact)].into_iter().chain(curves.iter().flat_map(pair)).collect();
    let row = |&step: &f64| -> Vec<Cell> {
        let cells = curves.iter().flat_map(|curve| [curve.error(step).into(), curve.order(step).into()]);
        [step.into()].into_iter().chain(cells).collect()
    };
    Table { rows: steps.iter().map(row).collect(), ..Table::new(name, caption, columns) }
}

/// Errors over step sizes on logarithmic axes, with lines of the given slopes to compare with.
pub(super) fn error_chart(
    title: impl Into<String>,
    subtitle: impl Into<String>,
    curves: &[ErrorCurve],
    slopes: &[f64],
) -> Chart {
    let mut chart = Chart::new(title, Axis::logarithmic("step size h"), Axis::logarithmic("largest error"))
        .with_subtitle(subtitle);
    for curve in curves {
        let label = format!("{} (slope {:.2})", curve.label, curve.slope());
        chart = chart.with(Series::new(label, Style::LineWithPoints, curve.points.clone()));
    }
    for &wanted in slopes {
        chart = guide(curves, wanted).into_iter().fold(chart, Chart::with);
    }
    chart
}

/// A line of a slope below all curves, far enough for its label, which is at the longest step.
fn guide(curves: &[ErrorCurve], slope: f64) -> Option<Series> {
    let points = || curves.iter().flat_map(|curve| curve.points.iter());
    let extreme =
        |select: fn(&(f64, f64)) -> f64, better: fn(f64, f64) -> f64| points().map(select).reduce(better);
    let (from, to) = (extreme(|point| point.0, f64::min)?, extreme(|point| point.0, f64::max)?);
    let (smallest, largest) = (extreme(|point| point.1, f64::min)?, extreme(|point| point.1, f64::max)?);
    let distance = libm::pow(largest / smallest, 0.11).max(3.0);
    let lowest = points().map(|&(h, error)| error / libm::pow(h, slope)).reduce(f64::min)?;
    // Steep lines are cut where they would stretch the axis.
    let from = from.max(libm::pow(smallest / lowest, 1.0 / slope)).min(0.5 * to);
    let label = if slope.fract() == 0.0 { power("h", slope as i64) } else { format!("h^{slope}") };
    Some(Series::slope(label, slope, (from, lowest / distance * libm::pow(from, slope)), from, to))
}
