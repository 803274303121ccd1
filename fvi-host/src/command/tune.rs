//! `fvi tune`: gains and orders of a controller for a plant.

use super::{CommandError, default_directory, stop, terminal, warn};
use fvi_lab::lab::tune::{TuneError, Tuning, TuningProblem, tune};
use fvi_lab::results::output_directory::OutputDirectory;
use fvi_scenario::language::visible::visible_line;
use std::path::PathBuf;

/// Arguments of `fvi tune`.
#[derive(Debug, clap::Args)]
pub struct TuneArguments {
    /// Plant, structure of the controller and specification (TOML)
    problem: PathBuf,
    /// Where the files go (default: `out/` and the name of the file)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Nothing on the terminal
    #[arg(long)]
    quiet: bool,
}

impl TuneArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let problem = TuningProblem::read(&self.problem)?;
        let directory = self.out.unwrap_or_else(|| default_directory(&self.problem, "tune"));
        let stop = stop::flag();
        let found = tune(&problem, &stop).map_err(|error| match error {
            TuneError::Stopped => CommandError::Stopped("stopped; nothing was written".to_owned()),
            other => CommandError::Failed(format!("{}: {other}", self.problem.display())),
        })?;
        let directory = OutputDirectory::claim(&directory)?;
        found.write(&problem, &directory)?;
        warn(found.warnings.iter().cloned());
        if !self.quiet {
            let text = said(&found, &problem);
            terminal::say(&format!("{text}; files in {}\n", directory.path().display()))?;
        }
        Ok(())
    }
}

fn said(found: &Tuning, problem: &TuningProblem) -> String {
    let [kp, ki, kd] = found.law.three();
    let margins = &found.margins;
    let phase = margins.phase_margin.map_or("–".to_owned(), |margin| format!("{margin:.2}°"));
    let sampled =
        found.sampled_margins.phase_margin.map_or("–".to_owned(), |margin| format!("{margin:.2}°"));
    let crossover = margins.gain_crossovers.last().map_or("–".to_owned(), |omega| format!("{omega:.4e}"));
    let gain = margins.gain_margin.map_or("any".to_owned(), |margin| format!("{margin:.3}"));
    format!(
        "{}: kp = {kp:.6}, ki = {ki:.6}, lambda = {:.4}, kd = {kd:.6}, mu = {:.4}; crossover {crossover}, phase margin {phase} \
         (sampled {sampled}), gain margin {gain}, Ms {:.3} (sampled {:.3})",
        visible_line(problem.heading()),
        found.law.lambda,
        found.law.mu,
        margins.ms,
        found.sampled_margins.ms
    )
}
