//! `[[case]]`: load cases of one linear structure, integrated together.

use super::load::Load;
use super::{Scenario, System};
use crate::language::document::{Table, Value};
use crate::language::error::InputError;
use serde::Serialize;

/// A load case: the structure under the loads of the system and those listed here.
#[derive(Clone, Debug, Serialize)]
pub struct Case {
    /// The name of its output directory.
    pub name: String,
    /// Its additional loads; may be empty.
    #[serde(rename = "load")]
    pub loads: Vec<Load>,
}

/// Longest name of a case, in bytes.
const LONGEST_NAME: usize = 64;

impl Case {
    /// Reads `[[case]]`.
    pub(super) fn read_all(value: &Value<'_>, system: &System) -> Result<Vec<Self>, InputError> {
        let tables = value.list("a list of tables, each headed [[case]]")?;
        let mut cases: Vec<Self> = Vec::new();
        for case in &tables {
            let case = Self::read(&case.table()?, system, &cases)?;
            cases.push(case);
        }
        if cases.is_empty() {
            return Err(value.out_of_range("one case at least"));
        }
        Ok(cases)
    }

    fn read(table: &Table<'_>, system: &System, before: &[Self]) -> Result<Self, InputError> {
        table.allow(&["name", "load"])?;
        let value = table.required("name")?;
        let name = value.text()?.to_owned();
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if name.is_empty() || name.len() > LONGEST_NAME || !name.chars().all(plain) {
            let allowed = format!(
                "1 to {LONGEST_NAME} letters a to z, digits, `-` and `_`: it is the name of a directory"
            );
            return Err(value.out_of_range(allowed));
        }
        // On some file systems names that differ only in case are the same.
        if before.iter().any(|other| other.name.eq_ignore_ascii_case(&name)) {
            return Err(value.out_of_range("a name of its own for each case"));
        }
        let given = table.optional("load");
        let given =
            given.map(|value| value.list("a list of tables, each headed [[case.load]]")).transpose()?;
        let loads = given
            .unwrap_or_default()
            .iter()
            .map(|load| Load::read(&load.table()?, &system.symbols(), system.coordinates()))
            .collect::<Result<_, _>>()?;
        Ok(Self { name, loads })
    }
}

impl Scenario {
    /// The scenario of one load case alone; without cases the scenario itself.
    pub fn case(&self, index: usize) -> Self {
        let mut scenario = self.clone();
        scenario.cases = Vec::new();
        if let Some(case) = self.cases.get(index) {
            scenario.system.loads.extend(case.loads.iter().cloned());
            scenario.title = Some(format!("{}: {}", self.heading(), case.name));
        }
        scenario
    }

    /// Range of the numbers of a load case in vectors of all motions.
    pub fn places_of(&self, case: usize) -> std::ops::Range<usize> {
        case * self.coordinates()..(case + 1) * self.coordinates()
    }

    /// Number of motions integrated together: one for each load case.
    pub fn copies(&self) -> usize {
        self.cases.len().max(1)
    }
}
