//! Every rival gives the sum that it stands for, within its tolerance, and keeps the contract of a memory.

use fvi_core::{BdfOrder, ConvolutionWeights, Memory, MemoryError};
use fvi_fft::baseline::{Signal, memory_term};
use fvi_fft::sums::max_or_nan;
use fvi_rivals::{
    ObliviousQuadrature, PlainSum, RelaxedProduct, TextbookHls, jiang, kernel_compression, l1_weights,
    matsuda, non_uniform_partition, oustaloup, short_memory, uniform_partition, vectorised,
};
use nalgebra::Complex;

const UNIT: f64 = f64::EPSILON / 2.0;

type Boxed = Box<dyn Memory<f64> + Send>;
type Symbol = fn(Complex<f64>) -> Complex<f64>;

/// Weights of s^β at step 1.
fn quadrature(order: usize, exponent: f64, count: usize) -> Vec<f64> {
    let order = BdfOrder::new(order).unwrap();
    ConvolutionWeights::bdf(order, exponent, 1.0).unwrap().take(count).collect()
}

/// Weights of no pattern but a slow decay.
fn arbitrary(count: usize) -> Vec<f64> {
    (0..count).map(|n| (0.7 * (n * n) as f64).cos() / (1.0 + n as f64).powf(0.8)).collect()
}

fn run(memory: &mut dyn Memory<f64>, samples: &[f64]) -> Vec<f64> {
    let channels = memory.channels();
    let mut terms = vec![f64::NAN; samples.len()];
    for (sample, term) in samples.chunks(channels).zip(terms.chunks_mut(channels)) {
        memory.next_term(term).unwrap();
        memory.push(sample).unwrap();
    }
    terms
}

/// Largest error of a signal over what `scale` makes of (Σ|w||x|, ‖w‖₂‖x‖₂).
fn largest_error(
    memory: &mut dyn Memory<f64>,
    weights: &[f64],
    signal: Signal,
    steps: usize,
    scale: impl Fn(f64, f64) -> f64,
) -> f64 {
    let channels = memory.channels();
    let samples = signal.samples::<f64>(channels, steps);
    memory.clear();
    let terms = run(memory, &samples);
    let norm =
        |numbers: &mut dyn Iterator<Item = f64>| numbers.map(|number| number * number).sum::<f64>().sqrt();
    let mut largest = 0.0_f64;
    for k in (1..steps).filter(|k| k % 37 == 5 || *k + 1 == steps || *k < 70 || k.is_power_of_two()) {
        let exact = memory_term(weights, 1, &samples, channels, k);
        for (channel, exact) in exact.iter().enumerate() {
            let of_samples = norm(&mut samples.iter().skip(channel).step_by(channels).take(k).copied());
            let norms = norm(&mut weights[1..=k].iter().copied()) * of_samples;
            let error = (terms[k * channels + channel] - exact.sum).abs() / scale(exact.absolute, norms);
            assert!(error.is_finite(), "{k}");
            largest = max_or_nan(largest, error);
        }
    }
    largest
}

fn of_terms(absolute: f64, _: f64) -> f64 {
    UNIT * absolute
}

/// Exact rivals, by how errors are measured: of each term, or of the norms as transforms have them.
fn exact_rivals(weights: &[f64], channels: usize, steps: usize) -> Vec<(&'static str, bool, Boxed)> {
    let plain = PlainSum::new(weights, channels, steps).unwrap();
    let uniform = uniform_partition(weights, channels, steps).unwrap();
    let partition = non_uniform_partition(weights, channels, steps).unwrap();
    let relaxed = RelaxedProduct::new(weights, channels, steps).unwrap();
    let hls = TextbookHls::new(weights, channels, steps).unwrap();
    vec![
        ("plain", true, vectorised(plain)),
        ("uniform", true, vectorised(uniform)),
        ("non-uniform", true, vectorised(partition)),
        ("relaxed", false, vectorised(relaxed)),
        ("hls", false, Box::new(hls)),
    ]
}

#[test]
fn exact_rivals_give_the_plain_sum_at_any_length() {
    for steps in [1, 2, 31, 32, 33, 63, 64, 65, 255, 256, 257, 700, 2049, 5000] {
        for (kernel, weights) in
            [quadrature(1, 0.5, steps), quadrature(2, 1.5, steps), arbitrary(steps)].iter().enumerate()
        {
            for channels in [1, 3] {
                if channels == 3 && steps > 700 {
                    continue;
                }
                for (name, of_each_term, mut memory) in exact_rivals(weights, channels, steps) {
                    for signal in [Signal::Stationary, Signal::Constant, Signal::Growing] {
                        let error = if of_each_term {
                            largest_error(&mut *memory, weights, signal, steps, of_terms)
                        } else {
                            largest_error(&mut *memory, weights, signal, steps, |_, norms| UNIT * norms)
                        };
                        assert!(error <= 40.0, "{name}, {steps}, kernel {kernel}, {signal:?}: {error} u");
                    }
                }
            }
        }
    }
}

#[test]
fn partitions_lose_no_digits_of_decaying_signals_where_the_textbook_does() {
    let steps = 4096;
    let weights = quadrature(1, 0.5, steps);
    let mut errors = Vec::new();
    for (name, of_each_term, mut memory) in exact_rivals(&weights, 1, steps) {
        let error = largest_error(&mut *memory, &weights, Signal::Decaying, steps, of_terms);
        assert_eq!(error <= 40.0, of_each_term, "{name}: {error} u");
        errors.push(error);
    }
    assert!(errors[4] > 1000.0, "{errors:?}");
}

#[test]
fn a_wrong_weight_is_seen() {
    let weights = quadrature(1, 0.5, 500);
    let mut wrong = weights.clone();
    wrong[400] *= 1.0 + 1e-9;
    let mut memory = non_uniform_partition(&wrong, 1, 500).unwrap();
    let error = largest_error(&mut memory, &weights, Signal::Growing, 500, of_terms);
    assert!(error < 40.0, "what is far back in a growing signal does not count: {error}");
    let error = largest_error(&mut memory, &weights, Signal::Decaying, 500, of_terms);
    assert!(error > 40.0, "{error}");
}

fn one_of_each(steps: usize) -> Vec<(&'static str, Boxed)> {
    let weights = quadrature(1, 0.5, steps);
    let order = BdfOrder::GRUNWALD_LETNIKOV;
    let symbol = |s: Complex<f64>| s.sqrt();
    let oblivious = ObliviousQuadrature::new(&symbol, &weights, 1.0, 2, steps, 1e-6).unwrap();
    let mut rivals: Vec<(&str, Boxed)> =
        exact_rivals(&weights, 2, steps).into_iter().map(|(name, _, memory)| (name, memory)).collect();
    rivals.push(("short memory", vectorised(short_memory(&weights, 2, steps, 0.1).unwrap())));
    rivals.push(("oblivious", vectorised(oblivious)));
    rivals.push(("oustaloup", vectorised(oustaloup(0.5, order, 1.0, 2, steps, 1e-3).unwrap())));
    rivals.push(("matsuda", vectorised(matsuda(0.5, order, 1.0, 2, steps, 1e-3).unwrap())));
    rivals.push(("jiang", vectorised(jiang(0.5, 1.0, 2, steps, 1e-6).unwrap())));
    rivals.push(("compression", vectorised(kernel_compression(0.5, 1.0, 2, steps, 1e-6).unwrap())));
    rivals
}

#[test]
fn every_rival_keeps_the_contract_of_a_memory() {
    let steps = 150;
    let samples = Signal::Stationary.samples::<f64>(2, steps);
    for (name, mut memory) in one_of_each(steps) {
        assert_eq!((memory.channels(), memory.stages(), memory.len()), (2, 1, 0), "{name}");
        let first = run(&mut *memory, &samples);
        let (mut two, mut three) = ([0.0; 2], [0.0; 3]);
        let full = Err(MemoryError::Full { capacity: steps });
        assert_eq!((memory.next_term(&mut two), memory.push(&two)), (full, full), "{name}");
        memory.clear();
        assert_eq!(memory.next_term(&mut two), Ok(()), "{name}");
        assert_eq!(two, [0.0; 2], "{name}: nothing has been pushed");
        let mismatch = Err(MemoryError::ChannelMismatch { expected: 2, found: 3 });
        let mut again = Vec::new();
        for sample in samples.chunks(2) {
            assert_eq!((memory.next_term(&mut three), memory.push(&three)), (mismatch, mismatch), "{name}");
            memory.next_term(&mut two).unwrap();
            memory.next_term(&mut two).unwrap();
            again.extend(two);
            memory.push(sample).unwrap();
        }
        let same = first.iter().zip(&again).all(|(a, b)| a.to_bits() == b.to_bits());
        assert!(same, "{name}: another run, or a term asked for twice, has other bits");
        // Terms need not be asked for.
        memory.clear();
        samples.chunks(2).take(100).for_each(|sample| memory.push(sample).unwrap());
        memory.next_term(&mut two).unwrap();
        assert!(two == first[200..202], "{name}: {two:?}, {:?}", &first[200..202]);
        assert!(memory.bytes() > 100, "{name}");
    }
}

#[test]
fn what_cannot_be_made_is_refused() {
    let order = BdfOrder::GRUNWALD_LETNIKOV;
    let weights = quadrature(1, 0.5, 10);
    assert!(PlainSum::new(&[], 1, 10).is_err() && PlainSum::new(&weights, 0, 10).is_err());
    assert!(uniform_partition(&weights, 1, 0).is_err());
    assert!(jiang(1.5, 1.0, 1, 10, 1e-6).is_err() && jiang(0.5, 1.0, 1, 10, 0.0).is_err());
    assert!(jiang(0.5, 1.0, 1, 10, 1e-30).is_err() && kernel_compression(0.5, -1.0, 1, 10, 1e-6).is_err());
    assert!(
        oustaloup(1.0, order, 1.0, 1, 10, 1e-3).is_err() && matsuda(0.5, order, 1.0, 1, 10, 2.0).is_err()
    );
    let oscillating = |s: Complex<f64>| s / (s * s + 0.1 * s + 4.0);
    let weights: Vec<f64> = (0..300).map(|n| (2.0 * f64::from(n)).cos()).collect();
    assert!(ObliviousQuadrature::new(&oscillating, &weights, 1.0, 1, 300, 1e-6).is_err());
}

#[test]
fn short_memory_leaves_out_no_more_than_it_says() {
    let steps = 3000;
    let weights = quadrature(1, 0.5, steps);
    let all: f64 = weights[1..].iter().map(|weight| weight.abs()).sum();
    for tolerance in [0.3, 0.1, 0.05] {
        let mut memory = short_memory(&weights, 1, steps, tolerance).unwrap();
        let window = memory.window();
        assert!(window < steps - 1, "{window}");
        let samples = Signal::Constant.samples::<f64>(1, steps);
        let terms = run(&mut memory, &samples);
        let mut largest = 0.0_f64;
        for (k, term) in terms.iter().enumerate() {
            let exact = memory_term(&weights, 1, &samples, 1, k)[0].sum;
            largest = max_or_nan(largest, (term - exact).abs());
        }
        let bound = tolerance * all * 0.1;
        assert!(largest <= bound && largest > 0.8 * bound, "{tolerance}: {largest:e}, {bound:e}");
    }
    // The window grows as the bound of the principle has it, L ~ ε^{−1/β}, while it is short beside the run.
    let weights = quadrature(1, 0.5, 1 << 18);
    let windows = [0.1, 0.05, 0.025].map(|tolerance| fvi_rivals::window_of(&weights, tolerance) as f64);
    for pair in windows.windows(2) {
        assert!((pair[1] / pair[0] / 4.0 - 1.0).abs() < 0.15, "{windows:?}");
    }
}

#[test]
fn fast_l1_formulas_keep_their_tolerance() {
    let steps = 3000;
    for order in [0.1, 0.5, 0.9] {
        let weights = l1_weights(order, 0.01, steps).unwrap();
        for tolerance in [1e-3, 1e-6, 1e-9] {
            let rivals: [(&str, _); 2] = [
                ("jiang", jiang(order, 0.01, 1, steps, tolerance).unwrap()),
                ("compression", kernel_compression(order, 0.01, 1, steps, tolerance).unwrap()),
            ];
            for (name, mut memory) in rivals {
                assert_eq!(memory.leading()[0], weights[0]);
                for signal in Signal::ALL {
                    let error = largest_error(&mut memory, &weights, signal, steps, |absolute, _| absolute);
                    assert!(error <= tolerance, "{name}, β = {order}, {tolerance:e}, {signal:?}: {error:e}");
                }
            }
        }
    }
}

#[test]
fn fast_l1_formulas_have_the_order_of_the_l1_formula() {
    // D^β t^{3+β} = Γ(4+β)/6 t³ at t = 1, of order 2 − β in h: the kind of solution that the paper of the
    // fast formula measures its order with.
    for order in [0.3, 0.5, 0.8] {
        let exact = libm::tgamma(4.0 + order) / 6.0;
        for name in ["plain", "jiang", "compression"] {
            let error = |steps: usize| {
                let step = 1.0 / steps as f64;
                let mut memory: Boxed = match name {
                    "plain" => {
                        let weights = l1_weights(order, step, steps).unwrap();
                        vectorised(PlainSum::new(&weights, 1, steps).unwrap())
                    }
                    "jiang" => vectorised(jiang(order, step, 1, steps, 1e-9).unwrap()),
                    _ => vectorised(kernel_compression(order, step, 1, steps, 1e-9).unwrap()),
                };
                let samples: Vec<f64> = (1..=steps).map(|k| (k as f64 * step).powf(3.0 + order)).collect();
                let terms = run(&mut *memory, &samples);
                (memory.leading()[0] * samples[steps - 1] + terms[steps - 1] - exact).abs()
            };
            let errors = [100, 200, 400].map(error);
            for pair in errors.windows(2) {
                let found = (pair[0] / pair[1]).log2();
                assert!((found - (2.0 - order)).abs() < 0.1, "{name}, β = {order}: {found}, {errors:?}");
            }
        }
    }
}

#[test]
fn oblivious_quadrature_keeps_its_tolerance() {
    let steps = 3000;
    let kernels: [(&str, Symbol); 2] =
        [("root", |s| s.sqrt()), ("Maxwell", |s| s.powf(0.6) / (Complex::new(1.0, 0.0) + s.powf(0.6)))];
    for (name, symbol) in kernels {
        // The weights of implicit Euler from a circle: far below what is asked for here.
        let step = 0.1;
        let weights = weights_on_a_circle(symbol, step, steps);
        for tolerance in [1e-3, 1e-5, 1e-7] {
            let mut memory = ObliviousQuadrature::new(&symbol, &weights, step, 1, steps, tolerance).unwrap();
            for signal in [Signal::Stationary, Signal::Decaying, Signal::Growing] {
                let error = largest_error(&mut memory, &weights, signal, steps, |absolute, _| absolute);
                assert!(error <= tolerance, "{name}, {tolerance:e}, {signal:?}: {error:e}");
            }
        }
    }
}

/// w_n = (1/M) Σ K((1 − r e^{iφ})/h) r^{−n} e^{−inφ} with rⁿ falling to 10⁻⁹ over the weights.
fn weights_on_a_circle(symbol: Symbol, step: f64, count: usize) -> Vec<f64> {
    let points = (2 * count).next_power_of_two();
    let radius = 1e-8f64.powf(1.0 / points as f64);
    let (_, inverse) = fvi_fft::real_transforms(points);
    let mut values: Vec<Complex<f64>> = (0..=points / 2)
        .map(|j| {
            let angle = std::f64::consts::TAU * j as f64 / points as f64;
            symbol((Complex::new(1.0, 0.0) - Complex::from_polar(radius, -angle)) / step).conj()
        })
        .map(|value| value.conj())
        .collect();
    values[0].im = 0.0;
    values[points / 2].im = 0.0;
    let mut weights = vec![0.0; points];
    inverse.process(&mut values, &mut weights).unwrap();
    (0..count).map(|n| weights[n] / points as f64 / radius.powi(n as i32)).collect()
}

#[test]
fn filters_approach_the_quadrature_as_their_sections_grow_in_number() {
    let steps = 4000;
    let order = BdfOrder::GRUNWALD_LETNIKOV;
    for exponent in [0.5, 1.5] {
        let weights = quadrature(1, exponent, steps);
        for name in ["oustaloup", "matsuda"] {
            let make = |tolerance| match name {
                "oustaloup" => oustaloup(exponent, order, 1.0, 1, steps, tolerance).unwrap(),
                _ => matsuda(exponent, order, 1.0, 1, steps, tolerance).unwrap(),
            };
            let (mut errors, mut sections) = (Vec::new(), Vec::new());
            for tolerance in [1e-1, 1e-2, 1e-4] {
                let mut memory = make(tolerance);
                let leading = (memory.leading()[0] / weights[0] - 1.0).abs();
                let error =
                    largest_error(&mut memory, &weights, Signal::Stationary, steps, |absolute, _| absolute);
                errors.push(error.max(leading));
                sections.push(memory.sections());
            }
            assert!(sections.is_sorted(), "{name}: {sections:?}");
            assert!(errors[1] < 0.5 * errors[0] && errors[2] < 0.1 * errors[1], "{name}: {errors:?}");
            assert!(errors[2] < 3e-3, "{name}, β = {exponent}: {errors:?} with {sections:?} sections");
        }
    }
}

#[test]
fn the_plain_sum_counts_two_operations_a_product() {
    let mut plain = PlainSum::new(&quadrature(1, 0.5, 1000), 1, 1000).unwrap();
    run(&mut plain, &vec![1.0; 1000]);
    assert_eq!(plain.operations().count(), 1000 * 999);
}
