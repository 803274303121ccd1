//! The midpoint rule with discrete gradients: its law for any potential, elongation, constraint and step.

use super::motion::Motion;
use crate::simulation::Precision;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::scenario::Scenario;
use serde_json::{Value, json};

fn scenario(system: &Value, initial: Value, (end, steps): (f64, usize)) -> Scenario {
    Scenario::from_value(&json!({
        "system": system,
        "initial": initial,
        "scheme": { "kind": "energy" },
        "time": { "step": end / steps as f64, "steps": steps },
        "output": { "memory_energy": true },
    }))
    .unwrap()
}

/// Energy, energy stored and energy dissipated at every grid point, and the last position.
fn energies(scenario: &Scenario) -> (Vec<[f64; 3]>, Vec<f64>) {
    let mut motion = Motion::start(scenario, Precision::F64).unwrap();
    let mut found = Vec::new();
    let read = |motion: &Motion<'_>| {
        let state = motion.state();
        let [.., stored, dissipated] = state.columns[..] else { panic!("no columns of energies") };
        [state.energy, stored, dissipated]
    };
    found.push(read(&motion));
    while !motion.is_done() {
        motion.advance().unwrap();
        found.push(read(&motion));
    }
    (found, motion.state().position.clone())
}

/// The largest rise of E plus the energy stored from one grid point to the next, and the largest error of E +
/// stored + dissipated = E₀, relative to the largest of all energies.
fn law(energies: &[[f64; 3]]) -> [f64; 2] {
    let sizes = energies.iter().flatten().map(|energy| energy.abs());
    let largest = sizes.fold(1e-300, max_or_nan);
    let kept = |[energy, stored, _]: [f64; 3]| energy + stored;
    let rises = energies.windows(2).map(|pair| kept(pair[1]) - kept(pair[0]));
    let rise = rises.fold(f64::NEG_INFINITY, max_or_nan);
    let whole = |row: &[f64; 3]| (row.iter().sum::<f64>() - energies[0][0]).abs();
    let off = energies.iter().map(whole).fold(0.0, max_or_nan);
    [rise / largest, off / largest]
}

/// A mass on a spring about a point, in the plane, damped along its length: stiff, with steps far beyond
/// those that follow its motion.
#[test]
fn a_spring_pendulum_never_gains_energy_at_any_step() {
    for (stiffness, step, rho) in [
        (20.0, 0.05, 3.0),
        (20.0, 0.3, 3.0),
        (200.0, 0.3, 0.3),
        (1000.0, 0.2, 0.1),
        (200.0, 0.3, 30.0),
        (20.0, 1.0, 1.0),
    ] {
        let system = json!({
            "mass": [1.0, 1.0],
            "potential": "0.5*k*(hypot(q0, q1) - 1)^2 + 9.81*q1",
            "parameters": { "k": stiffness },
            "damping": [{ "order": 0.5, "coefficient": rho, "along": "hypot(q0, q1)" }],
        });
        let start = json!({ "position": [1.1, 0.0], "velocity": [0.0, 0.5] });
        let (energies, _) = energies(&scenario(&system, start, (100.0 * step, 100)));
        let [rise, off] = law(&energies);
        assert!(rise < 1e-13 && off < 1e-12, "k = {stiffness}, h = {step}: {rise:e} {off:e}");
        assert!(energies[100][2] > 0.0, "{:?}", energies[100]);
    }
}

/// Steep walls, a double well, a quartic and an exponential potential, a constraint that is not quadratic,
/// and dampers along products and angles of any kernel, at steps of every length.
#[test]
fn neither_potential_nor_constraint_nor_step_breaks_the_law() {
    let potentials = [
        ("25*q0^4 + 3*q1^4 - 8*q0^2 + q0*q1 + 2*q2^2", None),
        ("exp(3*q0) + exp(-3*q0) + exp(2*q1 - q2) + exp(q2 - 2*q1) + q2^4", None),
        ("200*max(q0 - 0.3, 0)^2 + 200*max(-q0 - 0.3, 0)^2 + q1^2 - 5*q2 + 0.5*q2^4", None),
        ("9.81*q1 + 4*q2^4", Some("q0^4 + q1^4 + 0.3*q2^2 - 1")),
        ("9.81*q1 + 4*cos(3*q2)", Some("cosh(q0) + q1^2 - 2")),
    ];
    let kernels = [
        json!({ "order": 0.3, "coefficient": 0.8, "along": "q0*q1 + q2" }),
        json!({ "kernel": { "form": "prony", "strengths": [30.0, 2.0], "times": [0.01, 4.0] }, "coefficient": 1.0, "along": "sin(q0) - q2" }),
        json!({ "order": 1.0, "coefficient": 0.2, "along": "atan2(q1 + 2, q0)" }),
    ];
    for (index, (potential, constraint)) in potentials.iter().enumerate() {
        for step in [0.01, 0.1, 0.5, 2.0, 10.0] {
            let mut system = json!({ "mass": [1.0, 0.7, 0.2], "potential": potential, "damping": kernels });
            let mut start = json!({ "position": [0.4, -0.5, 0.3], "velocity": [1.0, 3.0, -2.0] });
            if let Some(constraint) = constraint {
                system["constraints"] = json!([constraint]);
                start["project"] = json!(true);
            }
            let scenario = scenario(&system, start, (60.0 * step, 60));
            let (energies, last) = energies(&scenario);
            let [rise, off] = law(&energies);
            assert!(rise < 1e-12 && off < 1e-11, "{index}, h = {step}: {rise:e} {off:e}");
            if constraint.is_some() {
                let [x, y, z] = last[..] else { panic!("{last:?}") };
                let value = if index == 3 {
                    x.powi(4) + y.powi(4) + 0.3 * z * z - 1.0
                } else {
                    x.cosh() + y * y - 2.0
                };
                assert!(value.abs() < 1e-12, "{index}, h = {step}: {value:e}");
            }
        }
    }
}

/// Of order 2, with the damping: against Gauss weights of order 6.
#[test]
fn it_has_order_two() {
    let system = json!({
        "mass": [1.0, 1.0],
        "potential": "10*(hypot(q0, q1) - 1)^2 + 9.81*q1",
        "force": ["0.4*cos(2*t)", "-0.1*q0"],
        "damping": [{ "order": 0.5, "coefficient": 1.0, "along": "hypot(q0, q1)" }],
    });
    has_order_two(&system, &json!({ "position": [1.1, 0.0], "velocity": [0.0, 0.5] }));
    has_order_two(&double_pendulum(), &json!({ "position": [1.0, 1.6], "velocity": [0.5, -1.0] }));
    has_order_two(&bead(), &json!({ "position": [0.4, -0.5], "velocity": [1.0, 3.0] }));
    has_order_two(&top(), &start_of_top());
}

fn has_order_two(system: &Value, start: &Value) {
    let at = |kind: Value, steps: usize| {
        let mut scenario = json!({
            "system": system, "initial": start, "scheme": kind, "time": { "step": 1.5 / steps as f64, "steps": steps },
        });
        scenario["convolution"] = json!({ "family": "gauss" });
        let scenario = Scenario::from_value(&scenario).unwrap();
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        while !motion.is_done() {
            motion.advance().unwrap();
        }
        [motion.state().position.clone(), motion.state().momentum.clone()].concat()
    };
    let exact = at(json!({ "kind": "galerkin", "degree": 3 }), 300);
    let off = [60, 120, 240].map(|steps| {
        let found = at(json!({ "kind": "energy" }), steps);
        found.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan)
    });
    for pair in off.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((order - 2.0).abs() < 0.2, "{order}: {off:?}");
    }
}

/// A double pendulum by its angles, with dampers in both joints.
fn double_pendulum() -> Value {
    json!({
        "kinetic": "0.9*v0^2 + 0.5*0.8*0.7^2*v1^2 + 0.8*0.7*v0*v1*cos(q0 - q1)",
        "potential": "-1.8*9.81*cos(q0) - 0.8*9.81*0.7*cos(q1)",
        "damping": [
            { "order": 0.5, "coefficient": 0.2, "along": "q0" },
            { "kernel": { "form": "prony", "strengths": [0.5], "times": [0.4] }, "coefficient": 1.0, "along": "sin(q1 - q0)" },
        ],
    })
}

/// A charged bead on a surface of revolution in a magnetic field: a mass that depends on the position, and
/// terms linear in the velocity.
fn bead() -> Value {
    json!({
        "kinetic": "0.5*(v0^2 + v1^2 + (q0*v0 + q1*v1)^2) + 3*(1 + q0^2)*v1 - 2*q1*v0",
        "potential": "4.9*(q0^2 + q1^2) + q0^4",
        "force": ["0.4*cos(2*t) - 0.3*v0", "-0.1*q0*v1"],
        "damping": [{ "order": 0.6, "coefficient": 0.7, "along": "q0*q1 + q0" }],
    })
}

/// A rigid body that turns about a fixed point, by a quaternion on its sphere: a mass that is singular but
/// for the constraint.
fn top() -> Value {
    let rates = [
        "(-q1*v0 + q0*v1 + q3*v2 - q2*v3)",
        "(-q2*v0 - q3*v1 + q0*v2 + q1*v3)",
        "(-q3*v0 + q2*v1 - q1*v2 + q0*v3)",
    ];
    let turns =
        [0.6, 0.9, 0.4].iter().zip(rates).map(|(j, rate)| format!("2*{j}*{rate}^2")).collect::<Vec<_>>();
    json!({
        "kinetic": turns.join(" + "),
        "potential": "5*(q0^2 - q1^2 - q2^2 + q3^2)",
        "constraints": ["q0^2 + q1^2 + q2^2 + q3^2 - 1"],
        "damping": [{ "order": 0.5, "coefficient": 0.4, "along": "q0*q1 + q2*q3" }],
    })
}

fn start_of_top() -> Value {
    let [w, x, y, z] = [0.8_f64, 0.2, 0.4, 0.4];
    let [a, b, c] = [1.0, -2.0, 4.0].map(|rate: f64| 0.5 * rate);
    let velocity =
        [-x * a - y * b - z * c, w * a + y * c - z * b, w * b - x * c + z * a, w * c + x * b - y * a];
    json!({ "position": [w, x, y, z], "velocity": velocity })
}

/// Masses that depend on the position, terms linear in the velocity, and a mass that only a constraint makes
/// regular keep the law at steps of any length.
#[test]
fn a_mass_that_depends_on_the_position_keeps_the_law_at_any_step() {
    let mut still = bead();
    still.as_object_mut().unwrap().remove("force");
    let systems = [
        (double_pendulum(), json!({ "position": [1.0, 1.6], "velocity": [0.5, -1.0] })),
        (still, json!({ "position": [0.4, -0.5], "velocity": [1.0, 3.0] })),
        (top(), start_of_top()),
    ];
    for (index, (system, start)) in systems.iter().enumerate() {
        for step in [0.01, 0.05, 0.2] {
            let (energies, last) = energies(&scenario(system, start.clone(), (100.0 * step, 100)));
            let [rise, off] = law(&energies);
            assert!(rise < 1e-12 && off < 1e-12, "{index}, h = {step}: {rise:e} {off:e}");
            assert!(energies[100][2] > 0.0, "{:?}", energies[100]);
            if index == 2 {
                let size = last.iter().map(|q| q * q).sum::<f64>();
                assert!((size - 1.0).abs() < 1e-13, "h = {step}: {size}");
            }
        }
    }
}

/// Without dampers and forces the energy is constant, over many steps too.
#[test]
fn the_energy_of_a_mass_that_depends_on_the_position_is_constant() {
    let mut system = double_pendulum();
    system.as_object_mut().unwrap().remove("damping");
    let start = json!({ "position": [2.0, 1.6], "velocity": [0.5, -1.0] });
    let mut whole = scenario(&system, start, (200.0, 4000));
    whole.output.memory_energy = false;
    let mut motion = Motion::start(&whole, Precision::F64).unwrap();
    let first = motion.state().energy;
    let mut off = 0.0;
    while !motion.is_done() {
        motion.advance().unwrap();
        off = max_or_nan(off, (motion.state().energy - first).abs());
    }
    assert!(off < 1e-11, "{off:e}");
}

/// A constant mass in words moves as the same mass in numbers.
#[test]
fn a_constant_kinetic_energy_is_that_of_its_mass() {
    let of = |system: Value| {
        let mut system = system;
        system["potential"] = json!("25*q0^4 + 3*q1^4 - 8*q0^2 + q0*q1");
        system["damping"] = json!([{ "order": 0.3, "coefficient": 0.8, "along": "q0*q1" }]);
        let start = json!({ "position": [0.4, -0.5], "velocity": [1.0, 3.0] });
        let (energies, last) = energies(&scenario(&system, start, (10.0, 200)));
        (energies[200], last)
    };
    let (energy, position) = of(json!({ "mass": [[1.0, 0.2], [0.2, 0.7]] }));
    let (in_words, there) = of(json!({ "kinetic": "0.5*v0^2 + 0.2*v0*v1 + 0.35*v1^2" }));
    let off = position.iter().zip(&there).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan);
    assert!(off < 1e-10 && (energy[0] - in_words[0]).abs() < 1e-10, "{off:e} {energy:?} {in_words:?}");
}

/// Work of forces enters the balance to rounding: a constant force is a linear potential.
#[test]
fn forces_do_their_work() {
    let of = |potential: &str, force: Value| {
        let system = json!({
            "mass": [1.0], "potential": potential, "force": force,
            "damping": [{ "order": 0.4, "coefficient": 2.0, "along": "q0^3" }],
        });
        let start = json!({ "position": [0.2], "velocity": [1.0] });
        energies(&scenario(&system, start, (40.0, 100)))
    };
    let (within, last) = of("q0^4 - 3*q0", json!(["0"]));
    let (outside, other) = of("q0^4", json!(["3"]));
    assert!((last[0] - other[0]).abs() < 1e-12);
    let [whole, work] = [within, outside].map(|energies| energies[100].iter().sum::<f64>());
    assert!((work - 3.0 * other[0] - whole).abs() < 1e-11, "{work} {whole}");
}

#[test]
fn what_it_does_not_go_with_is_refused() {
    let of = |change: &[(&str, Value)]| {
        let mut whole = json!({
            "system": { "mass": [1.0], "potential": "q0^4" },
            "initial": { "position": [1.0] },
            "scheme": { "kind": "energy" },
            "time": { "step": 0.1, "steps": 10 },
        });
        for (pointer, value) in change {
            let (table, key) = pointer.split_once('.').unwrap();
            whole[table][key] = value.clone();
        }
        Scenario::from_value(&whole).map(|_| ()).map_err(|error| error.to_string())
    };
    assert_eq!(of(&[]), Ok(()));
    let family = of(&[("convolution.family", json!("bdf"))]).unwrap_err();
    assert!(family.contains("convolution.family") && family.contains("midpoint rule"), "{family}");
    let degree = of(&[("scheme.degree", json!(2))]).unwrap_err();
    assert!(degree.contains("degree"), "{degree}");
}

/// Where a step hardly leads anywhere, differences of heights and constraints are rounding.
#[test]
fn a_pendulum_at_rest_takes_the_smallest_pushes() {
    for size in [1e-9, 1e-7, 2e-5, 3e-4] {
        let system = json!({
            "mass": [1.0, 1.0], "potential": "9.81*q1", "constraints": ["q0^2 + q1^2 - 1"],
            "force": [format!("{size:e}*cos(t)"), "0"],
            "damping": [{ "order": 0.6, "coefficient": 0.4, "along": "atan2(q0, -q1)" }],
        });
        let hanging = json!({ "position": [0.0, -1.0] });
        let (_, place) = energies(&scenario(&system, hanging, (5.0, 100)));
        // The same of small motions, by the angle.
        let system = json!({
            "mass": [1.0], "stiffness": [[9.81]], "force": [format!("{size:e}*cos(t)")],
            "damping": [{ "order": 0.6, "coefficient": 0.4, "along": "q0" }],
        });
        let (_, angle) = energies(&scenario(&system, json!({ "position": [0.0] }), (5.0, 100)));
        let off = (place[0] - angle[0]).abs();
        assert!(off < 1e-3 * angle[0].abs() + 1e-8, "{size}: {} {}", place[0], angle[0]);
    }
}

/// c sign(v)|v|^γ, γ < 1, whose slope is infinite at v = 0: for a quadratic potential the scheme is the
/// midpoint rule, and so is the step of Gauss's weights at one node, beside a damper of no force; at two
/// nodes it is Galerkin's of degree 2.
#[test]
fn dampers_whose_slope_is_infinite_at_rest_are_those_of_the_midpoint_rule() {
    for (gamma, c) in [(0.05, 0.5), (0.1, 0.5), (0.1, 20.0), (0.3, 2.0), (0.5, 0.2), (0.7, 10.0)] {
        for step in [0.02, 0.1] {
            let forces: Vec<String> = ["1.7", "2.3"]
                .iter()
                .enumerate()
                .map(|(i, rate)| format!("sin({rate}*t) - {c:?}*sign(v{i})*abs(v{i})^{gamma}"))
                .collect();
            let whole = |scheme: Value, convolution: Option<Value>| {
                let mut keys = json!({
                    "system": {
                        "mass": [1.0, 0.5], "stiffness": [[5.0, -1.0], [-1.0, 2.0]], "force": forces,
                        "damping": [{ "order": 0.5, "coefficient": [1e-14, 1e-14] }],
                    },
                    "initial": { "position": [1.0, 0.2], "velocity": [0.3, -0.1] },
                    "scheme": scheme,
                    "time": { "step": step, "end": 4.0 },
                });
                if let Some(convolution) = convolution {
                    keys["convolution"] = convolution;
                }
                let scenario = Scenario::from_value(&keys).unwrap();
                let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
                while !motion.is_done() {
                    motion.advance().unwrap();
                }
                motion.state().position.clone()
            };
            let gauss = || Some(json!({ "family": "gauss" }));
            let midpoint = whole(json!({ "kind": "low-order" }), None);
            let two = |convolution| whole(json!({ "kind": "galerkin", "degree": 2 }), convolution);
            let one = whole(json!({ "kind": "galerkin", "degree": 1 }), gauss());
            let energy = whole(json!({ "kind": "energy" }), gauss());
            for (found, known) in [(one, midpoint.clone()), (energy, midpoint), (two(gauss()), two(None))] {
                for (found, known) in found.iter().zip(&known) {
                    assert!((found - known).abs() < 1e-10, "{gamma}, {c}, {step}: {found} {known}");
                }
            }
        }
    }
}
