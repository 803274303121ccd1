//! A simulation without files: system, kernel, scheme, engine, grid and event in code, states as they are
//! made.
//!
//! A mass on a fractional Zener solid is let go; the run ends when it first passes its place of rest.

use fvi_lab::lab::run::Run;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Precision;
use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scenario: Scenario = r#"
        system.mass = [1.0]
        system.potential = "0.5*q0^2 + 0.1*q0^4"
        system.damping = [{ kernel = { form = "maxwell", order = 0.6, time = 1.0 }, coefficient = [1.5] }]
        initial.position = [1.0]
        scheme = { kind = "galerkin", degree = 2 }
        convolution.order = 4
        history.engine = "exponential-sum"
        time = { step = 0.01, end = 20.0 }
        event = [{ when = "q0", action = "stop" }]
    "#
    .parse()?;
    let run = Run::start(&scenario, Precision::F64)?;
    let Ok(summary) = run.to_the_end(&AtomicBool::new(false), |steps, state| {
        if steps % 50 == 0 {
            println!("t = {:.2}: q = {:+.6}", state.time, state.position[0]);
        }
        Ok::<(), Infallible>(())
    });
    let passage = summary.events.first().ok_or("the mass never passes its place of rest")?;
    println!("passes its place of rest at t = {:.9}", passage.time);
    Ok(())
}
