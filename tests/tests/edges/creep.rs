//! Coordinates without mass under a load from t = 0, or from later on, against inverse Laplace transforms:
//! creep of every kernel, alone, coupled, and beside masses.

use fvi_fft::sums::max_or_nan;
use fvi_host::fit::{Fit, fit};
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::motion::Motion;
use fvi_simulation::simulation::{GridState, Precision};
use nalgebra::{Complex, DMatrix, DVector};
use std::f64::consts::PI;
use std::path::Path;
use std::rc::Rc;
use std::sync::atomic::AtomicBool;

type Symbol = Rc<dyn Fn(Complex<f64>) -> Complex<f64>>;

/// A kernel in a file, K(s), and K(∞) if there is one.
#[derive(Clone)]
struct Kernel {
    keys: String,
    symbol: Symbol,
    unrelaxed: Option<f64>,
    /// True if Runge–Kutta families take it.
    is_for_stages: bool,
}

fn kernel(
    keys: impl Into<String>,
    symbol: impl Fn(Complex<f64>) -> Complex<f64> + 'static,
    unrelaxed: Option<f64>,
) -> Kernel {
    Kernel { keys: keys.into(), symbol: Rc::new(symbol), unrelaxed, is_for_stages: true }
}

fn maxwell(order: f64, inner: f64, time: f64) -> Kernel {
    let symbol = move |s: Complex<f64>| {
        let scaled = s * time;
        scaled.powf(order) / (1.0 + scaled.powf(order - inner))
    };
    let keys = format!(r#"{{ form = "maxwell", order = {order:?}, inner = {inner:?}, time = {time:?} }}"#);
    kernel(keys, symbol, (inner == 0.0).then_some(1.0))
}

fn prony(strengths: &[f64], times: &[f64]) -> Kernel {
    let terms: Vec<(f64, f64)> = strengths.iter().copied().zip(times.iter().copied()).collect();
    let sum = strengths.iter().sum();
    let symbol = move |s: Complex<f64>| {
        terms.iter().map(|&(g, time)| g * time * s / (1.0 + time * s)).sum::<Complex<f64>>()
    };
    kernel(
        format!(r#"{{ form = "prony", strengths = {strengths:?}, times = {times:?} }}"#),
        symbol,
        Some(sum),
    )
}

fn havriliak_negami(order: f64, power: f64, time: f64) -> Kernel {
    let symbol = move |s: Complex<f64>| 1.0 - (1.0 + (s * time).powf(order)).powf(-power);
    let keys =
        format!(r#"{{ form = "havriliak-negami", order = {order:?}, power = {power:?}, time = {time:?} }}"#);
    kernel(keys, symbol, Some(1.0))
}

fn springpot(order: f64) -> Kernel {
    kernel(format!(r#"{{ form = "power", order = {order:?} }}"#), move |s| s.powf(order), None)
}

fn tempered(order: f64, rate: f64) -> Kernel {
    let symbol = move |s: Complex<f64>| (s + rate).powf(order) - rate.powf(order);
    kernel(format!(r#"{{ form = "tempered", order = {order:?}, rate = {rate:?} }}"#), symbol, None)
}

fn formula(
    text: &str,
    symbol: impl Fn(Complex<f64>) -> Complex<f64> + 'static,
    unrelaxed: Option<f64>,
) -> Kernel {
    kernel(format!(r#"{{ symbol = "{text}" }}"#), symbol, unrelaxed)
}

/// A formula for multistep memories.
fn for_steps(kernel: Kernel) -> Kernel {
    Kernel { is_for_stages: false, ..kernel }
}

/// Kernels of every form, with parameters at their edges.
fn kernels() -> Vec<Kernel> {
    let one = Complex::new(1.0, 0.0);
    vec![
        maxwell(0.6, 0.0, 0.3),
        maxwell(0.5, 0.0, 10.0),
        maxwell(0.05, 0.0, 1.0),
        maxwell(0.99, 0.0, 0.5),
        maxwell(1.0, 0.0, 2.0),
        maxwell(0.7, 0.0, 1e-3),
        maxwell(0.7, 0.0, 1e4),
        maxwell(0.6, 0.01, 1.0),
        maxwell(0.9, 0.4, 0.5),
        maxwell(1.0, 0.6, 1.0),
        prony(&[1.0], &[0.3]),
        prony(&[1.0, 0.7, 3.0], &[1.0, 1e-3, 1e5]),
        havriliak_negami(0.7, 0.5, 1.0),
        havriliak_negami(0.1, 1.0, 1.0),
        havriliak_negami(0.95, 0.05, 0.2),
        havriliak_negami(1.0, 0.5, 2.0),
        havriliak_negami(1.0, 1.0, 0.7),
        springpot(0.05),
        springpot(0.5),
        springpot(0.95),
        springpot(1.0),
        tempered(0.5, 0.3),
        for_steps(formula("s/(s + 1)", move |s| s / (s + one), Some(1.0))),
        for_steps(formula("2 + s/(1 + s)", move |s| 2.0 * one + s / (s + one), Some(3.0))),
        formula("0.5 + 1.5*s^0.6/(1 + s^0.6)", |s| 0.5 + 1.5 * s.powf(0.6) / (1.0 + s.powf(0.6)), Some(2.0)),
        for_steps(formula("s^0.05/(1 + s^0.05)", |s| s.powf(0.05) / (1.0 + s.powf(0.05)), Some(1.0))),
        formula("s^0.5 + 0.3", |s| s.sqrt() + 0.3, None),
        for_steps(formula(
            "0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)",
            |s| 0.5 * s * (s + 0.1) / ((s + 0.1).powi(2) + 4.0),
            Some(0.5),
        )),
    ]
}

/// Inverse transforms of a vector at a time t > 0, on Talbot's contour.
pub(super) fn talbot(time: f64, of: impl Fn(Complex<f64>) -> DVector<Complex<f64>>) -> Vec<f64> {
    const POINTS: usize = 44;
    let count = POINTS as f64;
    let term = |k: usize| {
        let theta = PI * (2.0 * (k as f64 + 0.5) / count - 1.0);
        let (sine, cosine) = (0.6407 * theta).sin_cos();
        let cotangent = cosine / sine;
        let scaled = Complex::new(0.5017 * theta * cotangent - 0.6122, 0.2645 * theta) * count;
        let slope =
            Complex::new(0.5017 * cotangent - 0.5017 * 0.6407 * theta / (sine * sine), 0.2645) * count;
        of(scaled / time) * (scaled.exp() * slope / time / Complex::new(0.0, count))
    };
    let sum = (1..POINTS).map(term).fold(term(0), |sum, more| sum + more);
    sum.iter().map(|value| value.re).collect()
}

/// The same by the trapezoidal rule on a line in the right half-plane and Euler's summation.
fn on_a_line(time: f64, of: impl Fn(Complex<f64>) -> DVector<Complex<f64>>) -> Vec<f64> {
    const SHIFT: f64 = 19.0;
    let at = |k: usize| of(Complex::new(0.5 * SHIFT, PI * k as f64) / time).map(|value| value.re);
    let mut sum = at(0) * 0.5;
    let mut sums = Vec::new();
    for k in 1..=54 {
        sum += at(k) * if k % 2 == 0 { 1.0 } else { -1.0 };
        if k >= 40 {
            sums.push(sum.clone());
        }
    }
    while sums.len() > 1 {
        sums = sums.windows(2).map(|pair| (&pair[0] + &pair[1]) * 0.5).collect();
    }
    sums[0].iter().map(|value| value * (0.5 * SHIFT).exp() / time).collect()
}

/// M q̈ + K q + Σ ρ K(D) (q − q₀) = F from rest at q₀, or with K(D) q.
struct Solid {
    masses: Vec<f64>,
    stiffness: DMatrix<f64>,
    terms: Vec<(DMatrix<f64>, Kernel)>,
    force: Vec<f64>,
    rest: Vec<f64>,
    riemann_liouville: bool,
}

impl Solid {
    /// A coordinate on a spring beside a kernel.
    fn alone(stiffness: f64, rho: f64, kernel: Kernel, force: f64, rest: f64) -> Self {
        let one = |entry| DMatrix::from_element(1, 1, entry);
        Self {
            masses: vec![0.0],
            stiffness: one(stiffness),
            terms: vec![(one(rho), kernel)],
            force: vec![force],
            rest: vec![rest],
            riemann_liouville: false,
        }
    }

    fn transform(&self, s: Complex<f64>) -> DVector<Complex<f64>> {
        let complex = |matrix: &DMatrix<f64>| matrix.map(|entry| Complex::new(entry, 0.0));
        let vector = |numbers: &[f64]| {
            DVector::from_iterator(numbers.len(), numbers.iter().map(|&x| Complex::new(x, 0.0)))
        };
        let mass = DMatrix::from_diagonal(&vector(&self.masses));
        let rest = vector(&self.rest);
        let mut matrix = complex(&self.stiffness) + &mass * (s * s);
        let mut right = vector(&self.force) / s + &mass * &rest * s;
        for (rho, kernel) in &self.terms {
            let term = complex(rho) * (kernel.symbol)(s);
            if !self.riemann_liouville {
                right += &term * &rest / s;
            }
            matrix += term;
        }
        matrix.lu().solve(&right).expect("a regular matrix")
    }

    /// q at a time t > 0, known in two ways.
    fn exact(&self, time: f64) -> Vec<f64> {
        let (one, other) = (talbot(time, |s| self.transform(s)), on_a_line(time, |s| self.transform(s)));
        for (one, other) in one.iter().zip(&other) {
            assert!(
                (one - other).abs() < 1e-6 * (1.0 + one.abs()),
                "{one} and {other}: {}",
                self.system("1")
            );
        }
        one
    }

    /// The scenario's system under the force, from a time on.
    fn system(&self, load: &str) -> String {
        let rows = |matrix: &DMatrix<f64>| {
            let rows: Vec<String> =
                matrix.row_iter().map(|row| format!("{:?}", row.iter().collect::<Vec<_>>())).collect();
            format!("[{}]", rows.join(", "))
        };
        let force: Vec<String> = self.force.iter().map(|force| format!("{force:?}*{load}")).collect();
        let derivative = if self.riemann_liouville { "riemann-liouville" } else { "caputo" };
        let terms: Vec<String> = self
            .terms
            .iter()
            .map(|(rho, kernel)| {
                format!(
                    "[[system.damping]]\nkernel = {}\ncoefficient = {}\nderivative = \"{derivative}\"\n",
                    kernel.keys,
                    rows(rho)
                )
            })
            .collect();
        format!(
            "[system]\nmass = {:?}\nstiffness = {}\nforce = {force:?}\n{}[initial]\nposition = {:?}\n",
            self.masses,
            rows(&self.stiffness),
            terms.concat(),
            self.rest
        )
    }

    fn run(&self, load: &str, rest: &str) -> Vec<GridState> {
        let text = format!("{}{rest}", self.system(load));
        let scenario: Scenario = text.parse().unwrap_or_else(|error| panic!("{error}\n{text}"));
        let mut motion =
            Motion::start(&scenario, Precision::F64).unwrap_or_else(|error| panic!("{error}\n{text}"));
        let mut states = vec![motion.state().clone()];
        while !motion.is_done() {
            motion.advance().unwrap_or_else(|failure| panic!("{}\n{text}", failure.reason));
            states.push(motion.state().clone());
        }
        states
    }
}

const MIDPOINT: &str =
    "[scheme]\nkind = \"low-order\"\nkappa = 0.5\n[convolution]\norder = 2\nat = \"nodes\"\n";
const TRAPEZOIDAL: &str =
    "[scheme]\nkind = \"low-order\"\nkappa = 0.5\n[convolution]\nsymbol = \"trapezoidal\"\nat = \"nodes\"\n";
const GAUSS: &str = "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\norder = 3\nat = \"nodes\"\n";
const RADAU_2: &str = "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n";
const RADAU_3: &str = "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 3\n";

/// The position at t = 0+ of a coordinate alone.
fn at_once(solid: &Solid) -> f64 {
    let (rho, kernel) = &solid.terms[0];
    let (rest, pulled) = (solid.rest[0], solid.force[0]);
    match kernel.unrelaxed {
        None => rest,
        Some(modulus) => {
            let modulus = rho[(0, 0)] * modulus;
            let stored = if solid.riemann_liouville { 0.0 } else { modulus * rest };
            (pulled + stored) / (solid.stiffness[(0, 0)] + modulus)
        }
    }
}

fn near(found: f64, exact: f64, bound: f64, what: &str) {
    assert!((found - exact).abs() <= bound, "{found} instead of {exact}, off by {:e}: {what}", found - exact);
}

#[test]
fn known_values_of_a_fractional_zener_solid() {
    let solid = Solid::alone(1.0, 4.0, maxwell(0.6, 0.0, 0.3), 1.0, 0.0);
    let states = solid.run("1", &format!("{MIDPOINT}[time]\nstep = 0.001\nend = 10.0\n"));
    for (step, known) in [(0, 0.2), (100, 0.285), (1000, 0.473), (10_000, 0.775)] {
        near(states[step].position[0], known, 5e-4, "creep");
    }
    for step in [100, 1000, 10_000] {
        near(states[step].position[0], solid.exact(states[step].time)[0], 2e-6, "creep");
    }
}

/// Errors of a run relative to the largest position, at t = 0+ and over the rows from a time on.
fn errors(solid: &Solid, from: f64, rest: &str) -> (f64, f64) {
    let states = solid.run("1", rest);
    let last = states.len() - 1;
    let chosen = (1..=last).filter(|&k| states[k].time >= from && (k % (last / 6).max(1) == 0 || k == last));
    let (mut worst, mut largest) = (0.0_f64, at_once(solid).abs());
    for k in chosen {
        for (found, exact) in states[k].position.iter().zip(solid.exact(states[k].time)) {
            largest = max_or_nan(largest, exact.abs());
            worst = if (found - exact).abs() <= worst { worst } else { (found - exact).abs() };
        }
        assert_eq!(states[k].momentum, [0.0]);
    }
    ((states[0].position[0] - at_once(solid)).abs() / largest, worst / largest)
}

/// Springs, positions at rest, and whether the derivative is Riemann and Liouville's.
const VARIANTS: [(f64, f64, bool); 4] =
    [(1.0, 0.0, false), (0.0, 0.0, false), (1.0, -0.7, false), (1.0, 0.0, true)];

fn check(kernel: &Kernel, variant: usize, (scheme, time, bound): (&str, &str, f64)) {
    let (stiffness, rest, riemann_liouville) = VARIANTS[variant % VARIANTS.len()];
    let solid = Solid { riemann_liouville, ..Solid::alone(stiffness, 4.0, kernel.clone(), 1.0, rest) };
    let (at_once, later) = errors(&solid, 0.2, &format!("{scheme}{time}"));
    let what = format!("{} with {scheme}{time}", solid.system("1"));
    assert!(at_once < 1e-10 && later < bound, "{at_once:e} at once, {later:e} later: {what}");
}

#[test]
fn every_kernel_creeps_from_the_load_on() {
    // The trapezoidal rule leaves errors of alternating sign where K grows slowly.
    let multistep = [
        (MIDPOINT, "[time]\nstep = 0.01\nend = 2.0\n", 4e-4),
        (TRAPEZOIDAL, "[time]\nstep = 0.01\nend = 2.0\n", 1.5e-3),
        (GAUSS, "[time]\nstep = 0.01\nend = 2.0\n", 1e-4),
    ];
    let staged = [
        (RADAU_2, "[time]\nstep = 0.02\nend = 2.0\n", 2e-5),
        (RADAU_3, "[time]\ngrid = \"geometric\"\nfirst = 1e-4\nratio = 1.2\nend = 100.0\n", 5e-6),
        (RADAU_3, "[time]\ngrid = \"graded\"\nexponent = 3.0\nsteps = 60\nend = 2.0\n", 1e-6),
    ];
    for (index, kernel) in kernels().iter().enumerate() {
        for variant in 0..VARIANTS.len() {
            multistep.iter().for_each(|&run| check(kernel, variant, run));
        }
        for (place, &run) in staged.iter().enumerate().filter(|_| kernel.is_for_stages) {
            check(kernel, index + place, run);
        }
    }
}

#[test]
fn adaptive_steps_creep_within_their_tolerance() {
    let kernels = [
        maxwell(0.6, 0.0, 0.3),
        maxwell(1.0, 0.0, 2.0),
        prony(&[1.0, 0.7, 3.0], &[1.0, 1e-3, 1e5]),
        springpot(0.95),
    ];
    for (index, kernel) in kernels.iter().enumerate() {
        for variant in [index, index + 2] {
            let run = (RADAU_3, "[time]\ngrid = \"adaptive\"\ntolerance = 1e-7\nend = 2.0\n", 1e-7);
            check(kernel, variant, run);
        }
    }
}

#[test]
fn creep_data_tell_spring_and_memory() {
    // Compliance of 1 + 4·(0.3 s)^0.6/(1 + (0.3 s)^0.6), at the grid points of four decades and at t = 0.
    let solid = Solid::alone(1.0, 4.0, maxwell(0.6, 0.0, 0.3), 1.0, 0.0);
    let grid = "[time]\ngrid = \"geometric\"\nfirst = 0.001\nratio = 1.1\nend = 10.0\n";
    let mut data = "t,q0\n0,0.2\n".to_owned();
    for state in solid.run("1", &format!("{RADAU_3}{grid}")).iter().skip(1).step_by(6) {
        data += &format!("{:e},{:e}\n", state.time, solid.exact(state.time)[0]);
    }
    let start = Solid::alone(1.5, 2.0, maxwell(0.5, 0.0, 1.0), 1.0, 0.0);
    let scenario = format!("{}{RADAU_3}{grid}", start.system("1"));
    let free = [
        "stiffness[0][0]",
        "damping[0].coefficient[0][0]",
        "damping[0].kernel.order",
        "damping[0].kernel.time",
    ];
    let free = free.map(|path| format!("[[free]]\npath = \"system.{path}\"\nscale = \"log\"\n")).concat();
    let text = format!("scenario = \"scenario.toml\"\n{free}[[data]]\nfile = \"data.csv\"\n");
    let document = Document::new("fit", Path::new(""), &text).with_attached("data.csv", data.as_bytes());
    let plan = Fit::of_scenario(&document, Document::new("scenario", Path::new(""), &scenario))
        .unwrap_or_else(|error| panic!("{error}"));
    let mut found = fit(&plan, &AtomicBool::new(false), &mut |_| ()).unwrap();
    let found = found.models.remove(found.best);
    assert!(found.converged, "{found:#?}");
    for ((path, estimate), truth) in found.parameters.iter().zip([1.0, 4.0, 0.6, 0.3]) {
        assert!((estimate.estimate / truth - 1.0).abs() < 5e-4, "{path}: {found:#?}");
    }
}

/// Systems of several coordinates: stiffness that memories complete, dampers between nodes, masses.
fn coupled() -> Vec<Solid> {
    let matrix = |size: usize, entries: &[f64]| DMatrix::from_row_slice(size, size, entries);
    let pair = || matrix(2, &[1.0, -1.0, -1.0, 1.0]);
    let diagonal = |entries: &[f64]| DMatrix::from_diagonal(&DVector::from_row_slice(entries));
    let of = |masses: &[f64], stiffness, terms, force: &[f64], rest: &[f64]| Solid {
        masses: masses.to_vec(),
        stiffness,
        terms,
        force: force.to_vec(),
        rest: rest.to_vec(),
        riemann_liouville: false,
    };
    vec![
        // A spring between nodes that memories hold.
        of(
            &[0.0; 2],
            pair(),
            vec![(diagonal(&[1.0, 1.0]), maxwell(0.5, 0.0, 1.0))],
            &[1.0, 0.0],
            &[0.0, 0.0],
        ),
        // A mass, and a node between two memories.
        of(
            &[1.0, 0.0],
            diagonal(&[1.0, 0.0]),
            vec![(pair(), maxwell(0.5, 0.0, 1.0)), (diagonal(&[0.0, 0.5]), prony(&[1.0], &[1.0]))],
            &[0.0, 0.3],
            &[1.0, 0.2],
        ),
        // A springpot between nodes: both jump together.
        of(
            &[0.0; 2],
            diagonal(&[1.0, 2.0]),
            vec![(pair(), springpot(0.5)), (diagonal(&[0.0, 1.5]), havriliak_negami(0.7, 0.5, 1.0))],
            &[1.0, 0.0],
            &[0.3, -0.1],
        ),
        // A liquid chain without any spring.
        of(
            &[0.0; 2],
            matrix(2, &[0.0; 4]),
            vec![(pair(), maxwell(0.6, 0.0, 0.5)), (diagonal(&[2.0, 0.0]), prony(&[1.0, 0.5], &[1.0, 0.1]))],
            &[0.0, 1.0],
            &[0.0, 0.0],
        ),
        // Dashpots, springpots and Maxwell elements among two nodes and a mass.
        of(
            &[0.0, 1.0, 0.0],
            matrix(3, &[2.0, -1.0, 0.0, -1.0, 3.0, -1.0, 0.0, -1.0, 2.0]),
            vec![
                (matrix(3, &[1.0, -1.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0, 0.0]), springpot(0.5)),
                (matrix(3, &[1.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0]), maxwell(0.8, 0.0, 0.2)),
            ],
            &[0.0, 0.0, 1.0],
            &[0.0, 0.5, 0.0],
        ),
        // The last with its memories from rest at 0 in the other form.
        Solid {
            riemann_liouville: true,
            ..of(
                &[0.0, 0.0],
                diagonal(&[1.0, 0.5]),
                vec![(matrix(2, &[2.0, -1.0, -1.0, 2.0]), prony(&[1.0, 2.0], &[0.2, 3.0]))],
                &[1.0, -0.5],
                &[0.0, 0.0],
            )
        },
    ]
}

#[test]
fn coupled_coordinates_creep_together() {
    for (index, solid) in coupled().iter().enumerate() {
        // s q̂(s) → q(0+), with s^½ among what is left out.
        let s = Complex::new(1e12, 0.0);
        let at_once = solid.transform(s) * s;
        for (scheme, time, bound) in [
            (MIDPOINT, "[time]\nstep = 0.01\nend = 2.0\n", 1e-4),
            (TRAPEZOIDAL, "[time]\nstep = 0.01\nend = 2.0\n", 2e-4),
            (GAUSS, "[time]\nstep = 0.01\nend = 2.0\n", 5e-5),
            (RADAU_2, "[time]\nstep = 0.01\nend = 2.0\n", 2e-6),
            (RADAU_3, "[time]\ngrid = \"graded\"\nexponent = 3.0\nsteps = 80\nend = 2.0\n", 1e-6),
        ] {
            let states = solid.run("1", &format!("{scheme}{time}"));
            for (found, exact) in states[0].position.iter().zip(at_once.iter()) {
                near(*found, exact.re, 1e-5, &format!("at once, {}", solid.system("1")));
            }
            for k in [states.len() / 2, states.len() - 1] {
                for (found, exact) in states[k].position.iter().zip(solid.exact(states[k].time)) {
                    near(*found, exact, bound, &format!("{index}, {}{scheme}{time}", solid.system("1")));
                }
            }
        }
    }
}

#[test]
fn loads_that_begin_later_act_at_once_too() {
    for kernel in [maxwell(0.6, 0.0, 0.3), prony(&[1.0], &[1.0]), havriliak_negami(0.7, 0.5, 1.0)] {
        for stiffness in [1.0, 0.0] {
            let solid = Solid::alone(stiffness, 1.5, kernel.clone(), 1.0, 0.0);
            for (scheme, time, bound) in [
                (MIDPOINT, "[time]\nstep = 0.01\nend = 3.0\n", 2e-4),
                (GAUSS, "[time]\nstep = 0.01\nend = 3.0\n", 1e-4),
                (RADAU_3, "[time]\nstep = 0.02\nend = 3.0\n", 1e-7),
            ] {
                let states = solid.run("step(t - 1)", &format!("{scheme}{time}"));
                let before = states.iter().filter(|state| state.time < 1.0 - 1e-9);
                before.for_each(|state| assert_eq!(state.position, [0.0]));
                for state in states.iter().filter(|state| state.time > 1.3).step_by(40) {
                    let exact = solid.exact(state.time - 1.0)[0];
                    near(
                        state.position[0],
                        exact,
                        bound,
                        &format!("{}{scheme}{time}", solid.system("later")),
                    );
                }
            }
        }
    }
}

/// A chain of springs and memories, all of it or each second node without mass, with matrices in files.
fn chain(kernel: &Kernel, all: bool, is_sparse: bool) -> Scenario {
    const SIZE: usize = 120;
    let file = |own: f64| {
        let own = (1..=SIZE).map(|row| format!("{row} {row} {own}\n"));
        let beside = (2..=SIZE).map(|row| format!("{row} {} -1\n", row - 1));
        let count = 2 * SIZE - 1;
        let entries: String = own.chain(beside).collect();
        format!("%%MatrixMarket matrix coordinate real symmetric\n{SIZE} {SIZE} {count}\n{entries}")
    };
    let full = |own: f64| {
        let entry = |row: usize, column: usize| match row.abs_diff(column) {
            0 => own,
            1 => -1.0,
            _ => 0.0,
        };
        let row = |row: usize| (0..SIZE).map(|column| entry(row, column)).collect::<Vec<f64>>();
        format!("{:?}", (0..SIZE).map(row).collect::<Vec<_>>())
    };
    let mass: Vec<f64> = (0..SIZE).map(|node| if all { 0.0 } else { (node % 2) as f64 }).collect();
    let force: Vec<String> = (0..SIZE).map(|node| format!("{}", 1 + node % 3)).collect();
    let [stiffness, coefficient] =
        if is_sparse { ["'K.mtx'", "'R.mtx'"].map(String::from) } else { [full(2.5), full(4.0)] };
    let text = format!(
        "[system]\nmass = {mass:?}\nstiffness = {stiffness}\nforce = {force:?}\n[[system.damping]]\nkernel = {}\n\
         coefficient = {coefficient}\n[time]\nstep = 0.01\nsteps = 40\n[output]\ncoordinates = [0]\n",
        kernel.keys
    );
    let document = Document::new("chain.toml", Path::new("."), &text);
    let document = document.with_attached("K.mtx", file(2.5)).with_attached("R.mtx", file(4.0));
    Scenario::from_document(document).unwrap_or_else(|error| panic!("{error}"))
}

fn states_of(scenario: &Scenario, precision: Precision) -> Vec<GridState> {
    let mut motion = Motion::start(scenario, precision).unwrap_or_else(|error| panic!("{error}"));
    let mut states = vec![motion.state().clone()];
    while !motion.is_done() {
        motion.advance().unwrap_or_else(|failure| panic!("{}", failure.reason));
        states.push(motion.state().clone());
    }
    states
}

/// Largest difference of positions, relative to the largest.
fn difference(some: &[GridState], others: &[GridState]) -> f64 {
    let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
    for (some, other) in some.iter().zip(others) {
        for (one, other) in some.position.iter().zip(&other.position) {
            let off = (one - other).abs();
            (worst, largest) = (if off <= worst { worst } else { off }, largest.max(other.abs()));
        }
    }
    worst / largest
}

#[test]
fn sparse_solids_creep_like_full_ones_and_in_single_precision() {
    for kernel in [maxwell(0.6, 0.0, 0.3), havriliak_negami(0.7, 0.5, 1.0), prony(&[1.0, 2.0], &[0.1, 3.0])] {
        for all in [true, false] {
            let sparse = chain(&kernel, all, true);
            let states = states_of(&sparse, Precision::F64);
            assert!(states[0].position[0] > 0.01, "{}: it begins at the glass modulus", kernel.keys);
            let off = difference(&states, &states_of(&chain(&kernel, all, false), Precision::F64));
            assert!(off < 1e-12, "{}, {all}: {off:e}", kernel.keys);
            let off = difference(&states_of(&sparse, Precision::F32), &states);
            assert!(off < 2e-5, "{}, {all}, single precision: {off:e}", kernel.keys);
        }
    }
}

#[test]
fn creep_goes_on_from_a_saved_state_with_the_same_bits() {
    for all in [true, false] {
        let scenario = chain(&maxwell(0.6, 0.0, 0.3), all, true);
        let whole = states_of(&scenario, Precision::F64);
        for at in [0, 1, 17] {
            let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
            (0..at).for_each(|_| assert!(motion.advance().is_ok()));
            let (saved, gathered) = (motion.save().unwrap(), motion.gathered());
            let mut later = Motion::start(&scenario, Precision::F64).unwrap();
            later.resume(at, &saved, gathered, None).unwrap();
            for state in &whole[at + 1..] {
                later.advance().unwrap();
                assert_eq!(later.state().position, state.position, "from step {at}");
            }
        }
    }
}
