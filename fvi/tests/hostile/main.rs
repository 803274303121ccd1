//! Hostile input: mutations of a corpus of scenarios, problems, sweeps, expressions, tables, matrices,
//! archives and checkpoints. Nothing may panic, every refusal says something short, and a result that is
//! called one holds finite numbers only.
//!
//! `FVI_HOSTILE_RUNS` inputs of each kind are tried, from `FVI_HOSTILE_SEED`; `.ci/fuzz` sets them. An input
//! that fails is reported with its text; the one under way lies in the directory `FVI_HOSTILE_LAST`, if that
//! is set, for what aborts the process.

mod archives;
mod checkpoints;
mod corpus;
mod domains;
mod mutation;

use mutation::Generator;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

/// What became of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Outcome {
    /// It was refused with a message.
    Refused,
    /// It was understood, and what was computed of it failed with a message.
    Failed,
    /// It gave a result.
    Done,
}

/// A kind of input: its corpus, and what is done with each.
struct Domain {
    name: &'static str,
    corpus: Vec<String>,
    /// What became of the input; an error says which promise was broken.
    attempt: fn(&str) -> Result<Outcome, String>,
}

fn number(variable: &str, otherwise: u64) -> u64 {
    std::env::var(variable).ok().and_then(|text| text.parse().ok()).unwrap_or(otherwise)
}

/// Tries the corpus itself and mutations of it.
fn assail(domain: &Domain) {
    let (runs, seed) = (number("FVI_HOSTILE_RUNS", 300), number("FVI_HOSTILE_SEED", 1));
    let last = std::env::var_os("FVI_HOSTILE_LAST")
        .map(|directory| std::path::Path::new(&directory).join(domain.name));
    let mut generator = Generator::new(seed);
    let mut counts: BTreeMap<Outcome, u64> = BTreeMap::new();
    let mut slowest = (Duration::ZERO, String::new());
    let mutants = (0..runs).map(|_| mutation::mutant(&domain.corpus, &mut generator));
    for (index, input) in domain.corpus.iter().cloned().chain(mutants).enumerate() {
        if let Some(last) = &last {
            std::fs::write(last, &input).unwrap();
        }
        let start = Instant::now();
        let result = catch_unwind(AssertUnwindSafe(|| (domain.attempt)(&input)));
        let elapsed = start.elapsed();
        let outcome = match result {
            Ok(Ok(outcome)) => outcome,
            Ok(Err(broken)) => panic!("{}, input {index} of seed {seed}: {broken}\n{input}", domain.name),
            Err(_) => panic!("{}, input {index} of seed {seed} panics:\n{input}", domain.name),
        };
        *counts.entry(outcome).or_default() += 1;
        if elapsed > slowest.0 {
            slowest = (elapsed, input);
        }
    }
    let count = |outcome| counts.get(&outcome).copied().unwrap_or(0);
    println!(
        "{}: {} inputs: {} refused, {} failed, {} done; slowest {:?}",
        domain.name,
        domain.corpus.len() as u64 + runs,
        count(Outcome::Refused),
        count(Outcome::Failed),
        count(Outcome::Done),
        slowest.0,
    );
    if let Some(last) = last {
        std::fs::write(last.with_extension("slowest"), slowest.1).unwrap();
    }
    assert!(count(Outcome::Done) > 0, "{}: nothing came through: the corpus is stale", domain.name);
    assert!(count(Outcome::Refused) > 0 || runs == 0, "{}: nothing was refused", domain.name);
}

#[test]
fn expressions() {
    assail(&domains::expressions());
}

#[test]
fn scenarios() {
    assail(&domains::scenarios());
}

#[test]
fn problems() {
    assail(&domains::problems());
}

#[test]
fn tables() {
    assail(&domains::tables());
}

#[test]
fn matrices() {
    assail(&domains::matrices());
}

#[test]
fn archives() {
    archives::assail();
}

#[test]
fn sweeps() {
    assail(&domains::sweeps());
}

#[test]
fn checkpoints() {
    checkpoints::assail();
}
