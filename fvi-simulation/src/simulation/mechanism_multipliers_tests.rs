//! Multipliers of a mechanism's constraints: at the start, between grid points, and under a held force.

use super::Precision;
use super::motion::Motion;
use fvi_scenario::scenario::Scenario;
use serde_json::{Value, json};

/// A mass of 1 on a rod of length 1, looked into between grid points.
fn rod(damping: Value, initial: Value, steps: usize) -> Scenario {
    Scenario::from_value(&json!({
        "system": { "mass": [1.0, 1.0], "potential": "9.81*q1", "constraints": ["q0^2 + q1^2 - 1"], "damping": damping },
        "initial": initial,
        "scheme": { "kind": "galerkin", "degree": 3 },
        "time": { "step": 0.8 / steps as f64, "steps": steps },
        "output": { "times": [0.1] },
    }))
    .unwrap()
}

fn moving() -> Value {
    json!({ "position": [0.6, -0.8], "velocity": [0.8, 0.6] })
}

/// λ with 2 q·(F − 2λq) = −2|v|² under a force F.
fn of_rod(force: [f64; 2], q: &[f64], v: &[f64]) -> f64 {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    (product(&force, q) + product(v, v)) / (2.0 * product(q, q))
}

#[test]
fn multipliers_inside_a_step_are_those_of_the_state_there() {
    let scenario = rod(json!([]), moving(), 20);
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    while !motion.is_done() {
        let begin = motion.state().time;
        motion.advance().unwrap();
        for fraction in [0.1, 0.5, 0.9] {
            let mut state = motion.state().clone();
            motion.interpolate(begin + fraction * 0.04, &mut state);
            let expected = of_rod([0.0, -9.81], &state.position, &state.momentum);
            assert!((state.columns[0] - expected).abs() < 1e-12, "{state:?} {expected}");
        }
    }
    // A damper along a length: the middles of steps are grid points of a run with half the step.
    let kernel = json!({ "form": "prony", "strengths": [1.5, 0.6], "times": [0.2, 1.0] });
    let damper = json!([{ "kernel": kernel, "coefficient": 1.0, "along": "hypot(q0 - 0.3, q1)" }]);
    let (coarse, fine) = (rod(damper.clone(), moving(), 40), rod(damper, moving(), 80));
    let mut motions = [&coarse, &fine].map(|scenario| Motion::start(scenario, Precision::F64).unwrap());
    for _ in 0..40 {
        motions[0].advance().unwrap();
        motions[1].advance().unwrap();
        let expected = motions[1].state().clone();
        let mut state = expected.clone();
        motions[0].interpolate(expected.time, &mut state);
        assert!((state.columns[0] - expected.columns[0]).abs() < 1e-5, "{state:?} {expected:?}");
        motions[1].advance().unwrap();
    }
}

/// A damper of an order below 1 does not pull at once, a dashpot does.
#[test]
fn multipliers_of_the_start_have_the_forces_of_dampers_there() {
    for (order, share) in [(0.5, 0.0), (0.9, 0.0), (1.0, 1.0), (1.4, 0.0)] {
        let damper = json!([{ "order": order, "coefficient": 2.0, "along": "q0" }]);
        let scenario = rod(damper, moving(), 20);
        let motion = Motion::start(&scenario, Precision::F64).unwrap();
        let (state, v) = (motion.state(), [0.8, 0.6]);
        let expected = of_rod([-2.0 * share * v[0], -9.81], &state.position, &v);
        assert!((state.columns[0] - expected).abs() < 1e-12, "{order}: {state:?} {expected}");
    }
}

#[test]
fn multipliers_carry_a_held_force() {
    let scenario = Scenario::from_value(&json!({
        "system": { "mass": [1.0, 2.0], "constraints": ["q1"] },
        "initial": { "position": [0.0, 0.0] },
        "input": { "samples": [[1.0, 3.0], [0.0, -2.0]], "period": 0.2 },
        "time": { "step": 0.1, "steps": 4 },
    }));
    let scenario = scenario.unwrap();
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    let mut found = vec![motion.state().columns[0]];
    while !motion.is_done() {
        motion.advance().unwrap();
        found.push(motion.state().columns[0]);
    }
    // At a jump that of the step before it.
    for (found, expected) in found.into_iter().zip([3.0, 3.0, 3.0, -2.0, -2.0]) {
        assert!((found - expected).abs() < 1e-13, "{found} {expected}");
    }
}
