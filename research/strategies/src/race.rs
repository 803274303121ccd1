//! One race: errors first, then rounds of times.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use fvi_core::{Real, min_or_nan};
use fvi_fft::baseline::{MemoryTerm, Signal, memory_term};
use fvi_fft::sums::max_or_nan;
use fvi_fft::{Engines, WeightTable};

use crate::contestant::{BuildOutcome, Contestant, Run, Samples, Timed};
use crate::plan::Conditions;
use crate::precision::Precision;
use crate::record::{Absence, Kind, RaceRecord, Row};
use crate::strategy::{Declined, Flops, Strategy, Task};

/// A strategy that failed, or whose sums were wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Disqualified {
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
/// Number of channels that are compared: the first, the last, and those between at equal distances. In runs
/// so long that the known terms would be more than so many numbers they are fewer, but three.
const COMPARED_CHANNELS: usize = 16;
const COMPARED_TERMS: usize = 1 << 22;
/// Errors up to this multiple of u count as rounding and are accepted with any tolerance.
const ROUNDING: f64 = 16.0;
/// A median counts as reliable if half the width of its confidence interval is at most this fraction of it.
pub(crate) const STANDS: f64 = 0.05;

/// A strategy while its errors are measured.
struct Runner<'a> {
    promises: bool,
    contestant: Contestant<'a>,
    making: BuildOutcome,
    error_u: f64,
    bytes: Option<usize>,
    flops: Option<f64>,
    last: Vec<(f64, f64)>,
}

/// Measures the errors of all strategies: a race before its first round; `None` if it was stopped.
pub(crate) fn begin(
    conditions: &Conditions<'_>,
    task: &Task,
    strategies: &[Strategy],
    stop: &AtomicBool,
) -> Option<RaceRecord> {
    let mut absent = Vec::new();
    let mut leave = |strategy: &str, kind, reason: String| {
        absent.push(Absence { strategy: strategy.to_owned(), kind, reason });
    };
    let mut runners = Vec::new();
    for strategy in strategies {
        if stop.load(Ordering::Relaxed) {
            return None;
        }
        let contestant = Contestant::new(strategy, conditions.limit, stop);
        match contestant.make(task) {
            Ok(Ok(making)) => runners.push(Runner {
                promises: strategy.promises && making.promises,
                contestant,
                making,
                error_u: 0.0,
                bytes: None,
                flops: None,
                last: Vec::new(),
            }),
            Ok(Err(Declined::SitsOut(reason))) => leave(&strategy.name, Kind::SitsOut, reason),
            Err(_) if stop.load(Ordering::Relaxed) => return None,
            Ok(Err(Declined::Failed(reason))) | Err(reason) => leave(&strategy.name, Kind::Failed, reason),
        }
    }

    for (index, &signal) in conditions.signals.iter().enumerate() {
        let compared = Compared::new(task, signal);
        let exact = compared.sums(task, &task.weights);
        let mut own: Vec<(Arc<Vec<f64>>, Option<Sums>)> = Vec::new();
        runners = keep(runners, &mut leave, stop, |runner| {
            let (terms, bytes) = runner.contestant.terms(&compared.run)?;
            let exact = match &runner.making.own_weights {
                None => exact.as_ref(),
                Some(weights) => {
                    let known = own.iter().position(|(known, _)| known == weights);
                    let index = known.unwrap_or_else(|| {
                        own.push((Arc::clone(weights), compared.sums(task, weights)));
                        own.len() - 1
                    });
                    own[index].1.as_ref()
                }
            };
            let exact =
                exact.ok_or_else(|| "there are no sums with its weights to compare with".to_owned())?;
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
    let quadrature = task.kernel.quadrature_error(&task.weights);
    let rows = runners.into_iter().map(|runner| {
        let row = row(&runner, task, quadrature);
        runner.contestant.dismiss();
        row
    });
    Some(RaceRecord {
        kernel: task.kernel.name.clone(),
        length: task.length,
        channels: task.channels,
        precision: task.precision,
        tolerance: task.tolerance,
        rounds: 0,
        parts: Vec::new(),
        seconds: 0.0,
        rows: rows.collect(),
        absent,
    })
}

/// The error that is accepted with a tolerance: no less than rounding.
pub(crate) fn allowed(tolerance: f64, precision: Precision) -> f64 {
    tolerance.max(ROUNDING * precision.unit())
}

/// The row of a strategy that has not been timed yet.
fn row(runner: &Runner, task: &Task, quadrature: Option<f64>) -> Row {
    let allowed = allowed(task.tolerance, task.precision) / task.precision.unit();
    let own_weights = runner.making.own_weights.as_ref();
    Row {
        strategy: runner.contestant.name.clone(),
        error_u: runner.error_u,
        within: runner.error_u <= allowed,
        promised: runner.promises,
        own_weights: own_weights.is_some(),
        last: runner.last.clone(),
        rounds_ns: Vec::new(),
        mean_ns: f64::INFINITY,
        between_ns: (f64::INFINITY, f64::INFINITY),
        setups_ns: Vec::new(),
        setup_ns: runner.making.setup_ns,
        total_ns: f64::INFINITY,
        total_between_ns: (f64::INFINITY, f64::INFINITY),
        stands: false,
        p50_ns: f64::INFINITY,
        p999_ns: f64::INFINITY,
        worst_ns: f64::INFINITY,
        bytes: runner.bytes,
        flops: runner.flops,
        quadrature: own_weights.map_or(quadrature, |weights| task.kernel.quadrature_error(weights)),
    }
}

/// Calls `act` for every runner and passes those that fail to `leave`; returns the others, or `None` if the
/// race was stopped.
fn keep<'a>(
    runners: Vec<Runner<'a>>,
    leave: &mut impl FnMut(&str, Kind, String),
    stop: &AtomicBool,
    mut act: impl FnMut(&mut Runner<'a>) -> Result<(), String>,
) -> Option<Vec<Runner<'a>>> {
    let mut kept = Vec::with_capacity(runners.len());
    for mut runner in runners {
        if stop.load(Ordering::Relaxed) {
            return None;
        }
        match act(&mut runner) {
            Ok(()) => kept.push(runner),
            Err(_) if stop.load(Ordering::Relaxed) => return None,
            Err(reason) => {
                leave(&runner.contestant.name, Kind::Failed, reason);
                runner.contestant.dismiss();
            }
        }
    }
    Some(kept)
}

/// The race after a further round, in which each strategy is made anew and timed, one after the other;
/// `timed` receives the times of each. `None` if it was stopped.
///
/// A strategy can be slower in one place of memory than in another, and a machine for a while: rounds vary
/// both, so that the interval of a median covers them. With `anew` it is the first round of another process,
/// in which all memory is laid anew; the interval covers the medians of every process.
pub(crate) fn round(
    race: &RaceRecord,
    conditions: &Conditions<'_>,
    task: &Task,
    strategies: &[Strategy],
    stop: &AtomicBool,
    anew: bool,
    timed: &mut dyn FnMut(&str, &Timed),
) -> Option<RaceRecord> {
    let begin = Instant::now();
    let mut race = race.clone();
    match race.parts.last_mut() {
        Some(last) if !anew => *last += 1,
        _ => race.parts.push(1),
    }
    let run = Compared::new(task, *conditions.signals.first()?).run;
    let clock = clock_nanoseconds();
    let mut rows = Vec::with_capacity(race.rows.len());
    for mut row in race.rows {
        if stop.load(Ordering::Relaxed) {
            return None;
        }
        let strategy = strategies.iter().find(|strategy| strategy.name == row.strategy);
        let timed_now = match strategy {
            Some(strategy) => time(strategy, &row, conditions, task, &run, stop),
            None => Err("it is not there any more".to_owned()),
        };
        match timed_now {
            Ok((times, setup_ns)) => {
                timed(&row.strategy, &times);
                add(&mut row, &times, setup_ns, (clock, race.length, &race.parts));
                rows.push(row);
            }
            Err(_) if stop.load(Ordering::Relaxed) => return None,
            Err(reason) => race.absent.push(Absence {
                strategy: row.strategy,
                kind: Kind::Failed,
                reason: format!("in round {}: {reason}", race.rounds + 1),
            }),
        }
    }
    race.rows = rows;
    race.rounds += 1;
    race.seconds += begin.elapsed().as_secs_f64();
    Some(race)
}

/// Makes a strategy and times it; the second number is the time to make it, in nanoseconds.
fn time(
    strategy: &Strategy,
    row: &Row,
    conditions: &Conditions<'_>,
    task: &Task,
    run: &Run,
    stop: &AtomicBool,
) -> Result<(Timed, f64), String> {
    let contestant = Contestant::new(strategy, conditions.limit, stop);
    let timed = match contestant.make(task) {
        Ok(Ok(making)) => contestant.times(run).map(|timed| (timed, making.setup_ns)),
        Ok(Err(Declined::SitsOut(reason))) => Err(format!("it declined, as it did not before: {reason}")),
        Ok(Err(Declined::Failed(reason))) | Err(reason) => Err(reason),
    };
    contestant.dismiss();
    let (timed, setup_ns) = timed?;
    let mut pairs = timed.last.iter().zip(&row.last);
    let other = pairs.find(|(found, (term, room))| !((*found - term).abs() <= *room || **found == *term));
    match other {
        Some((found, (term, _))) => {
            Err(format!("while it is timed its last term is {found:e}, where it was {term:e}"))
        }
        None => Ok((timed, setup_ns)),
    }
}

/// Adds the times of a round to a row, with the time of reading the clock, the length of a run, and how many
/// rounds each process has made.
fn add(row: &mut Row, timed: &Timed, setup_ns: f64, (clock, length, parts): (f64, usize, &[usize])) {
    row.rounds_ns.push(timed.mean_ns);
    row.setups_ns.push(setup_ns);
    let median = Median::of_processes(&row.rounds_ns, parts);
    row.mean_ns = median.middle;
    row.between_ns = (median.low, median.high);
    row.setup_ns = Median::of(&row.setups_ns).middle;
    let totals = row.setups_ns.iter().zip(&row.rounds_ns).map(|(setup, mean)| setup + length as f64 * mean);
    let total = Median::of_processes(&totals.collect::<Vec<_>>(), parts);
    row.total_ns = total.middle;
    row.total_between_ns = (total.low, total.high);
    row.stands = median.stands() && total.stands();
    let steps = steps_ns(&timed.steps, clock);
    let shorter = |known: f64, part: f64| known.min(quantile(&steps, part).unwrap_or(0.0));
    row.p50_ns = shorter(row.p50_ns, 0.5);
    row.p999_ns = shorter(row.p999_ns, 0.999);
    row.worst_ns = shorter(row.worst_ns, 1.0);
}

/// True if a race needs no further round: the fewest are made, and every median stands, the time is over, or
/// there are no more rounds.
pub(crate) fn is_over(race: &RaceRecord, conditions: &Conditions<'_>) -> bool {
    let (fewest, most) = conditions.rounds;
    let long = || race.seconds >= conditions.patience.as_secs_f64();
    race.rounds >= most || race.rounds >= fewest && (race.rows.iter().all(|row| row.stands) || long())
}

/// Times of single steps without that of the clock reading.
pub(crate) fn steps_ns(steps: &[u32], clock: f64) -> Vec<f64> {
    steps.iter().map(|&step| (f64::from(step) - clock).max(0.0)).collect()
}

/// The time that the given fraction of the steps does not exceed; `None` without step times.
pub(crate) fn quantile(sorted: &[f64], part: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    sorted.get((part * last as f64).ceil() as usize).copied()
}

/// A median with its 95 % confidence interval, whose ends are two of the numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Median {
    count: usize,
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
            return Self { count, middle: f64::NAN, low: f64::NAN, high: f64::NAN };
        };
        let rank = rank_of_interval(count);
        Self {
            count,
            middle: 0.5 * (sorted[last / 2] + sorted[count / 2]),
            low: sorted[rank],
            high: sorted[last - rank],
        }
    }

    /// The same for numbers of several processes, the first `parts[0]` of the first one and so on: the
    /// interval holds the median of each as well, since what differs between processes repeats in all numbers
    /// of one.
    pub(crate) fn of_processes(numbers: &[f64], parts: &[usize]) -> Self {
        let mut median = Self::of(numbers);
        let mut rest = numbers;
        for &count in parts {
            let (part, others) = rest.split_at(count.min(rest.len()));
            rest = others;
            if !part.is_empty() {
                let middle = Self::of(part).middle;
                (median.low, median.high) = (min_or_nan(median.low, middle), max_or_nan(median.high, middle));
            }
        }
        median
    }

    /// True if it is known to 5 %; of fewer than six numbers no interval holds the median with 95 %.
    fn stands(self) -> bool {
        self.count >= 6 && 0.5 * (self.high - self.low) <= STANDS * self.middle
    }
}

/// The largest rank r, from 0, for which the median of a distribution lies beyond all but r of `count`
/// numbers at either end with a probability of 5 % at most; 0 if there is none. The number B of them that lie
/// below it is binomial.
fn rank_of_interval(count: usize) -> usize {
    if count > 1000 {
        // The probabilities below are too small to be added up, and B is nearly normal.
        return (0.5 * count as f64 - 0.98 * (count as f64).sqrt()) as usize;
    }
    let (mut rank, mut term, mut beyond) = (0, 0.5f64.powi(i32::try_from(count).unwrap_or(i32::MAX)), 0.0);
    // term = P(B = rank), beyond = P(B < rank)
    while rank + 1 < count {
        beyond += term;
        term *= (count - rank) as f64 / (rank + 1) as f64;
        if 2.0 * (beyond + term) > 0.05 {
            break;
        }
        rank += 1;
    }
    rank
}

/// A signal with the channels that are compared.
struct Compared {
    run: Run,
}

/// Reference terms of a signal: in twice the precision at some steps (`exact`), and by `block-fft` at all
/// steps (`all`), step by step, channel by channel; `largest` is the largest Σ|w||x| among the exact ones.
struct Sums {
    exact: Vec<(usize, MemoryTerm)>,
    all: Vec<MemoryTerm>,
    largest: f64,
}

impl Compared {
    fn new(task: &Task, signal: Signal) -> Self {
        let (length, channels) = (task.length, task.channels);
        let most = (COMPARED_TERMS / length).clamp(3, COMPARED_CHANNELS);
        let mut chosen: Vec<usize> = (0..most).map(|part| part * (channels - 1) / (most - 1)).collect();
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
        let largest = exact.iter().map(|(_, term)| term.absolute).fold(0.0, max_or_nan);
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
        let exact = self.exact.iter().map(|(index, known)| error(terms[*index], known)).fold(0.0, max_or_nan);
        let all = terms.iter().zip(&self.all).map(|(&term, known)| error(term, known)).fold(0.0, max_or_nan);
        // At steps without an exact reference an error counts only if it exceeds the rounding of `block-fft`.
        let error = if all <= 2.0 * exact + 2.0 * ROUNDING { exact } else { all };
        if error.is_finite() { Ok(error) } else { Err("the sums to compare with are not finite".to_owned()) }
    }
}

/// Time that reading the clock adds to a step, in nanoseconds.
pub(crate) fn clock_nanoseconds() -> f64 {
    const READINGS: u32 = 1000;
    let reading = || {
        let begin = Instant::now();
        for _ in 0..READINGS {
            std::hint::black_box(Instant::now());
        }
        begin.elapsed().as_secs_f64() * 1e9 / f64::from(READINGS)
    };
    (0..10).map(|_| reading()).fold(f64::INFINITY, min_or_nan)
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
        assert!(Median::of(&[100.0; 6]).stands() && !Median::of(&[100.0; 5]).stands());
    }

    #[test]
    fn an_interval_covers_the_medians_of_all_processes() {
        // Nine rounds of one process, and one of another that is slower by a half as a whole.
        let mut numbers = [20.0; 10];
        numbers[9] = 30.0;
        assert!(Median::of_processes(&numbers, &[10]).stands());
        let two = Median::of_processes(&numbers, &[9, 1]);
        assert_eq!((two.middle, two.low, two.high), (20.0, 20.0, 30.0));
        assert!(!two.stands());
    }

    #[test]
    fn an_interval_misses_the_median_in_one_of_twenty_cases_at_most() {
        // From tables of the sign test: the largest number of signs that is significant at 5 %, two-sided.
        let tables =
            [(6, 0), (8, 0), (9, 1), (11, 1), (12, 2), (15, 3), (20, 5), (25, 7), (40, 13), (100, 39)];
        for (count, rank) in tables {
            assert_eq!(rank_of_interval(count), rank, "{count} rounds");
        }
        assert!(rank_of_interval(1000).abs_diff(rank_of_interval(1001)) <= 1);
        assert!(!Median::of(&[]).stands());
        assert_eq!(Median::of(&[3.0, 1.0, 2.0]).middle, 2.0);
    }
}
