//! The solution t^(5/2): errors on graded and equal steps with a singular start.

use super::super::error_curve::{ErrorCurve, error_chart, error_table};
use super::super::{Findings, ReproduceError};
use super::problems::{COLLOCATION, COLLOCATION_2, GALERKIN, Made, Problem};
use std::sync::atomic::AtomicBool;

/// Label, scheme and exponent of the graded steps (1: equal steps).
const WAYS: [(&str, &str, f64); 8] = [
    ("BDF 2 at the nodes, equal steps", "", 1.0),
    (
        "BDF 3, starting weights, equal steps",
        "[scheme]\nkind = \"galerkin\"\ndegree = 2\nquadrature = \"gauss\"\npoints = 2\n\
         [convolution]\nfamily = \"bdf\"\norder = 3\nat = \"main-nodes\"\nstarting = [2.5]\n",
        1.0,
    ),
    ("Galerkin, Radau IIA 3, equal steps", GALERKIN, 1.0),
    ("collocation 3, equal steps", COLLOCATION, 1.0),
    ("collocation 2, exponent 4", COLLOCATION_2, 4.0),
    ("Galerkin, Radau IIA 3, exponent 4", GALERKIN, 4.0),
    ("collocation 3, exponent 3", COLLOCATION, 3.0),
    ("collocation 3, exponent 4", COLLOCATION, 4.0),
];

/// 20 to 1280 steps.
const LEVELS: std::ops::RangeInclusive<u32> = 0..=6;

/// Errors below this are rounding.
const FLOOR: f64 = 2e-14;

/// `[time]` with `steps` graded steps on [0, 1]; with the exponent 1 they are equal.
pub(super) fn graded(steps: usize, exponent: f64) -> String {
    match exponent {
        1.0 => format!("step = {:?}\nend = 1.0\n", 1.0 / steps as f64),
        _ => format!("grid = \"graded\"\nend = 1.0\nsteps = {steps}\nexponent = {exponent:?}\n"),
    }
}

pub(super) fn exhibit(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let curves = [|made: &Made| made.position, |made: &Made| made.momentum].map(|of| {
        let curve = |&(label, scheme, exponent): &(&str, &str, f64)| {
            let mut points = Vec::new();
            for level in LEVELS {
                let steps = 20 << level;
                let made = Problem::root().run(scheme, &graded(steps, exponent), stop)?;
                points.push((1.0 / steps as f64, of(&made)));
            }
            let rounding = points.iter().position(|point| point.1 < FLOOR);
            points.truncate(rounding.unwrap_or(points.len()));
            Ok::<_, ReproduceError>(ErrorCurve::new(label, points).above_rounding())
        };
        WAYS.iter().map(curve).collect::<Result<Vec<_>, _>>()
    });
    let [positions, momenta] = curves;
    let (positions, momenta) = (positions?, momenta?);
    let subtitle = "q̈ + D^(3/2) q + q = f on [0, 1], largest error over all grid points; h: mean step";
    let chart = |title, curves| error_chart(title, subtitle, curves, &[1.5, 5.0]);
    let caption = |of| format!("Errors of {of} over the mean step, on the times t_k = (k h)^exponent");
    Ok(Findings::default()
        .with_picture("", "Errors of q over the mean step size", chart("The solution t^(5/2): errors of q", &positions))
        .with_picture("momenta", "Errors of p over the mean step size", chart("The solution t^(5/2): errors of p", &momenta))
        .with_table(error_table("positions", caption("q"), &positions))
        .with_table(error_table("momenta", caption("p"), &momenta))
        .with_remark(
            "All schemes here take the force's moments with their polynomials exactly where its root asks for that, but collocation, which sees \
             its nodes only: on equal steps it has the order 1.5 of the start. With an exponent γ the start adds an error like h^(1.5 γ) to p: \
             the momentum has the full order 5 from γ = 4 on. Starting weights mend the quadrature of the memory, not the main nodes that \
             the damping acts at.",
        ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn graded_steps_keep_the_order_of_the_method() {
        let stop = AtomicBool::new(false);
        let error = |scheme, steps| Problem::root().run(scheme, &graded(steps, 4.0), &stop).unwrap();
        for (scheme, expected) in [(COLLOCATION, 5.0), (COLLOCATION_2, 3.0)] {
            let [coarse, fine] = [40, 80].map(|steps| error(scheme, steps));
            let orders =
                [(coarse.position / fine.position), (coarse.momentum / fine.momentum)].map(f64::log2);
            assert!(orders.iter().all(|order| (order - expected).abs() < 0.3), "{expected}: {orders:?}");
        }
    }
}
