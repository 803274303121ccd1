//! Measured data: tables of numbers over time or frequency.

use super::units::{inverse, is_same_dimension, is_stress, motion_by_force, plain};
use fvi_core::max_or_nan;
use fvi_scenario::language::cells::{Cells, DEVIATION, OVER, cells};
use fvi_scenario::language::document::{Table, Value};
use fvi_scenario::language::excerpt::excerpt;
use fvi_scenario::language::expression::nearest;
use fvi_scenario::language::{InputError, Problem};

/// A table of data, all under the same conditions.
#[derive(Clone, Debug)]
pub(super) struct Record {
    /// The file.
    pub(super) name: String,
    /// What the data are functions of.
    pub(super) domain: Domain,
    /// Values that keys of the scenario take for this table in place of the scenario's own, by the paths of
    /// the keys.
    pub(super) set: Vec<(String, toml::Value)>,
    /// t or ω of each row.
    pub(super) places: Vec<f64>,
    /// Lines of its file that are left out, since a number is missing in them.
    pub(super) left_out: Vec<u64>,
    pub(super) columns: Vec<Column>,
    /// What is known about the standard deviations of the data.
    pub(super) deviations: Deviations,
}

/// The independent variable of a table.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Domain {
    /// Time; the data are quantities of the motion.
    Time,
    /// Data in closed form: responses of the system linearised about `position`, by default the initial
    /// position, over frequencies; creep and relaxation of its moduli over time.
    Closed { over: Over, answer: Answer, position: Option<Vec<f64>> },
}

/// What closed forms are functions of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Over {
    Time,
    Frequency,
}

/// A complex function of the frequency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// The displacement of a coordinate under a force on another one, or its time derivative of this order:
    /// receptance, mobility, accelerance.
    Receptance { input: usize, output: usize, derivative: u8 },
    /// The entry of K + Σ ρ_m K_m(iω) of two coordinates: the modulus of a material without its mass.
    Modulus { input: usize, output: usize },
    /// K_m(iω) of a damping term.
    Kernel { term: usize },
}

/// The quantity in a column; the number is that of the coordinate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Observed {
    Position(usize),
    Momentum(usize),
    /// M⁻¹p.
    Velocity(usize),
    /// The time derivative of the velocity.
    Acceleration(usize),
    Energy,
    Real,
    Imaginary,
    Magnitude,
    /// 20 log₁₀ of the magnitude.
    Decibels,
    /// tan δ, the imaginary part over the real part.
    LossFactor,
    /// G(t) = L⁻¹\[K/s\].
    Relaxation,
    /// J(t) = L⁻¹\[1/(s K)\].
    Creep,
}

/// A column of data.
#[derive(Clone, Debug)]
pub(super) struct Column {
    pub(super) name: String,
    pub(super) what: Observed,
    pub(super) values: Vec<f64>,
    /// Standard deviations, up to a common factor unless they are known.
    pub(super) deviations: Vec<f64>,
    /// Its unit, where the file says it.
    pub(super) unit: Option<String>,
    /// What the numbers of the file were multiplied by.
    pub(super) factor: f64,
}

/// What a table specifies about its standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Deviations {
    /// Nothing.
    None,
    /// Their ratios, given as weights.
    Relative,
    /// Their values.
    Known,
}

impl Observed {
    /// Name of the kind of quantity; quantities of one kind have the same unit.
    pub(super) fn kind(self, domain: &Domain) -> &'static str {
        match (self, domain) {
            (Self::LossFactor, _) => "loss factors",
            (Self::Creep, _) => "creep",
            (_, Domain::Closed { answer: Answer::Receptance { derivative, .. }, .. }) => match derivative {
                0 => "a receptance",
                1 => "a mobility",
                _ => "an accelerance",
            },
            (_, Domain::Closed { answer: Answer::Modulus { .. }, .. }) => "a modulus",
            (_, Domain::Closed { answer: Answer::Kernel { .. }, .. }) => "a kernel",
            (Self::Position(_), _) => "positions",
            (Self::Momentum(_), _) => "momenta",
            (Self::Velocity(_), _) => "velocities",
            (Self::Acceleration(_), _) => "accelerations",
            _ => "energies",
        }
    }

    /// [`Self::kind`], with decibels as a kind of their own: residuals of two kinds have no common size.
    pub(super) fn kind_of_residuals(self, domain: &Domain) -> &'static str {
        if self == Self::Decibels { "decibels" } else { self.kind(domain) }
    }

    fn of_name(name: &str, domain: &Domain) -> Option<Self> {
        if let Domain::Closed { .. } = domain {
            let found = match name {
                "re" | "storage" => Self::Real,
                "im" | "loss" => Self::Imaginary,
                "magnitude" => Self::Magnitude,
                "tan_delta" => Self::LossFactor,
                "relaxation" => Self::Relaxation,
                "creep" => Self::Creep,
                _ => return None,
            };
            return domain.names().contains(&name).then_some(found);
        }
        if name == "energy" {
            return Some(Self::Energy);
        }
        let mut letters = name.chars();
        let letter = letters.next()?;
        let digits = letters.as_str();
        if digits.is_empty() || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
            return None;
        }
        let index = digits.parse().ok()?;
        match letter {
            'q' => Some(Self::Position(index)),
            'p' => Some(Self::Momentum(index)),
            'v' => Some(Self::Velocity(index)),
            'a' => Some(Self::Acceleration(index)),
            _ => None,
        }
    }

    /// The coordinate that the quantity belongs to.
    fn coordinate(self) -> Option<usize> {
        match self {
            Self::Position(index) | Self::Momentum(index) | Self::Velocity(index) => Some(index),
            Self::Acceleration(index) => Some(index),
            _ => None,
        }
    }
}

/// Columns of data that only a modulus or a kernel has: those over time, then those over frequencies.
const OF_MATERIALS: [&str; 5] = ["relaxation", "creep", "storage", "loss", "tan_delta"];

impl Domain {
    /// Names of the columns of closed forms.
    fn names(&self) -> &'static [&'static str] {
        match self {
            Self::Time => &[],
            Self::Closed { over: Over::Time, .. } => &OF_MATERIALS[..2],
            Self::Closed { answer: Answer::Receptance { .. }, .. } => &["re", "im", "magnitude"],
            Self::Closed { .. } => &["storage", "loss", "re", "im", "magnitude", "tan_delta"],
        }
    }
}

/// Keys of a table of data.
pub const KEYS: [&str; 14] = [
    "file",
    "columns",
    "units",
    "decimal",
    "quantity",
    "input",
    "output",
    "term",
    "position",
    "deviation",
    "relative_deviation",
    "relative_to",
    "set",
    "temperature",
];

/// Sizes of a scenario that restrict what its data may refer to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    pub(super) coordinates: usize,
    pub(super) terms: usize,
    /// First and last time of the scenario.
    pub(super) begin: f64,
    pub(super) end: f64,
}

/// Smallest and largest magnitude of data and deviations, so that sums of squares of their ratios neither
/// overflow nor underflow.
const SMALLEST: f64 = 1e-70;
const LARGEST: f64 = 1e70;

impl Record {
    /// Reads one table of `[[data]]`; `plain` is the same without places, and `before` are those that stand
    /// before it.
    pub(super) fn read(
        value: &Value<'_>,
        plain: &toml::Value,
        extent: Extent,
        before: &[Self],
    ) -> Result<Self, InputError> {
        let table = value.table()?;
        table.allow(&KEYS)?;
        let file = table.required("file")?;
        let cells = cells(&file, &table)?;
        let over = OVER.iter().find_map(|name| cells.column(name));
        let over = over.ok_or_else(|| file.out_of_range("a file with a column t, omega or f"))?;
        let domain = match cells.columns[over].name.as_str() {
            "t" if !OF_MATERIALS[..2].iter().any(|name| cells.column(name).is_some()) => {
                for key in ["quantity", "input", "output", "term", "position"] {
                    if let Some(value) = table.optional(key) {
                        let allowed =
                            "data over frequencies, with a column omega or f, and relaxation or creep"
                                .to_owned();
                        let with = "data of a motion over time".to_owned();
                        return Err(value.key_error(Problem::Incompatible { with, allowed }));
                    }
                }
                Domain::Time
            }
            over => closed(&table, extent, if over == "t" { Over::Time } else { Over::Frequency }, &cells)?,
        };
        let set = plain.get("set").and_then(toml::Value::as_table);
        let set = set.map_or_else(Vec::new, |set| {
            let entries = table.optional("set").and_then(|value| value.table().ok());
            let order = entries.map(|table| table.entries()).unwrap_or_default();
            let value = |(path, _): &(&str, Value<'_>)| Some(((*path).to_owned(), set.get(*path)?.clone()));
            order.iter().filter_map(value).collect()
        });
        if let Some(value) = table.optional("set") {
            value.table()?;
        }
        let mut record = Self {
            name: file.text()?.to_owned(),
            domain,
            set,
            places: cells.values(over),
            left_out: cells.left_out.clone(),
            columns: Vec::new(),
            deviations: Deviations::None,
        };
        // A table that sets `time` itself is checked against its own time later.
        let own_time = record.set.iter().any(|(path, _)| path == "time" || path.starts_with("time."));
        let times = if own_time { (0.0, f64::INFINITY) } else { (extent.begin, extent.end) };
        record.check_places(&cells, over, times)?;
        record.read_columns(&cells, &table, extent, before)?;
        record.read_deviations(&cells, &table)?;
        Ok(record)
    }

    fn check_places(
        &self,
        cells: &Cells<'_, '_>,
        over: usize,
        (begin, end): (f64, f64),
    ) -> Result<(), InputError> {
        let name = &cells.columns[over].name;
        for (&place, (line, row)) in self.places.iter().zip(&cells.rows) {
            let reason = match self.domain {
                Domain::Time if place < begin * (1.0 - 1e-12) => {
                    Some(format!("is before the motion begins, at t = {begin}"))
                }
                Domain::Time if place > end * (1.0 + 1e-12) => {
                    Some(format!("is after the motion ends, at t = {end}"))
                }
                Domain::Closed { over: Over::Frequency, .. } if place <= 0.0 => {
                    Some("is not a frequency > 0".to_owned())
                }
                Domain::Closed { over: Over::Time, .. } if place <= 0.0 => {
                    Some("is not a time > 0 after the step".to_owned())
                }
                _ => None,
            };
            if let Some(reason) = reason {
                let column = cells.place(over);
                return Err(cells.fault(*line, format!("{column}: {name} = {} {reason}", row[over])));
            }
        }
        Ok(())
    }

    fn read_columns(
        &mut self,
        cells: &Cells<'_, '_>,
        table: &Table<'_>,
        extent: Extent,
        before: &[Self],
    ) -> Result<(), InputError> {
        let known: Vec<String> = match self.domain {
            Domain::Time => {
                let of = |letter: char| (0..extent.coordinates).map(move |index| format!("{letter}{index}"));
                "qpva".chars().flat_map(of).chain(["energy".to_owned()]).collect()
            }
            Domain::Closed { .. } => self.domain.names().iter().map(|name| (*name).to_owned()).collect(),
        };
        let allowed = match self.domain {
            Domain::Time => {
                format!("q0, p0, v0, a0 and so on to {}, energy", extent.coordinates.saturating_sub(1))
            }
            // Without `quantity` the columns decide what they are of.
            Domain::Closed { over: Over::Frequency, answer: Answer::Receptance { .. }, .. }
                if table.optional("quantity").is_none() =>
            {
                "re and im of a receptance, storage, loss, tan_delta of a modulus, magnitude with `quantity`"
                    .to_owned()
            }
            Domain::Closed { .. } => self.domain.names().join(", "),
        };
        let more = format!("a column with {DEVIATION} behind its name, deviation, weight");
        for (index, place) in cells.columns.iter().enumerate() {
            let name = &place.name;
            if OVER.contains(&name.as_str()) {
                continue;
            }
            let base = name.strip_suffix(DEVIATION).unwrap_or(name);
            let is_of_row = name == "deviation" || name == "weight";
            let what = Observed::of_name(base, &self.domain);
            let is_there =
                what.is_some_and(|what| what.coordinate().is_none_or(|at| at < extent.coordinates));
            if !is_of_row && !is_there {
                let near = nearest(base, known.iter().map(String::as_str));
                let near = match (near, base) {
                    (None, "phase") => "; re and im, or storage and loss, have the phase in them".to_owned(),
                    (near, _) => near.map_or_else(String::new, |near| format!("; did you mean `{near}`?")),
                };
                let (number, name) = (place.number, excerpt(name));
                let reason =
                    format!("column {number}: unknown column `{name}`{near}; columns: {allowed}; {more}");
                return Err(cells.fault(cells.header, reason));
            }
            if let (Some(what), false, true) = (what, is_of_row, base == name) {
                if self.columns.iter().any(|column| column.what == what) {
                    let reason = format!("column {}: `{name}` says what another column does", place.number);
                    return Err(cells.fault(cells.header, reason));
                }
                let deviations = vec![1.0; cells.rows.len()];
                // Data in decibels have errors in decibels, unless these are shares of the magnitude.
                let (what, values) = match cells.is_in_decibels(name) && !has_relative_deviation(table, name)
                {
                    true => (Observed::Decibels, cells.levels(index)),
                    false => (what, cells.values(index)),
                };
                let is_said = what == Observed::Decibels && has_entry(table, "units", name);
                let unit = place.unit.clone().filter(|_| !is_said);
                let factor = cells.factor(name);
                self.columns.push(Column { name: name.clone(), what, values, deviations, unit, factor });
            }
        }
        if self.columns.is_empty() {
            return Err(cells.fault(cells.header, format!("there is no column of data; columns: {allowed}")));
        }
        for place in &cells.columns {
            let Some(base) = place.name.strip_suffix(DEVIATION) else { continue };
            let Some(own) = cells.column(base) else {
                return Err(
                    cells.fault(cells.header, format!("`{}`: there is no column `{base}`", place.name))
                );
            };
            let own = &cells.columns[own];
            if place.is_decibels() && !cells.is_in_decibels(base) {
                let reason = format!(
                    "the deviations of {base} are in dB, and {base} is not; `units = {{ {base} = \"dB\" }}` says that it is"
                );
                return Err(cells.fault(cells.header, reason));
            }
            if let (Some(unit), Some(other)) = (&place.unit, &own.unit)
                && unit != other
            {
                let reason =
                    format!("{base} is in `{}`, its deviations are in `{}`", excerpt(other), excerpt(unit));
                return Err(cells.fault(cells.header, reason));
            }
        }
        self.check_units(cells, table, before)
    }

    /// Refuses units of another kind of quantity, and those that contradict each other.
    fn check_units(
        &self,
        cells: &Cells<'_, '_>,
        table: &Table<'_>,
        before: &[Record],
    ) -> Result<(), InputError> {
        let said_otherwise = |column: &Column| has_entry(table, "units", &column.name);
        let mut unsaid = self.columns.iter().filter(|column| !said_otherwise(column));
        match unsaid
            .find_map(|column| of_another_kind(column, &self.domain))
            .or_else(|| contradiction(self, before))
        {
            Some(reason) => Err(cells.fault(cells.header, reason)),
            None => Ok(()),
        }
    }

    fn read_deviations(&mut self, cells: &Cells<'_, '_>, table: &Table<'_>) -> Result<(), InputError> {
        let names = cells.columns.iter().map(|place| &place.name);
        let of_columns: Vec<&String> =
            names.filter(|name| name.ends_with(DEVIATION) || *name == "deviation").collect();
        let by_weight = cells.column("weight");
        let deviation = table.optional("deviation");
        let relative = table.optional("relative_deviation");
        let mut ways: Vec<String> = Vec::new();
        ways.extend(of_columns.first().map(|name| format!("the column {name}")));
        ways.extend(by_weight.map(|_| "the column weight".to_owned()));
        // As tables both may stand there, each for columns of its own.
        let both = [&deviation, &relative].iter().all(|value| value.as_ref().is_some_and(Value::is_table));
        let keys = [("deviation", &deviation), ("relative_deviation", &relative)];
        for (key, value) in keys {
            if let (Some(value), Some(other), false) = (value, ways.first(), both && ways.len() == 1) {
                return Err(value.key_error(Problem::Conflict { other: other.clone() }));
            }
            ways.extend(value.as_ref().map(|_| key.to_owned()));
        }
        if by_weight.is_some() && !of_columns.is_empty() {
            return Err(cells
                .fault(cells.header, "columns of deviations and of weights: give one of them".to_owned()));
        }
        let positive = |column: usize| -> Result<Vec<f64>, InputError> {
            let wrong = cells.rows.iter().find(|(_, row)| row[column] <= 0.0);
            if let Some((line, row)) = wrong {
                let reason = format!("{}: {} is not > 0", cells.place(column), row[column]);
                return Err(cells.fault(*line, reason));
            }
            Ok(cells.values(column))
        };
        self.deviations = if ways.is_empty() { Deviations::None } else { Deviations::Known };
        if let Some(column) = by_weight {
            self.deviations = Deviations::Relative;
            let weights = positive(column)?;
            let deviations: Vec<f64> = weights.iter().map(|weight| weight.sqrt().recip()).collect();
            self.columns.iter_mut().for_each(|column| column.deviations.clone_from(&deviations));
        }
        for column in &mut self.columns {
            let own = format!("{}{DEVIATION}", column.name);
            let found =
                [own.as_str(), "deviation"].into_iter().find_map(|name| Some((name, cells.column(name)?)));
            match found {
                Some((name, index)) => {
                    let mut deviations = positive(index)?;
                    if name == "deviation" {
                        // It is in the unit of each column of data.
                        let factor = cells.factor(&column.name);
                        deviations.iter_mut().for_each(|one| *one *= factor);
                    }
                    column.deviations = deviations;
                }
                None if !of_columns.is_empty() => {
                    return Err(cells.fault(cells.header, format!("`{}` has no column `{own}`", column.name)));
                }
                None => {}
            }
        }
        self.check_magnitudes(cells)?;
        self.read_deviation_keys(cells, table, [deviation.as_ref(), relative.as_ref()])?;
        self.check_sizes(cells, &ways)
    }

    /// `deviation` and `relative_deviation`, each a number or a table by columns.
    fn read_deviation_keys(
        &mut self,
        cells: &Cells<'_, '_>,
        table: &Table<'_>,
        [deviation, relative]: [Option<&Value<'_>>; 2],
    ) -> Result<(), InputError> {
        let names: Vec<&str> = self.columns.iter().map(|column| column.name.as_str()).collect();
        let of_column = |value: Option<&Value<'_>>, name: &str| -> Result<Option<f64>, InputError> {
            let Some(value) = value else { return Ok(None) };
            if !value.is_table() {
                return value.positive().map(Some);
            }
            value.table()?.optional(name).map(|value| value.positive()).transpose()
        };
        for value in [deviation, relative].into_iter().flatten().filter(|value| value.is_table()) {
            value.table()?.allow(&names)?;
        }
        let to = table.optional("relative_to");
        let to_magnitude = match (&to, relative) {
            (Some(value), None) => {
                let allowed = "it beside `relative_deviation`".to_owned();
                return Err(
                    value.key_error(Problem::Incompatible { with: "no such deviation".to_owned(), allowed })
                );
            }
            (Some(value), _) => Some(value.choice(&[("datum", false), ("magnitude", true)])?),
            (None, _) => None,
        };
        let mut shares = Vec::new();
        for name in &names {
            let (one, share) = (of_column(deviation, name)?, of_column(relative, name)?);
            match (deviation.or(relative), one, share) {
                (Some(value), Some(_), Some(_)) => {
                    return Err(value.out_of_range(format!(
                        "one deviation of {name}, in `deviation` or in `relative_deviation`"
                    )));
                }
                (Some(value), None, None) => {
                    return Err(
                        value.out_of_range(format!("a deviation of each column: that of {name} is missing"))
                    );
                }
                _ => shares.push((one, share)),
            }
        }
        let is_part = |column: &Column| matches!(column.what, Observed::Real | Observed::Imaginary);
        for row in 0..self.places.len() {
            // Of a complex number, so that its real or imaginary part may be zero.
            let parts = self.columns.iter().filter(|column| is_part(column));
            let whole = parts.map(|column| column.values[row].powi(2)).sum::<f64>().sqrt();
            for (column, (one, share)) in self.columns.iter_mut().zip(&shares) {
                if let Some(one) = *one {
                    column.deviations[row] = one;
                }
                let Some(share) = share else { continue };
                let of_whole = to_magnitude.unwrap_or(matches!(column.name.as_str(), "re" | "im"));
                let size = if is_part(column) && of_whole { whole } else { column.values[row].abs() };
                if size == 0.0 {
                    let reason = format!("{} = 0 has no deviation relative to it", column.name);
                    return Err(cells.fault(cells.rows[row].0, reason));
                }
                column.deviations[row] = share * size;
            }
        }
        Ok(())
    }

    /// Refuses magnitudes below 0, which are decibels that nothing says to be such.
    fn check_magnitudes(&self, cells: &Cells<'_, '_>) -> Result<(), InputError> {
        for column in self.columns.iter().filter(|column| column.what == Observed::Magnitude) {
            let Some(row) = column.values.iter().position(|&value| value < 0.0) else { continue };
            let Column { name, values, .. } = column;
            let advice = "those in decibels are `units = { magnitude = \"dB\" }`";
            let reason = format!("{name} = {} is below 0, which no magnitude is; {advice}", values[row]);
            return Err(cells.fault(cells.rows[row].0, reason));
        }
        Ok(())
    }

    /// Checks that the squares of data over deviations neither overflow nor underflow.
    fn check_sizes(&self, cells: &Cells<'_, '_>, ways: &[String]) -> Result<(), InputError> {
        for column in &self.columns {
            let Column { name, values, deviations, .. } = column;
            for (row, (value, deviation)) in values.iter().zip(deviations).enumerate() {
                if value.abs() > LARGEST {
                    let reason =
                        format!("{name} = {value:e} is larger than {LARGEST:e}: give it in a larger unit");
                    return Err(cells.fault(cells.rows[row].0, reason));
                }
                if !(SMALLEST..=LARGEST).contains(deviation) {
                    let way = ways.first().map_or("", String::as_str);
                    let reason = format!(
                        "{name}, by {way}, has a deviation of {deviation:e}: those from {SMALLEST:e} to {LARGEST:e} are taken"
                    );
                    return Err(cells.fault(cells.rows[row].0, reason));
                }
            }
            // Where no deviation is known the data themselves are the only measure.
            let largest = values.iter().map(|value| value.abs()).fold(0.0, max_or_nan);
            if ways.is_empty() && largest > 0.0 && largest < SMALLEST {
                let reason = format!(
                    "the largest {name} is {largest:e}, less than {SMALLEST:e}: give it in a smaller unit"
                );
                return Err(cells.fault(cells.header, reason));
            }
        }
        Ok(())
    }

    /// Checks that the scenario has everything that the table refers to; the error is a sentence about what
    /// is missing.
    pub(super) fn check_extent(&self, extent: Extent) -> Result<(), String> {
        let highest = self.columns.iter().filter_map(|column| column.what.coordinate()).max();
        let highest = match self.domain {
            Domain::Closed {
                answer: Answer::Receptance { input, output, .. } | Answer::Modulus { input, output },
                ..
            } => Some(input.max(output)),
            _ => highest,
        };
        if let Some(highest) = highest.filter(|&highest| highest >= extent.coordinates) {
            return Err(format!("data of coordinate {highest} of {}", extent.coordinates));
        }
        match self.domain {
            Domain::Closed { answer: Answer::Kernel { term }, .. } if term >= extent.terms => {
                Err(format!("data of damping term {term} of {}", extent.terms))
            }
            _ => Ok(()),
        }
    }

    /// A sentence about the rows that are left out.
    pub(super) fn left_out_note(&self) -> Option<String> {
        let all = self.left_out.len() + self.places.len();
        let note = Cells::left_out_note(&self.left_out, Some(all))?;
        Some(format!("{}: {note}", self.name))
    }

    /// Numbers of data.
    pub(super) fn len(&self) -> usize {
        self.places.len() * self.columns.len()
    }

    /// The times > 0 that the rows tell: t, or 1/ω.
    pub(super) fn times(&self) -> impl Iterator<Item = f64> {
        let over_time = self.over() == "t";
        let times = self.places.iter().map(move |&place| if over_time { place } else { place.recip() });
        times.filter(|time| *time > 0.0)
    }

    /// Name of the independent variable.
    pub(super) fn over(&self) -> &'static str {
        match self.domain {
            Domain::Time | Domain::Closed { over: Over::Time, .. } => "t",
            Domain::Closed { over: Over::Frequency, .. } => "omega",
        }
    }
}

/// Quantities of `quantity`.
const QUANTITIES: [(&str, usize); 5] =
    [("receptance", 0), ("mobility", 1), ("accelerance", 2), ("modulus", 3), ("kernel", 4)];
const MODULUS: usize = 3;
const KERNEL: usize = 4;

/// Reads what the data of a table of closed forms are.
fn closed(
    table: &Table<'_>,
    extent: Extent,
    over: Over,
    cells: &Cells<'_, '_>,
) -> Result<Domain, InputError> {
    let (input, output, term) = (table.optional("input"), table.optional("output"), table.optional("term"));
    let of_material = OF_MATERIALS.iter().find(|name| cells.column(name).is_some());
    let quantity = match table.optional("quantity") {
        Some(value) => {
            let quantity = value.choice(&QUANTITIES)?;
            if let (Some(name), true) = (of_material, quantity < MODULUS) {
                let allowed = "\"modulus\" or \"kernel\"".to_owned();
                return Err(
                    value.error(Problem::Incompatible { with: format!("the column {name}"), allowed })
                );
            }
            quantity
        }
        None if term.is_some() => KERNEL,
        None if of_material.is_some() => MODULUS,
        None => {
            let is_there = |name: &str| cells.column(name).is_some();
            if is_there("magnitude") && !is_there("re") && !is_there("im") {
                let what = "of a receptance, a mobility, an accelerance, a modulus or a kernel";
                let reason =
                    format!("a magnitude {what}: `quantity = \"modulus\"` or the like says of which");
                return Err(cells.fault(cells.header, reason));
            }
            0
        }
    };
    let index = |value: &Option<Value<'_>>, count: usize| match value {
        Some(value) => value.whole(0..=count.saturating_sub(1)),
        None => Ok(0),
    };
    let belongs = |value: &Option<Value<'_>>, to: &str| match value {
        Some(value) => Err(value.key_error(Problem::Incompatible {
            with: format!("the quantity \"{}\"", QUANTITIES[quantity].0),
            allowed: to.to_owned(),
        })),
        None => Ok(()),
    };
    let position = table.optional("position");
    let answer = if quantity == KERNEL {
        belongs(&input, "`term`")?;
        belongs(&output, "`term`")?;
        belongs(&position, "`term`")?;
        if extent.terms == 0 {
            return Err(table.required("file")?.key_error(Problem::Incompatible {
                with: "a scenario without damping".to_owned(),
                allowed: "data of a kernel where there is one".to_owned(),
            }));
        }
        Answer::Kernel { term: index(&term, extent.terms)? }
    } else {
        belongs(&term, "`input` and `output`; a damping term's own K(iω) is the quantity \"kernel\"")?;
        let (input, output) = (index(&input, extent.coordinates)?, index(&output, extent.coordinates)?);
        match quantity {
            MODULUS => Answer::Modulus { input, output },
            derivative => Answer::Receptance { input, output, derivative: derivative as u8 },
        }
    };
    let position = position.map(|value| value.vector(extent.coordinates)).transpose()?;
    Ok(Domain::Closed { over, answer, position })
}

/// The sentence about a column whose unit is that of another kind of quantity; `None` if it is not, or
/// unknown.
fn of_another_kind(column: &Column, domain: &Domain) -> Option<String> {
    let unit = column.unit.as_deref()?;
    let kind = column.what.kind(domain);
    let is_compliance = || inverse(unit).is_some_and(|below| is_stress(&below));
    let derivative = match domain {
        Domain::Closed { answer: Answer::Receptance { derivative, .. }, .. } => Some(*derivative),
        _ => None,
    };
    let found = match (kind, derivative, motion_by_force(unit)) {
        ("creep", ..) if is_stress(unit) => "a modulus".to_owned(),
        ("a modulus" | "a kernel", ..) if is_compliance() => "a compliance".to_owned(),
        (_, Some(own), Some(other)) if own != other => {
            let name = ["receptance", "mobility", "accelerance"][usize::from(other.min(2))];
            format!("a quantity = {name:?}")
        }
        _ => return None,
    };
    let name = &column.name;
    let kind = if kind == "creep" { "a compliance" } else { kind };
    Some(format!(
        "{name} is {kind}, and `{}` the unit of {found}; `units = {{ {name} = … }}` is the number to multiply it by, whatever \
         it is",
        excerpt(unit)
    ))
}

/// The sentence about a column of `record` whose unit contradicts that of another column, in it or in a table
/// `before` it; `None` if there is none.
///
/// Units are compared as they are written, and where both columns are multiplied by the same number: who says
/// `units = { … }` of one of them knows what it does.
fn contradiction(record: &Record, before: &[Record]) -> Option<String> {
    for (index, column) in record.columns.iter().enumerate() {
        let earlier = record.columns[..index].iter().map(|other| (other, record));
        let others = before.iter().flat_map(|other| other.columns.iter().map(move |column| (column, other)));
        let mut others = earlier.chain(others);
        let Some(unit) = &column.unit else { continue };
        let found = others.find_map(|(other, of)| {
            let own = other.unit.as_ref().filter(|_| other.factor == column.factor)?;
            contradicts((column, &record.domain, unit), (other, &of.domain, own)).then_some((other, of, own))
        });
        if let Some((other, of, own)) = found {
            let place = if std::ptr::eq(of, record) { String::new() } else { format!(" of {}", of.name) };
            let name = &column.name;
            let advice = match [column.what, other.what].contains(&Observed::Decibels) {
                true => {
                    "`units = { magnitude = \"dB\" }` says that these are of 1 in the unit of the scenario"
                        .to_owned()
                }
                false => format!("`units = {{ {name} = … }}` is the number to multiply it by"),
            };
            let (unit, own) = (excerpt(unit), excerpt(own));
            return Some(format!("{name} is in `{unit}`, and {}{place} in `{own}`: {advice}", other.name));
        }
    }
    None
}

/// True if `relative_deviation` is about this column.
fn has_relative_deviation(table: &Table<'_>, column: &str) -> bool {
    let number = table.optional("relative_deviation").is_some_and(|value| !value.is_table());
    number || has_entry(table, "relative_deviation", column)
}

/// True if the table at `key` has an entry for a column.
fn has_entry(table: &Table<'_>, key: &str, column: &str) -> bool {
    let entries = table.optional(key).and_then(|value| value.table().ok());
    entries.is_some_and(|entries| entries.optional(column).is_some())
}

type Written<'a> = (&'a Column, &'a Domain, &'a str);

fn contradicts((one, of_one, unit): Written<'_>, (other, of_other, own): Written<'_>) -> bool {
    if one.what.kind(of_one) == other.what.kind(of_other) {
        // One coordinate may be a length and the next an angle.
        let is_of_one_quantity = matches!(of_one, Domain::Closed { .. }) || one.what == other.what;
        return plain(unit) != plain(own) && (is_of_one_quantity || is_same_dimension(unit, own));
    }
    let is_compliance = |column: &Column| column.what == Observed::Creep;
    let is_modulus =
        |column: &Column, domain: &Domain| ["a modulus", "a kernel"].contains(&column.what.kind(domain));
    let pair = match (is_compliance(one), is_compliance(other)) {
        (true, false) if is_modulus(other, of_other) => Some((unit, own)),
        (false, true) if is_modulus(one, of_one) => Some((own, unit)),
        _ => None,
    };
    pair.and_then(|(compliance, modulus)| Some(inverse(compliance)? != plain(modulus))).unwrap_or(false)
}
