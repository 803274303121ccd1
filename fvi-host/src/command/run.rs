//! `fvi run`: integrate a scenario.

use super::progress::Progress;
use super::{CommandError, default_directory, stop, terminal, warn};
use crate::lab::run::{RunEnd, RunError, RunOptions, RunSummary, run};
use crate::language::visible::visible_line;
use crate::scenario::{Engine, Scenario};
use crate::simulation::Precision;
use std::path::{Path, PathBuf};

/// Arguments of `fvi run`.
#[derive(Debug, clap::Args)]
pub struct RunArguments {
    /// The scenario file (TOML)
    scenario: PathBuf,
    /// Where the files go (default: `out/` and the name of the scenario)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The memory engine, in place of the scenario's
    #[arg(long, value_enum)]
    engine: Option<Engine>,
    /// What to compute in
    #[arg(long, value_enum, default_value_t)]
    precision: Precision,
    /// Neither progress nor result on the terminal
    #[arg(long)]
    quiet: bool,
}

impl RunArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let mut scenario = Scenario::read(&self.scenario)?;
        if let Some(engine) = self.engine {
            scenario.history.choose(engine);
        }
        let warnings = scenario.warnings();
        let before = warnings.len();
        warn(warnings);
        let directory = self.out.unwrap_or_else(|| default_directory(&self.scenario, "run"));
        let stop = stop::flag();
        let mut progress = Progress::new(scenario.time.steps, "steps", self.quiet);
        let options = RunOptions { directory: directory.clone(), precision: self.precision };
        let summary =
            run(&scenario, &options, &stop, |steps| progress.update(steps)).map_err(|error| match error {
                RunError::Input(error) => CommandError::Input(error),
                RunError::File(error) => CommandError::File(error),
            })?;
        progress.finish();
        warn(summary.warnings.iter().skip(before).cloned());
        let line = result_line(&scenario, &summary, &directory);
        match &summary.end {
            RunEnd::Completed => {
                if !self.quiet {
                    terminal::say(&format!("{line}\n"))?;
                }
                Ok(())
            }
            RunEnd::Stopped => Err(CommandError::Stopped(format!("stopped; {line}"))),
            RunEnd::Failed { step, time, reason } => Err(CommandError::Failed(format!(
                "step {step} (from t = {time} to t = {}) failed: {reason}; kept until then: {line}",
                scenario.time.time(step + 1),
            ))),
        }
    }
}

/// The run in one line.
fn result_line(scenario: &Scenario, summary: &RunSummary, directory: &Path) -> String {
    let last = &summary.last;
    let list = |numbers: &[f64]| {
        let numbers: Vec<String> = numbers.iter().map(|number| format!("{number:.9}")).collect();
        if numbers.len() == 1 { numbers.concat() } else { format!("[{}]", numbers.join(", ")) }
    };
    let mut errors = String::new();
    if let Some(measured) = &summary.errors {
        let kinds = [("q", &measured.position), ("p", &measured.momentum), ("energy", &measured.energy)];
        for (name, error) in kinds.into_iter().filter(|(_, error)| error.compared > 0) {
            errors += &format!("; largest error of {name} {:.3e}", error.largest);
        }
    }
    let mut engines: Vec<&str> = summary.engine.iter().map(|engine| engine.name()).collect();
    engines.dedup();
    let engines = if engines.is_empty() { "no memory".to_owned() } else { engines.join(", ") };
    format!(
        "{}: {} steps to t = {}: q = {}, p = {}, energy = {:.9}{errors}; {:.3} s, {engines}; files in {}",
        visible_line(scenario.heading()),
        summary.steps,
        last.time,
        list(&last.position),
        list(&last.momentum),
        last.energy,
        summary.seconds,
        directory.display(),
    )
}
