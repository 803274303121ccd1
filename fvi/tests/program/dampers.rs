//! Viscous dampers c sign(v)|v|^γ with γ < 1, the commonest of earthquake engineering, and the hysteresis of
//! Bouc and Wen.

use crate::workplace::{Workplace, text};
use fvi_host::run::Run;
use fvi_scenario::scenario::Scenario;
use serde_json::{Value, json};
use std::sync::atomic::AtomicBool;

/// The positions and momenta at the end of a run, or why there is none.
fn end_of(scenario: &Value) -> (Vec<f64>, Vec<f64>) {
    let read = Scenario::from_value(scenario).unwrap_or_else(|error| panic!("{scenario}: {error}"));
    let mut last = (Vec::new(), Vec::new());
    let mut run = Run::of(&read).start().unwrap();
    let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
        portion.states(|_, state| {
            last = (state.position.clone(), state.momentum.clone());
            Ok::<_, std::convert::Infallible>(())
        })
    });
    let end = format!("{end:?}");
    assert!(end.contains("Complete"), "{scenario}: {end}");
    last
}

/// Schemes with the names of their grids.
fn schemes() -> Vec<(&'static str, Value)> {
    let uniform = json!({ "step": 0.01, "end": 3.0 });
    let graded = json!({ "grid": "graded", "exponent": 2.0, "steps": 300, "end": 3.0 });
    let adaptive = json!({ "grid": "adaptive", "tolerance": 1e-4, "end": 3.0 });
    let radau = json!({ "family": "radau-iia", "stages": 2 });
    let galerkin = |degree: usize| json!({ "kind": "galerkin", "degree": degree });
    vec![
        ("low order", json!({ "time": uniform })),
        ("explicit Euler", json!({ "scheme": { "kind": "explicit-euler" }, "time": uniform })),
        ("implicit Euler", json!({ "scheme": { "kind": "implicit-euler" }, "time": uniform })),
        ("degree 2", json!({ "scheme": galerkin(2), "time": uniform })),
        ("degree 3", json!({ "scheme": galerkin(3), "time": uniform })),
        ("degree 2, graded", json!({ "scheme": galerkin(2), "convolution": radau, "time": graded })),
        ("degree 2, adaptive", json!({ "scheme": galerkin(2), "convolution": radau, "time": adaptive })),
        ("collocation", json!({ "scheme": { "kind": "collocation" }, "time": uniform })),
        ("collocation, graded", json!({ "scheme": { "kind": "collocation" }, "time": graded })),
        ("collocation, adaptive", json!({ "scheme": { "kind": "collocation" }, "time": adaptive })),
    ]
}

/// v̇ = −c v^γ from v₀ stops at t = v₀^{1−γ}/((1 − γ) c) and q = v₀^{2−γ}/((2 − γ) c), and stays there.
#[test]
fn a_damper_stops_a_mass_where_it_should_in_every_scheme_and_on_every_grid() {
    let c = 2.0;
    for power in [0.05, 0.1, 0.2, 0.3, 0.5, 0.7] {
        let stop = 1.0 / ((2.0 - power) * c);
        for (name, keys) in schemes() {
            // What sticks moves to and fro there by ever less, which adaptive steps follow: too many are refused.
            if name == "degree 2, adaptive" && power < 0.5 {
                continue;
            }
            let mut scenario = keys;
            scenario["system"] =
                json!({ "mass": [1.0], "force": [format!("-{c}*sign(v0)*abs(v0)^{power}")] });
            scenario["initial"] = json!({ "position": [0.0], "velocity": [1.0] });
            let (position, momentum) = end_of(&scenario);
            // Schemes of first order are those of Euler.
            let bound = if name.ends_with("Euler") { 0.02 } else { 5e-3 };
            let off = position[0] - stop;
            assert!(off.abs() < bound, "γ = {power}, {name}: {off:e} from {stop}");
            assert!(momentum[0].abs() < 0.03, "γ = {power}, {name}: {}", momentum[0]);
        }
    }
}

/// Where a variational scheme on adaptive steps gives up, it says which one does not, which takes few steps.
#[test]
fn adaptive_steps_say_which_scheme_lets_a_held_mass_rest() {
    let place = Workplace::new();
    let scenario = |scheme: &str| {
        format!(
            "[system]\nmass = [1.0]\npotential = \"2*q0^2\"\nforce = [\"-0.5*sign(v0)*abs(v0)^0.1\"]\n\
             [[system.damping]]\norder = 0.5\ncoefficient = [0.1]\n[initial]\nposition = [1.0]\n\
             [scheme]\n{scheme}\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n[time]\nend = 20.0\ntolerance = 1e-6\n"
        )
    };
    place.write("galerkin.toml", &scenario("kind = \"galerkin\"\ndegree = 2"));
    let output = place.fvi(&["run", "galerkin.toml"]);
    let said = text(&output.stderr);
    assert!(output.status.code() == Some(1) && said.contains("`scheme.kind` = \"collocation\""), "{said}");
    place.write("collocation.toml", &scenario("kind = \"collocation\""));
    let output = place.fvi(&["run", "collocation.toml", "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let summary: Value =
        serde_json::from_str(&std::fs::read_to_string(place.path("out/summary.json")).unwrap()).unwrap();
    // Some 900, or 3000 to 5000 where rounding makes the last stop one of many small ones.
    assert!(summary["steps"].as_u64().unwrap() < 10_000, "{}", summary["steps"]);
}

/// A mechanism, and a building that is pushed, freed and held by a damper in each storey: the schemes agree.
#[test]
fn dampers_between_masses_hold_them_in_every_scheme() {
    let damper = |over: &str| format!("3*sign({over})*abs({over})^0.1");
    let push = |size: f64| format!("{size}*sin(7*t)*step(2 - t)");
    let force = [
        format!("-{} + {} + {}", damper("v0"), damper("(v1 - v0)"), push(2.0)),
        format!("-{} + {}", damper("(v1 - v0)"), push(3.0)),
    ];
    let time = json!({ "step": 0.005, "end": 4.0 });
    let rest = json!({ "position": [0.0, 0.0] });
    let system =
        json!({ "mass": [1.0, 1.0], "stiffness": [[1800.0, -900.0], [-900.0, 900.0]], "force": force });
    let of_scheme = |scheme: Value| {
        end_of(&json!({ "system": system, "initial": rest, "scheme": scheme, "time": time })).0
    };
    let low = of_scheme(json!({ "kind": "low-order", "kappa": 0.5 }));
    let mechanism = json!({ "kinetic": "0.5*v0^2 + 0.5*v1^2", "potential": "450*q0^2 + 450*(q1 - q0)^2", "force": force });
    let others = [
        ("degree 2", of_scheme(json!({ "kind": "galerkin", "degree": 2 }))),
        ("collocation", of_scheme(json!({ "kind": "collocation" }))),
        ("mechanism", end_of(&json!({ "system": mechanism, "initial": rest, "time": time })).0),
    ];
    // Without dampers the amplitude is 0.02, and what a damper can hold 3/900.
    assert!(low.iter().any(|q| q.abs() > 1e-4), "{low:?}");
    for (name, other) in others {
        for (own, other) in low.iter().zip(&other) {
            assert!((own - other).abs() < 3e-5, "{name}: {own} and {other}");
        }
    }
}

/// v̇ = −v: what the energy of a mechanism loses is the work of the drag.
#[test]
fn what_drag_takes_from_a_mechanism_is_no_loss_of_its_steps() {
    let place = Workplace::new();
    let system = "[system]\nkinetic = \"0.5*v0^2\"\nforce = [\"-v0\"]\n[initial]\nposition = [0.0]\nvelocity = [1.0]\n";
    let run = place.run(&format!("{system}[time]\nstep = 0.01\nend = 1.0\n"), &[]);
    assert!(run.summary["warnings"].is_null(), "{}", run.summary["warnings"]);
    let p = run.summary["last"]["momentum"][0].as_f64().unwrap();
    assert!((p - (-1.0f64).exp()).abs() < 1e-4, "{p}");
}

/// The dashpot of order 1 holds the hysteretic z (coordinate 1, without mass) as −ż in the force does.
#[test]
fn a_dashpot_holds_what_velocities_of_others_push() {
    let with = |own: &str, damping: Value| {
        let force = [
            "-q0 - 9*q1 - 0.2*v0 + 5*sin(2*t)".to_owned(),
            format!("{own}v0 - 0.5*abs(v0)*q1 - 0.5*v0*abs(q1)"),
        ];
        end_of(&json!({
            "system": { "mass": [1.0, 0.0], "force": force, "damping": damping },
            "initial": { "position": [0.0, 0.0] },
            "time": { "step": 0.005, "end": 20.0 },
        }))
        .0
    };
    let dashpot = with("", json!([{ "order": 1, "coefficient": [0, 1] }]));
    let force = with("-v1 + ", json!([]));
    for (dashpot, force) in dashpot.iter().zip(&force) {
        assert!((dashpot - force).abs() < 1e-3, "{dashpot} and {force}");
    }
    assert!(force[0].abs() > 0.1);
}
