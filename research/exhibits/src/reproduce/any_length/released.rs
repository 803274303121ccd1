//! Motions released from rest, in Caputo's sense: the order under refinement of a grid that grows from 10⁻⁹.

use super::super::error_curve::{ErrorCurve, error_chart, error_table};
use super::super::{Findings, ReproduceError};
use super::problems::{COLLOCATION, COLLOCATION_2, Problem};
use std::sync::atomic::AtomicBool;

/// Damping orders with known values.
const ORDERS: [f64; 4] = [0.3, 0.5, 0.7, 1.5];

/// Numbers of halvings of every step.
const HALVINGS: std::ops::RangeInclusive<u32> = 0..=4;

/// Errors below this are those of the memory, whose table is made for 10⁻¹³, and rounding.
const FLOOR: f64 = 2e-13;

/// Grid points: steps growing from 10⁻⁹ by a factor of about 3 up to ½, through all times with known values,
/// each divided into 2^`halvings` equal steps.
fn grid(problem: &Problem, halvings: u32) -> Vec<f64> {
    let known = problem.times();
    let (mut times, mut step) = (vec![0.0], 1e-9_f64);
    for target in known {
        let from = times.last().copied().unwrap_or(0.0);
        // As many steps as the growth needs, all shortened by the same factor to end at the known time.
        let (mut lengths, mut sum) = (Vec::new(), 0.0);
        while sum < (target - from) * (1.0 - 1e-9) {
            lengths.push(step);
            sum += step;
            step = (3.0 * step).min(0.5);
        }
        let mut reached = 0.0;
        let count = lengths.len();
        for (index, length) in lengths.into_iter().enumerate() {
            reached += length * (target - from) / sum;
            times.push(if index + 1 == count { target } else { from + reached });
        }
    }
    let parts = 1_u32 << halvings;
    let cut = |pair: &[f64]| {
        let (from, to) = (pair[0], pair[1]);
        (0..parts)
            .map(move |part| from + (to - from) * f64::from(part) / f64::from(parts))
            .collect::<Vec<_>>()
    };
    let mut fine: Vec<f64> = times.windows(2).flat_map(cut).collect();
    fine.extend(times.last());
    fine
}

pub(super) fn exhibit(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let (mut positions, mut momenta) = (Vec::new(), Vec::new());
    let ways = ORDERS.map(|order| (order, COLLOCATION, 3)).into_iter().chain([(0.5, COLLOCATION_2, 2)]);
    for (order, scheme, stages) in ways {
        let problem = Problem::released(1.0, order);
        let mut points = [Vec::new(), Vec::new()];
        for halvings in HALVINGS {
            let times = grid(&problem, halvings);
            let time = format!("grid = \"points\"\npoints = {times:?}\n");
            let made = problem.run(scheme, &time, stop)?;
            for (points, error) in points.iter_mut().zip([made.position, made.momentum]) {
                points.push((0.5 / f64::from(1 << halvings), error));
            }
        }
        let label = format!("β = {order}, {stages} stages");
        let [of_position, of_momentum] = points.map(|mut points| {
            points.retain(|point| point.1 > FLOOR);
            ErrorCurve::new(label.as_str(), points)
        });
        positions.push(of_position);
        momenta.push(of_momentum);
    }
    let steps = grid(&Problem::released(1.0, 0.5), 0).len() - 1;
    let subtitle = "q̈ + D^β q + q = 0 on [0, 20], Caputo, q(0) = 1; h: longest step";
    let caption = |of| {
        format!(
            "Errors of {of} at 43 times from 0.001 to 20. The coarsest grid has {steps} steps: from 10⁻⁹ on each three times the one before, \
             up to ½; the next halve each step"
        )
    };
    let chart = error_chart("Let go from rest: errors of q", subtitle, &positions, &[3.0, 5.0]);
    Ok(Findings::default()
        .with_picture("", "Errors of q over the longest step", chart)
        .with_table(error_table("positions", caption("q"), &positions))
        .with_table(error_table("momenta", caption("p"), &momenta))
        .with_remark(
            "Values by residues and the integral along the cut, to 20 digits (`tests/reference/released.py`). The start is singular like t^(2−β) \
             in q̇: nothing of it is left in the order, since the steps grow with the time.",
        ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refined_grid_is_refined_everywhere_and_meets_the_times_that_are_known() {
        let problem = Problem::released(1.0, 0.5);
        let (coarse, fine) = (grid(&problem, 0), grid(&problem, 2));
        assert_eq!(fine.len() - 1, 4 * (coarse.len() - 1));
        assert!(fine.windows(2).all(|pair| pair[0] < pair[1]));
        for time in problem.times() {
            assert!(coarse.contains(&time) && fine.contains(&time), "{time}");
        }
    }
}
