//! `fvi reproduce`: the figures and tables of the papers, computed again.

use super::CommandError;
use crate::reproduce::{Exhibit, Findings, PAGE, ReproduceError, exhibits, write};
use clap::builder::PossibleValuesParser;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

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
        let mut progress = Progress::new(chosen.len(), self.quiet);
        let mut found: Vec<(Exhibit, Findings)> = Vec::new();
        for exhibit in chosen {
            progress.begin(found.len(), exhibit.name);
            let findings = (exhibit.compute)(&STOP).map_err(|error| match error {
                ReproduceError::Stopped => CommandError::Stopped("stopped; nothing was written".to_owned()),
                other => CommandError::Failed(format!("{}: {other}", exhibit.name)),
            })?;
            found.push((exhibit, findings));
        }
        progress.finish();
        write(&found, &self.out).map_err(|error| CommandError::Failed(error.to_string()))?;
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

/// A progress bar over the exhibits that appears on a terminal once they have taken about a second.
struct Progress {
    exhibits: usize,
    start: Instant,
    wanted: bool,
    bar: Option<ProgressBar>,
}

impl Progress {
    fn new(exhibits: usize, quiet: bool) -> Self {
        let wanted = !quiet && std::io::stderr().is_terminal();
        Self { exhibits, start: Instant::now(), wanted, bar: None }
    }

    fn begin(&mut self, done: usize, name: &'static str) {
        if !self.wanted {
            return;
        }
        if self.bar.is_none() && self.start.elapsed() > Duration::from_secs(1) {
            let bar = ProgressBar::with_draw_target(Some(self.exhibits as u64), ProgressDrawTarget::stderr());
            self.bar = Some(match ProgressStyle::with_template("{bar:40} {pos}/{len} exhibits, {msg}") {
                Ok(style) => bar.with_style(style),
                Err(_) => bar,
            });
        }
        if let Some(bar) = &self.bar {
            bar.set_position(done as u64);
            bar.set_message(name);
        }
    }

    fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
