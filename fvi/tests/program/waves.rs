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

/// The oscillation of the hemisphere that decays, s²(m + A(∞)) + s K̂(s) + c = 0, with K(t) and K̂(s) by the
/// trapezoidal rule from the file.
#[test]
fn the_mode_of_a_hemisphere_is_that_of_its_retardation() {
    let place = Workplace::new();
    let arguments =
        ["response", &scenario("hemisphere-decay.toml"), "--near", "1.4", "--modes", "1", "--out", "out"];
    let output = place.fvi(&arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("a table over time"), "{}", text(&output.stderr));
    let table = fs::read_to_string(place.path("out/modes.csv")).unwrap();
    let row: Vec<f64> = table.lines().nth(1).unwrap().split(',').map(|cell| cell.parse().unwrap()).collect();
    let found = nalgebra::Complex::new(row[1], row[2]);
    assert!(
        table.starts_with("near,re,im,frequency,damping,residual,of_tables\n") && row[6] < 1e-4,
        "{table}"
    );

    let rows: Vec<Vec<f64>> = fs::read_to_string(scenario("hemisphere-radiation.csv"))
        .unwrap()
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    let retardation = |time: f64| -> f64 {
        let value = |row: &Vec<f64>| row[2] * (row[0] * time).cos();
        let first = 0.5 * rows[0][0] * value(&rows[0]);
        let sum: f64 = rows
            .windows(2)
            .map(|pair| 0.5 * (pair[1][0] - pair[0][0]) * (value(&pair[0]) + value(&pair[1])))
            .sum();
        2.0 / std::f64::consts::PI * (first + sum)
    };
    let (spacing, end) = (0.02, 25.0);
    let values: Vec<f64> = (0..=(end / spacing) as usize).map(|k| retardation(spacing * k as f64)).collect();
    let transform = |s: nalgebra::Complex<f64>| -> nalgebra::Complex<f64> {
        let term = |(k, value): (usize, &f64)| {
            let share = if k == 0 { 0.5 } else { 1.0 };
            (-s * (spacing * k as f64)).exp() * (share * spacing * value)
        };
        values.iter().enumerate().map(term).sum()
    };
    let equation = |s: nalgebra::Complex<f64>| s * s * (1.5 * 261_799.387_8) + s * transform(s) + 770_475.6;
    let mut s = nalgebra::Complex::new(-0.1, 1.4);
    for _ in 0..20 {
        let h = 1e-6;
        s -= equation(s) * (2.0 * h) / (equation(s + h) - equation(s - h));
    }
    assert!((found - s).norm() < 3e-4 * s.norm(), "{found} {s}");
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
