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

/// Numbers of a system that is drawn at random, in the order in which they are asked for.
struct Drawn {
    numbers: std::vec::IntoIter<f64>,
    values: Vec<f64>,
    paths: Vec<String>,
}

impl Drawn {
    fn new(seed: u64) -> Self {
        // The first numbers of neighbouring seeds are alike.
        let numbers = numbers(seed, 300).split_off(20).into_iter();
        Self { numbers, values: Vec::new(), paths: Vec::new() }
    }

    fn between(&mut self, least: f64, most: f64) -> f64 {
        least + 0.5 * (self.numbers.next().unwrap() + 1.0) * (most - least)
    }

    fn below(&mut self, count: usize) -> usize {
        self.between(0.0, count as f64).min(count as f64 - 0.5) as usize
    }

    /// A place in the text for a number that is differentiated.
    fn number(&mut self, path: impl Into<String>, least: f64, most: f64) -> String {
        let value = self.between(least, most);
        self.values.push(value);
        self.paths.push(path.into());
        format!("<{}>", self.values.len() - 1)
    }

    fn kernel(&mut self, term: usize) -> String {
        let at = |name: &str| format!("system.damping[{term}].{name}");
        match self.below(6) {
            0 => format!("order = {}", self.number(at("order"), 0.2, 1.8)),
            1 => {
                format!("order = {}\nderivative = \"riemann-liouville\"", self.number(at("order"), 0.2, 0.9))
            }
            2 => {
                let (order, time) =
                    (self.number(at("kernel.order"), 0.4, 0.9), self.number(at("kernel.time"), 0.2, 2.0));
                format!("kernel = {{ form = \"maxwell\", order = {order}, time = {time} }}")
            }
            3 => {
                let (order, rate) =
                    (self.number(at("kernel.order"), 0.2, 0.9), self.number(at("kernel.rate"), 0.2, 2.0));
                format!("kernel = {{ form = \"tempered\", order = {order}, rate = {rate} }}")
            }
            4 => {
                let strength = self.number(at("kernel.strengths[0]"), 0.2, 2.0);
                let time = self.number(at("kernel.times[1]"), 0.2, 2.0);
                format!(
                    "kernel = {{ form = \"prony\", strengths = [{strength}, 0.7], times = [0.15, {time}] }}"
                )
            }
            _ => {
                let (order, time) =
                    (self.number(at("kernel.order"), 0.4, 0.9), self.number(at("kernel.time"), 0.2, 2.0));
                format!(
                    "kernel = {{ form = \"havriliak-negami\", order = {order}, power = 0.8, time = {time} }}"
                )
            }
        }
    }

    /// One to three coordinates, one or two damping terms, any scheme, 40 steps of random length.
    fn scenario(&mut self) -> String {
        let size = 1 + self.below(3);
        let masses: Vec<String> =
            (0..size).map(|k| self.number(format!("system.mass[{k}]"), 0.7, 2.0)).collect();
        let (stiff, hard, wave) = (
            self.number("system.parameters.k", 0.5, 3.0),
            self.number("system.parameters.c", 0.1, 0.5),
            self.number("system.parameters.w", 0.5, 2.0),
        );
        let own = |k: usize| match k {
            0 => "k*(1 - cos(q0))".to_owned(),
            _ => format!("0.5*k*(q{k} - q{0})^2 + c*q{k}^4", k - 1),
        };
        let potential: Vec<String> = (0..size).map(own).collect();
        let forces: Vec<String> = (0..size)
            .map(|k| if k == 0 { "c*sin(w*t)*(1 + 0.1*q0)".to_owned() } else { "0".to_owned() })
            .map(|force| format!("\"{force}\""))
            .collect();
        let mut text = format!(
            "[system]\nmass = [{}]\npotential = \"{}\"\nforce = [{}]\nparameters = {{ k = {stiff}, c = {hard}, w = {wave} }}\n",
            masses.join(", "),
            potential.join(" + "),
            forces.join(", ")
        );
        for term in 0..1 + self.below(2) {
            let kernel = self.kernel(term);
            let coefficients: Vec<String> = (0..size)
                .map(|k| self.number(format!("system.damping[{term}].coefficient[{k}]"), 0.1, 0.8))
                .collect();
            text += &format!("[[system.damping]]\n{kernel}\ncoefficient = [{}]\n", coefficients.join(", "));
        }
        let position: Vec<String> =
            (0..size).map(|k| self.number(format!("initial.position[{k}]"), -0.8, 0.8)).collect();
        let momentum: Vec<String> =
            (0..size).map(|k| self.number(format!("initial.momentum[{k}]"), -0.5, 0.5)).collect();
        let schemes: Vec<&str> = SCHEMES
            .iter()
            .chain(&STAGED)
            .copied()
            .filter(|scheme| !scheme.contains("exponential-sum"))
            .collect();
        let scheme = schemes[self.below(schemes.len())];
        let step = self.between(0.02, 0.1);
        text + &format!(
            "[initial]\nposition = [{}]\nmomentum = [{}]\n{scheme}\n[time]\nstep = {step}\nsteps = 40\n",
            position.join(", "),
            momentum.join(", ")
        )
    }

    fn with(&self, text: &str, values: &[f64]) -> String {
        let put = |text: String, (k, value): (usize, &f64)| {
            text.replace(&format!("<{k}>"), &format!("{value:.17e}"))
        };
        values.iter().enumerate().fold(text.to_owned(), put)
    }
}

/// Of fifty systems, kernels, schemes and steps, backwards, forwards, and by differences of order six.
#[test]
fn gradients_of_random_systems_are_their_sensitivities_and_differences() {
    let (mut of_sensitivities, mut of_differences) = (0.0, 0.0);
    for seed in 1..=50 {
        let mut drawn = Drawn::new(seed);
        let text = drawn.scenario();
        let chosen = [(); 3].map(|()| drawn.below(drawn.values.len()));
        let drawn = drawn;
        let paths: Vec<String> = drawn.paths.iter().map(|path| format!("\"{path}\"")).collect();
        let whole = format!("{text}[sensitivity]\nparameters = [{}]\n", paths.join(", "));
        let here = drawn.with(&whole, &drawn.values);
        of_sensitivities = max_or_nan(of_sensitivities, error(&here, seed, MOST_BYTES));
        // The function whose gradient that is: a sum over all rows.
        let function = |values: &[f64]| {
            let states = rows(&drawn.with(&text, values)).0;
            let by = numbers(seed, states.len() * states[0].len());
            states.concat().iter().zip(&by).map(|(number, by)| number * by).sum::<f64>()
        };
        let states = rows(&here).0;
        let size = states[0].len() / 2;
        let by = numbers(seed, states.len() * 2 * size);
        let position: Vec<f64> = by.chunks(2 * size).flat_map(|row| &row[..size]).copied().collect();
        let momentum: Vec<f64> = by.chunks(2 * size).flat_map(|row| &row[size..]).copied().collect();
        let found = gradient(&here, MOST_BYTES, (&position, &momentum)).parameters;
        let largest = found.iter().map(|one| one.abs()).fold(1e-3, max_or_nan);
        for parameter in chosen {
            let h = 1e-2 * drawn.values[parameter].abs().max(0.1);
            let at = |by: f64| {
                let mut values = drawn.values.clone();
                values[parameter] += by * h;
                function(&values)
            };
            let pair = |by: f64| at(by) - at(-by);
            let difference = (45.0 * pair(1.0) - 9.0 * pair(2.0) + pair(3.0)) / (60.0 * h);
            let error = (found[parameter] - difference).abs() / largest;
            assert!(
                error < 1e-8,
                "{}: {:e}, not {difference:e}\n{here}",
                drawn.paths[parameter],
                found[parameter]
            );
            of_differences = max_or_nan(of_differences, error);
        }
    }
    eprintln!(
        "largest difference from sensitivities {of_sensitivities:e}, from differences {of_differences:e}"
    );
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
