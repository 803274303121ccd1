//! Tables and memories of kernels that are expressions in s.

use fvi_core::{BdfOrder, Memory as _, RateTable, RungeKutta, Stateful as _};
use fvi_fft::exponentials::complex_exponential_table::complex_exponentials;
use fvi_fft::exponentials::exponential_table::ExponentialKernelError;
use fvi_fft::exponentials::rate_table::{RateTableError, rate_table_of};
use fvi_fft::memory::{Engine, History, MemoryRequest, States};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::quadrature::multistep_weights::multistep_weights;
use fvi_fft::quadrature::runge_kutta_weights::RungeKuttaWeights;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::given_weights::GivenWeights;
use fvi_fft::transfer::multistep_rule::MultistepRule;
use fvi_fft::transfer::relaxation::Relaxation;
use fvi_fft::{Aligned, ComplexExponentials};
use fvi_scenario::scenario::kernel_of_symbol;
use nalgebra::Complex;
use std::sync::Arc;

fn radau() -> RungeKutta<3> {
    RungeKutta::radau_iia().unwrap()
}

/// Σ c/(s + λ) s^d
fn value(table: &RateTable<Aligned<f64>>, s: Complex<f64>) -> Complex<f64> {
    let relaxations = table.rates.as_ref().iter().zip(table.coefficients.as_ref());
    let sum: Complex<f64> = relaxations.map(|(rate, c)| (s + rate).inv() * *c).sum();
    sum * s.powi(table.exponent.ceil() as i32)
}

#[test]
fn every_form_has_a_table_over_seventeen_decades() {
    let symbol = |text: &str| kernel_of_symbol(text);
    for (transfer, most) in [
        (TransferFunction::tempered(0.5, 0.3).unwrap(), 300),
        (TransferFunction::tempered(0.95, 3.0).unwrap(), 300),
        (TransferFunction::tempered(1.5, 2.0).unwrap(), 300),
        (TransferFunction::tempered(1.95, 2e-3).unwrap(), 300),
        (TransferFunction::maxwell(0.05, 0.0, 1.5).unwrap(), 200),
        (TransferFunction::maxwell(0.999, 0.0, 1e-3).unwrap(), 300),
        (TransferFunction::maxwell(1.0, 0.3, 0.5).unwrap(), 300),
        (TransferFunction::maxwell(0.5, 0.48, 0.5).unwrap(), 200),
        (TransferFunction::prony(&[1.0, 0.7, -0.1], &[1.0, 0.1, 1e-9]).unwrap(), 4),
        (TransferFunction::havriliak_negami(0.1, 0.1, 1.0).unwrap(), 200),
        (TransferFunction::havriliak_negami(0.95, 0.5, 1.0).unwrap(), 300),
        (TransferFunction::havriliak_negami(1.0, 0.95, 2.0).unwrap(), 300),
        (symbol("0.5 + 1.5*s^0.6/(1 + s^0.6)").unwrap(), 300),
        (symbol("s + s^0.5").unwrap(), 300),
        (symbol("s^1.5/(1 + s^0.3)").unwrap(), 300),
        (symbol("1/(1 + s^0.5)").unwrap(), 300),
        (symbol("s^0.3 - s^0.6").unwrap(), 300),
        (symbol("s/(1 + s)").unwrap(), 4),
        (symbol("0.3*s + s/(1 + s) - 0.2*s/(s^2 + 3*s + 2)").unwrap(), 4),
    ] {
        let table = rate_table_of::<f64, 3>(&radau(), &transfer, 1e-9, 1e8, 1e-12).unwrap_or_else(|error| {
            panic!("{transfer}: {error}");
        });
        let count = table.rates.as_ref().len();
        assert!(count <= most && table.leading.as_ref().is_empty(), "{transfer}: {count} rates");
        for decade in -5..=8 {
            // Off the axis, with the compressed rates.
            let s = Complex::from_polar(10f64.powi(decade), 1.2);
            let (found, known) = (value(&table, s), transfer.value(s));
            let error = (found - known).norm() / (known.norm() + transfer.spring());
            assert!(error < 2e-12, "{transfer}, s = {s:e}: {error:e}");
        }
    }
}

#[test]
fn kernels_that_are_no_relaxations_are_refused() {
    let symbol = |text: &str| kernel_of_symbol(text).unwrap();
    for transfer in [
        symbol("0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)"),
        symbol("sqrt(s)*tanh(sqrt(s))"),
        symbol("s^1.3 + s^0.5"),
        symbol("s^2/(1 + s)^2"),
    ] {
        let refused = rate_table_of::<f64, 3>(&radau(), &transfer, 1e-3, 1.0, 1e-12);
        assert!(matches!(refused, Err(RateTableError::ToleranceMissed { .. })), "{transfer}");
    }
}

const WAVES: &str = "0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)";

fn bdf(order: usize) -> MultistepRule {
    MultistepRule::Bdf(BdfOrder::new(order).unwrap())
}

/// Largest difference from weights that are computed another way, relative to the largest of them.
fn error(table: &ComplexExponentials, weights: &[f64]) -> f64 {
    let largest = weights.iter().fold(0.0_f64, |largest, weight| max_or_nan(largest, weight.abs()));
    let found = table.head.iter().copied().chain(table.tail());
    found.zip(weights).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan) / largest
}

#[test]
fn a_resonator_is_as_many_pairs_as_its_pole_has_places() {
    // (s + 0.1)² + 4 = 0 at γ(z) = h(−0.1 ± 2i), of which BDF 2 has two solutions for each sign and BDF 1
    // one: pairs ρ = 1/z.
    let (transfer, step) = (kernel_of_symbol(WAVES).unwrap(), 0.05);
    let (table, miss) = complex_exponentials(&transfer, bdf(1), false, step, 1000, 1e-11).unwrap();
    let known = Complex::new(1.0 + 0.1 * step, 2.0 * step).inv();
    let slowest = table.pairs[0];
    assert!((Complex::new(slowest[0], slowest[1].abs()) - known.conj()).norm() < 1e-11, "{slowest:?}");
    assert!(miss.largest < 1e-12 && miss.sum < 1e-11, "{miss:?}");
    for order in [1, 2, 3] {
        let (table, _) = complex_exponentials(&transfer, bdf(order), false, step, 1000, 1e-10).unwrap();
        assert!(table.pairs.len() <= order + 1, "BDF {order}: {} pairs", table.pairs.len());
        let weights = multistep_weights(&transfer, bdf(order), step, false, 1001).unwrap();
        assert!(error(&table, &weights) < 1e-10);
    }
}

#[test]
fn every_weight_of_kernels_without_a_cut_is_within_the_tolerance() {
    // Two waves; one that does not decay; one that acts on increments; the impedance of a rod, with poles
    // without end; a delay, whose weights end.
    let triangle = Relaxation::new("G", &[(0.0, 1.0), (2.0, 0.0)], None);
    let symbol = |text: &str| kernel_of_symbol(text).unwrap();
    for (transfer, on_increments) in [
        (symbol("s*(s + 0.05)/((s + 0.05)^2 + 1) + 0.3*s*(s + 0.3)/((s + 0.3)^2 + 25)"), false),
        (symbol("s^2/(s^2 + 4)"), false),
        (symbol("0.2*s + s*(s + 0.1)/((s + 0.1)^2 + 4)"), true),
        (symbol("s*tanh(s + 0.05)"), true),
        (TransferFunction::formula(Arc::new(triangle)).unwrap(), false),
    ] {
        // Rods and delays have no last pole, and with the trapezoidal rule their weights do not fall off.
        let is_rational = transfer.text().is_some_and(|text| text.contains("^2"));
        let rules = [bdf(1), bdf(2), MultistepRule::Trapezoidal];
        for rule in rules.into_iter().take(if is_rational { 3 } else { 2 }) {
            for tolerance in [1e-6, 1e-9] {
                let made = complex_exponentials(&transfer, rule, on_increments, 0.05, 3000, tolerance);
                let at = format!("{transfer}, {rule}, {tolerance}");
                let (table, miss) = made.unwrap_or_else(|error| panic!("{at}: {error}"));
                let weights = multistep_weights(&transfer, rule, 0.05, on_increments, 3001).unwrap();
                let error = error(&table, &weights);
                assert!(error <= tolerance && miss.sum <= tolerance, "{at}: {error:e} {miss:?}");
                // Of tables in closed form a bound is known, which the rounding of other weights may exceed.
                let is_closed = is_rational && rule != MultistepRule::Trapezoidal;
                let is_bounded = is_closed && error <= miss.largest + 1e-12;
                assert!(error == miss.largest || is_bounded, "{at}: {error:e} {miss:?}");
            }
        }
    }
}

#[test]
fn a_bound_that_is_not_met_is_refused_with_what_was_reached() {
    let transfer = kernel_of_symbol("s^0.5 + s/(s^2 + 1)").unwrap();
    let refused = complex_exponentials(&transfer, bdf(2), true, 0.01, 4000, 1e-13).unwrap_err();
    let ExponentialKernelError::ToleranceMissed { tolerance, reached } = refused else {
        panic!("{refused:?}")
    };
    assert!(tolerance == 1e-13 && reached > 1e-13 && reached < 1e-2, "{reached:e}");
    let waves = kernel_of_symbol(WAVES).unwrap();
    assert!(complex_exponentials(&waves, bdf(2), false, 0.01, 4000, 1.0).is_err());
    assert!(complex_exponentials(&waves, bdf(2), false, 0.0, 4000, 1e-6).is_err());
    assert!(complex_exponentials(&waves, bdf(2), false, 0.01, 0, 1e-6).is_err());
}

fn request<'a>(transfer: &'a TransferFunction, history: &'a History) -> MemoryRequest<'a> {
    MemoryRequest {
        family: ConvolutionFamily::Bdf { order: 1 },
        starting: &[],
        transfer,
        step_size: 0.25,
        end: None,
        coordinates: 2,
        motions: 1,
        samples: 6,
        given: false,
        history,
    }
}

/// A wave s (s + 0.1)/((s + 0.1)² + 4) beside a damper.
fn waves() -> TransferFunction {
    kernel_of_symbol("0.2*s + s*(s + 0.1)/((s + 0.1)^2 + 4)").unwrap()
}

#[test]
fn kernels_that_oscillate_have_exponentials_in_pairs_within_the_tolerance() {
    let transfer = waves();
    let bdf = |order| ConvolutionFamily::Bdf { order };
    for family in [bdf(1), bdf(2), ConvolutionFamily::Trapezoidal] {
        let terms = |engine, tolerance| {
            let history = History { engine: Some(engine), tolerance, ..History::default() };
            let request =
                MemoryRequest { samples: 1500, family, step_size: 0.05, ..request(&transfer, &history) };
            let mut memory = request.build::<f64>().unwrap();
            assert_eq!(memory.engine(), engine);
            let mut terms = Vec::new();
            for k in 0..1500u16 {
                let mut term = [f64::NAN; 2];
                memory.next_term(&mut term).unwrap();
                terms.push(term);
                memory.push(&[(0.1 * f64::from(k)).sin(), 1.0]).unwrap();
            }
            (terms, memory.bytes(), memory.state_bytes())
        };
        let (exact, ..) = terms(Engine::Direct, None);
        let (found, bytes, state) = terms(Engine::ExponentialSum, Some(1e-9));
        // |r − r̃| ≤ ε Σ|w| |x|.
        let rule = family.multistep().unwrap().unwrap();
        // The second weight is that which a damping term looks at.
        assert_eq!(found[1], exact[1], "{rule}");
        let sum: f64 =
            multistep_weights(&transfer, rule, 0.05, true, 1500).unwrap().iter().map(|w| w.abs()).sum();
        let error = exact.iter().zip(&found).flat_map(|(a, b)| [a[0] - b[0], a[1] - b[1]]);
        let error = error.fold(0.0_f64, |most, error| max_or_nan(most, error.abs()));
        assert!(error <= 1e-9 * sum, "{rule}: {error:e} {sum}");
        assert!(bytes < 4000 && state < 2000, "{rule}: {bytes} {state}");
    }
}

#[test]
fn pairs_are_refused_where_there_are_none() {
    let transfer = waves();
    let refused = |history: &History, samples| {
        let step_size = 0.01;
        let request = MemoryRequest { samples, step_size, ..request(&transfer, history) };
        request.build::<f64>().err().map(|error| error.to_string())
    };
    let pairs = History { engine: Some(Engine::ExponentialSum), tolerance: Some(1e-9), ..History::default() };
    assert_eq!(refused(&pairs, 1500), None);
    // No engine, no tolerance, no room for single precision, and the memory of firmware.
    assert_eq!(refused(&History::default(), 1500), None);
    for history in [
        History { tolerance: None, ..pairs },
        History { tolerance: Some(1e-6), states: Some(States::F32), ..pairs },
        History { engine: Some(Engine::ExponentialSumCore), ..pairs },
    ] {
        let message = refused(&history, 1500).unwrap_or_else(|| panic!("{history:?}"));
        assert!(message.contains("no table") && message.contains("\"block-fft\""), "{message}");
    }
    let short = History { horizon: Some(1000), planned: Some(900), ..pairs };
    assert!(refused(&short, 1500).unwrap().contains("history.horizon"));
}

#[test]
fn weights_of_a_resonator_that_outlasts_their_table_are_passive() {
    let transfer = kernel_of_symbol("s^2/(s^2 + 0.02*s + 4)").unwrap();
    let weights = multistep_weights(&transfer, bdf(2), 0.1, false, 300).unwrap();
    let made = GivenWeights::new("w.csv", weights).unwrap().at_step(0.1).unwrap();
    assert_eq!(made.active(), None);
}

/// ∫₀¹ f(β) dβ by Gauss and Legendre's rule with 5 points on each of 8 pieces.
fn integral<T: std::iter::Sum<T> + std::ops::Mul<f64, Output = T>>(f: impl Fn(f64) -> T) -> T {
    let (near, far) = (0.538_469_310_105_683_1, 0.906_179_845_938_664);
    let rule = [
        (0.0, 128.0 / 225.0),
        (near, 0.478_628_670_499_366_47),
        (-near, 0.478_628_670_499_366_47),
        (far, 0.236_926_885_056_189_08),
        (-far, 0.236_926_885_056_189_08),
    ];
    let points = (0..8).flat_map(|piece| rule.map(|(place, weight)| (f64::from(piece), place, weight)));
    points.map(|(piece, place, weight)| f((piece + 0.5 + 0.5 * place) / 8.0) * (weight / 16.0)).sum()
}

#[test]
fn distributed_order_is_the_integral_of_powers_also_where_its_logarithm_vanishes() {
    let transfer = kernel_of_symbol("(s - 1)/log(s)").unwrap();
    assert_eq!((transfer.active(), transfer.spring()), (None, 0.0));
    let places = [0.0, 1e-16, 1e-14, -1e-12, 1e-9, 1e-5, 0.3, 7.0, -0.999];
    for s in places.into_iter().flat_map(|beside| [0.0, 1e-13, 0.4].map(|im| Complex::new(1.0 + beside, im)))
    {
        let known = integral(|order| (s.ln() * order).exp());
        let error = (transfer.value(s) - known).norm() / known.norm();
        assert!(error < 1e-11, "{s}: {error:e}");
    }
    // The relaxation function ∫ t^{−β}/Γ(1 − β) dβ.
    for time in [0.05, 1.0, 20.0] {
        let known = integral(|order: f64| libm::pow(time, -order) / libm::tgamma(1.0 - order));
        let found = fvi_fft::transfer::laplace::relaxation(&transfer, time).unwrap();
        assert!((found / known - 1.0).abs() < 1e-9, "{time}: {found} {known}");
    }
}

#[test]
fn weights_of_every_symbol_are_the_series_of_its_value() {
    type Known = fn(Complex<f64>) -> Complex<f64>;
    let cases: [(&str, Known); 7] = [
        ("exp(-s)", |s| (-s).exp()),
        ("s*exp(-s)", |s| s * (-s).exp()),
        ("exp(-sqrt(s))", |s| (-s.sqrt()).exp()),
        ("s^0.5*exp(-0.1*s^0.5)", |s| s.sqrt() * (s.sqrt() * -0.1).exp()),
        ("s^0.5/tanh(s^0.5)", |s| s.sqrt() / s.sqrt().tanh()),
        ("(s - 1)/log(s)", |s| integral(|order| (s.ln() * order).exp())),
        ("(s - 1)/(sqrt(s) - 1)", |s| s.sqrt() + 1.0),
    ];
    // With h = 1 and 1.5 the first coefficient of γ(z)/h is 1, where s − 1 and ln s vanish.
    for ((text, known), step) in
        cases.into_iter().flat_map(|case| [0.02, 0.4, 1.0, 1.5].map(|step| (case, step)))
    {
        let transfer = kernel_of_symbol(text).unwrap_or_else(|error| panic!("{text}: {error:?}"));
        for rule in [bdf(1), bdf(2), MultistepRule::Trapezoidal] {
            let weights = multistep_weights(&transfer, rule, step, false, 900).unwrap();
            for z in [Complex::new(0.9, 0.0), Complex::new(-0.7, 0.3), Complex::new(0.1, 0.93)] {
                let series: Complex<f64> =
                    weights.iter().rev().fold(Complex::ZERO, |sum, &weight| sum * z + weight);
                let value = known(rule.symbol(z) / step) - transfer.spring();
                let error = (series - value).norm() / (1.0 + value.norm() + weights[0].abs());
                assert!(error < 1e-10, "{text}, h = {step}, {rule}, {z}: {error:e}");
            }
        }
    }
}

#[test]
fn a_slow_diffusion_has_hardly_any_weights_before_it_arrives() {
    // Beside the spring w_n ≈ h f(nh), f = e^{−1/(4t)}/(2 √π t^{3/2}), whose largest value is at t = 1/6.
    let (diffusion, step) = (kernel_of_symbol("exp(-sqrt(s))").unwrap(), 1e-6);
    let first = multistep_weights(&diffusion, bdf(1), step, false, 40).unwrap();
    assert!(
        first[0] == -diffusion.spring() && first[1..].iter().all(|weight| weight.abs() < 1e-30),
        "{first:?}"
    );
    let weights = multistep_weights(&diffusion, bdf(1), step, false, 20_000).unwrap();
    let time = 19_999.0 * step;
    let density = (-0.25 / time).exp() / (2.0 * std::f64::consts::PI.sqrt() * time.powf(1.5));
    assert!((weights[19_999] / (step * density) - 1.0).abs() < 2e-2, "{} {density}", weights[19_999]);
}

/// K(D) u at t = `steps`·h by the last stage of Radau IIA with 3 stages.
fn by_radau(transfer: &TransferFunction, step: f64, steps: usize, u: impl Fn(f64) -> f64) -> f64 {
    let method = radau();
    let weights = RungeKuttaWeights::of_transfer(&method, transfer, false, step, steps).unwrap();
    let planes = weights.planes();
    let nodes: Vec<f64> = method.matrix().iter().map(|row| row.iter().sum()).collect();
    let entry = |n: usize, j: usize| planes[(6 + j) * steps + n];
    let sum = (0..steps).flat_map(|k| (0..3).map(move |j| (k, j)));
    sum.map(|(k, j)| entry(steps - 1 - k, j) * u(step * (k as f64 + nodes[j]))).sum::<f64>()
        + transfer.spring() * u(step * steps as f64)
}

#[test]
fn runge_kutta_families_take_every_kernel_that_is_analytic_in_the_right_half_plane() {
    // u = t⁵ at t = 3: derivatives Γ(6) t^{5−β}/Γ(6 − β), a dead time (t − 1)⁵, and with e^{−√s} the
    // inverse of 120 e^{−√s}/s⁶ (mpmath, Talbot's contour, 30 digits).
    let u = |time: f64| libm::pow(time, 5.0);
    let diffusion = 61.924_596_165_742_37;
    let orders = integral(|order: f64| 120.0 * libm::pow(3.0, 5.0 - order) / libm::tgamma(6.0 - order));
    for (text, known, tolerance) in [
        ("exp(-s)", 32.0, 1e-6),
        ("s*exp(-s)", 80.0, 1e-6),
        ("(s - 1)/log(s)", orders, 1e-8),
        ("exp(-sqrt(s))", diffusion, 1e-10),
    ] {
        let transfer = kernel_of_symbol(text).unwrap();
        let found = by_radau(&transfer, 0.01, 300, u);
        assert!((found / known - 1.0).abs() < tolerance, "{text}: {found} {known}");
    }
    // A pole in the right half-plane is refused.
    let growing = kernel_of_symbol("s^0.5 + 1/((s - 1)^2 + 1)").unwrap();
    let refused = RungeKuttaWeights::<3>::of_transfer(&radau(), &growing, false, 0.1, 100).unwrap_err();
    assert!(refused.allowed.contains("analytic for Re s > 0"), "{refused}");
    assert!(multistep_weights(&growing, bdf(2), 0.1, false, 100).is_err());
}

#[test]
fn delays_are_refused_where_backward_differentiation_amplifies_them() {
    let delay = kernel_of_symbol("exp(-s)").unwrap();
    assert_eq!((delay.spring(), delay.growth(), delay.unrelaxed()), (1.0, 0.0, Some(0.0)));
    assert!(delay.active().is_some());
    for order in 1..=2 {
        let weights = multistep_weights(&delay, bdf(order), 1e-3, false, 3000).unwrap();
        // Σ w_n is K(0) − K(0).
        assert!(weights.iter().sum::<f64>().abs() < 1e-11, "{order}");
    }
    let refused = multistep_weights(&delay, bdf(3), 1e-3, false, 3000).map(|_| ()).unwrap_err();
    assert!(refused.allowed.contains("order 1 or 2"), "{refused}");
}

#[test]
fn symbols_that_lose_their_digits_are_refused_with_the_reason() {
    for (text, reason) in [
        ("(sqrt(1 + s) - 1)/s", "terms do not cancel"),
        ("1/(s - 1)", "divides by 0"),
        ("s^3*exp(-s)", "grows more slowly than s²"),
    ] {
        let error = kernel_of_symbol(text).unwrap_err();
        let help = miette::Diagnostic::help(&error).map(|help| help.to_string()).unwrap_or_default();
        assert!(help.contains(reason), "{text}: {help}");
    }
    assert!(kernel_of_symbol("s^0.5*tanh(s^0.5)").is_ok() && kernel_of_symbol("1/(sqrt(1 + s) + 1)").is_ok());
    // A quotient of numbers beyond all range is one of numbers within it.
    let [quotient, tangent] =
        ["s^0.5*sinh(s^0.5)/cosh(s^0.5)", "s^0.5*tanh(s^0.5)"].map(|text| kernel_of_symbol(text).unwrap());
    for s in [0.3, 20.0, 1e5, 1e7, 1e20] {
        let [one, other] = [&quotient, &tangent].map(|kernel| kernel.value(Complex::new(s, 0.7 * s)));
        assert!((one - other).norm() < 1e-12 * other.norm(), "{s}: {one} {other}");
    }
}
