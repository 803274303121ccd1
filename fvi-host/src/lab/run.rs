//! One run: from a checked scenario to the files of its output directory.

use crate::language::InputError;
use crate::numerics::starting::starting_condition;
use crate::results::files::{FileError, remove, write_json};
use crate::results::measure::{Largest, ReferenceErrors};
use crate::results::output_directory::OutputDirectory;
#[cfg(feature = "pictures")]
use crate::results::run_pictures::RunPictures;
use crate::results::trajectory::TrajectoryWriter;
use crate::scenario::{Engine, Scenario};
use crate::simulation::motion::{Failure, Motion};
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
    let run = Run::start(scenario, options.precision)?;

    let directory = OutputDirectory::claim(&options.directory)?;
    let trajectory_path = directory.join(TRAJECTORY);
    let writing = FileError::at(&trajectory_path);
    let coordinates = scenario.coordinates();
    let mut writer =
        TrajectoryWriter::create(&trajectory_path, coordinates, scenario.output.every).map_err(&writing)?;
    #[cfg(feature = "pictures")]
    let mut pictures = RunPictures::new(coordinates);
    let mut summary = run.to_the_end(stop, |steps, state| {
        writer.push(state).map_err(&writing)?;
        #[cfg(feature = "pictures")]
        pictures.take(state);
        if steps > 0 {
            progress(steps);
        }
        Ok::<_, RunError>(())
    })?;
    // A summary stands for the files beside it: the old one goes before they do, the new one comes last.
    remove(&directory.join(SUMMARY))?;
    let begin = Instant::now();
    writer.finish(&summary.last).map_err(&writing)?;
    summary.seconds += begin.elapsed().as_secs_f64();

    summary.files.push(TRAJECTORY);
    // The record is written even if a picture cannot be.
    #[cfg(feature = "pictures")]
    let drawn = pictures.write(scenario, summary.steps, directory.path(), &mut summary.files);
    write_json(&directory.join(SUMMARY), &summary)?;
    #[cfg(feature = "pictures")]
    drawn?;
    Ok(summary)
}

/// A run that writes nothing by itself: whoever makes it sees its states, and has its record at the end.
pub struct Run<'s> {
    scenario: &'s Scenario,
    motion: Motion<'s>,
    preparation_seconds: f64,
    largest: Largest,
    errors: ReferenceErrors,
}

impl<'s> Run<'s> {
    /// The run at t = 0.
    ///
    /// # Errors
    /// If the scenario cannot be run.
    pub fn start(scenario: &'s Scenario, precision: Precision) -> Result<Self, InputError> {
        let preparation = Instant::now();
        let motion = Motion::start(scenario, precision)?;
        Ok(Self {
            scenario,
            motion,
            preparation_seconds: preparation.elapsed().as_secs_f64(),
            largest: Largest::default(),
            errors: ReferenceErrors::default(),
        })
    }

    /// Makes all steps, or those until one fails or `stop` is set; `take` sees the number of steps made and the state after
    /// them, from the beginning on.
    ///
    /// # Errors
    /// Those of `take`. A step that fails is no error but an end, see [`RunEnd`].
    pub fn to_the_end<E>(
        mut self,
        stop: &AtomicBool,
        mut take: impl FnMut(usize, &GridState) -> Result<(), E>,
    ) -> Result<RunSummary, E> {
        let begin = Instant::now();
        let mut end = RunEnd::Completed;
        let (mut newton_iterations, mut newton_iterations_most) = (0_u64, 0_u32);
        self.observe(&mut take)?;
        while self.motion.steps() < self.scenario.time.steps {
            if stop.load(Ordering::Relaxed) {
                end = RunEnd::Stopped;
                break;
            }
            let made = self.motion.steps();
            let result = self.motion.advance();
            if self.motion.steps() > made {
                self.observe(&mut take)?;
            }
            match result {
                Ok(iterations) => {
                    newton_iterations += u64::from(iterations);
                    newton_iterations_most = newton_iterations_most.max(iterations);
                }
                Err(Failure { step, time, reason }) => {
                    end = RunEnd::Failed { step, time, reason };
                    break;
                }
            }
        }
        let (scenario, motion) = (self.scenario, self.motion);
        let simulation = motion.simulation();
        Ok(RunSummary {
            end,
            version: env!("CARGO_PKG_VERSION"),
            platform: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            precision: simulation.precision(),
            engine: simulation.engines().to_vec(),
            overruns: simulation.overruns(),
            memory_bytes: simulation.memory_bytes(),
            preparation_seconds: self.preparation_seconds,
            seconds: begin.elapsed().as_secs_f64(),
            steps: motion.steps(),
            steps_wanted: scenario.time.steps,
            newton_iterations,
            newton_iterations_most,
            last: motion.state().clone(),
            largest: self.largest,
            starting_condition: Some(&scenario.convolution.starting)
                .filter(|exponents| !exponents.is_empty())
                .map(|exponents| starting_condition(exponents))
                .filter(|condition| condition.is_finite()),
            warnings: scenario
                .warnings()
                .into_iter()
                .chain(self.errors.warning())
                .chain(motion.warning().map(str::to_owned))
                .collect(),
            errors: Some(self.errors).filter(ReferenceErrors::any),
            files: Vec::new(),
            scenario: scenario.clone(),
        })
    }

    /// Takes in the present state and shows it.
    fn observe<E>(&mut self, take: &mut impl FnMut(usize, &GridState) -> Result<(), E>) -> Result<(), E> {
        let (scenario, steps, state) = (self.scenario, self.motion.steps(), self.motion.state());
        self.largest.take(state);
        if let Some(reference) = &scenario.reference
            && let Some(known) = reference.at_step(steps, scenario.time.step, scenario.coordinates())
        {
            self.errors.compare(state, &known);
        }
        take(steps, state)
    }
}
