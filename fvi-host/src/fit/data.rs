//! Measured data: tables of numbers over time or frequency.

use super::cells::{Cells, DEVIATION, OVER, cells};
use fvi_core::max_or_nan;
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
    /// Frequency; the data are responses of the system linearised about `position`, by default the initial
    /// position.
    Frequency { answer: Answer, position: Option<Vec<f64>> },
}

/// A complex function of the frequency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// The displacement of a coordinate under a force on another one.
    Receptance { input: usize, output: usize },
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
            (_, Domain::Frequency { answer: Answer::Receptance { .. }, .. }) => "a receptance",
            (_, Domain::Frequency { answer: Answer::Modulus { .. }, .. }) => "a modulus",
            (_, Domain::Frequency { answer: Answer::Kernel { .. }, .. }) => "a kernel",
            (Self::Position(_), _) => "positions",
            (Self::Momentum(_), _) => "momenta",
            (Self::Velocity(_), _) => "velocities",
            (Self::Acceleration(_), _) => "accelerations",
            _ => "energies",
        }
    }

    fn of_name(name: &str, domain: &Domain) -> Option<Self> {
        if let Domain::Frequency { .. } = domain {
            return match name {
                "re" | "storage" => Some(Self::Real),
                "im" | "loss" => Some(Self::Imaginary),
                _ => None,
            };
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
            Self::Energy | Self::Real | Self::Imaginary => None,
        }
    }
}

/// Keys of a table of data.
pub const KEYS: [&str; 12] = [
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
    "set",
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
    /// Reads one table of `[[data]]`; `plain` is the same without places.
    pub(super) fn read(value: &Value<'_>, plain: &toml::Value, extent: Extent) -> Result<Self, InputError> {
        let table = value.table()?;
        table.allow(&KEYS)?;
        let file = table.required("file")?;
        let cells = cells(&file, &table)?;
        let over = OVER.iter().find_map(|name| cells.column(name));
        let over = over.ok_or_else(|| file.out_of_range("a file with a column t, omega or f"))?;
        let domain = match cells.columns[over].name.as_str() {
            "t" => {
                for key in ["quantity", "input", "output", "term", "position"] {
                    if let Some(value) = table.optional(key) {
                        let allowed = "data over frequencies, with a column omega or f".to_owned();
                        let with = "data over time".to_owned();
                        return Err(value.key_error(Problem::Incompatible { with, allowed }));
                    }
                }
                Domain::Time
            }
            _ => frequency(&table, extent)?,
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
        record.read_columns(&cells, extent)?;
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
                Domain::Frequency { .. } if place <= 0.0 => Some("is not a frequency > 0".to_owned()),
                _ => None,
            };
            if let Some(reason) = reason {
                let column = cells.place(over);
                return Err(cells.fault(*line, format!("{column}: {name} = {} {reason}", row[over])));
            }
        }
        Ok(())
    }

    fn read_columns(&mut self, cells: &Cells<'_, '_>, extent: Extent) -> Result<(), InputError> {
        let known: Vec<String> = match self.domain {
            Domain::Time => {
                let of = |letter: char| (0..extent.coordinates).map(move |index| format!("{letter}{index}"));
                "qpva".chars().flat_map(of).chain(["energy".to_owned()]).collect()
            }
            Domain::Frequency { .. } => ["re", "im", "storage", "loss"].map(str::to_owned).to_vec(),
        };
        let allowed = match self.domain {
            Domain::Time => {
                format!("q0, p0, v0, a0 and so on to {}, energy", extent.coordinates.saturating_sub(1))
            }
            Domain::Frequency { .. } => "re and im, or storage and loss".to_owned(),
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
                let near = near.map_or_else(String::new, |near| format!("; did you mean `{near}`?"));
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
                let (values, unit) = (cells.values(index), place.unit.clone());
                self.columns.push(Column { name: name.clone(), what, values, deviations, unit });
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
            if let (Some(unit), Some(other)) = (&place.unit, &own.unit)
                && unit != other
            {
                let reason =
                    format!("{base} is in `{}`, its deviations are in `{}`", excerpt(other), excerpt(unit));
                return Err(cells.fault(cells.header, reason));
            }
        }
        self.check_units(cells)
    }

    /// Checks that quantities of one kind have one unit.
    fn check_units(&self, cells: &Cells<'_, '_>) -> Result<(), InputError> {
        let with_unit = || self.columns.iter().filter_map(|column| Some((column, column.unit.as_ref()?)));
        for (column, unit) in with_unit() {
            let kind = column.what.kind(&self.domain);
            let same = |other: &Column| other.what.kind(&self.domain) == kind;
            if let Some((other, own)) = with_unit().find(|(other, own)| same(other) && *own != unit)
                && cells.factor(&column.name) == cells.factor(&other.name)
            {
                let reason = format!(
                    "{} is in `{}`, and {} in `{}`: `units = {{ {} = … }}` is the number to multiply it by",
                    column.name,
                    excerpt(unit),
                    other.name,
                    excerpt(own),
                    column.name
                );
                return Err(cells.fault(cells.header, reason));
            }
        }
        Ok(())
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
        let keys = [("deviation", &deviation), ("relative_deviation", &relative)];
        for (key, value) in keys {
            if let (Some(value), Some(other)) = (value, ways.first()) {
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
                    // A column `deviation` is in the unit of each column of data.
                    let factor = if name == "deviation" { cells.factor(&column.name) } else { 1.0 };
                    column.deviations = positive(index)?.into_iter().map(|one| one * factor).collect();
                }
                None if !of_columns.is_empty() => {
                    return Err(cells.fault(cells.header, format!("`{}` has no column `{own}`", column.name)));
                }
                None => {}
            }
        }
        if let Some(value) = &deviation {
            if value.is_table() {
                let table = value.table()?;
                let names: Vec<&str> = self.columns.iter().map(|column| column.name.as_str()).collect();
                table.allow(&names)?;
                for column in &mut self.columns {
                    let one = table.required(&column.name)?.positive()?;
                    column.deviations.fill(one);
                }
            } else {
                let one = value.positive()?;
                self.columns.iter_mut().for_each(|column| column.deviations.fill(one));
            }
        }
        if let Some(value) = &relative {
            let share = value.positive()?;
            for row in 0..self.places.len() {
                // For a complex number its magnitude is decisive, so that its real or imaginary part may be
                // zero.
                let whole = self.columns.iter().map(|column| column.values[row].powi(2)).sum::<f64>().sqrt();
                for column in &mut self.columns {
                    let size = match self.domain {
                        Domain::Time => column.values[row].abs(),
                        Domain::Frequency { .. } => whole,
                    };
                    if size == 0.0 {
                        let reason = format!("{} = 0 has no deviation relative to it", column.name);
                        return Err(cells.fault(cells.rows[row].0, reason));
                    }
                    column.deviations[row] = share * size;
                }
            }
        }
        self.check_sizes(cells, &ways)
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
            Domain::Frequency {
                answer: Answer::Receptance { input, output } | Answer::Modulus { input, output },
                ..
            } => Some(input.max(output)),
            _ => highest,
        };
        if let Some(highest) = highest.filter(|&highest| highest >= extent.coordinates) {
            return Err(format!("data of coordinate {highest} of {}", extent.coordinates));
        }
        match self.domain {
            Domain::Frequency { answer: Answer::Kernel { term }, .. } if term >= extent.terms => {
                Err(format!("data of damping term {term} of {}", extent.terms))
            }
            _ => Ok(()),
        }
    }

    /// A sentence about the rows that are left out.
    pub(super) fn left_out_note(&self) -> Option<String> {
        const MOST: usize = 10;
        let lines: Vec<String> = self.left_out.iter().take(MOST).map(u64::to_string).collect();
        let more = if self.left_out.len() > MOST { " …" } else { "" };
        let count = self.left_out.len();
        (count > 0).then(|| {
            let all = count + self.places.len();
            let lines = lines.join(", ");
            format!(
                "{}: {count} of {all} rows are left out, in which a number is missing: lines {lines}{more}",
                self.name
            )
        })
    }

    /// Numbers of data.
    pub(super) fn len(&self) -> usize {
        self.places.len() * self.columns.len()
    }

    /// Name of the independent variable.
    pub(super) fn over(&self) -> &'static str {
        if self.domain == Domain::Time { "t" } else { "omega" }
    }
}

/// Reads what the data of a table over frequencies are.
fn frequency(table: &Table<'_>, extent: Extent) -> Result<Domain, InputError> {
    let (input, output, term) = (table.optional("input"), table.optional("output"), table.optional("term"));
    let names = [("receptance", 0), ("modulus", 1), ("kernel", 2)];
    let quantity = match table.optional("quantity") {
        Some(value) => value.choice(&names)?,
        None if term.is_some() => 2,
        None => 0,
    };
    let index = |value: &Option<Value<'_>>, count: usize| match value {
        Some(value) => value.whole(0..=count.saturating_sub(1)),
        None => Ok(0),
    };
    let belongs = |value: &Option<Value<'_>>, to: &str| match value {
        Some(value) => Err(value.key_error(Problem::Incompatible {
            with: format!("the quantity \"{}\"", names[quantity].0),
            allowed: to.to_owned(),
        })),
        None => Ok(()),
    };
    let position = table.optional("position");
    let answer = if quantity == 2 {
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
        if quantity == 0 { Answer::Receptance { input, output } } else { Answer::Modulus { input, output } }
    };
    let position = position.map(|value| value.vector(extent.coordinates)).transpose()?;
    Ok(Domain::Frequency { answer, position })
}
