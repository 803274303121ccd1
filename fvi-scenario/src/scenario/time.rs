//! `[time]`, `[history]` and `[output]`: the grid, the memory engine and the output.

use super::adaptive::{Adaptive, MOST_STEPS_CHOSEN, Start};
use super::appearance::Appearance;
use super::grid::{Grid, GridRule, read_must_hit};
use super::keys;
use super::scheme_descriptor::SchemeDescriptor;
use crate::language::document::{Document, Table};
use crate::language::error::{InputError, Problem};
use fvi_core::min_or_nan;
use fvi_fft::exponentials::exponential_table::SMALLEST_TOLERANCE;
use fvi_fft::memory::{Engine, History, Overflow, States};
use fvi_fft::sums::max_or_nan;
use serde::{Serialize, Serializer};
use std::collections::BTreeSet;

/// Largest number of steps of a run: larger indices are not exact in double precision.
pub const MOST_STEPS: usize = 1 << 53;

/// What the end of a run that begins at 0, or later, must be.
pub(super) const LEAST_END: [&str; 2] = ["an end ≥ 0", "an end ≥ `start`"];

/// The times t_0 … t_steps: t_k = t_0 + k h, or those of a grid with different steps, from t_0 = 0 on.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeGrid {
    /// t_0 ≥ 0; zero for different steps.
    pub start: f64,
    /// h > 0; the shortest of different steps.
    pub step: f64,
    /// Number of steps; if they are chosen during the run, the largest number.
    pub steps: usize,
    /// The grid with different steps; `None` for equal steps.
    pub grid: Option<Grid>,
    /// True if to run although the step is known to be unstable.
    pub allow_unstable: bool,
    /// Reaction to energy that grows without work done on the system; absent: the run stops, unless
    /// `allow_unstable`.
    pub energy_guard: Option<OnEnergyGrowth>,
}

/// `[time]` in serialised form.
#[derive(Default, Serialize)]
struct Record<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    grid: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    start: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    step: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    steps: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    end: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    exponent: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    first: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ratio: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    longest: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    tolerance: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    shortest: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<Points<'a>>,
    #[serde(skip_serializing_if = "<[f64]>::is_empty")]
    must_hit: &'a [f64],
    allow_unstable: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    energy_guard: Option<OnEnergyGrowth>,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Points<'a> {
    File(&'a str),
    Times(&'a [f64]),
}

impl Serialize for TimeGrid {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { allow_unstable, energy_guard, .. } = *self;
        let mut record = Record { allow_unstable, energy_guard, ..Record::default() };
        match &self.grid {
            None => {
                record.start = Some(self.start).filter(|&start| start != 0.0);
                (record.step, record.steps) = (Some(self.step), Some(self.steps));
            }
            Some(grid) => {
                record.must_hit = grid.must_hit();
                match grid.rule() {
                    &GridRule::Graded { end, steps, exponent } => {
                        (record.grid, record.end) = (Some("graded"), Some(end));
                        (record.steps, record.exponent) = (Some(steps), Some(exponent));
                    }
                    &GridRule::Geometric { end, first, ratio, longest } => {
                        (record.grid, record.end, record.longest) = (Some("geometric"), Some(end), longest);
                        (record.first, record.ratio) = (Some(first), Some(ratio));
                    }
                    GridRule::Points { file } => {
                        record.grid = Some("points");
                        record.points =
                            Some(file.as_deref().map_or(Points::Times(grid.times()), Points::File));
                    }
                    &GridRule::Adaptive(Adaptive {
                        end, tolerance, first, shortest, longest, scale, ..
                    }) => {
                        (record.grid, record.end) = (Some("adaptive"), Some(end));
                        (record.tolerance, record.scale) = (Some(tolerance), Some(scale));
                        (record.first, record.longest) = (first, longest);
                        record.shortest = Some(shortest);
                    }
                }
            }
        }
        record.serialize(serializer)
    }
}

/// Reaction to energy that grows without work done on the system.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnEnergyGrowth {
    /// The step fails.
    Stop,
    /// The run goes on and a warning is given.
    Warn,
    /// None: `"off"`.
    #[serde(rename = "off")]
    Ignore,
}

impl TimeGrid {
    pub(super) fn read(table: &Table<'_>, start: Start, document: &Document) -> Result<Self, InputError> {
        const KINDS: [(&str, bool); 5] = [
            ("uniform", true),
            ("graded", false),
            ("geometric", false),
            ("points", false),
            ("adaptive", false),
        ];
        let has = |key: &str| table.optional(key).is_some();
        // A tolerance asks for adaptive steps; an equation does so without any key for steps.
        let chosen = has("tolerance") || (start.of_equation && !has("step") && !has("steps"));
        let uniform = table.optional("grid").map_or(Ok(!chosen), |value| value.choice(&KINDS))?;
        let allow_unstable = table.optional("allow_unstable").map_or(Ok(false), |value| value.truth())?;
        let reactions =
            [("stop", OnEnergyGrowth::Stop), ("warn", OnEnergyGrowth::Warn), ("off", OnEnergyGrowth::Ignore)];
        let energy_guard =
            table.optional("energy_guard").map(|value| value.choice(&reactions)).transpose()?;
        let (start, step, steps, grid) = if uniform {
            let (start, step, steps) = Self::read_uniform(table)?;
            (start, step, steps, None)
        } else {
            let grid = Grid::read(table, start, document)?;
            let start = Self::read_start(table)?;
            let (shortest, steps) = match grid.adaptive() {
                Some(adaptive) => (adaptive.shortest, MOST_STEPS_CHOSEN),
                None => (grid.lengths().fold(f64::INFINITY, min_or_nan), grid.times().len() - 1),
            };
            (start, shortest, steps, Some(grid))
        };
        let grid = Self { start, step, steps, grid, allow_unstable, energy_guard };
        if let (true, Some(value)) = (uniform, table.optional("must_hit")) {
            let times = read_must_hit(&value, grid.end())?;
            if let Some(time) = times.iter().find(|&&time| grid.index_of(time).is_none()) {
                let from =
                    if start == 0.0 { String::new() } else { format!(", from `time.start`, {start}, on") };
                let allowed = format!(
                    "multiples of `time.step`, {step}{from}; {time} is none: take another step, or another grid"
                );
                return Err(value.out_of_range(allowed));
            }
        }
        Ok(grid)
    }

    fn read_start(table: &Table<'_>) -> Result<f64, InputError> {
        let Some(value) = table.optional("start") else { return Ok(0.0) };
        match value.number()? {
            start if start >= 0.0 => Ok(start),
            _ => Err(value.out_of_range("a start ≥ 0: a motion before it belongs into `initial.past`")),
        }
    }

    /// Start, step and number of steps of a uniform grid.
    fn read_uniform(table: &Table<'_>) -> Result<(f64, f64, usize), InputError> {
        table.allow(&[
            "grid",
            "start",
            "step",
            "steps",
            "end",
            "must_hit",
            "allow_unstable",
            "energy_guard",
        ])?;
        let step = table.required("step")?.positive()?;
        let start = Self::read_start(table)?;
        let (counted, value) = table.either("steps", "end")?;
        let steps = if counted {
            value.whole(0..=MOST_STEPS)?
        } else {
            let end = value.number()?;
            if end < start {
                let allowed = LEAST_END[usize::from(start != 0.0)];
                return Err(value.out_of_range(allowed));
            }
            steps_to(end, start, step).map_err(|allowed| value.out_of_range(allowed))?
        };
        if !(start + step * steps as f64).is_finite() {
            return Err(value.out_of_range("an end that is a finite time"));
        }
        Ok((start, step, steps))
    }

    /// The same time interval in another number of steps, if the grid has a rule for that.
    pub(super) fn in_steps(&self, steps: usize) -> Self {
        match self.grid.as_ref().and_then(|grid| grid.in_steps(steps)) {
            Some(grid) => Self {
                step: grid.lengths().fold(f64::INFINITY, min_or_nan),
                steps: grid.times().len() - 1,
                grid: Some(grid),
                ..self.clone()
            },
            None => {
                let step = (self.end() - self.start) / steps.max(1) as f64;
                Self { step, steps, grid: None, ..self.clone() }
            }
        }
    }

    /// Settings for steps chosen during the run.
    pub fn adaptive(&self) -> Option<&Adaptive> {
        self.grid.as_ref().and_then(Grid::adaptive)
    }

    /// Number of steps, if it is known in advance.
    pub fn steps_known(&self) -> Option<usize> {
        self.adaptive().is_none().then_some(self.steps)
    }

    /// The longest step.
    pub fn longest_step(&self) -> f64 {
        self.grid.as_ref().map_or(self.step, |grid| grid.lengths().fold(0.0, max_or_nan))
    }

    /// The mean step.
    pub fn mean_step(&self) -> f64 {
        self.grid.as_ref().map_or(self.step, |grid| grid.end() / self.steps as f64)
    }

    /// Description for headings.
    pub fn describe(&self) -> String {
        self.grid.as_ref().map_or_else(|| format!("step {}", self.step), Grid::describe)
    }

    /// Reaction to energy that grows without work done on the system.
    pub fn on_energy_growth(&self) -> OnEnergyGrowth {
        let default = if self.allow_unstable { OnEnergyGrowth::Ignore } else { OnEnergyGrowth::Stop };
        self.energy_guard.unwrap_or(default)
    }

    /// t_k.
    pub fn time(&self, index: usize) -> f64 {
        match &self.grid {
            None => self.start + self.step * index as f64,
            Some(grid) => grid.times().get(index).copied().unwrap_or_else(|| grid.end()),
        }
    }

    /// Largest difference of a time from t_k that counts as rounding.
    pub(super) fn tolerance(&self, index: usize) -> f64 {
        let step = match &self.grid {
            None => self.step,
            Some(_) => self.time(index) - self.time(index.saturating_sub(1)),
        };
        same_time(self.time(index), step)
    }

    /// The first step that begins at a time or, to rounding, after it.
    pub(super) fn first_step_from(&self, time: f64) -> usize {
        match &self.grid {
            None => {
                let place = (time - self.start) / self.step;
                if place.is_infinite() {
                    return usize::MAX;
                }
                (place - f64::max(1e-9, 4.0 * f64::EPSILON * place)).ceil().max(0.0) as usize
            }
            Some(grid) => {
                let after = grid.times().partition_point(|&other| other < time);
                let before = after.saturating_sub(1);
                if time - self.time(before) <= self.tolerance(before) { before } else { after }
            }
        }
    }

    /// The index of the grid time that differs from a time by rounding only.
    pub(super) fn index_of(&self, time: f64) -> Option<usize> {
        if let Some(grid) = &self.grid {
            let after = grid.times().partition_point(|&other| other < time);
            let near = |&index: &usize| {
                index <= self.steps && (time - self.time(index)).abs() <= self.tolerance(index)
            };
            return [after, after.saturating_sub(1)].into_iter().find(near);
        }
        let index = ((time - self.start) / self.step).round();
        if !(index >= 0.0 && index <= self.steps as f64) {
            return None;
        }
        let index = index as usize;
        let grid_time = self.time(index);
        ((time - grid_time).abs() <= same_time(grid_time, self.step)).then_some(index)
    }

    /// The last time.
    pub fn end(&self) -> f64 {
        self.time(self.steps)
    }
}

/// The number of steps from a start to a later time, which must be a grid time up to rounding; otherwise a
/// description of what is allowed.
pub(super) fn steps_to(end: f64, start: f64, step: f64) -> Result<usize, String> {
    let exact = (end - start) / step;
    let whole = exact.round();
    if whole > MOST_STEPS as f64 {
        return Err(format!("at most {MOST_STEPS} steps of {step}"));
    }
    let off_grid = (exact - whole).abs() > 1e-9 * whole.max(1.0) + 4.0 * f64::EPSILON * start / step;
    if off_grid || (whole == 0.0 && end > start) {
        let (before, after) = (start + exact.floor() * step, start + (exact.floor() + 1.0) * step);
        // Far out, neighbouring grid times are rounded to the same number.
        let examples = if before < after { format!(", such as {before} or {after}") } else { String::new() };
        return Err(format!("a whole number of steps of {step}{examples}; or give `steps` instead"));
    }
    Ok(whole as usize)
}

/// Largest difference of a time from the grid time `time` that counts as rounding.
pub(super) fn same_time(time: f64, step: f64) -> f64 {
    f64::max(1e-9 * step, 4.0 * f64::EPSILON * time)
}

/// Largest tolerance of the exponential sum, see `examples/scenarios/README.md`.
pub const LARGEST_TOLERANCE: f64 = 1e-6;

/// Smallest tolerance with which an exponential sum may keep its state in single precision: rounding takes up
/// to half of it.
pub const SMALLEST_SINGLE_TOLERANCE: f64 = 5e-7;

/// Reads `[history]` for a number of samples.
pub(super) fn read_history(table: &Table<'_>, samples: usize) -> Result<History, InputError> {
    table.allow(&keys::HISTORY)?;
    let mut engine = table.optional("engine").map(|value| value.choice(&Engine::NAMES)).transpose()?;
    let (ring, exponentials) =
        ([Engine::Direct].as_slice(), [Engine::ExponentialSum, Engine::ExponentialSumCore].as_slice());
    let chunks = [Engine::ExponentialSum].as_slice();
    for (key, owners) in [
        ("capacity", ring),
        ("overflow", ring),
        ("tolerance", exponentials),
        ("horizon", exponentials),
        ("states", chunks),
    ] {
        let (Some(value), Some(&owner)) = (table.optional(key), owners.first()) else { continue };
        if !owners.contains(engine.get_or_insert(owner)) {
            return Err(value.key_error(Problem::Incompatible {
                with: "this `history.engine`".to_owned(),
                allowed: format!("`{key}` belongs to the engine \"{}\"", owner.name()),
            }));
        }
    }
    let tolerance = match table.optional("tolerance") {
        Some(value) => {
            let tolerance = value.number()?;
            if !(SMALLEST_TOLERANCE..=LARGEST_TOLERANCE).contains(&tolerance) {
                let allowed = format!("{SMALLEST_TOLERANCE:e} ≤ tolerance ≤ {LARGEST_TOLERANCE:e}");
                return Err(value.out_of_range(allowed));
            }
            Some(tolerance)
        }
        None => None,
    };
    let states = match table.optional("states") {
        Some(value) => {
            let states = value.choice(&[("f64", States::F64), ("f32", States::F32)])?;
            // Depends on a number: the table of combinations has features only.
            if states == States::F32
                && tolerance.is_none_or(|tolerance| tolerance < SMALLEST_SINGLE_TOLERANCE)
            {
                let with = match tolerance {
                    Some(tolerance) => format!("`history.tolerance` = {tolerance:e}"),
                    None => "a `history.tolerance` that is not given: exact to rounding".to_owned(),
                };
                let allowed = format!(
                    "with a tolerance of {SMALLEST_SINGLE_TOLERANCE:e} or more, half of which rounding to single precision may take"
                );
                return Err(value.error(Problem::Incompatible { with, allowed }));
            }
            Some(states)
        }
        None => None,
    };
    let threads = table.optional("threads").map(|value| value.whole(1..=1024)).transpose()?;
    let horizon = table.optional("horizon").map(|value| value.whole(samples..=usize::MAX)).transpose()?;
    let capacity = table.optional("capacity").map(|value| value.whole(1..=usize::MAX)).transpose()?;
    let overflow = match table.optional("overflow") {
        Some(value) => {
            let overflow = value.choice(&[("stop", Overflow::Stop), ("forget", Overflow::Forget)])?;
            if overflow == Overflow::Forget && capacity.is_none() {
                let problem = Problem::MissingKey { key: "capacity".to_owned() };
                return Err(value.error(problem));
            }
            overflow
        }
        None => Overflow::Stop,
    };
    Ok(History { engine, tolerance, horizon, capacity, overflow, states, threads, ..History::default() })
}

/// Momentum that is reported if the fractional force acts at the main nodes, as a kick at the end of every
/// step, or if a singular start leaves an offset in the momentum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReportedMomentum {
    /// The mean of the momenta before and after the kick at t_k, p_k + (h/2) Σ_m ρ_m (D^{β_m} q)_k: of order
    /// 2. With damping at several nodes and Riemann–Liouville's type from q₀ ≠ 0, the computed momentum minus
    /// a known offset of order 2.
    #[default]
    Mean,
    /// The momentum after the kick, as in the papers: of order 1. With damping at nodes, the momentum of the
    /// discrete Lagrangian.
    OneSided,
}

/// Output options.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OutputOptions {
    /// Number of steps per row of the trajectory; the last row is always written.
    pub every: usize,
    /// The momentum in trajectories, summaries, pictures and errors. Most schemes have one only.
    pub momentum: ReportedMomentum,
    /// The coordinates that are columns of the trajectory and curves of the pictures; absent: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coordinates: Option<Vec<usize>>,
    /// Number of steps between states stored in `snapshots.npz`; absent: none are stored.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub snapshots: Option<usize>,
    /// Times of the rows, increasing; between grid points by the scheme's own polynomial. Empty: the grid
    /// points.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub times: Vec<f64>,
    /// True if the energies stored in the memories of damping and dissipated by them are columns of the
    /// trajectory.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub memory_energy: bool,
    /// How the pictures look; no part of what a run is.
    #[serde(skip)]
    pub appearance: Appearance,
}

impl OutputOptions {
    /// The default of a scenario without `[output]`. Euler's methods, baselines of order 1, report the
    /// momentum that they compute.
    pub fn default_for(scheme: &SchemeDescriptor) -> Self {
        let momentum =
            if scheme.reports_own_momentum { ReportedMomentum::OneSided } else { ReportedMomentum::Mean };
        Self {
            every: 1,
            momentum,
            coordinates: None,
            snapshots: None,
            times: Vec::new(),
            memory_energy: false,
            appearance: Appearance::default(),
        }
    }

    pub(super) fn read(
        table: &Table<'_>,
        scheme: &SchemeDescriptor,
        count: usize,
        grid: &TimeGrid,
    ) -> Result<Self, InputError> {
        table.allow(&keys::OUTPUT)?;
        let default = Self::default_for(scheme);
        let every = table.optional("every").map_or(Ok(default.every), |value| value.whole(1..=usize::MAX))?;
        let momentum = match table.optional("momentum") {
            Some(value) => {
                let kinds = [("mean", ReportedMomentum::Mean), ("one-sided", ReportedMomentum::OneSided)];
                value.choice(&kinds)?
            }
            None => default.momentum,
        };
        let coordinates = match table.optional("coordinates") {
            Some(value) => {
                let (mut chosen, mut known) = (Vec::new(), BTreeSet::new());
                for entry in value.list("a list of coordinates")? {
                    let coordinate = entry.whole(0..=count - 1)?;
                    if !known.insert(coordinate) {
                        return Err(entry.out_of_range("each coordinate once"));
                    }
                    chosen.push(coordinate);
                }
                if chosen.is_empty() {
                    return Err(value.out_of_range("one coordinate at least"));
                }
                Some(chosen)
            }
            None => None,
        };
        let snapshots = table.optional("snapshots").map(|value| value.whole(1..=usize::MAX)).transpose()?;
        let memory_energy = table.optional("memory_energy").map_or(Ok(false), |value| value.truth())?;
        let times = Vec::new();
        let appearance = Appearance::read(table, coordinates.as_ref().map_or(count, Vec::len))?;
        let output = Self { every, momentum, coordinates, snapshots, times, memory_energy, appearance };
        let Some(value) = table.optional("times") else {
            return Ok(output);
        };
        if table.optional("every").is_some() {
            return Err(value.error(Problem::Conflict { other: "output.every".to_owned() }));
        }
        let times = value.numbers()?;
        if times.is_empty() || !times.is_sorted_by(|earlier, later| earlier < later) {
            return Err(value.out_of_range("increasing times, one at least"));
        }
        let (start, end) = (grid.start, grid.end());
        if let Some(time) = times.iter().find(|&&time| !(start..=end).contains(&time)) {
            return Err(value.out_of_range(format!("times from {start} to the end, {end}; {time} is not")));
        }
        Ok(Self { times, ..output })
    }

    /// True if a row is written at a time, up to rounding.
    pub(super) fn has(&self, time: f64) -> bool {
        let near = |&other: &f64| (time - other).abs() <= same_time(time, 0.0);
        let after = self.times.partition_point(|&other| other < time);
        self.times.iter().skip(after.saturating_sub(1)).take(2).any(near)
    }
}
