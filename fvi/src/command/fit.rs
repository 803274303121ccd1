//! `fvi fit`: estimates numbers of a scenario from measured data.

use super::progress::Progress;
use super::{CommandError, default_directory, stop, terminal};
use fvi_host::fit::{Fit, FitError, fit};
use fvi_host::results::output_directory::OutputDirectory;
use fvi_scenario::language::escape::visible;
use std::path::PathBuf;

/// Arguments of `fvi fit`.
#[derive(Debug, clap::Args)]
pub(crate) struct FitArguments {
    /// The file of the fit (TOML): a scenario, free numbers, data
    fit: PathBuf,
    /// Where the files go (default: `out/` and the name of the fit)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Neither progress nor result on the terminal
    #[arg(long)]
    quiet: bool,
}

impl FitArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let plan = Fit::read(&self.fit)?;
        let directory = self.out.unwrap_or_else(|| default_directory(&self.fit, "fit"));
        let stop = stop::flag();
        let mut progress = Progress::of_unknown("runs", self.quiet);
        let result = fit(&plan, &stop, &mut |runs| progress.update(runs));
        progress.finish();
        let found = result.map_err(|error| match error {
            FitError::Start(reason) => {
                CommandError::Unsuited(format!("there is no motion where the parameters start: {reason}"))
            }
            FitError::Unresolved(reason) | FitError::Untouched(reason) => CommandError::Unsuited(reason),
            FitError::Stopped => CommandError::Stopped("stopped; nothing was written".to_owned()),
            other => CommandError::Failed(other.to_string()),
        })?;
        let directory = OutputDirectory::claim(&directory)?;
        found.write(&plan, &directory)?;
        if !self.quiet {
            let report = visible(&found.report(&plan)).into_owned();
            terminal::say(&format!("{report}files in {}\n", directory.path().display()))?;
        }
        match found.models.iter().find(|model| !model.converged) {
            Some(model) => {
                let name =
                    model.name.as_ref().map_or_else(String::new, |name| format!(" of model \"{name}\""));
                Err(CommandError::Failed(format!("the search{name} has not converged: {}", model.end)))
            }
            None => Ok(()),
        }
    }
}
