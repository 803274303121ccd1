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

use crate::strategy::{AnyMemory, Declined, Flops, Made, Maker, Strategy, Task, Trouble};

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
    /// A run without and one with clock readings between the steps; the vector keeps the shortest time of
    /// each step, in nanoseconds.
    Times(Run, Vec<u32>),
}

/// Answer of the thread.
enum Answer {
    Made(Making),
    Declined(Declined),
    Terms { terms: Vec<f64>, bytes: usize },
    Times(Timed),
    Failed(String),
}

/// Times of a run, and the terms that it ends with, by which work is seen that is not done while it is timed.
pub(crate) struct Timed {
    /// Mean time of a step without what the thread waited for a processor, and with it.
    pub(crate) mean_ns: f64,
    pub(crate) with_waiting_ns: f64,
    pub(crate) steps: Vec<u32>,
    /// Of the wanted channels.
    pub(crate) last: Vec<f64>,
}

/// The strategy made.
pub(crate) struct Making {
    pub(crate) setup_ns: f64,
    pub(crate) own_weights: Option<Arc<Vec<f64>>>,
    pub(crate) flops: Flops,
    pub(crate) promises: bool,
}

/// A strategy in a race.
pub(crate) struct Contestant {
    pub(crate) name: String,
    jobs: Sender<Job>,
    answers: Receiver<Answer>,
    abandoned: Arc<AtomicBool>,
    limit: Duration,
}

/// Why a contestant leaves the race, as a sentence.
pub(crate) type Left = String;

impl Contestant {
    pub(crate) fn new(strategy: &Strategy, limit: Duration) -> Self {
        let (jobs, to_do) = channel();
        let (done, answers) = channel();
        let abandoned = Arc::new(AtomicBool::new(false));
        let (make, given_up) = (Arc::clone(&strategy.make), Arc::clone(&abandoned));
        // If the thread cannot be created, the first job returns an error.
        let _ = thread::Builder::new()
            .name(strategy.name.clone())
            .spawn(move || serve(&make, &to_do, &done, &given_up));
        Self { name: strategy.name.clone(), jobs, answers, abandoned, limit }
    }

    /// Sends a job and waits for the answer up to the time limit.
    fn ask(&self, job: Job) -> Result<Answer, Left> {
        if self.jobs.send(job).is_err() {
            return Err("it has died".to_owned());
        }
        match self.answers.recv_timeout(self.limit) {
            Ok(Answer::Failed(reason)) => Err(reason),
            Ok(answer) => Ok(answer),
            Err(RecvTimeoutError::Disconnected) => Err("it has died".to_owned()),
            Err(RecvTimeoutError::Timeout) => {
                self.abandoned.store(true, Ordering::Relaxed);
                Err(format!("no answer within {:.3} s, the time limit", self.limit.as_secs_f64()))
            }
        }
    }

    pub(crate) fn make(&self, task: &Task) -> Result<Result<Making, Declined>, Left> {
        match self.ask(Job::Make(task.clone()))? {
            Answer::Made(making) => Ok(Ok(making)),
            Answer::Declined(declined) => Ok(Err(declined)),
            _ => Err("it answered something else".to_owned()),
        }
    }

    /// Terms of the channels in `run`, step by step, and bytes of memory after the run.
    pub(crate) fn terms(&self, run: &Run) -> Result<(Vec<f64>, usize), Left> {
        match self.ask(Job::Terms(run.clone()))? {
            Answer::Terms { terms, bytes } => Ok((terms, bytes)),
            _ => Err("it answered something else".to_owned()),
        }
    }

    pub(crate) fn times(&self, run: &Run, steps: Vec<u32>) -> Result<Timed, Left> {
        match self.ask(Job::Times(run.clone(), steps))? {
            Answer::Times(timed) => Ok(timed),
            _ => Err("it answered something else".to_owned()),
        }
    }
}

impl Drop for Contestant {
    fn drop(&mut self) {
        self.abandoned.store(true, Ordering::Relaxed);
    }
}

/// Message of a panic.
fn words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    format!("it panicked: {}", text.unwrap_or_else(|| "without words".to_owned()))
}

fn serve(make: &Maker, jobs: &Receiver<Job>, answers: &Sender<Answer>, abandoned: &AtomicBool) {
    let mut memory: Option<(AnyMemory, Option<Trouble>)> = None;
    while let Ok(job) = jobs.recv() {
        let answer = catch_unwind(AssertUnwindSafe(|| match job {
            Job::Make(task) => {
                let begin = Instant::now();
                let made = make(&task);
                let setup_ns = begin.elapsed().as_secs_f64() * 1e9;
                match made {
                    Ok(Made { memory: any, .. }) if any.channels() != task.channels => Answer::Failed(
                        format!("its memory has {} channels instead of {}", any.channels(), task.channels),
                    ),
                    Ok(Made { memory: any, own_weights, flops, trouble, promises }) => {
                        memory = Some((any, trouble));
                        Answer::Made(Making { setup_ns, own_weights, flops, promises })
                    }
                    Err(declined) => Answer::Declined(declined),
                }
            }
            Job::Terms(run) => with_memory(&mut memory, &run, abandoned, None),
            Job::Times(run, steps) => with_memory(&mut memory, &run, abandoned, Some(steps)),
        }));
        let answer = answer.unwrap_or_else(|panic| Answer::Failed(words(&*panic)));
        if answers.send(answer).is_err() {
            return;
        }
    }
}

fn with_memory(
    memory: &mut Option<(AnyMemory, Option<Trouble>)>,
    run: &Run,
    abandoned: &AtomicBool,
    steps: Option<Vec<u32>>,
) -> Answer {
    let Some((memory, trouble)) = memory else { return Answer::Failed("it has not been made".to_owned()) };
    let answer = match (&mut *memory, &*run.samples) {
        (AnyMemory::F64(memory), Samples::F64(samples)) => {
            answer(&mut **memory, samples, run, abandoned, steps)
        }
        (AnyMemory::F32(memory), Samples::F32(samples)) => {
            answer(&mut **memory, samples, run, abandoned, steps)
        }
        (AnyMemory::Offline(offline), Samples::F64(samples)) => Ok(offline_answer(offline, samples, steps)),
        _ => Err("its memory is of another precision".to_owned()),
    };
    answer.unwrap_or_else(|reason| {
        let trouble = trouble.as_ref().and_then(|trouble| trouble());
        Answer::Failed(trouble.unwrap_or(reason))
    })
}

/// Number of steps between two checks whether the run has been abandoned.
const STRETCH: usize = 64;

fn answer<T: Real>(
    memory: &mut dyn Memory<T>,
    samples: &[T],
    run: &Run,
    abandoned: &AtomicBool,
    steps: Option<Vec<u32>>,
) -> Result<Answer, String> {
    let channels = memory.channels();
    let mut term = vec![T::zero(); channels];
    let at = |k: usize| move |error| format!("step {k}: {error}");
    let Some(mut steps) = steps else {
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
        return Ok(Answer::Terms { terms, bytes: memory.bytes() });
    };
    memory.clear();
    let count = samples.len() / channels;
    let waited = waited_ns();
    let begin = Instant::now();
    for (stretch, samples) in samples.chunks(channels * STRETCH).enumerate() {
        if abandoned.load(Ordering::Relaxed) {
            return Err("abandoned".to_owned());
        }
        steps_of(memory, black_box(samples), &mut term)
            .map_err(|(k, error)| at(stretch * STRETCH + k)(error))?;
    }
    let elapsed_ns = begin.elapsed().as_secs_f64() * 1e9;
    let (mean_ns, with_waiting_ns) = of_a_step(elapsed_ns, waited_ns() - waited, count);
    let last = run.channels.iter().map(|&channel| term[channel].to_f64()).collect();
    memory.clear();
    let mut before = Instant::now();
    for ((k, sample), step) in samples.chunks_exact(channels).enumerate().zip(&mut steps) {
        memory.next_term(&mut term).map_err(at(k))?;
        memory.push(sample).map_err(at(k))?;
        let now = Instant::now();
        *step = (*step).min(u32::try_from((now - before).as_nanos()).unwrap_or(u32::MAX));
        before = now;
        if k % STRETCH == 0 && abandoned.load(Ordering::Relaxed) {
            return Err("abandoned".to_owned());
        }
    }
    Ok(Answer::Times(Timed { mean_ns, with_waiting_ns, steps, last }))
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
fn offline_answer(offline: &mut OfflineFft, samples: &[f64], steps: Option<Vec<u32>>) -> Answer {
    let mut terms = vec![0.0; samples.len()];
    let waited = waited_ns();
    let begin = Instant::now();
    offline.convolve(black_box(samples), &mut terms);
    let elapsed_ns = begin.elapsed().as_secs_f64() * 1e9;
    let (mean_ns, with_waiting_ns) = of_a_step(elapsed_ns, waited_ns() - waited, samples.len());
    // The first sum is empty; the transform has the rounding of all others there.
    if let Some(first) = terms.first_mut() {
        *first = 0.0;
    }
    match steps {
        None => Answer::Terms { terms, bytes: offline.bytes() },
        Some(_) => Answer::Times(Timed {
            mean_ns,
            with_waiting_ns,
            steps: Vec::new(),
            last: terms.last().map(|&term| vec![term]).unwrap_or_default(),
        }),
    }
}

/// Time of a step without waiting, and with it. What was waited is read outside of the elapsed time: where
/// it is more than that, it lies beside it.
fn of_a_step(elapsed_ns: f64, waited_ns: f64, count: usize) -> (f64, f64) {
    let own_ns = if waited_ns < elapsed_ns { elapsed_ns - waited_ns } else { elapsed_ns };
    (own_ns / count as f64, elapsed_ns / count as f64)
}

/// How long this thread has been ready and waited for a processor, in nanoseconds, where the system tells
/// (Linux): other work on the machine is no cost of a strategy.
fn waited_ns() -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    told.split_ascii_whitespace().nth(1).and_then(|word| word.parse().ok()).unwrap_or(0.0)
}
