//! `fvi reproduce`: the figures and tables of the papers, computed again.

use super::progress::Progress;
use super::{CommandError, stop, terminal};
use clap::builder::PossibleValuesParser;
use fvi_exhibits::reproduce::{Exhibit, Findings, PAGE, ReproduceError, exhibits, write};
use fvi_host::results::output_directory::OutputDirectory;
use std::path::PathBuf;

/// Arguments of `fvi reproduce`.
#[derive(Debug, clap::Args)]
pub(crate) struct ReproduceArguments {
    /// Exhibits, or `all` but `accuracy`, which has a page of its own; without any, their names are listed
    #[arg(value_name = "NAME", value_parser = names(), hide_possible_values = true)]
    names: Vec<String>,
    /// Where the files go
    #[arg(long, value_name = "DIR", default_value = "out/reproduction")]
    out: PathBuf,
    /// Neither progress nor result on the terminal
    #[arg(long)]
    quiet: bool,
}

/// The name for all exhibits of the page `reproduction.md`; other pages have names of their own.
const ALL: &str = "all";

fn names() -> PossibleValuesParser {
    exhibits().iter().map(|exhibit| exhibit.name).chain([ALL]).collect::<Vec<_>>().into()
}

impl ReproduceArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let named = |exhibit: &Exhibit, name: &str| match name {
            ALL => exhibit.page == PAGE,
            name => name == exhibit.name,
        };
        let wanted = |exhibit: &Exhibit| self.names.iter().any(|name| named(exhibit, name));
        let chosen: Vec<Exhibit> = exhibits().into_iter().filter(wanted).collect();
        if chosen.is_empty() {
            return terminal::say(&list());
        }
        let directory = OutputDirectory::claim(&self.out)?;
        let stop = stop::flag();
        let mut progress = Progress::new(chosen.len(), "exhibits", self.quiet);
        let mut found: Vec<(Exhibit, Findings)> = Vec::new();
        for exhibit in chosen {
            progress.update(found.len());
            let findings = (exhibit.compute)(&stop).map_err(|error| match error {
                ReproduceError::Stopped => CommandError::Stopped("stopped; nothing was written".to_owned()),
                other => CommandError::Failed(format!("{}: {other}", exhibit.name)),
            })?;
            found.push((exhibit, findings));
        }
        progress.finish();
        write(&found, &directory)?;
        if !self.quiet {
            let comparisons: String =
                found.iter().map(|(exhibit, findings)| comparisons(exhibit, findings)).collect();
            let mut pages: Vec<&str> = found.iter().map(|(exhibit, _)| exhibit.page).collect();
            pages.dedup();
            let pages: Vec<String> =
                pages.into_iter().map(|page| self.out.join(page).display().to_string()).collect();
            terminal::say(&format!("{comparisons}{} exhibits; page: {}\n", found.len(), pages.join(", ")))?;
        }
        Ok(())
    }
}

fn list() -> String {
    let exhibits = exhibits();
    let width = exhibits.iter().map(|exhibit| exhibit.name.len()).max().unwrap_or(0);
    exhibits.iter().map(|exhibit| format!("{:width$}  {}\n", exhibit.name, exhibit.heading())).collect()
}

fn comparisons(exhibit: &Exhibit, findings: &Findings) -> String {
    let mut text = format!("{}: {}\n", exhibit.name, exhibit.heading());
    for comparison in &findings.comparisons {
        text += &format!("  {}: paper {}, here {}\n", comparison.quantity, comparison.paper, comparison.ours);
    }
    text
}
