//! Execution of a plan: rounds of all its races, each recorded when it is done.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use fvi_core::ParameterError;
use fvi_host::results::files::{FileError, write_text};
use fvi_host::results::output_directory::OutputDirectory;
use fvi_scenario::language::InputError;
use fvi_scenario::language::memory_limit::{OutOfMemory, check_capacity};

use crate::front::winners;
use crate::machine::Machine;
use crate::page::{Page, page};
use crate::plan::Plan;
use crate::race::{Disqualified, begin, is_over, round};
use crate::record::{Kind, RaceRecord, Record};
use crate::strategy::{Strategy, Task};
use crate::table::table;
use crate::{field, project};

/// The available strategies, and races between them.
pub struct Lab {
    strategies: Vec<Strategy>,
    /// Index of this process among those of the plan.
    process: Option<usize>,
}

/// Results of the races of a plan.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Everything that was measured.
    pub record: Record,
    /// Number of races of the plan.
    pub races: usize,
    /// Number of them that have all their rounds.
    pub done: usize,
    /// Strategies that failed, or whose sums were wrong.
    pub found_out: Vec<Disqualified>,
    /// Where the files are.
    pub directory: PathBuf,
}

/// Why races were not run, or their results not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LabError {
    /// The file cannot be used.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A file of results cannot be written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The longest race does not fit into memory.
    #[error("`lengths` and `channels`: {0}")]
    NoRoom(OutOfMemory),
    /// A kernel has no weights at one of the lengths.
    #[error("the kernel \"{kernel}\" has no weights over {length} steps: {error}")]
    Weights {
        /// Its name.
        kernel: String,
        /// Number of steps.
        length: usize,
        /// The problem.
        error: ParameterError,
    },
    /// Two strategies have one name.
    #[error("two strategies are named \"{0}\"")]
    SameName(String),
    /// The plan asks for several processes.
    #[error("`processes = {0}`: begin each of them with `Lab::in_process`, or use `fvi strategies`")]
    Processes(usize),
    /// There is no valid record from which the races can continue.
    #[error("{}: {reason}", .path.display())]
    Resume {
        /// The record.
        path: PathBuf,
        /// The problem with it.
        reason: String,
    },
}

/// Name of the file with the record, from which races continue.
const RECORD: &str = "strategies.json";
const TABLE: &str = "strategies.csv";

/// Shortest time between two writes of the files, and how many times as long as one takes it is at least.
const BETWEEN_WRITES: Duration = Duration::from_secs(1);
const PART_OF_TIME: u32 = 20;

/// Directory of the pictures, which are written when all races are done or stopped.
const PICTURES: &str = "pictures";

impl Default for Lab {
    fn default() -> Self {
        Self::new()
    }
}

impl Lab {
    /// The project's memories and the field's rivals.
    pub fn new() -> Self {
        let strategies = project::strategies().into_iter().chain(field::strategies()).collect();
        Self { strategies, process: None }
    }

    /// Adds a strategy.
    #[must_use]
    pub fn with(mut self, strategy: Strategy) -> Self {
        self.strategies.push(strategy);
        self
    }

    /// The lab in one of the processes that a plan asks for (its key `processes`), counted from 0: it makes the
    /// rounds of this process only. Process 0 begins the races; the others must be told to resume them, one
    /// after the other.
    #[must_use]
    pub fn in_process(mut self, index: usize) -> Self {
        self.process = Some(index);
        self
    }

    /// Reads and checks a file of strategies.
    ///
    /// # Errors
    /// The first thing in it that cannot be used, with its place.
    pub fn plan(&self, path: &Path) -> Result<Plan, LabError> {
        let names: Vec<&str> = self.strategies.iter().map(Strategy::name).collect();
        for (index, name) in names.iter().enumerate() {
            if names[..index].contains(name) {
                return Err(LabError::SameName((*name).to_owned()));
            }
        }
        Ok(Plan::read(path, &names)?)
    }

    /// Reads a file of strategies, runs its races and writes to a directory.
    ///
    /// # Errors
    /// [`LabError`]; a failing strategy is not an error but is listed in the summary.
    pub fn run(&self, plan: &Path, directory: &Path) -> Result<Summary, LabError> {
        let plan = self.plan(plan)?;
        self.race(&plan, directory, false, &AtomicBool::new(false), &mut |_, _| {})
    }

    /// Runs the races of a plan until `stop` is set; with `resume` it continues with the rounds that those
    /// recorded in the directory still lack, where otherwise results in it are replaced. Every race has its
    /// first round before any has its second: the rounds of a race lie as far apart as the plan is long, so
    /// that its medians are not those of a minute in which the machine was slower. `progress` receives the
    /// number of rounds done, and of those that are needed as far as is known.
    ///
    /// The record `strategies.json`, `strategies.csv` and `strategies.html` are rewritten after rounds, every
    /// second at most, and at the end; the pictures of the page are written to `pictures` at the end.
    ///
    /// # Errors
    /// [`LabError`]; a failing strategy is not an error but is listed in the summary.
    pub fn race(
        &self,
        plan: &Plan,
        directory: &Path,
        resume: bool,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Summary, LabError> {
        let most_here = self.rounds_by_now(plan)?;
        let programs = plan.programs.iter().map(|program| program.strategy());
        let wanted =
            |strategy: &Strategy| plan.strategies.as_ref().is_none_or(|names| names.contains(&strategy.name));
        let strategies: Vec<Strategy> =
            self.strategies.iter().cloned().chain(programs).filter(wanted).collect();
        require_room(plan, strategies.len())?;
        let tasks = tasks(plan)?;
        let output = OutputDirectory::claim(directory)?;
        let mut record =
            Record { plan: identity(plan, &strategies), machine: Machine::here(), races: Vec::new() };
        let mut races: Vec<Option<RaceRecord>> = vec![None; tasks.len()];
        if resume {
            let known = resumed(&output.join(RECORD), &record)?;
            for (task, race) in tasks.iter().zip(&mut races) {
                *race = known.iter().find(|race| race.is_for(task)).cloned();
            }
        }
        remove_pictures(&output)?;
        let conditions = plan.conditions();
        let (fewest, _) = conditions.rounds;
        let mut begun_here = vec![false; tasks.len()];
        let is_done =
            |race: &Option<RaceRecord>| race.as_ref().is_some_and(|race| is_over(race, &conditions));
        let made = |race: &Option<RaceRecord>| race.as_ref().map_or(0, |race| race.rounds);
        let needed = |race: &Option<RaceRecord>| {
            if is_done(race) { made(race) } else { fewest.max(made(race) + 1) }
        };
        let mut written: Option<(Instant, Duration)> = None;
        'rounds: for number in 0..most_here {
            for index in 0..tasks.len() {
                let (task, known) = (&tasks[index], &races[index]);
                if is_done(known) || made(known) > number {
                    continue;
                }
                progress(races.iter().map(made).sum(), races.iter().map(needed).sum());
                let begun = match known {
                    Some(race) => Some(race.clone()),
                    None => begin(&conditions, task, &strategies, stop),
                };
                let anew = !begun_here[index];
                let next = begun.and_then(|race| {
                    round(&race, &conditions, task, &strategies, stop, anew, &mut |_, _| {})
                });
                let Some(next) = next else { break 'rounds };
                (races[index], begun_here[index]) = (Some(next), true);
                let is_due =
                    |(at, took): (Instant, Duration)| at.elapsed() > BETWEEN_WRITES.max(PART_OF_TIME * took);
                if written.is_none_or(is_due) {
                    let begin = Instant::now();
                    record.races = races.iter().flatten().cloned().collect();
                    write(&record, plan, &strategies, &output)?;
                    written = Some((Instant::now(), begin.elapsed()));
                }
            }
        }
        progress(races.iter().map(made).sum(), races.iter().map(needed).sum());
        let done = races.iter().filter(|race| is_done(race)).count();
        record.races = races.into_iter().flatten().collect();
        let page = write(&record, plan, &strategies, &output)?;
        write_pictures(&page, &output)?;
        let found_out = found_out(&record);
        Ok(Summary { record, races: tasks.len(), done, found_out, directory: directory.to_owned() })
    }
}

impl Lab {
    /// Rounds of a race that are made by the end of this process. Those that are made in any case are divided
    /// among the processes; further ones are made by the last.
    fn rounds_by_now(&self, plan: &Plan) -> Result<usize, LabError> {
        let (fewest, most) = plan.rounds;
        match (plan.processes, self.process) {
            (1, None) => Ok(most),
            (of, Some(index)) if index + 1 == of => Ok(most),
            (of, Some(index)) if index < of => Ok((fewest * (index + 1)).div_ceil(of)),
            (of, _) => Err(LabError::Processes(of)),
        }
    }
}

/// What the record of a plan is known by: its file, the weights of its kernels, the strategies by name, and
/// the programs with what their files contain.
fn identity(plan: &Plan, strategies: &[Strategy]) -> String {
    let names = strategies.iter().map(|strategy| format!("\n# {}", strategy.name));
    let programs =
        plan.programs.iter().map(|program| format!("\n# {} {:016x}", program.name, program.fingerprint()));
    std::iter::once(plan.text.clone()).chain(names).chain(programs).collect()
}

/// The tasks of a plan, whose weights must exist.
fn tasks(plan: &Plan) -> Result<Vec<Task>, LabError> {
    let mut tasks = Vec::with_capacity(plan.races());
    for kernel in &plan.kernels {
        let weights = plan.lengths.iter().map(|&length| match kernel.weights(length) {
            Ok(weights) => Ok((length, Arc::new(weights))),
            Err(error) => Err(LabError::Weights { kernel: kernel.name.clone(), length, error }),
        });
        let weights = weights.collect::<Result<Vec<_>, _>>()?;
        for &precision in &plan.precisions {
            for &channels in &plan.channels {
                for (length, weights) in &weights {
                    tasks.extend(plan.tolerances.iter().map(|&tolerance| Task {
                        kernel: Arc::clone(kernel),
                        weights: Arc::clone(weights),
                        length: *length,
                        channels,
                        precision,
                        tolerance,
                        abandoned: Arc::default(),
                    }));
                }
            }
        }
    }
    Ok(tasks)
}

/// Writes the record, the table and the page.
fn write(
    record: &Record,
    plan: &Plan,
    strategies: &[Strategy],
    output: &OutputDirectory,
) -> Result<Page, LabError> {
    let failed = |name: &str, source: std::io::Error| FileError { path: output.join(name), source };
    let columns = table(record).map_err(|error| failed(TABLE, error.into()))?;
    let kept = serde_json::to_string(record).map_err(|error| failed(RECORD, error.into()))?;
    write_text(&output.join(TABLE), &columns)?;
    let page = page(record, plan, strategies);
    write_text(&output.join("strategies.html"), &page.html)?;
    write_text(&output.join(RECORD), &kept)?;
    Ok(page)
}

/// Removes the pictures of an earlier run, which may be of other races.
fn remove_pictures(output: &OutputDirectory) -> Result<(), LabError> {
    let directory = output.join(PICTURES);
    let failed = |source| FileError { path: directory.clone(), source };
    if !directory.is_dir() {
        return Ok(());
    }
    for entry in std::fs::read_dir(&directory).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.extension().is_some_and(|ending| ending == "svg") {
            std::fs::remove_file(&path).map_err(|source| FileError { path, source })?;
        }
    }
    Ok(())
}

/// The pictures of the page as files.
fn write_pictures(page: &Page, output: &OutputDirectory) -> Result<(), LabError> {
    let directory = output.join(PICTURES);
    std::fs::create_dir_all(&directory).map_err(|source| FileError { path: directory.clone(), source })?;
    for picture in &page.pictures {
        write_text(&directory.join(format!("{}.svg", picture.name)), &picture.content())?;
    }
    Ok(())
}

/// The races of a record, which must belong to the same file and machine.
fn resumed(path: &Path, wanted: &Record) -> Result<Vec<RaceRecord>, LabError> {
    let refused = |reason: String| LabError::Resume { path: path.to_owned(), reason };
    let text = std::fs::read_to_string(path)
        .map_err(|error| refused(format!("there is nothing to go on from: {error}")))?;
    let found: Record = serde_json::from_str(&text)
        .map_err(|error| refused(format!("this is no record of strategies: {error}")))?;
    if found.plan != wanted.plan {
        return Err(refused(
            "it was measured for another file of strategies, or other strategies or programs; leave out `--resume`"
                .to_owned(),
        ));
    }
    if found.machine != wanted.machine {
        return Err(refused(format!(
            "it was measured elsewhere ({}, {}), and times of two machines cannot stand side by side",
            found.machine.processor, found.machine.compiler
        )));
    }
    Ok(found.races)
}

fn found_out(record: &Record) -> Vec<Disqualified> {
    let mut found = Vec::new();
    for race in &record.races {
        for absence in race.absent.iter().filter(|absence| absence.kind == Kind::Failed) {
            let (strategy, reason) = (absence.strategy.clone(), absence.reason.clone());
            found.push(Disqualified { strategy, race: race.words(), reason });
        }
        for row in race.rows.iter().filter(|row| !row.within && row.promised) {
            let error = row.error_u * race.precision.unit();
            let reason = format!("its error is {error:.1e} of Σ|w||x|, more than {:e}", race.tolerance);
            found.push(Disqualified { strategy: row.strategy.clone(), race: race.words(), reason });
        }
    }
    found
}

/// Refuses races for which the strategies, all at once, would not fit into memory.
fn require_room(plan: &Plan, strategies: usize) -> Result<(), LabError> {
    // Samples, terms, spectra of samples and of weights, times of the single steps: an upper estimate for the
    // largest of the strategies.
    const OF_A_SAMPLE: usize = 64;
    const OF_A_STEP: usize = 80;
    const OF_A_WEIGHT: usize = 8;
    let length = plan.lengths.iter().copied().max().unwrap_or(0);
    let channels = plan.channels.iter().copied().max().unwrap_or(0);
    let samples = length.saturating_mul(channels).saturating_mul(OF_A_SAMPLE);
    let all = samples.saturating_add(length.saturating_mul(OF_A_STEP)).saturating_mul(strategies.max(1));
    let weights = plan.lengths.iter().fold(0_usize, |sum, &length| sum.saturating_add(length));
    let weights = weights.saturating_mul(plan.kernels.len()).saturating_mul(OF_A_WEIGHT);
    check_capacity(all.saturating_add(weights)).map_err(LabError::NoRoom)
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for sentence in winners(&self.record) {
            writeln!(f, "{sentence}")?;
        }
        // Each strategy once, with the first of its races.
        for (index, found) in self.found_out.iter().enumerate() {
            let same = |other: &&Disqualified| other.strategy == found.strategy;
            if self.found_out[..index].iter().any(|other| same(&other)) {
                continue;
            }
            let others = self.found_out[index..].iter().filter(same).count() - 1;
            let others = if others > 0 { format!("; and in {others} more") } else { String::new() };
            writeln!(f, "found out: \"{}\": {} ({}{others})", found.strategy, found.reason, found.race)?;
        }
        let rows = || self.record.races.iter().flat_map(|race| &race.rows);
        let (all, restless) = (rows().count(), rows().filter(|row| !row.stands).count());
        if restless > 0 {
            writeln!(f, "{restless} of {all} medians do not stand to 5 %")?;
        }
        write!(f, "{} of {} races in {}", self.done, self.races, self.directory.display())
    }
}
