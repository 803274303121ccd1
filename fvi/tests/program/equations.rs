//! Fractional differential equations: errors that follow the tolerance on problems with known solutions,
//! files in the user's own names, and messages that say what is wrong.

use crate::workplace::{Run, Workplace, text};
use fvi_host::run::{Run as LabRun, RunEnd};
use fvi_scenario::language::document::Document;
use fvi_scenario::scenario::Scenario;
use serde_json::{Value, json};
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/scenarios/equations")
}

/// The largest error of a scenario of the folder at a tolerance, in units of the tolerance and of the largest
/// value, or of 1 where that is larger.
fn error_in_tolerances(name: &str, tolerance: f64) -> f64 {
    let document = Document::read(&folder().join(name)).unwrap();
    let mut values = document.values().unwrap();
    values["time"]["tolerance"] = toml::Value::Float(tolerance);
    let scenario = Scenario::from_document(document.with_values(&values)).unwrap();
    let mut run = LabRun::of(&scenario).start().unwrap();
    let Ok(end) = run.drive(&AtomicBool::new(false), |_| Ok::<_, Infallible>(()));
    let summary = run.summary(end);
    assert_eq!(summary.end, RunEnd::Completed, "{name} to {tolerance:e}");
    let error = summary.errors.unwrap().position;
    assert!(error.compared >= 6, "{name}: {error:?}");
    error.largest / (tolerance * error.reference_largest.max(1.0))
}

#[test]
fn errors_stay_within_ten_tolerances_from_three_digits_to_thirteen() {
    let mut seen = 0;
    for entry in std::fs::read_dir(folder()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        // Chua's motion is chaotic. The difference of which `roots` takes a root has ten digits at its start.
        if !name.ends_with(".toml") || name == "chua.toml" {
            continue;
        }
        let tolerances: &[f64] =
            if name == "roots.toml" { &[1e-3, 1e-6] } else { &[1e-3, 1e-6, 1e-9, 1e-12, 1e-13] };
        for &tolerance in tolerances {
            let error = error_in_tolerances(&name, tolerance);
            assert!(error <= 10.0, "{name} to {tolerance:e}: {error:.1} tolerances");
            seen += 1;
        }
    }
    assert!(seen >= 40, "{seen}");
}

#[test]
fn published_test_problems_stay_within_ten_tolerances() {
    let mut seen = 0;
    for entry in std::fs::read_dir(folder().join("published")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if !name.ends_with(".toml") {
            continue;
        }
        // 64 oscillations that nothing damps turn errors of the memory's table into errors of their phase.
        let smallest = if name == "fhbvm-oscillating.toml" { 1e-12 } else { 1e-10 };
        for tolerance in [1e-5, smallest] {
            let error = error_in_tolerances(&format!("published/{name}"), tolerance);
            assert!(error <= 10.0, "{name} to {tolerance:e}: {error:.1} tolerances");
            seen += 1;
        }
    }
    assert!(seen >= 24, "{seen}");
}

#[test]
fn stages_are_chosen_by_the_tolerance_or_named() {
    let place = Workplace::new();
    let keys = json!({ "order": 0.5, "right": "-x0", "initial": [1.0] });
    let of = |tolerance: f64, rest: &str| {
        let run =
            place.run(&(equation(keys.clone(), json!({ "end": 5.0, "tolerance": tolerance })) + rest), &[]);
        let stages = run.summary["scenario"]["convolution"]["stages"].as_u64().unwrap();
        (stages, run.summary["steps"].as_u64().unwrap())
    };
    let (coarse, fine) = (of(1e-3, ""), of(1e-12, ""));
    assert!(coarse.0 < 7 && fine.0 == 7, "{coarse:?} {fine:?}");
    let named = of(1e-12, "[convolution]\nstages = 3\n");
    assert!(named.0 == 3 && named.1 > 3 * fine.1, "{named:?} {fine:?}");
    place.write("four.toml", &(equation(keys, json!({ "end": 5.0 })) + "[convolution]\nstages = 4\n"));
    let output = place.fvi(&["run", "four.toml"]);
    assert!(!output.status.success() && text(&output.stderr).contains("1, 2, 3, 5 or 7"));
}

#[test]
fn more_radians_than_the_memory_keeps_the_phase_for_are_told() {
    let place = Workplace::new();
    let warned = |end: f64, right: [&str; 2]| {
        let keys = json!({ "order": 0.5, "right": right, "initial": [1.0, 0.0] });
        let run = place.run(&equation(keys, json!({ "end": end, "tolerance": 1e-13 })), &[]);
        run.summary["warnings"].to_string().contains("radians")
    };
    // D^½ x = λx with arg λ = π/4 oscillates without end, |λ|² radians in a unit of time.
    assert!(warned(20.0, ["2*(x0 - x1)", "2*(x0 + x1)"]));
    assert!(!warned(1.0, ["2*(x0 - x1)", "2*(x0 + x1)"]));
    assert!(!warned(20.0, ["-x0", "-x1"]));
}

#[test]
fn orders_just_above_whole_numbers_turn_like_their_neighbours() {
    let place = Workplace::new();
    // 200 radians: an error of the memory in D^1.0001 counts a thousandfold less than in D^0.0001.
    let keys = json!({ "order": 1.0001, "right": ["x1", "-x0"], "initial": [[1.0, 0.0], [0.0, -1.0]] });
    let run = place.run(&equation(keys, json!({ "end": 200.0, "tolerance": 1e-6 })), &[]);
    assert!(run.summary["warnings"].is_null(), "{}", run.summary["warnings"]);
}

#[test]
fn growing_perturbations_are_told_with_their_number() {
    let place = Workplace::new();
    let warnings = |right: &str, end: f64| {
        let keys = json!({ "order": 0.5, "right": right, "initial": [1.0] });
        let run = place.run(&equation(keys, json!({ "end": end, "tolerance": 1e-9 })), &[]);
        run.summary["warnings"].to_string()
    };
    // x = 1 + t^1.5, from which others depart like E_½(5 √t), 6e6 at t = 0.6.
    let told = warnings("gamma(2.5)*t + 5*(x0 - 1 - t^1.5)", 0.6);
    assert!(told.contains("grown") && told.contains("e6 times"), "{told}");
    // All are alike in relation to their size where the solution grows itself, and where they decay.
    assert_eq!(warnings("5*x0", 0.6), "null");
    assert_eq!(warnings("gamma(2.5)*t - 5*(x0 - 1 - t^1.5)", 10.0), "null");
    // Where slopes are infinite a perturbation of the start is soon forgotten.
    assert_eq!(warnings("1 + (x0 - 1)^(1/3)", 0.6), "null");
    // D x − 2 D^½ x = f, x = 1 + t³: constants solve it without f, whatever else grows like e^{4t}.
    let terms = json!([{ "order": 1.0, "coefficient": 1.0 }, { "order": 0.5, "coefficient": -2.0 }]);
    let keys = json!({ "terms": terms, "right": "3*t^2 - 12*t^2.5/gamma(3.5)", "initial": 1.0 });
    let run = place.run(&equation(keys, json!({ "end": 10.0, "tolerance": 1e-6 })), &[]);
    assert!(run.summary["warnings"].to_string().contains("grown"), "{}", run.summary["warnings"]);
}

#[test]
fn unknowns_of_low_and_high_orders_begin_together() {
    // Steps of 1e-40 and less: derivatives of the one leave the range of numbers where the other has begun.
    let place = Workplace::new();
    for (orders, right, initial, tolerance) in [
        (json!([3.1, 0.1]), json!(["1 - x0^3", "1 - x1"]), json!([[0.0, 0.0, 0.0, 0.0], 0.0]), 1e-3),
        (json!([2.0, 0.2]), json!(["t^2 - x0^3", "1 - x1"]), json!([[0.0, 0.0], 0.0]), 1e-6),
        (json!([0.1, 3.0]), json!(["1 - x0^2", "1"]), json!([0.0, [0.0, 0.0, 0.0]]), 1e-9),
    ] {
        let keys = json!({ "order": orders, "right": right, "initial": initial });
        let run = place.run(&equation(keys, json!({ "end": 1.0, "tolerance": tolerance })), &[]);
        let steps = run.summary["steps"].as_u64().unwrap();
        assert!(steps < 2000 && run.summary["warnings"].is_null(), "{orders}: {steps} steps");
    }
}

#[test]
fn the_unit_of_time_makes_no_difference_to_an_equation() {
    // D^1.8 x = 10⁴ (1000 cos t − x) to t = 1, in a unit and in its millionth.
    let place = Workplace::new();
    let steps = |unit: f64| {
        let rate = 1e4 * unit.powf(1.8);
        let right = format!("{rate:?}*(1000*cos({unit:?}*t) - x0)");
        let keys = json!({ "order": 1.8, "right": right, "initial": [1000.0, 0.0] });
        let run = place.run(&equation(keys, json!({ "end": 1.0 / unit, "tolerance": 1e-10 })), &[]);
        run.summary["steps"].as_u64().unwrap()
    };
    let (seconds, others) = (steps(1.0), [1e6, 1e-6].map(steps));
    assert!(others.iter().all(|&count| count.abs_diff(seconds) * 10 < seconds), "{seconds} {others:?}");
}

#[test]
fn a_refusal_names_a_tolerance_that_passes_the_step() {
    let keys = json!({ "order": 0.5, "right": "-x0", "initial": 1.0 });
    let time = |tolerance: f64| json!({ "end": 1.0, "tolerance": tolerance, "shortest": 1e-3 });
    let told = message(keys.clone(), time(1e-10));
    let named = told.split("`time.tolerance` = ").nth(1).unwrap().split(' ').next().unwrap();
    assert!(told.contains("would pass this step"), "{told}");
    let tolerance: f64 = named.parse().unwrap();
    assert!((1e-8..1e-2).contains(&tolerance), "{told}");
    let place = Workplace::new();
    place.run(&equation(keys, time(tolerance)), &[]);
}

#[test]
fn roots_of_sizes_are_followed_through_zero() {
    // x = t^1.6 − 1 passes 0 at t = 1, where the slope of √|x| is infinite and that of x √|x| vanishes.
    let place = Workplace::new();
    let power = "gamma(2.6)/gamma(2)*t";
    for side in ["x*abs(x)^0.5", "sqrt(abs(x))", "sign(x)*abs(x)^0.5"] {
        let right = format!("{power} - {} + {}", side.replace('x', "x0"), side.replace('x', "(t^1.6 - 1)"));
        for tolerance in [1e-3, 1e-6, 1e-9] {
            let keys = json!({ "order": 0.6, "right": right, "initial": -1.0 });
            let time = json!({ "end": 2.0, "tolerance": tolerance });
            let run = place.run(&(equation(keys, time) + "[reference]\nposition = [\"t^1.6 - 1\"]\n"), &[]);
            let error = run.summary["errors"]["x"]["largest"].as_f64().unwrap();
            assert!(error < 10.0 * tolerance * 2.04, "{side} to {tolerance:e}: {error:e}");
        }
    }
}

/// A root of what begins at 0 keeps ten digits: smaller tolerances are told so, others and smooth starts are
/// not.
#[test]
fn infinite_slopes_at_the_start_are_told_where_they_limit_the_accuracy() {
    let place = Workplace::new();
    let warned = |right: &str, tolerance: f64| {
        let keys = json!({ "order": 0.5, "right": right, "initial": [0.5] });
        let run = place.run(&equation(keys, json!({ "end": 1.0, "tolerance": tolerance })), &[]);
        run.summary["warnings"].to_string().contains("infinite at the start")
    };
    assert!(warned("1 + (x0 - 0.5)^(1/3)", 1e-12));
    assert!(!warned("1 + (x0 - 0.5)^(1/3)", 1e-6));
    assert!(!warned("1 - (x0 - 0.5)^2", 1e-12));
}

fn equation(keys: Value, time: Value) -> String {
    toml::to_string(&json!({ "equation": keys, "time": time })).unwrap()
}

#[test]
fn files_are_in_the_users_words() {
    let place = Workplace::new();
    let chua = std::fs::read_to_string(folder().join("chua.toml")).unwrap();
    place.write("chua.toml", &chua.replace("end = 100.0", "end = 2.0"));
    let output = place.fvi(&["run", "chua.toml", "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let told = text(&output.stdout);
    assert!(told.contains("x = [") && !told.contains("energy"), "{told}");
    let rows = std::fs::read_to_string(place.path("out/trajectory.csv")).unwrap();
    assert_eq!(rows.lines().next(), Some("t,x0,x1,x2"));
    for picture in ["coordinates.svg", "phase.svg"] {
        assert!(place.path("out").join(picture).exists(), "{picture}");
    }
    assert!(!place.path("out/energy.svg").exists());
    let summary = Run::read(&place.path("out")).summary;
    for name in ["last", "largest"] {
        let keys: Vec<&String> = summary[name].as_object().unwrap().keys().collect();
        assert!(keys.iter().all(|key| ["x", "time"].contains(&key.as_str())), "{keys:?}");
        assert_eq!(summary[name]["x"].as_array().unwrap().len(), 3);
    }
    let scenario = &summary["scenario"];
    assert!(scenario.get("system").is_none() && scenario.get("initial").is_none());
    assert_eq!(scenario["equation"]["order"], json!([0.93, 0.99, 0.92]));
    // Further coordinates of higher orders are not written either.
    let higher =
        equation(json!({ "order": 2.5, "right": "-x0", "initial": [1, 0, 0] }), json!({ "end": 1.0 }));
    let run = place.run(&higher, &[]);
    assert!(
        run.rows.iter().all(|row| row.len() == 2)
            && run.summary["last"]["x"][0] == run.rows.last().unwrap()[1]
    );
    place.write("higher.toml", &higher);
    assert!(place.fvi(&["run", "higher.toml", "--out", "arrays", "--format", "npz"]).status.success());
    assert!(place.path("arrays/trajectory.npz").exists());
}

#[test]
fn events_and_references_are_of_the_unknowns() {
    let place = Workplace::new();
    let keys = json!({ "order": 1.5, "right": "-x0", "initial": [1.0, 0.0] });
    let mut scenario = equation(keys, json!({ "end": 3.0, "tolerance": 1e-9 }));
    scenario += "[[event]]\nwhen = \"x0 - 0.5\"\naction = \"stop\"\n[reference]\nposition = [\"1\"]\n";
    let run = place.run(&scenario, &[]);
    let event = &run.summary["events"][0];
    assert!(
        (event["x"][0].as_f64().unwrap() - 0.5).abs() < 1e-9 && event.get("momentum").is_none(),
        "{event}"
    );
    assert!(run.summary["errors"]["x"]["compared"].as_u64() > Some(3), "{}", run.summary["errors"]);
    assert_eq!(run.summary["last"]["time"], event["time"]);
}

/// The message with which a run of an equation is refused, or fails.
fn message(keys: Value, time: Value) -> String {
    let place = Workplace::new();
    place.write("equation.toml", &equation(keys, time));
    let output = place.fvi(&["run", "equation.toml", "--out", "out"]);
    assert!(!output.status.success());
    text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn a_solution_that_ends_is_told_with_its_time() {
    // x' = x² from 1 ends at t = 1.
    let told = message(json!({ "order": 1, "right": "x0^2", "initial": 1 }), json!({ "end": 5.0 }));
    assert!(told.contains("grows without bound, it ends near t = 0.99999"), "{told}");
    let told = message(json!({ "order": 0.8, "right": "x0^2", "initial": 1 }), json!({ "end": 5.0 }));
    assert!(told.contains("it ends near t = 0.6288"), "{told}");
    // D^½ x = −1/x reaches 0, where its right side ends.
    let told = message(json!({ "order": 0.5, "right": "-1/x0", "initial": 1 }), json!({ "end": 5.0 }));
    assert!(told.contains("failed") && told.contains("t = 0.") && !told.contains("mass"), "{told}");
}

#[test]
fn messages_name_the_keys_of_the_equation() {
    let end = || json!({ "end": 1.0 });
    let told = message(json!({ "order": 1.5, "right": "-x0", "initial": 1 }), end());
    assert!(told.contains("equation.initial") && told.contains("x0'(0)"), "{told}");
    let told = message(json!({ "order": 0.5, "right": ["x1", "log(x0)"], "initial": [-1, 0] }), end());
    assert!(told.contains("equation.right[1]") && told.contains("x = [-1.0, 0.0]"), "{told}");
    // Steps over which the solution grows from 1 to more than 10¹⁰⁰⁰ would give some number.
    let told =
        message(json!({ "order": 0.5, "right": "100*x0", "initial": 1 }), json!({ "end": 1.0, "step": 0.1 }));
    assert!(told.contains("time.step") && told.contains("tolerance"), "{told}");
    let told = message(
        json!({ "order": 0.5, "right": "-x0", "initial": 1 }),
        json!({ "end": 1.0, "tolerance": 1e-15 }),
    );
    assert!(told.contains("time.tolerance"), "{told}");
}

#[test]
fn sides_and_slopes_that_end_at_the_start_are_no_hindrance() {
    // Both begin like 2 √(t/π): |x|^{3/2} is no number on its other side, √x has no slope there.
    for (right, last) in [("1 - abs(x0)^1.5", 0.5), ("1 + sqrt(x0) - 2*x0", 0.5)] {
        let place = Workplace::new();
        let keys = json!({ "order": 0.5, "right": right, "initial": 0 });
        let coarse = place.run(&equation(keys.clone(), json!({ "end": 2.0, "tolerance": 1e-5 })), &[]);
        let fine = place.run(&equation(keys, json!({ "end": 2.0, "tolerance": 1e-10 })), &[]);
        let [coarse, fine] = [coarse, fine].map(|run| run.summary["last"]["x"][0].as_f64().unwrap());
        assert!((coarse - fine).abs() < 1e-4 && fine > last, "{right}: {coarse} {fine}");
    }
}
