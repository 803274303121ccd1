//! `fvi reproduce`: the figures and tables of the papers, computed again.

use super::CommandError;
use super::progress::Progress;
use crate::reproduce::{Exhibit, Findings, PAGE, ReproduceError, exhibits, write};
use clap::builder::PossibleValuesParser;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

/// Arguments of `fvi reproduce`.
#[derive(Debug, clap::Args)]
pub struct ReproduceArguments {
    /// Exhibits, or `all` of them; without any, their names are listed
    #[arg(value_name = "NAME", value_parser = names(), hide_possible_values = true)]
    names: Vec<String>,
    /// Where the files go
    #[arg(long, value_name = "DIR", default_value = "out/reproduction")]
    out: PathBuf,
    /// Neither progress nor result on the terminal
    #[arg(long)]
    quiet: bool,
}

/// The word for all exhibits.
const ALL: &str = "all";

fn names() -> PossibleValuesParser {
    exhibits().iter().map(|exhibit| exhibit.name).chain([ALL]).collect::<Vec<_>>().into()
}

/// Set by Ctrl-C; ends the computation after the step under way.
static STOP: AtomicBool = AtomicBool::new(false);

impl ReproduceArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let wanted = |exhibit: &Exhibit| self.names.iter().any(|name| name == ALL || name == exhibit.name);
        let chosen: Vec<Exhibit> = exhibits().into_iter().filter(wanted).collect();
        if chosen.is_empty() {
            print_list();
            return Ok(());
        }
        // Without the handler Ctrl-C still ends the program, only less tidily.
        let _ = ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed));
        let mut progress = Progress::new(chosen.len(), "exhibits", self.quiet);
        let mut found: Vec<(Exhibit, Findings)> = Vec::new();
        for exhibit in chosen {
            progress.update(found.len());
            let findings = (exhibit.compute)(&STOP).map_err(|error| match error {
                ReproduceError::Stopped => CommandError::Stopped("stopped; nothing was written".to_owned()),
                other => CommandError::Failed(format!("{}: {other}", exhibit.name)),
            })?;
            found.push((exhibit, findings));
        }
        progress.finish();
        write(&found, &self.out)?;
        if !self.quiet {
            for (exhibit, findings) in &found {
                print_comparisons(exhibit, findings);
            }
            println!("{} exhibits; page: {}", found.len(), self.out.join(PAGE).display());
        }
        Ok(())
    }
}

fn print_list() {
    let exhibits = exhibits();
    let width = exhibits.iter().map(|exhibit| exhibit.name.len()).max().unwrap_or(0);
    for exhibit in &exhibits {
        println!("{:width$}  {}", exhibit.name, exhibit.heading());
    }
}

fn print_comparisons(exhibit: &Exhibit, findings: &Findings) {
    println!("{}: {}", exhibit.name, exhibit.heading());
    for comparison in &findings.comparisons {
        println!("  {}: paper {}, here {}", comparison.quantity, comparison.paper, comparison.ours);
    }
}
