//! Judges mutants: does a test notice each of them?
//!
//!     fvi-mutants SOURCES COPY LIST EXPLAINED OUT [--skip PART]... [-- OPTIONS OF `CARGO TEST`...]...
//!
//! LIST is what `cargo mutants --list --json` says in SOURCES. The files that standard input names are copied
//! from there to COPY, where all mutants are compiled at once. Each group of options stands for tests, which
//! judge what has survived those before; tests with PART in their name are left out. EXPLAINED has mutants
//! that need no test. OUT gets a file of names for each verdict, and `summary.txt`.

mod compile;
mod judge;
mod mutant;
mod plant;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use judge::Verdict;

/// Behind the names of files.
const TOTAL: &str = "together";

fn main() {
    let mut arguments = std::env::args().skip(1);
    let mut path = || PathBuf::from(arguments.next().expect("SOURCES COPY LIST EXPLAINED OUT"));
    let [sources, copy, list, explained, out] = [path(), path(), path(), path(), path()];
    let (mut skip, mut groups) = (Vec::new(), Vec::<Vec<String>>::new());
    while let Some(argument) = arguments.next() {
        match (argument.as_str(), groups.last_mut()) {
            ("--", _) => groups.push(Vec::new()),
            (_, Some(group)) => group.push(argument),
            ("--skip", None) => skip.extend(arguments.next()),
            (other, None) => panic!("{other} is not an option"),
        }
    }

    let mutants = mutant::read(&list);
    let names = mutant::lasting_names(&sources, &mutants);
    let explained = mutant::explained(&explained);
    let files = std::io::stdin().lines().map(|line| line.expect("names of files")).collect();
    let tree = plant::Tree { sources, copy, files };
    let mut verdicts: BTreeMap<usize, Verdict> = BTreeMap::new();
    let mut unviable = BTreeSet::new();
    for (round, tests) in groups.iter().enumerate() {
        let settled = |at: &usize| verdicts.get(at).map_or(round > 0, |&verdict| verdict < Verdict::Survived);
        let refused = (0..mutants.len()).filter(settled).collect();
        let planted = compile::compile(&tree, &mutants, refused, tests);
        unviable.extend(planted.unviable.iter().copied());
        let recorded = judge::record(&planted.programs, &out.join("reached"), &skip);
        eprintln!("{} tests, {} mutants", recorded.len(), planted.numbers.len());
        // Mutants of one site have numbers that follow each other; the first stands for the site.
        let site = |at: usize| (&mutants[at].file, mutants[at].start, &mutants[at].genre);
        let mut first = 1;
        for (less_one, &at) in planted.numbers.iter().enumerate() {
            let number = less_one + 1;
            if site(at) != site(planted.numbers[first - 1]) {
                first = number;
            }
            let verdict = judge::judge(&planted.programs, &recorded, first, number);
            if verdict >= Verdict::Survived && !explained.contains_key(&names[at]) {
                println!("{verdict:?}: {}\t{}", mutants[at].name, names[at]);
            }
            // Own tests may reach what those across the crates do not.
            let before = verdicts.get(&at).copied().unwrap_or(verdict);
            verdicts.insert(at, if verdict == Verdict::Unreached { before } else { verdict });
        }
    }

    let mut lists: BTreeMap<&str, String> = BTreeMap::new();
    let mut counts: BTreeMap<&str, BTreeMap<&str, usize>> = BTreeMap::new();
    let known: BTreeSet<&String> = names.iter().collect();
    for (at, mutant) in mutants.iter().enumerate() {
        let verdict = match verdicts.get(&at) {
            Some(Verdict::Caught | Verdict::Endless) if explained.contains_key(&names[at]) => {
                "noticed, but explained"
            }
            Some(Verdict::Caught) => "noticed",
            Some(Verdict::Endless) => "without end",
            Some(_) if explained.contains_key(&names[at]) => "explained",
            Some(_) => "survive",
            None if unviable.contains(&at) => "do not compile",
            None if explained.contains_key(&names[at]) => "explained",
            None => "not judged",
        };
        for of in [mutant.file.as_str(), TOTAL] {
            *counts.entry(of).or_default().entry(verdict).or_default() += 1;
        }
        writeln!(lists.entry(verdict).or_default(), "{}\t{}", mutant.name, names[at]).expect("text");
    }
    for (verdict, names) in &lists {
        fs::write(out.join(verdict.replace(' ', "-").replace(',', "")), names).expect("a folder for results");
    }
    let mut summary = String::new();
    for (file, counts) in &counts {
        let all: usize = counts.values().sum();
        let parts: Vec<String> = counts.iter().map(|(verdict, count)| format!("{count} {verdict}")).collect();
        writeln!(summary, "{file}: {all} mutants, {}", parts.join(", ")).expect("text");
    }
    for (name, reason) in explained.iter().filter(|(name, _)| !known.contains(name)) {
        if mutants.iter().any(|mutant| name.starts_with(&format!("{}:", mutant.file))) {
            eprintln!("explained, but no mutant: {name} ({reason})");
        }
    }
    fs::write(out.join("summary.txt"), summary).expect("a folder for results");
}
