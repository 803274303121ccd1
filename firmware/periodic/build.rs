//! Generates the constants of the controller from its orders, gains and sample time.

use std::error::Error;
use std::path::Path;
use std::{env, fs};

use fvi_core::{AntiWindup, DerivativeFilter, PidGains, PidSettings};
use fvi_fft::exponentials::controller_source::controller_source;
use fvi_fft::exponentials::exponential_table::ENDLESS;

fn main() -> Result<(), Box<dyn Error>> {
    // u = 8 (r − y) + 4 I^0.9 (r − y) − 2 D^0.8 y, filtered, within ±2, every millisecond.
    let gains = PidGains::Parallel { proportional: 8.0f32, integral: 4.0, derivative: 2.0 };
    let settings = PidSettings {
        integral_order: 0.9,
        derivative_order: 0.8,
        derivative_filter: DerivativeFilter::FirstOrder { time: 0.01 },
        limits: [-2.0, 2.0],
        anti_windup: AntiWindup::BackCalculation { time: 0.2 },
        ..PidSettings::new(gains, 1e-3)
    };
    // Weights within 10⁻⁷, without an end.
    let source = controller_source("axis", &settings, ENDLESS, 1e-7)?;
    let out = env::var("OUT_DIR")?;
    fs::write(Path::new(&out).join("axis.rs"), source)?;
    println!("cargo::rerun-if-changed=build.rs");
    // The memory map of the processor.
    let map = "../images/memory/arm.x";
    println!("cargo::rerun-if-changed={map}");
    fs::copy(map, Path::new(&out).join("memory.x"))?;
    println!("cargo::rustc-link-search={out}");
    Ok(())
}
