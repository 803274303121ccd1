//! `scheme.kind = "auto"`: a tolerance in place of scheme, convolution, grid and step.

use super::sparse_matrix::KnownMatrices;
use super::time::steps_to;
use super::{Amplitude, Damping, Derivative, Feature, Scenario};
use crate::language::document::{Document, Table};
use crate::language::expression::{Expression, Function, Kind};
use crate::language::{InputError, Problem};
use toml::Value;

/// Range of tolerances.
const SMALLEST: f64 = 1e-12;
const LARGEST: f64 = 0.1;

/// Number of equal steps of the scenario that is read before anything has been chosen.
const UNCHOSEN_STEPS: f64 = 64.0;

/// Most rows for which a graded or adaptive grid has a grid point at every one.
const MOST_HIT: usize = 2000;

/// Most rows of a run that is compared with another one.
const MOST_COMPARED: usize = 1 << 16;

/// Number of times at which runs on adaptive grids are compared where the file names none, half of them
/// equally spaced, half of them shrinking towards the start.
const COMPARED: usize = 32;

/// Tolerance from which on Radau IIA takes less time with five stages, in longer steps.
const FIVE_STAGES_FROM: f64 = 3e-5;

/// Smallest tolerance for which backward differentiation on equal steps comes before Radau IIA.
const MULTISTEP_FROM: f64 = 3e-6;

/// Most coordinates for which the matrix of a step may be full.
const FEW: usize = 32;

/// First row, as a part of the whole time, below which rows are those of decades of time.
const DECADES: f64 = 1e-4;

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
    /// Collocation by Radau IIA.
    Radau {
        /// Number of stages.
        stages: usize,
    },
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
    /// Tolerance of adaptive steps, relative to positions of this size.
    Tolerance {
        /// ε.
        of: f64,
        /// `time.scale`.
        scale: f64,
    },
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

    /// The whole time.
    pub fn length(&self) -> f64 {
        self.end - self.start
    }

    /// Puts the grid of a candidate of a fineness into `[time]`.
    fn put_grid(self, spread: Spread, fineness: Fineness, rows: Option<&[f64]>, time: &mut Keys) {
        let Self { start, end, .. } = self;
        let hit = |time: &mut Keys, rows: &[f64]| {
            let inner: Vec<f64> = rows.iter().copied().filter(|&row| row > 0.0 && row < end).collect();
            if !inner.is_empty() && inner.len() <= MOST_HIT && !time.contains_key("must_hit") {
                put(time, &[("must_hit", list(&inner))]);
            }
        };
        ["step", "steps", "end"].iter().for_each(|key| drop(time.remove(*key)));
        match (fineness, spread) {
            (Fineness::Steps(steps), Spread::Graded { exponent }) => {
                put(time, &[("grid", "graded".into()), ("exponent", exponent.into())]);
                put(time, &[("end", end.into()), ("steps", whole(steps))]);
                hit(time, rows.unwrap_or_default());
            }
            (Fineness::Steps(steps), _) => {
                put(time, &[("step", ((end - start) / steps as f64).into()), ("steps", whole(steps))]);
            }
            (Fineness::Tolerance { of, scale }, _) => {
                put(time, &[("grid", "adaptive".into()), ("tolerance", of.into())]);
                if scale != 1.0 {
                    put(time, &[("scale", scale.into())]);
                }
                put(time, &[("end", end.into())]);
                hit(time, rows.unwrap_or(&compared_times(end)));
            }
        }
    }

    /// `output.every` on equal or graded steps, with that of the file; of runs that are compared at most some
    /// [`MOST_COMPARED`] rows, those that a run with half as many steps has among them.
    fn every(self, every: usize, steps: usize, compared: bool) -> usize {
        let stride = self.rows().map_or(1, |rows| (steps / rows.max(1)).max(1));
        let every = every.saturating_mul(stride).max(1);
        let rows = steps / every;
        match compared && rows > MOST_COMPARED {
            true => every.saturating_mul(rows.div_ceil(MOST_COMPARED).next_power_of_two()),
            false => every,
        }
    }

    /// Grid points at which runs of equal steps are compared that have more than [`MOST_COMPARED`]: those of
    /// [`every`](Self::every), and others towards the start, where motions with memory are hardest.
    fn thinned(self, steps: usize) -> Vec<f64> {
        let stride = self.every(1, steps, true);
        let towards_start = (0..usize::BITS - 2).flat_map(|shift| [1 << shift, 3 << shift]);
        let mut all: Vec<usize> = (stride..=steps).step_by(stride).chain([steps]).collect();
        all.extend(towards_start.take_while(|&point| point < steps));
        all.sort_unstable();
        all.dedup();
        let step = self.length() / steps as f64;
        all.into_iter().map(|point| self.start + point as f64 * step).collect()
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
    /// steps resolve and equal ones do not. Where rows are away from the start equal steps come first, as
    /// that does not show. Kinks and jumps of forces are met by adaptive steps, and so are decades of time.
    pub fn of(scenario: &Scenario) -> Vec<Self> {
        let tolerance = scenario.automatic.map_or(LARGEST, |automatic| automatic.tolerance);
        let radau = Method::Radau { stages: if tolerance > FIVE_STAGES_FROM { 3 } else { 5 } };
        let damping = &scenario.system.damping;
        let of_few = scenario.coordinates() <= FEW;
        // Sparse factors are of degree 2.
        let (degree, order) = if damping.is_empty() || of_few { (3, 6) } else { (2, 4) };
        let galerkin = Method::Galerkin { degree, order };
        let at = |method: Method, steps: Spread| Self { method, steps };
        let equal = |method: Method| at(method, Spread::Equal);
        // Some kernels take up to three stages.
        let (radau_3, gauss) = (Method::Radau { stages: 3 }, Method::Gauss { degree: 3 });
        let (adaptive, graded) = (at(radau, Spread::Adaptive), at(radau, Spread::Graded { exponent: 3.0 }));
        let begin = scenario.first_row();
        // Strong damping limits the steps of backward differentiation, and kernels with a short memory do.
        let growth = |term: &Damping| term.transfer.growth();
        let limits_steps = damping.iter().any(|term| growth(term) > 1.0 || growth(term) == 0.0);
        let first = match damping.is_empty() {
            _ if scenario.order_at_breaks().is_some() => vec![adaptive],
            true => vec![equal(galerkin), equal(radau)],
            false if begin.is_some_and(|begin| begin < DECADES) => vec![adaptive, graded],
            false if scenario.shows_singular_start() => vec![graded, equal(galerkin)],
            false if limits_steps || tolerance < MULTISTEP_FROM => {
                vec![equal(radau), equal(radau_3), equal(galerkin)]
            }
            false => vec![equal(galerkin), equal(radau)],
        };
        let rest = [
            equal(galerkin),
            equal(radau),
            equal(gauss),
            adaptive,
            at(gauss, Spread::Graded { exponent: 2.0 }),
            graded,
            equal(Method::Galerkin { degree: 2, order: 4 }),
            equal(Method::Gauss { degree: 2 }),
            equal(radau_3),
            at(radau_3, Spread::Adaptive),
            equal(Method::Midpoint),
        ];
        let mut candidates: Vec<Self> = Vec::new();
        for candidate in first.into_iter().chain(rest) {
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
            Method::Radau { stages } => (
                table(&[("kind", "collocation".into())]),
                Some(table(&[("family", "radau-iia".into()), ("stages", whole(stages))])),
            ),
        }
    }

    /// Time of a run of so many steps with a system of one coordinate, in units of a step of the midpoint
    /// rule; measured, and the same on every machine, so that a scenario leads to the same choice everywhere.
    pub fn cost(self, steps: usize) -> f64 {
        self.preparation() + steps as f64 * self.cost_of_step()
    }

    /// What a run costs before its first step.
    pub fn preparation(self) -> f64 {
        match self.method {
            Method::Midpoint | Method::Galerkin { .. } => 700.0,
            Method::Gauss { .. } => 1000.0,
            Method::Radau { stages } => 1000.0 + 500.0 * stages as f64,
        }
    }

    /// What a step costs.
    pub fn cost_of_step(self) -> f64 {
        match (self.method, self.steps) {
            (Method::Midpoint, _) => 1.0,
            (Method::Galerkin { degree, .. }, _) => degree as f64,
            (Method::Gauss { degree }, Spread::Equal) => 5.0 * degree as f64,
            (Method::Gauss { degree }, _) => 100.0 * degree as f64,
            (Method::Radau { stages }, Spread::Adaptive) => 6.0 * stages as f64,
            (Method::Radau { stages }, Spread::Graded { .. }) => 2.0 * stages as f64,
            (Method::Radau { stages }, Spread::Equal) => stages as f64,
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
                (None, Fineness::Steps(steps))
                    if compared && candidate.steps == Spread::Equal && steps > MOST_COMPARED =>
                {
                    output.remove("every");
                    put(output, &[("times", list(&automatic.thinned(steps)))]);
                }
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
                (None, Fineness::Tolerance { .. }) if compared => {
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

    /// True if rows are at grid points and the motion begins like a power of t that is not whole, so that
    /// errors in the first rows shrink more slowly than the others.
    #[doc(hidden)]
    pub fn shows_singular_start(&self) -> bool {
        let is_smooth =
            |term: &Damping| term.derivative == Derivative::Caputo && term.transfer.growth() == 1.0;
        self.first_row().is_none() && !self.system.damping.iter().all(is_smooth)
    }

    /// The order at which errors of equal steps are sure to shrink if forces jump or have kinks, in the
    /// position or at times: how large errors are depends on where in a step that happens, so that two runs
    /// may agree by chance. `None` if there are none.
    #[doc(hidden)]
    pub fn order_at_breaks(&self) -> Option<f64> {
        use Feature::{KinkedElement, KinkedForce, KinkedMechanism, KinkedPotential};
        let kinked = [KinkedPotential, KinkedElement, KinkedForce, KinkedMechanism];
        let breaks = |expression: &Expression| {
            expression.root().any(&|node| match node.kind() {
                Kind::Call(function, _) => {
                    matches!(function, Function::Step | Function::Sign | Function::Abs)
                }
                Kind::Choice(function, _) => function.selects(),
                _ => false,
            })
        };
        let in_time = self.system.force.iter().flatten().any(breaks)
            || self.system.loads.iter().any(|load| match &load.amplitude {
                Amplitude::Expression(expression) => breaks(expression),
                Amplitude::Record(_) => true,
            });
        match kinked.iter().any(|feature| feature.is_in(self)) {
            true => Some(1.0),
            false => (in_time || self.input.is_some()).then_some(2.0),
        }
    }

    /// The time of the first row behind the start, as a part of the whole, where the file determines it.
    fn first_row(&self) -> Option<f64> {
        let automatic = self.automatic?;
        let rows = self.rows_of(automatic)?;
        let behind = rows.into_iter().find(|&time| time > automatic.start)?;
        Some((behind - automatic.start) / (automatic.end - automatic.start))
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
