//! Collocation with Radau IIA: its order on smooth motions, the energy it loses, and that nothing makes it
//! unstable.

use fvi_fft::sums::max_or_nan;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Precision;
use fvi_simulation::simulation::motion::Motion;
use serde_json::{Value, json};

fn largest_error(scenario: &Value) -> f64 {
    let scenario = Scenario::from_value(scenario).unwrap();
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    let mut largest = 0.0_f64;
    for step in 1..=scenario.time.steps {
        motion.advance().unwrap();
        let known = scenario.reference.as_ref().unwrap().at_grid_point(step, &scenario.time, 1).unwrap();
        let state = motion.state();
        largest = max_or_nan(largest, (state.position[0] - known.position[0].unwrap()).abs());
        largest = max_or_nan(largest, (state.momentum[0] - known.momentum[0].unwrap()).abs());
    }
    largest
}

/// q̈ + D^β q + q³ = f with the solution t⁸, on [0, 1].
fn smooth(beta: f64, stages: usize, steps: usize) -> Value {
    let power = libm::tgamma(9.0) / libm::tgamma(9.0 - beta);
    json!({
        "system": {
            "mass": [1.0],
            "potential": "0.25*q0^4",
            "force": [format!("56*t^6 + {power:?}*t^{:?} + t^24", 8.0 - beta)],
            "damping": [{ "order": beta, "coefficient": [1.0] }],
        },
        "initial": { "position": [0.0], "velocity": [0.0] },
        "scheme": { "kind": "collocation" },
        "convolution": { "family": "radau-iia", "stages": stages },
        "time": { "step": 1.0 / steps as f64, "steps": steps },
        "reference": { "position": ["t^8"], "momentum": ["8*t^7"] },
    })
}

#[test]
fn two_and_three_stages_have_orders_three_and_five_on_smooth_motions() {
    for beta in [0.3, 0.7, 1.5] {
        for (stages, expected, steps) in [(2, 3.0, 40), (3, 5.0, 20)] {
            let errors = [1, 2, 4].map(|factor| largest_error(&smooth(beta, stages, factor * steps)));
            let order = (errors[1] / errors[2]).log2();
            assert!((order - expected).abs() < 0.3, "β = {beta}, {stages} stages: {errors:?}, order {order}");
        }
    }
}

fn oscillator(frequency: f64, damping: &Value, steps: usize) -> Value {
    json!({
        "system": {
            "mass": [1.0],
            "potential": format!("0.5*{:?}*q0^2", frequency * frequency),
            "damping": damping,
        },
        "initial": { "position": [1.0], "velocity": [0.0] },
        "scheme": { "kind": "collocation" },
        "time": { "step": 1.0, "steps": steps },
    })
}

#[test]
fn an_undamped_oscillator_loses_energy_by_the_stability_function() {
    // |R(iy)|² = P/(P + y⁶/3600) with P = (1 − y²/20)² + (2y/5)² for three stages.
    for y in [0.3_f64, 1.0, 3.0] {
        let scenario = Scenario::from_value(&oscillator(y, &json!([]), 8)).unwrap();
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        let mut before = motion.state().energy;
        let numerator = (1.0 - y * y / 20.0).powi(2) + (0.4 * y).powi(2);
        let factor = numerator / (numerator + y.powi(6) / 3600.0);
        for _ in 0..8 {
            motion.advance().unwrap();
            let energy = motion.state().energy;
            assert!((energy / before / factor - 1.0).abs() < 1e-12, "ωh = {y}: {} {factor}", energy / before);
            before = energy;
        }
    }
}

#[test]
fn neither_stiffness_nor_damping_makes_it_unstable() {
    for frequency in [1.0, 1e3, 1e6] {
        for (beta, coefficient) in [(0.1, 1.0), (0.5, 1e4), (1.0, 1e2), (1.9, 100.0), (1.9, 1e8)] {
            let damping = json!([{ "order": beta, "coefficient": [coefficient] }]);
            let scenario = Scenario::from_value(&oscillator(frequency, &damping, 300)).unwrap();
            let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
            let first = motion.state().energy;
            for _ in 0..300 {
                motion.advance().unwrap_or_else(|failure| panic!("{frequency}, {beta}: {failure:?}"));
                let energy = motion.state().energy;
                assert!(
                    energy <= first * (1.0 + 1e-9),
                    "ω = {frequency}, β = {beta}, ρ = {coefficient}: {energy:e}"
                );
            }
        }
    }
}
