//! The pictures of a run: coordinates over time, phase portrait, energy.

use crate::results::files::{FileError, remove, write_picture};
use crate::results::picture::{Axis, Chart, Series, Style};
use crate::results::run_traces::RunTraces;
use crate::results::trace::Envelope;
use crate::results::trajectory::States;
use fvi_scenario::scenario::{ReferenceRow, ReferenceSource, Scenario};
use fvi_simulation::simulation::columns::{Columns, Source};
use std::path::Path;

/// Number of segments of the polygon that a reference is drawn with.
const REFERENCE_INTERVALS: usize = 600;

impl RunTraces {
    /// Draws the pictures of a run up to the time `end`; adds the names of the files to `files`.
    pub(crate) fn draw(
        &self,
        scenario: &Scenario,
        end: f64,
        directory: &Path,
        files: &mut Vec<&'static str>,
    ) -> Result<(), FileError> {
        let reference = reference_rows(scenario, end);
        let mut charts = vec![("coordinates.svg", self.coordinates(scenario, &reference))];
        if scenario.equation.is_some() {
            remove(&directory.join("energy.svg"))?;
        } else {
            charts.push(("energy.svg", self.energy(scenario, &reference)));
        }
        match self.phase_portrait(scenario, &reference) {
            Some(chart) => charts.push(("phase.svg", chart)),
            // A phase portrait left by an earlier run of another system would be mistaken for one of this
            // run.
            None => remove(&directory.join("phase.svg"))?,
        }
        if scenario.controllers.is_empty() {
            ["control.svg", "output.svg"].iter().try_for_each(|name| remove(&directory.join(name)))?;
        } else {
            charts.extend([("control.svg", self.followed(scenario)), ("output.svg", self.put_out(scenario))]);
        }
        for (name, chart) in &charts {
            write_picture(&directory.join(name), chart)?;
            files.push(name);
        }
        Ok(())
    }

    /// The columns of a source.
    fn of(&self, scenario: &Scenario, source: Source) -> &[Envelope] {
        self.columns.get(Columns::of(scenario).places(source)).unwrap_or(&[])
    }

    fn coordinates(&self, scenario: &Scenario, reference: &[ReferenceRow]) -> Chart {
        let chosen = scenario.written_coordinates();
        let letter = States::of(scenario).letter();
        let labels = &scenario.output.appearance.labels;
        let label = match (chosen.as_slice(), labels.as_slice(), &scenario.equation) {
            (_, [only], _) => only.clone(),
            ([only], _, Some(_)) => format!("solution {letter}{only}"),
            ([only], _, None) => format!("position {letter}{only}"),
            (_, _, Some(_)) => "solution".to_owned(),
            (_, _, None) => "position".to_owned(),
        };
        let axis = Axis::linear(label).in_units(&scenario.output.appearance.units.position);
        let mut chart = chart(scenario, time_axis(scenario), axis);
        for (place, (index, envelope)) in chosen.iter().zip(&self.coordinates).enumerate() {
            let name = labels.get(place).cloned().unwrap_or_else(|| format!("{letter}{index}"));
            chart = chart.with(Series::new(name, Style::Line, envelope.points()));
        }
        for (index, &coordinate) in chosen.iter().take(self.coordinates.len()).enumerate() {
            let known = |row: &ReferenceRow| Some((row.time, (*row.position.get(coordinate)?)?));
            let points: Vec<_> = reference.iter().filter_map(known).collect();
            // One entry in the legend stands for the references of all coordinates.
            let label = if index == 0 { "reference" } else { "" };
            chart = with_reference(chart, scenario, label, points);
        }
        chart
    }

    /// Setpoints and measured values.
    fn followed(&self, scenario: &Scenario) -> Chart {
        let several = scenario.controllers.len() > 1;
        let mut chart = chart(scenario, time_axis(scenario), Axis::linear("setpoint and measured value"));
        for (index, curves) in self.of(scenario, Source::Controllers).chunks_exact(3).enumerate() {
            let name = |what: &str| if several { format!("{what} {index}") } else { what.to_owned() };
            chart = chart
                .with(Series::new(name("setpoint"), Style::Reference, curves[1].points()))
                .with(Series::new(name("measure"), Style::Line, curves[2].points()));
        }
        chart
    }

    /// Outputs of the controllers, and their limits if an output comes near them.
    fn put_out(&self, scenario: &Scenario) -> Chart {
        let several = scenario.controllers.len() > 1;
        let mut chart = chart(scenario, time_axis(scenario), Axis::linear("output u"));
        for (index, (curves, controller)) in
            self.of(scenario, Source::Controllers).chunks_exact(3).zip(&scenario.controllers).enumerate()
        {
            let name = |what: &str| if several { format!("{what} {index}") } else { what.to_owned() };
            let points = curves[0].points();
            let (begin, end) = (points.first().map(|point| point.0), points.last().map(|point| point.0));
            for limit in controller.settings.limits.into_iter().filter(|limit| limit.is_finite()) {
                let reached = points.iter().any(|&(_, output)| output == limit);
                if let (Some(begin), Some(end), true) = (begin, end, reached) {
                    let line = vec![(begin, limit), (end, limit)];
                    chart = chart.with(Series::new(name("limit"), Style::Reference, line));
                }
            }
            chart = chart.with(Series::new(name("u"), Style::Line, points));
        }
        chart
    }

    fn energy(&self, scenario: &Scenario, reference: &[ReferenceRow]) -> Chart {
        let points = reference.iter().filter_map(|row| Some((row.time, row.energy?))).collect();
        let units = &scenario.output.appearance.units;
        let energy_axis = Axis::linear("energy ½ pᵀM⁻¹p + U(q)").in_units(&units.energy);
        let mut chart = chart(scenario, time_axis(scenario), energy_axis).with(Series::new(
            "energy",
            Style::Line,
            self.energy.points(),
        ));
        let of_memories = self.of(scenario, Source::Memories);
        for (name, envelope) in ["stored in memories", "dissipated by them"].into_iter().zip(of_memories) {
            chart = chart.with(Series::new(name, Style::Line, envelope.points()));
        }
        with_reference(chart, scenario, "reference", points)
    }

    fn phase_portrait(&self, scenario: &Scenario, reference: &[ReferenceRow]) -> Option<Chart> {
        let chosen = scenario.written_coordinates();
        let coordinate = chosen.first().copied()?;
        // An equation has the second unknown in place of a momentum.
        let second = chosen.get(1).copied().filter(|_| scenario.equation.is_some());
        let known = |row: &ReferenceRow| {
            let beside = match second {
                Some(second) => row.position.get(second)?,
                None => row.momentum.get(coordinate)?,
            };
            Some((*row.position.get(coordinate)?.as_ref()?, *beside.as_ref()?))
        };
        let points = reference.iter().filter_map(known).collect();
        let path = self.phase.as_ref()?;
        let mut subtitle = subtitle(scenario);
        if path.interrupted() {
            subtitle += "; beginning and end of the run";
        }
        let appearance = &scenario.output.appearance;
        let label = |place: usize, name: String| appearance.labels.get(place).cloned().unwrap_or(name);
        let (y, unit) = match second {
            Some(second) => (label(1, format!("x{second}")), &appearance.units.position),
            None => (format!("momentum p{coordinate}"), &appearance.units.momentum),
        };
        let x = match second {
            Some(_) => label(0, format!("x{coordinate}")),
            None => label(0, format!("position q{coordinate}")),
        };
        let (x, y) = (Axis::linear(x).in_units(&appearance.units.position), Axis::linear(y).in_units(unit));
        let chart = Chart::new(scenario.heading(), x, y)
            .on_paper(appearance.paper)
            .with_subtitle(subtitle)
            .with(Series::new("trajectory", Style::Line, path.points()));
        Some(with_reference(chart, scenario, "reference", points))
    }
}

fn chart(scenario: &Scenario, x: Axis, y: Axis) -> Chart {
    Chart::new(scenario.heading(), x, y)
        .on_paper(scenario.output.appearance.paper)
        .with_subtitle(subtitle(scenario))
}

/// Number of decades of time beyond which the time axis is logarithmic.
const MOST_DECADES: f64 = 3.0;

/// True if the grid spans so many decades that the time axis is logarithmic.
fn over_decades(scenario: &Scenario) -> bool {
    scenario.time.grid.is_some() && (scenario.time.end() / first_time(scenario)).log10() > MOST_DECADES
}

/// First time after 0 on a logarithmic axis. For adaptive steps it is taken from the output times, since the
/// first steps may be extremely short because of a singular start.
fn first_time(scenario: &Scenario) -> f64 {
    let asked = scenario.output.times.iter().copied().find(|&time| time > 0.0);
    match scenario.time.adaptive() {
        Some(adaptive) => asked.or(adaptive.first).unwrap_or(adaptive.end),
        None => scenario.time.time(1),
    }
}

fn time_axis(scenario: &Scenario) -> Axis {
    let axis = if over_decades(scenario) { Axis::logarithmic("time t") } else { Axis::linear("time t") };
    axis.in_units(&scenario.output.appearance.units.time)
}

fn subtitle(scenario: &Scenario) -> String {
    let mut words = scenario.scheme.describe();
    if !scenario.system.damping.is_empty() {
        words += &format!("; {}", scenario.convolution.describe());
    }
    format!("{words}; {}", scenario.time.describe())
}

fn with_reference(chart: Chart, scenario: &Scenario, label: &str, points: Vec<(f64, f64)>) -> Chart {
    if points.is_empty() {
        return chart;
    }
    let style = match scenario.reference.as_ref().map(|reference| &reference.source) {
        Some(ReferenceSource::Table { .. }) => Style::ReferencePoints,
        _ => Style::Reference,
    };
    chart.with(Series::new(label, style, points))
}

/// The reference over the computed time: all rows of a table, or a fine polygon of an expression.
fn reference_rows(scenario: &Scenario, end: f64) -> Vec<ReferenceRow> {
    let Some(reference) = &scenario.reference else { return Vec::new() };
    match &reference.source {
        ReferenceSource::Table { rows, .. } => {
            let end = end * (1.0 + 1e-9);
            rows.iter().filter(|row| row.time <= end).cloned().collect()
        }
        ReferenceSource::Expressions { .. } => {
            let first = first_time(scenario);
            let at = |index: usize| {
                let part = index as f64 / REFERENCE_INTERVALS as f64;
                if over_decades(scenario) { first * (end / first).powf(part) } else { end * part }
            };
            let row = |index| reference.at_time(at(index), scenario.coordinates());
            (0..=REFERENCE_INTERVALS).filter_map(row).collect()
        }
    }
}
