//! Runs the control loop, prints what its image prints, and compares its operators with full-memory sums in
//! double precision.

use std::error::Error;

use fvi_core::{BdfOrder, ConvolutionWeights};
use scenarios::control_loop::{ControlLoop, PRINTED, TICKS, Tick};

/// Bound on the error of an operator, relative to Σ|w_n||e_{k−n}|.
const TOLERANCE: f64 = 5e-7;

/// Largest error of the operator of an exponent at every printed tick, relative to Σ|w_n||e_{k−n}|.
fn largest_error(ticks: &[Tick], exponent: f64, value: impl Fn(&Tick) -> f32) -> Result<f64, Box<dyn Error>> {
    let weights: Vec<f64> =
        ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, 1e-3)?.take(ticks.len()).collect();
    let mut largest = 0.0f64;
    for k in (PRINTED as usize..=ticks.len()).step_by(PRINTED as usize) {
        let past = &ticks[..k];
        let (mut sum, mut size) = (0.0, 0.0);
        for (weight, tick) in weights.iter().zip(past.iter().rev()).rev() {
            let product = weight * f64::from(tick.error);
            sum += product;
            size += product.abs();
        }
        largest = largest.max((f64::from(value(&past[k - 1])) - sum).abs() / size);
    }
    Ok(largest)
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut control_loop = ControlLoop::new()?;
    let mut ticks = Vec::with_capacity(TICKS as usize);
    for k in 1..=TICKS {
        let tick = control_loop.tick()?;
        ticks.push(tick);
        if k % PRINTED == 0 {
            println!("{k} {tick}");
        }
    }
    println!("hash {:08x}", control_loop.hash());
    let integral = largest_error(&ticks, -0.8, |tick| tick.integral)?;
    let derivative = largest_error(&ticks, 0.6, |tick| tick.derivative)?;
    eprintln!(
        "error of I^0.8 and D^0.6 against full memory in double precision: {integral:.1e} and {derivative:.1e} of the sum's size"
    );
    if integral > TOLERANCE || derivative > TOLERANCE {
        return Err(format!("larger than {TOLERANCE:e}").into());
    }
    Ok(())
}
