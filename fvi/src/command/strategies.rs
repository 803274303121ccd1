//! `fvi strategies`: any kernel, the strategies of the literature, your own programs.

use super::progress::Progress;
use super::{CommandError, default_directory, stop, terminal};
use fvi_scenario::language::escape::visible;
use fvi_strategies::{Lab, LabError, Summary};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

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
    /// The rounds of one of the processes that the file asks for, from 0
    #[arg(long, hide = true)]
    process: Option<usize>,
}

impl StrategiesArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let mut lab = Lab::new();
        let plan = lab.plan(&self.file).map_err(command_error)?;
        let directory = self.out.clone().unwrap_or_else(|| default_directory(&self.file, "strategies"));
        let of = plan.processes();
        match self.process {
            None if of > 1 => return self.in_processes(of, &directory),
            None => {}
            Some(index) => lab = lab.in_process(index),
        }
        // Programs of strategies are ended, and rounds kept, before the lab ends.
        let stop = stop::flag_of_steps(&Arc::new(AtomicBool::new(true)));
        let mut progress = Progress::new(plan.races(), "rounds", self.quiet);
        let summary = lab
            .race(&plan, &directory, self.resume, &stop, &mut |done, needed| progress.update_of(done, needed))
            .map_err(command_error)?;
        progress.finish();
        if stop.load(Ordering::Relaxed) || self.process.is_none_or(|index| index + 1 == of) {
            self.say(&summary, &directory)?;
        }
        Ok(())
    }

    fn say(&self, summary: &Summary, directory: &Path) -> Result<(), CommandError> {
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

impl StrategiesArguments {
    /// Runs this program once for each process, one after the other: each goes on from the record of the one
    /// before. A signal is passed on to the one that runs.
    fn in_processes(&self, of: usize, directory: &Path) -> Result<(), CommandError> {
        let failed = |error: std::io::Error| CommandError::Failed(format!("process of a race: {error}"));
        let program = std::env::current_exe().map_err(failed)?;
        let stop = stop::flag_of_steps(&Arc::new(AtomicBool::new(true)));
        for index in 0..of {
            let mut command = std::process::Command::new(&program);
            command.arg("strategies").arg(&self.file).arg("--out").arg(directory);
            command.args(["--process", &index.to_string()]);
            if self.resume || index > 0 {
                command.arg("--resume");
            }
            if self.quiet {
                command.arg("--quiet");
            }
            // In a group of its own the terminal does not tell it of an interrupt a second time.
            #[cfg(unix)]
            std::os::unix::process::CommandExt::process_group(&mut command, 0);
            let mut child = command.spawn().map_err(failed)?;
            let status = stop::wait(&mut child, &stop).map_err(failed)?;
            // It has said why.
            let words = format!("process {} of {of}: {status}", index + 1);
            match status.code() {
                Some(0) => {}
                Some(2) => return Err(CommandError::Unsuited(words)),
                Some(130) => return Err(CommandError::Stopped(words)),
                _ => return Err(CommandError::Failed(words)),
            }
        }
        Ok(())
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
