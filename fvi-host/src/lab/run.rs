//! One run: from a checked scenario to the files of its output directory.

use crate::language::InputError;
use crate::numerics::starting::starting_condition;
use crate::results::files::{FileError, remove, write_json};
use crate::results::measure::{Largest, ReferenceErrors};
use crate::results::output_directory::OutputDirectory;
use crate::results::run_pictures::RunPictures;
use crate::results::trajectory::TrajectoryWriter;
use crate::scenario::{Engine, Scenario};
use crate::simulation::energy_guard::EnergyGuard;
use crate::simulation::not_finite::{reason, start, what_is_not_finite};
use crate::simulation::{GridState, Precision};
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// How a run is made.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Where its files go; made if it is not there, and closed to other runs meanwhile.
    pub directory: PathBuf,
    /// What it computes in.
    pub precision: Precision,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "status")]
pub enum RunEnd {
    /// All steps were made.
    Completed,
    /// It was told to stop.
    Stopped,
    /// A step failed.
    Failed {
        /// The step that failed, from 0: from t_step to t_{step+1}.
        step: usize,
        /// The time at its beginning.
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
    /// What it computed in.
    pub precision: Precision,
    /// The engine of each damping term.
    pub engine: Vec<Engine>,
    /// Blocks that the `real-time` engine had not done when they were due.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overruns: Option<usize>,
    /// Bytes of the memories at the end.
    pub memory_bytes: usize,
    /// Seconds for making the integrator: weights, tables.
    pub preparation_seconds: f64,
    /// Seconds for the steps and for writing the trajectory.
    pub seconds: f64,
    /// Steps made.
    pub steps: usize,
    /// Steps asked for.
    pub steps_wanted: usize,
    /// Iterations of Newton's method, all steps together.
    pub newton_iterations: u64,
    /// Most iterations in one step.
    pub newton_iterations_most: u32,
    /// The last state.
    pub last: GridState,
    /// Largest absolute values.
    pub largest: Largest,
    /// What makes the result other than it may seem.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// Errors against the reference.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub errors: Option<ReferenceErrors>,
    /// Condition number of the system of the starting weights, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub starting_condition: Option<f64>,
    /// The files beside this one.
    pub files: Vec<&'static str>,
    /// The inputs as used, defaults filled in.
    pub scenario: Scenario,
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
}

/// Names of the files that a run writes.
const TRAJECTORY: &str = "trajectory.csv";
const SUMMARY: &str = "summary.json";

/// Runs a scenario and writes its files.
///
/// `stop` ends the run after the step under way; `progress` hears the number of steps made, after each.
/// Nothing is written when the scenario cannot be run. When a step fails or the run is stopped, what was
/// computed until then is written, and the summary says so.
///
/// # Errors
/// [`RunError`]; a step that fails is no error here but an end, see [`RunEnd`].
pub fn run(
    scenario: &Scenario,
    options: &RunOptions,
    stop: &AtomicBool,
    mut progress: impl FnMut(usize),
) -> Result<RunSummary, RunError> {
    let preparation = Instant::now();
    let (mut simulation, mut state) = start(scenario, options.precision)?;
    let preparation_seconds = preparation.elapsed().as_secs_f64();

    let directory = OutputDirectory::claim(&options.directory)?;
    let trajectory_path = directory.join(TRAJECTORY);
    let writing = FileError::at(&trajectory_path);
    let coordinates = scenario.coordinates();
    let mut writer =
        TrajectoryWriter::create(&trajectory_path, coordinates, scenario.output.every).map_err(&writing)?;
    let mut observed = Observed::new(scenario);
    writer.push(&state).map_err(&writing)?;
    observed.take(scenario, 0, &state);
    let mut guard = EnergyGuard::new(scenario, &state);

    let begin = Instant::now();
    let mut next = state.clone();
    let mut end = RunEnd::Completed;
    let mut steps = 0;
    let (mut newton_iterations, mut newton_iterations_most) = (0_u64, 0_u32);
    while steps < scenario.time.steps {
        if stop.load(Ordering::Relaxed) {
            end = RunEnd::Stopped;
            break;
        }
        let input = scenario.input.as_ref().and_then(|input| input.at_step(steps)).unwrap_or(&[]);
        match simulation.step(input) {
            Ok(iterations) => {
                newton_iterations += u64::from(iterations);
                newton_iterations_most = newton_iterations_most.max(iterations);
            }
            Err(error) => {
                end = failure(steps, &state, error.to_string());
                break;
            }
        }
        simulation.read(&mut next);
        if let Some(what) = what_is_not_finite(&next) {
            end = failure(steps, &state, reason(what));
            break;
        }
        steps += 1;
        std::mem::swap(&mut state, &mut next);
        writer.push(&state).map_err(&writing)?;
        observed.take(scenario, steps, &state);
        progress(steps);
        if let Some(reason) = guard.take(input, &state) {
            end = RunEnd::Failed { step: steps - 1, time: scenario.time.time(steps - 1), reason };
            break;
        }
    }
    // A summary stands for the files beside it: the old one goes before they do, the new one comes last.
    remove(&directory.join(SUMMARY))?;
    writer.finish(&state).map_err(&writing)?;
    let seconds = begin.elapsed().as_secs_f64();

    let mut files = vec![TRAJECTORY];
    // The record is written even if a picture cannot be.
    let drawn = observed.pictures.write(scenario, steps, directory.path(), &mut files);
    let summary = RunSummary {
        end,
        version: env!("CARGO_PKG_VERSION"),
        platform: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        precision: simulation.precision(),
        engine: simulation.engines().to_vec(),
        overruns: simulation.overruns(),
        memory_bytes: simulation.memory_bytes(),
        preparation_seconds,
        seconds,
        steps,
        steps_wanted: scenario.time.steps,
        newton_iterations,
        newton_iterations_most,
        last: state,
        largest: observed.largest,
        starting_condition: Some(&scenario.convolution.starting)
            .filter(|exponents| !exponents.is_empty())
            .map(|exponents| starting_condition(exponents))
            .filter(|condition| condition.is_finite()),
        warnings: scenario
            .warnings()
            .into_iter()
            .chain(observed.errors.warning())
            .chain(guard.warning())
            .collect(),
        errors: Some(observed.errors).filter(ReferenceErrors::any),
        files,
        scenario: scenario.clone(),
    };
    write_json(&directory.join(SUMMARY), &summary)?;
    drawn?;
    Ok(summary)
}

fn failure(step: usize, before: &GridState, reason: String) -> RunEnd {
    RunEnd::Failed { step, time: before.time, reason }
}

/// What is gathered along the way.
struct Observed {
    largest: Largest,
    errors: ReferenceErrors,
    pictures: RunPictures,
}

impl Observed {
    fn new(scenario: &Scenario) -> Self {
        Self {
            largest: Largest::default(),
            errors: ReferenceErrors::default(),
            pictures: RunPictures::new(scenario.coordinates()),
        }
    }

    fn take(&mut self, scenario: &Scenario, index: usize, state: &GridState) {
        self.largest.take(state);
        self.pictures.take(state);
        if let Some(reference) = &scenario.reference
            && let Some(known) = reference.at_step(index, scenario.time.step, scenario.coordinates())
        {
            self.errors.compare(state, &known);
        }
    }
}
