//! Forces that are given functions of time have their impulse, on every scheme and grid.

use super::motion::Motion;
use super::{GridState, Precision};
use crate::scenario::Scenario;
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

/// Whether it is one of Euler's methods, which look at forces at grid points alone.
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
            // Of order 1 are Euler's methods, κ ≠ ½ and one stage.
            let midpoint = scheme.0.get("kappa").is_none_or(|kappa| *kappa == 0.5);
            let exact = !is_euler(&scheme.0) && midpoint && scheme.1["stages"] != 1;
            assert!((q - 3.0).abs() < if exact { 1e-11 } else { 1.0 }, "{name}");
            checked += 1;
        }
    }
    assert!(checked > 60, "{checked}");
}
