//! Samples and records act from their own times on, wherever these lie in a step.

use super::workplace::{Workplace, text};
use fvi_fft::sums::max_or_nan;
use fvi_host::run::{Run, RunEnd};
use fvi_scenario::scenario::Scenario;
use std::fs;
use std::sync::atomic::AtomicBool;

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
    let difference = |(a, b): (&[f64; 2], &[f64; 2])| max_or_nan((a[0] - b[0]).abs(), (a[1] - b[1]).abs());
    one.iter().zip(other).map(difference).fold(0.0, max_or_nan)
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

/// q̈ + q = a(t) from q = 0.7, q̇ = −0.4, a the polygon through some points and zero outside.
fn driven_by(record: &[(f64, f64)], time: f64) -> [f64; 2] {
    let mut state = [0.7, -0.4];
    let mut now = 0.0;
    // q = (a + b s) plus a free motion, s from the beginning of each stretch.
    let mut resume = |until: f64, [a, b]: [f64; 2]| {
        let until = until.min(time);
        if until > now {
            let (sine, cosine) = (until - now).sin_cos();
            let (x, v) = (state[0] - a, state[1] - b);
            state = [a + b * (until - now) + x * cosine + v * sine, b - x * sine + v * cosine];
            now = until;
        }
    };
    resume(record[0].0, [0.0; 2]);
    for pair in record.windows(2) {
        resume(pair[1].0, [pair[0].1, (pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0)]);
    }
    resume(f64::INFINITY, [0.0; 2]);
    state
}

#[test]
fn random_records_drive_every_scheme_on_every_grid_as_their_polygons_do() {
    // With the largest errors of steps of 0.05 and shorter: h to the order of the scheme.
    let schemes = [
        ("kind = \"low-order\"\nkappa = 0.5", "", 2.5e-3),
        ("kind = \"low-order\"\nkappa = 1.0", "", 0.07),
        ("kind = \"low-order\"\nkappa = 0.0", "", 0.07),
        ("kind = \"explicit-euler\"", "", 0.4),
        ("kind = \"implicit-euler\"", "", 0.3),
        ("kind = \"galerkin\"\ndegree = 2\nquadrature = \"gauss\"\npoints = 2", "", 1e-7),
        ("kind = \"galerkin\"\ndegree = 2\nquadrature = \"lobatto\"\npoints = 3", "", 3e-8),
        ("kind = \"galerkin\"\ndegree = 3", "[convolution]\nfamily = \"radau-iia\"\nstages = 3", 2e-10),
        ("kind = \"collocation\"", "[convolution]\nfamily = \"radau-iia\"\nstages = 2", 2e-5),
        ("kind = \"collocation\"", "[convolution]\nfamily = \"radau-iia\"\nstages = 3", 2e-8),
        ("kind = \"galerkin\"\ndegree = 2", "[convolution]\nfamily = \"lobatto-iiic\"\nstages = 3", 4e-8),
    ];
    let place = Workplace::new();
    let mut state = 0x9e37_79b9_u64;
    let mut random = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    for case in 0..500 {
        let mut record = vec![(3.0 * random(), 2.0 * random() - 1.0)];
        for _ in 0..1 + case % 4 {
            // Pulses narrower than a step among them.
            let (after, _) = record[record.len() - 1];
            record.push((after + 10.0_f64.powf(-3.0 * random()), 2.0 * random() - 1.0));
        }
        if case % 5 == 0 {
            // On grid points of the equal steps.
            record.iter_mut().enumerate().for_each(|(index, row)| row.0 = 0.4 + 0.4 * index as f64);
        }
        let rows: String = record.iter().map(|(t, a)| format!("{t:?},{a:?}\n")).collect();
        place.write("record.csv", &format!("t,a\n{rows}"));
        let (scheme, convolution, bound) = schemes[case % schemes.len()];
        let any_step = !convolution.is_empty();
        let grids = [
            "step = 0.05\nend = 6.0",
            "grid = \"graded\"\nexponent = 1.5\nsteps = 150\nend = 6.0",
            "grid = \"geometric\"\nfirst = 0.01\nratio = 1.2\nlongest = 0.05\nend = 6.0",
            "grid = \"adaptive\"\ntolerance = 1e-7\nend = 6.0",
        ];
        for grid in &grids[..if any_step { grids.len() } else { 1 }] {
            let text = format!(
                "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[[system.load]]\npattern = [1.0]\n\
                 amplitude = {{ file = \"record.csv\" }}\n[initial]\nposition = [0.7]\nvelocity = [-0.4]\n\
                 [scheme]\n{scheme}\n{convolution}\n[time]\n{grid}\n"
            );
            place.write("driven.toml", &text);
            let scenario =
                Scenario::read(&place.path("driven.toml")).unwrap_or_else(|error| panic!("{error}: {text}"));
            let mut run = Run::of(&scenario).start().unwrap();
            let mut error = 0.0_f64;
            let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
                portion.states(|_, state| {
                    let [q, p] = driven_by(&record, state.time);
                    error = error.max((state.position[0] - q).abs()).max((state.momentum[0] - p).abs());
                    Ok::<_, std::convert::Infallible>(())
                })
            });
            assert_eq!(end, RunEnd::Completed);
            let bound = if grid.contains("tolerance") { 1e-6 } else { bound };
            assert!(error < bound, "{error:e}: {text}{rows}");
        }
    }
}

/// Forces that are unbounded at the start of a run, wherever it begins: p = ∫ (t − s)^e dt.
#[test]
fn a_force_that_is_unbounded_at_the_start_has_its_whole_impulse() {
    let place = Workplace::new();
    for (start, length) in [(0.0, 0.2), (10.0, 0.2), (1e-3, 5.0), (1e7, 2.0)] {
        for exponent in [-0.9, -0.5] {
            for scheme in ["low-order", "galerkin\"\ndegree = 2\nquadrature = \"gauss", "collocation"] {
                let scenario = format!(
                    "[system]\nmass = [1.0]\nforce = [\"(t - {start:?})^({exponent})\"]\n[initial]\nposition = [0.0]\n\
                     [scheme]\nkind = \"{scheme}\"\n[time]\nstep = {:?}\nstart = {start:?}\nend = {:?}\n",
                    length / 100.0,
                    start + length,
                );
                let run = place.run(&scenario, &[]);
                let exact = f64::powf(length, exponent + 1.0) / (exponent + 1.0);
                let found = *run.column("p0").last().unwrap();
                // The rounding of late times.
                let within = if start > 1e6 { 2e-2 } else { 1e-6 };
                assert!((found / exact - 1.0).abs() < within, "{scenario}: {found} for {exact}");
            }
        }
    }
    // What lies before the start is no matter, what has no impulse is refused.
    let free = |force: &str| {
        format!(
            "[system]\nmass = [1.0]\nforce = [\"{force}\"]\n[initial]\nposition = [0.0]\n\
             [time]\nstep = 0.01\nstart = 1.0\nend = 2.0\n"
        )
    };
    let run = place.run(&free("1/t"), &[]);
    assert!((run.column("p0").last().unwrap() - std::f64::consts::LN_2).abs() < 1e-4);
    place.write("none.toml", &free("(t - 1)^(-1.2)"));
    let output = place.fvi(&["run", "none.toml", "--out", "none"]);
    assert!(
        output.status.code() == Some(2) && text(&output.stderr).contains("impulse"),
        "{}",
        text(&output.stderr)
    );
}
