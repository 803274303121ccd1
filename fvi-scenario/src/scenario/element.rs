//! `[[system.element]]`: nonlinear potentials of a few coordinates each.

use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Expression, Symbols};
use serde::Serialize;

/// One potential U(x₀, x₁, …) applied at many places: Σ U(q_{c₀}, q_{c₁}, …) over the rows c of coordinates.
#[derive(Clone, Debug, Serialize)]
pub struct Element {
    /// U in x0, x1, … and the parameters.
    pub potential: Expression,
    /// The coordinates for x0, x1, …, one row for each place.
    pub coordinates: Vec<Vec<usize>>,
}

/// Largest number of coordinates of an element.
const WIDEST: usize = 64;

impl Element {
    pub(super) fn read(table: &Table<'_>, symbols: &Symbols, count: usize) -> Result<Self, InputError> {
        table.allow(&["potential", "coordinates"])?;
        let value = table.required("coordinates")?;
        let rows = value.list("a list of rows, each a list of coordinates")?;
        let coordinates: Vec<_> = rows.iter().map(|row| read_row(row, count)).collect::<Result<_, _>>()?;
        let width = coordinates.first().map_or(0, Vec::len);
        if !(1..=WIDEST).contains(&width) {
            return Err(value.out_of_range(format!("rows of 1 to {WIDEST} coordinates each")));
        }
        if let Some(index) = coordinates.iter().position(|row| row.len() != width) {
            return Err(rows[index].error(Problem::WrongShape {
                expected: format!("{width} coordinates, as many as the first row has"),
                found: format!("{}", coordinates[index].len()),
            }));
        }
        let names = (0..width).map(|index| format!("x{index}"));
        let potential = table.required("potential")?.expression(&symbols.clone().with_variables(names))?;
        Ok(Self { potential, coordinates })
    }
}

/// Reads a row of distinct coordinates below `count`.
fn read_row(row: &Value<'_>, count: usize) -> Result<Vec<usize>, InputError> {
    let places = row.list("a list of coordinates")?;
    let mut coordinates = Vec::with_capacity(places.len());
    for place in &places {
        let coordinate = place.whole(0..=count - 1)?;
        if coordinates.contains(&coordinate) {
            return Err(place.out_of_range("coordinates that differ within a row"));
        }
        coordinates.push(coordinate);
    }
    Ok(coordinates)
}
