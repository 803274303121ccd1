//! A strategy on a thread of its own, where it may be slow, fail or never come back.

use std::any::Any;
use std::hint::black_box;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use fvi_core::{Memory, Real};
use fvi_fft::baseline::OfflineFft;

use crate::strategy::{AnyMemory, Declined, Flops, Made, Maker, Strategy, Task, Trouble};

/// Samples of a signal, one number for each channel after the other.
#[derive(Debug)]
pub(crate) enum Samples {
    F64(Vec<f64>),
    F32(Vec<f32>),
}

/// One run through a signal.
#[derive(Clone)]
pub(crate) struct Run {
    pub(crate) samples: Arc<Samples>,
    /// Channels whose terms are wanted.
    pub(crate) channels: Arc<Vec<usize>>,
}

/// Request to the thread.
enum Job {
    Make(Task),
    /// A run whose terms are looked at.
    Terms(Run),
    /// A run without a clock in between, and one with it: `steps` keeps the shortest time of each step.
    Times(Run, Vec<u32>),
}

/// Its answer.
enum Answer {
    Made { setup_ns: f64, own_weights: Option<Arc<Vec<f64>>>, flops: Flops },
    Declined(Declined),
    Terms { terms: Vec<f64>, bytes: usize },
    Times { mean_ns: f64, steps: Vec<u32> },
    Failed(String),
}

/// The strategy made.
pub(crate) struct Making {
    pub(crate) setup_ns: f64,
    pub(crate) own_weights: Option<Arc<Vec<f64>>>,
    pub(crate) flops: Flops,
}

/// A strategy in a race.
pub(crate) struct Contestant {
    pub(crate) name: String,
    jobs: Sender<Job>,
    answers: Receiver<Answer>,
    abandoned: Arc<AtomicBool>,
    limit: Duration,
}

/// Why a contestant leaves the race, in words.
pub(crate) type Left = String;

impl Contestant {
    pub(crate) fn new(strategy: &Strategy, limit: Duration) -> Self {
        let (jobs, to_do) = channel();
        let (done, answers) = channel();
        let abandoned = Arc::new(AtomicBool::new(false));
        let (make, given_up) = (Arc::clone(&strategy.make), Arc::clone(&abandoned));
        // A thread that cannot be made is seen by its first job.
        let _ = thread::Builder::new()
            .name(strategy.name.clone())
            .spawn(move || serve(&make, &to_do, &done, &given_up));
        Self { name: strategy.name.clone(), jobs, answers, abandoned, limit }
    }

    /// Asks, and waits no longer than the limit.
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
            Answer::Made { setup_ns, own_weights, flops } => Ok(Ok(Making { setup_ns, own_weights, flops })),
            Answer::Declined(declined) => Ok(Err(declined)),
            _ => Err("it answered something else".to_owned()),
        }
    }

    /// Terms of the wanted channels, step by step, and bytes after the run.
    pub(crate) fn terms(&self, run: &Run) -> Result<(Vec<f64>, usize), Left> {
        match self.ask(Job::Terms(run.clone()))? {
            Answer::Terms { terms, bytes } => Ok((terms, bytes)),
            _ => Err("it answered something else".to_owned()),
        }
    }

    pub(crate) fn times(&self, run: &Run, steps: Vec<u32>) -> Result<(f64, Vec<u32>), Left> {
        match self.ask(Job::Times(run.clone(), steps))? {
            Answer::Times { mean_ns, steps } => Ok((mean_ns, steps)),
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
                    Ok(Made { memory: any, own_weights, flops, trouble }) => {
                        memory = Some((any, trouble));
                        Answer::Made { setup_ns, own_weights, flops }
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

/// Steps between two looks at whether anyone still waits.
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
        for (k, sample) in samples.chunks_exact(channels).enumerate() {
            memory.next_term(&mut term).map_err(at(stretch * STRETCH + k))?;
            memory.push(black_box(sample)).map_err(at(stretch * STRETCH + k))?;
        }
    }
    let elapsed_ns = begin.elapsed().as_secs_f64() * 1e9;
    let waited = waited_ns() - waited;
    let mean_ns = (elapsed_ns - waited).max(0.0) / count as f64;
    memory.clear();
    let mut before = Instant::now();
    for ((k, sample), step) in samples.chunks_exact(channels).enumerate().zip(&mut steps) {
        memory.next_term(&mut term).map_err(at(k))?;
        memory.push(black_box(sample)).map_err(at(k))?;
        let now = Instant::now();
        *step = (*step).min(u32::try_from((now - before).as_nanos()).unwrap_or(u32::MAX));
        before = now;
        if k % STRETCH == 0 && abandoned.load(Ordering::Relaxed) {
            return Err("abandoned".to_owned());
        }
    }
    Ok(Answer::Times { mean_ns, steps })
}

/// The lower bound takes all samples at once, so that no time belongs to a single step.
fn offline_answer(offline: &mut OfflineFft, samples: &[f64], steps: Option<Vec<u32>>) -> Answer {
    let mut terms = vec![0.0; samples.len()];
    let waited = waited_ns();
    let begin = Instant::now();
    offline.convolve(black_box(samples), &mut terms);
    let elapsed_ns = begin.elapsed().as_secs_f64() * 1e9 - (waited_ns() - waited);
    // The first sum is empty; the transform has the rounding of all others there.
    if let Some(first) = terms.first_mut() {
        *first = 0.0;
    }
    match steps {
        None => Answer::Terms { terms, bytes: offline.bytes() },
        Some(_) => Answer::Times { mean_ns: elapsed_ns.max(0.0) / samples.len() as f64, steps: Vec::new() },
    }
}

/// How long this thread has been ready and waited for a processor, in nanoseconds, where the system tells
/// (Linux): other work on the machine is no cost of a strategy.
fn waited_ns() -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    told.split_ascii_whitespace().nth(1).and_then(|word| word.parse().ok()).unwrap_or(0.0)
}
