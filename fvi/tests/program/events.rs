//! Events as a user watches for them: times, directions, stops, runs that go on, and what is refused.

use crate::workplace::{Workplace, text};
use std::f64::consts::PI;

/// q̈ + q = 0 from q = 1: cos t.
fn oscillator(scheme: &str, time: &str, events: &str) -> String {
    format!(
        "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[initial]\nposition = [1.0]\nvelocity = [0.0]\n\
         {scheme}\n[time]\n{time}\n{events}\n"
    )
}

const COLLOCATION: &str = "[scheme]\nkind = \"collocation\"";
const GAUSS: &str = "[scheme]\nkind = \"galerkin\"\ndegree = 3";

#[test]
fn events_are_found_on_every_grid() {
    let both = "[[event]]\nwhen = \"q0\"\n[[event]]\nwhen = \"q0 - 0.5\"\ndirection = \"rising\"";
    let grids = [
        (COLLOCATION, "step = 0.05\nsteps = 200", 1e-8),
        (GAUSS, "step = 0.05\nsteps = 200", 1e-5),
        (COLLOCATION, "grid = \"graded\"\nend = 10.0\nsteps = 200\nexponent = 2.0", 1e-6),
        (COLLOCATION, "grid = \"adaptive\"\nend = 10.0\ntolerance = 1e-9", 1e-8),
    ];
    for (scheme, time, near) in grids {
        let run = Workplace::new().run(&oscillator(scheme, time, both), &[]);
        let events = run.summary["events"].as_array().unwrap();
        let expected = [(0, 0.5 * PI), (0, 1.5 * PI), (1, 5.0 * PI / 3.0), (0, 2.5 * PI)];
        assert_eq!(events.len(), expected.len(), "{time}: {events:?}");
        for (found, (event, exact)) in events.iter().zip(expected) {
            assert_eq!(found["event"], event);
            let error = found["time"].as_f64().unwrap() - exact;
            assert!(error.abs() < near, "{time}: {error:e}");
            let level = if event == 0 { 0.0 } else { 0.5 };
            // To the rounding of the polynomial.
            assert!((found["position"][0].as_f64().unwrap() - level).abs() < 1e-14, "{time}: {found}");
        }
        assert_eq!(run.summary["status"], "completed");
    }
}

/// Where steps meet, and where several events lie in one step, each is there once: q falls from 1 to −1
/// through known places.
#[test]
fn none_is_twice_there_and_none_is_lost() {
    let radau =
        |stages: usize| format!("{COLLOCATION}\n[convolution]\nfamily = \"radau-iia\"\nstages = {stages}");
    let explicit = "[scheme]\nkind = \"explicit-euler\"".to_owned();
    for scheme in [radau(1), radau(2), radau(3), GAUSS.to_owned(), String::new(), explicit] {
        let run = Workplace::new()
            .run(&oscillator(&scheme, "step = 0.05\nsteps = 60", "[[event]]\nwhen = \"sin(40*q0)\""), &[]);
        let last = run.rows.last().unwrap()[1];
        let expected = (1..).map(|k| (13 - k) as f64 * PI / 40.0).take_while(|&place| place > last);
        let places: Vec<f64> = run.summary["events"]
            .as_array()
            .unwrap()
            .iter()
            .map(|event| event["position"][0].as_f64().unwrap())
            .collect();
        let expected: Vec<f64> = expected.collect();
        assert_eq!(places.len(), expected.len(), "{scheme}: {places:?}");
        for (place, expected) in places.iter().zip(expected) {
            assert!((place - expected).abs() < 1e-14, "{scheme}: {place} {expected}");
        }
    }
}

#[test]
fn an_event_at_a_grid_point_is_counted_once_at_its_time() {
    for (scheme, step) in [(COLLOCATION, 0.25), ("", 0.25), (COLLOCATION, 0.4)] {
        // q = t − 1, q = 0 at the fourth grid point, and inside the third step.
        let scenario = format!(
            "[system]\nmass = [1.0]\n[initial]\nposition = [-1.0]\nvelocity = [1.0]\n{scheme}\n\
             [time]\nstep = {step}\nsteps = 8\n[[event]]\nwhen = \"q0\"\n[[event]]\nwhen = \"q0\"\ndirection = \"falling\"\n"
        );
        let run = Workplace::new().run(&scenario, &[]);
        let events = run.summary["events"].as_array().unwrap();
        assert_eq!(events.len(), 1, "{events:?}");
        assert!((events[0]["time"].as_f64().unwrap() - 1.0).abs() < 1e-15, "{events:?}");
        assert_eq!(events[0]["rising"], true);
        // Where it begins with zero nothing passes.
        let begins = scenario.replace("position = [-1.0]", "position = [0.0]");
        assert!(Workplace::new().run(&begins, &[]).summary.get("events").is_none());
    }
}

#[test]
fn a_stop_ends_the_run_with_the_state_there() {
    let stop = "[[event]]\nwhen = \"q0 + 0.9\"\ndirection = \"falling\"\naction = \"stop\"\n[[event]]\nwhen = \"q0\"";
    for (scheme, time, output, near) in [
        (COLLOCATION, "step = 0.5\nsteps = 20", "", 1e-3),
        (COLLOCATION, "step = 0.5\nsteps = 20", "[output]\nevery = 100", 1e-3),
        (COLLOCATION, "step = 0.5\nsteps = 20", "[output]\ntimes = [0.3, 2.6, 2.8]", 1e-3),
        (COLLOCATION, "grid = \"adaptive\"\nend = 40.0\ntolerance = 1e-8", "", 1e-7),
        ("", "step = 0.01\nsteps = 4000", "", 1e-4),
    ] {
        let run = Workplace::new().run(&oscillator(scheme, time, &format!("{output}\n{stop}")), &[]);
        assert_eq!(run.summary["status"], "event");
        assert_eq!(run.summary["event"], 0);
        let (end, last) = (run.summary["time"].as_f64().unwrap(), run.rows.last().unwrap());
        // Numbers of JSON are read to the last place but one here.
        assert!((end - last[0]).abs() <= f64::EPSILON * end);
        assert!(run.rows.windows(2).all(|rows| rows[0][0] < rows[1][0]), "{time}");
        assert!((end - (-0.9_f64).acos()).abs() < near, "{time}: {end}");
        assert!((last[1] + 0.9).abs() < 1e-14, "{time}: {last:?}");
        // The zero of q before it, none after.
        let events = run.summary["events"].as_array().unwrap();
        assert_eq!((events.len(), &events[0]["event"]), (2, &1.into()));
        assert_eq!(run.summary["last"]["time"], run.summary["time"]);
    }
    // A turning point, in steps of about a third of the period.
    let turn = "[[event]]\nwhen = \"p0\"\ndirection = \"rising\"\naction = \"stop\"";
    let run = Workplace::new().run(&oscillator(COLLOCATION, "step = 2.0\nsteps = 20", turn), &[]);
    let last = run.rows.last().unwrap();
    assert!((last[0] - PI).abs() < 0.3 && last[2].abs() < 1e-14, "{last:?}");
}

/// The stop is known in the step behind the grid point only; the row of the grid point is there once.
#[test]
fn a_stop_at_a_grid_point_has_one_row() {
    let stop = "[[event]]\nwhen = \"q0\"\naction = \"stop\"\n";
    let rows = [
        ("", [0.0, 0.25, 0.5, 0.75, 1.0].as_slice()),
        ("[output]\nevery = 3", &[0.0, 0.75, 1.0]),
        ("[output]\ntimes = [0.5, 1.0, 1.1]", &[0.5, 1.0]),
        ("[output]\ntimes = [0.6, 1.1]", &[0.6, 1.0]),
    ];
    for scheme in [COLLOCATION, GAUSS, ""] {
        for (output, times) in rows {
            // q = t − 1.
            let scenario = format!(
                "[system]\nmass = [1.0]\n[initial]\nposition = [-1.0]\nvelocity = [1.0]\n{scheme}\n\
                 [time]\nstep = 0.25\nsteps = 8\n{output}\n{stop}"
            );
            let run = Workplace::new().run(&scenario, &[]);
            assert_eq!(run.rows.iter().map(|row| row[0]).collect::<Vec<_>>(), times, "{scheme}{output}");
            assert_eq!((&run.summary["status"], &run.summary["time"]), (&"event".into(), &1.0.into()));
            let last = run.rows.last().unwrap();
            assert!(last[1].abs() < 1e-15 && (last[2] - 1.0).abs() < 1e-15, "{last:?}");
        }
    }
    // A zero that is a rounding beyond the grid point: its rows are not neighbours to the last digit.
    let thirds = "[system]\nmass = [1.0]\n[initial]\nposition = [-1.0]\nvelocity = [3.0]\n[time]\nstep = 0.1111111111111111\n\
                  steps = 9\n";
    let run = Workplace::new().run(&format!("{thirds}{stop}"), &[]);
    assert_eq!(run.rows.len(), 4, "{:?}", run.rows);
}

#[test]
fn a_time_can_end_a_run() {
    let stop = "[[event]]\nwhen = \"t - 5\"\naction = \"stop\"\n";
    for (scheme, time) in [
        (COLLOCATION, "grid = \"adaptive\"\nend = 40.0\ntolerance = 1e-6"),
        (COLLOCATION, "step = 0.3\nsteps = 40"),
        ("", "step = 0.1\nsteps = 400"),
    ] {
        let run = Workplace::new().run(&oscillator(scheme, time, stop), &[]);
        assert_eq!((&run.summary["status"], &run.summary["time"]), (&"event".into(), &5.0.into()), "{time}");
        assert_eq!(run.rows.last().unwrap()[0], 5.0);
    }
}

#[test]
fn a_run_that_is_interrupted_has_the_same_events() {
    // The last function is not a number from the first zero of q on: that is told.
    let events = "[[event]]\nwhen = \"q0\"\n[[event]]\nwhen = \"sqrt(q0) - 0.5\"\n";
    let summary = |place: &Workplace, directory: &str| -> [serde_json::Value; 3] {
        let text = std::fs::read_to_string(place.path(directory).join("summary.json")).unwrap();
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
        ["events", "warnings", "last"].map(|key| summary[key].clone())
    };
    for scheme in [COLLOCATION, ""] {
        let place = Workplace::new();
        place.write("long.toml", &oscillator(scheme, "step = 0.1\nsteps = 400", events));
        assert!(place.fvi(&["run", "long.toml", "--out", "whole"]).status.success());
        for steps in ["16", "155", "233"] {
            let output = place.fvi(&["run", "long.toml", "--out", "parts", "--steps", steps, "--resume"]);
            assert!(output.status.success(), "{}", text(&output.stderr));
        }
        assert!(place.fvi(&["run", "long.toml", "--out", "parts", "--resume"]).status.success());
        let whole = summary(&place, "whole");
        assert_eq!(whole, summary(&place, "parts"));
        let of_q = whole[0].as_array().unwrap().iter().filter(|event| event["event"] == 0).count();
        assert_eq!(of_q, 13);
        assert!(
            whole[1][0].as_str().unwrap().contains("`event[1].when` is not a number at t = 1.5"),
            "{}",
            whole[1]
        );
    }
}

#[test]
fn a_run_that_an_event_ends_is_a_success_of_a_sweep() {
    let place = Workplace::new();
    let stop = "[[event]]\nwhen = \"q0 + 0.9\"\naction = \"stop\"";
    place.write("base.toml", &oscillator(COLLOCATION, "step = 0.1\nsteps = 100", stop));
    let sweep = "scenario = \"base.toml\"\n[axes]\n\"initial.position[0]\" = [1.0, 2.0]\n[keep]\nquantities = [\"last\"]\n";
    place.write("sweep.toml", sweep);
    let output = place.fvi(&["sweep", "sweep.toml", "--out", "swept"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let table = std::fs::read_to_string(place.path("swept/results.csv")).unwrap();
    for row in table.lines().skip(1) {
        let cells: Vec<&str> = row.split(',').collect();
        assert_eq!(cells[2], "completed", "{table}");
        assert!((cells[5].parse::<f64>().unwrap() + 0.9).abs() < 1e-14, "{table}");
    }
    assert_eq!(table.lines().count(), 3);
}

#[test]
fn events_that_make_no_sense_are_refused() {
    let mistakes = [
        (COLLOCATION, "[[event]]\nwhen = \"q1\"", "event[0].when"),
        (COLLOCATION, "[[event]]\nwhen = \"pi - 1\"", "a function of t, positions or momenta"),
        (COLLOCATION, "[[event]]\nwhen = \"q0\"\ndirection = \"up\"", "\"rising\", \"falling\", \"both\""),
        (COLLOCATION, "[[event]]\nwhen = \"q0\"\naction = \"print\"", "\"record\", \"stop\""),
        (COLLOCATION, "[[event]]\ndirection = \"both\"", "when"),
        ("", "[[event]]\nwhen = \"q0 + p0\"", "`scheme.kind` = \"collocation\""),
        (GAUSS, "[[event]]\nwhen = \"p0\"", "`scheme.kind` = \"collocation\""),
        ("", "[[event]]\nwhen = \"q0\"\nname = \"a\"", "name"),
        ("", "[event]\nwhen = \"q0\"", "[[event]]"),
    ];
    for (scheme, events, told) in mistakes {
        let place = Workplace::new();
        place.write("bad.toml", &oscillator(scheme, "step = 0.1\nsteps = 10", events));
        let output = place.fvi(&["run", "bad.toml"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{events}: {message}");
        assert!(message.contains(told), "{events}: {message}");
    }
    let place = Workplace::new();
    let stop = "[[event]]\nwhen = \"q0\"\naction = \"stop\"";
    place.write("stop.toml", &oscillator(COLLOCATION, "step = 0.1\nsteps = 32", stop));
    let output = place.fvi(&["converge", "stop.toml", "--levels", "3..4"]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    // Load cases would have an end each.
    let cases = "[system]\nmass = [1.0]\n[time]\nstep = 0.1\nsteps = 10\n[[case]]\nname = \"a\"\n[[case.load]]\n\
                 pattern = { coordinate = 0, value = 1.0 }\namplitude = \"sin(t)\"\n[[event]]\nwhen = \"q0\"\n";
    place.write("cases.toml", cases);
    let output = place.fvi(&["run", "cases.toml"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("event") && message.contains("[[case]]"), "{message}");
}
