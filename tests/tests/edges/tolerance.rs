//! Adaptive steps keep to their tolerance, or say why not: every family and degree, kernels with orders near
//! 0, 1 and 2, and coordinates without mass, which begin like a small power of t.

use fvi_fft::sums::max_or_nan;
use fvi_host::run::{Run, RunEnd};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::GridState;
use serde_json::{Value, json};
use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

/// The rows of a run, or why it ended before the end.
fn rows(scenario: &Value) -> Result<Vec<GridState>, String> {
    let scenario = Scenario::from_value(scenario).unwrap();
    let mut rows = Vec::new();
    let mut run = Run::of(&scenario).start().unwrap();
    let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
        portion.states(|_, state| {
            rows.push(state.clone());
            Ok::<_, Infallible>(())
        })
    });
    match end {
        RunEnd::Completed => Ok(rows),
        RunEnd::Failed { reason, .. } => Err(reason),
        other => panic!("{other:?}"),
    }
}

/// The Lagrange functions' degree, none for collocation; family and number of stages; order without damping.
type Method = (Option<usize>, &'static str, usize, usize);

/// Every scheme that takes steps of any length.
fn methods() -> Vec<Method> {
    let radau = |stages: usize| ("radau-iia", stages, 2 * stages - 1);
    let lobatto = |stages: usize| ("lobatto-iiic", stages, 2 * stages - 2);
    let collocation = (1..=3).map(radau).map(|(family, stages, order)| (None, family, stages, order));
    let families = (1..=3).map(radau).chain((2..=4).map(lobatto));
    let galerkin = families.flat_map(|(family, stages, order)| {
        (1..=stages).map(move |degree| (Some(degree), family, stages, order.min(2 * degree)))
    });
    collocation.chain(galerkin).collect()
}

/// The oscillator q̈ + q + 0.3 K(D) q = 0 from (1, 0.3) to t = 6.
fn oscillator(kernel: &str, derivative: &str, method: Method, tolerance: f64) -> Value {
    let (degree, family, stages, _) = method;
    let mut damping: Value = serde_json::from_str(kernel).unwrap();
    damping["coefficient"] = json!([0.3]);
    damping["derivative"] = json!(derivative);
    json!({
        "system": { "mass": [1.0], "stiffness": [1.0], "damping": [damping] },
        "initial": { "position": [1.0], "velocity": [0.3] },
        "scheme": degree.map_or(json!({ "kind": "collocation" }), |degree| json!({ "kind": "galerkin", "degree": degree })),
        "convolution": { "family": family, "stages": stages },
        "time": { "grid": "adaptive", "end": 6.0, "tolerance": tolerance },
    })
}

const RL: &str = "riemann-liouville";

/// (q, p) at t = 6 from the inverse of the Laplace transform (mpmath, Talbot's contour, 40 digits).
const OSCILLATORS: [(&str, &str, [f64; 2]); 14] = [
    (r#"{"order":0.01}"#, "caputo", [1.01029935828274, -0.207173366581685]),
    (r#"{"order":0.01}"#, RL, [0.975932714711889, -0.348049648129683]),
    (r#"{"order":0.3}"#, RL, [0.693850119244997, -0.248706847760967]),
    (r#"{"order":0.5}"#, "caputo", [0.555045906639566, 0.00107236636511317]),
    (r#"{"order":0.95}"#, "caputo", [0.334323052437096, 0.235897533403256]),
    (r#"{"order":0.999}"#, "caputo", [0.318441545188657, 0.2617860405799]),
    (r#"{"order":1.05}"#, "caputo", [0.349707789613049, 0.275939228894036]),
    (r#"{"order":1.5}"#, "caputo", [0.200314876428801, 0.536967057042333]),
    (r#"{"order":1.95}"#, "caputo", [0.217110282001541, 0.863223708461928]),
    (
        r#"{"kernel":{"form":"tempered","order":0.98,"rate":0.5}}"#,
        "caputo",
        [0.325180732510549, 0.260187339490141],
    ),
    (
        r#"{"kernel":{"form":"maxwell","order":0.9,"inner":0.1,"time":0.5}}"#,
        RL,
        [0.73553632388829, 0.226817052317113],
    ),
    (
        r#"{"kernel":{"form":"havriliak-negami","order":0.9,"power":0.2,"time":2.0}}"#,
        RL,
        [0.833881436923349, 0.356420780456824],
    ),
    (
        r#"{"kernel":{"form":"prony","strengths":[1.0,0.5],"times":[0.01,5.0]}}"#,
        RL,
        [0.944878048438677, 0.134633803229377],
    ),
    (
        r#"{"kernel":{"form":"prony","strengths":[1.0],"times":[0.5]}}"#,
        "caputo",
        [0.641938819761044, 0.30581581098889],
    ),
];

#[test]
fn the_tolerance_is_kept_by_every_family_and_degree() {
    for (index, method) in methods().into_iter().enumerate() {
        // What a low order reaches with a bearable number of steps.
        let tolerances: &[f64] = match method.3 {
            1 => &[1e-3],
            2 => &[1e-3, 1e-5],
            _ => &[1e-3, 1e-7, 1e-11],
        };
        // The order of variational schemes falls with that of the damping above 1, and steps become many.
        let collocation_only = |kernel: &str| kernel.starts_with(r#"{"order":1."#);
        // A third of the kernels for each method, in turn.
        for (kernel, derivative, exact) in OSCILLATORS.into_iter().skip(index % 3).step_by(3) {
            if method.0.is_some() && collocation_only(kernel) {
                continue;
            }
            for &tolerance in tolerances {
                let rows = rows(&oscillator(kernel, derivative, method, tolerance)).unwrap();
                let last = rows.last().unwrap();
                let error =
                    max_or_nan((last.position[0] - exact[0]).abs(), (last.momentum[0] - exact[1]).abs());
                let is_kept = last.time == 6.0 && error <= 10.0 * tolerance;
                assert!(is_kept, "{method:?}, {kernel}, {derivative}, {tolerance:e}: {error:e}");
            }
        }
    }
}

#[test]
fn a_tolerance_beyond_the_order_is_refused_with_the_number_of_steps() {
    for degree in [None, Some(1)] {
        let (kernel, derivative, _) = OSCILLATORS[3];
        let reason = rows(&oscillator(kernel, derivative, (degree, "radau-iia", 1, 1), 1e-11)).unwrap_err();
        assert!(reason.contains("steps would be needed") && reason.contains("of order 1.00"), "{reason}");
    }
}

/// D^α x = f(t, x) to t = 1, a coordinate without mass.
fn without_mass(order: f64, force: &str, start: f64, tolerance: f64) -> Value {
    json!({
        "system": {
            "mass": [0.0],
            "force": [force],
            "damping": [{ "order": order, "coefficient": [1.0], "derivative": "caputo" }],
        },
        "initial": { "position": [start] },
        "scheme": { "kind": "collocation" },
        "time": { "grid": "adaptive", "end": 1.0, "tolerance": tolerance },
    })
}

#[test]
fn coordinates_without_mass_begin_like_any_power() {
    for order in [0.15, 0.5, 0.9] {
        let a = order;
        let gamma = libm::tgamma;
        let force = format!(
            "{}*t^{} - {}*t^{} + {} + (1.5*t^{} - t^4)^3 - q0^1.5",
            gamma(9.0) / gamma(9.0 - a),
            8.0 - a,
            3.0 * gamma(5.0 + 0.5 * a) / gamma(5.0 - 0.5 * a),
            4.0 - 0.5 * a,
            2.25 * gamma(a + 1.0),
            0.5 * a
        );
        let exact = |t: f64| t.powi(8) - 3.0 * t.powf(4.0 + 0.5 * a) + 2.25 * t.powf(a);
        for tolerance in [1e-3, 1e-6, 1e-8, 1e-12] {
            let rows = rows(&without_mass(order, &force, 0.0, tolerance)).unwrap();
            for row in &rows {
                let error = (row.position[0] - exact(row.time)).abs();
                assert!(error <= 10.0 * tolerance, "{order}, {tolerance:e}: {error:e} at {:e}", row.time);
            }
            assert_eq!(rows.last().unwrap().time, 1.0);
        }
    }
}

#[test]
fn fractional_relaxation_is_kept_from_the_first_step_on() {
    // E_α(−10 t^α) by its series while its terms are small.
    let exact = |order: f64, time: f64| {
        let z = -10.0 * libm::pow(time, order);
        (0..60).map(|k| libm::pow(z, f64::from(k)) / libm::tgamma(order * f64::from(k) + 1.0)).sum::<f64>()
    };
    for order in [0.3, 0.6, 0.95] {
        for tolerance in [1e-3, 1e-6, 1e-8, 1e-12] {
            let rows = rows(&without_mass(order, "-10*q0", 1.0, tolerance)).unwrap();
            let early: Vec<_> = rows.iter().filter(|row| 10.0 * row.time.powf(order) < 0.5).collect();
            assert!(early.len() > 5 && rows.last().unwrap().time == 1.0);
            for row in early {
                let error = (row.position[0] - exact(order, row.time)).abs();
                assert!(error <= 10.0 * tolerance, "{order}, {tolerance:e}: {error:e} at {:e}", row.time);
            }
        }
    }
}
