//! `[reference]`: a known solution, as expressions in t or as a table.

use super::system::System;
use super::time::{OutputOptions, TimeGrid, same_time};
use crate::language::document::{Document, Table};
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Expression, Moment};
use crate::language::number_table::NumberTable;
use serde::Serialize;

/// A known solution.
#[derive(Clone, Debug, Serialize)]
pub struct Reference {
    /// Its source.
    #[serde(flatten)]
    pub source: ReferenceSource,
}

/// Source of a known solution.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum ReferenceSource {
    /// Expressions in t and the parameters.
    Expressions {
        /// q(t), one for each coordinate.
        #[serde(skip_serializing_if = "Option::is_none")]
        position: Option<Vec<Expression>>,
        /// p(t), one for each coordinate.
        #[serde(skip_serializing_if = "Option::is_none")]
        momentum: Option<Vec<Expression>>,
        /// E(t).
        #[serde(skip_serializing_if = "Option::is_none")]
        energy: Option<Expression>,
    },
    /// Values at given times.
    Table {
        /// The file that contains them, as written in the scenario.
        file: String,
        /// The values, ascending in time.
        #[serde(skip)]
        rows: Vec<ReferenceRow>,
    },
}

/// The known solution at one time; unknown values are `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceRow {
    /// t.
    pub time: f64,
    /// q, by coordinate.
    pub position: Vec<Option<f64>>,
    /// p, by coordinate.
    pub momentum: Vec<Option<f64>>,
    /// E.
    pub energy: Option<f64>,
    /// Number of values of the reference at this time that are infinite or not a number; they count as
    /// unknown.
    pub undefined: usize,
}

impl Reference {
    pub(super) fn read(
        table: &Table<'_>,
        system: &System,
        (grid, output): (&TimeGrid, &OutputOptions),
        document: &Document,
    ) -> Result<Self, InputError> {
        if system.stands_for_equation() {
            table.allow(&["position", "file"])?;
        }
        table.allow(&["position", "momentum", "energy", "file"])?;
        let count = system.names().count();
        if let Some(value) = table.optional("file") {
            for key in ["position", "momentum", "energy"] {
                if let Some(other) = table.optional(key) {
                    return Err(other.error(Problem::Conflict { other: "reference.file".to_owned() }));
                }
            }
            let rows = read_rows(&value, document, system)?;
            let reference = Self { source: ReferenceSource::Table { file: value.text()?.to_owned(), rows } };
            if !reference.meets(grid, output) {
                let reason = match &grid.grid {
                    None => {
                        format!("none of its times is a grid point k·{}, k = 0…{}", grid.step, grid.steps)
                    }
                    Some(_) => "none of its times is a grid point (`time.must_hit`) or one of `output.times`"
                        .to_owned(),
                };
                let file = document.resolve(value.text()?).display().to_string();
                return Err(value.error(Problem::Table { file, line: 2, reason }));
            }
            return Ok(reference);
        }
        let symbols = system.symbols().with_time();
        let list = |key| table.optional(key).map(|value| value.expressions(&symbols, count)).transpose();
        let position = list("position")?;
        let momentum = list("momentum")?;
        let energy = table.optional("energy").map(|value| value.expression(&symbols)).transpose()?;
        if position.is_none() && momentum.is_none() && energy.is_none() {
            table.required("position")?;
        }
        for (key, expressions) in [("position", &position), ("momentum", &momentum)] {
            let Some(value) = table.optional(key) else { continue };
            let entries = value.list("a list of expressions in quotes")?;
            for (entry, expression) in entries.iter().zip(expressions.iter().flatten()) {
                check_finite_somewhere(expression, entry, grid)?;
            }
        }
        if let (Some(value), Some(expression)) = (table.optional("energy"), &energy) {
            check_finite_somewhere(expression, &value, grid)?;
        }
        Ok(Self { source: ReferenceSource::Expressions { position, momentum, energy } })
    }

    /// The known solution at grid point `index` of a grid of the given step; `None` if no value is known
    /// there.
    pub fn at_step(&self, index: usize, step: f64, coordinates: usize) -> Option<ReferenceRow> {
        let time = step * index as f64;
        match &self.source {
            ReferenceSource::Expressions { .. } => self.at_time(time, coordinates),
            ReferenceSource::Table { rows, .. } => {
                let tolerance = same_time(time, step);
                let next = rows.partition_point(|row| row.time < time - tolerance);
                rows.get(next).filter(|row| row.time <= time + tolerance).cloned()
            }
        }
    }

    /// True if position, momentum and energy are known at one time or more.
    pub fn knows(&self) -> [bool; 3] {
        match &self.source {
            ReferenceSource::Expressions { position, momentum, energy } => {
                [position.is_some(), momentum.is_some(), energy.is_some()]
            }
            ReferenceSource::Table { rows, .. } => {
                let some = |list: &[Option<f64>]| list.iter().any(Option::is_some);
                [
                    rows.iter().any(|row| some(&row.position)),
                    rows.iter().any(|row| some(&row.momentum)),
                    rows.iter().any(|row| row.energy.is_some()),
                ]
            }
        }
    }

    /// The known solution at grid point `index`; `None` if no value is known there.
    pub fn at_grid_point(&self, index: usize, grid: &TimeGrid, coordinates: usize) -> Option<ReferenceRow> {
        if grid.grid.is_none() && grid.start == 0.0 {
            return self.at_step(index, grid.step, coordinates);
        }
        self.near(grid.time(index), grid.tolerance(index), coordinates)
    }

    /// The known solution at a time of the output; `None` if no value is known there.
    pub fn at_output(&self, time: f64, coordinates: usize) -> Option<ReferenceRow> {
        self.near(time, same_time(time, 0.0), coordinates)
    }

    fn near(&self, time: f64, tolerance: f64, coordinates: usize) -> Option<ReferenceRow> {
        match &self.source {
            ReferenceSource::Expressions { .. } => self.at_time(time, coordinates),
            ReferenceSource::Table { rows, .. } => {
                let next = rows.partition_point(|row| row.time < time - tolerance);
                rows.get(next).filter(|row| row.time <= time + tolerance).cloned()
            }
        }
    }

    /// The known solution at any time; `None` for a table of values.
    pub fn at_time(&self, time: f64, coordinates: usize) -> Option<ReferenceRow> {
        let ReferenceSource::Expressions { position, momentum, energy } = &self.source else { return None };
        // Values of an expression that are infinite or not a number count as unknown.
        let mut undefined = 0;
        let mut value = |expression: &Expression| {
            let value: f64 = expression.value(Moment::inside(time), &[]);
            undefined += usize::from(!value.is_finite());
            Some(value).filter(|value| value.is_finite())
        };
        let mut list = |expressions: &Option<Vec<Expression>>| match expressions {
            Some(expressions) => expressions.iter().map(&mut value).collect(),
            None => vec![None; coordinates],
        };
        let (position, momentum) = (list(position), list(momentum));
        let energy = energy.as_ref().and_then(value);
        Some(ReferenceRow { time, position, momentum, energy, undefined })
    }

    /// True if a value may be known at a grid point or a time of the output; always true for expressions.
    pub(super) fn meets(&self, grid: &TimeGrid, output: &OutputOptions) -> bool {
        let ReferenceSource::Table { rows, .. } = &self.source else { return true };
        rows.iter().any(|row| grid.index_of(row.time).is_some() || output.has(row.time))
    }

    /// Number of times of a table up to the end of the grid that are not grid points: no value is compared
    /// there.
    pub(super) fn off_grid(&self, grid: &TimeGrid, output: &OutputOptions) -> usize {
        let ReferenceSource::Table { rows, .. } = &self.source else { return 0 };
        let within = |row: &&ReferenceRow| (0.0..=grid.end()).contains(&row.time);
        let missed = |row: &&ReferenceRow| grid.index_of(row.time).is_none() && !output.has(row.time);
        rows.iter().filter(within).filter(missed).count()
    }
}

/// Largest number of grid points at which an expression is evaluated.
const MOST_TRIED: usize = 1 << 20;

/// Refuses an expression that is infinite or not a number at every grid point: nothing could be compared.
fn check_finite_somewhere(
    expression: &Expression,
    value: &crate::language::document::Value<'_>,
    grid: &TimeGrid,
) -> Result<(), InputError> {
    let finite = |index: usize| expression.value::<f64>(Moment::inside(grid.time(index)), &[]).is_finite();
    if grid.steps > MOST_TRIED || (0..=grid.steps).any(finite) {
        return Ok(());
    }
    let place = format!("any of the {} grid points", grid.steps + 1);
    Err(value.error(Problem::NotFinite { what: "the reference", place }))
}

fn read_rows(
    value: &crate::language::document::Value<'_>,
    document: &Document,
    system: &System,
) -> Result<Vec<ReferenceRow>, InputError> {
    let mut columns: Vec<String> = system.names().collect();
    let count = columns.len();
    if !system.stands_for_equation() {
        columns.extend((0..count).map(|index| format!("p{index}")).chain(["energy".to_owned()]));
    }
    let table = NumberTable::read(value, document, &columns)?;
    let place = |column: &String| table.names.iter().position(|name| name == column);
    let places: Vec<Option<usize>> = columns.iter().map(place).collect();
    let row = |numbers: &Vec<f64>| {
        let mut known = places.iter().map(|place| place.map(|at| numbers[at]));
        ReferenceRow {
            time: numbers[0],
            position: known.by_ref().take(count).collect(),
            momentum: known.by_ref().take(count).collect(),
            energy: known.next().flatten(),
            undefined: 0,
        }
    };
    Ok(table.rows.iter().map(row).collect())
}
