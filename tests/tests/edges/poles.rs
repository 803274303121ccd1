//! Poles of damped structures against the eigenvalues of an equivalent system of first order, and rational
//! symbols against the Prony series and the differential equations that they are.

use fvi_fft::sums::{max_or_nan, min_or_nan};
use std::f64::consts::PI;
use std::path::Path;

use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::GridState;
use fvi_simulation::simulation::motion::Motion;
use fvi_simulation::simulation::response::Linearised;
use fvi_simulation::simulation::{Precision, Simulation};
use nalgebra::{Complex, DMatrix, DVector};

use crate::kernels::of_ode;
use crate::variable_steps::noise;

fn scenario(text: &str) -> Scenario {
    let document = Document::new("edges.toml", Path::new("."), text);
    Scenario::from_document(document).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// A structure with a unit mass at every coordinate, and kernels that act on combinations of them.
struct Structure {
    stiffness: DMatrix<f64>,
    kernels: Vec<Kernel>,
}

/// b bᵀ K(s) with K = s C (s − A)⁻¹ B + D s, and its text in a scenario.
struct Kernel {
    text: String,
    direction: DVector<f64>,
    matrix: DMatrix<f64>,
    input: DVector<f64>,
    output: DVector<f64>,
    dashpot: f64,
}

impl Kernel {
    fn prony(strengths: &[f64], times: &[f64], direction: &[f64]) -> Self {
        let rates = times.iter().map(|time| -1.0 / time).collect::<Vec<_>>();
        Self {
            text: format!("kernel = {{ form = \"prony\", strengths = {strengths:?}, times = {times:?} }}"),
            direction: DVector::from_column_slice(direction),
            matrix: DMatrix::from_diagonal(&DVector::from_vec(rates)),
            input: DVector::from_element(times.len(), 1.0),
            output: DVector::from_column_slice(strengths),
            dashpot: 0.0,
        }
    }

    /// c s (s + e)/(s² + a s + b) + d s.
    fn resonator([c, e, a, b, d]: [f64; 5], direction: &[f64]) -> Self {
        Self {
            text: format!(
                "allow_active = true\nkernel = {{ symbol = \"{c:?}*s*(s + {e:?})/(s^2 + {a:?}*s + {b:?}) + {d:?}*s\" }}"
            ),
            direction: DVector::from_column_slice(direction),
            matrix: DMatrix::from_row_slice(2, 2, &[0.0, 1.0, -b, -a]),
            input: DVector::from_column_slice(&[0.0, 1.0]),
            output: DVector::from_column_slice(&[c * e, c]),
            dashpot: d,
        }
    }
}

impl Structure {
    fn text(&self) -> String {
        let size = self.stiffness.nrows();
        let terms = self.kernels.iter().map(|kernel| {
            let coefficient = &kernel.direction * kernel.direction.transpose();
            format!("[[system.damping]]\ncoefficient = {}\n{}\n", rows(&coefficient), kernel.text)
        });
        format!(
            "[system]\nmass = {:?}\nstiffness = {}\n{}[time]\nstep = 0.01\nsteps = 1\n",
            vec![1.0; size],
            rows(&self.stiffness),
            terms.collect::<String>()
        )
    }

    /// The matrix of the system of first order of q, q̇ and the states of the kernels.
    fn matrix(&self) -> DMatrix<f64> {
        let size = self.stiffness.nrows();
        let states: usize = self.kernels.iter().map(|kernel| kernel.matrix.nrows()).sum();
        let mut matrix = DMatrix::zeros(2 * size + states, 2 * size + states);
        matrix.view_mut((0, size), (size, size)).fill_with_identity();
        matrix.view_mut((size, 0), (size, size)).copy_from(&-&self.stiffness);
        let mut first = 2 * size;
        for kernel in &self.kernels {
            let count = kernel.matrix.nrows();
            let direction = &kernel.direction;
            matrix.view_mut((first, first), (count, count)).copy_from(&kernel.matrix);
            matrix.view_mut((first, size), (count, size)).copy_from(&(&kernel.input * direction.transpose()));
            matrix
                .view_mut((size, first), (size, count))
                .copy_from(&-(direction * kernel.output.transpose()));
            let mut viscous = matrix.view_mut((size, size), (size, size));
            viscous -= direction * direction.transpose() * kernel.dashpot;
            first += count;
        }
        matrix
    }

    fn check(&self, tolerance: f64) {
        compare(&self.text(), self.matrix(), tolerance);
    }
}

/// Compares the poles of a scenario with the eigenvalues of its system of first order, each with one.
fn compare(text: &str, matrix: DMatrix<f64>, tolerance: f64) {
    let read = scenario(text);
    let linearised = Linearised::new(&read, &vec![0.0; read.system.mass.size()]).unwrap();
    let mut found: Vec<Complex<f64>> = linearised
        .poles()
        .unwrap_or_else(|error| panic!("{error}\n{text}"))
        .iter()
        .flat_map(|pole| {
            let pair = [pole.place, pole.place.conj()];
            pair.into_iter().take(if pole.place.im == 0.0 { 1 } else { 2 })
        })
        .collect();
    let known = matrix.complex_eigenvalues();
    assert_eq!(found.len(), known.len(), "{text}{found:?}\n{known:?}");
    // Eigenvalues have the rounding errors of the largest.
    let largest = known.iter().map(|s| s.norm()).fold(0.0, max_or_nan);
    for s in known.iter() {
        let distance = |found: &Complex<f64>| (found - s).norm();
        let nearest =
            (0..found.len()).min_by(|&a, &b| distance(&found[a]).total_cmp(&distance(&found[b]))).unwrap();
        let error = distance(&found.swap_remove(nearest));
        assert!(error < tolerance * s.norm() + 1e-11 * largest, "{s}: {error:e}\n{text}{known}");
    }
}

/// A matrix as a list of rows.
fn rows(matrix: &DMatrix<f64>) -> String {
    let row = |row: usize| format!("{:?}", matrix.row(row).iter().collect::<Vec<_>>());
    format!("[{}]", (0..matrix.nrows()).map(row).collect::<Vec<_>>().join(", "))
}

fn one(stiffness: f64, kernels: Vec<Kernel>) -> Structure {
    Structure { stiffness: DMatrix::from_element(1, 1, stiffness), kernels }
}

#[test]
fn poles_are_counted_with_prony_series_of_any_times_and_strengths() {
    let mut numbers = noise(11);
    for case in 0..60 {
        // Every third with times and strengths at the edges.
        let reach = if case % 3 == 0 { 4.0 } else { 1.5 };
        let mut power = |reach: f64| 10f64.powf(reach * (2.0 * numbers() - 1.0));
        let strengths = [power(reach), power(0.5 * reach)];
        let times = [power(reach), power(reach)];
        one(1.0, vec![Kernel::prony(&strengths, &times, &[1.0])]).check(1e-6);
    }
}

#[test]
fn poles_are_counted_with_resonators() {
    let mut numbers = noise(12);
    for case in 0..60 {
        let mut between = |low: f64, high: f64| low + (high - low) * numbers();
        let (omega, ratio, c) = (between(0.5, 3.0), between(0.05, 0.9), between(0.1, 1.5));
        // Weak ones beside their own pole, at the frequency of the structure too.
        let c = if case % 4 == 0 { 1e-4 * c } else { c };
        let omega = if case % 6 == 0 { 1.0 } else { omega };
        let e = between(0.0, 2.0) * ratio * omega;
        let d = if case % 2 == 0 { 0.0 } else { 0.3 };
        one(1.0, vec![Kernel::resonator([c, e, 2.0 * ratio * omega, omega * omega, d], &[1.0])]).check(1e-6);
    }
}

#[test]
fn poles_are_counted_with_double_poles_and_shared_ones() {
    // (s + 1)² below; critical damping; two kernels with a pole in common, in one direction and in two.
    one(1.0, vec![Kernel::resonator([0.7, 0.0, 2.0, 1.0, 0.0], &[1.0])]).check(1e-6);
    one(4.0, vec![Kernel::resonator([0.7, 0.3, 3.0, 2.25, 0.1], &[1.0])]).check(1e-6);
    let shared = |direction: [f64; 2]| Structure {
        stiffness: DMatrix::from_row_slice(2, 2, &[3.0, -1.0, -1.0, 2.0]),
        kernels: vec![
            Kernel::prony(&[1.0, 0.5], &[0.5, 3.0], &[1.0, 0.0]),
            Kernel::prony(&[0.7], &[0.5], &direction),
        ],
    };
    shared([0.3, 1.0]).check(1e-6);
    // In one direction the series is that of two terms, and one state of the three is not seen.
    let read = scenario(&shared([1.0, 0.0]).text());
    assert_eq!(Linearised::new(&read, &[0.0; 2]).unwrap().poles().unwrap().len(), 4);
}

#[test]
fn poles_are_counted_with_several_coordinates() {
    let mut numbers = noise(13);
    for _ in 0..12 {
        let mut between = |low: f64, high: f64| low + (high - low) * numbers();
        let size = 3;
        let root = DMatrix::from_fn(size, size, |_, _| between(-1.0, 1.0));
        let stiffness = &root * root.transpose() + DMatrix::identity(size, size) * 0.3;
        let mut direction = || (0..size).map(|_| between(-1.0, 1.0)).collect::<Vec<_>>();
        let (first, second) = (direction(), direction());
        let (ratio, omega, time) = (between(0.1, 0.8), between(0.5, 3.0), between(0.05, 5.0));
        let resonator =
            Kernel::resonator([0.9, ratio * omega, 2.0 * ratio * omega, omega * omega, 0.0], &first);
        let prony = Kernel::prony(&[1.0, 0.4], &[time, 0.2], &second);
        Structure { stiffness, kernels: vec![resonator, prony] }.check(1e-6);
    }
}

/// K̂ = Σ b bᵀ s/(s² + 2ζω s + ω²) as equations of states A, B, C in a basis that hides the pairs.
#[test]
fn poles_are_counted_with_equations_of_states() {
    let mut numbers = noise(14);
    for (size, pairs) in [(1, 8), (2, 6), (2, 6), (2, 5), (3, 5), (3, 5), (4, 4)] {
        let mut between = |low: f64, high: f64| low + (high - low) * numbers();
        let stiffness = DMatrix::from_diagonal(&DVector::from_fn(size, |_, _| between(1.0, 5.0)));
        let count = 2 * pairs;
        let (mut a, mut b, mut c) =
            (DMatrix::zeros(count, count), DMatrix::zeros(count, size), DMatrix::zeros(size, count));
        for pair in (0..count).step_by(2) {
            let (ratio, omega) = (between(0.05, 0.5), between(0.5, 3.0));
            a.view_mut((pair, pair), (1, 2)).copy_from_slice(&[-2.0 * ratio * omega, -omega * omega]);
            a[(pair + 1, pair)] = 1.0;
            let direction = DVector::from_fn(size, |_, _| between(-1.0, 1.0));
            b.row_mut(pair).copy_from(&direction.transpose());
            c.column_mut(pair).copy_from(&direction);
        }
        let basis = DMatrix::from_fn(count, count, |_, _| between(-1.0, 1.0)).qr().q();
        let (a, b, c) = (&basis * a * basis.transpose(), &basis * b, c * basis.transpose());
        let text = format!(
            "[system]\nmass = {:?}\nstiffness = {}\n[[system.damping]]\n\
             kernel = {{ states = {{ A = {}, B = {}, C = {} }} }}\n[time]\nstep = 0.01\nsteps = 1\n",
            vec![1.0; size],
            rows(&stiffness),
            rows(&a),
            rows(&b),
            rows(&c)
        );
        let mut matrix = DMatrix::zeros(2 * size + count, 2 * size + count);
        matrix.view_mut((0, size), (size, size)).fill_with_identity();
        matrix.view_mut((size, 0), (size, size)).copy_from(&-stiffness);
        matrix.view_mut((size, 2 * size), (size, count)).copy_from(&-c);
        matrix.view_mut((2 * size, size), (count, size)).copy_from(&b);
        matrix.view_mut((2 * size, 2 * size), (count, count)).copy_from(&a);
        compare(&text, matrix, 1e-6);
    }
}

/// s² + k + Σ ρ (1 − (1 + τs)^{−γ}) of terms (ρ, γ, τ).
fn of_cole_davidson(stiffness: f64, terms: &[[f64; 3]], s: Complex<f64>) -> Complex<f64> {
    let damping = |&[rho, power, time]: &[f64; 3]| (1.0 - (1.0 + s * time).powf(-power)) * rho;
    s * s + stiffness + terms.iter().map(damping).sum::<Complex<f64>>()
}

/// The turns of a function on the way from one number to another, halved until it changes little.
fn turns(value: &dyn Fn(f64) -> Complex<f64>, from: f64, to: f64, depth: u32) -> f64 {
    let middle = 0.5 * (from + to);
    let first = (value(middle) / value(from)).arg();
    let second = (value(to) / value(middle)).arg();
    if depth > 5 && max_or_nan(first.abs(), second.abs()) < 0.5 || depth > 45 {
        return (first + second) / (2.0 * PI);
    }
    turns(value, from, middle, depth + 1) + turns(value, middle, to, depth + 1)
}

/// The zeros in the plane with its cut: the turns along a circle far out, along the cut, and around its
/// start. Closer to that lies one more where the function is still positive, since it falls to −∞ there.
fn zeros_of_cole_davidson(stiffness: f64, terms: &[[f64; 3]]) -> f64 {
    let value = |s: Complex<f64>| of_cole_davidson(stiffness, terms, s);
    let start = terms.iter().map(|[.., time]| 1.0 / time).fold(f64::INFINITY, min_or_nan);
    let scale: f64 = terms.iter().map(|[rho, _, time]| rho + 1.0 / (time * time)).sum();
    let far = 20.0 * (1.0 + stiffness + scale).sqrt();
    let close = 1e-13 * start;
    let [out, inner] = [far - start, close].map(f64::ln);
    let on_the_cut = |x: f64| {
        let distance = x.exp();
        value(Complex::new(-start - distance, 1e-13 * distance))
    };
    let around = |angle: f64| value(Complex::new(-start, 0.0) + Complex::from_polar(close, angle));
    let half = turns(&|angle| value(Complex::from_polar(far, angle)), 0.0, PI, 0)
        + turns(&on_the_cut, out, inner, 0)
        + turns(&around, PI * (1.0 - 1e-13), 0.0, 0);
    let closer = if around(0.0).re > 0.0 { 1.0 } else { 0.0 };
    2.0 * half + closer
}

#[test]
fn poles_are_counted_with_cole_davidson_kernels_beside_the_start_of_their_cut() {
    let mut numbers = noise(14);
    for case in 0..60 {
        let mut power = |reach: f64| 10f64.powf(reach * (2.0 * numbers() - 1.0));
        let stiffness = power(3.0);
        let mut term = || {
            let (rho, time) = (power(2.5), power(2.0));
            let near = 0.05 * min_or_nan(power(0.5), 1.0);
            [rho, if time > 1.0 { near } else { 1.0 - near }, time]
        };
        let mut terms = vec![term(), term()];
        terms.truncate(1 + case % 2);
        if case % 6 == 1 {
            // Two kernels with one start.
            terms[1][2] = terms[0][2];
        }
        let term = |[rho, power, time]: &[f64; 3]| {
            format!(
                "[[system.damping]]\ncoefficient = [{rho:?}]\n\
                 kernel = {{ form = \"havriliak-negami\", order = 1.0, power = {power:?}, time = {time:?} }}\n"
            )
        };
        let text = format!(
            "[system]\nmass = [1.0]\nstiffness = [{stiffness:?}]\n{}[time]\nstep = 0.01\nsteps = 1\n",
            terms.iter().map(term).collect::<String>()
        );
        let poles = Linearised::new(&scenario(&text), &[0.0]).unwrap().poles();
        let poles = poles.unwrap_or_else(|error| panic!("{error}\n{text}"));
        let found: usize = poles.iter().map(|pole| if pole.place.im == 0.0 { 1 } else { 2 }).sum();
        let known = zeros_of_cole_davidson(stiffness, &terms);
        assert!((known - found as f64).abs() < 0.01, "{found} of {known}: {poles:?}\n{text}");
        for pole in poles {
            // Close to the start of a cut a zero of double precision solves nothing.
            let s = pole.place;
            if terms.iter().all(|[.., time]| (1.0 + s * *time).norm() > 1e-4) {
                let size = s.norm_sqr() + stiffness + terms.iter().map(|[rho, ..]| rho).sum::<f64>();
                let left = of_cole_davidson(stiffness, &terms, s).norm() / size;
                assert!(left < 1e-10, "{s}: {left:e}\n{text}");
            }
        }
    }
}

fn last(text: &str) -> Result<GridState, String> {
    let scenario = scenario(text);
    let mut motion = Motion::start(&scenario, Precision::F64).map_err(|error| error.to_string())?;
    while !motion.is_done() {
        motion.advance().map_err(|failure| format!("{failure:?}"))?;
    }
    Ok(motion.state().clone())
}

const WAYS: [&str; 9] = [
    "[convolution]\norder = 2\n[time]\nstep = 0.05\nsteps = 60\n",
    "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\norder = 4\n[time]\nstep = 0.05\nsteps = 60\n",
    "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n[time]\nstep = 0.05\nsteps = 60\n",
    "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"lobatto-iiic\"\nstages = 2\n[time]\nstep = 0.05\nsteps = 60\n",
    "[scheme]\nkind = \"collocation\"\n[time]\nstep = 0.05\nsteps = 60\n",
    "[scheme]\nkind = \"collocation\"\n[history]\nengine = \"exponential-sum\"\n[time]\nstep = 0.05\nsteps = 60\n",
    "[scheme]\nkind = \"collocation\"\n[history]\nengine = \"block-fft\"\n[time]\nstep = 0.05\nsteps = 60\n",
    "[scheme]\nkind = \"collocation\"\n[time]\ngrid = \"graded\"\nexponent = 2.0\nend = 3.0\nsteps = 60\n",
    "[scheme]\nkind = \"collocation\"\n[time]\ngrid = \"adaptive\"\nend = 3.0\ntolerance = 1e-8\n",
];

fn damped(kernel: &str, rest: &str) -> String {
    format!(
        "[system]\nmass = [1.0]\nstiffness = [2.0]\n[[system.damping]]\ncoefficient = [0.8]\n{kernel}\n[initial]\n\
         position = [1.0]\nvelocity = [0.5]\n{rest}"
    )
}

#[test]
fn sums_of_quotients_move_as_the_prony_series_that_they_are() {
    let pairs = [
        ("s/(s+1)", "strengths = [1.0], times = [1.0]"),
        ("s/(s + 1) + 0.7*s/(s + 10)", "strengths = [1.0, 0.7], times = [1.0, 0.1]"),
        // 2 s/(s + 1) + s/(s + 2), over one denominator; with a fast and a slow term.
        ("(3*s^2 + 5*s)/(s^2 + 3*s + 2)", "strengths = [2.0, 1.0], times = [1.0, 0.5]"),
        ("1e4*s/(s + 1e4)*1e-4 + 3*s/(s + 1e-3)", "strengths = [1.0, 3.0], times = [1e-4, 1e3]"),
    ];
    for (symbol, prony) in pairs {
        for way in WAYS {
            for derivative in ["caputo", "riemann-liouville"] {
                let of =
                    |kernel: &str| last(&damped(&format!("{kernel}\nderivative = \"{derivative}\""), way));
                let known = of(&format!("kernel = {{ form = \"prony\", {prony} }}"));
                let Ok(known) = known else { continue };
                let found = of(&format!("kernel = {{ symbol = \"{symbol}\" }}"))
                    .unwrap_or_else(|error| panic!("{symbol}, {derivative}: {error}\n{way}"));
                let error = (found.position[0] - known.position[0]).abs();
                let of_momentum = (found.momentum[0] - known.momentum[0]).abs();
                assert!(
                    error.max(of_momentum) < 1e-10,
                    "{symbol}, {derivative}: {error:e}, {of_momentum:e}\n{way}"
                );
            }
        }
    }
}

#[test]
fn oscillating_and_double_poles_move_as_their_differential_equations_in_runge_kutta_families() {
    for numbers in [
        [0.5, 0.1, 0.2, 4.01, 0.0],
        [1.0, 0.5, 2.0, 1.0, 0.0],
        [0.9, 0.0, 0.5, 3.2, 0.3],
        [2.0, 30.0, 60.0, 1e4, 0.0],
    ] {
        let kernel = Kernel::resonator(numbers, &[1.0]);
        let exponential = {
            let mut structure = one(2.0, vec![]);
            let scaled = Kernel { output: &kernel.output * 0.8, dashpot: 0.8 * kernel.dashpot, ..kernel };
            structure.kernels.push(scaled);
            let matrix = structure.matrix();
            let mut start = DVector::zeros(matrix.nrows());
            (start[0], start[1]) = (1.0, 0.5);
            of_ode(&matrix, start.as_slice(), 3.0)[0]
        };
        let text = Kernel::resonator(numbers, &[1.0]).text;
        for (way, tolerance) in [
            ("[scheme]\nkind = \"collocation\"\n[time]\nstep = 0.01\nsteps = 300\n", 2e-8),
            (
                "[scheme]\nkind = \"collocation\"\n[history]\nengine = \"direct\"\n[time]\nstep = 0.01\nsteps = 300\n",
                2e-8,
            ),
            (
                "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n[time]\n\
                 step = 0.01\nsteps = 300\n",
                1e-5,
            ),
        ] {
            let found = last(&damped(&text, way)).unwrap_or_else(|error| panic!("{text}: {error}\n{way}"));
            let error = (found.position[0] - exponential).abs();
            assert!(error < tolerance, "{text}: {error:e}\n{way}");
        }
    }
}

#[test]
fn what_cannot_be_run_is_refused_with_its_reason() {
    let kernel = "kernel = { symbol = \"0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)\" }";
    let sum = "[scheme]\nkind = \"collocation\"\n[history]\nengine = \"exponential-sum\"\n[time]\nstep = 0.1\nsteps = 10\n";
    let refused = |rest: &str| {
        let scenario = scenario(&damped(kernel, rest));
        Simulation::new(&scenario, Precision::F64).err().unwrap().to_string()
    };
    assert!(refused(sum).contains("not made up by decaying exponentials"), "{}", refused(sum));
}
