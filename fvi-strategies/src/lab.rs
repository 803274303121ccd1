//! Execution of a plan: one race after the other, each recorded when it is done.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use fvi_core::ParameterError;
use fvi_lab::results::files::{FileError, write_text};
use fvi_lab::results::output_directory::OutputDirectory;
use fvi_lab::results::room::{NoRoom, require};
use fvi_scenario::language::InputError;

use crate::front::winners;
use crate::machine::Machine;
use crate::page::{Page, page};
use crate::plan::Plan;
use crate::race::{FoundOut, run};
use crate::record::{Kind, Record};
use crate::strategy::{Strategy, Task};
use crate::{field, project};

/// The available strategies, and races between them.
pub struct Lab {
    strategies: Vec<Strategy>,
}

/// Result of a race.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Everything that was measured.
    pub record: Record,
    /// Number of races of the plan.
    pub races: usize,
    /// Strategies that failed, or whose sums were wrong.
    pub found_out: Vec<FoundOut>,
    /// Where the files are.
    pub directory: PathBuf,
}

/// Why a race was not run.
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
    NoRoom(NoRoom),
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
        Self { strategies: project::strategies().into_iter().chain(field::strategies()).collect() }
    }

    /// Adds a strategy.
    #[must_use]
    pub fn with(mut self, strategy: Strategy) -> Self {
        self.strategies.push(strategy);
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

    /// Runs the races of a plan until `stop` is set; with `resume` those recorded in the directory are not
    /// repeated. `progress` receives the number of races done and a description of the current one.
    ///
    /// The files are rewritten after each race: `strategies.csv`, `strategies.html`, and the record
    /// `strategies.json`; the pictures of the page are written to `pictures` at the end.
    ///
    /// # Errors
    /// [`LabError`]; a failing strategy is not an error but is listed in the summary.
    pub fn race(
        &self,
        plan: &Plan,
        directory: &Path,
        resume: bool,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(usize, &str),
    ) -> Result<Summary, LabError> {
        let programs = plan.programs.iter().map(|program| program.strategy());
        let wanted =
            |strategy: &Strategy| plan.strategies.as_ref().is_none_or(|names| names.contains(&strategy.name));
        let strategies: Vec<Strategy> =
            self.strategies.iter().cloned().chain(programs).filter(wanted).collect();
        require_room(plan, strategies.len())?;
        let output = OutputDirectory::claim(directory)?;
        let machine = Machine::here();
        let mut record = Record { plan: plan.text.clone(), machine, races: Vec::new() };
        if resume {
            record.races = resumed(&output.join(RECORD), &record)?;
        }
        let known = std::mem::take(&mut record.races);
        let mut done = 0;
        'races: for kernel in &plan.kernels {
            for &precision in &plan.precisions {
                for &channels in &plan.channels {
                    for &length in &plan.lengths {
                        let mut weights = None;
                        for &tolerance in &plan.tolerances {
                            let race = known.iter().find(|race| {
                                race.is_of(&kernel.name, length, channels, precision, tolerance)
                            });
                            if let Some(race) = race {
                                record.races.push(race.clone());
                                done += 1;
                                continue;
                            }
                            if stop.load(Ordering::Relaxed) {
                                break 'races;
                            }
                            progress(done, &format!("{}, {length} steps, {channels} channels", kernel.name));
                            let weights =
                                match &weights {
                                    Some(weights) => Arc::clone(weights),
                                    None => {
                                        let made = kernel.weights(length).map_err(|error| {
                                            LabError::Weights { kernel: kernel.name.clone(), length, error }
                                        })?;
                                        Arc::clone(weights.insert(Arc::new(made)))
                                    }
                                };
                            let kernel = Arc::clone(kernel);
                            let task = Task { kernel, weights, length, channels, precision, tolerance };
                            let Some(race) = run(plan, &task, &strategies, stop) else { break 'races };
                            record.races.push(race);
                            done += 1;
                            write(&record, plan, &strategies, &output)?;
                        }
                    }
                }
            }
        }
        progress(done, "");
        let page = write(&record, plan, &strategies, &output)?;
        write_pictures(&page, &output)?;
        let found_out = found_out(&record);
        Ok(Summary { record, races: plan.races(), found_out, directory: directory.to_owned() })
    }
}

fn write(
    record: &Record,
    plan: &Plan,
    strategies: &[Strategy],
    output: &OutputDirectory,
) -> Result<Page, LabError> {
    let failed = |name: &str, error: std::io::Error| FileError { path: output.join(name), source: error };
    let table = record.table().map_err(|error| failed("strategies.csv", error.into()))?;
    let kept = serde_json::to_string(record).map_err(|error| failed(RECORD, error.into()))?;
    write_text(&output.join("strategies.csv"), &table)?;
    let page = page(record, plan, strategies);
    write_text(&output.join("strategies.html"), &page.html)?;
    write_text(&output.join(RECORD), &kept)?;
    Ok(page)
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
fn resumed(path: &Path, wanted: &Record) -> Result<Vec<crate::RaceRecord>, LabError> {
    let refused = |reason: String| LabError::Resume { path: path.to_owned(), reason };
    let text = std::fs::read_to_string(path)
        .map_err(|error| refused(format!("there is nothing to go on from: {error}")))?;
    let found: Record = serde_json::from_str(&text)
        .map_err(|error| refused(format!("this is no record of strategies: {error}")))?;
    if found.plan != wanted.plan {
        return Err(refused(
            "it was measured for another file of strategies; leave out `--resume`".to_owned(),
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

fn found_out(record: &Record) -> Vec<FoundOut> {
    let mut found = Vec::new();
    for race in &record.races {
        for absence in race.absent.iter().filter(|absence| absence.kind == Kind::Failed) {
            let (strategy, reason) = (absence.strategy.clone(), absence.reason.clone());
            found.push(FoundOut { strategy, race: race.words(), reason });
        }
        for row in race.rows.iter().filter(|row| !row.within && row.promised) {
            let error = row.error_u * race.precision.unit();
            let reason = format!("its error is {error:.1e} of Σ|w||x|, more than {:e}", race.tolerance);
            found.push(FoundOut { strategy: row.strategy.clone(), race: race.words(), reason });
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
    let length = plan.lengths.iter().copied().max().unwrap_or(0);
    let channels = plan.channels.iter().copied().max().unwrap_or(0);
    let samples = length.saturating_mul(channels).saturating_mul(OF_A_SAMPLE);
    let all = samples.saturating_add(length.saturating_mul(OF_A_STEP)).saturating_mul(strategies.max(1));
    require(all).map_err(LabError::NoRoom)
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for sentence in winners(&self.record) {
            writeln!(f, "{sentence}")?;
        }
        // Each strategy once, with the first of its races.
        for (index, found) in self.found_out.iter().enumerate() {
            let same = |other: &&FoundOut| other.strategy == found.strategy;
            if self.found_out[..index].iter().any(|other| same(&other)) {
                continue;
            }
            let others = self.found_out[index..].iter().filter(same).count() - 1;
            let others = if others > 0 { format!("; and in {others} more") } else { String::new() };
            writeln!(f, "found out: \"{}\": {} ({}{others})", found.strategy, found.reason, found.race)?;
        }
        write!(f, "{} of {} races in {}", self.record.races.len(), self.races, self.directory.display())
    }
}
