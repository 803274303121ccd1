//! What `cargo mutants --list --json` says of a mutant, and what a list of explained ones calls it.

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::Path;

use serde_json::Value;

/// Line and column, both from one on, as cargo-mutants counts them.
pub type LineColumn = (usize, usize);

/// One change of one place.
#[derive(Clone, Debug)]
pub struct Mutant {
    pub name: String,
    pub file: String,
    pub genre: String,
    pub replacement: String,
    pub start: LineColumn,
    pub end: LineColumn,
    pub returns: String,
}

/// All mutants of a list.
pub fn read(list: &Path) -> Vec<Mutant> {
    let text = fs::read_to_string(list).expect("the list of mutants");
    let list: Vec<Value> = serde_json::from_str(&text).expect("a list in JSON");
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let place = |value: &Value| {
        let number = |key: &str| value[key].as_u64().expect("a place") as usize;
        (number("line"), number("column"))
    };
    let mutant = |value: &Value| Mutant {
        name: text(&value["name"]),
        file: text(&value["file"]),
        genre: text(&value["genre"]),
        replacement: text(&value["replacement"]),
        start: place(&value["span"]["start"]),
        end: place(&value["span"]["end"]),
        returns: text(&value["function"]["return_type"]),
    };
    list.iter().map(mutant).collect()
}

/// Names that outlive changes elsewhere in a file: in place of line and column, the line itself, with what is
/// changed between ‹ and ›.
pub fn lasting_names(root: &Path, mutants: &[Mutant]) -> Vec<String> {
    let mut files: HashMap<&str, Vec<String>> = HashMap::new();
    let name = |mutant: &Mutant, lines: &[String]| {
        let prefix = format!("{}:{}:{}: ", mutant.file, mutant.start.0, mutant.start.1);
        let what = mutant.name.strip_prefix(&prefix).unwrap_or(&mutant.name);
        if mutant.genre == "FnValue" {
            return format!("{}: {what}", mutant.file);
        }
        let line: Vec<char> = lines[mutant.start.0 - 1].chars().collect();
        let end = if mutant.end.0 == mutant.start.0 { mutant.end.1 - 1 } else { line.len() };
        let part = |from: usize, to: usize| line[from..to].iter().collect::<String>();
        let (before, after) = (part(0, mutant.start.1 - 1), part(end, line.len()));
        let changed = part(mutant.start.1 - 1, end);
        format!("{}: {what} at `{}‹{changed}›{}`", mutant.file, before.trim_start(), after.trim_end())
    };
    let mut names = Vec::new();
    for mutant in mutants {
        let lines = files.entry(&mutant.file).or_insert_with(|| {
            let text = fs::read_to_string(root.join(&mutant.file)).expect("a source file");
            text.lines().map(str::to_owned).collect()
        });
        names.push(name(mutant, lines));
    }
    names
}

/// Lasting names of mutants that need no test, each with its reason: the heading above it.
pub fn explained(list: &Path) -> BTreeMap<String, String> {
    let text = fs::read_to_string(list).unwrap_or_default();
    let (mut reason, mut fresh) = (String::new(), false);
    let mut names = BTreeMap::new();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        match line.strip_prefix("# ") {
            Some(more) if fresh => reason = format!("{reason} {more}"),
            Some(begin) => (reason, fresh) = (begin.to_owned(), true),
            None => {
                fresh = false;
                names.insert(line.to_owned(), reason.clone());
            }
        }
    }
    names
}
