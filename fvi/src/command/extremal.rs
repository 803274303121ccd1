//! `fvi extremal`: solve a two-point fractional Euler–Lagrange problem.

use super::{CommandError, default_directory, terminal, warn};
use fvi_exhibits::two_point::{
    ExtremalSummary, GridError, OutputError, ProblemFile, Status, solve_and_write,
};
use fvi_host::results::output_directory::OutputDirectory;
use fvi_scenario::language::escape::visible_line;
use indicatif::{ProgressBar, ProgressDrawTarget};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Arguments of `fvi extremal`.
#[derive(Debug, clap::Args)]
pub(crate) struct ExtremalArguments {
    /// The problem file (TOML)
    problem: PathBuf,
    /// Where the files go (default: `out/` and the name of the problem)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Neither progress nor result on the terminal
    #[arg(long)]
    quiet: bool,
}

impl ExtremalArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let file = ProblemFile::read(&self.problem)?;
        let directory = self.out.unwrap_or_else(|| default_directory(&self.problem, "extremal"));
        let directory = OutputDirectory::claim(&directory)?;
        let mut progress = Progress::new(!self.quiet && std::io::stderr().is_terminal());
        let summary =
            solve_and_write(&file, &directory, &mut |steps, residual| progress.update(steps, residual))
                .map_err(|error| match error {
                    OutputError::File(error) => CommandError::File(error),
                    OutputError::NoRoom { .. } => CommandError::NoRoom(error.to_string()),
                    other => CommandError::Failed(other.to_string()),
                })?;
        progress.finish();
        warn(summary.errors.last().filter(|error| error.undefined > 0).map(|error| {
            format!("reference: it is not finite at {} grid points, which are not compared", error.undefined)
        }));
        let line = result_line(&file, &summary, directory.path());
        match summary.status {
            Status::Converged => {
                if !self.quiet {
                    terminal::say(&format!("{line}\n"))?;
                }
                Ok(())
            }
            Status::NotConverged => {
                Err(CommandError::Failed(format!("no convergence; best iterate kept: {line}")))
            }
        }
    }
}

/// The solution in one line.
fn result_line(file: &ProblemFile, summary: &ExtremalSummary, directory: &Path) -> String {
    let error = match summary.errors.last() {
        Some(GridError { largest, order: Some(order), .. }) => {
            format!("; largest error {largest:.3e}, order {order:.2}")
        }
        Some(GridError { largest, .. }) => format!("; largest error {largest:.3e}"),
        None => String::new(),
    };
    let value = summary.value.map_or_else(String::new, |value| format!(", value {value:.12}"));
    format!(
        "{}: {} steps{value}; Newton {}, Krylov {}, residual {:.1e} (rounding {:.1e}), \
         relative {:.1e}{error}; {:.3} s; files in {}",
        visible_line(file.heading()),
        file.grid.steps(),
        summary.newton_iterations,
        summary.krylov_iterations,
        summary.residual,
        summary.rounding_level,
        summary.relative_residual,
        summary.seconds,
        directory.display(),
    )
}

/// A line on a terminal that appears once a solution has taken about a second.
struct Progress {
    start: Instant,
    wanted: bool,
    spinner: Option<ProgressBar>,
}

impl Progress {
    fn new(wanted: bool) -> Self {
        Self { start: Instant::now(), wanted, spinner: None }
    }

    fn update(&mut self, steps: usize, residual: f64) {
        if !self.wanted || self.start.elapsed() < Duration::from_secs(1) {
            return;
        }
        let spinner = self
            .spinner
            .get_or_insert_with(|| ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr()));
        spinner.set_message(format!("{steps} Newton steps, relative residual {residual:.1e}"));
        spinner.tick();
    }

    fn finish(&self) {
        if let Some(spinner) = &self.spinner {
            spinner.finish_and_clear();
        }
    }
}
