//! `[sensitivity]`: derivatives of the discrete motion against differences of runs and dual numbers.

use crate::workplace::{Workplace, text};
use fvi_fft::sums::max_or_nan;
use fvi_host::run::{Run, RunEnd};
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use std::convert::Infallible;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// A scenario with numbers in braces, their values, and the paths of each.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) scenario: &'static str,
    pub(crate) numbers: &'static [(&'static str, f64, &'static str)],
}

/// The scenario with some numbers changed, and derivatives by all of them if wanted.
pub(crate) fn written(case: &Case, scheme: &str, values: &[f64], derivatives: bool) -> String {
    let mut text = case.scenario.replace("{scheme}", scheme);
    for ((name, ..), value) in case.numbers.iter().zip(values) {
        text = text.replace(&format!("{{{name}}}"), &format!("{value:.17e}"));
    }
    if derivatives {
        let paths: Vec<String> = case.numbers.iter().map(|(.., path)| format!("\"{path}\"")).collect();
        text += &format!("[sensitivity]\nparameters = [{}]\n", paths.join(", "));
    }
    text
}

/// The rows of a run: q and p, and the derivatives.
type Rows = (Vec<Vec<f64>>, Vec<Vec<f64>>);

pub(crate) fn rows(text: &str) -> Rows {
    let document = Document::new("scenario.toml", Path::new(""), text);
    let scenario = Scenario::from_document(document).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let (mut motion, mut derivatives) = (Vec::new(), Vec::new());
    let mut run = Run::of(&scenario).start().unwrap_or_else(|error| panic!("{error}\n{text}"));
    let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
        portion.rows(|_, state| {
            motion.push([&state.position[..], &state.momentum].concat());
            derivatives.push(state.sensitivities.clone());
            Ok::<_, Infallible>(())
        })
    });
    assert_eq!(end, RunEnd::Completed, "{text}");
    (motion, derivatives)
}

/// Largest difference of the derivatives from differences of order four, relative to the largest of each.
fn worst(case: &Case, scheme: &str) -> f64 {
    let values: Vec<f64> = case.numbers.iter().map(|(_, value, _)| *value).collect();
    let (motion, found) = rows(&written(case, scheme, &values, true));
    // What is beside the motion does not change it.
    assert_eq!(motion, rows(&written(case, scheme, &values, false)).0, "{}, {scheme}", case.name);
    let size = motion[0].len();
    let mut worst = 0.0_f64;
    for (index, (name, value, _)) in case.numbers.iter().enumerate() {
        let h = 2e-3 * if *value == 0.0 { 1.0 } else { value.abs() };
        let runs = [1.0, -1.0, 2.0, -2.0].map(|by| {
            let mut values = values.clone();
            values[index] += by * h;
            rows(&written(case, scheme, &values, false)).0
        });
        let (mut largest, mut error) = (1e-3_f64, 0.0_f64);
        for (row, found) in found.iter().enumerate() {
            for column in 0..size {
                let [one, other, far, away] = [0, 1, 2, 3].map(|run: usize| runs[run][row][column]);
                let difference = (8.0 * (one - other) - (far - away)) / (12.0 * h);
                largest = max_or_nan(largest, difference.abs());
                error = max_or_nan(error, (found[index * size + column] - difference).abs());
            }
        }
        assert!(error < 1e-7 * largest, "{}, {scheme}, {name}: {:e}", case.name, error / largest);
        worst = max_or_nan(worst, error / largest);
    }
    worst
}

pub(crate) const SCHEMES: [&str; 11] = [
    "",
    "[scheme]\nkappa = 0.3\n[convolution]\norder = 3",
    "[scheme]\nkappa = 0.0\n[convolution]\nat = \"main-nodes\"\norder = 1",
    "[convolution]\nat = \"main-nodes\"\norder = 2\n[output]\nmomentum = \"one-sided\"",
    "[scheme]\nkind = \"galerkin\"\ndegree = 3\n[convolution]\norder = 4\n[output]\nmomentum = \"one-sided\"",
    "[scheme]\nkind = \"galerkin\"\ndegree = 2\nquadrature = \"lobatto\"\n[convolution]\nat = \"main-nodes\"\norder = 2",
    "[history]\nengine = \"block-fft\"",
    "[convolution]\nsymbol = \"trapezoidal\"\n[output]\nmomentum = \"one-sided\"",
    "[history]\nengine = \"exponential-sum\"",
    "[history]\nengine = \"real-time\"\n[scheme]\nkind = \"galerkin\"\ndegree = 2",
    "[scheme]\nkind = \"implicit-euler\"",
];

pub(crate) const PENDULUM: Case = Case {
    name: "pendulum",
    scenario: "[system]\nmass = [{m}]\npotential = \"k*(1 - cos(q0)) + 0.1*c*q0^4\"\nforce = [\"a*sin(w*t)*(1 + 0.1*q0)\"]\n\
        parameters = { k = {k}, c = {c}, a = {a}, w = {w} }\n[[system.damping]]\norder = {beta}\ncoefficient = [{rho}]\n\
        [initial]\nposition = [{q}]\nmomentum = [{p}]\n{scheme}\n[time]\nstep = 0.1\nsteps = 60\n",
    numbers: &[
        ("m", 1.3, "system.mass[0]"),
        ("k", 2.0, "system.parameters.k"),
        ("c", 0.5, "system.parameters.c"),
        ("a", 0.4, "system.parameters.a"),
        ("w", 1.1, "system.parameters.w"),
        ("beta", 0.6, "system.damping[0].order"),
        ("rho", 0.3, "system.damping[0].coefficient[0]"),
        ("q", 0.7, "initial.position[0]"),
        ("p", 0.2, "initial.momentum[0]"),
    ],
};

pub(crate) const LINEAR: Case = Case {
    name: "two masses",
    scenario: "[system]\nmass = [[2.0, {m}], [{m}, 1.0]]\npotential = \"k*q0^2 + 0.7*(q1 - q0)^2\"\nforce = [\"0\", \"cos(t)\"]\n\
        parameters = { k = {k} }\n[[system.damping]]\norder = {beta}\ncoefficient = [[{r}, {s}], [{s}, 0.4]]\n\
        derivative = \"riemann-liouville\"\n[[system.damping]]\ncoefficient = [0.3, {c}]\n\
        kernel = { form = \"maxwell\", order = {order}, inner = {inner}, time = {tau} }\n\
        [initial]\nposition = [{q}, 0.0]\nvelocity = [0.1, {v}]\n{scheme}\n[time]\nstep = 0.1\nsteps = 60\n",
    numbers: &[
        ("m", 0.3, "system.mass[0][1]"),
        ("k", 1.5, "system.parameters.k"),
        ("beta", 1.4, "system.damping[0].order"),
        ("r", 0.5, "system.damping[0].coefficient[0][0]"),
        ("s", 0.1, "system.damping[0].coefficient[0][1]"),
        ("c", 0.2, "system.damping[1].coefficient[1]"),
        ("order", 0.8, "system.damping[1].kernel.order"),
        ("inner", 0.2, "system.damping[1].kernel.inner"),
        ("tau", 0.7, "system.damping[1].kernel.time"),
        ("q", 0.6, "initial.position[0]"),
        ("v", -0.2, "initial.velocity[1]"),
    ],
};

pub(crate) const KERNELS: Case = Case {
    name: "kernels",
    scenario: "[system]\nmass = [1.0]\npotential = \"q0^2 + 0.3*q0^4\"\n[[system.damping]]\ncoefficient = [0.5]\n\
        kernel = { form = \"tempered\", order = {b}, rate = {a} }\n[[system.damping]]\ncoefficient = [0.4]\n\
        kernel = { form = \"prony\", strengths = [1.0, {g}], times = [{u}, 0.1] }\n[[system.damping]]\ncoefficient = [0.4]\n\
        kernel = { form = \"havriliak-negami\", order = {h}, power = {n}, time = {x} }\n[[system.damping]]\n\
        coefficient = [{z}]\nkernel = { symbol = \"0.5 + s^0.6/(1 + s^0.6)\" }\n[[system.damping]]\norder = {e}\n\
        attached = [[1.0, 0.5]]\nstrength = [0.1, {l}]\n\
        [initial]\nposition = [{q}]\nvelocity = [0.3]\n{scheme}\n[time]\nstep = 0.1\nsteps = 60\n",
    numbers: &[
        ("b", 1.3, "system.damping[0].kernel.order"),
        ("a", 0.4, "system.damping[0].kernel.rate"),
        ("g", 0.7, "system.damping[1].kernel.strengths[1]"),
        ("u", 1.2, "system.damping[1].kernel.times[0]"),
        ("h", 0.7, "system.damping[2].kernel.order"),
        ("n", 0.6, "system.damping[2].kernel.power"),
        ("x", 0.8, "system.damping[2].kernel.time"),
        ("z", 0.3, "system.damping[3].coefficient[0]"),
        ("e", 1.6, "system.damping[4].order"),
        ("l", 0.2, "system.damping[4].strength[1]"),
        ("q", 0.6, "initial.position[0]"),
    ],
};

/// For matrix weights.
pub(crate) const STAGES: Case = Case {
    name: "stages",
    scenario: "[system]\nmass = [{m}, 1.0]\npotential = \"k*q0^2 + q1^2 + 0.2*(q1 - q0)^4\"\n\
        force = [\"-d*v0^3 + 0.1*q1*v1\", \"-0.2*v1\"]\nparameters = { k = {k}, d = {d} }\n\
        [[system.damping]]\norder = {b}\ncoefficient = [{r}, 0.1]\n[[system.damping]]\ncoefficient = [0.3, {c}]\n\
        kernel = { form = \"maxwell\", order = {o}, inner = {i}, time = {u} }\nderivative = \"riemann-liouville\"\n\
        [initial]\nposition = [{q}, 0.4]\nvelocity = [0.1, {v}]\n{scheme}\n[time]\nstep = 0.1\nsteps = 60\n",
    numbers: &[
        ("m", 1.4, "system.mass[0]"),
        ("k", 1.5, "system.parameters.k"),
        ("d", 0.3, "system.parameters.d"),
        ("r", 0.5, "system.damping[0].coefficient[0]"),
        ("c", 0.2, "system.damping[1].coefficient[1]"),
        ("b", 1.3, "system.damping[0].order"),
        ("o", 0.8, "system.damping[1].kernel.order"),
        ("i", 0.2, "system.damping[1].kernel.inner"),
        ("u", 0.7, "system.damping[1].kernel.time"),
        ("q", 0.6, "initial.position[0]"),
        ("v", -0.2, "initial.velocity[1]"),
    ],
};

/// For starting weights.
pub(crate) const STARTING: Case = Case {
    name: "starting",
    scenario: "[system]\nmass = [{m}]\npotential = \"q0^2\"\nforce = [\"a*cos(2*t)\"]\nparameters = { a = {a} }\n[[system.damping]]\n\
        order = 0.6\ncoefficient = [{r}]\n[initial]\nposition = [{q}]\n{scheme}\n[time]\nstep = 0.1\nsteps = 60\n",
    numbers: &[
        ("m", 1.4, "system.mass[0]"),
        ("a", 1.5, "system.parameters.a"),
        ("r", 0.5, "system.damping[0].coefficient[0]"),
        ("q", 0.6, "initial.position[0]"),
    ],
};

/// Matrices of a frame, elements and loads with a common constant, on springs of rows.
pub(crate) const LARGE: Case = Case {
    name: "large",
    scenario: "[system]\nmass = [1.0, {m}, 2.0]\nstiffness = [[4.0, {s}, 0.0], [{s}, 3.0, -1.0], [0.0, -1.0, 2.0]]\n\
        parameters = { k = {k} }\n[[system.element]]\npotential = \"k*(x1 - x0)^4 + 0.1*x0^2*k^2\"\n\
        coordinates = [[0, 1], [2, 1]]\n[[system.load]]\npattern = { coordinate = 1, value = 2.0 }\n\
        amplitude = \"sin(k*t)\"\n[[system.damping]]\norder = {b}\ncoefficient = [{r}, 0.0, 0.2]\n\
        [initial]\nposition = [{q}, 0.1, -0.3]\n{scheme}\n[time]\nstep = 0.1\nsteps = 60\n",
    numbers: &[
        ("m", 1.4, "system.mass[1]"),
        ("s", -1.2, "system.stiffness[0][1]"),
        ("k", 0.8, "system.parameters.k"),
        ("b", 0.5, "system.damping[0].order"),
        ("r", 0.3, "system.damping[0].coefficient[0]"),
        ("q", 0.6, "initial.position[0]"),
    ],
};

/// Constants in symbols, one of which is in the potential too; the second kernel has a spring.
pub(crate) const SYMBOLS: Case = Case {
    name: "symbols",
    scenario: "[system]\nmass = [1.0, 1.3]\npotential = \"k*q0^2 + q1^2 + 0.2*(q1 - q0)^4\"\n\
        parameters = { k = {k}, b = {b}, tau = {tau}, d = {d} }\n[[system.damping]]\ncoefficient = [0.5, 0.2]\n\
        kernel = { symbol = \"(tau*s)^b/(1 + (tau*s)^b)\" }\n[[system.damping]]\ncoefficient = [0.4, {c}]\n\
        kernel = { symbol = \"0.4*k + d*s^(2*b)\" }\n\
        [initial]\nposition = [{q}, 0.1]\nvelocity = [0.3, 0.0]\n{scheme}\n[time]\nstep = 0.1\nsteps = 60\n",
    numbers: &[
        ("k", 1.2, "system.parameters.k"),
        ("b", 0.4, "system.parameters.b"),
        ("tau", 0.7, "system.parameters.tau"),
        ("d", 0.6, "system.parameters.d"),
        ("c", 0.3, "system.damping[1].coefficient[1]"),
        ("q", 0.6, "initial.position[0]"),
    ],
};

/// A rotor: gyroscopic forces beside damping, of which one number is in two entries.
pub(crate) const GYROSCOPIC: Case = Case {
    name: "gyroscopic",
    scenario: "[system]\nmass = [{m}, 1.3]\npotential = \"q0^2 + 1.5*q1^2 + 0.3*q0^4\"\ngyroscopic = [[0.0, -{g}], [{g}, 0.0]]\n[[system.damping]]\norder = {b}\ncoefficient = [0.2, {c}]\n\
        [initial]\nposition = [{q}, 0.1]\nvelocity = [0.3, 0.0]\n{scheme}\n[time]\nstep = 0.1\nsteps = 60\n\
        allow_unstable = true\n",
    numbers: &[
        ("m", 1.2, "system.mass[0]"),
        ("g", 0.7, "system.gyroscopic[1][0]"),
        ("b", 0.4, "system.damping[0].order"),
        ("c", 0.3, "system.damping[0].coefficient[1]"),
        ("q", 0.6, "initial.position[0]"),
    ],
};

/// A motion before the start, at a time other than zero: three steps of one row each, or of two.
pub(crate) const PAST: Case = Case {
    name: "past",
    scenario: "[system]\nmass = [1.0, {m}]\npotential = \"q0^2 + 1.2*q1^2 + 0.3*(q1 - q0)^4\"\n\
        force = [\"a*sin(t)\", \"0\"]\nparameters = { a = {a} }\n[[system.damping]]\norder = {b}\n\
        coefficient = [0.5, {c}]\n[[system.damping]]\ncoefficient = [0.2, 0.1]\nkernel = { symbol = \"0.5*a + s^0.5\" }\n\
        [initial]\nposition = [{q}, 0.1]\nvelocity = [0.3, {v}]\n\
        past = [[{x}, 0.2], [0.1, {y}], [0.3, 0.0], [0.4, 0.1], [0.45, 0.1], [0.5, 0.1]]\n\
        {scheme}\n[time]\nstart = 0.7\nstep = 0.1\nsteps = 40\n",
    numbers: &[
        ("m", 1.2, "system.mass[1]"),
        ("a", 0.7, "system.parameters.a"),
        ("b", 1.4, "system.damping[0].order"),
        ("c", 0.3, "system.damping[0].coefficient[1]"),
        ("q", 0.6, "initial.position[0]"),
        ("v", 0.2, "initial.velocity[1]"),
        ("x", 0.1, "initial.past[0][0]"),
        ("y", 0.3, "initial.past[1][1]"),
    ],
};

/// Begins later than at t = 0, with Caputo's derivative of a motion with a velocity.
pub(crate) const LATER: Case = Case {
    name: "later",
    scenario: "[system]\nmass = [{m}]\npotential = \"q0^4\"\nforce = [\"a*sin(2*t)\"]\nparameters = { a = {a} }\n\
        [[system.damping]]\norder = {b}\ncoefficient = [{c}]\n[initial]\nposition = [{q}]\nvelocity = [{v}]\n\
        {scheme}\n[time]\nstart = 0.8\nstep = 0.1\nsteps = 40\n",
    numbers: &[
        ("m", 1.2, "system.mass[0]"),
        ("a", 0.7, "system.parameters.a"),
        ("b", 1.4, "system.damping[0].order"),
        ("c", 0.3, "system.damping[0].coefficient[0]"),
        ("q", 0.6, "initial.position[0]"),
        ("v", 0.2, "initial.velocity[0]"),
    ],
};

#[test]
fn constants_of_symbols_gyroscopic_entries_and_pasts_are_differences_of_runs() {
    let radau =
        "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 2";
    for scheme in ["", SCHEMES[1], SCHEMES[3], SCHEMES[4], SCHEMES[7], SCHEMES[10], radau] {
        worst(&SYMBOLS, scheme);
    }
    for scheme in ["", SCHEMES[1], SCHEMES[6], "[scheme]\nkind = \"galerkin\"\ndegree = 3"] {
        worst(&GYROSCOPIC, scheme);
    }
    for scheme in ["", SCHEMES[2], SCHEMES[3], SCHEMES[6], SCHEMES[10], SCHEMES[9]] {
        worst(&PAST, scheme);
        worst(&LATER, scheme);
    }
}

#[test]
fn derivatives_are_differences_of_runs() {
    let mut worst_of_all = 0.0_f64;
    for case in [&PENDULUM, &LINEAR, &KERNELS, &LARGE] {
        for scheme in SCHEMES {
            // Tables of exponentials take long to make.
            if case.name == "pendulum" || !scheme.contains("exponential-sum") {
                worst_of_all = max_or_nan(worst_of_all, worst(case, scheme));
            }
        }
    }
    for case in [&PENDULUM, &LINEAR] {
        worst_of_all = max_or_nan(worst_of_all, worst(case, "[scheme]\nkind = \"explicit-euler\""));
    }
    let forgetting =
        "[convolution]\norder = 2\n[history]\nengine = \"direct\"\ncapacity = 20\noverflow = \"forget\"";
    worst_of_all = max_or_nan(worst_of_all, worst(&PENDULUM, forgetting));
    for scheme in [
        "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 2",
        "[scheme]\nkind = \"galerkin\"\ndegree = 3\n[convolution]\nfamily = \"lobatto-iiic\"\nstages = 4",
        "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 3\n[history]\nengine = \"block-fft\"",
        "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 1",
        "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 3",
        "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n[history]\nengine = \"exponential-sum\"",
    ] {
        worst_of_all = max_or_nan(worst_of_all, worst(&STAGES, scheme));
    }
    worst_of_all =
        max_or_nan(worst_of_all, worst(&STARTING, "[convolution]\norder = 2\nstarting = [0.0, 1.0]"));
    assert!(worst_of_all > 0.0);
    eprintln!("largest difference: {worst_of_all:e}");
}

/// A number with its derivatives by seven others.
#[derive(Clone, Copy, Debug)]
struct Dual(f64, [f64; 7]);

impl Dual {
    fn constant(value: f64) -> Self {
        Self(value, [0.0; 7])
    }

    fn variable(value: f64, index: usize) -> Self {
        Self(value, std::array::from_fn(|other| if other == index { 1.0 } else { 0.0 }))
    }

    fn map(self, value: f64, slope: f64) -> Self {
        Self(value, self.1.map(|d| slope * d))
    }
}

impl std::ops::Add for Dual {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0, std::array::from_fn(|i| self.1[i] + other.1[i]))
    }
}

impl std::ops::Sub for Dual {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0, std::array::from_fn(|i| self.1[i] - other.1[i]))
    }
}

impl std::ops::Mul for Dual {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        self.map(self.0 * other.0, other.0) + other.map(0.0, self.0)
    }
}

impl std::ops::Div for Dual {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        self * other.map(1.0 / other.0, -1.0 / (other.0 * other.0))
    }
}

/// A scheme that is written out.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    Midpoint,
    MainNodes,
    Implicit,
}

/// m, k, c, ρ, β, q₀, v₀ of m q̈ + k sin q + c q³ + ρ D^β q = 0: rows (q, p) of the midpoint rule with BDF 2
/// at the node, or BDF 1 at the main nodes, or of the implicit Euler method with BDF 1, written out. The last
/// is collocation with the one stage of Radau IIA too.
fn by_hand(numbers: [f64; 7], h: f64, steps: usize, way: Way) -> Vec<[Dual; 2]> {
    let [m, k, c, rho, beta, q0, v0] = std::array::from_fn(|i| Dual::variable(numbers[i], i));
    let number = Dual::constant;
    let (main_nodes, at_end) = (way == Way::MainNodes, way == Way::Implicit);
    let gamma: Vec<f64> = if way == Way::Midpoint { vec![1.5, -2.0, 0.5] } else { vec![1.0, -1.0] };
    let gamma: Vec<f64> = gamma.iter().map(|g| g / h).collect();
    // w₀ = γ₀^β, and the recursion for powers of a polynomial.
    let logarithm = gamma[0].ln();
    let first = (beta.0 * logarithm).exp();
    let mut weights = vec![beta.map(first, first * logarithm)];
    for n in 1..=steps + 1 {
        let mut sum = number(0.0);
        for (j, &g) in gamma.iter().enumerate().skip(1).take(n) {
            let factor = beta * number(j as f64) - number((n - j) as f64);
            sum = sum + factor * number(g) * weights[n - j];
        }
        weights.push(sum / number(n as f64 * gamma[0]));
    }
    let (mut q, mut p) = (q0, m * v0);
    // What Caputo's derivative acts on.
    let acted = |x: Dual, time: f64| x - q0 - if beta.0 > 1.0 { v0 * number(time) } else { number(0.0) };
    let mut samples: Vec<Dual> = if main_nodes { vec![acted(q, 0.0)] } else { Vec::new() };
    let force = |x: Dual| k * x.map(x.0.sin(), x.0.cos()) + c * x * x * x;
    let slope = |x: f64| k.0 * x.cos() + 3.0 * c.0 * x * x;
    let mut rows = vec![[q, p]];
    for step in 0..steps {
        let known =
            (1..=samples.len()).fold(number(0.0), |sum, j| sum + weights[j] * samples[samples.len() - j]);
        // Where the forces are taken, and how much of them moves the position.
        let node = if at_end { 1.0 } else { 0.5 };
        let middle = (step as f64 + node) * h;
        let mut e = p / m * number(h);
        let mut pull = number(0.0);
        for _ in 0..40 {
            let x = q + e * number(node);
            pull = force(x);
            let mut own = slope(x.0);
            if !main_nodes {
                pull = pull + rho * (known + weights[0] * acted(x, middle));
                own += rho.0 * weights[0].0;
            }
            let residual = p - m * e / number(h) - pull * number(node * h);
            e = e + residual / number(m.0 / h + node * node * h * own);
        }
        let mut kick = number(0.0);
        if main_nodes {
            let next = acted(q + e, (step as f64 + 1.0) * h);
            kick = rho * (known + weights[0] * next);
            samples.push(next);
        } else {
            samples.push(acted(q + e * number(node), middle));
        }
        q = q + e;
        p = p - (pull + kick) * number(h);
        // Half of the kick is still to come in the momentum that is reported.
        rows.push([q, p + kick * number(0.5 * h)]);
    }
    rows
}

#[test]
fn derivatives_are_those_of_dual_numbers_in_a_hundred_random_scenarios() {
    let paths = "\"system.mass[0]\", \"system.parameters.k\", \"system.parameters.c\", \"system.damping[0].coefficient[0]\", \
        \"system.damping[0].order\", \"initial.position[0]\", \"initial.velocity[0]\"";
    let mut random = fastrand::Rng::with_seed(35);
    let mut worst = 0.0_f64;
    for number in 0..100 {
        let mut between = |low: f64, high: f64| low + (high - low) * random.f64();
        let (way, convolution) = [
            (Way::Midpoint, "[convolution]\norder = 2"),
            (Way::MainNodes, "[convolution]\nat = \"main-nodes\"\norder = 1"),
            (Way::Implicit, "[scheme]\nkind = \"implicit-euler\""),
            (
                Way::Implicit,
                "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 1",
            ),
        ][number % 4];
        let numbers = [
            between(0.5, 2.0),
            between(0.2, 3.0),
            between(0.0, 1.0),
            between(0.05, 0.8),
            between(0.15, if way == Way::MainNodes { 1.2 } else { 1.9 }),
            between(-1.0, 1.0),
            between(-1.0, 1.0),
        ];
        let [m, k, c, rho, beta, q0, v0] = numbers;
        let (h, steps) = (between(0.02, 0.1), 80);
        let engine = ["direct", "block-fft", "real-time"][number % 3];
        let text = format!(
            "[system]\nmass = [{m:?}]\npotential = \"-k*cos(q0) + c*q0^4/4\"\nparameters = {{ k = {k:?}, c = {c:?} }}\n\
             [[system.damping]]\norder = {beta:?}\ncoefficient = [{rho:?}]\n[initial]\nposition = [{q0:?}]\n\
             velocity = [{v0:?}]\n{convolution}\n[history]\nengine = \"{engine}\"\n\
             [time]\nstep = {h:?}\nsteps = {steps}\n[sensitivity]\nparameters = [{paths}]\n"
        );
        let (motion, found) = rows(&text);
        let known = by_hand(numbers, h, steps, way);
        let mut largest = [1e-3_f64; 7];
        for row in &known {
            for (parameter, largest) in largest.iter_mut().enumerate() {
                *largest = largest.max(row[0].1[parameter].abs()).max(row[1].1[parameter].abs());
            }
        }
        for (row, known) in known.iter().enumerate() {
            assert!((motion[row][0] - known[0].0).abs() < 1e-11, "{text}: {row}");
            for parameter in 0..7 {
                for (place, dual) in known.iter().enumerate() {
                    let error = (found[row][2 * parameter + place] - dual.1[parameter]).abs();
                    worst = max_or_nan(worst, error / largest[parameter]);
                    assert!(error < 1e-10 * largest[parameter], "{text}: {row}, {parameter}, {error:e}");
                }
            }
        }
    }
    eprintln!("largest difference from dual numbers: {worst:e}");
}

const PLAIN: &str = "[system]\nmass = [1.0]\npotential = \"k*q0^2\"\nparameters = { k = 1.0, a = 2.0 }\n[[system.damping]]\n\
    order = 0.5\ncoefficient = [0.1]\n[initial]\nposition = [1.0]\n[time]\nstep = 0.1\nsteps = 10\n";

/// An entry off the diagonal changes together with its mirror image, in mechanisms too.
#[test]
fn entries_off_the_diagonal_are_differences_of_runs() {
    let written = |entry: f64, more: &str| {
        format!(
            "[system]\nmass = [1.0, 1.0]\npotential = \"q0^2 + q1^2\"\n[[system.damping]]\norder = 0.5\n\
             along = [\"q0\", \"q1\"]\ncoefficient = [[1.0, {entry:?}], [{entry:?}, 0.5]]\n\
             [initial]\nposition = [1.0, 0.5]\nvelocity = [0.5, 0.0]\n[time]\nstep = 0.02\nend = 1.0\n{more}"
        )
    };
    let sought = "[sensitivity]\nparameters = [\"system.damping[0].coefficient[0][1]\"]\n";
    let (_, derivatives) = rows(&written(0.3, sought));
    let [(above, _), (below, _)] = [0.301, 0.299].map(|entry| rows(&written(entry, "")));
    let last = |rows: &[Vec<f64>]| rows.last().unwrap().clone();
    for ((above, below), found) in last(&above).iter().zip(last(&below)).zip(last(&derivatives)) {
        assert!(((above - below) / 0.002 - found).abs() < 1e-5, "{above} {below} {found}");
    }
}

#[test]
fn derivatives_are_columns_behind_the_energy() {
    let place = Workplace::new();
    let asked = "[output]\nevery = 5\n[sensitivity]\nparameters = [\"system.damping[0].order\", \"system.parameters.k\"]\n";
    let run = place.run(&format!("{PLAIN}{asked}"), &[]);
    assert_eq!(run.columns, ["t", "q0", "p0", "energy", "dq0_d0", "dp0_d0", "dq0_d1", "dp0_d1"]);
    assert_eq!(run.rows.len(), 3);
    // At t = 0 nothing has come of them; a parameter that occurs nowhere changes nothing.
    assert_eq!(run.rows[0][4..], [0.0; 4]);
    assert_eq!(run.summary["scenario"]["sensitivity"]["parameters"][1], "system.parameters.k");
    let nothing = place.run(&format!("{PLAIN}[sensitivity]\nparameters = [\"system.parameters.a\"]\n"), &[]);
    assert!(nothing.column("dq0_d0").iter().all(|&x| x == 0.0));
}

#[test]
fn what_is_not_differentiated_is_refused_with_key_and_reason() {
    let place = Workplace::new();
    let refused = |scenario: &str, arguments: &[&str], reason: &str| {
        place.write("scenario.toml", scenario);
        let output = place.fvi(&[&["run", "scenario.toml", "--out", "out"], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{scenario}");
        assert!(text(&output.stderr).contains(reason), "{reason}: {}", text(&output.stderr));
    };
    let by = |path: &str| format!("{PLAIN}[sensitivity]\nparameters = [\"{path}\"]\n");
    for (path, reason) in [
        ("system.damping[1].order", "below 1"),
        ("system.damping[0].kernel.order", "a number that the damping term has"),
        ("system.mass[0][0]", "the matrix is a diagonal"),
        ("system.mass[3]", "below 1"),
        ("system.stiffness[0]", "there is no `system.stiffness`"),
        ("system.parameters.z", "one of `system.parameters`: a, k"),
        ("initial.velocity[0]", "gives no velocity"),
        ("time.step", "system.parameters.NAME"),
        ("system.mass[0", "system.parameters.NAME"),
        ("", "system.parameters.NAME"),
    ] {
        refused(&by(path), &[], reason);
    }
    let good = by("system.parameters.k");
    refused(&good, &["--precision", "f32"], "single precision");
    refused(&good, &["--format", "npz"], "columns of `trajectory.csv`");
    refused(&format!("{PLAIN}[sensitivity]\nparameters = []\n"), &[], "one path at least");
    refused(&good.replace("k\"]", "k\", \"system.parameters.k\"]"), &[], "paths that differ");
    let controller = "[controller]\nkind = \"fractional-pid\"\nmeasures = \"q0\"\nsetpoint = \"1\"\ndrives = [1.0]\nkp = 2.0\nsample = 0.1\n";
    refused(&format!("{good}{controller}"), &[], "loops that are open");
    refused(&format!("{good}[[event]]\nwhen = \"q0\"\n"), &[], "nothing looks into");
    refused(&format!("{good}[output]\ntimes = [0.05]\n"), &[], "rows at grid points");
    let forced = |force: &str| {
        good.replace("[[system.damping]]", &format!("force = [\"{force}\"]\n[[system.damping]]"))
    };
    for kinked in ["-k*sign(q0)", "-k*abs(v0)", "-k*sign(v0)*abs(v0)^0.5", "-max(q0, 0)*v0"] {
        refused(&forced(kinked), &[], "whose slopes in position and velocity are continuous");
    }
    refused(&forced("k*step(0.33 - t)"), &[], "exact moments");
    // At the nodes it is a force as others are.
    let at_nodes = forced("k*step(0.33 - t)")
        .replace("[[system.damping]]", "force_quadrature = \"nodes\"\n[[system.damping]]");
    place.run(&at_nodes, &[]);
    let order = |more: &str| format!("{}{more}", by("system.damping[0].order"));
    refused(&order("[convolution]\norder = 2\nstarting = [0.0]\n"), &[], "without `convolution.starting`");
    refused(&order("").replace("order = 0.5", "order = 0.0"), &[], "Caputo's derivative jumps there");
    let symbol = by("system.parameters.a").replace("order = 0.5", "kernel = { symbol = \"gamma(a)*s^0.5\" }");
    refused(&symbol, &[], "a constant that a symbol does not have in gamma");
}

#[test]
fn large_systems_are_differentiated_by_their_sparse_factors() {
    // 700 coordinates in a chain, more than full matrices are solved for, beside 40 by a full matrix.
    let chain = |size: usize, mass: f64, k: f64, order: f64, asked: bool| {
        let list = |f: &dyn Fn(usize) -> String| (0..size).map(f).collect::<Vec<_>>().join(", ");
        let mut text = format!(
            "[system]\nmass = [{}]\nparameters = {{ k = {k:?} }}\n[[system.element]]\npotential = \"k*(x1 - x0)^2 + (x1 - x0)^4\"\n\
             coordinates = [{}]\n[[system.element]]\npotential = \"x0^2\"\ncoordinates = [{}]\n\
             [[system.damping]]\norder = {order:?}\ncoefficient = [{}]\n[initial]\nposition = [{}]\n[convolution]\norder = 2\n\
             at = \"nodes\"\n[time]\nstep = 0.1\nsteps = 12\n[output]\ncoordinates = [0, 3, 5, 9]\n",
            list(&|i| if i == 3 { format!("{mass:?}") } else { "1.0".to_owned() }),
            (1..size).map(|i| format!("[{}, {i}]", i - 1)).collect::<Vec<_>>().join(", "),
            list(&|i| format!("[{i}]")),
            list(&|_| "0.2".to_owned()),
            list(&|i| format!("{:?}", if i < 6 { 0.3 * (i as f64).cos() } else { 0.0 })),
        );
        if asked {
            text += "[sensitivity]\nparameters = [\"system.mass[3]\", \"system.parameters.k\", \"system.damping[0].order\"]\n";
        }
        text
    };
    let numbers = [1.3, 0.8, 0.6];
    let of = |size, [mass, k, order]: [f64; 3], asked| rows(&chain(size, mass, k, order, asked));
    for size in [40, 700] {
        let (motion, found) = of(size, numbers, true);
        assert_eq!(motion, of(size, numbers, false).0);
        for index in 0..3 {
            let h = 1e-3;
            let beside = [1.0, -1.0, 2.0, -2.0].map(|by| {
                let mut numbers = numbers;
                numbers[index] += by * h;
                of(size, numbers, false).0
            });
            let (mut largest, mut error) = (0.0_f64, 0.0_f64);
            for (row, found) in found.iter().enumerate() {
                for column in 0..found.len() / 3 {
                    let [one, other, far, away] = [0, 1, 2, 3].map(|run: usize| beside[run][row][column]);
                    let difference = (8.0 * (one - other) - (far - away)) / (12.0 * h);
                    largest = max_or_nan(largest, difference.abs());
                    error = max_or_nan(error, (found[index * found.len() / 3 + column] - difference).abs());
                }
            }
            assert!(error < 1e-8 * largest, "{size}, {index}: {error:e} of {largest:e}");
        }
    }
}

/// v|v| and the like have continuous slopes, though their factors have none.
#[test]
fn drag_is_differentiated() {
    for force in ["-c*v0*abs(v0)", "-c*sign(v0)*abs(v0)^1.5", "-c*v0*abs(v0) - q0*abs(q0)"] {
        let scenario = |c: f64, asked: &str| {
            rows(&format!(
                "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\nforce = [\"{force}\"]\nparameters = {{ c = {c:?} }}\n\
                 [initial]\nposition = [1.0]\n[time]\nstep = 0.05\nend = 8.0\n{asked}"
            ))
        };
        let (_, found) = scenario(0.3, "[sensitivity]\nparameters = [\"system.parameters.c\"]\n");
        let h = 1e-4;
        let [more, less] = [0.3 + h, 0.3 - h].map(|c| scenario(c, "").0);
        for ((found, more), less) in found.iter().zip(&more).zip(&less) {
            for column in 0..2 {
                let difference = (more[column] - less[column]) / (2.0 * h);
                assert!((found[column] - difference).abs() < 1e-6, "{force}: {} {difference}", found[column]);
            }
        }
    }
}
