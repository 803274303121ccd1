//! Mechanisms against motions in other coordinates, other solvers, and their laws.

use super::motion::Motion;
use super::response::Linearised;
use crate::simulation::{Precision, Simulation};
use fvi_fft::sums::max_or_nan;
use fvi_scenario::scenario::Scenario;
use nalgebra::Complex;
use serde_json::{Value, json};

/// The scenario of a system from a start, on `steps` steps up to `end` by the Galerkin scheme of a degree.
fn scenario(system: &Value, initial: Value, degree: usize, (end, steps): (f64, usize)) -> Scenario {
    Scenario::from_value(&json!({
        "system": system,
        "initial": initial,
        "scheme": { "kind": "galerkin", "degree": degree },
        "convolution": { "family": "gauss" },
        "time": { "step": end / steps as f64, "steps": steps },
        "output": { "memory_energy": true },
    }))
    .unwrap()
}

/// Position and momentum at the end.
fn end_of(scenario: &Scenario, precision: Precision) -> [Vec<f64>; 2] {
    let mut motion = Motion::start(scenario, precision).unwrap();
    while !motion.is_done() {
        motion.advance().unwrap();
    }
    [motion.state().position.clone(), motion.state().momentum.clone()]
}

fn distance(one: &[f64], other: &[f64]) -> f64 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).fold(0.0, |most, (a, b)| max_or_nan(most, (a - b).abs()))
}

const JOINTS: [&str; 2] = ["fractional", "prony"];

/// Two joints' dampers along two angles.
fn dampers(kind: &str, along: [&str; 2]) -> Value {
    let prony = |strengths: &[f64], times: &[f64], along: &str| {
        let kernel = json!({ "form": "prony", "strengths": strengths, "times": times });
        json!({ "kernel": kernel, "coefficient": 1.0, "along": along })
    };
    match kind {
        "fractional" => json!([
            { "order": 0.5, "coefficient": 1.2, "along": along[0] },
            { "order": 0.7, "coefficient": 0.5, "along": along[1] },
        ]),
        _ => json!([prony(&[1.5, 0.6], &[0.2, 1.0], along[0]), prony(&[0.8], &[0.4], along[1])]),
    }
}

/// A double pendulum by its angles; masses 1 and 0.8, lengths 1 and 0.7.
fn by_angles(kind: &str) -> Value {
    json!({
        "kinetic": "0.9*v0^2 + 0.5*0.8*0.7^2*v1^2 + 0.8*0.7*v0*v1*cos(q0 - q1)",
        "potential": "-1.8*9.81*cos(q0) - 0.8*9.81*0.7*cos(q1)",
        "damping": dampers(kind, ["q0", "q1 - q0"]),
    })
}

/// The same by the places of its masses.
fn by_places(kind: &str) -> Value {
    let (first, second) = ("atan2(q0, -q1)", "atan2(q2 - q0, q1 - q3)");
    let between = format!("{second} - {first}");
    json!({
        "mass": [1.0, 1.0, 0.8, 0.8],
        "potential": "9.81*q1 + 0.8*9.81*q3",
        "constraints": ["q0^2 + q1^2 - 1", "hypot(q2 - q0, q3 - q1) - 0.7"],
        "damping": dampers(kind, [first, &between]),
    })
}

fn places([angles, rates]: [[f64; 2]; 2]) -> [Vec<f64>; 2] {
    let [a, b] = angles;
    let [u, w] = rates;
    let (x, y) = (a.sin(), -a.cos());
    let (right, up) = (a.cos() * u, a.sin() * u);
    [
        vec![x, y, x + 0.7 * b.sin(), y - 0.7 * b.cos()],
        vec![right, up, right + 0.7 * b.cos() * w, up + 0.7 * b.sin() * w],
    ]
}

const ANGLES: [[f64; 2]; 2] = [[1.0, 1.6], [0.5, -1.0]];
const END: f64 = 1.5;

/// Angles and their momenta at the end, by SciPy's Radau and DOP853 on the relaxations of the kernels, to
/// 10⁻¹¹.
fn reference(kind: &str) -> [[f64; 2]; 2] {
    match kind {
        "fractional" => REFERENCES[0],
        _ => REFERENCES[1],
    }
}

const REFERENCES: [[[f64; 2]; 2]; 2] = [
    [[-0.665_673_560_342_3, -1.228_283_275_486_7], [3.103_526_684_593_0, 1.181_596_539_791_0]],
    [[-0.736_562_903_616_8, -1.432_714_031_014_4], [2.967_366_395_443_7, 0.998_577_031_052_4]],
];

#[test]
fn a_double_pendulum_has_the_order_of_its_degree_by_angles_and_by_places() {
    for kind in JOINTS {
        let [angles, momenta] = reference(kind);
        let exact = places([angles, [0.0; 2]])[0].clone();
        for (degree, steps) in [(1, 240), (2, 60), (3, 30)] {
            let initial = json!({ "position": ANGLES[0], "velocity": ANGLES[1] });
            let errors = |steps: usize| {
                let scenario = scenario(&by_angles(kind), initial.clone(), degree, (END, steps));
                let [q, p] = end_of(&scenario, Precision::F64);
                [distance(&q, &angles), distance(&p, &momenta)]
            };
            let (coarse, fine) = (errors(steps), errors(2 * steps));
            for (name, coarse, fine) in [("q", coarse[0], fine[0]), ("p", coarse[1], fine[1])] {
                let order = (coarse / fine).log2();
                let expected = 2.0 * degree as f64;
                assert!(
                    (order - expected).abs() < 0.45,
                    "{kind}, degree {degree}, {name}: {order}, {fine:e}"
                );
            }
            let [position, velocity] = places(ANGLES);
            let initial = json!({ "position": position, "velocity": velocity });
            let by_places = scenario(&by_places(kind), initial, degree, (END, 2 * steps));
            let [q, _] = end_of(&by_places, Precision::F64);
            let off = distance(&q, &exact);
            assert!(off < 40.0 * fine[0] + 1e-10, "{kind}, degree {degree}: {off:e} and {fine:?}");
        }
    }
}

#[test]
fn a_mass_on_a_spring_has_the_references_motion_for_every_order_of_damping() {
    // By SciPy's Radau on 160 relaxations, 10⁻¹¹; for 1.5 by discontinuous Galerkin steps in time, 10⁻⁹.
    let references = [
        (0.2, [-1.019_816_260_18, -0.232_147_696_94], [0.183_076_439_9, -2.347_235_836_9]),
        (0.5, [-0.948_850_194_03, -0.645_909_192_35], [0.576_879_358_8, -2.684_366_192_6]),
        (0.8, [-0.730_640_515_89, -0.988_985_524_63], [1.283_940_342_7, -2.549_365_893_6]),
        (1.5, [-0.705_330_483_0, -0.424_001_089_5], [0.042_043_684_7, -1.984_561_999_6]),
    ];
    for (order, position, momentum) in references {
        let system = json!({
            "mass": [1.0, 1.0],
            "potential": "10*(sqrt(q0^2 + q1^2) - 1)^2 + 9.81*q1",
            "damping": [{ "order": order, "coefficient": if order < 1.0 { 3.0 } else { 0.5 }, "along": "hypot(q0, q1)" }],
        });
        let initial = json!({ "position": [1.1, 0.2], "velocity": [0.3, -0.5] });
        let [q, p] = end_of(&scenario(&system, initial, 3, (2.0, 160)), Precision::F64);
        let off = [distance(&q, &position), distance(&p, &momentum)];
        // Momenta of orders above 1 have a lower order.
        let most = if order < 1.0 { [2e-9, 2e-8] } else { [1e-7, 1e-5] };
        assert!(off[0] < most[0] && off[1] < most[1], "order {order}: {off:?}");
    }
}

#[test]
fn constraints_hold_to_rounding_and_multipliers_are_the_forces_of_the_rods() {
    let [position, velocity] = places(ANGLES);
    let initial = json!({ "position": position, "velocity": velocity });
    let scenario = scenario(&by_places("fractional"), initial, 2, (6.0, 600));
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    let mut last: Option<Vec<f64>> = None;
    while !motion.is_done() {
        motion.advance().unwrap();
        let (q, columns) = (&motion.state().position, &motion.state().columns);
        let first = q[0] * q[0] + q[1] * q[1] - 1.0;
        let second = (q[2] - q[0]).hypot(q[3] - q[1]) - 0.7;
        assert!(first.abs() < 1e-13 && second.abs() < 1e-13, "{first:e}, {second:e}");
        // λ of the two constraints, then the energies of the memories.
        assert!(columns.len() == 4 && columns.iter().all(|number| number.is_finite()));
        last = Some(columns.clone());
    }
    assert!(last.unwrap()[3] > 0.0);
}

#[test]
fn a_slider_crank_turns_through_the_cut_of_its_angle() {
    // By the angle of the crank alone, and by the places of pin and slider; the damper of the crank acts
    // along atan2, which jumps by 2π at each turn.
    let (r, l) = (0.5_f64, 1.2_f64);
    let root = "sqrt(1.44 - 0.25*sin(q0)^2)";
    let slide = format!("-0.5*sin(q0)*v0*(1 + 0.5*cos(q0)/{root})");
    let kinetic = format!(
        "0.5*0.25*v0^2 + 0.35*({slide})^2 + 0.1*(0.25*v0^2 + (-0.5*sin(q0)*v0)*({slide}) + ({slide})^2)"
    );
    let angle = json!({
        "kinetic": kinetic,
        "potential": "9.81*1.3*0.5*sin(q0)",
        "damping": [
            { "order": 0.5, "coefficient": 0.3, "along": "q0" },
            { "order": 0.6, "coefficient": 0.8, "along": format!("0.5*cos(q0) + {root}") },
        ],
    });
    let place = json!({
        "mass": [[1.2, 0.0, 0.1], [0.0, 1.2, 0.0], [0.1, 0.0, 0.9]],
        "potential": "9.81*1.3*q1",
        "constraints": ["q0^2 + q1^2 - 0.25", "(q2 - q0)^2 + q1^2 - 1.44"],
        "damping": [
            { "order": 0.5, "coefficient": 0.3, "along": "atan2(q1, q0)" },
            { "order": 0.6, "coefficient": 0.8, "along": "q2" },
        ],
    });
    let (a, w) = (0.4_f64, 9.0_f64);
    let side = (l * l - r * r * a.sin() * a.sin()).sqrt();
    let position = [r * a.cos(), r * a.sin(), r * a.cos() + side];
    let velocity = [-r * a.sin() * w, r * a.cos() * w, (-r * a.sin() - r * r * a.sin() * a.cos() / side) * w];
    let grid = (1.5, 240);
    let by_angle = scenario(&angle, json!({ "position": [a], "velocity": [w] }), 3, grid);
    let by_place = scenario(&place, json!({ "position": position, "velocity": velocity }), 3, grid);
    let [q, _] = end_of(&by_angle, Precision::F64);
    let [x, _] = end_of(&by_place, Precision::F64);
    assert!(q[0] > 2.0 * std::f64::consts::PI, "the crank has turned by {}", q[0]);
    let side = (l * l - r * r * q[0].sin().powi(2)).sqrt();
    let off = distance(&x, &[r * q[0].cos(), r * q[0].sin(), r * q[0].cos() + side]);
    assert!(off < 1e-8, "{off:e}");
}

#[test]
fn energies_make_up_the_start_where_the_potential_is_quadratic() {
    let system = json!({
        "mass": [1.0, 2.0],
        "potential": "3*q0^2 + q0*q1 + 2*q1^2",
        "damping": [
            { "order": 0.5, "coefficient": [[0.7, 0.2], [0.2, 0.5]], "along": ["hypot(q0 + 2, q1)", "q0*q1 + q1"] },
            { "order": 1.4, "coefficient": 0.3, "along": "sin(q0) + q1" },
            { "kernel": { "form": "maxwell", "order": 0.6, "time": 0.4 }, "coefficient": [0.5, 0.0] },
        ],
    });
    let initial = json!({ "position": [0.6, -0.4], "velocity": [0.3, 1.0] });
    for (degree, steps) in [(1, 300), (2, 100), (4, 30)] {
        let scenario = scenario(&system, initial.clone(), degree, (15.0, steps));
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        let first = motion.state().energy;
        while !motion.is_done() {
            motion.advance().unwrap();
            let [stored, dissipated] = motion.state().columns[..] else { panic!("two columns") };
            let sum = motion.state().energy + stored + dissipated;
            assert!((sum - first).abs() < 1e-12 * first, "degree {degree}: {sum} of {first}");
            assert!(stored >= 0.0, "degree {degree}: {stored}");
        }
        let dissipated = motion.state().columns[1];
        assert!(dissipated > 0.3 * first, "degree {degree}: {dissipated} of {first}");
    }
}

#[test]
fn dampers_of_coordinates_move_them_as_other_schemes_do() {
    let pendulum = json!({
        "mass": [1.0],
        "potential": "-9.81*cos(q0)",
        "damping": [{ "order": 0.5, "coefficient": [0.6] }],
    });
    let initial = json!({ "position": [2.0], "velocity": [1.0] });
    let radau = Scenario::from_value(&json!({
        "system": pendulum, "initial": initial, "time": { "step": 2.0 / 4000.0, "steps": 4000 },
        "scheme": { "kind": "collocation" },
    }))
    .unwrap();
    let exact = end_of(&radau, Precision::F64);
    // Orders of degree 1, 2 and 3, and errors a hundred times below those of BDF.
    for (degree, steps, most) in [(1, 480, 2e-4), (2, 60, 2e-6), (3, 60, 1e-9)] {
        let run = scenario(&pendulum, initial.clone(), degree, (2.0, steps));
        let [q, p] = end_of(&run, Precision::F64);
        let off = [distance(&q, &exact[0]), distance(&p, &exact[1])];
        assert!(off[0] < most && off[1] < 4.0 * most, "degree {degree}: {off:?}");
    }
    let single = scenario(&pendulum, initial, 2, (2.0, 60));
    let off = distance(&end_of(&single, Precision::F32)[0], &exact[0]);
    assert!(off < 2e-5, "single precision: {off:e}");
}

#[test]
fn steps_of_any_length_make_the_same_motion() {
    let system = by_angles("fractional");
    let initial = json!({ "position": ANGLES[0], "velocity": ANGLES[1] });
    let graded = Scenario::from_value(&json!({
        "system": system, "initial": initial, "scheme": { "kind": "galerkin", "degree": 3 },
        "time": { "grid": "graded", "end": END, "steps": 120, "exponent": 2.0 },
    }))
    .unwrap();
    let [q, p] = end_of(&graded, Precision::F64);
    let [angles, momenta] = reference("fractional");
    let off = [distance(&q, &angles), distance(&p, &momenta)];
    assert!(off[0] < 1e-8 && off[1] < 1e-7, "{off:?}");
}

#[test]
fn what_a_mechanism_cannot_do_is_refused_at_its_key() {
    let start = json!({ "position": [1.0, 0.0], "velocity": [0.0, 1.0] });
    let base = json!({ "mass": [1.0, 1.0], "potential": "q1", "constraints": ["q0^2 + q1^2 - 1"] });
    let refused = |change: &[(&str, Value)], initial: &Value| {
        let mut system = base.clone();
        for (key, value) in change {
            system[*key] = value.clone();
        }
        if change.iter().any(|(key, _)| *key == "kinetic") {
            system.as_object_mut().unwrap().remove("mass");
        }
        let scenario = Scenario::from_value(&json!({
            "system": system, "initial": initial, "time": { "step": 0.1, "steps": 3 },
        }));
        let error = scenario.and_then(|scenario| Simulation::new(&scenario, Precision::F64).map(drop));
        let error = error.unwrap_err();
        (error.key().to_owned(), format!("{error}; {:?}", error.problem().allowed()))
    };
    /// What is changed of the system, the start, the key of the error, and what it says.
    type Case<'a> = (&'a [(&'a str, Value)], Value, &'a str, &'a str);
    let cases: [Case<'_>; 11] = [
        (&[], json!({ "position": [1.1, 0.0] }), "initial.position", "initial.project"),
        (&[], json!({ "position": [1.0, 0.0], "velocity": [1.0, 0.0] }), "initial.velocity", "rate 2e0"),
        (
            &[("constraints", json!(["q0^2 + q1^2 - 1", "3*q0^2 + 3*q1^2 - 3"]))],
            start.clone(),
            "system.constraints[1]",
            "redundant",
        ),
        (&[("kinetic", json!("0.5*v0^2 + 0.25*v1^4"))], start.clone(), "system.kinetic", "degree 2"),
        (&[("kinetic", json!("0.5*v0^2/(1 - q0) + 0.5*v1^2"))], start.clone(), "system.kinetic", "finite"),
        (
            &[("damping", json!([{ "order": 0.5, "coefficient": 1.0, "along": "hypot(q0 - 1, q1)" }]))],
            start.clone(),
            "system.damping[0].along",
            "no derivative",
        ),
        (
            &[("damping", json!([{ "order": 0.5, "coefficient": -1.0, "along": "q0" }]))],
            start.clone(),
            "system.damping[0].coefficient",
            "positive semidefinite",
        ),
        (
            &[("damping", json!([{ "order": 0.5, "coefficient": 1.0, "along": "2*pi" }]))],
            json!({ "position": [1.0, 0.0] }),
            "system.damping[0].along",
            "functions of the coordinates",
        ),
        (
            &[("damping", json!([{ "order": 0.5, "coefficient": [1.0, 2.0], "along": ["q0", "2*pi"] }]))],
            json!({ "position": [1.0, 0.0] }),
            "system.damping[0].along",
            "elongation 1",
        ),
        (
            &[("damping", json!([{ "order": 0.5, "coefficient": [1.0, 2.0, 3.0], "along": ["q0", "q1"] }]))],
            json!({ "position": [1.0, 0.0] }),
            "system.damping[0].coefficient",
            "one for each elongation",
        ),
        (
            &[("damping", json!([{ "order": 0.5, "coefficient": [1.0], "along": ["q0", "q1"] }]))],
            start.clone(),
            "system.damping[0].coefficient",
            "2",
        ),
    ];
    for (change, initial, key, phrase) in cases {
        let (found, message) = refused(change, &initial);
        assert_eq!(found, key, "{message}");
        assert!(message.contains(phrase), "{key}: {message}");
    }
}

/// Responses of one system described in three ways: by angles, by places with constraints, and by its
/// matrices M, K and ρ_m at the hanging rest.
#[test]
fn a_response_at_rest_is_that_of_the_linear_system() {
    let time = (1.0, 50);
    let places = [0.0, -1.0, 0.0, -1.7];
    let of = |system: &Value, position: &[f64]| {
        let start = json!({ "position": position });
        Linearised::new(&scenario(system, start, 2, time), position).unwrap()
    };
    let joint = [[1.0, -1.0], [-1.0, 1.0]];
    for kind in JOINTS {
        let [first, second] = [of(&by_angles(kind), &[0.0, 0.0]), of(&by_places(kind), &places)];
        let mut linear = by_angles(kind);
        linear.as_object_mut().unwrap().remove("kinetic");
        linear["mass"] = json!([[1.8, 0.56], [0.56, 0.392]]);
        linear["potential"] = json!("0.5*(1.8*9.81*q0^2 + 0.8*0.7*9.81*q1^2)");
        for (term, matrix) in [[[1.0, 0.0], [0.0, 0.0]], joint].into_iter().enumerate() {
            let damping = linear["damping"][term].as_object_mut().unwrap();
            damping.remove("along");
            let rho = damping["coefficient"].as_f64().unwrap();
            damping["coefficient"] = json!(matrix.map(|row| row.map(|entry| rho * entry)));
        }
        let third = of(&linear, &[0.0, 0.0]);
        for omega in [0.1, 1.0, 2.7, 5.4, 30.0] {
            for input in 0..2 {
                let [angles, expected] = [&first, &third].map(|one| one.response(omega, input).unwrap());
                let scale = expected.iter().map(|h| h.norm()).fold(0.0, max_or_nan);
                let off = |one: &[Complex<f64>], other: &[Complex<f64>]| {
                    one.iter().zip(other).map(|(a, b)| (a - b).norm()).fold(0.0, max_or_nan) / scale
                };
                assert!(off(&angles, &expected) < 1e-13, "{kind}, ω = {omega}: {angles:?} {expected:?}");
                let [angles, expected] =
                    [&first, &third].map(|one| one.discrete_response(omega, input).unwrap());
                assert!(off(&angles, &expected) < 1e-12, "{kind}, ω = {omega}: {angles:?} {expected:?}");
            }
            // A horizontal force on the lower mass turns the angles by 1 and 0.7.
            let of_angles = [0, 1].map(|input| first.response(omega, input).unwrap());
            let moved = |column: &[Complex<f64>]| column[0] + column[1] * 0.7;
            let expected = moved(&of_angles[0]) + moved(&of_angles[1]) * 0.7;
            let found = second.response(omega, 2).unwrap()[2];
            assert!((found - expected).norm() < 1e-12 * expected.norm(), "{kind}, ω = {omega}");
        }
        let poles = [&first, &second, &third].map(|one| one.poles().unwrap());
        assert!(poles[2].len() >= 2, "{:?}", poles[2]);
        for other in &poles[..2] {
            assert_eq!(other.len(), poles[2].len(), "{kind}");
            for (pole, expected) in other.iter().zip(&poles[2]) {
                let off = (pole.place - expected.place).norm();
                assert!(off < 1e-9 * expected.place.norm(), "{kind}: {pole:?} {expected:?}");
            }
        }
    }
}

/// Gauss weights under a harmonic force: after the damper has forgotten the start, positions at grid points
/// are H_h(ω) e^{iωt}, and H_h is as far from H as the order 2s says.
#[test]
fn a_discrete_response_is_that_of_a_long_run() {
    let omega = 2.2;
    let kernel = json!({ "form": "prony", "strengths": [3.0, 1.0], "times": [0.2, 0.6] });
    let system = json!({
        "mass": [1.0],
        "potential": "2*q0^2",
        "force": ["cos(2.2*t)"],
        "damping": [{ "kernel": kernel, "coefficient": [1.0] }],
    });
    for degree in 1..=3_usize {
        let off = [200, 400].map(|steps| {
            let of = |end: f64, steps| scenario(&system, json!({ "position": [0.0] }), degree, (end, steps));
            let linearised = Linearised::new(&of(20.0, steps), &[0.0]).unwrap();
            let discrete = linearised.discrete_response(omega, 0).unwrap()[0];
            let [position, _] = end_of(&of(80.0, 4 * steps), Precision::F64);
            let turned = Complex::new((omega * 80.0).cos(), (omega * 80.0).sin());
            let expected = (discrete * turned).re;
            assert!((position[0] - expected).abs() < 1e-10, "{degree}: {} {expected}", position[0]);
            (discrete - linearised.response(omega, 0).unwrap()[0]).norm()
        });
        let order = (off[0] / off[1]).log2();
        assert!((order - 2.0 * degree as f64).abs() < 0.2, "{degree}: {order}, {off:?}");
    }
}

/// Weights on rigid bars, whose constraints are curved and loaded: the same, with steps so long that the
/// curvature at the knots tells.
#[test]
fn a_discrete_response_with_loaded_constraints_is_that_of_a_long_run() {
    let rest = [0.0, -1.0, 0.0, -1.7];
    for degree in 1..=3_usize {
        let off = [0.1, 0.05].map(|step| {
            let step = step * degree as f64;
            let omega = 3.1;
            let steps = (600.0 / step) as usize;
            let mut system = by_places("prony");
            let of = |system: &Value| {
                scenario(system, json!({ "position": rest }), degree, (step * steps as f64, steps))
            };
            let linearised = Linearised::new(&of(&system), &rest).unwrap();
            let discrete = linearised.discrete_response(omega, 2).unwrap();
            system["force"] = json!(["0", "0", format!("2e-5*cos({omega:?}*t)"), "0"]);
            let [position, _] = end_of(&of(&system), Precision::F64);
            let (sine, cosine) = (omega * step * steps as f64).sin_cos();
            for (index, discrete) in discrete.iter().enumerate() {
                let found = (position[index] - rest[index]) / 2e-5;
                let expected = (discrete * Complex::new(cosine, sine)).re;
                assert!((found - expected).abs() < 1e-6, "{degree}, {step}, q{index}: {found} {expected}");
            }
            (discrete[2] - linearised.response(omega, 2).unwrap()[2]).norm()
        });
        let order = (off[0] / off[1]).log2();
        assert!((order - 2.0 * degree as f64).abs() < 0.3, "{degree}: {order}, {off:?}");
    }
}

#[test]
fn a_response_away_from_rest_names_the_rest_nearby() {
    let of = |system: &Value, position: &[f64]| {
        let start = json!({ "position": position, "project": position.len() > 2 });
        match Linearised::new(&scenario(system, start, 2, (1.0, 50)), position) {
            Ok(_) => String::new(),
            Err(error) => error.to_string(),
        }
    };
    let hanging = of(&by_angles("fractional"), &[0.3, -0.2]);
    assert!(hanging.contains("Newton's method finds one at q = ["), "{hanging}");
    let places = of(&by_places("prony"), &[0.1, -0.99, 0.0, -1.6]);
    assert!(places.contains("the constraints are off by"), "{places}");
    // At rest upside down there is a response, too; its poles say that it falls.
    assert_eq!(of(&by_angles("fractional"), &[std::f64::consts::PI, 0.0]), "");
    let turning = json!({ "kinetic": "0.5*(v0^2 + v1^2) + 0.3*(q0*v1 - q1*v0)", "potential": "q0^2 + q1^2" });
    let message = of(&turning, &[0.0, 0.0]);
    assert!(message.contains("system.kinetic") && message.contains("linear in the velocities"), "{message}");
    // A spring in a damper holds the arm where the start was.
    let spring = json!({ "symbol": "3 + 0.5*s/(1 + 0.5*s)" });
    let held = json!({
        "kinetic": "0.5*v0^2",
        "potential": "-q0",
        "damping": [{ "kernel": spring, "coefficient": 1.0, "along": "2*q0" }],
    });
    assert!(of(&held, &[0.0]).contains("is left at rest"));
    let start = json!({ "position": [0.0] });
    let linearised = Linearised::new(&scenario(&held, start, 2, (1.0, 50)), &[1.0 / 12.0]).unwrap();
    let soft = linearised.response(1e-9, 0).unwrap()[0];
    assert!((soft - 1.0 / 12.0).norm() < 1e-8, "{soft}");
}

/// Derivatives of a run by each path are central differences of runs, relative to the largest of them.
fn are_differences(of: &Value, paths: &[&str]) {
    let with = |paths: &[&str], change: Option<(&str, f64)>| {
        let mut own = of.clone();
        if !paths.is_empty() {
            own["sensitivity"] = json!({ "parameters": paths });
        }
        if let Some((path, step)) = change {
            let pointer = format!("/{}", path.replace(['.', '['], "/").replace(']', ""));
            let place = own.pointer_mut(&pointer).unwrap();
            *place = json!(place.as_f64().unwrap() + step);
        }
        Scenario::from_value(&own).unwrap()
    };
    let scenario = with(paths, None);
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    motion = motion.with_sensitivities(&Default::default()).unwrap();
    let plain = end_of(&with(&[], None), Precision::F64);
    while !motion.is_done() {
        motion.advance().unwrap();
    }
    let state = motion.state();
    assert_eq!(plain, [state.position.clone(), state.momentum.clone()], "the motion is not the same");
    let numbers = 2 * state.position.len();
    for (path, exact) in paths.iter().zip(state.sensitivities.chunks(numbers)) {
        let at = |step: f64| end_of(&with(&[], Some((path, step))), Precision::F64).concat();
        let h = 1e-3;
        let [near, far] = [h, 2.0 * h].map(|h| {
            let [more, less] = [at(h), at(-h)];
            more.iter().zip(&less).map(|(more, less)| (more - less) / (2.0 * h)).collect::<Vec<_>>()
        });
        let differences: Vec<f64> =
            near.iter().zip(&far).map(|(near, far)| (4.0 * near - far) / 3.0).collect();
        let size = differences.iter().fold(0.0, |most, x| max_or_nan(most, x.abs()));
        let error = distance(exact, &differences) / size;
        assert!(error < 1e-7, "{path}: {error:e}\n{exact:?}\n{differences:?}");
        assert!(size > 1e-3, "{path} does not matter");
    }
}

fn in_short(system: Value, initial: Value) -> Value {
    json!({
        "system": system,
        "initial": initial,
        "scheme": { "kind": "galerkin", "degree": 2 },
        "time": { "step": 0.05, "steps": 30 },
    })
}

#[test]
fn derivatives_of_a_double_pendulum_by_angles_are_differences_of_runs() {
    let system = json!({
        "kinetic": "0.5*(m + 0.8)*v0^2 + 0.5*0.8*l^2*v1^2 + 0.8*l*v0*v1*cos(q0 - q1)",
        "potential": "-(m + 0.8)*g*cos(q0) - 0.8*g*l*cos(q1)",
        "force": ["0", "a*sin(3*t) - c*v1"],
        "parameters": { "m": 1.0, "l": 0.7, "g": 9.81, "a": 0.4, "c": 0.1, "r": 1.3 },
        "damping": [
            { "order": 0.5, "coefficient": 1.2, "along": "q0" },
            { "order": 0.7, "coefficient": 0.5, "along": "sin(r*(q1 - q0))" },
            { "kernel": { "form": "prony", "strengths": [0.8, 0.3], "times": [0.4, 2.0] }, "coefficient": 0.3, "along": "q1" },
        ],
    });
    let paths = [
        "system.parameters.m",
        "system.parameters.l",
        "system.parameters.g",
        "system.parameters.a",
        "system.parameters.c",
        "system.parameters.r",
        "system.damping[0].order",
        "system.damping[0].coefficient",
        "system.damping[1].order",
        "system.damping[1].coefficient",
        "system.damping[2].kernel.strengths[1]",
        "system.damping[2].kernel.times[0]",
        "initial.position[0]",
    ];
    let by_velocity = json!({ "position": [1.2, 0.4], "velocity": [0.5, -1.0] });
    are_differences(&in_short(system.clone(), by_velocity), &[&paths[..], &["initial.velocity[1]"]].concat());
    let by_momentum = json!({ "position": [1.2, 0.4], "momentum": [0.5, -1.0] });
    are_differences(&in_short(system, by_momentum), &[&paths[..], &["initial.momentum[1]"]].concat());
}

#[test]
fn derivatives_of_mechanisms_with_constraints_are_differences_of_runs() {
    let (first, second) = ("atan2(q0, -q1)", "atan2(q2 - q0, q1 - q3)");
    let double = json!({
        "mass": [1.0, 1.0, 0.8, 0.8],
        "potential": "g*q1 + 0.8*g*q3",
        "constraints": ["q0^2 + q1^2 - l^2", "hypot(q2 - q0, q3 - q1) - 0.7"],
        "parameters": { "g": 9.81, "l": 1.0 },
        "damping": dampers("fractional", [first, &format!("{second} - {first}")]),
    });
    let paths = [
        "system.parameters.g",
        "system.parameters.l",
        "system.mass[0]",
        "system.damping[0].order",
        "system.damping[1].coefficient",
        "initial.position[1]",
        "initial.velocity[2]",
    ];
    let start =
        json!({ "position": [0.8, -0.6, 1.2, -1.1], "velocity": [0.3, 0.4, 0.0, 1.0], "project": true });
    are_differences(&in_short(double, start), &paths);
    // A crank of length 1, a rod of length 2, and a slide on the axis.
    let slider = json!({
        "mass": [1.0, 1.0, 0.8],
        "potential": "g*q1",
        "constraints": ["q0^2 + q1^2 - 1", "(q2 - q0)^2 + q1^2 - 4"],
        "parameters": { "g": 9.81 },
        "damping": [
            { "order": 0.5, "coefficient": 1.2, "along": "atan2(q1, q0)" },
            { "order": 1.4, "coefficient": 0.2, "along": "q2" },
        ],
    });
    let start = json!({ "position": [0.6, 0.8, 0.6 + 3.36_f64.sqrt()], "velocity": [-0.8, 0.6, 0.0], "project": true });
    are_differences(
        &in_short(slider, start),
        &[
            "system.parameters.g",
            "system.mass[2]",
            "system.damping[0].order",
            "system.damping[1].order",
            "initial.velocity[0]",
        ],
    );
}

#[test]
fn a_start_that_leaves_the_constraints_with_a_parameter_has_no_derivative() {
    let system = json!({
        "mass": [1.0, 1.0],
        "potential": "9.81*q1",
        "constraints": ["q0^2 + q1^2 - l^2"],
        "parameters": { "l": 1.0 },
    });
    let mut own = in_short(system, json!({ "position": [0.6, -0.8], "velocity": [0.0, 0.0] }));
    own["sensitivity"] = json!({ "parameters": ["system.parameters.l"] });
    let scenario = Scenario::from_value(&own).unwrap();
    let motion = Motion::start(&scenario, Precision::F64).unwrap();
    let refused = motion.with_sensitivities(&Default::default()).map(|_| ()).unwrap_err();
    assert!(refused.to_string().contains("initial.project"), "{refused}");
}

/// Against the run, and its derivative, of the same potential with the elongations written out in
/// `potential`.
#[test]
fn an_element_along_elongations_is_its_potential_in_words() {
    let [spring, twist] = ["hypot(q0 - 1, 2e0*q1)", "q1*x"];
    let along = json!([
        { "potential": "0.5*k*x0^2 + 0.1*x0*x1^4", "along": [spring, twist] },
        { "potential": "1e1*x0^4/4", "along": "q0 + q2" },
    ]);
    let of = |key: &str, value: Value| {
        let mut system = json!({
            "mass": [1.0, 0.5, 2.0],
            "parameters": { "k": 4.0, "x": 0.7 },
            "damping": [{ "order": 0.5, "coefficient": 0.3, "along": spring }],
        });
        system[key] = value;
        let start = json!({ "position": [1.5, 0.4, -0.2], "velocity": [0.0, 1.0, 0.0] });
        let mut own = in_short(system, start);
        own["sensitivity"] = json!({ "parameters": ["system.parameters.x"] });
        let scenario = Scenario::from_value(&own).unwrap();
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        motion = motion.with_sensitivities(&Default::default()).unwrap();
        while !motion.is_done() {
            motion.advance().unwrap();
        }
        [motion.state().position.clone(), motion.state().sensitivities.clone()]
    };
    let words = format!("0.5*k*({spring})^2 + 0.1*({spring})*({twist})^4 + 10*(q0 + q2)^4/4");
    let [found, slopes] = of("element", along);
    let [exact, exact_slopes] = of("potential", json!(words));
    assert!(distance(&found, &exact) < 1e-12, "{found:?} {exact:?}");
    assert!(distance(&slopes, &exact_slopes) < 1e-12, "{slopes:?} {exact_slopes:?}");
}

/// In a frame that turns, L has a part without velocities: E − U is negative at the start, and the guard of
/// energies compares with the energy at rest in the frame.
#[test]
fn a_motion_in_a_rotating_frame_is_not_stopped_for_its_energy() {
    let rotating = json!({
        "kinetic": "0.5*(v0 - 3*q1)^2 + 0.5*(v1 + 3*q0)^2", "potential": "15*(hypot(q0, q1) - 0.6)^2"
    });
    let turning = json!({ "position": [0.8, 0.1], "velocity": [0.5, -1.5] });
    let [seen, _] = end_of(&scenario(&rotating, turning, 3, (2.0, 400)), Precision::F64);
    // The same from outside.
    let still = json!({ "mass": [1.0, 1.0], "potential": "15*(hypot(q0, q1) - 0.6)^2" });
    let moving = json!({ "position": [0.8, 0.1], "velocity": [0.5 - 0.3, -1.5 + 2.4] });
    let [there, _] = end_of(&scenario(&still, moving, 3, (2.0, 400)), Precision::F64);
    let (sine, cosine) = 6.0_f64.sin_cos();
    let turned = [cosine * seen[0] - sine * seen[1], sine * seen[0] + cosine * seen[1]];
    assert!(distance(&turned, &there) < 1e-9, "{turned:?} {there:?}");
}

/// What a Gauss method does to fast relaxations at the start, whose share in the momentum is taken off: with
/// the velocity of an elongation there, and with its acceleration.
#[test]
fn momenta_from_rest_have_the_order_of_positions_for_every_order_of_damping() {
    for (order, degree, rate) in [(0.5, 3, 0.0), (0.8, 3, 0.0), (0.8, 2, 0.7), (1.2, 3, 0.7), (1.4, 2, 0.7)] {
        let system = json!({
            "kinetic": "0.5*v0^2", "potential": "-9.81*cos(q0)",
            "damping": [{ "order": order, "coefficient": 0.5, "along": "q0" }],
        });
        let after = |degree, steps| {
            let start = json!({ "position": [1.0], "velocity": [rate] });
            end_of(&scenario(&system, start, degree, (2.0, steps)), Precision::F64).concat()
        };
        let exact = after(4, 960);
        let errors = [60, 120].map(|steps| distance(&after(degree, steps)[1..], &exact[1..]));
        let found = (errors[0] / errors[1]).log2();
        assert!((found - 2.0 * degree as f64).abs() < 0.3, "{order}, {degree}: {errors:?}, order {found}");
    }
}

/// Where a run goes on, its momentum is that of the run before.
#[test]
fn a_restored_mechanism_shows_the_momentum_that_it_had() {
    for scheme in [json!({ "kind": "galerkin", "degree": 2 }), json!({ "kind": "energy" })] {
        let of = Scenario::from_value(&json!({
            "system": {
                "mass": [1.0], "potential": "q0^4",
                "damping": [{ "order": 0.5, "coefficient": 0.4, "along": "sin(q0)" }],
            },
            "initial": { "position": [1.0], "velocity": [0.5] },
            "scheme": scheme,
            "time": { "step": 0.05, "steps": 20 },
        }))
        .unwrap();
        let made = || Simulation::new(&of, Precision::F64).unwrap();
        let (mut first, mut again) = (made(), made());
        let mut state = Motion::start(&of, Precision::F64).unwrap().state().clone();
        (0..20).for_each(|_| {
            first.step(&[]).unwrap();
        });
        first.read(&mut state);
        again.restore(&first.save().unwrap()).unwrap();
        let shown = state.momentum.clone();
        again.read(&mut state);
        assert_eq!(state.momentum, shown, "{scheme}");
    }
}
