//! Sources of filters with complex poles compile, and have the response of their symbols.

use fvi_core::{BdfOrder, max_or_nan};
use fvi_fft::exponentials::complex_exponential_table::complex_exponentials;
use fvi_fft::exponentials::exponential_table::ENDLESS;
use fvi_fft::exponentials::paired_source::PairedSource;
use fvi_scenario::scenario::kernel_of_symbol;
use nalgebra::Complex;
use std::f64::consts::PI;

#[expect(unreachable_pub, reason = "the source is for a module of any visibility")]
mod notch {
    include!("filters/notch.rs");
}

const STEP: f64 = 0.01;

/// A notch at 2 rad/s and a resonance at 30 rad/s, whose poles are next to the axis.
const SYMBOL: &str = "(s^2 + 4)/(s^2 + 0.4*s + 4)*(s^2 + 60*s + 900)/(s^2 + 0.6*s + 900)";

fn source(in_single: bool) -> [String; 2] {
    let transfer = kernel_of_symbol(SYMBOL).unwrap().with_its_spring();
    let order = BdfOrder::new(2).unwrap();
    let (table, miss) = complex_exponentials(&transfer, order, false, STEP, ENDLESS, 1e-10).unwrap();
    assert!(miss.largest <= 1e-10 && miss.sum <= 1e-10, "{miss:?}");
    let source = PairedSource { table: &table, origin: "a notch and a resonance", name: "notch", in_single };
    [source.rust(), source.c()]
}

#[test]
fn the_source_is_what_is_compiled_here() {
    let [rust, c] = source(true);
    if let Some(directory) = std::env::var_os("FVI_WRITE_FILTERS") {
        std::fs::write(std::path::PathBuf::from(directory).join("notch.rs"), &rust).unwrap();
    }
    assert_eq!(rust, include_str!("filters/notch.rs"));
    // The same numbers, as values.
    let numbers = |text: &str| -> Vec<f64> {
        text.split(|letter: char| !(letter.is_ascii_alphanumeric() || "+-.".contains(letter)))
            .filter(|word| word.contains('.') || word.contains('e'))
            .filter_map(|word| word.parse().ok())
            .filter(|number: &f64| *number != 0.0)
            .collect()
    };
    let (in_rust, in_c) = (numbers(&rust), numbers(&c));
    assert!(in_rust.len() > 8, "{in_rust:?}");
    assert!(in_rust.iter().all(|number| in_c.contains(number)), "{in_rust:?} {in_c:?}");
    let [double, _] = source(false);
    assert!(double.contains("pub fn tick(&mut self, sample: f64) -> f64"), "{double}");
}

/// The response to a sine, by Fourier's integral over a whole number of its periods after the start has
/// faded, is K of the backward differences, and next to K(iω).
#[test]
fn a_filter_has_the_response_of_its_symbol() {
    let symbol = |s: Complex<f64>| {
        let square = s * s;
        (square + 4.0) / (square + s * 0.4 + 4.0) * (square + s * 60.0 + 900.0) / (square + s * 0.6 + 900.0)
    };
    // Periods of 16 … 2000 samples.
    for period in [16, 21, 63, 200, 314, 2000] {
        let turn = 2.0 * PI / f64::from(period);
        let omega = turn / STEP;
        let mut filter = notch::Notch::new();
        let (mut known, faded) = (Complex::<f64>::ZERO, 8000 / period * period);
        for k in 0..faded + period {
            let output = f64::from(filter.tick((turn * f64::from(k)).cos() as f32));
            if k >= faded {
                let back = Complex::new(0.0, -turn * f64::from(k)).exp();
                known += back * (output * 2.0 / f64::from(period));
            }
        }
        let fallen = Complex::new(1.0, 0.0) - Complex::new(0.0, -turn).exp();
        let exact = symbol((fallen + fallen * fallen * 0.5) / STEP);
        let size = exact.norm().max(0.1);
        assert!((known - exact).norm() < 3e-6 * size, "{omega}: {known} for {exact}");
        if omega < 3.0 {
            assert!((exact - symbol(Complex::new(0.0, omega))).norm() < 2e-3, "{omega}: {exact}");
        }
    }
}

#[test]
fn a_pair_that_hardly_decays_is_bounded_for_ten_million_ticks() {
    let mut filter = notch::Notch::default();
    let mut largest = 0.0;
    for k in 0..10_000_000_u32 {
        let sample = if k < 1000 { 1.0 } else { 0.0 };
        let output = filter.tick(sample).abs();
        if k > 9_000_000 {
            largest = max_or_nan(largest, f64::from(output));
        }
    }
    assert_eq!(largest, 0.0);
}
