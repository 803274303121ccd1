//! Checkpoints that were damaged on the disk, and such that somebody forged: their checksums fit.
//!
//! What is damaged is refused, or the run goes on from the checkpoint before and leaves the bytes that it
//! would have left. A forgery may say what it likes, but neither panics nor takes memory by a length that it
//! claims.

use super::mutation::Generator;
use super::{Outcome, number};
use fvi_host::checkpoint::{CheckpointEvery, is_readable};
use fvi_host::run::{RunEnd, RunOptions, run};
use fvi_scenario::scenario::Scenario;
use serde_json::json;
use std::collections::BTreeMap;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use tempfile::TempDir;

const STATE: &str = "checkpoint.fvi";
const PICTURES: &str = "checkpoint.pictures.fvi";

/// One input in so many is gone on with; all are read.
const RESUMED: usize = 16;

/// A run that was killed in the middle, and what it would have left.
struct Killed {
    scenario: Scenario,
    directory: TempDir,
    trajectory: Vec<u8>,
}

impl Killed {
    fn new(engine: &str, potential: &str) -> Self {
        let scenario = Scenario::from_value(&json!({
            "system": {
                "mass": [1.0],
                "potential": potential,
                "damping": [{ "order": 0.5, "coefficient": [0.1] }],
            },
            "initial": { "position": [1.0], "momentum": [0.0] },
            "time": { "step": 0.05, "steps": 60 },
            "history": { "engine": engine },
        }))
        .unwrap();
        let directory = tempfile::tempdir().unwrap();
        let stop = AtomicBool::new(false);
        run(&scenario, &RunOptions::new(directory.path()), &stop, &mut |_| ()).unwrap();
        let trajectory = fs::read(directory.path().join("trajectory.csv")).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let killed = catch_unwind(AssertUnwindSafe(|| {
            run(&scenario, &options(directory.path()), &stop, &mut |steps| {
                if steps == 41 {
                    resume_unwind(Box::new("killed"));
                }
            })
        }));
        assert!(killed.is_err());
        Self { scenario, directory, trajectory }
    }

    fn file(&self, name: &str) -> Vec<u8> {
        fs::read(self.directory.path().join(name)).unwrap()
    }

    /// Goes on with files in place of the killed run's own; whether it came to its end, with the trajectory
    /// of a run that was not disturbed.
    fn resume(&self, files: &BTreeMap<&str, Vec<u8>>) -> Option<bool> {
        let place = tempfile::tempdir().unwrap();
        for entry in fs::read_dir(self.directory.path()).unwrap() {
            let entry = entry.unwrap();
            let name = entry.file_name().into_string().unwrap();
            let bytes = files.get(name.as_str()).cloned();
            let bytes = bytes.unwrap_or_else(|| fs::read(entry.path()).unwrap());
            fs::write(place.path().join(name), bytes).unwrap();
        }
        let summary = run(&self.scenario, &options(place.path()), &AtomicBool::new(false), &mut |_| ());
        let ended = summary.ok()?.end == RunEnd::Completed;
        Some(ended && fs::read(place.path().join("trajectory.csv")).unwrap() == self.trajectory)
    }
}

fn options(directory: &Path) -> RunOptions {
    RunOptions { checkpoints: CheckpointEvery::Steps(10), resume: true, ..RunOptions::new(directory) }
}

/// Changes bytes as a bad disk does, or as someone who means harm; `other` is a file of the same kind.
pub(crate) fn change(bytes: &mut Vec<u8>, other: &[u8], generator: &mut Generator) {
    let place = generator.below(bytes.len() + 1);
    let end = (place + generator.below(40)).min(bytes.len());
    match generator.below(6) {
        0 => {
            if let Some(byte) = bytes.get_mut(place) {
                *byte ^= 1 << generator.below(8);
            }
        }
        1 => bytes.truncate(place),
        2 => drop(bytes.drain(place..end)),
        3 => {
            let part = bytes[place..end].to_vec();
            bytes.splice(place..place, part);
        }
        4 => {
            // A length, wherever lengths may stand.
            let lengths = [0, 1, u64::MAX, 1 << 40, 1 << 62, bytes.len() as u64, u64::from(u32::MAX)];
            let length = lengths[generator.below(lengths.len())].to_le_bytes();
            bytes.iter_mut().skip(place).zip(length).for_each(|(place, byte)| *place = byte);
        }
        _ => {
            let from = generator.below(other.len());
            let to = (from + generator.below(400)).min(other.len());
            bytes.splice(place..end, other[from..to].iter().copied());
        }
    }
}

/// Makes all checksums fit, as far as lengths lead.
fn seal(bytes: &mut [u8]) {
    let Some(count) = bytes.get(12..16).map(|count| u32::from_le_bytes(count.try_into().unwrap())) else {
        return;
    };
    let mut start = 0;
    let mut length = 16;
    for _ in 0..=count {
        let Some(end) = usize::try_from(length).ok().and_then(|length: usize| length.checked_add(start))
        else {
            return;
        };
        let Some((content, rest)) = bytes.split_at_mut_checked(end) else { return };
        let Some(place) = rest.first_chunk_mut::<4>() else { return };
        *place = crc32fast::hash(&content[start..]).to_le_bytes();
        start = end + 4;
        let Some(label) = bytes.get(start + 4..start + 12) else { return };
        length = u64::from_le_bytes(label.try_into().unwrap()).saturating_add(12);
    }
}

/// Tries damaged and forged checkpoints, as many as the other kinds of input.
pub(crate) fn assail() {
    let (runs, seed) = (number("FVI_HOSTILE_RUNS", 300) as usize, number("FVI_HOSTILE_SEED", 1));
    let mut generator = Generator::new(seed);
    let killed = [
        Killed::new("direct", "1 - cos(q0)"),
        Killed::new("exponential-sum", "0.5*q0^2"),
        Killed::new("block-fft", "1 - cos(q0)"),
        Killed::new("real-time", "0.5*q0^2"),
    ];
    let whole: Vec<[Vec<u8>; 2]> =
        killed.iter().map(|killed| [STATE, PICTURES].map(|name| killed.file(name))).collect();
    for (killed, [state, pictures]) in killed.iter().zip(&whole) {
        assert!(is_readable(state, pictures));
        assert_eq!(killed.resume(&BTreeMap::new()), Some(true));
    }
    let mut counts: BTreeMap<Outcome, usize> = BTreeMap::new();
    for index in 0..runs {
        let which = generator.below(killed.len());
        let other = generator.below(killed.len());
        let forged = generator.below(2) == 0;
        let file = generator.below(2);
        let mut files = whole[which].clone();
        for _ in 0..=generator.below(3) {
            change(&mut files[file], &whole[other][file], &mut generator);
        }
        if forged {
            seal(&mut files[file]);
        }
        let changed = files != whole[which];
        let attempt = || {
            let [state, pictures] = &files;
            let readable = is_readable(state, pictures);
            assert!(
                forged || readable != changed,
                "damage is taken for a whole checkpoint, or the other way round"
            );
            if index % RESUMED != 0 {
                return if readable { Outcome::Done } else { Outcome::Refused };
            }
            let files = BTreeMap::from([(STATE, state.clone()), (PICTURES, pictures.clone())]);
            match killed[which].resume(&files) {
                None if forged => Outcome::Refused,
                None => panic!("the checkpoint before was not taken"),
                Some(same) => {
                    assert!(same || forged, "a damaged checkpoint leads to another trajectory");
                    Outcome::Done
                }
            }
        };
        let outcome = catch_unwind(AssertUnwindSafe(attempt))
            .unwrap_or_else(|_| panic!("checkpoint {index} of seed {seed} fails"));
        *counts.entry(outcome).or_default() += 1;
    }
    let count = |outcome| counts.get(&outcome).copied().unwrap_or(0);
    let (refused, done) = (count(Outcome::Refused), count(Outcome::Done));
    println!("checkpoints: {runs} inputs: {refused} refused, {} failed, {done} done", count(Outcome::Failed));
    assert!(refused > 0 && done > 0 || runs == 0, "what is tried is stale");
}
