//! `[input]`: a force given by samples, each held until the next (zero-order hold).

use super::Scenario;
use super::time::{TimeGrid, same_time};
use crate::language::document::{Document, Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::number_table::NumberTable;
use serde::Serialize;

/// A piecewise constant force on the coordinates, as from a controller with a zero-order hold.
///
/// The input of step k, over [t_k, t_{k+1}], is the last sample whose time is not after t_k (to rounding);
/// the effect of samples inside the step depends on [`ForceQuadrature`](crate::scenario::ForceQuadrature).
/// Zero before the first sample; the last one is held to the end.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SampledInput {
    /// Time from which each sample acts; ascending.
    pub times: Vec<f64>,
    /// The samples, one number for each coordinate.
    pub samples: Vec<Vec<f64>>,
    /// Index of the first step under each sample.
    #[serde(skip)]
    first_steps: Vec<usize>,
}

impl SampledInput {
    pub(super) fn read(
        table: &Table<'_>,
        count: usize,
        grid: &TimeGrid,
        document: &Document,
    ) -> Result<Self, InputError> {
        table.allow(&["samples", "period", "times", "file"])?;
        let (inline, value) = table.either("samples", "file")?;
        let (times, samples) = if inline {
            let samples = value
                .list("a list of samples: numbers, or one row of numbers for each sample")?
                .iter()
                .map(|sample| {
                    if sample.is_list() {
                        return sample.vector(count);
                    }
                    let number = sample.number()?;
                    if count == 1 {
                        return Ok(vec![number]);
                    }
                    let expected = format!("a row of {count} numbers, one for each coordinate");
                    Err(sample.error(Problem::WrongShape { expected, found: "one number".to_owned() }))
                })
                .collect::<Result<Vec<_>, _>>()?;
            if samples.is_empty() {
                return Err(value.out_of_range("at least one sample"));
            }
            let times = match table.optional("times") {
                Some(times) => read_times(table, &times, samples.len())?,
                None => periodic(table, samples.len())?,
            };
            (times, samples)
        } else {
            for key in ["period", "times"] {
                if let Some(value) = table.optional(key) {
                    return Err(value.key_error(Problem::Conflict { other: "input.file".to_owned() }));
                }
            }
            let columns: Vec<String> = (0..count).map(|index| format!("u{index}")).collect();
            let read = NumberTable::read(&value, document, &columns)?;
            let place: Vec<Option<usize>> =
                columns.iter().map(|column| read.names.iter().position(|name| name == column)).collect();
            let sample = |row: &Vec<f64>| place.iter().map(|place| place.map_or(0.0, |at| row[at])).collect();
            (read.rows.iter().map(|row| row[0]).collect(), read.rows.iter().map(sample).collect())
        };
        let mut input = Self { times, samples, first_steps: Vec::new() };
        input.place_on(grid);
        Ok(input)
    }

    /// Samples that act from the given ascending times on, without indices of steps.
    pub fn of(times: Vec<f64>, samples: Vec<Vec<f64>>) -> Self {
        Self { times, samples, first_steps: Vec::new() }
    }

    /// True if a sample has a nonzero force on a coordinate.
    pub fn pushes(&self, coordinate: usize) -> bool {
        self.samples.iter().any(|sample| sample.get(coordinate).is_some_and(|&push| push != 0.0))
    }

    /// Determines the first step under each sample on another grid.
    pub(super) fn place_on(&mut self, grid: &TimeGrid) {
        // Grid times and sample times are rounded: a sample later than t_k by rounding only counts at t_k.
        self.first_steps = self.times.iter().map(|&time| grid.first_step_from(time)).collect();
    }

    /// The first sample that changes the force inside a step of a grid, with beginning and end of that step.
    pub(super) fn first_inside(&self, grid: &TimeGrid) -> Option<(usize, [f64; 2])> {
        self.times.iter().zip(&self.first_steps).enumerate().find_map(|(index, (&time, &first))| {
            let step = [grid.time(first.checked_sub(1)?), grid.time(first)];
            let changes = match index.checked_sub(1) {
                Some(before) => self.samples[index] != self.samples[before],
                None => self.samples[index].iter().any(|&force| force != 0.0),
            };
            (changes && time < grid.end() && grid.index_of(time).is_none()).then_some((index, step))
        })
    }

    /// The input held from a time on, for steps that begin at the times of samples; `None` before the first
    /// sample.
    fn at_time(&self, time: f64) -> Option<&[f64]> {
        let after = self.times.partition_point(|&begin| begin <= time + same_time(time, 0.0));
        after.checked_sub(1).map(|index| self.samples[index].as_slice())
    }

    /// The input held over step `step`; `None` before the first sample.
    pub(crate) fn at_step(&self, step: usize) -> Option<&[f64]> {
        let after = self.first_steps.partition_point(|&first| first <= step);
        after.checked_sub(1).map(|index| self.samples[index].as_slice())
    }
}

impl Scenario {
    /// The sampled input held over a step of the grid, N numbers; none before its first sample, or without
    /// `[input]`.
    pub fn input_over(&self, step: usize) -> &[f64] {
        self.input.as_ref().and_then(|input| input.at_step(step)).unwrap_or_default()
    }

    /// The sampled input held from a time on, as [`input_over`](Self::input_over), for steps that begin at
    /// the times of samples.
    pub fn input_from(&self, time: f64) -> &[f64] {
        self.input.as_ref().and_then(|input| input.at_time(time)).unwrap_or_default()
    }
}

/// The times of periodic samples.
fn periodic(table: &Table<'_>, count: usize) -> Result<Vec<f64>, InputError> {
    let value = table.required("period")?;
    let period = value.positive()?;
    let times: Vec<f64> = (0..count).map(|index| period * index as f64).collect();
    if times.last().is_some_and(|last| !last.is_finite()) {
        let allowed = format!("a period with which the last of {count} samples has a finite time");
        return Err(value.out_of_range(allowed));
    }
    Ok(times)
}

/// One time for each sample, ascending.
fn read_times(table: &Table<'_>, value: &Value<'_>, count: usize) -> Result<Vec<f64>, InputError> {
    if let Some(period) = table.optional("period") {
        return Err(period.key_error(Problem::Conflict { other: "input.times".to_owned() }));
    }
    let times = value.vector(count)?;
    if !times.is_sorted_by(|earlier, later| earlier < later) {
        return Err(value.out_of_range("ascending times"));
    }
    Ok(times)
}
