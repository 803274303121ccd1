//! Runs that are interrupted and gone on with leave the files of runs that were not.

use fvi_fft::memory::Engine;
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_host::checkpoint::{CheckpointEvery, is_readable};
use fvi_host::results::trajectory::Format;
use fvi_host::run::{RunEnd, RunError, RunOptions, run};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Precision;
use proptest::prelude::*;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// How a run is interrupted after a step.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Interruption {
    /// By a signal: it ends as it should.
    Stop,
    /// As if by SIGKILL: nothing more is written.
    Kill,
}

/// Random scenarios that are tried: more when `FVI_RESUMED_RUNS` says so.
fn cases() -> u32 {
    std::env::var("FVI_RESUMED_RUNS").ok().and_then(|cases| cases.parse().ok()).unwrap_or(12)
}

/// Runs until a step; whether it ended by itself.
fn run_until(
    scenario: &Scenario,
    options: &RunOptions,
    at: Option<(usize, Interruption)>,
) -> Result<bool, RunError> {
    let stop = AtomicBool::new(false);
    let attempt = || {
        run(scenario, options, &stop, &mut |steps| match at {
            Some((step, Interruption::Stop)) if steps >= step => stop.store(true, Ordering::Relaxed),
            Some((step, Interruption::Kill)) if steps >= step => {
                std::panic::resume_unwind(Box::new("killed"))
            }
            _ => {}
        })
    };
    match catch_unwind(AssertUnwindSafe(attempt)) {
        Ok(summary) => Ok(summary?.end == RunEnd::Completed),
        Err(_) => Ok(false),
    }
}

/// The files of results, the summary without seconds.
fn results(directory: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in fs::read_dir(directory).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        let content = fs::read(entry.path()).unwrap();
        if name == "summary.json" {
            let mut summary: Value = serde_json::from_slice(&content).unwrap();
            let summary = summary.as_object_mut().unwrap();
            summary.remove("seconds");
            summary.remove("preparation_seconds");
            files.insert(name, serde_json::to_vec_pretty(summary).unwrap());
        } else if !name.starts_with("checkpoint") {
            files.insert(name, content);
        }
    }
    files
}

#[track_caller]
fn assert_same(found: &Path, expected: &Path) {
    let (found, expected) = (results(found), results(expected));
    assert_eq!(found.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
    for (name, content) in &expected {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        assert!(&found[name] == content, "{name} differs:\n{}\nnot\n{}", text(&found[name]), text(content));
    }
}

/// Scenarios over engines, kernels, schemes, inputs.
fn scenarios() -> impl Strategy<Value = Value> {
    let engine = prop::sample::select(vec![
        "direct",
        "block-fft",
        "real-time",
        "exponential-sum",
        "exponential-sum-core",
        "forgetful",
    ]);
    let kernel = prop::sample::select(vec![
        "bdf-1",
        "bdf-2",
        "bdf-nodes",
        "starting",
        "radau-2",
        "lobatto-3",
        "collocation",
        "graded",
    ]);
    let potential = prop::sample::select(vec!["0.5*q0^2", "2 - 2*cos(q0)", "0.5*q0^2 + 0.25*(q1 - q0)^4"]);
    let rest = (any::<bool>(), any::<bool>(), 1..4usize, 60..300usize, 0.1..1.9f64, any::<bool>());
    (engine, kernel, potential, rest).prop_map(|(engine, kernel, potential, rest)| {
        let (caputo, input, every, steps, order, two_terms) = rest;
        let count = if potential.contains("q1") { 2 } else { 1 };
        let list = |number: f64| vec![number; count];
        let term = |order: f64| {
            let derivative = if caputo { "caputo" } else { "riemann-liouville" };
            json!({ "order": order, "coefficient": list(0.2), "derivative": derivative })
        };
        let damping = if two_terms { vec![term(order), term(0.5)] } else { vec![term(order)] };
        let (convolution, scheme) = match kernel {
            "bdf-2" => (json!({ "family": "bdf", "order": 2 }), json!({ "kind": "low-order" })),
            "bdf-nodes" => (
                json!({ "family": "bdf", "order": 1, "at": "nodes" }),
                json!({ "kind": "galerkin", "degree": 2, "quadrature": "gauss", "points": 2 }),
            ),
            "starting" => (
                json!({ "family": "bdf", "order": 1, "starting": [0.0, 1.0] }),
                json!({ "kind": "low-order" }),
            ),
            "radau-2" => {
                (json!({ "family": "radau-iia", "stages": 2 }), json!({ "kind": "galerkin", "degree": 2 }))
            }
            "lobatto-3" => {
                (json!({ "family": "lobatto-iiic", "stages": 3 }), json!({ "kind": "galerkin", "degree": 2 }))
            }
            "collocation" | "graded" => {
                (json!({ "family": "radau-iia", "stages": 2 }), json!({ "kind": "collocation" }))
            }
            _ => (json!({ "family": "bdf", "order": 1 }), json!({ "kind": "low-order" })),
        };
        let mut scenario = json!({
            "system": { "mass": list(1.0), "potential": potential, "damping": damping },
            "initial": { "position": list(1.0), "momentum": list(0.25) },
            "scheme": scheme,
            "convolution": convolution,
            "time": { "step": 0.02, "steps": steps, "allow_unstable": true },
            "history": match engine {
                "forgetful" => json!({ "engine": "direct", "capacity": 40, "overflow": "forget" }),
                "exponential-sum" | "exponential-sum-core" => json!({ "engine": engine }),
                engine => json!({ "engine": engine }),
            },
            "output": { "every": every },
            "event": [{ "when": "sin(20*q0) - 0.1*t" }, { "when": "q0 - 0.9", "direction": "falling" }],
        });
        if kernel == "graded" {
            scenario["time"] = json!({ "grid": "graded", "exponent": 2.0, "end": 4.0, "steps": steps });
            scenario["history"] = json!({ "engine": "any-step" });
            if two_terms {
                scenario["output"] = json!({ "times": [0.0, 0.3, 0.31, 1.7, 2.0, 4.0] });
            }
        }
        if input {
            let samples: Vec<Vec<f64>> = (0..20).map(|index| list(0.1 * f64::from(index % 7))).collect();
            scenario["input"] = json!({ "samples": samples, "period": 0.13 });
        } else if count == 1 {
            scenario["reference"] = json!({ "position": ["cos(t)"] });
        }
        scenario
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(cases()))]

    #[test]
    fn an_interrupted_run_leaves_the_files_of_one_that_was_not(
        scenario in scenarios(),
        single in any::<bool>(),
        npz in any::<bool>(),
        every in 1..40usize,
        extended in any::<bool>(),
        interruptions in prop::collection::vec(
            (0.0..1.0f64, prop::sample::select(vec![Interruption::Stop, Interruption::Kill])), 1..4),
    ) {
        let scenario = Scenario::from_value(&scenario).unwrap();
        let place = tempfile::tempdir().unwrap();
        let options = |name: &str| RunOptions {
            precision: if single { Precision::F32 } else { Precision::F64 },
            format: Some(if npz { Format::Npz } else { Format::Csv }),
            checkpoints: CheckpointEvery::Steps(every),
            resume: true,
            ..RunOptions::new(place.path().join(name))
        };
        prop_assert!(run_until(&scenario, &options("undisturbed"), None).unwrap());
        let steps = scenario.time.steps;
        for &(share, kind) in &interruptions {
            let step = 1 + (share * steps as f64) as usize;
            run_until(&scenario, &options("interrupted"), Some((step, kind))).unwrap();
        }
        // Block transforms, and matrix weights, are planned for the length of a run: of those the last bits
        // may differ.
        let planned = [Some(Engine::BlockFft), Some(Engine::RealTime)].contains(&scenario.history.engine)
            || !matches!(scenario.convolution.family, ConvolutionFamily::Bdf { .. });
        if extended && !planned {
            // One that ended early is carried further.
            let short = scenario.ending_after(steps / 2).unwrap();
            let options = options("carried");
            prop_assert!(run_until(&short, &options, None).unwrap());
            prop_assert!(run_until(&scenario, &options, None).unwrap());
            let mut expected = results(&place.path().join("undisturbed"));
            let found = results(&options.directory);
            // How far tables were made for may show in the bytes that memories take.
            expected.remove("summary.json");
            for (name, content) in &expected {
                prop_assert!(&found[name] == content, "{name} of the run that was carried further differs");
            }
        }
        prop_assert!(run_until(&scenario, &options("interrupted"), None).unwrap());
        assert_same(&place.path().join("interrupted"), &place.path().join("undisturbed"));
    }
}

fn oscillator(changes: &[(&str, Value)]) -> Scenario {
    let mut value = json!({
        "system": {
            "mass": [1.0],
            "potential": "1 - cos(q0)",
            "damping": [{ "order": 0.5, "coefficient": [0.1] }],
        },
        "initial": { "position": [1.0], "momentum": [0.0] },
        "time": { "step": 0.05, "steps": 100 },
        "history": { "engine": "direct" },
    });
    for (pointer, change) in changes {
        *value.pointer_mut(pointer).unwrap() = change.clone();
    }
    Scenario::from_value(&value).unwrap()
}

fn every_ten(directory: &Path) -> RunOptions {
    RunOptions { checkpoints: CheckpointEvery::Steps(10), resume: true, ..RunOptions::new(directory) }
}

#[test]
fn derivatives_of_an_interrupted_run_go_on_to_the_same_bits() {
    let base = json!({
        "system": {
            "mass": [1.0, 2.0],
            "potential": "k*q0^2 + (q1 - q0)^4",
            "parameters": { "k": 1.0 },
            "damping": [
                { "order": 0.6, "coefficient": [0.3, 0.1] },
                { "kernel": { "form": "maxwell", "order": 0.8, "time": 0.7 }, "coefficient": [0.0, 0.2] },
            ],
        },
        "initial": { "position": [1.0, 0.2], "velocity": [0.0, 0.3] },
        "time": { "step": 0.05, "steps": 150 },
    });
    let common =
        ["system.parameters.k", "system.mass[1]", "system.damping[0].coefficient[0]", "initial.velocity[1]"];
    let kernels = ["system.damping[0].order", "system.damping[1].kernel.time"];
    let nodes = json!({ "family": "bdf", "order": 2, "at": "nodes" });
    let cases = [
        (json!({ "kind": "low-order" }), nodes.clone(), json!({ "engine": "direct" })),
        (json!({ "kind": "low-order" }), nodes.clone(), json!({ "engine": "block-fft" })),
        (
            json!({ "kind": "low-order" }),
            json!({ "at": "main-nodes", "order": 1 }),
            json!({ "engine": "real-time" }),
        ),
        (json!({ "kind": "low-order" }), nodes.clone(), json!({ "engine": "exponential-sum" })),
        (json!({ "kind": "galerkin", "degree": 2 }), nodes, json!({})),
        (json!({ "kind": "collocation" }), json!({ "family": "radau-iia", "stages": 2 }), json!({})),
    ];
    let place = tempfile::tempdir().unwrap();
    for (index, (scheme, convolution, history)) in cases.into_iter().enumerate() {
        let mut value = base.clone();
        (value["scheme"], value["convolution"], value["history"]) = (scheme, convolution, history);
        let all = [&common[..], &kernels[..]].concat();
        value["sensitivity"] = json!({ "parameters": all });
        let scenario = Scenario::from_value(&value).unwrap();
        let options = |name: &str| RunOptions {
            checkpoints: CheckpointEvery::Steps(20),
            resume: true,
            ..RunOptions::new(place.path().join(format!("{name}-{index}")))
        };
        let (undisturbed, interrupted) = (options("undisturbed"), options("interrupted"));
        assert!(run_until(&scenario, &undisturbed, None).unwrap());
        for at in [(33, Interruption::Kill), (34, Interruption::Stop), (101, Interruption::Kill)] {
            assert!(!run_until(&scenario, &interrupted, Some(at)).unwrap());
        }
        // Derivatives by other numbers are another run.
        let mut other = value.clone();
        other["sensitivity"] = json!({ "parameters": common[1..] });
        let error =
            run_until(&Scenario::from_value(&other).unwrap(), &interrupted, None).unwrap_err().to_string();
        assert!(error.contains("sensitivity.parameters"), "{error}");
        assert!(run_until(&scenario, &interrupted, None).unwrap());
        assert_same(&interrupted.directory, &undisturbed.directory);
    }
}

#[test]
fn a_damaged_generation_is_passed_over_and_two_are_refused() {
    let place = tempfile::tempdir().unwrap();
    let scenario = oscillator(&[]);
    let undisturbed = place.path().join("undisturbed");
    run_until(&scenario, &RunOptions::new(&undisturbed), None).unwrap();
    let damages: [fn(&mut Vec<u8>, usize); 3] = [
        |bytes, place| bytes[place] ^= 0x10,
        |bytes, place| bytes.truncate(place),
        |bytes, place| bytes.insert(place, 0),
    ];
    let newest = ["checkpoint.fvi", "checkpoint.pictures.fvi", "trajectory.csv.part"];
    for (index, (name, damage)) in
        newest.iter().flat_map(|name| damages.map(|damage| (*name, damage))).enumerate()
    {
        let directory = place.path().join(index.to_string());
        let options = every_ten(&directory);
        run_until(&scenario, &options, Some((57, Interruption::Kill))).unwrap();
        let path = directory.join(name);
        let mut bytes = fs::read(&path).unwrap();
        // Of the trajectory, a row that belongs to the newest checkpoint only.
        let place =
            if name == "trajectory.csv.part" { bytes.len() - 40 } else { bytes.len() * (index + 1) / 10 };
        damage(&mut bytes, place);
        fs::write(&path, &bytes).unwrap();
        assert!(run_until(&scenario, &options, None).unwrap());
        assert_same(&directory, &undisturbed);

        // Both damaged: refused, and nothing is touched.
        run_until(&scenario, &options, Some((57, Interruption::Kill))).unwrap();
        for name in ["checkpoint.fvi", "checkpoint.previous.fvi"] {
            let mut bytes = fs::read(directory.join(name)).unwrap();
            damage(&mut bytes, 30);
            fs::write(directory.join(name), &bytes).unwrap();
        }
        let before = results(&directory);
        let error = run_until(&scenario, &options, None).unwrap_err().to_string();
        assert!(
            error.contains("checkpoint.fvi is damaged")
                && error.contains("checkpoint.previous.fvi is damaged"),
            "{error}"
        );
        assert!(results(&directory) == before);
    }
}

#[test]
fn every_flipped_byte_and_every_truncation_of_a_checkpoint_is_noticed() {
    let place = tempfile::tempdir().unwrap();
    run_until(&oscillator(&[]), &every_ten(place.path()), Some((57, Interruption::Kill))).unwrap();
    let read = |name: &str| fs::read(place.path().join(name)).unwrap();
    let (state, pictures) = (read("checkpoint.fvi"), read("checkpoint.pictures.fvi"));
    assert!(is_readable(&state, &pictures));
    for (bytes, of_state) in [(&state, true), (&pictures, false)] {
        let readable =
            |bytes: &[u8]| if of_state { is_readable(bytes, &pictures) } else { is_readable(&state, bytes) };
        let mut changed = bytes.clone();
        for index in 0..bytes.len() {
            changed[index] ^= 1 << (index % 8);
            assert!(!readable(&changed), "byte {index}");
            changed[index] = bytes[index];
            assert!(!readable(&bytes[..index]), "cut to {index} bytes");
        }
    }
}

#[test]
fn rows_that_do_not_go_with_those_that_are_there_are_refused() {
    let base = json!({
        "system": {
            "mass": [1.0, 1.0],
            "stiffness": [1.0, 2.0],
            "damping": [{ "order": 0.5, "coefficient": [0.1, 0.1] }],
        },
        "initial": { "position": [1.0, 0.5], "momentum": [0.0, 0.0] },
        "convolution": { "at": "main-nodes" },
        "time": { "step": 0.05, "steps": 100 },
    });
    let with = |output: Value| {
        let mut scenario = base.clone();
        scenario["output"] = output;
        Scenario::from_value(&scenario).unwrap()
    };
    let times = json!({ "times": [0.51, 0.77, 3.3, 4.4] });
    for (there, here, said) in [
        (
            json!({}),
            json!({ "coordinates": [1, 0] }),
            "`output.coordinates[0]` is 1 here and was absent there",
        ),
        (
            json!({ "coordinates": [0] }),
            json!({ "coordinates": [1] }),
            "`output.coordinates[0]` is 1 here and was 0",
        ),
        (
            json!({}),
            json!({ "momentum": "one-sided" }),
            "`output.momentum` is \"one-sided\" here and was \"mean\"",
        ),
        (times.clone(), json!({ "times": [0.51, 0.78, 3.3] }), "`output.times` has 0.78 here"),
        (json!({}), json!({ "snapshots": 5 }), "`output.snapshots` is 5 here and was absent there"),
        (json!({}), times.clone(), "`output.times` has 0.51 here"),
    ] {
        let place = tempfile::tempdir().unwrap();
        let options = every_ten(place.path());
        run_until(&with(there), &options, Some((57, Interruption::Kill))).unwrap();
        let before = results(place.path());
        let error = run_until(&with(here), &options, None).unwrap_err();
        assert!(matches!(error, RunError::Checkpoint(_)) && error.to_string().contains(said), "{error}");
        assert!(results(place.path()) == before);
    }
    // Rows that are still to come may be others.
    let place = tempfile::tempdir().unwrap();
    let (options, undisturbed) = (every_ten(&place.path().join("parts")), place.path().join("undisturbed"));
    run_until(&with(json!({ "times": [0.51, 0.77, 3.3] })), &options, Some((57, Interruption::Kill)))
        .unwrap();
    assert!(run_until(&with(times.clone()), &options, None).unwrap());
    run_until(&with(times), &RunOptions::new(&undisturbed), None).unwrap();
    assert_same(&options.directory, &undisturbed);
}

#[test]
fn another_run_is_refused_with_what_differs() {
    let place = tempfile::tempdir().unwrap();
    let options = every_ten(place.path());
    run_until(&oscillator(&[]), &options, Some((57, Interruption::Kill))).unwrap();
    let before = results(place.path());
    for (pointer, change, said) in [
        ("/initial/position", json!([1.25]), "`initial.position[0]` is 1.25 here and was 1.0 there"),
        ("/time/step", json!(0.04), "`time.step` is 0.04 here and was 0.05 there"),
        (
            "/history/engine",
            json!("block-fft"),
            "`history.engine` is \"block-fft\" here and was \"direct\" there",
        ),
    ] {
        let error = run_until(&oscillator(&[(pointer, change)]), &options, None).unwrap_err();
        assert!(matches!(error, RunError::Checkpoint(_)), "{error}");
        assert!(error.to_string().contains(said), "{error}");
    }
    let single = RunOptions { precision: Precision::F32, ..options.clone() };
    let error = run_until(&oscillator(&[]), &single, None).unwrap_err().to_string();
    assert!(error.contains("`precision`"), "{error}");
    let npz = RunOptions { format: Some(Format::Npz), ..options.clone() };
    let error = run_until(&oscillator(&[]), &npz, None).unwrap_err().to_string();
    assert!(error.contains("trajectory.npz"), "{error}");
    let error =
        run_until(&oscillator(&[]).ending_after(20).unwrap(), &options, None).unwrap_err().to_string();
    assert!(error.contains("step 50") && error.contains("step 20"), "{error}");
    assert!(results(place.path()) == before);
}

#[test]
fn a_memory_is_not_carried_beyond_its_table() {
    let place = tempfile::tempdir().unwrap();
    let scenario = oscillator(&[("/history", json!({ "engine": "exponential-sum" }))]);
    let options = every_ten(place.path());
    run_until(&scenario, &options, None).unwrap();
    let error = run_until(&scenario.ending_after(1 << 40).unwrap(), &options, None).unwrap_err().to_string();
    assert!(error.contains("history.horizon"), "{error}");
    assert!(run_until(&scenario.ending_after(200).unwrap(), &options, None).unwrap());
}

/// Checkpoints stay where someone asked for them, or where there is something to go on from.
#[test]
fn a_short_run_leaves_no_checkpoint_unless_asked_to() {
    let place = tempfile::tempdir().unwrap();
    let scenario = oscillator(&[]);
    let kept = |name: &str, options: &dyn Fn(RunOptions) -> RunOptions, at| {
        let directory = place.path().join(name);
        run_until(&scenario, &options(RunOptions::new(&directory)), at).unwrap();
        ["checkpoint.fvi", "checkpoint.pictures.fvi"].map(|name| directory.join(name).exists())
    };
    let as_it_is = |options: RunOptions| options;
    assert_eq!(kept("short", &as_it_is, None), [false; 2]);
    assert_eq!(kept("stopped", &as_it_is, Some((57, Interruption::Stop))), [true; 2]);
    assert_eq!(kept("stopped", &|options| RunOptions { resume: true, ..options }, None), [true; 2]);
    assert_same(&place.path().join("stopped"), &place.path().join("short"));
    let hourly = CheckpointEvery::Time(std::time::Duration::from_secs(3600));
    assert_eq!(kept("asked", &|options| RunOptions { checkpoints: hourly, ..options }, None), [true; 2]);
    assert_same(&place.path().join("asked"), &place.path().join("short"));
    // Carried further it begins at its start, and has the rows of one that went on.
    let further = scenario.ending_after(400).unwrap();
    for name in ["short", "asked"] {
        let options = RunOptions { resume: true, ..RunOptions::new(place.path().join(name)) };
        assert!(run_until(&further, &options, None).unwrap());
    }
    assert_same(&place.path().join("asked"), &place.path().join("short"));
}

#[test]
fn a_run_begins_anew_where_it_is_not_told_to_go_on() {
    let place = tempfile::tempdir().unwrap();
    let options = every_ten(place.path());
    run_until(&oscillator(&[]), &options, Some((57, Interruption::Kill))).unwrap();
    let anew = RunOptions { resume: false, checkpoints: CheckpointEvery::Never, ..options };
    assert!(run_until(&oscillator(&[("/initial/position", json!([0.5]))]), &anew, None).unwrap());
    let mut names: Vec<_> = fs::read_dir(place.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, ["coordinates.svg", "energy.svg", "phase.svg", "summary.json", "trajectory.csv"]);
}
