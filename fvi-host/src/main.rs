//! The program `fvi`.

use fvi_host::command::Program;
use std::process::ExitCode;

fn main() -> ExitCode {
    Program::run()
}
