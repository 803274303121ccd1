//! `fvi tune`: gains and orders of a controller for a plant.

use super::{CommandError, default_directory, stop, terminal, warn};
use fvi_host::results::output_directory::OutputDirectory;
use fvi_host::tune::{TuneError, Tuning, TuningProblem, in_words, tune};
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
    let (sampled, continuous) = (&found.sampled_margins, &found.margins);
    let phase = |margin: Option<f64>| margin.map_or("–".to_owned(), |margin| format!("{margin:.2}°"));
    let crossover = sampled.gain_crossovers.last().map_or("–".to_owned(), |omega| format!("{omega:.4e}"));
    let sought = |(name, bound, reached): (&str, Option<f64>, f64)| {
        let bound = bound?;
        // The search knows the points of a grid.
        let passed = if reached > bound + 5e-4 { format!(" (reached: {reached:.3})") } else { String::new() };
        Some(format!("; sought by default: {name} ≤ {bound:.3}{passed}"))
    };
    let reached = [("Ms", found.sought[0], sampled.ms), ("Mt", found.sought[1], sampled.mt)];
    let sought: String = reached.into_iter().filter_map(sought).collect();
    let gain = sampled.gain_margin.map_or("any".to_owned(), |margin| format!("{margin:.3}"));
    format!(
        "{}: {}; with samples of {}: crossover {crossover}, \
         phase margin {}, gain margin {gain}, Ms {:.3}, Mt {:.3} (in continuous time phase margin {}, Ms {:.3}){sought}",
        visible_line(problem.heading()),
        in_words(&found.law),
        problem.controller.sample,
        phase(sampled.phase_margin),
        sampled.ms,
        sampled.mt,
        phase(continuous.phase_margin),
        continuous.ms
    )
}
