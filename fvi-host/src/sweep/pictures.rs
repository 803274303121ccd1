//! Pictures of a sweep: a quantity over one axis as curves, over two as a map.

use super::axis::{Axis as SweptAxis, cell, number};
use super::plan::{Over, PictureRequest, Sweep};
use super::records::{Records, record_of};
use crate::results::files::{FileError, write_picture};
use crate::results::output_directory::OutputDirectory;
use crate::results::picture::{Axis, Chart, ColourMap, Series, Style};

/// Largest number of points of one picture.
const MOST_POINTS: usize = 1 << 20;

/// Largest number of curves of one picture.
const MOST_CURVES: usize = 8;

/// Largest number of points of a curve with markers.
const MOST_MARKED: usize = 60;

/// Draws the pictures that the sweep file requests, or default ones according to its axes; returns the names
/// of the files.
pub(super) fn write(
    sweep: &Sweep,
    shards: &[Records],
    directory: &OutputDirectory,
) -> Result<Vec<String>, FileError> {
    let suggested = suggestions(sweep);
    let requests = if sweep.pictures().is_empty() { &suggested } else { sweep.pictures() };
    let mut files = Vec::new();
    for request in requests {
        let chart = draw(sweep, shards, request)?;
        let name = format!("{}.svg", request.name);
        write_picture(&directory.join(&name), &chart)?;
        files.push(name);
    }
    Ok(files)
}

/// Default pictures: quantities over the one or two numeric axes of a sweep.
fn suggestions(sweep: &Sweep) -> Vec<PictureRequest> {
    let axes: Vec<usize> = (0..sweep.axes().len()).filter(|&index| sweep.axes()[index].count() > 1).collect();
    let numeric = axes.iter().all(|&index| sweep.axes()[index].is_numeric());
    let (x, over) = match *axes.as_slice() {
        _ if !numeric || sweep.runs() > MOST_POINTS => return Vec::new(),
        [x] => (x, Over::Alone),
        [a, b] if !sweep.is_grid() => (a, Over::Map(b)),
        [a, b] => {
            let count = |index: usize| sweep.axes()[index].count();
            // The longer axis lies along the picture where the other is a handful of curves.
            let (x, other) = if count(a) >= count(b) { (a, b) } else { (b, a) };
            if count(other) <= MOST_CURVES { (x, Over::Curves(other)) } else { (a, Over::Map(b)) }
        }
        _ => return Vec::new(),
    };
    let wanted = ["energy_left", "amplitude_q0", "largest_q0", "q0", "error_q", "growth"];
    let columns = sweep.quantities().columns();
    wanted
        .iter()
        .filter(|&&wanted| columns.iter().any(|column| column == wanted))
        .map(|&quantity| PictureRequest {
            name: quantity.to_owned(),
            quantity: quantity.to_owned(),
            x,
            over,
            logarithmic: false,
            range: None,
            limit: None,
        })
        .collect()
}

/// A run as a point of a picture.
struct Point {
    x: f64,
    other: f64,
    value: f64,
    limit: f64,
}

fn draw(sweep: &Sweep, shards: &[Records], request: &PictureRequest) -> Result<Chart, FileError> {
    let columns = sweep.quantities().columns();
    let column = |name: &str| columns.iter().position(|column| column == name);
    let (value, limit) = (column(&request.quantity), request.limit.as_deref().and_then(column));
    let other = match request.over {
        Over::Alone => None,
        Over::Curves(index) | Over::Map(index) => Some(index),
    };
    // Runs are selected in which axes that the picture does not show have their first values.
    let first: Vec<toml::Value> = sweep.axes().iter().map(|axis| axis.value(0)).collect();
    let hidden: Vec<usize> = (0..sweep.axes().len())
        .filter(|&index| sweep.is_grid() && index != request.x && Some(index) != other)
        .collect();
    let mut points = Vec::new();
    for run in 0..sweep.runs() {
        let values = sweep.values_of(run);
        if hidden.iter().any(|&index| values[index] != first[index]) {
            continue;
        }
        let record = record_of(shards, run)?;
        let of = |index: Option<usize>| {
            index.and_then(|index| record.values.get(index).copied()).unwrap_or(f64::NAN)
        };
        let at = |index: usize| number(&values[index]).unwrap_or(f64::NAN);
        let other = other.map_or(0.0, at);
        points.push(Point { x: at(request.x), other, value: of(value), limit: of(limit) });
    }
    let hidden_words: Vec<String> = hidden
        .iter()
        .filter(|&&index| sweep.axes()[index].count() > 1)
        .map(|&index| format!("{} = {}", sweep.axes()[index].path, cell(&first[index])))
        .collect();
    let quantity = axis(&described(&request.quantity), request.logarithmic, request.range);
    let x_axis = swept_axis(&sweep.axes()[request.x]);
    let chart = match request.over {
        Over::Map(index) => {
            let y_axis = swept_axis(&sweep.axes()[index]);
            let map = match sweep.is_grid() {
                true => ColourMap::cells(
                    quantity,
                    points.iter().map(|point| ((point.x, point.other), point.value)),
                ),
                false => ColourMap::points(
                    quantity,
                    points.iter().map(|point| ((point.x, point.other), point.value)),
                ),
            };
            let mut chart = Chart::new(sweep.heading(), x_axis, y_axis).with_map(map);
            if let Some(name) = &request.limit {
                let line = boundary(&points);
                chart = chart.with(Series::new(format!("limit of {name}"), Style::Reference, line));
            }
            chart
        }
        Over::Alone => {
            let style = if sweep.is_grid() { Style::LineWithPoints } else { Style::Points };
            let line = points.iter().map(|point| (point.x, point.value)).collect();
            Chart::new(sweep.heading(), x_axis, quantity).with(Series::new(
                request.quantity.clone(),
                style,
                line,
            ))
        }
        Over::Curves(index) => {
            let swept = &sweep.axes()[index];
            let swept_points = sweep.axes()[request.x].count();
            let mut chart = Chart::new(sweep.heading(), x_axis, quantity);
            for entry in 0..swept.count() {
                let there = swept.value(entry);
                let place = number(&there).unwrap_or(f64::NAN);
                let line = points.iter().filter(|point| point.other == place);
                let line = line.map(|point| (point.x, point.value)).collect();
                let label = format!("{} = {}", last_words(&swept.path), short(place));
                let style = if swept_points <= MOST_MARKED { Style::LineWithPoints } else { Style::Line };
                chart = chart.with(Series::new(label, style, line));
            }
            chart
        }
    };
    Ok(chart.on_paper(sweep.paper()).with_subtitle(hidden_words.join("; ")))
}

/// What a column of results is, for an axis: `q0` is the coordinate at the end of the run.
fn described(quantity: &str) -> String {
    let is_coordinate = |name: &str| {
        let index = name.strip_prefix(['q', 'p']);
        index.is_some_and(|index| !index.is_empty() && index.bytes().all(|digit| digit.is_ascii_digit()))
    };
    match (quantity.strip_prefix("largest_"), quantity.strip_prefix("amplitude_")) {
        _ if is_coordinate(quantity) || quantity == "energy" => format!("{quantity} at the end"),
        (Some(name), _) if is_coordinate(name) => format!("largest |{name}|"),
        (_, Some(name)) if is_coordinate(name) => format!("amplitude of {name}"),
        _ if quantity == "energy_left" => "energy at the end / at the start".to_owned(),
        _ => quantity.to_owned(),
    }
}

fn axis(label: &str, logarithmic: bool, range: Option<(f64, f64)>) -> Axis {
    let axis = if logarithmic { Axis::logarithmic(label) } else { Axis::linear(label) };
    match range {
        Some((from, to)) => axis.with_range(from, to),
        None => axis,
    }
}

fn swept_axis(swept: &SweptAxis) -> Axis {
    axis(&swept.path, swept.is_logarithmic(), None)
}

/// A number with as many digits as a legend has room for.
fn short(value: f64) -> String {
    let rounded: f64 = format!("{value:.3e}").parse().unwrap_or(value);
    format!("{rounded}")
}

/// The last part of a path, as a label.
fn last_words(path: &str) -> &str {
    path.rsplit_once('.').map_or(path, |(_, last)| last)
}

/// Boundary where a column changes from 1 to 0: for each x, the midpoint of the highest y with 1 and the next
/// y.
fn boundary(points: &[Point]) -> Vec<(f64, f64)> {
    let mut sorted: Vec<&Point> = points.iter().filter(|point| !point.limit.is_nan()).collect();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.other.total_cmp(&b.other)));
    let mut line = Vec::new();
    for column in sorted.chunk_by(|a, b| a.x == b.x) {
        let mut changes = column.windows(2).filter(|pair| (pair[0].limit > 0.5) != (pair[1].limit > 0.5));
        let Some(pair) = changes.next_back() else {
            line.push((column[0].x, f64::NAN));
            continue;
        };
        let (low, high) = (pair[0].other, pair[1].other);
        let middle = if low > 0.0 && high / low > 1.5 { (low * high).sqrt() } else { 0.5 * (low + high) };
        line.push((pair[0].x, middle));
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_boundary_lies_between_the_values_where_a_column_changes() {
        let point = |x, other, limit| Point { x, other, value: 0.0, limit };
        let points = [
            point(1.0, 0.5, 1.0),
            point(1.0, 0.6, 0.0),
            point(1.0, 0.7, 0.0),
            point(2.0, 0.5, 1.0),
            point(2.0, 0.6, 1.0),
            point(2.0, 0.7, 0.0),
            point(3.0, 0.5, 1.0),
        ];
        let line = boundary(&points);
        assert_eq!(line[0], (1.0, 0.55));
        assert!((line[1].1 - 0.65).abs() < 1e-15 && line[2].1.is_nan());
    }
}
