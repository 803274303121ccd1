//! The comparison of `fvi compare-engines`, a short form of the strategy lab: the project's memories for s^β
//! as constructed in runs; first agreement, then time per step and memory.

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use fvi_core::{BdfOrder, ParameterError};
use fvi_fft::WeightTable;
use fvi_fft::baseline::{Naive, OfflineFft, Signal};
#[cfg(feature = "pictures")]
use fvi_host::results::files::write_picture;
use fvi_host::results::files::{FileError, write_text};
#[cfg(feature = "pictures")]
use fvi_host::results::picture::{Axis, Chart, Series, Style};
use fvi_scenario::language::memory_limit::{OutOfMemory, check_capacity};

use crate::contestant::Timed;
use crate::plan::Conditions;
use crate::race::{begin, clock_nanoseconds, quantile, round, steps_ns};
use crate::record::{Kind, Row};
use crate::strategy::{AnyMemory, BuiltStrategy, Strategy, Task, require_short};
use crate::{field, project};

/// Problem on which the engines are compared.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Numbers of steps.
    pub lengths: Vec<usize>,
    /// Kernels: order of the backward differentiation formula and exponent of the quadrature, at step size 1.
    pub kernels: Vec<(BdfOrder, f64)>,
    /// Rounds in which each engine is made anew and timed; `None`: the shorter a run, the more of them.
    pub repetitions: Option<usize>,
}

/// One engine on one kernel at one length.
#[derive(Clone, Debug)]
pub struct EngineMeasurement {
    /// Name of the engine.
    pub engine: String,
    /// Number of steps.
    pub length: usize,
    /// Order of the backward differentiation formula.
    pub order: BdfOrder,
    /// Exponent of the quadrature.
    pub exponent: f64,
    /// Mean time of a step in nanoseconds, from a run without clock readings in between.
    pub step_mean_ns: f64,
    /// Times of the single steps in nanoseconds, shortest first; empty for an offline transform, which has no
    /// steps.
    pub steps_ns: Vec<f64>,
    /// Bytes of state, tables and buffers.
    pub bytes: usize,
    /// Largest |r_k − reference| / Σ|w||x| over the signals, in units of u = 2⁻⁵³.
    pub max_error_u: f64,
}

/// Why a comparison ended early.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ComparisonError {
    /// A parameter of a kernel is outside its range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The longest comparison does not fit into memory.
    #[error("a comparison over {length} steps: {no_room}")]
    NoRoom {
        /// Its number of steps.
        length: usize,
        /// Bytes that would be needed.
        no_room: OutOfMemory,
    },
    /// An engine cannot be constructed, or fails during a run.
    #[error("the engine \"{engine}\" failed: {reason}")]
    Failed {
        /// Name of the engine.
        engine: String,
        /// The problem.
        reason: String,
    },
}

const OFFLINE: &str = "offline-fft";

/// Longest time of one run of one engine.
const LIMIT: Duration = Duration::from_secs(24 * 3600);

/// The engines of the project, with an offline transform as the lower bound and the textbook algorithms.
pub fn strategies() -> Vec<Strategy> {
    let offline = Strategy::new(OFFLINE, "one transform of known samples, the lower bound", |task| {
        let offline = OfflineFft::new(WeightTable::scalars(&task.weights), task.length)?;
        Ok(BuiltStrategy::of(AnyMemory::Offline(Box::new(offline))))
    });
    let names = ["exponential-sum", "exponential-sum-core", "block-fft", "real-time", "direct", "hls"];
    let known: Vec<Strategy> = project::strategies().into_iter().chain(field::strategies()).collect();
    let engines = names.iter().filter_map(|name| known.iter().find(|one| one.name == *name).cloned());
    let naive = Strategy::new("naive", "the double sum as it is written", |task| {
        require_short(task, task.length)?;
        let memory = Naive::planned(WeightTable::scalars(&task.weights), 1, task.length)?;
        Ok(BuiltStrategy::of(AnyMemory::F64(Box::new(memory))))
    });
    std::iter::once(offline).chain(engines).chain([naive]).collect()
}

impl Comparison {
    /// Measures strategies; `progress` receives a description of the current measurement.
    ///
    /// For each kernel and length there is a race: first every engine runs on a smooth signal with noise, a
    /// decaying and a growing one, and a constant, and is compared with a sum in twice the precision. Then
    /// the engines are made anew and timed, round by round, and the shortest time counts: of whole runs for
    /// the mean, of each place among the sorted steps for the distribution. Engines whose cost per step grows
    /// with the run do not take part in longer ones.
    ///
    /// # Errors
    /// [`ComparisonError`] if an engine cannot be constructed or refuses a sample.
    pub fn run(
        &self,
        strategies: &[Strategy],
        progress: &mut dyn FnMut(&str),
    ) -> Result<Vec<EngineMeasurement>, ComparisonError> {
        self.require_room()?;
        let mut measurements = Vec::new();
        for &(order, exponent) in &self.kernels {
            for &length in &self.lengths {
                progress(&format!("order {}, exponent {exponent}, {length} steps", order.get()));
                let task = Task::of_a_run(order, exponent, length)?;
                let rounds = self.repetitions.unwrap_or_else(|| ((1 << 23) / length.max(1)).clamp(5, 50));
                let clock = clock_nanoseconds();
                for (row, shortest) in measure(&task, strategies, rounds)? {
                    let bytes = row.bytes.ok_or_else(|| ComparisonError::Failed {
                        engine: row.strategy.clone(),
                        reason: "its bytes are not known".to_owned(),
                    })?;
                    measurements.push(EngineMeasurement {
                        engine: row.strategy,
                        length,
                        order,
                        exponent,
                        step_mean_ns: shortest.mean_ns,
                        steps_ns: steps_ns(&shortest.steps, clock),
                        bytes,
                        max_error_u: row.error_u,
                    });
                }
            }
        }
        Ok(measurements)
    }
}

impl Comparison {
    /// Refuses lengths for which the engines, all at once, would not fit into memory.
    fn require_room(&self) -> Result<(), ComparisonError> {
        // Measured on the engines of the project: 380 bytes a step while they run, with a margin; in addition
        // the times of single steps, which are kept.
        const RUNNING: usize = 640;
        const KEPT: usize = 56;
        let length = self.lengths.iter().copied().max().unwrap_or(0);
        let all = self.lengths.iter().fold(0_usize, |sum, &length| sum.saturating_add(length));
        let kept = all.saturating_mul(self.kernels.len()).saturating_mul(KEPT);
        check_capacity(length.saturating_mul(RUNNING).saturating_add(kept))
            .map_err(|no_room| ComparisonError::NoRoom { length, no_room })
    }
}

/// Shortest times of some rounds.
struct Shortest {
    mean_ns: f64,
    /// Of the steps, shortest first, with a reading of the clock.
    steps: Vec<u32>,
}

/// A race of so many rounds: its rows with the shortest times.
fn measure(
    task: &Task,
    strategies: &[Strategy],
    rounds: usize,
) -> Result<Vec<(Row, Shortest)>, ComparisonError> {
    let signals = &Signal::ALL;
    let conditions = Conditions { signals, rounds: (rounds, rounds), limit: LIMIT, patience: Duration::MAX };
    let never = AtomicBool::new(false);
    let Some(mut race) = begin(&conditions, task, strategies, &never) else { return Ok(Vec::new()) };
    let mut shortest: HashMap<String, Shortest> = HashMap::new();
    let mut note = |name: &str, timed: &Timed| {
        let known = shortest
            .entry(name.to_owned())
            .or_insert_with(|| Shortest { mean_ns: f64::INFINITY, steps: timed.steps.clone() });
        known.mean_ns = known.mean_ns.min(timed.with_waiting_ns);
        known.steps.iter_mut().zip(&timed.steps).for_each(|(step, &other)| *step = (*step).min(other));
    };
    for _ in 0..rounds {
        let Some(next) = round(&race, &conditions, task, strategies, &never, false, &mut note) else { break };
        race = next;
        if let Some(absence) = race.absent.iter().find(|absence| absence.kind == Kind::Failed) {
            let (engine, reason) = (absence.strategy.clone(), absence.reason.clone());
            return Err(ComparisonError::Failed { engine, reason });
        }
    }
    let rows = race.rows.into_iter();
    Ok(rows.filter_map(|row| shortest.remove(&row.strategy).map(|shortest| (row, shortest))).collect())
}

impl EngineMeasurement {
    /// The step time in nanoseconds that the fraction `part` of the steps does not exceed.
    pub fn step_quantile_ns(&self, part: f64) -> Option<f64> {
        quantile(&self.steps_ns, part)
    }
}

/// Writes `engines.csv`, one row per measurement; an offline transform has no single steps.
///
/// # Errors
/// If the file cannot be written.
pub fn write_table(measurements: &[EngineMeasurement], path: &Path) -> Result<(), FileError> {
    let table = table(measurements)
        .map_err(|error| FileError { path: path.to_owned(), source: std::io::Error::other(error) })?;
    write_text(path, &table)
}

fn table(measurements: &[EngineMeasurement]) -> Result<String, csv::Error> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record([
        "engine",
        "length",
        "order",
        "exponent",
        "step_mean_ns",
        "step_p50_ns",
        "step_p999_ns",
        "step_max_ns",
        "bytes",
        "max_error_u",
    ])?;
    for row in measurements {
        let quantile = |part| row.step_quantile_ns(part).map_or(String::new(), |time| format!("{time:.1}"));
        table.write_record([
            row.engine.clone(),
            row.length.to_string(),
            row.order.get().to_string(),
            row.exponent.to_string(),
            format!("{:.3}", row.step_mean_ns),
            quantile(0.5),
            quantile(0.999),
            quantile(1.0),
            row.bytes.to_string(),
            format!("{:.3}", row.max_error_u),
        ])?;
    }
    let bytes = table.into_inner().map_err(|error| csv::Error::from(error.into_error()))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// The measurements as text, with the time relative to the offline transform of the same kernel and length.
pub fn text_table(measurements: &[EngineMeasurement]) -> String {
    let mut text = format!(
        "{:<20} {:>8} {:>5} {:>8} {:>9} {:>8} {:>8} {:>8} {:>10} {:>10} {:>8}\n",
        "engine",
        "length",
        "order",
        "exponent",
        "mean/ns",
        "/offline",
        "p50/ns",
        "p99.9/ns",
        "max/ns",
        "bytes",
        "error/u"
    );
    for row in measurements {
        let offline = measurements.iter().find(|other| other.engine == OFFLINE && same_task(row, other));
        let ratio = offline
            .map_or(String::new(), |offline| format!("{:.2}", row.step_mean_ns / offline.step_mean_ns));
        let quantile =
            |part| row.step_quantile_ns(part).map_or("–".to_owned(), |time| format!("{time:.0}"));
        text += &format!(
            "{:<20} {:>8} {:>5} {:>8} {:>9.1} {:>8} {:>8} {:>8} {:>10} {:>10} {:>8}\n",
            row.engine,
            row.length,
            row.order.get(),
            row.exponent,
            row.step_mean_ns,
            ratio,
            quantile(0.5),
            quantile(0.999),
            quantile(1.0),
            row.bytes,
            if row.max_error_u < 1e5 {
                format!("{:.1}", row.max_error_u)
            } else {
                format!("{:.0e}", row.max_error_u)
            },
        );
    }
    text
}

fn same_task(a: &EngineMeasurement, b: &EngineMeasurement) -> bool {
    (a.length, a.order, a.exponent) == (b.length, b.order, b.exponent)
}

/// Draws, for each kernel, the time per step against the length and, at the greatest length, how many steps
/// take longer than a time; returns the names of the files.
///
/// # Errors
/// If a picture cannot be drawn or written.
#[cfg(feature = "pictures")]
pub fn write_pictures(
    measurements: &[EngineMeasurement],
    directory: &Path,
) -> Result<Vec<String>, FileError> {
    let mut files = Vec::new();
    let mut kernels: Vec<(BdfOrder, f64)> = Vec::new();
    for row in measurements {
        if !kernels.contains(&(row.order, row.exponent)) {
            kernels.push((row.order, row.exponent));
        }
    }
    for (order, exponent) in kernels {
        let rows: Vec<&EngineMeasurement> =
            measurements.iter().filter(|row| (row.order, row.exponent) == (order, exponent)).collect();
        let subtitle = format!("BDF order {}, exponent {exponent}, one coordinate, f64", order.get());
        let suffix = format!("order{}_exponent{exponent}.svg", order.get());
        for (name, chart) in
            [("step_time", time_against_length(&rows)), ("step_distribution", distribution(&rows))]
        {
            let file = format!("{name}_{suffix}");
            write_picture(&directory.join(&file), &chart.with_subtitle(&subtitle))?;
            files.push(file);
        }
    }
    Ok(files)
}

#[cfg(feature = "pictures")]
fn time_against_length(rows: &[&EngineMeasurement]) -> Chart {
    let mut chart = Chart::new(
        "Time per step against the number of steps",
        Axis::logarithmic("steps"),
        Axis::logarithmic("mean time per step / ns"),
    );
    let mut engines: Vec<&str> = Vec::new();
    for row in rows {
        if !engines.contains(&row.engine.as_str()) {
            engines.push(&row.engine);
        }
    }
    for engine in engines {
        let points = rows.iter().filter(|row| row.engine == engine);
        let points = points.map(|row| (row.length as f64, row.step_mean_ns)).collect();
        let style = if engine == OFFLINE { Style::Reference } else { Style::LineWithPoints };
        chart = chart.with(Series::new(engine, style, points));
    }
    chart
}

#[cfg(feature = "pictures")]
fn distribution(rows: &[&EngineMeasurement]) -> Chart {
    let longest = rows.iter().map(|row| row.length).max().unwrap_or(0);
    let mut chart = Chart::new(
        format!("How many of {longest} steps take longer"),
        Axis::logarithmic("time of a step / ns"),
        Axis::logarithmic("part of the steps that take longer"),
    );
    for row in rows.iter().filter(|row| row.length == longest && !row.steps_ns.is_empty()) {
        let count = row.steps_ns.len();
        // Points at even distances along the logarithmic axis, down to the one longest step.
        let mut points: Vec<(f64, f64)> = Vec::new();
        let mut beyond = count;
        while beyond > 0 {
            points.push((row.steps_ns[count - beyond].max(1.0), beyond as f64 / count as f64));
            beyond = (beyond * 19 / 20).min(beyond - 1);
        }
        chart = chart.with(Series::new(&row.engine, Style::Line, points));
    }
    chart
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_fft::BlockFft;

    fn comparison(lengths: &[usize]) -> Comparison {
        let kernels = vec![(BdfOrder::GRUNWALD_LETNIKOV, 0.5)];
        Comparison { lengths: lengths.to_vec(), kernels, repetitions: Some(2) }
    }

    #[test]
    fn every_engine_is_measured_and_agrees() {
        let rows = comparison(&[1, 32, 700]).run(&strategies(), &mut |_| {}).unwrap();
        let engines: Vec<&str> = rows.iter().map(|row| row.engine.as_str()).collect();
        let names = [
            OFFLINE,
            "exponential-sum",
            "exponential-sum-core",
            "block-fft",
            "real-time",
            "direct",
            "hls",
            "naive",
        ];
        assert_eq!(engines, [names, names, names].concat());
        for row in &rows {
            assert!(row.step_mean_ns.is_finite() && row.max_error_u.is_finite() && row.bytes > 0);
            let (single_steps, exact) = (row.engine != OFFLINE, !["hls", "naive"].contains(&&*row.engine));
            assert_eq!(row.steps_ns.len(), if single_steps { row.length } else { 0 }, "{}", row.engine);
            assert!(
                !(single_steps && exact) || row.max_error_u <= 30.0,
                "{}: {} u",
                row.engine,
                row.max_error_u
            );
        }
    }

    #[test]
    fn a_wrong_engine_is_found_out() {
        let wrong = Strategy::new("wrong", "", |task| {
            let mut weights = task.weights.to_vec();
            weights[5] *= 1.0 + 1e-9;
            Ok(BuiltStrategy::memory(BlockFft::planned(WeightTable::scalars(&weights), 1, task.length)?))
        });
        let rows = comparison(&[500]).run(&[wrong], &mut |_| {}).unwrap();
        assert!(rows[0].max_error_u > 1000.0);
    }

    #[test]
    fn an_engine_that_refuses_a_sample_is_named() {
        let small = Strategy::new("small", "", |task| {
            Ok(BuiltStrategy::memory(BlockFft::planned(WeightTable::scalars(&task.weights), 1, 10)?))
        });
        let error = comparison(&[20]).run(&[small], &mut |_| {}).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the engine \"small\" failed: step 10: the memory is full: it takes 10 samples"
        );
    }

    #[test]
    fn quantiles_are_those_of_the_sorted_steps() {
        let steps_ns = (0..1001).map(f64::from).collect();
        let row = EngineMeasurement {
            engine: "some".to_owned(),
            length: 1001,
            order: BdfOrder::GRUNWALD_LETNIKOV,
            exponent: 0.5,
            step_mean_ns: 500.0,
            steps_ns,
            bytes: 1,
            max_error_u: 0.0,
        };
        assert_eq!(row.step_quantile_ns(0.5), Some(500.0));
        assert_eq!(row.step_quantile_ns(0.999), Some(999.0));
        assert_eq!(row.step_quantile_ns(1.0), Some(1000.0));
    }
}
