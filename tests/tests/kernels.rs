//! Kernels other than s^β: every engine sums their weights, motions have their orders against inverse Laplace
//! transforms, passive ones take energy.

use std::path::Path;

use fvi_core::{ActsOn, BdfOrder, Memory};
use fvi_fft::baseline::{Signal, memory_term};
use fvi_fft::memory::{Engine, History};
use fvi_fft::memory::{EngineError, Memories, MemoryRequest};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::quadrature::multistep_weights::multistep_weights;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::language::Document;
use fvi_scenario::scenario::{Scenario, kernel_of_symbol};
use fvi_simulation::simulation::motion::Motion;
use fvi_simulation::simulation::{GridState, Precision, Simulation};
use fvi_tests::convergence::observed_order;
use nalgebra::Complex;
use proptest::prelude::*;

use crate::node_form::states;
use crate::variable_steps::{noise, random_kernel};

const ENGINES: [Engine; 5] =
    [Engine::Direct, Engine::BlockFft, Engine::RealTime, Engine::ExponentialSum, Engine::ExponentialSumCore];

/// Largest error of a memory term in units of u Σ|w||x|: that of the table of exponentials is 36 of them in
/// double precision.
const BOUND: f64 = 80.0;

/// A passive kernel of any form.
fn kernels() -> impl Strategy<Value = TransferFunction> {
    let time = || (-2.0..2.0f64).prop_map(|power| 10f64.powf(power));
    prop_oneof![
        (0.05..1.95f64, time()).prop_map(|(order, rate)| TransferFunction::tempered(order, rate)),
        (0.05..0.95f64, time()).prop_map(|(order, time)| TransferFunction::maxwell(order, 0.0, time)),
        (0.4..1.0f64, 0.0..0.35f64, time())
            .prop_map(|(order, inner, time)| TransferFunction::maxwell(order, inner, time)),
        proptest::collection::vec((0.1..5.0f64, time()), 1..=6).prop_map(|terms| {
            let (strengths, times): (Vec<f64>, Vec<f64>) = terms.into_iter().unzip();
            TransferFunction::prony(&strengths, &times)
        }),
        (0.1..0.95f64, 0.1..1.0f64, time())
            .prop_map(|(order, power, time)| TransferFunction::havriliak_negami(order, power, time)),
        (0.1..0.9f64, time()).prop_map(|(power, time)| TransferFunction::havriliak_negami(1.0, power, time)),
    ]
    .prop_map(|made| made.expect("parameters in their ranges"))
}

/// Its series divides by ln(τs), which vanishes at s = 1/τ: there the weights are those of a circle.
#[test]
fn weights_of_distributed_orders_are_those_of_cauchys_integral() {
    for (from, to, time) in [(0.0, 1.0, 1.0), (0.3, 0.9, 0.05), (1.0, 1.4, 0.04), (0.0, 0.5, 20.0)] {
        let transfer = TransferFunction::distributed(from, to, time).unwrap();
        // From the definition, where it does not cancel.
        let mean = |s: Complex<f64>| {
            let (scaled, width) = (s * time, to - from);
            (scaled.powf(to) - scaled.powf(from)) / (scaled.ln() * width)
        };
        for step in [0.01, 0.05, 0.7] {
            let found = multistep_weights(&transfer, BdfOrder::new(2).unwrap(), step, false, 700).unwrap();
            let (points, radius) = (4096, 0.99_f64);
            let at = |k: usize| {
                let z = Complex::from_polar(
                    radius,
                    2.0 * std::f64::consts::PI * (k as f64 + 0.5) / points as f64,
                );
                (z, mean(((1.0 - z) + 0.5 * (1.0 - z) * (1.0 - z)) / step))
            };
            let values: Vec<_> = (0..points).map(at).collect();
            let largest = values.iter().map(|(_, value)| value.norm()).fold(0.0, max_or_nan);
            for n in [0, 1, 2, 7, 40, 200, 511, 512, 699] {
                let power = |z: &Complex<f64>| z.powi(-n);
                let exact: Complex<f64> = values.iter().map(|(z, value)| value * power(z)).sum();
                let error = (found[n as usize] - exact.re / points as f64).abs();
                let rounding = 2e-12 * largest * radius.powi(-n);
                assert!(error <= rounding, "{transfer}, step {step}, n = {n}: {error:e}, {rounding:e}");
            }
        }
    }
}

fn terms<T: Memories>(
    request: &MemoryRequest<'_>,
    channels: usize,
    samples: &[T],
) -> Result<Vec<T>, EngineError> {
    let mut memory = request.build::<T>()?;
    let mut terms = vec![T::of(f64::NAN); samples.len()];
    for (sample, term) in samples.chunks(channels).zip(terms.chunks_mut(channels)) {
        memory.next_term(term).expect("room for the run");
        memory.push(sample).expect("room for the run");
    }
    Ok(terms)
}

fn agrees_with_the_double_sum<T: Memories>(
    transfer: &TransferFunction,
    family: ConvolutionFamily,
    step_size: f64,
    length: usize,
) -> Result<(), TestCaseError> {
    const CHANNELS: usize = 2;
    let samples: Vec<T> = Signal::Stationary.samples(CHANNELS, length);
    let exact: Vec<f64> = samples.iter().map(|x| x.to_f64()).collect();
    let rule = family.multistep().unwrap().unwrap();
    for engine in ENGINES {
        let history = History { engine: Some(engine), ..History::default() };
        let request = MemoryRequest {
            end: None,
            family,
            starting: &[],
            transfer,
            step_size,
            coordinates: CHANNELS,
            motions: 1,
            samples: length,
            given: false,
            history: &history,
        };
        let on_increments = request.acts_on() != ActsOn::Values;
        let weights = multistep_weights(transfer, rule, step_size, on_increments, length + 1).unwrap();
        let terms = match terms::<T>(&request, CHANNELS, &samples) {
            // Fast poles of a Prony series leave complex exponentials: said, and another engine serves.
            Err(EngineError::Table(_)) if transfer.form() == "prony" => continue,
            // Weights that do not fall off: said.
            Err(EngineError::Unsuited { .. }) if family == ConvolutionFamily::Trapezoidal => continue,
            terms => terms.unwrap_or_else(|error| panic!("{transfer}, {engine:?}: {error}")),
        };
        for k in (0..length).filter(|k| k % 61 < 2 || k + 2 > length) {
            let reference = memory_term(&weights, 1, &exact, CHANNELS, k);
            for (term, reference) in terms[k * CHANNELS..].iter().zip(&reference) {
                let error = (term.to_f64() - reference.sum).abs();
                let unit = 0.5 * T::EPSILON.to_f64() * reference.absolute;
                prop_assert!(
                    error <= BOUND * unit,
                    "{transfer}, {rule}, h = {step_size}, {engine:?}, k = {k}: {:.1} u",
                    error / unit
                );
            }
        }
    }
    Ok(())
}

/// `usual` of something, or as many as an environment variable says: `.ci/kernels` asks for more.
fn wanted(variable: &str, usual: u32) -> u32 {
    std::env::var(variable).map_or(usual, |count| count.parse().expect("a whole number"))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: wanted("KERNELS", 40), ..ProptestConfig::default() })]

    #[test]
    fn every_engine_sums_the_weights_of_every_kernel(
        transfer in prop_oneof![5 => kernels(), 1 => (0.05..1.95f64).prop_map(|order| TransferFunction::power(order).unwrap())],
        family in prop_oneof![
            (1..=3usize).prop_map(|order| ConvolutionFamily::Bdf { order }),
            Just(ConvolutionFamily::Trapezoidal),
        ],
        step in -3.0..0.0f64,
        length in 2..700usize,
        single in any::<bool>(),
    ) {
        let step_size = 10f64.powf(step);
        if single {
            agrees_with_the_double_sum::<f32>(&transfer, family, step_size, length)?;
        } else {
            agrees_with_the_double_sum::<f64>(&transfer, family, step_size, length)?;
        }
    }
}

#[test]
fn weights_of_long_runs_agree_with_a_transform_in_the_middle_and_fall_as_they_must() {
    // Of s^0.6/(1 + s^0.6) ~ s^0.6 for small s: w_n → h^{−0.6} n^{−1.6}/Γ(−0.6) (1 + o(1)).
    let transfer = TransferFunction::maxwell(0.6, 0.0, 1.0).unwrap();
    let order = BdfOrder::new(2).unwrap();
    let weights = multistep_weights(&transfer, order, 0.1, false, 1_000_000).unwrap();
    let power =
        multistep_weights(&TransferFunction::power(0.6).unwrap(), order, 0.1, false, 1_000_000).unwrap();
    let ratio = |n: usize| weights[n] / power[n];
    assert!((ratio(999_999) - 1.0).abs() < 3e-3, "{}", ratio(999_999));
    // 1 − 1.2 … (n h)^{−0.6}: the next term of the expansion.
    let next = |n: usize| (1.0 - ratio(n)) * libm::pow(0.1 * n as f64, 0.6);
    assert!((next(999_999) / next(250_000) - 1.0).abs() < 2e-3);
}

/// The inverse Laplace transform at a time, on the modified Talbot contour of \[WeidemanTrefethen07\].
fn inverse_transform(time: f64, of: impl Fn(Complex<f64>) -> Complex<f64>) -> f64 {
    const POINTS: usize = 56;
    let count = POINTS as f64;
    let term = |k: usize| {
        let theta = std::f64::consts::PI * (2.0 * (k as f64 + 0.5) / count - 1.0);
        let (sine, cosine) = (0.6407 * theta).sin_cos();
        let cotangent = cosine / sine;
        let scaled = Complex::new(0.5017 * theta * cotangent - 0.6122, 0.2645 * theta) * count;
        let slope =
            Complex::new(0.5017 * cotangent - 0.5017 * 0.6407 * theta / (sine * sine), 0.2645) * count;
        scaled.exp() * of(scaled / time) * slope / time
    };
    let sum: Complex<f64> = (0..POINTS).map(term).sum();
    (sum / Complex::new(0.0, count)).re
}

/// The kernels whose orders are shown, as keys and as K(s).
fn analytic_kernels() -> Vec<(&'static str, TransferFunction)> {
    let symbol = |text: &str| kernel_of_symbol(text).unwrap();
    vec![
        (r#"{ symbol = "0.5 + 1.5*s^0.6/(1 + s^0.6)" }"#, symbol("0.5 + 1.5*s^0.6/(1 + s^0.6)")),
        (
            r#"{ form = "maxwell", order = 0.6, time = 1.0 }"#,
            TransferFunction::maxwell(0.6, 0.0, 1.0).unwrap(),
        ),
        (
            r#"{ form = "prony", strengths = [1.0, 0.7], times = [1.0, 0.1] }"#,
            TransferFunction::prony(&[1.0, 0.7], &[1.0, 0.1]).unwrap(),
        ),
        (
            r#"{ form = "havriliak-negami", order = 0.7, power = 0.5, time = 1.0 }"#,
            TransferFunction::havriliak_negami(0.7, 0.5, 1.0).unwrap(),
        ),
        (r#"{ form = "tempered", order = 0.5, rate = 0.3 }"#, TransferFunction::tempered(0.5, 0.3).unwrap()),
        (r#"{ form = "distributed" }"#, TransferFunction::distributed(0.0, 1.0, 1.0).unwrap()),
        (
            r#"{ form = "distributed", from = 0.3, to = 0.9, time = 0.5 }"#,
            TransferFunction::distributed(0.3, 0.9, 0.5).unwrap(),
        ),
        (r#"{ symbol = "0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)" }"#, symbol("0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)")),
    ]
}

#[test]
fn motions_have_the_orders_of_node_form_for_every_analytic_kernel() {
    for (keys, transfer) in analytic_kernels() {
        // q̈ + q + K(D) q = 0 from q = 1, Riemann–Liouville: q̂ = s/(s² + 1 + K(s)).
        let exact = inverse_transform(3.0, |s| s / (s * s + 1.0 + transfer.value(s) + transfer.spring()));
        for (degree, formula, smallest_order, largest_error) in
            [(1, 2, 1.9, 2e-4), (2, 3, 2.85, 1e-5), (2, 4, 3.6, 1e-7), (3, 5, 4.6, 2e-8)]
        {
            let steps = [32, 64, 128];
            let error = |steps_in_one: usize| {
                let text = format!(
                    "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[[system.damping]]\ncoefficient = [1.0]\n\
                     kernel = {keys}\nderivative = \"riemann-liouville\"\n[initial]\nposition = [1.0]\n[scheme]\n\
                     kind = \"galerkin\"\ndegree = {degree}\n[convolution]\norder = {formula}\n[time]\n\
                     step = {}\nsteps = {}\n[output]\nmomentum = \"one-sided\"\n",
                    1.0 / steps_in_one as f64,
                    3 * steps_in_one
                );
                (states(&text, None).last().unwrap().position[0] - exact).abs()
            };
            let errors = steps.map(error);
            // Resonances of the kernel want short steps before errors fall as they will.
            let order = (errors[1] / errors[2]).log2();
            let at = format!("{keys}, Gauss {degree}, BDF {formula}: {errors:?}");
            assert!(errors[1] < largest_error, "{at}");
            assert!(order > smallest_order || errors[2] < 2e-11, "order {order:.2}, {at}");
        }
    }
}

#[test]
fn the_trapezoidal_rule_has_order_two_for_every_kernel() {
    let powers = [0.5, 1.5].map(|order| {
        (format!("{{ form = \"power\", order = {order} }}"), TransferFunction::power(order).unwrap())
    });
    let others = analytic_kernels().into_iter().map(|(keys, transfer)| (keys.to_owned(), transfer));
    for (keys, transfer) in powers.into_iter().chain(others) {
        // Caputo's form: s² q̂ − s + q̂ + K(s) (q̂ − 1/s) = 0.
        let kernel = |s: Complex<f64>| transfer.value(s) + transfer.spring();
        let exact = inverse_transform(3.0, |s| (s + kernel(s) / s) / (s * s + 1.0 + kernel(s)));
        let errors = [32, 64, 128].map(|steps_in_one: usize| {
            let text = format!(
                "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[[system.damping]]\ncoefficient = [1.0]\n\
                 kernel = {keys}\n[initial]\nposition = [1.0]\n[convolution]\nsymbol = \"trapezoidal\"\n[time]\n\
                 step = {}\nsteps = {}\n",
                1.0 / steps_in_one as f64,
                3 * steps_in_one
            );
            (states(&text, None).last().unwrap().position[0] - exact).abs()
        });
        let order = (errors[1] / errors[2]).log2();
        assert!(order > 1.8 && errors[1] < 2e-4, "order {order:.2}, {keys}: {errors:?}");
    }
}

#[test]
fn runge_kutta_quadrature_has_its_order_with_every_kernel_that_relaxes() {
    // (s − 1)/ln s falls more slowly than any power at 0.
    let more = ["(s - 1)/log(s)", "log(1 + s)", "sqrt(s)/tanh(sqrt(s))"];
    let more = more.map(|text| (format!("{{ symbol = \"{text}\" }}"), kernel_of_symbol(text).unwrap()));
    let usual = analytic_kernels().into_iter().map(|(keys, transfer)| (keys.to_owned(), transfer));
    for (keys, transfer) in usual.filter(|(_, transfer)| transfer.is_relaxation()).chain(more) {
        // Caputo's form: s² q̂ − s + q̂ + K(s) (q̂ − 1/s) = 0.
        let kernel = |s: Complex<f64>| transfer.value(s) + transfer.spring();
        let exact = inverse_transform(3.0, |s| (s + kernel(s) / s) / (s * s + 1.0 + kernel(s)));
        for (scheme, smallest_order) in [
            ("kind = \"collocation\"\n", 3.7),
            ("kind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n", 2.7),
        ] {
            let steps = [16, 32, 64];
            let error = |steps_in_one: usize| {
                let text = format!(
                    "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[[system.damping]]\ncoefficient = [1.0]\n\
                     kernel = {keys}\n[initial]\nposition = [1.0]\n[scheme]\n\
                     {scheme}[time]\nstep = {}\nsteps = {}\n",
                    1.0 / steps_in_one as f64,
                    3 * steps_in_one
                );
                (states(&text, None).last().unwrap().position[0] - exact).abs()
            };
            let errors = steps.map(error);
            let order = observed_order(&steps.map(|count| 1.0 / count as f64), &errors);
            assert!(
                order > smallest_order || errors[2] < 2e-11,
                "order {order:.2}, {keys}, {scheme}: {errors:?}"
            );
        }
    }
}

/// The table of a kernel in a scenario.
fn keys_of(transfer: &TransferFunction) -> String {
    let parameters = transfer.parameters();
    let keys = parameters.iter().map(|(name, numbers)| match (*name, &numbers[..]) {
        ("strengths" | "times", numbers) => format!(", {name} = {numbers:?}"),
        (_, numbers) => format!(", {name} = {:?}", numbers[0]),
    });
    format!("{{ form = \"{}\"{} }}", transfer.form(), keys.collect::<String>())
}

/// Degree of the nodes and order of the formula, which is that of the scheme.
const SCHEMES: [(usize, usize); 4] = [(1, 2), (2, 3), (2, 4), (3, 5)];

#[test]
fn motions_have_the_orders_of_node_form_for_kernels_with_random_parameters() {
    let mut numbers = noise(2033);
    for _ in 0..wanted("KERNELS", 16) {
        let transfer = random_kernel(&mut numbers);
        let (keys, strength) = (keys_of(&transfer), 10f64.powf(numbers() - 0.7));
        // q̈ + 2q + ρ K(D) q = 0 from q = 1, Riemann–Liouville: q̂ = s/(s² + 2 + ρ K(s)), at three times,
        // since the error passes zero at some.
        let exact = [1.0, 1.5, 2.0].map(|time| {
            (time, inverse_transform(time, |s| s / (s * s + 2.0 + strength * transfer.value(s))))
        });
        // What grows faster than s wants short steps where it is strong, but for the midpoint rule.
        let taken = SCHEMES.iter().filter(|(_, formula)| *formula == 2 || transfer.growth() <= 1.0);
        for &(degree, formula) in taken {
            let error = |steps_in_one: usize| {
                let text = format!(
                    "[system]\nmass = [1.0]\npotential = \"q0^2\"\n[[system.damping]]\ncoefficient = [{strength:?}]\n\
                     kernel = {keys}\nderivative = \"riemann-liouville\"\n[initial]\nposition = [1.0]\n[scheme]\n\
                     kind = \"galerkin\"\ndegree = {degree}\n[convolution]\norder = {formula}\n[time]\nstep = {:?}\n\
                     steps = {}\n",
                    1.0 / steps_in_one as f64,
                    2 * steps_in_one
                );
                let states = states(&text, None);
                let error = |(time, exact): (f64, f64)| {
                    (states[(time * steps_in_one as f64) as usize].position[0] - exact).abs()
                };
                exact.map(error).into_iter().fold(0.0, max_or_nan)
            };
            let errors = [64, 128, 256].map(error);
            let orders = [0, 1].map(|k| (errors[k] / errors[k + 1]).log2());
            let expected = formula as f64 - 0.4;
            assert!(
                orders[0].max(orders[1]) > expected || errors[2] < 5e-11,
                "{keys}, ρ = {strength}, Gauss {degree}, BDF {formula}: {errors:?}, orders {orders:?}"
            );
        }
    }
}

/// The solution of ẋ = A x at a time: Taylor's series of the exponential of A t/2ᵏ, squared k times.
pub(crate) fn of_ode(matrix: &nalgebra::DMatrix<f64>, start: &[f64], time: f64) -> nalgebra::DVector<f64> {
    const SQUARINGS: i32 = 16;
    let scaled = matrix * (time * 0.5f64.powi(SQUARINGS));
    let identity = nalgebra::DMatrix::identity(matrix.nrows(), matrix.nrows());
    let mut exponential =
        (1..=24).rev().fold(identity.clone(), |sum, n| &identity + &scaled * sum / f64::from(n));
    for _ in 0..SQUARINGS {
        exponential = &exponential * &exponential;
    }
    exponential * nalgebra::DVector::from_column_slice(start)
}

#[test]
fn prony_series_and_waves_move_as_the_ode_with_more_states() {
    // q̈ + 2q + f = 0, of each element of a series ḟ = g q̇ − f/τ; of ½ s (s + a)/((s + a)² + b²)
    // f = x/2, ẋ = q̇ − a x + b y, ẏ = −b x − a y. Times from a tenth of a step to longer than the run.
    let (strengths, times) = ([1.0, 0.7, 0.3, 2.0], [1.0, 0.1, 1e-3, 50.0]);
    let mut series = nalgebra::DMatrix::zeros(6, 6);
    let mut waves = nalgebra::DMatrix::zeros(4, 4);
    for matrix in [&mut series, &mut waves] {
        (matrix[(0, 1)], matrix[(1, 0)]) = (1.0, -2.0);
    }
    for (j, (g, time)) in strengths.iter().zip(times).enumerate() {
        (series[(1, 2 + j)], series[(2 + j, 1)], series[(2 + j, 2 + j)]) = (-1.0, *g, -1.0 / time);
    }
    let (a, b) = (0.1, 2.0);
    (waves[(1, 2)], waves[(2, 1)]) = (-0.5, 1.0);
    (waves[(2, 2)], waves[(2, 3)], waves[(3, 2)], waves[(3, 3)]) = (-a, b, -b, -a);
    let prony = format!("{{ form = \"prony\", strengths = {strengths:?}, times = {times:?} }}");
    let symbol = "{ symbol = \"0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)\" }".to_owned();
    for (keys, matrix) in [(prony, series), (symbol, waves)] {
        let mut start = vec![0.0; matrix.nrows()];
        (start[0], start[1]) = (1.0, -0.4);
        let exact = of_ode(&matrix, &start, 3.0)[0];
        for (degree, formula) in SCHEMES {
            let error = |steps_in_one: usize| {
                let text = format!(
                    "[system]\nmass = [1.0]\npotential = \"q0^2\"\n[[system.damping]]\ncoefficient = [1.0]\n\
                     kernel = {keys}\n[initial]\nposition = [1.0]\nvelocity = [-0.4]\n[scheme]\nkind = \"galerkin\"\n\
                     degree = {degree}\n[convolution]\norder = {formula}\n[time]\nstep = {:?}\nsteps = {}\n",
                    1.0 / steps_in_one as f64,
                    3 * steps_in_one
                );
                (states(&text, None).last().unwrap().position[0] - exact).abs()
            };
            let errors = [64, 128, 256].map(error);
            let order = (errors[1] / errors[2]).log2();
            let at = format!("{keys}, Gauss {degree}, BDF {formula}: {errors:?}, order {order:.2}");
            assert!(order > formula as f64 - 0.35 || errors[2] < 3e-12, "{at}");
            assert!(formula < 4 || errors[2] < 1e-9, "{at}");
        }
    }
}

#[test]
fn waves_move_on_exponentials_in_pairs_as_on_the_plain_sum() {
    let waves = "s*(s + 0.05)/((s + 0.05)^2 + 4)";
    // On values, and on increments.
    for symbol in [waves.to_owned(), format!("0.2*s + {waves}")] {
        for rule in ["order = 1", "order = 2"] {
            let moved = |history: &str| {
                states(
                    &format!(
                        "[system]\nmass = [1.0, 2.0]\npotential = \"q0^2 + q1^2 + q0*q1\"\n[[system.damping]]\n\
                         coefficient = [1.0, 0.5]\nkernel = {{ symbol = \"{symbol}\" }}\n[initial]\n\
                         position = [1.0, -0.4]\n[convolution]\n{rule}\n[time]\nstep = 0.02\nsteps = 1500\n\
                         [history]\nengine = {history}\n"
                    ),
                    None,
                )
            };
            let (exact, found) = (moved("\"direct\""), moved("\"exponential-sum\"\ntolerance = 1e-9"));
            for (exact, found) in exact.iter().zip(&found) {
                for (exact, found) in exact.position.iter().zip(&found.position) {
                    assert!((exact - found).abs() < 1e-7, "{symbol}, {rule}: {exact} {found}");
                }
            }
            assert!(exact.iter().zip(&found).any(|(exact, found)| exact.position != found.position));
        }
    }
}

#[test]
fn starting_weights_of_kernels_give_back_the_order_that_a_singular_start_takes() {
    // K(D) of t^1.6 + t²/2 against inverse transforms.
    for transfer in [
        TransferFunction::maxwell(0.6, 0.0, 1.0).unwrap(),
        TransferFunction::havriliak_negami(0.7, 0.5, 1.0).unwrap(),
        TransferFunction::tempered(0.5, 0.3).unwrap(),
    ] {
        let (nu, order) = (1.6, BdfOrder::new(3).unwrap());
        let exact = |time: f64| {
            inverse_transform(time, |s| {
                transfer.value(s) * libm::tgamma(nu + 1.0) * (s.ln() * (-nu - 1.0)).exp()
            })
        };
        for steps in [40, 160] {
            let step = 2.0 / steps as f64;
            let history = History { engine: Some(Engine::Direct), ..History::default() };
            let error = |starting: &[f64]| {
                let request = MemoryRequest {
                    end: None,
                    family: ConvolutionFamily::Bdf { order: order.get() },
                    starting,
                    transfer: &transfer,
                    step_size: step,
                    coordinates: 1,
                    motions: 1,
                    samples: steps + 1,
                    given: true,
                    history: &history,
                };
                let mut memory = request.build::<f64>().unwrap();
                let mut largest = 0.0_f64;
                for k in 0..=steps {
                    let (time, mut term) = (step * k as f64, [0.0]);
                    let sample = libm::pow(time, nu) + 0.5 * time * time;
                    memory.next_term(&mut term).unwrap();
                    let found = term[0] + memory.leading()[0] * sample;
                    memory.push(&[sample]).unwrap();
                    if k > 2 {
                        let square = inverse_transform(time, |s| transfer.value(s) / (s * s * s));
                        largest = max_or_nan(largest, (found - exact(time) - square).abs());
                    }
                }
                largest
            };
            let (plain, corrected) = (error(&[]), error(&[1.6, 2.0]));
            assert!(
                corrected < 1e-10 && plain > 1e3 * corrected,
                "{transfer}, {steps}: {plain:e} {corrected:e}"
            );
        }
    }
}

/// A grid that is finer where the motion begins.
fn graded(steps: usize, end: f64, exponent: f64) -> String {
    format!(
        "[scheme]\nkind = \"collocation\"\n[time]\ngrid = \"graded\"\nexponent = {exponent:?}\nend = {end:?}\nsteps = {steps}\n"
    )
}

#[test]
fn graded_and_adaptive_grids_have_the_order_of_their_method_with_every_kernel_that_relaxes() {
    for (keys, transfer) in analytic_kernels().into_iter().filter(|(_, transfer)| transfer.is_relaxation()) {
        // Caputo's form: s² q̂ − s + q̂ + K(s) (q̂ − 1/s) = 0.
        let kernel = |s: Complex<f64>| transfer.value(s) + transfer.spring();
        let exact = inverse_transform(3.0, |s| (s + kernel(s) / s) / (s * s + 1.0 + kernel(s)));
        let last = |time: &str| {
            let text = format!(
                "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[[system.damping]]\ncoefficient = [1.0]\n\
                 kernel = {keys}\n[initial]\nposition = [1.0]\n{time}"
            );
            (moved(&text).last().unwrap().position[0] - exact).abs()
        };
        let errors = [40, 80, 160].map(|steps| last(&graded(steps, 3.0, 3.0)));
        // Over both refinements: the error of one may pass zero.
        let order = 0.5 * (errors[0] / errors[2]).log2();
        assert!(order > 4.3 || errors[2] < 5e-12, "order {order:.2}, {keys}: {errors:?}");
        let adaptive =
            "[scheme]\nkind = \"collocation\"\n[time]\ngrid = \"adaptive\"\nend = 3.0\ntolerance = 1e-8\n";
        let error = last(adaptive);
        assert!(error < 1e-8, "{keys}: {error:e}");
    }
}

#[test]
fn a_sphere_that_settles_under_bassets_force_has_its_closed_form_to_nine_digits() {
    // q̈ + 3 D^{3/2} q + q̇ = 1 from rest: q̇ = [(1 − w(α))/α − (1 − w(β))/β]/(β − α),
    // w(x) = e^{x²t} erfc(x √t), with x² ∫ w dt = w − 1 + 2x √(t/π).
    let (low, high) = (0.5 * (3.0 - 5f64.sqrt()), 0.5 * (3.0 + 5f64.sqrt()));
    let exact = |t: f64| {
        let w = |x: f64| (x * x * t).exp() * libm::erfc(x * t.sqrt());
        let sum = |x: f64| (w(x) - 1.0 + 2.0 * x * (t / std::f64::consts::PI).sqrt()) / (x * x);
        let velocity = ((1.0 - w(low)) / low - (1.0 - w(high)) / high) / (high - low);
        let position = ((t - sum(low)) / low - (t - sum(high)) / high) / (high - low);
        (position, velocity)
    };
    // By its order and by its symbol, whose table is made from its jump across the cut.
    for keys in ["order = 1.5", "kernel = { symbol = \"s^1.5\" }"] {
        let text = format!(
            "[system]\nmass = [1.0]\nforce = [\"1\"]\n[[system.damping]]\ncoefficient = [3.0]\n{keys}\n\
             [[system.damping]]\ncoefficient = [1.0]\norder = 1.0\n[initial]\nposition = [0.0]\n{}",
            graded(100, 8.0, 3.0)
        );
        for state in moved(&text).iter().skip(1) {
            let (position, velocity) = exact(state.time);
            let errors = ((state.position[0] - position).abs(), (state.momentum[0] - velocity).abs());
            assert!(errors.0 < 1e-9 && errors.1 < 1e-9, "{keys}, t = {}: {errors:?}", state.time);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: wanted("KERNELS", 24), ..ProptestConfig::default() })]

    /// The theorem of book/src/theory/kernels.md.
    #[test]
    fn the_midpoint_rule_gains_no_energy_from_a_passive_kernel(
        transfer in kernels(),
        rule in prop_oneof![Just("order = 1"), Just("order = 2"), Just("symbol = \"trapezoidal\"")],
        stiffness in -1.0..12.0f64,
        strength in -2.0..3.0f64,
        step in -2.0..0.5f64,
    ) {
        // Where Caputo's form leaves out a velocity, it may push at first.
        let velocity = if transfer.growth() > 1.0 { 0.0 } else { 0.3 };
        let text = format!(
            "[system]\nmass = [1.0]\npotential = \"0.5*k*q0^2\"\nparameters = {{ k = {:?} }}\n[[system.damping]]\n\
             coefficient = [{:?}]\nkernel = {}\n[initial]\nposition = [1.0]\nvelocity = [{velocity:?}]\n\
             [convolution]\n{rule}\n[time]\nstep = {:?}\nsteps = {}\nenergy_guard = \"off\"\n",
            10f64.powf(stiffness),
            10f64.powf(strength),
            keys_of(&transfer),
            10f64.powf(step),
            wanted("STEPS", 300),
        );
        let states = states(&text, None);
        let first = states[0].energy;
        // The factor of a stiff step is rounded, as if the mass were another by u (ωh)²/4 of itself: the
        // energy with that mass does not rise, and this one goes up and down beside it by as much.
        let turned = 10f64.powf(0.5 * stiffness + step);
        let rounding = 0.5 * f64::EPSILON * turned * turned;
        for state in &states {
            prop_assert!(state.energy <= first * (1.0 + 1e-9 + rounding), "{text}\n{} after {first}", state.energy);
        }
    }
}

/// An oscillator damped by these keys of a kernel.
fn damped(keys: &str, rest: &str) -> String {
    format!(
        "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[[system.damping]]\ncoefficient = [0.7]\n{keys}\n[initial]\n\
         position = [1.0]\nvelocity = [0.3]\n{rest}"
    )
}

#[test]
fn weights_of_a_file_move_a_system_as_the_kernel_that_they_are_of() {
    let (step, steps) = (0.05, 700);
    let order = BdfOrder::new(2).unwrap();
    let weights =
        |transfer: &TransferFunction| multistep_weights(transfer, order, step, false, steps + 1).unwrap();
    let maxwell = TransferFunction::maxwell(0.8, 0.1, 0.4).unwrap();
    let tempered = TransferFunction::tempered(0.4, 1.7).unwrap();
    for (transfer, keys) in [
        (&maxwell, "kernel = { form = \"maxwell\", order = 0.8, inner = 0.1, time = 0.4 }"),
        (&tempered, "kernel = { form = \"tempered\", order = 0.4, rate = 1.7 }"),
    ] {
        let given = format!("kernel = {{ weights = {:?} }}", weights(transfer));
        for scheme in [
            "[convolution]\norder = 2\n",
            "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\norder = 2\n",
            "[scheme]\nkind = \"low-order\"\nkappa = 0.0\n[convolution]\norder = 2\nat = \"main-nodes\"\n",
            "[scheme]\nkind = \"explicit-euler\"\n[convolution]\norder = 2\n",
        ] {
            for engine in ["direct", "block-fft", "real-time"] {
                for derivative in ["caputo", "riemann-liouville"] {
                    // What its samples leave in the momentum is known of K(s) alone.
                    let rest = format!(
                        "{scheme}[time]\nstep = {step}\nsteps = {steps}\nenergy_guard = \"warn\"\n[history]\n\
                         engine = \"{engine}\"\n"
                    );
                    let told = |kernel: &str| {
                        states(&damped(&format!("{kernel}\nderivative = \"{derivative}\""), &rest), None)
                    };
                    let (found, known) = (told(&given), told(keys));
                    for (found, known) in found.iter().zip(&known) {
                        let error = max_or_nan(
                            (found.position[0] - known.position[0]).abs(),
                            (found.momentum[0] - known.momentum[0]).abs(),
                        );
                        assert!(error < 2e-12, "{keys}, {scheme}, {engine}, t = {}: {error:e}", known.time);
                    }
                }
            }
        }
    }
}

#[test]
fn weights_are_refused_where_they_are_none_of_the_run() {
    let refusal = |keys: &str, rest: &str| {
        let document = Document::new("weights.toml", Path::new("."), &damped(keys, rest));
        Scenario::from_document(document)
            .and_then(|scenario| Simulation::new(&scenario, Precision::F64).map(|_| ()))
            .map_err(|error| error.to_string())
    };
    // A damper of ρ = 0.7 by backward differences at h = 0.1.
    let linear = |count: usize, rest: &str| {
        let mut weights = vec![0.0; count];
        (weights[0], weights[1]) = (10.0, -10.0);
        format!("kernel = {{ weights = {weights:?}{rest} }}")
    };
    let time = "[time]\nstep = 0.1\nsteps = 10\n";
    assert_eq!(refusal(&linear(11, ""), time), Ok(()));
    assert_eq!(refusal(&linear(11, ", step = 0.1"), time), Ok(()));
    let short = "[history]\nengine = \"direct\"\ncapacity = 3\noverflow = \"forget\"\n";
    assert_eq!(refusal(&linear(4, ""), &format!("{time}{short}")), Ok(()));
    let staged =
        "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n";
    let graded = "[scheme]\nkind = \"collocation\"\n[time]\ngrid = \"graded\"\nexponent = 2.0\nsteps = 10\nend = 1.0\n";
    let starting = "[convolution]\norder = 2\nat = \"main-nodes\"\nstarting = [0.5]\n";
    let active = "kernel = { weights = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0] }";
    for (keys, rest, reason) in [
        (linear(10, ""), time.to_owned(), "10 weights where a run of 10 steps needs 11, n = 0…10"),
        (linear(3, ""), format!("{time}{short}"), "3 weights where a run of 10 steps needs 4"),
        (linear(11, ", step = 0.2"), time.to_owned(), "`time.step` = 0.1"),
        (linear(11, ""), format!("{staged}{time}"), "a Runge–Kutta family"),
        (linear(11, ""), graded.to_owned(), "steps that differ"),
        (linear(11, ""), format!("{starting}{time}"), "system.damping[0].kernel"),
        (
            linear(11, ""),
            format!("{time}[history]\nengine = \"exponential-sum\"\n"),
            "weights do not tell the kernel",
        ),
        (active.to_owned(), time.to_owned(), "not allowed"),
    ] {
        let message = refusal(&keys, &rest).unwrap_err();
        assert!(message.contains(reason), "{keys}\n{rest}\n{message}");
    }
    assert_eq!(refusal(&format!("{active}\nallow_active = true"), time), Ok(()));
    // Other steps over the same time, as a study of convergence takes them.
    let document = Document::new("weights.toml", Path::new("."), &damped(&linear(21, ""), time));
    let scenario = Scenario::from_document(document).unwrap().in_steps(20);
    let refused = Simulation::new(&scenario, Precision::F64).err().unwrap().to_string();
    assert!(refused.contains("steps of 0.05"), "{refused}");
}

#[test]
fn the_step_of_weights_is_checked_as_that_of_their_kernel() {
    // Gauss 2 with BDF 4, strongly damped by s^1.4: too long a step is found by K(γ(z)/h) and by Σ w_n zⁿ
    // alike.
    let order = BdfOrder::new(4).unwrap();
    let transfer = TransferFunction::tempered(1.4, 0.5).unwrap();
    for (step, is_stable) in [(0.01, true), (0.4, false)] {
        let weights = multistep_weights(&transfer, order, step, false, 401).unwrap();
        let rest = format!(
            "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\norder = 4\n[time]\nstep = {step}\nsteps = 400\n"
        );
        for keys in [
            "kernel = { form = \"tempered\", order = 1.4, rate = 0.5 }".to_owned(),
            format!("kernel = {{ weights = {weights:?} }}"),
        ] {
            let text = damped(&keys, &rest).replace("[0.7]", "[3.0]");
            let scenario = Scenario::from_document(Document::new("w.toml", Path::new("."), &text)).unwrap();
            let found =
                Simulation::new(&scenario, Precision::F64).map(|_| ()).map_err(|error| error.to_string());
            assert_eq!(found.is_ok(), is_stable, "{keys:.40}: {found:?}");
        }
    }
}

#[test]
fn kernels_are_refused_where_they_have_no_memory() {
    let scenario = |rest: &str| {
        let text = format!(
            "[system]\nmass = [1.0]\n[[system.damping]]\ncoefficient = [1.0]\nkernel = {{ form = \"maxwell\", order = 0.6, \
             time = 1.0 }}\n[initial]\nposition = [1.0]\n{rest}"
        );
        let document = Document::new("kernels.toml", Path::new("."), &text);
        let refused = |error: fvi_scenario::language::InputError| error.to_string();
        match Scenario::from_document(document) {
            Ok(scenario) => Simulation::new(&scenario, Precision::F64).map(|_| ()).map_err(refused),
            Err(error) => Err(refused(error)),
        }
    };
    assert_eq!(scenario("[time]\nstep = 0.1\nsteps = 10\n"), Ok(()));
    assert_eq!(scenario("[scheme]\nkind = \"collocation\"\n[time]\nstep = 0.1\nsteps = 10\n"), Ok(()));
    let graded = "[scheme]\nkind = \"collocation\"\n[time]\ngrid = \"graded\"\nexponent = 2.0\nsteps = 10\nend = 1.0\n";
    assert_eq!(scenario(graded), Ok(()));
    let rest = format!("[initial]\nposition = [1.0]\n{graded}");
    let text = format!(
        "[system]\nmass = [1.0]\n[[system.damping]]\ncoefficient = [1.0]\n\
         kernel = {{ symbol = \"0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)\" }}\n{rest}"
    );
    let waves = Scenario::from_document(Document::new("waves.toml", Path::new("."), &text)).unwrap();
    let message = Simulation::new(&waves, Precision::F64).err().unwrap().to_string();
    assert!(message.contains("steps of any length") && message.contains("\"bdf\""), "{message}");
    let starting =
        "[convolution]\norder = 2\nat = \"main-nodes\"\nstarting = [0.5]\n[time]\nstep = 0.1\nsteps = 10\n";
    assert_eq!(scenario(starting), Ok(()));
    let text = text.replace(&rest, &format!("[initial]\nposition = [1.0]\n{starting}"));
    let message =
        Scenario::from_document(Document::new("waves.toml", Path::new("."), &text)).unwrap_err().to_string();
    assert!(message.contains("system.damping[0].kernel"), "{message}");
    let message = scenario(
        "[convolution]\nsymbol = \"trapezoidal\"\nat = \"main-nodes\"\n[time]\nstep = 0.1\nsteps = 10\n",
    )
    .unwrap_err();
    assert!(message.contains("damping at the main nodes"), "{message}");
    let message = scenario(
        "[convolution]\nsymbol = \"trapezoidal\"\n[history]\nengine = \"exponential-sum\"\n[time]\nstep = 0.1\nsteps = 10\n",
    )
    .unwrap_err();
    assert!(message.contains("alternate in sign"), "{message}");
}

/// A frame of three masses on materials with memory, with a harmonic force on the last.
fn material(kernels: &[(&str, &str)], convolution: &str, rest: &str) -> String {
    let term = |(keys, coefficient): &(&str, &str)| {
        format!("[[system.damping]]\ncoefficient = {coefficient}\n{keys}\n")
    };
    let damping: String = kernels.iter().map(term).collect();
    format!(
        "[system]\nmass = [1.0, 0.5, 2.0]\nstiffness = [[40.0, -15.0, 0.0], [-15.0, 30.0, -10.0], [0.0, -10.0, 12.0]]\n\
         force = [\"0\", \"0\", \"0.4*cos(1.3*t)\"]\nforce_quadrature = \"nodes\"\n{damping}[initial]\n\
         position = [0.3, -0.2, 0.1]\nvelocity = [0.5, 0.0, -1.0]\n[convolution]\n{convolution}\n\
         [output]\nmemory_energy = true\n[time]\nstep = 0.02\nsteps = 600\n{rest}"
    )
}

/// The states of a motion with everything that its scenario asks for.
fn moved(text: &str) -> Vec<GridState> {
    let scenario = Scenario::from_document(Document::new("energy.toml", Path::new("."), text)).unwrap();
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    let mut states = vec![motion.state().clone()];
    while !motion.is_done() {
        motion.advance().unwrap();
        states.push(motion.state().clone());
    }
    states
}

#[test]
fn what_is_stored_and_dissipated_makes_up_the_work_in_every_step() {
    let zener = "kernel = { form = \"maxwell\", order = 0.7, time = 0.4 }";
    let prony = "kernel = { form = \"prony\", strengths = [3.0, 0.4], times = [0.05, 7.0] }";
    let jumping = "kernel = { form = \"havriliak-negami\", order = 0.8, power = 0.6, time = 0.3 }\n\
                   derivative = \"riemann-liouville\"";
    let rho = "[[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]";
    let springpot = ("order = 0.35", "[0.5, 0.0, 0.2]");
    let dashpot = ("order = 1.0", "[0.0, 0.3, 0.0]");
    let engines = ["exponential-sum", "direct", "block-fft"];
    for (convolution, engine) in
        ["order = 1", "order = 2", "symbol = \"trapezoidal\""].into_iter().zip(engines)
    {
        let kernels = [(zener, rho), (prony, "[1.0, 0.3, 2.0]"), (jumping, rho), springpot, dashpot];
        let engine = format!("[history]\nengine = \"{engine}\"\n");
        let states = moved(&material(&kernels, convolution, &engine));
        let total = |index: usize| {
            let state = &states[index];
            state.energy + state.columns[0] + state.columns[1]
        };
        let (mut most, mut turned) = (0.0_f64, 0.0_f64);
        for k in 0..states.len() - 1 {
            let push = 0.4 * (1.3 * 0.02 * (k as f64 + 0.5)).cos();
            let work = push * (states[k + 1].position[2] - states[k].position[2]);
            let error = (total(k + 1) - total(k) - work).abs();
            turned += (states[k + 1].energy - states[k].energy).abs();
            most = max_or_nan(most, error);
            let lost = states[k + 1].columns[1] - states[k].columns[1];
            assert!(lost >= 0.0 && states[k].columns[0] >= 0.0, "{convolution}, {k}: {lost:e}");
        }
        let dissipated = states.last().unwrap().columns[1];
        assert!(dissipated > 1.0 && turned > dissipated, "{convolution}: {dissipated}");
        // Relative to the energy that there is; a step turns over some 10⁻³ of it.
        assert!(most < 1e-13 * total(0), "{convolution}: {most:e} of {}", total(0));
    }
}

#[test]
fn energies_of_memories_are_refused_where_nothing_balances() {
    let refusal = |kernel: &str, convolution: &str, rest: &str| {
        let text = material(&[(kernel, "[1.0, 1.0, 1.0]")], convolution, rest);
        // Momenta of a jump alternate by the trapezoidal rule, which is refused before.
        let text = text.replace("memory_energy = true", "memory_energy = true\nmomentum = \"one-sided\"");
        let document = Document::new("energy.toml", Path::new("."), &text);
        match Scenario::from_document(document) {
            Ok(scenario) => {
                fvi_simulation::simulation::motion::Motion::start(&scenario, Precision::F64).err()
            }
            Err(error) => Some(error),
        }
        .map(|error| error.to_string())
    };
    let maxwell = "kernel = { form = \"maxwell\", order = 0.7, time = 0.4 }";
    assert_eq!(refusal(maxwell, "order = 2", ""), None);
    let gauss = "[scheme]\nkind = \"galerkin\"\ndegree = 2\n";
    let mut spring = vec![0.0; 601];
    spring[0] = 1.0;
    let weights = format!("kernel = {{ weights = {spring:?} }}");
    for (kernel, convolution, rest, reason) in [
        ("order = 1.5", "order = 2", "", "grows faster than s"),
        (weights.as_str(), "order = 2", "", "they have no states"),
        (
            "kernel = { symbol = \"0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)\" }",
            "order = 2",
            "",
            "on the negative real axis",
        ),
        (maxwell, "order = 3", "[scheme]\nkind = \"low-order\"\nkappa = 0.5\n", "without an exact balance"),
        (maxwell, "order = 2", gauss, "without an exact balance"),
        ("order = 0.5\nderivative = \"riemann-liouville\"", "symbol = \"trapezoidal\"", "", "the jump"),
    ] {
        let message = refusal(kernel, convolution, rest).unwrap();
        assert!(message.contains("output.memory_energy") && message.contains(reason), "{kernel}: {message}");
    }
}

/// A matrix of relaxation functions Σ_k a_k a_kᵀ e^{−t/τ_k} of two coordinates, in files, and the keys that
/// name them.
fn cummins(couplings: &[([f64; 2], f64)], spoil: impl Fn(usize, usize, f64) -> f64, rest: &str) -> Document {
    let mut text =
        "[system]\nmass = [1.0, 2.0]\nstiffness = [[5.0, -1.0], [-1.0, 3.0]]\n[[system.damping]]\n"
            .to_owned();
    text +=
        "kernel = { relaxation = [[\"G00.csv\", \"G01.csv\"], [\"G10.csv\", \"G11.csv\"]], decay = 1.0 }\n";
    text += rest;
    text += "\n[initial]\nposition = [1.0, -0.5]\nvelocity = [0.0, 0.4]\n[convolution]\norder = 2\n[time]\nstep = 0.02\nsteps = 400\n";
    let mut document = Document::new("cummins.toml", Path::new("."), &text);
    for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let rows = (0..=600).map(|k| {
            let t = 1e-2 * f64::from(k);
            let relaxation: f64 = couplings.iter().map(|(a, time)| a[i] * a[j] * (-t / time).exp()).sum();
            format!("{t},{}\n", spoil(i, j, relaxation))
        });
        let rows: String = rows.collect();
        document = document.with_attached(&format!("G{i}{j}.csv"), format!("t,G\n{rows}"));
    }
    document
}

#[test]
fn a_matrix_of_relaxation_functions_moves_as_its_prony_series() {
    let couplings = [([1.0, 0.5], 1.0), ([-0.3, 0.8], 0.2)];
    let scenario = Scenario::from_document(cummins(&couplings, |_, _, g| g, "")).unwrap();
    let term = |([x, y], time): &([f64; 2], f64)| {
        format!(
            "[[system.damping]]\ncoefficient = [[{}, {}], [{}, {}]]\nkernel = {{ form = \"prony\", strengths = [1.0], \
             times = [{time}] }}\n",
            x * x,
            x * y,
            x * y,
            y * y
        )
    };
    let series: String = couplings.iter().map(term).collect();
    let known = states(
        &format!(
            "[system]\nmass = [1.0, 2.0]\nstiffness = [[5.0, -1.0], [-1.0, 3.0]]\n{series}[initial]\nposition = [1.0, -0.5]\n\
             velocity = [0.0, 0.4]\n[convolution]\norder = 2\n[time]\nstep = 0.02\nsteps = 400\n"
        ),
        None,
    );
    for engine in [Engine::Direct, Engine::BlockFft, Engine::RealTime] {
        let mut scenario = scenario.clone();
        scenario.history.choose(engine);
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        for known in &known[1..] {
            motion.advance().unwrap();
            for (found, known) in motion.state().position.iter().zip(&known.position) {
                // The rows are linear in between.
                assert!(
                    (found - known).abs() < 1e-4,
                    "{engine:?}, t = {}: {found} {known}",
                    motion.state().time
                );
            }
        }
    }
    // The record of the scenario is the scenario.
    let value = serde_json::to_value(&scenario).unwrap();
    let terms = value["system"]["damping"].as_array().unwrap();
    assert_eq!(terms.len(), 1);
    assert!(terms[0]["kernel"]["relaxation"][1][0].as_str().unwrap().ends_with("G10.csv"));
}

#[test]
fn matrices_that_drive_or_are_not_symmetric_are_refused() {
    let couplings = [([1.0, 0.5], 1.0), ([-0.3, 0.8], 0.2)];
    let refusal = |spoil: &dyn Fn(usize, usize, f64) -> f64, rest: &str| {
        let document = cummins(&couplings, spoil, rest);
        Scenario::from_document(document).err().map(|error| format!("{error:?}"))
    };
    // Every entry by itself is passive, or may push.
    let strong = |i: usize, j: usize, g: f64| if i == j { g } else { 4.0 * g };
    let message = refusal(&strong, "").unwrap();
    assert!(message.contains("smallest eigenvalue of this matrix drives the motion at ω"), "{message}");
    assert_eq!(refusal(&strong, "allow_active = true"), None);
    let message = refusal(&|i, j, g| if (i, j) == (1, 0) { 1.1 * g } else { g }, "").unwrap();
    assert!(message.contains("the numbers of entry [0][1]"), "{message}");
    let message = refusal(&|_, _, g| g, "coefficient = [1.0, 1.0]").unwrap();
    assert!(message.contains("a kernel that is a matrix of forces over velocities"), "{message}");
}
