//! Floating bodies from their hydrodynamics over frequency, and from equations of states.

use crate::workplace::{Workplace, text};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn scenario(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/scenarios");
    folder.join(name).display().to_string()
}

fn summary(place: &Workplace) -> Value {
    serde_json::from_str(&fs::read_to_string(place.path("out/summary.json")).unwrap()).unwrap()
}

#[test]
fn a_hemisphere_decays_as_the_frequency_domain_says() {
    let place = Workplace::new();
    let output = place.fvi(&["run", &scenario("hemisphere-decay.toml"), "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let found = summary(&place);
    let error = found["errors"]["position"]["largest"].as_f64().unwrap();
    assert!(error < 5e-5, "{error}");
    // Half of the displaced water: A(∞) = ρV/2.
    let mass = found["scenario"]["system"]["mass"][0].as_f64().unwrap();
    assert!((mass / 261_799.387_8 - 1.5).abs() < 1e-4, "{mass}");
    let said = text(&output.stderr);
    assert!(said.contains("Ogilvie") && said.contains("A(∞) follows from A and B"), "{said}");
    // The scenario of the summary has the whole mass, and says so; with it the run ends in the same place.
    assert_eq!(found["scenario"]["system"]["damping"][0]["kernel"]["added_to_mass"], false);
    let given = fs::read_to_string(scenario("hemisphere-decay.toml")).unwrap();
    let (given, _) = given.split_once("[reference]").unwrap();
    let table = format!("\"{}\", added_to_mass = false", scenario("hemisphere-radiation.csv"));
    let whole =
        given.replace("261799.3878", &mass.to_string()).replace("\"hemisphere-radiation.csv\"", &table);
    place.write("whole.toml", &whole);
    let output = place.fvi(&["run", "whole.toml", "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!(summary(&place)["last"], found["last"]);
}

#[test]
fn poles_of_two_bodies_are_those_of_their_equations() {
    let place = Workplace::new();
    let output = place.fvi(&["response", &scenario("two-body-absorber.toml"), "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let table = fs::read_to_string(place.path("out/poles.csv")).unwrap();
    let rows: Vec<Vec<f64>> = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    assert_eq!(rows.len(), 3, "{table}");
    for row in rows {
        let s = nalgebra::Complex::new(row[0], row[1]);
        let wave = s * s / (s * s + s * 1.1 + 0.9);
        let r = [0.6, 0.18];
        let entry = |i: usize, j: usize, mass: f64, stiffness: f64, damper: f64| {
            s * s * mass + s * damper + stiffness + wave * (r[i] * r[j])
        };
        let (a, b, d) =
            (entry(0, 0, 1.9, 7.3, 1.2), entry(0, 1, 0.25, -0.1, -1.2), entry(1, 1, 8.8, 0.42, 1.2));
        assert!((a * d - b * b).norm() < 1e-11 * (a * d).norm().max(1.0), "{s}");
    }
}
