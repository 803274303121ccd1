//! The fractional oscillator q̈ + ½ D^β q + q = 0 on [0, 8] with its exact solution, for damping orders from
//! 0.1 to 1.9.

use super::ReproduceError;
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use std::path::Path;

/// Damping orders with known values.
pub(super) const DAMPING_ORDERS: [f64; 11] = [0.1, 0.3, 0.5, 0.7, 0.9, 1.0, 1.1, 1.3, 1.5, 1.7, 1.9];

/// G, G′, G″, S = ∫G and J = ∫S to 21 digits at t = 1, 2, 3, 4, 6, 8, with L{G} = 1/(s² + ½ s^β + 1):
/// `tests/reference/oscillator.py`.
const VALUES: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/reference/oscillator.csv"));

/// How a motion starts, and in which sense it is damped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Start {
    /// Caputo, q(0) = 1, q̇(0) = 0.
    Released,
    /// Caputo, q(0) = 0, q̇(0) = 1.
    Pushed,
    /// Riemann–Liouville, q(0) = 1, q̇(0) = 0: a force that is singular like t^(−β).
    Singular,
}

impl Start {
    pub(super) const ALL: [Self; 3] = [Self::Released, Self::Pushed, Self::Singular];

    /// Description as text.
    pub(super) fn describe(self) -> &'static str {
        match self {
            Self::Released => "Caputo, q(0) = 1",
            Self::Pushed => "Caputo, q̇(0) = 1",
            Self::Singular => "Riemann–Liouville, q(0) = 1",
        }
    }

    /// q and p = q̇ at a time.
    fn solution(self, damping_order: f64, t: f64, [g, dg, ddg, s, j]: [f64; 5]) -> (f64, f64) {
        match self {
            Self::Released => (1.0 - s, -g),
            Self::Pushed if damping_order <= 1.0 => (g, dg),
            Self::Pushed => (t - j, 1.0 - s),
            Self::Singular => (dg, ddg),
        }
    }

    /// The motion, with its exact values for reference.
    ///
    /// # Errors
    /// If there are no values for the damping order.
    pub(super) fn scenario(self, damping_order: f64) -> Result<Scenario, ReproduceError> {
        let (derivative, position, velocity) = match self {
            Self::Released => ("caputo", 1.0, 0.0),
            Self::Pushed => ("caputo", 0.0, 1.0),
            Self::Singular => ("riemann-liouville", 1.0, 0.0),
        };
        let text = format!(
            r#"
            [system]
            mass = [1.0]
            potential = "0.5*q0^2"
            [[system.damping]]
            order = {damping_order:?}
            coefficient = [0.5]
            derivative = "{derivative}"
            [initial]
            position = [{position:?}]
            velocity = [{velocity:?}]
            [time]
            step = 0.125
            end = 8.0
            [reference]
            file = "exact.csv"
            "#
        );
        let document = Document::new("oscillator with known values", Path::new(""), &text);
        Ok(Scenario::from_document(document.with_attached("exact.csv", self.table(damping_order)))?)
    }

    /// `t,q0,p0,energy`.
    fn table(self, damping_order: f64) -> String {
        let mut table = "t,q0,p0,energy\n".to_owned();
        for line in VALUES.lines().skip(1) {
            let numbers: Vec<f64> = line.split(',').filter_map(|cell| cell.parse().ok()).collect();
            let [beta, t, values @ ..] = numbers.as_slice() else { continue };
            let Ok(values) = <[f64; 5]>::try_from(values) else { continue };
            if *beta == damping_order {
                let (q, p) = self.solution(damping_order, *t, values);
                table += &format!("{t:?},{q:?},{p:?},{:?}\n", 0.5 * (q * q + p * p));
            }
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_damping_order_has_values_that_start_and_damp_as_they_should() {
        for beta in DAMPING_ORDERS {
            for start in Start::ALL {
                let scenario = start.scenario(beta).unwrap();
                let reference = scenario.reference.unwrap();
                let row = |index| reference.at_step(index, 0.125, 1).unwrap();
                let energies = [8, 16, 64].map(|index| row(index).energy.unwrap());
                assert!(energies.iter().all(|energy| *energy > 0.0), "{beta}, {start:?}");
                assert!(energies[2] < 0.51, "{beta}, {start:?}: {energies:?}");
            }
        }
    }

    #[test]
    fn with_linear_damping_the_values_are_elementary() {
        // q̈ + ½ q̇ + q = 0.
        let (rate, frequency) = (0.25_f64, (1.0_f64 - 0.0625).sqrt());
        let scenario = Start::Pushed.scenario(1.0).unwrap();
        let row = scenario.reference.unwrap().at_step(16, 0.125, 1).unwrap();
        let exact = (-2.0 * rate).exp() * (2.0 * frequency).sin() / frequency;
        assert!((row.position[0].unwrap() - exact).abs() < 1e-15);
    }
}
