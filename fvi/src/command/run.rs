//! `fvi run`: integrate a scenario.

use super::choices::Choice;
use super::progress::Progress;
use super::{CommandError, default_directory, stop, terminal, warn};
use fvi_fft::memory::Engine;
use fvi_fft::sums::max_or_nan;
use fvi_host::checkpoint::CheckpointEvery;
use fvi_host::results::trajectory::Format;
use fvi_host::run::{RunEnd, RunError, RunOptions, RunSummary, run};
use fvi_scenario::language::escape::{visible, visible_line};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Precision;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Arguments of `fvi run`.
#[derive(Debug, clap::Args)]
pub(crate) struct RunArguments {
    /// The scenario file (TOML)
    scenario: PathBuf,
    /// Where the files go (default: `out/` and the name of the scenario)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The memory engine, in place of the scenario's
    #[arg(long, value_enum)]
    engine: Option<Choice<Engine>>,
    /// Floating-point precision
    #[arg(long, value_enum, default_value_t)]
    precision: Choice<Precision>,
    /// The format of the trajectory: a table of text, or NumPy arrays (default: csv)
    #[arg(long, value_enum)]
    format: Option<Choice<Format>>,
    /// The last time, in place of the scenario's
    #[arg(long, value_name = "TIME", conflicts_with = "steps", allow_negative_numbers = true)]
    until: Option<f64>,
    /// The number of steps, in place of the scenario's
    #[arg(long)]
    steps: Option<usize>,
    /// Continue from the checkpoint in the run's directory, or begin if there is none
    #[arg(long)]
    resume: bool,
    /// How often a checkpoint is written: a number of steps, a duration such as 30s or 10min, or never
    /// (default: 60s)
    #[arg(long, value_name = "STEPS|DURATION")]
    checkpoint_every: Option<CheckpointEvery>,
    /// Continue from a checkpoint of another machine or version, although the last bits may differ
    #[arg(long, requires = "resume")]
    accept_other_machine: bool,
    /// Neither progress nor result on the terminal
    #[arg(long)]
    quiet: bool,
}

impl RunArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let reading = Instant::now();
        let mut scenario = Scenario::read(&self.scenario)?;
        let reading_seconds = reading.elapsed().as_secs_f64();
        if let Some(Choice(engine)) = self.engine {
            scenario.history.choose(engine);
        }
        if let Some(end) = self.until {
            scenario = scenario.ending_at(end)?;
        } else if let Some(steps) = self.steps {
            scenario = scenario.ending_after(steps)?;
        }
        // Before a scheme has been chosen there is nothing to warn of.
        let warnings = if scenario.automatic.is_none() { scenario.warnings() } else { Vec::new() };
        let before = warnings.len();
        warn(warnings);
        let directory = self.out.unwrap_or_else(|| default_directory(&self.scenario, "run"));
        let begun = Arc::<AtomicBool>::default();
        let stop = stop::flag_of_steps(&begun);
        let mut progress = match scenario.time.steps_known() {
            Some(steps) => Progress::new(steps, "steps", self.quiet),
            None => Progress::of_unknown("steps", self.quiet),
        };
        let options = RunOptions {
            precision: self.precision.0,
            format: self.format.map(|Choice(format)| format),
            checkpoints: self.checkpoint_every.unwrap_or_default(),
            resume: self.resume,
            accept_other_machine: self.accept_other_machine,
            reading_seconds,
            ..RunOptions::new(&directory)
        };
        let mut made = |steps| {
            begun.store(true, Ordering::Relaxed);
            progress.update(steps);
        };
        let summary = run(&scenario, &options, &stop, &mut made).map_err(|error| match error {
            RunError::Input(error) => CommandError::Input(error),
            RunError::File(error) => CommandError::File(error),
            RunError::Checkpoint(error) => CommandError::Checkpoint(error),
            error @ RunError::Stopped => CommandError::Stopped(error.to_string()),
            error => CommandError::Failed(error.to_string()),
        })?;
        progress.finish();
        for note in &summary.notes {
            terminal::mention(&format!("note: {}\n", visible(note)));
        }
        warn(summary.warnings.iter().skip(before).cloned());
        let line = result_line(&scenario, &summary, &directory);
        match &summary.end {
            RunEnd::Completed | RunEnd::Event { .. } => {
                if !self.quiet {
                    let ended = match summary.end {
                        RunEnd::Event { event, time } => format!("; ended by event {event} at t = {time}"),
                        _ => String::new(),
                    };
                    terminal::say(&format!("{line}{ended}\n"))?;
                }
                Ok(())
            }
            RunEnd::Stopped => Err(CommandError::Stopped(format!("stopped; {line}"))),
            RunEnd::Failed { step, time, reason } => Err(CommandError::Failed(format!(
                "step {step} (from t = {time}{}) failed: {reason}; kept until then: {line}",
                match scenario.time.adaptive() {
                    Some(_) => String::new(),
                    None => format!(" to t = {}", scenario.time.time(step + 1)),
                },
            ))),
        }
    }
}

/// Largest number of coordinates of the last state shown on the terminal.
const MOST_SHOWN: usize = 8;

/// Numbers with nine decimals, or with nine after the first digit where all are small.
fn told(numbers: &[f64]) -> Vec<String> {
    let largest = numbers.iter().fold(0.0, |largest, number| max_or_nan(largest, number.abs()));
    let is_small = largest > 0.0 && largest < 1e-3;
    let told = |number: &f64| if is_small { format!("{number:.9e}") } else { format!("{number:.9}") };
    numbers.iter().map(told).collect()
}

/// The result of the run in one line, with the output coordinates.
fn result_line(scenario: &Scenario, summary: &RunSummary, directory: &Path) -> String {
    let last = &summary.last;
    if !summary.cases.is_empty() {
        return format!(
            "{}: {} steps to t = {} of {} load cases ({}); {:.3} s; files in directories of these names in {}",
            visible_line(scenario.heading()),
            summary.steps,
            last.time,
            summary.cases.len(),
            summary.cases.join(", "),
            summary.seconds,
            directory.display(),
        );
    }
    let chosen = scenario.written_coordinates();
    let list = |numbers: &[f64]| {
        let shown = chosen.iter().take(MOST_SHOWN).filter_map(|&index| numbers.get(index));
        let mut shown = told(&shown.copied().collect::<Vec<_>>());
        if chosen.len() > MOST_SHOWN {
            shown.push("…".to_owned());
        }
        if chosen.len() == 1 { shown.concat() } else { format!("[{}]", shown.join(", ")) }
    };
    let mut errors = String::new();
    if let Some(measured) = &summary.errors {
        let position = if scenario.equation.is_some() { "x" } else { "q" };
        let kinds = [(position, &measured.position), ("p", &measured.momentum), ("energy", &measured.energy)];
        for (name, error) in kinds.into_iter().filter(|(_, error)| error.compared > 0) {
            errors += &format!("; largest error of {name} {:.3e}", error.largest);
        }
    }
    let mut engines: Vec<&str> = summary.engine.iter().map(|engine| engine.name()).collect();
    engines.dedup();
    let engines = if engines.is_empty() { "no memory".to_owned() } else { engines.join(", ") };
    let state = match scenario.equation {
        Some(_) => format!("x = {}", list(&last.position)),
        None => {
            let (q, p) = (list(&last.position), list(&last.momentum));
            format!("q = {q}, p = {p}, energy = {}", told(&[last.energy]).concat())
        }
    };
    format!(
        "{}: {} steps to t = {}: {state}{errors}; {:.3} s, {engines}; files in {}",
        visible_line(scenario.heading()),
        summary.steps,
        last.time,
        summary.seconds,
        directory.display(),
    )
}
