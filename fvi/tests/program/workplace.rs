//! Runs the program `fvi` in a directory of its own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A directory of its own, and the program started in it.
pub(crate) struct Workplace(tempfile::TempDir);

impl Workplace {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    /// Names of everything in the directory.
    pub(crate) fn files(&self) -> Vec<String> {
        let name = |entry: std::io::Result<fs::DirEntry>| entry.unwrap().file_name().into_string().unwrap();
        let mut names: Vec<String> = fs::read_dir(self.0.path()).unwrap().map(name).collect();
        names.sort();
        names
    }

    pub(crate) fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_fvi"));
        command.args(arguments).current_dir(self.0.path());
        command
    }

    pub(crate) fn fvi(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Runs `fvi` with what the shell does to it, such as `fvi run s.toml | true`.
    pub(crate) fn shell(&self, line: &str) -> Output {
        let function = format!("fvi() {{ '{}' \"$@\"; }}; {line}", env!("CARGO_BIN_EXE_fvi"));
        Command::new("bash").args(["-c", &function]).current_dir(self.path("")).output().unwrap()
    }

    /// Runs a scenario given as text into `out`, which must succeed.
    pub(crate) fn run(&self, scenario: &str, arguments: &[&str]) -> Run {
        self.write("scenario.toml", scenario);
        let output = self.fvi(&[&["run", "scenario.toml", "--out", "out"], arguments].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        Run::read(&self.path("out"))
    }
}

pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// What a run has written.
pub(crate) struct Run {
    pub(crate) columns: Vec<String>,
    pub(crate) rows: Vec<Vec<f64>>,
    pub(crate) summary: serde_json::Value,
}

impl Run {
    pub(crate) fn read(directory: &Path) -> Self {
        let table = fs::read_to_string(directory.join("trajectory.csv")).unwrap();
        let mut lines = table.lines();
        let columns = lines.next().unwrap().split(',').map(str::to_owned).collect();
        let row = |line: &str| line.split(',').map(|cell| cell.parse().unwrap()).collect();
        let rows = lines.map(row).collect();
        let summary =
            serde_json::from_str(&fs::read_to_string(directory.join("summary.json")).unwrap()).unwrap();
        Self { columns, rows, summary }
    }

    pub(crate) fn column(&self, name: &str) -> Vec<f64> {
        let index = self.columns.iter().position(|column| column == name).unwrap();
        self.rows.iter().map(|row| row[index]).collect()
    }
}
