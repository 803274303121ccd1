//! Gradients: the steps backwards against sensitivities forwards, which differ in rounding only.

use crate::sensitivities::{
    Case, GYROSCOPIC, KERNELS, LARGE, LATER, LINEAR, PENDULUM, SCHEMES, STAGES, STARTING, SYMBOLS, rows,
    written,
};
use fvi_fft::sums::max_or_nan;
use fvi_host::gradient::{Cotangent, Gradient, MOST_BYTES};
use fvi_host::run::{Run, RunEnd};
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use std::convert::Infallible;
use std::path::Path;
use std::sync::atomic::AtomicBool;

fn scenario(text: &str) -> Scenario {
    let document = Document::new("scenario.toml", Path::new(""), text);
    Scenario::from_document(document).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// Numbers between −1 and 1 that follow from a seed.
fn numbers(seed: u64, count: usize) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

/// The gradient of the function whose derivatives by the rows, positions and momenta, are these.
fn gradient(text: &str, most_bytes: usize, by: (&[f64], &[f64])) -> Gradient {
    let scenario = scenario(text);
    let mut run =
        Run::of(&scenario).recorded(most_bytes).start().unwrap_or_else(|error| panic!("{error}\n{text}"));
    let Ok(end) = run.drive(&AtomicBool::new(false), |_| Ok::<_, Infallible>(()));
    assert_eq!(end, RunEnd::Completed, "{text}");
    let recording = run.recording().unwrap();
    recording
        .gradient(&scenario, Cotangent { position: by.0, momentum: by.1 })
        .unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// Largest difference from the sensitivities, relative to the sum of the magnitudes that each is made of.
fn error(text: &str, seed: u64, most_bytes: usize) -> f64 {
    let (states, sensitivities) = rows(text);
    let size = states[0].len() / 2;
    let cotangent = numbers(seed, states.len() * 2 * size);
    let pairs: Vec<&[f64]> = cotangent.chunks(2 * size).collect();
    let by_position: Vec<f64> = pairs.iter().flat_map(|row| &row[..size]).copied().collect();
    let by_momentum: Vec<f64> = pairs.iter().flat_map(|row| &row[size..]).copied().collect();
    let found = gradient(text, most_bytes, (&by_position, &by_momentum)).parameters;
    let mut worst = 0.0;
    for (parameter, found) in found.iter().enumerate() {
        let (mut expected, mut magnitude) = (0.0, 0.0);
        for (row, slopes) in pairs.iter().zip(&sensitivities) {
            for (cotangent, slope) in row.iter().zip(&slopes[parameter * 2 * size..]) {
                expected += cotangent * slope;
                magnitude += (cotangent * slope).abs();
            }
        }
        let error = (found - expected).abs() / magnitude.max(1e-300);
        assert!(error < 1e-10, "parameter {parameter}: {found:e}, not {expected:e}, {error:e}\n{text}");
        worst = max_or_nan(worst, error);
    }
    worst
}

fn with_own_values(case: &Case, scheme: &str) -> String {
    let values: Vec<f64> = case.numbers.iter().map(|(_, value, _)| *value).collect();
    written(case, scheme, &values, true)
}

/// Radau IIA, Lobatto IIIC and collocation.
const STAGED: [&str; 6] = [
    "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 2",
    "[scheme]\nkind = \"galerkin\"\ndegree = 3\n[convolution]\nfamily = \"lobatto-iiic\"\nstages = 4",
    "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 3\n[history]\nengine = \"block-fft\"",
    "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 1",
    "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 3",
    "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n[history]\nengine = \"exponential-sum\"",
];

#[test]
fn gradients_are_the_sums_of_sensitivities() {
    let mut worst = 0.0_f64;
    let mut take = |case: &Case, scheme: &str| {
        worst = max_or_nan(worst, error(&with_own_values(case, scheme), 7, MOST_BYTES));
    };
    for scheme in SCHEMES {
        take(&PENDULUM, scheme);
        take(&LATER, scheme);
        if !scheme.contains("exponential-sum") {
            [&LINEAR, &KERNELS, &LARGE, &SYMBOLS].into_iter().for_each(|case| take(case, scheme));
        }
    }
    for case in [&PENDULUM, &LINEAR] {
        take(case, "[scheme]\nkind = \"explicit-euler\"");
    }
    take(
        &PENDULUM,
        "[convolution]\norder = 2\n[history]\nengine = \"direct\"\ncapacity = 20\noverflow = \"forget\"",
    );
    STAGED.iter().for_each(|scheme| take(&STAGES, scheme));
    for scheme in ["", SCHEMES[1], SCHEMES[6], "[scheme]\nkind = \"galerkin\"\ndegree = 3"] {
        take(&GYROSCOPIC, scheme);
    }
    for starting in ["[0.0, 1.0]", "[0.6, 1.0, 1.6]"] {
        take(&STARTING, &format!("[convolution]\norder = 2\nstarting = {starting}"));
    }
    eprintln!("largest difference: {worst:e}");
}

#[test]
fn constants_of_expressions_are_differentiated_together() {
    // In a potential, elements, a force that depends on velocities, and a load; some in several of them.
    let text = "[system]\nmass = [1.0, 2.0]\n\
        potential = \"a*cos(b*q0) + c^2*q1^4/(1 + d*q0^2) + exp(-e*q1^2)*sqrt((f*q0 + 0.3)^2 + 1) + 0.1*q1*tanh(g*q0) + hypot(h*q0, 1)\"\n\
        force = [\"-a*v0*sqrt(v0^2 + 0.01) + k*sin(w*t)\", \"-(k + 0.1)*tanh(v1) + atan2(l*q0, 2)\"]\n\
        parameters = { a = 0.4, b = 1.3, c = 0.7, d = 0.2, e = 0.5, f = 0.6, g = 0.9, h = 1.1, k = 0.3, w = 1.7, l = 0.8, u = 1.2 }\n\
        [[system.damping]]\norder = 0.5\ncoefficient = [0.2, 0.3]\n\
        [[system.element]]\npotential = \"0.5*u*(x1 - x0)^2 + b*(x1 - x0)^4\"\ncoordinates = [[0, 1]]\n\
        [[system.load]]\npattern = { coordinate = 1, value = 2.0 }\namplitude = \"l*cos(w*t)\"\n\
        [initial]\nposition = [0.4, -0.3]\nmomentum = [0.1, 0.2]\n[time]\nstep = 0.05\nsteps = 80\n\
        [sensitivity]\nparameters = [NAMES]\n";
    let names =
        "abcdefghkwlu".chars().map(|name| format!("\"system.parameters.{name}\"")).collect::<Vec<_>>();
    for scheme in ["", "[scheme]\nkind = \"galerkin\"\ndegree = 2\n", "[scheme]\nkind = \"collocation\"\n"] {
        let text = text.replace("NAMES", &names.join(", ")).replace("[time]", &format!("{scheme}[time]"));
        eprintln!("{:e}", error(&text, 3, MOST_BYTES));
    }
}

#[test]
fn stretches_that_are_made_again_change_nothing() {
    for (case, scheme) in
        [(&PENDULUM, ""), (&LINEAR, SCHEMES[4]), (&STAGES, STAGED[4]), (&PENDULUM, SCHEMES[2])]
    {
        let text = with_own_values(case, scheme).replace("steps = 60", "steps = 400");
        let scenario = scenario(&text);
        let size = scenario.coordinates();
        let by = numbers(3, 401 * size);
        let whole = gradient(&text, MOST_BYTES, (&by, &by));
        assert_eq!(whole.force.len(), 400 * size);
        for most in [1, 5000] {
            assert_eq!(gradient(&text, most, (&by, &by)), whole, "{}, {most} bytes", case.name);
        }
    }
}
