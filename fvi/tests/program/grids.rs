//! Grids whose steps differ, as a user runs them: full order through singular starts, decades of time, rows
//! between grid points, and what is refused.

use crate::workplace::{Run, Workplace, text};

/// q̈ + D^(3/2) q + q = f with the solution t^(5/2).
fn root(scheme: &str, time: &str) -> Run {
    let scenario = format!(
        r#"
[system]
mass = [1.0]
potential = "0.5*q0^2"
force = ["15/4*sqrt(t) + 15/8*sqrt(pi)*t + t^2.5"]
[[system.damping]]
order = 1.5
coefficient = [1.0]
[initial]
position = [0.0]
velocity = [0.0]
{scheme}
[time]
{time}
[reference]
position = ["t^2.5"]
momentum = ["2.5*t^1.5"]
"#
    );
    run(&scenario, &[])
}

/// q̈ + D^β q + q = 0 in Caputo's sense from q = 1, against values of 20 digits.
fn caputo(order: f64, scheme: &str, time: &str, values: &str) -> Run {
    let scenario = format!(
        r#"
[system]
mass = [1.0]
potential = "0.5*q0^2"
[[system.damping]]
order = {order}
coefficient = [1.0]
[initial]
position = [1.0]
velocity = [0.0]
{scheme}
[time]
{time}
[output]
times = [0.001, 0.01, 0.1, 0.5, 1, 2, 5, 10, 20]
[reference]
file = "values.csv"
"#
    );
    run(&scenario, &[("values.csv", values)])
}

fn run(scenario: &str, files: &[(&str, &str)]) -> Run {
    let place = Workplace::new();
    place.write("grid.toml", scenario);
    for (name, content) in files {
        place.write(name, content);
    }
    let output = place.fvi(&["run", "grid.toml", "--out", "out"]);
    assert!(output.status.success(), "{scenario}: {}", text(&output.stderr));
    Run::read(&place.path("out"))
}

fn largest_error(run: &Run, of: &str) -> f64 {
    run.summary["errors"][of]["largest"].as_f64().unwrap()
}

const COLLOCATION: &str = "[scheme]\nkind = \"collocation\"";

/// Laplace transforms (s + s^(β−1))/(s² + s^β + 1) inverted on Talbot's contour in 40 digits.
const START_OF_ORDER_0_3: &str = "t,q0
0.001,0.99999950000055641398
0.01,0.99995000299642955243
0.1,0.99501706899657449072
0.5,0.88238089450643350365
1,0.59665947117769712771
2,0.083186176675696372046
5,0.5066869290209230929
10,0.30649607164871940541
20,0.23698833269962833135
";

#[test]
fn graded_steps_have_full_order_through_a_singular_start() {
    let error = |exponent: f64, steps: usize| {
        let time = format!("grid = \"graded\"\nend = 1.0\nexponent = {exponent}\nsteps = {steps}");
        let run = root(COLLOCATION, &time);
        assert_eq!(run.rows.len(), steps + 1);
        assert_eq!(run.summary["engine"][0], "any-step");
        largest_error(&run, "position")
    };
    assert!(error(3.0, 160) < 1.5e-11 && error(3.0, 320) < 1e-12);
    for exponent in [4.0, 5.0] {
        let (coarse, fine) = (error(exponent, 40), error(exponent, 80));
        let order = (coarse / fine).log2();
        assert!((order - 5.0).abs() < 0.3, "exponent {exponent}: order {order}");
    }
    // Equal steps: 1.5.
    let uniform = root(COLLOCATION, "step = 0.01\nend = 1.0");
    assert!(largest_error(&uniform, "position") > 1e-6);
}

#[test]
fn a_start_in_caputos_sense_keeps_nine_digits() {
    let time = "grid = \"geometric\"\nfirst = 1e-9\nratio = 1.3\nlongest = 0.05\nend = 20.0";
    let run = caputo(0.3, COLLOCATION, time, START_OF_ORDER_0_3);
    assert!(run.summary["steps"].as_u64().unwrap() <= 470);
    // One row for each of the times asked for.
    assert_eq!(run.rows.len(), 9);
    assert_eq!(run.summary["errors"]["position"]["compared"], 10);
    assert!(largest_error(&run, "position") < 4e-10);
    assert!(run.summary["step_lengths"]["smallest"].as_f64().unwrap() <= 1e-9);
    // The Galerkin scheme on the same nodes takes the same grid.
    let galerkin =
        "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 3";
    let run = caputo(0.3, galerkin, time, START_OF_ORDER_0_3);
    assert!(largest_error(&run, "position") < 1e-5, "{}", largest_error(&run, "position"));
}

#[test]
fn given_equal_steps_are_a_uniform_grid() {
    let galerkin =
        "[scheme]\nkind = \"galerkin\"\ndegree = 3\n[convolution]\nfamily = \"radau-iia\"\nstages = 3";
    for scheme in [COLLOCATION, galerkin] {
        let points: Vec<String> = (0..=200).map(|k| format!("{:?}", 0.01 * f64::from(k))).collect();
        let given = root(scheme, &format!("grid = \"points\"\npoints = [{}]", points.join(", ")));
        let uniform = root(scheme, "step = 0.01\nsteps = 200");
        assert_eq!(given.rows.len(), uniform.rows.len());
        for (a, b) in given.rows.iter().zip(&uniform.rows) {
            for (a, b) in a.iter().zip(b) {
                assert!((a - b).abs() < 1e-11 * 40.0, "{a} {b}");
            }
        }
    }
}

#[test]
fn times_that_must_be_hit_are_rows() {
    let time = "grid = \"graded\"\nend = 1.0\nexponent = 2.0\nsteps = 10\nmust_hit = [0.3, 0.7]";
    let run = root(COLLOCATION, time);
    for hit in [0.3, 0.7, 1.0] {
        assert!(run.rows.iter().any(|row| row[0] == hit), "{hit}");
    }
}

#[test]
fn grids_that_make_no_sense_are_refused() {
    let good = |time: &str, scheme: &str| {
        format!(
            "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[[system.damping]]\norder = 0.5\ncoefficient = [1.0]\n\
             [initial]\nposition = [1.0]\nvelocity = [0.0]\n[scheme]\n{scheme}\n[time]\n{time}\n"
        )
    };
    let collocation = "kind = \"collocation\"";
    let mistakes = [
        ("grid = \"graded\"\nend = 1.0\nsteps = 4\nexponent = 0.5", collocation, "time.exponent = 0.5"),
        ("grid = \"geometric\"\nend = 1.0\nfirst = 0.1\nratio = 1.0", collocation, "a ratio greater than 1"),
        (
            "grid = \"geometric\"\nend = 1.0\nfirst = 2.0\nratio = 2.0",
            collocation,
            "a first step up to the end",
        ),
        ("grid = \"points\"\npoints = [0.0, 0.5, 0.5, 1.0]", collocation, "0.5 is followed by 0.5"),
        ("grid = \"points\"\npoints = [0.1, 0.5]", collocation, "times that begin with 0"),
        ("grid = \"points\"\npoints = [0.0, 0.5]\nend = 1.0", collocation, "the last of `time.points`, 0.5"),
        ("step = 0.1\nend = 1.0\nmust_hit = [0.55]", collocation, "0.55 is none"),
        (
            "grid = \"graded\"\nend = 1.0\nsteps = 4\nexponent = 2.0\nmust_hit = [2.0]",
            collocation,
            "2 is not",
        ),
        (
            "grid = \"graded\"\nend = 1.0\nsteps = 4\nexponent = 2.0",
            "kind = \"low-order\"",
            "for equal steps",
        ),
        ("grid = \"graded\"\nend = 1.0\nstep = 0.1\nexponent = 2.0", collocation, "unknown key"),
        ("grid = \"wild\"\nend = 1.0", collocation, "\"uniform\", \"graded\", \"geometric\", \"points\""),
    ];
    for (time, scheme, told) in mistakes {
        let place = Workplace::new();
        place.write("bad.toml", &good(time, scheme));
        let output = place.fvi(&["run", "bad.toml", "--out", "out"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{time}: {message}");
        assert!(message.contains("bad.toml:") && message.contains(told), "{time}: {message}");
        assert!(!place.path("out").join("trajectory.csv").exists());
    }
    let place = Workplace::new();
    place.write("good.toml", &good("grid = \"graded\"\nend = 1.0\nsteps = 4\nexponent = 2.0", collocation));
    let output = place.fvi(&["run", "good.toml", "--engine", "direct"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("its weights are for equal steps"), "{}", text(&output.stderr));
    for arguments in [["--until", "0.5"], ["--steps", "2"]] {
        let output = place.fvi(&[&["run", "good.toml"], arguments.as_slice()].concat());
        assert_eq!(output.status.code(), Some(2));
        let message = text(&output.stderr);
        assert!(
            message.contains("good.toml:") && message.contains("steps that differ end where it says"),
            "{message}"
        );
    }
    let family = "kind = \"collocation\"\n[convolution]\nfamily = \"bdf\"";
    place.write("bdf.toml", &good("step = 0.1\nend = 1.0", family));
    let output = place.fvi(&["run", "bdf.toml"]);
    assert!(text(&output.stderr).contains("\"radau-iia\", whose nodes"), "{}", text(&output.stderr));
}
