//! Multipliers of a mechanism's constraints at any of its states.

use super::tangent::mechanism_step::{Saddle, add, add_transposed, second_at, turn_constraints};
use crate::model::Mechanism;
use fvi_core::{Instant, Lagrangian};

/// λ of M a + Cᵀλ = L_q + F − Gᵀf − (∂L_v/∂q) v and C a = −vᵀ∂²c v at a time, position and velocity, for
/// forces f of the dampers and a force of the input in F; `None` if they are not determined.
pub(super) fn multipliers(
    system: &mut Mechanism<f64>,
    (time, position, velocity): (f64, &[f64], &[f64]),
    [pulls, input]: [&[f64]; 2],
) -> Option<Vec<f64>> {
    let (n, m) = (system.coordinates(), system.constraints());
    let instant = Instant::in_step(time, 0.5, 0.0);
    let (mut momentum, mut force) = (vec![0.0; n], vec![0.0; n]);
    system.first(instant, position, velocity, &mut momentum, &mut force);
    force.iter_mut().zip(input).for_each(|(force, &input)| *force += input);
    let mut elongating = vec![0.0; pulls.len() * n];
    system.elongate(position, &mut elongating);
    add_transposed(-1.0, &elongating, pulls, &mut force);
    add(-1.0, &second_at(system, instant, position, velocity).coupling, velocity, &mut force);
    let (mut turning, mut bent) = (vec![0.0; m * n], vec![0.0; m]);
    turn_constraints(system, position, velocity, &mut turning);
    add(-1.0, &turning, velocity, &mut bent);
    Some(Saddle::new(system, position, [&force, &bent])?.value().1.to_vec())
}
