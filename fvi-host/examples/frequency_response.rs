//! The resonance of a mass on a polymer whose Prony series is known: frequency response, poles, damping
//! ratios.

use fvi_host::response::{ResponseOptions, respond};
use fvi_scenario::scenario::Scenario;
use std::sync::atomic::AtomicBool;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scenario: Scenario = r#"
        system.mass = [1.0]
        system.potential = "0.5*4*q0^2"
        system.damping = [{ kernel = { form = "prony", strengths = [1.0, 0.7], times = [1.0, 0.1] }, coefficient = [0.5] }]
        initial.position = [0.0]
        time = { step = 0.01, end = 20.0 }
    "#
    .parse()?;
    let options =
        ResponseOptions { from: Some(0.1), to: Some(100.0), points: 200, ..ResponseOptions::default() };
    let response = respond(&scenario, &options, &AtomicBool::new(false), &mut |_, _| {})?;
    let sizes = response.omega.iter().zip(&response.response).map(|(omega, h)| (omega, h.norm()));
    let Some((omega, height)) = sizes.max_by(|one, other| one.1.total_cmp(&other.1)) else { return Ok(()) };
    println!("largest response {height:.3} near ω = {omega:.3}");
    for pole in response.poles? {
        println!("pole: frequency {:.4}, damping ratio {:.4}", pole.frequency(), pole.damping());
    }
    Ok(())
}
