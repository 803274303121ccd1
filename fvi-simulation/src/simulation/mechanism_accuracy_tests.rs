//! Errors of mechanisms at given steps: fifteen systems, the same motion by angles and by places, fractional
//! and Prony dampers, Gauss methods of order 4 and 6.

use super::motion::Motion;
use crate::simulation::Precision;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::scenario::Scenario;
use serde_json::{Value, json};

/// A motion: system, start, end and steps; what is compared of position and momentum.
struct Case {
    name: &'static str,
    system: Value,
    start: Value,
    end: f64,
    steps: usize,
    shown: fn(&[f64], &[f64]) -> [Vec<f64>; 2],
    /// Errors of both by two and by three stages, as an implementation of the equations in NumPy has them.
    errors: [[f64; 2]; 2],
}

fn as_they_are(position: &[f64], momentum: &[f64]) -> [Vec<f64>; 2] {
    [position.to_vec(), momentum.to_vec()]
}

fn run(case: &Case, degree: usize, steps: usize) -> [Vec<f64>; 2] {
    let scenario = Scenario::from_value(&json!({
        "system": case.system,
        "initial": case.start,
        "scheme": { "kind": "galerkin", "degree": degree },
        "time": { "step": case.end / steps as f64, "steps": steps },
    }))
    .unwrap();
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    while !motion.is_done() {
        motion.advance().unwrap();
    }
    (case.shown)(&motion.state().position, &motion.state().momentum)
}

fn distance(one: &[f64], other: &[f64]) -> f64 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).fold(0.0, |most, (a, b)| max_or_nan(most, (a - b).abs()))
}

/// The errors are within a factor of two of those that the equations of the step have by themselves; the
/// reference is the same motion by four stages at a quarter of the step.
fn holds(cases: &[Case]) {
    for case in cases {
        let exact = run(case, 4, 4 * case.steps);
        for (degree, [position, momentum]) in [2, 3].into_iter().zip(case.errors) {
            let found = run(case, degree, case.steps);
            let off = [distance(&found[0], &exact[0]), distance(&found[1], &exact[1])];
            let name = case.name;
            // Numbers are given with two digits.
            assert!(off[0] < 2.1 * position, "{name}, {degree} stages: q {:e}, not {position:e}", off[0]);
            assert!(off[1] < 2.1 * momentum, "{name}, {degree} stages: p {:e}, not {momentum:e}", off[1]);
        }
    }
}

fn power(order: f64, coefficient: f64, along: &str) -> Value {
    json!({ "order": order, "coefficient": coefficient, "along": along })
}

fn prony(strengths: &[f64], times: &[f64], along: &str) -> Value {
    let kernel = json!({ "form": "prony", "strengths": strengths, "times": times });
    json!({ "kernel": kernel, "coefficient": 1.0, "along": along })
}

#[test]
fn a_mass_on_a_spring_and_a_pendulum() {
    let spring = Case {
        name: "spring pendulum",
        system: json!({
            "mass": [1.0, 1.0],
            "potential": "10*(sqrt(q0^2 + q1^2) - 1)^2 + 9.81*q1",
            "damping": [power(0.5, 3.0, "hypot(q0, q1)")],
        }),
        start: json!({ "position": [1.1, 0.2], "velocity": [0.3, -0.5] }),
        end: 2.0,
        steps: 80,
        shown: as_they_are,
        errors: [[4.8e-7, 1.6e-6], [8.2e-11, 6.4e-10]],
    };
    let angle = Case {
        name: "pendulum by its angle",
        system: json!({
            "kinetic": "0.5*v0^2", "potential": "-9.81*cos(q0)", "damping": [power(0.5, 0.6, "q0")],
        }),
        start: json!({ "position": [2.0], "velocity": [1.0] }),
        end: 2.0,
        steps: 60,
        shown: as_they_are,
        errors: [[4.4e-7, 1.5e-6], [1.7e-10, 3.3e-10]],
    };
    let (sin, cos) = 2.0_f64.sin_cos();
    let place = Case {
        name: "pendulum by its place",
        system: json!({
            "mass": [1.0, 1.0],
            "potential": "9.81*q1",
            "constraints": ["(q0^2 + q1^2 - 1)/2"],
            "damping": [power(0.5, 0.6, "atan2(q0, -q1)")],
        }),
        start: json!({ "position": [sin, -cos], "velocity": [cos, sin] }),
        end: 2.0,
        steps: 60,
        shown: as_they_are,
        errors: [[5.5e-6, 2.2e-5], [2.7e-9, 1.2e-8]],
    };
    holds(&[spring, angle, place]);
}

/// A double pendulum, masses 1 and 0.8, lengths 1 and 0.7.
#[test]
fn a_double_pendulum_in_two_descriptions() {
    let (first, second) = ("atan2(q0, -q1)", "atan2(q2 - q0, q1 - q3)");
    let between = format!("{second} - {first}");
    let kinds = |along: [&str; 2]| {
        [
            json!([prony(&[1.5, 0.6], &[0.2, 1.0], along[0]), prony(&[0.8], &[0.4], along[1])]),
            json!([power(0.5, 1.2, along[0]), power(0.7, 0.5, along[1])]),
        ]
    };
    let ([a, b], [u, w]) = ([1.0_f64, 1.6_f64], [0.5, -1.0]);
    let (x, y) = (a.sin(), -a.cos());
    let position = [x, y, x + 0.7 * b.sin(), y - 0.7 * b.cos()];
    let (right, up) = (a.cos() * u, a.sin() * u);
    let velocity = [right, up, right + 0.7 * b.cos() * w, up + 0.7 * b.sin() * w];
    let by_angles = [
        ("angles, Prony", [[1.6e-7, 4.1e-7], [1.7e-11, 3.3e-10]]),
        ("angles, fractional", [[2.9e-7, 4.9e-7], [7.0e-11, 5.3e-10]]),
    ];
    let by_places = [
        ("places, Prony", [[1.3e-7, 7.5e-7], [2.2e-11, 1.7e-10]]),
        ("places, fractional", [[1.8e-7, 4.9e-7], [5.2e-11, 4.3e-10]]),
    ];
    let angles = kinds(["q0", "q1 - q0"]).into_iter().zip(by_angles).map(|(damping, (name, errors))| Case {
        name,
        system: json!({
            "kinetic": "0.9*v0^2 + 0.5*0.8*0.7^2*v1^2 + 0.8*0.7*v0*v1*cos(q0 - q1)",
            "potential": "-1.8*9.81*cos(q0) - 0.8*9.81*0.7*cos(q1)",
            "damping": damping,
        }),
        start: json!({ "position": [a, b], "velocity": [u, w] }),
        end: 1.5,
        steps: 60,
        shown: as_they_are,
        errors,
    });
    let places = kinds([first, &between]).into_iter().zip(by_places).map(|(damping, (name, errors))| Case {
        name,
        system: json!({
            "mass": [1.0, 1.0, 0.8, 0.8],
            "potential": "9.81*q1 + 0.8*9.81*q3",
            "constraints": ["(q0^2 + q1^2 - 1)/2", "((q2 - q0)^2 + (q3 - q1)^2 - 0.49)/2"],
            "damping": damping,
        }),
        start: json!({ "position": position, "velocity": velocity }),
        end: 1.5,
        steps: 60,
        shown: as_they_are,
        errors,
    });
    holds(&angles.chain(places).collect::<Vec<_>>());
}

/// A slider-crank that turns through the cut of its angle, and a four-bar linkage with a damper along a
/// diagonal.
#[test]
fn closed_linkages() {
    let (a, w, r, l) = (0.4_f64, 9.0_f64, 0.5_f64, 1.2_f64);
    let side = (l * l - r * r * a.sin() * a.sin()).sqrt();
    let position = [r * a.cos(), r * a.sin(), r * a.cos() + side];
    let velocity = [-r * a.sin() * w, r * a.cos() * w, (-r * a.sin() - r * r * a.sin() * a.cos() / side) * w];
    let of_crank = [
        (
            "slider-crank, Prony",
            json!([prony(&[0.4], &[0.3], "atan2(q1, q0)"), prony(&[1.0], &[0.5], "q2")]),
            [[1.8e-4, 1.3e-3], [2.1e-7, 1.5e-6]],
        ),
        (
            "slider-crank, fractional",
            json!([power(0.5, 0.3, "atan2(q1, q0)"), power(0.6, 0.8, "q2")]),
            [[9.9e-5, 7.4e-4], [6.8e-8, 5.1e-7]],
        ),
    ];
    let cranks = of_crank.into_iter().map(|(name, damping, errors)| Case {
        name,
        system: json!({
            "mass": [[1.2, 0.0, 0.1], [0.0, 1.2, 0.0], [0.1, 0.0, 0.9]],
            "potential": "9.81*1.3*q1",
            "constraints": ["(q0^2 + q1^2 - 0.25)/2", "((q2 - q0)^2 + q1^2 - 1.44)/2"],
            "damping": damping,
        }),
        start: json!({ "position": position, "velocity": velocity }),
        end: 1.5,
        steps: 60,
        shown: as_they_are,
        errors,
    });
    let (position, velocity) = start_of_four_bar();
    let of_bars = [
        (
            "four-bar, Prony",
            prony(&[3.0, 1.0], &[0.2, 1.0], "hypot(q2, q3)"),
            [[3.7e-7, 2.0e-6], [1.5e-10, 8.3e-10]],
        ),
        ("four-bar, fractional", power(0.5, 2.0, "hypot(q2, q3)"), [[2.5e-7, 2.4e-6], [8.9e-11, 8.7e-10]]),
    ];
    let bars = of_bars.into_iter().map(|(name, damper, errors)| Case {
        name,
        system: json!({
            "mass": [[1.4, 0.0, 0.2, 0.0], [0.0, 1.4, 0.0, 0.2], [0.2, 0.0, 1.2, 0.0], [0.0, 0.2, 0.0, 1.2]],
            "potential": "9.81*(1.2*q1 + q3)",
            "constraints": [
                "(q0^2 + q1^2 - 0.36)/2",
                "((q2 - q0)^2 + (q3 - q1)^2 - 1.96)/2",
                "((q2 - 1.5)^2 + q3^2 - 1)/2",
            ],
            "damping": [damper],
        }),
        start: json!({ "position": position, "velocity": velocity }),
        end: 1.5,
        steps: 240,
        shown: as_they_are,
        errors,
    });
    holds(&cranks.chain(bars).collect::<Vec<_>>());
}

/// Bars of 0.6, 1.4 and 1 between bearings 1.5 apart: the first at the angle 1.2 turns at the rate 6.
fn start_of_four_bar() -> ([f64; 4], [f64; 4]) {
    let (angle, rate) = (1.2_f64, 6.0);
    let b = [0.6 * angle.cos(), 0.6 * angle.sin()];
    // Where the circles about both ends meet, the upper point.
    let to = [1.5 - b[0], -b[1]];
    let apart = to[0].hypot(to[1]);
    let along = (1.96 - 1.0 + apart * apart) / (2.0 * apart);
    let aside = (1.96 - along * along).sqrt();
    let unit = [to[0] / apart, to[1] / apart];
    let c = [b[0] + along * unit[0] - aside * unit[1], b[1] + along * unit[1] + aside * unit[0]];
    let of_b = [-0.6 * rate * angle.sin(), 0.6 * rate * angle.cos()];
    // (c − b)·(ċ − ḃ) = 0 and (c − d)·ċ = 0.
    let (rod, rocker) = ([c[0] - b[0], c[1] - b[1]], [c[0] - 1.5, c[1]]);
    let moved = rod[0] * of_b[0] + rod[1] * of_b[1];
    let whole = rod[0] * rocker[1] - rod[1] * rocker[0];
    let of_c = [moved * rocker[1] / whole, -moved * rocker[0] / whole];
    ([b[0], b[1], c[0], c[1]], [of_b[0], of_b[1], of_c[0], of_c[1]])
}

const INERTIA: [f64; 3] = [0.5, 0.6, 0.3];

/// The axes of a body, one after another, and its angular velocity for Ω along them turned into space.
fn axes(e: &[f64]) -> [[f64; 3]; 3] {
    let [a, b, c, d] = [e[0], e[1], e[2], e[3]];
    [
        [a * a + b * b - c * c - d * d, 2.0 * (b * c + a * d), 2.0 * (b * d - a * c)],
        [2.0 * (b * c - a * d), a * a - b * b + c * c - d * d, 2.0 * (c * d + a * b)],
        [2.0 * (b * d + a * c), 2.0 * (c * d - a * b), a * a - b * b - c * c + d * d],
    ]
}

fn in_space(axes: [[f64; 3]; 3], body: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| (0..3).map(|i| axes[i][k] * body[i]).sum())
}

fn cross(a: &[f64], b: &[f64]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Axes and angular momentum: JΩ = ½ E p for p = ∂T/∂v, with the rows of E below.
fn of_quaternion(e: &[f64], p: &[f64]) -> [Vec<f64>; 2] {
    let [a, b, c, d] = [e[0], e[1], e[2], e[3]];
    let rows = [[-b, a, d, -c], [-c, -d, a, b], [-d, c, -b, a]];
    let turning = rows.map(|row| 0.5 * row.iter().zip(p).map(|(e, p)| e * p).sum::<f64>());
    [axes(e).concat(), in_space(axes(e), turning).to_vec()]
}

fn of_directors(d: &[f64], p: &[f64]) -> [Vec<f64>; 2] {
    let parts = [0, 3, 6].map(|i| cross(&d[i..i + 3], &p[i..i + 3]));
    [d.to_vec(), [0, 1, 2].map(|k| parts.iter().map(|part| part[k]).sum()).to_vec()]
}

/// Quaternion, its rate, and Ω: Euler's angles 0.3, 1.1, 0.5 with the rates 1.5, −0.4, 3.
fn start_of_body() -> ([f64; 4], [f64; 4], [f64; 3]) {
    let [a, b, c] = [0.15_f64, 0.55, 0.25];
    let e =
        [b.cos() * (a + c).cos(), b.sin() * (a - c).cos(), b.sin() * (a - c).sin(), b.cos() * (a + c).sin()];
    let (tilt, spin) = (1.1_f64, 0.5_f64);
    let turning = [
        1.5 * tilt.sin() * spin.sin() - 0.4 * spin.cos(),
        1.5 * tilt.sin() * spin.cos() + 0.4 * spin.sin(),
        1.5 * tilt.cos() + 3.0,
    ];
    let [o0, o1, o2] = turning;
    let rate = [
        -e[1] * o0 - e[2] * o1 - e[3] * o2,
        e[0] * o0 - e[3] * o1 + e[2] * o2,
        e[3] * o0 + e[0] * o1 - e[1] * o2,
        -e[2] * o0 + e[1] * o1 + e[0] * o2,
    ]
    .map(|rate| 0.5 * rate);
    (e, rate, turning)
}

/// A body that hangs on a point, with a strut to the ground and a torsion damper on its twist: by a
/// quaternion with one constraint and by nine directors with six.
#[test]
fn a_rigid_body_in_two_descriptions() {
    let (e, rate, turning) = start_of_body();
    let directors = axes(&e);
    let spun = in_space(directors, turning);
    let moved = directors.map(|axis| cross(&spun, &axis));
    let rates = [
        "2*(q0*v1 - q1*v0 + q3*v2 - q2*v3)",
        "2*(q0*v2 - q2*v0 + q1*v3 - q3*v1)",
        "2*(q0*v3 - q3*v0 + q2*v1 - q1*v2)",
    ];
    let turns = INERTIA.iter().zip(rates).map(|(j, rate)| format!("0.5*{j}*({rate})^2"));
    let kinetic = turns.collect::<Vec<_>>().join(" + ") + " + 0.25*(2*(q0*v0 + q1*v1 + q2*v2 + q3*v3))^2";
    let quaternion = json!({
        "kinetic": kinetic,
        "potential": "-3*(q0^2 - q1^2 - q2^2 + q3^2)",
        "constraints": ["(q0^2 + q1^2 + q2^2 + q3^2 - 1)/2"],
    });
    let size = INERTIA.iter().sum::<f64>();
    let masses: Vec<f64> = INERTIA.iter().flat_map(|j| [0.5 * (size - 2.0 * j); 3]).collect();
    let product = |i: usize, j: usize| {
        let terms = [0, 1, 2].map(|k| format!("q{}*q{}", 3 * i + k, 3 * j + k));
        if i == j { format!("({} - 1)/2", terms.join(" + ")) } else { terms.join(" + ") }
    };
    let constraints: Vec<String> =
        [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].into_iter().map(|(i, j)| product(i, j)).collect();
    let nine = json!({ "mass": masses, "potential": "-3*q8", "constraints": constraints });
    let strut = |x: [&str; 3]| format!("sqrt(({} - 1.5)^2 + ({})^2 + ({} - 0.2)^2)", x[0], x[1], x[2]);
    let by_quaternion = [
        strut([
            "0.3*(q0^2 + q1^2 - q2^2 - q3^2) + 2*(q1*q3 + q0*q2)",
            "0.6*(q1*q2 + q0*q3) + 2*(q2*q3 - q0*q1)",
            "0.6*(q1*q3 - q0*q2) + q0^2 - q1^2 - q2^2 + q3^2",
        ]),
        "2*atan2(q3, q0)".to_owned(),
    ];
    let by_directors =
        [strut(["0.3*q0 + q6", "0.3*q1 + q7", "0.3*q2 + q8"]), "atan2(q1 - q3, q0 + q4)".to_owned()];
    let kinds = |along: &[String; 2]| {
        [
            json!([prony(&[2.0], &[0.4], &along[0]), prony(&[0.5], &[0.3], &along[1])]),
            json!([power(0.5, 1.0, &along[0]), power(0.6, 0.3, &along[1])]),
        ]
    };
    let case = |name, system: &Value, damping: Value, start: Value, is_quaternion: bool, errors| {
        let mut system = system.clone();
        system["damping"] = damping;
        let shown = if is_quaternion { of_quaternion } else { of_directors };
        Case { name, system, start, end: 1.5, steps: 60, shown, errors }
    };
    let start = json!({ "position": e, "velocity": rate });
    let placed = json!({ "position": directors.concat(), "velocity": moved.concat() });
    let [pronies, powers] = kinds(&by_quaternion);
    let [pronies_of_nine, powers_of_nine] = kinds(&by_directors);
    holds(&[
        case(
            "quaternion, Prony",
            &quaternion,
            pronies,
            start.clone(),
            true,
            [[1.6e-7, 1.7e-7], [1.7e-11, 2.0e-11]],
        ),
        case(
            "quaternion, fractional",
            &quaternion,
            powers,
            start,
            true,
            [[1.2e-7, 9.4e-8], [6.3e-11, 2.5e-11]],
        ),
        case(
            "directors, Prony",
            &nine,
            pronies_of_nine,
            placed.clone(),
            false,
            [[1.6e-7, 3.4e-7], [2.9e-11, 5.3e-11]],
        ),
        case(
            "directors, fractional",
            &nine,
            powers_of_nine,
            placed,
            false,
            [[2.0e-7, 2.7e-7], [9.6e-11, 6.3e-11]],
        ),
    ]);
}
