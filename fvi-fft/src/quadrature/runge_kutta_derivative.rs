//! Derivatives of the matrix weights of Runge–Kutta convolution quadrature by parameters of a kernel.

use crate::quadrature::runge_kutta_circle::on_circle;
use crate::transfer::derivative::TransferDerivative;
use fvi_core::{ParameterError, RungeKutta};
use nalgebra::SMatrix;

/// The derivatives ∂W_n of matrix weights with respect to a parameter θ of the kernel, n = 0 … count − 1,
/// plane by plane: entry (i, j) of ∂W_n is at (i·R + j)·count + n. On values, or on rises if `on_rises` is
/// set, as in [`of_transfer`](super::runge_kutta_weights::RungeKuttaWeights::of_transfer).
///
/// ```text
/// Σ_n ∂W_n zⁿ = f(Δ(z)/h) ,      f = ∂K/∂θ ;      on rises f(Δ(z)/h) (Δ(z)/h)⁻¹ A⁻¹/h
/// ```
///
/// Δ(z) = A⁻¹ − z A⁻¹ 1 bᵀ A⁻¹ has the eigenvalues λ with z R(λ) = 1, R the stability function of a stiffly
/// accurate method, and for each the eigenvectors v = (I − λA)⁻¹ 1 and wᵀ = bᵀ (I − λA)⁻¹, so that
/// f(Δ/h) = Σ f(λ/h) v wᵀ / wᵀv. The weights follow from Cauchy's integral on a circle inside |z| = 1, as a
/// transform, with errors relative to the largest.
///
/// # Errors
/// If h is not positive and finite, or a weight is not finite.
pub fn runge_kutta_derivative<const R: usize>(
    method: &RungeKutta<R>,
    derivative: &TransferDerivative,
    step_size: f64,
    on_rises: bool,
    count: usize,
) -> Result<Vec<f64>, ParameterError> {
    if let Some(time) = derivative.of_strength() {
        return relaxation_weights(method, time, step_size, on_rises, count);
    }
    let value = |s| derivative.value(s);
    Ok(on_circle(method, &value, step_size, on_rises, count)?.planes)
}

/// The matrix weights of τs/(1 + τs), those of the method for τẏ = u − y: with M = (I + hA/τ)⁻¹, its last row
/// m and a = M 1, whose last entry is the stability function,
///
/// ```text
/// on rises  W_0 = M ,  W_n = a_R^(n−1) a m ;      on values  W_0 = M ,  W_n = −a_R^(n−1) a m A h/τ .
/// ```
fn relaxation_weights<const R: usize>(
    method: &RungeKutta<R>,
    time: f64,
    step_size: f64,
    on_rises: bool,
    count: usize,
) -> Result<Vec<f64>, ParameterError> {
    let refused = ParameterError { parameter: "step size", value: step_size, allowed: "positive and finite" };
    if !(step_size > 0.0 && step_size.is_finite()) {
        return Err(refused);
    }
    let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j] * (step_size / time));
    let Some(inverse) = (SMatrix::identity() + matrix).try_inverse() else { return Err(refused) };
    let last = inverse.row(R - 1);
    let row = if on_rises { last.into_owned() } else { -(last * matrix) };
    let decays = inverse.column_sum();
    let mut planes = vec![0.0; R * R * count];
    for (plane, weights) in planes.chunks_mut(count.max(1)).enumerate() {
        let (i, j) = (plane / R, plane % R);
        let mut weight = decays[i] * row[j];
        for (n, place) in weights.iter_mut().enumerate() {
            if n == 0 {
                *place = inverse[(i, j)];
                continue;
            }
            *place = weight;
            weight *= decays[R - 1];
        }
    }
    Ok(planes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quadrature::runge_kutta_weights::RungeKuttaWeights;
    use crate::transfer::TransferFunction;
    use fvi_core::ParameterError;

    type Made = Result<TransferFunction, ParameterError>;

    /// A parameter, its index and value, and the kernel as a function of it.
    type Case = (&'static str, usize, f64, Box<dyn Fn(f64) -> Made>);

    fn assert_differences<const R: usize>(method: &RungeKutta<R>, case: &Case) {
        let (name, index, at, make) = case;
        let (step_size, count) = (0.05, 50);
        let transfer = make(*at).unwrap();
        let derivative = TransferDerivative::new(&transfer, name, *index).unwrap();
        for on_rises in [false, true] {
            // Differences of weights on rises are those of kernels that grow, besides those of strengths.
            if on_rises && transfer.growth() < 0.1 && *name != "strengths" {
                continue;
            }
            let found = runge_kutta_derivative(method, &derivative, step_size, on_rises, count).unwrap();
            let planes = |by: f64| {
                RungeKuttaWeights::of_transfer(method, &make(at + by).unwrap(), on_rises, step_size, count)
                    .unwrap()
                    .planes()
            };
            let h = 1e-3 * at;
            let [one, other, far, away] = [h, -h, 2.0 * h, -2.0 * h].map(planes);
            let (mut largest, mut error) = (0.0_f64, 0.0_f64);
            for (place, found) in found.iter().enumerate() {
                let difference =
                    (8.0 * (one[place] - other[place]) - (far[place] - away[place])) / (12.0 * h);
                largest = largest.max(difference.abs());
                error = error.max((found - difference).abs());
            }
            assert!(
                error < 1e-9 * largest,
                "{name} of {transfer}, {R}, {on_rises}: {error:e} of {largest:e}"
            );
        }
    }

    #[test]
    fn derivatives_are_differences_of_weights() {
        let cases: Vec<Case> = vec![
            ("order", 0, 0.7, Box::new(TransferFunction::power)),
            ("order", 0, 1.4, Box::new(TransferFunction::power)),
            ("rate", 0, 0.3, Box::new(|x| TransferFunction::tempered(1.4, x))),
            ("order", 0, 0.8, Box::new(|x| TransferFunction::maxwell(x, 0.2, 1.5))),
            ("inner", 0, 0.2, Box::new(|x| TransferFunction::maxwell(0.8, x, 1.5))),
            ("strengths", 1, 0.7, Box::new(|x| TransferFunction::prony(&[1.0, x], &[1.0, 0.1]))),
            ("times", 1, 0.1, Box::new(|x| TransferFunction::prony(&[1.0, 0.7], &[1.0, x]))),
            ("time", 0, 2.0, Box::new(|x| TransferFunction::havriliak_negami(0.6, 0.5, x))),
        ];
        for case in &cases {
            assert_differences(&RungeKutta::<1>::radau_iia().unwrap(), case);
            assert_differences(&RungeKutta::<2>::radau_iia().unwrap(), case);
            assert_differences(&RungeKutta::<3>::radau_iia().unwrap(), case);
            assert_differences(&RungeKutta::<4>::lobatto_iiic().unwrap(), case);
        }
    }
}
