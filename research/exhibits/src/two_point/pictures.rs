//! The pictures of `fvi extremal`.

use super::extremal::{Solution, Status};
use super::grid::Sigma;
use super::problem_file::{KnownPositions, ProblemFile, Statement};
use fvi_host::results::picture::{Axis, Chart, Envelope, Series, Style};

/// The charts of a solution, with the names of their files.
pub(super) fn charts(file: &ProblemFile, status: Status, extremal: &Solution) -> Vec<(&'static str, Chart)> {
    let d = file.coordinates();
    let sigma = match file.sigma {
        Sigma::Minus => "−",
        Sigma::Plus => "+",
    };
    let (statement, solution, velocity) = match &file.statement {
        Statement::Lagrangian { lagrangian, alpha } => {
            (format!("L = {}, α = {alpha}", lagrangian.text()), "discrete extremal", "fractional velocity v")
        }
        Statement::Equation { .. } => ("direct embedding".to_owned(), "solution", "velocity v"),
    };
    let label = match status {
        Status::Converged => solution,
        Status::NotConverged => "best iterate, not converged",
    };
    let subtitle = format!("{label}; {statement}, σ = {sigma}, {} steps", file.grid.steps());
    let points = |values: &[f64], i: usize, skip: Option<usize>| {
        let mut envelope = Envelope::new();
        for (k, value) in values[i..].iter().step_by(d).enumerate() {
            if Some(k) != skip {
                envelope.push(file.grid.time(k), *value);
            }
        }
        envelope.points()
    };
    let chart = |axis: &str| {
        Chart::new(file.heading(), Axis::linear("time t"), Axis::linear(axis)).with_subtitle(subtitle.clone())
    };
    let mut positions = chart("position x");
    let mut velocities = chart(velocity);
    for i in 0..d {
        let curve = points(&extremal.positions, i, None);
        positions = positions.with(Series::new(format!("x{i}"), Style::Line, curve));
        let curve = points(&extremal.velocities, i, Some(file.sigma.excluded(file.grid.steps())));
        velocities = velocities.with(Series::new(format!("v{i}"), Style::Line, curve));
    }
    if let Some(reference) = &file.reference {
        let style = match reference {
            KnownPositions::Expressions { .. } => Style::Reference,
            KnownPositions::Table { .. } => Style::ReferencePoints,
        };
        for i in 0..d {
            let mut envelope = Envelope::new();
            for k in 0..=file.grid.steps() {
                let time = file.grid.time(k);
                if let Some(known) = reference.at(time, file.grid.step()).filter(|x| x[i].is_finite()) {
                    envelope.push(time, known[i]);
                }
            }
            let label = if i == 0 { "reference" } else { "" };
            positions = positions.with(Series::new(label, style, envelope.points()));
        }
    }
    vec![("positions.svg", positions), ("velocities.svg", velocities)]
}
