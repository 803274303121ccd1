//! The program `fvi`.

use clap::Parser;
use fvi_host::command::Program;
use std::process::ExitCode;

fn main() -> ExitCode {
    Program::parse().execute()
}
