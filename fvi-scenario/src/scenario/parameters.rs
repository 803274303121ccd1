//! `parameters`: named constants of the expressions.

use crate::language::document::Value;
use crate::language::error::{InputError, Problem};
use crate::language::expression::Symbols;
use std::collections::BTreeMap;

/// Reads named constants.
///
/// # Errors
/// If a name is not valid, or a value is not a finite number.
pub fn read_parameters(value: &Value<'_>) -> Result<BTreeMap<String, f64>, InputError> {
    let mut parameters = BTreeMap::new();
    for (name, entry) in value.table()?.entries() {
        Symbols::new()
            .with_parameter(name, 0.0)
            .map_err(|error| entry.key_error(Problem::ParameterName(error)))?;
        parameters.insert(name.to_owned(), entry.number()?);
    }
    Ok(parameters)
}

/// Symbols with the parameters, whose names were checked when they were read.
pub(super) fn symbols_of(parameters: &BTreeMap<String, f64>) -> Symbols {
    let mut symbols = Symbols::new();
    for (name, &value) in parameters {
        // An expression that uses a name without a meaning is refused with it.
        let _ = symbols.add_parameter(name, value);
    }
    symbols
}

/// The names in a potential of `count` coordinates.
pub(super) fn symbols_of_potential(parameters: &BTreeMap<String, f64>, count: usize) -> Symbols {
    symbols_of(parameters).with_coordinates(count)
}

/// The names in a force on `count` coordinates.
pub(super) fn symbols_of_force(parameters: &BTreeMap<String, f64>, count: usize) -> Symbols {
    symbols_of(parameters).with_time().with_coordinates(count).with_velocities(count, |_| false)
}
