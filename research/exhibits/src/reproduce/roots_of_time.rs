//! Forces that begin like a root of time: errors of a scheme with and without exact moments of the force.

use super::error_curve::ErrorCurve;
use super::motion::Motion;
use super::problems::{on_grid, power_plate};
use super::table::{Cell, Column, Format, Table};
use super::{Exhibit, Findings, ReproduceError};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_scenario::scenario::{Convolution, ForceQuadrature, Scenario, Scheme};
use std::sync::atomic::AtomicBool;

pub(super) const EXHIBITS: [Exhibit; 1] = [Exhibit::beyond(
    "roots-of-time",
    "forces that begin like a root of time, by their values and by their moments",
    exhibit,
)];

/// Powers ν of the solutions t^ν; their forces begin like t^(ν−2).
const POWERS: [f64; 8] = [2.05, 2.1, 2.2, 2.35, 2.5, 2.8, 3.0, 3.5];

/// Steps on [0, 1].
const STEPS: [usize; 3] = [64, 128, 256];

/// q̈ + D^{3/2} q + q = f with the solution t^ν on `steps` equal steps, degree 3 on the nodes of Radau IIA 3.
fn scenario(power: f64, forces: ForceQuadrature, steps: usize) -> Result<Scenario, ReproduceError> {
    let mut scenario = on_grid(power_plate(power, 1.0)?, 1.0 / steps as f64, steps);
    scenario.system.force_quadrature = forces;
    scenario.scheme = Scheme::Galerkin { degree: 3, quadrature: None };
    scenario.convolution =
        Convolution { family: ConvolutionFamily::RadauIia { stages: 3 }, ..Convolution::default() };
    Ok(scenario)
}

/// Largest errors of q and p over all grid points, over the step sizes.
fn errors(power: f64, forces: ForceQuadrature, stop: &AtomicBool) -> Result<[ErrorCurve; 2], ReproduceError> {
    let mut curves = [Vec::new(), Vec::new()];
    for steps in STEPS {
        let scenario = scenario(power, forces, steps)?;
        let errors = Motion::run("", &scenario, stop)?.errors(&scenario);
        for (curve, error) in curves.iter_mut().zip([errors.position.largest, errors.momentum.largest]) {
            curve.push((scenario.time.step, error));
        }
    }
    Ok(curves.map(|points| ErrorCurve::new("", points)))
}

fn exhibit(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let error = |name: &str| Column::new(name, Format::Error);
    let order = |name: &str| Column::new(name, Format::Order);
    let columns = vec![
        Column::new("ν", Format::Exact),
        error("error of q, values"),
        order("order, values").headed("order"),
        error("error of q, moments"),
        order("order, moments").headed("order"),
        order("ν + ½"),
        error("error of p, moments"),
        order("order of p, moments").headed("order"),
        order("ν − ½"),
    ];
    let caption =
        "Largest errors over all grid points with 256 equal steps on [0, 1], orders from 64 steps on";
    let mut table = Table::new("", caption, columns);
    for power in POWERS {
        let [values, _] = errors(power, ForceQuadrature::Nodes, stop)?;
        let [position, momentum] = errors(power, ForceQuadrature::Moments, stop)?;
        let finest = |curve: &ErrorCurve| Cell::from(curve.points.last().map(|point| point.1));
        table = table.with_row([
            power.into(),
            finest(&values),
            values.slope().into(),
            finest(&position),
            position.slope().into(),
            (power + 0.5).into(),
            finest(&momentum),
            momentum.slope().into(),
            (power - 0.5).into(),
        ]);
    }
    Ok(Findings::default().with_table(table).with_remark(
        "q̈ + D^(3/2) q + q = f with the solution t^ν, Galerkin of degree 3 on the nodes of Radau IIA 3. By its values at the nodes the force \
         t^(ν−2) is taken to order ν − 1 at best; its moments are exact, and what is left is the quadrature of D^(3/2) t^ν in the first steps: \
         h^(ν−β) in the force, h^(ν+2−β) in q and h^(ν+1−β) in p. The same scheme in 50 digits has the same errors to four digits \
         (`tests/reference/power_plate.py`), so that no better moments would make them smaller. Where that is not enough take graded steps \
         (`any-length-singular`).",
    ))
}
