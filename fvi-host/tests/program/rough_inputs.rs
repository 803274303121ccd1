//! Samples and records act from their own times on, wherever these lie in a step.

use super::workplace::{Workplace, text};
use std::fs;

/// The positions q0 and q1 of two coupled coordinates over 40 steps that no jump below is a point of.
fn positions(place: &Workplace, scheme: &str, force: &str, rest: &str) -> Vec<[f64; 2]> {
    let scenario = format!(
        r#"
        [system]
        mass = [1.0, 2.0]
        potential = "0.5*q0^2 + (q1 - q0)^2 + 0.1*q1^4"
        {force}
        [[system.damping]]
        order = 0.5
        coefficient = [0.3, 0.2]
        derivative = "caputo"
        {rest}
        [initial]
        position = [0.2, 0.0]
        velocity = [0.0, 0.0]
        [scheme]
        {scheme}
        [time]
        step = 0.05
        steps = 40
        "#
    );
    place.write("rough.toml", &scenario);
    let output = place.fvi(&["run", "rough.toml", "--out", "out", "--quiet"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let rows = fs::read_to_string(place.path("out").join("trajectory.csv")).unwrap();
    let number = |cell: &str| cell.parse::<f64>().unwrap();
    let row = |line: &str| {
        let numbers: Vec<f64> = line.split(',').map(number).collect();
        [numbers[1], numbers[2]]
    };
    rows.lines().skip(1).map(row).collect()
}

/// The largest distance between two motions.
fn distance(one: &[[f64; 2]], other: &[[f64; 2]]) -> f64 {
    assert_eq!(one.len(), other.len());
    let difference = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
    one.iter().zip(other).map(difference).fold(0.0, f64::max)
}

const SCHEMES: [&str; 2] = [
    "kind = \"low-order\"\nkappa = 0.5",
    "kind = \"galerkin\"\ndegree = 2\nquadrature = \"gauss\"\npoints = 2",
];

#[test]
fn a_sample_between_grid_points_acts_like_a_jump_of_the_force_there() {
    let place = Workplace::new();
    for scheme in SCHEMES {
        let jumps = r#"force = ["2*step(t - 0.33) - 3*step(t - 1.271)", "0.5*step(t - 0.33)"]"#;
        let expected = positions(&place, scheme, jumps, "");
        let samples = "[input]\nsamples = [[2.0, 0.5], [-1.0, 0.5]]\ntimes = [0.33, 1.271]";
        let held = positions(&place, scheme, "", samples);
        assert!(distance(&held, &expected) < 1e-12, "{:e}", distance(&held, &expected));
        // From the next grid point on, the same samples come late.
        let late = positions(&place, scheme, "force_quadrature = \"nodes\"", samples);
        assert!(distance(&late, &expected) > 1e-2, "{:e}", distance(&late, &expected));
    }
}

#[test]
fn a_record_acts_like_the_polygon_that_it_is() {
    let place = Workplace::new();
    place.write("record.csv", "t,a\n0.1,0\n0.33,2\n0.402,2\n1.271,0.7\n");
    let record = "[[system.load]]\npattern = [1.0, -0.5]\namplitude = { file = \"record.csv\" }";
    let polygon = "step(t - 0.1)*step(1.271 - t)\
        *min(min((t - 0.1)*2/0.23, 2), 2 - (t - 0.402)*1.3/0.869)";
    let expression = format!("[[system.load]]\npattern = [1.0, -0.5]\namplitude = \"{polygon}\"");
    for scheme in SCHEMES {
        let expected =
            positions(&place, scheme, &format!("force = [\"{polygon}\", \"-0.5*({polygon})\"]"), "");
        for load in [record, &expression] {
            let found = positions(&place, scheme, "", load);
            assert!(distance(&found, &expected) < 1e-9, "{:e}", distance(&found, &expected));
        }
        let nodal = positions(&place, scheme, "force_quadrature = \"nodes\"", record);
        assert!(distance(&nodal, &expected) > 1e-5, "{:e}", distance(&nodal, &expected));
    }
}

#[test]
fn what_begins_between_the_nodes_of_a_step_sets_a_system_at_rest_going() {
    let place = Workplace::new();
    place.write("record.csv", "t,a\n0.17,0\n0.3,1\n0.5,0\n");
    let load = |amplitude: &str| {
        format!("[[system.load]]\npattern = {{ coordinate = 0 }}\namplitude = {amplitude}\n")
    };
    for (force, input) in [
        ("force = [\"step(t - 0.17)\"]\n".to_owned(), ""),
        (load("\"max(t - 0.17, 0)\""), ""),
        (load("{ file = \"record.csv\" }"), ""),
        (String::new(), "[input]\nsamples = [1.0]\ntimes = [0.17]\n"),
    ] {
        let run = place.run(
            &format!(
                "[system]\nmass = [1.0]\nstiffness = [1.0]\n{force}{input}[initial]\nposition = [0.0]\nvelocity = [0.0]\n\
                 [time]\nstep = 0.1\nsteps = 20\n"
            ),
            &[],
        );
        assert_eq!(run.summary["status"], "completed", "{force}{input}");
        assert!(run.rows[1][1] == 0.0 && run.rows[2][1] > 0.0, "{force}{input}: {:?}", &run.rows[..3]);
    }
    // By collocation, of whose stages one meets the pulse.
    let run = place.run(
        "[system]\nmass = [1.0]\nforce = [\"step(t - 0.11)*step(0.12 - t)\"]\n[initial]\nposition = [0.0]\n\
         velocity = [0.0]\n[scheme]\nkind = \"collocation\"\n[time]\nstep = 0.1\nsteps = 20\n",
        &[],
    );
    assert!(run.rows[2][1] > 0.0, "{:?}", &run.rows[..3]);
}
