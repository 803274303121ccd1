//! `[time]`, `[history]` and `[output]`: the grid, the memory engine and what is written.

use super::scheme::{ConvolutionFamily, Scheme};
use crate::language::document::Table;
use crate::language::error::{InputError, Problem};
use crate::numerics::exponential_table::SMALLEST_TOLERANCE;
use serde::Serialize;

/// Most steps of a run: beyond 2⁵³ their numbers have no exact place among floating-point numbers.
pub const MOST_STEPS: usize = 1 << 53;

/// The times t_k = k h, k = 0…steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TimeGrid {
    /// h > 0.
    pub step: f64,
    /// Number of steps.
    pub steps: usize,
    /// Whether to run although the step is known to make motions grow.
    pub allow_unstable: bool,
    /// What happens when energy grows that nothing has put in; absent: the run stops, unless `allow_unstable`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub energy_guard: Option<OnEnergyGrowth>,
}

/// What happens when energy grows that nothing has put in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnEnergyGrowth {
    /// The step fails.
    Stop,
    /// The run goes on and a warning is given.
    Warn,
    /// Nothing: `"off"`.
    #[serde(rename = "off")]
    Ignore,
}

impl TimeGrid {
    pub(super) fn read(table: &Table<'_>) -> Result<Self, InputError> {
        table.allow(&["step", "steps", "end", "allow_unstable", "energy_guard"])?;
        let step = table.required("step")?.positive()?;
        let (counted, value) = table.either("steps", "end")?;
        let steps = if counted {
            value.whole(0..=MOST_STEPS)?
        } else {
            let end = value.number()?;
            if end < 0.0 {
                return Err(value.out_of_range("an end ≥ 0"));
            }
            steps_to(end, step).map_err(|allowed| value.out_of_range(allowed))?
        };
        if !(step * steps as f64).is_finite() {
            return Err(value.out_of_range("an end that is a finite time"));
        }
        let allow_unstable = table.optional("allow_unstable").map_or(Ok(false), |value| value.truth())?;
        let reactions =
            [("stop", OnEnergyGrowth::Stop), ("warn", OnEnergyGrowth::Warn), ("off", OnEnergyGrowth::Ignore)];
        let energy_guard =
            table.optional("energy_guard").map(|value| value.choice(&reactions)).transpose()?;
        Ok(Self { step, steps, allow_unstable, energy_guard })
    }

    /// What happens when energy grows that nothing has put in.
    pub fn on_energy_growth(&self) -> OnEnergyGrowth {
        let default = if self.allow_unstable { OnEnergyGrowth::Ignore } else { OnEnergyGrowth::Stop };
        self.energy_guard.unwrap_or(default)
    }

    /// t_k.
    pub fn time(&self, index: usize) -> f64 {
        self.step * index as f64
    }

    /// The index of a time that differs from a grid time by rounding only.
    pub(super) fn index_of(&self, time: f64) -> Option<usize> {
        let index = (time / self.step).round();
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

/// The number of steps to a time ≥ 0, which is a grid time but for rounding; or what is allowed.
pub(super) fn steps_to(end: f64, step: f64) -> Result<usize, String> {
    let exact = end / step;
    let whole = exact.round();
    if whole > MOST_STEPS as f64 {
        return Err(format!("at most {MOST_STEPS} steps of {step}"));
    }
    let off_grid = (exact - whole).abs() > 1e-9 * whole.max(1.0);
    if off_grid || (whole == 0.0 && end > 0.0) {
        let (before, after) = (exact.floor() * step, (exact.floor() + 1.0) * step);
        // Far out, neighbouring grid times are one number.
        let examples = if before < after { format!(", such as {before} or {after}") } else { String::new() };
        return Err(format!("a whole number of steps of {step}{examples}; or give `steps` instead"));
    }
    Ok(whole as usize)
}

/// How far a time may be from the grid time `time` to be the same but for rounding.
pub(super) fn same_time(time: f64, step: f64) -> f64 {
    f64::max(1e-9 * step, 4.0 * f64::EPSILON * time)
}

/// A memory engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Engine {
    /// The plain sum over a ring of samples.
    Direct,
    /// Block transforms, amortised.
    BlockFft,
    /// Block transforms spread evenly over the steps.
    RealTime,
    /// A short head and decaying exponentials, in chunks and vector code.
    ExponentialSum,
    /// The same by the core's own memory, a sample at a time: what firmware runs, with its bits.
    ExponentialSumCore,
}

impl Engine {
    /// The engines with their names in files and on the command line.
    pub const NAMES: [(&'static str, Self); 5] = [
        ("direct", Self::Direct),
        ("block-fft", Self::BlockFft),
        ("real-time", Self::RealTime),
        ("exponential-sum", Self::ExponentialSum),
        ("exponential-sum-core", Self::ExponentialSumCore),
    ];

    /// The name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Direct => "direct",
            Self::BlockFft => "block-fft",
            Self::RealTime => "real-time",
            Self::ExponentialSum => "exponential-sum",
            Self::ExponentialSumCore => "exponential-sum-core",
        }
    }
}

/// What the direct engine does with a sample that no longer fits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Overflow {
    /// Stops the run.
    #[default]
    Stop,
    /// Forgets the oldest sample.
    Forget,
}

/// Largest tolerance of the exponential sum, see `scenarios/README.md`.
const LARGEST_TOLERANCE: f64 = 1e-6;

/// The memory engine and its settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct History {
    /// The engine; absent: the fastest that is exact to rounding.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub engine: Option<Engine>,
    /// Relative error of each weight of the exponential sum; absent: rounding.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Largest lag of the table of exponentials; absent: that of the run. A table of firmware reaches further.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub horizon: Option<usize>,
    /// Samples that the direct engine keeps; absent: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capacity: Option<usize>,
    /// What happens when they are more.
    pub overflow: Overflow,
    /// Samples that engine and table are chosen for, where a run is carried further than it was begun for; absent: those of the run.
    #[serde(skip)]
    pub planned: Option<usize>,
}

impl History {
    /// Puts another engine in place of the one in the file; settings that belong to that one no longer count.
    pub fn choose(&mut self, engine: Engine) {
        if self.engine != Some(engine) {
            *self = Self { engine: Some(engine), ..Self::default() };
        }
    }

    pub(super) fn read(
        table: &Table<'_>,
        family: ConvolutionFamily,
        time: &TimeGrid,
    ) -> Result<Self, InputError> {
        table.allow(&["engine", "tolerance", "horizon", "capacity", "overflow"])?;
        let mut engine = table.optional("engine").map(|value| value.choice(&Engine::NAMES)).transpose()?;
        let (ring, exponentials) =
            ([Engine::Direct].as_slice(), [Engine::ExponentialSum, Engine::ExponentialSumCore].as_slice());
        for (key, owners) in
            [("capacity", ring), ("overflow", ring), ("tolerance", exponentials), ("horizon", exponentials)]
        {
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
                if !matches!(family, ConvolutionFamily::Bdf { .. }) {
                    return Err(value.error(Problem::Incompatible {
                        with: "this `convolution.family`".to_owned(),
                        allowed: "only with \"bdf\"; the exponentials of Runge–Kutta quadrature are exact to rounding"
                            .to_owned(),
                    }));
                }
                Some(tolerance)
            }
            None => None,
        };
        let samples = time.steps.saturating_add(1);
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
        Ok(Self { engine, tolerance, horizon, capacity, overflow, planned: None })
    }
}

/// Which momentum is reported where the fractional force acts at the main nodes, as a kick at the end of every step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReportedMomentum {
    /// The mean of the momenta before and after the kick of t_k, p_k + (h/2) Σ_m ρ_m (D^{β_m} q)_k: of order 2.
    #[default]
    Mean,
    /// The one after it, the papers': of order 1.
    OneSided,
}

/// What is written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct OutputOptions {
    /// Every how many steps a row of the trajectory is written; the last row always is.
    pub every: usize,
    /// The momentum that trajectories, summaries, pictures and errors show. Where nothing acts at the main nodes there is one momentum only.
    pub momentum: ReportedMomentum,
    /// The coordinates that are columns of the trajectory and curves of the pictures; absent: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coordinates: Option<Vec<usize>>,
    /// Every how many steps the whole state is kept for `snapshots.npz`; absent: never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub snapshots: Option<usize>,
}

impl OutputOptions {
    /// What a scenario has that does not say. Euler's methods, baselines of order 1, have the momentum that they compute.
    pub fn default_for(scheme: &Scheme) -> Self {
        let momentum = match scheme {
            Scheme::ExplicitEuler | Scheme::ImplicitEuler => ReportedMomentum::OneSided,
            Scheme::LowOrder { .. } | Scheme::Galerkin { .. } => ReportedMomentum::Mean,
        };
        Self { every: 1, momentum, coordinates: None, snapshots: None }
    }

    pub(super) fn read(table: &Table<'_>, scheme: &Scheme, count: usize) -> Result<Self, InputError> {
        table.allow(&["every", "momentum", "coordinates", "snapshots"])?;
        let default = Self::default_for(scheme);
        let every = table.optional("every").map_or(Ok(default.every), |value| value.whole(1..=usize::MAX))?;
        let momentum = match table.optional("momentum") {
            Some(value) => {
                let kinds = [("mean", ReportedMomentum::Mean), ("one-sided", ReportedMomentum::OneSided)];
                let momentum = value.choice(&kinds)?;
                if momentum == ReportedMomentum::Mean && default.momentum == ReportedMomentum::OneSided {
                    return Err(value.error(Problem::Incompatible {
                        with: "this `scheme.kind`".to_owned(),
                        allowed: "\"one-sided\" with Euler's methods".to_owned(),
                    }));
                }
                momentum
            }
            None => default.momentum,
        };
        let coordinates = match table.optional("coordinates") {
            Some(value) => {
                let mut chosen: Vec<usize> = Vec::new();
                for entry in value.list("a list of coordinates")? {
                    let coordinate = entry.whole(0..=count - 1)?;
                    if chosen.contains(&coordinate) {
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
        Ok(Self { every, momentum, coordinates, snapshots })
    }
}
