//! A nonlinear motion that is known because the force is made for it.

use fvi_core::{Damping, Fixed, Instant, Mass, Scheme, System, TimeForce};
use nalgebra::{SVector, vector};

use crate::convergence::largest_error;
use crate::motion::{Pendulum, integrate};

/// The n-th derivative of t⁸/4, n any number from 0 to 8.
fn derivative(n: f64, t: f64) -> f64 {
    libm::tgamma(9.0) / libm::tgamma(9.0 - n) * t.powf(8.0 - n) / 4.0
}

/// Largest errors of position and momentum of a pendulum on [0, 1] under the force that makes q = t⁸/4 exact:
/// nonlinear, and with so many derivatives zero at the start that no method loses order there.
///
/// `damping` is ρ D^β with ρ = `coefficient`, β = `damping_order`, in steps of 1/`steps`.
pub fn manufactured_errors(
    scheme: impl Scheme<f64, Fixed<1>>,
    damping: impl Damping<f64, Fixed<1>>,
    (coefficient, damping_order): (f64, f64),
    steps: usize,
) -> [f64; 2] {
    let force = |instant: Instant<f64>| {
        let t = instant.time;
        let pull = 2.0 * derivative(0.0, t).sin() + coefficient * derivative(damping_order, t);
        SVector::from([derivative(2.0, t) + pull])
    };
    let system = System {
        mass: Mass::diagonal([1.0]).expect("positive"),
        potential: Pendulum { gravity: 2.0 },
        force: TimeForce(force),
    };
    let h = 1.0 / steps as f64;
    let motion = integrate(system, scheme, damping, h, (vector![0.0], vector![0.0]), steps)
        .expect("steps that converge");
    let exact = |n: f64| -> Vec<f64> { motion.times.iter().map(|&t| derivative(n, t)).collect() };
    [
        largest_error(&motion.first_positions(), &exact(0.0)),
        largest_error(&motion.first_momenta(), &exact(1.0)),
    ]
}
