//! An integral of order 0.8 in single precision, on a table without a horizon, over more than 2³² samples,
//! compared with the exact values at powers of two and at the end.

use std::error::Error;

use fvi_core::{ExponentialSum, FractionalOperator, Start};
use scenarios::tables::ENDLESS_INTEGRAL;

/// A million samples past 2³².
const SAMPLES: u64 = (1 << 32) + (1 << 20);

/// Largest relative error of a value: the tolerance of the table, and rounding of table and sums in single
/// precision.
const ALLOWED: f64 = 5e-7;

/// ln Γ(n + a) − ln Γ(n) for large n, by Stirling's series.
fn log_ratio_of_gammas(n: f64, a: f64) -> f64 {
    let series = |x: f64| 1.0 / (12.0 * x) - 1.0 / (360.0 * x.powi(3)) + 1.0 / (1260.0 * x.powi(5));
    (n - 0.5) * (a / n).ln_1p() + a * ((n + a).ln() - 1.0) + series(n + a) - series(n)
}

fn main() -> Result<(), Box<dyn Error>> {
    let memory = ExponentialSum::new(ENDLESS_INTEGRAL, 1.0, 1, vec![0.0f32; ENDLESS_INTEGRAL.state_len(1)])?;
    let mut integral = FractionalOperator::new(memory, Start::RiemannLiouville)?;
    // Γ(1.8)
    let gamma = 0.931_383_770_980_242_8;
    let mut worst = 0.0f64;
    for k in 1..=SAMPLES {
        let value = integral.push(0.7)?;
        if k >= 1024 && (k.is_power_of_two() || k == SAMPLES) {
            // Σ_{n<k} w_n = h^0.8 Γ(k + 0.8) / (Γ(1.8) Γ(k)), h = 1.
            let exact = f64::from(0.7f32) * log_ratio_of_gammas(k as f64, 0.8).exp() / gamma;
            let error = f64::from(value) / exact - 1.0;
            println!("{k} samples: {value:e}, relative error {error:.1e}");
            worst = worst.max(error.abs());
        }
    }
    if worst > ALLOWED { Err(format!("the largest error is {worst:e}").into()) } else { Ok(()) }
}
