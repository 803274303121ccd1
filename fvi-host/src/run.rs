//! One run: from a checked scenario to the files of its output directory.

use crate::files::{FileError, make_directory, write_json};
use crate::measure::{Largest, ReferenceErrors};
use crate::run_pictures::RunPictures;
use crate::scenario::{Engine, InputError, Scenario};
use crate::simulation::{GridState, Precision, Simulation};
use crate::starting::starting_condition;
use crate::trajectory::TrajectoryWriter;
use fvi_core::StepError;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// How a run is made.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Where its files go; made if it is not there.
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
    let mut simulation = Simulation::new(scenario, options.precision)?;
    let preparation_seconds = preparation.elapsed().as_secs_f64();

    let directory = &options.directory;
    make_directory(directory)?;
    let trajectory_path = directory.join(TRAJECTORY);
    let writing = FileError::at(&trajectory_path);
    let coordinates = scenario.coordinates();
    let mut writer =
        TrajectoryWriter::create(&trajectory_path, coordinates, scenario.output.every).map_err(&writing)?;
    let mut observed = Observed::new(scenario);
    let mut state = GridState {
        position: vec![0.0; coordinates],
        momentum: vec![0.0; coordinates],
        ..GridState::default()
    };
    simulation.read(&mut state);
    writer.push(&state).map_err(&writing)?;
    observed.take(scenario, 0, &state);

    let start = Instant::now();
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
                end = failure(steps, state.time, error);
                break;
            }
        }
        steps += 1;
        simulation.read(&mut state);
        writer.push(&state).map_err(&writing)?;
        observed.take(scenario, steps, &state);
        progress(steps);
    }
    writer.finish().map_err(&writing)?;
    let seconds = start.elapsed().as_secs_f64();

    let mut files = vec![TRAJECTORY];
    files.extend(observed.pictures.write(scenario, steps, directory)?);
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
            .map(|exponents| starting_condition(exponents)),
        warnings: scenario.warnings().into_iter().chain(observed.errors.warning()).collect(),
        errors: Some(observed.errors).filter(ReferenceErrors::any),
        files,
        scenario: scenario.clone(),
    };
    write_json(&directory.join(SUMMARY), &summary)?;
    Ok(summary)
}

fn failure(step: usize, time: f64, error: StepError) -> RunEnd {
    RunEnd::Failed { step, time, reason: error.to_string() }
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
