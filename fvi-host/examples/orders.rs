//! Many runs in code: how much of its energy an oscillator keeps for ten damping orders.

use fvi_host::run::Run;
use fvi_scenario::scenario::Scenario;
use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for tenths in (1..20).step_by(2) {
        let order = f64::from(tenths) / 10.0;
        let scenario: Scenario = format!(
            r#"
            system.mass = [1.0]
            system.potential = "0.5*q0^2"
            system.damping = [{{ order = {order}, coefficient = [0.05] }}]
            initial.position = [1.0]
            time = {{ step = 0.05, end = 50.0 }}
            "#
        )
        .parse()?;
        let mut energies = (0.0, 0.0);
        let mut run = Run::of(&scenario).start()?;
        let Ok(_) = run.drive(&AtomicBool::new(false), |portion| {
            portion.states(|steps, state| {
                if steps == 0 {
                    energies.0 = state.energy;
                }
                energies.1 = state.energy;
                Ok::<(), Infallible>(())
            })
        });
        println!("order {order:.1}: {:5.1} % of the energy left", 100.0 * energies.1 / energies.0);
    }
    Ok(())
}
