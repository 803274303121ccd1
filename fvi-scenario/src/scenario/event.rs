//! `[[event]]`: events detected during the run.

use super::system::System;
use crate::language::document::Table;
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Expression, Symbols};
use serde::Serialize;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

/// A function of time, position and momentum; the latter two have one number for each coordinate.
type Function = dyn FnMut(f64, &[f64], &[f64]) -> f64 + Send;

/// A function in code for an event, shared by the parts of a run. A call that fails returns NaN and stores
/// its error itself.
#[derive(Clone)]
pub struct SharedFunction(Arc<Mutex<Function>>);

impl SharedFunction {
    /// Wraps a function for sharing.
    pub fn new(function: impl FnMut(f64, &[f64], &[f64]) -> f64 + Send + 'static) -> Self {
        Self(Arc::new(Mutex::new(function)))
    }

    /// Its value.
    pub fn value(&self, time: f64, position: &[f64], momentum: &[f64]) -> f64 {
        (*self.0.lock().unwrap_or_else(PoisonError::into_inner))(time, position, momentum)
    }
}

impl fmt::Debug for SharedFunction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SharedFunction(…)")
    }
}

/// An event: a function of time, position and momentum passes zero.
#[derive(Clone, Debug, Serialize)]
pub struct Event {
    /// A function in code that replaces `when`.
    #[serde(skip)]
    pub own: Option<SharedFunction>,
    /// The function, of `t`, `q0`, …, `p0`, … and the parameters.
    pub when: Expression,
    /// The direction of the zero crossings.
    pub direction: Direction,
    /// Action at the event.
    pub action: Action,
}

/// Direction in which a function crosses zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// From negative to positive.
    Rising,
    /// From positive to negative.
    Falling,
    /// Both directions.
    #[default]
    Both,
}

/// Action of an event.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Action {
    /// The event is written to `summary.json`.
    #[default]
    Record,
    /// The event is written, and the run ends.
    Stop,
}

impl Event {
    /// The names of the momenta; the unknowns of an equation have none.
    fn momenta(system: &System) -> impl Iterator<Item = String> + use<> {
        let momenta = if system.stands_for_equation() { 0 } else { system.coordinates() };
        (0..momenta).map(|index| format!("p{index}"))
    }

    /// The names in `when`.
    pub(super) fn symbols(system: &System) -> Symbols {
        let symbols = system.symbols().with_time().with_variables(system.names());
        symbols.with_variables(Self::momenta(system))
    }

    pub(super) fn read(table: &Table<'_>, system: &System) -> Result<Self, InputError> {
        table.allow(&["when", "direction", "action"])?;
        if let Some(name) = Self::momenta(system).find(|name| system.parameters.contains_key(name)) {
            return Err(table.required("when")?.error(Problem::Incompatible {
                with: format!("a parameter with the name `{name}`"),
                allowed: "another name of the parameter: here it is a momentum".to_owned(),
            }));
        }
        let value = table.required("when")?;
        let when = value.expression(&Self::symbols(system))?;
        if when.root().as_number().is_some() {
            return Err(value.out_of_range("a function of t, positions or momenta, which may pass zero"));
        }
        let directions =
            [("rising", Direction::Rising), ("falling", Direction::Falling), ("both", Direction::Both)];
        let direction = table
            .optional("direction")
            .map_or(Ok(Direction::default()), |value| value.choice(&directions))?;
        let actions = [("record", Action::Record), ("stop", Action::Stop)];
        let action =
            table.optional("action").map_or(Ok(Action::default()), |value| value.choice(&actions))?;
        Ok(Self { own: None, when, direction, action })
    }
}
