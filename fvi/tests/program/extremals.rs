//! `fvi extremal`: the repository's problems, what is written, bad input, no convergence.

use crate::workplace::{Workplace, text};
use fvi_fft::sums::max_or_nan;
use std::fs;
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/problems")
}

/// What a solution has written: the table's header and rows of cells, and the summary.
struct Written {
    header: String,
    rows: Vec<Vec<String>>,
    summary: serde_json::Value,
}

impl Written {
    fn read(directory: &Path) -> Self {
        let table = fs::read_to_string(directory.join("extremal.csv")).unwrap();
        let mut lines = table.lines();
        let header = lines.next().unwrap().to_owned();
        let rows = lines.map(|line| line.split(',').map(str::to_owned).collect()).collect();
        let summary =
            serde_json::from_str(&fs::read_to_string(directory.join("summary.json")).unwrap()).unwrap();
        Self { header, rows, summary }
    }

    fn column(&self, name: &str) -> Vec<Option<f64>> {
        let index = self.header.split(',').position(|column| column == name).unwrap();
        self.rows.iter().map(|row| row[index].parse().ok()).collect()
    }

    fn number(&self, key: &str) -> f64 {
        self.summary[key].as_f64().unwrap()
    }

    /// Largest error and order on the grid of the file.
    fn error_and_order(&self) -> (f64, f64) {
        let last = self.summary["errors"].as_array().unwrap().last().unwrap();
        (last["largest"].as_f64().unwrap(), last["order"].as_f64().unwrap())
    }
}

fn solve(name: &str) -> Written {
    let place = Workplace::new();
    let problem = folder().join(name).with_extension("toml");
    let output = place.fvi(&["extremal", problem.to_str().unwrap(), "--out", "out"]);
    assert!(output.status.success(), "{name}: {}", text(&output.stderr));
    assert!(text(&output.stdout).contains("files in out"), "{}", text(&output.stdout));
    let written = Written::read(&place.path("out"));
    assert_eq!(written.summary["status"], "converged");
    assert!(written.number("residual") <= 32.0 * written.number("rounding_level"), "{name}");
    for picture in ["positions.svg", "velocities.svg"] {
        assert!(
            fs::read_to_string(place.path("out").join(picture)).unwrap().ends_with("</svg>\n"),
            "{picture}"
        );
    }
    written
}

#[test]
fn every_problem_is_among_those_tested_here() {
    let source = include_str!("extremals.rs");
    for entry in fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "toml") {
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            assert!(source.contains(&format!("solve(\"{name}\")")), "{name}");
        }
    }
}

#[test]
fn the_closed_forms_are_met_with_the_orders_their_comments_give() {
    let (error, order) = solve("least-fractional-speed").error_and_order();
    assert!(error < 6e-3 && (0.49..0.52).contains(&order), "{error} {order}");
    let (error, order) = solve("power-law").error_and_order();
    assert!(error < 1e-4 && (0.95..1.0).contains(&order), "{error} {order}");
    let (error, order) = solve("classical-oscillator").error_and_order();
    assert!(error < 3e-7 && (1.95..2.05).contains(&order), "{error} {order}");
    let (error, order) = solve("newton-with-friction").error_and_order();
    assert!(error < 7e-4 && (0.98..1.02).contains(&order), "{error} {order}");
}

#[test]
fn the_path_from_well_to_well_is_monotone_and_keeps_its_ends() {
    let written = solve("double-well");
    let positions: Vec<f64> = written.column("x0").into_iter().map(Option::unwrap).collect();
    assert_eq!(positions.len(), 2001);
    assert_eq!((positions[0], positions[2000]), (-1.0, 1.0));
    assert!(written.number("newton_iterations") <= 30.0);
    // No velocity belongs to the end for sigma = "+".
    let velocities = written.column("v0");
    assert_eq!(velocities.iter().position(Option::is_none), Some(2000));
}

#[test]
fn a_problem_of_two_coordinates_has_a_column_for_each() {
    let written = solve("coupled-pair");
    assert_eq!(written.header, "t,x0,x1,v0,v1");
    assert_eq!(written.rows.len(), 1001);
    assert_eq!(written.column("v1").iter().position(Option::is_none), Some(0));
    assert_eq!(written.column("x1")[1000], Some(-0.5));
    assert_eq!(written.column("t")[250], Some(0.25));
}

const GOOD: &str = r#"[problem]
lagrangian = "0.5*v0^2 + 0.1*v0^4 + k*(x0^2 - 1)^2"
parameters = { k = 2.0 }
alpha = 0.8
sigma = "-"
[boundary]
start = [-1.0]
end = [1.0]
[interval]
end = 4.0
steps = 300
[solver]
method = "krylov"
[guess]
position = ["tanh(t - 2)"]
[reference]
position = ["tanh(2*t - 4)"]
"#;

/// Line, passage to replace, replacement, and what the message must say besides the place.
const MISTAKES: &[(usize, &str, &str, &[&str])] = &[
    (2, "lagrangian =", "lagrangean =", &["problem.lagrangean", "unknown key", "did you mean `lagrangian`?"]),
    (2, "k*(x0", "c*(x0", &["problem.lagrangian", "unknown name `c`", "t, x0, v0, k, pi"]),
    (2, "0.1*v0^4", "0.1*v1^4", &["problem.lagrangian", "unknown name `v1`"]),
    (3, "k = 2.0", "x0 = 2.0", &["problem.parameters.x0", "cannot be a parameter"]),
    (4, "alpha = 0.8", "alpha = 0.0", &["problem.alpha = 0.0", "allowed: an order 0 < α ≤ 1"]),
    (4, "alpha = 0.8", "alpha = 1.01", &["problem.alpha = 1.01", "allowed: an order 0 < α ≤ 1"]),
    (4, "alpha = 0.8", "alpha = nan", &["problem.alpha = nan", "allowed: a finite number"]),
    (1, "alpha = 0.8\n", "", &["problem", "the key `alpha` is missing"]),
    (5, "sigma = \"-\"", "sigma = \"minus\"", &["problem.sigma = \"minus\"", "allowed: \"-\", \"+\""]),
    (6, "start = [-1.0]\n", "", &["boundary", "the key `start` is missing"]),
    (6, "end = [1.0]\n", "", &["boundary", "the key `end` is missing"]),
    (8, "end = [1.0]", "end = [1.0, 2.0]", &["boundary.end", "2 entries instead of 1"]),
    (8, "end = [1.0]", "end = [inf]", &["boundary.end[0] = inf", "allowed: a finite number"]),
    (10, "end = 4.0", "end = -4.0", &["interval.end = -4.0", "allowed: a number > 0, the start"]),
    (11, "steps = 300", "steps = 1", &["interval.steps = 1", "whole number from 2"]),
    (13, "krylov", "conjugate", &["solver.method = \"conjugate\"", "\"dense\", \"krylov\""]),
    (15, "tanh(t - 2)", "1/(t - 2)", &["the guess is not finite at t = 2"]),
    (15, "tanh(t - 2)", "x0", &["guess.position[0]", "unknown name `x0`"]),
    (
        17,
        "position = [\"tanh(2*t",
        "positions = [\"tanh(2*t",
        &["reference.positions", "did you mean `position`?"],
    ),
];

#[test]
fn mistakes_are_told_with_their_place_and_nothing_is_written() {
    for (line, passage, replacement, told) in MISTAKES {
        assert!(GOOD.contains(passage), "{passage}");
        let place = Workplace::new();
        place.write("bad.toml", &GOOD.replacen(passage, replacement, 1));
        let output = place.fvi(&["extremal", "bad.toml"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{replacement}: {message}");
        if !replacement.contains("1/(t") {
            assert!(message.contains(&format!("bad.toml:{line}:")), "{replacement}: {message}");
        }
        for words in *told {
            assert!(message.contains(words), "{replacement}: no «{words}» in {message}");
        }
        assert_eq!((place.files(), output.stdout.len()), (vec!["bad.toml".to_owned()], 0), "{replacement}");
    }
}

#[test]
fn the_good_problem_is_good_and_quiet_when_told() {
    let place = Workplace::new();
    place.write("good.toml", GOOD);
    let output = place.fvi(&["extremal", "good.toml", "--quiet"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!((output.stdout.len(), output.stderr.len()), (0, 0));
    let written = Written::read(&place.path("out/good"));
    assert_eq!(written.summary["problem"]["alpha"], 0.8);
    assert_eq!(written.summary["problem"]["method"], "krylov");
    // 17 digits: reading a number and writing it again gives the same text.
    for cell in written.rows[1..].iter().flatten() {
        assert_eq!(&format!("{:.16e}", cell.parse::<f64>().unwrap()), cell);
    }
}

#[test]
fn without_convergence_the_best_iterate_is_kept_and_named_so() {
    let place = Workplace::new();
    place.write("hard.toml", &GOOD.replace("method = \"krylov\"", "iterations = 1"));
    let output = place.fvi(&["extremal", "hard.toml", "--out", "out"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("no convergence; best iterate kept"), "{message}");
    let written = Written::read(&place.path("out"));
    assert_eq!(written.summary["status"], "not-converged");
    assert_eq!(written.rows.len(), 301);
    assert!(written.number("relative_residual") > 1e-6);
    assert!(written.summary.get("errors").is_none());
    let picture = fs::read_to_string(place.path("out/positions.svg")).unwrap();
    assert!(picture.contains("best iterate, not converged"));
}

#[test]
fn terms_of_an_equation_and_a_lagrangian_exclude_each_other() {
    let terms = "terms = [{ order = 2, of = [\"x0\"] }]";
    let lagrangian = GOOD.lines().nth(1).unwrap();
    let cases = [
        (GOOD.replace("sigma", &format!("{terms}\nsigma")), "problem.terms"),
        (GOOD.replace(lagrangian, terms), "problem.alpha"),
        (GOOD.replace(lagrangian, terms).replace("alpha = 0.8\n", ""), "solver.method"),
        (
            GOOD.replace(lagrangian, &terms.replace("order = 2", "order = 3")).replace("alpha = 0.8\n", ""),
            "problem.terms[0].order = 3",
        ),
        (
            GOOD.replace(lagrangian, &terms.replace("order = 2", "order = 1")).replace("alpha = 0.8\n", ""),
            "highest order is 2",
        ),
    ];
    for (problem, told) in cases {
        let place = Workplace::new();
        place.write("bad.toml", &problem);
        let output = place.fvi(&["extremal", "bad.toml"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(told), "{told}: {message}");
    }
}

/// x'' + x = 0 from 0 to 1 over [0, 2].
const OSCILLATOR: &str = r#"[problem]
terms = [{ order = 2, of = ["x0"] }, { order = 0, of = ["x0"] }]
[boundary]
start = [0.0]
end = [1.0]
[interval]
end = 2.0
steps = 64
[reference]
position = ["sin(t)/sin(2)"]
"#;

fn solved(problem: &str) -> Written {
    let place = Workplace::new();
    place.write("problem.toml", problem);
    let output = place.fvi(&["extremal", "problem.toml", "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    Written::read(&place.path("out"))
}

#[test]
fn the_asymmetric_embedding_of_an_euler_lagrange_equation_gives_the_extremal() {
    let terms = OSCILLATOR.lines().nth(1).unwrap();
    let extremal = solved(&OSCILLATOR.replace(terms, "lagrangian = \"0.5*v0^2 - 0.5*x0^2\"\nalpha = 1.0"));
    let embedded = |key: &str| solved(&OSCILLATOR.replace("[boundary]", &format!("{key}\n[boundary]")));
    let distance = |a: &Written, b: &Written| {
        let pairs = a.column("x0").into_iter().zip(b.column("x0"));
        pairs.fold(0.0, |largest, (a, b)| max_or_nan(largest, (a.unwrap() - b.unwrap()).abs()))
    };
    for sigma in ["-", "+"] {
        let asymmetric = embedded(&format!("embedding = \"asymmetric\"\nsigma = \"{sigma}\""));
        assert_eq!(asymmetric.summary["problem"]["embedding"], "asymmetric");
        assert!(distance(&asymmetric, &extremal) < 1e-12, "{sigma}");
        assert!((1.95..2.05).contains(&asymmetric.error_and_order().1));
        let symmetric = embedded(&format!("sigma = \"{sigma}\""));
        assert!(distance(&symmetric, &extremal) > 1e-3, "{sigma}");
        assert!((0.95..1.05).contains(&symmetric.error_and_order().1));
    }
}

#[test]
fn a_reference_that_is_not_finite_is_never_an_error_of_zero() {
    let place = Workplace::new();
    for (reference, told) in [
        ("0/0 + sqrt(-1 - t)", "not a finite number"),
        ("sqrt(-1 - t)", "the reference is not finite at any grid point between the ends"),
        ("1e308*10^(1 + t)", "the reference is not finite at any grid point between the ends"),
    ] {
        place.write("bad.toml", &OSCILLATOR.replace("sin(t)/sin(2)", reference));
        let output = place.fvi(&["extremal", "bad.toml"]);
        let message = text(&output.stderr);
        assert_eq!((output.status.code(), place.files().len()), (Some(2), 1), "{message}");
        assert!(message.contains("bad.toml:10:") && message.contains(told), "{message}");
    }
    place.write("part.toml", &OSCILLATOR.replace("sin(t)", "(t + sqrt(1 - t) - sqrt(1 - t))"));
    let output = place.fvi(&["extremal", "part.toml", "--out", "out"]);
    assert!(output.status.success());
    let message = text(&output.stderr);
    assert!(message.contains("warning: reference: it is not finite at 32 grid points"), "{message}");
    let written = Written::read(&place.path("out"));
    let finest = &written.summary["errors"].as_array().unwrap().last().unwrap().clone();
    assert_eq!((finest["compared"].as_u64(), finest["undefined"].as_u64()), (Some(33), Some(32)));
    for (table, told) in [
        ("t\n0\n1\n", "there is no column beside t"),
        ("t,x0\n0.01,1\n", "none of its times is a grid point"),
    ] {
        place.write("known.csv", table);
        place
            .write("bad.toml", &OSCILLATOR.replace("position = [\"sin(t)/sin(2)\"]", "file = \"known.csv\""));
        let output = place.fvi(&["extremal", "bad.toml"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(text(&output.stderr).contains(told), "{}", text(&output.stderr));
    }
}

#[test]
fn an_extremal_whose_functional_overflows_is_none() {
    let place = Workplace::new();
    let endless = GOOD.replace("end = 4.0", "end = 1.7e308").replace("steps = 300", "steps = 16");
    let endless: String =
        endless.lines().take_while(|line| *line != "[guess]").map(|line| format!("{line}\n")).collect();
    place.write("endless.toml", &endless.replace("krylov", "dense"));
    let output = place.fvi(&["extremal", "endless.toml", "--out", "out"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stdout));
    assert!(text(&output.stderr).contains("no convergence"), "{}", text(&output.stderr));
}
