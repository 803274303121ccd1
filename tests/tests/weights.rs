//! Convolution-quadrature weights against independent values and against the identities of the papers.

use fvi_core::{BdfOrder, ConvolutionWeights, left_operator, right_operator};
use fvi_fft::quadrature::multistep_weights::multistep_weights;
use fvi_fft::transfer::TransferFunction;
use fvi_tests::motion::weights;
use fvi_tests::reference;

/// Relative error allowed against 30-digit values one rounding of the leading weight's power,
/// one of the product.
const RELATIVE_ERROR: f64 = 4e-16;

/// The nearest `f64` to the exponent 0.7 of the reference values lies this far below it; the other exponents
/// are exact.
const EXPONENT_ROUNDING: f64 = 4.5e-17;

#[test]
fn weights_agree_with_thirty_digit_values_up_to_twenty_thousand() {
    let rows = reference::read("cq_weights.csv");
    let mut checked = 0;
    for group in rows.chunk_by(|a, b| a["order"] == b["order"] && a["beta"] == b["beta"]) {
        let order = BdfOrder::new(group[0]["order"] as usize).unwrap();
        let exponent = group[0]["beta"];
        let last = group.iter().map(|row| row["n"] as usize).max().unwrap();
        let weights: Vec<f64> =
            ConvolutionWeights::bdf(order, exponent, 1.0).unwrap().take(last + 1).collect();
        // How the weights follow the exponent, from a difference quotient.
        let nearby = ConvolutionWeights::bdf(order, exponent + 1e-6, 1.0).unwrap();
        let slopes: Vec<f64> =
            nearby.zip(&weights).map(|(moved, weight)| (moved - weight).abs() / 1e-6).collect();
        let rounding = if exponent == 0.7 { EXPONENT_ROUNDING } else { 0.0 };
        for row in group {
            let (n, expected) = (row["n"] as usize, row["weight"]);
            let error = (weights[n] - expected).abs();
            assert!(
                error <= RELATIVE_ERROR * expected.abs() + rounding * slopes[n],
                "order {order:?}, exponent {exponent}, n = {n}: {} instead of {expected}",
                weights[n]
            );
            checked += 1;
        }
    }
    assert!(checked > 500, "only {checked} reference values were read");
}

/// Lags of 10⁵ and more, some seconds for each kernel, where LONG is set: `.ci/kernels` does.
#[test]
fn weights_of_other_kernels_agree_with_twenty_four_digits() {
    let most = if std::env::var("LONG").is_ok() { usize::MAX } else { 12_345 };
    let text = include_str!("../reference/kernel_weights.csv");
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let mut checked = 0;
    for group in rows.chunk_by(|a, b| a[..3] == b[..3]) {
        let parameters: Vec<f64> = group[0][1].split(' ').map(|number| number.parse().unwrap()).collect();
        let transfer = match (group[0][0], &parameters[..]) {
            ("tempered", &[order, rate]) => TransferFunction::tempered(order, rate),
            ("maxwell", &[order, inner, time]) => TransferFunction::maxwell(order, inner, time),
            ("havriliak-negami", &[order, power, time]) => {
                TransferFunction::havriliak_negami(order, power, time)
            }
            ("prony", &[strength, time]) => TransferFunction::prony(&[strength], &[time]),
            other => panic!("{other:?}"),
        };
        let (transfer, order) = (transfer.unwrap(), BdfOrder::new(group[0][2].parse().unwrap()).unwrap());
        let step: f64 = group[0][3].parse().unwrap();
        let lag = |row: &Vec<&str>| row[4].parse::<usize>().unwrap();
        let last = group.iter().map(lag).filter(|&n| n <= most).max().unwrap();
        let weights = multistep_weights(&transfer, order, step, false, last + 1).unwrap();
        for row in group.iter().filter(|row| lag(row) <= most) {
            let (n, exact): (usize, f64) = (lag(row), row[5].parse().unwrap());
            let error = (weights[n] - exact).abs() / (0.5 * f64::EPSILON);
            // Below the least normal number there are fewer digits.
            let allowed = 4.0 * exact.abs();
            let nothing = f64::MIN_POSITIVE / (0.5 * f64::EPSILON);
            assert!(
                error <= allowed.max(nothing),
                "{transfer}, BDF {}, n = {n}: {:.1} u",
                order.get(),
                error / exact.abs()
            );
            checked += 1;
        }
    }
    assert!(checked > 250, "{checked}");
}

/// Coefficients of a product of power series.
fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    (0..a.len()).map(|k| (0..=k).map(|n| a[n] * b[k - n]).sum()).collect()
}

#[test]
fn powers_of_the_generating_function_form_a_semigroup() {
    // w^(a) ∗ w^(b) = w^(a+b) [HJO, Lemma 3.1 (1)], integrals included.
    for order in 1..=6 {
        for (a, b) in [(0.25, 0.25), (0.5, 0.5), (0.3, 0.9), (-0.5, 0.5), (-0.4, 1.9), (0.95, 0.95)] {
            let (left, right, sum) =
                (weights(order, a, 0.1, 300), weights(order, b, 0.1, 300), weights(order, a + b, 0.1, 300));
            let size = product(&absolute(&left), &absolute(&right));
            for (n, (found, expected)) in product(&left, &right).iter().zip(&sum).enumerate() {
                let error = (found - expected).abs();
                assert!(
                    error <= 1e-14 * size[n],
                    "order {order}, {a} + {b}, n = {n}: {found} and {expected}"
                );
            }
        }
    }
}

fn absolute(numbers: &[f64]) -> Vec<f64> {
    numbers.iter().map(|number| number.abs()).collect()
}

#[test]
fn the_right_operator_is_the_adjoint_of_the_left_one() {
    // Σ g_k (D₋f)_k = Σ (D₊g)_k f_k [HJO, Lemma 3.1 (2); JO, Lemma 4.1].
    for order in 1..=6 {
        for exponent in [-0.5, 0.3, 1.0, 1.9] {
            let table = weights(order, exponent, 0.1, 200);
            let f: Vec<f64> = (0..200).map(|k| (1.0 + k as f64 * 0.37).sin()).collect();
            let g: Vec<f64> = (0..200).map(|k| (2.0 + k as f64 * 0.11).cos() + 0.3).collect();
            let (mut left, mut right) = (vec![0.0; 200], vec![0.0; 200]);
            left_operator(&table, &f, &mut left);
            right_operator(&table, &g, &mut right);
            let by_left: f64 = left.iter().zip(&g).map(|(a, b)| a * b).sum();
            let by_right: f64 = right.iter().zip(&f).map(|(a, b)| a * b).sum();
            let size: f64 = left.iter().zip(&g).map(|(a, b)| (a * b).abs()).sum();
            assert!(
                (by_left - by_right).abs() <= 1e-13 * size,
                "order {order}, {exponent}: {by_left} and {by_right}"
            );
        }
    }
}

#[test]
fn order_one_and_exponent_one_is_the_backward_difference() {
    let table = weights(1, 1.0, 0.25, 50);
    let samples: Vec<f64> = (0..50).map(|k| (k as f64 * 0.3).exp() % 7.0).collect();
    let mut difference = vec![0.0; 50];
    left_operator(&table, &samples, &mut difference);
    for k in 1..50 {
        assert_eq!(difference[k], (samples[k] - samples[k - 1]) / 0.25, "k = {k}");
    }
}
