//! One run: from a checked scenario to the files of its output directory.

mod choice;
mod last;
mod portion;

use crate::checkpoint::{self, Checkpoint, CheckpointError, CheckpointEvery, Identity, Progress, Timer};
use crate::gradient::Recording;
use crate::output_sink::{BatchView, OutputMark, OutputSink, StateView};
use crate::results::files::{FileError, remove, write_json};
use crate::results::measure::{Largest, ReferenceErrors};
use crate::results::output_directory::OutputDirectory;
use crate::results::trajectory::Format;
pub use choice::{Choice, Chosen, choose};
use fvi_core::StateError;
use fvi_fft::memory::Engine;
use fvi_fft::memory::Tables;
use fvi_fft::quadrature::starting::starting_condition;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Appearance, Feature, Scenario};
use fvi_simulation::simulation::adaptive::Counts;
use fvi_simulation::simulation::events::{EventRecord, Watch, WatchState};
use fvi_simulation::simulation::motion::{Failure, Motion};
use fvi_simulation::simulation::step_batch::StepBatch;
use fvi_simulation::simulation::{GridState, Precision, Simulation, Solver};
pub(crate) use last::Last;
use portion::Place;
pub use portion::Portion;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// How a run is made.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Output directory; created if it does not exist, and locked against other runs during this one.
    pub directory: PathBuf,
    /// Floating-point precision.
    pub precision: Precision,
    /// Format of the trajectory; `None`: CSV, or that of the checkpoint.
    pub format: Option<Format>,
    /// How often checkpoints are written.
    pub checkpoints: CheckpointEvery,
    /// True if the run continues from the directory's checkpoint, if there is one.
    pub resume: bool,
    /// True if it continues even if rounding may differ between this machine or program version and that of
    /// the checkpoint.
    pub accept_other_machine: bool,
    /// Seconds that the caller has spent on reading the scenario, in which its kernels are examined; a part
    /// of the preparation.
    pub reading_seconds: f64,
}

impl RunOptions {
    /// A run from the start in double precision, with a trajectory in CSV and a checkpoint every minute.
    pub fn new(directory: impl Into<PathBuf>) -> Self {
        Self {
            directory: directory.into(),
            precision: Precision::default(),
            format: None,
            checkpoints: CheckpointEvery::default(),
            resume: false,
            accept_other_machine: false,
            reading_seconds: 0.0,
        }
    }
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "status")]
pub enum RunEnd {
    /// All steps were made.
    Completed,
    /// An event with `action = "stop"` happened.
    Event {
        /// Index of the event in the scenario, from 0.
        event: usize,
        /// Its time.
        time: f64,
    },
    /// The `stop` flag was set.
    Stopped,
    /// A step failed.
    Failed {
        /// The step that failed, from 0: from t_step to t_{step+1}.
        step: usize,
        /// Time at the beginning of that step.
        time: f64,
        /// Why.
        reason: String,
    },
}

/// The record of a run, `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct RunSummary {
    /// How it ended.
    #[serde(flatten)]
    pub end: RunEnd,
    /// Version of the program.
    pub version: &'static str,
    /// Operating system and processor.
    pub platform: String,
    /// Floating-point precision.
    pub precision: Precision,
    /// How the equations of a step were solved.
    pub solver: Solver,
    /// The engine of each damping term.
    pub engine: Vec<Engine>,
    /// For each memory that serves several damping terms: their indices, from 0.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub shared_memory: Vec<Vec<usize>>,
    /// Number of blocks that the `real-time` engine had not finished when they were due; only for that
    /// engine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overruns: Option<usize>,
    /// Bytes of the memories at the end.
    pub memory_bytes: usize,
    /// Seconds for setting up the integrator (elimination order, weights, tables), and for reading the
    /// scenario if the caller has measured it.
    pub preparation_seconds: f64,
    /// Seconds for the steps and for writing the trajectory.
    pub seconds: f64,
    /// Steps made.
    pub steps: usize,
    /// Number of steps requested; `None` for adaptive steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps_wanted: Option<usize>,
    /// Shortest and longest step, on grids with steps of different lengths.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step_lengths: Option<StepLengths>,
    /// Counts of accepted and rejected attempts, for adaptive steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attempts: Option<Attempts>,
    /// Iterations of Newton's method, all steps together.
    pub newton_iterations: u64,
    /// Most iterations in one step.
    pub newton_iterations_most: u32,
    /// The last state.
    pub last: GridState,
    /// The events that have occurred, in order of time.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub events: Vec<EventRecord>,
    /// Largest absolute values.
    pub largest: Largest,
    /// The load cases: each has a directory of this name with files and a summary of its own.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub cases: Vec<String>,
    /// Last and largest energy of each load case.
    #[serde(skip)]
    energies: Vec<(f64, f64)>,
    /// Warnings.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// Errors against the reference.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub errors: Option<ReferenceErrors>,
    /// Condition number of the system of the starting weights, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub starting_condition: Option<f64>,
    /// The files of results beside this one.
    pub files: Vec<&'static str>,
    /// What was chosen for `scheme.kind` = "auto", and why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub choice: Option<Choice>,
    /// The names of coordinates and units, as far as the scenario has them.
    #[serde(flatten)]
    pub appearance: Appearance,
    /// The inputs as used, defaults filled in.
    pub scenario: Scenario,
    /// Notes about the start of the run, such as the checkpoint that it continues from.
    #[serde(skip)]
    pub notes: Vec<String>,
}

/// Range of the lengths of the steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepLengths {
    /// The shortest step.
    pub smallest: f64,
    /// The longest step.
    pub largest: f64,
}

/// Counts of accepted and rejected attempts at adaptive steps, each a pair of steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Attempts {
    /// Number of all attempts.
    pub made: usize,
    /// Number of attempts whose error was too large.
    pub rejected: usize,
}

/// Short form of a [`RunSummary`], without the parts whose length grows with the number of coordinates.
#[derive(Clone, Debug, Serialize)]
pub struct ShortSummary<'a> {
    #[serde(flatten)]
    end: &'a RunEnd,
    steps: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    steps_wanted: Option<usize>,
    warnings: &'a [String],
}

impl RunSummary {
    /// The short form: end, number of steps and warnings, under the same names.
    pub fn in_short(&self) -> ShortSummary<'_> {
        let Self { end, steps, steps_wanted, warnings, .. } = self;
        ShortSummary { end, steps: *steps, steps_wanted: *steps_wanted, warnings }
    }

    /// The record as values of a file; of an equation with `x` in place of positions, and without momenta and
    /// energies.
    ///
    /// # Errors
    /// If a value cannot be written as JSON.
    pub fn record(&self) -> Result<serde_json::Value, serde_json::Error> {
        let mut record = serde_json::to_value(self)?;
        let Some(equation) = &self.scenario.equation else { return Ok(record) };
        let mut in_words = |state: &mut serde_json::Value| {
            let Some(state) = state.as_object_mut() else { return };
            ["momentum", "energy"].iter().for_each(|name| drop(state.remove(*name)));
            let Some(mut position) = state.remove("position") else { return };
            if let Some(numbers) = position.as_array_mut() {
                numbers.truncate(equation.unknowns());
            }
            state.insert("x".to_owned(), position);
        };
        for name in ["last", "largest", "errors"] {
            record.get_mut(name).into_iter().for_each(&mut in_words);
        }
        record["scenario"]["output"].as_object_mut().map(|output| output.remove("momentum"));
        let events = record.get_mut("events").and_then(|events| events.as_array_mut());
        events.into_iter().flatten().for_each(&mut in_words);
        Ok(record)
    }

    /// The record of one load case.
    fn of_case(&self, scenario: &Scenario, case: usize) -> Self {
        let places = scenario.places_of(case);
        let of = |numbers: &[f64]| numbers.get(places.clone()).unwrap_or(&[]).to_vec();
        let (energy, largest_energy) = self.energies.get(case).copied().unwrap_or_default();
        let (last, largest) = (&self.last, &self.largest);
        Self {
            last: GridState {
                position: of(&last.position),
                momentum: of(&last.momentum),
                energy,
                ..last.clone()
            },
            largest: Largest {
                position: of(&largest.position),
                momentum: of(&largest.momentum),
                energy: largest_energy,
            },
            scenario: scenario.case(case),
            ..self.clone()
        }
    }

    /// Removes what is recorded in the summaries of the load cases.
    fn of_all_cases(&mut self) {
        self.cases = self.scenario.cases.iter().map(|case| case.name.clone()).collect();
        for numbers in [
            &mut self.last.position,
            &mut self.last.momentum,
            &mut self.largest.position,
            &mut self.largest.momentum,
        ] {
            numbers.clear();
        }
    }
}

/// Why a run could not be made or recorded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// The scenario cannot be run.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A file cannot be written.
    #[error(transparent)]
    File(#[from] FileError),
    /// It cannot go on from what is in its directory.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// It was stopped before its first step, while a scheme was chosen.
    #[error("stopped while a scheme was chosen")]
    Stopped,
    /// A memory cannot be saved.
    #[error("no checkpoint can be written: {0}")]
    Unsaved(#[from] StateError),
}

/// State of a run at a step, from which another run of the same scenario can continue.
///
/// It contains the state of a checkpoint, without files. The caller must make sure that the scenario is the
/// same, since the caller's code may be part of it.
#[derive(Clone, Debug)]
pub struct RunSnapshot {
    progress: Progress,
    state: Vec<u8>,
    planned: usize,
}

impl RunSnapshot {
    /// Steps made.
    pub fn steps(&self) -> usize {
        self.progress.steps
    }

    /// Bytes of its state.
    pub fn bytes(&self) -> usize {
        self.state.len()
    }

    /// Number of samples for which engines and tables were chosen:
    /// [`History::planned`](fvi_fft::memory::History) of a run that continues.
    pub fn planned(&self) -> usize {
        self.planned
    }
}

/// Name of the file with the record of a run.
const SUMMARY: &str = "summary.json";
/// Runs a scenario and writes its files.
///
/// `stop` ends the run after the current batch of steps; `progress` receives the number of steps made, after
/// each step. Nothing is written when the scenario cannot be run. When a step fails or the run is stopped,
/// what was computed until then is written, and the summary says so. A run with `resume` continues from the
/// directory's checkpoint and leaves the same files as one that was never interrupted.
///
/// # Errors
/// [`RunError`]; a failing step is not an error here but an end, see [`RunEnd`].
pub fn run(
    scenario: &Scenario,
    options: &RunOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize),
) -> Result<RunSummary, RunError> {
    if options.format == Some(Format::Npz) {
        scenario.check_use(Feature::Npz)?;
    }
    let (tables, mut notes) = (Tables::default(), Vec::new());
    let (mut scenario, choice) = settled(scenario, options, &tables, stop)?;
    notes.extend(choice.as_ref().map(Choice::note));
    let mut found = None;
    let mut claimed = None;
    if options.resume {
        if options.directory.is_dir() {
            found = Checkpoint::find(claimed.insert(OutputDirectory::claim(&options.directory)?))?;
        }
        match &found {
            Some(checkpoint) => scenario.history.planned = Some(checkpoint.identity.planned),
            None => notes.push(format!(
                "there is no checkpoint in {}: the run begins at its start",
                options.directory.display()
            )),
        }
    }
    let builder = Run::of(&scenario).precision(options.precision).tables(&tables).chosen(choice.as_ref());
    let mut run = builder.prepared_for(options.reading_seconds).start()?;
    let identity = Identity::new(&scenario, options.precision, run.motion.simulation().engines());
    if let Some(checkpoint) = &mut found {
        let format = options.format.unwrap_or(checkpoint.progress.format());
        checkpoint.check(&identity, format, &scenario.time, options.accept_other_machine)?;
        run.resume(checkpoint.progress.clone(), &checkpoint.state)
            .map_err(|error| checkpoint.misfit(error))?;
    }
    let directory = match claimed {
        Some(directory) => directory,
        None => OutputDirectory::claim(&options.directory)?,
    };
    let (mut sinks, mut generations);
    match found {
        Some(checkpoint) => {
            notes.extend(checkpoint.notes);
            let (marks, traces) = (checkpoint.progress.files, checkpoint.traces);
            sinks = OutputSink::resume_all(&scenario, directory.path(), &marks, traces, run.steps() + 1)?;
            generations = checkpoint.generations;
        }
        None => {
            sinks = OutputSink::open_all(&scenario, directory.path(), options.format.unwrap_or_default())?;
            // Checkpoints of an earlier run do not belong to the rows of this one.
            checkpoint::remove(&directory)?;
            generations = checkpoint::Generations::default();
        }
    }
    let every = options.checkpoints;
    let mut timer = Timer::new(every);
    let mut write_checkpoint = |run: &Run<'_>, sinks: &mut [OutputSink]| {
        let marks = sinks.iter_mut().map(OutputSink::mark).collect::<Result<_, _>>()?;
        let state = run.motion.save()?;
        let traces: Vec<_> = sinks.iter().map(OutputSink::traces).collect();
        generations.write(&directory, &identity, &run.progress(marks), &state, &traces)?;
        sinks.iter_mut().for_each(OutputSink::keep);
        Ok::<_, RunError>(())
    };
    let end = run.go(
        stop,
        |steps| every.steps_to_next(steps),
        |run| {
            for (case, sink) in sinks.iter_mut().enumerate() {
                sink.take(&scenario, run.rows_between(), &run.batch_view(case))?;
            }
            let batch = run.motion.batch();
            (batch.first()..).take(batch.len()).filter(|&steps| steps > 0).for_each(&mut *progress);
            if timer.is_due(run.steps()) && !run.is_ended() {
                let begin = Instant::now();
                write_checkpoint(run, &mut sinks)?;
                timer.written(begin);
            }
            Ok::<_, RunError>(())
        },
    )?;
    let asked = options.resume || every != CheckpointEvery::Minute || timer.has_written();
    let goes_on = match end {
        RunEnd::Completed => asked,
        RunEnd::Stopped => true,
        // A failed step would fail again, and at a terminal event the motion has already passed the end of
        // the run.
        RunEnd::Failed { .. } | RunEnd::Event { .. } => false,
    };
    if goes_on && every != CheckpointEvery::Never {
        write_checkpoint(&run, &mut sinks)?;
    }
    finish(run, end, (sinks, notes), &directory)
}

/// A scenario with its scheme, and how that was chosen if the file asks for it.
fn settled(
    scenario: &Scenario,
    options: &RunOptions,
    tables: &Tables,
    stop: &AtomicBool,
) -> Result<(Scenario, Option<Choice>), RunError> {
    if scenario.automatic.is_none() {
        return Ok((scenario.clone(), None));
    }
    let Chosen { scenario, choice } = choose(scenario, options.precision, tables, stop)?;
    Ok((scenario, Some(choice)))
}

/// Writes the rest of the files of a run that has ended so, and its record with these notes.
fn finish(
    mut run: Run<'_>,
    end: RunEnd,
    (sinks, notes): (Vec<OutputSink>, Vec<String>),
    directory: &OutputDirectory,
) -> Result<RunSummary, RunError> {
    // A summary vouches for the files beside it: the old one is removed before they are replaced, the new one
    // is written last.
    remove(&directory.join(SUMMARY))?;
    if !run.scenario.cases.is_empty() {
        OutputSink::remove_files(directory.path())?;
    }
    run.motion.complete();
    let scenario = run.scenario;
    let without_last_energy = run.motion.batch().lacks_last_energy();
    let mut summary = run.summary(end);
    summary.notes = notes;
    let (mut drawn, mut own_files) = (Ok(()), Vec::new());
    for (case, mut sink) in sinks.into_iter().enumerate() {
        let mut files = Vec::new();
        let of_case = (!scenario.cases.is_empty()).then(|| summary.of_case(scenario, case));
        if of_case.is_some() {
            remove(&sink.directory().join(SUMMARY))?;
        }
        let one = of_case.as_ref().unwrap_or(&summary);
        if without_last_energy {
            sink.take_last_energy(&one.last);
        }
        // The record is written even if a picture cannot be.
        drawn = drawn.and(sink.finish(&one.scenario, &one.last, &mut files)?);
        match of_case {
            Some(mut of_case) => {
                of_case.files = files;
                write_json(&directory.join(&scenario.cases[case].name).join(SUMMARY), &of_case)?;
            }
            None => own_files = files,
        }
    }
    summary.files = own_files;
    if !scenario.cases.is_empty() {
        summary.of_all_cases();
    }
    let path = directory.join(SUMMARY);
    match scenario.equation {
        Some(_) => {
            let record = summary.record().map_err(|error| FileError::at(&path)(error.into()))?;
            write_json(&path, &record)?;
        }
        None => write_json(&path, &summary)?,
    }
    drawn?;
    Ok(summary)
}

/// An event with the output coordinates only.
fn of_written(scenario: &Scenario, happened: &EventRecord) -> EventRecord {
    let GridState { position, momentum, .. } = StateView::from(&happened.state()).shown(scenario);
    EventRecord { position, momentum, ..happened.clone() }
}

/// Warning about events beyond the number that the record holds.
fn events_not_told(seen: &WatchState) -> Vec<String> {
    let undefined =
        seen.undefined.iter().enumerate().filter_map(|(index, since)| since.map(|time| (index, time)));
    let undefined = undefined.map(|(index, time)| {
        format!("`event[{index}].when` is not a number at t = {time}: there, and wherever else it is none, nothing is seen")
    });
    let dropped = (seen.dropped > 0).then(|| {
        format!("{} events more have happened than the {} that are kept", seen.dropped, seen.happened.len())
    });
    undefined.chain(dropped).collect()
}

/// Warns of positions so small that a tolerance relative to `time.scale` says little about them.
fn small_beside_scale(scenario: &Scenario, largest: &Largest) -> Option<String> {
    const SMALL: f64 = 0.01;
    let scale = scenario.time.adaptive()?.scale;
    let most = largest.position.iter().copied().fold(0.0, max_or_nan);
    let what = if scenario.equation.is_some() { "unknown" } else { "position" };
    (most > 0.0 && most < SMALL * scale).then(|| {
        format!(
            "no {what} is larger than {most:.1e}, and `time.tolerance` is relative to `time.scale`, {scale}: give a scale of \
             the size of the {what}s"
        )
    })
}

/// A run that writes no files: its caller receives the states, and the record at the end.
pub struct Run<'s> {
    scenario: &'s Scenario,
    motion: Motion<'s>,
    /// True if the current state has been passed to the caller.
    seen: bool,
    begin: Instant,
    preparation_seconds: f64,
    /// Seconds of the run before it was last resumed.
    seconds: f64,
    /// Overruns of the run before it was last resumed.
    overruns: Option<usize>,
    newton_iterations: u64,
    newton_iterations_most: u32,
    largest: Largest,
    /// Largest energy so far of each load case.
    largest_energies: Vec<f64>,
    errors: ReferenceErrors,
    /// Machines and program versions that made earlier steps, where rounding may differ.
    elsewhere: Vec<String>,
    /// See [`rows_between`](Self::rows_between).
    between: Vec<GridState>,
    /// Number of entries of `output.times` passed so far.
    passed: usize,
    watch: Watch,
    /// The state at the event that has ended the run.
    ended: Option<GridState>,
    /// How its scheme was chosen.
    choice: Option<&'s Choice>,
    /// What its steps leave behind for gradients.
    recording: Option<Recording>,
}

/// How a run begins.
#[derive(Clone, Copy, Debug)]
pub struct RunBuilder<'s, 't> {
    scenario: &'s Scenario,
    precision: Precision,
    tables: Option<&'t Tables>,
    seconds: f64,
    choice: Option<&'s Choice>,
    recorded: Option<usize>,
}

impl<'s, 't> RunBuilder<'s, 't> {
    /// The precision of its arithmetic.
    #[must_use]
    pub fn precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    /// The tables of its memories are shared with other runs.
    #[must_use]
    pub fn tables<'u>(self, tables: &'u Tables) -> RunBuilder<'s, 'u> {
        let Self { scenario, precision, seconds, choice, recorded, .. } = self;
        RunBuilder { scenario, precision, tables: Some(tables), seconds, choice, recorded }
    }

    /// The run keeps its steps for gradients by the parameters of `[sensitivity]`, in stretches of so many
    /// bytes at most, in place of computing sensitivities along with the motion.
    #[must_use]
    pub fn recorded(self, most_bytes: usize) -> Self {
        Self { recorded: Some(most_bytes), ..self }
    }

    /// Adds seconds that its caller spent on preparation to those of the run.
    #[must_use]
    pub fn prepared_for(self, seconds: f64) -> Self {
        Self { seconds, ..self }
    }

    /// The record of how its scheme was chosen, for the summary.
    #[must_use]
    pub fn chosen(self, choice: Option<&'s Choice>) -> Self {
        Self { choice, ..self }
    }

    /// The run before its first step.
    ///
    /// # Errors
    /// If the scenario cannot be run.
    pub fn start(self) -> Result<Run<'s>, InputError> {
        self.start_with(&mut None)
    }

    /// As [`start`](Self::start), with the simulation of a run that [has ended](Run::into_simulation), if
    /// there is one: it is taken, and begins anew. The scenario of that run must differ from this one in the
    /// initial position and momentum and in parameters of expressions only, the precision in nothing.
    ///
    /// # Errors
    /// As [`start`](Self::start); the simulation is then gone.
    pub(crate) fn start_with(self, ended: &mut Option<Simulation>) -> Result<Run<'s>, InputError> {
        let Self { scenario, precision, tables, seconds, choice, recorded } = self;
        let own = Tables::default();
        let tables = tables.unwrap_or(&own);
        let preparation = Instant::now();
        let motion = Motion::reusing(ended.take(), scenario, precision, tables)?;
        let motion = match recorded {
            Some(_) => {
                scenario.check_use(Feature::Gradient)?;
                if precision == Precision::F32 {
                    let with = "a gradient in single precision".to_owned();
                    let allowed = "double precision".to_owned();
                    return Err(scenario.error_at("sensitivity", Problem::Incompatible { with, allowed }));
                }
                motion.recorded()
            }
            None => motion.with_sensitivities(tables)?,
        };
        Ok(Run {
            recording: recorded.map(Recording::new),
            between: Vec::new(),
            passed: 0,
            watch: Watch::new(scenario, motion.state()),
            ended: None,
            choice,
            scenario,
            motion,
            seen: false,
            begin: Instant::now(),
            preparation_seconds: seconds + preparation.elapsed().as_secs_f64(),
            seconds: 0.0,
            overruns: None,
            newton_iterations: 0,
            newton_iterations_most: 0,
            largest: Largest::default(),
            largest_energies: vec![0.0; scenario.cases.len()],
            errors: ReferenceErrors::default(),
            elsewhere: Vec::new(),
        })
    }
}

impl<'s> Run<'s> {
    /// A run of a scenario, all its load cases together, in double precision and with tables of its own
    /// unless the builder is told otherwise.
    pub fn of(scenario: &'s Scenario) -> RunBuilder<'s, 'static> {
        RunBuilder {
            scenario,
            precision: Precision::F64,
            tables: None,
            seconds: 0.0,
            choice: None,
            recorded: None,
        }
    }

    /// Makes all steps, or until one fails, or until the end of the current portion when `stop` is set.
    /// `take` receives them in portions, beginning with the initial state; the last one has no states but a
    /// row, that of the last state, where `[output] every` has passed over it.
    ///
    /// # Errors
    /// Errors of `take`. A failing step is not an error but an end, see [`RunEnd`].
    pub fn drive<E>(
        &mut self,
        stop: &AtomicBool,
        mut take: impl FnMut(&mut Portion<'_>) -> Result<(), E>,
    ) -> Result<RunEnd, E> {
        let (every, on_grid) = (self.scenario.output.every, self.scenario.output.times.is_empty());
        let mut last_is_there = true;
        let mut place = Place::of(self);
        let end = self.go(
            stop,
            |_| usize::MAX,
            |run| {
                let batch = run.motion.batch();
                if on_grid && !batch.is_empty() {
                    last_is_there = batch.multiples(every).last() == Some(batch.len() - 1);
                }
                take(&mut Portion { run, batch, place: &mut place })
            },
        )?;
        self.motion.complete();
        if !last_is_there {
            let none = StepBatch::new(0, true, 1);
            take(&mut Portion { run: self, batch: &none, place: &mut place })?;
        }
        Ok(end)
    }

    /// The record of each load case, or of the one motion without them.
    pub fn summaries(self, end: RunEnd) -> Vec<RunSummary> {
        let scenario = self.scenario;
        let summary = self.summary(end);
        if scenario.cases.is_empty() {
            return vec![summary];
        }
        (0..scenario.copies()).map(|case| summary.of_case(scenario, case)).collect()
    }

    /// Its simulation, with which a run of another member of its batch can start.
    pub(crate) fn into_simulation(self) -> Simulation {
        self.motion.into_simulation()
    }

    /// What its steps have left behind for gradients, if they were to be [recorded](RunBuilder::recorded);
    /// the run keeps nothing.
    pub fn recording(&mut self) -> Option<Recording> {
        self.recording.take()
    }

    /// Steps made.
    pub fn steps(&self) -> usize {
        self.motion.steps()
    }

    /// The current state, or that at the event that has ended the run.
    pub fn state(&self) -> &GridState {
        self.ended.as_ref().unwrap_or(self.motion.state())
    }

    /// True if an event has ended it.
    fn is_ended(&self) -> bool {
        self.ended.is_some()
    }

    /// The current state of one load case, or of the one motion without cases.
    fn view(&self, case: usize) -> StateView<'_> {
        let state = self.state();
        let (places, energy) = match self.motion.energies().get(case) {
            Some(&energy) => (self.scenario.places_of(case), energy),
            None => (0..state.position.len(), state.energy),
        };
        let position = state.position.get(places.clone()).unwrap_or(&[]);
        let momentum = state.momentum.get(places).unwrap_or(&[]);
        let GridState { columns, sensitivities, .. } = state;
        StateView { time: state.time, position, momentum, energy, columns, sensitivities }
    }

    /// The last batch of steps of one load case, or of the one motion without cases.
    fn batch_view(&self, case: usize) -> BatchView<'_> {
        let (batch, energies) = (self.motion.batch(), self.motion.energies());
        match energies.get(case..=case) {
            Some(energy) => BatchView::new(batch, self.scenario.places_of(case), energy),
            None => BatchView::new(batch, 0..self.scenario.coordinates(), batch.energies()),
        }
    }

    /// Makes the steps in batches: after n steps, at most `most(n)` in the next batch; `take` is called after
    /// each batch.
    fn go<E>(
        &mut self,
        stop: &AtomicBool,
        most: impl Fn(usize) -> usize,
        mut take: impl FnMut(&Self) -> Result<(), E>,
    ) -> Result<RunEnd, E> {
        self.begin = Instant::now();
        if !std::mem::replace(&mut self.seen, true) {
            self.observe();
            take(self)?;
        }
        while !self.motion.is_done() {
            if stop.load(Ordering::Relaxed) {
                return Ok(RunEnd::Stopped);
            }
            let made = self.motion.steps();
            let result = self.motion.advance_along(most(made));
            if self.motion.steps() > made {
                self.observe();
                take(self)?;
            }
            if let Err(Failure { step, time, reason }) = result {
                return Ok(RunEnd::Failed { step, time, reason });
            }
            if let (true, Some(&EventRecord { event, time, .. })) =
                (self.is_ended(), self.watch.seen().happened.last())
            {
                return Ok(RunEnd::Event { event, time });
            }
        }
        Ok(RunEnd::Completed)
    }

    /// The states at the entries of `output.times` that the last step has passed; with `output.times` also
    /// the state at the event that has ended the run.
    fn rows_between(&self) -> &[GridState] {
        &self.between
    }

    /// Evaluates the last batch: events and output times within it, errors, largest values. With events or
    /// `output.times` a batch is a single step.
    fn observe(&mut self) {
        if let Some(recording) = &mut self.recording {
            recording.take(&self.motion);
        }
        let (scenario, coordinates) = (self.scenario, self.scenario.coordinates());
        let reference = scenario.reference.as_ref();
        self.between.clear();
        let before = self.watch.time();
        self.look_for_events();
        let now = self.state().time;
        while let Some(&time) = scenario.output.times.get(self.passed)
            && time <= now
        {
            let mut state = self.motion.state().clone();
            self.motion.interpolate(time, &mut state);
            if let Some(known) = reference.and_then(|reference| reference.at_output(time, coordinates)) {
                self.errors.compare(&state, &known);
            }
            self.between.push(state);
            self.passed += 1;
        }
        if let (Some(ended), false) = (&self.ended, scenario.output.times.is_empty())
            && scenario.output.times[..self.passed].last().is_none_or(|&last| last < ended.time)
        {
            self.between.push(ended.clone());
        }
        if let Some(ended) = &self.ended {
            self.motion.show((ended.time > before).then_some(ended));
        }
        let batch = self.motion.batch();
        for &iterations in batch.iterations() {
            self.newton_iterations += u64::from(iterations);
            self.newton_iterations_most = self.newton_iterations_most.max(iterations);
        }
        self.largest.take(batch);
        if !batch.lacks_last_energy() {
            for (largest, &energy) in self.largest_energies.iter_mut().zip(self.motion.energies()) {
                *largest = max_or_nan(*largest, energy.abs());
            }
        }
        let Some(reference) = reference else { return };
        let chosen = scenario.time.adaptive().is_some() || self.ended.is_some();
        let mut state = self.state().clone();
        for index in 0..batch.len() {
            batch.read(index, &mut state);
            let known = match chosen {
                true => reference.at_output(state.time, coordinates),
                false => reference.at_grid_point(batch.first() + index, &scenario.time, coordinates),
            };
            if let Some(known) = known {
                self.errors.compare(&state, &known);
            }
        }
    }

    /// Finds the events in the last step.
    fn look_for_events(&mut self) {
        if self.watch.is_idle() || self.motion.steps() == 0 {
            return;
        }
        let state = self.motion.state().clone();
        self.ended = self.watch.take(&state, |time, place| self.motion.interpolate(time, place));
        if let Some(ended) = &mut self.ended {
            let mut there = ended.clone();
            self.motion.interpolate(ended.time, &mut there);
            ended.columns = there.columns;
        }
    }

    /// The current state, to continue from; `None` where that is not possible: an event has ended the run,
    /// its steps have different lengths, or it computes sensitivities.
    ///
    /// # Errors
    /// [`StateError`] if a memory cannot be saved.
    pub fn snapshot(&self) -> Result<Option<RunSnapshot>, StateError> {
        if self.is_ended() || self.scenario.sensitivity.is_some() || self.scenario.time.grid.is_some() {
            return Ok(None);
        }
        let planned = self.scenario.history.planned.unwrap_or_else(|| self.scenario.samples());
        let (progress, state) = (self.progress(Vec::new()), self.motion.save()?);
        Ok(Some(RunSnapshot { progress, state, planned }))
    }

    /// Approximate size in bytes of the state in [`snapshot`](Self::snapshot).
    pub fn memory_bytes(&self) -> usize {
        self.motion.simulation().memory_bytes()
    }

    /// Continues from the state of another run of the same scenario.
    ///
    /// # Errors
    /// [`StateError`] if the simulation differs; the run must then not be used any more.
    pub fn resume_from(&mut self, snapshot: &RunSnapshot) -> Result<(), StateError> {
        self.resume(snapshot.progress.clone(), &snapshot.state)
    }

    /// Progress of the run, for a checkpoint.
    fn progress(&self, files: Vec<OutputMark>) -> Progress {
        Progress {
            steps: self.steps(),
            files,
            cases: self.scenario.cases.iter().map(|case| case.name.clone()).collect(),
            largest_energies: self.largest_energies.clone(),
            newton_iterations: self.newton_iterations,
            newton_iterations_most: self.newton_iterations_most,
            overruns: self.overruns(),
            preparation_seconds: self.preparation_seconds,
            seconds: self.seconds(),
            largest: self.largest.clone(),
            errors: self.errors.parts(),
            guard: self.motion.gathered(),
            events: self.watch.seen().clone(),
            chosen: self.motion.chosen(),
            elsewhere: self.elsewhere.clone(),
        }
    }

    /// Continues where `progress` and `state` were taken.
    fn resume(&mut self, progress: Progress, state: &[u8]) -> Result<(), StateError> {
        self.motion.resume(progress.steps, state, progress.guard, progress.chosen)?;
        self.seen = true;
        self.preparation_seconds += progress.preparation_seconds;
        self.seconds = progress.seconds;
        self.overruns = progress.overruns;
        self.newton_iterations = progress.newton_iterations;
        self.newton_iterations_most = progress.newton_iterations_most;
        self.largest = progress.largest;
        self.largest_energies = progress.largest_energies;
        self.errors = ReferenceErrors::of_parts(progress.errors);
        self.elsewhere = progress.elsewhere;
        let now = self.motion.state().time;
        self.watch.resume(self.motion.state(), progress.events);
        self.passed = self.scenario.output.times.partition_point(|&time| time <= now);
        Ok(())
    }

    fn overruns(&self) -> Option<usize> {
        match (self.motion.simulation().overruns(), self.overruns) {
            (Some(now), Some(before)) => Some(now + before),
            (now, before) => now.or(before),
        }
    }

    fn seconds(&self) -> f64 {
        self.seconds + self.begin.elapsed().as_secs_f64()
    }

    /// Steps made, events and warnings so far.
    pub fn told(&self) -> (usize, Vec<EventRecord>, Vec<String>) {
        (self.steps(), self.events(), self.warnings())
    }

    fn events(&self) -> Vec<EventRecord> {
        self.watch.seen().happened.iter().map(|happened| of_written(self.scenario, happened)).collect()
    }

    fn warnings(&self) -> Vec<String> {
        let simulation = self.motion.simulation();
        self.scenario
            .warnings()
            .into_iter()
            .chain(simulation.warning().map(str::to_owned))
            .chain(self.errors.warning())
            .chain(self.motion.warning().map(str::to_owned))
            .chain(self.motion.notes())
            .chain(small_beside_scale(self.scenario, &self.largest))
            .chain(events_not_told(self.watch.seen()))
            .chain(self.elsewhere.iter().cloned())
            .collect()
    }

    /// The record of the run, which has ended so.
    pub fn summary(self, end: RunEnd) -> RunSummary {
        self.into_parts(end).0
    }

    /// Its record, and its simulation, with which a run of another member of its batch can start.
    pub(crate) fn into_parts(self, end: RunEnd) -> (RunSummary, Simulation) {
        let (seconds, overruns) = (self.seconds(), self.overruns());
        let (last, events) = (self.state().clone(), self.events());
        let warnings = self.warnings();
        let largest = Largest { energy: max_or_nan(self.largest.energy, last.energy.abs()), ..self.largest };
        let (scenario, motion) = (self.scenario, self.motion);
        let simulation = motion.simulation();
        let summary = RunSummary {
            end,
            version: env!("CARGO_PKG_VERSION"),
            platform: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            precision: simulation.precision(),
            solver: simulation.solver(),
            engine: simulation.engines().to_vec(),
            shared_memory: simulation.shared().to_vec(),
            overruns,
            memory_bytes: simulation.memory_bytes(),
            preparation_seconds: self.preparation_seconds,
            seconds,
            steps: motion.steps(),
            steps_wanted: scenario.time.steps_known(),
            step_lengths: match motion.counts() {
                Some(Counts { smallest, largest, .. }) => {
                    (motion.steps() > 0).then_some(StepLengths { smallest, largest })
                }
                None => scenario.time.grid.as_ref().map(|_| StepLengths {
                    smallest: scenario.time.step,
                    largest: scenario.time.longest_step(),
                }),
            },
            attempts: motion
                .counts()
                .map(|Counts { attempts, rejected, .. }| Attempts { made: attempts, rejected }),
            newton_iterations: self.newton_iterations,
            newton_iterations_most: self.newton_iterations_most,
            last,
            events,
            largest,
            cases: Vec::new(),
            energies: motion
                .energies()
                .iter()
                .zip(self.largest_energies)
                .map(|(&energy, largest)| (energy, max_or_nan(largest, energy.abs())))
                .collect(),
            starting_condition: Some(&scenario.convolution.starting)
                .filter(|exponents| !exponents.is_empty())
                .map(|exponents| starting_condition(exponents))
                .filter(|condition| condition.is_finite()),
            warnings,
            errors: Some(self.errors).filter(ReferenceErrors::any),
            files: Vec::new(),
            choice: self.choice.cloned(),
            appearance: scenario.output.appearance.clone(),
            scenario: scenario.clone(),
            notes: Vec::new(),
        };
        (summary, motion.into_simulation())
    }
}
