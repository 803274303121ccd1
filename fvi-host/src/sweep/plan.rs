//! The sweep file: a scenario, the values of some of its keys, and the results to be kept.

use super::axis::{self, Axis, Values};
use super::keep::{Quantities, Quantity};
use super::points::{MOST_SOBOL, MOST_SOBOL_AXES, Sampling};
use super::records::Layout;
use crate::checkpoint::contents_of_kernels;
use fvi_scenario::language::document::{Document, Table, Value};
use fvi_scenario::language::expression::nearest;
use fvi_scenario::language::{InputError, Problem, put};
#[cfg(feature = "pictures")]
use fvi_scenario::scenario::Paper;
use fvi_scenario::scenario::{Feature, Members, Scenario, SharedTerms};
use fvi_simulation::simulation::Precision;
use serde_json::json;
use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A sweep with all its values checked.
#[derive(Clone, Debug)]
pub struct Sweep {
    document: Document,
    base: Scenario,
    /// Values of the scenario's file.
    values: toml::Table,
    axes: Vec<Axis>,
    sampling: Sampling,
    runs: usize,
    trajectories: bool,
    settled: f64,
    quantities: Quantities,
    pictures: Vec<PictureRequest>,
    heading: String,
    own_terms: Option<TermsOfRuns>,
    /// The runs as members of the scenario, if all axes are of numbers.
    members: Option<Members>,
}

/// Makes the potential and forces given as code for the scenario of a run.
#[derive(Clone)]
struct TermsOfRuns(Arc<dyn Fn(&Scenario) -> SharedTerms + Send + Sync>);

impl fmt::Debug for TermsOfRuns {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TermsOfRuns(…)")
    }
}

/// A picture requested in the file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PictureRequest {
    pub(super) name: String,
    /// The column that is drawn.
    pub(super) quantity: String,
    /// Index of the axis along the picture.
    pub(super) x: usize,
    pub(super) over: Over,
    pub(super) logarithmic: bool,
    /// Ends of the scale of the quantity.
    pub(super) range: Option<(f64, f64)>,
    /// Name of a column with values 0 and 1, whose boundary is drawn into the map.
    pub(super) limit: Option<String>,
}

/// Second axis of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Over {
    /// No second axis.
    Alone,
    /// A curve for each value of another axis.
    Curves(usize),
    /// A second axis of a map.
    Map(usize),
}

/// Default fraction of a run, at its end, over which amplitudes are taken.
const SETTLED: f64 = 0.5;

/// The keys of a sweep.
const KEYS: [&str; 6] = ["title", "scenario", "axes", "sampling", "keep", "pictures"];

/// Largest number of runs; more would need records too large for a disk.
const MOST_RUNS: usize = u32::MAX as usize;

impl Sweep {
    /// Reads and checks a sweep file and its scenario.
    ///
    /// # Errors
    /// The first thing in either that cannot be used, with its place.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        Self::from_document(&Document::read(path)?)
    }

    /// Checks a sweep already read, and reads the scenario that it names.
    ///
    /// # Errors
    /// The first thing that cannot be used, with its place.
    pub fn from_document(document: &Document) -> Result<Self, InputError> {
        Self::of_scenario(document, document.scenario(&KEYS)?)
    }

    /// Checks a sweep and its scenario, both already read; the sweep's key `scenario` is ignored.
    ///
    /// # Errors
    /// The first thing in either that cannot be used, with its place.
    pub fn of_scenario(document: &Document, scenario: Document) -> Result<Self, InputError> {
        let plain = document.values()?;
        // Files that the scenario names are read once and shared by all runs.
        let base = Scenario::from_document(scenario.reading_once())?;
        document.with_root(|root| Self::from_root(&root, document, base, &plain))
    }

    fn from_root(
        root: &Table<'_>,
        document: &Document,
        base: Scenario,
        plain: &toml::Table,
    ) -> Result<Self, InputError> {
        root.allow(&KEYS)?;
        base.check_use(Feature::Sweep)?;
        let title = root.optional("title").map(|value| value.text().map(str::to_owned)).transpose()?;
        let values = base.document().values()?;
        let sampling_table = root.optional("sampling").map(|value| value.table()).transpose()?;
        let axes_value = root.required("axes")?;
        let table = axes_value.table()?;
        let plain_axes = plain.get("axes").and_then(toml::Value::as_table);
        let mut axes = Vec::new();
        for (path, value) in table.entries() {
            let plain =
                plain_axes.and_then(|axes| axes.get(path)).ok_or_else(|| axes_value.out_of_range(""))?;
            axes.push(Axis::read(path, &value, plain, sampling_table.is_some())?);
        }
        if axes.is_empty() {
            return Err(axes_value.out_of_range("at least one key of the scenario with its values"));
        }
        let sampling = match &sampling_table {
            Some(table) => read_sampling(table, axes.len())?,
            None => Sampling::Grid,
        };
        let runs = sampling.runs(&axes).filter(|&runs| runs <= MOST_RUNS);
        let runs = runs.ok_or_else(|| axes_value.out_of_range(format!("at most {MOST_RUNS} runs")))?;
        let mut sweep = Self {
            document: document.clone(),
            heading: title.unwrap_or_else(|| base.heading().to_owned()),
            quantities: Quantities { groups: Vec::new(), coordinates: base.coordinates() },
            base,
            values,
            axes,
            sampling,
            runs,
            trajectories: false,
            settled: SETTLED,
            pictures: Vec::new(),
            own_terms: None,
            members: None,
        };
        sweep.read_keep(root.optional("keep").map(|value| value.table()).transpose()?.as_ref())?;
        if sweep.axes.iter().all(Axis::is_numeric) {
            let paths = sweep.axes.iter().map(|axis| axis.path.as_str());
            sweep.members = Members::new(sweep.base.clone(), paths).ok();
        }
        for (index, (_, value)) in table.entries().iter().enumerate() {
            sweep.check_axis(index, value)?;
        }
        if let Some(value) = root.optional("pictures") {
            for (index, picture) in value.list("a list of pictures, [[pictures]]")?.iter().enumerate() {
                let picture = sweep.read_picture(&picture.table()?, index)?;
                sweep.pictures.push(picture);
            }
        }
        Ok(sweep)
    }

    fn read_keep(&mut self, table: Option<&Table<'_>>) -> Result<(), InputError> {
        let mut groups = vec![Quantity::Last, Quantity::Largest, Quantity::Energy];
        if self.base.reference.is_some() {
            groups.push(Quantity::Errors);
        }
        if let Some(table) = table {
            table.allow(&["trajectories", "quantities", "settled"])?;
            self.trajectories = table.optional("trajectories").map_or(Ok(false), |value| value.truth())?;
            if let Some(value) = table.optional("settled") {
                self.settled = value.number()?;
                if !(self.settled > 0.0 && self.settled <= 1.0) {
                    return Err(value.out_of_range(
                        "0 < settled ≤ 1, the last share of the run that `amplitude` is taken over",
                    ));
                }
            }
            if let Some(value) = table.optional("quantities") {
                let list = value.list("a list of quantities")?;
                groups = list.iter().map(|value| value.choice(&Quantity::NAMES)).collect::<Result<_, _>>()?;
                let twice = (1..groups.len()).find(|&index| groups[..index].contains(&groups[index]));
                if let Some(twice) = twice {
                    return Err(list[twice].out_of_range("each quantity once"));
                }
            }
        }
        self.quantities.groups = groups;
        Ok(())
    }

    /// Checks an axis: its path must be a key of the scenario, and each of its values valid with the other
    /// axes at their first values.
    fn check_axis(&self, index: usize, place: &Value<'_>) -> Result<(), InputError> {
        let axis = &self.axes[index];
        // Parameters may be unused in a scenario, but an axis over one that it does not define is a mistake.
        if let Some(name) = axis.path.strip_prefix("system.parameters.")
            && !self.base.document().has(&axis.path)
        {
            let reason = format!("the scenario has no parameter `{name}`");
            return Err(self.no_such_key(place, &axis.path, Some(reason)));
        }
        if axis.path == "time.step" {
            let terms = self.base.system.damping.iter().enumerate();
            let mut given = terms.filter(|(_, term)| term.transfer.table().is_some());
            let varies = |index: usize| {
                let kernel = format!("system.damping[{index}].kernel");
                !self.axes.iter().any(|axis| axis.path.starts_with(&kernel))
            };
            if let Some((index, _)) = given.find(|&(index, _)| varies(index)) {
                let with = format!("`system.damping[{index}].kernel.weights`, which belong to one step");
                let allowed = "one `time.step`, or an axis with a file of weights for each".to_owned();
                return Err(place.error(Problem::Incompatible { with, allowed }));
            }
        }
        let elements = if place.is_list() { place.list("a list of values")? } else { Vec::new() };
        let mut values: Vec<(Option<&Value<'_>>, toml::Value)> = match (&axis.values, &self.sampling) {
            (Values::List(list), _) => {
                list.iter().enumerate().map(|(at, value)| (elements.get(at), value.clone())).collect()
            }
            (_, Sampling::Grid) => (0..axis.count()).map(|at| (None, axis.value(at))).collect(),
            _ => [0.0, 0.5, 1.0].map(|share| (None, axis.at(share))).to_vec(),
        };
        values.dedup_by(|a, b| a.1 == b.1);
        let first: Vec<toml::Value> = self.axes.iter().map(|axis| axis.value(0)).collect();
        for (element, value) in values {
            let beside = |other: usize| if other == index { &value } else { &first[other] };
            let numbers = (0..first.len()).map(|other| axis::number(beside(other)));
            let numbers = numbers.collect::<Option<Vec<f64>>>();
            let is_one = |members: &Members| numbers.and_then(|numbers| members.changed(&numbers)).is_some();
            if self.members.as_ref().is_some_and(is_one) {
                continue;
            }
            let mut table = self.values.clone();
            for (other, axis) in self.axes.iter().enumerate() {
                let value = beside(other).clone();
                if let Err(reason) = put(&mut table, &axis.path, value) {
                    // The path of another axis is checked with that axis.
                    return if other == index {
                        Err(self.no_such_key(place, &axis.path, Some(reason)))
                    } else {
                        Ok(())
                    };
                }
            }
            let Err(error) = Scenario::from_document(self.base.document().with_values(&table)) else {
                continue;
            };
            if let Problem::UnknownKey { .. } = error.problem() {
                if axis.path.starts_with(error.key()) {
                    return Err(self.no_such_key(place, &axis.path, None));
                }
                continue;
            }
            // The first value of another axis may cause the error, which is then reported for that axis.
            let others =
                self.axes.iter().enumerate().any(|(other, axis)| other != index && error.key() == axis.path);
            if others {
                continue;
            }
            let advice = error.problem().allowed().map_or_else(String::new, |allowed| format!("; {allowed}"));
            let key = if error.key().is_empty() { String::new() } else { format!("{}: ", error.key()) };
            let reason = format!("{} = {}: {key}{}{advice}", axis.path, axis::cell(&value), error.problem());
            let file = self.base.document().name().to_owned();
            return Err(element.unwrap_or(place).error(Problem::Refused { file, reason }));
        }
        Ok(())
    }

    /// The error about a path that does not exist.
    fn no_such_key(&self, place: &Value<'_>, path: &str, reason: Option<String>) -> InputError {
        let mut paths = BTreeSet::new();
        collect_paths("", &toml::Value::Table(self.values.clone()), &mut paths);
        let used = serde_json::to_string(&self.base).ok().and_then(|text| serde_json::from_str(&text).ok());
        if let Some(used) = used {
            collect_paths("", &used, &mut paths);
        }
        let suggestion = nearest(path, paths.iter().map(String::as_str)).map(str::to_owned);
        let file = self.base.document().name();
        let allowed = match reason {
            Some(reason) => format!("keys of {file} by their paths; {reason}"),
            None => format!("keys of {file} by their paths, such as `system.damping[0].order`"),
        };
        place.key_error(Problem::UnknownKey { suggestion, allowed })
    }

    fn read_picture(&self, table: &Table<'_>, index: usize) -> Result<PictureRequest, InputError> {
        table.allow(&["name", "quantity", "x", "y", "curves", "scale", "range", "limit"])?;
        let axis = |value: &Value<'_>| -> Result<usize, InputError> {
            let path = value.text()?;
            let found = self.axes.iter().position(|axis| axis.path == path && axis.is_numeric());
            found.ok_or_else(|| {
                let numeric = self.axes.iter().filter(|axis| axis.is_numeric());
                let paths: Vec<String> = numeric.map(|axis| format!("\"{}\"", axis.path)).collect();
                value.out_of_range(format!("an axis of numbers: {}", paths.join(", ")))
            })
        };
        let columns = self.quantities.columns();
        let column = |value: &Value<'_>| -> Result<String, InputError> {
            let name = value.text()?.to_owned();
            if columns.contains(&name) {
                return Ok(name);
            }
            Err(value.out_of_range(format!("a column of the table: {}", columns.join(", "))))
        };
        let name = match table.optional("name") {
            Some(value) => {
                let name = value.text()?.to_owned();
                let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
                if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
                    return Err(value.out_of_range("letters, digits, `-`, `_` and `.`, not in front"));
                }
                if self.pictures.iter().any(|picture| picture.name == name) {
                    return Err(value.out_of_range("a name of its own for each picture"));
                }
                name
            }
            None => format!("picture-{}", index + 1),
        };
        let x = axis(&table.required("x")?)?;
        let (y, curves) = (table.optional("y"), table.optional("curves"));
        let over = match (&y, &curves) {
            (Some(_), Some(curves)) => {
                return Err(curves.key_error(Problem::Conflict { other: "y".to_owned() }));
            }
            (Some(value), None) => Over::Map(axis(value)?),
            (None, Some(value)) => Over::Curves(axis(value)?),
            (None, None) => Over::Alone,
        };
        if let (Over::Map(other) | Over::Curves(other), Some(value)) = (over, y.as_ref().or(curves.as_ref()))
            && other == x
        {
            return Err(value.out_of_range("another axis than `x`"));
        }
        let limit = table.optional("limit");
        if let (Some(value), false) = (&limit, matches!(over, Over::Map(_))) {
            return Err(value.key_error(Problem::Incompatible {
                with: "a picture without `y`".to_owned(),
                allowed: "`limit` belongs to a map".to_owned(),
            }));
        }
        let scales = [("linear", false), ("logarithmic", true)];
        let logarithmic = table.optional("scale").map_or(Ok(false), |value| value.choice(&scales))?;
        let range = match table.optional("range") {
            Some(value) => match value.numbers()?.as_slice() {
                &[from, to] if from < to && (from > 0.0 || !logarithmic) => Some((from, to)),
                _ => {
                    return Err(
                        value.out_of_range("two numbers, the lower first, both > 0 on a logarithmic scale")
                    );
                }
            },
            None => None,
        };
        let quantity = column(&table.required("quantity")?)?;
        let limit = limit.map(|value| column(&value)).transpose()?;
        Ok(PictureRequest { name, quantity, x, over, logarithmic, range, limit })
    }

    /// Number of runs.
    pub fn runs(&self) -> usize {
        self.runs
    }

    /// The scenario that the runs vary.
    pub fn base(&self) -> &Scenario {
        &self.base
    }

    /// The document that it was read from.
    pub(super) fn document(&self) -> &Document {
        &self.document
    }

    /// All strings that may occur in scenarios of the sweep.
    pub(super) fn texts(&self) -> BTreeSet<&str> {
        let lists = self.axes.iter().filter_map(|axis| match &axis.values {
            Values::List(values) => Some(values),
            Values::Range { .. } | Values::Whole { .. } => None,
        });
        let mut texts = BTreeSet::new();
        self.values.values().chain(lists.flatten()).for_each(|value| collect_texts(value, &mut texts));
        texts
    }

    /// The size of its pictures, as the scenario says.
    #[cfg(feature = "pictures")]
    pub(super) fn paper(&self) -> Option<Paper> {
        self.base.output.appearance.paper
    }

    /// The title, or that of the scenario.
    pub fn heading(&self) -> &str {
        &self.heading
    }

    /// The scenario of a run.
    ///
    /// # Errors
    /// If the combination of values is invalid.
    pub fn scenario_of(&self, run: usize) -> Result<Scenario, InputError> {
        match self.members.as_ref().and_then(|members| members.changed(&self.numbers_of(run)?)) {
            Some(scenario) => Ok(self.with_terms(scenario)),
            None => self.read_scenario_of(run),
        }
    }

    /// The values of a run, if all are numbers.
    fn numbers_of(&self, run: usize) -> Option<Vec<f64>> {
        self.values_of(run).iter().map(axis::number).collect()
    }

    /// The scenario of a run in the place of another [member](Members::put); `None` if it must be read, or is
    /// refused.
    pub(super) fn put_member<'m>(
        &self,
        run: usize,
        member: &'m mut Option<Scenario>,
    ) -> Option<&'m Scenario> {
        let members = self.members.as_ref()?;
        members.put(&self.numbers_of(run)?, member)?;
        if self.own_terms.is_some() {
            *member = member.take().map(|member| self.with_terms(member));
        }
        member.as_ref()
    }

    /// True if a simulation of one run can begin anew with another.
    pub(super) fn runs_differ_in_start_and_parameters(&self) -> bool {
        self.members.as_ref().is_some_and(Members::differ_in_start_and_parameters)
    }

    /// The scenario of a run, read from the values of its file.
    ///
    /// # Errors
    /// As [`scenario_of`](Self::scenario_of).
    pub(super) fn read_scenario_of(&self, run: usize) -> Result<Scenario, InputError> {
        let mut table = self.values.clone();
        for (axis, value) in self.axes.iter().zip(self.values_of(run)) {
            // The paths were checked when the sweep was read.
            let _ = put(&mut table, &axis.path, value);
        }
        Scenario::from_document(self.base.document().with_values(&table)).map(|read| self.with_terms(read))
    }

    fn with_terms(&self, scenario: Scenario) -> Scenario {
        match &self.own_terms {
            Some(TermsOfRuns(make)) => {
                let terms = make(&scenario);
                scenario.with_own_terms(terms)
            }
            None => scenario,
        }
    }

    /// The sweep with potential and forces given as code, in addition to those of each run's scenario. The
    /// records do not identify that code.
    #[must_use]
    pub fn with_own_terms(mut self, make: impl Fn(&Scenario) -> SharedTerms + Send + Sync + 'static) -> Self {
        self.own_terms = Some(TermsOfRuns(Arc::new(make)));
        self
    }

    pub(super) fn values_of(&self, run: usize) -> Vec<toml::Value> {
        self.sampling.values(&self.axes, run)
    }

    pub(super) fn axes(&self) -> &[Axis] {
        &self.axes
    }

    #[cfg(feature = "pictures")]
    pub(super) fn is_grid(&self) -> bool {
        self.sampling == Sampling::Grid
    }

    #[cfg(feature = "pictures")]
    pub(super) fn pictures(&self) -> &[PictureRequest] {
        &self.pictures
    }

    pub(super) fn quantities(&self) -> &Quantities {
        &self.quantities
    }

    pub(super) fn settled(&self) -> f64 {
        self.settled
    }

    /// True if the trajectory of each run goes into a file.
    pub fn keeps_trajectories(&self) -> bool {
        self.trajectories
    }

    /// Path of the trajectory of a run, if it is kept.
    pub(super) fn trajectory_of(&self, run: usize, directory: &Path) -> Option<PathBuf> {
        self.trajectories.then(|| directory.join("runs").join(format!("{run:06}.npz")))
    }

    pub(super) fn layout(&self) -> Layout {
        Layout { runs: self.runs, columns: self.quantities.columns().len() }
    }

    /// Identity of a sweep; the runs of two sweeps with the same identity may be joined in one table.
    pub(super) fn identity(&self, precision: Precision) -> Vec<u8> {
        let mut identity = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "precision": precision,
            "scenario": self.base,
            "file": self.values.to_string(),
            "axes": self.axes.iter().map(|axis| format!("{axis:?}")).collect::<Vec<_>>(),
            "sampling": match &self.sampling {
                Sampling::Grid => "grid".to_owned(),
                Sampling::LatinHypercube { seed, .. } => format!("latin-hypercube {seed}"),
                Sampling::Sobol { seed, .. } => format!("sobol {seed}"),
            },
            "runs": self.runs,
            "columns": self.quantities.columns(),
            "settled": self.settled,
            "trajectories": self.trajectories,
        });
        let kernels = contents_of_kernels(&self.base);
        if !kernels.is_empty() {
            identity["kernels"] = json!(kernels);
        }
        identity.to_string().into_bytes()
    }
}

fn read_sampling(table: &Table<'_>, axes: usize) -> Result<Sampling, InputError> {
    table.allow(&["kind", "count", "seed"])?;
    let sobol = table.required("kind")?.choice(&[("latin-hypercube", false), ("sobol", true)])?;
    let count_value = table.required("count")?;
    let most = if sobol { MOST_SOBOL } else { MOST_RUNS };
    let count = count_value.whole(1..=most)?;
    let seed = table.optional("seed").map_or(Ok(0), |value| value.whole(0..=usize::MAX))? as u64;
    if !sobol {
        return Ok(Sampling::latin_hypercube(axes, count, seed));
    }
    if axes > MOST_SOBOL_AXES {
        return Err(count_value.out_of_range(format!("at most {MOST_SOBOL_AXES} axes with Sobol's points")));
    }
    Ok(Sampling::Sobol { seed, count })
}

/// Collects all strings of a value.
fn collect_texts<'a>(value: &'a toml::Value, texts: &mut BTreeSet<&'a str>) {
    match value {
        toml::Value::String(text) => {
            texts.insert(text);
        }
        toml::Value::Array(list) => list.iter().for_each(|value| collect_texts(value, texts)),
        toml::Value::Table(table) => table.values().for_each(|value| collect_texts(value, texts)),
        _ => {}
    }
}

/// Collects the paths of all values that are not tables.
fn collect_paths(path: &str, value: &toml::Value, paths: &mut BTreeSet<String>) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                collect_paths(&path, value, paths);
            }
        }
        toml::Value::Array(list) => {
            paths.insert(path.to_owned());
            for (index, value) in list.iter().enumerate().take(100) {
                collect_paths(&format!("{path}[{index}]"), value, paths);
            }
        }
        _ => {
            paths.insert(path.to_owned());
        }
    }
}
