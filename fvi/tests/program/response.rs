//! `fvi response`: against closed forms, long-time answers of runs, and their decay.

use crate::workplace::{Workplace, text};
use fvi_fft::sums::{max_or_nan, min_or_nan};
use std::f64::consts::PI;
use std::fmt::Write;
use std::fs;

/// A complex number, by itself: nothing of the program's arithmetic takes part.
#[derive(Clone, Copy, Debug)]
struct Complex(f64, f64);

impl Complex {
    fn polar(size: f64, angle: f64) -> Self {
        Self(size * angle.cos(), size * angle.sin())
    }

    fn plus(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }

    fn times(self, other: Self) -> Self {
        Self(self.0 * other.0 - self.1 * other.1, self.0 * other.1 + self.1 * other.0)
    }

    fn scaled(self, factor: f64) -> Self {
        Self(self.0 * factor, self.1 * factor)
    }

    fn inverse(self) -> Self {
        let size = self.0 * self.0 + self.1 * self.1;
        Self(self.0 / size, -self.1 / size)
    }

    fn power(self, exponent: f64) -> Self {
        Self::polar(self.0.hypot(self.1).powf(exponent), exponent * self.1.atan2(self.0))
    }

    fn near(self, known: Self, tolerance: f64) -> bool {
        (self.0 - known.0).hypot(self.1 - known.1) <= tolerance * known.0.hypot(known.1)
    }
}

const ONE: Complex = Complex(1.0, 0.0);

fn table(place: &Workplace, name: &str) -> Vec<Vec<f64>> {
    let table = fs::read_to_string(place.path("out").join(name)).unwrap();
    table.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect()
}

fn respond(place: &Workplace, scenario: &str, arguments: &[&str]) {
    place.write("scenario.toml", scenario);
    let output = place.fvi(&[&["response", "scenario.toml", "--out", "out"], arguments].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
}

/// The key of a kernel, and K(s) written out.
type WrittenOut = (&'static str, fn(Complex) -> Complex);

fn kernels() -> Vec<WrittenOut> {
    vec![
        ("order = 0.7", |s| s.power(0.7)),
        ("order = 1.5", |s| s.power(1.5)),
        ("kernel = { form = \"tempered\", order = 0.5, rate = 0.3 }", |s| {
            s.plus(Complex(0.3, 0.0)).power(0.5).plus(Complex(-(0.3f64.sqrt()), 0.0))
        }),
        ("kernel = { form = \"maxwell\", order = 0.6, time = 2.0, inner = 0.1 }", |s| {
            let s = s.scaled(2.0);
            s.power(0.6).times(ONE.plus(s.power(0.5)).inverse())
        }),
        ("kernel = { form = \"prony\", strengths = [1.0, 0.7], times = [1.0, 0.1] }", |s| {
            let term = |g: f64, tau: f64| s.scaled(tau).times(ONE.plus(s.scaled(tau)).inverse()).scaled(g);
            term(1.0, 1.0).plus(term(0.7, 0.1))
        }),
        ("kernel = { form = \"havriliak-negami\", order = 0.7, power = 0.5, time = 1.5 }", |s| {
            let inner = ONE.plus(s.scaled(1.5).power(0.7)).power(-0.5);
            ONE.plus(inner.scaled(-1.0))
        }),
        // With a spring of 0.5, which belongs to K.
        ("kernel = { symbol = \"0.5 + s^0.6/(1 + s^0.6)\" }", |s| {
            s.power(0.6).times(ONE.plus(s.power(0.6)).inverse()).plus(Complex(0.5, 0.0))
        }),
    ]
}

#[test]
fn one_coordinate_has_its_closed_form_with_every_kernel() {
    let place = Workplace::new();
    for (kernel, value) in kernels() {
        let scenario = format!(
            "[system]\nmass = [2.0]\npotential = \"1.5*q0^2\"\n[[system.damping]]\ncoefficient = [0.8]\n{kernel}\n\
             [time]\nstep = 0.1\nsteps = 100\n"
        );
        respond(&place, &scenario, &["--from", "0.01", "--to", "100", "--points", "41"]);
        let rows = table(&place, "response.csv");
        assert_eq!(rows.len(), 41);
        assert!((rows[0][0], rows[40][0]) == (0.01, 100.0));
        for row in &rows {
            let s = Complex(0.0, row[0]);
            let below = s.times(s).scaled(2.0).plus(Complex(3.0, 0.0)).plus(value(s).scaled(0.8));
            assert!(Complex(row[1], row[2]).near(below.inverse(), 1e-12), "{kernel}: {row:?}");
        }
        for row in table(&place, "moduli_0.csv") {
            assert!(Complex(row[1], row[2]).near(value(Complex(0.0, row[0])), 1e-12), "{kernel}: {row:?}");
        }
        // Frequencies that the step does not resolve are none of the scheme.
        assert!(table(&place, "response_discrete.csv").iter().all(|row| row[0] <= PI / 0.1 * 1.001));
        assert!(place.path("out").join("nyquist.svg").exists());
    }
}

#[test]
fn creep_and_relaxation_are_written() {
    let place = Workplace::new();
    let scenario = "[system]\nmass = [1.0]\n[[system.damping]]\ncoefficient = [1.0]\norder = 0.5\n[time]\nstep = 0.1\nsteps = 100\n";
    respond(&place, scenario, &["--from", "0.1", "--to", "10", "--points", "5"]);
    let gamma = PI.sqrt();
    for row in table(&place, "creep_0.csv") {
        assert!((row[1] - row[0].sqrt() / (0.5 * gamma)).abs() < 1e-10 * row[1], "{row:?}");
    }
    for row in table(&place, "relaxation_0.csv") {
        assert!((row[1] - 1.0 / (row[0].sqrt() * gamma)).abs() < 1e-10 * row[1], "{row:?}");
    }
}

#[test]
fn coupled_coordinates_about_another_point() {
    let place = Workplace::new();
    // Hessian at (0.3, −0.2): [2 + 12·0.09·0.1, −0.5; −0.5, 1]; a force that turns: −∂F/∂q = [0, −0.2; 0, 0].
    let scenario = "[system]\nmass = [[2.0, 0.3], [0.3, 1.0]]\npotential = \"q0^2 + 0.1*q0^4 - 0.5*q0*q1 + 0.5*q1^2\"\n\
        force = [\"0.2*q1 + cos(t)\", \"0\"]\n[[system.damping]]\norder = 0.4\ncoefficient = [0.5, 0.0]\n\
        [[system.damping]]\norder = 1.0\ncoefficient = [[0.2, -0.2], [-0.2, 0.2]]\n[time]\nstep = 0.1\nsteps = 100\n";
    let arguments = ["--position", "0.3,-0.2", "--input", "1", "--output", "0", "--points", "30"];
    respond(&place, scenario, &arguments);
    for row in table(&place, "response.csv") {
        let s = Complex(0.0, row[0]);
        let entry = |mass: f64, stiffness: f64, half: f64, one: f64| {
            let inertia = s.times(s).scaled(mass).plus(Complex(stiffness, 0.0));
            inertia.plus(s.power(0.4).scaled(half)).plus(s.scaled(one))
        };
        let (a, b) = (entry(2.0, 2.0 + 1.2 * 0.09, 0.5, 0.2), entry(0.3, -0.5 - 0.2, 0.0, -0.2));
        let (c, d) = (entry(0.3, -0.5, 0.0, -0.2), entry(1.0, 1.0, 0.0, 0.2));
        let determinant = a.times(d).plus(b.times(c).scaled(-1.0));
        let known = b.scaled(-1.0).times(determinant.inverse());
        assert!(Complex(row[1], row[2]).near(known, 1e-11), "{row:?} {known:?}");
    }
}

#[test]
fn a_long_chain_from_files_has_the_answer_of_its_modes() {
    let place = Workplace::new();
    let tridiagonal = |own: f64, beside: f64| {
        let mut text = "%%MatrixMarket matrix coordinate real symmetric\n150 150 299\n".to_owned();
        for row in 1..=150 {
            if row > 1 {
                writeln!(text, "{row} {} {beside}", row - 1).unwrap();
            }
            writeln!(text, "{row} {row} {own}").unwrap();
        }
        text
    };
    place.write("M.mtx", &tridiagonal(4.0, 1.0));
    place.write("K.mtx", &tridiagonal(200.0, -100.0));
    let scenario = "[system]\nmass = \"M.mtx\"\nstiffness = \"K.mtx\"\n[[system.damping]]\norder = 0.6\ncoefficient = \"K.mtx\"\n\
        scale = 0.02\n[time]\nstep = 0.05\nsteps = 400\n[output]\ncoordinates = [149]\n";
    let arguments = ["--input", "149", "--output", "20", "--from", "0.05", "--to", "20", "--points", "25"];
    respond(&place, scenario, &arguments);
    let record = fs::read_to_string(place.path("out").join("response.json")).unwrap();
    assert!(record.contains("poles are sought in systems of up to"), "{record}");
    let h = 0.05;
    let tables = [(table(&place, "response.csv"), false), (table(&place, "response_discrete.csv"), true)];
    for (rows, discrete) in tables {
        assert_eq!(rows.len(), 25);
        for row in rows {
            let omega = row[0];
            let s = Complex(0.0, omega);
            // The midpoint rule and BDF 2 at its node, mode by mode: γ = 3/2 − 2z + z²/2.
            let z = Complex::polar(1.0, -omega * h);
            let gamma = Complex(1.5, 0.0).plus(z.scaled(-2.0)).plus(z.times(z).scaled(0.5));
            let mut sum = Complex(0.0, 0.0);
            for mode in 1..=150 {
                let angle = PI * f64::from(mode) / 151.0;
                let shape = |place: f64| (2.0f64 / 151.0).sqrt() * (angle * place).sin();
                let (mass, stiffness) = (4.0 + 2.0 * angle.cos(), 200.0 - 200.0 * angle.cos());
                let answer = if discrete {
                    let difference = ONE.plus(z.scaled(-1.0));
                    let mean = ONE.plus(z).scaled(0.5);
                    let damped = gamma.scaled(1.0 / h).power(0.6).scaled(0.02 * stiffness);
                    let elastic = Complex(stiffness, 0.0).plus(damped).times(mean).times(mean);
                    let below = difference.times(difference).scaled(mass / (h * h)).plus(elastic);
                    mean.times(z.power(0.5)).times(below.inverse())
                } else {
                    let damped = s.power(0.6).scaled(0.02 * stiffness);
                    s.times(s).scaled(mass).plus(Complex(stiffness, 0.0)).plus(damped).inverse()
                };
                sum = sum.plus(answer.scaled(shape(150.0) * shape(21.0)));
            }
            // The equations of a step near the first resonance lose five digits of 200/0.0026.
            let tolerance = if discrete { 2e-12 } else { 2e-13 };
            assert!((row[1] - sum.0).hypot(row[2] - sum.1) < tolerance, "{discrete}: {row:?} {sum:?}");
        }
    }
}

/// The outer masses of three swing against each other and leave the one at rest that is damped.
#[test]
fn a_motion_that_nothing_damps_is_listed_beside_the_response() {
    let place = Workplace::new();
    let scenario = "[system]\nmass = [1.0, 1.0, 1.0]\n\
                    stiffness = [[4.18, -4.18, 0.0], [-4.18, 8.36, -4.18], [0.0, -4.18, 4.18]]\n\
                    damping = [{ order = 0.5, coefficient = [0.0, 0.32, 0.0] }]\n\
                    [initial]\nposition = [0.0, 0.0, 0.0]\n[time]\nstep = 0.01\nend = 20.0\n";
    respond(&place, scenario, &[]);
    let own = 4.18f64.sqrt();
    let poles = table(&place, "poles.csv");
    assert!(poles.iter().any(|row| row[0].abs() < 1e-9 && (row[1] - own).abs() < 1e-9), "{poles:?}");
}

#[test]
fn runs_under_a_harmonic_load_end_with_the_response_of_their_scheme() {
    let place = Workplace::new();
    let schemes = [
        ("", "at = \"main-nodes\"\norder = 1"),
        ("kappa = 0.3", "at = \"main-nodes\"\norder = 2"),
        ("", "order = 2"),
        ("", "symbol = \"trapezoidal\""),
        ("kind = \"galerkin\"\ndegree = 3", "order = 4"),
        ("kind = \"galerkin\"\ndegree = 2\nquadrature = \"lobatto\"", "at = \"main-nodes\"\norder = 1"),
        ("kind = \"galerkin\"\ndegree = 2", "family = \"radau-iia\"\nstages = 2"),
        ("kind = \"galerkin\"\ndegree = 3", "family = \"lobatto-iiic\"\nstages = 4"),
        ("kind = \"collocation\"", "family = \"radau-iia\"\nstages = 3"),
        ("kind = \"collocation\"", "family = \"radau-iia\"\nstages = 2"),
        ("kind = \"implicit-euler\"", ""),
        ("kind = \"explicit-euler\"", "order = 1"),
    ];
    let (step, steps, omega) = (0.05, 7000, 1.3);
    // Motions that die like exponentials, so that the answer is there to rounding; and one of the power law.
    for (damping, tolerance) in [
        ("kernel = { form = \"prony\", strengths = [1.0, 0.7], times = [1.0, 0.3] }", 1e-10),
        ("order = 1.0", 1e-10),
        ("order = 0.5", 1e-3),
    ] {
        for (scheme, convolution) in schemes {
            let scenario = format!(
                "[system]\nmass = [1.0]\npotential = \"q0^2\"\nforce = [\"cos({omega}*t)\"]\n[[system.damping]]\n\
                 coefficient = [0.6]\n{damping}\n[scheme]\n{scheme}\n[convolution]\n{convolution}\n\
                 [time]\nstep = {step}\nsteps = {steps}\n"
            );
            let run = place.run(&scenario, &[]);
            let omega_text = omega.to_string();
            respond(&place, &scenario, &["--from", &omega_text, "--to", &omega_text]);
            let (exact, own) =
                (&table(&place, "response.csv")[0], &table(&place, "response_discrete.csv")[0]);
            let positions = run.column("q0");
            let mut worst = 0.0f64;
            for (k, position) in positions.iter().enumerate().skip(steps - 200) {
                let angle = omega * step * k as f64;
                let known = own[1] * angle.cos() - own[2] * angle.sin();
                worst = max_or_nan(worst, (position - known).abs());
            }
            assert!(worst < tolerance, "{damping}, {scheme}, {convolution}: {worst:e}");
            // And that is the response of the structure, to the order of the scheme.
            let error = (exact[1] - own[1]).hypot(exact[2] - own[2]);
            let is_first_order = scheme.contains("euler") || convolution.ends_with("order = 1");
            let expected = if is_first_order { 0.2 } else { 5e-3 };
            assert!(error < expected, "{damping}, {scheme}, {convolution}: {error:e}");
        }
    }
}

#[test]
fn released_structures_decay_by_their_poles() {
    let place = Workplace::new();
    let scenario = "[system]\nmass = [1.0]\npotential = \"q0^2\"\n[[system.damping]]\ncoefficient = [0.3]\n\
        kernel = { form = \"prony\", strengths = [1.0], times = [0.4] }\n[initial]\nposition = [1.0]\n\
        [scheme]\nkind = \"galerkin\"\ndegree = 3\n[convolution]\nfamily = \"radau-iia\"\nstages = 3\n\
        [time]\nstep = 0.02\nend = 40.0\n";
    let positions = place.run(scenario, &[]).column("q0");
    respond(&place, scenario, &[]);
    let poles = table(&place, "poles.csv");
    let pair = poles.iter().find(|pole| pole[1] > 0.0).unwrap();
    let (size, damping) = (pair[0].hypot(pair[1]), -pair[0] / pair[0].hypot(pair[1]));
    assert!((pair[2] - size).abs() < 1e-14 && (pair[3] - damping).abs() < 1e-14);
    // A pair alone: q_{k+2L} = a q_{k+L} + b q_k with a = 2 e^{σT} cos ωT, b = −e^{2σT}, from two equations,
    // once the real pole has died.
    let (k, lag) = (1200, 30);
    let q = |times: usize| positions[k + times * lag];
    let determinant = q(1) * q(1) - q(0) * q(2);
    let (a, b) = ((q(1) * q(2) - q(0) * q(3)) / determinant, (q(1) * q(3) - q(2) * q(2)) / determinant);
    let time = 0.02 * lag as f64;
    let decay = 0.5 * (-b).ln() / time;
    let turning = (0.5 * a / (-b).sqrt()).acos() / time;
    assert!(
        (decay - pair[0]).abs() < 1e-7 && (turning - pair[1]).abs() < 1e-7,
        "{pair:?}: {decay} {turning}"
    );
}

#[test]
fn what_cannot_be_answered_is_refused_with_its_reason() {
    let place = Workplace::new();
    place.write(
        "scenario.toml",
        "[system]\nmass = [1.0]\npotential = \"2*q0^2\"\n[time]\nstep = 0.1\nsteps = 10\n",
    );
    for (arguments, code, reason) in [
        (&["--input", "1"][..], 2, "input"),
        (&["--from", "-1"], 2, "positive and finite"),
        (&["--from", "3", "--to", "2"], 2, "not below the first"),
        (&["--points", "1"], 2, "points"),
        (&["--position", "0,1"], 2, "2 numbers instead of 1"),
        (&["--position", "nan"], 2, "finite"),
        (&["--from", "2", "--to", "2"], 1, "at a resonance without damping"),
    ] {
        let output = place.fvi(&[&["response", "scenario.toml", "--out", "out"], arguments].concat());
        assert_eq!(output.status.code(), Some(code), "{arguments:?}");
        assert!(text(&output.stderr).contains(reason), "{arguments:?}: {}", text(&output.stderr));
    }
}

#[test]
fn a_response_about_a_kink_of_the_forces_comes_with_a_warning() {
    let place = Workplace::new();
    let warns = |potential: &str, position: &str| {
        let scenario = format!(
            "[system]\nmass = [1.0, 2.0]\npotential = \"{potential}\"\n[[system.damping]]\norder = 1\n\
             coefficient = [0.1, 0.1]\n[time]\nstep = 0.1\nsteps = 10\n"
        );
        place.write("scenario.toml", &scenario);
        let output = place.fvi(&["response", "scenario.toml", "--position", position, "--out", "out"]);
        assert!(output.status.success(), "{potential}: {}", text(&output.stderr));
        text(&output.stderr).contains("kink")
    };
    for (potential, position, kink) in [
        ("q0^2 + q1^2 + abs(q0)", "0,0", true),
        ("q0^2 + q1^2 + abs(q0)", "0.1,0", false),
        // A spring that only pushes: its stiffness jumps.
        ("q0^2 + q1^2 + 50*max(0, q0 - q1)^2", "0.3,0.3", true),
        ("q0^2 + q1^2 + 50*max(0, q0 - q1)^2", "0.3,0.2", false),
        // Smooth, however stiff, curved or far away.
        ("1e9*q0^2 + q1^2 + q1^4", "1e3,-2", false),
        ("-9.81*cos(q0) + 1e6*exp(3*(q1 - q0))", "0.5,0.7", false),
    ] {
        assert_eq!(warns(potential, position), kink, "{potential} at {position}");
    }
}

/// A dashpot damps a mass on a spring by c/(2m), however light it is beside ω.
#[test]
fn poles_of_light_damping_have_their_digits() {
    let place = Workplace::new();
    for case in 0..12 {
        let (mass, stiffness) = (2.7 + 0.31 * f64::from(case), 5.0 * 1.9_f64.powi(case - 6));
        for damping in [1e-4, 1e-6, 1e-8] {
            let scenario = format!(
                "[system]\nmass = [{mass}]\nstiffness = [{stiffness}]\n[[system.damping]]\norder = 1.0\n\
                 coefficient = [{damping}]\n[initial]\nposition = [1.0]\n[time]\nstep = 0.001\nsteps = 10\n"
            );
            place.write("scenario.toml", &scenario);
            let output = place.fvi(&["response", "scenario.toml", "--out", "out"]);
            assert!(output.status.success(), "{scenario}: {}", text(&output.stderr));
            let poles = fs::read_to_string(place.path("out/poles.csv")).unwrap();
            let [re, im] = [0, 1].map(|column| {
                let line = poles.lines().nth(1).unwrap();
                line.split(',').nth(column).unwrap().parse::<f64>().unwrap()
            });
            let omega = (stiffness / mass).sqrt();
            let damped = (stiffness / mass - (damping / (2.0 * mass)).powi(2)).sqrt();
            assert!((re + damping / (2.0 * mass)).abs() < 1e-14 * omega, "{scenario}: {re:e}");
            assert!((im - damped).abs() < 1e-13 * omega, "{scenario}: {im}");
        }
    }
}

/// Two bars that hang: products of the forces' derivatives vanish by symmetry, second derivatives do not.
#[test]
fn hanging_bars_have_no_kink() {
    let place = Workplace::new();
    let warns = |spring: &str| {
        let scenario = format!(
            "[system]\nmass = [1.0, 1.0, 1.0, 1.0]\nconstraints = [\"q0^2 + q1^2 - 0.49\", \"(q2-q0)^2 + (q3-q1)^2 - 1.69\"]\n\
             potential = \"9.81*q1 + 9.81*q3 + {spring}\"\n\
             [initial]\nposition = [0.0, -0.7, 0.0, -2.0]\n[time]\nstep = 0.01\nsteps = 10\n"
        );
        place.write("scenario.toml", &scenario);
        let output = place.fvi(&["response", "scenario.toml", "--position", "0,-0.7,0,-2", "--out", "out"]);
        assert!(output.status.success(), "{spring}: {}", text(&output.stderr));
        text(&output.stderr).contains("kink")
    };
    for (spring, kink) in [
        ("0.5*(atan2(q2-q0, -(q3-q1)) - atan2(q0, -q1))^2", false),
        ("0.5*atan2(q2-q0, q1-q3)^2", false),
        ("0.5*atan((q2-q0)/(q1-q3))^2", false),
        ("3*abs(q2-q0)", true),
        ("50*max(0, q0)^2", true),
    ] {
        assert_eq!(warns(spring), kink, "{spring}");
    }
}

/// Modes near a frequency are among the poles, with their shapes.
#[test]
fn modes_near_a_frequency_are_poles_with_shapes() {
    let place = Workplace::new();
    place.write(
        "s.toml",
        "[system]\nmass = [1.0, 2.0]\nstiffness = [[3.0, -1.0], [-1.0, 4.0]]\n\
         [[system.damping]]\norder = 0.6\ncoefficient = [0.3, 0.1]\n[time]\nstep = 0.1\nsteps = 10\n",
    );
    let output = place.fvi(&[
        "response",
        "s.toml",
        "--near",
        "1.3,1.9",
        "--modes",
        "1",
        "--no-discrete",
        "--out",
        "out",
    ]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("modes at ω = "), "{}", text(&output.stdout));
    assert!(!place.path("out/response_discrete.csv").exists() && output.stderr.is_empty());
    let table = |name: &str| -> Vec<Vec<f64>> {
        let text = std::fs::read_to_string(place.path(name)).unwrap();
        text.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect()
    };
    let (modes, poles, shapes) =
        (table("out/modes.csv"), table("out/poles.csv"), table("out/mode_shapes.csv"));
    assert_eq!((modes.len(), poles.len(), shapes.len(), shapes[0].len()), (2, 2, 2, 5));
    for (k, mode) in modes.iter().enumerate() {
        let nearest = poles
            .iter()
            .map(|pole| (pole[0] - mode[1]).hypot(pole[1] - mode[2]))
            .fold(f64::INFINITY, min_or_nan);
        assert!(nearest < 1e-12, "{mode:?} {poles:?}");
        // The first row of (s²M + K + ρ s^0.6) x = 0.
        let s = nalgebra::Complex::new(mode[1], mode[2]);
        let x =
            [0, 1].map(|row: usize| nalgebra::Complex::new(shapes[row][1 + 2 * k], shapes[row][2 + 2 * k]));
        let residual = (s * s + 3.0 + s.powf(0.6) * 0.3) * x[0] - x[1];
        assert!(residual.norm() < 1e-12, "{residual}");
    }
    // Again without: the files of modes are gone.
    assert!(place.fvi(&["response", "s.toml", "--out", "out"]).status.success());
    assert!(!place.path("out/modes.csv").exists() && place.path("out/response_discrete.csv").exists());
    for (arguments, said) in [
        (&["--modes", "3"][..], "--near"),
        (&["--near", "-1"], "near"),
        (&["--near", "1", "--modes", "0"], "from 1 to 200"),
        (&["--near", "x"], "--near"),
    ] {
        let output = place.fvi(&[&["response", "s.toml", "--out", "other"], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
        assert!(text(&output.stderr).contains(said), "{}", text(&output.stderr));
    }
}
