//! Generates the controllers whose costs are measured.

use std::error::Error;
use std::path::Path;
use std::{env, fs};

use fvi_core::{AntiWindup, DerivativeFilter, PidGains, PidSettings};
use fvi_fft::exponentials::controller_source::controller_source;
use fvi_fft::exponentials::exponential_table::ENDLESS;

fn main() -> Result<(), Box<dyn Error>> {
    let gains = PidGains::Parallel { proportional: 8.0f32, integral: 4.0, derivative: 2.0 };
    // Everything that a loop may need; endless.
    let full = PidSettings {
        derivative_filter: DerivativeFilter::FirstOrder { time: 0.01 },
        limits: [-2.0, 2.0],
        rate_limit: 100.0,
        anti_windup: AntiWindup::BackCalculation { time: 0.2 },
        ..PidSettings::new(gains, 1e-3)
    };
    let orders = |integral_order, derivative_order| PidSettings { integral_order, derivative_order, ..full };
    let directory = env::var("OUT_DIR")?;
    for (name, settings) in [("integer", orders(1.0, 1.0)), ("fractional", orders(0.9, 0.8))] {
        let source = controller_source(name, &settings, ENDLESS, 1e-7)?;
        fs::write(Path::new(&directory).join(name).with_extension("rs"), source)?;
    }
    println!("cargo::rerun-if-changed=build.rs");
    Ok(())
}
