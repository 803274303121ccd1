//! `fvi strategies`.

use crate::workplace::{Workplace, text};

const RACE: &str =
    "lengths = [64]\ntolerances = [1e-6]\nrounds = [2, 2]\n[[kernel]]\nname = \"root\"\norder = 0.5\n";

#[test]
fn a_file_of_strategies_leads_to_a_table_a_page_and_sentences() {
    let workplace = Workplace::new();
    workplace.write("race.toml", RACE);
    let output = workplace.fvi(&["strategies", "race.toml"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    assert!(said.contains("root, 1 channel, f64, error up to 1e-6: fastest is"), "{said}");
    assert!(said.contains("1 of 1 races in out/race"), "{said}");
    let table = std::fs::read_to_string(workplace.path("out/race/strategies.csv")).unwrap();
    for name in ["direct", "block-fft", "exponential-sum", "gardner", "oblivious", "l1"] {
        assert_eq!(
            table.lines().filter(|line| line.starts_with(&format!("{name},root,64,1,f64,1e-6,"))).count(),
            1
        );
    }
    assert!(workplace.path("out/race/strategies.html").exists());
    assert!(workplace.path("out/race/pictures/error-bytes-root--64-steps--1-channel--f64.svg").exists());
    // Going on from what is complete measures nothing again.
    let output = workplace.fvi(&["strategies", "race.toml", "--resume", "--quiet"]);
    assert!(output.status.success() && output.stdout.is_empty(), "{}", text(&output.stderr));
    assert_eq!(std::fs::read_to_string(workplace.path("out/race/strategies.csv")).unwrap(), table);
}

#[test]
fn as_many_processes_as_the_file_asks_for_make_the_rounds() {
    let workplace = Workplace::new();
    workplace.write("race.toml", &format!("processes = 3\n{}", RACE.replace("[2, 2]", "[6, 6]")));
    let output = workplace.fvi(&["strategies", "race.toml"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    // What the last one says is said once.
    assert_eq!(text(&output.stdout).matches("fastest is").count(), 1);
    let record = std::fs::read_to_string(workplace.path("out/race/strategies.json")).unwrap();
    let record: fvi_strategies::Record = serde_json::from_str(&record).unwrap();
    let race = &record.races[0];
    assert_eq!((race.rounds, &*race.parts), (6, &[2, 2, 2][..]));
    for row in &race.rows {
        // The interval holds the median of each process.
        for part in row.rounds_ns.chunks(2) {
            let median = 0.5 * (part[0] + part[1]);
            assert!(row.between_ns.0 <= median && median <= row.between_ns.1, "{row:?}");
        }
    }
    let output = workplace.fvi(&["strategies", "none.toml"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn bad_files_are_refused_with_file_key_and_value() {
    let workplace = Workplace::new();
    workplace.write("race.toml", &RACE.replace("[1e-6]", "[1e-6, 2.0]"));
    let output = workplace.fvi(&["strategies", "race.toml"]);
    assert_eq!(output.status.code(), Some(2));
    let said = text(&output.stderr);
    for word in ["race.toml", "tolerances[1]", "2.0", "4e-15 ≤ tolerance ≤ 0.1"] {
        assert!(said.contains(word), "{word}: {said}");
    }
    workplace.write("race.toml", RACE);
    let output = workplace.fvi(&["strategies", "race.toml", "--resume"]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("nothing to go on from"));
    assert_eq!(workplace.files(), ["race.toml"]);
}

#[test]
fn the_shipped_file_is_read() {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/strategies/quick.toml");
    let plan = fvi_strategies::Lab::new().plan(&file).unwrap();
    assert_eq!(plan.races(), 18);
}

#[cfg(unix)]
const ROUNDS: usize = 50;

/// Times of the first strategy in each round of the first race.
#[cfg(unix)]
fn rounds_of_the_first_race(record: &std::path::Path) -> Vec<f64> {
    let record: fvi_strategies::Record =
        serde_json::from_str(&std::fs::read_to_string(record).unwrap()).unwrap();
    record.races[0].rows[0].rounds_ns.clone()
}

#[cfg(unix)]
#[test]
fn an_interrupt_keeps_what_was_measured() {
    let workplace = Workplace::new();
    let race = RACE.replace("[64]", "[64, 65, 66]").replace("[2, 2]", &format!("[{ROUNDS}, {ROUNDS}]"));
    // A program that is slow enough for a round to be under way.
    let slow = "[[program]]\nname = \"slow\"\ncommand = [\"sh\", \"-c\", '''\nwhile read word rest; do case $word in begin) ;; weights) echo ready 0 ;; \
                clear) echo ok ;; *) echo 0 ;; esac; done''']\n";
    workplace.write("race.toml", &format!("strategies = [\"naive\", \"slow\"]\n{race}{slow}"));
    let child = workplace
        .command(&["strategies", "race.toml", "--out", "out"])
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let begin = std::time::Instant::now();
    while !workplace.path("out/strategies.csv").exists() {
        assert!(begin.elapsed().as_secs() < 60, "the first race never ended");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let sent = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let output = child.wait_with_output().unwrap();
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.contains("stopped; 0 of 3 races are done and "), "{said}");
    assert!(said.contains(" begun, in out; `--resume` goes on"), "{said}");
    let table = std::fs::read_to_string(workplace.path("out/strategies.csv")).unwrap();
    assert!(table.contains("naive,root,64,"), "{table}");
    let times = || rounds_of_the_first_race(&workplace.path("out/strategies.json"));
    let kept = times();
    let output = workplace.fvi(&["strategies", "race.toml", "--out", "out", "--resume", "--quiet"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(
        std::fs::read_to_string(workplace.path("out/strategies.csv")).unwrap().contains("naive,root,66,")
    );
    let all = times();
    assert_eq!(all.len(), ROUNDS);
    assert!(!kept.is_empty() && kept.len() < ROUNDS && all.starts_with(&kept), "{kept:?}");
}
