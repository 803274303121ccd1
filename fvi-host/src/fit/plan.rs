//! The file of a fit: a scenario, which of its numbers are free, and the data.

use super::data::{Deviations, Domain, Extent, Record};
use super::prony::Series;
use super::shift::{Shift, is_of_shift};
use fvi_scenario::language::document::{Document, Table, Value};
use fvi_scenario::language::{InputError, Problem, mirrored, number_at, put, put_with_mirror, value_at};
#[cfg(feature = "pictures")]
use fvi_scenario::scenario::Appearance;
use fvi_scenario::scenario::{Feature, Scenario};
use std::path::Path;

/// A fit with all its values checked.
#[derive(Clone, Debug)]
pub struct Fit {
    pub(super) heading: String,
    pub(super) document: Document,
    pub(super) models: Vec<Model>,
    pub(super) records: Vec<Record>,
    pub(super) deviations: Deviations,
    pub(super) starts: usize,
    pub(super) seed: u64,
    pub(super) most_iterations: usize,
    pub(super) profile: Profile,
    /// The shift of the tables of data with the temperature.
    pub(super) shift: Option<Shift>,
}

/// A scenario some of whose numbers are sought.
#[derive(Clone, Debug)]
pub(super) struct Model {
    /// `None` where there is only one model.
    pub(super) name: Option<String>,
    pub(super) base: Scenario,
    /// The values of the scenario's file, overridden by those that the fit sets.
    pub(super) values: toml::Table,
    pub(super) free: Vec<Free>,
}

/// A free parameter.
#[derive(Clone, Debug)]
pub(super) struct Free {
    /// Its path in the scenario.
    pub(super) path: String,
    /// Index of the table of data that it applies to; `None`: all.
    pub(super) record: Option<usize>,
    pub(super) start: f64,
    pub(super) bounds: (f64, f64),
    pub(super) scale: Scale,
}

/// Scale on which a parameter is searched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scale {
    Linear,
    Logarithmic,
}

/// For which parameters the profile likelihood is computed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Profile {
    None,
    All,
    /// The parameters with these paths.
    Some(Vec<String>),
}

const KEYS: [&str; 11] = [
    "title",
    "shift",
    "scenario",
    "free",
    "data",
    "model",
    "starts",
    "seed",
    "deviations",
    "profile",
    "most_iterations",
];

/// Largest numbers of starts, parameters and tables of data of a fit.
const MOST_STARTS: usize = 10_000;
const MOST_PARAMETERS: usize = 100;
const MOST_RECORDS: usize = 1000;

/// Parts of a scenario whose numbers may be free parameters; the others concern the computation.
const SOUGHT: [&str; 4] = ["system.", "initial.", "input.", "controller"];

/// Default for the largest number of steps of a search.
const MOST_ITERATIONS: usize = 200;

impl Scale {
    /// The coordinate on this scale of a value.
    pub(super) fn inside(self, value: f64) -> f64 {
        match self {
            Self::Linear => value,
            Self::Logarithmic => libm::log(value),
        }
    }

    /// The value at a coordinate on this scale.
    pub(super) fn outside(self, coordinate: f64) -> f64 {
        match self {
            Self::Linear => coordinate,
            Self::Logarithmic => libm::exp(coordinate),
        }
    }
}

impl Free {
    /// Its name in results: its path, and the table that it applies to if only one.
    pub(super) fn key(&self) -> String {
        match self.record {
            None => self.path.clone(),
            Some(record) => format!("data[{record}]: {}", self.path),
        }
    }

    /// Typical size of its coordinate, to which changes are relative.
    pub(super) fn typical(&self, value: f64) -> f64 {
        if self.scale == Scale::Logarithmic {
            return 1.0;
        }
        let width = self.bounds.1 - self.bounds.0;
        let width = if width.is_finite() { 1e-3 * width } else { 0.0 };
        let size = value.abs().max(self.start.abs() * 1e-3).max(width);
        if size > 0.0 { size } else { 1.0 }
    }
}

/// The free numbers at a point by their paths.
pub(super) fn numbers_at<'a>(free: &'a [Free], point: &'a [f64]) -> impl Fn(&str) -> Option<f64> + 'a {
    move |path| free.iter().zip(point).find(|(free, _)| free.path == path).map(|(_, &number)| number)
}

/// Puts a number at a path, and at its mirror image. Numbers of the shift are none of the scenario.
pub(super) fn put_number(values: &mut toml::Table, path: &str, number: f64) -> Result<(), String> {
    if is_of_shift(path) { Ok(()) } else { put_with_mirror(values, path, number) }
}

impl Fit {
    /// Reads and checks the file of a fit, its scenarios and its data.
    ///
    /// # Errors
    /// The first thing in them that cannot be used, with its place.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        Self::from_document(&Document::read(path)?)
    }

    /// Checks a fit already read, and reads the scenario that it names.
    ///
    /// # Errors
    /// The first thing that cannot be used, with its place.
    pub fn from_document(document: &Document) -> Result<Self, InputError> {
        Self::of_scenario(document, document.scenario(&KEYS)?)
    }

    /// Checks a fit and its scenario, both already read; the fit's key `scenario` is ignored.
    ///
    /// # Errors
    /// The first thing in either that cannot be used, with its place.
    pub fn of_scenario(document: &Document, scenario: Document) -> Result<Self, InputError> {
        let plain = document.values()?;
        let base = Scenario::from_document(scenario.reading_once())?;
        document.with_root(|root| Self::from_root(&root, document, &base, &plain))
    }

    fn from_root(
        root: &Table<'_>,
        document: &Document,
        base: &Scenario,
        plain: &toml::Table,
    ) -> Result<Self, InputError> {
        root.allow(&KEYS)?;
        base.check_use(Feature::Fit)?;
        let title = root.optional("title").map(|value| value.text().map(str::to_owned)).transpose()?;
        let data = root.required("data")?;
        let tables = data.list("a list of tables, each headed [[data]]")?;
        if tables.is_empty() || tables.len() > MOST_RECORDS {
            return Err(data.out_of_range(format!("1 to {MOST_RECORDS} tables of data")));
        }
        let extent = extent(base);
        let plain_data = plain.get("data").and_then(toml::Value::as_array);
        let mut records = Vec::new();
        for (index, value) in tables.iter().enumerate() {
            let plain = plain_data.and_then(|list| list.get(index));
            let plain = plain.ok_or_else(|| value.out_of_range("a table of data"))?;
            let record = Record::read(value, plain, extent, &records)?;
            records.push(record);
        }
        let deviations = deviations(root, &tables, &records)?;
        let shift = Shift::read(root, &tables, &records)?;
        let context = Context { records: &records, shift: shift.as_ref() };
        let common = read_free(root.optional("free").as_ref(), context)?;
        let models = match root.optional("model") {
            None => Model::all(None, (base, base.document().values()?), &common, &[])?,
            Some(value) => read_models(&value, document, base, (&common, context), plain)?,
        };
        let most = MOST_PARAMETERS;
        if models.iter().any(|model| model.free.is_empty() || model.free.len() > most) {
            let problem = || format!("1 to {most} free numbers, each headed [[free]]");
            return Err(match root.optional("free") {
                Some(value) => value.out_of_range(problem()),
                None => root.required("free").err().unwrap_or_else(|| data.out_of_range(problem())),
            });
        }
        for model in &models {
            for (index, record) in records.iter().enumerate() {
                model.check_record(index, record, &tables[index])?;
            }
        }
        let starts = root.optional("starts").map_or(Ok(1), |value| value.whole(1..=MOST_STARTS))?;
        let seed = root.optional("seed").map_or(Ok(1), |value| value.whole(0..=usize::MAX))?;
        let unbounded = models.iter().flat_map(|model| &model.free);
        let unbounded = unbounded.into_iter().find(|free| !(free.bounds.1 - free.bounds.0).is_finite());
        if let (Some(value), Some(free), true) = (root.optional("starts"), unbounded, starts > 1) {
            let path = &free.path;
            return Err(value.error(Problem::Incompatible {
                with: format!("a free number without bounds, {path}"),
                allowed: "several starts where every free number has `bounds`, between which they lie"
                    .to_owned(),
            }));
        }
        let most_iterations =
            root.optional("most_iterations").map_or(Ok(MOST_ITERATIONS), |value| value.whole(1..=100_000))?;
        let heading = title.unwrap_or_else(|| base.heading().to_owned());
        let profile = match root.optional("profile") {
            None => Profile::None,
            Some(value) if value.is_list() => {
                let mut paths = Vec::new();
                for value in value.list("a list of paths")? {
                    let path = value.text()?.to_owned();
                    if !models.iter().any(|model| model.free.iter().any(|free| free.key() == path)) {
                        return Err(value.out_of_range("true, false, or paths of free numbers"));
                    }
                    paths.push(path);
                }
                Profile::Some(paths)
            }
            Some(value) if value.truth()? => Profile::All,
            Some(_) => Profile::None,
        };
        Ok(Self {
            heading,
            document: document.clone(),
            models,
            records,
            deviations,
            starts,
            seed: seed as u64,
            most_iterations,
            profile,
            shift,
        })
    }

    /// Title of its pictures: its own, or that of the scenario.
    pub fn heading(&self) -> &str {
        &self.heading
    }

    /// How its pictures look, as the first model's scenario says.
    #[cfg(feature = "pictures")]
    pub(super) fn appearance(&self) -> Appearance {
        self.models.first().map(|model| model.base.output.appearance.clone()).unwrap_or_default()
    }

    /// The file that it was read from.
    pub fn document(&self) -> &Document {
        &self.document
    }

    /// Number of data values.
    pub(super) fn data(&self) -> usize {
        self.records.iter().map(Record::len).sum()
    }
}

/// The sizes of the scenario that data are checked against.
fn extent(scenario: &Scenario) -> Extent {
    let terms = scenario.system.damping.len();
    let time = &scenario.time;
    Extent { coordinates: scenario.coordinates(), terms, begin: time.start, end: time.end() }
}

/// What is known about the standard deviations of all data together.
fn deviations(root: &Table<'_>, tables: &[Value<'_>], records: &[Record]) -> Result<Deviations, InputError> {
    let first = records.first().map_or(Deviations::None, |record| record.deviations);
    let mut kinds: Vec<&str> = Vec::new();
    for (record, value) in records.iter().zip(tables) {
        if record.deviations != first {
            let allowed = "deviations of all tables, weights in all tables, or neither in any".to_owned();
            return Err(value.out_of_range(allowed));
        }
        kinds.extend(record.columns.iter().map(|column| column.what.kind_of_residuals(&record.domain)));
        if first == Deviations::None && kinds.iter().any(|kind| *kind != kinds[0]) {
            let problem = format!("`deviation` in every table: there are data of {} and of others", kinds[0]);
            return Err(value.out_of_range(problem));
        }
    }
    let Some(value) = root.optional("deviations") else { return Ok(first) };
    let said = value.choice(&[("known", Deviations::Known), ("relative", Deviations::Relative)])?;
    if said == Deviations::Known && first != Deviations::Known {
        return Err(value.out_of_range("\"known\" where the tables of data have a `deviation`"));
    }
    Ok(said)
}

/// What entries of `[[free]]` may refer to.
#[derive(Clone, Copy)]
struct Context<'a> {
    records: &'a [Record],
    shift: Option<&'a Shift>,
}

/// A free parameter as written in the file, not yet checked against a scenario.
#[derive(Clone)]
struct Wanted<'v> {
    place: Value<'v>,
    path: String,
    record: Option<usize>,
    start: Option<f64>,
    bounds: (f64, f64),
    scale: Scale,
    /// The Prony series that is sought at the path.
    series: Option<Series>,
}

fn read_free<'v>(
    value: Option<&Value<'v>>,
    Context { records, shift }: Context<'_>,
) -> Result<Vec<Wanted<'v>>, InputError> {
    let Some(value) = value else { return Ok(Vec::new()) };
    let mut free: Vec<Wanted<'v>> = Vec::new();
    for place in value.list("a list of tables, each headed [[free]]")? {
        let table = place.table()?;
        table.allow(&["path", "start", "bounds", "scale", "data", "terms", "between"])?;
        let path_value = table.required("path")?;
        let path = path_value.text()?.to_owned();
        let record = table.optional("data").map(|value| value.whole(0..=records.len().saturating_sub(1)));
        let record = record.transpose()?;
        let series = Series::read(&table, records)?;
        let elsewhere = ["start", "bounds", "scale", "data"].into_iter().find_map(|key| table.optional(key));
        if let (true, Some(value)) = (series.is_some(), elsewhere) {
            return Err(value.key_error(Problem::Conflict { other: "terms".to_owned() }));
        }
        let same = |known: &Wanted<'_>| {
            known.path == path && (known.record == record || known.record.is_none() || record.is_none())
        };
        if free.iter().any(same) {
            return Err(path_value.out_of_range("each number once"));
        }
        let scales = [("linear", Scale::Linear), ("log", Scale::Logarithmic)];
        let scale = table.optional("scale").map_or(Ok(Scale::Linear), |value| value.choice(&scales))?;
        let mut bounds = (f64::NEG_INFINITY, f64::INFINITY);
        if scale == Scale::Logarithmic {
            bounds.0 = 0.0;
        }
        if let Some(value) = table.optional("bounds") {
            let numbers = value.numbers()?;
            let &[low, high] = numbers.as_slice() else {
                return Err(value.out_of_range("two numbers, the lower bound and the upper one"));
            };
            if low >= high {
                return Err(value.out_of_range("two numbers, the lower one first"));
            }
            if scale == Scale::Logarithmic && low <= 0.0 {
                return Err(value.out_of_range("bounds > 0, on the scale \"log\""));
            }
            bounds = (low, high);
        }
        let start = match table.optional("start") {
            Some(value) => {
                let start = value.number()?;
                check_number(&value, start, bounds, scale)?;
                Some(start)
            }
            None => None,
        };
        let wanted = Wanted { place, path, record, start, bounds, scale, series };
        if !is_of_shift(&wanted.path) {
            free.push(wanted);
            continue;
        }
        let Some(shift) = shift else {
            return Err(path_value.out_of_range("`[shift]` beside it, the law of the shift"));
        };
        let numbers = shift.numbers(&wanted.path);
        let Some(numbers) = numbers.filter(|_| wanted.record.is_none() && wanted.series.is_none()) else {
            return Err(path_value.out_of_range(format!("{}, for all tables together", shift.names())));
        };
        for (path, own) in numbers {
            let start = wanted.start.unwrap_or(own);
            check_number(&wanted.place, start, bounds, scale)?;
            free.push(Wanted { path, start: Some(start), ..wanted.clone() });
        }
    }
    let ranges = free.iter().filter(|wanted| wanted.terms() > 1);
    if let Some(second) = ranges.clone().nth(1) {
        let allowed = "one list of which the number of terms is sought";
        return Err(second.place.out_of_range(allowed));
    }
    Ok(free)
}

impl Wanted<'_> {
    /// How many numbers of terms are tried.
    fn terms(&self) -> usize {
        self.series.as_ref().map_or(1, |series| series.terms.clone().count())
    }
}

fn check_number(value: &Value<'_>, start: f64, bounds: (f64, f64), scale: Scale) -> Result<(), InputError> {
    if start < bounds.0 || start > bounds.1 {
        let (low, high) = bounds;
        return Err(
            value.out_of_range(format!("a start within the bounds {low} and {high}; here it is {start}"))
        );
    }
    if scale == Scale::Logarithmic && start <= 0.0 {
        return Err(value.out_of_range(format!("a start > 0 on the scale \"log\"; here it is {start}")));
    }
    Ok(())
}

fn read_models(
    value: &Value<'_>,
    document: &Document,
    base: &Scenario,
    (common, context): (&[Wanted<'_>], Context<'_>),
    plain: &toml::Table,
) -> Result<Vec<Model>, InputError> {
    let plain = plain.get("model").and_then(toml::Value::as_array);
    let mut models: Vec<Model> = Vec::new();
    for (index, value) in value.list("a list of tables, each headed [[model]]")?.iter().enumerate() {
        let table = value.table()?;
        table.allow(&["name", "scenario", "set", "free"])?;
        let name_value = table.required("name")?;
        let name = name_value.text()?.to_owned();
        if name.is_empty() || models.iter().any(|model| model.name.as_deref() == Some(&name)) {
            return Err(name_value.out_of_range("a name of its own for each model"));
        }
        let own = match table.optional("scenario") {
            Some(path) => {
                let document = Document::read(&document.resolve(path.text()?))?;
                let own = Scenario::from_document(document.reading_once())?;
                own.check_use(Feature::Fit)?;
                Some(own)
            }
            None => None,
        };
        let from = own.as_ref().unwrap_or(base);
        let mut values = from.document().values()?;
        if let Some(set) = table.optional("set") {
            let entries = plain.and_then(|list| list.get(index)?.get("set")?.as_table());
            for (path, place) in set.table()?.entries() {
                let Some(value) = entries.and_then(|entries| entries.get(path)) else { continue };
                put(&mut values, path, value.clone())
                    .map_err(|reason| refused(&place, from, &format!("{path}: {reason}")))?;
            }
            let changed = from.document().with_values(&values);
            if let Err(error) = Scenario::from_document(changed) {
                return Err(refused(&set, from, &said(&error)));
            }
        }
        let more = read_free(table.optional("free").as_ref(), context)?;
        if let Some(twice) = more.iter().find(|more| common.iter().any(|known| known.path == more.path)) {
            return Err(twice.place.out_of_range("each number once, for all models or for this one"));
        }
        models.extend(Model::all(Some(name), (from, values), common, &more)?);
    }
    if models.is_empty() {
        return Err(value.out_of_range("one model at least"));
    }
    Ok(models)
}

/// The error about a value that the scenario refuses.
fn refused(place: &Value<'_>, scenario: &Scenario, reason: &str) -> InputError {
    let file = scenario.document().name().to_owned();
    place.error(Problem::Refused { file, reason: reason.to_owned() })
}

/// The message of an error in a scenario, without its place, since no such file exists.
pub(super) fn said(error: &InputError) -> String {
    let advice = error.problem().allowed().map_or_else(String::new, |allowed| format!("; {allowed}"));
    let key = match (error.key(), error.value()) {
        ("", _) => String::new(),
        (key, "") => format!("{key}: "),
        (key, value) => format!("{key} = {value}: "),
    };
    format!("{key}{}{advice}", error.problem())
}

impl Model {
    /// The model, or one for each number of terms of its Prony series.
    fn all(
        name: Option<String>,
        (base, values): (&Scenario, toml::Table),
        common: &[Wanted<'_>],
        more: &[Wanted<'_>],
    ) -> Result<Vec<Self>, InputError> {
        let wanted: Vec<&Wanted<'_>> = common.iter().chain(more).collect();
        let mut ranges = wanted.iter().filter(|wanted| wanted.terms() > 1);
        let several = ranges.next().and_then(|wanted| wanted.series.as_ref());
        if let Some(second) = ranges.next() {
            return Err(second.place.out_of_range("one list of which the number of terms is sought"));
        }
        let Some(series) = several else { return Ok(vec![Self::new(name, base, values, &wanted, None)?]) };
        let of = |terms: usize| {
            let own = format!("{terms} {}", if terms == 1 { "term" } else { "terms" });
            let name = name.as_ref().map_or_else(|| own.clone(), |name| format!("{name}, {own}"));
            Self::new(Some(name), base, values.clone(), &wanted, Some(terms))
        };
        series.terms.clone().map(of).collect()
    }

    /// The model; a Prony series of which the number of terms is sought has `terms`.
    fn new(
        name: Option<String>,
        base: &Scenario,
        mut values: toml::Table,
        wanted: &[&Wanted<'_>],
        terms: Option<usize>,
    ) -> Result<Self, InputError> {
        let mut free = Vec::new();
        for Wanted { place, path, record, start, bounds, scale, series } in wanted {
            if let Some(series) = series {
                let count = terms.filter(|terms| series.terms.contains(terms));
                let count = count.unwrap_or(*series.terms.start());
                let path_value = place.table()?.required("path")?;
                let put = series.put(&mut values, path, count);
                let (paths, start) = put.map_err(|reason| refused(&path_value, base, &reason))?;
                if let Err(error) = Scenario::from_document(base.document().with_values(&values)) {
                    return Err(refused(&path_value, base, &said(&error)));
                }
                let (scale, bounds) = (Scale::Linear, (0.0, f64::INFINITY));
                free.extend(paths.into_iter().map(|path| Free { path, record: None, start, bounds, scale }));
                continue;
            }
            if is_of_shift(path) {
                let start = start.unwrap_or_default();
                let (path, bounds, scale) = (path.clone(), *bounds, *scale);
                free.push(Free { path, record: None, start, bounds, scale });
                continue;
            }
            let found = number_at(&values, path);
            let is_of_the_system = SOUGHT.iter().any(|part| path.starts_with(part));
            let Some(own) = found.filter(|_| is_of_the_system) else {
                let reason = format!(
                    "there is no number of the system, its start or its input at `{path}`; paths are such as system.damping[0].order, system.parameters.k"
                );
                let path_value = place.table()?.required("path")?;
                return Err(refused(&path_value, base, &reason));
            };
            if mirrored(path).is_some_and(|(mirrored, _)| value_at(&values, &mirrored).is_none()) {
                return Err(refused(place, base, "the mirror image of this entry is missing"));
            }
            let start = start.unwrap_or(own);
            check_number(place, start, *bounds, *scale)?;
            let free_number =
                Free { path: path.clone(), record: *record, start, bounds: *bounds, scale: *scale };
            let mut changed = values.clone();
            put_number(&mut changed, path, start).map_err(|reason| refused(place, base, &reason))?;
            let scenario = Scenario::from_document(base.document().with_values(&changed));
            if let Err(error) = scenario {
                return Err(refused(place, base, &format!("{path} = {start}: {}", said(&error))));
            }
            free.push(free_number);
        }
        Ok(Self { name, base: base.clone(), values, free })
    }

    /// Refuses a table of data that does not fit this model, or sets values that it refuses.
    fn check_record(&self, index: usize, record: &Record, place: &Value<'_>) -> Result<(), InputError> {
        let set = || place.table().ok().and_then(|table| table.optional("set"));
        let mut values = self.values.clone();
        for (path, value) in &record.set {
            let set = set();
            let blamed = set.as_ref().unwrap_or(place);
            if self.free.iter().any(|free| free.path == *path && free.record.is_none_or(|own| own == index)) {
                return Err(blamed.out_of_range(format!("numbers that are not free: {path} is sought")));
            }
            put(&mut values, path, value.clone())
                .map_err(|reason| refused(blamed, &self.base, &format!("{path}: {reason}")))?;
        }
        let scenario = Scenario::from_document(self.base.document().with_values(&values));
        let scenario =
            scenario.map_err(|error| refused(set().as_ref().unwrap_or(place), &self.base, &said(&error)))?;
        scenario.check_use(Feature::Fit)?;
        let own = extent(&scenario);
        let highest = record.places.last().copied().unwrap_or(0.0);
        if record.domain == Domain::Time && highest > own.end * (1.0 + 1e-12) {
            let end = own.end;
            let reason = format!("data up to t = {highest}: the motion ends at t = {end}");
            return Err(refused(place, &self.base, &reason));
        }
        let lowest = record.places.first().copied().unwrap_or(f64::INFINITY);
        if record.domain == Domain::Time && lowest < own.begin * (1.0 - 1e-12) {
            let reason = format!("data from t = {lowest} on: the motion begins at t = {}", own.begin);
            return Err(refused(place, &self.base, &reason));
        }
        record.check_extent(own).map_err(|reason| refused(place, &self.base, &reason))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_found_by_their_paths() {
        let table: toml::Table = "a = { list = [1.0, [2, 3.0]] }\nb = [{ c = 1.5 }]".parse().unwrap();
        assert_eq!(value_at(&table, "a.list[1][0]").and_then(toml::Value::as_integer), Some(2));
        assert_eq!(value_at(&table, "b[0].c").and_then(toml::Value::as_float), Some(1.5));
        for path in ["a.list[2]", "b[0].d", "c", "a.list.x", "b[x].c"] {
            assert!(value_at(&table, path).is_none(), "{path}");
        }
    }
}
