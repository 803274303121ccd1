//! The commands of the program, one module each, and their errors and exit codes.

mod choices;
#[cfg(feature = "research")]
pub(crate) mod compare_engines;
pub(crate) mod controller;
pub(crate) mod converge;
pub(crate) mod exponentials;
#[cfg(feature = "research")]
pub(crate) mod extremal;
pub(crate) mod filter;
pub(crate) mod fit;
mod kernel_choice;
mod listing;
mod progress;
pub(crate) mod rates;
#[cfg(feature = "research")]
pub(crate) mod reproduce;
pub(crate) mod response;
pub(crate) mod run;
mod stop;
#[cfg(feature = "research")]
pub(crate) mod strategies;
pub(crate) mod sweep;
mod terminal;
pub(crate) mod tune;
pub(crate) mod weights;

use clap::{Parser, Subcommand};
use fvi_host::checkpoint::CheckpointError;
use fvi_host::results::files::FileError;
use fvi_host::results::output_directory::OutputDirectory;
use fvi_scenario::language::InputError;
use fvi_scenario::language::escape::{short_numbers, visible};
use miette::{GraphicalReportHandler, GraphicalTheme};
use std::io::{ErrorKind, IsTerminal};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Fractional variational integrators with a fast memory.
#[derive(Debug, Parser)]
#[command(name = "fvi", version, about, arg_required_else_help = true)]
pub(crate) struct Program {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Integrate a scenario: data, pictures and a one-line result
    Run(run::RunArguments),
    /// Run one scenario with many values of some of its keys: a table, and pictures over the axes
    Sweep(sweep::SweepArguments),
    /// Error and order of a scenario over step sizes, against its reference or a finer run
    Converge(converge::ConvergeArguments),
    /// Fit numbers of a scenario to data: estimates, how well they are determined, the fitted scenario
    Fit(fit::FitArguments),
    /// Frequency response of a scenario, its poles, and the moduli, creep and relaxation of its kernels
    Response(response::ResponseArguments),
    /// Gains and orders of a fractional controller for a plant, margins, and pictures of the loop
    Tune(tune::TuneArguments),
    /// The figures and tables of the papers, computed again and set beside the printed values
    #[cfg(feature = "research")]
    Reproduce(reproduce::ReproduceArguments),
    /// Solve a two-point fractional Euler–Lagrange problem: the discrete extremal between fixed end points
    #[cfg(feature = "research")]
    Extremal(extremal::ExtremalArguments),
    /// Convolution-quadrature weights, as a table or as constants for firmware
    Weights(weights::WeightsArguments),
    /// Weights as a short head and decaying exponentials, for the exponential-sum memory
    Exponentials(exponentials::ExponentialsArguments),
    /// Rates of the memory for steps of any length, as a table or as a constant for firmware
    Rates(rates::RatesArguments),
    /// Filters of Oustaloup and Matsuda for a power of s: poles, sections or a difference equation
    Filter(filter::FilterArguments),
    /// The controllers of a scenario as constants for firmware: tables of exponentials, and the law
    Controller(controller::ControllerArguments),
    /// Memory engines side by side: agreement, then time per step and memory
    #[cfg(feature = "research")]
    CompareEngines(compare_engines::CompareEnginesArguments),
    /// Strategies for online convolution compared: any kernel, strategies of the literature, your own
    /// programs
    #[cfg(feature = "research")]
    Strategies(strategies::StrategiesArguments),
}

/// Why a command did not complete.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub(crate) enum CommandError {
    /// The input cannot be used: exit code 2.
    #[error(transparent)]
    Input(#[from] InputError),
    /// An argument is outside its range: exit code 2.
    #[error(transparent)]
    Argument(fvi_core::ParameterError),
    /// The request does not fit into memory: exit code 2.
    #[error("{0}")]
    NoRoom(String),
    /// The request does not apply to this input: exit code 2.
    #[error("{0}")]
    Unsuited(String),
    /// The computation failed: exit code 1.
    #[error("{0}")]
    Failed(String),
    /// There is no checkpoint from which the run can continue: exit code 2.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The runs of a sweep cannot be made in this directory, or cannot be joined: exit code 2.
    #[error("{0}")]
    Sweep(String),
    /// A file of results cannot be written: exit code 1; the path is not a directory, or another run is
    /// writing to it: exit code 2.
    #[error(transparent)]
    File(#[from] FileError),
    /// It was stopped by a signal: exit code 130.
    #[error("{0}")]
    Stopped(String),
}

impl Program {
    /// Executes the command line; the exit code is 0 on success, 2 on bad input, 1 when the computation
    /// failed and 130 when it was stopped by a signal.
    pub(crate) fn run() -> ExitCode {
        match Self::try_parse() {
            Ok(program) => program.execute(),
            Err(usage) => match usage.print() {
                // Requested help could not be printed.
                Err(error) if usage.exit_code() == 0 && error.kind() != ErrorKind::BrokenPipe => {
                    ExitCode::FAILURE
                }
                _ => ExitCode::from(usage.exit_code() as u8),
            },
        }
    }

    fn execute(self) -> ExitCode {
        let result = match self.command {
            Command::Run(arguments) => arguments.execute(),
            Command::Sweep(arguments) => arguments.execute(),
            #[cfg(feature = "research")]
            Command::CompareEngines(arguments) => arguments.execute(),
            #[cfg(feature = "research")]
            Command::Strategies(arguments) => arguments.execute(),
            Command::Converge(arguments) => arguments.execute(),
            #[cfg(feature = "research")]
            Command::Reproduce(arguments) => arguments.execute(),
            Command::Response(arguments) => arguments.execute(),
            Command::Fit(arguments) => arguments.execute(),
            Command::Tune(arguments) => arguments.execute(),
            #[cfg(feature = "research")]
            Command::Extremal(arguments) => arguments.execute(),
            Command::Weights(arguments) => arguments.execute(),
            Command::Exponentials(arguments) => arguments.execute(),
            Command::Rates(arguments) => arguments.execute(),
            Command::Filter(arguments) => arguments.execute(),
            Command::Controller(arguments) => arguments.execute(),
        };
        match result {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                terminal::mention(&error.report());
                error.code()
            }
        }
    }
}

impl CommandError {
    fn code(&self) -> ExitCode {
        match self {
            Self::File(error) if OutputDirectory::refuses(error) => ExitCode::from(2),
            Self::Input(_)
            | Self::Argument(_)
            | Self::NoRoom(_)
            | Self::Unsuited(_)
            | Self::Checkpoint(_)
            | Self::Sweep(_) => ExitCode::from(2),
            Self::Failed(_) | Self::File(_) => ExitCode::from(1),
            Self::Stopped(_) => ExitCode::from(stop::STOPPED),
        }
    }

    /// Text for standard error.
    fn report(&self) -> String {
        let Self::Input(error) = self else {
            return short_numbers(&visible(&format!("fvi: {self}\n"))).into_owned();
        };
        let theme = if std::io::stderr().is_terminal() {
            GraphicalTheme::default()
        } else {
            GraphicalTheme::unicode_nocolor()
        };
        // Lines are not wrapped, so that tools can search for a message.
        let handler = GraphicalReportHandler::new_themed(theme).with_width(usize::MAX).with_context_lines(1);
        let mut report = String::new();
        match handler.render_report(&mut report, error) {
            Ok(()) => report,
            Err(_) => format!("fvi: {error}\n"),
        }
    }
}

/// Prints warnings on standard error.
fn warn(warnings: impl IntoIterator<Item = String>) {
    for warning in warnings {
        terminal::mention(&format!("warning: {}\n", short_numbers(&visible(&warning))));
    }
}

/// Default output directory for an input file: `out/` and the file's name without its extension.
fn default_directory(input: &Path, command: &str) -> PathBuf {
    let stem = input.file_stem().unwrap_or_default();
    // A name of dots alone, as of `...toml`, would lead out of the directory.
    let only_dots = stem.as_encoded_bytes().iter().all(|&byte| byte == b'.');
    Path::new("out").join(if only_dots { command.as_ref() } else { stem })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_directory_of_a_file_lies_below_out() {
        for (file, directory) in [
            ("a/plate.toml", "out/plate"),
            ("...toml", "out/run"),
            ("..toml", "out/run"),
            (".toml", "out/.toml"),
        ] {
            assert_eq!(default_directory(Path::new(file), "run"), Path::new(directory), "{file}");
        }
    }
}
