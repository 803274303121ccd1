//! Sources of controllers compile, and make the controllers that their settings say.

use fvi_core::{DerivativeFilter, DerivativeOf, PidGains, PidLaw, PidSettings};
use fvi_fft::exponentials::controller_source::controller_source;

/// A fractional filter of the derivative, a law of everything that is not plain.
#[expect(unreachable_pub, reason = "the source is for a module of any visibility")]
mod full {
    include!("controllers/full.rs");
}

/// An integral alone, in double precision.
#[expect(unreachable_pub, reason = "the source is for a module of any visibility")]
mod plain {
    include!("controllers/plain.rs");
}

fn full_settings() -> PidSettings<f32> {
    let gains = PidGains::Parallel { proportional: 2.0, integral: 1.5, derivative: 0.25 };
    PidSettings {
        integral_order: 1.25,
        derivative_order: 0.75,
        setpoint_weights: [0.5, 0.25],
        derivative_of: DerivativeOf::ValuesFromRest,
        derivative_filter: DerivativeFilter::Fractional { time: 0.0625, order: 0.875 },
        rate_limit: 64.0,
        ..PidSettings::new(gains, 0.01)
    }
}

fn plain_settings() -> PidSettings<f64> {
    let gains =
        PidGains::Series { proportional: 0.3, integral_rate: 2.0, derivative_time: 0.0, filter_ratio: 10.0 };
    PidSettings { integral_order: 0.5, ..PidSettings::new(gains, 0.01) }
}

#[test]
fn the_source_is_what_is_compiled_here() {
    let full = controller_source("full", &full_settings(), 1000, 1e-3).unwrap();
    let plain = controller_source("plain", &plain_settings(), 1000, 1e-6).unwrap();
    if let Some(directory) = std::env::var_os("FVI_WRITE_CONTROLLERS") {
        let directory = std::path::PathBuf::from(directory);
        std::fs::write(directory.join("full.rs"), &full).unwrap();
        std::fs::write(directory.join("plain.rs"), &plain).unwrap();
    }
    assert_eq!(full, include_str!("controllers/full.rs"));
    assert_eq!(plain, include_str!("controllers/plain.rs"));
}

#[test]
fn it_makes_the_controller_of_its_settings() {
    assert_eq!(*full::full_law().unwrap().settings(), full_settings());
    assert_eq!(*plain::plain_law().unwrap().settings(), plain_settings());
    // One law, owned and shared.
    let law = full::full_law().unwrap();
    let mut own: full::FullPid = full::new_full().unwrap();
    let mut shared: full::FullPid<&PidLaw<f32>> = full::full_with(&law).unwrap();
    let mut plain: plain::PlainPid = plain::new_plain().unwrap();
    let mut sum = 0.0;
    for tick in 0..900 {
        let measured = (tick % 7) as f32 * 0.125;
        assert_eq!(own.tick(1.0, measured).unwrap(), shared.tick(1.0, measured).unwrap());
        sum = plain.tick(1.0, 0.0).unwrap();
    }
    // 0.3 (1 + 2 t^½/Γ(3/2)) at t = 9
    let exact = 0.3 * (1.0 + 2.0 * 3.0 / 0.886_226_925_452_758);
    assert!((sum - exact).abs() < 1e-3 * exact, "{sum} and not {exact}");
    // A law of other orders is not one of these tables.
    let other = PidSettings { integral_order: 1.5, ..full_settings() };
    assert!(full::full_with(PidLaw::new(other).unwrap()).is_err());
}
