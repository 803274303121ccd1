//! Bad input: exit code 2, a message with file, line, key, value and what is allowed, and nothing written.

use crate::workplace::{Workplace, text};

const GOOD: &str = r#"[system]
mass = [[2.0, 0.5], [0.5, 1.0]]
potential = "0.5*k*q0^2 + 0.5*q1^2"
force = ["8*step(1 - t)", "0"]
parameters = { k = 1.0 }
[[system.damping]]
order = 1.5
coefficient = [1.0, 1.0]
[initial]
position = [0.0, 0.0]
momentum = [0.0, 0.0]
[scheme]
kind = "low-order"
kappa = 0.5
[time]
step = 0.1
steps = 30
[convolution]
order = 1
at = "main-nodes"
"#;

/// Line, passage to replace, replacement, and what the message must say besides the place.
const MISTAKES: &[(usize, &str, &str, &[&str])] = &[
    (2, "mass = [[2.0", "masss = [[2.0", &["system.masss", "unknown key", "did you mean `mass`?", "damping"]),
    (2, "[[2.0, 0.5], [0.5, 1.0]]", "[1.0, -1.0]", &["system.mass = [1.0, -1.0]", "positive definite"]),
    (2, "[[2.0, 0.5], [0.5, 1.0]]", "[[1.0, 2.0], [2.0, 1.0]]", &["system.mass", "positive definite"]),
    (2, "[[2.0, 0.5], [0.5, 1.0]]", "[[1.0, 2.0, 3.0], [2.0, 1.0, 3.0]]", &["system.mass[0]", "3 entries"]),
    (3, "0.5*k*q0^2", "0.5*k*(q0^2", &["system.potential", "this bracket is never closed"]),
    (3, "0.5*k*q0^2", "0.5*c*q0^2", &["system.potential", "unknown name `c`", "q0, q1, k, pi"]),
    (
        3,
        "0.5*k*q0^2",
        "0.5*k*q0**2",
        &["system.potential", "unexpected character `*`", "powers are written with ^"],
    ),
    (4, "\"0\"", "\"q2\"", &["system.force[1]", "unknown name `q2`", "t, q0, q1, v0, v1, k, pi"]),
    (4, ", \"0\"]", "]", &["system.force", "1 entries instead of 2"]),
    (
        7,
        "order = 1.5",
        "order = 2.5",
        &["system.damping[0].order = 2.5", "allowed: a damping order 0 ≤ β < 2"],
    ),
    (8, "[1.0, 1.0]", "[1.0, nan]", &["system.damping[0].coefficient[1] = nan", "allowed: a finite number"]),
    (8, "[1.0, 1.0]", "[1.0, -1.0]", &["system.damping[0].coefficient", "positive semidefinite"]),
    (10, "[0.0, 0.0]", "[0.0]", &["initial.position = [0.0]", "1 entries instead of 2"]),
    (10, "[0.0, 0.0]", "[0.0, inf]", &["initial.position[1] = inf", "allowed: a finite number"]),
    (13, "low-order", "midpoint", &["scheme.kind = \"midpoint\"", "\"low-order\", \"galerkin\""]),
    (14, "kappa = 0.5", "kappa = 1.01", &["scheme.kappa = 1.01", "allowed: 0 ≤ κ ≤ 1"]),
    (14, "kappa = 0.5", "kappa = -0.5", &["scheme.kappa = -0.5", "allowed: 0 ≤ κ ≤ 1"]),
    (16, "step = 0.1", "step = 0", &["time.step = 0", "allowed: a number > 0"]),
    (16, "step = 0.1", "step = -0.1", &["time.step = -0.1", "allowed: a number > 0"]),
    (16, "step = 0.1", "step = 10.0", &["time.step = 10.0", "unstable: the largest stable step is about"]),
    (17, "steps = 30", "steps = -30", &["time.steps = -30", "allowed: a whole number from 0 to"]),
    (17, "steps = 30", "end = 0.25", &["time.end = 0.25", "whole number of steps of 0.1"]),
    (17, "steps = 30", "steps = 30\nend = 3.0", &["time.end = 3.0", "`time.steps`"]),
    (17, "steps = 30", "steps = ", &["not valid TOML"]),
];

#[test]
fn mistakes_are_told_with_their_place_and_nothing_is_written() {
    for (line, passage, replacement, told) in MISTAKES {
        assert!(GOOD.contains(passage), "{passage}");
        let place = Workplace::new();
        place.write("bad.toml", &GOOD.replacen(passage, replacement, 1));
        let output = place.fvi(&["run", "bad.toml"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{replacement}: {message}");
        let line = if replacement.contains("end = 3.0") { line + 1 } else { *line };
        assert!(message.contains(&format!("bad.toml:{line}:")), "{replacement}: {message}");
        for words in *told {
            assert!(message.contains(words), "{replacement}: no «{words}» in {message}");
        }
        assert_eq!((place.files(), output.stdout.len()), (vec!["bad.toml".to_owned()], 0), "{replacement}");
    }
}

#[test]
fn the_good_scenario_is_good() {
    let run = Workplace::new().run(GOOD, &[]);
    assert_eq!(run.rows.len(), 31);
}

#[test]
fn a_file_that_is_not_there_is_named() {
    let place = Workplace::new();
    let output = place.fvi(&["run", "nowhere.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("nowhere.toml: cannot be read"));
}

#[test]
fn a_table_file_with_a_mistake_is_named_with_its_line() {
    let mistakes = [
        ("t,u0,u1\n0,1,2\n0.5,x,1\n", "drive.csv, line 3: `x` is not a finite number"),
        ("t,u0,u1\n0,1,2\n0,1,1\n", "drive.csv, line 3: t = 0 does not come after"),
        ("time,u0\n0,1\n", "drive.csv, line 1: the first column must be t"),
        ("t,u2\n0,1\n", "drive.csv, line 1: unknown or repeated column `u2`"),
        ("t,u0\n", "drive.csv, line 1: there are no rows"),
        ("t,u0\n0,1\n1,2,3\n", "drive.csv, line 3"),
    ];
    for (table, told) in mistakes {
        let place = Workplace::new();
        place.write("drive.csv", table);
        place.write("bad.toml", &format!("{GOOD}[input]\nfile = \"drive.csv\"\n"));
        let output = place.fvi(&["run", "bad.toml"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains("bad.toml:22:8: input.file = \"drive.csv\""), "{message}");
        assert!(message.contains(told), "{message}");
    }
}

#[test]
fn a_command_line_that_makes_no_sense_is_bad_input() {
    let place = Workplace::new();
    for arguments in
        [&["integrate"][..], &["run"], &["run", "a.toml", "b.toml"], &["run", "a.toml", "--precision", "f16"]]
    {
        assert_eq!(place.fvi(arguments).status.code(), Some(2), "{arguments:?}");
    }
}
