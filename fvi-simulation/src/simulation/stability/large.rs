//! The stability check for a large system, by its fastest motions only.

use super::{DampingForm, Discretisation, LinearDamping, LinearSystem, Verdict, check_stability};
use crate::model::{Matrix, Model, matrix};
use fvi_core::{Block, Instant, Mechanics};
use fvi_fft::dense::symmetric_eigen;
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::scenario::Scenario;
use nalgebra::DMatrix;

/// Number of steps of the Lanczos iteration; the largest eigenvalues of stiffness and damping are well
/// separated, and an accuracy of a few per cent suffices.
const ITERATIONS: usize = 40;

/// Margin for the largest eigenvalue, which the iteration never overestimates.
const MARGIN: f64 = 1.02;

/// True if the scheme is stable at every step for any stiffness and damping: the midpoint rule, damped at its
/// node by BDF 1 or 2.
pub(super) fn is_unconditional(discretisation: &Discretisation, damped: bool) -> bool {
    let midpoint = discretisation.degree == 1 && discretisation.nodes == [0.5];
    let passive = match discretisation.form {
        DampingForm::Nodes { rule } => rule.is_passive(),
        DampingForm::MainNodes { .. } | DampingForm::Stages { .. } => !damped,
    };
    midpoint && passive
}

/// Checks single modes: one with the largest eigenvalues of K and ρ relative to M, and slower ones with
/// smaller eigenvalues in the same proportion.
///
/// Exact if the matrices are proportional; heuristic otherwise. Coordinates without mass are fixed, which
/// makes the others faster than they are.
pub(super) fn check_large(
    discretisation: &Discretisation,
    scenario: &Scenario,
    model: &mut Model<f64>,
) -> Verdict {
    let (step, steps) = (scenario.time.step, scenario.time.steps);
    let size = scenario.coordinates();
    let mut stiffness = model.stiffness();
    let mut restoring = vec![0.0; size];
    let instant = Instant::in_step(scenario.time.start, 0.5, step);
    let start = &scenario.initial.position;
    model.linearise(instant, start, &mut restoring, &mut stiffness);
    let massless = scenario.system.massless();
    let largest = |matrix: &Matrix<f64>| Some(MARGIN * largest_eigenvalue(model, matrix, &massless, size)?);
    let damping = scenario.system.damping.iter();
    let damping = damping.map(|term| Some((largest(&matrix(&term.coefficient))?, &term.transfer)));
    let damping: Option<Vec<(f64, &TransferFunction)>> = damping.collect();
    // What cannot be decided is not stable.
    let unknown = Verdict::Unstable { largest_stable_step: None };
    let (Some(fastest), Some(damping)) = (largest(&stiffness), damping) else { return unknown };
    let mut least = None;
    for part in (0..12).map(|halvings| 0.25_f64.powi(halvings)) {
        let one = |entry: f64| DMatrix::from_element(1, 1, entry);
        let terms = damping
            .iter()
            .map(|&(largest, transfer)| LinearDamping {
                coefficients: one(part * largest),
                transfer: transfer.clone(),
            })
            .collect();
        let Ok(system) = LinearSystem::new(&one(1.0), &one(part * fastest), terms) else { return unknown };
        if let Verdict::Unstable { largest_stable_step } =
            check_stability(discretisation, &system, step, steps)
        {
            let least_so_far = least.get_or_insert(largest_stable_step);
            *least_so_far = match (*least_so_far, largest_stable_step) {
                (Some(one), Some(other)) => Some(f64::min(one, other)),
                _ => None,
            };
        }
    }
    least.map_or(Verdict::Stable, |largest_stable_step| Verdict::Unstable { largest_stable_step })
}

/// The largest eigenvalue λ of A x = λ M x by the Lanczos iteration in the inner product of M; `None` where
/// numbers beyond the range occur.
fn largest_eigenvalue(
    model: &Model<f64>,
    matrix: &Matrix<f64>,
    massless: &[usize],
    size: usize,
) -> Option<f64> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mass = model.mass();
    let times = |block: &Matrix<f64>, x: &[f64]| {
        let mut product = vec![0.0; size];
        block.multiply_add(1.0, x, &mut product);
        product
    };
    // A pseudorandom start vector, the same on every machine.
    let mut seed = 0x9E37_79B9_7F4A_7C15_u64;
    let mut x: Vec<f64> = (0..size)
        .map(|_| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        })
        .collect();
    massless.iter().for_each(|&row| x[row] = 0.0);
    let norm = dot(&x, &times(mass, &x)).sqrt();
    if norm == 0.0 {
        // Nothing has mass.
        return Some(0.0);
    }
    x.iter_mut().for_each(|x| *x /= norm);
    let mut before = vec![0.0; size];
    let (mut diagonal, mut beside): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
    for _ in 0..ITERATIONS.min(size) {
        let force = times(matrix, &x);
        let alpha = dot(&force, &x);
        let mut next = vec![0.0; size];
        model.velocity(&force, &mut next);
        // The first has none before it.
        let beta = if let Some(&beta) = beside.last() { beta } else { 0.0 };
        for ((next, &x), &before) in next.iter_mut().zip(&x).zip(&before) {
            *next -= alpha * x + beta * before;
        }
        diagonal.push(alpha);
        // Rounding may leave a square below zero.
        let square = dot(&next, &times(mass, &next));
        let norm = if square < 0.0 { 0.0 } else { square.sqrt() };
        if !norm.is_finite() {
            return None;
        }
        if norm <= 1e-12 * alpha.abs() {
            break;
        }
        beside.push(norm);
        next.iter_mut().for_each(|next| *next /= norm);
        before = std::mem::replace(&mut x, next);
    }
    let count = diagonal.len();
    let tridiagonal = DMatrix::from_fn(count, count, |row, column| match row.abs_diff(column) {
        0 => diagonal[row],
        1 => beside[row.min(column)],
        _ => 0.0,
    });
    let largest = symmetric_eigen(tridiagonal).eigenvalues.max();
    largest.is_finite().then_some(if largest > 0.0 { largest } else { 0.0 })
}
