//! What surrounds the program fails: nobody reads what it says, devices are full, directories vanish, numbers
//! overflow.

use crate::workplace::{Run, Workplace, text};
use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};

const FREE: &str = r#"
title = "Free"
[system]
mass = [1.0]
[initial]
position = [1.0]
momentum = [0.5]
[time]
step = 0.25
steps = 8
"#;

/// A damped mass whose `direct` memory keeps a run of many steps busy for as long as a test needs.
const LONG: &str = r#"
[system]
mass = [1.0]
potential = "0.5*q0^2"
[[system.damping]]
order = 0.5
coefficient = [0.1]
[initial]
position = [1.0]
momentum = [0.0]
[time]
step = 0.01
steps = 3_000_000
[history]
engine = "direct"
"#;

impl Workplace {
    /// Starts a long run into `out` and waits until it has begun.
    fn start_long_run(&self) -> std::process::Child {
        self.write("long.toml", LONG);
        let mut command = self.command(&["run", "long.toml", "--out", "out"]);
        if cfg!(target_os = "linux") {
            // The tests may have been started with hang-ups ignored, which processes inherit.
            command = Command::new("env");
            command.args([
                "--default-signal=HUP",
                env!("CARGO_BIN_EXE_fvi"),
                "run",
                "long.toml",
                "--out",
                "out",
            ]);
            command.current_dir(self.path(""));
        }
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        // The part file appears when the first step is about to be made.
        while !fs::read_dir(self.path("out")).is_ok_and(|mut entries| entries.next().is_some()) {
            assert!(child.try_wait().unwrap().is_none());
            std::thread::yield_now();
        }
        child
    }
}

fn end_of(mut child: std::process::Child) -> (Option<i32>, String) {
    let status = child.wait().unwrap();
    let mut message = String::new();
    child.stderr.take().unwrap().read_to_string(&mut message).unwrap();
    (status.code(), message)
}

fn send(signal: &str, child: &std::process::Child) {
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
}

/// Commands that say something, short ones.
fn talking() -> Vec<String> {
    let problem =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/problems/classical-oscillator.toml");
    vec![
        "run free.toml".to_owned(),
        "converge free.toml --levels 2..3".to_owned(),
        format!("extremal '{}'", problem.display()),
        "reproduce".to_owned(),
        "compare-engines --lengths 2 --repetitions 1".to_owned(),
        "weights --exponent 0.5".to_owned(),
        "exponentials --exponent 0.5".to_owned(),
        "--help".to_owned(),
    ]
}

#[cfg(target_os = "linux")]
#[test]
fn a_reader_that_goes_is_no_error_and_a_full_device_is_one() {
    let place = Workplace::new();
    place.write("free.toml", FREE);
    for command in talking() {
        let gone = place.shell(&format!("fvi {command} | true; exit ${{PIPESTATUS[0]}}"));
        assert_eq!((gone.status.code(), text(&gone.stderr).as_str()), (Some(0), ""), "{command}");
        let full = place.shell(&format!("fvi {command} > /dev/full"));
        assert_eq!(full.status.code(), Some(1), "{command}");
        if command != "--help" {
            assert!(text(&full.stderr).contains("standard output: No space left"), "{}", text(&full.stderr));
        }
        let closed = place.shell(&format!("fvi {command} >&- 2>&-"));
        assert_eq!(closed.status.code(), Some(0), "{command}");
    }
    // The files are there even if the line about them could not be written.
    for file in ["out/free/summary.json", "out/free/convergence.csv", "out/compare-engines/engines.csv"] {
        assert!(place.path(file).exists(), "{file}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn an_error_that_nobody_hears_keeps_its_exit_code() {
    let place = Workplace::new();
    place.write("bad.toml", "[system]\n");
    for stream in ["2> /dev/full", "2>&-", "2>&1 | true; exit ${PIPESTATUS[0]}"] {
        assert_eq!(place.shell(&format!("fvi run bad.toml {stream}")).status.code(), Some(2), "{stream}");
    }
}

#[cfg(unix)]
#[test]
fn termination_and_hang_up_keep_what_was_computed() {
    for signal in ["-TERM", "-HUP"] {
        let place = Workplace::new();
        let child = place.start_long_run();
        send(signal, &child);
        let (code, message) = end_of(child);
        assert_eq!(code, Some(130), "{signal}: {message}");
        let run = Run::read(&place.path("out"));
        assert_eq!(run.summary["status"], "stopped");
        assert_eq!(run.summary["steps"], run.rows.len() - 1);
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_run_behind_nohup_goes_on_after_a_hang_up() {
    let place = Workplace::new();
    place.write("long.toml", &LONG.replace("3_000_000", "10_000"));
    let line =
        "trap '' HUP; fvi run long.toml --out out & until test -d out; do :; done; kill -HUP $!; wait $!";
    let output = place.shell(line);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}

#[cfg(unix)]
#[test]
fn two_runs_do_not_write_to_one_directory_and_a_killed_one_frees_it() {
    let place = Workplace::new();
    let mut first = place.start_long_run();
    place.write("free.toml", FREE);
    for command in [
        ["run", "free.toml"],
        ["converge", "free.toml"],
        ["reproduce", "jo-fig-4"],
        ["compare-engines", "--quiet"],
    ] {
        let second = place.fvi(&[&command[..], &["--out", "out"]].concat());
        assert_eq!(second.status.code(), Some(2), "{command:?}");
        let message = text(&second.stderr);
        assert!(message.contains("out: another run is writing to this directory"), "{message}");
    }
    first.kill().unwrap();
    first.wait().unwrap();
    // It has left what it was writing; the next run clears that away.
    assert_eq!(fs::read_dir(place.path("out")).unwrap().count(), 1);
    place.run(FREE, &[]);
    let mut names: Vec<_> =
        fs::read_dir(place.path("out")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["coordinates.svg", "energy.svg", "phase.svg", "summary.json", "trajectory.csv"]);
}

#[cfg(unix)]
#[test]
fn a_directory_that_is_removed_or_renamed_meanwhile_is_named() {
    for renamed in [false, true] {
        let place = Workplace::new();
        let child = place.start_long_run();
        if renamed {
            fs::rename(place.path("out"), place.path("elsewhere")).unwrap();
        } else {
            fs::remove_dir_all(place.path("out")).unwrap();
        }
        send("-INT", &child);
        let (code, message) = end_of(child);
        assert_eq!(code, Some(1), "{message}");
        assert!(message.contains("the directory out is not there, or no longer"), "{message}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_listing_goes_through_a_pipe_or_device_and_does_not_replace_it() {
    use std::os::unix::fs::FileTypeExt;
    let place = Workplace::new();
    let kind = |name: &str| fs::symlink_metadata(place.path(name)).unwrap().file_type();
    let line =
        "mkfifo pipe; cat pipe > copy & fvi weights --exponent 0.5 --out pipe; code=$?; wait; exit $code";
    assert_eq!(place.shell(line).status.code(), Some(0));
    assert!(kind("pipe").is_fifo());
    assert_eq!(fs::read(place.path("copy")).unwrap(), place.fvi(&["weights", "--exponent", "0.5"]).stdout);
    let output = place.shell("fvi weights --exponent 0.5 --out /dev/full");
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("/dev/full: No space left"), "{}", text(&output.stderr));
    // A run does not take a pipe for one of its files.
    place.write("free.toml", FREE);
    let output = place.shell("mkdir out; mkfifo out/trajectory.csv; fvi run free.toml --out out");
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("trajectory.csv: not a regular file"), "{}", text(&output.stderr));
    assert!(kind("out/trajectory.csv").is_fifo());
}

#[cfg(target_os = "linux")]
#[test]
fn what_does_not_fit_into_memory_is_refused_or_streamed() {
    let place = Workplace::new();
    let problem = "[problem]\nlagrangian = \"0.5*v0^2\"\nalpha = 0.75\nsigma = \"-\"\n\
                   [boundary]\nstart = [0.0]\nend = [1.0]\n[interval]\nend = 1.0\nsteps = 10_000_000\n";
    place.write("large.toml", problem);
    place.write("free.toml", FREE);
    for (command, named) in [
        ("extremal large.toml", "interval.steps = 10000000: about"),
        ("compare-engines --lengths 28", "--lengths: a comparison over 268435456 steps: about"),
        ("converge free.toml --levels 30..30", "--levels: the states of the finer run: about"),
    ] {
        let output = place.shell(&format!("ulimit -v 2000000; fvi {command} --out out"));
        assert_eq!(output.status.code(), Some(2), "{command}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(named), "{}", text(&output.stderr));
        assert!(!place.path("out").exists());
    }
    let many = "ulimit -v 2000000; fvi weights --exponent 0.5 --count 1000000000000";
    let streamed = place.shell(&format!("{many} | head -n 200000 | tail -n 1; exit ${{PIPESTATUS[0]}}"));
    assert_eq!(streamed.status.code(), Some(0), "{}", text(&streamed.stderr));
    assert!(text(&streamed.stdout).starts_with("199998,-"), "{}", text(&streamed.stdout));
}

#[test]
fn numbers_that_cannot_be_listed_are_refused() {
    let place = Workplace::new();
    for arguments in [
        "weights --exponent 1.9 --step 1e-170",
        "weights --exponent 1.9 --step 1e170",
        "weights --exponent 1.9 --step 1e155 --count 100000000",
        "exponentials --exponent 1.9 --step 1e-170",
        "exponentials --exponent 1.9 --step 1e-30 --format c",
        "weights --exponent 1.9 --step 1e-30 --format c",
        "exponentials --exponent 1.9 --step 1e30 --precision f32 --format rust",
    ] {
        let output = place.fvi(&arguments.split(' ').collect::<Vec<_>>());
        assert_eq!(output.status.code(), Some(2), "{arguments}: {}", text(&output.stdout));
        assert_eq!(text(&output.stdout), "", "{arguments}");
        assert!(text(&output.stderr).contains("step = "), "{}", text(&output.stderr));
    }
    // What is not asked for in single precision need not fit into it.
    let double = "exponentials --exponent 1.9 --step 1e-30 --format c --precision f64";
    assert!(place.fvi(&double.split(' ').collect::<Vec<_>>()).status.success());
}

#[test]
fn a_state_or_energy_that_is_not_finite_ends_the_run_as_a_failed_step() {
    let place = Workplace::new();
    // The free mass steps over the place where the potential ends, or gains more energy than a number can
    // tell.
    let past_zero = FREE
        .replace("mass = [1.0]", "mass = [1.0]\npotential = \"0.001*log(q0)\"")
        .replace("momentum = [0.5]", "momentum = [-2.4]");
    let too_fast = FREE.replace("mass = [1.0]", "mass = [1.0]\nforce = [\"1e154\"]");
    for scenario in [past_zero, too_fast] {
        place.write("scenario.toml", &scenario);
        let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stdout));
        let message = text(&output.stderr);
        assert!(message.contains("not finite") && message.contains("failed"), "{message}");
        let run = Run::read(&place.path("out"));
        assert!(run.rows.len() > 1 && run.rows.iter().flatten().all(|number| number.is_finite()));
        assert_eq!(run.summary["steps"], run.rows.len() - 1);
        assert!(!run.summary["last"].to_string().contains("null"), "{}", run.summary);
        assert!(!run.summary["largest"].to_string().contains("null"), "{}", run.summary);
    }
}

#[test]
fn a_start_that_is_not_finite_is_bad_input_and_named() {
    let place = Workplace::new();
    for (from, to, arguments, named) in [
        ("[0.5]", "[1e200]", "", "initial.momentum = [1e200]: the energy is not finite"),
        ("[0.5]", "[1e30]", "--precision f32", "initial.momentum = [1e30]: the energy is not finite"),
        (
            "momentum = [0.5]",
            "velocity = [1e39]",
            "--precision f32",
            "initial.velocity = [1e39]: cannot be used",
        ),
        (
            "position = [1.0]",
            "position = [1e39]",
            "--precision f32",
            "initial.position = [1e39]: cannot be used",
        ),
        ("step = 0.25", "step = 1e-60", "--precision f32", "time.step = 1e-60: cannot be used"),
    ] {
        place.write("scenario.toml", &FREE.replace(from, to));
        let output = place.shell(&format!("fvi run scenario.toml --out out {arguments}"));
        assert_eq!(output.status.code(), Some(2), "{to}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(named), "{}", text(&output.stderr));
        assert_eq!(place.files(), ["scenario.toml"]);
    }
}

#[test]
fn runs_at_the_ends_of_the_numbers_are_drawn() {
    let place = Workplace::new();
    for (position, momentum) in
        [("0.0", "3e-162"), ("1e308", "0.0"), ("5e-324", "0.0"), ("-1.7e308", "1e100")]
    {
        let scenario = FREE.replace("[1.0]\nmomentum", &format!("[{position}]\nmomentum"));
        let run = place.run(&scenario.replace("[0.5]", &format!("[{momentum}]")), &[]);
        assert_eq!(run.rows.len(), 9);
        for picture in ["coordinates.svg", "energy.svg", "phase.svg"] {
            let svg = fs::read_to_string(place.path("out").join(picture)).unwrap();
            assert!(svg.ends_with("</svg>\n") && !svg.contains("NaN"), "{position}, {momentum}, {picture}");
        }
    }
}

#[test]
fn control_characters_of_a_title_do_not_reach_the_terminal_or_the_pictures() {
    let place = Workplace::new();
    place.write("scenario.toml", &FREE.replace("Free", "\\u001b[2J\\u0007\\nsecond line"));
    for command in ["run", "converge"] {
        let output = place.fvi(&[command, "scenario.toml", "--out", "out"]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        let said = text(&output.stdout);
        assert!(said.starts_with("?[2J? second line: ") && !said.contains('\u{1b}'), "{said:?}");
    }
    for picture in ["coordinates.svg", "convergence.svg"] {
        let svg = fs::read_to_string(place.path("out").join(picture)).unwrap();
        assert!(svg.contains("\u{fffd}[2J\u{fffd}") && !svg.contains(['\u{1b}', '\u{7}']), "{picture}");
    }
    // A cell of a table ends up in the message about it.
    place.write("drive.csv", "t,u0\n0.0,\u{1b}]0;title\u{7}\n");
    place.write("scenario.toml", &format!("{FREE}\n[input]\nfile = \"drive.csv\"\n"));
    let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
    assert_eq!(output.status.code(), Some(2));
    let message = text(&output.stderr);
    assert!(message.contains("drive.csv") && !message.contains(['\u{1b}', '\u{7}']), "{message:?}");
}

#[test]
fn a_scenario_named_by_dots_stays_below_out() {
    let place = Workplace::new();
    place.write("...toml", FREE);
    assert!(place.fvi(&["run", "...toml"]).status.success());
    assert_eq!(place.files(), ["...toml", "out"]);
    assert!(place.path("out/run/summary.json").exists());
}
