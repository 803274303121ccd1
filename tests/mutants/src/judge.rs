//! Runs the tests that reach a mutant until one fails.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::compile::Program;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    Caught,
    /// A test ran for much longer than it should: its caller notices.
    Endless,
    Survived,
    /// No test runs this code.
    Unreached,
}

pub struct Test {
    program: usize,
    name: String,
    time: Duration,
    reaches: BTreeSet<usize>,
}

/// Bytes of each test's stack: with all mutants in it a function needs more than its own.
const STACK: &str = "268435456";

fn command(program: &Program) -> Command {
    let mut command = Command::new(&program.path);
    command
        .current_dir(&program.folder)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .envs([("RUST_BACKTRACE", "0"), ("RUST_MIN_STACK", STACK)]);
    command
}

/// All tests, with the time they take and the sites that they reach.
pub fn record(programs: &[Program], scratch: &Path, skip: &[String]) -> Vec<Test> {
    let mut tests = Vec::new();
    for (at, program) in programs.iter().enumerate() {
        let list = command(program).args(["--list", "--format", "terse"]).stdout(Stdio::piped()).output();
        let list = String::from_utf8(list.expect("a list of tests").stdout).expect("text");
        for name in list.lines().filter_map(|line| line.strip_suffix(": test")) {
            if skip.iter().any(|part| name.contains(part)) {
                continue;
            }
            let _ = fs::remove_file(scratch);
            let began = Instant::now();
            let passed = command(program)
                .args(["--exact", name, "--test-threads", "1"])
                .env("MUTANTS_RECORD", scratch)
                .status()
                .expect("a test that runs")
                .success();
            assert!(passed, "{name} fails without mutants");
            let text = fs::read_to_string(scratch).unwrap_or_default();
            let reaches = text.lines().filter_map(|line| line.parse().ok()).collect();
            tests.push(Test { program: at, name: name.to_owned(), time: began.elapsed(), reaches });
        }
    }
    tests.sort_by_key(|test| test.time);
    tests
}

/// The verdict on mutant `number` at the site whose first mutant is `first`.
pub fn judge(programs: &[Program], tests: &[Test], first: usize, number: usize) -> Verdict {
    let reaching: Vec<&Test> = tests.iter().filter(|test| test.reaches.contains(&first)).collect();
    if reaching.is_empty() {
        return Verdict::Unreached;
    }
    // Short tests first: most mutants are noticed by many.
    let (mut batch, mut limit) = (Vec::new(), Duration::from_millis(100));
    let mut time = Duration::ZERO;
    for (at, test) in reaching.iter().enumerate() {
        batch.push(*test);
        time += test.time;
        if time >= limit || at + 1 == reaching.len() {
            let verdict = run(programs, &batch, time, number);
            if verdict != Verdict::Survived {
                return verdict;
            }
            (batch, time) = (Vec::new(), Duration::ZERO);
            limit *= 4;
        }
    }
    Verdict::Survived
}

fn run(programs: &[Program], batch: &[&Test], time: Duration, number: usize) -> Verdict {
    let mut names: BTreeMap<usize, Vec<&str>> = BTreeMap::new();
    for test in batch {
        names.entry(test.program).or_default().push(&test.name);
    }
    for (program, names) in names {
        let mut child = command(&programs[program])
            .args(["--exact", "--test-threads", "1"])
            .args(names)
            .env("MUTANT", number.to_string())
            .spawn()
            .expect("tests that run");
        let (began, most) = (Instant::now(), Duration::from_secs(5) + 10 * time);
        loop {
            match child.try_wait().expect("a child") {
                Some(status) if status.success() => break,
                Some(_) => return Verdict::Caught,
                None if began.elapsed() > most => {
                    let _ = child.kill();
                    let _ = child.wait();
                    return Verdict::Endless;
                }
                None => sleep(Duration::from_millis(2)),
            }
        }
    }
    Verdict::Survived
}
