//! What a user of `fvi run` relies on: its files, its options, its ends.

use crate::workplace::{Run, Workplace, text};
use fvi_fft::sums::max_or_nan;
use std::fs;
use std::io::Read;
use std::process::Stdio;
use std::time::Duration;

const OSCILLATOR: &str = r#"
[system]
mass = [2.0]
potential = "0.5*k*q0^2"
parameters = { k = 3.0 }
[[system.damping]]
order = 0.5
coefficient = [0.25]
[initial]
position = [1.0]
velocity = [0.25]
[scheme]
kind = "low-order"
[convolution]
family = "bdf"
order = 2
[time]
step = 0.1
steps = 25
"#;

#[test]
fn pictures_have_the_names_units_and_size_that_were_asked_for_and_the_data_stay_as_they_are() {
    let place = Workplace::new();
    let plain = place.run(OSCILLATOR, &[]).rows;
    let output = r#"
        [output]
        labels = ["angle of the arm"]
        units = { time = "s", position = "rad", energy = "J" }
        picture = { width = 84, height = 60, font = 8 }
    "#;
    assert_eq!(place.run(&format!("{OSCILLATOR}{output}"), &[]).rows, plain);
    let picture = |name: &str| fs::read_to_string(place.path("out").join(name)).unwrap();
    for (name, words) in [
        ("coordinates.svg", ["time t (s)", "angle of the arm (rad)"]),
        ("energy.svg", ["time t (s)", "energy ½ pᵀM⁻¹p + U(q) (J)"]),
        ("phase.svg", ["angle of the arm (rad)", "momentum p0"]),
    ] {
        let svg = picture(name);
        assert!(svg.starts_with("<svg width=\"84mm\" height=\"60mm\" viewBox="), "{name}: {}", &svg[..80]);
        for words in words {
            assert!(svg.contains(words), "{name} does not say {words}");
        }
    }
}

#[test]
fn pictures_that_cannot_be_drawn_are_refused_with_what_is_allowed() {
    let place = Workplace::new();
    for (line, words) in [
        ("labels = [\"a\", \"b\"]", "1 names, one for each coordinate that is drawn, not 2"),
        ("labels = [\"\"]", "a name of 1 … 80 characters in one line"),
        ("units = { speed = \"m/s\" }", "time, position, momentum, energy"),
        ("picture = { width = 3 }", "30 … 1000 millimetres"),
        ("picture = { width = 84, font = 20 }", "for letters of 20 points, a width of 127"),
        ("picture = { font = 8 }", "width"),
    ] {
        place.write("scenario.toml", &format!("{OSCILLATOR}[output]\n{line}\n"));
        let output = place.fvi(&["run", "scenario.toml"]);
        assert_eq!(output.status.code(), Some(2), "{line}");
        let message = text(&output.stderr).replace('\n', " ");
        let message = message.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
        assert!(message.contains(words), "{line}: {message}");
    }
}

#[test]
fn a_run_writes_data_pictures_and_a_line_of_result() {
    let place = Workplace::new();
    place.write("oscillator.toml", OSCILLATOR);
    let output = place.fvi(&["run", "oscillator.toml"]);
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(text(&output.stderr), "");
    let line = text(&output.stdout);
    assert_eq!(line.lines().count(), 1);
    assert!(line.starts_with("oscillator: 25 steps to t = 2.5: q = "), "{line}");
    assert_eq!(place.files(), ["oscillator.toml", "out"]);
    let directory = place.path("out/oscillator");
    let mut files: Vec<_> = fs::read_dir(&directory)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    assert_eq!(files, ["coordinates.svg", "energy.svg", "phase.svg", "summary.json", "trajectory.csv"]);

    let run = Run::read(&directory);
    assert_eq!(run.columns, ["t", "q0", "p0", "energy"]);
    assert_eq!(run.rows.len(), 26);
    assert_eq!(run.rows[0], [0.0, 1.0, 0.5, 0.5 * 0.25 / 2.0 + 1.5]);
    for (index, row) in run.rows.iter().enumerate() {
        assert_eq!(row[0], 0.1 * index as f64);
        assert!((row[3] - (row[2] * row[2] / 4.0 + 1.5 * row[1] * row[1])).abs() < 1e-15);
    }
    assert_eq!(run.summary["status"], "completed");
    assert_eq!(run.summary["steps"], 25);
    assert_eq!(run.summary["last"]["position"][0], run.rows[25][1]);
    assert_eq!(run.summary["scenario"]["scheme"]["kappa"], 0.5);
    assert_eq!(run.summary["scenario"]["system"]["damping"][0]["derivative"], "caputo");
    let portrait = fs::read_to_string(directory.join("phase.svg")).unwrap();
    assert!(portrait.contains("momentum p0"));
}

#[test]
fn every_third_row_and_the_last_are_written() {
    let place = Workplace::new();
    let all = place.run(OSCILLATOR, &[]);
    let some = place.run(&format!("{OSCILLATOR}\n[output]\nevery = 10\n"), &[]);
    assert_eq!(some.rows, [0, 10, 20, 25].map(|index| all.rows[index].clone()));
}

#[test]
fn equal_runs_give_equal_bits() {
    let place = Workplace::new();
    let read = || fs::read(place.path("out/trajectory.csv")).unwrap();
    place.run(OSCILLATOR, &[]);
    let first = read();
    place.run(OSCILLATOR, &[]);
    assert_eq!(first, read());
}

#[test]
fn single_precision_agrees_with_double_to_its_own_rounding() {
    let place = Workplace::new();
    let double = place.run(OSCILLATOR, &[]);
    let single = place.run(OSCILLATOR, &["--precision", "f32"]);
    assert_eq!(single.summary["precision"], "f32");
    for name in ["q0", "p0", "energy"] {
        let (a, b) = (double.column(name), single.column(name));
        assert!(b.iter().all(|&number| f64::from(number as f32) == number));
        let largest = a.iter().fold(0.0_f64, |largest, number| max_or_nan(largest, number.abs()));
        let error = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan);
        assert!(error > 0.0 && error < 1e-5 * largest, "{name}: {error}");
    }
}

/// q = cos t, p = −sin t, energy ½, in rows and at events between grid points, far from t = 0: there the
/// difference of two grid times has few digits.
#[test]
fn states_between_grid_points_far_from_zero_have_the_momentum_of_the_motion() {
    let place = Workplace::new();
    for (precision, start, step, within) in [
        ("f32", 1e5, 0.01, 0.02),
        ("f32", 0.0, 0.01, 0.02),
        ("f64", 1.7e9, 0.001, 2e-6),
        ("f64", 0.0, 0.001, 2e-6),
    ] {
        for scheme in ["low-order", "galerkin\"\ndegree = 2\nquadrature = \"gauss", "collocation"] {
            let scenario = format!(
                "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[initial]\nposition = [1.0]\n\
                 [scheme]\nkind = \"{scheme}\"\n[time]\nstep = {step:?}\nstart = {start:?}\nend = {:?}\n\
                 [output]\ntimes = [{:?}]\n[[event]]\nwhen = \"q0\"\n",
                start + 10.0,
                start + 1.5755,
            );
            let run = place.run(&scenario, &["--precision", precision]);
            let named = ["q0", "p0", "energy"].map(|name| run.column(name));
            for ((&q, &p), &energy) in named[0].iter().zip(&named[1]).zip(&named[2]) {
                let [radius, twice] = [q * q + p * p, 2.0 * energy];
                assert!(
                    (radius - 1.0).abs() < within && (twice - 1.0).abs() < within,
                    "{scenario}: {q} {p} {energy}"
                );
            }
        }
    }
}

/// A bead on a circle turns by an angle of one a second: where it is at a time between grid points, far from t
/// = 0, where times in single precision are 0.008 apart.
#[test]
fn a_mechanism_in_single_precision_is_at_its_place_at_late_times() {
    let place = Workplace::new();
    for start in [0.0, 1e5] {
        let turned = 1.5755f64;
        let scenario = format!(
            "[system]\nmass = [1.0, 1.0]\nconstraints = [\"q0^2 + q1^2 - 1\"]\n\
             [initial]\nposition = [1.0, 0.0]\nvelocity = [0.0, 1.0]\n\
             [scheme]\nkind = \"galerkin\"\ndegree = 2\n\
             [time]\nstep = 0.01\nstart = {start:?}\nend = {:?}\n[output]\ntimes = [{:?}]\n",
            start + 10.0,
            start + turned,
        );
        let run = place.run(&scenario, &["--precision", "f32"]);
        let [x, y] = ["q0", "q1"].map(|name| run.column(name)[0]);
        let off = (x - turned.cos()).hypot(y - turned.sin());
        assert!(off < 2e-5, "from {start}: ({x}, {y}), {off:e} off");
    }
}

#[test]
fn no_steps_give_the_initial_state() {
    let place = Workplace::new();
    let run = place.run(&OSCILLATOR.replace("steps = 25", "end = 0.0"), &[]);
    assert_eq!(run.rows.len(), 1);
}

#[test]
fn quiet_says_nothing() {
    let place = Workplace::new();
    place.write("scenario.toml", OSCILLATOR);
    let output = place.fvi(&["run", "scenario.toml", "--quiet"]);
    assert_eq!((output.status.code(), output.stdout.len(), output.stderr.len()), (Some(0), 0, 0));
}

#[test]
fn a_full_memory_stops_the_run_and_keeps_what_was_computed() {
    let place = Workplace::new();
    let whole = place.run(OSCILLATOR, &[]);
    let text_of =
        |overflow: &str| format!("{OSCILLATOR}\n[history]\ncapacity = 10\noverflow = \"{overflow}\"\n");
    place.write("scenario.toml", &text_of("stop"));
    let output = place.fvi(&["run", "scenario.toml", "--out", "stopped"]);
    assert_eq!(output.status.code(), Some(1));
    let message = text(&output.stderr);
    assert!(message.contains("step 10 (from t = 1 to t = 1.1) failed"), "{message}");
    assert!(message.contains("10 samples"), "{message}");
    let run = Run::read(&place.path("stopped"));
    assert_eq!(run.rows, whole.rows[..11]);
    assert_eq!((&run.summary["status"], &run.summary["step"]), (&"failed".into(), &10.into()));

    // Told to forget, it goes on, and differs from the full memory from the first forgotten sample on.
    let short = place.run(&text_of("forget"), &[]);
    assert_eq!(short.rows.len(), 26);
    assert_eq!(short.rows[..11], whole.rows[..11]);
    assert_ne!(short.rows[25], whole.rows[25]);
}

#[test]
fn a_step_without_a_solution_stops_the_run_and_names_step_and_time() {
    let place = Workplace::new();
    // The force becomes singular at t = 1.
    let scenario =
        OSCILLATOR.replace("parameters = { k = 3.0 }", "parameters = { k = 3.0 }\nforce = [\"sqrt(1 - t)\"]");
    place.write("scenario.toml", &scenario);
    let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let message = text(&output.stderr);
    assert!(message.contains("step 10 (from t = 1 to t = 1.1) failed"), "{message}");
    let run = Run::read(&place.path("out"));
    assert_eq!(run.rows.len(), 11);
    assert_eq!(run.summary["status"], "failed");
}

#[test]
fn errors_against_a_reference_are_in_the_summary_and_in_the_result() {
    let place = Workplace::new();
    let free = r#"
        [system]
        mass = [1.0]
        [initial]
        position = [1.0]
        momentum = [0.5]
        [time]
        step = 0.25
        steps = 8
        [reference]
        position = ["1 + 0.5*t + 0.125*step(t - 1)"]
        energy = "0.125"
    "#;
    place.write("scenario.toml", free);
    let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
    assert!(text(&output.stdout).contains("largest error of q 1.250e-1; largest error of energy 0.000e0"));
    let errors = &Run::read(&place.path("out")).summary["errors"];
    assert_eq!(errors["position"]["largest"], 0.125);
    assert_eq!(errors["position"]["compared"], 9);
    assert_eq!(errors["energy"]["largest"], 0.0);
    assert!(errors.get("momentum").is_none());
}

#[test]
fn a_sampled_input_acts_as_the_same_force_in_time() {
    let place = Workplace::new();
    let with = |more: &str, force: &str| {
        OSCILLATOR.replace("parameters =", &format!("{force}\nparameters =")) + more
    };
    let held = place.run(&with("[input]\nperiod = 0.5\nsamples = [2.0, -1.0, 0.0]\n", ""), &[]);
    let force = "force = [\"2 - 3*step(t - 0.5) + step(t - 1.0)\"]";
    let forced = place.run(&with("", force), &[]);
    assert_eq!(held.rows, forced.rows);
    place.write("drive.csv", "# a comment\nt,u0\n0.0,2.0\n0.5,-1.0\n1.0,0.0\n");
    let from_file = place.run(&with("[input]\nfile = \"drive.csv\"\n", ""), &[]);
    assert_eq!(held.rows, from_file.rows);
}

#[test]
fn an_unstable_step_is_refused_unless_it_is_allowed() {
    let place = Workplace::new();
    let steep = OSCILLATOR
        .replace("order = 0.5", "order = 1.9")
        .replace("[0.25]\n[initial]", "[2.0]\n[initial]")
        .replace("order = 2\n", "order = 2\nat = \"main-nodes\"\n");
    place.write("scenario.toml", &steep);
    let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
    assert_eq!(output.status.code(), Some(2));
    let message = text(&output.stderr);
    assert!(message.contains("time.step = 0.1: unstable: the largest stable step is about "), "{message}");
    assert!(message.contains("allow_unstable"), "{message}");
    assert_eq!(place.files(), ["scenario.toml"]);
    let run = place.run(&steep.replace("step = 0.1", "step = 0.1\nallow_unstable = true"), &[]);
    assert_eq!(run.rows.len(), 26);
}

#[test]
fn a_step_at_which_stage_damping_grows_is_refused() {
    let place = Workplace::new();
    let staged = |degree: usize, more: &str| {
        format!(
            r#"
            [system]
            mass = [0.4]
            potential = "3*q0^2"
            [[system.damping]]
            order = 1.9
            coefficient = [0.9]
            [initial]
            position = [0.0]
            momentum = [0.1]
            [scheme]
            kind = "galerkin"
            degree = {degree}
            [convolution]
            family = "radau-iia"
            stages = 3
            [time]
            step = 0.015625
            steps = 200
            {more}
            "#
        )
    };
    place.write("scenario.toml", &staged(3, ""));
    let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
    assert_eq!(output.status.code(), Some(2));
    let message = text(&output.stderr);
    assert!(message.contains("time.step = 0.015625: unstable: the largest stable step is"), "{message}");
    assert_eq!(place.files(), ["scenario.toml"]);
    let largest = |run: Run| run.column("q0").iter().fold(0.0, |largest, q| max_or_nan(largest, q.abs()));
    assert!(largest(place.run(&staged(3, "allow_unstable = true"), &[])) > 1e3);
    // A degree less lifts the limit. Damping of order 2 would add ρ to the mass: amplitude p₀/m
    // √((m + ρ)/6) = 0.116.
    assert!(largest(place.run(&staged(2, ""), &[])) < 0.12);
}

#[test]
fn the_engine_of_the_command_line_counts() {
    let place = Workplace::new();
    let run = place.run(OSCILLATOR, &["--engine", "direct"]);
    assert_eq!(run.summary["engine"][0], "direct");
    assert_eq!(run.summary["scenario"]["history"]["engine"], "direct");
    let output = place.fvi(&["run", "scenario.toml", "--engine", "fastest"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("direct, block-fft, real-time, exponential-sum"));
}

#[test]
fn a_phase_portrait_of_another_system_does_not_stay_behind() {
    let place = Workplace::new();
    place.run(OSCILLATOR, &[]);
    assert!(place.path("out/phase.svg").exists());
    let two = "[system]\nmass = [1.0, 1.0]\n[initial]\nposition = [0.0, 1.0]\nmomentum = [0.0, 1.0]\n[time]\nstep = 0.1\nsteps = 3\n";
    let run = place.run(two, &[]);
    assert_eq!(run.columns, ["t", "q0", "q1", "p0", "p1", "energy"]);
    assert!(!place.path("out/phase.svg").exists());
}

#[test]
fn there_may_be_any_number_of_coordinates() {
    let place = Workplace::new();
    let scenario = |count: usize| {
        let list = vec!["1.0"; count].join(", ");
        format!(
            "[system]\nmass = [{list}]\npotential = \"0.5*q{}^2\"\n[[system.damping]]\norder = 0.5\ncoefficient = [{list}]\n\
             [initial]\nposition = [{list}]\nmomentum = [{list}]\n[time]\nstep = 0.1\nsteps = 5\n",
            count - 1
        )
    };
    for count in [1, 8, 9, 40] {
        let run = place.run(&scenario(count), &[]);
        let (free, held) = (run.column("q0"), run.column(&format!("q{}", count - 1)));
        // Every coordinate but the last one moves alike; the last one is on a spring.
        if count > 1 {
            assert_eq!(free, run.column(&format!("q{}", count - 2)), "{count}");
            assert!(held[5] < free[5], "{count}");
        }
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_keeps_what_was_computed() {
    let place = Workplace::new();
    place.write("scenario.toml", &OSCILLATOR.replace("steps = 25", "steps = 3_000_000"));
    let mut child = place
        .command(&["run", "scenario.toml", "--out", "out", "--engine", "direct"])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The trajectory's temporary file appears when the first step is about to be made.
    let started = || fs::read_dir(place.path("out")).is_ok_and(|mut entries| entries.next().is_some());
    while !started() {
        assert!(child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_millis(200));
    let interrupt =
        std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(interrupt.success());
    let status = child.wait().unwrap();
    let mut message = String::new();
    child.stderr.take().unwrap().read_to_string(&mut message).unwrap();
    assert_eq!(status.code(), Some(130), "{message}");
    assert!(message.contains("stopped"), "{message}");
    let run = Run::read(&place.path("out"));
    assert_eq!(run.summary["status"], "stopped");
    assert_eq!(run.summary["steps"], run.rows.len() - 1);
    assert!(run.rows.len() > 1 && run.rows.len() < 3_000_000);
}
