//! The pictures of a fit: data with model, and residuals; the comparison of models; the master curve.

use super::data::{Column, Deviations, Domain, Observed, Over, Record};
use super::plan::Fit;
use super::{Fitted, FittedModel};
use crate::results::picture::{Axis, Chart, Series, Style};

/// Largest number of tables of data that are drawn.
const MOST_TABLES: usize = 20;

/// The charts of a fitted model, with the names of their files.
pub(super) fn charts(plan: &Fit, fitted: &FittedModel) -> Vec<(String, Chart)> {
    let (mut charts, appearance) = (Vec::new(), plan.appearance());
    for (index, record) in plan.records.iter().take(MOST_TABLES).enumerate() {
        let told = &fitted.told[index];
        let values = || record.columns.iter().flat_map(|column| &column.values).chain(told.iter().flatten());
        let over = || match record.domain {
            Domain::Time => Axis::linear("time t").in_units(&appearance.units.time),
            Domain::Closed { over: Over::Time, .. } => {
                Axis::logarithmic("time t").in_units(&appearance.units.time)
            }
            Domain::Closed { over: Over::Frequency, .. } => Axis::logarithmic("angular frequency ω"),
        };
        // Moduli span decades; parts of a receptance have either sign.
        let is_positive = record.domain != Domain::Time && values().all(|&value| value > 0.0);
        let names: Vec<&str> = record.columns.iter().map(label).collect();
        let names = names.join(", ");
        let y = if is_positive { Axis::logarithmic(&names) } else { Axis::linear(&names) };
        let chart = |y: Axis| {
            Chart::new(plan.heading(), over(), y)
                .on_paper(appearance.paper)
                .with_subtitle(record.name.clone())
        };
        let (mut both, mut left) = (chart(y), chart(Axis::linear("(datum − model)/deviation")));
        for (number, (column, told)) in record.columns.iter().zip(told).enumerate() {
            // The model over its data, in a colour of its own.
            let data =
                Series::new(format!("{}, data", column.name), Style::Points, points(record, &column.values));
            let bars = match record.deviations {
                Deviations::Known => column.deviations.clone(),
                Deviations::None | Deviations::Relative => Vec::new(),
            };
            let model = Series::new(format!("{}, model", column.name), Style::Line, points(record, told));
            both = both
                .with(data.with_bars(bars).with_colour_of(2 * number))
                .with(model.with_colour_of(2 * number + 1));
            let residuals = points(record, &weighted(column, told));
            left = left
                .with(Series::new(column.name.clone(), Style::Points, residuals).with_colour_of(2 * number));
        }
        charts.push((format!("fit_{index}.svg"), both));
        charts.push((format!("residuals_{index}.svg"), left));
    }
    charts
}

/// AIC above the smallest over the number of parameters of each model, with the name of the file.
pub(super) fn comparison(plan: &Fit, fitted: &Fitted) -> Option<(String, Chart)> {
    let differences = fitted.aic_differences();
    if differences.len() < 2 {
        return None;
    }
    let (x, y) = (Axis::linear("free parameters"), Axis::linear("AIC − smallest AIC"));
    let appearance = plan.appearance();
    let mut chart = Chart::new(plan.heading(), x, y).on_paper(appearance.paper);
    for (model, difference) in fitted.models.iter().zip(differences) {
        let place = (model.parameters.len() as f64, difference);
        let name = model.name.clone().unwrap_or_default();
        chart = chart.with(Series::new(name, Style::Points, vec![place]));
    }
    Some(("models.svg".to_owned(), chart))
}

/// All shifted tables over the reduced frequency or time, with the name of the file.
pub(super) fn master_curve(plan: &Fit, fitted: &FittedModel) -> Option<(String, Chart)> {
    let over_time = plan.records.first()?.over() == "t";
    let alike = plan.records.iter().all(|record| (record.over() == "t") == over_time);
    plan.shift.as_ref().filter(|_| alike)?;
    let of_columns = plan.records.iter().flat_map(|record| &record.columns);
    let is_positive = of_columns.flat_map(|column| &column.values).all(|&value| value > 0.0);
    let names: Vec<&str> = plan.records[0].columns.iter().map(label).collect();
    let names = names.join(", ");
    let x = Axis::logarithmic(if over_time { "reduced time t/a" } else { "reduced angular frequency a ω" });
    let y = if is_positive { Axis::logarithmic(&names) } else { Axis::linear(&names) };
    let mut chart = Chart::new(plan.heading(), x, y).on_paper(plan.appearance().paper);
    for (index, (record, table)) in plan.records.iter().zip(&fitted.tables).take(MOST_TABLES).enumerate() {
        let factor = libm::exp10(table.log10_shift?);
        let moved = |values: &[f64]| -> Vec<(f64, f64)> {
            let reduced = |place: f64| if over_time { place / factor } else { place * factor };
            points(record, values).into_iter().map(|(place, value)| (reduced(place), value)).collect()
        };
        for (column, told) in record.columns.iter().zip(&fitted.told[index]) {
            let name = format!("{} at {}", column.name, table.temperature?);
            let data = Series::new(name, Style::Points, moved(&column.values)).with_colour_of(index);
            let model = Series::new(String::new(), Style::Line, moved(told)).with_colour_of(index);
            chart = chart.with(data).with(model);
        }
    }
    Some(("master_curve.svg".to_owned(), chart))
}

/// What an axis says of a column.
fn label(column: &Column) -> &str {
    if column.what == Observed::Decibels { "magnitude in dB" } else { &column.name }
}

fn points(record: &Record, values: &[f64]) -> Vec<(f64, f64)> {
    record.places.iter().copied().zip(values.iter().copied()).collect()
}

fn weighted(column: &Column, told: &[f64]) -> Vec<f64> {
    let data = column.values.iter().zip(told).zip(&column.deviations);
    data.map(|((datum, told), deviation)| (datum - told) / deviation).collect()
}
