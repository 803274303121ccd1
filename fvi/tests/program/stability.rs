//! Steps that are too long: refused before the run, or caught in it.

use crate::workplace::{Workplace, text};

fn scenario(potential: &str, damping: &str, position: &str, scheme: &str, time: &str) -> String {
    let zeros = position.split(',').map(|_| "0.0").collect::<Vec<_>>().join(", ");
    let ones = zeros.replace("0.0", "1.0");
    format!(
        "[system]\nmass = [{ones}]\npotential = \"{potential}\"\n{damping}\n[initial]\nposition = [{position}]\n\
         momentum = [{zeros}]\n[scheme]\nkind = \"low-order\"\n{scheme}\n[time]\n{time}\n"
    )
}

#[test]
fn growth_below_the_alternating_motion_is_refused() {
    let place = Workplace::new();
    let damping = |order: f64, rho: &str| {
        format!("[[system.damping]]\norder = {order}\ncoefficient = [{rho}]\nderivative = \"caputo\"")
    };
    let fifth = "kappa = 0.5\n[convolution]\norder = 5\nat = \"main-nodes\"";
    let two = "0.5*q0^2+0.5*q1^2+5000*(q1-q0)^2";
    for (name, text_of) in [
        (
            "two.toml",
            scenario(two, &damping(1.9, "0.01, 0.01"), "1.0, 1.0000001", fifth, "step = 0.02\nsteps = 2000"),
        ),
        ("one.toml", scenario("2*q0^2", &damping(1.5, "0.05"), "0.5", fifth, "step = 1.0\nsteps = 2000")),
    ] {
        place.write(name, &text_of);
        let output = place.fvi(&["run", name, "--out", "out"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains("unstable: the largest stable step is about"), "{message}");
        assert!(message.contains("a lower `convolution.order`"), "{message}");
        // The formula of order 2 has no such limit.
        place.write(name, &text_of.replace("order = 5", "order = 2"));
        let output = place.fvi(&["run", name, "--out", "out"]);
        assert!(output.status.success(), "{}", text(&output.stderr));
    }
}

#[test]
fn without_a_stable_step_none_is_named() {
    let place = Workplace::new();
    let damping = "[[system.damping]]\norder = 1.99\ncoefficient = [3.0]";
    let papers = "kappa = 0.5\n[convolution]\norder = 1\nat = \"main-nodes\"";
    place.write("scenario.toml", &scenario("0.5*q0^2", damping, "1.0", papers, "step = 0.1\nsteps = 10"));
    let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("motions grow at every shorter step too"), "{message}");
    assert!(!message.contains("a shorter `time.step`"), "{message}");
}

#[test]
fn a_run_whose_energy_grows_by_itself_stops_or_warns() {
    let place = Workplace::new();
    let pendulum = |key: &str| {
        scenario("1000*(1-cos(q0))", "", "3.0", "kappa = 0.0", &format!("step = 0.1\nsteps = 5000\n{key}"))
    };
    place.write("scenario.toml", &pendulum(""));
    let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(
        message.contains("the energy has risen from 1.990e3") && message.contains("time.energy_guard"),
        "{message}"
    );
    place.write("scenario.toml", &pendulum("energy_guard = \"warn\""));
    let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
    assert!(output.status.success() && text(&output.stderr).contains("warning: the energy has risen"));
    let summary = std::fs::read_to_string(place.path("out/summary.json")).unwrap();
    assert!(summary.contains("\"warnings\"") && summary.contains("the energy has risen"));
    let run = place.run(&pendulum("energy_guard = \"off\""), &[]);
    assert!(run.summary.get("warnings").is_none() && run.summary["steps"] == 5000);
}
