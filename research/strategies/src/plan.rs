//! The content of a file of strategies.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use fvi_fft::baseline::Signal;
use fvi_scenario::language::InputError;
use fvi_scenario::language::document::{Document, Table, Value};

use crate::kernel::{Kernel, read_kernel};
use crate::pipe::Program;
use crate::precision::Precision;

/// A file of strategies, read and checked.
#[derive(Clone, Debug)]
pub struct Plan {
    pub(crate) title: Option<String>,
    pub(crate) lengths: Vec<usize>,
    pub(crate) channels: Vec<usize>,
    pub(crate) precisions: Vec<Precision>,
    pub(crate) tolerances: Vec<f64>,
    pub(crate) signals: Vec<Signal>,
    /// Names of the strategies that take part; `None`: all.
    pub(crate) strategies: Option<Vec<String>>,
    pub(crate) kernels: Vec<Arc<Kernel>>,
    pub(crate) programs: Vec<Program>,
    pub(crate) rounds: (usize, usize),
    /// Number of processes among which the rounds of each race are divided.
    pub(crate) processes: usize,
    /// Longest time of one run of one strategy.
    pub(crate) limit: Duration,
    /// Time after which a race has no further round.
    pub(crate) patience: Duration,
    pub(crate) text: String,
}

/// How a race is run.
pub(crate) struct Conditions<'a> {
    pub(crate) signals: &'a [Signal],
    /// Smallest and largest number of rounds.
    pub(crate) rounds: (usize, usize),
    /// Longest time of one run of one strategy.
    pub(crate) limit: Duration,
    /// Time of all rounds after which there is no further one.
    pub(crate) patience: Duration,
}

const KEYS: [&str; 14] = [
    "title",
    "lengths",
    "channels",
    "precisions",
    "tolerances",
    "signals",
    "strategies",
    "rounds",
    "processes",
    "seconds",
    "time_limit",
    "parameters",
    "kernel",
    "program",
];

/// Largest length, number of channels, and number of values of a signal.
const LONGEST: usize = 1 << 24;
const MOST_CHANNELS: usize = 1 << 20;
const MOST_NUMBERS: usize = 1 << 28;

impl Plan {
    /// Reads a file; `known` are the names of the strategies that are available besides those of the file.
    ///
    /// # Errors
    /// The first thing in the file that cannot be used, with its place.
    pub fn read(path: &Path, known: &[&str]) -> Result<Self, InputError> {
        Self::of_document(&Document::read(path)?, known)
    }

    pub(crate) fn of_document(document: &Document, known: &[&str]) -> Result<Self, InputError> {
        document.with_root(|root| Self::of_root(&root, document, known))
    }

    fn of_root(root: &Table<'_>, document: &Document, known: &[&str]) -> Result<Self, InputError> {
        root.allow(&KEYS)?;
        let title = root.optional("title").map(|title| title.text().map(str::to_owned)).transpose()?;
        let (lengths, channels, longest) = read_sizes(root)?;
        let precisions = match root.optional("precisions") {
            Some(value) => {
                let names = [("f64", Precision::F64), ("f32", Precision::F32)];
                distinct(&value, |value| value.choice(&names))?
            }
            None => vec![Precision::F64],
        };
        let tolerances = match root.optional("tolerances") {
            Some(value) => distinct(&value, |value| match value.number()? {
                tolerance if (4e-15..=0.1).contains(&tolerance) => Ok(tolerance),
                _ => Err(value.out_of_range("4e-15 ≤ tolerance ≤ 0.1")),
            })?,
            None => vec![1e-12],
        };
        let signals = match root.optional("signals") {
            Some(value) => distinct(&value, |value| value.choice(&SIGNALS))?,
            None => Signal::ALL.to_vec(),
        };
        let programs = match root.optional("program") {
            Some(value) => list(&value, |value| Program::read(&value.table()?, document))?,
            None => Vec::new(),
        };
        let strategies = read_strategies(root, &programs, known)?;
        let rounds = match root.optional("rounds") {
            Some(value) => match list(&value, |value| value.whole(1..=100_000))?[..] {
                [fewest, most] if fewest <= most => (fewest, most),
                _ => return Err(value.out_of_range("the fewest and the most rounds, as [6, 40]")),
            },
            None => (6, 40),
        };
        let processes = match root.optional("processes") {
            Some(value) => match value.whole(1..=100_000)? {
                processes if processes <= rounds.0 => processes,
                _ => return Err(value.out_of_range(format!("at most the fewest rounds, {}", rounds.0))),
            },
            None => 1,
        };
        let (patience, limit) =
            (read_seconds(root, "seconds", 20.0)?, read_seconds(root, "time_limit", 60.0)?);
        let parameters = root.optional("parameters");
        let kernel_list = root.required("kernel")?;
        let kernels = list(&kernel_list, |value| {
            read_kernel(&value.table()?, parameters.as_ref(), longest).map(Arc::new)
        })?;
        for (index, kernel) in kernels.iter().enumerate() {
            if kernels[..index].iter().any(|other| other.name == kernel.name) {
                let value = &kernel_list.list("kernels")?[index];
                return Err(value.table()?.required("name")?.out_of_range("a name that no other kernel has"));
            }
        }
        // The contents of files with weights are part of the text that identifies the plan.
        let mut text = document.text().to_owned();
        for kernel in &kernels {
            text.push_str(&format!("\n# {} {:016x}", kernel.name, kernel.fingerprint()));
        }
        Ok(Self {
            title,
            lengths,
            channels,
            precisions,
            tolerances,
            signals,
            strategies,
            kernels,
            programs,
            rounds,
            processes,
            limit,
            patience,
            text,
        })
    }

    pub(crate) fn conditions(&self) -> Conditions<'_> {
        let Self { signals, rounds, limit, patience, .. } = self;
        Conditions { signals, rounds: *rounds, limit: *limit, patience: *patience }
    }

    /// Number of processes among which the rounds of each race are divided, so that memory is laid anew:
    /// [`Lab::in_process`](crate::Lab::in_process).
    pub fn processes(&self) -> usize {
        self.processes
    }

    /// Number of races: one for each kernel, precision, number of channels, length and tolerance.
    pub fn races(&self) -> usize {
        [
            self.kernels.len(),
            self.precisions.len(),
            self.channels.len(),
            self.lengths.len(),
            self.tolerances.len(),
        ]
        .iter()
        .product()
    }
}

/// The lengths of the runs and their numbers of channels, with the largest length.
fn read_sizes(root: &Table<'_>) -> Result<(Vec<usize>, Vec<usize>, usize), InputError> {
    let lengths = distinct(&root.required("lengths")?, |value| value.whole(1..=LONGEST))?;
    let channels = match root.optional("channels") {
        Some(value) => distinct(&value, |value| value.whole(1..=MOST_CHANNELS))?,
        None => vec![1],
    };
    let longest = lengths.iter().copied().max().unwrap_or(1);
    let most = channels.iter().copied().max().unwrap_or(1);
    if longest.saturating_mul(most) > MOST_NUMBERS {
        let value = root.optional("channels").map_or_else(|| root.required("lengths"), Ok)?;
        return Err(value.out_of_range(format!(
            "at most {MOST_NUMBERS} samples in a run; {longest} steps of {most} channels are more"
        )));
    }
    Ok((lengths, channels, longest))
}

/// The strategies that race; `None` for all. The names of programs are those of no other strategy.
fn read_strategies(
    root: &Table<'_>,
    programs: &[Program],
    known: &[&str],
) -> Result<Option<Vec<String>>, InputError> {
    let is_taken = |index: usize| {
        let name = programs[index].name.as_str();
        known.contains(&name) || programs[..index].iter().any(|other| other.name == name)
    };
    if let Some(index) = (0..programs.len()).find(|&index| is_taken(index)) {
        let value = &root.required("program")?.list("programs")?[index];
        return Err(value.table()?.required("name")?.out_of_range("a name that no other strategy has"));
    }
    let names: Vec<&str> =
        known.iter().copied().chain(programs.iter().map(|program| program.name.as_str())).collect();
    let Some(value) = root.optional("strategies") else { return Ok(None) };
    let chosen = distinct(&value, |value| {
        let name = value.text()?;
        if names.contains(&name) {
            return Ok(name.to_owned());
        }
        let all: Vec<_> = names.iter().map(|name| format!("\"{name}\"")).collect();
        Err(value.out_of_range(all.join(", ")))
    })?;
    Ok(Some(chosen))
}

/// A time in seconds.
fn read_seconds(root: &Table<'_>, key: &str, default: f64) -> Result<Duration, InputError> {
    let Some(value) = root.optional(key) else { return Ok(Duration::from_secs_f64(default)) };
    match value.number()? {
        seconds if seconds > 0.0 && seconds <= 1e6 => Ok(Duration::from_secs_f64(seconds)),
        _ => Err(value.out_of_range("a number of seconds > 0 and at most 1e6")),
    }
}

pub(crate) const SIGNALS: [(&str, Signal); 4] = [
    ("stationary", Signal::Stationary),
    ("decaying", Signal::Decaying),
    ("growing", Signal::Growing),
    ("constant", Signal::Constant),
];

/// A list that is not empty, and in which nothing is twice.
fn distinct<R: PartialEq>(
    value: &Value<'_>,
    read: impl Fn(&Value<'_>) -> Result<R, InputError>,
) -> Result<Vec<R>, InputError> {
    let all = list(value, read)?;
    match (0..all.len()).find(|&index| all[..index].contains(&all[index])) {
        Some(index) => Err(value.list("a list")?[index].out_of_range("each entry once")),
        None => Ok(all),
    }
}

/// A list that is not empty.
fn list<R>(
    value: &Value<'_>,
    read: impl Fn(&Value<'_>) -> Result<R, InputError>,
) -> Result<Vec<R>, InputError> {
    let values = value.list("a list")?;
    if values.is_empty() {
        return Err(value.out_of_range("a list with at least one entry"));
    }
    values.iter().map(read).collect()
}
