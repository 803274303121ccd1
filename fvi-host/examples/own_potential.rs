//! A potential that is no expression: a mass on a string that only pulls, with its derivatives in code.

use fvi_host::run::Run;
use fvi_scenario::language::expression::Moment;
use fvi_scenario::scenario::{OwnTerms, Scenario, SharedTerms};
use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

/// Stiffness 4 beyond a length of 0.5, on either side.
struct LooseString;

impl OwnTerms for LooseString {
    fn potential(&mut self, position: &[f64]) -> f64 {
        2.0 * (position[0].abs() - 0.5).max(0.0).powi(2)
    }

    fn add_restoring_force(&mut self, _: Moment<f64>, position: &[f64], restoring: &mut [f64]) {
        restoring[0] += 4.0 * (position[0].abs() - 0.5).max(0.0).copysign(position[0]);
    }

    fn add_linearisation(
        &mut self,
        time: Moment<f64>,
        position: &[f64],
        restoring: &mut [f64],
        stiffness: &mut [f64],
    ) {
        self.add_restoring_force(time, position, restoring);
        stiffness[0] += if position[0].abs() > 0.5 { 4.0 } else { 0.0 };
    }

    fn take_largest_force(&mut self, largest: &mut [f64]) {
        largest.fill(0.0);
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scenario: Scenario = r#"
        system.mass = [1.0]
        system.damping = [{ order = 0.5, coefficient = [0.2] }]
        initial.position = [1.0]
        time = { step = 0.002, end = 20.0 }
    "#
    .parse()?;
    let scenario = scenario.with_own_terms(SharedTerms::new(LooseString));
    let mut largest: f64 = 0.0;
    let mut run = Run::of(&scenario).start()?;
    let Ok(_) = run.drive(&AtomicBool::new(false), |portion| {
        portion.states(|_, state| {
            largest = largest.max(state.position[0].abs());
            Ok::<(), Infallible>(())
        })
    });
    println!("q(20) = {:+.4}, never beyond {largest:.4}", run.state().position[0]);
    Ok(())
}
