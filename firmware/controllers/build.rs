//! Generates the controllers whose costs are measured.

use std::error::Error;
use std::path::Path;
use std::{env, fs};

use fvi_core::{AntiWindup, DerivativeFilter, PidGains, PidLaw, PidSettings};
use fvi_fft::exponentials::controller_source::{ControllerTables, controller_source, source_with_tables};
use fvi_fft::exponentials::exponential_table::ENDLESS;
use fvi_fft::exponentials::fixed_source::{FixedController, FixedUnits};

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
    // The fractional one within 1 % over five decades, in floating point and in whole numbers.
    let write = |name: &str, source| fs::write(Path::new(&directory).join(name).with_extension("rs"), source);
    let settings = orders(0.9, 0.8);
    let law = PidLaw::new(settings)?;
    let tables = ControllerTables::over_band(&law, [0.005, 500.0], 1e-2)?;
    write("band", source_with_tables("band", &law, &tables, "")?)?;
    let gains = PidGains::Parallel { proportional: 8.0, integral: 4.0, derivative: 2.0 };
    let law = PidLaw::new(PidSettings {
        integral_order: 0.9,
        derivative_order: 0.8,
        derivative_filter: settings.derivative_filter,
        limits: [-2.0, 2.0],
        rate_limit: 100.0,
        anti_windup: settings.anti_windup,
        ..PidSettings::new(gains, 1e-3)
    })?;
    let fixed = FixedController::new(&law, &tables, FixedUnits { input: 1e-4, output: 1e-3 })?;
    write("whole", fixed.rust("whole", 1e-3, &tables, ""))?;
    println!("cargo::rerun-if-changed=build.rs");
    Ok(())
}
