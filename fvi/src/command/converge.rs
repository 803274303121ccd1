//! `fvi converge`: error and order over a sequence of step sizes.

use super::choices::Choice;
use super::progress::Progress;
use super::{CommandError, default_directory, stop, terminal, warn};
use fvi_fft::memory::Engine;
use fvi_host::converge::{ConvergeError, Grids, converge};
use fvi_host::results::files::{write_picture, write_text};
use fvi_host::results::output_directory::OutputDirectory;
use fvi_scenario::language::escape::visible_line;
use fvi_scenario::scenario::Scenario;
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// Arguments of `fvi converge`.
#[derive(Debug, clap::Args)]
pub(crate) struct ConvergeArguments {
    /// The scenario file (TOML)
    scenario: PathBuf,
    /// Levels, FIRST..LAST: on level i the scenario's time is cut into INTERVALS·2^i steps
    #[arg(long, value_name = "FIRST..LAST", default_value = "4..11", value_parser = levels)]
    levels: RangeInclusive<u32>,
    /// Parts of the scenario's time whose ends are grid points on every level, such as the jumps of a force
    #[arg(long, value_name = "INTERVALS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    intervals: u32,
    /// Time from which on errors count: next to a singular start they are larger than the order promises
    #[arg(long, value_name = "TIME", default_value_t = 0.0)]
    from: f64,
    /// Where the files go (default: `out/` and the name of the scenario)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The memory engine, in place of the scenario's
    #[arg(long, value_enum)]
    engine: Option<Choice<Engine>>,
    /// Neither progress nor table on the terminal
    #[arg(long)]
    quiet: bool,
}

impl ConvergeArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let mut scenario = Scenario::read(&self.scenario)?;
        if let Some(Choice(engine)) = self.engine {
            scenario.history.choose(engine);
        }
        warn(scenario.warnings());
        let directory = self.out.unwrap_or_else(|| default_directory(&self.scenario, "converge"));
        let directory = OutputDirectory::claim(&directory)?;
        let stop = stop::flag();
        let grids = Grids { levels: self.levels, intervals: self.intervals as usize, from: self.from };
        let mut progress = None;
        let result = converge(&scenario, &grids, &stop, &mut |made, all| {
            progress.get_or_insert_with(|| Progress::new(all, "steps", self.quiet)).update(made);
        });
        if let Some(progress) = progress {
            progress.finish();
        }
        let convergence = result.map_err(|error| match error {
            ConvergeError::Input(error) => CommandError::Input(error),
            ConvergeError::Stopped => CommandError::Stopped("stopped; nothing was written".to_owned()),
            ConvergeError::NoRoom(_) => CommandError::NoRoom(format!("--levels: {error}")),
            ConvergeError::From(error) => CommandError::Argument(error),
            other => CommandError::Failed(other.to_string()),
        })?;
        warn(convergence.warning());
        write_text(&directory.join("convergence.csv"), &convergence.csv())?;
        write_picture(&directory.join("convergence.svg"), &convergence.chart(&scenario))?;
        if !self.quiet {
            let heading = format!(
                "{}: {}; {}",
                visible_line(scenario.heading()),
                scenario.scheme.describe(),
                scenario.convolution.describe()
            );
            let files = directory.path().display();
            terminal::say(&format!("{heading}\n{}files in {files}\n", convergence.table()))?;
        }
        if convergence.levels.iter().all(|level| level.failure.is_some()) {
            return Err(CommandError::Failed("no level could be run".to_owned()));
        }
        Ok(())
    }
}

/// Reads FIRST..LAST, both ends included.
fn levels(text: &str) -> Result<RangeInclusive<u32>, String> {
    let expected = || "expected FIRST..LAST with 0 ≤ FIRST ≤ LAST ≤ 40, such as 4..11".to_owned();
    let (first, last) = text.split_once("..").ok_or_else(expected)?;
    let last = last.strip_prefix('=').unwrap_or(last);
    let (first, last): (u32, u32) =
        (first.parse().map_err(|_| expected())?, last.parse().map_err(|_| expected())?);
    if first <= last && last <= 40 { Ok(first..=last) } else { Err(expected()) }
}
