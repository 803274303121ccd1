//! Compiles the planted sources, and takes out what the compiler refuses.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::mutant::Mutant;
use crate::plant::{Tree, plant};

/// A program of tests, and the folder that it expects to run in.
pub struct Program {
    pub path: PathBuf,
    pub folder: PathBuf,
}

pub struct Planted {
    pub programs: Vec<Program>,
    /// Position in the list of mutants, by number less one.
    pub numbers: Vec<usize>,
    /// Mutants that cannot be compiled at all.
    pub unviable: BTreeSet<usize>,
}

/// Codes of errors that the plain mutant has as well: an operator or a value that the type does not have, or
/// a constant that has no value.
const OF_TYPES: [&str; 17] = [
    "E0277", "E0308", "E0369", "E0600", "E0067", "E0368", "E0015", "E0433", "E0425", "E0061", "E0283",
    "E0282", "E0107", "E0423", "E0599", "E0614", "E0080",
];

/// Plants all mutants but those that are `refused`, and compiles until nothing more is.
pub fn compile(tree: &Tree, mutants: &[Mutant], mut refused: BTreeSet<usize>, tests: &[String]) -> Planted {
    let mut unviable = BTreeSet::new();
    let given = refused.len();
    loop {
        let numbers = plant(tree, mutants, &refused);
        let (programs, errors) = build(&tree.copy, tests);
        if errors.is_empty() {
            return Planted { programs, numbers, unviable };
        }
        let mut files: BTreeMap<String, Vec<String>> = BTreeMap::new();
        let before = refused.len();
        for error in &errors {
            let Some(mutant) = culprit(&tree.copy, error, &mut files).map(|number| numbers[number - 1])
            else {
                continue;
            };
            refused.insert(mutant);
            let code = error["code"]["code"].as_str().unwrap_or_default();
            if OF_TYPES.contains(&code) {
                unviable.insert(mutant);
            }
        }
        eprintln!("{} mutants do not compile", refused.len() - given);
        if refused.len() == before {
            for error in errors.iter().take(5) {
                eprintln!("{}", error["rendered"].as_str().unwrap_or_default());
            }
            panic!("these errors belong to no mutant");
        }
    }
}

/// The number of the mutant on the lines that an error points at.
fn culprit(root: &Path, error: &Value, files: &mut BTreeMap<String, Vec<String>>) -> Option<usize> {
    let spans = error["spans"].as_array()?;
    let (primary, others): (Vec<&Value>, Vec<&Value>) =
        spans.iter().partition(|span| span["is_primary"].as_bool() == Some(true));
    primary.into_iter().chain(others).find_map(|span| {
        let file = span["file_name"].as_str()?;
        let lines = files.entry(file.to_owned()).or_insert_with(|| {
            let text = fs::read_to_string(root.join(file)).unwrap_or_default();
            text.lines().map(str::to_owned).collect()
        });
        let line = lines.get(span["line_start"].as_u64()? as usize - 1)?;
        let number = line.split("__mutants::chosen(").nth(1)?.split(')').next()?;
        number.parse().ok()
    })
}

fn build(root: &Path, tests: &[String]) -> (Vec<Program>, Vec<Value>) {
    let mut child = Command::new("cargo")
        .args(["test", "--no-run", "--message-format", "json"])
        .args(tests)
        .current_dir(root)
        .stdout(Stdio::piped())
        .spawn()
        .expect("cargo");
    let (mut programs, mut errors) = (Vec::new(), Vec::new());
    for line in BufReader::new(child.stdout.take().expect("its output")).lines() {
        let Ok(message) = serde_json::from_str::<Value>(&line.expect("text")) else { continue };
        if message["message"]["level"] == "error" && message["message"]["spans"][0].is_object() {
            errors.push(message["message"].clone());
        }
        if let (Some(path), Some(manifest)) =
            (message["executable"].as_str(), message["manifest_path"].as_str())
        {
            let folder = Path::new(manifest).parent().expect("a folder").to_owned();
            programs.push(Program { path: path.into(), folder });
        }
    }
    let done = child.wait().expect("an end").success();
    assert!(done || !errors.is_empty(), "cargo test --no-run failed");
    (programs, errors)
}
