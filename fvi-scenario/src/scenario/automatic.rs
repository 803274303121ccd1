//! `scheme.kind = "auto"`: a tolerance in place of scheme, convolution, grid and step.

use super::sparse_matrix::KnownMatrices;
use super::time::steps_to;
use super::{Derivative, Feature, Scenario};
use crate::language::document::{Document, Table};
use crate::language::{InputError, Problem};
use toml::Value;

/// Range of tolerances.
const SMALLEST: f64 = 1e-12;
const LARGEST: f64 = 0.1;

/// Number of equal steps of the scenario that is read before anything has been chosen.
const UNCHOSEN_STEPS: f64 = 64.0;

/// Most rows for which an adaptive grid has a grid point at every one.
const MOST_HIT: usize = 2000;

/// Most rows of a run that is compared with another one.
const MOST_COMPARED: usize = 4096;

/// Number of times at which runs on adaptive grids are compared where the file names none, half of them
/// equally spaced, half of them shrinking towards the start.
const COMPARED: usize = 32;

/// What a scenario with `scheme.kind = "auto"` asks for.
///
/// With ε the tolerance, the errors of position and momentum in the rows of the trajectory are to be at most
///
/// ```text
/// |δq_i| ≤ ε max(Q_i, Q/1000) ,   Q_i = max |q_i| over all rows ,   Q = max Q_i over the coordinates ,
/// ```
///
/// and the same with momenta.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Automatic {
    /// ε.
    pub tolerance: f64,
    /// Time between the rows of the trajectory, before `output.every`; `None`: they are at the grid points
    /// that are chosen.
    pub spacing: Option<f64>,
    start: f64,
    end: f64,
}

/// A way to integrate a scenario that asks for a tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The scheme.
    pub method: Method,
    /// How its steps lie.
    pub steps: Spread,
}

/// A scheme with its convolution quadrature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// The midpoint rule with BDF 2 at the node.
    Midpoint,
    /// Galerkin's scheme of a degree s on s Gauss points, with BDF of an order at the nodes.
    Galerkin {
        /// s.
        degree: usize,
        /// Of the weights.
        order: usize,
    },
    /// Galerkin's scheme of a degree with Gauss weights.
    Gauss {
        /// The degree.
        degree: usize,
    },
    /// Collocation by Radau IIA of three stages.
    Radau,
}

/// How the steps of a candidate lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spread {
    /// Equal steps.
    Equal,
    /// t_k = end (k/n)^exponent.
    Graded {
        /// The exponent.
        exponent: f64,
    },
    /// Chosen during the run by an error per step.
    Adaptive,
}

/// How fine a candidate is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fineness {
    /// Number of steps.
    Steps(usize),
    /// Tolerance of adaptive steps.
    Tolerance(f64),
}

/// The values of a table of a document.
type Keys = toml::Table;

impl Automatic {
    /// What a document asks for; `None` if it names a scheme or leaves it to the default.
    pub(super) fn of(document: &Document) -> Result<Option<Self>, InputError> {
        document.with_root(|root| {
            let Some(scheme) = root.optional("scheme").and_then(|value| value.table().ok()) else {
                return Ok(None);
            };
            match scheme.optional("kind") {
                Some(kind) if kind.text().is_ok_and(|kind| kind == "auto") => {
                    Self::read(&root, &scheme).map(Some)
                }
                _ => Ok(None),
            }
        })
    }

    fn read(root: &Table<'_>, scheme: &Table<'_>) -> Result<Self, InputError> {
        scheme.allow(&["kind", "tolerance"])?;
        let value = scheme.required("tolerance")?;
        let tolerance = value.number()?;
        if !(SMALLEST..=LARGEST).contains(&tolerance) {
            return Err(value.out_of_range(format!("{SMALLEST:e} ≤ tolerance ≤ {LARGEST}")));
        }
        if let Some(other) = root.optional("convolution") {
            return Err(other.key_error(Problem::Conflict { other: "scheme.kind = \"auto\"".to_owned() }));
        }
        let time = root.required("time")?.table()?;
        time.allow(&["start", "step", "steps", "end", "must_hit", "energy_guard"])?;
        let positive = |key: &str| time.optional(key).map(|value| value.positive()).transpose();
        let start = time.optional("start").map_or(Ok(0.0), |value| value.number())?;
        let mut spacing = positive("step")?;
        let end = match spacing {
            Some(step) => {
                let (counted, value) = time.either("steps", "end")?;
                if counted {
                    start + step * value.whole(1..=super::MOST_STEPS)? as f64
                } else {
                    let end = value.number()?;
                    steps_to(end, start, step).map_err(|allowed| value.out_of_range(allowed))?;
                    end
                }
            }
            None => {
                if let Some(value) = time.optional("steps") {
                    let allowed = "`end`; or `step` beside `steps`, the time between rows".to_owned();
                    let with = "`scheme.kind` = \"auto\", which chooses the steps".to_owned();
                    return Err(value.error(Problem::Incompatible { with, allowed }));
                }
                time.required("end")?.number()?
            }
        };
        if end.partial_cmp(&start) != Some(std::cmp::Ordering::Greater) {
            let value = time.either("steps", "end")?.1;
            return Err(value.out_of_range("an end after the start"));
        }
        if spacing.is_none() {
            spacing = sample_of_controllers(root)?;
        }
        Ok(Self { tolerance, spacing, start, end })
    }

    /// Number of rows apart from the first, where their spacing is given.
    pub fn rows(&self) -> Option<usize> {
        self.spacing.map(|spacing| ((self.end - self.start) / spacing).round() as usize)
    }

    /// Puts the grid of a candidate of a fineness into `[time]`.
    fn put_grid(self, spread: Spread, fineness: Fineness, rows: Option<&[f64]>, time: &mut Keys) {
        let Self { start, end, .. } = self;
        ["step", "steps", "end"].iter().for_each(|key| drop(time.remove(*key)));
        match (fineness, spread) {
            (Fineness::Steps(steps), Spread::Graded { exponent }) => {
                put(time, &[("grid", "graded".into()), ("exponent", exponent.into())]);
                put(time, &[("end", end.into()), ("steps", whole(steps))]);
            }
            (Fineness::Steps(steps), _) => {
                put(time, &[("step", ((end - start) / steps as f64).into()), ("steps", whole(steps))]);
            }
            (Fineness::Tolerance(tolerance), _) => {
                put(time, &[("grid", "adaptive".into()), ("tolerance", tolerance.into())]);
                put(time, &[("end", end.into())]);
                let mut hit = match rows {
                    Some(rows) if rows.len() <= MOST_HIT => rows.to_vec(),
                    Some(_) => Vec::new(),
                    None => compared_times(end),
                };
                hit.retain(|&time| time > 0.0 && time < end);
                if !hit.is_empty() && time.get("must_hit").is_none() {
                    put(time, &[("must_hit", list(&hit))]);
                }
            }
        }
    }

    /// `output.every` on equal or graded steps, with that of the file; of runs that are compared at most some
    /// [`MOST_COMPARED`] rows, those that they have in common among them.
    fn every(self, every: usize, steps: usize, compared: bool) -> usize {
        let stride = self.rows().map_or(1, |rows| (steps / rows.max(1)).max(1));
        let every = every.saturating_mul(stride);
        let rows = steps / every.max(1);
        match (compared && rows > MOST_COMPARED, self.rows()) {
            (false, _) => every,
            (true, Some(_)) => every.saturating_mul(rows.div_ceil(MOST_COMPARED)),
            (true, None) => (steps / COMPARED).max(1),
        }
    }

    /// Reads the document as if it left the scheme to the default.
    pub(super) fn unchosen(
        self,
        document: Document,
        known: Option<&KnownMatrices>,
    ) -> Result<Scenario, InputError> {
        let mut values = document.values()?;
        values.remove("scheme");
        let step = self.spacing.unwrap_or((self.end - self.start) / UNCHOSEN_STEPS);
        let steps = ((self.end - self.start) / step).round();
        change(&mut values, "time", |time| {
            time.remove("end");
            put(time, &[("step", step.into()), ("steps", whole(steps as usize))]);
        });
        let named = |error: InputError| document.error_at(error.key(), error.problem().clone());
        let mut scenario = Scenario::sharing(document.with_values(&values), known).map_err(named)?;
        scenario.automatic = Some(self);
        scenario.document = document;
        scenario.check_combinations()?;
        Ok(scenario)
    }
}

/// The time between samples of the first controller: rows that are wanted at every step are there, and
/// controllers need grid points.
fn sample_of_controllers(root: &Table<'_>) -> Result<Option<f64>, InputError> {
    let Some(value) = root.optional("controller") else { return Ok(None) };
    let first = if value.is_list() { value.list("tables")?.into_iter().next() } else { Some(value) };
    let sample = first.map(|first| first.table()?.required("sample")?.positive());
    sample.transpose()
}

fn whole(number: usize) -> Value {
    Value::Integer(i64::try_from(number).unwrap_or(i64::MAX))
}

/// Changes a table of a document, which is made if there is none.
fn change(values: &mut Keys, name: &str, with: impl FnOnce(&mut Keys)) {
    let mut table = match values.remove(name) {
        Some(Value::Table(table)) => table,
        _ => Keys::new(),
    };
    with(&mut table);
    values.insert(name.to_owned(), Value::Table(table));
}

fn put(table: &mut Keys, keys: &[(&str, Value)]) {
    for (key, value) in keys {
        table.insert((*key).to_owned(), value.clone());
    }
}

impl Candidate {
    /// The candidates for a scenario, the most promising first. Those that do not go with it are among them:
    /// reading them is refused by the table of combinations.
    ///
    /// A motion under fractional damping begins like a sum of powers of t that are not whole, which graded
    /// steps resolve and equal ones do not. Kinks and jumps in the position are met by adaptive steps.
    pub fn of(scenario: &Scenario) -> Vec<Self> {
        let all = |steps: Spread, methods: &[Method]| -> Vec<Self> {
            methods.iter().map(|&method| Self { method, steps }).collect()
        };
        let damping = &scenario.system.damping;
        let smooth = damping.iter().all(|term| {
            let growth = term.transfer.growth();
            term.derivative == Derivative::Caputo && (growth == 0.0 || growth == 1.0)
        });
        let graded = Spread::Graded { exponent: 3.0 };
        let gauss = [Method::Gauss { degree: 3 }, Method::Gauss { degree: 2 }];
        let galerkin = match damping.is_empty() {
            true => Method::Galerkin { degree: 3, order: 6 },
            false => Method::Galerkin { degree: 2, order: 4 },
        };
        let adaptive = Self { method: Method::Radau, steps: Spread::Adaptive };
        let first = match (damping.is_empty(), smooth) {
            _ if scenario.has_kinks() => vec![adaptive],
            (true, _) => all(Spread::Equal, &[galerkin, Method::Radau]),
            (false, true) => all(Spread::Equal, &[Method::Radau]),
            (false, false) => all(graded, &[Method::Radau]),
        };
        let rest = [
            all(Spread::Equal, &[galerkin, Method::Radau, gauss[0]]),
            vec![adaptive],
            all(Spread::Graded { exponent: 2.0 }, &gauss[..1]),
            all(graded, &[Method::Radau]),
            all(Spread::Equal, &[gauss[1], Method::Midpoint]),
        ];
        let mut candidates: Vec<Self> = Vec::new();
        for candidate in first.into_iter().chain(rest.into_iter().flatten()) {
            if !candidates.contains(&candidate) {
                candidates.push(candidate);
            }
        }
        candidates
    }

    /// The keys of `[scheme]` and `[convolution]`.
    fn keys(self) -> (Keys, Option<Keys>) {
        let table = |keys: &[(&str, Value)]| {
            let mut table = Keys::new();
            put(&mut table, keys);
            table
        };
        match self.method {
            Method::Midpoint => (table(&[("kind", "low-order".into())]), None),
            Method::Galerkin { degree, order } => (
                table(&[("kind", "galerkin".into()), ("degree", whole(degree))]),
                Some(table(&[("order", whole(order))])),
            ),
            Method::Gauss { degree } => (
                table(&[("kind", "galerkin".into()), ("degree", whole(degree))]),
                Some(table(&[("family", "gauss".into())])),
            ),
            Method::Radau => (
                table(&[("kind", "collocation".into())]),
                Some(table(&[("family", "radau-iia".into()), ("stages", whole(3))])),
            ),
        }
    }

    /// Time of a step of a system of one coordinate, in units of that of the midpoint rule; measured, and
    /// the same on every machine, so that a scenario leads to the same choice everywhere.
    pub fn cost(self) -> f64 {
        match (self.method, self.steps) {
            (Method::Midpoint, _) => 1.0,
            (Method::Galerkin { degree, .. }, _) => degree as f64,
            (Method::Gauss { degree }, Spread::Equal) => 5.0 * degree as f64,
            (Method::Gauss { degree }, _) => 40.0 * degree as f64,
            (Method::Radau, Spread::Adaptive) => 20.0,
            (Method::Radau, _) => 3.0,
        }
    }
}

impl Scenario {
    /// The scenario, which asks for a tolerance, on a candidate of this fineness. With `compared` its rows
    /// are those that such runs are compared at.
    ///
    /// # Errors
    /// If the candidate does not go with it.
    #[doc(hidden)]
    pub fn on_candidate(
        &self,
        candidate: Candidate,
        fineness: Fineness,
        (known, compared): (&KnownMatrices, bool),
    ) -> Result<Self, InputError> {
        let Some(automatic) = self.automatic else {
            return Err(self.error_at("scheme.kind", Problem::MissingKey { key: "tolerance".to_owned() }));
        };
        let mut values = self.document.values()?;
        let (scheme, convolution) = candidate.keys();
        values.insert("scheme".to_owned(), Value::Table(scheme));
        if let Some(convolution) = convolution {
            values.insert("convolution".to_owned(), Value::Table(convolution));
        }
        let rows = self.rows_of(automatic);
        let mut time_keys = Keys::new();
        change(&mut values, "time", |time| {
            automatic.put_grid(candidate.steps, fineness, rows.as_deref(), time);
            time_keys.clone_from(time);
        });
        if self.output.times.is_empty() {
            let every = self.output.every;
            change(&mut values, "output", |output| match (rows, fineness) {
                (_, Fineness::Steps(steps)) if candidate.steps == Spread::Equal => {
                    put(output, &[("every", whole(automatic.every(every, steps, compared)))]);
                }
                (Some(rows), _) => {
                    output.remove("every");
                    put(output, &[("times", list(&rows))]);
                }
                (None, Fineness::Steps(steps)) if compared => {
                    put(output, &[("every", whole(automatic.every(1, steps, true)))]);
                }
                (None, Fineness::Tolerance(_)) if compared => {
                    output.remove("every");
                    if let Some(hit) = time_keys.get("must_hit") {
                        put(output, &[("times", hit.clone())]);
                    }
                }
                (None, _) => {}
            });
        }
        self.read_as(&values, known)
    }

    /// Reads other values in place of those of the file, with what code has added to the scenario.
    fn read_as(&self, values: &Keys, known: &KnownMatrices) -> Result<Self, InputError> {
        let mut scenario = Self::knowing(self.document.with_values(values), known)?;
        scenario.document = self.document.clone();
        scenario.system.own_terms.clone_from(&self.system.own_terms);
        for (event, own) in scenario.events.iter_mut().zip(&self.events) {
            event.own.clone_from(&own.own);
        }
        if let Some(engine) = self.history.engine.filter(|_| scenario.history.engine != self.history.engine) {
            scenario.history.choose(engine);
        }
        scenario.check_combinations()?;
        Ok(scenario)
    }

    /// True if forces have jumps or kinks in the position.
    #[doc(hidden)]
    pub fn has_kinks(&self) -> bool {
        use Feature::{KinkedElement, KinkedForce, KinkedMechanism, KinkedPotential};
        let kinked = [KinkedPotential, KinkedElement, KinkedForce, KinkedMechanism];
        kinked.iter().any(|feature| feature.is_in(self))
    }

    /// The times of the rows, where the file determines them.
    fn rows_of(&self, automatic: Automatic) -> Option<Vec<f64>> {
        if !self.output.times.is_empty() {
            return Some(self.output.times.clone());
        }
        let (spacing, count) = (automatic.spacing?, automatic.rows()?);
        let every = self.output.every.max(1);
        let inner = (0..count).step_by(every).map(|row| automatic.start + spacing * row as f64);
        Some(inner.chain([automatic.end]).collect())
    }
}

fn list(numbers: &[f64]) -> Value {
    Value::Array(numbers.iter().map(|&number| Value::Float(number)).collect())
}

/// The times at which runs on adaptive grids are compared.
fn compared_times(end: f64) -> Vec<f64> {
    let half = COMPARED / 2;
    let equal = (1..half).map(|k| end * k as f64 / half as f64);
    let shrinking = (0..half).map(|k| end / half as f64 * libm::pow(0.25, k as f64 + 0.5));
    let mut times: Vec<f64> = equal.chain(shrinking).collect();
    times.sort_by(f64::total_cmp);
    times
}
