//! A strategy on a thread of its own, so that a slow, failing or hanging one does not affect the others.

use std::any::Any;
use std::hint::black_box;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::slice;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use fvi_core::{Memory, MemoryError, Real};
use fvi_fft::baseline::OfflineFft;

use crate::strategy::{
    AnyMemory, BuiltStrategy, DOUBLE_ONLY, Declined, Flops, Maker, Measured, Strategy, Task, Trouble,
};

/// Samples of a signal in the precision of the race, step by step, one number for each channel.
#[derive(Debug)]
pub(crate) enum Samples {
    F64(Vec<f64>),
    F32(Vec<f32>),
}

/// One run through a signal.
#[derive(Clone)]
pub(crate) struct Run {
    pub(crate) samples: Arc<Samples>,
    /// Channels whose terms are returned.
    pub(crate) channels: Arc<Vec<usize>>,
}

/// Request to the thread.
enum Job {
    Make(Task),
    /// A run that returns the terms.
    Terms(Run),
    /// Runs with and without clock readings between the steps.
    Times(Run),
}

/// Answer of the thread.
enum Answer {
    Made(BuildOutcome),
    Declined(Declined),
    Terms { terms: Vec<f64>, bytes: Option<usize> },
    Times(Timed),
    Failed(String),
}

/// Times of runs, and the terms that they end with, by which work is seen that is not done while it is timed.
pub(crate) struct Timed {
    /// Mean time of a step without what the thread waited for a processor, and with it.
    pub(crate) mean_ns: f64,
    pub(crate) with_waiting_ns: f64,
    /// Shortest time of each step in nanoseconds, with a reading of the clock, shortest first; empty for what
    /// has no steps.
    pub(crate) steps: Vec<u32>,
    /// Of the wanted channels.
    pub(crate) last: Vec<f64>,
}

/// The strategy made.
pub(crate) struct BuildOutcome {
    pub(crate) setup_ns: f64,
    pub(crate) own_weights: Option<Arc<Vec<f64>>>,
    pub(crate) flops: Flops,
    pub(crate) promises: bool,
}

/// How long a contestant is waited for before `stop` is looked at again.
const GLANCE: Duration = Duration::from_millis(50);
/// How long one that is abandoned has to come to its end.
const GRACE: Duration = Duration::from_millis(500);

/// A strategy in a race.
pub(crate) struct Contestant<'a> {
    pub(crate) name: String,
    stop: &'a AtomicBool,
    jobs: Sender<Job>,
    answers: Receiver<Answer>,
    abandoned: Arc<AtomicBool>,
    limit: Duration,
}

/// Why a contestant leaves the race, as a sentence.
pub(crate) type Left = String;

impl<'a> Contestant<'a> {
    pub(crate) fn new(strategy: &Strategy, limit: Duration, stop: &'a AtomicBool) -> Self {
        let (jobs, to_do) = channel();
        let (done, answers) = channel();
        let abandoned = Arc::new(AtomicBool::new(false));
        let (make, given_up) = (Arc::clone(&strategy.make), Arc::clone(&abandoned));
        // If the thread cannot be created, the first job returns an error.
        let _ = thread::Builder::new()
            .name(strategy.name.clone())
            .spawn(move || serve(&make, &to_do, &done, &given_up));
        Self { name: strategy.name.clone(), stop, jobs, answers, abandoned, limit }
    }

    /// Sends a job of so many runs and waits for the answer, up to the time limit of each or until it is
    /// stopped.
    fn ask(&self, job: Job, runs: u32) -> Result<Answer, Left> {
        if self.jobs.send(job).is_err() {
            return Err("it has died".to_owned());
        }
        let limit = self.limit.saturating_mul(runs);
        let begin = Instant::now();
        while begin.elapsed() < limit && !self.stop.load(Ordering::Relaxed) {
            match self.answers.recv_timeout(GLANCE.min(limit)) {
                Ok(Answer::Failed(reason)) => return Err(reason),
                Ok(answer) => return Ok(answer),
                Err(RecvTimeoutError::Disconnected) => return Err("it has died".to_owned()),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
        self.abandoned.store(true, Ordering::Relaxed);
        // Programs are ended before the lab may end itself.
        let _ = self.answers.recv_timeout(GRACE);
        let seconds = self.limit.as_secs_f64();
        Err(match runs {
            1 => format!("no answer within {seconds:.3} s, the time limit"),
            _ => format!("no answer within {runs} times {seconds:.3} s, the time limit of as many runs"),
        })
    }

    pub(crate) fn make(&self, task: &Task) -> Result<Result<BuildOutcome, Declined>, Left> {
        let abandoned = Arc::clone(&self.abandoned);
        match self.ask(Job::Make(Task { abandoned, ..task.clone() }), 1)? {
            Answer::Made(making) => Ok(Ok(making)),
            Answer::Declined(declined) => Ok(Err(declined)),
            _ => Err("it answered something else".to_owned()),
        }
    }

    /// Terms of the channels in `run`, step by step, and bytes of memory after the run, where they are known.
    pub(crate) fn terms(&self, run: &Run) -> Result<(Vec<f64>, Option<usize>), Left> {
        match self.ask(Job::Terms(run.clone()), 1)? {
            Answer::Terms { terms, bytes } => Ok((terms, bytes)),
            _ => Err("it answered something else".to_owned()),
        }
    }

    pub(crate) fn times(&self, run: &Run) -> Result<Timed, Left> {
        match self.ask(Job::Times(run.clone()), TIMED_RUNS)? {
            Answer::Times(timed) => Ok(timed),
            _ => Err("it answered something else".to_owned()),
        }
    }

    /// Waits until the thread has given its memory back, so that this does not happen while another strategy
    /// is timed; no longer than the time limit, and not for one that is abandoned.
    pub(crate) fn dismiss(self) {
        let Self { jobs, answers, limit, abandoned, .. } = self;
        drop(jobs);
        if !abandoned.load(Ordering::Relaxed) {
            let _ = answers.recv_timeout(limit);
        }
    }
}

/// Message of a panic.
fn words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    format!("it panicked: {}", text.unwrap_or_else(|| "without words".to_owned()))
}

/// What a strategy has made.
struct Made {
    memory: AnyMemory,
    trouble: Option<Trouble>,
    resident: Option<Measured>,
}

fn serve(make: &Maker, jobs: &Receiver<Job>, answers: &Sender<Answer>, abandoned: &AtomicBool) {
    let mut memory: Option<Made> = None;
    while let Ok(job) = jobs.recv() {
        let answer = catch_unwind(AssertUnwindSafe(|| match job {
            Job::Make(task) => {
                let begin = Instant::now();
                let made = make(&task);
                let setup_ns = begin.elapsed().as_secs_f64() * 1e9;
                match made {
                    Ok(BuiltStrategy { memory: any, .. }) if any.channels() != task.channels => {
                        Answer::Failed(format!(
                            "its memory has {} channels instead of {}",
                            any.channels(),
                            task.channels
                        ))
                    }
                    Ok(BuiltStrategy { memory: any, .. }) if any.precision() != task.precision => {
                        Answer::Declined(Declined::sits_out(DOUBLE_ONLY))
                    }
                    Ok(BuiltStrategy { memory: any, own_weights, flops, trouble, resident, promises }) => {
                        memory = Some(Made { memory: any, trouble, resident });
                        Answer::Made(BuildOutcome { setup_ns, own_weights, flops, promises })
                    }
                    Err(declined) => Answer::Declined(declined),
                }
            }
            Job::Terms(run) => with_memory(&mut memory, &run, abandoned, false),
            Job::Times(run) => with_memory(&mut memory, &run, abandoned, true),
        }));
        let answer = answer.unwrap_or_else(|panic| Answer::Failed(words(&*panic)));
        if answers.send(answer).is_err() {
            return;
        }
    }
}

fn with_memory(made: &mut Option<Made>, run: &Run, abandoned: &AtomicBool, timed: bool) -> Answer {
    let Some(Made { memory, trouble, resident }) = made else {
        return Answer::Failed("it has not been made".to_owned());
    };
    let answer = match (memory, &*run.samples) {
        (AnyMemory::F64(memory), Samples::F64(samples)) => {
            answer(&mut **memory, samples, run, abandoned, timed)
        }
        (AnyMemory::F32(memory), Samples::F32(samples)) => {
            answer(&mut **memory, samples, run, abandoned, timed)
        }
        (AnyMemory::Offline(offline), Samples::F64(samples)) => offline_answer(offline, samples, timed),
        _ => Err("its memory is of another precision".to_owned()),
    };
    let answer = answer.map(|answer| match (answer, resident) {
        (Answer::Terms { terms, .. }, Some(resident)) => Answer::Terms { terms, bytes: resident() },
        (answer, _) => answer,
    });
    answer.unwrap_or_else(|reason| {
        let trouble = trouble.as_ref().and_then(|trouble| trouble());
        Answer::Failed(trouble.unwrap_or(reason))
    })
}

/// Number of steps between two checks whether the run has been abandoned.
const STRETCH: usize = 64;

/// Runs of a strategy that is timed: one without readings of the clock between two with them.
const TIMED_RUNS: u32 = 3;

/// Short runs without them are repeated for this long, and their mean is taken.
const REPEATED: Duration = Duration::from_millis(1);

fn answer<T: Real>(
    memory: &mut dyn Memory<T>,
    samples: &[T],
    run: &Run,
    abandoned: &AtomicBool,
    timed: bool,
) -> Result<Answer, String> {
    let channels = memory.channels();
    let mut term = vec![T::zero(); channels];
    let at = |k: usize| move |error| format!("step {k}: {error}");
    if !timed {
        memory.clear();
        let mut terms = Vec::with_capacity(samples.len() / channels * run.channels.len());
        for (k, sample) in samples.chunks_exact(channels).enumerate() {
            memory.next_term(&mut term).map_err(at(k))?;
            memory.push(sample).map_err(at(k))?;
            terms.extend(run.channels.iter().map(|&channel| term[channel].to_f64()));
            if k % STRETCH == 0 && abandoned.load(Ordering::Relaxed) {
                return Err("abandoned".to_owned());
            }
        }
        return Ok(Answer::Terms { terms, bytes: Some(memory.bytes()) });
    }
    let count = samples.len() / channels;
    let mut steps = vec![u32::MAX; count];
    let mut each_step = |memory: &mut dyn Memory<T>, term: &mut [T]| {
        memory.clear();
        let mut before = Instant::now();
        for ((k, sample), step) in samples.chunks_exact(channels).enumerate().zip(&mut steps) {
            memory.next_term(term).map_err(at(k))?;
            memory.push(sample).map_err(at(k))?;
            let now = Instant::now();
            *step = (*step).min(u32::try_from((now - before).as_nanos()).unwrap_or(u32::MAX));
            before = now;
            if k % STRETCH == 0 && abandoned.load(Ordering::Relaxed) {
                return Err("abandoned".to_owned());
            }
        }
        Ok(())
    };
    // The first run of a new memory also brings it into the caches; its slow steps are not the shortest.
    each_step(&mut *memory, &mut term)?;
    let (mean_ns, with_waiting_ns) = repeated(count, || {
        memory.clear();
        let begin = Instant::now();
        for (stretch, samples) in samples.chunks(channels * STRETCH).enumerate() {
            if abandoned.load(Ordering::Relaxed) {
                return Err("abandoned".to_owned());
            }
            steps_of(memory, black_box(samples), &mut term)
                .map_err(|(k, error)| at(stretch * STRETCH + k)(error))?;
        }
        Ok(begin.elapsed())
    })?;
    let last = run.channels.iter().map(|&channel| term[channel].to_f64()).collect();
    each_step(memory, &mut term)?;
    steps.sort_unstable();
    Ok(Answer::Times(Timed { mean_ns, with_waiting_ns, steps, last }))
}

/// Mean time of a step, in nanoseconds, without what the thread waited for a processor, and with it; `run` is
/// a run of `count` steps and returns how long they took.
fn repeated(count: usize, mut run: impl FnMut() -> Result<Duration, String>) -> Result<(f64, f64), String> {
    let waited = waited_ns();
    let (mut elapsed, mut runs) = (Duration::ZERO, 0);
    while runs == 0 || elapsed < REPEATED {
        elapsed += run()?;
        runs += 1;
    }
    let (elapsed_ns, waited_ns) = (elapsed.as_secs_f64() * 1e9, waited_ns() - waited);
    // What was waited is read outside of the elapsed time: where it is more than that, it lies beside it.
    let own_ns = if waited_ns < elapsed_ns { elapsed_ns - waited_ns } else { elapsed_ns };
    let steps = (count * runs) as f64;
    Ok((own_ns / steps, elapsed_ns / steps))
}

/// Steps with the calls of the memory only; an error has the number of its step. One channel, where these
/// calls are all there is, has a loop of its own.
#[inline(never)]
fn steps_of<T: Real>(
    memory: &mut dyn Memory<T>,
    samples: &[T],
    term: &mut [T],
) -> Result<(), (usize, MemoryError)> {
    let mut step = |k: usize, sample: &[T], term: &mut [T]| {
        memory.next_term(term).map_err(|error| (k, error))?;
        memory.push(sample).map_err(|error| (k, error))
    };
    if let [term] = term {
        let mut samples = samples.iter().enumerate();
        return samples.try_for_each(|(k, x)| step(k, slice::from_ref(x), slice::from_mut(term)));
    }
    let mut samples = samples.chunks_exact(term.len()).enumerate();
    samples.try_for_each(|(k, sample)| step(k, sample, term))
}

/// The offline transform, a lower bound of the cost, takes all samples at once, so that single steps have no
/// times.
fn offline_answer(offline: &mut OfflineFft, samples: &[f64], timed: bool) -> Result<Answer, String> {
    let mut terms = vec![0.0; samples.len()];
    let mut run = || {
        let begin = Instant::now();
        offline.convolve(black_box(samples), &mut terms);
        Ok(begin.elapsed())
    };
    // The first run also brings the memory for the terms into being.
    run()?;
    let times = if timed { Some(repeated(samples.len(), run)?) } else { None };
    // The first sum is empty; the transform has the rounding of all others there.
    if let Some(first) = terms.first_mut() {
        *first = 0.0;
    }
    Ok(match times {
        None => Answer::Terms { terms, bytes: Some(offline.bytes()) },
        Some((mean_ns, with_waiting_ns)) => {
            let last = terms.last().map(|&term| vec![term]).unwrap_or_default();
            Answer::Times(Timed { mean_ns, with_waiting_ns, steps: Vec::new(), last })
        }
    })
}

/// How long this thread has been ready and waited for a processor, in nanoseconds, where the system tells
/// (Linux): other work on the machine is no cost of a strategy.
fn waited_ns() -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    told.split_ascii_whitespace().nth(1).and_then(|word| word.parse().ok()).unwrap_or(0.0)
}
