//! The program `fvi`.

mod command;

use command::Program;
use std::process::ExitCode;

fn main() -> ExitCode {
    Program::run()
}
