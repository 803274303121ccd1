//! A simulation without files: system, kernel, scheme, engine, grid and event in code, states as they are
//! made.
//!
//! A mass on a fractional Zener solid is let go; the run ends when it first passes its place of rest.

use fvi_host::prelude::*;
use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scenario = Scenario::builder([1.0])
        .potential("0.5*q0^2 + 0.1*q0^4")
        .damper(Damper::new(TransferFunction::maxwell(0.6, 0.0, 1.0)?, [1.5]))
        .position([1.0])
        .scheme(Scheme::Galerkin { degree: 2, quadrature: None })
        .convolution(ConvolutionFamily::Bdf { order: 4 })
        .engine(Engine::ExponentialSum)
        .event("q0", Direction::Both, Action::Stop)
        .until(0.01, 20.0)
        .build()?;
    let mut run = Run::of(&scenario).start()?;
    let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
        portion.states(|steps, state| {
            if steps % 50 == 0 {
                println!("t = {:.2}: q = {:+.6}", state.time, state.position[0]);
            }
            Ok::<(), Infallible>(())
        })
    });
    let summary = run.summary(end);
    let passage = summary.events.first().ok_or("the mass never passes its place of rest")?;
    println!("passes its place of rest at t = {:.9}", passage.time);
    Ok(())
}
