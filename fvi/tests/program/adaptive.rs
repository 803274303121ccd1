//! Steps chosen on the way: errors that follow the tolerance, jumps that are found, runs that go on with the
//! same bits, and what is refused.

use crate::workplace::{Run, Workplace, text};
use fvi_core::min_or_nan;
use fvi_fft::sums::max_or_nan;
use fvi_host::checkpoint::CheckpointEvery;
use fvi_host::run::{RunEnd, RunOptions, run};
use fvi_scenario::scenario::Scenario;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// q̈ + D^β q + q = f on [0, end] by collocation.
fn scenario(order: f64, start: f64, force: &str, time: Value) -> Value {
    json!({
        "system": {
            "mass": [1.0],
            "potential": "0.5*q0^2",
            "force": [force],
            "damping": [{ "order": order, "coefficient": [1.0], "derivative": "caputo" }],
        },
        "initial": { "position": [start], "velocity": [0.0] },
        "scheme": { "kind": "collocation" },
        "time": time,
    })
}

fn adaptive(end: f64, tolerance: f64) -> Value {
    json!({ "grid": "adaptive", "end": end, "tolerance": tolerance })
}

/// Runs a scenario; the summary and the rows (t, q, p).
fn rows(scenario: &Value) -> (fvi_host::run::RunSummary, Vec<[f64; 3]>) {
    let scenario = Scenario::from_value(scenario).unwrap();
    let mut rows = Vec::new();
    let mut run = fvi_host::run::Run::of(&scenario).start().unwrap();
    let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
        portion.states(|_, state| {
            rows.push([state.time, state.position[0], state.momentum[0]]);
            Ok::<_, std::convert::Infallible>(())
        })
    });
    (run.summary(end), rows)
}

/// Largest errors of q and p over the rows where they are known.
fn errors(rows: &[[f64; 3]], exact: impl Fn(f64) -> (f64, f64)) -> f64 {
    let errors = rows.iter().flat_map(|&[t, q, p]| {
        let (exact_q, exact_p) = exact(t);
        [(q - exact_q).abs(), (p - exact_p).abs()]
    });
    errors.fold(0.0, max_or_nan)
}

fn assert_few_rejections(summary: &fvi_host::run::RunSummary) {
    let attempts = summary.attempts.unwrap();
    assert!(100 * attempts.rejected <= 15 * attempts.made, "{attempts:?}");
    assert_eq!(summary.steps, 2 * (attempts.made - attempts.rejected));
}

#[test]
fn errors_follow_the_tolerance_through_a_singular_start() {
    let force = "15/4*sqrt(t) + 15/8*sqrt(pi)*t + t^2.5";
    let mut before = f64::INFINITY;
    for tolerance in [1e-4, 1e-6, 1e-8, 1e-10] {
        let (summary, rows) = rows(&scenario(1.5, 0.0, force, adaptive(1.0, tolerance)));
        assert_eq!(summary.end, RunEnd::Completed);
        assert_eq!(summary.last.time, 1.0);
        let error = errors(&rows, |t| (t.powf(2.5), 2.5 * t.powf(1.5)));
        assert!(error < 10.0 * tolerance && error < 0.1 * before, "{tolerance:e}: {error:e}");
        assert!(summary.steps < 400, "{tolerance:e}: {} steps", summary.steps);
        before = error;
    }
}

#[test]
fn the_unit_of_time_makes_no_difference() {
    // v̇ = −√v from v = 1 stops at t = 2.
    let exact = |t: f64| {
        let left = if t < 2.0 { 1.0 - 0.5 * t } else { 0.0 };
        (2.0 / 3.0 * (1.0 - left.powi(3)), left.powi(2))
    };
    let mut steps = Vec::new();
    for unit in [1.0, 3600.0, 1e-3, 1e-6] {
        let scenario = json!({
            "system": { "mass": [1.0], "force": [format!("-{:?}*sign(v0)*sqrt(abs(v0))", f64::powf(unit, 1.5))] },
            "initial": { "position": [0.0], "velocity": [unit] },
            "scheme": { "kind": "collocation" },
            "time": adaptive(4.0 / unit, 1e-6),
        });
        let (summary, rows) = rows(&scenario);
        let rows: Vec<_> = rows.iter().map(|&[t, q, p]| [t * unit, q, p / unit]).collect();
        let error = errors(&rows, exact);
        assert!(error < 1e-6, "{unit}: {error:e} in {} steps", summary.steps);
        steps.push(summary.steps);
    }
    assert!(steps.iter().all(|&count| count == steps[0]), "{steps:?}");
}

/// q̈ + ½ D q + q = 0 after Riemann and Liouville from q = 1: the kick −½ at t = 0, and a damped cosine.
#[test]
fn a_kick_at_the_start_is_passed_when_times_are_asked_for_too() {
    let place = Workplace::new();
    let scenario = "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n\
                    damping = [{ order = 1.0, coefficient = [0.5], derivative = \"riemann-liouville\" }]\n\
                    [initial]\nposition = [1.0]\n[scheme]\nkind = \"collocation\"\n\
                    [time]\ngrid = \"adaptive\"\nend = 5.0\ntolerance = 1e-6\n[output]\ntimes = [1.0, 5.0]\n";
    let run = place.run(scenario, &[]);
    let (rate, omega) = (0.25, (1.0 - 0.0625f64).sqrt());
    for row in &run.rows {
        let [t, q] = [row[0], row[1]];
        // q̇ = −½ behind the kick.
        let exact = (-rate * t).exp() * ((omega * t).cos() + (rate - 0.5) / omega * (omega * t).sin());
        assert!((q - exact).abs() < 1e-5, "{t}: {q}, not {exact}");
    }
}

#[test]
fn errors_follow_the_tolerance_without_memory() {
    // cos t, whose errors no damping forgets.
    for tolerance in [1e-4, 1e-7, 1e-10] {
        let mut free = scenario(1.5, 1.0, "0", adaptive(20.0, tolerance));
        free["system"]["damping"] = json!([]);
        let (summary, rows) = rows(&free);
        let error = errors(&rows, |t| (t.cos(), -t.sin()));
        assert!(error < 10.0 * tolerance && error > 1e-3 * tolerance, "{tolerance:e}: {error:e}");
        assert_few_rejections(&summary);
    }
}

#[test]
fn a_jump_is_found_and_is_a_grid_point() {
    // Without damping: 8 (1 − cos t) up to the jump, then the swing from there.
    let exact = |t: f64| match t {
        t if t <= 1.0 => (8.0 * (1.0 - t.cos()), 8.0 * t.sin()),
        t => (8.0 * ((t - 1.0).cos() - t.cos()), 8.0 * (t.sin() - (t - 1.0).sin())),
    };
    for force in ["8*step(1 - t)", "8*step(cos(t) - cos(1))*step(3 - t)"] {
        let mut free = scenario(1.5, 0.0, force, adaptive(5.0, 1e-8));
        free["system"]["damping"] = json!([]);
        let (summary, rows) = rows(&free);
        assert!(rows.iter().any(|row| (row[0] - 1.0).abs() < 1e-15), "{force}");
        assert!(errors(&rows, exact) < 8e-7, "{force}: {:e}", errors(&rows, exact));
        assert_few_rejections(&summary);
    }
}

#[test]
fn samples_and_times_that_must_be_hit_are_grid_points() {
    let mut driven = scenario(0.5, 0.0, "0", adaptive(2.0, 1e-6));
    driven["time"]["must_hit"] = json!([0.3, 1.7]);
    driven["input"] = json!({ "samples": [1.0, -1.0], "times": [0.25, 1.1] });
    let (summary, rows) = rows(&driven);
    for time in [0.25, 0.3, 1.1, 1.7, 2.0] {
        assert!(rows.iter().any(|row| row[0] == time), "{time}");
    }
    // Nothing moves before the first sample.
    assert!(rows.iter().filter(|row| row[0] <= 0.25).all(|row| row[1] == 0.0));
    let lengths = summary.step_lengths.unwrap();
    let shortest = rows.windows(2).map(|pair| pair[1][0] - pair[0][0]).fold(f64::INFINITY, min_or_nan);
    assert!((lengths.smallest / shortest - 1.0).abs() < 1e-3 && lengths.largest <= 2.0);
}

/// m q̈ + k q + ρ D^β q = f from q₀ and v₀ to t = 1, where (q, p) is known from the inverse of the Laplace
/// transform (mpmath, Talbot's contour, 30 digits).
#[test]
fn starts_near_order_two_with_a_velocity_are_no_more_than_rounding() {
    let cases = [
        (1.0, 1.9, 10.0, "caputo", "0", [-2.0, 1.0], 1e-9, [-0.91907322888289, 1.1361584452613]),
        (1000.0, 1.95, 10.0, "caputo", "0", [-2.0, 0.5], 1e-8, [1.1443313360377, -8.9600365839442]),
        (1000.0, 1.95, 10.0, "caputo", "0", [-2.0, 0.5], 1e-10, [1.1443313360377, -8.9600365839442]),
        (1.0, 1.99, 0.01, "caputo", "t^0.5", [-2.0, 1.0], 1e-8, [0.0019741048572726, 2.8020130493586]),
        (1.0, 1.99, 0.01, "caputo", "t^0.5", [-2.0, 1.0], 1e-10, [0.0019741048572726, 2.8020130493586]),
        // The momentum begins like −1000 t^0.5.
        (
            1.0,
            0.5,
            1000.0,
            "riemann-liouville",
            "0",
            [-2.0, 1.0],
            1e-6,
            [0.00112736844994, -0.00112833594745],
        ),
    ];
    for (stiffness, order, coefficient, derivative, force, start, tolerance, exact) in cases {
        let scenario = json!({
            "system": {
                "mass": [1.0],
                "potential": format!("0.5*{stiffness}*q0^2"),
                "force": [force],
                "damping": [{ "order": order, "coefficient": [coefficient], "derivative": derivative }],
            },
            "initial": { "position": [start[0]], "velocity": [start[1]] },
            "scheme": { "kind": "collocation" },
            "time": adaptive(1.0, tolerance),
        });
        let (summary, rows) = rows(&scenario);
        assert_eq!(summary.end, RunEnd::Completed, "order {order}");
        let largest = rows.iter().flat_map(|row| [row[1].abs(), row[2].abs()]).fold(1.0, max_or_nan);
        let &[time, q, p] = rows.last().unwrap();
        let error = max_or_nan((q - exact[0]).abs(), (p - exact[1]).abs());
        assert!(time == 1.0 && error < 10.0 * tolerance * largest, "order {order}: {error:e}");
        assert!(summary.steps < 700, "order {order}: {} steps", summary.steps);
    }
}

/// ρ |q₀| t^(1−β)/Γ(2 − β) is the momentum while the position has not moved.
#[test]
fn momenta_are_right_after_a_start_that_no_step_resolves() {
    for (order, gamma, powers) in [
        (0.999, 0.999_423_772_484_595_4, [1e-4, 1e-6, 1e-8, 1e-10]),
        (0.99, 0.994_325_851_191_506_4, [1e-5, 1e-6, 1e-8, 1e-10]),
    ] {
        for tolerance in powers {
            let mut singular = scenario(order, -2.0, "0", adaptive(1.0, tolerance));
            singular["system"]["damping"][0]["derivative"] = json!("riemann-liouville");
            let coefficient = singular["system"]["damping"][0]["coefficient"][0].as_f64().unwrap();
            let (summary, rows) = rows(&singular);
            assert_eq!(summary.end, RunEnd::Completed, "order {order}, tolerance {tolerance:e}");
            let exact = |t: f64| coefficient * 2.0 * t.powf(1.0 - order) / gamma;
            let largest = exact(1e-6);
            let early = rows.iter().filter(|row| row[0] > 2e-25 && row[0] < 1e-12);
            let error =
                early.clone().fold(0.0, |most: f64, row| max_or_nan(most, (row[2] - exact(row[0])).abs()));
            assert!(
                early.count() > 3 && error < 10.0 * tolerance * largest,
                "{order}, {tolerance:e}: {error:e}"
            );
        }
    }
}

#[test]
fn a_start_that_the_shortest_step_does_not_resolve_is_refused_with_its_power() {
    let mut singular = scenario(0.999, -2.0, "0", adaptive(1.0, 1e-8));
    singular["system"]["damping"][0]["derivative"] = json!("riemann-liouville");
    singular["time"]["shortest"] = json!(1e-20);
    let RunEnd::Failed { reason, .. } = rows(&singular).0.end else { panic!() };
    assert!(reason.contains("begin like t^0.001") && reason.contains("time.shortest"), "{reason}");
}

#[test]
fn stiff_systems_take_long_steps() {
    // A stiff spring between two masses whose motion it does not take part in.
    let stiff = json!({
        "system": {
            "mass": [1.0, 0.01],
            "potential": "0.5*q0^2 + 0.5*1e8*(q1 - q0)^2",
            "damping": [
                { "order": 0.5, "coefficient": [0.3, 0.5] },
                { "order": 1.0, "coefficient": [[1e4, -1e4], [-1e4, 1e4]] },
            ],
        },
        "initial": { "position": [1.0, 1.0], "velocity": [0.0, 0.0] },
        "scheme": { "kind": "collocation" },
        "time": adaptive(10.0, 1e-6),
    });
    let (summary, _) = rows(&stiff);
    assert_eq!(summary.end, RunEnd::Completed);
    // The period of the spring is 6e-4.
    assert!(summary.steps < 400, "{}", summary.steps);
}

/// Runs until `last` steps are made, or to the end; whether it got there.
fn run_until(
    scenario: &Scenario,
    directory: &Path,
    precision: fvi_simulation::simulation::Precision,
    last: Option<usize>,
) {
    let stop = AtomicBool::new(false);
    let options = RunOptions {
        precision,
        checkpoints: CheckpointEvery::Steps(5),
        resume: true,
        ..RunOptions::new(directory)
    };
    run(scenario, &options, &stop, &mut |steps| {
        if last == Some(steps) {
            stop.store(true, Ordering::Relaxed);
        }
    })
    .unwrap();
}

#[test]
fn a_run_that_is_interrupted_goes_on_with_the_same_bits() {
    let mut driven = scenario(0.5, 1.0, "step(sin(3*t)) - 0.1*step(q0 - 0.3)", adaptive(4.0, 1e-6));
    driven["system"]["potential"] = json!("0.5*q0^2 + 0.2*abs(q0 - 0.9)");
    driven["output"] = json!({ "times": [0.001, 0.5, 1.0, 2.5, 3.9] });
    driven["event"] = json!([{ "when": "sin(40*q0)" }, { "when": "p0", "direction": "rising" }]);
    for (precision, tolerance) in [
        (fvi_simulation::simulation::Precision::F64, 1e-6),
        (fvi_simulation::simulation::Precision::F32, 1e-4),
    ] {
        driven["time"]["tolerance"] = json!(tolerance);
        let scenario = Scenario::from_value(&driven).unwrap();
        let place = tempfile::tempdir().unwrap();
        let files = |name: &str| {
            let trajectory = std::fs::read(place.path().join(name).join("trajectory.csv")).unwrap();
            let summary = std::fs::read_to_string(place.path().join(name).join("summary.json")).unwrap();
            let mut summary: Value = serde_json::from_str(&summary).unwrap();
            for key in ["seconds", "preparation_seconds"] {
                summary.as_object_mut().unwrap().remove(key);
            }
            (trajectory, summary)
        };
        run_until(&scenario, &place.path().join("undisturbed"), precision, None);
        // After a whole pair of steps, and between the halves of one.
        for stops in [vec![8, 21], vec![7], vec![1, 2, 3, 30]] {
            let name = format!("interrupted-{}", stops.len());
            for stop in stops {
                run_until(&scenario, &place.path().join(&name), precision, Some(stop));
            }
            run_until(&scenario, &place.path().join(&name), precision, None);
            assert!(files(&name) == files("undisturbed"), "{precision:?} {name}");
        }
    }
}

#[test]
fn no_step_is_shorter_than_the_shortest() {
    // Pairs of no length from 2·0.3 on but the whole fill [0, 1]; what is too rough for them is said.
    for (shortest, steps) in [(0.3, 2), (0.2, 4), (0.24, 4), (0.05, 6)] {
        let mut time = adaptive(1.0, 0.1);
        time["shortest"] = json!(shortest);
        let (summary, rows) = rows(&scenario(0.5, 1.0, "0", time));
        assert_eq!(summary.end, RunEnd::Completed, "{shortest}");
        let least = rows.windows(2).map(|pair| pair[1][0] - pair[0][0]).fold(f64::INFINITY, min_or_nan);
        assert!(least >= shortest, "{shortest}: {least}");
        assert!(rows.len() <= steps + 1 && rows.last().unwrap()[0] == 1.0, "{shortest}: {}", rows.len());
    }
    let mut time = adaptive(1.0, 1e-10);
    time["shortest"] = json!(0.3);
    let RunEnd::Failed { reason, .. } = rows(&scenario(0.5, 1.0, "0", time)).0.end else { panic!() };
    assert!(reason.starts_with("the error is ") && reason.contains("with steps of 5.0e-1 even"), "{reason}");
}

#[test]
fn a_motion_that_blows_up_ends_with_what_was_computed() {
    let place = Workplace::new();
    place.write(
        "escape.toml",
        // q̈ = 4 q³ reaches infinity at t = 0.927.
        "[system]\nmass = [1.0]\npotential = \"-q0^4\"\n[initial]\nposition = [1.0]\n[scheme]\nkind = \"collocation\"\n\
         [time]\ngrid = \"adaptive\"\nend = 2.0\ntolerance = 1e-6\n",
    );
    let output = place.fvi(&["run", "escape.toml", "--out", "out"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("times the tolerance") && message.contains("time.shortest"), "{message}");
    let run = Run::read(&place.path("out"));
    assert!(run.rows.len() > 10 && run.rows.last().unwrap()[0] < 1.0);
    assert_eq!(run.summary["status"], "failed");
}

#[test]
fn what_makes_no_sense_is_refused() {
    let mistakes = [
        ("end = 1.0", "", "missing"),
        ("end = 1.0\ntolerance = 1e-15", "", "1e-12 ≤ tolerance"),
        ("end = 1.0\ntolerance = 0.5", "", "≤ 0.1"),
        ("end = 1.0\ntolerance = 1e-9", "f32", "single precision"),
        ("end = 1.0\ntolerance = 1e-6\nlongest = 1e-3\nshortest = 1e-2", "", "`time.longest`"),
        ("end = 1.0\ntolerance = 1e-6\nfirst = 2.0", "", "a first step between"),
        ("end = 1.0\ntolerance = 1e-6\nscale = 0.0", "", "time.scale"),
        ("end = 1.0\ntolerance = 1e-6\nsteps = 100", "", "unknown key"),
        ("end = 1.0\ntolerance = 1e-6\nshortest = 1e-3\nmust_hit = [0.5, 0.5001]", "", "0.5001"),
    ];
    for (time, precision, told) in mistakes {
        let place = Workplace::new();
        let scenario = format!(
            "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[initial]\nposition = [1.0]\nvelocity = [0.0]\n\
             [scheme]\nkind = \"collocation\"\n[time]\ngrid = \"adaptive\"\n{time}\n"
        );
        place.write("bad.toml", &scenario);
        let precision = if precision.is_empty() { "f64" } else { precision };
        let output = place.fvi(&["run", "bad.toml", "--out", "out", "--precision", precision]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{time}: {message}");
        assert!(message.contains("bad.toml") && message.contains(told), "{time}: {message}");
        assert!(!place.path("out").join("trajectory.csv").exists());
    }
}

#[test]
fn rows_between_grid_points_are_held_to_the_tolerance_with_every_degree() {
    for degree in [2, 3] {
        let oscillator = format!(
            "system.mass = [1.0]\nsystem.stiffness = [1.0]\ninitial.position = [1.0]\n\
             scheme = {{ kind = \"galerkin\", degree = {degree} }}\n\
             convolution = {{ family = \"radau-iia\", stages = 3 }}\n\
             time = {{ grid = \"adaptive\", end = 4.0, tolerance = 1e-10 }}\noutput.times = [0.3, 0.7, 1.3, 2.5, 3.3]\n"
        );
        let run = Workplace::new().run(&oscillator, &[]);
        let (times, positions) = (run.column("t"), run.column("q0"));
        assert_eq!(times, [0.3, 0.7, 1.3, 2.5, 3.3]);
        let error = times.iter().zip(&positions).map(|(t, q)| (q - t.cos()).abs()).fold(0.0, max_or_nan);
        assert!(error < 2e-10, "degree {degree}: {error:e}");
    }
}

/// Against a wall, where forces bend and steps of one length lose their order, a tolerance is reached with
/// about the same steps whatever the unit of length is.
#[test]
fn steps_that_a_tolerance_chooses_do_not_depend_on_the_unit_of_length() {
    let run = |length: f64| {
        let wall = format!(
            "system.mass = [1.0]\nsystem.potential = \"2*q0^2 + 25*max(q0 - {:e}, 0)^2\"\n\
             system.damping = [{{ order = 0.5, coefficient = [0.3] }}]\ninitial = {{ position = [{:e}] }}\n\
             scheme = {{ kind = \"auto\", tolerance = 1e-6 }}\ntime = {{ end = 5.0 }}\n",
            0.4 * length,
            -length
        );
        let run = Workplace::new().run(&wall, &[]);
        let last = |name: &str| run.column(name).last().unwrap() / length;
        (run.column("t").len(), [last("q0"), last("p0")])
    };
    let (rows, known) = run(1.0);
    for length in [1e-3, 1e-4, 1e-9, 1e3] {
        let (found, last) = run(length);
        assert!(found < 2 * rows && rows < 2 * found, "{length}: {found} rows, {rows}");
        for (last, known) in last.iter().zip(known) {
            assert!((last - known).abs() < 4e-6, "{length}: {last} {known}");
        }
    }
}
