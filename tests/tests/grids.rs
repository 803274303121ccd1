//! Runs on grids whose steps differ: equal steps on every engine, the order between grid points, and energy
//! that nothing puts in.

use fvi_fft::sums::max_or_nan;
use fvi_host::run::Run;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::GridState;
use serde_json::{Value, json};
use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

/// The rows of a run.
fn rows(scenario: &Value) -> Vec<GridState> {
    let scenario = Scenario::from_value(scenario).unwrap();
    let mut rows = Vec::new();
    let mut run = Run::of(&scenario).start().unwrap();
    let Ok(_) = run.drive(&AtomicBool::new(false), |portion| {
        portion.rows(|_, state| {
            rows.push(state.clone());
            Ok::<_, Infallible>(())
        })
    });
    rows
}

/// A driven pendulum with damping of some order.
fn pendulum(order: f64, scheme: (Value, Value)) -> Value {
    json!({
        "system": {
            "mass": [1.0],
            "potential": "-4*cos(q0)",
            "force": ["0.5*sin(2*t)"],
            "damping": [{ "order": order, "coefficient": [0.5] }],
        },
        "initial": { "position": [2.0], "velocity": [0.0] },
        "scheme": scheme.0,
        "convolution": scheme.1,
    })
}

fn radau(stages: usize) -> Value {
    json!({ "family": "radau-iia", "stages": stages })
}

#[test]
fn equal_steps_give_the_trajectory_of_the_engines_for_equal_steps() {
    let collocation = || json!({ "kind": "collocation" });
    let galerkin = |degree: usize| json!({ "kind": "galerkin", "degree": degree });
    let schemes = [
        (collocation(), radau(1)),
        (collocation(), radau(2)),
        (collocation(), radau(3)),
        (galerkin(3), radau(3)),
        (galerkin(2), json!({ "family": "lobatto-iiic", "stages": 3 })),
    ];
    for order in [0.3, 0.6, 1.5] {
        for scheme in &schemes {
            let runs = ["direct", "any-step"].map(|engine| {
                let mut scenario = pendulum(order, scheme.clone());
                scenario["time"] = json!({ "step": 0.02, "steps": 500 });
                scenario["history"] = json!({ "engine": engine });
                rows(&scenario)
            });
            let mut given = pendulum(order, scheme.clone());
            let times: Vec<f64> = runs[0].iter().map(|state| state.time).collect();
            given["time"] = json!({ "grid": "points", "points": times });
            let given = rows(&given);
            let largest = |of: fn(&GridState) -> f64| {
                runs[0].iter().fold(0.0_f64, |largest, state| max_or_nan(largest, of(state).abs()))
            };
            for of in [|state: &GridState| state.position[0], |state: &GridState| state.momentum[0]] {
                for other in [&runs[1], &given] {
                    assert_eq!(other.len(), 501);
                    for (one, other) in runs[0].iter().zip(other) {
                        let error = (of(one) - of(other)).abs() / largest(of);
                        assert!(error < 1e-11, "β = {order}, {scheme:?}, t = {}: {error:e}", one.time);
                    }
                }
            }
        }
    }
}

#[test]
fn between_grid_points_the_polynomial_has_its_order() {
    // t⁸ at places that are no grid points of any grid.
    let times: Vec<f64> = (1..40).map(|k| (f64::from(k) + 0.381_966) / 40.1).collect();
    let galerkin = json!({ "kind": "galerkin", "degree": 3 });
    let collocation = json!({ "kind": "collocation" });
    // Positions and momenta; where grid points lie beside these places differs, so that orders show over a
    // factor of eight only.
    for (scheme, stages, expected) in
        [(&collocation, 2, [3.0, 3.0]), (&collocation, 3, [5.0, 4.0]), (&galerkin, 3, [4.0, 3.0])]
    {
        let errors = [20, 160].map(|steps| {
            let mut scenario = pendulum(0.5, (scheme.clone(), radau(stages)));
            let power = libm::tgamma(9.0) / libm::tgamma(8.5);
            scenario["system"]["force"] = json!([format!("56*t^6 + 4*sin(t^8) + 0.5*{power:?}*t^7.5")]);
            scenario["initial"]["position"] = json!([0.0]);
            scenario["time"] = json!({ "grid": "graded", "end": 1.0, "steps": steps, "exponent": 1.5 });
            scenario["output"] = json!({ "times": times });
            let mut errors = [0.0_f64; 2];
            for state in rows(&scenario) {
                let t = state.time;
                errors[0] = errors[0].max((state.position[0] - t.powi(8)).abs());
                errors[1] = errors[1].max((state.momentum[0] - 8.0 * t.powi(7)).abs());
            }
            errors
        });
        for (index, expected) in expected.into_iter().enumerate() {
            let order = (errors[0][index] / errors[1][index]).log2() / 3.0;
            assert!(
                (order - expected).abs() < 0.4,
                "{scheme}, {stages} stages, {index}: {order} of {errors:?}"
            );
        }
    }
}

/// min(u, w + 3 − β) for positions and min(u, w + 2 − β) for momenta, u the order of the Runge–Kutta method
/// and w its stage order, as on equal steps: no grid gives back what the quadrature of D^β loses at the
/// stages.
#[test]
fn on_graded_steps_galerkin_schemes_have_the_orders_of_equal_steps() {
    let lobatto = |stages: usize| json!({ "family": "lobatto-iiic", "stages": stages });
    for (convolution, degree, method, stage) in [
        (radau(2), 2, 3.0, 2.0),
        (radau(3), 3, 5.0, 3.0),
        (lobatto(3), 2, 4.0, 2.0),
        (lobatto(4), 3, 6.0, 3.0),
    ] {
        for order in [0.4, 1.4] {
            let runs = [96, 192, 1536].map(|steps| {
                let scheme = json!({ "kind": "galerkin", "degree": degree });
                let mut scenario = pendulum(order, (scheme, convolution.clone()));
                scenario["time"] = json!({ "grid": "graded", "end": 4.0, "steps": steps, "exponent": 4.0 });
                rows(&scenario)
            });
            let of = [|state: &GridState| state.position[0], |state: &GridState| state.momentum[0]];
            for (of, lost) in of.into_iter().zip([3.0, 2.0]) {
                let errors = [&runs[0], &runs[1]].map(|run| {
                    let each = (runs[2].len() - 1) / (run.len() - 1);
                    let finer = runs[2].iter().step_by(each);
                    run.iter()
                        .zip(finer)
                        .fold(0.0_f64, |largest, (one, fine)| max_or_nan(largest, (of(one) - of(fine)).abs()))
                });
                let (measured, expected) =
                    ((errors[0] / errors[1]).log2(), f64::min(method, stage + lost - order));
                assert!(
                    (measured - expected).abs() < 0.35,
                    "{convolution}, β = {order}: {measured} for {expected}, {errors:?}"
                );
            }
        }
    }
}

#[test]
fn on_no_grid_does_damping_put_energy_in() {
    let mut times = vec![0.0];
    // Steps that jump by factors up to a thousand.
    let mut state = 1_u64;
    while times[times.len() - 1] < 10.0 {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let share = (state >> 40) as f64 / (1_u64 << 24) as f64;
        times.push(times[times.len() - 1] + 10_f64.powf(3.0 * share - 3.0));
    }
    let grids = [
        json!({ "grid": "graded", "end": 10.0, "steps": 60, "exponent": 4.0 }),
        json!({ "grid": "geometric", "end": 10.0, "first": 1e-9, "ratio": 1.7, "longest": 1.0 }),
        json!({ "grid": "points", "points": times }),
    ];
    for order in [0.1, 0.5, 0.9, 1.5, 1.9] {
        for grid in &grids {
            for stages in [1, 2, 3] {
                let mut scenario = pendulum(order, (json!({ "kind": "collocation" }), radau(stages)));
                scenario["system"]["potential"] = json!("2*q0^2");
                scenario["system"]["force"] = json!(["0"]);
                scenario["time"] = grid.clone();
                let rows = rows(&scenario);
                let start = rows[0].energy;
                for row in &rows {
                    assert!(
                        row.energy <= start * (1.0 + 1e-12),
                        "β = {order}, {grid}: {}",
                        row.energy / start
                    );
                }
                assert!(rows[rows.len() - 1].energy < 0.9 * start);
            }
        }
    }
}

#[test]
fn the_scenario_of_a_summary_runs_as_it_was() {
    for time in [
        json!({ "grid": "graded", "end": 2.0, "steps": 40, "exponent": 2.0 }),
        json!({ "grid": "adaptive", "end": 2.0, "tolerance": 1e-6 }),
        json!({ "step": 0.001, "steps": 20_000 }),
    ] {
        let mut scenario = pendulum(0.5, (json!({ "kind": "collocation" }), radau(3)));
        scenario["time"] = time;
        let record = serde_json::to_value(Scenario::from_value(&scenario).unwrap()).unwrap();
        let (first, second) = (rows(&scenario), rows(&without_nulls(record)));
        assert!(first == second, "{}", scenario["time"]);
    }
}

/// As a file would leave them out.
fn without_nulls(value: Value) -> Value {
    match value {
        Value::Object(entries) => {
            let entries = entries.into_iter().filter(|(_, entry)| !entry.is_null());
            entries.map(|(key, entry)| (key, without_nulls(entry))).collect()
        }
        other => other,
    }
}
