//! Tables for a band of frequencies: their responses by sums of their own, their size, their use in fvi-core.

use fvi_core::{BdfOrder, Kernel, Memory, PidGains, PidLaw, PidSettings, max_or_nan};
use fvi_fft::exponentials::band_table::{BandErrors, band_table};
use fvi_fft::exponentials::controller_source::ControllerTables;
use fvi_fft::exponentials::exponential_table::{ENDLESS, ExponentialKernel, ExponentialKernelError};
use fvi_fft::transfer::TransferFunction;
use nalgebra::Complex;

const STEP: f64 = 1e-3;

fn made(
    exponent: f64,
    band: [f64; 2],
    tolerance: f64,
) -> Result<(ExponentialKernel, BandErrors), ExponentialKernelError> {
    let transfer = TransferFunction::power(exponent).unwrap();
    band_table(&transfer, BdfOrder::GRUNWALD_LETNIKOV, exponent > 0.0, STEP, band, tolerance)
}

/// The largest relative error of the response over a band, against ((1 − z)/h)^β, and the largest error of
/// the phase against (iω)^β in degrees.
fn worst(table: &ExponentialKernel, exponent: f64, [low, high]: [f64; 2]) -> [f64; 2] {
    let mut worst = [0.0; 2];
    for k in 0..=5000 {
        let omega = 2.0 * std::f64::consts::PI * low * (high / low).powf(f64::from(k) / 5000.0);
        let z = Complex::new(0.0, -omega * STEP).exp();
        let mut found: Complex<f64> =
            table.head().iter().enumerate().map(|(n, weight)| z.powu(n as u32) * *weight).sum();
        let first = table.head().len() as u32;
        for e in table.exponentials() {
            let start = e.coefficient * (-e.rate * f64::from(first)).exp();
            found += z.powu(first) * start / (1.0 - z * (-e.rate).exp());
        }
        if table.on_increments() {
            found *= 1.0 - z;
        }
        let known = ((1.0 - z) / STEP).powf(exponent);
        let operator = Complex::new(0.0, omega).powf(exponent);
        worst[0] = max_or_nan(worst[0], (found / known - 1.0).norm());
        worst[1] = max_or_nan(worst[1], (found / operator).arg().to_degrees().abs());
    }
    worst
}

#[test]
fn the_response_is_within_the_tolerance_with_few_exponentials() {
    let band = [2.5e-3, 250.0];
    for (exponent, tolerance, most) in [
        (0.5, 1e-2, 7),
        (0.5, 1e-3, 11),
        (0.5, 1e-7, 23),
        (-0.8, 1e-2, 7),
        (-0.8, 1e-3, 10),
        (0.9, 1e-2, 6),
        (1.5, 1e-2, 7),
    ] {
        let (table, said) = made(exponent, band, tolerance).unwrap();
        let [relative, phase] = worst(&table, exponent, band);
        let count = table.exponentials().len();
        assert!(relative <= tolerance, "{exponent}: {relative}");
        assert!((said.relative / relative - 1.0).abs() < 0.02, "{exponent}: {said:?} {relative}");
        assert!((said.of_operator[1] / phase - 1.0).abs() < 0.02, "{exponent}: {said:?} {phase}");
        assert!(count <= most && table.horizon() == ENDLESS, "{exponent}: {count} {}", table.head().len());
    }
}

/// Oustaloup's filter with `count` sections, made for a band wider by `decades` at each end, as a function of
/// s = iω: its largest relative error over the band.
fn oustaloup(exponent: f64, [low, high]: [f64; 2], count: i32, decades: f64) -> f64 {
    let [low, high] = [low, high].map(|frequency| 2.0 * std::f64::consts::PI * frequency);
    let (first, last) = (low / 10f64.powf(decades), high * 10f64.powf(decades));
    let corner = |k: i32, shift: f64| {
        first * (last / first).powf((f64::from(k) + 0.5 * (1.0 + shift)) / f64::from(count))
    };
    let mut worst = 0.0;
    for k in 0..=2000 {
        let s = Complex::new(0.0, low * (high / low).powf(f64::from(k) / 2000.0));
        let sections: Complex<f64> =
            (0..count).map(|k| (s + corner(k, -exponent)) / (s + corner(k, exponent))).product();
        worst = max_or_nan(worst, (sections * last.powf(exponent) / s.powf(exponent) - 1.0).norm());
    }
    worst
}

/// Against s^½, before any discretisation and with the margin that suits it best, Oustaloup's filter of as
/// many sections is five times worse than a table is against the weights.
#[test]
fn seven_exponentials_are_more_accurate_than_seven_sections_of_oustaloup() {
    let band = [2.5e-3, 250.0];
    let (table, _) = made(0.5, band, 1e-2).unwrap();
    let [ours, _] = worst(&table, 0.5, band);
    let best = (0..=30).map(|tenths| oustaloup(0.5, band, 7, 0.1 * f64::from(tenths))).fold(1.0, f64::min);
    assert!(table.exponentials().len() == 7 && ours <= 1e-2 && best > 0.045, "{ours} {best}");
}

#[test]
fn a_memory_takes_the_table_and_keeps_integrating_below_the_band() {
    let (table, _) = made(-0.8, [0.1, 100.0], 1e-2).unwrap();
    let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, -0.8, STEP).unwrap();
    let single = table.table::<f32>();
    let state = vec![0.0f32; single.borrow::<f32>().state_len(1)];
    let mut memory = kernel.exponential_sum(single, 1, state).unwrap();
    let mut term = [0.0f32];
    let mut values = Vec::new();
    for _ in 0..100_000 {
        memory.push(&[1.0]).unwrap();
        memory.next_term(&mut term).unwrap();
        values.push(term[0]);
    }
    // 100 s of a one: t^0.8/Γ(1.8) within the band, and still growing at ten times its longest period.
    let known = 1.0 / libm::tgamma(1.8);
    assert!((f64::from(values[999]) / known - 1.0).abs() < 0.03, "{} {known}", values[999]);
    assert!(values[99_999] > 1.5 * values[49_999], "{} {}", values[49_999], values[99_999]);
}

#[test]
fn a_controller_has_the_tables_of_its_operators() {
    let gains = PidGains::Parallel { proportional: 1.0, integral: 2.0, derivative: 0.1 };
    let settings =
        PidSettings { integral_order: 0.9, derivative_order: 0.6, ..PidSettings::<f64>::new(gains, STEP) };
    let tables = ControllerTables::over_band(&PidLaw::new(settings).unwrap(), [0.01, 100.0], 1e-2).unwrap();
    let parts: Vec<_> = tables.errors.iter().map(|(part, errors)| (*part, errors.band)).collect();
    assert_eq!(parts, [("integral", [0.01, 100.0]), ("derivative", [0.01, 100.0])]);
    assert!(tables.errors.iter().all(|(_, errors)| errors.relative <= 1e-2));
    let counts = [tables.integral.exponentials().len(), tables.derivative.exponentials().len()];
    assert!(counts.iter().all(|count| *count <= 8), "{counts:?}");
    assert!(tables.worth("integral").contains("from 0.01 to 100 Hz"), "{}", tables.worth("integral"));
}

#[test]
fn bands_and_tolerances_out_of_range_are_named() {
    for (band, tolerance, said) in [
        ([0.0, 1.0], 1e-2, "lower end of the band = 0"),
        ([1.0, 0.5], 1e-2, "upper end of the band = 0.5"),
        ([1.0, 501.0], 1e-2, "upper end of the band = 501"),
        ([f64::NAN, 1.0], 1e-2, "lower end of the band = NaN"),
        ([0.1, 1.0], 1e-8, "tolerance = 0.00000001"),
        ([0.1, 1.0], 0.5, "tolerance = 0.5"),
    ] {
        let message = made(0.5, band, tolerance).unwrap_err().to_string();
        assert!(message.contains(said), "{said}: {message}");
    }
}
