//! Kernels as relaxations for the dampers of mechanisms, whose Gauss methods do not damp fast relaxations.

use crate::exponentials::rate_rules::Relaxation;
use crate::exponentials::rate_table::{ENDLESS, RateTableError, check_ranges};
use crate::exponentials::spectrum::Spectrum;
use crate::transfer::TransferFunction;
use crate::transfer::derivative::TransferDerivative;
use fvi_core::{ParameterError, RelaxationTable};

/// Rate times shortest step from which on relaxations act as dashpots: merging them changes the weights of a
/// Gauss method by X^{−2+β} relative to the first, 0 < β < 1 the growth beyond the last whole order.
const FASTEST: f64 = 1e13;

/// The table of a kernel for the dampers of a [mechanism](fvi_core::MechanismIntegrator), for steps of at
/// least `shortest` and times up to `horizon`: K(s) = s^d Σ_j c_j/(s + λ_j) within the relative `tolerance`
/// for |s| from the inverse of the horizon to ten times that of the shortest step.
///
/// The stability function of a Gauss method does not vanish at infinity, R(∞) = ±1, so that relaxations much
/// faster than a step count in all that follow, and those up to 10¹³ times as fast are kept. For a
/// completely monotone relaxation (every s^β with 0 ≤ β ≤ 1, Prony and Maxwell elements, and their sums) all
/// c_j are positive, and the dampers never give back more energy than they have taken up.
///
/// Source: \[LFS16\] for sums of relaxations; \[BanjaiFerrari22\] for the weights.
///
/// # Errors
/// [`RateTableError`]: for kernels with singularities off the negative real axis, kernels that vanish at
/// large s, and those given by weights; and for lengths out of range.
pub fn relaxation_table(
    transfer: &TransferFunction,
    shortest: f64,
    horizon: f64,
    tolerance: f64,
) -> Result<RelaxationTable<Vec<f64>>, RateTableError> {
    table_of((transfer, None), shortest, horizon, tolerance)
}

/// The table of ∂K/∂θ, with the d of the table of K, for the derivatives of a motion: within 10⁻¹⁰ of K.
///
/// # Errors
/// [`RateTableError`], also where ∂K/∂θ is no sum of relaxations.
pub fn relaxation_table_derivative(
    transfer: &TransferFunction,
    by: &TransferDerivative,
    shortest: f64,
    horizon: f64,
    tolerance: f64,
) -> Result<RelaxationTable<Vec<f64>>, RateTableError> {
    table_of((transfer, Some(by)), shortest, horizon, tolerance)
}

fn table_of(
    (transfer, by): (&TransferFunction, Option<&TransferDerivative>),
    shortest: f64,
    horizon: f64,
    tolerance: f64,
) -> Result<RelaxationTable<Vec<f64>>, RateTableError> {
    check_ranges(shortest, horizon, tolerance)?;
    if let Some(table) = transfer.table() {
        let (parameter, value) = ("number of weights", table.weights().len() as f64);
        return Err(ParameterError { parameter, value, allowed: "none: weights are for equal steps" }.into());
    }
    let growth = transfer.growth();
    if growth < 0.0 {
        let allowed = "at least 0 for dampers of mechanisms: the kernel vanishes at large s";
        return Err(ParameterError { parameter: "growth of the kernel", value: growth, allowed }.into());
    }
    let derivatives = if growth <= 1.0 { 1 } else { 2 };
    let [nodes, ends] = Spectrum { transfer, by, derivatives, shortest, horizon, tolerance }
        .relaxations()
        .map_err(|reached| RateTableError::ToleranceMissed { tolerance, reached })?;
    let closing = ENDLESS / shortest;
    let (slow, fast): (Vec<_>, Vec<_>) =
        nodes.into_iter().chain(ends).partition(|node| node.rate * shortest < FASTEST);
    let worth: f64 = fast.iter().map(|node| node.coefficient / node.rate).sum();
    let dashpot = (worth != 0.0).then_some(Relaxation { rate: closing, coefficient: worth * closing });
    let mut all: Vec<_> = slow.into_iter().filter(|node| node.coefficient != 0.0).chain(dashpot).collect();
    all.sort_by(|a, b| a.rate.total_cmp(&b.rate));
    let rates = all.iter().map(|node| node.rate).collect();
    let coefficients = all.iter().map(|node| node.coefficient).collect();
    Ok(RelaxationTable { is_inertial: derivatives == 2, rates, coefficients, shortest, horizon })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sums::max_or_nan;
    use fvi_core::{GaussLobatto, Relaxing};
    use nalgebra::{Complex, Matrix2, Vector2};
    use std::f64::consts::PI;

    type Weight = Matrix2<f64>;

    /// Z_0 … Z_{count−1} of K(s)/s for the Gauss method of two stages, by Cauchy's formula around 0:
    /// Σ Z_n ζⁿ = Z(Δ(ζ)/h), Δ(ζ) = (A + ζ/(1−ζ) 1bᵀ)⁻¹.
    fn weights(transfer: &TransferFunction, h: f64, count: usize) -> Vec<Weight> {
        let rule = GaussLobatto::<f64>::new(2).unwrap();
        let points = 8 * count;
        let radius = 1e-16_f64.powf(1.0 / points as f64);
        let values: Vec<(Complex<f64>, Matrix2<Complex<f64>>)> = (0..points)
            .map(|k| {
                let z = Complex::from_polar(radius, 2.0 * PI * k as f64 / points as f64);
                let carried = z / (Complex::new(1.0, 0.0) - z);
                let sum = Matrix2::from_fn(|i, j| carried * rule.weight(j) + rule.matrix(i, j));
                let delta = sum.try_inverse().unwrap() / Complex::new(h, 0.0);
                let half = delta.trace() * 0.5;
                let root = (half * half - delta.determinant()).sqrt();
                let [one, other] = [half + root, half - root];
                let [at_one, at_other] = [one, other].map(|s| transfer.value(s) / s);
                let identity = Matrix2::<Complex<f64>>::identity();
                let slope = (at_one - at_other) / (one - other);
                (z, identity * at_one + (delta - identity * one) * slope)
            })
            .collect();
        let weight = |n: usize| {
            let sum = values.iter().fold(Matrix2::zeros(), |sum: Matrix2<Complex<f64>>, (z, value)| {
                sum + value * z.powi(-(n as i32))
            });
            sum.map(|entry| entry.re / points as f64)
        };
        (0..count).map(weight).collect()
    }

    /// The same weights as a damper has them: the forces that a unit velocity at one node leaves.
    fn weights_of_damper(transfer: &TransferFunction, h: f64, count: usize) -> Vec<Weight> {
        weights_of_table(relaxation_table(transfer, h, h * count as f64, 1e-13).unwrap(), h, count)
    }

    fn weights_of_table(table: RelaxationTable<Vec<f64>>, h: f64, count: usize) -> Vec<Weight> {
        let rule = GaussLobatto::<f64>::new(2).unwrap();
        let columns = [0, 1].map(|node| {
            let numbers = vec![0.0; Relaxing::<f64, Vec<f64>, Vec<f64>>::numbers(table.rates.len(), 2, 1)];
            let mut damper = Relaxing::new(&rule, table.clone(), vec![1.0], 1, numbers).unwrap();
            let mut forces = Vec::new();
            for step in 0..count {
                damper.begin_step(h).unwrap();
                let mut force = [0.0; 2];
                damper.known(&mut force);
                if step == 0 {
                    force = [0, 1].map(|i| damper.leading([0, 0], [i, node]));
                }
                forces.push(Vector2::from(force));
                let mut rates = [0.0; 2];
                rates[node] = if step == 0 { 1.0 } else { 0.0 };
                damper.push(&rates);
            }
            forces
        });
        (0..count).map(|n| Matrix2::from_columns(&[columns[0][n], columns[1][n]])).collect()
    }

    #[test]
    fn dampers_have_the_weights_of_gauss_convolution_quadrature() {
        let powers = [0.0, 0.02, 0.3, 0.5, 0.9, 0.99, 1.0, 1.05, 1.5, 1.9];
        let mut kernels: Vec<_> = powers.iter().map(|&beta| TransferFunction::power(beta).unwrap()).collect();
        kernels.push(TransferFunction::prony(&[1.0, 0.5], &[0.3, 20.0]).unwrap());
        kernels.push(TransferFunction::maxwell(0.6, 0.3, 1.0).unwrap());
        kernels.push(TransferFunction::tempered(0.5, 0.7).unwrap());
        kernels.push(TransferFunction::havriliak_negami(0.7, 0.5, 1.0).unwrap());
        for transfer in &kernels {
            for h in [0.01, 0.7] {
                let (exact, found) = (weights(transfer, h, 40), weights_of_damper(transfer, h, 40));
                let size = exact[0].norm();
                let error = exact
                    .iter()
                    .zip(&found)
                    .fold(0.0, |most, (exact, found)| max_or_nan(most, (exact - found).norm() / size));
                assert!(error < 2e-11, "{transfer:?}, h = {h}: {error:e}");
            }
        }
    }

    #[test]
    fn derivatives_of_kernels_have_the_differences_of_their_weights() {
        type Case = (&'static str, usize, f64, Box<dyn Fn(f64) -> TransferFunction>);
        let prony = |g, t| TransferFunction::prony(&[1.0, g], &[0.3, t]).unwrap();
        let cases: Vec<Case> = vec![
            ("order", 0, 0.4, Box::new(|x| TransferFunction::power(x).unwrap())),
            ("order", 0, 1.5, Box::new(|x| TransferFunction::power(x).unwrap())),
            ("order", 0, 0.5, Box::new(|x| TransferFunction::tempered(x, 0.7).unwrap())),
            ("rate", 0, 0.7, Box::new(|x| TransferFunction::tempered(0.5, x).unwrap())),
            ("order", 0, 0.6, Box::new(|x| TransferFunction::maxwell(x, 0.3, 1.0).unwrap())),
            ("time", 0, 0.8, Box::new(|x| TransferFunction::maxwell(0.6, 0.3, x).unwrap())),
            ("power", 0, 0.5, Box::new(|x| TransferFunction::havriliak_negami(0.7, x, 1.0).unwrap())),
            ("strengths", 1, 0.5, Box::new(move |x| prony(x, 2.0))),
            ("times", 1, 2.0, Box::new(move |x| prony(0.5, x))),
        ];
        for (name, index, at, make) in cases {
            let h = 0.1;
            let by = TransferDerivative::new(&make(at), name, index).unwrap();
            let table = relaxation_table_derivative(&make(at), &by, h, 4.0, 1e-13).unwrap();
            let exact = weights_of_table(table, h, 40);
            let size = weights_of_damper(&make(at), h, 1)[0].norm();
            let [e, two] = [1e-3, 2e-3].map(|e| {
                let [more, less] = [at + e, at - e].map(|x| weights_of_damper(&make(x), h, 40));
                more.iter().zip(less).map(|(more, less)| (more - less) / (2.0 * e)).collect::<Vec<_>>()
            });
            for (n, exact) in exact.iter().enumerate() {
                let error = (exact - (e[n] * 4.0 - two[n]) / 3.0).norm() / size;
                assert!(error < 1e-9, "{name} of {}, weight {n}: {error:e}", make(at));
            }
        }
    }

    #[test]
    fn relaxations_of_passive_kernels_are_positive_and_others_refused() {
        for beta in [0.05, 0.5, 0.95, 1.0, 1.3] {
            let table = relaxation_table(&TransferFunction::power(beta).unwrap(), 1e-3, 1e2, 1e-12).unwrap();
            assert!(table.coefficients.iter().all(|&c| c > 0.0), "β = {beta}");
            assert!(table.rates.len() < 300, "β = {beta}: {} rates", table.rates.len());
        }
        let half = TransferFunction::power(0.5).unwrap();
        assert!(relaxation_table(&half, 1.0, 0.1, 1e-12).is_err());
        assert!(relaxation_table(&TransferFunction::power(-0.5).unwrap(), 1e-3, 1.0, 1e-12).is_err());
    }
}
