//! Time–temperature superposition: the shift of each table of data to a temperature of reference.

use super::data::{Answer, Domain, Record};
use fvi_scenario::language::document::{Table, Value};
use fvi_scenario::language::{InputError, Problem};

/// Molar gas constant in J/(mol K), exact since 2019.
const GAS: f64 = 8.314_462_618_153_24;

/// 0 °C in K.
const ICE: f64 = 273.15;

/// The beginning of the paths of its numbers.
const PREFIX: &str = "shift.";

/// The law of the shift factors a_T, by which frequencies are multiplied and times are divided before the
/// model is asked: G(ω; T) = G(a_T ω; T₀).
///
/// ```text
/// wlf:        log₁₀ a_T = −c₁ (T − T₀)/(c₂ + T − T₀)
/// arrhenius:  ln a_T = (E/R)(1/T − 1/T₀) ,   T in K
/// free:       log₁₀ a_T a number of its own for each temperature other than T₀
/// ```
///
/// \[WLF55\]; \[Ferry80\] ch. 11.
#[derive(Clone, Debug)]
pub(super) struct Shift {
    law: Law,
    reference: f64,
    /// Added to temperatures to have them in K.
    zero: f64,
    /// Temperatures of the tables of data.
    temperatures: Vec<f64>,
}

#[derive(Clone, Debug)]
enum Law {
    Wlf {
        c1: f64,
        c2: f64,
    },
    Arrhenius {
        energy: f64,
    },
    /// log₁₀ a_T of each table.
    Free {
        log10: Vec<f64>,
    },
}

/// True for a number of the shift, which is none of the scenario.
pub(super) fn is_of_shift(path: &str) -> bool {
    path.starts_with(PREFIX)
}

impl Shift {
    /// Reads `[shift]`, and the temperatures of the tables of data.
    pub(super) fn read(
        root: &Table<'_>,
        tables: &[Value<'_>],
        records: &[Record],
    ) -> Result<Option<Self>, InputError> {
        let Some(value) = root.optional("shift") else {
            for table in tables {
                if let Some(given) = table.table()?.optional("temperature") {
                    let allowed = "`[shift]`, the law of the shift with the temperature".to_owned();
                    let with = "a fit without `[shift]`".to_owned();
                    return Err(given.key_error(Problem::Incompatible { with, allowed }));
                }
            }
            return Ok(None);
        };
        let table = value.table()?;
        let law = table.required("law")?.choice(&[("wlf", 0), ("arrhenius", 1), ("free", 2)])?;
        let own: &[&str] = [&["c1", "c2"][..], &["energy"], &["log10"]][law];
        table.allow(&[&["law", "reference", "unit"][..], own].concat())?;
        let unit = table.optional("unit");
        let zero = unit.map_or(Ok(ICE), |unit| unit.choice(&[("celsius", ICE), ("kelvin", 0.0)]))?;
        let above_zero = |value: &Value<'_>| -> Result<f64, InputError> {
            let number = value.number()?;
            match number + zero > 0.0 && number.is_finite() {
                true => Ok(number),
                false => Err(value.out_of_range(format!("a temperature above {} ", -zero))),
            }
        };
        let reference = above_zero(&table.required("reference")?)?;
        let mut temperatures = Vec::new();
        for (table, record) in tables.iter().zip(records) {
            let given = table.table()?.required("temperature")?;
            temperatures.push(above_zero(&given)?);
            let answer = match &record.domain {
                Domain::Closed { answer: Answer::Receptance { .. }, .. } => Some("a receptance"),
                Domain::Time => Some("a motion over time"),
                Domain::Closed { .. } => None,
            };
            if let Some(with) = answer {
                let allowed = "data of a modulus or a kernel, which shift with the temperature".to_owned();
                return Err(given.key_error(Problem::Incompatible { with: with.to_owned(), allowed }));
            }
        }
        let number = |key: &str| -> Result<f64, InputError> {
            let value = table.required(key)?;
            let number = value.number()?;
            if number.is_finite() { Ok(number) } else { Err(value.out_of_range("a finite number")) }
        };
        let law = match law {
            0 => Law::Wlf { c1: number("c1")?, c2: number("c2")? },
            1 => Law::Arrhenius { energy: number("energy")? },
            _ => {
                let count = temperatures.len();
                let log10 = table.optional("log10").map(|value| Ok((value.numbers()?, value))).transpose()?;
                let log10 = match log10 {
                    None => vec![0.0; count],
                    Some((numbers, _)) if numbers.len() == count => numbers,
                    Some((_, value)) => {
                        return Err(
                            value.out_of_range(format!("{count} numbers, one for each table of data"))
                        );
                    }
                };
                Law::Free { log10 }
            }
        };
        let shift = Self { law, reference, zero, temperatures };
        if let (Law::Wlf { .. }, Some(record)) =
            (&shift.law, (0..tables.len()).find(|&record| shift.log10(record, &|_| None).is_none()))
        {
            let allowed = format!("c2 + T − T₀ > 0 for every temperature; data[{record}] has another");
            return Err(table.required("c2")?.out_of_range(allowed));
        }
        Ok(Some(shift))
    }

    /// The paths and start values of the numbers that an entry of `[[free]]` means; `None` if there are none.
    pub(super) fn numbers(&self, path: &str) -> Option<Vec<(String, f64)>> {
        let one = |number: f64| Some(vec![(path.to_owned(), number)]);
        match (&self.law, path.strip_prefix(PREFIX)?) {
            (Law::Wlf { c1, .. }, "c1") => one(*c1),
            (Law::Wlf { c2, .. }, "c2") => one(*c2),
            (Law::Arrhenius { energy }, "energy") => one(*energy),
            (Law::Free { log10 }, "log10") => {
                let firsts = (0..log10.len()).filter(|&record| {
                    self.first(record) == record && self.temperatures[record] != self.reference
                });
                Some(firsts.map(|record| (format!("{path}[{record}]"), log10[record])).collect())
            }
            _ => None,
        }
    }

    /// What may be free.
    pub(super) fn names(&self) -> &'static str {
        match self.law {
            Law::Wlf { .. } => "shift.c1, shift.c2",
            Law::Arrhenius { .. } => "shift.energy",
            Law::Free { .. } => "shift.log10",
        }
    }

    /// The first table at the temperature of a table.
    fn first(&self, record: usize) -> usize {
        let own = self.temperatures[record];
        self.temperatures.iter().position(|&temperature| temperature == own).unwrap_or(record)
    }

    /// The temperature of a table.
    pub(super) fn temperature(&self, record: usize) -> f64 {
        self.temperatures[record]
    }

    /// log₁₀ a_T of a table with the free numbers by their paths; `None` beyond the pole of the law of
    /// Williams, Landel and Ferry.
    pub(super) fn log10(&self, record: usize, free: &dyn Fn(&str) -> Option<f64>) -> Option<f64> {
        let sought = |path: &str, own: f64| free(path).unwrap_or(own);
        let temperature = self.temperatures[record];
        let rise = temperature - self.reference;
        match &self.law {
            Law::Wlf { c1, c2 } => {
                let below = sought("shift.c2", *c2) + rise;
                (below > 0.0).then(|| -sought("shift.c1", *c1) * rise / below)
            }
            Law::Arrhenius { energy } => {
                let inverse = (temperature + self.zero).recip() - (self.reference + self.zero).recip();
                Some(sought("shift.energy", *energy) / GAS * inverse * std::f64::consts::LOG10_E)
            }
            Law::Free { log10 } => {
                let first = self.first(record);
                Some(sought(&format!("shift.log10[{first}]"), log10[first]))
            }
        }
    }
}
