//! `fvi response`: frequency response, poles, and the moduli of kernels.

use super::progress::Progress;
use super::{CommandError, default_directory, stop, terminal, warn};
use fvi_host::response::{MODES, POINTS, ResponseError, ResponseOptions, respond};
use fvi_host::results::output_directory::OutputDirectory;
use fvi_scenario::language::escape::visible_line;
use fvi_scenario::scenario::Scenario;
use std::path::PathBuf;

/// Arguments of `fvi response`.
#[derive(Debug, clap::Args)]
pub(crate) struct ResponseArguments {
    /// The scenario file (TOML)
    scenario: PathBuf,
    /// The first angular frequency (default: 2π over the time of the scenario)
    #[arg(long, value_name = "OMEGA", allow_negative_numbers = true)]
    from: Option<f64>,
    /// The last angular frequency (default: π over the step of the scenario)
    #[arg(long, value_name = "OMEGA", allow_negative_numbers = true)]
    to: Option<f64>,
    /// Number of frequencies, equidistant on a logarithmic scale
    #[arg(long, default_value_t = POINTS)]
    points: usize,
    /// The coordinate on which the force acts, from 0
    #[arg(long, value_name = "COORDINATE", default_value_t = 0)]
    input: usize,
    /// The coordinate whose displacement is computed, from 0
    #[arg(long, value_name = "COORDINATE", default_value_t = 0)]
    output: usize,
    /// The point about which the system is linearised (default: its initial position)
    #[arg(long, value_name = "Q0,Q1,…", value_delimiter = ',', allow_negative_numbers = true)]
    position: Option<Vec<f64>>,
    /// Angular frequencies near which damped modes are sought, of systems of any size
    #[arg(long, value_name = "OMEGA,…", value_delimiter = ',', allow_negative_numbers = true)]
    near: Vec<f64>,
    /// Number of modes near each of them
    #[arg(long, value_name = "NUMBER", default_value_t = MODES, requires = "near")]
    modes: usize,
    /// Without the response of the discrete scheme, which takes as long as the response itself
    #[arg(long)]
    no_discrete: bool,
    /// Where the files go (default: `out/` and the name of the scenario)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Neither progress nor result on the terminal
    #[arg(long)]
    quiet: bool,
}

/// Largest number of poles shown on the terminal.
const MOST_SHOWN: usize = 6;

impl ResponseArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let scenario = Scenario::read(&self.scenario)?;
        let directory = self.out.unwrap_or_else(|| default_directory(&self.scenario, "response"));
        let options = ResponseOptions {
            from: self.from,
            to: self.to,
            points: self.points,
            input: self.input,
            output: self.output,
            position: self.position,
            near: self.near,
            modes: self.modes,
            discrete: !self.no_discrete,
            ..ResponseOptions::default()
        };
        let stop = stop::flag();
        let mut progress = None;
        let result = respond(&scenario, &options, &stop, &mut |done, all| {
            progress.get_or_insert_with(|| Progress::new(all, "frequencies", self.quiet)).update(done);
        });
        if let Some(progress) = progress {
            progress.finish();
        }
        let found = result.map_err(|error| match error {
            ResponseError::Input(error) => CommandError::Input(error),
            ResponseError::Argument(error) => CommandError::Argument(error),
            ResponseError::Position { .. } => CommandError::Unsuited(error.to_string()),
            ResponseError::NoRoom { .. } => CommandError::NoRoom(format!("--points: {error}")),
            ResponseError::Stopped => CommandError::Stopped("stopped; nothing was written".to_owned()),
            other => CommandError::Failed(other.to_string()),
        })?;
        let directory = OutputDirectory::claim(&directory)?;
        found.write(&scenario, &options, &directory)?;
        for note in found.left_out() {
            terminal::mention(&format!("note: no {note}\n"));
        }
        warn(found.warnings.iter().cloned());
        if !self.quiet {
            let mut line = format!("{}: {} frequencies", visible_line(scenario.heading()), found.omega.len());
            if let Ok(poles) = &found.poles {
                let shown = poles
                    .iter()
                    .take(MOST_SHOWN)
                    .map(|pole| format!("{:.6e} (damping {:.3e})", pole.frequency(), pole.damping()));
                let more = if poles.len() > MOST_SHOWN { ", …" } else { "" };
                let list: Vec<String> = shown.collect();
                line += &match list.is_empty() {
                    true => "; no poles but at s = 0".to_owned(),
                    false => format!("; poles at ω = {}{more}", list.join(", ")),
                };
            }
            if !found.modes.is_empty() {
                let shown = found.modes.iter().take(MOST_SHOWN);
                let list: Vec<String> = shown
                    .map(|(_, mode)| format!("{:.6e} (damping {:.3e})", mode.frequency(), mode.damping()))
                    .collect();
                let more = if found.modes.len() > MOST_SHOWN { ", …" } else { "" };
                line += &format!("; modes at ω = {}{more}", list.join(", "));
            }
            terminal::say(&format!("{line}; files in {}\n", directory.path().display()))?;
        }
        Ok(())
    }
}
