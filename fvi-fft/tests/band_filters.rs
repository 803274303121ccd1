//! Filters of the literature: what defines them, and their forms in discrete time.

use fvi_fft::exponentials::band_filter::{BandFilter, Design};
use nalgebra::Complex;
use std::f64::consts::PI;

const STEP: f64 = 1e-3;

fn filter(design: Design, exponent: f64, band: [f64; 2], order: usize) -> BandFilter {
    BandFilter::new(design, exponent, STEP, band, order).unwrap()
}

#[test]
fn oustaloups_corners_follow_each_other_by_constant_factors() {
    let found = filter(Design::Oustaloup, 0.5, [1.0, 100.0], 4);
    let (low, ratio) = (2.0 * PI, 100f64.powf(0.25));
    for i in 0..4 {
        // A quarter and three quarters of an interval from its beginning.
        let first = low * ratio.powi(i as i32);
        assert!((found.zeros[i] / (first * ratio.powf(0.25)) - 1.0).abs() < 1e-12, "{found:?}");
        assert!((found.poles[i] / (first * ratio.powf(0.75)) - 1.0).abs() < 1e-12, "{found:?}");
    }
    assert!((found.gain / (200.0 * PI).sqrt() - 1.0).abs() < 1e-12, "{found:?}");
}

/// At the frequencies ω_i of the design Matsuda's filter has the values ω_i^β, as a function of a real s.
#[test]
fn matsudas_fraction_goes_through_the_magnitudes() {
    for (exponent, order) in [(0.5, 3), (-0.3, 5), (0.8, 2)] {
        let found = filter(Design::Matsuda, exponent, [0.1, 100.0], order);
        for i in 0..=2 * order {
            let place = 0.2 * PI * 1000f64.powf(i as f64 / (2 * order) as f64);
            let value = found.at(Complex::new(place, 0.0));
            assert!((value.re / place.powf(exponent) - 1.0).abs() < 1e-7, "{exponent} {i}: {value}");
        }
        let [size, phase] = found.errors();
        assert!(size < 3.0 && phase < 40.0, "{exponent}: {size} {phase}");
    }
}

/// The sections one after the other, and the one difference equation, answer an impulse alike.
#[test]
fn sections_and_transfer_function_are_the_same_filter() {
    for design in [Design::Oustaloup, Design::Matsuda] {
        let found = filter(design, 0.5, [1.0, 100.0], 4);
        let sections = found.sections();
        let [b, a] = found.transfer_function().unwrap();
        assert_eq!((b.len(), a.len(), a[0]), (5, 5, 1.0));
        let mut states = vec![[0.0; 2]; sections.len()];
        let (mut inputs, mut outputs) = (Vec::new(), Vec::<f64>::new());
        for k in 0..200 {
            let input = if k == 0 { 1.0 } else { 0.0 };
            let mut signal = input;
            for ([b0, b1, a1], [x, y]) in sections.iter().zip(&mut states) {
                let next = b0 * signal + b1 * *x - a1 * *y;
                (*x, *y, signal) = (signal, next, next);
            }
            inputs.push(input);
            let past = |numbers: &[f64], values: &[f64], from: usize| -> f64 {
                (from..=4.min(k)).map(|n| numbers[n] * values[k - n]).sum()
            };
            let output = past(&b, &inputs, 0) - past(&a, &outputs, 1);
            outputs.push(output);
            assert!((output - signal).abs() < 1e-7 * found.gain, "{design:?} {k}: {output} {signal}");
        }
    }
}

/// With a dozen slow poles the coefficients of one polynomial are another filter: refused, and not printed.
#[test]
fn polynomials_that_double_precision_does_not_hold_are_refused() {
    let found = filter(Design::Oustaloup, 0.5, [1e-4, 100.0], 15);
    assert!(
        found.errors()[1] < 30.0 && found.transfer_function().unwrap_err().to_string().contains("narrower")
    );
    for (exponent, band, order, named) in [
        (1.2, [1.0, 10.0], 3, "exponent"),
        (0.5, [0.0, 10.0], 3, "lower end"),
        (0.5, [1.0, 500.0], 3, "upper end"),
        (0.5, [1.0, 10.0], 0, "order"),
    ] {
        let error = BandFilter::new(Design::Oustaloup, exponent, STEP, band, order).unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
    let error = BandFilter::new(Design::Matsuda, 0.5, STEP, [1e-3, 100.0], 40).unwrap_err().to_string();
    assert!(error.contains("continued fraction"), "{error}");
}
