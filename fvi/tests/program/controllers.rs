//! Closed loops: against simulations written here with sums over all samples, against a continuous loop, and
//! through everything that a run may be: interrupted, swept, large, refused.

use crate::tune::Complex;
use crate::workplace::{Workplace, text};
use fvi_fft::sums::max_or_nan;
use fvi_host::run::{RunEnd, RunOptions, run};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Precision;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// A PI^λD^μ law with its whole past, by sums of binomial coefficients.
#[derive(Clone)]
struct Law {
    gains: [f64; 3],
    orders: [f64; 2],
    /// c of the derivative's setpoint.
    weight: f64,
    filter: f64,
    sample: f64,
    limits: [f64; 2],
    /// h R.
    stride: f64,
    /// τ of back-calculation.
    tracking: Option<f64>,
    samples: Vec<f64>,
    /// c r − y, less its first value.
    signals: Vec<f64>,
    first: Option<f64>,
    filtered: f64,
    output: f64,
}

impl Law {
    fn new(gains: [f64; 3], orders: [f64; 2], sample: f64) -> Self {
        Self {
            gains,
            orders,
            weight: 0.0,
            filter: 0.0,
            sample,
            limits: [f64::NEG_INFINITY, f64::INFINITY],
            stride: f64::INFINITY,
            tracking: None,
            samples: Vec::new(),
            signals: Vec::new(),
            first: None,
            filtered: 0.0,
            output: 0.0,
        }
    }

    /// ((1 − z)/h)^power of a sequence at its last sample.
    fn operator(&self, power: f64, samples: &[f64]) -> f64 {
        let (mut weight, mut sum) = (1.0, 0.0);
        for (n, sample) in samples.iter().rev().enumerate() {
            if n > 0 {
                weight *= 1.0 - (power + 1.0) / n as f64;
            }
            sum += weight * sample;
        }
        sum * self.sample.powf(-power)
    }

    fn tick(&mut self, r: f64, y: f64) -> f64 {
        let [kp, ki, kd] = self.gains;
        let [lambda, mu] = self.orders;
        let signal = self.weight * r - y;
        self.signals.push(signal - *self.first.get_or_insert(signal));
        let derivative = self.operator(mu, &self.signals);
        let time = self.filter / self.sample;
        self.filtered = (time * self.filtered + derivative) / (1.0 + time);
        let beside = kp * (r - y) + kd * self.filtered;
        let [least, most] = [self.output - self.stride, self.output + self.stride]
            .map(|u| u.clamp(self.limits[0], self.limits[1]));
        self.samples.push(ki * (r - y));
        let mut whole = beside + self.operator(-lambda, &self.samples);
        if let (Some(tau), true) = (self.tracking, whole < least || whole > most) {
            // By halves, what the limits take away for every sample of the integral.
            let last = self.samples.len() - 1;
            let (mut low, mut high) = (-1e4, 1e4);
            for _ in 0..100 {
                self.samples[last] = 0.5 * (low + high);
                whole = beside + self.operator(-lambda, &self.samples);
                let wanted = ki * (r - y) + (whole.clamp(least, most) - whole) * tau.powf(-lambda);
                if self.samples[last] < wanted { low = self.samples[last] } else { high = self.samples[last] }
            }
        }
        self.output = whole.clamp(least, most);
        self.output
    }
}

/// Largest differences of columns from what is expected, by row.
fn worst(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan)
}

/// q̈ + q = u, on a scheme that is exact to rounding at this step.
fn oscillator(controller: &str, end: f64) -> String {
    format!(
        "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[initial]\nposition = [0.25]\n\
         [scheme]\nkind = \"galerkin\"\ndegree = 5\n[time]\nstep = 0.02\nend = {end}\n{controller}\n"
    )
}

/// The oscillator under forces that are held, turned exactly.
struct Oscillator {
    q: f64,
    p: f64,
}

impl Oscillator {
    fn go(&mut self, time: f64, u: f64) {
        let (sin, cos) = time.sin_cos();
        let (q, p) = (self.q - u, self.p);
        (self.q, self.p) = (u + q * cos + p * sin, p * cos - q * sin);
    }
}

#[test]
fn an_oscillator_in_a_loop_moves_as_one_that_is_turned_exactly() {
    // Sample times of one step and of several; delays of none, of whole steps, and of any length.
    for (every, delay) in [(1, 0.0), (5, 0.0), (2, 0.08), (1, 0.013), (3, 0.137)] {
        let sample = 0.02 * f64::from(every);
        let scenario = oscillator(
            &format!(
                "[controller]\nkind = \"fractional-pid\"\nmeasures = \"q0 + 0.1*p0\"\nsetpoint = \"1 + step(t - 4)\"\n\
                 drives = [1.0]\nkp = 1.5\nki = 0.8\nlambda = 0.9\nkd = 0.6\nmu = 0.7\nderivative_filter = 0.05\n\
                 sample = {sample}\ndelay = {delay}\nlimits = [-0.4, 1.5]\nrate_limit = 25.0\n\
                 anti_windup = {{ kind = \"back-calculation\", time = 0.4 }}\n"
            ),
            12.0,
        );
        let run = Workplace::new().run(&scenario, &[]);
        assert_eq!(run.columns, ["t", "q0", "p0", "energy", "u", "setpoint", "measure"]);
        let mut law = Law {
            filter: 0.05,
            limits: [-0.4, 1.5],
            stride: 25.0 * sample,
            tracking: Some(0.4),
            ..Law::new([1.5, 0.8, 0.6], [0.9, 0.7], sample)
        };
        let mut plant = Oscillator { q: 0.25, p: 0.0 };
        let (mut acting, mut waiting) = (0.0, Vec::<(f64, f64)>::new());
        let (mut positions, mut outputs, mut limited) = (Vec::new(), Vec::new(), 0);
        for step in 0..=600 {
            let now = 0.02 * f64::from(step);
            if step % every == 0 {
                let r = if now > 4.0 - 1e-9 { 2.0 } else { 1.0 };
                waiting.push((now + delay, law.tick(r, plant.q + 0.1 * plant.p)));
                limited += usize::from(law.limits.contains(&law.output));
            }
            positions.push(plant.q);
            outputs.push(law.output);
            let (mut at, next) = (now, now + 0.02);
            while let Some(&(begins, output)) = waiting.first()
                && begins < next - 1e-9
            {
                plant.go(begins.max(now) - at, acting);
                (at, acting) = (begins.max(now), output);
                waiting.remove(0);
            }
            plant.go(next - at, acting);
        }
        let errors = [worst(&run.column("q0"), &positions), worst(&run.column("u"), &outputs)];
        assert!(errors[0] < 1e-9 && errors[1] < 1e-9, "{every} {delay}: {errors:?}");
        assert!(limited > 0, "{every} {delay}: the limits were not reached");
    }
}

#[test]
fn a_first_order_plant_with_dead_time_moves_as_its_exponentials() {
    // ṗ = −p/2 + u by a linear damper; the plant is p.
    let (step, every, delay) = (0.01, 4, 0.12);
    let scenario = format!(
        "[system]\nmass = [1.0]\n[[system.damping]]\norder = 1.0\ncoefficient = [0.5]\n\
         [scheme]\nkind = \"collocation\"\n[time]\nstep = {step}\nend = 10.0\n\
         [controller]\nmeasures = \"p0\"\nsetpoint = \"1\"\ndrives = {{ coordinate = 0, value = 2.0 }}\nkp = 0.6\nki = 0.5\n\
         lambda = 1.1\nkd = 0.1\nmu = 0.5\nsetpoint_weights = [1.0, 1.0]\nsample = 0.04\ndelay = {delay}\n"
    );
    let run = Workplace::new().run(&scenario, &[]);
    let mut law = Law { weight: 1.0, ..Law::new([0.6, 0.5, 0.1], [1.1, 0.5], 0.04) };
    let (mut p, mut expected) = (0.0, Vec::new());
    let (mut acting, mut waiting) = (0.0, Vec::new());
    for step_number in 0..=1000usize {
        if step_number % every == 0 {
            waiting.push((step_number + 12, law.tick(1.0, p)));
        }
        expected.push(p);
        if waiting.first().is_some_and(|&(begins, _)| begins == step_number) {
            acting = waiting.remove(0).1;
        }
        let rest = 2.0 * 2.0 * acting;
        p = rest + (p - rest) * f64::exp(-0.5 * step);
    }
    let error = worst(&run.column("p0"), &expected);
    assert!(error < 1e-9, "{error:e}");
}

#[test]
fn a_fractional_plant_in_a_loop_moves_as_with_all_of_its_past() {
    // q̈ + 0.8 D^½ q + q = u by the midpoint rule, damped at the node by differences of order 1.
    let (h, count) = (0.02, 1000);
    let scenario = format!(
        "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[[system.damping]]\norder = 0.5\ncoefficient = [0.8]\n\
         derivative = \"riemann-liouville\"\n[convolution]\norder = 1\n[time]\nstep = {h}\nsteps = {count}\n\
         [controller]\nmeasures = \"q0\"\nsetpoint = \"1\"\ndrives = [1.0]\nkp = 2.0\nki = 1.0\nlambda = 0.6\nkd = 0.7\nmu = 1.2\n\
         derivative_filter = 0.1\nsample = {h}\n"
    );
    let run = Workplace::new().run(&scenario, &[]);
    let mut law = Law { filter: 0.1, ..Law::new([2.0, 1.0, 0.7], [0.6, 1.2], h) };
    let damping = Law::new([0.0; 3], [1.0; 2], h);
    let leading = 0.8 * h.powf(-0.5);
    let (mut q, mut p, mut nodes, mut expected) = (0.0, 0.0, Vec::new(), Vec::new());
    for _ in 0..=count {
        let u = law.tick(1.0, q);
        expected.push(q);
        // p₁ = p₀ − h G, e = h (p₀ + p₁)/2, G = X + 0.8 D^½ X − u at X = q + e/2.
        nodes.push(0.0);
        let known = 0.8 * damping.operator(0.5, &nodes);
        let e =
            (h * p - 0.5 * h * h * (q + leading * q + known - u)) / (1.0 + 0.25 * h * h * (1.0 + leading));
        let x = q + 0.5 * e;
        *nodes.last_mut().unwrap() = x;
        p -= h * (x + leading * x + known - u);
        q += e;
    }
    let error = worst(&run.column("q0"), &expected);
    assert!(error < 1e-10, "{error:e}");
}

/// E_α(−x), by its series.
fn mittag_leffler(alpha: f64, x: f64) -> f64 {
    (0..80).map(|k| (-x).powi(k) / libm::tgamma(alpha * f64::from(k) + 1.0)).sum()
}

#[test]
fn short_samples_approach_the_continuous_loop() {
    // An integrator under I^½: 1 − E_{3/2}(−t^{3/2}).
    let error = |sample: f64| {
        let scenario = format!(
            "[system]\nmass = [1.0]\n[time]\nstep = {sample}\nend = 4.0\n\
             [controller]\nmeasures = \"p0\"\nsetpoint = \"1\"\ndrives = [1.0]\nki = 1.0\nlambda = 0.5\nsample = {sample}\n"
        );
        let run = Workplace::new().run(&scenario, &[]);
        let exact: Vec<f64> =
            run.column("t").iter().map(|t| 1.0 - mittag_leffler(1.5, t.powf(1.5))).collect();
        worst(&run.column("p0"), &exact)
    };
    let errors = [0.02, 0.01, 0.005].map(error);
    assert!(errors[0] < 0.02, "{errors:?}");
    for pair in errors.windows(2) {
        assert!((1.7..2.4).contains(&(pair[0] / pair[1])), "{errors:?}");
    }
}

/// The function of time t > 0 whose Laplace transform this is, within 10⁻⁶ for steps of these loops.
///
/// Fourier's series of the inverse with Euler's summation. Source: \[AW95\].
fn inverse_laplace(transform: impl Fn(Complex) -> Complex, time: f64) -> f64 {
    const SHIFT: f64 = 18.4;
    const TERMS: i32 = 2000;
    const AVERAGED: i32 = 12;
    let term = |k: i32| {
        let s = Complex(SHIFT / (2.0 * time), f64::from(k) * std::f64::consts::PI / time);
        transform(s).0 * if k == 0 { 0.5 } else { f64::from(1 - 2 * (k % 2)) }
    };
    let mut sum: f64 = (0..TERMS).map(term).sum();
    // The mean of the partial sums that follow, with binomial weights.
    let (mut mean, mut weight) = (0.0, 0.5f64.powi(AVERAGED));
    for k in 0..=AVERAGED {
        sum += term(TERMS + k);
        mean += weight * sum;
        weight *= f64::from(AVERAGED - k) / f64::from(k + 1);
    }
    (0.5 * SHIFT).exp() / time * mean
}

#[test]
fn an_inverse_transform_is_the_function() {
    for time in [0.3, 1.0, 4.0] {
        let found = inverse_laplace(|s| s.power(-1.5), time);
        assert!((found - 2.0 * (time / std::f64::consts::PI).sqrt()).abs() < 1e-6, "{time}: {found}");
    }
}

#[test]
fn sampled_loops_approach_the_step_responses_of_continuous_ones() {
    // P, and the plant as a scenario with its measured value; the gains of a loop that is far from its limit
    // of stability; the dead time.
    type Transfer = fn(Complex) -> Complex;
    let first: Transfer = |s| s.plus(Complex(0.5, 0.0)).inverse().scaled(2.0);
    let oscillator: Transfer = |s| s.times(s).plus(Complex(1.0, 0.0)).inverse();
    let fractional: Transfer =
        |s| s.times(s).plus(s.power(0.5).scaled(0.8)).plus(Complex(1.0, 0.0)).inverse();
    let cases = [
        (
            first,
            "[system]\nmass = [1.0]\n[[system.damping]]\norder = 1.0\ncoefficient = [0.5]\n\
             [scheme]\nkind = \"collocation\"\n",
            ("p0", 2.0),
            ([0.6, 0.4, 0.1], [0.85, 0.6], 0.32),
        ),
        (
            oscillator,
            "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n",
            ("q0", 1.0),
            ([0.5, 0.6, 1.2], [0.7, 0.9], 0.16),
        ),
        (
            fractional,
            "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[[system.damping]]\norder = 0.5\n\
             coefficient = [0.8]\n",
            ("q0", 1.0),
            ([2.0, 1.0, 0.7], [1.2, 0.8], 0.0),
        ),
    ];
    for (plant, system, (measures, drive), ([kp, ki, kd], [lambda, mu], delay)) in cases {
        let exact = |time: f64| {
            let response = |s: Complex| {
                let integral = s.power(-lambda).scaled(ki).plus(Complex(kp, 0.0));
                let dead = Complex(-delay * s.0, -delay * s.1);
                let dead = Complex(dead.1.cos(), dead.1.sin()).scaled(dead.0.exp());
                let forward = plant(s).times(dead);
                // The derivative is that of the measured value.
                let back = forward.times(integral.plus(s.power(mu).scaled(kd))).plus(Complex(1.0, 0.0));
                forward.times(integral).times(back.inverse()).times(s.inverse())
            };
            inverse_laplace(response, time)
        };
        let error = |sample: f64| {
            let scenario = format!(
                "{system}[time]\nstep = {sample}\nend = 8.0\n[controller]\nmeasures = \"{measures}\"\n\
                 setpoint = \"1\"\ndrives = [{drive:?}]\nkp = {kp}\nki = {ki}\nkd = {kd}\nlambda = {lambda}\n\
                 mu = {mu}\nsample = {sample}\ndelay = {delay}\n"
            );
            let run = Workplace::new().run(&scenario, &[]);
            let (times, values) = (run.column("t"), run.column(measures));
            let every = (0.5 / sample).round() as usize;
            let rows = (every..times.len()).step_by(every);
            rows.map(|row| (values[row] - exact(times[row])).abs()).fold(0.0, max_or_nan)
        };
        let errors = [0.02, 0.01, 0.005].map(error);
        println!("{measures}, {delay}: {errors:?}");
        assert!(errors[2] < 0.02, "{measures}, dead time {delay}: {errors:?}");
        for pair in errors.windows(2) {
            assert!((1.6..2.5).contains(&(pair[0] / pair[1])), "{measures}, dead time {delay}: {errors:?}");
        }
    }
}

#[test]
fn a_loop_at_rest_stays_there_unless_values_before_the_start_count_as_zero() {
    // q = 20 without forces, setpoint 20.
    let rest = "[system]\nmass = [1.0]\n[initial]\nposition = [20.0]\n[time]\nstep = 0.01\nend = 1.0\n\
                [controller]\nmeasures = \"q0\"\nsetpoint = \"20\"\ndrives = [1.0]\nkp = 2.0\nki = 1.0\nkd = 0.5\n\
                mu = 0.9\nsample = 0.01\n";
    let place = Workplace::new();
    let run = place.run(rest, &[]);
    assert!(run.column("u").iter().all(|&u| u == 0.0) && run.column("q0").iter().all(|&q| q == 20.0));
    let run = place.run(&format!("{rest}derivative = \"riemann-liouville\"\n"), &[]);
    let kick = -0.5 * 20.0 * 0.01f64.powf(-0.9);
    assert!((run.column("u")[0] - kick).abs() < 1e-9, "{}", run.column("u")[0]);
}

/// An output at its limit is the last multiple of the quantum within it, also where the quotient of the two
/// is rounded: 0.3 and 0.1.
#[test]
fn a_limit_that_is_a_multiple_of_the_quantum_is_reached() {
    let place = Workplace::new();
    for (limit, quantum, reached) in [
        (0.3, 0.1, 0.3),
        (0.7, 0.1, 0.7),
        (0.6, 0.2, 0.6),
        (2.3, 0.1, 2.3),
        (3.3, 1e-4, 3.3),
        (0.35, 0.1, 0.3),
        (1.0, 0.3, 0.9),
    ] {
        for sign in [1.0, -1.0] {
            for precision in ["f64", "f32"] {
                let scenario = format!(
                    "[system]\nmass = [1.0]\n[initial]\nposition = [0.0]\n[time]\nstep = 0.01\nend = 0.1\n\
                     [controller]\nmeasures = \"q0\"\nsetpoint = \"{sign}\"\ndrives = [1.0]\nkp = 20.0\nki = 1.0\n\
                     sample = 0.01\nlimits = [-{limit}, {limit}]\nquantise = {{ output = {quantum} }}\n"
                );
                let run = place.run(&scenario, &["--precision", precision]);
                let near =
                    |u: f64| (u - sign * reached).abs() < 1e-6 * reached && u.abs() <= limit * (1.0 + 1e-7);
                assert!(run.column("u").iter().all(|&u| near(u)), "{limit} {quantum}: {:?}", run.column("u"));
            }
        }
    }
}

const LOOP: &str = "[controller]\nmeasures = \"q0\"\nsetpoint = \"1\"\ndrives = [1.0]\nkp = 1.5\nki = 0.8\nlambda = 0.9\n\
                    kd = 0.6\nmu = 0.7\nsample = 0.06\ndelay = 0.13\nlimits = [-1.0, 2.0]\n\
                    anti_windup = { kind = \"conditional\" }\nquantise = { measure = 1e-3, output = 0.25 }\n\
                    noise = { standard_deviation = 0.01, seed = 3 }\n";

#[test]
fn a_loop_that_is_interrupted_leaves_the_files_of_one_that_was_not() {
    let scenario = oscillator(LOOP, 8.0);
    for precision in [Precision::F64, Precision::F32] {
        let place = Workplace::new();
        place.write("scenario.toml", &scenario);
        let scenario = Scenario::read(&place.path("scenario.toml")).unwrap();
        let go = |directory: &str, until: Option<usize>, resume: bool| {
            let stop = AtomicBool::new(false);
            let options = RunOptions { precision, resume, ..RunOptions::new(place.path(directory)) };
            let end = run(&scenario, &options, &stop, &mut |steps| {
                stop.store(until.is_some_and(|until| steps >= until), Ordering::Relaxed);
            });
            end.unwrap().end
        };
        assert_eq!(go("whole", None, false), RunEnd::Completed);
        assert_eq!(go("parts", Some(101), false), RunEnd::Stopped);
        assert_eq!(go("parts", Some(203), true), RunEnd::Stopped);
        assert_eq!(go("parts", None, true), RunEnd::Completed);
        for file in ["trajectory.csv", "control.svg", "output.svg", "coordinates.svg"] {
            let read = |directory: &str| fs::read(place.path(directory).join(file)).unwrap();
            assert!(read("whole") == read("parts"), "{precision:?}: {file}");
        }
    }
}

#[test]
fn converters_have_their_quanta_limits_hold_and_noise_is_the_seeds() {
    let place = Workplace::new();
    let first = place.run(&oscillator(LOOP, 8.0), &[]);
    for (u, y) in first.column("u").into_iter().zip(first.column("measure")) {
        assert!(u == 0.25 * (u / 0.25).round() && (-1.0..=2.0).contains(&u), "{u}");
        assert!((y / 1e-3 - (y / 1e-3).round()).abs() < 1e-9, "{y}");
    }
    assert_eq!(first.column("u"), place.run(&oscillator(LOOP, 8.0), &[]).column("u"));
    let other = place.run(&oscillator(&LOOP.replace("seed = 3", "seed = 4"), 8.0), &[]);
    assert_ne!(first.column("measure"), other.column("measure"));
    // What is written of it makes the same scenario.
    place.write("scenario.toml", &oscillator(LOOP, 8.0));
    let read = Scenario::read(&place.path("scenario.toml")).unwrap();
    let again = Scenario::from_value(&read).unwrap();
    assert_eq!(serde_json::to_value(&again).unwrap(), serde_json::to_value(&read).unwrap());
}

#[test]
fn several_loops_have_columns_of_their_own_and_do_not_meet() {
    // Two oscillators that know nothing of each other.
    let one = |measures: &str, drives: &str, kp: f64| {
        format!(
            "[[controller]]\nmeasures = \"{measures}\"\nsetpoint = \"1\"\ndrives = {drives}\nkp = {kp}\nki = 0.5\nsample = 0.04\n"
        )
    };
    let both = format!(
        "[system]\nmass = [1.0, 1.0]\npotential = \"0.5*q0^2 + 0.5*q1^2\"\n[time]\nstep = 0.02\nend = 4.0\n{}{}",
        one("q0", "[1.0, 0.0]", 1.0),
        one("q1", "{ coordinate = 1 }", 2.0)
    );
    let run = Workplace::new().run(&both, &[]);
    let names = ["u0", "setpoint0", "measure0", "u1", "setpoint1", "measure1"];
    assert_eq!(run.columns[6..], names);
    for (index, kp) in [(0, 1.0), (1, 2.0)] {
        let alone = format!(
            "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[time]\nstep = 0.02\nend = 4.0\n{}",
            one("q0", "[1.0]", kp)
        );
        let alone = Workplace::new().run(&alone, &[]);
        assert!(worst(&run.column(&format!("u{index}")), &alone.column("u")) < 1e-12);
        assert!(worst(&run.column(&format!("q{index}")), &alone.column("q0")) < 1e-12);
    }
}

#[test]
fn a_large_sparse_system_is_driven_as_a_small_one() {
    let count = 140;
    let diagonal = |number: f64| format!("{:?}", vec![number; count]);
    let scenario = format!(
        "[system]\nmass = {}\nstiffness = {}\n[[system.damping]]\norder = 0.5\ncoefficient = {}\n\
         [time]\nstep = 0.05\nsteps = 200\n[output]\ncoordinates = [3, 4]\n{}",
        diagonal(1.0),
        diagonal(2.0),
        diagonal(0.3),
        "[controller]\nmeasures = \"q3\"\nsetpoint = \"1\"\ndrives = { coordinate = 3 }\nkp = 2.0\nki = 1.0\nsample = 0.05\ndelay = 0.07\n"
    );
    let large = Workplace::new().run(&scenario, &[]);
    let small = Workplace::new().run(
        "[system]\nmass = [1.0]\nstiffness = [2.0]\n[[system.damping]]\norder = 0.5\ncoefficient = [0.3]\n\
         [time]\nstep = 0.05\nsteps = 200\n[controller]\nmeasures = \"q0\"\nsetpoint = \"1\"\ndrives = [1.0]\nkp = 2.0\nki = 1.0\n\
         sample = 0.05\ndelay = 0.07\n",
        &[],
    );
    assert_eq!(large.columns, ["t", "q3", "q4", "p3", "p4", "energy", "u", "setpoint", "measure"]);
    assert!(worst(&large.column("q3"), &small.column("q0")) < 1e-12);
    assert!(worst(&large.column("u"), &small.column("u")) < 1e-12);
    assert!(large.column("q4").iter().all(|&q| q == 0.0));
}

#[test]
fn rows_between_grid_points_have_what_was_held_there_and_setpoints_may_be_files() {
    let place = Workplace::new();
    place.write("r.csv", "t,r\n0,0\n2,1\n3,1\n");
    let scenario = oscillator(&LOOP.replace("\"1\"", "{ file = \"r.csv\" }"), 4.0);
    let grid = place.run(&scenario, &[]);
    let held = |time: f64, name: &str| {
        let last = grid.column("t").iter().rposition(|&t| t <= time + 1e-9).unwrap();
        grid.column(name)[last]
    };
    assert!((held(1.02, "setpoint") - 0.51).abs() < 1e-12 && held(4.0, "setpoint") == 1.0);
    let times = [0.01, 0.59, 0.6, 1.234, 2.5, 4.0];
    let between = place.run(&format!("{scenario}[output]\ntimes = {times:?}\n"), &[]);
    assert_eq!(between.rows.len(), times.len());
    for name in ["u", "setpoint", "measure"] {
        let expected: Vec<f64> = times.iter().map(|&time| held(time, name)).collect();
        assert_eq!(between.column(name), expected, "{name}");
    }
    // An event ends the run between grid points: its row has what was held there.
    let event = format!("{scenario}[[event]]\nwhen = \"t - 1.237\"\naction = \"stop\"\n");
    let ended = place.run(&event, &[]);
    assert_eq!(ended.column("u").last(), Some(&held(1.237, "u")));
}

#[test]
fn arrays_and_sweeps_have_the_columns() {
    let place = Workplace::new();
    place.run(&oscillator(LOOP, 2.0), &[]);
    let arrays = |path: &Path| {
        let bytes = fs::read(path).unwrap();
        ["u.npy", "setpoint.npy", "measure.npy"]
            .iter()
            .all(|name| bytes.windows(name.len()).any(|window| window == name.as_bytes()))
    };
    let output = place.fvi(&["run", "scenario.toml", "--out", "arrays", "--format", "npz"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(arrays(&place.path("arrays/trajectory.npz")));
    place.write(
        "sweep.toml",
        "scenario = \"scenario.toml\"\n[axes]\n\"controller.kp\" = [0.5, 1.0]\n[keep]\nquantities = [\"energy\"]\ntrajectories = true\n",
    );
    let output = place.fvi(&["sweep", "sweep.toml", "--out", "swept"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
}

#[test]
fn what_no_loop_can_serve_is_refused_with_its_key() {
    let good = oscillator(LOOP, 2.0);
    let cases: &[(&str, &str, &[&str])] = &[
        ("measures = \"q0\"\n", "", &["controller", "`measures` is missing"]),
        ("measures = \"q0\"", "measures = \"q1\"", &["controller.measures", "unknown name `q1`"]),
        ("measures = \"q0\"", "measures = \"t\"", &["controller.measures", "unknown name `t`"]),
        ("setpoint = \"1\"", "setpoint = \"q0\"", &["controller.setpoint", "unknown name `q0`"]),
        ("drives = [1.0]", "drives = [1.0, 2.0]", &["controller.drives", "2 entries instead of 1"]),
        ("kp = 1.5", "kp = nan", &["controller.kp", "finite"]),
        ("lambda = 0.9", "lambda = 2.0", &["controller.lambda = 2.0", "greater than 0 and less than 2"]),
        ("mu = 0.7", "mu = 0.0", &["controller.mu = 0.0", "greater than 0 and less than 2"]),
        ("sample = 0.06", "sample = 0.05", &["controller.sample = 0.05", "a multiple of `time.step` = 0.02"]),
        ("sample = 0.06", "sample = 0.01", &["controller.sample = 0.01", "a multiple"]),
        ("delay = 0.13", "delay = -0.1", &["controller.delay = -0.1", "at least 0"]),
        ("limits = [-1.0, 2.0]", "limits = [2.0, -1.0]", &["controller.limits", "smaller"]),
        ("limits = [-1.0, 2.0]", "limits = [2.0]", &["controller.limits", "1 numbers instead of two"]),
        ("limits = [-1.0, 2.0]", "limits = [0.1, 0.2]", &["controller.quantise.output", "limits"]),
        ("\"conditional\"", "\"clamping\"", &["controller.anti_windup.kind", "back-calculation"]),
        (
            "\"conditional\"",
            "\"conditional\", time = 1.0",
            &["controller.anti_windup.time", "back-calculation"],
        ),
        ("measure = 1e-3", "measure = 0", &["controller.quantise.measure = 0", "a number > 0"]),
        ("seed = 3", "seed = -3", &["controller.noise.seed = -3", "whole number"]),
        ("kp = 1.5", "kp = 1.5\nintegral_time = 1.0", &["controller.integral_time", "series"]),
        ("kp = 1.5", "kp = 1.5\nform = \"series\"", &["controller.ki", "parallel"]),
        ("kp = 1.5", "kp = 1.5\nspeed = 1", &["controller.speed", "unknown key"]),
        (
            "kind = \"galerkin\"\ndegree = 5",
            "kind = \"collocation\"",
            &["controller.delay = 0.13", "a multiple of `time.step`"],
        ),
        (
            "kind = \"galerkin\"\ndegree = 5",
            "kind = \"low-order\"\nkappa = 0.0",
            &["controller.delay", "kappa > 0"],
        ),
    ];
    for (passage, replacement, said) in cases {
        assert!(good.contains(passage), "{passage}");
        let place = Workplace::new();
        place.write("scenario.toml", &good.replace(passage, replacement));
        let output = place.fvi(&["run", "scenario.toml"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{replacement}: {message}");
        for said in *said {
            assert!(message.contains(said), "{replacement}: no {said:?} in {message}");
        }
    }
    let adaptive = good
        .replace("kind = \"galerkin\"\ndegree = 5", "kind = \"collocation\"")
        .replace("step = 0.02\nend = 2", "grid = \"adaptive\"\ntolerance = 1e-6\nend = 2");
    let cases = "[[case]]\nname = \"one\"\n";
    for (scenario, said) in [(adaptive, "time.grid"), (format!("{good}{cases}"), "case")] {
        let place = Workplace::new();
        place.write("scenario.toml", &scenario);
        let output = place.fvi(&["run", "scenario.toml"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(said) && message.contains("controller"), "{message}");
    }
}

#[test]
fn numbers_that_leave_single_precision_are_refused_under_their_key() {
    let plain = "[controller]\nmeasures = \"q0\"\nsetpoint = \"1\"\ndrives = [1.0]\nsample = 0.02\n";
    let cases = [
        ("kp = 1e39", "controller.kp = 1e39"),
        ("ki = 1e60", "controller.ki = 1e60"),
        ("kd = 1e39", "controller.kd = 1e39"),
        ("setpoint_weights = [1e39, 0.0]", "controller.setpoint_weights"),
        ("limits = [1.0, 1.00000001]", "controller.limits"),
        ("limits = [-1e-50, 1e-50]", "controller.limits"),
        ("rate_limit = 1e-44", "controller.rate_limit"),
        ("kd = 0.1\nderivative_filter = 1e60", "controller.derivative_filter = 1e60"),
        (
            "kd = 0.1\nderivative_filter = { time = 1e60, order = 0.5 }",
            "controller.derivative_filter.time = 1e60",
        ),
        (
            "limits = [-1.0, 1.0]\nanti_windup = { kind = \"back-calculation\", time = 1e-60 }",
            "controller.anti_windup.time = 1e-60",
        ),
        ("form = \"series\"\nintegral_time = 1e-60", "controller.integral_time = 1e-60"),
        ("form = \"series\"\nkp = 1e30\nintegral_time = 1e-20", "controller.integral_time = 1e-20"),
        (
            "form = \"series\"\nderivative_time = 1e30\nfilter_ratio = 1e-30",
            "controller.derivative_time = 1e30",
        ),
    ];
    let place = Workplace::new();
    for (keys, said) in cases {
        let scenario = oscillator(&format!("{plain}{keys}"), 0.2);
        // One of several too; the constants of a part are refused as its run is.
        let several = scenario.replace("[controller]", "[[controller]]");
        for scenario in [&scenario, &several] {
            let said = if scenario == &several {
                said.replace("controller.", "controller[0].")
            } else {
                said.to_owned()
            };
            place.write("scenario.toml", scenario);
            for arguments in [
                &["run", "scenario.toml", "--precision", "f32"][..],
                &["controller", "scenario.toml", "--format", "c"],
            ] {
                let output = place.fvi(arguments);
                let message = text(&output.stderr);
                assert_eq!(output.status.code(), Some(2), "{keys}: {message}");
                assert!(message.contains(&said), "{arguments:?}: no {said:?} in {message}");
            }
        }
    }
    // A sample time of which single precision has no power.
    let short = oscillator(&format!("{plain}kd = 1.0\nmu = 1.5"), 0.2)
        .replace("0.02", "1e-30")
        .replace("0.2", "1e-29");
    place.write("scenario.toml", &short);
    let message = text(&place.fvi(&["run", "scenario.toml", "--precision", "f32"]).stderr);
    assert!(message.contains("controller.sample = 1e-30") && message.contains("derivative"), "{message}");
}

/// What `fvi tune` writes is taken as it is, and has the constants of a scenario with the same controller.
#[test]
fn constants_follow_from_what_a_tuning_wrote() {
    let place = Workplace::new();
    place.write(
        "tune.toml",
        "[plant]\ngain = 2.0\ntime_constant = 4.0\ndead_time = 0.5\n[specification]\nms = 1.5\n[controller]\nstructure = \"pi\"\nsample = 0.05\n",
    );
    let output = place.fvi(&["tune", "tune.toml", "--out", "tuned"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let alone = std::fs::read_to_string(place.path("tuned/controller.toml")).unwrap();
    let system = "[system]\nmass = [1.0]\npotential = \"q0^2\"\n[initial]\nposition = [0.3]\n[time]\nstep = 0.05\nend = 10.0\n";
    place.write("scenario.toml", &format!("{system}{alone}"));
    for format in ["c", "rust"] {
        let constants = |file: &str| {
            let output = place.fvi(&["controller", file, "--format", format]);
            assert!(output.status.success(), "{file}: {}", text(&output.stderr));
            assert_eq!(text(&output.stderr), "", "endless memories end nowhere");
            text(&output.stdout)
        };
        let found = constants("tuned/controller.toml");
        assert_eq!(found, constants("scenario.toml"));
        assert!(found.contains("integral"), "{found}");
    }
    place.write("empty.toml", "title = \"nothing\"\n");
    let output = place.fvi(&["controller", "empty.toml", "--format", "c"]);
    assert_eq!(output.status.code(), Some(2));
    place.write("wrong.toml", &alone.replace("sample = 0.05", "sample = -1.0"));
    let message = text(&place.fvi(&["controller", "wrong.toml", "--format", "c"]).stderr);
    assert!(message.contains("controller.sample") && message.contains("wrong.toml"), "{message}");
}

#[test]
fn a_measured_value_that_is_no_number_ends_the_run_there() {
    let scenario = oscillator(&LOOP.replace("measures = \"q0\"", "measures = \"sqrt(1.1 - q0)\""), 8.0)
        .replace("setpoint = \"1\"", "setpoint = \"5\"");
    let place = Workplace::new();
    place.write("scenario.toml", &scenario);
    let output = place.fvi(&["run", "scenario.toml", "--out", "out"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("controller") && message.contains("measured value"), "{message}");
    // From the start it is bad input.
    let scenario = oscillator(&LOOP.replace("measures = \"q0\"", "measures = \"sqrt(-q0)\""), 8.0);
    place.write("scenario.toml", &scenario);
    let output = place.fvi(&["run", "scenario.toml", "--out", "other"]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
}

#[test]
fn constants_for_firmware_have_the_tables_and_the_law_of_the_run() {
    let place = Workplace::new();
    let history = "[history]\ntolerance = 1e-7\nhorizon = 1000000\n";
    place.write("scenario.toml", &format!("{}{history}", oscillator(LOOP, 2.0)));
    let listed = |arguments: &[&str]| {
        let output = place.fvi(&[&["controller", "scenario.toml"], arguments].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let rust = listed(&["--format", "rust", "--name", "axis"]);
    for passage in [
        "pub const AXIS_INTEGRAL: fvi_core::ExponentialTable<&[f32]>",
        "pub const AXIS_DERIVATIVE: fvi_core::ExponentialTable<&[f32]>",
        "pub const fn axis_law()",
        "proportional: 1.5, integral: 0.8, derivative: 0.6",
        "limits: [-1.0, 2.0]",
        "anti_windup: fvi_core::AntiWindup::Conditional",
        "pub type AxisPid<L = fvi_core::PidLaw<f32>> = ",
        "pub fn new_axis() -> Result<AxisPid, ",
    ] {
        assert!(rust.contains(passage), "no {passage} in\n{rust}");
    }
    // The tables are those that `fvi exponentials` prints.
    let numbers = |text: &str| {
        let begin = text.find("head: &[").unwrap();
        text[begin..begin + text[begin..].find("slow_blocks").unwrap()].to_owned()
    };
    let arguments = ["--horizon", "1e6", "--tolerance", "1e-7", "--format", "rust", "--precision", "f32"];
    let table = place.fvi(&[&["exponentials", "--exponent", "-0.9"][..], &arguments].concat());
    assert_eq!(numbers(&rust), numbers(&text(&table.stdout)));
    let c = listed(&["--format", "c"]);
    for passage in [
        "static const float controller_integral_head",
        "#define CONTROLLER_DERIVATIVE_TABLE",
        "FVI_ON_INCREMENTS",
        "#define CONTROLLER_SETTINGS",
        ".anti_windup = FVI_PID_CONDITIONAL,",
        ".limits = {-1e0f, 2e0f},",
    ] {
        assert!(c.contains(passage), "no {passage} in\n{c}");
    }
    // A controller with a horizon says when it ends, one without has no end, and tables for single precision.
    let said = text(&place.fvi(&["controller", "scenario.toml", "--format", "c"]).stderr);
    assert_eq!(
        said,
        "note: controller ends after 1000000 samples, 60000 units of time: further ticks are refused\n"
    );
    for (constants, end) in [
        (&rust, "It\n/// ends after 1000000 samples, 60000 units of time: further ticks are refused."),
        (&c, "The controller ends after 1000000 samples, 60000 units of time: further ticks are refused."),
    ] {
        assert!(constants.contains(end), "{constants}");
    }
    place.write("scenario.toml", &oscillator(LOOP, 2.0));
    let (rust, c) = (listed(&["--format", "rust"]), listed(&["--format", "c"]));
    assert!(rust.contains("It has no end.") && c.contains("The controller has no end."), "{rust}{c}");
    for (constants, count, end) in [(&rust, 2, "ENDLESS,"), (&c, 2, "_HORIZON FVI_ENDLESS\n")] {
        assert_eq!(constants.matches(end).count(), count, "{constants}");
        assert!(constants.contains("tolerance 1e-7") && !constants.contains("ends after"), "{constants}");
    }
    let double = listed(&["--format", "rust", "--precision", "f64"]);
    assert!(double.contains("tolerance 4e-15"), "{double}");
    assert_eq!(text(&place.fvi(&["controller", "scenario.toml", "--format", "c"]).stderr), "");
    // What cannot be listed.
    place.write("scenario.toml", &oscillator("", 2.0));
    let refused = |arguments: &[&str], said: &str| {
        let output = place.fvi(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(text(&output.stderr).contains(said), "{}", text(&output.stderr));
    };
    refused(&["controller", "scenario.toml", "--format", "rust"], "the key `controller` is missing");
    place.write("scenario.toml", &oscillator(LOOP, 2.0));
    refused(&["controller", "scenario.toml", "--format", "c", "--precision", "f64"], "single precision");
}
