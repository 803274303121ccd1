//! `[[system.element]]`: nonlinear potentials of a few coordinates each.

use super::parameters::symbols_of;
use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::expression::Expression;
use serde::Serialize;
use std::collections::BTreeMap;

/// One potential U(x₀, x₁, …) applied at many places: Σ U(q_{c₀}, q_{c₁}, …) over the rows c of coordinates.
#[derive(Clone, Debug, Serialize)]
pub struct Element {
    /// U in x0, x1, … and the parameters; with `along` in place of `coordinates` the elongations are put in.
    pub potential: Expression,
    /// The coordinates for x0, x1, …, one row for each place.
    pub coordinates: Vec<Vec<usize>>,
}

/// Largest number of coordinates of an element.
const WIDEST: usize = 64;

impl Element {
    pub(super) fn read(
        table: &Table<'_>,
        parameters: &BTreeMap<String, f64>,
        count: usize,
    ) -> Result<Self, InputError> {
        table.allow(&["potential", "coordinates", "along"])?;
        let symbols = symbols_of(parameters);
        if let Some(along) = table.optional("along") {
            if let Some(other) = table.optional("coordinates") {
                let allowed = "one of the two: x0, x1, … are the elongations".to_owned();
                return Err(other.error(Problem::Incompatible { with: "`along`".to_owned(), allowed }));
            }
            return Self::read_along(&along, &table.required("potential")?, parameters, count);
        }
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

    /// U(g₀(q), g₁(q), …), as an element of the coordinates that occur in the elongations.
    fn read_along(
        along: &Value<'_>,
        potential: &Value<'_>,
        parameters: &BTreeMap<String, f64>,
        count: usize,
    ) -> Result<Self, InputError> {
        let symbols = symbols_of(parameters);
        if let Some(name) = parameters.keys().find(|name| index_of(name, 'x').is_some()) {
            return Err(
                along.out_of_range(format!("parameters with other names than {name}, an elongation's"))
            );
        }
        let lengths = match along.is_text() {
            true => vec![along.clone()],
            false => along.list("an expression of the coordinates, or a list of them")?,
        };
        let of_position = symbols.clone().with_coordinates(count);
        let lengths: Vec<Expression> =
            lengths.iter().map(|length| length.expression(&of_position)).collect::<Result<_, _>>()?;
        let occurs = |index: &usize| lengths.iter().any(|length| length.root().has_variable(*index));
        let coordinates: Vec<usize> = (0..count).filter(occurs).collect();
        if !(1..=WIDEST).contains(&coordinates.len()) {
            return Err(along.out_of_range(format!("elongations of 1 to {WIDEST} coordinates together")));
        }
        let names = |count: usize| (0..count).map(|index| format!("x{index}"));
        // Errors are told at the key.
        let of_lengths = potential.expression(&symbols.clone().with_variables(names(lengths.len())))?;
        let place = |coordinate: usize| coordinates.iter().position(|&own| own == coordinate);
        let inner: Vec<String> = (lengths.iter())
            .map(|length| {
                renamed(length.text(), |name| {
                    index_of(name, 'q').and_then(place).map(|index| format!("x{index}"))
                })
            })
            .collect();
        let text = renamed(of_lengths.text(), |name| {
            index_of(name, 'x').and_then(|index| inner.get(index)).map(|length| format!("({length})"))
        });
        let potential = Expression::parse(&text, &symbols.with_variables(names(coordinates.len())))
            .map_err(|error| along.error(Problem::Expression(error)))?;
        Ok(Self { potential, coordinates: vec![coordinates] })
    }
}

/// The index i of a name such as q12, for its letter.
fn index_of(name: &str, letter: char) -> Option<usize> {
    name.strip_prefix(letter)?.parse().ok()
}

/// An expression with other words for some of its names.
fn renamed(text: &str, other: impl Fn(&str) -> Option<String>) -> String {
    let (mut made, mut rest) = (String::new(), text);
    while let Some(first) = rest.chars().next() {
        let is_part = |c: char| c.is_alphanumeric() || c == '_' || (first.is_ascii_digit() && c == '.');
        let end =
            if is_part(first) { rest.find(|c| !is_part(c)).unwrap_or(rest.len()) } else { first.len_utf8() };
        let (word, behind) = rest.split_at(end);
        // The e of 2e3 belongs to a number.
        made += &other(word).unwrap_or_else(|| word.to_owned());
        rest = behind;
    }
    made
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
