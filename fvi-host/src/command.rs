//! The commands of the program, one module each, and what they share: how they end.

pub mod compare_engines;
pub mod converge;
pub mod exponentials;
pub mod extremal;
mod listing;
mod progress;
pub mod reproduce;
pub mod run;
pub mod weights;

use crate::files::FileError;
use crate::scenario::InputError;
use clap::{Parser, Subcommand};
use miette::{GraphicalReportHandler, GraphicalTheme};
use std::io::IsTerminal;
use std::process::ExitCode;

/// Fractional variational integrators with a fast memory.
#[derive(Debug, Parser)]
#[command(name = "fvi", version, about, arg_required_else_help = true)]
pub struct Program {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Integrate a scenario: data, pictures and a line of result
    Run(run::RunArguments),
    /// Error and order of a scenario over step sizes, against its reference or a finer run
    Converge(converge::ConvergeArguments),
    /// The figures and tables of the papers, computed again and set beside the printed values
    Reproduce(reproduce::ReproduceArguments),
    /// Solve a two-point fractional Euler–Lagrange problem: the discrete extremal between fixed end points
    Extremal(extremal::ExtremalArguments),
    /// Convolution-quadrature weights, as a table or as constants for firmware
    Weights(weights::WeightsArguments),
    /// Weights as a short head and decaying exponentials, for the exponential-sum memory
    Exponentials(exponentials::ExponentialsArguments),
    /// Memory engines side by side: agreement, then time per step and memory
    CompareEngines(compare_engines::CompareEnginesArguments),
}

/// How a command that did not do all it was asked to ended.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CommandError {
    /// The input cannot be used: exit code 2.
    #[error(transparent)]
    Input(#[from] InputError),
    /// An argument is outside its range: exit code 2.
    #[error(transparent)]
    Argument(fvi_core::ParameterError),
    /// The computation failed: exit code 1.
    #[error("{0}")]
    Failed(String),
    /// A file of results cannot be written: exit code 1.
    #[error(transparent)]
    File(#[from] FileError),
    /// It was stopped by Ctrl-C: exit code 130.
    #[error("{0}")]
    Stopped(String),
}

impl Program {
    /// Does what the command line says; the exit code is 0 when all is done, 2 on bad input, 1 when the
    /// computation failed and 130 when it was stopped by Ctrl-C.
    pub fn execute(self) -> ExitCode {
        let result = match self.command {
            Command::Run(arguments) => arguments.execute(),
            Command::CompareEngines(arguments) => arguments.execute(),
            Command::Converge(arguments) => arguments.execute(),
            Command::Reproduce(arguments) => arguments.execute(),
            Command::Extremal(arguments) => arguments.execute(),
            Command::Weights(arguments) => arguments.execute(),
            Command::Exponentials(arguments) => arguments.execute(),
        };
        match result {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprint!("{}", error.report());
                error.code()
            }
        }
    }
}

impl CommandError {
    fn code(&self) -> ExitCode {
        match self {
            Self::Input(_) | Self::Argument(_) => ExitCode::from(2),
            Self::Failed(_) | Self::File(_) => ExitCode::from(1),
            Self::Stopped(_) => ExitCode::from(130),
        }
    }

    /// What is written to standard error.
    fn report(&self) -> String {
        let Self::Input(error) = self else { return format!("fvi: {self}\n") };
        let theme = if std::io::stderr().is_terminal() {
            GraphicalTheme::default()
        } else {
            GraphicalTheme::unicode_nocolor()
        };
        // Lines are not wrapped: a message that tools search stays in one piece.
        let handler = GraphicalReportHandler::new_themed(theme).with_width(usize::MAX).with_context_lines(1);
        let mut report = String::new();
        match handler.render_report(&mut report, error) {
            Ok(()) => report,
            Err(_) => format!("fvi: {error}\n"),
        }
    }
}

/// Says on standard error what makes a result other than it may seem.
fn warn(warnings: impl IntoIterator<Item = String>) {
    for warning in warnings {
        eprintln!("warning: {warning}");
    }
}
