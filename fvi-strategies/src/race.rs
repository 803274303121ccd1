//! One race: errors first, then times in turn.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use fvi_core::Real;
use fvi_fft::baseline::{MemoryTerm, Signal, memory_term};
use fvi_fft::{Engines, WeightTable};

use crate::contestant::{Contestant, Making, Run, Samples};
use crate::plan::{Conditions, Plan};
use crate::precision::Precision;
use crate::record::{Absence, Kind, RaceRecord, Row};
use crate::strategy::{Declined, Flops, Strategy, Task};

/// A strategy that failed, or whose sums were wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundOut {
    /// Name of the strategy.
    pub strategy: String,
    /// Short description of the race.
    pub race: String,
    /// The problem.
    pub reason: String,
}

/// Steps of each signal whose terms are compared with the plain sum in twice the precision; the others are
/// compared with `block-fft`.
const COMPARED_STEPS: usize = 50;
/// Number of channels of these steps that are compared.
const COMPARED_CHANNELS: usize = 3;
/// Errors up to this multiple of u count as rounding and are accepted with any tolerance.
const ROUNDING: f64 = 16.0;
/// A median counts as reliable if half the width of its confidence interval is at most this fraction of it.
pub(crate) const STANDS: f64 = 0.05;

/// A strategy in a race.
pub(crate) struct Runner {
    promises: bool,
    contestant: Contestant,
    making: Making,
    pub(crate) error_u: f64,
    pub(crate) bytes: usize,
    flops: Option<f64>,
    /// The terms that the run which is timed ends with, and how far from them a repetition may be.
    last: Vec<(f64, f64)>,
    /// Mean time of a step in each round without what the thread waited for a processor, in nanoseconds.
    means: Vec<f64>,
    /// The shortest of them with it.
    pub(crate) shortest_ns: f64,
    /// Shortest time of each step, in nanoseconds with a reading of the clock; empty for what has no steps.
    steps: Vec<u32>,
}

/// Results of a race.
pub(crate) struct Measured {
    pub(crate) runners: Vec<Runner>,
    pub(crate) absent: Vec<Absence>,
    rounds: usize,
    clock: f64,
}

/// Runs a race of a plan; `None` if it was stopped.
pub(crate) fn run(
    plan: &Plan,
    task: &Task,
    strategies: &[Strategy],
    stop: &AtomicBool,
) -> Option<RaceRecord> {
    let measured = measure(&plan.conditions(), task, strategies, stop)?;
    let clock = measured.clock;
    let quadrature = task.kernel.quadrature_error(&task.weights);
    let of = |runner: &Runner| match &runner.making.own_weights {
        Some(weights) => task.kernel.quadrature_error(weights),
        None => quadrature,
    };
    Some(RaceRecord {
        kernel: task.kernel.name.clone(),
        length: task.length,
        channels: task.channels,
        precision: task.precision,
        tolerance: task.tolerance,
        rounds: measured.rounds,
        rows: measured
            .runners
            .into_iter()
            .map(|runner| Row { quadrature: of(&runner), ..row(runner, task, clock) })
            .collect(),
        absent: measured.absent,
    })
}

/// First measures the errors of every strategy, then the times, in turn; `None` if it was stopped.
pub(crate) fn measure(
    conditions: &Conditions<'_>,
    task: &Task,
    strategies: &[Strategy],
    stop: &AtomicBool,
) -> Option<Measured> {
    let stopped = || stop.load(Ordering::Relaxed);
    let mut absent = Vec::new();
    let mut leave = |strategy: &str, kind, reason: String| {
        absent.push(Absence { strategy: strategy.to_owned(), kind, reason });
    };
    let mut runners = Vec::new();
    for strategy in strategies {
        if stopped() {
            return None;
        }
        let contestant = Contestant::new(strategy, conditions.limit);
        match contestant.make(task) {
            Ok(Ok(making)) => runners.push(Runner {
                promises: strategy.promises && making.promises,
                contestant,
                making,
                error_u: 0.0,
                bytes: 0,
                flops: None,
                last: Vec::new(),
                means: Vec::new(),
                shortest_ns: f64::INFINITY,
                steps: vec![u32::MAX; task.length],
            }),
            Ok(Err(Declined::SitsOut(reason))) => leave(&strategy.name, Kind::SitsOut, reason),
            Ok(Err(Declined::Failed(reason))) | Err(reason) => leave(&strategy.name, Kind::Failed, reason),
        }
    }

    for (index, &signal) in conditions.signals.iter().enumerate() {
        let compared = Compared::new(task, signal);
        let exact = compared.sums(task, &task.weights).unwrap_or_default();
        let mut own: Vec<(Arc<Vec<f64>>, Sums)> = Vec::new();
        runners = keep(runners, &mut leave, stop, |runner| {
            let (terms, bytes) = runner.contestant.terms(&compared.run)?;
            let exact = match &runner.making.own_weights {
                None => &exact,
                Some(weights) => {
                    let known = own.iter().position(|(known, _)| known == weights);
                    let index = known.unwrap_or_else(|| {
                        // Computing the sums of the task's weights succeeded, so it does for these.
                        let sums = compared.sums(task, weights).unwrap_or_default();
                        own.push((Arc::clone(weights), sums));
                        own.len() - 1
                    });
                    &own[index].1
                }
            };
            let error = exact.largest_error(&terms, compared.run.channels.len(), task.precision.unit())?;
            runner.error_u = runner.error_u.max(error);
            runner.bytes = bytes;
            if index == 0 {
                let known = &exact.all[exact.all.len() - compared.run.channels.len()..];
                let room =
                    |known: &MemoryTerm| (2.0 * error + ROUNDING) * task.precision.unit() * known.absolute;
                let last = &terms[terms.len() - known.len()..];
                runner.last = last.iter().zip(known).map(|(&term, known)| (term, room(known))).collect();
            }
            if runner.flops.is_none() {
                runner.flops = match &runner.making.flops {
                    Flops::Unknown => None,
                    Flops::Counted(operations) => Some(operations.count() as f64 / task.length as f64),
                    Flops::OfAStep(operations) => Some(*operations),
                };
            }
            Ok(())
        })?;
    }

    let run = Compared::new(task, *conditions.signals.first()?).run;
    let begin = Instant::now();
    let (fewest, most) = conditions.rounds;
    let mut rounds = 0;
    while rounds < most && !runners.is_empty() {
        runners = keep(runners, &mut leave, stop, |runner| {
            let steps = std::mem::take(&mut runner.steps);
            let timed = runner.contestant.times(&run, steps)?;
            let other = timed.last.iter().zip(&runner.last);
            if let Some((found, (term, _))) = other
                .into_iter()
                .find(|(found, (term, room))| !((*found - term).abs() <= *room || **found == *term))
            {
                return Err(format!("while it is timed its last term is {found:e}, where it was {term:e}"));
            }
            runner.means.push(timed.mean_ns);
            runner.shortest_ns = runner.shortest_ns.min(timed.with_waiting_ns);
            runner.steps = timed.steps;
            Ok(())
        })?;
        rounds += 1;
        let all_stand = runners.iter().all(|runner| Median::of(&runner.means).stands());
        if rounds >= fewest && (all_stand || begin.elapsed() > conditions.patience) {
            break;
        }
    }
    Some(Measured { runners, absent, rounds, clock: clock_nanoseconds() })
}

/// Calls `act` for every runner and passes those that fail to `leave`; returns the others, or `None` if the
/// race was stopped.
fn keep(
    runners: Vec<Runner>,
    leave: &mut impl FnMut(&str, Kind, String),
    stop: &AtomicBool,
    mut act: impl FnMut(&mut Runner) -> Result<(), String>,
) -> Option<Vec<Runner>> {
    let mut kept = Vec::with_capacity(runners.len());
    for mut runner in runners {
        if stop.load(Ordering::Relaxed) {
            return None;
        }
        match act(&mut runner) {
            Ok(()) => kept.push(runner),
            Err(reason) => leave(&runner.contestant.name, Kind::Failed, reason),
        }
    }
    Some(kept)
}

impl Measured {
    /// Times of the single steps without that of the clock reading, in nanoseconds, shortest first.
    pub(crate) fn steps_ns(&self, runner: &Runner) -> Vec<f64> {
        sorted_steps(&runner.steps, self.clock)
    }
}

impl Runner {
    pub(crate) fn name(&self) -> &str {
        &self.contestant.name
    }
}

fn sorted_steps(steps: &[u32], clock: f64) -> Vec<f64> {
    let mut steps = steps.to_vec();
    steps.sort_unstable();
    steps.into_iter().map(|step| (f64::from(step) - clock).max(0.0)).collect()
}

/// The time that the given fraction of the steps does not exceed; `None` without step times.
pub(crate) fn quantile(sorted: &[f64], part: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    sorted.get((part * last as f64).ceil() as usize).copied()
}

fn row(runner: Runner, task: &Task, clock: f64) -> Row {
    let median = Median::of(&runner.means);
    let steps = sorted_steps(&runner.steps, clock);
    let quantile = |part: f64| quantile(&steps, part).unwrap_or(0.0);
    let allowed = (task.tolerance / task.precision.unit()).max(ROUNDING);
    Row {
        error_u: runner.error_u,
        within: runner.error_u <= allowed,
        promised: runner.promises,
        own_weights: runner.making.own_weights.is_some(),
        mean_ns: median.middle,
        between_ns: (median.low, median.high),
        stands: median.stands(),
        p50_ns: quantile(0.5),
        p999_ns: quantile(0.999),
        worst_ns: quantile(1.0),
        setup_ns: runner.making.setup_ns,
        bytes: runner.bytes,
        flops: runner.flops,
        quadrature: None,
        strategy: runner.contestant.name.clone(),
    }
}

/// A median with its 95 % confidence interval, whose ends are two of the numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Median {
    middle: f64,
    low: f64,
    high: f64,
}

impl Median {
    pub(crate) fn of(numbers: &[f64]) -> Self {
        let mut sorted = numbers.to_vec();
        sorted.sort_by(f64::total_cmp);
        let count = sorted.len();
        let Some(last) = count.checked_sub(1) else {
            return Self { middle: f64::NAN, low: f64::NAN, high: f64::NAN };
        };
        // Ranks of the ends from binomial order statistics, in the normal approximation.
        let half = 0.98 * (count as f64).sqrt();
        let rank = (0.5 * count as f64 - half).floor().max(0.0) as usize;
        let rank = rank.min(last / 2);
        Self {
            middle: 0.5 * (sorted[last / 2] + sorted[count / 2]),
            low: sorted[rank],
            high: sorted[last - rank],
        }
    }

    fn stands(self) -> bool {
        0.5 * (self.high - self.low) <= STANDS * self.middle
    }
}

/// A signal with the channels that are compared.
struct Compared {
    run: Run,
}

/// Reference terms of a signal: in twice the precision at some steps (`exact`), and by `block-fft` at all
/// steps (`all`), step by step, channel by channel; `largest` is the largest Σ|w||x| among the exact ones.
#[derive(Default)]
struct Sums {
    exact: Vec<(usize, MemoryTerm)>,
    all: Vec<MemoryTerm>,
    largest: f64,
}

impl Compared {
    fn new(task: &Task, signal: Signal) -> Self {
        let (length, channels) = (task.length, task.channels);
        let mut chosen: Vec<usize> =
            (0..COMPARED_CHANNELS).map(|part| part * (channels - 1) / (COMPARED_CHANNELS - 1)).collect();
        chosen.dedup();
        let samples = match task.precision {
            Precision::F64 => Samples::F64(signal.samples(channels, length)),
            Precision::F32 => Samples::F32(signal.samples(channels, length)),
        };
        Self { run: Run { samples: Arc::new(samples), channels: Arc::new(chosen) } }
    }

    /// The reference terms for these weights; `None` where `block-fft` refuses the weights.
    fn sums(&self, task: &Task, weights: &[f64]) -> Option<Sums> {
        match &*self.run.samples {
            Samples::F64(samples) => self.sums_of(weights, samples, task.channels),
            Samples::F32(samples) => {
                let weights: Vec<f32> = weights.iter().map(|&weight| weight as f32).collect();
                self.sums_of(&weights, samples, task.channels)
            }
        }
    }

    fn sums_of<T: Real>(&self, weights: &[T], samples: &[T], channels: usize) -> Option<Sums> {
        let chosen = &self.run.channels;
        let rows: Vec<Vec<T>> = chosen
            .iter()
            .map(|&channel| samples.iter().skip(channel).step_by(channels).copied().collect())
            .collect();
        let length = samples.len() / channels;
        let stride = length.div_ceil(COMPARED_STEPS).max(1);
        let mut exact = Vec::new();
        // The first term is an empty sum, in which there is no rounding.
        for k in (1..length).filter(|&k| k % stride == stride - 1 || k + 1 == length || k.is_power_of_two()) {
            let terms = rows.iter().map(|row| memory_term(weights, 1, row, 1, k)[0]);
            exact.extend(terms.enumerate().map(|(channel, term)| (k * rows.len() + channel, term)));
        }
        let wide: Vec<f64> = weights.iter().map(|weight| weight.to_f64()).collect();
        let sizes: Vec<f64> = wide.iter().map(|weight| weight.abs()).collect();
        let mut sum = f64::block_fft(&mut WeightTable::scalars(&wide), rows.len(), length).ok()?;
        let mut absolute = f64::block_fft(&mut WeightTable::scalars(&sizes), rows.len(), length).ok()?;
        let (mut sums, mut absolutes) = (vec![0.0; rows.len()], vec![0.0; rows.len()]);
        let mut all = Vec::with_capacity(length * rows.len());
        for k in 0..length {
            sum.next_term(&mut sums).ok()?;
            absolute.next_term(&mut absolutes).ok()?;
            all.extend(sums.iter().zip(&absolutes).map(|(&sum, &absolute)| MemoryTerm { sum, absolute }));
            let sample: Vec<f64> = rows.iter().map(|row| row[k].to_f64()).collect();
            sum.push(&sample).ok()?;
            absolute.push(&sample.iter().map(|number| number.abs()).collect::<Vec<_>>()).ok()?;
        }
        let largest = exact.iter().fold(0.0_f64, |largest, (_, term)| largest.max(term.absolute));
        Some(Sums { exact, all, largest })
    }
}

impl Sums {
    /// Largest error over Σ|w||x|, in units of u.
    fn largest_error(&self, terms: &[f64], channels: usize, unit: f64) -> Result<f64, String> {
        if terms.len() != self.all.len() {
            return Err(format!("{} terms instead of {}", terms.len(), self.all.len()));
        }
        if let Some(index) = terms.iter().position(|term| !term.is_finite()) {
            let (step, sum) = (index / channels, self.all[index].sum);
            return Err(format!("its term of step {step} is {}, where the sum is {sum:.6e}", terms[index]));
        }
        let error = |term: f64, known: &MemoryTerm| {
            let error = (term - known.sum).abs();
            // Where a term is (nearly) empty, transforms leave rounding errors in proportion to their other
            // terms.
            if error <= unit * self.largest && known.absolute <= unit * self.largest {
                return 0.0;
            }
            error / known.absolute.max(f64::MIN_POSITIVE) / unit
        };
        let exact = self.exact.iter().map(|(index, known)| error(terms[*index], known)).fold(0.0, f64::max);
        let all = terms.iter().zip(&self.all).map(|(&term, known)| error(term, known)).fold(0.0, f64::max);
        // At steps without an exact reference an error counts only if it exceeds the rounding of `block-fft`.
        Ok(if all > 2.0 * exact + 2.0 * ROUNDING { all } else { exact })
    }
}

/// Time that reading the clock adds to a step, in nanoseconds.
fn clock_nanoseconds() -> f64 {
    const READINGS: u32 = 1000;
    let reading = || {
        let begin = Instant::now();
        for _ in 0..READINGS {
            std::hint::black_box(Instant::now());
        }
        begin.elapsed().as_secs_f64() * 1e9 / f64::from(READINGS)
    };
    (0..10).map(|_| reading()).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_median_stands_when_its_interval_is_narrow() {
        let steady: Vec<f64> = (0..20).map(|index| 100.0 + f64::from(index) * 0.2).collect();
        let median = Median::of(&steady);
        assert!(median.stands() && (median.middle - 101.9).abs() < 1e-12, "{median:?}");
        assert!(median.low < median.middle && median.middle < median.high);
        let two_speeds: Vec<f64> = (0..20).map(|index| if index % 2 == 0 { 100.0 } else { 150.0 }).collect();
        assert!(!Median::of(&two_speeds).stands());
        assert!(!Median::of(&[]).stands());
        assert_eq!(Median::of(&[3.0, 1.0, 2.0]).middle, 2.0);
    }
}
