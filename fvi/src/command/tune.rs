//! `fvi tune`: gains and orders of a controller for a plant.

use super::{CommandError, default_directory, stop, terminal, warn};
use fvi_host::results::output_directory::OutputDirectory;
use fvi_host::tune::{TuneError, Tuning, TuningProblem, tune};
use fvi_scenario::language::escape::visible_line;
use std::path::PathBuf;

/// Arguments of `fvi tune`.
#[derive(Debug, clap::Args)]
pub(crate) struct TuneArguments {
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
            let model = found.model.map_or_else(String::new, |model| format!("; {model}"));
            terminal::say(&format!("{text}{model}; files in {}\n", directory.path().display()))?;
        }
        Ok(())
    }
}

fn said(found: &Tuning, problem: &TuningProblem) -> String {
    let [kp, ki, kd] = found.law.three();
    let (sampled, continuous) = (&found.sampled_margins, &found.margins);
    let phase = |margin: Option<f64>| margin.map_or("–".to_owned(), |margin| format!("{margin:.2}°"));
    let crossover = sampled.gain_crossovers.last().map_or("–".to_owned(), |omega| format!("{omega:.4e}"));
    let sought: String = ["Ms", "Mt"]
        .into_iter()
        .zip(found.sought)
        .filter_map(|(name, bound)| Some(format!("; sought by default: {name} ≤ {:.3}", bound?)))
        .collect();
    let gain = sampled.gain_margin.map_or("any".to_owned(), |margin| format!("{margin:.3}"));
    format!(
        "{}: kp = {kp:.6}, ki = {ki:.6}, lambda = {:.4}, kd = {kd:.6}, mu = {:.4}; with samples of {}: crossover {crossover}, \
         phase margin {}, gain margin {gain}, Ms {:.3}, Mt {:.3} (in continuous time phase margin {}, Ms {:.3}){sought}",
        visible_line(problem.heading()),
        found.law.lambda,
        found.law.mu,
        problem.controller.sample,
        phase(sampled.phase_margin),
        sampled.ms,
        sampled.mt,
        phase(continuous.phase_margin),
        continuous.ms
    )
}
