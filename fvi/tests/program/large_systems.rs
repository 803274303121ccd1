//! What a user relies on who brings matrices from a finite-element package.

use crate::workplace::{Workplace, text};
use std::fmt::Write;
use std::fs;

const CHAIN: &str = r#"
[system]
mass = "M.mtx"
stiffness = "K.mtx"
[[system.damping]]
order = 0.6
coefficient = "K.mtx"
scale = 0.02
[[system.damping]]
order = 0.3
coefficient = "K.mtx"
scale = 0.01
[[system.load]]
pattern = { coordinate = 149, value = 2.0 }
amplitude = { file = "record.csv" }
[scheme]
kind = "low-order"
[convolution]
at = "nodes"
order = 2
[history]
engine = "exponential-sum"
[time]
step = 0.05
steps = 40
[output]
coordinates = [149, 0]
snapshots = 10
"#;

/// The chain with two unknowns at each coordinate.
fn gauss() -> String {
    CHAIN.replace("kind = \"low-order\"", "kind = \"galerkin\"\ndegree = 2").replace("order = 2", "order = 4")
}

/// A tridiagonal matrix of 150 rows.
fn tridiagonal(own: f64, beside: f64) -> String {
    let mut text = "%%MatrixMarket matrix coordinate real symmetric\n150 150 299\n".to_owned();
    for row in 1..=150 {
        if row > 1 {
            writeln!(text, "{row} {} {beside}", row - 1).unwrap();
        }
        writeln!(text, "{row} {row} {own}").unwrap();
    }
    text
}

fn place() -> Workplace {
    let place = Workplace::new();
    place.write("M.mtx", &tridiagonal(4.0, 1.0));
    place.write("K.mtx", &tridiagonal(200.0, -100.0));
    place.write("record.csv", "t,a\n0,0\n0.5,1\n1,0\n");
    place
}

#[test]
fn chosen_coordinates_snapshots_and_a_map_are_written() {
    let place = place();
    let run = place.run(CHAIN, &[]);
    assert_eq!(run.columns, ["t", "q149", "q0", "p149", "p0", "energy"]);
    assert_eq!(run.rows.len(), 41);
    // The push arrives at the one end and has not reached the other.
    assert!(run.column("q149").iter().any(|q| q.abs() > 1e-4));
    assert!(run.column("q0").iter().all(|q| q.abs() < 1e-9));
    assert!(run.column("energy")[40] > 0.0);
    assert_eq!(run.summary["solver"]["kind"], "sparse");
    // Both dampings follow all coordinates.
    assert_eq!(run.summary["engine"], serde_json::json!(["exponential-sum", "exponential-sum"]));
    assert_eq!(run.summary["shared_memory"], serde_json::json!([[0, 1]]));
    assert_eq!(run.summary["last"]["position"].as_array().unwrap().len(), 150);
    let files = run.summary["files"].as_array().unwrap();
    for name in ["trajectory.csv", "snapshots.npz", "coordinates.svg", "energy.svg", "map.svg"] {
        assert!(files.iter().any(|file| file == name), "{name}: {files:?}");
        assert!(place.path("out").join(name).exists(), "{name}");
    }
    let archive = fs::read(place.path("out/snapshots.npz")).unwrap();
    // Heads of 128 bytes and 5 states of 150 coordinates.
    assert!(archive.len() > 8 * 5 * 301 + 3 * 128);
    // The summary's inputs make the same run.
    let mut inputs = run.summary["scenario"].clone();
    for table in [inputs.clone(), inputs["system"].take()] {
        let table = table.as_object().unwrap().iter().filter(|(_, value)| !value.is_null());
        let table: serde_json::Map<_, _> = table.map(|(key, value)| (key.clone(), value.clone())).collect();
        if table.contains_key("mass") {
            inputs["system"] = table.into();
        } else {
            inputs = table.into();
        }
    }
    assert_eq!(place.run(&toml::to_string(&inputs).unwrap(), &[]).rows, run.rows);
}

#[test]
fn a_run_that_goes_on_has_the_bytes_of_one_that_was_not_interrupted() {
    let place = place();
    for chain in [gauss(), CHAIN.to_owned()] {
        assert_eq!(place.run(&chain, &[]).summary["solver"]["kind"], "sparse");
        // A pause in the middle of a snapshot's steps, and at one.
        for (steps, arguments) in
            [("steps = 17", [].as_slice()), ("steps = 20", &["--resume"]), ("steps = 40", &["--resume"])]
        {
            place.write("scenario.toml", &chain.replace("steps = 40", steps));
            let output = place.fvi(&[&["run", "scenario.toml", "--out", "parts"], arguments].concat());
            assert!(output.status.success(), "{}", text(&output.stderr));
        }
        for file in ["trajectory.csv", "snapshots.npz", "map.svg"] {
            let of = |directory: &str| fs::read(place.path(directory).join(file)).unwrap();
            assert!(of("parts") == of("out"), "{file}");
        }
    }
    // Snapshots that are gone cannot be gone on with.
    fs::remove_file(place.path("parts/snapshots.npz")).unwrap();
    let output = place.fvi(&["run", "scenario.toml", "--out", "parts", "--resume"]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("snapshots.npz"), "{}", text(&output.stderr));
}

#[test]
fn the_line_of_result_shows_the_coordinates_that_are_written() {
    let place = place();
    for (coordinates, shown) in [("[149, 0]", 2), ("[7]", 1), ("[0, 1, 2, 3, 4, 5, 6, 7, 8, 9]", 9)] {
        place.write("scenario.toml", &CHAIN.replace("[149, 0]", coordinates));
        let output = place.fvi(&["run", "scenario.toml", "--out", "out", "--steps", "0"]);
        let line = text(&output.stdout);
        let positions = line.split("q = ").nth(1).unwrap().split(", p = ").next().unwrap();
        assert_eq!(positions.split(", ").count(), shown, "{line}");
        assert_eq!(positions.ends_with("…]"), shown > 8, "{line}");
    }
}

#[test]
fn energies_are_those_of_their_steps_where_not_every_one_is_written() {
    let place = place();
    let scenario = CHAIN.replace("snapshots = 10\n", "");
    let all = place.run(&scenario, &[]);
    let mut table = "t,energy\n".to_owned();
    for (time, energy) in all.column("t").iter().zip(all.column("energy")) {
        writeln!(table, "{time},{energy}").unwrap();
    }
    place.write("energies.csv", &table);
    // The energies of all grid points are compared with those of the reference, whatever is written.
    let few = format!("{scenario}every = 7\n[reference]\nfile = \"energies.csv\"\n");
    let errors = &place.run(&few, &[]).summary["errors"]["energy"];
    assert_eq!((&errors["compared"], &errors["largest"]), (&41.into(), &0.0.into()));
    // A run that is carried further from between two rows has the pictures and the largest energy of one that
    // went there at once.
    let few = format!("{scenario}every = 7\n");
    let largest = place.run(&few, &[]).summary["largest"].clone();
    let picture = fs::read(place.path("out/energy.svg")).unwrap();
    place.run(&few, &["--steps", "17"]);
    assert_eq!(place.run(&few, &["--resume"]).summary["largest"], largest);
    assert!(fs::read(place.path("out/energy.svg")).unwrap() == picture);
}

#[test]
fn bad_matrices_and_keys_are_refused_by_name() {
    let place = place();
    place.write("skew.mtx", "%%MatrixMarket matrix coordinate real general\n150 150 2\n1 2 1.0\n2 1 1.5\n");
    place.write("small.mtx", "%%MatrixMarket matrix coordinate real symmetric\n2 2 2\n1 1 1.0\n2 2 1.0\n");
    place.write("indefinite.mtx", &tridiagonal(1.0, 0.9));
    let whole = tridiagonal(4.0, 1.0);
    let cut: String = whole.split_inclusive('\n').take(100).collect();
    place.write("cut.mtx", &cut);
    place.write("B.mtx", "%%MatrixMarket matrix coordinate real general\n150 2 2\n1 1 1.0\n7 2 1.0\n");
    let cases: [(&str, &str, &[&str]); 18] = [
        ("\"M.mtx\"", "\"none.mtx\"", &["system.mass", "none.mtx"]),
        ("\"M.mtx\"", "\"cut.mtx\"", &["system.mass", "cut.mtx", "the file ends too early"]),
        ("\"M.mtx\"", "\"indefinite.mtx\"", &["system.mass", "not positive definite", "pivot", "coordinate"]),
        (
            "stiffness = \"K.mtx\"",
            "stiffness = \"skew.mtx\"",
            &["system.stiffness", "not symmetric", "row 0, column 1", "1.5"],
        ),
        ("stiffness = \"K.mtx\"", "stiffness = \"small.mtx\"", &["system.stiffness", "2 rows", "150"]),
        ("stiffness = \"K.mtx\"", "stiffness = \"record.csv\"", &["system.stiffness", ".mtx"]),
        (
            "coefficient = \"K.mtx\"",
            "coefficient = \"indefinite.mtx\"",
            &["system.damping[0].coefficient", "not positive semidefinite"],
        ),
        ("scale = 0.02", "scale = -0.02", &["system.damping[0].coefficient", "not positive semidefinite"]),
        ("scale = 0.02", "strength = [1.0]", &["strength", "attached"]),
        (
            "coefficient = \"K.mtx\"\nscale = 0.02",
            "attached = \"B.mtx\"\nstrength = [1.0]",
            &["strength", "2 numbers"],
        ),
        (
            "coefficient = \"K.mtx\"\nscale = 0.02",
            "attached = \"B.mtx\"\nstrength = [1.0, -1.0]",
            &["strength", "≥ 0"],
        ),
        ("coordinate = 149", "coordinate = 150", &["system.load[0].pattern.coordinate", "0 to 149"]),
        ("\"record.csv\"", "\"K.mtx\"", &["amplitude.file", "K.mtx"]),
        ("coordinates = [149, 0]\n", "", &["output.coordinates", "150"]),
        ("coordinates = [149, 0]", "coordinates = [149, 149]", &["output.coordinates", "once"]),
        (
            "[[system.load]]",
            "[[system.element]]\npotential = \"x0^4\"\ncoordinates = [[150]]\n[[system.load]]",
            &["system.element[0].coordinates[0][0]", "0 to 149"],
        ),
        (
            "[[system.load]]",
            "[[system.element]]\npotential = \"x1^4\"\ncoordinates = [[0]]\n[[system.load]]",
            &["system.element[0].potential", "x1"],
        ),
        ("at = \"nodes\"", "at = \"main-nodes\"", &["time.step", "stable", "\"nodes\""]),
    ];
    for (old, new, said) in cases {
        let scenario = CHAIN.replacen(old, new, 1);
        assert_ne!(scenario, CHAIN, "{old}");
        // Damped at the main nodes, this chain needs shorter steps.
        let scenario = if new.contains("main-nodes") {
            scenario.replace("scale = 0.02", "scale = 20.0")
        } else {
            scenario
        };
        place.write("scenario.toml", &scenario);
        let output = place.fvi(&["run", "scenario.toml", "--out", "refused"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{new}: {message}");
        // Messages are broken into lines to fit a terminal.
        let flat: String =
            message.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
        for word in said {
            assert!(flat.contains(word), "{new}: no `{word}` in {message}");
        }
        assert!(!place.path("refused").exists(), "{new}");
    }
}

/// Load cases of the chain under a load that they share, one of them under nothing else.
const CASES: &str = r#"
[[case]]
name = "near"
[[case.load]]
pattern = { coordinate = 3, value = 1.0 }
amplitude = "sin(4*t)"
[[case]]
name = "far-and-near"
[[case.load]]
pattern = { coordinate = 120, value = -2.0 }
amplitude = "step(0.7 - t)"
[[case.load]]
pattern = { coordinate = 3, value = 1.0 }
amplitude = "sin(4*t)"
[[case]]
name = "none-of-its-own"
"#;

/// The chain alone under the loads of one case.
fn alone(chain: &str, case: &str) -> String {
    let loads: String = CASES
        .split("[[case]]")
        .find(|text| text.contains(&format!("\"{case}\"")))
        .unwrap()
        .lines()
        .filter(|line| !line.starts_with("name"))
        .map(|line| line.replace("[[case.load]]", "[[system.load]]") + "\n")
        .collect();
    chain.replace("[scheme]", &format!("{loads}[scheme]"))
}

#[test]
fn load_cases_leave_the_files_of_runs_of_their_own() {
    leave_the_files_of_runs_of_their_own(CHAIN);
}

#[test]
fn load_cases_on_two_gauss_points_leave_the_files_of_runs_of_their_own() {
    leave_the_files_of_runs_of_their_own(&gauss());
}

fn leave_the_files_of_runs_of_their_own(chain: &str) {
    let place = place();
    // What an earlier run without cases has left there goes.
    place.run(chain, &[]);
    place.write("scenario.toml", &format!("{chain}{CASES}"));
    let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("3 load cases (near, far-and-near, none-of-its-own)"));
    let summary = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&fs::read(place.path(name)).unwrap()).unwrap()
    };
    assert_eq!(
        summary("out/summary.json")["cases"],
        serde_json::json!(["near", "far-and-near", "none-of-its-own"])
    );
    assert!(!place.path("out/trajectory.csv").exists() && !place.path("out/snapshots.npz").exists());
    for case in ["near", "far-and-near", "none-of-its-own"] {
        place.write("alone.toml", &alone(chain, case));
        let output = place.fvi(&["run", "alone.toml", "--out", "alone"]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        for file in ["trajectory.csv", "snapshots.npz"] {
            let of = |directory: &str| fs::read(place.path(directory).join(file)).unwrap();
            assert!(of(&format!("out/{case}")) == of("alone"), "{case}: {file}");
        }
        let (found, known) = (summary(&format!("out/{case}/summary.json")), summary("alone/summary.json"));
        for key in ["status", "last", "largest", "steps"] {
            assert_eq!(found[key], known[key], "{case}: {key}");
        }
        assert_eq!(found["scenario"]["system"], known["scenario"]["system"]);
        for file in ["coordinates.svg", "energy.svg", "map.svg"] {
            assert!(place.path(&format!("out/{case}")).join(file).exists(), "{case}: {file}");
        }
    }
}

#[test]
fn load_cases_go_on_after_an_interruption() {
    let place = place();
    let scenario = format!("{CHAIN}{CASES}");
    let run = |out: &str, steps: &str, arguments: &[&str]| {
        place.write("scenario.toml", &scenario.replace("steps = 40", steps));
        let output = place.fvi(&[&["run", "scenario.toml", "--out", out], arguments].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
    };
    run("out", "steps = 40", &[]);
    run("parts", "steps = 17", &["--checkpoint-every", "10"]);
    run("parts", "steps = 40", &["--resume"]);
    for case in ["near", "far-and-near", "none-of-its-own"] {
        for file in ["trajectory.csv", "coordinates.svg", "snapshots.npz", "map.svg"] {
            let of = |directory: &str| fs::read(place.path(directory).join(case).join(file)).unwrap();
            assert!(of("out") == of("parts"), "{case}: {file}");
        }
        let largest = |directory: &str| -> serde_json::Value {
            let file = place.path(directory).join(case).join("summary.json");
            serde_json::from_slice::<serde_json::Value>(&fs::read(file).unwrap()).unwrap()["largest"].take()
        };
        assert_eq!(largest("out"), largest("parts"));
    }
}

#[test]
fn load_cases_of_what_is_not_linear_are_refused() {
    let place = place();
    let with = |old: &str, new: &str| format!("{CHAIN}{CASES}").replacen(old, new, 1);
    let element = "[[system.element]]\npotential = \"x0^4\"\ncoordinates = [[3]]\n[[system.load]]";
    let cases: [(String, &[&str]); 9] = [
        (with("[[system.load]]", element), &["system.element", "linear", "[[case]]"]),
        (with("stiffness = ", "potential = \"q0^2\"\nstiffness = "), &["system.potential", "linear"]),
        (with("name = \"near\"\n", ""), &["case[0]", "name"]),
        (with("\"far-and-near\"", "\"NEAR\""), &["case[1].name", "of its own"]),
        (with("\"near\"", "\"../near\""), &["case[0].name", "directory"]),
        (with("coordinate = 120", "coordinate = 150"), &["case[1].load[0].pattern.coordinate", "0 to 149"]),
        (with("\"sin(4*t)\"", "\"1/t + q0\""), &["case[0].load[0].amplitude", "q0"]),
        (with("[time]", "[reference]\nposition = \"r\"\n[time]"), &["reference"]),
        (
            with("kind = \"low-order\"", "kind = \"galerkin\"\ndegree = 3"),
            &["scheme", "[[case]]", "sparse factor", "`degree` = 2 on two Gauss points"],
        ),
    ];
    for (scenario, said) in cases {
        place.write("scenario.toml", &scenario);
        let output = place.fvi(&["run", "scenario.toml", "--out", "refused"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        let flat: String =
            message.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
        for word in said {
            assert!(flat.contains(word), "no `{word}` in {message}");
        }
        assert!(!place.path("refused").exists());
    }
    place.write("scenario.toml", &format!("{CHAIN}{CASES}"));
    let output = place.fvi(&["converge", "scenario.toml", "--levels", "3..4"]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("case"));
}
