//! What mechanisms refuse, and what they warn of: where a motion would be wrong in silence.

use super::motion::{Failure, Motion};
use crate::simulation::{Precision, Simulation};
use fvi_scenario::scenario::Scenario;
use serde_json::{Value, json};
use std::f64::consts::FRAC_PI_4;

fn scenario(system: &Value, initial: &Value, scheme: Value, (step, steps): (f64, usize)) -> Scenario {
    Scenario::from_value(&json!({
        "system": system,
        "initial": initial,
        "scheme": scheme,
        "time": { "step": step, "steps": steps, "energy_guard": "off" },
    }))
    .unwrap()
}

/// The failure of a run, if it fails, and its notes.
fn run(scenario: &Scenario) -> (Option<Failure>, Vec<String>) {
    let mut motion = Motion::start(scenario, Precision::F64).unwrap();
    while !motion.is_done() {
        if let Err(failure) = motion.advance() {
            return (Some(failure), motion.notes());
        }
    }
    (None, motion.notes())
}

fn galerkin(degree: usize) -> Value {
    json!({ "kind": "galerkin", "degree": degree })
}

/// A mass that springs of frequency 2 pull to the origin, hardly damped along an elongation.
fn swinging(along: &str) -> Value {
    json!({
        "mass": [1.0, 1.0],
        "potential": "2*(q0^2 + q1^2)",
        "damping": [{ "order": 0.5, "coefficient": 1e-6, "along": along }],
    })
}

/// The bottom of a rod, where acos has no derivative and a step leads beyond its domain.
#[test]
fn a_step_beyond_the_domain_of_an_elongation_names_it() {
    let system = json!({
        "mass": [1.3, 1.3],
        "potential": "1.3*9.81*q1",
        "constraints": ["q0^2 + q1^2 - 0.64"],
        "damping": [{ "order": 0.5, "coefficient": 0.4, "along": "acos(-q1/0.8)" }],
    });
    let start = json!({ "position": [0.48, -0.64] });
    let (failure, _) = run(&scenario(&system, &start, galerkin(2), (0.01, 100)));
    let reason = failure.unwrap().reason;
    assert!(reason.contains("`system.damping[0].along`") && reason.contains("q = ["), "{reason}");
}

/// A rod and a spring on it, with a damper, in atomic units, in kilograms, and in masses of planets: the
/// places are the same. The same constraint twice is refused in all of them.
#[test]
fn the_unit_of_mass_does_not_matter() {
    let of = |unit: f64, constraints: &[&str]| {
        json!({
            "mass": [1.3 * unit, 1.3 * unit, 0.7 * unit],
            "potential": format!("{:e}*q1 + {:e}*(q2 - q0)^2", 12.753 * unit, 2.0 * unit),
            "constraints": constraints,
            "damping": [{ "order": 0.5, "coefficient": 0.4 * unit, "along": "q2 - q0" }],
        })
    };
    let start = json!({ "position": [0.48, -0.64, 0.5] });
    for scheme in [galerkin(1), galerkin(3), json!({ "kind": "energy" })] {
        let end = |unit: f64| {
            let scenario = scenario(&of(unit, &["q0^2 + q1^2 - 0.64"]), &start, scheme.clone(), (0.01, 200));
            let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
            while !motion.is_done() {
                motion.advance().unwrap_or_else(|failure| panic!("{unit:e}, {scheme}: {failure:?}"));
            }
            // Energies of the damper and the multiplier are as large as the masses.
            let columns = motion.state().columns.iter().map(|column| column / unit);
            motion.state().position.iter().copied().chain(columns).collect::<Vec<_>>()
        };
        let expected = end(1.0);
        assert!(expected.len() > 3 && expected[expected.len() - 1].abs() > 1.0, "{expected:?}");
        for unit in [1e-26, 1e20] {
            for (&found, &known) in end(unit).iter().zip(&expected) {
                assert!((found - known).abs() < 1e-10, "{unit:e}, {scheme}: {found} for {known}");
            }
        }
    }
    for unit in [1e-26, 1.0, 1e20] {
        let twice = of(unit, &["q0^2 + q1^2 - 0.64", "2*(q0^2 + q1^2) - 1.28"]);
        let twice = scenario(&twice, &start, galerkin(2), (0.01, 10));
        let refused = Motion::start(&twice, Precision::F64).err();
        let key = refused.map(|error| error.key().to_owned());
        assert_eq!(key.as_deref(), Some("system.constraints[1]"), "{unit:e}");
    }
}

/// Samples that begin inside steps would act late; those at grid points, and those that change nothing, are
/// taken.
#[test]
fn samples_of_a_force_begin_at_grid_points() {
    let of = |system: Value, input: Value| {
        Scenario::from_value(&json!({
            "system": system,
            "initial": { "position": [1.0] },
            "scheme": galerkin(2),
            "convolution": { "family": "gauss" },
            "input": input,
            "time": { "step": 0.02, "steps": 50 },
        }))
    };
    for system in [json!({ "kinetic": "0.5*v0^2" }), json!({ "mass": [1.0] })] {
        let late = json!({ "samples": [1.0, -1.0, 0.5], "period": 0.35 });
        let error = of(system.clone(), late).unwrap_err();
        let said = format!("{error} {:?}", error.problem().allowed());
        assert_eq!(error.key(), "input");
        for part in ["sample 1", "0.35", "0.34", "0.36", "divides `input.period`"] {
            assert!(said.contains(part), "{said}");
        }
        for taken in [
            json!({ "samples": [1.0, -1.0, 0.5], "period": 0.34 }),
            json!({ "samples": [1.0, 1.0, 0.5], "times": [0.0, 0.35, 0.5] }),
            json!({ "samples": [1.0, 2.0], "times": [0.0, 3.35] }),
        ] {
            of(system.clone(), taken).unwrap();
        }
    }
}

/// The mass passes the origin at t = π/4, where length and angle have no derivative: between the nodes of a
/// step of any length, and close behind one.
#[test]
fn a_motion_through_a_point_without_derivative_ends_there_and_says_which() {
    let start = json!({ "position": [1.0, 0.0] });
    let node = 0.5 - 3.0_f64.sqrt() / 6.0;
    let behind = [1e-3, 0.01, 0.1].map(|part| FRAC_PI_4 / (5.0 + node + part));
    for step in [0.2, 0.1, 0.0371].into_iter().chain(behind) {
        for along in
            ["hypot(q0, q1)", "sqrt(q0^2 + q1^2) + 3*q0", "atan2(q1, q0)", "acos(q0/hypot(q0, q1 - 0.3))"]
        {
            for scheme in [galerkin(2), galerkin(3), json!({ "kind": "energy" })] {
                let (failure, _) =
                    run(&scenario(&swinging(along), &start, scheme.clone(), (step, (1.2 / step) as usize)));
                let reaches = !along.starts_with("acos");
                let Some(failure) = failure else {
                    assert!(!reaches, "{along}, h = {step}, {scheme}: it passed");
                    continue;
                };
                assert!(reaches, "{along}, h = {step}, {scheme}: {failure:?}");
                assert!(failure.reason.contains("`system.damping[0].along`"), "{failure:?}");
                assert!((failure.time - FRAC_PI_4).abs() < 1.1 * step, "{failure:?}");
                let told = failure.reason.split("t = ").nth(1).unwrap();
                let told: f64 = told.split(' ').next().unwrap().parse().unwrap();
                let late = if scheme["kind"] == "energy" { 0.4 * step } else { 2e-2 * step };
                assert!((told - FRAC_PI_4).abs() < late + 2e-6, "{along}, h = {step}, {scheme}: {failure:?}");
            }
        }
    }
}

/// Beside the point short steps follow the angle, and long ones say that they do not.
#[test]
fn a_motion_close_beside_such_a_point_says_if_its_steps_are_too_long() {
    let start = json!({ "position": [1.0, 0.0], "velocity": [0.0, 0.02] });
    for (step, warns) in [(0.2, true), (0.0004, false)] {
        let of = scenario(&swinging("atan2(q1, q0)"), &start, galerkin(2), (step, (1.0 / step) as usize));
        let (failure, notes) = run(&of);
        assert_eq!(failure, None, "h = {step}");
        assert_eq!(
            notes.iter().any(|note| note.contains("system.damping[0].along")),
            warns,
            "h = {step}: {notes:?}"
        );
    }
    // A crank that turns through the cut of its angle is nothing special.
    let round = json!({ "position": [1.0, 0.0], "velocity": [0.0, 2.0] });
    let of = scenario(&swinging("atan2(q1, q0)"), &round, galerkin(2), (0.05, 200));
    assert_eq!(run(&of), (None, Vec::new()));
}

fn refusal(system: &Value, initial: &Value) -> (String, String) {
    let of = scenario(system, initial, galerkin(2), (0.1, 3));
    let error = Simulation::new(&of, Precision::F64).map(drop).unwrap_err();
    (error.key().to_owned(), error.to_string())
}

/// T = ½v₀² + 2v₀v₁ + ½v₁² is negative for v₀ = −v₁.
#[test]
fn a_kinetic_energy_that_is_negative_for_a_velocity_is_refused_where_it_is_allowed() {
    let of = |constraints: Value| {
        json!({
            "kinetic": "0.5*v0^2 + 2*v0*v1 + 0.5*v1^2", "potential": "q0^2 + q1^2", "constraints": constraints,
        })
    };
    let still = json!({ "position": [0.0, 0.0] });
    for constraints in [json!([]), json!(["q0 + q1"])] {
        let (key, message) = refusal(&of(constraints), &still);
        assert_eq!(key, "system.kinetic", "{message}");
        assert!(message.contains("not positive definite") && message.contains("energy -"), "{message}");
    }
    let allowed = scenario(&of(json!(["q0 - q1"])), &still, galerkin(2), (0.1, 3));
    assert_eq!(run(&allowed).0, None);
    // Nothing has mass.
    let none = json!({ "kinetic": "0.5*v0^2 + 0*v1", "potential": "q0^2 + q1^2" });
    let (key, message) = refusal(&none, &still);
    assert_eq!(key, "system.kinetic", "{message}");
}

/// The second coordinate, at rest, loses its mass where the first reaches 1, at t = 2.
#[test]
fn a_mass_that_is_lost_on_the_way_ends_the_run_with_the_time() {
    let system = json!({ "kinetic": "0.5*v0^2 + 0.5*(1 - q0)*v1^2", "potential": "0*q0" });
    let start = json!({ "position": [0.0, 0.0], "velocity": [0.5, 0.0] });
    for scheme in [galerkin(1), galerkin(3), json!({ "kind": "energy" })] {
        for (step, last) in [(0.3, 1.8), (0.25, 1.75)] {
            let (failure, _) = run(&scenario(&system, &start, scheme.clone(), (step, 20)));
            let failure = failure.unwrap();
            assert!((failure.time - last).abs() < 1e-12, "{scheme}: {failure:?}");
            let reason = &failure.reason;
            assert!(reason.contains("`system.kinetic`") && reason.contains("coordinate 1"), "{reason}");
        }
    }
}

#[test]
fn constraints_that_contradict_each_other_are_named() {
    let of = |constraints: Value, position: Value| {
        let system = json!({ "mass": [1.0, 1.0], "potential": "q1", "constraints": constraints });
        refusal(&system, &json!({ "position": position, "project": true }))
    };
    // Two circles about one point; a circle and a line beside it; a number that is not 0.
    for (constraints, index, phrase) in [
        (json!(["q0^2 + q1^2 - 1", "q0^2 + q1^2 - 4"]), 1, "contradicts those before it"),
        (json!(["q0 - q1", "2*q0 - 2*q1 + 3"]), 1, "where they hold it is 2.99"),
        (json!(["q0^2 + q1^2 - 1", "q0 - 5"]), 1, "no position on the constraints"),
    ] {
        let (key, message) = of(constraints, json!([0.6, 0.7]));
        assert_eq!(key, format!("system.constraints[{index}]"), "{message}");
        assert!(message.contains(phrase), "{message}");
        assert!(!message.contains("mass"), "{message}");
    }
    // The same length twice is redundant, not a contradiction.
    let (_, message) = of(json!(["q0^2 + q1^2 - 1", "3*q0^2 + 3*q1^2 - 3"]), json!([0.6, 0.8]));
    assert!(message.contains("redundant"), "{message}");
}

/// ωh = 0.5 is a turn of 28°, ωh = 30 one of 172°.
#[test]
fn a_motion_that_turns_beyond_a_right_angle_in_a_step_says_so() {
    let start = json!({ "position": [1.0], "velocity": [0.0] });
    for system in [
        json!({ "mass": [1.0], "potential": "5000*q0^2" }),
        json!({ "kinetic": "0.5*v0^2 + 3*q0*v0", "potential": "5000*q0^2" }),
    ] {
        for (step, phrase) in [(0.005, None), (0.015, None), (0.025, Some("103°")), (0.3, Some("172°"))] {
            let (failure, notes) = run(&scenario(&system, &start, json!({ "kind": "energy" }), (step, 200)));
            assert_eq!(failure, None);
            let told = notes.iter().any(|note| {
                note.contains("right angle") && phrase.is_none_or(|phrase| note.contains(phrase))
            });
            assert_eq!(told, phrase.is_some(), "h = {step}: {notes:?}");
        }
    }
    // A fast spring that carries little of the energy may turn as it likes.
    let system = json!({ "mass": [1.0, 1.0], "potential": "0.5*q0^2 + 5000*q1^2" });
    let slow = json!({ "position": [1.0, 1e-4], "velocity": [0.0, 0.0] });
    assert_eq!(
        run(&scenario(&system, &slow, json!({ "kind": "energy" }), (0.1, 200))).1,
        Vec::<String>::new()
    );
}

/// U = 0 where a mechanism hangs: what rounding makes of it is no energy from nowhere, neither at rest nor
/// before a force begins, nor where constraints leave no motion at all.
#[test]
fn a_mechanism_at_rest_stays_there_whatever_constant_its_potential_has() {
    for shift in ["9.81*(q1 + 1)", "9.81*q1", "1e3*(q1 + 1) - 1e3*(q1^2 + q0^2 - 1)"] {
        for force in [json!(["0", "0"]), json!(["step(t - 1)*sin(t - 1)", "0"])] {
            for constraints in [json!(["q0^2 + q1^2 - 1"]), json!(["q0^2 + q1^2 - 1", "q0"])] {
                let system = json!({
                    "mass": [1.0, 1.0], "potential": shift, "force": force, "constraints": constraints,
                });
                let start = json!({ "position": [0.0, -1.0], "velocity": [0.0, 0.0] });
                let (failure, notes) = run(&scenario(&system, &start, galerkin(2), (0.01, 300)));
                assert_eq!(failure, None, "{shift}, {force}, {constraints}");
                assert_eq!(notes, Vec::<String>::new(), "{shift}, {force}, {constraints}");
            }
        }
    }
}

/// Without `[convolution]` the memory of a scheme of order 4 has order 2; nobody may miss that.
#[test]
fn a_memory_of_lower_order_than_its_scheme_says_so_where_nobody_asked_for_it() {
    let warnings = |scheme: Value, convolution: Option<Value>, order: f64| {
        let mut whole = json!({
            "system": { "mass": [1.0], "damping": [{ "order": order, "coefficient": [1.0] }] },
            "initial": { "position": [1.0] },
            "scheme": scheme,
            "time": { "step": 0.1, "steps": 3 },
        });
        if let Some(convolution) = convolution {
            whole["convolution"] = convolution;
        }
        let warnings = Scenario::from_value(&whole).unwrap().warnings();
        warnings.iter().any(|warning| warning.starts_with("convolution: ") && warning.contains("order 2"))
    };
    assert!(warnings(galerkin(2), None, 0.5));
    assert!(!warnings(galerkin(1), None, 0.5));
    assert!(!warnings(galerkin(2), Some(json!({ "order": 2 })), 0.5));
    assert!(!warnings(galerkin(2), Some(json!({ "family": "gauss" })), 0.5));
    assert!(!warnings(json!({ "kind": "collocation" }), None, 0.5));
}
