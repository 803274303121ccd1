//! `[output] memory_energy = true`: what materials have stored and turned into heat.

use crate::workplace::{Workplace, text};
use std::fs;

fn scenario(steps: usize) -> String {
    format!(
        "[system]\nmass = [1.0]\npotential = \"2*q0^2\"\n[[system.damping]]\ncoefficient = [1.5]\n\
         kernel = {{ form = \"maxwell\", order = 0.6, time = 0.3 }}\n[initial]\nposition = [1.0]\n[output]\n\
         memory_energy = true\n[history]\nengine = \"direct\"\n[time]\nstep = 0.02\nsteps = {steps}\n"
    )
}

fn fvi(place: &Workplace, arguments: &str) -> (bool, String) {
    let output = place.fvi(&arguments.split(' ').collect::<Vec<_>>());
    (output.status.success(), text(&output.stderr))
}

#[test]
fn columns_and_curves_are_written_and_a_run_that_goes_on_has_the_same() {
    let place = Workplace::new();
    for (steps, out, more) in [(600, "whole", ""), (250, "parts", ""), (600, "parts", " --resume")] {
        place.write("run.toml", &scenario(steps));
        let command = format!("run run.toml --out {out} --checkpoint-every 100{more}");
        let (done, message) = fvi(&place, &command);
        assert!(done, "{command}: {message}");
    }
    let table = |run: &str| fs::read_to_string(place.path(run).join("trajectory.csv")).unwrap();
    let whole = table("whole");
    assert!(whole.starts_with("t,q0,p0,energy,memory_stored,memory_dissipated\n"));
    assert_eq!(table("parts"), whole);
    let row = |line: &str| -> Vec<f64> { line.split(',').map(|cell| cell.parse().unwrap()).collect() };
    let rows: Vec<Vec<f64>> = whole.lines().skip(1).map(row).collect();
    for row in &rows {
        assert!((row[3] + row[4] + row[5] - rows[0][3]).abs() < 1e-12 * rows[0][3], "{row:?}");
    }
    assert!(rows[300][5] > 0.5 * rows[0][3]);
    let picture = fs::read_to_string(place.path("whole/energy.svg")).unwrap();
    assert!(picture.contains("stored in memories") && picture.contains("dissipated by them"));
}

#[test]
fn numpy_files_hold_the_numbers_of_the_text_after_an_interruption_too() {
    let place = Workplace::new();
    place.write("run.toml", &scenario(300));
    place.write("begun.toml", &scenario(120));
    for command in [
        "run run.toml --out text",
        "run run.toml --out whole --format npz",
        "run begun.toml --out parts --format npz --checkpoint-every 50",
        "run run.toml --out parts --format npz --resume",
    ] {
        let (done, message) = fvi(&place, command);
        assert!(done, "{command}: {message}");
    }
    let archive = fs::read(place.path("whole/trajectory.npz")).unwrap();
    assert!(fs::read(place.path("parts/trajectory.npz")).unwrap() == archive);
    let text = fs::read_to_string(place.path("text/trajectory.csv")).unwrap();
    let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    for name in ["memory_stored", "memory_dissipated"] {
        let column = names.iter().position(|&heading| heading == name).unwrap();
        let number = |line: &str| line.split(',').nth(column).unwrap().parse::<f64>().unwrap();
        let numbers: Vec<u8> = text.lines().skip(1).flat_map(|line| number(line).to_le_bytes()).collect();
        assert!(archive.windows(numbers.len()).any(|bytes| bytes == numbers), "{name}");
    }
}

#[test]
fn damping_of_order_zero_is_a_spring_in_motion_and_energy() {
    // ω = 10 from rest at 1: q = cos 10 t, and ½ ρ q² is part of the energy.
    for (derivative, scheme) in [
        ("caputo", ""),
        ("riemann-liouville", ""),
        ("caputo", "scheme = { kind = \"galerkin\", degree = 2 }\n"),
        ("caputo", "scheme.kind = \"collocation\"\nconvolution = { family = \"radau-iia\", stages = 3 }\n"),
    ] {
        let text = format!(
            "system.mass = [1.0]\nsystem.damping = [{{ order = 0.0, coefficient = [100.0], derivative = \"{derivative}\" }}]\n\
             initial.position = [1.0]\ntime = {{ step = 0.001, steps = 2000 }}\n{scheme}"
        );
        let run = Workplace::new().run(&text, &[]);
        let last = run.rows.last().unwrap();
        assert!((last[1] - libm::cos(20.0)).abs() < 2e-4, "{scheme}: {last:?}");
        for energy in run.column("energy") {
            assert!((energy - 50.0).abs() < 1e-9 * 50.0, "{derivative} {scheme}: {energy}");
        }
    }
}

#[test]
fn energies_of_orders_near_zero_and_one_are_kept() {
    let place = Workplace::new();
    for order in [0.001, 0.95, 0.999] {
        let text = format!(
            "system.mass = [1.0]\nsystem.stiffness = [1.0]\nsystem.damping = [{{ order = {order}, coefficient = [0.5] }}]\n\
             initial.position = [1.0]\ntime = {{ step = 0.02, steps = 150 }}\noutput.memory_energy = true\n"
        );
        place.write("edge.toml", &text);
        let (done, message) = fvi(&place, &format!("run edge.toml --out {order}"));
        assert!(done, "{order}: {message}");
        let table = fs::read_to_string(place.path(&format!("{order}/trajectory.csv"))).unwrap();
        for line in table.lines().skip(1) {
            let row: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            assert!((row[3] + row[4] + row[5] - 0.5).abs() < 1e-13, "{order}: {row:?}");
        }
    }
}
