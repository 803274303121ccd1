//! `fvi strategies`: any kernel, the strategies of the literature, your own programs.

use super::progress::Progress;
use super::{CommandError, default_directory, stop, terminal};
use fvi_scenario::language::escape::visible;
use fvi_strategies::{Lab, LabError};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Arguments of `fvi strategies`.
#[derive(Debug, clap::Args)]
pub(crate) struct StrategiesArguments {
    /// The file of kernels, lengths and strategies (TOML)
    file: PathBuf,
    /// Where the files go (default: `out/` and the name of the file)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Continue an interrupted race from the results in the directory
    #[arg(long)]
    resume: bool,
    /// Neither progress nor result on the terminal
    #[arg(long)]
    quiet: bool,
}

impl StrategiesArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let lab = Lab::new();
        let plan = lab.plan(&self.file).map_err(command_error)?;
        let directory = self.out.unwrap_or_else(|| default_directory(&self.file, "strategies"));
        // Programs of strategies are ended, and rounds kept, before the lab ends.
        let stop = stop::flag_of_steps(&Arc::new(AtomicBool::new(true)));
        let mut progress = Progress::new(plan.races(), "rounds", self.quiet);
        let summary = lab
            .race(&plan, &directory, self.resume, &stop, &mut |done, needed| progress.update_of(done, needed))
            .map_err(command_error)?;
        progress.finish();
        if summary.done < summary.races {
            return Err(CommandError::Stopped(format!(
                "stopped; {} of {} races are done and {} begun, in {}; `--resume` goes on",
                summary.done,
                summary.races,
                summary.record.races.len() - summary.done,
                directory.display()
            )));
        }
        if self.quiet {
            return Ok(());
        }
        terminal::say(&format!("{summary}\n"))
    }
}

fn command_error(error: LabError) -> CommandError {
    match error {
        LabError::Input(error) => CommandError::Input(error),
        LabError::File(error) => CommandError::File(error),
        LabError::NoRoom(_) => CommandError::NoRoom(error.to_string()),
        error => CommandError::Unsuited(visible(&error.to_string()).into_owned()),
    }
}
