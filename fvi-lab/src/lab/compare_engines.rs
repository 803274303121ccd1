//! Memory engines side by side: agreement first, then time per step and memory.

use crate::memory::{LEAST_ON_INCREMENTS, MemoryRequest};
use crate::numerics::transfer::TransferFunction;
#[cfg(feature = "pictures")]
use crate::results::files::write_picture;
use crate::results::files::{FileError, write};
#[cfg(feature = "pictures")]
use crate::results::picture::{Axis, Chart, Series, Style};
use crate::results::room::{NoRoom, require};
use crate::scenario::{Convolution, ConvolutionFamily, Engine, History};
use fvi_core::{BdfOrder, ConvolutionWeights, Memory, MemoryError, ParameterError};
use fvi_fft::WeightTable;
use fvi_fft::baseline::{Hls, Naive, OfflineFft, Signal, memory_term};
use std::error::Error;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

/// Problem on which the engines are compared.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Numbers of steps.
    pub lengths: Vec<usize>,
    /// Kernels: order of the backward differentiation formula and exponent of the quadrature, at step size 1.
    pub kernels: Vec<(BdfOrder, f64)>,
    /// Timed runs of each engine; `None`: the shorter a run, the more of them.
    pub repetitions: Option<usize>,
}

/// What an engine is made for: a convolution of one channel in `f64`.
#[derive(Clone, Copy, Debug)]
pub struct Task<'a> {
    /// Order of the backward differentiation formula.
    pub order: BdfOrder,
    /// Exponent of the quadrature.
    pub exponent: f64,
    /// The weights w₀, w₁, …, one for each step.
    pub weights: &'a [f64],
}

/// A memory, or `None` if the engine does not take part in this task.
pub type Candidate = Result<Option<Box<dyn Memory<f64>>>, Box<dyn Error + Send + Sync>>;

/// An engine to compare: its name and how it is made.
pub struct Contender<'a> {
    name: String,
    make: Box<dyn Fn(Task<'_>) -> Candidate + 'a>,
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
    /// Mean time of a step in nanoseconds, from a run that reads no clock in between.
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
    /// There is no room for the longest comparison.
    #[error("a comparison over {length} steps: {no_room}")]
    NoRoom {
        /// Its number of steps.
        length: usize,
        /// Bytes that would be needed.
        no_room: NoRoom,
    },
    /// An engine cannot be made.
    #[error("the engine \"{engine}\" cannot be made: {error}")]
    Making {
        /// Name of the engine.
        engine: String,
        /// Its message.
        error: Box<dyn Error + Send + Sync>,
    },
    /// An engine took fewer samples than it was made for.
    #[error("the engine \"{engine}\" failed at step {step}: {error}")]
    Memory {
        /// Name of the engine.
        engine: String,
        /// The step.
        step: usize,
        /// Its message.
        error: MemoryError,
    },
}

/// Greatest length, in steps, for engines whose cost per step grows with the length of the run.
const LONGEST_PLAIN_SUM: usize = 1 << 15;

/// Terms of each signal that are compared with the reference.
const COMPARED_TERMS: usize = 50;

const OFFLINE: &str = "offline-fft";

impl<'a> Contender<'a> {
    /// An engine by name, and how it is made for a task.
    pub fn new(name: impl Into<String>, make: impl Fn(Task<'_>) -> Candidate + 'a) -> Self {
        Self { name: name.into(), make: Box::new(make) }
    }

    /// Name of the engine.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The engine for a task.
    ///
    /// # Errors
    /// Error of the engine's constructor.
    pub fn make(&self, task: Task<'_>) -> Candidate {
        (self.make)(task)
    }

    /// One of the project's engines, constructed as for a run of the program.
    pub fn of(engine: Engine) -> Self {
        Self::new(engine.name(), move |task| {
            if engine == Engine::Direct && task.weights.len() > LONGEST_PLAIN_SUM {
                return Ok(None);
            }
            let request = MemoryRequest {
                end: None,
                convolution: &Convolution {
                    family: ConvolutionFamily::Bdf { order: task.order.get() },
                    ..Convolution::default()
                },
                transfer: &TransferFunction::power(task.exponent)?,
                step_size: 1.0,
                coordinates: 1,
                motions: 1,
                samples: task.weights.len(),
                given: false,
                history: &History { engine: Some(engine), ..History::default() },
            };
            Ok(Some(Box::new(request.build()?)))
        })
    }

    /// The engines of the project and the baselines.
    pub fn all() -> Vec<Self> {
        let engines = [
            Engine::ExponentialSum,
            Engine::ExponentialSumCore,
            Engine::BlockFft,
            Engine::RealTime,
            Engine::Direct,
        ];
        let hls = Self::new("hls", |task| {
            let kernel = WeightTable::scalars(task.weights);
            Ok(Some(Box::new(Hls::planned(kernel, 1, task.weights.len())?)))
        });
        let naive = Self::new("naive", |task| {
            if task.weights.len() > LONGEST_PLAIN_SUM {
                return Ok(None);
            }
            let kernel = WeightTable::scalars(task.weights);
            Ok(Some(Box::new(Naive::planned(kernel, 1, task.weights.len())?)))
        });
        engines.into_iter().map(Self::of).chain([hls, naive]).collect()
    }
}

impl Comparison {
    /// Measures all contenders and an offline transform; `progress` receives a description of the current
    /// measurement.
    ///
    /// For each kernel and length, first every engine runs on a smooth signal with noise, a decaying and a
    /// growing one, and a constant, and is compared with a sum in twice the precision. Those runs touch all
    /// memory. Then the engines are timed turn by turn, and the shortest time counts: of whole runs for the
    /// mean, of each step for the distribution.
    ///
    /// # Errors
    /// [`ComparisonError`] if an engine cannot be made or refuses a sample.
    pub fn run(
        &self,
        contenders: &[Contender<'_>],
        progress: &mut dyn FnMut(&str),
    ) -> Result<Vec<EngineMeasurement>, ComparisonError> {
        self.require_room()?;
        let mut measurements = Vec::new();
        for &(order, exponent) in &self.kernels {
            for &length in &self.lengths {
                progress(&format!("order {}, exponent {exponent}, {length} steps", order.get()));
                let mut weights = vec![0.0; length];
                let on_values = ConvolutionWeights::bdf(order, exponent, 1.0)?;
                // The same kernels as in runs.
                let mut source =
                    if exponent >= LEAST_ON_INCREMENTS { on_values.on_increments() } else { on_values };
                source.fill(&mut weights);
                let task = Task { order, exponent, weights: &weights };
                let repetitions =
                    self.repetitions.unwrap_or_else(|| ((1 << 23) / length.max(1)).clamp(5, 50));
                measurements.extend(measure(task, contenders, repetitions)?);
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
        require(length.saturating_mul(RUNNING).saturating_add(kept))
            .map_err(|no_room| ComparisonError::NoRoom { length, no_room })
    }
}

fn measure(
    task: Task<'_>,
    contenders: &[Contender<'_>],
    repetitions: usize,
) -> Result<Vec<EngineMeasurement>, ComparisonError> {
    let length = task.weights.len();
    let measurement = |engine: &str, bytes, max_error_u| EngineMeasurement {
        engine: engine.to_owned(),
        length,
        order: task.order,
        exponent: task.exponent,
        step_mean_ns: f64::INFINITY,
        steps_ns: Vec::new(),
        bytes,
        max_error_u,
    };
    let signals = Signal::ALL.map(|signal| signal.samples::<f64>(1, length));
    let references = signals.each_ref().map(|signal| References::new(task.weights, signal));
    let mut terms = vec![0.0; length];

    let mut offline = OfflineFft::new(WeightTable::scalars(task.weights), length)?;
    let mut error = 0.0f64;
    for (signal, references) in signals.iter().zip(&references) {
        offline.convolve(signal, &mut terms);
        error = error.max(references.largest_error(&terms));
    }
    let mut offline_row = measurement(OFFLINE, offline.bytes(), error);

    let mut engines = Vec::new();
    for contender in contenders {
        let made = contender
            .make(task)
            .map_err(|error| ComparisonError::Making { engine: contender.name.clone(), error })?;
        let Some(mut memory) = made else { continue };
        let mut error = 0.0f64;
        for (signal, references) in signals.iter().zip(&references) {
            memory.clear();
            run(&mut *memory, signal, &mut terms).map_err(|(step, error)| ComparisonError::Memory {
                engine: contender.name.clone(),
                step,
                error,
            })?;
            error = error.max(references.largest_error(&terms));
        }
        let row = measurement(&contender.name, memory.bytes(), error);
        engines.push((memory, row, vec![u32::MAX; length]));
    }

    let signal = &signals[0];
    for _ in 0..repetitions {
        let begin = Instant::now();
        offline.convolve(black_box(signal), &mut terms);
        let nanoseconds = begin.elapsed().as_secs_f64() * 1e9;
        offline_row.step_mean_ns = offline_row.step_mean_ns.min(nanoseconds / length as f64);
        for (memory, row, steps) in &mut engines {
            let failed = |(step, error)| ComparisonError::Memory { engine: row.engine.clone(), step, error };
            memory.clear();
            let begin = Instant::now();
            run(&mut **memory, black_box(signal), &mut terms).map_err(failed)?;
            let nanoseconds = begin.elapsed().as_secs_f64() * 1e9;
            memory.clear();
            run_timed(&mut **memory, signal, &mut terms, steps).map_err(failed)?;
            row.step_mean_ns = row.step_mean_ns.min(nanoseconds / length as f64);
        }
    }
    let clock = clock_nanoseconds();
    let rows = engines.into_iter().map(|(_, mut row, steps)| {
        row.steps_ns = steps.into_iter().map(|step| (f64::from(step) - clock).max(0.0)).collect();
        row.steps_ns.sort_by(f64::total_cmp);
        row
    });
    Ok(std::iter::once(offline_row).chain(rows).collect())
}

/// Feeds `signal` to the memory and stores the memory term before each sample.
fn run(memory: &mut dyn Memory<f64>, signal: &[f64], terms: &mut [f64]) -> Result<(), (usize, MemoryError)> {
    for (k, (sample, term)) in signal.iter().zip(terms).enumerate() {
        memory.next_term(std::slice::from_mut(term)).map_err(|error| (k, error))?;
        memory.push(std::slice::from_ref(sample)).map_err(|error| (k, error))?;
    }
    Ok(())
}

/// Like [`run`], with a clock reading after each step; `steps[k]` keeps the shortest time of step k over all
/// calls, in nanoseconds.
fn run_timed(
    memory: &mut dyn Memory<f64>,
    signal: &[f64],
    terms: &mut [f64],
    steps: &mut [u32],
) -> Result<(), (usize, MemoryError)> {
    let mut before = Instant::now();
    for (k, ((sample, term), step)) in signal.iter().zip(terms).zip(steps).enumerate() {
        memory.next_term(std::slice::from_mut(term)).map_err(|error| (k, error))?;
        memory.push(std::slice::from_ref(sample)).map_err(|error| (k, error))?;
        let now = Instant::now();
        *step = (*step).min(u32::try_from((now - before).as_nanos()).unwrap_or(u32::MAX));
        before = now;
    }
    Ok(())
}

/// Time that reading the clock adds to a step, in nanoseconds.
fn clock_nanoseconds() -> f64 {
    const READINGS: u32 = 1000;
    let reading = || {
        let begin = Instant::now();
        for _ in 0..READINGS {
            black_box(Instant::now());
        }
        begin.elapsed().as_secs_f64() * 1e9 / f64::from(READINGS)
    };
    (0..10).map(|_| reading()).fold(f64::INFINITY, f64::min)
}

/// Memory terms at selected steps, computed in twice the precision.
struct References(Vec<(usize, fvi_fft::baseline::MemoryTerm)>);

impl References {
    fn new(weights: &[f64], signal: &[f64]) -> Self {
        let length = signal.len();
        let stride = length.div_ceil(COMPARED_TERMS).max(1);
        // The first term is an empty sum, in which there is no rounding to measure a transform's by.
        let compared =
            (1..length).filter(|&k| k % stride == stride - 1 || k + 1 == length || k.is_power_of_two());
        Self(compared.map(|k| (k, memory_term(weights, 1, signal, 1, k)[0])).collect())
    }

    fn largest_error(&self, terms: &[f64]) -> f64 {
        let error = |&(k, reference): &(usize, fvi_fft::baseline::MemoryTerm)| {
            let error = (terms[k] - reference.sum).abs();
            if error == 0.0 { 0.0 } else { error / reference.absolute / (f64::EPSILON / 2.0) }
        };
        // A comparison with not-a-number must not pass for agreement.
        self.0.iter().map(error).fold(0.0, |largest, error| if error <= largest { largest } else { error })
    }
}

impl EngineMeasurement {
    /// The step time in nanoseconds that the fraction `part` of the steps does not exceed.
    pub fn step_quantile_ns(&self, part: f64) -> Option<f64> {
        let last = self.steps_ns.len().checked_sub(1)?;
        self.steps_ns.get((part * last as f64).ceil() as usize).copied()
    }
}

/// Writes `engines.csv`, one row per measurement; an offline transform has no single steps.
///
/// # Errors
/// If the file cannot be written.
pub fn write_table(measurements: &[EngineMeasurement], path: &Path) -> Result<(), FileError> {
    write(path, |file| {
        let mut table = csv::Writer::from_writer(file);
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
            let quantile =
                |part| row.step_quantile_ns(part).map_or(String::new(), |time| format!("{time:.1}"));
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
        table.flush()
    })
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
        let rows = comparison(&[1, 32, 700]).run(&Contender::all(), &mut |_| {}).unwrap();
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
        let wrong = Contender::new("wrong", |task| {
            let mut weights = task.weights.to_vec();
            weights[5] *= 1.0 + 1e-9;
            let kernel = WeightTable::scalars(&weights);
            Ok(Some(Box::new(BlockFft::planned(kernel, 1, task.weights.len())?)))
        });
        let rows = comparison(&[500]).run(&[wrong], &mut |_| {}).unwrap();
        assert!(rows[1].max_error_u > 1000.0);
    }

    #[test]
    fn an_engine_that_refuses_a_sample_is_named() {
        let small = Contender::new("small", |task| {
            let kernel = WeightTable::scalars(task.weights);
            Ok(Some(Box::new(BlockFft::planned(kernel, 1, 10)?)))
        });
        let error = comparison(&[20]).run(&[small], &mut |_| {}).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the engine \"small\" failed at step 10: the memory is full: it takes 10 samples"
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
