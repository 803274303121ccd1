//! `fvi sweep`: one scenario with many values of some of its keys.

use super::choices::Choice;
use super::progress::Progress;
use super::{CommandError, default_directory, stop, terminal};
use fvi_host::sweep::{Shard, Sweep, SweepError, SweepOptions, SweepSummary, gather, sweep};
use fvi_scenario::language::escape::{visible, visible_line};
use fvi_simulation::simulation::Precision;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Arguments of `fvi sweep`.
#[derive(Debug, clap::Args)]
pub(crate) struct SweepArguments {
    /// The sweep file (TOML)
    sweep: PathBuf,
    /// Where the files go (default: `out/` and the name of the sweep)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Threads (default: one for each core)
    #[arg(long, value_name = "N")]
    jobs: Option<NonZero<usize>>,
    /// Make only a part of the runs (default: that of the task, in a Slurm array)
    #[arg(long, value_name = "I/COUNT")]
    shard: Option<Shard>,
    /// Join the shards in the directory to the table, and make no runs
    #[arg(long, conflicts_with_all = ["shard", "jobs"])]
    gather: bool,
    /// Floating-point precision
    #[arg(long, value_enum, default_value_t)]
    precision: Choice<Precision>,
    /// Neither progress nor result on the terminal
    #[arg(long)]
    quiet: bool,
}

impl SweepArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let plan = Sweep::read(&self.sweep)?;
        let directory = self.out.unwrap_or_else(|| default_directory(&self.sweep, "sweep"));
        let shard = match self.shard {
            Some(shard) => shard,
            None if self.gather => Shard::WHOLE,
            None => Shard::of_slurm(|name| std::env::var(name).ok())
                .map_err(|error| CommandError::Sweep(format!("the array of Slurm: {error}")))?
                .unwrap_or(Shard::WHOLE),
        };
        let begin = Instant::now();
        let options = SweepOptions {
            precision: self.precision.0,
            jobs: self.jobs,
            shard,
            ..SweepOptions::new(&directory)
        };
        let summary = if self.gather {
            gather(&plan, &options).map_err(command_error)?
        } else {
            let stop = stop::flag();
            let mut progress = Progress::new(plan.runs(), "runs", self.quiet);
            let summary =
                sweep(&plan, &options, &stop, &mut |done| progress.update(done)).map_err(command_error)?;
            progress.finish();
            summary
        };
        let line = result_line(&plan, &summary, shard, &directory, begin.elapsed().as_secs_f64());
        if summary.done < summary.share {
            return Err(CommandError::Stopped(format!("stopped; {line}; the same command goes on")));
        }
        if self.quiet { Ok(()) } else { terminal::say(&format!("{line}\n")) }
    }
}

fn command_error(error: SweepError) -> CommandError {
    match error {
        SweepError::Input(error) => CommandError::Input(error),
        SweepError::File(error) => CommandError::File(error),
        error => CommandError::Sweep(visible(&error.to_string()).into_owned()),
    }
}

/// The result of the sweep in one line.
fn result_line(plan: &Sweep, summary: &SweepSummary, shard: Shard, directory: &Path, seconds: f64) -> String {
    let part = if shard == Shard::WHOLE {
        format!("{} of {} runs", summary.done, summary.runs)
    } else {
        format!("shard {shard}: {} of its {} runs", summary.done, summary.share)
    };
    let failed = match summary.failed {
        0 => String::new(),
        failed => format!(", {failed} of them failed"),
    };
    let files =
        if summary.files.is_empty() { String::new() } else { format!(": {}", summary.files.join(", ")) };
    format!(
        "{}: {part}{failed}; {seconds:.1} s; files in {}{files}",
        visible_line(plan.heading()),
        directory.display()
    )
}
