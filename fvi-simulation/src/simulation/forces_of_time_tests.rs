//! Forces given as functions of time have the right impulse with every scheme and grid.

use super::motion::Motion;
use super::{GridState, Precision};
use fvi_scenario::scenario::Scenario;
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Every scheme, with its convolution, and whether it takes steps of any length.
fn schemes() -> Vec<(Value, Value, bool)> {
    let (bdf, radau) = (json!({}), |stages: usize| json!({ "family": "radau-iia", "stages": stages }));
    let lobatto = |stages: usize| json!({ "family": "lobatto-iiic", "stages": stages });
    let low_order = |kappa: f64| json!({ "kind": "low-order", "kappa": kappa });
    let galerkin = |degree: usize, quadrature: &str| json!({ "kind": "galerkin", "degree": degree, "quadrature": quadrature });
    let by_family = |degree: usize| json!({ "kind": "galerkin", "degree": degree });
    let mut all = vec![
        (json!({ "kind": "explicit-euler" }), bdf.clone(), false),
        (json!({ "kind": "implicit-euler" }), bdf.clone(), false),
        (galerkin(1, "lobatto"), bdf.clone(), false),
        (galerkin(2, "gauss"), bdf.clone(), false),
        (galerkin(2, "lobatto"), bdf.clone(), false),
        (galerkin(3, "gauss"), bdf.clone(), false),
    ];
    all.extend([0.0, 0.25, 0.5, 1.0].map(|kappa| (low_order(kappa), bdf.clone(), false)));
    for stages in [2, 3] {
        all.push((by_family(stages), radau(stages), true));
        all.push((by_family(stages), lobatto(stages), true));
    }
    all.extend([1, 2, 3].map(|stages| (json!({ "kind": "collocation" }), radau(stages), true)));
    all
}

/// True if it is one of Euler's methods, which evaluate forces at grid points only.
fn is_euler(scheme: &Value) -> bool {
    scheme["kind"].as_str().is_some_and(|kind| kind.ends_with("euler"))
}

/// The last state of a free mass under a system's force.
fn last(
    system: &Value,
    (scheme, convolution, _): &(Value, Value, bool),
    time: &Value,
) -> Result<GridState, String> {
    let mut all = json!({ "mass": [1.0] });
    let more = system.as_object().unwrap().clone();
    all.as_object_mut().unwrap().extend(more);
    let scenario = json!({ "system": all, "scheme": scheme, "convolution": convolution, "time": time });
    let scenario = Scenario::from_value(&scenario).map_err(|error| error.to_string())?;
    let mut motion = Motion::start(&scenario, Precision::F64).map_err(|error| error.to_string())?;
    while !motion.is_done() {
        motion.advance_along(usize::MAX).map_err(|failure| failure.reason)?;
    }
    Ok(motion.state().clone())
}

/// A file with the rows of a record.
fn record(rows: &[(f64, f64)]) -> tempfile::NamedTempFile {
    let mut text = "t,a\n".to_owned();
    rows.iter().for_each(|(time, number)| writeln!(text, "{time},{number}").unwrap());
    let file = tempfile::Builder::new().suffix(".csv").tempfile().unwrap();
    std::fs::write(file.path(), text).unwrap();
    file
}

fn load(file: &tempfile::NamedTempFile) -> Value {
    json!({ "load": [{ "pattern": [1.0], "amplitude": { "file": file.path() } }] })
}

#[test]
fn edges_of_records_on_grid_points_act_like_jumps() {
    let file = record(&[(0.5, 1.0), (1.5, 1.0)]);
    let jumps = json!({ "force": ["step(t - 0.5) - step(t - 1.5)"] });
    let mut checked = 0;
    for scheme in schemes() {
        let grids = [
            json!({ "step": 0.1, "end": 4.0 }),
            json!({ "step": 0.1, "end": 4.0, "must_hit": [0.5, 1.5] }),
            json!({ "grid": "graded", "steps": 20, "exponent": 1.7, "end": 4.0, "must_hit": [0.5, 1.5] }),
            json!({ "grid": "points", "points": [0.0, 0.3, 0.5, 1.1, 1.5, 2.7, 4.0] }),
            json!({ "grid": "adaptive", "tolerance": 1e-6, "end": 4.0 }),
            json!({ "grid": "adaptive", "tolerance": 1e-6, "end": 4.0, "must_hit": [0.5, 1.5] }),
        ];
        for grid in grids.iter().filter(|grid| scheme.2 || grid.get("grid").is_none()) {
            let found = last(&load(&file), &scheme, grid).unwrap();
            let expected = last(&jumps, &scheme, grid).unwrap();
            let (q, p) = (found.position[0], found.momentum[0]);
            let name = format!("{} {} {grid}: {q} {p}", scheme.0, scheme.1);
            assert!((p - 1.0).abs() < 1e-12, "{name}");
            assert!((q - expected.position[0]).abs() < 1e-11, "{name}, not {}", expected.position[0]);
            // Euler's methods, κ ≠ ½ and one stage are of order 1.
            let midpoint = scheme.0.get("kappa").is_none_or(|kappa| *kappa == 0.5);
            let exact = !is_euler(&scheme.0) && midpoint && scheme.1["stages"] != 1;
            assert!((q - 3.0).abs() < if exact { 1e-11 } else { 1.0 }, "{name}");
            checked += 1;
        }
    }
    assert!(checked > 60, "{checked}");
}

/// The grids of a scheme, with a break on and off their points.
fn grids(scheme: &(Value, Value, bool), end: f64) -> Vec<Value> {
    let mut grids = vec![json!({ "step": 0.1, "end": end })];
    if scheme.2 {
        grids.push(json!({ "grid": "graded", "steps": 40, "exponent": 1.7, "end": end }));
        // What a scheme of order 1 reaches with few steps.
        let tolerance = if scheme.1["stages"] == 1 { 1.6e-4 } else { 1e-6 };
        grids.push(json!({ "grid": "adaptive", "tolerance": tolerance, "end": end }));
    }
    grids
}

/// True if a scheme supports moments of forces.
fn takes_moments(scheme: &Value) -> bool {
    !is_euler(scheme) && scheme.get("kappa").is_none_or(|kappa| *kappa != 0.0)
}

#[test]
fn pulses_narrower_than_any_spacing_of_looks_have_their_impulse() {
    let mut checked = 0;
    for force in [
        "step(1e-4 - abs(t - 3.00123))/2e-4",
        "step(1e-4 - abs(t - 3.0312345))/2e-4",
        "max(0, 1 - abs(t - 3.0312345)/1e-5)/1e-5",
        "step(1e-10 - (t - 3.0312345)^2)/2e-5",
        "exp(-((t - 3.3)/1e-5)^2)/1e-5/sqrt(pi)",
        "exp(-((t - 3.3)/0.03)^2)/0.03/sqrt(pi)",
        "sin(t) - sin(t) + 1/(1 + ((t - 3.3)/1e-6)^2)/1e-6/pi",
    ] {
        for scheme in schemes().iter().filter(|scheme| takes_moments(&scheme.0)) {
            for grid in grids(scheme, 8.0) {
                let found = last(&json!({ "force": [force] }), scheme, &grid).unwrap();
                let (q, p) = (found.position[0], found.momentum[0]);
                let name = format!("{force} {} {} {grid}: {q} {p}", scheme.0, scheme.1);
                // The tails of the last pulse extend beyond the run.
                let room = match grid["tolerance"].as_f64() {
                    Some(tolerance) => 2.5 * tolerance + 5e-5,
                    None => 2e-6,
                };
                assert!((p - 1.0).abs() < room, "{name}");
                let centre = if force.contains("3.3") {
                    3.3
                } else if force.contains("3.00123") {
                    3.00123
                } else {
                    3.0312345
                };
                let second_order =
                    scheme.0.get("kappa").is_none_or(|kappa| *kappa == 0.5) && scheme.1["stages"] != 1;
                let room = match () {
                    () if !second_order => 0.2,
                    () => 3e-4,
                };
                assert!((q - (8.0 - centre)).abs() < room, "{name}");
                checked += 1;
            }
        }
    }
    assert!(checked > 150, "{checked}");
}

#[test]
fn many_jumps_in_a_step_are_all_found() {
    // On for half of each period of 2π/1000; full periods end at t = 2 up to 2π/1000.
    let exact = |end: f64| {
        let period = std::f64::consts::TAU / 1000.0;
        let whole = (end / period).floor();
        0.5 * period * whole + (end - whole * period).min(0.5 * period)
    };
    for scheme in schemes().iter().filter(|scheme| takes_moments(&scheme.0)) {
        let found =
            last(&json!({ "force": ["step(sin(1000*t))"] }), scheme, &json!({ "step": 0.1, "end": 4.0 }))
                .unwrap();
        assert!((found.momentum[0] - exact(4.0)).abs() < 1e-11, "{} {}", scheme.0, found.momentum[0]);
    }
}

#[test]
fn forces_without_an_impulse_are_refused_with_the_time() {
    let mut checked = 0;
    for (force, time) in [
        ("t^(-1.2)", "t = 0"),
        ("1/(t - 1.03)", "t = 1.03"),
        ("tan(t)", "t = 1.570796"),
        ("2 + sin(t)/(2 - t)^2", "t = 2"),
    ] {
        for scheme in schemes() {
            for grid in grids(&scheme, 4.0) {
                let error = last(&json!({ "force": [force] }), &scheme, &grid).unwrap_err();
                assert!(
                    error.contains(time) && error.contains("no impulse"),
                    "{force} {} {grid}: {error}",
                    scheme.0
                );
                let load = json!({ "load": [{ "pattern": [1.0], "amplitude": force }] });
                assert!(last(&load, &scheme, &grid).unwrap_err().contains(time));
                checked += 1;
            }
        }
    }
    assert!(checked > 80, "{checked}");
}

#[test]
fn forces_with_an_impulse_are_taken_where_they_have_no_bound() {
    let mut checked = 0;
    // Impulse, and moment about t = 3, which is the position at t = 3.
    let power = |left: f64, right: f64, e: f64| {
        // ∫ δ^e and ∫ δ^{e+1} up to 3 − c on the right, up to c on the left.
        let whole = |to: f64| [to.powf(e + 1.0) / (e + 1.0), to.powf(e + 2.0) / (e + 2.0)];
        let (l, r) = (whole(left), whole(right));
        [l[0] + r[0], right * (l[0] + r[0]) + l[1] - r[1]]
    };
    let logarithm = |left: f64, right: f64| {
        let whole = |to: f64| [to * to.ln() - to, 0.5 * to * to * to.ln() - 0.25 * to * to];
        let (l, r) = (whole(left), whole(right));
        [l[0] + r[0], right * (l[0] + r[0]) + l[1] - r[1]]
    };
    for (force, [p, q]) in [
        ("log(abs(t - 1.03))", logarithm(1.03, 1.97)),
        ("abs(t - 1.03)^(-0.5)", power(1.03, 1.97, -0.5)),
        ("abs(t - 1.5)^(-0.5)", power(1.5, 1.5, -0.5)),
        ("abs(t - 1.03)^(-0.9)", power(1.03, 1.97, -0.9)),
        ("t^(-0.9)", power(0.0, 3.0, -0.9)),
        ("1/sqrt(t)", power(0.0, 3.0, -0.5)),
    ] {
        for scheme in schemes() {
            for grid in grids(&scheme, 3.0) {
                let found = last(&json!({ "force": [force] }), &scheme, &grid);
                if !takes_moments(&scheme.0) {
                    assert!(found.unwrap_err().contains("at its nodes alone"));
                    continue;
                }
                let found =
                    found.unwrap_or_else(|error| panic!("{force} {} {} {grid}: {error}", scheme.0, scheme.1));
                let name = format!("{force} {} {} {grid}: {found:?} for {q} {p}", scheme.0, scheme.1);
                assert!((found.momentum[0] - p).abs() < 3e-7 * p.abs(), "{name}");
                let second_order =
                    scheme.0.get("kappa").is_none_or(|kappa| *kappa == 0.5) && scheme.1["stages"] != 1;
                let room = match () {
                    () if !second_order => 1.0,
                    () => 1e-5,
                };
                assert!((found.position[0] - q).abs() < room * q.abs(), "{name}");
                checked += 1;
            }
        }
    }
    assert!(checked > 100, "{checked}");
}

/// Warnings of a run.
fn notes(system: &Value, scheme: &Value, time: &Value) -> Vec<String> {
    let mut all = json!({ "mass": [1.0] });
    all.as_object_mut().unwrap().extend(system.as_object().unwrap().clone());
    let scenario = json!({ "system": all, "scheme": scheme, "time": time });
    let scenario = Scenario::from_value(&scenario).unwrap();
    Motion::start(&scenario, Precision::F64).unwrap().notes()
}

#[test]
fn what_no_node_sees_is_warned_of_with_the_time() {
    let euler = json!({ "kind": "explicit-euler" });
    let midpoint = json!({ "kind": "low-order" });
    let time = json!({ "step": 0.1, "end": 8.0 });
    for force in ["exp(-((t - 3.33)/1e-4)^2)", "step(1e-4 - abs(t - 3.33))", "max(0, 1 - abs(t - 3.33)/1e-3)"]
    {
        let near = |notes: &[String]| notes.len() == 1 && notes[0].contains("near t = 3.3");
        assert!(near(&notes(&json!({ "force": [force] }), &euler, &time)), "{force}");
        assert!(notes(&json!({ "force": [force] }), &midpoint, &time).is_empty());
        let by_nodes = json!({ "force": [force], "force_quadrature": "nodes" });
        assert!(near(&notes(&by_nodes, &midpoint, &time)), "{force}");
        let beside = json!({ "force": [format!("{force}*cos(q0) - q0")] });
        assert!(near(&notes(&beside, &midpoint, &time)), "{force}");
    }
    let file = record(&[(0.0, 0.0), (3.32, 0.0), (3.33, 1.0), (3.34, 0.0), (8.0, 0.0)]);
    assert_eq!(notes(&load(&file), &euler, &time).len(), 1);
    assert!(notes(&load(&file), &midpoint, &time).is_empty());
    // No warning for forces that the nodes resolve, even coarsely.
    for force in [
        "sin(3*t)",
        "8*step(1.03 - t)",
        "t^2.5",
        "exp(-t)*cos(q0)",
        "sqrt(t)",
        "abs(sin(t))",
        "5",
        "max(0, t - 1)",
    ] {
        for scheme in [&euler, &midpoint] {
            assert_eq!(notes(&json!({ "force": [force] }), scheme, &time), [""; 0], "{force}");
        }
    }
}

/// Random numbers of a small generator, from 0 to 1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

/// A force of time with the times at which it is not smooth, ascending from 0 to the end.
struct Rough {
    system: Value,
    value: Box<dyn Fn(f64) -> f64>,
    edges: Vec<f64>,
    _file: Option<tempfile::NamedTempFile>,
}

impl Rough {
    /// Pulses of any width anywhere.
    fn pulses(random: &mut Random, end: f64) -> Self {
        let pulses: Vec<_> = (0..4)
            .map(|_| {
                let width = 10_f64.powf(random.between(-6.0, 0.0));
                let from = random.between(0.0, end - width);
                (from, from + width, random.between(-1.0, 1.0) / width)
            })
            .collect();
        let term = |&(from, to, height): &(f64, f64, f64)| {
            let (centre, half) = (0.5 * (from + to), 0.5 * (to - from));
            format!("{height:?}*step({:?} - (t - {centre:?})^2)", half * half)
        };
        let force: Vec<String> = pulses.iter().map(term).collect();
        let mut edges = vec![0.0, end];
        edges.extend(pulses.iter().flat_map(|&(from, to, _)| [from, to]));
        let value = move |t: f64| pulses.iter().filter(|p| p.0 <= t && t <= p.1).map(|p| p.2).sum();
        Self { system: json!({ "force": [force.join(" + ")] }), value: Box::new(value), edges, _file: None }
    }

    /// A sine outside of a dead zone.
    fn dead_zone(random: &mut Random, end: f64) -> Self {
        let (rate, zone) = (10_f64.powf(random.between(0.0, 2.5)), random.between(0.1, 0.99));
        let sine = format!("sin({rate:?}*t)");
        let force = format!("sign({sine})*max(0, abs({sine}) - {zone:?})");
        let value = move |t: f64| {
            let sine = (rate * t).sin();
            sine.signum() * (sine.abs() - zone).max(0.0)
        };
        let mut edges = vec![0.0, end];
        let first = zone.asin();
        for half in 0..=(rate * end / std::f64::consts::PI) as usize {
            let begin = half as f64 * std::f64::consts::PI;
            edges.extend([begin + first, begin + std::f64::consts::PI - first].map(|x| x / rate));
        }
        Self { system: json!({ "force": [force] }), value: Box::new(value), edges, _file: None }
    }

    /// A record with edges and a narrow peak.
    fn record(random: &mut Random, end: f64) -> Self {
        let mut times: Vec<f64> = (0..6).map(|_| random.between(0.0, end)).collect();
        let (peak, width) = (random.between(0.1, end - 0.1), 10_f64.powf(random.between(-6.0, -1.5)));
        times.retain(|&time| (time - peak).abs() > 2.0 * width);
        times.extend([peak - width, peak, peak + width]);
        times.sort_by(f64::total_cmp);
        let number = |&time: &f64| {
            let number = if time == peak { 1.0 / width } else { random.between(-1.0, 1.0) };
            (time, number)
        };
        let rows: Vec<_> = times.iter().map(number).collect();
        let file = record(&rows);
        let mut edges = vec![0.0, end];
        edges.extend(&times);
        let value = move |t: f64| {
            rows.windows(2).find(|rows| rows[0].0 <= t && t <= rows[1].0).map_or(0.0, |rows| {
                rows[0].1 + (rows[1].1 - rows[0].1) * (t - rows[0].0) / (rows[1].0 - rows[0].0)
            })
        };
        Self { system: load(&file), value: Box::new(value), edges, _file: Some(file) }
    }

    /// ∫ F(t) g(t) dt by Gauss's rule of three points on short pieces between the edges.
    fn integral(&mut self, end: f64, g: impl Fn(f64) -> f64) -> f64 {
        self.edges.retain(|&edge| (0.0..=end).contains(&edge));
        self.edges.sort_by(f64::total_cmp);
        let mut sum = 0.0;
        for piece in self.edges.windows(2) {
            let parts = 200;
            let length = (piece[1] - piece[0]) / f64::from(parts);
            for part in 0..parts {
                let middle = piece[0] + (f64::from(part) + 0.5) * length;
                for (node, weight) in [(-0.6_f64.sqrt(), 5.0), (0.0, 8.0), (0.6_f64.sqrt(), 5.0)] {
                    let t = middle + 0.5 * length * node;
                    sum += length * weight / 18.0 * (self.value)(t) * g(t);
                }
            }
        }
        sum
    }
}

/// Gauss weights and discrete gradients take forces at their nodes: what they miss of a jump is said, and a
/// grid point there keeps it.
#[test]
fn jumps_inside_steps_are_said_where_nodes_take_them() {
    let rows = record(&[(0.123, 1.0), (0.678, 1.0)]);
    let load = json!([{ "pattern": [1.0], "amplitude": { "file": rows.path() } }]);
    let gauss = json!({ "kind": "galerkin", "degree": 2 });
    let jump = "step(t - 0.123)*step(0.678 - t)";
    let run = |system: Value, scheme: &Value, family: &str, time: Value| {
        let convolution = if family.is_empty() { json!({}) } else { json!({ "family": family }) };
        let scenario =
            json!({ "system": system, "scheme": scheme, "convolution": convolution, "time": time });
        let scenario = Scenario::from_value(&scenario).unwrap();
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        while !motion.is_done() {
            motion.advance_along(usize::MAX).unwrap();
        }
        let said = motion.notes().iter().any(|note| note.contains("inside the step from t = 0.1"));
        (motion.state().momentum[0], said)
    };
    let (coarse, fine) = (json!({ "step": 0.05, "end": 1.0 }), json!({ "step": 0.001, "end": 1.0 }));
    for system in [json!({ "mass": [1.0], "load": load }), json!({ "mass": [1.0], "force": [jump] })] {
        for (scheme, family) in [(&gauss, "gauss"), (&json!({ "kind": "energy" }), "")] {
            let (momentum, said) = run(system.clone(), scheme, family, coarse.clone());
            assert!(said && (momentum - 0.555).abs() > 1e-3, "{scheme}: {momentum}");
            let (momentum, said) = run(system.clone(), scheme, family, fine.clone());
            assert!(!said && (momentum - 0.555).abs() < 1e-12, "{scheme}: {momentum}");
        }
        let (momentum, said) = run(system, &gauss, "bdf", coarse.clone());
        assert!(!said && (momentum - 0.555).abs() < 1e-12, "{momentum}");
    }
    // Bends leave the order of the energy scheme.
    for (scheme, family, warns) in [(&gauss, "gauss", true), (&json!({ "kind": "energy" }), "", false)] {
        let system = json!({ "mass": [1.0], "force": ["20*abs(t - 0.123)"] });
        assert_eq!(run(system, scheme, family, coarse.clone()).1, warns, "{scheme}");
    }
}

/// Random pulses, dead zones and records with every scheme and grid: returns the number of checks.
fn check_random_forces(cases: usize, seed: u64) -> usize {
    let mut random = Random(seed);
    let (schemes, end) = (schemes(), 5.0);
    let mut checked = 0;
    for case in 0..cases {
        let mut rough = match case % 3 {
            0 => Rough::pulses(&mut random, end),
            1 => Rough::dead_zone(&mut random, end),
            _ => Rough::record(&mut random, end),
        };
        let scheme = &schemes[(random.next() * schemes.len() as f64) as usize];
        if !takes_moments(&scheme.0) {
            continue;
        }
        let (impulse, moment) = (rough.integral(end, |_| 1.0), rough.integral(end, |t| end - t));
        let size = rough.integral(end, |_| 1.0).abs().max(1.0);
        for grid in grids(scheme, end) {
            let found = last(&rough.system, scheme, &grid)
                .unwrap_or_else(|error| panic!("{} {} {} {grid}: {error}", rough.system, scheme.0, scheme.1));
            let (q, p) = (found.position[0], found.momentum[0]);
            let name =
                format!("{} {} {} {grid}: {q} {p}, not {moment} {impulse}", rough.system, scheme.0, scheme.1);
            let second_order =
                scheme.0.get("kappa").is_none_or(|kappa| *kappa == 0.5) && scheme.1["stages"] != 1;
            // In steps without an edge the nodes are used, which are exact for pulses, and for straight lines
            // to the order of the scheme. Adaptive steps end at edges and accumulate the errors in between.
            let (room, room_of_moment) = match (case % 3, second_order) {
                _ if grid["grid"] == "adaptive" && second_order => (1e-4, 1e-4),
                _ if grid["grid"] == "adaptive" => (2e-3, 2e-3),
                (0, _) => (1e-9, 1e-9),
                (2, true) => (1e-9, 3e-3),
                (_, true) => (0.03, 0.03),
                (_, false) => (0.3, 0.3),
            };
            assert!((p - impulse).abs() < room * size, "{name}");
            // With exact moments and straight lines the position is exact too.
            if second_order && scheme.0["quadrature"] != "lobatto" {
                assert!((q - moment).abs() < room_of_moment * end * size, "{name}");
            }
            checked += 1;
        }
    }
    checked
}

#[test]
fn random_forces_of_time_have_their_impulse() {
    // For a longer test: FORCE_CASES=500.
    let cases = std::env::var("FORCE_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(60);
    assert!(check_random_forces(cases, 7) > cases);
}
