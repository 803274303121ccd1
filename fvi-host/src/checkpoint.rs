//! Checkpoints: a run that was killed or stopped, or has ended, goes on as if there had been no interruption.
//!
//! A generation is two files in the run's directory, `checkpoint.fvi` with the state and
//! `checkpoint.pictures.fvi` with the traces that the pictures are drawn from; the generation before is kept
//! as `checkpoint.previous.fvi` and `checkpoint.previous.pictures.fvi`. They are files of checksummed
//! sections. Both are written to temporary files in the same directory and flushed to the disk before they
//! are renamed, so that one complete generation exists at any moment.

mod identity;
mod interval;

pub(crate) use interval::Timer;
pub use interval::{CheckpointEvery, IntervalError};

use crate::output_sink::{OutputMark, case_directories};
use crate::results::files::{self, FileError};
use crate::results::measure::{ErrorMeasure, Largest};
use crate::results::output_directory::OutputDirectory;
use crate::results::run_traces::RunTraces;
use crate::results::sections::{self, Damage};
use crate::results::trajectory::Format;
use fvi_core::StateError;
use fvi_scenario::scenario::TimeGrid;
use fvi_simulation::simulation::adaptive::Progress as Chosen;
use fvi_simulation::simulation::energy_guard::Gathered;
use fvi_simulation::simulation::events::WatchState;
pub(crate) use identity::{Identity, contents_of_kernels};
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

/// Name of the file with the newest checkpoint.
pub const CHECKPOINT: &str = "checkpoint.fvi";
/// Name of the file with the checkpoint before the newest.
pub const PREVIOUS: &str = "checkpoint.previous.fvi";
const PICTURES: &str = "checkpoint.pictures.fvi";
const PREVIOUS_PICTURES: &str = "checkpoint.previous.pictures.fvi";

/// First bytes of a checkpoint; a transfer in text mode would change the line ends in them and be detected.
const MAGIC: [u8; 8] = *b"fvi\r\n\x1a\nC";
const PICTURES_MAGIC: [u8; 8] = *b"fvi\r\n\x1a\nP";
const FORMAT: u32 = 8;

/// Why a run cannot continue from the checkpoints in its directory. No file has been changed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// There are checkpoints, and none of them is complete.
    #[error(
        "{newest}; {previous}: no checkpoint is left to go on from; without `--resume` the run begins anew"
    )]
    Damaged {
        /// What is wrong with the newest checkpoint.
        newest: String,
        /// What is wrong with the checkpoint before it.
        previous: String,
    },
    /// The checkpoint is of another run.
    #[error("{file} belongs to another run: {}; `--out` names another directory, and without `--resume` the run begins anew", .differences.join("; "))]
    OtherRun {
        /// The checkpoint.
        file: String,
        /// Name of the value that differs.
        differences: Vec<String>,
    },
    /// The checkpoint is of another machine or version, whose bits differ.
    #[error(
        "{file} was written elsewhere, and the run would go on with other bits: {}; `--accept-other-machine` goes on all the same",
        .differences.join("; ")
    )]
    OtherMachine {
        /// The checkpoint.
        file: String,
        /// Name of the value that differs.
        differences: Vec<String>,
    },
    /// The checkpoint lies beyond the end that is now requested.
    #[error(
        "{file} is of step {steps}, beyond the end at step {end}: `--steps` or `--until` name a later end"
    )]
    BeyondEnd {
        /// The checkpoint.
        file: String,
        /// Number of steps made at the checkpoint.
        steps: usize,
        /// Number of steps requested.
        end: usize,
    },
    /// The state does not fit the simulation.
    #[error("{file}: {source}")]
    State {
        /// The checkpoint.
        file: String,
        /// Error of the memory or the integrator.
        source: StateError,
    },
}

/// How far a run has got, apart from its state and its pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Progress {
    pub(crate) steps: usize,
    /// Marks of the files of each load case; a single one without load cases.
    pub(crate) files: Vec<OutputMark>,
    /// The names of the load cases, whose directories the files lie in.
    pub(crate) cases: Vec<String>,
    /// Largest energy so far of each load case.
    pub(crate) largest_energies: Vec<f64>,
    pub(crate) newton_iterations: u64,
    pub(crate) newton_iterations_most: u32,
    pub(crate) overruns: Option<usize>,
    pub(crate) preparation_seconds: f64,
    pub(crate) seconds: f64,
    pub(crate) largest: Largest,
    /// Errors of position, momentum and energy against the reference, and the number of undefined values of
    /// the reference.
    pub(crate) errors: ([ErrorMeasure; 3], usize),
    pub(crate) guard: Gathered,
    /// State of the event watch.
    pub(crate) events: WatchState,
    /// State of the step-size control, for adaptive steps.
    pub(crate) chosen: Option<Chosen>,
    /// Machines and program versions that made earlier steps, where their rounding may differ from this
    /// one's.
    pub(crate) elsewhere: Vec<String>,
}

impl Progress {
    /// The format of the trajectories.
    pub(crate) fn format(&self) -> Format {
        self.files.first().map_or_else(Format::default, |mark| mark.trajectory.format)
    }
}

/// A complete checkpoint, read from the disk.
pub(crate) struct Checkpoint {
    pub(crate) identity: Identity,
    pub(crate) progress: Progress,
    pub(crate) state: Vec<u8>,
    /// Traces of each load case; a single entry without load cases.
    pub(crate) traces: Vec<RunTraces>,
    /// Notes for the summary about the origin of the checkpoint, such as a damaged newer one.
    pub(crate) notes: Vec<String>,
    pub(crate) generations: Generations,
    file: String,
}

/// Which files of a directory belong to the checkpoint in use, so that writing the next one does not
/// overwrite them: for state and pictures, whether it is the file without `previous` in its name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Generations {
    /// The newest generation is the file without `previous` in its name.
    state: bool,
    pictures: bool,
}

impl Checkpoint {
    /// The newest complete checkpoint of a directory whose trajectory contains the rows up to it; `None` if
    /// there is no checkpoint.
    ///
    /// # Errors
    /// [`CheckpointError::Damaged`].
    pub(crate) fn find(directory: &OutputDirectory) -> Result<Option<Self>, CheckpointError> {
        let newest = match Self::read(directory, CHECKPOINT) {
            Ok(checkpoint) => return Ok(Some(checkpoint)),
            Err(reason) => reason,
        };
        let previous = match Self::read(directory, PREVIOUS) {
            Ok(mut checkpoint) => {
                checkpoint.generations.state = false;
                let gone = newest
                    .unwrap_or_else(|| format!("{} is not there", directory.join(CHECKPOINT).display()));
                checkpoint
                    .notes
                    .push(format!("{gone}: the run goes on from the checkpoint before, {}", checkpoint.file));
                return Ok(Some(checkpoint));
            }
            Err(reason) => reason,
        };
        match (newest, previous) {
            (None, None) => Ok(None),
            (newest, previous) => {
                let none = |name: &str| format!("{} is not there", directory.join(name).display());
                let newest = newest.unwrap_or_else(|| none(CHECKPOINT));
                Err(CheckpointError::Damaged { newest, previous: previous.unwrap_or_else(|| none(PREVIOUS)) })
            }
        }
    }

    /// Reads the checkpoint in the file `name`. The error describes the damage; it is `None` if there is no
    /// such file.
    fn read(directory: &OutputDirectory, name: &str) -> Result<Self, Option<String>> {
        let path = directory.join(name);
        let damaged =
            |reason: &dyn std::fmt::Display| Some(format!("{} is damaged: {reason}", path.display()));
        let bytes = match fs::read(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(None),
            bytes => bytes.map_err(|error| damaged(&error))?,
        };
        let (identity, progress, state) = parse(&bytes).map_err(|error| damaged(&error))?;
        let coordinates = progress.largest.position.len();
        let found = [(PICTURES, true), (PREVIOUS_PICTURES, false)].into_iter().find_map(|(name, newest)| {
            let bytes = fs::read(directory.join(name)).ok()?;
            let pictures = parse_pictures(&bytes, progress.steps, coordinates).ok()?;
            (pictures.len() == progress.files.len()).then_some((pictures, newest))
        });
        let Some((pictures, newest)) = found else {
            let reason = format!(
                "{} does not hold what belongs to step {}",
                directory.join(PICTURES).display(),
                progress.steps
            );
            return Err(damaged(&reason));
        };
        let directories = case_directories(directory.path(), progress.cases.iter().map(String::as_str));
        if directories.len() != progress.files.len() {
            return Err(damaged(&Unreadable::Content));
        }
        let mut files = directories.iter().zip(&progress.files);
        if let Some(missing) = files.find_map(|(directory, mark)| mark.missing(directory)) {
            return Err(damaged(&missing));
        }
        let generations = Generations { state: true, pictures: newest };
        let file = path.display().to_string();
        Ok(Self { identity, progress, state, traces: pictures, notes: Vec::new(), generations, file })
    }

    /// Returns an error if the checkpoint belongs to another run or, unless `accept` is set, to a machine or
    /// program version with other rounding.
    pub(crate) fn check(
        &mut self,
        wanted: &Identity,
        format: Format,
        grid: &TimeGrid,
        accept: bool,
    ) -> Result<(), CheckpointError> {
        let (file, end) = (self.file.clone(), grid.steps);
        let mut differences = self.identity.differences(wanted);
        let now = self.progress.chosen.as_ref().map_or_else(|| grid.time(self.progress.steps), Chosen::time);
        if let Some(time) = self.identity.missing_time(wanted, now) {
            differences
                .push(format!("`output.times` has {time} here, which is past, and had no such time there"));
        }
        if format != self.progress.format() {
            let (here, there) = (format.file(), self.progress.format().file());
            differences.push(format!("it writes {here} here and wrote {there} there"));
        }
        if !differences.is_empty() {
            return Err(CheckpointError::OtherRun { file, differences });
        }
        if self.progress.steps > end {
            return Err(CheckpointError::BeyondEnd { file, steps: self.progress.steps, end });
        }
        let differences = self.identity.other_machine(wanted);
        if differences.is_empty() {
            return Ok(());
        }
        if !accept {
            return Err(CheckpointError::OtherMachine { file, differences });
        }
        let steps = self.progress.steps;
        self.progress.elsewhere.push(format!(
            "until step {steps} the run was made elsewhere, and its last bits may differ from a run made here: {}",
            differences.join("; ")
        ));
        Ok(())
    }

    /// The error for a state that does not fit the simulation.
    pub(crate) fn misfit(&self, source: StateError) -> CheckpointError {
        CheckpointError::State { file: self.file.clone(), source }
    }
}

/// Why the content of a file is not a valid checkpoint.
#[derive(Debug, thiserror::Error)]
enum Unreadable {
    #[error(transparent)]
    Damage(#[from] Damage),
    #[error("its sections are others")]
    Sections,
    #[error("a section cannot be read")]
    Content,
}

fn parse(bytes: &[u8]) -> Result<(Identity, Progress, Vec<u8>), Unreadable> {
    let sections = sections::read(bytes, MAGIC, FORMAT)?;
    let [
        ([b'w', b'h', b'a', b't'], identity),
        ([b'f', b'a', b'r', b' '], progress),
        ([b's', b't', b'a', b't'], state),
    ] = sections.as_slice()
    else {
        return Err(Unreadable::Sections);
    };
    let identity = serde_json::from_slice(identity).map_err(|_| Unreadable::Content)?;
    let progress = postcard::from_bytes(progress).map_err(|_| Unreadable::Content)?;
    Ok((identity, progress, state.to_vec()))
}

fn parse_pictures(bytes: &[u8], steps: usize, coordinates: usize) -> Result<Vec<RunTraces>, Unreadable> {
    let sections = sections::read(bytes, PICTURES_MAGIC, FORMAT)?;
    let [([b's', b't', b'e', b'p'], step), ([b'p', b'i', b'c', b't'], pictures)] = sections.as_slice() else {
        return Err(Unreadable::Sections);
    };
    if *step != (steps as u64).to_le_bytes() {
        return Err(Unreadable::Content);
    }
    let pictures: Vec<RunTraces> = postcard::from_bytes(pictures).map_err(|_| Unreadable::Content)?;
    let sound = pictures.iter().all(|traces| traces.is_sound(coordinates));
    if sound { Ok(pictures) } else { Err(Unreadable::Content) }
}

/// Entry point for fuzzing: whether these contents of the two files are accepted. It never panics, and
/// allocates no more than a small multiple of their size.
pub fn is_readable(checkpoint: &[u8], pictures: &[u8]) -> bool {
    parse(checkpoint).is_ok_and(|(_, progress, _)| {
        parse_pictures(pictures, progress.steps, progress.largest.position.len()).is_ok()
    })
}

impl Generations {
    /// Writes a checkpoint; the previous newest checkpoint is renamed to [`PREVIOUS`].
    pub(crate) fn write(
        &mut self,
        directory: &OutputDirectory,
        identity: &Identity,
        progress: &Progress,
        state: &[u8],
        pictures: &[&RunTraces],
    ) -> Result<(), FileError> {
        let path = directory.join(CHECKPOINT);
        self.try_write(directory, identity, progress, state, pictures).map_err(FileError::at(&path))
    }

    fn try_write(
        &mut self,
        directory: &OutputDirectory,
        identity: &Identity,
        progress: &Progress,
        state: &[u8],
        pictures: &[&RunTraces],
    ) -> io::Result<()> {
        let place = |name: &str| directory.join(name);
        let traces = postcard::to_allocvec(pictures).map_err(io::Error::other)?;
        let step = (progress.steps as u64).to_le_bytes();
        let mut new_pictures = files::begin(&place(PICTURES))?;
        sections::write(
            &mut new_pictures,
            PICTURES_MAGIC,
            FORMAT,
            &[(*b"step", &step), (*b"pict", &traces)],
        )?;
        let (identity, progress) = (serde_json::to_vec(identity)?, postcard::to_allocvec(progress));
        let progress = progress.map_err(io::Error::other)?;
        let mut new_state = files::begin(&place(CHECKPOINT))?;
        let content: [sections::Section<'_>; 3] =
            [(*b"what", &identity), (*b"far ", &progress), (*b"stat", state)];
        sections::write(&mut new_state, MAGIC, FORMAT, &content)?;
        // No file of a complete generation is renamed before the new generation is on the disk.
        new_pictures.flush()?;
        new_state.flush()?;
        new_pictures.get_mut().sync()?;
        new_state.get_mut().sync()?;
        if std::mem::replace(&mut self.pictures, true) {
            rename(&place(PICTURES), &place(PREVIOUS_PICTURES))?;
        }
        files::commit(new_pictures)?;
        if std::mem::replace(&mut self.state, true) {
            rename(&place(CHECKPOINT), &place(PREVIOUS))?;
        }
        files::commit(new_state)?;
        // Flushing the directory makes the renames durable, on systems that allow it.
        let _ = File::open(directory_of(directory)).and_then(|directory| directory.sync_all());
        Ok(())
    }
}

fn directory_of(directory: &OutputDirectory) -> &Path {
    if directory.path().as_os_str().is_empty() { Path::new(".") } else { directory.path() }
}

/// Renames a file if it exists.
fn rename(from: &Path, to: &Path) -> io::Result<()> {
    match fs::rename(from, to) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        renamed => renamed,
    }
}

/// Removes the checkpoints of an earlier run.
pub(crate) fn remove(directory: &OutputDirectory) -> Result<(), FileError> {
    [CHECKPOINT, PREVIOUS, PICTURES, PREVIOUS_PICTURES]
        .into_iter()
        .try_for_each(|name| files::remove(&directory.join(name)))
}
